//! Mean and principal components.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::revision::Setting;
use shapelex_engine::estimate::Estimate;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::statistics::{Report, Request, Statistics};
use tokio::runtime::Handle;

use super::machines::Machines;
use super::selection::Selection;
use super::{Answer, json_word, transformation};

#[derive(Debug, Args)]
pub(crate) struct Run {
    #[command(flatten)]
    selection: Selection,
    /// Class of transformations that is removed: a name, or a JSON object with matrices.
    #[arg(long, default_value = "similarity", value_parser = transformation)]
    transformation: Transformation,
    /// projection, procrustes or partial_procrustes. Default: what suits the class.
    #[arg(long, value_parser = json_word::<Alignment>)]
    alignment: Option<Alignment>,
    /// training or canonical.
    #[arg(long, default_value = "training", value_parser = json_word::<Frame>)]
    frame: Frame,
    /// Number of components; 0 for the mean alone.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(..=32_767))]
    components: u16,
    /// Does not subtract the mean from aligned shapes.
    #[arg(long)]
    uncentred: bool,
    /// Divides aligned shapes by their norms.
    #[arg(long)]
    normalise: bool,
    /// Only predicts time, bytes and memory, for 1 to 64 tasks at a time.
    #[arg(long)]
    dry_run: bool,
    /// Bytes per second that a task reads from the store, for --dry-run. Default: from the cache of the system.
    #[arg(long, default_value_t = 2_000_000_000, value_parser = clap::value_parser!(u64).range(1..))]
    read_bytes_per_second: u64,
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// Numbers of tasks at a time for which costs are predicted.
const EXECUTORS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];

/// A run, or its prediction.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(crate) enum Outcome {
    Ran(Box<Answer<Report>>),
    Predicted { estimates: Vec<Estimate> },
}

impl Run {
    pub(crate) fn answer(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<Outcome, EngineError> {
        let began = Instant::now();
        let revision = runtime.block_on(self.selection.open(objects))?;
        let setting = Arc::new(Setting::new(revision.manifest(), &self.transformation, self.alignment)?);
        if self.dry_run {
            let rate = self.read_bytes_per_second as f64;
            let estimate =
                |executors| Estimate::new(&revision, &setting, self.components > 0, executors, rate);
            return Ok(Outcome::Predicted { estimates: EXECUTORS.map(estimate).to_vec() });
        }
        let runners = self.machines.runners(threads)?;
        let source = AtRest::new(revision, setting.clone(), runtime, runners.chosen());
        let request = Request {
            frame: self.frame,
            components: self.components.into(),
            centred: !self.uncentred,
            normalise: self.normalise,
        };
        let statistics = Statistics::of(&source, &setting, request)?;
        Ok(Outcome::Ran(Box::new(Answer::new(&source, began, statistics.report(&setting)))))
    }
}
