//! Common interface to both databases.
//!
//! The store writes its SQL once, with `$1` placeholders and types that both have: 64-bit integers, doubles, text,
//! bytes. Lists are bound by [`Query::push_bind`], which writes the placeholders of each database. Differences are
//! translated by [`translated`]; where a statement cannot be the same, the code asks [`Transaction::is_postgres`].

use std::borrow::Cow;
use std::time::Instant;

use sqlx::postgres::{PgArguments, PgRow};
use sqlx::sqlite::{SqliteArguments, SqliteRow};
use sqlx::{
    Arguments as _, AssertSqlSafe, Decode, Encode, PgConnection, PgPool, Postgres, Row as _, Sqlite,
    SqliteConnection, SqlitePool, Type,
};

use super::error::StoreError;
use super::failure::{self, Failure};
use super::known_names::Writes;
use super::metrics;

/// Connections of a store.
#[derive(Debug, Clone)]
pub(super) enum Pools {
    /// One connection writes, several read.
    Sqlite {
        writer: SqlitePool,
        reader: SqlitePool,
    },
    Postgres(PgPool),
}

impl Pools {
    /// Link for read-only statements.
    pub(super) fn reader(&self) -> Link<'_> {
        match self {
            Self::Sqlite { reader, .. } => Link::SqlitePool(reader),
            Self::Postgres(pool) => Link::PgPool(pool),
        }
    }

    /// Link for single write statements.
    pub(super) fn writer(&self) -> Link<'_> {
        match self {
            Self::Sqlite { writer, .. } => Link::SqlitePool(writer),
            Self::Postgres(pool) => Link::PgPool(pool),
        }
    }

    /// Begins a read transaction on a consistent snapshot.
    pub(super) async fn begin_read(&self) -> Result<Transaction, sqlx::Error> {
        const SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
        match self {
            Self::Sqlite { reader, .. } => reader.begin().await.map(Connection::Sqlite),
            Self::Postgres(pool) => begin(pool, SNAPSHOT).await.map(Connection::Postgres),
        }
        .map(|connection| Transaction { connection, writes_since: None, writes: None })
    }

    /// Begins a write transaction that excludes others with the same `scope`; on SQLite it excludes all others.
    pub(super) async fn begin_write(&self, scope: &str) -> Result<Transaction, sqlx::Error> {
        const LOCK: &str = "SELECT pg_advisory_xact_lock(hashtextextended($1, 0))";
        let asked = Instant::now();
        let connection = match self {
            Self::Sqlite { writer, .. } => Connection::Sqlite(writer.begin_with("BEGIN IMMEDIATE").await?),
            Self::Postgres(pool) => {
                let mut transaction = begin(pool, "BEGIN").await?;
                sqlx::query(LOCK).bind(scope).execute(&mut *transaction).await?;
                Connection::Postgres(transaction)
            }
        };
        metrics::waited(asked.elapsed());
        Ok(Transaction { connection, writes_since: Some(Instant::now()), writes: None })
    }

    pub(super) fn is_postgres(&self) -> bool {
        matches!(self, Self::Postgres(_))
    }

    /// Whether [`Pools::close`] was called.
    pub(super) fn is_closed(&self) -> bool {
        match self {
            Self::Sqlite { writer, .. } => writer.is_closed(),
            Self::Postgres(pool) => pool.is_closed(),
        }
    }

    /// Merges the write-ahead log of an embedded database into its file and empties it, so that a copy of the file is complete.
    /// Returns whether no reader has prevented it.
    pub(super) async fn fold_log(&self) -> Result<bool, sqlx::Error> {
        const FOLD: &str = "PRAGMA wal_checkpoint(TRUNCATE)";
        match self {
            Self::Sqlite { .. } => Ok(sql(self.writer(), FOLD).scalar::<i64>().await? == 0),
            Self::Postgres(_) => Ok(true),
        }
    }

    /// Closes all connections.
    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite { writer, reader } => {
                reader.close().await;
                // Writer last: the last connection to close merges the write-ahead log into the file.
                writer.close().await;
            }
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

