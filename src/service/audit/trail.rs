//! Audit trail of all requests: written in groups in the background, read by administrators.
//!
//! Entries pass through a bounded channel to a single writer task; a full channel makes requests wait. Entries are
//! flushed at least every `GROUP_TIME`. A caller that needs durability triggers an immediate flush.
//!
//! While the store accepts no entries, for example on a full disk, changes are refused ([`Trail::check`]) and reads
//! continue. Once the channel is full, reads are answered without an entry and counted by tenant; when the store
//! accepts entries again, one entry per tenant records that count. Where every read must be recorded (`required` of
//! [`Trail::start`]), reads are refused instead.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::mpsc::error::{SendTimeoutError, TrySendError};
use tokio::sync::{Notify, mpsc, oneshot};
use tokio::time::{Instant, sleep, timeout};

use super::refusals::{MANY, Refusals, counted};
use crate::domain::audit::{AuditFilter, Entry, Recorded};
use crate::service::app::{App, Page, ServiceError, metrics, now_ms};
use crate::store::Store;

/// Capacity of the channel to the writer.
const CHANNEL: usize = 4096;
/// Maximum number of entries per transaction.
const GROUP: usize = 512;
/// Maximum time until a group is written.
const GROUP_TIME: Duration = Duration::from_millis(100);
/// Time between attempts to write a group that the store has refused.
const PAUSE: Duration = Duration::from_secs(1);
/// Maximum time for which a request waits for its entry; a later response is of no use to the client.
const PATIENCE: Duration = Duration::from_secs(10);
/// Maximum time for writing the last entries at shutdown.
const CLOSE: Duration = Duration::from_secs(5);
/// Interval at which summaries of completed minutes are collected.
const SUM_UP: Duration = Duration::from_secs(5);
/// Minimum time between two log lines about a trail that cannot be written.
const QUIET: Duration = Duration::from_secs(10);
/// Minimum age in milliseconds of entries that an administrator can remove: an intruder with a stolen key cannot erase
/// the traces of the same day.
pub const MIN_AGE_MS: i64 = DAY_MS;
const DAY_MS: i64 = 24 * 3600 * 1000;

enum Message {
    Entry(Box<Entry>, Option<oneshot::Sender<()>>),
    Close(oneshot::Sender<()>),
}

/// Outcome of recording a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recording {
    /// The entry is written, or will be.
    Kept,
    /// The trail cannot be written: the request is only counted.
    Counted,
}

/// Entrance of the audit trail. Nothing is recorded before [`Trail::start`].
#[derive(Debug, Default)]
pub struct Trail {
    channel: OnceLock<mpsc::Sender<Message>>,
    refusals: Refusals,
    state: Arc<State>,
}

/// State of the trail, shared by the writer and its callers.
#[derive(Debug, Default)]
struct State {
    /// Whether the last attempt to write failed.
    failing: AtomicBool,
    /// Whether reads that cannot be recorded are refused.
    required: AtomicBool,
    /// Signals that a group should be written at once.
    due: Notify,
    /// Requests without an entry, by tenant.
    gaps: Mutex<BTreeMap<String, Gap>>,
}

/// Requests of one tenant without an entry.
#[derive(Debug, Clone, Copy)]
struct Gap {
    count: u64,
    first_ms: i64,
    last_ms: i64,
}

impl State {
    fn is_failing(&self) -> bool {
        self.failing.load(Ordering::Relaxed)
    }

    fn gaps(&self) -> MutexGuard<'_, BTreeMap<String, Gap>> {
        self.gaps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a request instead of recording it.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] if every request must be recorded.
    fn count(&self, entry: &Entry) -> Result<Recording, ServiceError> {
        if self.required.load(Ordering::Relaxed) {
            return Err(unavailable());
        }
        let fresh = Gap { count: 0, first_ms: entry.at_ms, last_ms: entry.at_ms };
        let mut gaps = self.gaps();
        let gap = gaps.entry(entry.tenant.clone()).or_insert(fresh);
        (gap.count, gap.last_ms) = (gap.count + 1, gap.last_ms.max(entry.at_ms));
        metrics::audit_lost();
        Ok(Recording::Counted)
    }

    /// Entries for the requests that were only counted.
    fn gap_entries(&self) -> Vec<Entry> {
        let gaps = std::mem::take(&mut *self.gaps());
        let entry = |(tenant, gap): (String, Gap)| {
            tracing::error!(
                count = gap.count,
                "reads are missing from the audit trail because it could not be written"
            );
            Entry {
                at_ms: gap.last_ms,
                tenant,
                method: MANY.to_owned(),
                objects: counted(
                    gap.count,
                    gap.first_ms,
                    gap.last_ms,
                    [("unrecorded".to_owned(), gap.count)],
                ),
                ..Entry::default()
            }
        };
        gaps.into_iter().map(entry).collect()
    }
}

