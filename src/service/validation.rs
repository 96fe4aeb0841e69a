//! Training and validation of the classifier of a dictionary.
//!
//! In every part of the cross-validation the mean shape, the alignment, the dictionary and the classifier are learnt
//! anew from the other parts alone: what is classified has had no influence on anything. A choice by `best` is made
//! within the training shapes, by a cross-validation of their own.

use rayon::prelude::*;

use super::learning::{Task, quantiles};
use super::membership::{MOST_STORED, Membership, WITHIN, units};
use super::models;
use super::{ServiceError, classify, error::Fault};
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::classification::discriminant::Regularisation;
use crate::analysis::classification::folds::stratified;
use crate::analysis::classification::quality::{BINS, Held, Part, Quality, confidences, sharpness};
use crate::analysis::classification::{
    Classifier, Description, Kind, Labelled, Observations, described, subset,
};
use crate::analysis::dictionary::model::Model;
use crate::analysis::dictionary::preparation::Preparation;
use crate::analysis::sparse::SparseCode;
use crate::domain::classifier::{
    Candidate, ClassQuality, ClassRecord, ClassifierKind, ClassifierRecord, ClassifierSettings, PartRecord,
    ReliabilityBin, Validation,
};
use crate::domain::dictionary::Content;

/// Components that `best` tries, as far as there are as many.
const COMPONENTS: [usize; 8] = [5, 8, 10, 15, 20, 30, 40, 60];
/// Poolings that `best` tries.
const POOLINGS: [f64; 4] = [1.0, 0.5, 0.25, 0.0];
/// Shrinkages that `best` tries.
const SHRINKAGES: [Option<f64>; 4] = [None, Some(0.01), Some(0.1), Some(0.3)];
/// Votes that `best` tries.
const NEIGHBOURS: [usize; 4] = [1, 3, 5, 9];
/// Candidates that are written down.
const REPORTED: usize = 10;

/// Labelled shapes that a classifier is trained and validated on.
pub(super) struct Study<'a> {
    /// How dictionaries are learnt.
    pub(super) task: &'a Task<'a>,
    /// Whitened shapes as given, centred when the class translates.
    pub(super) shapes: &'a ShapesInMemory,
    /// Their classes and subjects.
    pub(super) membership: &'a Membership,
    /// What is asked for.
    pub(super) settings: &'a ClassifierSettings,
}

/// A dictionary that was learnt from some of the shapes.
struct Learnt {
    preparation: Preparation,
    model: Model,
}

/// Some of the shapes, as a dictionary describes them.
struct Described {
    shapes: ShapesInMemory,
    prepared: Vec<f64>,
    codes: Vec<SparseCode>,
    classes: Vec<usize>,
}

impl Described {
    fn observations(&self) -> Observations<'_> {
        let shapes = self.shapes.all().whitened;
        Observations { shapes, prepared: &self.prepared, codes: &self.codes }
    }
}

