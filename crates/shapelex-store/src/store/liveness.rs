//! Liveness of replicas: each holds a lock that ends with its process.
//!
//! On SQLite this is the folder's lock. On PostgreSQL a dedicated connection holds an advisory lock on the replica's id, which
//! the database frees as soon as the connection ends. A replica that can take the lock of another knows that it has died: it
//! removes the remains of its uploads, releases its parts of jobs, and requeues its jobs. A replica that is only cut off from
//! the database for a moment may be considered dead. Its uploads then fail at commit and its claims no longer hold, but no
//! partial state becomes visible.

use std::sync::{Arc, Weak};
use std::time::Duration;

use sqlx::postgres::PgConnectOptions;
use sqlx::{ConnectOptions, Connection, PgConnection};

use super::engine::{Pools, sql};
use super::error::StoreError;
use super::handle::{Inner, PURGE_UPLOAD, Store, begin_task};
use super::replica::SEPARATOR;

/// Interval at which the connection is tested and the remains of dead replicas are looked for.
const PULSE: Duration = Duration::from_secs(5);
/// Pause before the lock is taken again.
const PAUSE: Duration = Duration::from_millis(200);
impl Store {
    /// Signals that this replica is alive, until the store is closed or dropped, and cleans up after dead replicas.
    ///
    /// # Errors
    /// Database errors.
    pub(super) async fn live(&self, options: PgConnectOptions) -> Result<(), StoreError> {
        let (inner, id) = (Arc::downgrade(&self.inner), self.inner.replica.0.clone());
        let mut held = lock(&options, &id).await?;
        begin_task(Box::pin(async move {
            while let Err(error) = watch(&inner, &mut held).await {
                tracing::warn!(%error, "the liveness connection of this process has ended");
                held = loop {
                    tokio::time::sleep(PAUSE).await;
                    if !alive(&inner) {
                        return;
                    }
                    if let Ok(held) = lock(&options, &id).await {
                        break held;
                    }
                };
            }
        }));
        Ok(())
    }

    /// Removes pending rows of unfinished uploads of dead replicas, releases their parts and hooks, and requeues their jobs.
    ///
    /// # Errors
    /// Database errors.
    pub(super) async fn tidy_behind_the_dead(&self) -> Result<(), StoreError> {
        const OWNED: &str = "SELECT DISTINCT upload AS id, 0 AS kind FROM chunk WHERE revision IS NULL
            UNION ALL SELECT lease_owner, 1 FROM job WHERE status = 'running' AND lease_owner IS NOT NULL
            UNION ALL SELECT lease_owner, 2 FROM hook WHERE lease_owner IS NOT NULL";
        if !matches!(self.inner.pools, Pools::Postgres(_)) {
            return Ok(());
        }
        for row in sql(self.reader(), OWNED).all().await? {
            let id: &str = row.get("id")?;
            if self.is_owner_alive(id).await? {
                continue;
            }
            match row.get::<i32>("kind")? {
                1 => self.requeue_job_of(id).await?,
                2 => self.release_hook_of(id).await?,
                _ => self.purge(PURGE_UPLOAD, Some(id)).await?,
            }
        }
        Ok(())
    }

    /// Whether the replica that created this identifier is alive.
    async fn is_owner_alive(&self, id: &str) -> Result<bool, StoreError> {
        const IS_DEAD: &str = "SELECT pg_try_advisory_xact_lock(hashtextextended($1, 0))";
        let replica = id.split(SEPARATOR).next().unwrap_or_default();
        // A single statement is its own transaction: the lock ends with it.
        Ok(replica == self.inner.replica.0
            || !sql(self.writer(), IS_DEAD).bind(replica).scalar::<bool>().await?)
    }
}

fn alive(inner: &Weak<Inner>) -> bool {
    inner.upgrade().is_some_and(|inner| !inner.pools.is_closed())
}

/// Opens a connection that holds the lock of the replica `id`.
async fn lock(options: &PgConnectOptions, id: &str) -> Result<PgConnection, sqlx::Error> {
    const LOCK: &str = "SELECT pg_advisory_lock(hashtextextended($1, 0))";
    let mut connection: PgConnection = options.connect().await?;
    sqlx::query(LOCK).bind(id).execute(&mut connection).await?;
    Ok(connection)
}

/// Tests the connection repeatedly, until it fails (an error) or the store is closed.
async fn watch(inner: &Weak<Inner>, held: &mut PgConnection) -> Result<(), sqlx::Error> {
    loop {
        let Some(inner) = inner.upgrade().filter(|inner| !inner.pools.is_closed()) else {
            return Ok(());
        };
        let store = Store::around(inner);
        if let Err(error) = store.tidy_behind_the_dead().await {
            tracing::warn!(%error, "leftovers of dead processes could not be removed");
        }
        drop(store);
        held.ping().await?;
        tokio::time::sleep(PULSE).await;
    }
}
