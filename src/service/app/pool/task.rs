//! Tasks of the pool, whatever they return: queues, channels and waiting are compiled once, not for each task. Generic code
//! only boxes a task and opens its outcome.

use std::any::Any;
use std::marker::PhantomData;
use std::pin::Pin;
use std::task::{Context, Poll};

use crate::service::app::error::ServiceError;
use crate::service::app::work::Work;

/// Outcome of any task.
pub(super) type AnyOutcome = Result<Box<dyn Any + Send>, ServiceError>;

/// A task with any outcome.
pub(super) type Task = Box<dyn FnOnce() -> AnyOutcome + Send>;

/// Reads a body, with any outcome.
pub(super) type Reading = Box<dyn FnOnce(&[u8]) -> AnyOutcome + Send>;

/// Reads a body and makes a task of it, with its work.
pub(super) type Planning = Box<dyn FnOnce(&[u8]) -> Result<(Work, Task), ServiceError> + Send>;

/// `task` without the type of its outcome.
pub(super) fn boxed<T: Send + 'static>(
    task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
) -> Task {
    Box::new(move || task().map(any))
}

/// `value` without its type.
pub(super) fn any<T: Send + 'static>(value: T) -> Box<dyn Any + Send> {
    Box::new(value)
}

/// The outcome, a `T`, of a task that runs elsewhere.
#[must_use = "a task runs only while somebody waits for it"]
pub struct Outcome<'a, T> {
    waiting: Pin<Box<dyn Future<Output = AnyOutcome> + Send + 'a>>,
    outcome: PhantomData<fn() -> T>,
}

impl<'a, T> Outcome<'a, T> {
    /// Outcome of a task that was boxed as one of a `T`.
    pub(super) fn of(waiting: impl Future<Output = AnyOutcome> + Send + 'a) -> Self {
        Self { waiting: Box::pin(waiting), outcome: PhantomData }
    }
}

impl<T: 'static> Future for Outcome<'_, T> {
    type Output = Result<T, ServiceError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        self.waiting.as_mut().poll(context).map(|outcome| outcome.map(opened))
    }
}

impl<T> std::fmt::Debug for Outcome<'_, T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Outcome").finish_non_exhaustive()
    }
}

fn opened<T: 'static>(value: Box<dyn Any + Send>) -> T {
    *value.downcast().expect("the outcome of a task has the type that it was boxed with")
}
