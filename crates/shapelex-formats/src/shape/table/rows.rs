//! Records to batches of rows.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use arrow_array::builder::{BooleanBuilder, Float64Builder, Int32Builder, Int64Builder, StringBuilder};
use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, ArrayRef, Float64Array, Int32Array, ListArray, RecordBatch};
use arrow_buffer::{BooleanBuffer, NullBuffer, OffsetBuffer, ScalarBuffer};
use arrow_schema::{DataType, Field, Schema, SchemaRef};

use super::super::options::WriteOptions;
use super::super::record::{Domain, Field as MeshField, Geometry, Mesh, Points, Record};
use super::super::text::name_fits;
use super::columns::{FIELDS, FieldNote, LABELS, PREFIX, SCHEMA, unwritten};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::unit::Unit;
use crate::value::Value;

/// Largest number of rows of a batch.
pub(super) const ROWS: usize = 8192;
/// Number of bytes at which a batch ends.
const BYTES: usize = 8 << 20;
/// Number of cells of attributes at which a batch ends: rows have a cell for each name, also those without the attribute.
const CELLS: usize = 1 << 21;
/// Most columns of attributes, and of fields: every row has a cell in each.
const COLUMNS: usize = 1024;

const POINTS: &str = "points";
const VERTICES: &str = "vertices";

/// Lists of one column, one after the other.
struct Lists<T> {
    values: Vec<T>,
    ends: Vec<i32>,
    valid: Vec<bool>,
}

impl<T> Default for Lists<T> {
    fn default() -> Self {
        Self { values: Vec::new(), ends: vec![0], valid: Vec::new() }
    }
}

impl<T: Copy> Lists<T> {
    /// Adds a list, or none.
    fn push(&mut self, list: Option<&[T]>, place: &Place) -> Result<(), FileError> {
        self.values.extend_from_slice(list.unwrap_or_default());
        self.valid.push(list.is_some());
        let end = i32::try_from(self.values.len()).map_err(|_| {
            let detail = format!("expected at most {} numbers of a shape, got more", i32::MAX);
            FileError::too_large(place.clone(), detail)
        })?;
        self.ends.push(end);
        Ok(())
    }

    fn array(self, item: DataType, values: impl FnOnce(Vec<T>) -> ArrayRef) -> ArrayRef {
        let nulls = self.valid.contains(&false).then(|| NullBuffer::from(self.valid));
        let offsets = OffsetBuffer::new(ScalarBuffer::from(self.ends));
        Arc::new(ListArray::new(item_field(item), offsets, values(self.values), nulls))
    }
}

fn item_field(item: DataType) -> Arc<Field> {
    Arc::new(Field::new("item", item, true))
}

fn list(item: DataType) -> DataType {
    DataType::List(item_field(item))
}

/// Doubles; NaN is null.
fn doubles(values: Vec<f64>) -> ArrayRef {
    let nulls = values
        .iter()
        .any(|value| value.is_nan())
        .then(|| NullBuffer::from(values.iter().map(|value| !value.is_nan()).collect::<BooleanBuffer>()));
    Arc::new(Float64Array::new(values.into(), nulls))
}

fn integers(values: Vec<i32>) -> ArrayRef {
    Arc::new(Int32Array::from(values))
}

/// The columns of attributes and fields, which follow from the first rows.
struct Layout {
    schema: SchemaRef,
    /// Attributes with separate columns, each with a value of its type, sorted by name.
    labels: Vec<(String, Value)>,
    fields: Vec<(String, FieldNote)>,
}

/// Rows that are collected until there are enough for a batch.
pub(super) struct Rows {
    metadata: HashMap<String, String>,
    /// Unit of all shapes: the one that is stated, else that of the first shape.
    unit: Option<Unit>,
    layout: Option<Layout>,
    columns: Columns,
    /// Memory of batches that were written, for the next ones.
    spare: Vec<Vec<f64>>,
    /// Items left out.
    pub(super) summary: Summary,
}

