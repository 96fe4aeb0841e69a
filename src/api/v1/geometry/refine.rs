//! Refinement: the same shape on a finer grid of knots, in the whole domain or in a part of it; and shapes of several resolutions by
//! control points of one.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::correspondence::Correspondence;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, planned};
use crate::api::v1::requests::request_macros::{LayeredOutput, checked, shapes_request};
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::representation::Representation;
use crate::geometry::resolution::{MAX_FACTOR, ParameterRegion};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::blocks::{Layers, pointed};
use crate::service::shapes::refine::{self, Layered, Refined};
use crate::service::shapes::request::Posted;
use crate::service::shapes::resize::resize;
use crate::wire::checked::{Checked, take_given};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

shapes_request! {
    /// Curves or surfaces to refine.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 3, "generator": {
            "name": "interpolator", "family": "half_integer_shifts",
            "domain_poles": [[0, 0], [0, std::f64::consts::TAU], [0, -std::f64::consts::TAU]]}},
        "shapes": [{"points": [[1, 0], [-0.5, 0.8660254037844386], [-0.5, -0.8660254037844386]]}], "factor": 2
    }))]
    RefineRequest {
        /// Factor by which the number of knots grows, along both directions of surfaces. Default: 2.
        #[schema(value_type = Option<usize>, minimum = 2)]
        factor: Checked<usize>;
        /// Numbers of control points `[M_u, M_v]` of surfaces in place of `factor`; they may grow or shrink.
        #[schema(value_type = Option<[usize; 2]>, min_items = 2, max_items = 2)]
        control_points: Checked<[usize; 2]>;
        /// Part of the domain to refine. The shapes keep their control points and get a block of those of the finer grid that move them
        /// in this part only, with offsets 0.
        #[schema(value_type = Option<ParameterRegion>)]
        region: Checked<ParameterRegion>;
    }
}

/// A shape on the refined grid of knots.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RefinedOutput {
    #[serde(flatten)]
    shape: LayeredOutput,
    /// `L₂` distance to the original shape; absent if the two are the same function.
    #[serde(skip_serializing_if = "Option::is_none")]
    l2_change: Option<f64>,
}

/// Refined shapes, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RefineAnswer {
    /// Refined representation; of a region, that of the request.
    representation: Representation,
    /// Whether the refined shapes are the same functions as the originals. True for B-splines and interpolators of
    /// half-integer shifts, on surfaces if both directions are such; others are sampled at the finer knots, and the same if all
    /// changes are rounding errors.
    exact: bool,
    /// `δ`: the original curve at `u` equals the refined curve at `u + δ`. Half a fine interval if knots of an odd order are
    /// split by an even factor, else 0. Of surfaces along `u`.
    parameter_shift: f64,
    /// `[δ_u, δ_v]` of surfaces: the original surface at `(u, v)` equals the refined one at `(u + δ_u, v + δ_v)`.
    #[serde(skip_serializing_if = "Option::is_none")]
    parameter_shifts: Option<[f64; 2]>,
    /// One entry per shape.
    shapes: Vec<RefinedOutput>,
}

/// Refines curves and surfaces to a grid with more knots, exactly where their generators allow it; else samples them at its knots.
///
/// With a `region`, only a part of the domain gets more control points, in a block. Without one, shapes with blocks are brought to one
/// grid that refines those of all blocks (default of `factor`: the coarsest such), so that a cohort takes them.
#[utoipa::path(post, path = "/v1/refine", tag = "curves", request_body = RefineRequest,
    responses(
        (status = 200, description = "The finer representation and control points", body = RefineAnswer)
    ))]
pub(in crate::api::v1) async fn refine(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<RefineRequest>(body)?.plan(app)).await
}

impl RefineRequest {
    fn plan(mut self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = Vec::new();
        let (settings, shapes) = self.take_shapes(&mut errors);
        let given = self.factor.is_some();
        let factor = self.factor.map_or(Some(USUAL_FACTOR), |field| field.take("/factor", &mut errors));
        let counts = take_given(self.control_points, "/control_points", &mut errors);
        let domain = settings.as_ref().map(|(representation, _)| representation.domain());
        if counts.is_some() && (given || domain.is_some_and(|domain| !domain.is_sheet())) {
            let detail = "this field belongs to surfaces, instead of a factor";
            errors.push(Fault::new("/control_points", detail));
        }
        let region = take_given(self.region, "/region", &mut errors);
        if let (Some(region), Some((representation, _))) = (&region, &settings) {
            let closed: Vec<bool> = representation.knots().iter().map(|knots| knots.closed).collect();
            errors
                .extend(region.faults(&closed).into_iter().map(|fault| Fault::from(fault).below("/region")));
        }
        let (((representation, correspondence), factor), shapes) =
            checked(settings.zip(factor), errors, shapes)?;
        let representation = app.admit(representation)?;
        if region.is_some() || shapes.iter().any(ShapeInput::has_blocks) {
            let wanted = Wanted { factor: given.then_some(factor), control_points: counts, region };
            return wanted.plan(app, representation, correspondence, shapes);
        }
        let work = refine_work(&representation, shapes.len(), factor, counts, &app.limits);
        planned(work, move |app| {
            let posted = Posted::from_splines(app, &representation, correspondence)?;
            let shapes = posted.read(app, shapes)?;
            let refined = match representation.domain() {
                Domain::Sheet { extent, .. } => {
                    let finer = extent.intervals.map(|count| count.saturating_mul(factor));
                    let (wanted, pointer) =
                        counts.map_or((finer, "/factor"), |counts| (counts, "/control_points"));
                    resize(app, &posted, wanted, pointer, &shapes)?
                }
                _ => refine::refine(app, &posted, factor, &shapes)?,
            };
            json(StatusCode::OK, &RefineAnswer::from(refined))
        })
    }
}

