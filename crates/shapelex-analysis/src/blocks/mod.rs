//! Blocks: how sets of numbers of the same subjects vary together, and whether parts of a shape vary on their own.
//!
//! * [`pls`] — two-block partial least squares and RV of blocks: shapes, parts of shapes, numbers;
//! * [`modularity`] — covariance ratio of the parts of a shape;
//! * [`parts`] — control points of a part, and its own alignment;
//! * [`records`] — results; [`error`] — reasons why there is none.
//!
//! Sources: Rohlf and Corti 2000 (partial least squares); Escoufier 1973 (RV); Adams 2016 (covariance ratio); Adams and Collyer 2016, 2019
//! (effect sizes of both).

pub mod error;
pub mod modularity;
pub mod parts;
pub mod pls;
pub mod records;
