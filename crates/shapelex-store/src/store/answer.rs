//! Return types of methods of the store.

use std::pin::Pin;

use super::error::StoreError;

/// Work of a method of the store, with its result.
///
/// The body of an `async fn` in an `impl` is compiled where it is awaited, which is in the crate above. Behind a pointer it is compiled
/// here, once, with the queries it makes. The allocation is nothing beside a statement.
pub type Work<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// [`Work`] that can fail.
pub type Answer<'a, T, E = StoreError> = Work<'a, Result<T, E>>;
