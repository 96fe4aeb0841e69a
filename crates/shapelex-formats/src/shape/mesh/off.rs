//! Object File Format (OFF) of Geomview, as text: with comments, and with normals (`N`), colours (`C`) and texture coordinates (`ST`).
//!
//! Numbers after the corners of a face are its colour.

use super::super::format::Format;
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Kind};
use super::super::source::Source;
use super::draft::Draft;
use super::scan::{Scan, count, number, words, wrong};
use super::{COLOURS, NORMALS, TEXTURE};
use crate::error::{FileError, Place};
use crate::shape::limits::Limits;
use crate::summary::Summary;

/// OFF.
pub(in super::super) static FORMAT: Format = Format {
    id: "off",
    name: "OFF",
    media_types: &["model/off", "application/x-off"],
    extensions: &["off"],
    recognise: |head| {
        let word = words(head).next().unwrap_or_default();
        prefix(word).is_some_and(|(_, rest)| rest.is_empty() || rest[0].is_ascii_digit())
    },
    kinds: &[Kind::Mesh, Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: None,
};

/// Values of vertices beside coordinates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Prefix {
    texture: bool,
    colours: bool,
    normals: bool,
    /// Four coordinates, or as many as the file says.
    dimension: bool,
}

/// The word that begins a file, and the text after it without a space.
fn prefix(word: &[u8]) -> Option<(Prefix, &[u8])> {
    let mut found = Prefix::default();
    let mut rest = word;
    let take = |part: &[u8], rest: &mut &[u8]| {
        let taken = rest.strip_prefix(part);
        *rest = taken.unwrap_or(*rest);
        taken.is_some()
    };
    found.texture = take(b"ST", &mut rest);
    found.colours = take(b"C", &mut rest);
    found.normals = take(b"N", &mut rest);
    found.dimension = take(b"4", &mut rest) | take(b"n", &mut rest);
    take(b"OFF", &mut rest).then_some((found, rest))
}

/// Lines with words, without comments.
struct Lines<'a>(Scan<'a>);

impl<'a> Lines<'a> {
    fn next(&mut self, what: &str) -> Result<Vec<&'a [u8]>, FileError> {
        while let Some(line) = self.0.line() {
            let line = line.split(|byte| *byte == b'#').next().unwrap_or_default();
            let found: Vec<&[u8]> = words(line).collect();
            if !found.is_empty() {
                return Ok(found);
            }
        }
        Err(FileError::truncated(self.0.place(), format!("expected {what}, got the end of the file")))
    }
}

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    let mut lines = Lines(Scan::new(&bytes));
    let mut first = lines.next("'OFF'")?;
    let Some((prefix, rest)) = prefix(first[0]) else {
        return Err(wrong(first[0], "'OFF'", lines.0.place()));
    };
    if prefix.dimension || first.get(1) == Some(&&b"BINARY"[..]) {
        let detail = "expected a text of points in three dimensions, got another kind of OFF";
        return Err(FileError::unsupported(lines.0.place(), detail));
    }
    first.remove(0);
    if !rest.is_empty() {
        first.insert(0, rest);
    }
    let counts = if first.is_empty() { lines.next("numbers of vertices and faces")? } else { first };
    let place = lines.0.place();
    let (2 | 3, Some(vertices), Some(faces)) = (counts.len(), counts.first(), counts.get(1)) else {
        let detail = format!("expected numbers of vertices, faces and edges, got {} words", counts.len());
        return Err(FileError::malformed(place, detail));
    };
    let vertices =
        limits.points(count(vertices, "a number of vertices", || place.clone())?, || place.clone())?;
    let faces = limits.faces(count(faces, "a number of faces", || place.clone())?, || place.clone())?;
    let mut summary = Summary::default();
    let mut draft = Draft::new(Place::default());
    read_vertices(&mut lines, prefix, vertices, &mut draft)?;
    read_faces(&mut lines, faces, &limits, &mut draft)?;
    if lines.next("").is_ok() {
        return Err(FileError::malformed(lines.0.place(), "expected the end of the file, got another line"));
    }
    draft.send(&mut summary, sink)?;
    Ok(summary)
}

fn read_vertices(
    lines: &mut Lines<'_>,
    prefix: Prefix,
    count: usize,
    draft: &mut Draft,
) -> Result<(), FileError> {
    let widths = [if prefix.normals { 3 } else { 0 }, 0, if prefix.texture { 2 } else { 0 }];
    let mut values: [Vec<f64>; 3] = Default::default();
    let mut of_colours = None;
    for k in 0..count {
        let line = lines.next("a vertex")?;
        let place = || Place { item: Some(k as u64), ..lines.0.place() };
        let numbers =
            line.iter().map(|word| number(word, "a number", place)).collect::<Result<Vec<f64>, _>>()?;
        let plain = 3 + widths[0] + widths[2];
        let colours = numbers.len().checked_sub(plain);
        let fits = match (prefix.colours, colours) {
            (false, Some(0)) => true,
            // Red, green and blue; opacity may be left out in all vertices.
            (true, Some(width @ 3..=4)) => *of_colours.get_or_insert(width) == width,
            _ => false,
        };
        if !fits {
            let colours = if prefix.colours { of_colours.unwrap_or(4) } else { 0 };
            let detail = format!("expected {} numbers of a vertex, got {}", plain + colours, numbers.len());
            return Err(FileError::malformed(place(), detail));
        }
        if let Some(x) = numbers[..3].iter().find(|x| !x.is_finite()) {
            return Err(FileError::malformed(place(), format!("expected finite coordinates, got {x}")));
        }
        draft.vertices.push(&numbers[..3]);
        let ends = [3 + widths[0], numbers.len() - widths[2], numbers.len()];
        let mut start = 3;
        for (values, end) in values.iter_mut().zip(ends) {
            values.extend(&numbers[start..end]);
            start = end;
        }
    }
    let widths = [widths[0], of_colours.unwrap_or(0), widths[2]];
    for ((values, width), name) in values.into_iter().zip(widths).zip([NORMALS, COLOURS, TEXTURE]) {
        if width > 0 {
            draft.field(name, Domain::Vertices, width, values);
        }
    }
    Ok(())
}

