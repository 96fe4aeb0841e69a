//! Matching: the start point, direction and mirror image of a shape that correspond best to the mean.
//!
//! ```text
//! score(s) = ‖P_{S̄} P_{k,s}‖² = Σ_ij (Σ_n f_j[n] q_i[n + s])²     all s at once by FFT
//! ```
//!
//! Surfaces that close have no finite list of start points: their parameters move ([`Motion`]), and the best motion is searched from
//! motions that are spread out, to 1/1024 turn. A moved surface has another norm, so what counts is the rest that a fit leaves.
//!
//! The square root of a circulant Gram operator commutes with cyclic shifts, so a shifted shape has the shifted basis.
//! The search alternates with the mean until nothing changes; every step raises the objective. In a tie the current
//! placement wins, then the smallest shift, so rounding decides nothing.

use std::borrow::Cow;

use super::AnalysisError;
use super::accumulate::{MergePart, ShapeSource, Shapes, ShapesInMemory, for_each_changed, map_shapes};
use super::correspondence::{Correspondence, Direction, Mirror};
use super::fit::{Fit, Scaling, best_correlation, cross_product};
use super::mean::MeanSpace;
use super::metric::dot;
use super::pass::Pass;
use super::subspace::Subspace;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::surface::motion::{Motion, Motions};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::fft::{FftScratch, RealFft};
use shapelex_numeric::kernels::largest;

/// Placement of one shape on the mean: mirrored (first coordinate negated), then reversed (`u → −u`, end to end
/// for open curves), then started at row `shift`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Placement {
    /// Row at which a contour starts; on surfaces the [code](Motion::code) of the motion of its parameters.
    pub shift: u32,
    /// Whether the shape is traversed backwards.
    pub reversed: bool,
    /// Whether the first coordinate is negated.
    pub mirrored: bool,
}

/// The placements to search for a set of shapes.
#[derive(Debug, Clone)]
pub struct Matching {
    size: usize,
    dimension: usize,
    fft: Option<RealFft>,
    motions: Option<MovedSurfaces>,
    space: ShapeSpace,
    /// Whether reversal commutes with whitening, as it does on closed curves.
    commutes: bool,
    candidates: Vec<Placement>,
}

/// The motions of the parameters of surfaces.
#[derive(Debug, Clone)]
struct MovedSurfaces {
    motions: Motions,
    /// The whitened constant 1.
    ones: Vec<f64>,
    /// Whether shapes are centred, as moved ones must be again.
    translates: bool,
}

impl Placement {
    /// Whether both differ at most in the start point.
    pub(super) fn is_image_of(self, other: Self) -> bool {
        (self.mirrored, self.reversed) == (other.mirrored, other.reversed)
    }
}

/// Parameterisations of surfaces that do not agree with those of their mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disagreement {
    /// Number of shapes that were looked at.
    pub looked_at: usize,
    /// Number of those that fit the mean better if their parameters move: what is left falls by a fifth or more.
    pub disagreeing: usize,
}

/// Position of a shape that has moved, with its previous placement.
pub(super) type Moved = (usize, Placement);

/// Positions of the shapes that have moved, with their placements `before`.
pub(super) fn moved(before: &[Placement], after: &[Placement]) -> Vec<Moved> {
    let pairs = before.iter().zip(after).enumerate();
    pairs.filter(|(_, (before, after))| before != after).map(|(k, (before, _))| (k, *before)).collect()
}

/// Relative difference below which two scores are equal.
const TIE: f64 = 1e-12;

/// Steps of a search for the best motion, in 1/1024 turn.
const STEPS: [u16; 4] = [64, 16, 4, 1];

/// Part by which what is left must fall for a motion to replace another: smaller steps would let all shapes drift along together.
const NOTICEABLE: f64 = 1e-3;

/// A motion of those that are spread out is followed if it leaves less than so many times what the best one leaves.
const FOLLOWED: f64 = 3.0;

