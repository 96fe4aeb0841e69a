//! Robust means: weights that take wrong shapes out of all sums.
//!
//! ```text
//! 1. median space      S̄ ← orth(Σ_k (w_k/d_k) P_k S̄),   d_k² = I − tr(P_S̄ P_k)          (Weiszfeld, from the plain mean)
//! 2. deviations        a_k = P_k m − m, scaled to the tangent space,   spatial signs a_k/‖a_k‖,   their q leading components ξ_i
//! 3. description       t_ki = ⟨ξ_i, a_k⟩,   e_k² = ‖a_k‖² − Σ_i t_ki²
//! 4. groups            shapes that keep to themselves are left out ([groups]); then 1 to 3 once more, without them
//! 5. densest majority  65 % of the weight with the least distances in t, by concentration steps
//! 6. factors           f_k = min(φ(z(distance of t_k)), φ(z(e_k))),   φ = 1 up to 3 standard deviations, 0 from 5 on
//! 7. the same          in the components of the shapes with these factors, about their mean,   φ = 1 up to 4.5, 0 from 6 on
//! 8. mirror images     shapes count by the probability that they are none ([mirrors]); then 1 to 3 and 5 to 7 once more, with it
//! ```
//!
//! Everything after that is the plain estimate with the weights `w_k f_k`: mean, components and atoms need no robust version of
//! their own, and clean shapes keep the weight one. The distances are brought to a normal distribution by the power `2/3`
//! (Wilson and Hilferty 1931), whose centre and spread come from the lower half first and then from the shapes within the limit.
//!
//! Nothing depends on the order of the shapes or on random numbers, and the sums are those of [`accumulate`](super::accumulate):
//! the same bits on any number of threads. A shape given twice counts as one of twice the weight. A robust mean takes
//! [`PASSES`] passes over the shapes, a plain one two; one that searches start points takes as many in each of a few more rounds.
//!
//! Limits: a third of the shapes may be wrong, not more; and a group of shapes that differs from all others is wrong by
//! this definition, even if it is a separate class. A compact part that is kept although it is unlike the majority is told ([`Minority`](super::factors::Minority)). Wrong shapes within the variation of the right ones cannot be told from
//! them, and hardly matter for the mean.
//!
//! Sources: Weiszfeld 1937; Locantore et al. 1999 (spatial signs); Hubert, Rousseeuw and Vanden Branden 2005 (two distances,
//! their limits); Rousseeuw and Van Driessen 1999 (concentration steps).

mod groups;
mod listed;
mod minority;
mod mirrors;
mod moments;
mod points;
mod rejection;
mod sources;
mod weiszfeld;

pub use self::listed::{LessCounted, Listed};
pub use self::points::point_weights;
pub(crate) use self::sources::Retained;

use self::mirrors::{Reflection, unmirrored};
use self::rejection::{Description, effective};
use self::sources::{ByDistance, Deviations, Reweighted, Signs};
use super::AnalysisError;
use super::accumulate::{ScatterSum, ShapeSource, accumulate, map_shapes};
use super::alignment::{
    AlignedShape, MeanShape, Method, REPORTED_EIGENVALUES, align_all_to, mean_shape, procrustes_mean,
    searched,
};
use super::factors::{Estimator, Factors};
use super::fit::Fit;
use super::frame::{Frame, canonical, representative};
use super::matching::{Matching, Placed, Placement, Target};
use super::mean::{MeanSpace, ProjectorSum};
use super::metric::{Metric, dot, norm};
use super::partial_sums::Measured;
use super::pca::SMALLEST_COMPONENT;
use super::placement_search::Found;
use super::procrustes::{self, ProcrustesMean};
use super::transformation::TransformationClass;
use shapelex_numeric::dense::{Eigenpairs, Matrix};

/// Minimum number of shapes for a robust mean: below, a majority cannot be told from the rest.
pub const MIN_SHAPES: usize = 5;

/// Number of equal weights that the weights of the shapes must be worth at least, `(Σw)²/Σw²`.
const MIN_EFFECTIVE: f64 = 3.0;

