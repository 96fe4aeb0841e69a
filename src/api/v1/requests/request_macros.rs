//! Request fields shared by the statistics endpoints, and small response types used by several resources.

use crate::wire::fault::Fault;
use serde::{Deserialize, Serialize};

use crate::analysis::alignment::MeanShape;
use crate::analysis::factors::{Factors, Minority, RobustSummary};
use crate::analysis::transformation::ClassName;
use crate::api::problem::Problem;
use crate::domain::dictionary::LessCountedShape;
use crate::domain::job::Priority;
use crate::numeric::dense::Matrix;
use crate::service::app::ServiceError;
use crate::service::cohorts::caveats;
use crate::service::cohorts::live_mean::LeftOut;
use crate::service::shapes::read;
use crate::service::shapes::refine::{Layered, Placed};
use crate::wire::checked::{Checked, take_or_default};
use crate::wire::shape::{Points, ShapeInput};

/// Declares a request with a representation, a correspondence, shapes and further fields.
macro_rules! shapes_request {
    ($(#[$meta:meta])* $name:ident { $($further:tt)* }) => {
        crate::wire::checked::document! {
            $(#[$meta])*
            pub(in crate::api::v1) struct $name {
                /// Representation of the shapes.
                #[schema(value_type = crate::geometry::representation::Representation, required = true)]
                representation: crate::wire::representation::Read<crate::geometry::representation::Representation>, required;
                /// Conversion of posted points to control points. Default: `landmarks`.
                #[schema(value_type = Option<crate::analysis::correspondence::Correspondence>)]
                correspondence: crate::wire::checked::Checked<crate::analysis::correspondence::Correspondence>;
                /// Shapes in the given representation.
                #[schema(value_type = Vec<crate::wire::shape::ShapeInput>, required = true)]
                shapes: crate::wire::checked::List<crate::wire::shape::ShapeInput>, required;
                $($further)*
            }
        }

        impl crate::api::v1::requests::batches::ManyShapes for $name {
            fn put_shapes(
                &mut self,
                shapes: crate::wire::checked::List<crate::wire::shape::ShapeInput>,
            ) {
                self.shapes = Some(shapes);
            }
        }

        impl $name {
            /// Takes the fields that all such requests share; faults go to `errors`.
            fn take_shapes(
                &mut self,
                errors: &mut Vec<crate::wire::fault::Fault>,
            ) -> (
                Option<(
                    crate::geometry::representation::Representation,
                    crate::analysis::correspondence::Correspondence,
                )>,
                Vec<crate::wire::shape::ShapeInput>,
            ) {
                use crate::wire::checked::take_or_default;
                errors.append(&mut self.faults);
                let representation =
                    self.representation.take().and_then(|field| field.take("/representation", errors));
                let correspondence = take_or_default(self.correspondence.take(), "/correspondence", errors);
                let shapes = self.shapes.take().unwrap_or_default().take("/shapes", errors);
                (representation.zip(correspondence), shapes)
            }
        }
    };
}
pub(in crate::api::v1) use shapes_request;

/// Declares a request with the settings of the statistics and further fields.
macro_rules! settings_request {
    ($(#[$meta:meta])* $name:ident { $($further:tt)* }) => {
        crate::api::v1::requests::request_macros::shapes_request! {
            $(#[$meta])*
            $name {
                /// How to treat contour direction. Default: `either` for closed planar curves under `cyclic`, else `given` (keep the
                /// direction as posted).
                #[schema(value_type = Option<crate::analysis::correspondence::Direction>)]
                direction: crate::wire::checked::Checked<crate::analysis::correspondence::Direction>;
                /// Whether shapes may be matched to mirror images. Default: `forbid`.
                #[schema(value_type = Option<crate::analysis::correspondence::Mirror>)]
                mirror: crate::wire::checked::Checked<crate::analysis::correspondence::Mirror>;
                /// Transformation class removed before shapes are compared.
                #[schema(value_type = crate::analysis::transformation::Transformation, required = true)]
                transformation: crate::wire::checked::Checked<crate::analysis::transformation::Transformation>, required;
                /// Alignment method. Default: `projection`, or `procrustes` where the class is no linear space: `rigid`, and `similarity`
                /// in three dimensions.
                #[schema(value_type = Option<crate::analysis::alignment::Alignment>)]
                alignment: crate::wire::checked::Checked<crate::analysis::alignment::Alignment>;
                /// Representative of the mean space to return. Default: `training`.
                #[schema(value_type = Option<crate::analysis::frame::Frame>)]
                frame: crate::wire::checked::Checked<crate::analysis::frame::Frame>;
                $($further)*
            }
        }

        impl $name {
            /// Takes the settings and the shapes; faults go to `errors`.
            fn take_settings(
                &mut self,
                errors: &mut Vec<crate::wire::fault::Fault>,
            ) -> (Option<crate::service::statistics::Settings>, Vec<crate::wire::shape::ShapeInput>) {
                use crate::analysis::alignment::Alignment;
                use crate::analysis::correspondence::Direction;
                use crate::wire::checked::{take_given, take_or_default};
                let (common, shapes) = self.take_shapes(errors);
                let direction = take_given(self.direction.take(), "/direction", errors);
                let mirror = take_or_default(self.mirror.take(), "/mirror", errors);
                let transformation =
                    self.transformation.take().and_then(|field| field.take("/transformation", errors));
                let alignment = take_given(self.alignment.take(), "/alignment", errors);
                let frame = take_or_default(self.frame.take(), "/frame", errors);
                let settings = (|| {
                    let (representation, correspondence) = common?;
                    let transformation = transformation?;
                    let usual = Alignment::usual(&transformation, representation.dimension());
                    let direction =
                        direction.unwrap_or_else(|| Direction::usual(correspondence, &representation));
                    Some(crate::service::statistics::Settings {
                        representation,
                        correspondence,
                        direction,
                        mirror: mirror?,
                        transformation,
                        alignment: alignment.unwrap_or(usual),
                        frame: frame?,
                        estimator: crate::analysis::factors::Estimator::Plain,
                    })
                })();
                (settings, shapes)
            }
        }
    };
}
pub(in crate::api::v1) use settings_request;

/// The checked parts of a request, or all of its faults: those of its fields, and those of its shapes that do not
/// depend on the representation.
///
/// # Errors
/// [`ServiceError::Invalid`].
pub(in crate::api::v1) fn checked<T>(
    value: Option<T>,
    mut errors: Vec<Fault>,
    shapes: Vec<ShapeInput>,
) -> Result<(T, Vec<ShapeInput>), ServiceError> {
    match value {
        Some(value) if errors.is_empty() => Ok((value, shapes)),
        _ => {
            errors.extend(read::shape_faults(shapes));
            ServiceError::unless_empty(errors)?;
            Err(ServiceError::invalid("", "the request is incomplete"))
        }
    }
}

/// Priority of the job that a request may become.
///
/// # Errors
/// [`ServiceError::Invalid`] at `/priority`.
pub(in crate::api::v1) fn priority_of(field: Option<Checked<Priority>>) -> Result<Priority, ServiceError> {
    let mut errors = Vec::new();
    let priority = take_or_default(field, "/priority", &mut errors);
    ServiceError::unless_empty(errors)?;
    Ok(priority.unwrap_or_default())
}

pub(in crate::api::v1) fn rows(matrix: &Matrix) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// A shape given by its control points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ShapeOutput {
    /// Control points in the representation.
    pub(in crate::api::v1) control_points: Points,
}

impl ShapeOutput {
    /// The shape with these control points, one per row.
    pub(in crate::api::v1) fn of(control_points: &Matrix) -> Self {
        Self { control_points: points(control_points) }
    }
}

/// Points of the rows of a matrix.
fn points(rows: &Matrix) -> Points {
    Points::from_columns(rows.as_slice().to_vec(), rows.ncols())
}

/// Control points of a finer grid that are moved from where the coarse control points of a shape have them.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct BlockOutput {
    /// Numbers of parts of an interval between knots: one for curves, those along `u` and `v` for surfaces.
    factors: Vec<usize>,
    /// Indices of the control points on the finer grid, in ascending order.
    indices: Vec<usize>,
    /// Their offsets, in the unit of the points.
    offsets: Points,
    /// The control points themselves: those of the coarse shape on the finer grid, with the offsets of this block and of all blocks
    /// whose grids it refines.
    control_points: Points,
}

/// A shape of several resolutions.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct LayeredOutput {
    #[serde(flatten)]
    shape: ShapeOutput,
    /// Control points of finer grids; absent if the shape has none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    blocks: Vec<BlockOutput>,
}

impl From<Layered> for LayeredOutput {
    fn from(Layered { control_points, blocks }: Layered) -> Self {
        let block = |Placed { block, control_points }: Placed| BlockOutput {
            offsets: points(&block.offsets),
            control_points: points(&control_points),
            factors: block.factors,
            indices: block.indices,
        };
        Self { shape: ShapeOutput::of(&control_points), blocks: blocks.into_iter().map(block).collect() }
    }
}

/// Parts that all entries of an answer about posted shapes have in common.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Caveats {
    /// Warnings about the shapes: contours drawn both ways round where their direction counts. Absent if there are
    /// none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
}

