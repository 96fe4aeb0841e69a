//! The beginning of a file never passes for all of it: what is cut, doubled or followed by other bytes is read whole or refused.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use shapelex_formats::shape::{
    FORMATS, Format, Geometry, Kind, Limits, Mesh, Place, Points, ReadOptions, Record, Source, WriteOptions,
    read,
};

/// A shape of a kind, with another one for each number.
pub(crate) fn record(kind: Kind, dimension: usize, number: usize) -> Record {
    let k = number as f64;
    let rows: Vec<f64> = match dimension {
        2 => [0.0, 0.0, 4.0 + k, 0.5, 3.0, 5.0, 1.0, 6.0 - k].to_vec(),
        _ => [0.0, 0.0, 0.0, 4.0 + k, 0.5, 0.25, 3.0, 5.0, 1.0, 1.0, 6.0 - k, 2.0].to_vec(),
    };
    let points = Points::from_rows(dimension, rows);
    let geometry = match kind {
        Kind::Landmarks => Geometry::Landmarks(points),
        Kind::Curve => Geometry::Curve { points, closed: true },
        _ => {
            let mut mesh = Mesh { vertices: points, ..Mesh::default() };
            [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]].into_iter().for_each(|face| mesh.faces.push(face));
            Geometry::Mesh(mesh)
        }
    };
    Record { name: Some(format!("s{number}")), ..Record::new(geometry, Place::default()) }
}

/// A file of `count` shapes, if the format has such ones.
fn file(format: &'static Format, kind: Kind, dimension: usize, count: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut writer = format.writer(&mut bytes, &WriteOptions::default()).ok()?;
    for number in 0..count {
        writer.push(&record(kind, dimension, number)).ok()?;
    }
    writer.finish().ok()?;
    Some(bytes)
}

/// Number of records of a file; none if it is refused.
fn count(format: &'static Format, bytes: &[u8]) -> Option<usize> {
    let mut source = Source::new(bytes, Limits::default()).ok()?;
    let mut count = 0;
    let read = read(format, &mut source, &ReadOptions::default(), &mut |_| {
        count += 1;
        Ok(())
    });
    read.ok().map(|_| count)
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn a_file_is_read_whole_or_refused() {
    let mut tried = Vec::new();
    for format in FORMATS.iter().filter(|format| format.is_read() && format.is_written()) {
        for (kind, dimension) in
            [(Kind::Landmarks, 2), (Kind::Landmarks, 3), (Kind::Curve, 2), (Kind::Mesh, 3)]
        {
            let sizes = if kind == Kind::Mesh { 1 } else { 3 };
            let Some(bytes) = file(format, kind, dimension, sizes) else { continue };
            let Some(whole) = count(format, &bytes) else { continue };
            let id = format!("{} of {}", format.id, kind.name());
            let packed = gzip(&bytes);
            assert_eq!(count(format, &packed), Some(whole), "{id} in gzip");
            let (head, tail) = bytes.split_at(bytes.len() / 2);
            assert_eq!(count(format, &[gzip(head), gzip(tail)].concat()), Some(whole), "{id} in two parts");
            for end in [packed.len() - 1, packed.len() - 8, packed.len() / 2] {
                assert_eq!(
                    count(format, &packed[..end]),
                    None,
                    "{id}: {end} of {} bytes of gzip",
                    packed.len()
                );
            }
            for after in [&b"x"[..], b"{\"points\":", b"\x01\x02\x03"] {
                assert_eq!(
                    count(format, &[&packed[..], after].concat()),
                    None,
                    "{id} in gzip before {after:?}"
                );
                assert_eq!(count(format, &[&bytes[..], after].concat()), None, "{id} before {after:?}");
            }
            let twice = count(format, &[&bytes[..], &bytes[..]].concat());
            assert!(twice.is_none_or(|twice| twice > whole), "{id} twice: {twice:?} of {whole}");
            tried.push(id);
        }
    }
    assert!(tried.len() > 20, "{tried:?}");
}
