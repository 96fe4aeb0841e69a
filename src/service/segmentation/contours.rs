//! Contours of label images, and surfaces of label volumes.

use serde::Serialize;

use super::image::{Coordinates, ImageOutput, Part, plane_frame, volume_frame};
use crate::segmentation::SegmentationError;
use crate::segmentation::contours::{
    Component, Components, Dropped, Labels, Region, Selection, Solid, Surface,
};
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::wire::files::Photograph;
use crate::wire::image::{Description, Grid, ImageFile};

/// Predicted seconds per cell: reading, and finding components.
const CELL: f64 = 6e-8;
/// Predicted seconds per cell to fill handles: looks at the cells around each cell of the boxes of components.
const FILLING: f64 = 1e-6;
/// Predicted bytes per cell beside the labels: components, and their parts in images of noise.
const CELL_BYTES: usize = 24;
/// Predicted bytes per cell to fill handles: the box of a component.
const FILLING_BYTES: usize = 12;

/// Settings wanted for an image.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Labels; all but 0 if `None`.
    pub labels: Option<Vec<u32>>,
    /// Blur of the mask of a label before its boundary is placed, in the unit of the coordinates.
    pub blur: f64,
    /// Number of cells below which a component is left out.
    pub least_cells: usize,
    /// Whether only the largest component of each label is wanted.
    pub largest: bool,
    /// Whether holes, cavities and handles are filled.
    pub fill: bool,
    /// Treatment of an image that looks like a photograph.
    pub photograph: Photograph,
    /// Coordinates of the answer.
    pub coordinates: Coordinates,
}

impl Default for Wanted {
    /// All components of all labels, in the world.
    fn default() -> Self {
        Self {
            labels: None,
            blur: 0.0,
            least_cells: 1,
            largest: false,
            fill: false,
            photograph: Photograph::Refuse,
            coordinates: Coordinates::World,
        }
    }
}

impl Wanted {
    /// Whether the cells of a label are wanted.
    fn takes(&self, label: u32) -> bool {
        self.labels.as_ref().is_none_or(|labels| labels.contains(&label))
    }
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

/// Components that are left out: small ones, and those beside the largest of their label.
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
    /// Components with fewer cells than asked for, and those beside the largest one.
    left_out: LeftOutOutput,
    /// Number of components that the edge of the image cuts: those with `edge_sides`.
    cut_by_edge: usize,
    /// Warnings about the answer.
    warnings: Vec<String>,
}

/// Boundaries found in the labels of a file.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// One entry for each component, in the order of their first cells; where labels overlap, of one label after the other.
    pub(super) boundaries: Vec<LabelBoundary>,
    /// Components that are left out.
    pub(super) dropped: Dropped,
    /// The grid of the first label image.
    pub(super) grid: Option<Grid>,
    /// Number of components with filled handles.
    pub(super) filled: usize,
    /// Segments that have an image to themselves.
    segments: Vec<u32>,
    /// Number of points or vertices.
    vertices: usize,
}

/// Warning about a volume whose ends are not known.
pub(super) const OPEN_ENDS: &str = "the file does not say where the volume of its segments ends along z: edge_sides counts no sides of the \
     first and the last slice";
/// Other ways to use a photograph.
pub(super) const WAY_OUT: &str =
    ": POST /v1/segment finds objects in a photograph, and photograph=read takes its values for labels";

impl Found {
    /// Number of components that the edge of the image cuts.
    pub(super) fn cut_by_edge(&self) -> usize {
        self.boundaries.iter().filter(|boundary| boundary.component().edge_sides > 0).count()
    }

    /// Warnings about them.
    pub(super) fn warnings(&self) -> Vec<String> {
        let open = self.grid.is_some_and(|grid| grid.has_open_ends()).then(|| OPEN_ENDS.to_owned());
        let filled = match self.filled {
            0 => None,
            count => Some(format!("{count} components had handles, which are filled")),
        };
        open.into_iter().chain(filled).collect()
    }
}

/// An image of which the header was read.
#[derive(Debug)]
pub struct Planned {
    wanted: Wanted,
    description: Description,
    _room: Held,
}

