//! Values of shapes at places: points, derivatives, frames.

use super::domain::Domain;
use crate::curve::{Curve, MAX_DERIVATIVE};
use crate::field_fault::FieldFault;
use crate::frame::Frame;
use crate::mesh::TriangleMesh;
use crate::representation::ShapeSpace;
use crate::subdivision::measures::{VertexFrame, frames};
use crate::surface::Surface;
use crate::surface::basis::SurfaceBasis;
use crate::surface::jet::{Jet, ORDERS, SurfaceFrame};
use shapelex_numeric::dense::Matrix;

/// Parameters at which shapes are evaluated.
#[derive(Debug, Clone, PartialEq)]
pub enum Parameters {
    /// This number of equally spaced `u`: at `i/count`, on open curves at `i/(count − 1)`.
    Equidistant(usize),
    /// The given `u`: modulo 1 on closed curves, within `[0, 1]` on open ones.
    At(Vec<f64>),
    /// A grid of equally spaced `u` and `v`: at `i/count` along closed directions, at `i/(count − 1)` along open ones.
    Grid([usize; 2]),
    /// The given pairs of `u` and `v`.
    Pairs(Vec<[f64; 2]>),
}

impl Parameters {
    /// Number of places.
    pub fn count(&self) -> usize {
        match self {
            Self::Equidistant(count) => *count,
            Self::At(list) => list.len(),
            Self::Grid([u, v]) => u.saturating_mul(*v),
            Self::Pairs(list) => list.len(),
        }
    }

    /// Values and derivatives up to `order` (at most [`MAX_DERIVATIVE`]) at such a place.
    pub fn derivatives(&self, order: usize) -> &'static [Derivative] {
        use Derivative::{First, Second, U, Uu, Uv, V, Value, Vv};
        let order = order.min(MAX_DERIVATIVE);
        match self {
            Self::Equidistant(_) | Self::At(_) => &[Value, First, Second][..=order],
            Self::Grid(_) | Self::Pairs(_) => &[Value, U, V, Uu, Uv, Vv][..[1, 3, 6][order]],
        }
    }

    /// Number of numbers at a place in `dimension` dimensions, with derivatives up to `order` and frames.
    pub fn numbers(&self, dimension: usize, order: usize, frames: bool) -> usize {
        let frame = match self {
            // Tangent, normal, curvature.
            Self::Equidistant(_) | Self::At(_) => 2 * dimension + 1,
            // Normal and two curvatures.
            Self::Grid(_) | Self::Pairs(_) => 5,
        };
        dimension * self.derivatives(order).len() + if frames { frame } else { 0 }
    }

    /// Given parameters that are outside of the domain, by index and direction.
    pub fn faults(&self, domain: Domain) -> Vec<FieldFault> {
        match self {
            Self::Equidistant(_) | Self::Grid(_) => Vec::new(),
            Self::At(list) => {
                let wrong = list.iter().enumerate().filter_map(|(i, u)| Some((i, domain.line_fault(*u)?)));
                wrong.map(|(i, detail)| FieldFault::new(i.to_string(), detail)).collect()
            }
            Self::Pairs(list) => domain.pair_faults(list),
        }
    }
}

/// A value or a derivative.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Derivative {
    /// The point itself.
    Value,
    /// `dr/du`.
    First,
    /// `d²r/du²`.
    Second,
    /// `∂σ/∂u`.
    U,
    /// `∂σ/∂v`.
    V,
    /// `∂²σ/∂u²`.
    Uu,
    /// `∂²σ/∂u∂v`.
    Uv,
    /// `∂²σ/∂v²`.
    Vv,
}

/// Values of one shape at some places.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Dimension of the points.
    pub dimension: usize,
    /// Number of places along `v`, if they form a grid; `v` varies fastest.
    pub columns: Option<usize>,
    /// Values and derivatives, coordinate-major, in the order of [`Parameters::derivatives`].
    pub derivatives: Vec<(Derivative, Vec<f64>)>,
    /// Directions and curvatures, if requested.
    pub frames: Option<Frames>,
}

/// Directions and curvatures at some places, as far as shapes have them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frames {
    /// Unit tangents of curves; `None` at places without direction.
    pub tangents: Option<Vec<Option<Vec<f64>>>>,
    /// Unit normals; `None` where there is none.
    pub normals: Vec<Option<Vec<f64>>>,
    /// Curvatures of curves in 1/length; `None` at places without direction.
    pub curvatures: Option<Vec<Option<f64>>>,
    /// Principal curvatures of surfaces in 1/length, the larger one first; `None` where they are undefined.
    pub principal_curvatures: Option<Vec<Option<[f64; 2]>>>,
}

impl Frames {
    fn from_curve(curve: &Curve, parameters: &[f64]) -> Self {
        let (mut tangents, mut normals, mut curvatures) = (Vec::new(), Vec::new(), Vec::new());
        for &u in parameters {
            let frame = Frame::at(curve, u);
            tangents.push(frame.tangent);
            normals.push(frame.normal);
            curvatures.push(frame.curvature);
        }
        let (tangents, curvatures) = (Some(tangents), Some(curvatures));
        Self { tangents, normals, curvatures, principal_curvatures: None }
    }

