//! Models of more shapes than a request reads into memory: their attributes are columns, the shapes themselves a stream.
//!
//! The choice depends on the number of shapes, and on the memory that they would take: a model of fewer shapes is computed in memory, as
//! ever, and one that cannot be streamed is refused.

use std::collections::BTreeMap;

use tokio::runtime::Handle;

use super::columns::{Columns, Form, Wanted};
use super::extras::names_scores;
use super::table::{check_levels, checked, names, resolved};
use super::{Formulas, ModelledShapes, Options, SHAPE, names as names_attribute};
use crate::analysis::accumulate::ShapeSource;
use crate::analysis::estimate::{Estimate, alignment_stage};
use crate::analysis::inference::limits::MAX_VALUE;
use crate::analysis::models::anova::ExchangeRule;
use crate::analysis::models::design::{Design, Table, Values};
use crate::analysis::models::streamed::{StreamWork, StreamedShapes};
use crate::analysis::models::study::LOG_CENTROID_SIZE;
use crate::analysis::strata;
use crate::domain::attribute::{Attribute, Measure};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::study::ShapeModel;
use crate::service::app::progress::{JobContext, Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::KnownAttributes;
use crate::service::cohorts::source::StoredShapes;
use crate::service::cohorts::{caveats, measures};
use crate::service::inference::regressions::Missing;
use crate::service::inference::study::{Plan, Study, StudyKind, bounded, refused as refused_study};
use crate::service::statistics::Setup;
use crate::store::{Cursor, Revisions};
use crate::wire::fault::Fault;

/// Bytes of the description of a shape in memory.
const DESCRIPTION: usize = 600;
/// Copies of the numbers of a shape that a model in memory holds.
const COPIES: usize = 7;

/// Shapes that are read as a stream.
#[derive(Debug)]
pub(super) struct Large {
    /// Number of shapes with all values.
    pub(super) count: usize,
    /// Warnings that every result has.
    pub(super) caveats: Vec<String>,
    /// Warning about shapes of one subject.
    pub(super) dependence: Option<String>,
    /// Number of attributes that were read.
    attributes: usize,
}

/// The shapes of a plan, if they are to be read as a stream.
///
/// # Errors
/// What a stream does not answer, at its place; missing values; attributes that no shape has.
pub(super) async fn select(
    app: &App,
    cohort: &Cohort,
    plan: &Plan<Options>,
    formulas: &Formulas,
) -> Result<Option<ModelledShapes>, ServiceError> {
    let (options, revisions) = (&plan.options, Revisions::until(cohort.revision));
    let fits = |shapes: u64| fits(app, cohort, usize::try_from(shapes).unwrap_or(usize::MAX));
    if fits(cohort.shapes) {
        return Ok(None);
    }
    measures::complete_for(app, cohort, &options.filter).await?;
    let all = app.store.count(&cohort.id, revisions, &options.filter).await?;
    if fits(all) {
        return Ok(None);
    }
    if let Some(pointer) = only_in_memory(options, formulas) {
        let most = app.limits.shapes;
        let detail = format!(
            "expected none with {all} shapes, which are read as a stream, got one: choose at most {most} shapes"
        );
        return Err(ServiceError::invalid(pointer, detail));
    }
    let wanted = wanted(plan, formulas);
    if wanted.iter().any(|wanted| matches!(wanted.attribute, Attribute::Measure(_))) {
        measures::complete(app, cohort).await?;
    }
    let mut filter = options.filter.clone();
    if options.missing == Missing::Skip {
        check_known(app, cohort, all, &wanted).await?;
        let named = wanted.iter().filter(|wanted| wanted.form == Form::Any);
        filter.has.extend(named.map(|wanted| wanted.attribute.clone()));
    }
    let columns = Columns::read(app, cohort, &filter, &wanted).await?;
    check_complete(app, cohort, &columns, &wanted).await?;
    let table = table_of(options, formulas, &columns, &wanted)?;
    let caveats = caveats::of_selection(app, cohort, &filter, plan.mirror).await?;
    let large = Large {
        count: columns.shapes,
        caveats,
        dependence: position(&wanted, Form::Distinct).and_then(|column| columns.dependence(column)),
        attributes: wanted.len(),
    };
    let left_out = usize::try_from(all).unwrap_or(usize::MAX).saturating_sub(columns.shapes);
    let strata = strata_of(&columns, &wanted);
    Ok(Some(ModelledShapes::streamed(formulas.clone(), table, filter, strata, left_out, large)))
}

/// Whether so many shapes are read into memory.
fn fits(app: &App, cohort: &Cohort, shapes: usize) -> bool {
    let representation = &cohort.spec.representation;
    let numbers = representation.size().saturating_mul(representation.dimension());
    let each = numbers.saturating_mul(COPIES * size_of::<f64>()).saturating_add(DESCRIPTION);
    shapes <= app.limits.shapes && shapes.saturating_mul(each) <= app.limits.job_bytes
}

/// Place of what is asked that takes all shapes in memory.
fn only_in_memory(options: &Options, formulas: &Formulas) -> Option<&'static str> {
    let further = &options.further;
    let is_number = options.response == SHAPE
        || options.response == LOG_CENTROID_SIZE
        || (!names_scores(&options.response) && resolved(&options.response).is_some());
    let asked = [
        (!formulas.own.random.is_empty(), formulas.place),
        (!is_number, "/response"),
        (!options.blocks.is_empty(), "/blocks"),
        (!matches!(options.exchange, ExchangeRule::Auto | ExchangeRule::Free), "/exchange"),
        (!options.error_terms.is_empty(), "/error_terms"),
        (further.pairs.is_some(), "/pairs"),
        (further.disparity.is_some(), "/disparity"),
        (further.trajectories.is_some(), "/trajectories"),
        (further.bands.is_some(), "/bands"),
        (further.keep, "/keep"),
        (options.random.is_some(), "/random"),
        (options.manova.is_some(), "/manova"),
        (options.covariance.is_some(), "/covariance"),
        (options.compatibility.is_some(), "/compatibility"),
    ];
    asked.into_iter().find(|(is_asked, _)| *is_asked).map(|(_, pointer)| pointer)
}

