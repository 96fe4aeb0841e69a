//! Vectors that are linear in the response, for exchanged and for redrawn residuals.
//!
//! A row `L` of the design stands for the vector `v = L B̂`. With `X = QC`, `U = QᵀY` and the reduced model `M = B_r B_rᵀ`:
//!
//! ```text
//! T = C⁻ᵀLᵀ,   V = TᵀU = HᵀY,   H = QT
//! exchange π:  V^π = TᵀMU + HᵀR[π],   R = E + Q(I − M)U
//! bootstrap δ: V* − V = HᵀE*[δ],      E* = E/√(1 − h), about its mean in each stratum
//! ```
//!
//! `R[π]` has the residual of shape `π(i)` in row `i`; `δ` draws with replacement within strata. `n P` multiply-adds an exchange for each
//! vector.
//!
//! Sources: Collyer, Sekora and Adams 2015; Davison and Hinkley 1997 (residuals of equal variance).

use rand::RngExt;

use super::anova::{FEWEST_EXCHANGES, Model, Testing};
use super::compare::Nested;
use super::effect_size::{Transform, effect_size, reaching};
use super::error::ModelError;
use super::exchange::{ExchangeKind, Exchanges};
use super::permuted::reduced;
use super::testing::without_observed;
use crate::AnalysisError;
use crate::inference::permutation::holm;
use crate::quantile::quantile;
use crate::random::stream;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Draws between two looks at the watch.
const BATCH: usize = 32;
/// Part of a residual below which a shape is fitted by itself alone, and has none to draw.
const OWN: f64 = 1e-9;

/// A permutation test of one statistic.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ExchangedStatistic {
    /// The observed value: distances and lengths in the norm of the shapes, angles in radians.
    pub value: f64,
    /// p value `(1 + exceeding)/(1 + permutations)`; null without permutations, and with fewer than 20 distinct exchanges.
    pub p: Option<f64>,
    /// p value corrected by Holm for the number of pairs; null if `p` is, and for one pair.
    pub p_holm: Option<f64>,
    /// Effect size, as for the terms of the table.
    pub z: Option<f64>,
    /// 95 % quantile of the statistic under the null model, the level that chance alone reaches. It does not bound a
    /// confidence interval.
    pub critical95: Option<f64>,
    /// Number of exchanges, without the observed one, whose statistic reaches the observed one.
    pub exceeding: usize,
}

impl ExchangedStatistic {
    /// The test of a list of a statistic, the observed value first; of all distinct exchanges if it is `exact`.
    pub(super) fn new(mut values: Vec<f64>, exact: bool, transform: Transform) -> Self {
        let value = values.first().copied().unwrap_or_default();
        without_observed(&mut values, exact);
        if values.len() < 2 {
            return Self { value, ..Self::default() };
        }
        let reached = reaching(&values);
        let z = effect_size(&values, transform).map(|size| size.z);
        let p = Some(reached as f64 / values.len() as f64);
        values.sort_by(f64::total_cmp);
        let critical95 = Some(quantile(&values, 0.95));
        Self { value, p, z, critical95, exceeding: reached - 1, ..Self::default() }
    }

    /// Fills in Holm's correction for all tests of one statistic.
    pub(super) fn correct<'a>(tests: impl Iterator<Item = &'a mut Self>) {
        let mut tests: Vec<&mut Self> = tests.filter(|test| test.p.is_some()).collect();
        if tests.len() > 1 {
            let corrected = holm(&tests.iter().filter_map(|test| test.p).collect::<Vec<_>>());
            tests.iter_mut().zip(corrected).for_each(|(test, p)| test.p_holm = Some(p));
        }
    }
}

/// Exchanges of a test, with their number.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ExchangeRecord {
    /// Units of exchange: all residuals, those within blocks, or whole blocks.
    pub exchange: ExchangeKind,
    /// Number of distinct exchanges; null beyond the range of numbers.
    pub distinct: Option<f64>,
    /// Whether all distinct exchanges were made, so that p is exact.
    pub exact: bool,
    /// Number of exchanges, without the observed one.
    pub permutations: usize,
}

/// Lists of statistics, the observed value of each first, and the exchanges that made them.
pub(super) struct Lists {
    pub(super) values: Vec<Vec<f64>>,
    pub(super) made: ExchangeRecord,
}

impl Lists {
    /// Lists of `observed` values, and of those of each exchange. `watch` is asked before every batch.
    pub(super) fn new(
        (exchanges, kind): (&Exchanges, ExchangeKind),
        observed: Vec<f64>,
        testing: &Testing<'_>,
        of: &(dyn Fn(usize) -> Vec<f64> + Sync),
        watch: &dyn Watch,
    ) -> Result<Self, ModelError> {
        let distinct = exchanges.distinct();
        let is_tested = distinct >= FEWEST_EXCHANGES || testing.given.is_some();
        let count = if is_tested { exchanges.count() } else { 0 };
        let drawn = batches(count, of, watch)?;
        let mut values: Vec<Vec<f64>> = observed.into_iter().map(|value| vec![value]).collect();
        for list in &mut values {
            list.reserve_exact(count);
        }
        for found in drawn {
            values.iter_mut().zip(found).for_each(|(list, value)| list.push(value));
        }
        let exact = exchanges.are_all() && count > 0;
        let made = ExchangeRecord {
            exchange: kind,
            distinct: distinct.is_finite().then_some(distinct),
            exact,
            permutations: count - usize::from(exact),
        };
        Ok(Self { values, made })
    }

