//! Initial shapes: posted, those that fill boxes or lie around seed points, and those of the components of a mask.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::contours::{self, ComponentOutput, ContoursAnswer, LabelBoundary, RegionOutput};
use super::image::{Coordinates, Part};
use super::kinds::Kind;
use super::request::BoxInput;
use super::wanted::size;
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::geometry::resample::RepeatedPoints;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::shapes::read::read_shape;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;
use crate::wire::image::Grid;
use crate::wire::shape::ShapeInput;

/// Usual radius around a seed point, as a part of the shortest side of the image.
const USUAL_RADIUS: f64 = 0.1;
/// Least usual radius in cells: at the usual first blur of two cells, an object that is smaller has no inside.
const LEAST_RADIUS: f64 = 4.0;

/// Point in an object, in the coordinates of the request. The initial shape is the largest ellipse, ellipsoid, cylinder or torus of
/// the square or cube around it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SeedInput {
    /// The point.
    #[schema(min_items = 2, max_items = 3)]
    pub at: Vec<f64>,
    /// Half of the side of the square or cube. Default: a tenth of the shortest side of the image, at least four cells.
    #[serde(default)]
    #[schema(exclusive_minimum = 0)]
    pub radius: Option<f64>,
}

impl SeedInput {
    /// The square or cube around the point.
    fn around(&self, usual_radius: f64) -> BoxInput {
        let radius = self.radius.unwrap_or(usual_radius);
        let corner = |side: f64| self.at.iter().map(|x| x + side * radius).collect();
        BoxInput { lower: corner(-1.0), upper: corner(1.0) }
    }

    /// Faults of the seed for shapes of a dimension, with pointers relative to it.
    fn faults(&self, dimension: usize) -> Vec<Fault> {
        let most = crate::numeric::MAX_NUMBER;
        let mut faults = Vec::new();
        if self.at.len() != dimension {
            let detail = format!("expected {dimension} coordinates, got {}", self.at.len());
            faults.push(Fault::new("/at", detail));
        }
        for (index, value) in self.at.iter().enumerate().filter(|(_, value)| !(value.abs() <= most)) {
            let detail = format!("expected a number within ±{most:e}, got {value}");
            faults.push(Fault::new(format!("/at/{index}"), detail));
        }
        if let Some(radius) = self.radius.filter(|radius| !(*radius > 0.0 && *radius <= most)) {
            let detail = format!("expected a positive number of at most {most:e}, got {radius}");
            faults.push(Fault::new("/radius", detail));
        }
        faults
    }
}

/// Initial shapes, one for each object.
#[derive(Debug)]
pub enum Starts {
    /// Posted shapes.
    Shapes(Vec<ShapeInput>),
    /// Boxes that the initial shapes fill.
    Boxes(Vec<BoxInput>),
    /// Points around which they lie.
    Seeds(Vec<SeedInput>),
    /// Components of the part `mask`: in the plane their outer contours, in space the boxes around them.
    Components(Vec<LabelBoundary>),
}

impl Starts {
    pub(super) fn count(&self) -> usize {
        match self {
            Self::Shapes(shapes) => shapes.len(),
            Self::Boxes(boxes) => boxes.len(),
            Self::Seeds(seeds) => seeds.len(),
            Self::Components(components) => components.len(),
        }
    }

    /// Sides of the box around the initial shape at `index`; none of a shape that is faulty.
    pub(super) fn extent(&self, index: usize, usual_radius: f64) -> Vec<f64> {
        let sides = |lower: &[f64], upper: &[f64]| lower.iter().zip(upper).map(|(a, b)| b - a).collect();
        match self {
            Self::Shapes(shapes) => posted_extent(&shapes[index]),
            Self::Boxes(boxes) => sides(&boxes[index].lower, &boxes[index].upper),
            Self::Seeds(seeds) => {
                let BoxInput { lower, upper } = seeds[index].around(usual_radius);
                sides(&lower, &upper)
            }
            Self::Components(components) => match &components[index] {
                LabelBoundary::Region(region) => extent(&region.points.concat(), 2),
                LabelBoundary::Solid(solid) => extent(&solid.outer.vertices.concat(), 3),
            },
        }
    }

    /// Whether the initial shape at `index` says how large its object is: a seed without a radius does not.
    pub(super) fn has_size(&self, index: usize) -> bool {
        match self {
            Self::Seeds(seeds) => seeds[index].radius.is_some(),
            Self::Shapes(_) | Self::Boxes(_) | Self::Components(_) => true,
        }
    }

