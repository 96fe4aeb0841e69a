//! Export of the whole store as lines of JSON, in a format common to both databases.
//!
//! ```text
//! {"format": "shapelex-export", "version": 1, "schema": …, "program": …, "tables": {"cohort": ["number", …], …}}
//! ["cohort", 1, "coh_…", …]                              one line a row, bytes in base64
//! {"rows": {"cohort": 1, …}, "counters": {"cohort": 1, …}, "digest": "…"}
//! ```
//!
//! The digest is the BLAKE3 of all lines before the last, each with its line break.

use std::io::Write;

use serde_json::{Map, Value, json};

use super::super::answer::Answer;
use super::super::engine::{Transaction, sql};
use super::super::handle::Store;
use super::tables::{Cell, TABLES, Table};
use super::{MaintenanceError, schema};

/// Format name in the first line.
pub(super) const FORMAT: &str = "shapelex-export";
/// Version of the format.
pub(super) const VERSION: i64 = 1;

/// First line of an export of the schema.
pub(super) fn head(schema: i64) -> Value {
    let tables: Map<String, Value> = TABLES
        .iter()
        .map(|table| {
            let names = table.columns.iter().map(|(name, _)| Value::from(*name));
            (table.name.to_owned(), names.collect())
        })
        .collect();
    json!({"format": FORMAT, "version": VERSION, "schema": schema,
        "program": env!("CARGO_PKG_VERSION"), "tables": tables})
}

/// Output lines with their running digest.
struct Lines<'a> {
    out: &'a mut (dyn Write + Send),
    digest: blake3::Hasher,
}

impl Lines<'_> {
    fn write(&mut self, line: &Value) -> Result<(), MaintenanceError> {
        let mut text = line.to_string();
        text.push('\n');
        self.digest.update(text.as_bytes());
        Ok(self.out.write_all(text.as_bytes())?)
    }
}

impl Store {
    /// Writes everything that is kept, of all tenants, from one snapshot; returns the number of rows. Readers and writers are
    /// not blocked. A few rows are in memory at a time, the largest of which may be a distance matrix.
    ///
    /// # Errors
    /// [`MaintenanceError::Stream`]; those of the database.
    pub fn export<'a>(&'a self, out: &'a mut (dyn Write + Send)) -> Answer<'a, u64, MaintenanceError> {
        Box::pin(async move {
            let schema = schema::require_present(&self.inner.pools).await?;
            let mut lines = Lines { out, digest: blake3::Hasher::new() };
            lines.write(&head(schema))?;
            let mut read = self.begin_read().await?;
            let (mut rows, mut counters) = (Map::new(), Map::new());
            let mut total = 0;
            for table in TABLES {
                let count = export_table(&mut read, table, &mut lines).await?;
                total += count;
                rows.insert(table.name.into(), count.into());
                if table.counted {
                    counters.insert(table.name.into(), counter(&mut read, table).await?.into());
                }
            }
            read.commit().await?;
            let digest = lines.digest.finalize().to_hex();
            lines.write(&json!({"rows": rows, "counters": counters, "digest": digest.as_str()}))?;
            lines.out.flush()?;
            Ok(total)
        })
    }

    /// Whether the store is embedded.
    pub(super) fn is_embedded(&self) -> bool {
        !self.inner.pools.is_postgres()
    }
}

/// Writes the rows of a table in key order; returns their number.
async fn export_table(
    read: &mut Transaction,
    table: &Table,
    lines: &mut Lines<'_>,
) -> Result<u64, MaintenanceError> {
    let (mut count, mut last) = (0, None);
    loop {
        let rows = page(read, table, last.as_deref()).await?;
        let Some(end) = rows.last() else { return Ok(count) };
        for row in &rows {
            let mut line = vec![Value::from(table.name)];
            line.extend(row.iter().map(Cell::to_json));
            lines.write(&Value::Array(line))?;
        }
        count += rows.len() as u64;
        last = Some(end[..table.key].to_vec());
    }
}

/// Next rows of a table after the key `after`.
async fn page(
    read: &mut Transaction,
    table: &Table,
    after: Option<&[Cell]>,
) -> Result<Vec<Vec<Cell>>, MaintenanceError> {
    let key = table.names(table.key);
    let mut query = sql(read, "SELECT ");
    query.push(&table.names(table.columns.len())).push(" FROM ").push(table.name);
    query.push(" WHERE ").push(table.condition.unwrap_or("1 = 1"));
    if let Some(after) = after {
        query.push(" AND (").push(&key).push(") > (");
        for (i, (cell, (_, kind))) in after.iter().zip(table.columns).enumerate() {
            query.push(if i == 0 { "" } else { ", " });
            cell.push_to(&mut query, *kind);
        }
        query.push(")");
    }
    query.push(" ORDER BY ").push(&key).push(" LIMIT ").push_bind(table.page);
    let rows = query.all().await?;
    let cells = rows.iter().map(|row| {
        let cells = table.columns.iter().map(|(name, kind)| Cell::read(row, name, *kind));
        cells.collect::<Result<Vec<Cell>, _>>()
    });
    Ok(cells.collect::<Result<_, _>>()?)
}

/// Last number that the database assigned to a row of the table.
async fn counter(read: &mut Transaction, table: &Table) -> Result<i64, MaintenanceError> {
    const IN_SQLITE: &str = "SELECT seq FROM sqlite_sequence WHERE name = $1";
    const IN_POSTGRES: &str =
        "SELECT coalesce(pg_sequence_last_value(pg_get_serial_sequence($1, $2)::regclass), 0)";
    let query = if read.is_postgres() {
        sql(read, IN_POSTGRES).bind(table.name).bind(table.columns[0].0)
    } else {
        sql(read, IN_SQLITE).bind(table.name)
    };
    Ok(query.optional_scalar().await?.unwrap_or_default())
}
