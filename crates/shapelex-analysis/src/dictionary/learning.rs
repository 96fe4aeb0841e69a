//! Learning the atoms of a dictionary.
//!
//! ```text
//! min_{D, B}  Σ_k w_k ( ½‖X_k − Σ_j D_j B_jkᵀ‖² + λ Σ_j ‖D_j B_jkᵀ‖ ),   c · P_𝓑(D_jᵀD_j) ≼ I,   B_jk ∈ 𝓑
//! ```
//!
//! (or without a penalty and with a limit on the number of `B_jk ≠ 0` per shape). The shapes are divided into groups. Every
//! shape of a group is coded, the statistics of the group replace its previous ones, and one sweep of block coordinate
//! descent updates the atoms. With one group this is batch alternation; with several it is online learning by the
//! sufficient statistics of Mairal et al. 2009, except that no group is ever forgotten or counted twice. Under a penalty the
//! objective (every shape with its latest code, the atoms as they are) never rises, for any number of groups. A pursuit does
//! not minimise, so its objective may rise; the result is then the atoms of the best pass.
//!
//! The statistics of a group are summed by parts of [`PART`] shapes, and these by the tree of all sums, so that other processes can
//! code parts.
//!
//! Atoms start as shapes drawn from the seed. An atom that no shape uses is replaced by the worst coded shape. Results have
//! the same bits for any number of threads.

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};

use super::statistics::Statistics;
use crate::AnalysisError;
use crate::accumulate::{BLOCK, PART, PartTree, ShapeSource, Shapes, read_numbers, write_numbers};
use crate::algebra::Algebra;
use crate::metric::dot;
use crate::pass::{CodeGroup, Group};
use crate::sparse::{Atoms, Coder, Encode, SparseCode};
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Schedule of the updates of the atoms: `online` after every group of shapes, `batch` after each pass over all shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Schedule {
    /// Atoms are updated after every group of shapes.
    #[default]
    Online,
    /// Atoms are updated after each pass over all shapes.
    Batch,
}

/// Parameters of dictionary learning.
#[derive(Debug, Clone, PartialEq)]
pub struct Learning {
    /// Number of atoms, `J`.
    pub atoms: usize,
    /// The coder of the shapes.
    pub coder: Coder,
    /// The transformations that act on atoms.
    pub algebra: Algebra,
    /// Schedule of the updates of the atoms.
    pub schedule: Schedule,
    /// Seed for drawing the initial atoms.
    pub seed: u64,
    /// Maximum number of passes over the shapes.
    pub max_epochs: usize,
    /// Learning ends when the objective is, by the gain of the second half of the passes, relatively nearer to its end than this; with a
    /// pursuit, which does not minimise, when it is so for ten passes.
    pub tolerance: f64,
}

/// State from which learning continues: atoms, and the statistics of earlier shapes that are not read again.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Atoms, `m × cJ`.
    pub atoms: Matrix,
    /// Statistics of the earlier shapes.
    pub statistics: Statistics,
}

/// Learnt atoms with the record of the learning process.
#[derive(Debug, Clone, PartialEq)]
pub struct Learnt {
    /// `m × cJ`; every atom is a normal form.
    pub atoms: Matrix,
    /// Statistics of all shapes that were used.
    pub statistics: Statistics,
    /// The objective divided by the total weight, after every pass.
    pub history: Vec<f64>,
    /// Whether learning ended by the tolerance.
    pub converged: bool,
    /// Number of atoms that were replaced.
    pub reseeded: usize,
}

/// Maximum number of groups of shapes.
pub const MAX_GROUPS: usize = 64;

/// Memory limit for the statistics of all groups, in bytes.
const GROUP_BYTES: usize = 256 << 20;

/// Number of shapes between two calls of the watch.
const STEP: usize = 512;

/// Mean squared coefficient below which an atom is unused.
const UNUSED: f64 = 1e-12;

/// Maximum number of times that replacing atoms prolongs learning. If more atoms are requested than are worth their penalty,
/// some stay unused.
const CHANCES: usize = 10;

/// Number of passes without progress that end learning with a pursuit. Its codes are not minimisers, so the objective
/// may rise at times before it falls further.
const PURSUIT_PATIENCE: usize = 10;