    /// Field or part of the request.
    fn place(&self) -> &'static str {
        match self {
            Self::Shapes(_) => "/shapes",
            Self::Boxes(_) => "/boxes",
            Self::Seeds(_) => "/seeds",
            Self::Components(_) => "/mask",
        }
    }

    /// A fault of the initial shape at `index`; `pointer` is relative to it.
    pub(super) fn fault(&self, index: usize, pointer: &str, detail: impl Into<String>) -> Fault {
        let place = self.place();
        let fault = match self {
            Self::Components(_) => Fault::new(place, detail),
            _ => Fault::new(format!("{place}/{index}{pointer}"), detail),
        };
        fault.at_shape(index)
    }

    /// Faults for shapes of a dimension.
    pub(super) fn faults(&self, dimension: usize, limits: &Limits) -> Vec<Fault> {
        let (count, most) = (self.count(), limits.shapes);
        if !(1..=most).contains(&count) {
            let what = if matches!(self, Self::Components(_)) { "components" } else { "entries" };
            let detail = format!("expected between 1 and {most} {what}, got {count}");
            return vec![Fault::new(self.place(), detail)];
        }
        let of = |index: usize| match self {
            Self::Boxes(boxes) => boxes[index].faults(dimension),
            Self::Seeds(seeds) => seeds[index].faults(dimension),
            Self::Shapes(_) | Self::Components(_) => Vec::new(),
        };
        let placed =
            |index| of(index).into_iter().map(move |fault| self.fault(index, &fault.pointer, fault.detail));
        (0..count).flat_map(placed).collect()
    }

    /// Control points of the initial shapes, coordinate-major, in the coordinates of the request.
    ///
    /// # Errors
    /// All faults of posted shapes; a representation whose shapes fill no box.
    pub(super) fn control_points<'k>(
        &self,
        kind: impl Fn(usize) -> &'k Kind,
        limits: &Limits,
        usual_radius: f64,
    ) -> Result<Vec<Vec<f64>>, ServiceError> {
        let (mut faults, mut found) = (Vec::new(), Vec::new());
        for index in 0..self.count() {
            match self.one(index, kind(index), limits, usual_radius) {
                Ok(control_points) => found.push(control_points),
                Err(own) => faults.extend(own),
            }
        }
        ServiceError::unless_empty(faults)?;
        Ok(found)
    }

    fn one(
        &self,
        index: usize,
        Kind { setup, place, .. }: &Kind,
        limits: &Limits,
        usual_radius: f64,
    ) -> Result<Vec<f64>, Vec<Fault>> {
        let fill = |lower: &[f64], upper: &[f64]| {
            let filled = setup.space.fill_box(lower, upper);
            let fault = |fault| vec![Fault::from(fault).below(place).at_shape(index)];
            filled.map(|shape| shape.as_slice().to_vec()).map_err(fault)
        };
        match self {
            Self::Shapes(shapes) => {
                let place = |fault: Fault| self.fault(index, &fault.pointer, fault.detail);
                let read = read_shape(&setup.reading(limits), shapes[index].clone());
                read.map(|shape| shape.control_points)
                    .map_err(|faults| faults.into_iter().map(place).collect())
            }
            Self::Boxes(boxes) => fill(&boxes[index].lower, &boxes[index].upper),
            Self::Seeds(seeds) => {
                let BoxInput { lower, upper } = seeds[index].around(usual_radius);
                fill(&lower, &upper)
            }
            Self::Components(components) => match &components[index] {
                LabelBoundary::Region(region) => {
                    along(region, setup).map_err(|detail| vec![self.fault(index, "", detail)])
                }
                LabelBoundary::Solid(solid) => {
                    let [lower, upper] = corners(&solid.outer.vertices.concat(), 3);
                    fill(&lower, &upper)
                }
            },
        }
    }

    /// The component where the object at `index` begins.
    pub(super) fn component(&self, index: usize) -> Option<ComponentOutput> {
        match self {
            Self::Components(components) => Some(*components[index].component()),
            _ => None,
        }
    }

    /// Warning about the part of its component that the initial shape at `index` leaves out.
    pub(super) fn warning(&self, index: usize) -> Option<String> {
        let Self::Components(components) = self else { return None };
        let (count, what) = match &components[index] {
            LabelBoundary::Region(region) => (region.holes.len(), "holes"),
            LabelBoundary::Solid(solid) => (solid.cavities.len() + solid.outer.genus, "cavities and handles"),
        };
        (count > 0).then(|| format!("the initial shape does not have the {what} of its component ({count})"))
    }
}