impl App {
    /// The audit trail of this process.
    pub fn trail(&self) -> Arc<Trail> {
        self.state()
    }
}

impl Trail {
    /// Starts the writer. `required`: requests that cannot be recorded are refused, including those that only read.
    ///
    /// Must be called on an async runtime; a second call has no effect.
    pub fn start(self: &Arc<Self>, store: &Store, required: bool) {
        self.channel.get_or_init(|| {
            let (sender, messages) = mpsc::channel(CHANNEL);
            self.state.required.store(required, Ordering::Relaxed);
            tokio::spawn(Writer { store: store.clone(), messages, state: Arc::clone(&self.state) }.serve());
            tokio::spawn(sum_up(Arc::clone(self), sender.clone()));
            sender
        });
    }

    /// Counts of requests without a known caller.
    pub fn refusals(&self) -> &Refusals {
        &self.refusals
    }

    /// Checks that a change may begin: its entry can be written, as far as is known.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] while the trail cannot be written.
    pub fn check(&self) -> Result<(), ServiceError> {
        if self.state.is_failing() {
            let detail =
                "the audit trail cannot be written: nothing was changed, send the request again later";
            return Err(ServiceError::Unavailable(detail.into()));
        }
        Ok(())
    }

    /// Records a request that has changed nothing; waits while the channel is full.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] if the trail cannot be written and every request must be recorded.
    pub async fn record(&self, entry: Entry) -> Result<Recording, ServiceError> {
        let Some(channel) = self.channel.get() else { return Ok(Recording::Kept) };
        let message = match channel.try_send(Message::Entry(Box::new(clean(entry)), None)) {
            Ok(()) => {
                if channel.max_capacity() - channel.capacity() >= GROUP {
                    self.state.due.notify_one();
                }
                return Ok(Recording::Kept);
            }
            Err(TrySendError::Closed(_)) => return Err(unavailable()),
            Err(TrySendError::Full(message)) => message,
        };
        if self.state.is_failing() {
            return self.count(&message);
        }
        match channel.send_timeout(message, PATIENCE).await {
            Ok(()) => Ok(Recording::Kept),
            Err(SendTimeoutError::Closed(_)) => Err(unavailable()),
            Err(SendTimeoutError::Timeout(message)) => {
                // Further requests do not wait until a write succeeds again.
                self.state.failing.store(true, Ordering::Relaxed);
                self.count(&message)
            }
        }
    }

    fn count(&self, message: &Message) -> Result<Recording, ServiceError> {
        match message {
            Message::Entry(entry, _) => self.state.count(entry),
            Message::Close(_) => Ok(Recording::Kept),
        }
    }

    /// Records a request and waits until the entry is on disk.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] if the trail cannot be written.
    pub async fn record_surely(&self, entry: Entry) -> Result<(), ServiceError> {
        let Some(channel) = self.channel.get() else { return Ok(()) };
        let (written, on_disk) = oneshot::channel();
        let message = Message::Entry(Box::new(clean(entry)), Some(written));
        channel.send_timeout(message, PATIENCE).await.map_err(|_| unavailable())?;
        self.state.due.notify_one();
        match timeout(PATIENCE, on_disk).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(unavailable()),
        }
    }

    /// Writes everything recorded so far; later entries are refused.
    pub async fn close(&self) {
        let Some(channel) = self.channel.get() else { return };
        let (closed, done) = oneshot::channel();
        let closing = async {
            for entry in self.refusals.all() {
                // Fails only if the channel is already closed.
                let _ = channel.send(Message::Entry(Box::new(entry), None)).await;
            }
            if channel.send(Message::Close(closed)).await.is_ok() {
                self.state.due.notify_one();
                // Also ends if the writer does.
                let _ = done.await;
            }
        };
        if timeout(CLOSE, closing).await.is_err() {
            tracing::error!("the last entries of the audit trail could not be written");
        }
    }
}

