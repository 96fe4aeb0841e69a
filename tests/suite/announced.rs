//! Short files whose headers announce the largest number that fits: a list for each format that is read.

use std::io::Write;
use std::sync::Arc;

use arrow_array::types::Float64Type;
use arrow_array::{ArrayRef, FixedSizeListArray, Int64Array, RecordBatch};
use arrow_ipc::writer::StreamWriter;
use flate2::Compression;
use flate2::write::GzEncoder;
use parquet::file::properties::{EnabledStatistics, WriterProperties};

use crate::dicom::{EXPLICIT, file};
use crate::http_whole::chunk;

/// A file, and what it announces.
pub(crate) type Announced = (String, Vec<u8>);

/// What stands for a number in a text, and for a coordinate that is a number of double precision but none of a shape.
const NUMBER: char = '%';
const COORDINATE: char = '~';
/// The largest numbers of 64 and 32 bits, and the most points that a shape may have on the command line: a header that keeps to
/// all limits is no reason either to take memory for what does not follow.
const LARGEST: [u64; 5] = [u64::MAX, i64::MAX as u64, u32::MAX as u64, i32::MAX as u64, 1 << 22];

/// The files of a format; `None` for one that is not known here.
pub(crate) fn announced(format: &str) -> Option<Vec<Announced>> {
    Some(match format {
        "png" => pictures(),
        "tiff" => tiffs(),
        "nii" => volumes(),
        "nii.gz" => volumes().into_iter().map(|(what, file)| (what, gzip(&file))).collect(),
        "segmentation" => segmentations(),
        "rtstruct" => structures(),
        "arrow" => streams(),
        "parquet" => parquets(),
        "npy" => arrays(),
        "npz" => archives("points.npy", &npy("(3, 2)", 1)),
        "zip" => archives("a.ndjson", b"{\"points\":[[0,0],[1,1]]}"),
        "swproj" => projects(),
        "imagej-roi" => regions(),
        "stl" => triangles(),
        "ply" => [texts(PLY), binary_ply()].concat(),
        "vtp" => [texts(VTP), encoded_vtp()].concat(),
        _ => texts(templates(format)?),
    })
}

/// Small files from which those above are made: they are whole.
pub(crate) fn whole() -> Vec<(&'static str, Vec<u8>)> {
    let cells = [nifti([3, 2, 2, 2, 1, 1, 1, 1])[..352].to_vec(), vec![1; 8]].concat();
    vec![
        ("tiff", tiff(&[])),
        ("nii.gz", gzip(&cells)),
        ("nii", cells),
        ("segmentation", segmentation("1", 2, 2)),
        ("rtstruct", structure("3")),
        ("arrow", stream().1),
        ("parquet", parquet_file()),
        ("npy", npy("(3, 2)", 1)),
        ("npy", npy("(3, 2)", 2)),
        ("npz", archive(&[("points.npy", &npy("(3, 2)", 1))], None, &[])),
        ("zip", archive(&[("a.ndjson", b"{\"points\":[[0,0],[1,1]]}")], None, &[])),
    ]
}

/// Texts in which one number announces something.
fn templates(format: &str) -> Option<&'static [&'static str]> {
    Some(match format {
        "ndjson" => {
            &["{\"vertices\":[[0,0,0],[1,0,0],[0,1,0]],\"faces\":[[0,1,%]]}", "{\"points\":[[0,0],[~,1]]}"]
        }
        "obj" => &[
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 %\n",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -%\n",
            "v 0 0 0\nl 1 %\n",
        ],
        "off" => &[
            "OFF\n% 1 0\n0 0 0\n",
            "OFF\n3 % 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n% 0 1 2\n",
        ],
        "vtk" => VTK,
        "gifti" => GIFTI,
        "particles" => &["0 0 0\n1 0 ~\n"],
        "tps" => &[
            "LM=%\n0 0\n",
            "LM3=%\n0 0 0\n",
            "LM=0\nCURVES=%\nPOINTS=1\n0 0\n",
            "LM=0\nCURVES=1\nPOINTS=%\n0 0\n",
        ],
        "nts" => {
            &["1 % 2 0 DIM=2\n0 0\n", "1 1 %0 0 DIM=2\n0 0\n", "1 %L 2L 0 DIM=2\na\n", "1 1 2 0 DIM=%\n0 0\n"]
        }
        "morphologika" => MORPHOLOGIKA,
        "fcsv" => {
            &["# Markups fiducial file version = 4.10\n# CoordinateSystem = 0\na,~,0,0,0,0,0,1,1,1,0,a,,\n"]
        }
        "mrk" => &[MARKUPS],
        "chc" => &["a 0 0 1 2 0 %\n", "a ~ 0 1 3 0 2 4 -1\n"],
        "nef" => &["#CONST 1 1 1 0\n#HARMO %\na\n1 0 0 1\n", "#CONST 1 1 1 0\n#HARMO 1\na\n1 0 0 ~\n"],
        "scalismo" => {
            &["[{\"id\":\"a\",\"coordinates\":[1,2,1e999]}]", "[{\"id\":\"a\",\"coordinates\":[1,2,3]}"]
        }
        "csv" => &["id,x1,y1,x4194304,y4194304\na,0,0,1,1\n", "id,x,y\na,0,~\n"],
        "geojson" => &["{\"type\":\"MultiPoint\",\"coordinates\":[[0,0],[~,1]]}"],
        "wkt" => &["MULTIPOINT ((0 0), (~ 1))"],
        "coco" => COCO,
        "nrrd" => NRRD,
        _ => return None,
    })
}

