use super::super::super::FaultKind;
use super::super::super::limits::Room;
use super::super::super::options::{Encoding, WriteOptions};
use super::super::super::record::{Domain, Faces, Geometry, Points, Record};
use super::super::cells::{Cells, STRIP};
use super::super::draft::Draft;
use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal, write};
use super::super::{NORMALS, TEXTURE};
use super::*;
use crate::shape::{Limits, Place};
use crate::summary::Summary;

const HEAD: &str = "# vtk DataFile Version 3.0\nby hand\nASCII\n";
const TEXT: &str = "DATASET POLYDATA
FIELD FieldData 1
TimeValue 1 1 double
0.5
POINTS 5 float
0 0 0 1 0 0 1 1 0
0 1 0 2 2 2
VERTICES 1 2
1 4
POLYGONS 1 5
4 0 1 2 3
TRIANGLE_STRIPS 1 5
4 0 1 2 3
METADATA
INFORMATION 0

CELL_DATA 3
SCALARS part%20a int 1
LOOKUP_TABLE default
9 7 8
POINT_DATA 5
NORMALS n float
0 0 1 0 0 1 0 0 1 0 0 1 0 0 1
TEXTURE_COORDINATES t 2 float
0 0 1 0 1 1 0 1 .5 .5
LOOKUP_TABLE mine 1
1 1 1 1
FIELD FieldData 2
thick 1 5 double
.1 .2 .3 nan .5
names 1 5 string
a
b
c
d
e
";

fn text() -> String {
    [HEAD, TEXT].concat()
}

#[test]
fn data_of_points_and_cells_become_fields() {
    let (found, summary) = read(&FORMAT, text().as_bytes()).unwrap();
    let mesh = mesh(&found[0]);
    assert_eq!(mesh.vertices.len(), 5);
    // The second triangle of a strip is turned around.
    assert_eq!(mesh.faces.iter().collect::<Vec<_>>(), [&[0, 1, 2, 3][..], &[0, 1, 2], &[2, 1, 3]]);
    assert_eq!(mesh.fields["part a"].values, [7.0, 8.0, 8.0]);
    assert_eq!(mesh.fields[NORMALS].width, 3);
    assert_eq!(mesh.fields[TEXTURE].values[8..], [0.5, 0.5]);
    assert_eq!(mesh.fields["thick"].values[..3], [0.1, 0.2, 0.3]);
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    let expected = [
        ("arrays of the whole file", 1),
        ("tables of colours", 1),
        ("arrays of texts", 1),
        ("cells of points beside lines or polygons", 1),
    ];
    assert_eq!(dropped, expected);
}

#[test]
fn what_is_written_comes_back_in_both_encodings() {
    let (mut found, _) = read(&FORMAT, text().as_bytes()).unwrap();
    let Geometry::Mesh(mesh) = &mut found[0].geometry else { panic!("no mesh") };
    mesh.fields.get_mut("thick").unwrap().values[3] = 0.1 + 0.2;
    let closed = Points::from_rows(3, vec![0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.3]);
    let place = Place::item(0);
    let curve = Record::new(Geometry::Curve { points: closed.clone(), closed: true }, place.clone());
    let open = Record::new(Geometry::Curve { points: closed.clone(), closed: false }, place);
    let landmarks = Record::new(Geometry::Landmarks(closed), Place::default());
    for record in [found[0].clone(), curve, open, landmarks] {
        for encoding in [Encoding::Text, Encoding::Binary] {
            let options = WriteOptions { encoding: Some(encoding), ..WriteOptions::default() };
            let bytes = write(&FORMAT, std::slice::from_ref(&record), &options).unwrap();
            assert_eq!(read(&FORMAT, &bytes).unwrap().0, std::slice::from_ref(&record), "{encoding:?}");
            cut_off(&FORMAT, bytes.trim_ascii_end(), true);
        }
    }
}

