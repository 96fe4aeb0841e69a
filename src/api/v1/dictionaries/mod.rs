//! Dictionaries, which jobs learn from cohorts: learn, list, read, draw, export, import, delete.

pub(in crate::api) mod aliases;
pub(in crate::api) mod assessments;
pub(in crate::api) mod classify;
pub(in crate::api) mod coding;
pub(in crate::api) mod complete;
pub(in crate::api) mod drift;
pub(in crate::api) mod pictures;
pub(in crate::api) mod report;
pub(in crate::api) mod scatter;

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use std::sync::Arc;

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use crate::analysis::alignment::Alignment;
use crate::analysis::classifier_record::{ClassifierKind, ClassifierSettings};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::dictionary::content::{Atom, Statistics};
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::modes::Mode;
use crate::analysis::estimate::Estimate;
use crate::analysis::factors::{Minority, RobustSummary};
use crate::analysis::frame::Frame;
use crate::analysis::mean_record::MeanRecord;
use crate::analysis::transformation::Transformation;
use crate::api::extract::{
    BesideFormat, Caller, Format, JsonBody, NoQuery, OnlyFormat, Path, Prefer, Query, ShapeFormat,
};
use crate::api::problem::Problem;
use crate::api::respond::{compute, file_of, json, mesh, picture};
use crate::api::v1::administration::jobs::accepted;
use crate::api::v1::dictionaries::classify::ClassifierOutput;
use crate::api::v1::requests::entity_tags::{Asked, kept_by_version, unless_known};
use crate::api::v1::requests::request_macros::{PageQuery, ShapeOutput, page, priority_of};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::dictionary::{LessCountedShape, Listed};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{Job, JobStatus, Priority};
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cost::requests;
use crate::service::dictionaries::answers::UsedDictionary;
use crate::service::dictionaries::file::DictionaryFile;
use crate::service::dictionaries::planning::{Decision, From as LearnFrom, Learn, Planned};
use crate::service::dictionaries::ready::Ready;
use crate::service::dictionaries::{file, modes, planning, ready};
use crate::service::jobs;
use crate::wire::checked::{Checked, document, take_given, take_or_default};
use crate::wire::gltf::{self, Play};
use crate::wire::mesh::MeshFormat;
use crate::wire::shape::Points;
use crate::wire::time::rfc3339;

