//! Linear models of the shapes of a cohort.
//!
//! * this file — the kind of study; `table` — the attributes that a formula names.

mod table;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use self::table::{complete, full_name, resolved, table_of};
use super::regressions::Missing;
use super::sample::{labels_of, subject_warning};
use super::study::{Plan, Study, StudyKind, StudyRequest, within_memory};
use crate::analysis::drawing::models::draw_model;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::models::anova::{ExchangeRule, Statistic, Testing};
use crate::analysis::models::design::{Contrasts, Design, Table, Values};
use crate::analysis::models::effect_size::Transform;
use crate::analysis::models::error::ModelError;
use crate::analysis::models::formula::{Formula, TermOrder};
use crate::analysis::models::study::{
    At, LOG_CENTROID_SIZE, MAX_PREDICTIONS, ModelQuestion, Response, model,
};
use crate::analysis::models::subspaces::{Space, SumType};
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::ShapeModel;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Name of the shapes as a response.
const SHAPE: &str = "shape";
/// Maximum number of characters of a formula.
const MAX_FORMULA: usize = 2000;

/// Treatment of columns that depend on others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Collinear {
    /// They are left out, and named.
    #[default]
    Drop,
    /// The request is refused.
    Refuse,
}

/// Options of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// The formula.
    pub formula: String,
    /// Order of the terms.
    pub order: TermOrder,
    /// Type of the sums of squares.
    #[serde(rename = "type")]
    pub kind: SumType,
    /// Coding of factors.
    pub contrasts: Option<Contrasts>,
    /// Levels of factors in their order.
    pub levels: BTreeMap<String, Vec<String>>,
    /// What is modelled.
    pub response: String,
    /// Treatment of shapes without a value.
    pub missing: Missing,
    /// Treatment of columns that depend on others.
    pub collinear: Collinear,
    /// Attributes whose values are blocks.
    pub blocks: Vec<String>,
    /// What is exchanged.
    pub exchange: ExchangeRule,
    /// Terms that are tested against others.
    pub error_terms: BTreeMap<String, String>,
    /// The statistic of p and Z.
    pub statistic: Statistic,
    /// Transformation of Z.
    pub z: Transform,
    /// Values at which shapes are predicted.
    pub at: Option<Vec<BTreeMap<String, At>>>,
}

/// Shapes of a model, with their attributes.
#[derive(Debug)]
pub struct ModelledShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    formula: Formula,
    table: Table,
    needs_sizes: bool,
    strata: Option<Vec<usize>>,
    blocks: Option<Vec<usize>>,
    left_out: usize,
}

impl StudyKind for ModelledShapes {
    type Options = Options;
    type Record = ShapeModel;
    const KIND: JobKind = JobKind::Model;
    const PHASE: &'static str = "model";

    fn faults(_: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let options = &request.options;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(request.strata_faults());
        match read(options) {
            Ok(formula) if formula.terms.is_empty() => {
                faults.push(Fault::new("/formula", ModelError::NoTerms.to_string()));
            }
            Ok(_) => {}
            Err(detail) => faults.push(Fault::new("/formula", detail)),
        }
        if options.response != SHAPE
            && options.response != LOG_CENTROID_SIZE
            && resolved(&options.response).is_none()
        {
            let detail = format!(
                "expected 'shape', '{LOG_CENTROID_SIZE}' or a numeric attribute, got '{}'",
                options.response
            );
            faults.push(Fault::new("/response", detail));
        }
        for (i, name) in options.blocks.iter().enumerate().filter(|(_, name)| resolved(name).is_none()) {
            faults.push(Fault::new(
                format!("/blocks/{i}"),
                format!("expected the name of an attribute, got '{name}'"),
            ));
        }
        if options.blocks.is_empty() && matches!(options.exchange, ExchangeRule::Within | ExchangeRule::Whole)
        {
            let detail = "expected `blocks` with an exchange within them or of whole ones, got none";
            faults.push(Fault::new("/exchange", detail));
        }
        if options.at.as_ref().is_some_and(|at| at.len() > MAX_PREDICTIONS) {
            let found = options.at.as_ref().map_or(0, Vec::len);
            faults
                .push(Fault::new("/at", format!("expected at most {MAX_PREDICTIONS} entries, got {found}")));
        }
        faults
    }

