//! Deformation of a shape by moved control points, or by the smallest change that satisfies handles.
//!
//! ```text
//! min ⟨δ, δ⟩ = tr(δᵀ Φ δ)   subject to   B (c + δ) = p:     δ = Φ⁻¹Bᵀ (B Φ⁻¹ Bᵀ)⁻¹ (p − B c)
//! ```
//!
//! The rows of `B` are the weights of the control points at the parameters of the handles, and `p` are the target positions.
//! Shapes of several resolutions are moved by control points of their blocks as well; handles move their coarse control points.
//! The change is the smallest one in `L₂`; it decays away from the handles as `Φ⁻¹` does.

use super::GeometryError;
use super::field_fault::FieldFault;
use super::influence::{support, weights};
use super::representation::{Representation, ShapeSpace};
use super::resolution::{Block, Detailed, Resolutions};
use super::vector::norm;
use shapelex_numeric::MAX_NUMBER;
use shapelex_numeric::dense::{Definite, Matrix};

/// Displacement of a control point.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ControlPointMove {
    /// Index of the control point, from 0, in the order of responses.
    pub control_point: usize,
    /// Displacement vector, in the unit of the points.
    pub by: Vec<f64>,
    /// Index of the block, from 0, of a shape of several resolutions whose control point it is: `control_point` is then one of its
    /// `indices`. Default: a control point of the coarse grid.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(nullable = false))]
    pub block: Option<usize>,
    /// New normal at the control point, of any length. For the subdivision scheme `normal_based` only. Default: the normal stays.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(nullable = false))]
    pub normal: Option<[f64; 3]>,
}

/// Handle: a point of a shape with its target position.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Handle {
    /// Parameters of the point: `u` on curves, `u` and `v` on surfaces, the index of a vertex at the level on subdivision surfaces.
    pub parameters: Vec<f64>,
    /// Target position of the point.
    pub position: Vec<f64>,
}

/// Result of a deformation.
#[derive(Debug)]
pub struct Deformation {
    /// The deformed shape.
    pub shape: Detailed,
    /// Support of each moved control point.
    pub supports: Vec<Support>,
    /// `L₂` norm of the change.
    pub l2_change: f64,
    /// Largest change at the knots.
    pub largest_change: f64,
}

/// Part of a shape that a control point affects.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Support {
    /// Index of the control point, from 0.
    pub control_point: usize,
    /// Interval `[from, to]` for every direction; `to` exceeds 1 where it extends past the end of a closed direction.
    /// Empty for subdivision surfaces, which have no parameters.
    pub parameters: Vec<[f64; 2]>,
}

/// Moves and handles that fit shapes with some blocks.
#[derive(Debug)]
pub struct Edit<'a> {
    grids: &'a Resolutions,
    moves: &'a [ControlPointMove],
    handles: &'a [Handle],
}

impl<'a> Edit<'a> {
    /// Checks moves and handles of a shape with these `blocks`, whose grids are `grids`.
    ///
    /// # Errors
    /// All that do not fit; neither moves nor handles.
    pub fn new(
        grids: &'a Resolutions,
        blocks: &[Block],
        moves: &'a [ControlPointMove],
        handles: &'a [Handle],
    ) -> Result<Self, Vec<FieldFault>> {
        let faults = edit_faults(grids.coarse().representation(), blocks, moves, handles);
        if faults.is_empty() { Ok(Self { grids, moves, handles }) } else { Err(faults) }
    }

    /// Moves control points of a shape, then applies the smallest change in `L₂` of the coarse control points with which it meets the
    /// handles.
    ///
    /// # Errors
    /// Handles that contradict one another, or that take the shape out of range.
    pub fn apply(&self, before: &Detailed) -> Result<Detailed, FieldFault> {
        let mut after = before.clone();
        for ControlPointMove { control_point, by, block, .. } in self.moves {
            let (rows, row) = match block.and_then(|block| after.blocks.get_mut(block)) {
                Some(Block { indices, offsets, .. }) => (offsets, indices.binary_search(control_point).ok()),
                None => (&mut after.control_points, Some(*control_point)),
            };
            let Some(row) = row else { continue };
            by.iter().enumerate().for_each(|(c, by)| rows[(row, c)] += by);
        }
        if !self.handles.is_empty() {
            let handles = self.below_details(&after.blocks);
            after.control_points += meet(self.grids.coarse(), &after.control_points, &handles)
                .map_err(|error| FieldFault::new("handles", error.to_string()))?;
        }
        let offsets = after.blocks.iter().flat_map(|block| block.offsets.iter());
        if !after.control_points.iter().chain(offsets).all(|value| value.abs() <= MAX_NUMBER) {
            let detail = format!("expected positions that keep the shape within ±{MAX_NUMBER:e}");
            return Err(FieldFault::new("handles", detail));
        }
        Ok(after)
    }

