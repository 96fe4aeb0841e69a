//! The design of a stream: a row for all shapes of equal attributes.

use super::keyed::KeyedExchange;
use super::rows::Rows;
use super::sums::Basis;
use crate::models::anova::check_origins;
use crate::models::compare::nested_in;
use crate::models::design::{Contrasts, Design, Table};
use crate::models::error::ModelError;
use crate::models::formula::{Formula, Term};
use crate::models::study::ModelQuestion;
use crate::models::subspaces::{Hypothesis, Space, SumType, orthonormal};
use shapelex_numeric::dense::Matrix;

/// Most numbers of a shape whose scatter is summed, for asymptotic p values.
pub(super) const MOST_OF_SCATTER: usize = 1024;
/// Most groups whose scatter is compared.
pub(super) const MOST_GROUPS: usize = 256;
/// Most numbers of the sums of groups.
pub(super) const MOST_OF_GROUPS: usize = 1 << 22;

/// A design with one row for all shapes of equal attributes.
pub(super) struct StreamedDesign<'a> {
    pub(super) design: Design,
    pub(super) space: Space,
    pub(super) basis: Basis,
    /// Sum of the weights, and number of shapes, of each row.
    pub(super) weights: Vec<f64>,
    pub(super) counts: Vec<f64>,
    /// One entry for each row.
    pub(super) table: Table,
    /// One for each shape.
    pub(super) whole: &'a Table,
    /// Factors whose combinations are the groups.
    pub(super) factors: Vec<usize>,
}

impl<'a> StreamedDesign<'a> {
    pub(super) fn new(
        question: &ModelQuestion<'a>,
        weights: &[f64],
        length: usize,
    ) -> Result<Self, ModelError> {
        let ModelQuestion { formula, table, contrasts, .. } = *question;
        if formula.terms.is_empty() {
            return Err(ModelError::NoTerms);
        }
        let formulas: Vec<&Formula> = std::iter::once(formula).chain(question.further.reduced).collect();
        let rows = Rows::new(&formulas, table, weights.len());
        let small = rows.table(table);
        let design = Design::new(formula, &small, contrasts).map_err(|error| rows.located(error))?;
        let of_rows = rows.sums(weights.iter().copied());
        let counts = rows.sums(std::iter::repeat_n(1.0, weights.len()));
        let space = Space::of_rows(&design, &of_rows, None);
        space.check_shapes(rows.shapes())?;
        let rank = space.rank();
        let (factors, groups, count) = groups_of(&design, MOST_OF_GROUPS / (rank * length).max(1));
        let scaled = |row: usize| (0..rank).map(move |j| (row, j));
        let numbers = (0..rows.count()).flat_map(scaled);
        let numbers = numbers.map(|(row, j)| space.basis[(row, j)] / space.roots()[row]).collect();
        let is_one = weights.iter().all(|weight| *weight == 1.0);
        let roots = if is_one { Vec::new() } else { weights.iter().map(|weight| weight.sqrt()).collect() };
        let basis = Basis { rows, rank, numbers, roots, groups, count };
        Ok(Self { design, space, basis, weights: of_rows, counts, table: small, whole: table, factors })
    }

    pub(super) fn exchange(
        &self,
        strata: Option<&[u32]>,
        question: &ModelQuestion<'_>,
    ) -> Option<KeyedExchange> {
        let (testing, shapes) = (&question.testing, self.basis.rows.shapes());
        (testing.permutations > 0)
            .then(|| KeyedExchange::new(shapes, strata, testing.seed, testing.permutations))
    }

    /// The hypotheses of a question, and the names of the rows of the table.
    pub(super) fn hypotheses(
        &self,
        question: &ModelQuestion<'_>,
    ) -> Result<Vec<(Hypothesis, String)>, ModelError> {
        let Self { design, space, .. } = self;
        let name = |term: usize| design.formula.name(&design.formula.terms[term]);
        let testing = &question.testing;
        let Some(reduced) = question.further.reduced else {
            if testing.kind == SumType::III {
                check_origins(design)?;
            }
            let all = space.hypotheses(design, testing.kind, testing.contrasts_of_three)?;
            return Ok(all.into_iter().map(|of| (of.term, of)).map(|(term, of)| (of, name(term))).collect());
        };
        let reduced = Design::new(reduced, &self.table, Contrasts::Treatment)
            .map_err(|error| self.basis.rows.located(error))?;
        let nested = nested_in((design, space), &reduced, "reduced")?;
        let whole = Matrix::identity(space.rank(), space.rank());
        let (own, _) = orthonormal(&nested.reduced, &whole, false);
        let names: Vec<String> = nested.added.iter().map(|&term| name(term)).collect();
        Ok(vec![(Hypothesis { term: 0, reduced: nested.reduced, own }, names.join(" + "))])
    }
}

/// Factors of the terms of a design, the combination of their levels of each row, and the number of combinations; one for all rows if they
/// are too many to be compared.
fn groups_of(design: &Design, most: usize) -> (Vec<usize>, Vec<u32>, usize) {
    let used = design.formula.terms.iter().fold(0, |set, term| set | term.set());
    let factors: Vec<usize> = design.factors().map(|(k, _)| k).filter(|k| used & 1 << k != 0).collect();
    let groups = design.cells_of(&Term(factors.clone()));
    let count = groups.iter().max().map_or(0, |last| last + 1);
    if factors.is_empty() || count > MOST_GROUPS.min(most) {
        return (Vec::new(), vec![0; design.shapes()], 1);
    }
    (factors, groups.into_iter().map(|group| group as u32).collect(), count)
}
