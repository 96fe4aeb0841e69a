//! Batches of rows to records.

use std::collections::{BTreeMap, HashMap};

use arrow_array::cast::AsArray;
use arrow_array::{Array, ArrayRef, BooleanArray, Float64Array, RecordBatch};
use arrow_schema::{DataType, Schema};

use super::super::json::check_attributes;
use super::super::limits::Limits;
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Field, Geometry, Mesh, Points, Record, Ring};
use super::arrays::{Lists, Texts, is_flag, is_list_of_numbers, is_number, is_text, numbers, wholes};
use super::columns::{FIELDS, FieldNote, LABELS, PREFIX, check_name};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::unit::Unit;
use crate::value::Value;

/// Column of the points, unless an option names another one.
const POINTS: &str = "points";

/// A table that is being read.
pub(super) struct Reading<'a> {
    options: &'a ReadOptions,
    limits: Limits,
    notes: BTreeMap<String, FieldNote>,
    unit: Option<Unit>,
    row: u64,
    /// Facts of the file, and the items left out.
    pub(super) summary: Summary,
}

impl<'a> Reading<'a> {
    /// A table with these metadata.
    pub(super) fn new(options: &'a ReadOptions, limits: Limits, metadata: &HashMap<String, String>) -> Self {
        let mut summary = Summary::default();
        let mut notes = BTreeMap::new();
        for (name, value) in metadata {
            match name.strip_prefix(PREFIX) {
                Some("fields") => notes = serde_json::from_str(value).unwrap_or_default(),
                Some(name) => summary.set(name, value.as_str()),
                None => {}
            }
        }
        let unit = metadata.get(&format!("{PREFIX}unit")).and_then(|unit| Unit::find(unit));
        Self { options, limits, notes, unit, row: 0, summary }
    }

    /// Positions of the columns of a schema that can be of use. Others are counted.
    ///
    /// # Errors
    /// A column of points that holds something else, a long name.
    pub(super) fn of_use(&mut self, schema: &Schema) -> Result<Vec<usize>, FileError> {
        let points = self.options.points_column().unwrap_or(POINTS);
        let mut found = Vec::new();
        for (k, field) in schema.fields().iter().enumerate() {
            let (name, kind) = (field.name(), field.data_type());
            check_name(name)?;
            if is_list_of_numbers(kind)
                || (name != points && (is_number(kind) || is_text(kind) || is_flag(kind)))
            {
                found.push(k);
            } else if name == points {
                return Err(no_lists(name, kind));
            } else {
                self.leave_out(name);
            }
        }
        let has_shapes = |k: &usize| [points, "vertices"].contains(&schema.field(*k).name().as_str());
        if found.iter().any(has_shapes) { Ok(found) } else { Err(no_shapes(points, schema)) }
    }

    fn leave_out(&mut self, name: &str) {
        let place = || Place::tag(format!("column '{name}'"));
        self.summary.drop("columns of other types", Some(name), place);
    }

    /// Gives on the rows of a batch.
    ///
    /// # Errors
    /// Columns of other types, rows without a shape, errors of `sink`.
    pub(super) fn batch(&mut self, batch: &RecordBatch, sink: Sink<'_>) -> Result<(), FileError> {
        let columns = self.columns(batch)?;
        for row in 0..batch.num_rows() {
            let place = Place::item(self.row);
            self.row += 1;
            match self.record(&columns, row, place) {
                Ok(record) => sink(record)?,
                Err(error) => self.options.leave_out(error, &mut self.summary)?,
            }
        }
        Ok(())
    }

    fn columns(&mut self, batch: &RecordBatch) -> Result<Columns, FileError> {
        let mut columns = Columns::default();
        let points = self.options.points_column().unwrap_or(POINTS);
        for (field, array) in batch.schema().fields().iter().zip(batch.columns()) {
            if !columns.take(field.name(), array, points)? && self.row == 0 {
                self.leave_out(field.name());
            }
        }
        if columns.points.is_none() && columns.vertices.is_none() {
            return Err(no_shapes(points, &batch.schema()));
        }
        Ok(columns)
    }

