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

use std::sync::atomic::{AtomicUsize, Ordering};

use shapelex_numeric::parallel;

use super::candidates::{Ballot, Choice, REPORTED, Trial, candidate, candidates};
use super::classifier::{Classifier, Kind};
use super::ensemble::{Ensemble, Member, ROUNDS, selected};
use super::folds::stratified;
use super::labels::{ClassLabels, units};
use super::observations::{Description, Evidence, Labelled, Observations};
use super::quality::Held;
use super::report;
use super::sharpness::sharpness;
use super::stored::trained_of;
use crate::AnalysisError;
use crate::accumulate::{ShapesInMemory, subset};
use crate::classifier_record::{Candidate, ClassifierRecord, ClassifierSettings};
use crate::dictionary::in_use::Dictionary;
use crate::dictionary::learn::learn_part;
use crate::dictionary::model::described;
use crate::dictionary::recipe::Recipe;
use crate::sparse::SparseCode;
use crate::watch::{Phase, Watch};

/// Number of folds of the inner cross-validation, within the training shapes, that `best` uses for its choice.
pub const WITHIN: usize = 4;

/// Trains a classifier in `dictionary` on labelled shapes, and validates it on shapes that neither it nor the dictionary
/// has seen. `shapes` are those from which the dictionary was learnt: whitened, and centred if the class translates.
///
/// Cost: [`ClassifierSettings::trainings`] times that of the dictionary. The same seed gives the same bits on any number
/// of threads.
///
/// # Errors
/// Degenerate shapes by their position; [`AnalysisError::Parameter`] at a field of `classifier` if the classes cannot be
/// told apart or divided ([`ClassLabels::faults`]); [`AnalysisError::Interrupted`].
pub fn train_classifier(
    dictionary: &Dictionary,
    shapes: &ShapesInMemory,
    labels: &ClassLabels,
    settings: &ClassifierSettings,
    watch: &dyn Watch,
) -> Result<ClassifierRecord, AnalysisError> {
    let recipe = &Recipe::of(&dictionary.content);
    let faults = labels.faults(settings, &recipe.method, dictionary.metric().len());
    faults.into_iter().next().map_or(Ok(()), |fault| Err(AnalysisError::from(fault)))?;
    Study { dictionary, recipe, shapes, labels, settings, watch }.record()
}

/// Chooses the classifier to train, given the training shapes and the number of the fold.
type Chooser<'a> = dyn Fn(&[usize], usize) -> Result<Choice, AnalysisError> + Sync + 'a;

/// Whether scores keep the units of their classifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scores {
    AsTheyAre,
    Standardised,
}

