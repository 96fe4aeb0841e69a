//! The nearest of many shapes that stream by: the best so far are kept, and nothing else.

use super::distance::Match;

/// One of the nearest.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbour<T> {
    /// What stands for the shape.
    pub shape: T,
    /// Its distance and how it lies at the query.
    pub found: Match,
}

/// The nearest shapes so far, ascending; of equal ones those that came first.
#[derive(Debug, Clone)]
pub struct Nearest<T> {
    most: usize,
    kept: Vec<Neighbour<T>>,
}

impl<T> Nearest<T> {
    /// Keeps at most `most`.
    pub fn new(most: usize) -> Self {
        Self { most, kept: Vec::new() }
    }

    /// Offers the next shape; `shape` is made only when it is kept. Cost `O(log most)` for most, `O(most)` when kept.
    pub fn offer(&mut self, found: Match, shape: impl FnOnce() -> T) {
        let position = self.kept.partition_point(|kept| kept.found.distance <= found.distance);
        if position < self.most {
            self.kept.truncate(self.most - 1);
            self.kept.insert(position, Neighbour { shape: shape(), found });
        }
    }

    /// The nearest ones, ascending.
    pub fn into_sorted(self) -> Vec<Neighbour<T>> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::Placement;

    #[test]
    fn the_nearest_stay_in_order_and_the_first_of_equal_ones() {
        let distances = [3.0, 1.0, 2.0, 1.0, 0.5, 2.0, 9.0];
        for most in 1..=8 {
            let mut nearest = Nearest::new(most);
            for (k, distance) in distances.into_iter().enumerate() {
                nearest.offer(Match { distance, placement: Placement::default() }, || k);
            }
            let found: Vec<usize> = nearest.into_sorted().iter().map(|neighbour| neighbour.shape).collect();
            assert_eq!(found, [4, 1, 3, 2, 5, 0, 6][..most.min(7)], "{most}");
        }
    }
}
