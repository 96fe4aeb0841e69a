//! Sums over the groups of a random part, from which all estimates are made, and the likelihood as a function of one factor.
//!
//! With an orthonormal basis `Q` of the fixed part and the residuals `E = Y − QQᵀY`, no digits are lost to fitted values:
//!
//! ```text
//! V = I + Z L Lᵀ Zᵀ,   V⁻¹ = I − Z M Zᵀ,   M_i = L (I + Lᵀ Z_iᵀZ_i L)⁻¹ Lᵀ
//! δ = (QᵀV⁻¹Q)⁻¹ QᵀV⁻¹E,   s = tr (E − Qδ)ᵀ V⁻¹ (E − Qδ)
//! ℓ = −½ [νP log(s/νP) + P log|V| + P log|XᵀV⁻¹X|],   ν = n − p
//! ```
//!
//! The last term is absent, and `ν = n`, for ordinary likelihood. Sources: Laird and Ware 1982; Harville 1977.

use std::ops::Range;

use super::super::anova::Model;
use super::super::error::ModelError;
use super::super::subspaces::orthonormal;
use super::Criterion;
use shapelex_numeric::dense::{self, Matrix};

/// Sums over the shapes of each group; rows are scaled by the roots of the weights.
#[derive(Debug, Clone)]
pub struct GroupSums {
    /// Number of shapes `n`.
    pub shapes: usize,
    /// `Z_iᵀZ_i`, `q × q`.
    pub zz: Vec<Matrix>,
    /// `Z_iᵀQ_i`, `q × p`.
    pub zq: Vec<Matrix>,
    /// `Z_iᵀE_i`, `q × P`.
    pub ze: Vec<Matrix>,
    /// `EᵀE` of each coordinate.
    pub squares: Vec<f64>,
    /// Triangle `R` of the columns as they are named: `Z_named = Z R`. `Z` has the columns that scatter most alike.
    pub triangle: Matrix,
    /// `log|XᵀX|` of the kept columns of the fixed part.
    pub log_design: f64,
    /// `Σ log w`.
    pub log_weights: f64,
}

/// The likelihood at one factor.
#[derive(Debug, Clone)]
pub struct Profile {
    /// `ℓ`, without constants.
    pub value: f64,
    /// Derivative of `ℓ` by `LLᵀ`, symmetric.
    pub slope: Matrix,
    /// `s/ν`: variance of a residual, summed over the coordinates.
    pub variance: f64,
    /// `δ`, `p × P`.
    pub change: Matrix,
}

impl GroupSums {
    /// Sums of residuals in columns, `P × n`, over the groups of a random part with named columns `z`, `n × q`; both are scaled by the
    /// roots of the weights.
    ///
    /// # Errors
    /// [`ModelError::Unidentified`] for columns that depend on each other.
    pub fn new(
        model: &Model,
        residuals: &Matrix,
        z: &Matrix,
        groups: &[usize],
        has_intercept: bool,
    ) -> Result<Self, ModelError> {
        let (shapes, count) = (groups.len(), groups.iter().max().map_or(0, |last| last + 1));
        let (basis, kept) = orthonormal(&Matrix::zeros(shapes, 0), z, has_intercept);
        if kept.iter().any(|kept| !kept) {
            let detail = "expected effects of a random part that are linearly independent, got some that depend on others";
            return Err(ModelError::Unidentified { detail: detail.into() });
        }
        let root = (shapes as f64).sqrt();
        let triangle = dense::transpose_multiply(&basis, z) / root;
        let (q, p, length) = (basis.ncols(), model.space.rank(), residuals.nrows());
        let mut zz = vec![Matrix::zeros(q, q); count];
        let mut zq = vec![Matrix::zeros(q, p); count];
        let mut ze = vec![Matrix::zeros(q, length); count];
        for (k, &group) in groups.iter().enumerate() {
            for a in 0..q {
                let own = root * basis[(k, a)];
                (0..q).for_each(|b| zz[group][(a, b)] += own * root * basis[(k, b)]);
                (0..p).for_each(|b| zq[group][(a, b)] += own * model.space.basis[(k, b)]);
                let mut row = ze[group].row_mut(a);
                row.iter_mut().zip(residuals.column(k).iter()).for_each(|(sum, value)| *sum += own * value);
            }
        }
        let squares = residuals.row_iter().map(|row| row.norm_squared()).collect();
        let log_design = 2.0 * model.space.log_determinant();
        let log_weights = model.weights().iter().map(|weight| weight.ln()).sum();
        Ok(Self { shapes, zz, zq, ze, squares, triangle, log_design, log_weights })
    }

