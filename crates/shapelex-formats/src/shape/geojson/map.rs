//! Features to records.

use serde_json::Value as Json;

use super::super::limits::Limits;
use super::super::objects::{Giving, Part};
use super::super::options::{Names, Nuclei, ReadOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Points, Record};
use super::coordinates::Coordinates;
use super::feature::{Node, Own, Properties};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::unit::Unit;

/// Makes records of features, and counts those that become none.
pub(super) struct Mapping<'o> {
    pub(super) options: &'o ReadOptions,
    limits: Limits,
    pub(super) summary: Summary,
    /// Number of rings that did not repeat their first point.
    unclosed: u64,
}

impl<'o> Mapping<'o> {
    pub(super) fn new(options: &'o ReadOptions, limits: Limits) -> Self {
        Self { options, limits, summary: Summary::default(), unclosed: 0 }
    }

    /// Gives the shapes of one feature, or of a geometry without properties, on.
    pub(super) fn give(
        &mut self,
        node: Node,
        item: u64,
        place: &Place,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        let node = match node.kind.as_str() {
            "Feature" => node,
            _ if node.is_geometry() => {
                let mut node = node;
                let id = node.id.take();
                Node { kind: "Feature".into(), id, geometry: Some(Box::new(node)), ..Node::default() }
            }
            "" => return Err(FileError::malformed(place.clone(), "expected a member type, got none")),
            other => {
                let detail = format!("expected a Feature or a geometry, got type '{other}'");
                return Err(FileError::malformed(place.clone(), detail));
            }
        };
        debug_assert_eq!(node.kind, "Feature");
        for name in node.of_geometries() {
            self.summary.drop("members of features", Some(name), || place.clone());
        }
        let Node { id, geometry, nucleus, properties, others, .. } = node;
        let mut template = self.template(properties, id, place);
        others.into_iter().for_each(|(name, value)| self.add_member(&mut template, name, value));
        let name = template.name.clone();
        let selected = [&template.label, &name].into_iter().flatten().any(|word| self.options.selects(word));
        if self.options.select.is_some() && !selected {
            self.summary.drop("features that are not selected", name.as_deref(), || place.clone());
            return Ok(());
        }
        let Some(outline) = geometry else {
            self.summary.drop("features without geometry", name.as_deref(), || place.clone());
            return Ok(());
        };
        let nuclei = self.options.nuclei.unwrap_or_default();
        let nucleus = match (nucleus, nuclei) {
            (Some(_), Nuclei::Skip) => {
                self.summary.drop("nuclei of cells", name.as_deref(), || place.clone());
                None
            }
            (nucleus, _) => nucleus,
        };
        if nuclei == Nuclei::Only {
            self.summary.drop("outlines beside the nuclei", name.as_deref(), || place.clone());
        } else {
            let outer = if nucleus.is_some() {
                template.clone()
            } else {
                std::mem::replace(&mut template, blank(place))
            };
            self.geometry(*outline, item, outer, place, sink)?;
        }
        let Some(nucleus) = nucleus else { return Ok(()) };
        template.name = name.map(|name| format!("{name}/nucleus"));
        self.geometry(*nucleus, item, template, place, sink)
    }

    /// A record without shape that has the facts of a feature.
    fn template(&mut self, properties: Properties, id: Option<String>, place: &Place) -> Record {
        let Properties { name, class, measurements, children, own, others } = properties;
        for name in &measurements.empty {
            self.summary.drop("measurements without a number", Some(name), || place.clone());
        }
        if children > 0 {
            let name = name.as_deref().or(id.as_deref());
            self.summary.drop_many("child objects", children, name, || place.clone());
        }
        let mut record = blank(place);
        (record.label, record.labels, record.metadata) = (class, measurements.values, others);
        match (name, id) {
            (Some(name), Some(id)) if self.options.names == Some(Names::Id) => {
                record.name = Some(id);
                record.metadata.insert("name".into(), name.into());
            }
            (Some(name), Some(id)) => {
                record.name = Some(name);
                if record.metadata.insert("id".into(), id.into()).is_some() {
                    self.summary.drop("properties with the name of a member", Some("id"), || place.clone());
                }
            }
            (name, id) => record.name = name.or(id),
        }
        // QuPath says the type of each of its objects, and measures them in pixels of the image.
        let of_qupath = record.metadata.get("objectType").is_some_and(Json::is_string);
        record.unit = of_qupath.then_some(Unit::Pixel);
        if let Some(Own { subject, labels, weight, unit, added }) = own {
            let is_added = added.iter().any(|name| name == "objectType");
            record.unit = match unit {
                Some(unit) => Unit::find(&unit),
                None => record.unit.filter(|_| !is_added),
            };
            added.iter().for_each(|name| drop(record.metadata.remove(name)));
            (record.subject, record.weight) = (subject, weight);
            record.labels.extend(labels);
        }
        record
    }

