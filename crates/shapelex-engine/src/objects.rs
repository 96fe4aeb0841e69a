//! Objects of a store: nothing that was read is used before its length and its content have been checked.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{
    GetOptions, GetResult, GetResultPayload, ObjectMeta, ObjectStore, PutMode, PutOptions, PutPayload,
};

use crate::EngineError;

/// Objects that are removed at the same time.
const AT_ONCE: usize = 4;

/// How long a store may take.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// Number of attempts at a request that fails with an error of the network or of the server.
    pub attempts: u32,
    /// Maximum duration of an attempt.
    pub timeout: Duration,
    /// Pause before the second attempt; it doubles before each further one.
    pub pause: Duration,
}

impl Default for Patience {
    /// Four attempts of a minute each: a part of 8 MB arrives in that time over one megabit per second.
    fn default() -> Self {
        Self { attempts: 4, timeout: Duration::from_secs(60), pause: Duration::from_millis(200) }
    }
}

/// Known length of an object before it is read.
#[derive(Debug, Clone, Copy)]
pub enum Length {
    /// Its size in bytes.
    Exactly(u64),
    /// The maximum size in bytes that is read.
    UpTo(u64),
}

/// Counts of the use of a store, since it was opened.
#[derive(Debug, Default)]
pub struct Counters {
    /// Units of work that were computed from it: parts, or groups of them.
    pub units: AtomicU64,
    /// Units of work that could not be computed.
    pub failures: AtomicU64,
    /// Bytes that were read.
    pub read_bytes: AtomicU64,
    /// Bytes that were written.
    pub written_bytes: AtomicU64,
    /// Requests that were repeated.
    pub retries: AtomicU64,
}

/// An object store, with patience.
#[derive(Clone)]
pub struct Objects {
    store: Arc<dyn ObjectStore>,
    patience: Patience,
    counters: Arc<Counters>,
}

impl fmt::Debug for Objects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.store)
    }
}

impl Objects {
    /// Objects of `store`.
    pub fn new(store: Arc<dyn ObjectStore>, patience: Patience) -> Self {
        Self { store, patience, counters: Arc::default() }
    }

    /// Counts of its use by this process.
    pub fn counters(&self) -> &Arc<Counters> {
        &self.counters
    }

    /// Content of an object.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] if the store announces or sends another length; [`EngineError::Refused`] beyond the maximum; errors
    /// of the store once all attempts have failed.
    pub async fn read(&self, path: &Path, length: Length) -> Result<Bytes, EngineError> {
        self.patiently(path, || self.read_once(path, length)).await
    }

    /// Content of an object whose size and blake3 digest are known.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for other bytes; errors of the store once all attempts have failed.
    pub async fn read_digested(&self, path: &Path, size: u64, digest: &str) -> Result<Bytes, EngineError> {
        let bytes = self.read(path, Length::Exactly(size)).await?;
        let found = blake3::hash(&bytes).to_hex();
        if found.as_str() != digest {
            return Err(EngineError::damaged(path, format!("digest {digest}"), format!("digest {found}")));
        }
        Ok(bytes)
    }

    async fn read_once(&self, path: &Path, length: Length) -> Result<Bytes, EngineError> {
        let answer = self.store.get_opts(path, GetOptions::default()).await;
        let answer = answer.map_err(|source| failed(path, source))?;
        let announced = answer.meta.size;
        match length {
            Length::Exactly(size) if announced != size => {
                return Err(EngineError::damaged(
                    path,
                    format!("{size} bytes"),
                    format!("{announced} bytes"),
                ));
            }
            Length::UpTo(most) if announced > most => {
                return Err(EngineError::refused(
                    path.to_string(),
                    format!("expected at most {most} bytes, got {announced}"),
                ));
            }
            _ => {}
        }
        let bytes = collect(path, answer, announced).await?;
        self.counters.read_bytes.fetch_add(announced, Ordering::Relaxed);
        Ok(bytes)
    }

