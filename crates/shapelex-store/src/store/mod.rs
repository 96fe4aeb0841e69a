//! Storage of cohorts, shapes, jobs and dictionaries in SQLite or PostgreSQL.
//!
//! ```text
//! cohort ─< chunk ── chunk_data     up to 4096 shapes: points (little-endian f64), weights, checksum
//!              └──< shape           attributes of each shape, and when it was deleted
//! job ── job_output ─< job_output_part the queue, the history of finished jobs, and their outputs, large ones in parts
//!  ├──< job_file                    files that a job works on, until it ends
//! dictionary ── dictionary_data     versions, each written once
//!      ├──< dictionary_alias         names for versions, which can be moved
//!      └──< assessment               result of a version for a stored shape
//! ```
//!
//! A chunk records the revision of its cohort that added it, a shape the revision that deleted it; the set at revision `r`
//! therefore never changes: `chunk.revision ≤ r and not (deleted_revision ≤ r)`.
//!
//! A [`Store`] shows the objects that one [`Principal`](crate::domain::access::Principal) may see: those of its tenant,
//! and of these the cohorts that are open to it.
//!
//! SQLite: one connection writes, in short transactions; four read; the folder belongs to one process. PostgreSQL: any
//! number of processes; only writers of the same cohort wait for each other. The SQL is the same (`engine`).
//!
//! * [`cohorts`], [`shapes`], [`dictionaries`] — finding, listing and deleting; `aliases` — names for versions; `assessments` — their results for shapes; [`upload`] — storing shapes;
//! * `rules` — correspondences of cohorts changed, and their shapes stored again;
//! * `corrections` — shapes stored again with other attributes, or deleted; `subjects` — the holdings of one; `erasure` — everything of a subject removed, `erasures` — the list of them, and the files written anew;
//! * `subject_secrets` — secrets by which identifiers of persons become subjects;
//! * `tally` — how many shapes run which way, or came as meshes;
//! * [`scan`] — reading control points in bulk; `places` — where they are, and whose they are;
//! * [`jobs`] — the queue; [`outputs`] — large results of jobs; [`files`] — inputs of jobs;
//! * [`changes`] — the change feed; [`hooks`] — where it is delivered; `trash` — deleted objects; [`receipts`] — outcomes of idempotent requests;
//! * [`audit`] — the audit trail; [`metrics`] — metric names;
//! * [`maintenance`] — checks, backups and exports of the whole store; `copies` — their marks;
//! * [`Answer`] — return types of methods; `blob` — conversion between numbers and bytes; `sqlite`, `postgres` — connections, checks, schema;
//! * `replica` — which processes are alive; `clock` — notes about the clock; `known_names` — versions that names of dictionaries mean.

mod aliases;
mod answer;
mod assessments;
mod attributes;
pub mod audit;
mod blob;
pub mod changes;
mod clock;
pub mod cohorts;
mod copies;
mod corrections;
pub mod dictionaries;
mod engine;
mod erasure;
mod erasures;
mod error;
mod failure;
pub mod files;
mod filter;
mod folder;
mod handle;
pub mod hooks;
pub mod jobs;
pub mod keys;
mod known_names;
mod liveness;
pub mod maintenance;
mod mark;
mod measure;
pub mod metrics;
mod order;
pub mod outputs;
mod places;
mod postgres;
pub mod receipts;
mod replica;
mod rules;
pub mod scan;
pub mod shapes;
mod sqlite;
mod subject_secrets;
mod subjects;
mod tally;
mod text;
mod trash;
pub mod upload;

pub use aliases::{AliasMove, AliasMoved, MAX_ALIASES};
pub use answer::{Answer, Work};
pub use assessments::{AssessmentListing, AssessmentRun, NewAssessment, StoredAssessment};
pub use attributes::{NewNames, Unmeasured, ValuesPage};
pub use audit::AuditCheck;
pub use clock::ClockNotes;
pub use corrections::Deleted;
pub use dictionaries::DictionaryFilter;
pub use erasure::{SubjectCohort, SubjectDictionary, SubjectJob};
pub use error::StoreError;
pub use filter::Revisions;
pub use handle::Store;
pub use hooks::{HookClaim, HookMeasures};
pub use jobs::{Claim, Claimed, Release};
pub use measure::Measures;
pub use order::{Cursor, CursorError, ListCursor, Order, SortKey};
pub use places::{NamedShape, Places};
pub use scan::{Ids, ScanBatch};
pub use shapes::{Listing, ShapePage};
pub use subjects::{HeldShape, Holding};
pub use tally::Tally;
pub use upload::{Added, ShapeRow, UnitOfShapes, Upload};

#[cfg(test)]
mod tests;
