//! Plausibility of the machine's clock: data removed by age cannot be recovered.
//!
//! The store keeps the newest trusted time. A clock more than `SLACK_MS` away from it (a machine that starts with a
//! wrong year, one that was off for long, a jump while it runs) is not trusted at once. Nothing is removed by age until
//! the clock is back, until an administrator confirms it (`shapelex confirm-clock`), or until it has advanced in step
//! with elapsed time for `PROOF_MS`, across restarts too, while no other process trusts a different time.
//!
//! ```text
//! trusted time at the last check + time passed ≈ now  → trusted
//! else candidate + time passed ≈ now                  → proven += time passed; trusted from PROOF_MS on
//! else                                                → candidate = now, proven = 0
//! ```

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::context::App;
use super::error::ServiceError;
use super::metrics;
use crate::store::{ClockNotes, Store, StoreError};
use crate::wire::time::rfc3339;

const DAY_MS: i64 = 24 * 3600 * 1000;
/// Largest trusted step: a night or a day off, or a time zone change stored as local time.
const SLACK_MS: i64 = DAY_MS;
/// Time for which a clock must advance plausibly before it is trusted: a day in which an operator can read the log.
const PROOF_MS: i64 = DAY_MS;
/// Earliest plausible time, 2020-01-01: this program is younger.
const EARLIEST_MS: i64 = 1_577_836_800_000;

/// State of the clock check in this process.
#[derive(Debug, Default)]
pub struct Clock {
    last: Mutex<Option<Look>>,
}

/// One check of the clock.
#[derive(Debug, Clone, Copy)]
struct Look {
    at: Instant,
    /// Time trusted by the store at that moment.
    believed_ms: Option<i64>,
    /// Actual time at that moment, provided that the trusted time is right.
    expected_ms: Option<i64>,
}

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Finding {
    is_believed: bool,
    notes: ClockNotes,
    expected_ms: Option<i64>,
}

impl Finding {
    fn believing(now_ms: i64) -> Self {
        Self { is_believed: true, notes: ClockNotes::believing(now_ms), expected_ms: Some(now_ms) }
    }
}

/// Decides whether a clock that shows `now_ms` is trusted, and which notes the store keeps about it.
///
/// `last`: the last check of this process and the time elapsed since.
fn judge(notes: ClockNotes, last: Option<(Look, Duration)>, now_ms: i64) -> Finding {
    let passed = last.map_or(0, |(_, passed)| i64::try_from(passed.as_millis()).unwrap_or(i64::MAX));
    // Notes of another process since then are no older than the last check of this one.
    let own = last.filter(|(look, _)| look.believed_ms == notes.believed_ms);
    let expected_ms = own.map_or(notes.believed_ms, |(look, _)| Some(look.expected_ms? + passed));
    if expected_ms.is_none_or(|expected| (now_ms - expected).abs() <= SLACK_MS) {
        return Finding::believing(now_ms);
    }
    let proven_ms = match notes.candidate_ms {
        Some(candidate) if (now_ms - candidate - passed).abs() <= SLACK_MS => notes.proven_ms + passed,
        _ => 0,
    };
    if proven_ms >= PROOF_MS && own.is_some() {
        return Finding::believing(now_ms);
    }
    let notes = ClockNotes { candidate_ms: Some(now_ms), proven_ms, ..notes };
    Finding { is_believed: false, notes, expected_ms }
}

impl Clock {
    fn last(&self) -> MutexGuard<'_, Option<Look>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Current time for records that expire. It is the clock's time, but never earlier than the trusted time, so that
    /// correcting a slow clock does not expire them early.
    pub fn stamp_ms(&self) -> i64 {
        let last = *self.last();
        last.and_then(|look| look.expected_ms).map_or_else(now_ms, |expected| expected.max(now_ms()))
    }
}

impl App {
    /// State of the clock check in this process.
    pub(in crate::service) fn clock(&self) -> Arc<Clock> {
        self.state()
    }
}

/// Milliseconds since 1970 UTC.
pub fn now_ms() -> i64 {
    jiff::Timestamp::now().as_millisecond()
}

/// Checks the clock; returns whether data may now be removed by age.
///
/// # Errors
/// Those of the store.
pub async fn look(app: &App) -> Result<bool, ServiceError> {
    let (notes, now, at) = (app.store.clock_notes().await?, now_ms(), Instant::now());
    let last = *app.clock().last();
    let found = judge(notes, last.map(|look| (look, at - look.at)), now);
    app.store.note_clock(found.notes).await?;
    let believed_ms = found.notes.believed_ms;
    *app.clock().last() = Some(Look { at, believed_ms, expected_ms: found.expected_ms });
    metrics::clock_is_believed(found.is_believed);
    if !found.is_believed {
        warn(now, found.expected_ms.unwrap_or(now));
    }
    Ok(found.is_believed)
}

fn warn(now_ms: i64, expected_ms: i64) {
    let (shows, expected) = (rfc3339(now_ms), rfc3339(expected_ms));
    tracing::warn!(
        shows,
        expected,
        "the clock differs by more than a day from the newest time in the store: nothing is removed for its age \
         until the clock is set, has run for a day, or is confirmed by `shapelex confirm-clock`"
    );
}

