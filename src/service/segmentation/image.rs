//! Images of requests: their headers, read before memory is taken, and their frames.

use serde::{Deserialize, Serialize};

use crate::formats::image::{Description, Grid, ImageError, Limits as FileLimits, describe};
use crate::segmentation::SegmentationError;
use crate::segmentation::frame::Frame;
use crate::service::app::{Limits, ServiceError};

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

impl ImageOutput {
    /// The grid of an image.
    pub fn new(grid: &Grid) -> Self {
        use crate::formats::image::LengthUnit;
        let axes = if grid.is_planar() { 2 } else { 3 };
        Self {
            size: grid.size()[..axes].to_vec(),
            spacing: grid.spacing()[..axes].to_vec(),
            has_lengths: grid.units()[..axes].iter().all(|unit| *unit != LengthUnit::Unknown),
        }
    }
}

/// Limits on the files of images.
pub fn file_limits(limits: &Limits) -> FileLimits {
    FileLimits { bytes: limits.image_bytes as u64, cells: limits.voxels as u64 }
}

/// What the header of the image in the part `name` says.
///
/// # Errors
/// A fault at `/name` for a file that is no image or too large.
pub fn described(bytes: &[u8], name: &str, limits: &Limits) -> Result<Description, ServiceError> {
    describe(bytes, &file_limits(limits)).map_err(|error| refused(&error, name))
}

/// Refusal of the image in the part `name`.
pub fn refused(error: &ImageError, name: &str) -> ServiceError {
    ServiceError::invalid(format!("/{name}"), error.to_string())
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
