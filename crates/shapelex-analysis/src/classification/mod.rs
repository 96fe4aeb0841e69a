//! Classes of shapes: which of several labelled sets a shape belongs to.
//!
//! * [`class_means`] — distance to the mean space of every class;
//! * [`atom_classes`] — the class of the best atom, and the class-wise residual of a code;
//! * [`discriminant`] — linear to quadratic discriminants of the features;
//! * [`neighbours`] — votes of the nearest training shapes;
//! * [`ensemble`] — several of these as one;
//! * [`folds`] — parts of a sample for cross-validation;
//! * [`quality`] — what a validation reports, and calibrated confidences.
//!
//! Every classifier answers an [`Evidence`] a shape: a distance to every class, for people, and a score, which ranks the
//! classes and from which confidences are made.
//!
//! Source: Schmitter 2017, sections 4.6 and 4.9; Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*,
//! chapters 4, 7 and 13.

pub mod atom_classes;
pub mod class_means;
pub mod discriminant;
pub mod ensemble;
pub mod folds;
pub mod neighbours;
pub mod quality;

use self::atom_classes::AtomClasses;
use self::class_means::ClassMeans;
use self::discriminant::{Discriminant, Regularisation};
use self::ensemble::Ensemble;
use self::neighbours::NearestNeighbours;
use super::AnalysisError;
use super::accumulate::{ShapesInMemory, map_shapes};
use super::dictionary::model::Model;
use super::dictionary::preparation::Preparation;
use super::metric::norm;
use super::sparse::SparseCode;
use shapelex_numeric::dense::Matrix;

/// Shapes with everything that classifiers look at.
#[derive(Debug, Clone, Copy)]
pub struct Observations<'a> {
    /// Whitened shapes as given, centred when the class translates: one after the other.
    pub shapes: &'a [f64],
    /// The same in the form that is coded.
    pub prepared: &'a [f64],
    /// Their codes.
    pub codes: &'a [SparseCode],
}

impl<'a> Observations<'a> {
    /// Number of shapes.
    pub fn count(&self) -> usize {
        self.codes.len()
    }

    /// Numbers of a shape.
    fn length(&self) -> usize {
        self.shapes.len() / self.count().max(1)
    }

    fn shape(&self, k: usize) -> &'a [f64] {
        &self.shapes[k * self.length()..(k + 1) * self.length()]
    }

    fn prepared(&self, k: usize) -> &'a [f64] {
        &self.prepared[k * self.length()..(k + 1) * self.length()]
    }
}

/// How shapes are described to classifiers.
#[derive(Debug, Clone, Copy)]
pub struct Description<'a> {
    /// How they are brought into pose.
    pub preparation: &'a Preparation,
    /// What they are coded in.
    pub model: &'a Model,
    /// Whether the logarithm of the size `ln ‖r − r̄‖` is a feature.
    pub size: bool,
}

impl Description<'_> {
    /// Features of the shapes, one a column: the code (scores; coefficients; for moved atoms their norms), then the
    /// logarithm of the size when that is asked for. `p × K`.
    pub fn features(&self, observations: Observations<'_>) -> Matrix {
        let atoms = self.model.len();
        let mut features = Matrix::zeros(atoms + usize::from(self.size), observations.count());
        for (k, mut column) in features.column_iter_mut().enumerate() {
            let code = &observations.codes[k];
            let block = code.values.len() / code.indices.len().max(1);
            for (&j, values) in code.indices.iter().zip(code.values.chunks_exact(block.max(1))) {
                column[j] = if block == 1 { values[0] } else { norm(values) };
            }
            if self.size {
                column[atoms] = norm(observations.shape(k)).ln();
            }
        }
        features
    }
}

/// Shapes of known classes.
#[derive(Debug, Clone, Copy)]
pub struct Labelled<'a> {
    /// The shapes.
    pub observations: Observations<'a>,
    /// Weights of the shapes in means.
    pub weights: &'a [f64],
    /// The class of every shape, from 0.
    pub classes: &'a [usize],
    /// Number of classes.
    pub count: usize,
}

impl Labelled<'_> {
    /// Shapes of every class.
    fn sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.count];
        self.classes.iter().for_each(|&c| sizes[c] += 1);
        sizes
    }
}

/// What kind of classifier.
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

/// What a classifier says about a shape, class by class.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Distance to every class: relative residual, Mahalanobis distance, or distance to the nearest member.
    pub distances: Vec<f64>,
    /// The larger, the likelier; confidences are `∝ exp(β score)`.
    pub scores: Vec<f64>,
}

impl Evidence {
    /// Of relative residuals: the score is `−d²`.
    fn of_residuals(distances: Vec<f64>) -> Self {
        let scores = distances.iter().map(|d| -d * d).collect();
        Self { distances, scores }
    }

    /// Classes from the likeliest on; of equal scores the nearer one, then the first.
    pub fn ranking(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.scores.len()).collect();
        order.sort_by(|&a, &b| {
            let by_score = self.scores[b].total_cmp(&self.scores[a]);
            by_score.then(self.distances[a].total_cmp(&self.distances[b])).then(a.cmp(&b))
        });
        order
    }

    /// The likeliest class.
    pub fn best(&self) -> usize {
        let better = |a: usize, b: usize| {
            let by_score = self.scores[a].total_cmp(&self.scores[b]);
            by_score.then(self.distances[b].total_cmp(&self.distances[a])).is_lt()
        };
        (1..self.scores.len()).fold(0, |best, c| if better(best, c) { c } else { best })
    }
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

    /// What it says about shapes, in order.
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

/// The whitened shapes at the positions `chosen`, in their order.
pub fn subset(shapes: &ShapesInMemory, chosen: &[usize]) -> ShapesInMemory {
    let all = shapes.all();
    let length = all.whitened.len() / all.weights.len().max(1);
    let whitened = chosen.iter().flat_map(|&k| &all.whitened[k * length..(k + 1) * length]).copied();
    ShapesInMemory::prepared(whitened.collect(), chosen.iter().map(|&k| all.weights[k]).collect())
}

/// Shapes in the form that is coded, one after the other, and their codes.
///
/// # Errors
/// [`AnalysisError::Degenerate`] with the position of the shape; errors of the codes.
pub fn described(
    preparation: &Preparation,
    model: &Model,
    shapes: &ShapesInMemory,
) -> Result<(Vec<f64>, Vec<SparseCode>), AnalysisError> {
    let posed = super::dictionary::preparation::Posed { source: shapes, preparation };
    let prepared = map_shapes(&posed, |_, y, _| Ok(y.to_vec()))?.concat();
    let codes = model.codes(&prepared, preparation.metric.len())?;
    Ok((prepared, codes))
}
