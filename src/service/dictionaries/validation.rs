//! Training and validation of the classifier of a dictionary.
//!
//! In every fold of the cross-validation, the mean shape, the alignment, the dictionary and the classifier are learnt
//! anew from the other folds alone, so that held-out shapes influence nothing. A choice by `best` is made within the
//! training shapes, by an inner cross-validation.
//!
//! Such choices differ between folds, and so do the units of the chosen kinds. The scores of a fold are therefore
//! converted to log probabilities, calibrated within the training shapes of that fold, before folds are combined.
//! Confidences and limits of the final classifier come from one more cross-validation of the choice made on all shapes:
//! from its own scores and distances.

use crate::formats::fault::Fault;
use rayon::prelude::*;

use super::class_labels::{MAX_STORED, Membership, WITHIN, units};
use super::learning::{Task, quantiles};
use super::{classifier_record, ready};
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::ShapesInMemory;
use crate::analysis::classification::discriminant::Regularisation;
use crate::analysis::classification::ensemble::{self, Ensemble, Member, ROUNDS, selected};
use crate::analysis::classification::folds::stratified;
use crate::analysis::classification::quality::{BINS, Held, Part, Quality, confidences, sharpness};
use crate::analysis::classification::record::{
    Candidate, ChosenQuality, ClassQuality, ClassRecord, ClassifierKind, ClassifierRecord,
    ClassifierSettings, PartRecord, ReliabilityBin, Validation,
};
use crate::analysis::classification::{
    Classifier, Description, Evidence, Kind, Labelled, Observations, described, subset,
};
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::model::Model;
use crate::analysis::dictionary::preparation::Preparation;
use crate::analysis::sparse::SparseCode;
use crate::service::app::ServiceError;

/// Numbers of components that `best` tries, as far as available.
const COMPONENTS: [usize; 8] = [5, 8, 10, 15, 20, 30, 40, 60];
/// Poolings that `best` tries.
const POOLINGS: [f64; 4] = [1.0, 0.5, 0.25, 0.0];
/// Shrinkages that `best` tries.
const SHRINKAGES: [Option<f64>; 4] = [None, Some(0.01), Some(0.1), Some(0.3)];
/// Numbers of neighbours that `best` tries.
const NEIGHBOURS: [usize; 4] = [1, 3, 5, 9];
/// Number of reported candidates.
const REPORTED: usize = 10;

/// Maximum count of probabilities kept for the candidates of one choice, 32 MB; beyond it, only every second candidate
/// is tried, or fewer.
const MAX_TRIED: usize = 1 << 22;

/// Chooses what to train, given the training shapes and the number of the fold.
type Chooser<'a> = dyn Fn(&[usize], usize) -> Result<Choice, ServiceError> + Sync + 'a;

/// A kind of classifier to train, or several with the sharpness and weight of their probabilities, the heaviest first.
#[derive(Debug, Clone, PartialEq)]
struct Choice {
    ballots: Vec<Ballot>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Ballot {
    kind: Kind,
    sharpness: f64,
    weight: f64,
}

impl Choice {
    /// A single kind with its own scores.
    fn of(kind: Kind) -> Self {
        Self { ballots: vec![Ballot { kind, sharpness: 1.0, weight: 1.0 }] }
    }

    fn first(&self) -> Kind {
        self.ballots[0].kind
    }

    /// Converts scores of a single kind to log probabilities; those of several kinds are log probabilities already.
    fn standardise(&self, evidence: &mut [Evidence]) {
        let [only] = self.ballots.as_slice() else { return };
        for evidence in evidence {
            evidence.scores =
                confidences(evidence, only.sharpness).into_iter().map(ensemble::logarithm).collect();
        }
    }
}

/// Whether scores keep the units of their classifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scores {
    AsTheyAre,
    Standardised,
}

/// Results of a candidate on shapes on which it was not trained.
struct Trial {
    kind: Kind,
    /// Number of correctly classified shapes.
    right: usize,
    /// Sharpness `β` of its probabilities.
    sharpness: f64,
    /// Probability of the true class of each shape.
    likelihoods: Vec<f64>,
}

impl Trial {
    fn new(kind: Kind, held: &[Held]) -> Self {
        let sharpness = sharpness(held.iter());
        Self {
            kind,
            right: held.iter().filter(|held| held.evidence.best() == held.class).count(),
            sharpness,
            likelihoods: held.iter().map(|held| confidences(&held.evidence, sharpness)[held.class]).collect(),
        }
    }

    /// Log loss.
    fn loss(&self) -> f64 {
        -self.likelihoods.iter().map(|p| ensemble::logarithm(*p)).sum::<f64>()
    }
}

