//! Repeatability of shapes that were taken several times of each subject, and the error of measurement.
//!
//! With the mean squares `MS_B` between and `MS_W` within `S` subjects, as traces, `n_0 = (n − Σ n_i²/n)/(S − 1)`, and for `k` replicates of
//! every subject `MS_R` between replicates and `MS_E` of the rest,
//!
//! ```text
//! ICC = (MS_B − MS_W)/(MS_B + (n_0 − 1) MS_W)
//! agreement = (MS_B − MS_E)/(MS_B + (k − 1) MS_E + k/S (MS_R − MS_E)),   consistency = (MS_B − MS_E)/(MS_B + (k − 1) MS_E)
//! ```
//!
//! Negative values stay negative. With weights, numbers of shapes are sums of weights but in degrees of freedom. Intervals are those of a
//! bootstrap of subjects. [`error`] — the table of measurement error; [`records`].
//!
//! Sources: Liljequist et al. 2019; Collyer and Adams 2024.

pub mod error;
pub mod records;

use self::records::{Bounded, PartsRecord, RepeatabilityPoint, RepeatabilityRecord};
use super::anova::Testing;
use super::error::ModelError;
use super::mixed::usual_scores;
use crate::inference::aligned::{AlignedShapes, mean_warnings};
use crate::inference::span::{Span, centre_rows};
use crate::mean_record::MeanRecord;
use crate::quantile::quantile;
use crate::random::stream;
use crate::strata::strata;
use crate::watch::Watch;
use rand::RngExt;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Ends of the intervals.
const ENDS: [f64; 2] = [0.025, 0.975];
/// Largest number of draws of a bootstrap.
pub const MAX_DRAWS: usize = 10_000;

/// What is asked.
#[derive(Debug, Clone)]
pub struct RepeatabilityQuestion<'a> {
    /// Subject of each shape.
    pub subjects: &'a [String],
    /// Replicate of each shape, as the device or the observer.
    pub replicates: Option<&'a [String]>,
    /// Group of each shape, the same for all shapes of a subject.
    pub groups: Option<&'a [String]>,
    /// Places along the shape.
    pub samples: usize,
    /// Number of draws of the bootstrap.
    pub draws: usize,
    /// Tests of the error of measurement: permutations and seed.
    pub testing: Testing<'a>,
}

/// Shapes of the subjects.
struct Layout<'a> {
    members: Vec<Vec<usize>>,
    weights: &'a [f64],
    /// For replicates of all subjects, once each and with equal weights: shapes of each subject in the order of the replicates.
    complete: Option<Vec<Vec<usize>>>,
}

/// Mean squares.
#[derive(Debug, Clone, Copy)]
struct Squares {
    between: f64,
    within: f64,
    n0: f64,
}

impl Squares {
    fn icc(self) -> Option<f64> {
        ratio(self.between - self.within, self.between + (self.n0 - 1.0) * self.within)
    }
}

fn ratio(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole)
}

/// Repeatability of aligned shapes. `watch` is asked before every draw.
///
/// Cost: `n P` multiply-adds a draw, and those of the tests.
///
/// # Errors
/// [`ModelError::Unidentified`] for fewer than two subjects with two shapes each; errors of the tests.
pub fn repeatability(
    shapes: &AlignedShapes<'_>,
    question: &RepeatabilityQuestion<'_>,
    watch: &dyn Watch,
) -> Result<RepeatabilityRecord, ModelError> {
    let mut record = of_vectors(&shapes.aligned, &shapes.weights, question, watch)?;
    let layout = Layout::new(question, &shapes.weights)?;
    let places = Places::along(shapes.space.space, question.samples);
    record.map = layout.map(shapes, &places);
    let metric = shapes.space.metric;
    if let Some(replicates) = question.replicates {
        record.replicates = error::displacements(&shapes.aligned, &layout, replicates, metric);
    }
    record.pooled = Some(MeanRecord::of(&shapes.mean, metric.dimension()));
    record.warnings.splice(0..0, mean_warnings(&shapes.mean));
    Ok(record)
}

