//! Parts of shapes and blocks, as requests name them.

use serde::{Deserialize, Serialize};

use crate::domain::attribute::Attribute;
use crate::domain::filter::ShapeFilter;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::sampling::Places;
use crate::service::app::ServiceError;
use crate::service::cohorts::attributes;
use crate::wire::fault::Fault;

/// Maximum number of labels of a block.
const MAX_LABELS: usize = 1000;
/// A part of a shape: `points` or `range`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PartSpec {
    /// Indices of its landmarks or control points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<usize>>,
    /// Of curves: the control points whose knots have a parameter between the first and the second number, both included, 0 to 1;
    /// on a closed curve the first may be the larger one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
}

impl PartSpec {
    /// Faults that do not depend on the shapes.
    pub(super) fn faults(&self, pointer: &str) -> Vec<Fault> {
        let mut faults = Vec::new();
        if self.points.is_some() == self.range.is_some() {
            faults.push(Fault::new(pointer, "expected either points or range"));
        }
        if self.range.is_some_and(|range| !range.iter().all(|u| (0.0..=1.0).contains(u))) {
            faults.push(Fault::new(format!("{pointer}/range"), "expected two numbers from 0 to 1"));
        }
        if let Some(points) = &self.points {
            let mut sorted = points.clone();
            sorted.sort_unstable();
            if let Some(two) = sorted.windows(2).find(|two| two[0] == two[1]) {
                let detail = format!("expected different points, got {} twice", two[0]);
                faults.push(Fault::new(format!("{pointer}/points"), detail));
            }
        }
        faults
    }

    /// Indices of the control points, at least `fewest`.
    ///
    /// # Errors
    /// Points that are not there; a range of shapes that are not curves; fewer points.
    pub(super) fn indices(
        &self,
        space: &ShapeSpace,
        fewest: usize,
        pointer: &str,
    ) -> Result<Vec<usize>, ServiceError> {
        let size = space.representation().size();
        let (found, pointer) = match (&self.points, self.range) {
            (Some(points), _) => (points.clone(), format!("{pointer}/points")),
            (None, Some(range)) => (in_range(space, range, pointer)?, format!("{pointer}/range")),
            (None, None) => return Err(ServiceError::invalid(pointer, "expected either points or range")),
        };
        if let Some(k) = found.iter().find(|k| **k >= size) {
            return Err(ServiceError::invalid(pointer, format!("expected indices below {size}, got {k}")));
        }
        if found.len() < fewest {
            let detail = format!("expected at least {fewest} control points, got {}", found.len());
            return Err(ServiceError::invalid(pointer, detail));
        }
        Ok(found)
    }
}

/// Control points of a curve whose knots lie in a range.
fn in_range(space: &ShapeSpace, [first, last]: [f64; 2], pointer: &str) -> Result<Vec<usize>, ServiceError> {
    let (size, count) = (space.representation().size(), space.representation().point_count());
    let Places::Curve(parameters) = Places::along(space, count) else {
        let detail = "expected points: only curves have a range of parameters";
        return Err(ServiceError::invalid(format!("{pointer}/range"), detail));
    };
    // Control points beyond the ends of an open curve belong to its first and last knots.
    let is_closed = space.representation().is_closed();
    let before = space.representation().points_before();
    let of = |k: usize| parameters[k.saturating_sub(before).min(count - 1)];
    let inside = |u: f64| match first <= last {
        true => (first..=last).contains(&u),
        false => is_closed && (u >= first || u <= last),
    };
    Ok((0..size).filter(|&k| inside(of(k))).collect())
}

/// A block: without fields the shapes of the cohort, with `points` or `range` a part of them, with `cohort` those of another cohort that
/// has the same subjects, with `labels` numbers.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BlockSpec {
    /// Id or name of another cohort: each of its shapes belongs to the shape with the same `subject`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cohort: Option<String>,
    /// Filter that selects shapes of the other cohort. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filter: Option<ShapeFilter>,
    /// Indices of landmarks or control points of a part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<usize>>,
    /// Of curves: parameters between which the knots of a part lie.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Attributes of the shapes of the cohort whose values are numbers, each standardised.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub labels: Option<Vec<String>>,
}

impl BlockSpec {
    /// The part of the shapes, if the block is one.
    pub(super) fn part(&self) -> Option<PartSpec> {
        (self.points.is_some() || self.range.is_some())
            .then(|| PartSpec { points: self.points.clone(), range: self.range })
    }

    /// Faults that do not depend on the shapes.
    pub(super) fn faults(&self, pointer: &str) -> Vec<Fault> {
        let mut faults = self.part().map_or_else(Vec::new, |part| part.faults(pointer));
        if let Some(filter) = &self.filter {
            faults.extend(attributes::filter_faults(filter, &format!("{pointer}/filter")));
            if self.cohort.is_none() {
                let detail =
                    "expected a filter with another cohort only: that of the cohort is beside the blocks";
                faults.push(Fault::new(format!("{pointer}/filter"), detail));
            }
        }
        let Some(labels) = &self.labels else { return faults };
        if self.cohort.is_some() || self.part().is_some() {
            faults.push(Fault::new(pointer, "expected labels, a part or another cohort, got several"));
        }
        if !(1..=MAX_LABELS).contains(&labels.len()) {
            let detail = format!("expected 1 to {MAX_LABELS} labels, got {}", labels.len());
            faults.push(Fault::new(format!("{pointer}/labels"), detail));
        }
        for (i, name) in labels.iter().enumerate().take(MAX_LABELS) {
            let pointer = format!("{pointer}/labels/{i}");
            match Attribute::parse(name) {
                Some(Attribute::Labels(_) | Attribute::Measure(_)) if !labels[..i].contains(name) => {}
                Some(Attribute::Labels(_) | Attribute::Measure(_)) => {
                    faults.push(Fault::new(pointer, format!("'{name}' is given twice")));
                }
                _ => {
                    let detail =
                        format!("expected 'labels.<attribute>' or 'measures.<measure>', got '{name}'");
                    faults.push(Fault::new(pointer, detail));
                }
            }
        }
        faults
    }

    /// Name in answers and drawings.
    pub(super) fn name(&self) -> String {
        let part = match (&self.points, self.range) {
            (Some(points), _) => format!("{} points", points.len()),
            (None, Some([first, last])) => format!("u from {first} to {last}"),
            (None, None) => "shape".into(),
        };
        match &self.cohort {
            Some(cohort) => format!("{part} of {cohort}"),
            None => part,
        }
    }
}
