//! Corrections of stored shapes: attributes changed, shapes deleted by a filter, all shapes of a subject erased.

use std::time::Duration;

use serde_json::{Map, Value, json};

use super::attribute_names;
use super::attributes::refuse_misspelt;
use super::catalogue::{Expected, find_as_expected};
use super::{measures, subjects};
use crate::domain::cohort::Cohort;
use crate::domain::erasure::ErasureState;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{Shape, ShapeAttributes};
use crate::service::app::{App, Limits, ServiceError, now_ms};
use crate::service::jobs;
use crate::service::shapes::read;
use crate::store::{Deleted, Revisions, SubjectCohort};
use crate::wire::fault::Fault;
use crate::wire::merge_patch::{MergePatch, merge};
use crate::wire::shape::ShapeInput;

/// Fields of a shape that can be changed.
const FIELDS: [&str; 5] = ["label", "labels", "metadata", "subject", "weight"];
/// Fields that a stored shape keeps, with the reason.
const FIXED: [(&[&str], &str); 3] = [
    (
        &["points", "control_points", "normals", "poles", "closed", "landmarks", "landmark_index"],
        "expected no geometry: the points of a stored shape do not change; delete it and add another",
    ),
    (&["id", "external_id"], "expected no identifier: a stored shape keeps its identifiers"),
    (&["created_at", "measures"], "expected no field that the service sets"),
];
/// Object of the audit entry of a dry run.
const DRY_RUN: &str = "dry_run";
/// Longest time that an erasure waits for the files of the store to be written anew.
const REWRITING: Duration = Duration::from_secs(15);
/// Number of attempts when others correct the same shape at the same time.
pub(super) const ATTEMPTS: usize = 16;

/// Changes attributes of a shape by a merge patch of label, labels, subject, metadata and weight; the cohort must be at an
/// expected version. Returns the cohort and the shape after that. Without a difference nothing is stored.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort or the shape; all faults of the patch, and those that the shape would have; more names
/// of attributes than a cohort may have; [`ServiceError::Changed`].
pub async fn correct(
    app: &App,
    key: &str,
    shape: &str,
    patch: MergePatch,
    expected: Option<Expected>,
) -> Result<(Cohort, Shape), ServiceError> {
    let members = checked_members(patch)?;
    // The faults of the new values do not depend on the shape.
    patched(&app.limits, &ShapeAttributes { weight: 1.0, ..ShapeAttributes::default() }, &members)?;
    let cohort = find_as_expected(app, key, expected.as_ref()).await?;
    let revision = expected.map(|_| cohort.revision);
    for _ in 0..ATTEMPTS {
        let found = app.store.find_placed(&cohort.id, shape).await?;
        let (place, current) =
            found.ok_or_else(|| ServiceError::NotFound { kind: "shape", key: shape.into() })?;
        app.touched.note("shape_id", &current.id);
        let attributes = patched(&app.limits, &current.attributes, &members)?;
        if attributes == current.attributes {
            return Ok((cohort, current));
        }
        let brought = attributes.labels.keys().filter(|name| !current.attributes.labels.contains_key(*name));
        let names = attribute_names::admit(app, &cohort, brought.cloned().collect(), "/labels").await?;
        let corrected = Shape { attributes, ..current };
        let shape = (&corrected, names.as_ref());
        let stored = app.store.correct_shape(&cohort.id, revision, place, shape, now_ms()).await?;
        if let Some(revision) = stored {
            return Ok((Cohort { revision, ..cohort }, corrected));
        }
    }
    Err(ServiceError::Unavailable("the shape is being changed by others: try again".into()))
}

/// Beyond 2⁶⁴ the digits of a number are lost when a patch is read.
const OF_64_BITS: f64 = 18_446_744_073_709_551_616.0;

