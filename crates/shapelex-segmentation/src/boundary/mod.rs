//! Boundaries as samples that depend linearly on free points, and integrals over the enclosed part.
//!
//! ```text
//! samples = B p,   E = e(samples),   ∂E/∂p = Bᵀ ∂e
//! ```
//!
//! Every gradient is the exact gradient of the discrete sum. The orientation of the first shape is kept as a sign, so that it
//! encloses a positive area or volume: shapes with inward normals need no reversal.
//!
//! * [`curve`] — planar closed curves; [`tensor`] — spheres and tori;
//! * [`mesh`] — triangle meshes; [`cylinder`] — cylinders with caps.

pub mod curve;
pub mod cylinder;
pub mod mesh;
pub mod tensor;

use shapelex_geometry::knot_line::Line;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::quadrature::GaussLegendre;

use crate::field::Integrated;

/// Gauss nodes in each half of a span where areas and volumes are exact but for rounding: for products of three splines up to degree 3, and
/// to 1e-13 for trigonometric and exponential ones. Knots of generators lie at halves of spans.
const EXACT: usize = 6;

/// A quadrature rule along a line: parameters, and weights with the number of spans as their sum.
#[derive(Debug, Clone)]
pub struct Rule {
    parameters: Vec<f64>,
    weights: Vec<f64>,
}

impl Rule {
    /// So many nodes a span: uniform along closed lines, for which that is best where functions are smooth, Gauss–Legendre nodes along open
    /// ones.
    pub fn sampled(line: &Line, per_span: usize) -> Self {
        if !line.is_closed() {
            return Self::gauss(line.intervals(), 1.0, per_span);
        }
        let count = line.intervals() * per_span;
        let parameters = (0..count).map(|s| s as f64 / per_span as f64).collect();
        Self { parameters, weights: vec![1.0 / per_span as f64; count] }
    }

    /// The rule by which areas and volumes are exact.
    pub fn exact(line: &Line) -> Self {
        Self::gauss(2 * line.intervals(), 0.5, EXACT)
    }

    fn gauss(pieces: usize, length: f64, nodes: usize) -> Self {
        let rule = GaussLegendre::new(nodes);
        let of_piece = |piece: usize| {
            rule.points().map(move |(x, w)| (length * (piece as f64 + 0.5 + 0.5 * x), 0.5 * length * w))
        };
        let (parameters, weights) = (0..pieces).flat_map(of_piece).unzip();
        Self { parameters, weights }
    }
}

/// A value with its gradient with respect to the free points.
#[derive(Debug, Clone, PartialEq)]
pub struct Differential<const D: usize> {
    /// The value.
    pub value: f64,
    /// One row per free point.
    pub gradient: Vec<[f64; D]>,
}

impl<const D: usize> Differential<D> {
    /// Zero, for `rows` free points.
    pub fn zero(rows: usize) -> Self {
        Self { value: 0.0, gradient: vec![[0.0; D]; rows] }
    }

    /// The same, `factor` times.
    pub fn times(mut self, factor: f64) -> Self {
        self.value *= factor;
        self.gradient.iter_mut().flatten().for_each(|slope| *slope *= factor);
        self
    }

    /// Adds the gradient of another value, `factor` times.
    pub fn add_gradient(&mut self, factor: f64, gradient: &[[f64; D]]) {
        for (sum, slopes) in self.gradient.iter_mut().zip(gradient) {
            (0..D).for_each(|c| sum[c] += factor * slopes[c]);
        }
    }
}

/// Points of a boundary with the derivatives of its parameterisation, or the slopes of a value in them. Lists that a kind of
/// boundary does not have are empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Samples<const D: usize> {
    /// Points of the quadrature rule.
    pub points: Vec<[f64; D]>,
    /// Derivatives along `u` there.
    pub along_u: Vec<[f64; D]>,
    /// Derivatives along `v` there; empty for curves.
    pub along_v: Vec<[f64; D]>,
    /// Vertices of a mesh.
    pub vertices: Vec<[f64; D]>,
}

impl<const D: usize> Samples<D> {
    /// Zeros in lists of the same lengths.
    fn zeros(&self) -> Self {
        let zeros = |list: &Vec<[f64; D]>| vec![[0.0; D]; list.len()];
        Self {
            points: zeros(&self.points),
            along_u: zeros(&self.along_u),
            along_v: zeros(&self.along_v),
            vertices: zeros(&self.vertices),
        }
    }
}

/// A boundary with fixed sampling, as a function of its free points in index coordinates.
pub trait Boundary<const D: usize>: std::fmt::Debug + Send + Sync {
    /// Number of free points.
    fn rows(&self) -> usize;

    /// The samples of a shape.
    fn sample(&self, rows: &[[f64; D]]) -> Samples<D>;

    /// `|det A| ∫_Ω F`, by the antiderivative of `F`.
    fn integral(&self, samples: &Samples<D>, field: &Integrated<D>) -> Differential<D>;

    /// The enclosed area or volume in units of length.
    fn volume(&self, samples: &Samples<D>) -> Differential<D>;

    /// The length of the curve or the area of the surface, without caps, in units of length.
    fn measure(&self, samples: &Samples<D>) -> Differential<D>;

    /// How unevenly the parameters are spread over the boundary: 0 if evenly. Scale invariant.
    fn spacing(&self, samples: &Samples<D>) -> Differential<D>;

    /// Mean over the samples of a function of their numbers and positions in index coordinates, given with its slope in them. Weights are those of the
    /// parameters, and do not depend on the shape.
    fn mean(
        &self,
        samples: &Samples<D>,
        function: &dyn Fn(usize, [f64; D]) -> (f64, [f64; D]),
    ) -> Differential<D>;

    /// `∮ max(factor ∂F/∂n, 0) φ_k φ_l n nᵀ ds` by rows `(k, c)`, the second derivatives of `factor ∫_Ω F` where they are
    /// positive. `None` for boundaries that do not offer it.
    fn curvature(&self, samples: &Samples<D>, field: &Integrated<D>, factor: f64) -> Option<Matrix> {
        let _ = (samples, field, factor);
        None
    }

    /// Second derivatives of [`Self::spacing`] by Gauss and Newton. `None` for boundaries that do not offer it.
    fn spacing_curvature(&self, samples: &Samples<D>) -> Option<Matrix> {
        let _ = samples;
        None
    }
}

/// Relative variance of positive numbers with weights that sum to one, `Σ w q²/(Σ w q)² − 1`, and its slope in every number.
fn relative_variance(numbers: &[f64], weights: impl Fn(usize) -> f64) -> (f64, Vec<f64>) {
    let moment =
        |power: i32| -> f64 { numbers.iter().enumerate().map(|(i, q)| weights(i) * q.powi(power)).sum() };
    let (mean, square) = (moment(1), moment(2));
    let slope = |(i, q): (usize, &f64)| weights(i) * 2.0 * (q - square / mean) / (mean * mean);
    (square / (mean * mean) - 1.0, numbers.iter().enumerate().map(slope).collect())
}
