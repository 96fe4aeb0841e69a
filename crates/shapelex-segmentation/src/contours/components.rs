//! Connected components of the cells of a label.

use shapelex_numeric::bounded::Stop;

use super::parts::{Parts, Wanted};
use crate::SegmentationError;

/// No component.
pub(super) const NONE: u32 = u32::MAX;

/// Labels of the cells of an image (`D = 2`) or a volume (`D = 3`), x fastest.
#[derive(Debug, Clone, Copy)]
pub struct Labels<'a, const D: usize> {
    pub(super) size: [usize; 3],
    pub(super) values: &'a [u32],
    /// Whether the first and the last layer along z may be within an object that the image shows in part.
    pub(super) open_ends: bool,
}

impl<'a, const D: usize> Labels<'a, D> {
    /// The labels of a grid: that of cell `(i, j, k)` is at `(k · size[1] + j) · size[0] + i`.
    ///
    /// # Errors
    /// [`SegmentationError::Empty`], [`SegmentationError::Values`]; [`SegmentationError::Cells`] for 2³² cells or more.
    pub fn new(size: [usize; D], values: &'a [u32]) -> Result<Self, SegmentationError> {
        const { assert!(D == 2 || D == 3) };
        let size = std::array::from_fn(|axis| size.get(axis).copied().unwrap_or(1));
        if size.contains(&0) {
            return Err(SegmentationError::Empty { size });
        }
        if size.iter().try_fold(1_usize, |count, size| count.checked_mul(*size)) != Some(values.len()) {
            return Err(SegmentationError::Values { size, count: values.len() });
        }
        if values.len() >= NONE as usize {
            return Err(SegmentationError::Cells { most: NONE as usize - 1, count: values.len() });
        }
        Ok(Self { size, values, open_ends: false })
    }

    /// The same labels, of an image that may go on beyond its first and last layer along z: no side there is one on the edge.
    #[must_use]
    pub fn with_open_ends(self, open_ends: bool) -> Self {
        Self { open_ends, ..self }
    }

    /// The cell at a position, x fastest.
    pub(super) fn cell(&self, at: usize) -> [usize; 3] {
        let [columns, rows, _] = self.size;
        [at % columns, at / columns % rows, at / columns / rows]
    }

    /// Distance in the list of neighbours along each axis.
    pub(super) fn strides(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    /// The `2D` neighbours of a cell; `None` beyond the edge.
    fn neighbours(&self, at: usize) -> impl Iterator<Item = Option<usize>> {
        let (cell, size, strides) = (self.cell(at), self.size, self.strides());
        (0..D).flat_map(move |axis| {
            let below = (cell[axis] > 0).then(|| at - strides[axis]);
            let above = (cell[axis] + 1 < size[axis]).then(|| at + strides[axis]);
            [below, above]
        })
    }
}

/// The components that are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection {
    /// Their labels; all but 0 if `None`.
    pub labels: Option<Vec<u32>>,
    /// Number of cells below which a component is left out.
    pub least_cells: usize,
    /// Whether only the largest component of each label is kept; of several, the first one.
    pub largest: bool,
    /// Whether labels that look like a photograph are refused.
    pub refuses_photographs: bool,
    /// Maximum number of components.
    pub most_components: usize,
}

impl Default for Selection {
    /// All components of all labels but 0, at most a million.
    fn default() -> Self {
        Self {
            labels: None,
            least_cells: 1,
            largest: false,
            refuses_photographs: false,
            most_components: 1_000_000,
        }
    }
}

impl Selection {
    /// Least number of cells of a component that is kept.
    pub(super) fn least(&self) -> u32 {
        u32::try_from(self.least_cells.max(1)).unwrap_or(u32::MAX)
    }
}

/// A connected set of cells of one label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component {
    /// The label.
    pub label: u32,
    /// Position, from 0, among all components of this label in the order of their first cells, also those left out.
    pub number: usize,
    /// Number of cells.
    pub cells: usize,
    /// Number of sides of cells, or faces in space, that are not shared by two cells of the component.
    pub faces: usize,
    /// Those of them on the edge of the image.
    pub border_faces: usize,
    /// Least and greatest indices of the cells along each axis.
    pub(super) corners: [[usize; 3]; 2],
}

