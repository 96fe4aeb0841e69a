//! Selected shapes of a stored cohort: their control points in the order of their descriptions, and their names in errors.

use std::collections::HashMap;

use tokio::runtime::Handle;

use super::attributes::name_of;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeDescription;
use crate::service::app::{App, ServiceError};
use crate::store::{Ids, Revisions};
use crate::wire::fault::Fault;

/// Shapes with descriptions, and the filters that together select all of them.
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
    pub fn read(
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
            return Err(ServiceError::Internal(format!("{left} selected shapes are not in the store")));
        }
        Ok((control_points, weights))
    }

    /// Replaces positions in errors of statistics by shape ids, which clients know.
    pub fn named(self, error: ServiceError, cohort: &str) -> ServiceError {
        let ServiceError::DegenerateShape(faults) = error else { return error };
        let named = |fault: Fault| {
            let name = fault.index.and_then(|k| self.shapes.get(k)).map_or("", name_of);
            let detail = format!("{} (shape '{name}' of the cohort '{cohort}')", fault.detail);
            Fault { pointer: String::new(), detail, ..fault }
        };
        ServiceError::DegenerateShape(faults.into_iter().map(named).collect())
    }
}
