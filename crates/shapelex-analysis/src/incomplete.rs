//! Mean and principal components of shapes that miss control points, by expectation and maximisation.
//!
//! ```text
//! E   missing control points of shape k:  mean and covariance V_k given those that are seen     (the posterior of `dictionary::posterior`)
//! M   r_mean, r̃_k by the usual alignment of the completed shapes;  S = Σ w_k ((r̃_k − r̄)(r̃_k − r̄)ᵀ + V_k)
//!     ξ_i, λ_i the leading eigenpairs of S,   ρ² = (tr S − Σ λ_i)/((W − W/K)(dN − q − I))
//! ```
//!
//! The model of the M step is that of probabilistic principal components: modes, and a residual of equal variance in all other
//! directions. Without `V_k` completed shapes would vary too little. Shapes without missing points give exactly the usual components.
//! The E step takes `ρ² (K − 1)/(K − 1 − I)`: the `I` modes of `K` shapes describe these better than others, and with their residual alone
//! missing points would follow the noise of the seen ones. The rounds are accelerated (`anderson`).
//! The pose of an incomplete shape is found with its scores, so that it does not depend on the missing points.
//!
//! Sources: Tipping, Bishop 1999; Ilin, Raiko 2010 (missing values).

use crate::AnalysisError;
use crate::alignment::{AlignedShape, MeanShape};
use crate::anderson::Anderson;
use crate::dictionary::posterior::conditioning::{Posterior, Seen};
use crate::dictionary::posterior::model::{control_variances, point_variance};
use crate::dictionary::posterior::places::{AtPlaces, selected};
use crate::dictionary::posterior::pose::Freedom;
use crate::factors::Estimator;
use crate::frame::{Frame, largest};
use crate::metric::{Metric, norm};
use crate::partial_sums::Measured;
use crate::pca::{FunctionalPca, SMALLEST_COMPONENT};
use crate::robust::align_all_by;
use crate::watch::Watch;
use shapelex_numeric::dense::{Eigenpairs, Matrix, add_outer_products, leading_eigenpairs, multiply};
use shapelex_numeric::parallel;

/// Most rounds of both steps.
pub const ROUNDS: usize = 100;
/// Relative change of the completed shapes at which the rounds end.
const CLOSE: f64 = 1e-5;
/// Largest length `d·N` of shapes: the scatter has its square as size.
pub const MAX_LENGTH: usize = 1024;
/// Least variance of the residual, divided by the mean one of the modes.
const LEAST_NOISE: f64 = 1e-6;

/// Shapes that may miss control points.
#[derive(Debug, Clone)]
pub struct IncompleteShapes {
    /// `d·N` coordinate-major numbers for each shape; those of missing control points have no meaning.
    pub control_points: Vec<f64>,
    /// Positions of the seen control points of each shape, ascending.
    pub seen: Vec<Vec<usize>>,
}

/// Mean and components of incomplete shapes.
#[derive(Debug)]
pub struct IncompletePca {
    /// The mean.
    pub mean: MeanShape,
    /// Aligned shapes, missing control points at their most likely places.
    pub aligned: Vec<AlignedShape>,
    /// The completed shapes as given: `d·N` numbers each.
    pub completed: Vec<f64>,
    /// The components, about the mean.
    pub pca: FunctionalPca,
    /// Variance of the residual of a whitened coordinate.
    pub noise: f64,
    /// Number of rounds.
    pub rounds: usize,
    /// Whether the last round changed nothing.
    pub converged: bool,
}

/// Work of the components of incomplete shapes, in multiply-adds, if all rounds are needed.
pub fn incomplete_work(length: usize, shapes: usize, components: usize) -> f64 {
    let (n, k, q) = (length as f64, shapes as f64, components as f64 + 12.0);
    // Most cohorts take a third of the rounds.
    ROUNDS as f64 / 3.0 * (k * n * n + 10.0 * n.powi(3) + 10.0 * k * n * q * q)
}

