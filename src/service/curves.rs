//! The stateless use cases of single curves: everything in the request, nothing stored. Plain functions, to be run on
//! the pool.

use rayon::prelude::*;

use super::error::Fault;
use super::input::{self, Reading};
use super::{App, Limits, ServiceError};
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::metric::Metric;
use crate::analysis::path::Path;
use crate::formats::InputError;
use crate::formats::shape::ShapeInput;
use crate::formats::svg::{self, Layer, colour};
use crate::geometry::GeometryError;
use crate::geometry::curve::{Curve, MAX_DERIVATIVE};
use crate::geometry::distance::{Distances, l2};
use crate::geometry::fit::{Fit, Samples};
use crate::geometry::frame::Frame;
use crate::geometry::ideal::{IdealCurve, Position};
use crate::geometry::intersection::self_intersects;
use crate::geometry::measures::CurveMeasures;
use crate::geometry::refine::Refinement;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::numeric::dense::Matrix;

/// Curves of a request, prepared.
#[derive(Debug)]
pub struct Curves {
    /// Their space.
    pub space: ShapeSpace,
    /// Its metric.
    pub metric: Metric,
    correspondence: Correspondence,
}

impl Curves {
    /// Prepares a representation of curves.
    ///
    /// # Errors
    /// Faults of the representation and the correspondence; landmarks.
    pub fn new(
        app: &App,
        representation: &Representation,
        correspondence: Correspondence,
    ) -> Result<Self, ServiceError> {
        let (space, metric) = app.space(representation, "/representation")?;
        if space.generator().is_none() {
            let detail = "landmarks are points without a curve: use closed_curve or open_curve";
            return Err(ServiceError::invalid("/representation/kind", detail));
        }
        input::check_correspondence(representation, correspondence)?;
        Ok(Self { space, metric, correspondence })
    }

    fn reading<'a>(&'a self, limits: &'a Limits) -> Reading<'a> {
        let (space, correspondence) = (&self.space, self.correspondence);
        Reading { space, correspondence, direction: Direction::Given, limits }
    }

    /// Control points of every shape, at least one.
    ///
    /// # Errors
    /// The faults of all bad shapes, at `/shapes/{index}…`.
    pub fn read(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<Vec<Matrix>, ServiceError> {
        let batch = input::read_batch(&self.reading(&app.limits), shapes)?;
        if batch.weights.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        let shapes = batch.control_points.chunks_exact(self.metric.len());
        Ok(shapes.map(|control_points| self.matrix(control_points)).collect())
    }

    /// Control points of one shape.
    ///
    /// # Errors
    /// Its faults below `pointer`.
    fn read_one(&self, app: &App, shape: ShapeInput, pointer: &str) -> Result<Matrix, ServiceError> {
        input::read_shape(&self.reading(&app.limits), shape)
            .map(|(control_points, _)| self.matrix(&control_points))
            .map_err(|errors| ServiceError::below(errors, pointer))
    }

    fn matrix(&self, control_points: &[f64]) -> Matrix {
        Matrix::from_column_slice(self.metric.size(), self.metric.dimension(), control_points)
    }

    fn curve(&self, control_points: &Matrix) -> Curve {
        Curve::of(&self.space, control_points).expect("the space is one of curves")
    }
}

/// Where curves are evaluated.
#[derive(Debug, Clone)]
pub enum Parameters {
    /// Equally spaced: at `u = i/count`, on open curves at `u = i/(count − 1)`.
    Equidistant(usize),
    /// At these `u`: modulo 1 on closed curves, within `[0, 1]` on open ones.
    At(Vec<f64>),
}

/// Values of one curve.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// `d^j r/du^j` for `j = 0, 1, …`: coordinate-major.
    pub derivatives: Vec<Vec<f64>>,
    /// Tangent, normal and curvature, when asked for.
    pub frames: Option<Vec<Frame>>,
}

