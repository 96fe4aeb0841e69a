//! Regression of the shapes of a cohort on an attribute: at once if it is quick, otherwise as a job.
//!
//! A plan fixes everything that the result depends on, including the revision of the cohort.

use crate::formats::fault::Fault;
use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::comparisons::test;
use super::test_sample::{self, Aligned, MAX_PERMUTATIONS};
use crate::analysis::alignment::{Alignment, unwhitened};
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::content::MeanRecord;
use crate::analysis::inference::regression::{Collinear, Design, Draws, Regression};
use crate::analysis::metric::{dot, norm};
use crate::analysis::rows::{Row, columns_of, rows_of};
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::job::JobKind;
use crate::domain::regression::{
    AttributeSummary, CovariateRecord, Prediction, RegressionScore, ShapeRegression,
};
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::geometry::drawing::svg::{self, Layer};
use crate::geometry::size::SizeMeasure;
use crate::service::app::faults::MAX_FAULTS;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, Attribute, KnownAttributes};
use crate::service::cohorts::catalogue;
use crate::service::cost::jobs::{Estimate, TestWork};
use crate::service::cost::requests;
use crate::service::jobs::inline_or_job::PlannedTest;
use crate::service::statistics::Setup;

/// Name of the natural logarithm of the centroid size as an attribute; a regression on it measures allometry.
const LOG_CENTROID_SIZE: &str = "log_centroid_size";

/// Maximum number of covariates.
const MAX_COVARIATES: usize = 20;

/// Maximum number of values of a categorical covariate.
const MAX_LEVELS: usize = 50;

/// Maximum absolute value of an attribute: its square, and the inverse of that, stay finite.
const LARGEST_VALUE: f64 = 1e100;

/// Minimum standard deviation of the attribute: the change per unit stays finite.
const SMALLEST_DEVIATION: f64 = 1e-100;

/// Quantiles of the attribute at which shapes are predicted.
const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];

/// Treatment of shapes without a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Missing {
    /// The request is refused, and these shapes are named.
    #[default]
    Refuse,
    /// These shapes are left out.
    Skip,
}

/// Request for a regression.
#[derive(Debug, Clone)]
pub struct Regress {
    /// Id or name of the cohort.
    pub cohort: String,
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// `labels.<attribute>` with numeric values, or `log_centroid_size`.
    pub attribute: String,
    /// Attributes whose effect is removed first.
    pub covariates: Vec<String>,
    /// Treatment of shapes without a value.
    pub missing: Missing,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Whether mirror images may be matched. Default: the rule of the cohort.
    pub mirror: Option<Mirror>,
    /// Number of permutations.
    pub permutations: usize,
    /// Seed of the permutations.
    pub seed: u64,
    /// Attributes that define strata: residuals are exchanged only between shapes with equal values.
    pub strata: Vec<String>,
}

/// Checked parameters of a regression, with the revision of the cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    cohort: String,
    revision: u64,
    filter: ShapeFilter,
    attribute: String,
    covariates: Vec<String>,
    missing: Missing,
    transformation: Transformation,
    alignment: Alignment,
    mirror: Mirror,
    permutations: usize,
    seed: u64,
    strata: Vec<String>,
}

/// A plan that is ready to run.
#[derive(Debug)]
pub struct Prepared {
    plan: Plan,
    cohort: Cohort,
    setup: Setup,
    shapes: Vec<ShapeDescription>,
    /// Covariates of the shapes, then the attribute.
    variables: Vec<Variable>,
    strata: Vec<usize>,
    left_out: usize,
    /// Predicted cost.
    pub estimate: Estimate,
}

/// A variable with its values; the last variable is the attribute.
#[derive(Debug, Clone, PartialEq)]
struct Variable {
    name: String,
    /// Pointer to the variable in the request.
    pointer: String,
    values: Values,
}

#[derive(Debug, Clone, PartialEq)]
enum Values {
    /// Computed when the shapes are read.
    LogCentroidSize,
    Numbers(Vec<f64>),
    /// Ascending levels, and the level of each shape.
    Levels(Vec<String>, Vec<usize>),
}