/// Passes over the shapes: plain sum, median, signs, description, scatter, description, antisymmetric parts and their scores, weighted sum,
/// frame.
pub const PASSES: usize = 1 + MEDIAN_STEPS + 8;

/// Further passes if a group of wrong shapes or mirror images are found: sum, median, signs and description without them.
pub const PASSES_WITHOUT_GROUPS: usize = MEDIAN_STEPS + 3;

/// Steps towards the median. The components that follow are centred on their own medians, so that it need not have
/// converged.
const MEDIAN_STEPS: usize = 2;

/// Maximum number of components that describe a shape. More of them would cover wrong shapes, not tell them.
const COMPONENTS: usize = 12;

/// Maximum number of numbers that describe all shapes; of very many, fewer components are kept.
const NUMBERS: usize = 1 << 25;

/// Maximum number of rounds in which placements and factors alternate, after the search of the plain mean.
const ROUNDS: usize = 16;

/// Memory of a robust mean in bytes, besides that of a plain one.
pub fn bytes(shapes: usize) -> usize {
    shapes.saturating_mul(8 * (2 * components_of(shapes) + 12))
}

fn components_of(shapes: usize) -> usize {
    COMPONENTS.min(NUMBERS / shapes.max(1)).max(1)
}

/// The mean of the shapes of `source` by `estimator`.
///
/// # Errors
/// As [`mean_shape`]; of a robust one also [`AnalysisError::TooFewShapes`] below five shapes, and [`AnalysisError::Parameter`] at
/// `robust` if their weights are worth fewer than three equal ones.
pub fn mean_by(
    estimator: Estimator,
    source: &dyn ShapeSource,
    metric: &Metric,
    method: &Method,
    frame: Frame,
    matching: &Matching,
) -> Result<MeanShape, AnalysisError> {
    if estimator == Estimator::Plain {
        return mean_shape(source, metric, method, frame, matching);
    }
    if source.count() < MIN_SHAPES {
        return Err(AnalysisError::TooFewShapes { found: source.count(), needed: MIN_SHAPES });
    }
    let measured = Measured { metric, method, matching };
    let (found, template) = match method {
        Method::Projection(class) => {
            let found = match matching.searches() {
                true => searched(source, class, matching, metric.len())?,
                false => Found::as_given(source.count()),
            };
            (found, Vec::new())
        }
        Method::Procrustes(fit) => {
            let mean = procrustes_mean(source, metric, *fit, Frame::Training, matching)?;
            let MeanShape { placements, leading, rounds, converged, whitened, .. } = mean;
            (Found { placements, leading, rounds, converged }, whitened)
        }
    };
    robust_mean(source, measured, frame, found, template)
}

/// Mean by `estimator` and aligned shapes of `control_points` in memory, as [`align_all_until`](super::alignment::align_all_until).
///
/// # Errors
/// As [`mean_by`]; [`AnalysisError::Interrupted`] once `stop` returns true.
pub fn align_all_by(
    estimator: Estimator,
    measured: Measured<'_>,
    frame: Frame,
    control_points: Vec<f64>,
    weights: Vec<f64>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(MeanShape, Vec<AlignedShape>), AnalysisError> {
    let Measured { metric, method, matching } = measured;
    align_all_to(metric, method, matching, control_points, weights, stop, |shapes| {
        mean_by(estimator, shapes, metric, method, frame, matching)
    })
}

/// The robust mean of the shapes of `source` (prepared with [`Method::translates`]): the plain mean with the factors of the module.
/// `found` is the result of the search of the plain mean, `template` the plain mean of Procrustes fits.
///
/// # Errors
/// [`AnalysisError::TooFewShapes`] below [`MIN_SHAPES`]; [`AnalysisError::Parameter`] at `robust` if the weights are worth fewer than
/// three equal ones; degenerate shapes; errors of the source.
fn robust_mean(
    source: &dyn ShapeSource,
    measured: Measured<'_>,
    frame: Frame,
    found: Found,
    template: Vec<f64>,
) -> Result<MeanShape, AnalysisError> {
    let Measured { metric, method, matching } = measured;
    let task = Task { source, metric, method, matching };
    match method {
        Method::Projection(class) => task.projection(class, frame, found),
        Method::Procrustes(fit) => task.procrustes(*fit, frame, found, template),
    }
}

/// Refuses weights without a majority.
fn check_weights(weights: &[f64]) -> Result<(), AnalysisError> {
    let worth = effective(weights);
    if worth >= MIN_EFFECTIVE {
        return Ok(());
    }
    let detail = format!(
        "expected weights that are worth at least {MIN_EFFECTIVE} equal ones, got {worth:.2}: a robust mean needs a \
         majority"
    );
    Err(AnalysisError::Parameter { field: "robust", detail })
}

/// Factors of shapes, and the probabilities that they are not mirror images, if some are.
type Judged = (Vec<f64>, Option<Vec<f64>>);

struct Task<'a> {
    source: &'a dyn ShapeSource,
    metric: &'a Metric,
    method: &'a Method,
    matching: &'a Matching,
}

