//! Measures of the training shapes of a dictionary, as it would describe them had they been held out.
//!
//! For components, shapes are left out one by one, exactly and without learning anew ([`downdate`](super::downdate)), if
//! nothing is searched or if there are many shapes. A small number of shapes with searched start points influences the
//! mean, which in turn influences the start points. In that case, and for sparse atoms, which have no downdate,
//! everything is learnt anew without one part of the shapes, and then describes that part.
//!
//! Which shapes are held out, and in which part, depends on the shapes as given and on a seed, not on their places
//! ([`Mark`](crate::accumulate::Mark)): the same shapes in any order have the same limit of outliers.

use super::content::{GrossErrors, HeldOutMeasure, HeldOutStatistics, HoldOut, TypicalScores};
use super::downdate::{Downdate, FEWEST, HeldOut};
use super::gross_errors::{Held, Typical};
use super::in_use::Dictionary;
use super::learn::{bytes, learn_part};
use super::method::Method;
use super::model::{described, squared_distance};
use super::novelty::{Logarithms, Novelty};
use super::recipe::Recipe;
use crate::AnalysisError;
use crate::accumulate::{KEPT_BYTES, ShapeSource, ShapesInMemory, subset};
use crate::preparation::Posed;
use crate::watch::{Phase, Watch};

/// Maximum number of held-out shapes: with 400, the limit at 0.99 has a standard error of a quarter of a percentage
/// point of false alarms, half of the effect of the choice of the cohort.
const MAX_HELD: usize = 400;

/// Below this number of shapes there are ten parts, above it five: a dictionary learnt from 16 of 20 shapes describes
/// the others visibly worse.
const FEW_SHAPES: usize = 100;
const PARTS: (usize, usize) = (10, 5);

/// Minimum number of shapes that are divided into parts.
const MIN_IN_PARTS: usize = 4;

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

/// Number of additional trainings needed to hold out some of `shapes` shapes, with or without a search of start points,
/// directions or mirror images.
pub fn trainings(method: &Method, searches: bool, shapes: usize) -> usize {
    let downdated = !method.is_sparse() && !relearns(searches, shapes);
    if shapes < MIN_IN_PARTS || method.needed_shapes() > inside(shapes) || downdated {
        return 0;
    }
    parts(shapes).1
}

/// Measures of held-out shapes. `None` for fewer than three shapes; for sparse atoms also if the shapes do not fit in
/// memory or if learning was continued (not `anew`). `state`: the sums from which components were computed.
pub(super) fn statistics(
    shapes: &dyn ShapeSource,
    dictionary: &Dictionary,
    recipe: &Recipe,
    state: &[u8],
    anew: bool,
    watch: &dyn Watch,
) -> Result<Option<HeldOutStatistics>, AnalysisError> {
    let (count, preparation) = (shapes.count(), &dictionary.preparation);
    if count < FEWEST {
        return Ok(None);
    }
    let method = &recipe.method;
    let anew = anew && count >= MIN_IN_PARTS && bytes(shapes, preparation) <= KEPT_BYTES;
    let few = relearns(preparation.matching.searches(), count);
    if !(method.is_sparse() || anew && few) {
        let downdate = method.downdate(&dictionary.content, preparation, state, count)?;
        return downdate
            .map(|downdate| {
                let held = left_out(shapes, dictionary, recipe, &downdate, watch)?;
                Ok(held.record(HoldOut::LeaveOneOut, recipe.held_out_seed))
            })
            .transpose();
    }
    if !anew || method.needed_shapes() > inside(count) {
        return Ok(None);
    }
    match held_in_parts(shapes, dictionary, recipe, watch) {
        Ok(held) => Ok(Some(held.record(HoldOut::Parts, recipe.held_out_seed))),
        Err(AnalysisError::Interrupted) => Err(AnalysisError::Interrupted),
        // The whole set could be learnt, but not a part of it: a shape may be degenerate for the mean of the others.
        Err(error) => {
            watch.not_held_out(error);
            Ok(None)
        }
    }
}

/// Held-out shapes.
struct HeldShapes {
    /// Prepared for the dictionary of all shapes.
    posed: Vec<f64>,
    /// Scores in that dictionary; empty for sparse atoms.
    scores: Vec<Vec<f64>>,
    /// Measures without the shapes themselves.
    found: HeldOut,
}

fn left_out(
    shapes: &dyn ShapeSource,
    dictionary: &Dictionary,
    recipe: &Recipe,
    downdate: &Downdate,
    watch: &dyn Watch,
) -> Result<HeldShapes, AnalysisError> {
    watch.check()?;
    let some = ShapesInMemory::sample(shapes, recipe.held_out_seed, MAX_HELD)?;
    let posed = ShapesInMemory::of(&Posed { source: &some, preparation: &dictionary.preparation })?;
    let codes = dictionary.model.codes(posed.all().whitened, dictionary.metric().len())?;
    let scores = codes.into_iter().map(|code| code.values).collect();
    let found = downdate.leave_out(posed.all());
    Ok(HeldShapes { posed: posed.into_whitened(), scores, found })
}

