//! Thin sheets of a volume: responses of the detector, their crests, and the innermost surface around a point.

use serde::{Deserialize, Serialize};

use super::image::{Coordinates, Part, volume_frame};
use super::request::ObjectPolarity;
use super::shown::LabelFormat;
use crate::numeric::bounded::Stop;
use crate::segmentation::SegmentationError;
use crate::segmentation::detector::{Innermost, Sheets, edge_map, innermost, largest_component};
use crate::segmentation::field::Image;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::wire::fault::Fault;
use crate::wire::image::write::{nifti_f32, nifti_u8, png_u8};
use crate::wire::image::{Description, Grid, ImageError};

/// Predicted bytes per cell beside the file: the image, the response and three parts of the normal in single precision, and cells on
/// crests.
pub(super) const CELL_BYTES: usize = 32;
/// Predicted seconds per cell: eigenvalues and crests.
const CELL: f64 = 1.2e-7;
/// Predicted seconds per cell and number of a kernel, for the 15 passes together.
const TAP: f64 = 1.2e-8;
/// Usual part of the percentile of positive responses from which on there are crests.
pub const FRACTION: f64 = 0.3;
/// Usual percentile.
pub const PERCENT: f64 = 99.0;
/// Largest blur in cells.
const MAX_BLUR: f64 = 16.0;

/// Field of the sheets of a volume that is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SheetField {
    /// The response of every cell, in units of the image per squared length; positive on sheets.
    #[default]
    Response,
    /// Cells on the crests of the responses above the threshold.
    Crests,
    /// The largest component of the innermost surface of crests around a point.
    Surface,
}

/// Settings wanted for a volume.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// The answered field.
    pub field: SheetField,
    /// Blur in the unit of the coordinates; two cells without.
    pub sigma: Option<f64>,
    /// Whether sheets are brighter or darker than their surroundings.
    pub polarity: ObjectPolarity,
    /// Part of a percentile of the positive responses above which there are crests.
    pub fraction: f64,
    /// The percentile.
    pub percent: f64,
    /// Point around which the surface lies; the middle of the volume without.
    pub centre: Option<Vec<f64>>,
    /// Distance from this point above which the surface is looked for.
    pub beyond: f64,
    /// Coordinates of blur, point and distance.
    pub coordinates: Coordinates,
    /// Slice of a picture; the middle one without.
    pub slice: Option<usize>,
}

/// A volume whose header was read, and its settings.
#[derive(Debug)]
pub struct Planned {
    wanted: Wanted,
    description: Description,
}

impl Planned {
    /// Reads the header of a volume and checks the settings.
    ///
    /// # Errors
    /// Faults at `/image` and of the fields.
    pub fn new(app: &App, image: Part<'_>, wanted: Wanted) -> Result<Self, ServiceError> {
        let description = image.describe(&app.limits)?;
        ServiceError::unless_empty(wanted.faults(&description.grid))?;
        Ok(Self { wanted, description })
    }

    /// Predicted work.
    pub fn work(&self) -> Work {
        Work::from_seconds(self.wanted.seconds(&self.description.grid))
    }

    /// The field as a file: NIfTI, or a picture of a slice.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if memory is short; a broken file; a blur below half a cell along an axis;
    /// [`ServiceError::Cancelled`].
    pub fn file(&self, app: &App, image: Part<'_>, format: LabelFormat) -> Result<Vec<u8>, ServiceError> {
        let (wanted, grid) = (&self.wanted, &self.description.grid);
        let read = usize::try_from(self.description.memory_bytes).unwrap_or(usize::MAX);
        let bytes = grid.cells().saturating_mul(CELL_BYTES).saturating_add(read);
        let _room = app.memory.hold(Purpose::Bodies, bytes)?;
        let context = app.pool.context();
        let stop = || context.is_cancelled();
        let volume = Image::new(grid.size(), image.image(&app.limits)?.values).map_err(faulty)?;
        let sheets = wanted.sheets(&volume, grid, &stop)?;
        if wanted.field == SheetField::Response {
            return wanted.response_file(&sheets, grid, format);
        }
        wanted.cells_file(&wanted.cells(&sheets, grid, &stop)?, grid, format)
    }
}

impl Wanted {
    /// Predicted seconds to detect sheets.
    pub(super) fn seconds(&self, grid: &Grid) -> f64 {
        let blur = self.sigma(grid) / self.cell(grid);
        grid.cells() as f64 * (CELL + TAP * (1.0 + 8.0 * blur))
    }

    /// The field as an image: responses, 0 where they are negative, or 1 on cells.
    ///
    /// # Errors
    /// A blur below half a cell along an axis; [`ServiceError::Cancelled`].
    pub(super) fn detected(
        &self,
        volume: &Image<f32>,
        grid: &Grid,
        stop: Stop<'_>,
    ) -> Result<Image, ServiceError> {
        let sheets = self.sheets(volume, grid, stop)?;
        match self.field {
            SheetField::Response => Ok(sheets.response().map(|response| response.max(0.0))),
            SheetField::Crests | SheetField::Surface => {
                Ok(edge_map(&self.cells(&sheets, grid, stop)?, grid.size()))
            }
        }
    }

