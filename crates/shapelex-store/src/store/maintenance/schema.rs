//! Schema versions and migration.

use super::super::answer::Answer;
use super::super::engine::{Pools, sql};
use super::super::error::StoreError;
use super::super::folder::DATABASE_FILE;
use super::super::folder::{FolderLock, protect};
use super::super::{mark, postgres, sqlite};
use super::{CONNECTIONS, MaintenanceError, Site, existing};

/// Schema versions of a store and of this program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Versions {
    /// Version of the store; 0 for an empty database.
    pub found: i64,
    /// Version of this program.
    pub known: i64,
}

impl Versions {
    async fn of(pools: &Pools) -> Result<Self, MaintenanceError> {
        let known = match pools {
            Pools::Sqlite { .. } => sqlite::latest(),
            Pools::Postgres(_) => postgres::latest(),
        };
        let found = version(pools).await?;
        if found > known {
            return Err(StoreError::Newer { found, known }.into());
        }
        Ok(Self { found, known })
    }
}

/// Versions of the store at `site`, which is not changed.
///
/// # Errors
/// [`MaintenanceError::NoStore`], [`StoreError::Newer`].
pub fn versions<'a>(site: &'a Site) -> Answer<'a, Versions, MaintenanceError> {
    Box::pin(async move {
        let pools = existing(site).await?;
        let versions = Versions::of(&pools).await;
        pools.close().await;
        versions
    })
}

/// Upgrades the schema of the store at `site`; returns the versions before. An embedded store must not be in use, and is
/// created if missing.
///
/// # Errors
/// [`StoreError::Newer`]; [`StoreError::Locked`], [`StoreError::Damaged`], [`StoreError::Schema`].
pub fn migrate<'a>(site: &'a Site) -> Answer<'a, Versions, MaintenanceError> {
    Box::pin(async move {
        let (pools, lock) = match site {
            Site::Folder(folder) => {
                let lock = FolderLock::take(folder)?;
                mark::require(folder).await?;
                protect(folder)?;
                (sqlite::connect(&folder.join(DATABASE_FILE), true).await?, Some(lock))
            }
            Site::Url(url) => {
                (Pools::Postgres(postgres::pool(postgres::options(url)?, CONNECTIONS).await?), None)
            }
        };
        let versions = Versions::of(&pools).await?;
        match &pools {
            Pools::Sqlite { writer, .. } => sqlite::migrate(writer).await?,
            Pools::Postgres(pool) => postgres::migrate(pool).await?,
        }
        pools.close().await;
        drop(lock);
        Ok(versions)
    })
}

/// Refuses a schema other than this program's.
pub(super) async fn require_present(pools: &Pools) -> Result<i64, MaintenanceError> {
    let Versions { found, known } = Versions::of(pools).await?;
    if found < known {
        return Err(MaintenanceError::Older { found, known });
    }
    Ok(known)
}

/// Last migration applied.
async fn version(pools: &Pools) -> Result<i64, StoreError> {
    const IN_SQLITE: &str = "SELECT count(*) FROM sqlite_master WHERE name = '_sqlx_migrations'";
    const IN_POSTGRES: &str = "SELECT count(*) FROM pg_tables
        WHERE schemaname = current_schema() AND tablename = '_sqlx_migrations'";
    const LAST: &str = "SELECT CAST(coalesce(max(version), 0) AS BIGINT) FROM _sqlx_migrations WHERE success";
    let has_table = match pools {
        Pools::Sqlite { .. } => IN_SQLITE,
        Pools::Postgres(_) => IN_POSTGRES,
    };
    if sql(pools.reader(), has_table).scalar::<i64>().await? == 0 {
        return Ok(0);
    }
    Ok(sql(pools.reader(), LAST).scalar().await?)
}
