//! Repeatability of the shapes of a cohort that were taken several times of each subject.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::comparisons::{check_places, samples_fault};
use super::models::table::{having, resolved};
use super::models::{faults_of_names, refused_at};
use super::regressions::Missing;
use super::sample::strata;
use super::study::{Plan, Study, StudyKind, StudyRequest, within_memory};
use crate::analysis::drawing::repeatability::draw_repeatability;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::models::anova::Testing;
use crate::analysis::models::repeatability::{MAX_DRAWS, RepeatabilityQuestion, repeatability};
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::ShapeRepeatability;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Options of a study of repeatability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// Attribute whose values are the subjects.
    pub subject: String,
    /// Attribute whose values are the replicates.
    pub replicate: Option<String>,
    /// Attribute whose values are groups of subjects.
    pub groups: Option<String>,
    /// Treatment of shapes without a value.
    pub missing: Missing,
    /// Number of points along the shape. Default: the number of control points.
    pub samples: Option<usize>,
    /// Number of draws of subjects for intervals.
    pub bootstrap: usize,
}

impl Options {
    /// Names of the attributes, with their places in the request.
    fn names(&self) -> impl Iterator<Item = (&str, &'static str)> {
        let others = [(self.replicate.as_deref(), "/replicate"), (self.groups.as_deref(), "/groups")];
        let others = others.into_iter().filter_map(|(name, pointer)| Some((name?, pointer)));
        std::iter::once((self.subject.as_str(), "/subject")).chain(others)
    }
}

/// Shapes of a study of repeatability, with their subjects, replicates and groups.
#[derive(Debug)]
pub struct RepeatedShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    /// Values of each attribute by its place in the request.
    values: BTreeMap<&'static str, Vec<String>>,
    strata: Vec<usize>,
    samples: usize,
    left_out: usize,
}

impl StudyKind for RepeatedShapes {
    type Options = Options;
    type Record = ShapeRepeatability;
    const KIND: JobKind = JobKind::Repeatability;
    const PHASE: &'static str = "repeatability";

    fn faults(app: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let options = &request.options;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        faults.extend(request.strata_faults());
        faults.extend(faults_of_names(options.names()));
        faults.extend(samples_fault(options.samples, app.limits.samples));
        if options.groups.is_some() && options.replicate.is_none() {
            faults.push(Fault::new("/groups", "expected `replicate` with groups, got none"));
        }
        if options.bootstrap > MAX_DRAWS {
            let detail = format!("expected a number between 0 and {MAX_DRAWS}, got {}", options.bootstrap);
            faults.push(Fault::new("/bootstrap", detail));
        }
        faults
    }

    fn complete(options: &mut Options, cohort: &Cohort) {
        options.samples.get_or_insert(cohort.spec.representation.comparison_places());
    }

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let options = &plan.options;
        let described = attributes::describe(app, cohort, &options.filter, "/filter").await?;
        let all = described.len();
        if all == 0 {
            let known = KnownAttributes::of(app, cohort).await?;
            return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
        }
        let names = options.names().map(|(name, pointer)| (name, pointer.to_owned())).collect();
        let shapes = having(app, cohort, names, options.missing, described).await?;
        let text = |name: &str| {
            let attribute = resolved(name);
            let of =
                |shape| attribute.as_ref().and_then(|attribute| attribute.text(shape)).unwrap_or_default();
            shapes.iter().map(of).collect()
        };
        let values = options.names().map(|(name, pointer)| (pointer, text(name))).collect();
        let strata = strata(&plan.strata, &shapes)?;
        let samples = options.samples.unwrap_or_else(|| cohort.spec.representation.comparison_places());
        let (filter, left_out) = ([options.filter.clone()], all - shapes.len());
        Ok(Self { shapes, filter, values, strata, samples, left_out })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        check_places(self.samples, setup)?;
        let shapes = self.shapes.len();
        let different = |values: &Vec<String>| values.iter().collect::<std::collections::BTreeSet<_>>().len();
        let counts: Vec<usize> = self.values.values().map(different).collect();
        // The table has columns for subjects, replicates and their products with groups.
        let (columns, permutations) = match plan.options.replicate {
            Some(_) => {
                (counts.iter().sum::<usize>() + counts.iter().skip(1).product::<usize>(), plan.permutations)
            }
            None => (0, 0),
        };
        let work =
            TestWork { shapes, samples: self.samples, permutations, columns, pairs: 0, pair_shapes: 0 };
        let numbers = shapes as f64 * setup.measured().metric.len() as f64;
        let draws = plan.options.bootstrap as f64;
        let estimate = within_memory(app, setup, &work, "/filter")?
            .with_design(columns, 3, permutations)
            .with_work(2.0 * draws * numbers, 8.0 * (3.0 * numbers + 3.0 * draws));
        super::study::bounded(app, estimate, "/filter")
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeRepeatability, ServiceError> {
        let Study { plan, cohort, sample, .. } = study;
        let options = &plan.options;
        let values = |pointer: &str| sample.values.get(pointer).map(Vec::as_slice);
        let question = RepeatabilityQuestion {
            subjects: values("/subject").unwrap_or_default(),
            replicates: values("/replicate"),
            groups: values("/groups"),
            samples: sample.samples,
            draws: options.bootstrap,
            testing: Testing {
                permutations: plan.permutations,
                seed: plan.seed,
                strata: Some(&sample.strata),
                ..Testing::default()
            },
        };
        let found = repeatability(shapes, &question, watch);
        let mut found = found.map_err(|error| refused_at(error, &sample.shapes, "/subject"))?;
        found.warnings.splice(0..0, study.caveats());
        if sample.left_out > 0 {
            found.warnings.push(format!("{} shapes lack a value and are left out", sample.left_out));
        }
        Ok(ShapeRepeatability {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(sample.shapes.len(), sample.left_out),
            subject: options.subject.clone(),
            replicate: options.replicate.clone(),
            groups: options.groups.clone(),
            found,
        })
    }

    fn draw(study: &Study<Self>, record: &ShapeRepeatability) -> Drawing {
        let setup = &study.setup;
        draw_repeatability((&setup.space, &setup.method), &study.cohort.spec.name, &record.found)
    }
}
