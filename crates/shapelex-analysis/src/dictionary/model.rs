//! A learnt dictionary in use: codes, reconstructions, scores and outlier measures.
//!
//! ```text
//! components   ŷ = ȳ + Σ_i s_i ξ_i,   s_i = ⟨ξ_i, y − ȳ⟩      T² = (s − s̄)ᵀ C⁺ (s − s̄)
//! sparse       ŷ = Σ_j D_j B_jᵀ
//! ```
//!
//! `y` is a prepared shape ([`preparation`](crate::preparation)).

use super::learning::Learning;
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory, read_numbers, write_numbers};
use crate::algebra::Algebra;
use crate::metric::{dot, norm};
use crate::pca::{FunctionalPca, reconstruction_error};
use crate::preparation::{Posed, Preparation};
use crate::sparse::{Atoms, Coder, Encode, SparseCode};
use crate::watch::Watch;
use shapelex_numeric::dense::{Matrix, symmetric_eigen};

/// Model of shapes.
#[derive(Debug, Clone)]
pub enum Model {
    /// Principal components.
    Components {
        /// The components.
        pca: FunctionalPca,
        /// Mean and covariance of the scores of the training shapes.
        spread: Spread,
    },
    /// Atoms with sparse codes.
    Sparse {
        /// The transformations that act on atoms.
        algebra: Algebra,
        /// The coder.
        coder: Coder,
        /// The transformed atoms, one block of columns each.
        atoms: Atoms,
    },
}

/// Mean and covariance of scores.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Mean scores, `s̄`.
    pub mean: Vec<f64>,
    /// Covariance of the scores, `C`.
    pub covariance: Matrix,
    /// `C⁺`.
    inverse: Matrix,
}

/// Relative eigenvalue of a covariance below which scores do not vary: uncentred components of few shapes are linearly
/// dependent.
const RANK: f64 = 1e-10;

/// Ratio of variance to second moment below which the variance is rounding error.
const CANCELLED: f64 = 1e-13;

impl Spread {
    /// From mean and covariance.
    pub fn new(mean: Vec<f64>, covariance: Matrix) -> Self {
        if covariance.is_empty() {
            // If all shapes are equal, there are no components about their mean.
            return Self { mean, inverse: covariance.clone(), covariance };
        }
        let eigen = symmetric_eigen(&covariance);
        let least = RANK * eigen.eigenvalues.iter().fold(0.0, |most: f64, value| most.max(*value));
        let vectors = &eigen.eigenvectors;
        let scaled = Matrix::from_fn(vectors.nrows(), vectors.ncols(), |i, j| {
            let value = eigen.eigenvalues[j];
            if value > least { vectors[(i, j)] / value } else { 0.0 }
        });
        Self { mean, covariance, inverse: scaled * vectors.transpose() }
    }

    /// From the components learnt from `shapes` shapes with total weight `weight`. The second moments of their scores are
    /// `diag(λ)`, hence `C = (diag(λ) − W s̄ s̄ᵀ)/(W − W/K)`.
    pub fn of(pca: &FunctionalPca, shapes: usize, weight: f64) -> Self {
        let mean = if pca.centred { vec![0.0; pca.eigenvalues.len()] } else { pca.scores(&pca.mean) };
        Self::from_moments(&pca.eigenvalues, mean, shapes, weight)
    }

    /// The same from the eigenvalues `λ` and the mean scores `s̄`.
    pub(super) fn from_moments(eigenvalues: &[f64], mean: Vec<f64>, shapes: usize, weight: f64) -> Self {
        let denominator = weight - weight / shapes as f64;
        let moment = |i: usize, j: usize| {
            let second = if i == j { eigenvalues[i] } else { 0.0 };
            second - weight * mean[i] * mean[j]
        };
        let varies = |i: usize| moment(i, i) > CANCELLED * eigenvalues[i];
        let covariance = Matrix::from_fn(mean.len(), mean.len(), |i, j| {
            if varies(i) && varies(j) { moment(i, j) / denominator } else { 0.0 }
        });
        Self::new(mean, covariance)
    }

    /// A square root of the covariance: `C = Z Zᵀ`.
    pub fn root(&self) -> Matrix {
        if self.covariance.is_empty() {
            return self.covariance.clone();
        }
        let eigen = symmetric_eigen(&self.covariance);
        let vectors = eigen.eigenvectors;
        Matrix::from_fn(vectors.nrows(), vectors.ncols(), |i, j| {
            vectors[(i, j)] * eigen.eigenvalues[j].max(0.0).sqrt()
        })
    }

