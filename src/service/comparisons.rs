//! Groups of shapes of a cohort, compared: at once when that is quick, else as a job.
//!
//! A plan fixes everything that the result depends on, among it the revision of the cohort.

use std::collections::{BTreeMap, HashMap};

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::compute::Setup;
use super::error::Fault;
use super::estimate::{Estimate, TestWork};
use super::jobs::JobContext;
use super::members::{self, Aligned, Attribute, KnownAttributes, MOST_PERMUTATIONS};
use super::planned::PlannedTest;
use super::{App, ServiceError, cohorts};
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::alignment::{Alignment, Method, unwhitened};
use crate::analysis::correspondence::Mirror;
use crate::analysis::inference::comparison::{PairTests, Sample, Tested};
use crate::analysis::inference::permutation::{Relabellings, Tally, holm};
use crate::analysis::inference::span::Span;
use crate::analysis::mean::{MeanSpace, ProjectorSum};
use crate::analysis::metric::Metric;
use crate::analysis::transformation::{Transformation, TransformationClass};
use crate::domain::cohort::Cohort;
use crate::domain::comparison::{
    Comparison, EffectPoint, GroupRecord, OverallRecord, PairRecord, SizeDifference, SizeSummary,
    StatisticRecord, TestRecord,
};
use crate::domain::dictionary::{MeanRecord, columns_of, rows_of};
use crate::domain::job::JobKind;
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::formats::effect::{self, Effect, EffectPoint as DrawnPoint};
use crate::formats::svg::{Layer, colour};
use crate::numeric::dense::{Matrix, transpose_multiply};

/// Most groups of a comparison.
const MOST_GROUPS: usize = 50;

/// Fewest shapes of a group: one has no scatter.
const FEWEST_MEMBERS: usize = 2;

/// Longest name of a group.
const MAX_NAME_CHARS: usize = 100;

/// Most points along the shape that are answered, over all pairs.
const MOST_EFFECT_POINTS: usize = 100_000;

/// Values that a fault lists.
const NAMED_VALUES: usize = 10;

/// A group by its name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NamedGroup {
    /// Its name, 1 to 100 characters, unlike those of the others.
    pub name: String,
    /// Which shapes of the cohort.
    pub filter: ShapeFilter,
}

/// Which groups are compared.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Grouping {
    /// These.
    Named(Vec<NamedGroup>),
    /// One for every value of an attribute.
    By {
        /// `label` or `labels.<attribute>`.
        attribute: String,
        /// Which shapes.
        filter: ShapeFilter,
    },
}

/// What a client asks to be compared.
#[derive(Debug, Clone)]
pub struct Compare {
    /// Id or name of the cohort.
    pub cohort: String,
    /// The groups.
    pub grouping: Grouping,
    /// The class that is removed.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Whether mirror images may be matched; the rule of the cohort unless given.
    pub mirror: Option<Mirror>,
    /// Relabellings.
    pub permutations: usize,
    /// Seed of those that are drawn.
    pub seed: u64,
    /// Attributes within whose values labels are exchanged.
    pub strata: Vec<String>,
    /// Points along the shape; as many as control points unless given.
    pub samples: Option<usize>,
}

/// What is compared, and at which revision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    cohort: String,
    revision: u64,
    grouping: Grouping,
    transformation: Transformation,
    alignment: Alignment,
    mirror: Mirror,
    permutations: usize,
    seed: u64,
    strata: Vec<String>,
    samples: usize,
}

/// A plan that can be carried out.
#[derive(Debug)]
pub struct Prepared {
    plan: Plan,
    cohort: Cohort,
    setup: Setup,
    members: Members,
    /// Its cost.
    pub estimate: Estimate,
}

/// Shapes with their groups and strata.
#[derive(Debug)]
struct Members {
    shapes: Vec<ShapeDescription>,
    /// The filters through which they are read.
    filters: Vec<ShapeFilter>,
    names: Vec<String>,
    /// Group of every shape.
    groups: Vec<usize>,
    strata: Vec<usize>,
    left_out: usize,
}

