//! The tangent space at the mean, in which linear statistics compare shapes of unit size.
//!
//! Sources: Kent and Mardia 2001 (tangent coordinates); Adams and Otárola-Castillo 2013 (geomorph, which projects partial Procrustes
//! fits in this way).

use super::alignment::Alignment;
use super::metric::{dot, norm};
use super::transformation::Transformation;
use super::{AnalysisError, DEGENERATE};

/// Alignment of shapes for linear statistics: a method, and whether the aligned shapes are moved, at unit size, into the tangent
/// space at their mean ([`to_tangent`]).
///
/// Without it a projected shape shrinks with the roughness of the shape (`‖P_k m‖ = cos θ_k`), and so does a full Procrustes fit:
/// averages of groups that differ in scatter alone would differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinearAlignment {
    /// The method.
    pub alignment: Alignment,
    /// Whether aligned shapes are moved into the tangent space.
    pub tangent: bool,
}

impl LinearAlignment {
    /// The alignment of the shapes of a test, from that of a request: partial Procrustes fits by name are moved into the tangent
    /// space, projections and full Procrustes fits by name are not.
    ///
    /// # Errors
    /// [`AnalysisError::NotAProperClass`] for `tangent` with a class that keeps sizes.
    pub fn of_test(
        transformation: &Transformation,
        dimension: usize,
        alignment: Option<Alignment>,
        tangent: Option<bool>,
    ) -> Result<Self, AnalysisError> {
        let by_name = alignment.map(|alignment| alignment == Alignment::PartialProcrustes);
        Self::new(transformation, dimension, alignment, tangent.or(by_name))
    }

    /// The alignment of the shapes of components, from that of a request: aligned shapes of a method by name are not moved.
    ///
    /// # Errors
    /// As [`Self::of_test`].
    pub fn of_components(
        transformation: &Transformation,
        dimension: usize,
        alignment: Option<Alignment>,
        tangent: Option<bool>,
    ) -> Result<Self, AnalysisError> {
        Self::new(transformation, dimension, alignment, tangent.or(alignment.map(|_| false)))
    }

    /// Without `alignment`: the projection where the class is a linear space, partial Procrustes fits for similarity in space.
    /// Without `tangent`: in the tangent space where the class removes size.
    fn new(
        transformation: &Transformation,
        dimension: usize,
        alignment: Option<Alignment>,
        tangent: Option<bool>,
    ) -> Result<Self, AnalysisError> {
        let removes_size = transformation.removes_size();
        let alignment = alignment.unwrap_or_else(|| match Alignment::usual(transformation, dimension) {
            Alignment::Procrustes if removes_size => Alignment::PartialProcrustes,
            usual => usual,
        });
        match tangent {
            Some(true) if !removes_size => Err(AnalysisError::NotAProperClass(
                "expected false with a class that keeps sizes, got true".into(),
            )),
            _ => Ok(Self { alignment, tangent: tangent.unwrap_or(removes_size) }),
        }
    }
}

/// Moves an aligned shape `y` into the tangent space at the mean `m`, at unit size: `z = y/‖y‖`, then
/// `z + (1 − ⟨z, m⟩/‖m‖²) m`; all whitened.
///
/// For the projection `y = P_k m` on a mean of unit norm the result is `m + y/‖y‖ − ‖y‖ m`. Cost: three passes over the coordinates.
///
/// # Errors
/// [`AnalysisError::Degenerate`] with index 0 for a shape whose alignment to the mean has no extent.
pub fn to_tangent(mean: &[f64], shape: &mut [f64]) -> Result<(), AnalysisError> {
    let (size, squared) = (norm(shape), dot(mean, mean));
    if !(size >= DEGENERATE * squared.sqrt()) {
        let class = "alignment to the mean, to which it is orthogonal".into();
        return Err(AnalysisError::Degenerate { index: 0, class, sigma: size / squared.sqrt() });
    }
    let along = 1.0 - dot(shape, mean) / (size * squared);
    shape.iter_mut().zip(mean).for_each(|(y, m)| *y = *y / size + along * m);
    Ok(())
}