    fn sheets(&self, volume: &Image<f32>, grid: &Grid, stop: Stop<'_>) -> Result<Sheets<f32>, ServiceError> {
        let frame = volume_frame(grid, self.coordinates).map_err(faulty)?;
        let sheets = Sheets::<f32>::new(volume, &frame, self.sigma(grid), self.polarity.into(), stop);
        sheets.map_err(faulty)?.ok_or(ServiceError::Cancelled)
    }

    /// Cells on crests, or of the innermost surface of them.
    fn cells(&self, sheets: &Sheets<f32>, grid: &Grid, stop: Stop<'_>) -> Result<Vec<usize>, ServiceError> {
        let least = sheets.threshold(self.fraction, self.percent);
        let cells = sheets.crests(least, stop).ok_or(ServiceError::Cancelled)?;
        if self.field != SheetField::Surface {
            return Ok(cells);
        }
        let frame = sheets.frame();
        let centre = self.point().map_or_else(|| middle(grid), |centre| frame.to_index(centre));
        let rules = Innermost::around(centre, self.beyond, frame);
        Ok(largest_component(&innermost(sheets, &cells, &rules), grid.size()))
    }

    pub(super) fn faults(&self, grid: &Grid) -> Vec<Fault> {
        let mut faults = Vec::new();
        if grid.is_planar() {
            faults.push(Fault::new("/image", "expected a volume, got an image of one layer"));
        }
        let most = MAX_BLUR * self.cell(grid);
        if let Some(sigma) = self.sigma.filter(|sigma| !(*sigma > 0.0 && *sigma <= most)) {
            let detail =
                format!("expected a positive number of at most {most} ({MAX_BLUR} cells), got {sigma}");
            faults.push(Fault::new("/sigma", detail));
        }
        for (name, value, largest) in [
            ("fraction", self.fraction, 1.0),
            ("percent", self.percent, 100.0),
            ("beyond", self.beyond, crate::numeric::MAX_NUMBER),
        ] {
            if !(0.0..=largest).contains(&value) {
                let detail = format!("expected a number between 0 and {largest}, got {value}");
                faults.push(Fault::new(format!("/{name}"), detail));
            }
        }
        if let Some(centre) = &self.centre {
            let finite = centre.iter().all(|value| value.abs() <= crate::numeric::MAX_NUMBER);
            if centre.len() != 3 || !finite {
                let detail = format!("expected 3 coordinates, got {}", centre.len());
                faults.push(Fault::new("/centre", detail));
            }
        }
        let last = grid.size()[2] - 1;
        if let Some(slice) = self.slice.filter(|slice| *slice > last) {
            faults.push(Fault::new("/slice", format!("expected a slice between 0 and {last}, got {slice}")));
        }
        faults
    }

    fn cell(&self, grid: &Grid) -> f64 {
        match self.coordinates {
            Coordinates::Index => 1.0,
            Coordinates::World => grid.determinant().abs().cbrt(),
        }
    }

    fn sigma(&self, grid: &Grid) -> f64 {
        self.sigma.unwrap_or(2.0 * self.cell(grid))
    }

    /// The given point.
    fn point(&self) -> Option<[f64; 3]> {
        self.centre.as_deref().and_then(|centre| centre.try_into().ok())
    }

    fn response_file(
        &self,
        sheets: &Sheets<f32>,
        grid: &Grid,
        format: LabelFormat,
    ) -> Result<Vec<u8>, ServiceError> {
        let values = sheets.response().values();
        match format {
            LabelFormat::Nifti => written(nifti_f32(grid, values)),
            LabelFormat::Png => {
                let most = values.iter().copied().fold(0.0_f32, f32::max);
                // A volume without sheets is black.
                let grey = |value: f32| (255.0 * (value / most).clamp(0.0, 1.0)).round() as u8;
                self.picture(grid, |cell| grey(values[cell]))
            }
        }
    }

    fn cells_file(&self, cells: &[usize], grid: &Grid, format: LabelFormat) -> Result<Vec<u8>, ServiceError> {
        let value = if format == LabelFormat::Png { u8::MAX } else { 1 };
        let mut values = vec![0; grid.cells()];
        cells.iter().for_each(|cell| values[*cell] = value);
        match format {
            LabelFormat::Nifti => written(nifti_u8(grid, &values)),
            LabelFormat::Png => self.picture(grid, |cell| values[cell]),
        }
    }

    /// A picture of the slice, from the values of cells by their position in the volume.
    fn picture(&self, grid: &Grid, value: impl Fn(usize) -> u8) -> Result<Vec<u8>, ServiceError> {
        let slice = self.slice.unwrap_or(grid.size()[2] / 2);
        let layer =
            grid.layer(slice).ok_or_else(|| ServiceError::Internal("a slice beyond the last".into()))?;
        let first = slice * layer.cells();
        let values: Vec<u8> = (first..first + layer.cells()).map(value).collect();
        written(png_u8(&layer, &values))
    }
}

/// The middle of a volume, in its cells.
fn middle(grid: &Grid) -> [f64; 3] {
    grid.size().map(|count| 0.5 * (count as f64 - 1.0))
}

fn written(file: Result<Vec<u8>, ImageError>) -> Result<Vec<u8>, ServiceError> {
    file.map_err(|error| ServiceError::parameter("format", error.to_string()))
}

/// Refusal of a volume or of its blur.
fn faulty(error: SegmentationError) -> ServiceError {
    let pointer = if matches!(error, SegmentationError::Blur { .. }) { "/sigma" } else { "/image" };
    ServiceError::invalid(pointer, error.to_string())
}
