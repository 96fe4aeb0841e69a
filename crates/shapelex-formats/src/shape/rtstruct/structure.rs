//! The data set of a structure set that is written.

use dicom_core::value::DataSetSequence;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};

use super::regions::ContourKind;
use crate::dicom::{SeriesImage, decimal};
use crate::error::{FaultKind, FileError, Place};

/// Class of the study that a structure set refers to (Detached Study Management).
const STUDY_CLASS: &str = "1.2.840.10008.3.1.2.3.1";

/// This software, as an identifier without a register (PS3.5, B.2): the first bits of the BLAKE3 hash of its name.
const IMPLEMENTATION: &str = "shapelex";

/// Largest distance, in mm, of a contour from the plane of the image that it was drawn on.
const ON_IMAGE_MM: f64 = 0.05;

/// A region that is written.
pub(super) struct Region {
    /// The number that the shapes ask for.
    pub(super) number: Option<i64>,
    pub(super) name: String,
    pub(super) kind: Option<String>,
    pub(super) colour: Option<[u8; 3]>,
    pub(super) contours: Vec<Contour>,
    /// Whether contours of no given type are combined by exclusive or: some of them bound holes.
    pub(super) xor: bool,
}

/// A contour that is written.
pub(super) struct Contour {
    pub(super) kind: ContourKind,
    /// Whether the type is that of the file it comes from.
    pub(super) kept: bool,
    /// Three numbers a point, in mm.
    pub(super) coordinates: Vec<f64>,
}

/// Date and time as the standard writes them.
pub(super) struct Moment {
    pub(super) date: String,
    pub(super) time: String,
}

type Set = InMemDicomObject;

fn put(set: &mut Set, tag: Tag, vr: VR, text: &str) {
    set.put(DataElement::new(tag, vr, PrimitiveValue::from(text)));
}

fn put_items(set: &mut Set, tag: Tag, items: Vec<Set>) {
    set.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
}

/// The bytes of the file. Its identifiers follow from its content, so the same shapes make the same file.
pub(super) fn file(
    regions: &[Region],
    series: &[SeriesImage],
    created: Option<&Moment>,
) -> Result<(Vec<u8>, usize), FileError> {
    let mut set = Set::new_empty();
    let first = series.first().cloned().unwrap_or_default();
    put_context(&mut set, &first, created);
    put_items(&mut set, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, vec![frame(&first, series)]);
    let numbers = numbers(regions);
    let mut away = 0;
    let rows = || regions.iter().zip(&numbers);
    let rois = rows().map(|(region, number)| roi(region, *number, &first)).collect();
    put_items(&mut set, tags::STRUCTURE_SET_ROI_SEQUENCE, rois);
    let contours = rows().map(|(region, number)| contours(region, *number, series, &mut away)).collect();
    put_items(&mut set, tags::ROI_CONTOUR_SEQUENCE, contours);
    let observations = rows().map(|(region, number)| observation(region, *number)).collect();
    put_items(&mut set, tags::RTROI_OBSERVATIONS_SEQUENCE, observations);
    let fault = |error: &dyn std::fmt::Display| FileError::of(FaultKind::Io, Place::default(), error);
    let mut content = Vec::new();
    let syntax = dicom_transfer_syntax_registry::entries::IMPLICIT_VR_LITTLE_ENDIAN.erased();
    set.write_dataset_with_ts(&mut content, &syntax).map_err(|error| fault(&error))?;
    let instance = uid("instance", &content);
    put(&mut set, tags::SOP_INSTANCE_UID, VR::UI, &instance);
    put(&mut set, tags::SERIES_INSTANCE_UID, VR::UI, &uid("series", &content));
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(uids::IMPLICIT_VR_LITTLE_ENDIAN)
        .media_storage_sop_class_uid(uids::RT_STRUCTURE_SET_STORAGE)
        .media_storage_sop_instance_uid(instance)
        .implementation_class_uid(uid("implementation", IMPLEMENTATION.as_bytes()))
        .implementation_version_name("SHAPELEX");
    let object = set.with_meta(meta).map_err(|error| fault(&error))?;
    let mut bytes = Vec::with_capacity(content.len());
    object.write_all(&mut bytes).map_err(|error| fault(&error))?;
    Ok((bytes, away))
}

