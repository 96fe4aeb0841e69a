//! Modes of variation, random shapes, and the prior of a dictionary.

use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

use super::in_use::Dictionary;
use super::model::{Model, Spread};
use super::prior::{Prior, Reference};
use crate::AnalysisError;
use crate::alignment::Method;
use crate::metric::Metric;
use crate::pca::FunctionalPca;
use shapelex_numeric::dense::Matrix;

/// The mean and both sides of a mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Explained fraction `λ_i/Σλ`.
    pub explained: f64,
    /// Standard deviation of the scores.
    pub deviation: f64,
    /// Control points at `s̄ − σ·deviation`, at `s̄` and at `s̄ + σ·deviation`.
    pub shapes: [Vec<f64>; 3],
}

/// A random shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Scores of the shape.
    pub scores: Vec<f64>,
    /// Control points, `d·N` coordinate-major numbers in the pose of the dictionary.
    pub control_points: Vec<f64>,
}

/// Draws shapes from the normal distribution of the training scores.
#[derive(Debug)]
pub struct Sampler<'a> {
    metric: &'a Metric,
    pca: &'a FunctionalPca,
    spread: &'a Spread,
    /// A square root of the covariance.
    root: Matrix,
    sigma: f64,
    random: ChaCha12Rng,
}

impl Dictionary {
    /// The mode of `component` (from 0): `ȳ ± sigma·√C_ii ξ_i`. `None` for sparse dictionaries, and for a component that
    /// does not exist.
    pub fn mode(&self, component: usize, sigma: f64) -> Option<Mode> {
        let Model::Components { pca, spread } = &self.model else { return None };
        let explained = *pca.explained.get(component)?;
        let deviation = spread.covariance[(component, component)].max(0.0).sqrt();
        let xi = pca.eigenshapes.column(component);
        let shapes = [-1.0, 0.0, 1.0].map(|side| {
            let step = side * sigma * deviation;
            let mut shape: Vec<f64> = pca.mean.iter().zip(xi.iter()).map(|(m, xi)| m + step * xi).collect();
            self.metric().unwhiten(&mut shape);
            shape
        });
        Some(Mode { explained, deviation, shapes })
    }

    /// Draws shapes whose scores have the mean and `sigma²` times the covariance of the training scores; the same seed
    /// gives the same shapes. `None` for sparse dictionaries, which do not describe how shapes spread.
    pub fn sampler(&self, seed: u64, sigma: f64) -> Option<Sampler<'_>> {
        let Model::Components { pca, spread } = &self.model else { return None };
        let (metric, root) = (self.metric(), spread.root());
        Some(Sampler { metric, pca, spread, root, sigma, random: ChaCha12Rng::seed_from_u64(seed) })
    }

    /// The whitened shapes that span the space that a `reference` names: the mean; or the atoms, with the mean of the aligned shapes if the
    /// components are those about it.
    pub fn span(&self, reference: Reference) -> Vec<Vec<f64>> {
        match (reference, &self.model) {
            (Reference::Mean, _) => vec![self.preparation.mean.clone()],
            (Reference::Atoms, Model::Components { pca, .. }) => {
                let eigenshapes = pca.eigenshapes.column_iter().map(|xi| xi.as_slice().to_vec());
                let mean = pca.centred.then(|| pca.mean.clone());
                mean.into_iter().chain(eigenshapes).collect()
            }
            (Reference::Atoms, Model::Sparse { .. }) => {
                let atoms = self.content.atoms.iter();
                atoms.map(|atom| self.metric().whitened(&atom.control_points)).collect()
            }
        }
    }

    /// The shape prior with the weight `gamma`. Cost: an orthogonal basis of all transformed references.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `reference` if the class is not linear.
    pub fn prior(&self, reference: Reference, gamma: f64) -> Result<Prior, AnalysisError> {
        let Method::Projection(class) = &self.preparation.method else {
            let detail = "expected a dictionary with a linear class: Procrustes fits have no projector";
            return Err(AnalysisError::Parameter { field: "reference", detail: detail.into() });
        };
        Ok(Prior::new(self.metric(), class, &self.span(reference), gamma))
    }
}

impl Sampler<'_> {
    /// The next shape.
    pub fn draw(&mut self) -> Sample {
        let Self { spread, random, .. } = self;
        let z = Matrix::from_fn(spread.mean.len(), 1, |_, _| StandardNormal.sample(random));
        let step = &self.root * &z;
        let scores: Vec<f64> =
            self.spread.mean.iter().zip(step.iter()).map(|(m, s)| m + self.sigma * s).collect();
        let mut control_points = self.pca.reconstruct(&scores);
        self.metric.unwhiten(&mut control_points);
        Sample { scores, control_points }
    }
}
