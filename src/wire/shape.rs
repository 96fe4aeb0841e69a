//! Shapes as JSON.
//!
//! ```json
//! {"points": [[0, 0], [2, 0], [2, 1]], "external_id": "scan-17", "label": "control", "labels": {"age": 61}}
//! ```
//!
//! Lists of points are read into one flat array. All faults in them are collected, not only the first one, and only
//! finite numbers are accepted.

use crate::wire::fault::Fault;
use std::fmt;

use serde::de::{Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use super::bounds::{self, keep_fault};
use super::checked::{Checked, Ignored, LARGE, Metadata, Raw, document, skip_list, visit_others};
use super::observed::Observed;
#[cfg(feature = "schema")]
use super::observed::ObservedEntry;
use super::trail::{next_entry, next_entry_by};
use super::unit::Ratio;

/// Largest magnitude of a coordinate.
pub const MAX_COORDINATE: f64 = crate::numeric::MAX_NUMBER;

/// Maximum number of faults kept per list of points.
const MAX_FAULTS: usize = 20;
/// Number of coordinates kept per point: no representation has more; further ones are only counted.
const MAX_WIDTH: usize = 3;

/// Points as rows of coordinates or as a grid, read leniently: faults are recorded, and points beyond the limit of a shape
/// are counted but not kept.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointList {
    coordinates: Vec<f64>,
    /// Number of coordinates of the first point.
    width: usize,
    rows: usize,
    /// Number of points of the first entry, if the entries are lists of points.
    columns: Option<usize>,
    null: bool,
    /// Limit of the points kept, if it was exceeded; else 0.
    most: usize,
    /// Small where nothing is wrong or missing: a request may have 100 000 lists.
    apart: Option<Box<Apart>>,
}

/// Faults of a list of points, and its missing points.
#[derive(Debug, Clone, Default, PartialEq)]
struct Apart {
    faults: Vec<Fault>,
    /// Positions of entries that are null: points that are missing.
    gaps: Vec<u32>,
}

impl From<&Points> for PointList {
    /// The points of an answer as if they were posted, in one list.
    fn from(points: &Points) -> Self {
        let rows = points.len();
        let coordinates = (0..rows).flat_map(|k| points.row(k)).collect();
        Self { coordinates, width: points.dimension, rows, ..Self::default() }
    }
}

impl PointList {
    /// Points of a file: row-major coordinates that are finite and within bounds.
    pub fn of_rows(dimension: usize, coordinates: Vec<f64>) -> Self {
        let rows = coordinates.len().checked_div(dimension).unwrap_or(0);
        Self { coordinates, width: dimension, rows, ..Self::default() }
    }

