//! Tensor-product surfaces: uniform samples along `u`, Gauss–Legendre nodes in every span along `v`.
//!
//! ```text
//! σ(u, v) = Σ_{k,l} c[k, l] φ_u(u − k) φ_v(v − l),   c = E p
//! ∭_Ω F = Σ w G(σ) n_x,   n_x = y_u z_v − y_v z_u
//! ```
//!
//! The bases are smooth within the spans only, so no rule goes across them. The two directions are applied one after the other,
//! which costs 8 products per sample instead of 16.

use rayon::prelude::*;

use shapelex_geometry::knot_line::Line;
use shapelex_geometry::vector::{cross, dot, norm};
use shapelex_numeric::sparse::SparseRows;

use super::{Boundary, Differential, Rule, Samples, relative_variance};
use crate::field::Integrated;
use crate::frame::Frame;

/// Minimum number of samples in a parallel task: some 30 µs of look-ups.
const TASK: usize = 256;

/// The linear map from free points to the samples of a tensor product.
#[derive(Debug, Clone)]
pub(super) struct Sheet {
    /// `E`, from free points to the control net, and its transpose.
    net: [SparseRows; 2],
    /// Values and derivatives along `u` and along `v`, and their transposes.
    maps: [[SparseRows; 2]; 2],
    transposes: [[SparseRows; 2]; 2],
    /// Weights along `u` and along `v`; their sums are the numbers of spans.
    weights: [Vec<f64>; 2],
}

impl Sheet {
    /// `net`: map from free points to control points `[k][l]`. `rules`: samples along `u` and `v`.
    pub(super) fn new(lines: &[Line; 2], net: SparseRows, rules: [Rule; 2]) -> Self {
        let maps = [0, 1].map(|i| lines[i].taps(&rules[i].parameters));
        let transposes = maps.each_ref().map(|pair| pair.each_ref().map(SparseRows::transpose));
        Self {
            net: [net.clone(), net.transpose()],
            maps,
            transposes,
            weights: rules.map(|rule| rule.weights),
        }
    }

    pub(super) fn rows(&self) -> usize {
        self.net[0].columns()
    }

    /// Number of samples along `v`.
    fn columns(&self) -> usize {
        self.weights[1].len()
    }

    /// The weight of a sample.
    fn weight(&self, sample: usize) -> f64 {
        self.weights[0][sample / self.columns()] * self.weights[1][sample % self.columns()]
    }

    /// Points and derivatives along `u` and `v`, `[u][v]`.
    pub(super) fn sample(&self, rows: &[[f64; 3]]) -> Samples<3> {
        let net = self.net[0].apply(rows);
        let length = self.maps[1][0].columns();
        let along = |derivative: usize| -> Vec<[f64; 3]> {
            net.chunks_exact(length).flat_map(|line| self.maps[1][derivative].apply(line)).collect()
        };
        let [values, slopes] = [along(0), along(1)];
        let around =
            |derivative: usize, lines: &[[f64; 3]]| across(&self.maps[0][derivative], lines, self.columns());
        Samples {
            points: around(0, &values),
            along_u: around(1, &values),
            along_v: around(0, &slopes),
            vertices: Vec::new(),
        }
    }

    /// The transpose of [`Self::sample`].
    pub(super) fn gather(&self, value: f64, slopes: &Samples<3>) -> Differential<3> {
        let columns = self.columns();
        let [values, derivatives] = &self.transposes[0];
        let mut lines = across(values, &slopes.points, columns);
        for (sum, part) in lines.iter_mut().zip(across(derivatives, &slopes.along_u, columns)) {
            (0..3).for_each(|c| sum[c] += part[c]);
        }
        let turned = across(values, &slopes.along_v, columns);
        let [values, derivatives] = &self.transposes[1];
        let lines = lines.chunks_exact(columns).zip(turned.chunks_exact(columns));
        let net: Vec<[f64; 3]> = lines
            .flat_map(|(line, turned)| {
                let mut sum = Differential { value: 0.0, gradient: values.apply(line) };
                sum.add_gradient(1.0, &derivatives.apply(turned));
                sum.gradient
            })
            .collect();
        Differential { value, gradient: self.net[1].apply(&net) }
    }