/// Checks and plans a regression.
///
/// # Errors
/// All faults of the request; a cohort that does not exist.
pub async fn prepare(app: &App, regress: Regress) -> Result<Prepared, ServiceError> {
    ServiceError::unless_empty(own_faults(&regress))?;
    let cohort = catalogue::find(app, &regress.cohort).await?;
    let plan = Plan {
        cohort: cohort.id.clone(),
        revision: cohort.revision,
        filter: regress.filter,
        attribute: regress.attribute,
        covariates: regress.covariates,
        missing: regress.missing,
        transformation: regress.transformation,
        alignment: regress.alignment,
        mirror: regress.mirror.unwrap_or(cohort.mirror),
        permutations: regress.permutations,
        seed: regress.seed,
        strata: regress.strata,
    };
    prepare_plan(app, cohort, plan).await
}

/// Faults of the request that do not depend on the cohort.
fn own_faults(regress: &Regress) -> Vec<Fault> {
    let mut faults = Vec::new();
    let attribute = &regress.attribute;
    if attribute != LOG_CENTROID_SIZE && !matches!(Attribute::parse(attribute), Some(Attribute::Labels(_))) {
        let detail = format!("expected 'labels.<attribute>' or '{LOG_CENTROID_SIZE}', got '{attribute}'");
        faults.push(Fault::new("/attribute", detail));
    }
    if regress.covariates.len() > MAX_COVARIATES {
        let detail = format!("expected at most {MAX_COVARIATES} entries, got {}", regress.covariates.len());
        faults.push(Fault::new("/covariates", detail));
    }
    for (i, name) in regress.covariates.iter().enumerate().take(MAX_COVARIATES) {
        let pointer = format!("/covariates/{i}");
        if name != LOG_CENTROID_SIZE && Attribute::parse(name).is_none() {
            let detail = format!("{}, or '{LOG_CENTROID_SIZE}', got '{name}'", Attribute::WANTED);
            faults.push(Fault::new(pointer, detail));
        } else if name == attribute || regress.covariates[..i].contains(name) {
            faults.push(Fault::new(pointer, format!("'{name}' is given twice")));
        }
    }
    if regress.permutations > MAX_PERMUTATIONS {
        let detail =
            format!("expected a number between 0 and {MAX_PERMUTATIONS}, got {}", regress.permutations);
        faults.push(Fault::new("/permutations", detail));
    }
    for name in regress.strata.iter().filter(|name| Attribute::parse(name).is_none()) {
        faults.push(Fault::new("/strata", format!("{}, got '{name}'", Attribute::WANTED)));
    }
    faults
}

async fn prepare_plan(app: &App, cohort: Cohort, plan: Plan) -> Result<Prepared, ServiceError> {
    let described = attributes::describe(app, &cohort, &plan.filter, "/filter").await?;
    let all = described.len();
    if all == 0 {
        let known = KnownAttributes::of(app, &cohort).await?;
        return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
    }
    let shapes = plan.complete(app, &cohort, described).await?;
    let variables = plan.variables(&shapes)?;
    let needed = 2 + variables.iter().map(Variable::columns).sum::<usize>();
    if shapes.len() < needed {
        let detail = format!(
            "expected at least {needed} shapes that have all values, got {}: no degree of freedom is left",
            shapes.len()
        );
        let pointer = if plan.covariates.is_empty() { "/attribute" } else { "/covariates" };
        return Err(ServiceError::invalid(pointer, detail));
    }
    let strata = test_sample::strata(&plan.strata, &shapes)?;
    if plan.permutations > 0 && !plan.strata.is_empty() {
        let distinct = strata.iter().collect::<BTreeSet<_>>().len();
        if distinct == shapes.len() {
            let detail = "no two shapes share a stratum: nothing can be exchanged";
            return Err(ServiceError::invalid("/strata", detail));
        }
    }
    let (task_app, settings) =
        (app.clone(), test_sample::settings(&cohort, &plan.transformation, plan.alignment, plan.mirror));
    let setup = app
        .pool
        .weighing(requests::space(&cohort.representation, &app.limits))
        .run(move || Setup::new(&task_app, &settings))
        .await?;
    let work = TestWork {
        shapes: shapes.len(),
        samples: 0,
        permutations: plan.permutations,
        columns: needed - 1,
        pairs: 0,
        pair_shapes: 0,
    };
    let estimate = Estimate::of_tests(&setup, &work);
    let most = app.limits.job_bytes as f64;
    if estimate.memory_bytes > most {
        let detail = format!(
            "expected a job that takes at most {most:.1e} bytes of memory, got {:.1e} for {} shapes: choose \
             fewer shapes",
            estimate.memory_bytes, work.shapes
        );
        return Err(ServiceError::invalid("/filter", detail));
    }
    // Refuse a singular design before reading the shapes, if all values are already known.
    if variables.iter().all(|variable| variable.values != Values::LogCentroidSize) {
        design(&variables, None, &vec![1.0; shapes.len()])?;
    }
    let left_out = all - shapes.len();
    Ok(Prepared { plan, cohort, setup, shapes, variables, strata, left_out, estimate })
}

