//! Instances of COCO: images, categories, and annotations with polygons or keypoints.

mod read;
#[cfg(test)]
mod tests;
mod write;

use super::format::Format;
use super::record::Kind;

/// Instances of COCO.
pub(super) static FORMAT: Format = Format {
    id: "coco",
    name: "COCO",
    media_types: &["application/x-coco+json"],
    extensions: &["coco.json"],
    recognise,
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["select", "attributes"],
    read: Some(read::read),
    open: Some(write::open),
};

/// Whether one of the lists of COCO is a member of the outermost object, among the first bytes.
fn recognise(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let (mut depth, mut in_string, mut escaped) = (0_usize, false, false);
    for (at, byte) in text.bytes().enumerate() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => {
                in_string = !in_string;
                let is_list = |name: &str| {
                    let rest = text[at + 1..].strip_prefix(name).and_then(|rest| rest.strip_prefix('"'));
                    let value = rest.and_then(|rest| rest.trim_start().strip_prefix(':'));
                    value.is_some_and(|value| value.trim_start().starts_with('['))
                };
                let lists = ["annotations", "images", "categories"];
                if in_string && depth == 1 && text.starts_with('{') && lists.iter().any(|name| is_list(name))
                {
                    return true;
                }
            }
            b'{' | b'[' if !in_string => depth += 1,
            b'}' | b']' if !in_string => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    false
}
