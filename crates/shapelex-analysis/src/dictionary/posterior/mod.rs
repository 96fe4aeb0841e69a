//! Posterior of a shape of which only a part is known: completion, bands, and shapes under conditions.
//!
//! ```text
//! y = ȳ + D z + e,   z ~ N(0, I),   D Dᵀ = Ξ C Ξᵀ,   e ~ N(0, ρ² I)         a shape in the pose of the dictionary, whitened
//! q_i = A p_i + b = E_i y + T_i(y) θ + ε_i,   ε_i ~ N(0, v_i),   θ flat       a seen point p_i, brought into pose
//! H = diag(I, 0) + Σ_i G_iᵀ G_i / v_i,   G_i = [E_i D, T_i(ŷ)],   (ẑ, θ̂) = H⁻¹ Σ_i G_iᵀ (q_i − E_i ȳ)/v_i
//! ```
//!
//! `E_i` evaluates a shape at the place of the point, `T_i` are the directions of the transformation class, whose flat prior makes it
//! unknown. The pose `(A, b)` absorbs `θ̂` and the step is repeated, until nothing moves. `H⁻¹` is then the covariance of the scores and
//! the pose together, and `G H⁻¹ Gᵀ + v` that of any other place. Variation outside the modes counts as noise, of the variance of the
//! residuals of held-out shapes.
//!
//! The posterior takes the modes as known. Those of few shapes are not, so its bands are too narrow; [`calibration`] widens them as far as
//! held-out shapes need.
//!
//! * [`places`] — shapes of a model at some places; [`model`] — the model that a dictionary is;
//! * [`pose`] — the transformation class as unknown; [`feature`] — functions of a shape that may be imposed;
//! * [`conditioning`] — the posterior; [`predicted`] — points and their covariances; [`calibration`] — factors of their bands;
//! * [`missing`] — a shape with missing parts; [`assessed`] — how unlike the model its seen part is.
//!
//! Sources: Albrecht, Lüthi, Gerig, Vetter 2013 (posterior shape models; the pose is alternated there too); Tipping, Bishop 1999
//! (residual as
//! noise); Diquigiovanni, Fontana, Vantini 2022 (simultaneous bands by split conformal prediction).

pub mod assessed;
pub mod calibration;
pub mod conditioning;
pub mod feature;
pub mod missing;
pub mod model;
pub mod places;
pub mod pose;
pub mod predicted;
#[cfg(test)]
mod tests;
