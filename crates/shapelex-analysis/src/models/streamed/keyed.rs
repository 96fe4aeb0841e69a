//! Exchanges of the residuals of a stream: keyed bijections of the shapes of each stratum, of which nothing is stored.
//!
//! ```text
//! x = l 2^h + r,   l < a,  r < 2^h,  a = ⌈n/2^h⌉        a Feistel network on pairs (l, r), walked until x < n
//! l ← l + ⌊a F_i(r)/2^64⌋ mod a,   r ← r + G_i(l) mod 2^h
//! ```
//!
//! `F_i` and `G_i` mix the key of the draw and stratum, and the number of the round. A draw tells where the residual of each shape goes in
//! constant time and in any order of the shapes, so that a pass over them sums many draws at once. Networks of few rounds are far from
//! all permutations of a small set: the fewer the shapes of a stratum, the more rounds.
//!
//! Sources: Luby and Rackoff 1988; Black and Rogaway 2002 (walks along cycles).

use rand::RngExt;

use crate::random::stream;

/// Pairs of rounds for strata of at least so many shapes.
const ROUNDS: [(u32, u64); 3] = [(3, 1 << 14), (6, 1 << 8), (16, 0)];

/// Odd number near 2⁶⁴ over the golden ratio: keys of rounds and strata.
const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

/// Exchanges of shapes within strata, one for each draw.
#[derive(Debug, Clone)]
pub struct KeyedExchange {
    keys: Vec<u64>,
    strata: Vec<Stratum>,
    /// Stratum and place in it of each shape, and the shapes of the strata one after the other; empty for one stratum of all.
    places: Vec<[u32; 2]>,
    members: Vec<u32>,
}

/// Shapes that may change places.
#[derive(Debug, Clone, Copy)]
struct Stratum {
    first: usize,
    size: u64,
    /// `h` and `a`.
    low_bits: u32,
    high: u64,
    rounds: u32,
}

impl KeyedExchange {
    /// `draws` exchanges of `shapes` shapes with this seed, within `strata` if there are some. Cost: a few numbers for each shape.
    pub fn new(shapes: usize, strata: Option<&[u32]>, seed: u64, draws: usize) -> Self {
        let keys = (0..draws).map(|draw| stream(seed, draw).random()).collect();
        let Some(labels) = strata else {
            let strata = vec![Stratum::new(0, shapes)];
            return Self { keys, strata, places: Vec::new(), members: Vec::new() };
        };
        let mut sizes = vec![0_usize; labels.iter().max().map_or(0, |last| *last as usize + 1)];
        labels.iter().for_each(|&label| sizes[label as usize] += 1);
        let mut strata = Vec::with_capacity(sizes.len());
        let mut first = 0;
        for size in &sizes {
            strata.push(Stratum::new(first, *size));
            first += size;
        }
        let (mut members, mut filled) = (vec![0; labels.len()], vec![0_u32; sizes.len()]);
        let place = |(k, &label): (usize, &u32)| {
            let place = filled[label as usize];
            filled[label as usize] += 1;
            members[strata[label as usize].first + place as usize] = k as u32;
            [label, place]
        };
        let places = labels.iter().enumerate().map(place).collect();
        Self { keys, strata, places, members }
    }

    /// Number of exchanges.
    pub fn draws(&self) -> usize {
        self.keys.len()
    }

    /// The shape that takes the residual of shape `k` in a draw.
    pub fn target(&self, draw: usize, k: usize) -> usize {
        let key = self.keys[draw];
        let Some(&[label, place]) = self.places.get(k) else {
            return self.strata[0].image(key, k as u64) as usize;
        };
        let stratum = &self.strata[label as usize];
        let key = key ^ u64::from(label).wrapping_mul(GOLDEN);
        self.members[stratum.first + stratum.image(key, u64::from(place)) as usize] as usize
    }

    /// A draw as the list of the shapes whose residual each shape takes.
    pub fn list(&self, draw: usize, shapes: usize) -> Vec<usize> {
        let mut list = vec![0; shapes];
        (0..shapes).for_each(|k| list[self.target(draw, k)] = k);
        list
    }
}

impl Stratum {
    fn new(first: usize, size: usize) -> Self {
        let size = size as u64;
        let low_bits = (u64::BITS - size.saturating_sub(1).leading_zeros()) / 2;
        let high = size.div_ceil(1 << low_bits).max(1);
        let rounds = ROUNDS.iter().find(|(_, least)| size >= *least).map_or(16, |(rounds, _)| *rounds);
        Self { first, size, low_bits, high, rounds }
    }

