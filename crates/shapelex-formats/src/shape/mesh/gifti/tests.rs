use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal};
use super::*;
use crate::shape::{FaultKind, Geometry};

fn array(intent: &str, of: &str, sizes: [usize; 2], rest: &str, data: &str) -> String {
    format!(
        "<DataArray Intent=\"NIFTI_INTENT_{intent}\" DataType=\"NIFTI_TYPE_{of}\" Dimensionality=\"2\" Dim0=\"{}\" Dim1=\"{}\" {rest}>\
         <MetaData><MD><Name>Name</Name><Value><![CDATA[/data/Doe/lh.white]]></Value></MD>\
         <MD><Name>AnatomicalStructurePrimary</Name><Value>CortexLeft</Value></MD></MetaData>\
         <CoordinateSystemTransformMatrix><DataSpace>NIFTI_XFORM_UNKNOWN</DataSpace><TransformedSpace>NIFTI_XFORM_TALAIRACH\
         </TransformedSpace><MatrixData>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</MatrixData></CoordinateSystemTransformMatrix>\
         <Data>{data}</Data></DataArray>",
        sizes[0], sizes[1]
    )
}

fn zlib(bytes: &[u8]) -> String {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    STANDARD.encode(encoder.finish().unwrap())
}

fn file() -> String {
    let points: Vec<u8> =
        [0.0_f32, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0].iter().flat_map(|x| x.to_be_bytes()).collect();
    let triangle: Vec<u8> = [0_i32, 1, 2].iter().flat_map(|x| x.to_le_bytes()).collect();
    [
        "<?xml version=\"1.0\"?>\n<!DOCTYPE GIFTI SYSTEM \"gifti.dtd\">\n<GIFTI Version=\"1.0\"><MetaData><MD><Name>UserName</Name>\
         <Value>J. Doe</Value></MD></MetaData><LabelTable><Label Key=\"1\">left &amp; right</Label></LabelTable>",
        &array("POINTSET", "FLOAT32", [3, 3], "ArrayIndexingOrder=\"ColumnMajorOrder\" Encoding=\"GZipBase64Binary\" Endian=\"BigEndian\"", &zlib(&points)),
        &array("TRIANGLE", "INT32", [1, 3], "ArrayIndexingOrder=\"RowMajorOrder\" Encoding=\"Base64Binary\" Endian=\"LittleEndian\"", &STANDARD.encode(triangle)),
        &array("SHAPE", "FLOAT64", [3, 1], "ArrayIndexingOrder=\"RowMajorOrder\" Encoding=\"ASCII\"", "0.1 0.2\n0.3"),
        "</GIFTI>",
    ]
    .concat()
}

