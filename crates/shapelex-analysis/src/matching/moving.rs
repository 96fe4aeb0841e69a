//! The search for the motion of the parameters of a surface that matches the mean best.
//!
//! ```text
//! rest(γ) = residual of the best fit of T_γ x to the mean     least over rotations of the parameter sphere, or starts
//! ```
//!
//! A search by halving steps from several starts: the rest has several minima.

use super::{Matching, Placement, Target};
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory, map_shapes};
use crate::fit::Scaling;
use crate::metric::dot;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::surface::motion::{Motion, Motions};
use shapelex_numeric::dense::Matrix;

/// Steps of a search for the best motion, in 1/1024 turn.
const STEPS: [u16; 4] = [64, 16, 4, 1];

/// Part by which the residual must fall for a motion to replace another: smaller steps would let all shapes drift along together.
const NOTICEABLE: f64 = 1e-3;

/// A motion of those that are spread out is followed if its residual is below so many times that of the best one.
const FOLLOWED: f64 = 3.0;

/// Maximum number of motions that are followed.
const MOST_FOLLOWED: usize = 2;

/// Shapes whose parameterisations are compared with the mean.
const LOOKED_AT: usize = 8;

/// Seed of their choice, which is not a parameter: the answer is a warning.
const LOOKED_AT_SEED: u64 = 0;

/// A parameterisation disagrees with the mean if another one leaves less than this part of its residual.
const DISAGREES: f64 = 0.8;

/// Motions that are tried for that, in 1/1024 turn: small ones, and halves of a turn.
const TRIED: [u16; 4] = [16, 48, 128, 512];

/// Whitened surfaces whose parameters move.
#[derive(Debug, Clone)]
pub(super) struct MovedSurfaces {
    motions: Motions,
    space: ShapeSpace,
    /// The whitened constant 1.
    ones: Vec<f64>,
    /// Whether shapes are centred, as moved ones must be again.
    pub(super) translates: bool,
}

/// Parameterisations of surfaces that do not agree with those of their mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disagreement {
    /// Number of shapes that were looked at.
    pub looked_at: usize,
    /// Number of those that fit the mean better if their parameters move: the residual falls by a fifth or more.
    pub disagreeing: usize,
}

impl MovedSurfaces {
    /// The surfaces of `space`; `None` if its parameters have no [motions](ShapeSpace::motions).
    pub(super) fn new(space: &ShapeSpace, reverses: bool, translates: bool) -> Option<Self> {
        let motions = space.motions(reverses)?;
        let mut ones = vec![1.0; space.representation().size()];
        space.gram().whiten(&mut ones);
        Some(Self { motions, space: space.clone(), ones, translates })
    }

    /// Control points of the whitened surface `x`, `N × 3`.
    fn rows(&self, x: &[f64]) -> Matrix {
        let size = self.ones.len();
        let mut rows = Matrix::from_column_slice(size, x.len() / size, x);
        self.space.gram().unwhiten(rows.as_mut_slice());
        rows
    }

    /// Moves the parameters of the whitened surface `x`. Returns by how much its mean position moved, which is subtracted if shapes
    /// are centred.
    pub(super) fn apply(&self, x: &mut [f64], motion: Motion) -> Vec<f64> {
        let mut moved = self.motions.apply(&self.rows(x), motion);
        self.space.gram().whiten(moved.as_mut_slice());
        x.copy_from_slice(moved.as_slice());
        let weight = dot(&self.ones, &self.ones);
        let centre = |coordinate: &mut [f64]| {
            let mean = if self.translates { dot(&self.ones, coordinate) / weight } else { 0.0 };
            coordinate.iter_mut().zip(&self.ones).for_each(|(value, one)| *value -= mean * one);
            mean
        };
        x.chunks_exact_mut(self.ones.len()).map(centre).collect()
    }

