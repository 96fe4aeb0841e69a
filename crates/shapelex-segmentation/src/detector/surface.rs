//! Surfaces among the cells on crests: the innermost one around a centre, and the largest piece.

use std::f64::consts::{PI, TAU};

use shapelex_geometry::vector::{dot, minus};

use super::Sheets;
use crate::field::image::percentile;
use crate::field::{Image, Value};
use crate::frame::Frame;

/// Rings of directions for each cell of the radius of a surface: directions are then 1.3 cells wide, so that nearly all of them meet a
/// cell of it. Through narrower ones the cells of the surface behind are seen.
const RINGS: f64 = 2.4;

/// Criteria of the innermost surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innermost {
    /// A rough centre, in index coordinates.
    pub centre: [f64; 3],
    /// Greatest number of rings of directions between the poles, 1 at least. Directions are about `π/rings` wide. There are fewer rings
    /// if directions were narrower than the cells of the surface, and would have none.
    pub rings: usize,
    /// Least cosine of the angle between normals and rays from the centre.
    pub along: f64,
    /// Distance from the centre above which surfaces are looked for, in units of length.
    pub beyond: f64,
    /// Depth of the layer kept in every direction, in units of length.
    pub depth: f64,
}

impl Innermost {
    /// The usual rules: 90 rings, cosines of at least 0.6, a depth of 1.5 cells.
    pub fn around(centre: [f64; 3], beyond: f64, frame: &Frame<3>) -> Self {
        let depth = 1.5 * frame.determinant().abs().cbrt();
        Self { centre, rings: 90, along: 0.6, beyond, depth }
    }
}

/// Of `cells`, those of the innermost surface: with a normal along the ray from the centre, and at most `depth` farther than the
/// nearest such cell of the same direction.
///
/// Directions are those of an equal-area grid: `rings` rings of equal height in the angle `θ` from the z axis, with
/// `2 rings sin θ` sectors each; at most 2.4 rings for each cell of the median distance. Cost: `O(n log n + rings²)` for `n` cells.
pub fn innermost<T: Value>(sheets: &Sheets<T>, cells: &[usize], rules: &Innermost) -> Vec<usize> {
    let (size, frame) = (sheets.response().size(), sheets.frame());
    let centre = frame.to_world(rules.centre);
    let candidate = |cell: &usize| {
        let ray = minus(frame.to_world(coordinates(*cell, size).map(|x| x as f64)), centre);
        let distance = dot(ray, ray).sqrt();
        let along = dot(ray, sheets.normal(*cell)).abs() > rules.along * distance;
        (along && distance > rules.beyond).then_some((*cell, ray, distance))
    };
    let candidates: Vec<(usize, [f64; 3], f64)> = cells.iter().filter_map(candidate).collect();
    let median = percentile(candidates.iter().map(|(.., distance)| *distance).collect(), 50.0);
    let radius = median.unwrap_or(0.0) / frame.determinant().abs().cbrt();
    let directions = Directions::new(((RINGS * radius) as usize).clamp(1, rules.rings.max(1)));
    let of = |(cell, ray, distance): (usize, [f64; 3], f64)| (cell, directions.of(ray, distance), distance);
    let candidates: Vec<(usize, usize, f64)> = candidates.into_iter().map(of).collect();
    let mut nearest = vec![f64::INFINITY; directions.count()];
    for (_, direction, distance) in &candidates {
        nearest[*direction] = distance.min(nearest[*direction]);
    }
    let kept = candidates.iter().filter(|(_, direction, at)| *at <= nearest[*direction] + rules.depth);
    kept.map(|(cell, ..)| *cell).collect()
}

/// A grid of directions of about equal areas.
struct Directions {
    /// Position of the first sector of every ring, and their number.
    first: Vec<usize>,
}

impl Directions {
    fn new(rings: usize) -> Self {
        let mut first = vec![0];
        for ring in 0..rings {
            let sine = (PI * (ring as f64 + 0.5) / rings as f64).sin();
            first.push(first[ring] + ((2.0 * rings as f64 * sine).round() as usize).max(1));
        }
        Self { first }
    }

    fn count(&self) -> usize {
        self.first[self.first.len() - 1]
    }

