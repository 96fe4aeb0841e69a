//! Plans of DataFusion, their memory and their threads.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use datafusion_common::{Result, internal_datafusion_err};
use datafusion_execution::TaskContext;
use datafusion_execution::config::SessionConfig;
use datafusion_execution::disk_manager::{DiskManagerBuilder, DiskManagerMode};
use datafusion_execution::memory_pool::FairSpillPool;
use datafusion_execution::runtime_env::RuntimeEnvBuilder;
use datafusion_physical_expr::expressions::Column;
use datafusion_physical_expr::{LexOrdering, Partitioning, PhysicalSortExpr};
use datafusion_physical_plan::repartition::RepartitionExec;
use datafusion_physical_plan::sorts::sort::SortExec;
use datafusion_physical_plan::{ExecutionPlan, displayable};
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use shapelex_analysis::accumulate::FAN_IN;

use super::fold::FoldExec;
use super::rows;
use super::subject::{Runner, Subject};
use super::sum::{Parts, SumExec};
use super::task::Task;
use super::work::Work;
use crate::EngineError;

/// Maximum size of a batch of rows in bytes, unless one row is larger: the input of an operator at once. A sort that merges batches it has
/// spilled holds two batches of each file, all of its memory if there are many, and the sort of the next level needs some.
const BATCH_BYTES: usize = 2 << 20;

/// Resources of a plan.
#[derive(Debug, Clone)]
pub struct Engine {
    /// Number of partitions that are computed at the same time.
    pub threads: NonZeroUsize,
    /// Memory of sums that wait for their group, in bytes; beyond it they are written to temporary files.
    pub memory_bytes: usize,
    /// Folder of temporary files. Default: that of the system.
    pub spill: Option<PathBuf>,
}

/// Counts of a pass.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Took {
    /// Number of files that were spilled.
    pub spills: usize,
    /// Their size in bytes.
    pub spilled_bytes: usize,
    /// Number of jobs of a cluster.
    pub jobs: usize,
    /// Number of jobs that were submitted again because a scheduler or results were lost.
    pub resubmitted: usize,
}

impl Runner for Engine {
    /// Cost: one read of all parts, the sums, and the states of all parts once through hash and sort.
    fn run<'a>(
        &'a self,
        subject: Subject,
        work: &'a Work,
    ) -> BoxFuture<'a, Result<(Vec<u8>, Took), EngineError>> {
        self.compute(subject, work).boxed()
    }
}

impl Engine {
    async fn compute(&self, subject: Subject, work: &Work) -> Result<(Vec<u8>, Took), EngineError> {
        let parts = work.units(subject.revision.parts());
        let context = self.context(self.batch_rows(work.state_bytes(&subject.setting)))?;
        let task = Arc::new(Task::new(subject, work.clone()));
        let plan = self.plan(&task, parts)?;
        let found = datafusion_physical_plan::collect(plan.clone(), context).await;
        let found = found.map_err(|error| task.error(error))?;
        let mut sums = Vec::new();
        for batch in &found {
            sums.extend(rows::read(batch)?.map(|(_, state)| state.to_vec()));
        }
        let took = took(&plan);
        match (sums.pop(), sums.pop()) {
            (Some(sum), None) => Ok((sum, took)),
            _ => Err(EngineError::from(internal_datafusion_err!(
                "expected one sum, got others from {}",
                displayable(plan.as_ref()).indent(false)
            ))),
        }
    }

    /// Sums of the parts, folded until one is left.
    fn plan(&self, task: &Arc<Task>, parts: usize) -> Result<Arc<dyn ExecutionPlan>> {
        let mut rows = parts;
        let all = Parts::All { count: parts, partitions: self.threads.get().min(parts) };
        let mut plan: Arc<dyn ExecutionPlan> = Arc::new(SumExec::new(task.clone(), all));
        while rows > 1 {
            let groups = rows.div_ceil(FAN_IN);
            let by_group = vec![Arc::new(Column::new("group", rows::GROUP)) as _];
            let partitioning = Partitioning::Hash(by_group, self.threads.get().min(groups));
            plan = Arc::new(RepartitionExec::try_new(plan, partitioning)?);
            let by_part = PhysicalSortExpr::new_default(Arc::new(Column::new("part", rows::PART)));
            let ordering = LexOrdering::new([by_part])
                .ok_or_else(|| internal_datafusion_err!("an ordering by one column"))?;
            plan = Arc::new(SortExec::new(ordering, plan).with_preserve_partitioning(true));
            plan = Arc::new(FoldExec::new(task.clone(), plan, rows));
            rows = groups;
        }
        Ok(plan)
    }

    /// Rows of a batch: as many states of about `state_bytes` as [`BATCH_BYTES`] hold, and a sixteenth of the memory of a partition.
    fn batch_rows(&self, state_bytes: usize) -> usize {
        let bytes = BATCH_BYTES.min(self.memory_bytes / 16 / self.threads);
        (bytes / state_bytes.max(1)).clamp(1, FAN_IN)
    }

    fn context(&self, batch_rows: usize) -> Result<Arc<TaskContext>> {
        let mode = match &self.spill {
            Some(folder) => DiskManagerMode::Directories(vec![folder.clone()]),
            None => DiskManagerMode::OsTmpDirectory,
        };
        let runtime = RuntimeEnvBuilder::new()
            .with_memory_pool(Arc::new(FairSpillPool::new(self.memory_bytes)))
            .with_disk_manager_builder(DiskManagerBuilder::default().with_mode(mode))
            .build_arc()?;
        // Sorts keep this much for merging spilled batches.
        let reserve = (self.memory_bytes / 8 / self.threads).min(10 << 20);
        let config = SessionConfig::new()
            .with_target_partitions(self.threads.get())
            .with_batch_size(batch_rows)
            .with_sort_spill_reservation_bytes(reserve);
        let none = || Default::default();
        let session = "pass".to_string();
        Ok(Arc::new(TaskContext::new(
            None,
            session,
            config,
            none(),
            Default::default(),
            Default::default(),
            Default::default(),
            runtime,
        )))
    }
}

/// Files that the operators of a plan have spilled.
fn took(plan: &Arc<dyn ExecutionPlan>) -> Took {
    let mut took = Took::default();
    if let Some(metrics) = plan.metrics() {
        took.spills += metrics.spill_count().unwrap_or(0);
        took.spilled_bytes += metrics.spilled_bytes().unwrap_or(0);
    }
    for below in plan.children().into_iter().map(self::took) {
        took.spills += below.spills;
        took.spilled_bytes += below.spilled_bytes;
    }
    took
}
