//! Annotations to records. Their images and categories may stand behind them, so a file is held as a whole; only its lists of
//! images and categories are kept beside it.

use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value as Json};

use super::super::json::{Beside, Weights, check_attributes};
use super::super::limits::Limits;
use super::super::objects::{Giving, Part};
use super::super::options::{Holes, ReadOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Points, Record};
use super::super::source::Source;
use super::super::text::name_fits;
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::value::Value;
use crate::words::plain;

/// A file, whose annotations are read one by one. Members such as `info` and `licenses` say nothing of shapes.
#[derive(Deserialize, Default)]
#[serde(default)]
struct File<'a> {
    #[serde(borrow)]
    images: Vec<&'a RawValue>,
    #[serde(borrow)]
    categories: Vec<&'a RawValue>,
    #[serde(borrow)]
    annotations: Option<Vec<&'a RawValue>>,
}

#[derive(Deserialize)]
struct Image {
    id: Json,
    #[serde(flatten)]
    others: Map<String, Json>,
}

#[derive(Deserialize)]
struct Category {
    id: Json,
    name: String,
}

#[derive(Deserialize)]
struct Annotation {
    #[serde(default)]
    id: Json,
    name: Option<String>,
    #[serde(default)]
    image_id: Json,
    #[serde(default)]
    category_id: Json,
    segmentation: Option<Segmentation>,
    keypoints: Option<Vec<f64>>,
    #[serde(default)]
    attributes: Map<String, Json>,
    #[serde(flatten)]
    others: Map<String, Json>,
}

/// Members of an annotation that become attributes and metadata.
static MEMBERS: Beside =
    Beside { lists: &["segmentation", "keypoints", "bbox"], objects: &[("segmentation", &MASK)] };
static MASK: Beside = Beside { lists: &["counts", "size"], objects: &[] };
/// Memory of polygons: a list each.
const POLYGONS: Weights = Weights { object: 0, list: 64, item: 0 };

/// Polygons as lists of x and y in turn, or a mask.
#[derive(Debug, PartialEq)]
enum Segmentation {
    Polygons(Vec<Vec<f64>>),
    Mask,
}

/// Name of items left out of files with masks.
const MASKS: &str = "masks";
/// Members of an annotation that follow from its polygons.
const DERIVED: [&str; 3] = ["area", "bbox", "num_keypoints"];

pub(super) fn read(
    source: &mut Source<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let fault = |error: serde_json::Error| {
        let place =
            Place { tag: Some(format!("column {}", error.column())), ..Place::line(error.line() as u64) };
        let kind = if error.is_eof() { FaultKind::Truncated } else { FaultKind::Malformed };
        FileError::of(kind, place, plain(&error))
    };
    let file: File<'_> = if text.trim_start().starts_with('[') {
        // Results of a detector are a bare list of annotations.
        File { annotations: Some(serde_json::from_str(&text).map_err(fault)?), ..File::default() }
    } else {
        serde_json::from_str(&text).map_err(fault)?
    };
    let Some(annotations) = file.annotations else {
        return Err(FileError::malformed(
            Place::tag("annotations"),
            "expected a list of annotations, got none",
        ));
    };
    let place_of = |tag: &str, item: usize, part: &RawValue| Place {
        byte: Some(offset(part.get(), &text)),
        tag: Some(tag.into()),
        ..Place::item(item as u64)
    };
    let mut images = BTreeMap::new();
    for (k, image) in file.images.into_iter().enumerate() {
        let Image { id, others } = part(image.get(), || place_of("images", k, image))?;
        // Parsed again for each annotation, so without blanks and repeated names. A map takes many times as much memory.
        images.insert(id.to_string(), Json::Object(others).to_string());
    }
    let mut categories = BTreeMap::new();
    for (k, category) in file.categories.into_iter().enumerate() {
        let Category { id, name } = part(category.get(), || place_of("categories", k, category))?;
        name_fits(&name)
            .map_err(|detail| FileError::malformed(place_of("categories", k, category), detail))?;
        categories.insert(id.to_string(), name);
    }
    let mut reading =
        Reading { options, limits, images, categories, summary: Summary::default(), masks: 0, given: 0 };
    for (item, annotation) in (0..).zip(annotations) {
        let place = Place { byte: Some(offset(annotation.get(), &text)), ..Place::item(item) };
        if let Err(error) = reading.annotation(annotation.get(), item, &place, sink) {
            options.leave_out(error, &mut reading.summary)?;
        }
    }
    reading.finish()
}

/// Offset of a part of a text.
fn offset(part: &str, text: &str) -> u64 {
    (part.as_ptr() as usize).saturating_sub(text.as_ptr() as usize) as u64
}

/// An image or a category.
fn part<'a, T: Deserialize<'a>>(text: &'a str, place: impl Fn() -> Place) -> Result<T, FileError> {
    check_attributes(text, &place)?;
    serde_json::from_str(text).map_err(|error| FileError::malformed(place(), plain(&error)))
}

struct Reading<'o> {
    options: &'o ReadOptions,
    limits: Limits,
    /// Members of the images beside their ids, by these, as JSON.
    images: BTreeMap<String, String>,
    categories: BTreeMap<String, String>,
    summary: Summary,
    /// Number of masks, and of annotations that became records.
    masks: u64,
    given: u64,
}

