//! Assignment of shapes to groups and strata, and of their subjects.

use std::collections::{BTreeMap, BTreeSet};

use super::permutation::{Draws, Relabellings};

/// Groups of the shapes of a study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups {
    /// Names, one per group.
    pub names: Vec<String>,
    /// Group of each shape: a position in `names`.
    pub labels: Vec<usize>,
}

impl Groups {
    /// Positions of the shapes of a group.
    pub fn members(&self, group: usize) -> Vec<usize> {
        (0..self.labels.len()).filter(|&k| self.labels[k] == group).collect()
    }

    /// Positions of the shapes of two groups.
    pub fn members_of_pair(&self, (first, second): (usize, usize)) -> Vec<usize> {
        let in_it = |k: &usize| self.labels[*k] == first || self.labels[*k] == second;
        (0..self.labels.len()).filter(in_it).collect()
    }

    /// All pairs of groups.
    pub fn pairs(&self) -> Vec<(usize, usize)> {
        let groups = self.names.len();
        (0..groups).flat_map(|first| (first + 1..groups).map(move |second| (first, second))).collect()
    }

    /// Relabellings of all shapes.
    pub fn relabellings(&self, draws: Draws<'_>) -> Relabellings {
        let Draws { strata, seed, permutations } = draws;
        Relabellings::new(self.labels.clone(), self.names.len(), strata, seed, permutations)
    }

    /// Relabellings of the shapes of two groups, in the order of [`Self::members_of_pair`].
    pub fn relabellings_of_pair(&self, pair: (usize, usize), draws: Draws<'_>) -> Relabellings {
        let members = self.members_of_pair(pair);
        let labels = members.iter().map(|&k| usize::from(self.labels[k] == pair.1)).collect();
        let strata: Vec<usize> = members.iter().map(|&k| draws.strata[k]).collect();
        Relabellings::new(labels, 2, &strata, draws.seed, draws.permutations)
    }
}

/// Number of subjects with shapes in several groups, given the subject and the group of each shape.
pub fn subjects_in_several_groups(subjects: &[Option<&str>], labels: &[usize]) -> usize {
    let mut sides: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (subject, &group) in subjects.iter().zip(labels) {
        sides.entry(subject.unwrap_or_default()).or_default().push(group);
    }
    sides.remove("");
    sides.values().filter(|groups| groups.iter().any(|group| *group != groups[0])).count()
}

/// Warning about shapes of one subject that are treated as independent.
pub fn dependence_warning(subjects: &[Option<&str>]) -> Option<String> {
    let known: Vec<&str> = subjects.iter().copied().flatten().collect();
    let distinct = known.iter().collect::<BTreeSet<_>>().len();
    dependence_warning_of(known.len(), distinct)
}

/// Warning about so many shapes of so many subjects.
pub fn dependence_warning_of(shapes: usize, distinct: usize) -> Option<String> {
    (distinct < shapes).then(|| {
        format!(
            "{shapes} shapes are of {distinct} subjects: shapes of one subject are not independent, and p values that treat \
             them so are too small"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_keep_the_order_of_the_shapes() {
        let groups =
            Groups { names: ["a", "b", "c"].map(String::from).to_vec(), labels: vec![2, 0, 1, 0, 2] };
        assert_eq!(groups.pairs(), [(0, 1), (0, 2), (1, 2)]);
        assert_eq!(groups.members_of_pair((0, 2)), [0, 1, 3, 4]);
        let draws = Draws { strata: &[0; 5], seed: 1, permutations: 9 };
        assert_eq!(groups.relabellings_of_pair((0, 2), draws).observed(), [1, 0, 0, 1]);
    }

    #[test]
    fn subjects_are_counted() {
        let subjects = [Some("x"), None, Some("x"), Some("y"), None];
        assert_eq!(subjects_in_several_groups(&subjects, &[0, 0, 1, 1, 1]), 1);
        assert!(
            dependence_warning(&subjects).is_some_and(|text| text.starts_with("3 shapes are of 2 subjects"))
        );
        assert_eq!(dependence_warning(&subjects[2..]), None);
    }
}