fn read_faces(
    lines: &mut Lines<'_>,
    faces: usize,
    limits: &Limits,
    draft: &mut Draft,
) -> Result<(), FileError> {
    let mut colours: Vec<Vec<f64>> = Vec::new();
    for k in 0..faces {
        let line = lines.next("a face")?;
        let place = || Place { item: Some(k as u64), ..lines.0.place() };
        let size = count(line[0], "a number of corners", place)?;
        let size = limits.points(size, place)?;
        if line.len() <= size {
            let detail = format!("expected {size} indices of vertices, got {}", line.len() - 1);
            return Err(FileError::malformed(place(), detail));
        }
        let known = draft.vertices.len() as u64;
        let mut corners = Vec::with_capacity(size);
        for word in &line[1..=size] {
            let corner = count(word, "an index of a vertex", place)?;
            let index = u32::try_from(corner).ok().filter(|_| corner < known);
            corners.push(index.ok_or_else(|| {
                FileError::malformed(
                    place(),
                    format!("expected indices of vertices below {known}, got {corner}"),
                )
            })?);
        }
        draft.faces.push(corners);
        let colour = line[1 + size..].iter().map(|word| number(word, "a number", place));
        let colour = colour.collect::<Result<Vec<f64>, _>>()?;
        if !matches!(colour.len(), 0 | 1 | 3 | 4) {
            let detail = format!("expected a colour of 1, 3 or 4 numbers, got {}", colour.len());
            return Err(FileError::malformed(place(), detail));
        }
        colours.push(colour);
    }
    let width = colours.iter().map(Vec::len).max().unwrap_or(0);
    if width > 0 {
        let components = colours.iter().flat_map(|colour| (0..width).map(|k| colour.get(k).copied()));
        let values = components.map(|value| value.unwrap_or(f64::NAN)).collect();
        // A single number is a position in a table of the program.
        draft.field(if width == 1 { "colour_index" } else { COLOURS }, Domain::Faces, width, values);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::testing::{changed, cut_off, mesh, read, read_within, refusal};
    use super::*;
    use crate::shape::FaultKind;

    const ALL: &str = "STCNOFF # all\n3 2 0\n0 0 0 0 0 1 1 0 0 0.5 0 0\n\n1 0 0 0 0 1 0 1 0 0.5 1 0 # b\n\
                       0 1 0 0 0 1 0 0 1 0.5 0 1\n3 0 1 2\n3 2 1 0 255 0 9\n";

    #[test]
    fn all_values_become_fields() {
        let (found, _) = read(&FORMAT, ALL.as_bytes()).unwrap();
        let mesh = mesh(&found[0]);
        assert_eq!(mesh.faces.iter().collect::<Vec<_>>(), [[0, 1, 2], [2, 1, 0]]);
        assert_eq!(mesh.fields[NORMALS].values[6..], [0.0, 0.0, 1.0]);
        assert_eq!(mesh.fields[COLOURS].values[4..8], [0.0, 1.0, 0.0, 0.5]);
        assert_eq!(mesh.fields[TEXTURE].values, [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        assert_eq!(mesh.fields["face_colours"].values[3..], [255.0, 0.0, 9.0]);
        assert!(mesh.fields["face_colours"].values[0].is_nan());
    }

    #[test]
    fn faults_name_the_line() {
        for (text, expected) in [
            ("FOO\n", "line 1: expected 'OFF', got 'FOO'"),
            ("4OFF\n", "line 1: expected a text of points in three dimensions, got another kind of OFF"),
            (
                "OFF BINARY\n",
                "line 1: expected a text of points in three dimensions, got another kind of OFF",
            ),
            ("OFF\n1\n", "line 2: expected numbers of vertices, faces and edges, got 1 words"),
            ("OFF 1 1 0\n0 0\n", "item 0, line 2: expected 3 numbers of a vertex, got 2"),
            ("OFF 1 1 0\n0 0 inf\n", "item 0, line 2: expected finite coordinates, got inf"),
            ("OFF 1 1 0\n0 0 0\n3 0 0\n", "item 0, line 3: expected 3 indices of vertices, got 2"),
            ("OFF 1 1 0\n0 0 0\n3 0 0 1\n", "item 0, line 3: expected indices of vertices below 1, got 1"),
            (
                "OFF 1 1 0\n0 0 0\n3 0 0 0 1 2\n",
                "item 0, line 3: expected a colour of 1, 3 or 4 numbers, got 2",
            ),
            ("OFF 1 0 0\n0 0 0\n0\n", "line 3: expected the end of the file, got another line"),
            ("OFF 99999999 0 0\n", "line 1: expected at most 4194304 points of a shape, got 99999999"),
            ("OFF 2 0 0\n0 0 0\n", "line 2: expected a vertex, got the end of the file"),
        ] {
            assert_eq!(refusal(&FORMAT, text.as_bytes()), expected);
        }
        let limits = Limits { points: 2, ..Limits::default() };
        assert_eq!(read_within(&FORMAT, ALL.as_bytes(), limits).unwrap_err().kind, FaultKind::TooLarge);
    }

    #[test]
    fn damaged_files_do_not_panic() {
        cut_off(&FORMAT, ALL.as_bytes(), true);
        changed(&FORMAT, ALL.as_bytes());
    }
}
