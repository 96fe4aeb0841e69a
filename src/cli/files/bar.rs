//! Progress of a transfer on the last line of a terminal.

use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Minimum time between two drawings.
const PAUSE: Duration = Duration::from_millis(100);
/// Number of cells of the bar.
const CELLS: u64 = 40;
/// Returns to the begin of the line and clears it.
const CLEAR: &str = "\r\x1b[2K";

/// Bytes transferred, on standard error. Clones share them.
#[derive(Debug, Clone)]
pub(super) struct Bar(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    begun: Instant,
    done: u64,
    total: u64,
    drawn: Option<Instant>,
}

impl Bar {
    pub(super) fn new(total: u64) -> Self {
        Self(Arc::new(Mutex::new(State { begun: Instant::now(), done: 0, total, drawn: None })))
    }

    /// Counts more bytes to transfer.
    pub(super) fn grow(&self, bytes: u64) {
        self.change(|state| state.total += bytes);
    }

    /// Counts bytes as transferred.
    pub(super) fn pass(&self, bytes: u64) {
        self.change(|state| state.done += bytes);
    }

    /// Writes a line above the bar.
    pub(super) fn tell(&self, line: &str) {
        self.change(|state| {
            show(&format!("{CLEAR}{line}\n"));
            state.drawn = None;
        });
    }

    /// Removes the bar.
    pub(super) fn end(&self) {
        show(CLEAR);
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut state);
        if state.drawn.is_none_or(|drawn| drawn.elapsed() >= PAUSE) {
            state.drawn = Some(Instant::now());
            show(&format!("{CLEAR}{}", state.line(state.begun.elapsed())));
        }
    }
}

impl State {
    /// Bar, amounts, rate and the time left at this rate.
    fn line(&self, elapsed: Duration) -> String {
        let total = self.total.max(self.done).max(1);
        let filled = (CELLS as f64 * self.done as f64 / total as f64) as usize;
        let rate = self.done as f64 / elapsed.as_secs_f64().max(1e-3);
        let left = if self.done > 0 {
            format!("{} s", ((total - self.done) as f64 / rate).ceil())
        } else {
            "-".into()
        };
        let (done, sum, rate) = (amount(self.done as f64), amount(total as f64), amount(rate));
        let cells = CELLS as usize;
        format!("[{:<cells$}] {done}/{sum} {rate}/s, {left} left", "#".repeat(filled))
    }
}

/// Bytes with a unit.
fn amount(bytes: f64) -> String {
    let units = ["KiB", "MiB", "GiB", "TiB"];
    let Some(power) = (1..=units.len()).rev().find(|power| bytes >= 1024_f64.powi(*power as i32)) else {
        return format!("{bytes:.0} B");
    };
    format!("{:.2} {}", bytes / 1024_f64.powi(power as i32), units[power - 1])
}

/// Writes to the terminal; that it went away is not a reason to stop.
fn show(text: &str) {
    let mut terminal = std::io::stderr().lock();
    let _ = terminal.write_all(text.as_bytes()).and_then(|()| terminal.flush());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_tells_amounts_rate_and_time() {
        let state = |done, total| State { begun: Instant::now(), done, total, drawn: None };
        let second = Duration::from_secs(1);
        assert_eq!(
            state(3 << 20, 6 << 20).line(second),
            format!("[{}{}] 3.00 MiB/6.00 MiB 3.00 MiB/s, 1 s left", "#".repeat(20), " ".repeat(20))
        );
        assert_eq!(state(0, 500).line(second), format!("[{}] 0 B/500 B 0 B/s, - left", " ".repeat(40)));
        assert!(state(2048, 1024).line(second).ends_with("] 2.00 KiB/2.00 KiB 2.00 KiB/s, 0 s left"));
    }
}