/// Checks what is asked for.
///
/// # Errors
/// Everything that is wrong with it; a cohort that does not exist.
pub async fn prepare(app: &App, compare: Compare) -> Result<Prepared, ServiceError> {
    ServiceError::unless_empty(own_faults(&compare, app.limits.samples))?;
    let cohort = cohorts::find(app, &compare.cohort).await?;
    let plan = Plan {
        cohort: cohort.id.clone(),
        revision: cohort.revision,
        samples: compare.samples.unwrap_or(cohort.representation.size()),
        grouping: compare.grouping,
        transformation: compare.transformation,
        alignment: compare.alignment,
        mirror: compare.mirror.unwrap_or(cohort.mirror),
        permutations: compare.permutations,
        seed: compare.seed,
        strata: compare.strata,
    };
    prepare_plan(app, cohort, plan).await
}

async fn prepare_plan(app: &App, cohort: Cohort, plan: Plan) -> Result<Prepared, ServiceError> {
    let members = plan.members(app, &cohort).await?;
    let (pairs, points) = (pairs_of(members.names.len()).len(), plan.samples);
    if pairs.saturating_mul(points) > MOST_EFFECT_POINTS {
        let detail = format!(
            "{points} points for each of {pairs} pairs are too many, at most {MOST_EFFECT_POINTS} are answered"
        );
        return Err(ServiceError::invalid("/samples", detail));
    }
    let (task_app, settings) =
        (app.clone(), members::settings(&cohort, &plan.transformation, plan.alignment, plan.mirror));
    let setup = app.pool.run(move || Setup::new(&task_app, &settings)).await?;
    if setup.space.generator().is_none() && plan.samples != setup.metric.size() {
        let detail =
            format!("landmarks are compared as they are: leave it out, or give {}", setup.metric.size());
        return Err(ServiceError::invalid("/samples", detail));
    }
    let groups = members.names.len();
    let work = TestWork {
        shapes: members.shapes.len(),
        samples: plan.samples,
        permutations: plan.permutations,
        columns: if groups > 2 { groups } else { 0 },
        pairs,
        pair_shapes: members.shapes.len() * (groups - 1),
    };
    let estimate = Estimate::of_tests(&setup, &work);
    let most = app.limits.job_bytes as f64;
    if estimate.memory_bytes > most {
        let detail = format!(
            "needs {:.1e} bytes of memory for {} shapes, at most {most:.1e} are given: choose fewer shapes",
            estimate.memory_bytes, work.shapes
        );
        return Err(ServiceError::invalid("/cohort", detail));
    }
    Ok(Prepared { plan, cohort, setup, members, estimate })
}

/// What is wrong whatever the cohort is.
fn own_faults(compare: &Compare, most_samples: usize) -> Vec<Fault> {
    let mut faults = Vec::new();
    if compare.permutations > MOST_PERMUTATIONS {
        let detail = format!("is {}, must be between 0 and {MOST_PERMUTATIONS}", compare.permutations);
        faults.push(Fault::new("/permutations", detail));
    }
    if let Some(samples) = compare.samples.filter(|samples| !(1..=most_samples).contains(samples)) {
        faults.push(Fault::new("/samples", format!("is {samples}, must be between 1 and {most_samples}")));
    }
    for name in compare.strata.iter().filter(|name| Attribute::parse(name).is_none()) {
        faults.push(Fault::new("/strata", format!("'{name}' {}", Attribute::WANTED)));
    }
    match &compare.grouping {
        Grouping::By { attribute, .. } => {
            if !matches!(Attribute::parse(attribute), Some(Attribute::Label | Attribute::Labels(_))) {
                faults.push(Fault::new(
                    "/by",
                    format!("is '{attribute}', must be 'label' or 'labels.<attribute>'"),
                ));
            }
        }
        Grouping::Named(groups) => faults.extend(group_faults(groups)),
    }
    faults
}

fn group_faults(groups: &[NamedGroup]) -> Vec<Fault> {
    let mut faults = Vec::new();
    if !(2..=MOST_GROUPS).contains(&groups.len()) {
        let detail = format!("has {} groups, there must be 2 to {MOST_GROUPS}", groups.len());
        faults.push(Fault::new("/groups", detail));
    }
    for (i, group) in groups.iter().enumerate().take(MOST_GROUPS) {
        let pointer = format!("/groups/{i}/name");
        if group.name.is_empty() || group.name.chars().count() > MAX_NAME_CHARS {
            faults.push(Fault::new(pointer, format!("must have 1 to {MAX_NAME_CHARS} characters")));
        } else if groups[..i].iter().any(|other| other.name == group.name) {
            faults.push(Fault::new(pointer, format!("'{}' is the name of another group too", group.name)));
        }
    }
    faults
}

