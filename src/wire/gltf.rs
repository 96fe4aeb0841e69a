//! Binary glTF 2.0 files (GLB): one mesh, with displacements to other shapes of it (morph targets).
//!
//! A displacement has the weight 0 at first; the weight 1 gives its shape, and weights between, beyond and below follow along
//! the line through both. Each displacement has an animation that moves its weight from 0 to 1, to −1 and back; or one animation
//! goes from the mesh through all of them. Names are in `extras.targetNames`, where programs look for them.

use std::borrow::Cow;
use std::ops::Range;

use serde_json::{Value, json};

use super::files::{FileError, Place};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::texture::{Texture, TexturedMesh};
use crate::geometry::vector::minus;

/// A displacement of the vertices of a mesh.
#[derive(Debug, Clone)]
pub struct Displacement {
    /// Name.
    pub name: String,
    /// The mesh at the weight 1, with as many vertices.
    pub mesh: TriangleMesh,
    /// Further facts about it.
    pub extras: Value,
}

/// How the displacements of a mesh are played.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Play {
    /// Each has a separate animation.
    Each,
    /// One animation goes from the mesh through all of them in order, and back.
    Sequence,
}

/// Seconds of an animation through all displacements, in one direction.
const SEQUENCE: f32 = 2.0;

/// Weights of a displacement during its animation, one each second.
const WEIGHTS: [f32; 5] = [0.0, 1.0, 0.0, -1.0, 0.0];

const FLOAT: u32 = 5126;
const UNSIGNED: u32 = 5125;
const INDICES: u32 = 34963;
const VERTICES: u32 = 34962;

/// The binary part of a file with its description.
#[derive(Debug, Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds a view of `bytes` and an accessor; returns the index of the accessor.
    fn push(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>, mut accessor: Value) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": offset, "byteLength": self.bytes.len() - offset});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(view);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn push_indices(&mut self, faces: &[[u32; 3]]) -> usize {
        let accessor = json!({"componentType": UNSIGNED, "count": 3 * faces.len(), "type": "SCALAR"});
        self.push(faces.iter().flatten().flat_map(|vertex| vertex.to_le_bytes()), Some(INDICES), accessor)
    }

    /// Adds positions, or displacements of them, with their bounds.
    fn push_positions(&mut self, points: &[[f64; 3]]) -> usize {
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            let fold = |c: usize| points.iter().map(|point| point[c] as f32).fold(start, pick);
            [fold(0), fold(1), fold(2)]
        };
        let accessor = json!({"componentType": FLOAT, "count": points.len(), "type": "VEC3",
            "min": bound(f32::min, f32::MAX), "max": bound(f32::max, f32::MIN)});
        self.push(points.iter().flat_map(|point| single(*point)), Some(VERTICES), accessor)
    }

    fn push_normals(&mut self, normals: &[[f64; 3]]) -> usize {
        let accessor = json!({"componentType": FLOAT, "count": normals.len(), "type": "VEC3"});
        self.push(normals.iter().flat_map(|normal| single(*normal)), Some(VERTICES), accessor)
    }

    fn push_places(&mut self, places: &[[f64; 2]]) -> usize {
        let accessor = json!({"componentType": FLOAT, "count": places.len(), "type": "VEC2"});
        let bytes = places.as_flattened().iter().flat_map(|place| (*place as f32).to_le_bytes());
        self.push(bytes, Some(VERTICES), accessor)
    }

    fn push_numbers(&mut self, numbers: &[f32]) -> usize {
        let bound = |pick: fn(f32, f32) -> f32, start: f32| [numbers.iter().copied().fold(start, pick)];
        let accessor = json!({"componentType": FLOAT, "count": numbers.len(), "type": "SCALAR",
            "min": bound(f32::min, f32::MAX), "max": bound(f32::max, f32::MIN)});
        self.push(numbers.iter().flat_map(|number| number.to_le_bytes()), None, accessor)
    }

    /// Positions and normals of a mesh, or their differences from those of another.
    fn push_attributes(&mut self, mesh: &TriangleMesh, from: Option<&TriangleMesh>) -> Value {
        let less = |points: &[[f64; 3]], others: Option<&Vec<[f64; 3]>>| match others {
            Some(others) => points.iter().zip(others).map(|(a, b)| minus(*a, *b)).collect(),
            None => points.to_vec(),
        };
        let positions = less(&mesh.vertices, from.map(|mesh| &mesh.vertices));
        let mut attributes = json!({"POSITION": self.push_positions(&positions)});
        let base = from.map(|mesh| mesh.normals.as_ref());
        if let (Some(normals), None | Some(Some(_))) = (&mesh.normals, base) {
            attributes["NORMAL"] = json!(self.push_normals(&less(normals, base.flatten())));
        }
        attributes
    }
}

