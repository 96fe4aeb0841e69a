//! Markups of 3D Slicer: points in [`fcsv`], points and curves in [`markups`].
//!
//! Coordinates are those of the file. Whether they are RAS or LPS is in the metadata of each record, `coordinate_system`, and is
//! written back; without it LPS is written, with a warning.

pub(super) mod fcsv;
pub(super) mod markups;

use serde_json::Value;

use super::record::{Geometry, Points, Record};
use super::text::{refused, unfit};
use crate::error::FileError;
use crate::summary::Summary;

/// Keys of the metadata that both formats write.
const KEPT: [&str; 3] = ["coordinate_system", "landmark_names", "descriptions"];

/// Points in space and whether they are a closed curve, if they are a curve.
fn points(record: &Record, curves: bool) -> Result<(&Points, Option<bool>), FileError> {
    let (points, closed) = match &record.geometry {
        Geometry::Landmarks(points) => (points, None),
        Geometry::Curve { points, closed } if curves => (points, Some(*closed)),
        _ => return Err(refused(record, if curves { "landmarks or a curve" } else { "landmarks" })),
    };
    if points.dimension() != 3 {
        return Err(unfit(
            record,
            format!("expected points in space, got {} coordinates", points.dimension()),
        ));
    }
    Ok((points, closed))
}

/// The coordinate system of a record: `RAS` or `LPS`.
fn system(record: &Record, summary: &mut Summary) -> &'static str {
    match record.metadata.get("coordinate_system").and_then(Value::as_str) {
        Some("RAS") => "RAS",
        Some("LPS") => "LPS",
        _ => {
            let warning = "the coordinate system of shapes is unknown: LPS is written";
            if !summary.warnings.iter().any(|other| other == warning) {
                summary.warnings.push(warning.into());
            }
            "LPS"
        }
    }
}

/// A text of each point in the metadata, such as its name.
fn text_of<'r>(record: &'r Record, key: &str, point: usize) -> Option<&'r str> {
    record.metadata.get(key)?.get(point)?.as_str().filter(|text| !text.is_empty())
}

/// Keeps texts of points, if one is not empty.
fn keep(record: &mut Record, key: &str, texts: Vec<String>) {
    if texts.iter().any(|text| !text.is_empty()) {
        record.metadata.insert(key.into(), texts.into());
    }
}
