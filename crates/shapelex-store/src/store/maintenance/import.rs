//! Import of an exported store into an empty one, in one transaction: all or nothing.

use std::io::{BufRead, Read as _};

use serde_json::{Map, Value};

use super::super::answer::Answer;
use super::super::copies::settle_copy;
use super::super::engine::{Transaction, sql};
use super::super::handle::Store;
use super::tables::{Cell, TABLES, Table};
use super::{MaintenanceError, export, schema};

/// Maximum length of a line: the largest value a database stores has 1.4 billion characters in base64.
const MAX_LINE_BYTES: u64 = 1_500_000_000;
/// Maximum numbers of rows and bytes per INSERT.
const ROWS_PER_INSERT: usize = 512;
const BYTES_PER_INSERT: usize = 4 << 20;
const END_OF_LINE: u8 = b'\n';

impl Store {
    /// Reads an export into this store, which must be empty; returns the number of rows, and that of the hooks that are paused: all active
    /// ones unless they are to `resume`.
    ///
    /// Nothing becomes visible before the last line has proved the export complete; otherwise nothing remains.
    ///
    /// # Errors
    /// [`MaintenanceError::StoreInUse`], [`MaintenanceError::Format`].
    pub fn import<'a>(
        &'a self,
        input: &'a mut (dyn BufRead + Send),
        resume: bool,
    ) -> Answer<'a, (u64, u64), MaintenanceError> {
        Box::pin(async move {
            let schema = schema::require_present(&self.inner.pools).await?;
            let mut lines = Lines { input, digest: blake3::Hasher::new(), number: 0, text: Vec::new() };
            let head = lines.next()?;
            check_head(&head, schema).map_err(|detail| lines.wrong(detail))?;
            let mut write = self.begin_write("import").await?;
            hold(&mut write).await?;
            let mut rows = Rows::default();
            let end = loop {
                match lines.next()? {
                    Value::Array(row) => {
                        rows.take(row).map_err(|detail| lines.wrong(detail))?;
                        rows.store(&mut write, false).await?;
                    }
                    end => {
                        check_end(&end, &rows, &lines.digest()).map_err(|detail| lines.wrong(detail))?;
                        break end;
                    }
                }
            };
            lines.expect_end()?;
            rows.store(&mut write, true).await?;
            for table in TABLES.iter().filter(|table| table.counted) {
                let last = end["counters"][table.name].as_i64();
                let last = last.ok_or_else(|| lines.wrong(format!("no counter of {}", table.name)))?;
                set_counter(&mut write, table, last).await?;
            }
            let paused = settle_copy(&mut write, resume).await?;
            write.commit().await?;
            Ok((rows.counts.iter().sum(), paused))
        })
    }
}

/// Input lines with their running digest.
struct Lines<'a> {
    input: &'a mut (dyn BufRead + Send),
    /// Digest of all lines before the one in `text`.
    digest: blake3::Hasher,
    number: u64,
    text: Vec<u8>,
}

impl Lines<'_> {
    fn next(&mut self) -> Result<Value, MaintenanceError> {
        self.number += 1;
        self.digest.update(&self.text);
        self.text.clear();
        (&mut *self.input).take(MAX_LINE_BYTES).read_until(END_OF_LINE, &mut self.text)?;
        if self.text.last() != Some(&END_OF_LINE) {
            return Err(self.wrong("the export is incomplete: it ends here".into()));
        }
        serde_json::from_slice(&self.text).map_err(|error| self.wrong(format!("not JSON: {error}")))
    }

    /// Digest of all lines before the last one read.
    fn digest(&self) -> String {
        self.digest.finalize().to_hex().to_string()
    }

    /// Refuses anything after the last line.
    fn expect_end(&mut self) -> Result<(), MaintenanceError> {
        if self.input.fill_buf()?.is_empty() {
            return Ok(());
        }
        Err(self.wrong("expected nothing after the last line".into()))
    }

    fn wrong(&self, detail: String) -> MaintenanceError {
        MaintenanceError::Format { line: self.number, detail }
    }
}

fn check_head(head: &Value, schema: i64) -> Result<(), String> {
    let expected = export::head(schema);
    if head["format"] != expected["format"] || head["version"] != expected["version"] {
        return Err(format!(
            "expected the first line of a {} of version {}",
            export::FORMAT,
            export::VERSION
        ));
    }
    if head["schema"] != expected["schema"] || head["tables"] != expected["tables"] {
        return Err(format!(
            "it was written by version {} with schema {}, this program has schema {schema}: import it with that version, then \
             run `shapelex migrate` with this one",
            head["program"].as_str().unwrap_or("?"),
            head["schema"]
        ));
    }
    Ok(())
}

fn check_end(end: &Value, rows: &Rows, digest: &str) -> Result<(), String> {
    let counts: Map<String, Value> =
        TABLES.iter().zip(rows.counts).map(|(table, count)| (table.name.into(), count.into())).collect();
    if end["rows"] != Value::Object(counts) {
        return Err("the export does not have the numbers of rows stated at its end".into());
    }
    if end["digest"] != digest {
        return Err(
            "the export does not match the digest stated at its end: it was changed or damaged".into()
        );
    }
    Ok(())
}

