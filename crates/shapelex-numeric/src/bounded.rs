//! What makes every search end: shares of steps, tolerances that grow when a share is spent, and callers who want to stop.

/// Says whether the caller wants the work to stop; looked at within long iterations.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// The caller waits to the end.
pub fn never() -> bool {
    false
}

/// Growth of a tolerance whenever a share of steps is spent: two steps lead from 10⁻¹¹ past 10⁻¹⁰.
const GROWTH: f64 = 4.0;

/// Later shares are this part of the first: the tolerance is known to be too small for the case.
const LATER: usize = 8;

/// Steps or parts between two looks at the caller's wish: some microseconds.
const LOOK: usize = 64;

/// The factor on the tolerance of a branch and bound search. It is 1 for a share of steps, then it grows geometrically, so
/// that every search with a positive tolerance ends: after at most `share · (1 + 64/8)` steps the factor is 4⁶⁴ > 10³⁸.
///
/// When the caller wants to stop the factor is infinite: everything is ruled out, and the result is to be thrown away.
pub struct Patience<'a> {
    stop: Stop<'a>,
    factor: f64,
    left: usize,
    later: usize,
    steps: usize,
}

impl<'a> Patience<'a> {
    /// Of a search that may take `share` steps at its own tolerance.
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

    /// Steps until now.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// What the tolerance is to be multiplied by.
    pub fn factor(&self) -> f64 {
        self.factor
    }
}

/// A number of panels, terms or stretches that may still be looked at.
pub struct Allowance<'a> {
    stop: Stop<'a>,
    left: usize,
    taken: usize,
}

impl<'a> Allowance<'a> {
    /// Of `most` parts.
    pub fn new(most: usize, stop: Stop<'a>) -> Self {
        Self { stop, left: most, taken: 0 }
    }

    /// Takes one, when there is one and the caller does not want to stop.
    pub fn take(&mut self) -> bool {
        if self.left.is_multiple_of(LOOK) && (self.stop)() {
            self.left = 0;
        }
        let taken = self.left > 0;
        self.left = self.left.saturating_sub(1);
        self.taken += usize::from(taken);
        taken
    }

    /// How many were taken.
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
        // The first look is at 6400, then one each 64 parts: the third ends it.
        assert_eq!((0..5000).filter(|_| allowance.take()).count(), 128);
    }
}