    /// Tests of the lists.
    pub(super) fn tests(self, transform: Transform) -> (Vec<ExchangedStatistic>, ExchangeRecord) {
        let exact = self.made.exact;
        let test = |values| ExchangedStatistic::new(values, exact, transform);
        (self.values.into_iter().map(test).collect(), self.made)
    }
}

/// Numbers of `count` draws, in batches on all threads.
fn batches<T: Send>(
    count: usize,
    of: &(dyn Fn(usize) -> T + Sync),
    watch: &dyn Watch,
) -> Result<Vec<T>, AnalysisError> {
    let found = parallel::try_map(count.div_ceil(BATCH), &|batch| {
        watch.check()?;
        Ok::<_, AnalysisError>((batch * BATCH..count.min((batch + 1) * BATCH)).map(of).collect::<Vec<_>>())
    })?;
    Ok(found.into_iter().flatten().collect())
}

/// Vectors `L B̂` of rows of a design.
#[derive(Debug, Clone)]
pub struct Functions {
    /// Name of each vector.
    pub names: Vec<String>,
    /// `T`: one column for each vector, in the coordinates of the basis.
    directions: Matrix,
    /// Factor of the intercept in each vector.
    intercepts: Vec<f64>,
}

impl Functions {
    /// The vectors of `rows`, each of which has a number for every column of the design.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` for a row that the shapes do not determine.
    pub fn new(
        model: &Model,
        names: Vec<String>,
        rows: &[Vec<f64>],
        field: &'static str,
    ) -> Result<Self, ModelError> {
        let (design, space) = (&model.design, &model.space);
        let kept: Vec<usize> = (0..space.kept.len()).filter(|j| space.kept[*j]).collect();
        let own = Matrix::from_fn(space.rank(), kept.len(), |i, j| space.coordinates[(i, kept[j])]);
        let wanted = Matrix::from_fn(kept.len(), rows.len(), |j, g| rows[g][kept[j]]);
        let solved = own.transpose().lu().solve(&wanted);
        let directions = solved.unwrap_or_else(|| Matrix::zeros(space.rank(), rows.len()));
        for (g, row) in rows.iter().enumerate() {
            let direction = directions.column(g);
            let is_off = |j: &usize| {
                let column = space.coordinates.column(*j);
                let scale = column.norm() * direction.norm() + row[*j].abs();
                (column.dot(&direction) - row[*j]).abs() > 1e-7 * scale
            };
            if let Some(j) = (0..row.len()).find(is_off) {
                let detail = format!(
                    "expected averages that the shapes determine, got '{}', for which {} cannot be told from other columns",
                    names[g], design.columns[j]
                );
                return Err(ModelError::Setting { field, detail });
            }
        }
        let intercepts = rows.iter().map(|row| if design.formula.intercept { row[0] } else { 0.0 }).collect();
        Ok(Self { names, directions, intercepts })
    }

    /// The coefficients of the columns that are kept; `inverse` is `C⁻ᵀ` of them.
    pub(super) fn of_columns(model: &Model, inverse: Matrix) -> Self {
        let intercept = |j: usize| f64::from(u8::from(j == 0 && model.design.formula.intercept));
        let intercepts = (0..inverse.ncols()).map(intercept).collect();
        Self { names: Vec::new(), directions: inverse, intercepts }
    }

    /// `H = QT`: one row for each shape.
    fn weights(&self, model: &Model) -> Matrix {
        dense::multiply(&model.space.basis, &self.directions)
    }

    /// The vectors, one a column.
    pub fn vectors(&self, model: &Model) -> Matrix {
        let mean = model.origin();
        let coordinates = dense::multiply(&model.scaled_about(&mean), &model.space.basis);
        let mut found = dense::multiply(&coordinates, &self.directions);
        for (mut column, factor) in found.column_iter_mut().zip(&self.intercepts) {
            column.iter_mut().zip(&mean).for_each(|(value, mean)| *value += factor * mean);
        }
        found
    }
}

/// Statistics of vectors that are to be tested: `statistics` of the vectors, one a column, gives `count` numbers.
pub(super) struct Tested<'a> {
    pub(super) functions: &'a Functions,
    pub(super) null: &'a Nested,
    /// Whether the vectors are taken about the mean of all, which keeps the digits of differences; otherwise about zero.
    pub(super) about_mean: bool,
    pub(super) statistics: &'a (dyn Fn(&Matrix) -> Vec<f64> + Sync),
}

