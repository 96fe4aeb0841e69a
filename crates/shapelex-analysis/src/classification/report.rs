//! Records of a validation: the classes with their distances, and all figures of quality.

use super::labels::ClassLabels;
use super::quality::{BINS, Bin, Held, Part, Quality};
use crate::classifier_record::{
    Candidate, ChosenQuality, ClassQuality, ClassRecord, ClassifierSettings, PartRecord, ReliabilityBin,
    Validation,
};
use crate::dictionary::learn::quantiles;

/// The classes, with the distances of their own held-out shapes.
pub(super) fn classes(labels: &ClassLabels, held: &[Held]) -> Vec<ClassRecord> {
    let sizes = labels.sizes();
    let record = |(class, label): (usize, &String)| {
        let own = held.iter().filter(|held| held.class == class);
        ClassRecord {
            label: label.clone(),
            shapes: sizes[class],
            distances: quantiles(own.map(|held| held.evidence.distances[class]).collect()),
        }
    };
    labels.labels.iter().enumerate().map(record).collect()
}

/// The figures of a validation from held-out shapes; `own`: those of the choice made on all shapes.
pub(super) fn validation(
    settings: &ClassifierSettings,
    labels: &ClassLabels,
    held: &[Held],
    candidates: Option<Vec<Candidate>>,
    own: Option<&[Held]>,
) -> Validation {
    let ClassifierSettings { folds, repeats, seed, .. } = *settings;
    let quality = quality(settings, labels, held);
    let shapes = labels.classes.len();
    let largest = labels.sizes().into_iter().max().unwrap_or(0);
    Validation {
        folds,
        repeats,
        seed,
        shapes,
        subjects: labels.subjects,
        accuracy: part(&quality.accuracy),
        majority: largest as f64 / shapes.max(1) as f64,
        balanced_accuracy: part(&quality.balanced_accuracy),
        classes: class_qualities(labels, &quality),
        brier: quality.brier,
        log_loss: quality.log_loss,
        reliability: quality.reliability.iter().enumerate().map(reliability_bin).collect(),
        accuracies: quality.accuracies,
        confusion: quality.confusion,
        candidates,
        chosen: own.map(|own| chosen_quality(settings, labels, own)),
    }
}

fn quality(settings: &ClassifierSettings, labels: &ClassLabels, held: &[Held]) -> Quality {
    let cases = labels.groups.iter().max().map_or(0, |most| most + 1);
    Quality::new(held, labels.labels.len(), settings.repeats, &labels.units(), cases)
}

fn chosen_quality(settings: &ClassifierSettings, labels: &ClassLabels, own: &[Held]) -> ChosenQuality {
    let quality = quality(settings, labels, own);
    ChosenQuality { accuracy: quality.accuracy.value, brier: quality.brier, log_loss: quality.log_loss }
}

fn class_qualities(labels: &ClassLabels, quality: &Quality) -> Vec<ClassQuality> {
    let classes = labels.labels.iter().zip(&quality.recall).zip(&quality.precision);
    classes
        .map(|((label, recall), precision)| ClassQuality {
            label: label.clone(),
            recall: part(recall),
            precision: *precision,
        })
        .collect()
}

fn part(part: &Part) -> PartRecord {
    PartRecord { value: part.value, low: part.low, high: part.high }
}

fn reliability_bin((i, bin): (usize, &Bin)) -> ReliabilityBin {
    let Bin { count, confidence, accuracy, .. } = *bin;
    ReliabilityBin { from: i as f64 / BINS as f64, count, confidence, accuracy }
}
