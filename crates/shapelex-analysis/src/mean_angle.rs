//! The angle between two mean shapes under a class, and the angle expected by chance.
//!
//! ```text
//! cos θ = max_s ⟨m, A r(· + s)⟩/(‖m‖ ‖A r‖)        A r(· + s) the member of the class of r nearest to m
//! ```
//!
//! `s` runs over the start points of the search, here also those between two control points (for closed curves, by
//! trigonometric interpolation). The mean of a set may start anywhere between the control points of another mean; on the
//! grid alone, half a step of 64 is an angle of a degree.
//!
//! The angle by chance comes from the means of halves of a set. Each half searches its own start points, so that the
//! angle includes everything that a search adds to the spread of the shapes, jumps to other start points included.

use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rand::seq::SliceRandom;

use super::AnalysisError;
use super::accumulate::{ShapeSource, ShapesInMemory, map_shapes, subset};
use super::alignment::mean_shape;
use super::frame::Frame;
use super::metric::{dot, norm};
use super::preparation::{Pose, Posed, Preparation};

/// Minimum number of shapes for comparing the means of halves.
pub const MIN_TO_HALVE: usize = 8;

/// Number of times the shapes are halved. The mean of eight angles has a relative standard error of a tenth.
const HALVINGS: u64 = 8;

/// Ratio of root mean square to mean for an angle with five degrees of freedom, `√5/E χ₅`. The mean is measured rather than
/// the mean square: an occasional half finds different start points altogether, and the square of its angle would dominate.
const ROOT_MEAN_SQUARE: f64 = 1.051;

/// Start points tried between two control points, and steps of the refinement of the best one.
const STARTS: usize = 8;
const STEPS: usize = 24;

/// The golden section.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// The angle between the mean of `preparation` and the whitened mean shape `other`, in radians.
///
/// Cost: 33 alignments of one shape; one alignment if start points are not searched.
///
/// # Errors
/// [`AnalysisError::Degenerate`] with index 0 if a mean is degenerate under the class.
pub fn angle(preparation: &Preparation, other: &[f64]) -> Result<f64, AnalysisError> {
    let aligning = Preparation { pose: Pose::Aligned { normalise: false }, ..preparation.clone() };
    let at = |offset: f64| -> Result<f64, AnalysisError> {
        let moved = aligning.matching.between(other, offset);
        let shape = ShapesInMemory::prepared(moved, vec![1.0]);
        let posed = Posed { source: &shape, preparation: &aligning };
        let aligned = map_shapes(&posed, |_, y, _| Ok(y.to_vec()))?.concat();
        let cosine = dot(&aligned, &aligning.mean) / (norm(&aligned) * norm(&aligning.mean));
        // For small angles the sine is more accurate.
        let away: f64 = aligned
            .iter()
            .zip(&aligning.mean)
            .map(|(a, m)| (a / norm(&aligned) - m / norm(&aligning.mean)).powi(2))
            .sum();
        Ok(if cosine > 0.5 {
            2.0 * (0.5 * away.sqrt()).min(1.0).asin()
        } else {
            cosine.clamp(-1.0, 1.0).acos()
        })
    };
    if !preparation.matching.shifts() {
        return at(0.0);
    }
    let mut best = (0.0, at(0.0)?);
    for i in 1..STARTS {
        let offset = i as f64 / STARTS as f64;
        let angle = at(offset)?;
        if angle < best.1 {
            best = (offset, angle);
        }
    }
    let (mut low, mut high) = (best.0 - 1.0 / STARTS as f64, best.0 + 1.0 / STARTS as f64);
    let inner = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let [mut left, mut right] = inner(low, high);
    let (mut at_left, mut at_right) = (at(left)?, at(right)?);
    for _ in 0..STEPS {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = inner(low, high)[0];
            at_left = at(left)?;
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = inner(low, high)[1];
            at_right = at(right)?;
        }
    }
    Ok(best.1.min(at_left).min(at_right))
}