    /// The same in another unit; numbers then beyond the bounds are faults.
    #[must_use]
    pub fn scaled(mut self, ratio: Ratio) -> Self {
        self.coordinates.iter_mut().for_each(|x| *x = ratio.times(*x));
        if let Some(x) = self.coordinates.iter().copied().find(|x| !(x.abs() <= MAX_COORDINATE)) {
            self.fault(String::new(), format!("expected numbers within ±{MAX_COORDINATE:e}, got {x:e}"));
        }
        self
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.rows * self.columns.unwrap_or(1)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether the document has `null` in place of a list.
    pub fn is_null(&self) -> bool {
        self.null
    }

    /// Number of coordinates of the first point.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Numbers of rows and columns, if the points form a grid.
    pub fn grid(&self) -> Option<[usize; 2]> {
        self.columns.map(|columns| [self.rows, columns])
    }

    /// Whether entries are null: points that are missing.
    pub fn has_gaps(&self) -> bool {
        !self.gaps().is_empty()
    }

    fn gaps(&self) -> &[u32] {
        self.apart.as_ref().map_or(&[], |apart| &apart.gaps)
    }

    fn faults(&self) -> &[Fault] {
        self.apart.as_ref().map_or(&[], |apart| &apart.faults)
    }

    /// Row-major coordinates, if every point has `dimension` finite numbers.
    ///
    /// # Errors
    /// All faults (at most 20, one for all missing points) with pointers relative to the list.
    pub fn checked(&self, dimension: usize) -> Result<&[f64], Vec<Fault>> {
        let Some(&first) = self.gaps().first() else { return self.present(dimension) };
        let others = self.gaps().len() - 1;
        let further = if others > 0 { format!(", as in {others} further entries") } else { String::new() };
        let gap =
            Fault::new(format!("/{first}"), format!("expected a list of coordinates, got null{further}"));
        let mut faults = self.faults().to_vec();
        let before = |fault: &Fault| position_of(fault).is_some_and(|position| position < first);
        faults.insert(faults.iter().take_while(|fault| before(fault)).count(), gap);
        Err(faults)
    }

    /// The points, `None` where one is missing, if every other has `dimension` finite numbers.
    ///
    /// # Errors
    /// All faults (at most 20) with pointers relative to the list.
    pub fn with_gaps(&self, dimension: usize) -> Result<Vec<Option<Vec<f64>>>, Vec<Fault>> {
        let mut present = self.present(dimension)?.chunks_exact(dimension.max(1));
        let mut gaps = self.gaps().iter().peekable();
        let row = |position: usize| match gaps.next_if(|gap| **gap as usize == position) {
            Some(_) => None,
            None => present.next().map(<[f64]>::to_vec),
        };
        Ok((0..self.rows).map(row).collect())
    }

    /// Row-major coordinates of the points that are there.
    fn present(&self, dimension: usize) -> Result<&[f64], Vec<Fault>> {
        if !self.faults().is_empty() {
            return Err(self.faults().to_vec());
        }
        if self.most > 0 {
            let detail = format!("expected at most {1} points, got {0}", self.len(), self.most);
            return Err(vec![Fault::new("", detail)]);
        }
        if self.rows > self.gaps().len() && self.width != dimension {
            let detail = format!(
                "expected {dimension} coordinates per point (the dimension of the representation), got {}",
                self.width
            );
            let first = if self.columns.is_some() { "/0/0" } else { "/0" };
            return Err(vec![Fault::new(first, detail)]);
        }
        Ok(&self.coordinates)
    }

    fn fault(&mut self, pointer: String, detail: String) {
        keep_fault(&mut self.apart.get_or_insert_default().faults, MAX_FAULTS, || {
            Fault::new(pointer, detail)
        });
    }

    /// Kind of the entries, known once there is one.
    fn kind(&self) -> Option<Kind> {
        (self.rows > self.gaps().len()).then_some(if self.columns.is_some() {
            Kind::Points
        } else {
            Kind::Point
        })
    }

    /// Adds the entry that was read: a point, or a column of the grid.
    fn push(&mut self, entry: &Entry) {
        let position = self.rows;
        self.rows += 1;
        let most = bounds::current().points;
        if entry.missing && self.columns.is_none() {
            match u32::try_from(position).ok().filter(|_| self.rows <= most) {
                Some(gap) => self.apart.get_or_insert_default().gaps.push(gap),
                None => self.most = most.max(1),
            }
            return;
        }
        for (pointer, detail) in &entry.faults {
            self.fault(format!("/{position}{pointer}"), detail.clone());
        }
        if let Some(detail) = &entry.not_a_list {
            self.fault(format!("/{position}"), detail.clone());
            return;
        }
        // The first point that is not missing.
        if position == self.gaps().len() {
            self.columns = entry.points;
            self.width = entry.width;
        }
        match (self.columns, entry.points) {
            // The fault of its content is already recorded.
            (Some(_), None) if !entry.faults.is_empty() => {}
            (Some(_), None) => self.fault(
                format!("/{position}"),
                "expected a list of points like the first entry, got no points".into(),
            ),
            (Some(first), Some(found)) if first != found => {
                self.fault(
                    format!("/{position}"),
                    format!("expected {first} points, as in the first list, got {found}"),
                );
            }
            _ if entry.width != self.width => {
                let detail = format!(
                    "expected {1} coordinates, as in the first point, got {0}",
                    entry.width, self.width
                );
                self.fault(format!("/{position}"), detail);
            }
            _ => {}
        }
        if entry.cut || self.len() > most {
            self.most = most.max(1);
        } else {
            self.coordinates.extend_from_slice(&entry.values);
        }
    }
}

impl<'de> Deserialize<'de> for PointList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ListVisitor;
        impl<'de> Visitor<'de> for ListVisitor {
            type Value = PointList;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of points such as [[0, 0], [1, 0]]")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<PointList, A::Error> {
                let mut list = PointList::default();
                let mut entry = Entry::default();
                loop {
                    let seed = EntrySeed(&mut entry, list.kind());
                    if next_entry_by(&mut rows, list.rows, seed)?.is_none() {
                        break;
                    }
                    list.push(&entry);
                }
                list.coordinates.shrink_to_fit();
                Ok(list)
            }

