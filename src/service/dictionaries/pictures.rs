//! Drawings of shapes beside their reconstructions by a dictionary, and of drift. The functions are synchronous and run on the pool.

use super::coding::{self, Asked};
use super::drift::CohortDrift;
use super::ready::Ready;
use crate::analysis::assessment::assess::Assessment;
use crate::analysis::dictionary::coding::{AnswerPose, CodedShape};
use crate::analysis::dictionary::posted_code::PostedCode;
use crate::analysis::drawing::View;
use crate::analysis::drawing::coded::{Pair, draw_pairs, draw_side_by_side};
use crate::analysis::drawing::drift::draw_drift;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::classify::{self, Assessed};
use crate::service::dictionaries::posterior::Prepared;
use crate::service::shapes::outcome::OnError;

/// Maximum number of shapes in a drawing.
pub const MAX_SHAPES: usize = 12;

/// Title of a drawing of the first of `count` shapes.
fn title(what: &str, count: usize, ready: &Ready) -> String {
    let (name, version) = (&ready.listed.name, ready.listed.version);
    match count {
        1 => format!("a shape {what} by {name} version {version}"),
        count if count <= MAX_SHAPES => format!("{count} shapes {what} by {name} version {version}"),
        count => format!("the first {MAX_SHAPES} of {count} shapes {what} by {name} version {version}"),
    }
}

/// Shapes with their reconstructions, coloured by the distance between them, with class and outlier test as captions. Missing parts are
/// those of the reconstruction.
///
/// # Errors
/// As [`classify::assess`].
pub fn assessed(
    app: &App,
    ready: &Ready,
    asked: Asked,
    quantile: f64,
    prepared: Option<&Prepared>,
) -> Result<Drawing, ServiceError> {
    let assessed = classify::assess(app, ready, asked, (quantile, 0), prepared)?.all()?;
    let count = assessed.len();
    let pair = |(index, assessed): (usize, Assessed)| match assessed {
        Assessed::Whole(assessment) => {
            let shapes = ready.dictionary().pair(&assessment.coded, AnswerPose::Input);
            let shapes = shapes.map_err(|error| error.at(index))?;
            Ok(Pair { caption: verdict(ready, index, &assessment), shapes })
        }
        Assessed::Part(part, novelty) => {
            let seen = 100.0 * part.seen.len() as f64 / ready.setup.metric.size() as f64;
            let novelty = usual(novelty.is_outlier);
            let caption = format!("{}: {seen:.0} % seen\n{novelty}", index + 1);
            Ok(Pair { caption, shapes: [part.filled, part.completed] })
        }
    };
    let pairs = assessed.into_iter().take(MAX_SHAPES).enumerate().map(pair);
    Ok(drawn_as_given(ready, "assessed", count, &pairs.collect::<Result<Vec<Pair>, ServiceError>>()?))
}

fn usual(is_outlier: bool) -> &'static str {
    if is_outlier { "unusual" } else { "usual" }
}

/// Number of a shape, its class and whether it is unusual: of an unusual one that comes first, as no class is certain then.
fn verdict(ready: &Ready, index: usize, assessment: &Assessment) -> String {
    let record = ready.dictionary().content.classifier.as_ref();
    let (number, novelty) = (index + 1, usual(assessment.score.outlier));
    let text = assessment.classified.as_ref().and_then(|classified| {
        let (first, record) = (classified.ranking.first()?, record?);
        let label = &record.classes.get(first.class)?.label;
        let percent = 100.0 * first.confidence;
        Some(match (assessment.score.outlier, classified.accepted) {
            (true, _) => format!("{number}: {novelty}\nnearest {label}"),
            (false, true) => format!("{number}: {label} ({percent:.0} %)\n{novelty}"),
            (false, false) => format!("{number}: of no class, nearest {label}\n{novelty}"),
        })
    });
    text.unwrap_or_else(|| format!("{number}: {novelty}"))
}

/// Shapes with their reconstructions, coloured by the distance between them.
///
/// # Errors
/// As [`coding::reconstruct_shapes`].
pub fn reconstructed(
    app: &App,
    ready: &Ready,
    asked: Asked,
    pose: AnswerPose,
) -> Result<Drawing, ServiceError> {
    let coded = coding::encode(app, ready, asked)?.all()?;
    let caption = |(index, coded): (usize, &CodedShape)| {
        format!("{}: {:.1} % off", index + 1, 100.0 * coded.code.relative_error)
    };
    let captions = coded.iter().enumerate().take(MAX_SHAPES).map(caption).collect();
    drawn_pairs(ready, "reconstructed", coded.iter().collect(), captions, pose)
}

fn drawn_pairs(
    ready: &Ready,
    what: &str,
    coded: Vec<&CodedShape>,
    captions: Vec<String>,
    pose: AnswerPose,
) -> Result<Drawing, ServiceError> {
    let count = coded.len();
    let pair = |(index, (coded, caption)): (usize, (&CodedShape, String))| {
        let shapes = ready.dictionary().pair(coded, pose).map_err(|error| error.at(index))?;
        Ok(Pair { caption, shapes })
    };
    let pairs: Vec<Pair> =
        coded.into_iter().zip(captions).enumerate().map(pair).collect::<Result<_, ServiceError>>()?;
    match pose {
        AnswerPose::Input => Ok(drawn_as_given(ready, what, count, &pairs)),
        AnswerPose::Model => {
            let drawing = draw_pairs(&ready.view(), &title(what, count, ready), &pairs, None);
            Ok(ready.setup.in_scale(drawing, ready.dictionary().content.length_unit.as_deref()))
        }
    }
}

/// The first of `count` shapes with their reconstructions by a dictionary, in the poses in which they were given.
fn drawn_as_given(ready: &Ready, what: &str, count: usize, pairs: &[Pair]) -> Drawing {
    let unit = ready.dictionary().content.length_unit.as_deref();
    draw_pairs(&View::as_given(&ready.setup.space), &title(what, count, ready), pairs, unit).to_scale(unit)
}

/// Reconstructions of posted codes, side by side.
///
/// # Errors
/// As [`coding::reconstruct_codes`].
pub fn reconstructed_codes(app: &App, ready: &Ready, codes: &[PostedCode]) -> Result<Drawing, ServiceError> {
    let reconstructions = coding::reconstruct_codes(app, ready, codes, OnError::Abort)?.all()?;
    let title = title("reconstructed", reconstructions.len(), ready);
    let numbered = reconstructions.into_iter().take(MAX_SHAPES).enumerate();
    let shapes: Vec<(String, Vec<f64>)> =
        numbered.map(|(index, shape)| ((index + 1).to_string(), shape.control_points)).collect();
    Ok(draw_side_by_side(&ready.view(), &title, &shapes))
}

/// Drift of a cohort.
pub fn drifted(ready: &Ready, found: &CohortDrift, quantile: f64) -> Drawing {
    let (name, version) = (&ready.listed.name, ready.listed.version);
    let title = format!("drift of {} since {name} version {version}", ready.listed.provenance.cohort_name);
    draw_drift(&title, &found.drift, found.since, quantile)
}
