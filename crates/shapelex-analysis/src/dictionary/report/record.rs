//! The report card as it is answered.

use super::{Angle, Interval, LearningPoint};
use crate::rows::Row;

/// How well the modes of a dictionary describe shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ReportCard {
    /// Number of shapes, without those that a robust mean left out.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count"))]
    pub shapes: usize,
    /// Number of subjects; a shape without one counts as its own.
    #[cfg_attr(feature = "serde", serde(rename = "subject_count"))]
    pub subjects: usize,
    /// Errors of the mean shape alone.
    pub mean_only: Errors,
    /// The modes, in order.
    pub modes: Vec<ModeReport>,
    /// Generalisation with components of fewer subjects, ascending.
    pub learning_curve: Vec<LearningPoint>,
    /// Named measurements, in the order of the request.
    pub measurements: Vec<MeasurementReport>,
    /// Limitations of the numbers.
    pub warnings: Vec<String>,
}

/// Errors with a number of modes, in the unit of the cohort.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Errors {
    /// Generalisation to corresponding points: root mean square distance of a shape, described without its subject; mean over subjects.
    pub generalisation: Interval,
    /// Generalisation as sets of points: root mean square distance of curve to curve or surface to surface, in both directions, of up to
    /// 100 shapes; null for landmarks.
    pub generalisation_to_set: Option<Interval>,
    /// Specificity to corresponding points: root mean square distance of random shapes to the nearest training shape.
    pub specificity: Interval,
    /// Specificity as sets of points, of up to 100 random shapes; null for landmarks.
    pub specificity_to_set: Option<Interval>,
}

/// A mode, with its quality together with those before it.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModeReport {
    /// Number of the mode, from 1.
    pub component: usize,
    /// Variance of the scores, in the pose of the dictionary.
    pub variance: Interval,
    /// Explained fraction of the mode.
    pub explained: Interval,
    /// Compactness: explained fraction of this mode and those before it.
    pub compactness: Interval,
    /// Angle of the mode to that of resampled subjects, in degrees; null without resamples.
    pub angle_deg: Option<Angle>,
    /// Largest principal angle of the span of this mode and those before it to that of resampled subjects, in degrees. It stays small
    /// where modes of equal variance exchange their places.
    pub span_angle_deg: Option<Angle>,
    /// Errors with this mode and those before it.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub errors: Errors,
}

/// A named measurement.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MeasurementReport {
    /// Name.
    pub name: String,
    /// `deg` for angles, else the unit of the cohort (squared for areas); null if the cohort has none.
    pub unit: Option<String>,
    /// Value of the mean shape, at the mean size of the shapes.
    pub of_mean: f64,
    /// Mean of the values of the training shapes at their own sizes.
    pub mean: f64,
    /// Standard deviation of these values.
    pub deviation: f64,
    /// Number of shapes that have the value.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count"))]
    pub shapes: usize,
    /// Changes of the measurement along each mode.
    pub modes: Vec<MeasuredMode>,
    /// The most likely shapes with the wanted values, in their order.
    pub wanted: Vec<WantedShape>,
}

/// Change of a measurement by a mode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MeasuredMode {
    /// Number of the mode, from 1.
    pub component: usize,
    /// Change per standard deviation of the mode, at the mean shape and the mean size: an exact derivative.
    pub change: f64,
    /// Correlation of the scores of the mode with the values of the training shapes; null if either does not vary.
    pub correlation: Option<f64>,
}

/// The most likely shape that has a wanted value.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct WantedShape {
    /// The wanted value.
    pub value: f64,
    /// Scores of the modes, in standard deviations; null if no shape of the modes has the value.
    pub scores: Option<Vec<f64>>,
    /// Mahalanobis distance of the shape from the mean, `|scores|`.
    pub distance: Option<f64>,
    /// Control points in the pose of the mean, at the mean size.
    #[cfg_attr(feature = "schema", schema(value_type = Option<Vec<Vec<f64>>>))]
    pub control_points: Option<Vec<Row>>,
}