            fn visit_unit<E>(self) -> Result<PointList, E> {
                Ok(PointList { null: true, ..PointList::default() })
            }

            visit_others!(@text not_a_list, PointList);
            visit_others!(@number not_a_list, PointList);
            visit_others!(@map not_a_list, PointList);
        }
        fn not_a_list(_: ListVisitor, what: &'static str) -> PointList {
            let mut list = PointList::default();
            list.fault(String::new(), format!("expected a list of points, got {what}"));
            list
        }
        deserializer.deserialize_any(ListVisitor)
    }
}

/// Kind of the entries of a list, set by the first one.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Point,
    Points,
}

/// Buffer for a point or a list of points. It is reused, so that a thousand points need only a few allocations.
#[derive(Default)]
struct Entry {
    values: Vec<f64>,
    /// Number of coordinates of its first point.
    width: usize,
    /// Number of points, if it is a list of points.
    points: Option<usize>,
    faults: Vec<(String, String)>,
    not_a_list: Option<String>,
    /// Whether it is null.
    missing: bool,
    /// Whether it has more points than are kept.
    cut: bool,
}

impl Entry {
    fn clear(&mut self) {
        self.values.clear();
        self.faults.clear();
        (self.width, self.points, self.not_a_list) = (0, None, None);
        (self.missing, self.cut) = (false, false);
    }

    fn fault(&mut self, pointer: String, detail: String) {
        if self.faults.len() < MAX_FAULTS {
            self.faults.push((pointer, detail));
        }
    }

    /// Adds the coordinate at index `place` of a point.
    fn coordinate(&mut self, place: usize, pointer: impl Fn() -> String, value: Value) {
        if self.cut || place >= MAX_WIDTH {
            return;
        }
        let found = match value {
            Value::Number(value) if value.is_finite() && value.abs() <= MAX_COORDINATE => Ok(value),
            Value::Number(value) => {
                Err(format!("expected a number within ±{MAX_COORDINATE:e}, got {value:e}"))
            }
            Value::Other(what) => Err(format!("expected a number, got {what}")),
        };
        self.values.push(*found.as_ref().unwrap_or(&0.0));
        if let Err(detail) = found {
            self.fault(pointer(), detail);
        }
    }

    /// Adds the point just read, which has `width` coordinates.
    fn point(&mut self, width: usize) {
        let position = self.points.unwrap_or(0);
        self.points = Some(position + 1);
        self.cut |= position >= bounds::current().points;
        if position == 0 {
            self.width = width;
        } else if width != self.width {
            let detail = format!("expected {} coordinates, as in the first point, got {width}", self.width);
            self.fault(format!("/{position}"), detail);
        }
    }
}

/// Reads an entry, of a given kind if that is known.
struct EntrySeed<'a>(&'a mut Entry, Option<Kind>);