impl Plan {
    /// Shapes that have all values; the others are refused or left out.
    async fn complete(
        &self,
        app: &App,
        cohort: &Cohort,
        described: Vec<ShapeDescription>,
    ) -> Result<Vec<ShapeDescription>, ServiceError> {
        let all = described.len();
        let mut faults = Vec::new();
        let mut incomplete = BTreeSet::new();
        let mut unknown = Vec::new();
        for (name, pointer) in self.names() {
            let Some(attribute) = Attribute::parse(name) else { continue };
            let is_attribute = name == self.attribute;
            let has = |shape: &ShapeDescription| {
                if is_attribute { attribute.number(shape).is_some() } else { attribute.text(shape).is_some() }
            };
            if described.iter().all(|shape| attribute.text(shape).is_none()) {
                unknown.push((name, pointer));
                continue;
            }
            for (k, shape) in described.iter().enumerate().filter(|(_, shape)| !has(shape)) {
                incomplete.insert(k);
                if faults.len() < MAX_FAULTS {
                    let what = if attribute.text(shape).is_some() { "is not a number" } else { "is missing" };
                    let detail = format!("{name} {what} on the shape '{}'", attributes::name_of(shape));
                    faults.push(Fault::new(pointer.clone(), detail).of_shape(k));
                }
            }
        }
        if !unknown.is_empty() {
            let known = KnownAttributes::of(app, cohort).await?;
            let fault = |(name, pointer)| {
                Fault::new(pointer, format!("none of the {all} shapes has {name}: {known}"))
            };
            return ServiceError::unless_empty(unknown.into_iter().map(fault).collect()).map(|()| Vec::new());
        }
        if self.missing == Missing::Refuse {
            ServiceError::unless_empty(faults)?;
        }
        let kept = described.into_iter().enumerate().filter(|(k, _)| !incomplete.contains(k));
        Ok(kept.map(|(_, shape)| shape).collect())
    }

    /// Names of covariates and attribute, with their pointers.
    fn names(&self) -> impl Iterator<Item = (&str, String)> {
        let covariates = self.covariates.iter().enumerate();
        let covariates = covariates.map(|(i, name)| (name.as_str(), format!("/covariates/{i}")));
        covariates.chain([(self.attribute.as_str(), "/attribute".to_owned())])
    }