/// A point in single precision.
fn single(point: [f64; 3]) -> impl Iterator<Item = u8> {
    point.into_iter().flat_map(|value| (value as f32).to_le_bytes())
}

/// Largest coordinate: the difference of two is a number of single precision.
const MOST: f64 = f32::MAX as f64 / 2.0;

/// Bytes of a displacement of so many vertices, each with a normal, at least.
pub const fn displacement_bytes(vertices: usize) -> usize {
    vertices.saturating_mul(2 * 3 * size_of::<f32>())
}

/// Writes a mesh with its displacements, which are asked for one after the other. With texture coordinates, it has one vertex for
/// each of their places.
///
/// # Errors
/// Coordinates beyond single precision; those of the displacements.
pub fn write<E: From<FileError>>(
    textured: &TexturedMesh,
    displacements: impl IntoIterator<Item = Result<Displacement, E>>,
    play: Play,
) -> Result<Vec<u8>, E> {
    let texture = textured.texture.as_ref();
    check_near(&textured.mesh)?;
    let mesh = by_place(texture, &textured.mesh);
    let mut buffer = Buffer::default();
    let indices = buffer.push_indices(&mesh.faces);
    let mut attributes = buffer.push_attributes(&mesh, None);
    if let Some(texture) = texture {
        attributes["TEXCOORD_0"] = json!(buffer.push_places(&texture.places));
    }
    let mut targets = Targets::default();
    for displacement in displacements {
        let Displacement { name, mesh: to, extras } = displacement?;
        check_near(&to)?;
        targets.attributes.push(buffer.push_attributes(&by_place(texture, &to), Some(&mesh)));
        targets.names.push(name);
        targets.extras.push(extras);
    }
    let primitive = json!({"attributes": attributes, "indices": indices});
    Ok(file(buffer, primitive, targets, play))
}

fn check_near(mesh: &TriangleMesh) -> Result<(), FileError> {
    match mesh.vertices.as_flattened().iter().find(|x| !(x.abs() <= MOST)) {
        None => Ok(()),
        Some(far) => {
            let detail = format!(
                "expected coordinates in single precision, as glTF has them (±{MOST:.1e}), got {far:e}"
            );
            Err(FileError::unsupported(Place::default(), detail))
        }
    }
}

/// Displacements whose numbers are in the buffer.
#[derive(Debug, Default)]
struct Targets {
    attributes: Vec<Value>,
    names: Vec<String>,
    extras: Vec<Value>,
}

fn file(mut buffer: Buffer, mut primitive: Value, targets: Targets, play: Play) -> Vec<u8> {
    let mut body = json!({});
    let mut animations = Vec::new();
    let Targets { attributes, names, extras } = targets;
    if !names.is_empty() {
        primitive["targets"] = json!(attributes);
        body["weights"] = json!(vec![0; names.len()]);
        body["extras"] = json!({"targetNames": names, "targets": extras});
        animations = match play {
            Play::Each => animate(&mut buffer, &names),
            Play::Sequence => vec![animate_through(&mut buffer, names.len())],
        };
    }
    body["primitives"] = json!([primitive]);
    let mut document = json!({
        "asset": {"version": "2.0", "generator": "shapelex"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [body],
        "accessors": buffer.accessors, "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.bytes.len()}],
    });
    if !animations.is_empty() {
        document["animations"] = json!(animations);
    }
    chunks(&document, buffer.bytes)
}

/// The mesh with one vertex for each place of its texture, if it has one.
fn by_place<'a>(texture: Option<&Texture>, mesh: &'a TriangleMesh) -> Cow<'a, TriangleMesh> {
    texture.map_or(Cow::Borrowed(mesh), |texture| Cow::Owned(texture.split(mesh)))
}

