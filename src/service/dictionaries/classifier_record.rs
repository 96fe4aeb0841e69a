//! Stored form of trained classifiers: conversion, validation, and preparation for use.

use crate::analysis::classification::atom_classes::AtomClasses;
use crate::analysis::classification::class_means::ClassMeans;
use crate::analysis::classification::discriminant::{Discriminant, Regularisation};
use crate::analysis::classification::ensemble::{Ensemble, Member, ROUNDS};
use crate::analysis::classification::neighbours::NearestNeighbours;
use crate::analysis::classification::record::{ClassifierRecord, Trained, TrainedMember};
use crate::analysis::classification::{Classifier, Kind};
use crate::analysis::dictionary::content::Content;
use crate::analysis::metric::Metric;
use crate::analysis::rows::{Row, columns_of, rows_of};
use crate::formats::fault::Fault;
use crate::numeric::dense::Matrix;

/// Stored form of a trained classifier.
pub(crate) fn trained_of(classifier: &Classifier, kind: Kind, metric: &Metric) -> Trained {
    match classifier {
        Classifier::MeanSpace(ClassMeans { means }) => {
            let rows = |mean: &Vec<f64>| {
                let mut control_points = mean.clone();
                metric.unwhiten(&mut control_points);
                rows_of(&control_points, metric.dimension())
            };
            Trained::MeanSpace { means: means.iter().map(rows).collect() }
        }
        Classifier::NearestAtom(AtomClasses { atoms }) => Trained::NearestAtom { atoms: atoms.clone() },
        Classifier::SparseResidual(AtomClasses { atoms }) => Trained::SparseResidual { atoms: atoms.clone() },
        Classifier::Discriminant(discriminant) => {
            let Discriminant { features, scales, means, factors, log_priors, shrinkage } =
                discriminant.clone();
            let pooling = match kind {
                Kind::Discriminant(regularisation) => regularisation.pooling,
                _ => 1.0,
            };
            let triangle = |factor: &Matrix| {
                let row = |i: usize| (0..=i).map(move |j| factor[(i, j)]);
                (0..factor.nrows()).flat_map(row).collect()
            };
            let factors = factors.iter().map(triangle).collect();
            Trained::Discriminant { features, scales, means, factors, log_priors, pooling, shrinkage }
        }
        Classifier::NearestNeighbours(nearest) => {
            let NearestNeighbours { neighbours, features, classes, size_factor, .. } = nearest;
            Trained::NearestNeighbours {
                neighbours: *neighbours,
                features: features.column_iter().map(|column| column.iter().copied().collect()).collect(),
                classes: classes.clone(),
                size_factor: *size_factor,
            }
        }
        Classifier::Ensemble(Ensemble { members }) => {
            let member = |member: &Member| TrainedMember {
                trained: trained_of(&member.classifier, member.kind, metric),
                sharpness: member.sharpness,
                weight: member.weight,
            };
            Trained::Ensemble { members: members.iter().map(member).collect() }
        }
    }
}

/// Kind of a stored classifier.
fn kind_of(trained: &Trained) -> Kind {
    match trained {
        Trained::MeanSpace { .. } | Trained::Ensemble { .. } => Kind::MeanSpace,
        Trained::NearestAtom { .. } => Kind::NearestAtom,
        Trained::SparseResidual { .. } => Kind::SparseResidual,
        Trained::Discriminant { pooling, shrinkage, .. } => Kind::Discriminant(Regularisation {
            components: None,
            pooling: *pooling,
            shrinkage: Some(*shrinkage),
        }),
        Trained::NearestNeighbours { neighbours, .. } => Kind::NearestNeighbours { neighbours: *neighbours },
    }
}

/// Prepares a stored classifier for use. Its parts are consistent: it was trained here, or [`classifier_faults`] has
/// found nothing.
pub(crate) fn classifier_of(record: &ClassifierRecord, metric: &Metric) -> Classifier {
    ready(record.trained.clone(), record.classes.len(), metric)
}

fn ready(trained: Trained, count: usize, metric: &Metric) -> Classifier {
    match trained {
        Trained::MeanSpace { means } => {
            let whitened = |rows: &Vec<Row>| {
                let mut columns = columns_of(rows, metric.dimension());
                metric.whiten(&mut columns);
                columns
            };
            Classifier::MeanSpace(ClassMeans { means: means.iter().map(whitened).collect() })
        }
        Trained::NearestAtom { atoms } => Classifier::NearestAtom(AtomClasses { atoms }),
        Trained::SparseResidual { atoms } => Classifier::SparseResidual(AtomClasses { atoms }),
        Trained::Discriminant { features, scales, means, factors, log_priors, shrinkage, .. } => {
            let size = features.len();
            let entry = |triangle: &[f64], i: usize, j: usize| {
                if j <= i { triangle[i * (i + 1) / 2 + j] } else { 0.0 }
            };
            let square = |triangle: &Vec<f64>| Matrix::from_fn(size, size, |i, j| entry(triangle, i, j));
            let factors = factors.iter().map(square).collect();
            Classifier::Discriminant(Discriminant { features, scales, means, factors, log_priors, shrinkage })
        }
        Trained::NearestNeighbours { neighbours, features, classes, size_factor } => {
            let rows = features.first().map_or(0, Vec::len);
            let features = Matrix::from_vec(rows, features.len(), features.concat());
            let nearest = NearestNeighbours { neighbours, features, classes, count, size_factor };
            Classifier::NearestNeighbours(nearest)
        }
        Trained::Ensemble { members } => {
            let member = |TrainedMember { trained, sharpness, weight }| Member {
                kind: kind_of(&trained),
                classifier: ready(trained, count, metric),
                sharpness,
                weight,
            };
            Classifier::Ensemble(Ensemble { members: members.into_iter().map(member).collect() })
        }
    }
}

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
