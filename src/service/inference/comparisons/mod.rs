//! Comparison of groups of shapes of a cohort.
//!
//! * this file — the kind of study; `groups` — the groups and their shapes.

mod groups;

use serde::{Deserialize, Serialize};

pub use self::groups::{Grouping, NamedGroup};
use self::groups::{Members, group_faults};
use super::sample::{subject_warning, subjects};
use super::study::{Plan, Study, StudyKind, StudyRequest, refused, within_memory};
use crate::analysis::drawing::studies::draw_comparison;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::inference::compare::compare;
use crate::analysis::inference::groups::subjects_in_several_groups;
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::job::JobKind;
use crate::domain::study::Comparison;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::sampling::Places;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Maximum number of points along the shape in an answer, over all pairs.
pub(super) const MAX_EFFECT_POINTS: usize = 100_000;

/// Options of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// The groups.
    pub grouping: Grouping,
    /// Number of points along the shape. Default: the number of control points.
    pub samples: Option<usize>,
}

/// Shapes of a comparison, in groups.
#[derive(Debug)]
pub struct ComparedShapes {
    members: Members,
    strata: Vec<usize>,
    /// Number of points along the shape.
    samples: usize,
}

impl StudyKind for ComparedShapes {
    type Options = Options;
    type Record = Comparison;
    const KIND: JobKind = JobKind::Compare;
    const PHASE: &'static str = "compare";

    fn faults(app: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(samples_fault(request.options.samples, app.limits.samples));
        faults.extend(request.strata_faults());
        faults.extend(group_faults(&request.options.grouping));
        faults
    }

    fn complete(options: &mut Options, cohort: &Cohort) {
        options.samples.get_or_insert(cohort.spec.representation.comparison_places());
    }

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let members = Members::of(app, cohort, &plan.options.grouping).await?;
        let strata = super::sample::strata(&plan.strata, &members.shapes)?;
        let relabellings = members.groups.relabellings(plan.draws(&strata));
        if plan.permutations > 0 && relabellings.exchangeable() == 0 {
            let detail = "no two shapes of different groups share a stratum: no labels can be exchanged";
            return Err(ServiceError::invalid("/strata", detail));
        }
        let samples = plan.options.samples.unwrap_or_else(|| cohort.spec.representation.comparison_places());
        let pairs = members.groups.pairs().len();
        if pairs.saturating_mul(samples) > MAX_EFFECT_POINTS {
            let detail = format!(
                "expected at most {MAX_EFFECT_POINTS} points over all pairs, got {samples} for each of {pairs} \
                 pairs"
            );
            return Err(ServiceError::invalid("/samples", detail));
        }
        Ok(Self { members, strata, samples })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.members.shapes, filters: &self.members.filters }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        check_places(self.samples, setup)?;
        let (shapes, groups) = (self.members.shapes.len(), self.members.groups.names.len());
        let work = TestWork {
            shapes,
            samples: self.samples,
            permutations: plan.permutations,
            columns: if groups > 2 { groups } else { 0 },
            pairs: self.members.groups.pairs().len(),
            pair_shapes: shapes * (groups - 1),
        };
        within_memory(app, setup, &work, "/cohort")
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<Comparison, ServiceError> {
        let Study { plan, cohort, sample, .. } = study;
        let Self { members, strata, samples } = sample;
        let found = compare(shapes, &members.groups, plan.draws(strata), *samples, watch);
        let mut found = found.map_err(|error| refused(error, "/groups"))?;
        found.warnings = [study.caveats(), sample.warnings(&plan.strata), found.warnings].concat();
        Ok(Comparison {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            length_unit: cohort.spec.shown_unit().map(str::to_owned),
            header: plan.header(members.shapes.len(), members.left_out),
            found,
        })
    }

    fn draw(study: &Study<Self>, comparison: &Comparison) -> Drawing {
        let setup = &study.setup;
        draw_comparison(
            (&setup.space, &setup.metric, &setup.method),
            &study.cohort.spec.name,
            &comparison.found,
        )
    }
}

impl ComparedShapes {
    /// Warnings about subjects, and about shapes that are left out.
    fn warnings(&self, strata: &[String]) -> Vec<String> {
        let Members { shapes, groups, left_out, .. } = &self.members;
        let mut warnings = Vec::new();
        let both = subjects_in_several_groups(&subjects(shapes), &groups.labels);
        if strata.is_empty() && both > 0 {
            warnings.push(format!(
                "{both} subjects have shapes in several groups: exchange labels within subjects with \
                 \"strata\": \"subject\""
            ));
        }
        warnings.extend(subject_warning(shapes, strata));
        if *left_out > 0 {
            warnings.push(format!("{left_out} shapes have no value of the attribute and are left out"));
        }
        warnings
    }
}

/// Checks that shapes of the space can be compared at this number of points.
///
/// # Errors
/// Another number than the only one, at `/samples`.
pub(super) fn check_places(found: usize, setup: &Setup) -> Result<(), ServiceError> {
    let usual = setup.space.representation().comparison_places();
    match Places::rule(&setup.space) {
        Some(rule) if found != usual => {
            let detail = format!("expected {usual} or no value, got {found}: {rule}");
            Err(ServiceError::invalid("/samples", detail))
        }
        _ => Ok(()),
    }
}

/// Fault of the number of points.
pub(super) fn samples_fault(samples: Option<usize>, most: usize) -> Option<Fault> {
    let samples = samples.filter(|samples| !(1..=most).contains(samples))?;
    Some(Fault::new("/samples", format!("expected a number between 1 and {most}, got {samples}")))
}
