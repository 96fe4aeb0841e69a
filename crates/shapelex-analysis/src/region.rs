//! Alignment on a region: shapes are posed by a part of them, and compared as wholes.
//!
//! ```text
//! x_k = (r_k(u_i))_i                            places of the region, of equal weights 1/M
//! A_k, b_k                                      alignment of the x_k, as of landmarks
//! r̃_k = A_k r_k + b_k,   r̄ = Σ w_k r̃_k / Σ w_k   whole shapes in these poses, and their mean
//! ```
//!
//! A difference outside of the region then stays one, and is not a compromise of the pose. An arc of a curve is sampled at four places for
//! each control point, so that `Σ_i |r(u_i)|²/M` is the mean over the arc but for the ends.

use crate::AnalysisError;
use crate::alignment::{AlignedShape, MeanShape};
use crate::correspondence::{Correspondence, Direction, Mirror};
use crate::dictionary::posterior::missing::is_on_arcs;
use crate::dictionary::posterior::places::selected;
use crate::factors::Estimator;
use crate::fit::transform;
use crate::frame::Frame;
use crate::matching::Matching;
use crate::metric::{Metric, dot, norm};
use crate::partial_sums::Measured;
use crate::robust::align_all_by;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// Places of a region of a curve for each control point.
const DENSITY: usize = 4;

/// A part of the shapes of a space.
#[derive(Debug, Clone)]
pub struct Region {
    places: Places,
    /// Which of the places belong to it.
    positions: Vec<usize>,
}

impl Region {
    /// Arcs of a curve, from a first to a last parameter, forwards.
    pub fn of_arcs(space: &ShapeSpace, arcs: &[[f64; 2]]) -> Self {
        let places = Places::along(space, DENSITY * space.representation().size());
        let closed = space.representation().is_closed();
        let positions =
            (0..places.count()).filter(|&i| is_on_arcs(places.parameter(i), arcs, closed)).collect();
        Self { places, positions }
    }

    /// Some of the places of landmarks, of surfaces (their knots) or of refined meshes (their control vertices).
    pub fn of_mask(space: &ShapeSpace, mask: &[bool]) -> Self {
        let places = Places::along(space, space.representation().size());
        let positions = (0..places.count()).filter(|&i| mask.get(i) == Some(&true)).collect();
        Self { places, positions }
    }

    /// Number of places of which a mask chooses.
    pub fn place_count(space: &ShapeSpace) -> usize {
        Places::along(space, space.representation().size()).count()
    }

    /// Number of places in the region.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Mean and aligned shapes of `control_points` in memory, `d·N` numbers per shape, aligned on the region. Correspondence is as given.
    ///
    /// The residual and the correlation of an aligned shape are those of the whole. Cost: that of an alignment of landmarks.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `region` below two places; degenerate parts of shapes, with their position; too few shapes;
    /// [`AnalysisError::Interrupted`].
    pub fn align(
        &self,
        space: &ShapeSpace,
        Measured { metric, method, .. }: Measured<'_>,
        frame: Frame,
        control_points: &[f64],
        weights: &[f64],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
        let (n, d) = (metric.size(), metric.dimension());
        let refused = |detail: String| AnalysisError::Parameter { field: "region", detail };
        let part = ShapeSpace::of_points(d, self.len()).ok().filter(|_| self.len() >= 2);
        let part = part.ok_or_else(|| refused(format!("expected at least 2 places, got {}", self.len())))?;
        let matching = Matching::new(&part, Correspondence::Landmarks, Direction::default(), Mirror::Forbid)
            .translating(method.translates());
        let points = control_points.chunks_exact(n * d).flat_map(|shape| {
            let all = self.places.points(space, &Matrix::from_column_slice(n, d, shape));
            selected(&all, d, &self.positions)
        });
        let own = Metric::of(&part);
        let measured = Measured { metric: &own, method, matching: &matching };
        let (mean, parts) =
            align_all_by(Estimator::Plain, measured, frame, points.collect(), weights.to_vec(), stop)?;
        let whole = |(part, shape): (&AlignedShape, &[f64])| {
            let mut moved = transform(&part.matrix, shape);
            for (coordinate, by) in moved.chunks_exact_mut(n).zip(&part.offset) {
                coordinate.iter_mut().for_each(|value| *value += by);
            }
            moved
        };
        let moved: Vec<Vec<f64>> = parts.iter().zip(control_points.chunks_exact(n * d)).map(whole).collect();
        let mean_points = average(&moved, weights);
        let mut whitened = mean_points.clone();
        metric.whiten(&mut whitened);
        let aligned = parts.into_iter().zip(moved).map(|(part, mut shape)| {
            metric.whiten(&mut shape);
            let residual = whitened.iter().zip(&shape).map(|(m, r)| (m - r).powi(2)).sum::<f64>().sqrt();
            let product = norm(&whitened) * norm(&shape);
            let correlation = if product > 0.0 { dot(&whitened, &shape) / product } else { 0.0 };
            AlignedShape { whitened: shape, residual, correlation: correlation.clamp(-1.0, 1.0), ..part }
        });
        let aligned = aligned.collect();
        Ok((
            MeanShape { whitened, control_points: mean_points, basis: None, disagreement: None, ..mean },
            aligned,
        ))
    }
}