#[derive(Default)]
struct Columns {
    external_id: StringBuilder,
    subject: StringBuilder,
    label: StringBuilder,
    weight: Float64Builder,
    closed: BooleanBuilder,
    dimension: Int32Builder,
    points: Lists<f64>,
    vertices: Lists<f64>,
    faces: Lists<i32>,
    face_sizes: Lists<i32>,
    ring_object: Int64Builder,
    ring_part: Int64Builder,
    ring_hole: BooleanBuilder,
    labels: Vec<BTreeMap<String, Value>>,
    /// Names of the labels.
    names: BTreeSet<String>,
    fields: Vec<BTreeMap<String, MeshField>>,
    metadata: StringBuilder,
    places: Vec<Place>,
    bytes: usize,
}

impl Rows {
    /// No rows yet.
    pub(super) fn new(options: &WriteOptions) -> Self {
        let mut metadata: HashMap<String, String> = HashMap::new();
        for (name, value) in &options.facts {
            metadata.insert(format!("{PREFIX}{name}"), value.clone());
        }
        if let Some(unit) = &options.unit {
            metadata.insert(format!("{PREFIX}unit"), unit.clone());
        }
        metadata.insert(format!("{PREFIX}schema"), SCHEMA.into());
        Self {
            metadata,
            unit: options.unit.as_deref().and_then(Unit::find),
            layout: None,
            columns: Columns::default(),
            spare: Vec::new(),
            summary: Summary::default(),
        }
    }

    /// Adds a row. Returns a batch when there are enough of them.
    ///
    /// # Errors
    /// Fourier coefficients, numbers that 32 bits do not hold, a length among shapes that have none and the other way round.
    pub(super) fn push(&mut self, record: &Record) -> Result<Option<RecordBatch>, FileError> {
        match (self.unit, record.unit) {
            (Some(unit), Some(from)) if from != unit => {
                self.columns.push(&record.clone().converted(from, unit)?)?;
            }
            (None, Some(unit)) if self.summary.records == 0 => {
                self.unit = Some(unit);
                self.metadata.entry(format!("{PREFIX}unit")).or_insert_with(|| unit.word().into());
                self.columns.push(record)?;
            }
            _ => self.columns.push(record)?,
        }
        self.summary.records += 1;
        let rows = self.columns.labels.len();
        let names = self.columns.names.len().min(COLUMNS);
        let wide = self.layout.as_ref().map_or(names, |layout| layout.labels.len());
        let full = rows >= ROWS || self.columns.bytes >= BYTES || rows * wide >= CELLS;
        if full { self.take().map(Some) } else { Ok(None) }
    }

    /// The rows that are left, perhaps none.
    ///
    /// # Errors
    /// None that the columns of this module can cause.
    pub(super) fn take(&mut self) -> Result<RecordBatch, FileError> {
        let columns = std::mem::take(&mut self.columns);
        let next = &mut self.columns;
        let numbers = if columns.points.values.is_empty() {
            &mut next.vertices.values
        } else {
            &mut next.points.values
        };
        *numbers = self.spare.pop().unwrap_or_default();
        let layout = self.layout.get_or_insert_with(|| Layout::new(&columns, &self.metadata));
        columns.batch(layout, &mut self.summary)
    }

    /// Takes back the memory of a batch that was written. New memory would take longer to get than its numbers to write.
    pub(super) fn reuse(&mut self, batch: RecordBatch) {
        let numbers = |name: &str| Some(batch.column_by_name(name)?.as_list_opt::<i32>()?.values().clone());
        let largest = [POINTS, VERTICES].into_iter().filter_map(numbers).max_by_key(|numbers| numbers.len());
        drop(batch);
        let Some(numbers) = largest else { return };
        let Some(buffer) = numbers.as_primitive_opt::<Float64Type>().map(|n| n.values().inner().clone())
        else {
            return;
        };
        drop(numbers);
        if let Ok(mut numbers) = buffer.into_vec::<f64>() {
            numbers.clear();
            self.spare.push(numbers);
        }
    }