    /// The area in the frame.
    pub(super) fn area(&self, samples: &Samples<3>, frame: &Frame<3>) -> Differential<3> {
        let mut slopes = samples.zeros();
        let mut area = 0.0;
        for s in 0..samples.points.len() {
            let [u, v] = [samples.along_u[s], samples.along_v[s]].map(|tangent| frame.turn(tangent));
            let normal = cross(u, v);
            let length = norm(normal);
            let weight = self.weight(s);
            area += weight * length;
            if length > 0.0 {
                let unit = normal.map(|x| weight * x / length);
                slopes.along_u[s] = frame.turn_back(cross(v, unit));
                slopes.along_v[s] = frame.turn_back(cross(unit, u));
            }
        }
        self.gather(area, &slopes)
    }

    /// Mean over the samples of a function of their positions, given with its slope.
    fn mean(
        &self,
        samples: &Samples<3>,
        function: &dyn Fn(usize, [f64; 3]) -> (f64, [f64; 3]),
    ) -> Differential<3> {
        let total: f64 = (0..samples.points.len()).map(|s| self.weight(s)).sum();
        let mut slopes = samples.zeros();
        let mut sum = 0.0;
        for (s, point) in samples.points.iter().enumerate() {
            let (share, (value, slope)) = (self.weight(s) / total, function(s, *point));
            sum += share * value;
            slopes.points[s] = slope.map(|x| share * x);
        }
        self.gather(sum, &slopes)
    }

    /// Mean over the sampled parallels of the relative variance of `|σ_u|²`, plus mean over the meridians of that of `|σ_v|²`.
    pub(super) fn unevenness(&self, samples: &Samples<3>, frame: &Frame<3>) -> Differential<3> {
        let columns = self.columns();
        let count = samples.points.len() / columns;
        let totals = self.weights.each_ref().map(|weights| weights.iter().sum::<f64>());
        let [us, vs] = [&samples.along_u, &samples.along_v]
            .map(|list| list.iter().map(|tangent| frame.turn(*tangent)).collect::<Vec<_>>());
        let mut slopes = samples.zeros();
        let mut value = 0.0;
        for j in 0..columns {
            let squares: Vec<f64> =
                (0..count).map(|i| dot(us[i * columns + j], us[i * columns + j])).collect();
            let (variance, factors) = relative_variance(&squares, |i| self.weights[0][i] / totals[0]);
            let share = 1.0 / columns as f64;
            value += share * variance;
            for (i, factor) in factors.into_iter().enumerate() {
                let s = i * columns + j;
                slopes.along_u[s] = frame.turn_back(us[s].map(|x| 2.0 * share * factor * x));
            }
        }
        for i in 0..count {
            let line = i * columns..(i + 1) * columns;
            let squares: Vec<f64> = vs[line.clone()].iter().map(|tangent| dot(*tangent, *tangent)).collect();
            let (variance, factors) = relative_variance(&squares, |j| self.weights[1][j] / totals[1]);
            let share = 1.0 / count as f64;
            value += share * variance;
            for (s, factor) in line.zip(factors) {
                slopes.along_v[s] = frame.turn_back(vs[s].map(|x| 2.0 * share * factor * x));
            }
        }
        self.gather(value, &slopes)
    }

    /// Largest lengths, in cells, of a parallel and of a meridian.
    pub(super) fn lengths(&self, samples: &Samples<3>) -> [f64; 2] {
        let columns = self.columns();
        let (mut parallels, mut meridians) = (vec![0.0; columns], vec![0.0; samples.points.len() / columns]);
        for s in 0..samples.points.len() {
            let (i, j) = (s / columns, s % columns);
            parallels[j] += self.weights[0][i] * norm(samples.along_u[s]);
            meridians[i] += self.weights[1][j] * norm(samples.along_v[s]);
        }
        [parallels, meridians].map(|lengths| lengths.into_iter().fold(0.0, f64::max))
    }
}

/// A sparse map along the slow index of `[k][j]`, with `columns` numbers `j`.
fn across(map: &SparseRows, lines: &[[f64; 3]], columns: usize) -> Vec<[f64; 3]> {
    let mut product = vec![[0.0; 3]; map.rows() * columns];
    for (out, row) in product.chunks_exact_mut(columns).zip(map.iter()) {
        for &(k, weight) in row {
            let line = &lines[k as usize * columns..(k as usize + 1) * columns];
            for (out, value) in out.iter_mut().zip(line) {
                (0..3).for_each(|c| out[c] += weight * value[c]);
            }
        }
    }
    product
}