impl Study<'_> {
    /// Validates, then trains on all shapes in the dictionary of `content`. `report` hears of the part that is done.
    ///
    /// # Errors
    /// Degenerate shapes by their position; covariances that cannot be inverted; [`ServiceError::Cancelled`].
    pub(super) fn record(
        &self,
        content: &Content,
        report: &(dyn Fn(f64) + Sync),
    ) -> Result<ClassifierRecord, ServiceError> {
        let held = self.validate(report)?;
        let everything: Vec<usize> = (0..self.membership.classes.len()).collect();
        let seed = self.settings.seed;
        let (kind, candidates) = match self.kind() {
            Some(kind) => (kind, None),
            None => {
                let (kind, candidates) = self.choose(&everything, seed)?;
                (kind, Some(candidates))
            }
        };
        let (setup, preparation, model) = models::prepare(self.task.app, content)?;
        let learnt = Learnt { preparation, model };
        let classifier = self.train(kind, &learnt, &self.describe(&learnt, &everything)?)?;
        let classes = self.classes(&held);
        let validation = self.report(&held, candidates);
        let trained = classify::trained_of(&classifier, kind, &setup.metric);
        let (settings, sharpness) = (self.settings.clone(), sharpness(held.iter()));
        Ok(ClassifierRecord { settings, classes, trained, sharpness, validation })
    }

    /// The kind that is asked for, unless it is to be chosen.
    fn kind(&self) -> Option<Kind> {
        let settings = self.settings;
        Some(match settings.kind {
            ClassifierKind::MeanSpace => Kind::MeanSpace,
            ClassifierKind::NearestAtom => Kind::NearestAtom,
            ClassifierKind::SparseResidual => Kind::SparseResidual,
            ClassifierKind::Discriminant => Kind::Discriminant(Regularisation {
                components: settings.components,
                pooling: settings.pooling.unwrap_or(1.0),
                shrinkage: settings.shrinkage,
            }),
            ClassifierKind::NearestNeighbours => {
                Kind::NearestNeighbours { neighbours: settings.neighbours.unwrap_or(5) }
            }
            ClassifierKind::Best => return None,
        })
    }

    /// Every shape, classified once a repeat by what was learnt without it.
    fn validate(&self, report: &(dyn Fn(f64) + Sync)) -> Result<Vec<Held>, ServiceError> {
        let ClassifierSettings { folds, repeats, seed, .. } = *self.settings;
        let Membership { classes, groups, .. } = self.membership;
        let done = std::sync::atomic::AtomicUsize::new(0);
        let hold_out = |(number, fold_of, fold): (usize, &Vec<usize>, usize)| {
            let (inside, outside) = divided(fold_of, fold);
            self.check_classes(&inside)?;
            let kind = match self.kind() {
                Some(kind) => kind,
                None => self.choose(&inside, seed.wrapping_add(number as u64))?.0,
            };
            let learnt = self.learn(&inside)?;
            let classifier = self.train(kind, &learnt, &self.describe(&learnt, &inside)?)?;
            let described = self.describe(&learnt, &outside)?;
            let evidence = classifier.evidence(self.description(&learnt), described.observations());
            let evidence = evidence.map_err(|error| self.located(error, &outside))?;
            let count = 1 + done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            report(count as f64 / (folds * repeats) as f64);
            let held = outside.iter().zip(evidence);
            let held =
                held.map(|(&shape, evidence)| Held { shape, class: classes[shape], fold: number, evidence });
            Ok(held.collect::<Vec<_>>())
        };
        let divisions: Vec<Vec<usize>> = (0..repeats)
            .map(|repeat| stratified(classes, groups, folds, seed.wrapping_add(repeat as u64)))
            .collect();
        let parts: Vec<(usize, &Vec<usize>, usize)> = divisions
            .iter()
            .enumerate()
            .flat_map(|(repeat, fold_of)| (0..folds).map(move |fold| (repeat * folds + fold, fold_of, fold)))
            .collect();
        // A fold at a time would leave threads idle in the small problems of a fold.
        let held: Result<Vec<Vec<Held>>, ServiceError> = parts.into_par_iter().map(hold_out).collect();
        Ok(held?.concat())
    }

    /// The candidate that gets most shapes right when it is trained on other ones; all of them, the best first.
    fn choose(&self, chosen: &[usize], seed: u64) -> Result<(Kind, Vec<Candidate>), ServiceError> {
        let classes: Vec<usize> = chosen.iter().map(|&k| self.membership.classes[k]).collect();
        let groups: Vec<usize> = chosen.iter().map(|&k| self.membership.groups[k]).collect();
        let cases = units(&classes, &groups, self.membership.labels.len());
        let fewest = cases.into_iter().min().unwrap_or(0);
        let fold_of = stratified(&classes, &groups, WITHIN.min(fewest).max(2), seed);
        let folds = fold_of.iter().max().map_or(0, |most| most + 1);
        let mut tallies: Vec<(Kind, usize, f64)> = Vec::new();
        let mut shapes = 0;
        for fold in 0..folds {
            let (inside, outside) = divided(&fold_of, fold);
            let inside: Vec<usize> = inside.iter().map(|&k| chosen[k]).collect();
            let outside: Vec<usize> = outside.iter().map(|&k| chosen[k]).collect();
            if self.check_classes(&inside).is_err() || outside.is_empty() {
                continue;
            }
            let learnt = self.learn(&inside)?;
            let (training, test) = (self.describe(&learnt, &inside)?, self.describe(&learnt, &outside)?);
            if shapes == 0 {
                let kinds = candidates(&learnt.model, self.membership);
                tallies = kinds.into_iter().map(|kind| (kind, 0, 0.0)).collect();
            }
            shapes += outside.len();
            let tried: Vec<Option<(usize, f64)>> = tallies
                .par_iter()
                .map(|(kind, ..)| {
                    self.task.context.check()?;
                    self.tried(*kind, &learnt, &training, &test, &outside)
                })
                .collect::<Result<_, ServiceError>>()?;
            // What cannot be trained on a part is out of the question.
            let pairs = std::mem::take(&mut tallies).into_iter().zip(tried);
            tallies = pairs
                .filter_map(|((kind, right, loss), tried)| {
                    tried.map(|(more, further)| (kind, right + more, loss + further))
                })
                .collect();
        }
        // Of equal counts the more confident one, then the first.
        tallies.sort_by(|a, b| b.1.cmp(&a.1).then(a.2.total_cmp(&b.2)));
        let none = || {
            ServiceError::invalid("/classifier/kind", "no candidate can be trained on parts of these shapes")
        };
        let best = tallies.first().ok_or_else(none)?.0;
        let candidate =
            |&(kind, right, _): &(Kind, usize, f64)| candidate(kind, right as f64 / shapes as f64);
        Ok((best, tallies.iter().take(REPORTED).map(candidate).collect()))
    }

    /// Shapes that a candidate gets right, and its log loss; none when it cannot be trained.
    fn tried(
        &self,
        kind: Kind,
        learnt: &Learnt,
        training: &Described,
        test: &Described,
        outside: &[usize],
    ) -> Result<Option<(usize, f64)>, ServiceError> {
        let classifier = match self.train(kind, learnt, training) {
            Ok(classifier) => classifier,
            Err(ServiceError::Invalid(_)) => return Ok(None),
            Err(error) => return Err(error),
        };
        let evidence = classifier.evidence(self.description(learnt), test.observations());
        let evidence = evidence.map_err(|error| self.located(error, outside))?;
        let held: Vec<Held> = evidence
            .into_iter()
            .zip(outside)
            .map(|(evidence, &shape)| Held {
                shape,
                class: self.membership.classes[shape],
                fold: 0,
                evidence,
            })
            .collect();
        let right = held.iter().filter(|held| held.evidence.best() == held.class).count();
        let beta = sharpness(held.iter());
        let loss = |held: &Held| {
            let p = confidences(&held.evidence, beta)[held.class];
            -p.max(f64::MIN_POSITIVE).ln()
        };
        Ok(Some((right, held.iter().map(loss).sum())))
    }

    fn learn(&self, chosen: &[usize]) -> Result<Learnt, ServiceError> {
        self.task.context.check()?;
        let content = self.task.content_of(&subset(self.shapes, chosen));
        let content = content.map_err(|error| renumbered(error, chosen))?;
        let (_, preparation, model) = models::prepare(self.task.app, &content)?;
        Ok(Learnt { preparation, model })
    }

    fn describe(&self, learnt: &Learnt, chosen: &[usize]) -> Result<Described, ServiceError> {
        let shapes = subset(self.shapes, chosen);
        let (prepared, codes) = described(&learnt.preparation, &learnt.model, &shapes)
            .map_err(|error| self.located(error, chosen))?;
        let classes = chosen.iter().map(|&k| self.membership.classes[k]).collect();
        Ok(Described { shapes, prepared, codes, classes })
    }

    fn description<'b>(&self, learnt: &'b Learnt) -> Description<'b> {
        Description {
            preparation: &learnt.preparation,
            model: &learnt.model,
            size: self.settings.sees_size(),
        }
    }

    fn train(&self, kind: Kind, learnt: &Learnt, training: &Described) -> Result<Classifier, ServiceError> {
        let sample = Labelled {
            observations: training.observations(),
            weights: training.shapes.all().weights,
            classes: &training.classes,
            count: self.membership.labels.len(),
        };
        Classifier::train(kind, self.description(learnt), sample).map_err(|error| self.located(error, &[]))
    }

    /// An error with the position of the shape among all, and the name of the class.
    fn located(&self, error: AnalysisError, chosen: &[usize]) -> ServiceError {
        match error {
            AnalysisError::SingularCovariance { class } => {
                let label = self.membership.labels.get(class).map_or("", String::as_str);
                let detail = format!(
                    "the covariance of the class '{label}' cannot be inverted: fewer components, more pooling or more \
                     shrinkage are needed"
                );
                ServiceError::invalid("/classifier/shrinkage", detail)
            }
            error => renumbered(error.into(), chosen),
        }
    }

    /// That every class has a shape among the chosen ones.
    fn check_classes(&self, chosen: &[usize]) -> Result<(), ServiceError> {
        let mut found = vec![false; self.membership.labels.len()];
        chosen.iter().for_each(|&k| found[self.membership.classes[k]] = true);
        let Some(absent) = found.iter().position(|found| !found) else { return Ok(()) };
        let detail = format!(
            "leave no shape of the class '{}' to be trained on, because its subjects have shapes of other classes too: \
             choose fewer or another seed",
            self.membership.labels[absent]
        );
        Err(ServiceError::invalid("/classifier/folds", detail))
    }

    fn classes(&self, held: &[Held]) -> Vec<ClassRecord> {
        let sizes = self.membership.sizes();
        let record = |(class, label): (usize, &String)| {
            let own = held.iter().filter(|held| held.class == class);
            ClassRecord {
                label: label.clone(),
                shapes: sizes[class],
                distances: quantiles(own.map(|held| held.evidence.distances[class]).collect()),
            }
        };
        self.membership.labels.iter().enumerate().map(record).collect()
    }

    fn report(&self, held: &[Held], candidates: Option<Vec<Candidate>>) -> Validation {
        let ClassifierSettings { folds, repeats, seed, .. } = *self.settings;
        let (labels, units, sizes) =
            (&self.membership.labels, self.membership.units(), self.membership.sizes());
        let cases = self.membership.groups.iter().max().map_or(0, |most| most + 1);
        let quality = Quality::new(held, labels.len(), repeats, &units, cases);
        let part = |part: &Part| PartRecord { value: part.value, low: part.low, high: part.high };
        let classes = labels.iter().zip(&quality.recall).zip(&quality.precision);
        let shapes = self.membership.classes.len();
        Validation {
            folds,
            repeats,
            seed,
            shapes,
            subjects: self.membership.subjects,
            accuracy: part(&quality.accuracy),
            accuracies: quality.accuracies.clone(),
            majority: sizes.iter().copied().max().unwrap_or(0) as f64 / shapes.max(1) as f64,
            balanced_accuracy: part(&quality.balanced_accuracy),
            classes: classes
                .map(|((label, recall), precision)| ClassQuality {
                    label: label.clone(),
                    recall: part(recall),
                    precision: *precision,
                })
                .collect(),
            brier: quality.brier,
            log_loss: quality.log_loss,
            reliability: quality
                .reliability
                .iter()
                .enumerate()
                .map(|(i, bin)| ReliabilityBin {
                    from: i as f64 / BINS as f64,
                    count: bin.count,
                    confidence: bin.confidence,
                    accuracy: bin.accuracy,
                })
                .collect(),
            confusion: quality.confusion,
            candidates,
        }
    }
}