const PLY: &[&str] = &[
    "ply\nformat ascii 1.0\nelement vertex %\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
    "ply\nformat ascii 1.0\nelement other %\nproperty float x\nelement vertex 1\nproperty float x\nend_header\n0\n",
    "ply\nformat ascii 1.0\nelement other %\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0\n",
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
     property list uint int vertex_indices\nend_header\n0 0 0\n% 0 0 0\n",
    "ply\nformat binary_little_endian 1.0\nelement vertex %\nproperty float x\nproperty float y\nproperty float z\nend_header\n0000",
    "ply\nformat binary_big_endian 1.0\nelement face %\nproperty list uchar int vertex_indices\nend_header\n0000",
];

const VTK: &[&str] = &[
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS % float\n0 0 0\n",
    "# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS % double\n0000",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOLYGONS % 4\n3 0 0 0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOLYGONS 1 %\n3 0 0 0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nLINES 1 4\n% 0 0 0\n",
    "# vtk DataFile Version 5.1\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOLYGONS % %\nOFFSETS vtktypeint64\n0 3\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 0\nCELL_TYPES %\n5\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOINT_DATA %\nSCALARS a float 1\nLOOKUP_TABLE default\n0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOINT_DATA 1\nSCALARS a float %\nLOOKUP_TABLE default\n0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOINT_DATA 1\nFIELD f %\na 1 1 float\n0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOINT_DATA 1\nFIELD f 1\na % 1 float\n0\n",
    "# vtk DataFile Version 3.0\n\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\nPOINT_DATA 1\nFIELD f 1\na 1 % float\n0\n",
];

const VTP: &[&str] = &[
    "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"%\"><Points>\
     <DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0</DataArray></Points></Piece></PolyData></VTKFile>",
    "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"1\"><Points>\
     <DataArray type=\"Float32\" NumberOfComponents=\"%\" format=\"ascii\">0 0 0</DataArray></Points></Piece></PolyData></VTKFile>",
    "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"1\"><Points>\
     <DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"appended\" offset=\"%\"/></Points></Piece></PolyData>\
     <AppendedData encoding=\"raw\">_0000</AppendedData></VTKFile>",
    "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"1\" NumberOfPolys=\"%\">\
     <Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0</DataArray></Points><Polys>\
     <DataArray type=\"Int64\" Name=\"connectivity\" format=\"ascii\">0 0 0</DataArray>\
     <DataArray type=\"Int64\" Name=\"offsets\" format=\"ascii\">%</DataArray></Polys></Piece></PolyData></VTKFile>",
];

const GIFTI: &[&str] = &[
    "<GIFTI Version=\"1.0\" NumberOfDataArrays=\"1\"><DataArray Intent=\"NIFTI_INTENT_POINTSET\" DataType=\"NIFTI_TYPE_FLOAT32\" \
     ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"2\" Dim0=\"%\" Dim1=\"3\" Encoding=\"ASCII\" Endian=\"LittleEndian\">\
     <Data>0 0 0</Data></DataArray></GIFTI>",
    "<GIFTI Version=\"1.0\" NumberOfDataArrays=\"1\"><DataArray Intent=\"NIFTI_INTENT_POINTSET\" DataType=\"NIFTI_TYPE_FLOAT32\" \
     ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"2\" Dim0=\"%\" Dim1=\"%\" Encoding=\"Base64Binary\" Endian=\"LittleEndian\">\
     <Data>AAAAAAAAAAAAAAAA</Data></DataArray></GIFTI>",
    "<GIFTI Version=\"1.0\" NumberOfDataArrays=\"1\"><DataArray Intent=\"NIFTI_INTENT_POINTSET\" DataType=\"NIFTI_TYPE_FLOAT32\" \
     ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"%\" Dim0=\"1\" Dim1=\"3\" Encoding=\"GZipBase64Binary\" Endian=\"LittleEndian\">\
     <Data>eJwDAAAAAAE=</Data></DataArray></GIFTI>",
];

