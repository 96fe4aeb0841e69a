use super::super::super::FaultKind;
use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Geometry};
use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal, write};
use super::super::{COLOURS, NORMALS, TEXTURE};
use super::*;
use crate::shape::{Limits, Place, Points, Record};

const TWO: &str = "\
# two shapes
mtllib a.mtl
v 9 9 9
o first one
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 0 1 0 nan nan nan
vt 0 0
vt 1 0.5
vn 0 0 1
g left
f 2/1/1 3/2/1 4//1
g right
usemtl red
f -2 -1 \\
 -3
o second
v 0 0 2
f 2/1 5/2 3/1 4/2
l 2 3
";

#[test]
fn objects_are_shapes_of_their_own() {
    let (found, summary) = read(&FORMAT, TWO.as_bytes()).unwrap();
    let names: Vec<_> = found.iter().map(|r| (r.name.as_deref(), r.place.line)).collect();
    assert_eq!(names, [(Some("first one"), Some(4)), (Some("second"), Some(17))]);
    let first = mesh(&found[0]);
    assert_eq!(first.vertices.coordinates(), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    assert_eq!(first.faces.iter().collect::<Vec<_>>(), [[0, 1, 2], [1, 2, 0]]);
    assert_eq!(first.fields[COLOURS].values[..6], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    assert!(first.fields[COLOURS].values[6..].iter().all(|x| x.is_nan()));
    // The second face has no normals: those of its corners differ from those of the first.
    assert_eq!(
        (first.fields["normals_of_corners"].width, first.fields["normals_of_corners"].domain),
        (9, Domain::Faces)
    );
    assert_eq!(first.fields["group"].values, [0.0, 1.0]);
    assert_eq!(found[0].metadata["groups"], serde_json::json!(["left", "right"]));
    assert_eq!(found[0].metadata["materials"], serde_json::json!(["", "red"]));
    let second = mesh(&found[1]);
    assert_eq!(second.vertices.len(), 4);
    assert_eq!(second.faces.iter().collect::<Vec<_>>(), [[0, 3, 1, 2]]);
    assert_eq!(second.fields[TEXTURE].values, [0.0, 0.0, 0.0, 0.0, 1.0, 0.5, 1.0, 0.5]);
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    let expected =
        [("references to other files", 1), ("vertices of no face", 1), ("lines beside the faces", 1)];
    assert_eq!(dropped, expected);
}

#[test]
fn what_is_written_comes_back() {
    let (found, _) = read(&FORMAT, TWO.as_bytes()).unwrap();
    let bytes = write(&FORMAT, &found, &WriteOptions::default()).unwrap();
    let (again, _) = read(&FORMAT, &bytes).unwrap();
    assert_eq!(again.len(), 2);
    for (a, b) in found.iter().zip(&again) {
        assert_eq!((&a.name, &a.metadata), (&b.name, &b.metadata));
        assert_eq!((&mesh(a).vertices, &mesh(a).faces), (&mesh(b).vertices, &mesh(b).faces));
        // NaN is not equal to itself: as text.
        assert_eq!(format!("{:?}", mesh(a).fields), format!("{:?}", mesh(b).fields));
    }
}

#[test]
fn curves_and_points_come_back() {
    let text = "o a\nv 0.1 0 0\nv 1 0 1e-7\nv 0 1 0\nl 1 2 3 1\n";
    let (found, _) = read(&FORMAT, text.as_bytes()).unwrap();
    assert!(matches!(&found[0].geometry, Geometry::Curve { points, closed: true } if points.len() == 3));
    let written = write(&FORMAT, &found, &WriteOptions::default()).unwrap();
    assert_eq!(String::from_utf8(written).unwrap(), text.replace("1e-7", "0.0000001"));
    let (found, summary) = read(&FORMAT, b"v 1 2 3\nvn 0 0 1\n").unwrap();
    assert!(matches!(&found[0].geometry, Geometry::Landmarks(points) if points.len() == 1));
    assert_eq!(summary.warnings, ["points without faces are read as landmarks"]);
}

#[test]
fn names_do_not_take_the_next_line_in() {
    let points = Points::from_rows(3, vec![1.0, 2.0, 3.0]);
    for (name, expected) in [("C:\\a", "C:\\a"), ("C:\\", "C:\\_"), ("a\\ ", "a\\ _"), ("a\n#b", "a__b")] {
        let record = Record::new(Geometry::Landmarks(points.clone()), Place::default());
        let record = Record { name: Some(name.into()), ..record };
        let (found, _) =
            read(&FORMAT, &write(&FORMAT, &[record], &WriteOptions::default()).unwrap()).unwrap();
        assert_eq!((found[0].name.as_deref(), found.len()), (Some(expected), 1), "{name}");
    }
}

#[test]
fn normals_of_vertices_are_a_field_of_vertices() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n";
    let (found, _) = read(&FORMAT, text.as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).fields[NORMALS].values, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
}

#[test]
fn indices_of_what_is_not_in_the_file_are_counted() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/2\n";
    let (found, summary) = read(&FORMAT, text.as_bytes()).unwrap();
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count, d.first.line)).collect();
    let expected = [
        ("texture coordinates that are not in the file", 3, Some(5)),
        ("normals that are not in the file", 1, Some(5)),
    ];
    assert_eq!(dropped, expected);
    assert_eq!(mesh(&found[0]).fields[NORMALS].values[..3], [0.0, 0.0, 1.0]);
    assert!(mesh(&found[0]).fields[NORMALS].values[6].is_nan());
}

