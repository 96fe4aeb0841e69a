//! Job that learns a dictionary from a stored cohort.
//!
//! A plan fixes everything that the result depends on, including the revision of the cohort: a job that runs again
//! after a crash learns the same dictionary, bit by bit, whatever was added in the meantime.

use std::sync::Arc;

use serde::Serialize;
use tokio::runtime::Handle;

use super::class_labels;
use super::distributed::Spreading;
use super::plan::{NO_STATE, Plan, program};
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::classification::record::{ClassifierRecord, ClassifierSettings};
use crate::analysis::classification::study::{WITHIN, train_classifier};
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::held_out;
use crate::analysis::dictionary::in_use::Dictionary;
use crate::analysis::dictionary::learn::{Learner, Learnt};
use crate::analysis::dictionary::model::Coded;
use crate::analysis::dictionary::procedure;
use crate::analysis::watch::{Phase, Watch};
use crate::domain::cohort::Cohort;
use crate::domain::dictionary::{NewDictionary, Provenance, Summary};
use crate::domain::id;
use crate::domain::job::Job;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, now_ms};
use crate::service::cohorts::placements::{KnownPlacements, SearchSettings};
use crate::service::cohorts::source::{StoredShapes, Work};
use crate::service::jobs::Outcome;
use crate::service::statistics::Setup;

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
    let plan: Plan = serde_json::from_value(job.parameters.clone())
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let dictionary = learn(app, handle, job, &plan, context)?;
    let result = LearntDictionary {
        dictionary: dictionary.id.clone(),
        name: plan.name,
        digest: dictionary.digest.clone(),
    };
    let result = serde_json::to_value(result)
        .map_err(|error| ServiceError::Internal(format!("a result is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: Some(Box::new(dictionary)), output: None })
}

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
    let setup = Setup::of(app, plan.settings(&cohort))?;
    let others = Spreading { app, handle, job, plan };
    let task = Task { app, handle, plan, cohort: &cohort, setup: &setup, context, others };
    let (content, state) = task.content(previous)?;
    let text = serde_json::to_vec(&content)
        .map_err(|error| ServiceError::Internal(format!("a dictionary is not JSON: {error}")))?;
    let provenance = Provenance {
        cohort: cohort.id.clone(),
        cohort_name: cohort.spec.name.clone(),
        cohort_revision: plan.revision,
        filter: plan.filter.clone(),
        shapes_digest: task.shapes_digest()?,
        continued_from: plan.continue_from.clone(),
        program: program(),
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

/// The version from which learning continues.
struct Previous {
    content: Content,
    revision: u64,
    state: Vec<u8>,
}

impl Previous {
    fn read(app: &App, handle: &Handle, id: &str) -> Result<Self, ServiceError> {
        let gone = || ServiceError::NotFound { kind: "dictionary", key: id.into() };
        let dictionary = handle.block_on(app.store.read_dictionary(id))?.ok_or_else(gone)?;
        let state = handle.block_on(app.store.read_dictionary_state(id))?;
        let state = state.ok_or_else(|| ServiceError::invalid("/continue_from", NO_STATE))?;
        Ok(Self { content: dictionary.content, revision: dictionary.provenance.cohort_revision, state })
    }
}

/// One run of a plan.
struct Task<'a> {
    app: &'a App,
    handle: &'a Handle,
    plan: &'a Plan,
    cohort: &'a Cohort,
    setup: &'a Setup,
    context: &'a JobContext,
    /// Workers to which parts of a pass can be distributed.
    others: Spreading<'a>,
}

/// Fraction of the progress of learning at which a phase begins.
fn beginning(phase: Phase) -> f64 {
    match phase {
        Phase::Mean => 0.0,
        Phase::Align => 0.1,
        Phase::Learn => 0.2,
        Phase::Certify => 0.9,
        Phase::HoldOut => 0.92,
        Phase::Validate => 0.95,
    }
}

impl Watch for Task<'_> {
    fn stop(&self) -> bool {
        self.context.is_cancelled()
    }

    fn epoch(&self, epochs: usize, objective: f64) {
        let (start, end) = (beginning(Phase::Learn), beginning(Phase::Certify));
        let most = self.plan.method.max_epochs();
        let fraction = start + (end - start) * (epochs as f64 / most as f64).min(1.0);
        self.context.report(Phase::Learn.name(), self.share() * fraction, Some(objective));
    }

    fn phase(&self, phase: Phase, fraction: f64) {
        let validation = self.validation_start();
        let progress = match phase {
            Phase::HoldOut if fraction > 0.0 => self.share() + (validation - self.share()) * fraction,
            Phase::Validate if fraction > 0.0 => validation + (1.0 - validation) * fraction,
            _ => self.share() * beginning(phase),
        };
        self.context.report(phase.name(), progress, None);
    }

    fn not_held_out(&self, error: &AnalysisError) {
        let error = ServiceError::from(error.clone());
        tracing::warn!(job = self.others.job.id, %error, "no shapes could be held out");
    }
}

impl Task<'_> {
    /// Fraction of the progress for learning; the remainder is holding out shapes, then validation.
    fn share(&self) -> f64 {
        let validation = self.plan.classifier.as_ref().map_or(0, |settings| settings.trainings(WITHIN));
        1.0 / (1 + self.held_out_trainings() + validation) as f64
    }

    /// Progress at which validation begins.
    fn validation_start(&self) -> f64 {
        self.share() * (1 + self.held_out_trainings()) as f64
    }

    fn held_out_trainings(&self) -> usize {
        match self.plan.continue_from {
            Some(_) => 0,
            None => held_out::usual_trainings(&self.plan.method),
        }
    }

    /// The learnt content, and the sums from which learning can continue.
    fn content(&self, previous: Option<Previous>) -> Result<(Content, Vec<u8>), ServiceError> {
        let stop = || self.context.is_cancelled();
        let known = self.known_placements();
        let shapes = self.shapes(0, &stop)?.starting_from(known.as_deref());
        let recipe = self.plan.recipe(self.cohort);
        let help = |shapes: &StoredShapes<'_>, dictionary: &Dictionary| self.coded(shapes, dictionary);
        let learner = Learner { recipe: &recipe, measured: self.setup.measured(), watch: self, help: &help };
        let Learnt { mut dictionary, state } = match &previous {
            None => learner.learn(&shapes)?,
            Some(Previous { content, revision, state }) => {
                let new = self.shapes(*revision, &stop)?;
                learner.continue_from(procedure::Previous { content, state }, &shapes, &new)?
            }
        };
        if let Some(settings) = &self.plan.classifier {
            dictionary.content.classifier = Some(self.classifier(&shapes, settings, &dictionary)?);
        }
        Ok((dictionary.content, state))
    }

    /// Placements that a search for the same mean has found. A search that began with those of an earlier revision does not
    /// count: the dictionary would depend on it.
    fn known_placements(&self) -> Option<Arc<KnownPlacements>> {
        let Plan { transformation, alignment, mirror, filter, revision, .. } = self.plan;
        let (transformation, filter) = (transformation.clone(), filter.clone());
        let settings = SearchSettings { transformation, alignment: *alignment, mirror: *mirror, filter };
        let known = KnownPlacements::find(self.app, &self.cohort.id, &settings);
        known.filter(|known| known.revision == *revision && known.started_from.is_none())
    }

    /// Encodes all shapes with the help of other workers, if that pays.
    fn coded(
        &self,
        shapes: &StoredShapes<'_>,
        dictionary: &Dictionary,
    ) -> Result<Option<Coded>, ServiceError> {
        let make = |part: &StoredShapes<'_>| Ok(dictionary.coded(part, self)?.to_bytes());
        let mut coded = Coded::default();
        let work = || Work::Codes(Box::new(dictionary.content.clone()));
        let spread = shapes.spread_work(&work, &make, &mut |bytes| coded.append(bytes))?;
        Ok(spread.then_some(coded))
    }

    /// Validates and trains the classifier.
    fn classifier(
        &self,
        shapes: &StoredShapes<'_>,
        settings: &ClassifierSettings,
        dictionary: &Dictionary,
    ) -> Result<ClassifierRecord, ServiceError> {
        self.context.check()?;
        self.phase(Phase::Validate, 0.0);
        let read = class_labels::read(self.app, self.cohort, &self.plan.filter, &settings.attribute);
        let labels = self.handle.block_on(read)?;
        let kept = ShapesInMemory::of(shapes)?;
        let record = train_classifier(dictionary, &kept, &labels, settings, self);
        record.map_err(|error| shapes.named(error))
    }

    /// Shapes of the cohort added after the revision `since`.
    fn shapes<'a>(
        &'a self,
        since: u64,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<StoredShapes<'a>, ServiceError> {
        let Self { app, handle, plan, cohort, setup, .. } = *self;
        let shapes = StoredShapes::new(app, handle, cohort, &plan.filter, since, setup, stop)?;
        Ok(shapes.distributed_by(&self.others))
    }

    /// BLAKE3 digest of control points and weights, in storage order.
    fn shapes_digest(&self) -> Result<String, ServiceError> {
        let mut hasher = blake3::Hasher::new();
        let stop = || self.context.is_cancelled();
        self.shapes(0, &stop)?.scan(&mut |control_points, weights| {
            for (shape, weight) in control_points.chunks_exact(self.setup.metric.len()).zip(weights) {
                shape.iter().chain([weight]).for_each(|number| {
                    hasher.update(&number.to_le_bytes());
                });
            }
            Ok(true)
        })?;
        Ok(hasher.finalize().to_hex().to_string())
    }
}
