//! Where along a shape it is wrong: a weight for each of its control points.
//!
//! ```text
//! c_k ≈ c̄ + Σ_i t_i D_i + Σ_j b_j B_j c̄ + e       minimise Σ_n v_n |r_n|² + g o_k² s² Σ_i t_i²/λ_i
//! r_n  the residual at control point n,   s_n  its median over the shapes,   o_k² the median of r_n/s_n over the shape, or one
//! v_n = 1/(1 + (r_n/(3 o_k s_n))⁴)
//! r_n² is averaged over the neighbours on a curve:  Σ_j (h + 1 − |j|) r_{n+j}² / Σ_j (h + 1 − |j|),   |j| ≤ h,   h = N/32, rounded, or 1
//! ```
//!
//! Three times with the components of all shapes as directions `D_i`, whose scores find the nearest shapes (`g = 10`, `o_k = 1`); then twice
//! about the mean of the 24
//! nearest ones, with the deviations of these as directions (`g = 5`). A set of several kinds of shapes has no components in
//! which damage stands out, but there are shapes like every one. Damage of the near shapes themselves hardly counts, by their
//! own `v_n`.
//!
//! Damage is a stretch, so that neighbours on a curve tell of each other; residuals by chance are not. Landmarks and
//! surfaces have no neighbours here. A shape unlike all others leaves more everywhere (`o_k`), which is not damage of a place.
//!
//! Members of the class may move as well (`B_j c̄`), since damage in one place turns and shifts the alignment of the whole shape.
//! Residuals and weights alternate, so that a damaged stretch does not pull the fit of the rest.

use super::rejection::{effective, median};
use crate::AnalysisError;
use crate::accumulate::ShapesInMemory;
use crate::alignment::{Method, unwhitened};
use crate::metric::{Metric, dot};
use crate::partial_sums::Measured;
use crate::pca::FunctionalPca;
use shapelex_numeric::dense::{Matrix, transpose_multiply};
use shapelex_numeric::parallel;

/// Maximum number of components of the model.
const COMPONENTS: usize = 12;

/// Number of shapes for each component.
const SHAPES_PER_COMPONENT: f64 = 8.0;

/// Fraction of the variance that the model explains.
const SHARE: f64 = 0.98;

/// Alternations of residuals and weights in the components of all shapes, and then in the nearest shapes.
const ROUNDS_OF_ALL: usize = 3;
const ROUNDS: usize = 2;

/// Number of shapes nearest to each one.
const NEAREST: usize = 24;

/// Fewest shapes that are near enough to describe another one.
const FEWEST: usize = 4;

/// Maximum number of shapes among which the nearest ones are searched.
const CANDIDATES: usize = 2048;

/// Multiple of the median residual at which a weight is one half.
const HALF: f64 = 3.0;

/// Least scale of a point, as a fraction of the median over all points, and as one of the size of the mean (rounding).
const LEAST_SCALE: f64 = 0.25;
const ROUNDING: f64 = 1e-10;

/// `g`: residuals of about so many neighbouring points go together, and count as one against the variances of the directions; in the
/// components of all shapes, and in the nearest shapes. Less lets the directions follow damage on curves of few points.
const TOGETHER_OF_ALL: f64 = 10.0;
const TOGETHER: f64 = 5.0;

/// Number of control points for each neighbour that a point is averaged with on one side.
const POINTS_PER_REACH: usize = 32;

/// Ridge of the directions of the class, as a fraction of the mean diagonal: they may depend on each other.
const RIDGE: f64 = 1e-9;

