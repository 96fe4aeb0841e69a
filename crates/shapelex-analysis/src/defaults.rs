//! Defaults of analyses: values for requests and programs that name none.

/// Quantile of the held-out training shapes of a dictionary beyond which a shape is an outlier, or belongs to none of the classes: of
/// shapes like those of the training, one in a hundred counts as one.
pub const OUTLIER_QUANTILE: f64 = 0.99;

/// Part of the shapes that a band about a completed shape covers.
pub const BAND_LEVEL: f64 = 0.95;

/// Neighbours of a query.
pub const NEIGHBOURS: usize = 10;

/// Components of an analysis.
pub const COMPONENTS: usize = 10;

/// Relabellings or permutations of a test: p has steps of a thousandth.
pub const PERMUTATIONS: usize = 1000;