impl Reading<'_> {
    fn annotation(&mut self, text: &str, item: u64, place: &Place, sink: Sink<'_>) -> Result<(), FileError> {
        let malformed = |error| FileError::malformed(place.clone(), plain(&error));
        MEMBERS.check(text.as_bytes(), || place.clone()).map_err(malformed)??;
        POLYGONS.check(text, self.limits.made(text.len()), || place.clone())?;
        let mut annotation: Annotation = serde_json::from_str(text).map_err(malformed)?;
        let (segmentation, keypoints) = (annotation.segmentation.take(), annotation.keypoints.take());
        let name = annotation.name.clone().or_else(|| word(&annotation.id));
        let label = self.label(&annotation.category_id);
        if !self.options.selects(label.as_deref().unwrap_or_default()) {
            self.summary.drop("annotations that are not selected", name.as_deref(), || place.clone());
            return Ok(());
        }
        let parts = match (segmentation, keypoints) {
            (Some(Segmentation::Mask), _) => {
                self.summary.drop(MASKS, name.as_deref(), || place.clone());
                self.masks += 1;
                return Ok(());
            }
            (Some(Segmentation::Polygons(polygons)), keypoints) if !polygons.is_empty() => {
                if keypoints.is_some() {
                    self.summary.drop("keypoints beside polygons", name.as_deref(), || place.clone());
                }
                polygons.into_iter().map(|polygon| ring(polygon, place)).collect::<Result<Vec<_>, _>>()?
            }
            (_, Some(keypoints)) => vec![landmarks(&keypoints, place)?],
            _ => {
                self.summary.drop("annotations without outline", name.as_deref(), || place.clone());
                return Ok(());
            }
        };
        self.given += 1;
        // It has a copy of the members of the image, so annotations left out do without it.
        let template = Record { name, label, ..self.template(annotation, place) };
        let limits = self.limits;
        let giving = Giving { holes: Holes::Keep, limits: &limits };
        giving.give(parts, item, template, &mut self.summary, sink)
    }

    /// The name of a category, or its id.
    fn label(&self, category: &Json) -> Option<String> {
        self.categories.get(&category.to_string()).cloned().or_else(|| word(category))
    }

    /// Facts of an annotation about its shapes, beside name and label.
    fn template(&mut self, annotation: Annotation, place: &Place) -> Record {
        let Annotation { image_id, attributes, others, .. } = annotation;
        let mut record = Record::new(Geometry::Landmarks(Points::new(2)), place.clone());
        for (name, value) in attributes {
            if let Some(value) = attribute(&value) {
                record.labels.insert(name, value);
            } else {
                self.summary
                    .drop("attributes that are no text, number or Boolean", Some(&name), || place.clone());
            }
        }
        for (name, value) in others {
            match name.as_str() {
                "score" => record.labels.extend(attribute(&value).map(|value| (name, value))),
                _ if DERIVED.contains(&name.as_str()) => {}
                _ => drop(record.metadata.insert(name, value)),
            }
        }
        if !image_id.is_null() {
            let mut image = Map::from_iter([("id".into(), image_id.clone())]);
            let known = self.images.get(&image_id.to_string());
            let others = known.and_then(|text| serde_json::from_str::<Map<String, Json>>(text).ok());
            image.extend(others.unwrap_or_default());
            record.metadata.insert("image".into(), Json::Object(image));
        }
        record
    }

    fn finish(mut self) -> Result<Summary, FileError> {
        let advice = "make label images of them, with annToMask of pycocotools for example, and import these";
        if self.masks > 0 && self.given == 0 {
            let detail = format!("expected annotations with polygons, got {} masks: {advice}", self.masks);
            let masks = self.summary.dropped.iter().find(|dropped| dropped.what == MASKS);
            let first = masks.map(|masks| masks.first.clone()).unwrap_or_default();
            return Err(FileError::unsupported(first, detail));
        }
        if self.masks > 0 {
            self.summary.warnings.push(format!("{} masks are not read: {advice}", self.masks));
        }
        Ok(self.summary)
    }
}

/// An id as a text.
fn word(id: &Json) -> Option<String> {
    match id {
        Json::String(text) => Some(text.clone()),
        Json::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

fn attribute(value: &Json) -> Option<Value> {
    match value {
        Json::Bool(value) => Some(Value::Bool(*value)),
        Json::String(text) => Some(Value::Text(text.clone())),
        Json::Number(number) => Value::number(number),
        _ => None,
    }
}

fn ring(polygon: Vec<f64>, place: &Place) -> Result<Part, FileError> {
    let count = polygon.len();
    if count == 0 || !count.is_multiple_of(2) {
        let detail = format!("expected x and y of every point of a polygon, got {count} numbers");
        return Err(FileError::malformed(Place::tag("segmentation").within(place), detail));
    }
    let mut points = Points::from_rows(2, polygon);
    points.open();
    Ok(Part::Area(vec![points]))
}

/// Points of x, y and visibility; a point that is not labelled (0) is missing.
fn landmarks(keypoints: &[f64], place: &Place) -> Result<Part, FileError> {
    let count = keypoints.len();
    if count == 0 || !count.is_multiple_of(3) {
        let detail = format!("expected x, y and visibility of every keypoint, got {count} numbers");
        return Err(FileError::malformed(Place::tag("keypoints").within(place), detail));
    }
    let mut points = Points::new(2);
    for point in keypoints.chunks_exact(3) {
        if point[2] == 0.0 { points.push_missing() } else { points.push(&point[..2]) }
    }
    Ok(Part::Points(points))
}

impl<'de> Deserialize<'de> for Segmentation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Either)
    }
}

struct Either;

impl<'de> Visitor<'de> for Either {
    type Value = Segmentation;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of polygons or a mask")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Segmentation, A::Error> {
        let mut polygons = Vec::new();
        while let Some(polygon) = list.next_element()? {
            polygons.push(polygon);
        }
        Ok(Segmentation::Polygons(polygons))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Segmentation, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Segmentation::Mask)
    }
}
