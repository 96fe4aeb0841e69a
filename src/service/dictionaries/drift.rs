//! Drift: differences between shapes added since a dictionary was learnt and its training shapes.

use tokio::runtime::Handle;

use super::ready::Ready;
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::assessment::drift::Drift;
use crate::domain::cohort::Cohort;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::source::StoredShapes;
use crate::store::Revisions;

/// Seed of the training shapes whose means are compared, which is not a parameter: the answer is an expectation.
const HALVED_SEED: u64 = 0;

/// Start of the new shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Since {
    /// The revision from which the dictionary was learnt.
    Training,
    /// Shapes added after this revision of the cohort.
    Revision(u64),
    /// Shapes added after this time, in milliseconds since 1970 UTC.
    Time(i64),
}

/// Drift of a cohort since a dictionary was learnt.
#[derive(Debug, Clone, PartialEq)]
pub struct CohortDrift {
    /// Id of the cohort.
    pub cohort: String,
    /// Shapes added after this revision are new; for a time, the revision before it.
    pub since: u64,
    /// Last revision considered.
    pub until: u64,
    /// Differences of the new shapes.
    pub drift: Drift,
}

/// Compares the training shapes of a dictionary with shapes of its cohort that were added since then and pass its
/// filter. Cost: encoding the new shapes, and computing their mean.
///
/// # Errors
/// A cohort that was deleted; a future revision; degenerate shapes, by name.
pub async fn drift(
    app: &App,
    ready: std::sync::Arc<Ready>,
    since: Since,
    quantile: f64,
) -> Result<CohortDrift, ServiceError> {
    super::coding::check_quantile(quantile).map_err(|_| {
        let detail = format!("expected a number of at least 0.5 and below 1, got {quantile}");
        ServiceError::parameter("quantile", detail)
    })?;
    let provenance = &ready.listed.provenance;
    let cohort = app.store.find_cohort(&provenance.cohort).await?;
    let gone = || ServiceError::NotFound { kind: "cohort", key: provenance.cohort_name.clone() };
    let cohort = cohort.ok_or_else(gone)?;
    app.touched.note("cohort_id", &cohort.id);
    let since = first_revision(app, &ready, &cohort, since).await?;
    let revisions = Revisions { after: since, until: cohort.revision };
    let count = app.store.count(&cohort.id, revisions, &provenance.filter).await?;
    let (id, until) = (cohort.id.clone(), cohort.revision);
    let drift = if count == 0 {
        Drift::default()
    } else {
        let (task_app, handle, task_ready) = (app.clone(), Handle::current(), ready.clone());
        let work = ready.work(usize::try_from(count).unwrap_or(usize::MAX), 0, &app.limits);
        let compared = move || compared(&task_app, &handle, &task_ready, &cohort, since, quantile);
        app.pool.weighing(work).run(compared).await?
    };
    Ok(CohortDrift { cohort: id, since, until, drift })
}

/// Revision after which shapes are new.
async fn first_revision(
    app: &App,
    ready: &Ready,
    cohort: &Cohort,
    since: Since,
) -> Result<u64, ServiceError> {
    match since {
        Since::Training => Ok(ready.listed.provenance.cohort_revision),
        Since::Revision(revision) if revision <= cohort.revision => Ok(revision),
        Since::Revision(revision) => {
            let detail =
                format!("expected at most {}, the revision of the cohort, got {revision}", cohort.revision);
            Err(ServiceError::parameter("since", detail))
        }
        Since::Time(ms) => Ok(app.store.revision_before(&cohort.id, ms).await?),
    }
}

fn compared(
    app: &App,
    handle: &Handle,
    ready: &Ready,
    cohort: &Cohort,
    since: u64,
    quantile: f64,
) -> Result<Drift, ServiceError> {
    let provenance = &ready.listed.provenance;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let source = StoredShapes::new(app, handle, cohort, &provenance.filter, since, &ready.setup, &stop)?;
    // Training shapes, as far as they still exist.
    let training = |most: usize| {
        let cohort = cohort.clone().at(provenance.cohort_revision);
        let shapes = StoredShapes::new(app, handle, &cohort, &provenance.filter, 0, &ready.setup, &stop)?;
        ShapesInMemory::sample(&shapes, HALVED_SEED, most)
    };
    Ok(ready.assessor.drift(&source, &training, quantile, &context)?)
}
