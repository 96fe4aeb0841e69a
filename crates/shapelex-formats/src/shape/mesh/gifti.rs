//! GIfTI surfaces (.gii): points, triangles and data of vertices.
//!
//! Each array of points is a shape. Matrices of coordinate systems are not applied: they are in the metadata, as far as they
//! change something. Names of persons and paths of files are left out.

use super::super::format::Format;
use super::super::limits::{Limits, Room};
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Kind};
use super::super::source::Source;
use super::NORMALS;
use super::draft::Draft;
use super::encoded::{Bytes, inflate};
use super::scalar::{Scalar, index};
use super::scan::{count, number, shown, words};
use super::xml::{Element, parse};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// GIfTI surfaces.
pub(in super::super) static FORMAT: Format = Format {
    id: "gifti",
    name: "GIfTI",
    media_types: &["application/x-gifti+xml"],
    extensions: &["gii"],
    recognise: |head| head.windows(6).any(|word| word == b"<GIFTI"),
    kinds: &[Kind::Mesh, Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: None,
};

/// Most arrays of points of a file, and most arrays: each surface has all data, so the work is their product.
const MAX_SURFACES: usize = 64;
const MAX_ARRAYS: usize = 10_000;

/// Entries of the metadata that name the structure of a surface. Others may name a person or a computer.
const KEPT: [&str; 4] =
    ["AnatomicalStructurePrimary", "AnatomicalStructureSecondary", "GeometricType", "TopologicalType"];

/// Metadata of other arrays, or a second value for the same surface.
const OTHER_METADATA: &str = "entries of metadata beside those of the points";

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let root = parse(&text, &limits, "")?;
    if root.name != "GIFTI" {
        return Err(FileError::malformed(
            root.place(),
            format!("expected GIFTI, got {}", shown(root.name.as_bytes())),
        ));
    }
    let mut summary = Summary::default();
    drop_metadata(&root, false, &mut summary);
    let mut arrays = Vec::new();
    let room = Room::new(&limits, text.len());
    for (k, element) in root.all("DataArray").enumerate() {
        let place = Place { item: Some(k as u64), ..element.place() };
        if k == MAX_ARRAYS {
            return Err(FileError::too_large(
                place,
                format!("expected at most {MAX_ARRAYS} arrays, got more"),
            ));
        }
        arrays.push(Array::read(element, &limits, &room).map_err(|error| error.at(place))?);
        let is_surface = arrays.last().is_some_and(Array::is_surface);
        drop_metadata(element, is_surface, &mut summary);
    }
    let labels = root.child("LabelTable");
    labels.into_iter().for_each(|labels| drop_colours(labels, &mut summary));
    let intent = |name: &'static str| arrays.iter().filter(move |array| array.intent == name);
    let triangles: Vec<&Array<'_>> = intent("TRIANGLE").collect();
    let count = intent("POINTSET").count();
    if count == 0 {
        let detail = "expected an array of points (NIFTI_INTENT_POINTSET), got none";
        return Err(FileError::malformed(root.place(), detail));
    }
    if count > MAX_SURFACES {
        let detail = format!("expected at most {MAX_SURFACES} arrays of points, got {count}");
        return Err(FileError::too_large(root.place(), detail));
    }
    if triangles.len() > 1 && triangles.len() != count {
        let detail =
            format!("expected triangles of each of {count} arrays of points, got {}", triangles.len());
        return Err(FileError::unsupported(root.place(), detail));
    }
    for (k, points) in intent("POINTSET").enumerate() {
        let faces = triangles.get(k).or(triangles.first()).copied();
        let mut draft = points.draft(k as u64, faces, &limits, &mut summary)?;
        for (k, array) in arrays.iter().enumerate() {
            if !array.is_surface() {
                array.add(k, &mut draft, &mut summary);
            }
        }
        if let Some(labels) = labels {
            add_labels(labels, &mut draft);
        }
        draft.send(&mut summary, sink)?;
    }
    Ok(summary)
}

/// An array of data.
struct Array<'a> {
    element: &'a Element<'a>,
    /// Its intent, without `NIFTI_INTENT_`.
    intent: &'a str,
    rows: usize,
    width: usize,
    /// Row-major.
    values: Vec<f64>,
}