    fn record(&self, columns: &Columns, row: usize, place: Place) -> Result<Record, FileError> {
        let geometry = self.geometry(columns, row, &place)?;
        let text = |cells: &Option<Cells>| cells.as_ref().and_then(|cells| cells.get(row)).map(shown);
        let json = |cells: &Option<Cells>, name: &str| match text(cells) {
            Some(text) => {
                let place = || Place { tag: Some(format!("column '{name}'")), ..place.clone() };
                check_attributes(&text, place)?;
                serde_json::from_str(&text)
                    .map_err(|_| FileError::malformed(place(), "expected a JSON object, got other text"))
            }
            None => Ok(serde_json::Map::new()),
        };
        let mut labels = BTreeMap::new();
        for (name, cells) in &columns.labels {
            if let Some(value) = cells.get(row) {
                finite(&value, name, &place)?;
                labels.insert(name.clone(), value);
            }
        }
        for (name, value) in json(&columns.more_labels, "more_labels")? {
            let value = serde_json::from_value(value).map_err(|_| {
                let place = Place { tag: Some("column 'more_labels'".into()), ..place.clone() };
                FileError::malformed(
                    place,
                    format!("expected a text, a number or a Boolean as {name}, got another value"),
                )
            })?;
            labels.insert(name, value);
        }
        let weight =
            columns.weight.as_ref().filter(|cells| cells.is_valid(row)).map(|cells| cells.value(row));
        if let Some(weight) = weight {
            finite(&Value::Number(weight), "weight", &place)?;
        }
        Ok(Record {
            unit: self.unit,
            name: text(&columns.external_id),
            subject: text(&columns.subject),
            label: text(&columns.label),
            labels,
            weight,
            metadata: json(&columns.metadata, "metadata")?,
            ring: columns.ring(row),
            ..Record::new(geometry, place)
        })
    }

    fn geometry(&self, columns: &Columns, row: usize, place: &Place) -> Result<Geometry, FileError> {
        let stated = columns.dimension.as_ref().and_then(|cells| value(cells, row)).and_then(whole);
        let dimension = stated.or(self.options.dimension);
        let points = columns.points.as_ref();
        if let Some(points) =
            points.and_then(|points| points.row(row, dimension, &self.limits, place).transpose())
        {
            let points = points?;
            let closed =
                columns.closed.as_ref().filter(|cells| cells.is_valid(row)).map(|cells| cells.value(row));
            return Ok(match closed.or(self.options.closed) {
                Some(closed) => Geometry::Curve { points, closed },
                None => Geometry::Landmarks(points),
            });
        }
        let vertices = columns.vertices.as_ref();
        let vertices = vertices.and_then(|lists| lists.row(row, Some(3), &self.limits, place).transpose());
        let Some(vertices) = vertices else {
            return Err(FileError::malformed(
                place.clone(),
                "expected points or vertices in every row, got null",
            ));
        };
        let mut mesh = Mesh { vertices: vertices?, ..Mesh::default() };
        columns.faces(row, &mut mesh, &self.limits, place)?;
        for (name, cells) in &columns.fields {
            let Some(values) = cells.flat(row) else { continue };
            let note = self.notes.get(name);
            let domain = match note {
                Some(note) if note.on == "faces" => Domain::Faces,
                _ => Domain::Vertices,
            };
            let width = note.map_or(1, |note| note.width);
            mesh.fields.insert(name.clone(), Field { domain, width, values });
        }
        Ok(Geometry::Mesh(mesh))
    }
}

fn no_lists(name: &str, kind: &DataType) -> FileError {
    FileError::malformed(
        Place::tag(format!("column '{name}'")),
        format!("expected lists of numbers, got {kind}"),
    )
}

fn no_shapes(points: &str, schema: &Schema) -> FileError {
    let names = schema.fields().iter().map(|field| field.name().as_str()).collect::<Vec<_>>();
    let detail = format!(
        "expected a column '{points}' of lists of numbers, or columns.coordinates that names it, got columns {}",
        names.join(", ")
    );
    FileError::malformed(Place::default(), detail)
}

/// Columns of a batch by their meaning.
#[derive(Default)]
struct Columns {
    external_id: Option<Cells>,
    subject: Option<Cells>,
    label: Option<Cells>,
    metadata: Option<Cells>,
    more_labels: Option<Cells>,
    weight: Option<Float64Array>,
    closed: Option<BooleanArray>,
    dimension: Option<Float64Array>,
    points: Option<NumberLists>,
    vertices: Option<NumberLists>,
    faces: Option<NumberLists>,
    face_sizes: Option<NumberLists>,
    ring_object: Option<Float64Array>,
    ring_part: Option<Float64Array>,
    ring_hole: Option<BooleanArray>,
    labels: BTreeMap<String, Cells>,
    fields: BTreeMap<String, NumberLists>,
}

/// Fills an empty place. Returns whether it was empty and there is something to put there.
fn fill<T>(place: &mut Option<T>, found: Option<T>) -> bool {
    if place.is_some() || found.is_none() {
        return false;
    }
    *place = found;
    true
}

/// Adds a column, if there is none of its name. Returns whether there was none.
fn insert<T>(columns: &mut BTreeMap<String, T>, name: &str, column: T) -> bool {
    let is_new = !columns.contains_key(name);
    if is_new {
        columns.insert(name.into(), column);
    }
    is_new
}

