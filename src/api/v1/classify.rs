//! Classification with the classifier of a dictionary, and assessment: code, class, outlier status and residual in one call.

use crate::formats::fault::Fault;
use axum::response::Response;
use serde::Serialize;

use super::coding::{
    CodeOutput, Received, ScoreOutput, Shapes, UsedDictionary, ask_dictionary, asking_request, quantile_of,
    samples_of,
};
use crate::analysis::classification::record::{
    ClassRecord, ClassifierKind, ClassifierRecord, ClassifierSettings, Validation,
};
use crate::analysis::dictionary::assess::{Assessment, Classified};
use crate::api::extract::{Caller, JsonBody, NoQuery, Path};
use crate::api::problem::Problem;
use crate::formats::checked::{Checked, List, Many, document, take_given, take_many};
use crate::formats::shape::ShapeInput;
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::coding::outlier_warnings;
use crate::service::dictionaries::ready::Ready;
use crate::service::dictionaries::{classify, ready};

/// Classifier of a dictionary; its trained numbers are in the exported file.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ClassifierOutput<'a> {
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
pub(super) struct ClassSize<'a> {
    /// Name of the class.
    label: &'a str,
    /// Number of its training shapes.
    shapes: usize,
}

impl<'a> ClassifierOutput<'a> {
    pub(super) fn new(record: &'a ClassifierRecord) -> Self {
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

/// A class with its distance and confidence.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RankedOutput {
    /// Name of the class.
    label: String,
    /// Distance to the class: relative residual, Mahalanobis distance, or distance to the nearest member.
    distance: f64,
    /// Confidence, calibrated on held-out shapes; the confidences of all classes sum to 1.
    confidence: f64,
}

/// Class of a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ClassOutput {
    /// Most likely class.
    label: String,
    /// All classes, most likely first.
    ranking: Vec<RankedOutput>,
    /// Confidence of the first class minus that of the second.
    margin: f64,
    /// Whether the distance to the class is within the quantile of the class's own shapes when held out. If not, the shape
    /// belongs to none of these classes.
    accepted: bool,
    /// Comparison of the shape with all training shapes.
    outlier: ScoreOutput,
}

impl ClassOutput {
    fn new(ready: &Ready, classified: Classified) -> Self {
        let record = ready.dictionary.content.classifier.as_ref();
        let label = |class: usize| {
            record
                .and_then(|record| record.classes.get(class))
                .map_or_else(String::new, |class| class.label.clone())
        };
        let ranking: Vec<RankedOutput> = classified
            .ranking
            .iter()
            .map(|ranked| RankedOutput {
                label: label(ranked.class),
                distance: ranked.distance,
                confidence: ranked.confidence,
            })
            .collect();
        Self {
            label: ranking.first().map_or_else(String::new, |first| first.label.clone()),
            ranking,
            margin: classified.margin,
            accepted: classified.accepted,
            outlier: ScoreOutput::new(classified.outlier),
        }
    }
}

/// Classes, one entry per shape, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ClassifyAnswer {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// One entry per shape.
    classes: Vec<ClassOutput>,
    /// Warnings about outlier detection; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// Classifies shapes with the classifier of a dictionary.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/classify", tag = "dictionaries", request_body = ClassifyRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One class per shape, in order", body = ClassifyAnswer),
        (status = 404, description = "No such dictionary or cohort"),
        (status = "4XX", description = "The input was refused, or the dictionary has no classifier")
    ))]
pub(super) async fn classify(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let received = ClassifyRequest::receive(&app, &key, body).await?;
    let settings =
        |request: ClassifyRequest, _: &Ready, errors: &mut _| quantile_of(request.quantile, errors);
    ask_dictionary(app, received, settings, |app, ready, asked, quantile| {
        let classified = classify::classify(app, ready, asked, quantile)?;
        let classes = classified.into_iter().map(|classified| ClassOutput::new(ready, classified)).collect();
        Ok(ClassifyAnswer {
            dictionary: UsedDictionary::new(ready),
            classes,
            warnings: outlier_warnings(ready),
        })
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

/// Code, class, outlier status and residual of a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AssessmentOutput {
    /// Sparse code or component scores, and the transformation into the pose of the dictionary.
    code: CodeOutput,
    /// Class of the shape; null if the dictionary has no classifier.
    class: Option<ClassOutput>,
    /// Comparison of the shape with the training shapes.
    outlier: ScoreOutput,
    /// `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary.
    relative_error: f64,
    /// Distances between the shape and its reconstruction at equally spaced parameters: `i/samples` on closed curves,
    /// `i/(samples − 1)` on open ones, every point of landmarks. In the unit of the shape.
    residual: Vec<f64>,
}

impl AssessmentOutput {
    fn new(ready: &Ready, assessment: Assessment) -> Result<Self, ServiceError> {
        let Assessment { coded, classified, score, relative_error, residual } = assessment;
        Ok(Self {
            code: CodeOutput::new(&ready.dictionary, &coded)?,
            class: classified.map(|classified| ClassOutput::new(ready, classified)),
            outlier: ScoreOutput::new(score),
            relative_error,
            residual,
        })
    }
}

/// Assessments, one entry per shape, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AssessAnswer {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// One entry per shape.
    assessments: Vec<AssessmentOutput>,
    /// Warnings about outlier detection; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// Assesses shapes in one call: pose, code, class, outlier status, and the residual along the contour.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/assess", tag = "dictionaries", request_body = AssessRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One assessment per shape, in order", body = AssessAnswer),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(super) async fn assess(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let received = AssessRequest::receive(&app, &key, body).await?;
    let settings = |request: AssessRequest, ready: &Ready, errors: &mut Vec<Fault>| {
        let quantile = quantile_of(request.quantile, errors);
        let samples = samples_of(request.samples, ready, errors);
        quantile.zip(samples).map(|((quantile, _), samples)| ((quantile, samples), samples))
    };
    ask_dictionary(app, received, settings, |app, ready, asked, (quantile, samples)| {
        let assessments = classify::assess(app, ready, asked, quantile, samples)?;
        let output = |assessment| AssessmentOutput::new(ready, assessment);
        let assessments = assessments.into_iter().map(output).collect::<Result<_, _>>()?;
        Ok(AssessAnswer {
            dictionary: UsedDictionary::new(ready),
            assessments,
            warnings: outlier_warnings(ready),
        })
    })
    .await
}
