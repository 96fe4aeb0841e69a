//! Merges the sums of every group, in the order of their parts.

use std::fmt;
use std::sync::Arc;

use arrow_array::RecordBatch;
use datafusion_common::tree_node::TreeNodeRecursion;
use datafusion_common::{DataFusionError, Result, internal_err};
use datafusion_common_runtime::SpawnedTask;
use datafusion_execution::{SendableRecordBatchStream, TaskContext};
use datafusion_physical_expr::{EquivalenceProperties, PhysicalExpr};
use datafusion_physical_plan::execution_plan::{Boundedness, EmissionType};
use datafusion_physical_plan::stream::RecordBatchStreamAdapter;
use datafusion_physical_plan::{
    ChildrenPropertiesMode, DisplayAs, DisplayFormatType, ExecutionPlan, ExecutionPlanProperties,
    PlanProperties, ReplaceChildrenOptions,
};
use futures_util::{StreamExt, TryStreamExt};
use shapelex_analysis::accumulate::FAN_IN;

use super::rows;
use super::sum::interrupted;
use super::task::Task;

/// Folds rows that are sorted by part, and of which every group is in one partition: 64 rows become one.
#[derive(Debug)]
pub(crate) struct FoldExec {
    task: Arc<Task>,
    input: Arc<dyn ExecutionPlan>,
    /// Number of rows of all partitions.
    pub(crate) rows: usize,
    properties: Arc<PlanProperties>,
}

impl FoldExec {
    pub(crate) fn new(task: Arc<Task>, input: Arc<dyn ExecutionPlan>, rows: usize) -> Self {
        let properties = PlanProperties::new(
            EquivalenceProperties::new(rows::schema()),
            input.output_partitioning().clone(),
            EmissionType::Incremental,
            Boundedness::Bounded,
        );
        Self { task, input, rows, properties: Arc::new(properties) }
    }
}

impl DisplayAs for FoldExec {
    fn fmt_as(&self, _: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FoldExec: rows={}", self.rows)
    }
}

impl ExecutionPlan for FoldExec {
    fn name(&self) -> &'static str {
        "FoldExec"
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        &self.properties
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        vec![&self.input]
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
        match (children.pop(), children.pop()) {
            (Some(input), None) => Ok(Arc::new(Self::new(self.task.clone(), input, self.rows))),
            _ => internal_err!("FoldExec has one child"),
        }
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        self.replace_children(children, ReplaceChildrenOptions::new(ChildrenPropertiesMode::Recompute))
    }

    fn execute(&self, partition: usize, context: Arc<TaskContext>) -> Result<SendableRecordBatchStream> {
        let input = self.input.execute(partition, context)?;
        let folding = Folding { input: Some(input), task: self.task.clone(), rows: self.rows, open: None };
        let rows = futures_util::stream::try_unfold(folding, |mut folding| async {
            let folded = folding.next().await?;
            let rows = folded.map(|rows| futures_util::stream::iter(rows.into_iter().map(Ok)));
            Ok::<_, DataFusionError>(rows.map(|rows| (rows, folding)))
        });
        Ok(Box::pin(RecordBatchStreamAdapter::new(rows::schema(), rows.try_flatten().boxed())))
    }
}

/// A group that is not complete: the next part that it lacks, and the sum of the others.
struct Open {
    next: usize,
    state: Vec<u8>,
}

struct Folding {
    input: Option<SendableRecordBatchStream>,
    task: Arc<Task>,
    rows: usize,
    open: Option<Open>,
}

impl Folding {
    /// The groups that the next batch completes; `None` at the end.
    async fn next(&mut self) -> Result<Option<Vec<RecordBatch>>> {
        let Some(input) = &mut self.input else { return Ok(None) };
        let Some(batch) = input.try_next().await? else {
            self.input = None;
            return match &self.open {
                None => Ok(None),
                Some(open) => internal_err!("the sum of part {} is missing", open.next),
            };
        };
        let (task, rows, open) = (self.task.clone(), self.rows, self.open.take());
        let folded = SpawnedTask::spawn_blocking(move || fold(&task, rows, open, &batch));
        let (folded, open) = folded.join_unwind().await.map_err(interrupted)??;
        self.open = open;
        Ok(Some(folded))
    }
}

/// Adds the rows of a batch to the open group; returns those that are complete, and the one that is not.
fn fold(
    task: &Task,
    rows: usize,
    mut open: Option<Open>,
    batch: &RecordBatch,
) -> Result<(Vec<RecordBatch>, Option<Open>)> {
    let (mut folded, mut pending) = (Vec::new(), Vec::new());
    let mut next = open.as_ref().map(|open| open.next);
    for (part, state) in rows::read(batch)? {
        let expected = next.unwrap_or(part / FAN_IN * FAN_IN);
        if part != expected || part >= rows {
            return internal_err!("expected the sum of part {expected} of {rows}, got that of part {part}");
        }
        pending.push(state);
        next = Some(part + 1);
        if (part + 1) % FAN_IN == 0 || part + 1 == rows {
            let state = merge(task, open.take(), &pending)?;
            folded.push(rows::row(part / FAN_IN, &state)?);
            pending.clear();
            next = None;
        }
    }
    if let (Some(next), false) = (next, pending.is_empty()) {
        open = Some(Open { next, state: merge(task, open, &pending)? });
    }
    Ok((folded, open))
}

