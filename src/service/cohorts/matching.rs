//! Which correspondence of a cohort lies nearer: some of its shapes, aligned under each that applies.
//!
//! ```text
//! v = Σ w_k ‖r̃_k − r̄‖² / (Σ w_k ‖r̄‖²)          the variance that is left, relative to the mean
//! e = (v_random − v) / (v_random − v_cyclic)     part of the variance explained by searched starts that starts as given explain
//! ```
//!
//! Searched starts always lie nearer than given ones: they are chosen so. Whether given starts mean something shows when they are
//! compared with random ones: `e` is 0 for tracings that begin anywhere, 1 where the search finds nothing better. Of
//! real sets it is .14 for cells traced by a program, which begin anywhere, and .59 for otoliths, of which some do; .71 for hearts, .78 for
//! molars and .90 for grains, whose classes are told better by the given starts; and 1.00 for wings.

use serde::Serialize;

use super::source;
use super::{attributes, catalogue, measures};
use crate::analysis::alignment::Alignment;
use crate::analysis::conversion::{Conversion, given_points};
use crate::analysis::correspondence::Correspondence;
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::geometry::capability::domain::Domain;
use crate::geometry::resample::RepeatedPoints;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cost::requests::{self, Counts};
use crate::service::statistics::{CheckedSettings, Settings, Setup};

/// Numbers of shapes that may be looked at.
const SAMPLES: std::ops::RangeInclusive<usize> = 3..=500;
/// Default number of shapes that are looked at.
pub const USUAL_SAMPLE: usize = 100;
/// Part of the variance explained by searched starts from which given ones are recommended.
const EXPLAINED: f64 = 0.65;
/// Factor of the variance from which the parameters of surfaces should move, as for the warning of their means.
const TURNED: f64 = 1.25;

/// Request for a comparison.
#[derive(Debug)]
pub struct MatchingRequest {
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits. Default: [`Alignment::usual`].
    pub alignment: Option<Alignment>,
    /// Filter that selects shapes.
    pub filter: ShapeFilter,
    /// Number of shapes that are looked at.
    pub sample: usize,
    /// Seed of the choice of shapes, and of random starts.
    pub seed: u64,
}

/// How near shapes lie under a correspondence.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MatchingFound {
    /// The correspondence.
    correspondence: Correspondence,
    /// Weighted mean squared distance of the aligned shapes from their mean, divided by the squared norm of the mean.
    residual_variance: f64,
    /// Part of the gain of searched starts that the starts as given have already: 0 for random starts, 1 where the
    /// search finds nothing better. Null for surfaces and open curves.
    #[schema(required = true)]
    explained: Option<f64>,
    /// Predicted processor time of a mean of the whole cohort, in seconds.
    seconds: f64,
}

/// Which correspondence lies nearer.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MatchingAnswer {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    cohort_revision: u64,
    /// Correspondence of the cohort.
    present: Correspondence,
    /// The correspondence that is recommended.
    recommended: Correspondence,
    /// Number of shapes that were looked at.
    sample: usize,
    /// Seed of the choice of shapes, and of random starts.
    seed: u64,
    /// Residual variance of closed curves that begin anywhere. Null for surfaces and open curves.
    #[schema(required = true)]
    random_variance: Option<f64>,
    /// One entry for each correspondence that applies, from the least freedom to the most.
    matchings: Vec<MatchingFound>,
    /// Limitations of the numbers.
    warnings: Vec<String>,
}

/// Tries the correspondences of a cohort on some of its shapes, which `seed` chooses by their ids.
///
/// # Errors
/// [`ServiceError::NotFound`]; a sample out of bounds; shapes for which there is no choice; too few or degenerate shapes; more work
/// than a request may take.
pub async fn compare(app: &App, key: &str, request: MatchingRequest) -> Result<MatchingAnswer, ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    if !SAMPLES.contains(&request.sample) {
        let (least, most) = SAMPLES.into_inner();
        let detail = format!("expected a number between {least} and {most}, got {}", request.sample);
        return Err(ServiceError::invalid("/sample", detail));
    }
    let candidates = candidates(&cohort)?;
    measures::complete_for(app, &cohort, &request.filter).await?;
    let described = attributes::describe(app, &cohort, &request.filter, "/filter").await?;
    let chosen = chosen(described.into_iter().map(|shape| shape.id), &request);
    if chosen.len() < *SAMPLES.start() {
        return Err(ServiceError::TooFewShapes { found: chosen.len(), needed: *SAMPLES.start() });
    }
    let shapes = source::find_all(app, &cohort, &chosen).await?;
    let settings = |correspondence| request.settings(&cohort, correspondence).checked(&app.limits);
    let tried: Vec<(Correspondence, CheckedSettings)> =
        candidates.iter().map(|&one| Ok((one, settings(one)?))).collect::<Result<_, ServiceError>>()?;
    let counts = Counts::for_cohort(&cohort, &app.limits);
    let some = counts.with_shapes(shapes.len());
    let one = |(_, settings): &(Correspondence, CheckedSettings)| requests::align(settings, some);
    // Random starts cost as much as given ones.
    let work = tried.iter().map(one).chain(tried.first().map(one)).fold(Work::MOMENT, |sum, one| sum + one);
    work.check(app.limits.request_work.as_secs_f64())?;
    let whole = tried.iter().map(|(_, settings)| requests::align(settings, counts).seconds()).collect();
    let (task_app, task_cohort) = (app.clone(), cohort.clone());
    let seed = request.seed;
    let pool = app.pool.weighing(work);
    let trial =
        move || Trial { app: &task_app, cohort: &task_cohort, shapes: &shapes, seed }.run(tried, whole);
    pool.run(trial).await
}

