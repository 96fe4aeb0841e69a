//! Subspaces of a design: an orthonormal basis of its columns, and for each term the pair of models that tests it.
//!
//! ```text
//! X = Q C        Q orthonormal, the intercept first; C = QᵀX
//! term j: reduced model span Q B_r, own directions Q B_j ⟂ Q B_r, df_j = rank B_j
//! ```
//!
//! | type | reduced model of `j` | full model of `j` |
//! |---|---|---|
//! | I, sequential | terms before `j` | and `j` |
//! | II, hierarchical | all terms that do not contain `j`, without `j` | and `j` |
//! | III, marginal | all columns but those of `j` | all columns |
//!
//! All pairs live in the coordinates `C`, which have as many rows as the design has independent columns.

use super::design::{Contrasts, Design};
use super::error::ModelError;
use shapelex_numeric::dense::{self, Matrix};

/// Part of its length that a column keeps beside those before it, unless it depends on them.
const DEPENDENT: f64 = 1e-7;

/// Type of the sums of squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum SumType {
    /// Sequential: each term after those before it.
    I,
    /// Hierarchical: each term after all that do not contain it.
    #[default]
    II,
    /// Marginal: each term after all others.
    III,
}

/// The space of a design.
#[derive(Debug, Clone)]
pub struct Space {
    /// `Q`: orthonormal columns, one row for each shape, scaled by the root of its weight.
    pub basis: Matrix,
    /// `C = QᵀX` of all columns.
    pub coordinates: Matrix,
    /// Whether each column is kept; the others depend on those before them.
    pub kept: Vec<bool>,
    roots: Vec<f64>,
    /// Factor of the covariance of the shapes.
    lower: Option<Matrix>,
}

/// A term with the models that test it, in the coordinates of the basis.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// Position of the term.
    pub term: usize,
    /// `B_r`: orthonormal columns that span the reduced model.
    pub reduced: Matrix,
    /// `B_j`: orthonormal columns that the term adds.
    pub own: Matrix,
}

impl Space {
    /// The space of a design whose shapes have these weights.
    ///
    /// # Errors
    /// [`ModelError::FewShapes`] if no degree of freedom is left for the residuals.
    pub fn new(design: &Design, weights: &[f64]) -> Result<Self, ModelError> {
        Self::correlated(design, weights, None)
    }

