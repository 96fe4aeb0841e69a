//! Modularity of the shapes of a cohort.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::blocks::refused;
use super::parts::PartSpec;
use super::sample::subject_warning;
use super::study::{Plan, Study, StudyKind, StudyRequest, bounded, within_memory};
use crate::analysis::blocks::modularity::{
    CovarianceRatio, MIN_POINTS, ModularityQuestion, PointExchange, modularity,
};
use crate::analysis::blocks::parts::part_of;
use crate::analysis::drawing::blocks::draw_modules;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::{AlignedShapes, mean_warnings};
use crate::analysis::models::effect_size::Transform;
use crate::analysis::rows::rows_of;
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::ShapeModularity;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::representation::ShapeSpace;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Maximum number of modules.
const MAX_MODULES: usize = 50;

/// Options of a test of modularity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// The modules by their names.
    pub modules: BTreeMap<String, PartSpec>,
    /// Form of the ratio.
    pub cr: CovarianceRatio,
    /// Transformation of Z.
    pub z: Transform,
}

/// Shapes whose parts may be modules.
#[derive(Debug)]
pub struct ModularShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
}

impl StudyKind for ModularShapes {
    type Options = Options;
    type Record = ShapeModularity;
    const KIND: JobKind = JobKind::Modularity;
    const PHASE: &'static str = "modularity";

    fn faults(_: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let modules = &request.options.modules;
        let mut faults: Vec<Fault> = request.permutations_fault().into_iter().collect();
        if !request.strata.is_empty() {
            let detail = "expected no strata: points are exchanged, not shapes";
            faults.push(Fault::new("/strata", detail));
        }
        if !(2..=MAX_MODULES).contains(&modules.len()) {
            let detail = format!("expected 2 to {MAX_MODULES} modules, got {}", modules.len());
            faults.push(Fault::new("/modules", detail));
        }
        faults.extend(modules.iter().flat_map(|(name, part)| part.faults(&pointer(name))));
        faults
    }

    fn complete(_: &mut Options, _: &Cohort) {}

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let shapes = selected(app, cohort, &plan.options.filter).await?;
        Ok(Self { shapes, filter: [plan.options.filter.clone()] })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        labels(&plan.options.modules, &setup.space)?;
        if plan.permutations > 0 {
            PointExchange::of(setup.space.domain())
                .map_err(|error| ServiceError::invalid("/permutations", error.to_string()))?;
        }
        let shapes = self.shapes.len();
        let work = TestWork { shapes, samples: 0, permutations: 0, columns: 0, pairs: 0, pair_shapes: 0 };
        let estimate = within_memory(app, setup, &work, "/filter")?;
        let (size, dimension) = (setup.metric.size(), setup.metric.dimension());
        bounded(app, estimate.with_points(size, dimension, plan.permutations), "/modules")
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeModularity, ServiceError> {
        let Study { plan, cohort, sample, setup, .. } = study;
        let options = &plan.options;
        let names: Vec<String> = options.modules.keys().cloned().collect();
        let labels = labels(&options.modules, &setup.space)?;
        let exchange = match plan.permutations {
            0 => None,
            _ => Some(
                PointExchange::of(setup.space.domain()).map_err(|error| refused(error, "/permutations"))?,
            ),
        };
        let question = ModularityQuestion {
            cr: options.cr,
            names: &names,
            labels: &labels,
            exchange,
            permutations: plan.permutations,
            seed: plan.seed,
            transform: options.z,
            given: None,
        };
        let (all, dimension): (Vec<usize>, _) = ((0..labels.len()).collect(), setup.metric.dimension());
        let points = part_of(shapes, &all, false, watch).map_err(|error| refused(error, "/modules"))?;
        let mut found = modularity(&points, dimension, &shapes.weights, &question, watch)
            .map_err(|error| refused(error, "/modules"))?;
        found.average = rows_of(points.column_mean().as_slice(), dimension);
        found.warnings = [study.caveats(), mean_warnings(&shapes.mean), found.warnings].concat();
        found.warnings.extend(subject_warning(&sample.shapes, &plan.strata));
        Ok(ShapeModularity {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(sample.shapes.len(), 0),
            found,
        })
    }

    fn draw(study: &Study<Self>, record: &ShapeModularity) -> Drawing {
        let title = format!("modules of {} shapes of {}", record.header.shapes, study.cohort.spec.name);
        draw_modules((&study.setup.space, &study.setup.method), &title, &record.found)
    }
}

/// Pointer of a module.
fn pointer(name: &str) -> String {
    format!("/modules/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// Module of each control point; the number of modules for points of none.
fn labels(modules: &BTreeMap<String, PartSpec>, space: &ShapeSpace) -> Result<Vec<usize>, ServiceError> {
    let mut labels = vec![modules.len(); space.representation().size()];
    for (module, (name, part)) in modules.iter().enumerate() {
        let pointer = pointer(name);
        for k in part.indices(space, MIN_POINTS, &pointer)? {
            if labels[k] < modules.len() {
                let detail = format!("expected modules that share no control point, got {k} in two");
                return Err(ServiceError::invalid(pointer, detail));
            }
            labels[k] = module;
        }
    }
    Ok(labels)
}

/// All shapes that pass a filter.
///
/// # Errors
/// None passes.
pub(super) async fn selected(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    let shapes = attributes::describe(app, cohort, filter, "/filter").await?;
    if shapes.is_empty() {
        let known = KnownAttributes::of(app, cohort).await?;
        return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
    }
    Ok(shapes)
}