/// Attributes of the formulas and the response, then those of the strata, then the subjects that should be told of.
fn wanted(plan: &Plan<Options>, formulas: &Formulas) -> Vec<Wanted> {
    let named = names(&plan.options, formulas).into_iter().filter_map(|(name, pointer)| {
        Some(Wanted { name: name.to_owned(), pointer, attribute: resolved(name)?, form: Form::Any })
    });
    let has_sizes = plan.options.response == LOG_CENTROID_SIZE
        || formulas.all().any(|(formula, _)| names_attribute(formula, LOG_CENTROID_SIZE));
    let sizes = has_sizes.then(|| Wanted {
        name: LOG_CENTROID_SIZE.into(),
        pointer: "/cohort".into(),
        attribute: Attribute::Measure(Measure::CentroidSize),
        form: Form::Any,
    });
    let strata = plan.strata.iter().filter_map(|name| {
        let attribute = Attribute::parse(name)?;
        Some(Wanted { name: name.clone(), pointer: "/strata".into(), attribute, form: Form::Texts })
    });
    let is_told =
        plan.strata.iter().any(|name| name == "subject") || names_attribute(&formulas.own, "subject");
    let subjects = (!is_told).then(|| Wanted {
        name: "subject".into(),
        pointer: String::new(),
        attribute: Attribute::Subject,
        form: Form::Distinct,
    });
    named.chain(sizes).chain(strata).chain(subjects).collect()
}

fn position(wanted: &[Wanted], form: Form) -> Option<usize> {
    wanted.iter().position(|wanted| wanted.form == form)
}

