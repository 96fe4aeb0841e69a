//! Places of shapes in storage, and their names.

use std::ops::Range;

use super::answer::Answer;
use super::blob::ROWS_PER_CHUNK;
use super::engine::sql;
use super::handle::Store;
use super::order::Cursor;
use super::shapes::read_attributes;
use crate::domain::shape::ShapeAttributes;

/// Places of consecutive shapes of a scan, as runs of neighbouring rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Places {
    /// Number of shapes before each run, and the place of its first shape.
    runs: Vec<(usize, Cursor)>,
    count: usize,
}

impl Places {
    /// Memory of a place in bytes, at most.
    pub const MOST_BYTES: usize = size_of::<(usize, Cursor)>();

    /// Number of shapes.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Place of the shape at a position.
    pub fn get(&self, position: usize) -> Option<Cursor> {
        let run = self.runs.partition_point(|(before, _)| *before <= position).checked_sub(1)?;
        let (before, first) = self.runs[run];
        let row = first.position + (position - before) as i64;
        (position < self.count).then_some(Cursor { position: row, ..first })
    }

    /// All places, in order.
    pub fn iter(&self) -> impl Iterator<Item = Cursor> {
        let ends = self.runs.iter().skip(1).map(|(before, _)| *before).chain([self.count]);
        self.runs.iter().zip(ends).flat_map(|(&(before, first), end)| {
            (0..(end - before) as i64).map(move |row| Cursor { position: first.position + row, ..first })
        })
    }

    /// Runs of neighbouring rows from the shape at `position` on: their chunks and rows.
    pub(super) fn runs_from(&self, position: usize) -> impl Iterator<Item = (i64, Range<usize>)> {
        let begun = self.runs.partition_point(|(before, _)| *before <= position).saturating_sub(1);
        let ends = self.runs.iter().skip(begun + 1).map(|(before, _)| *before).chain([self.count]);
        self.runs.iter().skip(begun).zip(ends).filter(move |(_, end)| *end > position).map(
            move |(&(before, first), end)| {
                let row = usize::try_from(first.position).unwrap_or_default();
                (first.chunk, row + position.saturating_sub(before)..row + end - before)
            },
        )
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.runs.as_slice())
    }

    /// Appends rows of a chunk.
    pub(super) fn push(&mut self, chunk: i64, rows: &Range<usize>) {
        if rows.is_empty() {
            return;
        }
        let first = Cursor { chunk, position: rows.start as i64 };
        let continues = self.runs.last().is_some_and(|&(before, run)| {
            run.chunk == chunk && run.position + (self.count - before) as i64 == first.position
        });
        if !continues {
            self.runs.push((self.count, first));
        }
        self.count += rows.len();
    }

    /// Appends the places of further shapes.
    pub fn append(&mut self, more: &Self) {
        self.runs.extend(more.runs.iter().map(|&(before, first)| (self.count + before, first)));
        self.count += more.count;
    }
}

/// A shape with its id.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedShape {
    /// Id, `shp_…`.
    pub id: String,
    /// Attributes without the weight.
    pub attributes: ShapeAttributes,
}

impl Store {
    /// The shapes at these places, in order, including deleted shapes; `None` for those that were purged.
    ///
    /// # Errors
    /// Database errors.
    pub fn shapes_at<'a>(
        &'a self,
        cohort_id: &'a str,
        places: &'a [Cursor],
    ) -> Answer<'a, Vec<Option<NamedShape>>> {
        Box::pin(async move {
            // A place is one number: the chunk times 2²⁰, plus the row.
            const AT: &str =
                "SELECT asked.key AS place, s.id, s.external_id, s.subject, s.label, s.labels, s.metadata
                FROM json_each($2) AS asked
                CROSS JOIN shape AS s ON s.chunk_id = CAST(asked.value AS BIGINT) / 1048576
                    AND s.position = CAST(asked.value AS BIGINT) % 1048576
                CROSS JOIN cohort AS h ON h.number = s.cohort
                WHERE h.id = $1";
            const { assert!(ROWS_PER_CHUNK <= 1 << 20) };
            let numbers: Vec<i64> = places.iter().map(|place| (place.chunk << 20) + place.position).collect();
            let asked = serde_json::Value::from(numbers).to_string();
            let rows = sql(self.reader(), AT).bind(cohort_id).bind(asked).all().await?;
            let mut found: Vec<Option<NamedShape>> = places.iter().map(|_| None).collect();
            for row in &rows {
                let place = usize::try_from(row.get::<i64>("place")?).unwrap_or(usize::MAX);
                if let Some(slot) = found.get_mut(place) {
                    *slot = Some(NamedShape { id: row.get("id")?, attributes: read_attributes(row)? });
                }
            }
            Ok(found)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_name_every_row() {
        let mut all = Places::default();
        let mut rows = Vec::new();
        for (chunk, range) in [(3, 0..4), (3, 4..6), (3, 7..9), (5, 2..2), (8, 0..1)] {
            all.push(chunk, &range);
            rows.extend(range.map(|row| Cursor { chunk, position: row as i64 }));
        }
        let mut twice = all.clone();
        twice.append(&all);
        assert_eq!((all.count(), all.runs.len()), (rows.len(), 3));
        assert_eq!(
            (0..9).map(|k| all.get(k)).collect::<Vec<_>>(),
            rows.iter().copied().map(Some).collect::<Vec<_>>()
        );
        assert_eq!(all.get(9), None);
        assert_eq!(all.iter().collect::<Vec<_>>(), rows);
        assert!((0..18).all(|k| twice.get(k) == Some(rows[k % 9])));
        let from = |position| -> Vec<Cursor> {
            let runs = all.runs_from(position);
            let rows = runs.flat_map(|(chunk, rows)| rows.map(move |row| (chunk, row as i64)));
            rows.map(|(chunk, position)| Cursor { chunk, position }).collect()
        };
        (0..=9).for_each(|position| assert_eq!(from(position), rows[position..], "from {position}"));
        assert_eq!(Places::default().runs_from(0).count(), 0);
        assert_eq!(Places::default().get(0), None);
    }
}
