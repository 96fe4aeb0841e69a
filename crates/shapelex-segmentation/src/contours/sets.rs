//! Disjoint sets of numbers, each known by its least member.

/// Disjoint sets of `0..n`.
pub(super) struct Sets {
    /// For every number a smaller one of its set; itself for the least.
    parents: Vec<u32>,
}

impl Sets {
    /// Sets of one number each.
    pub(super) fn of_each(count: u32) -> Self {
        Self { parents: (0..count).collect() }
    }

    /// Number of numbers.
    pub(super) fn len(&self) -> usize {
        self.parents.len()
    }

    /// A new number in a separate set. The caller keeps the count below 2³².
    pub(super) fn begin(&mut self) -> u32 {
        let number = self.parents.len() as u32;
        self.parents.push(number);
        number
    }

    /// The least member of the set of a number. Parents are smaller, so the search ends.
    pub(super) fn least(&mut self, mut number: u32) -> u32 {
        while self.parents[number as usize] != number {
            // The path becomes half as long, so that later searches are short.
            let parent = self.parents[number as usize];
            self.parents[number as usize] = self.parents[parent as usize];
            number = self.parents[number as usize];
        }
        number
    }

    /// Makes one set of those of two numbers, and returns its least member.
    pub(super) fn join(&mut self, one: u32, other: u32) -> u32 {
        let (one, other) = (self.least(one), self.least(other));
        let least = one.min(other);
        self.parents[one.max(other) as usize] = least;
        least
    }
}
