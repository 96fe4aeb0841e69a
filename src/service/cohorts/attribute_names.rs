//! Names of the further attributes of a cohort, of which there are at most [`MAX_NAMES`]: each is a column of its tables.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::domain::cohort::Cohort;
use crate::domain::shape::MAX_NAMES;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::store::{NewNames, Revisions};

/// Names that are read of a cohort to which an earlier version let more than [`MAX_NAMES`]: shapes that bring others are refused.
const MOST_READ: usize = 16 * MAX_NAMES;

/// Names of the further attributes of a cohort.
#[derive(Debug, Clone)]
struct CohortNames {
    /// Revision up to which they are known.
    revision: u64,
    /// Revision at which all were counted. Names of shapes that were deleted or changed since may be among them.
    counted: u64,
    names: Arc<BTreeSet<String>>,
}

impl Cached for CohortNames {
    const NAME: &'static str = "attribute names";

    fn bytes(&self) -> usize {
        self.names.iter().map(|name| name.len() + 2 * size_of::<String>()).sum()
    }
}

impl CohortNames {
    /// Changes by shapes that bring these names.
    fn with(&self, brought: BTreeSet<String>) -> NewNames {
        NewNames { known: Arc::clone(&self.names), until: self.revision, brought }
    }
}

/// Refuses more names than a cohort may have. Cost: a pass over the attributes of the shapes of the cohort that are new since the last
/// call, and one over those of all shapes before a refusal.
///
/// # Errors
/// A fault at `pointer`; a failure of the store.
pub(super) async fn admit(
    app: &App,
    cohort: &Cohort,
    brought: BTreeSet<String>,
    pointer: &str,
) -> Result<Option<NewNames>, ServiceError> {
    if brought.is_empty() {
        return Ok(None);
    }
    check(brought.len(), pointer)?;
    let known = up_to_date(app, cohort).await?;
    let names = known.with(brought);
    let fits = |names: &NewNames| names.count().is_none_or(|found| found <= MAX_NAMES);
    if fits(&names) {
        return Ok(Some(names));
    }
    // Names may have gone with their shapes.
    let names =
        if known.counted < known.revision { counted(app, cohort).await?.with(names.brought) } else { names };
    check(names.count().unwrap_or(0), pointer)?;
    Ok(Some(names))
}

/// Refuses so many names.
pub(super) fn check(found: usize, pointer: &str) -> Result<(), ServiceError> {
    if found <= MAX_NAMES {
        return Ok(());
    }
    let detail = format!(
        "expected at most {MAX_NAMES} different names of attributes in a cohort, got {found}: what differs from shape to shape \
         is the value of an attribute, not its name, or belongs to the metadata"
    );
    Err(ServiceError::invalid(pointer, detail))
}

/// The names at the revision of the cohort.
async fn up_to_date(app: &App, cohort: &Cohort) -> Result<Arc<CohortNames>, ServiceError> {
    match app.cache.find::<CohortNames>(&cohort.id, &()) {
        None => counted(app, cohort).await,
        Some(known) if known.revision >= cohort.revision => Ok(known),
        Some(known) => {
            let since = Revisions { after: known.revision, until: cohort.revision };
            let later = app.store.further_names(&cohort.id, since, MOST_READ).await?;
            let names = match later.is_subset(&known.names) {
                true => Arc::clone(&known.names),
                false => Arc::new(known.names.union(&later).cloned().collect()),
            };
            Ok(kept(app, cohort, CohortNames { revision: cohort.revision, names, ..*known }))
        }
    }
}

/// The names of all shapes.
async fn counted(app: &App, cohort: &Cohort) -> Result<Arc<CohortNames>, ServiceError> {
    let revision = cohort.revision;
    let names = app.store.further_names(&cohort.id, Revisions::until(revision), MOST_READ).await?;
    Ok(kept(app, cohort, CohortNames { revision, counted: revision, names: Arc::new(names) }))
}

fn kept(app: &App, cohort: &Cohort, names: CohortNames) -> Arc<CohortNames> {
    let names = Arc::new(names);
    app.cache.keep(&cohort.id, &(), &names);
    names
}
