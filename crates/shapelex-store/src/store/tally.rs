//! Tallies of the shapes of a selection: how many run which way, how many came as meshes.

use super::answer::Answer;
use super::attributes::{Unmeasured, unmeasured_at};
use super::engine::{Row, from_sql, sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::Store;
use super::order::Cursor;
use crate::domain::filter::ShapeFilter;

/// Number of shapes whose direction is found at once.
const DIRECTED_AT_ONCE: i64 = 4096;

/// Numbers of shapes of a selection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// All of them.
    pub shapes: u64,
    /// Closed planar curves that run clockwise.
    pub clockwise: u64,
    /// Closed planar curves that run counter-clockwise.
    pub counter_clockwise: u64,
    /// Surfaces that came as meshes, for which parameters were computed.
    pub fitted: u64,
}

impl Store {
    /// Counts the shapes that pass the filter. Curves of earlier versions count once their direction is known
    /// ([`Self::undirected`]).
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn tally<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
    ) -> Answer<'a, Tally> {
        Box::pin(async move {
            const NUMBERS: &str =
                "count(*) AS shapes, count(CASE s.clockwise WHEN 1 THEN 1 END) AS clockwise,
                count(CASE s.clockwise WHEN 0 THEN 1 END) AS counter_clockwise, count(s.fit_mean) AS fitted";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let selection = Selection { cohort, revisions, filter, after: (0, -1) };
            let row = selection.select(&mut read, NUMBERS).optional().await?;
            let count = |row: &Row, name: &str| Ok::<_, StoreError>(from_sql(row.get(name)?));
            row.map_or(Ok(Tally::default()), |row| {
                Ok(Tally {
                    shapes: count(&row, "shapes")?,
                    clockwise: count(&row, "clockwise")?,
                    counter_clockwise: count(&row, "counter_clockwise")?,
                    fitted: count(&row, "fitted")?,
                })
            })
        })
    }

    /// Some of the shapes of a cohort whose direction is not known, in storage order after a place.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Corrupt`].
    pub fn undirected<'a>(
        &'a self,
        cohort_id: &'a str,
        after: Option<Cursor>,
    ) -> Answer<'a, Vec<Unmeasured>> {
        Box::pin(async move {
            const NEXT: &str = "SELECT s.chunk_id, s.position FROM chunk AS c
                CROSS JOIN shape AS s ON s.chunk_id = c.id
                WHERE c.cohort = $1 AND c.revision IS NOT NULL AND c.id >= $2
                AND (s.chunk_id > $2 OR s.position > $3) AND s.clockwise IS NULL
                ORDER BY c.id, s.position LIMIT $4";
            let after = after.map_or((0, -1), |c| (c.chunk, c.position));
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let rows = sql(&mut read, NEXT).bind(cohort).bind(after.0).bind(after.1).bind(DIRECTED_AT_ONCE);
            let rows = rows.all().await?;
            unmeasured_at(&mut read, &rows).await
        })
    }

    /// Keeps the directions of shapes that had none: whether each runs clockwise.
    ///
    /// # Errors
    /// Database errors.
    pub fn keep_directions<'a>(&'a self, directions: &'a [(Cursor, bool)]) -> Answer<'a, ()> {
        Box::pin(async move {
            const KEEP: &str = "UPDATE shape SET clockwise = $3
                WHERE chunk_id = $1 AND position = $2 AND clockwise IS NULL";
            let mut write = self.begin_write("directions").await?;
            for (place, clockwise) in directions {
                let keep = sql(&mut write, KEEP).bind(place.chunk).bind(place.position);
                keep.bind(i64::from(*clockwise)).execute().await?;
            }
            Ok(write.commit().await?)
        })
    }
}
