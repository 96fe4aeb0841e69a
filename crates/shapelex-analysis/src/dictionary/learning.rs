//! Learning the atoms of a dictionary.
//!
//! ```text
//! min_{D, B}  Σ_k w_k ( ½‖X_k − Σ_j D_j B_jkᵀ‖² + λ Σ_j ‖D_j B_jkᵀ‖ ),   c · P_𝓑(D_jᵀD_j) ≼ I,   B_jk ∈ 𝓑
//! ```
//!
//! (or without penalty and with at most so many `B_jk ≠ 0` a shape). The shapes are cut into groups. Every shape of a
//! group is coded, the statistics of the group replace those it had before, and one sweep of block coordinate descent
//! moves the atoms. With one group this is batch alternation; with several it is online learning by the sufficient
//! statistics of Mairal et al. 2009, which here never forget a group and never count it twice: the objective — every
//! shape with its latest code, the atoms as they are — never rises under a penalty, for any number of groups. A pursuit
//! does not minimise: with it the objective may rise, and the atoms of the best pass are what is learnt.
//!
//! Atoms start as shapes chosen by the seed. An atom that no shape uses is replaced by the shape that is coded worst.
//! Results have the same bits on any number of threads.

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::algebra::Algebra;
use super::statistics::Statistics;
use crate::AnalysisError;
use crate::accumulate::{BLOCK, ShapeSource, Shapes};
use crate::metric::dot;
use crate::sparse::{Atoms, Coder, SparseCode};
use shapelex_numeric::dense::Matrix;

/// How often atoms move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Schedule {
    /// After every group of shapes.
    #[default]
    Online,
    /// After all of them.
    Batch,
}

/// What is learnt, and when it ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Learning {
    /// `J`.
    pub atoms: usize,
    /// How shapes are coded.
    pub coder: Coder,
    /// What atoms are moved by.
    pub algebra: Algebra,
    /// How often atoms move.
    pub schedule: Schedule,
    /// Draws the first atoms.
    pub seed: u64,
    /// Passes over the shapes at the most.
    pub max_epochs: usize,
    /// The passes end when the objective falls by less than this part of it; with a pursuit, in ten passes.
    pub tolerance: f64,
}

/// Where learning goes on: atoms, and the statistics of shapes that are not seen again.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// `m × cJ`.
    pub atoms: Matrix,
    /// Of the shapes seen before.
    pub statistics: Statistics,
}

/// How the caller follows and ends what takes long.
pub trait Watch: Sync {
    /// Whether to stop: asked every few shapes.
    fn stop(&self) -> bool {
        false
    }

    /// After every pass: how many there were, and the objective.
    fn epoch(&self, _epochs: usize, _objective: f64) {}
}

/// Nobody watches.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;
impl Watch for Unwatched {}

/// Learnt atoms with the record of learning.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt {
    /// `m × cJ`, normal forms.
    pub atoms: Matrix,
    /// Of all shapes that went in.
    pub statistics: Statistics,
    /// The objective over the weight, after every pass.
    pub history: Vec<f64>,
    /// Whether the tolerance ended learning.
    pub converged: bool,
    /// Atoms that were replaced.
    pub reseeded: usize,
}

/// Most groups of shapes.
const MOST_GROUPS: usize = 64;

/// Memory for the statistics of all groups.
const GROUP_BYTES: usize = 256 << 20;

/// Shapes between two looks at the watch.
const STEP: usize = 512;

/// An atom whose mean squared coefficient is below this is not used.
const UNUSED: f64 = 1e-12;

/// Passes that are added because new atoms came in: where more atoms than are worth their penalty were asked for, some
/// stay unused.
const CHANCES: usize = 10;

/// Passes without progress that end learning with a pursuit: its codes are no minimisers, so that the objective rises at
/// times before it falls on.
const PURSUIT_PATIENCE: usize = 10;

/// Memory for the sums of blocks that are formed side by side.
const BLOCK_BYTES: usize = 64 << 20;