/// Weights of the control points of aligned shapes, `N` numbers between zero and one for each. `aligned`: whitened, one after the
/// other; `weights`: the weights `w_k f_k` of the shapes in the robust estimate. Of more than 2048 shapes the nearest ones are
/// searched among so many, evenly spread along the first component.
///
/// Cost per shape: four least-squares problems of `dN` equations, with up to `12 + d² + d` and `24 + d² + d` unknowns.
///
/// # Errors
/// A failure of the eigenproblem.
pub fn point_weights(
    measured: Measured<'_>,
    aligned: &[f64],
    weights: &[f64],
) -> Result<Vec<Vec<f64>>, AnalysisError> {
    let Measured { metric, method, matching } = measured;
    let length = metric.len();
    let source = ShapesInMemory::prepared(aligned.to_vec(), weights.to_vec());
    let Some(first) = aligned.chunks_exact(length).zip(weights).find(|(_, w)| **w > 0.0) else {
        return Ok(Vec::new());
    };
    let model = Model::new(&source, metric, method, first.0, weights)?;
    let mut control_points = aligned.to_vec();
    metric.unwhiten(&mut control_points);
    parallel::for_each_chunk(&mut control_points, length, &|_, shape| {
        shape.iter_mut().zip(&model.mean).for_each(|(c, m)| *c -= m);
    });
    let shapes = Away { control_points, length, weights, curve: matching.curve(), size: model.size };
    let mut points = Points::unknown(weights.len(), metric.size());
    let mut scores = Vec::new();
    for _ in 0..ROUNDS_OF_ALL {
        let fits: Vec<Fitted> = parallel::map(weights.len(), &|k| {
            model.own.fit(shapes.of(k), &points.weights[k], points.noise[k], &model.precisions)
        });
        scores = fits.iter().map(|fit| fit.parts[..model.precisions.len()].to_vec()).collect();
        points.judge(fits.into_iter().map(|fit| fit.residuals).collect(), &shapes, Beside::All);
    }
    let near = nearest(&scores, weights);
    for _ in 0..ROUNDS {
        let local = |k: usize| match &near[k] {
            few if few.len() < FEWEST => {
                model.own.fit(shapes.of(k), &points.weights[k], points.noise[k], &model.precisions).residuals
            }
            near => shapes.beside(k, near, &points, &model),
        };
        let residuals = parallel::map(weights.len(), &local);
        points.judge(residuals, &shapes, Beside::Nearest);
    }
    Ok(points.weights)
}

/// Control points of shapes less those of a mean, one after the other, with the weights of the shapes.
struct Away<'a> {
    control_points: Vec<f64>,
    length: usize,
    weights: &'a [f64],
    /// Whether the control points follow each other along a curve, and whether that closes.
    curve: Option<bool>,
    /// Largest coordinate of the mean.
    size: f64,
}

/// Weights of control points, and how well the shapes are known.
struct Points {
    /// `v_n` of each shape.
    weights: Vec<Vec<f64>>,
    /// `3 o_k² s²` of each shape.
    noise: Vec<f64>,
}

impl Points {
    fn unknown(shapes: usize, n: usize) -> Self {
        Self { weights: vec![vec![1.0; n]; shapes], noise: vec![0.0; shapes] }
    }

    /// New weights from the residuals of the shapes `beside` others.
    fn judge(&mut self, residuals: Vec<Vec<f64>>, shapes: &Away<'_>, beside: Beside) {
        let n = self.weights[0].len();
        let mut residuals = match shapes.curve {
            Some(closed) => parallel::map(residuals.len(), &|k| averaged(&residuals[k], closed)),
            None => residuals,
        };
        let (together, own) = match beside {
            Beside::All => (TOGETHER_OF_ALL, vec![1.0; residuals.len()]),
            Beside::Nearest => (TOGETHER, shapes.own_scales(&residuals)),
        };
        residuals.iter_mut().zip(&own).for_each(|(r, own)| r.iter_mut().for_each(|r| *r /= own));
        let scales = scales(&residuals, shapes.weights, n, shapes.size);
        let square = scales.iter().map(|s| s * s).sum::<f64>() / n as f64;
        self.noise = own.iter().map(|own| together * square * own * own).collect();
        for (points, residuals) in self.weights.iter_mut().zip(&residuals) {
            for ((v, r), s) in points.iter_mut().zip(residuals).zip(&scales) {
                *v = 1.0 / (1.0 + (r / (HALF * s)).powi(4));
            }
        }
    }
}

/// The shapes beside which one is seen.
#[derive(Clone, Copy)]
enum Beside {
    All,
    Nearest,
}