    /// Whether there are no rows that were not taken.
    pub(super) fn is_empty(&self) -> bool {
        self.columns.labels.is_empty()
    }
}

impl Layout {
    fn new(columns: &Columns, metadata: &HashMap<String, String>) -> Self {
        let (labels, fields) = (label_types(&columns.labels), field_notes(&columns.fields));
        let text = || DataType::Utf8;
        let mut schema: Vec<Field> = [
            ("external_id", text()),
            ("subject", text()),
            ("label", text()),
            ("weight", DataType::Float64),
            ("closed", DataType::Boolean),
            ("dimension", DataType::Int32),
            (POINTS, list(DataType::Float64)),
            (VERTICES, list(DataType::Float64)),
            ("faces", list(DataType::Int32)),
            ("face_sizes", list(DataType::Int32)),
            ("ring_object", DataType::Int64),
            ("ring_part", DataType::Int64),
            ("ring_hole", DataType::Boolean),
        ]
        .map(|(name, kind)| Field::new(name, kind, true))
        .into();
        schema.extend(labels.iter().map(|(name, value)| {
            let kind = match value {
                Value::Bool(_) => DataType::Boolean,
                Value::Number(_) => DataType::Float64,
                Value::Text(_) => text(),
            };
            Field::new(format!("{LABELS}{name}"), kind, true)
        }));
        schema.extend(
            fields
                .iter()
                .map(|(name, _)| Field::new(format!("{FIELDS}{name}"), list(DataType::Float64), true)),
        );
        schema.extend([Field::new("more_labels", text(), true), Field::new("metadata", text(), true)]);
        let mut metadata = metadata.clone();
        if !fields.is_empty() {
            let notes: BTreeMap<_, _> = fields.iter().cloned().collect();
            // Maps of texts and numbers are JSON.
            metadata.insert(format!("{PREFIX}fields"), serde_json::to_string(&notes).unwrap_or_default());
        }
        Self { schema: Arc::new(Schema::new_with_metadata(schema, metadata)), labels, fields }
    }
}

/// Whether a column may have this name behind its prefix: longer ones are not read.
fn fits(prefix: &str, name: &str) -> bool {
    name_fits(&format!("{prefix}{name}")).is_ok()
}

/// Attributes of the first rows that have one type in all of them and a short name, as many as have a column.
fn label_types(rows: &[BTreeMap<String, Value>]) -> Vec<(String, Value)> {
    let mut found: BTreeMap<&String, Option<&Value>> = BTreeMap::new();
    for (name, value) in rows.iter().flatten() {
        let first = found.entry(name).or_insert(Some(value));
        if first.is_some_and(|first| std::mem::discriminant(first) != std::mem::discriminant(value)) {
            *first = None;
        }
    }
    let short = found.into_iter().filter(|(name, _)| fits(LABELS, name));
    short.filter_map(|(name, value)| Some((name.clone(), value?.clone()))).take(COLUMNS).collect()
}

/// Fields of the first rows with short names, as the first mesh has them.
fn field_notes(rows: &[BTreeMap<String, MeshField>]) -> Vec<(String, FieldNote)> {
    let mut found = BTreeMap::new();
    for (name, field) in rows.iter().flatten().filter(|(name, _)| fits(FIELDS, name)) {
        found.entry(name.clone()).or_insert_with(|| note_of(field));
    }
    found.into_iter().take(COLUMNS).collect()
}

fn note_of(field: &MeshField) -> FieldNote {
    let on = match field.domain {
        Domain::Vertices => "vertices",
        Domain::Faces => "faces",
    };
    FieldNote { on: on.into(), width: field.width }
}