impl Plan {
    async fn members(&self, app: &App, cohort: &Cohort) -> Result<Members, ServiceError> {
        let mut members = match &self.grouping {
            Grouping::Named(groups) => named_members(app, cohort, groups).await?,
            Grouping::By { attribute, filter } => members_by(app, cohort, attribute, filter).await?,
        };
        members.strata = members::strata(&self.strata, &members.shapes)?;
        if self.permutations > 0 && members.relabellings(self, None).exchangeable() == 0 {
            let detail = "no two shapes of different groups share a stratum: no label can be exchanged";
            return Err(ServiceError::invalid("/strata", detail));
        }
        Ok(members)
    }
}

async fn named_members(app: &App, cohort: &Cohort, groups: &[NamedGroup]) -> Result<Members, ServiceError> {
    let mut described = Vec::with_capacity(groups.len());
    for (i, group) in groups.iter().enumerate() {
        described.push(members::describe(app, cohort, &group.filter, &format!("/groups/{i}/filter")).await?);
    }
    let total: usize = described.iter().map(Vec::len).sum();
    if total > app.limits.shapes {
        let detail = format!("select {total} shapes, at most {} are compared", app.limits.shapes);
        return Err(ServiceError::invalid("/groups", detail));
    }
    let mut faults = overlap_faults(groups, &described);
    for (i, (group, shapes)) in groups.iter().zip(&described).enumerate() {
        if shapes.len() < FEWEST_MEMBERS {
            faults.extend(too_few(app, cohort, i, group, shapes.len()).await?);
        }
    }
    ServiceError::unless_empty(faults)?;
    let labels = described.iter().enumerate().flat_map(|(g, shapes)| std::iter::repeat_n(g, shapes.len()));
    Ok(Members {
        groups: labels.collect(),
        shapes: described.into_iter().flatten().collect(),
        filters: groups.iter().map(|group| group.filter.clone()).collect(),
        names: groups.iter().map(|group| group.name.clone()).collect(),
        strata: Vec::new(),
        left_out: 0,
    })
}

/// Why group `i` has so few shapes: an attribute that no shape has, or too narrow a filter.
async fn too_few(
    app: &App,
    cohort: &Cohort,
    i: usize,
    group: &NamedGroup,
    found: usize,
) -> Result<Vec<Fault>, ServiceError> {
    let known = KnownAttributes::of(app, cohort).await?;
    let listed = |key: &str| known.contains(&format!("labels.{key}"));
    let unknown: Vec<&String> = group.filter.labels.keys().filter(|key| !listed(key)).collect();
    if found == 0 && !unknown.is_empty() {
        return Ok(unknown
            .into_iter()
            .map(|key| {
                let pointer = key.replace('~', "~0").replace('/', "~1");
                let detail = format!("no shape has the attribute '{key}': {known}");
                Fault::new(format!("/groups/{i}/filter/labels/{pointer}"), detail)
            })
            .collect());
    }
    let detail =
        format!("selects {found} shapes for '{}', at least {FEWEST_MEMBERS} are needed: {known}", group.name);
    Ok(vec![Fault::new(format!("/groups/{i}/filter"), detail)])
}

/// Shapes that are in several groups.
fn overlap_faults(groups: &[NamedGroup], described: &[Vec<ShapeDescription>]) -> Vec<Fault> {
    let mut first: HashMap<&str, usize> = HashMap::new();
    let mut shared: BTreeMap<(usize, usize), Vec<&ShapeDescription>> = BTreeMap::new();
    for (g, shapes) in described.iter().enumerate() {
        for shape in shapes {
            match first.get(shape.id.as_str()) {
                Some(&other) => shared.entry((g, other)).or_default().push(shape),
                None => {
                    first.insert(&shape.id, g);
                }
            }
        }
    }
    let fault = |((g, other), shapes): ((usize, usize), Vec<&ShapeDescription>)| {
        let (count, ids) = (shapes.len(), members::first_names(shapes.into_iter()));
        let detail = format!(
            "'{}' and '{}' share {count} shapes, but no shape may be of two groups: {ids}",
            groups[g].name, groups[other].name
        );
        Fault::new(format!("/groups/{g}/filter"), detail)
    };
    shared.into_iter().map(fault).collect()
}

