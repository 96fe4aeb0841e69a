//! The surfaces of one control mesh under a linear scheme, as a shape space with its Gram operator.
//!
//! ```text
//! X = T_K C,   ⟨C, D⟩ = tr(Cᵀ Φ D),   Φ = T_Kᵀ M T_K,   M = Σ_f 1/(12F) (2 1 1; 1 2 1; 1 1 2)
//! ```
//!
//! Every face at the level has the same share `1/F` of the parameter domain, whatever its area. `Φ` is therefore the same for all
//! shapes, and the product is exactly the `L₂` product of two meshes as piecewise linear functions. `1ᵀΦ1 = 1`.
//!
//! Source: Badoual, Novara, Romani, Schmitter, Unser, *A non-stationary subdivision scheme*, the operator view of section 4.

use std::sync::{Arc, OnceLock};

use super::control::{ControlMesh, StartMesh};
use super::limit::{Limit, limit};
use super::stencil::{check_valences, step};
use super::{Scheme, Subdivision};
use crate::GeometryError;
use crate::generator::Exact;
use crate::mesh::{Connectivity, TriangleMesh};
use shapelex_numeric::dense::{DenseOperator, Matrix, Square, fill_upper};
use shapelex_numeric::operator::SymmetricOperator;
use shapelex_numeric::sparse::SparseRows;

/// A prepared control mesh with its refinement steps.
#[derive(Debug)]
pub struct SubdivisionBasis {
    scheme: Scheme,
    /// Connectivity of all levels, from the control mesh on.
    levels: Vec<Connectivity>,
    steps: Vec<SparseRows>,
    /// Level parameter `v` of the step after the last one.
    parameter: f64,
    gram: Arc<DenseOperator>,
    /// Operator from control vertices to their positions at the level.
    at_vertices: OnceLock<Option<Square>>,
}

impl Subdivision {
    /// The same surfaces with the control mesh after one step, one level less and the next parameter of the scheme, and the map from
    /// the control points of this mesh to those of the finer one. One split halves the `λ` of BLOB. `None` at level 0.
    ///
    /// # Errors
    /// As for [`steps`]; a control mesh that is not closed.
    pub fn finer(&self) -> Result<Option<(Self, SparseRows)>, GeometryError> {
        let Self { scheme, level, connectivity } = self;
        let Some(level) = level.checked_sub(1) else { return Ok(None) };
        let (mut step, mut levels, parameter) = steps(*scheme, &connectivity.connectivity()?, 1)?;
        let (Some(step), Some(finer)) = (step.pop(), levels.pop()) else { return Ok(None) };
        let connectivity = match connectivity {
            ControlMesh::Named(start) => ControlMesh::Named(StartMesh { splits: start.splits + 1, ..*start }),
            ControlMesh::Faces(_) => ControlMesh::Faces(finer.faces().to_vec()),
        };
        Ok(Some((Self { scheme: scheme.next(parameter), level, connectivity }, step)))
    }
}

/// The matrices `S_0 … S_{K−1}` of `level` steps, the meshes between them, and the parameter of the next step. Cost: some
/// hundred operations per vertex of all levels.
///
/// # Errors
/// [`GeometryError::Valence`]; [`GeometryError::NotLinear`] for the normal-based scheme, which has no matrices.
pub fn steps(
    scheme: Scheme,
    control: &Connectivity,
    level: usize,
) -> Result<(Vec<SparseRows>, Vec<Connectivity>, f64), GeometryError> {
    if matches!(scheme, Scheme::NormalBased { .. }) {
        return Err(GeometryError::NotLinear);
    }
    check_valences(scheme, control)?;
    let (mut steps, mut levels) = (Vec::with_capacity(level), vec![control.clone()]);
    let mut parameters = scheme.parameters();
    for v in parameters.by_ref().take(level) {
        let coarse = &levels[levels.len() - 1];
        steps.push(step(scheme, v, coarse));
        levels.push(coarse.split());
    }
    Ok((steps, levels, parameters.next().unwrap_or(1.0)))
}

