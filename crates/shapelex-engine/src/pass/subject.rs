//! The shapes of a pass, and the runner that computes it.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use futures_util::future::BoxFuture;

use super::engine::Took;
use super::work::Work;
use crate::EngineError;
use crate::cohort::revision::{Revision, Setting};
use crate::dictionary::Named;

/// The shapes of a pass, with the metric and the dictionary that it needs.
#[derive(Debug, Clone)]
pub struct Subject {
    /// The shapes.
    pub revision: Arc<Revision>,
    /// Their metric and alignment.
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
    /// The result of a pass over a revision, serialised, and its counts.
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
