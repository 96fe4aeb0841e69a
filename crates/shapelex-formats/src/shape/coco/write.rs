//! Records to annotations. Images and categories are collected and written behind them.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use serde_json::{Map, Value as Json, json};

use super::super::json::map_bytes;
use super::super::objects::{Grouping, PartRef, add_metadata, area, parts, refusal};
use super::super::options::WriteOptions;
use super::super::record::{Geometry, Points, Record};
use super::super::text::parts_left_out;
use super::super::write::{Opened, Output, Writer};
use crate::error::FileError;
use crate::summary::Summary;
use crate::value::Value;

/// Category of records without label: every annotation must have one.
const UNLABELLED: &str = "object";
/// Bytes of an id in a map, and of its data beside its texts.
const ID: usize = 64;

/// A file that is being written.
struct File<'a> {
    output: Output<'a>,
    grouping: Grouping,
    annotations: u64,
    /// Ids of the annotations so far.
    ids: BTreeSet<u64>,
    /// Id of each category by its name.
    categories: BTreeMap<String, u64>,
    /// Images by their id as text.
    images: BTreeMap<String, Json>,
    /// Number of bytes of ids, categories and images.
    kept: usize,
    summary: Summary,
}

pub(super) fn open<'a>(mut output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    output.write_all(b"{\"annotations\":[")?;
    Ok(Box::new(File {
        output,
        grouping: Grouping::default(),
        annotations: 0,
        ids: BTreeSet::new(),
        categories: BTreeMap::new(),
        images: BTreeMap::new(),
        kept: 0,
        summary: Summary::default(),
    }))
}

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let before = self.grouping.push(record, &mut self.summary);
        self.annotation(&before)
    }

    fn held(&self) -> usize {
        self.grouping.held() + self.kept
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let left = self.grouping.finish();
        self.annotation(&left)?;
        let mut categories: Vec<_> = self.categories.iter().map(|(name, id)| (*id, name)).collect();
        categories.sort_unstable();
        let categories: Vec<Json> =
            categories.into_iter().map(|(id, name)| json!({"id": id, "name": name})).collect();
        let images: Vec<&Json> = self.images.values().collect();
        let end = format!("\n],\n\"categories\":{},\n\"images\":{}}}\n", json!(categories), json!(images));
        self.output.write_all(end.as_bytes())?;
        self.output.flush()?;
        self.summary.records = self.grouping.count();
        Ok(self.summary)
    }
}

/// Members of an annotation that a reader gives a meaning.
const OWN: [&str; 11] = [
    "id",
    "name",
    "image_id",
    "category_id",
    "segmentation",
    "keypoints",
    "num_keypoints",
    "area",
    "bbox",
    "attributes",
    "score",
];

