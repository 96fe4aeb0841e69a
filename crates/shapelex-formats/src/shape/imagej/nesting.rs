//! Which rings of a composite region bound holes. ImageJ fills such a region by the even–odd rule.

use super::super::error::{FileError, Place};
use super::super::objects::{Part, area};
use super::super::record::Points;

/// Most comparisons of a ring with a point of another one: some seconds.
const MOST: u64 = 1 << 32;

/// A ring with what decides whether it lies in another one.
struct Candidate {
    ring: Points,
    area: f64,
    /// Least and greatest x and y.
    bounds: [f64; 4],
    inside: Option<[f64; 2]>,
}

/// Makes areas of rings that do not cross: a ring within an odd number of others bounds a hole of the smallest of them. Areas stand
/// in the order of their outer rings, followed by their holes in theirs.
///
/// # Errors
/// More rings and points than can be compared.
pub(super) fn areas(rings: Vec<Points>) -> Result<Vec<Part>, FileError> {
    let points: u64 = rings.iter().map(|ring| ring.len() as u64).sum();
    if points.saturating_mul(rings.len() as u64) > MOST {
        let detail = format!(
            "expected a composite of which rings times points are at most {MOST}, got {} rings of {points} points",
            rings.len()
        );
        return Err(FileError::too_large(Place::default(), detail));
    }
    let candidates: Vec<Candidate> = rings.into_iter().map(Candidate::new).collect();
    let around: Vec<Option<usize>> = (0..candidates.len()).map(|k| parent(&candidates, k)).collect();
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

/// The outer ring of which ring `k` bounds a hole: the smallest of those around it, if their number is odd.
fn parent(candidates: &[Candidate], k: usize) -> Option<usize> {
    let around: Vec<usize> =
        (0..candidates.len()).filter(|j| candidates[*j].contains(&candidates[k])).collect();
    let smallest = around.iter().copied().min_by(|a, b| candidates[*a].area.total_cmp(&candidates[*b].area));
    smallest.filter(|_| around.len() % 2 == 1)
}

impl Candidate {
    fn new(ring: Points) -> Self {
        let mut bounds = [f64::MAX, f64::MIN, f64::MAX, f64::MIN];
        for row in ring.rows() {
            bounds[0] = bounds[0].min(row[0]);
            bounds[1] = bounds[1].max(row[0]);
            bounds[2] = bounds[2].min(row[1]);
            bounds[3] = bounds[3].max(row[1]);
        }
        let inside = inside(&ring, [bounds[2], bounds[3]]);
        Self { area: area(&ring).abs(), bounds, inside, ring }
    }

    /// Whether another ring, which is smaller, lies within this one.
    fn contains(&self, other: &Self) -> bool {
        let [a, b] = [self.bounds, other.bounds];
        let around = a[0] <= b[0] && a[1] >= b[1] && a[2] <= b[2] && a[3] >= b[3];
        around
            && self.area > other.area
            && other
                .inside
                .is_some_and(|[x, y]| crossings(&self.ring, y).filter(|at| *at > x).count() % 2 == 1)
    }
}

/// Where the edges of a ring cross a horizontal line.
fn crossings(ring: &Points, y: f64) -> impl Iterator<Item = f64> {
    let next = ring.rows().skip(1).chain(ring.rows().take(1));
    ring.rows().zip(next).filter(move |(a, b)| (a[1] > y) != (b[1] > y)).map(move |(a, b)| {
        let share = (y - a[1]) / (b[1] - a[1]);
        a[0] + share * (b[0] - a[0])
    })
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
    use super::super::super::FaultKind;
    use super::*;

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
        assert_eq!(areas(rings).expect("areas"), expected);
    }

    #[test]
    fn rings_that_touch_are_told_apart() {
        // The hole shares the left edge with its outer ring.
        let outer = Points::from_rows(2, vec![0.0, 0.0, 4.0, 0.0, 4.0, 3.0, 0.0, 3.0]);
        let hole = Points::from_rows(2, vec![0.0, 1.0, 1.0, 1.0, 1.0, 2.0, 0.0, 2.0]);
        assert_eq!(areas(vec![hole.clone(), outer.clone()]).expect("areas"), [Part::Area(vec![outer, hole])]);
        let flat = Points::from_rows(2, vec![0.0, 0.0, 1.0, 0.0, 2.0, 0.0]);
        assert_eq!(areas(vec![flat.clone(), square(-1.0, 9.0)]).expect("areas").len(), 2);
        assert_eq!(areas(vec![]).expect("areas").len(), 0);
    }

    #[test]
    fn too_many_rings_are_refused() {
        let rings = vec![square(0.0, 1.0); 1 << 16];
        assert_eq!(areas(rings).expect_err("too many").kind, FaultKind::TooLarge);
    }
}
