//! Figures of a validation.
//!
//! ```text
//! p_c = exp(β s_c)/Σ exp(β s)        β of the other folds: see `sharpness`
//! Brier = mean Σ_c (p_c − [c = c(k)])²        95 % intervals by Wilson's score
//! ```
//!
//! Sources: Brier 1950; Wilson 1927.

use super::observations::Evidence;
use super::sharpness::{confidences, outside_of_folds};

/// A held-out shape with its evidence from a classifier trained without it.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// Position of the shape.
    pub shape: usize,
    /// True class of the shape.
    pub class: usize,
    /// Fold in which the shape was held out.
    pub fold: usize,
    /// Evidence for the shape.
    pub evidence: Evidence,
}

/// A proportion with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// The estimate.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Part {
    /// Wilson's score interval of the proportion `value` among `n` independent cases.
    pub fn of(value: f64, n: f64) -> Self {
        if !(n > 0.0) {
            return Self { value, low: 0.0, high: 1.0 };
        }
        let z2 = QUANTILE_975 * QUANTILE_975;
        let centre = (value + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = QUANTILE_975 / (1.0 + z2 / n) * (value * (1.0 - value) / n + z2 / (4.0 * n * n)).sqrt();
        Self { value, low: (centre - half).max(0.0).min(value), high: (centre + half).min(1.0).max(value) }
    }
}

/// 97.5 % quantile of the standard normal distribution.
const QUANTILE_975: f64 = 1.959_963_984_540_054;

/// Shapes with a confidence in their best class that lies in one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bin {
    /// Number of shapes, over all repeats.
    pub count: usize,
    /// Mean confidence.
    pub confidence: f64,
    /// Proportion that is classified correctly.
    pub accuracy: f64,
}

/// Number of equal intervals of confidence.
pub const BINS: usize = 10;

/// Figures of a validation.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Proportion of shapes that are classified correctly.
    pub accuracy: Part,
    /// Accuracy of every repeat.
    pub accuracies: Vec<f64>,
    /// Mean of the recalls of the classes.
    pub balanced_accuracy: Part,
    /// Recall of every class: the proportion of its shapes that are assigned to it.
    pub recall: Vec<Part>,
    /// Precision of every class: the proportion of the shapes assigned to it that belong to it. Null if there are none.
    pub precision: Vec<Option<f64>>,
    /// Counts over all repeats. Rows: true classes; columns: assigned classes.
    pub confusion: Vec<Vec<usize>>,
    /// Brier score: mean of `Σ_c (p_c − [c = c(k)])²`, with `β` from the other folds.
    pub brier: f64,
    /// Logarithmic loss: mean of `−ln p_{c(k)}`.
    pub log_loss: f64,
    /// Reliability by confidence in the best class.
    pub reliability: Vec<Bin>,
}

/// Confidence below which the logarithm is cut off, so that one shape with a confidence near zero does not dominate.
const LEAST: f64 = 1e-12;

