//! Connections: settings, checks at start, schema.

use std::path::Path;
use std::time::Duration;

use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, SqlSafeStr, SqlitePool};

use super::StoreError;

/// The first version whose write-ahead log does not lose pages with several connections.
const OLDEST_SQLITE: [u32; 3] = [3, 51, 3];
/// Result codes SQLITE_CORRUPT and SQLITE_NOTADB.
const DAMAGE_CODES: [i32; 2] = [11, 26];
/// How long a connection waits for another one's lock.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Connections that read: more only compete for the cores.
const READERS: u32 = 4;
/// The steps of the schema. Listed by hand: the macro that reads a folder would bring in the compile-time half of sqlx.
const MIGRATIONS: [(i64, &str, &str); 4] = [
    (1, "cohorts and shapes", include_str!("migrations/sqlite/0001_cohorts_and_shapes.sql")),
    (2, "jobs", include_str!("migrations/sqlite/0002_jobs.sql")),
    (3, "dictionaries", include_str!("migrations/sqlite/0003_dictionaries.sql")),
    (4, "job output", include_str!("migrations/sqlite/0004_job_output.sql")),
];

fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .journal_mode(SqliteJournalMode::Wal)
        // What was acknowledged survives a power cut.
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
        // 16 MiB per connection, for the indexes; chunks are read once and gain nothing.
        .pragma("cache_size", "-16384")
        // A chunk is a megabyte: at the default of 4 MiB every few would be written twice at once.
        .pragma("wal_autocheckpoint", "8192")
        .pragma("journal_size_limit", "67108864")
        // Statements that insert thousands of rows are pages long.
        .disable_statement_logging()
}

/// The one connection that writes: its pool is a fair queue.
pub(super) async fn writer(file: &Path) -> Result<SqlitePool, StoreError> {
    let pool = SqlitePoolOptions::new()
        .max_connections(1)
        .min_connections(1)
        .idle_timeout(None)
        .max_lifetime(None)
        // On a full disk SQLite ends the transaction by itself; sqlx then believes for ever to be
        // inside one. Such a connection is replaced.
        .before_acquire(|connection, _| Box::pin(async { Ok(!connection.is_in_transaction()) }))
        .connect_with(options(file).create_if_missing(true))
        .await?;
    Ok(pool)
}

/// Connections that only read.
pub(super) async fn reader(file: &Path) -> Result<SqlitePool, StoreError> {
    let pool =
        SqlitePoolOptions::new().max_connections(READERS).connect_with(options(file).read_only(true)).await?;
    Ok(pool)
}

/// Refuses a library with the known fault.
pub(super) async fn check_version(pool: &SqlitePool) -> Result<(), StoreError> {
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
pub(super) async fn check_file(pool: &SqlitePool) -> Result<(), StoreError> {
    let detail: String = sqlx::query_scalar("PRAGMA quick_check(1)").fetch_one(pool).await?;
    if detail == "ok" {
        return Ok(());
    }
    Err(StoreError::Damaged { detail })
}

/// Brings the schema up to date.
pub(super) async fn migrate(pool: &SqlitePool) -> Result<(), StoreError> {
    let migrations = MIGRATIONS.map(|(version, name, text)| {
        Migration::new(version, name.into(), MigrationType::Simple, text.into_sql_str(), false)
    });
    Migrator::with_migrations(migrations.into()).run(pool).await.map_err(StoreError::Schema)
}

/// Whether the error says that the file is damaged or no database.
pub(super) fn is_damage(error: &sqlx::Error) -> bool {
    let Some(code) = error.as_database_error().and_then(|e| e.code()) else {
        return false;
    };
    // The low byte of an extended code is the plain one.
    code.parse::<i32>().is_ok_and(|code| DAMAGE_CODES.contains(&(code & 0xff)))
}

/// Whether the error is a broken unique constraint on the column, such as `cohort.name`.
pub(super) fn is_duplicate(error: &sqlx::Error, column: &str) -> bool {
    error.as_database_error().is_some_and(|e| e.is_unique_violation() && e.message().contains(column))
}

/// Whether the error is a reference to a row that does not exist.
pub(super) fn is_missing_reference(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(|e| e.is_foreign_key_violation())
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
