//! What this machine does at best for an upload and for a small request.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use axum::routing::{get, post};
use axum::{Json, Router};
use serde_json::Value;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, QueryBuilder, Sqlite};
use tokio::net::TcpListener;

/// Rows of an INSERT and of a transaction of [`store_only`], as an upload has them.
const ROWS_PER_INSERT: usize = 512;
const ROWS_PER_TRANSACTION: usize = 4096;

/// Closed contours of `n` points as NDJSON, with ids and labels.
pub(crate) fn lines(n: usize, first: usize, count: usize) -> String {
    let mut text = String::new();
    for k in first..first + count {
        let points = serde_json::to_string(&points(n, k)).unwrap();
        writeln!(text, "{{\"external_id\":\"s{k}\",\"label\":\"c{}\",\"points\":{points}}}", k % 3).unwrap();
    }
    text
}

/// A contour of `n` points; others for other seeds.
pub(crate) fn points(n: usize, seed: usize) -> Vec<[f64; 2]> {
    (0..n)
        .map(|k| {
            let t = std::f64::consts::TAU * k as f64 / n as f64;
            let noise = |c: usize| 0.1 * ((seed * 31 + k * 17 + c * 7) as f64 * 0.618_033_988_7).sin();
            [2.0 * t.cos() + 0.3 * (2.0 * t).cos() + noise(0), t.sin() + 0.2 * (3.0 * t).sin() + noise(1)]
        })
        .collect()
}

/// A line of [`lines`].
#[derive(Debug, serde::Deserialize)]
pub(crate) struct Posted {
    pub(crate) external_id: String,
    pub(crate) label: String,
    pub(crate) points: Vec<[f64; 2]>,
}

/// The shapes of the lines, and the seconds in which one thread parses them and does nothing else.
pub(crate) fn parse_only(text: &str) -> (Vec<Posted>, f64) {
    let start = Instant::now();
    let shapes = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    (shapes, start.elapsed().as_secs_f64())
}

/// Seconds in which plain statements store the shapes in a new file of SQLite: one table with two unique indices, the points as a
/// blob, and a transaction, written to the disk, for every 4096 rows.
pub(crate) async fn store_only(shapes: &[Posted], file: &Path) -> f64 {
    let options = SqliteConnectOptions::new().filename(file).create_if_missing(true);
    let options = options.journal_mode(SqliteJournalMode::Wal).synchronous(SqliteSynchronous::Full);
    let mut database = options.disable_statement_logging().connect().await.unwrap();
    const TABLE: &str =
        "CREATE TABLE shape (id TEXT NOT NULL PRIMARY KEY, external_id TEXT NOT NULL UNIQUE, label TEXT,
        points BLOB NOT NULL)";
    sqlx::query(TABLE).execute(&mut database).await.unwrap();
    let start = Instant::now();
    for rows in shapes.chunks(ROWS_PER_TRANSACTION) {
        let mut transaction = database.begin().await.unwrap();
        for rows in rows.chunks(ROWS_PER_INSERT) {
            insert(&mut transaction, rows).await;
        }
        transaction.commit().await.unwrap();
    }
    start.elapsed().as_secs_f64()
}

async fn insert(database: &mut SqliteConnection, rows: &[Posted]) {
    let mut query = QueryBuilder::<Sqlite>::new("INSERT INTO shape ");
    query.push_values(rows, |mut row, shape| {
        let points: Vec<u8> = shape.points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        let id = uuid::Uuid::now_v7().to_string();
        row.push_bind(id).push_bind(&shape.external_id).push_bind(&shape.label).push_bind(points);
    });
    query.build().execute(database).await.unwrap();
}

/// Serves bare axum: `GET /livez` without a body, `POST /v1/project` with the JSON that was sent.
pub(crate) async fn echo(listener: TcpListener) -> std::io::Result<()> {
    let echo = post(async |Json(value): Json<Value>| Json(value));
    let router = Router::new().route("/livez", get(async || ())).route("/v1/project", echo);
    axum::serve(listener, router).await
}
