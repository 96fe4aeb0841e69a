//! Means of the store as references of priors.

use crate::analysis::alignment::Alignment;
use crate::analysis::frame::Frame;
use crate::analysis::rows::columns_of;
use crate::analysis::transformation::Transformation;
use crate::domain::filter::ShapeFilter;
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::live_mean::{self, MeanQuery, SearchStart};
use crate::service::dictionaries::ready;

/// What has a mean.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// The cohort with this id or name.
    Cohort(String),
    /// The dictionary with this id, `name@version`, `name@alias` or name.
    Dictionary(String),
}

/// A mean of the store.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredMean {
    /// Its representation.
    pub representation: Representation,
    /// Its control points, coordinate-major.
    pub control_points: Vec<f64>,
}

/// The mean of a cohort under a class of transformations, or that of a dictionary, which was learnt under its own class.
///
/// # Errors
/// [`ServiceError::NotFound`]; a class of a cohort that has no name, at `/prior/transformation`; shapes without a mean.
pub async fn find(
    app: &App,
    source: Source,
    transformation: Transformation,
    alignment: Option<Alignment>,
) -> Result<StoredMean, ServiceError> {
    match source {
        Source::Cohort(key) => {
            let Transformation::Named(transformation) = transformation else {
                let detail = "expected the name of a class for the mean of a cohort, got generators";
                return Err(ServiceError::invalid("/prior/transformation", detail));
            };
            let cohort = catalogue::find(app, &key).await?;
            let query = MeanQuery {
                transformation,
                alignment,
                frame: Frame::default(),
                filter: ShapeFilter::default(),
                start: SearchStart::default(),
            };
            let live = live_mean::mean(app, cohort, query).await?;
            let representation = live.cohort.spec.representation.clone();
            Ok(StoredMean { representation, control_points: live.mean.control_points.clone() })
        }
        Source::Dictionary(key) => {
            let ready = ready::find(app, &key).await?;
            let content = &ready.dictionary.content;
            let representation = content.representation.clone();
            let control_points = columns_of(&content.mean.control_points, representation.dimension());
            Ok(StoredMean { representation, control_points })
        }
    }
}
