//! A result beside its start: sizes, centres, and overlap.
//!
//! ```text
//! ratio = V/V₀,   shared = |Ω ∩ Ω₀|/|Ω₀| in cells,   c = 1/V ∫_Ω x dV
//! ```
//!
//! A minimum of the energy may lie at another object, and the minimisation ends there as well as anywhere. The sign of it is the
//! distance from the start: a result of a very different size, or one that no longer contains the centre of its start, has left
//! the object that the start pointed at.

use shapelex_geometry::raster::Grid;

use crate::frame::Frame;
use crate::snake::Outline;

/// Size and centre of a shape in the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent<const D: usize> {
    /// The enclosed area or volume.
    pub size: f64,
    /// The centroid of the enclosed part.
    pub centre: [f64; D],
}

/// A result beside its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved<const D: usize> {
    /// The start.
    pub start: Extent<D>,
    /// The result.
    pub result: Extent<D>,
    /// Whether the result contains the centre of the start.
    pub contains_centre: bool,
    /// Whether the start contains its own centre: a ring does not.
    pub start_contains_centre: bool,
    /// Part of the cells of the start that the result contains; 0 for a start without cells.
    pub shared: f64,
}

impl<const D: usize> Moved<D> {
    /// Compares outlines in index coordinates, which enclose these sizes. Cost: two rasters of the box around the start.
    pub fn between(start: (&Outline, f64), result: (&Outline, f64), frame: &Frame<D>) -> Self {
        let extent = |(outline, size): (&Outline, f64)| {
            let centre = outline.centroid();
            Extent { size, centre: frame.to_world(std::array::from_fn(|c| centre[c])) }
        };
        let centre = start.0.centroid();
        let contains = |outline: &Outline| {
            let grid = Grid { first: centre, spacing: [1.0; 3], size: [1; 3] };
            outline.cells(&grid).inside == [true]
        };
        Self {
            start: extent(start),
            result: extent(result),
            contains_centre: contains(result.0),
            start_contains_centre: contains(start.0),
            shared: shared(start.0, result.0),
        }
    }

    /// `V/V₀`.
    pub fn ratio(&self) -> f64 {
        self.result.size / self.start.size
    }

    /// Whether the result has left the object of its start: its size differs by more than `factor`, or it no longer contains the
    /// centre of the start. Of a start that does not contain its own centre, a ring, it has no cell left.
    pub fn has_left(&self, factor: f64) -> bool {
        let ratio = self.ratio();
        let is_away = if self.start_contains_centre { !self.contains_centre } else { self.shared == 0.0 };
        is_away || !(ratio <= factor && ratio * factor >= 1.0)
    }
}

/// Part of the cells of the start that the result contains.
fn shared(start: &Outline, result: &Outline) -> f64 {
    let Some(grid) = start.grid() else { return 0.0 };
    let (of_start, of_result) = (start.cells(&grid), result.cells(&grid));
    let count = of_start.inside.iter().filter(|inside| **inside).count();
    let both = of_start.inside.iter().zip(&of_result.inside).filter(|(a, b)| **a && **b).count();
    if count == 0 { 0.0 } else { both as f64 / count as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rectangle with corners at these positions.
    fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Outline {
        Outline::Polygon(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    }

    #[test]
    fn results_are_compared_with_their_starts() {
        let frame = Frame::new([[2.0, 0.0], [0.0, -3.0]], [1.0, 5.0]).unwrap();
        let start = rectangle([1.5, 2.5], [11.5, 8.5]);
        let right = rectangle([6.5, 2.5], [16.5, 8.5]);
        let moved = Moved::between((&start, 360.0), (&right, 360.0), &frame);
        // The centres are (6.5, 5.5) and (11.5, 5.5) in cells; half of the start is shared.
        for (found, expected) in [(moved.start.centre, [14.0, -11.5]), (moved.result.centre, [24.0, -11.5])] {
            // Sums of eight products of numbers below 1000.
            assert!(
                (0..2).all(|c| (found[c] - expected[c]).abs() < 1e-12),
                "{found:?}, expected {expected:?}"
            );
        }
        assert_eq!((moved.ratio(), moved.shared), (1.0, 0.5));
        assert!(moved.start_contains_centre && !moved.contains_centre && moved.has_left(2.0));
        let larger = Moved::between((&start, 360.0), (&rectangle([1.5, 2.5], [24.0, 8.5]), 810.0), &frame);
        assert_eq!((larger.ratio(), larger.shared, larger.contains_centre), (2.25, 1.0, true));
        assert!(larger.has_left(2.0) && !larger.has_left(2.25));
        let smaller = Moved::between((&start, 360.0), (&rectangle([5.5, 4.5], [7.5, 6.5]), 24.0), &frame);
        assert!(smaller.has_left(2.0) && !smaller.has_left(15.0) && smaller.contains_centre);
    }

    /// A ring does not contain its own centre: the test is whether anything is shared.
    #[test]
    fn rings_do_not_have_to_contain_their_centres() {
        let ring = |dx: f64| {
            let corners = [
                [0.0, 0.0],
                [20.0, 0.0],
                [20.0, 20.0],
                [0.0, 20.0],
                [0.0, 16.0],
                [16.0, 16.0],
                [16.0, 4.0],
                [0.0, 4.0],
            ];
            Outline::Polygon(corners.iter().map(|[x, y]| [x + dx + 0.25, y + 0.25]).collect())
        };
        let at = |dx: f64| Moved::between((&ring(0.0), 208.0), (&ring(dx), 208.0), &Frame::<2>::identity());
        assert!(!at(0.0).start_contains_centre && !at(0.0).has_left(2.0) && at(0.0).shared == 1.0);
        assert!(!at(3.0).has_left(2.0) && at(30.0).has_left(2.0));
    }
}
