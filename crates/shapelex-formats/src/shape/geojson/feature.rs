//! A feature or a geometry as it stands in the file, before it is a shape.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value as Json};

use super::super::json::Beside;
use super::coordinates::Coordinates;
use crate::value::Value;

/// Members of a feature that become attributes and metadata.
pub(super) static MEMBERS: Beside = Beside {
    lists: &["coordinates", "bbox"],
    objects: &[
        ("geometry", &MEMBERS),
        ("nucleusGeometry", &MEMBERS),
        ("geometries", &MEMBERS),
        ("properties", &PROPERTIES),
    ],
};
static PROPERTIES: Beside = Beside { lists: &CHILDREN, objects: &[] };
/// Features below another one, which are counted.
const CHILDREN: [&str; 2] = ["childObjects", "children"];

/// Members of a feature or a geometry that have a meaning here: all others are kept as they are.
pub(super) const KNOWN: [&str; 8] =
    ["type", "coordinates", "geometries", "geometry", "nucleusGeometry", "id", "properties", "bbox"];

/// An object of type Feature, or a geometry: they have no member but `type` in common, so one type holds both.
#[derive(Debug, Default)]
pub(super) struct Node {
    /// Member `type`.
    pub(super) kind: String,
    pub(super) coordinates: Option<Coordinates>,
    /// Those of a GeometryCollection.
    pub(super) geometries: Vec<Node>,
    pub(super) geometry: Option<Box<Node>>,
    /// Second outline of a cell of QuPath.
    pub(super) nucleus: Option<Box<Node>>,
    pub(super) id: Option<String>,
    pub(super) properties: Properties,
    /// Members that are not of the standard, such as `plane` and `isEllipse` of a geometry of QuPath.
    pub(super) others: Map<String, Json>,
}

/// Member `properties`.
#[derive(Debug, Default)]
pub(super) struct Properties {
    pub(super) name: Option<String>,
    pub(super) class: Option<String>,
    pub(super) measurements: Measurements,
    /// Number of features below this one.
    pub(super) children: u64,
    /// Parts of records that the writer of this crate keeps beside those that QuPath knows.
    pub(super) own: Option<Own>,
    pub(super) others: Map<String, Json>,
}

/// Member `shapelex` of the properties.
#[derive(Debug, Default, Deserialize, serde::Serialize)]
#[serde(default)]
pub(super) struct Own {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) subject: Option<String>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) labels: BTreeMap<String, Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) weight: Option<f64>,
    /// Unit of the coordinates, where it is not that of QuPath.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unit: Option<String>,
    /// Properties that the writer added, which are not metadata.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) added: Vec<String>,
}

impl Own {
    /// Whether it says nothing.
    pub(super) fn is_empty(&self) -> bool {
        let Self { subject, labels, weight, unit, added } = self;
        subject.is_none() && labels.is_empty() && weight.is_none() && unit.is_none() && added.is_empty()
    }
}

/// Numbers by name, and how many had none.
#[derive(Debug, Default)]
pub(super) struct Measurements {
    pub(super) values: BTreeMap<String, Value>,
    /// Names of those without a number.
    pub(super) empty: Vec<String>,
}

/// A text that is borrowed where it has no escapes.
#[derive(Deserialize)]
struct Text<'a>(#[serde(borrow)] Cow<'a, str>);

/// Refuses a member that is there already.
fn once<E: Error>(taken: bool, name: &'static str) -> Result<(), E> {
    if taken { Err(E::duplicate_field(name)) } else { Ok(()) }
}

impl Node {
    /// Whether this is a geometry, by its members.
    pub(super) fn is_geometry(&self) -> bool {
        self.coordinates.is_some() || self.kind == "GeometryCollection"
    }

    /// Names of its members that only a geometry has a use for.
    pub(super) fn of_geometries(&self) -> impl Iterator<Item = &str> {
        let members =
            [("coordinates", self.coordinates.is_some()), ("geometries", !self.geometries.is_empty())];
        members.into_iter().filter(|(_, given)| *given).map(|(name, _)| name)
    }

    /// Names of its members that a geometry of its type has no use for.
    pub(super) fn of_others(&self) -> impl Iterator<Item = &str> {
        let is_collection = self.kind == "GeometryCollection";
        let members = [
            ("geometry", self.geometry.is_some()),
            ("id", self.id.is_some()),
            ("nucleusGeometry", self.nucleus.is_some()),
            ("properties", !self.properties.is_empty()),
            ("coordinates", is_collection && self.coordinates.is_some()),
            ("geometries", !is_collection && !self.geometries.is_empty()),
        ];
        members.into_iter().filter(|(_, given)| *given).map(|(name, _)| name)
    }

    /// Number of its rings and lines, with those of the geometries below it.
    pub(super) fn rings(&self) -> usize {
        self.coordinates.as_ref().map_or(0, Coordinates::rings)
            + self.geometries.iter().map(Self::rings).sum::<usize>()
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Members)
    }
}

struct Members;

