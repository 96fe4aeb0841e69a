//! Outer rings and holes of components in the plane.
//!
//! The boundary is followed along the sides of the cells, with the component on the left. A side is a cell inside and the
//! direction of its neighbour outside; a vertex is on each side.

use rayon::prelude::*;
use shapelex_numeric::bounded::Stop;

use super::components::{Component, Components, NONE};
use super::level::Level;
use super::{blur_in_cells, check_vertices, starts};
use crate::SegmentationError;
use crate::frame::Frame;

/// Number of vertices between two questions whether to stop.
const LOOK: usize = 4096;

/// A component in the plane as closed curves, whose last point is joined to the first.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// The component.
    pub component: Component,
    /// The outer ring, counter-clockwise in the world. It begins at the left side of the first cell.
    pub outer: Vec<[f64; 2]>,
    /// The holes, clockwise in the world, in the order of the first cells on the right of them.
    pub holes: Vec<Vec<[f64; 2]>>,
}

impl Components<2> {
    /// Number of vertices of all rings.
    pub fn vertices(&self) -> usize {
        self.list().iter().map(|component| component.faces).sum()
    }

    /// The rings of all components, in world coordinates, from the mask blurred by `blur` units of length, 0 for none. `None`
    /// once `stop` returns true. The same bits on any number of threads.
    ///
    /// Cost: one pass over the cells, and `O(log n)` for each of `n` vertices. Memory: 17 bytes per vertex; with a blur also 12
    /// bytes per cell of the box of one component.
    ///
    /// # Errors
    /// [`SegmentationError::Vertices`] for more than `most_vertices`, [`SegmentationError::BlurOfMask`].
    pub fn regions(
        &self,
        frame: &Frame<2>,
        blur: f64,
        most_vertices: usize,
        stop: Stop<'_>,
    ) -> Result<Option<Vec<Region>>, SegmentationError> {
        let sigma = blur_in_cells(frame, blur)?;
        check_vertices(self.vertices(), most_vertices)?;
        let (starts, sides) = self.left_sides();
        let region = |id: usize| {
            let level = Level::new(self, id as u32, sigma);
            let sides = &sides[starts[id]..starts[id + 1]];
            region(self.list()[id], &Tracer { level, columns: self.size[0], sides }, frame, stop)
        };
        let all = 0..self.list().len();
        // Filters are parallel themselves; one box at a time bounds their memory.
        Ok(match blur > 0.0 {
            true => all.map(region).collect(),
            false => all.into_par_iter().map(region).collect(),
        })
    }

    /// The cells without a left neighbour in their component, grouped by component, and the starts of the groups.
    fn left_sides(&self) -> (Vec<usize>, Vec<u32>) {
        let columns = self.size[0];
        let is_left = |at: usize| {
            self.ids[at] != NONE && (at.is_multiple_of(columns) || self.ids[at - 1] != self.ids[at])
        };
        let mut counts = vec![0; self.list().len()];
        for at in (0..self.ids.len()).filter(|at| is_left(*at)) {
            counts[self.ids[at] as usize] += 1;
        }
        let starts = starts(counts.into_iter());
        let (mut next, mut sides) = (starts.clone(), vec![0; starts[starts.len() - 1]]);
        for at in (0..self.ids.len()).filter(|at| is_left(*at)) {
            let id = self.ids[at] as usize;
            sides[next[id]] = at as u32;
            next[id] += 1;
        }
        (starts, sides)
    }
}

/// The rings of a component. Each has a side on the left of a cell; the ring of the first one is the outer ring, since nothing
/// of the component is before it.
fn region(component: Component, tracer: &Tracer<'_>, frame: &Frame<2>, stop: Stop<'_>) -> Option<Region> {
    let mut met = vec![false; tracer.sides.len()];
    let mut rings = Vec::new();
    for side in 0..tracer.sides.len() {
        if !met[side] {
            let ring = tracer.ring(side, component.faces, &mut met, stop)?;
            rings.push(in_world(ring, frame));
        }
    }
    let mut rings = rings.into_iter();
    let outer = rings.next()?;
    Some(Region { component, outer, holes: rings.collect() })
}

/// Positions of a ring; a frame that changes the orientation has its points in the opposite order, from the same first one.
fn in_world(ring: Vec<[f64; 2]>, frame: &Frame<2>) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> = ring.into_iter().map(|point| frame.to_world(point)).collect();
    if frame.determinant() < 0.0 {
        points[1..].reverse();
    }
    points
}

/// Follows the boundary of a component.
struct Tracer<'a> {
    level: Level<'a, 2>,
    columns: usize,
    /// The cells of the component with a side on the left, in order.
    sides: &'a [u32],
}

/// A cell inside, and the direction of a neighbour outside.
#[derive(Clone, Copy, PartialEq)]
struct Side {
    cell: [isize; 2],
    outward: [isize; 2],
}

const LEFT: [isize; 2] = [-1, 0];

impl Side {
    /// The direction with the cell on the left.
    fn along(self) -> [isize; 2] {
        [-self.outward[1], self.outward[0]]
    }
}

impl Tracer<'_> {
    /// The ring from a left side on, in index coordinates; marks the left sides that it meets. `most`: number of all sides.
    fn ring(&self, first: usize, most: usize, met: &mut [bool], stop: Stop<'_>) -> Option<Vec<[f64; 2]>> {
        let at = self.sides[first] as usize;
        let start =
            Side { cell: [at % self.columns, at / self.columns].map(|index| index as isize), outward: LEFT };
        let (mut side, mut points) = (start, Vec::new());
        for step in 0..most {
            if step.is_multiple_of(LOOK) && stop() {
                return None;
            }
            points.push(self.point(side));
            if side.outward == LEFT {
                let at = (side.cell[1] as usize * self.columns + side.cell[0] as usize) as u32;
                if let Ok(side) = self.sides.binary_search(&at) {
                    met[side] = true;
                }
            }
            side = self.next(side);
            if side == start {
                break;
            }
        }
        Some(points)
    }

    /// The next side. Where two cells of the component meet at a corner only, it stays at its cell, which separates them.
    fn next(&self, side: Side) -> Side {
        let along = side.along();
        let ahead = plus(side.cell, along);
        let beyond = plus(ahead, side.outward);
        if !self.holds(ahead) {
            Side { cell: side.cell, outward: along }
        } else if !self.holds(beyond) {
            Side { cell: ahead, outward: side.outward }
        } else {
            Side { cell: beyond, outward: along.map(|x| -x) }
        }
    }

    fn holds(&self, [i, j]: [isize; 2]) -> bool {
        self.level.holds([i, j, 0])
    }

    fn point(&self, side: Side) -> [f64; 2] {
        let [i, j] = side.cell;
        let [x, y] = plus(side.cell, side.outward);
        let part = self.level.part([i, j, 0], [x, y, 0]);
        std::array::from_fn(|axis| side.cell[axis] as f64 + part * side.outward[axis] as f64)
    }
}

fn plus(a: [isize; 2], b: [isize; 2]) -> [isize; 2] {
    [a[0] + b[0], a[1] + b[1]]
}
