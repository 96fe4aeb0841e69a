//! The nearest neighbours in a stream of shapes: only the best so far are kept.

use super::distance::Match;

/// One of the nearest shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbour<T> {
    /// Identification of the shape.
    pub shape: T,
    /// Its distance, and its placement on the query.
    pub found: Match,
}

/// The nearest shapes so far, in ascending order; in a tie, the earlier shape comes first.
#[derive(Debug, Clone)]
pub struct Nearest<T> {
    most: usize,
    kept: Vec<Neighbour<T>>,
}

impl<T> Nearest<T> {
    /// An empty list that keeps at most `most` shapes.
    pub fn new(most: usize) -> Self {
        Self { most, kept: Vec::new() }
    }

    /// Offers the next shape; `shape` is called only if it is kept. Cost: `O(log most)`, and `O(most)` if the shape is kept.
    pub fn offer(&mut self, found: Match, shape: impl FnOnce() -> T) {
        let position = self.kept.partition_point(|kept| kept.found.distance <= found.distance);
        if position < self.most {
            self.kept.truncate(self.most - 1);
            self.kept.insert(position, Neighbour { shape: shape(), found });
        }
    }

    /// The nearest shapes, in ascending order of distance.
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