/// Memory limit for sums of blocks that are formed in parallel, in bytes.
const BLOCK_BYTES: usize = 64 << 20;

/// Distance from the border of its ball below which an atom is on the border.
const ON_BORDER: f64 = 1e-14;

/// Fewest passes after which the end of learning is estimated.
const FEWEST_PASSES: usize = 4;

/// Ratio of the gain to come to the gain of the second half of the passes: one if the distance from the end falls like the reciprocal
/// of their number, less if it falls faster. Measured on outlines with 8 to 24 atoms: 0.4 to 0.9.
const LEFT: f64 = 1.5;

/// How far an objective is from its end, estimated by how much the best of all passes is below that of their first half, and not less in
/// general. A single pass gains little long before the end.
fn left_to_gain(history: &[f64]) -> f64 {
    let passes = history.len();
    if passes < FEWEST_PASSES {
        return f64::INFINITY;
    }
    let least = |passes: &[f64]| passes.iter().copied().fold(f64::INFINITY, f64::min);
    LEFT * (least(&history[..passes / 2]) - least(history))
}

impl Learning {
    /// Learns atoms from prepared shapes in normal form.
    ///
    /// Cost per pass: `K` codes, and `O(groups · m c² J²)` for the atoms.
    ///
    /// # Errors
    /// [`AnalysisError::TooFewShapes`] below `J` shapes, [`AnalysisError::Interrupted`] when the watch stops,
    /// errors of the coder and of the source.
    pub fn learn(
        &self,
        source: &dyn ShapeSource,
        start: Option<Start>,
        watch: &dyn Watch,
    ) -> Result<Learnt, AnalysisError> {
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
            let residuals = match source.coders() {
                Some(code) => {
                    self.epoch_elsewhere(source.count(), &code, learnt.history.len(), &mut state, watch)?
                }
                None => self.epoch(source, &mut state, watch)?,
            };
            state.gather();
            let objective = state.total.objective(&state.atoms, self.coder.lambda());
            learnt.history.push(objective);
            watch.epoch(learnt.history.len(), objective);
            let near = left_to_gain(&learnt.history) <= self.tolerance * objective;
            waited = if near { waited + 1 } else { 0 };
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

    /// The learnt atoms, ready for coding.
    pub fn atoms_of(&self, atoms: &Matrix) -> Atoms {
        let length = atoms.nrows() * self.algebra.size();
        let blocks: Vec<_> =
            atoms.as_slice().chunks_exact(length).map(|atom| self.algebra.block(atom)).collect();
        let b = self.algebra.parameters();
        Atoms::blocks(Matrix::from_vec(length, self.atoms * b, blocks.concat()), b)
    }

    /// Normal forms of shapes drawn from the seed, in the order of the draw.
    fn first_atoms(&self, source: &dyn ShapeSource) -> Result<Matrix, AnalysisError> {
        let found = source.count();
        if found < self.atoms {
            return Err(AnalysisError::TooFewShapes { found, needed: self.atoms });
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
            // The shapes are already normal forms, up to rounding.
            self.algebra.to_border(shape);
        }
        Ok(Matrix::from_vec(length / self.algebra.size(), self.algebra.size() * self.atoms, shapes))
    }

    /// Number of shapes per group, if the statistics of a group take `bytes`.
    fn group_size(&self, shapes: usize, bytes: usize) -> usize {
        let groups = match self.schedule {
            Schedule::Batch => 1,
            Schedule::Online => (GROUP_BYTES / bytes).clamp(1, MAX_GROUPS),
        };
        shapes.div_ceil(groups).next_multiple_of(BLOCK)
    }

    /// Makes one pass and returns the squared distance of every shape from its reconstruction.
    fn epoch(
        &self,
        source: &dyn ShapeSource,
        state: &mut State<'_>,
        watch: &dyn Watch,
    ) -> Result<Vec<f64>, AnalysisError> {
        let mut residuals = Vec::with_capacity(source.count());
        let empty = state.empty();
        let mut group = PartTree::new(|| empty.clone(), merge);
        let mut part = empty.clone();
        let size = self.group_size(source.count(), state.total.bytes());
        let mut atoms = self.atoms_of(&state.atoms);
        source.for_each_batch(&mut |batch| {
            let mut rest = batch;
            while !rest.weights.is_empty() {
                let known = residuals.len();
                let room = (size - known % size).min(PART - known % PART);
                let piece;
                (piece, rest) = rest.split_at(room.min(rest.weights.len()));
                self.code_piece(&atoms, piece, watch, &mut part, &mut state.codes)?;
                residuals.extend(errors(piece, &state.codes[piece.first..]));
                let ended = residuals.len() % size == 0 || residuals.len() == source.count();
                if ended || residuals.len() % PART == 0 {
                    group.push(std::mem::replace(&mut part, empty.clone()));
                }
                if ended {
                    state.replace((residuals.len() - 1) / size, group.finish());
                    state.improve();
                    atoms = self.atoms_of(&state.atoms);
                }
            }
            Ok(())
        })?;
        Ok(residuals)
    }

    /// As [`epoch`](Self::epoch), with groups that `code` codes: the same bits.
    fn epoch_elsewhere(
        &self,
        count: usize,
        code: &CodeGroup<'_>,
        epoch: usize,
        state: &mut State<'_>,
        watch: &dyn Watch,
    ) -> Result<Vec<f64>, AnalysisError> {
        let mut residuals = Vec::with_capacity(count);
        let size = self.group_size(count, state.total.bytes());
        while residuals.len() < count {
            watch.check()?;
            let (first, end) = (residuals.len(), count.min(residuals.len() + size));
            let bytes = code(Group { epoch, first, end, atoms: state.atoms.as_slice(), mean: &[] })?;
            let mut coding = Coding::new(&state.total);
            coding.append(&bytes)?;
            if coding.errors.len() != end - first {
                return Err(AnalysisError::NotAnAccumulator);
            }
            watch.worked(end - first);
            residuals.extend(coding.errors);
            state.replace(first / size, coding.statistics);
            state.improve();
        }
        Ok(residuals)
    }

    /// Codes prepared shapes of one part, one after another from its first of a group on: their sums, and their codes, from the
    /// codes `known` of the epoch before, if there was one. `atoms` are those of a [`Group`], `m` numbers for each of `cJ` columns.
    ///
    /// Cost: the Gram matrix of the atoms, `O(m c² J²)`, a code for each shape, and `O(m c² J)` for its sums.
    ///
    /// # Errors
    /// Errors of the coder and of the source; [`AnalysisError::NotAnAccumulator`] for atoms of another size.
    pub fn coded(
        &self,
        atoms: &[f64],
        shapes: &dyn ShapeSource,
        known: Vec<SparseCode>,
        watch: &dyn Watch,
    ) -> Result<(Coding, Vec<SparseCode>), AnalysisError> {
        let columns = self.algebra.size() * self.atoms;
        if atoms.is_empty() || !atoms.len().is_multiple_of(columns) {
            return Err(AnalysisError::NotAnAccumulator);
        }
        let atoms = Matrix::from_column_slice(atoms.len() / columns, columns, atoms);
        let mut coding = Coding::new(&State::new(self, atoms.clone(), None).total);
        let (atoms, mut codes) = (self.atoms_of(&atoms), known);
        shapes.for_each_batch(&mut |batch| {
            self.code_piece(&atoms, batch, watch, &mut coding.statistics, &mut codes)?;
            coding.errors.extend(errors(batch, &codes[batch.first..]));
            Ok(())
        })?;
        Ok((coding, codes))
    }

    /// Codes consecutive shapes of a part and adds their statistics to its sum, in order.
    fn code_piece(
        &self,
        atoms: &Atoms,
        piece: Shapes<'_>,
        watch: &dyn Watch,
        part: &mut Statistics,
        known: &mut Vec<SparseCode>,
    ) -> Result<(), AnalysisError> {
        self.codes(atoms, piece, watch, known)?;
        let codes = &known[piece.first..];
        let empty = part.emptied();
        let sum = |block: Shapes<'_>| -> Statistics {
            let mut sum = empty.clone();
            let first = block.first - piece.first;
            sum.add(&self.algebra, block, &codes[first..first + block.weights.len()]);
            sum
        };
        let together = (BLOCK_BYTES / part.bytes()).clamp(1, MAX_GROUPS);
        let mut rest = piece;
        while !rest.weights.is_empty() {
            let several;
            (several, rest) = rest.split_at((BLOCK * together).min(rest.weights.len()));
            let count = several.weights.len().div_ceil(BLOCK);
            let sums = parallel::map(count, &|k| sum(several.block(k, BLOCK)));
            sums.iter().for_each(|sum| part.merge(sum));
        }
        Ok(())
    }

