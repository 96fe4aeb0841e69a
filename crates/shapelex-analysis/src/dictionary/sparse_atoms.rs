//! Dictionaries of sparse atoms.

use super::content::{Atom, Content};
use super::downdate::Downdate;
use super::learning::{Learning, Schedule, Start};
use super::method::Codes;
use super::model::Model;
use super::procedure::{Inconsistency, ParameterFault, Previous, Procedure};
use super::statistics::Statistics;
use super::work::{CODING, Cost, Size, USED, code_operations};
use crate::AnalysisError;
use crate::accumulate::ShapeSource;
use crate::algebra::Algebra;
use crate::alignment::Method as Alignment;
use crate::metric::Metric;
use crate::partial_sums::Measured;
use crate::preparation::{Pose, Preparation};
use crate::sparse::{Coder, GroupLasso, Lasso, Pursuit};
use crate::watch::{Phase, Watch};
use shapelex_numeric::dense::Matrix;

/// Sparse dictionary: every shape is coded with few atoms. The fields are those of
/// [`Method::Sparse`](super::method::Method::Sparse).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SparseAtoms {
    pub(super) atoms: usize,
    pub(super) lambda: Option<f64>,
    pub(super) nonzeros: Option<usize>,
    pub(super) codes: Codes,
    pub(super) nonnegative: bool,
    pub(super) normalise: bool,
    pub(super) seed: u64,
    pub(super) max_epochs: usize,
    pub(super) tolerance: f64,
    pub(super) schedule: Schedule,
}

/// Largest penalty and smallest exponent of it that a computation survives.
const MAX_LAMBDA: f64 = 1e100;

impl SparseAtoms {
    /// The transformations that act on atoms.
    fn algebra(&self, alignment: &Alignment) -> Result<Algebra, AnalysisError> {
        let refused = |detail| AnalysisError::Parameter { field: "method.codes", detail };
        match (self.codes, alignment) {
            (Codes::Aligned, _) => Ok(Algebra::numbers()),
            (Codes::Invariant, Alignment::Projection(class)) => {
                Algebra::of(class).map_err(|error| refused(error.to_string()))
            }
            (Codes::Invariant, Alignment::Procrustes(_)) => {
                let detail = "invariant codes require a linear class and \"alignment\": \"projection\"";
                Err(refused(detail.into()))
            }
        }
    }

    fn learning_by(&self, algebra: Algebra) -> Learning {
        let &Self { atoms, schedule, seed, max_epochs, tolerance, .. } = self;
        let coder = match (self.lambda, self.nonzeros) {
            (None, nonzeros) => Coder::Pursuit(Pursuit { nonzeros: nonzeros.unwrap_or(1) }),
            (Some(lambda), _) if algebra.parameters() == 1 => {
                Coder::Lasso(Lasso::new(lambda, self.nonnegative))
            }
            (Some(lambda), _) => Coder::GroupLasso(GroupLasso::new(lambda)),
        };
        Learning { atoms, coder, algebra, schedule, seed, max_epochs, tolerance }
    }

    /// The state in which the learning of an earlier version ended.
    fn start(
        &self,
        previous: Previous<'_>,
        metric: &Metric,
        algebra: &Algebra,
    ) -> Result<Start, AnalysisError> {
        let (length, size) = (metric.len(), algebra.size());
        let mut statistics = Statistics::new(length, size, self.atoms);
        statistics.restore(previous.state)?;
        let atoms = previous.content.atoms.iter().flat_map(|atom| metric.whitened(&atom.control_points));
        Ok(Start { atoms: Matrix::from_vec(length / size, size * self.atoms, atoms.collect()), statistics })
    }
}

impl Procedure for SparseAtoms {
    fn atoms(&self) -> usize {
        self.atoms
    }

    fn is_sparse(&self) -> bool {
        true
    }

    fn atoms_are_shapes(&self) -> bool {
        true
    }

    fn is_nonnegative(&self) -> bool {
        self.nonnegative
    }

    fn seed(&self) -> Option<u64> {
        Some(self.seed)
    }

    fn max_epochs(&self) -> usize {
        self.max_epochs
    }

    /// Each atom starts as a different shape.
    fn needed_shapes(&self) -> usize {
        self.atoms
    }

    fn described(&self, _: usize, _: usize) -> usize {
        self.atoms
    }

