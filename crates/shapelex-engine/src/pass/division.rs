//! How the parts of a revision are divided among the tasks of a cluster.

use std::ops::Range;

use shapelex_analysis::accumulate::FAN_IN;

/// Usual number of groups of parts from which on a task computes a whole group, 64 parts. With fewer, executors would have nothing to
/// do.
pub const MIN_GROUPS: usize = 16;

/// Unit of one task: a part, or a group of parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Unit {
    /// Its number among the units.
    pub(crate) number: usize,
    /// Its parts.
    pub(crate) parts: Range<usize>,
}

/// How the parts of a revision are divided among tasks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Division {
    /// Number of parts.
    pub(crate) parts: usize,
    /// Number of parts of a task: one, or [`FAN_IN`].
    pub(crate) size: usize,
}

impl Division {
    pub(crate) fn new(parts: usize, min_groups: usize) -> Self {
        let groups = parts.div_ceil(FAN_IN);
        Self { parts, size: if groups >= min_groups.max(2) { FAN_IN } else { 1 } }
    }

    /// The tasks.
    pub(crate) fn units(self) -> Vec<Unit> {
        let Self { parts, size } = self;
        let unit = |number: usize| Unit { number, parts: number * size..((number + 1) * size).min(parts) };
        (0..parts.div_ceil(size)).map(unit).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_parts_or_groups_and_cover_all_parts() {
        for (parts, min_groups) in [(0, 2), (1, 0), (64, 0), (65, 2), (65, 3), (100 * FAN_IN + 7, MIN_GROUPS)]
        {
            let units = Division::new(parts, min_groups).units();
            let numbers: Vec<usize> = units.iter().map(|unit| unit.number).collect();
            assert_eq!(numbers, (0..units.len()).collect::<Vec<_>>());
            let covered: Vec<usize> = units.iter().flat_map(|unit| unit.parts.clone()).collect();
            assert_eq!(covered, (0..parts).collect::<Vec<_>>());
        }
        let last = Division::new(FAN_IN + 1, 2).units().pop();
        assert_eq!(last, Some(Unit { number: 1, parts: FAN_IN..FAN_IN + 1 }));
        assert_eq!(Division::new(FAN_IN + 1, 3).units().len(), FAN_IN + 1);
    }
}
