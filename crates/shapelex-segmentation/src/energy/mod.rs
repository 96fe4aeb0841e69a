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
//!   class of shapes; [`wall`] — a box that the shape is kept to; [`hold`] — the first shape.
//!
//! Weights do not depend on the scale of the image or of the object.

pub mod boundary_cost;
pub mod contour;
pub mod hold;
pub mod local_contrast;
pub mod prior;
pub mod shape;
pub mod spacing;
pub mod threshold;
pub mod two_class;
pub mod wall;

use shapelex_numeric::dense::Matrix;

use crate::boundary::Differential;
use crate::field::Integrated;

pub use boundary_cost::BoundaryCost;
pub use contour::Contour;
pub use hold::Hold;
pub use local_contrast::LocalContrast;
pub use prior::Prior;
pub use shape::{Polarity, Shape};
pub use spacing::Spacing;
pub use threshold::Threshold;
pub use two_class::TwoClass;
pub use wall::Wall;

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
    /// See [`Wall`].
    Wall(Wall<D>),
    /// See [`Hold`].
    Hold(Hold<D>),
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
            Self::Wall(_) => "box",
            Self::Hold(_) => "start",
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
            Self::Wall(term) => term.evaluate(shape),
            Self::Hold(term) => term.evaluate(shape),
        }
    }
}

impl<const D: usize> Term<D> {
    /// The field that acts on the boundary with a factor: to first order, the term changes by `factor ∮ F δn dS`, up to a
    /// constant in `F`. `None` for terms without an image.
    fn force(&self, shape: &Shape<'_, D>) -> Option<(&Integrated<D>, f64)> {
        match self {
            Self::Contour(term) => Some((&term.laplacian, term.polarity.sign() / term.scale)),
            Self::Threshold(term) => Some((&term.saturated, -1.0 / term.scale)),
            Self::LocalContrast(term) => {
                Some((&term.image, -2.0 * term.polarity.sign() / (term.contrast * shape.volume.value)))
            }
            Self::TwoClass(term) => Some((&term.centred, term.factor(shape))),
            Self::BoundaryCost(_) | Self::Spacing(_) | Self::Prior(_) | Self::Wall(_) | Self::Hold(_) => None,
        }
    }

    /// A positive part of the second derivatives, by rows of all coordinates of the points. `None` for boundaries that do not
    /// offer it.
    ///
    /// ```text
    /// image   ∮ max(factor ∂F/∂n, 0) φ_k φ_l n nᵀ dS
    /// ρ       that of Gauss and Newton, 8/S Σ (φ'_k r')(φ'_l r')ᵀ/m²,   m = mean |r'|²
    /// γ       2S/V^{2/d}, the volume held fixed
    /// ```
    ///
    /// The cost of the boundary has no part: its curvature is small beside that of the image. Nor have the wall, which most
    /// shapes never touch, and the attraction to the first shape.
    fn curvature(&self, shape: &Shape<'_, D>) -> Option<Matrix> {
        let size = D * shape.rows.len();
        match self {
            Self::BoundaryCost(_) | Self::Wall(_) | Self::Hold(_) => Some(Matrix::zeros(size, size)),
            Self::Spacing(_) => shape.boundary.spacing_curvature(&shape.samples),
            Self::Prior(term) => Some(term.curvature(shape)),
            _ => {
                let (field, factor) = self.force(shape)?;
                shape.boundary.curvature(&shape.samples, field, factor)
            }
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

    /// A positive part of the second derivatives; see [`Boundary::curvature`](crate::boundary::Boundary::curvature). `None` for
    /// boundaries that do not offer it.
    pub fn curvature(&self, shape: &Shape<'_, D>) -> Option<Matrix> {
        let size = D * shape.rows.len();
        let mut sum = Matrix::zeros(size, size);
        for (term, weight) in &self.terms {
            sum += term.curvature(shape)? * *weight;
        }
        Some(sum)
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
