//! Steps of all shapes together.
//!
//! ```text
//! F = n log det(I + XXᵀ/(nδ)),   X: n × p, a centred shape in each row
//! ∇F = 2 X P/δ,   P = δ M⁻¹ = (I + XᵀX/(nδ))⁻¹,   ∇²F ≈ 2 W ⊗ P/δ,   W = (I + XXᵀ/(nδ))⁻¹
//! ```
//!
//! The bound by which each shape is moved on its own ([`Model`]) takes the place of `W` by the identity. It punishes each displacement
//! that leaves the span of the modes by `1/δ`, also one that all shapes make in proportion to their scores of a mode, which only turns
//! this mode. A detail that moves along a surface is brought into correspondence by just such displacements; shape by shape the steps
//! become as small as `δ` is beside the variance of the mode. `W` knows that they are cheap. The equations are solved by conjugate
//! gradients, with the blocks of single shapes as preconditioner.

use shapelex_geometry::reparametrisation::Reparametrisation;
use shapelex_numeric::dense::{Definite, Matrix, multiply, transpose_multiply};
use shapelex_numeric::parallel;

use super::domain::Domain;
use super::member::{Member, Penalty, Pose};
use super::model::{Model, Spread};
use super::{AnalysisError, spread_of};
use crate::watch::Watch;

/// Most patterns of displacements over the shapes that are cheaper than others, `n × PATTERNS` numbers.
const PATTERNS: usize = 32;
/// Most steps of conjugate gradients; the equations need not be solved further than the derivatives are good.
const SOLVES: usize = 25;
/// Decrease of the preconditioned residual, squared, at which the solution is good enough.
const SOLVED: f64 = 1e-4;
/// Shares of a step that are tried.
const SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// Solutions with rising damping that are tried in a round.
const ATTEMPTS: usize = 3;
/// Part of the diagonal of the blocks that keeps steps short: at first, at least and at most.
pub(super) const DAMPING: f64 = 1e-4;
const DAMPINGS: [f64; 2] = [1e-6, 1e2];

/// Where a step takes a member.
type Moved = (Reparametrisation, Pose, Vec<f64>);

/// The equations of a step: columns are shapes, rows their unknowns.
struct Equations<'a> {
    model: &'a Model,
    jacobians: &'a [Matrix],
    /// `n × r` orthonormal patterns of scores, and `λ/(λ + δ)` of each.
    patterns: Matrix,
    shares: Vec<f64>,
    /// Weights of the squared unknowns of every shape: deformation and damping.
    diagonal: Matrix,
    blocks: Vec<Definite>,
}

impl<'a> Equations<'a> {
    /// `None` if a block is not definite.
    fn new(
        model: &'a Model,
        jacobians: &'a [Matrix],
        scores: (Matrix, Vec<f64>),
        penalties: &[f64],
        damping: f64,
    ) -> Option<Self> {
        let (patterns, shares) = scores;
        let block = |(k, jacobian): (usize, &Matrix)| {
            let own: f64 = shares.iter().enumerate().map(|(i, share)| share * patterns[(k, i)].powi(2)).sum();
            let mut block = transpose_multiply(&model.weigh(jacobian), jacobian);
            let size = block.nrows();
            let largest = (0..size).map(|i| block[(i, i)]).fold(0.0, f64::max);
            let added: Vec<f64> =
                (0..size).map(|i| penalties[i] + damping * (block[(i, i)] + largest)).collect();
            block *= (1.0 - own).max(0.0);
            added.iter().enumerate().for_each(|(i, part)| block[(i, i)] += part);
            Some((Definite::new(&block).ok()?, added))
        };
        let found: Option<Vec<(Definite, Vec<f64>)>> =
            parallel::map(jacobians.len(), &|k| block((k, &jacobians[k]))).into_iter().collect();
        let (blocks, added): (Vec<Definite>, Vec<Vec<f64>>) = found?.into_iter().unzip();
        let diagonal = columns(&added);
        Some(Self { model, jacobians, patterns, shares, diagonal, blocks })
    }

    /// `(Jᵀ (W ⊗ P) J + diagonal) x`.
    fn apply(&self, x: &Matrix) -> Matrix {
        let image = |k: usize| (&self.jacobians[k] * x.column(k)).as_slice().to_vec();
        let mut moved = columns(&parallel::map(self.jacobians.len(), &image));
        // Equal shapes have no patterns.
        if !self.shares.is_empty() {
            let mut along = multiply(&moved, &self.patterns);
            for (mut column, share) in along.column_iter_mut().zip(&self.shares) {
                column *= *share;
            }
            moved -= multiply(&along, &self.patterns.transpose());
        }
        pulled(self.jacobians, &self.model.weigh(&moved)) + self.diagonal.component_mul(x)
    }

    /// The solution of the equations of single shapes.
    fn precondition(&self, right: &Matrix) -> Matrix {
        let solve = |k: usize| {
            self.blocks[k].solve(&Matrix::from_column_slice(right.nrows(), 1, right.column(k).as_slice()))
        };
        let solved = parallel::map(self.blocks.len(), &solve);
        columns(&solved.iter().map(|column| column.as_slice().to_vec()).collect::<Vec<_>>())
    }

