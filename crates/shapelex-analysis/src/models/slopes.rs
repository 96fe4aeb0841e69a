//! Tests of effects that vary between groups: on the coefficients of the groups.
//!
//! With `(x | g)` the error of `x` is the scatter of its effect between the groups. Each group has its own coefficients by least squares,
//!
//! ```text
//! b_i = (Z_iᵀZ_i)⁻¹ Z_iᵀY_i,   weight 1/[(Z_iᵀZ_i)⁻¹]_xx
//! ```
//!
//! and the model of the coefficients of `x` has the terms `t` of `t:x`, tested by exchanges of the groups; their mean is tested by signs. The
//! groups are exchangeable if they have the same values of `x`. Groups that do not determine `b_i` are left out.
//!
//! Source: Wishart 1938; Winkler et al. 2014 (signs).

use super::anova::{Model, Testing};
use super::effect_size::{effect_size, reaching};
use super::error::ModelError;
use super::exchange::{ExchangeKind, pairs};
use super::formula::{Formula, RandomPart, Term};
use super::permuted::Fitted;
use super::records::TermRecord;
use super::subspaces::{Hypothesis, Space, orthonormal};
use super::testing::without_observed;
use crate::random::stream;
use crate::watch::Watch;
use rand::RngExt;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Fewest distinct signs of a test, as of exchanges.
const FEWEST_SIGNS: f64 = 20.0;

impl Model {
    /// The random part in which the effect of a term varies, with the term of that part.
    pub(super) fn slope_of(&self, term: &Term) -> Option<(&RandomPart, &Term)> {
        let within = |slope: &&Term| term.set() & slope.set() == slope.set();
        self.design.formula.random.iter().find_map(|part| Some((part, part.terms.iter().find(within)?)))
    }

