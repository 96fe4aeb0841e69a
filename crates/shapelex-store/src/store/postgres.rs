//! PostgreSQL: connections and schema. Any number of replicas may share a database.

use std::str::FromStr;
use std::time::Duration;

use sqlx::postgres::{PgConnectOptions, PgPoolOptions};
use sqlx::{ConnectOptions, PgPool};

use super::error::StoreError;
use super::sqlite::{NEWEST, migrator};

/// How long a request waits for a connection.
const PATIENCE: Duration = Duration::from_secs(10);
/// Schema migrations, numbered as those of the embedded database.
const MIGRATIONS: &[(i64, &str, &str)] = &[
    (5, "schema", include_str!("migrations/postgres/0005_schema.sql")),
    (6, "retries and changes", include_str!("migrations/postgres/0006_retries_and_changes.sql")),
    (7, "audit", include_str!("migrations/postgres/0007_audit.sql")),
    (8, "keys", include_str!("migrations/postgres/0008_keys.sql")),
    (10, "passes", include_str!("migrations/postgres/0010_passes.sql")),
    (11, "measures and corrections", include_str!("migrations/postgres/0011_measures_and_corrections.sql")),
    (12, "aliases and output parts", include_str!("migrations/postgres/0012_aliases_and_output_parts.sql")),
    (13, "hooks", include_str!("migrations/postgres/0013_hooks.sql")),
    (14, "assessments", include_str!("migrations/postgres/0014_assessments.sql")),
    (15, "job files", include_str!("migrations/postgres/0015_job_files.sql")),
    (16, "directions and fits", include_str!("migrations/postgres/0016_directions_and_fits.sql")),
    (17, "former rules", include_str!("migrations/postgres/0017_former_rules.sql")),
    (18, "subject secrets", include_str!("migrations/postgres/0018_subject_secrets.sql")),
    (20, "erasures", include_str!("migrations/postgres/0020_erasures.sql")),
    (21, "no passes", include_str!("migrations/postgres/0021_no_passes.sql")),
];

/// Schemes of addresses of PostgreSQL; the driver takes any.
const SCHEMES: [&str; 2] = ["postgres", "postgresql"];

/// Connection options for the database at `url`.
pub(super) fn options(url: &str) -> Result<PgConnectOptions, StoreError> {
    // The rest of the address may hold a password.
    let scheme = url.split_once("://").map(|(scheme, _)| scheme);
    if !scheme.is_some_and(|scheme| SCHEMES.contains(&scheme)) {
        let is_word = |scheme: &&str| scheme.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'+');
        let found =
            scheme.filter(is_word).map_or_else(|| "another text".into(), |scheme| format!("{scheme}://"));
        let detail = format!("expected one that begins with postgres:// or postgresql://, got {found}");
        return Err(StoreError::Url { detail });
    }
    PgConnectOptions::from_str(url)
        .map(|options| options.application_name("shapelex").disable_statement_logging())
        .map_err(|error| StoreError::Url { detail: error.to_string() })
}

/// Connects and upgrades the schema; processes that start together wait for each other.
pub(super) async fn connect(options: PgConnectOptions, connections: u32) -> Result<PgPool, StoreError> {
    let pool = pool(options, connections).await?;
    migrate(&pool).await?;
    Ok(pool)
}

/// Connects to the database as it is.
pub(super) async fn pool(options: PgConnectOptions, connections: u32) -> Result<PgPool, StoreError> {
    let pool = PgPoolOptions::new().max_connections(connections).acquire_timeout(PATIENCE);
    Ok(pool.connect_with(options).await?)
}

/// Schema version that this program needs.
pub(super) fn latest() -> i64 {
    MIGRATIONS.last().map_or(0, |(version, _, _)| *version)
}

/// Upgrades the schema.
pub(super) async fn migrate(pool: &PgPool) -> Result<(), StoreError> {
    let Err(error) = migrator(MIGRATIONS).run(pool).await else { return Ok(()) };
    let found = sqlx::query_scalar(NEWEST).fetch_one(pool).await.unwrap_or_default();
    Err(StoreError::schema(error, found, latest()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_addresses_of_postgresql_are_taken() {
        for good in ["postgres://a@b/c", "postgresql:///c?host=/run/postgresql"] {
            assert!(options(good).is_ok(), "{good}");
        }
        for (wrong, found) in [
            ("mysql://a:secret@b/c", "got mysql://"),
            ("sqlite:///tmp/a.db", "got sqlite://"),
            ("Postgres//a:secret@b", "got another text"),
            ("a:secret@postgres://b", "got another text"),
            ("", "got another text"),
        ] {
            let refused = options(wrong).unwrap_err().to_string();
            assert!(refused.ends_with(found) && !refused.contains("secret"), "{wrong}: {refused}");
        }
    }
}