async fn members_by(
    app: &App,
    cohort: &Cohort,
    by: &str,
    filter: &ShapeFilter,
) -> Result<Members, ServiceError> {
    let at = |detail: String| ServiceError::invalid("/by", detail);
    let attribute = Attribute::parse(by).ok_or_else(|| at(Attribute::WANTED.into()))?;
    let described = members::describe(app, cohort, filter, "/filter").await?;
    let all = described.len();
    if all == 0 {
        let known = KnownAttributes::of(app, cohort).await?;
        return Err(ServiceError::invalid("/filter", format!("selects no shape: {known}")));
    }
    let values: BTreeMap<String, usize> = described.iter().filter_map(|shape| attribute.text(shape)).fold(
        BTreeMap::new(),
        |mut counts, value| {
            *counts.entry(value).or_default() += 1;
            counts
        },
    );
    if values.len() < 2 || values.len() > MOST_GROUPS {
        let known = KnownAttributes::of(app, cohort).await?;
        let detail = match values.len() {
            0 => format!("none of {all} shapes has {by}: {known}"),
            1 => format!("all shapes that have {by} have the same value: there is one group"),
            count => format!("{by} has {count} values, at most {MOST_GROUPS} groups are compared"),
        };
        return Err(at(detail));
    }
    let lonely: Vec<&str> = values
        .iter()
        .filter(|(_, count)| **count < FEWEST_MEMBERS)
        .map(|(value, _)| value.as_str())
        .collect();
    if !lonely.is_empty() {
        let named = lonely.iter().take(NAMED_VALUES).copied().collect::<Vec<_>>().join(", ");
        let detail = format!(
            "{} values of {by} have 1 shape, every group needs at least {FEWEST_MEMBERS}: {named}",
            lonely.len()
        );
        return Err(at(detail));
    }
    let names: Vec<String> = values.into_keys().collect();
    let group = |shape: &ShapeDescription| names.binary_search(&attribute.text(shape)?).ok();
    let (shapes, groups): (Vec<_>, Vec<_>) =
        described.into_iter().filter_map(|shape| group(&shape).map(|group| (shape, group))).unzip();
    let (filters, strata, left_out) = (vec![filter.clone()], Vec::new(), all - shapes.len());
    Ok(Members { shapes, filters, names, groups, strata, left_out })
}

impl Members {
    /// Positions of the shapes of a group.
    fn of_group(&self, group: usize) -> Vec<usize> {
        (0..self.groups.len()).filter(|&k| self.groups[k] == group).collect()
    }

    /// Relabellings of all shapes, or of the two groups of a pair (whose shapes come in the order of
    /// [`Self::of_pair`]).
    fn relabellings(&self, plan: &Plan, pair: Option<(usize, usize)>) -> Relabellings {
        let (members, groups) = match pair {
            Some(pair) => (self.of_pair(pair), 2),
            None => ((0..self.groups.len()).collect(), self.names.len()),
        };
        let label = |k: usize| match pair {
            Some((_, second)) => usize::from(self.groups[k] == second),
            None => self.groups[k],
        };
        let labels = members.iter().map(|&k| label(k)).collect();
        let strata: Vec<usize> = members.iter().map(|&k| self.strata[k]).collect();
        Relabellings::new(labels, groups, &strata, plan.seed, plan.permutations)
    }

    fn of_pair(&self, (first, second): (usize, usize)) -> Vec<usize> {
        let in_it = |k: &usize| self.groups[*k] == first || self.groups[*k] == second;
        (0..self.groups.len()).filter(in_it).collect()
    }

    fn warnings(&self, plan: &Plan) -> Vec<String> {
        let mut warnings = Vec::new();
        if plan.strata.is_empty() {
            let mut sides: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
            for (shape, &group) in self.shapes.iter().zip(&self.groups) {
                sides.entry(shape.subject.as_deref().unwrap_or_default()).or_default().push(group);
            }
            sides.remove("");
            let both = sides.values().filter(|groups| groups.iter().any(|group| *group != groups[0])).count();
            if both > 0 {
                warnings.push(format!(
                    "{both} subjects have shapes in several groups: exchange labels within subjects with \
                     \"strata\": \"subject\""
                ));
            }
        }
        warnings.extend(members::subject_warning(&self.shapes, &plan.strata));
        if self.left_out > 0 {
            warnings
                .push(format!("{} shapes have no value of the attribute and are left out", self.left_out));
        }
        warnings
    }
}

/// Every two of `groups`.
fn pairs_of(groups: usize) -> Vec<(usize, usize)> {
    (0..groups).flat_map(|first| (first + 1..groups).map(move |second| (first, second))).collect()
}

