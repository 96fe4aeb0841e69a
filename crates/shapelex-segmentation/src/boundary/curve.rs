//! Planar closed curves.
//!
//! ```text
//! r(t) = Σ_k c_k φ(t − k),   t_s = s/S,   w = 1/S
//! ∬_Ω F = Σ w G(r) y',   area = Σ w x y',   length = Σ w |A r'|
//! ```

use shapelex_geometry::knot_line::Line;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

use super::{Boundary, Differential, Rule, Samples, relative_variance};
use crate::field::Integrated;
use crate::frame::Frame;

/// A closed curve sampled at the nodes of a rule.
#[derive(Debug, Clone)]
pub struct CurveBoundary {
    /// From control points to points and derivatives, and their transposes.
    maps: [SparseRows; 2],
    transposes: [SparseRows; 2],
    weights: Vec<f64>,
    sign: f64,
    frame: Frame<2>,
}

impl CurveBoundary {
    /// The curves of a closed line with `per_span` uniform samples per control point, oriented so that `rows` enclose a positive area.
    pub fn new(line: &Line, per_span: usize, rows: &[[f64; 2]], frame: Frame<2>) -> Self {
        Self::with_rule(line, Rule::sampled(line, per_span), rows, frame)
    }

    /// The same with the samples of a rule.
    pub fn with_rule(line: &Line, rule: Rule, rows: &[[f64; 2]], frame: Frame<2>) -> Self {
        let maps = line.taps(&rule.parameters);
        let transposes = [maps[0].transpose(), maps[1].transpose()];
        let mut boundary = Self { maps, transposes, weights: rule.weights, sign: 1.0, frame };
        if boundary.volume(&boundary.sample(rows)).value < 0.0 {
            boundary.sign = -1.0;
        }
        boundary
    }

    /// The weight of a sample in means.
    fn share(&self, sample: usize) -> f64 {
        self.weights[sample] / self.rows() as f64
    }

    fn gather(&self, value: f64, slopes: &Samples<2>) -> Differential<2> {
        let mut sum = Differential { value, gradient: self.transposes[0].apply(&slopes.points) };
        sum.add_gradient(1.0, &self.transposes[1].apply(&slopes.along_u));
        sum
    }

    /// `Σ_s k_s φ_i φ_j v_s v_sᵀ` for a factor and a vector of every sample, with the values or the derivatives of `φ`.
    fn squares(&self, derivative: usize, vectors: impl Iterator<Item = (f64, [f64; 2])>) -> Matrix {
        let size = 2 * self.rows();
        let mut sum = Matrix::zeros(size, size);
        for (taps, (factor, v)) in self.maps[derivative].iter().zip(vectors) {
            for (i, a) in taps {
                for (j, b) in taps {
                    let both = factor * a * b;
                    for (c, d) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                        sum[(2 * *i as usize + c, 2 * *j as usize + d)] += both * v[c] * v[d];
                    }
                }
            }
        }
        sum
    }

    /// `Σ w g y'` for the antiderivative `g` with its gradient.
    fn enclosed(&self, samples: &Samples<2>, at: impl Fn([f64; 2]) -> (f64, [f64; 2])) -> Differential<2> {
        let factor = self.sign * self.frame.determinant().abs();
        let mut slopes = samples.zeros();
        let mut value = 0.0;
        for (s, (point, tangent)) in samples.points.iter().zip(&samples.along_u).enumerate() {
            let (g, gradient) = at(*point);
            let weight = factor * self.weights[s];
            let rise = weight * tangent[1];
            value += g * rise;
            slopes.points[s] = gradient.map(|slope| slope * rise);
            slopes.along_u[s] = [0.0, weight * g];
        }
        self.gather(value, &slopes)
    }
}

impl Boundary<2> for CurveBoundary {
    fn rows(&self) -> usize {
        self.maps[0].columns()
    }