impl<'de> serde::de::DeserializeSeed<'de> for EntrySeed<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        self.0.clear();
        deserializer.deserialize_any(self)
    }
}

/// Position of the entry that a fault is about.
fn position_of(fault: &Fault) -> Option<u32> {
    fault.pointer.split('/').nth(1)?.parse().ok()
}

fn missing(seed: EntrySeed<'_>, what: &'static str) {
    seed.0.missing = true;
    not_a_list(seed, what);
}

fn not_a_list(seed: EntrySeed<'_>, what: &'static str) {
    seed.0.not_a_list = Some(format!("expected a list of coordinates, got {what}"));
}

impl<'de> Visitor<'de> for EntrySeed<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of coordinates")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<(), A::Error> {
        let (Self(entry, mut kind), mut column) = (self, 0);
        loop {
            let seed = ElementSeed { entry, kind, column };
            let Some(element) = next_entry_by(&mut elements, column, seed)? else { break };
            match element {
                Element::Point => kind = Some(Kind::Points),
                Element::Coordinate(_) if kind == Some(Kind::Points) => {
                    entry.fault(format!("/{column}"), "expected a point, as in the entries before".into());
                }
                Element::Coordinate(value) => {
                    kind = Some(Kind::Point);
                    entry.coordinate(column, || format!("/{column}"), value);
                    entry.width += 1;
                }
            }
            column += 1;
        }
        Ok(())
    }

    visit_others!(@text not_a_list, ());
    visit_others!(@null missing, ());
    visit_others!(@number not_a_list, ());
    visit_others!(@map not_a_list, ());
}

/// Element of an entry.
enum Element {
    Coordinate(Value),
    /// A point, which is already in the entry.
    Point,
}

/// Reads a coordinate of an entry, or one of its points, at an index.
struct ElementSeed<'a> {
    entry: &'a mut Entry,
    kind: Option<Kind>,
    column: usize,
}

impl<'de> serde::de::DeserializeSeed<'de> for ElementSeed<'_> {
    type Value = Element;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Element, D::Error> {
        deserializer.deserialize_any(self)
    }
}

fn other(_: ElementSeed<'_>, what: &'static str) -> Element {
    Element::Coordinate(Value::Other(what))
}

impl<'de> Visitor<'de> for ElementSeed<'_> {
    type Value = Element;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a point")
    }

    fn visit_f64<E>(self, value: f64) -> Result<Element, E> {
        Ok(Element::Coordinate(Value::Number(value)))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Element, E> {
        Ok(Element::Coordinate(Value::Number(value as f64)))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Element, E> {
        Ok(Element::Coordinate(Value::Number(value as f64)))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut coordinates: A) -> Result<Element, A::Error> {
        let Self { entry, kind, column } = self;
        // Among numbers, a list is not a point.
        if kind == Some(Kind::Point) {
            skip_list(&mut coordinates)?;
            return Ok(Element::Coordinate(Value::Other("a list")));
        }
        let mut width = 0;
        while let Some(value) = next_entry::<Value, _>(&mut coordinates, width)? {
            entry.coordinate(width, || format!("/{column}/{width}"), value);
            width += 1;
        }
        entry.point(width);
        Ok(Element::Point)
    }

    visit_others!(@text other, Element);
    visit_others!(@null other, Element);
    visit_others!(@map other, Element);
}

/// A value where a number is expected.
enum Value {
    Number(f64),
    Other(&'static str),
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValueVisitor;
        impl<'de> Visitor<'de> for ValueVisitor {
            type Value = Value;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
                Ok(Value::Number(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
                Ok(Value::Number(value as f64))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
                Ok(Value::Number(value as f64))
            }

            visit_others!(@text not_a_number, Value);
            visit_others!(@null not_a_number, Value);
            visit_others!(@seq not_a_number, Value);
            visit_others!(@map not_a_number, Value);
        }
        fn not_a_number(_: ValueVisitor, what: &'static str) -> Value {
            Value::Other(what)
        }
        deserializer.deserialize_any(ValueVisitor)
    }
}

/// Tangents at the poles of a sphere.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PolesInput {
    /// Tangents at the pole `v = 0`.
    #[serde(default)]
    pub north: Option<PoleInput>,
    /// Tangents at the pole `v = 1`.
    #[serde(default)]
    pub south: Option<PoleInput>,
}

/// Tangents at one pole.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PoleInput {
    /// Vectors `T_1`, `T_2` of `σ_v = T_1 cos 2πu + T_2 sin 2πu`.
    pub tangents: [[f64; 3]; 2],
}