/// Replaces characters that one of the databases does not store: a group that is always refused would block all others.
fn clean(mut entry: Entry) -> Entry {
    for text in [&mut entry.key, &mut entry.subject].into_iter().flatten() {
        *text = text.replace('\0', "\u{fffd}");
    }
    entry
}

/// Records the summaries of completed minutes until the trail is closed.
async fn sum_up(trail: Arc<Trail>, channel: mpsc::Sender<Message>) {
    loop {
        tokio::select! {
            () = sleep(SUM_UP) => {}
            () = channel.closed() => return,
        }
        for entry in trail.refusals.due() {
            // The trail is closed: the counts of the last minute are written at the end.
            let Ok(_) = trail.record(entry).await else { return };
        }
    }
}

fn unavailable() -> ServiceError {
    ServiceError::Unavailable(
        "the audit trail cannot be written: the request may have been carried out all the same".into(),
    )
}

/// Writes entries in groups.
struct Writer {
    store: Store,
    messages: mpsc::Receiver<Message>,
    state: Arc<State>,
}

/// Entries that are written in one transaction.
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

    /// Takes queued messages, until the group is full.
    fn take_queued(&mut self, messages: &mut mpsc::Receiver<Message>) {
        while !self.is_full()
            && let Ok(message) = messages.try_recv()
        {
            self.take(message);
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
                // The waiting request may have been dropped.
                let _ = waiting.send(());
            }
            if let Some(closing) = group.closing {
                self.messages.close();
                let _ = closing.send(());
                return;
            }
        }
    }

    /// Collects entries until the first has waited for `GROUP_TIME`, a caller waits for durability, or the group is
    /// full. Entries do not wake the writer meanwhile: waking a thread costs a small request more than its work.
    async fn group(&mut self) -> Group {
        let mut group = Group::default();
        let Some(first) = self.messages.recv().await else {
            return std::future::pending().await;
        };
        group.take(first);
        group.take_queued(&mut self.messages);
        if group.waiting.is_empty() && !group.is_full() {
            // A signal given before counts: its entry may already be in the group, which is then written early.
            let _ = timeout(GROUP_TIME, self.state.due.notified()).await;
            group.take_queued(&mut self.messages);
        }
        metrics::audit_waits(group.entries.len() + self.messages.len());
        group
    }

    /// Writes the entries, retrying until it succeeds; then records the requests that were only counted in between.
    async fn write(&self, entries: &[Entry]) {
        let mut said: Option<Instant> = None;
        while let Err(error) = self.store.append_audit(entries).await {
            self.state.failing.store(true, Ordering::Relaxed);
            self.store.make_room(&error).await;
            let error = ServiceError::from(error);
            if said.is_none_or(|said| said.elapsed() >= QUIET) {
                said = Some(Instant::now());
                tracing::error!(
                    error = error.cause(),
                    entries = entries.len(),
                    "the audit trail cannot be written: changes are refused until it can, and writing is \
                     retried"
                );
            }
            metrics::audit_failed();
            sleep(PAUSE).await;
        }
        metrics::audit_written(entries.len());
        metrics::audit_waits(self.messages.len());
        if self.state.failing.swap(false, Ordering::Relaxed) {
            self.write_gaps().await;
        }
    }

    /// Records the missing requests in the trail.
    async fn write_gaps(&self) {
        let gaps = self.state.gap_entries();
        tracing::info!("the audit trail is written again");
        match self.store.append_audit(&gaps).await {
            Ok(()) => metrics::audit_written(gaps.len()),
            // The log has the counts.
            Err(error) => tracing::error!(
                error = ServiceError::from(error).cause(),
                "the gaps could not be recorded in the audit trail"
            ),
        }
    }
}

/// Removes entries older than `days` from all trails.
///
/// # Errors
/// Those of the store.
pub async fn prune(app: &App, days: u32) -> Result<(), ServiceError> {
    let removed = app.store.prune_audit(now_ms() - i64::from(days) * DAY_MS).await?;
    if removed > 0 {
        tracing::info!(removed, "old entries of the audit trail were removed");
    }
    Ok(())
}

