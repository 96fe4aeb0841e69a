//! Job that learns a dictionary from a stored cohort.
//!
//! A plan fixes everything that the result depends on, including the revision of the cohort: a job that runs again
//! after a crash learns the same dictionary, bit by bit, whatever was added in the meantime.

use std::sync::Arc;

use serde::Serialize;
use tokio::runtime::Handle;

use super::class_labels;
use super::plan::{NO_STATE, Plan, program};
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::{ShapeSource, ShapesInMemory};
use crate::analysis::classification::study::{WITHIN, train_classifier};
use crate::analysis::classifier_record::{ClassifierRecord, ClassifierSettings};
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::in_use::Dictionary;
use crate::analysis::dictionary::learn::{Learner, Learnt};
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::model::Coded;
use crate::analysis::dictionary::procedure;
use crate::analysis::estimate::{self, Stage, Trainings};
use crate::analysis::matching::Disagreement;
use crate::analysis::pca::UNCENTRED;
use crate::analysis::watch::{Phase, Watch};
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::dictionary::{LessCountedShape, NewDictionary, Provenance, Summary};
use crate::domain::id;
use crate::domain::job::Job;
use crate::service::app::progress::{JobContext, Meter, Part};
use crate::service::app::{App, ServiceError, now_ms};
use crate::service::cohorts::at_engine::{AtEngine, Passes, Purpose};
use crate::service::cohorts::caveats;
use crate::service::cohorts::placements::{KnownPlacements, SearchSettings, Which};
use crate::service::cohorts::source::{ShapesDigest, StoredShapes, Work};
use crate::service::jobs::Outcome;
use crate::service::shapes::directions::is_warning;
use crate::service::statistics::Setup;
use crate::store::Revisions;
use crate::wire::json;

/// Maximum size of stored sums from which learning can continue.
const STATE_BYTES: usize = 64 << 20;

/// Result of a job that learns a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct LearntDictionary {
    /// Id of the dictionary.
    pub dictionary: String,
    /// Its name.
    pub name: String,
    /// BLAKE3 digest of the learnt dictionary.
    pub digest: String,
}