/// Control points of a finer grid that are moved from where the coarse control points of a shape have them.
#[derive(Debug, Clone, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BlockInput {
    /// Numbers of parts of an interval between knots: one for curves, those along `u` and `v` for surfaces.
    #[schema(min_items = 1, max_items = 2)]
    pub factors: Vec<usize>,
    /// Indices of the control points on the finer grid, in ascending order.
    pub indices: Vec<usize>,
    /// Their offsets, in the unit of the points.
    #[schema(value_type = Vec<Vec<f64>>)]
    pub offsets: PointList,
    /// Set by the service. Ignored in a request, so that a shape can be posted as it was answered.
    #[serde(default)]
    #[schema(value_type = Option<Vec<Vec<f64>>>)]
    pub control_points: Option<Ignored>,
}

document! {
    /// A shape with its attributes.
    pub struct ShapeInput {
        /// Points on the shape, one list of coordinates each; for surfaces a grid `[u][v]` of points.
        #[schema(value_type = Option<PointsOrGrid>)]
        points: Box<PointList>;
        /// Control points in the representation, in place of `points`.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        control_points: Box<PointList>;
        /// Normals at the points, of any length, for the subdivision scheme `normal_based`.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        normals: Box<PointList>;
        /// The part that is seen, where `assess` takes shapes with missing parts: true or false for each control point, or arcs
        /// `[from, to]` of a curve, forwards in its parameter. Points that are null are missing too. Default: the whole shape.
        #[schema(value_type = Option<Vec<ObservedEntry>>)]
        observed: Box<Checked<Option<Observed>, LARGE>>;
        /// Tangents at the poles of a sphere given by `points`. Default: estimated.
        #[schema(value_type = Option<PolesInput>)]
        poles: Box<Checked<PolesInput>>;
        /// Control points of finer grids with their offsets, where `evaluate`, `measure`, `refine` and `deform` take shapes of several
        /// resolutions.
        #[schema(value_type = Option<Vec<BlockInput>>)]
        blocks: Box<Checked<Option<Vec<BlockInput>>, LARGE>>;
        /// Identifier assigned by the client, unique in a cohort.
        #[schema(value_type = Option<String>)]
        external_id: Checked<Option<String>>;
        /// Opaque identifier of the subject; never a name.
        #[schema(value_type = Option<String>)]
        subject: Checked<Option<String>>;
        /// Class label.
        #[schema(value_type = Option<String>)]
        label: Checked<Option<String>>;
        /// Additional attributes: strings, numbers or Booleans.
        #[schema(value_type = Option<Attributes>)]
        labels: Raw;
        /// Positive weight in means. Default: 1.
        #[schema(value_type = Option<f64>, minimum = 1e-100, maximum = 1e100)]
        weight: Checked<Option<f64>>;
        /// Arbitrary client data, stored with the shape.
        #[schema(value_type = serde_json::Value, required = false)]
        metadata: Box<Metadata>;
        /// Whether the contour is closed; must agree with the representation.
        #[schema(value_type = Option<bool>)]
        closed: Checked<Option<bool>>;
        /// Positions of homologous points, kept with the metadata.
        #[schema(value_type = Option<Vec<usize>>)]
        landmark_index: Box<Metadata>;
        /// Coordinates of homologous points, kept with the metadata.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        landmarks: Box<Metadata>;
        /// Set by the service. Ignored in a request, so that a shape can be posted as it was read.
        #[schema(value_type = Option<String>)]
        id: Ignored;
        /// Set by the service. Ignored in a request, so that a shape can be posted as it was read.
        #[schema(value_type = Option<String>)]
        created_at: Ignored;
        /// Set by the service. Ignored in a request, so that a shape can be posted as it was read.
        #[schema(value_type = Option<serde_json::Value>)]
        measures: Ignored;
    }
}

