//! Classification of shapes, and complete assessments. The functions are synchronous and run on the pool.

use super::coding::{self, Asked};
use super::ready::Ready;
use crate::analysis::dictionary::assess::{Assessment, Classified};
use crate::analysis::dictionary::coding::CodedShape;
use crate::service::app::{App, ServiceError};
use crate::service::shapes::outcome::{Outcomes, of_shape};

/// Classifies shapes; those beyond the training quantile `quantile` of their class are not accepted.
///
/// # Errors
/// A dictionary without classifier; a quantile out of range; under [`OnError::Abort`] faults of the shapes, degenerate
/// shapes.
///
/// [`OnError::Abort`]: crate::service::shapes::outcome::OnError::Abort
pub fn classify(
    app: &App,
    ready: &Ready,
    asked: Asked,
    quantile: f64,
) -> Result<Outcomes<Classified>, ServiceError> {
    if ready.dictionary.classifier.is_none() {
        let detail = "the dictionary has no classifier: learn one with \"classifier\" from a labelled cohort";
        return Err(ServiceError::invalid("", detail));
    }
    coding::check_quantile(quantile)?;
    let on_error = asked.on_error;
    let classify = |coded: &[CodedShape]| Ok(ready.dictionary.classify(coded, quantile)?.unwrap_or_default());
    let classified = coding::encode(app, ready, asked)?.together(on_error, classify)?;
    Ok(classified.map(|_, (_, classified)| Ok(classified)))
}

/// Assesses shapes: pose, code, class, novelty, and the residual at `samples` parameters.
///
/// # Errors
/// As [`classify`]; too many samples.
pub fn assess(
    app: &App,
    ready: &Ready,
    asked: Asked,
    quantile: f64,
    samples: usize,
) -> Result<Outcomes<Assessment>, ServiceError> {
    coding::check_quantile(quantile)?;
    let on_error = asked.on_error;
    let coded = coding::encode(app, ready, asked)?;
    coding::check_samples(app, samples, coded.len())?;
    let (dictionary, space) = (&ready.dictionary, &ready.setup.space);
    let classify = |coded: &[CodedShape]| match dictionary.classify(coded, quantile)? {
        Some(classified) => Ok(classified.into_iter().map(Some).collect()),
        None => Ok(vec![None; coded.len()]),
    };
    coded.together(on_error, classify)?.each(&app.pool.context(), |index, (coded, classified)| {
        let assessed = dictionary.assess(space, coded, classified, quantile, samples);
        assessed.map_err(|error| of_shape(index, error))
    })
}