/// Repeatability of vectors in columns, without a map.
///
/// # Errors
/// As for [`repeatability`].
pub fn of_vectors(
    vectors: &Matrix,
    weights: &[f64],
    question: &RepeatabilityQuestion<'_>,
    watch: &dyn Watch,
) -> Result<RepeatabilityRecord, ModelError> {
    let layout = Layout::new(question, weights)?;
    let sums = Sums::new(vectors, &layout);
    let all = vec![1; layout.members.len()];
    let squares = sums.squares(&all);
    let observed = sums.values(&all);
    let drawn = parallel::try_map(question.draws, &|index| {
        watch.check()?;
        let mut random = stream(question.testing.seed, index);
        let mut counts = vec![0; all.len()];
        all.iter().for_each(|_| counts[random.random_range(0..all.len())] += 1);
        Ok::<_, crate::AnalysisError>(sums.values(&counts))
    })?;
    let bounded = |i: usize| Bounded::new(observed[i]?, drawn.iter().filter_map(|drawn| drawn[i]).collect());
    let mut warnings = Vec::new();
    if question.replicates.is_some() && layout.complete.is_none() {
        warnings.push(
            "agreement and consistency need every replicate of every subject once, with equal weights".into(),
        );
    }
    let parts = layout.parts(vectors, squares.n0)?;
    let measurement_error = error::table(vectors, weights, question, sums.within.iter().sum(), watch)?;
    warnings.extend(measurement_error.warnings);
    Ok(RepeatabilityRecord {
        pooled: None,
        subjects: layout.members.len(),
        shapes_per_subject: squares.n0,
        mean_square_between: squares.between,
        mean_square_within: squares.within,
        variance_between: (squares.between - squares.within) / squares.n0,
        variance_within: squares.within,
        icc: bounded(0),
        agreement: bounded(1),
        consistency: bounded(2),
        draws: question.draws,
        components: parts,
        map: Vec::new(),
        measurement_error: measurement_error.terms,
        replicates: Vec::new(),
        warnings,
    })
}

impl Bounded {
    fn new(value: f64, mut drawn: Vec<f64>) -> Option<Self> {
        drawn.sort_by(f64::total_cmp);
        let end = |q: f64| (!drawn.is_empty()).then(|| quantile(&drawn, q));
        Some(Self { value, low: end(ENDS[0]), high: end(ENDS[1]) })
    }
}

impl<'a> Layout<'a> {
    fn new(question: &RepeatabilityQuestion<'_>, weights: &'a [f64]) -> Result<Self, ModelError> {
        let subjects = strata(question.subjects);
        let count = subjects.iter().max().map_or(0, |last| last + 1);
        let mut members = vec![Vec::new(); count];
        subjects.iter().enumerate().for_each(|(k, &subject)| members[subject].push(k));
        let repeated = members.iter().filter(|members| members.len() > 1).count();
        if repeated < 2 {
            let detail = format!(
                "expected at least two subjects with two shapes each, got {repeated} of {count} subjects"
            );
            return Err(ModelError::Unidentified { detail });
        }
        let complete = question.replicates.and_then(|names| complete(&members, &strata(names), weights));
        Ok(Self { members, weights, complete })
    }

    /// Mean squares of the rows at `rows` of vectors in columns.
    fn squares_of(&self, vectors: &Matrix, rows: impl Iterator<Item = usize> + Clone) -> Squares {
        let (mut within, mut between, mut degrees) = (0.0, 0.0, 0);
        let sizes: Vec<f64> =
            self.members.iter().map(|members| members.iter().map(|&k| self.weights[k]).sum()).collect();
        let total: f64 = sizes.iter().sum();
        for row in rows {
            let first = vectors[(row, 0)];
            let mut means = Vec::with_capacity(sizes.len());
            for (members, size) in self.members.iter().zip(&sizes) {
                let mean =
                    members.iter().map(|&k| self.weights[k] * (vectors[(row, k)] - first)).sum::<f64>()
                        / size;
                let square = |&k: &usize| self.weights[k] * (vectors[(row, k)] - first - mean).powi(2);
                within += members.iter().map(square).sum::<f64>();
                means.push(mean);
            }
            let mean = means.iter().zip(&sizes).map(|(mean, size)| mean * size).sum::<f64>() / total;
            between += means.iter().zip(&sizes).map(|(own, size)| size * (own - mean).powi(2)).sum::<f64>();
        }
        self.members.iter().for_each(|members| degrees += members.len() - 1);
        let free = (self.members.len() - 1) as f64;
        let n0 = (total - sizes.iter().map(|size| size * size).sum::<f64>() / total) / free;
        Squares { between: between / free, within: within / degrees as f64, n0 }
    }

