//! A study of the shapes of a cohort: at once if it is quick, otherwise as a job.
//!
//! A plan fixes everything that the result depends on, including the revision of the cohort. The differences between kinds of
//! studies are a [`StudyKind`].

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::sample::cohort_at;
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::estimate::{Estimate, TestWork, alignment_stage};
use crate::analysis::factors::Estimator;
use crate::analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use crate::analysis::inference::error::StudyError;
use crate::analysis::inference::permutation::Draws;
use crate::analysis::tangent::LinearAlignment;
use crate::analysis::transformation::Transformation;
use crate::analysis::watch::Watch;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::job::{JobKind, JobOutput};
use crate::domain::study::StudyHeader;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::progress::{JobContext, Meter, Part};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::caveats::of_descriptions;
use crate::service::cohorts::directed;
use crate::service::cohorts::selection::Selection;
use crate::service::cost::requests;
use crate::service::jobs::inline_or_job::{AT_ONCE_SECONDS, PlannedTest};
use crate::service::statistics::{Settings, Setup};
use crate::wire::fault::Fault;

/// Maximum number of permutations of a test.
const MAX_PERMUTATIONS: usize = 100_000;

/// Predicted time of the attributes of a shape in a design.
const DESCRIBED: f64 = 1e-5;

/// Request for a study with options `O`.
#[derive(Debug, Clone)]
pub struct StudyRequest<O> {
    /// Id or name of the cohort.
    pub cohort: String,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits. Default: [`LinearAlignment::of_test`].
    pub alignment: Option<Alignment>,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean. Default: [`LinearAlignment::of_test`].
    pub tangent: Option<bool>,
    /// Whether mirror images may be matched. Default: the rule of the cohort.
    pub mirror: Option<Mirror>,
    /// Number of permutations.
    pub permutations: usize,
    /// Seed of random permutations.
    pub seed: u64,
    /// Attributes that define strata: labels or residuals are exchanged only between shapes with equal values.
    pub strata: Vec<String>,
    /// Options of this kind of study.
    pub options: O,
}

impl<O> StudyRequest<O> {
    /// Fault of the number of permutations.
    pub(super) fn permutations_fault(&self) -> Option<Fault> {
        (self.permutations > MAX_PERMUTATIONS).then(|| {
            let detail =
                format!("expected a number between 0 and {MAX_PERMUTATIONS}, got {}", self.permutations);
            Fault::new("/permutations", detail)
        })
    }

    /// Faults of the names of strata.
    pub(super) fn strata_faults(&self) -> impl Iterator<Item = Fault> {
        let unknown = self.strata.iter().filter(|name| Attribute::parse(name).is_none());
        unknown.map(|name| Fault::new("/strata", format!("{}, got '{name}'", Attribute::WANTED)))
    }
}

/// Checked parameters of a study, with the revision of the cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan<O> {
    pub(super) cohort: String,
    pub(super) revision: u64,
    pub(super) transformation: Transformation,
    pub(super) alignment: Alignment,
    /// Absent in plans of earlier versions, which moved partial Procrustes fits only.
    #[serde(default)]
    pub(super) tangent: Option<bool>,
    pub(super) mirror: Mirror,
    pub(super) permutations: usize,
    pub(super) seed: u64,
    pub(super) strata: Vec<String>,
    #[serde(flatten)]
    pub(super) options: O,
}

impl<O> Plan<O> {
    fn new(request: StudyRequest<O>, cohort: &Cohort) -> Result<Self, ServiceError> {
        let LinearAlignment { alignment, tangent } = LinearAlignment::of_test(
            &request.transformation,
            cohort.spec.representation.dimension(),
            request.alignment,
            request.tangent,
        )
        .map_err(|error| ServiceError::invalid("/tangent", error.to_string()))?;
        Ok(Self {
            cohort: cohort.id.clone(),
            revision: cohort.revision,
            transformation: request.transformation,
            alignment,
            tangent: Some(tangent),
            mirror: request.mirror.unwrap_or(cohort.spec.mirror),
            permutations: request.permutations,
            seed: request.seed,
            strata: request.strata,
            options: request.options,
        })
    }

    pub(super) fn is_tangent(&self) -> bool {
        self.tangent.unwrap_or(self.alignment == Alignment::PartialProcrustes)
    }

    /// Settings for aligning the shapes of `cohort`.
    pub(super) fn settings(&self, cohort: &Cohort) -> Settings {
        Settings {
            representation: cohort.spec.representation.clone(),
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: self.mirror,
            transformation: self.transformation.clone(),
            alignment: self.alignment,
            frame: frame_for(&self.transformation),
            estimator: Estimator::Plain,
        }
    }

    /// Permutations within these strata.
    pub(super) fn draws<'a>(&self, strata: &'a [usize]) -> Draws<'a> {
        Draws { strata, seed: self.seed, permutations: self.permutations }
    }

    /// Header of the result.
    pub(super) fn header(&self, shapes: usize, left_out: usize) -> StudyHeader {
        StudyHeader {
            transformation: self.transformation.clone(),
            alignment: self.alignment,
            tangent: Some(self.is_tangent()),
            mirror: self.mirror,
            seed: self.seed,
            strata: self.strata.clone(),
            shapes,
            left_out,
        }
    }
}

