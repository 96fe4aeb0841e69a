//! Grids and masks as they are given, and their checks.

use shapelex_numeric::MAX_NUMBER;

use crate::field_fault::FieldFault;
use crate::raster::{Grid, Mask};

/// Mask on a regular grid whose cells lie inside or outside of the body.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct MaskInput {
    /// Number of cells along the 2 or 3 axes.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub size: Vec<usize>,
    /// Distance between cell centres along each axis, in the unit of the coordinates.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub spacing: Vec<f64>,
    /// Position of the centre of the first cell.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub first: Vec<f64>,
    /// Run lengths of cells, the last axis varying fastest: outside, inside, outside, and so on; the first may be 0.
    pub runs: Vec<usize>,
}

impl MaskInput {
    /// The mask, of at most `most_cells` cells.
    ///
    /// # Errors
    /// All fields that are out of range or do not fit together.
    pub fn mask(&self, most_cells: usize) -> Result<Mask, Vec<FieldFault>> {
        let Self { size, spacing, first, .. } = self.clone();
        let grid = GridInput { size, spacing, first };
        let (mut faults, cells) = (grid.faults(most_cells), grid.cells());
        let covered = self.runs.iter().fold(0_usize, |sum, run| sum.saturating_add(*run));
        if covered != cells {
            let detail = format!("expected runs over all {cells} cells of the grid, got {covered}");
            faults.push(FieldFault::new("runs", detail));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let grid = grid.as_checked();
        let runs = self.runs.iter().enumerate();
        let inside = runs.flat_map(|(i, run)| std::iter::repeat_n(i % 2 == 1, *run)).collect();
        Ok(Mask { grid, inside })
    }
}

/// A regular grid in the plane or in space.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct GridInput {
    /// Number of cells along the 2 or 3 axes.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub size: Vec<usize>,
    /// Distance between cell centres along each axis, in the unit of the coordinates.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub spacing: Vec<f64>,
    /// Position of the centre of the first cell.
    #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 3))]
    pub first: Vec<f64>,
}

impl GridInput {
    /// The grid, of at most `most_cells` cells.
    ///
    /// # Errors
    /// All fields that are out of range or do not fit together.
    pub fn grid(&self, most_cells: usize) -> Result<Grid, Vec<FieldFault>> {
        let faults = self.faults(most_cells);
        if faults.is_empty() { Ok(self.as_checked()) } else { Err(faults) }
    }

    /// The grid of fields without faults; one in the plane has one layer.
    fn as_checked(&self) -> Grid {
        let axis = |list: &[f64], usual: f64| [0, 1, 2].map(|i| list.get(i).copied().unwrap_or(usual));
        Grid {
            first: axis(&self.first, 0.0),
            spacing: axis(&self.spacing, 1.0),
            size: [0, 1, 2].map(|i| self.size.get(i).copied().unwrap_or(1)),
        }
    }

    /// Number of cells; saturates.
    fn cells(&self) -> usize {
        self.size.iter().fold(1_usize, |product, size| product.saturating_mul(*size))
    }

    fn faults(&self, most_cells: usize) -> Vec<FieldFault> {
        let mut faults = Vec::new();
        let mut fault = |field: &str, detail: String| faults.push(FieldFault::new(field, detail));
        let dimension = self.size.len();
        if !(2..=3).contains(&dimension) {
            fault("size", format!("expected 2 or 3 entries, got {dimension}"));
        }
        for (list, field) in [(&self.spacing, "spacing"), (&self.first, "first")] {
            if list.len() != dimension {
                fault(field, format!("expected {dimension} entries, one per axis, got {}", list.len()));
            } else if !list.iter().all(|value| value.abs() <= MAX_NUMBER) {
                fault(field, format!("expected numbers within ±{MAX_NUMBER:e}"));
            }
        }
        if !self.spacing.iter().all(|spacing| *spacing > 0.0) {
            fault("spacing", "expected positive numbers".into());
        }
        let cells = self.cells();
        if !(1..=most_cells).contains(&cells) {
            fault("size", format!("expected between 1 and {most_cells} cells, got {cells}"));
        }
        faults
    }
}