document! {
    /// A dictionary to learn.
    #[schema(example = json!({
        "name": "cells-modes", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 10, "centre": true}
    }))]
    pub(super) struct LearnRequest {
        /// Name: letters, digits, '.', '_' and '-', at most 100 characters. An existing name gets a new version.
        #[schema(value_type = String, required = true)]
        name: Checked<String>, required;
        /// Id or name of the cohort.
        #[schema(value_type = String, required = true)]
        cohort: Checked<String>, required;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Transformation class to remove. Required unless `continue_from` is given.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method. Default: `projection`, or `procrustes` where the class is no linear space: `rigid`, and `similarity`
        /// in three dimensions.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Representative of the mean space used as the mean shape. Default: `training`.
        #[schema(value_type = Option<Frame>)]
        frame: Checked<Frame>;
        /// Whether shapes may be matched to mirror images. Default: the cohort's setting.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Learning method and its parameters. Required unless `continue_from` is given.
        #[schema(value_type = Option<Method>)]
        method: Checked<Method>;
        /// Whether shapes unlike the majority are left out, or count less: another organ, a mirrored or leaked one. At least five shapes,
        /// and no classifier. Default: false.
        #[schema(value_type = Option<bool>)]
        robust: Checked<bool>;
        /// Seed of the choice of the held-out shapes, which set the limit of outliers: those of the smallest BLAKE3 digests of this seed and
        /// their contents, whatever their order. Default: 0.
        #[schema(value_type = Option<u64>)]
        held_out_seed: Checked<u64>;
        /// Whether the parameters of surfaces with poles that came as meshes correspond, as those of meshes with common vertices do. They
        /// are refused otherwise: `POST /v1/cohorts/{cohort}/correspond` makes a cohort in which they do. Default: false.
        #[schema(value_type = Option<bool>)]
        corresponding: Checked<bool>;
        /// Classifier to train. Default: none. It is trained on all shapes, and validated on shapes that neither it nor the
        /// dictionary has seen.
        #[schema(value_type = Option<ClassifierSettings>)]
        classifier: Checked<ClassifierSettings>;
        /// Id, `name@version`, `name@alias` or name of the version to continue from, with its parameters, mean shape and accumulated sums:
        /// only shapes added since then are learnt from. Cannot be combined with the parameters.
        #[schema(value_type = Option<String>)]
        continue_from: Checked<String>;
        /// Whether nothing is learnt if the newest version of the name was learnt from the same shapes with the same parameters; that version
        /// is returned then. Default: false.
        #[schema(value_type = Option<bool>)]
        only_if_changed: Checked<bool>;
        /// Whether to return only the predicted cost. Default: false.
        #[schema(value_type = Option<bool>)]
        dry_run: Checked<bool>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Predicted cost of learning.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EstimateAnswer {
    /// Predicted cost.
    estimate: Estimate,
    /// Revision of the cohort that would be learnt from.
    cohort_revision: u64,
    /// Learning method with all defaults filled in.
    method: Method,
}

/// Answer if nothing is learnt.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(super) enum NotLearnt<'a> {
    /// Predicted cost (dry run).
    Estimate(Box<EstimateAnswer>),
    /// The newest version, which would be learnt again.
    Unchanged(Box<DictionaryOutput<'a>>),
}

/// Training data, seed and program behind a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ProvenanceOutput {
    /// Filter that selected the shapes of the cohort.
    filter: ShapeFilter,
    /// BLAKE3 digest of the control points and weights of the shapes, in the order of the cohort.
    shapes_digest: String,
    /// BLAKE3 digest of the learnt dictionary: equal shapes and parameters give equal digests.
    digest: String,
    /// Seed of all random choices; null if there are none.
    seed: Option<u64>,
    /// Id of the version that learning continued from.
    continued_from: Option<String>,
    /// Program and its version.
    program: String,
    /// Warnings about the shapes in everything that is computed with the dictionary; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
}

impl ProvenanceOutput {
    fn new(listed: &Listed) -> Self {
        let provenance = &listed.provenance;
        Self {
            filter: provenance.filter.clone(),
            shapes_digest: provenance.shapes_digest.clone(),
            digest: listed.digest.clone(),
            seed: listed.summary.method.seed(),
            continued_from: provenance.continued_from.clone(),
            program: provenance.program.clone(),
            warnings: provenance.warnings.clone(),
            created_at: rfc3339(listed.created_at_ms),
        }
    }
}

/// Entry of the list of dictionaries.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DictionaryEntry {
    /// Identifier of the version.
    #[schema(example = "dic_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Name shared by all versions; on its own it addresses the latest version.
    name: String,
    /// Version, from 1; addressed as `name@version`.
    version: u64,
    /// Id of the cohort.
    cohort: String,
    /// Name of the cohort when the dictionary was learnt.
    cohort_name: String,
    /// Revision of the cohort when the dictionary was learnt.
    cohort_revision: u64,
    /// Representation of the shapes.
    representation: Representation,
    /// Transformation class removed before comparison.
    transformation: Transformation,
    /// Learning method with all its parameters.
    method: Method,
    /// Number of atoms or components.
    atoms: usize,
    /// Number of training shapes.
    #[serde(rename = "shape_count")]
    shapes: usize,
    /// Mean objective over the training shapes.
    objective: f64,
    /// Mean reconstruction error over the training shapes.
    reconstruction_error: f64,
    /// Kind of classifier; null without one.
    classifier: Option<ClassifierKind>,
    /// Fraction of the shapes classified correctly in cross-validation.
    accuracy: Option<f64>,
    /// Training data, seed and program behind the dictionary.
    provenance: ProvenanceOutput,
}

page! {
    /// One page of dictionaries.
    PageOfDictionaries of DictionaryEntry
}

