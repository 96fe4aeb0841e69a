//! Shapes that enclose a region of the plane or of space, and those that fill a box.

use std::f64::consts::TAU;
use std::sync::Arc;

use crate::field_fault::FieldFault;
use crate::knot_line::Line;
use crate::representation::{Representation, ShapeSpace};
use crate::subdivision::basis::SubdivisionBasis;
use crate::subdivision::{Scheme, Subdivision};
use crate::surface::Topology;
use crate::surface::basis::SurfaceBasis;
use shapelex_numeric::dense::Matrix;

/// Basis of the boundary of a region.
#[derive(Debug, Clone)]
pub enum Enclosure<'a> {
    /// A closed planar curve.
    Curve(&'a Line),
    /// A sphere, a torus, or a cylinder that is closed by lids.
    Surface(&'a Arc<SurfaceBasis>),
    /// A closed mesh with linear refinement.
    Mesh(&'a Subdivision),
}

/// Tube radius of a torus in a box, as a part of half of the smaller side across its axis.
const TUBE: f64 = 1.0 / 3.0;

impl ShapeSpace {
    /// The boundary of a region that the shapes of the space are.
    ///
    /// # Errors
    /// A fault of a field of the representation whose shapes enclose nothing, or whose points are not a linear function of the control
    /// points.
    pub fn enclosure(&self) -> Result<Enclosure<'_>, FieldFault> {
        let refuse = |field: &str, detail: &str| Err(FieldFault::new(field, detail));
        match self.representation() {
            Representation::ClosedCurve { dimension: 3, .. } => {
                refuse("dimension", "expected 2: a curve in space encloses nothing")
            }
            Representation::ClosedCurve { .. } => {
                let curve = self.line().map(Enclosure::Curve);
                curve.ok_or_else(|| FieldFault::new("kind", "expected a curve with a basis"))
            }
            Representation::Surface { topology: Topology::Plane, .. } => refuse(
                "topology",
                "expected sphere, torus or cylinder, got \"plane\", which encloses nothing",
            ),
            Representation::Surface { topology: Topology::SharpSphere, .. } => refuse(
                "topology",
                "expected sphere, torus or cylinder, got \"sharp_sphere\", whose poles may be anything",
            ),
            Representation::Surface { topology: Topology::Torus, seam, .. } if !seam.is_straight() => {
                refuse("seam", "expected \"straight\": a surface with another seam encloses nothing")
            }
            Representation::Surface { .. } => {
                let surface = self.shared_surface().map(Enclosure::Surface);
                surface.ok_or_else(|| FieldFault::new("kind", "expected a surface with a basis"))
            }
            Representation::Subdivision(Subdivision { scheme: Scheme::NormalBased { .. }, .. }) => {
                refuse("scheme", "expected a linear scheme, got \"normal_based\"")
            }
            Representation::Subdivision(subdivision) => match subdivision.connectivity.connectivity() {
                Ok(_) => Ok(Enclosure::Mesh(subdivision)),
                Err(fault) => refuse("connectivity", &format!("expected a closed mesh: {fault}")),
            },
            Representation::OpenCurve { .. } | Representation::Landmarks { .. } => {
                refuse("kind", "expected closed_curve, surface or subdivision: other shapes enclose nothing")
            }
        }
    }

    /// Control points of the largest ellipse, ellipsoid, cylinder or torus (with a tube of a third of its radius) in the box between
    /// two corners. The axis of cylinders and tori is z. The shape is interpolated at the knots.
    ///
    /// # Errors
    /// Those of [`Self::enclosure`]; a control mesh without positions.
    pub fn fill_box(&self, lower: &[f64], upper: &[f64]) -> Result<Matrix, FieldFault> {
        let centre = |c: usize| 0.5 * (lower[c] + upper[c]);
        let radius = |c: usize| 0.5 * (upper[c] - lower[c]);
        match self.enclosure()? {
            Enclosure::Curve(line) => {
                let turn = |k: usize| TAU * k as f64 / line.intervals() as f64;
                let unit = |k: usize, c: usize| if c == 0 { turn(k).cos() } else { turn(k).sin() };
                let points = Matrix::from_fn(line.intervals(), 2, |k, c| centre(c) + radius(c) * unit(k, c));
                Ok(line.interpolate(points))
            }
            Enclosure::Surface(basis) => {
                let tube = TUBE * radius(0).min(radius(1));
                let unit = |u: f64, v: f64| match basis.extent().topology {
                    Topology::Torus => {
                        let ((sine, cosine), across) = ((TAU * u).sin_cos(), tube * (TAU * v).cos() - tube);
                        let around = |c: usize| 1.0 + across / radius(c);
                        [around(0) * cosine, around(1) * sine, (TAU * v).sin()]
                    }
                    Topology::Cylinder => [(TAU * u).cos(), (TAU * u).sin(), 2.0 * v - 1.0],
                    Topology::Sphere | Topology::SharpSphere | Topology::Plane => {
                        let (sine, cosine) = (0.5 * TAU * v).sin_cos();
                        [sine * (TAU * u).cos(), sine * (TAU * u).sin(), cosine]
                    }
                };
                let at = |u: f64, v: f64| {
                    let unit = unit(u, v);
                    [0, 1, 2].map(|c| centre(c) + radius(c) * unit[c])
                };
                Ok(basis.interpolate_function(at))
            }
            Enclosure::Mesh(subdivision) => {
                let sphere = subdivision.connectivity.sphere().ok_or_else(|| {
                    let detail =
                        "expected a named mesh: a list of faces has no positions in a box, post a shape";
                    FieldFault::new("connectivity", detail)
                })?;
                let at = |k: usize, c: usize| centre(c) + radius(c) * sphere.vertices[k][c];
                let points = Matrix::from_fn(sphere.vertices.len(), 3, at);
                // A scheme that does not interpolate takes the positions as control points: the shape is then inside of the box.
                let fitted = self.subdivision().map(|basis: &SubdivisionBasis| basis.interpolate(&points));
                Ok(fitted.and_then(Result::ok).unwrap_or(points))
            }
        }
    }
}
