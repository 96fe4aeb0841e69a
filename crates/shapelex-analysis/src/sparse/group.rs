//! The group lasso, by Newton steps on the active blocks.
//!
//! ```text
//! min_a f(a),   f(a) = ½‖x − Σ_j U_j a_j‖² + λ Σ_j ‖a_j‖
//! g_j = λ a_j/‖a_j‖ − U_jᵀr,   H = DᵀD + λ diag_j((I − n_j n_jᵀ)/‖a_j‖),   n_j = a_j/‖a_j‖      (active blocks)
//! a_j ← (1 − λ/‖t‖)₊ t/s_j,   t = U_jᵀr + s_j a_j                                          (one block, others fixed)
//! gap = λ Σ‖a_j‖ − θ aᵀDᵀr + ½(1 − θ)²‖r‖²,   θ = min(1, λ/max_j ‖U_jᵀr‖)
//! ```
//!
//! In every round, the block whose correlation exceeds `λ` most joins by its closed-form update, and one Newton step is made
//! on all active blocks; the first block whose length reaches zero on the way leaves. Every move lowers the objective. If a
//! Newton step does not, a sweep of descent over all blocks replaces it. The gap, in a form free of cancellation, certifies
//! convergence.
//!
//! Source: Yuan and Lin 2006 for the problem; the active set is that of Lee et al. 2007 (feature-sign search), with norms
//! in place of absolute values.

use super::atoms::Atoms;
use super::code::DEFAULT_TOLERANCE;
use super::code::SparseCode;
use super::code::{Fit, Signal};
use super::encode::EncodeOne;
use crate::AnalysisError;
use shapelex_numeric::cholesky::ActiveCholesky;
use shapelex_numeric::kernels::{add_columns, add_scaled, column, dot};

/// Group lasso coder with a certificate: every active atom is transformed by a member `a_j` of the class.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupLasso {
    /// The penalty `λ > 0`.
    pub lambda: f64,
    /// Duality gap to reach, relative to `½‖x‖²`.
    pub tolerance: f64,
}

/// Maximum number of rounds: some for each block that joins or leaves, and a few to converge.
const MAX_ROUNDS: usize = 1000;

/// Maximum number of halvings of a step that does not lower the objective; smaller steps are rounding.
const HALVINGS: i32 = 30;

/// Relative ridge added to the diagonal of `H`. Dependent blocks leave `H` singular; with the ridge, a direction without
/// curvature ends where a block reaches zero. The ridge is far above the pivots that are rounding.
const RIDGE: f64 = 1e-10;

/// Scratch memory of the group lasso.
#[derive(Debug, Default)]
pub(super) struct GroupWork {
    /// The factor of `H`.
    factor: ActiveCholesky,
    /// Active blocks, ascending, and their columns.
    active: Vec<usize>,
    columns: Vec<usize>,
    /// `a`, with `b` numbers per block, as in all vectors below.
    code: Vec<f64>,
    /// `Dᵀr`.
    residual: Vec<f64>,
    /// `n_j` of active blocks.
    normals: Vec<f64>,
    /// `1/‖a_j‖` of active blocks.
    curvatures: Vec<f64>,
    /// The negative gradient on the columns of the factor, then the step there; or the values of one block.
    packed: Vec<f64>,
    /// A step, and its values on the columns of active blocks.
    step: Vec<f64>,
    values: Vec<f64>,
    /// `DᵀD step`.
    image: Vec<f64>,
}

impl GroupLasso {
    /// A coder with the default tolerance.
    pub fn new(lambda: f64) -> Self {
        Self { lambda, tolerance: DEFAULT_TOLERANCE }
    }

    /// `λ Σ_j ‖a_j‖` for values given in blocks.
    pub(super) fn penalty(&self, values: &[f64], block: usize) -> f64 {
        self.lambda * values.chunks_exact(block).map(norm).sum::<f64>()
    }
}

impl EncodeOne for GroupLasso {
    type Work = GroupWork;

    /// Cost: `O(nJb)` per shape for the correlations and `O(Jb·kb + (kb)³)` per round, with `k` active atoms; a shape takes
    /// few rounds more than `k`, or two or three Newton steps from a previous code.
    fn code(
        &self,
        atoms: &Atoms,
        signal: &Signal<'_>,
        previous: Option<&SparseCode>,
        work: &mut GroupWork,
    ) -> Result<SparseCode, AnalysisError> {
        let (lambda, block, wanted) = (self.lambda, atoms.block(), self.tolerance * 0.5 * signal.energy);
        let mut at = Search { lambda, block, atoms, signal, work };
        at.begin(previous);
        let mut best = f64::INFINITY;
        for _ in 0..MAX_ROUNDS {
            let (mut fit, mut gap) = at.certificate();
            if gap <= wanted {
                // The residual carries the rounding of its updates, so the certificate is computed from a fresh one.
                at.refresh();
                (fit, gap) = at.certificate();
            }
            best = gap.min(best);
            if gap <= wanted {
                let penalty = self.penalty(&at.work.code, block);
                return Ok(fit.measured(atoms, signal, &at.work.code, penalty, Some(gap)));
            }
            let joined = at.join();
            let moved = at.newton() || at.sweep();
            if !(at.trim() || joined || moved) {
                break;
            }
        }
        Err(AnalysisError::NoConvergence { index: 0, iterations: MAX_ROUNDS, gap: best, tolerance: wanted })
    }
}

