//! Value, rotation and refinement of a path, strip by strip, exactly.
//!
//! Places on the second curve are counted in its segments: `τ = M t`, so that `M √(g_i / M) = √(∫ (w⁺)² dτ)`.

use shapelex_numeric::dense::Matrix;

use super::curve::Level;
use super::{IDENTITY, Rotation};
use crate::fit::nearest_rotation;

/// Part of a segment for each node of a move that is tried.
const TRIED: f64 = 0.1;

/// Two curves at one resolution, with the weights of their pair. A path has `M + 1` places on the second curve.
pub(super) struct Strips<'a> {
    /// Square-root velocities of the first curve, or of a template.
    pub(super) first: &'a [[f32; 4]],
    pub(super) second: &'a Level,
    pub(super) elasticity: f64,
    pub(super) closed: bool,
    /// Whether rotations are removed.
    pub(super) turns: bool,
}

/// Sums over a path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums {
    /// `F`.
    pub(super) value: f64,
    /// `∫ √γ' u_a u_bᵀ`.
    outer: Rotation,
    /// `∫ √γ'`, times the last coordinate of a template.
    plain: f64,
}

/// Integrals over a part of a strip.
#[derive(Debug, Clone, Copy, Default)]
struct Part {
    /// `∫ (w⁺)²`.
    square: f64,
    /// `∫ w⁺ (u_b, 1)`.
    along: [f64; 4],
}

