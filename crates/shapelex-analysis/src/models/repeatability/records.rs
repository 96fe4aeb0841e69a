//! Results of repeatability as records.

use super::super::records::TermRecord;
use crate::mean_record::MeanRecord;

/// Repeatability of shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RepeatabilityRecord {
    /// Mean of all shapes, computed without knowledge of the subjects, to which they are aligned.
    pub pooled: Option<MeanRecord>,
    /// Number of subjects.
    pub subjects: usize,
    /// Shapes of a subject, `n_0`: their number if all subjects have as many, with weights the sum of these.
    pub shapes_per_subject: f64,
    /// Mean square between subjects.
    pub mean_square_between: f64,
    /// Mean square within subjects.
    pub mean_square_within: f64,
    /// Variance of the subjects, negative if they scatter less than chance has it.
    pub variance_between: f64,
    /// Variance within subjects.
    pub variance_within: f64,
    /// Intraclass correlation: part of the subjects in the variance. Null if nothing varies.
    pub icc: Option<Bounded>,
    /// The same of single shapes where replicates differ systematically and count as error; null unless every subject has every replicate
    /// once.
    pub agreement: Option<Bounded>,
    /// The same where systematic differences of replicates do not count.
    pub consistency: Option<Bounded>,
    /// Number of draws of subjects for the intervals.
    #[cfg_attr(feature = "serde", serde(rename = "bootstrap"))]
    pub draws: usize,
    /// Repeatability of directions; null with too few shapes.
    pub components: Option<PartsRecord>,
    /// Repeatability along the shape.
    pub map: Vec<RepeatabilityPoint>,
    /// Table of the error of measurement; empty without replicates.
    pub measurement_error: Vec<ErrorTermRecord>,
    /// Systematic displacement of each replicate; empty without replicates.
    pub replicates: Vec<ReplicateRecord>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// A value with the ends of its interval of 95 %, from draws of subjects.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bounded {
    /// The value.
    pub value: f64,
    /// Lower end; null without draws.
    pub low: Option<f64>,
    /// Upper end; null without draws.
    pub high: Option<f64>,
}

/// Repeatability of the directions of the first principal scores.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PartsRecord {
    /// Number of scores.
    pub components: usize,
    /// Part of the scatter of the shapes in them.
    pub explained: f64,
    /// Intraclass correlations of the directions that repeat best and worst, and between, in descending order.
    pub repeatability: Vec<f64>,
}

/// Repeatability at a point along the shape.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RepeatabilityPoint {
    /// Parameter `u` on curves; index of a landmark; on surfaces the index `k n_v + l` on the grid of knots.
    pub parameter: f64,
    /// Parameters `u` and `v` on surfaces.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub surface_parameters: Option<[f64; 2]>,
    /// Point on the mean.
    pub point: Vec<f64>,
    /// Intraclass correlation of the displacements of the point; null if it does not move.
    pub icc: Option<f64>,
    /// Variance of the subjects at the point.
    pub between: f64,
    /// Variance within subjects at the point.
    pub within: f64,
}

/// A term of the table of measurement error.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ErrorTermRecord {
    /// The term.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub term: TermRecord,
    /// Sum of squares over that of the residuals; null if these vanish.
    pub signal_to_noise: Option<f64>,
    /// Sum of squares over that about the means of the subjects; null for the subjects.
    pub eta_squared: Option<f64>,
}

/// Systematic difference of a replicate.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ReplicateRecord {
    /// Value of the replicate.
    pub replicate: String,
    /// Number of its shapes.
    pub shapes: usize,
    /// Length of the mean displacement in the norm of the shapes.
    pub distance: f64,
    /// Mean displacement of the control points from the means of the subjects.
    pub displacement: Vec<Vec<f64>>,
}
