//! Classification of shapes, and complete assessments. The functions are synchronous and run on the pool.

use super::coding::{self, Asked};
use super::ready::Ready;
use crate::analysis::dictionary::assess::{Assessment, Classified};
use crate::service::app::{App, ServiceError};

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
    if ready.dictionary.classifier.is_none() {
        let detail = "the dictionary has no classifier: learn one with \"classifier\" from a labelled cohort";
        return Err(ServiceError::invalid("", detail));
    }
    coding::check_quantile(quantile)?;
    let coded = coding::encode(app, ready, asked)?;
    Ok(ready.dictionary.classify(&coded, quantile)?.unwrap_or_default())
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
    Ok(ready.dictionary.assess(&ready.setup.space, coded, quantile, samples)?)
}