impl Prepared {
    fn compare(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<Comparison, ServiceError> {
        let stop = || context.is_cancelled();
        context.report("align", 0.0, None);
        let Self { plan, cohort, setup, members, .. } = self;
        let source = (cohort, members.filters.as_slice());
        let aligned = members::read_and_align(app, handle, source, &members.shapes, setup, &stop)?;
        context.report("compare", ALIGNED, None);
        let groups = self.groups(&aligned)?;
        let parameters = members::parameters(setup, plan.samples);
        let sample = Sample {
            coordinates: Span::new(&aligned.aligned, &aligned.weights)?.scores,
            points: members::points_of(setup, &aligned.aligned, &parameters),
            dimension: setup.metric.dimension(),
            sizes: aligned.sizes.clone(),
            weights: aligned.weights.clone(),
        };
        let mut warnings = members.warnings(plan);
        warnings.extend(members::mean_warnings(&aligned.mean));
        warnings.extend(aligned.warnings.iter().cloned());
        let all = members.relabellings(plan, None);
        let overall = if groups.len() > 2 {
            let test = sample.compare_all(&all, &stop)?;
            Some(OverallRecord { pseudo_f: statistic(&test.pseudo_f), r_squared: test.r_squared })
        } else {
            None
        };
        let mut pairs = Vec::new();
        let wanted = pairs_of(groups.len());
        for (i, &pair) in wanted.iter().enumerate() {
            context.check()?;
            context.report("compare", ALIGNED + (1.0 - ALIGNED) * i as f64 / wanted.len() as f64, None);
            let relabellings = members.relabellings(plan, Some(pair));
            if plan.permutations > 0 && relabellings.exchangeable() == 0 {
                warnings.push(format!(
                    "no labels of '{}' and '{}' can be exchanged within the strata: there is no p value",
                    members.names[pair.0], members.names[pair.1]
                ));
            }
            let chosen = sample.select(&members.of_pair(pair));
            let tests = chosen.compare_pair(&relabellings, &stop)?;
            let two = (&groups[pair.0], &groups[pair.1]);
            pairs.push(self.pair(two, tests, &aligned, &parameters, relabellings.exchangeable()));
        }
        correct(&mut pairs);
        Ok(Comparison {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            length_unit: cohort.length_unit.clone(),
            transformation: plan.transformation.clone(),
            alignment: plan.alignment,
            mirror: plan.mirror,
            seed: plan.seed,
            strata: plan.strata.clone(),
            shapes: members.shapes.len(),
            left_out: members.left_out,
            exchangeable: all.exchangeable(),
            pooled: members::mean_record(&aligned.mean, setup.metric.dimension()),
            groups: groups.into_iter().map(|group| group.record).collect(),
            pairs,
            overall,
            warnings,
        })
    }

    fn groups(&self, aligned: &Aligned) -> Result<Vec<Group>, ServiceError> {
        (0..self.members.names.len()).map(|group| self.group(group, aligned)).collect()
    }

    fn group(&self, group: usize, aligned: &Aligned) -> Result<Group, ServiceError> {
        let metric = &self.setup.metric;
        let members = self.members.of_group(group);
        let weights: Vec<f64> = members.iter().map(|&k| aligned.weights[k]).collect();
        let weight: f64 = weights.iter().sum();
        let average = members::average(&aligned.aligned, &aligned.weights, &members);
        let squared = |k: usize| {
            let column = aligned.aligned.column(k);
            column.iter().zip(&average).map(|(x, m)| (x - m).powi(2)).sum::<f64>()
        };
        let spread = members.iter().map(|&k| aligned.weights[k] * squared(k)).sum::<f64>() / weight;
        let average_rows = rows_of(&unwhitened(metric, &average), metric.dimension());
        let (mean, elements) = match &self.setup.method {
            Method::Projection(class) => {
                let placed = aligned.placed.select_columns(&members);
                let (mean, elements) =
                    mean_of_space(class, placed, weights.clone(), &aligned.mean.whitened, metric)?;
                (mean, Some(elements))
            }
            Method::Procrustes(_) => {
                let control_points = average_rows.clone();
                let (eigenvalues, converged) = (Vec::new(), true);
                (MeanRecord { control_points, eigenvalues, gap: None, unique: None, converged }, None)
            }
        };
        let summary = |(m, &measure): (usize, _)| {
            let values: Vec<f64> = members.iter().map(|&k| aligned.sizes[(m, k)]).collect();
            let (mean, deviation) = members::mean_and_deviation(&values, &weights);
            SizeSummary { measure, mean, deviation }
        };
        let record = GroupRecord {
            name: self.members.names[group].clone(),
            shapes: members.len(),
            weight,
            mean,
            average: average_rows,
            spread: spread.sqrt(),
            sizes: aligned.measures.iter().enumerate().map(summary).collect(),
        };
        Ok(Group { record, average, elements })
    }

    fn pair(
        &self,
        (first, second): (&Group, &Group),
        tests: PairTests,
        aligned: &Aligned,
        parameters: &[f64],
        exchangeable: usize,
    ) -> PairRecord {
        let chordal = |(a, b): (&Matrix, &Matrix)| {
            let cosines = transpose_multiply(a, b).norm_squared() / a.ncols() as f64;
            (1.0 - cosines).max(0.0).sqrt()
        };
        let sizes = tests.sizes.iter().zip(&aligned.measures).map(|(tested, &measure)| SizeDifference {
            measure,
            difference: tested.value.unwrap_or_default(),
            test: test(tested.tally),
        });
        PairRecord {
            first: first.record.name.clone(),
            second: second.record.name.clone(),
            exchangeable,
            chordal_distance: first.elements.as_ref().zip(second.elements.as_ref()).map(chordal),
            distance: statistic(&tests.distance),
            pseudo_f: statistic(&tests.pseudo_f),
            r_squared: tests.r_squared,
            hotelling: statistic(&tests.hotelling),
            components: tests.components,
            effect: self.effect(first, &tests, parameters),
            sizes: sizes.collect(),
        }
    }

    fn effect(&self, first: &Group, tests: &PairTests, parameters: &[f64]) -> Vec<EffectPoint> {
        let (d, count) = (self.setup.metric.dimension(), parameters.len());
        let average = Matrix::from_column_slice(first.average.len(), 1, &first.average);
        let points = members::points_of(&self.setup, &average, parameters);
        let row = |values: &[f64], i: usize| (0..d).map(|c| values[c * count + i]).collect::<Vec<f64>>();
        (0..count)
            .map(|i| {
                let difference = row(&tests.effect.difference, i);
                EffectPoint {
                    parameter: parameters[i],
                    point: row(points.as_slice(), i),
                    length: difference.iter().map(|x| x * x).sum::<f64>().sqrt(),
                    difference,
                    t_squared: tests.effect.t_squared[i],
                    p: tests.effect.tallies[i].p(),
                }
            })
            .collect()
    }
}

/// Part of the progress when the shapes are aligned.
const ALIGNED: f64 = 0.2;

/// A group with what its pairs need.
struct Group {
    record: GroupRecord,
    /// Arithmetic mean of the aligned shapes, whitened.
    average: Vec<f64>,
    /// Orthonormal basis of its mean space.
    elements: Option<Matrix>,
}

/// The member of the mean space of shapes (whitened, one a column) that is nearest to `pooled`, and a basis of the space.
fn mean_of_space(
    class: &TransformationClass,
    shapes: Matrix,
    weights: Vec<f64>,
    pooled: &[f64],
    metric: &Metric,
) -> Result<(MeanRecord, Matrix), ServiceError> {
    let source = ShapesInMemory::prepared(shapes.as_slice().to_vec(), weights);
    let space = MeanSpace::new(ProjectorSum::of(&source, class, metric.len())?, REPORTED_EIGENVALUES)?;
    let control_points = rows_of(&unwhitened(metric, &space.project(pooled)), metric.dimension());
    let (gap, unique) = (Some(space.gap), Some(space.is_unique()));
    let elements = space.elements();
    let record = MeanRecord { control_points, eigenvalues: space.eigenvalues, gap, unique, converged: true };
    Ok((record, elements))
}

/// Eigenvalues of a mean space that are answered.
const REPORTED_EIGENVALUES: usize = 10;

pub(super) fn test(tally: Tally) -> TestRecord {
    let Tally { exceeding, permutations, exact } = tally;
    TestRecord { p: tally.p(), p_holm: None, exceeding, permutations, exact }
}

fn statistic(tested: &Tested) -> StatisticRecord {
    StatisticRecord { value: tested.value, test: test(tested.tally) }
}

/// Corrects the p values of every statistic, and of every size, for the number of pairs.
fn correct(pairs: &mut [PairRecord]) {
    let sizes = pairs.first().map_or(0, |pair| pair.sizes.len());
    let statistics: [fn(&mut PairRecord) -> &mut TestRecord; 3] =
        [|pair| &mut pair.distance.test, |pair| &mut pair.pseudo_f.test, |pair| &mut pair.hotelling.test];
    for of in statistics {
        correct_tests(pairs.iter_mut().map(of).collect());
    }
    for m in 0..sizes {
        correct_tests(pairs.iter_mut().map(|pair| &mut pair.sizes[m].test).collect());
    }
}

fn correct_tests(tests: Vec<&mut TestRecord>) {
    let mut tests: Vec<(f64, &mut TestRecord)> =
        tests.into_iter().filter_map(|test| test.p.map(|p| (p, test))).collect();
    let p: Vec<f64> = tests.iter().map(|(p, _)| *p).collect();
    for ((_, test), corrected) in tests.iter_mut().zip(holm(&p)) {
        test.p_holm = Some(corrected);
    }
}

impl PlannedTest for Prepared {
    type Plan = Plan;
    type Answer = Comparison;
    const KIND: JobKind = JobKind::Compare;

