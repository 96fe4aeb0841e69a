//! NPZ: arrays of NumPy in a zip.
//!
//! | array | items | value |
//! |---|---|---|
//! | `points` | double | shapes × points × coordinates; if their numbers of points differ, all points of all shapes × coordinates |
//! | `offsets` | 64-bit integer | then: number of points before each shape, and of all |
//! | `ids`, `subjects`, `labels` | text | as in [`Record`]; empty if unknown |
//! | `weights` | double | NaN if unknown |
//! | `closed` | 8-bit integer | 1 closed curve, 0 open curve, −1 landmarks |
//! | `attributes`, `metadata` | text | a JSON object, or empty |
//!
//! Only `points` is always there; other arrays are, if a shape has a value.

use std::collections::BTreeMap;
use std::io::{Read, Write};

use serde::de::DeserializeOwned;
use serde_json::{Map, Value as Json};

use super::super::format::Format;
use super::super::json::check_attributes;
use super::super::limits::Limits;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Kind, Points, Record};
use super::super::source::Source;
use super::super::unzip::opened;
use super::super::write::{Opened, Output, Writer};
use super::array_zip::ArrayZip;
use super::columns::unwritten;
use super::npy::{Header, Items, Layout, exactly};
use super::npy_file::{geometry, points_of};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// NPZ.
pub(in super::super) static FORMAT: Format = Format {
    id: "npz",
    name: "NPZ",
    media_types: &["application/x-npz"],
    extensions: &["npz"],
    recognise,
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["closed", "columns", "dimension", "attributes"],
    read: Some(read),
    open: Some(open),
};

/// A zip whose first file is an array.
fn recognise(head: &[u8]) -> bool {
    let length = head.get(26..28).map(|bytes| usize::from(bytes[0]) | usize::from(bytes[1]) << 8);
    let name = length.and_then(|length| head.get(30..30 + length));
    head.starts_with(b"PK\x03\x04") && name.is_some_and(|name| name.ends_with(b".npy"))
}

/// An array that is held.
struct Array {
    name: String,
    header: Header,
    bytes: Vec<u8>,
}

impl Array {
    fn fault(&self, detail: impl Into<String>) -> FileError {
        FileError::malformed(at(&self.name), detail)
    }

    fn item(&self, k: usize) -> &[u8] {
        let size = self.header.size;
        self.bytes.get(k * size..(k + 1) * size).unwrap_or_default()
    }

    fn number(&self, k: usize) -> f64 {
        self.header.number(self.item(k))
    }

    /// The array, if it has one item a shape.
    fn of_shapes(self, shapes: usize) -> Result<Self, FileError> {
        if self.header.shape == [shapes] {
            return Ok(self);
        }
        Err(self.fault(format!(
            "expected an item for each of {shapes} shapes, got an array of shape {:?}",
            self.header.shape
        )))
    }

    /// The array, if its items are numbers or flags.
    fn of_numbers(self) -> Result<Self, FileError> {
        match self.header.is_number() || self.header.items == Items::Flag {
            true => Ok(self),
            false => Err(self.fault("expected numbers or flags, got texts")),
        }
    }

    /// A text, `None` where it is empty; numbers are written out.
    fn text(&self, k: usize) -> Result<Option<String>, FileError> {
        if self.header.is_number() {
            return Ok(Some(self.number(k).to_string()));
        }
        let text = self.header.text(self.item(k));
        let text = text.ok_or_else(|| self.fault("expected texts, got other items"))?;
        Ok((!text.is_empty()).then_some(text))
    }

    /// A JSON object, without members where there is no text.
    fn object<T: DeserializeOwned + Default>(&self, k: usize) -> Result<T, FileError> {
        let Some(text) = self.text(k)? else { return Ok(T::default()) };
        let place = || Place { item: Some(k as u64), ..at(&self.name) };
        check_attributes(&text, place)?;
        let json: Json = serde_json::from_str(&text)
            .map_err(|_| FileError::malformed(place(), "expected a JSON object, got other text"))?;
        serde_json::from_value(json).map_err(|_| {
            let detail = "expected a JSON object of texts, numbers and Booleans, got other values";
            FileError::malformed(place(), detail)
        })
    }
}

