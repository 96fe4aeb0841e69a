//! Relabellings: alternative assignments of shapes to groups, for permutation tests.
//!
//! Labels are exchanged within strata only, so that the number of shapes of every group in a stratum does not change. If
//! there are no more relabellings than requested, all of them are enumerated and the p value is exact. Otherwise they are
//! drawn, each from a separate random stream, so that they do not depend on the number of threads.

use std::collections::BTreeMap;

use crate::random::{shuffle, stream};

/// Parameters of the permutation draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draws<'a> {
    /// The stratum of every shape: labels or residuals are exchanged within strata only.
    pub strata: &'a [usize],
    /// Seed of the random numbers.
    pub seed: u64,
    /// Number of draws.
    pub permutations: usize,
}

/// Positions whose labels are exchangeable, and the groups among them with the numbers of their shapes.
#[derive(Debug, Clone)]
struct Stratum {
    members: Vec<usize>,
    counts: BTreeMap<usize, usize>,
}

/// The relabellings of a set of shapes.
#[derive(Debug, Clone)]
pub struct Relabellings {
    observed: Vec<usize>,
    groups: usize,
    strata: Vec<Stratum>,
    seed: u64,
    draws: usize,
    exact: bool,
}

/// Number of relabellings that reach an observed statistic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// Relabellings that reach it, without the observed labelling.
    pub exceeding: usize,
    /// All relabellings that were evaluated, without the observed labelling.
    pub permutations: usize,
    /// Whether all relabellings were enumerated.
    pub exact: bool,
}

impl Tally {
    /// The p value, `(1 + exceeding)/(1 + permutations)`; `None` without permutations.
    ///
    /// Source: Phipson and Smyth 2010: the p value of a permutation test is never zero.
    pub fn p(&self) -> Option<f64> {
        (self.permutations > 0).then(|| (1 + self.exceeding) as f64 / (1 + self.permutations) as f64)
    }
}

impl Relabellings {
    /// Relabellings of shapes, where shape `k` has the group `observed[k] < groups` and the stratum `strata[k]`. All of them if
    /// there are at most `permutations` besides the observed one, else `permutations` draws.
    pub fn new(
        observed: Vec<usize>,
        groups: usize,
        strata: &[usize],
        seed: u64,
        permutations: usize,
    ) -> Self {
        let strata = strata_of(&observed, strata);
        let all = arrangements(&strata, permutations as u64 + 1);
        let exact = all.is_some();
        let draws = match all {
            Some(all) if permutations > 0 => all as usize,
            _ => permutations,
        };
        Self { observed, groups, strata, seed, draws, exact }
    }

    /// Number of shapes in strata with more than one group. Relabelling does not affect the other shapes.
    pub fn exchangeable(&self) -> usize {
        let mixed = |stratum: &&Stratum| stratum.counts.values().all(|&count| count < stratum.members.len());
        self.strata.iter().filter(mixed).map(|stratum| stratum.members.len()).sum()
    }

    /// Whether labels are exchanged within several strata.
    pub fn is_stratified(&self) -> bool {
        self.strata.iter().filter(|stratum| !stratum.members.is_empty()).count() > 1
    }

    /// The observed labels.
    pub fn observed(&self) -> &[usize] {
        &self.observed
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.groups
    }

    /// Number of relabellings that [`Self::relabel`] makes. If these are all, the observed one is among them.
    pub fn draws(&self) -> usize {
        self.draws
    }

    /// Number of different relabellings; infinite beyond the range of numbers.
    pub fn distinct(&self) -> f64 {
        let mut all = 1.0;
        for stratum in &self.strata {
            let mut places = stratum.members.len();
            for &count in stratum.counts.values() {
                // Each partial product is a binomial coefficient.
                let fewer = count.min(places - count);
                all *= (1..=fewer).fold(1.0, |value, i| value * (places - fewer + i) as f64 / i as f64);
                places -= count;
            }
        }
        all
    }

    /// Whether the observed labelling is one of those that [`Self::relabel`] makes, because all of them are enumerated.
    pub fn hold_observed(&self) -> bool {
        self.exact && self.draws > 0
    }

    /// Writes the labels of relabelling `index`, which must be below `draws`.
    pub fn relabel(&self, index: usize, labels: &mut [usize]) {
        if self.exact {
            return self.arrange(index as u64, labels);
        }
        labels.copy_from_slice(&self.observed);
        let mut random = stream(self.seed, index);
        for stratum in &self.strata {
            shuffle(&mut random, &stratum.members, labels);
        }
    }

    /// The tally of a statistic that is reached by `reaching` relabellings.
    pub fn tally(&self, reaching: usize) -> Tally {
        // If all relabellings are enumerated, the observed one is among them and reaches itself.
        let own = usize::from(self.hold_observed());
        Tally {
            exceeding: reaching.saturating_sub(own),
            permutations: self.draws.saturating_sub(own),
            exact: self.exact,
        }
    }

    /// Writes the relabelling with this number. In mixed radix, it has one digit per stratum and group, which selects the
    /// places of the group among those that are left.
    fn arrange(&self, mut index: u64, labels: &mut [usize]) {
        for stratum in &self.strata {
            let mut places = stratum.members.clone();
            for (&group, &count) in &stratum.counts {
                let radix = binomial(places.len(), count, u64::MAX).unwrap_or(1);
                let taken = combination(index % radix, places.len(), count);
                index /= radix;
                let mut left = Vec::with_capacity(places.len() - count);
                for (place, taken) in places.into_iter().zip(taken) {
                    if taken {
                        labels[place] = group;
                    } else {
                        left.push(place);
                    }
                }
                places = left;
            }
        }
    }
}

