//! Seams: tori whose `u` direction is glued with a twist.
//!
//! ```text
//! σ(u + 1, v) = σ(u, π(v)),   c[k + M_u, l] = c[k, π(l)]
//! ```
//!
//! Two turns of `u` form a torus of `2M_u × M_v` control points (the *double cover*), on which the shift by `M_u` combined
//! with `π` commutes with the Gram operator and its root. Every operation on the twisted torus is therefore done on the
//! double cover, of which half is kept.

use std::sync::Arc;

use shapelex_numeric::operator::SymmetricOperator;

/// Seam of a torus: the map of `v` after one turn of `u`. `straight`: no twist. `reflected`: `v → −v`, a one-sided surface.
/// `half_turn`: `v → v + ½`, for an even number of control points along `v`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Seam {
    /// No twist.
    #[default]
    Straight,
    /// `π(v) = −v`, as on the figure-8 immersion of the Klein bottle. The surface is one-sided.
    Reflected,
    /// `π(v) = v + ½`. Needs an even number of control points along `v`.
    HalfTurn,
}

impl Seam {
    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Straight => "straight",
            Self::Reflected => "reflected",
            Self::HalfTurn => "half_turn",
        }
    }

    /// Whether there is no twist.
    pub fn is_straight(&self) -> bool {
        *self == Self::Straight
    }

    /// `π(l)` for the control point `l` of `count`.
    pub fn across(self, l: usize, count: usize) -> usize {
        match self {
            Self::Straight => l,
            Self::Reflected => (count - l) % count,
            Self::HalfTurn => (l + count / 2) % count,
        }
    }

    /// `π(v)` of a parameter.
    pub fn beyond(self, v: f64) -> f64 {
        match self {
            Self::Straight => v,
            Self::Reflected => 1.0 - v,
            Self::HalfTurn => v + 0.5,
        }
    }

    /// `x` (`[k][l]`, `count` along `v`), followed by its values on the second turn.
    pub(super) fn unfold(self, x: &[f64], count: usize) -> Vec<f64> {
        let mut both = x.to_vec();
        for row in x.chunks_exact(count) {
            both.extend((0..count).map(|l| row[self.across(l, count)]));
        }
        both
    }
}

/// The Gram operator of a twisted torus, from that of its double cover.
#[derive(Debug)]
pub(super) struct TwistedGram {
    pub(super) seam: Seam,
    /// `Φ_{2M_u} ⊗ Φ_v`, averaged over functions of `u ∈ [0, 2]`.
    pub(super) cover: Arc<dyn SymmetricOperator>,
    /// `M_v`.
    pub(super) count: usize,
}

impl TwistedGram {
    fn on_cover(
        &self,
        data: &mut [f64],
        factor: f64,
        operation: impl Fn(&dyn SymmetricOperator, &mut [f64]),
    ) {
        assert_eq!(data.len() % self.size(), 0, "columns of length {}", self.size());
        for x in data.chunks_exact_mut(self.size()) {
            let mut both = self.seam.unfold(x, self.count);
            operation(&*self.cover, &mut both);
            x.iter_mut().zip(&both).for_each(|(x, y)| *x = factor * y);
        }
    }
}

// `Φ = EᵀΦ̂E = 2 (Φ̂E)₁` with `E = (1, π)ᵀ`, where `(·)₁` is the first half: `Φ̂E` is the same on both halves.
impl SymmetricOperator for TwistedGram {
    fn size(&self) -> usize {
        self.cover.size() / 2
    }

    fn apply(&self, data: &mut [f64]) {
        self.on_cover(data, 2.0, |cover, data| cover.apply(data));
    }

    fn solve(&self, data: &mut [f64]) {
        self.on_cover(data, 0.5, |cover, data| cover.solve(data));
    }

    fn whiten(&self, data: &mut [f64]) {
        self.on_cover(data, 2.0_f64.sqrt(), |cover, data| cover.whiten(data));
    }

    fn unwhiten(&self, data: &mut [f64]) {
        self.on_cover(data, 0.5_f64.sqrt(), |cover, data| cover.unwhiten(data));
    }
}
