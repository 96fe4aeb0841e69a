//! Shapes in memory whose passes run on the engine, as those of the service do.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{MergePart, ShapeSource, Shapes, ShapesInMemory, VisitMarked};
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::pass::{CodeGroup, Group, Pass};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::learning_folder;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::Took;
use shapelex_engine::pass::learn::Learn;
use shapelex_engine::pass::subject::{Runner, Subject};
use shapelex_engine::pass::work::Work;

use crate::passes::runtime;

/// Shapes in memory, the sums of which a runner computes from a revision of the same shapes.
pub(crate) struct Spread<'a> {
    shapes: &'a ShapesInMemory,
    revision: Arc<Revision>,
    setting: Arc<Setting>,
    runner: &'a dyn Runner,
    took: Mutex<Vec<Took>>,
    /// Where codes are kept, the method by which groups of shapes are coded, and a name that no other source has.
    coding: Option<(Objects, Method, String)>,
}

impl<'a> Spread<'a> {
    pub(crate) fn new(
        shapes: &'a ShapesInMemory,
        revision: &Arc<Revision>,
        setting: &Arc<Setting>,
        runner: &'a dyn Runner,
    ) -> Self {
        let (revision, setting) = (revision.clone(), setting.clone());
        Self { shapes, revision, setting, runner, took: Mutex::default(), coding: None }
    }

    /// The same source, whose groups of shapes are coded by the runner too.
    pub(crate) fn coding(mut self, objects: &Objects, method: &Method) -> Self {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let run = format!("run-{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        self.coding = method.is_sparse().then(|| (objects.clone(), method.clone(), run));
        self
    }

    pub(crate) fn took(&self) -> Vec<Took> {
        self.took.lock().unwrap().clone()
    }

    fn run(&self, work: &Work) -> Result<Vec<u8>, EngineError> {
        let subject = Subject::new(self.revision.clone(), self.setting.clone(), None);
        let (state, took) = runtime().block_on(self.runner.run(subject, work))?;
        self.took.lock().unwrap().push(took);
        Ok(state)
    }

    fn code(
        &self,
        (objects, method, run): &(Objects, Method, String),
        group: Group<'_>,
    ) -> Result<Vec<u8>, EngineError> {
        let Group { epoch, first, end, atoms, mean } = group;
        let (mean, atoms) = (mean.to_vec(), atoms.to_vec());
        let learn = Learn { method: method.clone(), mean, atoms, first, end, epoch, run: run.clone() };
        let cohort = &self.revision.manifest().cohort;
        let folder = learning_folder(&cohort.id, cohort.revision)?;
        runtime().block_on(learn.remove_old(objects, &folder))?;
        self.run(&Work::Learn(Box::new(learn)))
    }
}

impl ShapeSource for Spread<'_> {
    fn count(&self) -> usize {
        self.shapes.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.shapes.for_each_batch(visit)
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.shapes.for_each_marked(visit)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        if self.revision.parts() == 0 {
            return Ok(false);
        }
        merge(&self.run(&Work::Sum(pass.clone()))?)?;
        Ok(true)
    }

    fn coders(&self) -> Option<CodeGroup<'_>> {
        let coding = self.coding.as_ref()?;
        Some(Box::new(move |group: Group<'_>| Ok(self.code(coding, group)?)))
    }
}
