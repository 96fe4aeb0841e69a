//! Holdings of a subject.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::{Caller, Path, Query};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::requests::request_macros::PageQuery;
use crate::service::cohorts::subjects::{self, Held};
use crate::store::{HeldShape, Holding};

/// Holdings of a subject: cohorts, and one page of the shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SubjectAnswer {
    /// Number of shapes that name the subject at some revision.
    #[serde(rename = "shape_count")]
    count: u64,
    /// Cohorts that hold some of them, those in the trash included.
    cohorts: Vec<HoldingCohort>,
    /// Shapes in the order of their ids.
    items: Vec<SubjectShape>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// A cohort that holds shapes of a subject.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct HoldingCohort {
    /// Id of the cohort.
    id: String,
    /// Its name.
    name: String,
    /// Its revision.
    revision: u64,
    /// Number of its shapes that name the subject at some revision.
    #[serde(rename = "shape_count")]
    shapes: u64,
    /// Whether it is in the trash.
    trashed: bool,
}

/// A shape of a subject.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SubjectShape {
    /// Id of the shape.
    id: String,
    /// Identifier assigned by the client.
    external_id: Option<String>,
    /// Id of its cohort.
    cohort: String,
    /// Whether its cohort shows it as the subject's now. Otherwise it was deleted or given to another subject, and only earlier revisions
    /// show it.
    current: bool,
}

impl From<Holding> for HoldingCohort {
    fn from(Holding { id, name, revision, shapes, trashed }: Holding) -> Self {
        Self { id, name, revision, shapes, trashed }
    }
}

impl From<HeldShape> for SubjectShape {
    fn from(HeldShape { id, external_id, cohort, is_current }: HeldShape) -> Self {
        Self { id, external_id, cohort, current: is_current }
    }
}

/// Returns the holdings of a subject: the cohorts of the tenant with shapes that name it, also deleted and corrected ones, and their ids.
///
/// A subject of which nothing is held is not found; neither is one whose shapes are in cohorts that are not open to the caller.
#[utoipa::path(get, path = "/v1/subjects/{subject}", tag = "cohorts",
    params(("subject" = String, Path, description = "The subject, percent-encoded"), PageQuery),
    responses(
        (status = 200, description = "The holdings", body = SubjectAnswer),
        (status = 404, description = "No such subject"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn find_subject(
    Caller(app): Caller,
    Path(subject): Path<String>,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let Held { cohorts, shapes, next } =
        subjects::find(&app, &subject, page.cursor.as_deref(), page.limit()?).await?;
    let answer = SubjectAnswer {
        count: cohorts.iter().map(|cohort| cohort.shapes).sum(),
        cohorts: cohorts.into_iter().map(HoldingCohort::from).collect(),
        items: shapes.into_iter().map(SubjectShape::from).collect(),
        next,
    };
    Ok(json(StatusCode::OK, &answer)?)
}