impl From<Listed> for DictionaryEntry {
    fn from(listed: Listed) -> Self {
        let provenance = ProvenanceOutput::new(&listed);
        let Listed { id, name, version, summary, provenance: source, .. } = listed;
        Self {
            id,
            name,
            version,
            cohort: source.cohort,
            cohort_name: source.cohort_name,
            cohort_revision: source.cohort_revision,
            representation: summary.representation,
            transformation: summary.transformation,
            method: summary.method,
            atoms: summary.atoms,
            shapes: summary.shapes,
            objective: summary.objective,
            reconstruction_error: summary.reconstruction_error,
            classifier: summary.classifier,
            accuracy: summary.accuracy,
            provenance,
        }
    }
}

/// A dictionary: mean shape, atoms, statistics and classifier.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DictionaryOutput<'a> {
    /// Identifier of the version.
    #[schema(example = "dic_0198c0ffee00700080000000000000aa")]
    id: &'a str,
    /// Name shared by all versions; on its own it addresses the latest version.
    name: &'a str,
    /// Version, from 1; addressed as `name@version`.
    version: u64,
    /// Id of the cohort.
    cohort: &'a str,
    /// Name of the cohort when the dictionary was learnt.
    cohort_name: &'a str,
    /// Revision of the cohort when the dictionary was learnt.
    cohort_revision: u64,
    /// Representation of the shapes.
    representation: &'a Representation,
    /// Point correspondence between shapes.
    correspondence: Correspondence,
    /// Treatment of contour direction.
    direction: Direction,
    /// Whether shapes may be matched to mirror images.
    mirror: Mirror,
    /// Unit of the coordinates of the cohort.
    length_unit: Option<&'a str>,
    /// Transformation class removed before comparison.
    transformation: &'a Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    alignment: Alignment,
    /// Representative of the mean space used as the mean shape.
    frame: Frame,
    /// Learning method with all its parameters.
    method: &'a Method,
    /// Mean shape.
    mean: &'a MeanRecord,
    /// Arithmetic mean of the aligned shapes; null for sparse atoms.
    centre: Option<&'a [Vec<f64>]>,
    /// Eigenshapes, orthonormal in `L₂`; or atoms of unit norm.
    atoms: &'a [Atom],
    /// Warnings about the shapes in everything that is computed with the dictionary; absent if there are none.
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    #[schema(required = false)]
    warnings: &'a [String],
    /// Convergence of the learning, and quality of the description of the shapes.
    statistics: &'a Statistics,
    /// Shapes that were left out, or count less; absent without `robust`.
    #[serde(skip_serializing_if = "Option::is_none")]
    robust: Option<RobustDictionary<'a>>,
    /// Classifier and its validation; null if none was requested.
    classifier: Option<ClassifierOutput<'a>>,
    /// Training data, seed and program behind the dictionary.
    provenance: ProvenanceOutput,
}

/// Shapes that a robust dictionary leaves out.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RobustDictionary<'a> {
    /// Number of shapes that are left out: their weight is zero.
    rejected: usize,
    /// Number of shapes that count less than their weight, without those left out.
    reduced: usize,
    /// Number of equal weights that the weights are worth, `(Σw)²/Σw²`.
    effective: f64,
    /// Shapes that count although they are unlike the majority and agree with each other; absent if there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    minority: Option<Minority>,
    /// Shapes with the smallest factors below one, at most 20, and where along them they are wrong.
    #[schema(max_items = 20)]
    shapes: &'a [LessCountedShape],
}

impl<'a> RobustDictionary<'a> {
    fn new(summary: RobustSummary, shapes: &'a [LessCountedShape]) -> Self {
        let RobustSummary { rejected, reduced, effective, minority } = summary;
        Self { rejected, reduced, effective, minority, shapes }
    }
}

impl<'a> DictionaryOutput<'a> {
    fn new(ready: &'a Ready) -> Self {
        let (listed, content, provenance) =
            (&ready.listed, &ready.dictionary().content, &ready.listed.provenance);
        Self {
            id: &listed.id,
            name: &listed.name,
            version: listed.version,
            cohort: &provenance.cohort,
            cohort_name: &provenance.cohort_name,
            cohort_revision: provenance.cohort_revision,
            representation: &content.representation,
            correspondence: content.correspondence,
            direction: content.direction,
            mirror: content.mirror,
            length_unit: content.length_unit.as_deref(),
            transformation: &content.transformation,
            alignment: content.alignment,
            frame: content.frame,
            method: &content.method,
            mean: &content.mean,
            centre: content.centre.as_deref(),
            atoms: &content.atoms,
            warnings: &provenance.warnings,
            statistics: &content.statistics,
            robust: content.robust.map(|summary| RobustDictionary::new(summary, &provenance.less_counted)),
            classifier: content.classifier.as_ref().map(ClassifierOutput::new),
            provenance: ProvenanceOutput::new(listed),
        }
    }
}