impl Columns {
    /// Takes a column by its name. Returns whether it is of use.
    fn take(&mut self, name: &str, array: &ArrayRef, points: &str) -> Result<bool, FileError> {
        let flags = || array.as_boolean_opt().cloned();
        let number = || numbers(array);
        if name == points {
            let found = NumberLists::of(array);
            if found.is_none() {
                return Err(no_lists(name, array.data_type()));
            }
            return Ok(fill(&mut self.points, found));
        }
        Ok(match name {
            "external_id" => fill(&mut self.external_id, Cells::of(array)),
            "subject" => fill(&mut self.subject, Cells::of(array)),
            "label" => fill(&mut self.label, Cells::of(array)),
            "metadata" => fill(&mut self.metadata, Cells::of(array)),
            "more_labels" => fill(&mut self.more_labels, Cells::of(array)),
            "weight" => fill(&mut self.weight, number()),
            "closed" => fill(&mut self.closed, flags()),
            "dimension" => fill(&mut self.dimension, number()),
            "vertices" => fill(&mut self.vertices, NumberLists::of(array)),
            "faces" => fill(&mut self.faces, NumberLists::of(array)),
            "face_sizes" => fill(&mut self.face_sizes, NumberLists::of(array)),
            "ring_object" => fill(&mut self.ring_object, number()),
            "ring_part" => fill(&mut self.ring_part, number()),
            "ring_hole" => fill(&mut self.ring_hole, flags()),
            name => match (name.strip_prefix(FIELDS).zip(NumberLists::of(array)), Cells::of(array)) {
                (Some((field, lists)), _) => insert(&mut self.fields, field, lists),
                (None, Some(cells)) => {
                    insert(&mut self.labels, name.strip_prefix(LABELS).unwrap_or(name), cells)
                }
                (None, None) => false,
            },
        })
    }

    fn ring(&self, row: usize) -> Option<Ring> {
        let position = |cells: &Option<Float64Array>| {
            let position = whole(value(cells.as_ref()?, row)?)?;
            u64::try_from(position).ok()
        };
        let hole = self.ring_hole.as_ref().filter(|cells| cells.is_valid(row))?.value(row);
        Some(Ring { object: position(&self.ring_object)?, part: position(&self.ring_part)?, hole })
    }

    /// Reads the faces of a row into a mesh.
    fn faces(&self, row: usize, mesh: &mut Mesh, limits: &Limits, place: &Place) -> Result<(), FileError> {
        let Some(corners) = self.faces.as_ref().and_then(|lists| lists.flat(row)) else { return Ok(()) };
        let at = |name: &str| Place { tag: Some(format!("column '{name}'")), ..place.clone() };
        let fault = |name: &str, detail: String| Err(FileError::malformed(at(name), detail));
        let index = |corner: &f64| {
            whole(*corner).and_then(|corner| u32::try_from(corner).ok()).ok_or_else(|| {
                FileError::malformed(at("faces"), format!("expected positions of vertices, got {corner}"))
            })
        };
        let corners = corners.iter().map(index).collect::<Result<Vec<u32>, _>>()?;
        let sizes = self.face_sizes.as_ref().and_then(|lists| lists.flat(row));
        let count = sizes.as_ref().map_or(corners.len() / 3, Vec::len);
        limits.faces(count as u64, || at("faces"))?;
        let Some(sizes) = sizes else {
            if !corners.len().is_multiple_of(3) {
                return fault(
                    "faces",
                    format!("expected three corners of every triangle, got {} numbers", corners.len()),
                );
            }
            corners.chunks_exact(3).for_each(|face| mesh.faces.push(face.iter().copied()));
            return Ok(());
        };
        let mut rest = corners.as_slice();
        for size in sizes {
            let split = whole(size).and_then(|size| rest.split_at_checked(size));
            let Some((face, others)) = split else {
                return fault(
                    "face_sizes",
                    format!("expected numbers of corners that add up to {}, got others", corners.len()),
                );
            };
            mesh.faces.push(face.iter().copied());
            rest = others;
        }
        if rest.is_empty() {
            return Ok(());
        }
        fault(
            "face_sizes",
            format!("expected numbers of corners that add up to {}, got fewer", corners.len()),
        )
    }
}

/// A whole number that is not negative.
fn whole(value: f64) -> Option<usize> {
    const LARGEST: f64 = 9_007_199_254_740_992.0;
    // The cast is exact in this range.
    ((0.0..=LARGEST).contains(&value) && value.fract() == 0.0).then_some(value as usize)
}

