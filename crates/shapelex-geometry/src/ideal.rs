//! Idealised curves, and the poles that a generator needs to contain them.
//!
//! ```text
//! circle, ellipse    (a cos 2πu, b sin 2πu)                     0, ±2πj
//! line               p + u (q − p)                              0, 0
//! parabola           (x, x²/4f),  x = e(2u − 1)                 0, 0, 0
//! hyperbola branch   (a cosh s, b sinh s),  s = e(2u − 1)       ±2e  (and 0 away from the origin)
//! Lissajous          (a sin(2πmu + δ), b sin 2πnu)              ±2πmj, ±2πnj  (and 0 away from the origin)
//! ```
//!
//! A curve in the null space of `L_α` is reproduced from its samples at the knots: the control points are those that
//! interpolate them.

use std::f64::consts::TAU;

use super::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// An idealised plane curve about the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "name", rename_all = "snake_case", deny_unknown_fields))]
pub enum IdealCurve {
    /// A circle, counter-clockwise from `(radius, 0)`.
    Circle {
        /// Radius.
        radius: f64,
    },
    /// An ellipse, counter-clockwise from `(a, 0)`.
    Ellipse {
        /// `a` along x and `b` along y.
        semi_axes: [f64; 2],
    },
    /// A straight line.
    Line {
        /// Its start.
        from: [f64; 2],
        /// Its end.
        to: [f64; 2],
    },
    /// The parabola `y = x²/(4f)` with its vertex at the origin, from `−extent` to `extent`.
    Parabola {
        /// `f`, distance of the focus from the vertex.
        focal_length: f64,
        /// Largest `x`.
        extent: f64,
    },
    /// The branch `(a cosh s, b sinh s)` of a hyperbola, `s` from `−extent` to `extent`.
    Hyperbola {
        /// `a` along x and `b` along y.
        semi_axes: [f64; 2],
        /// Largest `s`.
        extent: f64,
    },
    /// The Lissajous figure `(a sin(2πmu + δ), b sin 2πnu)`.
    Lissajous {
        /// `a` and `b`.
        amplitudes: [f64; 2],
        /// `m` and `n`, periods per turn.
        frequencies: [u16; 2],
        /// `δ` in radians.
        phase: f64,
    },
}

/// Where an idealised curve lies: turned by `angle` about the origin, then moved.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Position {
    /// Where the origin goes.
    pub centre: [f64; 2],
    /// In radians, counter-clockwise.
    pub angle: f64,
}

/// Two poles of the grid that differ by less than this part are equal: the curve errs by as much.
const SAME_POLE: f64 = 1e-12;

impl IdealCurve {
    /// One of each, for the catalogue.
    pub fn catalogue() -> Vec<Self> {
        vec![
            Self::Circle { radius: 1.0 },
            Self::Ellipse { semi_axes: [2.0, 1.0] },
            Self::Line { from: [0.0, 0.0], to: [1.0, 1.0] },
            Self::Parabola { focal_length: 0.25, extent: 1.0 },
            Self::Hyperbola { semi_axes: [1.0, 1.0], extent: 1.0 },
            Self::Lissajous { amplitudes: [1.0, 1.0], frequencies: [1, 2], phase: 0.0 },
        ]
    }

