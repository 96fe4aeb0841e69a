//! Several classifiers as one: the mean of what each holds likely.
//!
//! ```text
//! p_c = Σ_m w_m exp(β_m s_mc)/Σ_b exp(β_m s_mb),   score_c = ln p_c,   Σ w = 1
//! ```
//!
//! Scores of different kinds have different units; probabilities have none, so that they can be averaged. Which members
//! are in it, and how often, is found by adding, round by round, the one that makes the mean probability of shapes that
//! were held out likeliest. One that is best by a hair on few shapes does then not decide alone.
//!
//! Distances, by which shapes of no class are refused, are those of the first member.
//!
//! Source: Caruana, Niculescu-Mizil, Crew and Ksikes 2004 (selection with replacement).

use super::classifier::{Classifier, Kind};
use super::observations::{Description, Evidence, Observations};
use super::quality::confidences;
use crate::AnalysisError;

/// Rounds of the selection: a member weighs a twelfth at the least.
pub const ROUNDS: usize = 12;

/// Classifiers with their weights, the heaviest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Ensemble {
    /// At least one.
    pub members: Vec<Member>,
}

/// One of the classifiers.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// What kind it is.
    pub kind: Kind,
    /// The classifier.
    pub classifier: Classifier,
    /// `β` of its probabilities.
    pub sharpness: f64,
    /// `w`.
    pub weight: f64,
}

impl Ensemble {
    /// Scores `ln p`, and the distances of the first member.
    ///
    /// # Errors
    /// Those of the members.
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

/// Logarithm of a probability that may have been rounded to nothing.
pub fn logarithm(p: f64) -> f64 {
    p.max(f64::MIN_POSITIVE).ln()
}

/// How often each candidate is chosen, given the probabilities that every one of them gave to the true class of shapes held
/// out: `likelihoods[candidate][shape]`. Of equals the first. Cost `O(ROUNDS · candidates · shapes)`.
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
        // Each of the first two is sure of its own half of the shapes; the third is never sure.
        let likelihoods = vec![vec![0.9, 0.9, 0.1, 0.1], vec![0.1, 0.1, 0.9, 0.9], vec![0.3; 4]];
        assert_eq!(selected(&likelihoods), [6, 6, 0]);
        // One that is better everywhere stands alone.
        assert_eq!(selected(&[vec![0.5; 3], vec![0.8; 3]]), [0, ROUNDS]);
        assert_eq!(selected(&[vec![0.5; 3], vec![0.5; 3]]), [ROUNDS, 0], "of equals the first");
        assert!(selected(&[]).is_empty());
    }
}