impl ShapeInput {
    /// Whether a part of the shape is missing: it has null points, or lists the seen part.
    pub fn has_missing_parts(&self) -> bool {
        let lists = [self.points.as_deref(), self.control_points.as_deref()];
        let says = self.observed.as_ref().is_some_and(|observed| observed.get() != Some(&None));
        says || lists.into_iter().flatten().any(PointList::has_gaps)
    }

    /// The blocks of a shape of several resolutions that were read; none if it has no such.
    pub fn blocks(&self) -> &[BlockInput] {
        let blocks = self.blocks.as_ref().and_then(|blocks| blocks.get());
        blocks.and_then(Option::as_deref).unwrap_or_default()
    }

    /// Whether the shape has a list of blocks, or something in its place.
    pub fn has_blocks(&self) -> bool {
        self.blocks.as_ref().is_some_and(|blocks| !matches!(blocks.get(), Some(None)))
    }

    /// The same attributes without geometry, and without landmarks of it.
    #[must_use]
    pub fn without_geometry(&self) -> Self {
        let Self { external_id, subject, label, labels, weight, metadata, .. } = self.clone();
        Self { external_id, subject, label, labels, weight, metadata, ..Self::default() }
    }
}

document! {
    /// Attributes of a shape that is made by the service.
    pub struct ObjectInput {
        /// Identifier assigned by the client, unique in a cohort.
        #[schema(value_type = Option<String>)]
        external_id: Checked<Option<String>>;
        /// Opaque identifier of the subject; never a name.
        #[schema(value_type = Option<String>)]
        subject: Checked<Option<String>>;
        /// Class label.
        #[schema(value_type = Option<String>)]
        label: Checked<Option<String>>;
        /// Additional attributes: strings, numbers or Booleans.
        #[schema(value_type = Option<Attributes>)]
        labels: Raw;
        /// Positive weight in means. Default: 1.
        #[schema(value_type = Option<f64>, minimum = 1e-100, maximum = 1e100)]
        weight: Checked<Option<f64>>;
        /// Arbitrary client data, stored with the shape.
        #[schema(value_type = serde_json::Value, required = false)]
        metadata: Box<Metadata>;
    }
}

impl From<ObjectInput> for ShapeInput {
    fn from(object: ObjectInput) -> Self {
        let ObjectInput { external_id, subject, label, labels, weight, metadata, faults } = object;
        Self { external_id, subject, label, labels, weight, metadata, faults, ..Self::default() }
    }
}

/// Points in a response: one list of coordinates each, or a grid of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    dimension: usize,
    coordinates: Vec<f64>,
    /// Number of points per list, if it is a grid.
    columns: Option<usize>,
}

/// Types of fields, for the document.
#[cfg(feature = "schema")]
pub use described::{Attributes, PointsOrGrid};

#[cfg(feature = "schema")]
mod described {
    use utoipa::openapi::RefOr;
    use utoipa::openapi::schema::{AnyOfBuilder, ObjectBuilder, Schema, SchemaType, Type};
    use utoipa::{PartialSchema, ToSchema};

    use super::Points;

    impl PartialSchema for Points {
        fn schema() -> RefOr<Schema> {
            <Vec<Vec<f64>> as PartialSchema>::schema()
        }
    }

    impl ToSchema for Points {}

    /// Points or vectors that may be on a grid, for the OpenAPI document.
    #[derive(Debug)]
    pub struct PointsOrGrid;