/// An atom this near to the border of its ball is on it.
const ON_BORDER: f64 = 1e-14;

impl Learning {
    /// Learns from prepared shapes in their normal form.
    ///
    /// Cost of a pass: `K` codes, and `O(groups · m c² J²)` for the atoms.
    ///
    /// # Errors
    /// [`AnalysisError::TooFewShapes`] below `J` shapes, [`AnalysisError::Interrupted`] when the watch says so,
    /// errors of the codes and of the source.
    pub fn learn<S: ShapeSource>(
        &self,
        source: &S,
        start: Option<Start>,
        watch: &dyn Watch,
    ) -> Result<Learnt, S::Error> {
        let mut state = match start {
            Some(start) => State::new(self, start.atoms, Some(start.statistics)),
            None => State::new(self, self.first_atoms(source)?, None),
        };
        let mut learnt = Learnt {
            atoms: state.atoms.clone(),
            statistics: state.total.clone(),
            history: Vec::new(),
            converged: false,
            reseeded: 0,
        };
        let patience = if self.coder.lambda() > 0.0 { 1 } else { PURSUIT_PATIENCE };
        let (mut least, mut waited, mut chances) = (f64::INFINITY, 0, CHANCES);
        while waited < patience && learnt.history.len() < self.max_epochs {
            let residuals = self.epoch(source, &mut state, watch)?;
            state.gather();
            let objective = state.total.objective(&state.atoms, self.coder.lambda());
            learnt.history.push(objective);
            watch.epoch(learnt.history.len(), objective);
            waited = if least - objective > self.tolerance * objective { 0 } else { waited + 1 };
            if state.reseed(&residuals, source)? && chances > 0 {
                (chances, waited) = (chances - 1, 0);
            }
            if objective <= least {
                least = objective;
                (learnt.atoms, learnt.statistics) = (state.atoms.clone(), state.total.clone());
            }
        }
        (learnt.converged, learnt.reseeded) = (waited >= patience, state.reseeded);
        Ok(learnt)
    }

    /// Codes of the shapes in the learnt atoms.
    pub fn atoms_of(&self, atoms: &Matrix) -> Atoms {
        let length = atoms.nrows() * self.algebra.size();
        let blocks: Vec<_> =
            atoms.as_slice().chunks_exact(length).map(|atom| self.algebra.block(atom)).collect();
        let b = self.algebra.parameters();
        Atoms::blocks(Matrix::from_vec(length, self.atoms * b, blocks.concat()), b)
    }

    /// Normal forms of shapes that the seed chooses, in the order of the draw.
    fn first_atoms<S: ShapeSource>(&self, source: &S) -> Result<Matrix, S::Error> {
        let found = source.count();
        if found < self.atoms {
            return Err(AnalysisError::TooFewShapes { found, needed: self.atoms }.into());
        }
        let mut order: Vec<usize> = (0..found).collect();
        let mut random = ChaCha12Rng::seed_from_u64(self.seed);
        for i in 0..self.atoms {
            order.swap(i, random.random_range(i..found));
        }
        order.truncate(self.atoms);
        let mut shapes = pick(source, &order)?;
        let length = shapes.len() / self.atoms;
        for shape in shapes.chunks_exact_mut(length) {
            // A normal form is there already, as far as rounding lets it.
            self.algebra.to_border(shape);
        }
        Ok(Matrix::from_vec(length / self.algebra.size(), self.algebra.size() * self.atoms, shapes))
    }

    /// Shapes in a group whose statistics take `bytes`.
    fn group_size(&self, shapes: usize, bytes: usize) -> usize {
        let groups = match self.schedule {
            Schedule::Batch => 1,
            Schedule::Online => (GROUP_BYTES / bytes).clamp(1, MOST_GROUPS),
        };
        shapes.div_ceil(groups).next_multiple_of(BLOCK)
    }