impl Quality {
    /// Figures from shapes of `classes` classes, each held out `repeats` times. `units` is the number of independent cases
    /// (subjects) in every class, `all_units` the number in all classes.
    pub fn new(held: &[Held], classes: usize, repeats: usize, units: &[usize], all_units: usize) -> Self {
        let mut confusion = vec![vec![0_usize; classes]; classes];
        let folds = held.iter().map(|held| held.fold + 1).max().unwrap_or(1);
        let per_repeat = folds.div_ceil(repeats.max(1));
        let betas = outside_of_folds(held, folds);
        let (mut brier, mut log_loss) = (0.0, 0.0);
        let mut bins = vec![Bin::default(); BINS];
        let mut right = vec![(0_usize, 0_usize); repeats.max(1)];
        for one in held {
            let best = one.evidence.best();
            confusion[one.class][best] += 1;
            let repeat = (one.fold / per_repeat).min(right.len() - 1);
            right[repeat].0 += usize::from(best == one.class);
            right[repeat].1 += 1;
            let p = confidences(&one.evidence, betas[one.fold]);
            let off = |c: usize| p[c] - f64::from(u8::from(c == one.class));
            brier += (0..classes).map(|c| off(c).powi(2)).sum::<f64>();
            log_loss -= p[one.class].max(LEAST).ln();
            let bin = &mut bins[((p[best] * BINS as f64) as usize).min(BINS - 1)];
            bin.count += 1;
            bin.confidence += p[best];
            bin.accuracy += f64::from(u8::from(best == one.class));
        }
        for bin in &mut bins {
            bin.confidence /= bin.count.max(1) as f64;
            bin.accuracy /= bin.count.max(1) as f64;
        }
        let total = held.len().max(1) as f64;
        let column = |c: usize| -> usize { confusion.iter().map(|row| row[c]).sum() };
        let recall: Vec<Part> = (0..classes)
            .map(|c| {
                let all: usize = confusion[c].iter().sum();
                Part::of(confusion[c][c] as f64 / all.max(1) as f64, units[c] as f64)
            })
            .collect();
        let correct: usize = (0..classes).map(|c| confusion[c][c]).sum();
        Self {
            accuracy: Part::of(correct as f64 / total, all_units as f64),
            accuracies: right.iter().map(|(right, all)| *right as f64 / (*all).max(1) as f64).collect(),
            balanced_accuracy: balanced(&recall, units),
            precision: (0..classes)
                .map(|c| {
                    Some(column(c)).filter(|&all| all > 0).map(|all| confusion[c][c] as f64 / all as f64)
                })
                .collect(),
            recall,
            confusion,
            brier: brier / total,
            log_loss: log_loss / total,
            reliability: bins,
        }
    }
}

/// The mean recall. Its interval comes from the binomial variances of the recalls, with two successes and two failures added
/// to every class, so that a class without errors does not count as certain (Agresti and Coull 1998).
fn balanced(recall: &[Part], units: &[usize]) -> Part {
    let count = recall.len() as f64;
    let value = recall.iter().map(|part| part.value).sum::<f64>() / count;
    let variance: f64 = recall
        .iter()
        .zip(units)
        .map(|(part, &n)| {
            let n = n as f64 + 4.0;
            let p = (part.value * (n - 4.0) + 2.0) / n;
            p * (1.0 - p) / n
        })
        .sum();
    let half = QUANTILE_975 * variance.sqrt() / count;
    Part { value, low: (value - half).max(0.0), high: (value + half).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(class: usize, fold: usize, probabilities: &[f64], factor: f64) -> Held {
        let scores = probabilities.iter().map(|p| factor * p.ln()).collect();
        Held {
            shape: 0,
            class,
            fold,
            evidence: Evidence { distances: vec![0.0; probabilities.len()], scores },
        }
    }

    #[test]
    fn figures_by_hand() {
        // Two folds of five shapes each: four of class 0 (three found) and one of class 1 (not found).
        let part = |fold: usize| {
            let say = |class: usize, said: usize| {
                held(class, fold, if said == 0 { &[0.6, 0.4] } else { &[0.4, 0.6] }, 1.0)
            };
            vec![say(0, 0), say(0, 0), say(0, 0), say(0, 1), say(1, 0)]
        };
        let all = [part(0), part(1)].concat();
        let quality = Quality::new(&all, 2, 1, &[8, 2], 10);
        assert_eq!(quality.confusion, [[6, 2], [2, 0]]);
        assert!((quality.accuracy.value - 0.6).abs() < 1e-15);
        assert!((quality.balanced_accuracy.value - 0.375).abs() < 1e-15);
        assert_eq!(quality.precision, [Some(0.75), Some(0.0)]);
        // Of five shapes, three are right at 0.6 and two wrong at 0.6: β = 1 in both folds.
        let brier = (3.0 * 2.0 * 0.16 + 2.0 * 2.0 * 0.36) / 5.0;
        assert!((quality.brier - brier).abs() < 1e-9, "{}", quality.brier);
        let bin = quality.reliability.iter().find(|bin| bin.count > 0).unwrap();
        assert!(bin.count == 10 && (bin.accuracy - 0.6).abs() < 1e-15 && (bin.confidence - 0.6).abs() < 1e-9);
        // Wilson's interval for 6 of 10, from the formula.
        assert!((quality.accuracy.low - 0.312_673_8).abs() < 1e-6, "{}", quality.accuracy.low);
        assert!((quality.accuracy.high - 0.831_819_7).abs() < 1e-6, "{}", quality.accuracy.high);
    }
}