    impl PartialSchema for PointsOrGrid {
        fn schema() -> RefOr<Schema> {
            // No points are a list and a grid at once, so one of them would be too strict.
            AnyOfBuilder::new()
                .item(<Vec<Vec<f64>> as PartialSchema>::schema())
                .item(<Vec<Vec<Vec<f64>>> as PartialSchema>::schema())
                .description(Some("Points: one list of coordinates each, or a grid `[u][v]` of them."))
                .examples([serde_json::json!([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])])
                .into()
        }
    }

    impl ToSchema for PointsOrGrid {}

    /// Attributes of a shape, for the OpenAPI document.
    #[derive(Debug)]
    pub struct Attributes;

    impl PartialSchema for Attributes {
        fn schema() -> RefOr<Schema> {
            let types = [Type::String, Type::Number, Type::Boolean, Type::Null];
            ObjectBuilder::new()
                .additional_properties(Some(ObjectBuilder::new().schema_type(SchemaType::from_iter(types))))
                .description(Some("Attributes by name: strings, numbers or Booleans."))
                .into()
        }
    }

    impl ToSchema for Attributes {}
}

impl Points {
    /// Points from `d·N` coordinate-major numbers.
    pub fn from_columns(coordinates: Vec<f64>, dimension: usize) -> Self {
        Self { dimension, coordinates, columns: None }
    }

