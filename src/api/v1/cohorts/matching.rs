//! Which correspondence of a cohort lies nearer.

use axum::http::StatusCode;
use axum::response::Response;

use crate::analysis::alignment::Alignment;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Caller, JsonBody, NoQuery, Path};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::service::app::ServiceError;
#[cfg(feature = "schema")]
use crate::service::cohorts::matching::MatchingAnswer;
use crate::service::cohorts::matching::{self, MatchingRequest, USUAL_SAMPLE};
use crate::wire::checked::{Checked, document, take_given, take_or_default};

document! {
    /// How the correspondences of a cohort are tried.
    #[schema(example = json!({"transformation": "similarity", "sample": 50}))]
    pub(in crate::api::v1) struct MatchRequest {
        /// Transformation class removed before shapes are compared. Default: `similarity`.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method. Default: that of means.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Number of shapes that are looked at, 3 to 500. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 3, maximum = 500)]
        sample: Checked<usize>;
        /// Seed of the choice of shapes, and of random starts. Default: 0.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
    }
}

/// Tells which of `landmarks`, `arc_length` and `cyclic` lies nearer, and its cost.
///
/// Some shapes of the cohort, which the seed chooses by their ids, are aligned under each correspondence that applies to them. Contours
/// are tried from the points at which they were given to begin, also where the cohort has moved them, and from random ones: searched starts
/// always lie nearer, and `explained` tells the worth of the given ones. Nothing is changed:
/// `PATCH /v1/cohorts/{cohort}` sets another correspondence.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/matching", tag = "cohorts", request_body = MatchRequest,
    params(("cohort" = String, Path, description = "Id or name")),
    responses(
        (status = 200, description = "Each correspondence that applies", body = MatchingAnswer),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn match_cohort(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let request: MatchRequest = app.parse(&body)?;
    let found = matching::compare(&app, &key, request.checked()?).await?;
    Ok(json(StatusCode::OK, &found)?)
}

impl MatchRequest {
    fn checked(self) -> Result<MatchingRequest, ServiceError> {
        let mut errors = self.faults;
        let similarity = Transformation::Named(ClassName::Similarity);
        let transformation =
            take_given(self.transformation, "/transformation", &mut errors).unwrap_or(similarity);
        let alignment = take_given(self.alignment, "/alignment", &mut errors);
        let filter = take_filter(self.filter, "/filter", &mut errors).unwrap_or_default();
        let sample = take_given(self.sample, "/sample", &mut errors).unwrap_or(USUAL_SAMPLE);
        let seed = take_or_default(self.seed, "/seed", &mut errors).unwrap_or_default();
        ServiceError::unless_empty(errors)?;
        Ok(MatchingRequest { transformation, alignment, filter, sample, seed })
    }
}