    /// Values of covariates and attribute.
    fn variables(&self, shapes: &[ShapeDescription]) -> Result<Vec<Variable>, ServiceError> {
        let (mut variables, mut faults) = (Vec::new(), Vec::new());
        for (name, pointer) in self.names() {
            let values = match Attribute::parse(name) {
                None => Values::LogCentroidSize,
                Some(attribute) => Values::of(&attribute, shapes),
            };
            match &values {
                Values::Numbers(numbers) if numbers.iter().any(|x| x.abs() > LARGEST_VALUE) => {
                    let detail = format!("expected values within ±{LARGEST_VALUE:.0e}");
                    faults.push(Fault::new(pointer.clone(), detail));
                }
                Values::Levels(levels, _) if levels.len() > MAX_LEVELS => {
                    let detail =
                        format!("expected at most {MAX_LEVELS} values of a category, got {}", levels.len());
                    faults.push(Fault::new(pointer.clone(), detail));
                }
                _ => {}
            }
            variables.push(Variable { name: name.into(), pointer, values });
        }
        ServiceError::unless_empty(faults)?;
        Ok(variables)
    }
}

impl Values {
    /// Numbers if all values are numeric; otherwise levels.
    fn of(attribute: &Attribute, shapes: &[ShapeDescription]) -> Self {
        let numbers: Option<Vec<f64>> = shapes.iter().map(|shape| attribute.number(shape)).collect();
        if let Some(numbers) = numbers {
            return Self::Numbers(numbers);
        }
        let texts: Vec<String> =
            shapes.iter().map(|shape| attribute.text(shape).unwrap_or_default()).collect();
        let levels: Vec<String> = texts.iter().cloned().collect::<BTreeSet<_>>().into_iter().collect();
        let of_shapes = texts.iter().map(|text| levels.partition_point(|level| level < text)).collect();
        Self::Levels(levels, of_shapes)
    }
}

impl Variable {
    /// Number of columns in the design.
    fn columns(&self) -> usize {
        match &self.values {
            Values::Levels(levels, _) => levels.len().saturating_sub(1).max(1),
            _ => 1,
        }
    }

    /// Columns of the variable; those of sizes only if these are given.
    fn design(&self, sizes: Option<&[f64]>) -> Vec<Vec<f64>> {
        match &self.values {
            Values::LogCentroidSize => sizes.map(<[f64]>::to_vec).into_iter().collect(),
            Values::Numbers(numbers) => vec![numbers.clone()],
            Values::Levels(levels, of_shapes) => {
                // A category with a single value is a constant column, and is refused as such.
                let first = usize::from(levels.len() > 1);
                let indicator =
                    |level: usize| of_shapes.iter().map(move |&own| f64::from(u8::from(own == level)));
                (first..levels.len()).map(|level| indicator(level).collect()).collect()
            }
        }
    }
}

/// Why a column says nothing.
const SAYS_NOTHING: &str =
    "the covariate is constant, or a linear combination of the covariates before it: leave it out";

/// Design of `variables`, the last of which is the attribute.
fn design(variables: &[Variable], sizes: Option<&[f64]>, weights: &[f64]) -> Result<Design, ServiceError> {
    let (mut columns, mut pointers) = (Vec::new(), Vec::new());
    for variable in variables {
        let of_variable = variable.design(sizes);
        pointers.extend(std::iter::repeat_n(variable.pointer.clone(), of_variable.len()));
        columns.extend(of_variable);
    }
    let attribute = columns.pop().unwrap_or_default();
    Design::new(&columns, &attribute, weights).map_err(|collinear| match collinear {
        Collinear::Attribute => {
            let detail =
                "the attribute is constant, or a linear combination of the covariates: there is no regression on \
                 it";
            ServiceError::invalid("/attribute", detail)
        }
        Collinear::Covariate(i) => ServiceError::invalid(pointers[i].clone(), SAYS_NOTHING),
    })
}