#[test]
fn surfaces_are_read_with_their_data() {
    let (found, summary) = read(&FORMAT, file().as_bytes()).unwrap();
    let kept = mesh(&found[0]);
    assert_eq!(kept.vertices.coordinates(), [0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    assert_eq!(kept.faces.iter().collect::<Vec<_>>(), [[0, 1, 2]]);
    assert_eq!(kept.fields["shape_2"].values, [0.1, 0.2, 0.3]);
    assert_eq!(found[0].metadata["AnatomicalStructurePrimary"], "CortexLeft");
    assert_eq!(found[0].metadata["labels"]["1"], "left & right");
    assert_eq!(found[0].metadata["transform"]["to"], "NIFTI_XFORM_TALAIRACH");
    let dropped = &summary.dropped[0];
    assert_eq!((dropped.names.join(" "), dropped.count), ("UserName Name Name Name".into(), 4));
    let written = serde_json::to_string(&summary).unwrap();
    assert!(!written.contains("Doe"), "{written}");
}

#[test]
fn faults_are_named() {
    let text = file();
    for (from, to, expected) in [
        (
            "NIFTI_INTENT_POINTSET",
            "NIFTI_INTENT_SHAPE",
            "expected an array of points (NIFTI_INTENT_POINTSET), got none",
        ),
        ("FLOAT32", "COMPLEX64", "expected a type of numbers, got 'COMPLEX64'"),
        ("Dim0=\"3\"", "Dim0=\"4\"", "expected 48 bytes of compressed data, got fewer"),
        ("Dim0=\"3\"", "Dim0=\"99999999999\"", "expected at most 16777216 faces of a mesh, got 99999999999"),
        ("Dim1=\"3\"", "Dim1=\"9999999999\"", "expected at most 1073741824 bytes of an array"),
        ("Dimensionality=\"2\"", "Dimensionality=\"0\"", "expected 1 to 6 dimensions, got 0"),
        (
            "GZipBase64Binary",
            "ExternalFileBinary",
            "expected Encoding ASCII, Base64Binary or GZipBase64Binary, got 'ExternalFileBinary'",
        ),
        ("BigEndian", "PDPEndian", "expected Endian LittleEndian or BigEndian, got 'PDPEndian'"),
        ("0.1 0.2", "0.1", "expected 3 numbers, got 2"),
        ("0.1 0.2", "0.1 x", "expected a number, got 'x'"),
        ("&amp;", "&lol;", "expected entities of XML, got '&lol;'"),
        (
            "<GIFTI Version=\"1.0\">",
            "<GIFTI><GIFTI>",
            "expected the end of the first element, got the end of the file",
        ),
    ] {
        let refused = refusal(&FORMAT, text.replacen(from, to, 1).as_bytes());
        assert!(refused.contains(expected), "{refused} for {to}");
    }
    let limits = Limits { points: 2, ..Limits::default() };
    assert_eq!(read_within(&FORMAT, text.as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
    let alone = text.replacen("NIFTI_INTENT_TRIANGLE", "NIFTI_INTENT_NONE", 1);
    let (found, _) = read(&FORMAT, alone.as_bytes()).unwrap();
    assert!(matches!(found[0].geometry, Geometry::Landmarks(_)));
}

#[test]
fn many_surfaces_are_refused_and_many_fields_counted() {
    let text = file();
    let [points, shape] = ["POINTSET", "SHAPE"].map(|intent| {
        let start = text.find(&format!("<DataArray Intent=\"NIFTI_INTENT_{intent}")).unwrap();
        let end = start + text[start..].find("</DataArray>").unwrap() + 12;
        text[start..end].to_owned()
    });
    let many = format!("<GIFTI>{}</GIFTI>", points.repeat(65));
    assert_eq!(
        refusal(&FORMAT, many.as_bytes()),
        "GIFTI, byte 7: expected at most 64 arrays of points, got 65"
    );
    let many = text.replace("</GIFTI>", &format!("{}</GIFTI>", shape.repeat(1001)));
    let (found, summary) = read(&FORMAT, many.as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).fields.len(), 1000);
    let beyond = summary.dropped.iter().find(|dropped| dropped.what == "fields beyond the first thousand");
    assert_eq!(beyond.unwrap().count, 2);
}

#[test]
fn damaged_files_do_not_panic() {
    cut_off(&FORMAT, file().as_bytes(), false);
    changed(&FORMAT, file().as_bytes());
}

#[test]
fn what_arrays_and_labels_say_is_kept_or_counted() {
    let entry =
        |name: &str, value: &str| format!("<MD><Name>{name}</Name><Value>{value}</Value></MD></MetaData>");
    let mut text = file().replace("<Label Key=\"1\">", "<Label Key=\"1\" Red=\"1\">");
    // The points, the triangle and the data, from the last one: their ends stay where they are.
    for (intent, entry) in [
        ("SHAPE", entry("TopologicalType", "Open")),
        (
            "TRIANGLE",
            [entry("TopologicalType", "Closed"), entry("GeometricType", "Pial")].concat().replacen(
                "</MetaData>",
                "",
                1,
            ),
        ),
        ("POINTSET", entry("GeometricType", "Inflated")),
    ] {
        let at = text.find(&format!("NIFTI_INTENT_{intent}")).unwrap();
        let end = at + text[at..].find("</MetaData>").unwrap();
        text.replace_range(end..end + "</MetaData>".len(), &entry);
    }
    let (found, summary) = read(&FORMAT, text.as_bytes()).unwrap();
    let kept =
        ["AnatomicalStructurePrimary", "GeometricType", "TopologicalType"].map(|key| &found[0].metadata[key]);
    assert_eq!(kept, ["CortexLeft", "Inflated", "Closed"]);
    let dropped: Vec<_> = summary.dropped[1..].iter().map(|d| (&*d.what, d.names.join(" "))).collect();
    let other = "AnatomicalStructurePrimary TopologicalType GeometricType".to_owned();
    assert_eq!(
        dropped,
        [("entries of metadata beside those of the points", other), ("colours of labels", String::new())]
    );
}
