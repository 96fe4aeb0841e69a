//! Components in space without handles and cavities.
//!
//! The box of a component has none. Its cells outside of the component are taken away from its faces on, each only if that changes
//! no topology: the rest is the component with its cavities, and with a film one cell thick across every handle. It is the
//! three-dimensional closing of holes of Aktouf, Bertrand and Perroton (2002), for cells that are connected across faces inside,
//! and across faces and edges outside.

use std::collections::VecDeque;

use shapelex_numeric::bounded::Stop;

use super::components::{Component, Components, Dropped, Labels, NONE};
use super::surfaces::Solid;
use crate::SegmentationError;
use crate::frame::Frame;

/// Position of a cell among the 27 around it, x fastest.
const CENTRE: usize = 13;
/// The 26 others.
const AROUND: u32 = ((1 << 27) - 1) & !(1 << CENTRE);
/// Neighbours of each of the 27 cells across faces.
const FACES: [u32; 27] = adjacent(1);
/// Neighbours across faces and edges.
const EDGES: [u32; 27] = adjacent(2);
/// Number of cells between two questions whether to stop.
const LOOK: usize = 4096;

/// The neighbours of each of the 27 cells, but for the middle one, at most `most` steps along the axes away, one along each.
const fn adjacent(most: usize) -> [u32; 27] {
    let mut all = [0; 27];
    let mut pair = 0;
    while pair < 27 * 27 {
        let (p, q): (usize, usize) = (pair / 27, pair % 27);
        let apart = [(p % 3).abs_diff(q % 3), (p / 3 % 3).abs_diff(q / 3 % 3), (p / 9).abs_diff(q / 9)];
        let steps = apart[0] + apart[1] + apart[2];
        let near = apart[0] < 2 && apart[1] < 2 && apart[2] < 2;
        if near && steps > 0 && steps <= most && q != CENTRE {
            all[p] |= 1 << q;
        }
        pair += 1;
    }
    all
}

/// Members of a set of the 27 cells.
fn members(set: u32) -> impl Iterator<Item = usize> {
    (0..27).filter(move |cell| set >> cell & 1 == 1)
}

/// A set and the neighbours of its members within another one.
fn grown(set: u32, within: u32, adjacent: &[u32; 27]) -> u32 {
    members(set).fold(set, |all, cell| all | adjacent[cell] & within)
}

/// Whether a set is one piece; an empty one is none.
fn is_connected(set: u32, adjacent: &[u32; 27]) -> bool {
    let mut met = set & set.wrapping_neg();
    for _ in 0..27 {
        met = grown(met, set, adjacent);
    }
    set != 0 && met == set
}

/// Whether a cell among cells inside can go without a change of topology: of the cells inside that are within three steps across
/// faces, and of those outside within two steps across faces and edges, each are one piece (Bertrand and Malandain 1994).
fn is_simple(inside: u32) -> bool {
    let (inside, outside) = (inside & AROUND, !inside & AROUND);
    let near = (0..2).fold(FACES[CENTRE] & inside, |near, _| grown(near, inside, &FACES));
    let far = grown(EDGES[CENTRE] & outside, outside, &EDGES);
    is_connected(near, &FACES) && is_connected(far, &EDGES)
}

/// The cells of a box with a margin of one cell, x fastest.
struct Peeling {
    size: [usize; 3],
    /// Whether a cell belongs to the component.
    mask: Vec<bool>,
    /// Whether a cell has not been taken away.
    inside: Vec<bool>,
}

impl Peeling {
    fn of(components: &Components<3>, id: u32, [lower, upper]: [[usize; 3]; 2]) -> Self {
        let size: [usize; 3] = std::array::from_fn(|axis| upper[axis] - lower[axis] + 3);
        let count = size.iter().product();
        let mut peeling = Self { size, mask: vec![false; count], inside: vec![false; count] };
        for at in 0..count {
            let cell = peeling.cell(at);
            if (0..3).all(|axis| (1..size[axis] - 1).contains(&cell[axis])) {
                let cell: [isize; 3] = std::array::from_fn(|axis| (lower[axis] + cell[axis]) as isize - 1);
                peeling.inside[at] = true;
                peeling.mask[at] = components.holds(id, cell);
            }
        }
        peeling
    }

    fn cell(&self, at: usize) -> [usize; 3] {
        [at % self.size[0], at / self.size[0] % self.size[1], at / self.size[0] / self.size[1]]
    }

