//! Shapes of the groups, given all shapes.
//!
//! ```text
//! Û_i = Γ Z_iᵀV_i⁻¹(Y_i − X_i B̂),   shape x̄_i B̂ + z̄_i Û_i,   cov Û_i = Γ − Γ Z_iᵀV_i⁻¹Z_i Γ
//! ```
//!
//! at the means `x̄_i`, `z̄_i` of the values of the group. The covariance takes `B̂` as known.

use super::super::anova::Model;
use super::super::coefficients::Coefficients;
use super::super::records::CoefficientRecord;
use super::Part;
use super::optimum::Optimum;
use super::records::ConditionalRecord;
use super::sums::GroupSums;
use crate::metric::{Metric, norm};
use shapelex_numeric::dense::Matrix;

/// Estimates in coordinates.
pub struct Estimates {
    /// Change of the coefficients of the basis from least squares, `p × P`.
    pub change: Matrix,
    /// Expected effects of each group, named, `q × P`.
    pub effects: Vec<Matrix>,
    /// Posterior covariance of the effects of each group, named, summed over the coordinates, `q × q`.
    pub posterior: Vec<Matrix>,
}

impl Estimates {
    /// Zeros.
    pub(super) fn none(sums: &GroupSums) -> Self {
        let (q, length, count) = (sums.effects(), sums.squares.len(), sums.zz.len());
        Self {
            change: Matrix::zeros(sums.rank(), length),
            effects: vec![Matrix::zeros(q, length); count],
            posterior: vec![Matrix::zeros(q, q); count],
        }
    }

    /// Fills in the coordinates from `first` on, which share an optimum. `None` beyond the range of numbers.
    pub(super) fn take(&mut self, sums: &GroupSums, first: usize, found: &Optimum) -> Option<()> {
        let count = found.profile.change.ncols();
        self.change.columns_mut(first, count).copy_from(&found.profile.change);
        let inverse = sums.triangle.clone().try_inverse()?;
        let (inner, _) = sums.inner(&found.factor)?;
        for (i, m) in inner.iter().enumerate() {
            // ΓZᵀV⁻¹ = M Zᵀ.
            let left = sums.ze[i].columns(first, count) - &sums.zq[i] * &found.profile.change;
            self.effects[i].columns_mut(first, count).copy_from(&(&inverse * m * left));
            self.posterior[i] += sums.named(&(m * found.profile.variance))?;
        }
        Some(())
    }

    /// The same in the coordinates of shapes, for scores along orthonormal directions.
    pub(super) fn along(self, directions: &Matrix) -> Self {
        let back = directions.transpose();
        let effects = self.effects.iter().map(|effects| effects * &back).collect();
        Self { change: self.change * &back, effects, posterior: self.posterior }
    }
}

/// Shapes of all groups, in their order.
pub(super) fn conditional(
    model: &Model,
    part: &Part,
    coefficients: &Coefficients,
    estimates: &Estimates,
    metric: Option<&Metric>,
) -> Vec<ConditionalRecord> {
    let (design, roots, columns) = (&model.design, model.space.roots(), &part.columns);
    let Coefficients { rows, kept, .. } = coefficients;
    let mut members = vec![Vec::new(); part.count];
    part.groups.iter().enumerate().for_each(|(k, &group)| members[group].push(k));
    let record = |name: &str, values: Vec<f64>| CoefficientRecord {
        column: name.into(),
        norm: Some(norm(&values)),
        value: metric.is_none().then(|| values[0]),
        shape: metric.map(|metric| metric.rows(&values)),
    };
    let of = |group: usize| {
        let members = &members[group];
        let total: f64 = members.iter().map(|&k| model.weights[k]).sum();
        let mean = |value: &dyn Fn(usize) -> f64| {
            members.iter().map(|&k| model.weights[k] / total * value(k)).sum::<f64>()
        };
        let x = Matrix::from_fn(1, kept.len(), |_, j| mean(&|k| design.matrix[(k, kept[j])]));
        let z = Matrix::from_fn(1, columns.ncols(), |_, j| mean(&|k| columns[(k, j)] / roots[k]));
        let values: Vec<f64> = (x * rows + z * &estimates.effects[group]).iter().copied().collect();
        let effects = part.effects.iter().zip(estimates.effects[group].row_iter());
        ConditionalRecord {
            group: design.levels_at(&part.group.0, members[0]),
            shapes: members.len(),
            value: metric.is_none().then(|| values[0]),
            shape: metric.map(|metric| metric.rows(&values)),
            effects: effects.map(|(name, row)| record(name, row.iter().copied().collect())).collect(),
            covariance: super::rows_of(&estimates.posterior[group]),
        }
    };
    (0..estimates.effects.len()).map(of).collect()
}
