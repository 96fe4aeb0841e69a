//! The learning curve: errors of shapes under components that were learnt from fewer subjects.

use shapelex_numeric::parallel;

use super::Scale;
use super::interval::Interval;
use super::sample::Sample;
use crate::AnalysisError;
use crate::random::stream;
use crate::watch::Watch;
use rand::seq::SliceRandom;

/// Parts of the subjects that are learnt from.
const PARTS: [f64; 6] = [0.1, 0.2, 0.35, 0.5, 0.7, 0.9];

/// Draws for each number of subjects.
pub(super) const DRAWS: usize = 20;

/// Maximum number of shapes that a draw describes.
const MOST_DESCRIBED: usize = 200;

/// Fewest subjects to learn from.
const FEWEST: usize = 2;

/// Errors with components from so many subjects.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct LearningPoint {
    /// Number of subjects that were learnt from.
    #[cfg_attr(feature = "serde", serde(rename = "subject_count"))]
    pub subjects: usize,
    /// Generalisation with all modes of the report: root mean square distance of corresponding points of shapes of other subjects,
    /// in the unit of the cohort. The interval is that of single draws of so many subjects.
    pub generalisation: Interval,
}

/// Numbers of subjects to learn from, ascending.
pub(super) fn sizes(subjects: usize) -> Vec<usize> {
    let of = |part: f64| (part * subjects as f64).round() as usize;
    let mut sizes: Vec<usize> =
        PARTS.into_iter().map(of).filter(|size| (FEWEST..subjects).contains(size)).collect();
    sizes.dedup();
    sizes
}

/// Errors for each of the [`sizes`]. The mean to which shapes are aligned is that of all. Cost: [`DRAWS`] eigenproblems for each size.
///
/// # Errors
/// A failure of an eigenproblem; [`AnalysisError::Interrupted`].
pub(super) fn learning_curve(
    sample: &Sample,
    scale: &Scale,
    count: usize,
    seed: u64,
    watch: &dyn Watch,
) -> Result<Vec<LearningPoint>, AnalysisError> {
    let sizes = sizes(sample.subjects.len());
    let draw = |index: usize| {
        watch.check()?;
        let mut order: Vec<usize> = (0..sample.subjects.len()).collect();
        order.shuffle(&mut stream(seed, index));
        let (inside, outside) = order.split_at(sizes[index / DRAWS]);
        let members = |subjects: &[usize]| -> Vec<usize> {
            subjects.iter().flat_map(|&subject| sample.subjects[subject].iter().copied()).collect()
        };
        let learnt: Vec<(usize, f64)> = members(inside).into_iter().map(|k| (k, 1.0)).collect();
        let part = sample.of(&learnt, count)?;
        let described = members(outside);
        let described = &described[..described.len().min(MOST_DESCRIBED)];
        let error = |&k: &usize| scale.length(k, part.errors(sample, k, count)[count]);
        watch.worked(1);
        Ok(described.iter().map(error).sum::<f64>() / described.len() as f64)
    };
    let errors: Vec<f64> = parallel::try_map::<_, AnalysisError>(sizes.len() * DRAWS, &draw)?;
    let points = sizes.iter().zip(errors.chunks_exact(DRAWS));
    Ok(points
        .map(|(&subjects, errors)| LearningPoint {
            subjects,
            generalisation: Interval::of_draws(errors.to_vec()),
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_subjects_are_always_left_to_describe() {
        assert_eq!(sizes(100), [10, 20, 35, 50, 70, 90]);
        assert_eq!(sizes(4), [2, 3]);
        assert!(sizes(2).is_empty() && sizes(1).is_empty() && sizes(0).is_empty());
    }
}
