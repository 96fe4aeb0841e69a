//! Our operators as bytes, between client, scheduler and executors.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use ballista_core::serde::BallistaPhysicalExtensionCodec;
use datafusion_common::{DataFusionError, Result, internal_datafusion_err, internal_err};
use datafusion_execution::TaskContext;
use datafusion_physical_plan::ExecutionPlan;
use datafusion_proto::physical_plan::{PhysicalExtensionCodec, PhysicalProtoConverterExtension};
use serde::{Deserialize, Serialize};

use crate::objects::Objects;
use crate::pass::fold::FoldExec;
use crate::pass::sum::{Parts, SumExec};
use crate::pass::task::{Description, Task};

/// Begin of the bytes of our operators; those of Ballista are protocol buffers, which do not begin with it.
const MAGIC: &[u8] = b"shapelex";

/// Passes that an executor keeps open: the tasks of a pass arrive one after the other, those of few passes side by side.
const KEPT: usize = 4;

/// An operator, without its input.
#[derive(Serialize, Deserialize)]
#[serde(tag = "operator", rename_all = "snake_case", deny_unknown_fields)]
enum Operator {
    Sum { pass: Description },
    Fold { rows: usize },
}

/// Reads and writes our operators, and those of Ballista.
#[derive(Debug, Default)]
pub struct Codec {
    ballista: BallistaPhysicalExtensionCodec,
    /// The store of an executor; `None` where no parts are read.
    objects: Option<Objects>,
    recent: Mutex<VecDeque<Arc<Task>>>,
}

impl Codec {
    /// The codec of an executor, which reads parts from `objects`.
    pub fn reading(objects: Objects) -> Self {
        Self { objects: Some(objects), ..Self::default() }
    }

    /// The task of this description: one that is open already, if there is one.
    fn task(&self, description: Description) -> Arc<Task> {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(task) = recent.iter().find(|task| task.description == description) {
            return task.clone();
        }
        let task = Arc::new(Task::described(description, self.objects.clone()));
        recent.push_front(task.clone());
        recent.truncate(KEPT);
        task
    }
}

impl PhysicalExtensionCodec for Codec {
    fn try_decode(
        &self,
        bytes: &[u8],
        inputs: &[Arc<dyn ExecutionPlan>],
        context: &TaskContext,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let Some(operator) = bytes.strip_prefix(MAGIC) else {
            return self.ballista.try_decode(bytes, inputs, context, converter);
        };
        let [input] = inputs else { return internal_err!("expected one input, got {}", inputs.len()) };
        let operator =
            serde_json::from_slice(operator).map_err(|error| DataFusionError::External(Box::new(error)))?;
        match operator {
            Operator::Sum { pass } => {
                Ok(Arc::new(SumExec::new(self.task(pass), Parts::Listed(input.clone()))))
            }
            Operator::Fold { rows } => {
                let sum = input.downcast_ref::<SumExec>();
                let sum =
                    sum.ok_or_else(|| internal_datafusion_err!("expected sums, got {}", input.name()))?;
                Ok(Arc::new(FoldExec::new(sum.task.clone(), input.clone(), rows)))
            }
        }
    }

    fn try_encode(
        &self,
        node: Arc<dyn ExecutionPlan>,
        bytes: &mut Vec<u8>,
        converter: &dyn PhysicalProtoConverterExtension,
    ) -> Result<()> {
        let operator = if let Some(sum) = node.downcast_ref::<SumExec>() {
            Operator::Sum { pass: sum.task.description.clone() }
        } else if let Some(fold) = node.downcast_ref::<FoldExec>() {
            Operator::Fold { rows: fold.rows }
        } else {
            return self.ballista.try_encode(node, bytes, converter);
        };
        bytes.extend_from_slice(MAGIC);
        serde_json::to_writer(bytes, &operator).map_err(|error| DataFusionError::External(Box::new(error)))
    }
}
