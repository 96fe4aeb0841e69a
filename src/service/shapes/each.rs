//! Work on every entry of a list in parallel, until the request is cancelled.

use super::outcome::Outcomes;
use crate::service::app::progress::JobContext;
use crate::service::app::{ServiceError, parallel};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Applies `work` to every item in parallel, until the request is cancelled.
pub(crate) fn each<I: Sync, T: Send>(
    context: &JobContext,
    items: &[I],
    work: impl Fn(&I) -> T + Sync,
) -> Result<Vec<T>, ServiceError> {
    let results = parallel::map_ref(items, |_, item| context.check().map(|()| work(item)));
    results.into_iter().collect()
}

/// Applies `work` to every shape in parallel; collects all faults at `/shapes/{index}…`.
pub(crate) fn each_shape<T: Send>(
    context: &JobContext,
    shapes: Vec<ShapeInput>,
    work: impl Fn(usize, ShapeInput) -> Result<T, Vec<Fault>> + Sync,
) -> Result<Vec<T>, ServiceError> {
    each_of(context, "shapes", shapes, work)?.all()
}

/// Applies `work` to every entry of a list in parallel, until the request is cancelled; faults are placed at
/// `/{list}/{index}…`.
pub(crate) fn each_of<I: Send, T: Send>(
    context: &JobContext,
    list: &str,
    items: Vec<I>,
    work: impl Fn(usize, I) -> Result<T, Vec<Fault>> + Sync,
) -> Result<Outcomes<T>, ServiceError> {
    // Skipped entries have no faults: the request then ends as cancelled.
    let unless_cancelled =
        |index, item| if context.is_cancelled() { Err(Vec::new()) } else { work(index, item) };
    let results = parallel::map(items, unless_cancelled);
    context.check()?;
    Ok(Outcomes::of_list(list, results))
}
