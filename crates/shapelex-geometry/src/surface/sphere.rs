//! Spheres: surfaces that close at two poles and stay smooth there under any deformation.
//!
//! ```text
//! σ(u, v) = Σ_{k<M_u} Σ_{l=−1}^{M_v+1} c[k, l] φ_u(M_u u − k) φ_v(M_v v − l)
//! σ(u, 0) = c_N,   σ_v(u, 0) = T_1N cos 2πu + T_2N sin 2πu,   likewise at v = 1 with c_S, T_1S, T_2S
//! ```
//!
//! The degrees of freedom are the `M_u (M_v − 1)` control points between the poles, the two poles, and four tangents. A
//! tangent is stored as a point: the *handle* `c_N + κ T`, `κ = sin(π/M_v)/π`, which lies on the first ring of a round
//! sphere. All `N = M_u (M_v − 1) + 6` rows of a shape are therefore points: an affine map of the rows is that of the
//! surface, and equal rows give a constant.
//!
//! Along `u`, a pole is constant and tangents are first harmonics. The real Fourier transform along `u` therefore splits the
//! Gram operator into banded blocks along `v`: one with the poles, two with a pair of tangents each, and a common one for
//! all other harmonics, times the eigenvalue of `Φ_u`.
//!
//! A generator that is shifted by half an interval along `v` has `M_v + 2` control points, the first two of which follow from pole and
//! tangents alone: there are `M_v − 2` rings between the poles, and points at the knots are met in the mean only.
//!
//! Source: Schmitter, *Spline Shape Processing*, (7.11)–(7.13), with the lengths of the tangents corrected.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use std::sync::Arc;

use realfft::num_complex::Complex64;

use super::super::GeometryError;
use super::super::knot_line::{Line, dependent};
use super::super::open::OpenInterpolation;
use shapelex_numeric::banded::{Band, Banded};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::fft::RealFft;
use shapelex_numeric::kronecker::transpose;
use shapelex_numeric::operator::SymmetricOperator;

/// Number of rows after those between the poles: the poles, the handles of the north, the handles of the south.
pub const POLAR_ROWS: usize = 6;
/// Minimum number of intervals from pole to pole, with one ring of points in between.
pub const MIN_ALONG_MERIDIAN: usize = 2;
/// As [`POLAR_ROWS`], with sharp poles and `around` control points along `u`: the poles, and a handle for each meridian at either.
pub fn sharp_polar_rows(around: usize) -> usize {
    around.saturating_mul(2).saturating_add(2)
}
const NORTH: usize = 0;
const SOUTH: usize = 1;
/// Index of the first handle of each pole.
const HANDLES: [usize; 2] = [2, 4];

/// `κ`, the length of handles: a handle is the pole plus `κ` times the tangent.
pub fn handle_length(meridian_intervals: usize) -> f64 {
    (PI / meridian_intervals as f64).sin() / PI
}

/// Coefficients of the conditions at the poles.
#[derive(Debug, Clone, Copy)]
struct PoleRule {
    /// `φ_v(0)`, `φ_v(1)`.
    values: [f64; 2],
    /// `M_v φ_v'(1)`.
    slope: f64,
    /// Whether `φ_v` is shifted by half an interval: the two control points at a pole are those at `±½`.
    shifted: bool,
    /// Ratio of the control values of `cos 2πu` to its samples at the knots.
    harmonic: f64,
}

impl PoleRule {
    /// For a closed line along `u`, and an open one along `v` with one phantom beyond each end.
    fn new(around: &Line, meridian: &Line) -> Self {
        let [phi, psi] = [around.generator(), meridian.generator()];
        let reach = (phi.support() / 2) as isize;
        let omega = TAU / around.intervals() as f64;
        let gain: f64 = (-reach..=reach).map(|k| phi.evaluate(k as f64, 0) * (omega * k as f64).cos()).sum();
        Self {
            values: [psi.evaluate(0.0, 0), psi.evaluate(1.0, 0)],
            slope: meridian.intervals() as f64 * psi.evaluate(1.0, 1),
            shifted: psi.is_shifted(),
            harmonic: gain.recip(),
        }
    }

