//! Contours in one slice: which of them bound holes, and which touch themselves.

use std::collections::{HashMap, HashSet};

use super::plane::{Basis, FLAT_MM};
use super::regions::{Contour, Region};
use crate::error::FileError;
use crate::shape::record::Points;

/// Most closed contours in one slice of a region: each pair of them is compared.
const MOST_CONTOURS: usize = 1024;

/// The closed contours of a region in one plane. Indices are those of the contours of the region.
pub(super) struct Slice {
    /// Distance of the plane from the origin, along the normal.
    pub(super) offset: f64,
    /// Contours in the order in which they are given on: each part is followed by its holes.
    pub(super) rings: Vec<SliceRing>,
}

/// A closed contour of a slice.
pub(super) struct SliceRing {
    pub(super) contour: usize,
    /// Part of the slice, from 0.
    pub(super) part: usize,
    /// Whether it lies within an odd number of others.
    pub(super) hole: bool,
}

/// The slices of a region in the order of their first contours in the file.
pub(super) fn slices(region: &Region, basis: &Basis) -> Result<Vec<Slice>, FileError> {
    let closed = region.contours.iter().enumerate().filter(|(_, contour)| contour.kind.is_closed());
    let mut sorted: Vec<(f64, usize)> =
        closed.map(|(k, contour)| (basis.offset(&contour.points), k)).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut groups: Vec<(f64, Vec<usize>)> = Vec::new();
    for (offset, contour) in sorted {
        match groups.last_mut() {
            Some((first, group)) if offset - *first <= FLAT_MM => group.push(contour),
            _ => groups.push((offset, vec![contour])),
        }
    }
    for (_, group) in &mut groups {
        group.sort_unstable();
    }
    groups.sort_by_key(|(_, group)| group[0]);
    groups
        .into_iter()
        .map(|(offset, group)| Ok(Slice { offset, rings: rings(region, basis, &group)? }))
        .collect()
}

fn rings(region: &Region, basis: &Basis, group: &[usize]) -> Result<Vec<SliceRing>, FileError> {
    if group.len() > MOST_CONTOURS {
        let place = region.contours[group[0]].place.clone();
        let detail = format!("expected at most {MOST_CONTOURS} closed contours a slice, got {}", group.len());
        return Err(FileError::too_large(place, detail));
    }
    if let [contour] = group {
        return Ok(vec![SliceRing { contour: *contour, part: 0, hole: false }]);
    }
    let outlines: Vec<Outline> =
        group.iter().map(|k| Outline::new(basis.project(&region.contours[*k].points))).collect();
    let around = |k: usize| -> Vec<usize> {
        (0..group.len()).filter(|other| *other != k && outlines[*other].contains(&outlines[k])).collect()
    };
    let around: Vec<Vec<usize>> = (0..group.len()).map(around).collect();
    let mut rings = Vec::new();
    let outer = (0..group.len()).filter(|k| around[*k].len().is_multiple_of(2));
    for (part, k) in outer.enumerate() {
        rings.push(SliceRing { contour: group[k], part, hole: false });
        // The holes of a part are one level deeper, and within it.
        let holes =
            (0..group.len()).filter(|h| around[*h].len() == around[k].len() + 1 && around[*h].contains(&k));
        rings.extend(holes.map(|h| SliceRing { contour: group[h], part, hole: true }));
    }
    // Contours that cross each other can lie within others in no order; nothing may be lost.
    let given: HashSet<usize> = rings.iter().map(|ring| ring.contour).collect();
    let lost = group.iter().filter(|contour| !given.contains(contour));
    rings
        .extend(lost.map(|contour| SliceRing { contour: *contour, part: 0, hole: true }).collect::<Vec<_>>());
    Ok(rings)
}

/// A closed contour in the plane, with its box.
struct Outline {
    points: Points,
    low: [f64; 2],
    high: [f64; 2],
}