    fn faults(&self, max_atoms: usize) -> Vec<ParameterFault> {
        let &Self { atoms, lambda, nonzeros, codes, max_epochs, tolerance, .. } = self;
        let mut faults = Vec::new();
        let mut check = |fits: bool, field: &'static str, detail: String| {
            if !fits {
                faults.push(ParameterFault { field, detail });
            }
        };
        let detail = format!("expected a number between 1 and {max_atoms}, got {atoms}");
        check((1..=max_atoms).contains(&atoms), "atoms", detail);
        check(
            lambda.is_some() != nonzeros.is_some(),
            if nonzeros.is_some() { "nonzeros" } else { "lambda" },
            "expected either lambda (penalty) or nonzeros (atoms in a code)".into(),
        );
        if let Some(lambda) = lambda {
            let detail = format!("expected a positive number up to 1e100, got {lambda}");
            check(lambda > 0.0 && lambda <= MAX_LAMBDA, "lambda", detail);
        }
        if let Some(count) = nonzeros {
            let detail = format!("expected a number between 1 and the number of atoms, got {count}");
            check((1..=atoms.max(1)).contains(&count), "nonzeros", detail);
        }
        let signed = !self.nonnegative || (lambda.is_some() && codes == Codes::Aligned);
        let detail =
            "nonnegative codes require lambda and aligned codes: a pursuit and moved atoms have no sign";
        check(signed, "nonnegative", detail.into());
        let detail = "expected true: invariant codes are those of shapes of unit norm";
        check(self.normalise || codes == Codes::Aligned, "normalise", detail.into());
        let detail = format!("expected a number between 1 and 10000, got {max_epochs}");
        check((1..=10_000).contains(&max_epochs), "max_epochs", detail);
        let detail = format!("expected a number between 0 and 1, got {tolerance}");
        check((0.0..1.0).contains(&tolerance), "tolerance", detail);
        faults
    }

    fn inconsistencies(&self, content: &Content, _: &dyn Fn(&[f64]) -> bool) -> Vec<Inconsistency> {
        let fits = content.atoms.len() == self.atoms;
        if fits { Vec::new() } else { vec![("atoms", "expected as many atoms as the method says")] }
    }

    fn pose(&self, alignment: &Alignment) -> Result<Pose, AnalysisError> {
        let algebra = self.algebra(alignment)?;
        Ok(match self.codes {
            Codes::Aligned => Pose::Aligned { normalise: self.normalise },
            Codes::Invariant => Pose::Invariant(algebra),
        })
    }

    fn learning(&self, alignment: &Alignment) -> Result<Option<Learning>, AnalysisError> {
        Ok(Some(self.learning_by(self.algebra(alignment)?)))
    }

    fn fit(
        &self,
        shapes: &dyn ShapeSource,
        previous: Option<Previous<'_>>,
        preparation: &Preparation,
        content: &mut Content,
        watch: &dyn Watch,
    ) -> Result<Vec<u8>, AnalysisError> {
        watch.check()?;
        watch.phase(Phase::Learn, 0.0);
        let metric = &preparation.metric;
        let learning = self.learning_by(self.algebra(&preparation.method)?);
        let start = previous.map(|previous| self.start(previous, metric, &learning.algebra)).transpose()?;
        let mut learnt = learning.learn(shapes, start, watch)?;
        if !self.nonnegative {
            learnt.turn_to(&learning.algebra, &preparation.mean);
        }
        let atoms = learnt.atoms.as_slice().chunks_exact(metric.len());
        let atom =
            |atom| Atom { control_points: metric.rows(atom), usage: 0.0, eigenvalue: None, explained: None };
        content.atoms = atoms.map(atom).collect();
        content.statistics.history = learnt.history;
        content.statistics.converged = learnt.converged;
        content.statistics.reseeded = learnt.reseeded;
        Ok(learnt.statistics.to_bytes())
    }

    fn model(&self, content: &Content, measured: Measured<'_>) -> Result<Model, AnalysisError> {
        let learning = self.learning_by(self.algebra(measured.method)?);
        let (rows, columns) = (measured.metric.len() / learning.algebra.size(), learning.algebra.size());
        let atoms = content.columns(measured.metric);
        let atoms = atoms.reshape_generic(nalgebra::Dyn(rows), nalgebra::Dyn(columns * content.atoms.len()));
        Ok(learning.model(&atoms))
    }

    /// Atoms have no downdate.
    fn downdate(
        &self,
        _: &Content,
        _: &Preparation,
        _: &[u8],
        _: usize,
    ) -> Result<Option<Downdate>, AnalysisError> {
        Ok(None)
    }

    fn cost(&self, size: Size) -> Cost {
        let (k, n, atoms) = (size.shapes, size.length, self.atoms as f64);
        let block = if self.codes == Codes::Invariant { size.class } else { 1.0 };
        let columns = atoms * block;
        let used = self.nonzeros.map_or(USED * columns, |count| count as f64 * block).min(n);
        let code = code_operations(n, columns, used);
        let sweep = 2.0 * n * size.dimension * columns * atoms;
        let groups = (k / 128.0).clamp(1.0, 64.0);
        let sums = columns * columns + n * columns;
        Cost {
            multiply_adds: CODING * self.max_epochs as f64 * (k * code + groups * sweep),
            numbers: (groups + 16.0) * sums,
        }
    }
}
