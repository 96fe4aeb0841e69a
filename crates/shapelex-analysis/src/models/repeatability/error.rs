//! Error of measurement: what replicates add to the scatter within subjects.
//!
//! In the model `subject + replicate`, with groups `subject + replicate + group:replicate`, terms of replicates are tested by type II with
//! exchanges within the subjects, the subjects by free exchanges:
//!
//! ```text
//! SNR_j = SS_j/RSS,   η²_ME = SS_j/(sum of squares about the means of the subjects)
//! ```
//!
//! Source: Collyer and Adams 2024.

use super::super::anova::{Model, Testing};
use super::super::design::{Contrasts, Table};
use super::super::error::ModelError;
use super::super::exchange::pairs;
use super::super::formula::{Formula, TermOrder};
use super::records::{ErrorTermRecord, ReplicateRecord};
use super::{Layout, RepeatabilityQuestion};
use crate::metric::{Metric, norm};
use crate::strata::strata;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

/// The table.
pub(super) struct ErrorTable {
    pub(super) terms: Vec<ErrorTermRecord>,
    pub(super) warnings: Vec<String>,
}

/// The table of measurement error, given the sum of squares within subjects; empty without replicates.
pub(super) fn table(
    vectors: &Matrix,
    weights: &[f64],
    question: &RepeatabilityQuestion<'_>,
    within: f64,
    watch: &dyn Watch,
) -> Result<ErrorTable, ModelError> {
    let Some(replicates) = question.replicates else {
        return Ok(ErrorTable { terms: Vec::new(), warnings: Vec::new() });
    };
    let mut attributes =
        Table::default().with_factor("subject", question.subjects).with_factor("replicate", replicates);
    let mut text = "~ subject + replicate".to_owned();
    let subjects = strata(question.subjects);
    if let Some(groups) = question.groups {
        let both = pairs(&subjects, &strata(groups));
        if both.iter().max() != subjects.iter().max() {
            let detail = "expected one group for all shapes of a subject, got several";
            return Err(ModelError::Unidentified { detail: detail.into() });
        }
        attributes = attributes.with_factor("group", groups);
        text += " + group:replicate";
    }
    let formula = Formula::parse(&text, TermOrder::ByDegree)?;
    let model = Model::new(&formula, &attributes, Contrasts::Treatment, vectors.clone(), weights.to_vec())?;
    let testing = Testing { blocks: Some(&subjects), ..question.testing.clone() };
    let found = model.anova(&testing, watch)?;
    let residual = found.residual.sum_of_squares;
    let of = |term: super::super::records::TermRecord| {
        let own = term.sum_of_squares;
        let is_error = term.term != "subject";
        ErrorTermRecord {
            signal_to_noise: term.f.map(|_| own / residual),
            eta_squared: (is_error && within > 0.0).then(|| own / within),
            term,
        }
    };
    Ok(ErrorTable { terms: found.terms.into_iter().map(of).collect(), warnings: found.warnings })
}

/// Mean displacement of the shapes of each replicate from the means of their subjects.
pub(super) fn displacements(
    vectors: &Matrix,
    layout: &Layout<'_>,
    replicates: &[String],
    metric: &Metric,
) -> Vec<ReplicateRecord> {
    let numbers = strata(replicates);
    let count = numbers.iter().max().map_or(0, |last| last + 1);
    let mut sums = vec![(Matrix::zeros(vectors.nrows(), 1), 0.0, 0_usize, 0_usize); count];
    for members in &layout.members {
        let total: f64 = members.iter().map(|&k| layout.weights[k]).sum();
        // About the first shape, so that equal shapes differ by nothing.
        let first = vectors.column(members[0]);
        let mut mean = Matrix::zeros(vectors.nrows(), 1);
        members.iter().for_each(|&k| mean += (vectors.column(k) - first) * (layout.weights[k] / total));
        for &k in members {
            let (sum, weights, shapes, last) = &mut sums[numbers[k]];
            *sum += (vectors.column(k) - first - &mean) * layout.weights[k];
            *weights += layout.weights[k];
            *shapes += 1;
            *last = k;
        }
    }
    let of = |(sum, weights, shapes, last): (Matrix, f64, usize, usize)| {
        let values: Vec<f64> = sum.iter().map(|value| value / weights).collect();
        ReplicateRecord {
            replicate: replicates[last].clone(),
            shapes,
            distance: norm(&values),
            displacement: metric.rows(&values),
        }
    };
    sums.into_iter().map(of).collect()
}
