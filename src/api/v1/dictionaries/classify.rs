//! Classification with the classifier of a dictionary, and assessment: code, class, novelty and residual in one call.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::assessment::assess::Classified;
use crate::analysis::classifier_record::{
    ClassRecord, ClassifierKind, ClassifierRecord, ClassifierSettings, Validation,
};
use crate::api::extract::{Caller, Path};
use crate::api::problem::Problem;
use crate::api::v1::dictionaries::coding::{
    Shapes, ask_dictionary, asking_request, quantile_of, receive, samples_of,
};
use crate::api::v1::dictionaries::pictures::draw_dictionary;
use crate::api::v1::requests::batches::{Batch, DrawnBatch, results};
use crate::service::app::App;
use crate::service::dictionaries::answers::{
    AssessmentOutput, ByDictionary, ClassOutput, NoveltyOutput, Verdict,
};
use crate::service::dictionaries::classify;
use crate::service::dictionaries::pictures::assessed;
use crate::service::dictionaries::posterior;
use crate::service::dictionaries::ready::Ready;
use crate::service::shapes::outcome::of_shape;
use crate::wire::checked::{Checked, List, Many, document, take_given, take_many};

/// Classifier of a dictionary; its trained numbers are in the exported file.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ClassifierOutput<'a> {
    /// Requested settings, with all defaults filled in.
    settings: &'a ClassifierSettings,
    /// Kind of classifier that was trained; under `best` it is the kind selected.
    kind: ClassifierKind,
    /// Classes, in alphabetical order.
    classes: Vec<ClassSize<'a>>,
    /// Performance on shapes that neither the classifier nor the dictionary had seen.
    validation: &'a Validation,
}

/// A class of the training shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ClassSize<'a> {
    /// Name of the class.
    label: &'a str,
    /// Number of its training shapes.
    #[serde(rename = "shape_count")]
    shapes: usize,
}

impl<'a> ClassifierOutput<'a> {
    pub(in crate::api::v1) fn new(record: &'a ClassifierRecord) -> Self {
        let size = |class: &'a ClassRecord| ClassSize { label: &class.label, shapes: class.shapes };
        Self {
            settings: &record.settings,
            kind: record.trained.kind(),
            classes: record.classes.iter().map(size).collect(),
            validation: &record.validation,
        }
    }
}

asking_request! {
    /// Shapes to classify.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "quantile": 0.99}))]
    ClassifyRequest {
        /// Training quantile, from 0.5, beyond which a shape belongs to none of the classes. Default: 0.99.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        quantile: Checked<f64>;
    }
}

/// Class of a shape and its novelty.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ClassificationOutput {
    /// Use of the shape, by its class and its novelty together.
    verdict: Verdict,
    #[serde(flatten)]
    class: ClassOutput,
    /// Comparison of the shape with all training shapes.
    novelty: NoveltyOutput,
}

results! {
    /// Classes.
    ClassifyAnswer with ByDictionary of ClassifyResult: ClassifiedShape with ClassificationOutput
}

/// Classifies shapes with the classifier of a dictionary.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/classify", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((ClassifyRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One class per shape, in order", content((ClassifyAnswer = "application/json"), (ClassifyResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort"),
        (status = "4XX", description = "The input was refused, or the dictionary has no classifier")
    ))]
pub(in crate::api::v1) async fn classify(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let received = receive::<ClassifyRequest>(&app, &key, batch).await?;
    let settings =
        |request: ClassifyRequest, _: &Ready, errors: &mut _| quantile_of(request.quantile, errors);
    ask_dictionary::<_, _, ClassifyAnswer>(app, received, settings, |app, ready, asked, quantile| {
        let output = |classified: Classified| {
            let (class, novelty) =
                (ClassOutput::new(ready, &classified), NoveltyOutput::new(&classified.outlier));
            ClassificationOutput { verdict: Verdict::of(Some(&class), &novelty), class, novelty }
        };
        let classes = classify::classify(app, ready, asked, quantile)?;
        Ok((classes.map(|_, classified| Ok(output(classified))), ByDictionary::with_warnings(ready)))
    })
    .await
}

asking_request! {
    /// Shapes to assess.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "samples": 8}))]
    AssessRequest {
        /// Training quantile, from 0.5, beyond which a shape is an outlier or of none of the classes. Default: 0.99.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        quantile: Checked<f64>;
        /// Number of parameters at which the residual is returned. Default: the number of control points.
        #[schema(value_type = Option<usize>)]
        samples: Checked<usize>;
    }
}

results! {
    /// Assessments.
    AssessAnswer with ByDictionary of AssessResult: AssessedShape with AssessmentOutput
}

fn assess_settings(
    request: AssessRequest,
    ready: &Ready,
    errors: &mut Vec<Fault>,
) -> Option<((f64, usize), usize)> {
    let quantile = quantile_of(request.quantile, errors);
    let samples = samples_of(request.samples, ready, errors);
    quantile.zip(samples).map(|((quantile, _), samples)| ((quantile, samples), samples))
}

/// Assesses shapes in one call: pose, code, class, novelty, and the residual along the contour.
///
/// Shapes may miss parts: control points or landmarks that are null, or all outside of `observed`. They are posed on
/// the seen part, with points that correspond as given; scores, residual and novelty are those of the posterior given
/// the seen part, compared with parts of held-out training shapes. The first such request after a start learns this
/// comparison and takes longer. The dictionary must have components.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then. As SVG or PNG: the first shapes, coloured by
/// the distance to their reconstructions.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/assess", tag = "dictionaries",
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery,
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    request_body(content((AssessRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One assessment per shape, in order", content((AssessAnswer = "application/json"), (AssessResult = "application/x-ndjson"), (String = "image/svg+xml"))),
        (status = 404, description = "No such dictionary or cohort"),
        (status = "4XX", description = "The input was refused: also parts that leave their pose open, or a dictionary without components for them")
    ))]
pub(in crate::api::v1) async fn assess(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: DrawnBatch,
) -> Result<Response, Problem> {
    let received = receive::<AssessRequest>(&app, &key, batch.batch).await?;
    let prepared = match received.shapes.have_missing_parts() {
        true => Some(posterior::prepare(&app, &received.ready, true).await?),
        false => None,
    };
    if let Some(file) = batch.picture {
        let draw = move |app: &App, ready: &Ready, asked, (quantile, _)| {
            assessed(app, ready, asked, quantile, prepared.as_ref())
        };
        return draw_dictionary(app, received, file, assess_settings, draw).await;
    }
    let answer = move |app: &App, ready: &Ready, asked, settings| {
        let assessments = classify::assess(app, ready, asked, settings, prepared.as_ref())?;
        let assessments = assessments.map(|index, assessed| {
            AssessmentOutput::new(ready, assessed).map_err(|error| of_shape(index, error))
        });
        Ok((assessments, ByDictionary::with_warnings_of_parts(ready, prepared.as_ref())))
    };
    ask_dictionary::<_, _, AssessAnswer>(app, received, assess_settings, answer).await
}