fn held_in_parts(
    source: &dyn ShapeSource,
    dictionary: &Dictionary,
    recipe: &Recipe,
    watch: &dyn Watch,
) -> Result<HeldShapes, AnalysisError> {
    // The order of the ranks: cohorts are often ordered by class, and a period may run through them.
    let shapes = ShapesInMemory::ranked(source, recipe.held_out_seed)?;
    let (parts, learnt) = parts(shapes.count());
    let (mut distances, mut residuals, mut held) = (Vec::new(), Vec::new(), Vec::new());
    for part in 0..learnt {
        watch.check()?;
        let (mut outside, inside): (Vec<usize>, Vec<usize>) =
            (0..shapes.count()).partition(|k| k % parts == part);
        outside.truncate(MAX_HELD);
        let measured = dictionary.preparation.measured();
        let (learner, _) = learn_part(recipe, measured, &subset(&shapes, &inside), watch)?;
        let found = learner.told(&subset(&shapes, &outside))?;
        distances.extend(found.distances.into_iter().flatten());
        residuals.extend(found.residuals);
        held.extend(outside);
        watch.phase(Phase::HoldOut, (part + 1) as f64 / learnt as f64);
    }
    let (posed, codes) = described(&dictionary.preparation, &dictionary.model, &subset(&shapes, &held))?;
    let scores = match recipe.method.is_sparse() {
        true => Vec::new(),
        false => codes.into_iter().map(|code| code.values).collect(),
    };
    let distances = (!distances.is_empty()).then_some(distances);
    Ok(HeldShapes { posed, scores, found: HeldOut { distances, residuals } })
}

impl Dictionary {
    /// Measures of shapes from which the dictionary was not learnt.
    fn told(&self, shapes: &ShapesInMemory) -> Result<HeldOut, AnalysisError> {
        let (prepared, codes) = described(&self.preparation, &self.model, shapes)?;
        let pairs = prepared.chunks_exact(self.metric().len()).zip(&codes);
        let residuals = pairs.map(|(y, code)| squared_distance(y, &self.model.reconstruct(code))).collect();
        let distances = codes.iter().map(|code| self.model.distance(code)).collect();
        Ok(HeldOut { distances, residuals })
    }
}

/// Largest stored value; every shape beyond it is new.
const MOST: f64 = 1e100;

impl HeldShapes {
    fn record(mut self, method: HoldOut, seed: u64) -> HeldOutStatistics {
        for values in self.found.distances.iter_mut().chain([&mut self.found.residuals]) {
            values.iter_mut().for_each(|value| *value = value.min(MOST));
        }
        let Self { posed, scores, found: HeldOut { distances, residuals } } = self;
        let held = Held { posed: &posed, scores: &scores, residuals: &residuals };
        let typical = Typical::of(&held);
        let kept = typical.as_ref().map_or_else(|| vec![true; residuals.len()], |found| found.kept.clone());
        let logarithms = |values: &[f64]| {
            Logarithms::of(&chosen(values, &kept).map(|value| value.min(MOST)).collect::<Vec<f64>>())
        };
        let among_typical = typical.as_ref().and_then(|found| found.distances.as_ref());
        let measured = among_typical.map(|(distances, _)| distances).or(distances.as_ref());
        let novelty = Novelty {
            distances: measured.map(|distances| logarithms(distances)),
            residuals: logarithms(&residuals),
        };
        let measures = residuals.iter().enumerate();
        let measures: Vec<f64> = measures
            .map(|(k, residual)| novelty.measure(measured.map(|distances| distances[k].min(MOST)), *residual))
            .collect();
        let scores = among_typical.zip(novelty.distances).map(|((_, spread), logarithms)| TypicalScores {
            mean: spread.mean.clone(),
            covariance: spread.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
            log_mean: logarithms.mean,
            log_deviation: logarithms.deviation,
        });
        let shapes = kept.iter().filter(|kept| !**kept).count();
        HeldOutStatistics {
            method,
            seed: Some(seed),
            novelty: ascending(chosen(&measures, &kept).collect()),
            t_squared: distances.map(|values| measure(logarithms(&values), values)),
            residuals: measure(novelty.residuals, residuals),
            gross_errors: typical.map(|_| GrossErrors { shapes, scores }),
        }
    }
}

/// The values that are kept.
fn chosen<'a>(values: &'a [f64], kept: &'a [bool]) -> impl Iterator<Item = f64> {
    values.iter().zip(kept).filter(|(_, kept)| **kept).map(|(value, _)| *value)
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
    fn parts_and_trainings_are_bounded() {
        assert_eq!([5, 20, 100, 400, 401].map(parts), [(5, 5), (10, 10), (5, 5), (5, 5), (5, 1)]);
        let components = Method::FunctionalPca { components: 3, centre: true };
        assert_eq!([3, 20, 400, 401].map(|count| trainings(&components, true, count)), [0, 10, 5, 0]);
        assert_eq!(trainings(&components, false, 20), 0);
    }

    /// The stored values match the measures from which they were computed.
    #[test]
    fn the_record_is_in_order() {
        let found = HeldOut { distances: Some(vec![3.0, 1.0, 1e300]), residuals: vec![0.1, 0.3, 0.2] };
        let posed = vec![1.0, 2.0, 3.0];
        let held = HeldShapes { posed, scores: vec![vec![1.0]; 3], found };
        let record = held.record(HoldOut::LeaveOneOut, 7);
        assert_eq!((record.seed, &record.gross_errors), (Some(7), &None));
        assert_eq!(record.residuals.values, [0.1, 0.2, 0.3]);
        assert_eq!(record.t_squared.unwrap().values, [1.0, 3.0, MOST]);
        assert!(record.novelty.len() == 3 && record.novelty.is_sorted());
    }
}
