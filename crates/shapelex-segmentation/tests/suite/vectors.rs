//! Loader of `tests/vectors/segmentation`.

use std::path::Path;

use serde_json::Value;
use shapelex_segmentation::field::Image;

/// The document `tests/vectors/segmentation/<name>.json`.
pub(crate) fn load(name: &str) -> Value {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/segmentation");
    let file = folder.join(format!("{name}.json"));
    let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// A number.
pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("not a number: {value}"))
}

/// A count.
pub(crate) fn count(value: &Value) -> usize {
    value.as_u64().unwrap_or_else(|| panic!("not a count: {value}")) as usize
}

/// The numbers of a list, and those of lists in it, in order.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    match value.as_array() {
        Some(list) => list.iter().flat_map(numbers).collect(),
        None => vec![number(value)],
    }
}

/// A list of points.
pub(crate) fn points<const D: usize>(value: &Value) -> Vec<[f64; D]> {
    let list = value.as_array().unwrap_or_else(|| panic!("not a list: {value}"));
    list.iter().map(|point| numbers(point).try_into().expect("a point")).collect()
}

/// The image or volume of a document.
pub(crate) fn image(document: &Value) -> Image {
    let size = [&document["width"], &document["height"]].map(count);
    let (depth, values) = match document.get("volume") {
        Some(volume) => (count(&document["depth"]), numbers(volume)),
        None => (1, numbers(&document["image"])),
    };
    Image::new([size[0], size[1], depth], values).expect("a complete image")
}

/// Compares numbers, relative to the largest expected magnitude.
pub(crate) fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found - expected).abs() / largest;
        assert!(
            error <= tolerance,
            "{what}[{at}]: {found} for {expected}, relative error {error:.1e} > {tolerance:.0e}"
        );
    }
}
