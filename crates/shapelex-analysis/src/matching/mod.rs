//! Matching: the start point, direction and mirror image of a shape that correspond best to the mean.
//!
//! ```text
//! score(s) = ‖P_{S̄} P_{k,s}‖² = Σ_ij (Σ_n f_j[n] q_i[n + s])²     all s at once by FFT
//! ```
//!
//! Surfaces that close have no finite list of start points: their parameters move ([`Motion`]), and the best motion is searched from
//! motions that are spread out, to 1/1024 turn. A moved surface has another norm, so the rest that a fit leaves counts.
//!
//! The square root of a circulant Gram operator commutes with cyclic shifts, so a shifted shape has the shifted basis.
//! The search alternates with the mean until nothing changes; every step raises the objective. In a tie the current
//! placement wins, then the smallest shift, so rounding decides nothing.

mod moving;

use std::borrow::Cow;

pub use crate::placement::Placement;
pub use moving::Disagreement;
use moving::MovedSurfaces;

use super::AnalysisError;
use super::accumulate::{MergePart, PART, ShapeSource, Shapes, VisitMarked, for_each_changed, map_shapes};
use super::correspondence::{Correspondence, Direction, Mirror};
use super::fit::{Fit, best_correlation, cross_product};
use super::mean::MeanSpace;
use super::pass::Pass;
use super::subspace::Subspace;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::surface::motion::Motion;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::fft::{FftScratch, RealFft};
use shapelex_numeric::kernels::largest;

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

/// Position of a shape that has moved, with its previous placement.
pub(super) type Moved = (usize, Placement);

/// Positions of the shapes that have moved, with their placements `before`.
pub(super) fn moved(before: &[Placement], after: &[Placement]) -> Vec<Moved> {
    let pairs = before.iter().zip(after).enumerate();
    pairs.filter(|(_, (before, after))| before != after).map(|(k, (before, _))| (k, *before)).collect()
}

/// Relative difference below which two scores are equal.
const TIE: f64 = 1e-12;

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
        let moved = || MovedSurfaces::new(space, direction == Direction::Either, true);
        let motions = moves.then(moved).flatten();
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

    /// Whether control points follow each other along a curve: `Some`, with whether it closes.
    pub(crate) fn curve(&self) -> Option<bool> {
        self.space.domain().is_line().then_some(self.commutes)
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

    /// The placement of the mirror image of the curve `x` that fits `x` best: mirrored and reversed, and started where it fits if start
    /// points are searched.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0.
    pub(crate) fn mirror_image(&self, x: &[f64], fit: Fit) -> Result<Placement, AnalysisError> {
        let image = Placement { shift: 0, mirrored: true, reversed: true };
        if !self.shifts() {
            return Ok(image);
        }
        let scores = Target::shape(x, fit, self).scores(&self.place(x, image), self)?;
        let scored = [(image, scores.as_slice())];
        Ok(better(scored.into_iter(), image))
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

    /// The shape `x` in the given placement, and the mean position that was subtracted from it, in the coordinates of the shape as
    /// given; `None` unless parameters moved.
    pub fn place_with_mean<'a>(
        &self,
        x: &'a [f64],
        placement: Placement,
    ) -> (Cow<'a, [f64]>, Option<Vec<f64>>) {
        if placement == Placement::default() {
            return (Cow::Borrowed(x), None);
        }
        let (placed, mut mean) = self.placed(x, placement);
        if let Some(mean) = mean.as_mut().filter(|_| placement.mirrored) {
            mean[0] = -mean[0];
        }
        (Cow::Owned(placed), mean)
    }

    fn placed(&self, x: &[f64], placement: Placement) -> (Vec<f64>, Option<Vec<f64>>) {
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
        let surfaces = self.motions.as_ref().filter(|_| placement.shift != 0);
        let mean = surfaces.map(|surfaces| surfaces.apply(&mut placed, Motion::from_code(placement.shift)));
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
            return self.best_motion(surfaces, x, target, current);
        }
        let scores: Vec<Vec<f64>> = self
            .candidates
            .iter()
            .map(|&candidate| target.scores(&self.place(x, candidate), self))
            .collect::<Result<_, _>>()?;
        let scores = self.candidates.iter().zip(&scores);
        Ok(better(scores.map(|(&candidate, scores)| (candidate, &**scores)), current))
    }

    /// Updates the placement of every shape of `source`; `placements` may have more. Returns the positions of the shapes that moved, with their previous placements.
    ///
    /// # Errors
    /// Errors of the source; degenerate shapes.
    pub fn improve(
        &self,
        source: &dyn ShapeSource,
        target: &Target<'_>,
        placements: &mut [Placement],
    ) -> Result<Vec<(usize, Placement)>, AnalysisError> {
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
pub struct Placed<'a> {
    /// The shapes as given.
    pub source: &'a dyn ShapeSource,
    /// The search that defines the placements.
    pub matching: &'a Matching,
    /// One placement per shape.
    pub placements: &'a [Placement],
}

impl Placed<'_> {
    fn stand_as_given(&self) -> bool {
        self.placements.iter().all(|placement| *placement == Placement::default())
    }

    fn place(&self, batch: Shapes<'_>, whitened: &mut [f64]) {
        let length = whitened.len() / batch.weights.len().max(1);
        for ((k, x, _), placed) in batch.iter().zip(whitened.chunks_exact_mut(length.max(1))) {
            placed.copy_from_slice(&self.matching.place(x, self.placements[k]));
        }
    }
}

impl ShapeSource for Placed<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        if self.stand_as_given() {
            return self.source.for_each_batch(visit);
        }
        let place = |batch: Shapes<'_>, whitened: &mut [f64]| {
            self.place(batch, whitened);
            Ok(())
        };
        for_each_changed(self.source, place, visit)
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.source.for_each_marked(&mut |mut rest, mut marks| {
            // Parts, so that a source in memory is not copied as a whole.
            while !marks.is_empty() {
                let (part, others) = rest.split_at(marks.len().min(PART));
                let (own, left) = marks.split_at(part.weights.len());
                let mut whitened = part.whitened.to_vec();
                self.place(part, &mut whitened);
                visit(Shapes { whitened: &whitened, ..part }, own)?;
                (rest, marks) = (others, left);
            }
            Ok(())
        })
    }

    /// Only this process knows the placements, so the pass is distributed only while all shapes stand as given.
    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        Ok(self.stand_as_given() && self.source.spread(pass, merge)?)
    }
}
