//! Properties of a generator built for a number of control points, and its graph.

use std::sync::Arc;

use crate::drawing::colour;
use crate::drawing::plot::{Graph, plot};
use crate::drawing::scene::Drawing;
use crate::field_fault::FieldFault;
use crate::generator::{Built, GeneratorKind, evaluate_taylor};

/// A generator built for a number of control points.
#[derive(Debug, Clone)]
pub struct GeneratorDetails {
    /// Requested kind and parameters.
    pub kind: GeneratorKind,
    /// Number of control points of a closed curve, or of intervals of an open one.
    pub count: usize,
    /// The generator.
    pub built: Arc<Built>,
    /// Squared Riesz bounds `(A², B²)`.
    pub riesz_squared: (f64, f64),
    /// Warnings about numerical properties.
    pub warnings: Vec<String>,
}

/// Default number of control points.
const USUAL: usize = 8;

/// Maximum number of control points for which a generator is described.
const MOST: usize = 1_000_000_000;

/// Condition number of the system of the weights above which a warning is given: the weights cancel.
const WARN_CONDITION: f64 = 1e6;

/// Ratio of the lower to the upper Riesz bound (squared) below which a warning is given: control points can lie far
/// from the curve.
const WARN_RIESZ: f64 = 1e-4;

/// Number of steps per half-integer interval of a graph.
const STEPS: usize = 24;

impl GeneratorDetails {
    /// Builds and describes a generator. Default of the count: 8, or the fewest if these are more.
    ///
    /// # Errors
    /// All faults of the parameters; a count out of range; a generator that cannot be built.
    pub fn new(kind: GeneratorKind, count: Option<usize>) -> Result<Self, Vec<FieldFault>> {
        let faults: Vec<FieldFault> =
            kind.faults().into_iter().map(|(field, detail)| FieldFault::new(field, detail)).collect();
        if !faults.is_empty() {
            return Err(faults);
        }
        let refused = |field: &str, detail: String| Err(vec![FieldFault::new(field, detail)]);
        let properties = kind.properties();
        let fewest = properties.fewest_control_points.min(properties.fewest_intervals);
        if fewest > MOST {
            let detail = format!(
                "expected poles that need at most {MOST} control points, got poles that need {fewest}"
            );
            return refused("domain_poles", detail);
        }
        let count = count.unwrap_or(USUAL.max(fewest));
        if !(fewest..=MOST).contains(&count) {
            let detail = format!("expected a number between {fewest} and {MOST}, got {count}");
            return refused("control_points", detail);
        }
        let built = match kind.build(count) {
            Ok(built) => built,
            Err(error) => return refused("", error.to_string()),
        };
        let riesz_squared = built.generator.riesz_bounds_squared();
        let mut warnings = warnings(&built, riesz_squared);
        if !properties.partition_of_unity {
            warnings.push(
                "the generator does not reproduce constants: moving the control points does not move the shape"
                    .into(),
            );
        }
        Ok(Self { kind, count, built, riesz_squared, warnings })
    }

    /// Graph of the generator and its derivative.
    pub fn draw(&self) -> Drawing {
        let generator = &self.built.generator;
        let reach = generator.support() as f64 / 2.0;
        let pieces = |derivative: usize| -> Vec<Vec<[f64; 2]>> {
            (0..2 * generator.support())
                .map(|p| {
                    let at = |i: usize| {
                        let s = 2.0 * i as f64 / STEPS as f64 - 1.0;
                        let t = -reach + 0.5 * p as f64 + 0.25 * (s + 1.0);
                        [t, evaluate_taylor(generator.piece(p), s, derivative)]
                    };
                    (0..=STEPS).map(at).collect()
                })
                .collect()
        };
        let graphs = vec![
            Graph { name: "φ′".into(), colour: colour::PLUS, pieces: pieces(1) },
            Graph { name: "φ".into(), colour: colour::MAIN, pieces: pieces(0) },
        ];
        plot(&format!("{}, {} control points", self.kind.name(), self.count), "t", graphs)
    }
}

/// Caveats about the weights and the Riesz bounds.
fn warnings(built: &Built, (lower, upper): (f64, f64)) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(condition) = built.condition.filter(|condition| *condition > WARN_CONDITION) {
        warnings.push(format!("the weights cancel: their system has the condition number {condition:.1e}"));
    }
    if lower < WARN_RIESZ * upper {
        warnings.push(format!(
            "the shifts are nearly dependent: A²/B² is {:.1e}, control points may lie far from the curve",
            lower / upper
        ));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::svg::Style;

    #[test]
    fn the_cubic_b_spline_has_its_known_riesz_bounds() {
        let details = GeneratorDetails::new(GeneratorKind::Bspline { degree: 3 }, None).unwrap();
        // Σ_k |φ̂(ω + 2πk)|² is 1 at ω = 0 and 17/315 at ω = π.
        let (lower, upper) = details.riesz_squared;
        assert!((lower - 17.0 / 315.0).abs() < 1e-9 && (upper - 1.0).abs() < 1e-9, "{lower} {upper}");
        assert_eq!((details.count, details.warnings.len()), (8, 0));
        assert!(details.draw().to_svg(&Style::default()).starts_with("<svg"));
    }

    #[test]
    fn counts_out_of_range_are_refused() {
        let refused = GeneratorDetails::new(GeneratorKind::Trigonometric {}, Some(0)).unwrap_err();
        assert_eq!(refused.iter().map(|fault| &*fault.field).collect::<Vec<_>>(), ["control_points"]);
    }
}