#[test]
fn faults_name_the_line() {
    let points = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (text, expected) in [
        ("f 1 2 4", "line 4: expected indices of vertices up to 3, got 4"),
        ("f 1 2 0", "line 4: expected an index from 1, or from -1 to -3, got '0'"),
        ("f 1 2 -4", "line 4: expected an index from 1, or from -1 to -3, got '-4'"),
        ("f 1 2 x", "line 4: expected an index from 1, or from -1 to -3, got 'x'"),
        ("f 1/1/1/1 2 3", "line 4: expected indices of vertices up to 3, got 1"),
        ("v 1 2", "line 4: expected 3 coordinates of a vertex, a weight or a colour, got 2 numbers"),
        ("v 1 2 inf", "line 4: expected finite coordinates, got inf"),
        ("v 1 2 1,5", "line 4: expected a number, got '1,5'"),
        ("vn 1 2", "line 4: expected 3 coordinates of a normal, got 2 numbers"),
        ("solid cube", "line 4: expected a statement of OBJ, got 'solid'"),
        ("o \u{fffd}", ""),
    ] {
        let mut bytes = [points, text].concat().into_bytes();
        if expected.is_empty() {
            bytes.pop();
            assert_eq!(refusal(&FORMAT, &bytes), "line 4: expected UTF-8 text, got other bytes");
        } else if text.contains("1/1/1/1") {
            assert_eq!(refusal(&FORMAT, &bytes), "line 4: expected vertex/texture/normal, got '1/1/1/1'");
        } else {
            assert_eq!(refusal(&FORMAT, &bytes), expected);
        }
    }
    assert_eq!(refusal(&FORMAT, b""), "line 1: expected points, got none");
    let limits = Limits { points: 2, ..Limits::default() };
    let error = read_within(&FORMAT, points.as_bytes(), limits).unwrap_err();
    assert_eq!((error.kind, error.place.line), (FaultKind::TooLarge, Some(3)));
}

#[test]
fn damaged_files_do_not_panic() {
    cut_off(&FORMAT, TWO.as_bytes(), true);
    changed(&FORMAT, TWO.as_bytes());
}

#[test]
fn long_names_that_many_shapes_may_have_are_refused() {
    for keyword in ["o", "g", "usemtl"] {
        let file = |length: usize| {
            let name = "x".repeat(length);
            format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{keyword} {name}\no\nf 1 2 3\no\nf 1 2 3\n")
        };
        assert_eq!(read(&FORMAT, file(1024).as_bytes()).unwrap().0.len(), 2);
        let expected =
            format!("line 4: expected a name of at most 1024 bytes, got 1025 of '{}…'", "x".repeat(40));
        assert_eq!(refusal(&FORMAT, file(1025).as_bytes()), expected);
    }
    // Names of other files are counted, not repeated.
    let text = format!("mtllib {}\nv 0 0 0\n", "x".repeat(1025));
    assert_eq!(read(&FORMAT, text.as_bytes()).unwrap().1.dropped[0].names[0].len(), 1024);
}

#[test]
fn names_that_are_not_read_are_not_written() {
    let (mut found, _) = read(&FORMAT, TWO.as_bytes()).unwrap();
    found[0].name = Some("x".repeat(1024));
    let bytes = write(&FORMAT, &found, &WriteOptions::default()).unwrap();
    assert_eq!(read(&FORMAT, &bytes).unwrap().0[0].name, found[0].name);
    found[0].name = Some("x".repeat(1025));
    let refused = write(&FORMAT, &found, &WriteOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("expected a name of at most 1024 bytes, got 1025"), "{refused}");
    found[0].name = None;
    found[0].metadata.insert("groups".into(), serde_json::json!(["left", "x".repeat(1025)]));
    let refused = write(&FORMAT, &found, &WriteOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("expected a name of at most 1024 bytes, got 1025"), "{refused}");
}