    /// The solution for this right-hand side, by conjugate gradients.
    fn solve(&self, right: Matrix) -> Matrix {
        let mut x = Matrix::zeros(right.nrows(), right.ncols());
        let mut residual = right;
        let mut near = self.precondition(&residual);
        let mut direction = near.clone();
        let mut size = residual.dot(&near);
        let first = size;
        for _ in 0..SOLVES {
            let image = self.apply(&direction);
            let curvature = direction.dot(&image);
            if !(curvature > 0.0) || !(size > SOLVED * first) {
                break;
            }
            let step = size / curvature;
            x += &direction * step;
            residual -= image * step;
            near = self.precondition(&residual);
            let next = residual.dot(&near);
            direction = &near + direction * (next / size);
            size = next;
        }
        x
    }
}

/// Lists as columns of a matrix.
fn columns(lists: &[Vec<f64>]) -> Matrix {
    let size = lists.first().map_or(0, Vec::len);
    Matrix::from_iterator(size, lists.len(), lists.iter().flatten().copied())
}

/// `Jᵀ` of every shape, applied to its column.
fn pulled(jacobians: &[Matrix], moved: &Matrix) -> Matrix {
    let pull = |k: usize| jacobians[k].tr_mul(&moved.column(k)).as_slice().to_vec();
    columns(&parallel::map(jacobians.len(), &pull))
}

/// `δ n Σ log(1 + λ/δ)` and the deformations: the objective of a step.
fn objective<'a>(
    spread: &Spread,
    maps: impl ExactSizeIterator<Item = &'a Reparametrisation>,
    (delta, penalty): (f64, Penalty),
) -> f64 {
    let entropy = delta * maps.len() as f64 * spread.entropy(delta);
    entropy + maps.map(|map| penalty.total(map)).sum::<f64>()
}

/// A step is tried whole and in parts; `Ok(None)` if the objective does not fall.
fn tried(
    domain: &Domain,
    members: &[Member],
    weights: (f64, Penalty),
    (wanted, change): (&[usize], &Matrix),
    before: f64,
) -> Result<Option<(f64, Vec<Moved>)>, AnalysisError> {
    for share in SHARES {
        let move_one = |k: usize| {
            let part: Vec<f64> = change.column(k).iter().map(|x| share * x).collect();
            members[k].moved(domain, wanted, &part)
        };
        let moved: Vec<Moved> = parallel::map(members.len(), &move_one);
        let coefficients: Vec<&[f64]> = moved.iter().map(|one| &one.2[..]).collect();
        let spread = Spread::of(&coefficients)?;
        if objective(&spread, moved.iter().map(|one| &one.0), weights) < before {
            return Ok(Some((share, moved)));
        }
    }
    Ok(None)
}

/// One step of rotations of the parameters, poses and the `wanted` coefficients of all shapes, shortened until the objective falls.
/// Returns whether it fell; `damping` follows how far steps could be trusted.
///
/// # Errors
/// [`AnalysisError::Interrupted`].
pub(super) fn step(
    domain: &Domain,
    members: &mut [Member],
    (delta, penalty): (f64, Penalty),
    wanted: &[usize],
    damping: &mut f64,
    watch: &dyn Watch,
) -> Result<bool, AnalysisError> {
    let spread = spread_of(members)?;
    let model = spread.model(delta);
    let derive = |k: usize| {
        watch.check()?;
        watch.worked(1);
        Ok::<_, AnalysisError>(members[k].jacobian(domain, wanted))
    };
    let jacobians = parallel::try_map(members.len(), &derive)?;
    let mut penalties = vec![0.0; 6];
    penalties.extend(wanted.iter().map(|&index| penalty.of(index)));
    let apart: Vec<Vec<f64>> = members.iter().map(|member| model.apart(&member.coefficients)).collect();
    let mut right = -pulled(&jacobians, &model.weigh(&columns(&apart)));
    for (mut column, member) in right.column_iter_mut().zip(members.iter()) {
        for (j, &index) in wanted.iter().enumerate() {
            column[6 + j] -= penalties[6 + j] * member.map.coefficients()[index];
        }
    }
    let before = objective(&spread, members.iter().map(|member| &member.map), (delta, penalty));
    for _ in 0..ATTEMPTS {
        watch.check()?;
        let scores = spread.patterns(&apart, delta, PATTERNS);
        if let Some(equations) = Equations::new(&model, &jacobians, scores, &penalties, *damping) {
            let change = equations.solve(right.clone());
            let found = tried(domain, members, (delta, penalty), (wanted, &change), before)?;
            if let Some((share, moved)) = found {
                for (member, (map, pose, coefficients)) in members.iter_mut().zip(moved) {
                    (member.map, member.pose, member.coefficients) = (map, pose, coefficients);
                }
                let factor = if share < 1.0 { 2.0 / share } else { 0.125 };
                *damping = (*damping * factor).clamp(DAMPINGS[0], DAMPINGS[1]);
                return Ok(true);
            }
        }
        *damping = (*damping * 30.0).min(DAMPINGS[1]);
    }
    Ok(false)
}
