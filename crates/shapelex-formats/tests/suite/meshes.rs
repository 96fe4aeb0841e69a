//! Meshes of other programs beside the checkout, compared with their list of contents, which trimesh made.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use shapelex_formats::shape::{
    Encoding, Faces, Geometry, Limits, Mesh, ReadOptions, Record, Source, Summary, WriteOptions, detect,
    find, read,
};

use crate::data::load;

/// trimesh merges vertices whose coordinates agree to this.
const MERGED: f64 = 1e-8;

/// All records of a file.
fn records(name: &str, bytes: &[u8]) -> (Vec<Record>, Summary) {
    let mut found = Vec::new();
    let mut source = Source::new(bytes, Limits::default()).unwrap();
    let file_name = Path::new(name).file_name().and_then(|name| name.to_str());
    let format = detect(source.head(), file_name).unwrap();
    let summary = read(format, &mut source, &ReadOptions::default(), &mut |record| {
        found.push(record);
        Ok(())
    });
    (found, summary.unwrap_or_else(|error| panic!("{name}: {error}")))
}

fn meshes(records: &[Record]) -> impl Iterator<Item = &Mesh> {
    records.iter().filter_map(|record| match &record.geometry {
        Geometry::Mesh(mesh) => Some(mesh),
        _ => None,
    })
}

/// What the list of contents says of a file.
#[derive(Debug, PartialEq)]
struct Figures {
    triangles: usize,
    merged: usize,
    watertight: bool,
    euler: i64,
}

impl Figures {
    /// Of all meshes together, after merging vertices that nearly agree.
    fn of(records: &[Record]) -> Self {
        let mut known = BTreeMap::new();
        let mut triangles = 0;
        let mut edges: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        for mesh in meshes(records) {
            let rows: Vec<&[f64]> = mesh.vertices.rows().collect();
            for triangle in mesh.faces.triangles() {
                triangles += 1;
                let corners = triangle.map(|vertex| {
                    let row = rows[vertex as usize];
                    let key: Vec<i64> = row.iter().map(|x| (x / MERGED).round() as i64).collect();
                    let next = known.len();
                    *known.entry(key).or_insert(next)
                });
                for k in 0..3 {
                    let (a, b) = (corners[k], corners[(k + 1) % 3]);
                    *edges.entry((a.min(b), a.max(b))).or_default() += 1;
                }
            }
        }
        let watertight = triangles > 0 && edges.values().all(|count| *count == 2);
        let euler = known.len() as i64 - edges.len() as i64 + triangles as i64;
        Self { triangles, merged: known.len(), watertight, euler }
    }
}

#[test]
fn all_files_hold_what_their_list_says() {
    let Some(contents) = load("formats-meshes/contents.json") else { return };
    let contents: Vec<serde_json::Value> = serde_json::from_slice(&contents).unwrap();
    for entry in &contents {
        let name = entry["file"].as_str().unwrap();
        let (found, summary) = records(name, &load(&format!("formats-meshes/{name}")).unwrap());
        let points: usize = found
            .iter()
            .map(|record| match &record.geometry {
                Geometry::Mesh(mesh) => mesh.vertices.len(),
                Geometry::Landmarks(points) => points.len(),
                other => panic!("{name}: {other:?}"),
            })
            .sum();
        let Some(cells) = entry["cells"].as_u64() else { continue };
        let figures = Figures::of(&found);
        assert_eq!(figures.triangles as u64, cells, "{name}");
        if let Some(merged) = entry["merged_points"].as_u64() {
            let expected = Figures {
                triangles: figures.triangles,
                merged: merged as usize,
                watertight: entry["watertight"].as_bool().unwrap(),
                euler: entry["euler"].as_i64().unwrap(),
            };
            assert_eq!(figures, expected, "{name}");
        }
        // STL has no shared vertices, and trimesh splits those with several texture coordinates or normals.
        let split = ["fuze.ply"].contains(&name) || name.ends_with(".obj");
        let merged = summary.properties.get("merged_corners").and_then(serde_json::Value::as_u64);
        match merged {
            Some(merged) if entry["encoding"] == "binary" => {
                assert_eq!(points as u64 + merged, entry["points"].as_u64().unwrap(), "{name}");
            }
            Some(_) => {}
            None if split => {}
            None => assert_eq!(points as u64, entry["points"].as_u64().unwrap(), "{name}"),
        }
    }
}