impl Outline {
    fn new(points: Points) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for row in points.rows() {
            low = [0, 1].map(|k| low[k].min(row[k]));
            high = [0, 1].map(|k| high[k].max(row[k]));
        }
        Self { points, low, high }
    }

    /// Whether two of three points of another outline, at thirds of their number, are inside: one of them may touch the boundary.
    fn contains(&self, other: &Self) -> bool {
        if (0..2).any(|k| other.low[k] < self.low[k] || other.high[k] > self.high[k]) {
            return false;
        }
        let count = other.points.len();
        let inside = |at: usize| other.points.rows().nth(at).is_some_and(|row| self.is_inside(row));
        [0, count / 3, 2 * count / 3].into_iter().filter(|at| inside(*at)).count() >= 2
    }

    /// Whether a ray from a point crosses the outline an odd number of times.
    fn is_inside(&self, point: &[f64]) -> bool {
        let mut inside = false;
        let Some(mut last) = self.points.rows().next_back() else { return false };
        for row in self.points.rows() {
            if (row[1] > point[1]) != (last[1] > point[1]) {
                let share = (point[1] - row[1]) / (last[1] - row[1]);
                inside ^= point[0] < row[0] + share * (last[0] - row[0]);
            }
            last = row;
        }
        inside
    }
}

/// How a closed contour meets itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Contact {
    /// It does not.
    None,
    /// It passes the same points again.
    Touches,
    /// It runs along the same edges in both directions: a channel, which leads to a hole.
    Keyhole,
}

/// Compares the points and edges of a closed contour, exactly as they are in the file.
pub(super) fn contact(contour: &Contour) -> Contact {
    let mut numbers = HashMap::new();
    let mut corners: Vec<usize> = Vec::new();
    for row in contour.points.rows() {
        // −0 and 0 are one position.
        let key = [0, 1, 2].map(|k| (row[k] + 0.0).to_bits());
        let next = numbers.len();
        let number = *numbers.entry(key).or_insert(next);
        if corners.last() != Some(&number) {
            corners.push(number);
        }
    }
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() == numbers.len() {
        return Contact::None;
    }
    let count = corners.len();
    let edges: HashSet<(usize, usize)> = (0..count).map(|k| (corners[k], corners[(k + 1) % count])).collect();
    if edges.iter().any(|(a, b)| edges.contains(&(*b, *a))) { Contact::Keyhole } else { Contact::Touches }
}

#[cfg(test)]
mod tests {
    use super::super::regions::ContourKind;
    use super::*;
    use crate::shape::Place;

    fn flat(points: &[[f64; 2]]) -> Contour {
        let coordinates = points.iter().flat_map(|[x, y]| [*x, *y, 5.0]).collect();
        let points = Points::from_rows(3, coordinates);
        Contour { kind: ContourKind::ClosedPlanar, points, number: 1, image: None, place: Place::default() }
    }

    fn square(x: f64, y: f64, half: f64) -> Contour {
        flat(&[[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])
    }

    #[test]
    fn parts_are_followed_by_their_holes() {
        // Two parts; the first one has two holes, and an island in the second hole.
        let contours = vec![
            square(2.0, 0.0, 1.0),
            square(-2.0, 0.0, 1.0),
            square(0.0, 0.0, 9.0),
            square(30.0, 0.0, 9.0),
            square(2.0, 0.0, 0.5),
        ];
        let region = Region {
            number: 1,
            name: "a".into(),
            kind: None,
            colour: None,
            frame_of_reference: "1".into(),
            contours,
            index: 0,
        };
        let basis = Basis::of(&region.contours.iter().collect::<Vec<_>>()).expect("a plane");
        let slices = slices(&region, &basis).expect("slices");
        assert_eq!(slices.len(), 1);
        let rings: Vec<_> = slices[0].rings.iter().map(|ring| (ring.contour, ring.part, ring.hole)).collect();
        assert_eq!(rings, [(2, 0, false), (0, 0, true), (1, 0, true), (3, 1, false), (4, 2, false)]);
    }

    #[test]
    fn keyholes_are_seen() {
        assert_eq!(contact(&square(0.0, 0.0, 1.0)), Contact::None);
        let mut repeated = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert_eq!(contact(&flat(&repeated)), Contact::None);
        repeated.push([0.0, 0.0]);
        assert_eq!(contact(&flat(&repeated)), Contact::None);
        let eight = [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0], [2.0, 2.0], [1.0, 1.0], [0.0, 2.0]];
        assert_eq!(contact(&flat(&eight)), Contact::Touches);
        let keyhole = [
            [0.0, 0.0],
            [9.0, 0.0],
            [9.0, 9.0],
            [0.0, 9.0],
            [0.0, 0.0],
            [3.0, 3.0],
            [3.0, 6.0],
            [6.0, 6.0],
            [6.0, 3.0],
            [3.0, 3.0],
        ];
        assert_eq!(contact(&flat(&keyhole)), Contact::Keyhole);
    }
}
