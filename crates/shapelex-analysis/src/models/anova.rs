//! Analysis of variance of shapes: sums of squares, F, Z and p of each term of a model.
//!
//! A term is tested against the residuals of the whole model, or, if its levels differ only between the groups of an error term,
//! against these groups: then the shapes are averaged in them, with the sums of their weights, and the model of the averages has the
//! error term as its residuals. The ratio of two mean squares whose permutations are drawn apart has no level.

use super::design::{Contrasts, Design, Prepared, Table};
use super::effect_size::{Transform, effect_size, reaching};
use super::error::ModelError;
use super::exchange::{Draw, ExchangeKind, Exchanges, pairs};
use super::formula::Formula;
use super::permuted::{Fitted, Sums};
use super::records::{AnovaRecord, DesignRecord, ResidualRecord, TermRecord, TotalRecord};
use super::subspaces::{Hypothesis, Space, SumType};
use crate::inference::histogram::ExplainedHistogram;
use crate::watch::{Counted, Watch};
use shapelex_numeric::dense::Matrix;

/// Fewest distinct exchanges of a test: with fewer no p value is below .05.
const FEWEST_EXCHANGES: f64 = 20.0;

/// The statistic whose permutations are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Statistic {
    /// The ratio of mean squares.
    #[default]
    F,
    /// The sum of squares.
    SumOfSquares,
}

/// Choice of what is exchanged for each term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum ExchangeRule {
    /// With blocks, within them for terms that vary inside, whole blocks for others; without, all residuals.
    #[default]
    Auto,
    /// All residuals.
    Free,
    /// Residuals within blocks.
    Within,
    /// Whole blocks.
    Whole,
}

/// How a model is tested.
#[derive(Debug, Clone)]
pub struct Testing<'a> {
    /// Type of the sums of squares.
    pub kind: SumType,
    /// Contrasts of type III. Sums are those of the effects about the mean of all levels.
    pub contrasts_of_three: Contrasts,
    /// The statistic of p and Z.
    pub statistic: Statistic,
    /// Transformation of Z.
    pub transform: Transform,
    /// Number of permutations.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
    /// Stratum of each shape: nothing is exchanged between strata.
    pub strata: Option<&'a [usize]>,
    /// Block of each shape.
    pub blocks: Option<&'a [usize]>,
    /// Choice of the residuals that are exchanged.
    pub exchange: ExchangeRule,
    /// Terms that are tested against others, by their names.
    pub error_terms: &'a [(String, String)],
    /// Given exchanges, in place of drawn ones.
    pub given: Option<&'a [Vec<usize>]>,
}