    /// The two control points at and beyond a pole, from the one before it, the pole, and the inward derivative `σ_v` there.
    ///
    /// ```text
    /// c[−1] = c[1] + τ/(M_v φ'(1)),    c[0] = (c_N − φ(1)(c[−1] + c[1]))/φ(0)
    /// shifted:  φ(0) = φ(1),   c[−1], c[0] = ½ (c_N/φ(1) ± τ/(M_v φ'(1)))
    /// ```
    fn close(&self, inner: f64, pole: f64, tangent: f64) -> [f64; 2] {
        if self.shifted {
            let (middle, step) = (0.5 * pole / self.values[1], 0.5 * tangent / self.slope);
            return [middle - step, middle + step];
        }
        let beyond = inner + tangent / self.slope;
        [(pole - self.values[1] * (beyond + inner)) / self.values[0], beyond]
    }
}

/// Conditions at the poles besides closedness.
#[derive(Debug, Clone)]
enum Ends {
    /// One tangent plane at each pole.
    Smooth,
    /// Nothing: every meridian has its own tangent. Without given ones, those that continue the meridian beyond its ends.
    Sharp(Arc<OpenInterpolation>),
}

/// Map from the rows of a sphere to its `M_u × (M_v + 3)` tensor-product control points.
#[derive(Debug, Clone)]
pub(super) struct SphereBasis {
    /// `M_u`, `M_v`.
    intervals: [usize; 2],
    rule: PoleRule,
    ends: Ends,
    /// Map from points along a meridian to its control points, with the first and the last row halved.
    meridians: Arc<Banded>,
}

impl SphereBasis {
    /// # Errors
    /// [`GeometryError::Dependent`] if the samples along a meridian do not determine the control points.
    pub(super) fn new(around: &Line, meridian: &Line) -> Result<Self, GeometryError> {
        let (rule, last) = (PoleRule::new(around, meridian), meridian.intervals());
        let band = if rule.shifted {
            normal_of_pairs(last - 2, rule.values[1])
        } else {
            knots_of(last, rule.values)
        };
        let meridians = Arc::new(Banded::new(band).map_err(dependent)?);
        Ok(Self { intervals: [around.intervals(), last], rule, ends: Ends::Smooth, meridians })
    }