/// Refuses attributes that no shape has.
async fn check_known(app: &App, cohort: &Cohort, all: u64, wanted: &[Wanted]) -> Result<(), ServiceError> {
    let mut unknown = Vec::new();
    for wanted in wanted.iter().filter(|wanted| wanted.form == Form::Any) {
        let revisions = Revisions::until(cohort.revision);
        if !app.store.has_attribute(&cohort.id, revisions, &wanted.attribute).await? {
            unknown.push(wanted);
        }
    }
    refuse_unknown(app, cohort, all, &unknown).await
}

async fn refuse_unknown(
    app: &App,
    cohort: &Cohort,
    all: u64,
    unknown: &[&Wanted],
) -> Result<(), ServiceError> {
    if unknown.is_empty() {
        return Ok(());
    }
    let known = KnownAttributes::of(app, cohort).await?;
    let fault = |wanted: &&Wanted| {
        Fault::new(wanted.pointer.clone(), format!("none of the {all} shapes has {}: {known}", wanted.name))
    };
    ServiceError::unless_empty(unknown.iter().map(fault).collect())
}

/// Refuses shapes without a value, and names the first of them.
async fn check_complete(
    app: &App,
    cohort: &Cohort,
    columns: &Columns,
    wanted: &[Wanted],
) -> Result<(), ServiceError> {
    let all = columns.shapes;
    let of = |(column, wanted): (usize, &'_ Wanted)| {
        let (without, places) = columns.without(column);
        (wanted.form != Form::Distinct && without > 0).then(|| (without, places.to_vec()))
    };
    let incomplete: Vec<(&Wanted, usize, Vec<Cursor>)> = wanted
        .iter()
        .enumerate()
        .filter_map(|(column, wanted)| of((column, wanted)).map(|(n, places)| (wanted, n, places)))
        .collect();
    let unknown: Vec<&Wanted> =
        incomplete.iter().filter(|(_, without, _)| *without == all).map(|(wanted, ..)| *wanted).collect();
    refuse_unknown(app, cohort, all as u64, &unknown).await?;
    let mut faults = Vec::new();
    for (wanted, without, places) in incomplete {
        let first = app.store.shapes_at(&cohort.id, &places).await?;
        let first = first.into_iter().flatten().map(|shape| shape.attributes.external_id.unwrap_or(shape.id));
        let first = first.take(NAMED).collect::<Vec<_>>().join(", ");
        let detail = format!("{without} of {all} shapes have no {}: {first}", wanted.name);
        faults.push(Fault::new(wanted.pointer.clone(), detail));
    }
    ServiceError::unless_empty(faults)
}

/// Names of shapes in a fault.
const NAMED: usize = 5;

fn table_of(
    options: &Options,
    formulas: &Formulas,
    columns: &Columns,
    wanted: &[Wanted],
) -> Result<Table, ServiceError> {
    let (mut attributes, mut faults) = (BTreeMap::new(), Vec::new());
    for (column, wanted) in wanted.iter().enumerate().filter(|(_, wanted)| wanted.form == Form::Any) {
        let Some(mut values) = columns.values(column) else { continue };
        if let (LOG_CENTROID_SIZE, Values::Numbers(numbers)) = (wanted.name.as_str(), &mut values) {
            if numbers.iter().any(|size| !(*size <= MAX_VALUE)) {
                let detail = "the cohort has shapes too large to be measured";
                return Err(ServiceError::invalid("/cohort", detail));
            }
            numbers.iter_mut().for_each(|size| *size = size.ln());
        } else {
            faults.extend(checked(options, &wanted.name, &wanted.pointer, &values));
        }
        attributes.insert(wanted.name.clone(), values);
    }
    faults.extend(check_levels(options, formulas));
    ServiceError::unless_empty(faults)?;
    Ok(Table { attributes, levels: options.levels.clone() })
}

