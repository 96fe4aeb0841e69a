//! Values of a curve at the Gauss nodes of its half-segments, all nodes at once.
//!
//! ```text
//! ∫_{−1}^{1} f(s) ds ≈ Σ_i w_i f(s_i)      12 nodes, and 8 to see how well the 12 have done
//! ```

use std::sync::LazyLock;

use super::curve::Curve;
use super::generator::HALF_PIECE;
use shapelex_numeric::quadrature::GaussLegendre;

/// Nodes of the rule, exact for degree 23, and of its check.
const NODES: usize = 12;
const CHECKS: usize = 8;
/// Numbers that are computed at once: all nodes, a multiple of four.
const LANES: usize = NODES + CHECKS;

type Lanes = [f64; LANES];

/// Nodes of both rules, one after the other, and their weights.
static RULES: LazyLock<(Lanes, Lanes)> = LazyLock::new(|| {
    let (mut nodes, mut weights) = ([0.0; LANES], [0.0; LANES]);
    let rules = [GaussLegendre::new(NODES), GaussLegendre::new(CHECKS)];
    for (lane, (node, weight)) in rules.iter().flat_map(GaussLegendre::points).enumerate() {
        (nodes[lane], weights[lane]) = (node, weight);
    }
    (nodes, weights)
});

/// Integrals over a half-segment by both rules.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Integral {
    /// By 12 nodes.
    pub(crate) value: f64,
    /// By 8 nodes.
    pub(crate) check: f64,
}

impl Integral {
    fn of(values: &Lanes) -> Self {
        let (nodes, checks) = (RULES.1.split_at(NODES), values.split_at(NODES));
        Self { value: dot(nodes.0, checks.0), check: dot(nodes.1, checks.1) }
    }
}

/// Dot product of a multiple of four numbers, in four sums that do not wait for each other.
fn dot(weights: &[f64], values: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    for (weights, values) in weights.as_chunks::<4>().0.iter().zip(values.as_chunks::<4>().0) {
        for lane in 0..4 {
            sums[lane] += weights[lane] * values[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// `∫ |dr/dt| ds` over every half-segment.
pub(crate) fn speeds(curve: &Curve) -> Vec<Integral> {
    let of_half = |half: usize| {
        let mut squares = [0.0; LANES];
        for c in 0..curve.dimension() {
            let slope = slopes(curve.polynomial(half, c));
            squares.iter_mut().zip(slope).for_each(|(square, slope)| *square += slope * slope);
        }
        squares.iter_mut().for_each(|square| *square = square.sqrt());
        Integral::of(&squares)
    };
    (0..curve.halves()).map(of_half).collect()
}

/// `½ ∮ x dy − y dx` of a planar curve, relative to its first point, so that a shape far from the origin keeps its digits.
pub(crate) fn signed_area(curve: &Curve) -> f64 {
    let origin = curve.evaluate(0.0, 0);
    let mut sums = [0.0; LANES];
    for half in 0..curve.halves() {
        let [x, y] = [0, 1].map(|c| {
            let polynomial = curve.polynomial(half, c);
            (values(polynomial, origin[c]), slopes(polynomial))
        });
        for lane in 0..LANES {
            sums[lane] += x.0[lane] * y.1[lane] - y.0[lane] * x.1[lane];
        }
    }
    0.5 * HALF_PIECE * Integral::of(&sums).value
}

/// `p(s) − origin` at all nodes.
fn values(polynomial: &[f64], origin: f64) -> Lanes {
    let nodes = &RULES.0;
    let mut sums = [0.0; LANES];
    for (term, &coefficient) in polynomial.iter().enumerate().rev() {
        let coefficient = if term == 0 { coefficient - origin } else { coefficient };
        for lane in 0..LANES {
            sums[lane] = sums[lane] * nodes[lane] + coefficient;
        }
    }
    sums
}

/// `dp/dt` at all nodes.
fn slopes(polynomial: &[f64]) -> Lanes {
    let nodes = &RULES.0;
    let mut sums = [0.0; LANES];
    for (term, &coefficient) in polynomial.iter().enumerate().skip(1).rev() {
        let coefficient = term as f64 * coefficient / HALF_PIECE;
        for lane in 0..LANES {
            sums[lane] = sums[lane] * nodes[lane] + coefficient;
        }
    }
    sums
}
