//! Request fields that the statistics share, and small answers that several resources give.

use serde::{Deserialize, Serialize};

use crate::analysis::alignment::{Alignment, MeanShape};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::formats::InputError;
use crate::formats::checked::Checked;
use crate::formats::representation::CheckedRepresentation;
use crate::formats::shape::Points;
use crate::numeric::dense::Matrix;
use crate::service::ServiceError;
use crate::service::compute::Settings;

/// Declares a request with the settings of the statistics and further fields.
macro_rules! settings_request {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[derive(Debug, serde::Deserialize, utoipa::ToSchema)]
        #[serde(deny_unknown_fields)]
        pub(super) struct $name {
            /// What the shapes are made of.
            #[schema(value_type = crate::geometry::representation::Representation)]
            pub(super) representation: crate::formats::representation::CheckedRepresentation,
            /// How points correspond; `landmarks` unless given.
            #[serde(default)]
            #[schema(value_type = crate::analysis::correspondence::Correspondence)]
            pub(super) correspondence: crate::formats::checked::Checked<crate::analysis::correspondence::Correspondence>,
            /// Whether the direction of contours means something; `given` unless given.
            #[serde(default)]
            #[schema(value_type = crate::analysis::correspondence::Direction)]
            pub(super) direction: crate::formats::checked::Checked<crate::analysis::correspondence::Direction>,
            /// Whether mirror images may be matched; `forbid` unless given.
            #[serde(default)]
            #[schema(value_type = crate::analysis::correspondence::Mirror)]
            pub(super) mirror: crate::formats::checked::Checked<crate::analysis::correspondence::Mirror>,
            /// The class that is removed before shapes are compared.
            #[schema(value_type = crate::analysis::transformation::Transformation, example = json!("similarity"))]
            pub(super) transformation: crate::formats::checked::Checked<crate::analysis::transformation::Transformation>,
            /// Projection on the class, or Procrustes fits; `projection` unless given.
            #[serde(default)]
            #[schema(value_type = crate::analysis::alignment::Alignment)]
            pub(super) alignment: crate::formats::checked::Checked<crate::analysis::alignment::Alignment>,
            /// Which member of the mean space is answered; `training` unless given.
            #[serde(default)]
            #[schema(value_type = crate::analysis::frame::Frame)]
            pub(super) frame: crate::formats::checked::Checked<crate::analysis::frame::Frame>,
            /// The shapes.
            pub(super) shapes: Vec<crate::formats::shape::ShapeInput>,
            $($(#[$field_doc])* pub(super) $field: $type,)*
        }

        impl $name {
            /// The checked settings, the shapes and the further fields.
            ///
            /// # Errors
            /// All settings that are wrong.
            pub(super) fn split(
                self,
            ) -> Result<
                (crate::service::compute::Settings, Vec<crate::formats::shape::ShapeInput>, ($($type,)*)),
                crate::service::ServiceError,
            > {
                let Self {
                    representation, correspondence, direction, mirror, transformation, alignment, frame, shapes,
                    $($field,)*
                } = self;
                let settings = super::settings::UncheckedSettings {
                    representation, correspondence, direction, mirror, transformation, alignment, frame,
                };
                Ok((settings.check()?, shapes, ($($field,)*)))
            }
        }
    };
}
pub(super) use settings_request;

/// Settings that may be wrong.
pub(super) struct UncheckedSettings {
    pub(super) representation: CheckedRepresentation,
    pub(super) correspondence: Checked<Correspondence>,
    pub(super) direction: Checked<Direction>,
    pub(super) mirror: Checked<Mirror>,
    pub(super) transformation: Checked<Transformation>,
    pub(super) alignment: Checked<Alignment>,
    pub(super) frame: Checked<Frame>,
}

impl UncheckedSettings {
    /// The settings.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] with all that are wrong.
    pub(super) fn check(self) -> Result<Settings, ServiceError> {
        let mut errors: Vec<InputError> = Vec::new();
        let representation = self.representation.take("/representation", &mut errors);
        let correspondence = self.correspondence.take("/correspondence", &mut errors);
        let direction = self.direction.take("/direction", &mut errors);
        let mirror = self.mirror.take("/mirror", &mut errors);
        let transformation = self.transformation.take("/transformation", &mut errors);
        let alignment = self.alignment.take("/alignment", &mut errors);
        let frame = self.frame.take("/frame", &mut errors);
        match (representation, correspondence, direction, mirror, transformation, alignment, frame) {
            (
                Some(representation),
                Some(correspondence),
                Some(direction),
                Some(mirror),
                Some(transformation),
                Some(alignment),
                Some(frame),
            ) => Ok(Settings {
                representation,
                correspondence,
                direction,
                mirror,
                transformation,
                alignment,
                frame,
            }),
            _ => Err(ServiceError::below(errors, "")),
        }
    }
}

/// Rows of a matrix.
pub(super) fn rows(matrix: &Matrix) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// A shape by its control points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ShapeOutput {
    /// Coefficients in the representation.
    pub(super) control_points: Points,
}

