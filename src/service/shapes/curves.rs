//! Stateless use cases of single curves: evaluation, measures and distances, resampling of polygons.
//!
//! The request carries all data, and nothing is stored. The functions are synchronous and run on the pool.

use crate::formats::fault::Fault;
use rayon::prelude::*;

use super::read;
use super::request::Posted;
use crate::formats::shape::ShapeInput;
use crate::geometry::curve::MAX_DERIVATIVE;
use crate::geometry::distance::{Distances, STRETCHES};
use crate::geometry::frame::Frame;
use crate::geometry::intersection::self_intersects;
use crate::geometry::measures::CurveMeasures;
use crate::numeric::dense::Matrix;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, Limits, ServiceError, warnings};

/// Parameters at which curves are evaluated.
#[derive(Debug, Clone)]
pub enum Parameters {
    /// Equally spaced: at `u = i/count`, on open curves at `u = i/(count − 1)`.
    Equidistant(usize),
    /// The given `u`: modulo 1 on closed curves, within `[0, 1]` on open ones.
    At(Vec<f64>),
}

/// Values of one curve.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// `d^j r/du^j` for `j = 0, 1, …`: coordinate-major.
    pub derivatives: Vec<Vec<f64>>,
    /// Tangent, normal and curvature, if requested.
    pub frames: Option<Vec<Frame>>,
}

/// Evaluates curves, their derivatives up to `order`, and their frames.
///
/// # Errors
/// Too many samples, parameters out of range.
pub fn evaluate(
    app: &App,
    curves: &Posted,
    shapes: &[Matrix],
    parameters: &Parameters,
    order: usize,
    frames: bool,
) -> Result<Vec<Evaluation>, ServiceError> {
    let mut faults = Vec::new();
    if order > MAX_DERIVATIVE {
        faults.push(Fault::new("/derivatives", format!("expected 0, 1 or {MAX_DERIVATIVE}, got {order}")));
    }
    let (count, pointer) = match parameters {
        Parameters::Equidistant(count) => (*count, "/samples"),
        Parameters::At(list) => (list.len(), "/parameters"),
    };
    let dimension = curves.space.representation().dimension();
    let values = dimension * (order.min(MAX_DERIVATIVE) + 1) + if frames { 2 * dimension + 1 } else { 0 };
    let total = count.saturating_mul(shapes.len()).saturating_mul(values);
    if count == 0 || total > app.limits.answer_numbers {
        let most = app.limits.answer_numbers;
        let detail = format!("expected a request for between 1 and {most} numbers, got {total}");
        faults.push(Fault::new(pointer, detail));
    }
    if let Parameters::At(list) = parameters
        && !curves.space.representation().is_closed()
    {
        let outside = list.iter().enumerate().filter(|(_, u)| !(0.0..=1.0).contains(*u));
        let fault = |(i, u): (usize, &f64)| {
            Fault::new(
                format!("/parameters/{i}"),
                format!("expected a number between 0 and 1 on an open curve, got {u}"),
            )
        };
        faults.extend(outside.map(fault));
    }
    ServiceError::unless_empty(faults)?;
    // Reserved before the computation, so that no work is done for a response that does not fit in memory.
    let _room = app.memory.foresee(total)?;
    each(&app.pool.context(), shapes, |shape| {
        let curve = curves.curve(shape);
        let parameters = match parameters {
            Parameters::Equidistant(count) => curve.parameters(*count),
            Parameters::At(list) => list.clone(),
        };
        Evaluation {
            derivatives: (0..=order).map(|j| curve.evaluate_all(&parameters, j)).collect(),
            frames: frames.then(|| parameters.iter().map(|&u| Frame::at(&curve, u)).collect()),
        }
    })
}

/// Measures of one curve.
#[derive(Debug, Clone)]
pub struct Measured {
    /// Area, centroid, length, curvature, bounding box.
    pub measures: CurveMeasures,
    /// Whether the curve intersects itself; planar curves only.
    pub self_intersecting: Option<bool>,
    /// Distances to the reference, if there is one.
    pub distances: Option<Distances>,
    /// Caveats about the numbers.
    pub warnings: Vec<String>,
}

/// Maximum number of pairs of intervals over which distances are measured in one request: a minute of work.
const MAX_PAIRS: usize = 10_000_000;

/// Measures curves, and their distances to a reference.
///
/// # Errors
/// Faults of the shapes, and of the reference at `/reference…`; too many distances.
pub fn measure(
    app: &App,
    curves: &Posted,
    shapes: Vec<ShapeInput>,
    reference: Option<ShapeInput>,
) -> Result<Vec<Measured>, ServiceError> {
    let (shapes, reference) = curves.read_with_reference(app, shapes, reference)?;
    let reference = reference.map(|control_points| curves.curve(&control_points));
    let intervals = curves.space.representation().count();
    let pairs = shapes.len().saturating_mul(intervals * intervals);
    if reference.is_some() && pairs > MAX_PAIRS {
        let detail = format!("expected at most {MAX_PAIRS} pairs of intervals in one request, got {pairs}");
        return Err(ServiceError::invalid("/reference", detail));
    }
    let context = app.pool.context();
    let (stop, stretches) = (|| context.is_cancelled(), STRETCHES / shapes.len().max(1));
    let measured = |shape: &Matrix| {
        context.check()?;
        let curve = curves.curve(shape);
        let distances = reference
            .as_ref()
            .map(|reference| Distances::unless_stopped(&curve, reference, stretches, &stop))
            .map(|distances| distances.ok_or(ServiceError::Cancelled))
            .transpose()?;
        let measures = CurveMeasures::unless_stopped(&curve, &stop).ok_or(ServiceError::Cancelled)?;
        let self_intersecting = (curve.dimension() == 2).then(|| self_intersects(&curve));
        let warnings = warnings::of_curve(&measures, distances.as_ref());
        Ok(Measured { measures, self_intersecting, distances, warnings })
    };
    shapes.par_iter().map(measured).collect()
}

