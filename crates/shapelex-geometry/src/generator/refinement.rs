//! Two-scale relations: generators as combinations of B-splines on a finer grid.
//!
//! ```text
//! β_α(t) = Σ_k h[k] β_{α/m}(m t − k + n(m−1)/2),     Σ h[k] z^{−k} = m^{1−n} Π_i Σ_{k<m} (e^{α_i/m} z⁻¹)^k
//! φ(t)   = Σ_l g[l] β_{α/m}(m t − l + …),            g[l] = Σ_ν λ[|ν|] h[l − m(n − 2 + ν)/2],  |ν| ≤ n − 2, m even
//! ```
//!
//! Here `φ` is the interpolator of half-integer shifts and `n = |α|`. The interpolators of increasing orders are not
//! combinations of a single B-spline and have no such relation.
//!
//! Source: Schmitter, *Spline Shape Processing*, (6.53)–(6.57), with one division of the poles and centred shifts.

use super::catalogue::{Built, Recipe};
use super::poles::{Poles, multiply};

/// Filter `h[0 … n(m−1)]` of the B-spline of `poles`, not normalised.
pub fn two_scale_filter(poles: &Poles, factor: usize) -> Vec<f64> {
    let m = factor as f64;
    // Σ_i Σ_i' f(i, i') z^{−(i+i')}
    let pair = |f: &dyn Fn(f64, f64) -> f64| {
        let mut product = vec![0.0; 2 * factor - 1];
        for i in 0..factor {
            for k in 0..factor {
                product[i + k] += f(i as f64, k as f64);
            }
        }
        product
    };
    let mut h = vec![m.powi(1 - poles.order() as i32)];
    for _ in 0..poles.zeros {
        h = multiply(&h, &vec![1.0; factor]);
    }
    for w in &poles.trigonometric {
        h = multiply(&h, &pair(&|i, k| (w * (i - k) / m).cos()));
    }
    for a in &poles.hyperbolic {
        h = multiply(&h, &pair(&|i, k| (a * (i - k) / m).cosh()));
    }
    for (a, b) in &poles.quadruples {
        for a in [*a, -a] {
            h = multiply(&h, &pair(&|i, k| (a * (i + k) / m).exp() * (b * (i - k) / m).cos()));
        }
    }
    h
}

/// Filter `g[0 … m(2n − 2) − n]` of the interpolator of half-integer shifts with `weights` `λ`, not normalised. `factor`
/// must be even.
pub fn prefilter(poles: &Poles, weights: &[f64], factor: usize) -> Vec<f64> {
    let h = two_scale_filter(poles, factor);
    let reach = poles.order() - 2;
    let mut g = vec![0.0; factor * reach + h.len()];
    for shift in 0..=2 * reach {
        let weight = weights[shift.abs_diff(reach)];
        let start = factor * shift / 2;
        h.iter().enumerate().for_each(|(k, value)| g[start + k] += weight * value);
    }
    g
}

/// A generator in terms of the normalised B-splines on the finer grid.
#[derive(Debug, Clone, PartialEq)]
pub struct FineFilter {
    /// Fine index of the first tap, relative to `factor` times the coarse index.
    pub first: isize,
    /// The taps; those of one residue modulo `factor` sum to one if 0 is a pole.
    pub taps: Vec<f64>,
    /// Whether the fine B-splines are centred half a fine interval before their index: for an odd order whose knots are split
    /// evenly.
    pub half_step: bool,
}

impl FineFilter {
    /// The filter of `built`, made by `recipe`; `None` if the generator has no two-scale relation with this factor.
    pub fn new(recipe: &Recipe, built: &Built, factor: usize) -> Option<Self> {
        let poles = recipe.poles();
        let order = poles.order();
        let doubled_delay = order * (factor - 1);
        let fine = poles.refined(factor as f64).integral();
        let (raw, lead, scale) = match recipe {
            // Shifts by half an interval on both grids: `(n(m−1) − (m−1))/2` fine intervals between the two.
            Recipe::ShiftedBspline(_) => {
                let taps = two_scale_filter(poles, factor).into_iter();
                let taps = taps.map(|value| fine / poles.integral() * value).collect();
                let first = -(((order - 1) * (factor - 1) / 2) as isize);
                return Some(Self { first, taps, half_step: false });
            }
            Recipe::Bspline(_) => (two_scale_filter(poles, factor), 0, fine / poles.integral()),
            Recipe::HalfIntegerShifts(_) if factor.is_multiple_of(2) => {
                (prefilter(poles, built.weights.as_ref()?, factor), factor / 2 * (order - 2), fine)
            }
            _ => return None,
        };
        Some(Self {
            first: -((lead + doubled_delay / 2) as isize),
            taps: raw.into_iter().map(|value| scale * value).collect(),
            half_step: doubled_delay % 2 == 1,
        })
    }

    /// The same taps for fine B-splines that are centred half a fine interval after their index, as shifted ones are.
    #[must_use]
    pub fn for_shifted(self) -> Self {
        if self.half_step { Self { first: self.first - 1, half_step: false, ..self } } else { self }
    }
}
