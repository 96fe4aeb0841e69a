//! The audit trail of all requests: written behind them in groups, read by administrators.
//!
//! Entries go through a bounded channel to the one task that writes them, and a full channel makes requests wait: none is
//! ever dropped. What waits for nobody lies at most `GROUP_TIME` in memory; who must know that the entry is on disk has
//! its group written at once.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep, timeout, timeout_at};

use super::cohorts::Page;
use super::{App, ServiceError, metrics, now_ms};
use crate::domain::audit::{AuditFilter, Entry, Recorded};
use crate::store::Store;

/// Entries that may wait to be written.
const CHANNEL: usize = 4096;
/// Most entries of a transaction.
const GROUP: usize = 512;
/// Longest time until a group is written.
const GROUP_TIME: Duration = Duration::from_millis(100);
/// Time between attempts to write a group that the store did not take.
const PAUSE: Duration = Duration::from_secs(1);
/// Longest time that a request waits for its entry; an answer later than this helps nobody.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest time for the last entries when the service stops.
const CLOSE: Duration = Duration::from_secs(5);
/// How often old entries are removed.
const PRUNE: Duration = Duration::from_secs(24 * 3600);
/// Milliseconds of a day.
const DAY_MS: i64 = 24 * 3600 * 1000;

/// Most objects that the entry of one request names beside those of its path.
const MAX_TOUCHED: usize = 32;

/// The objects that a request turns out to be about, whatever it called them: noted where they are found.
#[derive(Debug, Clone, Default)]
pub struct Touched(Arc<Mutex<BTreeMap<String, String>>>);

impl Touched {
    /// Notes the id of an object; a second one of the same kind as `kind.2`, and so on.
    pub fn note(&self, kind: &str, id: &str) {
        let mut ids = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let places = (1..=MAX_TOUCHED).map(|k| if k == 1 { kind.to_owned() } else { format!("{kind}.{k}") });
        for place in places {
            match ids.get(&place) {
                Some(known) if known == id => return,
                Some(_) => {}
                None => {
                    ids.insert(place, id.to_owned());
                    return;
                }
            }
        }
    }

    /// What was noted.
    pub fn ids(&self) -> BTreeMap<String, String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

enum Message {
    Entry(Box<Entry>, Option<oneshot::Sender<()>>),
    Close(oneshot::Sender<()>),
}

/// The way into the audit trail. Nothing is recorded before [`Trail::start`].
#[derive(Debug, Default)]
pub struct Trail {
    channel: OnceLock<mpsc::Sender<Message>>,
}

impl Trail {
    /// Starts to write what is recorded, and to remove what is older than `days`.
    ///
    /// Must be called on an async runtime; a second call changes nothing.
    pub fn start(&self, store: &Store, days: u32) {
        self.channel.get_or_init(|| {
            let (sender, receiver) = mpsc::channel(CHANNEL);
            tokio::spawn(Writer { store: store.clone(), messages: receiver }.serve());
            tokio::spawn(prune(store.clone(), days, sender.clone()));
            sender
        });
    }

    /// Records a request; waits while too many wait to be written.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] when the trail cannot be written.
    pub async fn record(&self, entry: Entry) -> Result<(), ServiceError> {
        self.send(entry, None).await
    }

    /// Records a request and waits until the entry is on disk.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] when the trail cannot be written.
    pub async fn record_surely(&self, entry: Entry) -> Result<(), ServiceError> {
        if self.channel.get().is_none() {
            return Ok(());
        }
        let (written, on_disk) = oneshot::channel();
        self.send(entry, Some(written)).await?;
        match timeout(PATIENCE, on_disk).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(unavailable()),
        }
    }

    async fn send(&self, mut entry: Entry, written: Option<oneshot::Sender<()>>) -> Result<(), ServiceError> {
        let Some(channel) = self.channel.get() else { return Ok(()) };
        for text in [&mut entry.key, &mut entry.subject].into_iter().flatten() {
            // PostgreSQL does not store it, and a group that is never taken would hold up all others.
            *text = text.replace('\0', "\u{fffd}");
        }
        let message = Message::Entry(Box::new(entry), written);
        channel.send_timeout(message, PATIENCE).await.map_err(|_| unavailable())
    }

