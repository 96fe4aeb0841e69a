//! The nearest neighbours in a stream of shapes: only the best so far are kept.

use std::cmp::Ordering;

use rayon::prelude::*;

use super::AnalysisError;
use super::distance::{DistanceSpace, Match, PreparedShapes};
use shapelex_numeric::bounded::Stop;

/// One of the nearest shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Position of the shape among all shapes.
    pub position: usize,
    /// Its distance, and its placement on the query.
    pub found: Match,
}

impl Neighbour {
    /// Order by distance; in a tie, the earlier shape comes first.
    fn order(&self, other: &Self) -> Ordering {
        let by_distance = self.found.distance.total_cmp(&other.found.distance);
        by_distance.then(self.position.cmp(&other.position))
    }
}

/// The nearest shapes so far, in ascending order.
#[derive(Debug, Clone)]
struct Nearest {
    most: usize,
    kept: Vec<Neighbour>,
}

impl Nearest {
    /// An empty list that keeps at most `most` shapes.
    fn new(most: usize) -> Self {
        Self { most, kept: Vec::new() }
    }

    /// Offers a shape. Cost: `O(log most)`, and `O(most)` if the shape is kept.
    fn offer(&mut self, neighbour: Neighbour) {
        let rank = self.kept.partition_point(|kept| kept.order(&neighbour).is_le());
        if rank < self.most {
            self.kept.truncate(self.most - 1);
            self.kept.insert(rank, neighbour);
        }
    }

    /// Distance above which no shape is kept.
    fn limit(&self) -> f64 {
        let last = self.most.checked_sub(1).and_then(|last| self.kept.get(last));
        last.map_or(f64::INFINITY, |kept| kept.found.distance)
    }
}

/// Minimum number of shapes that are compared between two looks at the limit, for each neighbour that is searched.
const ROUND: usize = 8;

/// Shapes among which one task looks for the smallest bounds.
const TASK: usize = 1 << 14;

/// The `most` of the positions `left` with the smallest bounds, in ascending order.
fn smallest(left: &[usize], most: usize, bound: impl Fn(usize) -> f64 + Sync) -> Vec<usize> {
    let cut = |mut some: Vec<usize>| {
        if some.len() > most {
            some.select_nth_unstable_by(most, |&a, &b| bound(a).total_cmp(&bound(b)));
            some.truncate(most);
        }
        some
    };
    let mut found = cut(left.par_chunks(TASK).flat_map_iter(|task| cut(task.to_vec())).collect());
    found.sort_unstable();
    found
}

/// Search for the nearest shapes to each of several queries, over shapes that arrive in batches.
#[derive(Debug)]
pub struct NeighbourSearch<'a> {
    space: &'a DistanceSpace,
    queries: PreparedShapes,
    nearest: Vec<Nearest>,
    /// Number of shapes offered so far.
    offered: usize,
}

impl<'a> NeighbourSearch<'a> {
    /// A search for the `most` nearest shapes to each query. A query that is among the shapes is its own neighbour.
    pub fn new(space: &'a DistanceSpace, queries: PreparedShapes, most: usize) -> Self {
        let nearest = vec![Nearest::new(most); queries.count()];
        Self { space, queries, nearest, offered: 0 }
    }

    /// Number of queries.
    pub fn queries(&self) -> usize {
        self.queries.count()
    }

    /// Compares all queries with further shapes. `stop` is checked before every query, and between comparisons.
    ///
    /// Where the space has lower bounds of distances, only pairs are compared whose bound is not beyond the nearest found, the
    /// smallest bounds first. The result is the same.
    ///
    /// Cost: at most that of [`DistanceSpace::compare`] for every query.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `stop` returns true.
    pub fn offer(&mut self, shapes: &PreparedShapes, stop: Stop<'_>) -> Result<(), AnalysisError> {
        for (query, nearest) in self.nearest.iter_mut().enumerate() {
            let bounds = self.space.lower_bounds(&self.queries, query, shapes);
            let bound = |position: usize| bounds.as_ref().map_or(0.0, |bounds| bounds[position]);
            // A bound that is not a number excludes nothing.
            let is_near = |position: usize, limit: f64| !(bound(position) > limit);
            let limit = nearest.limit();
            let all = 0..shapes.count();
            let mut left: Vec<usize> = match limit < f64::INFINITY {
                true => all.into_par_iter().filter(|&k| is_near(k, limit)).collect(),
                false => all.collect(),
            };
            let mut round = if bounds.is_some() { ROUND * nearest.most.max(1) } else { left.len() };
            while !left.is_empty() {
                if stop() {
                    return Err(AnalysisError::Interrupted);
                }
                let compared = smallest(&left, round, bound);
                let found = self.space.compare_some(&self.queries, query, shapes, &compared);
                for (&position, found) in compared.iter().zip(found) {
                    nearest.offer(Neighbour { position: self.offered + position, found });
                }
                let limit = nearest.limit();
                // The limit excludes nearly all, and is cheaper than a look at the list of compared shapes.
                let is_left = |k: &usize| is_near(*k, limit) && compared.binary_search(k).is_err();
                left = left.into_par_iter().filter(is_left).collect();
                round *= 2;
            }
        }
        self.offered += shapes.count();
        Ok(())
    }

    /// The neighbours of every query, in ascending order of distance; of equally distant shapes, those offered first.
    pub fn into_sorted(self) -> Vec<Vec<Neighbour>> {
        self.nearest.into_iter().map(|nearest| nearest.kept).collect()
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
            // In any order.
            for (position, distance) in distances.into_iter().enumerate().rev() {
                nearest.offer(Neighbour {
                    position,
                    found: Match { distance, placement: Placement::default() },
                });
            }
            let found: Vec<usize> = nearest.kept.iter().map(|neighbour| neighbour.position).collect();
            assert_eq!(found, [4, 1, 3, 2, 5, 0, 6][..most.min(7)], "{most}");
        }
    }
}
