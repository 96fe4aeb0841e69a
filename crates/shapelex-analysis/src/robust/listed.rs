//! The shapes of a large set that a robust estimate leaves out, and where along them they are wrong.

use super::points::point_weights;
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory};
use crate::factors::Factors;
use crate::partial_sums::Measured;

/// Number of other shapes that tell where the listed ones are wrong, unless there are fewer.
const BESIDE: usize = 256;

/// A shape that counts less than its weight, or not at all.
#[derive(Debug, Clone, PartialEq)]
pub struct LessCounted {
    /// Position of the shape in its set.
    pub position: usize,
    /// Factor of its weight.
    pub factor: f64,
    /// Weights of its control points, as [`point_weights`].
    pub point_weights: Vec<f64>,
}

/// Shapes that count less, and others beside which they are seen: in memory, as the source prepared them.
#[derive(Debug)]
pub struct Listed {
    shapes: ShapesInMemory,
    /// Positions of the shapes in their set, ascending.
    positions: Vec<usize>,
    /// The listed ones of these, in the order of their factors, with these.
    least: Vec<(usize, f64)>,
}

impl Listed {
    /// The shapes of `source` with the least `factors` below one, at most `most`; and 256 others that count, evenly spread over the
    /// set. `None` if all factors are one. One pass over the source.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn of(
        source: &dyn ShapeSource,
        factors: &Factors,
        most: usize,
    ) -> Result<Option<Self>, AnalysisError> {
        let factors = &factors.factors;
        let mut least: Vec<usize> = (0..factors.len()).filter(|k| factors[*k] < 1.0).collect();
        if least.is_empty() {
            return Ok(None);
        }
        least.sort_by(|&i, &j| factors[i].total_cmp(&factors[j]).then(i.cmp(&j)));
        least.truncate(most);
        let counting: Vec<usize> = (0..factors.len()).filter(|k| factors[*k] > 0.0).collect();
        let held = counting.len().min(BESIDE);
        let beside = (0..held).map(|i| counting[i * counting.len() / held]);
        let mut positions: Vec<usize> = least.iter().copied().chain(beside).collect();
        positions.sort_unstable();
        positions.dedup();
        let (mut whitened, mut weights) = (Vec::new(), Vec::with_capacity(positions.len()));
        let mut wanted = positions.iter().peekable();
        source.for_each_batch(&mut |batch| {
            for (k, x, weight) in batch.iter().filter(|(k, ..)| wanted.next_if_eq(&k).is_some()) {
                whitened.extend_from_slice(x);
                weights.push(weight * factors[k]);
            }
            Ok(())
        })?;
        let place = |&k: &usize| positions.partition_point(|position| *position < k);
        let least = least.iter().map(|k| (place(k), factors[*k])).collect();
        Ok(Some(Self { shapes: ShapesInMemory::prepared(whitened, weights), positions, least }))
    }

    /// The shapes, as the source prepared them, with the weights `w_k f_k`.
    pub fn shapes(&self) -> &ShapesInMemory {
        &self.shapes
    }

    /// Position in the set of each of the [shapes](Self::shapes).
    pub fn positions(&self) -> &[usize] {
        &self.positions
    }

    /// The listed shapes by ascending factors. `aligned`: the [shapes](Self::shapes), aligned to the mean.
    ///
    /// # Errors
    /// As [`point_weights`].
    pub fn described(
        self,
        measured: Measured<'_>,
        aligned: &[f64],
    ) -> Result<Vec<LessCounted>, AnalysisError> {
        let mut points = point_weights(measured, aligned, self.shapes.all().weights)?;
        let described = |(place, factor): (usize, f64)| LessCounted {
            position: self.positions[place],
            factor,
            point_weights: points.get_mut(place).map(std::mem::take).unwrap_or_default(),
        };
        Ok(self.least.into_iter().map(described).collect())
    }
}