impl Planned {
    /// Reads the header of an image, checks the settings and reserves memory.
    ///
    /// # Errors
    /// Faults at the part and of the fields; [`ServiceError::Overloaded`] if memory is short.
    pub fn new(app: &App, image: Part<'_>, wanted: Wanted) -> Result<Self, ServiceError> {
        if !(wanted.blur >= 0.0 && wanted.blur.is_finite()) {
            let detail = format!("expected a number of at least 0, got {}", wanted.blur);
            return Err(ServiceError::invalid("/blur", detail));
        }
        let description = image.describe(&app.limits)?;
        let room = app.memory.hold(Purpose::Bodies, label_bytes(&description, wanted.fill))?;
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
        let fills = self.wanted.fill && !self.description.grid.is_planar();
        Work::from_seconds(cells * (CELL * blur + if fills { FILLING } else { 0.0 }))
    }

    /// The boundaries of the labels.
    ///
    /// # Errors
    /// A file that is broken or holds no labels; wanted labels without cells; too many vertices; [`ServiceError::Cancelled`].
    pub fn contours(&self, app: &App, image: Part<'_>) -> Result<ContoursAnswer, ServiceError> {
        let context = app.pool.context();
        let stop = || context.is_cancelled();
        let mut found = Found::default();
        let mut add =
            |file: &ImageFile<u32>, segment| found.add(file, segment, &self.wanted, &app.limits, &stop);
        image.each_label_image(&app.limits, &|label| self.wanted.takes(label), &mut add)?;
        found.check_labels(&self.wanted)?;
        Ok(ContoursAnswer {
            image: ImageOutput::new(self.grid()),
            coordinates: self.wanted.coordinates,
            left_out: LeftOutOutput { components: found.dropped.components, cells: found.dropped.cells },
            cut_by_edge: found.cut_by_edge(),
            warnings: found.warnings(),
            results: found.boundaries,
        })
    }
}

/// Memory in which a label image is decoded, the boundaries of its labels are found and handles filled, by its header.
pub(super) fn label_bytes(description: &Description, fill: bool) -> usize {
    let filling = if fill && !description.grid.is_planar() { FILLING_BYTES } else { 0 };
    let labels = description.grid.cells().saturating_mul(size_of::<u32>() + CELL_BYTES + filling);
    usize::try_from(description.memory_bytes).unwrap_or(usize::MAX).saturating_add(labels)
}

impl Found {
    /// Adds the boundaries of a label image: of all wanted labels, or of a `segment` that may overlap others.
    ///
    /// # Errors
    /// Wanted labels without cells; a photograph; more components, points or vertices than `limits` allow;
    /// [`ServiceError::Cancelled`].
    pub(super) fn add(
        &mut self,
        file: &ImageFile<u32>,
        segment: Option<u32>,
        wanted: &Wanted,
        limits: &Limits,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), ServiceError> {
        let selection = Selection {
            labels: if segment.is_some() { None } else { wanted.labels.clone() },
            least_cells: wanted.least_cells,
            largest: wanted.largest,
            refuses_photographs: wanted.photograph == Photograph::Refuse,
            most_components: limits.shapes.saturating_sub(self.boundaries.len()),
        };
        self.grid.get_or_insert(file.grid);
        self.segments.extend(segment);
        match file.grid.is_planar() {
            true => self.add_regions(file, wanted, &selection, limits, stop),
            false => self.add_solids(file, wanted, &selection, limits, stop),
        }
    }

    /// Refuses wanted labels that no segment has, where each has an image to itself.
    fn check_labels(&self, wanted: &Wanted) -> Result<(), ServiceError> {
        let is_apart = self.grid.is_none() || !self.segments.is_empty();
        let missing = wanted.labels.iter().flatten().find(|label| !self.segments.contains(label));
        match missing.filter(|_| is_apart) {
            Some(label) => Err(faulty(SegmentationError::Label { label: *label })),
            None => Ok(()),
        }
    }

    fn push(&mut self, found: LabelBoundary) {
        self.vertices += match &found {
            LabelBoundary::Region(RegionOutput { points, holes, .. }) => {
                points.len() + holes.iter().map(Vec::len).sum::<usize>()
            }
            LabelBoundary::Solid(SolidOutput { outer, cavities, .. }) => {
                outer.vertices.len() + cavities.iter().map(|cavity| cavity.vertices.len()).sum::<usize>()
            }
        };
        self.boundaries.push(found);
    }

