//! Largest likelihood over the relative factor of the random effects.

use std::ops::Range;

use super::Criterion;
use super::sums::{GroupSums, Profile};
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::lbfgs::{Objective, Rules, minimise};

/// Steps of the grid over `ρ/(1 + ρ)` before the derivative is solved.
const GRID: usize = 40;
/// Largest `ρ/(1 + ρ)`: groups without scatter inside.
const MOST: f64 = 1.0 - 1e-12;
/// Smallest eigenvalue of the relative covariance, over one plus its largest, that is not at the boundary.
const BOUNDARY: f64 = 1e-6;
/// Factors from which a search starts, for effects that scatter as much as residuals.
const STARTS: [f64; 3] = [0.3, 1.0, 3.0];
/// Rules of the search: until the likelihood is flat to rounding.
const EXACT: Rules =
    Rules { memory: 10, iterations: 500, first: 0.1, clip: 1.0, tolerance: 1e-9, relative: 1e-15 };

/// The optimum: the relative covariance of the effects of `Z`, and the likelihood there.
#[derive(Debug, Clone)]
pub struct Optimum {
    /// `L`.
    pub factor: Matrix,
    /// `LLᵀ`.
    pub relative: Matrix,
    /// The likelihood.
    pub profile: Profile,
    /// Whether the covariance is singular.
    pub boundary: bool,
}

/// The largest likelihood of coordinates that share their factor. `None` if residuals vanish.
pub fn optimum(
    sums: &GroupSums,
    coordinates: Range<usize>,
    criterion: Criterion,
    watch: &dyn Watch,
) -> Option<Optimum> {
    match sums.effects() {
        1 => of_one(sums, coordinates, criterion),
        _ => of_several(sums, coordinates, criterion, watch),
    }
}

/// One effect: the derivative is solved by bisection next to the best place of a grid.
fn of_one(sums: &GroupSums, coordinates: Range<usize>, criterion: Criterion) -> Option<Optimum> {
    let at = |part: f64| {
        let part = part.min(MOST);
        let factor = Matrix::from_element(1, 1, (part / (1.0 - part)).sqrt());
        sums.profile(&factor, coordinates.clone(), criterion).map(|profile| (factor, profile))
    };
    let place = |k: usize| k as f64 / GRID as f64;
    let value = |k: usize| at(place(k)).map_or(f64::NEG_INFINITY, |(_, profile)| profile.value);
    let values: Vec<f64> = (0..=GRID).map(value).collect();
    let best = (0..=GRID).max_by(|&a, &b| values[a].total_cmp(&values[b]))?;
    let slope = |part: f64| at(part).map_or(-1.0, |(_, profile)| profile.slope[(0, 0)]);
    let (mut low, mut high) = (place(best.saturating_sub(1)), place((best + 1).min(GRID)).min(MOST));
    let found = if best == 0 && slope(0.0) <= 0.0 {
        0.0
    } else if best == GRID && slope(MOST) >= 0.0 {
        MOST
    } else {
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if slope(middle) > 0.0 { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let (factor, profile) = at(found)?;
    let boundary = !(BOUNDARY..MOST).contains(&found);
    Some(Optimum { relative: &factor * &factor, factor, profile, boundary })
}

/// Several effects, by the entries of the lower triangle of `L`, in which the boundary is a place like others.
fn of_several(
    sums: &GroupSums,
    coordinates: Range<usize>,
    criterion: Criterion,
    watch: &dyn Watch,
) -> Option<Optimum> {
    let q = sums.effects();
    let mut likelihood = Likelihood { sums, coordinates, criterion };
    let mut best: Option<(Vec<f64>, f64)> = None;
    for start in STARTS {
        let mut x: Vec<f64> =
            (0..q).flat_map(|a| (0..=a).map(move |b| if a == b { start } else { 0.0 })).collect();
        let found = minimise(&mut likelihood, &mut x, &EXACT, &|| watch.stop());
        let value = found.history.last().copied().unwrap_or(f64::INFINITY);
        if value.is_finite() && best.as_ref().is_none_or(|(_, least)| value < *least) {
            best = Some((x, value));
        }
    }
    let factor = triangle(q, &best?.0);
    let profile = sums.profile(&factor, likelihood.coordinates, criterion)?;
    let relative = &factor * factor.transpose();
    let values = dense::symmetric_eigen(&relative).eigenvalues;
    let (least, most) = (values.min(), values.max());
    Some(Optimum { factor, relative, profile, boundary: !(least > BOUNDARY * (1.0 + most)) })
}

/// The lower triangle with these entries, row by row.
fn triangle(q: usize, entries: &[f64]) -> Matrix {
    Matrix::from_fn(q, q, |a, b| if b <= a { entries[a * (a + 1) / 2 + b] } else { 0.0 })
}

struct Likelihood<'a> {
    sums: &'a GroupSums,
    coordinates: Range<usize>,
    criterion: Criterion,
}

impl Objective for Likelihood<'_> {
    fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
        let q = self.sums.effects();
        let factor = triangle(q, x);
        let Some(profile) = self.sums.profile(&factor, self.coordinates.clone(), self.criterion) else {
            return f64::INFINITY;
        };
        // d LLᵀ = dL Lᵀ + L dLᵀ.
        let slope = profile.slope * factor * -2.0;
        let places = (0..q).flat_map(|a| (0..=a).map(move |b| (a, b)));
        gradient.iter_mut().zip(places).for_each(|(own, place)| *own = slope[place]);
        -profile.value
    }

    fn displacement(&self, direction: &[f64]) -> f64 {
        direction.iter().fold(0.0, |most, value| f64::max(most, value.abs()))
    }
}
