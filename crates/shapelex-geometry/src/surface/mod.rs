//! Tensor-product surfaces: two lines of knots, and how the sheet between them closes.
//!
//! ```text
//! σ(u, v) = Σ_{k,l} c[k, l] φ_u(M_u u − k) φ_v(M_v v − l),   (u, v) ∈ [0, 1]²,   c[k, l] ∈ R³
//! ```
//!
//! * [`basis`] — the space of such surfaces: its Gram operator, interpolation, and the control points of a shape;
//! * [`sphere`] — the conditions at two poles;
//! * [`seam`] — tori that are glued with a twist;
//! * [`jet`] — values, derivatives, normals and curvatures;
//! * [`measures`] — volume, area, centroid, flux;
//! * [`fit`] — least-squares fits of points with parameters;
//! * [`parameterisation`] — parameters on a mesh;
//! * [`tessellation`] — triangles on a surface;
//! * [`ideal`] — idealised surfaces, and the generators that contain them.
//!
//! Source: Schmitter, *Spline Shape Processing*, 2.2, 6.2.4, 6.3.4 and 7, with the misprints corrected.

pub mod basis;
pub mod fit;
pub mod ideal;
pub mod jet;
pub mod measures;
pub mod parameterisation;
pub mod seam;
pub mod sphere;
pub mod tessellation;

use std::ops::Range;

use super::generator::GeneratorKind;
use super::line::Line;
use super::open::phantoms;
use super::vector::{far_origin, minus};
use seam::Seam;

/// How a surface closes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Topology {
    /// Closed along `u`; the edges `v = 0` and `v = 1` are the poles.
    Sphere,
    /// Closed along `u`, open along `v`.
    Cylinder,
    /// Closed along both.
    Torus,
    /// Open along both.
    Plane,
}

impl Topology {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Sphere, Self::Cylinder, Self::Torus, Self::Plane];

    /// The name that stands in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::Cylinder => "cylinder",
            Self::Torus => "torus",
            Self::Plane => "plane",
        }
    }

    /// Whether `u` and `v` are closed.
    pub fn closed(self) -> [bool; 2] {
        match self {
            Self::Sphere | Self::Cylinder => [true, false],
            Self::Torus => [true, true],
            Self::Plane => [false, false],
        }
    }

    /// The generators that are taken unless others are asked for: circles where it closes, from pole to pole half of one.
    pub fn usual_generators(self) -> [GeneratorKind; 2] {
        let round = [self.closed()[0], self.closed()[1] || self == Self::Sphere];
        round.map(|round| if round { GeneratorKind::Trigonometric {} } else { GeneratorKind::Keys {} })
    }

    /// The sign of `σ_u × σ_v` in the outward normal: that of the usual parameterisation, longitude and colatitude on the
    /// sphere, longitude and height on the cylinder.
    pub fn orientation(self) -> f64 {
        if self == Self::Sphere { -1.0 } else { 1.0 }
    }
}

/// A surface: all control points that matter on `[0, 1]²`, with those beyond its edges.
#[derive(Debug, Clone)]
pub struct Surface {
    topology: Topology,
    seam: Seam,
    lines: [Line; 2],
    /// Rows along `u` and `v`, from `−K` on.
    size: [usize; 2],
    /// `[k][l]`.
    control_points: Vec<[f64; 3]>,
}

impl Surface {
    /// How it closes.
    pub fn topology(&self) -> Topology {
        self.topology
    }

    /// Whether it has two sides.
    pub fn is_orientable(&self) -> bool {
        self.seam != Seam::Reflected
    }

    /// Whether it encloses a volume: spheres, tori, and cylinders with lids.
    pub fn encloses(&self) -> bool {
        self.topology != Topology::Plane && self.is_orientable()
    }

    /// Its directions.
    pub fn lines(&self) -> &[Line; 2] {
        &self.lines
    }

    /// Intervals of a direction within `[0, 1]`.
    pub fn intervals(&self, direction: usize) -> usize {
        self.size[direction] - 1 - 2 * phantoms(self.lines[direction].generator().support())
    }

    /// A power of two near the largest coordinate, 1 when all are 0.
    fn power_of_two(&self) -> f64 {
        let largest = self.control_points.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs()));
        if largest > f64::MIN_POSITIVE && largest.is_finite() { largest.log2().floor().exp2() } else { 1.0 }
    }

    /// A point near a surface that is far from the origin for its extent, when moving its control points moves it.
    pub fn far_origin(&self) -> Option<[f64; 3]> {
        far_origin(self.control_points.iter())
            .filter(|_| self.lines.iter().all(Line::reproduces_constants) && self.seam.is_straight())
    }

    /// The same surface moved by `−origin`.
    pub fn about(&self, origin: [f64; 3]) -> Self {
        let control_points = self.control_points.iter().map(|point| minus(*point, origin)).collect();
        Self { control_points, ..self.clone() }
    }

    /// The same surface times `factor`.
    fn scaled(&self, factor: f64) -> Self {
        let control_points =
            self.control_points.iter().map(|point| point.map(|value| value * factor)).collect();
        Self { control_points, ..self.clone() }
    }

    /// `Σ_k w_k c[k, l]` for the `columns` `l`, with `k` from `first` on.
    fn combine_rows(&self, first: usize, weights: &[f64], columns: Range<usize>) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; columns.len()];
        for (i, weight) in weights.iter().enumerate() {
            let start = (first + i) * self.size[1];
            let row = &self.control_points[start + columns.start..start + columns.end];
            for (sum, point) in sums.iter_mut().zip(row) {
                (0..3).for_each(|c| sum[c] += weight * point[c]);
            }
        }
        sums
    }
}

/// `Σ_l w_l row[l]`.
fn combine(row: &[[f64; 3]], weights: &[f64]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (point, weight) in row.iter().zip(weights) {
        (0..3).for_each(|c| sum[c] += weight * point[c]);
    }
    sum
}
