//! Attributes of stored shapes. They define the groups, strata and covariates of tests and the classes of classifiers.

use std::collections::BTreeSet;

use super::measures;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{MAX_NAMES, ShapeDescription};
use crate::service::app::{App, ServiceError};
use crate::store::Revisions;
use crate::wire::fault::Fault;

/// Maximum number of ids named in a fault.
const NAMED_IDS: usize = 5;
/// Maximum number of attributes named in a fault.
const NAMED_ATTRIBUTES: usize = 50;
/// Number of names that are read of a cohort, which may have more since an earlier version.
const MOST_READ: usize = 16 * MAX_NAMES;

/// Descriptions of the shapes that pass a filter, in storage order.
///
/// # Errors
/// A fault at `pointer` if there are more shapes than the limit of a request; below it, attributes that no shape has.
pub(crate) async fn describe(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    pointer: &str,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    measures::complete_for(app, cohort, filter).await?;
    let (revisions, most) = (Revisions::until(cohort.revision), app.limits.shapes);
    let found = app.store.describe_shapes(&cohort.id, revisions, filter, most + 1).await?;
    if found.is_empty() {
        refuse_unknown(app, cohort, filter, FilterPlace::Body(pointer)).await?;
    }
    if found.len() > most {
        return Err(ServiceError::invalid(
            pointer,
            format!("expected a filter that selects at most {most} shapes, the limit of a test"),
        ));
    }
    Ok(found)
}

/// Where a request gives a filter.
#[derive(Debug, Clone, Copy)]
pub(crate) enum FilterPlace<'a> {
    /// In parameters of the query.
    Query,
    /// In the body, at a pointer.
    Body(&'a str),
}

impl FilterPlace<'_> {
    /// A fault of the condition on an attribute.
    pub(crate) fn fault(self, attribute: &Attribute, detail: String) -> Fault {
        let below =
            |pointer: &str, name: &str| format!("{pointer}/{}", name.replace('~', "~0").replace('/', "~1"));
        match (self, attribute) {
            (Self::Query, attribute) => Fault::of_parameter(attribute.to_string(), detail),
            (Self::Body(pointer), Attribute::Labels(name)) => {
                Fault::new(below(&format!("{pointer}/labels"), name), detail)
            }
            (Self::Body(pointer), Attribute::Measure(measure)) => {
                Fault::new(below(&format!("{pointer}/measures"), measure.name()), detail)
            }
            (Self::Body(pointer), other) => Fault::new(below(pointer, &other.to_string()), detail),
        }
    }
}

/// Faults of a filter of a body: too many conditions, or values that cannot be compared with those of their attributes.
pub fn filter_faults(filter: &ShapeFilter, pointer: &str) -> Vec<Fault> {
    if let Some(detail) = filter.excess() {
        return vec![Fault::new(pointer, detail)];
    }
    let fault = |(attribute, detail)| FilterPlace::Body(pointer).fault(&attribute, detail);
    filter.faults().into_iter().map(fault).collect()
}

/// Refuses attributes that no shape of the cohort has, which may be misspelt: those of a filter that selects nothing, those
/// whose absence a filter accepts, and the one that gives the order. In a cohort without shapes every name is accepted.
///
/// # Errors
/// Every such attribute, with the names of those that exist.
pub(crate) async fn refuse_misspelt(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    order: Option<Attribute>,
    is_empty: bool,
) -> Result<(), ServiceError> {
    let accepts_absence = filter.conditions().filter(|(_, condition)| !condition.none_of.is_empty());
    let accepted = accepts_absence.map(|(attribute, _)| attribute);
    let named: BTreeSet<Attribute> =
        if is_empty { filter.attributes() } else { accepted.collect() }.into_iter().chain(order).collect();
    refuse_absent(app, cohort, named, FilterPlace::Query).await
}