fn at(name: &str) -> Place {
    Place { entry: Some(format!("{name}.npy")), ..Place::default() }
}

/// The arrays of the file, of which points, ids and others are known by their names.
#[derive(Default)]
struct Arrays {
    found: Vec<Array>,
}

impl Arrays {
    fn take(&mut self, name: &str) -> Option<Array> {
        let at = self.found.iter().position(|array| array.name == name)?;
        Some(self.found.remove(at))
    }
}

/// Number of files of other names that a fault names.
const NAMED: usize = 5;
const KNOWN: [&str; 8] =
    ["offsets", "ids", "subjects", "labels", "weights", "closed", "attributes", "metadata"];

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let mut summary = Summary::default();
    let wanted = options.points_column().unwrap_or("points");
    let mut arrays = unpack(source, wanted, &mut summary)?;
    let Some(points) = arrays.take(wanted) else {
        let others = summary.dropped.iter().flat_map(|dropped| &dropped.names).take(NAMED);
        let others = others.cloned().collect::<Vec<_>>().join(", ");
        let others = if others.is_empty() { "no other".into() } else { others };
        let detail =
            format!("expected an array '{wanted}', or columns.coordinates that names it, got {others}");
        return Err(FileError::malformed(Place::tag(wanted), detail));
    };
    let shapes = match arrays.take("offsets") {
        Some(offsets) => Shapes::ragged(points, offsets, &limits)?,
        None => Shapes::regular(points, options, &limits)?,
    };
    let count = shapes.count();
    let mut texts = |name: &str| arrays.take(name).map(|array| array.of_shapes(count)).transpose();
    let (ids, subjects, labels) = (texts("ids")?, texts("subjects")?, texts("labels")?);
    let (attributes, metadata) = (texts("attributes")?, texts("metadata")?);
    let mut numbers = |name: &str| texts(name)?.map(Array::of_numbers).transpose();
    let (weights, closed) = (numbers("weights")?, numbers("closed")?);
    for k in 0..count {
        let points = shapes.get(k);
        let place = Place { item: Some(k as u64), ..at(wanted) };
        let text = |array: &Option<Array>| array.as_ref().map_or(Ok(None), |array| array.text(k));
        let geometry = match closed.as_ref().map(|closed| closed.number(k)) {
            Some(closed) if closed < 0.0 => Geometry::Landmarks(points),
            Some(closed) => Geometry::Curve { points, closed: closed > 0.0 },
            None => geometry(points, options),
        };
        sink(Record {
            name: text(&ids)?,
            subject: text(&subjects)?,
            label: text(&labels)?,
            labels: attributes.as_ref().map_or(Ok(BTreeMap::new()), |array| array.object(k))?,
            weight: weights.as_ref().map_or(Ok(None), |weights| known(weights.number(k), k))?,
            metadata: metadata.as_ref().map_or(Ok(Map::new()), |array| array.object(k))?,
            ..Record::new(geometry, place)
        })?;
    }
    Ok(summary)
}

/// A weight; NaN stands for an unknown one.
fn known(weight: f64, shape: usize) -> Result<Option<f64>, FileError> {
    if weight.is_infinite() {
        let place = Place { item: Some(shape as u64), ..at("weights") };
        return Err(FileError::malformed(place, format!("expected a finite number or NaN, got {weight}")));
    }
    Ok(Some(weight).filter(|weight| !weight.is_nan()))
}