/// Angle in radians to be expected between the means of two sets with `counts` shapes, all like `shapes` (as given,
/// whitened, centred when the class translates). It is estimated from random halves of `shapes`, with a fixed seed.
///
/// Cost: sixteen means of half of the shapes. `stop` is checked before each of them.
///
/// # Errors
/// [`AnalysisError::Interrupted`]; errors of degenerate shapes, in which the index has no meaning;
/// [`AnalysisError::TooFewShapes`] for fewer than [`MIN_TO_HALVE`] shapes.
pub fn expected(
    preparation: &Preparation,
    frame: Frame,
    shapes: &ShapesInMemory,
    counts: [usize; 2],
    stop: &dyn Fn() -> bool,
) -> Result<f64, AnalysisError> {
    let found = shapes.count();
    if found < MIN_TO_HALVE {
        return Err(AnalysisError::TooFewShapes { found, needed: MIN_TO_HALVE });
    }
    let mean = |chosen: &[usize]| {
        if stop() {
            return Err(AnalysisError::Interrupted);
        }
        let Preparation { metric, method, matching, .. } = preparation;
        Ok(mean_shape(&subset(shapes, chosen), metric, method, frame, matching)?.whitened)
    };
    let mut order: Vec<usize> = (0..found).collect();
    let mut random = ChaCha12Rng::seed_from_u64(0);
    let mut sum = 0.0;
    for _ in 0..HALVINGS {
        order.shuffle(&mut random);
        let (first, second) = order.split_at(found / 2);
        let halved = Preparation { mean: mean(first)?, ..preparation.clone() };
        sum += angle(&halved, &mean(second)?)?;
    }
    let of = |counts: [usize; 2]| counts.iter().map(|&count| 1.0 / count.max(1) as f64).sum::<f64>();
    let halves = [found / 2, found - found / 2];
    Ok(ROOT_MEAN_SQUARE * sum / HALVINGS as f64 * (of(counts) / of(halves)).sqrt())
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::alignment::{Alignment, Method};
    use crate::correspondence::{Correspondence, Direction, Mirror};
    use crate::matching::Matching;
    use crate::metric::Metric;
    use crate::transformation::{ClassName, Transformation};
    use shapelex_geometry::generator::GeneratorKind;
    use shapelex_geometry::representation::{Representation, ShapeSpace};

    const POINTS: usize = 48;

    fn preparation() -> Preparation {
        let representation = Representation::ClosedCurve {
            dimension: 2,
            control_points: POINTS,
            generator: GeneratorKind::Trigonometric {},
        };
        let space = ShapeSpace::new(&representation).unwrap();
        let similarity = Transformation::Named(ClassName::Similarity);
        Preparation {
            metric: Metric::of(&space),
            method: Method::new(&similarity, Alignment::Projection, 2).unwrap(),
            matching: Matching::new(&space, Correspondence::Cyclic, Direction::Given, Mirror::Forbid),
            mean: Vec::new(),
            pose: Pose::Aligned { normalise: false },
        }
    }

    /// An outline with three unequal lobes and random harmonics, started at `start`.
    fn outline(start: f64, random: &mut ChaCha12Rng, spread: f64) -> Vec<f64> {
        let waves: Vec<(f64, f64)> = (2..8)
            .map(|_| (spread * random.random_range(-1.0..1.0), random.random_range(0.0..6.3)))
            .collect();
        let at = |i: usize| {
            let t = std::f64::consts::TAU * (i as f64 + start) / POINTS as f64;
            let own: f64 =
                waves.iter().zip(2..).map(|((a, phase), k)| a * (f64::from(k) * t + phase).cos()).sum();
            let r = 1.0 + 0.2 * (3.0 * t).cos() + 0.15 * (t - 0.4).sin() + own;
            [1.5 * r * t.cos(), r * t.sin()]
        };
        (0..2).flat_map(|c| (0..POINTS).map(move |i| (c, i))).map(|(c, i)| at(i)[c]).collect()
    }

    fn whitened(preparation: &Preparation, outlines: Vec<Vec<f64>>) -> ShapesInMemory {
        let weights = vec![1.0; outlines.len()];
        ShapesInMemory::new(&preparation.metric, true, outlines.concat(), weights).unwrap()
    }

    #[test]
    fn a_start_between_control_points_is_no_angle() {
        let (mut preparation, mut random) = (preparation(), ChaCha12Rng::seed_from_u64(1));
        let shapes = [0.0, 0.5, 7.3].map(|start| outline(start, &mut random, 0.0));
        let shapes = whitened(&preparation, shapes.into());
        let length = preparation.metric.len();
        preparation.mean = shapes.all().whitened[..length].to_vec();
        for other in shapes.all().whitened.chunks_exact(length) {
            let found = angle(&preparation, other).unwrap();
            // On the grid the angle is 0.06; the golden section ends at 1e-6 of a step.
            assert!(found < 1e-5, "{found}");
        }
    }

    /// Over cohorts of similar shapes, observed and expected angles agree. With sixteen pairs, the ratio has a standard
    /// error of about a tenth.
    #[test]
    fn the_expected_angle_is_found_between_means() {
        let preparation = preparation();
        let (mut observed, mut wanted) = (0.0, 0.0);
        for seed in 0..16 {
            let mut random = ChaCha12Rng::seed_from_u64(seed);
            let mut draw = |count: usize| -> ShapesInMemory {
                let outlines = (0..count).map(|_| {
                    let start = random.random_range(0.0..POINTS as f64);
                    outline(start, &mut random, 0.04)
                });
                whitened(&preparation, outlines.collect())
            };
            let (first, second) = (draw(40), draw(24));
            let mean = |shapes: &ShapesInMemory| {
                let Preparation { metric, method, matching, .. } = &preparation;
                mean_shape(shapes, metric, method, Frame::Training, matching).unwrap().whitened
            };
            let to = Preparation { mean: mean(&first), ..preparation.clone() };
            observed += angle(&to, &mean(&second)).unwrap().powi(2);
            wanted += expected(&to, Frame::Training, &first, [40, 24], &|| false).unwrap().powi(2);
        }
        let ratio = (wanted / observed).sqrt();
        assert!((0.75..1.35).contains(&ratio), "{ratio}");
    }
}
