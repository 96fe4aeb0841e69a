//! Shapes of a cohort: find, list, count, delete.

use serde::de::IgnoredAny;

use super::answer::Answer;
use super::blob::{self, Chunk};
use super::changes;
use super::engine::{Row, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{Store, blocking};
use super::order::{Cursor, ListCursor, Order, SortKey};
use shapelex_analysis::conversion::Beginning;

use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{FitResidual, Shape, ShapeAttributes, ShapeMeasures};

/// Page of shapes in storage order.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapePage {
    /// Shapes of the page.
    pub shapes: Vec<Shape>,
    /// Start of the next page, if there is one.
    pub next: Option<ListCursor>,
}

/// Selection of a list of shapes.
#[derive(Debug, Clone)]
pub struct Listing<'a> {
    /// Revisions between which the shapes are in the cohort.
    pub revisions: Revisions,
    /// Filter that the shapes pass.
    pub filter: &'a ShapeFilter,
    /// Order of the list. Default: storage order.
    pub order: Option<&'a Order>,
    /// Position after which the page starts.
    pub after: Option<ListCursor>,
    /// Maximum number of shapes.
    pub limit: usize,
    /// Whether weights and control points are read.
    pub geometry: bool,
}

impl<'a> Listing<'a> {
    /// The first `limit` shapes that pass the filter, with their geometry, in storage order.
    pub fn first(filter: &'a ShapeFilter, limit: usize) -> Self {
        Self { revisions: Revisions::latest(), filter, order: None, after: None, limit, geometry: true }
    }
}

/// Columns of a description: without metadata, which are many times larger.
macro_rules! described {
    () => {
        "s.chunk_id, s.position, s.id, s.external_id, s.subject, s.label, s.labels,
        coalesce(s.first_stored_ms, c.created_at_ms) AS created_at_ms,
        s.points, s.centroid_size, s.length, s.area, s.volume, s.self_intersecting, s.clockwise,
        s.fit_mean, s.fit_largest, s.fit_area, s.given_start, s.given_reversed"
    };
}
pub(super) use described;

/// Columns that [`read_entry`] reads.
macro_rules! entry {
    () => {
        concat!("s.metadata, ", described!())
    };
}

