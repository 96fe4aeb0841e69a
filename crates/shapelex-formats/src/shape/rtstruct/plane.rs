//! The planes of the contours of a region.

use serde_json::{Value, json};

use super::regions::Contour;
use crate::shape::record::Points;

/// Largest distance from a plane, in mm, of the points of a contour in it. Files have two or more digits after the point; the
/// thinnest slices of scanners of bones are 0.08 mm apart.
pub(super) const FLAT_MM: f64 = 0.01;

/// Orthonormal, right-handed directions: two in a plane, and its normal.
///
/// ```text
/// x = a u + b v + c n
/// ```
///
/// `u` is nearest to the first axis of a pair of patient axes, which depends on the largest component of the normal: (x, y) where
/// it is z, (x, z) where it is y, (y, z) where it is x. In planes along the axes, `a` and `b` are coordinates of the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Basis {
    pub(super) u: [f64; 3],
    pub(super) v: [f64; 3],
    pub(super) normal: [f64; 3],
}

impl Basis {
    /// The common basis of planar contours. `None` if all of them are straight or shorter than three points.
    ///
    /// The normal is that of the sum of the vector areas, `Σ ½ Σ pᵢ × pᵢ₊₁`, each with the sign that points to the same side: for
    /// contours of one direction noise averages out. It is an axis of the patient if all contours are flat along that axis.
    pub(super) fn of(contours: &[&Contour]) -> Option<Self> {
        let mut sum = [0.0; 3];
        for contour in contours {
            let area = vector_area(&contour.points);
            let sign = if dot(area, sum) < 0.0 { -1.0 } else { 1.0 };
            sum = std::array::from_fn(|k| sum[k] + sign * area[k]);
        }
        let normal = unit(sum)?;
        let axis = (0..3).rev().max_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs()))?;
        let along = Self::along(axis);
        if contours.iter().all(|contour| along.deviation(&contour.points) <= FLAT_MM) {
            return Some(along);
        }
        let sign = if dot(normal, along.normal) < 0.0 { -1.0 } else { 1.0 };
        let normal = normal.map(|x| sign * x);
        let part = dot(along.u, normal);
        let u = unit(std::array::from_fn(|k| along.u[k] - part * normal[k]))?;
        Some(Self { u, v: cross(normal, u), normal })
    }

    /// The basis of planes across an axis.
    fn along(axis: usize) -> Self {
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        match axis {
            0 => Self { u: y, v: z, normal: x },
            1 => Self { u: x, v: z, normal: [0.0, -1.0, 0.0] },
            _ => Self { u: x, v: y, normal: z },
        }
    }

    /// Distance of the first point from the plane through the origin.
    pub(super) fn offset(&self, points: &Points) -> f64 {
        points.rows().next().map_or(0.0, |row| self.height(row))
    }

    /// Largest distance of a point from the parallel plane through the first one.
    pub(super) fn deviation(&self, points: &Points) -> f64 {
        let offset = self.offset(points);
        points.rows().map(|row| (self.height(row) - offset).abs()).fold(0.0, f64::max)
    }

    /// Coordinates in the plane.
    pub(super) fn project(&self, points: &Points) -> Points {
        let mut plane = Points::new(2);
        for row in points.rows() {
            plane.push(&[self.u, self.v].map(|axis| dot(axis, [row[0], row[1], row[2]]) + 0.0));
        }
        plane
    }

    /// The plane of a contour as it is said of a record.
    pub(super) fn describe(&self, points: &Points) -> Value {
        json!({ "u": self.u, "v": self.v, "normal": self.normal, "offset": self.offset(points) + 0.0 })
    }

    /// A slice in words: `z = 12.500 mm` where its normal is an axis of the patient.
    pub(super) fn slice(&self, offset: f64) -> String {
        let [x, y, z] = self.normal;
        match (0..3).find(|k| self.normal[*k].abs() == 1.0) {
            Some(k) => format!("{} = {:.3} mm", ["x", "y", "z"][k], offset * self.normal[k] + 0.0),
            None => format!("{offset:.3} mm along ({x:.3}, {y:.3}, {z:.3})"),
        }
    }

    fn height(&self, row: &[f64]) -> f64 {
        dot(self.normal, [row[0], row[1], row[2]])
    }
}

/// `½ Σ (pᵢ − p₀) × (pᵢ₊₁ − p₀)`: exactly along an axis if all points have one coordinate along it.
fn vector_area(points: &Points) -> [f64; 3] {
    let Some(first) = points.rows().next() else { return [0.0; 3] };
    let from_first = |row: &[f64]| [0, 1, 2].map(|k| row[k] - first[k]);
    let mut area = [0.0; 3];
    for (a, b) in points.rows().zip(points.rows().skip(1)) {
        let product = cross(from_first(a), from_first(b));
        area = std::array::from_fn(|k| area[k] + 0.5 * product[k]);
    }
    area
}

/// `None` of the zero vector, and beyond the range of numbers.
fn unit(x: [f64; 3]) -> Option<[f64; 3]> {
    let largest = x.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let x = x.map(|x| x / largest);
    let length = dot(x, x).sqrt();
    Some(x.map(|x| x / length))
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::super::regions::ContourKind;
    use super::*;
    use crate::shape::Place;

    fn contour(coordinates: &[f64]) -> Contour {
        let points = Points::from_rows(3, coordinates.to_vec());
        Contour { kind: ContourKind::ClosedPlanar, points, number: 1, image: None, place: Place::default() }
    }

    #[test]
    fn planes_along_the_axes_keep_the_coordinates_of_the_file() {
        let rows = [[0.1, 0.2, 7.3], [2.0, 0.2, 7.3], [2.0, 1.7, 7.3]];
        for (axis, kept) in [(2, [0, 1]), (1, [0, 2]), (0, [1, 2])] {
            // The third coordinate of `rows` becomes the one along `axis`.
            let order: [usize; 3] =
                std::array::from_fn(|k| if k == axis { 2 } else { usize::from(k == kept[1]) });
            let flat: Vec<f64> = rows.iter().flat_map(|row| order.map(|k| row[k])).collect();
            let contour = contour(&flat);
            let basis = Basis::of(&[&contour]).expect("a plane");
            assert_eq!(basis, Basis::along(axis));
            let expected: Vec<f64> = rows.iter().flat_map(|row| [row[0], row[1]]).collect();
            assert_eq!(basis.project(&contour.points).coordinates(), expected);
            assert!((basis.offset(&contour.points).abs() - 7.3).abs() < 1e-15);
        }
    }

    #[test]
    fn an_oblique_plane_is_a_rotation_of_its_points() {
        let contour = contour(&[0.0, 0.0, 1.0, 4.0, 0.0, 2.0, 4.0, 3.0, 2.5, 0.0, 3.0, 1.5]);
        let basis = Basis::of(&[&contour]).expect("a plane");
        assert!(basis.deviation(&contour.points) < 1e-14);
        assert!((dot(cross(basis.u, basis.v), basis.normal) - 1.0).abs() < 1e-14);
        let plane = basis.project(&contour.points);
        for (row, plane) in contour.points.rows().zip(plane.rows()) {
            for k in 0..3 {
                let x = basis.u[k] * plane[0]
                    + basis.v[k] * plane[1]
                    + basis.normal[k] * basis.offset(&contour.points);
                assert!((x - row[k]).abs() < 1e-14, "{x} {}", row[k]);
            }
        }
    }

    #[test]
    fn a_straight_contour_has_no_plane() {
        assert_eq!(Basis::of(&[&contour(&[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0])]), None);
        assert_eq!(Basis::of(&[]), None);
    }
}
