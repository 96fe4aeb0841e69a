//! Folds for cross-validation, stratified by class and grouped by subject.

use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rand::seq::SliceRandom;

/// The fold of every shape, from 0. Shapes of one group (a subject) share a fold, and all folds have nearly equal
/// fractions of every class.
///
/// Groups are taken in an order drawn from `seed`, largest first, and each goes to the fold that has least of its
/// classes. Deterministic for a given seed. Cost `O(n log n + groups·folds·classes of a group)`.
pub fn stratified(classes: &[usize], groups: &[usize], folds: usize, seed: u64) -> Vec<usize> {
    let count = classes.iter().max().map_or(0, |most| most + 1);
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); groups.iter().max().map_or(0, |most| most + 1)];
    groups.iter().enumerate().for_each(|(k, &group)| members[group].push(k));
    let mut sizes = vec![0_usize; count];
    classes.iter().for_each(|&class| sizes[class] += 1);
    let mut order: Vec<usize> = (0..members.len()).filter(|&group| !members[group].is_empty()).collect();
    order.shuffle(&mut ChaCha12Rng::seed_from_u64(seed));
    order.sort_by_key(|&group| std::cmp::Reverse(members[group].len()));
    let mut filled = vec![vec![0_usize; count]; folds];
    let mut totals = vec![0_usize; folds];
    let mut fold_of = vec![0; classes.len()];
    for group in order {
        let members = &members[group];
        let load = |fold: usize| -> f64 {
            members.iter().map(|&k| filled[fold][classes[k]] as f64 / sizes[classes[k]] as f64).sum()
        };
        let loads: Vec<f64> = (0..folds).map(load).collect();
        let best = (1..folds).fold(0, |best, fold| {
            let less = loads[fold].total_cmp(&loads[best]).then(totals[fold].cmp(&totals[best])).is_lt();
            if less { fold } else { best }
        });
        for &k in members {
            filled[best][classes[k]] += 1;
            totals[best] += 1;
            fold_of[k] = best;
        }
    }
    fold_of
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_spread_and_groups_stay_together() {
        let classes: Vec<usize> = (0..60).map(|k| usize::from(k % 3 == 0)).collect();
        let alone: Vec<usize> = (0..60).collect();
        let folds = stratified(&classes, &alone, 5, 7);
        for fold in 0..5 {
            let of_class = |class| (0..60).filter(|&k| folds[k] == fold && classes[k] == class).count();
            assert_eq!((of_class(0), of_class(1)), (8, 4));
        }
        assert_ne!(folds, stratified(&classes, &alone, 5, 8), "the seed draws the order");
        let pairs: Vec<usize> = (0..60).map(|k| k / 2).collect();
        let folds = stratified(&classes, &pairs, 5, 7);
        assert!((0..30).all(|pair| folds[2 * pair] == folds[2 * pair + 1]));
        for fold in 0..5 {
            let of_class = |class| (0..60).filter(|&k| folds[k] == fold && classes[k] == class).count();
            assert!((7..=9).contains(&of_class(0)) && (3..=5).contains(&of_class(1)));
        }
    }
}