    /// The handles with the positions that the coarse shape has to meet, to which blocks add their details.
    fn below_details(&self, blocks: &[Block]) -> Vec<Handle> {
        let below = |handle: &Handle| {
            let details = self.grids.detail_at(blocks, &handle.parameters);
            let position = handle.position.iter().zip(details).map(|(position, detail)| position - detail);
            Handle { position: position.collect(), parameters: handle.parameters.clone() }
        };
        self.handles.iter().map(below).collect()
    }

    /// Changes by the edit: `after` is the result of [`Self::apply`].
    pub fn described(&self, before: &Detailed, after: Detailed) -> Deformation {
        let space = self.grids.finest().space();
        let change = self.grids.flatten(&after) - self.grids.flatten(before);
        let support = |moved: &ControlPointMove| Support {
            control_point: moved.control_point,
            parameters: match moved.block.and_then(|block| before.blocks.get(block)) {
                Some(block) => self.grids.grid_of(block).support(moved.control_point),
                None => support(self.grids.coarse(), moved.control_point),
            },
        };
        Deformation {
            supports: self.moves.iter().map(support).collect(),
            l2_change: space.norm(&change),
            largest_change: space.largest_change(&change),
            shape: after,
        }
    }
}

pub(crate) fn edit_faults(
    representation: &Representation,
    blocks: &[Block],
    moves: &[ControlPointMove],
    handles: &[Handle],
) -> Vec<FieldFault> {
    let (size, dimension) = (representation.size(), representation.dimension());
    let mut faults = Vec::new();
    if moves.is_empty() && handles.is_empty() {
        faults.push(FieldFault::new("", "expected moves or handles, got neither"));
    }
    let position = |values: &[f64], field: String| {
        let wrong = values.len() != dimension || !values.iter().all(|value| value.abs() <= MAX_NUMBER);
        let detail = format!("expected {dimension} coordinates within ±{MAX_NUMBER:e}");
        wrong.then(|| FieldFault::new(field, detail))
    };
    for (i, moved) in moves.iter().enumerate() {
        faults.extend(position(&moved.by, format!("moves/{i}/by")));
        faults.extend(
            normal_fault(representation, moved.normal).map(|fault| fault.below(&format!("moves/{i}"))),
        );
        faults.extend(place_fault(size, blocks, moved).map(|fault| fault.below(&format!("moves/{i}"))));
    }
    for (i, Handle { parameters, position: to }) in handles.iter().enumerate() {
        faults.extend(position(to, format!("handles/{i}/position")));
        let found = representation.handle_faults(parameters).into_iter();
        faults.extend(found.map(|fault| fault.below(&format!("handles/{i}/parameters"))));
    }
    faults
}

/// Fault of the place of a move: a control point of the coarse grid of `size`, or of a block.
fn place_fault(size: usize, blocks: &[Block], moved: &ControlPointMove) -> Option<FieldFault> {
    let point = moved.control_point;
    let Some(index) = moved.block else {
        let detail = format!("expected a control point from 0 and below {size}, got {point}");
        return (point >= size).then(|| FieldFault::new("control_point", detail));
    };
    let Some(block) = blocks.get(index) else {
        let detail = match blocks.len() {
            0 => format!("expected none, because the shape has no blocks, got {index}"),
            count => format!("expected a block from 0 and below {count}, got {index}"),
        };
        return Some(FieldFault::new("block", detail));
    };
    let detail = format!("expected one of the indices of block {index}, got {point}");
    block.indices.binary_search(&point).is_err().then(|| FieldFault::new("control_point", detail))
}

/// Fault of a new normal of a control point.
fn normal_fault(representation: &Representation, normal: Option<[f64; 3]>) -> Option<FieldFault> {
    let length = norm(normal?);
    let detail = if representation.is_linear() {
        "expected none: normals belong to the subdivision scheme normal_based".to_owned()
    } else if length > 0.0 && length.is_finite() {
        return None;
    } else {
        format!("expected a normal with a direction, got length {length}")
    };
    Some(FieldFault::new("normal", detail))
}

/// Relative distance, in terms of the influence of the control points, below which two handles are not independent.
const APART: f64 = 1e-9;

