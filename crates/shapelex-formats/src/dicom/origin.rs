//! Where the shapes of an instance come from: attributes by which a hospital finds the scan, the study and the segment again.
//!
//! Only unique identifiers, codes and numbers: they lead back to the archive, and tell a reader without access to it nothing about the person.

use std::collections::BTreeMap;

use dicom_dictionary_std::{tags, uids};

use super::values::Node;
use crate::error::FileError;
use crate::value::Value;

/// Attributes of shapes by their names.
type Labels = BTreeMap<String, Value>;

/// Attributes of the shapes of an instance.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Origin {
    /// Attributes that all shapes share.
    common: Labels,
    /// Further attributes of a region or segment, by its number.
    parts: BTreeMap<i64, Labels>,
    /// Series of the images that the file refers to, by the instances of these.
    series: BTreeMap<String, String>,
}

/// Number of classes that are told apart: more than any modality has.
const MOST_CLASSES: usize = 16;

/// Images that an instance refers to.
#[derive(Default)]
struct Images {
    classes: Vec<String>,
    series: BTreeMap<String, String>,
}

impl Origin {
    pub(crate) fn of(root: &Node<'_>) -> Result<Self, FileError> {
        let mut origin = Self::default();
        for (name, tag) in [
            ("sop_instance", tags::SOP_INSTANCE_UID),
            ("series", tags::SERIES_INSTANCE_UID),
            ("study", tags::STUDY_INSTANCE_UID),
            ("frame_of_reference", tags::FRAME_OF_REFERENCE_UID),
            ("body_part", tags::BODY_PART_EXAMINED),
        ] {
            put(&mut origin.common, name, root.short_text(tag)?);
        }
        let images = Images::of(root)?;
        put(&mut origin.common, "modality", images.modality().map(str::to_owned));
        let mut series = images.series.values();
        let first = series.next();
        put(
            &mut origin.common,
            "image_series",
            first.filter(|one| series.all(|other| other == *one)).cloned(),
        );
        origin.series = images.series;
        for segment in root.items(tags::SEGMENT_SEQUENCE)? {
            let number = segment.integer(tags::SEGMENT_NUMBER)?;
            origin.describe(number, code(&segment, tags::SEGMENTED_PROPERTY_TYPE_CODE_SEQUENCE)?);
        }
        for region in root.items(tags::RTROI_OBSERVATIONS_SEQUENCE)? {
            let number = region.integer(tags::REFERENCED_ROI_NUMBER)?;
            origin.describe(number, code(&region, tags::RTROI_IDENTIFICATION_CODE_SEQUENCE)?);
        }
        Ok(origin)
    }

    fn describe(&mut self, number: Option<i64>, code: Option<String>) {
        if let (Some(number), Some(code)) = (number, code) {
            put(self.parts.entry(number).or_default(), "property", Some(code));
        }
    }

    /// Attributes of all shapes of the instance.
    pub fn common(&self) -> &BTreeMap<String, Value> {
        &self.common
    }

    /// Says in its attributes where a shape comes from: the region or segment with a number, its contour, and the image that this was drawn on.
    pub fn tell(&self, labels: &mut Labels, number: i64, contour: Option<usize>, image: Option<&str>) {
        let part = self.parts.get(&number).into_iter().flatten();
        let known = self.common.iter().chain(part).map(|(name, value)| (name.clone(), value.clone()));
        labels.extend(known);
        labels.insert("region_number".into(), Value::whole(number.into()));
        if let Some(contour) = contour {
            labels.insert("contour_number".into(), Value::whole(contour as i128));
        }
        if let Some(image) = image {
            labels.insert("image".into(), image.into());
            put(labels, "image_series", self.series.get(image).cloned());
        }
    }
}

impl Images {
    /// Images of a structure set, listed by frames of reference, and of a segmentation, listed by series.
    fn of(root: &Node<'_>) -> Result<Self, FileError> {
        let mut images = Self::default();
        for frame in root.items(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE)? {
            for study in frame.items(tags::RT_REFERENCED_STUDY_SEQUENCE)? {
                for series in study.items(tags::RT_REFERENCED_SERIES_SEQUENCE)? {
                    images.add(&series, tags::CONTOUR_IMAGE_SEQUENCE)?;
                }
            }
        }
        for series in root.items(tags::REFERENCED_SERIES_SEQUENCE)? {
            images.add(&series, tags::REFERENCED_INSTANCE_SEQUENCE)?;
        }
        Ok(images)
    }

    fn add(&mut self, series: &Node<'_>, tag: dicom_core::Tag) -> Result<(), FileError> {
        let Some(uid) = series.short_text(tags::SERIES_INSTANCE_UID)? else { return Ok(()) };
        for image in series.items(tag)? {
            if let Some(class) = image.short_text(tags::REFERENCED_SOP_CLASS_UID)?
                && self.classes.len() < MOST_CLASSES
                && !self.classes.contains(&class)
            {
                self.classes.push(class);
            }
            if let Some(instance) = image.short_text(tags::REFERENCED_SOP_INSTANCE_UID)? {
                self.series.insert(instance, uid.clone());
            }
        }
        Ok(())
    }

    /// The modality of all images, by their classes; `None` where they have several, or an unknown one.
    fn modality(&self) -> Option<&'static str> {
        let mut modalities = self.classes.iter().map(|class| modality(class));
        let first = modalities.next()??;
        modalities.all(|other| other == Some(first)).then_some(first)
    }
}

/// The modality that makes images of a class.
fn modality(class: &str) -> Option<&'static str> {
    match class {
        uids::CT_IMAGE_STORAGE | uids::ENHANCED_CT_IMAGE_STORAGE => Some("CT"),
        uids::MR_IMAGE_STORAGE | uids::ENHANCED_MR_IMAGE_STORAGE => Some("MR"),
        uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE | uids::ENHANCED_PET_IMAGE_STORAGE => Some("PT"),
        uids::NUCLEAR_MEDICINE_IMAGE_STORAGE => Some("NM"),
        uids::ULTRASOUND_IMAGE_STORAGE
        | uids::ULTRASOUND_MULTI_FRAME_IMAGE_STORAGE
        | uids::ENHANCED_US_VOLUME_STORAGE => Some("US"),
        _ => None,
    }
}

/// The first image that a contour was drawn on, if it names one.
pub(crate) fn image_of(contour: &Node<'_>) -> Result<Option<String>, FileError> {
    match &contour.items(tags::CONTOUR_IMAGE_SEQUENCE)?[..] {
        [image] => image.short_text(tags::REFERENCED_SOP_INSTANCE_UID),
        _ => Ok(None),
    }
}

/// Scheme and value of the first code of a sequence, `SCT:80891009`.
fn code(node: &Node<'_>, tag: dicom_core::Tag) -> Result<Option<String>, FileError> {
    let Some(code) = node.item(tag)? else { return Ok(None) };
    let scheme = code.short_text(tags::CODING_SCHEME_DESIGNATOR)?;
    let value = code.short_text(tags::CODE_VALUE)?;
    Ok(scheme.zip(value).map(|(scheme, value)| format!("{scheme}:{value}")))
}

fn put(labels: &mut Labels, name: &str, value: Option<String>) {
    if let Some(value) = value {
        labels.insert(name.into(), value.into());
    }
}