impl Prepared {
    fn regress(
        &self,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Result<ShapeRegression, ServiceError> {
        let stop = || context.is_cancelled();
        context.report("align", 0.0, None);
        let source = (&self.cohort, std::slice::from_ref(&self.plan.filter));
        let aligned = test_sample::read_and_align(app, handle, source, &self.shapes, &self.setup, &stop)?;
        context.report("regress", 0.2, None);
        let sizes = self.log_sizes(&aligned)?;
        let design = design(&self.variables, sizes.as_deref(), &aligned.weights)?;
        let attribute = self.attribute(sizes.as_deref())?;
        let summary = self.summary(&attribute, &aligned.weights)?;
        let draws =
            Draws { strata: &self.strata, seed: self.plan.seed, permutations: self.plan.permutations };
        let found = design.regress(&aligned.aligned, &aligned.weights, draws, &stop)?;
        Ok(self.record(&aligned, &attribute, summary, found))
    }

    /// Logarithms of the centroid sizes, if requested.
    fn log_sizes(&self, aligned: &Aligned) -> Result<Option<Vec<f64>>, ServiceError> {
        if !self.variables.iter().any(|variable| variable.values == Values::LogCentroidSize) {
            return Ok(None);
        }
        let row = aligned.sizes.measures.iter().position(|&measure| measure == SizeMeasure::CentroidSize);
        let row = row.ok_or_else(|| {
            ServiceError::invalid("/cohort", "the cohort has shapes too large to be measured")
        })?;
        Ok(Some(aligned.sizes.values.row(row).iter().map(|size| size.ln()).collect()))
    }

    fn attribute(&self, sizes: Option<&[f64]>) -> Result<Vec<f64>, ServiceError> {
        let column = self.variables.last().and_then(|variable| variable.design(sizes).pop());
        column.ok_or_else(|| ServiceError::Internal("a regression without an attribute".into()))
    }

    fn summary(&self, attribute: &[f64], weights: &[f64]) -> Result<AttributeSummary, ServiceError> {
        let (mean, deviation) = test_sample::mean_and_deviation(attribute, weights);
        if deviation < SMALLEST_DEVIATION {
            let detail = format!(
                "expected a standard deviation of at least {SMALLEST_DEVIATION:.0e}: use a smaller unit"
            );
            return Err(ServiceError::invalid("/attribute", detail));
        }
        let smallest = attribute.iter().copied().fold(f64::MAX, f64::min);
        let largest = attribute.iter().copied().fold(f64::MIN, f64::max);
        Ok(AttributeSummary { name: self.plan.attribute.clone(), mean, deviation, smallest, largest })
    }

    fn record(
        &self,
        aligned: &Aligned,
        attribute: &[f64],
        summary: AttributeSummary,
        found: Regression,
    ) -> ShapeRegression {
        let all: Vec<usize> = (0..self.shapes.len()).collect();
        let average = test_sample::average(&aligned.aligned, &aligned.weights, &all);
        let slope = &found.slope;
        let moved =
            |step: f64| -> Vec<f64> { average.iter().zip(slope).map(|(a, b)| a + step * b).collect() };
        let mut sorted = attribute.to_vec();
        sorted.sort_by(f64::total_cmp);
        let prediction = |q: f64| {
            let value = quantile(&sorted, q);
            Prediction {
                quantile: q,
                attribute: value,
                control_points: self.rows(&moved(value - summary.mean)),
            }
        };
        let length = norm(slope);
        let score = |k: usize| {
            let centred: Vec<f64> =
                aligned.aligned.column(k).iter().zip(&average).map(|(y, a)| y - a).collect();
            if length > 0.0 { dot(&centred, slope) / length } else { 0.0 }
        };
        let scores = self.shapes.iter().enumerate().map(|(k, shape)| RegressionScore {
            id: shape.id.clone(),
            external_id: shape.external_id.clone(),
            attribute: attribute[k],
            score: score(k),
        });
        let mut warnings = test_sample::mean_warnings(&aligned.mean);
        warnings.extend(test_sample::subject_warning(&self.shapes, &self.plan.strata));
        if self.left_out > 0 {
            warnings.push(format!("{} shapes lack a value and are left out", self.left_out));
        }
        let plan = &self.plan;
        ShapeRegression {
            cohort: self.cohort.id.clone(),
            cohort_revision: plan.revision,
            transformation: plan.transformation.clone(),
            alignment: plan.alignment,
            mirror: plan.mirror,
            seed: plan.seed,
            strata: plan.strata.clone(),
            shapes: self.shapes.len(),
            left_out: self.left_out,
            pooled: MeanRecord::of(&aligned.mean, self.setup.metric.dimension()),
            covariates: self.covariates(),
            degrees: found.degrees,
            r_squared: found.r_squared,
            partial_r_squared: found.partial_r_squared,
            model_r_squared: found.model_r_squared,
            pseudo_f: found.pseudo_f,
            test: test(found.tally),
            average: self.rows(&average),
            change_per_unit: self.rows(slope),
            change_per_deviation: self.rows(&slope.iter().map(|b| b * summary.deviation).collect::<Vec<_>>()),
            predictions: QUANTILES.map(prediction).to_vec(),
            scores: scores.collect(),
            attribute: summary,
            warnings,
        }
    }

    fn covariates(&self) -> Vec<CovariateRecord> {
        let covariates = self.variables.iter().take(self.plan.covariates.len());
        covariates
            .map(|variable| CovariateRecord {
                name: variable.name.clone(),
                levels: match &variable.values {
                    Values::Levels(levels, _) => Some(levels.clone()),
                    _ => None,
                },
            })
            .collect()
    }

    fn rows(&self, whitened: &[f64]) -> Vec<Row> {
        rows_of(&unwhitened(&self.setup.metric, whitened), self.setup.metric.dimension())
    }
}

/// Quantile of ascending values, with linear interpolation.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let position = q * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

impl PlannedTest for Prepared {
    type Plan = Plan;
    type Answer = ShapeRegression;
    const KIND: JobKind = JobKind::Regress;

    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn of_plan(app: &App, handle: &Handle, plan: Plan) -> Result<Self, ServiceError> {
        let cohort = test_sample::cohort_at(app, handle, &plan.cohort, plan.revision)?;
        handle.block_on(prepare_plan(app, cohort, plan))
    }

