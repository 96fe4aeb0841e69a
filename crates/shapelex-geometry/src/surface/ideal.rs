//! Idealised surfaces, and generators that contain them.
//!
//! ```text
//! sphere, ellipsoid       (a cos 2πu sin πv, b sin 2πu sin πv, c cos πv)                  0, ±2πj   ×   0, ±2πj (of the great circle)
//! cylinder                (r cos 2πu, r sin 2πu, h v)                                     0, ±2πj   ×   0, 0, 0
//! torus                   ((R + r cos 2πv) cos 2πu, (R + r cos 2πv) sin 2πu, r sin 2πv)   0, ±2πj   ×   0, ±2πj
//! Roman surface           r² (½ cos 2πu sin 4πv, ½ sin 2πu sin 4πv, ½ sin 4πu cos² 2πv)   0, ±2πj, ±4πj   ×   0, ±4πj
//! hyperbolic paraboloid   (a s cosh t, b s sinh t, h s²),  s = 2u − 1, t = 2v − 1         0, 0, 0   ×   0, ±2
//! figure 8                ρ = R + cos πu sin 2πv − sin πu sin 4πv,
//!                         (ρ cos 2πu, ρ sin 2πu, sin πu sin 2πv + cos πu sin 4πv)         0, ±πj, ±2πj, ±3πj   ×   0, ±2πj, ±4πj
//! helicoid                (s cos 2πu, s sin 2πu, h u),  s = r (2v − 1)                    0, 0, ±2πj   ×   0, 0, 0
//! pinched torus           ρ = R + r cos πu cos 2πv,
//!                         (ρ cos 2πu, ρ sin 2πu, r cos πu sin 2πv)                        0, ±πj, ±2πj, ±3πj   ×   0, ±2πj
//! ```
//!
//! The control points are the samples at the knots, from which phantoms and tangents follow. Every generator contains the
//! constants, so that a surface can be moved by its control points.
//!
//! Source: Schmitter, *Spline Shape Processing*, 6.2.4, 6.3.4 and 7.1–7.3; pole lists completed with 0 where it is missing.

use std::f64::consts::{PI, TAU};

use super::Topology;
use super::basis::{Extent, SurfaceBasis};
use super::seam::Seam;
use crate::GeometryError;
use crate::generator::{Family, GeneratorKind, PoleList};
use shapelex_numeric::dense::Matrix;

/// Idealised surface about the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "name", rename_all = "snake_case", deny_unknown_fields))]
pub enum IdealSurface {
    /// A sphere.
    Sphere {
        /// Radius of the sphere.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
    },
    /// An ellipsoid with its axes along x, y and z.
    Ellipsoid {
        /// Semi-axes along x, y and z.
        #[cfg_attr(feature = "schema", schema(min_items = 3, max_items = 3))]
        semi_axes: [f64; 3],
    },
    /// The lateral surface of a cylinder, starting at `z = 0`.
    Cylinder {
        /// Radius of the cylinder.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
        /// Height of the cylinder.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        height: f64,
    },
    /// A torus around the z axis.
    Torus {
        /// Radius `R` of the centre line of the tube.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        major_radius: f64,
        /// Radius `r` of the tube.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        minor_radius: f64,
    },
    /// Steiner's Roman surface: one-sided, with three double lines and six pinch points.
    Roman {
        /// Parameter `r`; the size of the surface is its square.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
    },
    /// A part of the hyperbolic paraboloid `x²/a² − y²/b² = z/h`.
    HyperbolicParaboloid {
        /// Parameters `a` and `b`.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        semi_axes: [f64; 2],
        /// Parameter `h`.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        height: f64,
    },
    /// The figure-8 immersion of the Klein bottle, which is one-sided.
    FigureEight {
        /// Radius `R` of the circle that the figure 8 follows; the figure 8 has size 1.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
    },
    /// One turn of a helicoid around the z axis.
    Helicoid {
        /// Half of the width.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        radius: f64,
        /// Height of one turn.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        height: f64,
    },
    /// A torus whose tube is pinched to a point at one place and turned inside out there.
    PinchedTorus {
        /// Radius `R` of the centre line of the tube.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        major_radius: f64,
        /// Radius `r` of the tube.
        #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
        minor_radius: f64,
    },
}