impl Task<'_> {
    fn projection(
        &self,
        class: &TransformationClass,
        frame: Frame,
        mut found: Found,
    ) -> Result<MeanShape, AnalysisError> {
        let Self { source, metric, matching, .. } = *self;
        let mut start: Option<MeanSpace<'_>> = None;
        let mut standing = vec![1.0; source.count()];
        for round in 1..=ROUNDS {
            source.check()?;
            let placed = Placed { source, matching, placements: &found.placements };
            let space = match start.take() {
                Some(space) => space,
                None => {
                    let standing = Reweighted { source: &placed, factors: &standing };
                    MeanSpace::new(ProjectorSum::of(&standing, class, metric.len())?, 0)?
                }
            };
            let median = |mut space: MeanSpace<'_>, kept: &Reweighted<'_>| {
                for _ in 0..MEDIAN_STEPS {
                    space = weiszfeld::step(kept, space)?;
                }
                self.centre(kept, &space)
            };
            let all = vec![1.0; source.count()];
            let centre = median(space, &Reweighted { source: &placed, factors: &all })?;
            let factors = self.factors(&placed, centre, |kept| {
                median(MeanSpace::new(ProjectorSum::of(kept, class, metric.len())?, 0)?, kept)
            })?;
            if round == 1 && matching.searches() {
                // The search ends in one of many optima: wrong shapes have led it, so it begins again without them.
                standing = factors.factors;
                let without = Reweighted { source, factors: &standing };
                let again = searched(&without, class, matching, metric.len())?;
                (found.placements, found.rounds) = (again.placements, found.rounds + again.rounds);
                found.converged &= again.converged;
                continue;
            }
            let weighted = Reweighted { source: &placed, factors: &factors.factors };
            let sum = ProjectorSum::of(&weighted, class, metric.len())?;
            let space = MeanSpace::new(sum, REPORTED_EIGENVALUES)?;
            let moved = self.moved(&Target::subspace(&space, matching), &found.placements)?;
            if let Some(placements) = moved {
                found.rounds += 1;
                if round < ROUNDS {
                    found.placements = placements;
                    start = Some(space);
                    continue;
                }
                found.converged = false;
            }
            let target = Target::subspace(&space, matching);
            let disagreement = matching.disagreement(&placed, &target, class.translates())?;
            let whitened = representative(&space, frame, metric, &weighted)?;
            let mean = MeanShape::in_space(&space, metric, whitened, found);
            return Ok(MeanShape { disagreement, robust: Some(factors), ..mean });
        }
        unreachable!("the last round returns")
    }

    /// Whitened member of a mean space that does not change with the poses of the shapes, where the class has one.
    fn centre(&self, kept: &Reweighted<'_>, space: &MeanSpace<'_>) -> Result<Vec<f64>, AnalysisError> {
        match canonical(space, self.metric) {
            Err(AnalysisError::NoCanonicalFrame { .. }) => {
                representative(space, Frame::Training, self.metric, kept)
            }
            centre => Ok(centre?),
        }
    }

    /// The placements on `target`, if some of them differ from `standing`.
    fn moved(
        &self,
        target: &Target<'_>,
        standing: &[Placement],
    ) -> Result<Option<Vec<Placement>>, AnalysisError> {
        if !self.matching.searches() {
            return Ok(None);
        }
        let mut placements = standing.to_vec();
        let moved = self.matching.improve(self.source, target, &mut placements)?;
        Ok((!moved.is_empty()).then_some(placements))
    }

    fn procrustes(
        &self,
        fit: Fit,
        frame: Frame,
        mut found: Found,
        mut template: Vec<f64>,
    ) -> Result<MeanShape, AnalysisError> {
        let Self { source, metric, method, matching } = *self;
        for round in 1..=ROUNDS {
            source.check()?;
            let placed = Placed { source, matching, placements: &found.placements };
            let median = |mut template: Vec<f64>, kept: &Reweighted<'_>| {
                for _ in 0..MEDIAN_STEPS {
                    let near = ByDistance { source: kept, method, mean: &template };
                    template = procrustes::step(&near, fit, &template)?;
                }
                Ok::<_, AnalysisError>(template)
            };
            let all = vec![1.0; source.count()];
            template = median(template, &Reweighted { source: &placed, factors: &all })?;
            let mut nearer = None;
            let factors = self.factors(&placed, template.clone(), |kept| {
                let centre = median(procrustes::step(kept, fit, &template)?, kept)?;
                nearer = Some(centre.clone());
                Ok(centre)
            })?;
            template = nearer.unwrap_or(template);
            if round == 1 && matching.searches() {
                let without = Reweighted { source, factors: &factors.factors };
                let again = procrustes_mean(&without, metric, fit, Frame::Training, matching)?;
                (found.placements, template) = (again.placements, again.whitened);
                (found.rounds, found.converged) =
                    (found.rounds + again.rounds, found.converged && again.converged);
                continue;
            }
            let weighted = Reweighted { source: &placed, factors: &factors.factors };
            let ProcrustesMean { mean, iterations, converged } =
                procrustes::iterate(&weighted, fit, template)?;
            let moved = self.moved(&Target::shape(&mean, fit, matching), &found.placements)?;
            found.rounds = if matching.searches() { found.rounds } else { found.rounds.max(iterations) };
            if let Some(placements) = moved {
                found.rounds += 1;
                if round < ROUNDS {
                    found.placements = placements;
                    template = mean;
                    continue;
                }
                found.converged = false;
            }
            let target = Target::shape(&mean, fit, matching);
            let disagreement = matching.disagreement(&placed, &target, true)?;
            let whitened = procrustes::turn(mean, fit, frame, metric, &weighted)?;
            found.converged &= converged;
            let mean = MeanShape::fitted(metric, whitened, found);
            return Ok(MeanShape { disagreement, robust: Some(factors), ..mean });
        }
        unreachable!("the last round returns")
    }

    /// Factors of the shapes by their deviations from the whitened `centre`. Without the [groups] of wrong shapes and the mirror images
    /// ([mirrors]), if there are some, about the centre of the others, which `again` finds.
    fn factors(
        &self,
        placed: &Placed<'_>,
        centre: Vec<f64>,
        mut again: impl FnMut(&Reweighted<'_>) -> Result<Vec<f64>, AnalysisError>,
    ) -> Result<Factors, AnalysisError> {
        let mut standing = vec![1.0; placed.count()];
        let bytes = 8 * centre.len().saturating_mul(placed.count());
        let memory = self.source.reserve(bytes);
        let keep = memory.is_some();
        let kept = Reweighted { source: placed, factors: &standing };
        let away = Deviations::new(&kept, self.method, &centre, keep)?;
        let (described, components) = signs(&away)?;
        check_weights(described.weights())?;
        let weights = described.weights().to_vec();
        let without = described.outside_groups(self.start(&centre, &components));
        let (mut factors, own) = if without.contains(&0.0) {
            drop(away);
            standing = without;
            self.judged_again(placed, &standing, keep, &mut again)?
        } else {
            self.judged(&away, &described)?
        };
        if let Some(own) = own {
            standing.iter_mut().zip(own).for_each(|(standing, own)| *standing *= own);
            (factors, _) = self.judged_again(placed, &standing, keep, &mut again)?;
        }
        factors.iter_mut().zip(&standing).for_each(|(factor, standing)| *factor *= standing);
        let weighted: Vec<f64> =
            weights.iter().zip(&factors).map(|(weight, factor)| weight * factor).collect();
        let minority = described.minority(&factors);
        Ok(Factors { factors, effective: effective(&weighted), minority })
    }

    /// [`Self::judged`] about the centre of the shapes with the factors `standing`.
    fn judged_again(
        &self,
        placed: &Placed<'_>,
        standing: &[f64],
        keep: bool,
        again: &mut impl FnMut(&Reweighted<'_>) -> Result<Vec<f64>, AnalysisError>,
    ) -> Result<Judged, AnalysisError> {
        let kept = Reweighted { source: placed, factors: standing };
        let centre = again(&kept)?;
        let away = Deviations::new(&kept, self.method, &centre, keep)?;
        self.judged(&away, &signs(&away)?.0)
    }

    /// The factors of the shapes by their distances, and the probabilities that they are not mirror images, if some are.
    fn judged(&self, away: &Deviations<'_>, signs: &Description) -> Result<Judged, AnalysisError> {
        let factors = by_distance(away, signs)?;
        let own = match Reflection::new(self.method, self.matching, away.centre())? {
            Some(reflection) => unmirrored(&reflection, away, signs, &factors)?,
            None => None,
        };
        Ok((factors, own))
    }

    /// How much a later start changes the scores of a shape at `centre` in the `components`, where start points are searched. These are
    /// control points: shapes of which some are searched from the other end start half an interval apart from the others, which is no
    /// difference of shapes.
    fn start(&self, centre: &[f64], components: &Matrix) -> Option<Vec<f64>> {
        let later = self.matching.shifts().then(|| self.matching.between(centre, 0.5))?;
        let earlier = self.matching.between(centre, -0.5);
        let change: Vec<f64> = later.iter().zip(earlier).map(|(later, earlier)| later - earlier).collect();
        Some(components.column_iter().map(|xi| dot(xi.as_slice(), &change)).collect())
    }
}

/// The shapes in the leading components of their spatial signs, and these, as columns.
fn signs(away: &Deviations<'_>) -> Result<(Description, Matrix), AnalysisError> {
    let length = away.centre().len();
    let sum: ScatterSum = accumulate(&Signs(away), || ScatterSum::new(length))?;
    let leading = sum.leading(false, components_of(away.count()))?;
    description(away, &vec![0.0; length], leading)
}

/// Factors by the distances within the components of the `signs` and from them, then within those of the shapes that these keep.
fn by_distance(away: &Deviations<'_>, signs: &Description) -> Result<Vec<f64>, AnalysisError> {
    let factors = signs.factors(None);
    let near = Reweighted { source: away, factors: &factors };
    let sum: ScatterSum = accumulate(&near, || ScatterSum::new(away.centre().len()))?;
    let origin = sum.mean();
    let leading = sum.leading(true, components_of(away.count()))?;
    Ok(description(away, &origin, leading)?.0.final_factors(&factors))
}

/// The deviations less `origin`, in components with this total variance, and those components, as columns.
fn description(
    away: &Deviations<'_>,
    origin: &[f64],
    (total, pairs): (f64, Eigenpairs),
) -> Result<(Description, Matrix), AnalysisError> {
    let count = pairs.values.iter().take_while(|value| **value > SMALLEST_COMPONENT * total).count();
    let components = pairs.vectors.columns(0, count).into_owned();
    let of_origin: Vec<f64> = components.column_iter().map(|xi| dot(xi.as_slice(), origin)).collect();
    let described = map_shapes(away, |_, a, weight| {
        let scores = components.column_iter().zip(&of_origin).map(|(xi, o)| dot(xi.as_slice(), a) - o);
        let square = a.iter().zip(origin).map(|(a, o)| (a - o) * (a - o)).sum();
        Ok((scores.collect(), square, weight))
    })?;
    let shares = pairs.values[..count].iter().map(|value| value / total).collect();
    Ok((Description::new(described, shares, norm(away.centre())), components))
}