const MORPHOLOGIKA: &[&str] = &[
    "[individuals]\n%\n[landmarks]\n1\n[dimensions]\n2\n[rawpoints]\n'1\n0 0\n",
    "[individuals]\n%\n[landmarks]\n0\n[dimensions]\n2\n[rawpoints]\n'1\n",
    "[individuals]\n1\n[landmarks]\n%\n[dimensions]\n2\n[rawpoints]\n'1\n0 0\n",
    "[individuals]\n1\n[landmarks]\n1\n[dimensions]\n%\n[rawpoints]\n'1\n0 0\n",
    "[individuals]\n1\n[landmarks]\n1\n[dimensions]\n2\n[groups]\na %\n[rawpoints]\n'1\n0 0 0\n",
];

const MARKUPS: &str = "{\"@schema\":\"https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/\
     markups-schema-v1.0.3.json#\",\"markups\":[{\"type\":\"Fiducial\",\"coordinateSystem\":\"LPS\",\"controlPoints\":\
     [{\"id\":\"1\",\"label\":\"a\",\"position\":[~,0,0],\"positionStatus\":\"defined\"}]}]}";

const COCO: &[&str] = &[
    "{\"images\":[{\"id\":1,\"width\":%,\"height\":%}],\"categories\":[],\"annotations\":[{\"id\":1,\"image_id\":1,\
     \"segmentation\":{\"size\":[%,%],\"counts\":[0,%]}}]}",
    "{\"images\":[],\"categories\":[],\"annotations\":[{\"id\":1,\"image_id\":1,\"segmentation\":[[0,0,~,0,1,1]]}]}",
];

const NRRD: &[&str] = &[
    "NRRD0004\ntype: uint8\ndimension: 2\nsizes: % %\nencoding: raw\n\n00",
    "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1 1 %\nencoding: raw\n\n00",
    "NRRD0004\ntype: double\nendian: little\ndimension: %\nsizes: 1 1\nencoding: raw\n\n00",
    "NRRD0004\ntype: uint64\nendian: little\ndimension: 2\nsizes: % 1\nencoding: text\n\n0 0",
    "NRRD0004\ntype: uint64\nendian: little\ndimension: 2\nsizes: 1 %\nencoding: gzip\n\n00",
    "NRRD0004\ntype: uint8\ndimension: 2\nsizes: 1 1\nencoding: raw\nbyte skip: %\n\n00",
    "NRRD0004\ntype: uint8\ndimension: 2\nsizes: 1 1\nencoding: raw\nline skip: %\n\n00",
];

/// Each text with each of the largest numbers.
fn texts(templates: &[&str]) -> Vec<Announced> {
    let with = |template: &str, number: u64| {
        let text = template.replace(NUMBER, &number.to_string()).replace(COORDINATE, "1e308");
        let lines: Vec<&str> = text.lines().take(6).collect();
        (lines.join(" ").chars().take(160).collect(), text.into_bytes())
    };
    let all = templates.iter().flat_map(|template| {
        let numbers = if template.contains(NUMBER) { &LARGEST[..] } else { &LARGEST[..1] };
        numbers.iter().map(move |number| with(template, *number))
    });
    all.collect()
}