impl Store {
    /// Finds the shape with this id, or else with this external id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`].
    pub fn find_shape<'a>(&'a self, cohort_id: &'a str, key: &'a str) -> Answer<'a, Option<Shape>> {
        Box::pin(async move { Ok(self.find_placed(cohort_id, key).await?.map(|(_, shape)| shape)) })
    }

    /// The same, with the place of the shape in storage.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`].
    pub fn find_placed<'a>(
        &'a self,
        cohort_id: &'a str,
        key: &'a str,
    ) -> Answer<'a, Option<(Cursor, Shape)>> {
        Box::pin(async move {
            const BY_ID: &str = concat!(
                "SELECT ",
                entry!(),
                " FROM shape AS s JOIN chunk AS c ON c.id = s.chunk_id
                JOIN cohort AS h ON h.number = s.cohort
                WHERE s.id = $2 AND h.id = $1 AND s.deleted_revision IS NULL AND c.revision IS NOT NULL"
            );
            const BY_EXTERNAL_ID: &str = concat!(
                "SELECT ",
                entry!(),
                " FROM cohort AS h JOIN shape AS s ON s.cohort = h.number
                JOIN chunk AS c ON c.id = s.chunk_id
                WHERE h.id = $1 AND s.external_id = $2 AND s.deleted_revision IS NULL
                AND c.revision IS NOT NULL"
            );
            let mut read = self.begin_read().await?;
            for query in [BY_ID, BY_EXTERNAL_ID] {
                let row = sql(&mut read, query).bind(cohort_id).bind(key).optional().await?;
                if let Some(row) = row {
                    let entry = read_entry(&row)?;
                    let place = entry.place;
                    return Ok(fill(&mut read, vec![entry]).await?.pop().map(|shape| (place, shape)));
                }
            }
            Ok(None)
        })
    }

    /// Finds the shapes with these ids, or else with these external ids, in the order of the keys.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`].
    pub fn find_shapes<'a>(
        &'a self,
        cohort_id: &'a str,
        keys: &'a [String],
    ) -> Answer<'a, Vec<Option<Shape>>> {
        Box::pin(async move {
            const BY_ID: &str = concat!(
                "SELECT asked.key AS place, ",
                entry!(),
                " FROM json_each($2) AS asked
                CROSS JOIN shape AS s ON s.id = asked.value
                CROSS JOIN chunk AS c ON c.id = s.chunk_id
                CROSS JOIN cohort AS h ON h.number = s.cohort
                WHERE h.id = $1 AND s.deleted_revision IS NULL AND c.revision IS NOT NULL"
            );
            const BY_EXTERNAL_ID: &str = concat!(
                "SELECT asked.key AS place, ",
                entry!(),
                " FROM cohort AS h CROSS JOIN json_each($2) AS asked ON true
                CROSS JOIN shape AS s ON s.cohort = h.number AND s.external_id = asked.value
                CROSS JOIN chunk AS c ON c.id = s.chunk_id
                WHERE h.id = $1 AND s.deleted_revision IS NULL AND c.revision IS NOT NULL"
            );
            let asked = serde_json::Value::from(keys).to_string();
            let mut read = self.begin_read().await?;
            let mut found: Vec<Option<Entry>> = keys.iter().map(|_| None).collect();
            for query in [BY_ID, BY_EXTERNAL_ID] {
                for row in sql(&mut read, query).bind(cohort_id).bind(&asked).all().await? {
                    let place = usize::try_from(row.get::<i64>("place")?).unwrap_or(usize::MAX);
                    if let Some(slot) = found.get_mut(place).filter(|slot| slot.is_none()) {
                        *slot = Some(read_entry(&row)?);
                    }
                }
            }
            let is_found: Vec<bool> = found.iter().map(Option::is_some).collect();
            let mut shapes =
                in_their_order(&mut read, found.into_iter().flatten().collect()).await?.into_iter();
            Ok(is_found.into_iter().map(|found| if found { shapes.next() } else { None }).collect())
        })
    }

    /// A page of current shapes; shorter than asked for if their attributes take some megabytes.
    ///
    /// Memory grows only with the page. Cost in the order of an attribute: one pass over the shapes.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`] if there is no such cohort, [`StoreError::Corrupt`].
    pub fn list_shapes<'a>(&'a self, cohort_id: &'a str, listing: &'a Listing<'a>) -> Answer<'a, ShapePage> {
        Box::pin(async move {
            let Listing { revisions, filter, order, after, limit, geometry } = listing;
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let after_place =
                after.as_ref().map_or((0, -1), |cursor| (cursor.place.chunk, cursor.place.position));
            let selection = Selection { cohort, revisions: *revisions, filter, after: (0, -1) };
            let (entries, next) = match order {
                None => {
                    stored_entries(&mut read, Selection { after: after_place, ..selection }, *limit).await?
                }
                Some(order) => ordered_entries(&mut read, selection, order, after.as_ref(), *limit).await?,
            };
            Ok(ShapePage { next, shapes: shapes_of(&mut read, entries, *geometry).await? })
        })
    }

    /// Last revision of the cohort that only contains shapes added by the time `ms`.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn revision_before<'a>(&'a self, cohort_id: &'a str, ms: i64) -> Answer<'a, u64> {
        Box::pin(async move {
            const FIRST_AFTER: &str =
                "SELECT min(revision) FROM chunk WHERE cohort = $1 AND created_at_ms > $2";
            const LAST: &str = "SELECT revision FROM cohort WHERE number = $1";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let after: Option<i64> = sql(&mut read, FIRST_AFTER).bind(cohort).bind(ms).scalar().await?;
            let last: i64 = sql(&mut read, LAST).bind(cohort).scalar().await?;
            Ok(from_sql(after.map_or(last, |revision| revision - 1)))
        })
    }

    /// Number of shapes of the cohort between the revisions that pass the filter.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn count<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
    ) -> Answer<'a, u64> {
        Box::pin(async move {
            const ALL: &str = "SELECT
                (SELECT CAST(coalesce(sum(rows), 0) AS BIGINT) FROM chunk WHERE cohort = $1 AND revision <= $2) -
                (SELECT count(*) FROM shape WHERE cohort = $1 AND deleted_revision <= $2)";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let count: i64 = if filter.is_everything() && revisions.after == 0 {
                let all = sql(&mut read, ALL).bind(cohort).bind(to_sql(revisions.until));
                all.scalar().await?
            } else {
                let selection = Selection { cohort, revisions, filter, after: (0, -1) };
                selection.select(&mut read, "count(*)").scalar().await?
            };
            Ok(from_sql(count))
        })
    }

    /// Number of shapes of the cohort at the revision `revisions.after` that pass the filter and were deleted by the
    /// revision `revisions.until`.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn count_deleted<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
    ) -> Answer<'a, u64> {
        Box::pin(async move {
            let Revisions { after, until } = revisions;
            let before = self.count(cohort_id, Revisions::until(after), filter).await?;
            let still = self.count(cohort_id, Revisions::until(until), filter).await?;
            Ok((before + self.count(cohort_id, revisions, filter).await?).saturating_sub(still))
        })
    }

    /// Deletes a shape by its id; returns the new revision, or `None` if there is no such shape.
    ///
    /// Scans at earlier revisions still see it.
    ///
    /// # Errors
    /// Database errors.
    pub fn delete_shape<'a>(
        &'a self,
        cohort_id: &'a str,
        shape_id: &'a str,
        now_ms: i64,
    ) -> Answer<'a, Option<u64>> {
        Box::pin(async move {
            let mut write = self.begin_write(cohort_id).await?;
            let Some(revision) = mark_deleted(&mut write, cohort_id, shape_id).await? else {
                return Ok(None);
            };
            const UPDATE: &str = "UPDATE cohort
                SET revision = $2, shapes = shapes - 1, updated_at_ms = $3 WHERE id = $1";
            sql(&mut write, UPDATE).bind(cohort_id).bind(revision).bind(now_ms).execute().await?;
            let change =
                NewChange::for_shape(ChangeKind::ShapeDeleted, shape_id, cohort_id, from_sql(revision));
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(Some(from_sql(revision)))
        })
    }
}

