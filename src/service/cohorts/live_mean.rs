//! Mean of a stored cohort at its current revision, with some aligned shapes for drawings.
//!
//! It is computed on demand, and cached by revision and parameters.

use std::sync::Arc;

use serde::Serialize;
use tokio::runtime::Handle;

use super::source::StoredShapes;
use crate::analysis::accumulate::prepare;
use crate::analysis::alignment::{AlignedShape, Alignment, MeanShape, align, mean_shape};
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeFilter;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::statistics::{CheckedSettings, Settings, Setup};

/// Parameters of a cohort mean.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeanQuery {
    /// Transformation class.
    pub transformation: ClassName,
    /// Projection or Procrustes alignment.
    pub alignment: Alignment,
    /// Frame: selects the representative of the mean space.
    pub frame: Frame,
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
}

/// Mean of a cohort at a revision.
#[derive(Debug)]
pub struct LiveMean {
    /// The cohort at that revision.
    pub cohort: Cohort,
    /// Setup of the computation.
    pub setup: Setup,
    /// The mean, without placements.
    pub mean: MeanShape,
    /// Some aligned shapes, for drawings.
    pub drawn: Vec<AlignedShape>,
}

impl Cached for LiveMean {
    const NAME: &'static str = "means";

    fn bytes(&self) -> usize {
        // Control points, plain and whitened, of the mean and of every drawn shape, plus a few vectors.
        let vectors = 8 + 3 * self.drawn.len();
        8 * vectors * self.setup.metric.len() + self.setup.space.bytes()
    }
}

/// Mean of the shapes of a cohort that match the filter, at its current revision; cached.
///
/// # Errors
/// [`ServiceError::NotFound`]; too few or degenerate shapes.
pub async fn mean(app: &App, cohort: Cohort, query: MeanQuery) -> Result<Arc<LiveMean>, ServiceError> {
    let (id, key) = (cohort.id.clone(), (cohort.revision, query.clone()));
    if let Some(known) = app.cache.find(&id, &key) {
        return Ok(known);
    }
    let settings = Settings {
        representation: cohort.spec.representation.clone(),
        correspondence: cohort.spec.correspondence,
        direction: cohort.spec.direction,
        mirror: cohort.spec.mirror,
        transformation: Transformation::Named(query.transformation),
        alignment: query.alignment,
        frame: query.frame,
    };
    let settings = settings.checked(&app.limits)?;
    let (task_app, handle, filter) = (app.clone(), Handle::current(), query.filter);
    let work = requests::align(&settings, Counts::for_cohort(&cohort, &app.limits));
    let computed =
        app.pool.weighing(work).run(move || compute(&task_app, &handle, cohort, settings, filter)).await?;
    let mean = Arc::new(computed);
    app.cache.keep(&id, &key, &mean);
    Ok(mean)
}

fn compute(
    app: &App,
    handle: &Handle,
    cohort: Cohort,
    settings: CheckedSettings,
    filter: ShapeFilter,
) -> Result<LiveMean, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let source = StoredShapes::new(app, handle, &cohort, &filter, 0, &setup, &stop)?;
    let Setup { metric, method, frame, matching, .. } = &setup;
    let mean = mean_shape(&source, metric, method, *frame, matching);
    let mut mean = mean.map_err(|error| source.named(error))?;
    let mut drawn = Vec::new();
    let first = source.first(MAX_DRAWN)?;
    for (k, shape) in first.chunks_exact(metric.len()).enumerate() {
        let (mut x, centroid) = (shape.to_vec(), metric.centroid(shape));
        prepare(metric, method.translates(), k, &mut x)?;
        drawn.push(align(method, matching, &mean.whitened, &x, &centroid, mean.placements[k])?);
    }
    mean.placements = Vec::new();
    Ok(LiveMean { setup, mean, drawn, cohort })
}
