//! Passes over a revision.
//!
//! ```text
//! SumExec ─► hash by group ─► sort by part ─► FoldExec ─► hash by group ─► sort ─► FoldExec ─► … ─► one row
//! (group, part, state)                        64 rows of a group become one: part' = group, group' = ⌊part'/64⌋
//! ```
//!
//! An engine that aggregates merges sums in the order in which they arrive, and floating-point addition is not associative. So no
//! aggregate is used: every part becomes a row with its number and its serialised sum, rows of 64 parts meet in one partition, are
//! sorted, and fold into one; and again, until one row is left. The tree depends on the numbers of the parts alone, and it is the one
//! by which `shapelex-analysis` merges ([`FAN_IN`](shapelex_analysis::accumulate::FAN_IN)), so the bits are the same.
//!
//! * [`revision`] — the parts of a revision, read and checked;
//! * [`source`] — a revision as a [`ShapeSource`](shapelex_analysis::accumulate::ShapeSource), whose passes run on an [`engine`];
//! * [`engine`] — plans of DataFusion, their memory and their threads;
//! * [`sum`], [`fold`] — the two operators; [`division`] — tasks of a cluster;
//! * [`work`] — what is computed of each part: a sum, codes, the nearest shapes; [`codes`] — codes as Parquet; `graph` — graphs of near neighbours; [`search`] — the nearest shapes;
//! * [`learn`] — groups of shapes that are coded while atoms are learnt;
//! * [`regress`] — the passes of a regression; [`variables`] — values of its variables;
//! * [`task`] — what both need: the revision, opened when the first part is read, and the pass.

pub mod codes;
pub mod division;
pub mod engine;
pub mod fold;
#[cfg(feature = "approximate")]
pub(crate) mod graph;
pub mod learn;
pub mod regress;
pub mod rows;
pub mod search;
pub mod source;
pub mod sum;
pub mod task;
pub mod variables;
pub mod work;