/// Labelled shapes on which a classifier is trained and validated.
struct Study<'a> {
    /// Dictionary learnt from all shapes.
    dictionary: &'a Dictionary,
    /// Its recipe, with which parts of the shapes are learnt from.
    recipe: &'a Recipe,
    /// Whitened shapes as given, centred if the class translates.
    shapes: &'a ShapesInMemory,
    /// Classes and subjects of the shapes.
    labels: &'a ClassLabels,
    /// Settings of the classifier.
    settings: &'a ClassifierSettings,
    /// Progress and cancellation.
    watch: &'a dyn Watch,
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
    /// Validates, then trains on all shapes in the dictionary.
    fn record(&self) -> Result<ClassifierRecord, AnalysisError> {
        let everything: Vec<usize> = (0..self.labels.classes.len()).collect();
        let seed = self.settings.seed;
        let choosing = self.settings.requested().is_none();
        // If there is a choice, the validation takes by far the larger part of the time.
        let first = if choosing { (1 + WITHIN) as f64 / (2 + WITHIN) as f64 } else { 1.0 };
        let report = |fraction: f64| self.watch.phase(Phase::Validate, fraction);
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
        let all = self.describe(self.dictionary, &everything)?;
        let classifier = self.train(&choice, self.dictionary, &all)?;
        let calibration = own.as_deref().unwrap_or(&held);
        Ok(ClassifierRecord {
            settings: self.settings.clone(),
            classes: report::classes(self.labels, calibration),
            trained: trained_of(&classifier, choice.first(), self.dictionary.metric()),
            sharpness: sharpness(calibration.iter()),
            validation: report::validation(self.settings, self.labels, &held, candidates, own.as_deref()),
        })
    }

    /// Determines the classifier to train on the shapes `chosen`, with the candidates if there was a choice.
    fn chosen(&self, chosen: &[usize], seed: u64) -> Result<(Choice, Option<Vec<Candidate>>), AnalysisError> {
        match self.settings.requested() {
            Some(kind) => Ok((Choice::of(kind), None)),
            None => self.choose(chosen, seed).map(|(choice, candidates)| (choice, Some(candidates))),
        }
    }

    /// Classifies each shape once per repeat with a classifier learnt without it; `choose` determines the classifier to train.
    fn cross_validate(
        &self,
        choose: &Chooser<'_>,
        scores: Scores,
        report: &(dyn Fn(f64) + Sync),
    ) -> Result<Vec<Held>, AnalysisError> {
        let ClassifierSettings { folds, repeats, seed, .. } = *self.settings;
        let ClassLabels { classes, groups, .. } = self.labels;
        let done = AtomicUsize::new(0);
        let hold_out = |(number, fold_of, fold): (usize, &Vec<usize>, usize)| {
            let (inside, outside) = divided(fold_of, fold);
            self.check_classes(&inside)?;
            let choice = choose(&inside, number)?;
            let (learnt, training) = self.learn(&inside)?;
            let classifier = self.train(&choice, &learnt, &training)?;
            let described = self.describe(&learnt, &outside)?;
            let mut evidence = self.evidence(&classifier, &learnt, &described, &outside)?;
            if scores == Scores::Standardised {
                choice.standardise(&mut evidence);
            }
            let count = 1 + done.fetch_add(1, Ordering::Relaxed);
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
        let held = parallel::try_map::<_, AnalysisError>(parts.len(), &|k| hold_out(parts[k]))?;
        Ok(held.concat())
    }

    /// Chooses the classifier to train on the shapes `chosen` by a cross-validation within them; returns the candidates too, the
    /// best first.
    fn choose(&self, chosen: &[usize], seed: u64) -> Result<(Choice, Vec<Candidate>), AnalysisError> {
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
            let detail = "no candidate can be trained on parts of these shapes".into();
            return Err(AnalysisError::Parameter { field: "classifier.kind", detail });
        }
        let candidates = trials.iter().enumerate().filter(|(i, _)| *i < REPORTED || weight(*i).is_some());
        let candidates = candidates.map(|(i, trial)| Candidate {
            weight: weight(i),
            ..candidate(trial.kind, trial.right as f64 / shapes as f64)
        });
        Ok((Choice { ballots }, candidates.collect()))
    }

    /// Results of all candidates in a cross-validation within the shapes `chosen`, and the number of shapes classified.
    fn trials(&self, chosen: &[usize], seed: u64) -> Result<(Vec<Trial>, usize), AnalysisError> {
        let classes: Vec<usize> = chosen.iter().map(|&k| self.labels.classes[k]).collect();
        let groups: Vec<usize> = chosen.iter().map(|&k| self.labels.groups[k]).collect();
        let cases = units(&classes, &groups, self.labels.labels.len());
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
            let (learnt, training) = self.learn(&inside)?;
            let test = self.describe(&learnt, &outside)?;
            if shapes == 0 {
                let kinds = candidates(&learnt.model, self.labels);
                tried = kinds.into_iter().map(|kind| (kind, Vec::new())).collect();
            }
            shapes += outside.len();
            let found = parallel::try_map(tried.len(), &|k| {
                self.watch.check()?;
                self.tried(tried[k].0, &learnt, &training, &test, &outside)
            })?;
            // Candidates that cannot be trained on a fold are discarded.
            let pairs = std::mem::take(&mut tried).into_iter().zip(found);
            tried = pairs
                .filter_map(|((kind, held), more)| more.map(|more| (kind, [held, more].concat())))
                .collect();
        }
        Ok((parallel::map(tried.len(), &|k| Trial::new(tried[k].0, &tried[k].1)), shapes))
    }

    /// Results of a candidate on shapes on which it was not trained; `None` if it cannot be trained.
    fn tried(
        &self,
        kind: Kind,
        learnt: &Dictionary,
        training: &Described,
        test: &Described,
        outside: &[usize],
    ) -> Result<Option<Vec<Held>>, AnalysisError> {
        let classifier = match self.trained(kind, learnt, training) {
            Ok(classifier) => classifier,
            Err(AnalysisError::SingularCovariance { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        let evidence = self.evidence(&classifier, learnt, test, outside)?;
        let held = |(evidence, &shape): (Evidence, &usize)| Held {
            shape,
            class: self.labels.classes[shape],
            fold: 0,
            evidence,
        };
        Ok(Some(evidence.into_iter().zip(outside).map(held).collect()))
    }

    fn evidence(
        &self,
        classifier: &Classifier,
        learnt: &Dictionary,
        described: &Described,
        positions: &[usize],
    ) -> Result<Vec<Evidence>, AnalysisError> {
        let evidence = classifier.evidence(self.description(learnt), described.observations());
        evidence.map_err(|error| self.located(error, positions))
    }

    /// Learns from the chosen shapes, and describes them by the dictionary learnt.
    fn learn(&self, chosen: &[usize]) -> Result<(Dictionary, Described), AnalysisError> {
        self.watch.check()?;
        let measured = self.dictionary.preparation.measured();
        let shapes = subset(self.shapes, chosen);
        let learnt = learn_part(self.recipe, measured, &shapes, self.watch);
        let (learnt, posed) = learnt.map_err(|error| renumbered(error, chosen))?;
        let prepared = posed.into_whitened();
        let codes = learnt.model.codes(&prepared, measured.metric.len());
        let codes = codes.map_err(|error| self.located(error, chosen))?;
        Ok((learnt, self.described(chosen, shapes, prepared, codes)))
    }

    fn described(
        &self,
        chosen: &[usize],
        shapes: ShapesInMemory,
        prepared: Vec<f64>,
        codes: Vec<SparseCode>,
    ) -> Described {
        let classes = chosen.iter().map(|&k| self.labels.classes[k]).collect();
        Described { shapes, prepared, codes, classes }
    }

    fn describe(&self, learnt: &Dictionary, chosen: &[usize]) -> Result<Described, AnalysisError> {
        let shapes = subset(self.shapes, chosen);
        let (prepared, codes) = described(&learnt.preparation, &learnt.model, &shapes)
            .map_err(|error| self.located(error, chosen))?;
        Ok(self.described(chosen, shapes, prepared, codes))
    }

    fn description<'b>(&self, learnt: &'b Dictionary) -> Description<'b> {
        Description {
            preparation: &learnt.preparation,
            model: &learnt.model,
            size: self.settings.sees_size(),
        }
    }

    fn train(
        &self,
        choice: &Choice,
        learnt: &Dictionary,
        training: &Described,
    ) -> Result<Classifier, AnalysisError> {
        let train = |kind| self.trained(kind, learnt, training).map_err(|error| self.located(error, &[]));
        if let [only] = choice.ballots.as_slice() {
            return train(only.kind);
        }
        let member = |&Ballot { kind, sharpness, weight }: &Ballot| {
            Ok(Member { kind, classifier: train(kind)?, sharpness, weight })
        };
        let members = choice.ballots.iter().map(member).collect::<Result<_, AnalysisError>>()?;
        Ok(Classifier::Ensemble(Ensemble { members }))
    }

    fn trained(
        &self,
        kind: Kind,
        learnt: &Dictionary,
        training: &Described,
    ) -> Result<Classifier, AnalysisError> {
        let sample = Labelled {
            observations: training.observations(),
            weights: training.shapes.all().weights,
            classes: &training.classes,
            count: self.labels.labels.len(),
        };
        Classifier::train(kind, self.description(learnt), sample)
    }

    /// Adds the position of the shape among all, and the name of the class, to an error.
    fn located(&self, error: AnalysisError, chosen: &[usize]) -> AnalysisError {
        match error {
            AnalysisError::SingularCovariance { class } => {
                let label = self.labels.labels.get(class).map_or("", String::as_str);
                let detail = format!(
                    "the covariance of the class '{label}' cannot be inverted: use fewer components, more \
                     pooling or more shrinkage"
                );
                AnalysisError::Parameter { field: "classifier.shrinkage", detail }
            }
            error => renumbered(error, chosen),
        }
    }

    /// Checks that every class has a shape among the chosen ones.
    fn check_classes(&self, chosen: &[usize]) -> Result<(), AnalysisError> {
        let mut found = vec![false; self.labels.labels.len()];
        chosen.iter().for_each(|&k| found[self.labels.classes[k]] = true);
        let Some(absent) = found.iter().position(|found| !found) else { return Ok(()) };
        let detail = format!(
            "the folds leave no training shape of the class '{}', because its subjects have shapes of other \
             classes too: choose fewer folds or another seed",
            self.labels.labels[absent]
        );
        Err(AnalysisError::Parameter { field: "classifier.folds", detail })
    }
}

/// Positions outside of a fold, and those in it.
fn divided(fold_of: &[usize], fold: usize) -> (Vec<usize>, Vec<usize>) {
    (0..fold_of.len()).partition(|&k| fold_of[k] != fold)
}

/// Renumbers an error about a shape of a subset by its position among all shapes.
fn renumbered(error: AnalysisError, chosen: &[usize]) -> AnalysisError {
    match error.position().and_then(|position| chosen.get(position)) {
        Some(&position) => error.at(position),
        None => error,
    }
}
