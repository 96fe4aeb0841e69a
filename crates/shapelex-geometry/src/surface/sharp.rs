//! Spheres with sharp poles: closed at both poles, with a separate tangent for each meridian there.
//!
//! ```text
//! σ(u, 0) = c_N,   σ_v(u, 0) = Σ_k τ_N[k] φ_u(M_u u − k),   likewise at v = 1 with c_S and −τ_S[k]
//! ```
//!
//! Only closedness is imposed: cones, creases and folds may end in the poles. The degrees of freedom are the `M_u (M_v − 1)`
//! control points between the poles, the two poles, and `2M_u` inward tangents. A tangent is stored as a point on its
//! meridian, the *handle* `c_N + κ τ_N[k]` or `c_S + κ τ_S[k]`, with the `κ` of smooth spheres; on a round sphere with an interpolating
//! generator along `u` it lies on the first ring. All `N = M_u (M_v + 1) + 2` rows of a shape are points, as on smooth spheres.
//!
//! The real Fourier transform along `u` splits the Gram operator into a banded block for the constants, which has the poles, and a
//! common one for all other harmonics, times the eigenvalue of `Φ_u`.
//!
//! Source: Schmitter, *Spline Shape Processing*, (7.13) without (7.11) and (7.12), as in Fig. 7.3 (left), 7.5 and 7.6 (right).

use realfft::num_complex::Complex64;

use super::super::GeometryError;
use super::sphere::{SphereBasis, handle_length, stay, through};
use shapelex_numeric::banded::{Band, Banded};
use shapelex_numeric::fft::RealFft;
use shapelex_numeric::operator::SymmetricOperator;

/// The Gram operator of the rows of a sphere with sharp poles.
#[derive(Debug)]
pub(super) struct SharpGram {
    /// `M_u`, `M_v`.
    intervals: [usize; 2],
    /// Number of rings between the poles.
    between: usize,
    fft: RealFft,
    /// Eigenvalues of `Φ_u`, by harmonic.
    eigenvalues: Vec<f64>,
    /// Blocks with the poles and without.
    blocks: [Banded; 2],
}

impl SharpGram {
    /// From the eigenvalues of `Φ_u` and the matrix `Φ_v`.
    ///
    /// # Errors
    /// [`GeometryError::Dependent`] if a block is not positive definite.
    pub(super) fn new(
        basis: &SphereBasis,
        eigenvalues: Vec<f64>,
        meridian: &Band,
        support: usize,
    ) -> Result<Self, GeometryError> {
        let block = |poles: bool| basis.sharp_block(meridian, support, poles);
        let (blocks, intervals) = ([block(true)?, block(false)?], basis.intervals());
        Ok(Self { intervals, between: basis.between(), fft: RealFft::new(intervals[0]), eigenvalues, blocks })
    }

    /// Unknowns along a meridian: both tangents and the points in between.
    fn length(&self) -> usize {
        self.between + 2
    }

    /// Start of the unknowns of harmonic `q` (`1`, `cos`, `sin`, `cos 2·`, …). The poles are before and after those of the constants.
    fn start(&self, q: usize) -> usize {
        if q == 0 { 1 } else { 2 + q * self.length() }
    }

    /// Places of the poles among the unknowns.
    fn poles(&self) -> [usize; 2] {
        [0, 1 + self.length()]
    }

    /// The part `[re, im]` of the spectrum that harmonic `q` is, and its weight in a unitary transform.
    fn part(&self, q: usize) -> (usize, bool, f64) {
        let (count, wave) = (self.intervals[0], q.div_ceil(2));
        let single = q == 0 || 2 * wave == count;
        (wave, q == 0 || q % 2 == 1, if single { 1.0 } else { 2.0 })
    }

    /// Unitary real Fourier transform along `u` of unknowns `[k][m]` of all meridians.
    fn transform(&self, grid: &[f64], y: &mut [f64]) {
        let (count, length) = (self.intervals[0], self.length());
        let mut scratch = self.fft.scratch();
        let mut spectrum = vec![Complex64::ZERO; self.fft.spectrum_len()];
        let mut signal = vec![0.0; count];
        for m in 0..length {
            signal.iter_mut().enumerate().for_each(|(k, value)| *value = grid[k * length + m]);
            self.fft.forward(&signal, &mut spectrum, &mut scratch);
            for q in 0..count {
                let (wave, real, weight) = self.part(q);
                let value = if real { spectrum[wave].re } else { -spectrum[wave].im };
                y[self.start(q) + m] = value * (weight / count as f64).sqrt();
            }
        }
    }

    /// The inverse of [`Self::transform`], which is its transpose.
    fn transform_back(&self, y: &[f64], grid: &mut [f64]) {
        let (count, length) = (self.intervals[0], self.length());
        let mut scratch = self.fft.scratch();
        let mut spectrum = vec![Complex64::ZERO; self.fft.spectrum_len()];
        let mut signal = vec![0.0; count];
        for m in 0..length {
            spectrum.fill(Complex64::ZERO);
            for q in 0..count {
                let (wave, real, weight) = self.part(q);
                let value = y[self.start(q) + m] * (count as f64 / weight).sqrt();
                if real { spectrum[wave].re = value } else { spectrum[wave].im = -value }
            }
            self.fft.inverse(&mut spectrum, &mut signal, &mut scratch);
            signal.iter().enumerate().for_each(|(k, value)| grid[k * length + m] = *value);
        }
    }

