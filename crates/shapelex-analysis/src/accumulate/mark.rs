//! Marks of shapes, and samples that depend on the marks alone.
//!
//! ```text
//! mark of a shape     the first 16 bytes of BLAKE3(control points, weight), as they were given
//! rank under a seed   the first 16 bytes of BLAKE3(seed, mark)
//! sample of m shapes  those of the m smallest ranks
//! ```
//!
//! A sample has the same shapes in the same order for any order of the set, any division into batches and any store, and whether a
//! period runs through the set or not. A further shape changes it by one shape at most.

use std::collections::BTreeMap;

use super::source::{ShapeSource, ShapesInMemory};
use crate::AnalysisError;
use shapelex_numeric::parallel;

/// Number of bytes of a digest that are kept: among 10⁹ shapes, two share them with a probability below 10⁻²⁰.
const KEPT: usize = 16;

/// Shapes whose marks a task computes.
const TOGETHER: usize = 64;

/// Digest of a shape as it was given, before it was centred and whitened: equal for copies of a shape, and for no others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Mark([u8; KEPT]);

impl Mark {
    /// The mark of a shape with these `d·N` numbers and this weight. Cost: a BLAKE3 digest, about a nanosecond for each byte.
    pub fn of(numbers: &[f64], weight: f64) -> Self {
        let mut bytes = Vec::with_capacity(size_of::<f64>() * (numbers.len() + 1));
        numbers.iter().chain([&weight]).for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
        Self(leading(&blake3::hash(&bytes)))
    }

    /// Marks of shapes, given one after the other, with one weight each. Computed in parallel.
    pub fn of_all(numbers: &[f64], weights: &[f64]) -> Vec<Self> {
        let length = numbers.len() / weights.len().max(1);
        let tasks = weights.len().div_ceil(TOGETHER);
        let of = |task: usize| -> Vec<Self> {
            let range = task * TOGETHER..weights.len().min((task + 1) * TOGETHER);
            range.map(|k| Self::of(&numbers[k * length..(k + 1) * length], weights[k])).collect()
        };
        parallel::map(tasks, &of).into_iter().flatten().collect()
    }

    /// The rank of the shape under a seed.
    fn rank(self, seed: u64) -> [u8; KEPT] {
        let mut bytes = [0; size_of::<u64>() + KEPT];
        bytes[..size_of::<u64>()].copy_from_slice(&seed.to_le_bytes());
        bytes[size_of::<u64>()..].copy_from_slice(&self.0);
        leading(&blake3::hash(&bytes))
    }
}

fn leading(digest: &blake3::Hash) -> [u8; KEPT] {
    let mut kept = [0; KEPT];
    kept.copy_from_slice(&digest.as_bytes()[..KEPT]);
    kept
}

/// Positions in the order of the ranks of the marks; copies stand together.
pub fn ranked(marks: &[Mark], seed: u64) -> Vec<usize> {
    let ranks: Vec<[u8; KEPT]> = marks.iter().map(|mark| mark.rank(seed)).collect();
    let mut order: Vec<usize> = (0..marks.len()).collect();
    order.sort_by_key(|&k| ranks[k]);
    order
}

/// The shapes of the smallest ranks among those that were offered.
struct Draw {
    seed: u64,
    most: usize,
    /// One entry for all copies of a shape.
    drawn: BTreeMap<[u8; KEPT], Drawn>,
}

struct Drawn {
    whitened: Vec<f64>,
    weight: f64,
    copies: usize,
}

impl Draw {
    fn offer(&mut self, mark: Mark, whitened: &[f64], weight: f64) {
        let rank = mark.rank(self.seed);
        if let Some(drawn) = self.drawn.get_mut(&rank) {
            drawn.copies += 1;
            return;
        }
        let is_full = self.drawn.len() >= self.most;
        if is_full && self.drawn.last_key_value().is_none_or(|(last, _)| *last < rank) {
            return;
        }
        self.drawn.insert(rank, Drawn { whitened: whitened.to_vec(), weight, copies: 1 });
        if is_full {
            self.drawn.pop_last();
        }
    }

    /// Each distinct shape once, in the order of the ranks, then their copies while there is room: many copies of one shape do not
    /// displace the others.
    fn finish(self) -> ShapesInMemory {
        let (mut whitened, mut weights) = (Vec::new(), Vec::new());
        let most_copies = self.drawn.values().map(|drawn| drawn.copies).max().unwrap_or(0);
        let rounds = (0..most_copies).flat_map(|round| self.drawn.values().filter(move |d| d.copies > round));
        for drawn in rounds.take(self.most) {
            whitened.extend_from_slice(&drawn.whitened);
            weights.push(drawn.weight);
        }
        ShapesInMemory::prepared(whitened, weights)
    }
}

