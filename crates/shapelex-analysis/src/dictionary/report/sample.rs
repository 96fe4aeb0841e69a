//! Training shapes in the coordinates of their own spectrum.
//!
//! ```text
//! Σ w (y − ȳ)(y − ȳ)ᵀ = Q D Qᵀ,   z_k = Qᵀ(y_k − ȳ)
//! without a subject G:   D − Σ_G w zzᵀ − (W − W_G) δδᵀ,   δ = −Σ_G w z / (W − W_G),   the mean moves by Qδ
//! ```
//!
//! (About the origin, nothing is centred and `δ` is absent.) The spectrum is complete, so that a matrix of these coordinates says all
//! about shapes without some of their subjects, and no shape is read again.

use rand::RngExt;
use rand::rngs::ChaCha12Rng;

use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory};
use crate::dictionary::model::Spread;
use crate::metric::dot;
use crate::pca::{FunctionalPca, SMALLEST_COMPONENT};
use shapelex_numeric::dense::{self, Eigenpairs, Matrix, transpose_multiply_columns};
use shapelex_numeric::kernels::add_scaled;

/// Relative eigenvalue below which a direction is rounding error.
const RANK: f64 = 1e-15;

/// Training shapes in coordinates of their spectrum.
#[derive(Debug)]
pub(in crate::dictionary) struct Sample {
    /// `ȳ`, or zero if components are not centred; whitened.
    pub(in crate::dictionary) mean: Vec<f64>,
    /// `Q`: one column for each direction in which shapes vary.
    pub(in crate::dictionary) basis: Matrix,
    /// Diagonal of `D`.
    pub(in crate::dictionary) values: Vec<f64>,
    /// `z_k`, a column for each shape.
    pub(in crate::dictionary) coordinates: Matrix,
    /// `‖y_k − ȳ‖² − ‖z_k‖²`: rounding, but for directions below the rank.
    pub(in crate::dictionary) outside: Vec<f64>,
    /// `w_k`.
    pub(in crate::dictionary) weights: Vec<f64>,
    /// Shapes of each subject.
    pub(in crate::dictionary) subjects: Vec<Vec<usize>>,
    /// Whether components are centred.
    pub(in crate::dictionary) centred: bool,
}

/// Components of some of the shapes.
pub(in crate::dictionary) struct Part {
    /// Eigenpairs of their scatter, in coordinates.
    pub(in crate::dictionary) pairs: Eigenpairs,
    /// Trace of their scatter.
    pub(in crate::dictionary) total: f64,
    /// `δ`: their mean less that of all; zero if nothing is centred.
    pub(in crate::dictionary) shift: Vec<f64>,
    /// Their weight.
    pub(in crate::dictionary) weight: f64,
}