    /// Codes prepared shapes, starting from the codes of the previous pass in `known`, and stores the new codes there. Few
    /// atoms enter or leave a code from pass to pass.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`], errors of the coder.
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
            watch.check()?;
            let places = step.first..step.first + step.weights.len();
            let coded = match known.get(places.clone()) {
                Some(previous) => self.coder.codes_from(atoms, step.whitened, previous),
                None => self.coder.codes(atoms, step.whitened),
            };
            let coded = coded.map_err(|error| error.after(step.first))?;
            watch.worked(coded.len());
            known.splice(places.start..places.end.min(known.len()), coded);
        }
        Ok(())
    }
}

impl Learnt {
    /// Transforms every atom by the orthogonal member of the class that brings it nearest to `target`. Among equivalent
    /// atoms, this is the one that is comparable with the mean shape.
    pub fn turn_to(&mut self, algebra: &Algebra, target: &[f64]) {
        for (j, atom) in self.atoms.as_mut_slice().chunks_exact_mut(target.len()).enumerate() {
            let turn = algebra.rotation_to(atom, target);
            algebra.act(atom, &turn);
            self.statistics.substitute(j, &turn);
        }
    }
}

/// Adds a sum to another.
fn merge(sum: &mut Statistics, other: Statistics) {
    sum.merge(&other);
}

