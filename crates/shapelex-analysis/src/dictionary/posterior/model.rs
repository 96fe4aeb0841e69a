//! The model of shapes that a dictionary of components is.

use std::collections::HashMap;

use super::places::AtPlaces;
use super::pose::Freedom;
use crate::AnalysisError;
use crate::dictionary::in_use::Dictionary;
use crate::dictionary::model::Model;
use crate::metric::Metric;
use shapelex_geometry::capability::place::Place;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// Shapes as their mean, with modes of unit variance and a residual.
#[derive(Debug, Clone)]
pub struct PosteriorModel {
    pub(super) metric: Metric,
    /// Unknown part of the pose of a shape.
    pub(super) freedom: Freedom,
    /// Control points of the mean and of the modes, `N × d`, in the pose of the dictionary.
    shapes: Vec<Matrix>,
    /// All control points.
    pub(super) controls: AtPlaces,
    /// As many places along shapes as there are control points.
    pub(super) grid: AtPlaces,
    /// Variance of the residual of a point, for each coordinate.
    pub(super) noise: f64,
    /// Mean scores, `s̄`.
    score_mean: Vec<f64>,
    /// `L` with `s = s̄ + L z`.
    score_root: Matrix,
}

/// Least variance of the residual, divided by that of the modes: components that describe the training shapes fully still do not
/// describe others fully.
const LEAST_NOISE: f64 = 1e-3;

/// Most control points whose own variances are computed: they take the square of their number.
const OWN_VARIANCES: usize = 1024;

impl Dictionary {
    /// The model for posteriors.
    ///
    /// Cost `O(J d N)`, and `O(N²)` for the variances of control points.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `dictionary` for sparse codes and without components.
    pub fn posterior_model(&self, space: &ShapeSpace) -> Result<PosteriorModel, AnalysisError> {
        let refused = |detail: &str| AnalysisError::Parameter { field: "dictionary", detail: detail.into() };
        let Model::Components { pca, spread } = &self.model else {
            return Err(refused(
                "expected a dictionary of components, got sparse codes: they have no posterior",
            ));
        };
        if pca.eigenvalues.is_empty() || !spread.covariance.diagonal().iter().any(|c| *c > 0.0) {
            return Err(refused("expected a dictionary of shapes that vary, got equal ones"));
        }
        let metric = self.metric();
        let root = spread.root();
        // Directions without variance have a column of zeros.
        let kept: Vec<usize> = (0..root.ncols()).filter(|&j| root.column(j).norm_squared() > 0.0).collect();
        let root = Matrix::from_columns(&kept.iter().map(|&j| root.column(j)).collect::<Vec<_>>());
        let mean = pca.reconstruct(&spread.mean);
        let modes = &pca.eigenshapes * &root;
        let freedom = Freedom::of(&self.preparation.method, metric.dimension());
        let residual = self.residual_variance(modes.ncols() + freedom.count());
        let noise = residual.max(LEAST_NOISE * modes.norm_squared() / metric.len() as f64);
        let whitened = std::iter::once(mean.as_slice()).chain(modes.as_slice().chunks_exact(metric.len()));
        let shapes = whitened.map(|shape| {
            let mut shape = shape.to_vec();
            metric.unwhiten(&mut shape);
            Matrix::from_vec(metric.size(), metric.dimension(), shape)
        });
        let shapes: Vec<Matrix> = shapes.collect();
        let of_point = noise * point_variance(metric);
        let own = control_variances(metric, noise).unwrap_or_else(|| vec![of_point; metric.size()]);
        let columns: Vec<Vec<f64>> = shapes.iter().map(|shape| shape.as_slice().to_vec()).collect();
        let controls = AtPlaces::new(metric.dimension(), columns[0].clone(), &columns[1..], own);
        let mut model = PosteriorModel {
            metric: metric.clone(),
            freedom,
            shapes,
            grid: controls.clone(),
            controls,
            noise: of_point,
            score_mean: spread.mean.clone(),
            score_root: root,
        };
        model.grid = model.along(space, &Places::along(space, metric.size()));
        Ok(model)
    }

    /// `ρ²`: variance of a whitened coordinate of a shape that was not learnt from, beside its modes; `unknowns` numbers of a shape
    /// are described by the modes and the pose.
    fn residual_variance(&self, unknowns: usize) -> f64 {
        let statistics = &self.content.statistics;
        let values = match &statistics.held_out {
            Some(held_out) => &held_out.residuals.values,
            None => &statistics.residuals,
        };
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let left = self.metric().len().saturating_sub(unknowns).max(1);
        mean / left as f64
    }
}

/// Variance of a coordinate of a point for whitened coordinates of variance one, on average along the shape: `tr(Φ⁻¹Φ)/⟨1, 1⟩`.
pub(crate) fn point_variance(metric: &Metric) -> f64 {
    let mut ones = vec![0.0; metric.len()];
    ones[..metric.size()].fill(1.0);
    metric.size() as f64 / metric.inner(&ones, &ones)
}

