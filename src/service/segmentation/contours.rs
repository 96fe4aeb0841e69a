//! Contours of label images, and surfaces of label volumes.

use serde::Serialize;

use super::image::{Coordinates, ImageOutput, Part, plane_frame, volume_frame};
use crate::formats::image::{Description, Grid, ImageFile};
use crate::segmentation::SegmentationError;
use crate::segmentation::contours::{
    Component, Components, Dropped, Labels, Region, Selection, Solid, Surface,
};
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError, Work};

/// Predicted seconds per cell: reading, and finding components.
const CELL: f64 = 6e-8;
/// Predicted bytes per cell beside the labels: components, and their parts in images of noise.
const CELL_BYTES: usize = 16;

/// What is wanted of an image.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Labels; all but 0 if `None`.
    pub labels: Option<Vec<u32>>,
    /// Blur of the mask of a label before its boundary is placed, in the unit of the coordinates.
    pub blur: f64,
    /// Number of cells below which a component is left out.
    pub least_cells: usize,
    /// Coordinates of the answer.
    pub coordinates: Coordinates,
}

/// A component of a label in the plane, as closed curves without a repeated point.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct RegionOutput {
    #[serde(flatten)]
    pub(super) component: ComponentOutput,
    /// The outer contour, counter-clockwise in the coordinates of the answer.
    pub(super) points: Vec<[f64; 2]>,
    /// The contours of the holes, clockwise.
    pub(super) holes: Vec<Vec<[f64; 2]>>,
}

/// A component of a label in space, as closed surfaces.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SolidOutput {
    #[serde(flatten)]
    pub(super) component: ComponentOutput,
    #[serde(flatten)]
    pub(super) outer: SurfaceOutput,
    /// The surfaces of the cavities, whose normals point into them.
    pub(super) cavities: Vec<SurfaceOutput>,
}

/// A connected set of cells of one label: cells that share sides, or faces in space.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct ComponentOutput {
    /// The label.
    pub(super) label: u32,
    /// Position among the components of this label, from 0, in the order of their first cells.
    pub(super) component: usize,
    /// Number of cells.
    pub(super) cells: usize,
    /// Number of sides or faces of cells on the edge of the image, along which the component is closed.
    pub(super) edge_sides: usize,
}

/// A closed surface as a mesh.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SurfaceOutput {
    /// Positions of the vertices.
    pub(super) vertices: Vec<[f64; 3]>,
    /// Triangles, counter-clockwise as seen from outside of the component.
    pub(super) faces: Vec<[u32; 3]>,
    /// Number of handles.
    pub(super) genus: usize,
}

/// Components that are left out because they are small.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct LeftOutOutput {
    /// Their number.
    components: usize,
    /// Their cells.
    cells: usize,
}

/// A component: contours of an image, surfaces of a volume.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum LabelBoundary {
    /// In the plane.
    Region(RegionOutput),
    /// In space.
    Solid(SolidOutput),
}

impl LabelBoundary {
    /// The component.
    pub(super) fn component(&self) -> &ComponentOutput {
        match self {
            Self::Region(region) => &region.component,
            Self::Solid(solid) => &solid.component,
        }
    }
}

/// Boundaries of the labels of an image.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ContoursAnswer {
    /// The image.
    image: ImageOutput,
    /// Coordinates of the points.
    coordinates: Coordinates,
    /// One entry for each component, in the order of their first cells.
    pub(super) results: Vec<LabelBoundary>,
    /// Components with fewer cells than asked for.
    left_out: LeftOutOutput,
}

/// An image of which the header was read.
#[derive(Debug)]
pub struct Planned {
    wanted: Wanted,
    description: Description,
    _room: Held,
}

impl Planned {
    /// Reads the header of an image, checks what is wanted and reserves memory.
    ///
    /// # Errors
    /// Faults at the part and of the fields; [`ServiceError::Overloaded`] if memory is short.
    pub fn new(app: &App, image: Part<'_>, wanted: Wanted) -> Result<Self, ServiceError> {
        if !(wanted.blur >= 0.0 && wanted.blur.is_finite()) {
            let detail = format!("expected a number of at least 0, got {}", wanted.blur);
            return Err(ServiceError::invalid("/blur", detail));
        }
        let description = image.describe(&app.limits)?;
        let room = app.memory.hold(Purpose::Bodies, label_bytes(&description))?;
        Ok(Self { wanted, description, _room: room })
    }

    /// Grid of the image.
    pub(super) fn grid(&self) -> &Grid {
        &self.description.grid
    }

    /// Predicted work.
    pub fn work(&self) -> Work {
        let cells = self.description.grid.cells() as f64;
        let blur = if self.wanted.blur > 0.0 { 2.0 } else { 1.0 };
        Work::from_seconds(cells * CELL * blur)
    }

