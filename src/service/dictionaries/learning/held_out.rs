//! Measures of the training shapes of a dictionary, as it would describe them had they been held out.
//!
//! For components, shapes are left out one by one, exactly and without learning anew
//! ([`held_out`](crate::analysis::dictionary::held_out)), if nothing is searched or if there are many shapes. A small
//! number of shapes with searched start points influences the mean, which in turn influences the start points. In that
//! case, and for sparse atoms, which have no downdate, everything is learnt anew without one part of the shapes, and
//! then describes that part.

use super::{Task, in_memory, phase};
use crate::analysis::accumulate::{Accumulator, ScatterSum, ShapeSource, ShapesInMemory};
use crate::analysis::classification::{described, subset};
use crate::analysis::dictionary::content::{Content, HeldOutMeasure, HeldOutStatistics, HoldOut};
use crate::analysis::dictionary::held_out::{Downdate, FEWEST, HeldOut};
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::model::{Model, squared_distance};
use crate::analysis::dictionary::novelty::{Logarithms, Novelty};
use crate::analysis::dictionary::preparation::{Posed, Preparation};
use crate::analysis::pca::FunctionalPca;
use crate::service::app::ServiceError;
use crate::service::cohorts::source::StoredShapes;
use crate::service::cost::jobs::KEPT_BYTES;
use crate::service::dictionaries::plan::Plan;
use crate::service::dictionaries::ready;

/// Maximum number of held-out shapes: with 400, the limit at 0.99 has a standard error of a quarter of a percentage
/// point of false alarms, half of the effect of the choice of the cohort.
const MAX_HELD: usize = 400;

/// Below this number of shapes there are ten parts, above it five: a dictionary learnt from 16 of 20 shapes describes
/// the others visibly worse.
const FEW_SHAPES: usize = 100;
const PARTS: (usize, usize) = (10, 5);

/// Number of parts for `shapes` shapes, and number of parts for which a dictionary is learnt anew: one if there are
/// more shapes than are held out.
fn parts(shapes: usize) -> (usize, usize) {
    let parts = if shapes < FEW_SHAPES { PARTS.0.min(shapes) } else { PARTS.1 };
    if shapes > MAX_HELD { (parts, 1) } else { (parts, parts) }
}

/// Minimum number of shapes left to learn from without a part.
fn inside(shapes: usize) -> usize {
    shapes - shapes.div_ceil(parts(shapes).0.max(1))
}

/// Whether components are learnt anew without parts of this many shapes.
fn relearns(searches: bool, shapes: usize) -> bool {
    searches && shapes <= MAX_HELD
}

/// Number of additional trainings needed to hold out some of `shapes` shapes.
pub(crate) fn trainings(method: &Method, searches: bool, shapes: usize) -> usize {
    match method {
        _ if shapes < MIN_IN_PARTS => 0,
        Method::Sparse { atoms, .. } if *atoms > inside(shapes) => 0,
        Method::FunctionalPca { .. } if !relearns(searches, shapes) => 0,
        _ => parts(shapes).1,
    }
}

/// Minimum number of shapes that are divided into parts.
const MIN_IN_PARTS: usize = 4;

/// The same for a plan, independent of the number of its shapes; used for progress.
pub(super) fn usual_trainings(plan: &Plan) -> usize {
    match plan.method {
        Method::Sparse { .. } if plan.continue_from.is_none() => PARTS.1,
        _ => 0,
    }
}

/// At most [`MAX_HELD`] of the positions, evenly spread.
fn spread(positions: &[usize]) -> Vec<usize> {
    let held = positions.len().min(MAX_HELD);
    (0..held).map(|i| positions[i * positions.len() / held]).collect()
}

