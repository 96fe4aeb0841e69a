//! The posterior of scores and pose, given seen points and imposed values.
//!
//! Every step solves the linear system of the module above at the present pose and shape (Gauss–Newton); where nothing but points is
//! seen, only the pose is not linear, and a few steps suffice.

use super::feature::ShapeFeature;
use super::places::AtPlaces;
use super::pose::{Freedom, Pose, undetermined};
use crate::AnalysisError;
use crate::metric::{dot, norm};
use shapelex_numeric::dense::{Definite, Matrix, add_outer_products};
use shapelex_numeric::kernels::add_scaled;

/// Known part of a shape.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Shapes of the model at the seen places.
    pub(super) at: AtPlaces,
    /// The seen points, coordinate-major, in their own pose.
    pub(super) points: Vec<f64>,
    /// Variance of the measurement of each point, for each coordinate.
    pub(super) variances: Vec<f64>,
    /// Imposed values.
    pub(super) imposed: Vec<Imposed>,
}

/// A value that a shape is to have.
#[derive(Debug, Clone)]
pub(super) struct Imposed {
    /// Feature that has the value.
    pub(super) feature: ShapeFeature,
    /// Shapes of the model at its places.
    pub(super) at: AtPlaces,
    /// The value.
    pub(super) value: f64,
    /// Its standard deviation; zero imposes it exactly.
    pub(super) deviation: f64,
}

/// The distribution of scores and pose.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// Most likely scores, of unit variance beforehand.
    pub scores: Vec<f64>,
    /// Most likely pose.
    pub pose: Pose,
    /// The way back to the pose in which the shape is seen.
    pub back: Pose,
    /// Covariance of the scores, and of a small motion behind them.
    pub covariance: Matrix,
    /// `T_k`.
    pub(super) directions: Vec<Matrix>,
    /// Whether the motion has a translation.
    pub(super) translates: bool,
    /// `Σ |q_i − ŷ_i|²/v_i`.
    pub misfit: f64,
    /// Number of seen numbers that are not taken by the pose.
    pub freedom: usize,
    /// Number of steps.
    pub steps: usize,
    /// Whether the last step moved nothing.
    pub converged: bool,
}

/// Most steps.
const STEPS: usize = 100;
/// Change of scores, and of the pose relative to its size, at which the steps end.
const CLOSE: f64 = 1e-8;
/// Longest step of scores where values are imposed, which need not be linear.
const LONGEST: f64 = 2.0;
/// Variance of an exact value, divided by that of the modes.
const EXACT: f64 = 1e-10;
/// Difference to an exact value, in standard deviations of the modes, from which on it counts as not reached.
const REACHED: f64 = 1e-3;
/// Part of a direction's information that others must leave.
const INDEPENDENT: f64 = 1e-13;

impl Posterior {
    /// The posterior of a shape.
    ///
    /// Cost: for each of usually three to eight steps `O(d M (J + I)²)` for `M` seen points, `J` scores and `I` unknowns of the pose.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `observed` if nothing is seen, or too little for the pose; at `conditions` with the position of
    /// one that has no value or cannot be met with the others; [`AnalysisError::Degenerate`] for flat points.
    pub fn new(seen: &Seen, freedom: &Freedom) -> Result<Self, AnalysisError> {
        let d = freedom.dimension();
        let numbers = d * seen.at.count() + seen.imposed.len();
        if numbers < freedom.count().max(1) {
            let detail = format!(
                "expected at least {} seen numbers, as many as the pose has unknowns, got {numbers}",
                freedom.count().max(1)
            );
            return Err(AnalysisError::Parameter { field: "observed", detail });
        }
        let mut state = State {
            scores: vec![0.0; seen.at.scores()],
            pose: freedom.start(&seen.points, &seen.at.mean)?,
            seen,
            freedom,
        };
        let size = state.size();
        let mut steps = 0;
        let (factor, directions, converged) = loop {
            steps += 1;
            let (factor, directions, found) = state.solve()?;
            let (z, motion) = found.split_at(state.scores.len());
            let moved: f64 =
                z.iter().zip(&state.scores).map(|(new, old)| (new - old).powi(2)).sum::<f64>().sqrt();
            let turned = norm(&motion[..directions.len()]);
            let shifted = norm(&motion[directions.len()..]) / size;
            let converged = moved <= CLOSE * (1.0 + norm(z)) && turned <= CLOSE && shifted <= CLOSE;
            if !(moved + turned + shifted).is_finite() {
                return Err(undetermined());
            }
            let part = if seen.imposed.is_empty() { 1.0 } else { (LONGEST / moved).min(1.0) };
            state.scores.iter_mut().zip(z).for_each(|(old, new)| *old += part * (new - *old));
            state.pose = freedom.absorb(&state.pose, &directions, motion);
            if converged || steps == STEPS {
                break (factor, directions, converged);
            }
        };
        state.check()?;
        let unknowns = state.scores.len() + freedom.count();
        let misfit = state.misfit()?;
        Ok(Self {
            back: state.pose.inverse()?,
            scores: state.scores,
            pose: state.pose,
            covariance: factor.solve(&Matrix::identity(unknowns, unknowns)),
            directions,
            translates: freedom.translates(),
            misfit,
            freedom: numbers - freedom.count(),
            steps,
            converged,
        })
    }