fn strata_of(observed: &[usize], strata: &[usize]) -> Vec<Stratum> {
    let count = strata.iter().map(|stratum| stratum + 1).max().unwrap_or(0);
    let mut found = vec![Stratum { members: Vec::new(), counts: BTreeMap::new() }; count];
    for (position, (&group, &stratum)) in observed.iter().zip(strata).enumerate() {
        found[stratum].members.push(position);
        *found[stratum].counts.entry(group).or_insert(0) += 1;
    }
    found
}

/// Number of relabellings; `None` if there are more than `most`.
fn arrangements(strata: &[Stratum], most: u64) -> Option<u64> {
    let mut all = 1_u64;
    for stratum in strata {
        let mut places = stratum.members.len();
        for &count in stratum.counts.values() {
            all = all.checked_mul(binomial(places, count, most)?).filter(|&all| all <= most)?;
            places -= count;
        }
    }
    Some(all)
}

/// The binomial coefficient `n` over `k`; `None` if it is larger than `most`.
fn binomial(n: usize, k: usize, most: u64) -> Option<u64> {
    let k = k.min(n - k);
    let mut value = 1_u128;
    for i in 1..=k {
        // Every partial product is a binomial coefficient, and the sequence increases.
        value = value * (n - k + i) as u128 / i as u128;
        if value > u128::from(most) {
            return None;
        }
    }
    u64::try_from(value).ok()
}

/// The subset with number `index` of `k` among `n` places, in lexicographic order.
fn combination(mut index: u64, n: usize, mut k: usize) -> Vec<bool> {
    let mut taken = vec![false; n];
    for (place, taken) in taken.iter_mut().enumerate() {
        if k == 0 {
            break;
        }
        let with_it = binomial(n - place - 1, k - 1, u64::MAX).unwrap_or(u64::MAX);
        if index < with_it {
            *taken = true;
            k -= 1;
        } else {
            index -= with_it;
        }
    }
    taken
}

/// Holm's step-down correction: `p̃_(i) = max_{j ≤ i} min(1, (m − j + 1) p_(j))` for the ascending `p_(1) … p_(m)`, in the
/// order of `p`. It is valid for any dependence between the tests.
///
/// Source: Holm 1979.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&i, &j| p[i].total_cmp(&p[j]));
    let mut corrected = vec![0.0; p.len()];
    let mut largest = 0.0_f64;
    for (rank, &i) in order.iter().enumerate() {
        largest = largest.max(((p.len() - rank) as f64 * p[i]).min(1.0));
        corrected[i] = largest;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn holm_as_worked_by_hand() {
        // Sorted: 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1 gives 0.02, 0.03, 0.06, and 0.04 raised to the previous 0.06.
        let corrected = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (found, wanted) in corrected.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((found - wanted).abs() < 1e-15, "{corrected:?}");
        }
        assert_eq!(holm(&[0.6, 0.7]), [1.0, 1.0]);
        assert_eq!(holm(&[]), [0.0; 0]);
    }

    #[test]
    fn all_relabellings_are_gone_through_once() {
        for (observed, groups, strata, all) in [
            (vec![0, 0, 0, 1, 1, 1], 2, vec![0; 6], 20),
            (vec![0, 1, 2, 0, 1, 0], 3, vec![0; 6], 60),
            (vec![0, 1, 0, 1, 1, 0, 0], 2, vec![0, 0, 1, 1, 1, 2, 2], 6),
        ] {
            let relabellings = Relabellings::new(observed.clone(), groups, &strata, 0, 1000);
            assert_eq!(relabellings.draws(), all);
            let mut found = BTreeSet::new();
            for index in 0..all {
                let mut labels = vec![0; observed.len()];
                relabellings.relabel(index, &mut labels);
                for stratum in 0..=*strata.iter().max().unwrap() {
                    let of = |labels: &[usize]| {
                        let in_it = labels.iter().zip(&strata).filter(|(_, s)| **s == stratum);
                        let mut labels: Vec<usize> = in_it.map(|(label, _)| *label).collect();
                        labels.sort_unstable();
                        labels
                    };
                    assert_eq!(of(&labels), of(&observed));
                }
                found.insert(labels);
            }
            assert_eq!(found.len(), all);
            assert!(found.contains(&observed));
            let wanted = Tally { exceeding: 4, permutations: all - 1, exact: true };
            assert_eq!(relabellings.tally(5), wanted);
        }
    }

    #[test]
    fn draws_stay_within_strata_and_every_label_is_equally_likely() {
        let observed: Vec<usize> = (0..40).map(|k| usize::from(k % 4 == 0)).collect();
        let strata: Vec<usize> = (0..40).map(|k| k / 20).collect();
        let relabellings = Relabellings::new(observed, 2, &strata, 7, 4000);
        assert_eq!((relabellings.draws(), relabellings.exchangeable()), (4000, 40));
        let (mut labels, mut ones) = (vec![0; 40], vec![0; 40]);
        for index in 0..4000 {
            relabellings.relabel(index, &mut labels);
            assert_eq!(labels[..20].iter().sum::<usize>(), 5);
            ones.iter_mut().zip(&labels).for_each(|(ones, label)| *ones += label);
        }
        // Expected value 1000, standard deviation 27.
        assert!(ones.iter().all(|ones| (850..1150).contains(ones)), "{ones:?}");
    }

    #[test]
    fn what_cannot_be_exchanged_is_told() {
        let relabellings = Relabellings::new(vec![0, 0, 1, 1], 2, &[0, 0, 1, 1], 0, 100);
        assert_eq!((relabellings.exchangeable(), relabellings.draws()), (0, 1));
        assert_eq!(relabellings.tally(1).p(), None);
        let none = Relabellings::new(vec![0, 1], 2, &[0, 0], 0, 0);
        assert_eq!((none.draws(), none.tally(0).p()), (0, None));
    }
}
