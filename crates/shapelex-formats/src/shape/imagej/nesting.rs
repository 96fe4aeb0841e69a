//! Which rings of a composite region bound holes. ImageJ fills such a region by the even–odd rule.

use std::cell::OnceCell;

use super::super::limits::{Bound, Budget};
use super::super::objects::{Part, area};
use super::super::record::Points;
use crate::error::FileError;

/// A comparison is one of the boxes of two rings, or a look at an edge.
pub(super) const COMPARISONS: Bound = Bound {
    what: "comparisons of rings that lie side by side or one around the other",
    free: 1 << 24,
    per_byte: 128,
};
/// How many comparisons a search among the edges of a ring takes as long as, besides its looks: the ring is fetched from elsewhere.
const SEARCH: u64 = 8;

/// A ring with the data that decide whether it lies in another one.
struct Candidate {
    ring: Points,
    frame: Frame,
    inside: Option<[f64; 2]>,
    /// Only of a ring whose box is around that of another one.
    edges: OnceCell<Vec<Edge>>,
}

/// Data that tell most rings apart, small enough to go through many of them.
#[derive(Clone, Copy)]
struct Frame {
    position: usize,
    area: f64,
    /// Least and greatest x and y.
    bounds: [f64; 4],
}

/// An edge that is not horizontal. The middle one of a sorted slice is the root of a tree: those before it begin no higher, those after
/// it no lower, and it knows where the highest of them all ends.
struct Edge {
    ends: [[f64; 2]; 2],
    highest: f64,
}

/// Makes areas of rings that do not cross: a ring within an odd number of others bounds a hole of the smallest of them. Areas stand
/// in the order of their outer rings, followed by their holes in theirs.
///
/// Cost: n log n of n points; a comparison of each ring with those that begin left of it and do not end there; and, where its box is
/// in that of a larger one, a search for the k edges of that one that cross a line, by some (k + 1) log n looks.
///
/// # Errors
/// More comparisons than `work` has.
pub(super) fn areas(rings: Vec<Points>, work: &Budget) -> Result<Vec<Part>, FileError> {
    let candidates: Vec<Candidate> = rings.into_iter().enumerate().map(Candidate::new).collect();
    let around = parents(&candidates, work)?;
    // Rings that cross may name a hole as their outer ring; such a ring stays an area.
    let is_outer = |parent: &usize| around[*parent].is_none();
    let parents: Vec<Option<usize>> = around.iter().map(|parent| parent.filter(is_outer)).collect();
    // Position of the area that each outer ring begins.
    let mut begun = vec![None; candidates.len()];
    let mut areas: Vec<Vec<Points>> = Vec::new();
    for (k, parent) in parents.iter().enumerate() {
        if parent.is_none() {
            begun[k] = Some(areas.len());
            areas.push(vec![candidates[k].ring.clone()]);
        }
    }
    for (candidate, parent) in candidates.into_iter().zip(parents) {
        if let Some(at) = parent.and_then(|parent| begun[parent]) {
            areas[at].push(candidate.ring);
        }
    }
    Ok(areas.into_iter().map(Part::Area).collect())
}

/// The outer ring of which each ring bounds a hole.
fn parents(candidates: &[Candidate], work: &Budget) -> Result<Vec<Option<usize>>, FileError> {
    // From left to right, so that a ring comes after those around it. Zero is added as −0 would stand before 0.
    let mut order: Vec<Frame> = candidates.iter().map(|candidate| candidate.frame).collect();
    order.sort_by(|a, b| (a.bounds[0] + 0.0).total_cmp(&(b.bounds[0] + 0.0)).then(b.area.total_cmp(&a.area)));
    let mut parents = vec![None; candidates.len()];
    // Rings that do not end left of the one at hand.
    let mut open: Vec<Frame> = Vec::new();
    for frame in order {
        work.take(open.len() as u64)?;
        open.retain(|other| other.bounds[1] >= frame.bounds[0]);
        parents[frame.position] = parent(candidates, &open, frame, work)?;
        open.push(frame);
    }
    Ok(parents)
}

/// The outer ring of which a ring bounds a hole: the smallest of those around it, if their number is odd.
fn parent(
    candidates: &[Candidate],
    open: &[Frame],
    frame: Frame,
    work: &Budget,
) -> Result<Option<usize>, FileError> {
    let Some(point) = candidates[frame.position].inside else { return Ok(None) };
    let mut around = Vec::new();
    for other in open.iter().filter(|other| other.is_larger(frame)) {
        if candidates[other.position].contains(point, work)? {
            around.push(other);
        }
    }
    // The first one if some are equally large.
    let smallest = around.iter().min_by(|a, b| a.area.total_cmp(&b.area).then(a.position.cmp(&b.position)));
    Ok(smallest.filter(|_| around.len() % 2 == 1).map(|smallest| smallest.position))
}

