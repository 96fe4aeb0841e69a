//! Directions of stored curves that earlier versions did not find.

use std::sync::Arc;

use crate::domain::cohort::Cohort;
use crate::geometry::size::runs_clockwise;
use crate::service::app::cache::Cached;
use crate::service::app::parallel;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::directions::have_direction;

/// A cohort whose curves all have a known direction.
struct Directed;

impl Cached for Directed {
    const NAME: &'static str = "directions";

    fn bytes(&self) -> usize {
        64
    }
}

/// Finds the directions of curves that were stored by a version that did not. Once for a cohort, as long as the cache remembers it.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn complete(app: &App, cohort: &Cohort) -> Result<(), ServiceError> {
    let representation = &cohort.spec.representation;
    if !have_direction(representation) || app.cache.has::<Directed>(&cohort.id, &()) {
        return Ok(());
    }
    let mut after = None;
    loop {
        let shapes = app.store.undirected(&cohort.id, after).await?;
        let Some(last) = shapes.last() else { break };
        after = Some(last.place);
        let space = app.space_of(representation)?;
        let counts = Counts::for_stored(representation, shapes.len(), &app.limits);
        let pool = app.pool.weighing(requests::measure_stored(representation, counts, &app.limits));
        let directed = pool.run(move || {
            Ok(parallel::map_ref(&shapes, |_, shape| {
                (shape.place, runs_clockwise(&space, &shape.control_points) == Some(true))
            }))
        });
        app.store.keep_directions(&directed.await?).await?;
    }
    app.cache.keep(&cohort.id, &(), &Arc::new(Directed));
    Ok(())
}