    /// Repeatability at places along the shape.
    fn map(&self, shapes: &AlignedShapes<'_>, places: &Places) -> Vec<RepeatabilityPoint> {
        let points = shapes.points(&shapes.aligned, places);
        let mean = Matrix::from_column_slice(shapes.mean.whitened.len(), 1, &shapes.mean.whitened);
        let mean = shapes.points(&mean, places);
        let (count, d) = (places.count(), shapes.space.metric.dimension());
        let of = |i: usize| {
            let squares = self.squares_of(&points, (0..d).map(|c| c * count + i));
            RepeatabilityPoint {
                parameter: places.parameter(i),
                surface_parameters: places.surface_parameters(i),
                point: (0..d).map(|c| mean[(c * count + i, 0)]).collect(),
                icc: squares.icc(),
                between: (squares.between - squares.within) / squares.n0,
                within: squares.within,
            }
        };
        parallel::map(count, &of)
    }

    /// Repeatability of the directions of the first principal scores: eigenvalues of `(S_B + (n_0 − 1) S_W)⁻¹ (S_B − S_W)`.
    fn parts(&self, vectors: &Matrix, n0: f64) -> Result<Option<PartsRecord>, ModelError> {
        let span = Span::new(vectors, self.weights)?;
        let (shapes, subjects) = (vectors.ncols(), self.members.len());
        let bound = ((shapes - subjects) / 3).min(span.eigenvalues.len());
        if bound == 0 {
            return Ok(None);
        }
        let (count, explained) = usual_scores(&span, bound);
        let mut scores = span.scores.rows(0, count).into_owned();
        centre_rows(&mut scores, self.weights);
        let (mut between, mut within) = (Matrix::zeros(count, count), Matrix::zeros(count, count));
        for members in &self.members {
            let total: f64 = members.iter().map(|&k| self.weights[k]).sum();
            let mut mean = Matrix::zeros(count, 1);
            members.iter().for_each(|&k| mean += scores.column(k) * (self.weights[k] / total));
            between += &mean * mean.transpose() * total;
            for &k in members {
                let about = scores.column(k) - &mean;
                within += &about * about.transpose() * self.weights[k];
            }
        }
        between /= (subjects - 1) as f64;
        within /= (shapes - subjects) as f64;
        let Some(cholesky) = (&between + &within * (n0 - 1.0)).cholesky() else { return Ok(None) };
        let lower = cholesky.l();
        let half = lower.solve_lower_triangular(&(&between - &within));
        let Some(relative) = half.and_then(|half| lower.solve_lower_triangular(&half.transpose())) else {
            return Ok(None);
        };
        let mut values: Vec<f64> = dense::symmetric_eigen(&relative).eigenvalues.iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        Ok(Some(PartsRecord { components: count, explained, repeatability: values }))
    }
}

/// Shapes of each subject in the order of the replicates, if every subject has each of them once, with equal weights.
fn complete(members: &[Vec<usize>], replicates: &[usize], weights: &[f64]) -> Option<Vec<Vec<usize>>> {
    let count = replicates.iter().max().map_or(0, |last| last + 1);
    let is_equal = weights.iter().all(|weight| *weight == weights[0]);
    let of = |members: &Vec<usize>| {
        let mut places = vec![None; count];
        members.iter().for_each(|&k| places[replicates[k]] = Some(k));
        let found: Option<Vec<usize>> = places.into_iter().collect();
        found.filter(|found| found.len() == members.len())
    };
    (is_equal && count > 1).then(|| members.iter().map(of).collect::<Option<_>>())?
}

