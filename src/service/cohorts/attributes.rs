//! Attributes of stored shapes. They define the groups, strata and covariates of tests and the classes of classifiers.

use std::collections::BTreeSet;

use crate::domain::cohort::Cohort;
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::formats::fault::Fault;
use crate::service::app::{App, ServiceError};
use crate::store::Revisions;

/// Maximum number of ids named in a fault.
const NAMED_IDS: usize = 5;

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
    /// The fault of the attribute with this name.
    fn fault(self, name: &str, detail: String) -> Fault {
        match (self, name.strip_prefix("labels.")) {
            (Self::Query, _) => Fault::of_parameter(name, detail),
            (Self::Body(pointer), None) => Fault::new(format!("{pointer}/{name}"), detail),
            (Self::Body(pointer), Some(key)) => {
                let key = key.replace('~', "~0").replace('/', "~1");
                Fault::new(format!("{pointer}/labels/{key}"), detail)
            }
        }
    }
}

/// Refuses a filter that selects nothing because no shape of the cohort has one of its attributes, which may be misspelt. In
/// a cohort without shapes every filter is accepted.
///
/// # Errors
/// Every such attribute, with the names of those that exist.
pub(crate) async fn refuse_unknown(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    place: FilterPlace<'_>,
) -> Result<(), ServiceError> {
    if *filter == ShapeFilter::default() {
        return Ok(());
    }
    let known = KnownAttributes::of(app, cohort).await?;
    let own = [("label", filter.label.is_some()), ("subject", filter.subject.is_some())];
    let own = own.into_iter().filter(|(_, given)| *given).map(|(name, _)| name.to_owned());
    let names = own.chain(filter.labels.keys().map(|key| format!("labels.{key}")));
    let unknown: Vec<String> = names.filter(|name| !known.contains(name)).collect();
    let (revisions, all) = (Revisions::until(cohort.revision), ShapeFilter::default());
    if unknown.is_empty() || app.store.count(&cohort.id, revisions, &all).await? == 0 {
        return Ok(());
    }
    let fault = |name: &String| {
        place.fault(
            name,
            format!("expected an attribute that shapes of the cohort have, got '{name}': {known}"),
        )
    };
    let faults = unknown.iter().map(fault);
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
        Ok(Self(app.store.attribute_names(&cohort.id, Revisions::until(cohort.revision)).await?))
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
        let names: Vec<&str> = self.0.iter().map(String::as_str).collect();
        write!(f, "the attributes of the cohort are {}", names.join(", "))
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
