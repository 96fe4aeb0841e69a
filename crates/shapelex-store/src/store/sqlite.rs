//! SQLite: connection settings, checks at start, schema.

use std::path::Path;
use std::time::Duration;

use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqliteLockingMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, SqlSafeStr, SqlitePool};

use super::engine::Pools;
use super::error::StoreError;

/// First version whose write-ahead log does not lose pages with several connections.
const OLDEST_SQLITE: [u32; 3] = [3, 51, 3];
/// Checks the whole file except the order of indexes.
pub(super) const QUICK_CHECK: &str = "PRAGMA quick_check(1)";
/// Result of the check for a sound file.
pub(super) const SOUND: &str = "ok";
/// Largest file, in bytes, that is checked before anything else: the check takes a tenth of a second.
const SMALL_BYTES: u64 = 64 << 20;
/// How long a connection waits for a lock.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of reading connections: more would only compete for the cores.
const READERS: u32 = 4;
/// Schema migrations. Listed by hand: the macro that reads a folder would pull in the compile-time half of sqlx.
const MIGRATIONS: &[(i64, &str, &str)] = &[
    (1, "cohorts and shapes", include_str!("migrations/sqlite/0001_cohorts_and_shapes.sql")),
    (2, "jobs", include_str!("migrations/sqlite/0002_jobs.sql")),
    (3, "dictionaries", include_str!("migrations/sqlite/0003_dictionaries.sql")),
    (4, "job output", include_str!("migrations/sqlite/0004_job_output.sql")),
    (5, "tenants", include_str!("migrations/sqlite/0005_tenants.sql")),
    (6, "retries and changes", include_str!("migrations/sqlite/0006_retries_and_changes.sql")),
    (7, "audit", include_str!("migrations/sqlite/0007_audit.sql")),
    (8, "keys", include_str!("migrations/sqlite/0008_keys.sql")),
    (10, "passes", include_str!("migrations/sqlite/0010_passes.sql")),
    (11, "measures and corrections", include_str!("migrations/sqlite/0011_measures_and_corrections.sql")),
    (12, "aliases and output parts", include_str!("migrations/sqlite/0012_aliases_and_output_parts.sql")),
    (13, "hooks", include_str!("migrations/sqlite/0013_hooks.sql")),
    (14, "assessments", include_str!("migrations/sqlite/0014_assessments.sql")),
    (15, "job files", include_str!("migrations/sqlite/0015_job_files.sql")),
    (16, "directions and fits", include_str!("migrations/sqlite/0016_directions_and_fits.sql")),
    (17, "former rules", include_str!("migrations/sqlite/0017_former_rules.sql")),
    (18, "subject secrets", include_str!("migrations/sqlite/0018_subject_secrets.sql")),
    (20, "erasures", include_str!("migrations/sqlite/0020_erasures.sql")),
    (21, "no passes", include_str!("migrations/sqlite/0021_no_passes.sql")),
];

fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .journal_mode(SqliteJournalMode::Wal)
        // Acknowledged writes survive a power cut.
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
        // 16 MiB per connection, for the indexes; chunks are read once and gain nothing.
        .pragma("cache_size", "-16384")
        // A chunk is a megabyte: with the default of 4 MiB, every few chunks would be written twice at once.
        .pragma("wal_autocheckpoint", "8192")
        .pragma("journal_size_limit", "67108864")
        // Removed rows are overwritten: the file keeps nothing of an erased shape.
        .pragma("secure_delete", "ON")
        // Statements that insert thousands of rows are several pages long.
        .disable_statement_logging()
}

/// Whether the file is absent, or small enough to be checked at once.
pub(super) fn is_small(file: &Path) -> bool {
    std::fs::metadata(file).is_ok_and(|about| about.len() <= SMALL_BYTES) || !file.exists()
}

/// Opens the connections of the database in `file` as it is; may `create` a new one.
pub(super) async fn connect(file: &Path, create: bool) -> Result<Pools, StoreError> {
    let writer = writer(options(file).create_if_missing(create)).await?;
    check_version(&writer).await?;
    let reader = reader(file).await?;
    Ok(Pools::Sqlite { writer, reader })
}

/// Opens a connection that leaves the database in `file` and its write-ahead log unchanged. If it is `whole`, the file is complete without
/// a log, and nothing is written beside it.
pub(super) async fn look(file: &Path, whole: bool) -> Result<SqlitePool, StoreError> {
    // Does not use `options`: requesting a journal mode writes to a file that has another one, as a backup does.
    let options = SqliteConnectOptions::new().filename(file).read_only(true).immutable(whole);
    let options = options.busy_timeout(BUSY_TIMEOUT);
    let pool = SqlitePoolOptions::new().max_connections(1);
    Ok(pool.connect_with(options.disable_statement_logging()).await?)
}

/// Migrates the database in `file` and opens its connections without checking the whole file.
pub(super) async fn attach(file: &Path) -> Result<Pools, StoreError> {
    let writer = writer(options(file).create_if_missing(true)).await?;
    check_version(&writer).await?;
    upgrade(&writer).await?;
    let reader = reader(file).await?;
    Ok(Pools::Sqlite { writer, reader })
}

