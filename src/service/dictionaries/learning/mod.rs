//! Job that learns a dictionary from a stored cohort.
//!
//! A plan fixes everything that the result depends on, including the revision of the cohort: a job that runs again
//! after a crash learns the same dictionary, bit by bit, whatever was added in the meantime.

mod held_out;

use tokio::runtime::Handle;

pub(crate) use self::held_out::trainings as held_out_trainings;
use super::class_labels::{Membership, WITHIN};
use super::distributed::Spreading;
use super::plan::{NO_STATE, Plan, program};
use super::ready;
use super::validation::Study;
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::{Accumulator, ScatterSum, ShapeSource, Shapes, ShapesInMemory};
use crate::analysis::alignment::mean_shape;
use crate::analysis::classification::record::{ClassifierRecord, ClassifierSettings};
use crate::analysis::dictionary::content::{Atom, Content, MeanRecord, ScoreStatistics, Statistics};
use crate::analysis::dictionary::learning::{Learning, Start, Watch};
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::model::{Certificate, Coded, Model};
use crate::analysis::dictionary::preparation::{Pose, Posed, Preparation};
use crate::analysis::dictionary::statistics::Statistics as CodeStatistics;
use crate::analysis::pca::FunctionalPca;
use crate::analysis::rows::{Row, columns_of, rows_of};
use crate::domain::cohort::Cohort;
use crate::domain::dictionary::{NewDictionary, Provenance, Summary};
use crate::domain::id;
use crate::domain::job::Job;
use crate::numeric::dense::Matrix;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, now_ms};
use crate::service::cohorts::source::{StoredShapes, Work};
use crate::service::cost::jobs::KEPT_BYTES;
use crate::service::jobs::Outcome;
use crate::service::statistics::Setup;

/// Maximum size of stored sums from which learning can continue.
const STATE_BYTES: usize = 64 << 20;

/// Maximum number of stored values of a distribution.
const QUANTILES: usize = 1001;

/// Runs the job.
///
/// # Errors
/// The reason why the dictionary cannot be learnt; [`ServiceError::Cancelled`].
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = serde_json::from_value(job.parameters.clone())
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let dictionary = learn(app, handle, job, &plan, context)?;
    let result =
        serde_json::json!({"dictionary": dictionary.id, "name": plan.name, "digest": dictionary.digest});
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
    let setup = Setup::new(app, &plan.settings(&cohort))?;
    let others = Spreading { app, handle, job, plan };
    let task = Task { app, handle, plan, cohort: &cohort, setup: &setup, context, others };
    let (content, state) = task.content(previous)?;
    let text = serde_json::to_vec(&content)
        .map_err(|error| ServiceError::Internal(format!("a dictionary is not JSON: {error}")))?;
    let provenance = Provenance {
        cohort: cohort.id.clone(),
        cohort_name: cohort.name.clone(),
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
pub(crate) struct Task<'a> {
    pub(crate) app: &'a App,
    handle: &'a Handle,
    plan: &'a Plan,
    cohort: &'a Cohort,
    setup: &'a Setup,
    pub(crate) context: &'a JobContext,
    /// Workers to which parts of a pass can be distributed.
    others: Spreading<'a>,
}

/// Phases of the progress with the fraction at which they begin, in order.
mod phase {
    /// Computation of the mean shape, including the search of start points.
    pub(crate) const MEAN: (&str, f64) = ("mean", 0.0);
    /// Alignment of the shapes.
    pub(crate) const ALIGN: (&str, f64) = ("align", 0.1);
    /// Learning of atoms or components.
    pub(crate) const LEARN: (&str, f64) = ("learn", 0.2);
    /// Encoding of all shapes in the learnt dictionary.
    pub(crate) const CERTIFY: (&str, f64) = ("certify", 0.9);
    /// Holding out shapes, to calibrate the detection of new ones.
    pub(crate) const HOLD_OUT: (&str, f64) = ("hold_out", 0.92);
    /// Validation and training of the classifier.
    pub(crate) const VALIDATE: (&str, f64) = ("validate", 0.95);
}

impl Watch for Task<'_> {
    fn stop(&self) -> bool {
        self.context.is_cancelled()
    }

    fn epoch(&self, epochs: usize, objective: f64) {
        let most = match self.plan.method {
            Method::Sparse { max_epochs, .. } => max_epochs,
            Method::FunctionalPca { .. } => 1,
        };
        let (name, start) = phase::LEARN;
        let fraction = start + (phase::CERTIFY.1 - start) * (epochs as f64 / most as f64).min(1.0);
        self.context.report(name, self.share() * fraction, Some(objective));
    }
}

