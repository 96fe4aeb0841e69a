use super::super::super::FaultKind;
use super::super::super::options::{self, WriteOptions};
use super::super::super::record::Geometry;
use super::super::super::record::{Field, Mesh, Points, Record};
use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal, write};
use super::*;

const TEXT: &str = "ply\r
format ascii 1.0
comment by hand
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property double quality
element face 3
property list uchar int vertex_indices
property list uchar float texcoord
property uchar red
property uchar green
property uchar blue
element edge 1
property int vertex1
end_header
0 0 0 255 0 0 0.1
1 0 0 0 255 0 0.2
1 1 0 0 0 255 nan
0 1 0 9 9 9 -4e9
4 0 1 2 3 2 0.5 0.25 1 2 3
2 0 1 2 0.5 0.75 4 5 6
3 0 1 2 2 1 1 7 8 9
3
";

#[test]
fn properties_become_fields() {
    let (found, summary) = read(&FORMAT, TEXT.as_bytes()).unwrap();
    let mesh = mesh(&found[0]);
    assert_eq!(mesh.vertices.len(), 4);
    assert_eq!(mesh.faces.iter().collect::<Vec<_>>(), [&[0, 1, 2, 3][..], &[0, 1, 2]]);
    assert_eq!(
        (mesh.fields[COLOURS].width, mesh.fields[COLOURS].values[..4].to_vec()),
        (3, vec![255.0, 0.0, 0.0, 0.0])
    );
    assert_eq!(mesh.fields["face_colours"].values, [1.0, 2.0, 3.0, 7.0, 8.0, 9.0]);
    assert_eq!(mesh.fields["texcoord"].values, [0.5, 0.25, 1.0, 1.0]);
    assert_eq!(mesh.fields["quality"].values[3], -4e9);
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    let expected = [("elements other than vertices and faces", 1), ("faces of less than three corners", 1)];
    assert_eq!(dropped, expected);
}

#[test]
fn what_is_written_comes_back_in_every_encoding() {
    let (mut found, _) = read(&FORMAT, TEXT.as_bytes()).unwrap();
    if let Geometry::Mesh(mesh) = &mut found[0].geometry {
        // A value that is not there is not equal to itself.
        mesh.fields.get_mut("quality").unwrap().values[2] = 0.1 + 0.2;
    }
    for encoding in [options::Encoding::Text, options::Encoding::Binary] {
        let options = WriteOptions { encoding: Some(encoding), ..WriteOptions::default() };
        let bytes = write(&FORMAT, &found, &options).unwrap();
        assert_eq!(read(&FORMAT, &bytes).unwrap().0, found, "{encoding:?}");
    }
    let error = write(&FORMAT, &[found[0].clone(), found[0].clone()], &WriteOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "expected one shape, as PLY holds only one, got several");
}

/// A triangle of all types of numbers in one byte order.
fn binary(big_endian: bool) -> Vec<u8> {
    let order = if big_endian { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 3\nproperty float x\nproperty double y\nproperty short z\n\
         property uint label\nelement face 1\nproperty list ushort int vertex_index\nend_header\n"
    )
    .into_bytes();
    let mut put = |value: &[u8]| {
        let mut value = value.to_vec();
        if !big_endian {
            value.reverse();
        }
        bytes.extend(value);
    };
    for (x, y, z, label) in
        [(0.5_f32, 1e-9_f64, -2_i16, 7_u32), (1.0, 0.0, 3, 4_000_000_000), (0.0, 1.0, 0, 0)]
    {
        put(&x.to_be_bytes());
        put(&y.to_be_bytes());
        put(&z.to_be_bytes());
        put(&label.to_be_bytes());
    }
    put(&3_u16.to_be_bytes());
    for vertex in [2_i32, 0, 1] {
        put(&vertex.to_be_bytes());
    }
    bytes
}

#[test]
fn both_byte_orders_are_read() {
    let [little, big] = [false, true].map(|big| read(&FORMAT, &binary(big)).unwrap().0);
    assert_eq!(little, big);
    let mesh = mesh(&little[0]);
    assert_eq!(mesh.vertices.coordinates(), [0.5, 1e-9, -2.0, 1.0, 0.0, 3.0, 0.0, 1.0, 0.0]);
    assert_eq!(mesh.faces.iter().collect::<Vec<_>>(), [[2, 0, 1]]);
    assert_eq!(mesh.fields["label"].values, [7.0, 4e9, 0.0]);
}

