//! The trait of dictionary methods: one implementation of `Procedure` for each variant of [`Method`].

use super::components::Components;
use super::content::Content;
use super::downdate::Downdate;
use super::learning::Learning;
use super::method::Method;
use super::model::Model;
use super::sparse_atoms::SparseAtoms;
use super::work::{Cost, Size};
use crate::AnalysisError;
use crate::accumulate::ShapeSource;
use crate::alignment::Method as Alignment;
use crate::partial_sums::Measured;
use crate::preparation::{Pose, Preparation};
use crate::watch::Watch;

/// An earlier version of a dictionary, from which learning continues.
#[derive(Debug, Clone, Copy)]
pub struct Previous<'a> {
    /// Its content.
    pub content: &'a Content,
    /// The sums from which it was computed, as returned by learning.
    pub state: &'a [u8],
}

/// A parameter out of its range, or that does not suit the others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterFault {
    /// Path of the parameter, with dots.
    pub field: &'static str,
    /// The expected and the actual value.
    pub detail: String,
}

impl From<ParameterFault> for AnalysisError {
    fn from(ParameterFault { field, detail }: ParameterFault) -> Self {
        Self::Parameter { field, detail }
    }
}

/// A field of a content that learning never produces, with the expectation.
pub type Inconsistency = (&'static str, &'static str);

/// How a method learns atoms from prepared shapes, and how its atoms are used.
pub(super) trait Procedure {
    /// Number of atoms or components requested.
    fn atoms(&self) -> usize;

    /// Whether shapes are coded with few of many atoms, not with the scores of all components.
    fn is_sparse(&self) -> bool;

    /// Whether every atom is a shape; differences of shapes are not.
    fn atoms_are_shapes(&self) -> bool;

    /// Whether coefficients must be non-negative.
    fn is_nonnegative(&self) -> bool {
        false
    }

    /// Seed of all random choices; `None` if there are none.
    fn seed(&self) -> Option<u64> {
        None
    }

    /// Maximum number of passes over the shapes.
    fn max_epochs(&self) -> usize {
        1
    }

    /// Minimum number of shapes to learn from, besides that of a mean.
    fn needed_shapes(&self) -> usize {
        0
    }

    /// Number of numbers that describe each of `shapes` shapes of `length` numbers.
    fn described(&self, shapes: usize, length: usize) -> usize;

    /// Parameters out of range, for at most `max_atoms` atoms.
    fn faults(&self, max_atoms: usize) -> Vec<ParameterFault>;

    /// Parts of a content that do not fit the method, apart from the sizes of shapes; `bounded` tests numbers.
    fn inconsistencies(&self, content: &Content, bounded: &dyn Fn(&[f64]) -> bool) -> Vec<Inconsistency>;

    /// Form of the shapes for coding.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `method.codes` if the alignment does not suit the method.
    fn pose(&self, alignment: &Alignment) -> Result<Pose, AnalysisError>;

    /// How atoms are learnt by coding shapes; `None` if they are not.
    ///
    /// # Errors
    /// As [`Self::pose`].
    fn learning(&self, alignment: &Alignment) -> Result<Option<Learning>, AnalysisError> {
        let _ = alignment;
        Ok(None)
    }

    /// Learns from prepared shapes into `content`, and returns the sums from which learning can continue.
    ///
    /// # Errors
    /// Errors of the source; [`AnalysisError::Interrupted`]; [`AnalysisError::NotAnAccumulator`] for sums of another
    /// dictionary.
    fn fit(
        &self,
        shapes: &dyn ShapeSource,
        previous: Option<Previous<'_>>,
        preparation: &Preparation,
        content: &mut Content,
        watch: &dyn Watch,
    ) -> Result<Vec<u8>, AnalysisError>;

