use super::super::super::FaultKind;
use super::super::super::options::{Encoding, WriteOptions};
use super::super::super::record::{Faces, Geometry, Points};
use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal, write};
use super::*;

const TEXT: &str = "solid first
 facet normal 0 0 1
  outer loop
   vertex 0 0 0
   vertex 1 0 0
   vertex -0.0 1e0 0
  endloop
 endfacet
 FACET NORMAL 0 0 nan
  outer loop
   vertex 0 1 0
   vertex 1 0 0
   vertex 0.5 1 0
  endloop
 endfacet
endsolid first
solid
endsolid
solid last one
facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 0 0 vertex 1 2 3 endloop endfacet
endsolid last one
";

#[test]
fn solids_are_shapes_of_their_own() {
    let (found, summary) = read(&FORMAT, TEXT.as_bytes()).unwrap();
    let names: Vec<_> = found.iter().map(|r| (r.name.as_deref(), r.place.line)).collect();
    assert_eq!(names, [(Some("first"), Some(1)), (Some("last one"), Some(19))]);
    assert_eq!(mesh(&found[0]).faces.iter().collect::<Vec<_>>(), [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(mesh(&found[0]).vertices.len(), 4);
    assert_eq!(mesh(&found[1]).faces.iter().collect::<Vec<_>>(), [[0, 0, 1]]);
    assert_eq!(summary.properties["merged_corners"], 3);
    assert_eq!((summary.dropped[0].what.as_str(), summary.dropped[0].count), ("solids without triangles", 1));
}

fn binary() -> Vec<u8> {
    let (mut found, _) = read(&FORMAT, TEXT.as_bytes()).unwrap();
    found.truncate(1);
    write(&FORMAT, &found, &WriteOptions::default()).unwrap()
}

#[test]
fn what_is_written_comes_back() {
    let (found, _) = read(&FORMAT, TEXT.as_bytes()).unwrap();
    let options = WriteOptions { encoding: Some(Encoding::Text), ..WriteOptions::default() };
    let (again, _) = read(&FORMAT, &write(&FORMAT, &found, &options).unwrap()).unwrap();
    for (a, b) in found.iter().zip(&again) {
        assert_eq!(
            (&a.name, &mesh(a).vertices, &mesh(a).faces),
            (&b.name, &mesh(b).vertices, &mesh(b).faces)
        );
    }
    assert_eq!(mesh(&again[1]).fields[NORMALS].values, [0.0; 3]);
    let (again, summary) = read(&FORMAT, &binary()).unwrap();
    assert_eq!(
        (&mesh(&again[0]).vertices, &mesh(&again[0]).faces),
        (&mesh(&found[0]).vertices, &mesh(&found[0]).faces)
    );
    assert_eq!(mesh(&again[0]).fields[NORMALS].values, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    assert_eq!(summary.properties["encoding"], "binary");
    let error = write(&FORMAT, &found, &WriteOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "expected one shape, as binary STL holds only one, got several");
}

#[test]
fn vertices_without_faces_have_no_place() {
    let (mut found, _) = read(&FORMAT, &binary()).unwrap();
    let Geometry::Mesh(written) = &mut found[0].geometry else { panic!("no mesh") };
    written.vertices = Points::from_rows(3, [written.vertices.coordinates(), &[5.0; 6]].concat());
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).unwrap();
    writer.push(&found[0]).unwrap();
    let summary = writer.finish().unwrap();
    let dropped = summary.dropped.iter().find(|dropped| dropped.what == "vertices of no face").unwrap();
    assert_eq!((dropped.count, bytes == binary()), (2, true));

    let Geometry::Mesh(without) = &mut found[0].geometry else { panic!("no mesh") };
    without.faces = Faces::default();
    without.fields.clear();
    let error = write(&FORMAT, &found, &WriteOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "expected shapes in space that STL can hold, got a shape without faces");
}

#[test]
fn binary_files_may_begin_as_a_text() {
    let mut bytes = binary();
    bytes[..11].copy_from_slice(b"solid facet");
    bytes[HEAD + 48] = 5;
    let (found, _) = read(&FORMAT, &bytes).unwrap();
    assert_eq!(mesh(&found[0]).fields["attribute"].values, [5.0, 0.0]);
}

#[test]
fn faults_are_named() {
    for (text, expected) in [
        ("solid a\nfacet normal 0 0 1\nouter lop", "line 3: expected 'loop', got 'lop'"),
        ("solid a\nvertex 0 0 1\n", "line 2: expected 'facet' or 'endsolid', got 'vertex'"),
        ("solid a\n", "line 3: expected 'facet' or 'endsolid', got the end of the file"),
        (
            "solid a\nfacet normal 0 0 1 outer loop vertex 0 0 inf",
            "line 2: expected finite coordinates, got inf",
        ),
        ("solid a\nendsolid\nfacet", "line 3: expected 'solid', got 'facet'"),
        ("solder", "byte 6: expected 'solid', or the 84 bytes of a header, got 6 bytes"),
    ] {
        let refused = refusal(&FORMAT, text.as_bytes());
        assert!(
            refused == expected || text == "solid a\n" && refused.contains("got the end of the file"),
            "{refused}"
        );
    }
    let mut bytes = binary();
    bytes.push(0);
    assert_eq!(refusal(&FORMAT, &bytes), "byte 80: expected 184 bytes by the number of triangles, got 185");
    bytes[80..84].fill(0xff);
    assert_eq!(read(&FORMAT, &bytes).unwrap_err().kind, FaultKind::TooLarge);
    let limits = Limits { points: 3, ..Limits::default() };
    assert_eq!(read_within(&FORMAT, TEXT.as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
    assert_eq!(read_within(&FORMAT, &binary(), limits).unwrap_err().kind, FaultKind::TooLarge);
}

#[test]
fn damaged_files_do_not_panic() {
    cut_off(&FORMAT, TEXT.as_bytes(), true);
    changed(&FORMAT, TEXT.as_bytes());
    cut_off(&FORMAT, &binary(), false);
    changed(&FORMAT, &binary());
}
