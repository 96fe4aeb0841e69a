//! Cholesky factor of a submatrix whose index set grows and shrinks.
//!
//! ```text
//! G_AA = L Lᵀ,   A an ordered set of indices of a symmetric matrix G
//! ```
//!
//! Adding or removing an index costs `O(k²)` for `k` indices. Memory is allocated only when the factor exceeds its
//! previous size.

use super::dense::Matrix;
use super::kernels::{add_scaled, column};

/// Factor of those rows and columns of a symmetric matrix that are in a set of indices.
#[derive(Debug, Clone, Default)]
pub struct ActiveCholesky {
    indices: Vec<usize>,
    /// `L` by rows; row `i` has `i + 1` entries, of which the last one is `1/Lᵢᵢ`.
    rows: Vec<f64>,
}

/// Ratio of a pivot to its diagonal entry below which a column depends on the previous ones.
const INDEPENDENT: f64 = 1e-12;

/// Start of row `i` of a packed triangle.
fn start(i: usize) -> usize {
    i * (i + 1) / 2
}

impl ActiveCholesky {
    /// The indices, in the order of the factor.
    pub fn indices(&self) -> &[usize] {
        &self.indices
    }

    /// Empties the set.
    pub fn clear(&mut self) {
        self.indices.clear();
        self.rows.clear();
    }

    /// Adds an index. Returns whether its column is independent of the previous ones; if not, nothing changes.
    pub fn push(&mut self, gram: &Matrix, index: usize) -> bool {
        let column = column(gram, index);
        self.push_by(|other| column[other], index)
    }

    /// As [`Self::push`], for a matrix given by `entry(other)`, the entry in row `other` of the column of `index`.
    pub fn push_by(&mut self, entry: impl Fn(usize) -> f64, index: usize) -> bool {
        let packed = self.rows.len();
        self.rows.extend(self.indices.iter().map(|&other| entry(other)));
        let (known, row) = self.rows.split_at_mut(packed);
        solve_lower(known, row);
        let diagonal = entry(index);
        let pivot = diagonal - row.iter().map(|value| value * value).sum::<f64>();
        if !(pivot > INDEPENDENT * diagonal) {
            self.rows.truncate(packed);
            return false;
        }
        self.rows.push(1.0 / pivot.sqrt());
        self.indices.push(index);
        true
    }

    /// Adds an index whose row of `L` is known: its `head`, and the square of its last entry.
    pub fn push_row(&mut self, head: impl Iterator<Item = f64>, pivot: f64, index: usize) {
        self.rows.extend(head);
        self.rows.push(1.0 / pivot.sqrt());
        self.indices.push(index);
    }

    /// Removes the index at `position`: the rows behind it lose a column by rotations.
    pub fn remove(&mut self, position: usize) {
        self.indices.remove(position);
        let kept = self.indices.len();
        // Row `i + 1` becomes row `i` of the new factor.
        for turned in position..kept {
            let head = start(turned + 1) + turned;
            let (a, b) = (self.rows[head], 1.0 / self.rows[head + 1]);
            let length = a.hypot(b);
            let (cosine, sine) = (a / length, b / length);
            self.rows[head] = 1.0 / length;
            for row in turned + 1..kept {
                let at = start(row + 1) + turned;
                let (x, y) = (self.rows[at], self.rows[at + 1]);
                self.rows[at] = cosine * x + sine * y;
                self.rows[at + 1] = cosine * y - sine * x;
            }
        }
        for row in position..kept {
            let from = start(row + 1);
            self.rows.copy_within(from..from + row + 1, start(row));
        }
        self.rows.truncate(start(kept));
    }

    /// `x ← G_AA⁻¹ x`.
    pub fn solve(&self, x: &mut [f64]) {
        self.solve_lower(x);
        self.solve_upper(x);
    }

    /// `x ← L⁻¹ x`. The solution for the first indices is a prefix of the solution for all.
    pub fn solve_lower(&self, x: &mut [f64]) {
        solve_lower(&self.rows, x);
    }

    /// The last entry of `L⁻¹y`, from the entries before it and the last entry of `y`.
    pub fn last_of_lower(&self, before: &[f64], last: f64) -> f64 {
        let row = &self.rows[start(before.len())..];
        (last - product(row, before)) * row[before.len()]
    }

    /// `x ← L⁻ᵀ x`.
    pub fn solve_upper(&self, x: &mut [f64]) {
        for i in (0..x.len()).rev() {
            let row = &self.rows[start(i)..start(i + 1)];
            x[i] *= row[i];
            let head = x[i];
            add_scaled(&mut x[..i], -head, &row[..i]);
        }
    }
}

/// `x ← L⁻¹ x`, with the first rows of the packed `L`.
fn solve_lower(rows: &[f64], x: &mut [f64]) {
    for i in 0..x.len() {
        let row = &rows[start(i)..start(i + 1)];
        x[i] = (x[i] - product(row, &x[..i])) * row[i];
    }
}

/// Product of the head of a row with `x`, in two partial sums, because rows are short.
fn product(row: &[f64], x: &[f64]) -> f64 {
    let pairs = row.chunks_exact(2).zip(x.chunks_exact(2));
    let (even, odd) = pairs.fold((0.0, 0.0), |(even, odd), (l, v)| (even + l[0] * v[0], odd + l[1] * v[1]));
    let last = x.len() - x.len() % 2;
    even + odd + x[last..].iter().zip(&row[last..]).map(|(v, l)| v * l).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_follow_the_set() {
        let a = Matrix::from_fn(9, 6, |i, j| ((i * 7 + j * 5 + i * j) as f64).sin());
        let gram = a.tr_mul(&a);
        for position in 0..5 {
            let mut factor = ActiveCholesky::default();
            for index in [4, 1, 5, 0, 3] {
                assert!(factor.push(&gram, index));
            }
            let mut same = ActiveCholesky::default();
            for (k, &index) in factor.indices().iter().enumerate() {
                let row = &factor.rows[start(k)..start(k + 1)];
                same.push_row(row[..k].iter().copied(), row[k].powi(-2), index);
            }
            assert_eq!(same.indices, factor.indices);
            assert!(same.rows.iter().zip(&factor.rows).all(|(a, b)| (a - b).abs() < 1e-12));
            factor.remove(position);
            assert_eq!(factor.indices().len(), 4);
            assert!(factor.push(&gram, 2));
            let right = [1.0, -2.0, 0.5, 0.25, 3.0];
            let (mut x, mut half) = (right, right);
            factor.solve(&mut x);
            factor.solve_lower(&mut half);
            assert_eq!(factor.last_of_lower(&half[..4], right[4]), half[4]);
            for (i, &row) in factor.indices().iter().enumerate() {
                let product: f64 = factor.indices().iter().zip(&x).map(|(&c, v)| gram[(row, c)] * v).sum();
                assert!((product - right[i]).abs() < 1e-11, "{product} for {}", right[i]);
            }
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
