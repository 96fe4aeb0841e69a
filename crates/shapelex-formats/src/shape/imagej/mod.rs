//! Regions of interest of ImageJ: a file each, big-endian, of version 217 and later.
//!
//! | offset | bytes | content |
//! |---|---|---|
//! | 0 | 4 | `Iout` |
//! | 4, 6 | 2, 1 | version, type |
//! | 8 | 4 × 2 | bounds: top, left, bottom, right |
//! | 16 | 2 | number of points; 0 if it stands at 18, in 4 bytes |
//! | 18 | 4 × 4 | ends of a line, or bounds of a rectangle with fractions |
//! | 34, 36 | 2, 4 | width of the stroke, number of floats of a composite |
//! | 40, 44 | 4, 4 | colours of stroke and filling, ARGB |
//! | 48, 50 | 2, 2 | subtype, options |
//! | 52, 54, 56 | 2, 2, 4 | style, diameter of rounded corners, position in the stack |
//! | 60 | 4 | offset of the second header: channel, slice, frame, name, properties |
//! | 64 | | x of all points, y of all points, relative to the bounds; then both as floats, absolute |

mod bytes;
mod decode;
mod encode;
mod nesting;
mod outline;
mod set;
#[cfg(test)]
mod tests;

use super::format::Format;
use super::record::Kind;

/// Regions of interest of ImageJ.
pub(super) static FORMAT: Format = Format {
    id: "imagej-roi",
    name: "ImageJ ROI",
    media_types: &["application/x-imagej-roi"],
    extensions: &["roi"],
    recognise: |head| head.starts_with(b"Iout"),
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["holes", "select"],
    read: Some(decode::read),
    open: Some(encode::open),
};

/// Several regions, as the ROI Manager of ImageJ saves them. They are read as any archive of files.
pub(super) static SET: Format = Format {
    id: "imagej-roi-set",
    name: "ImageJ ROI set",
    media_types: &["application/x-imagej-roi+zip"],
    extensions: &["roi.zip"],
    recognise: |_| false,
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &[],
    read: None,
    open: Some(set::open),
};

/// Length of the first header, and of the second one.
const HEADER: usize = 64;

/// Words for the types, by their number; `noRoi` has none.
const TYPES: [&str; 11] = [
    "polygon",
    "rectangle",
    "oval",
    "line",
    "freeline",
    "polyline",
    "none",
    "freehand",
    "traced",
    "angle",
    "point",
];

/// Number of the type with a word.
fn type_number(word: &str) -> Option<u8> {
    (0..).zip(TYPES).find(|(_, known)| *known == word).map(|(number, _)| number)
}

const RECTANGLE: u8 = 1;
const LINE: u8 = 3;
const POLYLINE: u8 = 5;
const POINT: u8 = 10;

/// Option: the points are also given with fractions.
const SUB_PIXEL: u16 = 128;

/// Commands of the path of a composite.
const MOVE: f64 = 0.0;
const LINE_TO: f64 = 1.0;
const CLOSE: f64 = 4.0;
