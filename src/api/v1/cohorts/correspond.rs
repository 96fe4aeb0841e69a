//! Groupwise correspondence of the surfaces of a cohort, and of new surfaces against a dictionary.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::groupwise::{
    Corresponding, DEGREE, GroupwiseOptions, MAX_DEGREE, MAX_ROUNDS, ROUNDS, STIFFNESS,
};
use crate::api::extract::{Caller, JsonBody, NoQuery, Path, Prefer};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::dictionaries::coding::{Shapes, ask_dictionary, asking_request, receive};
use crate::api::v1::requests::batches::{Batch, results};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{Waited, waited};
use crate::api::v1::requests::request_macros::priority_of;
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
use crate::service::app::ServiceError;
#[cfg(feature = "schema")]
use crate::service::correspondence::CohortCorrespondence;
use crate::service::correspondence::{self, CorrespondRequest};
use crate::service::dictionaries::answers::ByDictionary;
use crate::service::dictionaries::correspond;
use crate::service::dictionaries::ready::Ready;
use crate::wire::checked::{Checked, List, Many, document, take_given, take_many};
use crate::wire::fault::Fault;
use crate::wire::shape::{Points, ShapeInput};

document! {
    /// How the surfaces of a cohort are brought into correspondence.
    #[schema(example = json!({"name": "hippocampi-corresponding", "degree": 4}))]
    pub(in crate::api::v1) struct CorrespondCohortRequest {
        /// Name of the new cohort: letters, digits, '.', '_' and '-', at most 100 characters.
        #[schema(value_type = String, required = true)]
        name: Checked<String>, required;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Highest degree of the fields that move the parameters, 0 (rotations only) to 6. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 0, maximum = 6)]
        degree: Checked<usize>;
        /// Steps of every surface for each degree, 1 to 20. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 20)]
        rounds: Checked<usize>;
        /// Weight of the deformations of the parameters. Default: 10.
        #[schema(value_type = Option<f64>, minimum = 1e-4, maximum = 1e4)]
        stiffness: Checked<f64>;
        /// Whether sizes are compared; otherwise every surface is scaled to unit area while its parameters are searched. Stored
        /// shapes keep their size. Default: true.
        #[schema(value_type = Option<bool>)]
        sizes: Checked<bool>;
        /// Priority among the tenant's queued jobs. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Brings the surfaces of a cohort into correspondence, without a template.
