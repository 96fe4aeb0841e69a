//! Shapes of points and normals on one control mesh, refined by the normal-based scheme; and the paths between them.

use std::f64::consts::PI;

use super::Subdivision;
use super::normal_based::{Oriented, corners, sphere_normals};
use super::refinement::{Depth, refine_mesh};
use crate::GeometryError;
use crate::capability::FieldFault;
use crate::deformation::{ControlPointMove, Handle, edit_faults};
use crate::mesh::{Connectivity, MeshError, TriangleMesh};
use crate::representation::Representation;
use crate::vector::{minus, norm};
use shapelex_numeric::MAX_NUMBER;

/// The shapes of one control mesh.
#[derive(Debug)]
pub struct OrientedMeshes<'a> {
    subdivision: &'a Subdivision,
    control: Connectivity,
}

impl<'a> OrientedMeshes<'a> {
    /// Prepares the shapes of a control mesh, whose scheme is the normal-based one.
    ///
    /// # Errors
    /// Faces that do not form a surface.
    pub fn new(subdivision: &'a Subdivision) -> Result<Self, MeshError> {
        Ok(Self { subdivision, control: subdivision.control()? })
    }

    /// Number of points.
    pub fn count(&self) -> usize {
        self.control.vertices()
    }

    /// Default normals of points: those of the spheres through their neighbours.
    pub fn usual_normals(&self, points: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let faces = self.control.faces().to_vec();
        sphere_normals(&TriangleMesh { vertices: points.to_vec(), normals: None, faces })
    }

    /// Mesh of a shape at its level, or at the finest one with at most `faces` faces; with the normals of the scheme.
    ///
    /// # Errors
    /// [`GeometryError::Edge`] for an edge that cannot be split.
    pub fn refine(&self, shape: &Oriented, faces: Option<usize>) -> Result<TriangleMesh, GeometryError> {
        let mesh = TriangleMesh {
            vertices: shape.points.clone(),
            normals: Some(shape.normals.clone()),
            faces: self.control.faces().to_vec(),
        };
        let (size, finest) = (self.subdivision.connectivity.size(), self.subdivision.level);
        let coarser = |most: usize| (0..=finest).rev().find(|level| size.split(*level).faces <= most);
        let level = faces.map_or(finest, |most| coarser(most).unwrap_or(0));
        let refined = refine_mesh(self.subdivision.scheme, mesh, Depth::Level(level), usize::MAX, false);
        refined.map(|(refined, _)| refined.shape)
    }
}

/// Warning of the corners that edges of a control mesh or polyline make: see [`corners`].
pub fn corner_warning(shape: &Oriented, edges: &[[usize; 2]], balance: f64) -> Option<String> {
    let (count, vertex, angle) = corners(shape, edges.iter().copied(), balance)?;
    let degrees = angle.to_degrees();
    Some(format!(
        "corners: {count} edges have a normal orthogonal to them at one end only, so that the limit has a corner at the other end, \
         first at point {vertex} with {degrees:.1} degrees; a balance above 0 rounds it off"
    ))
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

/// Distance in radians from opposite directions below which two unit normals define no great circle.
const OPPOSITE: f64 = 1e-9;

/// Why there is no shape between two others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BetweenFault {
    /// The normals of a point are opposite.
    #[error(
        "expected a normal that is not opposite to that of the other shape: no shortest path between opposite \
         normals is unique"
    )]
    Opposite,
    /// The interpolated normal of a point vanishes.
    #[error("the interpolated normal has no direction")]
    NoDirection,
}

/// Maximum deviation from 1 of the length of a normal that counts as a unit normal, written with few digits.
const UNIT: f64 = 1e-6;

impl Oriented {
    /// Points with normals as given, of any length, or else with those that `usual` makes of the points; and a caveat about
    /// given normals that were not of unit length.
    ///
    /// # Errors
    /// As many normals as there are points, at `normals`; normals without a direction, at `normals/{index}`.
    pub fn from_given(
        points: Vec<[f64; 3]>,
        given: Option<Vec<[f64; 3]>>,
        usual: impl FnOnce(&[[f64; 3]]) -> Vec<[f64; 3]>,
    ) -> Result<(Self, Option<String>), FieldFault> {
        let (is_given, count) = (given.is_some(), points.len());
        let normals = given.unwrap_or_else(|| usual(&points));
        if normals.len() != count {
            let detail = format!("expected {count} entries, one per point, got {}", normals.len());
            return Err(FieldFault::new("normals", detail));
        }
        let off = normals.iter().filter(|normal| (norm(**normal) - 1.0).abs() > UNIT).count();
        let shape = Self::new(points, &normals).map_err(|index| {
            let detail = if is_given {
                "expected a normal with a direction, got zero"
            } else {
                "required normal is missing: the neighbouring points define none"
            };
            FieldFault::new(format!("normals/{index}"), detail)
        })?;
        let caveat = || format!("{off} of {count} normals were not of unit length and were normalised");
        Ok((shape, (is_given && off > 0).then(caveat)))
    }

    /// The shape at `tau` between this one (0) and another one (1): points on straight lines, normals on great circles.
    ///
    /// # Errors
    /// The first point without a normal.
    pub fn between(&self, to: &Self, tau: f64) -> Result<Self, (usize, BetweenFault)> {
        let mix = |a: [f64; 3], b: [f64; 3], [p, q]: [f64; 2]| [0, 1, 2].map(|c| p * a[c] + q * b[c]);
        let places = self.points.iter().zip(&to.points);
        let points = places.map(|(a, b)| mix(*a, *b, [1.0 - tau, tau])).collect();
        let mut normals = Vec::with_capacity(self.normals.len());
        for (vertex, (a, b)) in self.normals.iter().zip(&to.normals).enumerate() {
            let angle = norm(minus(*a, *b)).atan2(norm(mix(*a, *b, [1.0, 1.0]))) * 2.0;
            if PI - angle < OPPOSITE {
                return Err((vertex, BetweenFault::Opposite));
            }
            let sine = angle.sin();
            let shares = if sine > 0.0 {
                [((1.0 - tau) * angle).sin() / sine, (tau * angle).sin() / sine]
            } else {
                [1.0 - tau, tau]
            };
            normals.push(mix(*a, *b, shares));
        }
        Self::new(points, &normals).map_err(|vertex| (vertex, BetweenFault::NoDirection))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn given_normals_are_normalised_and_missing_ones_named() {
        let points = vec![[0.0; 3], [1.0, 0.0, 0.0]];
        let unused = |_: &[[f64; 3]]| -> Vec<[f64; 3]> { unreachable!("normals are given") };
        let given = vec![[0.0, 0.0, 2.0], [0.0, 1.0, 0.0]];
        let (shape, caveat) = Oriented::from_given(points.clone(), Some(given), unused).unwrap();
        assert_eq!(shape.normals, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]);
        assert_eq!(caveat.as_deref(), Some("1 of 2 normals were not of unit length and were normalised"));
        let none = |points: &[[f64; 3]]| vec![[0.0; 3]; points.len()];
        assert_eq!(Oriented::from_given(points.clone(), None, none).unwrap_err().field, "normals/0");
        assert_eq!(Oriented::from_given(points, Some(Vec::new()), unused).unwrap_err().field, "normals");
    }
}
