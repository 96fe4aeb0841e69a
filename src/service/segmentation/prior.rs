//! The shape prior without an image: how far shapes are from the class of a posted reference.

use std::ops::Range;

use crate::analysis::AnalysisError;
use crate::analysis::alignment::Method;
use crate::analysis::matching::{Placement, Target};
use crate::analysis::mean::MeanSpace;
use crate::analysis::metric::Metric;
use crate::segmentation::boundary::Differential;
use crate::segmentation::energy::Prior;
use crate::segmentation::frame::Frame;
use crate::segmentation::snake::Model;
use crate::segmentation::snake::kind::SpaceModel;
use crate::service::app::{App, ServiceError};
use crate::service::shapes::directions::Ways;
use crate::service::shapes::outcome::{OnError, Outcomes, of_shape};
use crate::service::shapes::read;
use crate::service::statistics::{CheckedSettings, Setup};
use crate::wire::fault::Fault;
use crate::wire::shape::{Points, ShapeInput};

/// Range of weights.
const WEIGHTS: Range<f64> = 0.0..1e9;
/// Cells along the longest side of a shape, for each control point of a curve and for the root of their number of a surface: the faces of
/// cylinders and meshes have about the size of a cell. The interior of curves, spheres and tori does not depend on it.
const CELLS: [f64; 2] = [16.0, 8.0];

/// The prior energy of a shape.
#[derive(Debug, Clone)]
pub struct PriorEnergy {
    /// `E = γ d²/|V|^{2/d}`; for shapes that enclose nothing, `γ d²/‖c − c̄‖²`.
    pub energy: f64,
    /// `∂E/∂c` of the free points.
    pub gradient: Points,
    /// `d²`, the squared distance to the nearest member of the class.
    pub squared_distance: f64,
    /// `V`: enclosed area or volume, negative for a shape of the other direction; `None` for shapes that enclose nothing.
    pub volume: Option<f64>,
    /// Placement of the shape that fits the reference best.
    pub placement: Placement,
}

/// Prior energies of shapes. The start point, the direction and the mirror image of each are those that fit the reference best, as
/// far as the settings search for them. With them a warning of contours drawn both ways round, if that matters.
///
/// # Errors
/// A weight out of range, at `/weight`; enclosing shapes without a model, at `/representation`; faults of the input. Under
/// [`OnError::Skip`] those of the shapes are among the outcomes.
pub fn energies(
    app: &App,
    settings: CheckedSettings,
    weight: f64,
    reference: ShapeInput,
    (shapes, on_error): (Vec<ShapeInput>, OnError),
) -> Result<(Outcomes<PriorEnergy>, Option<String>), ServiceError> {
    if !WEIGHTS.contains(&weight) {
        let detail = format!("expected a number between 0 and {:e}, got {weight}", WEIGHTS.end);
        return Err(ServiceError::invalid("/weight", detail));
    }
    let setup = Setup::new(app, settings.of_a_prior())?;
    let model = match setup.space.enclosure() {
        Ok(_) => Some(SpaceModel::new(&setup.space)),
        Err(_) => None,
    };
    let model = model.transpose();
    let model = model.map_err(|fault| ServiceError::below(vec![Fault::from(fault)], "/representation"))?;
    let reading = setup.reading(&app.limits);
    let (reference, shapes) = read::read_with_reference(&reading, reference, (shapes, on_error))?;
    let mixed = setup.rule().warning(Ways::of_each(&setup.space, &reference, &shapes));
    let found = match (&model, setup.metric.dimension()) {
        (Some(SpaceModel::Plane(model)), _) => of_all(app, &setup, Some(&**model), weight, reference, shapes),
        (Some(SpaceModel::Space(model)), _) => of_all(app, &setup, Some(&**model), weight, reference, shapes),
        (None, 2) => of_all::<2>(app, &setup, None, weight, reference, shapes),
        (None, _) => of_all::<3>(app, &setup, None, weight, reference, shapes),
    };
    Ok((found?.checked(on_error)?, mixed))
}

