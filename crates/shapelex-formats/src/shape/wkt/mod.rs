//! Well-known text: a geometry a line, with or without an id before or behind it.
//!
//! ```text
//! cell 7<tab>POLYGON ((0 0, 4 0, 4 3, 0 0), (1 1, 2 1, 2 2, 1 1))
//! ```

mod parse;
#[cfg(test)]
mod tests;
mod write;

use super::format::Format;
use super::objects::Giving;
use super::options::ReadOptions;
use super::record::Sink;
use super::record::{Geometry, Kind, Points, Record};
use super::source::Source;
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use parse::{Text, begins_geometry};

/// Well-known text.
pub(super) static FORMAT: Format = Format {
    id: "wkt",
    name: "WKT",
    media_types: &["text/wkt", "application/wkt"],
    extensions: &["wkt"],
    recognise: |head| {
        let text = String::from_utf8_lossy(head);
        begins_geometry(text.trim_start_matches('\u{feff}')) && text.contains('(')
    },
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["holes", "select"],
    read: Some(read),
    open: Some(write::open),
};

/// Words of a first line that names columns.
const COLUMNS: [&str; 5] = ["wkt", "geometry", "geom", "the_geom", "wkt_geom"];

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let giving = Giving { holes: options.holes.unwrap_or_default(), limits: &limits };
    let (mut line, mut item, mut summary) = (String::new(), 0, Summary::default());
    let mut first = true;
    while options.next_line(source, &mut line, &mut summary)? {
        let text = line.trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let place = Place { line: Some(source.line()), ..Place::item(item) };
        let is_header = std::mem::take(&mut first) && names_columns(text);
        if is_header {
            continue;
        }
        let mut template = Record::new(Geometry::Landmarks(Points::new(2)), place.clone());
        let mut parsed = Text::new(&line, limits);
        let parts = match parsed.line().map_err(|error| error.at(place.clone())) {
            Ok(parts) => parts,
            Err(error) => {
                // The end of a line is not that of the file.
                let kind = if error.kind == FaultKind::Truncated { FaultKind::Malformed } else { error.kind };
                options.leave_out(FileError { kind, ..error }, &mut summary)?;
                item += 1;
                continue;
            }
        };
        template.name = parsed.id;
        if let Some(srid) = parsed.srid {
            template.metadata.insert("srid".into(), srid.into());
        }
        let name = template.name.clone();
        if parsed.measures > 0 {
            summary.drop("measures of points", name.as_deref(), || place.clone());
        }
        if !options.selects(name.as_deref().unwrap_or_default()) {
            summary.drop("geometries that are not selected", name.as_deref(), || place.clone());
        } else if parts.is_empty() {
            summary.drop("empty geometries", name.as_deref(), || place.clone());
        } else {
            giving.give(parts, item, template, &mut summary, sink)?;
        }
        item += 1;
    }
    Ok(summary)
}

/// Whether a line holds names of columns, one of which is that of a geometry.
fn names_columns(line: &str) -> bool {
    let words = line.split([',', ';', '\t']).map(|word| word.trim().trim_matches('"').to_lowercase());
    !line.contains('(') && words.into_iter().any(|word| COLUMNS.contains(&word.as_str()))
}
