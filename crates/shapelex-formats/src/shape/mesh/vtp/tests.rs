use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal};
use super::*;
use crate::shape::{FaultKind, Record};

/// How the arrays of a test are written.
#[derive(Clone, Copy, PartialEq, Debug)]
enum How {
    Text,
    Inline,
    Base64,
    Raw,
}

/// Adds an array: its element to `xml`, its data there or to `appended`.
struct Made {
    how: How,
    compressed: bool,
    big: bool,
    appended: Vec<u8>,
}

impl Made {
    fn data(&self, bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let order = |value: u64| if self.big { value.to_be_bytes() } else { value.to_le_bytes() };
        if !self.compressed {
            return (Vec::new(), [&order(bytes.len() as u64)[..], bytes].concat());
        }
        // Blocks of 16 bytes.
        let blocks: Vec<Vec<u8>> = bytes
            .chunks(16)
            .map(|block| {
                let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
                encoder.write_all(block).unwrap();
                encoder.finish().unwrap()
            })
            .collect();
        let sizes = [blocks.len() as u64, 16, bytes.len() as u64 % 16].into_iter();
        let sizes = sizes.chain(blocks.iter().map(|block| block.len() as u64));
        (sizes.flat_map(order).collect(), blocks.concat())
    }

    fn array(&mut self, attributes: &str, of: &str, values: &[f64]) -> String {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| {
                let mut raw = match of {
                    "Float64" => value.to_be_bytes().to_vec(),
                    "Float32" => (*value as f32).to_be_bytes().to_vec(),
                    "Int64" => (*value as i64).to_be_bytes().to_vec(),
                    _ => vec![*value as u8],
                };
                if !self.big {
                    raw.reverse();
                }
                raw
            })
            .collect();
        let (head, body) = self.data(&bytes);
        let encoded = [STANDARD.encode(&head), STANDARD.encode(&body)].concat();
        let start = format!("<DataArray {attributes} type=\"{of}\"");
        match self.how {
            How::Text => {
                let text: Vec<String> = values.iter().map(f64::to_string).collect();
                format!("{start} format=\"ascii\">\n{}\n</DataArray>", text.join(" "))
            }
            How::Inline => format!("{start} format=\"binary\">\n {encoded}\n</DataArray>"),
            How::Base64 | How::Raw => {
                let offset = self.appended.len();
                self.appended.extend(if self.how == How::Raw {
                    [head, body].concat()
                } else {
                    encoded.into_bytes()
                });
                format!("{start} format=\"appended\" offset=\"{offset}\"/>")
            }
        }
    }
}

fn file(how: How, compressed: bool, big: bool) -> Vec<u8> {
    let mut made = Made { how, compressed, big, appended: Vec::new() };
    let points = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.25];
    let parts = [
        made.array("Name=\"Points\" NumberOfComponents=\"3\"", "Float32", &points),
        made.array("Name=\"connectivity\"", "Int64", &[0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0]),
        made.array("Name=\"offsets\"", "Int64", &[4.0, 7.0]),
        made.array("Name=\"n\" NumberOfComponents=\"3\"", "Float64", &[0.1; 12]),
        made.array("Name=\"label\"", "UInt8", &[7.0, 255.0]),
    ];
    let order = if big { "BigEndian" } else { "LittleEndian" };
    let compressor = if compressed { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let head = format!(
        "<?xml version=\"1.0\"?>\n<!-- by hand -->\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"{order}\" \
         header_type=\"UInt64\"{compressor}><PolyData><Piece NumberOfPoints=\"4\" NumberOfPolys=\"2\"><Points>{}</Points>\
         <Polys>{}{}</Polys><PointData Normals=\"n\">{}</PointData><CellData>{}</CellData></Piece></PolyData>",
        parts[0], parts[1], parts[2], parts[3], parts[4]
    );
    let appended = match how {
        How::Text | How::Inline => Vec::new(),
        How::Base64 => {
            [&b"<AppendedData encoding=\"base64\">\n_"[..], &made.appended, b"</AppendedData>"].concat()
        }
        How::Raw => [&b"<AppendedData encoding=\"raw\">_"[..], &made.appended, b"</AppendedData>"].concat(),
    };
    [head.as_bytes(), &appended, b"</VTKFile>\n"].concat()
}

fn records(bytes: &[u8]) -> Vec<Record> {
    let (mut found, _) = read(&FORMAT, bytes).unwrap();
    found.iter_mut().for_each(|record| record.place = Place::default());
    found
}