#[test]
fn names_and_fields_are_kept() {
    let Some(bytes) = load("formats-meshes/two_objects_mixed_case_names.stl") else { return };
    let (found, _) = records("a.stl", &bytes);
    let names: Vec<_> = found.iter().map(|record| record.name.as_deref()).collect();
    assert_eq!(names, [Some("CubeExportedFromCAD"), Some("TranslatedCubeExportedFromCAD")]);
    let fields = |name: &str| -> BTreeSet<String> {
        let (found, _) = records(name, &load(&format!("formats-meshes/{name}")).unwrap());
        meshes(&found).flat_map(|mesh| mesh.fields.keys().cloned()).collect()
    };
    for (name, expected) in [
        ("cycloidal.ply", &["colours", "face_colours"][..]),
        ("fuze.ply", &["colours", "face_colours", "texcoord"]),
        ("plane.ply", &["normals", "texture_coordinates"]),
        ("multi.ply", &["colours", "texture_coordinates"]),
        ("nancolor.obj", &["colours"]),
        ("singlevn.obj", &["normals", "texture_coordinates"]),
        ("comments.off", &["colours"]),
        ("scalismo_unit-sphere.vtk", &["normals"]),
    ] {
        assert_eq!(fields(name).iter().map(String::as_str).collect::<Vec<_>>(), expected, "{name}");
    }
    let (found, summary) = records("ascii.stl.zip", &load("formats-meshes/ascii.stl.zip").unwrap());
    assert_eq!(found[0].place.entry.as_deref(), Some("fuji_obj.stl"));
    assert_eq!(summary.dropped[0].names, ["__MACOSX/._fuji_obj.stl"]);
}

/// Signed volume of triangles.
fn volume(vertices: &[f64], faces: &Faces) -> f64 {
    let point = |k: u32| [0, 1, 2].map(|axis| vertices[3 * k as usize + axis]);
    let determinant = |[a, b, c]: [[f64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    faces.triangles().map(|face| determinant(face.map(point)) / 6.0).sum()
}

#[test]
fn the_same_surface_is_the_same_in_two_formats() {
    let Some(bytes) = load("formats-meshes/fsaverage5_white_left.gii.gz") else { return };
    let (gifti, _) = records("a.gii.gz", &bytes);
    let (ply, _) = records("left_white.ply", &load("surfaces-fsaverage5/left_white.ply").unwrap());
    let (Some(a), Some(b)) = (meshes(&gifti).next(), meshes(&ply).next()) else { panic!("no meshes") };
    assert_eq!((&a.vertices, &a.faces), (&b.vertices, &b.faces));
    // Outward orientation: the volume is positive.
    assert!(volume(a.vertices.coordinates(), &a.faces) > 1e5);
}

#[test]
fn what_is_written_comes_back_exactly() {
    for name in [
        "formats-meshes/cycloidal.ply",
        "surfaces-spot/spot_control_mesh.obj",
        "surfaces-fsaverage5/left_pial.ply",
    ] {
        let Some(bytes) = load(name) else { continue };
        let (found, _) = records(name, &bytes);
        for (format, encoding) in [
            ("obj", Encoding::Text),
            ("ply", Encoding::Text),
            ("ply", Encoding::Binary),
            ("vtk", Encoding::Text),
            ("vtk", Encoding::Binary),
        ] {
            let mut written = Vec::new();
            let options = WriteOptions { encoding: Some(encoding), ..WriteOptions::default() };
            let mut writer = find(format).unwrap().writer(&mut written, &options).unwrap();
            found.iter().for_each(|record| writer.push(record).unwrap());
            writer.finish().unwrap();
            let (again, _) = records(&format!("a.{format}"), &written);
            for (a, b) in meshes(&found).zip(meshes(&again)) {
                assert_eq!((&a.vertices, &a.faces), (&b.vertices, &b.faces), "{name} {format}");
                for (field, values) in a.fields.iter().filter(|_| format != "obj") {
                    assert_eq!(Some(values), b.fields.get(field), "{name} {format} {field}");
                }
            }
            assert_eq!(again.len(), found.len());
        }
    }
}

#[test]
fn real_files_cut_off_are_refused_or_read_without_a_panic() {
    let names = [
        "tet.ply",
        "ballA.off",
        "7_8ths_cube.stl",
        "ascii.stl.zip",
        "cubevt.obj",
        "scalismo_unit-sphere.vtk",
    ];
    for name in names {
        let Some(bytes) = load(&format!("formats-meshes/{name}")) else { continue };
        for length in (0..bytes.len()).step_by(bytes.len() / 40) {
            let Ok(mut source) = Source::new(&bytes[..length], Limits::default()) else { continue };
            let Ok(format) = detect(source.head(), Some(name)) else { continue };
            let cut = read(format, &mut source, &ReadOptions::default(), &mut |_| Ok(()));
            // A text of OBJ may end after any line.
            assert!(cut.is_err() || name.ends_with(".obj"), "{name}, {length} bytes");
        }
    }
}
