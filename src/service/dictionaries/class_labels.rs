//! Classes and subjects of the shapes of a cohort, for training a classifier.
//!
//! Classes are the values of an attribute; shapes of one subject stay together in cross-validation. Whether the classes
//! are sufficient for the requested classifier is checked before a job is stored.

use crate::analysis::classification::MAX_STORED;
use crate::analysis::classification::labels::ClassLabels;
use crate::analysis::classification::record::{ClassifierKind, ClassifierSettings, Feature};
use crate::analysis::dictionary::method::Method;
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeFilter;
use crate::formats::fault::Fault;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{Attribute, KnownAttributes, describe, first_names};

/// Maximum number of classes named in a fault.
const NAMED: usize = 5;

/// Maximum number of classes: a confusion matrix must stay readable.
const MAX_CLASSES: usize = 1000;

/// Maximum count of numbers of evidence kept by a validation.
const MAX_EVIDENCE: usize = 1 << 25;

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

/// Reasons why the classifier cannot be trained and validated on these shapes, which have `length` numbers each and
/// are described by `method`.
pub fn faults(
    labels: &ClassLabels,
    settings: &ClassifierSettings,
    method: &Method,
    length: usize,
) -> Vec<Fault> {
    if let Some(fault) = count_fault(labels, &settings.attribute) {
        return vec![fault];
    }
    let stored = stored(settings, method, labels.classes.len(), labels.labels.len(), length);
    let too_large = (stored > MAX_STORED).then(|| {
        let detail = format!(
            "expected a classifier of at most {MAX_STORED} numbers, got {stored}: ask for fewer components, \
             choose fewer shapes, or another kind"
        );
        at("kind", detail)
    });
    let found = [
        too_large,
        division_fault(labels, settings),
        neighbours_fault(labels, settings),
        evidence_fault(labels, settings),
    ];
    found.into_iter().flatten().collect()
}

fn at(field: &str, detail: String) -> Fault {
    Fault::new(format!("/classifier/{field}"), detail)
}

fn count_fault(labels: &ClassLabels, attribute: &str) -> Option<Fault> {
    let found = labels.labels.len();
    let detail = if found < 2 {
        let only = labels.labels.first().map_or("", String::as_str);
        format!("expected at least two classes, but all shapes have the same '{attribute}', '{only}'")
    } else if found > MAX_CLASSES {
        format!("expected at most {MAX_CLASSES} classes, got {found} values of '{attribute}'")
    } else {
        return None;
    };
    Some(at("attribute", detail))
}

/// Position of the first smallest number.
fn smallest(values: &[usize]) -> usize {
    (1..values.len()).fold(0, |best, c| if values[c] < values[best] { c } else { best })
}

/// Why the classes cannot be divided into the folds of the validation.
fn division_fault(labels: &ClassLabels, settings: &ClassifierSettings) -> Option<Fault> {
    let (sizes, units, folds) = (labels.sizes(), labels.units(), settings.folds);
    let fewest = smallest(&units);
    let (label, cases) = (&labels.labels[fewest], units[fewest]);
    let alone: Vec<&str> =
        (0..sizes.len()).filter(|&c| sizes[c] == 1).map(|c| labels.labels[c].as_str()).collect();
    if !alone.is_empty() {
        let named = alone[..alone.len().min(NAMED)].join("', '");
        let detail = format!(
            "expected at least 2 shapes in each class, but {} classes have only one ('{named}')",
            alone.len()
        );
        return Some(at("attribute", detail));
    }
    if folds > cases {
        let shapes = sizes[fewest];
        let of = match labels.subjects {
            Some(_) => format!("{shapes} shapes of {cases} subjects"),
            None => format!("{shapes} shapes"),
        };
        let detail = format!(
            "expected at most as many folds as the smallest class can be divided into, got {folds}: the class \
             '{label}' has {of}"
        );
        return Some(at("folds", detail));
    }
    let divides = settings.kind != ClassifierKind::Best || cases - cases.div_ceil(folds) >= 2;
    (!divides).then(|| {
        let detail = format!(
            "best divides the training shapes once more, but the class '{label}' has only {cases} cases: choose \
             another kind, or fewer folds"
        );
        at("kind", detail)
    })
}

fn neighbours_fault(labels: &ClassLabels, settings: &ClassifierSettings) -> Option<Fault> {
    let sizes = labels.sizes();
    let smallest = smallest(&sizes);
    let neighbours = settings.neighbours.filter(|&k| k > sizes[smallest])?;
    let (label, size) = (&labels.labels[smallest], sizes[smallest]);
    let detail = format!(
        "expected at most {size}, the number of shapes of the class '{label}' (which could never win otherwise), \
         got {neighbours}"
    );
    Some(at("neighbours", detail))
}