/// Predicted work of refining `shapes` shapes.
fn refine_work(
    representation: &Admitted,
    shapes: usize,
    factor: usize,
    control_points: Option<[usize; 2]>,
    limits: &Limits,
) -> Work {
    let counts = Counts::new(representation, shapes, limits);
    match representation.domain() {
        Domain::Sheet { extent, .. } => {
            let finer = extent.intervals.map(|count| count.saturating_mul(factor));
            requests::resize(counts, extent.intervals, control_points.unwrap_or(finer), limits)
        }
        _ => requests::refine(counts, counts.points().saturating_mul(factor), limits),
    }
}

impl From<Refined> for RefineAnswer {
    fn from(Refined { representation, exact, parameter_shifts, shapes }: Refined) -> Self {
        let shape = |(control_points, l2_change): (Matrix, Option<f64>)| RefinedOutput {
            shape: Layered { control_points, blocks: Vec::new() }.into(),
            l2_change,
        };
        Self {
            representation,
            exact,
            parameter_shift: parameter_shifts.first().copied().unwrap_or_default(),
            parameter_shifts: parameter_shifts.try_into().ok(),
            shapes: shapes.into_iter().map(shape).collect(),
        }
    }
}

/// Target of shapes of several resolutions: a block for a region, otherwise one grid for all shapes.
#[derive(Debug)]
struct Wanted {
    factor: Option<usize>,
    control_points: Option<[usize; 2]>,
    region: Option<ParameterRegion>,
}

/// Default factor of a refinement.
const USUAL_FACTOR: usize = 2;

impl Wanted {
    /// Factors of the wanted grid, with the field that names it; `None` for the coarsest that refines all blocks.
    ///
    /// # Errors
    /// Numbers of control points that are not multiples; a factor that does not fit.
    fn factors(
        &self,
        representation: &Representation,
    ) -> Result<Option<(Vec<usize>, &'static str)>, ServiceError> {
        let knots: Vec<usize> = representation.knots().iter().map(|knots| knots.count).collect();
        if let Some(counts) = self.control_points {
            let factors: Vec<usize> =
                counts.iter().zip(&knots).map(|(count, knots)| count / (*knots).max(1)).collect();
            let whole = counts
                .iter()
                .zip(&knots)
                .zip(&factors)
                .all(|((count, knots), factor)| knots * factor == *count);
            if whole
                && factors.iter().any(|factor| *factor > 1)
                && factors.iter().all(|factor| *factor <= MAX_FACTOR)
            {
                return Ok(Some((factors, "/control_points")));
            }
            let detail = format!(
                "expected larger multiples of {knots:?} on a grid that refines this one, got {counts:?}"
            );
            return Err(ServiceError::invalid("/control_points", detail));
        }
        let (factor, pointer) = match (self.factor, &self.region) {
            (Some(factor), _) => (factor, "/factor"),
            (None, Some(_)) => (USUAL_FACTOR, "/region"),
            (None, None) => return Ok(None),
        };
        if !(2..=MAX_FACTOR).contains(&factor) {
            let detail = format!("expected a number between 2 and {MAX_FACTOR}, got {factor}");
            return Err(ServiceError::invalid("/factor", detail));
        }
        Ok(Some((vec![factor; knots.len()], pointer)))
    }

    fn plan(
        self,
        app: &App,
        representation: Admitted,
        correspondence: Correspondence,
        shapes: Vec<ShapeInput>,
    ) -> Result<Planned, ServiceError> {
        let wanted = self.factors(&representation)?;
        let named = wanted.as_ref().map(|(factors, pointer)| (&**factors, *pointer));
        let layers = Layers::new(app, representation, pointed(&shapes), named)?;
        if let (None, Some((factors, pointer))) = (&self.region, &wanted)
            && layers.factors() != factors
        {
            let detail = format!(
                "expected a grid that refines those of all blocks, which {:?} times the knots do, got {factors:?}",
                layers.factors()
            );
            return Err(ServiceError::invalid(*pointer, detail));
        }
        let counts = Counts::new(layers.finest(), shapes.len(), &app.limits);
        let flat =
            requests::refine(counts, counts.points(), &app.limits) + requests::grids(counts, layers.count());
        let work = self.region.map_or(flat, |_| flat + requests::region(counts));
        planned(work, move |app| {
            let posted = Posted::of_layers(app, &layers, correspondence)?;
            let (Some(region), Some((factors, _))) = (self.region, wanted) else {
                return json(
                    StatusCode::OK,
                    &RefineAnswer::from(refine::flatten(app, &layers, &posted, shapes)?),
                );
            };
            let shapes = refine::refine_region(app, &posted, &factors, &region, shapes)?;
            json(StatusCode::OK, &RefineAnswer::of_region(layers.coarse(), shapes))
        })
    }
}

impl RefineAnswer {
    fn of_region(representation: &Representation, shapes: Vec<Layered>) -> Self {
        let output = |shape: Layered| RefinedOutput { shape: shape.into(), l2_change: None };
        Self {
            representation: representation.clone(),
            exact: true,
            parameter_shift: 0.0,
            parameter_shifts: representation.domain().is_sheet().then_some([0.0; 2]),
            shapes: shapes.into_iter().map(output).collect(),
        }
    }
}
