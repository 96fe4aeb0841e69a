//! One direction of a shape: the integer shifts of a generator along a closed or open line of knots.
//!
//! ```text
//! closed   r(u) = Σ_{k<M} c[k] φ_per(M u − k),   φ_per(t) = Σ_n φ(t − nM)
//! open     r(u) = Σ_{k=−K}^{M+K} c[k] φ(M u − k),   K = ⌈support/2⌉ − 1
//! ```

use std::sync::Arc;

use super::GeometryError;
use super::generator::{Generator, GeneratorKind, Poles, evaluate_taylor};
use super::open::{OpenInterpolation, covering, open_gram};
use shapelex_numeric::NumericError;
use shapelex_numeric::banded::Banded;
use shapelex_numeric::circulant::Circulant;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::SymmetricOperator;
use shapelex_numeric::sparse::SparseRows;

/// Why closed directions have no shifted generators.
pub const SHIFTED_CLOSED: &str = "expected an open direction for \"shifted_exponential\", got a closed one, which begins anywhere: use \"exponential\"";

/// A prepared line of `M` intervals: generator, Gram operator and interpolation at the knots.
#[derive(Debug, Clone)]
pub struct Line {
    intervals: usize,
    closed: bool,
    generator: Arc<Generator>,
    poles: Poles,
    gram: Arc<dyn SymmetricOperator>,
    interpolation: Interpolation,
}

/// Conversion of points at the knots to control points.
#[derive(Debug, Clone)]
enum Interpolation {
    /// The control points are the points.
    Equal,
    /// The samples are a circulant operator applied to the control points.
    Circulant(Circulant),
    /// Interpolation on an open line.
    Open(Arc<OpenInterpolation>),
}

impl Line {
    /// Prepares a line. Cost: one generator (cached), and two FFTs of length `M` (closed) or a banded factorisation
    /// (open).
    ///
    /// # Errors
    /// Errors of the generator; [`GeometryError::Dependent`] if the shifts are dependent.
    pub fn new(kind: &GeneratorKind, intervals: usize, closed: bool) -> Result<Self, GeometryError> {
        Self::over(kind, intervals, intervals, closed)
    }

    /// An open line of `intervals` from pole to pole, half of a great circle. If the poles of the generator depend on the
    /// number of intervals, they are those for the whole circle.
    ///
    /// Its interpolation is done by the surface: conditions at the poles replace those beyond the ends.
    pub(super) fn meridian(kind: &GeneratorKind, intervals: usize) -> Result<Self, GeometryError> {
        let built = kind.build(kind.meridian_count(intervals))?;
        let gram = Banded::new(open_gram(&built.generator, intervals, 0)).map_err(dependent)?;
        Ok(Self {
            intervals,
            closed: false,
            generator: built.generator.clone(),
            poles: built.poles.clone(),
            gram: Arc::new(gram),
            interpolation: Interpolation::Equal,
        })
    }

    /// A closed line of `2 · intervals` with the generator for `intervals`, for functions of `u` with a period of two turns. Its
    /// Gram operator is that of the average over both turns.
    pub(super) fn twice_round(kind: &GeneratorKind, intervals: usize) -> Result<Self, GeometryError> {
        Self::over(kind, intervals, 2 * intervals, true)
    }

    fn over(
        kind: &GeneratorKind,
        intervals_of_the_poles: usize,
        intervals: usize,
        closed: bool,
    ) -> Result<Self, GeometryError> {
        let built = kind.build(intervals_of_the_poles)?;
        if closed && kind.is_shifted() {
            return Err(GeometryError::Surface { field: "generator", detail: SHIFTED_CLOSED.into() });
        }
        let (generator, interpolating) = (built.generator.clone(), kind.properties().interpolating);
        let (gram, interpolation): (Arc<dyn SymmetricOperator>, _) = if closed {
            let interpolation = if interpolating {
                Interpolation::Equal
            } else {
                let samples = Circulant::new(&sampling_row(&generator, intervals));
                Interpolation::Circulant(samples.map_err(dependent)?)
            };
            let gram = Circulant::new(&gram_row(&generator, intervals, 0, 0)).map_err(dependent)?;
            (Arc::new(gram), interpolation)
        } else {
            let open = OpenInterpolation::new(&generator, &built.poles, intervals, interpolating);
            let gram = Banded::new(open_gram(&generator, intervals, 0)).map_err(dependent)?;
            (Arc::new(gram), Interpolation::Open(Arc::new(open.map_err(dependent)?)))
        };
        Ok(Self { intervals, closed, generator, poles: built.poles.clone(), gram, interpolation })
    }

    /// Number of intervals, `M`.
    pub fn intervals(&self) -> usize {
        self.intervals
    }

    /// Whether the line is closed.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// The generator.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }

    /// Whether the generator is shifted by half a knot, so that control points lie between the knots.
    pub fn is_shifted(&self) -> bool {
        self.generator.is_shifted()
    }

    /// Poles of the functions that the generator reproduces, on the grid of the knots.
    pub fn poles(&self) -> &Poles {
        &self.poles
    }

