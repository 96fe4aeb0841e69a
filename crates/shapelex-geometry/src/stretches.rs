//! Bounds of the stretches of a planar curve: boxes and cones of tangents, for every half-segment and for a binary tree of them.

use super::columns::{Columns, LANES, Lanes, place};
use super::cone::Cone;
use shapelex_numeric::lanes::vectorised;

/// Part of the curve, with bounds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    /// In units of half-segments.
    pub(crate) start: f64,
    pub(crate) end: f64,
    pub(crate) low: [f64; 2],
    pub(crate) high: [f64; 2],
    /// Directions of the tangents.
    pub(crate) tangents: Cone,
    /// Both parts, if it consists of several half-segments.
    pub(crate) parts: Option<[usize; 2]>,
}

/// Stretches of whole half-segments: every one after its parts, the whole curve last.
pub(crate) struct Tree {
    pub(crate) stretches: Vec<Stretch>,
    /// Bounds of the half-segments, block by block.
    bounds: Vec<BlockBounds>,
}

impl Tree {
    /// The stretches of `curve`.
    pub(crate) fn of(curve: &Columns) -> Self {
        let halves = curve.halves();
        let mut bounds = vec![BlockBounds::EMPTY; curve.blocks().len()];
        vectorised(
            #[inline(always)]
            || {
                for (bounds, block) in bounds.iter_mut().zip(curve.blocks()) {
                    bounds.set(block, curve.terms());
                }
            },
        );
        let mut tree = Self { stretches: Vec::with_capacity(2 * halves), bounds };
        tree.grow(0, halves);
        tree
    }

    /// Adds the stretch of some half-segments, and returns its position.
    fn grow(&mut self, start: usize, end: usize) -> usize {
        let stretch = if end - start == 1 {
            let (block, lane) = place(start);
            self.bounds[block].stretch(lane, start as f64)
        } else {
            let middle = (start + end).div_ceil(2);
            let parts = [self.grow(start, middle), self.grow(middle, end)];
            let [first, second] = parts.map(|part| &self.stretches[part]);
            Stretch { parts: Some(parts), ..join(first, second) }
        };
        self.stretches.push(stretch);
        self.stretches.len() - 1
    }
}

/// Bounds of the half-segments of a block.
#[derive(Clone)]
struct BlockBounds {
    low: [Lanes; 2],
    high: [Lanes; 2],
    slope: [Lanes; 2],
    bend: [Lanes; 2],
}

impl BlockBounds {
    const EMPTY: Self = {
        let zeros = [[0.0; LANES]; 2];
        Self { low: zeros, high: zeros, slope: zeros, bend: zeros }
    };

    /// `r = Σ r_m s^m` is within `Σ_{m≥1} |r_m|` of `r_0`, and its tangent within `Σ_{m≥2} m |r_m|` of `r_1`.
    #[inline(always)]
    fn set(&mut self, block: &[Lanes], terms: usize) {
        for (c, polynomial) in block.chunks_exact(terms).take(2).enumerate() {
            let (mut reach, mut bend) = ([0.0; LANES], [0.0; LANES]);
            for (m, column) in polynomial.iter().enumerate().skip(1) {
                let factor = if m > 1 { m as f64 } else { 0.0 };
                for lane in 0..LANES {
                    reach[lane] += column[lane].abs();
                    bend[lane] += factor * column[lane].abs();
                }
            }
            for lane in 0..LANES {
                self.low[c][lane] = polynomial[0][lane] - reach[lane];
                self.high[c][lane] = polynomial[0][lane] + reach[lane];
            }
            self.slope[c] = polynomial.get(1).copied().unwrap_or_default();
            self.bend[c] = bend;
        }
    }

    /// The half-segment of a lane.
    fn stretch(&self, lane: usize, start: f64) -> Stretch {
        let of = |lanes: &[Lanes; 2]| [lanes[0][lane], lanes[1][lane]];
        let bend = of(&self.bend);
        Stretch {
            start,
            end: start + 1.0,
            low: of(&self.low),
            high: of(&self.high),
            tangents: Cone::around(of(&self.slope), length(bend)),
            parts: None,
        }
    }
}

/// Joint bounds of two consecutive stretches.
fn join(first: &Stretch, second: &Stretch) -> Stretch {
    Stretch {
        start: first.start,
        end: second.end,
        low: [0, 1].map(|c| first.low[c].min(second.low[c])),
        high: [0, 1].map(|c| first.high[c].max(second.high[c])),
        tangents: first.tangents.and(&second.tangents),
        parts: None,
    }
}

/// `|v|` of numbers near 1.
pub(crate) fn length(v: [f64; 2]) -> f64 {
    (v[0] * v[0] + v[1] * v[1]).sqrt()
}
