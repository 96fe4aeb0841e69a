//! The generators that users choose from, with their properties.

use serde::{Deserialize, Serialize};

use super::bspline::{Poles, exponential_bspline, normalised_bspline, sinc};
use super::piecewise::Generator;
use crate::geometry::GeometryError;

/// A generator by name, as it stands in a representation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "name", rename_all = "snake_case", deny_unknown_fields)]
pub enum GeneratorKind {
    /// The interpolator that reproduces circles and ellipses of a closed curve with `M ≥ 3` control
    /// points; support 4, C¹; tends to `keys` as `M` grows.
    Trigonometric {},
    /// The cubic interpolator of Keys; support 4, C¹, reproduces polynomials of degree 2.
    Keys {},
    /// The polynomial B-spline of degree 1 to 5: not interpolating above degree 1, smoothest for its support.
    Bspline {
        /// Degree, 1 to 5.
        #[schema(minimum = 1, maximum = 5)]
        degree: u8,
    },
}

/// What is known of a generator beforehand.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct GeneratorProperties {
    /// Length of the support in units of the knot distance.
    #[schema(example = 4)]
    pub support: usize,
    /// Number of continuous derivatives.
    #[schema(example = 1)]
    pub smoothness: usize,
    /// Whether control points lie on the shape.
    pub interpolating: bool,
    /// Functions reproduced exactly.
    #[schema(example = json!(["constants", "circles and ellipses"]))]
    pub reproduces: Vec<String>,
    /// Fewest control points of a closed curve.
    #[schema(example = 3)]
    pub fewest_control_points: usize,
}

/// Highest degree of the B-splines offered.
const MAX_DEGREE: u8 = 5;

impl GeneratorKind {
    /// One of each kind, in the order of the catalogue.
    pub fn catalogue() -> Vec<Self> {
        let splines = (1..=MAX_DEGREE).map(|degree| Self::Bspline { degree });
        [Self::Trigonometric {}, Self::Keys {}].into_iter().chain(splines).collect()
    }

    /// Checks the parameters.
    ///
    /// # Errors
    /// What is wrong with the degree.
    pub fn check(&self) -> Result<(), String> {
        match *self {
            Self::Bspline { degree } if !(1..=MAX_DEGREE).contains(&degree) => {
                Err(format!("is {degree}, must be between 1 and {MAX_DEGREE}"))
            }
            _ => Ok(()),
        }
    }

    /// Properties that need no construction; of a checked kind.
    pub fn properties(&self) -> GeneratorProperties {
        let (support, smoothness, interpolating, reproduces): (_, _, _, Vec<String>) = match *self {
            Self::Trigonometric {} => (4, 1, true, vec!["constants".into(), "circles and ellipses".into()]),
            Self::Keys {} => (4, 1, true, vec!["polynomials of degree 2".into()]),
            Self::Bspline { degree } => (
                degree as usize + 1,
                (degree as usize).saturating_sub(1),
                degree == 1,
                vec![format!("polynomials of degree {degree}")],
            ),
        };
        GeneratorProperties { support, smoothness, interpolating, reproduces, fewest_control_points: 3 }
    }

    /// Builds the generator for a closed curve of `control_points` points (`≥ 3`).
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below three control points.
    pub fn build(&self, control_points: usize) -> Result<Generator, GeometryError> {
        if control_points < 3 {
            return Err(GeometryError::TooFewPoints { found: control_points, needed: 3 });
        }
        match *self {
            Self::Trigonometric {} => {
                ellipse_interpolator(2.0 * std::f64::consts::PI / control_points as f64)
            }
            Self::Keys {} => ellipse_interpolator(0.0),
            Self::Bspline { degree } => normalised_bspline(&Poles::zeros(degree as usize + 1)),
        }
    }
}

/// The interpolator of support 4 for the poles `(0, ±jω)`; Keys' function at `ω = 0`.
///
/// ```text
/// φ = λ₄ β_(0,0,±jω) + λ₃ [β_(0,±jω)(t + ½) + β_(0,±jω)(t − ½)]
/// λ₄ = 1 / (sinc²(ω/2) − 4 S₃),   λ₃ = −2 λ₄ S₃ / sinc²(ω/2),   S₃ = (ω − sin ω)/ω³
/// ```
///
/// The stable equivalents of γ₁, γ₂ in Schmitter et al., *Trigonometric Interpolation Kernel*, eq. (5);
/// the branches printed there for `|t| ≤ 1` are wrong and would lose `10⁻¹⁸ M⁴` when right.
fn ellipse_interpolator(omega: f64) -> Result<Generator, GeometryError> {
    let s3 = third_sine_difference(omega);
    let sinc2 = sinc(omega / 2.0).powi(2);
    let lambda4 = 1.0 / (sinc2 - 4.0 * s3);
    let lambda3 = -2.0 * lambda4 * s3 / sinc2;
    let poles = |zeros| {
        if omega == 0.0 { Poles::zeros(zeros + 2) } else { Poles::trigonometric(zeros, omega) }
    };
    let beta4 = exponential_bspline(&poles(2))?;
    let beta3 = exponential_bspline(&poles(1))?;
    Ok(Generator::combine(4, &[(lambda4, 0, &beta4), (lambda3, -1, &beta3), (lambda3, 1, &beta3)]))
}

/// `(ω − sin ω)/ω³`, by its series below 2 where the difference cancels.
fn third_sine_difference(omega: f64) -> f64 {
    if omega >= 2.0 {
        return (omega - omega.sin()) / omega.powi(3);
    }
    let y = omega * omega;
    let (mut term, mut sum) = (1.0 / 6.0, 0.0);
    for n in 1..=14 {
        sum += term;
        let k = (2 * n + 2) as f64;
        term *= -y / (k * (k + 1.0));
    }
    sum
}
