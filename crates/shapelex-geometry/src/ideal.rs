//! Idealised curves, and the poles with which a generator contains them.
//!
//! ```text
//! circle, ellipse    (a cos 2πu, b sin 2πu)                     0, ±2πj
//! line               p + u (q − p)                              0, 0
//! parabola           (x, x²/4f),  x = e(2u − 1)                 0, 0, 0
//! hyperbola branch   (a cosh s, b sinh s),  s = e(2u − 1)       ±2e  (and 0 away from the origin)
//! Lissajous          (a sin(2πmu + δ), b sin 2πnu)              ±2πmj, ±2πnj  (and 0 away from the origin)
//! ```
//!
//! A curve in the null space of `L_α` is reproduced from its samples at the knots: its control points interpolate the
//! samples.

use std::f64::consts::TAU;

use super::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Idealised plane curve about the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "name", rename_all = "snake_case", deny_unknown_fields))]
pub enum IdealCurve {
    /// A circle, counter-clockwise from `(radius, 0)`.
    Circle {
        /// Radius of the circle.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
    },
    /// An ellipse, counter-clockwise from `(a, 0)`.
    Ellipse {
        /// Semi-axes: `a` along x and `b` along y.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        semi_axes: [f64; 2],
    },
    /// A straight line.
    Line {
        /// Start point.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        from: [f64; 2],
        /// End point.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        to: [f64; 2],
    },
    /// The parabola `y = x²/(4f)` with its vertex at the origin, from `−extent` to `extent`.
    Parabola {
        /// Focal length `f`: distance of the focus from the vertex.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        focal_length: f64,
        /// Largest `x`.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        extent: f64,
    },
    /// The branch `(a cosh s, b sinh s)` of a hyperbola, `s` from `−extent` to `extent`.
    Hyperbola {
        /// Semi-axes: `a` along x and `b` along y.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        semi_axes: [f64; 2],
        /// Largest `s`.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        extent: f64,
    },
    /// The Lissajous figure `(a sin(2πmu + δ), b sin 2πnu)`.
    Lissajous {
        /// Amplitudes `a` and `b`.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        amplitudes: [f64; 2],
        /// Frequencies `m` and `n`: periods per turn.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        frequencies: [u16; 2],
        /// Phase `δ` in radians.
        phase: f64,
    },
}

/// Placement of an idealised curve: rotation by `angle` about the origin, then translation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Position {
    /// New position of the origin.
    pub centre: [f64; 2],
    /// Angle in radians, counter-clockwise.
    pub angle: f64,
}

/// Relative difference below which two poles on the grid are equal; the error of the curve is of the same size.
const SAME_POLE: f64 = 1e-12;

impl IdealCurve {
    /// One curve of each kind, for the catalogue.
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

    /// Whether the curve is closed, so that a closed curve can represent it.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Circle { .. } | Self::Ellipse { .. } | Self::Lissajous { .. })
    }

    /// Error in the parameters, if any.
    pub fn fault(&self) -> Option<&'static str> {
        let positive = |values: &[f64]| values.iter().all(|value| *value > 0.0 && *value <= 1e100);
        let finite = |values: &[f64]| values.iter().all(|value| value.abs() <= 1e100);
        match self {
            Self::Circle { radius } if !positive(&[*radius]) => {
                Some("expected a positive radius up to 1e100")
            }
            Self::Ellipse { semi_axes } if !positive(semi_axes) => {
                Some("expected positive semi-axes up to 1e100")
            }
            Self::Line { from, to } if from == to || !finite(from) || !finite(to) => {
                Some("expected two different points within ±1e100")
            }
            Self::Parabola { focal_length, extent } if !positive(&[*focal_length, *extent]) => {
                Some("expected a positive focal length and extent up to 1e100")
            }
            Self::Hyperbola { semi_axes, extent }
                if !positive(semi_axes) || !positive(&[*extent]) || *extent > 100.0 =>
            {
                Some("expected positive semi-axes up to 1e100 and a positive extent up to 100")
            }
            Self::Lissajous { amplitudes, frequencies, phase }
                if !positive(amplitudes) || frequencies.contains(&0) || !finite(&[*phase]) =>
            {
                Some(
                    "expected positive amplitudes up to 1e100, positive frequencies, and a phase within ±1e100",
                )
            }
            _ => None,
        }
    }

    /// Point at parameter `u`.
    pub fn at(&self, u: f64) -> [f64; 2] {
        // Exact at multiples of a quarter turn; elsewhere to an ulp of the angle.
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

    /// Poles on the domain `u ∈ [0, 1]` of the functions that make up the curve, one of every pair, with multiplicity.
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

    /// Poles on the domain that a generator needs in order to contain the curve.
    pub fn domain_poles(&self, position: &Position) -> Vec<[f64; 2]> {
        let pair = |(pole, times): ([f64; 2], usize)| match pole {
            [0.0, 0.0] => vec![pole; times],
            [re, im] => vec![pole, [-re + 0.0, -im + 0.0]],
        };
        self.needed(position).into_iter().flat_map(pair).collect()
    }

    /// Poles on the domain that the generator of `space` lacks, each with the required multiplicity; empty if the curve is
    /// reproduced exactly.
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

    /// Control points in `space`, `N × d`; exact if no pole is [`Self::missing`]. In space, the curve lies in `z = 0`.
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