/// Start of resampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// The first point.
    #[default]
    First,
    /// The canonical start point of the contour.
    Canonical,
}

/// A resampled contour.
#[derive(Debug, Clone)]
pub struct Resampled {
    /// Dimension `d`.
    pub dimension: usize,
    /// Points, coordinate-major.
    pub points: Vec<f64>,
    /// Length of the polygon.
    pub length: f64,
}

/// Resamples polygons to `count` points of equal arc length.
///
/// # Errors
/// Faults of the input.
pub fn resample(
    app: &App,
    count: usize,
    start: Start,
    closed: bool,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<Resampled>, ServiceError> {
    let mut faults = Vec::new();
    let fewest = if closed { 3 } else { 2 };
    if !(fewest..=app.limits.points).contains(&count) {
        let detail = format!("expected a number between {fewest} and {}, got {count}", app.limits.points);
        faults.push(Fault::new("/count", detail));
    }
    if !closed && start == Start::Canonical {
        faults.push(Fault::new("/start", "expected \"first\": an open contour starts at its first point"));
    }
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if count.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} points over all shapes", app.limits.samples);
        faults.push(Fault::new("/count", detail));
    }
    ServiceError::unless_empty(faults)?;
    each_shape(&app.pool.context(), shapes, |_, shape| {
        let points = raw_points(shape, None, closed, &app.limits)?;
        let dimension = points.ncols();
        let contour = read::contour(points, closed).map_err(below_points)?;
        let from = if start == Start::Canonical { contour.canonical_start() } else { 0.0 };
        let points = contour.sample(count, from).as_slice().to_vec();
        Ok(Resampled { dimension, points, length: contour.length() })
    })
}

/// Applies `work` to every item in parallel, until the request is cancelled.
pub(crate) fn each<I: Sync, T: Send>(
    context: &JobContext,
    items: &[I],
    work: impl Fn(&I) -> T + Sync,
) -> Result<Vec<T>, ServiceError> {
    items.par_iter().map(|item| context.check().map(|()| work(item))).collect()
}

/// Applies `work` to every shape in parallel; collects all faults at `/shapes/{index}…`.
pub(crate) fn each_shape<T: Send>(
    context: &JobContext,
    shapes: Vec<ShapeInput>,
    work: impl Fn(usize, ShapeInput) -> Result<T, Vec<Fault>> + Sync,
) -> Result<Vec<T>, ServiceError> {
    each_of(context, "shapes", shapes, work)
}

/// Applies `work` to every entry of a list in parallel, until the request is cancelled; collects all faults at
/// `/{list}/{index}…`.
pub(crate) fn each_of<I: Send, T: Send>(
    context: &JobContext,
    list: &str,
    items: Vec<I>,
    work: impl Fn(usize, I) -> Result<T, Vec<Fault>> + Sync,
) -> Result<Vec<T>, ServiceError> {
    // Skipped entries have no faults: the request then ends as cancelled.
    let unless_cancelled =
        |(index, item)| if context.is_cancelled() { Err(Vec::new()) } else { work(index, item) };
    let results: Vec<Result<T, Vec<Fault>>> =
        items.into_par_iter().enumerate().map(unless_cancelled).collect();
    context.check()?;
    let (mut values, mut faults) = (Vec::with_capacity(results.len()), Vec::new());
    for (index, result) in results.into_iter().enumerate() {
        match result {
            Ok(value) => values.push(value),
            Err(errors) => {
                let placed = errors.into_iter().map(|error| error.below(&format!("/{list}/{index}")));
                faults.extend(placed.map(|error| error.of_shape(index)));
            }
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(values)
}

pub(crate) fn below_points(errors: Vec<Fault>) -> Vec<Fault> {
    errors.into_iter().map(|error| error.below("/points")).collect()
}

/// Points of a shape as posted, of `dimension` coordinates or, without one, 2 or 3.
pub(crate) fn raw_points(
    shape: ShapeInput,
    dimension: Option<usize>,
    closed: bool,
    limits: &Limits,
) -> Result<Matrix, Vec<Fault>> {
    let points = read::given(&shape.points).cloned();
    let stated = shape.closed.as_ref().and_then(|field| field.get().copied().flatten());
    read::attributes(shape)?;
    let points = points.ok_or_else(|| vec![Fault::new("", "expected points, got none")])?;
    if stated.is_some_and(|stated| stated != closed) {
        let detail = format!(
            "expected the value of this request, whose contours are {1}, got {0}",
            !closed,
            if closed { "closed" } else { "open" }
        );
        return Err(vec![Fault::new("/closed", detail)]);
    }
    if points.len() > limits.points {
        let detail = format!("expected at most {1} points, got {0}", points.len(), limits.points);
        return Err(vec![Fault::new("/points", detail)]);
    }
    let dimension = dimension.unwrap_or_else(|| points.width().clamp(2, 3));
    let coordinates = points.checked(dimension).map_err(below_points)?;
    Ok(Matrix::from_row_slice(points.len(), dimension, coordinates))
}
