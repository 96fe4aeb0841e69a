//! glTF 2.0 in one binary file (.glb): one node a shape, in single precision.
//!
//! Meshes are triangles with normals, colours and texture coordinates, curves are lines, landmarks are points.

use std::io::Write;

use serde_json::{Value, json};

use super::super::format::Format;
use super::super::options::WriteOptions;
use super::super::record::{Kind, Record};
use super::super::write::{Opened, Output, Writer};
use super::part::{Part, count_lost, refused, singles};
use super::{COLOURS, NORMALS, TEXTURE};
use crate::error::FileError;
use crate::summary::Summary;

/// Binary glTF.
pub(in super::super) static FORMAT: Format = Format {
    id: "gltf",
    name: "binary glTF",
    media_types: &["model/gltf-binary"],
    extensions: &["glb"],
    recognise: |head| head.starts_with(b"glTF"),
    kinds: &[Kind::Mesh, Kind::Curve, Kind::Landmarks],
    options: &[],
    read: None,
    open: Some(open),
};

/// Types of components.
const FLOAT: u32 = 5126;
const INDEX: u32 = 5125;
/// Ways of drawing.
const DRAWN_POINTS: u32 = 0;
const DRAWN_LOOP: u32 = 2;
const DRAWN_LINE: u32 = 3;
const DRAWN_TRIANGLES: u32 = 4;
/// How far the length of a normal may be from 1: that of the validator of the format, half of it to be safe.
const UNIT: f64 = 2.5e-4;

/// About the size of the description of a shape.
const NODE_BYTES: usize = 2048;