/// Rows of one table, collected for a joint insert.
#[derive(Default)]
struct Rows {
    /// Index of the table in [`TABLES`].
    table: usize,
    waiting: Vec<Vec<Cell>>,
    bytes: usize,
    /// Rows of the previous table that are still to be inserted.
    before: Option<(usize, Vec<Vec<Cell>>)>,
    counts: [u64; TABLES.len()],
}

impl Rows {
    /// Adds the row in a line.
    fn take(&mut self, line: Vec<Value>) -> Result<(), String> {
        let mut values = line.into_iter();
        let name = values.next();
        let name = name.as_ref().and_then(Value::as_str).unwrap_or_default();
        let place = TABLES.iter().position(|table| table.name == name);
        let place = place.filter(|place| *place >= self.table);
        let place = place.ok_or_else(|| format!("unexpected row of the table {name:?}"))?;
        let columns = TABLES[place].columns;
        if values.len() != columns.len() {
            return Err(format!(
                "expected {} values in a row of {name}, got {}",
                columns.len(),
                values.len()
            ));
        }
        let cells = values.zip(columns).map(|(value, (column, kind))| {
            Cell::from_json(value, *kind)
                .ok_or_else(|| format!("the value of {name}.{column} has another type"))
        });
        let cells: Vec<Cell> = cells.collect::<Result<_, _>>()?;
        if place != self.table {
            self.before = Some((self.table, std::mem::take(&mut self.waiting)));
            (self.table, self.bytes) = (place, 0);
        }
        self.counts[place] += 1;
        self.bytes += cells.iter().map(Cell::size).sum::<usize>();
        self.waiting.push(cells);
        Ok(())
    }

    /// Inserts full batches; if `last`, everything.
    async fn store(&mut self, write: &mut Transaction, last: bool) -> Result<(), MaintenanceError> {
        if let Some((table, rows)) = self.before.take() {
            insert(write, &TABLES[table], &rows).await?;
        }
        if last || self.waiting.len() >= ROWS_PER_INSERT || self.bytes >= BYTES_PER_INSERT {
            insert(write, &TABLES[self.table], &self.waiting).await?;
            self.waiting.clear();
            self.bytes = 0;
        }
        Ok(())
    }
}

async fn insert(write: &mut Transaction, table: &Table, rows: &[Vec<Cell>]) -> Result<(), MaintenanceError> {
    if rows.is_empty() {
        return Ok(());
    }
    let mut query = sql(write, "INSERT INTO ").persistent(rows.len() == ROWS_PER_INSERT);
    query.push(table.name).push(" (").push(&table.names(table.columns.len())).push(") VALUES ");
    for (i, row) in rows.iter().enumerate() {
        query.push(if i == 0 { "(" } else { ", (" });
        for (k, (cell, (_, kind))) in row.iter().zip(table.columns).enumerate() {
            query.push(if k == 0 { "" } else { ", " });
            cell.push_to(&mut query, *kind);
        }
        query.push(")");
    }
    query.execute().await?;
    Ok(())
}

/// Locks out other writers, and refuses a store that is not empty.
async fn hold(write: &mut Transaction) -> Result<(), MaintenanceError> {
    if write.is_postgres() {
        let mut lock = sql(&mut *write, "LOCK TABLE ");
        let names: Vec<&str> = TABLES.iter().map(|table| table.name).collect();
        lock.push(&names.join(", ")).push(" IN SHARE ROW EXCLUSIVE MODE");
        lock.execute().await?;
    }
    for table in TABLES {
        let mut query = sql(&mut *write, "SELECT count(*) FROM (SELECT 1 FROM ");
        query.push(table.name).push(" LIMIT 1) AS first");
        if query.scalar::<i64>().await? > 0 {
            return Err(MaintenanceError::StoreInUse(table.name));
        }
    }
    Ok(())
}

/// Makes the database continue numbering the rows of the table after `last`.
async fn set_counter(write: &mut Transaction, table: &Table, last: i64) -> Result<(), MaintenanceError> {
    const FORGET: &str = "DELETE FROM sqlite_sequence WHERE name = $1";
    const SET: &str = "INSERT INTO sqlite_sequence (name, seq) VALUES ($1, $2)";
    const IN_POSTGRES: &str = "SELECT setval(pg_get_serial_sequence($1, $2)::regclass, $3)";
    if last == 0 {
        return Ok(());
    }
    if write.is_postgres() {
        sql(write, IN_POSTGRES).bind(table.name).bind(table.columns[0].0).bind(last).execute().await?;
        return Ok(());
    }
    sql(&mut *write, FORGET).bind(table.name).execute().await?;
    sql(write, SET).bind(table.name).bind(last).execute().await?;
    Ok(())
}