/// Positions outside of a fold, and those in it.
fn divided(fold_of: &[usize], fold: usize) -> (Vec<usize>, Vec<usize>) {
    (0..fold_of.len()).partition(|&k| fold_of[k] != fold)
}

/// What `best` chooses from, as far as it is small enough to be kept.
fn candidates(model: &Model, membership: &Membership) -> Vec<Kind> {
    let (shapes, classes) = (membership.classes.len(), membership.labels.len());
    let mut kinds = Vec::new();
    if classes * model_length(model) <= MOST_STORED {
        kinds.push(Kind::MeanSpace);
    }
    match model {
        Model::Sparse { .. } => kinds.extend([Kind::NearestAtom, Kind::SparseResidual]),
        Model::Components { pca, .. } if !pca.centred => kinds.push(Kind::NearestAtom),
        // Differences from a centre are no shapes that another could be near to.
        Model::Components { .. } => {}
    }
    if shapes * (model.len() + 1) <= MOST_STORED {
        kinds.extend(NEIGHBOURS.map(|neighbours| Kind::NearestNeighbours { neighbours }));
    }
    let mut sizes: Vec<usize> = COMPONENTS.iter().copied().filter(|&count| count < model.len()).collect();
    sizes.push(model.len());
    for count in sizes {
        for pooling in POOLINGS {
            if pooling < 1.0 && classes * (count + 1) * (count + 1) > MOST_STORED {
                continue;
            }
            for shrinkage in SHRINKAGES {
                let components = Some(count);
                kinds.push(Kind::Discriminant(Regularisation { components, pooling, shrinkage }));
            }
        }
    }
    kinds
}