impl Model {
    /// Mean of the vectors for a model with an intercept, otherwise zero.
    fn origin(&self) -> Vec<f64> {
        if self.design.formula.intercept { self.mean() } else { vec![0.0; self.length()] }
    }

    /// `E` and `U`, one column for each shape and basis vector, about an origin.
    fn parts(&self, origin: &[f64]) -> (Matrix, Matrix) {
        let scaled = self.scaled_about(origin);
        let coordinates = dense::multiply(&scaled, &self.space.basis);
        let residuals = scaled - dense::multiply(&coordinates, &self.space.basis.transpose());
        (residuals, coordinates)
    }

    /// Lists of statistics of vectors for exchanges of the residuals of a reduced model.
    ///
    /// # Errors
    /// Blocks without equals; a failure of an eigenproblem; [`AnalysisError::Interrupted`] once `watch` stops.
    pub(super) fn exchanged(
        &self,
        tested: &Tested<'_>,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Lists, ModelError> {
        let Tested { functions, null, about_mean, statistics } = tested;
        let origin = if *about_mean { self.origin() } else { vec![0.0; self.length()] };
        let (residuals, coordinates) = self.parts(&origin);
        let (mut residuals, coordinates) = reduced(residuals, coordinates)?;
        let observed = statistics(&dense::multiply(&coordinates, &functions.directions));
        let inside = dense::multiply(&coordinates, &null.reduced);
        let fitted = dense::multiply(&inside, &null.reduced.transpose());
        let beyond = &coordinates - &fitted;
        residuals += dense::multiply(&beyond, &self.space.basis.transpose());
        let base = dense::multiply(&fitted, &functions.directions);
        let kind = self.kind_of_terms(&null.added, testing)?;
        let exchanges = self.exchanges(kind, testing)?;
        let (weights, cells) = (functions.weights(self), &self.fitted.cells);
        let mut firsts = vec![0; cells.iter().max().map_or(0, |last| last + 1)];
        cells.iter().enumerate().rev().for_each(|(k, &cell)| firsts[cell] = k);
        let of = |index: usize| {
            let mut to = vec![0; cells.len()];
            exchanges.cells(index, cells, &mut to);
            let moved = Matrix::from_fn(cells.len(), weights.ncols(), |k, g| weights[(firsts[to[k]], g)]);
            statistics(&(&base + dense::multiply(&residuals, &moved)))
        };
        Lists::new((&exchanges, kind), observed, testing, &of, watch)
    }

    /// Residuals, one a column.
    pub(super) fn residuals(&self) -> Matrix {
        self.parts(&self.origin()).0
    }

    /// Residuals of equal variance, about their means in the strata, one a column.
    pub(super) fn drawn_residuals(&self, strata: &[usize]) -> Matrix {
        let mut residuals = self.residuals();
        let leverages = self.space.leverages();
        for (mut column, leverage) in residuals.column_iter_mut().zip(&leverages) {
            let free = 1.0 - leverage;
            column.scale_mut(if free > OWN { 1.0 / free.sqrt() } else { 0.0 });
        }
        let count = strata.iter().max().map_or(0, |last| last + 1);
        let (mut means, mut sizes) = (Matrix::zeros(residuals.nrows(), count), vec![0.0; count]);
        for (k, &stratum) in strata.iter().enumerate() {
            let mut mean = means.column_mut(stratum);
            mean += residuals.column(k);
            sizes[stratum] += 1.0;
        }
        for (k, &stratum) in strata.iter().enumerate() {
            let mut column = residuals.column_mut(k);
            column.axpy(-1.0 / sizes[stratum], &means.column(stratum), 1.0);
        }
        residuals
    }

    /// `of` the changes of vectors, one a column, for residuals that are drawn anew within strata.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `watch` stops.
    pub(super) fn redrawn<T: Send>(
        &self,
        (functions, residuals): (&Functions, &Matrix),
        strata: &[usize],
        testing: &Testing<'_>,
        of: &(dyn Fn(Matrix) -> T + Sync),
        watch: &dyn Watch,
    ) -> Result<Vec<T>, AnalysisError> {
        let weights = functions.weights(self);
        let mut members = vec![Vec::new(); strata.iter().max().map_or(0, |last| last + 1)];
        strata.iter().enumerate().for_each(|(k, &stratum)| members[stratum].push(k));
        let draw = |index: usize| {
            let mut random = stream(testing.seed, index);
            let mut moved = Matrix::zeros(strata.len(), weights.ncols());
            for (k, &stratum) in strata.iter().enumerate() {
                let from = members[stratum][random.random_range(0..members[stratum].len())];
                let mut row = moved.row_mut(from);
                row += weights.row(k);
            }
            of(dense::multiply(residuals, &moved))
        };
        batches(testing.permutations, &draw, watch)
    }
}