/// Learns a dictionary from a cohort.
///
/// The response is a job (202). With `Prefer: wait=N` it is the dictionary (201) if that is ready within `N` seconds, at most
/// 60. With `dry_run` it is the predicted cost (200), and nothing runs. The cohort is used as it is now, even if shapes are
/// added meanwhile. Learning again from the same shapes with the same parameters gives the same digest; with `only_if_changed` it is
/// left out, and the response is the newest version (200).
#[utoipa::path(post, path = "/v1/dictionaries", tag = "dictionaries", request_body = LearnRequest,
    params(("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the dictionary"), RetryHeader),
    responses(
        (status = 200, description = "Predicted cost (dry run), or the newest version (`only_if_changed`)", body = NotLearnt),
        (status = 201, description = "The dictionary, if it was learnt within the wait", body = DictionaryOutput, headers(("Location" = String))),
        (status = 202, description = "The job that learns the dictionary", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or learning failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(super) async fn learn_dictionary(
    Caller(app): Caller,
    _: NoQuery,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let mut request: LearnRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let (learn, dry_run) = learn_of(request)?;
    let Planned { plan, estimate } = match planning::decide(&app, learn).await? {
        Decision::Learn(planned) => *planned,
        Decision::Unchanged(ready) => return Ok(json(StatusCode::OK, &DictionaryOutput::new(&ready))?),
    };
    if dry_run {
        let (cohort_revision, method) = (plan.revision, plan.method);
        return Ok(json(StatusCode::OK, &EstimateAnswer { estimate, cohort_revision, method })?);
    }
    let job = planning::submit(&app.clone().with_body(&body), plan, &estimate).await?;
    // Who does not wait is told of the job, also when the same request has been answered before and the job is over.
    let Some(time) = prefer.wait else { return Ok(accepted(job)?) };
    learnt(&app, jobs::wait(&app, &job.id, time).await?).await
}

/// The dictionary of a job that has succeeded, else the job.
async fn learnt(app: &App, job: Job) -> Result<Response, Problem> {
    match (job.status, job.result.as_ref().and_then(|result| result["dictionary"].as_str())) {
        (JobStatus::Succeeded, Some(id)) => {
            let ready = ready::find(app, id).await?;
            let location = format!("/v1/dictionaries/{id}");
            let response = json(StatusCode::CREATED, &DictionaryOutput::new(&ready))?;
            Ok(([(header::LOCATION, location)], response).into_response())
        }
        (JobStatus::Failed, _) => Err(Problem::from_failed(&job)),
        _ => Ok(accepted(job)?),
    }
}

/// Fields that a request with `continue_from` may not have, and whether they are given.
fn given_fields(request: &LearnRequest) -> [(&'static str, bool); 10] {
    [
        ("filter", request.filter.is_some()),
        ("transformation", request.transformation.is_some()),
        ("alignment", request.alignment.is_some()),
        ("frame", request.frame.is_some()),
        ("mirror", request.mirror.is_some()),
        ("method", request.method.is_some()),
        ("robust", request.robust.is_some()),
        ("held_out_seed", request.held_out_seed.is_some()),
        ("corresponding", request.corresponding.is_some()),
        ("classifier", request.classifier.is_some()),
    ]
}

fn learn_of(request: LearnRequest) -> Result<(Learn, bool), ServiceError> {
    let (continues, given) = (request.continue_from.is_some(), given_fields(&request));
    let mut errors = request.faults;
    let mut faults: Vec<Fault> = Vec::new();
    for (field, given) in given {
        let needed = matches!(field, "transformation" | "method");
        if continues && given {
            faults.push(Fault::new(
                format!("/{field}"),
                "expected no value with continue_from: the field is that of the continued version",
            ));
        } else if !continues && !given && needed {
            faults.push(Fault::new(format!("/{field}"), "required field is missing"));
        }
    }
    let name = take_given(request.name, "/name", &mut errors);
    let cohort = take_given(request.cohort, "/cohort", &mut errors);
    let filter = take_filter(request.filter, "/filter", &mut errors);
    let transformation = take_given(request.transformation, "/transformation", &mut errors);
    let alignment = take_given(request.alignment, "/alignment", &mut errors);
    let frame = take_or_default(request.frame, "/frame", &mut errors);
    let mirror = take_given(request.mirror, "/mirror", &mut errors);
    let method = take_given(request.method, "/method", &mut errors);
    let robust = take_or_default(request.robust, "/robust", &mut errors);
    let held_out_seed = take_or_default(request.held_out_seed, "/held_out_seed", &mut errors);
    let corresponding = take_or_default(request.corresponding, "/corresponding", &mut errors);
    let classifier = take_given(request.classifier, "/classifier", &mut errors);
    let version = take_given(request.continue_from, "/continue_from", &mut errors);
    let only_if_changed = take_or_default(request.only_if_changed, "/only_if_changed", &mut errors);
    let dry_run = take_or_default(request.dry_run, "/dry_run", &mut errors);
    faults.extend(errors);
    ServiceError::unless_empty(faults)?;
    let incomplete = || ServiceError::invalid("", "the request is incomplete");
    let from = match version {
        Some(version) => LearnFrom::Version(version),
        None => LearnFrom::Anew {
            filter: Box::new(filter.ok_or_else(incomplete)?),
            transformation: transformation.ok_or_else(incomplete)?,
            alignment,
            frame: frame.ok_or_else(incomplete)?,
            mirror,
            method: method.ok_or_else(incomplete)?,
            robust: robust.ok_or_else(incomplete)?,
            held_out_seed: held_out_seed.ok_or_else(incomplete)?,
            corresponding: corresponding.ok_or_else(incomplete)?,
            classifier: classifier.map(Box::new),
        },
    };
    let (name, cohort) = (name.ok_or_else(incomplete)?, cohort.ok_or_else(incomplete)?);
    let learn = Learn { name, cohort, from, only_if_changed: only_if_changed.unwrap_or(false) };
    Ok((learn, dry_run.unwrap_or(false)))
}

/// Filter and page of the list of dictionaries.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct DictionariesQuery {
    /// Versions of this name only.
    name: Option<String>,
    /// Dictionaries learnt from this cohort only, by id or name.
    cohort: Option<String>,
    /// Cursor from the previous page.
    cursor: Option<String>,
    /// Entries per page, 1 to 1000. Default: 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
}

/// Lists dictionaries in order of creation, one entry per version.
#[utoipa::path(get, path = "/v1/dictionaries", tag = "dictionaries", params(DictionariesQuery),
    responses(
        (status = 200, description = "A page of dictionaries", body = PageOfDictionaries),
        (status = 400, description = "The query was refused")
    ))]
