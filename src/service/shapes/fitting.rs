//! Fits of raw contours, refinement, and idealised shapes. The functions are synchronous and run on the pool.
//!
//! Curves are fitted at the size of their representation, or at the smallest size that meets a tolerance. Refinement
//! multiplies the number of knots, exactly where the generator allows it.

use super::curves::{below_points, each, each_shape, raw_points};
use super::request::Posted;
use super::surfaces::PlacedSurface;
use super::{read, surfaces};
use crate::analysis::correspondence::Correspondence;
use crate::formats::fault::Fault;
use crate::formats::shape::{MAX_COORDINATE, ShapeInput};
use crate::geometry::GeometryError;
use crate::geometry::curve::Curve;
use crate::geometry::distance::l2;
use crate::geometry::fit::{Fit, Samples};
use crate::geometry::ideal::{IdealCurve, Position};
use crate::geometry::refine::Refinement;
use crate::geometry::representation::Representation;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};

/// Size of fitted curves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// The size of the representation.
    Given,
    /// The smallest number of control points whose `L₂` residual (the root mean square distance) is within this
    /// tolerance.
    Tolerance(f64),
}

/// Fits curves to raw contours, in given parameters (one list per shape) or in arc length.
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
    let curves = Posted::of_curves(app, representation, Correspondence::Landmarks)?;
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if let Some(lists) = parameters
        && lists.len() != shapes.len()
    {
        let detail = format!("expected one list per shape ({1}), got {0}", lists.len(), shapes.len());
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
        let detail = format!(
            "expected a positive number (a bound of the root mean square distance, in the unit of the points), \
             got {tolerance}"
        );
        return Err(ServiceError::invalid("/representation/tolerance", detail));
    }
    let closed = representation.is_closed();
    let context = app.pool.context();
    let samples = each_shape(&context, shapes, |index, shape| {
        let points = raw_points(shape, Some(representation.dimension()), closed, &app.limits)?;
        match parameters {
            Some(lists) => given_samples(points, &lists[index], closed),
            None => {
                let contour = read::contour(points, closed).map_err(below_points)?;
                Samples::new(contour.points().clone(), contour.parameters(), closed).map_err(of_contour)
            }
        }
    })?;
    let fits: Vec<Result<Fit, GeometryError>> = each(&context, &samples, |samples| match size {
        Size::Given => samples.fit(&curves.space),
        Size::Tolerance(tolerance) => {
            let stop = || context.is_cancelled();
            samples.fit_within_until(representation, tolerance, app.limits.control_points, &stop)
        }
    })?;
    let (mut found, mut faults) = (Vec::with_capacity(fits.len()), Vec::new());
    for (index, fit) in fits.into_iter().enumerate() {
        match fit {
            Ok(fit) => found.push(fit),
            Err(error) => {
                let fault = Fault::new(format!("/shapes/{index}/points"), error.to_string());
                faults.push(fault.of_shape(index));
            }
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(found)
}

fn of_contour(error: GeometryError) -> Vec<Fault> {
    vec![Fault::new("/points", error.to_string())]
}

fn given_samples(points: Matrix, parameters: &[f64], closed: bool) -> Result<Samples, Vec<Fault>> {
    if parameters.len() != points.nrows() {
        let detail =
            format!("expected one point per parameter ({1}), got {0}", points.nrows(), parameters.len());
        return Err(vec![Fault::new("/points", detail)]);
    }
    Samples::new(points, parameters.to_vec(), closed).map_err(of_contour)
}

/// Maximum factor of a refinement.
const MAX_FACTOR: usize = 1024;

/// Refined curves.
#[derive(Debug)]
pub struct Refined {
    /// The refinement: its method and the finer space.
    pub refinement: Refinement,
    /// Control points and, if the refinement is not exact, the `L₂` distance to the original curve.
    pub shapes: Vec<(Matrix, Option<f64>)>,
}

/// Refines curves to `factor` times as many knots.
///
/// # Errors
/// A factor that does not fit; too many control points.
pub fn refine(app: &App, curves: &Posted, factor: usize, shapes: &[Matrix]) -> Result<Refined, ServiceError> {
    let representation = curves.space.representation();
    if !(2..=MAX_FACTOR).contains(&factor) {
        let detail = format!("expected a number between 2 and {MAX_FACTOR}, got {factor}");
        return Err(ServiceError::invalid("/factor", detail));
    }
    let generator = representation.generator();
    if generator.is_some_and(|generator| generator.needs_even_factors()) && factor % 2 == 1 {
        let detail = format!(
            "expected an even number, got {factor}: half-integer shifts fall between the knots of an odd split"
        );
        return Err(ServiceError::invalid("/factor", detail));
    }
    let count = representation.count().saturating_mul(factor);
    if count > app.limits.control_points {
        let detail = format!(
            "expected at most {1} {0} after refinement, got {count}",
            representation.knots()[0].field,
            app.limits.control_points
        );
        return Err(ServiceError::invalid("/factor", detail));
    }
    if count.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} control points over all shapes", app.limits.samples);
        return Err(ServiceError::invalid("/factor", detail));
    }
    let refinement = Refinement::new(&curves.space, factor)
        .map_err(|error| ServiceError::invalid("/representation/generator", error.to_string()))?;
    let shapes = each(&app.pool.context(), shapes, |shape| {
        let fine = refinement.apply(shape);
        let change = (!refinement.is_exact()).then(|| {
            Curve::of(refinement.space(), &fine).map_or(0.0, |curve| l2(&curves.curve(shape), &curve))
        });
        (fine, change)
    })?;
    Ok(Refined { refinement, shapes })
}