    /// `T²` of scores.
    pub fn distance(&self, scores: &[f64]) -> f64 {
        let away = Matrix::from_fn(scores.len(), 1, |i, _| scores[i] - self.mean[i]);
        (away.transpose() * &self.inverse * &away)[(0, 0)].max(0.0)
    }
}

impl Model {
    /// Codes of whitened prepared shapes, given one after the other. The scores of a component model are a dense code.
    ///
    /// # Errors
    /// [`AnalysisError::NoConvergence`] for a lasso.
    pub fn codes(&self, whitened: &[f64], length: usize) -> Result<Vec<SparseCode>, AnalysisError> {
        match self {
            Self::Sparse { coder, atoms, .. } => coder.codes(atoms, whitened),
            Self::Components { pca, .. } => {
                let code = |y: &[f64]| {
                    let values = pca.scores(y);
                    let residual = squared_distance(y, &pca.reconstruct(&values));
                    SparseCode {
                        indices: (0..values.len()).collect(),
                        values,
                        objective: 0.5 * residual,
                        duality_gap: None,
                        relative_error: residual.sqrt() / norm(y),
                    }
                };
                Ok(whitened.chunks_exact(length).map(code).collect())
            }
        }
    }

    /// The reconstruction `ŷ` of a code.
    pub fn reconstruct(&self, code: &SparseCode) -> Vec<f64> {
        match self {
            Self::Components { pca, .. } => pca.reconstruct(&code.dense(pca.eigenvalues.len())),
            Self::Sparse { atoms, .. } => {
                let b = atoms.block();
                let mut y = vec![0.0; atoms.matrix().nrows()];
                for (&j, values) in code.indices.iter().zip(code.values.chunks_exact(b)) {
                    for (i, value) in values.iter().enumerate() {
                        let column = atoms.matrix().column(j * b + i);
                        y.iter_mut().zip(column.iter()).for_each(|(sum, d)| *sum += value * d);
                    }
                }
                y
            }
        }
    }

    /// `T²` of a code; `None` for sparse codes.
    pub fn distance(&self, code: &SparseCode) -> Option<f64> {
        match self {
            Self::Components { spread, .. } => Some(spread.distance(&code.values)),
            Self::Sparse { .. } => None,
        }
    }

    /// Atoms or components in blocks of columns, and the number of columns of a block.
    pub fn columns(&self) -> (&Matrix, usize) {
        match self {
            Self::Components { pca, .. } => (&pca.eigenshapes, 1),
            Self::Sparse { atoms, .. } => (atoms.matrix(), atoms.block()),
        }
    }

    /// Number of atoms or components.
    pub fn len(&self) -> usize {
        match self {
            Self::Components { pca, .. } => pca.eigenvalues.len(),
            Self::Sparse { atoms, .. } => atoms.len(),
        }
    }

    /// Whether the model has no atoms or components.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Quality of the description of a set of shapes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Certificate {
    /// Sum of the weights.
    pub weight: f64,
    /// Weighted mean of the objectives of the codes.
    pub objective: f64,
    /// Weighted mean of `‖y − ŷ‖²/(‖y‖‖ŷ‖)`; shapes with an empty code count as 1.
    pub reconstruction_error: f64,
    /// Mean number of real numbers in a code.
    pub parameters: f64,
    /// Fraction of the shapes that use each atom.
    pub usage: Vec<f64>,
    /// `‖y − ŷ‖²` of every shape.
    pub residuals: Vec<f64>,
    /// `T²` of every shape; empty for sparse codes.
    pub distances: Vec<f64>,
}

/// Number of shapes between two calls of the watch.
const STEP: usize = 512;

impl Certificate {
    /// Codes every prepared shape of `source`.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`], errors of the coder and of the source.
    pub fn new(model: &Model, source: &dyn ShapeSource, watch: &dyn Watch) -> Result<Self, AnalysisError> {
        Ok(Coded::new(model, source, watch)?.certificate())
    }
}

/// Quality of the description of each of some shapes, in order. Parts are joined in order, so that the certificate has
/// the same bits whichever process computed them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Coded {
    weights: Vec<f64>,
    objectives: Vec<f64>,
    errors: Vec<f64>,
    residuals: Vec<f64>,
    distances: Vec<f64>,
    /// Total number of real numbers in all codes.
    parameters: f64,
    /// Number of shapes that use each atom.
    usage: Vec<f64>,
}

