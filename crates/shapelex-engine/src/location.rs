//! Where objects are.

use std::sync::Arc;

use object_store::ObjectStore;
use object_store::local::LocalFileSystem;

use crate::EngineError;

/// The store in a folder, which is made if it does not exist. [`Objects`](crate::objects::Objects) take any other store as well.
///
/// # Errors
/// [`EngineError::Refused`] for the address of something else, [`EngineError::Io`] for a folder that cannot be made.
pub fn open(folder: &str) -> Result<Arc<dyn ObjectStore>, EngineError> {
    if folder.is_empty() || folder.contains("://") {
        return Err(EngineError::refused("store", format!("expected a folder, got '{folder}'")));
    }
    std::fs::create_dir_all(folder)?;
    let store = LocalFileSystem::new_with_prefix(folder);
    Ok(Arc::new(store.map_err(|source| EngineError::Store { object: folder.into(), source })?))
}