    /// Writes what was recorded so far; later entries are refused.
    pub async fn close(&self) {
        let Some(channel) = self.channel.get() else { return };
        let (closed, done) = oneshot::channel();
        let closing = async {
            if channel.send(Message::Close(closed)).await.is_ok() {
                // Also ends when the writer does.
                let _ = done.await;
            }
        };
        if timeout(CLOSE, closing).await.is_err() {
            tracing::error!("the last entries of the audit trail could not be written");
        }
    }
}

fn unavailable() -> ServiceError {
    ServiceError::Unavailable(
        "the audit trail cannot be written; what was asked for may have been done all the same".into(),
    )
}

/// Writes entries in groups.
struct Writer {
    store: Store,
    messages: mpsc::Receiver<Message>,
}

/// Entries that are written together.
#[derive(Default)]
struct Group {
    entries: Vec<Entry>,
    waiting: Vec<oneshot::Sender<()>>,
    closing: Option<oneshot::Sender<()>>,
}

impl Group {
    fn take(&mut self, message: Message) {
        match message {
            Message::Entry(entry, waiting) => {
                self.entries.push(*entry);
                self.waiting.extend(waiting);
            }
            Message::Close(closing) => self.closing = Some(closing),
        }
    }

    fn is_full(&self) -> bool {
        self.entries.len() >= GROUP || self.closing.is_some()
    }
}

impl Writer {
    async fn serve(mut self) {
        loop {
            let group = self.group().await;
            self.write(&group.entries).await;
            for waiting in group.waiting {
                // Whoever waited may have gone away.
                let _ = waiting.send(());
            }
            if let Some(closing) = group.closing {
                self.messages.close();
                let _ = closing.send(());
                return;
            }
        }
    }

    /// What is there when the first entry has lain for its time, or when somebody waits for one.
    async fn group(&mut self) -> Group {
        let mut group = Group::default();
        let Some(first) = self.messages.recv().await else {
            return std::future::pending().await;
        };
        group.take(first);
        let end = Instant::now() + GROUP_TIME;
        while group.waiting.is_empty() && !group.is_full() {
            match timeout_at(end, self.messages.recv()).await {
                Ok(Some(message)) => group.take(message),
                _ => break,
            }
        }
        while !group.is_full()
            && let Ok(message) = self.messages.try_recv()
        {
            group.take(message);
        }
        metrics::audit_waits(group.entries.len() + self.messages.len());
        group
    }

    /// Writes until it is written.
    async fn write(&self, entries: &[Entry]) {
        while let Err(error) = self.store.append_audit(entries).await {
            let error = ServiceError::from(error);
            tracing::error!(
                error = error.cause(),
                entries = entries.len(),
                "the audit trail cannot be written; it is tried again"
            );
            metrics::audit_failed();
            sleep(PAUSE).await;
        }
        metrics::audit_written(entries.len());
        metrics::audit_waits(self.messages.len());
    }
}

/// Removes what is too old, until the trail is closed.
async fn prune(store: Store, days: u32, channel: mpsc::Sender<Message>) {
    loop {
        match store.prune_audit(now_ms() - i64::from(days) * DAY_MS).await {
            Ok(0) => {}
            Ok(removed) => tracing::info!(removed, "old entries of the audit trail were removed"),
            Err(error) => {
                let error = ServiceError::from(error);
                tracing::warn!(error = error.cause(), "old entries of the audit trail could not be removed");
            }
        }
        tokio::select! {
            () = sleep(PRUNE) => {}
            () = channel.closed() => return,
        }
    }
}

/// Entries of the trail of the caller's tenant that match `filter`, in their order, behind `cursor` (the place of the last
/// one seen).
///
/// # Errors
/// A cursor that is not one.
pub async fn list(
    app: &App,
    filter: &AuditFilter,
    cursor: Option<&str>,
    limit: usize,
) -> Result<Page<Recorded>, ServiceError> {
    let mut items = list_after(app, filter, place(cursor)?, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].sequence.to_string());
    items.truncate(limit);
    Ok((items, next))
}

/// The place that a cursor stands for.
///
/// # Errors
/// A cursor that is not one.
pub fn place(cursor: Option<&str>) -> Result<u64, ServiceError> {
    let place = cursor.map(str::parse).transpose();
    let place = place.map_err(|_| ServiceError::Query("cursor is not one of this list".into()))?;
    Ok(place.unwrap_or(0))
}

