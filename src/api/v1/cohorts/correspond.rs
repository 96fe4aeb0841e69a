//! Correspondence of the surfaces or curves of a cohort, and of new ones against a dictionary.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::elastic::settings::{Effort, ElasticSettings};
use crate::analysis::groupwise::{DEGREE, GroupwiseOptions, MAX_DEGREE, MAX_ROUNDS, ROUNDS, STIFFNESS};
use crate::analysis::sliding::SlidingCriterion;
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
use crate::api::v1::statistics::matched::ElasticFields;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
use crate::numeric::dense::Matrix;
use crate::service::app::ServiceError;
#[cfg(feature = "schema")]
use crate::service::correspondence::CohortCorrespondence;
use crate::service::correspondence::{
    self, CorrespondMethod, CorrespondRequest, ElasticOptions, elastic_faults,
};
use crate::service::dictionaries::answers::ByDictionary;
use crate::service::dictionaries::correspond::{self, Following};
use crate::service::dictionaries::ready::Ready;
use crate::wire::checked::{Checked, List, Many, document, take_given, take_many};
use crate::wire::fault::Fault;
use crate::wire::shape::{Points, ShapeInput};

document! {
    /// How the surfaces or curves of a cohort are brought into correspondence.
    #[schema(example = json!({"name": "hippocampi-corresponding", "degree": 4}))]
    pub(in crate::api::v1) struct CorrespondCohortRequest {
        /// Name of the new cohort: letters, digits, '.', '_' and '-', at most 100 characters.
        #[schema(value_type = String, required = true)]
        name: Checked<String>, required;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Default: `groupwise` for surfaces, `elastic` for curves.
        #[schema(value_type = Option<CorrespondMethod>)]
        method: Checked<CorrespondMethod>;
        /// `groupwise`: highest degree of the fields that move the parameters, 0 (rotations only) to 6. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 0, maximum = 6)]
        degree: Checked<usize>;
        /// `groupwise`: steps of every surface for each degree, 1 to 20. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 20)]
        rounds: Checked<usize>;
        /// `groupwise`: weight of the deformations of the parameters. Default: 10.
        #[schema(value_type = Option<f64>, minimum = 1e-4, maximum = 1e4)]
        stiffness: Checked<f64>;
        /// `groupwise`: whether sizes are compared; otherwise every surface is scaled to unit area while its parameters are searched.
        /// Stored shapes keep their size. Default: true.
        #[schema(value_type = Option<bool>)]
        sizes: Checked<bool>;
        /// `elastic`: weight of bending against stretching, above 0 and up to 1: near 0, lengths correspond. Default: 1.
        #[schema(value_type = Option<f64>, maximum = 1)]
        elasticity: Checked<f64>;
        /// `elastic`, `sliding`: number of segments into which curves are divided, 16 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 16, maximum = 1000)]
        points: Checked<usize>;
        /// `sliding`: criterion that the points minimise. Default: `procrustes`.
        #[schema(value_type = Option<SlidingCriterion>)]
        criterion: Checked<SlidingCriterion>;
        /// `elastic`: thoroughness of the search. Default: `normal`.
        #[schema(value_type = Option<Effort>)]
        effort: Checked<Effort>;
        /// `elastic`: number of starts of the mean, of which the best is kept, 1 to 20: the mean with searched starts, then curves that
        /// stand for the others, which takes the distances of all pairs. Default: 1.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 20)]
        starts: Checked<usize>;
        /// `elastic`, `sliding`: number of control points (intervals of open curves) of the new curves, at least 8. Default: those of the cohort.
        #[schema(value_type = Option<usize>, minimum = 8)]
        control_points: Checked<usize>;
        /// Priority among the tenant's queued jobs. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Brings the surfaces or curves of a cohort into correspondence, without a template.
///
/// The parameters of all surfaces are moved by rotations and smooth maps of the parameter sphere that together minimise the entropy
/// of the shapes; those of curves follow the elastic mean, whose directions agree most with theirs, or slide to the positions of the
/// mean. The job stores the shapes with their new parameters in a new cohort, whose points correspond as given
/// (`landmarks`); labels, subjects and external ids are kept, and the metadata say where each shape comes from. With
/// `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/correspond", tag = "cohorts", request_body = CorrespondCohortRequest,
    params(
        ("cohort" = String, Path, description = "Id or name of a cohort of surfaces with the topology `sphere`, or of curves"),
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
        use CorrespondMethod::{Elastic, Groupwise, Sliding};
        let fields: [(&str, bool, &[CorrespondMethod]); 10] = [
            ("/degree", self.degree.is_some(), &[Groupwise]),
            ("/rounds", self.rounds.is_some(), &[Groupwise]),
            ("/stiffness", self.stiffness.is_some(), &[Groupwise]),
            ("/sizes", self.sizes.is_some(), &[Groupwise]),
            ("/elasticity", self.elasticity.is_some(), &[Elastic]),
            ("/points", self.points.is_some(), &[Elastic, Sliding]),
            ("/effort", self.effort.is_some(), &[Elastic]),
            ("/starts", self.starts.is_some(), &[Elastic]),
            ("/control_points", self.control_points.is_some(), &[Elastic, Sliding]),
            ("/criterion", self.criterion.is_some(), &[Sliding]),
        ];
        let given = fields.into_iter().filter(|field| field.1).map(|(name, _, of)| (name, of)).collect();
        let mut errors = self.faults;
        let name = take_given(self.name, "/name", &mut errors);
        let filter = take_filter(self.filter, "/filter", &mut errors);
        let method = take_given(self.method, "/method", &mut errors);
        let groupwise = GroupwiseOptions {
            degree: take_given(self.degree, "/degree", &mut errors).unwrap_or(DEGREE),
            rounds: take_given(self.rounds, "/rounds", &mut errors).unwrap_or(ROUNDS),
            stiffness: take_given(self.stiffness, "/stiffness", &mut errors).unwrap_or(STIFFNESS),
            sizes: take_given(self.sizes, "/sizes", &mut errors).unwrap_or(true),
        };
        let usual = SlidingCriterion::Procrustes;
        let criterion = take_given(self.criterion, "/criterion", &mut errors).unwrap_or(usual);
        let Self { elasticity, points, effort, .. } = self;
        let fields = ElasticFields { elasticity, points, rotation: None, effort };
        let elastic = ElasticOptions {
            elastic: fields.take(&mut errors),
            starts: take_given(self.starts, "/starts", &mut errors).unwrap_or(1),
            control_points: take_given(self.control_points, "/control_points", &mut errors),
        };
        ServiceError::unless_empty(errors)?;
        match (name, filter) {
            (Some(name), Some(filter)) => {
                Ok(CorrespondRequest { name, filter, method, given, groupwise, elastic, criterion })
            }
            _ => Err(ServiceError::invalid("", "the request is incomplete")),
        }
    }
}

asking_request! {
    /// Surfaces or curves to bring into correspondence with a dictionary.
    #[schema(example = json!({"cohort": "hippocampi", "ids": ["hippocampus_001"]}))]
    CorrespondShapesRequest {
        /// Surfaces: highest degree of the fields that move the parameters, 0 (rotations only) to 6. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 0, maximum = 6)]
        degree: Checked<usize>;
        /// Surfaces: steps of every surface for each degree, 1 to 20. Default: 4.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 20)]
        rounds: Checked<usize>;
        /// Surfaces: weight of the deformations of the parameters. Default: 10.
        #[schema(value_type = Option<f64>, minimum = 1e-4, maximum = 1e4)]
        stiffness: Checked<f64>;
        /// Curves: weight of bending against stretching, above 0 and up to 1: near 0, lengths correspond. Default: 1.
        #[schema(value_type = Option<f64>, maximum = 1)]
        elasticity: Checked<f64>;
        /// Curves: number of segments into which the mean and a curve are divided, 16 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 16, maximum = 1000)]
        points: Checked<usize>;
        /// Curves: thoroughness of the search. Default: `normal`.
        #[schema(value_type = Option<Effort>)]
        effort: Checked<Effort>;
    }
}

/// A surface or curve in correspondence with a dictionary.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CorrespondingOutput {
    /// Control points of the shape with its new parameters, in the pose in which it was given.
    #[schema(value_type = Points)]
    control_points: Option<Points>,
    /// Root mean square distance between the reparametrised shape and the answered one, over the parameters.
    residual: f64,
    /// The same divided by the root mean square distance of the shape from its mean position.
    relative_residual: f64,
    /// Surfaces: fraction of the area of the answered surface whose normal points against that of the given one.
    #[serde(skip_serializing_if = "Option::is_none")]
    folded: Option<f64>,
    /// Surfaces: smallest ratio of an area on the parameter sphere after the map to that before it; negative where the map folds.
    #[serde(skip_serializing_if = "Option::is_none")]
    least_jacobian: Option<f64>,
    /// Surfaces: root mean square displacement of the parameters besides the rotation, in radians.
    #[serde(skip_serializing_if = "Option::is_none")]
    displacement: Option<f64>,
    /// Curves: elastic distance from the mean of the dictionary, 0 to π/2.
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<f64>,
    /// Curves: largest distance between the reparametrised curve and the answered one.
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_residual: Option<f64>,
    /// Curves: place of the given curve, as a fraction of its length, at which the answered one begins.
    #[serde(skip_serializing_if = "Option::is_none")]
    start: Option<f64>,
    /// Curves: whether the answered curve is traversed in the other direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    reversed: Option<bool>,
    /// Curves: whether the mirror image is matched; the answered curve is not mirrored.
    #[serde(skip_serializing_if = "Option::is_none")]
    mirrored: Option<bool>,
    /// Curves: smallest and largest slope of the fraction of the length by the parameter of the dictionary.
    #[serde(skip_serializing_if = "Option::is_none")]
    slopes: Option<[f64; 2]>,
}

