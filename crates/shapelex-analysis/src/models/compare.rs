//! Two nested models beside each other.
//!
//! ```text
//! span X_red ⊂ span X:   SS = ‖Y_full − Y_red‖²,   df = rank X − rank X_red,   F = (SS/df)/(RSS/df_E)
//! ```
//!
//! The residuals of the reduced model are exchanged, as for a term of the table.

use std::collections::BTreeSet;

use super::anova::{ExchangeRule, Model, Testing};
use super::design::{Contrasts, Design, Table};
use super::error::ModelError;
use super::exchange::ExchangeKind;
use super::formula::{Formula, Term};
use super::records::AnovaRecord;
use super::subspaces::{Hypothesis, Space, orthonormal, scaled};
use crate::watch::{Counted, Watch};
use shapelex_numeric::dense::{self, Matrix};

/// Length that a unit vector of a nested model may have outside of the larger one.
const OUTSIDE: f64 = 1e-7;

/// A reduced model in the space of a larger one.
#[derive(Debug, Clone)]
pub struct Nested {
    /// Its formula.
    pub(super) formula: String,
    /// `B_r`: orthonormal columns in the coordinates of the basis.
    pub(super) reduced: Matrix,
    /// Terms of the larger model that it has not.
    pub(super) added: Vec<usize>,
}

/// A reduced model by its design, of the same rows as the `whole` one.
///
/// # Errors
/// [`ModelError::Setting`] at `field` for a model that is not nested in the whole one, or is not smaller.
pub(super) fn nested_in(
    (whole, space): (&Design, &Space),
    design: &Design,
    field: &'static str,
) -> Result<Nested, ModelError> {
    let (basis, formula) = (&space.basis, design.formula.to_string());
    let columns = scaled(design, space.roots(), None);
    let (own, _) = orthonormal(&Matrix::zeros(columns.nrows(), 0), &columns, design.formula.intercept);
    let inside = dense::transpose_multiply(basis, &own);
    let outside = &own - dense::multiply(basis, &inside);
    let refused = |detail: String| Err(ModelError::Setting { field, detail });
    if outside.column_iter().any(|column| column.norm() > OUTSIDE) {
        return refused(format!("expected a model within {}, got {formula}", whole.formula));
    }
    // Without the mean in it, residuals of the reduced model are not those about the mean, which the sums of squares are.
    let is_centred = (0..inside.ncols()).map(|j| inside[(0, j)].powi(2)).sum::<f64>() > 1.0 - OUTSIDE;
    if whole.formula.intercept && !is_centred {
        return refused(format!("expected a model with an intercept, got {formula}"));
    }
    if inside.ncols() >= space.rank() {
        return refused(format!(
            "expected a smaller model than {}, got {formula}, which has the same fits",
            whole.formula
        ));
    }
    let (reduced, _) = orthonormal(&Matrix::zeros(inside.nrows(), 0), &inside, false);
    let known: BTreeSet<_> =
        design.formula.terms.iter().map(|term| variables(&design.formula, term)).collect();
    let terms = whole.formula.terms.iter().enumerate();
    let added = terms.filter(|(_, term)| !known.contains(&variables(&whole.formula, term)));
    Ok(Nested { formula, reduced, added: added.map(|(t, _)| t).collect() })
}

/// The variables of a term.
fn variables(formula: &Formula, term: &Term) -> BTreeSet<String> {
    term.0.iter().map(|&v| formula.variables[v].to_string()).collect()
}

impl Model {
    /// A reduced model by its formula.
    ///
    /// # Errors
    /// Errors of its design; [`ModelError::Setting`] at `field` for a model that is not nested in this one, or is not smaller.
    pub fn nested(
        &self,
        formula: &Formula,
        table: &Table,
        field: &'static str,
    ) -> Result<Nested, ModelError> {
        self.nested_design(&Design::new(formula, table, Contrasts::Treatment)?, field)
    }

    /// The model without some of its terms.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` if all terms are left.
    pub(super) fn without(
        &self,
        is_out: impl Fn(&Term) -> bool,
        field: &'static str,
    ) -> Result<Nested, ModelError> {
        let own = &self.design.formula;
        let terms: Vec<Term> = own.terms.iter().filter(|term| !is_out(term)).cloned().collect();
        let intercept = own.intercept || terms.is_empty();
        let formula = Formula { terms, intercept, random: Vec::new(), ..own.clone() };
        let all: Vec<usize> = (0..self.design.shapes()).collect();
        self.nested_design(&self.design.restricted(formula, &all)?, field)
    }

    fn nested_design(&self, design: &Design, field: &'static str) -> Result<Nested, ModelError> {
        nested_in((&self.design, &self.space), design, field)
    }

    /// What is exchanged to test several terms at once.
    ///
    /// # Errors
    /// Terms some of which vary within the blocks while others do not.
    pub(super) fn kind_of_terms(
        &self,
        terms: &[usize],
        testing: &Testing<'_>,
    ) -> Result<ExchangeKind, ModelError> {
        let kinds: Vec<ExchangeKind> = terms.iter().map(|&term| self.kind_of(term, testing)).collect();
        match kinds.first() {
            Some(first) if kinds.iter().all(|kind| kind == first) => Ok(*first),
            None if testing.blocks.is_none() || testing.exchange == ExchangeRule::Free => {
                Ok(ExchangeKind::Free)
            }
            _ => {
                let names: Vec<String> = terms
                    .iter()
                    .map(|&term| self.design.formula.name(&self.design.formula.terms[term]))
                    .collect();
                let detail = format!(
                    "expected within or whole, got auto: of the terms {} some vary within the blocks, others do not",
                    names.join(", ")
                );
                Err(ModelError::Setting { field: "exchange", detail })
            }
        }
    }

    /// The comparison with a reduced model, as a table of one row.
    ///
    /// # Errors
    /// Models that are not nested; errors of the test.
    pub fn compare(
        &self,
        reduced: &Formula,
        table: &Table,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<AnovaRecord, ModelError> {
        self.check_fixed("full")?;
        if self.design.formula.terms.is_empty() {
            return Err(ModelError::NoTerms);
        }
        let nested = self.nested(reduced, table, "reduced")?;
        let (own, _) =
            orthonormal(&nested.reduced, &Matrix::identity(self.space.rank(), self.space.rank()), false);
        let hypothesis = Hypothesis { term: 0, reduced: nested.reduced, own };
        let observed = self.fitted.observed(std::slice::from_ref(&hypothesis));
        let mut rows: Vec<_> =
            observed.first().map(|sums| self.row(&hypothesis, *sums)).into_iter().collect();
        let kind = self.kind_of_terms(&nested.added, testing)?;
        self.test(&[hypothesis], kind, testing, &mut rows, &Counted::new(watch, testing.permutations))?;
        let names =
            nested.added.iter().map(|&term| self.design.formula.name(&self.design.formula.terms[term]));
        let names: Vec<String> = names.collect();
        rows.iter_mut().for_each(|row| row.term = names.join(" + "));
        let mut warnings = self.design.warnings.clone();
        warnings.extend(rows.iter().filter_map(super::anova::few_exchanges));
        Ok(self.record(self, rows, self.space.dropped(&self.design), warnings))
    }

    /// Checks that a formula has no random parts.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` for one that has.
    pub(super) fn check_fixed(&self, field: &'static str) -> Result<(), ModelError> {
        if self.design.formula.random.is_empty() {
            return Ok(());
        }
        let detail = format!(
            "expected a formula without random parts, got {}: give the groups as `blocks`",
            self.design.formula
        );
        Err(ModelError::Setting { field, detail })
    }
}
