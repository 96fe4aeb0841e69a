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
//! * [`revision`](crate::cohort::revision) — the parts of a revision, read and checked;
//! * [`subject`] — the shapes of a pass, and who runs it;
//! * [`engine`] — plans of DataFusion, their memory and their threads;
//! * [`sum`], [`fold`] — the two operators; `division` — tasks of a cluster;
//! * [`work`] — results of parts, such as sums and codes, and their merging; [`codes`] — codes as Parquet;
//! * [`learn`] — groups of shapes that are coded while atoms are learnt;
//! * [`regress`] — the passes of a regression; [`variables`] — values of its variables;
//! * [`task`] — common data of both: the revision, opened when the first part is read, and the pass.

pub mod codes;
#[cfg(feature = "cluster")]
pub mod division;
pub mod engine;
pub mod fold;
pub mod learn;
pub mod regress;
pub mod rows;
pub mod subject;
pub mod sum;
pub mod task;
pub mod variables;
pub mod work;