impl From<Following> for CorrespondingOutput {
    fn from(found: Following) -> Self {
        let points = |rows: &Matrix| Points::from_columns(rows.as_slice().to_vec(), rows.ncols());
        match found {
            Following::Surface(found) => Self {
                control_points: Some(points(&found.refit.rows)),
                residual: found.refit.residual,
                relative_residual: found.refit.relative_residual,
                folded: Some(found.refit.folded),
                least_jacobian: Some(found.least_jacobian),
                displacement: Some(found.map.displacement()),
                ..Self::default()
            },
            Following::Curve(found) => {
                let (matched, refit, slopes) = *found;
                Self {
                    control_points: Some(points(&refit.control_points)),
                    residual: refit.residual,
                    relative_residual: refit.relative_residual,
                    distance: Some(matched.distance),
                    largest_residual: Some(refit.largest),
                    start: Some(matched.places[0]),
                    reversed: Some(matched.reversed),
                    mirrored: Some(matched.mirrored),
                    slopes: Some(slopes),
                    ..Self::default()
                }
            }
        }
    }
}

results! {
    /// Surfaces or curves in correspondence.
    CorrespondAnswer with ByDictionary of CorrespondResult: CorrespondedShape with CorrespondingOutput
}

/// Brings new surfaces or curves into correspondence with a dictionary, which stays as it is.
///
/// Surfaces: the rotation of the parameter sphere and a smooth map of it are searched that bring a surface nearest to the mean in the
/// metric of the dictionary's components. The dictionary is one of surfaces with the topology `sphere`, usually learnt from a cohort
/// of `POST /v1/cohorts/{cohort}/correspond`. Curves: the start, direction and parameters are searched whose directions agree most with
/// those of the mean of the dictionary at equal parameters (an elastic match); contours of any number of points and curves of cohorts with
/// another correspondence are taken. The answered control points can be encoded, scored or classified.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/correspond", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((CorrespondShapesRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One shape per shape, in order", content((CorrespondAnswer = "application/json"), (CorrespondResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn correspond_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let mut received = receive::<CorrespondShapesRequest>(&app, &key, batch).await?;
    received.shapes.other_parameters = true;
    let settings = CorrespondShapesRequest::settings;
    ask_dictionary::<_, _, CorrespondAnswer>(app, received, settings, |app, ready, asked, choices| {
        let found = match choices {
            Choices::Surfaces(options) => correspond::correspond(app, ready, asked, &options)?,
            Choices::Curves(settings) => correspond::correspond_curves(app, ready, asked, settings)?,
        };
        Ok((found.map(|_, found| Ok(CorrespondingOutput::from(found))), ByDictionary::new(ready)))
    })
    .await
}