impl From<Option<String>> for Caveats {
    fn from(warning: Option<String>) -> Self {
        Self { warnings: warning.into_iter().collect() }
    }
}

/// A mean shape with its certificate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MeanOutput {
    /// Mean shape; of unit `L₂` norm except under `rigid` and `translation`.
    pub(in crate::api::v1) mean: ShapeOutput,
    /// Basis of the mean space, orthonormal in `L₂`: the mean and all its images under the class are combinations of these shapes.
    /// Absent unless `basis` is true, and for Procrustes alignment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::api::v1) basis: Option<Vec<ShapeOutput>>,
    /// Leading eigenvalues of the weighted sum of projectors, with multiplicity. Divided by the total weight they are
    /// mean squared cosines between the mean space and the shapes. Empty for Procrustes alignment.
    pub(in crate::api::v1) eigenvalues: Vec<f64>,
    /// Gap between the eigenvalues of the mean space and the next one; null for Procrustes alignment.
    pub(in crate::api::v1) gap: Option<f64>,
    /// Whether the mean is unique (gap at least 1e-6 of the total weight); null for Procrustes alignment.
    pub(in crate::api::v1) unique: Option<bool>,
    /// Number of shapes.
    #[serde(rename = "shape_count")]
    pub(in crate::api::v1) shapes: usize,
    /// Objective that the mean maximises, the sum of squared cosines; null for Procrustes alignment.
    pub(in crate::api::v1) objective: Option<f64>,
    /// Number of rounds of the start point search, or of iterations of the Procrustes alignment.
    pub(in crate::api::v1) rounds: usize,
    /// Whether the last round left the result unchanged.
    pub(in crate::api::v1) converged: bool,
    /// Shapes that a robust mean leaves out, or that count less; absent without `robust`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::api::v1) robust: Option<RobustOutput>,
    /// Warnings about the result.
    pub(in crate::api::v1) warnings: Vec<String>,
}

