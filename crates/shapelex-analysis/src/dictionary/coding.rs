//! Codes of shapes in a dictionary, and reconstructions from them.
//!
//! Shapes are prepared as in learning, then encoded in the components or sparse atoms.

use super::in_use::Dictionary;
use super::model::{Model, error_of};
use crate::AnalysisError;
use crate::metric::Metric;
use crate::preparation::Prepared;
use crate::sparse::SparseCode;
use crate::watch::Watch;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// Number of shapes encoded between two calls of the watch.
const TOGETHER: usize = 1024;

/// A shape with its code.
#[derive(Debug, Clone, PartialEq)]
pub struct CodedShape {
    /// The given shape, `d·N` coordinate-major control points.
    pub control_points: Vec<f64>,
    /// The prepared shape that is encoded.
    pub prepared: Prepared,
    /// Code of the shape.
    pub code: SparseCode,
}

/// Transformed atoms that approximate a shape: `r ≈ Σ_j B_j d_j + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Moves {
    /// Matrices `B_j`, `d × d`, one per atom in use.
    pub matrices: Vec<Matrix>,
    /// Offset `b`, of length `d`.
    pub offset: Vec<f64>,
}

/// Pose of reconstructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum AnswerPose {
    /// Pose of the shape.
    #[default]
    Input,
    /// Pose of the dictionary: aligned, normalised.
    Model,
}

/// A reconstructed shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// Control points, `d·N` coordinate-major numbers.
    pub control_points: Vec<f64>,
    /// Relative error `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary; only for shapes.
    pub relative_error: Option<f64>,
    /// Distances between shape and reconstruction at equally spaced parameters; only for shapes.
    pub residual: Vec<f64>,
}

impl Dictionary {
    /// Encodes shapes, given by `d·N` coordinate-major control points, one shape after the other.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] or [`AnalysisError::NoExtent`] with the position of the shape, before any shape is
    /// encoded; errors of the coder; [`AnalysisError::Interrupted`].
    pub fn encode(
        &self,
        control_points: &[f64],
        watch: &dyn Watch,
    ) -> Result<Vec<CodedShape>, AnalysisError> {
        let length = self.metric().len();
        let mut prepared = Vec::with_capacity(control_points.len() / length);
        for (part, shapes) in control_points.chunks(TOGETHER * length).enumerate() {
            watch.check()?;
            prepared.extend(self.preparation.prepare(shapes).map_err(|error| error.after(part * TOGETHER))?);
        }
        let mut coded = Vec::with_capacity(prepared.len());
        let mut prepared = prepared.into_iter();
        for (part, shapes) in control_points.chunks(TOGETHER * length).enumerate() {
            watch.check()?;
            let together: Vec<Prepared> = prepared.by_ref().take(shapes.len() / length).collect();
            let whitened: Vec<f64> =
                together.iter().flat_map(|shape| shape.whitened.iter().copied()).collect();
            let codes = self.model.codes(&whitened, length).map_err(|error| error.after(part * TOGETHER))?;
            let shapes = shapes.chunks_exact(length).zip(together).zip(codes);
            coded.extend(shapes.map(|((shape, prepared), code)| CodedShape {
                control_points: shape.to_vec(),
                prepared,
                code,
            }));
        }
        Ok(coded)
    }

    /// Transformations of the atoms in the pose of the shape; `None` unless codes are invariant.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 for a shape whose normal form cannot be inverted.
    pub fn moves(&self, coded: &CodedShape) -> Result<Option<Moves>, AnalysisError> {
        let Model::Sparse { algebra, .. } = &self.model else { return Ok(None) };
        if !self.is_invariant() {
            return Ok(None);
        }
        let (back, offset) = coded.prepared.back()?;
        let members = coded.code.values.chunks_exact(algebra.parameters());
        let matrices = members.map(|values| &back * algebra.member(values)).collect();
        Ok(Some(Moves { matrices, offset }))
    }

    /// Coefficients, one per atom in use; for invariant codes the norms `‖D_j B_jᵀ‖`, which do not depend on the pose.
    pub fn magnitudes(&self, coded: &CodedShape) -> Vec<f64> {
        match &self.model {
            Model::Sparse { algebra, .. } if self.is_invariant() => {
                let blocks = coded.code.values.chunks_exact(algebra.parameters());
                blocks.map(|block| block.iter().map(|value| value * value).sum::<f64>().sqrt()).collect()
            }
            _ => coded.code.values.clone(),
        }
    }