impl Columns {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let place = &record.place;
        self.push_geometry(&record.geometry, place)?;
        self.external_id.append_option(record.name.as_deref());
        self.subject.append_option(record.subject.as_deref());
        self.label.append_option(record.label.as_deref());
        self.weight.append_option(record.weight);
        let ring = record.ring.as_ref();
        let integer = |number: u64| {
            i64::try_from(number).map_err(|_| {
                FileError::too_large(
                    place.clone(),
                    format!("expected positions of rings below 2⁶³, got {number}"),
                )
            })
        };
        self.ring_object.append_option(ring.map(|ring| integer(ring.object)).transpose()?);
        self.ring_part.append_option(ring.map(|ring| integer(ring.part)).transpose()?);
        self.ring_hole.append_option(ring.map(|ring| ring.hole));
        let new = record.labels.keys().filter(|name| !self.names.contains(*name));
        let new: Vec<String> = new.cloned().collect();
        self.names.extend(new);
        self.labels.push(record.labels.clone());
        if record.metadata.is_empty() {
            self.metadata.append_null();
        } else {
            self.metadata.append_value(serde_json::to_string(&record.metadata).map_err(unwritten)?);
        }
        self.places.push(place.clone());
        self.bytes += record.bytes();
        Ok(())
    }

    fn push_geometry(&mut self, geometry: &Geometry, place: &Place) -> Result<(), FileError> {
        let none = Mesh::default();
        let (points, closed, mesh) = match geometry {
            Geometry::Curve { points, closed } => (Some(points), Some(*closed), &none),
            Geometry::Landmarks(points) => (Some(points), None, &none),
            Geometry::Mesh(mesh) => (None, None, mesh),
            Geometry::Fourier(_) => {
                let detail = "expected curves, landmarks or meshes in a table, got Fourier coefficients";
                return Err(FileError::unsupported(place.clone(), detail));
            }
        };
        let is_mesh = points.is_none();
        let dimension = points.unwrap_or(&mesh.vertices).dimension();
        let dimension = i32::try_from(dimension).map_err(|_| {
            FileError::too_large(place.clone(), format!("expected a smaller dimension, got {dimension}"))
        })?;
        let (faces, sizes) = flat_faces(mesh, place)?;
        self.closed.append_option(closed);
        self.dimension.append_value(dimension);
        self.points.push(points.map(Points::coordinates), place)?;
        self.vertices.push(is_mesh.then(|| mesh.vertices.coordinates()), place)?;
        self.faces.push(is_mesh.then_some(&faces), place)?;
        self.face_sizes.push(sizes.as_deref(), place)?;
        self.fields.push(mesh.fields.clone());
        Ok(())
    }

    fn batch(self, layout: &Layout, summary: &mut Summary) -> Result<RecordBatch, FileError> {
        let Self { labels, fields, places, .. } = self;
        let (labels, more) = label_columns(&labels, layout)?;
        let fields = field_columns(&fields, &places, layout, summary)?;
        let Self { mut external_id, mut subject, mut label, mut metadata, .. } = self;
        let Self { mut weight, mut closed, mut dimension, .. } = self;
        let Self { mut ring_object, mut ring_part, mut ring_hole, .. } = self;
        let mut arrays: Vec<ArrayRef> = vec![
            Arc::new(external_id.finish()),
            Arc::new(subject.finish()),
            Arc::new(label.finish()),
            Arc::new(weight.finish()),
            Arc::new(closed.finish()),
            Arc::new(dimension.finish()),
            self.points.array(DataType::Float64, doubles),
            self.vertices.array(DataType::Float64, doubles),
            self.faces.array(DataType::Int32, integers),
            self.face_sizes.array(DataType::Int32, integers),
            Arc::new(ring_object.finish()),
            Arc::new(ring_part.finish()),
            Arc::new(ring_hole.finish()),
        ];
        arrays.extend(labels);
        arrays.extend(fields);
        arrays.extend([more, Arc::new(metadata.finish()) as ArrayRef]);
        RecordBatch::try_new(Arc::clone(&layout.schema), arrays).map_err(unwritten)
    }
}

