//! Least-squares fits of spline curves to raw contours.
//!
//! ```text
//! min_c Σ_i w_i |r_c(u_i) − p_i|²,   Σ w_i = 1,   w_i ∝ half the distance of u_{i−1} and u_{i+1}
//! ```
//!
//! With these weights, the sum is the trapezoidal value of `∫ |r − p|² du`, whatever the density of the points. The normal
//! equations `(BᵀWB) c = BᵀWp` are banded; for closed curves, they become banded when the control points are taken
//! alternately from both ends. Points of a curve of the space, at their parameters, reproduce its control points.

use super::GeometryError;
use super::curve::Curve;
use super::generator::Generator;
use super::representation::{Representation, ShapeSpace};
use shapelex_numeric::banded::{Band, Banded};
use shapelex_numeric::bounded::{Stop, never};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::SymmetricOperator;

/// Ordered points with their parameters `u ∈ [0, 1)` (closed) or `[0, 1]` (open).
#[derive(Debug, Clone)]
pub struct Samples {
    points: Matrix,
    parameters: Vec<f64>,
    weights: Vec<f64>,
}

/// Relative squared influence on the points below which a control point is not determined by them.
const DETERMINED: f64 = 1e-9;

/// A fitted curve.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Representation of the curve.
    pub representation: Representation,
    /// Its control points.
    pub control_points: Matrix,
    /// `L₂` residual, `√(Σ w_i |r(u_i) − p_i|²)`.
    pub residual: f64,
    /// Largest residual, `max_i |r(u_i) − p_i|`.
    pub largest: f64,
}

impl Samples {
    /// Wraps points (`P × d`) and their strictly increasing parameters.
    ///
    /// # Errors
    /// [`GeometryError::Parameter`] for the first parameter that is out of range or not increasing.
    pub fn new(points: Matrix, parameters: Vec<f64>, closed: bool) -> Result<Self, GeometryError> {
        let count = parameters.len();
        let inside = |u: f64| u >= 0.0 && if closed { u < 1.0 } else { u <= 1.0 };
        for (index, &u) in parameters.iter().enumerate() {
            if !inside(u) || (index > 0 && u <= parameters[index - 1]) {
                return Err(GeometryError::Parameter { index, value: u });
            }
        }
        let before = |i: usize| match i {
            0 if closed => parameters[count - 1] - 1.0,
            0 => parameters[0],
            i => parameters[i - 1],
        };
        let after = |i: usize| match parameters.get(i + 1) {
            Some(&u) => u,
            None if closed => parameters[0] + 1.0,
            None => parameters[count - 1],
        };
        let spans: Vec<f64> = (0..count).map(|i| after(i) - before(i)).collect();
        let total: f64 = spans.iter().sum();
        let weights = spans.iter().map(|span| if total > 0.0 { span / total } else { 1.0 }).collect();
        Ok(Self { points, parameters, weights })
    }

    /// Points at the nodes of a rule with these weights, of sum 1.
    pub(crate) fn weighted(points: Matrix, parameters: Vec<f64>, weights: Vec<f64>) -> Self {
        Self { points, parameters, weights }
    }