/// Numbers of a shape.
fn model_length(model: &Model) -> usize {
    match model {
        Model::Components { pca, .. } => pca.mean.len(),
        Model::Sparse { algebra, atoms, .. } => atoms.matrix().nrows() * algebra.size(),
    }
}

fn candidate(kind: Kind, accuracy: f64) -> Candidate {
    let plain = |kind| Candidate {
        kind,
        components: None,
        pooling: None,
        shrinkage: None,
        neighbours: None,
        accuracy,
    };
    match kind {
        Kind::MeanSpace => plain(ClassifierKind::MeanSpace),
        Kind::NearestAtom => plain(ClassifierKind::NearestAtom),
        Kind::SparseResidual => plain(ClassifierKind::SparseResidual),
        Kind::NearestNeighbours { neighbours } => {
            Candidate { neighbours: Some(neighbours), ..plain(ClassifierKind::NearestNeighbours) }
        }
        Kind::Discriminant(Regularisation { components, pooling, shrinkage }) => {
            Candidate { components, pooling: Some(pooling), shrinkage, ..plain(ClassifierKind::Discriminant) }
        }
    }
}

/// The error about a shape of a part, with its position among all.
fn renumbered(error: ServiceError, chosen: &[usize]) -> ServiceError {
    match error {
        ServiceError::DegenerateShape(faults) => {
            let moved = |fault: Fault| match fault.index.and_then(|index| chosen.get(index)) {
                Some(&index) => Fault { index: Some(index), pointer: format!("/shapes/{index}"), ..fault },
                None => fault,
            };
            ServiceError::DegenerateShape(faults.into_iter().map(moved).collect())
        }
        other => other,
    }
}
