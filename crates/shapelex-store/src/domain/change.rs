//! Change feed: an entry for every change of a tenant's objects, so that a pipeline can resume where it stopped.

use serde::{Deserialize, Serialize};

/// Kind of change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// A cohort was created.
    CohortCreated,
    /// The name, description or unit of a cohort was changed.
    CohortUpdated,
    /// A cohort was moved to the trash.
    CohortDeleted,
    /// A cohort was restored from the trash.
    CohortRestored,
    /// Shapes were added; `revision` is the resulting revision.
    ShapesAdded,
    /// Attributes of a shape were changed.
    ShapeUpdated,
    /// Attributes of several shapes were changed by one request; the object is the cohort.
    ShapesUpdated,
    /// A shape was deleted.
    ShapeDeleted,
    /// Shapes that pass a filter were deleted; the object is the cohort.
    ShapesDeleted,
    /// Shapes of a subject were erased, in all revisions; the object is the cohort, `shape_ids` names them.
    SubjectErased,
    /// A version of a dictionary was learnt or imported.
    DictionaryAdded,
    /// A version of a dictionary was moved to the trash.
    DictionaryDeleted,
    /// A version of a dictionary was restored from the trash.
    DictionaryRestored,
    /// An alias of a dictionary was created or moved; the object is the version that it names now.
    DictionaryAliasMoved,
    /// An alias of a dictionary was removed; the object is the version that it named.
    DictionaryAliasRemoved,
    /// A job was submitted; `object` is its id.
    JobQueued,
    /// A job succeeded.
    JobSucceeded,
    /// A job failed.
    JobFailed,
    /// A job was cancelled.
    JobCancelled,
}

impl ChangeKind {
    /// All kinds.
    pub const ALL: [Self; 19] = [
        Self::CohortCreated,
        Self::CohortUpdated,
        Self::CohortDeleted,
        Self::CohortRestored,
        Self::ShapesAdded,
        Self::ShapeUpdated,
        Self::ShapesUpdated,
        Self::ShapeDeleted,
        Self::ShapesDeleted,
        Self::SubjectErased,
        Self::DictionaryAdded,
        Self::DictionaryDeleted,
        Self::DictionaryRestored,
        Self::DictionaryAliasMoved,
        Self::DictionaryAliasRemoved,
        Self::JobQueued,
        Self::JobSucceeded,
        Self::JobFailed,
        Self::JobCancelled,
    ];

    /// Name used in JSON and the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::CohortCreated => "cohort_created",
            Self::CohortUpdated => "cohort_updated",
            Self::CohortDeleted => "cohort_deleted",
            Self::CohortRestored => "cohort_restored",
            Self::ShapesAdded => "shapes_added",
            Self::ShapeUpdated => "shape_updated",
            Self::ShapesUpdated => "shapes_updated",
            Self::ShapeDeleted => "shape_deleted",
            Self::ShapesDeleted => "shapes_deleted",
            Self::SubjectErased => "subject_erased",
            Self::DictionaryAdded => "dictionary_added",
            Self::DictionaryDeleted => "dictionary_deleted",
            Self::DictionaryRestored => "dictionary_restored",
            Self::DictionaryAliasMoved => "dictionary_alias_moved",
            Self::DictionaryAliasRemoved => "dictionary_alias_removed",
            Self::JobQueued => "job_queued",
            Self::JobSucceeded => "job_succeeded",
            Self::JobFailed => "job_failed",
            Self::JobCancelled => "job_cancelled",
        }
    }

    /// Kind with this name.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == word)
    }
}

/// Conditions on changes; all must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChangeFilter {
    /// Changes of these kinds; `None` for all kinds.
    pub kinds: Option<Vec<ChangeKind>>,
    /// Changes of the cohort with this id, of its shapes, dictionaries and jobs.
    pub cohort: Option<String>,
}

impl ChangeFilter {
    /// Whether the change meets the conditions.
    pub fn admits(&self, change: &Change) -> bool {
        self.kinds.as_ref().is_none_or(|kinds| kinds.contains(&change.kind))
            && self.cohort.as_ref().is_none_or(|cohort| change.cohort.as_ref() == Some(cohort))
    }
}

/// A change to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewChange<'a> {
    /// Kind of change.
    pub kind: ChangeKind,
    /// Id of the changed object.
    pub object: &'a str,
    /// Id of the cohort it belongs to.
    pub cohort: Option<&'a str>,
    /// Revision of the cohort after the change.
    pub revision: Option<u64>,
    /// Number of shapes added, changed, deleted or erased.
    pub shapes: Option<u64>,
    /// Ids of the shapes that were erased.
    pub shape_ids: Option<&'a [&'a str]>,
}

/// Maximum number of shapes that a change names: a page of changes stays below ten megabytes.
pub const MAX_NAMED: usize = 200;

impl<'a> NewChange<'a> {
    /// A change of a cohort itself.
    pub fn for_cohort(kind: ChangeKind, cohort: &'a str, revision: u64) -> Self {
        Self {
            kind,
            object: cohort,
            cohort: Some(cohort),
            revision: Some(revision),
            shapes: None,
            shape_ids: None,
        }
    }

    /// A change of a shape of the cohort.
    pub fn for_shape(kind: ChangeKind, shape: &'a str, cohort: &'a str, revision: u64) -> Self {
        Self {
            kind,
            object: shape,
            cohort: Some(cohort),
            revision: Some(revision),
            shapes: None,
            shape_ids: None,
        }
    }

    /// A change of the state of a job on the cohort.
    pub fn for_job(kind: ChangeKind, job: &'a str, cohort: Option<&'a str>) -> Self {
        Self { kind, object: job, cohort, revision: None, shapes: None, shape_ids: None }
    }

    /// A change of a dictionary that was learnt from the cohort.
    pub fn for_dictionary(kind: ChangeKind, dictionary: &'a str, cohort: &'a str) -> Self {
        Self { kind, object: dictionary, cohort: Some(cohort), revision: None, shapes: None, shape_ids: None }
    }
}

/// A recorded change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// Number of the change, from 1; changes of a tenant are numbered in order.
    pub sequence: u64,
    /// Time of the change, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// Kind of change.
    pub kind: ChangeKind,
    /// Id of the changed object.
    pub object: String,
    /// Id of the cohort it belongs to.
    pub cohort: Option<String>,
    /// Revision of the cohort after the change.
    pub revision: Option<u64>,
    /// Number of shapes added, changed, deleted or erased.
    pub shapes: Option<u64>,
    /// Ids of the shapes that were erased.
    pub shape_ids: Option<Vec<String>>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_the_names_of_their_documents() {
        for kind in ChangeKind::ALL {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
            assert_eq!(ChangeKind::from_word(kind.as_str()), Some(kind));
        }
        assert_eq!(ChangeKind::from_word("job_progress"), None);
    }

    #[test]
    fn a_filter_admits_what_meets_all_conditions() {
        let change = Change {
            sequence: 1,
            at_ms: 0,
            kind: ChangeKind::ShapesAdded,
            object: "coh_1".into(),
            cohort: Some("coh_1".into()),
            revision: Some(1),
            shapes: Some(2),
            shape_ids: None,
        };
        let of = |kind, cohort: &str| ChangeFilter { kinds: Some(vec![kind]), cohort: Some(cohort.into()) };
        assert!(ChangeFilter::default().admits(&change));
        assert!(of(ChangeKind::ShapesAdded, "coh_1").admits(&change));
        assert!(!of(ChangeKind::ShapesAdded, "coh_2").admits(&change));
        assert!(!of(ChangeKind::JobQueued, "coh_1").admits(&change));
    }
}
