//! Sizes of many shapes, to be compared.

use crate::AnalysisError;
use crate::metric::{Metric, norm};
use crate::watch::Watch;
use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::size::{SizeMeasure, Sizes};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Sizes beyond this leave the range in which their squares are exact.
pub const LARGEST_SIZE: f64 = 1e100;

/// Sizes of shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct SizeTable {
    /// Measures, one per row.
    pub measures: Vec<SizeMeasure>,
    /// One column per shape.
    pub values: Matrix,
    /// Whether a measure is left out because a size is beyond [`LARGEST_SIZE`].
    pub is_cut: bool,
}

impl SizeTable {
    /// Sizes of the shapes with these control points (`d·N` coordinate-major numbers each), by all measures that shapes of
    /// `space` have. Cost: one quadrature per shape.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `watch` stops.
    pub fn of(
        space: &ShapeSpace,
        metric: &Metric,
        control_points: &[f64],
        watch: &dyn Watch,
    ) -> Result<Self, AnalysisError> {
        let measures = SizeMeasure::of(space);
        let of_shape = |k: usize, sizes: &mut [f64]| -> Result<(), AnalysisError> {
            watch.check()?;
            let shape = &control_points[k * metric.len()..(k + 1) * metric.len()];
            let found = Sizes::of(space, shape, &|| watch.stop());
            watch.worked(1);
            let size = |&measure| found.get(measure).unwrap_or_else(|| centroid_size(space, metric, shape));
            sizes.iter_mut().zip(&measures).for_each(|(value, measure)| *value = size(measure));
            Ok(())
        };
        let mut values = Matrix::zeros(measures.len(), control_points.len() / metric.len());
        parallel::try_for_each_chunk(values.as_mut_slice(), measures.len(), &of_shape)?;
        let fits = |m: &usize| values.row(*m).iter().all(|size| size.abs() <= LARGEST_SIZE);
        let kept: Vec<usize> = (0..measures.len()).filter(fits).collect();
        Ok(Self {
            values: values.select_rows(&kept),
            is_cut: kept.len() < measures.len(),
            measures: kept.into_iter().map(|m| measures[m]).collect(),
        })
    }
}

/// Size about the mean position: of landmarks `√Σ‖p − p̄‖²` (Bookstein 1991), of curves and surfaces `(∫‖r − r̄‖² du)^½`, the
/// `L₂` norm.
pub fn centroid_size(space: &ShapeSpace, metric: &Metric, shape: &[f64]) -> f64 {
    // The metric of landmarks is the mean over them.
    let count = if space.domain() == Domain::Points { metric.size() as f64 } else { 1.0 };
    count.sqrt() * deviation(metric, shape)
}

/// `L₂` norm about the mean position.
fn deviation(metric: &Metric, shape: &[f64]) -> f64 {
    let mut shape = shape.to_vec();
    metric.centre(&mut shape);
    metric.whiten(&mut shape);
    // Squares leave the range of numbers long before sizes do; a power of two changes no digits.
    let largest = shape.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let unit = if largest > f64::MIN_POSITIVE { largest.log2().floor().exp2() } else { 1.0 };
    shape.iter_mut().for_each(|value| *value /= unit);
    unit * norm(&shape)
}
