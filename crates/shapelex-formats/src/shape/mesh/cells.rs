//! Cells of VTK by their numbers. Polygons are kept, as are lines, which count if there are no polygons.

use super::super::limits::Room;
use super::super::record::{Domain, Faces};
use super::draft::Draft;
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Number of a cell of points.
pub(super) const POINTS: u32 = 2;
/// Number of a line of several points.
pub(super) const LINE: u32 = 4;
/// Number of a strip of triangles.
pub(super) const STRIP: u32 = 6;
/// Number of a polygon.
pub(super) const POLYGON: u32 = 7;

/// The cells of a file in the order of their data.
#[derive(Default)]
pub(super) struct Cells {
    /// Row of the data of each polygon.
    rows: Vec<usize>,
    /// Number of cells.
    count: usize,
}

impl Cells {
    /// Number of cells so far.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Adds cells, each of the kind that `kind` gives for its position.
    pub(super) fn add(
        &mut self,
        cells: &Faces,
        kind: impl Fn(usize) -> u32,
        draft: &mut Draft,
        summary: &mut Summary,
    ) {
        for (k, cell) in cells.iter().enumerate() {
            let row = self.count;
            self.count += 1;
            match (kind(k), cell) {
                (5 | POLYGON | 9, _) => {
                    draft.faces.push(cell.iter().copied());
                    self.rows.push(row);
                }
                (8, [a, b, c, d]) => {
                    draft.faces.push([*a, *b, *d, *c]);
                    self.rows.push(row);
                }
                (STRIP, _) => {
                    for (k, window) in cell.windows(3).enumerate() {
                        // Every other triangle of a strip is turned around.
                        let swap = usize::from(k % 2 == 1);
                        draft.faces.push([window[swap], window[1 - swap], window[2]]);
                        self.rows.push(row);
                    }
                }
                (3 | LINE, _) => draft.lines.push(cell.to_vec()),
                (1 | POINTS, _) => draft.point_cells += 1,
                (other, _) => {
                    let name = format!("type {other}");
                    summary.drop("cells that are no polygons", Some(&name), || Place::item(row as u64));
                }
            }
        }
    }

    /// Adds a field of the cells as one of the faces; without polygons it is left out. Each triangle of a strip has a copy of its
    /// row: values beyond those of the cells take room.
    pub(super) fn field(
        &self,
        name: &str,
        width: usize,
        values: &[f64],
        draft: &mut Draft,
        room: &Room,
    ) -> Result<(), FileError> {
        if self.rows.is_empty() && self.count > 0 {
            draft.lose("fields of cells without polygons", name);
        }
        if self.rows.is_empty() || !draft.keeps(name) {
            return Ok(());
        }
        let count = self.rows.len().saturating_mul(width);
        room.take(count.saturating_sub(values.len()), Place::default)?;
        let mut of_faces = Vec::with_capacity(count);
        for row in &self.rows {
            of_faces.extend_from_slice(&values[row * width..(row + 1) * width]);
        }
        draft.field(name, Domain::Faces, width, of_faces);
        Ok(())
    }
}

/// Lists of indices by their ends.
pub(super) fn by_ends(indices: &[u32], ends: &[u32], place: impl Fn() -> Place) -> Result<Faces, FileError> {
    let mut cells = Faces::default();
    let mut start = 0;
    for end in ends {
        let end = *end as usize;
        let cell = indices.get(start..end).ok_or_else(|| {
            let detail = format!("expected offsets from {start} to {}, got {end}", indices.len());
            FileError::malformed(place(), detail)
        })?;
        cells.push(cell.iter().copied());
        start = end;
    }
    if start < indices.len() {
        let detail = format!("expected {start} indices of points by the offsets, got {}", indices.len());
        return Err(FileError::malformed(place(), detail));
    }
    Ok(cells)
}