    /// Number of effects of a group, `q`.
    pub fn effects(&self) -> usize {
        self.triangle.nrows()
    }

    /// Rank of the fixed part, `p`.
    pub fn rank(&self) -> usize {
        self.zq.first().map_or(0, Matrix::ncols)
    }

    /// `ν`.
    pub fn degrees(&self, criterion: Criterion) -> f64 {
        match criterion {
            Criterion::Reml => (self.shapes - self.rank()) as f64,
            Criterion::Ml => self.shapes as f64,
        }
    }

    /// `M_i` of each group, and `log|V|`; `None` beyond the range of numbers.
    pub fn inner(&self, factor: &Matrix) -> Option<(Vec<Matrix>, f64)> {
        let (mut inner, mut log_determinant) = (Vec::with_capacity(self.zz.len()), 0.0);
        let (transposed, unit) = (factor.transpose(), Matrix::identity(self.effects(), self.effects()));
        for zz in &self.zz {
            let cholesky = (&unit + &transposed * zz * factor).cholesky()?;
            log_determinant +=
                2.0 * cholesky.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>();
            inner.push(factor * cholesky.solve(&transposed));
        }
        Some((inner, log_determinant))
    }

    /// The likelihood of some coordinates that share the factor `L`, `q × q`. `None` beyond the range of numbers.
    ///
    /// Cost: `q² (p + P)` multiply-adds a group.
    pub fn profile(
        &self,
        factor: &Matrix,
        coordinates: Range<usize>,
        criterion: Criterion,
    ) -> Option<Profile> {
        let (p, count) = (self.rank(), coordinates.len());
        let of = |ze: &Matrix| ze.columns(coordinates.start, count).into_owned();
        let (inner, log_determinant) = self.inner(factor)?;
        let (mut inside, mut along) = (Matrix::identity(p, p), Matrix::zeros(p, count));
        let mut sum: f64 = self.squares[coordinates.clone()].iter().sum();
        for (i, m) in inner.iter().enumerate() {
            let ze = of(&self.ze[i]);
            let (zq_m, m_ze) = (self.zq[i].transpose() * m, m * &ze);
            inside -= &zq_m * &self.zq[i];
            along -= zq_m * &ze;
            sum -= ze.dot(&m_ze);
        }
        let cholesky = inside.cholesky()?;
        let inverse = cholesky.inverse();
        let change = &inverse * &along;
        sum -= change.dot(&along);
        let log_inside = 2.0 * cholesky.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>();
        let (degrees, copies) = (self.degrees(criterion), count as f64);
        let is_restricted = criterion == Criterion::Reml;
        let mut slope = Matrix::zeros(self.effects(), self.effects());
        for (i, m) in inner.iter().enumerate() {
            let left = Matrix::identity(self.effects(), self.effects()) - &self.zz[i] * m;
            let zvq = &left * &self.zq[i];
            let u = &left * of(&self.ze[i]) - &zvq * &change;
            slope -= (&left * &self.zz[i]) * copies;
            if is_restricted {
                slope += (&zvq * &inverse * zvq.transpose()) * copies;
            }
            slope += (&u * u.transpose()) * (degrees * copies / sum);
        }
        let restricted = if is_restricted { log_inside + self.log_design } else { 0.0 };
        let value =
            -0.5 * copies * (degrees * (sum / (degrees * copies)).ln() + log_determinant + restricted);
        let variance = sum / degrees;
        (value.is_finite() && sum > 0.0).then(|| Profile { value, slope: slope * 0.5, variance, change })
    }

    /// Covariance of the named effects, given that of the effects of `Z`.
    pub fn named(&self, covariance: &Matrix) -> Option<Matrix> {
        let inverse = self.triangle.clone().try_inverse()?;
        Some(&inverse * covariance * inverse.transpose())
    }
}
