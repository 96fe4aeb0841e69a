//! Attributes that a formula names, with their values.

use std::collections::{BTreeMap, BTreeSet};

use super::super::regressions::Missing;
use super::{Formulas, Options};
use crate::analysis::inference::limits::{MAX_VALUE, MIN_DEVIATION};
use crate::analysis::models::design::{Table, Values};
use crate::analysis::models::study::LOG_CENTROID_SIZE;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeDescription;
use crate::service::app::faults::MAX_FAULTS;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::wire::fault::Fault;

/// The attribute of a name: `subject`, `label`, `labels.<attribute>`, `measures.<measure>`, or the attribute alone.
pub(in super::super) fn resolved(name: &str) -> Option<Attribute> {
    Attribute::parse(&full_name(name))
}

/// The name by which other requests know the attribute of a name.
pub(super) fn full_name(name: &str) -> String {
    match Attribute::parse(name) {
        Some(_) => name.to_owned(),
        None => format!("labels.{name}"),
    }
}

/// Names of the attributes, with the places in the request that name them.
pub(super) fn names<'a>(options: &'a Options, formulas: &'a Formulas) -> BTreeMap<&'a str, String> {
    let mut names: BTreeMap<&str, String> = BTreeMap::new();
    for (formula, place) in formulas.all() {
        for variable in &formula.variables {
            names.entry(&variable.name).or_insert_with(|| place.to_owned());
        }
    }
    if !options.is_of_shapes() {
        names.entry(&options.response).or_insert_with(|| "/response".into());
    }
    for (i, name) in options.blocks.iter().enumerate() {
        names.entry(name).or_insert_with(|| format!("/blocks/{i}"));
    }
    names.remove(LOG_CENTROID_SIZE);
    names
}

/// Shapes that have all values; the others are refused or left out.
///
/// # Errors
/// Values that are missing; attributes that no shape has.
pub(super) async fn complete(
    app: &App,
    cohort: &Cohort,
    options: &Options,
    formulas: &Formulas,
    described: Vec<ShapeDescription>,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    having(app, cohort, names(options, formulas), options.missing, described).await
}

/// Shapes that have all values of the names, which the places of the request name; the others are refused or left out.
///
/// # Errors
/// Values that are missing; attributes that no shape has.
pub(in super::super) async fn having(
    app: &App,
    cohort: &Cohort,
    names: BTreeMap<&str, String>,
    missing: Missing,
    described: Vec<ShapeDescription>,
) -> Result<Vec<ShapeDescription>, ServiceError> {
    let all = described.len();
    let (mut faults, mut incomplete, mut unknown) = (Vec::new(), BTreeSet::new(), Vec::new());
    for (name, pointer) in names {
        let has = |shape: &ShapeDescription| {
            resolved(name).is_some_and(|attribute| attribute.text(shape).is_some())
        };
        if !described.iter().any(has) {
            unknown.push((name.to_owned(), pointer));
            continue;
        }
        for (k, shape) in described.iter().enumerate().filter(|(_, shape)| !has(shape)) {
            incomplete.insert(k);
            if faults.len() < MAX_FAULTS {
                let detail = format!("{name} is missing on the shape '{}'", attributes::name_of(shape));
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
    if missing == Missing::Refuse {
        ServiceError::unless_empty(faults)?;
    }
    let kept = described.into_iter().enumerate().filter(|(k, _)| !incomplete.contains(k));
    Ok(kept.map(|(_, shape)| shape).collect())
}

/// The table of the attributes.
///
/// # Errors
/// Numbers that are too large; a response that is no number, or that does not vary.
pub(super) fn table_of(
    options: &Options,
    formulas: &Formulas,
    shapes: &[ShapeDescription],
) -> Result<Table, ServiceError> {
    let (mut table, mut faults) =
        (Table { attributes: BTreeMap::new(), levels: options.levels.clone() }, Vec::new());
    for (name, pointer) in names(options, formulas) {
        let Some(attribute) = resolved(name) else { continue };
        let numbers: Option<Vec<f64>> = shapes.iter().map(|shape| attribute.number(shape)).collect();
        let values = match numbers {
            Some(numbers) => Values::Numbers(numbers),
            None => {
                Values::Texts(shapes.iter().map(|shape| attribute.text(shape).unwrap_or_default()).collect())
            }
        };
        faults.extend(checked(options, name, &pointer, &values));
        table.attributes.insert(name.to_owned(), values);
    }
    faults.extend(check_levels(options, formulas));
    ServiceError::unless_empty(faults)?;
    Ok(table)
}

/// Faults of the values of an attribute, which the place `pointer` names.
pub(super) fn checked(options: &Options, name: &str, pointer: &str, values: &Values) -> Vec<Fault> {
    let of_response = (name == options.response).then(|| response_fault(values, name)).flatten();
    let large = match values {
        Values::Numbers(numbers) => numbers.iter().find(|number| number.abs() > MAX_VALUE),
        Values::Texts(_) | Values::Levels { .. } => None,
    };
    let of_size = large.map(|large| {
        Fault::new(pointer, format!("expected numbers within ±{MAX_VALUE:.0e} for '{name}', got {large:e}"))
    });
    of_response.into_iter().chain(of_size).collect()
}

/// Faults of levels that are those of no attribute of the formula.
pub(super) fn check_levels(options: &Options, formulas: &Formulas) -> Vec<Fault> {
    let known: BTreeSet<&str> =
        formulas.own.variables.iter().map(|variable| variable.name.as_str()).collect();
    let unknown = options.levels.keys().filter(|name| !known.contains(name.as_str()));
    let fault = |name| Fault::new("/levels", format!("expected attributes of the formula, got '{name}'"));
    unknown.map(fault).collect()
}

fn response_fault(values: &Values, name: &str) -> Option<Fault> {
    let Values::Numbers(numbers) = values else {
        return Some(Fault::new(
            "/response",
            format!("expected an attribute whose values are numbers, got texts for '{name}'"),
        ));
    };
    let least = numbers.iter().copied().fold(f64::MAX, f64::min);
    let most = numbers.iter().copied().fold(f64::MIN, f64::max);
    (most - least < MIN_DEVIATION).then(|| {
        Fault::new("/response", format!("expected numbers that vary for '{name}', got {least} to {most}"))
    })
}