    /// The learnt atoms in use.
    ///
    /// # Errors
    /// As [`Self::pose`].
    fn model(&self, content: &Content, measured: Measured<'_>) -> Result<Model, AnalysisError>;

    /// Exact leave-one-out statistics from the sums of `shapes` shapes; `None` if the method has none.
    ///
    /// # Errors
    /// A failure of the eigenproblem; [`AnalysisError::NotAnAccumulator`].
    fn downdate(
        &self,
        content: &Content,
        preparation: &Preparation,
        state: &[u8],
        shapes: usize,
    ) -> Result<Option<Downdate>, AnalysisError>;

    /// Predicted cost of learning.
    fn cost(&self, size: Size) -> Cost;
}

/// Evaluates an expression for the procedure of a method: the one place that tells methods apart.
macro_rules! with_procedure {
    ($method:expr, $procedure:ident => $value:expr) => {
        match $method {
            &Method::FunctionalPca { components, centre } => {
                let $procedure = Components { components, centre };
                $value
            }
            &Method::Sparse {
                atoms,
                lambda,
                nonzeros,
                codes,
                nonnegative,
                normalise,
                seed,
                max_epochs,
                tolerance,
                schedule,
            } => {
                let $procedure = SparseAtoms {
                    atoms,
                    lambda,
                    nonzeros,
                    codes,
                    nonnegative,
                    normalise,
                    seed,
                    max_epochs,
                    tolerance,
                    schedule,
                };
                $value
            }
        }
    };
}

impl Method {
    /// Number of atoms or components requested.
    pub fn atoms(&self) -> usize {
        with_procedure!(self, procedure => procedure.atoms())
    }

    /// Whether shapes are coded with few of many atoms, not with the scores of all components.
    pub fn is_sparse(&self) -> bool {
        with_procedure!(self, procedure => procedure.is_sparse())
    }

    /// Whether every atom is a shape; components about a centre are differences of shapes.
    pub fn atoms_are_shapes(&self) -> bool {
        with_procedure!(self, procedure => procedure.atoms_are_shapes())
    }

    /// Whether coefficients must be non-negative.
    pub fn is_nonnegative(&self) -> bool {
        with_procedure!(self, procedure => procedure.is_nonnegative())
    }

    /// Seed of all random choices; `None` if there are none.
    pub fn seed(&self) -> Option<u64> {
        with_procedure!(self, procedure => procedure.seed())
    }

    /// Maximum number of passes over the shapes.
    pub fn max_epochs(&self) -> usize {
        with_procedure!(self, procedure => procedure.max_epochs())
    }

    /// Minimum number of shapes to learn from, besides that of a mean.
    pub fn needed_shapes(&self) -> usize {
        with_procedure!(self, procedure => procedure.needed_shapes())
    }

    /// Number of numbers that describe each of `shapes` shapes of `length` numbers.
    pub fn described(&self, shapes: usize, length: usize) -> usize {
        with_procedure!(self, procedure => procedure.described(shapes, length))
    }

    /// Parameters out of range, for at most `max_atoms` atoms.
    pub fn faults(&self, max_atoms: usize) -> Vec<ParameterFault> {
        with_procedure!(self, procedure => procedure.faults(max_atoms))
    }

    /// Parts of a content that do not fit the method, apart from the sizes of shapes; `bounded` tests numbers.
    pub fn inconsistencies(&self, content: &Content, bounded: &dyn Fn(&[f64]) -> bool) -> Vec<Inconsistency> {
        with_procedure!(self, procedure => procedure.inconsistencies(content, bounded))
    }

    /// Form of the shapes for coding.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `method.codes` if the alignment does not suit the method.
    pub fn pose(&self, alignment: &Alignment) -> Result<Pose, AnalysisError> {
        with_procedure!(self, procedure => procedure.pose(alignment))
    }

    /// How atoms are learnt by coding shapes; `None` if they are not.
    ///
    /// # Errors
    /// As [`Self::pose`].
    pub fn learning(&self, alignment: &Alignment) -> Result<Option<Learning>, AnalysisError> {
        with_procedure!(self, procedure => procedure.learning(alignment))
    }

    /// Predicted cost of learning.
    pub fn cost(&self, size: Size) -> Cost {
        with_procedure!(self, procedure => procedure.cost(size))
    }

    pub(super) fn fit(
        &self,
        shapes: &dyn ShapeSource,
        previous: Option<Previous<'_>>,
        preparation: &Preparation,
        content: &mut Content,
        watch: &dyn Watch,
    ) -> Result<Vec<u8>, AnalysisError> {
        with_procedure!(self, procedure => procedure.fit(shapes, previous, preparation, content, watch))
    }

    pub(super) fn model(&self, content: &Content, measured: Measured<'_>) -> Result<Model, AnalysisError> {
        with_procedure!(self, procedure => procedure.model(content, measured))
    }

    pub(super) fn downdate(
        &self,
        content: &Content,
        preparation: &Preparation,
        state: &[u8],
        shapes: usize,
    ) -> Result<Option<Downdate>, AnalysisError> {
        with_procedure!(self, procedure => procedure.downdate(content, preparation, state, shapes))
    }
}
