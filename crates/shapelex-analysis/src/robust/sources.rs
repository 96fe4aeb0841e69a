//! Sources with other weights, or with the deviations of their shapes.

use shapelex_numeric::parallel;

use super::weiszfeld::NEAREST;
use crate::AnalysisError;
use crate::accumulate::{
    BLOCK, Reservation, ShapeSource, Shapes, ShapesInMemory, VisitMarked, for_each_changed,
};
use crate::alignment::Method;
use crate::fit::{Scaling, cross_product, transform};
use crate::metric::{dot, norm};
use crate::subspace::{Subspace, turn};
use crate::transformation::{Structure, TransformationClass};

/// The shapes of a source with the weights `w_k f_k`. Only this process knows the factors, so no pass is distributed.
pub(crate) struct Reweighted<'a> {
    pub(crate) source: &'a dyn ShapeSource,
    /// One factor for each shape, zero or more.
    pub(crate) factors: &'a [f64],
}

impl ShapeSource for Reweighted<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.source.for_each_batch(&mut |batch| {
            let factors = &self.factors[batch.first..batch.first + batch.weights.len()];
            let weights: Vec<f64> = batch.weights.iter().zip(factors).map(|(w, f)| w * f).collect();
            visit(Shapes { weights: &weights, ..batch })
        })
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.source.located(error)
    }
}

/// The shapes of a source with the weights `w_k / max(‖A_k x_k − m‖, ε)`: a step of Weiszfeld for Procrustes fits.
pub(super) struct ByDistance<'a> {
    pub(super) source: &'a dyn ShapeSource,
    pub(super) method: &'a Method,
    /// `m`, whitened.
    pub(super) mean: &'a [f64],
}

impl ShapeSource for ByDistance<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let least = NEAREST * norm(self.mean);
        self.source.for_each_batch(&mut |batch| {
            let length = self.mean.len();
            let weight = |i: usize| {
                let x = &batch.whitened[i * length..(i + 1) * length];
                let near = self.method.bring(x, self.mean).map_err(|error| error.at(batch.first + i))?;
                let away: f64 = near.whitened.iter().zip(self.mean).map(|(y, m)| (y - m).powi(2)).sum();
                Ok::<_, AnalysisError>(batch.weights[i] / away.sqrt().max(least))
            };
            let weights = parallel::try_map(batch.weights.len(), &weight)?;
            visit(Shapes { weights: &weights, ..batch })
        })
    }
}

/// The deviation of the whitened shape `x` from the centre `m`, in the chart in which members of the class are straight.
///
/// ```text
/// a = y X − m,   y = P m = A x (N × d),   X such that mᵀ(y X) = mᵀm
/// ```
///
/// The nearest member `P m` alone shrinks by the square of its angle, so that shapes along a mode would lie on a curve, and the
/// extreme ones leave the components of the others. `X` is a `d × d` matrix for linear classes, a number for each axis or one
/// number for the others, and one where sizes are kept. Shapes nearly orthogonal to the centre are scaled by at most [`MOST_SCALED`].
///
/// # Errors
/// [`AnalysisError::Degenerate`] with index 0.
fn deviation(method: &Method, x: &[f64], centre: &[f64]) -> Result<Vec<f64>, AnalysisError> {
    if let Method::Projection(class) = method
        && class.structure == Structure::Complex
    {
        return deviation_of_complex(class, x, centre);
    }
    let mut y = method.bring(x, centre)?.whitened;
    let scale = |y: &mut [f64], m: &[f64]| {
        let (size, product) = (dot(m, m), dot(y, m));
        let factor = if product * MOST_SCALED > size { size / product } else { 1.0 };
        y.iter_mut().for_each(|value| *value *= factor);
    };
    match method {
        Method::Procrustes(fit) if fit.scaling == Scaling::None => {}
        Method::Projection(class) if class.structure == Structure::PerCoordinate => {
            let d = class.dimension();
            let products = cross_product(centre, &y, d);
            let own = cross_product(centre, centre, d);
            let singular = products.singular_values();
            let inverse = products.try_inverse().filter(|_| singular.min() * MOST_SCALED > own.trace());
            if let Some(inverse) = inverse {
                // Rows of the shapes here are coordinates: (y X)ᵀ = Xᵀ yᵀ.
                y = transform(&(own * inverse), &y);
            }
        }
        Method::Projection(class) if class.structure == Structure::PerAxis => {
            let n = y.len() / class.dimension();
            y.chunks_exact_mut(n).zip(centre.chunks_exact(n)).for_each(|(y, m)| scale(y, m));
        }
        _ => scale(&mut y, centre),
    }
    y.iter_mut().zip(centre).for_each(|(y, m)| *y -= m);
    Ok(y)
}

/// [`deviation`] in the span of `q` and `J q`: `P m = a q + b J q` with `a = ⟨q, m⟩`, `b = ⟨J q, m⟩`, and `⟨P m, m⟩ = a² + b²`.
fn deviation_of_complex(
    class: &TransformationClass,
    x: &[f64],
    centre: &[f64],
) -> Result<Vec<f64>, AnalysisError> {
    let (mut q, mut away) = (vec![0.0; x.len()], vec![0.0; x.len()]);
    Subspace::write_basis(class, x, 1.0, &mut q)?;
    turn(&q, &mut away);
    let (a, b, size) = (dot(&q, centre), dot(&away, centre), dot(centre, centre));
    let product = a * a + b * b;
    let factor = if product * MOST_SCALED > size { size / product } else { 1.0 };
    for ((away, q), m) in away.iter_mut().zip(&q).zip(centre) {
        *away = factor * (a * q + b * *away) - m;
    }
    Ok(away)
}