/// Marks a visible shape as deleted by the next revision of its cohort, and returns that revision.
async fn mark_deleted(
    write: &mut Transaction,
    cohort_id: &str,
    shape_id: &str,
) -> Result<Option<i64>, StoreError> {
    const MARK: &str = "UPDATE shape
        SET deleted_revision = (SELECT revision + 1 FROM cohort WHERE id = $1)
        WHERE id = $2 AND deleted_revision IS NULL
        AND cohort = (SELECT number FROM cohort WHERE id = $1)
        AND (SELECT revision FROM chunk WHERE chunk.id = shape.chunk_id) IS NOT NULL
        RETURNING deleted_revision";
    Ok(sql(&mut *write, MARK).bind(cohort_id).bind(shape_id).optional_scalar().await?)
}

/// Bytes of attributes after which a page ends.
const PAGE_BYTES: usize = 4 << 20;
/// Number of rows of a page held in memory at once.
const ROWS: usize = 100;

/// A shape whose weight and control points have not been read yet.
struct Entry {
    place: Cursor,
    shape: Shape,
}

impl Entry {
    /// Size of its unbounded attributes.
    fn bytes(&self) -> usize {
        self.shape.attributes.metadata.as_ref().map_or(0, String::len)
    }
}

pub(super) fn read_attributes(row: &Row) -> Result<ShapeAttributes, StoreError> {
    Ok(ShapeAttributes {
        external_id: row.get("external_id")?,
        subject: row.get("subject")?,
        label: row.get("label")?,
        labels: from_json(row.get("labels")?)?.unwrap_or_default(),
        weight: 1.0,
        metadata: json_text(row.get("metadata")?)?,
    })
}

