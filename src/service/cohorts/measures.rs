//! Measures of shapes that arrive: stored beside them, so that tables and filters need no geometry.

use std::sync::Arc;

use super::directed;
use crate::analysis::metric::Metric;
use crate::analysis::size::centroid_size;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeMeasures;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::size::{SizeMeasure, Sizes, runs_clockwise};
use crate::numeric::bounded::never;
use crate::service::app::parallel;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};

/// Computes the measures of shapes of one space.
#[derive(Debug)]
pub(crate) struct Measuring {
    space: ShapeSpace,
    metric: Metric,
    /// Sizes that shapes of the space have.
    sizes: Vec<SizeMeasure>,
}

impl Measuring {
    /// Prepares the measures of shapes of `space`.
    pub(crate) fn new(space: ShapeSpace) -> Self {
        let (metric, sizes) = (Metric::of(&space), SizeMeasure::of(&space));
        Self { space, metric, sizes }
    }

    /// Measures of the shape with these control points (`d·N` coordinate-major numbers), which came as so many points, if that
    /// is known.
    ///
    /// Cost: a quadrature of the curve or surface, and a search for crossings of planar curves.
    pub(crate) fn measure(&self, control_points: &[f64], points: Option<usize>) -> ShapeMeasures {
        let (sizes, self_intersecting) = Sizes::with_crossings(&self.space, control_points, &never);
        let size = |measure| {
            let size = sizes.get(measure).filter(|_| self.sizes.contains(&measure));
            size.filter(|size| size.is_finite())
        };
        ShapeMeasures {
            points: points.map(|points| points as u64),
            centroid_size: Some(centroid_size(&self.space, &self.metric, control_points)),
            length: size(SizeMeasure::Length),
            area: size(SizeMeasure::Area),
            volume: size(SizeMeasure::Volume),
            self_intersecting,
            clockwise: runs_clockwise(&self.space, control_points),
            fit: None,
            beginning: None,
        }
    }
}

/// Measures shapes of earlier versions if the filter asks for measures.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn complete_for(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
) -> Result<(), ServiceError> {
    let is_measure = |attribute: &Attribute| matches!(attribute, Attribute::Measure(_));
    if filter.attributes().iter().any(is_measure) { complete(app, cohort).await } else { Ok(()) }
}

/// Measures the shapes of a cohort that were stored by a version that did not.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn complete(app: &App, cohort: &Cohort) -> Result<(), ServiceError> {
    let mut measuring: Option<Arc<Measuring>> = None;
    loop {
        let shapes = app.store.unmeasured(&cohort.id).await?;
        if shapes.is_empty() {
            return directed::complete(app, cohort).await;
        }
        let measuring = match &measuring {
            Some(measuring) => Arc::clone(measuring),
            None => {
                let new = Arc::new(Measuring::new(app.space_of(&cohort.spec.representation)?));
                Arc::clone(measuring.insert(new))
            }
        };
        let representation = &cohort.spec.representation;
        let counts = Counts::for_stored(representation, shapes.len(), &app.limits);
        let work = requests::measure_stored(representation, counts, &app.limits);
        let pool = app.pool.weighing(work);
        let measured = pool.run(move || {
            Ok(parallel::map_ref(&shapes, |_, shape| {
                (shape.place, measuring.measure(&shape.control_points, None))
            }))
        });
        app.store.keep_measures(&measured.await?).await?;
    }
}