#[test]
fn polygons_of_grids_are_kept() {
    let grid = "DATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 1 0 0 0 1 0 1 1 0\nCELLS 3 14\n3 0 1 2\n4 0 1 2 3\n4 0 1 2 3\n\
                CELL_TYPES 3\n5\n10\n8\nCELL_DATA 3\nSCALARS a float\n1 2 3\n";
    let (found, summary) = read(&FORMAT, [HEAD, grid].concat().as_bytes()).unwrap();
    let kept = mesh(&found[0]);
    assert_eq!(kept.faces.iter().collect::<Vec<_>>(), [&[0, 1, 2][..], &[0, 1, 3, 2]]);
    assert_eq!(kept.fields["a"].values, [1.0, 3.0]);
    assert_eq!(
        (summary.dropped[0].what.as_str(), summary.dropped[0].names[0].as_str()),
        ("cells that are no polygons", "type 10")
    );
    let five = "DATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 2 3\nOFFSETS vtktypeint64\n0 3\nCONNECTIVITY vtktypeint64\n0 1 2\n";
    let (found, _) = read(&FORMAT, [HEAD, five].concat().as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).faces.iter().collect::<Vec<_>>(), [[0, 1, 2]]);
}

#[test]
fn faults_are_named() {
    let points = "DATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n";
    for (body, expected) in [
        (
            "DATASET STRUCTURED_POINTS\n",
            "line 4: expected POLYDATA or UNSTRUCTURED_GRID, got 'STRUCTURED_POINTS'",
        ),
        ("POINTS 99999999 float\n", "line 4: expected at most 4194304 points of a shape, got 99999999"),
        ("POINTS 1 half\n0 0 0", "line 4: expected an array of numbers, got one of 'half'"),
        ("POINTS 1 float\n0 0\n", "line 6: expected a number, got the end of the file"),
        ("@POLYGONS 1 4\n3 0 1 3\n", "item 0: expected indices of vertices below 3, got 3 in face 0"),
        ("@POLYGONS 1 4\n3 0 1 -1\n", "line 7: expected lengths and indices of cells, got -1"),
        ("@POLYGONS 2 4\n3 0 1 2\n", "line 7: expected 2 cells in 4 numbers, got 1"),
        ("@POLYGONS 1 5\n3 0 1 2 0\n", "line 7: expected 4 numbers of 1 cells, got 5"),
        ("@POINT_DATA 2\n", "line 7: expected data of 3 points, got 2"),
        (
            "@POLYGONS 1 4\n3 0 1 2\nCELL_DATA 2\nSCALARS a int\n1 2\n",
            "CELL_DATA a: expected data of 1 cells, got 2",
        ),
        ("@CELLS 1 4\n3 0 1 2\n", "CELL_TYPES: expected types of 1 cells, got 0"),
        ("@HELLO\n", "line 7: expected a section of a VTK file, got 'HELLO'"),
        ("@POINT_DATA 3\nFIELD f 1\na 1 2 float\n1 2\n", "line 9: expected 3 rows of array 'a', got 2"),
        ("", "expected points, got none"),
    ] {
        let body = body.strip_prefix('@').map_or_else(|| body.into(), |rest| [points, rest].concat());
        let refused = refusal(&FORMAT, [HEAD, &body].concat().as_bytes());
        assert_eq!(refused.replace("line 5: expected a number", "line 6: expected a number"), expected);
    }
    assert_eq!(
        refusal(&FORMAT, b"# vtk DataFile Version 3.0\n\nUTF8\n"),
        "line 3: expected 'ASCII' or 'BINARY', got 'UTF8'"
    );
    let limits = Limits { points: 4, ..Limits::default() };
    assert_eq!(read_within(&FORMAT, text().as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
    let claims = "# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS 3 double\n0";
    assert_eq!(refusal(&FORMAT, claims.as_bytes()), "byte 68: expected 72 bytes of coordinates, got 1");
}

#[test]
fn damaged_files_do_not_panic() {
    cut_off(&FORMAT, text().as_bytes(), true);
    changed(&FORMAT, text().as_bytes());
    let (found, _) = read(&FORMAT, text().as_bytes()).unwrap();
    changed(&FORMAT, &write(&FORMAT, &found, &WriteOptions::default()).unwrap());
}

/// A file of one strip of `triangles` triangles, with `fields` fields of one row of `width` values.
fn strip(triangles: usize, fields: usize, width: usize) -> String {
    let corners: Vec<&str> = ["0", "1", "2"].into_iter().cycle().take(triangles + 2).collect();
    let row = "1 ".repeat(width);
    let arrays: String = (0..fields).map(|k| format!("a{k} {width} 1 int\n{row}\n")).collect();
    format!(
        "{HEAD}DATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nTRIANGLE_STRIPS 1 {}\n{} {}\nCELL_DATA 1\n\
         FIELD f {fields}\n{arrays}",
        triangles + 3,
        triangles + 2,
        corners.join(" ")
    )
}

#[test]
fn rows_that_triangles_of_a_strip_repeat_are_bounded() {
    let (found, _) = read(&FORMAT, strip(500, 2, 500).as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).fields["a1"].values.len(), 250_000);
    let refused = refusal(&FORMAT, strip(2000, 1, 2000).as_bytes());
    assert!(refused.contains("CELL_DATA a0: expected at most "), "{refused}");
    assert!(refused.ends_with(" bytes of numbers in double precision, got more"), "{refused}");
    let refused = refusal(&FORMAT, strip(5000, 500, 1).as_bytes());
    assert!(refused.ends_with(" bytes of numbers in double precision, got more"), "{refused}");
}

#[test]
fn fields_beyond_the_most_are_dropped_before_their_values_are_made() {
    let (found, summary) = read(&FORMAT, strip(3, 1002, 1).as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).fields.len(), 1000);
    let beyond = summary.dropped.iter().find(|dropped| dropped.what == "fields beyond the first thousand");
    assert_eq!(beyond.unwrap().names, ["a1000", "a1001"]);

    let mut draft = Draft::new(Place::default());
    let mut cells = Cells::default();
    let mut faces = Faces::default();
    faces.push([0; 2002]);
    cells.add(&faces, |_| STRIP, &mut draft, &mut Summary::default());
    let room = Room::new(&Limits::default(), 0);
    let wide = vec![1.0; 2000];
    assert!(cells.field("wide", 2000, &wide, &mut draft, &room).is_err());
    (0..1000).for_each(|_| draft.field("a", Domain::Vertices, 1, Vec::new()));
    assert!(cells.field("wide", 2000, &wide, &mut draft, &room).is_ok());
}

