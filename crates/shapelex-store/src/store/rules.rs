//! Rules of cohorts: correspondence, direction and mirror images, which may change with a revision.
//!
//! As for corrections, rows are only ever ended: shapes that another rule stores otherwise are stored again, under their ids. Results
//! for an earlier revision are computed again by the rule of that revision, which the cohort keeps.

use super::answer::Answer;
use super::changes;
use super::cohorts::name_taken;
use super::engine::{Transaction, sql, to_sql};
use super::error::StoreError;
use super::handle::{Store, blocking};
use super::text::to_text;
use super::upload::{ShapeRow, WholeCohort};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::cohort::Cohort;

impl Store {
    /// Stores the properties of a cohort as its next revision, if it is still at `cohort.revision`, and with them all of its shapes
    /// again, each with its time of creation, if `shapes` has them.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], [`StoreError::CohortGone`]; [`StoreError::Changed`] also if the cohort has another number of shapes.
    pub fn change_rule<'a>(
        &'a self,
        cohort: &'a Cohort,
        shapes: Option<Vec<(ShapeRow, i64)>>,
        now_ms: i64,
    ) -> Answer<'a, ()> {
        Box::pin(async move {
            let width = cohort.spec.representation.size() * cohort.spec.representation.dimension();
            let (rows, created): (Vec<ShapeRow>, Vec<i64>) = shapes.into_iter().flatten().unzip();
            let rewrites = !rows.is_empty();
            let whole = blocking(move || WholeCohort::new(rows, width)).await?;
            let mut write = self.begin_write(&cohort.id).await?;
            let number = self.number_at(&mut write, &cohort.id, Some(cohort.revision)).await?;
            let revision = to_sql(cohort.revision + 1);
            if rewrites {
                let upload = self.inner.replica.owned_id();
                store_again(&mut write, (number, revision, now_ms), &upload, (&whole, &created)).await?;
            }
            self.set_properties(&mut write, number, cohort, now_ms).await?;
            let change = NewChange::for_cohort(ChangeKind::CohortUpdated, &cohort.id, cohort.revision + 1);
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            Ok(write.commit().await?)
        })
    }

    async fn set_properties(
        &self,
        write: &mut Transaction,
        number: i64,
        cohort: &Cohort,
        now_ms: i64,
    ) -> Result<(), StoreError> {
        const UPDATE: &str = "UPDATE cohort SET name = $2, handle = $3, description = $4, length_unit = $5,
            correspondence = $6, direction = $7, mirror = $8, former_rules = $9, revision = revision + 1,
            updated_at_ms = $10 WHERE number = $1";
        let spec = &cohort.spec;
        let updated = sql(write, UPDATE)
            .bind(number)
            .bind(&spec.name)
            .bind(self.handle(&spec.name))
            .bind(&spec.description)
            .bind(&spec.length_unit)
            .bind(to_text(&spec.correspondence))
            .bind(to_text(&spec.direction))
            .bind(to_text(&spec.mirror))
            .bind(to_text(&cohort.former_rules))
            .bind(now_ms)
            .execute()
            .await;
        updated.map_err(|error| name_taken(error, &spec.name))?;
        Ok(())
    }
}

/// Ends all living rows of a cohort with a revision, and stores the shapes again as that revision.
async fn store_again(
    write: &mut Transaction,
    (cohort, revision, now_ms): (i64, i64, i64),
    upload: &str,
    (whole, created): (&WholeCohort, &[i64]),
) -> Result<(), StoreError> {
    const END: &str = "UPDATE shape SET deleted_revision = $2 WHERE cohort = $1 AND deleted_revision IS NULL
        AND chunk_id IN (SELECT id FROM chunk WHERE cohort = $1 AND revision IS NOT NULL)";
    const SHOW: &str = "UPDATE chunk SET revision = $2, created_at_ms = $3
        WHERE upload = $1 AND revision IS NULL";
    const AGE: &str = "UPDATE shape SET first_stored_ms = $3 WHERE chunk_id = $1 AND position = $2";
    let ended = sql(&mut *write, END).bind(cohort).bind(revision).execute().await?;
    if ended != created.len() as u64 {
        return Err(StoreError::Changed);
    }
    let places = whole.insert(&mut *write, cohort, upload).await?;
    for ((chunk, position), created) in places.into_iter().zip(created) {
        sql(&mut *write, AGE).bind(chunk).bind(position).bind(*created).execute().await?;
    }
    sql(write, SHOW).bind(upload).bind(revision).bind(now_ms).execute().await?;
    Ok(())
}