    /// Splits rows into the points between the poles, the poles, and the handles of both poles.
    fn split<'a>(&self, x: &'a [f64]) -> (&'a [f64], [f64; 2], [&'a [f64]; 2]) {
        let count = self.intervals[0];
        let (free, polar) = x.split_at(count * self.between);
        let (north, south) = polar[2..].split_at(count);
        (free, [polar[0], polar[1]], [north, south])
    }

    /// Unknowns `[k][m]` from the points between the poles and tangents by pole and meridian.
    fn join(&self, free: &[f64], tangent: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let mut grid = Vec::with_capacity(self.intervals[0] * self.length());
        for (k, points) in free.chunks_exact(self.between).enumerate() {
            grid.push(tangent(0, k));
            grid.extend_from_slice(points);
            grid.push(tangent(1, k));
        }
        grid
    }

    /// Rows from unknowns: `pole` of the sum of the tangents of a pole, `handle` of pole and tangent.
    fn leave(
        &self,
        y: &[f64],
        x: &mut [f64],
        pole: impl Fn(usize, f64) -> f64,
        handle: impl Fn(f64, f64) -> f64,
    ) {
        let (count, length) = (self.intervals[0], self.length());
        let mut grid = vec![0.0; count * length];
        self.transform_back(y, &mut grid);
        let (free, polar) = x.split_at_mut(count * (length - 2));
        for (points, unknowns) in free.chunks_exact_mut(length - 2).zip(grid.chunks_exact(length)) {
            points.copy_from_slice(&unknowns[1..length - 1]);
        }
        for which in [0, 1] {
            let tangent = |k: usize| grid[k * length + which * (length - 1)];
            let at = pole(which, (0..count).map(tangent).sum());
            polar[which] = at;
            (0..count).for_each(|k| polar[2 + which * count + k] = handle(at, tangent(k)));
        }
    }

    /// `√M_u`: one unit of a pole is this much of the constants.
    fn unit(&self) -> f64 {
        (self.intervals[0] as f64).sqrt()
    }

    fn kappa(&self) -> f64 {
        handle_length(self.intervals[1])
    }

    /// `y = V x`: rows to harmonics, handles to tangents `(handle − pole)/κ`.
    fn analyse(&self, x: &[f64], y: &mut [f64]) {
        let (free, poles, handles) = self.split(x);
        let tangent = |which: usize, k: usize| (handles[which][k] - poles[which]) / self.kappa();
        self.transform(&self.join(free, tangent), y);
        self.poles().into_iter().zip(poles).for_each(|(place, pole)| y[place] = pole * self.unit());
    }

    /// `x = V⁻¹ y`.
    fn synthesise(&self, y: &[f64], x: &mut [f64]) {
        let places = self.poles();
        let pole = |which: usize, _| y[places[which]] / self.unit();
        self.leave(y, x, pole, |at, tangent| at + self.kappa() * tangent);
    }

    /// `x = Vᵀ y`.
    fn synthesise_transposed(&self, y: &[f64], x: &mut [f64]) {
        let places = self.poles();
        let pole = |which: usize, sum: f64| y[places[which]] * self.unit() - sum / self.kappa();
        self.leave(y, x, pole, |_, tangent| tangent / self.kappa());
    }

    /// `y = V⁻ᵀ x`.
    fn analyse_transposed(&self, x: &[f64], y: &mut [f64]) {
        let (free, poles, handles) = self.split(x);
        self.transform(&self.join(free, |which, k| self.kappa() * handles[which][k]), y);
        for (which, place) in self.poles().into_iter().enumerate() {
            y[place] = (poles[which] + handles[which].iter().sum::<f64>()) / self.unit();
        }
    }

    /// Applies `operation` to the block of every harmonic, and multiplies by `factor` of its eigenvalue.
    fn each_block(
        &self,
        y: &mut [f64],
        operation: impl Fn(&Banded, &mut [f64]),
        factor: impl Fn(f64) -> f64,
    ) {
        for q in 0..self.intervals[0] {
            let block = &self.blocks[usize::from(q > 0)];
            let start = if q == 0 { 0 } else { self.start(q) };
            let part = &mut y[start..start + block.size()];
            operation(block, part);
            let factor = factor(self.eigenvalues[q.div_ceil(2)]);
            part.iter_mut().for_each(|value| *value *= factor);
        }
    }
}

// `Φ = VᵀGV` and `R = G^½V` with the blocks `G`.
impl SymmetricOperator for SharpGram {
    fn size(&self) -> usize {
        self.intervals[0] * self.length() + 2
    }

    fn apply(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, |block, y| block.apply(y), |value| value);
        through(self, data, Self::analyse, blocks, Self::synthesise_transposed);
    }

    fn solve(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, |block, y| block.solve(y), f64::recip);
        through(self, data, Self::analyse_transposed, blocks, Self::synthesise);
    }

    fn whiten(&self, data: &mut [f64]) {
        let blocks = |y: &mut [f64]| self.each_block(y, |block, y| block.whiten(y), f64::sqrt);
        through(self, data, Self::analyse, blocks, stay);
    }

    fn unwhiten(&self, data: &mut [f64]) {
        let blocks =
            |y: &mut [f64]| self.each_block(y, |block, y| block.unwhiten(y), |value| value.sqrt().recip());
        through(self, data, stay, blocks, Self::synthesise);
    }
}
