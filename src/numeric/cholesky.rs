//! The Cholesky factor of a matrix that grows and shrinks by rows.
//!
//! ```text
//! G_AA = L Lᵀ,   A an ordered set of indices of a symmetric matrix G
//! ```
//!
//! Adding an index costs `O(k²)` for `k` indices, removing one `O(k²)` for each that follows it.

use super::dense::Matrix;

/// The factor of the rows and columns of a symmetric matrix that are in a set.
#[derive(Debug, Clone, Default)]
pub struct ActiveCholesky {
    indices: Vec<usize>,
    /// Row `i` of `L` has `i + 1` entries.
    rows: Vec<Vec<f64>>,
}

/// A pivot below this part of the diagonal entry is rounding: the column depends on those before.
const INDEPENDENT: f64 = 1e-12;

impl ActiveCholesky {
    /// The set, in the order of the factor.
    pub fn indices(&self) -> &[usize] {
        &self.indices
    }

    /// Adds an index; whether its column is independent of those before (else nothing changes).
    pub fn push(&mut self, gram: &Matrix, index: usize) -> bool {
        let mut row: Vec<f64> = self.indices.iter().map(|&other| gram[(other, index)]).collect();
        self.solve_lower(&mut row);
        let diagonal = gram[(index, index)];
        let pivot = diagonal - row.iter().map(|value| value * value).sum::<f64>();
        if !(pivot > INDEPENDENT * diagonal) {
            return false;
        }
        row.push(pivot.sqrt());
        self.rows.push(row);
        self.indices.push(index);
        true
    }

    /// Removes the index at `position`.
    pub fn remove(&mut self, gram: &Matrix, position: usize) {
        let after = self.indices.split_off(position + 1);
        self.indices.pop();
        self.rows.truncate(position);
        for index in after {
            // What was independent of more is independent of less; rounding at the border is dropped.
            self.push(gram, index);
        }
    }

    /// `x ← L⁻¹ x`.
    fn solve_lower(&self, x: &mut [f64]) {
        for i in 0..x.len() {
            let row = &self.rows[i];
            let known: f64 = row[..i].iter().zip(&x[..i]).map(|(l, v)| l * v).sum();
            x[i] = (x[i] - known) / row[i];
        }
    }

    /// `x ← G_AA⁻¹ x`.
    pub fn solve(&self, x: &mut [f64]) {
        self.solve_lower(x);
        for i in (0..x.len()).rev() {
            x[i] /= self.rows[i][i];
            let head = x[i];
            for (value, l) in x[..i].iter_mut().zip(&self.rows[i][..i]) {
                *value -= l * head;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_follow_the_set() {
        let a = Matrix::from_fn(9, 6, |i, j| ((i * 7 + j * 5 + i * j) as f64).sin());
        let gram = a.tr_mul(&a);
        let mut factor = ActiveCholesky::default();
        for index in [4, 1, 5, 0] {
            assert!(factor.push(&gram, index));
        }
        factor.remove(&gram, 1);
        assert_eq!(factor.indices(), [4, 5, 0]);
        let right = [1.0, -2.0, 0.5];
        let mut x = right;
        factor.solve(&mut x);
        for (i, &row) in factor.indices().iter().enumerate() {
            let product: f64 = factor.indices().iter().zip(&x).map(|(&c, v)| gram[(row, c)] * v).sum();
            assert!((product - right[i]).abs() < 1e-12, "{product} for {}", right[i]);
        }
    }

    #[test]
    fn dependent_columns_are_refused() {
        let a = Matrix::from_row_slice(3, 3, &[1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 2.0]);
        let gram = a.tr_mul(&a);
        let mut factor = ActiveCholesky::default();
        assert!(factor.push(&gram, 0) && factor.push(&gram, 1));
        assert!(!factor.push(&gram, 2));
        assert_eq!(factor.indices(), [0, 1]);
    }
}