/// Maximum number of motions that are followed.
const MOST_FOLLOWED: usize = 2;

/// Shapes whose parameterisations are compared with the mean.
const LOOKED_AT: usize = 8;

/// A parameterisation disagrees with the mean if another one leaves less than this part of what it leaves.
const DISAGREES: f64 = 0.8;

/// Motions that are tried for that, in 1/1024 turn: small ones, and halves of a turn.
const TRIED: [u16; 4] = [16, 48, 128, 512];

/// The placement with the largest score, from those of all candidates at all start points. In a tie the `current` one wins,
/// then the first.
pub(super) fn better<'s>(
    scores: impl Iterator<Item = (Placement, &'s [f64])> + Clone,
    current: Placement,
) -> Placement {
    let standing = scores.clone().find(|(candidate, _)| candidate.is_image_of(current));
    let standing = standing.map_or(f64::MIN, |(_, scores)| scores[current.shift as usize]);
    let mut best = (current, standing);
    let beats = |score: f64, best: f64| score > best + TIE * best.abs();
    for (candidate, scores) in scores {
        // Most shapes stay where they are.
        if !beats(largest(scores), best.1) {
            continue;
        }
        for (shift, &score) in scores.iter().enumerate() {
            if beats(score, best.1) {
                best = (Placement { shift: shift as u32, ..candidate }, score);
            }
        }
    }
    best.0
}

impl Matching {
    /// The search for shapes of `space`.
    ///
    /// Mirroring a planar closed contour reverses its direction, so the contour is also traversed backwards, unless points
    /// correspond as landmarks. Mirroring a surface turns it inside out, so `u` is traversed backwards. Planar closed contours
    /// are brought to one direction beforehand. Open curves, closed curves in space, cylinders and tori are tried in both directions
    /// under [`Direction::Either`].
    pub fn new(
        space: &ShapeSpace,
        correspondence: Correspondence,
        direction: Direction,
        mirror: Mirror,
    ) -> Self {
        let representation = space.representation();
        let (size, dimension) = (representation.size(), representation.dimension());
        let contour = correspondence != Correspondence::Landmarks && space.domain().is_line();
        let closed_planar = representation.is_closed() && dimension == 2;
        let reversals: &[bool] = if contour && !closed_planar && direction == Direction::Either {
            &[false, true]
        } else {
            &[false]
        };
        let turned = contour && closed_planar || space.domain().is_sheet();
        let mirrors: &[bool] = if mirror == Mirror::Allow { &[false, true] } else { &[false] };
        let candidates = mirrors
            .iter()
            .flat_map(|&mirrored| reversals.iter().map(move |&reversed| (mirrored, reversed)))
            .map(|(mirrored, reversed)| Placement {
                shift: 0,
                mirrored,
                reversed: reversed ^ (mirrored && turned),
            })
            .collect();
        let fft = (correspondence == Correspondence::Cyclic && contour).then(|| RealFft::new(size));
        let moves = correspondence == Correspondence::Cyclic;
        let motions = moves.then(|| space.motions(direction == Direction::Either)).flatten();
        let motions = motions.map(|motions| {
            let mut ones = vec![1.0; size];
            space.gram().whiten(&mut ones);
            MovedSurfaces { motions, ones, translates: true }
        });
        let commutes = representation.is_closed();
        Self { size, dimension, fft, motions, space: space.clone(), commutes, candidates }
    }

    /// The same search for shapes that are prepared for a class with or without translations. Default: with.
    pub fn translating(mut self, translates: bool) -> Self {
        if let Some(surfaces) = &mut self.motions {
            surfaces.translates = translates;
        }
        self
    }

    /// `N`.
    pub(super) fn size(&self) -> usize {
        self.size
    }

    /// `d`.
    pub(super) fn dimension(&self) -> usize {
        self.dimension
    }

    /// The transform that searches start points. `None` if they are not searched.
    pub(super) fn fft(&self) -> Option<&RealFft> {
        self.fft.as_ref()
    }

