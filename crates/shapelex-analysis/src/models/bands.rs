//! Bands of predicted shapes.
//!
//! ```text
//! cov ŷ_0(t) = h_0 Σ(t),   Σ(t) = Σ_k w_k e_k(t) e_k(t)ᵀ/df_E            e(t) = φ(t)ᵀ c, d coordinates
//! pointwise:    t_{df_E, (1 + level)/2} √(h_0 Σ_ii(t))                    of a new shape: √(1 + h_0) in place of √h_0
//! simultaneous: the factor is the quantile of max_t ‖ŷ*_0(t) − ŷ_0(t)‖/√(h_0 tr Σ(t)) over redrawn residuals
//! ```
//!
//! Residuals are divided by `√(1 − h_kk)` before they are drawn: bands of undivided ones are too narrow by `√(1 − p/n)`.
//!
//! Source: Davison and Hinkley 1997.

use super::anova::{Model, Testing};
use super::error::ModelError;
use super::resample::Functions;
use crate::inference::aligned::AlignedShapes;
use crate::quantile::{quantile, student_quantile};
use crate::rows::rows_of;
use crate::watch::Watch;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// Bands that are asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bands {
    /// Level, between 0 and 1.
    pub level: f64,
    /// Number of places along curves.
    pub samples: usize,
}

/// Bands of a prediction.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BandRecord {
    /// Level.
    pub level: f64,
    /// Places along the predicted shape; of a number, itself.
    pub points: Vec<Vec<f64>>,
    /// Half width of the pointwise interval of each coordinate of each place.
    pub half_width: Vec<Vec<f64>>,
    /// Factor by which the half widths are larger for a new shape rather than the mean.
    pub new_shape: f64,
    /// Standard deviation of each place: the root of the trace of its covariance.
    pub deviation: Vec<f64>,
    /// Covariance of each place: the entries on and below the diagonal, row by row.
    pub covariance: Vec<Vec<f64>>,
    /// Factor of the deviations for a band that holds all places at once; null without permutations, and with blocks, whose shapes are not
    /// independent.
    pub simultaneous: Option<f64>,
}

/// Covariances of the residuals at places.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spread {
    /// `Σ(t)`, the lower triangle row by row.
    pub(super) covariances: Vec<Vec<f64>>,
    traces: Vec<f64>,
    pub(super) dimension: usize,
    /// Degrees of freedom of the residuals.
    pub(super) degrees: usize,
}

impl Spread {
    /// Covariances of residuals, given at places, coordinate-major, one shape a column.
    fn of(residuals: &Matrix, dimension: usize, degrees: usize) -> Self {
        let count = residuals.nrows() / dimension;
        let entry = |i: usize, a: usize, b: usize| {
            residuals.row(a * count + i).dot(&residuals.row(b * count + i)) / degrees as f64
        };
        let of = |i: usize| {
            (0..dimension).flat_map(|a| (0..=a).map(move |b| (a, b))).map(|(a, b)| entry(i, a, b)).collect()
        };
        Self::new((0..count).map(of).collect(), dimension, degrees)
    }

    pub(super) fn new(covariances: Vec<Vec<f64>>, dimension: usize, degrees: usize) -> Self {
        let mut spread = Self { covariances, traces: Vec::new(), dimension, degrees };
        spread.traces = (0..spread.covariances.len()).map(|i| spread.variances(i).iter().sum()).collect();
        spread
    }

    /// Variances of the coordinates of a place.
    fn variances(&self, i: usize) -> Vec<f64> {
        (0..self.dimension).map(|a| self.covariances[i][a * (a + 3) / 2]).collect()
    }

    /// The band of a prediction whose places are given, coordinate-major.
    pub(super) fn band(
        &self,
        level: f64,
        leverage: f64,
        points: &[f64],
        simultaneous: Option<f64>,
    ) -> BandRecord {
        let points = rows_of(points, self.dimension);
        let factor = student_quantile(0.5 * (1.0 + level), self.degrees);
        let variances = |i: usize| self.variances(i).into_iter().map(|variance| leverage * variance);
        let half_width = |i: usize| variances(i).map(|variance| factor * variance.max(0.0).sqrt()).collect();
        let scaled = |covariance: &Vec<f64>| covariance.iter().map(|value| leverage * value).collect();
        BandRecord {
            level,
            half_width: (0..points.len()).map(half_width).collect(),
            new_shape: if leverage > 0.0 { (1.0 / leverage + 1.0).sqrt() } else { 1.0 },
            deviation: (0..points.len()).map(|i| variances(i).sum::<f64>().max(0.0).sqrt()).collect(),
            covariance: self.covariances.iter().map(scaled).collect(),
            points,
            simultaneous,
        }
    }