    /// The same with sharp poles.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub(super) fn sharp(around: &Line, meridian: &Line, interpolating: bool) -> Result<Self, GeometryError> {
        let (generator, poles) = (meridian.generator(), meridian.poles());
        let open = OpenInterpolation::new(generator, poles, meridian.intervals(), interpolating);
        let ends = Ends::Sharp(Arc::new(open.map_err(dependent)?));
        Ok(Self { ends, ..Self::new(around, meridian)? })
    }

    /// `M_u`, `M_v`.
    pub(super) fn intervals(&self) -> [usize; 2] {
        self.intervals
    }

    /// Whether every meridian has its own tangent at the poles.
    pub(super) fn is_sharp(&self) -> bool {
        matches!(self.ends, Ends::Sharp(_))
    }

    /// Number of rows after those between the poles: the poles and their handles.
    pub(super) fn polar_rows(&self) -> usize {
        if self.is_sharp() { sharp_polar_rows(self.intervals[0]) } else { POLAR_ROWS }
    }

    /// Number of rings between the poles, `M_v − 1`; one less if the generator is shifted.
    pub(super) fn between(&self) -> usize {
        self.intervals[1] - 1 - usize::from(self.rule.shifted)
    }

    /// Number of control points along a meridian, with those at and beyond the poles.
    pub(super) fn columns_stored(&self) -> usize {
        self.between() + 4
    }

    /// Number of control points between the poles.
    fn free(&self) -> usize {
        self.intervals[0] * self.between()
    }

    /// `c[k, l]` for one coordinate of a shape, `l = −1 … M_v + 1` fastest.
    pub(super) fn expand(&self, rows: &[f64]) -> Vec<f64> {
        let (count, columns) = (self.intervals[0], self.columns_stored());
        let value =
            |k, l| -> f64 { self.combination(k, l).iter().map(|(row, part)| part * rows[*row]).sum() };
        let mut grid = Vec::with_capacity(count * columns);
        for (k, row) in rows[..self.free()].chunks_exact(self.between()).enumerate() {
            grid.extend([value(k, 0), value(k, 1)]);
            grid.extend(row);
            grid.extend([value(k, columns - 2), value(k, columns - 1)]);
        }
        grid
    }

    /// The control point `l − 1` of meridian `k` as a combination of rows.
    pub(super) fn combination(&self, k: usize, l: usize) -> Vec<(usize, f64)> {
        let [count, intervals] = self.intervals;
        let row = |l: usize| k * self.between() + l - 1;
        // At the south, inwards is against the direction of v.
        let (pole, inner, which, direction) = match l {
            0 | 1 => (NORTH, row(1), 1 - l, 1.0),
            _ if l > self.between() + 1 => (SOUTH, row(self.between()), l - self.between() - 2, -1.0),
            _ => return vec![(row(l - 1), 1.0)],
        };
        let part = |inner, pole, tangent| self.rule.close(inner, pole, tangent)[which];
        if self.is_sharp() {
            let (tangent, first) = (part(0.0, 0.0, 1.0) / handle_length(intervals), self.free());
            return vec![
                (inner, part(1.0, 0.0, 0.0)),
                (first + pole, part(0.0, 1.0, 0.0) - tangent),
                (first + 2 + pole * count + k, tangent),
            ];
        }
        let (sine, cosine) = (TAU * k as f64 / count as f64).sin_cos();
        let tangent = direction * self.rule.harmonic * part(0.0, 0.0, 1.0) / handle_length(intervals);
        let first = self.free();
        vec![
            (inner, part(1.0, 0.0, 0.0)),
            (first + pole, part(0.0, 1.0, 0.0) - tangent * (cosine + sine)),
            (first + HANDLES[pole], tangent * cosine),
            (first + HANDLES[pole] + 1, tangent * sine),
        ]
    }

    /// Rows, for one coordinate, of the surface that interpolates `points` (`[k][l]`, `l = 0 … M_v`) with the given tangents.
    ///
    /// Along `u` this is a solve on the closed line. Along `v`, with `c[−1]` and `c[M_v + 1]` from the conditions at the poles,
    /// `φ(1) c[l−1] + φ(0) c[l] + φ(1) c[l+1] = p[l]`: a symmetric band matrix if the first and the last row are halved.
    pub(super) fn interpolate(
        &self,
        points: &[f64],
        lines: &[Line; 2],
        north: [f64; 2],
        south: [f64; 2],
    ) -> Vec<f64> {
        let [count, intervals] = self.intervals;
        let length = intervals + 1;
        let mut turned = vec![0.0; points.len()];
        transpose(points, length, &mut turned);
        let around = lines[0].interpolate(Matrix::from_vec(count, length, turned));
        let side = self.rule.values[1];
        let mut rows = Vec::with_capacity(self.free() + POLAR_ROWS);
        let [top, bottom] = [points[0], points[intervals]];
        for k in 0..count {
            let (sine, cosine) = (TAU * k as f64 / count as f64).sin_cos();
            let tangent = |[a, b]: [f64; 2]| self.rule.harmonic * (a * cosine + b * sine) / self.rule.slope;
            let mut p: Vec<f64> = (0..length).map(|l| around[(k, l)]).collect();
            if self.rule.shifted {
                rows.extend(self.between_in_mean(&p, [top, bottom], [tangent(north), -tangent(south)]));
                continue;
            }
            p[0] = 0.5 * (top - side * tangent(north));
            p[intervals] = 0.5 * (bottom + side * tangent(south));
            self.meridians.solve(&mut p);
            rows.extend_from_slice(&p[1..intervals]);
        }
        let kappa = handle_length(intervals);
        rows.extend([top, bottom]);
        rows.extend(north.map(|tangent| top + kappa * tangent));
        rows.extend(south.map(|tangent| bottom + kappa * tangent));
        rows
    }

    /// Control points between the poles with a shifted generator, from the points `p` at the knots of a meridian, its poles, and its
    /// inward tangents over `M_v φ'(1)`: `φ(1) (c[l−1] + c[l]) = p[l]` at all knots in between, in the least-squares sense.
    fn between_in_mean(&self, p: &[f64], poles: [f64; 2], steps: [f64; 2]) -> Vec<f64> {
        let (last, value) = (self.intervals[1], self.rule.values[1]);
        let mut left: Vec<f64> = p[1..last].to_vec();
        let ends = [0, 1].map(|i| self.rule.close(0.0, poles[i], steps[i] * self.rule.slope)[0]);
        left[0] -= value * ends[0];
        left[last - 2] -= value * ends[1];
        let mut free: Vec<f64> = left.windows(2).map(|pair| value * (pair[0] + pair[1])).collect();
        self.meridians.solve(&mut free);
        free
    }

    /// Rows, for one coordinate, of the sphere with sharp poles that interpolates `points` (`[k][l]`, `l = 0 … M_v`). Meridians are
    /// continued beyond the poles by annihilation, as open lines are.
    pub(super) fn interpolate_sharp(&self, points: &[f64], lines: &[Line; 2]) -> Vec<f64> {
        let Ends::Sharp(open) = &self.ends else { return Vec::new() };
        let [count, intervals] = self.intervals;
        let length = intervals + 1;
        let mut turned = vec![0.0; points.len()];
        transpose(points, length, &mut turned);
        let around = lines[0].interpolate(Matrix::from_vec(count, length, turned));
        let net = open.interpolate(&around.transpose());
        let [top, bottom] = [points[0], points[intervals]];
        self.rows_of_sharp_net(|k, l| net[(l, k)], [top, bottom])
    }

    /// Rows, for one coordinate, with the control points `c(k, l)`, `l − 1 = −1 … M_v + 1`, and these poles.
    pub(super) fn rows_of_sharp_net(&self, c: impl Fn(usize, usize) -> f64, poles: [f64; 2]) -> Vec<f64> {
        let [count, intervals] = self.intervals;
        let mut rows = Vec::with_capacity(self.free() + self.polar_rows());
        for k in 0..count {
            rows.extend((2..2 + self.between()).map(|l| c(k, l)));
        }
        rows.extend(poles);
        let (kappa, last) = (handle_length(intervals), self.columns_stored() - 1);
        let step = if self.rule.shifted { 1 } else { 2 };
        for (pole, beyond, inner) in [(poles[0], 0, step), (poles[1], last, last - step)] {
            rows.extend((0..count).map(|k| pole + kappa * self.rule.slope * (c(k, beyond) - c(k, inner))));
        }
        rows
    }

    /// The block `EᵀΦ_vE` of a sphere with sharp poles, for the tangents and the points between the poles, and with `poles` for these
    /// before and after them.
    pub(super) fn sharp_block(
        &self,
        meridian: &Band,
        support: usize,
        poles: bool,
    ) -> Result<Banded, GeometryError> {
        let last = self.columns_stored() - 1;
        let mut columns = self.columns(Some(1));
        let [at, beyond] = self.rule.close(0.0, 0.0, 1.0);
        let south = columns.len() - 1;
        // Tangents of both poles point inwards.
        columns[south] = vec![(last, beyond), (last - 1, at)];
        if poles {
            let [at, beyond] = self.rule.close(0.0, 1.0, 0.0);
            columns.insert(0, vec![(0, beyond), (1, at)]);
            columns.push(vec![(last, beyond), (last - 1, at)]);
        }
        gram_block(&columns, meridian, support + 1)
    }

    /// Coefficients over the control points `l = −1 … M_v + 1` of a meridian: for the pole (`order` 0) or the tangent
    /// (`order` 1) at the north, for the points between the poles, then for the south.
    fn columns(&self, order: Option<usize>) -> Vec<Vec<(usize, f64)>> {
        let last = self.columns_stored() - 1;
        let ends = |pole: f64, tangent: f64| self.rule.close(0.0, pole, tangent);
        let polar = order.map(|order| match order {
            0 => (ends(1.0, 0.0), ends(1.0, 0.0)),
            _ => (ends(0.0, 1.0), ends(0.0, -1.0)),
        });
        let inner = self.rule.close(1.0, 0.0, 0.0);
        let mut columns = Vec::new();
        if let Some(([at, beyond], _)) = polar {
            columns.push(vec![(0, beyond), (1, at)]);
        }
        for l in 1..=self.between() {
            let mut column = vec![(l + 1, 1.0)];
            if l == 1 {
                column.extend([(0, inner[1]), (1, inner[0])]);
            }
            if l == self.between() {
                column.extend([(last, inner[1]), (last - 1, inner[0])]);
            }
            columns.push(column);
        }
        if let Some((_, [at, beyond])) = polar {
            columns.push(vec![(last, beyond), (last - 1, at)]);
        }
        columns
    }

    /// The block `EᵀΦ_vE` for these columns.
    fn block(&self, meridian: &Band, support: usize, order: Option<usize>) -> Result<Banded, GeometryError> {
        gram_block(&self.columns(order), meridian, (support - 1).max(2))
    }
}