pub(super) async fn list_dictionaries(
    Caller(app): Caller,
    Query(query): Query<DictionariesQuery>,
) -> Result<Response, Problem> {
    let DictionariesQuery { name, cohort, cursor, limit } = query;
    let page = PageQuery { cursor, limit };
    let (items, next) =
        planning::list(&app, name, cohort.as_deref(), page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<DictionaryEntry> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfDictionaries { items, next })?)
}

/// Entity tag of a version, which never changes.
fn digest_tag(ready: &Ready) -> String {
    format!("\"{}\"", ready.listed.id)
}

/// Returns a dictionary by id, by `name@version` or `name@alias`, or by name (the latest version).
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name")),
    responses(
        (status = 200, description = "The dictionary; its ETag identifies the version", body = DictionaryOutput),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such dictionary")
    ))]
pub(super) async fn find_dictionary(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let ready = ready::find(&app, &key).await?;
    let (tag, found) = (digest_tag(&ready), Arc::clone(&ready));
    let answer =
        compute(app.weighing(Work::MOMENT), move |_| json(StatusCode::OK, &DictionaryOutput::new(&ready)));
    Ok(kept_by_version(unless_known(&headers, &tag, answer).await?, &key, &found.listed))
}

/// Moves a version (by id or `name@version`) or all versions of a name to the trash.
///
/// A version that an alias names is refused, and with it the deletion of all versions of its name: move or delete the alias first.
#[utoipa::path(delete, path = "/v1/dictionaries/{dictionary}", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name")),
    responses(
        (status = 204, description = "Moved to the trash"),
        (status = 404, description = "No such dictionary"),
        (status = 409, description = "An alias names the version")
    ))]
