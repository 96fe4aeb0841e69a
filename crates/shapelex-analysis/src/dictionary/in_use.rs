//! A dictionary in use: its content, prepared for computation.

use super::content::{Content, HeldOutStatistics};
use super::model::{Coded, Model, Spread};
use crate::AnalysisError;
use crate::accumulate::ShapeSource;
use crate::metric::Metric;
use crate::partial_sums::Measured;
use crate::preparation::{Pose, Posed, Preparation};
use crate::rows::columns_of;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

/// A dictionary in use.
#[derive(Debug, Clone)]
pub struct Dictionary {
    /// Learnt statistics, with the parameters of learning.
    pub content: Content,
    /// Preparation of shapes for coding.
    pub preparation: Preparation,
    /// Atoms or components.
    pub model: Model,
    /// Scores of the held-out shapes without gross errors; `None` if there were none.
    typical: Option<Spread>,
}

impl Dictionary {
    /// Prepares a content, learnt or read, for use with the metric, alignment and matching of its recipe. Training and
    /// use start from the same recorded numbers. Cost: the products of all atoms.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] if the parts are inconsistent (in a content that was not learnt here).
    pub fn new(content: Content, measured: Measured<'_>) -> Result<Self, AnalysisError> {
        let model = content.method.model(&content, measured)?;
        let preparation = content.preparation(measured)?;
        let held_out = content.statistics.held_out.clone();
        Ok(Self { content, preparation, model, typical: None }.holding_out(held_out))
    }

    /// The dictionary with these measures of held-out shapes.
    pub(super) fn holding_out(mut self, held_out: Option<HeldOutStatistics>) -> Self {
        let scores = held_out.as_ref().and_then(|held| held.gross_errors.as_ref()?.scores.as_ref());
        self.typical = scores.map(|scores| {
            let q = scores.mean.len();
            let covariance = Matrix::from_fn(q, q, |i, j| scores.covariance[i][j]);
            Spread::new(scores.mean.clone(), covariance)
        });
        self.content.statistics.held_out = held_out;
        self
    }

    /// Distance of scores by which outliers are found, if it is not `T²`.
    pub(super) fn typical_distance(&self, scores: &[f64]) -> Option<f64> {
        self.typical.as_ref().map(|typical| typical.distance(scores))
    }

    /// Metric of the shapes.
    pub fn metric(&self) -> &Metric {
        &self.preparation.metric
    }

    /// Whether codes are invariant: atoms are transformed by members of the class.
    pub fn is_invariant(&self) -> bool {
        matches!(self.preparation.pose, Pose::Invariant(_))
    }

    /// Whether it has components about a mean: differences between shapes, rather than shapes.
    pub fn is_centred(&self) -> bool {
        matches!(&self.model, Model::Components { pca, .. } if pca.centred)
    }

    /// Control points of atom `j`, `d·N` coordinate-major numbers.
    pub fn atom(&self, j: usize) -> Vec<f64> {
        columns_of(&self.content.atoms[j].control_points, self.metric().dimension())
    }

    /// Quality of the description of each shape of `source`, from which a certificate is made.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`]; errors of the coder and of the source.
    pub fn coded(&self, source: &dyn ShapeSource, watch: &dyn Watch) -> Result<Coded, AnalysisError> {
        Coded::new(&self.model, &Posed { source, preparation: &self.preparation }, watch)
    }
}

impl Content {
    /// Whitened atoms, one per column.
    pub(super) fn columns(&self, metric: &Metric) -> Matrix {
        let columns = self.atoms.iter().flat_map(|atom| metric.whitened(&atom.control_points)).collect();
        Matrix::from_vec(metric.len(), self.atoms.len(), columns)
    }
}