/// The sum so far, and those that follow it.
fn merge(task: &Task, open: Option<Open>, pending: &[&[u8]]) -> Result<Vec<u8>> {
    let begun = open.map(|open| open.state);
    let sums: Vec<&[u8]> = begun.as_deref().into_iter().chain(pending.iter().copied()).collect();
    task.merge(&sums).map_err(|error| task.fail(usize::MAX, error))
}

#[cfg(test)]
mod tests {
    use object_store::memory::InMemory;
    use shapelex_analysis::accumulate::{Accumulator, PART, ScatterSum};
    use shapelex_analysis::pass::{Pass, Sum};
    use shapelex_analysis::transformation::{ClassName, Transformation};

    use super::*;
    use crate::cohort::revision::{Revision, Setting};
    use crate::cohort::writer::Writer;
    use crate::objects::{Objects, Patience};
    use crate::pass::subject::Subject;
    use crate::pass::work::Work;
    use crate::{cohort::record::Record, ingest::read_description};

    /// Numbers of a shape: three landmarks in the plane.
    const WIDTH: usize = 6;

    /// A scatter pass over a cohort of `PART + 1` shapes.
    fn task() -> Task {
        let cohort = format!(
            r#"{{"id": "c", "name": "c", "representation": {{"kind": "landmarks", "dimension": 2, "points": 3}},
                "correspondence": "landmarks", "direction": "given", "mirror": "forbid", "revision": 1,
                "shape_count": {}}}"#,
            PART + 1
        );
        let objects = Objects::new(Arc::new(InMemory::new()), Patience::default());
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let revision = runtime.block_on(async {
            let cohort = read_description(cohort.as_bytes()).unwrap();
            let mut writer = Writer::begin(objects.clone(), cohort, false).await.unwrap();
            for k in 0..PART + 1 {
                let control_points = (0..WIDTH).map(|i| ((k * WIDTH + i) as f64).sin()).collect();
                writer.add(Record { weight: 1.0, control_points, ..Record::default() }).await.unwrap();
            }
            writer.finish().await.unwrap();
            Revision::open(objects, "c", 1).await.unwrap()
        });
        let class = Transformation::Named(ClassName::Similarity);
        let setting = Setting::new(revision.manifest(), &class, None).unwrap();
        let pass = Pass { aligned: None, sum: Sum::Scatter { origin: vec![0.0; WIDTH] } };
        let (revision, setting) = (Arc::new(revision), Arc::new(setting));
        Task::new(Subject::new(revision, setting, None), Work::Sum(pass))
    }

    /// The empty sums of these parts as one batch.
    fn batch(parts: &[usize]) -> RecordBatch {
        let state = ScatterSum::new(WIDTH).to_bytes();
        let rows: Vec<RecordBatch> = parts.iter().map(|part| rows::row(*part, &state).unwrap()).collect();
        datafusion_common::arrow::compute::concat_batches(&rows::schema(), &rows).unwrap()
    }

    #[test]
    fn rows_that_are_missing_twice_or_too_many_are_no_sum() {
        let task = task();
        let folded = |rows: usize, parts: &[usize]| fold(&task, rows, None, &batch(parts));
        let (groups, open) = folded(67, &(0..67).collect::<Vec<_>>()).unwrap();
        assert_eq!((groups.len(), open.map(|open| open.next)), (2, None));
        let (groups, open) = folded(67, &(64..66).collect::<Vec<_>>()).unwrap();
        assert_eq!((groups.len(), open.map(|open| open.next)), (0, Some(66)));
        for (parts, expected) in [
            (&[0, 2][..], "expected the sum of part 1 of 67, got that of part 2"),
            (&[0, 1, 1], "expected the sum of part 2 of 67, got that of part 1"),
            (&[5], "expected the sum of part 0 of 67, got that of part 5"),
            (&[64, 65, 66, 67], "expected the sum of part 64 of 67, got that of part 67"),
        ] {
            let error = folded(67, parts).map(drop).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_state_of_another_pass_is_refused() {
        let task = task();
        let row = rows::row(0, &ScatterSum::new(WIDTH + 1).to_bytes()).unwrap();
        let error = fold(&task, 1, None, &row).map(drop).unwrap_err();
        assert_eq!(task.error(error).to_string(), "these bytes are not a stored sum of this kind and size");
    }
}