    /// Mahalanobis distance of the scores from the mean.
    pub fn distance(&self) -> f64 {
        norm(&self.scores)
    }
}

/// Scores and pose between two steps.
struct State<'a> {
    scores: Vec<f64>,
    pose: Pose,
    seen: &'a Seen,
    freedom: &'a Freedom,
}

impl State<'_> {
    /// Root mean square distance of the seen places of the mean from the origin, or one.
    fn size(&self) -> f64 {
        let mean = &self.seen.at.mean;
        let size = norm(mean) / (mean.len().max(1) as f64).sqrt();
        if size > 0.0 { size } else { 1.0 }
    }

    /// The linear system at the present shape and pose: its factor, the directions of the pose, and the solution.
    fn solve(&self) -> Result<(Definite, Vec<Matrix>, Vec<f64>), AnalysisError> {
        let directions = self.freedom.directions(&self.pose)?;
        let (j, unknowns) = (self.scores.len(), self.scores.len() + self.freedom.count());
        let (mut rows, mut right) = self.of_points(&directions, unknowns);
        self.of_values(&directions, unknowns, (&mut rows, &mut right))?;
        let mut information = Matrix::zeros(unknowns, unknowns);
        (0..j).for_each(|i| information[(i, i)] = 1.0);
        add_outer_products(&mut information, &rows, 1.0);
        let mut sum = Matrix::zeros(unknowns, 1);
        for (row, value) in rows.chunks_exact(unknowns).zip(&right) {
            add_scaled(sum.as_mut_slice(), *value, row);
        }
        let factor = Definite::new(&information).ok().filter(|factor| factor.independence() > INDEPENDENT);
        let factor = factor.ok_or_else(undetermined)?;
        let found = factor.solve(&sum).as_slice().to_vec();
        Ok((factor, directions, found))
    }

    /// Rows `G_i/√v_i` and right sides `(q_i − m_i)/√v_i` of the seen points.
    fn of_points(&self, directions: &[Matrix], unknowns: usize) -> (Vec<f64>, Vec<f64>) {
        let Seen { at, points, variances, .. } = self.seen;
        let (d, count, square) = (self.freedom.dimension(), at.count(), self.pose.square());
        let (q, y) = (self.pose.apply(points), at.points(&self.scores));
        let mut rows = vec![0.0; d * count * unknowns];
        let mut right = Vec::with_capacity(d * count);
        for c in 0..d {
            for i in 0..count {
                let weight = (at.noise[i] + square * variances[i]).sqrt().recip();
                let row = &mut rows[(c * count + i) * unknowns..][..unknowns];
                let point = |e: usize| y[e * count + i];
                fill(row, at.row(i, c), directions, self.freedom.translates(), (c, point));
                row.iter_mut().for_each(|value| *value *= weight);
                right.push(weight * (q[c * count + i] - at.mean[c * count + i]));
            }
        }
        (rows, right)
    }

    /// Adds a row for each imposed value.
    fn of_values(
        &self,
        directions: &[Matrix],
        unknowns: usize,
        (rows, right): (&mut Vec<f64>, &mut Vec<f64>),
    ) -> Result<(), AnalysisError> {
        let j = self.scores.len();
        for (position, imposed) in self.seen.imposed.iter().enumerate() {
            let (value, row) = self.value(imposed, directions, unknowns).ok_or_else(|| no_value(position))?;
            let variance = imposed.deviation.powi(2).max(EXACT * spread(&row, j));
            if !(variance > 0.0) {
                return Err(unvaried(position));
            }
            let weight = variance.sqrt().recip();
            right.push(weight * (imposed.value - value + dot(&row[..j], &self.scores)));
            rows.extend(row.iter().map(|value| weight * value));
        }
        Ok(())
    }

    /// The present value of a function, and its derivatives by the scores and a motion.
    fn value(&self, imposed: &Imposed, directions: &[Matrix], unknowns: usize) -> Option<(f64, Vec<f64>)> {
        let Imposed { feature, at, .. } = imposed;
        let (d, count) = (self.freedom.dimension(), at.count());
        let back = self.pose.inverse().ok()?;
        let y = at.points(&self.scores);
        let r = back.apply(&y);
        let points: Vec<Vec<f64>> = (0..count).map(|i| (0..d).map(|c| r[c * count + i]).collect()).collect();
        let (value, by_points) = feature.of(&points)?;
        let (mut row, mut of_coordinate) = (vec![0.0; unknowns], vec![0.0; unknowns]);
        for (i, by_point) in by_points.iter().enumerate().filter(|(_, by)| by.iter().any(|x| *x != 0.0)) {
            for c in 0..d {
                let by: f64 = (0..d).map(|e| back.matrix[(e, c)] * by_point[e]).sum();
                let point = |e: usize| y[e * count + i];
                fill(&mut of_coordinate, at.row(i, c), directions, self.freedom.translates(), (c, point));
                add_scaled(&mut row, by, &of_coordinate);
            }
        }
        (value.is_finite() && row.iter().all(|x| x.is_finite())).then_some((value, row))
    }

    /// Whether the exact values are reached.
    fn check(&self) -> Result<(), AnalysisError> {
        let directions = self.freedom.directions(&self.pose)?;
        let unknowns = self.scores.len() + self.freedom.count();
        for (position, imposed) in self.seen.imposed.iter().enumerate() {
            let (value, row) =
                self.value(imposed, &directions, unknowns).ok_or_else(|| no_value(position))?;
            let spread = spread(&row, self.scores.len()).sqrt();
            let most = if imposed.deviation > 0.0 { f64::INFINITY } else { REACHED * spread };
            if (imposed.value - value).abs() > most {
                let detail = format!(
                    "{position}: expected conditions that one shape can meet, got a contradiction: {} is wanted, the nearest shape has {value}",
                    imposed.value
                );
                return Err(AnalysisError::Parameter { field: "conditions", detail });
            }
        }
        Ok(())
    }

    fn misfit(&self) -> Result<f64, AnalysisError> {
        let Seen { at, points, variances, .. } = self.seen;
        let (q, y) = (self.pose.apply(points), at.points(&self.scores));
        let (count, square) = (at.count(), self.pose.square());
        let of = |k: usize| (q[k] - y[k]).powi(2) / (at.noise[k % count] + square * variances[k % count]);
        Ok((0..q.len()).map(of).sum())
    }
}

