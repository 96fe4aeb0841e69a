//! Shapes of a study: aligned to one mean, which knows nothing of groups or attributes.

use std::borrow::Cow;

use super::error::StudyError;
use super::limits::MAX_WEIGHT_RATIO;
use crate::AnalysisError;
use crate::accumulate::{ShapesInMemory, Watched};
use crate::alignment::{MeanShape, Method, mean_shape, unwhitened};
use crate::frame::Frame;
use crate::matching::Matching;
use crate::metric::Metric;
use crate::rows::{Row, rows_of};
use crate::size::{LARGEST_SIZE, SizeTable};
use crate::tangent::to_tangent;
use crate::transformation::Transformation;
use crate::watch::Watch;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_geometry::size::SizeMeasure;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Space of the shapes of a study, and how they are aligned.
#[derive(Debug, Clone, Copy)]
pub struct StudySpace<'a> {
    /// Space of the shapes.
    pub space: &'a ShapeSpace,
    /// Metric of the space.
    pub metric: &'a Metric,
    /// Projection or Procrustes alignment.
    pub method: &'a Method,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean.
    pub tangent: bool,
    /// Frame of the mean; [`frame_for`] gives the usual one.
    pub frame: Frame,
    /// Search over start points, directions and mirror images.
    pub matching: &'a Matching,
}

/// Frame of the mean of a study. Where the class allows it, the mean depends on the subspaces alone, so that no statistic
/// changes when shapes are moved by members of the class.
pub fn frame_for(transformation: &Transformation) -> Frame {
    match transformation {
        Transformation::Named(_) => Frame::Canonical,
        Transformation::Custom(_) => Frame::Training,
    }
}

/// Shapes aligned to their mean.
#[derive(Debug, Clone)]
pub struct AlignedShapes<'a> {
    pub(crate) space: StudySpace<'a>,
    /// The mean; its placements are those of the shapes.
    pub mean: MeanShape,
    /// Prepared shapes placed on the mean, one per column, whitened.
    pub placed: Matrix,
    /// Aligned shapes, one per column, whitened.
    pub aligned: Matrix,
    /// Positive weights.
    pub weights: Vec<f64>,
    /// Sizes before alignment.
    pub sizes: SizeTable,
}

impl<'a> AlignedShapes<'a> {
    /// Aligns shapes to their mean: `d·N` coordinate-major control points each, and one positive weight. `watch` is asked
    /// between passes, and counts them.
    ///
    /// # Errors
    /// [`StudyError::Weights`]; degenerate or too few shapes; [`AnalysisError::Interrupted`] once `watch` stops.
    pub fn new(
        space: StudySpace<'a>,
        control_points: Vec<f64>,
        weights: Vec<f64>,
        watch: &dyn Watch,
    ) -> Result<Self, StudyError> {
        check_weights(&weights)?;
        let StudySpace { metric, method, tangent, frame, matching, .. } = space;
        let sizes = SizeTable::of(space.space, metric, &control_points, watch)?;
        let source = ShapesInMemory::new(metric, method.translates(), control_points, weights.clone())?;
        watch.check()?;
        let mean = mean_shape(&Watched::new(&source, watch), metric, method, frame, matching)?;
        // In place: 100 000 shapes in separate vectors would take more memory, and leave it in pieces.
        let mut placed = source.into_whitened();
        parallel::for_each_chunk(&mut placed, metric.len(), &|k, x| {
            if let Cow::Owned(moved) = matching.place(x, mean.placements[k]) {
                x.copy_from_slice(&moved);
            }
        });
        let mut aligned = placed.clone();
        parallel::try_for_each_chunk(&mut aligned, metric.len(), &|k, x| {
            watch.check()?;
            watch.worked(1);
            bring((method, tangent), &mean.whitened, x).map_err(|error| error.at(k))
        })?;
        let columns = |values| Matrix::from_vec(metric.len(), weights.len(), values);
        Ok(Self { space, mean, placed: columns(placed), aligned: columns(aligned), weights, sizes })
    }

    /// Number of shapes.
    pub fn count(&self) -> usize {
        self.weights.len()
    }