impl Frame {
    /// Whether this ring has the larger area, and its box is around that of another one.
    fn is_larger(&self, other: Self) -> bool {
        let [a, b] = [self.bounds, other.bounds];
        let around = a[0] <= b[0] && a[1] >= b[1] && a[2] <= b[2] && a[3] >= b[3];
        around && self.area > other.area
    }
}

impl Candidate {
    fn new((position, ring): (usize, Points)) -> Self {
        let mut bounds = [f64::MAX, f64::MIN, f64::MAX, f64::MIN];
        for row in ring.rows() {
            bounds[0] = bounds[0].min(row[0]);
            bounds[1] = bounds[1].max(row[0]);
            bounds[2] = bounds[2].min(row[1]);
            bounds[3] = bounds[3].max(row[1]);
        }
        let inside = inside(&ring, [bounds[2], bounds[3]]);
        let frame = Frame { position, area: area(&ring).abs(), bounds };
        Self { frame, inside, ring, edges: OnceCell::new() }
    }

    /// Whether a point is within the ring: an odd number of edges cross the line to the right of it.
    fn contains(&self, point: [f64; 2], work: &Budget) -> Result<bool, FileError> {
        let edges = self.edges.get_or_init(|| tree(&self.ring));
        let mut looks = SEARCH;
        let count = crossed(edges, point, &mut looks);
        work.take(looks)?;
        Ok(count % 2 == 1)
    }
}

/// The edges of a ring that are not horizontal, as a tree.
fn tree(ring: &Points) -> Vec<Edge> {
    let next = ring.rows().skip(1).chain(ring.rows().take(1));
    let sloping = ring.rows().zip(next).filter(|(a, b)| a[1] != b[1]);
    let mut edges: Vec<Edge> =
        sloping.map(|(a, b)| Edge { ends: [[a[0], a[1]], [b[0], b[1]]], highest: a[1].max(b[1]) }).collect();
    edges.sort_unstable_by(|a, b| a.low().total_cmp(&b.low()));
    raise(&mut edges);
    edges
}

impl Edge {
    fn low(&self) -> f64 {
        self.ends[0][1].min(self.ends[1][1])
    }
}

/// Passes the highest ends on to the roots. Returns that of the whole slice.
fn raise(edges: &mut [Edge]) -> f64 {
    let (before, rest) = edges.split_at_mut(edges.len() / 2);
    let Some((root, after)) = rest.split_first_mut() else { return f64::NEG_INFINITY };
    root.highest = root.highest.max(raise(before)).max(raise(after));
    root.highest
}

/// Number of edges that a horizontal line from a point to the right crosses. Counts the edges looked at.
fn crossed(edges: &[Edge], [x, y]: [f64; 2], looks: &mut u64) -> usize {
    let (before, rest) = edges.split_at(edges.len() / 2);
    let Some((root, after)) = rest.split_first() else { return 0 };
    *looks += 1;
    if !(root.highest > y) {
        return 0;
    }
    let mut count = crossed(before, [x, y], looks);
    if root.low() <= y {
        count += usize::from(crossing(&root.ends[0], &root.ends[1], y).is_some_and(|at| at > x));
        count += crossed(after, [x, y], looks);
    }
    count
}

/// Where an edge crosses a horizontal line.
fn crossing(a: &[f64], b: &[f64], y: f64) -> Option<f64> {
    ((a[1] > y) != (b[1] > y)).then(|| {
        let share = (y - a[1]) / (b[1] - a[1]);
        a[0] + share * (b[0] - a[0])
    })
}

/// Where the edges of a ring cross a horizontal line.
fn crossings(ring: &Points, y: f64) -> impl Iterator<Item = f64> {
    let next = ring.rows().skip(1).chain(ring.rows().take(1));
    ring.rows().zip(next).filter_map(move |(a, b)| crossing(a, b, y))
}