/// A mean shape with its certificate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MeanOutput {
    /// The mean shape; of unit `L₂` norm except under `rigid` and `translation`.
    pub(super) mean: ShapeOutput,
    /// Leading eigenvalues of the weighted sum of projectors, with multiplicity; over the total weight they are
    /// mean squared cosines between the mean space and the shapes. Empty for Procrustes fits.
    pub(super) eigenvalues: Vec<f64>,
    /// Gap between the eigenvalues of the mean space and the next; null for Procrustes fits.
    pub(super) gap: Option<f64>,
    /// Whether the mean is unique (gap at least 1e-6 of the total weight); null for Procrustes fits.
    pub(super) unique: Option<bool>,
    /// Number of shapes.
    pub(super) shapes: usize,
    /// What the mean maximises: the sum of squared cosines; null for Procrustes fits.
    pub(super) objective: Option<f64>,
    /// Rounds of the start point search, or iterations of the Procrustes fit.
    pub(super) rounds: usize,
    /// Whether the last round changed nothing.
    pub(super) converged: bool,
    /// What a reader of the result should know.
    pub(super) warnings: Vec<String>,
}

impl MeanOutput {
    /// The answer for `mean` in dimension `d`.
    pub(super) fn new(mean: &MeanShape, dimension: usize) -> Self {
        let mut warnings = Vec::new();
        if mean.unique == Some(false) {
            warnings
                .push("the mean is not unique: the eigenvalue gap is below 1e-6 of the total weight".into());
        }
        if !mean.converged {
            warnings.push(format!(
                "no convergence after {} rounds: the last ones still changed the mean",
                mean.rounds
            ));
        }
        Self {
            mean: ShapeOutput {
                control_points: Points::from_columns(mean.control_points.clone(), dimension),
            },
            eigenvalues: mean.eigenvalues.clone(),
            gap: mean.gap,
            unique: mean.unique,
            shapes: mean.shapes,
            objective: mean.objective,
            rounds: mean.rounds,
            converged: mean.converged,
            warnings,
        }
    }
}

/// A page of a list.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Page<T> {
    /// The entries.
    pub(super) items: Vec<T>,
    /// Cursor of the next page; null on the last.
    pub(super) next: Option<String>,
}

/// A page of a list: where it starts and how long it is.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// Cursor from the page before.
    pub(super) cursor: Option<String>,
    /// Entries per page, 1 to 1000; 100 unless given.
    pub(super) limit: Option<usize>,
}

/// Most entries of a page.
const MAX_PAGE: usize = 1000;

impl PageQuery {
    /// The length of the page.
    ///
    /// # Errors
    /// A limit out of bounds.
    pub(super) fn limit(&self) -> Result<usize, crate::api::problem::Problem> {
        let limit = self.limit.unwrap_or(100);
        if (1..=MAX_PAGE).contains(&limit) {
            return Ok(limit);
        }
        let detail = format!("limit is {limit}, must be between 1 and {MAX_PAGE}");
        Err(crate::api::problem::Problem::new(crate::api::problem::ProblemKind::InvalidQuery, detail))
    }
}

/// Milliseconds since 1970 as RFC 3339 UTC.
pub(super) fn time(ms: i64) -> String {
    jiff::Timestamp::from_millisecond(ms).map_or_else(|_| String::new(), |time| time.to_string())
}

/// The class names, for the catalogue.
pub(super) fn class_names() -> impl Iterator<Item = ClassName> {
    ClassName::ALL.into_iter()
}