impl IncompleteShapes {
    /// Mean and `components` leading components.
    ///
    /// Cost: for each of some tens of rounds the scatter of all shapes and an eigenproblem of size `dN`.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `components` for as many as there are shapes or more, at `shapes` for control points that too few
    /// shapes have or a shape that does not determine its pose; degenerate shapes; [`AnalysisError::Interrupted`].
    pub fn pca(
        mut self,
        measured: Measured<'_>,
        frame: Frame,
        components: usize,
        watch: &dyn Watch,
    ) -> Result<IncompletePca, AnalysisError> {
        let (n, d, count) = (measured.metric.size(), measured.metric.dimension(), self.seen.len());
        let freedom = Freedom::of(measured.method, d);
        self.check(n, components, d * n, &freedom)?;
        self.start(n, d);
        let missing: Vec<usize> = (0..count).filter(|&k| self.seen[k].len() < n).collect();
        // Covariances of the missing control points, of the modes as columns, and how often each is missing.
        let mut unknown = Unknown::none(n);
        let (mut noise, mut anderson) = (0.0, Anderson::default());
        for round in 1..=ROUNDS {
            watch.check()?;
            let stop = || watch.stop();
            let shapes = (self.control_points.clone(), vec![1.0; count]);
            let (mean, aligned) = align_all_by(Estimator::Plain, measured, frame, shapes.0, shapes.1, &stop)?;
            let (pca, own) =
                maximised(measured.metric, &aligned, &unknown, (components, noise), freedom.count())?;
            noise = own * predictive(count, pca.eigenvalues.len());
            let model = Model::new(measured.metric, &pca, noise, count, &freedom);
            let before = self.control_points.clone();
            let (change, next) = self.expected(&model, &missing)?;
            unknown = next;
            let converged = change <= CLOSE || missing.is_empty();
            if converged || round == ROUNDS {
                return Ok(IncompletePca {
                    mean,
                    aligned,
                    completed: self.control_points,
                    pca,
                    noise: own,
                    rounds: round,
                    converged,
                });
            }
            self.accelerate(&before, measured.metric, &missing, &mut anderson);
        }
        Err(AnalysisError::Interrupted)
    }

    /// Moves missing control points on from where they were before the last step, which counts in parts of the size of each shape.
    fn accelerate(&mut self, before: &[f64], metric: &Metric, missing: &[usize], anderson: &mut Anderson) {
        let length = metric.len();
        let sizes: Vec<f64> = missing
            .iter()
            .map(|&k| {
                let mut centred = self.control_points[k * length..(k + 1) * length].to_vec();
                metric.centre(&mut centred);
                norm(&centred)
            })
            .collect();
        let own = |shapes: &[f64]| -> Vec<f64> {
            let of = |(&k, size): (&usize, &f64)| {
                shapes[k * length..(k + 1) * length].iter().map(|x| x / size).collect::<Vec<f64>>()
            };
            missing.iter().zip(&sizes).flat_map(of).collect()
        };
        let (x, image) = (own(before), own(&self.control_points));
        let step: Vec<f64> = image.iter().zip(&x).map(|(image, x)| image - x).collect();
        let next = anderson.next(&x, &step);
        for ((&k, size), shape) in missing.iter().zip(&sizes).zip(next.chunks_exact(length)) {
            let n = metric.size();
            let seen = &self.seen[k];
            let target = &mut self.control_points[k * length..(k + 1) * length];
            for (i, (target, x)) in target.iter_mut().zip(shape).enumerate() {
                // Seen points stay as they are, to the last bit.
                if seen.binary_search(&(i % n)).is_err() {
                    *target = size * x;
                }
            }
        }
    }

    fn check(
        &self,
        n: usize,
        components: usize,
        length: usize,
        freedom: &Freedom,
    ) -> Result<(), AnalysisError> {
        let refused = |field: &'static str, detail: String| Err(AnalysisError::Parameter { field, detail });
        let count = self.seen.len();
        if components + 1 >= count {
            let detail = format!(
                "expected at most {} for {count} shapes, two fewer than shapes, got {components}",
                count.saturating_sub(2)
            );
            return refused("components", detail);
        }
        if components + freedom.count() >= length {
            let most = length.saturating_sub(freedom.count() + 1);
            return refused(
                "components",
                format!("expected at most {most} for shapes of {length} numbers, got {components}"),
            );
        }
        let least = freedom.count().div_ceil(length / n).max(1);
        if let Some(k) = self.seen.iter().position(|seen| seen.len() < least) {
            let detail = format!("expected at least {least} control points, got {}", self.seen[k].len());
            return Err(AnalysisError::Unsuitable { index: k, detail });
        }
        for i in 0..n {
            let having = self.seen.iter().filter(|seen| seen.binary_search(&i).is_ok()).count();
            if having < 2 {
                let detail = format!("expected at least 2 shapes that have control point {i}, got {having}");
                return refused("shapes", detail);
            }
        }
        Ok(())
    }

