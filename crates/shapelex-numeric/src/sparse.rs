//! Sparse matrices by rows.

/// A sparse matrix: for every row, the columns of its non-zero entries and their values.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SparseRows {
    columns: usize,
    /// End of the entries of every row.
    ends: Vec<usize>,
    entries: Vec<(u32, f64)>,
}

impl SparseRows {
    /// An empty matrix with `columns` columns; `rows` and `entries` are expected numbers, for allocation.
    pub fn new(columns: usize, rows: usize, entries: usize) -> Self {
        Self { columns, ends: Vec::with_capacity(rows), entries: Vec::with_capacity(entries) }
    }

    /// Appends a row. Entries of the same column are added in the given order; columns stay in the order of their first entry.
    pub fn push(&mut self, row: &[(u32, f64)]) {
        let start = self.entries.len();
        for &(column, value) in row {
            debug_assert!((column as usize) < self.columns);
            match self.entries[start..].iter_mut().find(|entry| entry.0 == column) {
                Some(entry) => entry.1 += value,
                None => self.entries.push((column, value)),
            }
        }
        self.ends.push(self.entries.len());
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.ends.len()
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of stored entries.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are no stored entries.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The entries of a row.
    #[inline]
    pub fn row(&self, index: usize) -> &[(u32, f64)] {
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        &self.entries[start..self.ends[index]]
    }

    /// All rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[(u32, f64)]> {
        (0..self.rows()).map(|index| self.row(index))
    }

    /// `A x` for rows `x` of `D` numbers. Cost: `D` products per entry.
    pub fn apply<const D: usize>(&self, x: &[[f64; D]]) -> Vec<[f64; D]> {
        let mut product = Vec::new();
        self.apply_into(x, &mut product);
        product
    }

    /// As [`Self::apply`], written to a vector that can be reused.
    pub fn apply_into<const D: usize>(&self, x: &[[f64; D]], product: &mut Vec<[f64; D]>) {
        product.resize(self.rows(), [0.0; D]);
        // Uses the widest vectors of the machine. Products and sums are not fused, so that the bits are the same on all machines.
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let mut start = 0;
                for (&end, out) in self.ends.iter().zip(product) {
                    let mut sum = [0.0; D];
                    for &(column, value) in &self.entries[start..end] {
                        let x = &x[column as usize];
                        for c in 0..D {
                            sum[c] += value * x[c];
                        }
                    }
                    *out = sum;
                    start = end;
                }
            },
        );
    }

    /// `A x` for a single column.
    pub fn apply_column(&self, x: &[f64]) -> Vec<f64> {
        self.iter().map(|row| row.iter().map(|(column, value)| value * x[*column as usize]).sum()).collect()
    }

    /// `Aᵀ`. Entries of a row are in the order of the rows of `A`.
    pub fn transpose(&self) -> Self {
        let mut ends = vec![0; self.columns];
        self.entries.iter().for_each(|(column, _)| ends[*column as usize] += 1);
        let mut total = 0;
        // The place of the next entry of every row; the end of the row once all are placed.
        for end in &mut ends {
            total += std::mem::replace(end, total);
        }
        let mut entries = vec![(0, 0.0); total];
        for (index, row) in self.iter().enumerate() {
            for &(column, value) in row {
                entries[ends[column as usize]] = (index as u32, value);
                ends[column as usize] += 1;
            }
        }
        Self { columns: self.rows(), ends, entries }
    }

    /// `A B`. Cost: one product per pair of an entry of `A` and an entry in the matching row of `B`.
    pub fn multiply(&self, right: &Self) -> Self {
        let mut product = Self::new(right.columns, self.rows(), 2 * self.len());
        let mut sums = vec![0.0; right.columns];
        let mut met = vec![false; right.columns];
        let mut row_columns: Vec<u32> = Vec::new();
        for row in self.iter() {
            for &(middle, value) in row {
                for &(column, other) in right.row(middle as usize) {
                    if !std::mem::replace(&mut met[column as usize], true) {
                        row_columns.push(column);
                    }
                    sums[column as usize] += value * other;
                }
            }
            row_columns.sort_unstable();
            for column in row_columns.drain(..) {
                met[column as usize] = false;
                product.entries.push((column, std::mem::take(&mut sums[column as usize])));
            }
            product.ends.push(product.entries.len());
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dense(matrix: &SparseRows) -> Vec<Vec<f64>> {
        let row = |entries: &[(u32, f64)]| {
            let mut row = vec![0.0; matrix.columns()];
            entries.iter().for_each(|(column, value)| row[*column as usize] += value);
            row
        };
        matrix.iter().map(row).collect()
    }

    #[test]
    fn products_are_those_of_dense_matrices() {
        let mut a = SparseRows::new(3, 2, 4);
        a.push(&[(2, 1.0), (0, 2.0), (2, 0.5)]);
        a.push(&[(1, -1.0)]);
        assert_eq!(dense(&a), [[2.0, 0.0, 1.5], [0.0, -1.0, 0.0]]);
        let mut b = SparseRows::new(2, 3, 4);
        b.push(&[(1, 1.0)]);
        b.push(&[]);
        b.push(&[(0, 4.0), (1, 2.0)]);
        assert_eq!(dense(&a.multiply(&b)), [[6.0, 5.0], [0.0, 0.0]]);
        assert_eq!((a.rows(), a.len(), b.row(1).len()), (2, 3, 0));
        assert_eq!(a.apply(&[[1.0, 0.0], [0.0, 1.0], [2.0, 2.0]]), [[5.0, 3.0], [0.0, -1.0]]);
        assert_eq!(a.apply_column(&[1.0, 0.0, 2.0]), [5.0, 0.0]);
        let transposed = a.transpose();
        assert_eq!(dense(&transposed), [[2.0, 0.0], [0.0, -1.0], [1.5, 0.0]]);
        assert_eq!((transposed.columns(), dense(&transposed.transpose())), (2, dense(&a)));
        let mut wide = vec![[9.0; 8]];
        a.apply_into(&[[1.0; 8], [2.0; 8], [3.0; 8]], &mut wide);
        assert_eq!(wide, [[6.5; 8], [-2.0; 8]]);
    }
}
