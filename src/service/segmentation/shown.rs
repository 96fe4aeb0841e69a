//! Segmented objects as pictures and as label images.

use serde::{Deserialize, Serialize};

use super::answer::SegmentAnswer;
use crate::geometry::drawing::colour::{self, Colour};
use crate::geometry::drawing::layer::{Layer, Mark};
use crate::geometry::drawing::picture;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::raster::Grid as Cells;
use crate::segmentation::field::Image;
use crate::segmentation::snake::Outline;
use crate::service::app::ServiceError;
use crate::wire::image::write::{nifti_u8, nifti_u16, png_u8, png_u16};
use crate::wire::image::{Grid, ImageError};
use crate::wire::picture::{GreyCells, PictureError, PictureFile};

/// Greatest number of cells along a side of a drawn picture; those of larger images are means of blocks.
const MOST_CELLS: usize = 1024;
/// Percentiles of the image that are drawn black and white.
const RANGE: [f64; 2] = [0.5, 99.5];
/// Offset of the plane that cuts surfaces from the middle of a slice, in cells: vertices often lie in the middle itself.
const OFF_MIDDLE: f64 = 1e-6;
/// Stroke widths of initial shapes and results.
const WIDTHS: [f64; 2] = [1.2, 1.8];

/// How segmented objects are answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shown {
    /// As numbers.
    Numbers,
    /// As a drawing.
    Drawn(PictureFile),
    /// As a label image.
    Labels(LabelFormat),
}

/// A file of segmented objects.
#[derive(Debug)]
pub struct ShownFile {
    /// Media type.
    pub media_type: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Format of a label image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelFormat {
    /// PNG, for images in the plane.
    Png,
    /// NIfTI-1, with the positions of the image.
    Nifti,
}

impl LabelFormat {
    /// Media type of the file.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Nifti => "application/x-nifti",
        }
    }
}

/// Segmented objects with their outlines in the cells of the image.
#[derive(Debug)]
pub struct Segmented {
    /// The answer.
    pub answer: SegmentAnswer,
    /// Outlines of the initial shapes and of the results.
    pub(super) outlines: Vec<[Outline; 2]>,
    pub(super) image: Image<f32>,
    pub(super) grid: Grid,
}

impl Segmented {
    /// The file in which the objects are shown; `None` for numbers.
    ///
    /// # Errors
    /// A picture of too many pixels; those of [`Self::label_file`].
    pub fn file(&self, shown: Shown) -> Result<Option<ShownFile>, ServiceError> {
        let (media_type, bytes) = match shown {
            Shown::Numbers => return Ok(None),
            Shown::Drawn(file) => {
                let bytes = file.write(&self.drawing()?).map_err(|error| match error {
                    PictureError::TooLarge { .. } => ServiceError::parameter("width", error.to_string()),
                    PictureError::Render(_) => ServiceError::Internal(error.to_string()),
                })?;
                (file.format.media_type(), bytes)
            }
            Shown::Labels(format) => (format.media_type(), self.label_file(format)?),
        };
        Ok(Some(ShownFile { media_type, bytes }))
    }

    /// The image in grey below the outlines of initial shapes and results. Of a volume, the slice through the middle of the first
    /// result.
    ///
    /// # Errors
    /// [`ServiceError::Internal`] if the picture cannot be written (a bug).
    pub fn drawing(&self) -> Result<Drawing, ServiceError> {
        let slice = self.drawn_slice();
        let spacing = self.grid.spacing();
        let layers = [(0, "initial shape", colour::BEFORE), (1, "result", colour::AFTER)];
        let layers = layers.map(|(which, name, colour)| {
            self.layer(which, slice, colour, [spacing[0], spacing[1]]).named(name)
        });
        let cells = grey(&self.image, slice);
        let [width, height, depth] = self.image.size();
        let side = |axis: usize, cells: usize| spacing[axis] * (cells as f64 - 0.5);
        let corners = [[-0.5 * spacing[0], 0.5 * spacing[1]], [side(0, width), -side(1, height)]];
        let picture = cells.over(corners).map_err(|error| ServiceError::Internal(error.to_string()))?;
        let title = if depth == 1 { "Segmentation".into() } else { format!("Segmentation, slice {slice}") };
        Ok(picture::over(&title, picture, layers.to_vec()))
    }

    /// The slice through the middle of the first result.
    fn drawn_slice(&self) -> usize {
        let last = self.image.size()[2] - 1;
        let bounds = self.outlines.first().and_then(|[_, result]| result.bounds());
        let middle = bounds.map_or(0.5 * last as f64, |[lower, upper]| 0.5 * (lower[2] + upper[2]));
        middle.round().clamp(0.0, last as f64) as usize
    }