/// Runs the job.
///
/// # Errors
/// The reason why the dictionary cannot be learnt; [`ServiceError::Cancelled`].
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let dictionary = learn(app, handle, job, &plan, context)?;
    let result = LearntDictionary {
        dictionary: dictionary.id.clone(),
        name: plan.name,
        digest: dictionary.digest.clone(),
    };
    let result = json::to_value(&result)
        .map_err(|error| ServiceError::Internal(format!("a result is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: Some(Box::new(dictionary)), output: None })
}

/// Maximum number of weights of control points that the provenance of a robust dictionary has.
const LISTED_NUMBERS: usize = 4096;

/// Learns the dictionary of a plan.
///
/// # Errors
/// As [`run`].
pub fn learn(
    app: &App,
    handle: &Handle,
    job: &Job,
    plan: &Plan,
    context: &JobContext,
) -> Result<NewDictionary, ServiceError> {
    let cohort = plan.cohort(app, handle)?;
    let previous = match &plan.continue_from {
        None => None,
        Some(id) => Some(Previous::read(app, handle, id)?),
    };
    let known = previous.as_ref().map_or_else(Vec::new, |previous| previous.warnings.clone());
    let setup = Setup::of(app, plan.settings(&cohort))?;
    let shapes = count(app, handle, plan)?;
    let meter = meter(plan, &setup, shapes, context);
    let passes = Passes {
        cohort: &cohort,
        filter: &plan.filter,
        transformation: &plan.transformation,
        alignment: plan.alignment,
        purpose: Purpose::Learning { job: &job.id, attempt: job.attempt, method: &plan.method },
    };
    let engine = AtEngine::of(app, passes, shapes);
    let task = Task { app, handle, job, plan, cohort: &cohort, setup: &setup, context, meter, engine };
    let Found { content, state, shapes_digest, less_counted, disagreement } = task.content(previous)?;
    // Shapes that were read once do not tell that their cohort was deleted since.
    plan.cohort(app, handle)?;
    let text = serde_json::to_vec(&content)
        .map_err(|error| ServiceError::Internal(format!("a dictionary is not JSON: {error}")))?;
    let provenance = Provenance {
        cohort: cohort.id.clone(),
        cohort_name: cohort.spec.name.clone(),
        cohort_revision: plan.revision,
        filter: plan.filter.clone(),
        shapes_digest,
        continued_from: plan.continue_from.clone(),
        program: program(),
        less_counted,
        warnings: task.warnings(known, disagreement)?,
    };
    Ok(NewDictionary {
        id: id::new_id(id::DICTIONARY),
        name: plan.name.clone(),
        summary: Summary::of(&content),
        digest: blake3::hash(&text).to_hex().to_string(),
        content: text,
        state: Some(state).filter(|state| state.len() <= STATE_BYTES),
        provenance,
        created_at_ms: now_ms(),
    })
}

/// Number of shapes of a plan.
fn count(app: &App, handle: &Handle, plan: &Plan) -> Result<usize, ServiceError> {
    let revisions = Revisions { after: 0, until: plan.revision };
    let shapes = handle.block_on(app.store.count(&plan.cohort, revisions, &plan.filter))?;
    Ok(usize::try_from(shapes).unwrap_or(usize::MAX))
}

/// Progress of a plan over `shapes` shapes, by the predicted work of its phases.
fn meter(plan: &Plan, setup: &Setup, shapes: usize, context: &JobContext) -> Meter {
    let known = plan.continue_from.is_some();
    let trainings = Trainings {
        held_out: if known { 0 } else { plan.held_out_trainings(setup, shapes) },
        validation: plan.classifier.as_ref().map_or(0, |settings| settings.trainings(WITHIN)),
    };
    let mut stages = estimate::stages(setup.measured(), &plan.method, shapes, known, trainings);
    if plan.robust
        && let Some(mean) = stages.first_mut()
    {
        *mean = mean.robust(setup.measured(), shapes);
    }
    let part = |stage: &Stage| Part { work: stage.multiply_adds, count: stage.passes * shapes as f64 };
    let parts: Vec<Part> = stages.iter().map(part).collect();
    // The digest of the shapes reads them once more, as the certificate does.
    let rest = estimate::READING * shapes as f64 * setup.metric.len() as f64;
    Meter::new(context, parts, rest)
}

/// The version from which learning continues.
struct Previous {
    content: Content,
    revision: u64,
    state: Vec<u8>,
    warnings: Vec<String>,
}

impl Previous {
    fn read(app: &App, handle: &Handle, id: &str) -> Result<Self, ServiceError> {
        let gone = || ServiceError::NotFound { kind: "dictionary", key: id.into() };
        let dictionary = handle.block_on(app.store.read_dictionary(id))?.ok_or_else(gone)?;
        let state = handle.block_on(app.store.read_dictionary_state(id))?;
        let state = state.ok_or_else(|| ServiceError::invalid("/continue_from", NO_STATE))?;
        let Provenance { cohort_revision, warnings, .. } = dictionary.provenance;
        Ok(Self { content: dictionary.content, revision: cohort_revision, state, warnings })
    }
}

/// Result of a run of a plan.
struct Found {
    content: Content,
    /// The sums from which learning can continue.
    state: Vec<u8>,
    /// Digest of the shapes.
    shapes_digest: String,
    /// The shapes that count less.
    less_counted: Vec<LessCountedShape>,
    disagreement: Option<Disagreement>,
}

/// One run of a plan.
struct Task<'a> {
    app: &'a App,
    handle: &'a Handle,
    job: &'a Job,
    plan: &'a Plan,
    cohort: &'a Cohort,
    setup: &'a Setup,
    context: &'a JobContext,
    meter: Meter,
    /// Where passes can be computed besides this process.
    engine: Option<AtEngine<'a>>,
}

/// Place of a phase among the parts of [`estimate::stages`].
fn part_of(phase: Phase) -> usize {
    match phase {
        Phase::Mean => 0,
        Phase::Align | Phase::Learn => 1,
        Phase::Certify => 2,
        Phase::HoldOut => 3,
        Phase::Validate => 4,
    }
}

impl Watch for Task<'_> {
    fn stop(&self) -> bool {
        self.context.is_cancelled()
    }

    fn worked(&self, count: usize) {
        self.meter.worked(count);
    }

    fn epoch(&self, _: usize, objective: f64) {
        self.meter.objective(objective);
    }

    fn phase(&self, phase: Phase, fraction: f64) {
        self.meter.enter(part_of(phase), phase.name());
        self.meter.reached(fraction);
    }

    fn not_held_out(&self, error: AnalysisError) {
        let error = ServiceError::from(error);
        tracing::warn!(job = self.job.id, %error, "no shapes could be held out");
    }
}