/// The same bytes with others from a position on.
fn patched(bytes: &[u8], at: usize, with: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[at..at + with.len()].copy_from_slice(with);
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// PNG: width and height of 31 bits and beyond, lengths of chunks, and an entry for each depth and kind of colour.
fn pictures() -> Vec<Announced> {
    let picture = |width: u32, height: u32, kind: [u8; 2]| {
        let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &kind, &[0; 3]].concat();
        let start = b"\x89PNG\r\n\x1a\n".to_vec();
        [start, chunk(b"IHDR", &header), chunk(b"IDAT", &[0; 8]), chunk(b"IEND", b"")].concat()
    };
    let most = i32::MAX as u32;
    let mut all = Vec::new();
    for (width, height) in [(most, most), (most, 1), (1, most), (u32::MAX, u32::MAX), (1 << 16, 1 << 15)] {
        for kind in [[1, 0], [16, 0], [8, 2], [16, 6], [8, 3]] {
            all.push((format!("{width} x {height} of {kind:?}"), picture(width, height, kind)));
        }
    }
    let small = picture(1, 1, [8, 0]);
    for length in [u32::MAX, most] {
        all.push(("a long header".into(), patched(&small, 8, &length.to_be_bytes())));
        all.push(("a long chunk".into(), patched(&small, 33, &length.to_be_bytes())));
    }
    all
}

/// TIFF of one row of one cell, with other entries: tag, type, count, value. Types: 3 has 16 bits, 4 has 32.
fn tiff(others: &[(u16, u16, u32, u32)]) -> Vec<u8> {
    let plain = [(256, 4, 1, 1), (257, 4, 1, 1), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1)];
    let strips = [(273, 4, 1, 8), (277, 3, 1, 1), (278, 4, 1, 1), (279, 4, 1, 1)];
    let mut entries: Vec<(u16, u16, u32, u32)> = plain.into_iter().chain(strips).collect();
    entries.retain(|(tag, ..)| others.iter().all(|(other, ..)| other != tag));
    entries.extend(others);
    entries.sort();
    let mut bytes = [&b"II*\0"[..], &8_u32.to_le_bytes(), &(entries.len() as u16).to_le_bytes()].concat();
    for (tag, kind, count, value) in entries {
        bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        bytes.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
    }
    bytes.extend([0; 4]);
    bytes
}

fn tiffs() -> Vec<Announced> {
    let most = u32::MAX;
    let cases: [&[(u16, u16, u32, u32)]; 13] = [
        &[(256, 4, 1, most), (257, 4, 1, most)],
        &[(256, 4, 1, 1 << 16), (257, 4, 1, 1 << 15), (278, 4, 1, most)],
        &[(257, 4, 1, most), (278, 4, 1, 1)],
        &[(256, 4, 1, i32::MAX as u32), (278, 4, 1, most)],
        &[(258, 3, most, 8)],
        &[(273, 4, most, 8), (279, 4, most, 8)],
        &[(273, 4, 1, most)],
        &[(279, 4, 1, most)],
        &[(277, 3, 1, 65535)],
        &[(277, 3, 1, 65535), (258, 3, 65535, 8)],
        &[(322, 4, 1, most), (323, 4, 1, most), (324, 4, 1, 8), (325, 4, 1, most)],
        &[(256, 4, 1, 1 << 20), (257, 4, 1, 1 << 20), (322, 4, 1, 16), (323, 4, 1, 16)],
        &[(320, 3, most, 8), (262, 3, 1, 3)],
    ];
    let mut all: Vec<Announced> = cases.map(|case| (format!("{case:?}"), tiff(case))).into();
    let small = tiff(&[]);
    all.push(("the place of a directory".into(), patched(&small, 4, &[255; 4])));
    all.push(("many entries".into(), patched(&small, 8, &[255; 2])));
    all.push(("the place of a next directory".into(), patched(&small, small.len() - 4, &[255; 4])));
    let big = [&b"II+\0\x08\0\0\0"[..], &16_u64.to_le_bytes(), &u64::MAX.to_le_bytes(), &[0; 24]].concat();
    all.push(("many entries of BigTIFF".into(), big.clone()));
    all.push(("the place of a directory of BigTIFF".into(), patched(&big, 8, &[255; 8])));
    all
}

/// NIfTI-1 of whole numbers of one byte with sizes, their count first.
fn nifti(sizes: [i16; 8]) -> Vec<u8> {
    let mut bytes = vec![0; 356];
    bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
    sizes
        .iter()
        .enumerate()
        .for_each(|(k, size)| bytes[40 + 2 * k..][..2].copy_from_slice(&size.to_le_bytes()));
    bytes[70..74].copy_from_slice(&[2, 0, 8, 0]);
    (0..8).for_each(|k| bytes[76 + 4 * k..][..4].copy_from_slice(&1_f32.to_le_bytes()));
    bytes[108..112].copy_from_slice(&352_f32.to_le_bytes());
    bytes[344..348].copy_from_slice(b"n+1\0");
    bytes
}