/// Shapes that a robust estimate leaves out.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RobustOutput {
    /// Factor of the weight of each shape, in request order: 1 for shapes like the majority, 0 for those that are left out. Absent
    /// for cohorts.
    #[serde(skip_serializing_if = "Option::is_none")]
    weights: Option<Vec<f64>>,
    /// Shapes of the cohort with the smallest factors below one, at most 100. Absent for posted shapes.
    #[serde(skip_serializing_if = "Option::is_none")]
    shapes: Option<Vec<LessCountedShape>>,
    /// Number of shapes that are left out.
    rejected_count: usize,
    /// Number of shapes that count less, without those left out.
    reduced_count: usize,
    /// Number of equal weights that the weights of the shapes are worth, `(Σw)²/Σw²`.
    effective_count: f64,
    /// Shapes that count although they are unlike the majority and agree with each other; absent if there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    minority: Option<Minority>,
}

impl RobustOutput {
    /// Of posted shapes.
    fn of_posted(factors: &Factors) -> Self {
        Self { weights: Some(factors.factors.clone()), ..Self::of(factors.summary()) }
    }

    /// Of a cohort.
    fn of_cohort(left_out: &LeftOut) -> Self {
        Self { shapes: Some(left_out.shapes.clone()), ..Self::of(left_out.summary) }
    }

    fn of(summary: RobustSummary) -> Self {
        let RobustSummary { rejected, reduced, effective, minority } = summary;
        Self {
            weights: None,
            shapes: None,
            rejected_count: rejected,
            reduced_count: reduced,
            effective_count: effective,
            minority,
        }
    }
}

/// Caveat about a minority that a robust mean keeps.
fn minority_warning(Minority { shapes, share, distance }: Minority) -> String {
    format!(
        "{shapes} of the shapes that count ({:.0} %) are unlike the majority and agree with each other, and the mean is {:.1} % of its \
         size away from that of the majority: if they are of another kind, leave them out",
        100.0 * share,
        100.0 * distance
    )
}

