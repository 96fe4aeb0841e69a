//! Spheres and tori of splines.
//!
//! # Tied spheres
//! The tangents at the poles follow from the neighbouring rings, which keeps ellipsoids exact under any affine map:
//!
//! ```text
//! T_1N = a Σ_k cos(2πk/M_u) c[k, 1],   T_2N = a Σ_k sin(2πk/M_u) c[k, 1],   a = 2π/(M_u ρ)
//! T_1S = −a Σ_k cos(2πk/M_u) c[k, M_v − 1],   likewise T_2S
//! ```
//!
//! `ρ` is the radius of the ring next to a pole of the unit sphere; `sin(π/M_v)` for interpolating generators.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use shapelex_geometry::GeometryError;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::SurfaceBasis;
use shapelex_geometry::surface::sphere::{POLAR_ROWS, handle_length};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

use super::{Model, OUTLINE_SPACING, Outline, SPACING, per_span};
use crate::boundary::tensor::{TensorBoundary, lengths};
use crate::boundary::{Boundary, Rule};
use crate::frame::Frame;

/// Minimum number of samples per span along `u` and Gauss nodes per span along `v`: the volume is then accurate to a millionth.
const LEAST: usize = 4;

/// Spheres or tori of one size.
#[derive(Debug, Clone)]
pub struct SurfaceSnake {
    basis: Arc<SurfaceBasis>,
    /// From free points to the rows of the basis; `None` if they are the same.
    lift: Option<SparseRows>,
    /// From free points to the control net.
    net: SparseRows,
    /// Number of free points in the centre: handles are not.
    central: usize,
}

impl SurfaceSnake {
    /// The surfaces of a sphere, or of a torus with a straight seam; the free points are the rows of the basis.
    ///
    /// # Errors
    /// [`GeometryError::Surface`] for other topologies.
    pub fn new(basis: Arc<SurfaceBasis>) -> Result<Self, GeometryError> {
        let refuse = |field, detail: &str| Err(GeometryError::Surface { field, detail: detail.into() });
        let size = basis.gram().size();
        let central = match basis.extent().topology {
            Topology::Sphere => size - POLAR_ROWS + 2,
            Topology::Torus if basis.seam().is_straight() => size,
            Topology::Torus => return refuse("seam", "expected a torus with a straight seam"),
            _ => return refuse("topology", "expected a sphere or a torus"),
        };
        let net = basis.control_net();
        Ok(Self { basis, lift: None, net, central })
    }

    /// Spheres with tied tangents; the free points are those between the poles, the north and the south pole.
    ///
    /// # Errors
    /// [`GeometryError::Surface`] for other topologies.
    pub fn tied_sphere(basis: Arc<SurfaceBasis>) -> Result<Self, GeometryError> {
        if basis.extent().topology != Topology::Sphere {
            let detail = "expected a sphere".into();
            return Err(GeometryError::Surface { field: "topology", detail });
        }
        let lift = tie(&basis);
        let net = basis.control_net().multiply(&lift);
        Ok(Self { basis, central: lift.columns(), lift: Some(lift), net })
    }

    fn lengths(&self, rows: &[[f64; 3]]) -> [f64; 2] {
        lengths(self.basis.lines(), &self.net, rows)
    }
}

/// The map from the points and poles of a sphere to its rows, by the rule of tied tangents.
fn tie(basis: &SurfaceBasis) -> SparseRows {
    let [around, last] = basis.extent().intervals;
    let free = around * (last - 1);
    let sphere = basis.interpolate_function(|u, v| {
        let ((sine, cosine), (height, radius)) = ((TAU * u).sin_cos(), ((PI * v).cos(), (PI * v).sin()));
        [radius * cosine, radius * sine, height]
    });
    // The first point of the first ring lies at longitude 0.
    let factor = handle_length(last) * TAU / (around as f64 * sphere[(0, 0)]);
    let mut lift = SparseRows::new(free + 2, free + POLAR_ROWS, 2 * free);
    (0..free + 2).for_each(|row| lift.push(&[(row as u32, 1.0)]));
    for (pole, ring, sign) in [(free, 0, 1.0), (free + 1, last - 2, -1.0)] {
        for phase in [0.0, 0.25] {
            let wave = |k: usize| (TAU * (k as f64 / around as f64 - phase)).cos();
            let tangent = (0..around).map(|k| ((k * (last - 1) + ring) as u32, sign * factor * wave(k)));
            lift.push(&tangent.chain([(pole as u32, 1.0)]).collect::<Vec<_>>());
        }
    }
    lift
}

impl Model<3> for SurfaceSnake {
    fn rows(&self) -> usize {
        self.net.columns()
    }

    fn boundary(&self, rows: &[[f64; 3]], sigma: f64, frame: Frame<3>) -> Box<dyn Boundary<3>> {
        let (lines, lengths) = (self.basis.lines(), self.lengths(rows));
        let spacing = SPACING * sigma.max(1.0);
        let samples = [0, 1].map(|i| per_span(lengths[i], lines[i].intervals(), spacing, LEAST));
        Box::new(TensorBoundary::new(lines, self.net.clone(), samples, rows, frame))
    }

    fn exact(&self, rows: &[[f64; 3]], frame: Frame<3>) -> Box<dyn Boundary<3>> {
        let lines = self.basis.lines();
        let rules = [0, 1].map(|i| Rule::exact(&lines[i]));
        Box::new(TensorBoundary::with_rules(lines, self.net.clone(), rules, rows, frame))
    }

    fn outline(&self, rows: &[[f64; 3]]) -> Outline {
        let (lines, lengths) = (self.basis.lines(), self.lengths(rows));
        let counts = [0, 1].map(|i| {
            let intervals = lines[i].intervals();
            intervals * per_span(lengths[i], intervals, OUTLINE_SPACING, LEAST)
        });
        let rows = self.control_points(rows);
        let rows = Matrix::from_fn(rows.len(), 3, |i, c| rows[i][c]);
        Outline::Mesh(self.basis.surface(&rows).tessellate(counts))
    }

    fn centre(&self) -> Vec<f64> {
        let share = 1.0 / self.central as f64;
        (0..self.rows()).map(|row| if row < self.central { share } else { 0.0 }).collect()
    }

    fn lift(&self) -> Option<SparseRows> {
        self.lift.clone()
    }
}