/// Usual radius around a seed point.
pub(super) fn usual_radius(grid: &Grid, coordinates: Coordinates, cell: f64) -> f64 {
    let axes = if grid.is_planar() { 2 } else { 3 };
    let side = |axis: usize| match coordinates {
        Coordinates::Index => grid.size()[axis] as f64,
        Coordinates::World => grid.size()[axis] as f64 * grid.spacing()[axis],
    };
    let shortest = (0..axes).map(side).fold(f64::INFINITY, f64::min);
    (USUAL_RADIUS * shortest).max(LEAST_RADIUS * cell)
}

/// Control points of the outer contour of a component, resampled at equal arc length.
fn along(region: &RegionOutput, setup: &Setup) -> Result<Vec<f64>, String> {
    let correspondence = match setup.correspondence() {
        Correspondence::Landmarks => Correspondence::ArcLength,
        resampled => resampled,
    };
    let (direction, repeated_points) = (Direction::Given, RepeatedPoints::Drop);
    let conversion = Conversion { space: &setup.space, correspondence, direction, repeated_points };
    let points = Matrix::from_fn(region.points.len(), 2, |k, c| region.points[k][c]);
    let converted = conversion.interpolate(points).map_err(|fault| fault.detail)?;
    Ok(converted.control_points.as_slice().to_vec())
}

/// Least and greatest coordinates of points, one after the other in `rows`.
fn corners(rows: &[f64], dimension: usize) -> [Vec<f64>; 2] {
    let of = |bound: fn(f64, f64) -> f64, from: f64| {
        let along = |c: usize| rows.iter().skip(c).step_by(dimension).copied().fold(from, bound);
        (0..dimension).map(along).collect()
    };
    [of(f64::min, f64::INFINITY), of(f64::max, f64::NEG_INFINITY)]
}

/// Sides of the box around points, one after the other in `rows`.
fn extent(rows: &[f64], dimension: usize) -> Vec<f64> {
    let [lower, upper] = corners(rows, dimension);
    lower.into_iter().zip(upper).map(|(a, b)| b - a).collect()
}

/// That of the points or control points of a posted shape.
fn posted_extent(shape: &ShapeInput) -> Vec<f64> {
    let list = shape.points.as_ref().or(shape.control_points.as_ref());
    let rows = list.and_then(|list| Some((list.checked(list.width()).ok()?, list.width())));
    rows.filter(|(_, width)| *width > 0).map_or_else(Vec::new, |(rows, width)| extent(rows, width))
}

/// Plans to find the components of a mask of the size of the image: predicted work, and the function that finds them.
///
/// # Errors
/// Those of [`contours::Planned`], see [`of_part`]; a mask of another size.
pub(super) fn of_mask(
    app: &App,
    image: Bytes,
    mask: Bytes,
    slice: Option<usize>,
    wanted: contours::Wanted,
) -> Result<(Work, impl FnOnce() -> Result<Starts, ServiceError> + Send + use<>), ServiceError> {
    let grid = Part { name: "image", bytes: &image, slice }.describe(&app.limits)?.grid;
    let found = contours::Planned::new(app, Part { name: "mask", bytes: &mask, slice }, wanted)?;
    if found.grid().size() != grid.size() {
        let detail = format!("expected {}, the size of the image, got {}", size(&grid), size(found.grid()));
        return Err(ServiceError::invalid("/mask", detail));
    }
    let (work, app) = (found.work(), app.clone());
    let find = move || {
        let ContoursAnswer { results, .. } =
            found.contours(&app, Part { name: "mask", bytes: &mask, slice })?;
        Ok(Starts::Components(results))
    };
    Ok((work, find))
}

/// The same refusal with the names that the fields of contours have beside a mask.
pub(super) fn of_part(error: ServiceError) -> ServiceError {
    let ServiceError::Invalid(faults) = error else { return error };
    ServiceError::Invalid(faults.map(|fault| match fault.pointer.as_str() {
        "/image" => {
            // A mask has no such option.
            let detail = fault.detail.replace(contours::WAY_OUT, "");
            Fault { pointer: "/mask".into(), detail, ..fault }
        }
        "/labels" => Fault { pointer: "/mask_labels".into(), ..fault },
        "/least_cells" => Fault { pointer: "/mask_least_cells".into(), ..fault },
        _ => fault,
    }))
}