/// At most `limit` entries behind a place.
///
/// # Errors
/// Those of the store.
pub async fn list_after(
    app: &App,
    filter: &AuditFilter,
    after: u64,
    limit: usize,
) -> Result<Vec<Recorded>, ServiceError> {
    Ok(app.store.list_audit(&app.principal.tenant, filter, after, limit).await?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::Limits;

    fn entry(number: usize) -> Entry {
        Entry {
            at_ms: now_ms(),
            tenant: "default".into(),
            request_id: number.to_string(),
            ..Entry::default()
        }
    }

    async fn app() -> (tempfile::TempDir, App) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        (folder, App::new(store, Limits::default(), 1))
    }

    async fn recorded(app: &App) -> Vec<String> {
        let found = list_after(app, &AuditFilter::default(), 0, 10_000).await.unwrap();
        found.into_iter().map(|recorded| recorded.entry.request_id).collect()
    }

    #[test]
    fn objects_are_noted_once_each() {
        let touched = Touched::default();
        for id in ["coh_1", "coh_2", "coh_1", "coh_3"] {
            touched.note("cohort_id", id);
        }
        touched.note("shape_id", "shp_1");
        let found: Vec<(String, String)> = touched.ids().into_iter().collect();
        let wanted = [
            ("cohort_id", "coh_1"),
            ("cohort_id.2", "coh_2"),
            ("cohort_id.3", "coh_3"),
            ("shape_id", "shp_1"),
        ];
        assert_eq!(found, wanted.map(|(kind, id)| (kind.to_owned(), id.to_owned())));
        for k in 0..1000 {
            touched.note("cohort_id", &k.to_string());
        }
        assert_eq!(touched.ids().len(), MAX_TOUCHED + 1);
    }

    #[tokio::test]
    async fn who_waits_has_the_entry_on_disk_and_those_before_it() {
        let (_folder, app) = app().await;
        app.trail.start(&app.store, 1);
        app.trail.record(entry(0)).await.unwrap();
        app.trail.record_surely(entry(1)).await.unwrap();
        assert_eq!(recorded(&app).await, ["0", "1"]);
    }

    #[tokio::test]
    async fn more_than_a_channel_and_a_group_of_entries_arrive_in_their_order_before_it_closes() {
        let (_folder, app) = app().await;
        app.trail.start(&app.store, 1);
        let count = CHANNEL + GROUP + 7;
        for number in 0..count {
            app.trail.record(entry(number)).await.unwrap();
        }
        app.trail.close().await;
        assert_eq!(recorded(&app).await, (0..count).map(|number| number.to_string()).collect::<Vec<_>>());
        assert!(matches!(app.trail.record_surely(entry(0)).await, Err(ServiceError::Unavailable(_))));
    }

    #[tokio::test]
    async fn many_at_once_are_all_written() {
        let (_folder, app) = app().await;
        app.trail.start(&app.store, 1);
        let record = |number| {
            let trail = Arc::clone(&app.trail);
            tokio::spawn(async move { trail.record_surely(entry(number)).await })
        };
        for task in (0..200).map(record).collect::<Vec<_>>() {
            task.await.unwrap().unwrap();
        }
        let mut found = recorded(&app).await;
        found.sort_by_key(|number| number.parse::<usize>().unwrap());
        assert_eq!(found, (0..200).map(|number| number.to_string()).collect::<Vec<_>>());
        assert_eq!(app.store.check_audit().await.unwrap().entries, 200);
    }

    #[tokio::test]
    async fn what_is_too_old_goes_when_the_service_starts() {
        let (_folder, app) = app().await;
        let old = Entry { at_ms: now_ms() - 2 * DAY_MS, ..entry(0) };
        app.store.append_audit(&[old, entry(1)]).await.unwrap();
        app.trail.start(&app.store, 1);
        let start = Instant::now();
        while recorded(&app).await != ["1"] {
            assert!(start.elapsed() < Duration::from_secs(10));
            sleep(Duration::from_millis(5)).await;
        }
        // A character that PostgreSQL does not store.
        let odd = Entry { subject: Some("a\0b".into()), ..entry(2) };
        app.trail.record_surely(odd).await.unwrap();
        assert_eq!(recorded(&app).await, ["1", "2"]);
    }
}