#[test]
fn all_encodings_hold_the_same() {
    let expected = records(&file(How::Text, false, false));
    let kept = mesh(&expected[0]);
    assert_eq!(kept.faces.iter().collect::<Vec<_>>(), [&[0, 1, 2, 3][..], &[2, 1, 0]]);
    assert_eq!(kept.vertices.coordinates()[9..], [0.0, 1.0, 0.25]);
    assert_eq!(
        (&kept.fields[NORMALS].values[..], &kept.fields["label"].values[..]),
        (&[0.1; 12][..], &[7.0, 255.0][..])
    );
    for how in [How::Inline, How::Base64, How::Raw] {
        for (compressed, big) in [(false, false), (true, false), (false, true), (true, true)] {
            let bytes = file(how, compressed, big);
            assert_eq!(records(&bytes), expected, "{how:?} {compressed} {big}");
            if compressed != big {
                continue;
            }
            cut_off(&FORMAT, &bytes, true);
            changed(&FORMAT, &bytes);
        }
    }
    // Without the end of a document nothing is read, if nothing is appended.
    let text = file(How::Text, false, false);
    cut_off(&FORMAT, &text[..text.len() - 2], false);
}

#[test]
fn polygons_of_grids_are_kept() {
    let text = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid><Piece NumberOfPoints=\"4\" NumberOfCells=\"2\"><Points>\
        <DataArray type=\"Float32\" NumberOfComponents=\"3\">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points><Cells>\
        <DataArray type=\"Int32\" Name=\"connectivity\">0 1 2 3 0 1 2</DataArray><DataArray type=\"Int32\" Name=\"offsets\">4 7\
        </DataArray><DataArray type=\"UInt8\" Name=\"types\">10 5</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>";
    let (found, summary) = read(&FORMAT, text.as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).faces.iter().collect::<Vec<_>>(), [[0, 1, 2]]);
    assert_eq!(summary.dropped[0].what, "cells that are no polygons");
}