/// Indices of the corners of all faces, and the number of corners of each unless all are triangles.
fn flat_faces(mesh: &Mesh, place: &Place) -> Result<(Vec<i32>, Option<Vec<i32>>), FileError> {
    let index = |vertex: &u32| {
        i32::try_from(*vertex).map_err(|_| {
            let detail = format!("expected indices of vertices up to {}, got {vertex}", i32::MAX);
            FileError::too_large(place.clone(), detail)
        })
    };
    let faces = mesh.faces.iter().flatten().map(index).collect::<Result<Vec<_>, _>>()?;
    if mesh.faces.iter().all(|face| face.len() == 3) {
        return Ok((faces, None));
    }
    // A face has no more corners than `faces`, whose length is checked when the list is added.
    let sizes = mesh.faces.iter().map(|face| i32::try_from(face.len()).unwrap_or(i32::MAX)).collect();
    Ok((faces, Some(sizes)))
}

/// The columns of attributes, and that of the others.
fn label_columns(
    rows: &[BTreeMap<String, Value>],
    layout: &Layout,
) -> Result<(Vec<ArrayRef>, ArrayRef), FileError> {
    let column = |(name, kind): &(String, Value)| -> ArrayRef {
        let values = rows.iter().map(|row| row.get(name));
        match kind {
            Value::Bool(_) => {
                let value = |value: Option<&Value>| {
                    if let Some(Value::Bool(yes)) = value { Some(*yes) } else { None }
                };
                Arc::new(values.map(value).collect::<arrow_array::BooleanArray>())
            }
            Value::Number(_) => {
                let value =
                    |value: Option<&Value>| if let Some(Value::Number(x)) = value { Some(*x) } else { None };
                Arc::new(values.map(value).collect::<Float64Array>())
            }
            Value::Text(_) => {
                fn value(value: Option<&Value>) -> Option<&str> {
                    if let Some(Value::Text(text)) = value { Some(text) } else { None }
                }
                Arc::new(values.map(value).collect::<arrow_array::StringArray>())
            }
        }
    };
    let has_column = |name: &str, value: &Value| {
        let found = layout.labels.binary_search_by(|(column, _)| column.as_str().cmp(name));
        found.is_ok_and(|at| std::mem::discriminant(&layout.labels[at].1) == std::mem::discriminant(value))
    };
    let mut more = StringBuilder::new();
    for row in rows {
        let others: BTreeMap<_, _> = row.iter().filter(|(name, value)| !has_column(name, value)).collect();
        if others.is_empty() {
            more.append_null();
        } else {
            more.append_value(serde_json::to_string(&others).map_err(unwritten)?);
        }
    }
    Ok((layout.labels.iter().map(column).collect(), Arc::new(more.finish())))
}

/// The columns of fields. Fields that the first rows do not have, or have with other carriers, are left out and counted.
fn field_columns(
    rows: &[BTreeMap<String, MeshField>],
    places: &[Place],
    layout: &Layout,
    summary: &mut Summary,
) -> Result<Vec<ArrayRef>, FileError> {
    for (row, place) in rows.iter().zip(places) {
        for (name, field) in row {
            if !layout.fields.contains(&(name.clone(), note_of(field))) {
                let what = match layout.fields.len() {
                    _ if !fits(FIELDS, name) => "fields with names that are too long for a column",
                    COLUMNS => "fields beside the 1024 that have a column",
                    _ => "fields that the first meshes do not have",
                };
                summary.drop(what, Some(name), || place.clone());
            }
        }
    }
    let column = |(name, note): &(String, FieldNote)| {
        let mut lists = Lists::default();
        for (row, place) in rows.iter().zip(places) {
            let field = row.get(name).filter(|field| note_of(field) == *note);
            lists.push(field.map(|field| field.values.as_slice()), place)?;
        }
        Ok(lists.array(DataType::Float64, doubles))
    };
    layout.fields.iter().map(column).collect()
}