/// Trusts the clock as it is now; returns the time it shows.
///
/// # Errors
/// Those of the store.
pub async fn confirm(store: &Store) -> Result<String, StoreError> {
    let now = now_ms();
    store.note_clock(ClockNotes::believing(now)).await?;
    Ok(rfc3339(now))
}

/// Refuses a clock that shows a time before this program existed.
///
/// # Errors
/// The time it shows, and the remedy.
pub fn check() -> Result<(), String> {
    check_time(now_ms())
}

fn check_time(now_ms: i64) -> Result<(), String> {
    if now_ms >= EARLIEST_MS {
        return Ok(());
    }
    Err(format!(
        "the clock of this machine shows {}, expected a time after {}: set the clock first, because its times \
         are stored with all data",
        rfc3339(now_ms),
        rfc3339(EARLIEST_MS)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: i64 = 1_800_000_000_000;
    const HOUR_MS: i64 = 3_600_000;

    /// Checks by one process, at the given hours of elapsed time, of a clock that shows the given hours after `NOW`.
    fn looks(mut notes: ClockNotes, steps: &[(u64, i64)]) -> (Vec<bool>, ClockNotes) {
        let (mut last, mut found) = (None, Vec::new());
        for (hours, shown) in steps {
            let passed = Duration::from_secs(hours * 3600);
            let finding = judge(notes, last.map(|look| (look, passed)), NOW + shown * HOUR_MS);
            notes = finding.notes;
            let (believed_ms, expected_ms) = (notes.believed_ms, finding.expected_ms);
            last = Some(Look { at: Instant::now(), believed_ms, expected_ms });
            found.push(finding.is_believed);
        }
        (found, notes)
    }

    fn believed() -> ClockNotes {
        ClockNotes::believing(NOW)
    }

    #[test]
    fn a_clock_that_goes_on_is_believed() {
        assert_eq!(looks(ClockNotes::default(), &[(0, 0)]), (vec![true], believed()));
        assert_eq!(looks(believed(), &[(0, 20), (1, 21), (100, 121)]).0, [true; 3]);
        assert_eq!(looks(believed(), &[(0, -20), (1, 3)]).0, [true; 2]);
    }

    #[test]
    fn a_jump_is_not_believed_until_it_is_undone_or_proven() {
        let year = 400 * 24;
        for far in [year, -year, 30 * year, 30] {
            let (found, notes) = looks(believed(), &[(0, far), (1, far + 1)]);
            assert_eq!((found, notes.believed_ms), (vec![false; 2], Some(NOW)), "{far}");
        }
        assert_eq!(looks(believed(), &[(0, 0), (1, year), (1, 2)]).0, [true, false, true]);
        let back = [(0, 0), (1, year), (10, -year), (50, 61)];
        assert_eq!(looks(believed(), &back).0, [true, false, false, true]);
        let hours: Vec<(u64, i64)> = (0..26).map(|k| (u64::from(k > 0), year + k)).collect();
        let (found, notes) = looks(believed(), &hours);
        assert_eq!(found.iter().position(|is_believed| *is_believed), Some(24));
        assert_eq!(notes.believed_ms, Some(NOW + (year + 25) * HOUR_MS));
    }

    #[test]
    fn a_clock_that_jumps_again_begins_its_proof_anew() {
        let year = 400 * 24;
        let (found, notes) = looks(believed(), &[(0, year), (20, year + 20), (20, 3 * year)]);
        assert_eq!((found, notes.proven_ms), (vec![false; 3], 0));
    }

    #[test]
    fn a_proof_goes_on_after_a_restart() {
        let year = 400 * 24;
        let (_, notes) = looks(believed(), &[(0, year), (20, year + 20)]);
        assert_eq!(notes.proven_ms, 20 * HOUR_MS);
        let (found, _) = looks(notes, &[(0, year + 30), (5, year + 35)]);
        assert_eq!(found, [false, true]);
    }

    #[test]
    fn who_stands_against_another_process_is_not_believed() {
        let year = 400 * 24;
        let (_, mut notes) = looks(believed(), &[(0, year), (20, year + 20)]);
        // The other process has trusted its own clock in between.
        notes.believed_ms = Some(NOW + 25 * HOUR_MS);
        let look = Look { at: Instant::now(), believed_ms: Some(NOW), expected_ms: Some(NOW + 20 * HOUR_MS) };
        let passed = Duration::from_secs(5 * 3600);
        let finding = judge(notes, Some((look, passed)), NOW + (year + 25) * HOUR_MS);
        assert!(!finding.is_believed);
        assert_eq!(finding.notes.believed_ms, notes.believed_ms);
    }

    #[test]
    fn a_time_before_the_program_is_refused() {
        for (time, is_refused) in [(-1, true), (0, true), (EARLIEST_MS - 1, true), (EARLIEST_MS, false)] {
            assert_eq!(check_time(time).is_err(), is_refused, "{time}");
        }
        assert!(check_time(-5000).unwrap_err().contains("1969-12-31T23:59:55Z"));
    }
}