/// Samples at the knots of a meridian of `last` intervals, with the first and the last row halved.
fn knots_of(last: usize, [middle, side]: [f64; 2]) -> Band {
    let mut band = Band::zeros(last + 1, 1);
    for l in 0..=last {
        band.add(l, l, if l == 0 || l == last { 0.5 * middle } else { middle });
        if l < last {
            band.add(l, l + 1, side);
        }
    }
    band
}

/// The normal matrix of `value (c[l − 1] + c[l])`, `l = 0 … count`, for `count` unknowns.
fn normal_of_pairs(count: usize, value: f64) -> Band {
    let mut band = Band::zeros(count, 1);
    for l in 0..count {
        band.add(l, l, 2.0 * value * value);
        if l + 1 < count {
            band.add(l, l + 1, value * value);
        }
    }
    band
}

/// `EᵀΦ_vE` for the columns of `E`, a band of this width.
fn gram_block(columns: &[Vec<(usize, f64)>], meridian: &Band, width: usize) -> Result<Banded, GeometryError> {
    let mut block = Band::zeros(columns.len(), width);
    for (i, a) in columns.iter().enumerate() {
        for (j, b) in columns.iter().enumerate().skip(i).take(width + 1) {
            let pairs = a.iter().flat_map(|x| b.iter().map(move |y| (x, y)));
            block.add(i, j, pairs.map(|((k, x), (l, y))| x * meridian.get(*k, *l) * y).sum());
        }
    }
    Banded::new(block).map_err(dependent)
}