    /// Reconstructs an encoded shape of `space`, with the distances at `samples` parameters.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 for a shape that the alignment makes degenerate.
    pub fn reconstruct(
        &self,
        space: &ShapeSpace,
        coded: &CodedShape,
        pose: AnswerPose,
        samples: usize,
    ) -> Result<Reconstruction, AnalysisError> {
        let y = self.model.reconstruct(&coded.code);
        let relative_error = Some(error_of(&coded.prepared.whitened, &y));
        let [shape, answer] = self.posed(coded, y, pose)?;
        let residual = distances(space, self.metric(), &shape, &answer, samples);
        Ok(Reconstruction { control_points: answer, relative_error, residual })
    }

    /// An encoded shape and its reconstruction, in the requested pose: control points.
    ///
    /// # Errors
    /// As [`Self::reconstruct`].
    pub fn pair(&self, coded: &CodedShape, pose: AnswerPose) -> Result<[Vec<f64>; 2], AnalysisError> {
        self.posed(coded, self.model.reconstruct(&coded.code), pose)
    }

    /// A shape and its reconstruction `y`, both in the requested pose.
    fn posed(
        &self,
        coded: &CodedShape,
        y: Vec<f64>,
        pose: AnswerPose,
    ) -> Result<[Vec<f64>; 2], AnalysisError> {
        let mut shapes = [coded.prepared.whitened.clone(), y];
        shapes.iter_mut().for_each(|x| self.metric().unwhiten(x));
        if pose == AnswerPose::Input {
            let (matrix, offset) = coded.prepared.back()?;
            shapes.iter_mut().for_each(|x| transform(x, &matrix, &offset));
        }
        Ok(shapes)
    }

    /// The combination of atoms `Σ_j α_j d_j` with these coefficients, one per index, and of the centre if there is one:
    /// control points in the pose of the dictionary.
    pub fn combine(&self, indices: &[usize], values: &[f64]) -> Vec<f64> {
        let code = SparseCode {
            indices: indices.to_vec(),
            values: values.to_vec(),
            objective: 0.0,
            duality_gap: None,
            relative_error: 0.0,
        };
        let mut control_points = self.model.reconstruct(&code);
        self.metric().unwhiten(&mut control_points);
        control_points
    }

    /// The combination of transformed atoms `Σ_j B_j d_j + b`, with one `d × d` matrix per index: control points.
    pub fn combine_moved(&self, indices: &[usize], matrices: &[Matrix], offset: &[f64]) -> Vec<f64> {
        let metric = self.metric();
        let mut control_points = vec![0.0; metric.len()];
        for (&j, matrix) in indices.iter().zip(matrices) {
            let mut atom = self.atom(j);
            transform(&mut atom, matrix, &vec![0.0; matrix.nrows()]);
            control_points.iter_mut().zip(atom).for_each(|(sum, value)| *sum += value);
        }
        for (coordinate, b) in control_points.chunks_exact_mut(metric.size()).zip(offset) {
            coordinate.iter_mut().for_each(|value| *value += b);
        }
        control_points
    }
}

/// Transforms each point: `r ← M r + b`.
fn transform(control_points: &mut [f64], matrix: &Matrix, offset: &[f64]) {
    let d = offset.len();
    let n = control_points.len() / d;
    for k in 0..n {
        let point: Vec<f64> = (0..d).map(|c| control_points[c * n + k]).collect();
        for c in 0..d {
            control_points[c * n + k] = offset[c] + (0..d).map(|e| matrix[(c, e)] * point[e]).sum::<f64>();
        }
    }
}

/// Distances `|r(u_i) − s(u_i)|` at `u_i = i/samples` of closed curves and `i/(samples − 1)` of open ones; at every
/// point of landmarks, and at all knots of surfaces.
fn distances(space: &ShapeSpace, metric: &Metric, r: &[f64], s: &[f64], samples: usize) -> Vec<f64> {
    let difference = r.iter().zip(s).map(|(r, s)| r - s);
    let difference = Matrix::from_iterator(metric.size(), metric.dimension(), difference);
    if samples == 0 {
        return Vec::new();
    }
    let places = Places::along(space, samples);
    let points = places.points(space, &difference);
    let points = Matrix::from_vec(places.count(), metric.dimension(), points);
    points.row_iter().map(|row| row.norm()).collect()
}