pub(super) async fn delete_dictionary(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
) -> Result<StatusCode, Problem> {
    planning::delete(&app, &key).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Atoms of a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AtomsAnswer<'a> {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// One entry per atom.
    atoms: &'a [Atom],
}

/// Returns the atoms or components of a dictionary.
///
/// As SVG: the atoms side by side.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/atoms", tag = "dictionaries",
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "The atoms", content((AtomsAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such dictionary")
    ))]
pub(super) async fn dictionary_atoms(
    Caller(app): Caller,
    Path(key): Path<String>,
    OnlyFormat(format): OnlyFormat,
    asked: Asked,
) -> Result<Response, Problem> {
    let ready = ready::find(&app, &key).await?;
    let found = Arc::clone(&ready);
    let answer = compute(app.weighing(Work::MOMENT + format.work()), move |_| match format {
        Format::Picture(file) => picture(&modes::draw_atoms(&ready), &file),
        Format::Json => {
            let (dictionary, atoms) =
                (UsedDictionary::new(&ready), ready.dictionary().content.atoms.as_slice());
            json(StatusCode::OK, &AtomsAnswer { dictionary, atoms })
        }
    });
    let response = asked.unless_known(&found.listed.id, format, answer).await?;
    Ok(kept_by_version(response, &key, &found.listed))
}

/// Selects a mode and its amplitude.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ModeQuery {
    /// Component, from 1. Default: 1.
    #[param(minimum = 1)]
    component: Option<usize>,
    /// Number of standard deviations. Default: 2.
    #[param(minimum = -1000000, maximum = 1000000)]
    sigma: Option<f64>,
}

/// A mode of variation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ModeAnswer {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// Component, from 1.
    component: usize,
    /// Number of standard deviations.
    sigma: f64,
    /// Fraction of the variance or energy explained.
    explained: f64,
    /// Standard deviation of the scores.
    deviation: f64,
    /// Mean minus `sigma` standard deviations.
    minus: ShapeOutput,
    /// Arithmetic mean of the aligned shapes.
    mean: ShapeOutput,
    /// Mean plus `sigma` standard deviations.
    plus: ShapeOutput,
    /// Warnings about the shapes that the dictionary was learnt from; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
}

impl ModeAnswer {
    fn new(ready: &Ready, component: usize, sigma: f64, mode: Mode) -> Self {
        let (dictionary, dimension) = (UsedDictionary::new(ready), ready.setup.metric.dimension());
        let Mode { explained, deviation, shapes } = mode;
        let [minus, mean, plus] =
            shapes.map(|shape| ShapeOutput { control_points: Points::from_columns(shape, dimension) });
        let warnings = dictionary.warnings.clone();
        Self { dictionary, component, sigma, explained, deviation, minus, mean, plus, warnings }
    }
}

/// Predicted work of answering a mode in a format.
fn mode_work(ready: &Ready, format: ShapeFormat) -> Work {
    let meshes = match format {
        ShapeFormat::Plain(_) => 0,
        ShapeFormat::Mesh(MeshFormat::Gltf, _) => 1 + ready.dictionary().model.len().min(modes::MAX_TARGETS),
        ShapeFormat::Mesh(..) => 1,
    };
    let grid = match format {
        ShapeFormat::Mesh(_, Some(grid)) => grid,
        _ => [256, 256],
    };
    Work::MOMENT + format.work() + meshes as f64 * requests::mesh(grid)
}