    /// First places of missing control points: in proportion between the seen ones before and after, around the shape.
    fn start(&mut self, n: usize, d: usize) {
        for (shape, seen) in self.control_points.chunks_exact_mut(n * d).zip(&self.seen) {
            for i in (0..n).filter(|i| seen.binary_search(i).is_err()) {
                let after = seen.partition_point(|&s| s < i);
                let before = seen[(after + seen.len() - 1) % seen.len()];
                let after = seen[after % seen.len()];
                let (from, whole) = ((i + n - before) % n, (after + n - before) % n);
                let part = if whole == 0 { 0.0 } else { from as f64 / whole as f64 };
                for c in 0..d {
                    shape[c * n + i] = (1.0 - part) * shape[c * n + before] + part * shape[c * n + after];
                }
            }
        }
    }

    /// Moves missing control points to their most likely places: the largest relative change of a shape, and the remaining uncertainty.
    fn expected(&mut self, model: &Model, missing: &[usize]) -> Result<(f64, Unknown), AnalysisError> {
        let (n, d) = (model.at.count(), model.at.dimension);
        let shapes = &self.control_points;
        let found: Vec<(Vec<f64>, Vec<f64>)> = parallel::try_map(missing.len(), &|i| {
            let k = missing[i];
            let completed = model.complete(&shapes[k * n * d..(k + 1) * n * d], &self.seen[k]);
            completed.map_err(|error| of_shape(error, k))
        })?;
        let (mut change, mut unknown) = (0.0_f64, Unknown::none(n));
        for (&k, (shape, columns)) in missing.iter().zip(found) {
            let before = &mut self.control_points[k * n * d..(k + 1) * n * d];
            let moved: f64 = before.iter().zip(&shape).map(|(a, b)| (a - b).powi(2)).sum();
            let mut centred = shape.clone();
            model.metric.centre(&mut centred);
            change = change.max(moved.sqrt() / norm(&centred));
            before.copy_from_slice(&shape);
            unknown.columns.extend(columns);
            (0..n).filter(|i| self.seen[k].binary_search(i).is_err()).for_each(|i| unknown.times[i] += 1.0);
        }
        Ok((change, unknown))
    }
}

/// Residual variance of other shapes, divided by that of the shapes from which the modes were learnt.
fn predictive(count: usize, modes: usize) -> f64 {
    let free = count.saturating_sub(1 + modes).max(1);
    (count - 1) as f64 / free as f64
}

fn of_shape(error: AnalysisError, k: usize) -> AnalysisError {
    match error {
        AnalysisError::Parameter { detail, .. } => AnalysisError::Unsuitable { index: k, detail },
        other => other.at(k),
    }
}

/// Uncertainty of missing control points.
struct Unknown {
    /// Roots of their covariances by the modes: control points of a change of a shape each, in the pose of the mean.
    columns: Vec<f64>,
    /// How often each control point is missing.
    times: Vec<f64>,
}

impl Unknown {
    fn none(n: usize) -> Self {
        Self { columns: Vec::new(), times: vec![0.0; n] }
    }
}