impl Task<'_> {
    /// The learnt content, and findings on the way.
    fn content(&self, previous: Option<Previous>) -> Result<Found, ServiceError> {
        let stop = || self.context.is_cancelled();
        let known = self.known_placements();
        let known = known.as_ref().map(|(known, which)| (&**known, *which));
        let stored = self.shapes(0, &stop)?.starting_from(known);
        let mut digest = ShapesDigest::default();
        let kept = match &self.engine {
            None => stored.kept(self.setup.matching.searches() || self.plan.robust, Some(&mut digest))?,
            Some(_) => None,
        };
        let shapes: &dyn ShapeSource = match &kept {
            Some(kept) => kept,
            None => &stored,
        };
        let recipe = self.plan.recipe(self.cohort);
        let help = |dictionary: &Dictionary| Ok(self.coded(&stored, dictionary)?);
        let learner = Learner { recipe: &recipe, measured: self.setup.measured(), watch: self, help: &help };
        let learn = || match &previous {
            None => Ok(learner.learn(shapes)?),
            Some(Previous { content, revision, state, .. }) => {
                let new = self.shapes(*revision, &stop)?;
                let previous = procedure::Previous { content, state };
                Ok::<_, ServiceError>(learner.continue_from(previous, shapes, &new)?)
            }
        };
        let learnt = match learn() {
            Err(_) if self.engine.as_ref().is_some_and(AtEngine::has_failed_to_code) => learn(),
            learnt => learnt,
        };
        let Learnt { mut dictionary, state, less_counted, disagreement } = learnt?;
        if let Some(settings) = &self.plan.classifier {
            dictionary.content.classifier = Some(self.classifier(shapes, settings, &dictionary)?);
        }
        let less_counted = stored.less_counted(less_counted, LISTED_NUMBERS)?;
        if kept.is_none() {
            let add = &mut |control_points: &[f64], weights: &[f64]| {
                digest.add(control_points, weights);
                Ok(true)
            };
            stored.scan(add)?;
        }
        let content = dictionary.content;
        Ok(Found { content, state, shapes_digest: digest.finish(), less_counted, disagreement })
    }

    /// Warnings about the shapes; `known` are those of the continued version about their parameters.
    fn warnings(
        &self,
        known: Vec<String>,
        disagreement: Option<Disagreement>,
    ) -> Result<Vec<String>, ServiceError> {
        let Plan { filter, mirror, method, .. } = self.plan;
        let directions = caveats::of_directions(self.app, self.cohort, filter, *mirror);
        let directions = self.handle.block_on(directions)?;
        let known = known.into_iter().filter(|text| !is_warning(text) && text != UNCENTRED);
        let uncentred = matches!(method, Method::FunctionalPca { centre: false, .. });
        let parameters = caveats::of_parameters(disagreement);
        let found = directions.into_iter().chain(known).chain(parameters);
        Ok(found.chain(uncentred.then(|| UNCENTRED.to_owned())).collect())
    }

    /// Placements that a search for the same mean has found, of which the dictionary does not depend: those of all shapes at the same
    /// revision, unless that search began with the placements of an earlier one, or else those of the leading shapes. A robust mean
    /// begins with the search of the plain one, which its own placements do not replace.
    fn known_placements(&self) -> Option<(Arc<KnownPlacements>, Which)> {
        let Plan { transformation, alignment, mirror, filter, revision, robust, .. } = self.plan;
        let (transformation, filter) = (transformation.clone(), filter.clone());
        let (alignment, mirror, robust) = (*alignment, *mirror, *robust);
        let CohortSpec { correspondence, direction, .. } = self.cohort.spec;
        let settings =
            SearchSettings { transformation, alignment, correspondence, direction, mirror, filter, robust };
        let known = KnownPlacements::find(self.app, &self.cohort.id, &settings)?;
        let is_same = known.revision == *revision && known.started_from.is_none() && !robust;
        Some((known, if is_same { Which::All } else { Which::Leading }))
    }

    /// Encodes all shapes on the engine, if there is one.
    fn coded(
        &self,
        shapes: &StoredShapes<'_>,
        dictionary: &Dictionary,
    ) -> Result<Option<Coded>, ServiceError> {
        let mut coded = Coded::default();
        let work = || Work::Codes(Box::new(dictionary.content.clone()));
        let spread = shapes.spread_work(&work, &mut |bytes| coded.append(bytes))?;
        Ok(spread.then_some(coded))
    }

    /// Validates and trains the classifier.
    fn classifier(
        &self,
        shapes: &dyn ShapeSource,
        settings: &ClassifierSettings,
        dictionary: &Dictionary,
    ) -> Result<ClassifierRecord, ServiceError> {
        self.context.check()?;
        self.phase(Phase::Validate, 0.0);
        let read = class_labels::read(self.app, self.cohort, &self.plan.filter, &settings.attribute);
        let labels = self.handle.block_on(read)?;
        let kept = ShapesInMemory::of(shapes)?;
        let record = train_classifier(dictionary, &kept, &labels, settings, self);
        Ok(record.map_err(|error| shapes.located(error))?)
    }

    /// Shapes of the cohort added after the revision `since`.
    fn shapes<'a>(
        &'a self,
        since: u64,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<StoredShapes<'a>, ServiceError> {
        let Self { app, handle, plan, cohort, setup, .. } = *self;
        let shapes = StoredShapes::new(app, handle, cohort, &plan.filter, since, setup, stop)?;
        let shapes = match &self.engine {
            Some(engine) => shapes.distributed_by(engine),
            None => shapes,
        };
        Ok(shapes.counted_by(self))
    }
}