/// A kind of study: the shapes that it selects, and its computation on them.
pub trait StudyKind: Sized + Send + Sync + 'static {
    /// Options beyond those of every study, as requested and as stored with a job.
    type Options: Serialize + DeserializeOwned + Send + Sync;
    /// Result.
    type Record: Serialize + DeserializeOwned + Send;
    /// Kind of the job that computes it.
    const KIND: JobKind;
    /// Name of the phase after the alignment, for progress.
    const PHASE: &'static str;

    /// Faults of a request that do not depend on the cohort.
    fn faults(app: &App, request: &StudyRequest<Self::Options>) -> Vec<Fault>;

    /// Sets options that depend on the cohort.
    fn complete(options: &mut Self::Options, cohort: &Cohort);

    /// Fixes the inputs of the result beside the cohort. Default: nothing.
    ///
    /// # Errors
    /// Faults of objects that the options name.
    fn fix(
        _app: &App,
        _options: &mut Self::Options,
    ) -> impl Future<Output = Result<(), ServiceError>> + Send {
        std::future::ready(Ok(()))
    }

    /// Selects the shapes.
    ///
    /// # Errors
    /// Faults of groups, attributes and strata.
    fn select(
        app: &App,
        cohort: &Cohort,
        plan: &Plan<Self::Options>,
    ) -> impl Future<Output = Result<Self, ServiceError>> + Send;

    /// The selected shapes.
    fn selection(&self) -> Selection<'_>;

    /// Predicts the cost.
    ///
    /// # Errors
    /// Too much memory; options that do not fit the space of the shapes.
    fn estimate(
        &self,
        app: &App,
        plan: &Plan<Self::Options>,
        setup: &Setup,
    ) -> Result<Estimate, ServiceError>;

    /// Control points and weights of the shapes that are aligned, made of those of the selection. Default: as they are.
    fn prepared(_: &Study<Self>, control_points: Vec<f64>, weights: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
        (control_points, weights)
    }

    /// Computes the result of the aligned shapes.
    ///
    /// # Errors
    /// Shapes that have no such result; [`ServiceError::Cancelled`].
    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<Self::Record, ServiceError>;

    /// The result of shapes that are not read into memory, if the sample is one of them. Default: none.
    fn streamed(
        _study: &Study<Self>,
        _app: &App,
        _handle: &Handle,
        _context: &JobContext,
    ) -> Option<Result<Self::Record, ServiceError>> {
        None
    }

    /// Whether something is kept beside the result: a job then, however quick. Default: no.
    fn is_kept(_: &Self::Options) -> bool {
        false
    }

    /// What is kept beside the result of a job. Default: nothing.
    ///
    /// # Errors
    /// What cannot be stored (a bug).
    fn kept(_record: &mut Self::Record, _job: &str) -> Result<Option<JobOutput>, ServiceError> {
        Ok(None)
    }

    /// Drawing of a result.
    fn draw(study: &Study<Self>, record: &Self::Record) -> Drawing;
}

/// A study that is ready to run.
#[derive(Debug)]
pub struct Study<K: StudyKind> {
    pub(super) plan: Plan<K::Options>,
    pub(super) cohort: Cohort,
    pub(super) setup: Setup,
    pub(super) sample: K,
    estimate: Estimate,
}

impl<K: StudyKind> Study<K> {
    /// Checks and plans a study.
    ///
    /// # Errors
    /// All faults of the request; a cohort that does not exist.
    pub async fn prepare(app: &App, mut request: StudyRequest<K::Options>) -> Result<Self, ServiceError> {
        ServiceError::unless_empty(K::faults(app, &request))?;
        let cohort =
            catalogue::find(app, &request.cohort).await.map_err(|error| error.named_at("/cohort"))?;
        K::complete(&mut request.options, &cohort);
        K::fix(app, &mut request.options).await?;
        let plan = Plan::new(request, &cohort)?;
        Self::for_cohort(app, cohort, plan).await
    }

    async fn for_cohort(app: &App, cohort: Cohort, plan: Plan<K::Options>) -> Result<Self, ServiceError> {
        directed::complete(app, &cohort).await?;
        let sample = K::select(app, &cohort, &plan).await?;
        let (task_app, settings) = (app.clone(), plan.settings(&cohort));
        let described = Work::from_seconds(sample.selection().shapes.len() as f64 * DESCRIBED);
        let work = requests::space(&cohort.spec.representation, &app.limits) + described;
        let prepare = move || {
            let setup = Setup::of(&task_app, settings)?;
            let estimate = sample.estimate(&task_app, &plan, &setup)?;
            Ok((plan, sample, setup, estimate))
        };
        let (plan, sample, setup, estimate) = app.pool.weighing(work).run(prepare).await?;
        Ok(Self { plan, cohort, setup, sample, estimate })
    }