    /// Positions of the 27 cells around one that is not in the margin.
    fn around(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let [columns, rows, _] = self.size;
        let first = at - (rows + 1) * columns - 1;
        (0..27).map(move |k| first + k % 3 + (k / 3 % 3 + k / 9 * rows) * columns)
    }

    /// Takes cells away until none can go; each waits again when one beside it has gone. `None` once `stop` returns true.
    fn peel(&mut self, stop: Stop<'_>) -> Option<()> {
        let is_first = |at: &usize| {
            let cell = self.cell(*at);
            let on_face = (0..3).any(|axis| cell[axis] == 1 || cell[axis] + 2 == self.size[axis]);
            on_face && self.inside[*at] && !self.mask[*at]
        };
        let mut queue: VecDeque<u32> = (0..self.mask.len()).filter(is_first).map(|at| at as u32).collect();
        let mut waits = vec![false; self.mask.len()];
        queue.iter().for_each(|at| waits[*at as usize] = true);
        let mut count = 0_usize;
        while let Some(at) = queue.pop_front() {
            count += 1;
            if count.is_multiple_of(LOOK) && stop() {
                return None;
            }
            let at = at as usize;
            waits[at] = false;
            let inside =
                self.around(at).enumerate().fold(0, |set, (k, at)| set | u32::from(self.inside[at]) << k);
            if !is_simple(inside) {
                continue;
            }
            self.inside[at] = false;
            for beside in self.around(at) {
                if self.inside[beside] && !self.mask[beside] && !waits[beside] {
                    waits[beside] = true;
                    queue.push_back(beside as u32);
                }
            }
        }
        Some(())
    }
}

impl Components<3> {
    /// The component at a position of the list, its cavities and handles filled, as [`solids`](Self::solids) gives it: the component itself counts the
    /// cells and sides of before. `None` once `stop` returns true.
    ///
    /// Cost: about five looks at the 27 cells around each cell of the box of the component. Memory: 12 bytes for each of these.
    ///
    /// # Errors
    /// Those of [`solids`](Self::solids); [`SegmentationError::Cells`] for a box of 2³² cells or more with its margin.
    pub fn filled(
        &self,
        id: usize,
        frame: &Frame<3>,
        blur: f64,
        most_vertices: usize,
        stop: Stop<'_>,
    ) -> Result<Option<Solid>, SegmentationError> {
        let component = self.list()[id];
        let [lower, upper] = component.corners;
        let count = (0..3).map(|axis| upper[axis] - lower[axis] + 3).product::<usize>();
        if count >= NONE as usize {
            return Err(SegmentationError::Cells { most: NONE as usize - 1, count });
        }
        let mut peeling = Peeling::of(self, id as u32, component.corners);
        if peeling.peel(stop).is_none() {
            return Ok(None);
        }
        // Beyond the edge of the image there is no margin, so that a blur goes on there as elsewhere.
        let begin = lower.map(|index| usize::from(index == 0));
        let end: [usize; 3] =
            std::array::from_fn(|axis| peeling.size[axis] - usize::from(upper[axis] + 1 == self.size[axis]));
        let has = |at: &usize| {
            let cell = peeling.cell(*at);
            (0..3).all(|axis| (begin[axis]..end[axis]).contains(&cell[axis]))
        };
        let id_of = |at: usize| if peeling.inside[at] { 0 } else { NONE };
        let ids = (0..peeling.inside.len()).filter(has).map(id_of).collect();
        let size: [usize; 3] = std::array::from_fn(|axis| end[axis] - begin[axis]);
        let first: [f64; 3] = std::array::from_fn(|axis| (lower[axis] + begin[axis]) as f64 - 1.0);
        let whole = Component {
            faces: 0,
            border_faces: 0,
            corners: [size.map(|size| size - 1), [0; 3]],
            ..component
        };
        let mut found = Self { size, ids, list: vec![whole], dropped: Dropped::default() };
        if !found.measure(&Labels { size, values: &[], open_ends: false }, stop) {
            return Ok(None);
        }
        let solids = found.solids(&frame.shifted(first), blur, most_vertices, stop)?;
        let solid = solids.and_then(|solids| solids.into_iter().next());
        Ok(solid.map(|solid| Solid { component, ..solid }))
    }
}
