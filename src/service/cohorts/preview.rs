//! Previews: the effect of an upload, told without storing anything.
//!
//! Shapes go the way of an upload, by the same steps, to an upload of the store that writes nothing. Where an upload under `abort` ends
//! with its first invalid shapes, a preview goes on, so that all of them are counted, and keeps the refusal of the upload.

use super::fits::MeshFits;
use super::upload::{Stored, UploadResult};
use crate::service::app::ServiceError;
use crate::service::app::faults::Faults;
use crate::service::shapes::outcome::OnError;
use crate::wire::fault::Fault;
use crate::wire::files::Inspection;
use crate::wire::summary::FileSummary;

/// Effect that an upload of a file would have.
#[derive(Debug)]
pub struct Preview {
    /// Its answer, but for ids; the revision is that at which the look began. Under [`OnError::Abort`] invalid shapes and those whose
    /// external id belongs to another one are counted as if they were left out.
    pub stored: Stored,
    /// Summary of the file by its reader.
    pub file: FileSummary,
    /// Shapes of the file under the names with which they would be stored.
    pub found: Inspection,
    /// Number of shapes whose external id belongs to another one.
    pub conflicts: usize,
    /// Faults of the invalid shapes, those that say the same as one.
    pub faults: Faults,
    /// Fits to meshes.
    pub fits: Option<MeshFits>,
    /// Refusal that the upload would get.
    pub refusal: Option<ServiceError>,
}

/// Notes on an upload that is only looked at.
#[derive(Debug)]
pub(super) struct Notes {
    /// Whether the upload would end with its first invalid shapes.
    aborts: bool,
    /// Faults of all shapes.
    pub(super) faults: Faults,
    /// Faults with which it would end, and the position of the first shape that would not be stored before.
    last: Faults,
    end: Option<usize>,
    has_ended: bool,
    /// The shapes of the file.
    pub(super) found: Inspection,
}

impl Notes {
    pub(super) fn new(on_error: OnError) -> Self {
        Self {
            aborts: on_error == OnError::Abort,
            faults: Faults::of_file(),
            last: Faults::of_file(),
            end: None,
            has_ended: false,
            found: Inspection::default(),
        }
    }

    /// Notes the faults of a shape of the group that begins at the position `group`, of which an upload would store none.
    pub(super) fn refuse(&mut self, group: usize, faults: &[Fault]) {
        self.faults.extend(faults.iter().cloned());
        if self.aborts && !self.has_ended {
            self.end.get_or_insert(group);
            self.last.extend(faults.iter().cloned());
        }
    }

    /// Notes that all shapes that arrived together have been read: an upload ends with the faults of these.
    pub(super) fn pass(&mut self) {
        self.has_ended = self.end.is_some();
    }

    /// Refusal of an upload that had `conflicts`. Shapes before its end are compared with those of the cohort first.
    pub(super) fn refusal(&self, conflicts: &[UploadResult]) -> Option<ServiceError> {
        if !self.aborts {
            return None;
        }
        let is_met = |conflict: &&UploadResult| self.end.is_none_or(|end| conflict.index < end);
        let conflict = conflicts.first().filter(is_met).and_then(|conflict| conflict.faults.first());
        match conflict {
            Some(fault) => Some(ServiceError::ExternalIdConflict(Box::new(fault.clone()))),
            None => self.end.map(|_| ServiceError::Invalid(self.last.clone())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conflict(index: usize) -> UploadResult {
        let faults = vec![Fault::new("/external_id", format!("taken at {index}"))];
        UploadResult { index, faults, ..UploadResult::default() }
    }

    #[test]
    fn an_upload_ends_with_what_it_meets_first() {
        let mut notes = Notes::new(OnError::Abort);
        assert!(notes.refusal(&[]).is_none());
        let refused = |notes: &Notes, conflicts: &[UploadResult]| match notes.refusal(conflicts) {
            Some(ServiceError::ExternalIdConflict(fault)) => fault.detail,
            Some(ServiceError::Invalid(faults)) => format!("{} faults", faults.count()),
            other => format!("{other:?}"),
        };
        assert_eq!(refused(&notes, &[conflict(3), conflict(5)]), "taken at 3");
        notes.refuse(100, &[Fault::new("", "bad"), Fault::new("", "bad")]);
        notes.refuse(200, &[Fault::new("", "worse")]);
        notes.pass();
        notes.refuse(300, &[Fault::new("", "later")]);
        assert_eq!(refused(&notes, &[]), "3 faults");
        assert_eq!(refused(&notes, &[conflict(100)]), "3 faults");
        assert_eq!(refused(&notes, &[conflict(99), conflict(100)]), "taken at 99");
        assert_eq!(notes.faults.count(), 4);
    }

    #[test]
    fn nothing_refuses_an_upload_that_leaves_out() {
        let mut notes = Notes::new(OnError::Skip);
        notes.refuse(0, &[Fault::new("", "bad")]);
        notes.pass();
        assert!(notes.refusal(&[conflict(3)]).is_none());
        assert_eq!(notes.faults.count(), 1);
    }
}