/// Components of aligned shapes with their uncertainty, and the variance of the residual. `noise`: that of missing control points.
fn maximised(
    metric: &Metric,
    aligned: &[AlignedShape],
    unknown: &Unknown,
    (components, noise): (usize, f64),
    pose: usize,
) -> Result<(FunctionalPca, f64), AnalysisError> {
    let (length, n, count) = (metric.len(), metric.size(), aligned.len());
    let mut mean = vec![0.0; length];
    for shape in aligned {
        mean.iter_mut().zip(&shape.whitened).for_each(|(sum, y)| *sum += y / count as f64);
    }
    let away: Vec<f64> =
        aligned.iter().flat_map(|shape| shape.whitened.iter().zip(&mean).map(|(y, m)| y - m)).collect();
    let mut scatter = Matrix::zeros(length, length);
    add_outer_products(&mut scatter, &away, 1.0);
    let mut columns = unknown.columns.clone();
    metric.whiten(&mut columns);
    add_outer_products(&mut scatter, &columns, 1.0);
    if noise > 0.0 {
        let own = control_variances(metric, noise).unwrap_or_else(|| vec![noise * point_variance(metric); n]);
        for (i, times) in unknown.times.iter().enumerate().filter(|(_, times)| **times > 0.0) {
            for c in 0..metric.dimension() {
                let mut column = vec![0.0; length];
                column[c * n + i] = (times * own[i]).sqrt();
                metric.whiten(&mut column);
                add_outer_products(&mut scatter, &column, 1.0);
            }
        }
    }
    let total = scatter.trace();
    let Eigenpairs { mut values, vectors } = leading_eigenpairs(&scatter, components)?;
    let least = SMALLEST_COMPONENT * values.first().copied().unwrap_or(0.0);
    values.truncate(values.iter().take_while(|value| **value > least).count());
    let mut eigenshapes = vectors.columns(0, values.len()).into_owned();
    for mut column in eigenshapes.column_iter_mut() {
        let mut control_points = column.as_slice().to_vec();
        metric.unwhiten(&mut control_points);
        if largest(&control_points) < 0.0 {
            column.neg_mut();
        }
    }
    let described: f64 = values.iter().sum();
    let directions = (length.saturating_sub(values.len() + pose).max(1) * (count - 1)) as f64;
    let explained = values.iter().map(|value| value / total).collect();
    let least = LEAST_NOISE * described / directions;
    let noise = ((total - described) / directions).max(least);
    Ok((FunctionalPca { mean, eigenvalues: values, explained, eigenshapes, centred: true }, noise))
}

/// The model of the E step.
struct Model<'a> {
    metric: &'a Metric,
    freedom: &'a Freedom,
    at: AtPlaces,
}

impl<'a> Model<'a> {
    fn new(metric: &'a Metric, pca: &FunctionalPca, noise: f64, count: usize, freedom: &'a Freedom) -> Self {
        let control = |whitened: &[f64]| {
            let mut shape = whitened.to_vec();
            metric.unwhiten(&mut shape);
            shape
        };
        let mode = |j: usize| {
            let deviation = (pca.eigenvalues[j] / (count - 1) as f64).sqrt();
            control(&pca.eigenshapes.column(j).iter().map(|x| deviation * x).collect::<Vec<f64>>())
        };
        let modes: Vec<Vec<f64>> = (0..pca.eigenvalues.len()).map(mode).collect();
        let own = control_variances(metric, noise)
            .unwrap_or_else(|| vec![noise * point_variance(metric); metric.size()]);
        Self { metric, freedom, at: AtPlaces::new(metric.dimension(), control(&pca.mean), &modes, own) }
    }

    /// The completed shape as given, and a root of the covariance of its missing control points by the modes.
    fn complete(&self, shape: &[f64], seen: &[usize]) -> Result<(Vec<f64>, Vec<f64>), AnalysisError> {
        let (n, d) = (self.at.count(), self.at.dimension);
        let known = Seen::of(self.at.select(seen), selected(shape, d, seen));
        let posterior = Posterior::new(&known, self.freedom)?;
        let likely = posterior.back.apply(&self.at.points(&posterior.scores));
        let mut completed = shape.to_vec();
        let missing: Vec<usize> = (0..n).filter(|i| seen.binary_search(i).is_err()).collect();
        for c in 0..d {
            missing.iter().for_each(|&i| completed[c * n + i] = likely[c * n + i]);
        }
        let j = posterior.scores.len();
        let covariance = posterior.covariance.view((0, 0), (j, j)).into_owned();
        let root = root_of(&covariance);
        let mut columns = vec![0.0; n * d * j];
        let spread = multiply(&self.at.modes.transpose(), &root);
        for (column, values) in columns.chunks_exact_mut(n * d).zip(spread.column_iter()) {
            for c in 0..d {
                missing.iter().for_each(|&i| column[c * n + i] = values[c * n + i]);
            }
        }
        Ok((completed, columns))
    }
}