impl Default for Testing<'_> {
    fn default() -> Self {
        Self {
            kind: SumType::default(),
            contrasts_of_three: Contrasts::Sum,
            statistic: Statistic::default(),
            transform: Transform::default(),
            permutations: 999,
            seed: 0,
            strata: None,
            blocks: None,
            exchange: ExchangeRule::default(),
            error_terms: &[],
            given: None,
        }
    }
}

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
        let design = Design::new(formula, table, contrasts)?;
        let space = Space::new(&design, &weights)?;
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
        let total: f64 = self.weights.iter().sum();
        let first = numbers[0];
        first + numbers.iter().zip(&self.weights).map(|(x, w)| w * (x - first)).sum::<f64>() / total
    }

    /// Weighted mean of the vectors.
    pub(super) fn mean(&self) -> Vec<f64> {
        self.vectors.row_iter().map(|row| self.average(&row.iter().copied().collect::<Vec<_>>())).collect()
    }

    /// Differences of the vectors from another, scaled by the roots of their weights.
    pub(super) fn scaled_about(&self, mean: &[f64]) -> Matrix {
        let roots = self.space.roots();
        Matrix::from_fn(self.length(), roots.len(), |i, k| (self.vectors[(i, k)] - mean[i]) * roots[k])
    }

    /// Checks that a test of type III has a meaning: numbers of interactions have values on both sides of zero.
    fn check_origins(&self) -> Result<(), ModelError> {
        let formula = &self.design.formula;
        for (k, variable) in self.design.variables.iter().enumerate() {
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

    /// Degrees of freedom of the residuals.
    pub fn degrees(&self) -> usize {
        self.design.shapes() - self.space.rank()
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
        if let Some(part) =
            self.design.formula.random.iter().find(|part| !part.intercept || !part.terms.is_empty())
        {
            let of = Formula { terms: Vec::new(), random: vec![part.clone()], ..self.design.formula.clone() };
            return Err(ModelError::RandomSlope { part: of.to_string().trim_start_matches("~ ").to_owned() });
        }
        if testing.kind == SumType::III {
            self.check_origins()?;
        }
        let hypotheses = self.space.hypotheses(&self.design, testing.kind, testing.contrasts_of_three)?;
        let mut warnings = self.design.warnings.clone();
        let counted = Counted::new(watch, testing.permutations * hypotheses.len());
        let observed = self.fitted.observed(&hypotheses);
        let mut rows: Vec<TermRecord> =
            hypotheses.iter().zip(&observed).map(|(hypothesis, sums)| self.row(hypothesis, *sums)).collect();
        let mut plain = Vec::new();
        for (hypothesis, row) in hypotheses.into_iter().zip(&mut rows) {
            if row.degrees == 0 {
                row.aliased_with = self.space.aliases(&self.design, hypothesis.term);
                continue;
            }
            match self.error_term_of(&hypothesis, testing)? {
                Some(error) => self.test_collapsed(&error, row, testing, &counted)?,
                None => plain.push(hypothesis),
            }
        }
        let grouped = match self.design.formula.random.is_empty() {
            true => None,
            false => Some(self.with_groups(&plain)?),
        };
        match &grouped {
            None => self.test_plain(&plain, testing, &mut rows, &counted)?,
            Some(grouped) => grouped.test(testing, &mut rows, &counted)?,
        }
        let dropped = self.space.dropped(&self.design);
        if !dropped.is_empty() {
            warnings.push(format!("columns that depend on others are left out: {}", dropped.join(", ")));
        }
        if testing.kind == SumType::III && testing.contrasts_of_three != Contrasts::Sum {
            warnings.push(
                "type III with other contrasts than sum tests effects at the reference level, not about the mean of all".into(),
            );
        }
        if testing.kind == SumType::III && grouped.is_some() {
            warnings.push(
                "terms that vary inside of random groups are tested by type II, given the groups".into(),
            );
        }
        warnings.extend(rows.iter().filter_map(few_exchanges));
        let whole = grouped.as_ref().map_or(self, |grouped| &grouped.model);
        Ok(self.record(whole, rows, dropped, warnings))
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
            let chosen = hypotheses.iter().filter(|hypothesis| self.kind_of(hypothesis, testing) == kind);
            let chosen: Vec<Hypothesis> = chosen.cloned().collect();
            if !chosen.is_empty() {
                self.test(&chosen, kind, testing, rows, watch)?;
            }
        }
        Ok(())
    }

    fn record(
        &self,
        whole: &Self,
        terms: Vec<TermRecord>,
        dropped: Vec<String>,
        mut warnings: Vec<String>,
    ) -> AnovaRecord {
        let degrees = whole.degrees();
        let (residual, total) = (whole.fitted.residual, self.fitted.total);
        if !self.design.formula.intercept {
            warnings.push("without an intercept, sums of squares and R² are those about zero".into());
        }
        AnovaRecord {
            formula: self.design.formula.to_string(),
            terms,
            residual: ResidualRecord {
                degrees,
                sum_of_squares: residual,
                mean_square: residual / degrees as f64,
                r_squared: share(residual, total),
            },
            total: TotalRecord {
                degrees: self.design.shapes() - usize::from(self.design.formula.intercept),
                sum_of_squares: total,
            },
            design: DesignRecord {
                columns: self.design.columns.clone(),
                dropped,
                rank: self.space.rank(),
                contrasts: self.design.contrasts,
                levels: self
                    .design
                    .factors()
                    .map(|(k, factor)| (self.design.formula.variables[k].to_string(), factor.levels.clone()))
                    .collect(),
            },
            warnings,
        }
    }

    pub(super) fn row(&self, hypothesis: &Hypothesis, sums: Sums) -> TermRecord {
        let degrees = hypothesis.own.ncols();
        let own = if degrees == 0 { 0.0 } else { sums.own };
        TermRecord {
            term: self.design.formula.name(&self.design.formula.terms[hypothesis.term]),
            degrees,
            sum_of_squares: own,
            mean_square: (degrees > 0).then(|| own / degrees as f64),
            r_squared: share(own, self.fitted.total),
            partial_eta_squared: share(own, own + self.fitted.residual),
            f: self.ratio(degrees, Sums { own, residual: self.fitted.residual }),
            ..TermRecord::default()
        }
    }

    /// `F`; `None` without degrees of freedom, or if nothing is left for the residuals.
    fn ratio(&self, degrees: usize, sums: Sums) -> Option<f64> {
        let mean = sums.residual / self.degrees() as f64;
        (degrees > 0 && sums.residual > 1e-12 * self.fitted.total).then(|| sums.own / degrees as f64 / mean)
    }

    /// Kind of exchange for a term.
    fn kind_of(&self, hypothesis: &Hypothesis, testing: &Testing<'_>) -> ExchangeKind {
        let Some(blocks) = testing.blocks else { return ExchangeKind::Free };
        match testing.exchange {
            ExchangeRule::Free => ExchangeKind::Free,
            ExchangeRule::Within => ExchangeKind::Within,
            ExchangeRule::Whole => ExchangeKind::Whole,
            ExchangeRule::Auto => {
                let term = self.design.cells_of(&self.design.formula.terms[hypothesis.term]);
                let both = pairs(blocks, &term);
                let different = |labels: &[usize]| labels.iter().max().map_or(0, |last| last + 1);
                let (of_blocks, of_both) = (different(blocks), different(&both));
                let columns =
                    self.design.term_of_column.iter().filter(|owner| **owner == hypothesis.term + 1).count();
                if of_both > of_blocks {
                    ExchangeKind::Within
                } else if different(&term) == of_blocks && columns + 1 >= of_blocks {
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
        let drawn = if distinct < FEWEST_EXCHANGES && testing.given.is_none() {
            Vec::new()
        } else {
            self.fitted.permuted(hypotheses, &exchanges, watch)?
        };
        for (i, hypothesis) in hypotheses.iter().enumerate() {
            let row = &mut rows[hypothesis.term];
            row.exchange = kind;
            row.distinct = distinct.is_finite().then_some(distinct);
            row.exact = exchanges.are_all() && !drawn.is_empty();
            let degrees = row.degrees;
            let value = |sums: Sums| match testing.statistic {
                Statistic::F => self.ratio(degrees, sums).unwrap_or(f64::MAX),
                Statistic::SumOfSquares => sums.own,
            };
            let mut values = vec![value(observed[i])];
            values.extend(drawn.iter().map(|sums| value(sums[i])));
            let shares: Vec<f64> =
                drawn.iter().map(|sums| share(sums[i].own, sums[i].own + sums[i].residual)).collect();
            row.histogram = ExplainedHistogram::new(&shares, row.partial_eta_squared, row.exact);
            row.tell(values, testing.transform);
        }
        Ok(())
    }

    fn exchanges(&self, kind: ExchangeKind, testing: &Testing<'_>) -> Result<Exchanges, ModelError> {
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

impl TermRecord {
    /// Fills in p and Z of a list of the statistic, the observed value first.
    fn tell(&mut self, mut values: Vec<f64>, transform: Transform) {
        if self.exact && values.len() > 1 {
            // The observed exchange is among all: the value nearest to it.
            let observed = values[0];
            let distance = |value: f64| (value - observed).abs();
            let nearest =
                (1..values.len()).min_by(|&a, &b| distance(values[a]).total_cmp(&distance(values[b])));
            nearest.map(|k| values.swap_remove(k));
        }
        self.permutations = values.len() - 1;
        if self.permutations == 0 {
            return;
        }
        self.exceeding = reaching(&values) - 1;
        self.p = Some((1 + self.exceeding) as f64 / values.len() as f64);
        self.z = effect_size(&values, transform).map(|size| size.z);
    }
}

/// Warning about a term whose p value no exchanges give.
fn few_exchanges(row: &TermRecord) -> Option<String> {
    let distinct = row.distinct.filter(|distinct| *distinct < FEWEST_EXCHANGES)?;
    let term = &row.term;
    Some(format!("{term} has {distinct} distinct exchanges, of at least {FEWEST_EXCHANGES} for a p value"))
}

fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 }
}
