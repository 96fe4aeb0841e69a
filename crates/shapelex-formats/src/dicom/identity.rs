//! Which elements tell of a person, a place or a date.

use std::collections::BTreeSet;

use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags};

use super::data_set::{DataSet, Element, Value};
use super::values::{File, shown};
use crate::error::Place;
use crate::summary::Summary;

/// Group of elements that concern the patient.
const PATIENT: u16 = 0x0010;

/// Elements that identify by themselves, beside those of the patient, names of persons, dates, times and unique identifiers. From
/// the basic profile of confidentiality, PS3.15, table E.1-1.
const TEXTS: [Tag; 27] = [
    tags::ACCESSION_NUMBER,
    tags::INSTITUTION_NAME,
    tags::INSTITUTION_ADDRESS,
    tags::INSTITUTIONAL_DEPARTMENT_NAME,
    tags::STATION_NAME,
    tags::STUDY_DESCRIPTION,
    tags::SERIES_DESCRIPTION,
    tags::ADMITTING_DIAGNOSES_DESCRIPTION,
    tags::REFERRING_PHYSICIAN_ADDRESS,
    tags::REFERRING_PHYSICIAN_TELEPHONE_NUMBERS,
    tags::STUDY_ID,
    tags::DEVICE_SERIAL_NUMBER,
    tags::PROTOCOL_NAME,
    tags::IMAGE_COMMENTS,
    tags::STRUCTURE_SET_LABEL,
    tags::STRUCTURE_SET_NAME,
    tags::STRUCTURE_SET_DESCRIPTION,
    tags::ROI_DESCRIPTION,
    tags::ROI_GENERATION_DESCRIPTION,
    tags::APPROVAL_STATUS,
    tags::CONTRIBUTION_DESCRIPTION,
    // ROI Observation Label and Description, retired.
    Tag(0x3006, 0x0085),
    Tag(0x3006, 0x0088),
    // Not in the table, and yet typed by people.
    tags::SEGMENT_DESCRIPTION,
    tags::TRACKING_ID,
    tags::CONTENT_LABEL,
    tags::CONTENT_DESCRIPTION,
];

/// Unique identifiers of things that many files share, or that relate coordinates, and those by which shapes are found again.
const COMMON: [Tag; 10] = [
    tags::SOP_INSTANCE_UID,
    tags::SERIES_INSTANCE_UID,
    tags::STUDY_INSTANCE_UID,
    tags::REFERENCED_SOP_INSTANCE_UID,
    tags::SOP_CLASS_UID,
    tags::REFERENCED_SOP_CLASS_UID,
    tags::FRAME_OF_REFERENCE_UID,
    tags::REFERENCED_FRAME_OF_REFERENCE_UID,
    tags::CODING_SCHEME_UID,
    tags::CONTEXT_UID,
];

/// Lists the names of all elements that identify, and the tags of private ones; none of their values.
pub(crate) fn list_identifying(file: &File<'_>, summary: &mut Summary) {
    let mut names = BTreeSet::new();
    list(file.set(), &mut names, summary);
}

/// The depth of sequences is bounded by that of the file.
fn list(set: &DataSet<'_>, names: &mut BTreeSet<Tag>, summary: &mut Summary) {
    for element in set.elements() {
        let tag = element.tag;
        let what = match tag.group() % 2 {
            1 => "private elements",
            _ if identifies(element) => "identifying elements",
            _ => "",
        };
        if !what.is_empty() {
            let name = names.insert(tag).then(|| name(tag));
            summary
                .drop(what, name.as_deref(), || Place { byte: Some(element.at), ..Place::tag(shown(tag)) });
        } else if let Value::Items(items) = &element.value {
            items.iter().for_each(|item| list(item, names, summary));
        }
    }
}

fn identifies(element: &Element<'_>) -> bool {
    let filled = match &element.value {
        Value::Bytes(bytes) => bytes.iter().any(|byte| !matches!(byte, b' ' | b'\0')),
        Value::Items(_) | Value::Fragments(_) => false,
    };
    let kind = match element.vr {
        VR::PN | VR::DA | VR::TM | VR::DT => true,
        VR::UI => !COMMON.contains(&element.tag),
        _ => element.tag.group() == PATIENT || TEXTS.contains(&element.tag),
    };
    filled && kind
}

fn name(tag: Tag) -> String {
    let entry = StandardDataDictionary.by_tag(tag).filter(|_| tag.group().is_multiple_of(2));
    entry.map_or_else(|| shown(tag), |entry| entry.alias().to_owned())
}
