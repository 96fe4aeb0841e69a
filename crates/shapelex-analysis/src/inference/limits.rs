//! Limits of the studies: beyond them results lose their precision or their meaning.

/// Maximum ratio of the weights of one study: beyond it a single shape dominates, and precision is lost.
pub const MAX_WEIGHT_RATIO: f64 = 1e9;

/// Minimum number of shapes of a group: a single shape has no scatter.
pub const MIN_MEMBERS: usize = 2;

/// Maximum number of values of a categorical covariate.
pub const MAX_LEVELS: usize = 50;

/// Maximum absolute value of a variable: its square, and the inverse of that, stay finite.
pub const MAX_VALUE: f64 = 1e100;

/// Minimum standard deviation of the attribute: the change per unit stays finite.
pub const MIN_DEVIATION: f64 = 1e-100;