    fn sample(&self, rows: &[[f64; 2]]) -> Samples<2> {
        let [points, along_u] = [0, 1].map(|derivative| self.maps[derivative].apply(rows));
        Samples { points, along_u, ..Samples::default() }
    }

    fn integral(&self, samples: &Samples<2>, field: &Integrated<2>) -> Differential<2> {
        self.enclosed(samples, |point| field.at(point))
    }

    fn volume(&self, samples: &Samples<2>) -> Differential<2> {
        self.enclosed(samples, |[x, _]| (x, [1.0, 0.0]))
    }

    fn measure(&self, samples: &Samples<2>) -> Differential<2> {
        let mut slopes = samples.zeros();
        let mut value = 0.0;
        for ((slope, tangent), weight) in slopes.along_u.iter_mut().zip(&samples.along_u).zip(&self.weights) {
            let [x, y] = self.frame.turn(*tangent);
            let length = x.hypot(y);
            value += weight * length;
            if length > 0.0 {
                *slope = self.frame.turn_back([x, y].map(|x| weight * x / length));
            }
        }
        self.gather(value, &slopes)
    }

    fn mean(
        &self,
        samples: &Samples<2>,
        function: &dyn Fn(usize, [f64; 2]) -> (f64, [f64; 2]),
    ) -> Differential<2> {
        let mut slopes = samples.zeros();
        let mut sum = 0.0;
        for (s, point) in samples.points.iter().enumerate() {
            let (share, (value, of_point)) = (self.share(s), function(s, *point));
            sum += share * value;
            slopes.points[s] = of_point.map(|x| share * x);
        }
        self.gather(sum, &slopes)
    }

    fn curvature(&self, samples: &Samples<2>, field: &Integrated<2>, factor: f64) -> Option<Matrix> {
        let area = self.frame.determinant().abs();
        let rise = |((point, tangent), weight): ((&[f64; 2], &[f64; 2]), &f64)| {
            let speed = tangent[0].hypot(tangent[1]).max(f64::MIN_POSITIVE);
            let n = [self.sign * tangent[1] / speed, -self.sign * tangent[0] / speed];
            // `F`, the slope of its antiderivative along x, half a cell to either side.
            let at = |step: f64| field.at([point[0] + step * n[0], point[1] + step * n[1]]).1[0];
            ((factor * (at(0.5) - at(-0.5))).max(0.0) * weight * area * speed, n)
        };
        Some(self.squares(0, samples.points.iter().zip(&samples.along_u).zip(&self.weights).map(rise)))
    }

    fn spacing_curvature(&self, samples: &Samples<2>) -> Option<Matrix> {
        let turned: Vec<[f64; 2]> = samples.along_u.iter().map(|tangent| self.frame.turn(*tangent)).collect();
        let mean: f64 = turned.iter().enumerate().map(|(s, [x, y])| self.share(s) * (x * x + y * y)).sum();
        let factor = 8.0 / (mean * mean).max(f64::MIN_POSITIVE);
        let slopes = turned.iter().enumerate();
        Some(self.squares(1, slopes.map(|(s, v)| (factor * self.share(s), self.frame.turn_back(*v)))))
    }

    /// `mean(q²)/mean(q)² − 1`, `q = |A r'|²`.
    fn spacing(&self, samples: &Samples<2>) -> Differential<2> {
        let tangents: Vec<[f64; 2]> =
            samples.along_u.iter().map(|tangent| self.frame.turn(*tangent)).collect();
        let squares: Vec<f64> = tangents.iter().map(|[x, y]| x * x + y * y).collect();
        let (value, of_squares) = relative_variance(&squares, |s| self.share(s));
        let mut slopes = samples.zeros();
        for ((slope, tangent), factor) in slopes.along_u.iter_mut().zip(&tangents).zip(of_squares) {
            *slope = self.frame.turn_back(tangent.map(|x| 2.0 * factor * x));
        }
        self.gather(value, &slopes)
    }
}