/// Migrates a schema to an old version.
#[cfg(test)]
pub(super) async fn migrate_to(writer: &SqlitePool, version: i64) -> Result<(), StoreError> {
    migrator(MIGRATIONS).run_to(version, writer).await.map_err(StoreError::Schema)
}

/// Schema version that this program needs.
pub(super) fn latest() -> i64 {
    MIGRATIONS.last().map_or(0, |(version, _, _)| *version)
}

/// Checks the file and upgrades its schema.
pub(super) async fn migrate(writer: &SqlitePool) -> Result<(), StoreError> {
    check_file(writer).await?;
    upgrade(writer).await
}

/// Brings the schema up to date.
async fn upgrade(writer: &SqlitePool) -> Result<(), StoreError> {
    let Err(error) = migrator(MIGRATIONS).run(writer).await else { return Ok(()) };
    let found = sqlx::query_scalar(NEWEST).fetch_one(writer).await.unwrap_or_default();
    Err(StoreError::schema(error, found, latest()))
}

/// Migrates the database in `file`, after a check if requested, and opens its connections.
///
/// Connections share an index of the write-ahead log in a file beside it. Where the disk has no room for that, a single connection, which
/// keeps the index in memory, reads and writes.
pub(super) async fn open(file: &Path, check: bool) -> Result<Pools, StoreError> {
    let shared = options(file).create_if_missing(true);
    let alone = options(file).locking_mode(SqliteLockingMode::Exclusive);
    match migrated(shared, check).await {
        Ok(writer) => Ok(Pools::Sqlite { reader: reader(file).await?, writer }),
        Err(StoreError::Full) if std::fs::metadata(file).is_ok_and(|about| about.len() > 0) => {
            tracing::warn!(
                "the disk of the store has no room for the index of its log: one connection reads and writes, and no other process can \
                 open the store, until the next start"
            );
            let writer = migrated(alone, check).await?;
            Ok(Pools::Sqlite { reader: writer.clone(), writer })
        }
        Err(error) => Err(error),
    }
}

/// The writing connection of a migrated database.
async fn migrated(options: SqliteConnectOptions, check: bool) -> Result<SqlitePool, StoreError> {
    let writer = writer(options).await?;
    check_version(&writer).await?;
    if check {
        check_file(&writer).await?;
    }
    upgrade(&writer).await?;
    Ok(writer)
}

/// The single writing connection; its pool is a fair queue.
async fn writer(options: SqliteConnectOptions) -> Result<SqlitePool, StoreError> {
    let pool = SqlitePoolOptions::new()
        .max_connections(1)
        .min_connections(1)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
        // On a full disk SQLite ends the transaction by itself, but sqlx still believes to be inside one. Such a connection is
        // replaced.
        .before_acquire(|connection, _| Box::pin(async { Ok(!connection.is_in_transaction()) }))
        .connect_with(options)
        .await?;
    Ok(pool)
}

/// Read-only connections. All are opened at once, because each has a thread that inherits the priority of its opener, which
/// later may be a job.
async fn reader(file: &Path) -> Result<SqlitePool, StoreError> {
    let pool = SqlitePoolOptions::new()
        .max_connections(READERS)
        .min_connections(READERS)
        .idle_timeout(None)
        .max_lifetime(None)
        // A local file has no network that could fail.
        .test_before_acquire(false)
        .connect_with(options(file).read_only(true))
        .await?;
    Ok(pool)
}

/// Refuses an SQLite library with the known bug.
async fn check_version(pool: &SqlitePool) -> Result<(), StoreError> {
    let version: String = sqlx::query_scalar("SELECT sqlite_version()").fetch_one(pool).await?;
    if is_recent(&version) {
        return Ok(());
    }
    Err(StoreError::TooOld { version })
}

fn is_recent(version: &str) -> bool {
    let parts: Vec<u32> = version.split('.').map_while(|p| p.parse().ok()).collect();
    parts.as_slice() >= OLDEST_SQLITE.as_slice()
}

/// Refuses a damaged file.
async fn check_file(pool: &SqlitePool) -> Result<(), StoreError> {
    let detail: String = sqlx::query_scalar(QUICK_CHECK).fetch_one(pool).await?;
    if detail == SOUND {
        return Ok(());
    }
    Err(StoreError::Damaged { detail })
}

/// Version of a schema.
pub(super) const NEWEST: &str = "SELECT max(version) FROM _sqlx_migrations";

/// Migrations of a schema, ready to run.
pub(super) fn migrator(steps: &[(i64, &'static str, &'static str)]) -> Migrator {
    let migrations = steps.iter().map(|(version, name, text)| {
        Migration::new(*version, (*name).into(), MigrationType::Simple, text.into_sql_str(), false)
    });
    Migrator::with_migrations(migrations.collect())
}

#[cfg(test)]
mod tests {
    use super::is_recent;

    #[test]
    fn versions_are_compared_as_numbers() {
        for (version, expected) in [
            ("3.51.3", true),
            ("3.52.0", true),
            ("4.0", true),
            ("3.51.2", false),
            ("3.9.9", false),
            ("", false),
        ] {
            assert_eq!(is_recent(version), expected, "{version}");
        }
    }
}