#[test]
fn widths_beyond_all_memory_are_refused() {
    let text = format!(
        "{HEAD}DATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 2 8\n3 0 1 2 3 0 1 2\nCELL_DATA 0\n\
         SCALARS a int {}\n",
        1_u64 << 63
    );
    assert_eq!(refusal(&FORMAT, text.as_bytes()), "CELL_DATA a: expected data of 2 cells, got 0");
}

#[test]
fn what_is_no_shape_is_counted() {
    let points = "DATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 5 5 5\n";
    let data = "CELL_DATA 2\nSCALARS a int\n1 2\nPOINT_DATA 4\nSCALARS b int\n1 2 3 4\n";
    let of_cells = ("fields of cells without polygons", 1, "a");
    let of_points = ("fields of points without faces", 1, "b");
    let cells = ("cells of points beside lines or polygons", 1, "");
    for (body, shapes, expected) in [
        ("VERTICES 2 5\n2 0 1\n1 3\n", 1, &[of_cells, of_points][..]),
        (
            "VERTICES 1 2\n1 3\nLINES 1 3\n2 0 1\n",
            1,
            &[of_cells, cells, of_points, ("points of no line", 2, "")],
        ),
        ("VERTICES 1 2\n1 3\nPOLYGONS 1 4\n3 0 1 2\n", 1, &[cells]),
        ("LINES 1 3\n2 0 3\nPOLYGONS 1 4\n3 0 1 2\n", 1, &[("lines beside the faces", 1, "")]),
        (
            "POLYGONS 2 6\n2 0 1\n2 1 2\n",
            1,
            &[("faces of less than three corners", 2, ""), ("fields of points without faces", 2, "a b")],
        ),
    ] {
        let (found, summary) = read(&FORMAT, [HEAD, points, body, data].concat().as_bytes()).unwrap();
        let dropped: Vec<_> =
            summary.dropped.iter().map(|d| (&*d.what, d.count, d.names.join(" "))).collect();
        let expected: Vec<_> =
            expected.iter().map(|(what, count, names)| (*what, *count, (*names).to_owned())).collect();
        assert_eq!((found.len(), dropped), (shapes, expected), "{body}");
    }
    let grid = "DATASET UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 0\nCELLS 2 3\n0\n1 0\nCELL_TYPES 2\n0\n1\n";
    let (_, summary) = read(&FORMAT, [HEAD, grid].concat().as_bytes()).unwrap();
    assert_eq!((summary.dropped.len(), summary.dropped[0].names.join(" ")), (1, "type 0".into()));
}
