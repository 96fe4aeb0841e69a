//! Images of requests: their headers, read before memory is taken, and their frames.

use serde::{Deserialize, Serialize};

use crate::segmentation::SegmentationError;
use crate::segmentation::frame::Frame;
use crate::service::app::{Limits, ServiceError};
use crate::wire::image::{
    Description, Grid, ImageError, ImageFile, LabelPart, Limits as FileLimits, describe, detect, read,
    read_labels,
};
use crate::wire::unit::Unit;

/// Coordinates of shapes in an image: positions in the `world`, in millimetres, or positions of cells (`index`), whose centres
/// are whole numbers from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Coordinates {
    /// Positions in the world, in millimetres.
    #[default]
    World,
    /// Positions of cells.
    Index,
}

/// The grid of an image, as it is answered.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct ImageOutput {
    /// Number of cells along x, y and, for volumes, z.
    size: Vec<usize>,
    /// Distance between the centres of neighbouring cells along these axes, in millimetres.
    spacing: Vec<f64>,
    /// Whether the file gives lengths; without them a cell has the side 1.
    has_lengths: bool,
}

/// Takes a label image, and the label that its segment has.
type AddLabels<'a> = &'a mut dyn FnMut(&ImageFile<u32>, Option<u32>) -> Result<(), ServiceError>;

impl ImageOutput {
    /// The grid of an image.
    pub fn new(grid: &Grid) -> Self {
        let axes = if grid.is_planar() { 2 } else { 3 };
        Self {
            size: grid.size()[..axes].to_vec(),
            spacing: grid.spacing()[..axes].to_vec(),
            has_lengths: grid.has_lengths(),
        }
    }
}

/// Limits on the files of images.
pub(super) fn file_limits(limits: &Limits) -> FileLimits {
    FileLimits { bytes: limits.image_bytes as u64, cells: limits.voxels as u64 }
}

/// The file of a part of a request: an image, or the slice of a volume that is wanted of it.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// Name of the part.
    pub name: &'static str,
    /// The file.
    pub bytes: &'a [u8],
    /// Index along z of the slice; `None` for the whole. An image in the plane is its own slice.
    pub slice: Option<usize>,
}

impl Part<'_> {
    /// Description from the header; memory is that of the whole file.
    ///
    /// # Errors
    /// A fault at the part for a file that is not an image or too large, at `/slice` for a slice that it does not have.
    pub fn describe(&self, limits: &Limits) -> Result<Description, ServiceError> {
        let found = describe(self.bytes, &file_limits(limits)).map_err(|error| self.refused(&error))?;
        let grid = self.of_slice(found.grid, &found.grid, |grid, k| grid.layer(k))?;
        Ok(Description { grid, ..found })
    }

    /// The image.
    ///
    /// # Errors
    /// As for [`Self::describe`]; a broken file.
    pub fn image(&self, limits: &Limits) -> Result<ImageFile, ServiceError> {
        let file = read(self.bytes, &file_limits(limits)).map_err(|error| self.refused(&error))?;
        let grid = file.grid;
        self.of_slice(file, &grid, |file, k| file.layer(k))
    }

    /// The labels.
    ///
    /// # Errors
    /// As for [`Self::describe`]; a broken file, or one that holds other numbers than labels.
    pub fn labels(&self, limits: &Limits) -> Result<ImageFile<u32>, ServiceError> {
        let file = read_labels(self.bytes, &file_limits(limits)).map_err(|error| self.refused(&error))?;
        let grid = file.grid;
        self.of_slice(file, &grid, |file, k| file.layer(k))
    }

    /// Gives on the label images: one, or where segments overlap, one for each that is wanted.
    ///
    /// # Errors
    /// As for [`Self::describe`]; a broken file, or one that holds other numbers than labels; those of `add`.
    pub fn each_label_image(
        &self,
        limits: &Limits,
        wanted: &dyn Fn(u32) -> bool,
        add: AddLabels<'_>,
    ) -> Result<(), ServiceError> {
        let format = detect(self.bytes).map_err(|error| self.refused(&error))?;
        let mut added = Ok(());
        let mut give = |LabelPart { image, label, first }: LabelPart| {
            let grid = image.grid;
            let part = Self { slice: self.slice.and_then(|k| k.checked_sub(first)), ..*self };
            // The image of a segment has only the slices around its frames.
            let is_there = part.slice.is_some_and(|k| k < grid.size()[2]);
            if label.is_some() && self.slice.is_some() && !is_there {
                return true;
            }
            let file = part.of_slice(image, &grid, |file, k| file.layer(k));
            added = file.and_then(|file| add(&file, label));
            added.is_ok()
        };
        let read = format.each_label_image(self.bytes, &file_limits(limits), wanted, &mut give);
        read.map_err(|error| self.refused(&error)).and(added)
    }

    /// The whole, or its slice by `layer`.
    fn of_slice<T>(
        &self,
        whole: T,
        grid: &Grid,
        layer: impl Fn(&T, usize) -> Option<T>,
    ) -> Result<T, ServiceError> {
        match self.slice.filter(|_| !grid.is_planar()) {
            None => Ok(whole),
            Some(k) => layer(&whole, k).ok_or_else(|| {
                let last = grid.size()[2] - 1;
                ServiceError::invalid("/slice", format!("expected a slice between 0 and {last}, got {k}"))
            }),
        }
    }

    fn refused(&self, error: &ImageError) -> ServiceError {
        ServiceError::invalid(format!("/{}", self.name), error.to_string())
    }
}

/// Unit of coordinates of a grid: cells, or the unit of positions.
pub fn unit_of(grid: &Grid, coordinates: Coordinates) -> Option<Unit> {
    match coordinates {
        Coordinates::World => grid.unit(),
        Coordinates::Index if grid.is_planar() => Some(Unit::Pixel),
        Coordinates::Index => Some(Unit::Voxel),
    }
}

/// The frame of a volume.
///
/// # Errors
/// A map without an inverse.
pub fn volume_frame(grid: &Grid, coordinates: Coordinates) -> Result<Frame<3>, SegmentationError> {
    match coordinates {
        Coordinates::Index => Ok(Frame::identity()),
        Coordinates::World => {
            let rows = grid.affine();
            Frame::new(rows.map(|[x, y, z, _]| [x, y, z]), rows.map(|[.., offset]| offset))
        }
    }
}

/// The frame of an image in the plane: the first two rows of its map.
///
/// # Errors
/// A fault at `/coordinates` for an image that is not parallel to the plane of x and y in the world.
pub fn plane_frame(grid: &Grid, coordinates: Coordinates) -> Result<Frame<2>, ServiceError> {
    let [x, y, z] = grid.affine();
    match coordinates {
        Coordinates::Index => Ok(Frame::identity()),
        Coordinates::World if z[0] == 0.0 && z[1] == 0.0 => {
            let frame = Frame::new([[x[0], x[1]], [y[0], y[1]]], [x[3], y[3]]);
            frame.map_err(|error| ServiceError::invalid("/image", error.to_string()))
        }
        Coordinates::World => {
            let detail = "expected an image parallel to the plane of x and y, got an oblique one: ask for \
                          \"coordinates\": \"index\"";
            Err(ServiceError::invalid("/coordinates", detail))
        }
    }
}
