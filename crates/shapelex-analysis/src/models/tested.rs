//! Rows of a table of sums of squares, of shapes in memory or of sums over a stream of them.

use super::design::Design;
use super::effect_size::{Transform, effect_size, reaching};
use super::permuted::Sums;
use super::records::{AnovaRecord, DesignRecord, ResidualRecord, TermRecord, TotalRecord, share};
use super::subspaces::{Hypothesis, Space};
use super::testing::{Statistic, Testing, without_observed};
use crate::inference::histogram::ExplainedHistogram;

/// What the rows of a table are made of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tested<'a> {
    pub(super) design: &'a Design,
    pub(super) space: &'a Space,
    /// Number of shapes.
    pub(super) shapes: usize,
    /// `‖E‖²`.
    pub(super) residual: f64,
    /// Sum of squares about the mean, or about zero without an intercept.
    pub(super) total: f64,
}

impl Tested<'_> {
    /// Degrees of freedom of the residuals.
    pub(super) fn degrees(&self) -> usize {
        self.shapes - self.space.rank()
    }

    /// The row of a term without its test.
    pub(super) fn row(&self, hypothesis: &Hypothesis, sums: Sums) -> TermRecord {
        let degrees = hypothesis.own.ncols();
        let own = if degrees == 0 { 0.0 } else { sums.own };
        TermRecord {
            term: self.design.formula.name(&self.design.formula.terms[hypothesis.term]),
            degrees,
            sum_of_squares: own,
            mean_square: (degrees > 0).then(|| own / degrees as f64),
            r_squared: share(own, self.total),
            partial_eta_squared: share(own, own + self.residual),
            f: self.ratio(degrees, Sums { own, residual: self.residual }),
            ..TermRecord::default()
        }
    }

    /// `F`; `None` without degrees of freedom, or if nothing is left for the residuals.
    pub(super) fn ratio(&self, degrees: usize, sums: Sums) -> Option<f64> {
        let mean = sums.residual / self.degrees() as f64;
        (degrees > 0 && sums.residual > 1e-12 * self.total).then(|| sums.own / degrees as f64 / mean)
    }

    /// Fills in the test of a row, whose kind of exchange is known: sums as observed and of each exchange.
    pub(super) fn tell(&self, row: &mut TermRecord, observed: Sums, drawn: &[Sums], testing: &Testing<'_>) {
        let degrees = row.degrees;
        let value = |sums: Sums| match testing.statistic {
            Statistic::F => self.ratio(degrees, sums).unwrap_or(f64::MAX),
            Statistic::SumOfSquares => sums.own,
        };
        let mut values = vec![value(observed)];
        values.extend(drawn.iter().map(|sums| value(*sums)));
        let shares: Vec<f64> = drawn.iter().map(|sums| share(sums.own, sums.own + sums.residual)).collect();
        row.histogram = ExplainedHistogram::new(&shares, row.partial_eta_squared, row.exact);
        row.tell(values, testing.transform);
    }

    /// The table of these rows, whose residuals have so many degrees of freedom and this sum of squares.
    pub(super) fn record(
        &self,
        (degrees, residual): (usize, f64),
        terms: Vec<TermRecord>,
        dropped: Vec<String>,
        mut warnings: Vec<String>,
    ) -> AnovaRecord {
        let Self { design, space, total, .. } = *self;
        if !design.formula.intercept {
            warnings.push("without an intercept, sums of squares and R² are those about zero".into());
        }
        let levels = design
            .factors()
            .map(|(k, factor)| (design.formula.variables[k].to_string(), factor.levels.clone()))
            .collect();
        AnovaRecord {
            formula: design.formula.to_string(),
            terms,
            residual: ResidualRecord {
                degrees,
                sum_of_squares: residual,
                mean_square: residual / degrees as f64,
                r_squared: share(residual, total),
            },
            total: TotalRecord {
                degrees: self.shapes - usize::from(design.formula.intercept),
                sum_of_squares: total,
            },
            design: DesignRecord {
                columns: design.columns.clone(),
                dropped,
                rank: space.rank(),
                contrasts: design.contrasts,
                levels,
            },
            warnings,
        }
    }
}

impl TermRecord {
    /// Fills in p and Z of a list of the statistic, the observed value first.
    pub(super) fn tell(&mut self, mut values: Vec<f64>, transform: Transform) {
        without_observed(&mut values, self.exact);
        self.permutations = values.len() - 1;
        if self.permutations == 0 {
            return;
        }
        self.exceeding = reaching(&values) - 1;
        self.p = Some((1 + self.exceeding) as f64 / values.len() as f64);
        self.z = effect_size(&values, transform).map(|size| size.z);
    }
}