impl MatchingRequest {
    fn settings(&self, cohort: &Cohort, correspondence: Correspondence) -> Settings {
        let spec = &cohort.spec;
        let usual = Alignment::usual(&self.transformation, spec.representation.dimension());
        Settings {
            representation: spec.representation.clone(),
            correspondence,
            direction: spec.direction,
            mirror: spec.mirror,
            transformation: self.transformation.clone(),
            alignment: self.alignment.unwrap_or(usual),
            frame: Frame::default(),
            estimator: Estimator::Plain,
        }
    }
}

/// The correspondences that apply to the shapes of a cohort, from the least freedom to the most. Points of contours that were resampled
/// are landmarks no longer.
fn candidates(cohort: &Cohort) -> Result<Vec<Correspondence>, ServiceError> {
    let domain = cohort.spec.representation.domain();
    let all = [Correspondence::Landmarks, Correspondence::ArcLength, Correspondence::Cyclic];
    let stored = cohort.spec.correspondence;
    let applies = |one: &Correspondence| {
        let resampled = domain.is_line() && *one == Correspondence::Landmarks && stored != *one;
        one.fault(domain).is_none() && !resampled
    };
    let found: Vec<Correspondence> = all.into_iter().filter(applies).collect();
    if found.len() < 2 {
        let detail = "expected a cohort with a choice of correspondences: curves that were not resampled, closed curves, or spheres, \
                      cylinders and tori";
        return Err(ServiceError::parameter("cohort", detail));
    }
    Ok(found)
}

/// A number between 0 and 1 for a shape, from its id and a seed.
fn drawn(seed: u64, purpose: &str, id: &str) -> f64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(purpose.as_bytes());
    hasher.update(id.as_bytes());
    let mut bytes = [0; 8];
    hasher.finalize_xof().fill(&mut bytes);
    (u64::from_le_bytes(bytes) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Ids of the shapes that are looked at, in an order that depends on the ids and the seed alone.
fn chosen(ids: impl Iterator<Item = String>, request: &MatchingRequest) -> Vec<String> {
    let mut drawn: Vec<(f64, String)> = ids.map(|id| (drawn(request.seed, "choice", &id), id)).collect();
    drawn.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
    drawn.into_iter().take(request.sample).map(|(_, id)| id).collect()
}

/// Shapes that are tried under several correspondences.
struct Trial<'a> {
    app: &'a App,
    cohort: &'a Cohort,
    shapes: &'a [Shape],
    seed: u64,
}

