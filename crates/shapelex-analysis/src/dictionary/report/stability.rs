//! Stability: components of resampled subjects beside those of all.

use super::interval::Interval;
use super::sample::Sample;
use crate::AnalysisError;
use crate::quantile::quantile;
use crate::random::stream;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Angles between the components of all shapes and those of resampled subjects, in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Angle {
    /// Median.
    pub median: f64,
    /// 95 % of the angles are at most this.
    pub most: f64,
}

/// Stability of each component under resampling.
pub(super) struct Stability {
    /// Variances of the scores.
    pub(super) variances: Vec<Interval>,
    /// Explained fractions.
    pub(super) explained: Vec<Interval>,
    /// Explained fractions of the first components together.
    pub(super) cumulative: Vec<Interval>,
    /// Angle of each component to the one of the same rank.
    pub(super) modes: Vec<Option<Angle>>,
    /// Largest principal angle between the spans of the first components.
    pub(super) spans: Vec<Option<Angle>>,
}

/// One resample: for each component its variance, explained fraction, and both angles.
struct Resample {
    variances: Vec<f64>,
    explained: Vec<f64>,
    modes: Vec<f64>,
    spans: Vec<f64>,
}

/// Draws as many subjects as there are, with replacement, `resamples` times. The mean to which shapes are aligned is kept. Cost per
/// resample: the scatter of the coordinates, and an eigenproblem for `count` pairs.
///
/// # Errors
/// A failure of an eigenproblem; [`AnalysisError::Interrupted`].
pub(super) fn stability(
    sample: &Sample,
    count: usize,
    (resamples, seed): (usize, u64),
    watch: &dyn Watch,
) -> Result<Stability, AnalysisError> {
    let one = |index: usize| {
        watch.check()?;
        let shapes = sample.resampled(&mut stream(seed, index));
        let part = sample.of(&shapes, count)?;
        let weight: f64 = shapes.iter().map(|&(k, times)| times * sample.weights[k]).sum();
        let drawn: f64 = shapes.iter().map(|(_, times)| times).sum();
        watch.worked(1);
        let at = |i: usize| part.pairs.values.get(i).copied().unwrap_or(0.0);
        let v = &part.pairs.vectors;
        Ok(Resample {
            variances: (0..count).map(|i| at(i) / (weight - weight / drawn)).collect(),
            explained: (0..count).map(|i| at(i) / part.total).collect(),
            modes: (0..count).map(|i| if i < v.ncols() { degrees(v[(i, i)].abs()) } else { 90.0 }).collect(),
            spans: (0..count).map(|i| if i < v.ncols() { widest(v, i + 1) } else { 90.0 }).collect(),
        })
    };
    // A subject drawn alone leaves nothing to compare.
    let usable = if sample.subjects.len() < 2 { 0 } else { resamples };
    let drawn: Vec<Resample> = parallel::try_map::<_, AnalysisError>(usable, &one)?;
    let (weight, shapes) = (sample.weights.iter().sum::<f64>(), sample.count() as f64);
    let total: f64 = sample.values.iter().sum();
    let of = |value: f64, most: f64, get: &dyn Fn(&Resample) -> f64| {
        let values: Vec<f64> = drawn.iter().map(get).filter(|value| value.is_finite()).collect();
        Interval::around(value, most, &values)
    };
    let variance = |i: usize| sample.values[i] / (weight - weight / shapes);
    let part = |first: usize, last: usize| sample.values[first..=last].iter().sum::<f64>() / total;
    Ok(Stability {
        variances: (0..count).map(|i| of(variance(i), f64::MAX, &|r| r.variances[i])).collect(),
        explained: (0..count).map(|i| of(part(i, i), 1.0, &|r| r.explained[i])).collect(),
        cumulative: (0..count).map(|i| of(part(0, i), 1.0, &|r| r.explained[..=i].iter().sum())).collect(),
        modes: (0..count).map(|i| angle(drawn.iter().map(|r| r.modes[i]).collect())).collect(),
        spans: (0..count).map(|i| angle(drawn.iter().map(|r| r.spans[i]).collect())).collect(),
    })
}

/// Largest principal angle between the span of the first `m` coordinates and that of the first `m` columns, in degrees.
fn widest(columns: &Matrix, m: usize) -> f64 {
    degrees(columns.view((0, 0), (m, m)).into_owned().singular_values().min())
}

fn degrees(cosine: f64) -> f64 {
    cosine.min(1.0).acos().to_degrees()
}

fn angle(mut angles: Vec<f64>) -> Option<Angle> {
    angles.sort_by(f64::total_cmp);
    (!angles.is_empty()).then(|| Angle { median: quantile(&angles, 0.5), most: quantile(&angles, 0.95) })
}
