//! Sizes of cells as the first page of a file describes them: in the XML of OME, or in the lines of ImageJ.
//!
//! ```text
//! <OME …><Image …><Pixels PhysicalSizeX="0.5" PhysicalSizeXUnit="µm" PhysicalSizeZ="2" …>      units: µm unless said
//! ImageJ=1.54f ␊ slices=5 ␊ unit=micron ␊ spacing=2.0 ␊                                         x and y: the resolution
//! ```
//!
//! Only attributes of the first element `Pixels` are read. Texts that cannot be understood are ignored.

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};

use super::directory::Lists;
use super::page::{Pages, resolution};
use crate::image::error::ImageError;
use crate::image::grid::{Grid, LengthUnit};
use crate::unit::Unit;

/// Most bytes of lines that are read: ImageJ writes some hundred.
const MOST_LINES: usize = 1 << 16;

/// Sizes of cells along x, y, z, each with its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sizes(pub(super) [(f64, LengthUnit); 3]);

impl Sizes {
    /// The grid of so many cells of these sizes.
    pub(super) fn grid(&self, size: [usize; 3]) -> Result<Grid, ImageError> {
        let spacing = self.0.map(|(size, unit)| unit.millimetres(size));
        Grid::along_axes(size, spacing, self.0.map(|(_, unit)| unit))
    }
}

/// Sizes of cells in millimetres that can be meant: their products are numbers.
const MEANT: std::ops::Range<f64> = 1e-30..1e30;

/// A length, where it is one.
fn length(size: f64, unit: LengthUnit) -> Option<(f64, LengthUnit)> {
    (MEANT.contains(&unit.millimetres(size)) && unit.length().is_some()).then_some((size, unit))
}

/// The sizes that the first page describes, where `decoder` is. `None` if it describes none in the plane.
///
/// # Errors
/// A resolution of 0 or without a number, beside lines of ImageJ.
pub(super) fn sizes(
    bytes: &[u8],
    lists: &Lists,
    decoder: &mut Pages<'_>,
) -> Result<Option<Sizes>, ImageError> {
    let Some([from, size]) = lists.description else { return Ok(None) };
    let text = bytes[from..from + size].trim_ascii_start();
    if text.starts_with(b"ImageJ=") {
        return lines(&text[..text.len().min(MOST_LINES)], decoder);
    }
    let valid = text.utf8_chunks().next().map_or("", |chunk| chunk.valid());
    Ok(if valid.trim_start_matches('\u{feff}').starts_with('<') { pixels(valid) } else { None })
}

/// Sizes of ImageJ: the resolution counts cells in a length of `unit`.
fn lines(text: &[u8], decoder: &mut Pages<'_>) -> Result<Option<Sizes>, ImageError> {
    // Older versions write the sign for micro as a byte of Latin-1, newer ones as an escape.
    let text: String = match std::str::from_utf8(text) {
        Ok(text) => text.into(),
        Err(_) => text.iter().map(|byte| char::from(*byte)).collect(),
    };
    let find = |name: &str| {
        let pairs = text.lines().filter_map(|line| line.split_once('='));
        pairs
            .filter(|(key, _)| *key == name)
            .map(|(_, value)| value.trim_matches(['\0', ' ', '\r']))
            .next_back()
    };
    let unit = find("unit").map(|unit| unit.replace("\\u00B5", "µ").replace("\\u00b5", "µ"));
    let unit = unit.and_then(|unit| Unit::find(&unit)).filter(|unit| unit.is_length());
    let Some(unit) = unit.map(LengthUnit::from) else { return Ok(None) };
    let Some(plane) = resolution(decoder)? else { return Ok(None) };
    // A spacing against the direction of the axis is one.
    let z = find("spacing").and_then(|text| text.parse::<f64>().ok()).map(f64::abs);
    Ok(whole(plane.map(|size| length(size, unit)), z.and_then(|size| length(size, unit))))
}

/// Sizes in the plane and, where it is known, across it.
fn whole(plane: [Option<(f64, LengthUnit)>; 2], z: Option<(f64, LengthUnit)>) -> Option<Sizes> {
    Some(Sizes([plane[0]?, plane[1]?, z.unwrap_or((1.0, LengthUnit::Unknown))]))
}

/// Sizes of the first element `Pixels` of a document of OME.
fn pixels(text: &str) -> Option<Sizes> {
    let mut reader = Reader::from_str(text);
    let mut is_ome = false;
    loop {
        let start = match reader.read_event().ok()? {
            Event::Start(start) | Event::Empty(start) => start,
            Event::Eof => return None,
            _ => continue,
        };
        match start.local_name().into_inner() {
            "OME" => is_ome = true,
            _ if !is_ome => return None,
            "Pixels" => {
                let size = |axis: &str| physical(&start, axis);
                return whole([size("X"), size("Y")], size("Z"));
            }
            _ => {}
        }
    }
}

/// The attributes `PhysicalSizeX` and `PhysicalSizeXUnit`, of any axis.
fn physical(start: &BytesStart<'_>, axis: &str) -> Option<(f64, LengthUnit)> {
    let attribute = |name: String| {
        let found = start.try_get_attribute(&name).ok()??;
        Some(found.normalized_value(XmlVersion::Implicit1_0).ok()?.into_owned())
    };
    let size: f64 = attribute(format!("PhysicalSize{axis}"))?.trim().parse().ok()?;
    match attribute(format!("PhysicalSize{axis}Unit")).as_deref().map(str::trim) {
        None => length(size, LengthUnit::Micrometre),
        Some("Å") => length(size / 10.0, LengthUnit::Nanometre),
        Some(unit) => length(size, Unit::find(unit)?.into()),
    }
}