/// The change `δ` (`N × d`) of `control_points` that satisfies `handles`. Cost: a solve with `Φ` per handle, and `k³/3`.
///
/// # Errors
/// [`GeometryError::Handles`] for handles at the same place.
pub fn meet(
    space: &ShapeSpace,
    control_points: &Matrix,
    handles: &[Handle],
) -> Result<Matrix, GeometryError> {
    let (size, dimension, count) = (control_points.nrows(), control_points.ncols(), handles.len());
    let mut transposed = Matrix::zeros(size, count);
    for (j, handle) in handles.iter().enumerate() {
        weights(space, &handle.parameters).into_iter().for_each(|(i, weight)| transposed[(i, j)] += weight);
    }
    let missing = Matrix::from_fn(count, dimension, |j, c| {
        handles[j].position[c] - transposed.column(j).dot(&control_points.column(c))
    });
    let mut influence = transposed.clone();
    space.gram().solve(influence.as_mut_slice());
    let coupling = transposed.transpose() * &influence;
    let coupling = Definite::new(&coupling).ok().filter(|coupling| coupling.independence() > APART);
    let coupling = coupling.ok_or(GeometryError::Handles { count })?;
    Ok(influence * coupling.solve(&missing))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;
    use crate::surface::Topology;
    use crate::surface::seam::Seam;

    fn closed(control_points: usize) -> ShapeSpace {
        let generator = GeneratorKind::Bspline { degree: 3 };
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points, generator }).unwrap()
    }

    /// Among all changes that satisfy the handles, this one is the smallest in `L₂`.
    #[test]
    fn the_change_meets_its_handles_and_is_the_smallest() {
        let space = closed(9);
        let shape = Matrix::from_fn(9, 2, |k, c| ((k * (c + 2)) as f64).sin());
        let handle = |u: f64, position: [f64; 2]| Handle { parameters: vec![u], position: position.into() };
        let handles = [handle(0.3, [1.0, 2.0]), handle(0.95, [-1.0, 0.5])];
        let change = meet(&space, &shape, &handles).unwrap();
        let at = |shape: &Matrix, u: f64, c: usize| -> f64 {
            weights(&space, &[u]).iter().map(|(i, weight)| weight * shape[(*i, c)]).sum()
        };
        for handle in &handles {
            for c in 0..2 {
                let met = at(&(&shape + &change), handle.parameters[0], c);
                assert!((met - handle.position[c]).abs() < 1e-13, "{met}");
            }
        }
        // Orthogonal to every change that vanishes at the handles: any change minus the one that matches its values there.
        let other = Matrix::from_fn(9, 2, |k, c| (k as f64 + 0.3 * c as f64).cos());
        let still: Vec<Handle> = handles
            .iter()
            .map(|handle| {
                let u = handle.parameters[0];
                Handle { position: (0..2).map(|c| at(&other, u, c)).collect(), ..handle.clone() }
            })
            .collect();
        let free = &other - meet(&space, &Matrix::zeros(9, 2), &still).unwrap();
        let mut image = free.clone();
        space.gram().apply(image.as_mut_slice());
        assert!(change.dot(&image).abs() < 1e-13 * change.norm() * image.norm(), "{}", change.dot(&image));
        let twice = [handle(0.3, [0.0; 2]), handle(0.3, [1.0; 2])];
        assert_eq!(meet(&space, &shape, &twice), Err(GeometryError::Handles { count: 2 }));
    }

    #[test]
    fn moves_come_before_handles_and_faults_name_their_fields() {
        let space = closed(9);
        let shape = Matrix::from_fn(9, 2, |k, c| ((k * (c + 2)) as f64).sin());
        let moves = [ControlPointMove { control_point: 4, by: vec![0.5, 0.0], block: None, normal: None }];
        let handles = [Handle { parameters: vec![0.5], position: vec![1.0, 2.0] }];
        let grids = Resolutions::uniform(&space);
        let edit = Edit::new(&grids, &[], &moves, &handles).unwrap();
        let shape = Detailed { control_points: shape, blocks: Vec::new() };
        let after = edit.apply(&shape).unwrap();
        let met: f64 =
            weights(&space, &[0.5]).iter().map(|(i, weight)| weight * after.control_points[(*i, 1)]).sum();
        assert!((met - 2.0).abs() < 1e-13, "{met}");
        let found = edit.described(&shape, after);
        assert!(found.l2_change > 0.0 && found.supports[0].control_point == 4, "{found:?}");
        let moves = [ControlPointMove { control_point: 9, by: vec![1.0], block: None, normal: None }];
        let handles = [Handle { parameters: vec![0.5, 0.5], position: vec![1.0, f64::NAN] }];
        let faults = Edit::new(&grids, &[], &moves, &handles).unwrap_err();
        let fields: Vec<&str> = faults.iter().map(|fault| &*fault.field).collect();
        let wanted = ["moves/0/by", "moves/0/control_point", "handles/0/position", "handles/0/parameters"];
        assert_eq!(fields, wanted);
    }

    #[test]
    fn the_support_of_a_control_point_goes_over_the_end() {
        // The cubic B-spline extends two knots to each side.
        assert_eq!(support(&closed(10), 5), [[0.3, 0.7]]);
        assert_eq!(support(&closed(10), 1), [[0.9, 1.3]]);
        assert_eq!(support(&closed(4), 0), [[0.0, 1.0]]);
        let generators = [GeneratorKind::Trigonometric {}, GeneratorKind::Trigonometric {}];
        let (topology, seam) = (Topology::Sphere, Seam::Straight);
        let sphere = Representation::Surface { topology, seam, control_points: [8, 5], generators };
        let sphere = ShapeSpace::new(&sphere).unwrap();
        // The north pole moves its surroundings in all directions, and nothing else.
        assert_eq!(support(&sphere, 8 * 4), [[0.0, 1.0], [0.0, 0.4]]);
    }
}