/// Stored text, if it is valid JSON.
fn json_text(text: Option<&str>) -> Result<Option<String>, StoreError> {
    from_json::<IgnoredAny>(text).map(|_| text.map(str::to_owned))
}

/// Reads the measures of a shape, which are empty until it has been measured.
pub(super) fn read_measures(row: &Row) -> Result<ShapeMeasures, StoreError> {
    let flag = |name: &str| Ok::<_, StoreError>(row.get::<Option<i64>>(name)?.map(|flag| flag != 0));
    let fit = match (row.get("fit_mean")?, row.get("fit_largest")?, row.get("fit_area")?) {
        (Some(mean), Some(largest), Some(area)) => Some(FitResidual { mean, largest, area }),
        _ => None,
    };
    let beginning = row.get::<Option<f64>>("given_start")?.zip(flag("given_reversed")?);
    Ok(ShapeMeasures {
        points: row.get::<Option<i64>>("points")?.map(from_sql),
        centroid_size: row.get("centroid_size")?,
        length: row.get("length")?,
        area: row.get("area")?,
        volume: row.get("volume")?,
        self_intersecting: flag("self_intersecting")?,
        clockwise: flag("clockwise")?,
        fit,
        beginning: beginning.map(|(start, reversed)| Beginning { start, reversed }),
    })
}

fn read_entry(row: &Row) -> Result<Entry, StoreError> {
    let attributes = read_attributes(row)?;
    Ok(Entry {
        place: Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? },
        shape: Shape {
            id: row.get("id")?,
            attributes,
            measures: read_measures(row)?,
            control_points: Vec::new(),
            created_at_ms: row.get("created_at_ms")?,
        },
    })
}

pub(super) fn from_json<T: serde::de::DeserializeOwned>(text: Option<&str>) -> Result<Option<T>, StoreError> {
    let Some(text) = text else { return Ok(None) };
    let value = serde_json::from_str(text)
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable attributes: {e}") })?;
    Ok(Some(value))
}

/// Entries of the next shapes in storage order, and the position after them if there are more.
async fn stored_entries(
    read: &mut Transaction,
    mut selection: Selection<'_>,
    limit: usize,
) -> Result<(Vec<Entry>, Option<ListCursor>), StoreError> {
    // A filter may scan every shape of the cohort, so it is applied in a single query.
    let rows_at_once = if selection.filter.is_everything() { ROWS } else { limit };
    let (mut entries, mut bytes, mut more) = (Vec::new(), 0, true);
    while more && entries.len() < limit && bytes < PAGE_BYTES {
        let wanted = (limit - entries.len()).min(rows_at_once);
        let rows = selection.page(read, entry!(), wanted + 1).all().await?;
        more = rows.len() > wanted;
        for row in rows.iter().take(wanted) {
            if bytes >= PAGE_BYTES {
                more = true;
                break;
            }
            let entry = read_entry(row)?;
            bytes += entry.bytes();
            selection.after = (entry.place.chunk, entry.place.position);
            entries.push(entry);
        }
    }
    let next = entries.last().map(|entry: &Entry| entry.place).filter(|_| more);
    Ok((entries, next.map(|place| ListCursor { place, key: None })))
}