#[test]
fn faults_are_named() {
    let vertex = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
    for (body, expected) in [
        ("layout ascii 1.0\n", "line 2: expected a line of the header, got 'layout ascii 1.0'"),
        (
            "format utf8 1.0\n",
            "line 2: expected ascii, binary_little_endian or binary_big_endian, got 'utf8'",
        ),
        ("format ascii 1.0\nproperty int x\n", "line 3: expected an element, got a property"),
        ("format ascii 1.0\nelement vertex -1\n", "line 3: expected a number of rows, got '-1'"),
        (
            "format ascii 1.0\nelement vertex 1\nproperty half x\n",
            "line 4: expected a type of PLY, got 'half'",
        ),
        (
            "format ascii 1.0\nelement vertex 1\nproperty int x\nend_header\n1\n",
            "element vertex: expected a property y, got none",
        ),
        ("format ascii 1.0\nend_header\n", "expected an element vertex, got none"),
        (
            "format ascii 1.0\nelement tristrips 1\nproperty list int int a\nend_header\n0",
            "element tristrips: expected polygons as the element face, got strips of triangles",
        ),
        (
            "format ascii 1.0\nelement vertex 18446744073709551615\nproperty float x\nend_header\n",
            "element vertex: expected at most 4194304 points of a shape, got 18446744073709551615",
        ),
        ("format ascii 1.0\nVERTEXend_header\n0 0 0\n1\n", "line 9: expected the end of the file, got '1'"),
        (
            "format ascii 1.0\nVERTEXend_header\n0 0\n",
            "item 0, element vertex, property z, line 9: expected a number, got the end of the file",
        ),
        (
            "format ascii 1.0\nVERTEXelement face 1\nproperty list char int vertex_indices\nend_header\n0 0 0\n-1\n",
            "item 0, element face, property vertex_indices: expected a length of a list, got -1",
        ),
        (
            "format ascii 1.0\nVERTEXelement face 1\nproperty list char int vertex_indices\nend_header\n0 0 0\n3 0 0 -7\n",
            "item 0, element face: expected an index of a vertex, got -7",
        ),
        (
            "format ascii 1.0\nVERTEXelement face 1\nproperty list char int vertex_indices\nend_header\n0 0 0\n3 0 0 1\n",
            "item 0: expected indices of vertices below 1, got 1 in face 0",
        ),
    ] {
        let text = format!("ply\n{}", body.replace("VERTEX", vertex));
        assert_eq!(refusal(&FORMAT, text.as_bytes()), expected);
    }
    // A file of points: the check is that of landmarks.
    let text = format!("ply\nformat ascii 1.0\n{vertex}end_header\n0 0 nan\n");
    let refused = refusal(&FORMAT, text.as_bytes());
    assert!(refused.contains("expected coordinates within"), "{refused}");
}

#[test]
fn points_are_bounded() {
    let limits = Limits { points: 3, ..Limits::default() };
    assert_eq!(read_within(&FORMAT, TEXT.as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
}

#[test]
fn rows_without_properties_take_no_time() {
    let text = "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    assert_eq!(read(&FORMAT, text.as_bytes()).unwrap().0.len(), 1);
}

#[test]
fn damaged_files_do_not_panic() {
    cut_off(&FORMAT, TEXT.trim_end().as_bytes(), false);
    changed(&FORMAT, TEXT.as_bytes());
    for big_endian in [false, true] {
        cut_off(&FORMAT, &binary(big_endian), false);
        changed(&FORMAT, &binary(big_endian));
    }
}

#[test]
fn fields_whose_names_become_one_stay_apart() {
    let field = |x: f64| Field { domain: Domain::Vertices, width: 1, values: vec![x] };
    let names = ["a b", "a\tb", "x", "nx"];
    let fields = names.iter().zip(1..).map(|(name, k)| ((*name).into(), field(f64::from(k)))).collect();
    let mut mesh = Mesh { vertices: Points::from_rows(3, vec![0.0; 3]), fields, ..Mesh::default() };
    mesh.faces.push([0, 0, 0]);
    let bytes = write(&FORMAT, &[Record::new(mesh, Place::default())], &WriteOptions::default()).unwrap();
    let (found, _) = read(&FORMAT, &bytes).unwrap();
    let Geometry::Mesh(mesh) = &found[0].geometry else { panic!("no mesh") };
    let found: Vec<_> = mesh.fields.iter().map(|(name, field)| (name.as_str(), field.values[0])).collect();
    assert_eq!(found, [("a_b", 2.0), ("a_b_", 1.0), ("nx", 4.0), ("x_", 3.0)]);
}
