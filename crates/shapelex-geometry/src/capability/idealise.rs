//! Control points of idealised shapes, where a space contains them.

use crate::ideal::{IdealCurve, Position};
use crate::representation::{Representation, ShapeSpace};
use crate::surface::Topology;
use crate::surface::basis::SurfaceBasis;
use crate::surface::ideal::IdealSurface;
use crate::surface::seam::Seam;
use crate::vector::{minus, norm};
use shapelex_numeric::dense::Matrix;

/// An idealised shape with its position.
#[derive(Debug, Clone, Copy)]
pub enum Placed {
    /// A curve.
    Curve(PlacedCurve),
    /// A surface.
    Surface(PlacedSurface),
}

/// An idealised curve with its position.
#[derive(Debug, Clone, Copy)]
pub struct PlacedCurve {
    /// The curve.
    pub curve: IdealCurve,
    /// Position of the curve.
    pub position: Position,
}

/// An idealised surface with its position.
#[derive(Debug, Clone, Copy)]
pub struct PlacedSurface {
    /// The surface.
    pub surface: IdealSurface,
    /// Position of its centre.
    pub centre: [f64; 3],
    /// Angle in radians of a rotation about the z axis, applied before the translation.
    pub angle: f64,
}

impl PlacedSurface {
    fn at(&self, u: f64, v: f64) -> [f64; 3] {
        let ([x, y, z], (sine, cosine)) = (self.surface.at(u, v), self.angle.sin_cos());
        let turned = [cosine * x - sine * y, sine * x + cosine * y, z];
        [0, 1, 2].map(|c| self.centre[c] + turned[c])
    }
}

/// Why a space has no control points of an idealised shape.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IdealFault {
    /// A parameter of the shape is invalid.
    #[error("{0}")]
    Parameters(&'static str),
    /// The shape is of another kind than those of the space.
    #[error("expected a shape of the kind of the representation")]
    OtherKind,
    /// A closed curve was asked to represent an open one.
    #[error("the curve does not close: use an open_curve")]
    Open,
    /// The generator lacks poles, each with the required multiplicity.
    #[error("the generator does not reproduce this curve: {}", missing_poles(.0))]
    Missing(Vec<([f64; 2], usize)>),
    /// The surface has another topology or seam.
    #[error(
        "expected a surface with the topology and seam of the representation, got a {} with the seam \"{}\"",
        topology.name(),
        seam.name()
    )]
    Topology {
        /// Topology of the surface.
        topology: Topology,
        /// Its seam.
        seam: Seam,
    },
    /// The generators do not contain the surface.
    #[error("the generators do not reproduce this surface (the nearest is {worst:.1e} away)")]
    NotContained {
        /// Largest distance of the nearest surface.
        worst: f64,
    },
}

fn missing_poles(missing: &[([f64; 2], usize)]) -> String {
    let name = |(pole, times): &([f64; 2], usize)| match (*pole, *times) {
        ([0.0, 0.0], 1) => "0".to_owned(),
        ([0.0, 0.0], times) => format!("0 ({times} times)"),
        ([0.0, im], _) => format!("±{im}i"),
        ([re, _], _) => format!("±{re}"),
    };
    let list: Vec<String> = missing.iter().map(name).collect();
    format!("expected {} among its domain_poles", list.join(", "))
}

/// Maximum relative distance at which an idealised surface counts as contained in the space.
const CONTAINED: f64 = 1e-9;

impl ShapeSpace {
    /// Exact control points of an idealised shape.
    ///
    /// # Errors
    /// Parameters or a topology that do not fit, generators that do not reproduce the shape.
    pub fn idealise(&self, placed: &Placed) -> Result<Matrix, IdealFault> {
        match (placed, self.surface()) {
            (Placed::Curve(placed), None) if self.line().is_some() => self.idealise_curve(placed),
            (Placed::Surface(placed), Some(basis)) => idealise_surface(basis, placed),
            _ => Err(IdealFault::OtherKind),
        }
    }

    fn idealise_curve(&self, PlacedCurve { curve, position }: &PlacedCurve) -> Result<Matrix, IdealFault> {
        if let Some(detail) = curve.fault() {
            return Err(IdealFault::Parameters(detail));
        }
        if self.representation().is_closed() && !curve.is_closed() {
            return Err(IdealFault::Open);
        }
        let missing = curve.missing(position, self);
        if !missing.is_empty() {
            return Err(IdealFault::Missing(missing));
        }
        Ok(curve.control_points(position, self))
    }
}

fn idealise_surface(basis: &SurfaceBasis, placed: &PlacedSurface) -> Result<Matrix, IdealFault> {
    let surface = &placed.surface;
    if let Some(fault) = surface.fault() {
        return Err(IdealFault::Parameters(fault));
    }
    let (topology, seam) = surface.topology();
    let found = basis.extent().topology;
    // A sphere with smooth poles is also one with sharp ones.
    let fits = topology == found || (topology, found) == (Topology::Sphere, Topology::SharpSphere);
    if !fits || seam != basis.seam() {
        return Err(IdealFault::Topology { topology, seam });
    }
    let rows = basis.interpolate_function(|u, v| placed.at(u, v));
    let made = basis.surface(&rows);
    let count = basis.extent().intervals.map(|count| 2 * count + 1);
    let [u, v] = count.map(|count| (0..count).map(|i| (i as f64 + 0.5) / count as f64).collect::<Vec<_>>());
    let points = made.points(&u, &v);
    let wanted = u.iter().flat_map(|&u| v.iter().map(move |&v| placed.at(u, v)));
    let worst = points.iter().zip(wanted).map(|(a, b)| norm(minus(*a, b))).fold(0.0, f64::max);
    let extent = points.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs()));
    if worst <= CONTAINED * extent { Ok(rows) } else { Err(IdealFault::NotContained { worst }) }
}

impl IdealSurface {
    /// Smallest representation that contains the surface.
    pub fn representation(&self) -> Representation {
        let (topology, seam) = self.topology();
        let (control_points, generators) = (self.fewest_intervals(), self.generators());
        Representation::Surface { topology, seam, control_points, generators }
    }
}
