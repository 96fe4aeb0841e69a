//! A cohort as a table.
//!
//! * [`table`] — rows and columns; [`summary`] — attributes summed up; [`scatter`] — two columns as a picture;
//! * `columns` — attributes kept in memory; `derived` — results of dictionaries for the shapes.

pub(crate) mod columns;
pub(crate) mod derived;
pub mod scatter;
pub mod summary;
pub mod table;