/// The animation from the mesh through `count` displacements and back, with one of them at full weight at each time.
fn animate_through(buffer: &mut Buffer, count: usize) -> Value {
    // Frame 0 is the mesh itself; there and back.
    let frames: Vec<usize> = (0..=count).chain((0..count).rev()).collect();
    let seconds: Vec<f32> = (0..frames.len()).map(|k| SEQUENCE * k as f32 / count as f32).collect();
    let input = buffer.push_numbers(&seconds);
    let weights = frames.iter().flat_map(|frame| (1..=count).map(move |k| f32::from(u8::from(k == *frame))));
    let output = buffer.push_numbers(&weights.collect::<Vec<_>>());
    json!({"name": "path",
        "samplers": [{"input": input, "output": output, "interpolation": "LINEAR"}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]})
}

/// One animation for each displacement.
fn animate(buffer: &mut Buffer, names: &[String]) -> Vec<Value> {
    let seconds: Range<u8> = 0..WEIGHTS.len() as u8;
    let input = buffer.push_numbers(&seconds.map(f32::from).collect::<Vec<_>>());
    let animation = |(k, name): (usize, &String)| {
        let weights = WEIGHTS
            .iter()
            .flat_map(|weight| (0..names.len()).map(move |other| if other == k { *weight } else { 0.0 }));
        let output = buffer.push_numbers(&weights.collect::<Vec<_>>());
        json!({"name": name,
            "samplers": [{"input": input, "output": output, "interpolation": "LINEAR"}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}]})
    };
    names.iter().enumerate().map(animation).collect()
}

/// A header, a JSON chunk and a binary chunk, each padded to four bytes.
fn chunks(document: &Value, numbers: Vec<u8>) -> Vec<u8> {
    let document = padded(document.to_string().into_bytes(), b' ');
    let numbers = padded(numbers, 0);
    let length = 12 + 8 + document.len() + 8 + numbers.len();
    let mut file = Vec::with_capacity(length);
    file.extend(b"glTF");
    file.extend(2_u32.to_le_bytes());
    file.extend((length as u32).to_le_bytes());
    for (name, bytes) in [(*b"JSON", document), (*b"BIN\0", numbers)] {
        file.extend((bytes.len() as u32).to_le_bytes());
        file.extend(name);
        file.extend(bytes);
    }
    file
}

