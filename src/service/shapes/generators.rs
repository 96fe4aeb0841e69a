//! Properties of a generator, and its graph.

use std::sync::Arc;

use crate::geometry::drawing::plot::{Graph, plot};
use crate::geometry::drawing::svg::colour;
use crate::geometry::generator::{Built, GeneratorKind};
use crate::service::app::ServiceError;

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

/// Builds and describes a generator.
///
/// # Errors
/// [`ServiceError::Query`] with all faults of the parameters.
pub fn describe(kind: GeneratorKind, count: Option<usize>) -> Result<GeneratorDetails, ServiceError> {
    let faults: Vec<String> =
        kind.faults().into_iter().map(|(field, detail)| format!("{field}: {detail}")).collect();
    if !faults.is_empty() {
        return Err(ServiceError::Query(faults.join("; ")));
    }
    let properties = kind.properties();
    let fewest = properties.fewest_control_points.min(properties.fewest_intervals);
    if fewest > MOST {
        let detail = format!(
            "domain_poles: expected poles that need at most {MOST} control points, got poles that need {fewest}"
        );
        return Err(ServiceError::Query(detail));
    }
    let count = count.unwrap_or(USUAL.max(fewest));
    if !(fewest..=MOST).contains(&count) {
        let detail = format!("control_points: expected a number between {fewest} and {MOST}, got {count}");
        return Err(ServiceError::Query(detail));
    }
    let built = kind.build(count).map_err(|error| ServiceError::Query(error.to_string()))?;
    let riesz_squared = built.generator.riesz_bounds_squared();
    let mut warnings = Vec::new();
    if let Some(condition) = built.condition.filter(|condition| *condition > WARN_CONDITION) {
        warnings.push(format!("the weights cancel: their system has the condition number {condition:.1e}"));
    }
    if riesz_squared.0 < WARN_RIESZ * riesz_squared.1 {
        warnings.push(format!(
            "the shifts are nearly dependent: A²/B² is {:.1e}, control points may lie far from the curve",
            riesz_squared.0 / riesz_squared.1
        ));
    }
    if !properties.partition_of_unity {
        warnings.push(
            "the generator does not reproduce constants: moving the control points does not move the shape"
                .into(),
        );
    }
    Ok(GeneratorDetails { kind, count, built, riesz_squared, warnings })
}

/// Number of steps per half-integer interval of a graph.
const STEPS: usize = 24;

/// Graph of the generator and its derivative.
pub fn draw(details: &GeneratorDetails) -> String {
    let generator = &details.built.generator;
    let reach = generator.support() as f64 / 2.0;
    let pieces = |derivative: usize| -> Vec<Vec<[f64; 2]>> {
        (0..2 * generator.support())
            .map(|p| {
                let at = |i: usize| {
                    let s = 2.0 * i as f64 / STEPS as f64 - 1.0;
                    let t = -reach + 0.5 * p as f64 + 0.25 * (s + 1.0);
                    [t, crate::geometry::generator::evaluate_taylor(generator.piece(p), s, derivative)]
                };
                (0..=STEPS).map(at).collect()
            })
            .collect()
    };
    let graphs = [
        Graph { name: "φ′".into(), colour: colour::PLUS, pieces: pieces(1) },
        Graph { name: "φ".into(), colour: colour::MAIN, pieces: pieces(0) },
    ];
    plot(&format!("{}, {} control points", details.kind.name(), details.count), "t", &graphs)
}
