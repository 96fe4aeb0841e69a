//! Analysis of variance of shapes: sums of squares, F, Z and p of each term of a model.
//!
//! A term is tested against the residuals of the whole model, or, if its levels differ only between the groups of an error term,
//! against these groups: then the shapes are averaged in them, with the sums of their weights, and the model of the averages has the
//! error term as its residuals. The ratio of two mean squares whose permutations are drawn apart has no level.

use super::design::{Contrasts, Design, Prepared, Table};
use super::effect_size::{effect_size, reaching};
use super::error::ModelError;
use super::exchange::{Draw, ExchangeKind, Exchanges, pairs};
use super::formula::{Formula, Term};
use super::permuted::{Fitted, Sums};
use super::records::{AnovaRecord, RatioRecord, TermRecord};
use super::subspaces::{Hypothesis, Space, SumType};
use super::tested::Tested;
use super::testing::without_observed;
pub use super::testing::{ExchangeRule, Statistic, Testing};
use crate::watch::{Counted, Watch};
use shapelex_numeric::dense::Matrix;

/// Fewest distinct exchanges of a test: with fewer no p value is below .05.
pub(super) const FEWEST_EXCHANGES: f64 = 20.0;

/// A model of shapes: its design, space and response.
#[derive(Debug, Clone)]
pub struct Model {
    /// The design.
    pub design: Design,
    /// Its space.
    pub space: Space,
    /// The response.
    pub fitted: Fitted,
    pub(super) vectors: Matrix,
    pub(super) weights: Vec<f64>,
}

impl Model {
    /// The model of a formula, for vectors in columns and positive weights.
    ///
    /// # Errors
    /// Errors of the design; fewer shapes than columns; a failure of an eigenproblem.
    pub fn new(
        formula: &Formula,
        table: &Table,
        contrasts: Contrasts,
        vectors: Matrix,
        weights: Vec<f64>,
    ) -> Result<Self, ModelError> {
        Self::with_covariance(formula, table, contrasts, vectors, weights, None)
    }