/// Evaluates curves, their derivatives up to `order`, and their frames.
///
/// # Errors
/// Too many samples, parameters out of range.
pub fn evaluate(
    app: &App,
    curves: &Curves,
    shapes: &[Matrix],
    parameters: &Parameters,
    order: usize,
    frames: bool,
) -> Result<Vec<Evaluation>, ServiceError> {
    let mut faults = Vec::new();
    if order > MAX_DERIVATIVE {
        faults.push(Fault::new("/derivatives", format!("is {order}, must be 0, 1 or {MAX_DERIVATIVE}")));
    }
    let (count, pointer) = match parameters {
        Parameters::Equidistant(count) => (*count, "/samples"),
        Parameters::At(list) => (list.len(), "/parameters"),
    };
    let values = order.min(MAX_DERIVATIVE) + 1 + if frames { 2 } else { 0 };
    let total = count.saturating_mul(shapes.len()).saturating_mul(values);
    if count == 0 || total > app.limits.samples {
        let detail = format!("asks for {total} values, between 1 and {} are answered", app.limits.samples);
        faults.push(Fault::new(pointer, detail));
    }
    if let Parameters::At(list) = parameters
        && !curves.space.representation().is_closed()
    {
        let outside = list.iter().enumerate().filter(|(_, u)| !(0.0..=1.0).contains(*u));
        let fault = |(i, u): (usize, &f64)| {
            Fault::new(
                format!("/parameters/{i}"),
                format!("is {u}, an open curve has parameters from 0 to 1"),
            )
        };
        faults.extend(outside.map(fault));
    }
    ServiceError::unless_empty(faults)?;
    Ok(shapes
        .par_iter()
        .map(|shape| {
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
        .collect())
}

/// Measures of one curve.
#[derive(Debug, Clone)]
pub struct Measured {
    /// Area, centroid, length, curvature, box.
    pub measures: CurveMeasures,
    /// Planar curves only.
    pub self_intersecting: Option<bool>,
    /// To the reference, when there is one.
    pub distances: Option<Distances>,
}

/// Pairs of intervals over which distances are measured in one request: a minute of work.
const MAX_PAIRS: usize = 10_000_000;

/// Measures curves, and their distances to a reference.
///
/// # Errors
/// Faults of the shapes, and of the reference at `/reference…`; too many distances.
pub fn measure(
    app: &App,
    curves: &Curves,
    shapes: Vec<ShapeInput>,
    reference: Option<ShapeInput>,
) -> Result<Vec<Measured>, ServiceError> {
    let reference = reference.map(|shape| curves.read_one(app, shape, "/reference")).transpose();
    let (shapes, reference) = match (curves.read(app, shapes), reference) {
        (Err(ServiceError::Invalid(mut faults)), Err(ServiceError::Invalid(more))) => {
            faults.extend(more);
            return Err(ServiceError::Invalid(faults));
        }
        (shapes, reference) => (shapes?, reference?),
    };
    let reference = reference.map(|control_points| curves.curve(&control_points));
    let intervals = curves.space.representation().count();
    let pairs = shapes.len().saturating_mul(intervals * intervals);
    if reference.is_some() && pairs > MAX_PAIRS {
        let detail = format!(
            "asks for distances over {pairs} pairs of intervals, at most {MAX_PAIRS} are compared in one request"
        );
        return Err(ServiceError::invalid("/reference", detail));
    }
    Ok(shapes
        .par_iter()
        .map(|shape| {
            let curve = curves.curve(shape);
            Measured {
                measures: CurveMeasures::of(&curve),
                self_intersecting: (curve.dimension() == 2).then(|| self_intersects(&curve)),
                distances: reference.as_ref().map(|reference| Distances::of(&curve, reference)),
            }
        })
        .collect())
}

/// Where resampling starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// At the first point.
    #[default]
    First,
    /// At the canonical start point of the contour.
    Canonical,
}

/// A resampled contour.
#[derive(Debug, Clone)]
pub struct Resampled {
    /// `d`.
    pub dimension: usize,
    /// Coordinate-major points.
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
        let detail = format!("is {count}, must be between {fewest} and {}", app.limits.points);
        faults.push(Fault::new("/count", detail));
    }
    if !closed && start == Start::Canonical {
        faults.push(Fault::new("/start", "an open contour starts at its first point"));
    }
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if count.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("at most {} points are answered over all shapes", app.limits.samples);
        faults.push(Fault::new("/count", detail));
    }
    ServiceError::unless_empty(faults)?;
    each_shape(shapes, |_, shape| {
        let points = raw_points(shape, None, closed, &app.limits)?;
        let dimension = points.ncols();
        let contour = input::contour(points, closed).map_err(below_points)?;
        let from = if start == Start::Canonical { contour.canonical_start() } else { 0.0 };
        let points = contour.sample(count, from).as_slice().to_vec();
        Ok(Resampled { dimension, points, length: contour.length() })
    })
}