/// Begins a transaction, in a task that ends also if the caller does not wait for it: a connection that has sent `BEGIN` and is
/// dropped before the answer would go back to the pool within the transaction.
async fn begin(
    pool: &PgPool,
    statement: &'static str,
) -> Result<sqlx::Transaction<'static, Postgres>, sqlx::Error> {
    let pool = pool.clone();
    let begun = tokio::spawn(async move { pool.begin_with(statement).await }).await;
    begun.unwrap_or(Err(sqlx::Error::WorkerCrashed))
}

/// A transaction; rolled back if dropped without [`Transaction::commit`].
#[derive(Debug)]
pub(super) struct Transaction {
    connection: Connection,
    /// Time at which it began, if it writes.
    writes_since: Option<Instant>,
    /// Counts it once it is committed.
    writes: Option<Writes>,
}

#[derive(Debug)]
enum Connection {
    Sqlite(sqlx::Transaction<'static, Sqlite>),
    Postgres(sqlx::Transaction<'static, Postgres>),
}

impl Transaction {
    pub(super) async fn commit(self) -> Result<(), sqlx::Error> {
        match self.connection {
            Connection::Sqlite(transaction) => transaction.commit().await?,
            Connection::Postgres(transaction) => transaction.commit().await?,
        }
        if let Some(begun) = self.writes_since {
            metrics::wrote(begun.elapsed());
        }
        self.writes.inspect(Writes::count);
        Ok(())
    }

    /// The same transaction, which `writes` counts once it is committed.
    pub(super) fn counted_by(self, writes: &Writes) -> Self {
        Self { writes: Some(writes.clone()), ..self }
    }

    pub(super) fn is_postgres(&self) -> bool {
        matches!(self.connection, Connection::Postgres(_))
    }
}

/// Connection, pool or transaction in which a statement runs.
#[derive(Debug)]
pub(super) enum Link<'c> {
    SqlitePool(&'c SqlitePool),
    PgPool(&'c PgPool),
    Sqlite(&'c mut SqliteConnection),
    Postgres(&'c mut PgConnection),
}

impl<'c> From<&'c mut Transaction> for Link<'c> {
    fn from(transaction: &'c mut Transaction) -> Self {
        match &mut transaction.connection {
            Connection::Sqlite(transaction) => Link::Sqlite(transaction),
            Connection::Postgres(transaction) => Link::Postgres(transaction),
        }
    }
}

/// Types that both databases accept as values.
pub(super) trait Bindable<'q>:
    Encode<'q, Sqlite> + Type<Sqlite> + Encode<'q, Postgres> + Type<Postgres>
{
}

impl<'q, T> Bindable<'q> for T where
    T: Encode<'q, Sqlite> + Type<Sqlite> + Encode<'q, Postgres> + Type<Postgres>
{
}

/// Types that both databases return as values.
pub(super) trait Readable<'r>:
    Decode<'r, Sqlite> + Type<Sqlite> + Decode<'r, Postgres> + Type<Postgres>
{
}

impl<'r, T> Readable<'r> for T where
    T: Decode<'r, Sqlite> + Type<Sqlite> + Decode<'r, Postgres> + Type<Postgres>
{
}

#[derive(Debug)]
enum Arguments {
    Sqlite(SqliteArguments),
    Postgres(PgArguments),
}

impl Arguments {
    fn add<'q>(&mut self, value: impl Bindable<'q>) -> Result<(), sqlx::error::BoxDynError> {
        match self {
            Self::Sqlite(arguments) => sqlx::Arguments::add(arguments, value),
            Self::Postgres(arguments) => arguments.add(value),
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Sqlite(arguments) => sqlx::Arguments::len(arguments),
            Self::Postgres(arguments) => arguments.len(),
        }
    }
}

/// A statement with its values and its link.
#[derive(Debug)]
pub(super) struct Query<'c> {
    link: Link<'c>,
    text: Cow<'static, str>,
    arguments: Arguments,
    /// Number of placeholders without a name, which stand for the first arguments in their order.
    nameless: usize,
    /// First value that could not be encoded.
    error: Option<sqlx::Error>,
    persistent: bool,
}

/// Statement `text` to be run at `link`.
pub(super) fn sql<'c>(link: impl Into<Link<'c>>, text: &'static str) -> Query<'c> {
    let link = link.into();
    let arguments = match &link {
        Link::SqlitePool(_) | Link::Sqlite(_) => Arguments::Sqlite(SqliteArguments::default()),
        Link::PgPool(_) | Link::Postgres(_) => Arguments::Postgres(PgArguments::default()),
    };
    Query { link, text: Cow::Borrowed(text), arguments, nameless: 0, error: None, persistent: true }
}

impl Query<'_> {
    /// Binds the value of the next placeholder.
    pub(super) fn bind<'q>(mut self, value: impl Bindable<'q>) -> Self {
        self.add(value);
        self
    }