fn padded(mut bytes: Vec<u8>, with: u8) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(4), with);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(height: f64) -> TriangleMesh {
        TriangleMesh {
            vertices: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, height]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            faces: vec![[0, 1, 2]],
        }
    }

    fn written<const K: usize>(mesh: &TexturedMesh, displacements: [Displacement; K], play: Play) -> Vec<u8> {
        write::<FileError>(mesh, displacements.map(Ok), play).unwrap()
    }

    /// The document and the binary part of a file, whose lengths are checked.
    fn parts(file: &[u8]) -> (Value, &[u8]) {
        let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((number(4), number(8)), (2, file.len()));
        let json: Value = serde_json::from_slice(&file[20..20 + number(12)]).unwrap();
        let binary = 20 + number(12);
        assert_eq!(&file[binary + 4..binary + 8], b"BIN\0");
        assert!(number(binary) >= json["buffers"][0]["byteLength"].as_u64().unwrap() as usize);
        (json, &file[binary + 8..])
    }

    #[test]
    fn files_have_the_length_that_they_state() {
        let file = written(&triangle(0.5).into(), [], Play::Each);
        let (json, binary) = parts(&file);
        assert_eq!(json["buffers"][0]["byteLength"], binary.len());
        assert_eq!(json["accessors"][1]["max"], json!([2.0, 1.0, 0.5]));
        assert_eq!(json["bufferViews"][2]["byteOffset"], 12 + 36);
        assert!(json["animations"].is_null() && json["meshes"][0]["weights"].is_null());
    }

    #[test]
    fn textures_repeat_vertices_and_paths_are_played_in_order() {
        // Both ends of an edge of the same place: a mesh of two faces that is closed along one direction.
        let texture = Texture {
            places: vec![[0.0, 0.0], [1.0, 0.0], [0.5, 1.0], [0.0, 1.0]],
            faces: vec![[0, 1, 2], [3, 1, 2]],
        };
        let two = |height: f64| TriangleMesh { faces: vec![[0, 1, 2], [0, 1, 2]], ..triangle(height) };
        let to =
            |height: f64| Displacement { name: format!("{height}"), mesh: two(height), extras: json!({}) };
        let textured = TexturedMesh { mesh: two(0.0), texture: Some(texture) };
        let file = written(&textured, [to(1.0), to(2.0), to(3.0)], Play::Sequence);
        let (json, binary) = parts(&file);
        let primitive = &json["meshes"][0]["primitives"][0];
        let accessor = |k: &Value| &json["accessors"][k.as_u64().unwrap() as usize];
        for kind in ["POSITION", "NORMAL", "TEXCOORD_0"] {
            assert_eq!(accessor(&primitive["attributes"][kind])["count"], 4, "{kind}");
        }
        assert_eq!(accessor(&primitive["targets"][1]["POSITION"])["count"], 4);
        assert_eq!(json["animations"].as_array().unwrap().len(), 1);
        let sampler = &json["animations"][0]["samplers"][0];
        assert_eq!(accessor(&sampler["input"])["count"], 7);
        assert_eq!(accessor(&sampler["input"])["max"], json!([4.0]));
        let view =
            &json["bufferViews"][accessor(&sampler["output"])["bufferView"].as_u64().unwrap() as usize];
        let at = view["byteOffset"].as_u64().unwrap() as usize;
        let weight = |k: usize| f32::from_le_bytes(binary[at + 4 * k..at + 4 * k + 4].try_into().unwrap());
        let frame = |k: usize| [0, 1, 2].map(|target| weight(3 * k + target));
        assert_eq!(
            [0, 1, 3, 4, 6].map(frame),
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0; 3]]
        );
    }

    #[test]
    fn displacements_have_names_and_animations() {
        let to = |name: &str, height: f64| Displacement {
            name: name.into(),
            mesh: triangle(height),
            extras: json!({"explained": 0.5}),
        };
        let displacements = [to("mode 1", 2.5), to("mode 2", -0.5)];
        let file = written(&triangle(0.5).into(), displacements, Play::Each);
        let (json, binary) = parts(&file);
        let mesh = &json["meshes"][0];
        assert_eq!(mesh["weights"], json!([0, 0]));
        assert_eq!(mesh["extras"]["targetNames"], json!(["mode 1", "mode 2"]));
        let targets = &mesh["primitives"][0]["targets"];
        let accessor = |k: &Value| &json["accessors"][k.as_u64().unwrap() as usize];
        assert_eq!(accessor(&targets[0]["POSITION"])["max"], json!([0.0, 0.0, 2.0]));
        assert_eq!(accessor(&targets[1]["POSITION"])["min"], json!([0.0, 0.0, -1.0]));
        assert_eq!(accessor(&targets[1]["NORMAL"])["count"], 3);
        assert_eq!(json["animations"][1]["name"], "mode 2");
        let output = accessor(&json["animations"][1]["samplers"][0]["output"]);
        assert_eq!(output["count"], 2 * WEIGHTS.len());
        let view = &json["bufferViews"][output["bufferView"].as_u64().unwrap() as usize];
        let at = view["byteOffset"].as_u64().unwrap() as usize;
        let weight = |k: usize| f32::from_le_bytes(binary[at + 4 * k..at + 4 * k + 4].try_into().unwrap());
        assert_eq!([2, 3, 6, 7].map(weight), [0.0, 1.0, 0.0, -1.0]);
        for view in json["bufferViews"].as_array().unwrap() {
            assert_eq!(view["byteOffset"].as_u64().unwrap() % 4, 0);
        }
    }
}
