//! Bodies for readers that wait for bytes: files of other programs are read by libraries that know of no async runtime.
//!
//! A separate thread reads while the body arrives. A channel that holds two chunks connects the two: a slow reader slows the
//! client down.

use std::cell::RefCell;
use std::io::{self, Read};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, ThreadId};
use std::time::Duration;

use bytes::{Buf, Bytes};
use futures_util::future::{Either, select};
use futures_util::{Stream, StreamExt};
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::context::App;
use super::error::ServiceError;
use super::idempotency::Retry;
use super::memory::{Held, Memory, Purpose};
use crate::wire::fault::Fault;
use crate::wire::files::{Asked, FaultKind, FileError, Limits, Source};

/// Time within which the next [`LEAST`] bytes of a body must arrive.
const PAUSE: Duration = Duration::from_secs(30);
/// Number of bytes that keep a body alive: one that trickles would hold a thread for ever.
const LEAST: usize = 128 << 10;
/// Number of chunks between body and reader.
const CHUNKS: usize = 2;
/// Memory of a reader beside the held part of the file: chunks, and records on their way.
const FIXED: usize = 12 << 20;
/// Time for which streams may continue when the service is stopping.
const STOPPING: Duration = Duration::from_secs(5);

/// A part of a body.
enum Piece {
    Bytes(Bytes),
    /// The body has ended as it should.
    End,
}

/// A body as a blocking reader.
struct BodyReader {
    pieces: mpsc::Receiver<Piece>,
    current: Bytes,
    has_ended: bool,
    stop: Stop,
    memory: Memory,
}

/// Tells a reader that the client has gone, or that its time is over, so that it can end.
#[derive(Debug, Clone)]
pub struct Stop(Arc<Signal>);

#[derive(Debug)]
struct Signal {
    is_set: AtomicBool,
    overran: AtomicBool,
    /// Number of looks.
    looks: AtomicU32,
    /// The thread that reads, and its processor time when it began, in microseconds: it reads one file after the other.
    begun: OnceLock<(ThreadId, u64)>,
    /// Processor time that the reading may take.
    most: Duration,
}

/// Number of looks between two at the clock, which is asked of the kernel.
const LOOKS: u32 = 64;

impl Stop {
    fn new(most: Duration) -> Self {
        let (is_set, overran) = (AtomicBool::new(false), AtomicBool::new(false));
        Self(Arc::new(Signal { is_set, overran, looks: AtomicU32::new(0), begun: OnceLock::new(), most }))
    }

    /// Begins to count the time of this thread.
    fn begin(&self) {
        let _ = self.0.begun.set((thread::current().id(), thread_micros()));
    }

    /// Whether the client has gone, or the thread that reads has taken more than its time.
    pub fn is_set(&self) -> bool {
        let signal = &*self.0;
        let looks_at_clock = signal.looks.fetch_add(1, Ordering::Relaxed).is_multiple_of(LOOKS);
        if looks_at_clock && self.taken() > signal.most {
            signal.overran.store(true, Ordering::Relaxed);
            signal.is_set.store(true, Ordering::Relaxed);
        }
        signal.is_set.load(Ordering::Relaxed)
    }

    /// Processor time of the reading; threads that help know nothing of it.
    fn taken(&self) -> Duration {
        match self.0.begun.get() {
            Some((reader, begun)) if *reader == thread::current().id() => {
                Duration::from_micros(thread_micros().saturating_sub(*begun))
            }
            _ => Duration::ZERO,
        }
    }

    /// The outcome of a reading, which may have ended because its time was over.
    fn judged<T>(&self, outcome: Result<T, ServiceError>) -> Result<T, ServiceError> {
        match outcome {
            Err(_) if self.0.overran.load(Ordering::Relaxed) => {
                Err(ServiceError::TookTooLong { seconds: self.0.most.as_secs() })
            }
            outcome => outcome,
        }
    }
}

/// Processor time of this thread in microseconds.
#[cfg(target_os = "linux")]
fn thread_micros() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec.unsigned_abs() * 1_000_000 + time.tv_nsec.unsigned_abs() / 1000
}

/// Processor time of this thread, for which other systems have other calls: their readings end with their client only.
#[cfg(not(target_os = "linux"))]
fn thread_micros() -> u64 {
    0
}

/// Sets a [`Stop`] when it is dropped.
struct Guard(Stop);

impl Drop for Guard {
    fn drop(&mut self) {
        self.0.0.is_set.store(true, Ordering::Relaxed);
    }
}