fn volumes() -> Vec<Announced> {
    let most = i16::MAX;
    let small = nifti([3, 2, 2, 2, 1, 1, 1, 1]);
    let mut all: Vec<Announced> = [
        [7, most, most, most, most, most, most, most],
        [3, most, most, most, 1, 1, 1, 1],
        [3, 1, 1, most, 1, 1, 1, 1],
        [2, most, most, 1, 1, 1, 1, 1],
        [most, 1, 1, 1, 1, 1, 1, 1],
    ]
    .map(|sizes| (format!("{sizes:?}"), nifti(sizes)))
    .into();
    let wide = [1024_i16, 64, 8].map(|kind| [kind.to_le_bytes(), 64_i16.to_le_bytes()].concat());
    all.extend(
        wide.iter().map(|kind| ("wide cells".into(), patched(&all[1].1, 70, kind))).collect::<Vec<_>>(),
    );
    all.push(("a place of the cells".into(), patched(&small, 108, &f32::MAX.to_le_bytes())));
    let extended = patched(&small, 348, &[1, 0, 0, 0, 255, 255, 255, 127]);
    all.push(("a long extension".into(), patched(&extended, 108, &368_f32.to_le_bytes())));
    all
}

/// DICOM segmentation with a number of frames and of cells of each, whose pixels are `length` bytes by their header.
fn segmentation(frames: &str, side: u16, length: u32) -> Vec<u8> {
    let e = EXPLICIT;
    let plane = e.sequence(0x0020_9116, &[e.text(0x0020_0037, "DS", "1\\0\\0\\0\\1\\0")]);
    let measures = [e.text(0x0018_0088, "DS", "2"), e.text(0x0028_0030, "DS", "0.5\\0.25")].concat();
    let shared = [plane, e.sequence(0x0028_9110, &[measures])].concat();
    let position = e.text(0x0020_0032, "DS", "0\\0\\0");
    let number = e.number(0x0062_000b, 1);
    let frame = [e.sequence(0x0020_9113, &[position]), e.sequence(0x0062_000a, &[number])].concat();
    let segment = [e.number(0x0062_0004, 1), e.text(0x0062_0005, "LO", "a")].concat();
    let set = [
        e.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.66.4"),
        e.text(0x0028_0008, "IS", frames),
        e.number(0x0028_0010, side),
        e.number(0x0028_0011, side),
        e.number(0x0028_0100, 1),
        e.text(0x0062_0001, "CS", "BINARY"),
        e.sequence(0x0062_0002, &[segment]),
        e.sequence(0x5200_9229, &[shared]),
        e.sequence(0x5200_9230, &[frame]),
        e.header(0x7fe0_0010, "OB", length),
        vec![1, 0],
    ];
    file(e.syntax(), &set.concat())
}

fn segmentations() -> Vec<Announced> {
    let most = i32::MAX.to_string();
    let cases =
        [(&*most, 65535, 2), (&*most, 2, 2), ("1", 65535, 2), ("1", 2, u32::MAX - 1), ("1", 65535, u32::MAX)];
    let mut all: Vec<Announced> = cases
        .map(|(frames, side, length)| {
            (format!("{frames} of {side}, {length} bytes"), segmentation(frames, side, length))
        })
        .into();
    all.push((
        "a long element".into(),
        file(EXPLICIT.syntax(), &EXPLICIT.header(0x0008_0005, "UN", u32::MAX - 1)),
    ));
    all
}

/// DICOM structure set with one triangle, whose number of points is a text.
fn structure(count: &str) -> Vec<u8> {
    let e = EXPLICIT;
    let name =
        [e.text(0x3006_0022, "IS", "1"), e.text(0x3006_0024, "UI", "1.2"), e.text(0x3006_0026, "LO", "a")];
    let data = e.text(0x3006_0050, "DS", "0\\0\\0\\1\\0\\0\\0\\1\\0");
    let contour =
        [e.text(0x3006_0042, "CS", "CLOSED_PLANAR"), e.text(0x3006_0046, "IS", count), data].concat();
    let contour = [e.sequence(0x3006_0040, &[contour]), e.text(0x3006_0084, "IS", "1")].concat();
    let names = e.sequence(0x3006_0020, &[name.concat()]);
    file(e.syntax(), &[structure_class(), names, e.sequence(0x3006_0039, &[contour])].concat())
}

