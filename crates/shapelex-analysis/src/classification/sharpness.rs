//! Confidences calibrated on a validation.
//!
//! ```text
//! p_c = exp(β s_c)/Σ exp(β s)        β maximises Σ_k ln p_{c(k)}
//! ```
//!
//! Every fold has its own `β`, from the shapes outside of it. All begin at the `β` of all shapes, where the derivatives outside of a
//! fold are those of all shapes without those of the fold, which takes one pass over the shapes for all folds.
//!
//! Sources: Guo, Pleiss, Sun and Weinberger 2017 (one temperature for all classes); Halley's iteration: Traub 1964.

use shapelex_numeric::kernels::{GROUP, exponentials};
use shapelex_numeric::lanes::vectorised;
use shapelex_numeric::parallel;

use super::observations::Evidence;
use super::quality::Held;

/// Bounds of `β`. Outside of them all confidences are equal, or all certain.
const SHARPNESS: (f64, f64) = (1e-6, 1e9);

/// Maximum number of steps.
const STEPS: usize = 200;

/// Largest factor by which a step changes `β`.
const STRIDE: f64 = 4.0;

/// Relative precision of `β`, beyond the digits that confidences show.
const PRECISION: f64 = 1e-10;

/// Distance of a score from the best one, beyond which it does not count at any `β`: its powers stay finite.
const FARTHEST: f64 = 1e90;

/// Exponent of a weight that is nothing beside that of the best class, which is 1.
const NOTHING: f64 = -700.0;

/// Shapes whose derivatives are summed before they are added to those of others. Changing it changes last bits.
const TOGETHER: usize = 256;

/// `β` that maximises the likelihood of the true classes; 1 if there are no shapes. The likelihood is concave in `β`.
///
/// If all shapes are classified correctly, the maximum is at infinity and `β` ends at its bound.
pub fn sharpness<'a>(held: impl Iterator<Item = &'a Held>) -> f64 {
    let scores = Scores::of(held);
    scores.start().map_or(1.0, |start| sharpness_near(start, |beta| scores.derivatives(beta, |_| true)))
}

/// For each of the first `folds` folds, [`sharpness`] by the shapes outside of it.
pub(super) fn outside_of_folds(held: &[Held], folds: usize) -> Vec<f64> {
    let scores = Scores::of(held.iter());
    let Some(start) = scores.start() else { return vec![1.0; folds] };
    let all = sharpness_near(start, |beta| scores.derivatives(beta, |_| true));
    let inside = parallel::map(folds, &|fold| scores.derivatives(all, |other| other == fold));
    let total = inside.iter().fold([0.0; 3], |sum, part| std::array::from_fn(|i| sum[i] + part[i]));
    parallel::map(folds, &|fold| {
        let outside = std::array::from_fn(|i| total[i] - inside[fold][i]);
        let (start, _) = step(all, outside, (all / STRIDE, all * STRIDE));
        sharpness_near(start.clamp(SHARPNESS.0, SHARPNESS.1), |beta| {
            scores.derivatives(beta, |other| other != fold)
        })
    })
}

/// The zero of the slope of a concave function of `β` by its first three derivatives, from a nearby `start`: steps within a bracket.
fn sharpness_near(start: f64, derivatives: impl Fn(f64) -> [f64; 3]) -> f64 {
    let (mut low, mut high) = SHARPNESS;
    let mut beta = start;
    for _ in 0..STEPS {
        let derivatives = derivatives(beta);
        if derivatives[0] > 0.0 {
            low = beta
        } else {
            high = beta
        }
        // Far from the maximum the likelihood is nearly straight, and an unbounded step would overshoot.
        let (next, is_cubic) = step(beta, derivatives, (low.max(beta / STRIDE), high.min(beta * STRIDE)));
        let relative = (next - beta).abs() / beta;
        // A step of cubic convergence leaves about the cube of its length.
        if relative <= PRECISION || is_cubic && relative * relative <= PRECISION {
            return next;
        }
        beta = next;
    }
    beta
}

/// Halley's step to the zero of the first derivative, within bounds, and whether it converges cubically: it is Newton's where the third
/// derivative is not small beside the second, and the middle of the bounds where there is none.
fn step(beta: f64, [slope, second, third]: [f64; 3], (least, most): (f64, f64)) -> (f64, bool) {
    let newton = -slope / second;
    let bend = 0.5 * newton * third / second;
    let is_cubic = bend.abs() < 0.5;
    let next = beta + if is_cubic { newton / (1.0 + bend) } else { newton };
    if next.is_nan() {
        return ((least * most).sqrt(), false);
    }
    (next.clamp(least, most), is_cubic && least <= next && next <= most)
}