    /// Adds a member of a feature to the metadata, or counts it if a property has its name.
    fn add_member(&mut self, record: &mut Record, name: String, value: Json) {
        if record.metadata.contains_key(&name) {
            self.summary.drop("members with the name of a property", Some(&name), || record.place.clone());
        } else {
            record.metadata.insert(name, value);
        }
    }

    /// Gives the parts of a geometry on.
    fn geometry(
        &mut self,
        mut node: Node,
        item: u64,
        mut template: Record,
        place: &Place,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        if !node.others.is_empty() {
            let members = std::mem::take(&mut node.others).into();
            self.add_member(&mut template, "geometry".into(), members);
        }
        self.limits.rings(node.rings(), || place.clone())?;
        let mut parts = Vec::new();
        self.collect(node, template.name.as_deref(), &mut parts, place)?;
        let limits = self.limits;
        let giving = Giving { holes: self.options.holes.unwrap_or_default(), limits: &limits };
        giving.give(parts, item, template, &mut self.summary, sink)
    }

    /// Adds the parts of a geometry of a feature with a name. Its depth is bounded by that of the text.
    fn collect(
        &mut self,
        node: Node,
        name: Option<&str>,
        parts: &mut Vec<Part>,
        place: &Place,
    ) -> Result<(), FileError> {
        // Other members of a whole geometry are metadata already.
        for member in node.of_others().chain(node.others.keys().map(String::as_str)) {
            self.summary.drop("members of geometries", Some(member), || place.clone());
        }
        let Node { kind, coordinates, geometries, .. } = node;
        if kind == "GeometryCollection" {
            if geometries.is_empty() {
                self.summary.drop("empty geometries", name, || place.clone());
            }
            return geometries.into_iter().try_for_each(|node| self.collect(node, name, parts, place));
        }
        let place = || Place::tag("coordinates").within(place);
        let height = match kind.as_str() {
            "Point" => 0,
            "MultiPoint" | "LineString" => 1,
            "Polygon" | "MultiLineString" => 2,
            "MultiPolygon" => 3,
            other => {
                let detail = format!("expected a type of geometry, got '{other}'");
                return Err(FileError::malformed(place(), detail));
            }
        };
        let Some(coordinates) = coordinates else {
            return Err(FileError::malformed(place(), format!("expected coordinates of a {kind}, got none")));
        };
        let Some(found) = coordinates.height else {
            self.summary.drop("empty geometries", name, place);
            return Ok(());
        };
        if found != height {
            let [expected, found] = [height, found].map(|height| {
                ["a position", "a list of positions", "lists of positions", "lists of lists of positions"]
                    [height]
            });
            let detail = format!("expected {expected} as coordinates of a {kind}, got {found}");
            return Err(FileError::malformed(place(), detail));
        }
        match kind.as_str() {
            "Point" | "MultiPoint" => parts.push(Part::Points(coordinates.points())),
            "LineString" => parts.push(Part::Line(coordinates.points())),
            "MultiLineString" => parts.extend(coordinates.lines().into_iter().map(Part::Line)),
            "Polygon" => parts.push(self.polygon(coordinates.lines())),
            _ => {
                parts.extend(Coordinates::polygons(coordinates).into_iter().map(|rings| self.polygon(rings)))
            }
        }
        Ok(())
    }

    fn polygon(&mut self, mut rings: Vec<Points>) -> Part {
        for ring in &mut rings {
            if !ring.open() {
                self.unclosed += 1;
            }
        }
        Part::Area(rings)
    }

    /// Summary of the whole file.
    pub(super) fn finish(mut self) -> Summary {
        if self.unclosed > 0 {
            let warning = format!("{} rings do not repeat their first point, taken as closed", self.unclosed);
            self.summary.warnings.push(warning);
        }
        self.summary
    }
}

/// A record of which only the place is known.
fn blank(place: &Place) -> Record {
    Record::new(Geometry::Landmarks(Points::new(2)), place.clone())
}