fn structure_class() -> Vec<u8> {
    EXPLICIT.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.481.3")
}

fn structures() -> Vec<Announced> {
    let long = |tag: u32, vr: &str, length: u32| {
        file(EXPLICIT.syntax(), &[structure_class(), EXPLICIT.header(tag, vr, length)].concat())
    };
    vec![
        ("many points".into(), structure(&i32::MAX.to_string())),
        ("a long sequence".into(), long(0x3006_0039, "SQ", u32::MAX - 1)),
        ("an open sequence".into(), long(0x3006_0039, "SQ", u32::MAX)),
        ("a long value".into(), long(0x3006_0050, "UN", u32::MAX - 1)),
    ]
}

/// Eleven shapes of two points as a stream of Arrow.
fn stream() -> (RecordBatch, Vec<u8>) {
    let points = FixedSizeListArray::from_iter_primitive::<Float64Type, _, _>(
        (0..11).map(|k| Some([Some(0.0), Some(1.0), Some(f64::from(k)), Some(0.5)])),
        4,
    );
    let dimension = Int64Array::from(vec![2; 11]);
    let columns = [("points", Arc::new(points) as ArrayRef), ("dimension", Arc::new(dimension))];
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let mut bytes = Vec::new();
    let mut writer = StreamWriter::try_new(&mut bytes, &batch.schema()).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();
    drop(writer);
    (batch, bytes)
}

/// Arrow: lengths of metadata, and every number of 64 bits that counts rows, values or bytes.
fn streams() -> Vec<Announced> {
    let (_, small) = stream();
    let head = [255_u8, 255, 255, 255];
    let mut all: Vec<Announced> = vec![
        ("long metadata".into(), [&head[..], &i32::MAX.to_le_bytes(), &small[8..]].concat()),
        (
            "a long end of a file".into(),
            [b"ARROW1\0\0", &small[..], &i32::MAX.to_le_bytes(), b"ARROW1"].concat(),
        ),
    ];
    for at in (0..small.len() - 8).step_by(8) {
        let number = i64::from_le_bytes(small[at..at + 8].try_into().unwrap());
        if (1..=4096).contains(&number) {
            all.push((format!("{number} at {at}"), patched(&small, at, &i64::MAX.to_le_bytes())));
        }
    }
    assert!(all.len() > 6, "{} numbers", all.len());
    all
}

/// The same shapes as a file of Parquet.
fn parquet_file() -> Vec<u8> {
    let (batch, mut bytes) = (stream().0, Vec::new());
    // Without what a reader need not look at.
    let settings = WriterProperties::builder()
        .set_statistics_enabled(EnabledStatistics::None)
        .set_offset_index_disabled(true)
        .set_dictionary_enabled(false)
        .build();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), Some(settings)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    bytes
}

/// Parquet: the length of its end, and every number of rows and of values in it.
fn parquets() -> Vec<Announced> {
    let small = parquet_file();
    let end = small.len() - 8;
    let length = u32::from_le_bytes(small[end..end + 4].try_into().unwrap()) as usize;
    let mut all: Vec<Announced> = [u32::MAX, i32::MAX as u32]
        .map(|length| ("a long end".into(), patched(&small, end, &length.to_le_bytes())))
        .into();
    // Numbers are zigzag and variable: 11 rows are 22, 44 values are 88, and the largest number has ten bytes.
    let most = [&[0xfe][..], &[0xff; 8], &[1]].concat();
    for at in (end - length..end).filter(|at| [22, 88].contains(&small[*at])) {
        let longer = ((length + most.len() - 1) as u32).to_le_bytes();
        let file = [&small[..at], &most, &small[at + 1..end], &longer, b"PAR1"].concat();
        all.push((format!("byte {at} behind {:02x?}", &small[at - 6..at + 4]), file));
    }
    assert!(all.len() > 4, "{} numbers", all.len());
    all
}

/// NPY of doubles whose header is text of a version.
fn npy(shape: &str, version: u8) -> Vec<u8> {
    let text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = text.len() as u32;
    let length =
        if version == 1 { length.to_le_bytes()[..2].to_vec() } else { length.to_le_bytes().to_vec() };
    [b"\x93NUMPY", &[version, 0][..], &length, text.as_bytes(), &[0; 48]].concat()
}

