//! The report card of a dictionary: at once if it is quick, otherwise by a job.
//!
//! It is computed from the shapes that the dictionary was learnt from, as they were at the revision of the cohort. Without
//! shapes that were erased since then there is none.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::answers::UsedDictionary;
use super::ready::{self, Ready};
use crate::analysis::AnalysisError;
use crate::analysis::dictionary::report::measurement::quantity_faults;
use crate::analysis::dictionary::report::{MAX_MODES, ReportCard, ReportOptions, TrainingShapes};
use crate::analysis::drawing::report::draw_report;
use crate::analysis::estimate::Estimate;
use crate::analysis::strata::strata;
use crate::domain::cohort::Cohort;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::progress::{JobContext, Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes;
use crate::service::cohorts::selection::Selection;
use crate::service::jobs::inline_or_job::PlannedTest;
use crate::wire::fault::Fault;

/// Maximum number of random shapes, and of resamples.
const MAX_DRAWS: usize = 10_000;
/// Maximum number of named measurements, and of wanted values of each.
const MAX_MEASUREMENTS: usize = 50;
const MAX_VALUES: usize = 20;

/// Checked request, as stored with a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Id of the version of the dictionary.
    dictionary: String,
    /// Id of its cohort.
    cohort: String,
    options: ReportOptions,
}

/// A report card with its origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DictionaryReport {
    /// The dictionary, at the version that was examined.
    dictionary: UsedDictionary,
    /// Id of the cohort that it was learnt from.
    cohort: String,
    /// Revision of the cohort.
    cohort_revision: u64,
    /// Unit of lengths; null if the cohort has none.
    length_unit: Option<String>,
    /// Number of random shapes.
    draws: usize,
    /// Number of resamples.
    resamples: usize,
    /// Seed of all random choices.
    seed: u64,
    /// Results.
    #[serde(flatten)]
    found: ReportCard,
}

/// A report that is ready to be computed.
#[derive(Debug)]
pub struct PlannedReport {
    plan: Plan,
    ready: Arc<Ready>,
    /// The cohort at the revision of the dictionary.
    cohort: Cohort,
    shapes: Vec<ShapeDescription>,
    /// Subject of each shape, numbered from 0.
    subjects: Vec<usize>,
    estimate: Estimate,
}

impl PlannedReport {
    /// Checks and plans the report of the dictionary `key`.
    ///
    /// # Errors
    /// All faults of the options; sparse codes; a cohort that was deleted; shapes that were erased since; too many shapes, too much memory.
    pub async fn prepare(app: &App, key: &str, options: ReportOptions) -> Result<Self, ServiceError> {
        ServiceError::unless_empty(option_faults(&options))?;
        let ready = ready::find(app, key).await?;
        Self::of(app, ready, options).await
    }

    async fn of(app: &App, ready: Arc<Ready>, options: ReportOptions) -> Result<Self, ServiceError> {
        if ready.dictionary().content.method.is_sparse() {
            let detail = "expected a dictionary of components: a sparse one has no modes";
            return Err(ServiceError::parameter("dictionary", detail));
        }
        ServiceError::unless_empty(measurement_faults(&ready, &options))?;
        let Training { cohort, shapes, subjects } = Training::of(app, &ready).await?;
        let content = &ready.dictionary().content;
        let plan = Plan { dictionary: ready.listed.id.clone(), cohort: cohort.id.clone(), options };
        let count = subjects.iter().max().map_or(0, |last| last + 1);
        let measured = ready.setup.measured();
        let estimate = Estimate::for_report(&ready.setup.space, measured, shapes.len(), count, &plan.options);
        let estimate = if content.robust.is_some() { estimate.robust(measured) } else { estimate };
        let (bytes, most) = (estimate.memory_bytes, app.limits.job_bytes as f64);
        if bytes > most {
            let detail = format!(
                "expected a report that takes at most {most:.1e} bytes of memory, got {bytes:.1e} for {} shapes",
                shapes.len()
            );
            return Err(ServiceError::parameter("dictionary", detail));
        }
        Ok(Self { plan, ready, cohort, shapes, subjects, estimate })
    }
}

/// The shapes that a dictionary was learnt from.
#[derive(Debug)]
pub(super) struct Training {
    /// The cohort at the revision of the dictionary.
    pub(super) cohort: Cohort,
    /// The shapes.
    pub(super) shapes: Vec<ShapeDescription>,
    /// Subject of each shape, numbered from 0.
    pub(super) subjects: Vec<usize>,
}

impl Training {
    /// Finds them.
    ///
    /// # Errors
    /// A cohort that was deleted; shapes that were erased since; more than one request may have.
    pub(super) async fn of(app: &App, ready: &Ready) -> Result<Self, ServiceError> {
        let provenance = &ready.listed.provenance;
        let cohort = app.store.find_cohort(&provenance.cohort).await?;
        let gone = || ServiceError::NotFound { kind: "cohort", key: provenance.cohort_name.clone() };
        let cohort = cohort.ok_or_else(gone)?.at(provenance.cohort_revision);
        app.touched.note("cohort_id", &cohort.id);
        let content = &ready.dictionary().content;
        let learnt_from = content.statistics.shapes + content.robust.map_or(0, |robust| robust.rejected);
        let most = app.limits.shapes;
        if learnt_from > most {
            let detail =
                format!("expected a dictionary learnt from at most {most} shapes, got {learnt_from}");
            return Err(ServiceError::parameter("dictionary", detail));
        }
        let shapes = attributes::describe(app, &cohort, &provenance.filter, "").await?;
        if shapes.len() != learnt_from {
            return Err(changed(&format!("{} of {learnt_from} are left", shapes.len())));
        }
        let subjects = numbered(&shapes);
        Ok(Self { cohort, shapes, subjects })
    }

