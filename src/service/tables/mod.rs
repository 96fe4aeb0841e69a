//! A cohort as a table.
//!
//! * [`table`] — rows and columns; [`summary`] — attributes summed up;
//! * `columns` — attributes kept in memory; `derived` — what dictionaries say of the shapes.

pub(crate) mod columns;
pub(crate) mod derived;
pub mod summary;
pub mod table;
