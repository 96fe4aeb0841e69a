//! Stereolithography (STL): triangles without shared vertices, as text or binary.
//!
//! Corners with exactly the same coordinates become one vertex, and the summary says so. Each `solid` of a text is a shape of its
//! own. Normals are a field of the faces, as is the `attribute` of a binary file if it is not 0 everywhere.

mod write;

use std::collections::HashMap;

use super::super::format::Format;
use super::super::limits::Limits;
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Kind};
use super::super::source::Source;
use super::NORMALS;
use super::draft::Draft;
use super::scalar::Scalar;
use super::scan::{Scan, number, text, words, wrong};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// STL.
pub(in super::super) static FORMAT: Format = Format {
    id: "stl",
    name: "STL",
    media_types: &["model/stl", "application/sla"],
    extensions: &["stl"],
    recognise: |head| {
        head.starts_with(b"solid") && head.windows(6).any(|word| word.eq_ignore_ascii_case(b"facet "))
    },
    kinds: &[Kind::Mesh],
    options: &[],
    read: Some(read),
    open: Some(write::open),
};

/// Number of bytes before the triangles of a binary file.
const HEAD: usize = 84;
/// Number of bytes of a triangle.
const TRIANGLE: usize = 50;

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    let mut summary = Summary::default();
    let claim = bytes.get(HEAD - 4..HEAD).map(|count| Scalar::U32.decode(count, false) as u64);
    let length = claim.map(|count| HEAD as u64 + count * TRIANGLE as u64);
    // A binary file may begin with "solid" too: its length tells.
    let binary = length == Some(bytes.len() as u64);
    let solid = bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    summary.set("encoding", if binary || !solid { "binary" } else { "ascii" });
    if !binary && solid {
        read_text(&bytes, &limits, &mut summary, sink)?;
        return Ok(summary);
    }
    let Some(length) = length else {
        let detail = format!("expected 'solid', or the {HEAD} bytes of a header, got {} bytes", bytes.len());
        return Err(FileError::truncated(Place::default(), detail));
    };
    limits.faces((length - HEAD as u64) / TRIANGLE as u64, || Place::byte(80))?;
    if !binary {
        let detail = format!("expected {length} bytes by the number of triangles, got {}", bytes.len());
        let fault = if length > bytes.len() as u64 { FileError::truncated } else { FileError::malformed };
        return Err(fault(Place::byte(80), detail));
    }
    let mut solid = Solid::new(None, Place::default());
    for triangle in bytes[HEAD..].chunks_exact(TRIANGLE) {
        let values = Scalar::F32.decode_all(&triangle[..48], false);
        solid.normals.extend(&values[..3]);
        values[3..].chunks_exact(3).try_for_each(|point| solid.corner(point, &limits, Place::default))?;
        solid.attributes.push(Scalar::U16.decode(&triangle[48..], false));
    }
    solid.send(&mut summary, sink)?;
    Ok(summary)
}

/// A solid with its vertices so far.
struct Solid {
    draft: Draft,
    known: HashMap<[u64; 3], u32>,
    corners: Vec<u32>,
    normals: Vec<f64>,
    attributes: Vec<f64>,
}

impl Solid {
    fn new(name: Option<String>, place: Place) -> Self {
        let mut draft = Draft::new(place);
        draft.name = name;
        Self {
            draft,
            known: HashMap::new(),
            corners: Vec::new(),
            normals: Vec::new(),
            attributes: Vec::new(),
        }
    }

    fn corner(&mut self, point: &[f64], limits: &Limits, place: impl Fn() -> Place) -> Result<(), FileError> {
        // A sum with 0 makes one zero of both.
        let [x, y, z] = [0, 1, 2].map(|k| (point[k] + 0.0).to_bits());
        let next = self.draft.vertices.len();
        let vertex = match self.known.get(&[x, y, z]) {
            Some(vertex) => *vertex,
            None => {
                limits.points(next as u64 + 1, place)?;
                self.draft.vertices.push(point);
                // At most as many as there are faces, which are counted in 32 bits.
                let vertex = u32::try_from(next).unwrap_or(u32::MAX);
                self.known.insert([x, y, z], vertex);
                vertex
            }
        };
        self.corners.push(vertex);
        Ok(())
    }

    fn send(mut self, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
        let merged = self.corners.len() - self.draft.vertices.len();
        let before = summary.properties.get("merged_corners").and_then(serde_json::Value::as_u64);
        summary.set("merged_corners", before.unwrap_or(0) + merged as u64);
        for triangle in self.corners.chunks_exact(3) {
            self.draft.faces.push(triangle.iter().copied());
        }
        self.draft.field(NORMALS, Domain::Faces, 3, self.normals);
        if self.attributes.iter().any(|attribute| *attribute != 0.0) {
            self.draft.field("attribute", Domain::Faces, 1, self.attributes);
        }
        self.draft.send(summary, sink)
    }
}

fn read_text(bytes: &[u8], limits: &Limits, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
    let mut scan = Scan::new(bytes);
    let mut count = 0;
    while let Some(line) = scan.line() {
        let mut rest = words(line);
        match rest.next() {
            None => continue,
            Some(word) if word.eq_ignore_ascii_case(b"solid") => {}
            Some(word) => return Err(wrong(word, "'solid'", scan.place())),
        }
        let place = Place { item: Some(count), ..scan.place() };
        let name = text(&line.trim_ascii_start()[5..], || scan.place())?;
        let mut solid = Solid::new(Some(name).filter(|name| !name.is_empty()).map(str::to_owned), place);
        while facet(&mut scan, &mut solid, limits)? {}
        if solid.corners.is_empty() {
            summary.drop("solids without triangles", solid.draft.name.as_deref(), || scan.place());
        } else {
            solid.send(summary, sink)?;
        }
        count += 1;
    }
    Ok(())
}

/// Reads a triangle. Returns `false` at the end of the solid.
fn facet(scan: &mut Scan<'_>, solid: &mut Solid, limits: &Limits) -> Result<bool, FileError> {
    let first = scan.expect_word("'facet' or 'endsolid'")?;
    if first.eq_ignore_ascii_case(b"endsolid") {
        // A name may follow.
        if !scan.rest().starts_with(b"\n") {
            scan.line();
        }
        return Ok(false);
    }
    if !first.eq_ignore_ascii_case(b"facet") {
        return Err(wrong(first, "'facet' or 'endsolid'", scan.place()));
    }
    limits.faces(solid.corners.len() as u64 / 3 + 1, || scan.place())?;
    keywords(scan, &["normal"])?;
    for _ in 0..3 {
        let word = scan.expect_word("a number")?;
        // A normal that is not there is written in several ways.
        solid.normals.push(number(word, "a number", || scan.place()).unwrap_or(f64::NAN));
    }
    keywords(scan, &["outer", "loop"])?;
    for _ in 0..3 {
        keywords(scan, &["vertex"])?;
        let mut point = [0.0; 3];
        for x in &mut point {
            *x = scan.number("a number")?;
            if !x.is_finite() {
                return Err(FileError::malformed(
                    scan.place(),
                    format!("expected finite coordinates, got {x}"),
                ));
            }
        }
        solid.corner(&point, limits, || scan.place())?;
    }
    keywords(scan, &["endloop", "endfacet"])?;
    Ok(true)
}

fn keywords(scan: &mut Scan<'_>, expected: &[&str]) -> Result<(), FileError> {
    for keyword in expected {
        let word = scan.expect_word(&format!("'{keyword}'"))?;
        if !word.eq_ignore_ascii_case(keyword.as_bytes()) {
            return Err(wrong(word, &format!("'{keyword}'"), scan.place()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