struct File<'a> {
    output: Output<'a>,
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    /// Number of bytes of the descriptions.
    described: usize,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(File {
        output,
        bytes: Vec::new(),
        views: Vec::new(),
        accessors: Vec::new(),
        meshes: Vec::new(),
        nodes: Vec::new(),
        described: 0,
        summary: Summary::default(),
    }))
}

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let part = Part::of(record, "glTF")?;
        if part.points().is_empty() {
            return Err(refused(record, "glTF", "no points"));
        }
        let positions = singles(record, part.points(), "glTF")?;
        let mut attributes = serde_json::Map::new();
        attributes.insert("POSITION".into(), self.floats(&positions, 3, true).into());
        self.attributes(part, record, &mut attributes);
        let primitive = match part {
            Part::Mesh(mesh) if !mesh.faces.is_empty() => {
                if mesh.faces.iter().any(|face| face.len() > 3) && self.summary.warnings.is_empty() {
                    self.summary.warnings.push("polygons are fans of triangles".into());
                }
                let indices: Vec<u32> = mesh.faces.triangles().flatten().collect();
                let indices = self.indices(&indices);
                json!({ "attributes": attributes, "indices": indices, "mode": DRAWN_TRIANGLES })
            }
            // The standard has no empty array of indices.
            Part::Mesh(_) | Part::Points(_) => json!({ "attributes": attributes, "mode": DRAWN_POINTS }),
            Part::Curve(_, true) => json!({ "attributes": attributes, "mode": DRAWN_LOOP }),
            Part::Curve(_, false) => json!({ "attributes": attributes, "mode": DRAWN_LINE }),
        };
        let mut node = json!({ "mesh": self.meshes.len() });
        if let Some(name) = &record.name {
            node["name"] = name.as_str().into();
        }
        self.meshes.push(json!({ "primitives": [primitive] }));
        self.nodes.push(node);
        self.described += NODE_BYTES + record.name.as_ref().map_or(0, String::len);
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.bytes.len() + self.described
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let mut document = json!({ "asset": { "version": "2.0", "generator": "Shapelex" } });
        if !self.nodes.is_empty() {
            let all: Vec<usize> = (0..self.nodes.len()).collect();
            document["scene"] = 0.into();
            document["scenes"] = json!([{ "nodes": all }]);
            document["nodes"] = std::mem::take(&mut self.nodes).into();
            document["meshes"] = std::mem::take(&mut self.meshes).into();
            document["accessors"] = std::mem::take(&mut self.accessors).into();
            document["bufferViews"] = std::mem::take(&mut self.views).into();
            document["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        // Every array is one of numbers of four bytes: the length is a multiple of 4.
        let chunks = if self.bytes.is_empty() { 0 } else { 8 + self.bytes.len() };
        let length = |count: usize| {
            u32::try_from(count).map(u32::to_le_bytes).map_err(|_| {
                FileError::too_large(
                    super::super::Place::default(),
                    "expected less than 4 GiB of glTF, got more",
                )
            })
        };
        self.output.write_all(&[&b"glTF\x02\0\0\0"[..], &length(20 + text.len() + chunks)?].concat())?;
        self.output.write_all(&[&length(text.len())?[..], b"JSON", &text].concat())?;
        if chunks > 0 {
            self.output.write_all(&[&length(self.bytes.len())?[..], b"BIN\0"].concat())?;
            self.output.write_all(&self.bytes)?;
        }
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl File<'_> {
    /// Adds the fields that glTF has a place for, and counts all that it has none for.
    fn attributes(
        &mut self,
        part: Part<'_>,
        record: &Record,
        attributes: &mut serde_json::Map<String, Value>,
    ) {
        let mut written = Vec::new();
        let is_unit = |row: &[f64]| (row[0].hypot(row[1]).hypot(row[2]) - 1.0).abs() <= UNIT;
        let normals =
            part.vertex_field(NORMALS, &[3]).filter(|field| field.values.chunks_exact(3).all(is_unit));
        let places =
            part.vertex_field(TEXTURE, &[2]).filter(|field| field.values.iter().all(|x| x.is_finite()));
        let colours = part.vertex_field(COLOURS, &[3, 4]).and_then(|field| {
            let largest = field.values.iter().fold(0.0, |a: f64, b| a.max(*b));
            let scale = if largest > 1.0 { 255.0 } else { 1.0 };
            let fits = |x: &f64| (0.0..=scale).contains(x);
            field.values.iter().all(fits).then_some((field, scale))
        });
        if let Some(field) = normals {
            let values: Vec<f32> = field.values.iter().map(|x| *x as f32).collect();
            attributes.insert("NORMAL".into(), self.floats(&values, 3, false).into());
            written.push(NORMALS);
        }
        if let Some(field) = places {
            // The picture begins with its upper row.
            let flipped = field.values.chunks_exact(2).flat_map(|row| [row[0] as f32, (1.0 - row[1]) as f32]);
            attributes
                .insert("TEXCOORD_0".into(), self.floats(&flipped.collect::<Vec<_>>(), 2, false).into());
            written.push(TEXTURE);
        }
        if let Some((field, scale)) = colours {
            let values: Vec<f32> = field.values.iter().map(|x| (x / scale) as f32).collect();
            attributes.insert("COLOR_0".into(), self.floats(&values, field.width, false).into());
            written.push(COLOURS);
        }
        count_lost(part, record, &[], &mut self.summary, |name, _| written.contains(&name));
    }

    fn floats(&mut self, values: &[f32], width: usize, bounds: bool) -> usize {
        let mut accessor = json!({
            "componentType": FLOAT,
            "count": values.len() / width,
            "type": if width == 2 { "VEC2" } else if width == 3 { "VEC3" } else { "VEC4" },
        });
        if bounds {
            let all = |axis: usize| values.iter().skip(axis).step_by(width).copied();
            accessor["min"] = (0..width).map(|axis| all(axis).fold(f32::INFINITY, f32::min)).collect();
            accessor["max"] = (0..width).map(|axis| all(axis).fold(f32::NEG_INFINITY, f32::max)).collect();
        }
        self.add(values.iter().flat_map(|value| value.to_le_bytes()).collect(), 34962, accessor)
    }

    fn indices(&mut self, values: &[u32]) -> usize {
        let accessor = json!({ "componentType": INDEX, "count": values.len(), "type": "SCALAR" });
        self.add(values.iter().flat_map(|value| value.to_le_bytes()).collect(), 34963, accessor)
    }

    /// Adds an array. Returns the position of its accessor.
    fn add(&mut self, bytes: Vec<u8>, target: u32, mut accessor: Value) -> usize {
        accessor["bufferView"] = self.views.len().into();
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(), "target": target
        }));
        self.bytes.extend(bytes);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::super::record::{Domain, Faces, Field, Geometry, Mesh, Points};
    use super::super::testing::write;
    use super::*;
    use crate::shape::Place;

    fn square() -> Record {
        let mut faces = Faces::default();
        faces.push([0, 1, 2, 3]);
        let field =
            |width, values: &[f64]| Field { domain: Domain::Vertices, width, values: values.to_vec() };
        let fields = BTreeMap::from([
            (NORMALS.into(), field(3, &[0.0, 0.0, 1.0].repeat(4))),
            (TEXTURE.into(), field(2, &[0.0, 0.25].repeat(4))),
            (COLOURS.into(), field(3, &[255.0, 0.0, 51.0].repeat(4))),
            ("thickness".into(), field(1, &[1.0; 4])),
        ]);
        let vertices =
            Points::from_rows(3, vec![0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 1.0, -0.5]);
        Record { name: Some("a b".into()), ..Record::new(Mesh { vertices, faces, fields }, Place::default()) }
    }

    #[test]
    fn chunks_and_accessors_are_those_of_the_standard() {
        let line = Points::from_rows(3, vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        let line = Record::new(Geometry::Curve { points: line, closed: false }, Place::default());
        let bytes = write(&FORMAT, &[square(), line], &WriteOptions::default()).unwrap();
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], number(4), number(8)), (&b"glTF"[..], 2, bytes.len()));
        let text = number(12);
        assert_eq!(
            (&bytes[16..20], text % 4, &bytes[24 + text..28 + text]),
            (&b"JSON"[..], 0, &b"BIN\0"[..])
        );
        let document: Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        assert_eq!(document["buffers"][0]["byteLength"], number(20 + text));
        assert_eq!(document["nodes"][0], json!({ "mesh": 0, "name": "a b" }));
        let positions = &document["accessors"][0];
        assert_eq!(
            (&positions["min"], &positions["max"]),
            (&json!([0.0, 0.0, -0.5]), &json!([2.0, 1.0, 0.0]))
        );
        let values = |accessor: usize| {
            let view = &document["bufferViews"]
                [document["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize];
            let start = 28 + text + view["byteOffset"].as_u64().unwrap() as usize;
            bytes[start..start + view["byteLength"].as_u64().unwrap() as usize].to_vec()
        };
        let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
        let colours = values(attributes["COLOR_0"].as_u64().unwrap() as usize);
        assert_eq!(colours[8..12], 0.2_f32.to_le_bytes());
        let places = values(attributes["TEXCOORD_0"].as_u64().unwrap() as usize);
        assert_eq!(places[4..8], 0.75_f32.to_le_bytes());
        let indices = values(document["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize);
        assert_eq!(indices, [0_u32, 1, 2, 0, 2, 3].map(u32::to_le_bytes).concat());
        assert_eq!(document["meshes"][1]["primitives"][0]["mode"], 3);
    }

    #[test]
    fn vertices_without_faces_are_drawn_as_points() {
        let mut record = square();
        let Geometry::Mesh(mesh) = &mut record.geometry else { panic!("no mesh") };
        mesh.faces = Faces::default();
        let bytes = write(&FORMAT, &[record], &WriteOptions::default()).unwrap();
        let text = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document: Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let primitive = &document["meshes"][0]["primitives"][0];
        assert_eq!((&primitive["mode"], primitive.get("indices")), (&json!(0), None));
        let lengths: Vec<_> = document["bufferViews"].as_array().unwrap().iter().collect();
        assert!(lengths.iter().all(|view| view["byteLength"].as_u64().unwrap() > 0), "{lengths:?}");
    }

    #[test]
    fn what_is_left_out_is_counted() {
        let mut bytes = Vec::new();
        let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).unwrap();
        writer.push(&square()).unwrap();
        let mut far = square();
        let Geometry::Mesh(mesh) = &mut far.geometry else { panic!("no mesh") };
        mesh.vertices = Points::from_rows(3, vec![1e39; 12]);
        let error = writer.push(&far).unwrap_err().to_string();
        assert_eq!(
            error,
            "expected shapes in space that glTF can hold, got coordinates beyond single precision of shape 'a b'"
        );
        let summary = writer.finish().unwrap();
        assert_eq!((summary.dropped[0].names.join(" "), summary.warnings.len()), ("thickness".into(), 1));
    }
}