impl File<'_> {
    fn annotation(&mut self, records: &[Record]) -> Result<(), FileError> {
        let Some(first) = records.first() else { return Ok(()) };
        let mut annotation = match &first.geometry {
            Geometry::Landmarks(points) if records.len() == 1 => keypoints(points, first)?,
            _ => polygons(records, first)?,
        };
        parts_left_out(&mut self.summary, first, &["label", "labels", "ring"]);
        let number =
            first.name.as_deref().and_then(|name| name.parse().ok()).filter(|id| !self.ids.contains(id));
        let id = number.unwrap_or_else(|| self.free_id());
        self.ids.insert(id);
        self.kept += ID;
        annotation.insert("id".into(), id.into());
        if let Some(name) = first.name.as_ref().filter(|name| **name != id.to_string()) {
            annotation.insert("name".into(), name.clone().into());
        }
        let count = self.categories.len() as u64 + 1;
        let label = first.label.clone().unwrap_or_else(|| UNLABELLED.into());
        if !self.categories.contains_key(&label) {
            self.kept += ID + label.len();
        }
        annotation.insert("category_id".into(), (*self.categories.entry(label).or_insert(count)).into());
        let mut metadata = first.metadata.clone();
        annotation.insert("image_id".into(), self.image(metadata.remove("image")));
        let mut attributes = Map::new();
        for (name, value) in &first.labels {
            match value {
                Value::Number(number) if name == "score" => {
                    drop(annotation.insert("score".into(), json!(number)))
                }
                value => drop(attributes.insert(name.clone(), json!(value))),
            }
        }
        if !attributes.is_empty() {
            annotation.insert("attributes".into(), Json::Object(attributes));
        }
        add_metadata(&mut annotation, metadata, &OWN, first, &mut self.summary);
        annotation.entry("iscrowd").or_insert(0.into());
        self.output.write_all(if self.annotations > 0 { b",\n" } else { b"\n" })?;
        serde_json::to_writer(&mut self.output, &annotation).map_err(std::io::Error::from)?;
        self.annotations += 1;
        Ok(())
    }

    /// The first id that no annotation has, from the number of the annotation on.
    fn free_id(&self) -> u64 {
        (self.annotations + 1..).find(|id| !self.ids.contains(id)).unwrap_or(u64::MAX)
    }

    /// Id of the image of a record; a record without image belongs to one without name.
    fn image(&mut self, image: Option<Json>) -> Json {
        let mut image = match image {
            Some(Json::Object(image)) => image,
            Some(Json::String(name)) => Map::from_iter([("file_name".into(), name.into())]),
            _ => Map::new(),
        };
        if !image.contains_key("file_name") {
            image.insert("file_name".into(), "".into());
        }
        let id = match image.get("id") {
            Some(id) => id.clone(),
            None => {
                let same =
                    self.images.values().find(|known| known.get("file_name") == image.get("file_name"));
                same.map_or_else(|| json!(self.images.len() as u64 + 1), |known| known["id"].clone())
            }
        };
        image.insert("id".into(), id.clone());
        if let Entry::Vacant(entry) = self.images.entry(id.to_string()) {
            self.kept += ID + map_bytes(&image);
            entry.insert(Json::Object(image));
        }
        id
    }
}

/// Polygons with their area and bounds, which COCO wants beside them.
fn polygons(records: &[Record], first: &Record) -> Result<Map<String, Json>, FileError> {
    let (mut lists, mut total) = (Vec::new(), 0.0);
    let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    for part in parts(records, "COCO")? {
        let ring = match part {
            PartRef::Area(rings) if rings.len() == 1 => rings[0],
            PartRef::Area(_) => return Err(refusal(first, "COCO", "holes")),
            PartRef::Line(_) => return Err(refusal(first, "COCO", "an open line")),
            PartRef::Points(_) => return Err(refusal(first, "COCO", "points beside other parts")),
        };
        if ring.dimension() != 2 {
            return Err(refusal(first, "COCO", "points of 3 coordinates"));
        }
        total += area(ring).abs();
        for row in ring.rows() {
            for axis in [0, 1] {
                bounds[axis] = bounds[axis].min(row[axis]);
                bounds[axis + 2] = bounds[axis + 2].max(row[axis]);
            }
        }
        lists.push(ring.coordinates().to_vec());
    }
    let [left, top, right, bottom] = bounds;
    let members = [
        ("segmentation", json!(lists)),
        ("area", json!(total)),
        ("bbox", json!([left, top, right - left, bottom - top])),
    ];
    Ok(members.map(|(name, value)| (name.to_owned(), value)).into_iter().collect())
}

/// Landmarks as keypoints; a missing one is not labelled.
fn keypoints(points: &Points, record: &Record) -> Result<Map<String, Json>, FileError> {
    if points.dimension() != 2 {
        return Err(refusal(record, "COCO", &format!("points of {} coordinates", points.dimension())));
    }
    let known = |row: &&[f64]| row.iter().all(|x| !x.is_nan());
    let all = points.rows().flat_map(|row| if known(&row) { [row[0], row[1], 2.0] } else { [0.0; 3] });
    let members = [
        ("keypoints", json!(all.collect::<Vec<_>>())),
        ("num_keypoints", json!(points.rows().filter(known).count())),
    ];
    Ok(members.map(|(name, value)| (name.to_owned(), value)).into_iter().collect())
}
