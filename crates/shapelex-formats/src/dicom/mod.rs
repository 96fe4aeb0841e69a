//! Common parts of files of DICOM: their data sets, and the elements that tell of a person.
//!
//! Containers are read by `dicom-parser`, one header after the other; values stay where they are in the file until they are asked
//! for. So a length is compared with the bytes that are left before anything is read, and nested sequences cost no stack.
//!
//! * [`series()`] reads the facts that a structure set needs of an image that it refers to.

mod content;
mod data_set;
mod extended;
mod identity;
mod number;
mod origin;
pub(crate) mod run_lengths;
mod series;
mod values;

pub(crate) use content::{Content, is_dicom};
pub(crate) use identity::list_identifying;
pub(crate) use number::decimal;
pub use origin::Origin;
pub(crate) use origin::image_of;
pub(crate) use series::check_orientation;
pub use series::series;
pub(crate) use values::{File, Node};

use dicom_core::dictionary::UidDictionary;
use dicom_dictionary_std::{StandardSopClassDictionary, tags};

use crate::error::{FileError, Place};
pub use crate::series::{Patient, SeriesImage, Study};
use crate::summary::Summary;

/// Identity of an instance of DICOM, and of its patient.
#[derive(Clone, PartialEq)]
pub struct Instance {
    /// SOP Instance UID (0008,0018).
    pub uid: Option<String>,
    /// Issuer of Patient ID (0010,0021) and Patient ID (0010,0020) with the separator of units between them; `None` without an ID.
    /// It identifies a person: only a keyed digest of it may be kept.
    pub person: Option<String>,
    /// Attributes of its shapes.
    pub origin: Origin,
    /// Identifying elements, which are left out.
    pub left_out: Summary,
}

/// Says nothing of the person.
impl std::fmt::Debug for Instance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Instance").field("uid", &self.uid).finish_non_exhaustive()
    }
}

impl Instance {
    pub(crate) fn of(root: &Node<'_>) -> Result<Self, FileError> {
        let issuer = root.short_text(tags::ISSUER_OF_PATIENT_ID)?.unwrap_or_default();
        let id = root.short_text(tags::PATIENT_ID)?.filter(|id| !id.is_empty());
        let person = id.map(|id| format!("{issuer}\u{1f}{id}"));
        let (uid, origin) = (root.short_text(tags::SOP_INSTANCE_UID)?, Origin::of(root)?);
        Ok(Self { uid, person, origin, left_out: Summary::default() })
    }

    /// That of a whole file, of which at most `held` bytes are unpacked.
    ///
    /// # Errors
    /// Faults of the file.
    pub fn read(bytes: &[u8], held: u64) -> Result<Self, FileError> {
        /// Deepest nesting of sequences.
        const DEPTH: usize = 64;
        let content = Content::new(bytes, held, |_| Ok(()))?;
        let file = content.parse(DEPTH)?;
        let mut instance = Self::of(&file.root())?;
        list_identifying(&file, &mut instance.left_out);
        Ok(instance)
    }
}

/// Refuses a file of another class than those given, and names its class.
pub(crate) fn check_class(root: &Node<'_>, classes: &[&str], name: &str) -> Result<(), FileError> {
    let found = root.text(tags::SOP_CLASS_UID)?;
    if found.as_deref().is_some_and(|found| classes.contains(&found)) {
        return Ok(());
    }
    let modality = root.text(tags::MODALITY)?.unwrap_or_else(|| "none".into());
    let known =
        found.as_deref().and_then(|uid| StandardSopClassDictionary.by_uid(uid)).map(|entry| entry.name);
    let found = known.or(found.as_deref()).unwrap_or("a data set without a class");
    let detail = format!("expected {name}, got {found} (modality {modality})");
    Err(FileError::unsupported(Place::tag(values::shown(tags::SOP_CLASS_UID)), detail))
}