    /// Tests a term whose effect varies between the groups of a random part; what cannot be tested is told.
    pub(super) fn test_slopes(
        &self,
        (part, slope): (&RandomPart, &Term),
        row: &mut TermRecord,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<Option<String>, ModelError> {
        let name = self.design.formula.part_name(part);
        let Some(slopes) = self.slopes(part, slope)? else {
            let term = &row.term;
            return Ok(Some(format!(
                "{term} is not tested: its effects in {name} are not single numbers, or too few groups determine them"
            )));
        };
        let own = TermRecord { error_term: Some(name.clone()), collapsed: true, ..TermRecord::default() };
        let term = row.term.clone();
        if self.design.formula.name(slope) == term {
            let tested = slopes.signs(testing, watch)?;
            *row = TermRecord { term, r_squared: row.r_squared, ..tested.with_error(own) };
            return Ok(None);
        }
        let model = &slopes.model;
        let hypotheses = model.space.hypotheses(&model.design, testing.kind, testing.contrasts_of_three)?;
        let formula = &self.design.formula;
        let is_own = |hypothesis: &Hypothesis| {
            let set = model.design.formula.terms[hypothesis.term].set() | slope.set();
            formula.terms.iter().any(|own| own.set() == set && formula.name(own) == term)
        };
        let chosen: Vec<Hypothesis> = hypotheses.into_iter().filter(is_own).collect();
        let Some(hypothesis) = chosen.first().filter(|hypothesis| hypothesis.own.ncols() > 0) else {
            return Ok(Some(format!(
                "{term} is not tested: it varies in other ways within the groups of {name}"
            )));
        };
        let mut rows: Vec<TermRecord> = vec![TermRecord::default(); model.design.formula.terms.len()];
        rows[hypothesis.term] = model.row(hypothesis, model.fitted.observed(&chosen)[0]);
        let inner = Testing { strata: None, blocks: None, error_terms: &[], given: None, ..testing.clone() };
        model.test_plain(&chosen, &inner, &mut rows, watch)?;
        let tested = rows.swap_remove(hypothesis.term);
        *row = TermRecord { term, r_squared: row.r_squared, ..tested.with_error(own) };
        Ok(None)
    }

    /// The model of the coefficients of the groups; `None` if fewer than its columns and one are determined, or a coefficient is none.
    fn slopes(&self, part: &RandomPart, slope: &Term) -> Result<Option<Slopes>, ModelError> {
        let formula = &self.design.formula;
        let all: Vec<usize> = (0..self.design.shapes()).collect();
        let has_intercept = part.intercept || formula.intercept;
        let own = Formula {
            intercept: has_intercept,
            terms: part.terms.clone(),
            random: Vec::new(),
            ..formula.clone()
        };
        let design = self.design.restricted(own, &all)?;
        let place = part.terms.iter().position(|term| term.set() == slope.set()).map_or(0, |place| place + 1);
        let columns: Vec<usize> =
            (0..design.columns.len()).filter(|j| design.term_of_column[*j] == place).collect();
        let [column] = columns.as_slice() else { return Ok(None) };
        let groups = self.design.cells_of(&part.group);
        let count = groups.iter().max().map_or(0, |last| last + 1);
        let mut members = vec![Vec::new(); count];
        groups.iter().enumerate().for_each(|(k, &group)| members[group].push(k));
        let mean = if has_intercept { self.mean() } else { vec![0.0; self.length()] };
        let scaled = self.scaled_about(&mean);
        let (mut vectors, mut weights, mut firsts) = (Vec::new(), Vec::new(), Vec::new());
        for members in &members {
            let z = Matrix::from_fn(members.len(), design.columns.len(), |i, j| {
                design.matrix[(members[i], j)] * self.space.roots()[members[i]]
            });
            let (basis, kept) = orthonormal(&Matrix::zeros(members.len(), 0), &z, has_intercept);
            let triangle = dense::transpose_multiply(&basis, &z);
            let Some(inverse) = triangle.try_inverse().filter(|_| kept.iter().all(|kept| *kept)) else {
                continue;
            };
            let along = dense::multiply(&scaled.select_columns(members), &basis);
            vectors.extend((along * inverse.row(*column).transpose()).iter().copied());
            weights.push(inverse.row(*column).norm_squared().recip());
            firsts.push(members[0]);
        }
        let constant =
            |term: &Term| pairs(&groups, &self.design.cells_of(term)).iter().max() == groups.iter().max();
        let mut terms = Vec::new();
        for term in formula.terms.iter().filter(|term| term.contains(slope)) {
            let rest = Term(term.0.iter().filter(|variable| !slope.0.contains(variable)).copied().collect());
            if constant(&rest) {
                terms.push(rest);
            }
        }
        let intercept = formula.terms.iter().any(|term| term.set() == slope.set());
        let model = Formula { intercept, terms, random: Vec::new(), ..formula.clone() };
        let design = self.design.restricted(model, &firsts)?;
        if firsts.len() <= design.columns.len() {
            return Ok(None);
        }
        let vectors = Matrix::from_vec(self.length(), firsts.len(), vectors);
        let space = Space::new(&design, &weights)?;
        let fitted = Fitted::new(&space, &vectors, false)?;
        Ok(Some(Slopes { model: Self { design, space, fitted, vectors, weights } }))
    }
}

impl TermRecord {
    fn with_error(self, own: Self) -> Self {
        Self { error_term: own.error_term, collapsed: own.collapsed, ..self }
    }
}

/// The model of the coefficients of the groups.
struct Slopes {
    model: Model,
}

impl Slopes {
    /// Tests the mean by signs of the groups.
    fn signs(&self, testing: &Testing<'_>, watch: &dyn Watch) -> Result<TermRecord, ModelError> {
        let model = &self.model;
        let (count, basis) = (model.weights.len(), &model.space.basis);
        let scaled = model.scaled_about(&vec![0.0; model.length()]);
        let (total, free) = (scaled.norm_squared(), (count - basis.ncols()) as f64);
        let sums = |sign: &dyn Fn(usize) -> f64| {
            let signed = Matrix::from_fn(count, basis.ncols(), |i, j| sign(i) * basis[(i, j)]);
            let along = dense::multiply(&scaled, &signed);
            let own = along.column(0).norm_squared();
            (own, (total - along.norm_squared()).max(f64::MIN_POSITIVE))
        };
        let (own, rest) = sums(&|_| 1.0);
        let f = |(own, rest): (f64, f64)| own / (rest / free);
        let distinct = 2_f64.powi(i32::try_from(count - 1).unwrap_or(i32::MAX));
        let exact = distinct <= testing.permutations as f64 + 1.0;
        let drawn = match (distinct < FEWEST_SIGNS, exact) {
            (true, _) => 0,
            (false, true) => distinct as usize,
            (false, false) => testing.permutations,
        };
        let mut values = vec![f((own, rest))];
        values.extend(parallel::try_map(drawn, &|index| {
            watch.check()?;
            watch.worked(1);
            let mut random = stream(testing.seed, index);
            let drawn: Vec<bool> = match exact {
                // The sign of the last group is kept: that of all does not matter.
                true => (0..count).map(|i| index >> i.min(63) & 1 == 1).collect(),
                false => (0..count).map(|_| random.random_range(0..2) == 1).collect(),
            };
            Ok::<_, crate::AnalysisError>(f(sums(&|i| if drawn[i] { -1.0 } else { 1.0 })))
        })?);
        without_observed(&mut values, exact && drawn > 0);
        let permutations = values.len() - 1;
        let exceeding = reaching(&values) - 1;
        Ok(TermRecord {
            degrees: 1,
            sum_of_squares: own,
            mean_square: Some(own),
            partial_eta_squared: own / (own + rest),
            f: Some(f((own, rest))),
            z: effect_size(&values, testing.transform).map(|size| size.z),
            p: (permutations > 0).then(|| (1 + exceeding) as f64 / (1 + permutations) as f64),
            exceeding,
            permutations,
            exact: exact && drawn > 0,
            exchange: ExchangeKind::Signs,
            distinct: Some(distinct).filter(|distinct| distinct.is_finite()),
            ..TermRecord::default()
        })
    }
}
