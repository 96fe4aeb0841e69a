//! Coefficients of the columns of a design.

use super::anova::Model;
use super::design::Design;
use super::records::CoefficientRecord;
use super::subspaces::Space;
use crate::metric::{Metric, norm};
use shapelex_numeric::dense::{self, Matrix};

/// Part of the largest number that a combination of the kept columns can have, by which it may miss another column: columns depend
/// on others to as many digits.
const DEPENDENT: f64 = 1e-7;

/// Coefficients of the columns that are kept, with `C⁻ᵀ` for leverages, and the combinations of them that the other columns are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coefficients {
    /// One row for each kept column.
    pub(super) rows: Matrix,
    /// Positions of the kept columns.
    pub(super) kept: Vec<usize>,
    /// Inverse of `Cᵀ` of the kept columns; `None` only for a basis that lost all digits.
    pub(super) inverse: Option<Matrix>,
    /// Positions of the columns that are left out.
    pub(super) left_out: Vec<usize>,
    /// The combination of the kept columns that each column that is left out is, one a column; `None` as for `inverse`.
    pub(super) aliases: Option<Matrix>,
}

impl Coefficients {
    pub(super) fn new(model: &Model) -> Self {
        // About the mean, which is the intercept's: coordinates keep the digits of the differences.
        let centred = dense::multiply(&model.centred(), &model.space.basis);
        Self::of(&model.space, &centred, model.design.formula.intercept.then(|| model.mean()))
    }

    /// Coefficients of vectors with the coordinates `centred` about a `mean`, which is the intercept's, one column for each vector of the
    /// basis.
    pub(super) fn of(space: &Space, centred: &Matrix, mean: Option<Vec<f64>>) -> Self {
        let kept: Vec<usize> = (0..space.kept.len()).filter(|j| space.kept[*j]).collect();
        let coordinates = Matrix::from_fn(space.rank(), kept.len(), |i, j| space.coordinates[(i, kept[j])]);
        let mut rows = coordinates
            .clone()
            .lu()
            .solve(&centred.transpose())
            .unwrap_or_else(|| Matrix::zeros(kept.len(), centred.nrows()));
        if let Some(mean) = mean {
            rows.row_mut(0).iter_mut().zip(mean).for_each(|(value, mean)| *value += mean);
        }
        let left_out: Vec<usize> = (0..space.kept.len()).filter(|j| !space.kept[*j]).collect();
        let others =
            Matrix::from_fn(space.rank(), left_out.len(), |i, j| space.coordinates[(i, left_out[j])]);
        let aliases = space.solve(&others);
        Self { rows, kept, inverse: coordinates.transpose().try_inverse(), left_out, aliases }
    }

    pub(super) fn records(
        &self,
        design: &Design,
        space: &Space,
        metric: Option<&Metric>,
    ) -> Vec<CoefficientRecord> {
        let of = |(j, column): (usize, &String)| {
            let own = self.kept.iter().position(|kept| *kept == j).filter(|_| space.kept[j]);
            let values: Option<Vec<f64>> = own.map(|row| self.rows.row(row).iter().copied().collect());
            CoefficientRecord {
                column: column.clone(),
                norm: values.as_deref().map(norm),
                value: values.as_ref().filter(|_| metric.is_none()).map(|values| values[0]),
                shape: values.as_ref().and_then(|values| metric.map(|metric| metric.rows(values))),
            }
        };
        design.columns.iter().enumerate().map(of).collect()
    }

    /// A column that is left out and in which a row differs from those of all shapes, so that they do not determine its fitted vector.
    pub(super) fn undetermined(&self, row: &[f64]) -> Option<usize> {
        let Some(aliases) = &self.aliases else { return self.left_out.first().copied() };
        let kept = self.of_kept(row);
        let length = norm(&kept);
        let is_off = |(own, column): &(usize, usize)| {
            let alias = aliases.column(*own);
            let sum: f64 = kept.iter().zip(alias.iter()).map(|(x, part)| x * part).sum();
            (sum - row[*column]).abs() > DEPENDENT * (alias.norm() * length + row[*column].abs())
        };
        self.left_out.iter().copied().enumerate().find(is_off).map(|(_, column)| column)
    }

    /// Numbers of the kept columns of a row.
    pub(super) fn of_kept(&self, row: &[f64]) -> Vec<f64> {
        self.kept.iter().map(|&j| row[j]).collect()
    }

    /// The fitted vector of a row of the kept columns.
    pub(super) fn values(&self, row: &[f64]) -> Vec<f64> {
        let of = |column: usize| row.iter().zip(self.rows.column(column).iter()).map(|(x, b)| x * b).sum();
        (0..self.rows.ncols()).map(of).collect()
    }

    /// `x_0 (XᵀWX)⁻¹ x_0ᵀ` of a row of the kept columns.
    pub(super) fn leverage(&self, row: &[f64]) -> f64 {
        let row = Matrix::from_column_slice(row.len(), 1, row);
        self.inverse.as_ref().map_or(f64::NAN, |inverse| (inverse * row).norm_squared())
    }
}