/// Members of a patch of a shape.
pub(super) fn checked_members(patch: MergePatch) -> Result<Map<String, Value>, ServiceError> {
    let MergePatch { members, mut faults } = patch;
    for name in members.keys().filter(|name| !FIELDS.contains(&name.as_str())) {
        let fixed = FIXED.iter().find(|(names, _)| names.contains(&name.as_str()));
        let detail = match fixed {
            Some((_, sentence)) => (*sentence).to_owned(),
            None => format!("expected one of the fields {}, got \"{name}\"", FIELDS.join(", ")),
        };
        faults.push(Fault::new(format!("/{}", name.replace('~', "~0").replace('/', "~1")), detail));
    }
    if let Some(Value::Object(labels)) = members.get("labels") {
        let is_long = |value: &Value| value.as_f64().is_some_and(|number| number.abs() >= OF_64_BITS);
        for (name, value) in labels.iter().filter(|(_, value)| is_long(value)) {
            let pointer = format!("/labels/{}", name.replace('~', "~0").replace('/', "~1"));
            let detail = format!(
                "expected a number below 1.8e19 in size, whose digits are kept, or a text, got {value}"
            );
            faults.push(Fault::new(pointer, detail));
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(members)
}

/// The attributes with the changes, checked as those of a shape that arrives.
pub(super) fn patched(
    limits: &Limits,
    current: &ShapeAttributes,
    members: &Map<String, Value>,
) -> Result<ShapeAttributes, ServiceError> {
    let mut document = document(current)?;
    merge(&mut document, Value::Object(members.clone()));
    let shape: ShapeInput = read::parse(limits, document.to_string().as_bytes())?;
    let changed = read::attributes(shape).map_err(|faults| ServiceError::Invalid(faults.into()))?;
    Ok(ShapeAttributes { external_id: current.external_id.clone(), ..changed })
}

/// The attributes that can be changed, as they are posted.
fn document(attributes: &ShapeAttributes) -> Result<Value, ServiceError> {
    let unreadable = |error| ServiceError::Internal(format!("the metadata of a shape: {error}"));
    let metadata = attributes.metadata.as_deref().map(serde_json::from_str::<Value>);
    let ShapeAttributes { subject, label, labels, weight, .. } = attributes;
    let metadata = metadata.transpose().map_err(unreadable)?;
    let mut document = json!({"labels": labels, "weight": weight});
    for (name, value) in [
        ("subject", subject.clone().map(Value::from)),
        ("label", label.clone().map(Value::from)),
        ("metadata", metadata),
    ] {
        if let Some(value) = value {
            document[name] = value;
        }
    }
    Ok(document)
}

/// Which shapes of a cohort are to be deleted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deletion {
    /// Filter that they pass.
    pub filter: ShapeFilter,
    /// Whether an empty filter means all shapes.
    pub all: bool,
    /// Whether they are only counted.
    pub dry_run: bool,
}

/// Deletes the shapes of a cohort that pass a filter, as one revision; the cohort must be at an expected version.
///
/// # Errors
/// [`ServiceError::NotFound`]; a filter without conditions, unless all shapes are meant; attributes that no shape has;
/// [`ServiceError::Changed`].
pub async fn delete(
    app: &App,
    key: &str,
    deletion: Deletion,
    expected: Option<Expected>,
) -> Result<Deleted, ServiceError> {
    let Deletion { filter, all, dry_run } = deletion;
    match (filter == ShapeFilter::default(), all) {
        (true, false) => return Err(ServiceError::Query("expected a filter, or all=true".into())),
        (false, true) => {
            return Err(ServiceError::parameter("all", "expected either a filter or all=true, got both"));
        }
        _ => {}
    }
    let cohort = find_as_expected(app, key, expected.as_ref()).await?;
    // Before anything is deleted: a misspelt attribute with `ne` would select every shape.
    refuse_misspelt(app, &cohort, &filter, None, true).await?;
    measures::complete_for(app, &cohort, &filter).await?;
    let (revisions, revision) = (Revisions::until(cohort.revision), expected.map(|_| cohort.revision));
    let deleted = if dry_run {
        app.touched.note(DRY_RUN, "true");
        let shapes = app.store.count(&cohort.id, revisions, &filter).await?;
        Deleted { shapes, revision: cohort.revision }
    } else {
        app.store.delete_shapes(&cohort.id, &filter, revision, now_ms()).await?
    };
    app.touched.note("shapes", &deleted.shapes.to_string());
    Ok(deleted)
}

/// Outcome of an erasure.
#[derive(Debug)]
pub struct Erased {
    /// Cohorts with the shapes erased from them; for a dry run, those that would be.
    pub cohorts: Vec<SubjectCohort>,
    /// Whether the files of the store hold nothing of the subject either; `None` for a dry run.
    pub is_done: Option<bool>,
}

/// Erases the shapes of a subject in all cohorts of the tenant, those in the trash included, at every revision; with `dry_run`, tells which
/// would be erased. Waits for the files to be written anew, but no longer than `REWRITING`.
///
/// # Errors
/// [`ServiceError::NotFound`] for a subject that has no shapes and was not erased before; [`ServiceError::Forbidden`] for keys limited to
/// certain cohorts; a failure of the store, after which a repetition erases the rest.
pub async fn erase(app: &App, subject: &str, dry_run: bool) -> Result<Erased, ServiceError> {
    app.check_unlimited("erasing a subject")?;
    let found = app.store.find_subject(subject).await?;
    if found.is_empty() && app.store.find_erasure(subject).await?.is_none() {
        return Err(subjects::not_found());
    }
    for cohort in &found {
        app.touched.note("cohort_id", &cohort.id);
    }
    let shapes: u64 = found.iter().map(|cohort| cohort.shapes).sum();
    if dry_run {
        app.touched.note(DRY_RUN, "true");
        app.touched.note("shapes", &shapes.to_string());
        return Ok(Erased { cohorts: found, is_done: None });
    }
    let mut erased = Vec::new();
    for cohort in found {
        let Some(cohort) = app.store.erase_subject(cohort, subject, now_ms()).await? else { continue };
        app.cache.forget(&cohort.id);
        for job in &cohort.jobs {
            jobs::taken_away(app, &job.id, job.removed);
        }
        erased.push(cohort);
    }
    app.store.finish_erasures(Some(subject), now_ms()).await?;
    let shapes: u64 = erased.iter().map(|cohort| cohort.shapes).sum();
    app.touched.note("shapes", &shapes.to_string());
    // It goes on if it takes longer, or the client leaves.
    let _ = tokio::time::timeout(REWRITING, app.store.begin_rewriting()).await;
    let state = app.store.find_erasure(subject).await?.map(|erasure| erasure.state);
    let is_done = state == Some(ErasureState::Done);
    tracing::info!(shapes, cohorts = erased.len(), is_done, "a subject was erased");
    Ok(Erased { cohorts: erased, is_done: Some(is_done) })
}

/// Completes an interrupted erasure.
///
/// # Errors
/// A failure of the store.
pub async fn finish(app: &App) -> Result<(), ServiceError> {
    let overwritten = app.store.finish_erasures(None, now_ms()).await?;
    if overwritten > 0 {
        tracing::info!(overwritten, "an interrupted erasure was completed");
    }
    Ok(())
}
