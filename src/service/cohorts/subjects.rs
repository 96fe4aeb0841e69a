//! Holdings of a subject: cohorts, with the shapes that name it at some revision.

use crate::service::app::{App, ServiceError};
use crate::store::{HeldShape, Holding};

/// Holdings of a subject.
#[derive(Debug)]
pub struct Held {
    /// Cohorts with their numbers of shapes.
    pub cohorts: Vec<Holding>,
    /// A page of the shapes.
    pub shapes: Vec<HeldShape>,
    /// Cursor of the next page.
    pub next: Option<String>,
}

/// Cohorts and shapes of a subject, the shapes after `cursor` (the id of the last shape of the previous page).
///
/// # Errors
/// [`ServiceError::NotFound`] if nothing is held that the caller may see.
pub async fn find(
    app: &App,
    subject: &str,
    cursor: Option<&str>,
    limit: usize,
) -> Result<Held, ServiceError> {
    let cohorts = app.store.list_holdings(subject).await?;
    if cohorts.is_empty() {
        return Err(not_found());
    }
    for cohort in &cohorts {
        app.touched.note("cohort_id", &cohort.id);
    }
    let mut shapes = app.store.list_held_shapes(subject, cursor, limit + 1).await?;
    let next = (shapes.len() > limit).then(|| shapes[limit - 1].id.clone());
    shapes.truncate(limit);
    Ok(Held { cohorts, shapes, next })
}

/// The refusal of a subject of which nothing is held. It does not repeat the subject, so that neither does a log.
pub(super) fn not_found() -> ServiceError {
    ServiceError::NotFound { kind: "subject", key: "…".into() }
}
