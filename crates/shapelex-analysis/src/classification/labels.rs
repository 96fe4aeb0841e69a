//! Classes and subjects of labelled shapes.

use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Classes and subjects of shapes, in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassLabels {
    /// Names of the classes, in alphabetical order.
    pub labels: Vec<String>,
    /// Class of each shape.
    pub classes: Vec<usize>,
    /// Groups that must not be divided: shapes of one subject share a number, all others have one each.
    pub groups: Vec<usize>,
    /// Number of subjects; `None` if no shape has one.
    pub subjects: Option<usize>,
}

impl ClassLabels {
    /// From the name of the class and the subject of each shape.
    pub fn new(names: &[String], subjects: &[Option<String>]) -> Self {
        let sorted: BTreeSet<&String> = names.iter().collect();
        let places: BTreeMap<&String, usize> =
            sorted.iter().enumerate().map(|(c, name)| (*name, c)).collect();
        let mut numbers: HashMap<&str, usize> = HashMap::new();
        let mut next = 0;
        let mut number = || {
            next += 1;
            next - 1
        };
        let groups = subjects
            .iter()
            .map(|subject| match subject {
                Some(subject) => *numbers.entry(subject).or_insert_with(&mut number),
                None => number(),
            })
            .collect();
        Self {
            classes: names.iter().map(|name| places[name]).collect(),
            labels: sorted.into_iter().cloned().collect(),
            groups,
            subjects: Some(numbers.len()).filter(|&count| count > 0),
        }
    }

    /// From the name of the class of each shape; no shapes share a subject.
    pub fn from_names(names: &[String]) -> Self {
        Self::new(names, &vec![None; names.len()])
    }

    /// Number of shapes per class.
    pub fn sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.labels.len()];
        self.classes.iter().for_each(|&class| sizes[class] += 1);
        sizes
    }

    /// Number of independent cases per class: subjects, and shapes without one.
    pub fn units(&self) -> Vec<usize> {
        units(&self.classes, &self.groups, self.labels.len())
    }
}

/// Number of groups with shapes of each of `count` classes.
pub(super) fn units(classes: &[usize], groups: &[usize], count: usize) -> Vec<usize> {
    let pairs: BTreeSet<(usize, usize)> = classes.iter().copied().zip(groups.iter().copied()).collect();
    let mut units = vec![0; count];
    pairs.iter().for_each(|(class, _)| units[*class] += 1);
    units
}