/// Choices for the kind of shapes of a dictionary.
enum Choices {
    Surfaces(GroupwiseOptions),
    Curves(ElasticSettings),
}

impl CorrespondShapesRequest {
    /// The choices, and the numbers in whose time the work for a shape is done.
    fn settings(self, ready: &Ready, errors: &mut Vec<Fault>) -> Option<(Choices, usize)> {
        let of_curves = ready.setup.space.domain().is_line();
        let fields = [
            ("/degree", self.degree.is_some(), false),
            ("/rounds", self.rounds.is_some(), false),
            ("/stiffness", self.stiffness.is_some(), false),
            ("/elasticity", self.elasticity.is_some(), true),
            ("/points", self.points.is_some(), true),
            ("/effort", self.effort.is_some(), true),
        ];
        let kind = if of_curves { "curves" } else { "surfaces" };
        let misplaced = fields.into_iter().filter(|(_, given, of)| *given && *of != of_curves);
        errors.extend(misplaced.map(|(field, ..)| {
            Fault::new(field, format!("expected no value with a dictionary of {kind}, got one"))
        }));
        if of_curves {
            let Self { elasticity, points, effort, .. } = self;
            let settings = ElasticFields { elasticity, points, rotation: None, effort }.take(errors);
            errors.extend(elastic_faults(&settings));
            let numbers = correspond::elastic_numbers(&settings);
            return Some((Choices::Curves(settings), numbers));
        }
        let options = GroupwiseOptions {
            degree: take_given(self.degree, "/degree", errors).unwrap_or(DEGREE).min(MAX_DEGREE + 1),
            rounds: take_given(self.rounds, "/rounds", errors).unwrap_or(ROUNDS).min(MAX_ROUNDS + 1),
            sizes: true,
            stiffness: take_given(self.stiffness, "/stiffness", errors).unwrap_or(STIFFNESS),
        };
        errors.extend(correspondence::option_faults(&options));
        Some((Choices::Surfaces(options), correspond::numbers(&options)))
    }
}