impl Away<'_> {
    fn of(&self, k: usize) -> &[f64] {
        &self.control_points[k * self.length..(k + 1) * self.length]
    }

    /// `o_k`: roots of the medians over each shape of its residuals, in that of all shapes.
    fn own_scales(&self, residuals: &[Vec<f64>]) -> Vec<f64> {
        let n = residuals[0].len();
        let (of_all, equal) = (scales(residuals, self.weights, n, self.size), vec![1.0; n]);
        let own = |k: usize| {
            let relative: Vec<f64> = residuals[k].iter().zip(&of_all).map(|(r, s)| r / s).collect();
            median(&relative, &equal).max(ROUNDING).sqrt()
        };
        parallel::map(residuals.len(), &own)
    }

    /// Residuals of shape `k` beside the shapes `near`: about their mean, in their deviations and the moves of the class.
    fn beside(&self, k: usize, near: &[usize], points: &Points, model: &Model) -> Vec<f64> {
        let n = points.weights[k].len();
        let total: f64 = near.iter().map(|&j| self.weights[j]).sum();
        let (mut mean, mut known) = (vec![0.0; self.length], vec![0.0; n]);
        for &j in near {
            let v = &points.weights[j];
            known.iter_mut().zip(v).for_each(|(sum, v)| *sum += self.weights[j] * v);
            let values = mean.iter_mut().zip(self.of(j)).enumerate();
            values.for_each(|(row, (sum, c))| *sum += self.weights[j] * v[row % n] * c);
        }
        mean.iter_mut().enumerate().for_each(|(row, sum)| *sum /= known[row % n].max(f64::MIN_POSITIVE));
        let deviation = |&j: &usize| -> Vec<f64> {
            let root = (self.weights[j] / total).sqrt();
            let v = &points.weights[j];
            let away = self.of(j).iter().zip(&mean).enumerate();
            away.map(|(row, (c, m))| root * v[row % n] * (c - m)).collect()
        };
        let mut columns: Vec<Vec<f64>> = near.iter().map(deviation).collect();
        columns.extend(model.moves.iter().cloned());
        let directions = Directions(Matrix::from_vec(self.length, columns.len(), columns.concat()));
        let away: Vec<f64> = self.of(k).iter().zip(&mean).map(|(c, m)| c - m).collect();
        directions.fit(&away, &points.weights[k], points.noise[k], &vec![1.0; near.len()]).residuals
    }
}