    fn add<'q>(&mut self, value: impl Bindable<'q>) {
        if let Err(error) = self.arguments.add(value) {
            self.error.get_or_insert(sqlx::Error::Encode(error));
        }
    }

    /// Whether it runs on PostgreSQL.
    pub(super) fn is_postgres(&self) -> bool {
        matches!(self.arguments, Arguments::Postgres(_))
    }

    /// Appends to the statement text.
    pub(super) fn push(&mut self, text: &str) -> &mut Self {
        self.text.to_mut().push_str(text);
        self
    }

    /// Appends a placeholder with its value.
    ///
    /// For SQLite it has no name if possible: SQLite and its driver look up the name of every placeholder among all names,
    /// so that a statement with thousands of names takes a hundred times as long.
    pub(super) fn push_bind<'q>(&mut self, value: impl Bindable<'q>) -> &mut Self {
        // The driver takes the k-th placeholder without a name for the k-th argument, wherever names stand in between.
        let is_nameless =
            matches!(self.arguments, Arguments::Sqlite(_)) && self.nameless == self.arguments.len();
        self.add(value);
        if is_nameless {
            self.nameless += 1;
            return self.push("?");
        }
        let place = format!("${}", self.arguments.len());
        self.push(&place)
    }

    /// The statement between two other parts.
    pub(super) fn within(mut self, before: &str, after: &str) -> Self {
        self.text.to_mut().insert_str(0, before);
        self.text.to_mut().push_str(after);
        self
    }

    /// Appends a subquery of the numbers of a list, bound as one value.
    pub(super) fn push_numbers(&mut self, numbers: impl Iterator<Item = i64>) -> &mut Self {
        let list = serde_json::Value::from_iter(numbers).to_string();
        self.push_list(list, "CAST(t.value AS BIGINT)")
    }

    /// Appends a subquery of the texts of a list, bound as one value.
    pub(super) fn push_texts<'t>(&mut self, texts: impl Iterator<Item = &'t str>) -> &mut Self {
        let list = serde_json::Value::from_iter(texts).to_string();
        self.push_list(list, "t.value")
    }

    fn push_list(&mut self, list: String, value: &str) -> &mut Self {
        let (each, end) = match self.arguments {
            Arguments::Sqlite(_) => (" FROM json_each(", ") AS t)"),
            Arguments::Postgres(_) => (" FROM json_array_elements_text(", "::json) AS t (value))"),
        };
        self.push("(SELECT ").push(value).push(each).push_bind(list).push(end)
    }

    /// Sets whether the prepared statement is cached; rarely repeated statements are not worth it.
    pub(super) fn persistent(mut self, persistent: bool) -> Self {
        self.persistent = persistent;
        self
    }

    /// Executes it; returns the number of rows changed.
    pub(super) async fn execute(self) -> Result<u64, sqlx::Error> {
        match self.ready()? {
            Ready::Sqlite(query, OnSqlite::Pool(pool)) => Ok(query.execute(pool).await?.rows_affected()),
            Ready::Sqlite(query, OnSqlite::Connection(one)) => Ok(query.execute(one).await?.rows_affected()),
            Ready::Postgres(query, OnPostgres::Pool(pool)) => Ok(query.execute(pool).await?.rows_affected()),
            Ready::Postgres(query, OnPostgres::Connection(one)) => {
                Ok(query.execute(one).await?.rows_affected())
            }
        }
    }

    /// Returns all rows.
    pub(super) async fn all(self) -> Result<Vec<Row>, sqlx::Error> {
        Ok(match self.ready()? {
            Ready::Sqlite(query, OnSqlite::Pool(pool)) => rows(query.fetch_all(pool).await?, Row::Sqlite),
            Ready::Sqlite(query, OnSqlite::Connection(one)) => rows(query.fetch_all(one).await?, Row::Sqlite),
            Ready::Postgres(query, OnPostgres::Pool(pool)) => {
                rows(query.fetch_all(pool).await?, Row::Postgres)
            }
            Ready::Postgres(query, OnPostgres::Connection(one)) => {
                rows(query.fetch_all(one).await?, Row::Postgres)
            }
        })
    }

    /// Returns the first row, if any.
    pub(super) async fn optional(self) -> Result<Option<Row>, sqlx::Error> {
        Ok(match self.ready()? {
            Ready::Sqlite(query, OnSqlite::Pool(pool)) => query.fetch_optional(pool).await?.map(Row::Sqlite),
            Ready::Sqlite(query, OnSqlite::Connection(one)) => {
                query.fetch_optional(one).await?.map(Row::Sqlite)
            }
            Ready::Postgres(query, OnPostgres::Pool(pool)) => {
                query.fetch_optional(pool).await?.map(Row::Postgres)
            }
            Ready::Postgres(query, OnPostgres::Connection(one)) => {
                query.fetch_optional(one).await?.map(Row::Postgres)
            }
        })
    }

    /// Returns the first row.
    pub(super) async fn one(self) -> Result<Row, sqlx::Error> {
        self.optional().await?.ok_or(sqlx::Error::RowNotFound)
    }

    /// Returns the first column of the first row.
    pub(super) async fn scalar<T: for<'r> Readable<'r>>(self) -> Result<T, sqlx::Error> {
        self.one().await?.at(0)
    }

    /// Returns the first column of the first row, if any.
    pub(super) async fn optional_scalar<T: for<'r> Readable<'r>>(self) -> Result<Option<T>, sqlx::Error> {
        self.optional().await?.map(|row| row.at(0)).transpose()
    }
}

