//! A revision as a source of shapes.

use std::sync::{Arc, Mutex, PoisonError};

use shapelex_analysis::accumulate::{MergePart, PART, ShapeSource, Shapes, prepare};
use shapelex_analysis::pass::Pass;
use tokio::runtime::Handle;

use super::engine::{Engine, Took};
use super::revision::{Revision, Setting};
use crate::EngineError;
use crate::cohort::part::Numbers;

/// The shapes of a revision, read again in every pass. Sums that an engine can make run there.
///
/// Used on threads that do not run the tasks of `runtime`: reading waits for it.
#[derive(Debug)]
pub struct AtRest<'a> {
    revision: Arc<Revision>,
    setting: Arc<Setting>,
    runtime: &'a Handle,
    engine: Option<&'a Engine>,
    took: Mutex<Vec<Took>>,
}

impl<'a> AtRest<'a> {
    /// The shapes of `revision`. Without `engine`, this thread computes all sums, part after part.
    pub fn new(
        revision: Arc<Revision>,
        setting: Arc<Setting>,
        runtime: &'a Handle,
        engine: Option<&'a Engine>,
    ) -> Self {
        Self { revision, setting, runtime, engine, took: Mutex::default() }
    }

    /// What each pass on the engine took so far.
    pub fn took(&self) -> Vec<Took> {
        self.took.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Starts to read a part, if there is one with this number.
    fn read(&self, k: usize) -> Option<tokio::task::JoinHandle<Result<Numbers, EngineError>>> {
        let revision = self.revision.clone();
        (k < revision.parts()).then(|| self.runtime.spawn(async move { revision.read(k).await }))
    }
}

impl ShapeSource for AtRest<'_> {
    type Error = EngineError;

    fn count(&self) -> usize {
        self.revision.shapes()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        let Setting { metric, method, .. } = &*self.setting;
        let (mut k, mut next) = (0, self.read(0));
        while let Some(reading) = next {
            let read = self.runtime.block_on(reading);
            let read = read.map_err(|error| EngineError::refused("runtime", error.to_string()))?;
            let Numbers { mut control_points, weights } = read?;
            next = self.read(k + 1);
            let first = k * PART;
            prepare(metric, method.translates(), first, &mut control_points)?;
            visit(Shapes { first, whitened: &control_points, weights: &weights })?;
            k += 1;
        }
        Ok(())
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, EngineError> {
        let Some(engine) = self.engine.filter(|_| self.revision.parts() > 0) else { return Ok(false) };
        let run = engine.run(self.revision.clone(), self.setting.clone(), pass);
        let (sum, took) = self.runtime.block_on(run)?;
        merge(&sum)?;
        self.took.lock().unwrap_or_else(PoisonError::into_inner).push(took);
        Ok(true)
    }
}
