//! Mean and principal components of any source of shapes: of a revision, or, to compare, of shapes in memory.

use serde::Serialize;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::ShapeSource;
use shapelex_analysis::alignment::{MeanShape, mean_shape};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::preparation::Posed;

use crate::cohort::revision::Setting;

/// What is computed.
#[derive(Debug, Clone, Copy)]
pub struct Request {
    /// Selects the representative of the mean space.
    pub frame: Frame,
    /// Number of components; none for the mean alone.
    pub components: usize,
    /// Whether the mean is subtracted from the aligned shapes.
    pub centred: bool,
    /// Whether aligned shapes are divided by their norms.
    pub normalise: bool,
}

/// What was computed.
#[derive(Debug, Clone)]
pub struct Statistics {
    /// The mean.
    pub mean: MeanShape,
    /// The components of the shapes aligned to it, if they were asked for.
    pub pca: Option<FunctionalPca>,
}

impl Statistics {
    /// Mean and components of the shapes of `source`, prepared as the setting's method wants them.
    ///
    /// Cost: a pass for the mean space and one for its frame, or one for each iteration of a Procrustes fit; one for the components.
    /// Memory beside a part: the sums, and 8 bytes a shape for its placement.
    ///
    /// # Errors
    /// Fewer than two shapes, degenerate shapes, errors of the source.
    pub fn of(source: &dyn ShapeSource, setting: &Setting, request: Request) -> Result<Self, AnalysisError> {
        let Setting { metric, method, matching, .. } = setting;
        let Request { frame, components, centred, normalise } = request;
        let mean = mean_shape(source, metric, method, frame, matching)?;
        if components == 0 {
            return Ok(Self { mean, pca: None });
        }
        let preparation = setting.aligned_to(&mean.whitened, normalise);
        let posed = Posed { source, preparation: &preparation };
        let pca = FunctionalPca::new(&posed, metric, &preparation.mean, centred, components)?;
        Ok(Self { mean, pca: Some(pca) })
    }

    /// blake3 digest of all numbers: equal for equal bits.
    pub fn digest(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut add = |numbers: &[f64]| {
            hasher.update(&(numbers.len() as u64).to_le_bytes());
            numbers.iter().for_each(|value| {
                hasher.update(&value.to_le_bytes());
            });
        };
        add(&self.mean.whitened);
        add(&self.mean.eigenvalues);
        add(self.mean.objective.as_slice());
        if let Some(pca) = &self.pca {
            add(&pca.mean);
            add(&pca.eigenvalues);
            add(pca.eigenshapes.as_slice());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// The statistics as a document.
    pub fn report(&self, setting: &Setting) -> Report {
        let rows = |whitened: &[f64]| setting.metric.rows(whitened);
        let component = |pca: &FunctionalPca, i: usize| Component {
            eigenvalue: pca.eigenvalues[i],
            explained_fraction: pca.explained[i],
            control_points: rows(pca.eigenshapes.column(i).as_slice()),
        };
        Report {
            digest: self.digest(),
            shape_count: self.mean.shapes,
            rounds: self.mean.rounds,
            converged: self.mean.converged,
            unique: self.mean.unique,
            eigenvalues: self.mean.eigenvalues.clone(),
            mean: rows(&self.mean.whitened),
            components: self
                .pca
                .iter()
                .flat_map(|pca| (0..pca.eigenvalues.len()).map(move |i| component(pca, i)))
                .collect(),
        }
    }
}

/// Control points, one row per point.
type Points = Vec<Vec<f64>>;

/// Statistics as a document.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Digest of all numbers.
    pub digest: String,
    /// Number of shapes.
    pub shape_count: usize,
    /// Rounds of a search of placements, or iterations of a fit.
    pub rounds: usize,
    /// Whether the last round changed nothing.
    pub converged: bool,
    /// Whether the mean is unique; null for fits.
    pub unique: Option<bool>,
    /// Leading eigenvalues of the mean operator; empty for fits.
    pub eigenvalues: Vec<f64>,
    /// The mean.
    pub mean: Points,
    /// The components.
    pub components: Vec<Component>,
}

/// A component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Component {
    /// Sum of squared scores.
    pub eigenvalue: f64,
    /// Its fraction of the total.
    pub explained_fraction: f64,
    /// The eigenshape.
    pub control_points: Points,
}