impl BodyReader {
    /// The file that the body is. If it is compressed, its content beyond the bytes that arrived is charged as well.
    ///
    /// # Errors
    /// Those of the first bytes.
    fn source(self, limits: Limits) -> Result<Source<'static>, FileError> {
        let memory = self.memory.clone();
        let held: RefCell<(Option<Held>, usize, usize)> = RefCell::default();
        let ask = move |asked: Asked| {
            let (room, content, beside) = &mut *held.borrow_mut();
            match asked {
                Asked::Content(bytes) => *content = limits.memory(bytes).max(*content),
                Asked::Beside(bytes) => *beside = bytes.max(*beside),
            }
            let needed = content.saturating_add(*beside);
            match room {
                Some(room) => room.grow_to(needed)?,
                None => *room = Some(memory.hold(Purpose::Bodies, needed)?),
            }
            Ok(())
        };
        let asked = move |asked| {
            ask(asked).map_err(|error: ServiceError| match error {
                ServiceError::Overloaded(detail) => FileError::new(FaultKind::Memory, detail),
                other => FileError::new(FaultKind::TooLarge, other.to_string()),
            })
        };
        Ok(Source::new(self, limits)?.asking(asked))
    }
}

impl Read for BodyReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.current.is_empty() && !self.has_ended {
            match self.pieces.blocking_recv() {
                Some(Piece::Bytes(bytes)) => self.current = bytes,
                Some(Piece::End) => self.has_ended = true,
                // A body that broke off must not pass for a short file. Its own error is answered.
                None => return Err(io::Error::other("the body ended early")),
            }
        }
        if self.stop.is_set() {
            return Err(io::Error::other("the client has gone"));
        }
        let count = buffer.len().min(self.current.len());
        self.current.copy_to_slice(&mut buffer[..count]);
        Ok(count)
    }
}

/// Reads a file on a separate thread while its body arrives; the [`Stop`] is set when the client has gone. The bytes are added
/// to `retry`.
///
/// # Errors
/// A body that stalls, breaks off or takes more memory than there is; [`ServiceError::Unavailable`] if the service stops;
/// errors of `read`. They end the reading.
pub async fn read_incoming<T: Send + 'static>(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    limits: Limits,
    retry: &mut Option<Retry>,
    read: impl FnOnce(Source<'static>, Stop) -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    let (sender, pieces) = mpsc::channel(CHUNKS);
    let stop = Stop::new(app.limits.compute_time);
    let _guard = Guard(stop.clone());
    let memory = app.memory.clone();
    let body = BodyReader { pieces, current: Bytes::new(), has_ended: false, stop: stop.clone(), memory };
    let reading = pin!(app.pool.read_blocking(move || {
        stop.begin();
        stop.judged(body.source(limits).map_err(Into::into).and_then(|source| read(source, stop.clone())))
    }));
    let passing = pin!(pass(app, stream, limits, retry, sender));
    let both = async {
        match select(reading, passing).await {
            // Bytes after a file, such as the padding of an archive, belong to the request too.
            Either::Left((read, passing)) => {
                let value = read?;
                passing.await?;
                Ok(value)
            }
            Either::Right((passed, reading)) => {
                passed?;
                reading.await
            }
        }
    };
    tokio::select! {
        done = both => done,
        () = stopped(app) => Err(ServiceError::Unavailable(
            "the service is stopping: nothing of the file is kept, send it again".into(),
        )),
    }
}

/// Completes when the service is stopping and the grace period of streams is over.
pub async fn stopped(app: &App) {
    app.stopping().await;
    tokio::time::sleep(STOPPING).await;
}

/// Passes a body on to its reader. Once that has ended, the rest is only counted.
async fn pass(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    limits: Limits,
    retry: &mut Option<Retry>,
    sender: mpsc::Sender<Piece>,
) -> Result<(), ServiceError> {
    let mut stream = pin!(stream);
    let mut room = app.memory.hold(Purpose::Bodies, FIXED)?;
    let (mut total, mut arrived, mut after, mut end) = (0_usize, 0, 0, Instant::now() + PAUSE);
    loop {
        let piece = tokio::time::timeout_at(end, stream.next()).await.map_err(|_| stalled())?;
        let Some(bytes) = piece.transpose()? else { break };
        arrived += bytes.len();
        total = total.saturating_add(bytes.len());
        room.resize(FIXED.saturating_add(limits.memory(total)))?;
        if let Some(retry) = retry {
            retry.update(&bytes);
        }
        if sender.is_closed() && arrived_after(&mut after, bytes.len()) > limits.held {
            let detail =
                format!("expected the end of the body after the file, got more than {} bytes", limits.held);
            return Err(ServiceError::TooLarge(Fault::new("", detail).into()));
        }
        let begun = Instant::now();
        // The reader may have ended before the body.
        let _ = sender.send(Piece::Bytes(bytes)).await;
        // The time in which the reader was busy is not that of the client.
        end += begun.elapsed();
        if arrived >= LEAST {
            (arrived, end) = (0, Instant::now() + PAUSE);
        }
    }
    let _ = sender.send(Piece::End).await;
    // The memory is that of the reader, until it has ended.
    sender.closed().await;
    Ok(())
}

/// Number of bytes that have arrived after the end of the reading.
fn arrived_after(after: &mut usize, more: usize) -> usize {
    *after = after.saturating_add(more);
    *after
}

fn stalled() -> ServiceError {
    ServiceError::Interrupted(format!("expected {LEAST} bytes within {} s, got fewer", PAUSE.as_secs()))
}
