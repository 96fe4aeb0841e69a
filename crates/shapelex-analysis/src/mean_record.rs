//! Mean shapes as serialisable records.

use crate::alignment::MeanShape;
use crate::rows::rows_of;

/// Mean shape with its certificate.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct MeanRecord {
    /// Control points, of unit `L₂` norm except under `rigid` and `translation`.
    pub control_points: Vec<Vec<f64>>,
    /// Leading eigenvalues of the sum of projectors; empty for Procrustes alignment.
    pub eigenvalues: Vec<f64>,
    /// Gap between the eigenvalues of the mean space and the next one; null for Procrustes alignment.
    pub gap: Option<f64>,
    /// Whether the mean is unique; null for Procrustes alignment.
    pub unique: Option<bool>,
    /// Whether the search for start points, or the Procrustes alignment, converged.
    pub converged: bool,
}

impl MeanRecord {
    /// The record of a mean shape in `dimension` coordinates.
    pub fn of(mean: &MeanShape, dimension: usize) -> Self {
        Self {
            control_points: rows_of(&mean.control_points, dimension),
            eigenvalues: mean.eigenvalues.clone(),
            gap: mean.gap,
            unique: mean.unique,
            converged: mean.converged,
        }
    }
}
