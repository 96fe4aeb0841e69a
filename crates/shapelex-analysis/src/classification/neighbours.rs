//! Classification by votes of the nearest training shapes, in the features of the dictionary.
//!
//! ```text
//! score_c = ln((v_c + ½)/(k + C/2))        v_c of the k nearest training shapes are of class c
//! ```
//!
//! Scores of aligned shapes are `L₂` coordinates, so the distance is the one between the aligned shapes, as far as the
//! components describe them. If the size is a feature, it is scaled to the variance of all other features together.
//!
//! Source: Fix and Hodges 1951; Cover and Hart 1967.

use super::observations::{Evidence, Labelled};
use crate::dictionary::model::squared_distance;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// The training shapes, which vote.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestNeighbours {
    /// Number of neighbours that vote.
    pub neighbours: usize,
    /// Features, one training shape per column.
    pub features: Matrix,
    /// Classes of the training shapes.
    pub classes: Vec<usize>,
    /// Number of classes.
    pub count: usize,
    /// Scale factor of the size, if it is a feature (the last one).
    pub size_factor: Option<f64>,
}

impl NearestNeighbours {
    pub(super) fn train(mut features: Matrix, size: bool, sample: Labelled<'_>, neighbours: usize) -> Self {
        let size_factor = size.then(|| {
            let variances = features.row_iter().map(|row| row.variance()).collect::<Vec<f64>>();
            let last = features.nrows() - 1;
            let (shape, size) = (variances[..last].iter().sum::<f64>(), variances[last]);
            if size > 0.0 { (shape / size).sqrt() } else { 0.0 }
        });
        scale_size(&mut features, size_factor);
        Self { neighbours, features, classes: sample.classes.to_vec(), count: sample.count, size_factor }
    }

    /// Evidence from features, one shape per column; distances are to the nearest training shape of a class. Cost `O(K n p)`.
    pub(super) fn evidence(&self, features: &Matrix) -> Vec<Evidence> {
        let mut features = features.clone();
        scale_size(&mut features, self.size_factor);
        parallel::map(features.ncols(), &|k| self.one(features.column(k).as_slice()))
    }

    fn one(&self, z: &[f64]) -> Evidence {
        let squared: Vec<f64> =
            self.features.column_iter().map(|known| squared_distance(known.as_slice(), z)).collect();
        let mut order: Vec<usize> = (0..squared.len()).collect();
        let k = self.neighbours.min(order.len());
        let nearer = |a: &usize, b: &usize| squared[*a].total_cmp(&squared[*b]).then(a.cmp(b));
        if k < order.len() {
            order.select_nth_unstable_by(k, nearer);
        }
        let mut votes = vec![0.0; self.count];
        order[..k].iter().for_each(|&i| votes[self.classes[i]] += 1.0);
        let mut distances = vec![f64::INFINITY; self.count];
        for (&class, squared) in self.classes.iter().zip(&squared) {
            distances[class] = distances[class].min(squared.sqrt());
        }
        let all = k as f64 + 0.5 * self.count as f64;
        Evidence { distances, scores: votes.iter().map(|votes| ((votes + 0.5) / all).ln()).collect() }
    }
}

fn scale_size(features: &mut Matrix, factor: Option<f64>) {
    if let Some(factor) = factor {
        let last = features.nrows() - 1;
        features.row_mut(last).scale_mut(factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classification::Observations;

    #[test]
    fn the_nearest_vote() {
        let observations = Observations { shapes: &[], prepared: &[], codes: &[] };
        let classes = [0, 0, 1, 1, 1];
        let sample = Labelled { observations, weights: &[], classes: &classes, count: 2 };
        let features = Matrix::from_row_slice(1, 5, &[0.0, 1.0, 3.0, 4.0, 9.0]);
        let nearest = NearestNeighbours::train(features, false, sample, 3);
        let found = nearest.evidence(&Matrix::from_row_slice(1, 2, &[0.5, 4.2]));
        assert_eq!(found[0].best(), 0);
        assert_eq!(found[0].distances, [0.5, 2.5]);
        // Two of three votes, with half a vote added to both classes.
        assert!((found[0].scores[0] - (2.5_f64 / 4.0).ln()).abs() < 1e-15);
        assert!((found[0].scores[1] - (1.5_f64 / 4.0).ln()).abs() < 1e-15);
        assert_eq!(found[1].best(), 1);
        // With the size as a feature, scaled to the variance of the others.
        let features = Matrix::from_row_slice(2, 5, &[0.0, 1.0, 3.0, 4.0, 9.0, 0.0, 0.1, 0.3, 0.4, 0.9]);
        let nearest = NearestNeighbours::train(features, true, sample, 1);
        assert!((nearest.size_factor.unwrap() - 10.0).abs() < 1e-12);
    }
}