    fn complete(_: &mut Options, _: &Cohort) {}

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let options = &plan.options;
        let formula = read(options).map_err(|detail| ServiceError::invalid("/formula", detail))?;
        let described = attributes::describe(app, cohort, &options.filter, "/filter").await?;
        let all = described.len();
        if all == 0 {
            let known = KnownAttributes::of(app, cohort).await?;
            return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
        }
        let shapes = complete(app, cohort, options, &formula, described).await?;
        let table = table_of(options, &formula, &shapes)?;
        let needs_sizes = options.response == LOG_CENTROID_SIZE
            || formula.variables.iter().any(|variable| variable.name == LOG_CENTROID_SIZE);
        let labels = |names: &[String], pointer: &str| match names.is_empty() {
            true => Ok(None),
            false => labels_of(names, &shapes, pointer).map(Some),
        };
        let blocks: Vec<String> = options.blocks.iter().map(|name| full_name(name)).collect();
        let (strata, blocks) = (labels(&plan.strata, "/strata")?, labels(&blocks, "/blocks")?);
        let (filter, left_out) = ([options.filter.clone()], all - shapes.len());
        Ok(Self { shapes, filter, formula, table, needs_sizes, strata, blocks, left_out })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        let shapes = self.shapes.len();
        // Sizes are known once the shapes are read; any numbers that differ make as many columns.
        let table = self.table_with((0..shapes).map(|k| k as f64).collect());
        let refused = |error| refused(error, &self.shapes);
        let design = Design::named(&self.formula, &table, plan.options.coding()).map_err(refused)?;
        // Groups of random parts are columns of the model inside of them.
        let groups: usize = self.formula.random.iter().map(|part| design.count(&part.group)).sum();
        let (columns, terms) = (design.columns.len() + groups, self.formula.terms.len());
        let length = if plan.options.response == SHAPE { setup.measured().metric.len() } else { 1 };
        let (numbers, most) = (columns.saturating_mul(length), app.limits.samples);
        if numbers > most {
            let detail = format!(
                "expected at most {most} numbers in the coefficients, got {numbers} for {columns} columns"
            );
            return Err(ServiceError::invalid("/formula", detail));
        }
        let permutations = plan.permutations;
        let work =
            TestWork { shapes, samples: 0, permutations, columns: columns + 1, pairs: 0, pair_shapes: 0 };
        let estimate = within_memory(app, setup, &work, "/filter")?.with_design(columns, terms, permutations);
        let most = app.limits.job_bytes as f64;
        if estimate.memory_bytes > most {
            let detail = format!(
                "expected a model that takes at most {most:.1e} bytes of memory, got {:.1e} for {shapes} shapes, {columns} columns and \
                 {permutations} permutations of {terms} terms",
                estimate.memory_bytes
            );
            return Err(ServiceError::invalid("/permutations", detail));
        }
        if shapes <= columns && !self.needs_sizes {
            // Fewer shapes than independent columns are refused before the shapes are read.
            Space::new(&design.filled(), &vec![1.0; shapes]).map_err(refused)?;
        }
        Ok(estimate)
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeModel, ServiceError> {
        let Study { plan, cohort, sample, .. } = study;
        let options = &plan.options;
        let table = match sample.needs_sizes {
            true => sample.table_with(shapes.log_centroid_sizes().ok_or_else(|| {
                ServiceError::invalid("/cohort", "the cohort has shapes too large to be measured")
            })?),
            false => sample.table.clone(),
        };
        let error_terms: Vec<(String, String)> =
            options.error_terms.iter().map(|(term, error)| (term.clone(), error.clone())).collect();
        let question = ModelQuestion {
            formula: &sample.formula,
            table: &table,
            contrasts: options.coding(),
            response: response_of(&options.response, &table)?,
            testing: sample.testing(plan, &error_terms),
            at: options.at.as_deref(),
        };
        let mut found = model(shapes, &question, watch).map_err(|error| refused(error, &sample.shapes))?;
        let dropped = &found.anova.design.dropped;
        if options.collinear == Collinear::Refuse && !dropped.is_empty() {
            return Err(refused(ModelError::Collinear { columns: dropped.join(", ") }, &sample.shapes));
        }
        found.anova.warnings = warnings_of(study, std::mem::take(&mut found.anova.warnings));
        Ok(ShapeModel {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(sample.shapes.len(), sample.left_out),
            kind: options.kind,
            response: options.response.clone(),
            blocks: options.blocks.clone(),
            found,
        })
    }

