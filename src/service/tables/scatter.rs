//! Shapes of a cohort as points in the plane of two components of a dictionary.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::table::{self, CohortTable, TableQuery};
use crate::analysis::drawing::morphospace::{Outline, ScoredGroup, draw_morphospace};
use crate::domain::attribute::Attribute;
use crate::domain::filter::ShapeFilter;
use crate::geometry::drawing::legend::Entry;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::dictionaries::coding::misfit;
use crate::service::dictionaries::modes;
use crate::service::dictionaries::ready::{self, Ready};
use crate::wire::table::{Table, Values};

/// Most points of a drawing: more than a page can show.
const MAX_POINTS: usize = 20_000;
/// Most groups: more could not be told apart.
const MAX_GROUPS: usize = 24;
/// Name of the group of shapes without a value.
const WITHOUT: &str = "none";
/// Standard deviations of the shapes beside the axes.
pub const SIGMA: f64 = 2.0;

/// Settings of the drawing.
#[derive(Debug)]
pub struct ScatterQuery {
    /// Id or name of the cohort. Default: the cohort from which the dictionary was learnt.
    pub cohort: Option<String>,
    /// Components of the axes, from 1.
    pub components: [usize; 2],
    /// Attribute whose values are the groups.
    pub groups: Option<String>,
    /// Line about the points of a group.
    pub outline: Outline,
    /// Whether shapes stand at the ends of the axes.
    pub shapes: bool,
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
}

/// Scores of a cohort, ready to be drawn.
pub struct Scatter {
    ready: Arc<Ready>,
    title: String,
    query: ScatterQuery,
    groups: Vec<ScoredGroup>,
    notes: Vec<String>,
}

/// Reads the scores.
///
/// # Errors
/// A dictionary or a cohort that does not exist, or does not suit the other; components that the dictionary does not have; an attribute
/// that no shape has, or of too many values.
pub async fn scatter(app: &App, key: &str, query: ScatterQuery) -> Result<Scatter, ServiceError> {
    let ready = ready::find(app, key).await?;
    let [x, y] = query.components;
    for (name, component) in [("x", x), ("y", y)] {
        let found = ready.dictionary().model.len();
        if !(1..=found).contains(&component) {
            let detail = format!("expected a number between 1 and {found}, got {component}");
            return Err(ServiceError::parameter(name, detail));
        }
    }
    if x == y {
        return Err(ServiceError::parameter(
            "y",
            format!("expected another component than x, got {y} for both"),
        ));
    }
    let id = &ready.listed.id;
    let mut columns = vec![format!("{id}.score.{x}"), format!("{id}.score.{y}")];
    if let Some(name) = &query.groups {
        let is_attribute = Attribute::parse(name).is_some();
        let wrong = || ServiceError::parameter("groups", format!("{}, got '{name}'", Attribute::WANTED));
        is_attribute.then_some(()).ok_or_else(wrong)?;
        columns.push(name.clone());
    }
    let cohort = query.cohort.clone().unwrap_or_else(|| ready.listed.provenance.cohort.clone());
    if let Some(detail) = misfit(&ready, &catalogue::find(app, &cohort).await?) {
        return Err(ServiceError::parameter("cohort", detail));
    }
    let wanted = TableQuery { columns: Some(columns), filter: query.filter.clone(), in_query: true };
    let CohortTable { cohort, table, .. } = table::table(app, &cohort, wanted).await?;
    let mut notes = ready.listed.provenance.warnings.clone();
    let groups = grouped(&table, &cohort.spec.name, &mut notes)?;
    let title = format!("{} in {} version {}", cohort.spec.name, ready.listed.name, ready.listed.version);
    Ok(Scatter { ready, title, query, groups, notes })
}

/// The points of a table of two scores and perhaps the names of groups; `all` is the name where there are none.
fn grouped(table: &Table, all: &str, notes: &mut Vec<String>) -> Result<Vec<ScoredGroup>, ServiceError> {
    let [(_, Values::Number(first)), (_, Values::Number(second)), names @ ..] = table.columns.as_slice()
    else {
        return Err(ServiceError::Internal("a table of scores has other columns than were asked for".into()));
    };
    let mut groups: BTreeMap<String, Vec<[f64; 2]>> = BTreeMap::new();
    let step = table.rows.div_ceil(MAX_POINTS).max(1);
    let mut without = 0;
    for row in (0..table.rows).step_by(step) {
        let point = [first[row], second[row]];
        if point.iter().any(|score| !score.is_finite()) {
            without += 1;
            continue;
        }
        let name = match names.first() {
            None => all.to_owned(),
            Some((_, values)) => values.text(row).unwrap_or_else(|| WITHOUT.into()),
        };
        groups.entry(name).or_default().push(point);
        if groups.len() > MAX_GROUPS {
            let detail = format!("expected an attribute of at most {MAX_GROUPS} values, got more");
            return Err(ServiceError::parameter("groups", detail));
        }
    }
    if step > 1 {
        notes.push(format!(
            "{} of {} shapes are drawn: one of {step}",
            table.rows.div_ceil(step),
            table.rows
        ));
    }
    if without > 0 {
        notes.push(format!("{without} shapes have no scores"));
    }
    Ok(groups.into_iter().map(|(name, scores)| ScoredGroup { name, scores }).collect())
}

impl Scatter {
    /// Number of points.
    pub fn points(&self) -> usize {
        self.groups.iter().map(|group| group.scores.len()).sum()
    }

    /// The dictionary.
    pub fn ready(&self) -> &Ready {
        &self.ready
    }

    /// The drawing.
    ///
    /// # Errors
    /// None that the query leaves open.
    pub fn draw(self) -> Result<Drawing, ServiceError> {
        let Self { ready, title, query, groups, notes } = self;
        let content = &ready.dictionary().content;
        let axis = |component: usize| match content.atoms.get(component - 1).and_then(|atom| atom.explained) {
            Some(part) => format!("component {component} ({:.1} %)", 100.0 * part),
            None => format!("atom {component}"),
        };
        let [x, y] = query.components;
        let mut notes: Vec<Entry> = notes.into_iter().map(Entry::Text).collect();
        // Sparse atoms have no two sides.
        let shapes = match query.shapes && !content.method.is_sparse() {
            false => None,
            true => {
                let ends = |component: usize| modes::mode(&ready, component, SIGMA).map(|mode| mode.shapes);
                let ([left, _, right], [low, _, high]) = (ends(x)?, ends(y)?);
                notes.push(Entry::Text(format!(
                    "shapes: the mean ± {SIGMA} standard deviations along each axis"
                )));
                Some([left, right, low, high])
            }
        };
        let axes = [axis(x), axis(y)];
        let view = ready.view();
        Ok(draw_morphospace(&view, &title, axes, groups, query.outline, shapes.as_ref(), &notes))
    }
}