/// Sums over the shapes of each subject, about the mean of all.
struct Sums<'a> {
    layout: &'a Layout<'a>,
    /// Means of the subjects, one a column, and the sums of their weights.
    means: Matrix,
    sizes: Vec<f64>,
    /// Squared distances from the mean of the subject.
    within: Vec<f64>,
    /// Shapes of each replicate as columns, in the order of the subjects.
    replicates: Vec<Matrix>,
}

impl<'a> Sums<'a> {
    fn new(vectors: &Matrix, layout: &'a Layout<'a>) -> Self {
        let mut centred = vectors.clone();
        centre_rows(&mut centred, layout.weights);
        let (mut means, mut sizes, mut within) = (Vec::new(), Vec::new(), Vec::new());
        for members in &layout.members {
            let total: f64 = members.iter().map(|&k| layout.weights[k]).sum();
            let mut mean = Matrix::zeros(vectors.nrows(), 1);
            members.iter().for_each(|&k| mean += centred.column(k) * (layout.weights[k] / total));
            let square = |&k: &usize| layout.weights[k] * (centred.column(k) - &mean).norm_squared();
            within.push(members.iter().map(square).sum());
            means.extend_from_slice(mean.as_slice());
            sizes.push(total);
        }
        let means = Matrix::from_vec(vectors.nrows(), layout.members.len(), means);
        let of = |rows: &Vec<Vec<usize>>| {
            let column = |r: usize| {
                let chosen: Vec<usize> = rows.iter().map(|row| row[r]).collect();
                centred.select_columns(&chosen)
            };
            (0..rows.first().map_or(0, Vec::len)).map(column).collect()
        };
        let replicates = layout.complete.as_ref().map(of).unwrap_or_default();
        Self { layout, means, sizes, within, replicates }
    }

    /// Mean squares of subjects that are drawn so many times, as different ones.
    fn squares(&self, counts: &[usize]) -> Squares {
        let (mut between, mut within, mut degrees, mut total, mut double) = (0.0, 0.0, 0, 0.0, 0.0);
        let mut sum = Matrix::zeros(self.means.nrows(), 1);
        for (i, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (times, size) = (count as f64, self.sizes[i]);
            between += times * size * self.means.column(i).norm_squared();
            sum += self.means.column(i) * (times * size);
            within += times * self.within[i];
            degrees += count * (self.layout.members[i].len() - 1);
            total += times * size;
            double += times * size * size;
        }
        let free = (counts.len() - 1) as f64;
        Squares {
            between: (between - sum.norm_squared() / total).max(0.0) / free,
            within: if degrees > 0 { within / degrees as f64 } else { 0.0 },
            n0: (total - double / total) / free,
        }
    }

    /// Repeatability, agreement and consistency.
    fn values(&self, counts: &[usize]) -> [Option<f64>; 3] {
        let squares = self.squares(counts);
        if self.replicates.is_empty() {
            return [squares.icc(), None, None];
        }
        let (k, subjects) = (self.replicates.len() as f64, counts.len() as f64);
        let weight = self.layout.weights[0];
        let of = |shapes: &Matrix| {
            let mut sum = Matrix::zeros(shapes.nrows(), 1);
            for (column, &count) in shapes.column_iter().zip(counts).filter(|(_, count)| **count > 0) {
                sum += column * (count as f64 / subjects);
            }
            sum
        };
        let means: Vec<Matrix> = self.replicates.iter().map(of).collect();
        let mean = means.iter().fold(Matrix::zeros(self.means.nrows(), 1), |sum, own| sum + own / k);
        let between: f64 = means.iter().map(|own| weight * subjects * (own - &mean).norm_squared()).sum();
        let of_replicates = between / (k - 1.0);
        let rest = (squares.within * subjects * (k - 1.0) - between) / ((subjects - 1.0) * (k - 1.0));
        let (own, scatter) = (squares.between - rest, squares.between + (k - 1.0) * rest);
        [squares.icc(), ratio(own, scatter + k / subjects * (of_replicates - rest)), ratio(own, scatter)]
    }
}