    /// Fits a curve of `space`. Cost `O(P N² + M N²)`, where `N` is the support.
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] if there are fewer points than control points, [`GeometryError::Undetermined`] if they
    /// leave gaps in which the curve is not determined, [`GeometryError::NotACurve`] for landmarks.
    pub fn fit(&self, space: &ShapeSpace) -> Result<Fit, GeometryError> {
        let representation = space.representation();
        let generator = space.generator().ok_or(GeometryError::NotACurve)?;
        let (found, needed) = (self.parameters.len(), representation.size());
        if found < needed {
            return Err(GeometryError::TooFewPoints { found, needed });
        }
        let basis = Basis::new(generator, representation);
        let width = generator.support() - 1;
        let mut normal = Band::zeros(needed, if basis.closed { 2 * width } else { width });
        let mut right = Matrix::zeros(needed, self.points.ncols());
        for ((&u, &w), p) in self.parameters.iter().zip(&self.weights).zip(self.points.row_iter()) {
            let values = basis.at(u);
            for (position, &(i, a)) in values.iter().enumerate() {
                for c in 0..p.ncols() {
                    right[(i, c)] += w * a * p[c];
                }
                for &(j, b) in &values[position..] {
                    normal.add(i.min(j), i.max(j), w * a * b);
                }
            }
        }
        let undetermined = GeometryError::Undetermined { points: found, needed };
        let factored = Banded::new(normal).ok().filter(|normal| normal.independence() > DETERMINED);
        let normal = factored.ok_or(undetermined)?;
        normal.solve(right.as_mut_slice());
        let control_points = Matrix::from_fn(needed, right.ncols(), |k, c| right[(basis.position(k), c)]);
        let curve = Curve::of(space, &control_points).ok_or(GeometryError::NotACurve)?;
        let (residual, largest) = self.residuals(&curve);
        Ok(Fit { representation: representation.clone(), control_points, residual, largest })
    }

    /// The fit with the fewest control points (or intervals), up to `most`, and a residual of at most `tolerance`. The search
    /// is by doubling and bisection; fits of different sizes are not nested, so a smaller one may exist by chance.
    ///
    /// # Errors
    /// [`GeometryError::Tolerance`] with the best residual if no fit reaches the tolerance, [`GeometryError::Undetermined`] if
    /// the points leave gaps at every size; errors of the generator.
    pub fn fit_within(
        &self,
        representation: &Representation,
        tolerance: f64,
        most: usize,
    ) -> Result<Fit, GeometryError> {
        self.fit_within_until(representation, tolerance, most, &never)
    }

    /// As [`Self::fit_within`], with cancellation: once `stop` returns true, the best fit so far is returned.
    ///
    /// # Errors
    /// As for [`Self::fit_within`].
    pub fn fit_within_until(
        &self,
        representation: &Representation,
        tolerance: f64,
        most: usize,
        stop: Stop<'_>,
    ) -> Result<Fit, GeometryError> {
        let extra = representation.with_count(1).size() - 1;
        let (points, needed) = (self.parameters.len(), representation.fewest() + extra);
        if points < needed {
            return Err(GeometryError::TooFewPoints { found: points, needed });
        }
        let most = most.min(points - extra);
        let fit = |count: usize| self.fit(&ShapeSpace::new(&representation.with_count(count))?);
        let mut best: Option<Fit> = None;
        let (mut failed, mut count) = (representation.fewest().saturating_sub(1), representation.fewest());
        let mut found = loop {
            let Some(next) = (count <= most).then_some(count) else {
                let undetermined = GeometryError::Undetermined { points, needed };
                let Fit { residual, representation, .. } = best.ok_or(undetermined)?;
                let count = representation.count();
                return Err(GeometryError::Tolerance { tolerance, residual, count, most });
            };
            match fit(next) {
                Ok(fit) if fit.residual <= tolerance || stop() => break fit,
                Ok(fit) if best.as_ref().is_none_or(|best| fit.residual < best.residual) => best = Some(fit),
                Ok(_) | Err(GeometryError::Undetermined { .. }) => {}
                Err(error) => return Err(error),
            }
            failed = next;
            count = if next == most { most + 1 } else { (2 * next).min(most) };
        };
        while found.representation.count() > failed + 1 && !stop() {
            let middle = failed.midpoint(found.representation.count());
            match fit(middle) {
                Ok(fit) if fit.residual <= tolerance => found = fit,
                Ok(_) | Err(GeometryError::Undetermined { .. }) => failed = middle,
                Err(error) => return Err(error),
            }
        }
        Ok(found)
    }

    fn residuals(&self, curve: &Curve) -> (f64, f64) {
        let mut value = vec![0.0; curve.dimension()];
        let (mut sum, mut largest) = (0.0, 0.0_f64);
        for ((&u, &w), p) in self.parameters.iter().zip(&self.weights).zip(self.points.row_iter()) {
            curve.evaluate_into(u, 0, &mut value);
            let square: f64 = value.iter().zip(p.iter()).map(|(r, p)| (r - p).powi(2)).sum();
            sum += w * square;
            largest = largest.max(square);
        }
        (sum.sqrt(), largest.sqrt())
    }
}

/// The basis functions of a curve, with their rows in the normal equations.
struct Basis<'a> {
    generator: &'a Generator,
    closed: bool,
    intervals: usize,
    size: usize,
}

impl<'a> Basis<'a> {
    fn new(generator: &'a Generator, representation: &Representation) -> Self {
        let (intervals, size) = (representation.count(), representation.size());
        Self { generator, closed: representation.is_closed(), intervals, size }
    }

    /// Row of control point `k`: `k` itself if open; 0, 1, N−1, 2, N−2, … if closed, so that cyclic neighbours stay close.
    fn position(&self, k: usize) -> usize {
        match k {
            _ if !self.closed => k,
            0 => 0,
            k if 2 * k <= self.size => 2 * k - 1,
            k => 2 * (self.size - k),
        }
    }

    /// `(row, φ_k(u))` of every basis function that does not vanish at `u`; each row occurs once.
    fn at(&self, u: f64) -> Vec<(usize, f64)> {
        let t = u * self.intervals as f64;
        let reach = self.generator.support() as f64 / 2.0;
        let (first, last) = ((t - reach).ceil() as isize, (t + reach).floor() as isize);
        let lead = self.generator.beyond()[0] as isize;
        let mut values: Vec<(usize, f64)> = Vec::with_capacity(self.generator.support() + 1);
        for k in first..=last {
            let value = self.generator.evaluate(t - k as f64, 0);
            let row = if self.closed {
                k.rem_euclid(self.size as isize)
            } else if (0..self.size as isize).contains(&(k + lead)) {
                k + lead
            } else {
                continue;
            };
            let row = self.position(row as usize);
            match values.iter_mut().find(|(known, _)| *known == row) {
                Some((_, sum)) => *sum += value,
                None => values.push((row, value)),
            }
        }
        values
    }
}
