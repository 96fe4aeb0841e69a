//! Checks of the classifier in an imported file.

use crate::analysis::classification::ensemble::ROUNDS;
use crate::analysis::classification::record::{ClassifierRecord, Trained, TrainedMember};
use crate::analysis::dictionary::content::Content;
use crate::analysis::rows::Row;
use crate::formats::fault::Fault;

/// Largest number in a file whose square is finite.
const MAX_NUMBER: f64 = 1e100;

/// Inconsistencies in the classifier of a file whose dictionary is valid: wrong sizes, and values that training never
/// produces.
pub(crate) fn classifier_faults(content: &Content) -> Vec<Fault> {
    let Some(record) = &content.classifier else { return Vec::new() };
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(Fault::new(format!("/content/classifier/{field}"), detail));
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
) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(Fault::new(format!("/content/classifier/{at}/{field}"), detail));
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
fn trained_faults(content: &Content, record: &ClassifierRecord, trained: &Trained, at: &str) -> Vec<Fault> {
    if let Trained::Ensemble { members } = trained {
        return member_faults(content, record, members, at);
    }
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(Fault::new(format!("/content/classifier/{at}/{field}"), detail));
        }
    };
    let classes = record.classes.len();
    let atoms = content.atoms.len();
    let described = atoms + usize::from(record.settings.sees_size());
    let (size, dimension) = (content.representation.size(), content.representation.dimension());
    let finite = |values: &[f64]| values.iter().all(|value| value.abs() <= MAX_NUMBER);
    match trained {
        Trained::MeanSpace { means } => {
            let shape = |rows: &Vec<Row>| {
                rows.len() == size
                    && rows.iter().all(|row| row.len() == dimension && finite(row))
                    && rows.iter().flatten().any(|value| *value != 0.0)
            };
            let fits = means.len() == classes && means.iter().all(shape);
            check(fits, "means", "expected one shape of the representation per class");
        }
        Trained::NearestAtom { atoms: of } | Trained::SparseResidual { atoms: of } => {
            let own = |of: &Vec<usize>| of.is_sorted_by(|a, b| a < b) && of.iter().all(|&j| j < atoms);
            let fits = of.len() == classes && of.iter().all(own);
            check(fits, "atoms", "expected the atoms of every class in ascending order");
        }
        Trained::Discriminant { features, scales, means, factors, log_priors, .. } => {
            let p = features.len();
            let fits =
                p > 0 && features.iter().all(|&i| i < described) && features.is_sorted_by(|a, b| a < b);
            check(fits, "features", "expected positions of features in ascending order");
            let fits = scales.len() == p && scales.iter().all(|scale| *scale > 0.0 && *scale <= MAX_NUMBER);
            check(fits, "scales", "expected one positive number per feature");
            let fits = means.len() == classes && means.iter().all(|mean| mean.len() == p && finite(mean));
            check(fits, "means", "expected the features of every class");
            let triangle = |factor: &Vec<f64>| {
                factor.len() == p * (p + 1) / 2
                    && finite(factor)
                    && (0..p).all(|i| factor[i * (i + 3) / 2] > 1e-100)
            };
            let fits = (factors.len() == 1 || factors.len() == classes) && factors.iter().all(triangle);
            check(fits, "factors", "expected lower triangles with a positive diagonal");
            let fits = log_priors.len() == classes && finite(log_priors);
            check(fits, "log_priors", "expected one number per class");
        }
        Trained::NearestNeighbours { neighbours, features, classes: of, size_factor } => {
            check(
                (1..=of.len()).contains(neighbours),
                "neighbours",
                "expected at least one neighbour, and at most as many as there are shapes",
            );
            let fits = features.len() == of.len()
                && features.iter().all(|features| features.len() == described && finite(features));
            check(fits, "features", "expected the features of every shape");
            let all =
                (0..classes).all(|class| of.contains(&class)) && of.iter().all(|&class| class < classes);
            check(all, "classes", "expected positions of classes, every class at least once");
            let fits = size_factor.is_some() == record.settings.sees_size()
                && size_factor.is_none_or(|factor| (0.0..=MAX_NUMBER).contains(&factor));
            check(fits, "size_factor", "expected a factor exactly when size is one of the features");
        }
        Trained::Ensemble { .. } => {}
    }
    faults
}