impl<'a> Array<'a> {
    fn read(element: &'a Element<'a>, limits: &Limits, room: &Room) -> Result<Self, FileError> {
        let place = || element.place();
        let attribute = |name: &str| element.attribute(name).unwrap_or_default();
        let of = attribute("DataType");
        let scalar = scalar(of).ok_or_else(|| {
            FileError::unsupported(place(), format!("expected a type of numbers, got {}", shown_type(of)))
        })?;
        let dimension = claim(element, "Dimensionality")?;
        let by_column = attribute("ArrayIndexingOrder") == "ColumnMajorOrder";
        if by_column && dimension > 2 {
            let detail = format!("expected at most 2 dimensions in the order of columns, got {dimension}");
            return Err(FileError::unsupported(place(), detail));
        }
        if !(1..=6).contains(&dimension) {
            return Err(FileError::malformed(
                place(),
                format!("expected 1 to 6 dimensions, got {dimension}"),
            ));
        }
        let rows = limits.faces(claim(element, "Dim0")?, place)?;
        let mut width = 1_usize;
        for k in 1..dimension {
            let size = usize::try_from(claim(element, &format!("Dim{k}"))?).unwrap_or(usize::MAX);
            width = width.saturating_mul(size);
        }
        let size = rows.saturating_mul(width);
        let bytes = size.saturating_mul(scalar.size());
        if bytes > limits.held {
            let detail = format!("expected at most {} bytes of an array, got {bytes}", limits.held);
            return Err(FileError::too_large(place(), detail));
        }
        room.take(size, place)?;
        let mut values = numbers(element, scalar, size)?;
        if by_column && width > 1 {
            values = (0..rows)
                .flat_map(|row| (0..width).map(move |k| k * rows + row))
                .map(|at| values[at])
                .collect();
        }
        let intent = attribute("Intent");
        Ok(Self {
            element,
            intent: intent.strip_prefix("NIFTI_INTENT_").unwrap_or(intent),
            rows,
            width,
            values,
        })
    }

    /// Whether it is one of points or triangles, whose metadata become those of the shape.
    fn is_surface(&self) -> bool {
        matches!(self.intent, "POINTSET" | "TRIANGLE")
    }

    /// The shape of an array of points.
    fn draft(
        &self,
        item: u64,
        triangles: Option<&Self>,
        limits: &Limits,
        summary: &mut Summary,
    ) -> Result<Draft, FileError> {
        let place = Place { item: Some(item), ..self.element.place() };
        limits.points(self.rows as u64, || place.clone())?;
        let three = |array: &Self, what: &str| match array.width {
            3 => Ok(()),
            other => Err(FileError::malformed(
                array.element.place(),
                format!("expected 3 {what} a row, got {other}"),
            )),
        };
        three(self, "coordinates")?;
        let mut draft = Draft::new(place);
        self.values.chunks_exact(3).for_each(|point| draft.vertices.push(point));
        if let Some(triangles) = triangles {
            three(triangles, "corners")?;
            for triangle in triangles.values.chunks_exact(3) {
                let mut face = [0; 3];
                for (corner, value) in face.iter_mut().zip(triangle) {
                    *corner = index(*value).ok_or_else(|| {
                        let detail = format!("expected indices of points, got {value}");
                        FileError::malformed(triangles.element.place(), detail)
                    })?;
                }
                draft.faces.push(face);
            }
        }
        // Metadata of triangles about the surface, such as its topology, come after those of the points.
        for element in std::iter::once(self.element).chain(triangles.map(|triangles| triangles.element)) {
            for (name, value) in metadata(element).filter(|(name, _)| KEPT.contains(name)) {
                if *draft.metadata.entry(name).or_insert(value.into()) != value {
                    summary.drop(OTHER_METADATA, Some(name), || element.place());
                }
            }
        }
        for (k, system) in self.element.all("CoordinateSystemTransformMatrix").enumerate() {
            let text = |name: &str| system.child(name).map(|child| child.text.trim()).unwrap_or_default();
            let matrix = words(text("MatrixData").as_bytes());
            let matrix = matrix.map(|word| number(word, "a number", || system.place()));
            let matrix = matrix.collect::<Result<Vec<f64>, _>>()?;
            let identity =
                matrix.iter().enumerate().all(|(k, x)| *x == f64::from(u8::from(k.is_multiple_of(5))));
            summary.set("coordinate_system", text("DataSpace"));
            if !identity {
                let value = serde_json::json!({ "to": text("TransformedSpace"), "matrix": matrix });
                draft
                    .metadata
                    .insert(if k == 0 { "transform".into() } else { format!("transform_{k}") }, value);
            }
        }
        Ok(draft)
    }

    /// Adds data of vertices as a field.
    fn add(&self, k: usize, draft: &mut Draft, summary: &mut Summary) {
        let name = metadata(self.element).find(|(name, _)| *name == "Name").map(|(_, value)| value);
        // A name that is a path says where a file was.
        let name = name.filter(|name| !name.is_empty() && !name.contains(['/', '\\']));
        let own = match (self.intent, self.width) {
            ("VECTOR", 3) if name.is_none() => NORMALS.to_owned(),
            (intent, _) => format!("{}_{k}", intent.to_lowercase()),
        };
        if self.rows != draft.vertices.len() || self.width == 0 {
            summary.drop("arrays of other than the vertices", Some(name.unwrap_or(&own)), || {
                self.element.place()
            });
        } else if draft.keeps(name.unwrap_or(&own)) {
            draft.field(name.unwrap_or(&own), Domain::Vertices, self.width, self.values.clone());
        }
    }
}

