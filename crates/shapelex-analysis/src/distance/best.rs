//! The best placement of a pair, and its score.

use super::prepared::{Columns, PreparedShapes};
use super::products::Term;
use super::spectra::{Transform, Work, scores_of_complex_pair, scores_of_complex_spectra};
use super::{DistanceSpace, chunk};
use crate::matching::Placement;
use crate::metric::dot;
use shapelex_numeric::kernels::largest;

/// Relative difference below which the scores of two placements are equal; the first placement wins.
pub(super) const TIE: f64 = 1e-12;

/// The best score of a pair, and a placement that attains it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Best {
    pub(super) score: f64,
    pub(super) placed_score: f64,
    pub(super) placement: Placement,
}

impl Best {
    pub(super) const NONE: Self = Self {
        score: f64::NEG_INFINITY,
        placed_score: f64::NEG_INFINITY,
        placement: Placement { shift: 0, reversed: false, mirrored: false },
    };

    /// Keeps the largest score. The placement changes only if the improvement exceeds rounding.
    pub(super) fn offer(&mut self, score: f64, placement: Placement) {
        self.score = self.score.max(score);
        if score > self.placed_score + TIE * self.placed_score.abs() || self.placed_score == f64::NEG_INFINITY
        {
            (self.placed_score, self.placement) = (score, placement);
        }
    }
}

impl DistanceSpace {
    /// The largest score of shapes `i` and `j` over all candidates, by FFT.
    pub(super) fn largest_score(&self, shapes: &PreparedShapes, i: usize, j: usize, work: &mut Work) -> f64 {
        let score = |laid: &Columns| {
            self.scores(shapes, i, laid, j, work);
            largest(&work.scores)
        };
        shapes.laid.iter().map(score).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The best score of shape `i` of `shapes` and shape `j` of `others`, with its placement.
    pub(super) fn best(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        j: usize,
        work: &mut Work,
    ) -> Best {
        let mut best = Best::NONE;
        self.each_score(shapes, i, others, j, work, |_, score, placement| best.offer(score, placement));
        best
    }

    /// Calls `visit` with the position of each candidate, and the score of each placement that begins with it.
    pub(super) fn each_score(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        j: usize,
        work: &mut Work,
        mut visit: impl FnMut(usize, f64, Placement),
    ) {
        for (k, (&candidate, laid)) in self.matching.candidates().iter().zip(&others.laid).enumerate() {
            self.scores(shapes, i, laid, j, work);
            for (shift, &score) in work.scores.iter().enumerate() {
                visit(k, score, Placement { shift: shift as u32, ..candidate });
            }
        }
    }

    /// Fills `work.scores`: one score per start point of shape `j` in `laid`, or a single one if start points are not searched.
    pub(super) fn scores(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        laid: &Columns,
        j: usize,
        work: &mut Work,
    ) {
        match (&shapes.laid[0], laid, &self.transform) {
            (Columns::Spectra(first), Columns::Spectra(second), Some(transform)) => {
                let length = transform.spectrum_len(self.columns);
                let (first, second) = (chunk(first, i, length), chunk(second, j, length));
                match transform {
                    Transform::Real(fft) => self.scores_of_spectra(fft, first, second, work),
                    Transform::Complex(fft) => scores_of_complex_spectra(fft, first, second, work),
                    Transform::ComplexPair(fft) => scores_of_complex_pair(fft, first, second, work),
                }
            }
            (Columns::Signals(first), Columns::Signals(second), _) => {
                let length = self.size * self.columns;
                let (first, second) = (chunk(first, i, length), chunk(second, j, length));
                let product = |terms: &Vec<Term>| {
                    let column = |all, k| chunk(all, k, self.size);
                    let inner = |t: &Term| t.sign * dot(column(first, t.left), column(second, t.right));
                    terms.iter().map(inner).sum::<f64>()
                };
                work.scores[0] = self.score_of(self.products.iter().map(product));
            }
            _ => unreachable!("all shapes of a space are prepared alike"),
        }
    }
}