    /// Whether it closes, and so fits on a closed curve.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Circle { .. } | Self::Ellipse { .. } | Self::Lissajous { .. })
    }

    /// What is wrong with the parameters.
    pub fn fault(&self) -> Option<&'static str> {
        let positive = |values: &[f64]| values.iter().all(|value| *value > 0.0 && *value <= 1e100);
        let finite = |values: &[f64]| values.iter().all(|value| value.abs() <= 1e100);
        match self {
            Self::Circle { radius } if !positive(&[*radius]) => Some("needs a positive radius up to 1e100"),
            Self::Ellipse { semi_axes } if !positive(semi_axes) => {
                Some("needs positive semi-axes up to 1e100")
            }
            Self::Line { from, to } if from == to || !finite(from) || !finite(to) => {
                Some("needs two different points within ±1e100")
            }
            Self::Parabola { focal_length, extent } if !positive(&[*focal_length, *extent]) => {
                Some("needs a positive focal length and extent up to 1e100")
            }
            Self::Hyperbola { semi_axes, extent }
                if !positive(semi_axes) || !positive(&[*extent]) || *extent > 100.0 =>
            {
                Some("needs positive semi-axes up to 1e100 and a positive extent up to 100")
            }
            Self::Lissajous { amplitudes, frequencies, phase }
                if !positive(amplitudes) || frequencies.contains(&0) || !finite(&[*phase]) =>
            {
                Some("needs positive amplitudes up to 1e100, positive frequencies, and a phase within ±1e100")
            }
            _ => None,
        }
    }

    /// The point at `u`.
    pub fn at(&self, u: f64) -> [f64; 2] {
        // At multiples of a quarter turn exactly, elsewhere to an ulp of the angle.
        let turn = |turns: f64| (TAU * (turns - turns.floor())).sin_cos();
        match *self {
            Self::Circle { radius } => {
                let (s, c) = turn(u);
                [radius * c, radius * s]
            }
            Self::Ellipse { semi_axes: [a, b] } => {
                let (s, c) = turn(u);
                [a * c, b * s]
            }
            Self::Line { from, to } => [0, 1].map(|i| from[i] + u * (to[i] - from[i])),
            Self::Parabola { focal_length, extent } => {
                let x = extent * (2.0 * u - 1.0);
                [x, x * x / (4.0 * focal_length)]
            }
            Self::Hyperbola { semi_axes: [a, b], extent } => {
                let s = extent * (2.0 * u - 1.0);
                [a * s.cosh(), b * s.sinh()]
            }
            Self::Lissajous { amplitudes: [a, b], frequencies: [m, n], phase } => {
                let x = turn(f64::from(m) * u);
                [a * (x.0 * phase.cos() + x.1 * phase.sin()), b * turn(f64::from(n) * u).0]
            }
        }
    }

    /// Poles of the domain `u ∈ [0, 1]` whose functions it is made of, one of every pair.
    fn needed(&self, position: &Position) -> Vec<([f64; 2], usize)> {
        let mut needed = match *self {
            Self::Circle { .. } | Self::Ellipse { .. } => vec![([0.0, TAU], 1)],
            Self::Line { .. } => vec![([0.0, 0.0], 2)],
            Self::Parabola { .. } => vec![([0.0, 0.0], 3)],
            Self::Hyperbola { extent, .. } => vec![([2.0 * extent, 0.0], 1)],
            Self::Lissajous { frequencies: [m, n], .. } if m == n => vec![([0.0, TAU * f64::from(m)], 1)],
            Self::Lissajous { frequencies, .. } => {
                frequencies.iter().map(|&f| ([0.0, TAU * f64::from(f)], 1)).collect()
            }
        };
        if position.centre != [0.0, 0.0] && needed.iter().all(|(pole, _)| *pole != [0.0, 0.0]) {
            needed.insert(0, ([0.0, 0.0], 1));
        }
        needed
    }

    /// The poles of the domain that a generator needs to contain the curve.
    pub fn domain_poles(&self, position: &Position) -> Vec<[f64; 2]> {
        let pair = |(pole, times): ([f64; 2], usize)| match pole {
            [0.0, 0.0] => vec![pole; times],
            [re, im] => vec![pole, [-re + 0.0, -im + 0.0]],
        };
        self.needed(position).into_iter().flat_map(pair).collect()
    }

    /// Poles of the domain that the generator of `space` lacks, each with the multiplicity that is needed; empty when
    /// the curve is reproduced.
    pub fn missing(&self, position: &Position, space: &ShapeSpace) -> Vec<([f64; 2], usize)> {
        let intervals = space.representation().count() as f64;
        let present = space.line().expect("curves have a line").poles().list();
        let count = |pole: [f64; 2]| {
            let near = |a: f64, b: f64| (a - b).abs() <= SAME_POLE * (1.0 + b.abs());
            present
                .iter()
                .filter(|p| near(p[0], pole[0] / intervals) && near(p[1], pole[1] / intervals))
                .count()
        };
        self.needed(position).into_iter().filter(|(pole, times)| count(*pole) < *times).collect()
    }

    /// Control points in `space`, `N × d`; exact when nothing is [`Self::missing`]. In space the curve lies in `z = 0`.
    pub fn control_points(&self, position: &Position, space: &ShapeSpace) -> Matrix {
        let representation = space.representation();
        let (count, intervals) = (representation.point_count(), representation.count());
        let (sine, cosine) = position.angle.sin_cos();
        let mut points = Matrix::zeros(count, representation.dimension());
        for k in 0..count {
            let [x, y] = self.at(k as f64 / intervals as f64);
            points[(k, 0)] = cosine * x - sine * y + position.centre[0];
            points[(k, 1)] = sine * x + cosine * y + position.centre[1];
        }
        space.interpolate(points).expect("curves pass through their points")
    }
}