impl SubdivisionBasis {
    /// Prepares the control mesh. Cost: the steps, and `729` products per vertex of the level for the Gram operator.
    ///
    /// # Errors
    /// As for [`steps`]; faces that do not form a mesh for which the scheme has rules; control vertices that are linearly
    /// dependent at this level.
    pub fn new(subdivision: &Subdivision) -> Result<Self, GeometryError> {
        let scheme = subdivision.scheme;
        let control = subdivision.control()?;
        let (steps, levels, parameter) = steps(scheme, &control, subdivision.level)?;
        let gram = gram(&steps, &levels[levels.len() - 1], control.vertices());
        let gram = Arc::new(DenseOperator::new(gram)?);
        Ok(Self { scheme, levels, steps, parameter, gram, at_vertices: OnceLock::new() })
    }

    /// The Gram operator `Φ`, `N × N`.
    pub fn gram(&self) -> &Arc<DenseOperator> {
        &self.gram
    }

    /// The control mesh.
    pub fn control(&self) -> &Connectivity {
        &self.levels[0]
    }

    /// The level, `K`.
    pub fn level(&self) -> usize {
        self.steps.len()
    }

    /// Connectivity of the mesh at the level.
    pub fn finest(&self) -> &Connectivity {
        &self.levels[self.levels.len() - 1]
    }

    /// Positions `T_K C` of the vertices at the level, for control vertices `N × 3`.
    pub fn points(&self, rows: &Matrix) -> Vec<[f64; 3]> {
        self.points_of_levels(rows).pop().unwrap_or_default()
    }

    /// Positions of the vertices at every level, beginning with the control vertices.
    pub fn points_of_levels(&self, rows: &Matrix) -> Vec<Vec<[f64; 3]>> {
        let control = (0..rows.nrows()).map(|i| [0, 1, 2].map(|c| rows[(i, c)])).collect();
        let mut levels: Vec<Vec<[f64; 3]>> = vec![control];
        for step in &self.steps {
            let next = step.apply(&levels[levels.len() - 1]);
            levels.push(next);
        }
        levels
    }

    /// The mesh at the level.
    pub fn mesh(&self, rows: &Matrix) -> TriangleMesh {
        TriangleMesh { vertices: self.points(rows), normals: None, faces: self.finest().faces().to_vec() }
    }

    /// Limit positions and normals of the vertices at the level: see [`limit`].
    pub fn limit(&self, rows: &Matrix) -> Limit {
        limit(self.scheme, self.parameter, self.finest(), &self.points(rows))
    }

    /// `T_K`, one row per vertex of the level.
    pub fn operator(&self) -> SparseRows {
        operator(&self.steps, self.control().vertices())
    }

    /// The control vertices with an influence on a vertex of the level, with their weights: its row of `T_K`.
    pub fn weights(&self, vertex: u32) -> Vec<(usize, f64)> {
        let mut weights = vec![(vertex, 1.0)];
        for step in self.steps.iter().rev() {
            let mut coarser = SparseRows::new(step.columns(), 1, 0);
            let parts: Vec<(u32, f64)> = weights
                .iter()
                .flat_map(|(row, weight)| {
                    step.row(*row as usize).iter().map(move |(i, part)| (*i, weight * part))
                })
                .collect();
            coarser.push(&parts);
            weights = coarser.row(0).to_vec();
        }
        weights.into_iter().map(|(i, weight)| (i as usize, weight)).collect()
    }

    /// Interpolation: control vertices of the surface whose control vertices are at `points` at the level. Cost: `N³/3` for the
    /// first surface, `N²` for each further one.
    ///
    /// # Errors
    /// [`GeometryError::NoInterpolation`] if the positions do not determine the control vertices.
    pub fn interpolate(&self, points: &Matrix) -> Result<Matrix, GeometryError> {
        let size = self.control().vertices();
        let factor = self.at_vertices.get_or_init(|| {
            let mut matrix = Matrix::zeros(size, size);
            for i in 0..size {
                self.weights(i as u32).into_iter().for_each(|(j, weight)| matrix[(i, j)] += weight);
            }
            Square::new(&matrix)
        });
        factor.as_ref().map(|factor| factor.solve(points)).ok_or(GeometryError::NoInterpolation { size })
    }