/// The Gram operator of the rows of a sphere.
#[derive(Debug)]
pub(super) struct SphereGram {
    basis: SphereBasis,
    fft: RealFft,
    /// Eigenvalues of `Φ_u`, by harmonic.
    eigenvalues: Vec<f64>,
    /// Blocks with the poles, with tangents, and for the points in between alone.
    blocks: [Banded; 3],
}

/// Whether a block operation is `Φ` or its root.
#[derive(Clone, Copy)]
enum Power {
    Whole,
    Half,
}

impl SphereGram {
    /// From the eigenvalues of `Φ_u` and the matrix `Φ_v`.
    ///
    /// # Errors
    /// [`GeometryError::Dependent`] if a block is not positive definite.
    pub(super) fn new(
        basis: SphereBasis,
        eigenvalues: Vec<f64>,
        meridian: &Band,
        support: usize,
    ) -> Result<Self, GeometryError> {
        let block = |order| basis.block(meridian, support, order);
        let blocks = [block(Some(0))?, block(Some(1))?, block(None)?];
        Ok(Self { fft: RealFft::new(basis.intervals[0]), basis, eigenvalues, blocks })
    }

    /// The harmonics in order (`1`, `cos`, `sin`, `cos 2·`, …): the start of each, its block, and its eigenvalue. The first three
    /// have the polar unknown of the north before them and that of the south after them.
    fn harmonics(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        let (count, between) = (self.basis.intervals[0], self.basis.between());
        (0..count).map(move |q| {
            let before = q.min(3) * 2 + q * between;
            (before, [0, 1, 1].get(q).copied().unwrap_or(2), self.eigenvalues[q.div_ceil(2)])
        })
    }