    /// Whether constants are reproduced, so that moving all control points moves the line.
    pub fn reproduces_constants(&self) -> bool {
        self.poles.zeros > 0
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Number of control points before the start, `K`, and beyond the end of an open line; 0 if closed.
    pub fn beyond(&self) -> [usize; 2] {
        if self.closed { [0; 2] } else { self.generator.beyond() }
    }

    /// Number of control points.
    pub fn count(&self) -> usize {
        let [before, after] = self.beyond();
        self.intervals + if self.closed { 0 } else { 1 + before + after }
    }

    /// Maps from control points to values and to first derivatives at parameters `t = M u` in units of the knots. Open lines have
    /// `M + 1 + 2K` control points, from the first one beyond the end on. Where a derivative jumps, it is the one to the right.
    pub fn taps(&self, parameters: &[f64]) -> [SparseRows; 2] {
        let (support, [beyond, _], count) = (self.generator.support(), self.beyond(), self.count());
        let reach = 0.5 * support as f64;
        [0, 1].map(|derivative| {
            let mut map = SparseRows::new(count, parameters.len(), parameters.len() * support);
            for t in parameters {
                let near = (t - reach).ceil() as isize..=(t + reach).floor() as isize;
                let entries = near.filter_map(|k| {
                    let column = if self.closed { k.rem_euclid(count as isize) } else { k + beyond as isize };
                    let weight = self.generator.evaluate(t - k as f64, derivative);
                    let inside = (0..count as isize).contains(&column);
                    (inside && weight != 0.0).then_some((column as u32, weight))
                });
                map.push(&entries.collect::<Vec<_>>());
            }
            map
        })
    }

    /// Half-interval of a parameter, and the local coordinate in it: see [`locate`].
    pub fn locate(&self, u: f64) -> (usize, f64) {
        locate(u, self.intervals, self.closed)
    }

    /// The control points with an influence on a half-interval: the index of the first, counted from the first phantom (`−K`),
    /// and the `derivative` with respect to `u` of their basis functions at `s ∈ [−1, 1]`.
    pub fn weights(&self, half: usize, s: f64, derivative: usize) -> (usize, impl Iterator<Item = f64> + '_) {
        let beyond = self.generator.beyond()[0] as isize;
        let scale = (self.intervals as f64).powi(derivative as i32);
        let mut pieces = covering(&self.generator, half).peekable();
        let first = pieces.peek().map_or(0, |(k, _)| (k + beyond) as usize);
        let weight = move |(_, p)| scale * evaluate_taylor(self.generator.piece(p), s, derivative);
        (first, pieces.map(weight))
    }

    /// Control points of the line that interpolates `points` (`M × d`, or `(M + 1) × d` if open) at the knots `u = k/M`.
    ///
    /// These are the points themselves for interpolating generators, otherwise the solution of a circulant system. Open lines
    /// are extended by annihilation beyond their ends.
    pub fn interpolate(&self, mut points: Matrix) -> Matrix {
        match &self.interpolation {
            Interpolation::Equal => points,
            Interpolation::Circulant(sampling) => {
                sampling.solve(points.as_mut_slice());
                points
            }
            Interpolation::Open(open) => open.interpolate(&points),
        }
    }
}

/// Half-interval of a parameter and `s ∈ [−1, 1]` in it. Closed lines reduce `u` modulo 1, open ones clamp it to `[0, 1]`.
pub fn locate(u: f64, intervals: usize, closed: bool) -> (usize, f64) {
    let u = if closed { u - u.floor() } else { u.clamp(0.0, 1.0) };
    let halves = 2 * intervals;
    let position = halves as f64 * u;
    let half = (position as usize).min(halves - 1);
    (half, 2.0 * (position - half as f64) - 1.0)
}

/// Maps an operator that is not positive definite to dependent shifts.
pub(super) fn dependent(error: NumericError) -> GeometryError {
    match error {
        NumericError::NotPositiveDefinite { size, smallest } => GeometryError::Dependent { size, smallest },
        other => other.into(),
    }
}

/// First row of the circulant `∫₀¹ φ_0^(d₁)(u) φ_k^(d₂)(u) du = N^{d₁+d₂−1} Σ_n a_{d₁d₂}[k + nN]`.
///
/// `d₁ + d₂` must be even; otherwise the row belongs to an antisymmetric matrix.
pub fn gram_row(generator: &Generator, n: usize, d1: usize, d2: usize) -> Vec<f64> {
    let reach = generator.support() as isize - 1;
    let factor = (n as f64).powi((d1 + d2) as i32 - 1);
    let mut row = vec![0.0; n];
    for m in -reach..=reach {
        row[m.rem_euclid(n as isize) as usize] += factor * generator.correlation(d1, d2, m);
    }
    row
}

/// Eigenvalues of the circulant of [`gram_row`], by harmonic.
///
/// # Errors
/// [`GeometryError::Dependent`] if the shifts are dependent.
pub(super) fn gram_eigenvalues(generator: &Generator, n: usize) -> Result<Vec<f64>, GeometryError> {
    let gram = Circulant::new(&gram_row(generator, n, 0, 0)).map_err(dependent)?;
    Ok(gram.eigenvalues().to_vec())
}

/// `b[k mod N] += φ(k)`: the samples at the knots are this circulant times the control points.
fn sampling_row(generator: &Generator, n: usize) -> Vec<f64> {
    let reach = generator.support() as isize / 2;
    let mut row = vec![0.0; n];
    for k in -reach..=reach {
        row[k.rem_euclid(n as isize) as usize] += generator.evaluate(k as f64, 0);
    }
    row
}
