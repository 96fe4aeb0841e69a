//! Dictionaries of principal components.

use super::content::{Atom, Content};
use super::downdate::Downdate;
use super::model::{Model, Spread};
use super::procedure::{Inconsistency, ParameterFault, Previous, Procedure};
use super::work::{Cost, EIGENPROBLEM, PRODUCT, Size};
use crate::AnalysisError;
use crate::accumulate::{Accumulator, ScatterSum, ShapeSource};
use crate::alignment::Method as Alignment;
use crate::partial_sums::Measured;
use crate::pca::FunctionalPca;
use crate::preparation::{Pose, Preparation};
use crate::watch::{Phase, Watch};
use shapelex_numeric::dense::Matrix;

/// Functional principal components of the aligned shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Components {
    /// Number of components.
    pub(super) components: usize,
    /// Whether components are centred on the arithmetic mean of the aligned shapes.
    pub(super) centre: bool,
}

impl Procedure for Components {
    fn atoms(&self) -> usize {
        self.components
    }

    fn is_sparse(&self) -> bool {
        false
    }

    fn atoms_are_shapes(&self) -> bool {
        !self.centre
    }

    fn described(&self, shapes: usize, length: usize) -> usize {
        self.components.min(length).min(shapes)
    }

    fn faults(&self, max_atoms: usize) -> Vec<ParameterFault> {
        if (1..=max_atoms).contains(&self.components) {
            return Vec::new();
        }
        let detail = format!("expected a number between 1 and {max_atoms}, got {}", self.components);
        vec![ParameterFault { field: "components", detail }]
    }

    fn inconsistencies(&self, content: &Content, bounded: &dyn Fn(&[f64]) -> bool) -> Vec<Inconsistency> {
        let count = content.atoms.len();
        let complete =
            |atom: &Atom| atom.eigenvalue.is_some_and(|value| value > 0.0) && atom.explained.is_some();
        let scores = content.statistics.scores.as_ref().is_some_and(|scores| {
            let rows = &scores.covariance;
            scores.mean.len() == count
                && rows.len() == count
                && rows.iter().all(|row| row.len() == count && bounded(row))
                && bounded(&scores.mean)
                && (0..count).all(|i| rows[i][i] >= 0.0)
        });
        let checks = [
            (content.centre.is_some(), "centre", "required field is missing"),
            (
                content.atoms.iter().all(complete),
                "atoms",
                "expected a positive eigenvalue and the explained part for every atom",
            ),
            (scores, "statistics/scores", "expected mean and covariance of one score per component"),
        ];
        checks.into_iter().filter(|(fits, ..)| !fits).map(|(_, field, detail)| (field, detail)).collect()
    }

    fn pose(&self, _: &Alignment) -> Result<Pose, AnalysisError> {
        Ok(Pose::Aligned { normalise: false })
    }

    /// Reads the shapes once.
    fn fit(
        &self,
        shapes: &dyn ShapeSource,
        previous: Option<Previous<'_>>,
        preparation: &Preparation,
        content: &mut Content,
        watch: &dyn Watch,
    ) -> Result<Vec<u8>, AnalysisError> {
        watch.check()?;
        watch.phase(Phase::Learn, 0.0);
        let metric = &preparation.metric;
        let origin = FunctionalPca::origin(&preparation.mean, self.centre);
        let mut sum = ScatterSum::new(metric.len());
        if let Some(previous) = previous {
            sum.restore(previous.state)?;
        }
        sum.merge(FunctionalPca::scatter(shapes, &origin)?);
        let state = sum.to_bytes();
        let weight = sum.weight();
        let pca = FunctionalPca::from_sum(sum, metric, &origin, self.centre, self.components)?;
        content.centre = Some(metric.rows(&pca.mean));
        content.atoms = (0..pca.eigenvalues.len())
            .map(|i| Atom {
                control_points: metric.rows(pca.eigenshapes.column(i).as_slice()),
                usage: 1.0,
                eigenvalue: Some(pca.eigenvalues[i]),
                explained: Some(pca.explained[i]),
            })
            .collect();
        content.statistics.weight = weight;
        Ok(state)
    }

    fn model(&self, content: &Content, measured: Measured<'_>) -> Result<Model, AnalysisError> {
        let metric = measured.metric;
        let mean = content.centre.as_deref().map_or_else(Vec::new, |centre| metric.whitened(centre));
        let pca = FunctionalPca {
            mean,
            eigenvalues: content.atoms.iter().filter_map(|atom| atom.eigenvalue).collect(),
            explained: content.atoms.iter().filter_map(|atom| atom.explained).collect(),
            eigenshapes: content.columns(metric),
            centred: self.centre,
        };
        let spread = match &content.statistics.scores {
            Some(scores) => {
                let size = scores.mean.len();
                Spread::new(scores.mean.clone(), Matrix::from_fn(size, size, |i, j| scores.covariance[i][j]))
            }
            None => Spread::of(&pca, content.statistics.shapes, content.statistics.weight),
        };
        Ok(Model::Components { pca, spread })
    }

    fn downdate(
        &self,
        content: &Content,
        preparation: &Preparation,
        state: &[u8],
        shapes: usize,
    ) -> Result<Option<Downdate>, AnalysisError> {
        let mut sum = ScatterSum::new(preparation.metric.len());
        sum.restore(state)?;
        let origin = FunctionalPca::origin(&preparation.mean, self.centre);
        Downdate::new(sum, &origin, shapes, self.centre, content.atoms.len()).map(Some)
    }

    fn cost(&self, size: Size) -> Cost {
        let (k, n, c) = (size.shapes, size.length, self.components as f64);
        Cost {
            multiply_adds: PRODUCT * k * n * (n.min(k) + 2.0 * c) + EIGENPROBLEM * n.min(k).powi(3),
            // The vectors of few shapes are kept as they are.
            numbers: 3.0 * n * if 2.0 * k < n { k } else { n },
        }
    }
}
