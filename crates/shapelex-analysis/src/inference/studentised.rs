//! Distance of two groups that may scatter unequally: a studentised statistic, tested by random signs.
//!
//! ```text
//! T = ‖ȳ_1 − ȳ_0‖²/(V_0 + V_1),   ȳ_g = Σ p y,   V_g = n_g/(n_g − 1) Σ p² ‖y − ȳ_g‖²,   p = w/W_g
//! r_k = y_k − μ,   μ = (V_1 ȳ_0 + V_0 ȳ_1)/(V_0 + V_1)              deviations from the common mean
//! T* : the statistic of ε_k r_k,   ε_k = 1 or −1 with equal probability
//! ```
//!
//! Labels can be exchanged only if the groups scatter alike. The sign of a deviation from the common mean can be exchanged whatever
//! the scatter of its group: the test keeps its level, nearly, for groups of unequal size and unequal scatter.
//!
//! Sources: Welch 1947 (the statistic of one coordinate); Wu 1986 and Liu 1988 (wild bootstrap); Davidson and Flachaire 2008 (random
//! signs, with the null hypothesis imposed).

use super::super::AnalysisError;
use super::comparison::{Sample, Tested};
use super::permutation::Tally;
use super::reaches;
use crate::random::stream;
use crate::watch::Watch;
use rand::RngExt;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Number of draws per product.
const COLUMNS: usize = 64;

/// First random stream of signs; those below are of relabellings.
const STREAMS: usize = 1 << 40;

/// `V_0 + V_1` below which scatter is rounding, as a fraction of `Σ p² ‖y‖²` of both groups.
const NO_SCATTER: f64 = 1e-12;

/// The shapes of a group.
struct Side {
    /// Coordinates, one column per shape.
    rows: Matrix,
    /// `p`, weights of sum one.
    parts: Vec<f64>,
}

/// Means of a group, one column per draw, and the variance `V` of each.
struct Moments {
    means: Matrix,
    variances: Vec<f64>,
    /// `Σ p² ‖y‖²`.
    squares: f64,
}

impl Side {
    fn new(sample: &Sample, labels: &[usize], group: usize) -> Self {
        let members: Vec<usize> = (0..labels.len()).filter(|&k| labels[k] == group).collect();
        let total: f64 = members.iter().map(|&k| sample.weights[k]).sum();
        Self {
            rows: sample.coordinates.select_columns(&members),
            parts: members.iter().map(|&k| sample.weights[k] / total).collect(),
        }
    }

    /// Moments of the shapes times `signs`, a row per shape and a column per draw.
    fn moments(&self, signs: &Matrix) -> Moments {
        let n = self.parts.len() as f64;
        let weighted = |power: i32| {
            let mut signs = signs.clone();
            signs.row_iter_mut().zip(&self.parts).for_each(|(mut row, part)| row *= part.powi(power));
            dense::multiply(&self.rows, &signs)
        };
        let means = weighted(1);
        // Of equal weights one product is a multiple of the other.
        let equal = self.parts.iter().all(|part| *part == self.parts[0]);
        let crossed = if equal { &means * self.parts[0] } else { weighted(2) };
        let squares = |k: usize| self.parts[k].powi(2) * self.rows.column(k).norm_squared();
        let squares: f64 = (0..self.parts.len()).map(squares).sum();
        let parts: f64 = self.parts.iter().map(|p| p * p).sum();
        let variance = |b: usize| {
            let (mean, crossed) = (means.column(b), crossed.column(b));
            n / (n - 1.0) * (squares - 2.0 * mean.dot(&crossed) + parts * mean.norm_squared()).max(0.0)
        };
        let variances = (0..signs.ncols()).map(variance).collect();
        Moments { means, variances, squares }
    }

    /// Replaces shapes by their deviations from `centre`.
    fn centre(&mut self, centre: &[f64]) {
        for mut column in self.rows.column_iter_mut() {
            column.iter_mut().zip(centre).for_each(|(y, m)| *y -= m);
        }
    }
}