impl Task<'_> {
    fn enter(&self, (name, fraction): (&'static str, f64)) -> Result<(), ServiceError> {
        self.context.check()?;
        self.context.report(name, self.share() * fraction, None);
        Ok(())
    }

    /// Fraction of the progress for learning; the remainder is holding out shapes, then validation.
    fn share(&self) -> f64 {
        let validation = self.plan.classifier.as_ref().map_or(0, |settings| settings.trainings(WITHIN));
        1.0 / (1 + held_out::usual_trainings(self.plan) + validation) as f64
    }

    /// Progress at which validation begins.
    fn validation_start(&self) -> f64 {
        self.share() * (1 + held_out::usual_trainings(self.plan)) as f64
    }

    /// The learnt content, and the sums from which learning can continue.
    fn content(&self, previous: Option<Previous>) -> Result<(Content, Vec<u8>), ServiceError> {
        let stop = || self.context.is_cancelled();
        let shapes = self.shapes(0, &stop)?;
        self.enter(phase::MEAN)?;
        let metric = &self.setup.metric;
        let mean = match &previous {
            Some(previous) => previous.content.mean.clone(),
            None => {
                let Setup { method, frame, matching, .. } = self.setup;
                let mean = mean_shape(&shapes, metric, method, *frame, matching);
                MeanRecord::of(&mean.map_err(|error| shapes.named(error))?, metric.dimension())
            }
        };
        let mut content = self.empty_content(mean);
        let preparation = self.preparation(&content)?;
        self.enter(phase::ALIGN)?;
        let since = previous.as_ref().map_or(0, |previous| previous.revision);
        let new_shapes = self.shapes(since, &stop)?;
        let kept = self.kept(&new_shapes, &preparation).map_err(|error| new_shapes.named(error))?;
        let state = match kept {
            Some(kept) => self.learn_from(&kept, previous, &preparation, &mut content),
            None => {
                let posed = Posed { source: &new_shapes, preparation: &preparation };
                self.learn_from(&posed, previous, &preparation, &mut content)
            }
        };
        let state = state.map_err(|error| new_shapes.named(error))?;
        self.enter(phase::CERTIFY)?;
        content.statistics.shapes = shapes.count();
        let (_, preparation, model) = ready::prepare(self.app, &content)?;
        let certificate = self.certificate(&shapes, &content, &preparation, &model);
        let certificate = certificate.map_err(|error| shapes.named(error))?;
        certify(&mut content, certificate, &model);
        self.enter(phase::HOLD_OUT)?;
        let held_out = self.held_out(&shapes, &content, &preparation, &state);
        content.statistics.held_out = held_out.map_err(|error| shapes.named(error))?;
        if let Some(settings) = &self.plan.classifier {
            let classifier = self.classifier(&shapes, settings, &content);
            content.classifier = Some(classifier.map_err(|error| shapes.named(error))?);
        }
        Ok((content, state))
    }

    /// Certificate: quality of the description of `shapes` by the learnt dictionary.
    fn certificate(
        &self,
        shapes: &StoredShapes<'_>,
        content: &Content,
        preparation: &Preparation,
        model: &Model,
    ) -> Result<Certificate, ServiceError> {
        let code = |source: &StoredShapes<'_>| Coded::new(model, &Posed { source, preparation }, self);
        let make = |part: &StoredShapes<'_>| Ok(code(part)?.to_bytes());
        let mut coded = Coded::default();
        let work = || Work::Codes(Box::new(content.clone()));
        let spread = shapes.spread_work(&work, &make, &mut |bytes| coded.append(bytes))?;
        Ok(if spread { coded } else { code(shapes)? }.certificate())
    }

    /// Validates and trains the classifier.
    fn classifier(
        &self,
        shapes: &StoredShapes<'_>,
        settings: &ClassifierSettings,
        content: &Content,
    ) -> Result<ClassifierRecord, ServiceError> {
        self.enter(phase::VALIDATE)?;
        let read = Membership::read(self.app, self.cohort, &self.plan.filter, &settings.attribute);
        let membership = self.handle.block_on(read)?;
        let length = self.setup.metric.len();
        ServiceError::unless_empty(membership.faults(settings, &self.plan.method, length))?;
        let context = self.context.silent();
        let task = Task { context: &context, ..*self };
        let shapes = &in_memory(shapes)?;
        let study = Study { task: &task, shapes, membership: &membership, settings };
        let start = self.validation_start();
        study.record(content, &|part| {
            self.context.report(phase::VALIDATE.0, start + (1.0 - start) * part, None);
        })
    }

    /// Content learnt from shapes in memory, without certificate.
    pub(crate) fn content_of(&self, shapes: &ShapesInMemory) -> Result<Content, ServiceError> {
        let Setup { metric, method, frame, matching, .. } = self.setup;
        let mean = mean_shape(shapes, metric, method, *frame, matching)?;
        let mut content = self.empty_content(MeanRecord::of(&mean, metric.dimension()));
        let preparation = self.preparation(&content)?;
        let posed = in_memory(&Posed { source: shapes, preparation: &preparation })?;
        self.learn_from(&posed, None, &preparation, &mut content)?;
        content.statistics.shapes = shapes.count();
        Ok(content)
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

    /// Prepared shapes in memory, if they fit. Components take a single pass and read the shapes from the store.
    fn kept(
        &self,
        shapes: &StoredShapes<'_>,
        preparation: &Preparation,
    ) -> Result<Option<ShapesInMemory>, ServiceError> {
        let bytes = shapes.count().saturating_mul(8 * preparation.metric.len());
        if matches!(self.plan.method, Method::FunctionalPca { .. }) || bytes > KEPT_BYTES {
            return Ok(None);
        }
        in_memory(&Posed { source: shapes, preparation }).map(Some)
    }

    fn empty_content(&self, mean: MeanRecord) -> Content {
        let cohort = self.cohort;
        Content {
            representation: cohort.representation.clone(),
            correspondence: cohort.correspondence,
            direction: cohort.direction,
            mirror: self.plan.mirror,
            length_unit: cohort.length_unit.clone(),
            transformation: self.plan.transformation.clone(),
            alignment: self.plan.alignment,
            frame: self.plan.frame,
            method: self.plan.method.clone(),
            mean,
            centre: None,
            atoms: Vec::new(),
            statistics: Statistics::default(),
            classifier: None,
        }
    }

    fn preparation(&self, content: &Content) -> Result<Preparation, ServiceError> {
        let pose = match &self.plan.method {
            Method::FunctionalPca { .. } => Pose::Aligned { normalise: false },
            sparse => ready::learning(sparse, &self.setup.method)?.0,
        };
        let mut mean = columns_of(&content.mean.control_points, self.setup.metric.dimension());
        self.setup.metric.whiten(&mut mean);
        Ok(Preparation {
            metric: self.setup.metric.clone(),
            method: self.setup.method.clone(),
            matching: self.setup.matching.clone(),
            mean,
            pose,
        })
    }

    /// Learns from prepared shapes; returns the sums from which learning can continue.
    fn learn_from<S: ShapeSource>(
        &self,
        shapes: &S,
        previous: Option<Previous>,
        preparation: &Preparation,
        content: &mut Content,
    ) -> Result<Vec<u8>, ServiceError>
    where
        ServiceError: From<S::Error>,
    {
        self.enter(phase::LEARN)?;
        match &self.plan.method {
            Method::FunctionalPca { components, centre } => {
                self.learn_components(shapes, previous, &preparation.mean, (*components, *centre), content)
            }
            sparse => {
                let learning = ready::learning(sparse, &self.setup.method)?.1;
                self.learn_atoms(shapes, previous, &learning, &preparation.mean, content)
            }
        }
    }

    fn learn_components<S: ShapeSource>(
        &self,
        shapes: &S,
        previous: Option<Previous>,
        mean: &[f64],
        (components, centre): (usize, bool),
        content: &mut Content,
    ) -> Result<Vec<u8>, ServiceError>
    where
        ServiceError: From<S::Error>,
    {
        let metric = &self.setup.metric;
        let origin = FunctionalPca::origin(mean, centre);
        let mut sum = ScatterSum::new(metric.len());
        if let Some(previous) = previous {
            sum.restore(&previous.state)?;
        }
        sum.merge(FunctionalPca::scatter(shapes, &origin)?);
        let state = sum.to_bytes();
        let weight = sum.weight();
        let pca = FunctionalPca::of_sum(sum, metric, &origin, centre, components)?;
        content.centre = Some(self.rows(&pca.mean));
        content.atoms = (0..pca.eigenvalues.len())
            .map(|i| Atom {
                control_points: self.rows(pca.eigenshapes.column(i).as_slice()),
                usage: 1.0,
                eigenvalue: Some(pca.eigenvalues[i]),
                explained: Some(pca.explained[i]),
            })
            .collect();
        content.statistics.weight = weight;
        Ok(state)
    }

    fn learn_atoms<S: ShapeSource>(
        &self,
        shapes: &S,
        previous: Option<Previous>,
        learning: &Learning,
        mean: &[f64],
        content: &mut Content,
    ) -> Result<Vec<u8>, ServiceError>
    where
        ServiceError: From<S::Error>,
    {
        let (length, size) = (self.setup.metric.len(), learning.algebra.size());
        let start = previous.map(|previous| {
            let mut statistics = CodeStatistics::new(length, size, learning.atoms);
            statistics.restore(&previous.state)?;
            let atoms = previous.content.atoms.iter().flat_map(|atom| self.whitened(&atom.control_points));
            let atoms = Matrix::from_vec(length / size, size * learning.atoms, atoms.collect());
            Ok::<_, AnalysisError>(Start { atoms, statistics })
        });
        let mut learnt = learning.learn(shapes, start.transpose()?, self)?;
        if !self.plan.method.is_nonnegative() {
            learnt.turn_to(&learning.algebra, mean);
        }
        content.atoms = learnt
            .atoms
            .as_slice()
            .chunks_exact(length)
            .map(|atom| Atom {
                control_points: self.rows(atom),
                usage: 0.0,
                eigenvalue: None,
                explained: None,
            })
            .collect();
        content.statistics.history = learnt.history;
        content.statistics.converged = learnt.converged;
        content.statistics.reseeded = learnt.reseeded;
        Ok(learnt.statistics.to_bytes())
    }

    fn rows(&self, whitened: &[f64]) -> Vec<Row> {
        let mut control_points = whitened.to_vec();
        self.setup.metric.unwhiten(&mut control_points);
        rows_of(&control_points, self.setup.metric.dimension())
    }

    fn whitened(&self, rows: &[Row]) -> Vec<f64> {
        let mut columns = columns_of(rows, self.setup.metric.dimension());
        self.setup.metric.whiten(&mut columns);
        columns
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

/// Loads all shapes of a source into memory.
fn in_memory<S: ShapeSource>(source: &S) -> Result<ShapesInMemory, S::Error> {
    let (mut whitened, mut weights) = (Vec::new(), Vec::new());
    source.for_each_batch(&mut |batch: Shapes<'_>| {
        whitened.extend_from_slice(batch.whitened);
        weights.extend_from_slice(batch.weights);
        Ok(())
    })?;
    Ok(ShapesInMemory::prepared(whitened, weights))
}

/// Stores the certificate in the statistics.
fn certify(content: &mut Content, certificate: Certificate, model: &Model) {
    let statistics = &mut content.statistics;
    statistics.shapes = certificate.residuals.len();
    statistics.weight = certificate.weight;
    statistics.objective = certificate.objective;
    statistics.reconstruction_error = certificate.reconstruction_error;
    statistics.parameters = certificate.parameters;
    statistics.residuals = quantiles(certificate.residuals);
    content.atoms.iter_mut().zip(certificate.usage).for_each(|(atom, usage)| atom.usage = usage);
    if let Model::Components { pca, spread } = model {
        statistics.converged = true;
        statistics.total =
            pca.eigenvalues.first().zip(pca.explained.first()).map(|(value, part)| value / part);
        statistics.scores = Some(ScoreStatistics {
            mean: spread.mean.clone(),
            covariance: spread.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
            t_squared: quantiles(certificate.distances),
        });
    }
}

/// The values in ascending order; if there are more than [`QUANTILES`], that many of them, evenly spaced by rank.
pub(crate) fn quantiles(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    if values.len() <= QUANTILES {
        return values;
    }
    let last = values.len() - 1;
    (0..QUANTILES).map(|i| values[(i * last + (QUANTILES - 1) / 2) / (QUANTILES - 1)]).collect()
}