    /// Unitary real Fourier transform along `u` of the points between the poles (input `k` slow, output harmonics slow).
    fn transform(&self, x: &[f64], y: &mut [f64]) {
        let (count, between) = (self.basis.intervals[0], self.basis.between());
        let mut scratch = self.fft.scratch();
        let mut spectrum = vec![Complex64::ZERO; self.fft.spectrum_len()];
        let mut signal = vec![0.0; count];
        let starts: Vec<usize> = self.starts().collect();
        for l in 0..between {
            for (k, value) in signal.iter_mut().enumerate() {
                *value = x[k * between + l];
            }
            self.fft.forward(&signal, &mut spectrum, &mut scratch);
            for (q, start) in starts.iter().enumerate() {
                let value = spectrum[q.div_ceil(2)];
                let single = q == 0 || 2 * q.div_ceil(2) == count;
                let part = if q == 0 || q % 2 == 1 { value.re } else { -value.im };
                y[start + l] = part * (if single { 1.0 } else { 2.0 } / count as f64).sqrt();
            }
        }
    }

    /// The inverse of [`Self::transform`], which is its transpose.
    fn transform_back(&self, y: &[f64], x: &mut [f64]) {
        let (count, between) = (self.basis.intervals[0], self.basis.between());
        let mut scratch = self.fft.scratch();
        let mut spectrum = vec![Complex64::ZERO; self.fft.spectrum_len()];
        let mut signal = vec![0.0; count];
        let starts: Vec<usize> = self.starts().collect();
        for l in 0..between {
            spectrum.fill(Complex64::ZERO);
            for (q, start) in starts.iter().enumerate() {
                let single = q == 0 || 2 * q.div_ceil(2) == count;
                let value = y[start + l] * (if single { 1.0 } else { 0.5 } * count as f64).sqrt();
                let place = &mut spectrum[q.div_ceil(2)];
                if q == 0 || q % 2 == 1 { place.re = value } else { place.im = -value }
            }
            self.fft.inverse(&mut spectrum, &mut signal, &mut scratch);
            for (k, value) in signal.iter().enumerate() {
                x[k * between + l] = *value;
            }
        }
    }

