//! Regression of shapes on an attribute: change of the shape, explained variation, predictions, scores.

use super::aligned::{AlignedShapes, mean_warnings};
use super::compare::UNEQUAL_SPREADS;
use super::error::StudyError;
use super::permutation::Draws;
use super::records::{AttributeSummary, CovariateRecord, Prediction, RegressionRecord};
use super::regression::Regression;
use super::variables::Variables;
use crate::alignment::MeanShape;
use crate::mean_record::MeanRecord;
use crate::metric::{Metric, dot, norm};
use crate::quantile::quantile;
use crate::watch::{Counted, Watch};

/// Quantiles of the attribute at which shapes are predicted.
const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];

/// A regression with the position of each shape along it.
#[derive(Debug, Clone, PartialEq)]
pub struct Regressed {
    /// The regression.
    pub record: RegressionRecord,
    /// Value of the attribute of each shape.
    pub values: Vec<f64>,
    /// Score of each shape, `⟨y − ȳ, b⟩/‖b‖`: distance that it has moved in the direction of the change.
    pub scores: Vec<f64>,
    /// Warnings about the mean of the shapes.
    pub warnings: Vec<String>,
}

/// Regresses shapes on an attribute, adjusted for covariates.
///
/// `draws` are permutations of the residuals (Freedman and Lane). Predictions are made at the 5 %, 50 % and 95 % quantiles
/// of the attribute, with the covariates at their mean.
///
/// Cost: that of [`Design::regress`](super::regression::Design::regress).
///
/// # Errors
/// Every variant of [`StudyError`] about variables; [`AnalysisError::Interrupted`](crate::AnalysisError::Interrupted) once
/// `watch` stops.
pub fn regress(
    shapes: &AlignedShapes<'_>,
    variables: &Variables,
    draws: Draws<'_>,
    watch: &dyn Watch,
) -> Result<Regressed, StudyError> {
    variables.check_count(shapes.count())?;
    let sizes = match variables.need_sizes() {
        true => Some(shapes.log_centroid_sizes().ok_or(StudyError::Unmeasured)?),
        false => None,
    };
    let design = variables.design(sizes.as_deref(), &shapes.weights)?;
    let values = variables.attribute_values(sizes.as_deref());
    let summary = variables.summary(&values, &shapes.weights)?;
    let counted = Counted::new(watch, draws.permutations);
    let found = design.regress(&shapes.aligned, &shapes.weights, draws, &counted)?;
    let all: Vec<usize> = (0..shapes.count()).collect();
    let average = shapes.average(&all);
    let scores = all.iter().map(|&k| score(shapes, k, &average, &found.slope)).collect();
    let mut sorted = values.clone();
    sorted.sort_by(f64::total_cmp);
    let outcome = Outcome {
        metric: shapes.space.metric,
        mean: &shapes.mean,
        covariates: variables.covariate_records(),
        attribute: summary,
        sorted: &sorted,
        average: &average,
        found,
    };
    let mut warnings = mean_warnings(&shapes.mean);
    warnings.extend(scatter_warning(shapes, &values, &outcome));
    Ok(Regressed { record: outcome.record(), values, scores, warnings })
}

/// Fewest shapes of a half whose scatter is looked at.
const FEWEST: usize = 5;

/// Warning about shapes whose scatter about the regression changes with the attribute: those above its median beside the others (Goldfeld
/// and Quandt 1965).
fn scatter_warning(shapes: &AlignedShapes<'_>, values: &[f64], outcome: &Outcome<'_>) -> Option<String> {
    let (average, slope) = (outcome.average, &outcome.found.slope);
    let median = quantile(outcome.sorted, 0.5);
    let mut halves = [(0.0, 0.0, 0_usize); 2];
    for (k, value) in values.iter().enumerate().filter(|(_, value)| **value != median) {
        let step = value - outcome.attribute.mean;
        let aligned = shapes.aligned.column(k);
        let rest = aligned.iter().zip(average.iter().zip(slope));
        let square: f64 = rest.map(|(y, (a, b))| (y - a - step * b).powi(2)).sum();
        let (sum, weight, count) = &mut halves[usize::from(*value > median)];
        *sum += shapes.weights[k] * square;
        *weight += shapes.weights[k];
        *count += 1;
    }
    if halves.iter().any(|(_, _, count)| *count < FEWEST) {
        return None;
    }
    let [below, above] = halves.map(|(sum, weight, _)| (sum / weight).sqrt());
    let (more, less, wide, narrow) =
        if above > below { ("above", "below", above, below) } else { ("below", "above", below, above) };
    (wide > UNEQUAL_SPREADS * narrow).then(|| {
        let ratio = if narrow > 0.0 { format!("{:.2} times as much as", wide / narrow) } else { "unlike".into() };
        format!(
            "shapes {more} the median of the attribute scatter {ratio} those {less} it: the test assumes equal scatter and finds changes \
             too often"
        )
    })
}

/// Data from which the record of a regression is made.
#[derive(Debug)]
pub struct Outcome<'a> {
    /// Metric of the shapes.
    pub metric: &'a Metric,
    /// The mean that shapes are aligned to.
    pub mean: &'a MeanShape,
    /// Covariates, as used.
    pub covariates: Vec<CovariateRecord>,
    /// Summary of the attribute.
    pub attribute: AttributeSummary,
    /// Values of the attribute, ascending.
    pub sorted: &'a [f64],
    /// Mean of the aligned shapes, whitened: the prediction at the mean of the attribute.
    pub average: &'a [f64],
    /// The regression.
    pub found: Regression,
}

impl Outcome<'_> {
    /// The regression as a record, with predictions at the quantiles 5, 50 and 95 %.
    pub fn record(self) -> RegressionRecord {
        let Self { metric, mean, covariates, attribute, sorted, average, found } = self;
        let slope = &found.slope;
        let moved =
            |step: f64| -> Vec<f64> { average.iter().zip(slope).map(|(a, b)| a + step * b).collect() };
        let prediction = |q: f64| {
            let value = quantile(sorted, q);
            let control_points = metric.rows(&moved(value - attribute.mean));
            Prediction { quantile: q, attribute: value, control_points }
        };
        let per_deviation: Vec<f64> = slope.iter().map(|b| b * attribute.deviation).collect();
        RegressionRecord {
            pooled: MeanRecord::of(mean, metric.dimension()),
            covariates,
            degrees: found.degrees,
            r_squared: found.r_squared,
            partial_r_squared: found.partial_r_squared,
            model_r_squared: found.model_r_squared,
            pseudo_f: found.pseudo_f,
            test: found.tally.into(),
            average: metric.rows(average),
            change_per_unit: metric.rows(slope),
            change_per_deviation: metric.rows(&per_deviation),
            predictions: QUANTILES.map(prediction).to_vec(),
            attribute,
        }
    }
}

/// Score of shape `k`.
fn score(shapes: &AlignedShapes<'_>, k: usize, average: &[f64], slope: &[f64]) -> f64 {
    let centred: Vec<f64> = shapes.aligned.column(k).iter().zip(average).map(|(y, a)| y - a).collect();
    let length = norm(slope);
    if length > 0.0 { dot(&centred, slope) / length } else { 0.0 }
}