/// Variances of the control points for whitened coordinates of the variance `noise`: the diagonal of `Φ⁻¹`.
pub(crate) fn control_variances(metric: &Metric, noise: f64) -> Option<Vec<f64>> {
    let n = metric.size();
    if n > OWN_VARIANCES {
        return None;
    }
    let mut inverse = Matrix::identity(n, n);
    metric.unwhiten(inverse.as_mut_slice());
    Some(inverse.row_iter().map(|row| noise * row.norm_squared()).collect())
}

impl PosteriorModel {
    /// `d`.
    pub fn dimension(&self) -> usize {
        self.metric.dimension()
    }

    /// Number of control points.
    pub fn size(&self) -> usize {
        self.metric.size()
    }

    /// Number of scores of unit variance.
    pub fn score_count(&self) -> usize {
        self.shapes.len() - 1
    }

    /// Number of components of the dictionary.
    pub fn components(&self) -> usize {
        self.score_mean.len()
    }

    /// Unknown part of the pose of a shape.
    pub fn freedom(&self) -> &Freedom {
        &self.freedom
    }

    /// The model for shapes in the pose of the dictionary, or in their own pose.
    #[must_use]
    pub fn in_pose(&self, known: bool) -> Self {
        let dimension = self.dimension();
        let freedom = if known { Freedom::Fixed { dimension } } else { self.freedom.clone() };
        Self { freedom, ..self.clone() }
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        8 * 3 * self.shapes.len() * self.metric.len() + 4096
    }

    /// All control points.
    pub fn controls(&self) -> &AtPlaces {
        &self.controls
    }

    /// As many places along shapes as there are control points.
    pub fn grid(&self) -> &AtPlaces {
        &self.grid
    }

    /// Scores of the dictionary for scores of unit variance.
    pub fn scores(&self, z: &[f64]) -> Vec<f64> {
        let of = |(i, mean): (usize, &f64)| {
            mean + (0..z.len()).map(|j| self.score_root[(i, j)] * z[j]).sum::<f64>()
        };
        self.score_mean.iter().enumerate().map(of).collect()
    }

    /// Standard deviations of the scores of the dictionary, for a covariance of those of unit variance.
    pub fn score_deviations(&self, covariance: &Matrix) -> Vec<f64> {
        let root = &self.score_root;
        let inner = covariance.view((0, 0), (root.ncols(), root.ncols()));
        (root * inner * root.transpose()).diagonal().iter().map(|v| v.max(0.0).sqrt()).collect()
    }

    /// Shapes at named places; `None` if they have no such places. Several points in the stretch of one control point share its
    /// residual: the variance of each is multiplied by their number.
    pub fn at(&self, space: &ShapeSpace, places: &[Place]) -> Option<AtPlaces> {
        let weights = space.weights_at(places)?;
        let points =
            |shape: &Matrix| shape.column_iter().flat_map(|c| weights.apply_column(c.as_slice())).collect();
        let columns: Vec<Vec<f64>> = self.shapes.iter().map(points).collect();
        let cells: Vec<[i64; 2]> = places.iter().map(|place| self.cell(space, place)).collect();
        let mut shared: HashMap<[i64; 2], f64> = HashMap::new();
        cells.iter().for_each(|cell| *shared.entry(*cell).or_default() += 1.0);
        let noise = cells.iter().map(|cell| self.noise * shared[cell]).collect();
        Some(AtPlaces::new(self.dimension(), columns[0].clone(), &columns[1..], noise))
    }

    /// The stretch of a shape, of the size of one control point, in which a place is.
    fn cell(&self, space: &ShapeSpace, place: &Place) -> [i64; 2] {
        let n = self.size() as f64;
        let of = |u: f64, cells: f64| (u.rem_euclid(1.0) * cells).floor() as i64;
        match place {
            Place::One(u) if space.domain().is_line() => [of(*u, n), 0],
            Place::One(index) => [*index as i64, 0],
            Place::Two([u, v]) => [of(*u, n.sqrt()), of(*v, n.sqrt())],
        }
    }

    /// Shapes at places along them.
    pub fn along(&self, space: &ShapeSpace, places: &Places) -> AtPlaces {
        let columns: Vec<Vec<f64>> = self.shapes.iter().map(|shape| places.points(space, shape)).collect();
        AtPlaces::new(self.dimension(), columns[0].clone(), &columns[1..], vec![self.noise; places.count()])
    }

    /// The centroid of shapes, as a place.
    pub(super) fn centroid(&self) -> AtPlaces {
        let columns: Vec<Vec<f64>> =
            self.shapes.iter().map(|shape| self.metric.centroid(shape.as_slice())).collect();
        // The mean of the residuals along the shape.
        let noise = vec![self.noise / self.size() as f64];
        AtPlaces::new(self.dimension(), columns[0].clone(), &columns[1..], noise)
    }
}
