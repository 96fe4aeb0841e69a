//! Disjoint sets of cells, from which components are made.

use std::collections::BTreeMap;

use shapelex_numeric::bounded::Stop;

use super::components::{Component, Dropped, Labels, NONE, Selection};
use super::sets::Sets;
use crate::SegmentationError;
use crate::texture::Texture;

/// The labels that are wanted, in increasing order; all but 0 if `None`.
pub(super) struct Wanted(Option<Vec<u32>>);

impl Wanted {
    /// The labels of a selection, all of which must occur.
    pub(super) fn new<const D: usize>(
        labels: &Labels<'_, D>,
        selection: &Selection,
    ) -> Result<Self, SegmentationError> {
        let Some(mut wanted) = selection.labels.clone() else { return Ok(Self(None)) };
        wanted.sort_unstable();
        wanted.dedup();
        let mut met = vec![false; wanted.len()];
        for label in labels.values {
            if let Ok(at) = wanted.binary_search(label) {
                met[at] = true;
            }
        }
        match met.iter().position(|met| !met) {
            Some(at) => Err(SegmentationError::Label { label: wanted[at] }),
            None => Ok(Self(Some(wanted))),
        }
    }

    fn holds(&self, label: u32) -> bool {
        self.0.as_ref().map_or(label != 0, |wanted| wanted.binary_search(&label).is_ok())
    }
}

/// Parts of components that a pass in the order of the cells meets apart from each other, as disjoint sets.
pub(super) struct Parts {
    /// For every cell its part, or [`NONE`].
    ids: Vec<u32>,
    /// The parts of each component.
    sets: Sets,
    /// For every part its label.
    labels: Vec<u32>,
}

impl Parts {
    /// Joins every cell to its neighbours before it. `None` once `stop` returns true.
    pub(super) fn find<const D: usize>(
        labels: &Labels<'_, D>,
        wanted: &Wanted,
        stop: Stop<'_>,
    ) -> Option<Self> {
        let strides = labels.strides();
        let mut parts =
            Self { ids: vec![NONE; labels.values.len()], sets: Sets::of_each(0), labels: Vec::new() };
        for (at, label) in labels.values.iter().enumerate() {
            if at.is_multiple_of(labels.size[0]) && stop() {
                return None;
            }
            if !wanted.holds(*label) {
                continue;
            }
            let cell = labels.cell(at);
            let mut part = NONE;
            for axis in (0..D).filter(|axis| cell[*axis] > 0) {
                let before = at - strides[axis];
                if labels.values[before] == *label {
                    let other = parts.ids[before];
                    part = if part == NONE { other } else { parts.sets.join(part, other) };
                }
            }
            // There are fewer parts than cells, hence than `NONE`.
            if part == NONE {
                part = parts.sets.begin();
                parts.labels.push(*label);
            }
            parts.ids[at] = part;
        }
        Some(parts)
    }

    /// Number of cells of every component, at its first part; 0 for other parts.
    pub(super) fn sizes(&mut self) -> Vec<u32> {
        let mut sizes = vec![0; self.sets.len()];
        for part in self.ids.iter().filter(|part| **part != NONE) {
            sizes[self.sets.least(*part) as usize] += 1;
        }
        sizes
    }

    /// How finely the labels are divided, by the sizes of components at their first parts.
    pub(super) fn texture(&self, sizes: &[u32]) -> Texture {
        let of_components = || sizes.iter().filter(|cells| **cells > 0);
        let crumbs = || of_components().filter(|cells| **cells <= Texture::CRUMB);
        let mut labels = self.labels.clone();
        labels.sort_unstable();
        labels.dedup();
        Texture {
            labels: labels.len(),
            cells: of_components().map(|cells| *cells as usize).sum(),
            components: of_components().count(),
            crumbs: crumbs().count(),
            crumb_cells: crumbs().map(|cells| *cells as usize).sum(),
        }
    }

    /// Whether the component that begins with a part is kept, by the sizes of components at their first parts.
    pub(super) fn kept(&self, sizes: &[u32], selection: &Selection) -> Vec<bool> {
        let mut kept: Vec<bool> = sizes.iter().map(|cells| *cells >= selection.least()).collect();
        if selection.largest {
            let mut largest = BTreeMap::<u32, usize>::new();
            for (part, label) in self.labels.iter().enumerate().filter(|(part, _)| sizes[*part] > 0) {
                let before = largest.entry(*label).or_insert(part);
                if sizes[part] > sizes[*before] {
                    *before = part;
                }
            }
            for (part, kept) in kept.iter_mut().enumerate().filter(|(_, kept)| **kept) {
                *kept = largest.get(&self.labels[part]) == Some(&part);
            }
        }
        kept
    }

    /// Numbers the components that are kept in the order of their first cells. Faces and corners are not yet known.
    pub(super) fn number<const D: usize>(
        self,
        labels: &Labels<'_, D>,
        mut sizes: Vec<u32>,
        kept: &[bool],
    ) -> (Vec<u32>, Vec<Component>, Dropped) {
        let Self { mut ids, mut sets, .. } = self;
        let mut of_part = vec![NONE; sets.len()];
        let (mut list, mut dropped, mut met) =
            (Vec::new(), Dropped::default(), BTreeMap::<u32, usize>::new());
        for (at, id) in ids.iter_mut().enumerate().filter(|(_, id)| **id != NONE) {
            let first = sets.least(*id);
            // The size is taken at the first cell of a component.
            let cells = std::mem::take(&mut sizes[first as usize]);
            if cells > 0 {
                let number = met.entry(labels.values[at]).or_default();
                if kept[first as usize] {
                    of_part[first as usize] = list.len() as u32;
                    list.push(component(labels, at, *number, cells));
                } else {
                    dropped.components += 1;
                    dropped.cells += cells as usize;
                }
                *number += 1;
            }
            *id = of_part[first as usize];
        }
        (ids, list, dropped)
    }
}

/// A component of a number of cells, of which one is known.
fn component<const D: usize>(labels: &Labels<'_, D>, at: usize, number: usize, cells: u32) -> Component {
    Component {
        label: labels.values[at],
        number,
        cells: cells as usize,
        faces: 0,
        border_faces: 0,
        corners: [labels.cell(at); 2],
    }
}