impl IdealSurface {
    /// One surface of each kind, for the catalogue.
    pub fn catalogue() -> Vec<Self> {
        vec![
            Self::Sphere { radius: 1.0 },
            Self::Ellipsoid { semi_axes: [3.0, 2.0, 1.0] },
            Self::Cylinder { radius: 1.0, height: 2.0 },
            Self::Torus { major_radius: 2.0, minor_radius: 0.7 },
            Self::Roman { radius: 1.0 },
            Self::HyperbolicParaboloid { semi_axes: [1.0, 1.0], height: 1.0 },
            Self::FigureEight { radius: 3.0 },
            Self::Helicoid { radius: 1.0, height: 1.0 },
            Self::PinchedTorus { major_radius: 2.0, minor_radius: 0.7 },
        ]
    }

    /// Error in the parameters, if any.
    pub fn fault(&self) -> Option<&'static str> {
        let (values, which): (&[f64], _) = match self {
            Self::Sphere { radius } | Self::Roman { radius } | Self::FigureEight { radius } => {
                (&[*radius], "expected a positive radius up to 1e30")
            }
            Self::Ellipsoid { semi_axes } => (semi_axes, "expected positive semi-axes up to 1e30"),
            Self::Cylinder { radius, height } | Self::Helicoid { radius, height } => {
                (&[*radius, *height], "expected a positive radius and height up to 1e30")
            }
            Self::Torus { major_radius, minor_radius }
            | Self::PinchedTorus { major_radius, minor_radius } => {
                (&[*major_radius, *minor_radius], "expected positive radii up to 1e30")
            }
            Self::HyperbolicParaboloid { semi_axes: [a, b], height } => {
                (&[*a, *b, *height], "expected positive semi-axes and a positive height up to 1e30")
            }
        };
        let positive = values.iter().all(|value| *value > 0.0 && *value <= 1e30);
        (!positive).then_some(which)
    }

    /// Topology and seam of the surface.
    pub fn topology(&self) -> (Topology, Seam) {
        match self {
            Self::Sphere { .. } | Self::Ellipsoid { .. } => (Topology::Sphere, Seam::Straight),
            Self::Cylinder { .. } => (Topology::Cylinder, Seam::Straight),
            Self::Torus { .. } | Self::Roman { .. } => (Topology::Torus, Seam::Straight),
            Self::HyperbolicParaboloid { .. } | Self::Helicoid { .. } => (Topology::Plane, Seam::Straight),
            Self::FigureEight { .. } => (Topology::Torus, Seam::Reflected),
            Self::PinchedTorus { .. } => (Topology::Torus, Seam::HalfTurn),
        }
    }

    /// Generators that contain the surface.
    pub fn generators(&self) -> [GeneratorKind; 2] {
        let circle = GeneratorKind::Trigonometric {};
        let quadratic = GeneratorKind::Cubic {};
        let halves = || harmonics(&[PI, TAU, 3.0 * PI]);
        match self {
            Self::Sphere { .. } | Self::Ellipsoid { .. } | Self::Torus { .. } => [circle.clone(), circle],
            Self::Cylinder { .. } => [circle, quadratic],
            Self::Roman { .. } => [harmonics(&[TAU, 2.0 * TAU]), harmonics(&[2.0 * TAU])],
            Self::HyperbolicParaboloid { .. } => {
                [quadratic, interpolator(&[[0.0, 0.0], [2.0, 0.0], [-2.0, 0.0]])]
            }
            Self::FigureEight { .. } => [halves(), harmonics(&[TAU, 2.0 * TAU])],
            Self::Helicoid { .. } => {
                [interpolator(&[[0.0, 0.0], [0.0, 0.0], [0.0, TAU], [0.0, -TAU]]), quadratic]
            }
            Self::PinchedTorus { .. } => [halves(), circle],
        }
    }

    /// Minimum `M_u` and `M_v` for these generators; `M_v` is even for the pinched torus.
    pub fn fewest_intervals(&self) -> [usize; 2] {
        match self {
            Self::Sphere { .. } | Self::Ellipsoid { .. } => [3, 2],
            Self::Cylinder { .. } => [3, 2],
            Self::Torus { .. } => [3, 3],
            Self::Roman { .. } => [5, 5],
            Self::HyperbolicParaboloid { .. } => [2, 2],
            Self::FigureEight { .. } => [4, 5],
            Self::Helicoid { .. } => [3, 2],
            Self::PinchedTorus { .. } => [4, 4],
        }
    }

    /// The space of surfaces of this size that contains the surface.
    ///
    /// # Errors
    /// Errors of the generators.
    pub fn basis(&self, intervals: [usize; 2]) -> Result<SurfaceBasis, GeometryError> {
        let (topology, seam) = self.topology();
        SurfaceBasis::new(Extent { topology, intervals }, seam, &self.generators())
    }

    /// Rows of the surface in [`Self::basis`], or in any other space that contains it.
    pub fn rows(&self, basis: &SurfaceBasis) -> Matrix {
        basis.interpolate_function(|u, v| self.at(u, v))
    }

    /// Point at `(u, v)`.
    pub fn at(&self, u: f64, v: f64) -> [f64; 3] {
        let (sine, cosine) = (TAU * u).sin_cos();
        let (half_sine, half_cosine) = (PI * u).sin_cos();
        let (sine_v, cosine_v) = (TAU * v).sin_cos();
        let around = |distance: f64, z: f64| [distance * cosine, distance * sine, z];
        match *self {
            Self::Sphere { radius } => {
                let (s, c) = (PI * v).sin_cos();
                around(radius * s, radius * c)
            }
            Self::Ellipsoid { semi_axes: [a, b, c] } => {
                let (sine_v, cosine_v) = (PI * v).sin_cos();
                [a * cosine * sine_v, b * sine * sine_v, c * cosine_v]
            }
            Self::Cylinder { radius, height } => around(radius, height * v),
            Self::Torus { major_radius, minor_radius } => {
                around(major_radius + minor_radius * cosine_v, minor_radius * sine_v)
            }
            Self::Roman { radius } => {
                let (size, double) = (radius * radius, 2.0 * sine_v * cosine_v);
                around(0.5 * size * double, size * cosine * sine * cosine_v * cosine_v)
            }
            Self::HyperbolicParaboloid { semi_axes: [a, b], height } => {
                let (s, t) = (2.0 * u - 1.0, 2.0 * v - 1.0);
                [a * s * t.cosh(), b * s * t.sinh(), height * s * s]
            }
            Self::FigureEight { radius } => {
                let double = 2.0 * sine_v * cosine_v;
                around(
                    radius + half_cosine * sine_v - half_sine * double,
                    half_sine * sine_v + half_cosine * double,
                )
            }
            Self::Helicoid { radius, height } => around(radius * (2.0 * v - 1.0), height * u),
            Self::PinchedTorus { major_radius, minor_radius } => {
                let tube = minor_radius * half_cosine;
                around(major_radius + tube * cosine_v, tube * sine_v)
            }
        }
    }
}

/// The interpolator of half-integer shifts with these poles on the domain.
fn interpolator(poles: &[[f64; 2]]) -> GeneratorKind {
    GeneratorKind::Interpolator {
        family: Family::HalfIntegerShifts,
        poles: PoleList::from_domain(poles),
        support: None,
        weights: Vec::new(),
    }
}

/// The interpolator that contains constants and waves of these angular frequencies.
fn harmonics(frequencies: &[f64]) -> GeneratorKind {
    let pairs = frequencies.iter().flat_map(|&f| [[0.0, f], [0.0, -f]]);
    let poles: Vec<[f64; 2]> = std::iter::once([0.0, 0.0]).chain(pairs).collect();
    interpolator(&poles)
}