fn scalar(of: &str) -> Option<Scalar> {
    Some(match of.trim_start_matches("NIFTI_TYPE_") {
        "UINT8" => Scalar::U8,
        "INT8" => Scalar::I8,
        "INT16" => Scalar::I16,
        "UINT16" => Scalar::U16,
        "INT32" => Scalar::I32,
        "UINT32" => Scalar::U32,
        "INT64" => Scalar::I64,
        "UINT64" => Scalar::U64,
        "FLOAT32" => Scalar::F32,
        "FLOAT64" => Scalar::F64,
        _ => return None,
    })
}

fn shown_type(of: &str) -> String {
    shown(of.trim_start_matches("NIFTI_TYPE_").as_bytes())
}

/// The `size` numbers of an array in the order of the file.
fn numbers(element: &Element<'_>, scalar: Scalar, size: usize) -> Result<Vec<f64>, FileError> {
    let place = || element.place();
    let refused = |name: &str, known: &str| {
        let value = shown(element.attribute(name).unwrap_or_default().as_bytes());
        FileError::unsupported(place(), format!("expected {name} {known}, got {value}"))
    };
    let bytes = size.saturating_mul(scalar.size());
    let text = element.child("Data").map(|data| data.text.as_bytes()).unwrap_or_default();
    let raw = match element.attribute("Encoding") {
        Some("ASCII") => {
            let values = words(text).map(|word| number(word, "a number", place));
            let values = values.collect::<Result<Vec<f64>, _>>()?;
            if values.len() != size {
                let detail = format!("expected {size} numbers, got {}", values.len());
                return Err(FileError::malformed(place(), detail));
            }
            return Ok(values);
        }
        Some("Base64Binary") => Bytes::base64(text).all(place)?,
        Some("GZipBase64Binary") => inflate(&Bytes::base64(text).all(place)?, bytes, place)?,
        _ => return Err(refused("Encoding", "ASCII, Base64Binary or GZipBase64Binary")),
    };
    let big_endian = match element.attribute("Endian") {
        Some("LittleEndian") => false,
        Some("BigEndian") => true,
        _ => return Err(refused("Endian", "LittleEndian or BigEndian")),
    };
    if raw.len() != bytes {
        return Err(FileError::malformed(place(), format!("expected {bytes} bytes, got {}", raw.len())));
    }
    Ok(scalar.decode_all(&raw, big_endian))
}

/// Names and values of the metadata.
fn metadata<'e>(element: &'e Element<'_>) -> impl Iterator<Item = (&'e str, &'e str)> {
    let entries = element.child("MetaData").into_iter().flat_map(|all| all.all("MD"));
    entries.map(|entry| {
        let text = |name: &str| entry.child(name).map(|child| child.text.trim()).unwrap_or_default();
        (text("Name"), text("Value"))
    })
}

/// Counts the metadata that become none of a shape.
fn drop_metadata(element: &Element<'_>, is_surface: bool, summary: &mut Summary) {
    for (name, _) in metadata(element) {
        let what = match (KEPT.contains(&name), is_surface) {
            (false, _) => "entries of metadata, which may identify someone",
            (true, false) => OTHER_METADATA,
            (true, true) => continue,
        };
        summary.drop(what, Some(name), || element.place());
    }
}

/// Counts the colours of labels.
fn drop_colours(table: &Element<'_>, summary: &mut Summary) {
    let is_coloured = |label: &&Element<'_>| {
        ["Red", "Green", "Blue", "Alpha"].iter().any(|name| label.attribute(name).is_some())
    };
    let count = table.all("Label").filter(is_coloured).count();
    if count > 0 {
        summary.drop_many("colours of labels", count as u64, None, || table.place());
    }
}

/// Names of the numbers of labels.
fn add_labels(table: &Element<'_>, draft: &mut Draft) {
    let label = |label: &Element<'_>| {
        let key = label.attribute("Key").or(label.attribute("Index")).unwrap_or_default().to_owned();
        (key, serde_json::Value::from(label.text.trim()))
    };
    let labels: serde_json::Map<String, serde_json::Value> = table.all("Label").map(label).collect();
    if !labels.is_empty() {
        draft.metadata.insert("labels".into(), labels.into());
    }
}

fn claim(element: &Element<'_>, name: &str) -> Result<u64, FileError> {
    let value = element.attribute(name).unwrap_or_default().trim();
    count(value.as_bytes(), &format!("a whole number {name}"), || element.place())
}

#[cfg(test)]
mod tests;
