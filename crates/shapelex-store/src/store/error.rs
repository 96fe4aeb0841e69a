//! Why the store refuses or fails.

use std::path::PathBuf;

use crate::domain::shape::MAX_NAMES;

/// Why the store did not do it. Its text ends in the log: never a text that a client has sent.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another cohort has the name.
    #[error("the name is already in use")]
    NameTaken {
        /// The name asked for.
        name: String,
    },
    /// The external identifier belongs to a shape with other content.
    #[error("the external id of shape {position} belongs to a shape with other content")]
    ExternalIdConflict {
        /// Position in the whole upload, from 0.
        position: u64,
        /// The identifier.
        external_id: String,
    },
    /// A shape has more or fewer numbers than the representation of its cohort.
    #[error("shape {position} has {found} numbers, expected {expected}")]
    WrongWidth {
        /// Position in the whole upload, from 0.
        position: u64,
        /// Its numbers.
        found: usize,
        /// `N·d` of the cohort.
        expected: usize,
    },
    /// The further attributes of a cohort would have too many names.
    #[error("expected at most {most} names of attributes in a cohort, got {found}", most = MAX_NAMES)]
    TooManyNames {
        /// Names with those of the shapes that were to be stored.
        found: usize,
    },
    /// The cohort was deleted.
    #[error("the cohort no longer exists")]
    CohortGone,
    /// The shape is part of an upload that is not finished; it may yet vanish.
    #[error("shape {position}: the external id {external_id:?} is part of an unfinished upload")]
    ExternalIdPending {
        /// Position in the whole upload, from 0.
        position: u64,
        /// The identifier.
        external_id: String,
    },
    /// Another process took this one for dead and removed the shapes it had stored so far.
    #[error("the upload was interrupted: send it again")]
    UploadLost,
    /// Stored control points do not have their checksum.
    #[error("stored control points are damaged (chunk {chunk}): restore a backup")]
    Corrupt {
        /// Number of the chunk.
        chunk: i64,
    },
    /// The database is not as this program wrote it.
    #[error("the database is damaged: restore a backup")]
    Damaged {
        /// The fault, for the log.
        detail: String,
    },
    /// The newest part of it is missing.
    #[error(
        "the store is older than it was: its last {missing} audit entries are missing, and with them everything \
         that was acknowledged then. The write-ahead log beside the database (shapelex.db-wal) is missing, \
         truncated or damaged, or the database was replaced. Put the log back, restore a backup, or continue \
         with what is left: `shapelex serve --accept-loss true`"
    )]
    Older {
        /// Audit entries that are missing.
        missing: u64,
    },
    /// Another process uses the data folder.
    #[error("the data folder {} is in use by another process", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// The SQLite library has a known fault.
    #[error("expected SQLite 3.51.3 or newer, got {version}")]
    TooOld {
        /// Its version.
        version: String,
    },
    /// The data folder cannot be used.
    #[error("the data folder {} cannot be used: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The schema cannot be brought up to date.
    #[error("the database schema does not fit this program")]
    Schema(#[source] sqlx::migrate::MigrateError),
    /// A newer program wrote the schema.
    #[error(
        "the schema of the store has version {found}, this program knows {known}: use the program that wrote it, or a newer one"
    )]
    Newer {
        /// Schema version of the store.
        found: i64,
        /// Schema version of this program.
        known: i64,
    },
    /// The given place of the database is not one.
    #[error("the address of the database cannot be read: {detail}")]
    Url {
        /// Why, without the address, which may hold a password.
        detail: String,
    },
    /// It is not as it was when the client looked.
    #[error("the object has changed meanwhile")]
    Changed,
    /// Aliases name the version of a dictionary.
    #[error("{} aliases name the version", aliases.len())]
    Aliased {
        /// Id of the version.
        id: String,
        /// The aliases, as `name@alias`.
        aliases: Vec<String>,
    },
    /// A request with the same key was done before.
    #[error("the request has already been carried out")]
    AlreadyDone,
    /// Changes that old are not kept any more.
    #[error("changes before number {first} are no longer available")]
    ChangesGone {
        /// The first that is.
        first: u64,
    },
    /// As many jobs wait as may.
    #[error("too many jobs are waiting: the limit is {limit}")]
    TooManyJobs {
        /// Jobs that may wait.
        limit: u32,
    },
    /// The jobs of a tenant that wait, and a new one, are predicted to take too long together.
    #[error(
        "too much work is waiting: jobs of {waiting:.0} predicted seconds, the limit with a new one is \
         {limit:.0}"
    )]
    TooMuchWork {
        /// Of those that wait.
        waiting: f64,
        /// Of all.
        limit: f64,
    },
    /// The files of the jobs of a tenant that wait or run, and those of a new one, take too much room together.
    #[error("jobs with {waiting} bytes of files are waiting, the limit with a new one is {limit}")]
    TooManyBytes {
        /// Bytes of those that wait or run.
        waiting: u64,
        /// Of all.
        limit: u64,
    },
    /// The job was cancelled or taken over meanwhile.
    #[error("the job is no longer held")]
    JobLost,
    /// No connection became free in time, or the database is away for a moment.
    #[error("the store is busy: try again")]
    Busy,
    /// The disk is full; reading goes on.
    #[error("the disk of the store is full")]
    Full,
    /// The database may only be read.
    #[error("the store is read-only at the moment")]
    ReadOnly,
    /// A text holds the character U+0000.
    #[error("expected text without the character U+0000")]
    Text,
    /// Any other failure of the database.
    #[error("the database failed")]
    Database(#[source] sqlx::Error),
}

impl StoreError {
    /// Why a schema of the version `found` cannot be brought up to date by a program that knows `known`.
    pub(super) fn schema(error: sqlx::migrate::MigrateError, found: i64, known: i64) -> Self {
        match error {
            sqlx::migrate::MigrateError::VersionMissing(_) if found > known => Self::Newer { found, known },
            error => Self::Schema(error),
        }
    }
}