/// A point within a ring: half-way between two neighbouring crossings of a line that meets no vertex.
fn inside(ring: &Points, [low, high]: [f64; 2]) -> Option<[f64; 2]> {
    let middle = low + (high - low) / 2.0;
    let above = ring.rows().map(|row| row[1]).filter(|y| *y > middle).fold(high, f64::min);
    let below = ring.rows().map(|row| row[1]).filter(|y| *y <= middle).fold(low, f64::max);
    let y = below + (above - below) / 2.0;
    let mut found: Vec<f64> = crossings(ring, y).collect();
    found.sort_by(f64::total_cmp);
    let pair = found.chunks_exact(2).find(|pair| pair[1] > pair[0])?;
    Some([pair[0] + (pair[1] - pair[0]) / 2.0, y])
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::rc::Rc;

    use super::super::super::FaultKind;
    use super::*;

    /// For a file of which some bytes are read.
    fn budget(read: u64) -> Budget {
        Budget::new(COMPARISONS, Rc::new(Cell::new(read)))
    }

    fn square(at: f64, size: f64) -> Points {
        Points::from_rows(2, vec![at, at, at + size, at, at + size, at + size, at, at + size])
    }

    #[test]
    fn an_island_in_a_hole_is_an_area_of_its_own() {
        let rings = vec![
            square(2.0, 6.0),
            square(0.0, 10.0),
            square(20.0, 3.0),
            square(3.0, 4.0),
            square(21.0, 1.0),
            square(4.0, 1.0),
        ];
        let expected = vec![
            Part::Area(vec![square(0.0, 10.0), square(2.0, 6.0)]),
            Part::Area(vec![square(20.0, 3.0), square(21.0, 1.0)]),
            Part::Area(vec![square(3.0, 4.0), square(4.0, 1.0)]),
        ];
        assert_eq!(areas(rings, &budget(0)).expect("areas"), expected);
    }

    #[test]
    fn rings_that_touch_are_told_apart() {
        // The hole shares the left edge with its outer ring.
        let outer = Points::from_rows(2, vec![0.0, 0.0, 4.0, 0.0, 4.0, 3.0, 0.0, 3.0]);
        let hole = Points::from_rows(2, vec![0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 0.0, 2.0]);
        let rings = vec![hole.clone(), outer.clone()];
        assert_eq!(areas(rings, &budget(0)).expect("areas"), [Part::Area(vec![outer, hole])]);
        let flat = Points::from_rows(2, vec![0.0, 0.0, 1.0, 0.0, 2.0, 0.0]);
        assert_eq!(areas(vec![flat.clone(), square(-1.0, 9.0)], &budget(0)).expect("areas").len(), 2);
        assert_eq!(areas(vec![], &budget(0)).expect("areas").len(), 0);
    }

    #[test]
    fn a_large_ring_costs_little_for_each_hole() {
        let corner = |k: u32| (f64::from(k) / 20_000.0 * std::f64::consts::TAU).sin_cos();
        let outline = (0..20_000).map(corner).flat_map(|(y, x)| [100.0 * x, 100.0 * y]);
        let mut rings = vec![Points::from_rows(2, outline.collect())];
        rings.extend((0..2500).map(|k| {
            let [x, y] = [k % 50, k / 50].map(|at| 2.0 * f64::from(at) - 50.0);
            Points::from_rows(2, vec![x, y, x + 1.0, y, x + 1.0, y + 1.0, x, y + 1.0])
        }));
        let candidates: Vec<Candidate> = rings.iter().cloned().enumerate().map(Candidate::new).collect();
        let work = budget(0);
        let parents = parents(&candidates, &work).expect("few comparisons");
        assert_eq!(parents.len(), rings.len());
        assert!(parents[1..].iter().all(|parent| *parent == Some(0)) && parents[0].is_none());
        let used = work.taken();
        assert!(used < 2500 * 400, "{used}");
        assert_eq!(areas(rings.clone(), &budget(0)).expect("areas"), [Part::Area(rings)]);
    }

    #[test]
    fn too_many_rings_are_refused() {
        // One in the other: each is compared with all that are around it.
        let rings: Vec<Points> =
            (0..6000).map(|k| square(f64::from(k), 2.0 * (6000.0 - f64::from(k)))).collect();
        assert_eq!(areas(rings[..600].to_vec(), &budget(0)).expect("areas").len(), 300);
        let error = areas(rings, &budget(1000)).expect_err("too many");
        assert_eq!(error.kind, FaultKind::TooLarge);
        let most = (1 << 24) + 128 * 1000;
        let expected = format!(
            "expected at most {most} comparisons of rings that lie side by side or one around the other in 1000 bytes, got more"
        );
        assert_eq!(error.detail, expected);
    }
}