    /// Directions and mirror images to try; the shape as given comes first.
    pub(super) fn candidates(&self) -> &[Placement] {
        &self.candidates
    }

    /// Whether there is anything to search.
    pub fn searches(&self) -> bool {
        self.fft.is_some() || self.moves() || self.candidates.len() > 1
    }

    /// Whether motions of the parameters of surfaces are searched.
    pub fn moves(&self) -> bool {
        self.motions.is_some()
    }

    /// The motion of the parameters in a placement of a surface; `None` if motions are not searched.
    pub fn motion(&self, placement: Placement) -> Option<Motion> {
        self.motions.as_ref().map(|_| Motion::from_code(placement.shift))
    }

    /// Where a search for the placement of the whitened shape `x` begins: as given, or on a sphere where its poles are at the ends of
    /// its long axis, however it was parameterised.
    pub(super) fn first(&self, x: &[f64]) -> Placement {
        let Some(surfaces) = &self.motions else { return Placement::default() };
        let motion = surfaces.motions.canonical(&self.rows(x));
        Placement { shift: motion.code(), ..Placement::default() }
    }

    /// Relative change of the surface `x` by the motion of its parameters, which its space represents only nearly: root mean square
    /// distance halfway between knots, divided by that of the surface from its centroid. 0 if motions are not searched.
    pub fn change(&self, x: &[f64], placement: Placement) -> f64 {
        let Some(surfaces) = &self.motions else { return 0.0 };
        let still = Placement { shift: 0, ..placement };
        surfaces.motions.change(&self.rows(&self.place(x, still)), Motion::from_code(placement.shift))
    }

    /// Control points of the whitened shape `x`, `N × d`.
    fn rows(&self, x: &[f64]) -> Matrix {
        let mut rows = Matrix::from_column_slice(self.size, self.dimension, x);
        self.space.gram().unwhiten(rows.as_mut_slice());
        rows
    }

    /// Moves the parameters of the whitened shape `x`. Returns by how much its mean position moved, which is subtracted if shapes
    /// are centred.
    fn move_parameters(&self, surfaces: &MovedSurfaces, x: &mut [f64], motion: Motion) -> Vec<f64> {
        let mut moved = surfaces.motions.apply(&self.rows(x), motion);
        self.space.gram().whiten(moved.as_mut_slice());
        x.copy_from_slice(moved.as_slice());
        let (ones, weight) = (&surfaces.ones, dot(&surfaces.ones, &surfaces.ones));
        let centre = |coordinate: &mut [f64]| {
            let mean = if surfaces.translates { dot(ones, coordinate) / weight } else { 0.0 };
            coordinate.iter_mut().zip(ones).for_each(|(value, one)| *value -= mean * one);
            mean
        };
        x.chunks_exact_mut(self.size).map(centre).collect()
    }

    /// Whether start points are searched.
    pub fn shifts(&self) -> bool {
        self.fft.is_some()
    }

