//! Sectors of directions in the plane.

/// Directions within less than half a turn, from `right` counter-clockwise to `left`, of any lengths. Both vanish if the directions
/// have no such bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cone {
    left: [f64; 2],
    right: [f64; 2],
}

/// Sine of the angle by which a sector must be less than half a turn: the rounding of its edges.
const ROUNDING: f64 = 1e-14;

impl Cone {
    /// All directions.
    pub(crate) const ALL: Self = Self { left: [0.0; 2], right: [0.0; 2] };

    /// The directions of `v + w`, `|w| ≤ deviation`.
    ///
    /// ```text
    /// sin β = deviation / |v|,   edges v cos β ± v⊥ sin β, times |v|
    /// ```
    #[inline(always)]
    pub(crate) fn around(v: [f64; 2], deviation: f64) -> Self {
        let rest = v[0] * v[0] + v[1] * v[1] - deviation * deviation;
        let (along, across) = if rest > 0.0 { (rest.sqrt(), deviation) } else { (0.0, 0.0) };
        let edge = |across: f64| [v[0] * along - v[1] * across, v[1] * along + v[0] * across];
        Self { left: edge(across), right: edge(-across) }
    }

    /// Whether the directions lie within half a turn.
    #[inline]
    pub(crate) fn is_bounded(&self) -> bool {
        self.left != [0.0; 2]
    }

    /// The directions of both; [`Self::ALL`] if they do not lie within half a turn.
    #[inline]
    pub(crate) fn and(&self, other: &Self) -> Self {
        let left = if cross(self.left, other.left) > 0.0 { other.left } else { self.left };
        let right = if cross(self.right, other.right) < 0.0 { other.right } else { self.right };
        let width = cross(right, left);
        // Edges that are opposite up to rounding bound no sector.
        let along = dot(right, left);
        let is_sector = if along > 0.0 { width >= 0.0 } else { width > ROUNDING * -along };
        // Less than a right angle from one of the edges: an opposite direction has the same cross products as one along them.
        let is_ahead = |v: [f64; 2]| dot(right, v) > 0.0 || dot(v, left) > 0.0;
        let holds = |v: [f64; 2]| cross(right, v) >= 0.0 && cross(v, left) >= 0.0 && is_ahead(v);
        let joins = [self.left, self.right, other.left, other.right].into_iter().all(holds);
        if is_sector && joins && self.is_bounded() && other.is_bounded() {
            Self { left, right }
        } else {
            Self::ALL
        }
    }
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn around(degrees: f64, spread: f64) -> Cone {
        let (sin, cos) = degrees.to_radians().sin_cos();
        Cone::around([3.0 * cos, 3.0 * sin], 3.0 * spread.to_radians().sin())
    }

    #[test]
    fn cones_join_up_to_half_a_turn() {
        for turn in [0.0, 17.0, 90.0, 133.0, 180.0, 270.0, 301.0] {
            for (apart, spread, is_bounded) in [
                (0.0, 0.0, true),
                (30.0, 10.0, true),
                (159.0, 10.0, true),
                (161.0, 10.0, false),
                (180.0, 0.0, false),
            ] {
                for apart in [apart, -apart] {
                    let joined = around(turn, spread).and(&around(turn + apart, spread));
                    assert_eq!(joined.is_bounded(), is_bounded, "{turn}° and {apart}° further, ±{spread}°");
                }
            }
        }
    }

    /// Three sectors of 100° that cover all directions, and the two of them that do not.
    #[test]
    fn a_full_turn_is_no_cone() {
        let [a, b, c] = [0.0, 120.0, 240.0].map(|degrees| around(degrees, 50.0));
        assert!(!a.and(&b).is_bounded() && !a.and(&b).and(&c).is_bounded());
        assert!(around(0.0, 20.0).and(&around(120.0, 20.0)).is_bounded());
    }

    #[test]
    fn what_has_no_direction_has_no_bound() {
        assert_eq!(Cone::around([0.0; 2], 0.0), Cone::ALL);
        assert_eq!(Cone::around([1.0, 0.0], 1.0), Cone::ALL);
        let east = Cone::around([1.0, 0.0], 0.0);
        assert!(
            east.is_bounded() && !east.and(&Cone::ALL).is_bounded() && !Cone::ALL.and(&east).is_bounded()
        );
        assert_eq!(east.and(&east), east);
    }
}
