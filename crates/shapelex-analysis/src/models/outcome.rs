//! All that was found of a linear model.

use std::collections::BTreeMap;

use super::bands::BandRecord;
use super::disparity::DisparityRecord;
use super::kept::KeptModel;
use super::manova::ManovaRecord;
use super::mixed::records::RandomRecord;
use super::pairs::PairsRecord;
use super::records::{AnovaRecord, At, CoefficientRecord};
use super::trajectories::TrajectoriesRecord;
use crate::mean_record::MeanRecord;

/// A linear model of shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelRecord {
    /// The table.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub anova: AnovaRecord,
    /// Mean of all shapes, computed without knowledge of the model, to which they are aligned; null if numbers are modelled.
    pub pooled: Option<MeanRecord>,
    /// Coefficients of the columns of the design.
    pub coefficients: Vec<CoefficientRecord>,
    /// Predicted shapes, or numbers.
    pub predictions: Vec<PredictionRecord>,
    /// Formula of the reduced model of a comparison, whose residuals are exchanged.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub reduced: Option<String>,
    /// Pairs of groups, if asked for.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub pairs: Option<PairsRecord>,
    /// Disparity of groups, if asked for.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub disparity: Option<DisparityRecord>,
    /// Trajectories of groups, if asked for.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub trajectories: Option<TrajectoriesRecord>,
    /// Random effects of the groups of a random part; null without one.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub random: Option<RandomRecord>,
    /// Multivariate statistics of the terms, on request.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub manova: Option<ManovaRecord>,
    /// Model for predictions without the shapes, if asked for; it is stored beside the record.
    #[cfg_attr(feature = "serde", serde(skip))]
    #[cfg_attr(feature = "schema", schema(ignore))]
    pub kept: Option<Box<KeptModel>>,
}

/// Predictions of a model at values of its attributes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PredictionRecord {
    /// The values. Numbers that are not given are at their mean, and shapes are averaged over other factors as they occur.
    pub at: BTreeMap<String, At>,
    /// Predicted number.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<f64>,
    /// Predicted control points, in the frame of the mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
    /// Leverage: variance of the prediction, over that of a residual.
    pub leverage: f64,
    /// Whether a number lies outside of the values of the shapes.
    pub extrapolated: bool,
    /// Bands, if asked for.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub band: Option<BandRecord>,
}
