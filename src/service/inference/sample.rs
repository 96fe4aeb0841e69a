//! Sample of a study: the selected shapes of a stored cohort with their strata and control points.

use std::collections::HashMap;

use tokio::runtime::Handle;

use crate::analysis::inference::groups;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeDescription;
use crate::formats::fault::Fault;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{first_names, name_of};
use crate::store::{Ids, Revisions};

/// The stratum of every shape: shapes with equal values of all attributes share one.
///
/// # Errors
/// Shapes without one of the attributes, at `/strata`.
pub(super) fn strata(names: &[String], shapes: &[ShapeDescription]) -> Result<Vec<usize>, ServiceError> {
    let mut faults = Vec::new();
    let mut keys = vec![Vec::new(); shapes.len()];
    for name in names {
        let Some(attribute) = Attribute::parse(name) else {
            faults.push(Fault::new("/strata", format!("{}, got '{name}'", Attribute::WANTED)));
            continue;
        };
        let without: Vec<_> = shapes.iter().filter(|shape| attribute.text(shape).is_none()).collect();
        if !without.is_empty() {
            let (count, first) = (without.len(), first_names(without.into_iter()));
            let detail = format!("{count} of {} shapes have no {name}: {first}", shapes.len());
            faults.push(Fault::new("/strata", detail));
        }
        for (key, shape) in keys.iter_mut().zip(shapes) {
            key.push(attribute.text(shape));
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(groups::strata(keys))
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
    Ok(Cohort { revision, ..cohort })
}

/// Shapes of a study, and the filters that together select all of them.
#[derive(Debug, Clone, Copy)]
pub struct Selection<'a> {
    /// The shapes, in the order of the result.
    pub shapes: &'a [ShapeDescription],
    /// Filters through which they are read.
    pub filters: &'a [ShapeFilter],
}

impl Selection<'_> {
    /// Control points (`length` numbers each) and weights of the shapes, in order.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`] once `stop` returns true; a failure of the store.
    pub(super) fn read(
        self,
        app: &App,
        handle: &Handle,
        cohort: &Cohort,
        length: usize,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(Vec<f64>, Vec<f64>), ServiceError> {
        let Self { shapes, filters } = self;
        let places: HashMap<&str, usize> =
            shapes.iter().enumerate().map(|(k, s)| (s.id.as_str(), k)).collect();
        let mut control_points = vec![0.0; shapes.len() * length];
        let (mut weights, mut left) = (vec![0.0; shapes.len()], shapes.len());
        for filter in filters {
            let mut position = None;
            loop {
                if stop() {
                    return Err(ServiceError::Cancelled);
                }
                let revisions = Revisions::until(cohort.revision);
                let scan = app.store.scan(&cohort.id, revisions, filter, position, Ids::Include);
                let Some(batch) = handle.block_on(scan)? else { break };
                position = Some(batch.position);
                let rows = batch.control_points.chunks_exact(length).zip(&batch.weights);
                for (id, (row, &weight)) in batch.ids.iter().zip(rows) {
                    if let Some(&k) = places.get(id.as_str()) {
                        control_points[k * length..(k + 1) * length].copy_from_slice(row);
                        left -= usize::from(weights[k] == 0.0);
                        weights[k] = weight;
                    }
                }
            }
        }
        if left > 0 {
            return Err(ServiceError::Internal(format!("{left} shapes of a test are not in the store")));
        }
        Ok((control_points, weights))
    }

    /// Replaces positions in errors of statistics by shape ids, which clients know.
    pub(super) fn named(self, error: ServiceError, cohort: &str) -> ServiceError {
        let ServiceError::DegenerateShape(faults) = error else { return error };
        let named = |fault: Fault| {
            let name = fault.index.and_then(|k| self.shapes.get(k)).map_or("", name_of);
            let detail = format!("{} (shape '{name}' of the cohort '{cohort}')", fault.detail);
            Fault { pointer: String::new(), detail, ..fault }
        };
        ServiceError::DegenerateShape(faults.into_iter().map(named).collect())
    }
}
