//! How the pairs of a matrix of distances are compared: modulo a class of transformations, or elastically.

use crate::analysis::AnalysisError;
use crate::analysis::distance::{DistanceSpace, PreparedShapes};
use crate::analysis::elastic::curve::ElasticCurve;
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::ElasticSpace;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::source::StoredShapes;
use crate::service::cost::requests::{self, Counts};
use crate::service::statistics::Setup;
use crate::store::{Ids, ScanBatch};

/// Space in which shapes are compared.
pub(super) struct Compared {
    pub(super) setup: Setup,
    pairs: Pairs,
}

enum Pairs {
    Linear(Box<DistanceSpace>),
    Elastic(Box<ElasticSpace>),
}

/// Shapes that are prepared for comparison.
pub(super) enum Prepared {
    Linear(PreparedShapes),
    Elastic(Vec<ElasticCurve>),
}

/// Receives the completed fraction and returns whether to continue.
pub(super) type GoOn<'a> = dyn Fn(f64) -> bool + Sync + 'a;

/// Names and labels of stored shapes, and the shapes prepared.
pub(super) type NamedPrepared = (Vec<String>, Vec<Option<String>>, Option<Prepared>);

/// Checks that an elastic distance is asked for modulo what it removes.
///
/// # Errors
/// [`ServiceError::Invalid`] at `/transformation`.
pub fn check_elastic_class(transformation: &Transformation) -> Result<(), ServiceError> {
    use ClassName::{Rigid, ScaledRotation, Similarity, Translation};
    let known = [Similarity, ScaledRotation, Rigid, Translation].map(Transformation::Named);
    if known.contains(transformation) {
        return Ok(());
    }
    let detail = format!(
        "expected \"similarity\", \"scaled_rotation\", \"rigid\" or \"translation\" with an elastic distance, which is one modulo \
         positions, scales and rotations, got {}",
        match transformation {
            Transformation::Named(name) => format!("\"{}\"", name.as_str()),
            Transformation::Custom(_) => "matrices".to_owned(),
        }
    );
    Err(ServiceError::invalid("/transformation", detail))
}

impl Compared {
    pub(super) fn new(setup: Setup, elastic: Option<ElasticSettings>) -> Result<Self, ServiceError> {
        let pairs = match elastic {
            None => Pairs::Linear(Box::new(DistanceSpace::new(&setup.method, &setup.matching)?)),
            Some(settings) => {
                let rule = setup.rule();
                let space = ElasticSpace::new(&setup.space, rule.direction, rule.mirror, settings)?;
                Pairs::Elastic(Box::new(space))
            }
        };
        Ok(Self { setup, pairs })
    }

    /// Bytes of a prepared shape.
    pub(super) fn bytes(&self) -> usize {
        match &self.pairs {
            Pairs::Linear(space) => space.bytes(),
            Pairs::Elastic(space) => space.bytes(),
        }
    }

    /// Memory of `count` prepared curves, taken from the account of requests; those of jobs are within their own limit.
    pub(super) fn room(&self, app: &App, count: usize) -> Result<Option<Held>, ServiceError> {
        match &self.pairs {
            Pairs::Linear(_) => Ok(None),
            Pairs::Elastic(space) => {
                app.memory.hold(Purpose::Bodies, count.saturating_mul(space.bytes())).map(Some)
            }
        }
    }

    /// Work of all pairs of `count` shapes.
    pub(super) fn pairs(&self, count: usize) -> Work {
        match &self.pairs {
            Pairs::Linear(space) => Work::from_multiply_adds(space.matrix_operations(count)),
            Pairs::Elastic(space) => Work::from_seconds(0.5 * (count as f64).powi(2) * space.seconds()),
        }
    }

    /// Work of a matrix of `counts` shapes, `count` of them.
    pub(super) fn work(&self, counts: Counts, count: usize) -> Work {
        let work = requests::distances(counts, 0.0) + self.pairs(count);
        match &self.pairs {
            Pairs::Linear(_) => work,
            Pairs::Elastic(space) => work + requests::elastic_curves(count, space.settings().points),
        }
    }

    /// Most work of pairs that is done at once.
    pub(super) fn most(app: &App) -> Work {
        Work::from_multiply_adds(app.limits.matrix_operations as f64)
    }

    /// Prepares shapes of these control points.
    pub(super) fn prepare_given(&self, control_points: Vec<f64>) -> Result<Prepared, AnalysisError> {
        Ok(match &self.pairs {
            Pairs::Linear(space) => {
                Prepared::Linear(space.prepare_given(&self.setup.metric, control_points)?)
            }
            Pairs::Elastic(space) => Prepared::Elastic(space.prepare(&control_points)?),
        })
    }

    /// Prepares stored shapes as they are read.
    pub(super) fn prepare_stored(
        &self,
        shapes: &StoredShapes<'_>,
        cohort: &Cohort,
    ) -> Result<NamedPrepared, ServiceError> {
        let (mut ids, mut labels, mut prepared) = (Vec::new(), Vec::new(), None);
        let mut add = |batch: &ScanBatch, more: Prepared| {
            match (&mut prepared, more) {
                (Some(Prepared::Linear(all)), Prepared::Linear(more)) => all.append(more),
                (Some(Prepared::Elastic(all)), Prepared::Elastic(more)) => all.extend(more),
                (all, more) => *all = Some(more),
            }
            let names = batch.ids.iter().zip(&batch.external_ids);
            ids.extend(names.map(|(id, external_id)| external_id.as_ref().unwrap_or(id).clone()));
            labels.extend_from_slice(&batch.labels);
        };
        match &self.pairs {
            Pairs::Linear(space) => shapes.for_each_stored(Ids::Include, &mut |batch| {
                add(batch, Prepared::Linear(space.prepare(&batch.control_points)?));
                Ok(())
            })?,
            Pairs::Elastic(space) => shapes.for_each_named(&mut |batch| {
                let more = space.prepare(&batch.control_points).map_err(|error| match error {
                    AnalysisError::Unsuitable { index, detail } => {
                        let (id, name) =
                            (batch.ids.get(index).cloned().unwrap_or_default(), &cohort.spec.name);
                        ServiceError::invalid("", format!("{detail} (shape '{id}' of the cohort '{name}')"))
                    }
                    error => error.into(),
                })?;
                add(batch, Prepared::Elastic(more));
                Ok(())
            })?,
        }
        Ok((ids, labels, prepared))
    }

    /// The matrix of all distances.
    pub(super) fn matrix(&self, prepared: &Prepared, go_on: &GoOn<'_>) -> Result<Vec<f64>, AnalysisError> {
        match (&self.pairs, prepared) {
            (Pairs::Linear(space), Prepared::Linear(shapes)) => space.matrix(shapes, go_on),
            (Pairs::Elastic(space), Prepared::Elastic(curves)) => space.matrix(curves, go_on),
            _ => unreachable!("all shapes are prepared by the space that compares them"),
        }
    }
}
