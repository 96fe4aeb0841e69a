//! The surface of a component in a cube of eight neighbouring centres, for each of the 256 sets of corners inside.
//!
//! On each face of the cube, lines cut off every run of neighbouring corners inside, so that corners inside that lie across a
//! diagonal are separated. The lines of two cubes with a common face are the same, each edge with one end inside is the end of
//! two lines, and lines of the six faces form loops. Filling the loops gives a closed surface without further cases.
//!
//! A loop is a fan of triangles from one of its vertices if none of the inner edges has its two ends on one face of the cube: such
//! an edge could also be one of the neighbouring cube, and four triangles would meet there. Otherwise it is a fan from its
//! centre.
//!
//! # Source
//! Lorensen, Cline 1987, Marching cubes, without its ambiguous faces. The loops by faces: Bloomenthal 1994, An implicit surface
//! polygonizer, Graphics Gems IV.

use std::sync::LazyLock;

/// Number of edges of a cube.
pub(super) const EDGES: u8 = 12;

/// Corners of the faces, counter-clockwise as seen from outside. Corner `c` is at `(c & 1, c >> 1 & 1, c >> 2)`.
const FACES: [[u8; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// The triangles in a cube.
#[derive(Debug, Clone, Default)]
pub(super) struct Case {
    /// Corners of the triangles, counter-clockwise as seen from outside of the component: edge `e < 12` of the cube, or centre
    /// `e − 12`.
    pub(super) triangles: Vec<[u8; 3]>,
    /// The edges of the loops that have a centre.
    pub(super) centres: Vec<Vec<u8>>,
}

/// The triangles for every set of corners inside, as bits of the index.
pub(super) static CASES: LazyLock<Vec<Case>> = LazyLock::new(|| (0..=u8::MAX).map(case).collect());

/// Axis and lower corner of an edge.
pub(super) fn edge_ends(edge: u8) -> (usize, u8) {
    const OTHERS: [[u8; 2]; 3] = [[2, 4], [1, 4], [1, 2]];
    let (axis, place) = (edge / 4, edge % 4);
    let [one, other] = OTHERS[axis as usize];
    (axis as usize, (place & 1) * one + (place >> 1) * other)
}

/// The edge between two corners.
fn edge(a: u8, b: u8) -> u8 {
    let (axis, lower) = ((a ^ b).trailing_zeros() as usize, a & b);
    (0..EDGES).find(|edge| edge_ends(*edge) == (axis, lower)).unwrap_or_default()
}

/// The triangles of a set of corners.
fn case(inside: u8) -> Case {
    let mut case = Case::default();
    for ring in loops(inside) {
        let apex = (0..ring.len()).find(|apex| is_fan(&ring, *apex));
        let (hub, first, count) = match apex {
            Some(apex) => (ring[apex], apex + 1, ring.len() - 2),
            None => (EDGES + case.centres.len() as u8, 0, ring.len()),
        };
        let at = |step: usize| ring[(first + step) % ring.len()];
        case.triangles.extend((0..count).map(|step| [hub, at(step), at(step + 1)]));
        if apex.is_none() {
            case.centres.push(ring);
        }
    }
    case
}

/// The loops of crossed edges, with the corners inside on the left as seen from outside of the cube.
fn loops(inside: u8) -> Vec<Vec<u8>> {
    let is_inside = |corner: u8| inside >> corner & 1 == 1;
    let mut next = [None; EDGES as usize];
    for face in FACES {
        for start in (0..4).filter(|at| is_inside(face[*at]) && !is_inside(face[(at + 3) % 4])) {
            let entry = edge(face[(start + 3) % 4], face[start]);
            let last = (start..start + 3).find(|at| !is_inside(face[(at + 1) % 4])).unwrap_or(start);
            next[entry as usize] = Some(edge(face[last % 4], face[(last + 1) % 4]));
        }
    }
    let mut found = Vec::new();
    for start in 0..EDGES {
        // Following a line also removes it, so every loop is found once and the search ends.
        let follow = |from: &u8| next[*from as usize].take();
        let ring: Vec<u8> = std::iter::successors(Some(start), follow).skip(1).collect();
        if !ring.is_empty() {
            found.push(ring);
        }
    }
    found
}

/// Whether no inner edge of the fan from a vertex of a loop has both ends on one face.
fn is_fan(ring: &[u8], apex: usize) -> bool {
    let inner = (2..ring.len() - 1).map(|step| ring[(apex + step) % ring.len()]);
    inner.into_iter().all(|other| faces_of(ring[apex]) & faces_of(other) == 0)
}

/// The two faces of an edge, as bits.
fn faces_of(edge: u8) -> u8 {
    let (axis, lower) = edge_ends(edge);
    let ends = [lower, lower | 1 << axis];
    let holds = |face: &usize| ends.iter().all(|end| FACES[*face].contains(end));
    (0..FACES.len()).filter(holds).map(|face| 1 << face).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every crossed edge is in one loop, and every edge of a triangle inside of the cube is between two triangles.
    #[test]
    fn triangles_cover_loops_of_all_crossed_edges() {
        for inside in 0..=u8::MAX {
            let case = &CASES[inside as usize];
            let crossed = (0..EDGES).filter(|edge| {
                let (axis, lower) = edge_ends(*edge);
                (inside >> lower ^ inside >> (lower | 1 << axis)) & 1 == 1
            });
            let mut met: Vec<u8> = loops(inside).concat();
            met.sort_unstable();
            assert_eq!(met, crossed.collect::<Vec<u8>>(), "{inside:#b}");
            let sides: Vec<[u8; 2]> =
                case.triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
            for [a, b] in &sides {
                let twins = sides.iter().filter(|side| **side == [*b, *a]).count();
                let on_face = *a < EDGES && *b < EDGES && faces_of(*a) & faces_of(*b) != 0;
                assert_eq!(twins, usize::from(!on_face), "{inside:#b}: {a} to {b}");
            }
        }
    }

    #[test]
    fn a_corner_is_cut_off_with_the_normal_away_from_it() {
        let case = &CASES[1];
        assert_eq!(case.triangles.len(), 1);
        // Counter-clockwise about (1, 1, 1): along x, then y, then z.
        let axes = case.triangles[0].map(|edge| edge_ends(edge).0);
        assert!([[0, 1, 2], [1, 2, 0], [2, 0, 1]].contains(&axes), "{axes:?}");
    }
}
