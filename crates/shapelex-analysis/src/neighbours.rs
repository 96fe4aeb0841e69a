//! The nearest neighbours in a stream of shapes: only the best so far are kept.

use super::AnalysisError;
use super::distance::{DistanceSpace, Match, PreparedShapes};
use shapelex_numeric::bounded::Stop;

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

/// Search for the nearest shapes to each of several queries, over shapes that arrive in batches.
#[derive(Debug)]
pub struct NeighbourSearch<'a, T> {
    space: &'a DistanceSpace,
    queries: PreparedShapes,
    own: Vec<T>,
    nearest: Vec<Nearest<T>>,
}

impl<'a, T: Clone + PartialEq> NeighbourSearch<'a, T> {
    /// A search for the `most` nearest shapes to each query. `own` identifies queries that are among the shapes, in order: a
    /// shape is not its own neighbour. It is empty if none is.
    pub fn new(space: &'a DistanceSpace, queries: PreparedShapes, own: Vec<T>, most: usize) -> Self {
        let nearest = vec![Nearest::new(most); queries.count()];
        Self { space, queries, own, nearest }
    }

    /// Number of queries.
    pub fn queries(&self) -> usize {
        self.queries.count()
    }

    /// Compares all queries with further shapes, identified by `names`. `stop` is checked before every query.
    ///
    /// Cost: that of [`DistanceSpace::compare`] for every query.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `stop` returns true.
    pub fn offer(
        &mut self,
        names: &[T],
        shapes: &PreparedShapes,
        stop: Stop<'_>,
    ) -> Result<(), AnalysisError> {
        for (query, nearest) in self.nearest.iter_mut().enumerate() {
            if stop() {
                return Err(AnalysisError::Interrupted);
            }
            let own = self.own.get(query);
            for (name, found) in names.iter().zip(self.space.compare(&self.queries, query, shapes)) {
                if own != Some(name) {
                    nearest.offer(found, || name.clone());
                }
            }
        }
        Ok(())
    }

    /// The neighbours of every query, in ascending order of distance; of equally distant shapes, those offered first.
    pub fn into_sorted(self) -> Vec<Vec<Neighbour<T>>> {
        self.nearest.into_iter().map(Nearest::into_sorted).collect()
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