    /// Whether a motion near none, or half a turn, leaves much less of `x` than it leaves as it is.
    fn disagrees(&self, x: &[f64], target: &Target<'_>) -> Result<bool, AnalysisError> {
        let least = DISAGREES * target.rest(x)?;
        for motion in TRIED.iter().flat_map(|steps| self.motions.near(Motion::default(), *steps)) {
            let mut moved = x.to_vec();
            self.apply(&mut moved, motion);
            if target.rest(&moved)? < least {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Matching {
    /// The motion of the parameters in a placement of a surface; `None` if motions are not searched.
    pub fn motion(&self, placement: Placement) -> Option<Motion> {
        self.motions.as_ref().map(|_| Motion::from_code(placement.shift))
    }

    /// Where a search for the placement of the whitened shape `x` begins: as given, or on a sphere where its poles are at the ends of
    /// its long axis, however it was parameterised.
    pub(crate) fn first(&self, x: &[f64]) -> Placement {
        let Some(surfaces) = &self.motions else { return Placement::default() };
        let motion = surfaces.motions.canonical(&surfaces.rows(x));
        Placement { shift: motion.code(), ..Placement::default() }
    }

    /// Relative change of the surface `x` by the motion of its parameters, which its space represents only nearly: root mean square
    /// distance halfway between knots, divided by that of the surface from its centroid. 0 if motions are not searched.
    pub fn change(&self, x: &[f64], placement: Placement) -> f64 {
        let Some(surfaces) = &self.motions else { return 0.0 };
        let still = Placement { shift: 0, ..placement };
        surfaces.motions.change(&surfaces.rows(&self.place(x, still)), Motion::from_code(placement.shift))
    }

    /// The best placement of the surface `x`: from where it stands, and from those motions that are spread out whose scores are near
    /// the best, each followed uphill to the nearest maximum.
    ///
    /// Cost: 24 moved surfaces, some 60 for each start that is followed, and one for each motion that is spread out.
    pub(super) fn best_motion(
        &self,
        surfaces: &MovedSurfaces,
        x: &[f64],
        target: &Target<'_>,
        current: Placement,
    ) -> Result<Placement, AnalysisError> {
        let motions = &surfaces.motions;
        let standing = Motion::from_code(current.shift);
        let rest = |placement: Placement| target.rest(&self.place(x, placement));
        let beats = |rest: f64, best: f64| rest < (1.0 - NOTICEABLE) * best;
        let downhill = |mut best: (Placement, f64)| {
            for steps in STEPS {
                loop {
                    let mut next = best;
                    for motion in motions.near(Motion::from_code(best.0.shift), steps) {
                        let placement = Placement { shift: motion.code(), ..best.0 };
                        let rest = rest(placement)?;
                        if beats(rest, next.1) {
                            next = (placement, rest);
                        }
                    }
                    if next.0 == best.0 {
                        break;
                    }
                    best = next;
                }
            }
            Ok::<_, AnalysisError>(best)
        };
        let mut best = downhill((current, rest(current)?))?;
        let mut others = Vec::new();
        for motion in motions.spread_out() {
            let shift = motions.then(standing, motion).code();
            for candidate in &self.candidates {
                let placement = Placement { shift, ..*candidate };
                others.push((placement, rest(placement)?));
            }
        }
        others.retain(|(_, rest)| *rest < FOLLOWED * best.1);
        others.sort_by(|a, b| a.1.total_cmp(&b.1));
        for other in others.into_iter().take(MOST_FOLLOWED) {
            let found = downhill(other)?;
            if beats(found.1, best.1) {
                best = found;
            }
        }
        Ok(best.0)
    }

    /// Number of surfaces, of a [sample](ShapesInMemory::sample) of at most 8 whose parameters correspond as given, that fit better if
    /// their parameters move; `None` for other shapes, and where parameters are searched. `translates`: whether shapes are centred.
    ///
    /// Cost: a pass over `source`, and at most 24 moved surfaces for each of the 8.
    ///
    /// # Errors
    /// Errors of the source; degenerate shapes.
    pub fn disagreement(
        &self,
        source: &dyn ShapeSource,
        target: &Target<'_>,
        translates: bool,
    ) -> Result<Option<Disagreement>, AnalysisError> {
        let surfaces = if self.moves() { None } else { MovedSurfaces::new(&self.space, true, translates) };
        let Some(surfaces) = surfaces else { return Ok(None) };
        let some = ShapesInMemory::sample(source, LOOKED_AT_SEED, LOOKED_AT)?;
        let found = map_shapes(&some, |_, x, _| surfaces.disagrees(x, target))?;
        let disagreeing = found.iter().filter(|disagrees| **disagrees).count();
        Ok(Some(Disagreement { looked_at: found.len(), disagreeing }))
    }
}

impl Target<'_> {
    /// Residual of the best fit of the shape of `y`: of the dimensions of the mean space those outside that of `y`; the squared
    /// distance from the mean, at the size of the shape or in parts of the squared norms.
    fn rest(&self, y: &[f64]) -> Result<f64, AnalysisError> {
        let score = self.scores_without_shift(y)?;
        Ok(match self {
            Self::Subspace { space, .. } => {
                space.bases.iter().map(Matrix::ncols).sum::<usize>() as f64 - score
            }
            Self::Shape { mean, fit, .. } if fit.scaling == Scaling::None => {
                dot(mean, mean) + dot(y, y) - 2.0 * score
            }
            Self::Shape { mean, .. } => {
                1.0 - score.max(0.0).powi(2) / (dot(y, y) * dot(mean, mean)).max(f64::MIN_POSITIVE)
            }
        })
    }
}
