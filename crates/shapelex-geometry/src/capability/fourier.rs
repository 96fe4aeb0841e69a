//! Curves given by Fourier coefficients: their points, and their control points where a space contains them.

use std::f64::consts::TAU;

use crate::curve::Curve;
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Maximum distance between a curve of a space and the given one, relative to the extent of the given one: rounding of
/// interpolation, far below what a missing harmonic of any weight in a drawing would cause.
const SAME: f64 = 1e-9;
/// Number of places between two control points at which curves are compared.
const PLACES: usize = 4;

/// A closed curve `r(t) = c + Σ_{k=1…n} a_k cos 2πkt + b_k sin 2πkt`, `0 ≤ t < 1`.
#[derive(Debug, Clone, Copy)]
pub struct FourierCurve<'a> {
    /// `c`, one number a dimension.
    pub constant: &'a [f64],
    /// `a_k`, n × d, row-major.
    pub cosine: &'a [f64],
    /// `b_k`, n × d, row-major.
    pub sine: &'a [f64],
}

impl FourierCurve<'_> {
    /// Number of harmonics.
    pub fn harmonics(&self) -> usize {
        self.cosine.len().checked_div(self.constant.len()).unwrap_or(0)
    }

    /// Points at `count` equally spaced `t`, one a row. Cost: `count · n` sines and cosines.
    pub fn points(&self, count: usize) -> Matrix {
        let (d, n) = (self.constant.len(), self.harmonics());
        let mut points = Matrix::from_fn(count, d, |_, c| self.constant[c]);
        for j in 0..count {
            for k in 1..=n {
                // The angle is reduced in whole numbers: it is as exact for the last harmonic as for the first.
                let turns = (j as u128 * k as u128 % count as u128) as f64 / count as f64;
                let (sine, cosine) = (TAU * turns).sin_cos();
                for c in 0..d {
                    let at = (k - 1) * d + c;
                    points[(j, c)] += self.cosine[at] * cosine + self.sine[at] * sine;
                }
            }
        }
        points
    }
}

impl ShapeSpace {
    /// Control points of a Fourier curve, if the space contains it: the same curve with the same parameter.
    ///
    /// The curve of the space through the points at its knots is compared with the given one between them. Cost: sines of
    /// [`FourierCurve::points`] at four places a control point.
    pub fn fourier_control_points(&self, fourier: &FourierCurve<'_>) -> Option<Matrix> {
        let representation = self.representation();
        let (n, d) = (representation.size(), fourier.constant.len());
        // Points at knots tell no more harmonics than this apart.
        if !representation.is_closed() || representation.dimension() != d || 2 * fourier.harmonics() >= n {
            return None;
        }
        let control_points = self.interpolate(fourier.points(n)).ok()?;
        let count = PLACES * n;
        let (wanted, curve) = (fourier.points(count), Curve::of(self, &control_points)?);
        let places: Vec<f64> = (0..count).map(|j| j as f64 / count as f64).collect();
        let found = curve.evaluate_all(&places, 0);
        let extent = wanted.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
        let agrees = wanted.iter().zip(&found).all(|(wanted, found)| (wanted - found).abs() <= SAME * extent);
        agrees.then_some(control_points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;

    fn space(control_points: usize, generator: GeneratorKind) -> ShapeSpace {
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points, generator }).unwrap()
    }

    const ELLIPSE: FourierCurve<'static> =
        FourierCurve { constant: &[3.0, -1.0], cosine: &[2.0, 0.5], sine: &[-0.25, 1.0] };
    const BEAN: FourierCurve<'static> = FourierCurve {
        constant: &[3.0, -1.0],
        cosine: &[2.0, 0.5, 0.25, 0.0],
        sine: &[-0.25, 1.0, 0.0, 0.125],
    };

    #[test]
    fn points_are_those_of_the_formula() {
        let points = ELLIPSE.points(4);
        let rows = [[5.0, -0.5], [2.75, 0.0], [1.0, -1.5], [3.25, -2.0]];
        for (j, row) in rows.iter().enumerate() {
            for c in 0..2 {
                assert!((points[(j, c)] - row[c]).abs() < 1e-15, "{j} {c} {}", points[(j, c)]);
            }
        }
    }

    #[test]
    fn a_space_that_contains_a_curve_gives_it_back() {
        let trigonometric = space(7, GeneratorKind::Trigonometric {});
        let control_points = trigonometric.fourier_control_points(&ELLIPSE).unwrap();
        let curve = Curve::of(&trigonometric, &control_points).unwrap();
        let (found, wanted) = (curve.evaluate_all(&[0.3], 0), ELLIPSE.points(10));
        assert!((found[0] - wanted[(3, 0)]).abs() < 1e-14 && (found[1] - wanted[(3, 1)]).abs() < 1e-14);
        // The generator has the pole of the first harmonic only.
        assert!(trigonometric.fourier_control_points(&BEAN).is_none());
        let splines = space(7, GeneratorKind::Bspline { degree: 3 });
        assert!(splines.fourier_control_points(&ELLIPSE).is_none());
        // Three points do not tell a second harmonic from the first.
        assert!(space(3, GeneratorKind::Trigonometric {}).fourier_control_points(&BEAN).is_none());
    }
}
