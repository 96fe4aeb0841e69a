//! A revision as a source of shapes.

use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, PoisonError};

use futures_util::future::BoxFuture;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{Mark, MergePart, PART, ShapeSource, Shapes, VisitMarked, prepare};
use shapelex_analysis::pass::Pass;
use tokio::runtime::Handle;

use super::engine::Took;
use super::task::Task;
use super::work::Work;
use crate::EngineError;
use crate::cohort::part::Numbers;
use crate::cohort::revision::{Revision, Setting};
use crate::named::Named;

/// What a pass is over.
#[derive(Debug, Clone)]
pub struct Subject {
    /// The shapes.
    pub revision: Arc<Revision>,
    /// What they are measured by.
    pub setting: Arc<Setting>,
    /// The dictionary that the pass uses, if it uses one.
    pub dictionary: Option<Arc<Named>>,
    /// Number of parts that are done.
    pub done: Arc<AtomicUsize>,
}

impl Subject {
    /// A revision measured by `setting`.
    pub fn new(revision: Arc<Revision>, setting: Arc<Setting>, dictionary: Option<Arc<Named>>) -> Self {
        Self { revision, setting, dictionary, done: Arc::default() }
    }
}

/// Where passes are computed: on the threads of this process, or on other machines.
pub trait Runner: std::fmt::Debug + Sync {
    /// The result of a pass over a revision, serialised, and what it took.
    ///
    /// # Errors
    /// Damaged parts, degenerate shapes, errors of the store (of several, the first one among those found before the pass ended);
    /// memory, temporary files or machines that do not suffice.
    fn run<'a>(
        &'a self,
        subject: Subject,
        work: &'a Work,
    ) -> BoxFuture<'a, Result<(Vec<u8>, Took), EngineError>>;
}

/// The shapes of a revision, read again in every pass. Sums run on a [`Runner`].
///
/// Used on threads that do not run the tasks of `runtime`: reading waits for it.
#[derive(Debug)]
pub struct AtRest<'a> {
    subject: Subject,
    runtime: &'a Handle,
    runner: Option<&'a dyn Runner>,
    took: Mutex<Vec<Took>>,
}

impl<'a> AtRest<'a> {
    /// The shapes of `revision`. Without `runner`, this thread computes all sums, part after part.
    pub fn new(
        revision: Arc<Revision>,
        setting: Arc<Setting>,
        runtime: &'a Handle,
        runner: Option<&'a dyn Runner>,
    ) -> Self {
        Self { subject: Subject::new(revision, setting, None), runtime, runner, took: Mutex::default() }
    }

    /// The revision.
    pub fn revision(&self) -> &Arc<Revision> {
        &self.subject.revision
    }

    /// What its shapes are measured by.
    pub(crate) fn setting(&self) -> &Arc<Setting> {
        &self.subject.setting
    }

    /// What each pass on the engine took so far.
    pub fn took(&self) -> Vec<Took> {
        self.took.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The result of a pass that is no sum of the analysis. Without runner, this thread computes it, part after part.
    ///
    /// # Errors
    /// As [`Runner::run`].
    pub fn run(
        &self,
        dictionary: Option<Arc<Named>>,
        setting: Arc<Setting>,
        work: &Work,
    ) -> Result<Vec<u8>, EngineError> {
        let revision = self.subject.revision.clone();
        let subject = Subject::new(revision, setting, dictionary);
        let Some(runner) = self.runner else {
            return self.runtime.block_on(Task::new(subject, work.clone()).alone());
        };
        let (state, took) = self.runtime.block_on(runner.run(subject, work))?;
        self.took.lock().unwrap_or_else(PoisonError::into_inner).push(took);
        Ok(state)
    }

    /// Whether passes run on an engine.
    pub fn has_runner(&self) -> bool {
        self.runner.is_some()
    }

    /// Waits for a task of the runtime.
    pub(crate) fn wait<T>(&self, task: impl Future<Output = T>) -> T {
        self.runtime.block_on(task)
    }

    /// blake3 digest of the control points and weights of all shapes, hexadecimal, as the service notes it. Reads all parts.
    ///
    /// # Errors
    /// Damaged parts; errors of the store.
    pub fn shapes_digest(&self) -> Result<String, EngineError> {
        let (mut hasher, width) = (blake3::Hasher::new(), self.subject.revision.width());
        let mut bytes = Vec::new();
        self.for_each_part(&mut |_, Numbers { control_points, weights, .. }| {
            bytes.clear();
            for (shape, weight) in control_points.chunks_exact(width).zip(weights) {
                bytes.extend(shape.iter().chain([&weight]).flat_map(|number| number.to_le_bytes()));
            }
            hasher.update(&bytes);
            Ok(())
        })?;
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// Starts to read a part, if there is one with this number.
    fn read(&self, k: usize) -> Option<tokio::task::JoinHandle<Result<Numbers, EngineError>>> {
        let revision = self.subject.revision.clone();
        (k < revision.parts()).then(|| self.runtime.spawn(async move { revision.read(k, &[]).await }))
    }

    /// Visits the parts in order; one is read while the one before it is visited.
    fn for_each_part(
        &self,
        visit: &mut dyn FnMut(usize, Numbers) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        let (mut k, mut next) = (0, self.read(0));
        while let Some(reading) = next {
            let read = self.runtime.block_on(reading);
            let read = read.map_err(|error| EngineError::refused("runtime", error.to_string()))??;
            next = self.read(k + 1);
            visit(k, read)?;
            k += 1;
        }
        Ok(())
    }
}

impl ShapeSource for AtRest<'_> {
    fn count(&self) -> usize {
        self.subject.revision.shapes()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let Setting { metric, method, .. } = &*self.subject.setting;
        Ok(self.for_each_part(&mut |k, Numbers { mut control_points, weights, .. }| {
            let first = k * PART;
            prepare(metric, method.translates(), first, &mut control_points)?;
            Ok(visit(Shapes { first, whitened: &control_points, weights: &weights })?)
        })?)
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        let Setting { metric, method, .. } = &*self.subject.setting;
        Ok(self.for_each_part(&mut |k, Numbers { mut control_points, weights, .. }| {
            let (first, marks) = (k * PART, Mark::of_all(&control_points, &weights));
            prepare(metric, method.translates(), first, &mut control_points)?;
            Ok(visit(Shapes { first, whitened: &control_points, weights: &weights }, &marks)?)
        })?)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        let Some(runner) = self.runner.filter(|_| self.subject.revision.parts() > 0) else {
            return Ok(false);
        };
        let work = Work::Sum(pass.clone());
        let (sum, took) = self.runtime.block_on(runner.run(self.subject.clone(), &work))?;
        merge(&sum)?;
        self.took.lock().unwrap_or_else(PoisonError::into_inner).push(took);
        Ok(true)
    }
}
