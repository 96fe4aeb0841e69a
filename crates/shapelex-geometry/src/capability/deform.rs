//! Deformations: places of handles, the size of a change, and moved shapes of points and normals.

use super::domain::Domain;
use crate::deformation::{ControlPointMove, Handle, edit_faults};
use crate::field_fault::FieldFault;
use crate::representation::{Representation, ShapeSpace};
use crate::sampling::Places;
use crate::subdivision::normal_based::Oriented;
use crate::subdivision::oriented::OrientedMeshes;
use crate::vector::{minus, norm};
use shapelex_numeric::MAX_NUMBER;
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

/// A shape whose points and normals were moved.
#[derive(Debug, Clone, PartialEq)]
pub struct MovedOriented {
    /// Its points and normals.
    pub shape: Oriented,
    /// Largest displacement of a vertex at the level.
    pub largest_change: f64,
}

impl OrientedMeshes<'_> {
    /// Moves points, gives them new normals, then puts the points of handles in their positions. The scheme interpolates, so that every
    /// point is on the surface; handles on other vertices have no unique solution and are refused. Cost: two refinements.
    ///
    /// # Errors
    /// All moves and handles that do not fit, at `moves…` and `handles…`; edges that cannot be split afterwards, at `moves`.
    pub fn moved(
        &self,
        representation: &Representation,
        before: &Oriented,
        moves: &[ControlPointMove],
        handles: &[Handle],
    ) -> Result<MovedOriented, Vec<FieldFault>> {
        let mut faults = edit_faults(representation, &[], moves, handles);
        let (count, mut held) = (self.count(), vec![None; self.count()]);
        for (i, Handle { parameters, .. }) in handles.iter().enumerate() {
            let [vertex] = parameters[..] else { continue };
            let pointer = format!("handles/{i}/parameters/0");
            if vertex >= count as f64 {
                let detail = format!(
                    "expected a control point, from 0 to {}, got {vertex}: the scheme normal_based is not linear, and \
                     several changes would move another vertex there",
                    count - 1
                );
                faults.push(FieldFault::new(pointer, detail));
            } else if vertex >= 0.0
                && let Some(other) = held[vertex as usize].replace(i)
            {
                let detail =
                    format!("expected another control point than that of handle {other}, got {vertex}");
                faults.push(FieldFault::new(pointer, detail));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut shape = before.clone();
        for ControlPointMove { control_point, by, normal, .. } in moves {
            let point = &mut shape.points[*control_point];
            by.iter().zip(point).for_each(|(by, x)| *x += by);
            if let Some(normal) = normal {
                let length = norm(*normal);
                shape.normals[*control_point] = normal.map(|x| x / length);
            }
        }
        for Handle { parameters, position } in handles {
            let point = &mut shape.points[parameters[0] as usize];
            position.iter().zip(point).for_each(|(to, x)| *x = *to);
        }
        if shape.points.as_flattened().iter().any(|x| !(x.abs() <= MAX_NUMBER)) {
            let detail = format!("expected displacements that keep the shape within ±{MAX_NUMBER:e}");
            return Err(vec![FieldFault::new("moves", detail)]);
        }
        let refined = |shape: &Oriented, field: &str| {
            let mesh = self.refine(shape, None);
            mesh.map_err(|error| vec![FieldFault::new(field, error.to_string())])
        };
        let (old, new) = (refined(before, "shape")?, refined(&shape, "moves")?);
        let apart = old.vertices.iter().zip(&new.vertices).map(|(a, b)| norm(minus(*a, *b)));
        Ok(MovedOriented { largest_change: apart.fold(0.0, f64::max), shape })
    }
}
