//! Groups of a comparison: their definition, and the shapes of each.

use std::collections::{BTreeMap, HashMap};

use serde::{Deserialize, Serialize};

use crate::analysis::inference::groups::Groups;
use crate::analysis::inference::limits::MIN_MEMBERS;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeDescription;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::wire::fault::Fault;

/// Maximum number of groups of a comparison.
const MAX_GROUPS: usize = 50;

/// Maximum length of a group's name.
const MAX_NAME_CHARS: usize = 100;

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
        filter: Box<ShapeFilter>,
    },
}

/// Shapes with their groups.
#[derive(Debug)]
pub(super) struct Members {
    pub(super) shapes: Vec<ShapeDescription>,
    /// Filters through which they are read.
    pub(super) filters: Vec<ShapeFilter>,
    pub(super) groups: Groups,
    pub(super) left_out: usize,
}

impl Members {
    /// Shapes of the groups.
    ///
    /// # Errors
    /// Groups that overlap, or have too few shapes; attributes that do not exist.
    pub(super) async fn of(app: &App, cohort: &Cohort, grouping: &Grouping) -> Result<Self, ServiceError> {
        match grouping {
            Grouping::Named(groups) => named_members(app, cohort, groups).await,
            Grouping::By { attribute, filter } => members_by(app, cohort, attribute, filter).await,
        }
    }
}

/// Faults of a definition that do not depend on the cohort.
pub(super) fn group_faults(grouping: &Grouping) -> Vec<Fault> {
    match grouping {
        Grouping::Named(groups) => named_faults(groups),
        Grouping::By { attribute, .. } => match Attribute::parse(attribute) {
            Some(Attribute::Label | Attribute::Labels(_)) => Vec::new(),
            _ => {
                let detail = format!("expected 'label' or 'labels.<attribute>', got '{attribute}'");
                vec![Fault::new("/by", detail)]
            }
        },
    }
}

fn named_faults(groups: &[NamedGroup]) -> Vec<Fault> {
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
        faults.extend(attributes::filter_faults(&group.filter, &format!("/groups/{i}/filter")));
    }
    faults
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
    let names = groups.iter().map(|group| group.name.clone()).collect();
    Ok(Members {
        groups: Groups { names, labels: labels.collect() },
        shapes: described.into_iter().flatten().collect(),
        filters: groups.iter().map(|group| group.filter.clone()).collect(),
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
    let attribute = Attribute::parse(by).ok_or_else(|| ServiceError::invalid("/by", Attribute::WANTED))?;
    let described = attributes::describe(app, cohort, filter, "/filter").await?;
    let all = described.len();
    if all == 0 {
        let known = KnownAttributes::of(app, cohort).await?;
        return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
    }
    let mut values: BTreeMap<String, usize> = BTreeMap::new();
    for value in described.iter().filter_map(|shape| attribute.text(shape)) {
        *values.entry(value).or_default() += 1;
    }
    check_values(app, cohort, by, &values, all).await?;
    let names: Vec<String> = values.into_keys().collect();
    let group = |shape: &ShapeDescription| names.binary_search(&attribute.text(shape)?).ok();
    let (shapes, labels): (Vec<_>, Vec<_>) =
        described.into_iter().filter_map(|shape| group(&shape).map(|group| (shape, group))).unzip();
    let left_out = all - shapes.len();
    Ok(Members { shapes, filters: vec![filter.clone()], groups: Groups { names, labels }, left_out })
}

/// Checks the `values` of the attribute `by`, with the number of shapes of each; `all` counts the shapes with or without it.
async fn check_values(
    app: &App,
    cohort: &Cohort,
    by: &str,
    values: &BTreeMap<String, usize>,
    all: usize,
) -> Result<(), ServiceError> {
    if values.len() < 2 || values.len() > MAX_GROUPS {
        let known = KnownAttributes::of(app, cohort).await?;
        let detail = match values.len() {
            0 => format!("none of the {all} shapes has {by}: {known}"),
            1 => format!("expected at least two groups, but all shapes that have {by} have the same value"),
            count => format!("expected at most {MAX_GROUPS} groups, got {count} values of {by}"),
        };
        return Err(ServiceError::invalid("/by", detail));
    }
    let lonely: Vec<&str> =
        values.iter().filter(|(_, count)| **count < MIN_MEMBERS).map(|(value, _)| value.as_str()).collect();
    if lonely.is_empty() {
        return Ok(());
    }
    let named = lonely.iter().take(NAMED_VALUES).copied().collect::<Vec<_>>().join(", ");
    let detail = format!(
        "expected at least {MIN_MEMBERS} shapes in every group, but {} values of {by} have only 1: \
         {named}",
        lonely.len()
    );
    Err(ServiceError::invalid("/by", detail))
}
