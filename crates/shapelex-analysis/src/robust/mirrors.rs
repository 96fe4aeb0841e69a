//! Mirror images among shapes that are nearly symmetric.
//!
//! ```text
//! R     reflection, reversal and the rotation that brings the mirrored centre m back to itself,   R² = I
//! d_k   antisymmetric part of shape k, ½ (m + a_k − R (m + a_k));   that of its mirror image is −d_k
//! v_k   d_k in its leading components about zero, so that Σ w_k v_k v_kᵀ = W I, whichever of the two each shape is
//! v     ∼ (1 − ε) N(μ, C) + ε N(−μ, C),   C = I − μ μᵀ                          (EM, begun on the two sides of the mean of v)
//! p_k   probability that shape k is none of the mirror images,   ln (p_k/(1 − p_k)) = ln ((1 − ε)/ε) + 2 μᵀv_k/(1 − |μ|²)
//! gain  mean log density of v, less that of a single normal distribution
//! ```
//!
//! A mirror image of a nearly symmetric shape is not farther from the majority than the shape itself, and no group in the
//! leading scores: asymmetry is one of many small variations. But it is the same deviation with the other sign, which leaves the second
//! moments of `v` as they are. So one direction `μ` and the fraction `ε` are all that has to be estimated. The shapes count by `p_k`,
//! not by a decision: where the two sides overlap, the estimates of the right shapes are those of their side all the same.
//!
//! Mirror images are taken out if the gain is at least [`GAIN`] plus [`GAIN_OF_FEW`] divided by their number, the two sides [`SEPARATION`]
//! apart, and a third of the shapes at most is mirrored. Planar curves only: of landmarks, nothing says which belong together.
//!
//! Sources: Dempster, Laird and Rubin 1977 (EM); McLachlan and Peel 2000 (mixtures); Mardia, Bookstein and Moreton 2000
//! (symmetric and antisymmetric parts).

use super::groups::MOST_WRONG;
use super::rejection::Description;
use super::sources::{Deviations, ROUNDING, Reweighted};
use crate::AnalysisError;
use crate::accumulate::{ScatterSum, ShapeSource, Shapes, accumulate, for_each_changed, map_shapes};
use crate::alignment::Method;
use crate::fit::{Fit, Scaling, cross_product, nearest_rotation, transform};
use crate::matching::{Matching, Placement};
use crate::metric::{dot, norm};
use crate::transformation::Structure;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Maximum number of components of the antisymmetric parts.
const COMPONENTS: usize = 6;

/// Number of distinct shapes for each of them.
const SHAPES_PER_COMPONENT: f64 = 8.0;

/// Component that is rounding error, as a fraction of the largest variance.
const SMALLEST: f64 = 1e-6;

/// Fewest distinct shapes among which mirror images are searched.
const FEWEST: f64 = 30.0;

/// Least gain: twelve of thirteen real sets without mirror images had none at all, one of 50 shapes 0.08; sets of which 12 or 30 % are
/// mirrored and can be told 0.2 and more.
const GAIN: f64 = 0.12;

/// Addition to the least gain, divided by the number of shapes.
const GAIN_OF_FEW: f64 = 4.0;

/// Least distance of the two sides, in standard deviations within one.
const SEPARATION: f64 = 3.0;

/// Maximum number of steps of EM; sides that can be told settle within ten.
const STEPS: usize = 40;

/// Maximum number of shapes in EM.
const SAMPLE: usize = 4096;

/// Change of `ε` that ends the steps.
const SETTLED: f64 = 1e-6;

/// Begin of EM: log odds of the side of the mean.
const BEGIN: f64 = 4.0;

/// Probabilities this near to zero or one count as such.
const CERTAIN: f64 = 1e-3;

/// Least variance within a side along the line between the two.
const LEAST_VARIANCE: f64 = 1e-6;

/// `R` for a class of transformations and a centre.
pub(super) struct Reflection<'a> {
    matching: &'a Matching,
    placement: Placement,
    rotation: Matrix,
}

