//! Attributes and measures of stored shapes, without their geometry.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde_json::Value;

use super::answer::Answer;
use super::blob::{self, Chunk};
use super::engine::{Row, Transaction, sql, to_sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{Store, blocking};
use super::order::Cursor;
use super::shapes::{described, from_json, read_measures};
use crate::domain::attribute::{Attribute, Measure};
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{MAX_NAMES, ShapeDescription, ShapeMeasures};

/// Number of rows read at once.
const DESCRIBED_AT_ONCE: usize = 4096;

/// Number of chunks whose values are read at once.
const CHUNKS_WITH_VALUES: usize = 64;

/// Number of shapes measured at once.
const MEASURED_AT_ONCE: i64 = 512;

/// Values of some attributes of consecutive shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct ValuesPage {
    /// Place of each shape.
    pub places: Vec<Cursor>,
    /// Values of each shape, one for each attribute; null where there is none.
    pub values: Vec<Vec<Value>>,
}

/// A shape that has not been measured: a row of an earlier version.
#[derive(Debug, Clone, PartialEq)]
pub struct Unmeasured {
    /// Its place.
    pub place: Cursor,
    /// Control points, coordinate-major.
    pub control_points: Vec<f64>,
}

/// Names of further attributes that shapes bring to a cohort.
#[derive(Debug, Clone)]
pub struct NewNames {
    /// Names that shapes of the cohort have; some may be those of shapes that are gone.
    pub known: Arc<BTreeSet<String>>,
    /// Revision up to which they are known.
    pub until: u64,
    /// Names that the shapes bring.
    pub brought: BTreeSet<String>,
}

impl NewNames {
    /// Number of the names of the cohort with those that are brought, if one of these is new.
    pub fn count(&self) -> Option<usize> {
        let fresh = self.brought.iter().filter(|name| !self.known.contains(*name)).count();
        (fresh > 0).then_some(self.known.len() + fresh)
    }

    /// Checks within the transaction that stores the shapes: others may have brought names since.
    pub(super) async fn check(&self, write: &mut Transaction, cohort: i64) -> Result<(), StoreError> {
        let since = Revisions { after: self.until, ..Revisions::latest() };
        let later = names(write, cohort, since, MAX_NAMES + 1).await?;
        let known = Arc::new(self.known.union(&later).cloned().collect());
        match (Self { known, ..self.clone() }).count() {
            Some(found) if found > MAX_NAMES => Err(StoreError::TooManyNames { found }),
            _ => Ok(()),
        }
    }
}

/// Names of the further attributes of the shapes of a cohort, at most `limit`.
async fn names(
    read: &mut Transaction,
    cohort: i64,
    revisions: Revisions,
    limit: usize,
) -> Result<BTreeSet<String>, StoreError> {
    let all = ShapeFilter::default();
    let selection = Selection { cohort, revisions, filter: &all, after: (0, -1) };
    let rows = selection.attribute_names(read, limit).all().await?;
    rows.iter().map(|row| Ok(row.get("name")?)).collect()
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
                let rows = selection.page(&mut read, described!(), page).all().await?;
                let Some(last) = rows.last().filter(|_| page > 0) else { return Ok(found) };
                after = (last.get("chunk_id")?, last.get("position")?);
                let described =
                    move || rows.iter().map(read_description).collect::<Result<Vec<_>, StoreError>>();
                found.extend(blocking(described).await?);
            }
        })
    }

    /// Values of some attributes of the next shapes between the revisions that pass the filter, in storage order; `None` behind the last.
    /// `after` is the last place of the page before.
    ///
    /// Cost: a pass over the attributes of the shapes; a page holds those of at most 64 chunks.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn values<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
        attributes: &'a [Attribute],
        after: Option<Cursor>,
    ) -> Answer<'a, Option<ValuesPage>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let after = after.map_or((0, -1), |place| (place.chunk, i64::MAX));
            let selection = Selection { cohort, revisions, filter, after };
            let rows = selection.values(&mut read, attributes, CHUNKS_WITH_VALUES).all().await?;
            let sizes: Vec<bool> = attributes.iter().map(is_written_as_text).collect();
            blocking(move || read_values(&rows, &sizes)).await
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

    /// Names of the further attributes that shapes of the cohort have, at most `limit`. Cost: one pass over the attributes of the
    /// shapes.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn further_names<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        limit: usize,
    ) -> Answer<'a, BTreeSet<String>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            names(&mut read, cohort, revisions, limit).await
        })
    }

    /// Names of the attributes that shapes of the cohort have: `label`, `subject` and at most `limit` `labels.<attribute>`. Cost:
    /// one pass over the attributes of all shapes.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn attribute_names<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        limit: usize,
    ) -> Answer<'a, BTreeSet<String>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let all = ShapeFilter::default();
            let selection = Selection { cohort, revisions, filter: &all, after: (0, -1) };
            let further = names(&mut read, cohort, revisions, limit).await?;
            let mut names: BTreeSet<String> = further.iter().map(|name| format!("labels.{name}")).collect();
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
            let rows = selection.page(&mut read, described!(), limit).all().await?;
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
            unmeasured_at(&mut read, &rows).await
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
                self_intersecting = $8, clockwise = $9
                WHERE chunk_id = $1 AND position = $2 AND centroid_size IS NULL";
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
                    .bind(measures.clockwise.map(i64::from))
                    .execute()
                    .await?;
            }
            Ok(write.commit().await?)
        })
    }
}