    /// The sector of a ray of positive length.
    fn of(&self, ray: [f64; 3], length: f64) -> usize {
        let rings = self.first.len() - 1;
        let place = |part: f64, count: usize| ((part * count as f64).max(0.0) as usize).min(count - 1);
        let ring = place((ray[2] / length).clamp(-1.0, 1.0).acos() / PI, rings);
        let sectors = self.first[ring + 1] - self.first[ring];
        self.first[ring] + place(ray[1].atan2(ray[0]) / TAU + 0.5, sectors)
    }
}

/// Of ascending `cells` of a grid, those of the largest component by faces, edges and corners; of equally large ones, that with
/// the first cell. Cost: `O(n log n)` for `n` cells.
pub fn largest_component(cells: &[usize], size: [usize; 3]) -> Vec<usize> {
    let mut component = vec![usize::MAX; cells.len()];
    let mut largest = (0, 0);
    for start in 0..cells.len() {
        if component[start] != usize::MAX {
            continue;
        }
        component[start] = start;
        let (mut waiting, mut count) = (vec![start], 0);
        // Every cell is put on the list once.
        while let Some(at) = waiting.pop() {
            count += 1;
            for cell in neighbours(cells[at], size) {
                if let Ok(found) = cells.binary_search(&cell)
                    && component[found] == usize::MAX
                {
                    component[found] = start;
                    waiting.push(found);
                }
            }
        }
        if count > largest.0 {
            largest = (count, start);
        }
    }
    let members = cells.iter().zip(component).filter(|(_, component)| *component == largest.1);
    members.map(|(cell, _)| *cell).collect()
}

/// The cells, at most 27, that share a corner with a cell; the cell among them.
fn neighbours(cell: usize, size: [usize; 3]) -> impl Iterator<Item = usize> {
    let at = coordinates(cell, size);
    let [x, y, z]: [_; 3] = std::array::from_fn(|c| at[c].saturating_sub(1)..=(at[c] + 1).min(size[c] - 1));
    z.flat_map(move |k| {
        let x = x.clone();
        y.clone().flat_map(move |j| x.clone().map(move |i| (k * size[1] + j) * size[0] + i))
    })
}

/// Indices along x, y, z of a cell.
fn coordinates(cell: usize, [columns, rows, _]: [usize; 3]) -> [usize; 3] {
    [cell % columns, cell / columns % rows, cell / columns / rows]
}

/// An image with 1 in `cells` and 0 elsewhere.
///
/// # Panics
/// For cells outside of the grid.
pub fn edge_map<T: Value>(cells: &[usize], size: [usize; 3]) -> Image<T> {
    let mut map = Image::from_rows(size, |_, _, _: &mut [T]| ());
    cells.iter().for_each(|cell| map.set(*cell, 1.0));
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_about_equal_areas() {
        let directions = Directions::new(30);
        let count = directions.count();
        let mut hits = vec![0.0_f64; count];
        // A spiral of points with equal areas, about 400 per direction.
        let points = 400 * count;
        for i in 0..points {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / points as f64;
            let (sine, cosine) = (TAU * 0.618_033_988_749_894_9 * i as f64).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            hits[directions.of([radius * cosine, radius * sine, z], 1.0)] += 1.0;
        }
        // Rings next to the poles have a whole number of sectors near 3.1.
        let [least, most] =
            [hits.iter().copied().fold(1e9, f64::min), hits.iter().copied().fold(0.0, f64::max)];
        assert!(least > 300.0 && most < 500.0, "{least} to {most} of 400");
        assert_eq!(directions.of([0.0, 0.0, 2.0], 2.0) / 3, 0);
        assert!(directions.of([0.0, -0.0, -2.0], 2.0) < count);
    }

    #[test]
    fn components_touch_by_corners_and_do_not_go_around_the_edges() {
        let size = [4, 3, 3];
        let at = |[i, j, k]: [usize; 3]| (k * 3 + j) * 4 + i;
        // A diagonal of three cells, and (0, 1, 0) beside it; (3, 0, 0) is next to (0, 1, 0) in order only.
        let mut cells = [[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 0, 0], [0, 1, 0]].map(at);
        cells.sort_unstable();
        assert_eq!(at([3, 0, 0]) + 1, at([0, 1, 0]));
        let expected: Vec<usize> = cells.iter().copied().filter(|cell| *cell != at([3, 0, 0])).collect();
        assert_eq!(largest_component(&cells, size), expected);
        assert!(largest_component(&[], size).is_empty());
        let map: Image = edge_map(&expected, size);
        assert_eq!((map.at([1, 1, 1]), map.at([0, 2, 2]), map.values().iter().sum::<f64>()), (1.0, 0.0, 4.0));
    }
}
