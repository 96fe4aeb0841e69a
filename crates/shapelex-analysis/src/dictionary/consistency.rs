//! Consistency of a content that was not learnt here, and of the dictionary made of it.

use super::content::{Content, HeldOutMeasure, TypicalScores};
use super::in_use::Dictionary;
use crate::factors::RobustSummary;
use crate::metric::norm;
use crate::rows::Row;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_numeric::MAX_NUMBER;

/// Tolerance for products of atoms in a file; for learnt atoms the deviation is about 1e-15.
const ORTHONORMAL: f64 = 1e-6;

impl Content {
    /// Inconsistencies in a content whose representation and method are valid: wrong sizes, and values that learning never
    /// produces.
    pub fn faults(&self) -> Vec<FieldFault> {
        let (size, dimension) = (self.representation.size(), self.representation.dimension());
        let mut faults = Vec::new();
        let mut check = |ok: bool, field: String, detail: &str| {
            if !ok {
                faults.push(FieldFault::new(field, detail));
            }
        };
        let bounded = |row: &[f64]| row.iter().all(|value| value.abs() <= MAX_NUMBER);
        let shape = |rows: &[Row]| {
            rows.len() == size && rows.iter().all(|row| row.len() == dimension && bounded(row))
        };
        let wrong = "expected the size of the representation, and numbers within ±1e100";
        check(shape(&self.mean.control_points), "mean/control_points".into(), wrong);
        for (j, atom) in self.atoms.iter().enumerate() {
            check(shape(&atom.control_points), format!("atoms/{j}/control_points"), wrong);
        }
        if let Some(centre) = &self.centre {
            check(shape(centre), "centre".into(), wrong);
        }
        let scores = self.statistics.scores.as_ref();
        for (field, detail) in self.method.inconsistencies(self, &bounded) {
            check(false, field.into(), detail);
        }
        let quantiles = |values: &[f64]| !values.is_empty() && values.is_sorted();
        let residuals = &self.statistics.residuals;
        check(quantiles(residuals), "statistics/residuals".into(), "expected numbers in ascending order");
        check(
            scores.is_none_or(|scores| quantiles(&scores.t_squared)),
            "statistics/scores/t_squared".into(),
            "expected numbers in ascending order",
        );
        let counts = |robust: &RobustSummary| {
            robust.effective.is_finite()
                && robust.effective >= 0.0
                && robust.reduced <= self.statistics.shapes
        };
        check(
            self.robust.as_ref().is_none_or(counts),
            "robust".into(),
            "expected counts of shapes, and the number that they are worth",
        );
        faults.extend(held_out_faults(self));
        faults
    }
}

impl Dictionary {
    /// Faults that make comparisons impossible: a mean without extent, and atoms that are not of unit norm or not
    /// orthogonal where they must be (components, and the blocks of invariant codes).
    pub fn norm_faults(&self) -> Vec<FieldFault> {
        let mut faults = Vec::new();
        let model = &self.model;
        if !(norm(&self.preparation.mean) > 0.0) {
            faults.push(FieldFault::new("mean/control_points", "expected a shape with an extent"));
        }
        // Components are mutually orthogonal; the atoms of invariant codes have orthogonal blocks.
        let (columns, block) = model.columns();
        let group = if self.content.method.is_sparse() { block } else { columns.ncols() };
        for j in 0..model.len() {
            let first = j * block / group.max(1) * group;
            let products = columns.columns(first, group).tr_mul(&columns.columns(j * block, block));
            let wanted = |i: usize, k: usize| if first + i == j * block + k { 1.0 } else { 0.0 };
            let near = |i: usize, k: usize| (products[(i, k)] - wanted(i, k)).abs() <= ORTHONORMAL;
            if !(0..group).all(|i| (0..block).all(|k| near(i, k))) {
                let detail = "expected unit norm, and orthogonality where the method requires it";
                faults.push(FieldFault::new(format!("atoms/{j}/control_points"), detail));
            }
        }
        faults
    }
}

/// Inconsistencies in the measures of held-out shapes.
fn held_out_faults(content: &Content) -> Vec<FieldFault> {
    let Some(held_out) = &content.statistics.held_out else { return Vec::new() };
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(FieldFault::new(format!("statistics/held_out/{field}"), detail));
        }
    };
    let left = held_out.novelty.len();
    let count = left + held_out.gross_errors.as_ref().map_or(0, |gross| gross.shapes);
    let ascending = |values: &[f64], count: usize| {
        values.len() == count && values.is_sorted() && values.iter().all(|value| value.abs() <= MAX_NUMBER)
    };
    let fits = |measure: &HeldOutMeasure| {
        ascending(&measure.values, count)
            && measure.log_mean.abs() <= MAX_NUMBER
            && (1e-100..=MAX_NUMBER).contains(&measure.log_deviation)
    };
    let wrong = "expected one number per held-out shape in ascending order, with mean and positive deviation";
    check(
        left >= 2 && ascending(&held_out.novelty, left),
        "novelty",
        "expected at least two numbers in ascending order",
    );
    check(fits(&held_out.residuals), "residuals", wrong);
    check(held_out.t_squared.as_ref().is_none_or(fits), "t_squared", wrong);
    let components = !content.method.is_sparse();
    check(
        held_out.t_squared.is_some() == components,
        "t_squared",
        "expected for components, and only for them",
    );
    let scores = held_out.gross_errors.as_ref().and_then(|gross| gross.scores.as_ref());
    check(
        scores.is_none_or(|scores| components && are_of(scores, content.atoms.len())),
        "gross_errors/scores",
        "expected a mean and a covariance of the scores, with mean and positive deviation of logarithms",
    );
    faults
}

/// Whether these can be scores in `components` components.
fn are_of(scores: &TypicalScores, components: usize) -> bool {
    let TypicalScores { mean, covariance, log_mean, log_deviation } = scores;
    let row = |row: &[f64]| row.len() == components && row.iter().all(|value| value.abs() <= MAX_NUMBER);
    row(mean)
        && covariance.len() == components
        && covariance.iter().all(|values| row(values))
        && log_mean.abs() <= MAX_NUMBER
        && (1e-100..=MAX_NUMBER).contains(log_deviation)
}
