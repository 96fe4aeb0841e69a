//! Which processes live: each holds a lock that ends with it.
//!
//! On SQLite the folder's lock says it; on PostgreSQL a connection of its own holds an advisory lock on the process's id,
//! which the database frees as soon as the connection ends. Whoever takes the lock of another process knows that it is
//! gone, removes what its uploads left behind, gives its parts of jobs to others, and puts its jobs back into the queue. A
//! process that is only cut off from the database for a moment may be taken for dead: its uploads then fail when they are
//! committed, its claims do not hold any more, and nothing half is ever seen.

use std::sync::{Arc, Weak};
use std::time::Duration;

use sqlx::postgres::PgConnectOptions;
use sqlx::{ConnectOptions, Connection, PgConnection};

use super::engine::{Pools, sql};
use super::error::StoreError;
use super::handle::{Inner, PURGE_UPLOAD, Store};
use crate::domain::id;

/// How often the connection is tried, and uploads of the dead are looked for.
const PULSE: Duration = Duration::from_secs(5);
/// Pause before the lock is taken again.
const PAUSE: Duration = Duration::from_millis(200);
/// Between the id of a process and that of what is its own.
const SEPARATOR: char = '.';

/// An identifier of a process, or of an upload.
fn new_id() -> String {
    id::unique()
}

/// The identifier of this process, as long as it lives.
#[derive(Debug)]
pub(super) struct Replica(String);

impl Replica {
    pub(super) fn new() -> Self {
        Self(new_id())
    }

    /// An identifier of something that ends with this process: an upload, a claim.
    pub(super) fn owned_id(&self) -> String {
        format!("{}{SEPARATOR}{}", self.0, new_id())
    }
}

impl Store {
    /// Says that this process lives, until the store is closed or dropped, and tidies up behind others.
    ///
    /// # Errors
    /// Those of the database.
    pub(super) async fn live(&self, options: PgConnectOptions) -> Result<(), StoreError> {
        let (inner, id) = (Arc::downgrade(&self.inner), self.inner.replica.0.clone());
        let mut held = lock(&options, &id).await?;
        tokio::spawn(async move {
            while let Err(error) = watch(&inner, &mut held).await {
                tracing::warn!(%error, "the connection that says that this process lives has ended");
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
        });
        Ok(())
    }

    /// Removes what the unfinished uploads of processes that are gone left behind, and puts their jobs back into the queue.
    ///
    /// # Errors
    /// Those of the database.
    pub(super) async fn tidy_behind_the_dead(&self) -> Result<(), StoreError> {
        const OWNED: &str = "SELECT DISTINCT upload AS id, 0 AS kind FROM chunk WHERE revision IS NULL
            UNION ALL SELECT lease_owner, 1 FROM job WHERE status = 'running' AND lease_owner IS NOT NULL
            UNION ALL SELECT lease_owner, 2 FROM task WHERE lease_owner IS NOT NULL";
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
                2 => self.release_part_of(id).await?,
                _ => self.purge(PURGE_UPLOAD, Some(id)).await?,
            }
        }
        Ok(())
    }

    /// Whether the process that gave this identifier lives.
    async fn is_owner_alive(&self, id: &str) -> Result<bool, StoreError> {
        const IS_DEAD: &str = "SELECT pg_try_advisory_xact_lock(hashtextextended($1, 0))";
        let replica = id.split(SEPARATOR).next().unwrap_or_default();
        // A single statement is a transaction of its own: the lock ends with it.
        Ok(replica == self.inner.replica.0
            || !sql(self.writer(), IS_DEAD).bind(replica).scalar::<bool>().await?)
    }
}

fn alive(inner: &Weak<Inner>) -> bool {
    inner.upgrade().is_some_and(|inner| !inner.pools.is_closed())
}

/// A connection that holds the lock of the process `id`.
async fn lock(options: &PgConnectOptions, id: &str) -> Result<PgConnection, sqlx::Error> {
    const LOCK: &str = "SELECT pg_advisory_lock(hashtextextended($1, 0))";
    let mut connection: PgConnection = options.connect().await?;
    sqlx::query(LOCK).bind(id).execute(&mut connection).await?;
    Ok(connection)
}

/// Tries the connection again and again, until it ends (an error) or the store is gone.
async fn watch(inner: &Weak<Inner>, held: &mut PgConnection) -> Result<(), sqlx::Error> {
    loop {
        let Some(inner) = inner.upgrade().filter(|inner| !inner.pools.is_closed()) else {
            return Ok(());
        };
        let store = Store::around(inner);
        if let Err(error) = store.tidy_behind_the_dead().await {
            tracing::warn!(%error, "what dead processes left behind could not be removed");
        }
        drop(store);
        held.ping().await?;
        tokio::time::sleep(PULSE).await;
    }
}