fn of_all<const D: usize>(
    app: &App,
    setup: &Setup,
    model: Option<&dyn Model<D>>,
    weight: f64,
    reference: Vec<f64>,
    shapes: Outcomes<(Vec<f64>, f64)>,
) -> Result<Outcomes<PriorEnergy>, ServiceError> {
    // A reference without extent is refused even if all shapes are.
    Prior::<D>::new(setup.metric.clone(), setup.method.clone(), &rows(&reference), None, Frame::identity())
        .map_err(|error| at_reference(error, "/reference"))?;
    with_target(setup, &reference, "/reference", |target| {
        let one = Measured { setup, model, weight, reference: &reference, target };
        shapes.each(&app.pool.context(), |index, (shape, _)| {
            let found = one.energy(&shape).map_err(|error| of_shape(index, error))?;
            found.ok_or_else(|| no_volume(index))
        })
    })?
}

fn no_volume(index: usize) -> ServiceError {
    let detail = "expected a shape with an extent that encloses an area or a volume if it is closed, got one that does not";
    ServiceError::Invalid(vec![Fault::new(format!("/shapes/{index}"), detail).at_shape(index)].into())
}

fn at_reference(error: AnalysisError, pointer: &str) -> ServiceError {
    ServiceError::from_analysis(error, |_| pointer.into()).without_index()
}

/// Calls `search` with the class of a reference at `pointer`, for which the placements of shapes are searched.
///
/// # Errors
/// A reference without extent, or with less than the class needs.
pub(super) fn with_target<T>(
    setup: &Setup,
    reference: &[f64],
    pointer: &str,
    search: impl FnOnce(&Target<'_>) -> T,
) -> Result<T, ServiceError> {
    let reference = prepared(setup, reference);
    match &setup.method {
        Method::Procrustes(fit) => Ok(search(&Target::shape(&reference, *fit, &setup.matching))),
        Method::Projection(class) => {
            let space = MeanSpace::from_shape(class, &reference);
            let space = space.map_err(|error| at_reference(error, pointer))?;
            Ok(search(&Target::subspace(&space, &setup.matching)))
        }
    }
}

/// The shape with its control points in the order in which it fits a target best; unchanged if it has no extent.
pub(super) fn begun(setup: &Setup, target: &Target<'_>, control_points: Vec<f64>) -> Vec<f64> {
    let placement = setup.matching.best(&prepared(setup, &control_points), target, Placement::default());
    let Ok(placement) = placement else { return control_points };
    let order = order(setup, placement);
    let coordinates = control_points.chunks_exact(order.len());
    coordinates.flat_map(|coordinate| order.iter().map(|k| coordinate[*k])).collect()
}

/// A whitened shape, centred if the class translates.
fn prepared(setup: &Setup, control_points: &[f64]) -> Vec<f64> {
    let mut shape = control_points.to_vec();
    if setup.method.translates() {
        setup.metric.centre(&mut shape);
    }
    setup.metric.whiten(&mut shape);
    shape
}

struct Measured<'a, const D: usize> {
    setup: &'a Setup,
    /// The model by which the shapes enclose a region, if they do.
    model: Option<&'a dyn Model<D>>,
    weight: f64,
    reference: &'a [f64],
    target: &'a Target<'a>,
}