/// Labelled shapes on which a classifier is trained and validated.
pub(crate) struct Study<'a> {
    /// Learning task of the dictionary.
    pub(crate) task: &'a Task<'a>,
    /// Whitened shapes as given, centred if the class translates.
    pub(crate) shapes: &'a ShapesInMemory,
    /// Classes and subjects of the shapes.
    pub(crate) membership: &'a Membership,
    /// Settings of the classifier.
    pub(crate) settings: &'a ClassifierSettings,
}

/// A dictionary learnt from some of the shapes.
struct Learnt {
    preparation: Preparation,
    model: Model,
}

/// Some of the shapes, as described by a dictionary.
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
    /// Validates, then trains on all shapes in the dictionary of `content`. `report` receives the completed fraction.
    ///
    /// # Errors
    /// Degenerate shapes by their position; singular covariances; [`ServiceError::Cancelled`].
    pub(crate) fn record(
        &self,
        content: &Content,
        report: &(dyn Fn(f64) + Sync),
    ) -> Result<ClassifierRecord, ServiceError> {
        let everything: Vec<usize> = (0..self.membership.classes.len()).collect();
        let seed = self.settings.seed;
        let choosing = self.kind().is_none();
        // If there is a choice, the validation takes by far the larger part of the time.
        let first = if choosing { (1 + WITHIN) as f64 / (2 + WITHIN) as f64 } else { 1.0 };
        let choose = |inside: &[usize], number: usize| self.chosen(inside, seed.wrapping_add(number as u64));
        let held = self.cross_validate(
            &|inside, number| Ok(choose(inside, number)?.0),
            if choosing { Scores::Standardised } else { Scores::AsTheyAre },
            &|part| report(first * part),
        )?;
        let (choice, candidates) = self.chosen(&everything, seed)?;
        let own = match choosing {
            true => Some(self.cross_validate(&|_, _| Ok(choice.clone()), Scores::AsTheyAre, &|part| {
                report(first + (1.0 - first) * part);
            })?),
            false => None,
        };
        let (setup, preparation, model) = ready::prepare(self.task.app, content)?;
        let learnt = Learnt { preparation, model };
        let classifier = self.train(&choice, &learnt, &self.describe(&learnt, &everything)?)?;
        let calibration = own.as_deref().unwrap_or(&held);
        let classes = self.classes(calibration);
        let validation = self.report(&held, candidates, own.as_deref());
        let trained = classifier_record::trained_of(&classifier, choice.first(), &setup.metric);
        let (settings, sharpness) = (self.settings.clone(), sharpness(calibration.iter()));
        Ok(ClassifierRecord { settings, classes, trained, sharpness, validation })
    }

    /// The requested kind; `None` if it is to be chosen.
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
            ClassifierKind::Best | ClassifierKind::Ensemble => return None,
        })
    }

    /// Determines what to train on the shapes `chosen`, with the candidates if there was a choice.
    fn chosen(&self, chosen: &[usize], seed: u64) -> Result<(Choice, Option<Vec<Candidate>>), ServiceError> {
        match self.kind() {
            Some(kind) => Ok((Choice::of(kind), None)),
            None => self.choose(chosen, seed).map(|(choice, candidates)| (choice, Some(candidates))),
        }
    }

    /// Classifies each shape once per repeat with a classifier learnt without it; `choose` determines what to train.
    fn cross_validate(
        &self,
        choose: &Chooser<'_>,
        scores: Scores,
        report: &(dyn Fn(f64) + Sync),
    ) -> Result<Vec<Held>, ServiceError> {
        let ClassifierSettings { folds, repeats, seed, .. } = *self.settings;
        let Membership { classes, groups, .. } = self.membership;
        let done = std::sync::atomic::AtomicUsize::new(0);
        let hold_out = |(number, fold_of, fold): (usize, &Vec<usize>, usize)| {
            let (inside, outside) = divided(fold_of, fold);
            self.check_classes(&inside)?;
            let choice = choose(&inside, number)?;
            let learnt = self.learn(&inside)?;
            let classifier = self.train(&choice, &learnt, &self.describe(&learnt, &inside)?)?;
            let described = self.describe(&learnt, &outside)?;
            let mut evidence = self.evidence(&classifier, &learnt, &described, &outside)?;
            if scores == Scores::Standardised {
                choice.standardise(&mut evidence);
            }
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
        // Folds run in parallel, because the small problems within a fold would leave threads idle.
        let held: Result<Vec<Vec<Held>>, ServiceError> = parts.into_par_iter().map(hold_out).collect();
        Ok(held?.concat())
    }

    /// Chooses what to train on the shapes `chosen` by a cross-validation within them; returns the candidates too, the
    /// best first.
    fn choose(&self, chosen: &[usize], seed: u64) -> Result<(Choice, Vec<Candidate>), ServiceError> {
        let (mut trials, shapes) = self.trials(chosen, seed)?;
        // Among equal counts, the more confident candidate comes first; ties keep their order.
        trials.sort_by(|a, b| b.right.cmp(&a.right).then(a.loss().total_cmp(&b.loss())));
        let likelihoods: Vec<Vec<f64>> = trials.iter().map(|trial| trial.likelihoods.clone()).collect();
        let counts = selected(&likelihoods);
        let weight = |i: usize| Some(counts[i] as f64 / ROUNDS as f64).filter(|weight| *weight > 0.0);
        let mut ballots: Vec<Ballot> = trials
            .iter()
            .enumerate()
            .filter_map(|(i, trial)| {
                let Trial { kind, sharpness, .. } = *trial;
                weight(i).map(|weight| Ballot { kind, sharpness, weight })
            })
            .collect();
        ballots.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        if ballots.is_empty() {
            let detail = "no candidate can be trained on parts of these shapes";
            return Err(ServiceError::invalid("/classifier/kind", detail));
        }
        let candidates = trials.iter().enumerate().filter(|(i, _)| *i < REPORTED || weight(*i).is_some());
        let candidates = candidates.map(|(i, trial)| Candidate {
            weight: weight(i),
            ..candidate(trial.kind, trial.right as f64 / shapes as f64)
        });
        Ok((Choice { ballots }, candidates.collect()))
    }

    /// Results of all candidates in a cross-validation within the shapes `chosen`, and the number of shapes classified.
    fn trials(&self, chosen: &[usize], seed: u64) -> Result<(Vec<Trial>, usize), ServiceError> {
        let classes: Vec<usize> = chosen.iter().map(|&k| self.membership.classes[k]).collect();
        let groups: Vec<usize> = chosen.iter().map(|&k| self.membership.groups[k]).collect();
        let cases = units(&classes, &groups, self.membership.labels.len());
        let fewest = cases.into_iter().min().unwrap_or(0);
        let fold_of = stratified(&classes, &groups, WITHIN.min(fewest).max(2), seed);
        let folds = fold_of.iter().max().map_or(0, |most| most + 1);
        let mut tried: Vec<(Kind, Vec<Held>)> = Vec::new();
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
                tried = kinds.into_iter().map(|kind| (kind, Vec::new())).collect();
            }
            shapes += outside.len();
            let found: Vec<Option<Vec<Held>>> = tried
                .par_iter()
                .map(|(kind, _)| {
                    self.task.context.check()?;
                    self.tried(*kind, &learnt, &training, &test, &outside)
                })
                .collect::<Result<_, ServiceError>>()?;
            // Candidates that cannot be trained on a fold are discarded.
            let pairs = std::mem::take(&mut tried).into_iter().zip(found);
            tried = pairs
                .filter_map(|((kind, held), more)| more.map(|more| (kind, [held, more].concat())))
                .collect();
        }
        Ok((tried.into_par_iter().map(|(kind, held)| Trial::new(kind, &held)).collect(), shapes))
    }

    /// Results of a candidate on shapes on which it was not trained; `None` if it cannot be trained.
    fn tried(
        &self,
        kind: Kind,
        learnt: &Learnt,
        training: &Described,
        test: &Described,
        outside: &[usize],
    ) -> Result<Option<Vec<Held>>, ServiceError> {
        let classifier = match self.train(&Choice::of(kind), learnt, training) {
            Ok(classifier) => classifier,
            Err(ServiceError::Invalid(_)) => return Ok(None),
            Err(error) => return Err(error),
        };
        let evidence = self.evidence(&classifier, learnt, test, outside)?;
        let held = |(evidence, &shape): (Evidence, &usize)| Held {
            shape,
            class: self.membership.classes[shape],
            fold: 0,
            evidence,
        };
        Ok(Some(evidence.into_iter().zip(outside).map(held).collect()))
    }

    fn evidence(
        &self,
        classifier: &Classifier,
        learnt: &Learnt,
        described: &Described,
        positions: &[usize],
    ) -> Result<Vec<Evidence>, ServiceError> {
        let evidence = classifier.evidence(self.description(learnt), described.observations());
        evidence.map_err(|error| self.located(error, positions))
    }

    fn learn(&self, chosen: &[usize]) -> Result<Learnt, ServiceError> {
        self.task.context.check()?;
        let content = self.task.content_of(&subset(self.shapes, chosen));
        let content = content.map_err(|error| renumbered(error, chosen))?;
        let (_, preparation, model) = ready::prepare(self.task.app, &content)?;
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

    fn train(
        &self,
        choice: &Choice,
        learnt: &Learnt,
        training: &Described,
    ) -> Result<Classifier, ServiceError> {
        let sample = Labelled {
            observations: training.observations(),
            weights: training.shapes.all().weights,
            classes: &training.classes,
            count: self.membership.labels.len(),
        };
        let train = |kind: Kind| {
            Classifier::train(kind, self.description(learnt), sample)
                .map_err(|error| self.located(error, &[]))
        };
        if let [only] = choice.ballots.as_slice() {
            return train(only.kind);
        }
        let member = |&Ballot { kind, sharpness, weight }: &Ballot| {
            Ok(Member { kind, classifier: train(kind)?, sharpness, weight })
        };
        let members = choice.ballots.iter().map(member).collect::<Result<_, ServiceError>>()?;
        Ok(Classifier::Ensemble(Ensemble { members }))
    }

    /// Adds the position of the shape among all, and the name of the class, to an error.
    fn located(&self, error: AnalysisError, chosen: &[usize]) -> ServiceError {
        match error {
            AnalysisError::SingularCovariance { class } => {
                let label = self.membership.labels.get(class).map_or("", String::as_str);
                let detail = format!(
                    "the covariance of the class '{label}' cannot be inverted: use fewer components, more \
                     pooling or more shrinkage"
                );
                ServiceError::invalid("/classifier/shrinkage", detail)
            }
            error => renumbered(error.into(), chosen),
        }
    }

    /// Checks that every class has a shape among the chosen ones.
    fn check_classes(&self, chosen: &[usize]) -> Result<(), ServiceError> {
        let mut found = vec![false; self.membership.labels.len()];
        chosen.iter().for_each(|&k| found[self.membership.classes[k]] = true);
        let Some(absent) = found.iter().position(|found| !found) else { return Ok(()) };
        let detail = format!(
            "the folds leave no training shape of the class '{}', because its subjects have shapes of other \
             classes too: choose fewer folds or another seed",
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

    /// Quality measures from held-out shapes.
    fn quality(&self, held: &[Held]) -> Quality {
        let cases = self.membership.groups.iter().max().map_or(0, |most| most + 1);
        let (labels, units) = (self.membership.labels.len(), self.membership.units());
        Quality::new(held, labels, self.settings.repeats, &units, cases)
    }

    fn report(&self, held: &[Held], candidates: Option<Vec<Candidate>>, own: Option<&[Held]>) -> Validation {
        let ClassifierSettings { folds, repeats, seed, .. } = *self.settings;
        let (labels, sizes) = (&self.membership.labels, self.membership.sizes());
        let quality = self.quality(held);
        let chosen = own.map(|own| self.quality(own)).map(|quality| ChosenQuality {
            accuracy: quality.accuracy.value,
            brier: quality.brier,
            log_loss: quality.log_loss,
        });
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
            chosen,
        }
    }
}

/// Positions outside of a fold, and those in it.
fn divided(fold_of: &[usize], fold: usize) -> (Vec<usize>, Vec<usize>) {
    (0..fold_of.len()).partition(|&k| fold_of[k] != fold)
}

/// Maximum count of numbers in each classifier that `best` keeps.
const MAX_OF_MEMBER: usize = MAX_STORED / ROUNDS;

/// Candidates for `best` that are small enough to be kept.
fn candidates(model: &Model, membership: &Membership) -> Vec<Kind> {
    let (shapes, classes) = (membership.classes.len(), membership.labels.len());
    let mut kinds = Vec::new();
    if classes * model_length(model) <= MAX_OF_MEMBER {
        kinds.push(Kind::MeanSpace);
    }
    match model {
        Model::Sparse { .. } => kinds.extend([Kind::NearestAtom, Kind::SparseResidual]),
        Model::Components { pca, .. } if !pca.centred => kinds.push(Kind::NearestAtom),
        // Differences from a centre are not shapes, so distances to them are meaningless.
        Model::Components { .. } => {}
    }
    if shapes * (model.len() + 1) <= MAX_OF_MEMBER {
        kinds.extend(NEIGHBOURS.map(|neighbours| Kind::NearestNeighbours { neighbours }));
    }
    let mut sizes: Vec<usize> = COMPONENTS.iter().copied().filter(|&count| count < model.len()).collect();
    sizes.push(model.len());
    for count in sizes {
        for pooling in POOLINGS {
            if pooling < 1.0 && classes * (count + 1) * (count + 1) > MAX_OF_MEMBER {
                continue;
            }
            for shrinkage in SHRINKAGES {
                let components = Some(count);
                kinds.push(Kind::Discriminant(Regularisation { components, pooling, shrinkage }));
            }
        }
    }
    let most = (MAX_TRIED / (shapes * classes).max(1)).max(REPORTED);
    let step = kinds.len().div_ceil(most);
    kinds.into_iter().step_by(step.max(1)).collect()
}

/// Number of coordinates of a shape.
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
        weight: None,
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

/// Renumbers an error about a shape of a subset by its position among all shapes.
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
