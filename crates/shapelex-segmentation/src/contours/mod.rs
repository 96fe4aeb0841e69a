//! Labelled images and volumes as closed curves and closed surfaces.
//!
//! * [`components`] — connected components of the cells of a label;
//! * `level` — positions of the boundary between the centres of two cells;
//! * [`rings`] — the outer ring and the holes of a component in the plane;
//! * `cases` — the pieces of a surface in a cube of eight centres; [`surfaces`] — the outer surface and the cavities of a
//!   component in space;
//! * `fill` — components in space without handles and cavities.
//!
//! # Topology
//! The cells of a component are connected across sides in the plane and across faces in space. Cells that meet at a corner or
//! at an edge only are not connected there: the boundary passes between them. Cells outside are connected across corners in the
//! plane, and across faces and edges in space. So every component has one outer boundary, its holes or cavities are its other
//! boundaries, and no boundary touches itself or another one of the same component.
//!
//! # Positions
//! A vertex of the boundary is on the line between the centres of a cell inside and a neighbour outside, where the mask, or
//! the mask blurred by `σ`, is ½. Values of the blurred mask are limited so that every cell stays on its side of ½: a blur moves
//! vertices by less than half a cell and never changes the topology. Beyond the edge of the image there is nothing inside:
//! components are closed there, along the outer sides of the cells, and say how many of them they have on the edge.
//!
//! # Bias
//! Without a blur, which is the usual choice, a ring of a component of `n` cells without holes encloses exactly `n − ½` cells,
//! since every convex corner loses an eighth of a cell and every concave one gains it. All sides have directions that are multiples
//! of 45°, which makes lengths up to 8 % too large. A blur of `σ` cells moves a smooth curve of radius `R` inwards by `σ²/2R`,
//! which takes `πσ²` from the area whatever the size, and a surface of radius `R` by `σ²/R`. Measured for discs and balls, relative
//! to the number of their cells, and for lengths to the circumference:
//!
//! | σ | area, R = 3, 10, 40 | length, R = 3, 10, 40 | volume, R = 3, 10, 40 |
//! | --- | --- | --- | --- |
//! | 0 | −0.50, −0.50, −0.50 | +1.8, +4.8, +5.4 % | −6.5, −22, −89 |
//! | ½ | −0.94, −0.94, −0.94 | −0.3, +3.0, +3.5 % | −12, −41, −165 |
//! | 1 | −3.40, −3.49, −3.51 | −6.9, −0.1, +0.4 % | −28, −113 |

mod cases;
pub mod components;
mod fill;
mod level;
mod parts;
pub mod rings;
mod sets;
pub mod surfaces;

pub use components::{Component, Components, Dropped, Labels, Selection};
pub use rings::Region;
pub use surfaces::{Solid, Surface, SurfaceCounts};

use crate::SegmentationError;
use crate::frame::Frame;

/// Maximum blur in cells along an axis. Vertices move by less than half a cell, for which a larger one is of no use.
pub const MAX_BLUR: f64 = 8.0;

/// Blur in cells of a blur in units of length.
fn blur_in_cells<const D: usize>(frame: &Frame<D>, blur: f64) -> Result<[f64; 3], SegmentationError> {
    let cells = frame.sigma_in_cells(blur);
    match cells.into_iter().find(|sigma| !(0.0..=MAX_BLUR).contains(sigma)) {
        Some(sigma) => Err(SegmentationError::BlurOfMask { most: MAX_BLUR, sigma }),
        None => Ok(cells),
    }
}

/// Refuses more vertices than `most`, before memory for them is taken.
fn check_vertices(found: usize, most: usize) -> Result<(), SegmentationError> {
    if found > most { Err(SegmentationError::Vertices { most, found }) } else { Ok(()) }
}

/// Starts of the groups of a list that is grouped by component, from the sizes of the groups; the last one is its length.
fn starts(sizes: impl Iterator<Item = usize>) -> Vec<usize> {
    let ends = sizes.scan(0, |end, size| {
        *end += size;
        Some(*end)
    });
    std::iter::once(0).chain(ends).collect()
}