/// Removes the entries of the caller's tenant before a time, from the beginning of its trail; returns the new
/// beginning.
///
/// # Errors
/// [`ServiceError::Parameters`] if the time is less than [`MIN_AGE_MS`] ago.
pub async fn remove(app: &App, before_ms: i64) -> Result<Beginning, ServiceError> {
    if before_ms > now_ms() - MIN_AGE_MS {
        let detail = "expected a time at least 24 hours ago, because entries of the last day are not removed";
        return Err(ServiceError::parameter("before", detail));
    }
    let tenant = &app.principal.tenant;
    let removed = app.store.prune_audit_of(tenant, before_ms).await?;
    let (sequence, link) = app.store.audit_beginning(tenant).await?;
    tracing::warn!(
        removed,
        by = app.principal.key,
        "an administrator has removed entries of the audit trail"
    );
    let anchor = Beginning { removed, sequence, digest: blake3::Hash::from_bytes(link).to_hex().to_string() };
    app.touched.note("removed_sequence", &anchor.sequence.to_string());
    app.touched.note("removed_digest", &anchor.digest);
    Ok(anchor)
}

/// Beginning of a trail after removals: its first entry is chained to the digest of the last removed entry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Beginning {
    /// Number of entries removed by this call.
    pub removed: u64,
    /// Position of the last entry ever removed; 0 if none was.
    pub sequence: u64,
    /// Digest of that entry, in hexadecimal.
    pub digest: String,
}

/// Entries of the caller's tenant that match `filter`, in order, after `cursor` (the position of the last entry of the
/// previous page).
///
/// # Errors
/// An invalid cursor.
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

/// Position encoded by a cursor; 0 without one.
///
/// # Errors
/// An invalid cursor.
pub fn place(cursor: Option<&str>) -> Result<u64, ServiceError> {
    let place = cursor.map(str::parse).transpose();
    let place = place.map_err(|_| ServiceError::foreign_cursor())?;
    Ok(place.unwrap_or(0))
}

