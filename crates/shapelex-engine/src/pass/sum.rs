//! The leaf of a plan: reads parts, and sums each.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use datafusion_common::tree_node::TreeNodeRecursion;
use datafusion_common::{DataFusionError, Result, internal_err};
use datafusion_common_runtime::SpawnedTask;
use datafusion_execution::{SendableRecordBatchStream, TaskContext};
use datafusion_physical_expr::{EquivalenceProperties, Partitioning, PhysicalExpr};
use datafusion_physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion_physical_plan::stream::RecordBatchStreamAdapter;
use datafusion_physical_plan::{
    DisplayAs, DisplayFormatType, ExecutionPlan, PlanProperties, ReplaceChildrenOptions,
};
use futures_util::{StreamExt, TryStreamExt};
use shapelex_analysis::accumulate::{PART, ShapesInMemory};
use shapelex_analysis::pass::Pass;

use super::revision::{Revision, Setting};
use super::rows;
use crate::EngineError;
use crate::cohort::part::Numbers;

/// What every operator of a plan needs.
#[derive(Debug)]
pub(super) struct Task {
    pub(super) revision: Arc<Revision>,
    pub(super) setting: Arc<Setting>,
    pub(super) pass: Pass,
    /// The error of the part with the lowest number, among those that were found before the plan ended.
    failure: Mutex<Option<(usize, EngineError)>>,
}

impl Task {
    pub(super) fn new(revision: Arc<Revision>, setting: Arc<Setting>, pass: Pass) -> Self {
        Self { revision, setting, pass, failure: Mutex::default() }
    }

    /// Keeps the error of a part, which DataFusion would wrap in others, and tells DataFusion to end.
    pub(super) fn fail(&self, part: usize, error: EngineError) -> DataFusionError {
        let text = error.to_string();
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        if failure.as_ref().is_none_or(|(before, _)| part < *before) {
            *failure = Some((part, error));
        }
        DataFusionError::Execution(text)
    }

    /// The error that was kept, else that of DataFusion.
    pub(super) fn error(&self, error: DataFusionError) -> EngineError {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        failure.map_or_else(|| error.into(), |(_, own)| own)
    }

    /// The sum of the part `k`, serialised.
    ///
    /// # Errors
    /// A degenerate shape, with its position in the revision.
    fn sum(&self, k: usize, numbers: Numbers) -> Result<Vec<u8>, EngineError> {
        let Setting { metric, method, .. } = &*self.setting;
        let Numbers { control_points, weights } = numbers;
        let shapes = ShapesInMemory::new(metric, method.translates(), control_points, weights);
        let sum = shapes.and_then(|shapes| self.pass.make(&shapes, self.setting.measured()));
        Ok(sum.map_err(|error| error.after(k * PART))?)
    }
}

/// Reads every `n`-th part and sums it: a row for each.
///
/// A part is read while the one before it is summed, so a partition holds two parts.
#[derive(Debug)]
pub(super) struct SumExec {
    task: Arc<Task>,
    partitions: usize,
    properties: Arc<PlanProperties>,
}

impl SumExec {
    pub(super) fn new(task: Arc<Task>, partitions: usize) -> Self {
        let properties = PlanProperties::new(
            EquivalenceProperties::new(rows::schema()),
            Partitioning::UnknownPartitioning(partitions),
            EmissionType::Incremental,
            Boundedness::Bounded,
        );
        Self { task, partitions, properties: Arc::new(properties) }
    }
}

impl DisplayAs for SumExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SumExec: parts={}, partitions={}", self.task.revision.parts(), self.partitions)
    }
}

impl ExecutionPlan for SumExec {
    fn name(&self) -> &'static str {
        "SumExec"
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        Vec::new()
    }

    fn apply_expressions(
        &self,
        _: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        Ok(TreeNodeRecursion::Continue)
    }

    fn replace_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
        _: ReplaceChildrenOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        if children.is_empty() { Ok(self) } else { internal_err!("SumExec has no children") }
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        if children.is_empty() { Ok(self) } else { internal_err!("SumExec has no children") }
    }

    fn execute(&self, partition: usize, _: Arc<TaskContext>) -> Result<SendableRecordBatchStream> {
        let mine = (partition..self.task.revision.parts()).step_by(self.partitions);
        let task = self.task.clone();
        let read = move |k: usize| {
            let task = task.clone();
            let read = SpawnedTask::spawn(async move {
                match task.revision.read(k).await {
                    Ok(numbers) => Ok((task, k, numbers)),
                    Err(error) => Err(task.fail(k, error)),
                }
            });
            async move { read.join_unwind().await.map_err(interrupted)? }
        };
        let sum = |(task, k, numbers): (Arc<Task>, usize, Numbers)| async move {
            let sum = move || task.sum(k, numbers).map_err(|error| task.fail(k, error));
            rows::row(k, &SpawnedTask::spawn_blocking(sum).join_unwind().await.map_err(interrupted)??)
        };
        let rows = futures_util::stream::iter(mine).map(read).buffered(2).and_then(sum);
        Ok(Box::pin(RecordBatchStreamAdapter::new(rows::schema(), rows)))
    }
}

/// A task that was stopped because the plan is no longer wanted.
pub(super) fn interrupted(error: tokio::task::JoinError) -> DataFusionError {
    DataFusionError::ExecutionJoin(Box::new(error))
}