fn evidence_fault(labels: &ClassLabels, settings: &ClassifierSettings) -> Option<Fault> {
    let (shapes, classes) = (labels.classes.len(), labels.labels.len());
    let evidence = shapes.saturating_mul(classes).saturating_mul(settings.repeats);
    (evidence > MAX_EVIDENCE).then(|| {
        let detail = format!(
            "expected at most {MAX_EVIDENCE} numbers of evidence, got {evidence} ({shapes} shapes, {classes} \
             classes): choose fewer repeats"
        );
        at("repeats", detail)
    })
}

/// Count of numbers stored in a classifier of `shapes` shapes and `classes` classes. `best` chooses only kinds that are
/// small enough.
fn stored(
    settings: &ClassifierSettings,
    method: &Method,
    shapes: usize,
    classes: usize,
    length: usize,
) -> usize {
    let described = method.described(shapes, length);
    let features = settings.components.unwrap_or(described).min(described) + 1;
    match settings.kind {
        ClassifierKind::MeanSpace => classes.saturating_mul(length),
        ClassifierKind::NearestNeighbours => shapes.saturating_mul(features),
        ClassifierKind::Discriminant if settings.pooling.unwrap_or(1.0) < 1.0 => {
            classes.saturating_mul(features * features)
        }
        ClassifierKind::Discriminant
        | ClassifierKind::NearestAtom
        | ClassifierKind::SparseResidual
        | ClassifierKind::Best
        | ClassifierKind::Ensemble => 0,
    }
}

/// Faults of the settings of a classifier that do not depend on the shapes.
pub(crate) fn settings_faults(settings: &ClassifierSettings, method: &Method) -> Vec<Fault> {
    use ClassifierKind::{Best, Discriminant, NearestAtom, NearestNeighbours, SparseResidual};
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: String| {
        if !ok {
            faults.push(at(field, detail));
        }
    };
    let kind = settings.kind;
    let detail = "expected best or one of the other kinds, got ensemble: only best makes ensembles";
    check(kind != ClassifierKind::Ensemble, "kind", detail.into());
    let detail = "sparse_residual requires a sparse dictionary";
    check(kind != SparseResidual || method.is_sparse(), "kind", detail.into());
    let detail = "nearest_atom requires atoms that are shapes, but components about a centre are differences: \
                  learn sparse atoms, or components without centre";
    check(kind != NearestAtom || method.atoms_are_shapes(), "kind", detail.into());
    let attribute = settings.attribute.as_str();
    let classes = Attribute::parse(attribute).is_some_and(|attribute| attribute != Attribute::Subject);
    check(classes, "attribute", format!("expected label or labels.<attribute>, got '{attribute}'"));
    let features = &settings.features;
    check(features.contains(&Feature::Shape), "features", "expected shape among the features".into());
    check(
        features.len() <= 2 && (features.len() < 2 || features[0] != features[1]),
        "features",
        "expected different entries, got one twice".into(),
    );
    check(
        !settings.sees_size() || matches!(kind, Discriminant | NearestNeighbours | Best),
        "features",
        "the feature size requires the kind discriminant or nearest_neighbours".into(),
    );
    let only = |given: bool, owner: ClassifierKind| !given || kind == owner;
    let belongs = |owner: &str| format!("this field belongs to the kind {owner}");
    check(only(settings.components.is_some(), Discriminant), "components", belongs("discriminant"));
    check(only(settings.pooling.is_some(), Discriminant), "pooling", belongs("discriminant"));
    check(only(settings.shrinkage.is_some(), Discriminant), "shrinkage", belongs("discriminant"));
    check(
        only(settings.neighbours.is_some(), NearestNeighbours),
        "neighbours",
        belongs("nearest_neighbours"),
    );
    faults.extend(range_faults(settings, method.atoms()));
    faults
}

/// Numbers of the settings that are out of range, for a dictionary of `atoms` atoms.
fn range_faults(settings: &ClassifierSettings, atoms: usize) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: String| {
        if !ok {
            faults.push(at(field, detail));
        }
    };
    if let Some(components) = settings.components {
        check(
            (1..=atoms).contains(&components),
            "components",
            format!("expected a number between 1 and {atoms}, got {components}"),
        );
    }
    for (field, value) in [("pooling", settings.pooling), ("shrinkage", settings.shrinkage)] {
        if let Some(value) = value {
            check(
                (0.0..=1.0).contains(&value),
                field,
                format!("expected a number between 0 and 1, got {value}"),
            );
        }
    }
    if let Some(neighbours) = settings.neighbours {
        check(neighbours >= 1, "neighbours", "expected at least 1, got 0".into());
    }
    check(
        (2..=100).contains(&settings.folds),
        "folds",
        format!("expected a number between 2 and 100, got {}", settings.folds),
    );
    check(
        (1..=100).contains(&settings.repeats),
        "repeats",
        format!("expected a number between 1 and 100, got {}", settings.repeats),
    );
    faults
}