    /// The same points as a grid with `columns` points per list, or as one list without `columns`.
    pub fn in_grid(self, columns: Option<usize>) -> Self {
        Self { columns: columns.filter(|columns| *columns > 0), ..self }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.coordinates.len() / self.dimension.max(1)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Coordinates of point `k`.
    pub fn row(&self, k: usize) -> Vec<f64> {
        let n = self.len();
        (0..self.dimension).map(|c| self.coordinates[c * n + k]).collect()
    }
}

impl Serialize for Points {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        struct RowView<'a>(&'a Points, usize);
        impl Serialize for RowView<'_> {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let n = self.0.len();
                serializer.collect_seq((0..self.0.dimension).map(|c| self.0.coordinates[c * n + self.1]))
            }
        }
        struct ListView<'a>(&'a Points, std::ops::Range<usize>);
        impl Serialize for ListView<'_> {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_seq(self.1.clone().map(|k| RowView(self.0, k)))
            }
        }
        match self.columns {
            None => ListView(self, 0..self.len()).serialize(serializer),
            Some(columns) => serializer.collect_seq(
                (0..self.len() / columns).map(|i| ListView(self, i * columns..(i + 1) * columns)),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> PointList {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn rows_become_flat_numbers() {
        let list = read("[[1, 2.5], [-3e1, 4]]");
        assert_eq!(list.checked(2).unwrap(), &[1.0, 2.5, -30.0, 4.0]);
        assert_eq!(list.len(), 2);
        assert!(list.checked(3).is_err());
    }

    #[test]
    fn every_fault_is_named() {
        let faults = read(r#"[[1, 2], [3], [4, "x"], null, {"a": [1]}, [5, 1e101], [6, [7]], 8]"#)
            .checked(2)
            .unwrap_err();
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/1", "/2/1", "/3", "/4", "/5/1", "/6/1", "/7"]);
    }

    #[test]
    fn points_beyond_those_of_a_shape_are_counted() {
        let limits = bounds::Bounds { points: 4, ..bounds::Bounds::default() };
        let read = |text: &str| bounds::within(limits, || read(text));
        for (text, found) in
            [("[[0, 1]]", 4), ("[[0, 1]]", 5), ("[[[0, 1], [2, 3]]]", 4), ("[[[0, 1], [2, 3]]]", 6)]
        {
            let columns = text.matches("],").count() + 1;
            let entry = &text[1..text.len() - 1];
            let list = read(&format!("[{}]", vec![entry; found / columns].join(",")));
            assert_eq!(list.len(), found, "{text}");
            assert_eq!(list.checked(2).is_ok(), found <= 4, "{text}");
            assert!(list.coordinates.len() <= 8, "{text} {}", list.coordinates.len());
        }
        let wide = read("[[0,0,0,0,0,0,0,0,0]]");
        assert_eq!((wide.width(), wide.coordinates.len()), (9, 3));
        let row = read(&format!("[[{}]]", vec!["[1,2]"; 50].join(",")));
        assert!(row.checked(2).is_err() && row.coordinates.is_empty());
    }

    #[test]
    fn a_shape_of_nothing_is_small() {
        assert!(size_of::<ShapeInput>() <= 336, "{}", size_of::<ShapeInput>());
    }

    #[test]
    fn faults_are_bounded() {
        let text = format!("[{}]", vec!["7"; 1000].join(","));
        assert_eq!(read(&text).checked(2).unwrap_err().len(), MAX_FAULTS);
    }

    #[test]
    fn missing_points_are_gaps_or_one_fault() {
        let list = read("[null, [1, 2], null, null, [3, 4], null]");
        let rows = [None, Some(vec![1.0, 2.0]), None, None, Some(vec![3.0, 4.0]), None];
        assert_eq!((list.len(), list.has_gaps(), list.with_gaps(2).unwrap()), (6, true, rows.to_vec()));
        let faults = list.checked(2).unwrap_err();
        let detail = "expected a list of coordinates, got null, as in 3 further entries";
        assert_eq!(faults, [Fault::new("/0", detail)]);
        assert_eq!(list.with_gaps(3).unwrap_err()[0].pointer, "/0");
        let pointers = |text: &str| {
            let faults = read(text).with_gaps(2).err().unwrap_or_default();
            faults.into_iter().map(|fault| fault.pointer).collect::<Vec<String>>()
        };
        assert_eq!(pointers("[[1, 2], null, [3], null, 4]"), ["/2", "/4"]);
        // Grids have no missing points, also where one comes first.
        assert_eq!(pointers("[[[1, 2], [3, 4]], null]"), ["/1"]);
        assert_eq!(read("[null, [[1, 2], [3, 4]]]").checked(2).unwrap_err()[0].pointer, "/0");
        assert_eq!(pointers("[null, null]"), [""; 0]);
        let limits = bounds::Bounds { points: 2, ..bounds::Bounds::default() };
        let cut = bounds::within(limits, || read("[null, null, null]"));
        assert_eq!(cut.with_gaps(2).unwrap_err()[0].detail, "expected at most 2 points, got 3");
    }

    #[test]
    fn grids_are_flattened_and_ragged_ones_named() {
        let grid = read("[[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [10, 11, 12]], [[0, 0, 0], [1, 1, 1]]]");
        assert_eq!(grid.grid(), Some([3, 2]));
        assert_eq!(grid.len(), 6);
        assert_eq!(grid.checked(3).unwrap()[9..12], [10.0, 11.0, 12.0]);
        assert_eq!(grid.checked(2).unwrap_err()[0].pointer, "/0/0");
        let faults = read(
            r#"[[[1, 2], [3, 4]], [[1, 2]], [[1, 2], [3]], [1, 2], [[1, "x"], 5], [[1, 2], [1, [2]]], []]"#,
        )
        .checked(2)
        .unwrap_err();
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/1", "/2/1", "/3/0", "/3/1", "/4/0/1", "/4/1", "/4", "/5/1/1", "/6"]);
    }

    #[test]
    fn points_come_back_as_rows() {
        let points = Points::from_columns(vec![1.0, 2.0, 3.0, 4.0], 2);
        assert_eq!(serde_json::to_string(&points).unwrap(), "[[1.0,3.0],[2.0,4.0]]");
        assert_eq!(serde_json::to_string(&points.in_grid(Some(1))).unwrap(), "[[[1.0,3.0]],[[2.0,4.0]]]");
    }
}
