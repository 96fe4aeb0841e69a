//! How the two curves of a pair are laid: the first may be mirrored and reversed.

use super::Rotation;
use super::curve::Level;

/// A way to lay a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Way {
    /// Whether the first coordinate is negated.
    pub(super) mirrored: bool,
    /// Whether it is traversed backwards.
    pub(super) reversed: bool,
}

/// A path from the first curve, laid in some way, to the second one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) way: Way,
    pub(super) rotation: Rotation,
    /// `M + 1` places on the second curve, as fractions of its length.
    pub(super) path: Vec<f64>,
    /// `F`.
    pub(super) value: f64,
}

impl Way {
    /// Square-root velocities of the segments of a curve that is laid in this way.
    pub(super) fn lay(self, level: &Level) -> Vec<[f32; 4]> {
        let signs = [0, 1, 2].map(|c| self.sign(c));
        let mut rows = level.rows.clone();
        rows.iter_mut().for_each(|row| (0..3).for_each(|c| row[c] *= signs[c]));
        if self.reversed {
            rows.reverse();
        }
        rows
    }

    /// Factor of coordinate `c` of tangents.
    fn sign(self, c: usize) -> f32 {
        if (self.mirrored && c == 0) != self.reversed { -1.0 } else { 1.0 }
    }
}

impl Found {
    /// The same match from the second curve, laid in that way, to the first one.
    pub(super) fn swapped(&self, closed: bool) -> Self {
        let (mut path, mut rotation) = (inverse(&self.path), self.rotation);
        (0..3).for_each(|r| (0..3).for_each(|c| rotation[r][c] = self.rotation[c][r]));
        let other = Self { path: std::mem::take(&mut path), rotation, ..self.clone() };
        other.laid(closed)
    }

    /// The same match with both curves laid in its way: from the first curve as it is to the second one laid.
    pub(super) fn laid(mut self, closed: bool) -> Self {
        if self.way.reversed {
            self.path = self.path.iter().rev().map(|t| 1.0 - t).collect();
        }
        if closed {
            let turns = self.path[0].floor();
            self.path.iter_mut().for_each(|t| *t -= turns);
        }
        if self.way.mirrored {
            (0..3).filter(|&c| c != 0).for_each(|c| {
                self.rotation[0][c] = -self.rotation[0][c];
                self.rotation[c][0] = -self.rotation[c][0];
            });
        }
        self
    }
}

/// The inverse of a path that rises by 1, at as many places from 0 to 1. Where the path jumps, the inverse stays.
pub(super) fn inverse(path: &[f64]) -> Vec<f64> {
    let count = path.len() - 1;
    let at = |t: f64| {
        // The turn of the path that holds the place.
        let turns = (t - path[0]).floor();
        let wanted = t - turns;
        let k = path.partition_point(|&end| end <= wanted).clamp(1, count) - 1;
        let step = path[k + 1] - path[k];
        let part = if step > 0.0 { ((wanted - path[k]) / step).clamp(0.0, 1.0) } else { 0.0 };
        (k as f64 + part) / count as f64 + turns
    };
    let mut found: Vec<f64> = (0..count).map(|i| at(i as f64 / count as f64)).collect();
    found.push(found[0] + 1.0);
    found
}

/// A path at the places of another one, which rises from 0 to 1; linear between places.
pub(super) fn composed(path: &[f64], inner: &[f64]) -> Vec<f64> {
    let last = path.len() - 1;
    let at = |s: f64| {
        let place = s.clamp(0.0, 1.0) * last as f64;
        let k = (place as usize).min(last - 1);
        path[k] + (place - k as f64) * (path[k + 1] - path[k])
    };
    inner.iter().map(|&s| at(s)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inverse_of_an_inverse_is_the_path() {
        let warp = |t: f64| t + 0.3 + 0.1 * (std::f64::consts::TAU * t).sin();
        let path: Vec<f64> = (0..=200).map(|i| warp(f64::from(i) / 200.0)).collect();
        let twice = inverse(&inverse(&path));
        for (one, two) in path.iter().zip(&twice) {
            let apart = (one - two).rem_euclid(1.0);
            assert!(apart.min(1.0 - apart) < 1e-3, "{one} {two}");
        }
    }

    #[test]
    fn a_match_that_is_swapped_twice_is_the_match() {
        let path: Vec<f64> =
            (0..=100).map(|i| f64::from(i) / 100.0 + 0.2 + 0.05 * (0.0628 * f64::from(i)).sin()).collect();
        let path: Vec<f64> = path.iter().take(100).copied().chain([path[0] + 1.0]).collect();
        let rotation = [[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]];
        for (mirrored, reversed) in [(false, false), (true, true), (true, false), (false, true)] {
            let way = Way { mirrored, reversed };
            let found = Found { way, rotation, path: path.clone(), value: 0.5 };
            let twice = found.swapped(true).swapped(true);
            assert_eq!(twice.rotation, rotation, "{way:?}");
            for (one, two) in path.iter().zip(&twice.path) {
                assert!((one - two).abs() < 2e-3, "{way:?}: {one} {two}");
            }
        }
    }
}