    /// The boundaries of the labels.
    ///
    /// # Errors
    /// A file that is broken or holds no labels; wanted labels without cells; too many vertices; [`ServiceError::Cancelled`].
    pub fn contours(&self, app: &App, image: Part<'_>) -> Result<ContoursAnswer, ServiceError> {
        let file = image.labels(&app.limits)?;
        let context = app.pool.context();
        let stop = || context.is_cancelled();
        let (results, dropped) = boundaries(&file, &self.wanted, &app.limits, &stop)?;
        Ok(ContoursAnswer {
            image: ImageOutput::new(&file.grid),
            coordinates: self.wanted.coordinates,
            results,
            left_out: LeftOutOutput { components: dropped.components, cells: dropped.cells },
        })
    }
}

/// Memory in which a label image is decoded and the boundaries of its labels are found, by its header.
pub(super) fn label_bytes(description: &Description) -> usize {
    let labels = description.grid.cells().saturating_mul(size_of::<u32>() + CELL_BYTES);
    usize::try_from(description.memory_bytes).unwrap_or(usize::MAX).saturating_add(labels)
}

/// The boundaries of the labels of an image, in the order of the first cells of their components.
///
/// # Errors
/// Wanted labels without cells; more components, points or vertices than `limits` allow; [`ServiceError::Cancelled`].
pub(super) fn boundaries(
    file: &ImageFile<u32>,
    wanted: &Wanted,
    limits: &Limits,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Vec<LabelBoundary>, Dropped), ServiceError> {
    let selection = Selection {
        labels: wanted.labels.clone(),
        least_cells: wanted.least_cells,
        most_components: limits.shapes,
    };
    match file.grid.is_planar() {
        true => regions(file, wanted, &selection, limits, stop),
        false => solids(file, wanted, &selection, limits, stop),
    }
}

fn regions(
    file: &ImageFile<u32>,
    wanted: &Wanted,
    selection: &Selection,
    limits: &Limits,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Vec<LabelBoundary>, Dropped), ServiceError> {
    let frame = plane_frame(&file.grid, wanted.coordinates)?;
    let [width, height, _] = file.grid.size();
    let labels = Labels::<2>::new([width, height], &file.values).map_err(faulty)?;
    let found = Components::find(&labels, selection, stop).map_err(faulty)?;
    let found = found.ok_or(ServiceError::Cancelled)?;
    let most = limits.samples.min(limits.answer_numbers / 2);
    let regions = found.regions(&frame, wanted.blur, most, stop).map_err(faulty)?;
    let regions = regions.ok_or(ServiceError::Cancelled)?;
    Ok((regions.into_iter().map(region).collect(), found.dropped()))
}

fn solids(
    file: &ImageFile<u32>,
    wanted: &Wanted,
    selection: &Selection,
    limits: &Limits,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Vec<LabelBoundary>, Dropped), ServiceError> {
    let frame = volume_frame(&file.grid, wanted.coordinates).map_err(faulty)?;
    let labels = Labels::<3>::new(file.grid.size(), &file.values).map_err(faulty)?;
    let found = Components::find(&labels, selection, stop).map_err(faulty)?;
    let found = found.ok_or(ServiceError::Cancelled)?;
    // Three coordinates, and two triangles of three indices.
    let most = limits.vertices.min(limits.answer_numbers / 3);
    let solids = found.solids(&frame, wanted.blur, most, stop).map_err(faulty)?;
    let solids = solids.ok_or(ServiceError::Cancelled)?;
    Ok((solids.into_iter().map(solid).collect(), found.dropped()))
}

/// Refusal of labels or of a setting.
fn faulty(error: SegmentationError) -> ServiceError {
    let pointer = match &error {
        SegmentationError::BlurOfMask { .. } => "/blur",
        SegmentationError::Label { .. } => "/labels",
        SegmentationError::Components { .. } => "/least_cells",
        _ => "/image",
    };
    ServiceError::invalid(pointer, error.to_string())
}

fn component(found: Component) -> ComponentOutput {
    let Component { label, number, cells, border_faces, .. } = found;
    ComponentOutput { label, component: number, cells, edge_sides: border_faces }
}

fn region(found: Region) -> LabelBoundary {
    let Region { component: of, outer, holes } = found;
    LabelBoundary::Region(RegionOutput { component: component(of), points: outer, holes })
}

fn surface(found: Surface) -> SurfaceOutput {
    let genus = found.genus();
    SurfaceOutput { vertices: found.mesh.vertices, faces: found.mesh.faces, genus }
}

fn solid(found: Solid) -> LabelBoundary {
    let Solid { component: of, outer, cavities } = found;
    let cavities = cavities.into_iter().map(surface).collect();
    LabelBoundary::Solid(SolidOutput { component: component(of), outer: surface(outer), cavities })
}