/// Reads the arrays that are of use; of others, and of other files, the names are kept.
fn unpack(source: &mut Source<'_>, points: &str, summary: &mut Summary) -> Result<Arrays, FileError> {
    let malformed = |error: &dyn std::fmt::Display| {
        FileError::malformed(Place::default(), format!("expected a zip of arrays, got {error}"))
    };
    let most = source.limits().held;
    let bytes = source.bytes()?;
    let size = bytes.len();
    let mut archive = opened(bytes)?;
    let mut arrays = Arrays::default();
    let mut held = 0_usize;
    for k in 0..archive.len() {
        let mut file = archive.by_index(k).map_err(|error| malformed(&error))?;
        let name = file.name().map_err(|error| malformed(&error))?.into_owned();
        let array = name.strip_suffix(".npy").filter(|name| *name == points || KNOWN.contains(name));
        let Some(array) = array.filter(|array| arrays.found.iter().all(|other| other.name != *array)) else {
            summary.drop("files of other names", Some(&name), || Place {
                entry: Some(name.clone()),
                ..Place::default()
            });
            continue;
        };
        let reserve = |bytes: usize| source.reserve(size.saturating_add(held).saturating_add(bytes));
        let read = read_array(array, &mut file, most.saturating_sub(held), reserve);
        let array = read.map_err(|error| error.at(at(array)))?;
        held = held.saturating_add(array.bytes.len());
        arrays.found.push(array);
    }
    Ok(arrays)
}

/// Reads an array of at most `held` bytes, after `reserve` has been asked for them.
fn read_array(
    name: &str,
    file: &mut impl Read,
    held: usize,
    reserve: impl FnOnce(usize) -> Result<(), FileError>,
) -> Result<Array, FileError> {
    let header = Header::read(file)?;
    let count = header.count()?.saturating_mul(header.size as u64);
    let Some(count) = usize::try_from(count).ok().filter(|count| *count <= held) else {
        let detail = format!("expected arrays of at most {held} bytes, got {count}");
        return Err(FileError::too_large(Place::default(), detail));
    };
    reserve(count)?;
    // Items of no bytes are of empty texts, which may be any number.
    if header.size == 0 && header.count()? > 0 && header.shape.iter().any(|axis| *axis > held) {
        return Err(FileError::too_large(Place::default(), "expected fewer items, got more"));
    }
    let bytes = exactly(file, count)?;
    Ok(Array { name: name.to_owned(), header, bytes })
}

/// Shapes of one array, made one after the other.
struct Shapes {
    array: Array,
    places: Places,
}

/// Where the points of each shape are.
enum Places {
    /// All shapes have as many.
    Regular(Layout),
    /// The number of points before each, and coordinates of a point.
    Ragged { offsets: Array, shapes: usize, dimension: usize },
}

impl Shapes {
    fn regular(array: Array, options: &ReadOptions, limits: &Limits) -> Result<Self, FileError> {
        let layout = Layout::of(&array.header, options, limits).map_err(|error| error.at(at(&array.name)))?;
        Ok(Self { array, places: Places::Regular(layout) })
    }

    /// Shapes of different numbers of points, by the number of points before each.
    fn ragged(array: Array, offsets: Array, limits: &Limits) -> Result<Self, FileError> {
        let ([count, dimension], false, true) =
            (array.header.shape.as_slice(), array.header.fortran, array.header.is_number())
        else {
            return Err(array.fault(format!(
                "expected points × coordinates in C order beside offsets, got {:?}",
                array.header.shape
            )));
        };
        if *dimension == 0 {
            return Err(array.fault("expected at least one coordinate, got none"));
        }
        let [ends] = offsets.header.shape[..] else {
            return Err(offsets.fault(format!(
                "expected a list of offsets, got an array of shape {:?}",
                offsets.header.shape
            )));
        };
        let offsets = offsets.of_numbers()?;
        let is_length =
            |length: f64| length >= 0.0 && length <= limits.points as f64 && length.fract() == 0.0;
        let begins = ends > 0 && offsets.number(0) == 0.0 && offsets.number(ends - 1) == *count as f64;
        if !(begins && (1..ends).all(|k| is_length(offsets.number(k) - offsets.number(k - 1)))) {
            return Err(offsets
                .fault(format!("expected offsets that ascend from 0 to the {count} points, got others")));
        }
        let places = Places::Ragged { offsets, shapes: ends - 1, dimension: *dimension };
        Ok(Self { array, places })
    }

    fn count(&self) -> usize {
        match &self.places {
            Places::Regular(layout) => layout.shapes,
            Places::Ragged { shapes, .. } => *shapes,
        }
    }