    /// As [`Self::new`], for shapes whose covariance has the factor `L`, `n × n`, a lower triangle.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn with_covariance(
        formula: &Formula,
        table: &Table,
        contrasts: Contrasts,
        vectors: Matrix,
        weights: Vec<f64>,
        lower: Option<Matrix>,
    ) -> Result<Self, ModelError> {
        let design = Design::new(formula, table, contrasts)?;
        let space = Space::correlated(&design, &weights, lower)?;
        let fitted = Fitted::new(&space, &vectors, formula.intercept)?;
        Ok(Self { design, space, fitted, vectors, weights })
    }

    /// Weights of the shapes.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Number of numbers of a vector.
    pub(super) fn length(&self) -> usize {
        self.vectors.nrows()
    }

    /// Weighted mean of numbers of the shapes, about the first one.
    pub(super) fn average(&self, numbers: &[f64]) -> f64 {
        average(numbers, &self.weights)
    }

    /// Weighted mean of the vectors.
    pub(super) fn mean(&self) -> Vec<f64> {
        self.vectors.row_iter().map(|row| self.average(&row.iter().copied().collect::<Vec<_>>())).collect()
    }

    /// The vectors about their mean, or about zero without an intercept, scaled as the basis is.
    pub(super) fn centred(&self) -> Matrix {
        let mean = if self.design.formula.intercept { self.mean() } else { vec![0.0; self.length()] };
        self.scaled_about(&mean)
    }

    /// Differences of the vectors from another, scaled as the basis is.
    pub(super) fn scaled_about(&self, mean: &[f64]) -> Matrix {
        let mut scaled =
            Matrix::from_fn(self.length(), self.weights.len(), |i, k| self.vectors[(i, k)] - mean[i]);
        self.space.scale(&mut scaled);
        scaled
    }

    /// Degrees of freedom of the residuals.
    pub fn degrees(&self) -> usize {
        self.tested().degrees()
    }

    /// The table of the analysis of variance. `watch` is asked before every batch of permutations.
    ///
    /// # Errors
    /// No term; type III of a design whose columns depend on each other; blocks without equals; [`AnalysisError::Interrupted`](
    /// crate::AnalysisError::Interrupted) once `watch` stops.
    pub fn anova(&self, testing: &Testing<'_>, watch: &dyn Watch) -> Result<AnovaRecord, ModelError> {
        if self.design.formula.terms.is_empty() {
            return Err(ModelError::NoTerms);
        }
        if self.space.is_correlated()
            && !(self.design.formula.random.is_empty() && testing.error_terms.is_empty())
        {
            let detail = "expected a model without random parts and error terms with a covariance, got some";
            return Err(ModelError::Covariance { detail: detail.into() });
        }
        if testing.kind == SumType::III {
            check_origins(&self.design)?;
        }
        let hypotheses = self.space.hypotheses(&self.design, testing.kind, testing.contrasts_of_three)?;
        let mut warnings = self.design.warnings.clone();
        let counted = Counted::new(watch, testing.permutations * hypotheses.len());
        let observed = self.fitted.observed(&hypotheses);
        let mut rows: Vec<TermRecord> =
            hypotheses.iter().zip(&observed).map(|(hypothesis, sums)| self.row(hypothesis, *sums)).collect();
        let mut plain = Vec::new();
        for (hypothesis, row) in hypotheses.iter().zip(&mut rows) {
            if row.degrees == 0 {
                row.aliased_with = self.space.aliases(&self.design, hypothesis.term);
                continue;
            }
            match self.error_term_of(hypothesis, testing)? {
                Some(error) => {
                    self.test_collapsed(&error, row, testing, &counted)?;
                    row.rrpp = self.ratio_of_two(&hypotheses, hypothesis, &error, testing, &counted)?;
                }
                None => match self.slope_of(&self.design.formula.terms[hypothesis.term]) {
                    Some(slope) => warnings.extend(self.test_slopes(slope, row, testing, &counted)?),
                    None => plain.push(hypothesis.clone()),
                },
            }
        }
        let grouped = match self.design.formula.random.is_empty() {
            true => None,
            false => self.with_groups_if_any(&plain, &mut warnings)?,
        };
        match &grouped {
            None if self.design.formula.random.is_empty() => {
                self.test_plain(&plain, testing, &mut rows, &counted)?;
            }
            None => {}
            Some(grouped) => grouped.test(testing, &mut rows, &counted)?,
        }
        let dropped = self.space.dropped(&self.design);
        warnings.extend(warnings_of(&dropped, testing, grouped.is_some()));
        warnings.extend(rows.iter().filter_map(few_exchanges));
        let whole = grouped.as_ref().map_or(self, |grouped| &grouped.model);
        Ok(self.record(whole, rows, dropped, warnings))
    }

    /// The test of RRPP of a term against another: the ratio of their mean squares, each permuted about its own reduced model.
    fn ratio_of_two(
        &self,
        all: &[Hypothesis],
        own: &Hypothesis,
        error: &Term,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Option<RatioRecord>, ModelError> {
        let terms = &self.design.formula.terms;
        let Some(error) = all.iter().find(|other| testing.rrpp && terms[other.term].set() == error.set())
        else {
            return Ok(None);
        };
        let exchanges = self.exchanges(ExchangeKind::Free, testing)?;
        let pair = [own.clone(), error.clone()];
        let degrees = pair.each_ref().map(|hypothesis| hypothesis.own.ncols() as f64);
        let ratio = |sums: &Vec<Sums>| {
            let value = sums[0].own / degrees[0] / (sums[1].own / degrees[1]);
            if value.is_finite() { value } else { f64::MAX }
        };
        let mut values = vec![ratio(&self.fitted.observed(&pair))];
        values.extend(self.fitted.permuted(&pair, &exchanges, watch)?.iter().map(ratio));
        without_observed(&mut values, exchanges.are_all());
        let p = reaching(&values) as f64 / values.len() as f64;
        let z = effect_size(&values, testing.transform).map(|size| size.z);
        Ok((values.len() > 1).then_some(RatioRecord { z, p }))
    }

    /// Tests terms against the residuals of the model.
    pub(super) fn test_plain(
        &self,
        hypotheses: &[Hypothesis],
        testing: &Testing<'_>,
        rows: &mut [TermRecord],
        watch: &dyn Watch,
    ) -> Result<(), ModelError> {
        for kind in [ExchangeKind::Free, ExchangeKind::Within, ExchangeKind::Whole] {
            let chosen =
                hypotheses.iter().filter(|hypothesis| self.kind_of(hypothesis.term, testing) == kind);
            let chosen: Vec<Hypothesis> = chosen.cloned().collect();
            if !chosen.is_empty() {
                self.test(&chosen, kind, testing, rows, watch)?;
            }
        }
        Ok(())
    }

    /// What the rows of the table are made of.
    pub(super) fn tested(&self) -> Tested<'_> {
        let Fitted { residual, total, .. } = self.fitted;
        Tested { design: &self.design, space: &self.space, shapes: self.design.shapes(), residual, total }
    }

    pub(super) fn record(
        &self,
        whole: &Self,
        terms: Vec<TermRecord>,
        dropped: Vec<String>,
        warnings: Vec<String>,
    ) -> AnovaRecord {
        self.tested().record((whole.degrees(), whole.fitted.residual), terms, dropped, warnings)
    }

    pub(super) fn row(&self, hypothesis: &Hypothesis, sums: Sums) -> TermRecord {
        self.tested().row(hypothesis, sums)
    }

    /// Kind of exchange for a term.
    pub(super) fn kind_of(&self, term: usize, testing: &Testing<'_>) -> ExchangeKind {
        let Some(blocks) = testing.blocks else { return ExchangeKind::Free };
        match testing.exchange {
            ExchangeRule::Free => ExchangeKind::Free,
            ExchangeRule::Within => ExchangeKind::Within,
            ExchangeRule::Whole => ExchangeKind::Whole,
            ExchangeRule::Auto => {
                let cells = self.design.cells_of(&self.design.formula.terms[term]);
                let both = pairs(blocks, &cells);
                let different = |labels: &[usize]| labels.iter().max().map_or(0, |last| last + 1);
                let (of_blocks, of_both) = (different(blocks), different(&both));
                let columns = self.design.term_of_column.iter().filter(|owner| **owner == term + 1).count();
                if of_both > of_blocks {
                    ExchangeKind::Within
                } else if different(&cells) == of_blocks && columns + 1 >= of_blocks {
                    // The blocks themselves, not a number of theirs.
                    ExchangeKind::Free
                } else {
                    ExchangeKind::Whole
                }
            }
        }
    }

    pub(super) fn test(
        &self,
        hypotheses: &[Hypothesis],
        kind: ExchangeKind,
        testing: &Testing<'_>,
        rows: &mut [TermRecord],
        watch: &dyn Watch,
    ) -> Result<(), ModelError> {
        let exchanges = self.exchanges(kind, testing)?;
        let observed = self.fitted.observed(hypotheses);
        let distinct = exchanges.distinct();
        let drawn = if are_few(&exchanges, testing) {
            Vec::new()
        } else {
            self.fitted.permuted(hypotheses, &exchanges, watch)?
        };
        for (i, hypothesis) in hypotheses.iter().enumerate() {
            let row = &mut rows[hypothesis.term];
            row.exchange = kind;
            row.distinct = distinct.is_finite().then_some(distinct);
            row.exact = exchanges.are_all() && !drawn.is_empty();
            let drawn: Vec<Sums> = drawn.iter().map(|sums| sums[i]).collect();
            self.tested().tell(row, observed[i], &drawn, testing);
        }
        Ok(())
    }

    pub(super) fn exchanges(
        &self,
        kind: ExchangeKind,
        testing: &Testing<'_>,
    ) -> Result<Exchanges, ModelError> {
        if let Some(given) = testing.given {
            return Ok(Exchanges::Given(given.to_vec()));
        }
        let none = vec![0; self.design.shapes()];
        let draw = Draw {
            strata: testing.strata.unwrap_or(&none),
            blocks: testing.blocks,
            kind,
            permutations: testing.permutations,
            seed: testing.seed,
        };
        Exchanges::new(&self.fitted.cells, draw).map_err(|sizes| ModelError::UnequalBlocks {
            sizes: sizes.iter().take(10).map(ToString::to_string).collect::<Vec<_>>().join(", "),
        })
    }
}