fn arrays() -> Vec<Announced> {
    let shapes = LARGEST.into_iter().flat_map(|n| {
        [
            format!("({n}, 2)"),
            format!("(1, {n}, 2)"),
            format!("({n}, {n}, {n})"),
            format!("(0, {n}, 2)"),
            format!("({n}, 0, 2)"),
        ]
    });
    let mut all: Vec<Announced> = shapes.map(|shape| (shape.clone(), npy(&shape, 1))).collect();
    all.push(("a long header".into(), patched(&npy("(3, 2)", 1), 8, &[255; 2])));
    all.push(("a long header of version 2".into(), patched(&npy("(3, 2)", 2), 8, &[255; 4])));
    all
}

/// An archive of stored files: the size of each by its headers, if it is another one, and further bytes of each entry.
pub(crate) fn archive(files: &[(&str, &[u8])], size: Option<u32>, extra: &[u8]) -> Vec<u8> {
    let (mut local, mut central) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let mut sum = flate2::Crc::new();
        sum.update(content);
        let length = content.len() as u32;
        let sizes = [if extra.is_empty() { length } else { u32::MAX }, size.unwrap_or(length)];
        let lengths = [(name.len() as u16).to_le_bytes(), (extra.len() as u16).to_le_bytes()].concat();
        let sizes = sizes.map(u32::to_le_bytes).concat();
        let described = [&[0; 8][..], &sum.sum().to_le_bytes(), &sizes, &lengths].concat();
        let (start, name) = ((local.len() as u32).to_le_bytes(), name.as_bytes());
        central.extend([b"PK\x01\x02\x2d\0\x2d\0", &described[..], &[0; 10], &start, name, extra].concat());
        local.extend([b"PK\x03\x04\x2d\0", &described[..], name, extra, content].concat());
    }
    let count = (files.len() as u16).to_le_bytes();
    let ends = [(central.len() as u32).to_le_bytes(), (local.len() as u32).to_le_bytes()].concat();
    let end = [b"PK\x05\x06\0\0\0\0", &count[..], &count, &ends, &[0; 2]].concat();
    [local, central, end].concat()
}

/// Archives: sizes of 64 bits, numbers of entries, places. Sizes of 32 bits are used by no reader.
fn archives(name: &str, content: &[u8]) -> Vec<Announced> {
    let small = archive(&[(name, content)], None, &[]);
    let long = [&[1, 0, 16, 0][..], &[255; 7], &[127], &[255; 7], &[127]].concat();
    let end = small.len() - 22;
    vec![
        ("a long entry of 64 bits".into(), archive(&[(name, content)], Some(u32::MAX), &long)),
        ("many entries".into(), patched(&small, end + 8, &[255, 255, 255, 255])),
        ("a long list of entries".into(), patched(&small, end + 12, &[255, 255, 255, 127])),
        ("the place of the list".into(), patched(&small, end + 16, &[255, 255, 255, 127])),
    ]
}

/// A workbook with one sheet, of which its last cell is used, and a list of texts that says to be long.
fn workbook(count: u64) -> Vec<u8> {
    let relation = |id: &str, kind: &str, target: &str| {
        let schema = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
        format!("<Relationship Id=\"{id}\" Type=\"{schema}/{kind}\" Target=\"{target}\"/>")
    };
    let relations = |all: &str| {
        let schema = "http://schemas.openxmlformats.org/package/2006/relationships";
        format!("<Relationships xmlns=\"{schema}\">{all}</Relationships>")
    };
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let parts = [
        ("[Content_Types].xml", "<Types/>".to_owned()),
        ("_rels/.rels", relations(&relation("rId1", "officeDocument", "xl/workbook.xml"))),
        (
            "xl/_rels/workbook.xml.rels",
            relations(
                &(relation("rId1", "worksheet", "worksheets/sheet1.xml")
                    + &relation("rId2", "sharedStrings", "sharedStrings.xml")),
            ),
        ),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{main}\" xmlns:r=\"http://schemas.openxmlformats.org/officeDocument/2006/relationships\">\
                 <sheets><sheet name=\"data\" sheetId=\"1\" r:id=\"rId1\"/></sheets></workbook>"
            ),
        ),
        (
            "xl/worksheets/sheet1.xml",
            format!(
                "<worksheet xmlns=\"{main}\"><dimension ref=\"A1:XFD{count}\"/><sheetData><row r=\"{count}\">\
                 <c r=\"XFD{count}\"><v>1</v></c></row></sheetData></worksheet>"
            ),
        ),
        (
            "xl/sharedStrings.xml",
            format!("<sst xmlns=\"{main}\" count=\"{count}\" uniqueCount=\"{count}\"></sst>"),
        ),
    ];
    let files: Vec<(&str, &[u8])> = parts.iter().map(|(name, text)| (*name, text.as_bytes())).collect();
    archive(&files, None, &[])
}