impl Sample {
    /// Prepared shapes about `reference`, a whitened shape near all of them. `subjects` numbers the subject of each shape from 0.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub(in crate::dictionary) fn new(
        shapes: &ShapesInMemory,
        reference: &[f64],
        centred: bool,
        subjects: &[usize],
    ) -> Result<Self, AnalysisError> {
        let origin = FunctionalPca::origin(reference, centred);
        let sum = FunctionalPca::scatter(shapes, &origin)?;
        let mean: Vec<f64> = match centred {
            true => sum.mean().iter().zip(&origin).map(|(m, o)| m + o).collect(),
            false => origin,
        };
        let length = mean.len();
        let most = if centred { shapes.count() - 1 } else { shapes.count() };
        let (_, pairs) = sum.leading(centred, most.min(length))?;
        let first = pairs.values.first().copied().unwrap_or(0.0);
        let rank = pairs.values.iter().take_while(|value| **value > RANK * first).count();
        let basis = pairs.vectors.columns(0, rank).into_owned();
        let all = shapes.all();
        let away: Vec<f64> =
            all.whitened.chunks_exact(length).flat_map(|y| y.iter().zip(&mean).map(|(y, m)| y - m)).collect();
        let coordinates = transpose_multiply_columns(&basis, &away);
        let squares = away.chunks_exact(length).map(|a| dot(a, a)).zip(coordinates.column_iter());
        let outside = squares.map(|(square, z)| (square - z.norm_squared()).max(0.0)).collect();
        let count = subjects.iter().max().map_or(0, |last| last + 1);
        let mut members = vec![Vec::new(); count];
        subjects.iter().enumerate().for_each(|(k, subject)| members[*subject].push(k));
        Ok(Self {
            mean,
            values: pairs.values[..rank].to_vec(),
            basis,
            coordinates,
            outside,
            weights: all.weights.to_vec(),
            subjects: members,
            centred,
        })
    }

    /// Number of shapes.
    pub(in crate::dictionary) fn count(&self) -> usize {
        self.weights.len()
    }

    /// `z_k`.
    pub(in crate::dictionary) fn shape(&self, k: usize) -> &[f64] {
        let rank = self.values.len();
        &self.coordinates.as_slice()[k * rank..(k + 1) * rank]
    }

    /// Mean and covariance of the first `count` coordinates, which are the scores of all shapes.
    pub(in crate::dictionary) fn spread(&self, count: usize) -> Spread {
        let weight: f64 = self.weights.iter().sum();
        let mut mean = vec![0.0; count];
        for (k, share) in self.weights.iter().map(|w| w / weight).enumerate().filter(|_| !self.centred) {
            mean.iter_mut().zip(self.shape(k)).for_each(|(mean, z)| *mean += share * z);
        }
        Spread::from_moments(&self.values[..count], mean, self.count(), weight)
    }

    /// The whitened shape with the coordinates `z`.
    pub(in crate::dictionary) fn whitened(&self, z: &[f64]) -> Vec<f64> {
        let mut y = self.mean.clone();
        z.iter().zip(self.basis.column_iter()).filter(|(z, _)| **z != 0.0).for_each(|(z, q)| {
            add_scaled(&mut y, *z, q.as_slice());
        });
        y
    }

    /// The `count` leading components of all shapes but those of a subject, by the downdate above; anew without a subject with
    /// more than half of the weight.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub(in crate::dictionary) fn without(&self, subject: usize, count: usize) -> Result<Part, AnalysisError> {
        let rank = self.values.len();
        let members = &self.subjects[subject];
        let all = self.weights.iter().sum::<f64>();
        let weight = all - members.iter().map(|&k| self.weights[k]).sum::<f64>();
        if weight < 0.5 * all {
            // A subject that outweighs all others leaves rounding behind: the rest is summed anew. There is one at most.
            let others: Vec<(usize, f64)> =
                (0..self.count()).filter(|k| !members.contains(k)).map(|k| (k, 1.0)).collect();
            return self.of(&others, count);
        }
        let mut scatter = Matrix::from_diagonal(&self.values.clone().into());
        let (left, sum) = self.weighted(members.iter().map(|&k| (k, 1.0)));
        dense::add_outer_products(&mut scatter, &left, -1.0);
        let shift: Vec<f64> = match self.centred {
            true => sum.iter().map(|sum| -sum / weight).collect(),
            false => vec![0.0; rank],
        };
        self.components(scatter, weight, shift, count)
    }

    /// The `count` leading components of shapes that occur so often, each a position and a number of times.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub(in crate::dictionary) fn of(
        &self,
        shapes: &[(usize, f64)],
        count: usize,
    ) -> Result<Part, AnalysisError> {
        let rank = self.values.len();
        let (columns, sum) = self.weighted(shapes.iter().copied());
        let mut scatter = Matrix::zeros(rank, rank);
        dense::add_outer_products(&mut scatter, &columns, 1.0);
        let weight: f64 = shapes.iter().map(|&(k, times)| times * self.weights[k]).sum();
        let shift: Vec<f64> = match self.centred {
            true => sum.iter().map(|sum| sum / weight).collect(),
            false => vec![0.0; rank],
        };
        self.components(scatter, weight, shift, count)
    }

    /// `√w z` of shapes, and `Σ w z`.
    fn weighted(&self, shapes: impl Iterator<Item = (usize, f64)>) -> (Vec<f64>, Vec<f64>) {
        let (mut columns, mut sum) = (Vec::new(), vec![0.0; self.values.len()]);
        for (k, times) in shapes {
            let weight = times * self.weights[k];
            columns.extend(self.shape(k).iter().map(|z| weight.sqrt() * z));
            sum.iter_mut().zip(self.shape(k)).for_each(|(sum, z)| *sum += weight * z);
        }
        (columns, sum)
    }

    fn components(
        &self,
        mut scatter: Matrix,
        weight: f64,
        shift: Vec<f64>,
        count: usize,
    ) -> Result<Part, AnalysisError> {
        let moved: Vec<f64> = shift.iter().map(|d| weight.sqrt() * d).collect();
        dense::add_outer_products(&mut scatter, &moved, -1.0);
        let total = scatter.trace();
        let mut pairs = dense::leading_eigenpairs(&scatter, count)?;
        let least = SMALLEST_COMPONENT * pairs.values.first().copied().unwrap_or(0.0);
        let kept = pairs.values.iter().take_while(|value| **value > least).count();
        pairs.values.truncate(kept);
        pairs.vectors = pairs.vectors.columns(0, kept).into_owned();
        Ok(Part { pairs, total, shift, weight })
    }

    /// Shapes of so many subjects drawn with replacement, with how often each occurs.
    pub(in crate::dictionary) fn resampled(&self, random: &mut ChaCha12Rng) -> Vec<(usize, f64)> {
        let count = self.subjects.len();
        let mut times = vec![0.0; count];
        (0..count).for_each(|_| times[random.random_range(0..count)] += 1.0);
        let drawn = self.subjects.iter().zip(times).filter(|(_, times)| *times > 0.0);
        drawn.flat_map(|(members, times)| members.iter().map(move |&k| (k, times))).collect()
    }
}

impl Part {
    /// `√(‖y − ŷ‖²)` of shape `k` by the first 0, 1, …, `count` components.
    pub(in crate::dictionary) fn errors(&self, sample: &Sample, k: usize, count: usize) -> Vec<f64> {
        let away = self.away(sample, k);
        let mut square = sample.outside[k] + dot(&away, &away);
        let mut errors = vec![square.sqrt()];
        for i in 0..count {
            if let Some(v) = (i < self.pairs.values.len()).then(|| self.pairs.vectors.column(i)) {
                square = (square - dot(v.as_slice(), &away).powi(2)).max(0.0);
            }
            errors.push(square.sqrt());
        }
        errors
    }

    /// `z_k − δ`.
    pub(in crate::dictionary) fn away(&self, sample: &Sample, k: usize) -> Vec<f64> {
        sample.shape(k).iter().zip(&self.shift).map(|(z, d)| z - d).collect()
    }
}
