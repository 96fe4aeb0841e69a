//! Thin-plate splines: points, grids and pictures between two sets of landmarks.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::drawing::warps::WarpView;
use crate::api::extract::{BesideFormat, Caller, Format, JsonBody};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, picture, planned};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::rows;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests;
use crate::service::shapes::warp::{
    WarpFound, WarpGridInput, WarpOptions, WarpParts, WarpSurfaceInput, WarpTask,
};
use crate::wire::checked::{Checked, LARGE, document, take_given, take_or_default};
use crate::wire::shape::{PointList, Points};

document! {
    /// Landmarks before and after, and objects that are mapped between them.
    #[schema(example = json!({
        "reference": [[0, 0], [4, 0], [4, 4], [0, 4], [2, 2]], "target": [[0, 0], [4, 0], [4, 4], [0, 4], [2.5, 2.2]],
        "points": [[1, 1], [3, 3]], "grid": {"cells": 8}, "links": [[0, 1], [1, 2], [2, 3], [3, 0]]
    }))]
    pub(in crate::api::v1) struct WarpRequest {
        /// Landmarks of the reference, in the plane or in space: at least three or four, at most 2000, at different places, not on one line
        /// or plane.
        #[schema(value_type = Vec<Vec<f64>>, required = true)]
        reference: PointList, required;
        /// Landmarks of the target, in the same order.
        #[schema(value_type = Vec<Vec<f64>>, required = true)]
        target: PointList, required;
        /// Points of the reference to map: further landmarks, points along its curves, vertices of its mesh.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        points: PointList;
        /// Surface of the target onto which mapped points are projected, in space.
        #[schema(value_type = Option<WarpSurfaceInput>)]
        onto: WarpSurfaceInput;
        /// Grid around the reference to deform; it is returned if it is given, and searched for folds in any case.
        #[schema(value_type = Option<WarpGridInput>)]
        grid: Checked<WarpGridInput>;
        /// Whether the target is moved, turned and scaled onto the reference first. Default: false.
        #[schema(value_type = Option<bool>)]
        superimpose: Checked<bool>;
        /// Factor of the change from the reference to the target, within ±1000. Default: 1.
        #[schema(value_type = Option<f64>, minimum = -1000, maximum = 1000)]
        magnify: Checked<f64>;
        /// λ of the regularised spline, in units of the kernel for landmarks of unit size: with more than 0 the map is smoother, and misses
        /// its targets. Default: 0.
        #[schema(value_type = Option<f64>, minimum = 0, maximum = 1e6)]
        smoothing: Checked<f64>;
        /// Whether partial warps are returned, for at most 500 landmarks. Default: false.
        #[schema(value_type = Option<bool>)]
        partial_warps: Checked<bool>;
        /// Pairs of landmarks between which a picture has lines.
        #[schema(value_type = Option<Vec<[usize; 2]>>)]
        links: Checked<Vec<[usize; 2]>, LARGE>;
    }
}

/// A deformed grid.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct WarpGridOutput {
    /// Number of nodes along each axis.
    size: Vec<usize>,
    /// Side of a cell of the reference.
    spacing: f64,
    /// First node of the reference.
    first: Vec<f64>,
    /// Images of the nodes; the last axis varies fastest.
    nodes: Points,
    /// Determinants of the derivative at the nodes: factors of areas or volumes.
    determinants: Vec<f64>,
}

/// A target in one of the principal warps of its reference.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct PartialWarpOutput {
    /// Eigenvalue of the bending energy matrix.
    eigenvalue: f64,
    /// Principal warp: an entry for each landmark, the largest positive, of unit norm.
    warp: Vec<f64>,
    /// Partial warp score: the target's coordinates along the warp.
    score: Vec<f64>,
    /// Part of the bending energy.
    energy: f64,
}

/// A thin-plate spline.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct WarpAnswer {
    /// Bending energy, `tr(YᵀBY)` with the kernel `r² log r²` in the plane and `−r` in space; with `smoothing`, that of the map.
    bending_energy: f64,
    /// Affine part: the constant, then a row for each coordinate of the reference.
    affine: Vec<Vec<f64>>,
    /// Largest distance of a mapped landmark from its target: rounding, unless there is `smoothing`.
    residual: f64,
    /// Images of `points`; absent without them.
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<Points>,
    /// Distances by which they were projected; absent without `onto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<Vec<f64>>,
    /// The deformed grid; absent if none was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    grid: Option<WarpGridOutput>,
    /// Number of nodes of the grid at which the map folds.
    folds: usize,
    /// Partial warps, from the largest scale to the smallest; absent unless asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    partial_warps: Option<Vec<PartialWarpOutput>>,
    /// Folds, and points that are extrapolated.
    warnings: Vec<String>,
}

/// Maximum number of landmarks that have numbers unless the query says so.
const NUMBERED: usize = 60;

