//! Caveats of a selection of shapes of a cohort, which everything that is computed of them answers.
//!
//! * curves of both directions where the direction counts;
//! * surfaces with poles that came as meshes: parameters were computed for each alone, so a mean of control points differs from a mean of
//!   shapes unless the job `correspond` has moved the parameters, or the client knows that they correspond.

use std::sync::Arc;

use super::directed;
use crate::analysis::correspondence::{Correspondence, Mirror};
use crate::analysis::matching::Disagreement;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{ShapeDescription, ShapeMeasures};
use crate::geometry::capability::domain::Domain;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::shapes::directions::{Rule, Ways, have_direction};
use crate::store::{Revisions, Tally};

/// A tally that is remembered.
struct Counted(Tally);

impl Cached for Counted {
    const NAME: &'static str = "tallies";

    fn bytes(&self) -> usize {
        128
    }
}

/// Counts the shapes of a cohort that pass the filter at its revision.
async fn tally(app: &App, cohort: &Cohort, filter: &ShapeFilter) -> Result<Tally, ServiceError> {
    let key = (cohort.revision, filter);
    if let Some(known) = app.cache.find::<Counted>(&cohort.id, &key) {
        return Ok(known.0);
    }
    directed::complete(app, cohort).await?;
    let found = app.store.tally(&cohort.id, Revisions::until(cohort.revision), filter).await?;
    app.cache.keep(&cohort.id, &key, &Arc::new(Counted(found)));
    Ok(found)
}

/// Whether parameters of meshes are computed for shapes of the cohort, and compared as they are.
fn compares_meshes(cohort: &Cohort) -> bool {
    let representation = &cohort.spec.representation;
    let has_poles = match representation.domain() {
        Domain::Sheet { extent, .. } => extent.topology.has_poles(),
        Domain::Points | Domain::Line { .. } | Domain::Vertices => false,
    };
    has_poles && cohort.spec.correspondence == Correspondence::Landmarks
}

/// A warning of curves of both directions among the shapes that pass the filter, if it matters.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn of_directions(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    mirror: Mirror,
) -> Result<Option<String>, ServiceError> {
    let rule = Rule::of(&cohort.spec, mirror);
    if !have_direction(&cohort.spec.representation) || !rule.counts() {
        return Ok(None);
    }
    let Tally { clockwise, counter_clockwise, .. } = tally(app, cohort, filter).await?;
    Ok(rule.warning(Ways { clockwise, counter_clockwise }))
}

/// A sentence about the surfaces that came as meshes among the shapes that pass the filter, if there are any.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn of_meshes(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
) -> Result<Option<String>, ServiceError> {
    if !compares_meshes(cohort) {
        return Ok(None);
    }
    let Tally { fitted, shapes, .. } = tally(app, cohort, filter).await?;
    Ok(meshes(cohort, fitted, shapes))
}

/// A sentence about `fitted` of `shapes` surfaces that came as meshes.
fn meshes(cohort: &Cohort, fitted: u64, shapes: u64) -> Option<String> {
    let name = &cohort.spec.name;
    (fitted > 0 && shapes > 1).then(|| {
        format!(
            "{fitted} of {shapes} surfaces came as meshes, and parameters were computed for each by itself, so that equal \
             parameters do not mean equal places: POST /v1/cohorts/{name}/correspond makes a cohort in which they do"
        )
    })
}

/// All caveats of these shapes of a cohort.
pub(crate) fn of_descriptions(cohort: &Cohort, shapes: &[ShapeDescription], mirror: Mirror) -> Vec<String> {
    of_measures(cohort, shapes.iter().map(|shape| &shape.measures), mirror)
}

/// All caveats of shapes of a cohort with these measures.
pub(crate) fn of_measures<'a>(
    cohort: &Cohort,
    measures: impl Iterator<Item = &'a ShapeMeasures> + Clone,
    mirror: Mirror,
) -> Vec<String> {
    let directions = Rule::of(&cohort.spec, mirror).warning(Ways::of_measures(measures.clone()));
    let fitted = measures.clone().filter(|measures| measures.fit.is_some()).count() as u64;
    let fitted = if compares_meshes(cohort) { fitted } else { 0 };
    directions.into_iter().chain(meshes(cohort, fitted, measures.count() as u64)).collect()
}

/// All caveats of the shapes that pass the filter.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn of_selection(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    mirror: Mirror,
) -> Result<Vec<String>, ServiceError> {
    let directions = of_directions(app, cohort, filter, mirror).await?;
    let meshes = of_meshes(app, cohort, filter).await?;
    Ok(directions.into_iter().chain(meshes).collect())
}

/// Why a mean or a dictionary of the shapes is refused unless the request says that their parameters correspond.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn refusal(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
) -> Result<Option<String>, ServiceError> {
    let found = of_meshes(app, cohort, filter).await?;
    Ok(found.map(|found| {
        format!(
            "expected surfaces whose parameters correspond, or true to say that they do, got others: {found}"
        )
    }))
}

/// A warning of surfaces whose parameters disagree with those of their mean.
pub(crate) fn of_parameters(found: Option<Disagreement>) -> Option<String> {
    let Disagreement { looked_at, disagreeing } = found.filter(|found| found.disagreeing > 0)?;
    Some(format!(
        "the parameterisations of {disagreeing} of {looked_at} surfaces that were looked at disagree with that of the \
         mean, which is then no mean of their shapes: use the correspondence \"cyclic\", or for spheres \
         POST /v1/cohorts/{{cohort}}/correspond"
    ))
}
