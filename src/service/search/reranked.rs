//! Nearest shapes by elastic distances: those nearest modulo a class, compared elastically.

use std::collections::HashMap;

use rayon::prelude::*;

use super::distances::of_cohort;
use super::neighbours::FoundNeighbour;
use crate::analysis::elastic::curve::ElasticCurve;
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::ElasticSpace;
use crate::domain::cohort::Cohort;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::source;
use crate::service::cost::requests;
use crate::service::statistics::Setup;

/// A search whose neighbours are compared elastically.
pub(super) struct Reranking {
    space: ElasticSpace,
    candidates: usize,
    /// Control points of the queries.
    queries: Vec<f64>,
}

impl Reranking {
    /// Elastic comparison of `count` queries with these control points, each with at most `candidates` shapes of the cohort.
    ///
    /// # Errors
    /// Shapes that are not curves; more work than a request may take.
    pub(super) fn new(
        (app, cohort): (&App, &Cohort),
        setup: &Setup,
        elastic: ElasticSettings,
        (candidates, count): (usize, usize),
        queries: &[f64],
    ) -> Result<Self, ServiceError> {
        let rule = setup.rule();
        let space = ElasticSpace::new(&setup.space, rule.direction, rule.mirror, elastic);
        let space = space.map_err(|error| of_cohort(error.into()))?;
        let found = Self { space, candidates, queries: queries.to_vec() };
        // A cohort may hold fewer shapes than are asked for.
        let stored = usize::try_from(cohort.shapes).unwrap_or(usize::MAX);
        let pairs = count * candidates.min(stored);
        found.work(pairs, count + pairs.min(stored)).check(app.limits.request_work.as_secs_f64())?;
        Ok(found)
    }

    /// Work of so many pairs of so many curves.
    fn work(&self, pairs: usize, curves: usize) -> Work {
        Work::from_seconds(pairs as f64 * self.space.seconds())
            + requests::elastic_curves(curves, self.space.settings().points)
    }

    /// A warning that other shapes were not compared, if there may be some.
    pub(super) fn warning(&self, found: &[Vec<FoundNeighbour>]) -> Option<String> {
        let all = found.iter().all(|list| list.len() < self.candidates);
        (!all).then(|| {
            format!(
                "only the {} shapes nearest modulo the class were compared elastically with each query: others may be nearer; a larger \
                 \"candidates\" compares more",
                self.candidates
            )
        })
    }

    /// The neighbours by ascending elastic distance. Their placements remain those modulo the class.
    ///
    /// # Errors
    /// Curves without length; more memory than a request may take.
    pub(super) async fn run(
        self,
        app: &App,
        cohort: &Cohort,
        found: Vec<Vec<FoundNeighbour>>,
    ) -> Result<Vec<Vec<FoundNeighbour>>, ServiceError> {
        let pairs: usize = found.iter().map(Vec::len).sum();
        let mut ids: Vec<String> = found.iter().flatten().map(|neighbour| neighbour.id.clone()).collect();
        ids.sort_unstable();
        ids.dedup();
        let curves = ids.len() + found.len();
        let work = self.work(pairs, curves);
        let room = app.memory.hold(Purpose::Bodies, curves.saturating_mul(self.space.bytes()))?;
        // Shapes that were deleted meanwhile are no neighbours any more.
        let stored = source::find_each(app, cohort, &ids).await?.into_vec();
        let known = ids.into_iter().zip(stored);
        let shapes: Vec<(String, Vec<f64>)> =
            known.filter_map(|(id, shape)| Some((id, shape.ok()?.control_points))).collect();
        let task_app = app.clone();
        let task = move || {
            let _room = room;
            let context = task_app.pool.context();
            let of_shape = |error| ServiceError::from_analysis(error, |_| String::new());
            let space = &self.space;
            let queries = space.prepare(&self.queries).map_err(of_shape)?;
            let (names, points): (Vec<String>, Vec<Vec<f64>>) = shapes.into_iter().unzip();
            let prepared = space.prepare(&points.concat()).map_err(of_shape)?;
            let prepared: HashMap<String, ElasticCurve> = names.into_iter().zip(prepared).collect();
            let one = |(query, list): (&ElasticCurve, Vec<FoundNeighbour>)| {
                context.check()?;
                let compared = |neighbour: FoundNeighbour| {
                    let distance = space.compare(query, prepared.get(&neighbour.id)?).distance;
                    Some(FoundNeighbour { distance, ..neighbour })
                };
                let mut list: Vec<FoundNeighbour> = list.into_iter().filter_map(compared).collect();
                list.sort_by(|a, b| a.distance.total_cmp(&b.distance));
                Ok(list)
            };
            queries.par_iter().zip(found).map(one).collect()
        };
        app.pool.weighing(work).run(task).await
    }
}