impl<'a> Reflection<'a> {
    /// About the whitened `centre`. `None` where mirror images are the same shapes, are searched anyway, or cannot be formed.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0.
    pub(super) fn new(
        method: &Method,
        matching: &'a Matching,
        centre: &[f64],
    ) -> Result<Option<Self>, AnalysisError> {
        let rotates = match method {
            Method::Projection(class) => class.structure == Structure::Complex,
            Method::Procrustes(fit) => fit.rotates,
        };
        if !rotates || matching.dimension() != 2 || matching.curve().is_none() || matching.mirrors() {
            return Ok(None);
        }
        let fit = Fit { dimension: 2, rotates: true, scaling: Scaling::None };
        let placement = matching.mirror_image(centre, fit)?;
        let rotation = nearest_rotation(&cross_product(centre, &matching.place(centre, placement), 2));
        Ok(Some(Self { matching, placement, rotation }))
    }

    /// `½ (x − R x)`.
    fn antisymmetric(&self, x: &[f64]) -> Vec<f64> {
        let image = transform(&self.rotation, &self.matching.place(x, self.placement));
        x.iter().zip(image).map(|(x, image)| 0.5 * (x - image)).collect()
    }
}

/// The probabilities that the shapes are not mirror images, if some of them are. `factors`: those of their distances; `described`:
/// the shapes in the components of their signs.
///
/// Two passes over the deviations: the scatter of the antisymmetric parts, and their scores.
///
/// # Errors
/// Errors of the source; a failure of the eigenproblem.
pub(super) fn unmirrored(
    reflection: &Reflection<'_>,
    away: &Deviations<'_>,
    described: &Description,
    factors: &[f64],
) -> Result<Option<Vec<f64>>, AnalysisError> {
    let weights: Vec<f64> = described.weights().iter().zip(factors).map(|(w, factor)| w * factor).collect();
    let count = described.distinct_of(weights.iter().sum());
    let most = COMPONENTS.min((count / SHAPES_PER_COMPONENT) as usize);
    if count < FEWEST {
        return Ok(None);
    }
    let of_centre = reflection.antisymmetric(away.centre());
    let parts = Antisymmetric { away, reflection, of_centre: &of_centre };
    let parts = Reweighted { source: &parts, factors };
    let sum: ScatterSum = accumulate(&parts, || ScatterSum::new(of_centre.len()))?;
    let total = sum.weight();
    let (_, pairs) = sum.leading(false, most)?;
    let largest = pairs.values.first().copied().unwrap_or(0.0);
    let rounding = (ROUNDING * norm(away.centre())).powi(2) * total;
    let varies = |value: &&f64| **value > (SMALLEST * largest).max(rounding);
    let q = pairs.values.iter().take_while(varies).count();
    if q == 0 {
        return Ok(None);
    }
    let rows: Vec<Vec<f64>> = (0..q)
        .map(|i| pairs.vectors.column(i).iter().map(|xi| xi * (total / pairs.values[i]).sqrt()).collect())
        .collect();
    // R is symmetric, so that the components see nothing of the symmetric parts.
    let own: Vec<f64> = rows.iter().map(|row| dot(row, &of_centre)).collect();
    let v = map_shapes(away, |_, a, _| {
        Ok(rows.iter().zip(&own).map(|(row, own)| dot(row, a) + own).collect::<Vec<f64>>())
    })?;
    let v = v.concat();
    let Some(sides) = Sides::settled(&v, &weights) else { return Ok(None) };
    let told = sides.gain >= GAIN + GAIN_OF_FEW / count && sides.separation() >= SEPARATION;
    Ok((told && sides.mirrored <= MOST_WRONG).then(|| sides.probabilities(&v)))
}

/// The antisymmetric parts of shapes.
struct Antisymmetric<'a> {
    away: &'a Deviations<'a>,
    reflection: &'a Reflection<'a>,
    of_centre: &'a [f64],
}