impl Coded {
    /// Codes every prepared shape of `source`.
    ///
    /// # Errors
    /// As for [`Certificate::new`].
    pub fn new(model: &Model, source: &dyn ShapeSource, watch: &dyn Watch) -> Result<Self, AnalysisError> {
        let mut coded = Self { usage: vec![0.0; model.len()], ..Self::default() };
        source.for_each_batch(&mut |batch| {
            let mut rest = batch;
            while !rest.weights.is_empty() {
                let step;
                (step, rest) = rest.split_at(STEP.min(rest.weights.len()));
                watch.check()?;
                let length = step.whitened.len() / step.weights.len();
                let codes = model.codes(step.whitened, length).map_err(|error| error.after(step.first))?;
                for ((_, y, weight), code) in step.iter().zip(&codes) {
                    coded.add(model, y, weight, code);
                }
            }
            Ok(())
        })?;
        Ok(coded)
    }

    fn add(&mut self, model: &Model, y: &[f64], weight: f64, code: &SparseCode) {
        let reconstructed = model.reconstruct(code);
        self.weights.push(weight);
        self.objectives.push(code.objective);
        self.errors.push(error_of(y, &reconstructed));
        self.parameters += code.values.len() as f64;
        code.indices.iter().for_each(|&j| self.usage[j] += 1.0);
        self.residuals.push(squared_distance(y, &reconstructed));
        self.distances.extend(model.distance(code));
    }

    /// Sums and means over all shapes.
    pub fn certificate(self) -> Certificate {
        let shapes = self.residuals.len() as f64;
        let weight = self.weights.iter().sum();
        let mean = |values: &[f64]| {
            values.iter().zip(&self.weights).fold(0.0, |sum, (value, weight)| sum + weight * value) / weight
        };
        Certificate {
            weight,
            objective: mean(&self.objectives),
            reconstruction_error: mean(&self.errors),
            parameters: self.parameters / shapes,
            usage: self.usage.iter().map(|count| count / shapes).collect(),
            residuals: self.residuals,
            distances: self.distances,
        }
    }

    /// Serialises the values: little-endian, equal bytes for equal values.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let Self { weights, objectives, errors, residuals, distances, parameters, usage } = self;
        for numbers in [weights, objectives, errors, residuals, distances, usage] {
            write_numbers(&mut bytes, numbers);
        }
        write_numbers(&mut bytes, &[*parameters]);
        bytes
    }

    /// Appends the shapes serialised by [`Coded::to_bytes`].
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for any other bytes.
    pub fn append(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let mut next = || read_numbers(&mut bytes);
        let (weights, objectives, errors) = (next()?, next()?, next()?);
        let (residuals, distances, usage, parameters) = (next()?, next()?, next()?, next()?);
        let shapes = weights.len();
        let fits = [&objectives, &errors, &residuals].iter().all(|numbers| numbers.len() == shapes)
            && (distances.is_empty() || distances.len() == shapes)
            && parameters.len() == 1
            && (self.weights.is_empty() || self.usage.len() == usage.len());
        if !fits {
            return Err(AnalysisError::NotAnAccumulator);
        }
        self.weights.extend(weights);
        self.objectives.extend(objectives);
        self.errors.extend(errors);
        self.residuals.extend(residuals);
        self.distances.extend(distances);
        self.parameters += parameters[0];
        self.usage.resize(usage.len(), 0.0);
        self.usage.iter_mut().zip(usage).for_each(|(sum, count)| *sum += count);
        Ok(())
    }
}

/// [`reconstruction_error`], or 1 if the reconstruction is zero.
pub fn error_of(y: &[f64], reconstructed: &[f64]) -> f64 {
    let error = reconstruction_error(y, reconstructed);
    if error.is_finite() { error } else { 1.0 }
}

/// Squared distance `‖a − b‖²`.
pub fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    dot(&difference, &difference)
}

impl Learning {
    /// The model with the learnt atoms.
    pub fn model(&self, atoms: &Matrix) -> Model {
        Model::Sparse { algebra: self.algebra.clone(), coder: self.coder, atoms: self.atoms_of(atoms) }
    }
}

/// Shapes in the form that is coded, one after the other, and their codes.
///
/// # Errors
/// [`AnalysisError::Degenerate`] with the position of the shape; errors of the codes.
pub fn described(
    preparation: &Preparation,
    model: &Model,
    shapes: &ShapesInMemory,
) -> Result<(Vec<f64>, Vec<SparseCode>), AnalysisError> {
    let prepared = ShapesInMemory::of(&Posed { source: shapes, preparation })?.into_whitened();
    let codes = model.codes(&prepared, preparation.metric.len())?;
    Ok((prepared, codes))
}
