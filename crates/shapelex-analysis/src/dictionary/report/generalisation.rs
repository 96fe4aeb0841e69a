//! Generalisation: errors of shapes that the components of all other subjects describe, for each number of components.

use super::sample::Sample;
use super::{ByNumber, PointSets, Scale};
use crate::AnalysisError;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Leaves every subject out once. Cost per subject: an eigenproblem for `count` pairs of the rank of the sample.
///
/// # Errors
/// A failure of an eigenproblem; [`AnalysisError::Interrupted`].
pub(super) fn generalisation(
    sample: &Sample,
    scale: &Scale,
    sets: &PointSets<'_>,
    count: usize,
    watch: &dyn Watch,
) -> Result<ByNumber, AnalysisError> {
    let chosen = sets.chosen(sample.count(), count);
    let left_out = |subject: usize| {
        watch.check()?;
        let others = sample.without(subject, count)?;
        let members = &sample.subjects[subject];
        let points = members.iter().map(|&k| {
            let errors = others.errors(sample, k, count).into_iter();
            errors.map(|error| scale.length(k, error)).collect()
        });
        let points = mean_of(points.collect());
        let shown = members.iter().filter(|k| chosen.binary_search(k).is_ok());
        let distances = shown.map(|&k| {
            let away = Matrix::from_vec(sample.values.len(), 1, others.away(sample, k));
            let mut scores = others.pairs.vectors.tr_mul(&away);
            let mut by_count = Vec::with_capacity(count + 1);
            let shape = sets.shape(sample.shape(k));
            for i in (0..=count).rev() {
                // Directions beyond the rank of the others describe nothing more.
                let known = i.min(scores.nrows());
                scores.rows_mut(known, scores.nrows() - known).fill(0.0);
                let described = &others.pairs.vectors * &scores;
                let z: Vec<f64> = described.iter().zip(&others.shift).map(|(s, d)| s + d).collect();
                by_count.push(sets.distance(&shape, &sets.shape(&z)).map(|found| scale.set(k, found)));
            }
            by_count.reverse();
            by_count.into_iter().collect::<Option<Vec<f64>>>()
        });
        let distances: Option<Vec<Vec<f64>>> = distances.collect();
        watch.worked(members.len());
        Ok((points, distances.filter(|found| !found.is_empty()).map(mean_of)))
    };
    let subjects: Vec<(Vec<f64>, Option<Vec<f64>>)> =
        parallel::try_map::<_, AnalysisError>(sample.subjects.len(), &left_out)?;
    Ok(ByNumber::of(subjects))
}

/// Mean of lists, entry by entry.
fn mean_of(lists: Vec<Vec<f64>>) -> Vec<f64> {
    let entries = lists.first().map_or(0, Vec::len);
    let count = lists.len() as f64;
    (0..entries).map(|i| lists.iter().map(|list| list[i]).sum::<f64>() / count).collect()
}
