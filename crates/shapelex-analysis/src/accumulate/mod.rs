//! Sums over many shapes that stream, split and merge.
//!
//! A set of shapes is summed in units, from a block ([`BLOCK`] shapes) for small sums to a part ([`PART`] shapes) for large
//! ones. The units of a part merge in order, the parts in groups of [`FAN_IN`], the groups likewise until one sum is left. The
//! result therefore has the same bits for any number of threads, any division of the shapes into batches, and any process that
//! computed the sum of a part or of a group.
//!
//! * [`ShapeSource`] — a set of shapes: in memory, stored, or changed on the way;
//! * [`Mark`] — a digest of a shape as given: samples of a set depend on the marks alone, not on its order;
//! * [`Accumulator`] — a sum over them, made by [`accumulate`]; [`map_shapes`] gives a value for each shape;
//! * [`OuterProductSum`], [`ScatterSum`] — sums of outer products with their leading eigenpairs.

mod mark;
mod scatter;
mod source;
mod sum;

pub use self::mark::{Mark, ranked};
pub use self::scatter::{OuterProductSum, ScatterSum};
pub use self::source::{
    BLOCK, KEPT_BYTES, MergePart, PART, Reservation, Reserved, ShapeSource, Shapes, ShapesInMemory,
    VisitMarked, Watched, map_shapes, prepare, smallest_eligible, subset,
};
pub use self::sum::{Accumulator, FAN_IN, accumulate};

pub(crate) use self::scatter::{MATRIX_FREE, for_each_group, unit};
pub(crate) use self::source::{Leading, for_each_changed, map_blocks};
pub(crate) use self::sum::{PartTree, accumulate_spread, merge_serialised, read_numbers, write_numbers};
