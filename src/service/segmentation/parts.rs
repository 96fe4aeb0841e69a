//! The parts of a request for a segmentation, from the form to the prepared segmentation. A request reads them on the pool; a job reads them
//! once more, from the store.

use bytes::Bytes;

use super::cost::SegmentEstimate;
use super::image::Part;
use super::posted::{Checks, SegmentRequest, ShapePrior};
use super::reference::{self, Stored};
use super::segment::{Files, Planned};
use super::shown::Segmented;
use super::starts;
use super::wanted::Wanted;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::wire::unit::Unit;

/// Name of the JSON document.
pub const PARAMETERS: &str = "parameters";
/// Names of the files.
pub const FILES: [&str; 3] = ["image", "truth", "mask"];

/// The document and the files of a request.
#[derive(Debug, Clone, Default)]
pub struct Parts {
    /// The JSON document.
    pub parameters: Bytes,
    /// The image.
    pub image: Bytes,
    /// Labels of the truth.
    pub truth: Option<Bytes>,
    /// Labels of which each component begins an object.
    pub mask: Option<Bytes>,
}

/// The parts with their settings.
#[derive(Debug)]
pub struct Prepared {
    parts: Parts,
    slice: Option<usize>,
    /// Settings.
    pub wanted: Wanted,
}

/// The parts with a checked plan.
#[derive(Debug)]
pub struct Ready {
    parts: Parts,
    slice: Option<usize>,
    planned: Planned,
}

/// Attracting shapes of the store, as they are at present; `None` if the request names nothing.
///
/// # Errors
/// Those of [`reference::find`].
pub async fn attracting(app: &App, asked: &SegmentRequest) -> Result<Option<Stored>, ServiceError> {
    match asked.prior.as_ref().and_then(ShapePrior::stored) {
        Some((source, transformation, alignment)) => {
            reference::find(app, source, transformation, alignment).await.map(Some)
        }
        None => Ok(None),
    }
}

impl Parts {
    /// All parts that are there, with their names.
    pub fn named(&self) -> Vec<(&'static str, &Bytes)> {
        let files = [Some(&self.image), self.truth.as_ref(), self.mask.as_ref()];
        let files = FILES.into_iter().zip(files).filter_map(|(name, file)| Some((name, file?)));
        std::iter::once((PARAMETERS, &self.parameters)).chain(files).collect()
    }

    /// Checks the parts against `asked`, on the pool, and finds the components of a mask.
    ///
    /// # Errors
    /// Faults of the fields and of the mask.
    pub async fn prepared(
        self,
        app: &App,
        asked: SegmentRequest,
        stored: Option<Stored>,
    ) -> Result<Prepared, ServiceError> {
        let (reader, has_mask) = (app.clone(), self.mask.is_some());
        let check = move |_: &[u8]| asked.wanted(&reader, stored, has_mask);
        let Checks { mut wanted, of_mask, slice } = app.pool.read(self.parameters.clone(), check).await?;
        if let Some(mask) = self.mask.clone() {
            let (reader, image, whole) = (app.clone(), self.image.clone(), mask.clone());
            let plan = move |_: &[u8]| starts::of_mask(&reader, image, whole, slice, of_mask);
            wanted.starts = app.pool.run_planned(mask, plan).await.map_err(starts::of_part)?;
        }
        Ok(Prepared { parts: self, slice, wanted })
    }

    /// As [`Self::prepared`], on this thread.
    ///
    /// # Errors
    /// As [`Self::prepared`].
    pub fn prepared_here(
        self,
        app: &App,
        asked: SegmentRequest,
        stored: Option<Stored>,
    ) -> Result<Prepared, ServiceError> {
        let Checks { mut wanted, of_mask, slice } = asked.wanted(app, stored, self.mask.is_some())?;
        if let Some(mask) = self.mask.clone() {
            let plan = starts::of_mask(app, self.image.clone(), mask, slice, of_mask);
            let (_, find) = plan.map_err(starts::of_part)?;
            wanted.starts = find().map_err(starts::of_part)?;
        }
        Ok(Prepared { parts: self, slice, wanted })
    }

    fn files(&self, slice: Option<usize>) -> Files<'_> {
        let part = |name, bytes| Part { name, bytes, slice };
        let truth = self.truth.as_deref().map(|bytes| part("truth", bytes));
        Files { image: part("image", &self.image), truth }
    }
}

impl Prepared {
    /// Reads the headers of the files, and predicts the cost of the segmentation.
    ///
    /// # Errors
    /// Those of [`Planned::new`].
    pub fn ready(self, app: &App) -> Result<Ready, ServiceError> {
        let Self { parts, slice, wanted } = self;
        let planned = Planned::new(app, parts.files(slice), wanted)?;
        Ok(Ready { parts, slice, planned })
    }
}

impl Ready {
    /// Predicted work.
    pub fn work(&self) -> Work {
        self.planned.work()
    }

    /// Predicted cost.
    pub fn estimate(&self) -> SegmentEstimate {
        self.planned.estimate()
    }

    /// Unit of the coordinates of the objects, where the image gives one.
    pub fn unit(&self) -> Option<Unit> {
        self.planned.unit()
    }

    /// Segments the objects of a request, for which it reserves memory.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if memory is short; those of [`Planned::segment`].
    pub fn segment(self, app: &App) -> Result<Segmented, ServiceError> {
        let _room = app.memory.hold(Purpose::Bodies, self.planned.estimate().memory_bytes)?;
        self.segment_in_job(app)
    }

    /// Segments the objects of a job, whose memory was checked when it was submitted.
    ///
    /// # Errors
    /// Those of [`Planned::segment`].
    pub fn segment_in_job(self, app: &App) -> Result<Segmented, ServiceError> {
        let Self { parts, slice, planned } = self;
        planned.segment(app, parts.files(slice))
    }
}