impl ShapesInMemory {
    /// At most `most` shapes of a source: those of the smallest ranks under `seed`, in the order of their ranks, and copies of shapes
    /// last. All shapes, if there are no more.
    ///
    /// Cost: a pass over the source with a digest of every shape.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn sample(source: &dyn ShapeSource, seed: u64, most: usize) -> Result<Self, AnalysisError> {
        let mut draw = Draw { seed, most, drawn: BTreeMap::new() };
        source.for_each_marked(&mut |batch, marks| {
            batch.iter().zip(marks).for_each(|((_, x, weight), mark)| draw.offer(*mark, x, weight));
            Ok(())
        })?;
        Ok(draw.finish())
    }

    /// All shapes of a source in the order of their ranks under `seed`.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn ranked(source: &dyn ShapeSource, seed: u64) -> Result<Self, AnalysisError> {
        let (mut whitened, mut weights, mut all) = (Vec::new(), Vec::new(), Vec::new());
        source.for_each_marked(&mut |batch, marks| {
            whitened.extend_from_slice(batch.whitened);
            weights.extend_from_slice(batch.weights);
            all.extend_from_slice(marks);
            Ok(())
        })?;
        let length = whitened.len() / weights.len().max(1);
        let order = ranked(&all, seed);
        let rows = order.iter().flat_map(|&k| &whitened[k * length..(k + 1) * length]).copied();
        Ok(Self::prepared(rows.collect(), order.iter().map(|&k| weights[k]).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shapes(numbers: &[f64]) -> ShapesInMemory {
        let whitened = numbers.iter().flat_map(|x| [*x, 1.0 + x]).collect();
        ShapesInMemory::prepared(whitened, vec![1.0; numbers.len()])
    }

    fn firsts(shapes: &ShapesInMemory) -> Vec<f64> {
        shapes.all().whitened.chunks_exact(2).map(|shape| shape[0]).collect()
    }

    /// The definition, computed for all shapes with a sort: the sample of a stream is its beginning.
    #[test]
    fn a_sample_has_the_smallest_ranks_in_any_order() {
        let numbers: Vec<f64> = (0..5000).map(f64::from).collect();
        let rank = |x: f64, seed: u64| {
            let bytes: Vec<u8> = [x, 1.0 + x, 1.0].iter().flat_map(|number| number.to_le_bytes()).collect();
            let mark = blake3::hash(&bytes);
            *blake3::hash(&[&seed.to_le_bytes()[..], &mark.as_bytes()[..16]].concat()).as_bytes()
        };
        for seed in [0, 7] {
            let mut wanted = numbers.clone();
            wanted.sort_by_key(|x| rank(*x, seed));
            let found = firsts(&ShapesInMemory::sample(&shapes(&numbers), seed, 40).unwrap());
            assert_eq!(found, wanted[..40], "seed {seed}");
            let mut other = numbers.clone();
            other.reverse();
            other.rotate_left(1234);
            assert_eq!(firsts(&ShapesInMemory::sample(&shapes(&other), seed, 40).unwrap()), found);
            assert_eq!(firsts(&ShapesInMemory::ranked(&shapes(&other), seed).unwrap()), wanted);
        }
    }

    /// A sample of a shape that is given 3000 times and of 100 others holds all of them, and copies in the other places.
    #[test]
    fn copies_do_not_displace_others() {
        let numbers: Vec<f64> = (0..3100).map(|k| if k % 31 == 0 { f64::from(k) } else { 0.5 }).collect();
        let found = firsts(&ShapesInMemory::sample(&shapes(&numbers), 0, 400).unwrap());
        let mut distinct = found[..101].to_vec();
        distinct.sort_by(f64::total_cmp);
        distinct.dedup();
        assert_eq!((found.len(), distinct.len()), (400, 101));
        assert!(found[101..].iter().all(|x| *x == 0.5));
        assert_eq!(firsts(&ShapesInMemory::sample(&shapes(&[2.0; 9]), 0, 400).unwrap()), [2.0; 9]);
        assert_eq!(ShapesInMemory::sample(&shapes(&[]), 0, 400).unwrap().count(), 0);
    }

    #[test]
    fn the_weight_belongs_to_the_mark() {
        assert_ne!(Mark::of(&[1.0, 2.0], 1.0), Mark::of(&[1.0, 2.0], 2.0));
        assert_eq!(Mark::of_all(&[1.0, 2.0, 3.0, 4.0], &[1.0, 2.0])[1], Mark::of(&[3.0, 4.0], 2.0));
    }
}