impl ShapeSource for Antisymmetric<'_> {
    fn count(&self) -> usize {
        self.away.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let change = |_: Shapes<'_>, shapes: &mut [f64]| {
            parallel::for_each_chunk(shapes, self.of_centre.len(), &|_, a| {
                let part = self.reflection.antisymmetric(a);
                a.iter_mut().zip(part).zip(self.of_centre).for_each(|((a, part), own)| *a = part + own);
            });
            Ok(())
        };
        for_each_changed(self.away, change, visit)
    }
}

/// The two sides that EM has found: `N(μ, I − μ μᵀ)`, and a fraction `ε` of mirror images.
struct Sides {
    mu: Vec<f64>,
    /// `|μ|²`; the variance within a side along `μ` is `1 − |μ|²`.
    square: f64,
    /// `ε`.
    mirrored: f64,
    gain: f64,
}

impl Sides {
    /// `None` if all shapes are on one side.
    fn settled(v: &[f64], weights: &[f64]) -> Option<Self> {
        let q = v.len() / weights.len();
        let total: f64 = weights.iter().sum();
        let mean = signed_mean(v, q, weights.iter().map(|weight| weight / total));
        let along: Vec<f64> = v.chunks_exact(q).map(|v| dot(v, &mean)).collect();
        let chosen = spread_along(&along, weights);
        let total: f64 = chosen.iter().map(|&k| weights[k]).sum();
        let rows: Vec<f64> = chosen.iter().flat_map(|&k| &v[k * q..(k + 1) * q]).copied().collect();
        let parts: Vec<f64> = chosen.iter().map(|&k| weights[k] / total).collect();
        let begin = |&k: &usize| logistic(if along[k] < 0.0 { -BEGIN } else { BEGIN });
        let mut probabilities: Vec<f64> = chosen.iter().map(begin).collect();
        let mut sides = Self { mu: Vec::new(), square: 0.0, mirrored: 0.0, gain: 0.0 };
        // A single normal distribution along the mean of v, whose second moment is one.
        let alone = -0.5 - 0.5 * (1.0 - dot(&mean, &mean)).max(LEAST_VARIANCE).ln();
        for _ in 0..STEPS {
            let mirrored: f64 = probabilities.iter().zip(&parts).map(|(p, part)| part * (1.0 - p)).sum();
            let signs = probabilities.iter().zip(&parts).map(|(p, part)| part * (2.0 * p - 1.0));
            let mu = signed_mean(&rows, q, signs);
            let square = dot(&mu, &mu).min(1.0 - LEAST_VARIANCE);
            if mirrored < SETTLED || square <= f64::MIN_POSITIVE {
                return None;
            }
            let change = (mirrored - sides.mirrored).abs();
            sides = Self { mu, square, mirrored, gain: 0.0 };
            sides.gain = -alone;
            for ((v, p), part) in rows.chunks_exact(q).zip(&mut probabilities).zip(&parts) {
                let (probability, density) = sides.of(v);
                *p = probability;
                sides.gain += part * density;
            }
            if change < SETTLED {
                break;
            }
        }
        Some(sides)
    }

    /// Probability that a shape is not a mirror image, and its log density along `μ`, but for the constant of the normal distribution.
    fn of(&self, v: &[f64]) -> (f64, f64) {
        let (within, length, product) = (1.0 - self.square, self.square.sqrt(), dot(v, &self.mu));
        let log_odds = ((1.0 - self.mirrored) / self.mirrored).ln() + 2.0 * product / within;
        // The larger of the two terms, and the share of the other one.
        let (share, own) =
            if log_odds > 0.0 { (1.0 - self.mirrored, product) } else { (self.mirrored, -product) };
        let away = own / length - length;
        let both = (-log_odds.abs()).exp().ln_1p();
        (logistic(log_odds), share.ln() + both - 0.5 * (away * away / within + within.ln()))
    }

    /// The probabilities of all shapes that they are not mirror images.
    fn probabilities(&self, v: &[f64]) -> Vec<f64> {
        let certain = |p: f64| match p {
            p if p < CERTAIN => 0.0,
            p if p > 1.0 - CERTAIN => 1.0,
            p => p,
        };
        v.chunks_exact(self.mu.len()).map(|v| certain(self.of(v).0)).collect()
    }