/// The shapes at the places of these rows, which are in storage order.
///
/// # Errors
/// [`StoreError::Corrupt`].
pub(super) async fn unmeasured_at(
    read: &mut Transaction,
    rows: &[Row],
) -> Result<Vec<Unmeasured>, StoreError> {
    let place = |row: &Row| -> Result<Cursor, StoreError> {
        Ok(Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? })
    };
    let places: Vec<Cursor> = rows.iter().map(place).collect::<Result<_, _>>()?;
    let mut found = Vec::with_capacity(places.len());
    for of_chunk in places.chunk_by(|a, b| a.chunk == b.chunk) {
        let row = blob::load(&mut *read, &[of_chunk[0].chunk]).await?.pop();
        let row = row.ok_or(StoreError::Corrupt { chunk: of_chunk[0].chunk })?;
        let chunk = Chunk::verified(&row)?;
        for &place in of_chunk {
            let position = usize::try_from(place.position).unwrap_or(usize::MAX);
            found.push(Unmeasured { place, control_points: chunk.shape(position)?.1 });
        }
    }
    Ok(found)
}

/// Whether values of an attribute are numbers that are read as texts.
fn is_written_as_text(attribute: &Attribute) -> bool {
    matches!(attribute, Attribute::Measure(measure) if !measure.is_flag() && *measure != Measure::Points)
}

/// The shapes of chunks with their values, of which some are numbers that are written as texts.
fn read_values(rows: &[Row], are_written: &[bool]) -> Result<Option<ValuesPage>, StoreError> {
    let mut page = ValuesPage { places: Vec::new(), values: Vec::new() };
    for row in rows {
        let (chunk, held): (i64, &str) = (row.get("chunk_id")?, row.get("held")?);
        let corrupt = |_| StoreError::Corrupt { chunk };
        let mut shapes: Vec<(i64, Vec<Value>)> = Vec::new();
        for mut values in serde_json::from_str::<Vec<Vec<Value>>>(held).map_err(corrupt)? {
            let position = (!values.is_empty()).then(|| values.remove(0)).and_then(|first| first.as_i64());
            for (value, _) in values.iter_mut().zip(are_written).filter(|(_, written)| **written) {
                let number = value.as_str().and_then(|text| text.parse::<f64>().ok());
                *value = number.map_or(Value::Null, Value::from);
            }
            shapes.push((position.ok_or(StoreError::Corrupt { chunk })?, values));
        }
        shapes.sort_unstable_by_key(|(position, _)| *position);
        for (position, values) in shapes {
            page.places.push(Cursor { chunk, position });
            page.values.push(values);
        }
    }
    Ok((!page.places.is_empty()).then_some(page))
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
