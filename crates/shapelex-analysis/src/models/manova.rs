//! Multivariate statistics of the terms of a model in the first principal coordinates of the response.
//!
//! ```text
//! H = U_jᵀU_j,   U_j = Q_jᵀY,   θ the eigenvalues of (EᵀE)⁻¹H
//! Pillai Σθ/(1+θ),   Wilks Π 1/(1+θ),   Hotelling–Lawley Σθ,   Roy max θ
//! ```
//!
//! p values are those of the exchanges of the analysis of variance; small values of Wilks count. Sources: Anderson 2003, chapter 8.

use super::anova::{Model, Testing};
use super::effect_size::{effect_size, reaching};
use super::error::ModelError;
use super::exchange::{ExchangeKind, Exchanges};
use super::subspaces::Hypothesis;
use crate::inference::span::Span;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Largest number of coordinates.
pub const MAX_COORDINATES: usize = 100;

/// Multivariate statistics of the terms.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ManovaRecord {
    /// Number of principal coordinates.
    pub components: usize,
    /// Part of the scatter of the shapes in them.
    pub explained: f64,
    /// The terms that are tested against the residuals of the model.
    pub terms: Vec<ManovaTerm>,
}

/// Multivariate statistics of a term.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ManovaTerm {
    /// Name of the term.
    pub term: String,
    /// Pillai's trace.
    pub pillai: ManovaStatistic,
    /// Wilks' lambda, small if the term matters. Z is that of its negative logarithm.
    pub wilks: ManovaStatistic,
    /// The trace of Hotelling and Lawley.
    pub hotelling_lawley: ManovaStatistic,
    /// Roy's largest root.
    pub roy: ManovaStatistic,
}

/// A statistic with its p value and effect size; null without permutations.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ManovaStatistic {
    /// The value.
    pub value: f64,
    /// Effect size.
    pub z: Option<f64>,
    /// p value.
    pub p: Option<f64>,
}

impl Model {
    /// Multivariate statistics of all terms in the first principal coordinates: so many, or half of the degrees of freedom of the residuals.
    ///
    /// Cost: `n q m` multiply-adds for each term and exchange.
    ///
    /// # Errors
    /// More coordinates than half of the degrees of freedom; those of [`Self::anova`].
    pub fn manova(
        &self,
        coordinates: Option<usize>,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<ManovaRecord, ModelError> {
        if let Some(part) = self.design.formula.random.first() {
            let detail =
                format!("expected a model without random parts, got {}", self.design.formula.part_name(part));
            return Err(ModelError::Multivariate { detail });
        }
        let centred = self.space.about_mean(self.centred(), self.design.formula.intercept);
        let span = Span::of_scaled(&centred)?;
        let bound = (self.degrees() / 2).min(span.eigenvalues.len()).min(MAX_COORDINATES);
        if bound == 0 || coordinates.is_some_and(|m| m > bound) {
            let detail = format!(
                "expected at most {bound} coordinates, half of the degrees of freedom of the residuals, got {}",
                coordinates.unwrap_or(1)
            );
            return Err(ModelError::Multivariate { detail });
        }
        let count = coordinates.unwrap_or(bound);
        let explained = span.eigenvalues[..count].iter().sum::<f64>() / span.total();
        let scores = span.scores.rows(0, count).into_owned();
        let hypotheses = self.space.hypotheses(&self.design, testing.kind, testing.contrasts_of_three)?;
        let mut terms = Vec::new();
        for hypothesis in hypotheses.iter().filter(|hypothesis| hypothesis.own.ncols() > 0) {
            if self.error_term_of(hypothesis, testing)?.is_some() {
                continue;
            }
            let kind = self.kind_of(hypothesis.term, testing);
            terms.push(self.multivariate(&scores, hypothesis, kind, testing, watch)?);
        }
        Ok(ManovaRecord { components: count, explained, terms })
    }

    fn multivariate(
        &self,
        scores: &Matrix,
        hypothesis: &Hypothesis,
        kind: ExchangeKind,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<ManovaTerm, ModelError> {
        let exchanges = self.exchanges(kind, testing)?;
        let reduced = dense::multiply(&self.space.basis, &hypothesis.reduced);
        let fitted = dense::multiply(scores, &reduced);
        let residuals = scores - dense::multiply(&fitted, &reduced.transpose());
        let plan = Plan {
            gram: dense::multiply(&residuals, &residuals.transpose()),
            rows: self.fitted.rows_of_cells(),
            own: &hypothesis.own,
            residuals,
        };
        let cells = &self.fitted.cells;
        let observed = plan.statistics(cells);
        let drawn = match super::anova::are_few(&exchanges, testing) {
            true => Vec::new(),
            false => parallel::try_map(exchanges.count(), &|index| {
                watch.check()?;
                let mut to = vec![0; cells.len()];
                exchanges.cells(index, cells, &mut to);
                watch.worked(1);
                Ok::<_, crate::AnalysisError>(plan.statistics(&to))
            })?,
        };
        let of = |s: usize| told(&observed, &drawn, s, &exchanges, testing);
        let [pillai, wilks, hotelling_lawley, roy] = [of(0), of(1), of(2), of(3)];
        let wilks = ManovaStatistic { value: (-wilks.value).exp(), ..wilks };
        let term = self.design.formula.name(&self.design.formula.terms[hypothesis.term]);
        Ok(ManovaTerm { term, pillai, wilks, hotelling_lawley, roy })
    }
}

fn told(
    observed: &[f64; 4],
    drawn: &[[f64; 4]],
    s: usize,
    exchanges: &Exchanges,
    testing: &Testing<'_>,
) -> ManovaStatistic {
    let mut values = vec![observed[s]];
    values.extend(drawn.iter().map(|drawn| drawn[s]));
    super::testing::without_observed(&mut values, exchanges.are_all() && !drawn.is_empty());
    let p = (values.len() > 1).then(|| reaching(&values) as f64 / values.len() as f64);
    let z = effect_size(&values, testing.transform).map(|size| size.z);
    ManovaStatistic { value: observed[s], z, p }
}

/// A term, with what all exchanges share.
struct Plan<'a> {
    /// Residuals of the reduced model, `m × n`.
    residuals: Matrix,
    /// Their products, which no exchange changes.
    gram: Matrix,
    /// Rows of the basis, one column for each cell.
    rows: &'a Matrix,
    own: &'a Matrix,
}

impl Plan<'_> {
    /// Pillai, −log Wilks, Hotelling–Lawley and Roy of an exchange that takes each residual to a cell.
    fn statistics(&self, to: &[usize]) -> [f64; 4] {
        let mut sums = Matrix::zeros(self.residuals.nrows(), self.rows.ncols());
        for (k, &cell) in to.iter().enumerate() {
            let mut sum = sums.column_mut(cell);
            sum += self.residuals.column(k);
        }
        let along = dense::multiply(self.rows, &sums.transpose());
        let own = dense::transpose_multiply(self.own, &along);
        let error = &self.gram - dense::transpose_multiply(&along, &along);
        let Some(cholesky) = error.cholesky() else { return [f64::MAX; 4] };
        let ratio = &own * cholesky.solve(&own.transpose());
        let values = dense::symmetric_eigen(&(0.5 * (&ratio + ratio.transpose()))).eigenvalues;
        let sum = |of: &dyn Fn(f64) -> f64| values.iter().map(|value| of(value.max(0.0))).sum::<f64>();
        [sum(&|x| x / (1.0 + x)), sum(&f64::ln_1p), sum(&|x| x), values.max().max(0.0)]
    }
}
