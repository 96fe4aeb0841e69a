//! Sliding that converges: displacements from the points as given, with the mean 0 over the shapes.
//!
//! Directions are taken once. Those of surface sliders are common to all shapes: the two leading directions of the sum of all tangent planes
//! in the common pose, turned into the tangent plane of each shape, as otherwise their mean would mean nothing. A round solves the
//! criterion from the given points against the consensus in the pose and size of the shape, subtracts the mean, and superimposes. The
//! fixed point is the same in any order of shapes: they are worked through in the order of their contents.

use super::Slid;
use super::directions::{
    Direction, SlidingCriterion, bending, difference, displaced, displacements, dot, of_curves, of_surface,
    point,
};
use super::error::SlidingError;
use super::superimposed::{Superimposed, distance, principal_axes, superimpose};
use super::table::Sliders;
use crate::anderson::Anderson;
use crate::fit::transform;
use crate::metric::norm;
use crate::unit_size::{Placed, unit};
use crate::watch::Watch;
use shapelex_numeric::dense::{Matrix, svd, symmetric_eigen};
use shapelex_numeric::parallel;

/// Most rounds; with acceleration, some tens are usual.
pub const ROUNDS: usize = 1000;
/// Move of the consensus at which it has converged.
const STILL: f64 = 1e-12;
/// Root of the mean square of what a round changes in the displacements of a shape, at the same time.
const SAME: f64 = 1e-11;

/// A shape at unit size with its directions.
struct Specimen {
    points: Vec<f64>,
    place: Placed,
    directions: Vec<Direction>,
}

/// Slides shapes (coordinate-major) until nothing changes. Cost of a round: `p³`, and `m³/3` for each shape.
///
/// # Errors
/// Shapes without extent; sliders without a direction, or that are not determined; [`SlidingError::Cancelled`].
pub fn slide(
    shapes: &[Vec<f64>],
    sliders: &Sliders,
    (dimension, criterion): (usize, SlidingCriterion),
    watch: &dyn Watch,
) -> Result<Slid, SlidingError> {
    let mut order: Vec<usize> = (0..shapes.len()).collect();
    order.sort_by(|&a, &b| by_content(&shapes[a], &shapes[b]));
    let numbered = |error: SlidingError| error.numbered(&order);
    let sorted: Vec<&[f64]> = order.iter().map(|&k| shapes[k].as_slice()).collect();
    let state = State::new(&sorted, sliders, (dimension, criterion)).map_err(numbered)?;
    let mut found = state.run(watch).map_err(numbered)?;
    let mut places = vec![0; order.len()];
    order.iter().enumerate().for_each(|(place, &k)| places[k] = place);
    let unsorted =
        |list: &mut Vec<Vec<f64>>| *list = places.iter().map(|&k| std::mem::take(&mut list[k])).collect();
    unsorted(&mut found.aligned);
    found.points.iter_mut().for_each(unsorted);
    found.displacements.iter_mut().for_each(unsorted);
    Ok(found)
}

/// Order of two shapes by their numbers: by the first that differs, then by how many there are.
pub(super) fn by_content(a: &[f64], b: &[f64]) -> std::cmp::Ordering {
    let unequal = a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne());
    unequal.unwrap_or(a.len().cmp(&b.len()))
}

/// Shapes with their directions, and their common pose as given.
struct State<'a> {
    sliders: &'a Sliders,
    dimension: usize,
    criterion: SlidingCriterion,
    specimens: Vec<Specimen>,
    /// Shapes as given, superimposed.
    placed: Superimposed,
}

/// Result of displacements: shapes in the common pose, and their places and sizes after they have slid.
struct Posed {
    superimposed: Superimposed,
    places: Vec<Placed>,
}