    /// Reads them.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`] once `stop` returns true; a failure of the store.
    pub(super) fn read(
        &self,
        app: &App,
        handle: &Handle,
        ready: &Ready,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<TrainingShapes, ServiceError> {
        let filter = [ready.listed.provenance.filter.clone()];
        let selection = Selection { shapes: &self.shapes, filters: &filter };
        let length = ready.setup.metric.len();
        let (control_points, weights) = selection.read(app, handle, &self.cohort, length, stop)?;
        Ok(TrainingShapes { control_points, weights, subjects: self.subjects.clone() })
    }
}

/// Subject of each shape as a number; a shape without one is its own.
fn numbered(shapes: &[ShapeDescription]) -> Vec<usize> {
    let keys = shapes.iter().enumerate();
    strata(keys.map(|(k, shape)| shape.subject.as_deref().ok_or(k)))
}

fn changed(what: &str) -> ServiceError {
    let detail = format!(
        "the shapes that the dictionary was learnt from have changed since ({what}): learn a new version"
    );
    ServiceError::parameter("dictionary", detail)
}

fn option_faults(options: &ReportOptions) -> Vec<Fault> {
    let ReportOptions { modes, draws, resamples, measurements, .. } = options;
    let bounds = [
        ("/modes", *modes, 1, MAX_MODES),
        ("/draws", *draws, 1, MAX_DRAWS),
        ("/resamples", *resamples, 0, MAX_DRAWS),
    ];
    let outside = bounds.into_iter().filter(|(_, value, least, most)| !(*least..=*most).contains(value));
    let mut faults: Vec<Fault> = outside
        .map(|(field, value, least, most)| {
            Fault::new(field, format!("expected a number between {least} and {most}, got {value}"))
        })
        .collect();
    if measurements.len() > MAX_MEASUREMENTS {
        let detail = format!("expected at most {MAX_MEASUREMENTS} entries, got {}", measurements.len());
        faults.push(Fault::new("/measurements", detail));
    }
    for (i, measurement) in measurements.iter().enumerate().take(MAX_MEASUREMENTS) {
        if measurement.values.len() > MAX_VALUES {
            let detail = format!("expected at most {MAX_VALUES} values, got {}", measurement.values.len());
            faults.push(Fault::new(format!("/measurements/{i}/values"), detail));
        }
        if measurements[..i].iter().any(|other| other.name == measurement.name) {
            let detail = format!("'{}' is given twice", measurement.name);
            faults.push(Fault::new(format!("/measurements/{i}/name"), detail));
        }
    }
    faults
}

fn measurement_faults(ready: &Ready, options: &ReportOptions) -> Vec<Fault> {
    let of = |(i, quantity)| {
        let faults = quantity_faults(&ready.setup.space, quantity).into_iter();
        faults.map(move |fault| Fault::from(fault).below(&format!("/measurements/{i}/measure")))
    };
    options.measurements.iter().map(|measurement| &measurement.measure).enumerate().flat_map(of).collect()
}

impl PlannedTest for PlannedReport {
    type Plan = Plan;
    type Answer = DictionaryReport;
    const KIND: JobKind = JobKind::Report;

    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn from_plan(app: &App, handle: &Handle, plan: Plan) -> Result<Self, ServiceError> {
        let ready = handle.block_on(ready::find(app, &plan.dictionary))?;
        handle.block_on(Self::of(app, ready, plan.options))
    }

    fn seconds(&self) -> f64 {
        self.estimate.seconds
    }

    fn answer(
        &self,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Result<DictionaryReport, ServiceError> {
        let Self { plan, ready, cohort, shapes, subjects, .. } = self;
        let parts = vec![Part { work: self.estimate.multiply_adds, count: f64::MAX }];
        let meter = Meter::new(context, parts, 0.0);
        meter.enter(0, "report");
        let provenance = &ready.listed.provenance;
        let filter = [provenance.filter.clone()];
        let selection = Selection { shapes, filters: &filter };
        let stop = || context.is_cancelled();
        let length = ready.setup.metric.len();
        let (control_points, weights) = selection.read(app, handle, cohort, length, &stop)?;
        let training = TrainingShapes { control_points, weights, subjects: subjects.clone() };
        let found = ready.dictionary().report(&ready.setup.space, training, &plan.options, &meter);
        let mut found = found.map_err(|error| match error {
            AnalysisError::Parameter { field: "shapes", .. } => changed("their statistics differ"),
            AnalysisError::Parameter { field: "dictionary", detail } => {
                ServiceError::parameter("dictionary", detail)
            }
            other => selection.named(other.into(), &cohort.spec.name),
        })?;
        found.warnings.extend(provenance.warnings.clone());
        Ok(DictionaryReport {
            dictionary: UsedDictionary::new(ready),
            cohort: cohort.id.clone(),
            cohort_revision: cohort.revision,
            length_unit: ready.dictionary().content.length_unit.clone(),
            draws: plan.options.draws,
            resamples: plan.options.resamples,
            seed: plan.options.seed,
            found,
        })
    }

    fn draw(&self, answer: &DictionaryReport) -> Drawing {
        let listed = &self.ready.listed;
        let title = format!("report card of {} version {}", listed.name, listed.version);
        draw_report(&title, &answer.found, answer.length_unit.as_deref())
    }
}