    /// The rows of `T_K` for the control vertices, which give their positions at the level.
    pub fn at_control_vertices(&self) -> SparseRows {
        let size = self.control().vertices();
        let mut rows = SparseRows::new(size, size, 16 * size);
        for vertex in 0..size as u32 {
            let weights: Vec<(u32, f64)> =
                self.weights(vertex).into_iter().map(|(i, weight)| (i as u32, weight)).collect();
            rows.push(&weights);
        }
        rows
    }

    /// The finest level with at most `faces` faces, or else the control mesh.
    pub fn level_with(&self, faces: usize) -> usize {
        self.levels.iter().rposition(|level| level.faces().len() <= faces).unwrap_or(0)
    }

    /// The mesh of a level, with its vertices at their positions at the last level.
    pub fn drawn(&self, rows: &Matrix, level: usize) -> TriangleMesh {
        let connectivity = &self.levels[level];
        let mut vertices = self.points(rows);
        vertices.truncate(connectivity.vertices());
        TriangleMesh { vertices, normals: None, faces: connectivity.faces().to_vec() }
    }

    /// The vertices of a level as points on the flat faces of the control mesh: barycentric weights of at most three corners.
    pub fn flat(&self, level: usize) -> SparseRows {
        let middles = Scheme::NormalBased { balance: Exact::new(0.0) };
        let halves: Vec<SparseRows> =
            self.levels[..level].iter().map(|connectivity| step(middles, 1.0, connectivity)).collect();
        operator(&halves, self.control().vertices())
    }

    /// Approximate size of the basis in bytes.
    pub fn bytes(&self) -> usize {
        let entries: usize = self.steps.iter().map(SparseRows::len).sum();
        16 * entries + 200 * self.finest().vertices() + 16 * self.gram.size().pow(2)
    }
}

/// The product of the steps on `size` control vertices.
fn operator(steps: &[SparseRows], size: usize) -> SparseRows {
    let mut identity = SparseRows::new(size, size, size);
    (0..size as u32).for_each(|i| identity.push(&[(i, 1.0)]));
    steps.iter().fold(identity, |product, step| step.multiply(&product))
}

/// Gram matrix `Φ`. A face with corners `a`, `b`, `c` and `s = T_a + T_b + T_c` contributes
/// `(s sᵀ + T_a T_aᵀ + T_b T_bᵀ + T_c T_cᵀ)/(12F)`.
fn gram(steps: &[SparseRows], finest: &Connectivity, size: usize) -> Matrix {
    let operator = operator(steps, size);
    let mut gram = Matrix::zeros(size, size);
    let mut add_square = |row: &[(u32, f64)], factor: f64| {
        for (k, &(j, b)) in row.iter().enumerate() {
            // Columns ascend, so this is the lower triangle.
            let (b, column) = (factor * b, &mut gram.as_mut_slice()[j as usize * size..][..size]);
            row[k..].iter().for_each(|&(i, a)| column[i as usize] += a * b);
        }
    };
    let mut uses = vec![0.0; finest.vertices()];
    let (mut sums, mut columns) = (vec![0.0; size], Vec::new());
    let mut sum = Vec::new();
    for face in finest.faces() {
        for corner in face.map(|corner| corner as usize) {
            uses[corner] += 1.0;
            for &(i, value) in operator.row(corner) {
                sums[i as usize] += value;
                columns.push(i);
            }
        }
        columns.sort_unstable();
        columns.dedup();
        sum.clear();
        sum.extend(columns.drain(..).map(|i| (i, std::mem::take(&mut sums[i as usize]))));
        add_square(&sum, 1.0);
    }
    for (row, uses) in operator.iter().zip(uses) {
        add_square(row, uses);
    }
    gram /= 12.0 * finest.faces().len() as f64;
    fill_upper(&mut gram);
    gram
}