    fn plan(&self) -> &Plan {
        &self.plan
    }

    fn of_plan(app: &App, handle: &Handle, plan: Plan) -> Result<Self, ServiceError> {
        let cohort = members::cohort_at(app, handle, &plan.cohort, plan.revision)?;
        handle.block_on(prepare_plan(app, cohort, plan))
    }

    fn seconds(&self) -> f64 {
        self.estimate.seconds
    }

    fn answer(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<Comparison, ServiceError> {
        self.compare(app, handle, context)
    }

    fn draw(&self, answer: &Comparison) -> String {
        draw(self, answer)
    }
}

/// Colours of the groups of a drawing, over and over (colour-blind safe).
const GROUP_COLOURS: [&str; 6] = ["#4477aa", "#cc3311", "#228833", "#aa3377", "#ccbb44", "#66ccee"];

/// Picture: the averages of the groups over one another, and the effect along the first group of the pair that is
/// farthest apart.
fn draw(prepared: &Prepared, comparison: &Comparison) -> String {
    let (space, d) = (&prepared.setup.space, prepared.setup.metric.dimension());
    let layers: Vec<Layer> = comparison
        .groups
        .iter()
        .enumerate()
        .map(|(g, group)| {
            let control_points = columns_of(&group.average, d);
            let colour = GROUP_COLOURS[g % GROUP_COLOURS.len()];
            Layer::of(space, [control_points.as_slice()], colour, 1.5, 0.9)
                .named(format!("{} (n = {})", group.name, group.shapes))
        })
        .collect();
    let distance = |pair: &PairRecord| pair.distance.value.unwrap_or_default();
    let farthest = comparison.pairs.iter().max_by(|a, b| distance(a).total_cmp(&distance(b)));
    let Some(pair) = farthest else { return effect::draw("", &layers, None, &[]) };
    let points = pair.effect.iter().map(|point| DrawnPoint {
        point: point.point.clone(),
        length: point.length,
        significant: point.p.is_some_and(|p| p <= SIGNIFICANT),
    });
    let effect = Effect {
        points: points.collect(),
        closed: space.generator().is_some() && space.representation().is_closed(),
        connected: space.generator().is_some(),
        colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
    };
    let of = |name: &str, test: &TestRecord| match test.p_holm.or(test.p) {
        Some(p) => format!("{name}, p = {p:.2}").replace("p = 0.00", &format!("p = {p:.1e}")),
        None => name.to_owned(),
    };
    let mut captions = vec![
        format!("effect on {}: {} less {}", pair.first, pair.second, pair.first),
        of(&format!("distance {:.3}", distance(pair)), &pair.distance.test),
    ];
    if let Some(chordal) = pair.chordal_distance {
        captions.push(format!("chordal distance {chordal:.3}"));
    }
    captions.push(of("Hotelling", &pair.hotelling.test));
    if let Some(overall) = &comparison.overall {
        captions.push(of("all groups, pseudo-F", &overall.pseudo_f.test));
    }
    let title = format!("{} groups of {}", comparison.groups.len(), prepared.cohort.name);
    effect::draw(&title, &layers, Some(&effect), &captions)
}

/// p values at most this are drawn wide.
const SIGNIFICANT: f64 = 0.05;