/// An identifier by the hash of a content, as one of the form `2.25.` and a UUID (PS3.5, B.2; RFC 9562, version 8).
fn uid(purpose: &str, content: &[u8]) -> String {
    let mut hasher = blake3::Hasher::new_derive_key("shapelex 2026 identifiers of DICOM");
    hasher.update(purpose.as_bytes()).update(&[0]).update(content);
    let mut bytes = [0; 16];
    hasher.finalize_xof().fill(&mut bytes);
    bytes[6] = bytes[6] & 0x0f | 0x80;
    bytes[8] = bytes[8] & 0x3f | 0x80;
    format!("2.25.{}", u128::from_be_bytes(bytes))
}

/// Patient, study, equipment and the set itself.
fn put_context(set: &mut Set, first: &SeriesImage, created: Option<&Moment>) {
    let (date, time) = created.map_or(("", ""), |moment| (&moment.date, &moment.time));
    let SeriesImage { study, patient, .. } = first;
    let rows = [
        (tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"),
        (tags::SOP_CLASS_UID, VR::UI, uids::RT_STRUCTURE_SET_STORAGE),
        (tags::STUDY_DATE, VR::DA, &study.date),
        (tags::STUDY_TIME, VR::TM, &study.time),
        (tags::ACCESSION_NUMBER, VR::SH, &study.accession_number),
        (tags::MODALITY, VR::CS, "RTSTRUCT"),
        (tags::MANUFACTURER, VR::LO, "Shapelex"),
        (tags::REFERRING_PHYSICIAN_NAME, VR::PN, &study.referring_physician),
        (tags::OPERATORS_NAME, VR::PN, ""),
        (tags::MANUFACTURER_MODEL_NAME, VR::LO, "shapelex-formats"),
        (tags::PATIENT_NAME, VR::PN, &patient.name),
        (tags::PATIENT_ID, VR::LO, &patient.id),
        (tags::PATIENT_BIRTH_DATE, VR::DA, &patient.birth_date),
        (tags::PATIENT_SEX, VR::CS, &patient.sex),
        (tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION")),
        (tags::STUDY_INSTANCE_UID, VR::UI, &study.instance),
        (tags::STUDY_ID, VR::SH, &study.id),
        (tags::SERIES_NUMBER, VR::IS, ""),
        (tags::FRAME_OF_REFERENCE_UID, VR::UI, &first.frame_of_reference),
        (tags::POSITION_REFERENCE_INDICATOR, VR::LO, ""),
        (tags::STRUCTURE_SET_LABEL, VR::SH, "Shapelex"),
        (tags::STRUCTURE_SET_DATE, VR::DA, date),
        (tags::STRUCTURE_SET_TIME, VR::TM, time),
    ];
    for (tag, vr, text) in rows {
        put(set, tag, vr, text);
    }
    if created.is_some() {
        put(set, tags::INSTANCE_CREATION_DATE, VR::DA, date);
        put(set, tags::INSTANCE_CREATION_TIME, VR::TM, time);
    }
}

fn reference(image: &SeriesImage) -> Set {
    let mut set = Set::new_empty();
    put(&mut set, tags::REFERENCED_SOP_CLASS_UID, VR::UI, &image.class);
    put(&mut set, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, &image.instance);
    set
}

/// The frame of reference with the study and all images of the series.
fn frame(first: &SeriesImage, series: &[SeriesImage]) -> Set {
    let mut one = Set::new_empty();
    put(&mut one, tags::SERIES_INSTANCE_UID, VR::UI, &first.series);
    put_items(&mut one, tags::CONTOUR_IMAGE_SEQUENCE, series.iter().map(reference).collect());
    let mut study = Set::new_empty();
    put(&mut study, tags::REFERENCED_SOP_CLASS_UID, VR::UI, STUDY_CLASS);
    put(&mut study, tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, &first.study.instance);
    put_items(&mut study, tags::RT_REFERENCED_SERIES_SEQUENCE, vec![one]);
    let mut frame = Set::new_empty();
    put(&mut frame, tags::FRAME_OF_REFERENCE_UID, VR::UI, &first.frame_of_reference);
    put_items(&mut frame, tags::RT_REFERENCED_STUDY_SEQUENCE, vec![study]);
    frame
}

/// The number that a region asks for, if no region before it has it, else the least that no region asks for.
fn numbers(regions: &[Region]) -> Vec<i64> {
    let mut taken = std::collections::BTreeSet::new();
    let asked: std::collections::BTreeSet<i64> = regions.iter().filter_map(|region| region.number).collect();
    let mut next = 1;
    let mut number = |region: &Region| {
        if let Some(number) = region.number.filter(|number| taken.insert(*number)) {
            return number;
        }
        while asked.contains(&next) || !taken.insert(next) {
            next += 1;
        }
        next
    };
    regions.iter().map(&mut number).collect()
}

fn roi(region: &Region, number: i64, first: &SeriesImage) -> Set {
    let mut set = Set::new_empty();
    put(&mut set, tags::ROI_NUMBER, VR::IS, &number.to_string());
    put(&mut set, tags::REFERENCED_FRAME_OF_REFERENCE_UID, VR::UI, &first.frame_of_reference);
    put(&mut set, tags::ROI_NAME, VR::LO, &region.name);
    put(&mut set, tags::ROI_GENERATION_ALGORITHM, VR::CS, "");
    set
}

fn observation(region: &Region, number: i64) -> Set {
    let mut set = Set::new_empty();
    put(&mut set, tags::OBSERVATION_NUMBER, VR::IS, &number.to_string());
    put(&mut set, tags::REFERENCED_ROI_NUMBER, VR::IS, &number.to_string());
    put(&mut set, tags::RTROI_INTERPRETED_TYPE, VR::CS, region.kind.as_deref().unwrap_or(""));
    put(&mut set, tags::ROI_INTERPRETER, VR::PN, "");
    set
}

/// The contours of a region; counts those on no image of the series.
fn contours(region: &Region, number: i64, series: &[SeriesImage], away: &mut usize) -> Set {
    let mut items = Vec::with_capacity(region.contours.len());
    for (k, contour) in region.contours.iter().enumerate() {
        let mut set = Set::new_empty();
        match series.iter().find(|image| is_on(image, &contour.coordinates)) {
            Some(image) => put_items(&mut set, tags::CONTOUR_IMAGE_SEQUENCE, vec![reference(image)]),
            None => *away += 1,
        }
        let xor = region.xor && !contour.kept && contour.kind == ContourKind::ClosedPlanar;
        let kind = if xor { ContourKind::ClosedPlanarXor } else { contour.kind };
        put(&mut set, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, kind.word());
        put(&mut set, tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, &(contour.coordinates.len() / 3).to_string());
        put(&mut set, tags::CONTOUR_NUMBER, VR::IS, &(k + 1).to_string());
        let numbers: Vec<String> = contour.coordinates.iter().copied().map(decimal).collect();
        set.put(DataElement::new(tags::CONTOUR_DATA, VR::DS, PrimitiveValue::Strs(numbers.into())));
        items.push(set);
    }
    let mut set = Set::new_empty();
    if let Some(colour) = region.colour {
        let numbers: Vec<String> = colour.iter().map(u8::to_string).collect();
        set.put(DataElement::new(tags::ROI_DISPLAY_COLOR, VR::IS, PrimitiveValue::Strs(numbers.into())));
    }
    put_items(&mut set, tags::CONTOUR_SEQUENCE, items);
    put(&mut set, tags::REFERENCED_ROI_NUMBER, VR::IS, &number.to_string());
    set
}

/// Whether all points are in the plane of an image.
fn is_on(image: &SeriesImage, coordinates: &[f64]) -> bool {
    let normal = image.normal();
    coordinates.chunks_exact(3).all(|row| {
        let height: f64 = (0..3).map(|k| normal[k] * (row[k] - image.position[k])).sum();
        height.abs() <= ON_IMAGE_MM
    })
}