///
/// The parameters of all surfaces are moved by rotations and smooth maps of the parameter sphere that together minimise the entropy
/// of the shapes. The job stores the surfaces with their new parameters in a new cohort, whose points correspond as given
/// (`landmarks`); labels, subjects and external ids are kept, and the metadata say where each shape comes from. With
/// `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/correspond", tag = "cohorts", request_body = CorrespondCohortRequest,
    params(
        ("cohort" = String, Path, description = "Id or name of a cohort of surfaces with the topology `sphere`"),
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The new cohort, with the result for each shape", body = CohortCorrespondence),
        (status = 202, description = "The job that computes it", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = 409, description = "The name is already in use"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn correspond_cohort(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: CorrespondCohortRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let job = correspondence::submit(&app, &key, request.checked()?).await?;
    match waited(&app, job, prefer).await? {
        Waited::Succeeded(job) => Ok(json(StatusCode::OK, &job.result)?),
        Waited::Else(response) => Ok(response),
    }
}

impl CorrespondCohortRequest {
    fn checked(self) -> Result<CorrespondRequest, ServiceError> {
        let mut errors = self.faults;
        let name = take_given(self.name, "/name", &mut errors);
        let filter = take_filter(self.filter, "/filter", &mut errors);
        let degree = self.degree.map_or(Some(DEGREE), |field| field.take("/degree", &mut errors));
        let rounds = self.rounds.map_or(Some(ROUNDS), |field| field.take("/rounds", &mut errors));
        let stiffness = self.stiffness.map_or(Some(STIFFNESS), |field| field.take("/stiffness", &mut errors));
        let sizes = self.sizes.map_or(Some(true), |field| field.take("/sizes", &mut errors));
        ServiceError::unless_empty(errors)?;
        match (name, filter, degree, rounds, stiffness, sizes) {
            (Some(name), Some(filter), Some(degree), Some(rounds), Some(stiffness), Some(sizes)) => {
                Ok(CorrespondRequest {
                    name,
                    filter,
                    options: GroupwiseOptions { degree, rounds, sizes, stiffness },
                })
            }
            _ => Err(ServiceError::invalid("", "the request is incomplete")),
        }
    }
}

asking_request! {
    /// Surfaces to bring into correspondence with a dictionary.
    #[schema(example = json!({"cohort": "hippocampi", "ids": ["hippocampus_001"]}))]
    CorrespondShapesRequest {
        /// Highest degree of the fields that move the parameters, 0 (rotations only) to 6. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 0, maximum = 6)]
        degree: Checked<usize>;
        /// Steps of every surface for each degree, 1 to 20. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 20)]
        rounds: Checked<usize>;
        /// Weight of the deformations of the parameters. Default: 10.
        #[schema(value_type = Option<f64>, minimum = 1e-4, maximum = 1e4)]
        stiffness: Checked<f64>;
    }
}

/// A surface in correspondence with a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CorrespondingOutput {
    /// Control points of the surface with its new parameters, in the pose in which it was given.
    control_points: Points,
    /// Root mean square distance between the reparametrised surface and the answered one, over the parameters.
    residual: f64,
    /// The same divided by the root mean square distance of the surface from its mean position.
    relative_residual: f64,
    /// Fraction of the area of the answered surface whose normal points against that of the given one.
    folded: f64,
    /// Smallest ratio of an area on the parameter sphere after the map to that before it; negative where the map folds.
    least_jacobian: f64,
    /// Root mean square displacement of the parameters besides the rotation, in radians.
    displacement: f64,
}

impl From<Corresponding> for CorrespondingOutput {
    fn from(found: Corresponding) -> Self {
        Self {
            residual: found.refit.residual,
            relative_residual: found.refit.relative_residual,
            folded: found.refit.folded,
            least_jacobian: found.least_jacobian,
            displacement: found.map.displacement(),
            control_points: Points::from_columns(found.refit.rows.as_slice().to_vec(), 3),
        }
    }
}

results! {
    /// Surfaces in correspondence.
    CorrespondAnswer with ByDictionary of CorrespondResult: CorrespondedShape with CorrespondingOutput
}

/// Brings new surfaces into correspondence with a dictionary of components, which stays as it is.
///
/// The rotation of the parameter sphere and a smooth map of it are searched that bring a surface nearest to the mean in the
/// metric of the dictionary's components. The dictionary is one of surfaces with the topology `sphere`, usually learnt from a cohort
/// of `POST /v1/cohorts/{cohort}/correspond`. The answered control points can be encoded, scored or classified.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/correspond", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((CorrespondShapesRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One surface per shape, in order", content((CorrespondAnswer = "application/json"), (CorrespondResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn correspond_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let received = receive::<CorrespondShapesRequest>(&app, &key, batch).await?;
    ask_dictionary::<_, _, CorrespondAnswer>(
        app,
        received,
        CorrespondShapesRequest::settings,
        |app, ready, asked, options| {
            let found = correspond::correspond(app, ready, asked, &options)?;
            Ok((found.map(|_, found| Ok(CorrespondingOutput::from(found))), ByDictionary::new(ready)))
        },
    )
    .await
}

impl CorrespondShapesRequest {
    /// The choices, and the numbers in whose time the work for a shape is done.
    fn settings(self, _: &Ready, errors: &mut Vec<Fault>) -> Option<(GroupwiseOptions, usize)> {
        let degree = self.degree.map_or(Some(DEGREE), |field| field.take("/degree", errors));
        let rounds = self.rounds.map_or(Some(ROUNDS), |field| field.take("/rounds", errors));
        let stiffness = self.stiffness.map_or(Some(STIFFNESS), |field| field.take("/stiffness", errors));
        let options = GroupwiseOptions {
            degree: degree?.min(MAX_DEGREE + 1),
            rounds: rounds?.min(MAX_ROUNDS + 1),
            sizes: true,
            stiffness: stiffness?,
        };
        errors.extend(correspondence::option_faults(&options));
        Some((options, correspond::numbers(&options)))
    }
}
