//! Attributes of stored shapes. They define the groups, strata and covariates of tests and the classes of classifiers.

use std::collections::BTreeSet;

use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::service::app::{App, ServiceError};
use crate::store::Revisions;

/// Maximum number of ids named in a fault.
const NAMED_IDS: usize = 5;

/// Number of shapes searched for names of attributes.
const LOOKED_THROUGH: usize = 10_000;

/// Descriptions of the shapes that pass a filter, in storage order.
///
/// # Errors
/// A fault at `pointer` if there are more shapes than the limit of a request.
pub(crate) async fn describe(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    pointer: &str,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    let (revisions, most) = (Revisions::until(cohort.revision), app.limits.shapes);
    let found = app.store.describe_shapes(&cohort.id, revisions, filter, most + 1).await?;
    if found.len() > most {
        return Err(ServiceError::invalid(
            pointer,
            format!("expected a filter that selects at most {most} shapes, the limit of a test"),
        ));
    }
    Ok(found)
}

/// Names of the attributes that exist in a cohort.
pub(crate) struct KnownAttributes(BTreeSet<String>);

impl KnownAttributes {
    /// Collects the names from the first shapes of `cohort`.
    ///
    /// # Errors
    /// A failure of the store.
    pub(crate) async fn of(app: &App, cohort: &Cohort) -> Result<Self, ServiceError> {
        let (revisions, all) = (Revisions::until(cohort.revision), ShapeFilter::default());
        let shapes = app.store.describe_shapes(&cohort.id, revisions, &all, LOOKED_THROUGH).await?;
        let labels = |shape: &ShapeDescription| {
            shape.labels.keys().map(|key| format!("labels.{key}")).collect::<Vec<_>>()
        };
        let mut names: BTreeSet<String> = shapes.iter().flat_map(labels).collect();
        for attribute in ["label", "subject"] {
            let known = Attribute::parse(attribute);
            if shapes.iter().any(|shape| known.as_ref().is_some_and(|known| known.text(shape).is_some())) {
                names.insert(attribute.into());
            }
        }
        Ok(Self(names))
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