/// Weighted mean of numbers, about the first one.
pub(super) fn average(numbers: &[f64], weights: &[f64]) -> f64 {
    let (total, first) = (weights.iter().sum::<f64>(), numbers[0]);
    first + numbers.iter().zip(weights).map(|(x, w)| w * (x - first)).sum::<f64>() / total
}

/// Checks that a test of type III has a meaning: numbers of interactions have values on both sides of zero.
pub(super) fn check_origins(design: &Design) -> Result<(), ModelError> {
    let formula = &design.formula;
    for (k, variable) in design.variables.iter().enumerate() {
        let Prepared::Numbers { values, .. } = variable else { continue };
        if !formula.terms.iter().any(|term| term.degree() > 1 && term.0.contains(&k)) {
            continue;
        }
        let least = values.iter().copied().fold(f64::MAX, f64::min);
        let most = values.iter().copied().fold(f64::MIN, f64::max);
        if least > 0.0 || most < 0.0 {
            return Err(ModelError::FarFromZero { name: formula.variables[k].to_string(), least, most });
        }
    }
    Ok(())
}

/// Warnings about columns that are left out, and about type III.
pub(super) fn warnings_of(dropped: &[String], testing: &Testing<'_>, is_grouped: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    if !dropped.is_empty() {
        warnings.push(format!("columns that depend on others are left out: {}", dropped.join(", ")));
    }
    if testing.kind == SumType::III && testing.contrasts_of_three != Contrasts::Sum {
        warnings.push(
            "type III with other contrasts than sum tests effects at the reference level, not about the mean of all".into(),
        );
    }
    if testing.kind == SumType::III && is_grouped {
        warnings
            .push("terms that vary inside of random groups are tested by type II, given the groups".into());
    }
    warnings
}

/// Whether there are too few distinct exchanges for a p value.
pub(super) fn are_few(exchanges: &Exchanges, testing: &Testing<'_>) -> bool {
    exchanges.distinct() < FEWEST_EXCHANGES && testing.given.is_none()
}

/// Warning about a term whose p value no exchanges give.
pub(super) fn few_exchanges(row: &TermRecord) -> Option<String> {
    let distinct = row.distinct.filter(|distinct| *distinct < FEWEST_EXCHANGES)?;
    let term = &row.term;
    Some(format!("{term} has {distinct} distinct exchanges, of at least {FEWEST_EXCHANGES} for a p value"))
}