/// Content of a drawing of a warp.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct WarpQuery {
    /// `grid`, `arrows` or `wireframe`. Default: `grid`.
    #[param(inline)]
    show: Option<WarpView>,
    /// Whether landmarks have numbers, from 0. Default: true for at most 60.
    numbers: Option<bool>,
}

impl WarpQuery {
    /// Checks that pictures are asked for where something is said of them.
    fn check(&self, format: &Format) -> Result<(), Problem> {
        let given = [("show", self.show.is_some()), ("numbers", self.numbers.is_some())];
        match given.iter().find(|(_, given)| *given) {
            Some((name, _)) if matches!(format, Format::Json) => {
                Err(Problem::of_parameter(*name, "expected only with the formats svg and png"))
            }
            _ => Ok(()),
        }
    }
}

/// Maps points and grids by the thin-plate spline that takes landmarks to others and bends least.
///
/// Also landmark transfer: map the other landmarks of a reference by those that both have in common, and project them onto the
/// surface of the target. Partial warps, the affine part and the bending energy describe the change.
///
/// As SVG: the deformed grid (of landmarks in space, in two planes), arrows, or both sets with their links.
#[utoipa::path(post, path = "/v1/warp", tag = "curves", request_body = WarpRequest,
    params(("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), WarpQuery, DrawingQuery),
    responses(
        (status = 200, description = "The spline", content((WarpAnswer = "application/json"), (String = "image/svg+xml")))
    ))]
pub(in crate::api::v1) async fn warp(
    Caller(app): Caller,
    format: Format,
    BesideFormat(query): BesideFormat<WarpQuery>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    query.check(&format)?;
    let plan = move |app: &App, body: &[u8]| app.parse::<WarpRequest>(body)?.plan(app, format, &query);
    compute_planned(app, body, plan).await
}

impl WarpRequest {
    fn plan(self, app: &App, format: Format, query: &WarpQuery) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let grid = take_given(self.grid, "/grid", &mut errors);
        let superimpose = take_or_default(self.superimpose, "/superimpose", &mut errors);
        let magnify = take_given(self.magnify, "/magnify", &mut errors);
        let smoothing = take_or_default(self.smoothing, "/smoothing", &mut errors);
        let partial_warps = take_or_default(self.partial_warps, "/partial_warps", &mut errors);
        let links = take_or_default(self.links, "/links", &mut errors);
        ServiceError::unless_empty(errors)?;
        let options = WarpOptions {
            grid: grid.unwrap_or_default(),
            superimpose: superimpose.unwrap_or_default(),
            magnify: magnify.unwrap_or(1.0),
            smoothing: smoothing.unwrap_or_default(),
            partial_warps: partial_warps.unwrap_or_default(),
            links: links.unwrap_or_default(),
        };
        let Self { reference, target, points, onto, .. } = self;
        let task = WarpTask::new(app, WarpParts { reference, target, points, onto, options })?;
        let draws = !matches!(format, Format::Json);
        if draws {
            task.check_drawn()?;
        }
        let [landmarks, places] = task.counts(draws);
        let work =
            requests::warp(landmarks, places, task.projected(), task.has_partial_warps()) + format.work();
        let (view, numbers) =
            (query.show.unwrap_or_default(), query.numbers.unwrap_or(landmarks <= NUMBERED));
        planned(work, move |app| match format {
            Format::Picture(file) => picture(&task.drawing(app, view, numbers)?, &file),
            Format::Json => json(StatusCode::OK, &WarpAnswer::new(task.found(app)?, grid.is_some())),
        })
    }
}

fn points(rows: Matrix) -> Points {
    let dimension = rows.ncols();
    Points::from_columns(rows.as_slice().to_vec(), dimension)
}

impl WarpAnswer {
    fn new(found: WarpFound, has_grid: bool) -> Self {
        let partial_warps = found.partial_warps.map(|(warps, scores)| {
            let one = |(k, &eigenvalue): (usize, &f64)| {
                let score: Vec<f64> = scores.row(k).iter().copied().collect();
                let energy = eigenvalue * score.iter().map(|x| x * x).sum::<f64>();
                let warp = warps.warps.column(k).iter().copied().collect();
                PartialWarpOutput { eigenvalue, warp, score, energy }
            };
            warps.eigenvalues.iter().enumerate().map(one).collect()
        });
        let grid = has_grid.then(|| WarpGridOutput {
            size: found.lattice.size,
            spacing: found.lattice.spacing,
            first: found.lattice.first,
            nodes: points(found.nodes),
            determinants: found.determinants,
        });
        Self {
            bending_energy: found.bending_energy,
            affine: rows(&found.affine),
            residual: found.residual,
            points: found.points.map(points),
            distances: found.distances,
            grid,
            folds: found.folds,
            partial_warps,
            warnings: found.warnings,
        }
    }
}