/// Confidence `p_c` of every class.
pub fn confidences(evidence: &Evidence, beta: f64) -> Vec<f64> {
    let scores = &evidence.scores;
    let best = scores.iter().copied().fold(f64::MIN, f64::max);
    let mut weights: Vec<f64> = scores.iter().map(|s| beta * (s - best)).collect();
    vectorised(
        #[inline(always)]
        || {
            for weights in weights.chunks_mut(GROUP) {
                let mut exponents = [0.0; GROUP];
                exponents[..weights.len()].copy_from_slice(weights);
                let found = exponentials(exponents);
                for (weight, found) in weights.iter_mut().zip(found) {
                    *weight = if *weight > NOTHING { found } else { 0.0 };
                }
            }
        },
    );
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

/// Scores of shapes that were held out, relative to the best one of each shape.
struct Scores {
    classes: usize,
    /// Shape by shape; none is positive.
    scores: Vec<f64>,
    /// Scores of the true classes, one for each shape.
    own: Vec<f64>,
    folds: Vec<usize>,
}

impl Scores {
    fn of<'a>(held: impl Iterator<Item = &'a Held>) -> Self {
        let mut all = Self { classes: 0, scores: Vec::new(), own: Vec::new(), folds: Vec::new() };
        for held in held {
            let scores = &held.evidence.scores;
            let best = scores.iter().copied().fold(f64::MIN, f64::max);
            let relative = |s: &f64| (s - best).max(-FARTHEST);
            all.classes = scores.len();
            all.scores.extend(scores.iter().map(relative));
            all.own.push(relative(&scores[held.class]));
            all.folds.push(held.fold);
        }
        all
    }

    /// A first `β`: the reciprocal spread of the scores of a shape. `None` if there are no shapes, or none has a spread.
    fn start(&self) -> Option<f64> {
        let squares = self.scores.chunks_exact(self.classes.max(1)).map(|scores| {
            let near = || scores.iter().filter(|s| **s > -FARTHEST);
            let (count, sum) = near().fold((0.0, 0.0), |(count, sum), s| (count + 1.0, sum + s));
            near().map(|s| (s - sum / count).powi(2)).sum::<f64>() / count
        });
        let spread = (squares.sum::<f64>() / self.own.len() as f64).sqrt();
        (spread > 0.0).then(|| spread.recip().clamp(SHARPNESS.0, SHARPNESS.1))
    }

    /// First three derivatives of `Σ ln p_c(k)` over the shapes of the folds chosen: `Σ (s_c(k) − E s)`, `−Σ Var s`, and minus the sum of
    /// the third central moments, under `p`.
    fn derivatives(&self, beta: f64, chosen: impl Fn(usize) -> bool + Sync) -> [f64; 3] {
        let sums = parallel::map(self.own.len().div_ceil(TOGETHER), &|part| {
            let shapes = part * TOGETHER..((part + 1) * TOGETHER).min(self.own.len());
            vectorised(
                #[inline(always)]
                || {
                    let mut sums = [0.0; 3];
                    for k in shapes.clone() {
                        if chosen(self.folds[k]) {
                            let scores = &self.scores[k * self.classes..(k + 1) * self.classes];
                            let [mean, variance, skew] = central_moments(scores, beta);
                            sums[0] += self.own[k] - mean;
                            sums[1] -= variance;
                            sums[2] -= skew;
                        }
                    }
                    sums
                },
            )
        });
        sums.iter().fold([0.0; 3], |sum, part| std::array::from_fn(|i| sum[i] + part[i]))
    }
}

/// Mean, variance and third central moment of scores up to zero under `p ∝ exp(β s)`.
#[inline(always)]
fn central_moments(scores: &[f64], beta: f64) -> [f64; 3] {
    let mut sums = [[0.0; GROUP]; 4];
    let (groups, rest) = scores.as_chunks::<GROUP>();
    for s in groups {
        add_moments(&mut sums, s, exponentials(s.map(|s| beta * s)));
    }
    if !rest.is_empty() {
        let mut last = [0.0; GROUP];
        last[..rest.len()].copy_from_slice(rest);
        let mut weights = exponentials(last.map(|s| beta * s));
        weights[rest.len()..].fill(0.0);
        add_moments(&mut sums, &last, weights);
    }
    let [sum, first, second, third] = sums.map(|lanes| lanes.iter().sum::<f64>());
    let (mean, second, third) = (first / sum, second / sum, third / sum);
    let variance = (second - mean * mean).max(0.0);
    [mean, variance, third - mean * (3.0 * second - 2.0 * mean * mean)]
}

