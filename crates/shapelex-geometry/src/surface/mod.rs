//! Tensor-product surfaces: two lines of knots, and a topology that says how the sheet between them closes.
//!
//! ```text
//! σ(u, v) = Σ_{k,l} c[k, l] φ_u(M_u u − k) φ_v(M_v v − l),   (u, v) ∈ [0, 1]²,   c[k, l] ∈ R³
//! ```
//!
//! * [`basis`] — the space of such surfaces: Gram operator, interpolation, and control points of a shape;
//! * [`sphere`] — the conditions at two smooth poles, `sharp` — at two sharp ones;
//! * [`seam`] — tori glued with a twist;
//! * [`jet`] — values, derivatives, normals and curvatures;
//! * [`measures`] — volume, area, centroid, flux;
//! * [`field`] — vector fields for the flux;
//! * [`fit`] — least-squares fits of points with parameters;
//! * [`motion`] — motions of the parameters;
//! * [`parameterisation`] — parameters on a mesh;
//! * [`refinement`] — the same surface on finer knots;
//! * [`tessellation`] — triangle meshes of surfaces;
//! * [`ideal`] — idealised surfaces, and generators that contain them.
//!
//! Source: Schmitter, *Spline Shape Processing*, 2.2, 6.2.4, 6.3.4 and 7, with the misprints corrected.

pub mod basis;
pub mod field;
pub mod fit;
pub mod ideal;
pub mod jet;
pub mod measures;
pub mod motion;
pub mod parameterisation;
pub mod refinement;
pub mod seam;
mod sharp;
pub mod sphere;
pub mod tessellation;

use std::ops::Range;

use super::generator::GeneratorKind;
use super::knot_line::Line;
use super::vector::{far_origin, minus};
use seam::Seam;

/// Topology of a surface. `sphere`: closed along `u`, with a pole at each end of `v`, smooth there; `sharp_sphere`: the same with
/// points, creases and folds that may end in the poles. `cylinder`: closed along `u`. `torus`:
/// closed along `u` and `v`. `plane`: open along both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Topology {
    /// Closed along `u`; the edges `v = 0` and `v = 1` shrink to the poles.
    Sphere,
    /// As `sphere`, with a separate tangent for each meridian at the poles.
    SharpSphere,
    /// Closed along `u`, open along `v`.
    Cylinder,
    /// Closed along `u` and `v`.
    Torus,
    /// Open along `u` and `v`.
    Plane,
}

impl Topology {
    /// All topologies.
    pub const ALL: [Self; 5] = [Self::Sphere, Self::SharpSphere, Self::Cylinder, Self::Torus, Self::Plane];

    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::SharpSphere => "sharp_sphere",
            Self::Cylinder => "cylinder",
            Self::Torus => "torus",
            Self::Plane => "plane",
        }
    }

    /// Whether `u` and `v` are closed.
    pub fn closed(self) -> [bool; 2] {
        match self {
            Self::Sphere | Self::SharpSphere | Self::Cylinder => [true, false],
            Self::Torus => [true, true],
            Self::Plane => [false, false],
        }
    }

    /// Whether the edges `v = 0` and `v = 1` are poles.
    pub fn has_poles(self) -> bool {
        matches!(self, Self::Sphere | Self::SharpSphere)
    }

    /// Default generators: circles along closed directions, half of one from pole to pole.
    pub fn usual_generators(self) -> [GeneratorKind; 2] {
        let round = [self.closed()[0], self.closed()[1] || self.has_poles()];
        round.map(|round| if round { GeneratorKind::Trigonometric {} } else { GeneratorKind::Cubic {} })
    }

    /// The sign of `σ_u × σ_v` in the outward normal, for the usual parameterisation: longitude and colatitude on the sphere,
    /// longitude and height on the cylinder.
    pub fn orientation(self) -> f64 {
        if self.has_poles() { -1.0 } else { 1.0 }
    }
}

/// A surface with all control points that have an influence on `[0, 1]²`, including those beyond its edges.
#[derive(Debug, Clone)]
pub struct Surface {
    topology: Topology,
    seam: Seam,
    lines: [Line; 2],
    /// Number of rows along `u` and `v`, counted from `−K`.
    size: [usize; 2],
    /// Control points, `[k][l]`.
    control_points: Vec<[f64; 3]>,
}

impl Surface {
    /// Topology of the surface.
    pub fn topology(&self) -> Topology {
        self.topology
    }

    /// Whether the surface has two sides.
    pub fn is_orientable(&self) -> bool {
        self.seam != Seam::Reflected
    }

    /// Whether the surface encloses a volume: spheres, tori, and cylinders with lids.
    pub fn encloses(&self) -> bool {
        self.topology != Topology::Plane && self.is_orientable()
    }

    /// The lines along `u` and `v`.
    pub fn lines(&self) -> &[Line; 2] {
        &self.lines
    }

    /// Number of intervals along a direction within `[0, 1]`.
    pub fn intervals(&self, direction: usize) -> usize {
        let [before, after] = self.lines[direction].generator().beyond();
        self.size[direction] - 1 - before - after
    }

    /// A power of two near the largest coordinate; 1 if all coordinates are 0.
    fn power_of_two(&self) -> f64 {
        let largest = self.control_points.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs()));
        if largest > f64::MIN_POSITIVE && largest.is_finite() { largest.log2().floor().exp2() } else { 1.0 }
    }

    /// A point near the surface if it is far from the origin relative to its extent, and moving its control points moves it.
    pub fn far_origin(&self) -> Option<[f64; 3]> {
        far_origin(self.control_points.iter())
            .filter(|_| self.lines.iter().all(Line::reproduces_constants) && self.seam.is_straight())
    }

    /// The same surface moved by `−origin`.
    pub fn about(&self, origin: [f64; 3]) -> Self {
        let control_points = self.control_points.iter().map(|point| minus(*point, origin)).collect();
        Self { control_points, ..self.clone() }
    }

    /// The same surface scaled by `factor`.
    fn scaled(&self, factor: f64) -> Self {
        let control_points =
            self.control_points.iter().map(|point| point.map(|value| value * factor)).collect();
        Self { control_points, ..self.clone() }
    }

    /// `Σ_k w_k c[k, l]` for all `l` in `columns`, with `k` from `first` on.
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