fn norm(a: &[f64]) -> f64 {
    a.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The search for one code.
struct Search<'a> {
    lambda: f64,
    block: usize,
    atoms: &'a Atoms,
    signal: &'a Signal<'a>,
    work: &'a mut GroupWork,
}

impl Search<'_> {
    /// Starts from the previous code, or from zero.
    fn begin(&mut self, previous: Option<&SparseCode>) {
        let columns = self.atoms.columns();
        let GroupWork { code, normals, curvatures, step, image, .. } = &mut *self.work;
        for all in [&mut *code, normals, curvatures, step, image] {
            all.clear();
            all.resize(columns, 0.0);
        }
        if let Some(previous) = previous {
            previous.start(self.atoms, code);
        }
        self.refresh();
        self.find_active();
    }

    /// Recomputes the residual.
    fn refresh(&mut self) {
        self.atoms.residual(self.signal.correlations, &self.work.code, &mut self.work.residual);
    }

    fn find_active(&mut self) {
        let GroupWork { active, columns, code, .. } = &mut *self.work;
        active.clear();
        let blocks = code.chunks_exact(self.block).enumerate();
        active.extend(blocks.filter(|(_, a)| a.iter().any(|value| *value != 0.0)).map(|(j, _)| j));
        columns.clear();
        columns.extend(active.iter().flat_map(|&j| j * self.block..(j + 1) * self.block));
    }

    /// Fit and gap of the current code.
    fn certificate(&self) -> (Fit, f64) {
        let GroupWork { code, residual, .. } = &*self.work;
        let fit = Fit::of(self.signal, code, residual);
        let penalty = self.lambda * code.chunks_exact(self.block).map(norm).sum::<f64>();
        let strongest = residual.chunks_exact(self.block).map(norm).fold(0.0, f64::max);
        (fit, fit.gap(penalty, self.lambda, strongest))
    }

    /// Adds the inactive block with the largest correlation above `λ`. Returns whether there is one.
    fn join(&mut self) -> bool {
        let mut best = (self.lambda * self.lambda, None);
        for (j, residual) in self.work.residual.chunks_exact(self.block).enumerate() {
            let squared = inner(residual, residual);
            if squared > best.0 && self.work.active.binary_search(&j).is_err() {
                best = (squared, Some(j));
            }
        }
        let Some(j) = best.1 else { return false };
        let joined = self.update(j);
        self.find_active();
        joined
    }

    /// Removes active blocks that are better at zero, which rounding may leave. Returns whether there were any.
    fn trim(&mut self) -> bool {
        let mut trimmed = false;
        while let Some(idle) = self.idle() {
            self.update(idle);
            self.find_active();
            trimmed = true;
        }
        trimmed
    }

    /// The first active block that its own update sets to zero: `‖U_jᵀr + s_j a_j‖ ≤ λ`.
    fn idle(&self) -> Option<usize> {
        let GroupWork { active, residual, code, .. } = &*self.work;
        let strength = |j: usize| {
            let range = j * self.block..(j + 1) * self.block;
            let energy = self.atoms.energies()[j];
            range.map(|i| (residual[i] + energy * code[i]).powi(2)).sum::<f64>().sqrt()
        };
        active.iter().copied().find(|&j| strength(j) <= self.lambda)
    }

    /// Sets one block to its optimum with the others fixed. Returns whether it changed.
    fn update(&mut self, j: usize) -> bool {
        let (first, energy) = (j * self.block, self.atoms.energies()[j]);
        let GroupWork { code, residual, packed, .. } = &mut *self.work;
        let target = |i: usize| residual[i] + energy * code[i];
        let length = (first..first + self.block).map(|i| target(i).powi(2)).sum::<f64>().sqrt();
        let shrinkage = if length > self.lambda { (1.0 - self.lambda / length) / energy } else { 0.0 };
        packed.clear();
        packed.extend((first..first + self.block).map(|i| shrinkage * target(i)));
        let mut changed = false;
        for (i, &new) in (first..).zip(packed.iter()) {
            if new != code[i] {
                add_scaled(residual, code[i] - new, column(self.atoms.gram(), i));
                code[i] = new;
                changed = true;
            }
        }
        changed
    }

    /// One pass of descent over all blocks. Returns whether anything changed.
    fn sweep(&mut self) -> bool {
        let changed = (0..self.atoms.len()).fold(false, |changed, j| self.update(j) | changed);
        self.find_active();
        changed
    }

    /// Makes a Newton step on the active blocks, after shorter ones to where blocks reach zero. Returns whether the objective
    /// falls.
    fn newton(&mut self) -> bool {
        let mut moved = false;
        self.find_direction();
        while let Some((reach, j)) = self.first_crossing() {
            self.work.step.iter_mut().for_each(|step| *step *= reach);
            if !self.leave(j) {
                break;
            }
            moved = true;
            self.find_direction();
        }
        self.find_image();
        let mut parts = (0..HALVINGS).map(|halvings| 0.5_f64.powi(halvings));
        let Some(part) = parts.find(|&part| self.change(part) < 0.0) else { return moved };
        self.take(part);
        true
    }

    /// Takes the step that ends with block `j` at zero, if it lowers the objective.
    fn leave(&mut self, j: usize) -> bool {
        let range = j * self.block..(j + 1) * self.block;
        let GroupWork { code, step, packed, .. } = &mut *self.work;
        packed.clear();
        packed.extend_from_slice(&step[range.clone()]);
        step[range.clone()].iter_mut().zip(&code[range.clone()]).for_each(|(step, a)| *step = -a);
        self.find_image();
        let falls = self.change(1.0) < 0.0;
        if falls {
            self.take(1.0);
            self.find_active();
        } else {
            let GroupWork { step, packed, .. } = &mut *self.work;
            step[range].copy_from_slice(packed);
        }
        falls
    }

    /// `step ← −H⁻¹g` on the columns of active blocks.
    fn find_direction(&mut self) {
        let (lambda, block, gram) = (self.lambda, self.block, self.atoms.gram());
        let GroupWork { factor, active, code, residual, normals, curvatures, packed, step, .. } =
            &mut *self.work;
        factor.clear();
        step.fill(0.0);
        for &j in active.iter() {
            let range = j * block..(j + 1) * block;
            let length = norm(&code[range.clone()]);
            curvatures[j] = 1.0 / length;
            normals[range.clone()].iter_mut().zip(&code[range.clone()]).for_each(|(n, a)| *n = a / length);
            for i in range.clone() {
                let gram = column(gram, i);
                let bend = |k: usize| lambda * curvatures[j] * (f64::from(k == i) - normals[k] * normals[i]);
                let hessian = |k: usize| if range.contains(&k) { gram[k] + bend(k) } else { gram[k] };
                let ridge = |k: usize| if k == i { 1.0 + RIDGE } else { 1.0 };
                factor.push_by(|k| hessian(k) * ridge(k), i);
            }
        }
        packed.clear();
        packed.extend(factor.indices().iter().map(|&i| residual[i] - lambda * normals[i]));
        factor.solve(packed);
        factor.indices().iter().zip(packed.iter()).for_each(|(&i, &value)| step[i] = value);
    }

    /// The fraction of the step at which the first block reaches length zero along its normal, with that block.
    fn first_crossing(&self) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        for &j in &self.work.active {
            let range = j * self.block..(j + 1) * self.block;
            let along = inner(&self.work.normals[range.clone()], &self.work.step[range]);
            let reach = -1.0 / (along * self.work.curvatures[j]);
            if along < 0.0 && reach <= 1.0 && first.is_none_or(|(least, _)| reach < least) {
                first = Some((reach, j));
            }
        }
        first
    }

    /// `image ← DᵀD step`.
    fn find_image(&mut self) {
        let GroupWork { columns, values, step, image, .. } = &mut *self.work;
        values.clear();
        values.extend(columns.iter().map(|&i| step[i]));
        image.fill(0.0);
        add_columns(image, self.atoms.gram().as_slice(), columns, values);
    }

    /// `f(a + part·step) − f(a)`, with every term free of cancellation:
    ///
    /// ```text
    /// gᵀδ + ½ δᵀDᵀDδ + λ Σ_j (‖a_j + δ_j‖ − ‖a_j‖ − n_jᵀδ_j)
    /// ```
    fn change(&self, part: f64) -> f64 {
        let GroupWork { active, code, residual, normals, step, image, .. } = &*self.work;
        let quadratic = 0.5 * part * part * dot(step, image);
        let block_change = |&j: &usize| {
            let range = j * self.block..(j + 1) * self.block;
            let slope: f64 =
                range.clone().map(|i| (self.lambda * normals[i] - residual[i]) * step[i] * part).sum();
            slope + self.lambda * bend(&code[range.clone()], &normals[range.clone()], &step[range], part)
        };
        quadratic + active.iter().map(block_change).sum::<f64>()
    }

    fn take(&mut self, part: f64) {
        let GroupWork { code, residual, step, image, .. } = &mut *self.work;
        add_scaled(code, part, step);
        add_scaled(residual, -part, image);
    }
}

/// `‖a + δ‖ − ‖a‖ − nᵀδ` with `δ = part·step`, `n = a/‖a‖`: the rise of the norm above its tangent, computed as
/// `(‖δ‖² − (nᵀδ)²)/(‖a + δ‖ + ‖a‖ + nᵀδ)` where the tangent is positive.
fn bend(a: &[f64], normal: &[f64], step: &[f64], part: f64) -> f64 {
    let along = part * inner(normal, step);
    let tangent = norm(a) + along;
    let reached = a.iter().zip(step).map(|(a, step)| (a + part * step).powi(2)).sum::<f64>().sqrt();
    if tangent <= 0.0 {
        return reached - tangent;
    }
    let across: f64 = normal.iter().zip(step).map(|(n, step)| (part * step - along * n).powi(2)).sum();
    across / (reached + tangent)
}