impl<'de> Visitor<'de> for Members {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a feature or a geometry as an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut node = Node::default();
        while let Some(Text(key)) = map.next_key()? {
            match &*key {
                "type" => {
                    once(!node.kind.is_empty(), "type")?;
                    node.kind = map.next_value()?;
                }
                "coordinates" => {
                    once(node.coordinates.is_some(), "coordinates")?;
                    node.coordinates = Some(map.next_value()?);
                }
                "geometries" => {
                    once(!node.geometries.is_empty(), "geometries")?;
                    node.geometries = map.next_value()?;
                }
                "geometry" => {
                    once(node.geometry.is_some(), "geometry")?;
                    node.geometry = map.next_value()?;
                }
                "nucleusGeometry" => {
                    once(node.nucleus.is_some(), "nucleusGeometry")?;
                    node.nucleus = map.next_value()?;
                }
                "id" => match map.next_value()? {
                    Json::String(text) => node.id = Some(text),
                    Json::Number(number) => node.id = Some(number.to_string()),
                    Json::Null => {}
                    other => drop(node.others.insert(key.into_owned(), other)),
                },
                "properties" => {
                    once(!node.properties.is_empty(), "properties")?;
                    node.properties = map.next_value::<Option<Properties>>()?.unwrap_or_default();
                }
                // It follows from the coordinates.
                "bbox" => drop(map.next_value::<IgnoredAny>()?),
                _ => drop(node.others.insert(key.into_owned(), map.next_value()?)),
            }
        }
        Ok(node)
    }
}

impl Properties {
    fn is_empty(&self) -> bool {
        let Self { name, class, measurements, children, own, others } = self;
        name.is_none()
            && class.is_none()
            && measurements.values.is_empty()
            && measurements.empty.is_empty()
            && *children == 0
            && own.is_none()
            && others.is_empty()
    }

    /// Takes the name of a class; other members of the class stay beside the other properties.
    fn classify(&mut self, class: Json) {
        match class {
            Json::String(name) => self.class = Some(name),
            Json::Object(mut class) => {
                if class.get("name").is_some_and(Json::is_null) {
                    class.remove("name");
                }
                // QuPath writes a class below another one as a list of names; its own text joins them so.
                let (key, name) = match (class.get("name"), class.get("names")) {
                    (Some(Json::String(name)), _) => ("name", Some(name.clone())),
                    (_, Some(Json::Array(names))) => {
                        let names: Option<Vec<_>> = names.iter().map(Json::as_str).collect();
                        ("names", names.map(|names| names.join(": ")))
                    }
                    _ => ("name", None),
                };
                if name.is_some() {
                    class.remove(key);
                    self.class = name;
                }
                if !class.is_empty() {
                    self.others.insert("classification".into(), Json::Object(class));
                }
            }
            Json::Null => {}
            other => drop(self.others.insert("classification".into(), other)),
        }
    }
}

impl<'de> Deserialize<'de> for Properties {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(PropertyMembers)
    }
}

struct PropertyMembers;

impl<'de> Visitor<'de> for PropertyMembers {
    type Value = Properties;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("properties as an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Properties, A::Error> {
        let mut properties = Properties::default();
        while let Some(Text(key)) = map.next_key()? {
            match &*key {
                "name" => match map.next_value()? {
                    Json::String(name) => properties.name = Some(name),
                    Json::Number(number) => properties.name = Some(number.to_string()),
                    Json::Null => {}
                    other => drop(properties.others.insert(key.into_owned(), other)),
                },
                "classification" => properties.classify(map.next_value()?),
                "measurements" => {
                    properties.measurements = map.next_value::<Option<Measurements>>()?.unwrap_or_default();
                }
                name if CHILDREN.contains(&name) => {
                    let text = map.next_value::<&RawValue>()?.get();
                    if let Ok(children) = serde_json::from_str::<Vec<IgnoredAny>>(text) {
                        properties.children = children.len() as u64;
                    } else {
                        let other = serde_json::from_str(text).map_err(A::Error::custom)?;
                        properties.others.insert(key.into_owned(), other);
                    }
                }
                "shapelex" => properties.own = Some(map.next_value()?),
                _ => drop(properties.others.insert(key.into_owned(), map.next_value()?)),
            }
        }
        Ok(properties)
    }
}

impl Measurements {
    fn insert(&mut self, name: String, value: Json) {
        match value {
            Json::Number(number) => match Value::number(&number) {
                Some(value) => drop(self.values.insert(name, value)),
                None => self.empty.push(name),
            },
            Json::Bool(value) => drop(self.values.insert(name, Value::Bool(value))),
            Json::String(value) => drop(self.values.insert(name, Value::Text(value))),
            _ => self.empty.push(name),
        }
    }
}

impl<'de> Deserialize<'de> for Measurements {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(MeasurementMembers)
    }
}

struct MeasurementMembers;

/// A measurement as QuPath wrote it before 0.4.
#[derive(Deserialize)]
struct Measurement {
    name: String,
    #[serde(default)]
    value: Json,
}

impl<'de> Visitor<'de> for MeasurementMembers {
    type Value = Measurements;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("measurements as an object or a list of names and values")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Measurements, A::Error> {
        let mut measurements = Measurements::default();
        while let Some((name, value)) = map.next_entry()? {
            measurements.insert(name, value);
        }
        Ok(measurements)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Measurements, A::Error> {
        let mut measurements = Measurements::default();
        while let Some(Measurement { name, value }) = list.next_element()? {
            measurements.insert(name, value);
        }
        Ok(measurements)
    }

    fn visit_unit<E: Error>(self) -> Result<Measurements, E> {
        Ok(Measurements::default())
    }
}