impl<'a> State<'a> {
    fn new(
        shapes: &[&[f64]],
        sliders: &'a Sliders,
        (dimension, criterion): (usize, SlidingCriterion),
    ) -> Result<Self, SlidingError> {
        let specimens = parallel::try_map(shapes.len(), &|shape| {
            let (points, place) = unit(shapes[shape], dimension);
            if !(place.size > 0.0) {
                return Err(SlidingError::NoExtent { shape });
            }
            let directions = of_curves(&points, dimension, sliders)
                .map_err(|point| SlidingError::NoDirection { shape, point })?;
            Ok(Specimen { points, place, directions })
        })?;
        let units: Vec<Vec<f64>> = specimens.iter().map(|one| one.points.clone()).collect();
        let placed = superimpose(&units, &units[0], dimension);
        let mut state = Self { sliders, dimension, criterion, specimens, placed };
        state.add_surfaces()?;
        Ok(state)
    }

    /// Adds the directions of the surface sliders, in a common frame.
    fn add_surfaces(&mut self) -> Result<(), SlidingError> {
        for &slider in &self.sliders.surface {
            let planes = parallel::try_map(self.specimens.len(), &|shape| {
                let axes = of_surface(&self.specimens[shape].points, slider)
                    .map_err(|point| SlidingError::NoDirection { shape, point })?;
                Ok(Matrix::from_fn(3, 2, |c, k| axes[k][c]))
            })?;
            let mut projectors = Matrix::zeros(3, 3);
            for (plane, turn) in planes.iter().zip(&self.placed.rotations) {
                let common = turn * plane;
                projectors += &common * common.transpose();
            }
            let frame = leading_two(&projectors);
            for ((specimen, plane), turn) in
                self.specimens.iter_mut().zip(&planes).zip(&self.placed.rotations)
            {
                let projected = plane * (plane.transpose() * (turn.transpose() * &frame));
                let turned = polar(&projected).unwrap_or_else(|| plane.clone());
                specimen.directions.extend([0, 1].map(|k| {
                    let along = [turned[(0, k)], turned[(1, k)], turned[(2, k)]];
                    Direction { point: slider, along }
                }));
            }
        }
        Ok(())
    }

    /// Superimposes the shapes after displacements, beginning with `consensus`.
    fn place(&self, displacements: &[f64], consensus: &[f64]) -> Posed {
        let (d, m) = (self.dimension, self.sliders.directions());
        let slid = parallel::map(self.specimens.len(), &|k| {
            let one = &self.specimens[k];
            unit(&displaced(&one.points, &one.directions, &displacements[k * m..(k + 1) * m], d), d)
        });
        let (units, places): (Vec<_>, Vec<_>) = slid.into_iter().unzip();
        Posed { superimposed: superimpose(&units, consensus, d), places }
    }

    /// Displacements that the criterion asks for, with the mean 0.
    fn wanted(&self, posed: &Posed) -> Result<Vec<f64>, SlidingError> {
        let (d, m) = (self.dimension, self.sliders.directions());
        let consensus = &posed.superimposed.consensus;
        let bending = match self.criterion {
            SlidingCriterion::BendingEnergy => Some(bending(consensus, d, self.sliders)?),
            SlidingCriterion::Procrustes => None,
        };
        let count = self.specimens.len();
        let found = parallel::try_map(count, &|shape| {
            let one = &self.specimens[shape];
            let place = &posed.places[shape];
            let mut target = transform(&posed.superimposed.rotations[shape].transpose(), consensus);
            let size = target.len() / d;
            for (k, x) in target.iter_mut().enumerate() {
                *x = place.centre[k / size] + place.size * *x;
            }
            displacements(&one.points, &target, &one.directions, (d, bending.as_ref()))
                .ok_or(SlidingError::Free { shape })
        })?;
        let mut found = found.concat();
        for j in 0..m {
            let mean = (0..count).map(|k| found[k * m + j]).sum::<f64>() / count as f64;
            (0..count).for_each(|k| found[k * m + j] -= mean);
        }
        Ok(found)
    }

