//! An ensemble of classifiers: the weighted mean of their class probabilities.
//!
//! ```text
//! p_c = Σ_m w_m exp(β_m s_mc)/Σ_b exp(β_m s_mb),   score_c = ln p_c,   Σ w = 1
//! ```
//!
//! Scores of different kinds have different units; probabilities have none and can be averaged. Members and their weights
//! are found by greedy selection: every round adds the candidate that maximises the likelihood of the mean probability on
//! held-out shapes. A candidate that is slightly better on a few shapes therefore does not decide alone.
//!
//! Distances, which serve to reject shapes of no class, are those of the first member.
//!
//! Source: Caruana, Niculescu-Mizil, Crew and Ksikes 2004 (selection with replacement).

use super::classifier::{Classifier, Kind};
use super::observations::{Description, Evidence, Observations};
use super::sharpness::confidences;
use crate::AnalysisError;

/// Rounds of the selection; the smallest weight of a member is therefore a twelfth.
pub const ROUNDS: usize = 12;

/// Classifiers with their weights, in descending order of weight.
#[derive(Debug, Clone, PartialEq)]
pub struct Ensemble {
    /// The members, at least one.
    pub members: Vec<Member>,
}

/// One member of an ensemble.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Kind of the classifier.
    pub kind: Kind,
    /// The classifier.
    pub classifier: Classifier,
    /// `β` of its class probabilities.
    pub sharpness: f64,
    /// Weight `w`.
    pub weight: f64,
}

impl Ensemble {
    /// Scores `ln p` of the ensemble, with the distances of the first member.
    ///
    /// # Errors
    /// Errors of the members.
    pub(super) fn evidence(
        &self,
        description: Description<'_>,
        observations: Observations<'_>,
    ) -> Result<Vec<Evidence>, AnalysisError> {
        let mut mean: Vec<Evidence> = Vec::new();
        for member in &self.members {
            let found = member.classifier.evidence(description, observations)?;
            if mean.is_empty() {
                let empty = |one: &Evidence| Evidence {
                    distances: one.distances.clone(),
                    scores: vec![0.0; one.scores.len()],
                };
                mean = found.iter().map(empty).collect();
            }
            for (mean, one) in mean.iter_mut().zip(&found) {
                let p = confidences(one, member.sharpness);
                mean.scores.iter_mut().zip(p).for_each(|(sum, p)| *sum += member.weight * p);
            }
        }
        for score in mean.iter_mut().flat_map(|evidence| &mut evidence.scores) {
            *score = logarithm(*score);
        }
        Ok(mean)
    }
}

/// Logarithm of a probability that may have been rounded to zero.
pub fn logarithm(p: f64) -> f64 {
    p.max(f64::MIN_POSITIVE).ln()
}

/// Number of times each candidate is selected, from the probabilities that each of them gave to the true class of held-out
/// shapes: `likelihoods[candidate][shape]`. The first candidate wins a tie. Cost `O(ROUNDS · candidates · shapes)`.
pub fn selected(likelihoods: &[Vec<f64>]) -> Vec<usize> {
    let shapes = likelihoods.first().map_or(0, Vec::len);
    let mut chosen = vec![0; likelihoods.len()];
    let mut sum = vec![0.0; shapes];
    for _ in 0..ROUNDS {
        let gain = |candidate: &Vec<f64>| -> f64 {
            sum.iter().zip(candidate).map(|(sum, p)| logarithm(sum + p)).sum()
        };
        let gains: Vec<f64> = likelihoods.iter().map(gain).collect();
        let best = (1..gains.len()).fold(0, |best, i| if gains[i] > gains[best] { i } else { best });
        let Some(candidate) = likelihoods.get(best) else { break };
        chosen[best] += 1;
        sum.iter_mut().zip(candidate).for_each(|(sum, p)| *sum += p);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_that_help_each_other_are_chosen_together() {
        // Each of the first two is certain on its own half of the shapes; the third is never certain.
        let likelihoods = vec![vec![0.9, 0.9, 0.1, 0.1], vec![0.1, 0.1, 0.9, 0.9], vec![0.3; 4]];
        assert_eq!(selected(&likelihoods), [6, 6, 0]);
        // A candidate that is better everywhere is selected alone.
        assert_eq!(selected(&[vec![0.5; 3], vec![0.8; 3]]), [0, ROUNDS]);
        assert_eq!(selected(&[vec![0.5; 3], vec![0.5; 3]]), [ROUNDS, 0], "of equals the first");
        assert!(selected(&[]).is_empty());
    }
}
