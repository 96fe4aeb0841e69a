//! The matrix of all distances of a set of shapes.

use rayon::prelude::*;

use super::prepared::{Columns, PreparedShapes};
use super::products::{Score, Term, rotation_score};
use super::spectra::Work;
use super::{DistanceSpace, TILE};
use crate::AnalysisError;
use shapelex_numeric::dense::{Matrix, transpose_multiply_columns};

/// Approximate number of columns per side of a matrix product: enough for its kernels, few enough for the cache.
pub(super) const TILE_COLUMNS: usize = 256;

impl DistanceSpace {
    /// The symmetric matrix of all distances, row by row: `K²` numbers with zeros on the diagonal.
    ///
    /// `go_on` receives the fraction that is done and returns whether to continue; it is called between tiles, from any thread.
    /// Each pair is computed once, in tiles that do not depend on the number of threads, and neither do the bits.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `go_on` returns false.
    pub fn matrix(
        &self,
        shapes: &PreparedShapes,
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Result<Vec<f64>, AnalysisError> {
        let count = shapes.count();
        let mut matrix = vec![0.0; count * count];
        let tile = self.tile();
        let (done, tiles) = (std::sync::atomic::AtomicUsize::new(0), count.div_ceil(tile));
        let all = (tiles * (tiles + 1) / 2).max(1);
        matrix.par_chunks_mut(tile * count.max(1)).enumerate().try_for_each_init(
            || self.work(),
            |work, (band, rows)| {
                for column in band..tiles {
                    let before = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if !go_on(before as f64 / all as f64) {
                        return Err(AnalysisError::Interrupted);
                    }
                    let side = |k: usize| k * tile..((k + 1) * tile).min(count);
                    self.fill_tile(shapes, side(band), side(column), rows, work);
                }
                Ok(())
            },
        )?;
        mirror_upper(&mut matrix, count);
        Ok(matrix)
    }

    pub(super) fn tile(&self) -> usize {
        match self.transform {
            Some(_) => TILE,
            None => (TILE_COLUMNS / self.columns).max(1),
        }
    }

    /// Writes the distances of one tile above the diagonal into the `rows` of its band.
    pub(super) fn fill_tile(
        &self,
        shapes: &PreparedShapes,
        left: std::ops::Range<usize>,
        right: std::ops::Range<usize>,
        rows: &mut [f64],
        work: &mut Work,
    ) {
        let (count, sizes) = (shapes.count(), &shapes.sizes);
        let products = shapes.laid.iter().map(|laid| match (&shapes.laid[0], laid) {
            (Columns::Signals(first), Columns::Signals(second)) => {
                let length = self.size * self.columns;
                let side = |all: &[f64], range: &std::ops::Range<usize>| {
                    all[range.start * length..range.end * length].to_vec()
                };
                let first = Matrix::from_vec(self.size, self.columns * left.len(), side(first, &left));
                Some(transpose_multiply_columns(&first, &side(second, &right)))
            }
            _ => None,
        });
        let products: Option<Vec<Matrix>> = products.collect();
        for i in left.clone() {
            for j in right.clone().filter(|&j| j > i) {
                let score = match &products {
                    Some(products) => {
                        let of = |product| self.score_in(product, i - left.start, j - right.start);
                        products.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
                    }
                    None => self.largest_score(shapes, i, j, work),
                };
                let distance = self.distance(score, sizes[i], sizes[j]);
                rows[(i - left.start) * count + j] = match self.is_close(distance, sizes[i], sizes[j]) {
                    true => self.closer(shapes, i, shapes, j, work).distance,
                    false => distance,
                };
            }
        }
    }

    /// The score of shapes `i` and `j` of two tiles, from the products of all their columns.
    pub(super) fn score_in(&self, products: &Matrix, i: usize, j: usize) -> f64 {
        let (row, column) = (i * self.columns, j * self.columns);
        let product = |terms: &Vec<Term>| -> f64 {
            terms.iter().map(|t| t.sign * products[(row + t.left, column + t.right)]).sum()
        };
        self.score_of(self.products.iter().map(product))
    }

    pub(super) fn score_of(&self, mut products: impl Iterator<Item = f64>) -> f64 {
        match self.score {
            Score::Squares => products.map(|p| p * p).sum(),
            Score::Single => products.next().unwrap_or_default(),
            Score::Rotation => rotation_score(&products.collect::<Vec<f64>>()),
        }
    }
}

/// Copies the upper triangle to the lower one, tile by tile.
pub(super) fn mirror_upper(matrix: &mut [f64], count: usize) {
    for row in (0..count).step_by(TILE) {
        for column in (0..=row).step_by(TILE) {
            for i in row..(row + TILE).min(count) {
                for j in column..(column + TILE).min(i) {
                    matrix[i * count + j] = matrix[j * count + i];
                }
            }
        }
    }
}