/// `Σ w_k r_k / Σ w_k`.
fn average(shapes: &[Vec<f64>], weights: &[f64]) -> Vec<f64> {
    let total: f64 = weights.iter().sum();
    let mut mean = vec![0.0; shapes.first().map_or(0, Vec::len)];
    for (shape, weight) in shapes.iter().zip(weights) {
        mean.iter_mut().zip(shape).for_each(|(sum, value)| *sum += weight / total * value);
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alignment::{Alignment, Method};
    use crate::transformation::{ClassName, Transformation};

    /// Two squares each with a different fifth point, turned, moved and scaled.
    fn shapes(count: usize) -> Vec<f64> {
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
        let shape = |k: usize| -> Vec<f64> {
            let (turn, size) = (0.7 * k as f64, 1.0 + 0.3 * k as f64);
            let far = [5.0, 0.5 + k as f64];
            let points = corners.iter().chain([&far]).map(|p| {
                let (sin, cos) = turn.sin_cos();
                [size * (cos * p[0] - sin * p[1]) + 3.0, size * (sin * p[0] + cos * p[1]) - k as f64]
            });
            let points: Vec<[f64; 2]> = points.collect();
            (0..2).flat_map(|c| points.iter().map(move |p| p[c]).collect::<Vec<f64>>()).collect()
        };
        (0..count).flat_map(shape).collect()
    }

    fn aligned(mask: &[bool], alignment: Alignment) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
        let space = ShapeSpace::of_points(2, 5).unwrap();
        let similarity = Transformation::Named(ClassName::Similarity);
        let method = Method::new(&similarity, alignment, 2).unwrap();
        let matching = Matching::new(&space, Correspondence::Landmarks, Direction::default(), Mirror::Forbid)
            .translating(true);
        let metric = Metric::of(&space);
        let measured = Measured { metric: &metric, method: &method, matching: &matching };
        let region = Region::of_mask(&space, mask);
        region.align(&space, measured, Frame::Training, &shapes(6), &[1.0; 6], &|| false)
    }

    /// Parts that are equal within the region coincide, and all of the difference is outside of it.
    #[test]
    fn equal_regions_coincide() {
        for alignment in [Alignment::Projection, Alignment::Procrustes] {
            let (mean, shapes) = aligned(&[true, true, true, true, false], alignment).unwrap();
            for (k, shape) in shapes.iter().enumerate() {
                for i in (0..10).filter(|i| i % 5 < 4) {
                    let (found, wanted) = (shape.whitened[i], mean.whitened[i]);
                    assert!((found - wanted).abs() < 1e-9, "{alignment:?} {k} {i}: {found} {wanted}");
                }
                let far = |c: usize| shape.whitened[4 + 5 * c] - mean.whitened[4 + 5 * c];
                assert!((far(0).hypot(far(1)) - shape.residual).abs() < 1e-9, "{alignment:?} {k}");
                assert!(shape.residual > 0.05 || !(k == 0 || k == 5), "{alignment:?} {k} {}", shape.residual);
            }
        }
    }

    #[test]
    fn regions_without_extent_are_refused() {
        let field = |mask: &[bool]| match aligned(mask, Alignment::Projection) {
            Err(AnalysisError::Parameter { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field(&[false; 5]), "region");
        assert_eq!(field(&[true, false, false, false, false]), "region");
    }
}