/// An idealised shape with its position.
#[derive(Debug, Clone, Copy)]
pub enum Placed {
    /// A curve.
    Curve(PlacedCurve),
    /// A surface.
    Surface(PlacedSurface),
}

/// An idealised curve with its position.
#[derive(Debug, Clone, Copy)]
pub struct PlacedCurve {
    /// The curve.
    pub curve: IdealCurve,
    /// Position of the curve.
    pub position: Position,
}

/// Exact control points of idealised curves or surfaces.
///
/// # Errors
/// Shapes that the generators do not reproduce; for curves, with the missing poles.
pub fn idealise(app: &App, posted: &Posted, wanted: &[Placed]) -> Result<Vec<Matrix>, ServiceError> {
    let (list, name) = if posted.is_of_surfaces() { ("surfaces", "surface") } else { ("curves", "curve") };
    let refused = |detail: String| Err(ServiceError::invalid(format!("/{list}"), detail));
    if wanted.is_empty() {
        return refused("expected at least 1 entry, got none".into());
    }
    if wanted.len().saturating_mul(posted.metric.size()) > app.limits.samples {
        return refused(format!("expected at most {} control points over all entries", app.limits.samples));
    }
    let (mut shapes, mut faults) = (Vec::with_capacity(wanted.len()), Vec::new());
    for (index, placed) in wanted.iter().enumerate() {
        let made = match placed {
            Placed::Curve(placed) => idealise_curve(posted, placed),
            Placed::Surface(placed) => surfaces::idealise(posted, placed),
        };
        let made =
            made.map_err(|detail| (format!("/{list}/{index}/{name}"), detail)).and_then(|shape: Matrix| {
                let inside = shape.iter().all(|value| value.abs() <= MAX_COORDINATE);
                inside.then_some(shape).ok_or_else(|| {
                    (format!("/{list}/{index}"), format!("expected coordinates within ±{MAX_COORDINATE:e}"))
                })
            });
        match made {
            Ok(shape) => shapes.push(shape),
            Err((pointer, detail)) => faults.push(Fault::new(pointer, detail).of_shape(index)),
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(shapes)
}

fn idealise_curve(posted: &Posted, PlacedCurve { curve, position }: &PlacedCurve) -> Result<Matrix, String> {
    if let Some(detail) = curve.fault() {
        return Err(detail.into());
    }
    if posted.space.representation().is_closed() && !curve.is_closed() {
        return Err("the curve does not close: use an open_curve".into());
    }
    let missing = curve.missing(position, &posted.space);
    if !missing.is_empty() {
        return Err(format!("the generator does not reproduce this curve: {}", missing_poles(&missing)));
    }
    Ok(curve.control_points(position, &posted.space))
}

fn missing_poles(missing: &[([f64; 2], usize)]) -> String {
    let name = |(pole, times): &([f64; 2], usize)| match (*pole, *times) {
        ([0.0, 0.0], 1) => "0".to_owned(),
        ([0.0, 0.0], times) => format!("0 ({times} times)"),
        ([0.0, im], _) => format!("±{im}i"),
        ([re, _], _) => format!("±{re}"),
    };
    let list: Vec<String> = missing.iter().map(name).collect();
    format!("expected {} among its domain_poles", list.join(", "))
}