fn value(cells: &Float64Array, row: usize) -> Option<f64> {
    cells.is_valid(row).then(|| cells.value(row)).filter(|value| value.is_finite())
}

/// Checks that a number is finite.
fn finite(value: &Value, column: &str, place: &Place) -> Result<(), FileError> {
    match value {
        Value::Number(number) if !number.is_finite() => {
            let place = Place { tag: Some(format!("column '{column}'")), ..place.clone() };
            Err(FileError::malformed(place, format!("expected a finite number or null, got {number}")))
        }
        _ => Ok(()),
    }
}

fn shown(value: Value) -> String {
    match value {
        Value::Text(text) => text,
        Value::Number(number) => number.to_string(),
        Value::Bool(yes) => yes.to_string(),
    }
}

/// Cells of a column: texts, numbers, whole numbers of 64 bits or flags.
enum Cells {
    Texts(Texts),
    Numbers(Float64Array),
    Wholes(ArrayRef),
    Flags(BooleanArray),
}

impl Cells {
    fn of(array: &ArrayRef) -> Option<Self> {
        if is_flag(array.data_type()) {
            return Some(Self::Flags(array.as_boolean().clone()));
        }
        if matches!(array.data_type(), DataType::Int64 | DataType::UInt64) {
            return Some(Self::Wholes(array.clone()));
        }
        numbers(array).map(Self::Numbers).or_else(|| Texts::of(array).map(Self::Texts))
    }

    fn get(&self, row: usize) -> Option<Value> {
        match self {
            Self::Texts(texts) => texts.get(row).map(Value::from),
            // NaN stands for a missing number in tables of Python.
            Self::Numbers(numbers) => {
                let number = numbers.is_valid(row).then(|| numbers.value(row));
                number.filter(|number| !number.is_nan()).map(Value::Number)
            }
            Self::Wholes(array) => {
                array.is_valid(row).then(|| wholes(array, row)).flatten().map(Value::whole)
            }
            Self::Flags(flags) => flags.is_valid(row).then(|| Value::Bool(flags.value(row))),
        }
    }
}

/// Lists of numbers, or lists of points.
struct NumberLists {
    rows: Lists,
    points: Option<Lists>,
    numbers: Float64Array,
}

impl NumberLists {
    fn of(array: &ArrayRef) -> Option<Self> {
        let rows = Lists::of(array)?;
        if let Some(numbers) = numbers(&rows.values) {
            return Some(Self { rows, points: None, numbers });
        }
        let points = Lists::of(&rows.values)?;
        let numbers = numbers(&points.values)?;
        Some(Self { rows, points: Some(points), numbers })
    }

    fn number(&self, at: usize) -> f64 {
        if self.numbers.is_valid(at) { self.numbers.value(at) } else { f64::NAN }
    }

    /// The numbers of a row, if they are not points.
    fn flat(&self, row: usize) -> Option<Vec<f64>> {
        let range = self.rows.get(row).filter(|_| self.points.is_none())?;
        Some(range.map(|at| self.number(at)).collect())
    }

    /// The points of a row.
    fn row(
        &self,
        row: usize,
        dimension: Option<usize>,
        limits: &Limits,
        place: &Place,
    ) -> Result<Option<Points>, FileError> {
        let Some(range) = self.rows.get(row) else { return Ok(None) };
        let place = || place.clone();
        let Some(points) = &self.points else {
            let Some(dimension) = dimension.filter(|dimension| *dimension > 0) else {
                let detail =
                    "expected a column 'dimension' or the option dimension, got lists of numbers alone";
                return Err(FileError::new(FaultKind::Option, detail).at(place()));
            };
            if !range.len().is_multiple_of(dimension) {
                let detail = format!("expected {dimension} numbers a point, got {} numbers", range.len());
                return Err(FileError::malformed(place(), detail));
            }
            limits.points((range.len() / dimension) as u64, place)?;
            return Ok(Some(Points::from_rows(dimension, range.map(|at| self.number(at)).collect())));
        };
        limits.points(range.len() as u64, place)?;
        let width = range.clone().find_map(|at| points.get(at)).map(|point| point.len());
        let dimension = width.or(dimension).unwrap_or(2);
        let mut found = Points::new(dimension);
        for (k, at) in range.enumerate() {
            match points.get(at) {
                Some(point) if point.len() == dimension && dimension > 0 => {
                    found.push(&point.map(|at| self.number(at)).collect::<Vec<_>>());
                }
                Some(point) => {
                    let detail =
                        format!("expected {dimension} coordinates, got {} in point {k}", point.len());
                    return Err(FileError::malformed(place(), detail));
                }
                None => found.push_missing(),
            }
        }
        Ok(Some(found))
    }
}