    fn draw(study: &Study<Self>, record: &ShapeModel) -> Drawing {
        let setup = &study.setup;
        draw_model(
            (&setup.space, &setup.method),
            &study.cohort.spec.name,
            record.header.shapes,
            &record.found,
        )
    }
}

impl Options {
    /// Coding of the coefficients.
    fn coding(&self) -> Contrasts {
        self.contrasts.unwrap_or_default()
    }
}

/// What is modelled.
fn response_of<'a>(name: &str, table: &'a Table) -> Result<Response<'a>, ServiceError> {
    match (name, table.attributes.get(name)) {
        (SHAPE, _) => Ok(Response::Shape),
        (_, Some(Values::Numbers(numbers))) => Ok(Response::Numbers(numbers)),
        _ => Err(ServiceError::invalid("/response", format!("expected numbers, got texts for '{name}'"))),
    }
}

/// All that should be known of a model beside what was found.
fn warnings_of(study: &Study<ModelledShapes>, mut found: Vec<String>) -> Vec<String> {
    let Study { plan, sample, .. } = study;
    let mut warnings = study.caveats();
    warnings.append(&mut found);
    if plan.options.blocks.iter().all(|name| name != "subject") && !names_subject(&sample.formula) {
        warnings.extend(subject_warning(&sample.shapes, &plan.strata));
    }
    if sample.left_out > 0 {
        warnings.push(format!("{} shapes lack a value and are left out", sample.left_out));
    }
    warnings
}

impl ModelledShapes {
    /// How the terms are tested.
    fn testing<'a>(&'a self, plan: &Plan<Options>, error_terms: &'a [(String, String)]) -> Testing<'a> {
        let options = &plan.options;
        Testing {
            kind: options.kind,
            contrasts_of_three: options.contrasts.unwrap_or(Contrasts::Sum),
            statistic: options.statistic,
            transform: options.z,
            permutations: plan.permutations,
            seed: plan.seed,
            strata: self.strata.as_deref(),
            blocks: self.blocks.as_deref(),
            exchange: options.exchange,
            error_terms,
            given: None,
        }
    }

    /// The table with the logarithms of the centroid sizes.
    fn table_with(&self, sizes: Vec<f64>) -> Table {
        let mut table = self.table.clone();
        if self.needs_sizes {
            table.attributes.insert(LOG_CENTROID_SIZE.into(), Values::Numbers(sizes));
        }
        table
    }
}

fn read(options: &Options) -> Result<Formula, String> {
    let length = options.formula.chars().count();
    if length > MAX_FORMULA {
        return Err(format!("expected at most {MAX_FORMULA} characters, got {length}"));
    }
    Formula::parse(&options.formula, options.order).map_err(|error| error.to_string())
}

fn names_subject(formula: &Formula) -> bool {
    formula.variables.iter().any(|variable| variable.name == "subject")
}

/// Refusal for an error of a model, which names shapes by their ids.
fn refused(error: ModelError, shapes: &[ShapeDescription]) -> ServiceError {
    let place = |shape: usize| shapes.get(shape).map_or("", |shape| attributes::name_of(shape));
    let (pointer, detail) = match error {
        ModelError::Analysis(error) => return error.into(),
        ModelError::Domain { name, expected, value, shape } => (
            "/formula".to_owned(),
            format!("expected {expected} for '{name}', got {value:e} on the shape '{}'", place(shape)),
        ),
        ModelError::UnknownLevel { name, level, shape } => {
            let detail = format!(
                "expected one of the levels of '{name}', got '{level}' on the shape '{}'",
                place(shape)
            );
            (format!("/levels/{}", name.replace('~', "~0").replace('/', "~1")), detail)
        }
        error @ ModelError::StrataInside { .. } => ("/strata".into(), error.to_string()),
        error @ ModelError::UnequalBlocks { .. } => ("/blocks".into(), error.to_string()),
        error @ ModelError::NoErrorTerm { .. } => ("/error_terms".into(), error.to_string()),
        error @ (ModelError::EmptyCells { .. } | ModelError::FarFromZero { .. }) => {
            ("/type".into(), error.to_string())
        }
        error @ ModelError::FewShapes { .. } => ("/filter".into(), error.to_string()),
        ref error @ ModelError::UnknownPlace { place, ref name, .. } => {
            (format!("/at/{place}/{}", name.replace('~', "~0").replace('/', "~1")), error.to_string())
        }
        error => ("/formula".into(), error.to_string()),
    };
    ServiceError::invalid(pointer, detail)
}