/// The studentised distance of the groups 0 and 1 of `labels` with its test by `draws` signs for every shape; `None` if no group scatters.
/// `watch` is asked before every product.
///
/// Cost: `n m` multiply-adds per draw, for `n` shapes of `m` coordinates; twice that for shapes of unequal weights.
///
/// # Errors
/// [`AnalysisError::Interrupted`] once `watch` stops.
pub fn studentised(
    sample: &Sample,
    labels: &[usize],
    (seed, draws): (u64, usize),
    watch: &dyn Watch,
) -> Result<Option<Tested>, AnalysisError> {
    let mut sides = [0, 1].map(|group| Side::new(sample, labels, group));
    let [first, second] =
        sides.each_ref().map(|side| side.moments(&Matrix::from_element(side.parts.len(), 1, 1.0)));
    let (scatter, distance) =
        (first.variances[0] + second.variances[0], (&second.means - &first.means).norm_squared());
    if !(scatter > NO_SCATTER * (first.squares + second.squares)) {
        return Ok(None);
    }
    let value = distance / scatter;
    let common = (first.means * second.variances[0] + second.means * first.variances[0]) / scatter;
    sides.iter_mut().for_each(|side| side.centre(common.as_slice()));
    let reaching = parallel::try_map(draws.div_ceil(COLUMNS), &|batch| {
        watch.check()?;
        let drawn = batch * COLUMNS..draws.min((batch + 1) * COLUMNS);
        let drawn = statistics(&sides, seed, drawn);
        Ok::<_, AnalysisError>(drawn.into_iter().filter(|&drawn| reaches(drawn, value)).count())
    })?;
    let tally = Tally { exceeding: reaching.into_iter().sum(), permutations: draws, exact: false };
    Ok(Some(Tested { value: Some(value), tally }))
}

/// `T*` of each of the `draws`; a draw without scatter has the statistic infinity.
fn statistics(sides: &[Side; 2], seed: u64, draws: std::ops::Range<usize>) -> Vec<f64> {
    let counts = sides.each_ref().map(|side| side.parts.len());
    let mut signs = counts.map(|count| Matrix::zeros(count, draws.len()));
    for (b, draw) in draws.enumerate() {
        let mut random = stream(seed, STREAMS + draw);
        for signs in &mut signs {
            signs.column_mut(b).iter_mut().for_each(|sign| *sign = if random.random() { 1.0 } else { -1.0 });
        }
    }
    let [first, second] = [0, 1].map(|group| sides[group].moments(&signs[group]));
    let least = NO_SCATTER * (first.squares + second.squares);
    let statistic = |b: usize| {
        let distance = (second.means.column(b) - first.means.column(b)).norm_squared();
        let scatter = first.variances[b] + second.variances[b];
        if scatter > least { distance / scatter } else { f64::INFINITY }
    };
    (0..first.variances.len()).map(statistic).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::Unwatched;

    fn sample(values: &[f64], weights: &[f64]) -> Sample {
        Sample {
            coordinates: Matrix::from_row_slice(1, values.len(), values),
            points: Matrix::zeros(1, values.len()),
            dimension: 1,
            sizes: Matrix::zeros(0, values.len()),
            weights: weights.to_vec(),
        }
    }

    #[test]
    fn of_one_coordinate_it_is_the_square_of_welchs_t() {
        let values = [1.0, 2.0, 4.0, 2.5, 3.0, 7.0, 9.0];
        let labels = [0, 0, 0, 0, 1, 1, 1];
        let found = studentised(&sample(&values, &[3.0; 7]), &labels, (1, 0), &Unwatched).unwrap().unwrap();
        // Means 2.375 and 19/3; variances of the values 1.5625 and 28/3.
        let wanted = (19.0_f64 / 3.0 - 2.375).powi(2) / (1.5625 / 4.0 + 28.0 / 9.0);
        assert!((found.value.unwrap() - wanted).abs() < 1e-12, "{found:?}, expected {wanted}");
        assert_eq!((found.tally.permutations, found.tally.p()), (0, None));
    }

    #[test]
    fn a_shape_of_weight_two_moves_means_as_two_shapes_do() {
        let heavy = studentised(
            &sample(&[0.0, 3.0, 5.0, 6.0], &[2.0, 1.0, 1.0, 1.0]),
            &[0, 0, 1, 1],
            (1, 0),
            &Unwatched,
        );
        // Means 1 and 5.5; V = 2 Σ p²(y − ȳ)²: 2 (4/9 + 4/9) and 2 (1/16 + 1/16).
        let wanted = 4.5_f64.powi(2) / (16.0 / 9.0 + 0.25);
        assert!((heavy.unwrap().unwrap().value.unwrap() - wanted).abs() < 1e-12);
    }

    #[test]
    fn equal_shapes_have_no_such_distance_and_groups_far_apart_differ() {
        let labels = [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1];
        let of = |values: [f64; 12]| {
            studentised(&sample(&values, &[1.0; 12]), &labels, (3, 999), &Unwatched).unwrap()
        };
        assert_eq!(of([1.0; 12]), None);
        let apart = of([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 9.0, 9.4, 9.9, 8.0, 9.5, 9.1]).unwrap();
        assert!(apart.tally.p().unwrap() < 0.01, "{apart:?}");
        let mixed = of([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.5, 1.5, 2.5, 3.5, 4.5, 2.0]).unwrap();
        assert!(mixed.tally.p().unwrap() > 0.3, "{mixed:?}");
    }
}