impl MeanOutput {
    pub(in crate::api::v1) fn new(mean: &MeanShape, dimension: usize) -> Self {
        let mut warnings = Vec::new();
        if mean.unique == Some(false) {
            warnings
                .push("the mean is not unique: the eigenvalue gap is below 1e-6 of the total weight".into());
        }
        if !mean.converged {
            warnings.push(format!(
                "no convergence after {} rounds: the mean still changed in the last ones",
                mean.rounds
            ));
        }
        warnings.extend(caveats::of_parameters(mean.disagreement));
        warnings.extend(mean.robust.as_ref().and_then(|factors| factors.minority).map(minority_warning));
        Self {
            mean: ShapeOutput {
                control_points: Points::from_columns(mean.control_points.clone(), dimension),
            },
            basis: None,
            eigenvalues: mean.eigenvalues.clone(),
            gap: mean.gap,
            unique: mean.unique,
            shapes: mean.shapes,
            objective: mean.objective,
            rounds: mean.rounds,
            converged: mean.converged,
            robust: mean.robust.as_ref().map(RobustOutput::of_posted),
            warnings,
        }
    }

    /// The mean of a cohort, with the shapes that it leaves out.
    pub(in crate::api::v1) fn leaving_out(mut self, left_out: Option<&LeftOut>) -> Self {
        self.warnings.extend(left_out.and_then(|left_out| left_out.summary.minority).map(minority_warning));
        self.robust = left_out.map(RobustOutput::of_cohort);
        self
    }
}

/// Declares the page of a list: a separate type, since the schema of a generic one would repeat its items in place.
macro_rules! page {
    ($(#[$meta:meta])* $name:ident of $item:ident) => {
        $(#[$meta])*
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        pub(in crate::api::v1) struct $name {
            /// Entries of the page.
            items: Vec<$item>,
            /// Cursor of the next page; null on the last page.
            next: Option<String>,
        }
    };
}
pub(in crate::api::v1) use page;

/// Pagination: where the page starts and its length.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct PageQuery {
    /// Cursor from the previous page.
    pub(in crate::api::v1) cursor: Option<String>,
    /// Entries per page, 1 to 1000. Default: 100.
    #[param(minimum = 1, maximum = 1000)]
    pub(in crate::api::v1) limit: Option<usize>,
}

/// Maximum number of entries per page.
const MAX_PAGE: usize = 1000;

impl PageQuery {
    /// Length of the page.
    ///
    /// # Errors
    /// A limit out of bounds.
    pub(in crate::api::v1) fn limit(&self) -> Result<usize, Problem> {
        let limit = self.limit.unwrap_or(100);
        if (1..=MAX_PAGE).contains(&limit) {
            return Ok(limit);
        }
        let detail = format!("expected a number between 1 and {MAX_PAGE}, got {limit}");
        Err(Problem::of_parameter("limit", detail))
    }
}

/// Milliseconds since 1970 of a time in RFC 3339, the value of the query parameter `name`.
///
/// # Errors
/// Another text.
pub(in crate::api::v1) fn milliseconds(name: &str, text: &str) -> Result<i64, Problem> {
    let time = text.parse::<jiff::Timestamp>().map_err(|_| {
        let detail = format!("expected a time such as 2026-01-31T12:00:00Z, got '{text}'");
        Problem::of_parameter(name, detail)
    })?;
    Ok(time.as_millisecond())
}

/// Class names, for the catalogue.
pub(in crate::api::v1) fn class_names() -> impl Iterator<Item = ClassName> {
    ClassName::ALL.into_iter()
}

/// Header of a request that may safely be repeated.
#[cfg(feature = "schema")]
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Header)]
pub(in crate::api::v1) struct RetryHeader {
    /// Key chosen by the client: a request repeated with the same key within seven days is executed only once.
    #[allow(dead_code, reason = "only for the document; the extractor of the caller reads it")]
    #[param(rename = "Idempotency-Key")]
    idempotency_key: Option<String>,
}

/// Header of a request that may become a job.
#[cfg(feature = "schema")]
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Header)]
pub(in crate::api::v1) struct PreferHeader {
    /// `wait=10`: wait up to ten seconds for the job; `respond-async`: make a job in any case.
    #[allow(dead_code, reason = "only for the document; an extractor reads it")]
    prefer: Option<String>,
}

/// Header of a conditional change.
#[cfg(feature = "schema")]
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Header)]
pub(in crate::api::v1) struct IfMatchHeader {
    /// ETag of the version that the client last saw. If the current version differs, nothing is changed.
    #[allow(dead_code, reason = "only for the document; an extractor reads it")]
    #[param(rename = "If-Match")]
    if_match: Option<String>,
}