impl Task<'_> {
    /// Measures of held-out shapes. `None` for fewer than three shapes; for sparse atoms also if the shapes do not fit
    /// in memory or if learning was continued. `state`: the sums from which components were computed.
    pub(super) fn held_out(
        &self,
        shapes: &StoredShapes<'_>,
        content: &Content,
        preparation: &Preparation,
        state: &[u8],
    ) -> Result<Option<HeldOutStatistics>, ServiceError> {
        let bytes = shapes.count().saturating_mul(8 * preparation.metric.len());
        if shapes.count() < FEWEST {
            return Ok(None);
        }
        let anew = shapes.count() >= MIN_IN_PARTS && bytes <= KEPT_BYTES && self.plan.continue_from.is_none();
        let few = relearns(preparation.matching.searches(), shapes.count());
        let (method, found) = match &content.method {
            Method::FunctionalPca { centre, .. } if !(anew && few) => {
                let components = (*centre, content.atoms.len());
                (HoldOut::LeaveOneOut, self.left_out(shapes, components, preparation, state)?)
            }
            // Each atom starts as a shape of its own.
            Method::Sparse { atoms, .. } if !anew || *atoms > inside(shapes.count()) => return Ok(None),
            _ => match self.held_in_parts(&in_memory(shapes)?) {
                Ok(found) => (HoldOut::Parts, found),
                Err(ServiceError::Cancelled) => return Err(ServiceError::Cancelled),
                // The whole set could be learnt, but not a part of it: a shape may be degenerate for the mean of the
                // others.
                Err(error) => {
                    tracing::warn!(job = self.others.job.id, %error, "no shapes could be held out");
                    return Ok(None);
                }
            },
        };
        Ok(Some(record(method, found)))
    }

    fn left_out(
        &self,
        shapes: &StoredShapes<'_>,
        (centre, components): (bool, usize),
        preparation: &Preparation,
        state: &[u8],
    ) -> Result<HeldOut, ServiceError> {
        let mut sum = ScatterSum::new(preparation.metric.len());
        sum.restore(state)?;
        let origin = FunctionalPca::origin(&preparation.mean, centre);
        let downdate = Downdate::new(sum, &origin, shapes.count(), centre, components)?;
        self.context.check()?;
        let some = shapes.spread_out(MAX_HELD)?;
        let posed = in_memory(&Posed { source: &some, preparation })?;
        Ok(downdate.leave_out(posed.all()))
    }

    fn held_in_parts(&self, shapes: &ShapesInMemory) -> Result<HeldOut, ServiceError> {
        let (parts, learnt) = parts(shapes.count());
        let (mut distances, mut residuals) = (Vec::new(), Vec::new());
        for part in 0..learnt {
            self.context.check()?;
            // Consecutive shapes go to different parts, because cohorts are often ordered by class.
            let (outside, inside): (Vec<usize>, Vec<usize>) =
                (0..shapes.count()).partition(|k| k % parts == part);
            let found = self.told(&subset(shapes, &inside), &subset(shapes, &spread(&outside)))?;
            distances.extend(found.distances.into_iter().flatten());
            residuals.extend(found.residuals);
            let done = (part + 1) as f64 / learnt as f64;
            let progress = self.share() + (self.validation_start() - self.share()) * done;
            self.context.report(phase::HOLD_OUT.0, progress, None);
        }
        Ok(HeldOut { distances: (!distances.is_empty()).then_some(distances), residuals })
    }

    /// Measures that a dictionary learnt from some shapes assigns to others.
    fn told(&self, inside: &ShapesInMemory, outside: &ShapesInMemory) -> Result<HeldOut, ServiceError> {
        let context = self.context.silent();
        let content = Task { context: &context, ..*self }.content_of(inside)?;
        let (_, preparation, model) = ready::prepare(self.app, &content)?;
        let (prepared, codes) = described(&preparation, &model, outside)?;
        let shapes = prepared.chunks_exact(preparation.metric.len()).zip(&codes);
        let residuals = shapes.map(|(y, code)| squared_distance(y, &model.reconstruct(code))).collect();
        let distances = match &model {
            Model::Components { spread, .. } => {
                Some(codes.iter().map(|code| spread.distance(&code.values)).collect())
            }
            Model::Sparse { .. } => None,
        };
        Ok(HeldOut { distances, residuals })
    }
}

/// Largest stored value; every shape beyond it is new.
const MOST: f64 = 1e100;

fn record(method: HoldOut, mut found: HeldOut) -> HeldOutStatistics {
    for values in found.distances.iter_mut().chain([&mut found.residuals]) {
        values.iter_mut().for_each(|value| *value = value.min(MOST));
    }
    let HeldOut { distances, residuals } = found;
    let novelty = Novelty {
        distances: distances.as_deref().map(Logarithms::of),
        residuals: Logarithms::of(&residuals),
    };
    let distance = |k: usize| distances.as_ref().map(|distances| distances[k]);
    let measures = residuals.iter().enumerate().map(|(k, residual)| novelty.measure(distance(k), *residual));
    HeldOutStatistics {
        method,
        novelty: ascending(measures.collect()),
        t_squared: novelty.distances.zip(distances).map(|(logarithms, values)| measure(logarithms, values)),
        residuals: measure(novelty.residuals, residuals),
    }
}

fn measure(logarithms: Logarithms, values: Vec<f64>) -> HeldOutMeasure {
    let Logarithms { mean, deviation } = logarithms;
    HeldOutMeasure { values: ascending(values), log_mean: mean, log_deviation: deviation }
}

fn ascending(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bounded_number_of_shapes_is_held_out() {
        let all: Vec<usize> = (0..100_000).collect();
        assert_eq!(spread(&all[..3]), [0, 1, 2]);
        let many = spread(&all);
        assert!(many.len() == MAX_HELD && many.is_sorted_by(|a, b| a < b) && many[MAX_HELD - 1] < 100_000);
        assert_eq!([5, 20, 100, 400, 401].map(parts), [(5, 5), (10, 10), (5, 5), (5, 5), (5, 1)]);
        let components = Method::FunctionalPca { components: 3, centre: true };
        assert_eq!([3, 20, 400, 401].map(|count| trainings(&components, true, count)), [0, 10, 5, 0]);
        assert_eq!(trainings(&components, false, 20), 0);
    }

    /// The stored values match the measures from which they were computed.
    #[test]
    fn the_record_is_in_order() {
        let found = HeldOut { distances: Some(vec![3.0, 1.0, 1e300]), residuals: vec![0.1, 0.3, 0.2] };
        let record = record(HoldOut::LeaveOneOut, found);
        assert_eq!(record.residuals.values, [0.1, 0.2, 0.3]);
        assert_eq!(record.t_squared.unwrap().values, [1.0, 3.0, MOST]);
        assert!(record.novelty.len() == 3 && record.novelty.is_sorted());
    }
}