    /// The points of a shape.
    fn get(&self, k: usize) -> Points {
        let header = &self.array.header;
        let (range, dimension) = match &self.places {
            Places::Regular(layout) if header.fortran => {
                return layout.transposed(header, &self.array.bytes, k);
            }
            Places::Regular(layout) => (k * layout.width()..(k + 1) * layout.width(), layout.dimension),
            Places::Ragged { offsets, dimension, .. } => {
                // They ascend to the number of points, so they are exact.
                let [start, end] = [k, k + 1].map(|k| offsets.number(k) as usize * dimension);
                (start..end, *dimension)
            }
        };
        Points::from_rows(dimension, range.map(|item| self.array.number(item)).collect())
    }
}

/// Arrays that are being collected.
#[derive(Default)]
struct Collected {
    values: Vec<f64>,
    ends: Vec<usize>,
    dimension: Option<usize>,
    ids: Vec<Option<String>>,
    subjects: Vec<Option<String>>,
    labels: Vec<Option<String>>,
    attributes: Vec<Option<String>>,
    metadata: Vec<Option<String>>,
    weights: Vec<f64>,
    closed: Vec<Option<bool>>,
}

struct Zip<'a> {
    output: Output<'a>,
    arrays: Collected,
    held: usize,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Zip { output, arrays: Collected::default(), held: 0, summary: Summary::default() }))
}

impl Writer for Zip<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, closed) = points_of(record)?;
        let arrays = &mut self.arrays;
        let dimension = *arrays.dimension.get_or_insert(points.dimension());
        if points.dimension() != dimension {
            let detail = format!(
                "expected {dimension} coordinates in every shape of an array, got {}",
                points.dimension()
            );
            return Err(FileError::unsupported(record.place.clone(), detail));
        }
        arrays.values.extend_from_slice(points.coordinates());
        arrays.ends.push(arrays.values.len() / dimension.max(1));
        arrays.ids.push(record.name.clone());
        arrays.subjects.push(record.subject.clone());
        arrays.labels.push(record.label.clone());
        let json = |empty: bool, text: serde_json::Result<String>| {
            if empty { Ok(None) } else { text.map(Some).map_err(unwritten) }
        };
        let texts = [
            json(record.labels.is_empty(), serde_json::to_string(&record.labels))?,
            json(record.metadata.is_empty(), serde_json::to_string(&record.metadata))?,
        ];
        self.held += record.bytes();
        let [attributes, metadata] = texts;
        arrays.attributes.push(attributes);
        arrays.metadata.push(metadata);
        arrays.weights.push(record.weight.unwrap_or(f64::NAN));
        arrays.closed.push(closed);
        if record.ring.is_some() {
            self.summary.drop("places among the rings of an object", None, || record.place.clone());
        }
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.held
    }

    fn finish(self: Box<Self>) -> Result<Summary, FileError> {
        let Self { output, arrays, summary, .. } = *self;
        let mut zip = ArrayZip::new(output);
        write_points(&mut zip, &arrays)?;
        zip.texts("ids", &arrays.ids)?;
        zip.texts("subjects", &arrays.subjects)?;
        zip.texts("labels", &arrays.labels)?;
        if arrays.weights.iter().any(|weight| !weight.is_nan()) {
            zip.numbers("weights", &[arrays.weights.len()], &arrays.weights)?;
        }
        if arrays.closed.iter().any(Option::is_some) {
            zip.flags("closed", &arrays.closed)?;
        }
        zip.texts("attributes", &arrays.attributes)?;
        zip.texts("metadata", &arrays.metadata)?;
        let mut output = zip.finish()?;
        output.flush()?;
        Ok(summary)
    }
}

/// The points, and their offsets unless all shapes have as many.
fn write_points<W: Write>(zip: &mut ArrayZip<W>, arrays: &Collected) -> Result<(), FileError> {
    let (shapes, dimension) = (arrays.ends.len(), arrays.dimension.unwrap_or(2));
    let all = arrays.ends.last().copied().unwrap_or(0);
    let each = arrays.ends.first().copied().unwrap_or(0);
    if arrays.ends.iter().enumerate().all(|(k, end)| *end == each * (k + 1)) {
        return zip.numbers("points", &[shapes, each, dimension], &arrays.values);
    }
    zip.numbers("points", &[all, dimension], &arrays.values)?;
    zip.offsets("offsets", &arrays.ends)
}
