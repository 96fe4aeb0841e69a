//! Where objects are.

use std::sync::Arc;

use object_store::ObjectStore;
use object_store::local::LocalFileSystem;

use crate::EngineError;

/// The store in a folder, which is made if it does not exist, or, with the feature `s3`, in a bucket: `s3://bucket/folder`, with
/// credentials, region and endpoint from the variables `AWS_…`. [`Objects`](crate::objects::Objects) take any other store as well.
///
/// # Errors
/// [`EngineError::Refused`] for the address of something else, [`EngineError::Io`] for a folder that cannot be made.
pub fn open(store: &str) -> Result<Arc<dyn ObjectStore>, EngineError> {
    #[cfg(feature = "s3")]
    if store.starts_with("s3://") {
        return bucket(store);
    }
    if store.is_empty() || store.contains("://") {
        let expected = if cfg!(feature = "s3") { "a folder or s3://bucket/folder" } else { "a folder" };
        return Err(EngineError::refused("store", format!("expected {expected}, got '{store}'")));
    }
    std::fs::create_dir_all(store)?;
    let opened = LocalFileSystem::new_with_prefix(store);
    Ok(Arc::new(opened.map_err(|source| EngineError::Store { object: store.into(), source })?))
}

#[cfg(feature = "s3")]
fn bucket(store: &str) -> Result<Arc<dyn ObjectStore>, EngineError> {
    use object_store::aws::AmazonS3Builder;
    use object_store::prefix::PrefixStore;

    let name = store.trim_start_matches("s3://");
    let (bucket, folder) = name.split_once('/').unwrap_or((name, ""));
    let opened = AmazonS3Builder::from_env().with_bucket_name(bucket).build();
    let opened = opened.map_err(|source| EngineError::Store { object: store.into(), source })?;
    let folder = folder.trim_matches('/');
    if folder.is_empty() {
        return Ok(Arc::new(opened));
    }
    Ok(Arc::new(PrefixStore::new(opened, folder)))
}
