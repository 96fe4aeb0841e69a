//! Classification of shapes, and complete assessments. The functions are synchronous and run on the pool.

use super::coding::{self, Asked, Given};
use super::posterior::{self, Prepared};
use super::ready::Ready;
use crate::analysis::AnalysisError;
use crate::analysis::assessment::assess::{Assessment, Classified};
use crate::analysis::dictionary::coding::CodedShape;
use crate::analysis::dictionary::posterior::assessed::{PartAssessment, PartScore};
use crate::service::app::progress::JobContext;
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
    if ready.dictionary().content.classifier.is_none() {
        let detail = "the dictionary has no classifier: learn one with \"classifier\" from a labelled cohort";
        return Err(ServiceError::invalid("", detail));
    }
    coding::check_quantile(quantile)?;
    let on_error = asked.on_error;
    let classify = |coded: &[CodedShape]| Ok(ready.assessor.classify(coded, quantile)?.unwrap_or_default());
    let classified = coding::encode(app, ready, asked)?.together(on_error, classify)?;
    Ok(classified.map(|_, (_, classified)| Ok(classified)))
}

/// The assessment of a shape.
#[derive(Debug)]
pub enum Assessed {
    /// Of a whole shape.
    Whole(Box<Assessment>),
    /// Of a shape of which a part is seen.
    Part(Box<PartAssessment>, PartScore),
}

/// Code of a whole shape with its class; neither for a part.
type Coded = Option<(CodedShape, Option<Classified>)>;

/// Assesses shapes: pose, code, class, novelty, and the residual at `samples` parameters. Parts are assessed with the model of
/// `prepared`.
///
/// # Errors
/// As [`classify`]; too many samples; parts that leave their pose open.
pub fn assess(
    app: &App,
    ready: &Ready,
    asked: Asked,
    (quantile, samples): (f64, usize),
    prepared: Option<&Prepared>,
) -> Result<Outcomes<Assessed>, ServiceError> {
    coding::check_quantile(quantile)?;
    let (on_error, context) = (asked.on_error, app.pool.context());
    let given = asked.given(app, ready)?;
    coding::check_samples(app, samples, given.len())?;
    let code = |given: &[Given]| coded(ready, given, quantile, &context);
    given.together(on_error, code)?.each(&context, |index, assessed| match assessed {
        (Given::Whole(_), Some((coded, classified))) => {
            let assessed = ready.assessor.assess(&ready.setup.space, coded, classified, quantile, samples);
            Ok(Assessed::Whole(Box::new(assessed.map_err(|error| of_shape(index, error))?)))
        }
        (Given::Part(part), _) => {
            let prepared = prepared.ok_or_else(|| ServiceError::Internal("a part without a model".into()))?;
            let (part, score) = posterior::assess(ready, prepared, &part, (quantile, samples))
                .map_err(|faults| ServiceError::of_entry("shapes", index, faults))?;
            Ok(Assessed::Part(Box::new(part), score))
        }
        (Given::Whole(_), None) => Err(ServiceError::Internal("a whole shape without a code".into())),
    })
}

/// Codes of the whole shapes among some, with their classes if there is a classifier.
fn coded(
    ready: &Ready,
    given: &[Given],
    quantile: f64,
    context: &JobContext,
) -> Result<Vec<Coded>, AnalysisError> {
    let whole = |(place, given): (usize, &Given)| match given {
        Given::Whole(shape) => Some((place, shape.clone())),
        Given::Part(_) => None,
    };
    let (places, shapes): (Vec<usize>, Vec<Vec<f64>>) = given.iter().enumerate().filter_map(whole).unzip();
    let located = |error: AnalysisError| match error.position() {
        Some(position) => error.at(places[position]),
        None => error,
    };
    let mut found: Vec<Coded> = given.iter().map(|_| None).collect();
    if shapes.is_empty() {
        return Ok(found);
    }
    let coded = ready.dictionary().encode(&shapes.concat(), context).map_err(located)?;
    let classes = ready.assessor.classify(&coded, quantile).map_err(located)?;
    let classes =
        classes.map_or_else(|| vec![None; coded.len()], |found| found.into_iter().map(Some).collect());
    for ((place, coded), class) in places.iter().zip(coded).zip(classes) {
        found[*place] = Some((coded, class));
    }
    Ok(found)
}
