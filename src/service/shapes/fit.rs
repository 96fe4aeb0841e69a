//! Fits of shapes to posted points and meshes. The function is synchronous and runs on the pool.

use super::each::each_of;
use super::outcome::{OnError, Outcomes};
use super::read_mesh::{MeshInput, PostedMesh};
use super::read_points::{below_points, posted_list, raw_points};
use super::request::{Posted, check_curves};
use crate::analysis::correspondence::Correspondence;
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::capability::fit::{FitSettings, FitTarget, Fitted, Fitter, PointPlaces};
use crate::geometry::field_fault::FieldFault;
use crate::geometry::representation::Representation;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// A representation to fit, and how.
#[derive(Debug)]
pub struct FitTask {
    /// Representation of the fitted shapes.
    pub representation: Admitted,
    /// Largest residual of a curve or a surface with parameters, whose size is then chosen.
    pub tolerance: Option<f64>,
    /// PointPlaces of the points, one entry per shape.
    pub places: Option<Vec<PointPlaces>>,
    /// Number of rounds for refined meshes.
    pub turns: usize,
    /// Initial shape of all fits of refined meshes.
    pub start: Option<ShapeInput>,
    /// Treatment of entries that cannot be fitted.
    pub on_error: OnError,
}

/// Targets of fits.
#[derive(Debug)]
pub enum FitInputs {
    /// Contours, grids or lists of points.
    Shapes(Vec<ShapeInput>),
    /// Triangle meshes.
    Meshes(Vec<MeshInput>),
}

impl FitInputs {
    fn count(&self) -> usize {
        match self {
            Self::Shapes(shapes) => shapes.len(),
            Self::Meshes(meshes) => meshes.len(),
        }
    }

    /// Name of the list in the request.
    fn list(&self) -> &'static str {
        match self {
            Self::Shapes(_) => "shapes",
            Self::Meshes(_) => "meshes",
        }
    }
}

/// Default number of rounds.
pub const USUAL_TURNS: usize = 20;
/// Maximum number of rounds.
pub const MAX_TURNS: usize = 200;

/// Maximum number of multiply-adds for the normal equations of a request: a minute of work.
const MAX_OPERATIONS: f64 = 1e11;

/// Number of sizes up to the largest one that a search for a tolerance may solve for, as multiples of that one: the doublings together are
/// little more than one, and a bisection has six steps at most.
pub const SIZES_TRIED: f64 = 8.0;

/// Maximum number of control points of `count` surfaces with parameters under a tolerance, so that their equations are solved within the
/// bound of a request.
pub fn most_within_tolerance(count: usize) -> usize {
    (3.0 * MAX_OPERATIONS / (SIZES_TRIED * count.max(1) as f64)).cbrt() as usize
}