impl Strips<'_> {
    /// `M`.
    pub(super) fn count(&self) -> usize {
        self.second.count
    }

    fn dimension(&self) -> usize {
        self.second.dimension()
    }

    /// `ε Oᵀ u_a` and `1 − ε` of strip `i`: the product with a tangent and 1 is the weight.
    pub(super) fn turned(&self, i: usize, rotation: &Rotation) -> [f64; 4] {
        let mut turned = [0.0; 4];
        let own = self.first[i].map(f64::from);
        for r in 0..3 {
            (0..3).for_each(|c| turned[c] += self.elasticity * rotation[r][c] * own[r]);
        }
        turned[3] = (1.0 - self.elasticity) * own[3];
        turned
    }

    /// Square-root velocity of the second curve on segment `j`, which may lie beyond its ends.
    fn tangent(&self, j: isize) -> [f64; 4] {
        let count = self.count() as isize;
        // Paths begin in the first turn: a division is seldom needed.
        let at = if j >= count { j - count } else { j };
        let at = if (0..count).contains(&at) { at } else { at.rem_euclid(count) } as usize;
        self.second.rows[at].map(f64::from)
    }

    /// `w` of a turned tangent and a segment.
    fn weight(turned: &[f64; 4], tangent: &[f64; 4]) -> f64 {
        turned[0] * tangent[0] + turned[1] * tangent[1] + turned[2] * tangent[2] + turned[3]
    }

    fn part(&self, turned: &[f64; 4], [from, to]: [f64; 2]) -> Part {
        let mut part = Part::default();
        for (j, [a, b]) in pieces(from, to) {
            let tangent = self.tangent(j);
            let w = Self::weight(turned, &tangent);
            if w > 0.0 {
                let amount = w * (b - a);
                part.square += w * amount;
                (0..4).for_each(|c| part.along[c] += amount * tangent[c]);
            }
        }
        part
    }

    /// Sums over a path under a rotation.
    pub(super) fn sums(&self, path: &[f64], rotation: &Rotation) -> Sums {
        let count = self.count();
        let scale = count as f64;
        let mut sums = Sums { value: 0.0, outer: [[0.0; 3]; 3], plain: 0.0 };
        for i in 0..count {
            let part = self.part(&self.turned(i, rotation), [scale * path[i], scale * path[i + 1]]);
            let root = part.square.sqrt();
            if root > 0.0 {
                sums.value += root;
                let inverse = root.recip();
                let own = self.first[i].map(|x| f64::from(x) * inverse);
                sums.plain += own[3] * part.along[3];
                for r in 0..3 {
                    (0..3).for_each(|c| sums.outer[r][c] += own[r] * part.along[c]);
                }
            }
        }
        sums.value /= scale;
        sums.plain /= scale;
        sums.outer.iter_mut().flatten().for_each(|x| *x /= scale);
        sums
    }

    /// `(O ∫ w⁺ u_b, ∫ w⁺) / √(g_i / M)` of every strip, the average of the square-root velocity of the second curve along a path: the template
    /// whose product with it is largest.
    pub(super) fn averages(&self, path: &[f64], rotation: &Rotation) -> Vec<[f64; 4]> {
        let scale = self.count() as f64;
        let average = |i: usize| {
            let part = self.part(&self.turned(i, rotation), [scale * path[i], scale * path[i + 1]]);
            let inverse = if part.square > 0.0 { part.square.sqrt().recip() } else { 0.0 };
            let along = part.along.map(|x| x * inverse);
            let turned = [0, 1, 2].map(|r| (0..3).map(|c| rotation[r][c] * along[c]).sum());
            [turned[0], turned[1], turned[2], along[3]]
        };
        (0..self.count()).map(average).collect()
    }

    /// The best rotation for a path that has these sums, and the value of the path under it, at least.
    pub(super) fn rotation(&self, sums: &Sums) -> (Rotation, f64) {
        let (rotation, most) = self.best_rotation(&sums.outer);
        let value = self.elasticity * most + (1.0 - self.elasticity) * sums.plain;
        (rotation, value.max(sums.value))
    }

    /// The rotation that maximises `tr(OᵀH)`, and the maximum.
    pub(super) fn best_rotation(&self, h: &Rotation) -> (Rotation, f64) {
        let d = self.dimension();
        let mut rotation = IDENTITY;
        if !self.turns {
            return (rotation, (0..d).map(|c| h[c][c]).sum());
        }
        if d == 2 {
            let (c, s) = (h[0][0] + h[1][1], h[1][0] - h[0][1]);
            let most = (c * c + s * s).sqrt();
            if most > 0.0 {
                rotation[0][..2].copy_from_slice(&[c / most, -s / most]);
                rotation[1][..2].copy_from_slice(&[s / most, c / most]);
            }
            return (rotation, most);
        }
        let found = nearest_rotation(&Matrix::from_fn(d, d, |r, c| h[r][c]));
        let mut most = 0.0;
        for r in 0..d {
            for c in 0..d {
                rotation[r][c] = found[(r, c)];
                most += found[(r, c)] * h[r][c];
            }
        }
        (rotation, most)
    }

    /// Moves every second place of a path to its best position between its neighbours, then the others. The value never decreases.
    pub(super) fn refine(&self, path: &mut [f64], rotation: &Rotation) {
        let count = self.count();
        let scale = count as f64;
        let turned: Vec<[f64; 4]> = (0..count).map(|i| self.turned(i, rotation)).collect();
        let first = if self.closed { 0 } else { 1 };
        for parity in 0..2 {
            for i in (first..count).filter(|i| i % 2 == parity) {
                let (strip, before) = match i {
                    0 => (count - 1, path[count - 1] - 1.0),
                    _ => (i - 1, path[i - 1]),
                };
                let ends = [scale * before, scale * path[i + 1]];
                path[i] = self.best_between([&turned[strip], &turned[i]], ends) / scale;
                if i == 0 {
                    path[count] = path[0] + 1.0;
                }
            }
        }
    }

    /// Moves the places around every `spacing`-th one, those beside it less, where that raises the value: steps that are alike over many
    /// strips become even. The value never decreases.
    pub(super) fn relax(&self, path: &mut [f64], rotation: &Rotation, spacing: usize) {
        let count = self.count();
        let turned: Vec<[f64; 4]> = (0..count).map(|i| self.turned(i, rotation)).collect();
        let mut places = vec![0.0; 2 * spacing + 1];
        let middles = if self.closed { 0..count } else { spacing..count.saturating_sub(spacing) + 1 };
        for middle in middles.step_by(spacing) {
            // Strips and nodes from `first` on, in the turn after the first one.
            let first = middle + count - spacing;
            let node = |k: usize| path[(first + k) % count] + ((first + k) / count) as f64 - 1.0;
            let node = |k: usize| if self.closed || first + k < 2 * count { node(k) } else { 1.0 };
            places.iter_mut().enumerate().for_each(|(k, place)| *place = count as f64 * node(k));
            let found = self.best_move(&places, |k| &turned[(first + k) % count]);
            for k in 1..2 * spacing {
                let (at, turns) = ((first + k) % count, ((first + k) / count) as f64 - 1.0);
                path[at] = (places[k] + found * share(k, spacing)) / count as f64 - turns;
            }
            if self.closed {
                path[count] = path[0] + 1.0;
            }
        }
    }

    /// The move of the middle of some places that raises their value most, of a parabola through three of them.
    fn best_move<'t>(&self, places: &[f64], turned: impl Fn(usize) -> &'t [f64; 4]) -> f64 {
        let spacing = places.len() / 2;
        let value = |by: f64| -> f64 {
            let at = |k: usize| places[k] + by * share(k, spacing);
            (0..2 * spacing).map(|k| self.part(turned(k), [at(k), at(k + 1)]).square.sqrt()).sum()
        };
        // Steps remain positive.
        let least = |steps: std::ops::Range<usize>| {
            let step = |k: usize| places[k + 1] - places[k];
            spacing as f64 * steps.map(step).fold(f64::INFINITY, f64::min)
        };
        let (down, up) = (0.5 * least(0..spacing), 0.5 * least(spacing..2 * spacing));
        let by = down.min(up).min(TRIED * spacing as f64);
        if !(by > 0.0) {
            return 0.0;
        }
        let [low, now, high] = [-by, 0.0, by].map(value);
        let bend = low + high - 2.0 * now;
        let vertex = if bend < 0.0 { (0.5 * by * (low - high) / bend).clamp(-down, up) } else { 0.0 };
        let tried = [(value(vertex), vertex), (low, -by), (high, by)];
        tried.into_iter().fold((now, 0.0), |best, next| if next.0 > best.0 { next } else { best }).1
    }

    /// The place between `from` and `to` where the roots of the integrals of the strips on both sides have the largest sum.
    fn best_between(&self, turned: [&[f64; 4]; 2], [from, to]: [f64; 2]) -> f64 {
        let (mut left, mut right) = (0.0, self.part(turned[1], [from, to]).square);
        let value = |left: f64, right: f64| left.sqrt() + right.max(0.0).sqrt();
        let mut best = (f64::NEG_INFINITY, from);
        for (j, [a, b]) in pieces(from, to) {
            let tangent = self.tangent(j);
            let [p, q] = turned.map(|turned| Self::weight(turned, &tangent).max(0.0).powi(2));
            // The stationary place; without `p` it is the beginning, without `q` the end.
            let wanted = if p == 0.0 {
                0.0
            } else if q == 0.0 {
                b - a
            } else {
                (p * p * right - q * q * left) / (p * q * (p + q))
            };
            let y = wanted.clamp(0.0, b - a);
            let found = value(left + p * y, right - q * y);
            if found > best.0 {
                best = (found, a + y);
            }
            left += p * (b - a);
            right -= q * (b - a);
        }
        best.1
    }
}

/// Share of a move that node `k` of `2 · spacing` takes.
fn share(k: usize, spacing: usize) -> f64 {
    1.0 - k.abs_diff(spacing) as f64 / spacing as f64
}

/// The segments between two places, each with its part.
fn pieces(from: f64, to: f64) -> impl Iterator<Item = (isize, [f64; 2])> {
    // Towards zero, and one more on either side: pieces without length are left out.
    let (first, last) = (from as isize - isize::from(from < 0.0), to as isize + 1);
    (first..last).map(move |j| (j, [from.max(j as f64), to.min((j + 1) as f64)])).filter(|(_, [a, b])| b > a)
}
