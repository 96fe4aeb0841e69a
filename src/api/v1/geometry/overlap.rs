//! Overlap of two bodies (contours, meshes or masks), counted on a grid of cells.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, planned};
use crate::api::v1::requests::request_macros::checked;
use crate::geometry::overlap::{GridInput, Overlapping};
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests;
use crate::service::shapes::overlap::{self, BodyInput, Cells};
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::fault::Fault;

document! {
    /// Two bodies, both in the plane or both in space.
    #[schema(example = json!({
        "first": {"contour": [[0, 0], [4, 0], [4, 4], [0, 4]]}, "second": {"contour": [[1, 1], [5, 1], [5, 5], [1, 5]]}, "spacing": 0.05
    }))]
    pub(in crate::api::v1) struct OverlapRequest {
        /// First body.
        #[schema(value_type = BodyInput, required = true)]
        first: BodyInput, required;
        /// Second body.
        #[schema(value_type = BodyInput, required = true)]
        second: BodyInput, required;
        /// Side of a grid cell, in the unit of the coordinates. Default: 1/128 of the longest side of the common bounding box,
        /// or 1/32 of the longest side of the smaller body if this is less, as far as the limit of cells allows. A mask brings
        /// its own grid.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0)]
        spacing: Checked<f64>;
        /// Grid on which cells are counted, in place of a spacing; parts of the bodies beyond it are left out, with a warning.
        #[schema(value_type = Option<GridInput>)]
        grid: Checked<GridInput>;
    }
}

/// Grid on which cells are counted.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct GridOutput {
    /// Number of cells along each axis.
    size: Vec<usize>,
    /// Distance between cell centres along each axis.
    spacing: Vec<f64>,
    /// Position of the centre of the first cell.
    first: Vec<f64>,
}

/// Overlap of two bodies, counted in cells whose centres are inside.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct OverlapAnswer {
    /// `|A ∩ B|/|A ∪ B|`; 1 for two empty bodies.
    jaccard: f64,
    /// `2|A ∩ B|/(|A| + |B|)`; 1 for two empty bodies.
    dice: f64,
    /// Largest distance from a surface cell of one body to the surface of the other, over both; null if one is empty.
    hausdorff: Option<f64>,
    /// 95th percentile of these distances from one body to the other, the larger one of both directions.
    hausdorff_95: Option<f64>,
    /// Mean of these distances.
    mean_surface_distance: Option<f64>,
    /// Number of cells inside the first and the second body.
    cells: [usize; 2],
    /// Number of cells inside both bodies.
    intersection: usize,
    /// Number of cells inside either body.
    union: usize,
    /// Areas (in the plane) or volumes (in space) of the two bodies, counted in cells.
    measures: [f64; 2],
    /// Grid on which cells were counted.
    grid: GridOutput,
    /// Limitations of the numbers, each with a JSON pointer to its body: few cells, contours or meshes that intersect
    /// themselves or enclose nothing.
    warnings: Vec<String>,
}

/// Measures the overlap of two closed contours, meshes or masks: Jaccard, Dice and Hausdorff.
///
/// A cell is inside a body if the boundary winds round its centre: a part that is enclosed twice is inside, and a hole has the
/// opposite orientation. The test is the same for all bodies on one grid.
#[utoipa::path(post, path = "/v1/overlap", tag = "curves", request_body = OverlapRequest,
    responses(
        (status = 200, description = "Counts and distances", body = OverlapAnswer)
    ))]
pub(in crate::api::v1) async fn overlap(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<OverlapRequest>(body)?.plan(app)).await
}

impl OverlapRequest {
    fn plan(self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let spacing = take_given(self.spacing, "/spacing", &mut errors);
        let grid = take_given(self.grid, "/grid", &mut errors);
        if spacing.is_some() && grid.is_some() {
            errors.push(Fault::new("/grid", "expected either spacing or grid, got both"));
        }
        let ((first, second), _) = checked(self.first.zip(self.second), errors, Vec::new())?;
        let cells = grid.map_or(Cells::Spacing(spacing), Cells::Grid);
        let bodies = overlap::read(app, [first, second], cells)?;
        planned(requests::overlap(bodies.cells()), move |app| {
            let context = app.pool.context();
            let found = bodies.overlap(&|| context.is_cancelled()).ok_or(ServiceError::Cancelled)?;
            json(StatusCode::OK, &OverlapAnswer::from(found))
        })
    }
}

impl From<Overlapping> for OverlapAnswer {
    fn from(Overlapping { grid, dimension, overlap, warnings }: Overlapping) -> Self {
        Self {
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
            warnings,
        }
    }
}