/// Squared distance of each shape from its reconstruction by its code.
fn errors(shapes: Shapes<'_>, codes: &[SparseCode]) -> Vec<f64> {
    shapes.iter().zip(codes).map(|((_, x, _), code)| code.relative_error.powi(2) * dot(x, x)).collect()
}

/// Sums over coded shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Coding {
    statistics: Statistics,
    /// Squared distance of each shape from its reconstruction.
    errors: Vec<f64>,
}

impl Coding {
    /// The sums over no shapes, of the sizes of `like`.
    fn new(like: &Statistics) -> Self {
        Self { statistics: like.emptied(), errors: Vec::new() }
    }

    /// Adds the sums over the shapes that follow, as [`to_bytes`](Self::to_bytes) wrote them.
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for sums of other sizes.
    pub fn append(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        self.errors.extend(read_numbers(&mut bytes)?);
        let mut statistics = self.statistics.emptied();
        statistics.restore(bytes)?;
        self.statistics.merge(&statistics);
        Ok(())
    }

    /// Writes the sums: equal bytes for equal sums.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &self.errors);
        bytes.extend(self.statistics.to_bytes());
        bytes
    }
}

impl Learning {
    /// The sums over no shapes, for shapes of `length` numbers.
    pub fn coding(&self, length: usize) -> Coding {
        Coding::new(&Statistics::new(length, self.algebra.size(), self.atoms))
    }

    /// Whether codes start from those of the epoch before: a pursuit starts afresh.
    pub fn resumes(&self) -> bool {
        self.coder.lambda() > 0.0
    }
}

/// The shapes at `positions`, in that order.
fn pick(source: &dyn ShapeSource, positions: &[usize]) -> Result<Vec<f64>, AnalysisError> {
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
    /// Statistics of shapes that are not read again.
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

    /// Replaces the statistics of a group by new ones.
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

    /// Recomputes the total: additions and subtractions leave rounding errors.
    fn gather(&mut self) {
        self.total = self.base.clone().unwrap_or_else(|| self.empty());
        self.groups.iter().for_each(|group| self.total.merge(group));
    }

    /// Updates every atom once and scales it to the border of its ball. Its codes shrink accordingly, and so does the
    /// penalty.
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

    /// Replaces unused atoms by the worst coded shapes, which cannot raise the objective. Returns whether there were any.
    fn reseed(&mut self, residuals: &[f64], source: &dyn ShapeSource) -> Result<bool, AnalysisError> {
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