/// Positions of the shapes with the least distances in the `scores` from each one, of those with a weight; copies of a shape are not
/// near to it.
fn nearest(scores: &[Vec<f64>], weights: &[f64]) -> Vec<Vec<usize>> {
    let mut candidates: Vec<usize> = (0..weights.len()).filter(|&k| weights[k] > 0.0).collect();
    let first = |k: usize| scores[k].first().copied().unwrap_or(0.0);
    if candidates.len() > CANDIDATES {
        candidates.sort_by(|&i, &j| first(i).total_cmp(&first(j)));
        let count = candidates.len();
        candidates = (0..CANDIDATES).map(|i| candidates[i * count / CANDIDATES]).collect();
    }
    let of = |k: usize| {
        let distance =
            |j: usize| -> f64 { scores[k].iter().zip(&scores[j]).map(|(a, b)| (a - b).powi(2)).sum() };
        let mut distances: Vec<(f64, usize)> =
            candidates.iter().map(|&j| (distance(j), j)).filter(|(distance, _)| *distance > 0.0).collect();
        if distances.len() > NEAREST {
            distances.select_nth_unstable_by(NEAREST, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            distances.truncate(NEAREST);
        }
        // Sums do not depend on how the nearest ones were selected.
        distances.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        distances.into_iter().map(|(_, j)| j).collect()
    };
    parallel::map(scores.len(), &of)
}

/// The residuals of neighbours on a curve together: roots of the weighted means of their squares, at the ends of an open one of
/// those that are there.
fn averaged(residuals: &[f64], closed: bool) -> Vec<f64> {
    let n = residuals.len();
    let reach = ((n + POINTS_PER_REACH / 2) / POINTS_PER_REACH).max(1) as isize;
    let square = |at: usize| {
        let neighbours = (-reach..=reach).filter_map(|j| {
            let there = at as isize + j;
            let inside = (0..n as isize).contains(&there);
            let there = there.rem_euclid(n as isize) as usize;
            (closed || inside).then(|| (residuals[there], (reach + 1 - j.abs()) as f64))
        });
        let (sum, weight) = neighbours.fold((0.0, 0.0), |(sum, total), (r, w)| (sum + w * r * r, total + w));
        sum / weight
    };
    (0..n).map(|at| square(at).sqrt()).collect()
}

/// `s_n`: weighted median over the shapes of the residuals at every point.
fn scales(residuals: &[Vec<f64>], weights: &[f64], n: usize, size: f64) -> Vec<f64> {
    let at = |point: usize| {
        let values: Vec<f64> = residuals.iter().map(|r| r[point]).collect();
        median(&values, weights)
    };
    let scales = parallel::map(n, &at);
    let least = (LEAST_SCALE * median(&scales, &vec![1.0; n])).max(ROUNDING * size);
    scales.into_iter().map(|scale| scale.max(least)).collect()
}

/// Mean and directions of the robust estimate, as control points.
struct Model {
    mean: Vec<f64>,
    /// Components, then the moves of the class.
    own: Directions,
    /// `1/λ_i` of the components.
    precisions: Vec<f64>,
    moves: Vec<Vec<f64>>,
    /// Largest coordinate of the mean.
    size: f64,
}

impl Model {
    fn new(
        source: &ShapesInMemory,
        metric: &Metric,
        method: &Method,
        reference: &[f64],
        weights: &[f64],
    ) -> Result<Self, AnalysisError> {
        let worth = effective(weights);
        let most = ((worth - 1.0) / SHAPES_PER_COMPONENT).max(0.0) as usize;
        let pca = FunctionalPca::new(source, metric, reference, true, COMPONENTS)?;
        let mut explained = 0.0;
        let explaining = pca.explained.iter().take_while(|part| {
            let further = explained < SHARE;
            explained += *part;
            further
        });
        let count = explaining.count().min(most);
        let total: f64 = weights.iter().sum();
        let precisions = pca.eigenvalues[..count].iter().map(|value| total / value).collect();
        let mean = unwhitened(metric, &pca.mean);
        let moves = moves(&mean, method, metric);
        let mut columns: Vec<Vec<f64>> =
            (0..count).map(|i| unwhitened(metric, pca.eigenshapes.column(i).as_slice())).collect();
        columns.extend(moves.iter().cloned());
        let own = Directions(Matrix::from_vec(metric.len(), columns.len(), columns.concat()));
        let size = mean.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        Ok(Self { mean, own, precisions, moves, size })
    }
}

/// Directions in which a shape may differ, as columns of `dN` control coordinates.
struct Directions(Matrix);

/// A shape in some directions.
struct Fitted {
    /// Residual at every control point.
    residuals: Vec<f64>,
    /// Factors of the directions; zero if they cannot be told.
    parts: Vec<f64>,
}

impl Directions {
    /// The fit of a shape, given without the mean, under the weights `v`: `noise` times the `precisions` are added to the diagonal of
    /// the first directions.
    fn fit(&self, away: &[f64], v: &[f64], noise: f64, precisions: &[f64]) -> Fitted {
        let (n, p) = (v.len(), self.0.ncols());
        let (mut left, mut parts) = (away.to_vec(), vec![0.0; p]);
        if p > 0 {
            let mut weighted = self.0.clone();
            for mut column in weighted.column_iter_mut() {
                column.iter_mut().enumerate().for_each(|(row, value)| *value *= v[row % n]);
            }
            let mut normal = transpose_multiply(&weighted, &self.0);
            let ridge = RIDGE * normal.trace() / p as f64;
            for i in 0..p {
                normal[(i, i)] += ridge + precisions.get(i).map_or(0.0, |precision| noise * precision);
            }
            let right = Matrix::from_fn(p, 1, |i, _| dot(weighted.column(i).as_slice(), away));
            if let Some(root) = normal.cholesky() {
                let found = root.solve(&right);
                let fitted = &self.0 * &found;
                left.iter_mut().zip(fitted.iter()).for_each(|(e, f)| *e -= f);
                parts = found.as_slice().to_vec();
            }
        }
        let residuals = (0..n).map(|i| left.iter().skip(i).step_by(n).map(|e| e * e).sum::<f64>().sqrt());
        Fitted { residuals: residuals.collect(), parts }
    }
}

/// `E c̄` for the unit matrices `E` of a linear class or the rotations and scales of a fit, and shifts if the class translates.
fn moves(mean: &[f64], method: &Method, metric: &Metric) -> Vec<Vec<f64>> {
    let (n, d) = (metric.size(), metric.dimension());
    let act = |matrix: &Matrix| crate::fit::transform(matrix, mean);
    let mut moves: Vec<Vec<f64>> = match method {
        Method::Projection(class) => class.matrices().iter().map(act).collect(),
        Method::Procrustes(fit) => {
            let turns = (0..d).flat_map(|c| (0..c).map(move |e| (c, e))).filter(|_| fit.rotates);
            let turn = |(c, e): (usize, usize)| {
                let mut matrix = Matrix::zeros(d, d);
                (matrix[(c, e)], matrix[(e, c)]) = (1.0, -1.0);
                act(&matrix)
            };
            turns.map(turn).chain([mean.to_vec()].into_iter().filter(|_| !method.keeps_sizes())).collect()
        }
    };
    if method.translates() {
        moves.extend((0..d).map(|c| (0..d * n).map(|row| f64::from(row / n == c)).collect()));
    }
    moves
}