    /// Weighted mean of the aligned shapes at `members`, whitened; computed relative to the first one to avoid cancellation.
    pub(super) fn average(&self, members: &[usize]) -> Vec<f64> {
        let (columns, weights) = (&self.aligned, &self.weights);
        let first = columns.column(members[0]);
        let total: f64 = members.iter().map(|&k| weights[k]).sum();
        let mut sum = vec![0.0; columns.nrows()];
        for &k in members {
            let column = columns.column(k);
            let differences = column.iter().zip(first.iter()).map(|(value, first)| value - first);
            sum.iter_mut().zip(differences).for_each(|(sum, difference)| *sum += weights[k] * difference);
        }
        sum.iter().zip(first.iter()).map(|(sum, first)| first + sum / total).collect()
    }

    /// Rows of control points of a whitened shape.
    pub(super) fn rows(&self, whitened: &[f64]) -> Vec<Row> {
        let metric = self.space.metric;
        rows_of(&unwhitened(metric, whitened), metric.dimension())
    }

    /// Whitened shapes at places along them, coordinate-major, one a column.
    pub(crate) fn points(&self, whitened: &Matrix, places: &Places) -> Matrix {
        let StudySpace { space, metric, .. } = self.space;
        let (size, dimension) = (metric.size(), metric.dimension());
        let mut points = Matrix::zeros(places.count() * dimension, whitened.ncols());
        parallel::for_each_chunk(points.as_mut_slice(), places.count() * dimension, &|k, column| {
            let control_points = unwhitened(metric, whitened.column(k).as_slice());
            let shape = Matrix::from_column_slice(size, dimension, &control_points);
            column.copy_from_slice(&places.points(space, &shape));
        });
        points
    }

    /// Natural logarithms of the centroid sizes; `None` if a shape is too large to be measured.
    pub fn log_centroid_sizes(&self) -> Option<Vec<f64>> {
        let row = self.sizes.measures.iter().position(|&measure| measure == SizeMeasure::CentroidSize)?;
        Some(self.sizes.values.row(row).iter().map(|size| size.ln()).collect())
    }

    /// Warning about sizes that are left out.
    pub(super) fn size_warning(&self) -> Option<String> {
        self.sizes.is_cut.then(|| format!("sizes beyond {LARGEST_SIZE:.0e} are not compared"))
    }
}

/// Warnings about the mean of all shapes.
pub fn mean_warnings(mean: &MeanShape) -> Vec<String> {
    let mut warnings = Vec::new();
    if mean.unique == Some(false) {
        warnings.push(
            "the pooled mean is not unique: the eigenvalue gap is below 1e-6 of the total weight".into(),
        );
    }
    if !mean.converged {
        warnings.push(format!("the pooled mean has not converged after {} rounds", mean.rounds));
    }
    warnings
}

/// Aligns a whitened shape to the mean, in place.
fn bring((method, tangent): (&Method, bool), mean: &[f64], shape: &mut [f64]) -> Result<(), AnalysisError> {
    shape.copy_from_slice(&method.bring(shape, mean)?.whitened);
    if tangent { to_tangent(mean, shape) } else { Ok(()) }
}

fn check_weights(weights: &[f64]) -> Result<(), StudyError> {
    let smallest = weights.iter().copied().fold(f64::MAX, f64::min);
    check_weight_range(smallest, weights.iter().copied().fold(0.0, f64::max))
}

/// Checks that no shape dominates the others.
///
/// # Errors
/// [`StudyError::Weights`].
pub fn check_weight_range(smallest: f64, largest: f64) -> Result<(), StudyError> {
    if largest <= MAX_WEIGHT_RATIO * smallest {
        return Ok(());
    }
    Err(StudyError::Weights { smallest, largest })
}

/// Weighted mean of numbers, and their standard deviation `√(n/(n−1) · Σw(x − x̄)²/Σw)`.
pub(super) fn mean_and_deviation(values: &[f64], weights: &[f64]) -> (f64, f64) {
    let total: f64 = weights.iter().sum();
    let first = values[0];
    let mean = first + values.iter().zip(weights).map(|(x, w)| w * (x - first)).sum::<f64>() / total;
    let squares = values.iter().zip(weights).map(|(x, w)| w * (x - mean).powi(2)).sum::<f64>();
    let n = values.len() as f64;
    (mean, (squares / total * n / (n - 1.0)).sqrt())
}
