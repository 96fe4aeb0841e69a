//! Linear models of the shapes of a cohort.
//!
//! * this file — the kind of study; `answer` — its question and record, `refusals` — its errors; `table` — the attributes that a formula names; [`further`] — pairs, disparity, trajectories, bands;
//!   [`extras`] — random effects, multivariate statistics, known covariances; [`kept`] — predictions of models that are kept;
//! * `streamed` — models of more shapes than fit into memory, `columns` — their attributes.

mod answer;
mod columns;
pub mod extras;
pub mod further;
pub mod kept;
mod refusals;
mod streamed;
pub(super) mod table;

use std::collections::BTreeMap;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use self::extras::{Compatibility, CovarianceOptions, ManovaOptions, RandomOptions, names_scores};
use self::further::FurtherOptions;
use self::refusals::refused;
pub(super) use self::refusals::refused_at;
use self::streamed::Large;
use self::table::{complete, full_name, resolved, table_of};
use super::regressions::Missing;
use super::sample::labels_of;
use super::study::{Plan, Study, StudyKind, StudyRequest, within_memory};
use crate::analysis::drawing::models::draw_model;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::models::anova::{ExchangeRule, Statistic};
use crate::analysis::models::design::{Contrasts, Design, Table, Values};
use crate::analysis::models::effect_size::Transform;
use crate::analysis::models::error::ModelError;
use crate::analysis::models::formula::{Formula, RandomPart, TermOrder};
use crate::analysis::models::manova::MAX_COORDINATES;
use crate::analysis::models::mixed;
use crate::analysis::models::records::At;
use crate::analysis::models::study::{LOG_CENTROID_SIZE, MAX_PREDICTIONS, model};
use crate::analysis::models::subspaces::{Space, SumType};
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{JobKind, JobOutput};
use crate::domain::shape::ShapeDescription;
use crate::domain::study::ShapeModel;
use crate::geometry::drawing::scene::Drawing;
use crate::numeric::dense::Matrix;
use crate::service::app::progress::JobContext;
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
    /// What is asked besides the table.
    #[serde(default)]
    pub further: FurtherOptions,
    /// Estimates of a random part.
    #[serde(default)]
    pub random: Option<RandomOptions>,
    /// Multivariate statistics.
    #[serde(default)]
    pub manova: Option<ManovaOptions>,
    /// Known covariance of the shapes.
    #[serde(default)]
    pub covariance: Option<CovarianceOptions>,
    /// Other programs whose numbers are added.
    #[serde(default)]
    pub compatibility: Option<Compatibility>,
}

/// The formula of a model and those that belong to it, with their places.
#[derive(Debug, Clone)]
struct Formulas {
    own: Formula,
    place: &'static str,
    others: Vec<(Formula, &'static str)>,
}

impl Formulas {
    fn all(&self) -> impl Iterator<Item = (&Formula, &'static str)> {
        let others = self.others.iter().map(|(formula, place)| (formula, *place));
        std::iter::once((&self.own, self.place)).chain(others)
    }

    /// The reduced model of a comparison.
    fn reduced(&self) -> Option<&Formula> {
        self.others.iter().find(|(_, place)| *place == "/reduced").map(|(formula, _)| formula)
    }
}

/// Shapes of a model, with their attributes.
#[derive(Debug)]
pub struct ModelledShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    formulas: Formulas,
    table: Table,
    needs_sizes: bool,
    strata: Option<Vec<usize>>,
    blocks: Option<Vec<usize>>,
    left_out: usize,
    /// Names of the shapes in their covariance, and its factor, known once the cost is.
    named: Vec<String>,
    factor: OnceLock<Matrix>,
    /// Of shapes that are read as a stream, which have no descriptions.
    large: Option<Large>,
}

impl StudyKind for ModelledShapes {
    type Options = Options;
    type Record = ShapeModel;
    const KIND: JobKind = JobKind::Model;
    const PHASE: &'static str = "model";