/// Largest factor of a shape in the chart of [`deviation`].
const MOST_SCALED: f64 = 1e3;

/// The [deviations](deviation) `a_k` of the shapes of a source, with their weights: computed once, or in every pass where they do
/// not fit in memory.
pub(super) struct Deviations<'a> {
    source: &'a dyn ShapeSource,
    method: &'a Method,
    /// `m`, whitened.
    centre: &'a [f64],
    kept: Option<ShapesInMemory>,
}

impl<'a> Deviations<'a> {
    /// From the whitened `centre`; in memory if `keep`.
    pub(super) fn new(
        source: &'a dyn ShapeSource,
        method: &'a Method,
        centre: &'a [f64],
        keep: bool,
    ) -> Result<Self, AnalysisError> {
        let mut deviations = Self { source, method, centre, kept: None };
        if keep {
            deviations.kept = Some(ShapesInMemory::of(&deviations)?);
        }
        Ok(deviations)
    }

    /// `m`.
    pub(super) fn centre(&self) -> &'a [f64] {
        self.centre
    }
}

/// Deviation, as a fraction of the norm of the mean, that is rounding error.
pub(super) const ROUNDING: f64 = 1e-8;

impl ShapeSource for Deviations<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        if let Some(kept) = &self.kept {
            self.source.check()?;
            self.source.worked(self.source.count());
            return visit(kept.all());
        }
        let length = self.centre.len();
        let change = |batch: Shapes<'_>, whitened: &mut [f64]| {
            parallel::try_for_each_chunk(whitened, length, &|i, x| {
                let away =
                    deviation(self.method, x, self.centre).map_err(|error| error.at(batch.first + i))?;
                x.copy_from_slice(&away);
                Ok(())
            })
        };
        for_each_changed(self.source, change, visit)
    }
}

/// The deviations of a source with the weights `w_k/‖a_k‖²`, zero for shapes at the centre: their outer products are those of the spatial signs
/// `a_k/‖a_k‖`.
pub(super) struct Signs<'a>(pub(super) &'a Deviations<'a>);

impl ShapeSource for Signs<'_> {
    fn count(&self) -> usize {
        self.0.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let (length, least) = (self.0.centre.len(), (ROUNDING * norm(self.0.centre)).powi(2));
        self.0.for_each_batch(&mut |batch| {
            let of = |i: usize| {
                let a = &batch.whitened[i * length..(i + 1) * length];
                match dot(a, a) {
                    square if square > least => batch.weights[i] / square,
                    _ => 0.0,
                }
            };
            let weights = parallel::map(batch.weights.len(), &of);
            visit(Shapes { weights: &weights, ..batch })
        })
    }
}

/// The shapes of a source whose factor is positive, with the weights `w_k f_k`. Positions count these shapes only.
pub(crate) struct Retained<'a> {
    source: &'a dyn ShapeSource,
    factors: &'a [f64],
    count: usize,
}

/// Number of retained shapes per batch.
const BATCH: usize = 16 * BLOCK;

impl<'a> Retained<'a> {
    /// The shapes of `source` with a positive one of `factors`, which has one for each.
    pub(crate) fn new(source: &'a dyn ShapeSource, factors: &'a [f64]) -> Self {
        let count = factors.iter().filter(|factor| **factor > 0.0).count();
        Self { source, factors, count }
    }
}

impl ShapeSource for Retained<'_> {
    fn count(&self) -> usize {
        self.count
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        self.source.reserve(bytes)
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let (mut whitened, mut weights, mut first) = (Vec::new(), Vec::new(), 0);
        self.source.for_each_batch(&mut |batch| {
            for (k, x, weight) in batch.iter().filter(|(k, ..)| self.factors[*k] > 0.0) {
                whitened.extend_from_slice(x);
                weights.push(weight * self.factors[k]);
                if weights.len() == BATCH {
                    visit(Shapes { first, whitened: &whitened, weights: &weights })?;
                    first += BATCH;
                    whitened.clear();
                    weights.clear();
                }
            }
            Ok(())
        })?;
        if weights.is_empty() {
            return Ok(());
        }
        visit(Shapes { first, whitened: &whitened, weights: &weights })
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        let mut first = 0;
        self.source.for_each_marked(&mut |batch, all| {
            let (mut whitened, mut weights, mut marks) = (Vec::new(), Vec::new(), Vec::new());
            for ((k, x, weight), mark) in batch.iter().zip(all).filter(|((k, ..), _)| self.factors[*k] > 0.0)
            {
                whitened.extend_from_slice(x);
                weights.push(weight * self.factors[k]);
                marks.push(*mark);
            }
            if !weights.is_empty() {
                visit(Shapes { first, whitened: &whitened, weights: &weights }, &marks)?;
            }
            first += marks.len();
            Ok(())
        })
    }
}