    /// Distance of the two sides in standard deviations.
    fn separation(&self) -> f64 {
        2.0 * (self.square / (1.0 - self.square)).sqrt()
    }
}

/// `Σ_k s_k v_k`.
fn signed_mean(v: &[f64], q: usize, signs: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sum = vec![0.0; q];
    for (v, sign) in v.chunks_exact(q).zip(signs) {
        sum.iter_mut().zip(v).for_each(|(sum, v)| *sum += sign * v);
    }
    sum
}

/// The shapes with a weight; of many, [`SAMPLE`] that are evenly spread over the values `along`, whatever their order.
fn spread_along(along: &[f64], weights: &[f64]) -> Vec<usize> {
    let mut kept: Vec<usize> = (0..weights.len()).filter(|&k| weights[k] > 0.0).collect();
    if kept.len() > SAMPLE {
        kept.sort_by(|&i, &j| along[i].total_cmp(&along[j]));
        let count = kept.len();
        kept = (0..SAMPLE).map(|i| kept[i * count / SAMPLE]).collect();
    }
    kept
}

/// `1/(1 + exp(−x))`.
fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic pseudo-random numbers, nearly normal with deviation one.
    struct Random(u64);

    impl Random {
        fn normal(&mut self) -> f64 {
            let mut even = || {
                self.0 =
                    self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (self.0 >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| even()).sum::<f64>() - 6.0
        }
    }

    /// Two standardised scores: the first `apart` standard deviations from zero, the last shapes with the other sign.
    fn scores(right: usize, mirrored: usize, apart: f64, seed: u64) -> Vec<f64> {
        let mut random = Random(seed);
        let shape = |k: usize| {
            let sign = if k < right { 1.0 } else { -1.0 };
            [sign * (apart + random.normal()), sign * random.normal()]
        };
        let mut v: Vec<f64> = (0..right + mirrored).flat_map(shape).collect();
        for i in 0..2 {
            let square: f64 = v.iter().skip(i).step_by(2).map(|v| v * v).sum();
            let size = (square / (right + mirrored) as f64).sqrt();
            v.iter_mut().skip(i).step_by(2).for_each(|v| *v /= size);
        }
        v
    }

    #[test]
    fn overlapping_sides_are_estimated_without_bias() {
        // A distance of 4.2 deviations: one in 56 is nearer to the other side.
        for seed in 1..6 {
            let sides = Sides::settled(&scores(1400, 600, 2.1, seed), &[1.0; 2000]).unwrap();
            assert!((sides.mirrored - 0.3).abs() < 0.03, "seed {seed}: {}", sides.mirrored);
            assert!((sides.separation() - 4.2).abs() < 0.3, "seed {seed}: {}", sides.separation());
            assert!(sides.gain > GAIN, "seed {seed}: {}", sides.gain);
        }
    }

    #[test]
    fn one_side_has_no_gain() {
        for seed in 1..6 {
            for (count, apart) in [(40, 0.0), (40, 2.0), (400, 0.0), (400, 0.5), (400, 3.0)] {
                let found = Sides::settled(&scores(count, 0, apart, seed), &vec![1.0; count]);
                let gain = found.map_or(0.0, |sides| sides.gain);
                assert!(gain < GAIN + GAIN_OF_FEW / count as f64, "{count} at {apart}, seed {seed}: {gain}");
            }
        }
    }

    #[test]
    fn many_shapes_have_the_sides_of_a_sample_in_any_order() {
        let v = scores(7000, 2000, 2.5, 3);
        let sides = Sides::settled(&v, &[1.0; 9000]).unwrap();
        assert!((sides.mirrored - 2.0 / 9.0).abs() < 0.02, "{}", sides.mirrored);
        let backwards: Vec<f64> = v.chunks_exact(2).rev().flatten().copied().collect();
        let other = Sides::settled(&backwards, &[1.0; 9000]).unwrap();
        assert!((sides.mirrored - other.mirrored).abs() < 1e-9 && (sides.square - other.square).abs() < 1e-9);
    }
}
