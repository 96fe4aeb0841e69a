//! Sample of a study: strata and subjects of the selected shapes of a stored cohort.

use tokio::runtime::Handle;

use crate::analysis::{inference::groups, strata};
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeDescription;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::first_names;
use crate::wire::fault::Fault;

/// The stratum of every shape: shapes with equal values of all attributes share one.
///
/// # Errors
/// Shapes without one of the attributes, at `/strata`.
pub(super) fn strata(names: &[String], shapes: &[ShapeDescription]) -> Result<Vec<usize>, ServiceError> {
    labels_of(names, shapes, "/strata")
}

/// A number for every shape, which shapes with equal values of all attributes share.
///
/// # Errors
/// Shapes without one of the attributes, at `pointer`.
pub(super) fn labels_of(
    names: &[String],
    shapes: &[ShapeDescription],
    pointer: &str,
) -> Result<Vec<usize>, ServiceError> {
    let mut faults = Vec::new();
    let mut keys = vec![Vec::new(); shapes.len()];
    for name in names {
        let Some(attribute) = Attribute::parse(name) else {
            faults.push(Fault::new(pointer, format!("{}, got '{name}'", Attribute::WANTED)));
            continue;
        };
        let without: Vec<_> = shapes.iter().filter(|shape| attribute.text(shape).is_none()).collect();
        if !without.is_empty() {
            let (count, first) = (without.len(), first_names(without.into_iter()));
            let detail = format!("{count} of {} shapes have no {name}: {first}", shapes.len());
            faults.push(Fault::new(pointer, detail));
        }
        for (key, shape) in keys.iter_mut().zip(shapes) {
            key.push(attribute.text(shape));
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(strata::strata(keys))
}

/// The subject of every shape.
pub(super) fn subjects(shapes: &[ShapeDescription]) -> Vec<Option<&str>> {
    shapes.iter().map(|shape| shape.subject.as_deref()).collect()
}

/// Warning about shapes of one subject that are treated as independent; none if `strata` contains the subject.
pub(super) fn subject_warning(shapes: &[ShapeDescription], strata: &[String]) -> Option<String> {
    if strata.iter().any(|name| name == "subject") {
        return None;
    }
    groups::dependence_warning(&subjects(shapes))
}

/// The cohort at the revision of a requested study.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub(super) fn cohort_at(app: &App, handle: &Handle, id: &str, revision: u64) -> Result<Cohort, ServiceError> {
    let cohort = handle.block_on(app.store.find_cohort(id))?;
    let cohort = cohort.ok_or_else(|| ServiceError::NotFound { kind: "cohort", key: id.into() })?;
    Ok(cohort.at(revision))
}
