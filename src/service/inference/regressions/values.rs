//! Values of attribute and covariates of a regression.

use std::collections::BTreeSet;

use super::{Missing, Options};
use crate::analysis::inference::variables::{Values, Variable, Variables};
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeDescription;
use crate::service::app::faults::MAX_FAULTS;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::wire::fault::Fault;

/// Name of the natural logarithm of the centroid size as an attribute; a regression on it measures allometry.
pub(super) const LOG_CENTROID_SIZE: &str = "log_centroid_size";

/// Shapes that have all values; the others are refused or left out.
///
/// # Errors
/// Values that are missing or not numbers; attributes that no shape has.
pub(super) async fn complete(
    app: &App,
    cohort: &Cohort,
    options: &Options,
    described: Vec<ShapeDescription>,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    let all = described.len();
    let mut faults = Vec::new();
    let mut incomplete = BTreeSet::new();
    let mut unknown = Vec::new();
    for (name, pointer) in options.names() {
        let Some(attribute) = Attribute::parse(name) else { continue };
        let is_attribute = name == options.attribute;
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
                faults.push(Fault::new(pointer.clone(), detail).at_shape(k));
            }
        }
    }
    if !unknown.is_empty() {
        let known = KnownAttributes::of(app, cohort).await?;
        let fault =
            |(name, pointer)| Fault::new(pointer, format!("none of the {all} shapes has {name}: {known}"));
        return ServiceError::unless_empty(unknown.into_iter().map(fault).collect()).map(|()| Vec::new());
    }
    if options.missing == Missing::Refuse {
        ServiceError::unless_empty(faults)?;
    }
    let kept = described.into_iter().enumerate().filter(|(k, _)| !incomplete.contains(k));
    Ok(kept.map(|(_, shape)| shape).collect())
}

/// Covariates and attribute with their values.
///
/// # Errors
/// All values that are too large, and categories with too many values.
pub(super) fn variables(options: &Options, shapes: &[ShapeDescription]) -> Result<Variables, ServiceError> {
    let (mut covariates, mut faults) = (Vec::new(), Vec::new());
    for (name, pointer) in options.names() {
        let values = match Attribute::parse(name) {
            None => Values::LogCentroidSize,
            Some(attribute) => values_of(&attribute, shapes),
        };
        if let Err(error) = values.check() {
            faults.push(Fault::new(pointer, error.to_string()));
        }
        covariates.push(Variable { name: name.into(), values });
    }
    ServiceError::unless_empty(faults)?;
    let attribute =
        covariates.pop().ok_or_else(|| ServiceError::Internal("a regression without an attribute".into()))?;
    Ok(Variables { covariates, attribute })
}

/// Numbers if all values are numeric; otherwise a category.
fn values_of(attribute: &Attribute, shapes: &[ShapeDescription]) -> Values {
    let numbers: Option<Vec<f64>> = shapes.iter().map(|shape| attribute.number(shape)).collect();
    numbers.map_or_else(
        || {
            let text = |shape| attribute.text(shape).unwrap_or_default();
            Values::category(&shapes.iter().map(text).collect::<Vec<_>>())
        },
        Values::Numbers,
    )
}
