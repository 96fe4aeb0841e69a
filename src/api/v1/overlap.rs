//! The overlap of two bodies.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::settings::checked;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute_planned, json, planned};
use crate::formats::checked::{Checked, document, take_given};
use crate::service::cost::requests;
use crate::service::shapes::overlap::{self, BodyInput};

document! {
    /// Two bodies, both of the plane or both of space.
    #[schema(example = json!({
        "first": {"contour": [[0, 0], [4, 0], [4, 4], [0, 4]]}, "second": {"contour": [[1, 1], [5, 1], [5, 5], [1, 5]]}, "spacing": 0.05
    }))]
    pub(super) struct OverlapRequest {
        /// The one.
        #[schema(value_type = BodyInput, required = true)]
        first: BodyInput, required;
        /// The other.
        #[schema(value_type = BodyInput, required = true)]
        second: BodyInput, required;
        /// Side of a cell, in the unit of the coordinates. Unless given a 128th of the longest side of the box of both, or a 32nd of
        /// that of the smaller body where this is less, as far as there are cells for it. With a mask its grid is taken.
        #[schema(value_type = Option<f64>)]
        spacing: Checked<f64>;
    }
}

/// The grid on which cells were counted.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct GridOutput {
    /// Number of cells along the axes.
    size: Vec<usize>,
    /// Distances of their centres.
    spacing: Vec<f64>,
    /// Where the centre of the first cell is.
    first: Vec<f64>,
}

/// How two bodies overlap, counted in cells whose centres are inside.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct OverlapAnswer {
    /// `|A ∩ B|/|A ∪ B|`; 1 for two empty bodies.
    jaccard: f64,
    /// `2|A ∩ B|/(|A| + |B|)`; 1 for two empty bodies.
    dice: f64,
    /// Largest distance of a cell at the surface of one body from that of the other, over both; null when one is empty.
    hausdorff: Option<f64>,
    /// 95th percentile of these distances.
    hausdorff_95: Option<f64>,
    /// Mean of these distances.
    mean_surface_distance: Option<f64>,
    /// Cells inside of the first and of the second body.
    cells: [usize; 2],
    /// Cells inside of both.
    intersection: usize,
    /// Cells inside of any.
    union: usize,
    /// Areas in the plane, volumes in space, counted in cells.
    measures: [f64; 2],
    /// The grid.
    grid: GridOutput,
    /// What the numbers do not hold, with the pointer to the body: few cells, contours and meshes that cross themselves or enclose
    /// nothing.
    warnings: Vec<String>,
}

/// How two closed contours, meshes or masks overlap: Jaccard, Dice, Hausdorff.
///
/// A cell is inside when its centre is, by the number of crossings of a ray: exact, and the same for all of them on one grid.
#[utoipa::path(post, path = "/overlap", tag = "curves", request_body = OverlapRequest,
    responses(
        (status = 200, description = "Counts and distances", body = OverlapAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn overlap(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, move |app, body| {
        let (request, mut errors) = (app.parse::<OverlapRequest>(body)?, Vec::new());
        errors.extend(request.faults);
        let spacing = take_given(request.spacing, "/spacing", &mut errors);
        let bodies = request.first.zip(request.second);
        let ((first, second), _) = checked(bodies, errors, Vec::new())?;
        let bodies = overlap::read(app, [first, second], spacing)?;
        planned(requests::overlap(bodies.cells()), move |app| {
            let found = bodies.overlap(&app.pool.context())?;
            let (grid, overlap, dimension) = (found.grid, found.overlap, found.dimension);
            json(
                StatusCode::OK,
                &OverlapAnswer {
                    jaccard: overlap.jaccard,
                    dice: overlap.dice,
                    hausdorff: overlap.hausdorff,
                    hausdorff_95: overlap.hausdorff_95,
                    mean_surface_distance: overlap.mean_surface_distance,
                    cells: overlap.cells,
                    intersection: overlap.intersection,
                    union: overlap.union,
                    measures: overlap.cells.map(|cells| cells as f64 * grid.cell_measure()),
                    grid: GridOutput {
                        size: grid.size[..dimension].to_vec(),
                        spacing: grid.spacing[..dimension].to_vec(),
                        first: grid.first[..dimension].to_vec(),
                    },
                    warnings: found.warnings,
                },
            )
        })
    })
    .await
}