    fn count(&mut self, dropped: Dropped) {
        self.dropped.components += dropped.components;
        self.dropped.cells += dropped.cells;
    }

    fn add_regions(
        &mut self,
        file: &ImageFile<u32>,
        wanted: &Wanted,
        selection: &Selection,
        limits: &Limits,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), ServiceError> {
        let frame = plane_frame(&file.grid, wanted.coordinates)?;
        let [width, height, _] = file.grid.size();
        let labels = Labels::<2>::new([width, height], &file.values).map_err(faulty)?;
        let found = Components::find(&labels, selection, stop).map_err(faulty)?;
        let found = found.ok_or(ServiceError::Cancelled)?;
        self.count(found.dropped());
        let most = limits.samples.min(limits.answer_numbers / 2).saturating_sub(self.vertices);
        let regions = found.regions(&frame, wanted.blur, most, stop).map_err(faulty)?;
        let regions = regions.ok_or(ServiceError::Cancelled)?;
        regions.into_iter().for_each(|found| self.push(region(found, wanted.fill)));
        Ok(())
    }

    fn add_solids(
        &mut self,
        file: &ImageFile<u32>,
        wanted: &Wanted,
        selection: &Selection,
        limits: &Limits,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), ServiceError> {
        let frame = volume_frame(&file.grid, wanted.coordinates).map_err(faulty)?;
        let labels = Labels::<3>::new(file.grid.size(), &file.values).map_err(faulty)?;
        let labels = labels.with_open_ends(file.grid.has_open_ends());
        let found = Components::find(&labels, selection, stop).map_err(faulty)?;
        let found = found.ok_or(ServiceError::Cancelled)?;
        self.count(found.dropped());
        // Three coordinates, and two triangles of three indices.
        let most = limits.vertices.min(limits.answer_numbers / 3).saturating_sub(self.vertices);
        let solids = found.solids(&frame, wanted.blur, most, stop).map_err(faulty)?;
        for (id, one) in solids.ok_or(ServiceError::Cancelled)?.into_iter().enumerate() {
            let one = match wanted.fill && one.outer.genus() > 0 {
                true => {
                    self.filled += 1;
                    let filled = found.filled(id, &frame, wanted.blur, most, stop).map_err(faulty)?;
                    filled.ok_or(ServiceError::Cancelled)?
                }
                false => one,
            };
            self.push(solid(one, wanted.fill));
        }
        Ok(())
    }
}

/// Refusal of labels or of a setting.
fn faulty(error: SegmentationError) -> ServiceError {
    let pointer = match &error {
        SegmentationError::BlurOfMask { .. } => "/blur",
        SegmentationError::Label { .. } => "/labels",
        SegmentationError::Components { .. } => "/least_cells",
        _ => "/image",
    };
    let way_out = if matches!(error, SegmentationError::Photograph { .. }) { WAY_OUT } else { "" };
    ServiceError::invalid(pointer, format!("{error}{way_out}"))
}

fn component(found: Component) -> ComponentOutput {
    let Component { label, number, cells, border_faces, .. } = found;
    ComponentOutput { label, component: number, cells, edge_sides: border_faces }
}

fn region(found: Region, fill: bool) -> LabelBoundary {
    let Region { component: of, outer, holes } = found;
    let holes = if fill { Vec::new() } else { holes };
    LabelBoundary::Region(RegionOutput { component: component(of), points: outer, holes })
}

fn surface(found: Surface) -> SurfaceOutput {
    let genus = found.genus();
    SurfaceOutput { vertices: found.mesh.vertices, faces: found.mesh.faces, genus }
}

fn solid(found: Solid, fill: bool) -> LabelBoundary {
    let Solid { component: of, outer, cavities } = found;
    let cavities = if fill { Vec::new() } else { cavities };
    let cavities = cavities.into_iter().map(surface).collect();
    LabelBoundary::Solid(SolidOutput { component: component(of), outer: surface(outer), cavities })
}
