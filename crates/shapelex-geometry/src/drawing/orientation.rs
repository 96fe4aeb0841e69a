//! Orientation of shapes in drawings: upright, and the same for all shapes that differ by a rotation.
//!
//! The longest principal axis points up; of shapes in space, the second one points right. The remaining choice, to turn
//! the shape by half a turn about an axis, is made by the third moment `m = Σ p |p|²` about the centroid: of the turns, the one
//! with the largest `⟨m, g⟩` is taken, with a fixed direction `g` on the page that is askew to the axes, since shapes with a
//! mirror axis have their moment along or across it. A planar shape whose axes are equally long has its moment upwards.

use super::layer::rows_of_dimension;
use crate::representation::ShapeSpace;
use crate::sampling::Places;
use crate::vector::{cross, dot};
use shapelex_numeric::dense::{Matrix, leading_eigenpairs};

/// A rotation, or none.
#[derive(Debug, Clone, Default)]
pub struct Orientation {
    /// Its matrix, row by row.
    rows: Option<Vec<Vec<f64>>>,
}

/// Number of places on a curve that are looked at.
const PLACES: usize = 256;
/// Least difference of two principal moments, relative to the largest, at which their axes are told apart.
const ROUND: f64 = 0.02;
/// Least length of the third moment, relative to `Σ |p|³`, at which it has a direction.
const SYMMETRIC: f64 = 1e-6;
/// Direction on the page towards which the third moment is turned: right, up, towards the viewer.
const GENERIC: [f64; 3] = [0.5, 0.8, 0.33];

/// Right, up, and towards the viewer of drawings of shapes in space.
const SCREEN: [[f64; 3]; 3] = {
    let (a, b, c) = (std::f64::consts::FRAC_1_SQRT_2, 0.408_248_290_463_863, 0.577_350_269_189_625_8);
    [[a, a, 0.0], [-b, b, 2.0 * b], [c, -c, c]]
};

impl Orientation {
    /// The orientation that shapes have.
    pub fn as_given() -> Self {
        Self::default()
    }

    /// The rotation that puts a shape of `space`, given by control points, upright. None for shapes without a direction, such
    /// as circles.
    pub fn upright(space: &ShapeSpace, shape: &[f64]) -> Self {
        let d = space.representation().dimension();
        let places = Places::along(space, PLACES);
        let points = places.points(space, &rows_of_dimension(shape, d));
        let count = places.count();
        let centroid: Vec<f64> =
            points.chunks_exact(count).map(|c| c.iter().sum::<f64>() / count as f64).collect();
        let point = |k: usize| (0..d).map(|c| points[c * count + k] - centroid[c]).collect::<Vec<f64>>();
        let moments = Moments::of((0..count).map(point), d);
        let rows = match d {
            2 => moments.upright_in_plane(),
            3 => moments.upright_in_space(),
            _ => None,
        };
        Self { rows }
    }

    /// Control points in this orientation.
    pub fn turn(&self, shape: &[f64]) -> Vec<f64> {
        let Some(rows) = &self.rows else { return shape.to_vec() };
        let count = shape.len() / rows.len();
        let coordinate = |row: &Vec<f64>| {
            let at = |k: usize| row.iter().enumerate().map(|(c, x)| x * shape[c * count + k]).sum::<f64>();
            (0..count).map(at).collect::<Vec<f64>>()
        };
        rows.iter().flat_map(coordinate).collect()
    }
}

/// Moments of points about their centroid.
struct Moments {
    /// `Σ p pᵀ`.
    second: Matrix,
    /// `Σ p |p|²`.
    third: Vec<f64>,
    /// `Σ |p|³`.
    size: f64,
}

impl Moments {
    fn of(points: impl Iterator<Item = Vec<f64>>, d: usize) -> Self {
        let start = Self { second: Matrix::zeros(d, d), third: vec![0.0; d], size: 0.0 };
        points.fold(start, |mut moments, p| {
            let square: f64 = p.iter().map(|x| x * x).sum();
            for (i, x) in p.iter().enumerate() {
                moments.third[i] += x * square;
                for (j, y) in p.iter().enumerate() {
                    moments.second[(i, j)] += x * y;
                }
            }
            moments.size += square.powf(1.5);
            moments
        })
    }

    /// Whether the third moment has a direction.
    fn has_direction(&self) -> bool {
        self.third.iter().map(|x| x * x).sum::<f64>().sqrt() > SYMMETRIC * self.size
    }

    /// Rows of the rotation of the plane: right and up.
    fn upright_in_plane(&self) -> Option<Vec<Vec<f64>>> {
        let axes = leading_eigenpairs(&self.second, 2).ok()?;
        let [x, y] = [self.third[0], self.third[1]];
        let round = !(axes.values[0] - axes.values[1] > ROUND * axes.values[0]);
        let up = match (round, self.has_direction()) {
            (true, false) => return None,
            (true, true) => [x / x.hypot(y), y / x.hypot(y)],
            (false, _) => [axes.vectors[(0, 0)], axes.vectors[(1, 0)]],
        };
        let towards =
            |up: [f64; 2]| GENERIC[0] * (x * up[1] - y * up[0]) + GENERIC[1] * (x * up[0] + y * up[1]);
        // A point-symmetric shape looks the same upside down; the rule then only makes the choice definite.
        let sign = match self.has_direction() {
            true => towards(up),
            false => up[1] + 1e-3 * up[0],
        };
        let up = up.map(|value| if sign < 0.0 { -value } else { value });
        Some(vec![vec![up[1], -up[0]], up.to_vec()])
    }