    fn from_surface(frames: impl Iterator<Item = SurfaceFrame>) -> Self {
        let of = |frame: SurfaceFrame| (frame.normal.map(Vec::from), frame.curvatures);
        let (normals, principal_curvatures) = frames.map(of).unzip();
        Self { normals, principal_curvatures: Some(principal_curvatures), ..Self::default() }
    }

    /// Frames at the vertices of a closed mesh; normals are its own, if it has some.
    fn from_mesh(mesh: &TriangleMesh) -> Self {
        let of = |frame: VertexFrame| (frame.normal.map(Vec::from), frame.curvatures);
        let (mut normals, principal_curvatures): (Vec<_>, _) = frames(mesh).into_iter().map(of).unzip();
        for (normal, own) in normals.iter_mut().zip(mesh.normals.iter().flatten()) {
            *normal = Some(own.to_vec());
        }
        Self { normals, principal_curvatures: Some(principal_curvatures), ..Self::default() }
    }
}

impl Evaluation {
    /// The vertices of a closed mesh.
    pub fn from_mesh(mesh: &TriangleMesh, frames: bool) -> Self {
        Self {
            dimension: 3,
            columns: None,
            derivatives: vec![(Derivative::Value, columns(&mesh.vertices, |vertex| *vertex))],
            frames: frames.then(|| Frames::from_mesh(mesh)),
        }
    }

    fn from_curve(curve: &Curve, parameters: &[f64], wanted: &[Derivative], frames: bool) -> Self {
        let values = |(order, name): (usize, &Derivative)| (*name, curve.evaluate_all(parameters, order));
        Self {
            dimension: curve.dimension(),
            columns: None,
            derivatives: wanted.iter().enumerate().map(values).collect(),
            frames: frames.then(|| Frames::from_curve(curve, parameters)),
        }
    }

    fn from_grid(surface: &Surface, [u, v]: &[Vec<f64>; 2], wanted: &[Derivative], frames: bool) -> Self {
        if wanted.len() > 1 || frames {
            let (jets, at) = (surface.jets(u, v), |i: usize| v[i % v.len()]);
            return Self { columns: Some(v.len()), ..Self::from_jets(surface, &jets, at, wanted, frames) };
        }
        let points = columns(&surface.points(u, v), |point| *point);
        Self {
            dimension: 3,
            columns: Some(v.len()),
            derivatives: vec![(Derivative::Value, points)],
            frames: None,
        }
    }

    fn from_jets(
        surface: &Surface,
        jets: &[Jet],
        v: impl Fn(usize) -> f64,
        wanted: &[Derivative],
        frames: bool,
    ) -> Self {
        debug_assert!(wanted.len() <= ORDERS.len());
        let values = |(order, name): (usize, &Derivative)| (*name, columns(jets, |jet| jet[order]));
        let frame = |(i, jet): (usize, &Jet)| surface.frame(v(i), jet);
        Self {
            dimension: 3,
            columns: None,
            derivatives: wanted.iter().enumerate().map(values).collect(),
            frames: frames.then(|| Frames::from_surface(jets.iter().enumerate().map(frame))),
        }
    }
}

/// Points as coordinate-major numbers.
pub(crate) fn columns<T>(items: &[T], point: impl Fn(&T) -> [f64; 3]) -> Vec<f64> {
    let point = &point;
    (0..3).flat_map(|c| items.iter().map(move |item| point(item)[c])).collect()
}

impl ShapeSpace {
    /// Values, derivatives up to `order` (at most [`MAX_DERIVATIVE`]) and frames of the shape with these control points;
    /// `None` if its places are not named by such parameters. Cost: the supports of the generators per place and derivative.
    pub fn evaluate(
        &self,
        control_points: &Matrix,
        parameters: &Parameters,
        order: usize,
        frames: bool,
    ) -> Option<Evaluation> {
        self.evaluate_shifted(control_points, parameters, [0.0; 2], order, frames)
    }

    /// As [`Self::evaluate`], at the parameters plus `shifts` along `u` and `v`; only closed directions have such.
    pub fn evaluate_shifted(
        &self,
        control_points: &Matrix,
        parameters: &Parameters,
        shifts: [f64; 2],
        order: usize,
        frames: bool,
    ) -> Option<Evaluation> {
        let wanted = parameters.derivatives(order);
        let curve = || Curve::of(self, control_points);
        let surface = || self.surface().map(|basis: &SurfaceBasis| basis.surface(control_points));
        let moved =
            |list: &[f64], shift: f64| list.iter().map(|parameter| parameter + shift).collect::<Vec<_>>();
        Some(match parameters {
            Parameters::Equidistant(count) => {
                let curve = curve()?;
                let list = moved(&curve.parameters(*count), shifts[0]);
                Evaluation::from_curve(&curve, &list, wanted, frames)
            }
            Parameters::At(list) => {
                Evaluation::from_curve(&curve()?, &moved(list, shifts[0]), wanted, frames)
            }
            Parameters::Grid(count) => {
                let surface = surface()?;
                let lists = [0, 1].map(|i| moved(&surface.parameters(i, count[i]), shifts[i]));
                Evaluation::from_grid(&surface, &lists, wanted, frames)
            }
            Parameters::Pairs(list) => {
                let surface = surface()?;
                let jets: Vec<Jet> =
                    list.iter().map(|[u, v]| surface.jet(u + shifts[0], v + shifts[1])).collect();
                Evaluation::from_jets(&surface, &jets, |i| list[i][1], wanted, frames)
            }
        })
    }
}
