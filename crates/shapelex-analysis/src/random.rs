//! Random draws: a stream for each, and shuffles.

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};

/// The random stream of draw `index`.
pub(crate) fn stream(seed: u64, index: usize) -> ChaCha12Rng {
    let mut random = ChaCha12Rng::seed_from_u64(seed);
    random.set_stream(index as u64);
    random
}

/// Shuffles the values at the positions `members`; all orders are equally likely.
pub(crate) fn shuffle(random: &mut ChaCha12Rng, members: &[usize], values: &mut [usize]) {
    for i in (1..members.len()).rev() {
        values.swap(members[i], members[random.random_range(0..=i)]);
    }
}