    /// Rows of the rotation of space that shows the longest axis upwards and the second one to the right.
    fn upright_in_space(&self) -> Option<Vec<Vec<f64>>> {
        let axes = leading_eigenpairs(&self.second, 3).ok()?;
        if !(axes.values[0] - axes.values[2] > ROUND * axes.values[0]) {
            return None;
        }
        let axis = |i: usize| [0, 1, 2].map(|c| axes.vectors[(c, i)]);
        let third = [self.third[0], self.third[1], self.third[2]];
        let turned = |[right, up]: [f64; 2]| {
            let (right, up) = (axis(1).map(|x| right * x), axis(0).map(|x| up * x));
            [right, up, cross(right, up)]
        };
        let towards = |frame: &[[f64; 3]; 3]| {
            frame.iter().zip(GENERIC).map(|(axis, weight)| weight * dot(*axis, third)).sum::<f64>()
        };
        let frames = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(turned);
        let [first, rest @ ..] = frames;
        let best = rest.into_iter().fold(
            first,
            |best, next| {
                if towards(&next) > towards(&best) { next } else { best }
            },
        );
        // Σ screen axis · body axisᵀ
        let row = |i: usize| {
            (0..3).map(|j| (0..3).map(|a| SCREEN[a][i] * best[a][j]).sum::<f64>()).collect::<Vec<f64>>()
        };
        Some((0..3).map(row).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::layer::{depth, flatten};
    use crate::representation::Representation;

    fn landmarks(dimension: usize, points: usize) -> ShapeSpace {
        ShapeSpace::new(&Representation::Landmarks { dimension, points }).unwrap()
    }

    /// A shape turned by an angle in the plane of its first two axes.
    fn turned(shape: &[f64], angle: f64) -> Vec<f64> {
        let n = shape.len() / (if shape.len().is_multiple_of(3) { 3 } else { 2 });
        let mut turned = shape.to_vec();
        for k in 0..n {
            let (x, y) = (shape[k], shape[n + k]);
            turned[k] = x * angle.cos() - y * angle.sin();
            turned[n + k] = x * angle.sin() + y * angle.cos();
        }
        turned
    }

    fn assert_near(a: &[f64], b: &[f64]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9), "{a:?}\n{b:?}");
    }

    #[test]
    fn planar_shapes_stand_upright_however_they_were_turned() {
        let space = landmarks(2, 4);
        // a pear, thin end up, with one side heavier
        let pear = [-1.0, 1.2, 0.1, 0.0, 0.0, 0.1, 5.0, 0.3];
        let upright = Orientation::upright(&space, &pear).turn(&pear);
        let height = |shape: &[f64]| shape[4..].iter().fold(f64::MIN, |a, b| a.max(*b));
        assert!((height(&upright) - upright[6]).abs() < 1e-12 && upright[6] > 3.0, "{upright:?}");
        for angle in [0.3, 1.5, 3.0, 4.4, 6.0] {
            let shape = turned(&pear, angle);
            assert_near(&Orientation::upright(&space, &shape).turn(&shape), &upright);
        }
    }

    #[test]
    fn shapes_in_space_show_their_longest_axis_upwards() {
        let space = landmarks(3, 5);
        // long along z, then x, flat along y
        let points = [[0.0, 0.0, 0.0], [1.5, 0.0, 0.4], [-1.0, 0.1, 0.3], [0.2, 0.3, 2.0], [0.1, -0.2, 6.0]];
        let shape: Vec<f64> = (0..3).flat_map(|c| points.map(|p| p[c])).collect();
        let upright = Orientation::upright(&space, &shape).turn(&shape);
        let seen: Vec<[f64; 2]> =
            (0..5).map(|k| flatten(&[upright[k], upright[5 + k], upright[10 + k]])).collect();
        let deep: Vec<f64> = (0..5).map(|k| depth(&[upright[k], upright[5 + k], upright[10 + k]])).collect();
        let range = |values: Vec<f64>| {
            values.iter().fold(f64::MIN, |a, b| a.max(*b)) - values.iter().fold(f64::MAX, |a, b| a.min(*b))
        };
        let (wide, high) =
            (range(seen.iter().map(|p| p[0]).collect()), range(seen.iter().map(|p| p[1]).collect()));
        assert!(high > wide && wide > range(deep), "{seen:?}");
        for angle in [0.5, 2.0, 4.0] {
            let shape = turned(&shape, angle);
            assert_near(&Orientation::upright(&space, &shape).turn(&shape), &upright);
        }
    }

    #[test]
    fn shapes_without_direction_stay_as_they_are() {
        let square = [1.0, -1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0];
        assert_eq!(Orientation::upright(&landmarks(2, 4), &square).turn(&square), square);
        let one = [3.0; 8];
        assert_eq!(Orientation::upright(&landmarks(2, 4), &one).turn(&one), one);
        assert_eq!(Orientation::as_given().turn(&one), one);
    }
}
