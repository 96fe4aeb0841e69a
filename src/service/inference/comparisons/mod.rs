//! Comparison of groups of shapes of a cohort: at once if it is quick, otherwise as a job.
//!
//! * this file — the request, and the assignment of shapes to groups. A plan fixes everything that the result depends
//!   on, including the revision of the cohort;
//! * `answer` — the comparison;
//! * `drawing` — its drawing.

mod answer;
mod drawing;

use crate::formats::fault::Fault;
use std::collections::{BTreeMap, HashMap};

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

pub(crate) use self::answer::test;
use super::test_sample::{self, MAX_PERMUTATIONS};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::inference::permutation::Relabellings;
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::comparison::Comparison;
use crate::domain::job::JobKind;
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::geometry::sampling::Places;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, Attribute, KnownAttributes};
use crate::service::cohorts::catalogue;
use crate::service::cost::jobs::{Estimate, TestWork};
use crate::service::cost::requests;
use crate::service::jobs::inline_or_job::PlannedTest;
use crate::service::statistics::Setup;

/// Maximum number of groups of a comparison.
const MAX_GROUPS: usize = 50;

/// Minimum number of shapes of a group: a single shape has no scatter.
const MIN_MEMBERS: usize = 2;

/// Maximum length of a group's name.
const MAX_NAME_CHARS: usize = 100;

/// Maximum number of points along the shape in an answer, over all pairs.
const MAX_EFFECT_POINTS: usize = 100_000;

/// Maximum number of values listed in a fault.
const NAMED_VALUES: usize = 10;

/// A named group of shapes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NamedGroup {
    /// Name of the group, 1 to 100 characters, unique among the groups.
    pub name: String,
    /// Filter that selects the shapes of the group.
    pub filter: ShapeFilter,
}

/// Definition of the groups.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Grouping {
    /// Explicit groups.
    Named(Vec<NamedGroup>),
    /// One group for every value of an attribute.
    By {
        /// `label` or `labels.<attribute>`.
        attribute: String,
        /// Filter that selects the shapes.
        filter: ShapeFilter,
    },
}

/// Request for a comparison.
#[derive(Debug, Clone)]
pub struct Compare {
    /// Id or name of the cohort.
    pub cohort: String,
    /// The groups.
    pub grouping: Grouping,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Whether mirror images may be matched. Default: the rule of the cohort.
    pub mirror: Option<Mirror>,
    /// Number of permutations.
    pub permutations: usize,
    /// Seed of random permutations.
    pub seed: u64,
    /// Attributes that define strata: labels are exchanged only between shapes with equal values.
    pub strata: Vec<String>,
    /// Number of points along the shape. Default: the number of control points.
    pub samples: Option<usize>,
}

/// Checked parameters of a comparison, with the revision of the cohort.
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

/// A plan that is ready to run.
#[derive(Debug)]
pub struct Prepared {
    plan: Plan,
    cohort: Cohort,
    setup: Setup,
    members: Members,
    /// Predicted cost.
    pub estimate: Estimate,
}

/// Shapes with their groups and strata.
#[derive(Debug)]
struct Members {
    shapes: Vec<ShapeDescription>,
    /// Filters through which they are read.
    filters: Vec<ShapeFilter>,
    names: Vec<String>,
    /// Group of each shape.
    groups: Vec<usize>,
    strata: Vec<usize>,
    left_out: usize,
}

/// Checks and plans a comparison.
///
/// # Errors
/// All faults of the request; a cohort that does not exist.
pub async fn prepare(app: &App, compare: Compare) -> Result<Prepared, ServiceError> {
    ServiceError::unless_empty(own_faults(&compare, app.limits.samples))?;
    let cohort = catalogue::find(app, &compare.cohort).await?;
    let plan = Plan {
        cohort: cohort.id.clone(),
        revision: cohort.revision,
        samples: compare.samples.unwrap_or_else(|| cohort.representation.comparison_places()),
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
    if pairs.saturating_mul(points) > MAX_EFFECT_POINTS {
        let detail = format!(
            "expected at most {MAX_EFFECT_POINTS} points over all pairs, got {points} for each of {pairs} \
             pairs"
        );
        return Err(ServiceError::invalid("/samples", detail));
    }
    let (task_app, settings) =
        (app.clone(), test_sample::settings(&cohort, &plan.transformation, plan.alignment, plan.mirror));
    let setup = app
        .pool
        .weighing(requests::space(&cohort.representation, &app.limits))
        .run(move || Setup::new(&task_app, &settings))
        .await?;
    let usual = setup.space.representation().comparison_places();
    if let Some(what) = Places::rule(&setup.space)
        && plan.samples != usual
    {
        let detail = format!("expected {usual} or no value, got {}: {what}", plan.samples);
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
            "expected a job that takes at most {most:.1e} bytes of memory, got {:.1e} for {} shapes: choose \
             fewer shapes",
            estimate.memory_bytes, work.shapes
        );
        return Err(ServiceError::invalid("/cohort", detail));
    }
    Ok(Prepared { plan, cohort, setup, members, estimate })
}