/// `Z` with `Z Zᵀ = C`.
fn root_of(covariance: &Matrix) -> Matrix {
    let eigen = shapelex_numeric::dense::symmetric_eigen(covariance);
    Matrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        eigen.eigenvectors[(i, j)] * eigen.eigenvalues[j].max(0.0).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accumulate::ShapesInMemory;
    use crate::dictionary::method::Method;
    use crate::dictionary::recipe::Recipe;
    use crate::dictionary::report::tests::{ovals, space};
    use crate::pca::Components;
    use crate::robust::align_all_by;
    use crate::transformation::{ClassName, Transformation};
    use crate::watch::Unwatched;
    use shapelex_numeric::dense::svd;

    const N: usize = 12;

    fn setting() -> crate::dictionary::recipe::Setting {
        let similarity = Transformation::Named(ClassName::Similarity);
        let method = Method::FunctionalPca { components: 2, centre: true };
        Recipe::new(space().representation().clone(), similarity, method).setting().unwrap()
    }

    fn found(
        points: &[f64],
        seen: Vec<Vec<usize>>,
        components: usize,
    ) -> Result<IncompletePca, AnalysisError> {
        let setting = setting();
        let measured =
            Measured { metric: &setting.metric, method: &setting.method, matching: &setting.matching };
        let shapes = IncompleteShapes { control_points: points.to_vec(), seen };
        shapes.pca(measured, Frame::default(), components, &Unwatched)
    }

    fn complete(points: &[f64], count: usize) -> FunctionalPca {
        let setting = setting();
        let measured =
            Measured { metric: &setting.metric, method: &setting.method, matching: &setting.matching };
        let (mean, aligned) = align_all_by(
            Estimator::Plain,
            measured,
            Frame::default(),
            points.to_vec(),
            vec![1.0; count],
            &|| false,
        )
        .unwrap();
        let whitened = aligned.iter().flat_map(|shape| shape.whitened.iter().copied()).collect();
        let source = ShapesInMemory::prepared(whitened, vec![1.0; count]);
        Components::new(&source, &setting.metric, &mean.whitened, true, 2).unwrap().pca
    }

    /// Largest principal angle of the spans of two components, in degrees.
    fn angle(a: &FunctionalPca, b: &FunctionalPca) -> f64 {
        let product = a.eigenshapes.columns(0, 2).transpose() * b.eigenshapes.columns(0, 2);
        svd(product, false, false).unwrap().singular_values.min().clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// A third of the shapes miss a quarter of their points.
    fn gaps(count: usize) -> Vec<Vec<usize>> {
        let hidden = |k: usize, i: usize| k.is_multiple_of(3) && (i + N - (5 * k) % N) % N < 3;
        (0..count).map(|k| (0..N).filter(|&i| !hidden(k, i)).collect()).collect()
    }

    #[test]
    fn complete_shapes_have_their_usual_components() {
        let points = ovals(30, 0.05);
        let all = found(&points, vec![(0..N).collect(); 30], 2).unwrap();
        let usual = complete(&points, 30);
        assert_eq!((all.rounds, all.converged), (1, true));
        for i in 0..2 {
            assert!((all.pca.eigenvalues[i] / usual.eigenvalues[i] - 1.0).abs() < 1e-9);
        }
        assert!(angle(&all.pca, &usual) < 1e-5);
        assert_eq!(all.completed, points);
    }

    #[test]
    fn modes_of_incomplete_shapes_are_those_of_complete_ones() {
        let points = ovals(60, 0.03);
        let mut holes = points.clone();
        for (shape, seen) in holes.chunks_exact_mut(2 * N).zip(gaps(60)) {
            (0..2 * N).filter(|i| !seen.contains(&(i % N))).for_each(|i| shape[i] = 1e6);
        }
        let partly = found(&holes, gaps(60), 2).unwrap();
        let usual = complete(&points, 60);
        assert!(angle(&partly.pca, &usual) < 5.0, "{}", angle(&partly.pca, &usual));
        for i in 0..2 {
            let ratio = partly.pca.eigenvalues[i] / usual.eigenvalues[i];
            assert!((0.8..1.25).contains(&ratio), "{i}: {ratio}");
        }
        // Sizes are near 30.
        let worst = points.iter().zip(&partly.completed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 2.0 && partly.converged, "{worst} {}", partly.rounds);
    }

    #[test]
    fn too_little_is_refused() {
        let points = ovals(6, 0.05);
        let field = |found: Result<IncompletePca, AnalysisError>| match found {
            Err(AnalysisError::Parameter { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        let whole = || vec![(0..N).collect::<Vec<usize>>(); 6];
        assert_eq!(field(found(&points, whole(), 5)), "components");
        let mut one = whole();
        one[2] = vec![4];
        let few = found(&points, one, 2);
        assert!(matches!(few, Err(AnalysisError::Unsuitable { index: 2, .. })), "{few:?}");
        let never = vec![(1..N).collect::<Vec<usize>>(); 6];
        assert_eq!(field(found(&points, never, 2)), "shapes");
    }
}