/// Derivatives of a coordinate of a point by scores, motions `T_k` and a translation.
pub(super) fn fill(
    row: &mut [f64],
    modes: &[f64],
    directions: &[Matrix],
    translates: bool,
    (coordinate, point): (usize, impl Fn(usize) -> f64),
) {
    let (j, k) = (modes.len(), modes.len() + directions.len());
    row[..j].copy_from_slice(modes);
    for (value, t) in row[j..k].iter_mut().zip(directions) {
        *value = (0..t.ncols()).map(|e| t[(coordinate, e)] * point(e)).sum();
    }
    if translates {
        row[k..].fill(0.0);
        row[k + coordinate] = 1.0;
    }
}

/// Variance of a value with these derivatives by `j` scores of unit variance; where they do not change it, its change by the pose.
fn spread(row: &[f64], j: usize) -> f64 {
    let (by_scores, all) = (dot(&row[..j], &row[..j]), dot(row, row));
    if by_scores > UNVARIED * all { by_scores } else { all }
}

/// Part of the squared derivatives of a value below which those by scores are rounding error.
const UNVARIED: f64 = 1e-20;

fn no_value(position: usize) -> AnalysisError {
    let detail = format!("{position}: the shape that it leads to has no such value, or no derivative of it");
    AnalysisError::Parameter { field: "conditions", detail }
}

fn unvaried(position: usize) -> AnalysisError {
    let detail = format!("{position}: expected a value that the modes change, this one they do not");
    AnalysisError::Parameter { field: "conditions", detail }
}
