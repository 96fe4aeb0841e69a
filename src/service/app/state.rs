//! State that a use case keeps for the life of the process, looked up by its type.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

type Entries = HashMap<TypeId, Arc<dyn Any + Send + Sync>>;

/// At most one value per type; only the owner of a type can name it.
#[derive(Debug, Clone, Default)]
pub(super) struct State(Arc<RwLock<Entries>>);

impl State {
    /// Value of this type; created by default on first use.
    pub(super) fn get<T: Default + Send + Sync + 'static>(&self) -> Arc<T> {
        self.find().unwrap_or_else(|| {
            let mut entries = self.0.write().unwrap_or_else(PoisonError::into_inner);
            let entry = entries.entry(TypeId::of::<T>()).or_insert_with(|| Arc::new(T::default()));
            Arc::clone(entry).downcast().unwrap_or_default()
        })
    }

    /// Replaces the value of this type.
    pub(super) fn put<T: Send + Sync + 'static>(&self, value: T) {
        let mut entries = self.0.write().unwrap_or_else(PoisonError::into_inner);
        entries.insert(TypeId::of::<T>(), Arc::new(value));
    }

    fn find<T: Send + Sync + 'static>(&self) -> Option<Arc<T>> {
        let entries = self.0.read().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(entries.get(&TypeId::of::<T>())?).downcast().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_made_once_and_shared_by_clones() {
        let state = State::default();
        let first: Arc<Vec<u8>> = state.get();
        assert!(Arc::ptr_eq(&first, &state.clone().get()));
        state.clone().put(vec![7_u8]);
        assert_eq!(*state.get::<Vec<u8>>(), [7]);
        assert_eq!(*state.get::<String>(), "");
    }
}