fn strata_of(columns: &Columns, wanted: &[Wanted]) -> Option<Vec<usize>> {
    let of = |(column, _): (usize, &Wanted)| match columns.values(column) {
        Some(Values::Levels { of_shapes, .. }) => Some(of_shapes),
        _ => None,
    };
    let is_stratum = |(_, wanted): &(usize, &Wanted)| wanted.form == Form::Texts;
    let labels: Vec<Vec<u32>> = wanted.iter().enumerate().filter(is_stratum).filter_map(of).collect();
    match labels.as_slice() {
        [] => None,
        [one] => Some(one.iter().map(|label| *label as usize).collect()),
        several => {
            let key = |k: usize| several.iter().map(|labels| labels[k]).collect::<Vec<u32>>();
            Some(strata::strata((0..columns.shapes).map(key)))
        }
    }
}

impl Large {
    /// Predicted cost.
    ///
    /// # Errors
    /// Too much memory.
    pub(super) fn estimate(
        &self,
        app: &App,
        plan: &Plan<Options>,
        setup: &Setup,
        design: &Design,
    ) -> Result<Estimate, ServiceError> {
        // Rows of factors alone are shared.
        let factors = design.factors().map(|(_, factor)| factor.levels.len());
        let are_factors = design.factors().count() == design.variables.len();
        let combinations = factors.fold(1_usize, usize::saturating_mul);
        let of_shapes = plan.options.response == SHAPE;
        let work = StreamWork {
            shapes: self.count,
            rows: if are_factors { combinations.min(self.count) } else { self.count },
            columns: design.columns.len(),
            attributes: self.attributes,
            length: if of_shapes { setup.metric.len() } else { 1 },
            terms: design.formula.terms.len(),
            permutations: plan.permutations,
            of_shapes,
        };
        bounded(app, Estimate::for_stream(setup.measured(), &work), "/permutations")
    }

    /// The model: the passes of the mean, and one more.
    ///
    /// # Errors
    /// Shapes that have no such model; memory that others hold; [`ServiceError::Cancelled`].
    pub(super) fn model(
        &self,
        study: &Study<ModelledShapes>,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Result<ShapeModel, ServiceError> {
        let (setup, sample, estimate) = (&study.setup, &study.sample, study.estimate());
        let stop = || context.is_cancelled();
        let stage = alignment_stage(setup.measured(), self.count);
        let passes = if study.plan.options.response == SHAPE { stage.passes - 2.0 } else { 1.0 };
        let last = (estimate.multiply_adds - stage.multiply_adds).max(1.0);
        let count = self.count as f64;
        let parts =
            vec![Part { work: stage.multiply_adds, count: passes * count }, Part { work: last, count }];
        let meter = Meter::new(context, parts, 0.0);
        meter.enter(0, "align");
        // Sums take the place of kept values as far as there is room; the whole was bounded when the request was planned.
        let _sums = app.cache.reserve(estimate.memory_bytes as usize);
        let filter: &ShapeFilter = &sample.filter[0];
        let source = StoredShapes::new(app, handle, &study.cohort, filter, 0, setup, &stop)?;
        if source.len() != self.count {
            return Err(ServiceError::Unavailable(
                "shapes were erased while they were read: try again".into(),
            ));
        }
        let kept = if setup.matching.searches() { source.kept(true, None)? } else { None };
        let shapes: &dyn ShapeSource = match &kept {
            Some(kept) => kept,
            None => &source,
        };
        let needs_mean = study.plan.options.response == SHAPE;
        let streamed = StreamedShapes::new(shapes, study.space(), needs_mean, &meter)
            .map_err(|error| source.named(refused_study(error, "/cohort")))?;
        meter.enter(1, ModelledShapes::PHASE);
        let found = sample.record(study, &sample.table, |question| streamed.model(question, &meter));
        found.map_err(|error| source.named(error))
    }
}