    fn layer(&self, which: usize, slice: usize, colour: Colour, spacing: [f64; 2]) -> Layer {
        // Rows of a picture run down the page.
        let place = |point: &[f64; 2]| [spacing[0] * point[0], -spacing[1] * point[1]];
        let (mut lines, mut mark) = (Vec::new(), Mark::Closed);
        for outlines in &self.outlines {
            match &outlines[which] {
                Outline::Polygon(points) => lines.push(points.iter().map(place).collect()),
                Outline::Mesh(mesh) => {
                    mark = Mark::Open;
                    let cut = cut(mesh, slice as f64 + OFF_MIDDLE);
                    lines.extend(cut.iter().map(|ends| ends.iter().map(place).collect::<Vec<_>>()));
                }
            }
        }
        let (colours, titles) = (Vec::new(), Vec::new());
        Layer { lines, colours, mark, colour, width: WIDTHS[which], opacity: 1.0, name: None, titles }
    }

    /// The labels of the cells as a file: 1 for those of the first result, and so on; 0 outside. A cell of several results has the
    /// label of the first one.
    ///
    /// # Errors
    /// More than 65 535 objects; PNG of a volume; an image that is too long for NIfTI.
    pub fn label_file(&self, format: LabelFormat) -> Result<Vec<u8>, ServiceError> {
        let labels = self.labels()?;
        let largest = labels.iter().copied().max().unwrap_or(0);
        let file = match (format, u8::try_from(largest)) {
            (LabelFormat::Png, Ok(_)) => png_u8(&self.grid, &narrow(&labels)),
            (LabelFormat::Png, Err(_)) => png_u16(&self.grid, &labels),
            (LabelFormat::Nifti, Ok(_)) => nifti_u8(&self.grid, &narrow(&labels)),
            (LabelFormat::Nifti, Err(_)) => nifti_u16(&self.grid, &labels),
        };
        file.map_err(|error: ImageError| ServiceError::parameter("format", error.to_string()))
    }

    /// Labels of the cells, x fastest.
    fn labels(&self) -> Result<Vec<u16>, ServiceError> {
        let most = usize::from(u16::MAX);
        if self.outlines.len() > most {
            let detail = format!("expected at most {most} objects, got {}", self.outlines.len());
            return Err(ServiceError::parameter("format", detail));
        }
        let [width, height, depth] = self.image.size();
        let cells = Cells { first: [0.0; 3], spacing: [1.0; 3], size: [width, height, depth] };
        let mut labels = vec![0_u16; width * height * depth];
        for (label, [_, result]) in (1..).zip(&self.outlines) {
            let mask = result.cells(&cells);
            for (at, _) in mask.inside.iter().enumerate().filter(|(_, inside)| **inside) {
                let [i, j, k] = [at / (height * depth), at / depth % height, at % depth];
                let cell = &mut labels[(k * height + j) * width + i];
                *cell = if *cell == 0 { label } else { *cell };
            }
        }
        Ok(labels)
    }
}

/// Labels that fit into 8 bits.
fn narrow(labels: &[u16]) -> Vec<u8> {
    labels.iter().map(|label| *label as u8).collect()
}

/// The pieces of a mesh in the plane `z`, one for each face that crosses it.
fn cut(mesh: &TriangleMesh, z: f64) -> Vec<[[f64; 2]; 2]> {
    let of_face = |face: &[u32; 3]| {
        let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
        let crossing = |(from, to): (usize, usize)| {
            let [a, b] = [corners[from], corners[to]];
            let part = (z - a[2]) / (b[2] - a[2]);
            ((a[2] < z) != (b[2] < z)).then(|| [0, 1].map(|c| a[c] + part * (b[c] - a[c])))
        };
        let mut ends = [(0, 1), (1, 2), (2, 0)].into_iter().filter_map(crossing);
        Some([ends.next()?, ends.next()?])
    };
    mesh.faces.iter().filter_map(of_face).collect()
}

/// Grey values of a slice: means of blocks of cells, so that no side has more than [`MOST_CELLS`].
fn grey(image: &Image<f32>, slice: usize) -> GreyCells {
    let [width, height, _] = image.size();
    let block = width.max(height).div_ceil(MOST_CELLS);
    let size = [width.div_ceil(block), height.div_ceil(block)];
    let [low, high] = RANGE.map(|percent| image.percentile(percent));
    let mean = |x: usize, y: usize| {
        let (columns, rows) =
            (x * block..((x + 1) * block).min(width), y * block..((y + 1) * block).min(height));
        let count = (columns.len() * rows.len()) as f64;
        let sum: f64 = rows.flat_map(|j| columns.clone().map(move |i| image.at([i, j, slice]))).sum();
        let part = (sum / count - low) / (high - low);
        // An image without range is black.
        (255.0 * part.clamp(0.0, 1.0)).round() as u8
    };
    let grey = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| mean(x, y))).collect();
    GreyCells { size, grey }
}
