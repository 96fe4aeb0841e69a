//! Consistency of a recorded classifier with its dictionary.

use super::ensemble::ROUNDS;
use crate::classifier_record::{ClassifierRecord, Trained, TrainedMember};
use crate::dictionary::content::Content;
use crate::rows::Row;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_numeric::MAX_NUMBER;

/// Inconsistencies in the classifier of a content that is consistent otherwise, at fields of `classifier`: wrong sizes, and
/// values that training never produces.
pub fn classifier_faults(content: &Content) -> Vec<FieldFault> {
    let Some(record) = &content.classifier else { return Vec::new() };
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(FieldFault::new(format!("classifier/{field}"), detail));
        }
    };
    check(record.classes.len() >= 2, "classes", "expected at least two classes");
    for (c, class) in record.classes.iter().enumerate() {
        let sorted = !class.distances.is_empty() && class.distances.is_sorted();
        check(sorted, &format!("classes/{c}/distances"), "expected numbers in ascending order");
    }
    check(is_sharpness(record.sharpness), "sharpness", "expected a positive number up to 1e9");
    faults.extend(trained_faults(content, record, &record.trained, "trained"));
    faults
}

fn is_sharpness(value: f64) -> bool {
    value > 0.0 && value <= 1e9
}

/// Tolerance of the sum of rounded weights.
const SUM_OF_WEIGHTS: f64 = 1e-9;

/// Inconsistencies in an ensemble of classifiers.
fn member_faults(
    content: &Content,
    record: &ClassifierRecord,
    members: &[TrainedMember],
    at: &str,
) -> Vec<FieldFault> {
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(FieldFault::new(format!("classifier/{at}/{field}"), detail));
        }
    };
    check((1..=ROUNDS).contains(&members.len()), "members", "expected between one and twelve members");
    let weights: f64 = members.iter().map(|member| member.weight).sum();
    let positive = members.iter().all(|member| member.weight > 0.0);
    check(
        positive && (weights - 1.0).abs() <= SUM_OF_WEIGHTS,
        "members",
        "expected positive weights that sum to 1",
    );
    let sharp = members.iter().all(|member| is_sharpness(member.sharpness));
    check(sharp, "members", "expected a positive sharpness up to 1e9 for every member");
    let single = |member: &TrainedMember| !matches!(member.trained, Trained::Ensemble { .. });
    check(members.iter().all(single), "members", "expected single classifiers, got ensembles");
    for (i, member) in members.iter().enumerate().filter(|(_, member)| single(member)) {
        let at = format!("{at}/members/{i}/trained");
        faults.extend(trained_faults(content, record, &member.trained, &at));
    }
    faults
}

/// Inconsistencies in the numbers of a classifier, or of an ensemble member, at `at`.
fn trained_faults(
    content: &Content,
    record: &ClassifierRecord,
    trained: &Trained,
    at: &str,
) -> Vec<FieldFault> {
    if let Trained::Ensemble { members } = trained {
        return member_faults(content, record, members, at);
    }
    let wrong = checks(content, record, trained).into_iter().filter(|(fits, ..)| !fits);
    let fault =
        |(_, field, detail)| FieldFault::new(format!("classifier/{at}/{field}"), String::from(detail));
    wrong.map(fault).collect()
}

/// Whether a field is consistent, its name, and the expectation.
type Check = (bool, &'static str, &'static str);

/// Checks of a single classifier.
fn checks(content: &Content, record: &ClassifierRecord, trained: &Trained) -> Vec<Check> {
    let (classes, atoms) = (record.classes.len(), content.atoms.len());
    let described = atoms + usize::from(record.settings.sees_size());
    let (size, dimension) = (content.representation.size(), content.representation.dimension());
    match trained {
        Trained::MeanSpace { means } => {
            let shape = |rows: &Vec<Row>| {
                rows.len() == size
                    && rows.iter().all(|row| row.len() == dimension && finite(row))
                    && rows.iter().flatten().any(|value| *value != 0.0)
            };
            let fits = means.len() == classes && means.iter().all(shape);
            vec![(fits, "means", "expected one shape of the representation per class")]
        }
        Trained::NearestAtom { atoms: of } | Trained::SparseResidual { atoms: of } => {
            let own = |of: &Vec<usize>| of.is_sorted_by(|a, b| a < b) && of.iter().all(|&j| j < atoms);
            let fits = of.len() == classes && of.iter().all(own);
            vec![(fits, "atoms", "expected the atoms of every class in ascending order")]
        }
        Trained::Discriminant { .. } => discriminant_checks(trained, classes, described),
        Trained::NearestNeighbours { .. } => neighbour_checks(record, trained, described),
        Trained::Ensemble { .. } => Vec::new(),
    }
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|value| value.abs() <= MAX_NUMBER)
}

/// Checks of a discriminant of shapes with `described` features.
fn discriminant_checks(trained: &Trained, classes: usize, described: usize) -> Vec<Check> {
    let Trained::Discriminant { features, scales, means, factors, log_priors, .. } = trained else {
        return Vec::new();
    };
    let p = features.len();
    let ascending = features.iter().all(|&i| i < described) && features.is_sorted_by(|a, b| a < b);
    let positive = |scale: &f64| *scale > 0.0 && *scale <= MAX_NUMBER;
    let triangle = |factor: &Vec<f64>| {
        factor.len() == p * (p + 1) / 2 && finite(factor) && (0..p).all(|i| factor[i * (i + 3) / 2] > 1e-100)
    };
    let factors_fit = (factors.len() == 1 || factors.len() == classes) && factors.iter().all(triangle);
    let means_fit = means.len() == classes && means.iter().all(|mean| mean.len() == p && finite(mean));
    vec![
        (p > 0 && ascending, "features", "expected positions of features in ascending order"),
        (
            scales.len() == p && scales.iter().all(positive),
            "scales",
            "expected one positive number per feature",
        ),
        (means_fit, "means", "expected the features of every class"),
        (factors_fit, "factors", "expected lower triangles with a positive diagonal"),
        (log_priors.len() == classes && finite(log_priors), "log_priors", "expected one number per class"),
    ]
}

/// Checks of a vote of neighbours among shapes with `described` features.
fn neighbour_checks(record: &ClassifierRecord, trained: &Trained, described: usize) -> Vec<Check> {
    let Trained::NearestNeighbours { neighbours, features, classes: of, size_factor } = trained else {
        return Vec::new();
    };
    let classes = record.classes.len();
    let features_fit = features.len() == of.len()
        && features.iter().all(|features| features.len() == described && finite(features));
    let all = (0..classes).all(|class| of.contains(&class)) && of.iter().all(|&class| class < classes);
    let factor_fits = size_factor.is_some() == record.settings.sees_size()
        && size_factor.is_none_or(|factor| (0.0..=MAX_NUMBER).contains(&factor));
    vec![
        (
            (1..=of.len()).contains(neighbours),
            "neighbours",
            "expected at least one neighbour, and at most as many as there are shapes",
        ),
        (features_fit, "features", "expected the features of every shape"),
        (all, "classes", "expected positions of classes, every class at least once"),
        (factor_fits, "size_factor", "expected a factor exactly when size is one of the features"),
    ]
}