/// At most `limit` entries after a position.
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
    use sqlx::Connection as _;
    use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

    use super::*;
    use crate::service::app::Limits;

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

    #[tokio::test]
    async fn who_waits_has_the_entry_on_disk_and_those_before_it() {
        let (_folder, app) = app().await;
        app.trail().start(&app.store, false);
        app.trail().record(entry(0)).await.unwrap();
        app.trail().record_surely(entry(1)).await.unwrap();
        assert_eq!(recorded(&app).await, ["0", "1"]);
    }

    #[tokio::test]
    async fn more_than_a_channel_and_a_group_of_entries_arrive_in_their_order_before_it_closes() {
        let (_folder, app) = app().await;
        app.trail().start(&app.store, false);
        let count = CHANNEL + GROUP + 7;
        for number in 0..count {
            app.trail().record(entry(number)).await.unwrap();
        }
        app.trail().close().await;
        assert_eq!(recorded(&app).await, (0..count).map(|number| number.to_string()).collect::<Vec<_>>());
        assert!(matches!(app.trail().record_surely(entry(0)).await, Err(ServiceError::Unavailable(_))));
    }

    #[tokio::test]
    async fn many_at_once_are_all_written() {
        let (_folder, app) = app().await;
        app.trail().start(&app.store, false);
        let record = |number| {
            let trail = app.trail();
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
    async fn what_is_too_old_goes_and_odd_characters_are_replaced() {
        let (_folder, app) = app().await;
        let old = Entry { at_ms: now_ms() - 2 * DAY_MS, ..entry(0) };
        app.store.append_audit(&[old, entry(1)]).await.unwrap();
        prune(&app, 1).await.unwrap();
        assert_eq!(recorded(&app).await, ["1"]);
        app.trail().start(&app.store, false);
        // A character that PostgreSQL does not store.
        let odd = Entry { subject: Some("a\0b".into()), ..entry(2) };
        app.trail().record_surely(odd).await.unwrap();
        assert_eq!(recorded(&app).await, ["1", "2"]);
    }

    /// Has the database refuse entries, or accept them again.
    async fn refuse_entries(folder: &tempfile::TempDir, on: bool) {
        let statement = if on {
            "CREATE TRIGGER refuse BEFORE INSERT ON audit BEGIN SELECT RAISE(ABORT, 'refused'); END"
        } else {
            "DROP TRIGGER refuse"
        };
        let file = SqliteConnectOptions::new().filename(folder.path().join("shapelex.db"));
        let mut connection = SqliteConnection::connect_with(&file).await.unwrap();
        sqlx::query(statement).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
    }

    async fn until(mut holds: impl FnMut() -> bool) {
        let start = Instant::now();
        while !holds() {
            assert!(start.elapsed() < Duration::from_secs(20));
            sleep(Duration::from_millis(5)).await;
        }
    }

    #[tokio::test]
    async fn while_the_trail_cannot_be_written_reads_are_counted_and_changes_refused() {
        let (folder, app) = app().await;
        app.trail().start(&app.store, false);
        refuse_entries(&folder, true).await;
        app.trail().check().unwrap();
        app.trail().record(entry(0)).await.unwrap();
        until(|| app.trail().state.is_failing()).await;
        assert!(matches!(app.trail().check(), Err(ServiceError::Unavailable(_))));
        let mut counted = 0;
        for number in 1..2 * CHANNEL {
            counted += u64::from(app.trail().record(entry(number)).await.unwrap() == Recording::Counted);
        }
        // The writer holds one group.
        assert!((1..=CHANNEL as u64).contains(&counted), "{counted}");
        refuse_entries(&folder, false).await;
        until(|| !app.trail().state.is_failing()).await;
        app.trail().check().unwrap();
        app.trail().close().await;
        let found = list_after(&app, &AuditFilter::default(), 0, 10_000).await.unwrap();
        let kept = found.iter().filter(|recorded| !recorded.entry.request_id.is_empty()).count();
        let gaps: Vec<_> = found.iter().filter(|recorded| recorded.entry.method == MANY).collect();
        assert_eq!(kept as u64 + counted, 2 * CHANNEL as u64);
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        assert_eq!(gaps[0].entry.objects["unrecorded"], counted.to_string());
        app.store.check_audit().await.unwrap();
    }

    #[tokio::test]
    async fn where_every_request_must_be_recorded_reads_are_refused_at_once() {
        let (folder, app) = app().await;
        app.trail().start(&app.store, true);
        refuse_entries(&folder, true).await;
        app.trail().record(entry(0)).await.unwrap();
        until(|| app.trail().state.is_failing()).await;
        let begun = Instant::now();
        let mut refused = 0;
        for number in 1..2 * CHANNEL {
            refused += usize::from(app.trail().record(entry(number)).await.is_err());
        }
        assert!(refused > 0 && begun.elapsed() < PATIENCE, "{refused} in {:?}", begun.elapsed());
    }

    #[tokio::test]
    async fn counts_of_refusals_are_written_at_the_end() {
        let (_folder, app) = app().await;
        app.trail().start(&app.store, false);
        for _ in 0..3 {
            app.trail().refusals().count(None, "unauthenticated", "r", false, 7);
        }
        app.trail().close().await;
        let found = app.store.list_audit("", &AuditFilter::default(), 0, 10).await.unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].entry.objects["reason.unauthenticated"], "3");
    }

    #[tokio::test]
    async fn an_administrator_removes_old_entries_and_the_trail_begins_at_the_anchor() {
        let (_folder, app) = app().await;
        let aged = |days: i64| Entry { at_ms: now_ms() - days * DAY_MS, ..entry(0) };
        app.store.append_audit(&[aged(9), aged(8), aged(2), aged(0)]).await.unwrap();
        let all = list_after(&app, &AuditFilter::default(), 0, 10).await.unwrap();
        for before in [now_ms(), now_ms() - MIN_AGE_MS + 60_000] {
            assert!(matches!(remove(&app, before).await, Err(ServiceError::Parameters(_))));
        }
        let beginning = remove(&app, now_ms() - 3 * DAY_MS).await.unwrap();
        let digest = blake3::Hash::from_bytes(all[1].digest).to_hex().to_string();
        assert_eq!(beginning, Beginning { removed: 2, sequence: 2, digest: digest.clone() });
        let left = list_after(&app, &AuditFilter::default(), 0, 10).await.unwrap();
        assert_eq!(left, all[2..]);
        assert_eq!(left[0].digest, left[0].expected_digest(&all[1].digest));
        assert_eq!(app.store.check_audit().await.unwrap().entries, 2);
        assert_eq!(app.touched.ids()["removed_digest"], digest);
        assert_eq!(remove(&app, now_ms() - 3 * DAY_MS).await.unwrap().removed, 0);
    }
}
