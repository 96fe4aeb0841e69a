//! Assessments that are stored beside the shapes of a cohort.

use serde_json::{Map, Value};

#[cfg(feature = "schema")]
use super::assessments::AssessedStored;
use crate::domain::filter::ShapeFilter;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{FilterPlace, refuse_unknown};
use crate::service::cohorts::{catalogue, measures};
use crate::store::{AssessmentListing, StoredAssessment};
use crate::wire::time::rfc3339;

/// Size of a page at which it ends.
const PAGE_BYTES: usize = 8 << 20;
/// Assessments that are read between two looks at the size.
const STEP: usize = 64;

/// Content of a list.
#[derive(Debug, Clone)]
pub struct StoredListing {
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Id, `name@version`, `name@alias` or name of a dictionary; `None` for all.
    pub dictionary: Option<String>,
    /// Accepted class; `None` for all.
    pub class: Option<String>,
    /// Whether the shapes are outliers; `None` for all.
    pub is_outlier: Option<bool>,
    /// Position after which the page starts.
    pub cursor: Option<String>,
    /// Maximum number of assessments.
    pub limit: usize,
}

/// An assessment that is stored beside a shape.
#[derive(Debug, serde::Serialize, utoipa::ToSchema)]
pub struct StoredAssessmentOutput {
    #[serde(flatten)]
    #[schema(value_type = AssessedStored)]
    assessed: Map<String, Value>,
    /// Revision of the cohort at which the shape was assessed.
    cohort_revision: u64,
    /// Time of the assessment, RFC 3339 in UTC.
    assessed_at: String,
}

/// A page of the assessments stored beside the shapes of a cohort, and the cursor of the next one.
///
/// # Errors
/// A cohort or dictionary that does not exist; an invalid cursor; an attribute that no shape has.
pub async fn list(
    app: &App,
    key: &str,
    listing: &StoredListing,
) -> Result<(Vec<StoredAssessmentOutput>, Option<String>), ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    let dictionary = match &listing.dictionary {
        None => None,
        Some(key) => {
            let not_found = || ServiceError::NotFound { kind: "dictionary", key: key.clone() };
            Some(app.store.find_dictionary_id(key).await?.ok_or_else(not_found)?)
        }
    };
    let cursor = listing.cursor.as_deref().map(|cursor| cursor.split_once('/'));
    let mut after: Option<(String, String)> = match cursor {
        None => None,
        Some(Some((dictionary, shape))) => Some((dictionary.to_owned(), shape.to_owned())),
        Some(None) => return Err(ServiceError::foreign_cursor()),
    };
    measures::complete_for(app, &cohort, &listing.filter).await?;
    let (mut rows, mut bytes): (Vec<StoredAssessment>, usize) = (Vec::new(), 0);
    let has_more = loop {
        let limit = STEP.min(listing.limit + 1 - rows.len());
        let wanted = AssessmentListing {
            filter: &listing.filter,
            dictionary: dictionary.as_deref(),
            class: listing.class.as_deref(),
            is_outlier: listing.is_outlier,
            after: after.as_ref().map(|(dictionary, shape)| (dictionary.as_str(), shape.as_str())),
            limit,
        };
        let found = app.store.list_assessments(&cohort.id, &wanted).await?;
        let is_last = found.len() < limit;
        bytes += found.iter().map(|row| row.body.len()).sum::<usize>();
        rows.extend(found);
        after = rows.last().map(|row| (row.dictionary.clone(), row.shape.clone()));
        if is_last || bytes > PAGE_BYTES || rows.len() > listing.limit {
            break !is_last;
        }
    };
    if rows.is_empty() && listing.cursor.is_none() {
        refuse_unknown(app, &cohort, &listing.filter, FilterPlace::Query).await?;
    }
    rows.truncate(listing.limit);
    let next = rows.last().filter(|_| has_more).map(|row| format!("{}/{}", row.dictionary, row.shape));
    Ok((rows.into_iter().map(output).collect::<Result<_, _>>()?, next))
}

fn output(row: StoredAssessment) -> Result<StoredAssessmentOutput, ServiceError> {
    let damaged = |error| ServiceError::Internal(format!("a stored assessment is not JSON: {error}"));
    let mut assessed: Map<String, Value> = serde_json::from_str(&row.body).map_err(damaged)?;
    assessed.insert("id".into(), row.shape.into());
    if let Some(external_id) = row.external_id {
        assessed.insert("external_id".into(), external_id.into());
    }
    Ok(StoredAssessmentOutput { assessed, cohort_revision: row.revision, assessed_at: rfc3339(row.at_ms) })
}
