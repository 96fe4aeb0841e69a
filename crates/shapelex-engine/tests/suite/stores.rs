//! Object stores that misbehave.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};

/// What a store does wrong when a part is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// Answers 503 so many times.
    Unavailable(usize),
    /// Answers after so many milliseconds.
    Late(u64),
    /// Sends so many bytes less than it announces.
    SendsLess(usize),
    /// Sends so many bytes more than it announces.
    SendsMore(usize),
    /// Announces so many bytes more than there are, and sends what there is.
    AnnouncesMore(u64),
    /// Breaks off in the middle, once.
    BreaksOff,
    /// Turns one bit.
    TurnsABit,
    /// Refuses to write: the disk is full.
    Full,
}

/// A store that does something wrong with parts.
#[derive(Debug)]
pub(crate) struct Misbehaving {
    pub(crate) inner: Arc<InMemory>,
    pub(crate) fault: Fault,
    /// Number of reads of parts.
    pub(crate) reads: AtomicUsize,
}

impl Misbehaving {
    pub(crate) fn new(inner: Arc<InMemory>, fault: Fault) -> Arc<Self> {
        Arc::new(Self { inner, fault, reads: AtomicUsize::new(0) })
    }

    async fn bend(&self, read: usize, mut answer: GetResult) -> Result<GetResult> {
        let (meta, range, attributes) =
            (answer.meta.clone(), answer.range.clone(), answer.attributes.clone());
        if let Fault::AnnouncesMore(bytes) = self.fault {
            answer.meta.size += bytes;
            return Ok(answer);
        }
        let mut bytes = answer.bytes().await?.to_vec();
        let mut pieces = Vec::new();
        match self.fault {
            Fault::SendsLess(less) => bytes.truncate(bytes.len() - less),
            Fault::SendsMore(more) => bytes.extend(vec![0; more]),
            Fault::TurnsABit => {
                let middle = bytes.len() / 2;
                bytes[middle] ^= 1;
            }
            Fault::BreaksOff if read == 0 => {
                bytes.truncate(bytes.len() / 2);
                pieces.push(Err(generic("connection reset")));
            }
            _ => {}
        }
        pieces.insert(0, Ok(Bytes::from(bytes)));
        let payload = GetResultPayload::Stream(futures_util::stream::iter(pieces).boxed());
        Ok(GetResult { payload, meta, range, attributes })
    }
}

fn generic(detail: &str) -> object_store::Error {
    object_store::Error::Generic { store: "test", source: detail.into() }
}

impl fmt::Display for Misbehaving {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Misbehaving({:?})", self.fault)
    }
}

#[async_trait]
impl ObjectStore for Misbehaving {
    async fn put_opts(&self, path: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        if self.fault == Fault::Full {
            return Err(generic("No space left on device (os error 28)"));
        }
        self.inner.put_opts(path, payload, options).await
    }

    async fn put_multipart_opts(
        &self,
        path: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.inner.put_multipart_opts(path, options).await
    }

    async fn get_opts(&self, path: &Path, options: GetOptions) -> Result<GetResult> {
        if !path.as_ref().ends_with(".parquet") || options.head {
            return self.inner.get_opts(path, options).await;
        }
        let read = self.reads.fetch_add(1, Ordering::Relaxed);
        match self.fault {
            Fault::Unavailable(times) if read < times => Err(generic("503 Service Unavailable")),
            Fault::Late(milliseconds) => {
                tokio::time::sleep(Duration::from_millis(milliseconds)).await;
                self.inner.get_opts(path, options).await
            }
            _ => self.bend(read, self.inner.get_opts(path, options).await?).await,
        }
    }

    fn delete_stream(&self, paths: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        self.inner.delete_stream(paths)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}