#[test]
fn faults_are_named() {
    let text = String::from_utf8(file(How::Text, false, false)).unwrap();
    for (from, to, expected) in [
        (
            "\"PolyData\"",
            "\"ImageData\"",
            "expected data of type PolyData or UnstructuredGrid, got ImageData",
        ),
        ("LittleEndian", "Middle", "expected byte_order LittleEndian or BigEndian, got 'Middle'"),
        ("UInt64", "UInt16", "expected header_type UInt32 or UInt64, got 'UInt16'"),
        (
            "header_type",
            "compressor=\"vtkLZ4DataCompressor\" header_type",
            "expected compressor vtkZLibDataCompressor, got 'vtkLZ4DataCompressor'",
        ),
        ("NumberOfPoints=\"4\"", "NumberOfPoints=\"5\"", "expected 5 × 3 coordinates, got 4 × 3"),
        (
            "NumberOfPoints=\"4\"",
            "NumberOfPoints=\"99999999999\"",
            "expected at most 4194304 points of a shape, got 99999999999",
        ),
        ("\n4 7\n", "\n4 9\n", "expected offsets from 4 to 7, got 9"),
        ("\n4 7\n", "\n4\n", "expected 4 indices of points by the offsets, got 7"),
        ("\n0 1 2 3 2 1 0\n", "\n0 1 2 3 2 1 4\n", "expected indices of vertices below 4, got 4 in face 1"),
        ("\n0 1 2 3 2 1 0\n", "\n0 1 2 3 2 1 -1\n", "expected whole numbers from 0, got -1"),
        ("\n7 255\n", "\n7\n", "expected 2 × 1 values, got 1"),
        ("\n7 255\n", "\n7 x\n", "expected a number, got 'x'"),
        ("\n7 255\n", "\n7 &boom;\n", "expected entities of XML, got '&boom;'"),
        ("ascii", "hex", "expected format ascii, binary or appended, got 'hex'"),
        ("</Points>", "</Point>", "expected XML, got a fault"),
    ] {
        let refused = refusal(&FORMAT, text.replacen(from, to, 1).as_bytes());
        assert!(refused.contains(expected), "{refused} for {to}");
    }
    let deep = "<VTKFile>".repeat(1000);
    assert_eq!(read(&FORMAT, deep.as_bytes()).unwrap_err().kind, FaultKind::TooLarge);
    let limits = Limits { points: 3, ..Limits::default() };
    assert_eq!(read_within(&FORMAT, text.as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
}

#[test]
fn arrays_that_share_their_data_are_bounded_together() {
    let file = |count: usize| {
        let array =
            |k: usize| format!("<DataArray type=\"UInt8\" Name=\"a{k}\" format=\"appended\" offset=\"0\"/>");
        let arrays: String = (0..count).map(array).collect();
        let head = format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"100000\"><PointData>{arrays}</PointData>\
             </Piece></PolyData><AppendedData encoding=\"raw\">_"
        );
        [head.as_bytes(), &100_000_u32.to_le_bytes(), &[1; 100_000], b"</AppendedData></VTKFile>"].concat()
    };
    let few = refusal(&FORMAT, &file(10));
    assert!(few.contains("expected points, got none"), "{few}");
    let many = refusal(&FORMAT, &file(50));
    assert!(many.contains(" bytes of numbers in double precision, got more"), "{many}");
}

/// A file without points, and `count` arrays without components that name the same data.
fn shared(count: usize, compressor: &str, encoding: &str, data: &[u8]) -> Vec<u8> {
    let array = "<DataArray type=\"Int8\" NumberOfComponents=\"0\" format=\"appended\" offset=\"0\"/>";
    let head = format!(
        "<VTKFile type=\"PolyData\"{compressor}><PolyData><Piece NumberOfPoints=\"0\"><PointData>{}</PointData></Piece></PolyData>\
         <AppendedData encoding=\"{encoding}\">_",
        array.repeat(count)
    );
    [head.as_bytes(), data, b"</AppendedData></VTKFile>"].concat()
}

#[test]
fn what_arrays_are_decoded_from_is_bounded_even_if_nothing_comes_out() {
    let zlib = " compressor=\"vtkZLibDataCompressor\"";
    let spaces = [" ".repeat(500_000), "AAAAAA==".into()].concat().into_bytes();
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    // Blocks of zlib, each of nothing.
    let empty = b"\x78\x9c\x03\0\0\0\0\x01";
    let empty_blocks =
        [words(&[10_000, 0, 0]), words(&[empty.len() as u32; 10_000]), empty.repeat(10_000)].concat();
    // One block of zlib, of many stored blocks of nothing.
    let stored =
        [&b"\x78\x01"[..], &b"\0\0\0\xff\xff".repeat(100_000), b"\x01\0\0\xff\xff\0\0\0\x01"].concat();
    let stored = [words(&[1, 0, 0, stored.len() as u32]), stored].concat();
    for (compressor, encoding, data) in
        [("", "base64", spaces), (zlib, "raw", empty_blocks), (zlib, "raw", stored)]
    {
        let few = refusal(&FORMAT, &shared(5, compressor, encoding, &data));
        assert!(few.contains("expected points, got none"), "{few}");
        let many = refusal(&FORMAT, &shared(60, compressor, encoding, &data));
        assert!(many.contains("bytes that arrays are decoded from in "), "{many}");
    }
}

#[test]
fn rows_that_triangles_of_a_strip_repeat_are_bounded() {
    let file = |triangles: usize, width: usize| {
        let corners = ["0 1 2"; 1000].join(" ");
        let corners: Vec<&str> = corners.split(' ').take(triangles + 2).collect();
        format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"3\"><Points><DataArray type=\"Float32\" \
             NumberOfComponents=\"3\">0 0 0 1 0 0 0 1 0</DataArray></Points><Strips><DataArray type=\"Int32\" \
             Name=\"connectivity\">{}</DataArray><DataArray type=\"Int32\" Name=\"offsets\">{}</DataArray></Strips><CellData>\
             <DataArray type=\"Int8\" Name=\"a\" NumberOfComponents=\"{width}\">{}</DataArray></CellData></Piece></PolyData>\
             </VTKFile>",
            corners.join(" "),
            triangles + 2,
            "1 ".repeat(width)
        )
    };
    let (found, _) = read(&FORMAT, file(500, 500).as_bytes()).unwrap();
    assert_eq!(mesh(&found[0]).fields["a"].values.len(), 250_000);
    let refused = refusal(&FORMAT, file(2000, 2000).as_bytes());
    assert!(refused.contains("DataArray a, byte "), "{refused}");
    assert!(refused.ends_with(" bytes of numbers in double precision, got more"), "{refused}");
}

#[test]
fn long_names_of_pieces_are_cut_off_in_the_places_of_their_lines() {
    for (name, expected) in
        [("ä".repeat(40), "ä".repeat(40)), ("ä".repeat(41), format!("{}…", "ä".repeat(40)))]
    {
        let text = format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece Name=\"{name}\" NumberOfPoints=\"2\"><Points><DataArray type=\"Int8\" \
             NumberOfComponents=\"3\">0 0 0 1 0 0</DataArray></Points><Lines><DataArray type=\"Int32\" Name=\"connectivity\">\
             0 1 1 0</DataArray><DataArray type=\"Int32\" Name=\"offsets\">2 4</DataArray></Lines></Piece></PolyData></VTKFile>"
        );
        let (found, _) = read(&FORMAT, text.as_bytes()).unwrap();
        let tags: Vec<Option<&str>> = found.iter().map(|record| record.place.tag.as_deref()).collect();
        let expected = format!("Piece {expected}");
        assert_eq!(tags, [Some(expected.as_str()); 2]);
    }
}