    /// Size of an object in bytes, if it exists.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn size(&self, path: &Path) -> Result<Option<u64>, EngineError> {
        let ask = || async {
            match self.store.get_opts(path, GetOptions::new().with_head(true)).await {
                Ok(answer) => Ok(Some(answer.meta.size)),
                Err(object_store::Error::NotFound { .. }) => Ok(None),
                Err(source) => Err(failed(path, source)),
            }
        };
        self.patiently(path, ask).await
    }

    /// Writes an object. Returns `false` if `mode` is [`PutMode::Create`] and it exists.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn write(&self, path: &Path, content: Bytes, mode: PutMode) -> Result<bool, EngineError> {
        let write = || async {
            let options = PutOptions { mode: mode.clone(), ..PutOptions::default() };
            match self.store.put_opts(path, PutPayload::from(content.clone()), options).await {
                Ok(_) => {
                    self.counters.written_bytes.fetch_add(content.len() as u64, Ordering::Relaxed);
                    Ok(true)
                }
                Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
                Err(source) => Err(failed(path, source)),
            }
        };
        self.patiently(path, write).await
    }

    /// Removes an object; one that does not exist is not an error.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn remove(&self, path: &Path) -> Result<(), EngineError> {
        let remove = || async {
            let one = futures_util::stream::iter([Ok(path.clone())]).boxed();
            match self.store.delete_stream(one).try_collect::<Vec<_>>().await {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => Ok(()),
                Err(source) => Err(failed(path, source)),
            }
        };
        self.patiently(path, remove).await
    }

    /// Removes all objects below a folder.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn remove_all(&self, folder: &Path) -> Result<(), EngineError> {
        let found = self.list(folder).await?;
        self.remove_each(found.into_iter().map(|object| object.location)).await
    }

    /// Removes objects, a few at a time.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed; some of the objects may be gone.
    pub async fn remove_each(&self, paths: impl IntoIterator<Item = Path>) -> Result<(), EngineError> {
        let remove = |path| async move { self.remove(&path).await };
        futures_util::stream::iter(paths).map(remove).buffered(AT_ONCE).try_collect().await
    }

    /// All objects below a folder.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn list(&self, folder: &Path) -> Result<Vec<ObjectMeta>, EngineError> {
        let list = || async {
            let found = self.store.list(Some(folder)).try_collect::<Vec<_>>().await;
            found.map_err(|source| failed(folder, source))
        };
        self.patiently(folder, list).await
    }

    /// Names of the folders at the top.
    ///
    /// # Errors
    /// Errors of the store once all attempts have failed.
    pub async fn folders(&self) -> Result<Vec<String>, EngineError> {
        let top = Path::default();
        let list = || async {
            let found = self.store.list_with_delimiter(None).await;
            found.map_err(|source| failed(&top, source))
        };
        let found = self.patiently(&top, list).await?;
        Ok(found.common_prefixes.iter().filter_map(|folder| folder.filename().map(String::from)).collect())
    }

    /// Repeats a request that fails for reasons that may pass.
    async fn patiently<T, F: Future<Output = Result<T, EngineError>>>(
        &self,
        path: &Path,
        request: impl Fn() -> F,
    ) -> Result<T, EngineError> {
        let Patience { attempts, timeout, mut pause } = self.patience;
        let mut attempt = 1;
        loop {
            let outcome = tokio::time::timeout(timeout, request()).await;
            let failure = match outcome {
                Ok(Err(error)) if passes(&error) => error,
                Ok(settled) => return settled,
                Err(_) => {
                    EngineError::Slow { object: path.to_string(), seconds: timeout.as_secs_f64(), attempts }
                }
            };
            if attempt >= attempts {
                return Err(failure);
            }
            self.counters.retries.fetch_add(1, Ordering::Relaxed);
            tokio::time::sleep(pause).await;
            (attempt, pause) = (attempt + 1, pause * 2);
        }
    }
}

fn failed(path: &Path, source: object_store::Error) -> EngineError {
    EngineError::Store { object: path.to_string(), source }
}

/// Whether the same request may succeed later.
fn passes(error: &EngineError) -> bool {
    use object_store::Error::{Generic, JoinError};
    matches!(error, EngineError::Store { source: Generic { .. } | JoinError { .. }, .. })
}

/// The bytes of an answer, which must be as many as it announces. Memory is taken as they arrive, never beyond the announced size.
async fn collect(path: &Path, answer: GetResult, announced: u64) -> Result<Bytes, EngineError> {
    let wrong = |got: String| EngineError::damaged(path, format!("{announced} bytes"), got);
    let bytes = match answer.payload {
        GetResultPayload::File(..) => answer.bytes().await.map_err(|source| failed(path, source))?,
        GetResultPayload::Stream(mut stream) => {
            let mut bytes = Vec::new();
            while let Some(piece) = stream.next().await {
                let piece = piece.map_err(|source| failed(path, source))?;
                if (bytes.len() + piece.len()) as u64 > announced {
                    return Err(wrong("more than that".into()));
                }
                bytes.extend_from_slice(&piece);
            }
            bytes.into()
        }
    };
    if bytes.len() as u64 == announced { Ok(bytes) } else { Err(wrong(format!("{} bytes", bytes.len()))) }
}