    /// The whitened shape `x` started `offset` control points later, by trigonometric interpolation; unchanged if start
    /// points are not searched.
    pub fn between(&self, x: &[f64], offset: f64) -> Vec<f64> {
        let Some(fft) = self.fft.as_ref().filter(|_| offset != 0.0) else { return x.to_vec() };
        let n = fft.len();
        let (mut scratch, mut moved) = (fft.scratch(), x.to_vec());
        for (coordinate, mut spectrum) in moved.chunks_exact_mut(n).zip(spectra(fft, x)) {
            for (k, value) in spectrum.iter_mut().enumerate() {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 * offset / n as f64).sin_cos();
                // At an even length, the highest frequency has a cosine only.
                *value *= realfft::num_complex::Complex64::new(cos, if 2 * k == n { 0.0 } else { sin });
            }
            fft.inverse(&mut spectrum, coordinate, &mut scratch);
        }
        moved
    }

    /// Whether mirror images are tried.
    pub fn mirrors(&self) -> bool {
        self.candidates.iter().any(|candidate| candidate.mirrored)
    }

    /// The shape `x` (coordinate-major, `d·N`) in the given placement.
    pub fn place<'a>(&self, x: &'a [f64], placement: Placement) -> Cow<'a, [f64]> {
        if placement == Placement::default() {
            return Cow::Borrowed(x);
        }
        Cow::Owned(self.placed(x, placement).0)
    }

    /// The mean position of the shape `x` in its placement, in the coordinates of the shape as given: it was subtracted from
    /// what [`Self::place`] gives, and is 0 unless parameters move.
    pub fn mean_position(&self, x: &[f64], placement: Placement) -> Vec<f64> {
        let mut mean = self.placed(x, placement).1;
        if placement.mirrored {
            mean[0] = -mean[0];
        }
        mean
    }

    fn placed(&self, x: &[f64], placement: Placement) -> (Vec<f64>, Vec<f64>) {
        let n = self.size;
        let mut placed = x.to_vec();
        for (c, coordinate) in placed.chunks_exact_mut(n).enumerate() {
            if placement.mirrored && c == 0 {
                coordinate.iter_mut().for_each(|value| *value = -*value);
            }
            if placement.reversed && self.commutes {
                self.space.reverse(coordinate);
            } else if placement.reversed {
                self.space.gram().unwhiten(coordinate);
                self.space.reverse(coordinate);
                self.space.gram().whiten(coordinate);
            }
            if self.motions.is_none() {
                coordinate.rotate_left(placement.shift as usize);
            }
        }
        let motion = Motion::from_code(placement.shift);
        let mean = match &self.motions {
            Some(surfaces) if motion != Motion::default() => {
                self.move_parameters(surfaces, &mut placed, motion)
            }
            _ => vec![0.0; self.dimension],
        };
        (placed, mean)
    }

    /// `diag(±1, 1, …)`: the linear part of a placement.
    pub fn reflection(&self, placement: Placement) -> Matrix {
        let mut reflection = Matrix::identity(self.dimension, self.dimension);
        if placement.mirrored {
            reflection[(0, 0)] = -1.0;
        }
        reflection
    }

    /// The best placement of `x` for `target`, starting from its current placement.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0.
    pub fn best(
        &self,
        x: &[f64],
        target: &Target<'_>,
        current: Placement,
    ) -> Result<Placement, AnalysisError> {
        if let Some(surfaces) = &self.motions {
            return self.best_motion(&surfaces.motions, x, target, current);
        }
        let scores: Vec<Vec<f64>> = self
            .candidates
            .iter()
            .map(|&candidate| target.scores(&self.place(x, candidate), self))
            .collect::<Result<_, _>>()?;
        let scores = self.candidates.iter().zip(&scores);
        Ok(better(scores.map(|(&candidate, scores)| (candidate, &**scores)), current))
    }

    /// The best placement of the surface `x`: from where it stands, and from those motions that are spread out whose scores are near
    /// the best, each followed uphill to the nearest maximum.
    ///
    /// Cost: 24 moved surfaces, some 60 for each start that is followed, and one for each motion that is spread out.
    fn best_motion(
        &self,
        motions: &Motions,
        x: &[f64],
        target: &Target<'_>,
        current: Placement,
    ) -> Result<Placement, AnalysisError> {
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

    /// Of surfaces whose parameters correspond as given, how many of at most 8, evenly spread over `source`, fit the target better if
    /// their parameters move; `None` for other shapes, and where parameters are searched.
    ///
    /// # Errors
    /// Errors of the source; degenerate shapes.
    pub fn disagreement<S: ShapeSource>(
        &self,
        source: &S,
        target: &Target<'_>,
        translates: bool,
    ) -> Result<Option<Disagreement>, S::Error> {
        if self.moves() {
            return Ok(None);
        }
        let moving = Self::new(&self.space, Correspondence::Cyclic, Direction::Either, Mirror::Forbid);
        let moving = moving.translating(translates);
        let Some(surfaces) = &moving.motions else { return Ok(None) };
        let some = ShapesInMemory::spread_out(source, LOOKED_AT)?;
        let disagrees = |_: usize, x: &[f64], _: f64| {
            let least = DISAGREES * target.rest(x)?;
            for motion in TRIED.iter().flat_map(|steps| surfaces.motions.near(Motion::default(), *steps)) {
                let placement = Placement { shift: motion.code(), ..Placement::default() };
                if target.rest(&moving.place(x, placement))? < least {
                    return Ok(true);
                }
            }
            Ok(false)
        };
        let found = map_shapes(&some, disagrees)?;
        let disagreeing = found.iter().filter(|disagrees| **disagrees).count();
        Ok(Some(Disagreement { looked_at: found.len(), disagreeing }))
    }

    /// Updates the placement of every shape of `source`; `placements` may have more. Returns the positions of the shapes that moved, with their previous placements.
    ///
    /// # Errors
    /// Errors of the source; degenerate shapes.
    pub fn improve<S: ShapeSource>(
        &self,
        source: &S,
        target: &Target<'_>,
        placements: &mut [Placement],
    ) -> Result<Vec<(usize, Placement)>, S::Error> {
        let standing = &*placements;
        let improved =
            map_shapes(source, |k, x, _| self.best(x, target, standing[k]).map_err(|error| error.at(k)))?;
        let placements = &mut placements[..improved.len()];
        let moved = moved(placements, &improved);
        placements.copy_from_slice(&improved);
        Ok(moved)
    }
}