/// Returns the mean and the two sides of a mode of variation.
///
/// As SVG: steps of the mode side by side. As OBJ, PLY or STL: the mesh of the surface at the mean plus `sigma` standard
/// deviations; `sigma` may be negative. As glTF: the mesh of the mean with one morph target for each of the first 16
/// components, or for the one asked for, whose weight 1 stands for `sigma` standard deviations.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/modes", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), ModeQuery, ShapeFormatQuery, DrawingQuery),
    responses(
        (status = 200, description = "The mode", content((ModeAnswer = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such dictionary"),
        (status = "4XX", description = "The query was refused, or the dictionary has no modes")
    ))]
pub(super) async fn dictionary_mode(
    Caller(app): Caller,
    Path(key): Path<String>,
    format: ShapeFormat,
    BesideFormat(query): BesideFormat<ModeQuery>,
    asked: Asked,
) -> Result<Response, Problem> {
    let ready = ready::find(&app, &key).await?;
    let (found, work) = (Arc::clone(&ready), mode_work(&ready, format));
    let answer = compute(app.weighing(work), move |_| answer_mode(&ready, &query, format));
    let response = asked.unless_known(&found.listed.id, format, answer).await?;
    Ok(kept_by_version(response, &key, &found.listed))
}

fn answer_mode(ready: &Ready, query: &ModeQuery, format: ShapeFormat) -> Result<Response, ServiceError> {
    let (component, sigma) = (query.component.unwrap_or(1), query.sigma.unwrap_or(2.0));
    if let ShapeFormat::Mesh(MeshFormat::Gltf, grid) = format {
        let (mean, displacements) = modes::displacements(ready, query.component, sigma, grid)?;
        return Ok(file_of(MeshFormat::Gltf, gltf::write(&mean, displacements, Play::Each)?));
    }
    let mode = modes::mode(ready, component, sigma)?;
    match format {
        ShapeFormat::Plain(Format::Picture(file)) => {
            picture(&modes::draw_mode(ready, component, sigma, &mode), &file)
        }
        ShapeFormat::Mesh(format, grid) => mesh(&ready.setup.space, &mode.shapes[2], format, grid),
        ShapeFormat::Plain(Format::Json) => {
            json(StatusCode::OK, &ModeAnswer::new(ready, component, sigma, mode))
        }
    }
}

/// Exports a dictionary as one file.
///
/// The file is JSON in the format of `docs/dictionaries.md`; another service imports it with the same digest.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/export", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name")),
    responses(
        (status = 200, description = "The file", body = DictionaryFile),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such dictionary")
    ))]
pub(super) async fn export_dictionary(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    asked: Asked,
) -> Result<Response, Problem> {
    let ready = ready::find(&app, &key).await?;
    let (id, name) =
        (ready.listed.id.clone(), format!("{}-{}.json", ready.listed.name, ready.listed.version));
    let work = Work::numbers((ready.dictionary().model.len() * ready.setup.metric.len()) as f64);
    let answer =
        compute(app.weighing(work), move |_| json(StatusCode::OK, &DictionaryFile::new(&ready).text()?));
    let response = asked.unless_known(&id, "file", answer).await?;
    let disposition = format!("attachment; filename=\"{name}\"");
    Ok(([(header::CONTENT_DISPOSITION, disposition)], response).into_response())
}

/// Name of the imported dictionary.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ImportQuery {
    /// Name to import under. Default: the name in the file.
    name: Option<String>,
}

/// Imports an exported dictionary as the next version of its name.
#[utoipa::path(post, path = "/v1/dictionaries/import", tag = "dictionaries", params(ImportQuery, RetryHeader), request_body = DictionaryFile,
    responses(
        (status = 201, description = "Imported", body = DictionaryOutput, headers(("Location" = String))),
        (status = "4XX", description = "The file was refused")
    ))]
pub(super) async fn import_dictionary(
    Caller(app): Caller,
    Query(query): Query<ImportQuery>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let reader = app.clone();
    let file: DictionaryFile = app.pool.read(body, move |body| reader.parse_whole(body)).await?;
    let ready = file::import(&app, file, query.name).await?;
    let location = format!("/v1/dictionaries/{}", ready.listed.id);
    let response = json(StatusCode::CREATED, &DictionaryOutput::new(&ready))?;
    Ok(([(header::LOCATION, location)], response).into_response())
}