impl FitTask {
    /// Fits a shape to every entry of `inputs`. All entries are read before the space is prepared, which may take far more
    /// memory than they do.
    ///
    /// # Errors
    /// Faults of the input: points that leave gaps, tolerances that are not reached, fits that are folded or diverge; too
    /// much work. Under [`OnError::Skip`] those of a single entry are among the outcomes.
    pub fn fit(self, app: &App, inputs: FitInputs) -> Result<Outcomes<Fitted>, ServiceError> {
        check_curves(&self.representation)?;
        if inputs.count() == 0 {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        check_places(self.representation.domain(), self.places.as_deref(), inputs.count())?;
        check_tolerance(self.tolerance)?;
        let (list, on_error) = (inputs.list(), self.on_error);
        let targets = read_targets(app, &self.representation, self.places, inputs)?.checked(on_error)?;
        let posted = Posted::new(app, &self.representation, Correspondence::Landmarks)?;
        let mut most = app.limits.control_points;
        if self.tolerance.is_some() && posted.space.domain().is_sheet() {
            most = most.min(most_within_tolerance(targets.len()));
        }
        check_work(&posted, list, targets.len(), self.turns)?;
        let start = self.start.map(|shape| posted.read_one(app, shape, "/start")).transpose()?;
        let settings =
            FitSettings { tolerance: self.tolerance, max_control_points: most, turns: self.turns, start };
        let fitter = Fitter::new(&posted.space, settings)
            .map_err(|error| ServiceError::invalid("/representation/kind", error.to_string()))?;
        if fitter.lacks_start() {
            let detail =
                "required field is missing: only control meshes named after a body have a start of their own";
            return Err(ServiceError::invalid("/start", detail));
        }
        let context = app.pool.context();
        let stop = || context.is_cancelled();
        let fits = targets.each(&context, |index, target| {
            let fitted = fitter.fit(target, &stop);
            fitted.map_err(|found| ServiceError::of_entry(list, index, faults(found)))
        });
        fits?.checked(on_error)
    }
}

/// Reads every entry of `inputs`.
fn read_targets(
    app: &App,
    representation: &Representation,
    places: Option<Vec<PointPlaces>>,
    inputs: FitInputs,
) -> Result<Outcomes<FitTarget>, ServiceError> {
    let context = app.pool.context();
    match inputs {
        FitInputs::Shapes(shapes) => each_of(&context, "shapes", shapes, |index, shape| {
            let (points, usual) = read_target(shape, representation, &app.limits)?;
            let places = places.as_ref().map_or(usual, |lists| lists[index].clone());
            Ok(FitTarget::Points { points, places })
        }),
        FitInputs::Meshes(meshes) => each_of(&context, "meshes", meshes, |_, mesh| {
            let PostedMesh { mesh, source } = PostedMesh::read(mesh, &app.limits)?;
            Ok(FitTarget::Mesh { mesh, source })
        }),
    }
}

fn faults(found: Vec<FieldFault>) -> Vec<Fault> {
    found.into_iter().map(Fault::from).collect()
}

/// Checks the total work of `count` fits to the entries of `list`.
fn check_work(posted: &Posted, list: &str, count: usize, turns: usize) -> Result<(), ServiceError> {
    let operations = posted.space.fit_operations(count, turns).unwrap_or(0.0);
    if operations <= MAX_OPERATIONS {
        return Ok(());
    }
    let fewer = if posted.space.domain().is_mesh() { "turns or control points" } else { "control points" };
    let detail = format!(
        "expected at most {MAX_OPERATIONS:.0e} multiply-adds for all fits, got {operations:.0e} ({count} \
         entries): send fewer entries, or use fewer {fewer}"
    );
    Err(ServiceError::invalid(format!("/{list}"), detail))
}

/// Checks that there is a list of places for each shape, and its parameters.
fn check_places(domain: Domain, places: Option<&[PointPlaces]>, count: usize) -> Result<(), ServiceError> {
    let Some(lists) = places else { return Ok(()) };
    if lists.len() != count {
        let detail = format!("expected one list per shape ({count}), got {}", lists.len());
        return Err(ServiceError::invalid("/parameters", detail));
    }
    let faults = lists.iter().enumerate().flat_map(|(i, list)| {
        let found = domain.place_faults(list).into_iter();
        found.map(move |fault| Fault::from(fault).below(&format!("/parameters/{i}")))
    });
    ServiceError::unless_empty(faults.collect())
}

fn check_tolerance(tolerance: Option<f64>) -> Result<(), ServiceError> {
    match tolerance {
        Some(tolerance) if !(tolerance > 0.0) => {
            let detail = format!(
                "expected a positive number (a bound of the root mean square distance, in the unit of the \
                 points), got {tolerance}"
            );
            Err(ServiceError::invalid("/representation/tolerance", detail))
        }
        _ => Ok(()),
    }
}

/// Points to fit, and their places if these are not given.
fn read_target(
    shape: ShapeInput,
    representation: &Representation,
    limits: &Limits,
) -> Result<(Matrix, PointPlaces), Vec<Fault>> {
    let domain = representation.domain();
    if let Domain::Line { closed } = domain {
        let points = raw_points(shape, Some(representation.dimension()), closed, limits)?;
        return Ok((points, PointPlaces::Free));
    }
    let list = posted_list(shape)?;
    let coordinates = list.checked(3).map_err(below_points)?;
    let (count, most) = (list.len(), limits.points);
    let fewest = representation.size();
    if domain.is_mesh() && !(fewest..=most).contains(&count) {
        let detail = format!(
            "expected between {fewest} and {most} points (at least as many as control points), got {count}"
        );
        return Err(vec![Fault::new("/points", detail)]);
    }
    if count > most {
        let detail = format!("expected at most {most} points, got {count}");
        return Err(vec![Fault::new("/points", detail)]);
    }
    let places = list.grid().map_or(PointPlaces::Free, PointPlaces::Grid);
    Ok((Matrix::from_row_slice(count, 3, coordinates), places))
}