type Prepared<DB, A> = sqlx::query::Query<'static, DB, A>;

enum OnSqlite<'c> {
    Pool(&'c SqlitePool),
    Connection(&'c mut SqliteConnection),
}

enum OnPostgres<'c> {
    Pool(&'c PgPool),
    Connection(&'c mut PgConnection),
}

enum Ready<'c> {
    Sqlite(Prepared<Sqlite, SqliteArguments>, OnSqlite<'c>),
    Postgres(Prepared<Postgres, PgArguments>, OnPostgres<'c>),
}

impl<'c> Query<'c> {
    fn ready(self) -> Result<Ready<'c>, sqlx::Error> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let persistent = self.persistent;
        Ok(match (self.link, self.arguments) {
            (Link::SqlitePool(pool), Arguments::Sqlite(arguments)) => {
                Ready::Sqlite(on_sqlite(self.text, arguments, persistent), OnSqlite::Pool(pool))
            }
            (Link::Sqlite(one), Arguments::Sqlite(arguments)) => {
                Ready::Sqlite(on_sqlite(self.text, arguments, persistent), OnSqlite::Connection(one))
            }
            (Link::PgPool(pool), Arguments::Postgres(arguments)) => {
                Ready::Postgres(on_postgres(self.text, arguments, persistent), OnPostgres::Pool(pool))
            }
            (Link::Postgres(one), Arguments::Postgres(arguments)) => {
                Ready::Postgres(on_postgres(self.text, arguments, persistent), OnPostgres::Connection(one))
            }
            _ => unreachable!("arguments are made for their link"),
        })
    }
}

fn on_sqlite(
    text: Cow<'static, str>,
    arguments: SqliteArguments,
    persistent: bool,
) -> Prepared<Sqlite, SqliteArguments> {
    match text {
        Cow::Borrowed(text) => sqlx::query_with(text, arguments),
        Cow::Owned(text) => sqlx::query_with(AssertSqlSafe(text), arguments),
    }
    .persistent(persistent)
}

fn on_postgres(
    text: Cow<'static, str>,
    arguments: PgArguments,
    persistent: bool,
) -> Prepared<Postgres, PgArguments> {
    match translated(text) {
        Cow::Borrowed(text) => sqlx::query_with(text, arguments),
        Cow::Owned(text) => sqlx::query_with(AssertSqlSafe(text), arguments),
    }
    .persistent(persistent)
}

/// Translates a statement written for SQLite to PostgreSQL; most need no translation and are not copied.
fn translated(text: Cow<'static, str>) -> Cow<'static, str> {
    if !text.contains("CROSS JOIN") && !text.contains("json_each") {
        return text;
    }
    // In SQLite these words fix the order of the loops; PostgreSQL plans for itself.
    let text = text.replace("CROSS JOIN", "JOIN");
    // A list bound as a JSON array: `key` is the index from 0, `value` the text.
    let text = text.replace(
        "json_each($2) AS asked",
        "(SELECT t.value, t.place - 1 AS key FROM
            json_array_elements_text($2::json) WITH ORDINALITY AS t (value, place)) AS asked",
    );
    Cow::Owned(text.replace(
        "json_each($1) AS asked",
        "(SELECT t.value, t.place - 1 AS key FROM
            json_array_elements_text($1::json) WITH ORDINALITY AS t (value, place)) AS asked",
    ))
}

fn rows<T>(found: Vec<T>, row: fn(T) -> Row) -> Vec<Row> {
    found.into_iter().map(row).collect()
}

/// Row of a result.
pub(super) enum Row {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

impl Row {
    /// Value of a column by name.
    pub(super) fn get<'r, T: Readable<'r>>(&'r self, column: &str) -> Result<T, sqlx::Error> {
        match self {
            Self::Sqlite(row) => row.try_get(column),
            Self::Postgres(row) => row.try_get(column),
        }
    }

    /// Value of a column by index.
    pub(super) fn at<'r, T: Readable<'r>>(&'r self, index: usize) -> Result<T, sqlx::Error> {
        match self {
            Self::Sqlite(row) => row.try_get(index),
            Self::Postgres(row) => row.try_get(index),
        }
    }
}

/// Whether the error is a violated unique constraint on the column of the table.
pub(super) fn is_duplicate(error: &sqlx::Error, table: &str, column: &str) -> bool {
    error.as_database_error().is_some_and(|error| {
        // One database names the column in the message, the other its index.
        error.is_unique_violation()
            && (error.message().contains(&format!("{table}.{column}"))
                || error.constraint().is_some_and(|name| name.starts_with(&format!("{table}_{column}"))))
    })
}

/// Whether the error is SQLite's error for a missing table.
pub(super) fn is_missing_table(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(|error| error.message().starts_with("no such table"))
}

/// Whether the error is a reference to a missing row.
pub(super) fn is_missing_reference(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(|error| error.is_foreign_key_violation())
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        let failure = failure::of(&error);
        metrics::failed(failure);
        match failure {
            Some(Failure::Passing) => Self::Busy,
            Some(Failure::Damaged) => Self::Damaged { detail: error.to_string() },
            Some(Failure::Full) => Self::Full,
            Some(Failure::ReadOnly) => Self::ReadOnly,
            Some(Failure::Text) => Self::Text,
            None => Self::Database(error),
        }
    }
}

/// An unsigned number for SQLite, whose integers are signed; too large ones mean "the last".
pub(super) fn to_sql(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// An unsigned number from SQLite; the schema never stores negative ones.
pub(super) fn from_sql(number: i64) -> u64 {
    u64::try_from(number).unwrap_or_default()
}

/// Number of shapes per INSERT: more bring little, and SQLite allows 32766 placeholders in a statement.
const ROWS_PER_INSERT: usize = 512;

/// The rows of one INSERT statement after the other. Their numbers are powers of two, so that there are only ten statements:
/// preparing one takes longer than inserting its rows.
pub(super) fn rows_of_inserts<T>(mut rows: &[T]) -> impl Iterator<Item = &[T]> {
    std::iter::from_fn(move || {
        let count = ROWS_PER_INSERT.min(1 << rows.len().checked_ilog2()?);
        let (next, later) = rows.split_at(count);
        rows = later;
        Some(next)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_have_few_lengths() {
        let lengths = |rows: usize| rows_of_inserts(&vec![(); rows]).map(<[()]>::len).collect::<Vec<_>>();
        assert_eq!(lengths(0), [0; 0]);
        assert_eq!(lengths(7), [4, 2, 1]);
        assert_eq!(lengths(1600), [512, 512, 512, 64]);
    }
}