    /// As [`Self::new`], for shapes whose covariance has this factor: rows are those of `L⁻¹X`.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn correlated(design: &Design, weights: &[f64], lower: Option<Matrix>) -> Result<Self, ModelError> {
        let space = Self::of_rows(design, weights, lower);
        space.check_shapes(design.shapes())?;
        Ok(space)
    }

    /// The space of rows with these weights, each that of one or more shapes.
    pub(super) fn of_rows(design: &Design, weights: &[f64], lower: Option<Matrix>) -> Self {
        let roots: Vec<f64> = weights.iter().map(|weight| weight.sqrt()).collect();
        let scaled = scaled(design, &roots, lower.as_ref());
        let (basis, kept) =
            orthonormal(&Matrix::zeros(design.shapes(), 0), &scaled, design.formula.intercept);
        let coordinates = dense::transpose_multiply(&basis, &scaled);
        Self { basis, coordinates, kept, roots, lower }
    }

    /// Checks that shapes leave the residuals a degree of freedom.
    ///
    /// # Errors
    /// [`ModelError::FewShapes`].
    pub(super) fn check_shapes(&self, found: usize) -> Result<(), ModelError> {
        let rank = self.rank();
        if found > rank { Ok(()) } else { Err(ModelError::FewShapes { found, needed: rank + 1, rank }) }
    }

    /// Rank of the design.
    pub fn rank(&self) -> usize {
        self.basis.ncols()
    }

    /// Root of the weight of each shape.
    pub fn roots(&self) -> &[f64] {
        &self.roots
    }

    /// Whether shapes have a covariance.
    pub fn is_correlated(&self) -> bool {
        self.lower.is_some()
    }

    /// Scales vectors of the shapes, in columns, as the basis is.
    pub fn scale(&self, vectors: &mut Matrix) {
        for (mut column, root) in vectors.column_iter_mut().zip(&self.roots) {
            column.scale_mut(*root);
        }
        if let Some(lower) = &self.lower {
            let mut transposed = vectors.transpose();
            lower.solve_lower_triangular_mut(&mut transposed);
            *vectors = transposed.transpose();
        }
    }

    /// Scaled vectors about their mean, which are centred already unless shapes have a covariance: the mean is then the part along the
    /// first vector of the basis.
    pub(super) fn about_mean(&self, scaled: Matrix, has_intercept: bool) -> Matrix {
        if !(has_intercept && self.is_correlated()) {
            return scaled;
        }
        let first = self.basis.columns(0, 1);
        &scaled - (&scaled * first) * first.transpose()
    }

    /// Leverage of each shape: the part of its residual that the model takes.
    pub fn leverages(&self) -> Vec<f64> {
        self.basis.row_iter().map(|row| row.norm_squared()).collect()
    }

    /// `log|det C|` of the kept columns: `C` is their triangle in the basis.
    pub fn log_determinant(&self) -> f64 {
        let kept = columns_where_index(&self.coordinates, |j| self.kept[j]);
        kept.lu().determinant().abs().ln()
    }

    /// Residuals of vectors in columns, scaled as the basis is.
    pub fn residuals(&self, scaled: &Matrix) -> Matrix {
        let fitted = dense::multiply(scaled, &self.basis);
        scaled - dense::multiply(&fitted, &self.basis.transpose())
    }

    /// Coordinates of the columns of another design of the same space.
    fn coordinates_of(&self, design: &Design) -> Matrix {
        dense::transpose_multiply(&self.basis, &scaled(design, &self.roots, self.lower.as_ref()))
    }

    /// The hypotheses of all terms.
    ///
    /// # Errors
    /// Type III of a design whose columns depend on each other.
    pub fn hypotheses(
        &self,
        design: &Design,
        kind: SumType,
        of_type_three: Contrasts,
    ) -> Result<Vec<Hypothesis>, ModelError> {
        let terms = &design.formula.terms;
        if kind == SumType::III {
            self.check_independent(design)?;
        }
        let coded = match kind {
            SumType::III if of_type_three != design.contrasts => {
                self.coordinates_of(&design.with_contrasts(of_type_three))
            }
            _ => self.coordinates.clone(),
        };
        let of = |j: usize| {
            let in_reduced = |owner: usize| match (owner, kind) {
                (0, _) => true,
                (owner, SumType::I) => owner <= j,
                (owner, SumType::II) => owner != j + 1 && !terms[owner - 1].contains(&terms[j]),
                (owner, SumType::III) => owner != j + 1,
            };
            let reduced = self.span_of(&coded, design, in_reduced);
            let own = columns_where(&coded, &design.term_of_column, |owner| owner == j + 1);
            let (own, _) = orthonormal(&reduced, &own, design.formula.intercept);
            Hypothesis { term: j, reduced, own }
        };
        Ok((0..terms.len()).map(of).collect())
    }

    fn span_of(&self, coded: &Matrix, design: &Design, wanted: impl Fn(usize) -> bool) -> Matrix {
        let columns = columns_where(coded, &design.term_of_column, wanted);
        orthonormal(&Matrix::zeros(self.rank(), 0), &columns, design.formula.intercept).0
    }

    fn check_independent(&self, design: &Design) -> Result<(), ModelError> {
        let dropped = self.dropped(design);
        if dropped.is_empty() { Ok(()) } else { Err(ModelError::EmptyCells { columns: dropped.join(", ") }) }
    }

    /// Names of the columns that depend on those before them.
    pub fn dropped(&self, design: &Design) -> Vec<String> {
        let all = design.columns.iter().zip(&self.kept);
        all.filter(|(_, kept)| !**kept).map(|(name, _)| name.clone()).collect()
    }

    /// Columns that the first column of a term without directions of its own is a combination of.
    pub fn aliases(&self, design: &Design, term: usize) -> Vec<String> {
        let Some(first) = design.term_of_column.iter().position(|owner| *owner == term + 1) else {
            return Vec::new();
        };
        let wanted = self.coordinates.column(first).into_owned();
        let Some(coefficients) = self.solve(&Matrix::from_column_slice(wanted.len(), 1, wanted.as_slice()))
        else {
            return Vec::new();
        };
        let largest = coefficients.iter().map(|c| c.abs()).fold(0.0, f64::max);
        let kept = (0..self.kept.len()).filter(|j| self.kept[*j]);
        kept.zip(coefficients.iter())
            .filter(|(j, c)| *j != first && c.abs() > DEPENDENT * largest)
            .map(|(j, _)| design.columns[j].clone())
            .collect()
    }

    /// Coefficients of the kept columns for coordinates in the basis: `C⁻¹ U`.
    pub fn solve(&self, coordinates: &Matrix) -> Option<Matrix> {
        let kept = columns_where_index(&self.coordinates, |j| self.kept[j]);
        kept.lu().solve(coordinates)
    }
}