    /// Start of the points between the poles in every harmonic.
    fn starts(&self) -> impl Iterator<Item = usize> + '_ {
        self.harmonics().map(|(start, block, _)| start + usize::from(block < 2))
    }

    /// Positions of the polar unknowns among the harmonics, in the order of the rows, with the value of one unit of each.
    fn polar(&self) -> [(usize, f64); POLAR_ROWS] {
        let (count, length) = (self.basis.intervals[0] as f64, self.basis.between() + 2);
        let tangent = self.basis.rule.harmonic * count.sqrt() * FRAC_1_SQRT_2;
        let [pole, cosine, sine] = [0, length, 2 * length];
        let end = length - 1;
        [
            (pole, count.sqrt()),
            (pole + end, count.sqrt()),
            (cosine, tangent),
            (sine, tangent),
            (cosine + end, tangent),
            (sine + end, tangent),
        ]
    }

    /// Transforms the points between the poles to harmonics, and inserts the polar unknowns, each times its unit to the `power`.
    fn enter(&self, free: &[f64], unknowns: [f64; POLAR_ROWS], power: i32, y: &mut [f64]) {
        self.transform(free, y);
        for ((place, unit), value) in self.polar().into_iter().zip(unknowns) {
            y[place] = value * unit.powi(power);
        }
    }

    /// The reverse of [`Self::enter`]: the points between the poles, and the polar unknowns, each times its unit to the `power`.
    fn leave(&self, y: &[f64], power: i32, free: &mut [f64]) -> [f64; POLAR_ROWS] {
        self.transform_back(y, free);
        self.polar().map(|(place, unit)| y[place] * unit.powi(power))
    }

    /// Splits a shape into the points between the poles and the six polar rows.
    fn split<'a>(&self, x: &'a [f64]) -> (&'a [f64], [f64; POLAR_ROWS]) {
        let (free, polar) = x.split_at(self.basis.free());
        (free, polar.try_into().expect("there are six"))
    }

    fn kappa(&self) -> f64 {
        handle_length(self.basis.intervals[1])
    }

    /// `y = V x`: rows to harmonics, handles to tangents `(handle − pole)/κ`.
    fn analyse(&self, x: &[f64], y: &mut [f64]) {
        let (free, mut polar) = self.split(x);
        for (pole, first) in HANDLES.into_iter().enumerate() {
            let at = polar[pole];
            polar[first..first + 2].iter_mut().for_each(|handle| *handle = (*handle - at) / self.kappa());
        }
        self.enter(free, polar, 1, y);
    }

    /// `x = V⁻¹ y`.
    fn synthesise(&self, y: &[f64], x: &mut [f64]) {
        let (free, rows) = x.split_at_mut(self.basis.free());
        let mut polar = self.leave(y, -1, free);
        for (pole, first) in HANDLES.into_iter().enumerate() {
            let at = polar[pole];
            polar[first..first + 2].iter_mut().for_each(|tangent| *tangent = at + self.kappa() * *tangent);
        }
        rows.copy_from_slice(&polar);
    }

    /// `x = Vᵀ y`.
    fn synthesise_transposed(&self, y: &[f64], x: &mut [f64]) {
        let (free, rows) = x.split_at_mut(self.basis.free());
        let mut polar = self.leave(y, 1, free);
        for (pole, first) in HANDLES.into_iter().enumerate() {
            polar[first..first + 2].iter_mut().for_each(|handle| *handle /= self.kappa());
            polar[pole] -= polar[first] + polar[first + 1];
        }
        rows.copy_from_slice(&polar);
    }

    /// `y = V⁻ᵀ x`.
    fn analyse_transposed(&self, x: &[f64], y: &mut [f64]) {
        let (free, mut polar) = self.split(x);
        for (pole, first) in HANDLES.into_iter().enumerate() {
            polar[pole] += polar[first] + polar[first + 1];
            polar[first..first + 2].iter_mut().for_each(|tangent| *tangent *= self.kappa());
        }
        self.enter(free, polar, -1, y);
    }

    /// Applies `operation` to the block of every harmonic, and multiplies by its eigenvalue to the `power`.
    fn each_block(
        &self,
        y: &mut [f64],
        power: Power,
        inverse: bool,
        operation: impl Fn(&Banded, &mut [f64]),
    ) {
        for (start, block, eigenvalue) in self.harmonics() {
            let block = &self.blocks[block];
            let part = &mut y[start..start + block.size()];
            operation(block, part);
            let factor = match power {
                Power::Whole => eigenvalue,
                Power::Half => eigenvalue.sqrt(),
            };
            let factor = if inverse { factor.recip() } else { factor };
            part.iter_mut().for_each(|value| *value *= factor);
        }
    }
}

/// A change of basis.
type Change<G> = fn(&G, &[f64], &mut [f64]);

/// For every column: a change of basis, an operation on `blocks`, and another change of basis.
pub(super) fn through<G: SymmetricOperator>(
    gram: &G,
    data: &mut [f64],
    enter: Change<G>,
    blocks: impl Fn(&mut [f64]),
    leave: Change<G>,
) {
    assert_eq!(data.len() % gram.size(), 0, "columns of length {}", gram.size());
    let mut y = vec![0.0; gram.size()];
    for x in data.chunks_exact_mut(gram.size()) {
        enter(gram, x, &mut y);
        blocks(&mut y);
        leave(gram, &y, x);
    }
}

/// No change of basis.
pub(super) fn stay<G>(_: &G, x: &[f64], y: &mut [f64]) {
    y.copy_from_slice(x);
}

// `Φ = VᵀGV` and `R = G^½V` with the blocks `G`.
impl SymmetricOperator for SphereGram {
    fn size(&self) -> usize {
        self.basis.free() + POLAR_ROWS
    }

    fn apply(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, Power::Whole, false, |block, y| block.apply(y));
        through(self, data, Self::analyse, blocks, Self::synthesise_transposed);
    }

    fn solve(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, Power::Whole, true, |block, y| block.solve(y));
        through(self, data, Self::analyse_transposed, blocks, Self::synthesise);
    }

    fn whiten(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, Power::Half, false, |block, y| block.whiten(y));
        through(self, data, Self::analyse, blocks, stay);
    }

    fn unwhiten(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, Power::Half, true, |block, y| block.unwhiten(y));
        through(self, data, stay, blocks, Self::synthesise);
    }
}
