//! The choice among classifiers.

use super::atom_classes::AtomClasses;
use super::class_means::ClassMeans;
use super::discriminant::{Discriminant, Regularisation};
use super::ensemble::Ensemble;
use super::neighbours::NearestNeighbours;
use super::observations::{Description, Evidence, Labelled, Observations};
use crate::AnalysisError;

/// Kind of classifier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// Distance to the mean space of every class.
    MeanSpace,
    /// Class of the atom that correlates best.
    NearestAtom,
    /// Class whose atoms leave least of the shape.
    SparseResidual,
    /// Regularised discriminant.
    Discriminant(Regularisation),
    /// Votes of the nearest training shapes.
    NearestNeighbours {
        /// How many vote.
        neighbours: usize,
    },
}

/// A classifier that was trained.
#[derive(Debug, Clone, PartialEq)]
pub enum Classifier {
    /// Distance to the mean space of every class.
    MeanSpace(ClassMeans),
    /// Class of the atom that correlates best.
    NearestAtom(AtomClasses),
    /// Class whose atoms leave least of the shape.
    SparseResidual(AtomClasses),
    /// Regularised discriminant.
    Discriminant(Discriminant),
    /// Votes of the nearest training shapes.
    NearestNeighbours(NearestNeighbours),
    /// The mean of several.
    Ensemble(Ensemble),
}

impl Classifier {
    /// Trains on labelled shapes; every class has at least one.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with the position of the shape; [`AnalysisError::SingularCovariance`] of a
    /// discriminant.
    pub fn train(
        kind: Kind,
        description: Description<'_>,
        sample: Labelled<'_>,
    ) -> Result<Self, AnalysisError> {
        Ok(match kind {
            Kind::MeanSpace => Self::MeanSpace(ClassMeans::train(description.preparation, sample)?),
            Kind::NearestAtom => Self::NearestAtom(AtomClasses::by_correlation(description.model, sample)),
            Kind::SparseResidual => Self::SparseResidual(AtomClasses::by_use(description.model, sample)),
            Kind::Discriminant(regularisation) => {
                let features = description.features(sample.observations);
                Self::Discriminant(Discriminant::train(&features, description.size, sample, regularisation)?)
            }
            Kind::NearestNeighbours { neighbours } => {
                let features = description.features(sample.observations);
                let nearest = NearestNeighbours::train(features, description.size, sample, neighbours);
                Self::NearestNeighbours(nearest)
            }
        })
    }

    /// Its evidence about shapes, in order.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with the position of the shape.
    pub fn evidence(
        &self,
        description: Description<'_>,
        observations: Observations<'_>,
    ) -> Result<Vec<Evidence>, AnalysisError> {
        Ok(match self {
            Self::MeanSpace(means) => return means.evidence(description.preparation, observations),
            Self::NearestAtom(atoms) => atoms.correlations(description.model, observations),
            Self::SparseResidual(atoms) => atoms.residuals(description.model, observations),
            Self::Discriminant(discriminant) => discriminant.evidence(&description.features(observations)),
            Self::NearestNeighbours(nearest) => nearest.evidence(&description.features(observations)),
            Self::Ensemble(ensemble) => return ensemble.evidence(description, observations),
        })
    }
}