/// Applies `work` to every shape; the faults of all of them at `/shapes/{index}…`.
fn each_shape<T: Send>(
    shapes: Vec<ShapeInput>,
    work: impl Fn(usize, ShapeInput) -> Result<T, Vec<InputError>> + Sync,
) -> Result<Vec<T>, ServiceError> {
    let results: Vec<Result<T, Vec<InputError>>> =
        shapes.into_par_iter().enumerate().map(|(index, shape)| work(index, shape)).collect();
    let (mut values, mut faults) = (Vec::with_capacity(results.len()), Vec::new());
    for (index, result) in results.into_iter().enumerate() {
        match result {
            Ok(value) => values.push(value),
            Err(errors) => {
                let placed = errors.into_iter().map(|error| error.below(&format!("/shapes/{index}")));
                faults.extend(placed.map(|error| Fault { index: Some(index), ..error.into() }));
            }
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(values)
}

fn below_points(errors: Vec<InputError>) -> Vec<InputError> {
    errors.into_iter().map(|error| error.below("/points")).collect()
}

/// The points of a shape as they were posted, of `dimension` or of 2 or 3.
fn raw_points(
    shape: ShapeInput,
    dimension: Option<usize>,
    closed: bool,
    limits: &Limits,
) -> Result<Matrix, Vec<InputError>> {
    let points = input::given(&shape.points).cloned();
    let stated = shape.closed.as_ref().and_then(|field| field.get().copied().flatten());
    input::attributes(shape)?;
    let points = points.ok_or_else(|| vec![InputError::new("", "has no points")])?;
    if stated.is_some_and(|stated| stated != closed) {
        let detail = format!(
            "is {}, but contours of this request are {}",
            !closed,
            if closed { "closed" } else { "open" }
        );
        return Err(vec![InputError::new("/closed", detail)]);
    }
    if points.len() > limits.points {
        let detail = format!("has {} points, at most {} are accepted", points.len(), limits.points);
        return Err(vec![InputError::new("/points", detail)]);
    }
    let dimension = dimension.unwrap_or_else(|| points.width().clamp(2, 3));
    let coordinates = points.checked(dimension).map_err(below_points)?;
    Ok(Matrix::from_row_slice(points.len(), dimension, coordinates))
}

/// How large fitted curves are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// As the representation says.
    Given,
    /// As few control points as the largest `L₂` residual allows.
    Tolerance(f64),
}

/// Fits curves to raw contours, in the parameter given (one list a shape) or the arc length.
///
/// # Errors
/// Faults of the input: contours that leave gaps, tolerances that are not reached.
pub fn fit(
    app: &App,
    representation: &Representation,
    size: Size,
    parameters: Option<&[Vec<f64>]>,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<Fit>, ServiceError> {
    let curves = Curves::new(app, representation, Correspondence::Landmarks)?;
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if let Some(lists) = parameters
        && lists.len() != shapes.len()
    {
        let detail = format!("has {} lists for {} shapes", lists.len(), shapes.len());
        return Err(ServiceError::invalid("/parameters", detail));
    }
    let mut faults = Vec::new();
    for (i, list) in parameters.into_iter().flatten().enumerate() {
        let most = if representation.is_closed() { 1.0_f64.next_down() } else { 1.0 };
        let wrong = |j: usize| !(0.0..=most).contains(&list[j]) || (j > 0 && list[j] <= list[j - 1]);
        faults.extend((0..list.len()).find(|&j| wrong(j)).map(|index| {
            let error = GeometryError::Parameter { index, value: list[index] };
            Fault::new(format!("/parameters/{i}/{index}"), error.to_string())
        }));
    }
    ServiceError::unless_empty(faults)?;
    if let Size::Tolerance(tolerance) = size
        && !(tolerance > 0.0)
    {
        let detail =
            format!("is {tolerance}, must be positive: the largest residual in the unit of the points");
        return Err(ServiceError::invalid("/representation/tolerance", detail));
    }
    let closed = representation.is_closed();
    let samples = each_shape(shapes, |index, shape| {
        let points = raw_points(shape, Some(representation.dimension()), closed, &app.limits)?;
        match parameters {
            Some(lists) => given_samples(points, &lists[index], closed),
            None => {
                let contour = input::contour(points, closed).map_err(below_points)?;
                Samples::new(contour.points().clone(), contour.parameters(), closed).map_err(of_contour)
            }
        }
    })?;
    let fits: Vec<Result<Fit, GeometryError>> = samples
        .par_iter()
        .map(|samples| match size {
            Size::Given => samples.fit(&curves.space),
            Size::Tolerance(tolerance) => {
                samples.fit_within(representation, tolerance, app.limits.control_points)
            }
        })
        .collect();
    let (mut found, mut faults) = (Vec::with_capacity(fits.len()), Vec::new());
    for (index, fit) in fits.into_iter().enumerate() {
        match fit {
            Ok(fit) => found.push(fit),
            Err(error) => {
                let fault = Fault::new(format!("/shapes/{index}/points"), error.to_string());
                faults.push(Fault { index: Some(index), ..fault });
            }
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(found)
}

fn of_contour(error: GeometryError) -> Vec<InputError> {
    vec![InputError::new("/points", error.to_string())]
}

fn given_samples(points: Matrix, parameters: &[f64], closed: bool) -> Result<Samples, Vec<InputError>> {
    if parameters.len() != points.nrows() {
        let detail = format!("has {} points for {} parameters", points.nrows(), parameters.len());
        return Err(vec![InputError::new("/points", detail)]);
    }
    Samples::new(points, parameters.to_vec(), closed).map_err(of_contour)
}

/// Largest factor of a refinement.
const MAX_FACTOR: usize = 1024;

/// Refined curves.
#[derive(Debug)]
pub struct Refined {
    /// How it was done, and the finer space.
    pub refinement: Refinement,
    /// Control points and, where the curve is not the same, the `L₂` distance to the one before.
    pub shapes: Vec<(Matrix, Option<f64>)>,
}

/// Refines curves to `factor` times as many knots.
///
/// # Errors
/// A factor that does not fit, too many control points.
pub fn refine(app: &App, curves: &Curves, factor: usize, shapes: &[Matrix]) -> Result<Refined, ServiceError> {
    let representation = curves.space.representation();
    if !(2..=MAX_FACTOR).contains(&factor) {
        let detail = format!("is {factor}, must be between 2 and {MAX_FACTOR}");
        return Err(ServiceError::invalid("/factor", detail));
    }
    let generator = representation.generator();
    if generator.is_some_and(|generator| generator.needs_even_factors()) && factor % 2 == 1 {
        let detail =
            format!("is {factor}, must be even: half-integer shifts fall between the knots of an odd split");
        return Err(ServiceError::invalid("/factor", detail));
    }
    let count = representation.count().saturating_mul(factor);
    if count > app.limits.control_points {
        let detail = format!(
            "asks for {count} {}, at most {} are accepted",
            representation.count_field(),
            app.limits.control_points
        );
        return Err(ServiceError::invalid("/factor", detail));
    }
    if count.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("at most {} control points are answered over all shapes", app.limits.samples);
        return Err(ServiceError::invalid("/factor", detail));
    }
    let refinement = Refinement::new(&curves.space, factor)
        .map_err(|error| ServiceError::invalid("/representation/generator", error.to_string()))?;
    let shapes = shapes
        .par_iter()
        .map(|shape| {
            let fine = refinement.apply(shape);
            let change = (!refinement.is_exact()).then(|| {
                Curve::of(refinement.space(), &fine).map_or(0.0, |curve| l2(&curves.curve(shape), &curve))
            });
            (fine, change)
        })
        .collect();
    Ok(Refined { refinement, shapes })
}

/// An idealised curve in its place.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    /// The curve.
    pub curve: IdealCurve,
    /// Where it lies.
    pub position: Position,
}

/// Largest coordinate of an idealised curve: what is answered can be posted.
const MAX_COORDINATE: f64 = 1e100;

/// Exact control points of idealised curves.
///
/// # Errors
/// Curves that the generator does not reproduce, with the poles that are missing.
pub fn idealise(app: &App, curves: &Curves, wanted: &[Placed]) -> Result<Vec<Matrix>, ServiceError> {
    let representation = curves.space.representation();
    let mut faults = Vec::new();
    if wanted.is_empty() {
        faults.push(Fault::new("/curves", "has no entries, at least 1 is needed"));
    }
    if wanted.len().saturating_mul(curves.metric.size()) > app.limits.samples {
        let detail = format!("at most {} control points are answered over all curves", app.limits.samples);
        faults.push(Fault::new("/curves", detail));
    }
    for (index, Placed { curve, position }) in wanted.iter().enumerate() {
        let mut fault = |detail: String| {
            let fault = Fault::new(format!("/curves/{index}/curve"), detail);
            faults.push(Fault { index: Some(index), ..fault });
        };
        if let Some(detail) = curve.fault() {
            fault(detail.into());
            continue;
        }
        if representation.is_closed() && !curve.is_closed() {
            fault("does not close: use an open_curve".into());
            continue;
        }
        let missing = curve.missing(position, &curves.space);
        if !missing.is_empty() {
            fault(format!("is not reproduced by the generator: {}", missing_poles(&missing)));
        }
    }
    ServiceError::unless_empty(std::mem::take(&mut faults))?;
    let made = |placed: &Placed| placed.curve.control_points(&placed.position, &curves.space);
    let shapes: Vec<Matrix> = wanted.iter().map(made).collect();
    for (index, shape) in shapes.iter().enumerate() {
        if !shape.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            let fault = Fault::new(format!("/curves/{index}"), format!("leaves ±{MAX_COORDINATE:e}"));
            faults.push(Fault { index: Some(index), ..fault });
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(shapes)
}

fn missing_poles(missing: &[([f64; 2], usize)]) -> String {
    let name = |(pole, times): &([f64; 2], usize)| match (*pole, *times) {
        ([0.0, 0.0], 1) => "0".to_owned(),
        ([0.0, 0.0], times) => format!("0 ({times} times)"),
        ([0.0, im], _) => format!("±{im}i"),
        ([re, _], _) => format!("±{re}"),
    };
    let list: Vec<String> = missing.iter().map(name).collect();
    format!("among its domain_poles must be {}", list.join(", "))
}

/// The kind of path between two shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// The straight line `(1 − τ) r_1 + τ r_2`.
    #[default]
    Plane,
    /// The great circle between the shapes scaled to unit `L₂` norm.
    Sphere,
}

/// A path between two shapes.
#[derive(Debug)]
pub struct Morph {
    /// `τ` and control points of every frame.
    pub frames: Vec<(f64, Matrix)>,
    /// Angle between the shapes in radians, on the sphere.
    pub angle: Option<f64>,
}

/// Where on a path.
#[derive(Debug, Clone, PartialEq)]
pub enum Positions {
    /// Equally spaced from 0 to 1, at least two.
    Steps(usize),
    /// At these.
    At(Vec<f64>),
}

/// Most frames of an animation.
const MAX_FRAMES: usize = 1000;

/// Largest extrapolation.
const MAX_POSITION: f64 = 1000.0;

/// Shapes at `positions` of the path from one shape to another.
///
/// # Errors
/// Faults of the shapes at `/from…` and `/to…`, of the positions; opposite shapes.
pub fn morph(
    app: &App,
    curves: &Curves,
    kind: PathKind,
    positions: &Positions,
    from: ShapeInput,
    to: ShapeInput,
) -> Result<Morph, ServiceError> {
    let mut faults = Vec::new();
    let (positions, pointer) = match positions {
        Positions::At(list) => (list.clone(), "/positions"),
        Positions::Steps(count) => {
            ((0..*count).map(|i| i as f64 / (count - 1) as f64).collect::<Vec<f64>>(), "/steps")
        }
    };
    let total = positions.len().saturating_mul(curves.metric.size());
    if positions.is_empty() || total > app.limits.samples {
        let detail = format!(
            "asks for {total} control points, between 1 and {} are answered over all positions",
            app.limits.samples
        );
        faults.push(Fault::new(pointer, detail));
    }
    let wild = positions.iter().enumerate().filter(|(_, tau)| !(tau.abs() <= MAX_POSITION));
    faults.extend(wild.map(|(i, tau)| {
        Fault::new(format!("/positions/{i}"), format!("is {tau}, must be within ±{MAX_POSITION}"))
    }));
    let mut read = |shape, pointer: &str| match curves.read_one(app, shape, pointer) {
        Ok(matrix) => Some(matrix.as_slice().to_vec()),
        Err(ServiceError::Invalid(found)) => {
            faults.extend(found);
            None
        }
        Err(_) => None,
    };
    let shapes = (read(from, "/from"), read(to, "/to"));
    ServiceError::unless_empty(faults)?;
    let (Some(first), Some(second)) = shapes else {
        return Err(ServiceError::Internal("a shape without control points and faults".into()));
    };
    let path = match kind {
        PathKind::Plane => Path::plane(first, second),
        PathKind::Sphere => Path::sphere(&curves.metric, first, second).map_err(|error| {
            let pointer = |index: usize| if index == 0 { "/from".to_owned() } else { "/to".to_owned() };
            ServiceError::of_analysis(error, pointer).without_index()
        })?,
    };
    let frames = positions.iter().map(|&tau| (tau, curves.matrix(&path.at(tau)))).collect();
    Ok(Morph { frames, angle: path.angle() })
}

/// Animated picture of a path, through its frames and back.
///
/// # Errors
/// Too many frames.
pub fn draw_morph(curves: &Curves, title: &str, morph: &Morph) -> Result<String, ServiceError> {
    if morph.frames.len() > MAX_FRAMES {
        let detail = format!("has {} entries, at most {MAX_FRAMES} are drawn", morph.frames.len());
        return Err(ServiceError::invalid("/positions", detail));
    }
    let shapes = morph.frames.iter().map(|(_, shape)| shape.as_slice());
    Ok(svg::animate(title, &Layer::of(&curves.space, shapes, colour::MAIN, 2.5, 1.0)))
}