impl<const D: usize> Measured<'_, D> {
    /// The energy of a shape; `None` without volume, or without extent.
    fn energy(&self, control_points: &[f64]) -> Result<Option<PriorEnergy>, AnalysisError> {
        let setup = self.setup;
        let placement =
            setup.matching.best(&prepared(setup, control_points), self.target, Placement::default())?;
        let order = order(setup, placement);
        let sign = |c: usize| if placement.mirrored && c == 0 { -1.0 } else { 1.0 };
        let given: Vec<[f64; D]> = rows(control_points);
        let placed: Vec<[f64; D]> =
            order.iter().map(|k| std::array::from_fn(|c| sign(c) * given[*k][c])).collect();
        let (frame, free, volume) = match self.model {
            Some(model) => {
                let Some(frame) = frame(&placed) else { return Ok(None) };
                let in_cells: Vec<[f64; D]> = placed.iter().map(|point| frame.to_index(*point)).collect();
                let free = model.free_points(&in_cells);
                let boundary = model.exact(&free, frame);
                let volume = boundary.volume(&boundary.sample(&free));
                (frame, free, volume)
            }
            None => {
                let extent = extent(&setup.metric, &placed);
                (Frame::identity(), placed, extent)
            }
        };
        let (metric, method) = (setup.metric.clone(), setup.method.clone());
        let lift = self.model.and_then(|model| model.lift());
        let prior = Prior::new(metric, method, &rows(self.reference), lift, frame)?;
        let Some(energy) = prior.relative(&free, &volume) else { return Ok(None) };
        let mut gradient = vec![[0.0; D]; free.len()];
        for (k, slope) in energy.gradient.iter().enumerate() {
            let slope = frame.gradient_to_world(*slope);
            gradient[order[k]] = std::array::from_fn(|c| self.weight * sign(c) * slope[c]);
        }
        Ok(Some(PriorEnergy {
            energy: self.weight * energy.value,
            gradient: Points::from_columns(
                (0..D).flat_map(|c| gradient.iter().map(move |row| row[c])).collect(),
                D,
            ),
            squared_distance: energy.value * volume.value.abs().powf(2.0 / D as f64),
            volume: self.model.map(|_| volume.value * if placement.mirrored { -1.0 } else { 1.0 }),
            placement,
        }))
    }
}

/// `S^{d/2}` for `S = ‖c − c̄‖²`, with its gradient `d S^{d/2 − 1} Φ (c − c̄)`: stands for the volume of shapes that enclose nothing, so
/// that energies are relative to `S`.
fn extent<const D: usize>(metric: &Metric, points: &[[f64; D]]) -> Differential<D> {
    let mut shape: Vec<f64> = (0..D).flat_map(|c| points.iter().map(move |point| point[c])).collect();
    metric.centre(&mut shape);
    let square = metric.inner(&shape, &shape);
    metric.apply(&mut shape);
    let half = 0.5 * D as f64;
    let slope = D as f64 * square.powf(half - 1.0);
    let gradient = rows::<D>(&shape).into_iter().map(|row| row.map(|value| slope * value)).collect();
    Differential { value: square.powf(half), gradient }
}

/// The positions of the control points of a shape in the order of a placement.
fn order(setup: &Setup, placement: Placement) -> Vec<usize> {
    let count = setup.metric.size();
    // Reversal permutes control points, here their positions.
    let mut order: Vec<f64> = (0..count).map(|k| k as f64).collect();
    if placement.reversed {
        setup.space.reverse(&mut order);
    }
    order.rotate_left(placement.shift as usize % count.max(1));
    order.into_iter().map(|position| position as usize).collect()
}

/// A frame in which a shape has as many cells as integrals over it need; `None` for a shape without extent.
fn frame<const D: usize>(points: &[[f64; D]]) -> Option<Frame<D>> {
    let along = |c: usize| points.iter().map(move |point| point[c]);
    let side = |c: usize| along(c).fold(f64::MIN, f64::max) - along(c).fold(f64::MAX, f64::min);
    let longest = (0..D).map(side).fold(0.0, f64::max);
    let count = points.len() as f64;
    let cells = if D == 2 { CELLS[0] * count } else { CELLS[1] * count.sqrt() };
    let spacing = longest / cells;
    Frame::new(std::array::from_fn(|r| std::array::from_fn(|c| if r == c { spacing } else { 0.0 })), [0.0; D])
        .ok()
        .filter(|_| spacing > 0.0)
}

/// Coordinate-major control points as rows.
fn rows<const D: usize>(control_points: &[f64]) -> Vec<[f64; D]> {
    let count = control_points.len() / D;
    (0..count).map(|k| std::array::from_fn(|c| control_points[c * count + k])).collect()
}
