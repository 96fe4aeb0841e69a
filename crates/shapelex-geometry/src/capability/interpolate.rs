//! Interpolation: grids of points that determine a surface.

use super::domain::Domain;
use crate::field_fault::FieldFault;
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Maximum distance between the points of a pole, relative to the extent of the shape; they may differ by rounding to
/// decimal digits.
const SAME_POLE: f64 = 1e-9;

impl ShapeSpace {
    /// Why `count` points, in a `grid` `[u][v]` or a list, are not the grid of points of a shape; `None` if they are, and for
    /// shapes without two parameters.
    pub fn grid_fault(&self, grid: Option<[usize; 2]>, count: usize) -> Option<String> {
        let Domain::Sheet { extent, .. } = self.domain() else { return None };
        let wanted = extent.grid();
        if grid == Some(wanted) {
            return None;
        }
        let found = match grid {
            Some([u, v]) => format!("a grid of {u} × {v} points"),
            None => format!("a list of {count} points, not a grid [u][v]"),
        };
        let (name, [u, v]) = (extent.topology.name(), wanted);
        Some(format!("expected a grid of {u} × {v} points for a {name} of this size, got {found}"))
    }

    /// Points of the poles that do not coincide, at `{row}/{column}` of a grid of points that fits: the first one at each
    /// pole. None for shapes without poles.
    pub fn open_poles(&self, points: &Matrix) -> Vec<FieldFault> {
        let Domain::Sheet { extent, .. } = self.domain() else { return Vec::new() };
        if !self.has_poles() {
            return Vec::new();
        }
        let [rows, columns] = extent.grid();
        let size = points.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
        let mut faults = Vec::new();
        for (column, name) in [(0, "north"), (columns - 1, "south")] {
            let apart = |k: usize| (points.row(k * columns + column) - points.row(column)).norm();
            let wrong = (0..rows).find(|&k| apart(k) > SAME_POLE * size);
            faults.extend(wrong.map(|k| {
                let detail = format!(
                    "expected the {name} pole at /points/0/{column}, got a point that is {:.1e} away: all \
                     meridians of a sphere start and end in the same points",
                    apart(k)
                );
                FieldFault::new(format!("{k}/{column}"), detail)
            }));
        }
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;
    use crate::surface::Topology;
    use crate::surface::seam::Seam;

    fn sphere() -> ShapeSpace {
        let generators = [GeneratorKind::Trigonometric {}, GeneratorKind::Trigonometric {}];
        let control_points = [8, 5];
        let (topology, seam) = (Topology::Sphere, Seam::Straight);
        ShapeSpace::new(&Representation::Surface { topology, seam, control_points, generators }).unwrap()
    }

    #[test]
    fn the_points_of_a_pole_coincide_up_to_rounding() {
        let (space, columns) = (sphere(), 6);
        let round = |k: usize, c: usize| {
            let (u, v) = ((k / columns) as f64 / 8.0, (k % columns) as f64 / 5.0);
            let (longitude, colatitude) = (std::f64::consts::TAU * u, std::f64::consts::PI * v);
            [longitude.cos() * colatitude.sin(), longitude.sin() * colatitude.sin(), colatitude.cos()][c]
        };
        let mut points = Matrix::from_fn(48, 3, round);
        assert!(space.open_poles(&points).is_empty(), "{:?}", space.open_poles(&points));
        points[(2 * columns, 0)] += 1e-11;
        assert!(space.open_poles(&points).is_empty(), "{:?}", space.open_poles(&points));
        points[(3 * columns + 5, 1)] += 0.25;
        let faults = space.open_poles(&points);
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert_eq!(faults[0].field, "3/5");
        assert!(faults[0].detail.contains("2.5e-1"), "{}", faults[0].detail);
    }

    #[test]
    fn only_the_grid_of_the_surface_fits() {
        let space = sphere();
        assert_eq!(space.grid_fault(Some([8, 6]), 48), None);
        for (grid, found) in [(Some([8, 5]), "got a grid of 8 × 5 points"), (None, "got a list of 48 points")]
        {
            let detail = space.grid_fault(grid, 48).unwrap();
            assert!(detail.contains(found), "{detail}");
        }
    }
}
