//! Energies of shapes: dimensionless terms, each with the exact gradient of its discrete sum.
//!
//! ```text
//! E = Σ_i w_i E_i
//! ```
//!
//! * [`shape`] — a shape with its samples;
//! * [`contour`] — flux of the gradient through the boundary; [`threshold`] — region brighter than a level;
//! * [`local_contrast`] — mean inside against a shell; [`two_class`] — two means, without a polarity;
//! * [`boundary_cost`] — size of the boundary; [`spacing`] — evenness of the parameterisation; [`prior`] — distance from a
//!   class of shapes.
//!
//! Weights do not depend on the scale of the image or of the object.

pub mod boundary_cost;
pub mod contour;
pub mod local_contrast;
pub mod prior;
pub mod shape;
pub mod spacing;
pub mod threshold;
pub mod two_class;

use crate::boundary::Differential;

pub use boundary_cost::BoundaryCost;
pub use contour::Contour;
pub use local_contrast::LocalContrast;
pub use prior::Prior;
pub use shape::{Polarity, Shape};
pub use spacing::Spacing;
pub use threshold::Threshold;
pub use two_class::TwoClass;

/// A term of an energy.
#[derive(Debug, Clone)]
pub enum Term<const D: usize> {
    /// See [`Contour`].
    Contour(Contour<D>),
    /// See [`Threshold`].
    Threshold(Threshold<D>),
    /// See [`LocalContrast`].
    LocalContrast(LocalContrast<D>),
    /// See [`TwoClass`].
    TwoClass(TwoClass<D>),
    /// See [`BoundaryCost`].
    BoundaryCost(BoundaryCost),
    /// See [`Spacing`].
    Spacing(Spacing),
    /// See [`Prior`].
    Prior(Prior<D>),
}

impl<const D: usize> Term<D> {
    /// Name in answers.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Contour(_) => "contour",
            Self::Threshold(_) => "threshold",
            Self::LocalContrast(_) => "local_contrast",
            Self::TwoClass(_) => "two_class",
            Self::BoundaryCost(_) => "boundary",
            Self::Spacing(_) => "spacing",
            Self::Prior(_) => "prior",
        }
    }

    /// Value and gradient. The value is infinite for shapes on which the term is not defined.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        match self {
            Self::Contour(term) => term.evaluate(shape),
            Self::Threshold(term) => term.evaluate(shape),
            Self::LocalContrast(term) => term.evaluate(shape),
            Self::TwoClass(term) => term.evaluate(shape),
            Self::BoundaryCost(term) => term.evaluate(shape),
            Self::Spacing(term) => term.evaluate(shape),
            Self::Prior(term) => term.evaluate(shape),
        }
    }
}

/// The value of a term, and its share of the energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TermValue {
    /// Name of the term.
    pub name: &'static str,
    /// The value without its weight.
    pub value: f64,
    /// The value times the weight.
    pub weighted: f64,
}

/// A weighted sum of terms.
#[derive(Debug, Clone)]
pub struct Energy<const D: usize> {
    /// Terms with their weights.
    pub terms: Vec<(Term<D>, f64)>,
}

impl<const D: usize> Energy<D> {
    /// The energy and its gradient.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let mut sum = Differential::zero(shape.rows.len());
        for (term, weight) in &self.terms {
            let part = term.evaluate(shape);
            sum.value += weight * part.value;
            sum.add_gradient(*weight, &part.gradient);
        }
        sum
    }

    /// The terms one by one.
    pub fn values(&self, shape: &Shape<'_, D>) -> Vec<TermValue> {
        let value = |(term, weight): &(Term<D>, f64)| {
            let value = term.evaluate(shape).value;
            TermValue { name: term.name(), value, weighted: weight * value }
        };
        self.terms.iter().map(value).collect()
    }
}
