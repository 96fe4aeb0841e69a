//! Deformations: places of handles, and the size of a change.

use super::FieldFault;
use super::domain::Domain;
use crate::representation::{Representation, ShapeSpace};
use crate::sampling::Places;
use shapelex_numeric::dense::Matrix;

impl Representation {
    /// Faults of the parameters of a handle: outside of the domain (at their index), or not as many as it needs.
    pub fn handle_faults(&self, parameters: &[f64]) -> Vec<FieldFault> {
        let domain = self.domain();
        match (domain, parameters) {
            (Domain::Sheet { .. }, [u, v]) => {
                let faults = domain.pair_faults(&[[*u, *v]]).into_iter();
                let direction = |field: &str| field.strip_prefix("0/").unwrap_or_default().to_owned();
                faults.map(|fault| FieldFault { field: direction(&fault.field), ..fault }).collect()
            }
            (Domain::Vertices, [vertex]) => {
                let count = self.refined_vertices();
                if vertex.fract() == 0.0 && (0.0..count as f64).contains(vertex) {
                    return Vec::new();
                }
                let detail = format!("expected a vertex of the level, from 0 to {}, got {vertex}", count - 1);
                vec![FieldFault::new("0", detail)]
            }
            (Domain::Line { .. } | Domain::Points, [u]) => {
                domain.line_fault(*u).map(|detail| FieldFault::new("", detail)).into_iter().collect()
            }
            _ => {
                let wanted = match domain {
                    Domain::Sheet { .. } => "u and v",
                    Domain::Vertices => "the number of a vertex",
                    Domain::Line { .. } | Domain::Points => "u",
                };
                let detail = format!("expected {wanted}, got {} entries", parameters.len());
                vec![FieldFault::new("", detail)]
            }
        }
    }
}

impl ShapeSpace {
    /// Largest length of a change (`N × d`) of control points at the knots.
    pub fn largest_change(&self, change: &Matrix) -> f64 {
        let places = Places::along(self, self.representation().point_count());
        let points = Matrix::from_vec(places.count(), change.ncols(), places.points(self, change));
        points.row_iter().map(|row| row.norm()).fold(0.0, f64::max)
    }
}
