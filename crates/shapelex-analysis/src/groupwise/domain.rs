//! Functions on the parameter sphere: their values at nodes, and their coefficients in spherical harmonics.

use shapelex_geometry::reparametrisation::harmonics::{Table, count};
use shapelex_geometry::reparametrisation::nodes::{Nodes, Symmetry};
use shapelex_numeric::dense::{Matrix, multiply};

/// Divisions of the icosahedron: 642 nodes.
const DIVISIONS: usize = 3;
/// Highest degree of the harmonics in which shapes are compared: `121 − 1` functions.
const DEGREE: usize = 10;

/// The common parameter sphere.
#[derive(Debug)]
pub(super) struct Domain {
    /// Nodes with weights.
    pub nodes: Nodes,
    /// Rotations that permute the nodes.
    pub symmetries: Vec<Symmetry>,
    /// `B × Q`: coefficients `⟨Y_j, f⟩` of values at the nodes.
    analysis: Matrix,
}

impl Domain {
    /// Number of nodes, `Q`.
    pub(super) const NODES: usize = 10 * 4_usize.pow(DIVISIONS as u32) + 2;
    /// Number of harmonics, `B`.
    pub(super) const SIZE: usize = count(DEGREE);

    pub(super) fn new() -> Self {
        let nodes = Nodes::new(DIVISIONS);
        let mut table = Table::new(DEGREE);
        let mut analysis = Matrix::zeros(count(DEGREE), nodes.points.len());
        for (q, (x, weight)) in nodes.points.iter().zip(&nodes.weights).enumerate() {
            table.fill(*x);
            (0..table.len()).for_each(|j| analysis[(j, q)] = weight * table.value(j));
        }
        Self { symmetries: nodes.symmetries(), nodes, analysis }
    }

    /// Coefficients of functions (`Q × m` values), without their means: the constant harmonic is left out.
    pub(super) fn coefficients(&self, values: &mut Matrix) -> Matrix {
        for mut column in values.column_iter_mut() {
            let mean: f64 =
                column.iter().zip(&self.nodes.weights).map(|(value, weight)| value * weight).sum();
            column.add_scalar_mut(-mean);
        }
        multiply(&self.analysis, values)
    }
}