    /// One pass; the squared distance of every shape from its code.
    fn epoch<S: ShapeSource>(
        &self,
        source: &S,
        state: &mut State<'_>,
        watch: &dyn Watch,
    ) -> Result<Vec<f64>, S::Error> {
        let mut residuals = Vec::with_capacity(source.count());
        let mut group = state.empty();
        let size = self.group_size(source.count(), state.total.bytes());
        let mut atoms = self.atoms_of(&state.atoms);
        source.for_each_batch(&mut |batch| {
            let mut rest = batch;
            while !rest.weights.is_empty() {
                let room = size - residuals.len() % size;
                let part;
                (part, rest) = rest.split_at(room.min(rest.weights.len()));
                self.code_part(&atoms, part, watch, &mut group, &mut state.codes)?;
                residuals
                    .extend(part.iter().map(|(k, x, _)| state.codes[k].relative_error.powi(2) * dot(x, x)));
                if residuals.len() % size == 0 || residuals.len() == source.count() {
                    let number = (residuals.len() - 1) / size;
                    state.replace(number, std::mem::replace(&mut group, state.empty()));
                    state.improve();
                    atoms = self.atoms_of(&state.atoms);
                }
            }
            Ok(())
        })?;
        Ok(residuals)
    }

    /// Codes shapes of a group and adds their statistics, in the order of the shapes.
    fn code_part(
        &self,
        atoms: &Atoms,
        part: Shapes<'_>,
        watch: &dyn Watch,
        group: &mut Statistics,
        known: &mut Vec<SparseCode>,
    ) -> Result<(), AnalysisError> {
        self.codes(atoms, part, watch, known)?;
        let codes = &known[part.first..];
        let empty = group.emptied();
        let sum = |block: Shapes<'_>| {
            let mut sum = empty.clone();
            let first = block.first - part.first;
            sum.add(&self.algebra, block, &codes[first..first + block.weights.len()]);
            sum
        };
        let together = (BLOCK_BYTES / group.bytes()).clamp(1, MOST_GROUPS);
        let mut rest = part;
        while !rest.weights.is_empty() {
            let several;
            (several, rest) = rest.split_at((BLOCK * together).min(rest.weights.len()));
            let sums: Vec<Statistics> = several.blocks(BLOCK).map(sum).collect();
            sums.iter().for_each(|sum| group.merge(sum));
        }
        Ok(())
    }

    /// Codes prepared shapes, starting from the codes of the pass before, where they stand in `known`, and writes the
    /// new codes there: from pass to pass few atoms come and go.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`], errors of the codes.
    fn codes(
        &self,
        atoms: &Atoms,
        shapes: Shapes<'_>,
        watch: &dyn Watch,
        known: &mut Vec<SparseCode>,
    ) -> Result<(), AnalysisError> {
        let mut rest = shapes;
        while !rest.weights.is_empty() {
            let step;
            (step, rest) = rest.split_at(STEP.min(rest.weights.len()));
            if watch.stop() {
                return Err(AnalysisError::Interrupted);
            }
            let places = step.first..step.first + step.weights.len();
            let coded = match known.get(places.clone()) {
                Some(previous) => self.coder.codes_from(atoms, step.whitened, previous),
                None => self.coder.codes(atoms, step.whitened),
            };
            let coded = coded.map_err(|error| error.after(step.first))?;
            known.splice(places.start..places.end.min(known.len()), coded);
        }
        Ok(())
    }
}

impl Learnt {
    /// Turns every atom by the orthogonal member of the class that brings it nearest to `target`: of all equally good
    /// atoms the one that is seen beside the mean shape.
    pub fn turn_to(&mut self, algebra: &Algebra, target: &[f64]) {
        for (j, atom) in self.atoms.as_mut_slice().chunks_exact_mut(target.len()).enumerate() {
            let turn = algebra.rotation_to(atom, target);
            algebra.act(atom, &turn);
            self.statistics.substitute(j, &turn);
        }
    }
}