/// Projects: numbers of a table as JSON, and a workbook whose one cell is the last one that there is.
fn projects() -> Vec<Announced> {
    let tables = texts(&[
        "{\"data\":[{\"name\":%,\"shape_1\":\"a.ply\"}]}",
        "{\"data\":[{\"name\":\"a\",\"shape_%\":\"a.ply\"}]}",
    ]);
    let last = [1 << 20, u64::from(u32::MAX), u64::MAX];
    let books = last.map(|count| (format!("a cell in row {count}"), workbook(count)));
    [tables, books.to_vec()].concat()
}

/// ImageJ: numbers of points, a composite region, and places of names.
fn regions() -> Vec<Announced> {
    let mut small = vec![0; 128];
    small[..4].copy_from_slice(b"Iout");
    small[4..8].copy_from_slice(&[0, 228, 0, 0]);
    small[8..16].copy_from_slice(&[0, 0, 0, 0, 0, 9, 0, 9]);
    small[60..64].copy_from_slice(&64_u32.to_be_bytes());
    let rectangle = patched(&small, 6, &[1]);
    vec![
        ("many points".into(), patched(&small, 16, &[255; 2])),
        ("many points of 32 bits".into(), patched(&small, 18, &[127, 255, 255, 255])),
        ("a long composite".into(), patched(&rectangle, 36, &[255; 4])),
        ("a composite of 31 bits".into(), patched(&rectangle, 36, &[127, 255, 255, 255])),
        ("the place of a second header".into(), patched(&small, 60, &[255; 4])),
        ("a long name".into(), patched(&patched(&rectangle, 64 + 20, &[255; 4]), 64 + 16, &[0, 0, 0, 64])),
        (
            "the place of a name".into(),
            patched(&patched(&rectangle, 64 + 20, &[0, 0, 0, 2]), 64 + 16, &[255; 4]),
        ),
    ]
}

fn triangles() -> Vec<Announced> {
    let most = [u32::MAX, i32::MAX as u32, 1 << 24, 1 << 22];
    most.map(|count| (format!("{count} triangles"), [&[0; 80][..], &count.to_le_bytes(), &[0; 50]].concat()))
        .into()
}

/// PLY in bytes: a face with the longest list of each type of length.
fn binary_ply() -> Vec<Announced> {
    let types = [
        ("uchar", vec![255_u8]),
        ("ushort", vec![255; 2]),
        ("uint", vec![255; 4]),
        ("int", vec![255, 255, 255, 127]),
    ];
    let file = |(kind, length): (&str, Vec<u8>)| {
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list {kind} int vertex_indices\nend_header\n"
        );
        (format!("a list by {kind}"), [head.as_bytes(), &[0; 12], &length, &[0; 12]].concat())
    };
    types.map(file).into()
}

/// VTK XML in base64: the longest array, and the most and largest blocks.
fn encoded_vtp() -> Vec<Announced> {
    let encode = |bytes: &[u8]| base64::Engine::encode(&base64::engine::general_purpose::STANDARD, bytes);
    let file = |compressor: &str, data: &str| {
        format!(
            "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\"{compressor}><PolyData>\
             <Piece NumberOfPoints=\"1\"><Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"binary\">{data}</DataArray>\
             </Points></Piece></PolyData></VTKFile>"
        )
        .into_bytes()
    };
    let long = encode(&[&u64::MAX.to_le_bytes()[..], &[0; 12]].concat());
    let zlib = " compressor=\"vtkZLibDataCompressor\"";
    let blocks = |head: [u64; 4]| {
        let head: Vec<u8> = head.iter().flat_map(|number| number.to_le_bytes()).collect();
        file(zlib, &format!("{}{}", encode(&head), encode(&[0; 12])))
    };
    vec![
        ("a long array".into(), file("", &long)),
        ("many blocks".into(), blocks([u64::MAX, 12, 12, 12])),
        ("large blocks".into(), blocks([1, u64::MAX, 0, 12])),
        ("a large last block".into(), blocks([1, 12, u64::MAX, 12])),
        ("a block of many bytes".into(), blocks([1, 12, 0, u64::MAX])),
    ]
}