    /// Place of the shape that takes the residual of the shape at place `x`.
    fn image(&self, key: u64, x: u64) -> u64 {
        let mut image = self.step(key, x);
        // Places lie on a cycle of the network, so a walk comes back to one of them.
        while image >= self.size {
            image = self.step(key, image);
        }
        image
    }

    fn step(&self, key: u64, x: u64) -> u64 {
        let mask = (1 << self.low_bits) - 1;
        let (mut high, mut low) = (x >> self.low_bits, x & mask);
        let mut round_key = key;
        for _ in 0..self.rounds {
            round_key = round_key.wrapping_add(GOLDEN);
            high += scaled(mixed(round_key ^ low), self.high);
            high -= if high >= self.high { self.high } else { 0 };
            round_key = round_key.wrapping_add(GOLDEN);
            low = (low + (mixed(round_key ^ high) >> 32)) & mask;
        }
        high << self.low_bits | low
    }
}

/// `⌊below z/2⁶⁴⌋`, of the leading 32 bits of `z`.
fn scaled(z: u64, below: u64) -> u64 {
    ((z >> 32) * below) >> 32
}

/// The finaliser of SplitMix64, a bijection that mixes all bits.
fn mixed(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn draws_are_permutations_within_strata() {
        for shapes in [1, 2, 3, 5, 17, 64, 65, 1000, 40_000] {
            let strata: Vec<u32> = (0..shapes).map(|k| (k * k % 7 % 3) as u32).collect();
            for strata in [None, Some(strata.as_slice())] {
                let exchange = KeyedExchange::new(shapes, strata, 5, 3);
                for draw in 0..exchange.draws() {
                    let mut list = exchange.list(draw, shapes);
                    if let Some(strata) = strata {
                        assert!(list.iter().enumerate().all(|(k, &from)| strata[k] == strata[from]));
                    }
                    list.sort_unstable();
                    assert!(list.into_iter().eq(0..shapes), "{shapes} shapes");
                }
            }
        }
    }

    /// All permutations of few shapes are equally likely: χ² of their numbers within 4.5 standard deviations of its mean.
    #[test]
    fn all_permutations_of_few_shapes_are_equally_likely() {
        const DRAWS: usize = 24_000;
        for shapes in 2..=5 {
            let exchange = KeyedExchange::new(shapes, None, 11, DRAWS);
            let mut counts = BTreeMap::new();
            (0..DRAWS).for_each(|draw| *counts.entry(exchange.list(draw, shapes)).or_insert(0.0) += 1.0);
            let all = (1..=shapes).product::<usize>();
            let expected = DRAWS as f64 / all as f64;
            let excess =
                counts.values().map(|count: &f64| (count - expected).powi(2) / expected).sum::<f64>();
            let degrees = (all - 1) as f64;
            assert_eq!(counts.len(), all);
            assert!((excess - degrees).abs() < 4.5 * (2.0 * degrees).sqrt(), "{shapes}: χ² {excess}");
        }
    }

    /// Where a shape goes, and where its neighbour goes beside it, are uniform for strata of every number of rounds.
    #[test]
    fn shapes_and_their_neighbours_go_anywhere() {
        const DRAWS: usize = 20_000;
        const BINS: usize = 16;
        for shapes in [60, 700, 30_000] {
            let exchange = KeyedExchange::new(shapes, None, 3, DRAWS);
            let bin = |place: usize| place * BINS / shapes;
            for k in [0, shapes / 2, shapes - 2] {
                let mut counts = [[0.0; BINS]; 2];
                for draw in 0..DRAWS {
                    let [own, next] = [k, k + 1].map(|k| exchange.target(draw, k));
                    counts[0][bin(own)] += 1.0;
                    counts[1][bin((next + shapes - own) % shapes)] += 1.0;
                }
                // Two shapes never go to one place.
                for (counts, least) in counts.iter().zip([0, 1]) {
                    let size = |b: usize| (least..shapes).filter(|&place| bin(place) == b).count() as f64;
                    let of = |b: usize| {
                        let expected = DRAWS as f64 * size(b) / (shapes - least) as f64;
                        (counts[b] - expected).powi(2) / expected
                    };
                    let excess: f64 = (0..BINS).map(of).sum();
                    assert!(excess < 15.0 + 4.5 * 30.0_f64.sqrt(), "{shapes} shapes, shape {k}: χ² {excess}");
                }
            }
        }
    }
}