fn dropped(summary: &Summary) -> Vec<(&str, u64, String)> {
    summary.dropped.iter().map(|d| (d.what.as_str(), d.count, d.names.join(" "))).collect()
}

#[test]
fn objects_of_points_are_shapes_of_their_own() {
    let shape = |name: Option<&str>, points: Vec<f64>| {
        let record = Record::new(Geometry::Landmarks(Points::from_rows(3, points)), Place::default());
        Record { name: name.map(str::to_owned), ..record }
    };
    let points =
        [shape(None, vec![1.0, 2.0, 3.0]), shape(Some("b"), vec![4.0; 6]), shape(Some("c"), vec![5.0; 3])];
    let shapes = |records: &[Record]| -> Vec<_> {
        records.iter().map(|record| (record.name.clone(), record.geometry.clone())).collect()
    };
    for records in [&points[..], &points[..1], &points[1..]] {
        let bytes = write(&FORMAT, records, &WriteOptions::default()).unwrap();
        let (again, summary) = read(&FORMAT, &bytes).unwrap();
        assert_eq!((shapes(&again), dropped(&summary)), (shapes(records), vec![]));
    }
    // Beside faces they are left out, as the loose vertices of programs that model.
    let triangle = read(&FORMAT, b"o t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nf 1 2 3\n").unwrap().0;
    let other = Record { name: Some("u".into()), ..triangle[0].clone() };
    for meshes in [&triangle[..], &[triangle[0].clone(), other]] {
        let records = [&points[1..2], meshes, &points[2..]].concat();
        let (again, summary) =
            read(&FORMAT, &write(&FORMAT, &records, &WriteOptions::default()).unwrap()).unwrap();
        assert_eq!(shapes(&again), shapes(meshes));
        assert_eq!(
            dropped(&summary),
            [("objects of vertices only, beside faces or lines", 2, "b c".to_owned())]
        );
    }
    // Vertices of all objects before the first one.
    let (found, _) = read(&FORMAT, b"v 1 1 1\nv 2 2 2\no a\nv 3 3 3\no b\n").unwrap();
    assert_eq!((found.len(), found[0].name.as_deref()), (1, Some("a")));
    // A face without corners draws nothing.
    assert_eq!(read(&FORMAT, b"o a\nv 0 0 0\no b\nl\n").unwrap().0.len(), 1);
    // Points before the first object belong to an object of faces, those that another object uses to that one.
    let text = "v 9 9 9\no a\nv 0 0 0\nv 1 0 0\no b\nv 0 1 0\nf 2 3 4\no c\n";
    let (found, summary) = read(&FORMAT, text.as_bytes()).unwrap();
    assert_eq!((found.len(), mesh(&found[0]).vertices.len(), found[0].name.as_deref()), (1, 4, Some("b")));
    assert_eq!(dropped(&summary), [("objects without a shape", 2, "a c".to_owned())]);
}

#[test]
fn what_no_face_uses_is_counted() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0 2\nvt 0 0\nvn 0 0 1\ng unused\nusemtl red\ng left\n\
                l 1/1 2/1\nl 2 1\no a\nv 3 3 3\n";
    let (found, summary) = read(&FORMAT, text.as_bytes()).unwrap();
    assert_eq!(found.len(), 2);
    let expected = [
        ("third texture coordinates", 1, ""),
        ("texture coordinates of no face", 2, ""),
        ("normals of no face", 1, ""),
        ("points of no line", 1, ""),
        ("objects of vertices only, beside faces or lines", 1, "a"),
    ];
    assert_eq!(dropped(&summary), expected.map(|(what, count, names)| (what, count, names.to_owned())));
}

#[test]
fn lines_of_an_object_have_names() {
    let (found, _) = read(&FORMAT, b"o a\nv 0 0 0\nv 1 0 0\nl 1 2\nl 2 1\n").unwrap();
    let names: Vec<_> = found.iter().filter_map(|record| record.name.as_deref()).collect();
    assert_eq!(names, ["a", "a/2"]);
}

#[test]
fn fields_of_other_carriers_are_not_written() {
    // STL has normals of faces.
    let text = "solid\nfacet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet\nendsolid\n";
    let (found, _) = read(&super::super::stl::FORMAT, text.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).unwrap();
    writer.push(&found[0]).unwrap();
    let summary = writer.finish().unwrap();
    assert_eq!(dropped(&summary), [("fields that the format has no place for", 1, "normals".to_owned())]);
    assert!(!String::from_utf8(bytes).unwrap().contains("vn"));
}
