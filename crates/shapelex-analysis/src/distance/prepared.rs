//! Shapes prepared for comparison.

use realfft::num_complex::Complex64;

use super::spectra::{HALF_ROOT, Transform, complex_spectra, spectra};
use super::{DistanceSpace, chunk};
use crate::AnalysisError;
use crate::accumulate;
use crate::alignment::Method;
use crate::fit::Scaling;
use crate::magnitudes::Magnitudes;
use crate::metric::{Metric, norm};
use crate::subspace::{Subspace, check_extent};
use shapelex_numeric::parallel;

/// Shapes prepared for comparison: orthonormal bases or points, as signals or as spectra, one set per candidate placement.
#[derive(Debug, Clone)]
pub struct PreparedShapes {
    /// `‖x‖` of shapes that keep their sizes, else 1.
    pub(super) sizes: Vec<f64>,
    /// One entry per candidate placement (without start point); the first is the shape as given.
    pub(super) laid: Vec<Columns>,
    /// For every candidate placement, if the space has bounds; else empty.
    pub(super) magnitudes: Vec<Magnitudes>,
}

#[derive(Debug, Clone)]
pub(super) enum Columns {
    Signals(Vec<f64>),
    Spectra(Vec<Complex64>),
}

impl DistanceSpace {
    /// Prepares shapes of these control points, `d·N` coordinate-major numbers each.
    ///
    /// # Errors
    /// As for [`Self::prepare`].
    pub fn prepare_given(
        &self,
        metric: &Metric,
        mut control_points: Vec<f64>,
    ) -> Result<PreparedShapes, AnalysisError> {
        accumulate::prepare(metric, self.method.translates(), 0, &mut control_points)?;
        self.prepare(&control_points)
    }

    /// Prepares whitened shapes, `d·N` numbers each, centred when the class translates.
    ///
    /// Cost `O(dN I²)` per shape and placement; with a search of start points also one FFT per column.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] or [`AnalysisError::NoExtent`] with the position of the first such shape.
    pub fn prepare(&self, whitened: &[f64]) -> Result<PreparedShapes, AnalysisError> {
        let length = self.size * self.matching.dimension();
        let candidates = self.matching.candidates();
        let columns = parallel::try_map(whitened.len() / length, &|i| {
            let x = chunk(whitened, i, length);
            let laid = candidates.iter().map(|&laid| self.columns_of(&self.matching.place(x, laid)));
            laid.collect::<Result<Vec<Vec<f64>>, _>>().map_err(|error| error.at(i))
        })?;
        let mut signals = vec![Vec::with_capacity(self.columns * whitened.len()); candidates.len()];
        for shape in columns {
            signals.iter_mut().zip(shape).for_each(|(all, one)| all.extend(one));
        }
        let laid = signals.into_iter().map(|signals| match &self.transform {
            Some(Transform::Real(fft)) => Columns::Spectra(spectra(fft, &signals)),
            Some(Transform::Complex(fft)) => Columns::Spectra(complex_spectra(fft, 1.0, &signals)),
            Some(Transform::ComplexPair(fft)) => Columns::Spectra(complex_spectra(fft, HALF_ROOT, &signals)),
            None => Columns::Signals(signals),
        });
        let laid: Vec<Columns> = laid.collect();
        let keeps_size = matches!(&self.method, Method::Procrustes(fit) if fit.scaling == Scaling::None);
        let size = |x: &[f64]| if keeps_size { norm(x) } else { 1.0 };
        let sizes = whitened.chunks_exact(length).map(size).collect();
        let magnitudes = |laid: &Columns| match (laid, self.bounded) {
            (Columns::Spectra(spectra), Some(signals)) => {
                Some(Magnitudes::new(signals, self.size, self.columns, spectra))
            }
            _ => None,
        };
        let magnitudes = laid.iter().filter_map(magnitudes).collect();
        Ok(PreparedShapes { sizes, laid, magnitudes })
    }

    /// The columns that represent the whitened shape `x`, of unit norm: products of two sizes would leave the range of numbers.
    pub(super) fn columns_of(&self, x: &[f64]) -> Result<Vec<f64>, AnalysisError> {
        match &self.method {
            Method::Projection(class) => {
                let blocks = Subspace::new(class, x)?.blocks;
                Ok(blocks.iter().flat_map(|block| block.q.iter().copied()).collect())
            }
            Method::Procrustes(_) => {
                check_extent(norm(x), norm(x))?;
                let factor = norm(x).recip();
                Ok(x.iter().map(|value| factor * value).collect())
            }
        }
    }
}

impl PreparedShapes {
    /// Number of prepared shapes.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Reserves memory for further shapes.
    pub fn reserve(&mut self, shapes: usize) {
        let count = self.count().max(1);
        self.sizes.reserve_exact(shapes);
        for laid in &mut self.laid {
            match laid {
                Columns::Signals(all) => all.reserve_exact(all.len() / count * shapes),
                Columns::Spectra(all) => all.reserve_exact(all.len() / count * shapes),
            }
        }
        self.magnitudes.iter_mut().for_each(|all| all.reserve(shapes));
    }

    /// Appends the shapes of `more`, prepared by the same space.
    pub fn append(&mut self, more: Self) {
        self.sizes.extend(more.sizes);
        self.magnitudes.iter_mut().zip(more.magnitudes).for_each(|(all, more)| all.append(more));
        for (laid, more) in self.laid.iter_mut().zip(more.laid) {
            match (laid, more) {
                (Columns::Signals(all), Columns::Signals(more)) => all.extend(more),
                (Columns::Spectra(all), Columns::Spectra(more)) => all.extend(more),
                _ => unreachable!("all shapes of a space are prepared alike"),
            }
        }
    }
}