    /// `max_t ‖δ(t)‖/√(h_0 tr Σ(t))` of a change of the places, coordinate-major.
    pub(super) fn largest(&self, leverage: f64, change: &[f64]) -> f64 {
        let count = self.traces.len();
        let square = |i: usize| (0..self.dimension).map(|a| change[a * count + i].powi(2)).sum::<f64>();
        let ratio = |(i, trace): (usize, &f64)| {
            if *trace > 0.0 { square(i) / (leverage * trace) } else { 0.0 }
        };
        self.traces.iter().enumerate().map(ratio).fold(0.0, f64::max).sqrt()
    }
}

/// The quantile of the largest changes at a level; none without draws.
pub(super) fn factor_at(mut largest: Vec<f64>, level: f64) -> Option<f64> {
    largest.sort_by(f64::total_cmp);
    (!largest.is_empty()).then(|| quantile(&largest, level))
}

/// Where shapes are followed; numbers are followed as they are.
pub(super) struct Followed<'a> {
    shapes: Option<(&'a AlignedShapes<'a>, Places)>,
}

impl<'a> Followed<'a> {
    pub(super) fn new(shapes: Option<&'a AlignedShapes<'a>>, samples: usize) -> Self {
        let along = |shapes: &'a AlignedShapes<'a>| (shapes, Places::along(shapes.space.space, samples));
        Self { shapes: shapes.map(along) }
    }

    /// Vectors, one a column, at the places, coordinate-major.
    pub(super) fn at(&self, vectors: Matrix) -> Matrix {
        match &self.shapes {
            Some((shapes, places)) => shapes.points(&vectors, places),
            None => vectors,
        }
    }

    fn dimension(&self) -> usize {
        self.shapes.as_ref().map_or(1, |(shapes, _)| shapes.space.metric.dimension())
    }
}

impl Model {
    /// Bands of the predictions of `rows`, whose vectors and leverages are given. Shapes are followed at places, numbers themselves.
    ///
    /// # Errors
    /// Random parts; an end of the time.
    pub fn bands(
        &self,
        bands: Bands,
        (rows, leverages): (&[Vec<f64>], &[f64]),
        shapes: Option<&AlignedShapes<'_>>,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Vec<BandRecord>, ModelError> {
        self.check_fixed("bands")?;
        let names = (0..rows.len()).map(|k| format!("at/{k}")).collect();
        let functions = Functions::new(self, names, rows, "at")?;
        let one = vec![0; self.design.shapes()];
        let strata = testing.strata.unwrap_or(&one);
        let followed = Followed::new(shapes, bands.samples);
        let (spread, points) = (self.spread(&followed), followed.at(functions.vectors(self)));
        let mut largest = vec![Vec::new(); rows.len()];
        // Shapes of blocks are not independent.
        if testing.blocks.is_none() {
            let drawn = followed.at(self.drawn_residuals(strata));
            let of = |changes: Matrix| -> Vec<f64> {
                let of =
                    |(k, leverage): (usize, &f64)| spread.largest(*leverage, changes.column(k).as_slice());
                leverages.iter().enumerate().map(of).collect()
            };
            for values in self.redrawn((&functions, &drawn), strata, testing, &of, watch)? {
                largest.iter_mut().zip(values).for_each(|(list, value)| list.push(value));
            }
        }
        let record = |(k, (leverage, largest)): (usize, (&f64, Vec<f64>))| {
            let simultaneous = factor_at(largest, bands.level);
            spread.band(bands.level, *leverage, points.column(k).as_slice(), simultaneous)
        };
        Ok(leverages.iter().zip(largest).enumerate().map(record).collect())
    }

    /// Covariances of the residuals at places.
    pub(super) fn spread(&self, followed: &Followed<'_>) -> Spread {
        Spread::of(&followed.at(self.residuals()), followed.dimension(), self.degrees())
    }
}
