//! Classes and subjects of the shapes of a cohort, for training a classifier.
//!
//! Classes are the values of an attribute; shapes of one subject stay together in cross-validation. Whether the classes
//! are sufficient for the requested classifier ([`ClassLabels::faults`]) is checked before a job is stored.

use crate::analysis::classification::labels::ClassLabels;
use crate::analysis::classifier_record::ClassifierSettings;
use crate::analysis::dictionary::method::Method;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::error::parameter_fault;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{KnownAttributes, describe, first_names};
use crate::wire::fault::Fault;

/// Reads the classes of the shapes that pass the filter, at the revision of the cohort.
///
/// # Errors
/// At `/classifier/attribute`: an attribute that shapes lack; at `/filter`: more shapes than the limit of a
/// request.
pub async fn read(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    attribute: &str,
) -> Result<ClassLabels, ServiceError> {
    let refused = |detail: String| ServiceError::invalid("/classifier/attribute", detail);
    let wanted = || refused(format!("{}, got '{attribute}'", Attribute::WANTED));
    let parsed = Attribute::parse(attribute).ok_or_else(wanted)?;
    let shapes = describe(app, cohort, filter, "/filter").await?;
    let names: Vec<Option<String>> = shapes.iter().map(|shape| parsed.text(shape)).collect();
    let without = || shapes.iter().zip(&names).filter(|(_, name)| name.is_none()).map(|(shape, _)| shape);
    let missing = without().count();
    if missing == shapes.len() && missing > 0 {
        let known = KnownAttributes::of(app, cohort).await?;
        return Err(refused(format!("no shape has the attribute '{attribute}': {known}")));
    }
    if missing > 0 {
        let first = first_names(without());
        let all = shapes.len();
        let detail = format!(
            "{missing} of {all} shapes lack '{attribute}' ({first}): set it, or exclude these shapes with a \
             filter"
        );
        return Err(refused(detail));
    }
    let subjects: Vec<Option<String>> = shapes.into_iter().map(|shape| shape.subject).collect();
    Ok(ClassLabels::new(&names.into_iter().flatten().collect::<Vec<_>>(), &subjects))
}

/// Faults of the settings of a classifier that do not depend on the shapes.
pub(crate) fn settings_faults(
    settings: &ClassifierSettings,
    method: &Method,
) -> impl Iterator<Item = Fault> + use<> {
    let attribute = Attribute::parse(&settings.attribute);
    let names_classes = matches!(attribute, Some(Attribute::Label | Attribute::Labels(_)));
    settings.faults(method, names_classes).into_iter().map(parameter_fault)
}