/// The same in the order of an attribute.
async fn ordered_entries(
    read: &mut Transaction,
    selection: Selection<'_>,
    order: &Order,
    after: Option<&ListCursor>,
    limit: usize,
) -> Result<(Vec<Entry>, Option<ListCursor>), StoreError> {
    let rows = selection.ordered(read, entry!(), order, after, limit + 1).all().await?;
    let (mut entries, mut bytes, mut next) = (Vec::new(), 0, None);
    for row in rows.iter().take(limit) {
        if bytes >= PAGE_BYTES {
            break;
        }
        let entry = read_entry(row)?;
        bytes += entry.bytes();
        next = Some(ListCursor { place: entry.place, key: Some(SortKey::read(row)?) });
        entries.push(entry);
    }
    let more = rows.len() > entries.len();
    Ok((entries, next.filter(|_| more)))
}

/// The shapes of entries, with weights and control points if wanted.
async fn shapes_of(
    connection: &mut Transaction,
    entries: Vec<Entry>,
    geometry: bool,
) -> Result<Vec<Shape>, StoreError> {
    if geometry {
        return in_their_order(connection, entries).await;
    }
    Ok(entries.into_iter().map(|entry| entry.shape).collect())
}

/// Fills entries in any order, each chunk read once.
async fn in_their_order(connection: &mut Transaction, entries: Vec<Entry>) -> Result<Vec<Shape>, StoreError> {
    let mut entries: Vec<(usize, Entry)> = entries.into_iter().enumerate().collect();
    entries.sort_by_key(|(_, entry)| (entry.place.chunk, entry.place.position));
    let (order, entries): (Vec<usize>, Vec<Entry>) = entries.into_iter().unzip();
    let mut shapes: Vec<(usize, Shape)> = order.into_iter().zip(fill(connection, entries).await?).collect();
    shapes.sort_by_key(|(index, _)| *index);
    Ok(shapes.into_iter().map(|(_, shape)| shape).collect())
}

/// Reads weights and control points, with one chunk in memory at a time.
async fn fill(connection: &mut Transaction, mut entries: Vec<Entry>) -> Result<Vec<Shape>, StoreError> {
    let mut filled = Vec::with_capacity(entries.len());
    while let Some(first) = entries.first() {
        let chunk = first.place.chunk;
        let others = entries.iter().position(|e| e.place.chunk != chunk);
        let rest = entries.split_off(others.unwrap_or(entries.len()));
        let row = blob::load(connection, &[chunk]).await?.pop();
        let row = row.ok_or(StoreError::Corrupt { chunk })?;
        filled.extend(blocking(move || fill_from(&row, entries)).await?);
        entries = rest;
    }
    Ok(filled)
}

/// Digests of the control points of shapes of one chunk, as they are stored.
pub(super) async fn points_digests(
    connection: &mut Transaction,
    places: Vec<Cursor>,
) -> Result<Vec<blake3::Hash>, StoreError> {
    let Some(chunk) = places.first().map(|place| place.chunk) else { return Ok(Vec::new()) };
    let row = blob::load(connection, &[chunk]).await?.pop().ok_or(StoreError::Corrupt { chunk })?;
    let digests = move || {
        let chunk = Chunk::verified(&row)?;
        let digest = |place: Cursor| {
            let position = usize::try_from(place.position).unwrap_or(usize::MAX);
            chunk.shape(position).map(|(_, points)| blake3::hash(&blob::bytes_of(&points)))
        };
        places.into_iter().map(digest).collect::<Result<Vec<_>, StoreError>>()
    };
    blocking(digests).await
}

fn fill_from(row: &Row, entries: Vec<Entry>) -> Result<Vec<Shape>, StoreError> {
    let chunk = Chunk::verified(row)?;
    let fill = |Entry { place, mut shape }: Entry| {
        let position = usize::try_from(place.position).unwrap_or(usize::MAX);
        (shape.attributes.weight, shape.control_points) = chunk.shape(position)?;
        Ok(shape)
    };
    entries.into_iter().map(fill).collect()
}