    /// Progress of the alignment, which counts passes, and of the tests, which report their fraction.
    fn meter(&self, context: &JobContext) -> Meter {
        let shapes = usize::try_from(self.estimate.shapes).unwrap_or(usize::MAX);
        let alignment = alignment_stage(self.setup.measured(), shapes);
        let count = alignment.passes * shapes as f64;
        let rest = (self.estimate.multiply_adds - alignment.multiply_adds).max(0.0);
        let parts = vec![Part { work: alignment.multiply_adds, count }, Part { work: rest, count: f64::MAX }];
        Meter::new(context, parts, 0.0)
    }

    /// Warnings about the shapes in the result.
    pub(super) fn caveats(&self) -> Vec<String> {
        of_descriptions(&self.cohort, self.sample.selection().shapes, self.plan.mirror)
    }

    /// Predicted cost.
    pub(super) fn estimate(&self) -> Estimate {
        self.estimate
    }

    /// The space of the study.
    pub(super) fn space(&self) -> StudySpace<'_> {
        let Setup { space, metric, method, frame, matching, .. } = &self.setup;
        StudySpace { space, metric, method, tangent: self.plan.is_tangent(), frame: *frame, matching }
    }
}

impl<K: StudyKind> PlannedTest for Study<K> {
    type Plan = Plan<K::Options>;
    type Answer = K::Record;
    const KIND: JobKind = K::KIND;

    fn plan(&self) -> &Self::Plan {
        &self.plan
    }

    fn from_plan(app: &App, handle: &Handle, plan: Self::Plan) -> Result<Self, ServiceError> {
        let cohort = cohort_at(app, handle, &plan.cohort, plan.revision)?;
        handle.block_on(Self::for_cohort(app, cohort, plan))
    }

    fn seconds(&self) -> f64 {
        self.estimate.seconds
    }

    fn answer(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<K::Record, ServiceError> {
        if let Some(result) = K::streamed(self, app, handle, context) {
            return result;
        }
        let stop = || context.is_cancelled();
        let meter = self.meter(context);
        meter.enter(0, "align");
        let (selection, space) = (self.sample.selection(), self.space());
        let (control_points, weights) =
            selection.read(app, handle, &self.cohort, space.metric.len(), &stop)?;
        let (control_points, weights) = K::prepared(self, control_points, weights);
        let aligned = AlignedShapes::new(space, control_points, weights, &meter);
        let aligned =
            aligned.map_err(|error| selection.named(refused(error, "/cohort"), &self.cohort.spec.name))?;
        meter.enter(1, K::PHASE);
        K::result(self, &aligned, &meter)
    }

    fn is_quick(&self) -> bool {
        self.seconds() <= AT_ONCE_SECONDS && !K::is_kept(&self.plan.options)
    }

    fn kept(answer: &mut K::Record, job: &str) -> Result<Option<JobOutput>, ServiceError> {
        K::kept(answer, job)
    }

    fn draw(&self, answer: &K::Record) -> Drawing {
        self.setup.in_scale(K::draw(self, answer), self.cohort.spec.shown_unit())
    }
}

/// Predicted cost of `work`, provided that it fits in memory; otherwise a fault at `pointer`.
///
/// # Errors
/// Too much memory.
pub(super) fn within_memory(
    app: &App,
    setup: &Setup,
    work: &TestWork,
    pointer: &str,
) -> Result<Estimate, ServiceError> {
    bounded(app, Estimate::for_tests(setup.measured(), work), pointer)
}

/// The `estimate`, provided that it fits in memory; otherwise a fault at `pointer`.
///
/// # Errors
/// Too much memory.
pub(super) fn bounded(app: &App, estimate: Estimate, pointer: &str) -> Result<Estimate, ServiceError> {
    let most = app.limits.job_bytes as f64;
    if estimate.memory_bytes <= most {
        return Ok(estimate);
    }
    let detail = format!(
        "expected a job that takes at most {most:.1e} bytes of memory, got {:.1e} for {} shapes: choose \
         fewer shapes",
        estimate.memory_bytes, estimate.shapes
    );
    Err(ServiceError::invalid(pointer, detail))
}

/// Refusal for an error of a study; `pointer` is the place of errors that do not name it themselves.
pub(super) fn refused(error: StudyError, pointer: &str) -> ServiceError {
    if let StudyError::Analysis(error) = error {
        return error.into();
    }
    let pointer = match &error {
        StudyError::CollinearCovariate { covariate } => format!("/covariates/{covariate}"),
        StudyError::CollinearAttribute | StudyError::SmallDeviation => "/attribute".into(),
        StudyError::Weights { .. } => "/cohort".into(),
        StudyError::Unmeasured => {
            return ServiceError::invalid("/cohort", "the cohort has shapes too large to be measured");
        }
        StudyError::LargeValues
        | StudyError::ManyLevels { .. }
        | StudyError::FewShapes { .. }
        | StudyError::FewMembers { .. }
        | StudyError::Analysis(_) => pointer.to_owned(),
    };
    ServiceError::invalid(pointer, error.to_string())
}