    fn faults(app: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let options = &request.options;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(request.strata_faults());
        match read(options) {
            Ok(formula) if formula.terms.is_empty() => {
                faults.push(Fault::new(options.place(), ModelError::NoTerms.to_string()));
            }
            Ok(_) => {}
            Err(detail) => faults.push(Fault::new(options.place(), detail)),
        }
        faults.extend(options.further.faults(app, options));
        let response = options.response.as_str();
        let is_known = match names_scores(response) {
            true => extras::scores(response).is_some(),
            false => [SHAPE, LOG_CENTROID_SIZE].contains(&response) || resolved(response).is_some(),
        };
        if !is_known {
            let detail = format!(
                "expected 'shape', '{LOG_CENTROID_SIZE}', 'score 1..3' or a numeric attribute, got '{response}'"
            );
            faults.push(Fault::new("/response", detail));
        }
        let blocks: Vec<String> = (0..options.blocks.len()).map(|i| format!("/blocks/{i}")).collect();
        let blocks = options.blocks.iter().zip(&blocks);
        faults.extend(faults_of_names(blocks.map(|(name, pointer)| (name.as_str(), pointer.as_str()))));
        faults.extend(extras::faults(options));
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
        let place = options.place();
        let own = read(options).map_err(|detail| ServiceError::invalid(place, detail))?;
        let formulas = Formulas { own, place, others: options.further.formulas(options)? };
        if let Some(large) = streamed::select(app, cohort, plan, &formulas).await? {
            return Ok(large);
        }
        let described = attributes::describe(app, cohort, &options.filter, "/filter").await?;
        let all = described.len();
        if all == 0 {
            let known = KnownAttributes::of(app, cohort).await?;
            return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
        }
        let shapes = complete(app, cohort, options, &formulas, described).await?;
        let table = table_of(options, &formulas, &shapes)?;
        let needs_sizes = options.response == LOG_CENTROID_SIZE
            || formulas.all().any(|(formula, _)| names(formula, LOG_CENTROID_SIZE));
        let labels = |names: &[String], pointer: &str| match names.is_empty() {
            true => Ok(None),
            false => labels_of(names, &shapes, pointer).map(Some),
        };
        let blocks: Vec<String> = options.blocks.iter().map(|name| full_name(name)).collect();
        let (strata, blocks) = (labels(&plan.strata, "/strata")?, labels(&blocks, "/blocks")?);
        let (filter, left_out) = ([options.filter.clone()], all - shapes.len());
        let named = match &options.covariance {
            Some(covariance) => covariance.names_of(&shapes)?,
            None => Vec::new(),
        };
        let factor = OnceLock::new();
        let large = None;
        Ok(Self {
            shapes,
            filter,
            formulas,
            table,
            needs_sizes,
            strata,
            blocks,
            left_out,
            named,
            factor,
            large,
        })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        let shapes = self.shapes.len();
        // Sizes are known once the shapes are read; any numbers that differ make as many columns.
        let table = self.table_with((0..shapes).map(|k| k as f64).collect());
        let place = self.formulas.place;
        let refused = |error| refused(error, place, &self.shapes);
        let design = Design::named(&self.formulas.own, &table, plan.options.coding()).map_err(refused)?;
        // Groups of random parts are columns of the model inside of them.
        let of_part = |part: &RandomPart| design.count(&part.group) * (1 + part.terms.len());
        let groups: usize = self.formulas.own.random.iter().map(of_part).sum();
        let (columns, terms) = (design.columns.len() + groups, self.formulas.own.terms.len());
        let length = if plan.options.is_of_shapes() { setup.measured().metric.len() } else { 1 };
        let (numbers, most) = (columns.saturating_mul(length), app.limits.samples);
        if numbers > most {
            let detail = format!(
                "expected at most {most} numbers in the coefficients, got {numbers} for {columns} columns"
            );
            return Err(ServiceError::invalid(place, detail));
        }
        if let Some(large) = &self.large {
            return large.estimate(app, plan, setup, &design);
        }
        let permutations = plan.permutations;
        let work =
            TestWork { shapes, samples: 0, permutations, columns: columns + 1, pairs: 0, pair_shapes: 0 };
        let (more, bytes) = plan.options.extra_work(shapes, columns, (length, terms, permutations), groups);
        let estimate = within_memory(app, setup, &work, "/filter")?
            .with_design(columns, terms, permutations)
            .with_work(more, bytes);
        let further = &plan.options.further;
        let estimate = further.cost(estimate, (&plan.options, &design), (setup, permutations))?;
        let most = app.limits.job_bytes as f64;
        if estimate.memory_bytes > most {
            let detail = format!(
                "expected a model that takes at most {most:.1e} bytes of memory, got {:.1e} for {shapes} shapes, {columns} columns and \
                 {permutations} permutations of {terms} terms",
                estimate.memory_bytes
            );
            return Err(ServiceError::invalid("/permutations", detail));
        }
        if let Some(covariance) = &plan.options.covariance {
            let names: Vec<&str> = self.named.iter().map(String::as_str).collect();
            let factor =
                covariance.read().and_then(|covariance| covariance.factor(&names)).map_err(refused)?;
            self.factor.get_or_init(|| factor);
        }
        if shapes <= columns && !self.needs_sizes {
            // Fewer shapes than independent columns are refused before the shapes are read.
            Space::new(&design.filled(), &vec![1.0; shapes]).map_err(refused)?;
        }
        Ok(estimate)
    }