/// Columns of a design, scaled by the roots of the weights, and without the covariance of the shapes.
pub(super) fn scaled(design: &Design, roots: &[f64], lower: Option<&Matrix>) -> Matrix {
    let mut scaled = design.matrix.clone();
    for mut column in scaled.column_iter_mut() {
        column.iter_mut().zip(roots).for_each(|(value, root)| *value *= root);
    }
    if let Some(lower) = lower {
        lower.solve_lower_triangular_mut(&mut scaled);
    }
    scaled
}

fn columns_where(matrix: &Matrix, owners: &[usize], wanted: impl Fn(usize) -> bool) -> Matrix {
    columns_where_index(matrix, |j| wanted(owners[j]))
}

fn columns_where_index(matrix: &Matrix, wanted: impl Fn(usize) -> bool) -> Matrix {
    let chosen: Vec<usize> = (0..matrix.ncols()).filter(|j| wanted(*j)).collect();
    Matrix::from_fn(matrix.nrows(), chosen.len(), |i, j| matrix[(i, chosen[j])])
}

/// Orthonormal columns that span what `columns` add to the orthonormal `before`, in order, and whether each column adds a direction.
/// With an intercept in the first column of all, lengths are those about the mean: years near 2000 are not collinear.
pub(super) fn orthonormal(before: &Matrix, columns: &Matrix, has_intercept: bool) -> (Matrix, Vec<bool>) {
    let rows = columns.nrows();
    let mut basis: Vec<Vec<f64>> =
        before.column_iter().map(|column| column.iter().copied().collect()).collect();
    let first = basis.len();
    let mut kept = Vec::with_capacity(columns.ncols());
    for column in columns.column_iter() {
        let mut own: Vec<f64> = column.iter().copied().collect();
        let mut whole = norm(&own);
        if let Some(q) = basis.first().filter(|_| has_intercept && whole > 0.0) {
            let along = product(&own, q);
            let about: Vec<f64> = own.iter().zip(q).map(|(value, q)| value - along * q).collect();
            // A column without variation keeps its length, against which the rest is nothing.
            let length = norm(&about);
            if length > 1e-12 * whole {
                (own, whole) = (about, length);
            }
        }
        // Two rounds of Gram–Schmidt suffice.
        for _ in 0..2 {
            for q in &basis {
                let along = product(&own, q);
                own.iter_mut().zip(q).for_each(|(value, q)| *value -= along * q);
            }
        }
        let length = norm(&own);
        let adds = length > DEPENDENT * whole && basis.len() < rows;
        if adds {
            own.iter_mut().for_each(|value| *value /= length);
            basis.push(own);
        }
        kept.push(adds);
    }
    let found = basis.split_off(first);
    (Matrix::from_vec(rows, found.len(), found.concat()), kept)
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    product(a, a).sqrt()
}