    fn run(&self, watch: &dyn Watch) -> Result<Slid, SlidingError> {
        let mut displacements = vec![0.0; self.specimens.len() * self.sliders.directions()];
        let mut posed = self.place(&displacements, &self.placed.consensus);
        let mut anderson = Anderson::default();
        let (mut rounds, mut last_move, mut converged) = (0, f64::INFINITY, false);
        for round in 1..=ROUNDS {
            if watch.stop() {
                return Err(SlidingError::Cancelled);
            }
            rounds = round;
            let wanted = self.wanted(&posed)?;
            let step: Vec<f64> = wanted.iter().zip(&displacements).map(|(new, old)| new - old).collect();
            let change = norm(&step) / (self.specimens.len() as f64).sqrt();
            let next = anderson.next(&displacements, &step);
            // The last round is a plain one.
            let consensus = posed.superimposed.consensus.clone();
            converged = change < SAME && last_move < STILL;
            displacements = if converged { wanted } else { next };
            posed = self.place(&displacements, &consensus);
            last_move = distance(&posed.superimposed.consensus, &consensus);
            if converged {
                break;
            }
        }
        Ok(self.slid(&displacements, posed, (rounds, last_move, converged)))
    }

    fn slid(
        &self,
        displacements: &[f64],
        posed: Posed,
        (rounds, last_move, converged): (usize, f64, bool),
    ) -> Slid {
        let (d, m) = (self.dimension, self.sliders.directions());
        let Superimposed { aligned, consensus, .. } = posed.superimposed;
        let axes = principal_axes(&consensus, d);
        let own = |k: usize| &displacements[k * m..(k + 1) * m];
        let points = |(k, one): (usize, &Specimen)| {
            let slid = displaced(&one.points, &one.directions, own(k), d);
            let size = slid.len() / d;
            let given = |(i, x): (usize, f64)| one.place.centre[i / size] + one.place.size * x;
            slid.into_iter().enumerate().map(given).collect::<Vec<f64>>()
        };
        let along = |k: usize| own(k)[..self.sliders.curves.len()].iter().map(|t| -t).collect::<Vec<f64>>();
        Slid {
            consensus: transform(&axes, &consensus),
            aligned: aligned.iter().map(|shape| transform(&axes, shape)).collect(),
            points: Some(self.specimens.iter().enumerate().map(points).collect()),
            displacements: Some((0..self.specimens.len()).map(along).collect()),
            rounds,
            last_move,
            converged,
            criterion: Vec::new(),
            passed: (0..self.specimens.len()).map(|k| self.passed(k, own(k))).sum(),
        }
    }

    /// Number of curve sliders of a shape that have moved farther than their neighbour on that side is away.
    fn passed(&self, shape: usize, displacements: &[f64]) -> usize {
        let points = &self.specimens[shape].points;
        let at = |k: usize| point(points, self.dimension, k);
        let passes = |(row, by): &(&[usize; 3], &f64)| {
            let [before, slide, after] = **row;
            let apart = difference(at(if **by > 0.0 { before } else { after }), at(slide));
            **by * **by > dot(apart, apart)
        };
        self.sliders.curves.iter().zip(displacements).filter(passes).count()
    }
}

/// Eigenvectors of the two largest eigenvalues of a symmetric `3 × 3` matrix.
fn leading_two(matrix: &Matrix) -> Matrix {
    let pairs = symmetric_eigen(matrix);
    let least = pairs.eigenvalues.imin();
    let kept: Vec<usize> = (0..3).filter(|k| *k != least).collect();
    pairs.eigenvectors.select_columns(&kept)
}

/// The orthonormal columns nearest to those of a `3 × 2` matrix; `None` if it has no rank.
fn polar(matrix: &Matrix) -> Option<Matrix> {
    let found = svd(matrix.clone(), true, true)?;
    Some(found.u? * found.v_t?)
}