/// A closed tensor-product surface: a sphere or a torus.
#[derive(Debug, Clone)]
pub struct TensorBoundary {
    sheet: Sheet,
    sign: f64,
    frame: Frame<3>,
}

impl TensorBoundary {
    /// The surfaces of two lines, with `samples` per span along `u` and `v`, oriented so that `rows` enclose a positive volume.
    /// `net`: map from free points to control points `[k][l]`.
    pub fn new(
        lines: &[Line; 2],
        net: SparseRows,
        samples: [usize; 2],
        rows: &[[f64; 3]],
        frame: Frame<3>,
    ) -> Self {
        Self::with_rules(lines, net, [0, 1].map(|i| Rule::sampled(&lines[i], samples[i])), rows, frame)
    }

    /// The same with the samples of rules.
    pub fn with_rules(
        lines: &[Line; 2],
        net: SparseRows,
        rules: [Rule; 2],
        rows: &[[f64; 3]],
        frame: Frame<3>,
    ) -> Self {
        let mut boundary = Self { sheet: Sheet::new(lines, net, rules), sign: 1.0, frame };
        if boundary.volume(&boundary.sample(rows)).value < 0.0 {
            boundary.sign = -1.0;
        }
        boundary
    }

    /// `Σ w g n_x` for the antiderivative `g` with its gradient.
    fn enclosed(
        &self,
        samples: &Samples<3>,
        at: impl Fn([f64; 3]) -> (f64, [f64; 3]) + Sync,
    ) -> Differential<3> {
        let factor = self.sign * self.frame.determinant().abs();
        let one = |s: usize| {
            let (g, gradient) = at(samples.points[s]);
            let ([_, yu, zu], [_, yv, zv]) = (samples.along_u[s], samples.along_v[s]);
            let weight = factor * self.sheet.weight(s);
            let (normal, weighted) = (weight * (yu * zv - yv * zu), weight * g);
            let of_u = [0.0, weighted * zv, -weighted * yv];
            let of_v = [0.0, -weighted * zu, weighted * yu];
            (g * normal, gradient.map(|slope| slope * normal), of_u, of_v)
        };
        let parts: Vec<_> = (0..samples.points.len()).into_par_iter().with_min_len(TASK).map(one).collect();
        let mut slopes = samples.zeros();
        let mut value = 0.0;
        for (s, (part, of_point, of_u, of_v)) in parts.into_iter().enumerate() {
            value += part;
            (slopes.points[s], slopes.along_u[s], slopes.along_v[s]) = (of_point, of_u, of_v);
        }
        self.sheet.gather(value, &slopes)
    }
}

impl Boundary<3> for TensorBoundary {
    fn rows(&self) -> usize {
        self.sheet.rows()
    }

    fn sample(&self, rows: &[[f64; 3]]) -> Samples<3> {
        self.sheet.sample(rows)
    }

    fn integral(&self, samples: &Samples<3>, field: &Integrated<3>) -> Differential<3> {
        self.enclosed(samples, |point| field.at(point))
    }

    fn volume(&self, samples: &Samples<3>) -> Differential<3> {
        self.enclosed(samples, |[x, _, _]| (x, [1.0, 0.0, 0.0]))
    }

    fn measure(&self, samples: &Samples<3>) -> Differential<3> {
        self.sheet.area(samples, &self.frame)
    }

    fn mean(
        &self,
        samples: &Samples<3>,
        function: &dyn Fn(usize, [f64; 3]) -> (f64, [f64; 3]),
    ) -> Differential<3> {
        self.sheet.mean(samples, function)
    }

    fn spacing(&self, samples: &Samples<3>) -> Differential<3> {
        self.sheet.unevenness(samples, &self.frame)
    }
}

/// Largest lengths, in cells, of a parallel and of a meridian of a shape.
pub fn lengths(lines: &[Line; 2], net: &SparseRows, rows: &[[f64; 3]]) -> [f64; 2] {
    // Four samples per span give lengths to a few per cent.
    let sheet = Sheet::new(lines, net.clone(), [0, 1].map(|i| Rule::sampled(&lines[i], 4)));
    sheet.lengths(&sheet.sample(rows))
}
