//! Positions of the boundary of a component between the centres of two cells.

use super::components::Components;
use crate::field::Image;
use crate::field::filter::{blur, gaussian_kernel};

/// The value of the mask on the boundary.
const HALF: f64 = 0.5;
/// Least distance of a value of the blurred mask from ½: vertices stay at least a ninth of a cell away from the centres, so that
/// neighbouring ones do not coincide.
const MARGIN: f64 = 1.0 / 16.0;

/// The mask of a component, blurred.
pub(super) struct Level<'a, const D: usize> {
    components: &'a Components<D>,
    id: u32,
    /// The first cell of the blurred box, and its values; `None` without a blur.
    blurred: Option<([usize; 3], Image<f32>)>,
}

impl<'a, const D: usize> Level<'a, D> {
    /// The mask of a component blurred by `sigma` cells along each axis, in a box around it that the blur does not leave. At the
    /// edge of the image, the mask is continued by its outermost cells.
    pub(super) fn new(components: &'a Components<D>, id: u32, sigma: [f64; 3]) -> Self {
        let blurred = sigma.iter().any(|sigma| *sigma > 0.0).then(|| {
            let (first, mask) = crop(components, id, sigma);
            (first, blur(&mask, sigma))
        });
        Self { components, id, blurred }
    }

    /// Part of the way from the centre of a cell inside to that of a neighbour outside at which the mask is ½.
    pub(super) fn part(&self, inside: [isize; 3], outside: [isize; 3]) -> f64 {
        let Some((first, image)) = &self.blurred else { return HALF };
        let value =
            |cell: [isize; 3]| image.at(std::array::from_fn(|axis| cell[axis] as usize - first[axis]));
        let above = value(inside).max(HALF + MARGIN) - HALF;
        // Beyond the edge of the image the mask is continued antisymmetrically, so that it is ½ on the edge.
        let below = match self.components.contains(outside) {
            true => HALF - value(outside).min(HALF - MARGIN),
            false => above,
        };
        above / (above + below)
    }

    /// Whether a cell belongs to the component.
    pub(super) fn holds(&self, cell: [isize; 3]) -> bool {
        self.components.holds(self.id, cell)
    }
}

/// The mask of a component in the box of its cells, larger by the radius of the blur and one cell, within the image; and the
/// first cell of the box.
fn crop<const D: usize>(components: &Components<D>, id: u32, sigma: [f64; 3]) -> ([usize; 3], Image<f32>) {
    let [lower, upper] = components.list()[id as usize].corners;
    let margin = sigma.map(|sigma| gaussian_kernel(sigma, 0).len() / 2 + 1);
    let first: [usize; 3] = std::array::from_fn(|axis| lower[axis].saturating_sub(margin[axis]));
    let end: [usize; 3] =
        std::array::from_fn(|axis| (upper[axis] + margin[axis] + 1).min(components.size[axis]));
    let mask = Image::from_rows(std::array::from_fn(|axis| end[axis] - first[axis]), |j, k, row| {
        for (i, value) in row.iter_mut().enumerate() {
            let cell = [first[0] + i, first[1] + j, first[2] + k].map(|index| index as isize);
            *value = f32::from(u8::from(components.holds(id, cell)));
        }
    });
    (first, mask)
}