/// Faults of the request that do not depend on the cohort.
fn own_faults(compare: &Compare, most_samples: usize) -> Vec<Fault> {
    let mut faults = Vec::new();
    if compare.permutations > MAX_PERMUTATIONS {
        let detail =
            format!("expected a number between 0 and {MAX_PERMUTATIONS}, got {}", compare.permutations);
        faults.push(Fault::new("/permutations", detail));
    }
    if let Some(samples) = compare.samples.filter(|samples| !(1..=most_samples).contains(samples)) {
        faults.push(Fault::new(
            "/samples",
            format!("expected a number between 1 and {most_samples}, got {samples}"),
        ));
    }
    for name in compare.strata.iter().filter(|name| Attribute::parse(name).is_none()) {
        faults.push(Fault::new("/strata", format!("{}, got '{name}'", Attribute::WANTED)));
    }
    match &compare.grouping {
        Grouping::By { attribute, .. } => {
            if !matches!(Attribute::parse(attribute), Some(Attribute::Label | Attribute::Labels(_))) {
                faults.push(Fault::new(
                    "/by",
                    format!("expected 'label' or 'labels.<attribute>', got '{attribute}'"),
                ));
            }
        }
        Grouping::Named(groups) => faults.extend(group_faults(groups)),
    }
    faults
}

fn group_faults(groups: &[NamedGroup]) -> Vec<Fault> {
    let mut faults = Vec::new();
    if !(2..=MAX_GROUPS).contains(&groups.len()) {
        let detail = format!("expected 2 to {MAX_GROUPS} groups, got {}", groups.len());
        faults.push(Fault::new("/groups", detail));
    }
    for (i, group) in groups.iter().enumerate().take(MAX_GROUPS) {
        let pointer = format!("/groups/{i}/name");
        if group.name.is_empty() || group.name.chars().count() > MAX_NAME_CHARS {
            faults.push(Fault::new(pointer, format!("expected 1 to {MAX_NAME_CHARS} characters")));
        } else if groups[..i].iter().any(|other| other.name == group.name) {
            faults.push(Fault::new(pointer, format!("expected different names, got '{}' twice", group.name)));
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
        members.strata = test_sample::strata(&self.strata, &members.shapes)?;
        if self.permutations > 0 && members.relabellings(self, None).exchangeable() == 0 {
            let detail = "no two shapes of different groups share a stratum: no labels can be exchanged";
            return Err(ServiceError::invalid("/strata", detail));
        }
        Ok(members)
    }
}

async fn named_members(app: &App, cohort: &Cohort, groups: &[NamedGroup]) -> Result<Members, ServiceError> {
    let mut described = Vec::with_capacity(groups.len());
    for (i, group) in groups.iter().enumerate() {
        described
            .push(attributes::describe(app, cohort, &group.filter, &format!("/groups/{i}/filter")).await?);
    }
    let total: usize = described.iter().map(Vec::len).sum();
    if total > app.limits.shapes {
        let detail = format!("expected groups of at most {} shapes in all, got {total}", app.limits.shapes);
        return Err(ServiceError::invalid("/groups", detail));
    }
    let mut faults = overlap_faults(groups, &described);
    for (i, (group, shapes)) in groups.iter().zip(&described).enumerate() {
        if shapes.len() < MIN_MEMBERS {
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

/// Reason why group `i` has too few shapes: an attribute that no shape has, or too narrow a filter.
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
    let detail = format!("expected at least {MIN_MEMBERS} shapes for '{}', got {found}: {known}", group.name);
    Ok(vec![Fault::new(format!("/groups/{i}/filter"), detail)])
}

/// Faults for shapes that belong to several groups.
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
        let (count, ids) = (shapes.len(), attributes::first_names(shapes.into_iter()));
        let detail = format!(
            "expected disjoint groups, but '{}' and '{}' share {count} shapes: {ids}",
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
    let described = attributes::describe(app, cohort, filter, "/filter").await?;
    let all = described.len();
    if all == 0 {
        let known = KnownAttributes::of(app, cohort).await?;
        return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
    }
    let values: BTreeMap<String, usize> = described.iter().filter_map(|shape| attribute.text(shape)).fold(
        BTreeMap::new(),
        |mut counts, value| {
            *counts.entry(value).or_default() += 1;
            counts
        },
    );
    if values.len() < 2 || values.len() > MAX_GROUPS {
        let known = KnownAttributes::of(app, cohort).await?;
        let detail = match values.len() {
            0 => format!("none of the {all} shapes has {by}: {known}"),
            1 => format!("expected at least two groups, but all shapes that have {by} have the same value"),
            count => format!("expected at most {MAX_GROUPS} groups, got {count} values of {by}"),
        };
        return Err(at(detail));
    }
    let lonely: Vec<&str> =
        values.iter().filter(|(_, count)| **count < MIN_MEMBERS).map(|(value, _)| value.as_str()).collect();
    if !lonely.is_empty() {
        let named = lonely.iter().take(NAMED_VALUES).copied().collect::<Vec<_>>().join(", ");
        let detail = format!(
            "expected at least {MIN_MEMBERS} shapes in every group, but {} values of {by} have only 1: \
             {named}",
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

    /// Permutations of all shapes, or of the two groups of a pair (whose shapes are in the order of [`Self::of_pair`]).
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
        warnings.extend(test_sample::subject_warning(&self.shapes, &plan.strata));
        if self.left_out > 0 {
            warnings
                .push(format!("{} shapes have no value of the attribute and are left out", self.left_out));
        }
        warnings
    }
}

/// All pairs of `groups`.
fn pairs_of(groups: usize) -> Vec<(usize, usize)> {
    (0..groups).flat_map(|first| (first + 1..groups).map(move |second| (first, second))).collect()
}

impl PlannedTest for Prepared {
    type Plan = Plan;
    type Answer = Comparison;
    const KIND: JobKind = JobKind::Compare;

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

    fn answer(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<Comparison, ServiceError> {
        self.compare(app, handle, context)
    }

    fn draw(&self, answer: &Comparison) -> String {
        drawing::draw(self, answer)
    }
}