    fn streamed(
        study: &Study<Self>,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Option<Result<ShapeModel, ServiceError>> {
        study.sample.large.as_ref().map(|large| large.model(study, app, handle, context))
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeModel, ServiceError> {
        let sample = &study.sample;
        let table = match sample.needs_sizes {
            true => sample.table_with(shapes.log_centroid_sizes().ok_or_else(|| {
                ServiceError::invalid("/cohort", "the cohort has shapes too large to be measured")
            })?),
            false => sample.table.clone(),
        };
        sample.record(study, &table, |question| model(shapes, question, watch))
    }

    fn is_kept(options: &Options) -> bool {
        options.further.keep
    }

    fn kept(record: &mut ShapeModel, job: &str) -> Result<Option<JobOutput>, ServiceError> {
        kept::output(record, job)
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

    /// Whether shapes are modelled, and no numbers.
    fn is_of_shapes(&self) -> bool {
        self.response == SHAPE || names_scores(&self.response)
    }

    /// Place of the formula in the request.
    fn place(&self) -> &'static str {
        if self.further.reduced.is_some() { "/full" } else { "/formula" }
    }

    /// Multiply-adds and bytes of what is asked beside the table.
    fn extra_work(
        &self,
        shapes: usize,
        columns: usize,
        (length, terms, permutations): (usize, usize, usize),
        groups: usize,
    ) -> (f64, f64) {
        let (n, rows) = (shapes as f64, length as f64);
        let (mut work, mut bytes) = (0.0, 0.0);
        if groups > 0 {
            let (more, memory) = mixed::cost((shapes, groups), columns, length);
            (work, bytes) = (work + more, bytes + memory);
        }
        if let Some(manova) = &self.manova {
            let m = manova.components.unwrap_or(MAX_COORDINATES).min(shapes) as f64;
            let tests = terms as f64 * permutations as f64;
            work += tests * (n * m + columns as f64 * m * m + m * m * m) + n * n.min(rows) * rows;
            bytes += 40.0 * tests + 16.0 * n * (n.min(rows) + m);
        }
        if self.covariance.is_some() {
            work += n * n * (n / 6.0 + rows + columns as f64);
            bytes += 24.0 * n * n;
        }
        (work, bytes)
    }
}

impl ModelledShapes {
    /// Shapes that are read as a stream.
    fn streamed(
        formulas: Formulas,
        table: Table,
        filter: ShapeFilter,
        strata: Option<Vec<usize>>,
        left_out: usize,
        large: Large,
    ) -> Self {
        Self {
            shapes: Vec::new(),
            filter: [filter],
            formulas,
            table,
            needs_sizes: false,
            strata,
            blocks: None,
            left_out,
            named: Vec::new(),
            factor: OnceLock::new(),
            large: Some(large),
        }
    }

    /// Number of shapes.
    fn count(&self) -> usize {
        self.large.as_ref().map_or(self.shapes.len(), |large| large.count)
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
    read_text(&options.formula, options.order)
}

fn read_text(text: &str, order: TermOrder) -> Result<Formula, String> {
    let length = text.chars().count();
    if length > MAX_FORMULA {
        return Err(format!("expected at most {MAX_FORMULA} characters, got {length}"));
    }
    Formula::parse(text, order).map_err(|error| error.to_string())
}

/// Whether a formula names an attribute.
fn names(formula: &Formula, attribute: &str) -> bool {
    formula.variables.iter().any(|variable| variable.name == attribute)
}

/// Faults of names, with their places, that are those of no attribute.
pub(super) fn faults_of_names<'a, 'b>(names: impl Iterator<Item = (&'a str, &'b str)>) -> Vec<Fault> {
    let unknown = names.filter(|(name, _)| resolved(name).is_none());
    let fault =
        |(name, pointer)| Fault::new(pointer, format!("expected the name of an attribute, got '{name}'"));
    unknown.map(fault).collect()
}
