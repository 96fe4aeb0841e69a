//! Classification of shapes, and complete assessments. The functions are synchronous and run on the pool.
//!
//! Classes are ranked by likelihood, with calibrated confidences. A shape beyond the training quantile of its most
//! likely class is not accepted.

use super::coding::{self, Asked, Coded, Score};
use super::ready::Ready;
use crate::analysis::classification::quality::confidences;
use crate::analysis::classification::{Description, Observations};
use crate::analysis::dictionary::model::error_of;
use crate::analysis::sparse::SparseCode;
use crate::service::app::{App, ServiceError};

/// A class in a ranking by likelihood.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// Index of the class.
    pub class: usize,
    /// Distance to the class.
    pub distance: f64,
    /// Calibrated confidence; the confidences of all classes sum to 1.
    pub confidence: f64,
}

/// Result of classifying a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Classified {
    /// All classes, the most likely first.
    pub ranking: Vec<Ranked>,
    /// Confidence of the first class minus that of the second.
    pub margin: f64,
    /// Whether the distance is within the training quantile of the class; otherwise the shape belongs to none of the
    /// classes.
    pub accepted: bool,
    /// Comparison of the shape with all training shapes.
    pub outlier: Score,
}

/// Classifies shapes; those beyond the training quantile `quantile` of their class are not accepted.
///
/// # Errors
/// A dictionary without classifier; faults of the shapes or of the quantile; degenerate shapes.
pub fn classify(
    app: &App,
    ready: &Ready,
    asked: Asked,
    quantile: f64,
) -> Result<Vec<Classified>, ServiceError> {
    if ready.classifier.is_none() {
        let detail = "the dictionary has no classifier: learn one with \"classifier\" from a labelled cohort";
        return Err(ServiceError::invalid("", detail));
    }
    coding::check_quantile(quantile)?;
    let coded = coding::encode(app, ready, asked)?;
    Ok(of_coded(ready, &coded, quantile)?.into_iter().flatten().collect())
}

/// Classes of encoded shapes; `None` without a classifier.
fn of_coded(ready: &Ready, coded: &[Coded], quantile: f64) -> Result<Vec<Option<Classified>>, ServiceError> {
    let record = ready.dictionary.content.classifier.as_ref();
    let (Some(classifier), Some(record)) = (&ready.classifier, record) else {
        return Ok(coded.iter().map(|_| None).collect());
    };
    let metric = &ready.setup.metric;
    let mut shapes: Vec<f64> = coded.iter().flat_map(|coded| coded.control_points.iter().copied()).collect();
    crate::analysis::accumulate::prepare(metric, ready.setup.method.translates(), 0, &mut shapes)?;
    let prepared: Vec<f64> = coded.iter().flat_map(|coded| coded.prepared.whitened.iter().copied()).collect();
    let codes: Vec<SparseCode> = coded.iter().map(|coded| coded.code.clone()).collect();
    let observations = Observations { shapes: &shapes, prepared: &prepared, codes: &codes };
    let (preparation, model, size) = (&ready.preparation, &ready.model, record.settings.sees_size());
    let evidence = classifier.evidence(Description { preparation, model, size }, observations)?;
    let classified = evidence.iter().zip(coded).map(|(evidence, coded)| {
        let confidences = confidences(evidence, record.sharpness);
        let ranked = |class: usize| Ranked {
            class,
            distance: evidence.distances[class],
            confidence: confidences[class],
        };
        let ranking: Vec<Ranked> = evidence.ranking().into_iter().map(ranked).collect();
        let second = ranking.get(1).map_or(0.0, |ranked| ranked.confidence);
        let bound = coding::value_at(&record.classes[ranking[0].class].distances, quantile);
        Some(Classified {
            margin: ranking[0].confidence - second,
            accepted: ranking[0].distance <= bound,
            outlier: coding::score_of(ready, &coded.prepared.whitened, &coded.code, quantile),
            ranking,
        })
    });
    Ok(classified.collect())
}

/// Complete assessment of a shape.
#[derive(Debug)]
pub struct Assessment {
    /// Code and pose.
    pub coded: Coded,
    /// Class, if the dictionary has a classifier.
    pub classified: Option<Classified>,
    /// Comparison with the training shapes.
    pub score: Score,
    /// Relative error `‖y − ŷ‖²/(‖y‖‖ŷ‖)`.
    pub relative_error: f64,
    /// Distances between the shape and its reconstruction, in the pose of the shape.
    pub residual: Vec<f64>,
}

/// Assesses shapes: pose, code, class, outlier test, and the residual at `samples` parameters.
///
/// # Errors
/// As [`classify`]; shapes that the alignment makes degenerate; too many samples.
pub fn assess(
    app: &App,
    ready: &Ready,
    asked: Asked,
    quantile: f64,
    samples: usize,
) -> Result<Vec<Assessment>, ServiceError> {
    coding::check_quantile(quantile)?;
    let coded = coding::encode(app, ready, asked)?;
    coding::check_samples(app, samples, coded.len())?;
    let classified = of_coded(ready, &coded, quantile)?;
    let assess = |(index, (coded, classified)): (usize, (Coded, Option<Classified>))| {
        let y = ready.model.reconstruct(&coded.code);
        let relative_error = error_of(&coded.prepared.whitened, &y);
        let score = match &classified {
            Some(classified) => classified.outlier.clone(),
            None => coding::score_of(ready, &coded.prepared.whitened, &coded.code, quantile),
        };
        let residual = coding::residual(ready, &coded, y, samples).map_err(|error| match error {
            ServiceError::DegenerateShape(mut faults) => {
                faults.iter_mut().for_each(|fault| fault.index = Some(index));
                ServiceError::DegenerateShape(faults)
            }
            other => other,
        })?;
        Ok(Assessment { coded, classified, score, relative_error, residual })
    };
    coded.into_iter().zip(classified).enumerate().map(assess).collect()
}