/// The shapes at `positions`, in the order of these.
fn pick<S: ShapeSource>(source: &S, positions: &[usize]) -> Result<Vec<f64>, S::Error> {
    let mut picked: Vec<Vec<f64>> = vec![Vec::new(); positions.len()];
    source.for_each_batch(&mut |batch| {
        let length = batch.whitened.len() / batch.weights.len().max(1);
        for (slot, &position) in picked.iter_mut().zip(positions) {
            if let Some(i) = position.checked_sub(batch.first).filter(|&i| i < batch.weights.len()) {
                *slot = batch.whitened[i * length..(i + 1) * length].to_vec();
            }
        }
        Ok(())
    })?;
    Ok(picked.concat())
}

/// Atoms with the statistics of every group.
struct State<'a> {
    learning: &'a Learning,
    length: usize,
    atoms: Matrix,
    /// Of shapes that are not seen again.
    base: Option<Statistics>,
    groups: Vec<Statistics>,
    total: Statistics,
    /// Latest code of every shape.
    codes: Vec<SparseCode>,
    reseeded: usize,
}

impl<'a> State<'a> {
    fn new(learning: &'a Learning, atoms: Matrix, base: Option<Statistics>) -> Self {
        let length = atoms.nrows() * learning.algebra.size();
        let empty = Statistics::new(length, learning.algebra.size(), learning.atoms);
        let total = base.clone().unwrap_or(empty);
        Self { learning, length, atoms, base, groups: Vec::new(), total, codes: Vec::new(), reseeded: 0 }
    }

    fn empty(&self) -> Statistics {
        self.total.emptied()
    }

    /// Puts the new statistics of a group in the place of those it had.
    fn replace(&mut self, number: usize, group: Statistics) {
        self.total.merge(&group);
        match self.groups.get_mut(number) {
            Some(known) => {
                self.total.remove(known);
                *known = group;
            }
            None => self.groups.push(group),
        }
    }

    /// The total anew: what was added and taken out again leaves rounding behind.
    fn gather(&mut self) {
        self.total = self.base.clone().unwrap_or_else(|| self.empty());
        self.groups.iter().for_each(|group| self.total.merge(group));
    }

    /// Moves every atom once, and takes them to the border of their balls: what an atom gains its codes lose, and the
    /// penalty with them.
    fn improve(&mut self) {
        let algebra = &self.learning.algebra;
        self.total.sweep(algebra, &mut self.atoms, UNUSED * self.total.weight());
        for (j, atom) in self.atoms.as_mut_slice().chunks_exact_mut(self.length).enumerate() {
            let Some(r) = algebra.to_border(atom) else { continue };
            if (&r - Matrix::identity(r.nrows(), r.ncols())).norm() > ON_BORDER {
                let all = self.groups.iter_mut().chain(&mut self.base).chain([&mut self.total]);
                all.for_each(|statistics| statistics.substitute(j, &r));
            }
        }
    }

    /// Replaces atoms that no shape uses by the shapes that are coded worst, which cannot raise the objective; whether
    /// there were any.
    fn reseed<S: ShapeSource>(&mut self, residuals: &[f64], source: &S) -> Result<bool, S::Error> {
        let least = UNUSED * self.total.weight();
        let unused: Vec<usize> =
            (0..self.learning.atoms).filter(|&j| self.total.use_of(j) <= least).collect();
        if unused.is_empty() {
            return Ok(false);
        }
        let mut worst: Vec<usize> = (0..residuals.len()).collect();
        worst.sort_by(|&a, &b| residuals[b].total_cmp(&residuals[a]).then(a.cmp(&b)));
        worst.truncate(unused.len());
        let shapes = pick(source, &worst)?;
        for (&j, shape) in unused.iter().zip(shapes.chunks_exact(self.length)) {
            let mut atom = shape.to_vec();
            self.learning.algebra.to_border(&mut atom);
            self.atoms.as_mut_slice()[j * self.length..(j + 1) * self.length].copy_from_slice(&atom);
            self.reseeded += 1;
        }
        Ok(true)
    }
}
