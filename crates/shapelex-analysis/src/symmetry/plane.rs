//! The best plane of reflection of a shape.
//!
//! With `M = (Π c)ᵀ Φ c` of a centred shape the reflection `H = I − 2 n nᵀ` makes `⟨S c, c⟩ = tr M − 2 nᵀ M n`, so that the best normal
//! is the eigenvector of the smallest eigenvalue of `M`: no reference shape, and no iteration.
//!
//! Of a closed curve without markings, `Π` reverses the control points from any shift `s`: `M_ij(s) = Σ_n x_i[s − n] x_j[n]` are circular
//! convolutions, all shifts at once by FFT. In the plane `tr M − 2 λ_min` is the magnitude of the self-convolution of `x_1 + i x_2`.

use super::error::SymmetryError;
use super::records::{CurvePlaneRecord, PlaneRecord};
use crate::AnalysisError;
use crate::metric::{dot, norm};
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::fft::RealFft;

/// Part of the best correlation from which a local maximum is told.
const TOLD: f64 = 0.95;
/// Relative difference below which two correlations are equal.
const TIE: f64 = 1e-9;
/// Most maxima that are told.
const MOST: usize = 16;

/// The best plane of a centred shape `x` and its relabelled `image`, both whitened and coordinate-major in `dimension` coordinates.
///
/// # Errors
/// A shape without extent.
pub fn best_plane(x: &[f64], image: &[f64], dimension: usize) -> Result<PlaneRecord, SymmetryError> {
    let size = x.len() / dimension;
    let of = |list: &[f64], c: usize| list[c * size..(c + 1) * size].to_vec();
    let entry = |i: usize, j: usize| dot(&of(image, i), &of(x, j));
    let products = Matrix::from_fn(dimension, dimension, |i, j| 0.5 * (entry(i, j) + entry(j, i)));
    let eigen = dense::symmetric_eigen(&products);
    let smallest =
        (0..dimension).min_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b])).unwrap_or(0);
    let mut normal: Vec<f64> = eigen.eigenvectors.column(smallest).iter().copied().collect();
    // One of two opposite normals.
    if normal.iter().find(|x| x.abs() > 1e-12).is_some_and(|x| *x < 0.0) {
        normal.iter_mut().for_each(|x| *x = -*x);
    }
    let whole = norm(x);
    if !(whole > 0.0 && normal.iter().all(|x| x.is_finite())) {
        return Err(SymmetryError::NoExtent);
    }
    let (mut odd, mut even, mut inner) = (0.0, 0.0, 0.0);
    for k in 0..size {
        let along: f64 = (0..dimension).map(|c| normal[c] * image[c * size + k]).sum();
        for (c, n) in normal.iter().enumerate() {
            let (own, other) = (x[c * size + k], image[c * size + k] - 2.0 * n * along);
            odd += (own - other).powi(2);
            even += (own + other).powi(2);
            inner += own * other;
        }
    }
    let axis_degrees = (dimension == 2).then(|| {
        let degrees = normal[0].atan2(-normal[1]).to_degrees().rem_euclid(180.0);
        if degrees < 180.0 { degrees } else { 0.0 }
    });
    Ok(PlaneRecord {
        normal,
        axis_degrees,
        correlation: inner / (whole * whole),
        asymmetry: odd.sqrt() / (2.0 * whole),
        symmetric_part: even.sqrt() / (2.0 * whole),
    })
}

/// Planes of a closed curve without markings: all local maxima of the correlation of the curve with its image of at least 95 % of the
/// best one, which comes first; equal ones by their shift. `x`: the centred curve, whitened, at control points spaced by arc length.
///
/// Cost: `d (d + 1)/2` transforms of length `N`, and an eigenproblem of size `d` for each shift.
///
/// # Errors
/// A curve without extent.
pub fn planes_of_curve(x: &[f64], dimension: usize) -> Result<Vec<CurvePlaneRecord>, SymmetryError> {
    let size = x.len() / dimension;
    let values = correlations(x, dimension)?;
    let best = values.iter().copied().fold(f64::MIN, f64::max);
    if !(best > 0.0) {
        return Err(SymmetryError::NoExtent);
    }
    let tie = TIE * best;
    let neighbours = |s: usize| [values[(s + size - 1) % size], values[(s + 1) % size]];
    let is_maximum = |&s: &usize| {
        let [before, after] = neighbours(s);
        values[s] > before + tie && values[s] >= after - tie
    };
    let mut shifts: Vec<usize> = (0..size).filter(is_maximum).filter(|&s| values[s] >= TOLD * best).collect();
    if shifts.is_empty() {
        // A circle: no maximum stands out.
        shifts.extend(values.iter().position(|value| *value >= best - tie));
    }
    let below = |s: usize| ((best - values[s]) / tie).floor();
    shifts.sort_by(|&a, &b| below(a).max(1.0).total_cmp(&below(b).max(1.0)).then(a.cmp(&b)));
    shifts.truncate(MOST);
    shifts
        .into_iter()
        .map(|shift| {
            let image = reversed(x, size, shift);
            let [before, after] = neighbours(shift);
            let bend = before - 2.0 * values[shift] + after;
            let fraction = if bend < -tie { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            let first = ((shift as f64 + fraction) / (2.0 * size as f64)).rem_euclid(1.0);
            Ok(CurvePlaneRecord {
                shift,
                crossings: [first, (first + 0.5).rem_euclid(1.0)],
                plane: best_plane(x, &image, dimension)?,
            })
        })
        .collect()
}

/// Coordinates of `size` points of a closed curve in reversed order: point `n` is point `shift − n`.
pub(super) fn reversed(x: &[f64], size: usize, shift: usize) -> Vec<f64> {
    x.chunks_exact(size)
        .flat_map(|column| (0..size).map(move |n| column[(shift + size - n) % size]))
        .collect()
}

/// `max_H ⟨S_s x, x⟩ = tr M(s) − 2 λ_min(M(s))` of every shift.
fn correlations(x: &[f64], dimension: usize) -> Result<Vec<f64>, AnalysisError> {
    let size = x.len() / dimension;
    let fft = RealFft::new(size);
    let mut scratch = fft.scratch();
    let spectra: Vec<Vec<_>> = x
        .chunks_exact(size)
        .map(|column| {
            let mut spectrum = vec![Default::default(); fft.spectrum_len()];
            fft.forward(column, &mut spectrum, &mut scratch);
            spectrum
        })
        .collect();
    let mut entries = vec![Matrix::zeros(dimension, dimension); size];
    let mut convolution = vec![0.0; size];
    for (i, j) in (0..dimension).flat_map(|i| (0..=i).map(move |j| (i, j))) {
        let mut product: Vec<_> = spectra[i].iter().zip(&spectra[j]).map(|(a, b)| a * b).collect();
        fft.inverse(&mut product, &mut convolution, &mut scratch);
        for (matrix, &value) in entries.iter_mut().zip(&convolution) {
            matrix[(i, j)] = value;
            matrix[(j, i)] = value;
        }
    }
    let of = |matrix: &Matrix| matrix.trace() - 2.0 * dense::symmetric_eigen(matrix).eigenvalues.min();
    Ok(entries.iter().map(of).collect())
}
