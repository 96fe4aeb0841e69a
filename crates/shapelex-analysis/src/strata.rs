//! Strata: sets of shapes that are drawn, or whose labels are exchanged, together.

use std::collections::BTreeMap;

/// Strata of shapes with these keys, numbered by first appearance: equal keys share a stratum.
pub fn strata<K: Ord>(keys: impl IntoIterator<Item = K>) -> Vec<usize> {
    let mut numbers = BTreeMap::new();
    keys.into_iter()
        .map(|key| {
            let next = numbers.len();
            *numbers.entry(key).or_insert(next)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strata_are_numbered_as_they_appear() {
        assert_eq!(strata(["b", "a", "b", "c"]), [0, 1, 0, 2]);
    }
}