/// Target to which shapes are matched.
#[derive(Debug)]
pub enum Target<'a> {
    /// A mean space; the score is the squared cosine between subspaces.
    Subspace {
        /// The mean space.
        space: &'a MeanSpace<'a>,
        /// Spectra of its basis functions per block: one per basis function and coordinate.
        spectra: Vec<Vec<Spectrum>>,
    },
    /// A mean shape; the score is the correlation after the best fit.
    Shape {
        /// Whitened mean shape.
        mean: &'a [f64],
        /// The kind of fit.
        fit: Fit,
        /// Spectrum of every coordinate.
        spectra: Vec<Spectrum>,
    },
}

type Spectrum = Vec<realfft::num_complex::Complex64>;

impl<'a> Target<'a> {
    /// A target that matches subspaces with `space`.
    pub fn subspace(space: &'a MeanSpace<'a>, matching: &Matching) -> Self {
        let spectra = match &matching.fft {
            None => Vec::new(),
            Some(fft) => space.bases.iter().map(|base| spectra(fft, base.as_slice())).collect(),
        };
        Self::Subspace { space, spectra }
    }

    /// A target that matches shapes with the whitened `mean` under `fit`.
    pub fn shape(mean: &'a [f64], fit: Fit, matching: &Matching) -> Self {
        let spectra = matching.fft.as_ref().map_or_else(Vec::new, |fft| spectra(fft, mean));
        Self::Shape { mean, fit, spectra }
    }

    /// The score of `y` at its current start point.
    fn scores_without_shift(&self, y: &[f64]) -> Result<f64, AnalysisError> {
        match self {
            Self::Subspace { space, .. } => {
                let blocks = Subspace::new(space.class, y)?.blocks;
                let cosines = blocks.iter().zip(&space.bases);
                Ok(cosines.map(|(block, base)| block.q.tr_mul(base).norm_squared()).sum())
            }
            Self::Shape { mean, fit, .. } => {
                Ok(best_correlation(&cross_product(mean, y, fit.dimension), *fit))
            }
        }
    }

    /// What the best fit of the shape of `y` leaves: of the dimensions of the mean space those outside that of `y`; the squared
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