/// Adds `w`, `w s`, `w s²` and `w s³`.
#[inline(always)]
fn add_moments(sums: &mut [[f64; GROUP]; 4], s: &[f64; GROUP], weights: [f64; GROUP]) {
    for k in 0..GROUP {
        let (first, second) = (weights[k] * s[k], weights[k] * s[k] * s[k]);
        sums[0][k] += weights[k];
        sums[1][k] += first;
        sums[2][k] += second;
        sums[3][k] += second * s[k];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(class: usize, fold: usize, scores: Vec<f64>) -> Held {
        Held { shape: 0, class, fold, evidence: Evidence { distances: vec![0.0; scores.len()], scores } }
    }

    /// Shapes of `classes` classes, whose scores lean to the true one.
    fn drawn(shapes: usize, classes: usize, folds: usize) -> Vec<Held> {
        let score = |k: usize, c: usize| 3.0 * ((k * 37 + c * 101 + k * c) as f64 * 0.7).sin();
        let shape = |k: usize| {
            let class = (7 * k) % classes;
            let lean = |c: usize| score(k, c) + if c == class { 2.5 } else { 0.0 };
            held(class, k % folds, (0..classes).map(lean).collect())
        };
        (0..shapes).map(shape).collect()
    }

    /// Slope of the likelihood by the exponential function of the library.
    fn slope(held: &[&Held], beta: f64) -> f64 {
        let of = |held: &&Held| {
            let weights = held.evidence.scores.iter().map(|s| (beta * s).exp());
            let sums =
                weights.zip(&held.evidence.scores).fold((0.0, 0.0), |(a, b), (w, s)| (a + w, b + w * s));
            held.evidence.scores[held.class] - sums.1 / sums.0
        };
        held.iter().map(of).sum()
    }

    /// Zero of the slope by bisection.
    fn expected(held: &[&Held]) -> f64 {
        let halve = |(low, high): (f64, f64), _| {
            let middle = 0.5 * (low + high);
            if slope(held, middle) > 0.0 { (middle, high) } else { (low, middle) }
        };
        (0..200).fold((1e-3, 100.0), halve).0
    }

    #[test]
    fn scores_that_are_logarithms_of_frequencies_are_calibrated() {
        // 0.8 of the shapes assigned to class 0 with confidence 0.8 belong to it: β undoes the factor.
        for factor in [0.01, 1.0, 30.0] {
            let scores = [0.8_f64, 0.2].map(|p| factor * p.ln());
            let shapes: Vec<Held> = (0..10).map(|k| held(usize::from(k >= 8), 0, scores.to_vec())).collect();
            let beta = sharpness(shapes.iter());
            assert!((beta * factor - 1.0).abs() < 1e-9, "{beta} {factor}");
        }
        assert_eq!(sharpness([].iter()), 1.0);
        assert_eq!(outside_of_folds(&[], 3), [1.0; 3]);
    }

    #[test]
    fn every_fold_has_the_sharpness_of_the_shapes_outside_of_it() {
        for (shapes, classes, folds) in [(60, 2, 5), (900, 7, 3), (700, 40, 15)] {
            let all = drawn(shapes, classes, folds);
            let found = outside_of_folds(&all, folds);
            for (fold, found) in found.iter().enumerate() {
                let outside: Vec<&Held> = all.iter().filter(|held| held.fold != fold).collect();
                let expected = expected(&outside);
                assert!((found / expected - 1.0).abs() < 1e-10, "{found} for {expected}, {classes} classes");
                let alone = sharpness(outside.into_iter());
                assert!((found / alone - 1.0).abs() < 1e-10, "{found} for {alone}");
            }
            let total = expected(&all.iter().collect::<Vec<_>>());
            assert!((sharpness(all.iter()) / total - 1.0).abs() < 1e-10);
        }
    }

    #[test]
    fn scores_without_an_end_and_without_errors_are_borne() {
        let sure = drawn(40, 3, 2).into_iter().map(|held| Held { class: held.evidence.best(), ..held });
        let sure: Vec<Held> = sure.collect();
        assert!(sharpness(sure.iter()) > 10.0, "no error: certain");
        let excluded = |k: usize| {
            let class = if k.is_multiple_of(4) { 1 } else { 0 };
            held(class, 0, vec![0.0, -1.0, f64::NEG_INFINITY])
        };
        let shapes: Vec<Held> = (0..40).map(excluded).collect();
        // A quarter belongs to the second class: β = ln 3.
        assert!((sharpness(shapes.iter()) / 3.0_f64.ln() - 1.0).abs() < 1e-10);
    }
}
