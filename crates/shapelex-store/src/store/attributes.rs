//! Attributes and measures of stored shapes, without their geometry.

use std::collections::BTreeSet;

use super::answer::Answer;
use super::blob::{self, Chunk};
use super::engine::{Row, sql, to_sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{Store, blocking};
use super::shapes::{Cursor, entry, from_json, read_measures};
use crate::domain::attribute::Attribute;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{ShapeDescription, ShapeMeasures};

/// Number of rows read at once.
const DESCRIBED_AT_ONCE: usize = 4096;

/// Number of shapes measured at once.
const MEASURED_AT_ONCE: i64 = 512;

/// A shape that has not been measured: a row of an earlier version.
#[derive(Debug, Clone, PartialEq)]
pub struct Unmeasured {
    /// Its place.
    pub place: Cursor,
    /// Control points, coordinate-major.
    pub control_points: Vec<f64>,
}

impl Store {
    /// Attributes of at most `limit` shapes between the revisions that pass the filter, in storage order.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn describe_shapes<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
        limit: usize,
    ) -> Answer<'a, Vec<ShapeDescription>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let (mut found, mut after): (Vec<ShapeDescription>, _) = (Vec::new(), (0, -1));
            // Rows take many times the memory of descriptions.
            loop {
                let selection = Selection { cohort, revisions, filter, after };
                let page = DESCRIBED_AT_ONCE.min(limit - found.len());
                let rows = selection.page(&mut read, entry!(), page).all().await?;
                let Some(last) = rows.last().filter(|_| page > 0) else { return Ok(found) };
                after = (last.get("chunk_id")?, last.get("position")?);
                let described =
                    move || rows.iter().map(read_description).collect::<Result<Vec<_>, StoreError>>();
                found.extend(blocking(described).await?);
            }
        })
    }

    /// Whether a shape of the cohort between the revisions has the attribute.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn has_attribute<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        attribute: &'a Attribute,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            let filter = ShapeFilter { has: [attribute.clone()].into(), ..ShapeFilter::default() };
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let selection = Selection { cohort, revisions, filter: &filter, after: (0, -1) };
            Ok(selection.page(&mut read, "s.position", 1).optional().await?.is_some())
        })
    }

    /// Names of the attributes that shapes of the cohort have: `label`, `subject` and `labels.<attribute>`. Cost: one pass
    /// over the attributes of all shapes.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn attribute_names<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
    ) -> Answer<'a, BTreeSet<String>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let all = ShapeFilter::default();
            let selection = Selection { cohort, revisions, filter: &all, after: (0, -1) };
            let mut names = BTreeSet::new();
            for row in selection.attribute_names(&mut read).all().await? {
                let name: String = row.get("name")?;
                names.insert(format!("labels.{name}"));
            }
            for (name, given) in [("label", "count(s.label)"), ("subject", "count(s.subject)")] {
                let count: i64 = selection.select(&mut read, given).scalar().await?;
                if count > 0 {
                    names.insert(name.into());
                }
            }
            Ok(names)
        })
    }

    /// The next shapes between the revisions, in storage order, with their places; at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn describe_after<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        after: Option<Cursor>,
        limit: usize,
    ) -> Answer<'a, Vec<(Cursor, ShapeDescription)>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let (filter, after) =
                (ShapeFilter::everything(), after.map_or((0, -1), |c| (c.chunk, c.position)));
            let selection = Selection { cohort, revisions, filter: &filter, after };
            let rows = selection.page(&mut read, entry!(), limit).all().await?;
            let described = |row: &Row| {
                let place = Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? };
                Ok((place, read_description(row)?))
            };
            blocking(move || rows.iter().map(described).collect()).await
        })
    }

    /// Some of the shapes that have not been measured.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Corrupt`].
    pub fn unmeasured<'a>(&'a self, cohort_id: &'a str) -> Answer<'a, Vec<Unmeasured>> {
        Box::pin(async move {
            const NEXT: &str = "SELECT s.chunk_id, s.position FROM shape AS s
                CROSS JOIN chunk AS c ON c.id = s.chunk_id
                WHERE s.cohort = $1 AND s.centroid_size IS NULL AND s.deleted_revision IS NULL
                AND c.revision IS NOT NULL ORDER BY s.chunk_id, s.position LIMIT $2";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let rows = sql(&mut read, NEXT).bind(cohort).bind(MEASURED_AT_ONCE).all().await?;
            let place = |row: &Row| -> Result<Cursor, StoreError> {
                Ok(Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? })
            };
            let places: Vec<Cursor> = rows.iter().map(place).collect::<Result<_, _>>()?;
            let mut found = Vec::with_capacity(places.len());
            for of_chunk in places.chunk_by(|a, b| a.chunk == b.chunk) {
                let row = blob::load(&mut read, &[of_chunk[0].chunk]).await?.pop();
                let row = row.ok_or(StoreError::Corrupt { chunk: of_chunk[0].chunk })?;
                let chunk = Chunk::verified(&row)?;
                for &place in of_chunk {
                    let position = usize::try_from(place.position).unwrap_or(usize::MAX);
                    found.push(Unmeasured { place, control_points: chunk.shape(position)?.1 });
                }
            }
            Ok(found)
        })
    }

    /// Keeps the measures of shapes that had none.
    ///
    /// # Errors
    /// Database errors.
    pub fn keep_measures<'a>(&'a self, measured: &'a [(Cursor, ShapeMeasures)]) -> Answer<'a, ()> {
        Box::pin(async move {
            const KEEP: &str =
                "UPDATE shape SET points = $3, centroid_size = $4, length = $5, area = $6, volume = $7,
                self_intersecting = $8 WHERE chunk_id = $1 AND position = $2 AND centroid_size IS NULL";
            let mut write = self.begin_write("measures").await?;
            for (place, measures) in measured {
                sql(&mut write, KEEP)
                    .bind(place.chunk)
                    .bind(place.position)
                    .bind(measures.points.map(to_sql))
                    .bind(measures.centroid_size)
                    .bind(measures.length)
                    .bind(measures.area)
                    .bind(measures.volume)
                    .bind(measures.self_intersecting.map(i64::from))
                    .execute()
                    .await?;
            }
            Ok(write.commit().await?)
        })
    }
}

fn read_description(row: &Row) -> Result<ShapeDescription, StoreError> {
    Ok(ShapeDescription {
        id: row.get("id")?,
        external_id: row.get("external_id")?,
        subject: row.get("subject")?,
        label: row.get("label")?,
        labels: from_json(row.get("labels")?)?.unwrap_or_default(),
        measures: read_measures(row)?,
        created_at_ms: row.get("created_at_ms")?,
    })
}