/// Components that were left out: small ones, and those beside the largest of their label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Their number.
    pub components: usize,
    /// Their cells.
    pub cells: usize,
}

/// The connected components of labelled cells.
#[derive(Debug, Clone)]
pub struct Components<const D: usize> {
    pub(super) size: [usize; 3],
    /// For every cell, the position of its component, or [`NONE`].
    pub(super) ids: Vec<u32>,
    pub(super) list: Vec<Component>,
    pub(super) dropped: Dropped,
}

impl<const D: usize> Components<D> {
    /// Finds the components, in the order of their first cells. `None` once `stop` returns true.
    ///
    /// Cost: five passes over the cells. Memory: 4 bytes per cell, and 17 per part of a component that begins apart from the
    /// others on a row, of which there are at most as many as cells.
    ///
    /// # Errors
    /// [`SegmentationError::Label`] for a wanted label without cells, [`SegmentationError::Photograph`],
    /// [`SegmentationError::Components`] for too many.
    pub fn find(
        labels: &Labels<'_, D>,
        selection: &Selection,
        stop: Stop<'_>,
    ) -> Result<Option<Self>, SegmentationError> {
        let wanted = Wanted::new(labels, selection)?;
        let Some(mut parts) = Parts::find(labels, &wanted, stop) else { return Ok(None) };
        let sizes = parts.sizes();
        if selection.refuses_photographs {
            let texture = parts.texture(&sizes);
            if texture.is_photograph() {
                return Err(SegmentationError::Photograph { texture });
            }
        }
        let kept = parts.kept(&sizes, selection);
        let found = kept.iter().filter(|kept| **kept).count();
        if found > selection.most_components {
            return Err(SegmentationError::Components { most: selection.most_components, found });
        }
        let (ids, list, dropped) = parts.number(labels, sizes, &kept);
        let mut found = Self { size: labels.size, ids, list, dropped };
        Ok(found.measure(labels, stop).then_some(found))
    }

    /// The components, in the order of their first cells.
    pub fn list(&self) -> &[Component] {
        &self.list
    }

    /// The components that were left out.
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Whether a cell belongs to a component; no cell beyond the edge does.
    pub(super) fn holds(&self, id: u32, cell: [isize; 3]) -> bool {
        self.id(cell) == id
    }

    /// The component of a cell, or [`NONE`].
    pub(super) fn id(&self, cell: [isize; 3]) -> u32 {
        let [columns, rows, _] = self.size;
        if !self.contains(cell) {
            return NONE;
        }
        let [i, j, k] = cell.map(|index| index as usize);
        self.ids[(k * rows + j) * columns + i]
    }

    /// Whether the image has a cell.
    pub(super) fn contains(&self, cell: [isize; 3]) -> bool {
        (0..3).all(|axis| (0..self.size[axis] as isize).contains(&cell[axis]))
    }

    /// Counts faces and finds the corners of all components. Returns false once `stop` returns true.
    pub(super) fn measure(&mut self, labels: &Labels<'_, D>, stop: Stop<'_>) -> bool {
        for at in 0..self.ids.len() {
            if at.is_multiple_of(self.size[0]) && stop() {
                return false;
            }
            let id = self.ids[at];
            if id == NONE {
                continue;
            }
            let (cell, component) = (labels.cell(at), &mut self.list[id as usize]);
            for (side, neighbour) in labels.neighbours(at).enumerate() {
                let counts = !(labels.open_ends && side / 2 == 2);
                component.border_faces += usize::from(neighbour.is_none() && counts);
                component.faces += usize::from(neighbour.is_none_or(|other| self.ids[other] != id));
            }
            let [lower, upper] = component.corners;
            component.corners = [
                std::array::from_fn(|axis| lower[axis].min(cell[axis])),
                std::array::from_fn(|axis| upper[axis].max(cell[axis])),
            ];
        }
        true
    }
}