    fn seconds(&self) -> f64 {
        self.estimate.seconds
    }

    fn answer(
        &self,
        app: &App,
        handle: &Handle,
        context: &JobContext,
    ) -> Result<ShapeRegression, ServiceError> {
        self.regress(app, handle, context)
    }

    fn draw(&self, answer: &ShapeRegression) -> String {
        draw(self, answer)
    }
}

/// Colours from low to high values of the attribute (colour-blind safe).
const SHADES: [&str; 7] = ["#2166ac", "#5a8fc4", "#92b7d8", "#8c8c8c", "#e2a184", "#cf6a53", "#b2182b"];

/// Drawing of the predicted shapes from the 5 % to the 95 % quantile of the attribute.
fn draw(prepared: &Prepared, regression: &ShapeRegression) -> String {
    let (space, d) = (&prepared.setup.space, prepared.setup.metric.dimension());
    let [Some(low), Some(high)] = [regression.predictions.first(), regression.predictions.last()] else {
        return svg::draw("", &[]);
    };
    let (from, to) = (columns_of(&low.control_points, d), columns_of(&high.control_points, d));
    let last = SHADES.len() - 1;
    let layers: Vec<Layer> = SHADES
        .iter()
        .enumerate()
        .map(|(i, colour)| {
            let part = i as f64 / last as f64;
            let shape: Vec<f64> = from.iter().zip(&to).map(|(a, b)| (1.0 - part) * a + part * b).collect();
            let layer = Layer::of(space, [shape.as_slice()], colour, 2.0, 1.0);
            let name = |prediction: &Prediction| {
                format!("{:.0} %: {:.4}", 100.0 * prediction.quantile, prediction.attribute)
            };
            match i {
                0 => layer.named(name(low)),
                i if i == last => layer.named(name(high)),
                _ => layer,
            }
        })
        .collect();
    let p = regression.test.p.map_or_else(String::new, |p| format!(", p = {p:.4}"));
    let title = format!(
        "{} of {} shapes of {}: R² = {:.3}{p}",
        regression.attribute.name, regression.shapes, prepared.cohort.name, regression.r_squared
    );
    svg::draw(&title, &layers)
}
