//! Warnings that accompany a result whose numbers are less accurate or less meaningful than they seem.

use super::faults::MAX_FAULTS;

/// Warnings of the shapes of a request, each with the index of its shape; at most [`MAX_FAULTS`].
pub fn by_shape<'a>(list: &str, shapes: impl Iterator<Item = &'a Vec<String>>) -> Vec<String> {
    let numbered = shapes.enumerate().flat_map(|(index, warnings)| {
        warnings.iter().map(move |warning| format!("/{list}/{index}: {warning}"))
    });
    numbered.take(MAX_FAULTS).collect()
}