impl Trial<'_> {
    fn run(
        &self,
        tried: Vec<(Correspondence, CheckedSettings)>,
        seconds: Vec<f64>,
    ) -> Result<MatchingAnswer, ServiceError> {
        let closed = self.cohort.spec.representation.domain() == Domain::Line { closed: true };
        let arc = tried.iter().find(|(one, _)| *one == Correspondence::ArcLength).filter(|_| closed);
        let random = arc.map(|(_, settings)| self.variance(settings.clone(), true)).transpose()?;
        let mut found = Vec::new();
        for ((correspondence, settings), seconds) in tried.into_iter().zip(seconds) {
            let residual_variance = self.variance(settings, false)?;
            found.push(MatchingFound { correspondence, residual_variance, explained: None, seconds });
        }
        let searched = found.last().map_or(0.0, |last| last.residual_variance);
        if let Some(random) = random {
            let gained = random - searched;
            for one in &mut found {
                one.explained =
                    Some(if gained > 0.0 { (random - one.residual_variance) / gained } else { 1.0 });
            }
        }
        Ok(MatchingAnswer {
            cohort: self.cohort.id.clone(),
            cohort_revision: self.cohort.revision,
            present: self.cohort.spec.correspondence,
            recommended: recommended(&found),
            sample: self.shapes.len(),
            seed: self.seed,
            random_variance: random,
            matchings: found,
            warnings: self.warnings(closed),
        })
    }

    /// Variance that is left under some settings; with `random` starts, those of the shapes are not looked at.
    fn variance(&self, settings: CheckedSettings, random: bool) -> Result<f64, ServiceError> {
        let setup = Setup::new(self.app, settings)?;
        let context = self.app.pool.context();
        let (mut control_points, mut weights) = (Vec::new(), Vec::new());
        for shape in self.shapes {
            context.check()?;
            control_points.extend(self.placed(&setup, shape, random)?);
            weights.push(shape.attributes.weight);
        }
        let stop = || context.is_cancelled();
        Ok(setup.mean_and_variance(control_points, &weights, &stop)?.1)
    }

    /// Control points of a shape as another correspondence would have stored it.
    fn placed(&self, setup: &Setup, shape: &Shape, random: bool) -> Result<Vec<f64>, ServiceError> {
        let (space, correspondence) = (&setup.space, setup.correspondence());
        if !space.domain().is_line() || correspondence == Correspondence::Landmarks {
            return Ok(shape.control_points.clone());
        }
        let (size, dimension) = (space.representation().size(), space.representation().dimension());
        let mut beginning = shape.measures.beginning.unwrap_or_default();
        if random {
            beginning.start = drawn(self.seed, "start", &shape.id);
        }
        let stored = Matrix::from_column_slice(size, dimension, &shape.control_points);
        let points = given_points(space, &stored, beginning)
            .ok_or_else(|| ServiceError::Internal("a curve without a curve".into()))?;
        let direction = self.cohort.spec.direction;
        let conversion =
            Conversion { space, correspondence, direction, repeated_points: RepeatedPoints::Drop };
        let converted = conversion.interpolate(points);
        let converted = converted.map_err(|fault| {
            ServiceError::invalid("", format!("the shape '{}': {}", shape.id, fault.detail))
        })?;
        Ok(converted.control_points.as_slice().to_vec())
    }

    fn warnings(&self, closed: bool) -> Vec<String> {
        let searched = self.cohort.spec.correspondence == Correspondence::Cyclic;
        let unknown = self.shapes.iter().filter(|shape| shape.measures.beginning.is_none()).count();
        let some = closed && searched && unknown > 0;
        let all = self.shapes.len();
        some.then(|| {
            format!(
                "where {unknown} of {all} contours began is not known, since an earlier version has stored them: arc_length is tried \
                 from their canonical starts"
            )
        })
        .into_iter()
        .collect()
    }
}

/// The correspondence with the least freedom that explains enough; for surfaces and open curves that leaves little more than the
/// nearest.
fn recommended(found: &[MatchingFound]) -> Correspondence {
    let nearest = found.iter().map(|one| one.residual_variance).fold(f64::MAX, f64::min);
    let enough = |one: &&MatchingFound| match one.explained {
        Some(explained) => explained >= EXPLAINED,
        None => one.residual_variance <= TURNED * nearest,
    };
    found.iter().find(enough).or(found.last()).map_or_else(Correspondence::default, |one| one.correspondence)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(
        correspondence: Correspondence,
        residual_variance: f64,
        explained: Option<f64>,
    ) -> MatchingFound {
        MatchingFound { correspondence, residual_variance, explained, seconds: 1.0 }
    }

    #[test]
    fn the_least_freedom_that_explains_enough_is_recommended() {
        let curves = |explained| {
            [
                found(Correspondence::ArcLength, 0.08, Some(explained)),
                found(Correspondence::Cyclic, 0.05, Some(1.0)),
            ]
        };
        assert_eq!(recommended(&curves(0.13)), Correspondence::Cyclic);
        assert_eq!(recommended(&curves(0.8)), Correspondence::ArcLength);
        let surfaces =
            |given| [found(Correspondence::Landmarks, given, None), found(Correspondence::Cyclic, 0.1, None)];
        assert_eq!(recommended(&surfaces(0.12)), Correspondence::Landmarks);
        assert_eq!(recommended(&surfaces(0.2)), Correspondence::Cyclic);
    }

    #[test]
    fn shapes_are_drawn_by_their_ids_whatever_their_order() {
        let request = |seed| MatchingRequest {
            transformation: Transformation::Named(crate::analysis::transformation::ClassName::Similarity),
            alignment: None,
            filter: ShapeFilter::default(),
            sample: 5,
            seed,
        };
        let ids: Vec<String> = (0..40).map(|k| format!("shp_{k}")).collect();
        let forwards = chosen(ids.iter().cloned(), &request(1));
        assert_eq!(forwards, chosen(ids.iter().rev().cloned(), &request(1)));
        assert_ne!(forwards, chosen(ids.into_iter(), &request(2)));
        assert_eq!(forwards.len(), 5);
    }
}