/// Refuses a filter that selects nothing because no shape of the cohort has one of its attributes.
///
/// # Errors
/// Every such attribute, with the names of those that exist.
pub(crate) async fn refuse_unknown(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    place: FilterPlace<'_>,
) -> Result<(), ServiceError> {
    refuse_absent(app, cohort, filter.attributes(), place).await
}

/// Number of names that are asked for one by one, which ends at the first shape that has the attribute; more are looked up among all
/// names of the cohort.
const ONE_BY_ONE: usize = 4;

/// Whether there are shapes with each of the attributes, as far as it is known without a pass for each.
async fn are_known(app: &App, cohort: &Cohort, named: &[Attribute]) -> Result<bool, ServiceError> {
    if named.len() > ONE_BY_ONE {
        return Ok(false);
    }
    for attribute in named {
        if !app.store.has_attribute(&cohort.id, Revisions::until(cohort.revision), attribute).await? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Refuses the attributes that no shape has, unless the cohort has no shapes.
async fn refuse_absent(
    app: &App,
    cohort: &Cohort,
    named: BTreeSet<Attribute>,
    place: FilterPlace<'_>,
) -> Result<(), ServiceError> {
    // Measures and times are not misspelt: their names were read. A subject is asked for to learn that nothing is held of it.
    let is_free = |attribute: &Attribute| matches!(attribute, Attribute::Labels(_) | Attribute::Label);
    let named: Vec<Attribute> = named.into_iter().filter(is_free).collect();
    if are_known(app, cohort, &named).await? {
        return Ok(());
    }
    let known = KnownAttributes::of(app, cohort).await?;
    let absent: Vec<&Attribute> =
        named.iter().filter(|attribute| !known.contains(&attribute.to_string())).collect();
    let (revisions, everything) = (Revisions::until(cohort.revision), ShapeFilter::everything());
    if absent.is_empty() || app.store.count(&cohort.id, revisions, &everything).await? == 0 {
        return Ok(());
    }
    let fault = |attribute: &Attribute| {
        let detail =
            format!("expected an attribute that shapes of the cohort have, got '{attribute}': {known}");
        place.fault(attribute, detail)
    };
    let faults = absent.into_iter().map(fault);
    match place {
        FilterPlace::Query => Err(ServiceError::Parameters(faults.collect())),
        FilterPlace::Body(_) => Err(ServiceError::Invalid(faults.collect())),
    }
}

/// Names of the attributes that exist in a cohort.
pub(crate) struct KnownAttributes(BTreeSet<String>);

impl KnownAttributes {
    /// The names that shapes of `cohort` have.
    ///
    /// # Errors
    /// A failure of the store.
    pub(crate) async fn of(app: &App, cohort: &Cohort) -> Result<Self, ServiceError> {
        let revisions = Revisions::until(cohort.revision);
        Ok(Self(app.store.attribute_names(&cohort.id, revisions, MOST_READ).await?))
    }

    /// Whether an attribute with this name exists.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.0.contains(name)
    }
}

impl std::fmt::Display for KnownAttributes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0.is_empty() {
            return f.write_str("the shapes of the cohort have no attributes");
        }
        let names: Vec<&str> = self.0.iter().take(NAMED_ATTRIBUTES).map(String::as_str).collect();
        write!(f, "the attributes of the cohort are {}", names.join(", "))?;
        match self.0.len() - names.len() {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

/// Name of a shape for clients: its external id, or else its id.
pub(crate) fn name_of(shape: &ShapeDescription) -> &str {
    shape.external_id.as_deref().unwrap_or(&shape.id)
}

/// Names of the first few shapes.
pub(crate) fn first_names<'a>(shapes: impl Iterator<Item = &'a ShapeDescription>) -> String {
    let mut names: Vec<&str> = shapes.take(NAMED_IDS + 1).map(name_of).collect();
    if names.len() > NAMED_IDS {
        names[NAMED_IDS] = "…";
    }
    names.join(", ")
}
