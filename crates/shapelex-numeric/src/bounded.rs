//! Termination of searches: budgets of steps, tolerances that grow once a budget is spent, and cancellation by the caller.

/// Returns whether the caller wants the work to stop. Checked within long iterations.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// A [`Stop`] that never asks to stop.
pub fn never() -> bool {
    false
}

/// Growth of a tolerance each time a share of steps is spent: two increases lead from 10⁻¹¹ past 10⁻¹⁰.
const GROWTH: f64 = 4.0;

/// Ratio of the first share to later ones: by then the tolerance is known to be too small for the case.
const LATER: usize = 8;

/// Number of steps or parts between two checks of `stop`: some microseconds.
const LOOK: usize = 64;

/// Factor on the tolerance of a branch and bound search. It is 1 for a share of steps and then grows geometrically, so that
/// every search with a positive tolerance ends: after at most `share · (1 + 64/8)` steps the factor is 4⁶⁴ > 10³⁸.
///
/// When the caller wants to stop, the factor is infinite: everything is excluded, and the result must be discarded.
pub struct Patience<'a> {
    stop: Stop<'a>,
    factor: f64,
    left: usize,
    later: usize,
    steps: usize,
}

impl<'a> Patience<'a> {
    /// For a search that may take `share` steps at its own tolerance.
    pub fn new(share: usize, stop: Stop<'a>) -> Self {
        Self { stop, factor: 1.0, left: share.max(1), later: (share / LATER).max(1), steps: 0 }
    }

    /// Counts a step.
    pub fn step(&mut self) {
        self.steps += 1;
        self.left -= 1;
        if self.left == 0 {
            self.left = self.later;
            self.factor *= GROWTH;
        }
        if self.steps.is_multiple_of(LOOK) && (self.stop)() {
            self.factor = f64::INFINITY;
        }
    }

    /// Number of steps so far.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Factor by which to multiply the tolerance.
    pub fn factor(&self) -> f64 {
        self.factor
    }
}

/// A budget of panels, terms or stretches.
pub struct Allowance<'a> {
    stop: Stop<'a>,
    left: usize,
    taken: usize,
}

impl<'a> Allowance<'a> {
    /// A budget of `most` parts.
    pub fn new(most: usize, stop: Stop<'a>) -> Self {
        Self { stop, left: most, taken: 0 }
    }

    /// Takes one part. Returns false if the budget is spent or the caller wants to stop.
    pub fn take(&mut self) -> bool {
        if self.left.is_multiple_of(LOOK) && (self.stop)() {
            self.left = 0;
        }
        let taken = self.left > 0;
        self.left = self.left.saturating_sub(1);
        self.taken += usize::from(taken);
        taken
    }

    /// Number of parts taken.
    pub fn taken(&self) -> usize {
        self.taken
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn a_tolerance_grows_past_everything_within_a_counted_number_of_steps() {
        let mut patience = Patience::new(80, &never);
        (0..79).for_each(|_| patience.step());
        assert_eq!(patience.factor(), 1.0);
        (0..=10 * 64).for_each(|_| patience.step());
        assert!(patience.factor() > 1e38, "{}", patience.factor());
        (0..100_000).for_each(|_| patience.step());
        assert_eq!(patience.factor(), f64::INFINITY);
    }

    #[test]
    fn a_caller_who_stops_ends_a_search_at_the_next_look() {
        let mut patience = Patience::new(1000, &|| true);
        (0..LOOK).for_each(|_| patience.step());
        assert_eq!(patience.factor(), f64::INFINITY);
    }

    #[test]
    fn an_allowance_ends_and_is_given_up_at_the_next_look() {
        let mut allowance = Allowance::new(1000, &never);
        assert_eq!((0..5000).filter(|_| allowance.take()).count(), 1000);
        let looks = AtomicUsize::new(0);
        let stop = || looks.fetch_add(1, Ordering::Relaxed) >= 2;
        let mut allowance = Allowance::new(64 * 100, &stop);
        // The first check is at 6400, then one every 64 parts: the third one ends it.
        assert_eq!((0..5000).filter(|_| allowance.take()).count(), 128);
    }
}
