//! The shape prior of a posted reference.

use axum::response::Response;
use serde::Serialize;

use crate::api::extract::Caller;
use crate::api::problem::Problem;
use crate::api::v1::requests::batches::{Batch, PlannedResults, answer_batch, results};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::{Caveats, checked, settings_request};
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::segmentation::cost;
use crate::service::segmentation::prior::{self, PriorEnergy};
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::OnError;
use crate::wire::checked::{Checked, take_given};
use crate::wire::shape::{Points, ShapeInput};

settings_request! {
    /// Shapes at which the prior of a reference is evaluated.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "trigonometric"}},
        "transformation": "similarity", "correspondence": "cyclic",
        "reference": {"points": [[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1]]},
        "shapes": [{"points": [[5, 9], [3, 7], [3, 3], [5, 1], [7, 3], [7, 6]]}]
    }))]
    ReferencePriorRequest {
        /// Shape whose class attracts.
        #[schema(value_type = ShapeInput, required = true)]
        reference: ShapeInput, required;
        /// Weight `γ`. Default: 1.
        #[schema(value_type = Option<f64>, minimum = 0)]
        weight: Checked<f64>;
    }
}

/// Prior energy at a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ReferencePriorOutput {
    /// Energy `γ d²/|V|^(2/d)`, which has no unit. Of shapes that enclose nothing (open curves, curves in space, sheets, landmarks) it is
    /// `γ d²/s²`, `s` the `L₂` norm about the mean position.
    energy: f64,
    /// Gradient of the energy with respect to the free points: all control points, without those of a cylinder beyond its ends.
    gradient: Points,
    /// Squared `L₂` distance `d²` to the nearest member of the class of the reference.
    squared_distance: f64,
    /// Enclosed area or volume `V`; negative for a shape of the other direction. Null for shapes that enclose nothing.
    volume: Option<f64>,
    /// Control point at which the shape begins to fit the reference best, after a reversal.
    shift: u32,
    /// Whether it fits best in the opposite direction.
    reversed: bool,
    /// Whether it fits best as a mirror image.
    mirrored: bool,
}

impl From<PriorEnergy> for ReferencePriorOutput {
    fn from(found: PriorEnergy) -> Self {
        let PriorEnergy { energy, gradient, squared_distance, volume, placement } = found;
        let (shift, reversed, mirrored) = (placement.shift, placement.reversed, placement.mirrored);
        Self { energy, gradient, squared_distance, volume, shift, reversed, mirrored }
    }
}

results! {
    /// Prior energies.
    ReferencePriorAnswer with Caveats of ReferencePriorResult: ShapeWithReferencePrior with ReferencePriorOutput
}

/// Computes energy and gradient of the shape prior of a reference, without an image.
///
/// The energy is the squared distance of a shape from the nearest member of the class of the reference, relative to the area or
/// volume of the shape, or to its squared size if it encloses nothing: it does not depend on its size, and the same term in
/// `POST /v1/segment` attracts with it. `procrustes` takes rotations without reflection. Under `cyclic` the start point is
/// searched, under `either` the direction.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/prior", tag = "statistics", params(BatchQuery),
    request_body(content((ReferencePriorRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One energy per shape, in order", content((ReferencePriorAnswer = "application/json"), (ReferencePriorResult = "application/x-ndjson")))
    ))]
pub(in crate::api::v1) async fn prior_of_reference(
    Caller(app): Caller,
    batch: Batch,
) -> Result<Response, Problem> {
    answer_batch::<_, ReferencePriorAnswer>(app, batch, ReferencePriorRequest::plan).await
}

impl ReferencePriorRequest {
    fn plan(
        mut self,
        app: &App,
        on_error: OnError,
    ) -> Result<PlannedResults<ReferencePriorAnswer>, ServiceError> {
        let mut errors = Vec::new();
        let (settings, shapes) = self.take_settings(&mut errors);
        let weight = take_given(self.weight, "/weight", &mut errors).unwrap_or(1.0);
        let whole = settings.zip(self.reference);
        let ((settings, reference), shapes) = checked(whole, errors, shapes)?;
        let settings = settings.checked(&app.limits)?;
        let counts = Counts::new(&settings.representation, shapes.len() + 1, &app.limits);
        let work =
            requests::align(&settings, counts) + cost::boundaries(&settings.representation, shapes.len());
        let names = InputNames::of_posted(&shapes);
        let find = move |app: &App| {
            let (found, mixed) = prior::energies(app, settings, weight, reference, (shapes, on_error))?;
            Ok((found.map(|_, energy| Ok(ReferencePriorOutput::from(energy))), Caveats::from(mixed)))
        };
        Ok((work, names, Box::new(find)))
    }
}