    /// The score of `y` for every shift to search.
    fn scores(&self, y: &[f64], matching: &Matching) -> Result<Vec<f64>, AnalysisError> {
        let Some(fft) = &matching.fft else {
            return Ok(vec![self.scores_without_shift(y)?]);
        };
        let n = fft.len();
        let mut scratch = fft.scratch();
        let mut scores = vec![0.0; n];
        match self {
            Self::Subspace { space, spectra: targets } => {
                let blocks = Subspace::new(space.class, y)?.blocks;
                for (block, target) in blocks.iter().zip(targets) {
                    let coordinates = block.q.nrows() / n;
                    let own = spectra(fft, block.q.as_slice());
                    for q in own.chunks_exact(coordinates) {
                        for f in target.chunks_exact(coordinates) {
                            let correlation = correlate(fft, f, q, &mut scratch);
                            scores.iter_mut().zip(correlation).for_each(|(sum, r)| *sum += r * r);
                        }
                    }
                }
            }
            Self::Shape { fit, spectra: target, .. } => {
                let d = fit.dimension;
                let own = spectra(fft, y);
                let mut products = vec![Matrix::zeros(d, d); n];
                for c in 0..d {
                    for e in 0..d {
                        let correlation = correlate(fft, &target[c..=c], &own[e..=e], &mut scratch);
                        products.iter_mut().zip(correlation).for_each(|(h, r)| h[(c, e)] = r);
                    }
                }
                scores.iter_mut().zip(&products).for_each(|(score, h)| *score = best_correlation(h, *fit));
            }
        }
        Ok(scores)
    }
}

fn spectra(fft: &RealFft, columns: &[f64]) -> Vec<Spectrum> {
    let mut scratch = fft.scratch();
    columns
        .chunks_exact(fft.len())
        .map(|column| {
            let mut spectrum = vec![Default::default(); fft.spectrum_len()];
            fft.forward(column, &mut spectrum, &mut scratch);
            spectrum
        })
        .collect()
}

/// `Σ_c Σ_n f_c[n] q_c[n + s]` for all `s`.
fn correlate(fft: &RealFft, f: &[Spectrum], q: &[Spectrum], scratch: &mut FftScratch) -> Vec<f64> {
    let mut product: Spectrum = vec![Default::default(); fft.spectrum_len()];
    for (f, q) in f.iter().zip(q) {
        product.iter_mut().zip(f.iter().zip(q)).for_each(|(sum, (f, q))| *sum += f.conj() * q);
    }
    let mut correlation = vec![0.0; fft.len()];
    fft.inverse(&mut product, &mut correlation, scratch);
    correlation
}

/// A source whose shapes are read in their placements.
pub struct Placed<'a, S> {
    /// The shapes as given.
    pub source: &'a S,
    /// The search that defines the placements.
    pub matching: &'a Matching,
    /// One placement per shape.
    pub placements: &'a [Placement],
}

impl<S> Placed<'_, S> {
    fn stand_as_given(&self) -> bool {
        self.placements.iter().all(|placement| *placement == Placement::default())
    }
}

impl<S: ShapeSource> ShapeSource for Placed<'_, S> {
    type Error = S::Error;

    fn count(&self) -> usize {
        self.source.count()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), Self::Error>,
    ) -> Result<(), Self::Error> {
        if self.stand_as_given() {
            return self.source.for_each_batch(visit);
        }
        let place = |batch: Shapes<'_>, whitened: &mut [f64]| {
            let length = whitened.len() / batch.weights.len().max(1);
            for ((k, x, _), placed) in batch.iter().zip(whitened.chunks_exact_mut(length.max(1))) {
                placed.copy_from_slice(&self.matching.place(x, self.placements[k]));
            }
            Ok(())
        };
        for_each_changed(self.source, place, visit)
    }

    /// Only this process knows the placements, so the pass is distributed only while all shapes stand as given.
    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, Self::Error> {
        Ok(self.stand_as_given() && self.source.spread(pass, merge)?)
    }
}
