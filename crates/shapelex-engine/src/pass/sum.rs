//! Reads parts, and sums each.

use std::fmt;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::UInt64Type;
use arrow_array::{RecordBatch, UInt64Array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use datafusion_common::tree_node::TreeNodeRecursion;
use datafusion_common::{DataFusionError, Result, internal_datafusion_err, internal_err};
use datafusion_common_runtime::SpawnedTask;
use datafusion_execution::{SendableRecordBatchStream, TaskContext};
use datafusion_physical_expr::{EquivalenceProperties, Partitioning, PhysicalExpr};
use datafusion_physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion_physical_plan::stream::RecordBatchStreamAdapter;
use datafusion_physical_plan::{
    ChildrenPropertiesMode, DisplayAs, DisplayFormatType, ExecutionPlan, ExecutionPlanProperties,
    PlanProperties, ReplaceChildrenOptions,
};
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt};

use super::rows;
use super::task::{Input, Task};

/// The parts that a [`SumExec`] sums.
#[derive(Debug, Clone)]
pub(crate) enum Parts {
    /// All of a revision; the partition `p` of `n` takes every `n`-th from `p` on.
    All {
        /// Number of parts of the revision.
        count: usize,
        /// Number of partitions.
        partitions: usize,
    },
    /// Those whose numbers a plan yields.
    #[cfg_attr(
        not(feature = "cluster"),
        expect(dead_code, reason = "tasks of a cluster are told their parts")
    )]
    Listed(Arc<dyn ExecutionPlan>),
}

impl Parts {
    /// Schema of a plan that lists parts.
    pub(crate) fn schema() -> SchemaRef {
        Arc::new(Schema::new(vec![Field::new("part", DataType::UInt64, false)]))
    }

    /// The numbers of parts as a batch of that schema.
    #[cfg_attr(
        not(feature = "cluster"),
        expect(dead_code, reason = "tasks of a cluster are told their parts")
    )]
    pub(crate) fn batch(parts: impl IntoIterator<Item = usize>) -> Result<RecordBatch> {
        let numbers: UInt64Array = parts.into_iter().map(|part| part as u64).collect();
        Ok(RecordBatch::try_new(Self::schema(), vec![Arc::new(numbers)])?)
    }

    fn read(batch: &RecordBatch) -> Result<Vec<usize>> {
        let numbers = batch.column(0).as_primitive_opt::<UInt64Type>();
        let numbers = numbers
            .ok_or_else(|| internal_datafusion_err!("expected numbers of parts, got {}", batch.schema()))?;
        Ok(numbers.values().iter().map(|part| *part as usize).collect())
    }

    fn partitions(&self) -> usize {
        match self {
            Self::All { partitions, .. } => *partitions,
            Self::Listed(plan) => plan.output_partitioning().partition_count(),
        }
    }

    /// The parts of a partition.
    fn of(&self, partition: usize, context: Arc<TaskContext>) -> Result<BoxStream<'static, Result<usize>>> {
        match self {
            Self::All { count, partitions } => {
                let mine = (partition..*count).step_by(*partitions);
                Ok(futures_util::stream::iter(mine.map(Ok)).boxed())
            }
            Self::Listed(plan) => {
                let numbers = plan.execute(partition, context)?.and_then(|batch| async move {
                    Ok(futures_util::stream::iter(Self::read(&batch)?.into_iter().map(Ok)))
                });
                Ok(numbers.try_flatten().boxed())
            }
        }
    }
}

/// Reads parts and sums them: a row for each, in the order of its parts.
///
/// A part is read while the one before it is summed, so a partition holds two parts.
#[derive(Debug)]
pub(crate) struct SumExec {
    pub(crate) task: Arc<Task>,
    parts: Parts,
    properties: Arc<PlanProperties>,
}

impl SumExec {
    pub(crate) fn new(task: Arc<Task>, parts: Parts) -> Self {
        let properties = PlanProperties::new(
            EquivalenceProperties::new(rows::schema()),
            Partitioning::UnknownPartitioning(parts.partitions()),
            EmissionType::Incremental,
            Boundedness::Bounded,
        );
        Self { task, parts, properties: Arc::new(properties) }
    }
}

impl DisplayAs for SumExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.parts {
            Parts::All { count, partitions } => {
                write!(f, "SumExec: parts={count}, partitions={partitions}")
            }
            Parts::Listed(_) => write!(f, "SumExec"),
        }
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
        match &self.parts {
            Parts::All { .. } => Vec::new(),
            Parts::Listed(plan) => vec![plan],
        }
    }

    fn apply_expressions(
        &self,
        _: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        Ok(TreeNodeRecursion::Continue)
    }

    fn replace_children(
        self: Arc<Self>,
        mut children: Vec<Arc<dyn ExecutionPlan>>,
        _: ReplaceChildrenOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        match (&self.parts, children.pop(), children.pop()) {
            (Parts::All { .. }, None, None) => Ok(self),
            (Parts::Listed(_), Some(plan), None) => {
                Ok(Arc::new(Self::new(self.task.clone(), Parts::Listed(plan))))
            }
            _ => internal_err!("SumExec has a child where it is told its parts, and none elsewhere"),
        }
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        self.replace_children(children, ReplaceChildrenOptions::new(ChildrenPropertiesMode::Recompute))
    }

    fn execute(&self, partition: usize, context: Arc<TaskContext>) -> Result<SendableRecordBatchStream> {
        let parts = self.parts.of(partition, context)?;
        let task = self.task.clone();
        let read = move |part: Result<usize>| {
            let task = task.clone();
            let read = SpawnedTask::spawn(async move {
                let k = part?;
                match task.read(k).await {
                    Ok(input) => Ok((task, k, input)),
                    Err(error) => Err(task.fail(k, error)),
                }
            });
            async move { read.join_unwind().await.map_err(interrupted)? }
        };
        let sum = |(task, k, input): (Arc<Task>, usize, Input)| async move {
            let making = task.clone();
            let make = move || making.make(k, input).map_err(|error| making.fail(k, error));
            let made = SpawnedTask::spawn_blocking(make).join_unwind().await.map_err(interrupted)??;
            let state = task.keep(k, made).await.map_err(|error| task.fail(k, error))?;
            rows::row(k, &state)
        };
        let rows = parts.map(read).buffered(2).and_then(sum);
        Ok(Box::pin(RecordBatchStreamAdapter::new(rows::schema(), rows)))
    }
}

/// A task that was stopped because the plan is no longer wanted.
pub(super) fn interrupted(error: tokio::task::JoinError) -> DataFusionError {
    DataFusionError::ExecutionJoin(Box::new(error))
}
