//! The iteration of geomorph's `gpagen`, for reproduction.
//!
//! All shapes are rotated onto the first one. A round slides the shapes of the last round against the mean, whose directions are taken
//! anew, and rotates them onto it. It ends with the tenth round, or when `|Σ y|²/n` changes by less than 10⁻⁴; the consensus still moves
//! then. Shapes are not centred or scaled again.
//!
//! Source: geomorph 4.0.8, of which only the arithmetic is taken: equal to 10⁻¹⁰.

use super::Slid;
use super::directions::{
    Direction, SlidingCriterion, bending, displaced, displacements, of_curves, of_surface,
};
use super::error::SlidingError;
use super::superimposed::{distance, principal_axes, rotated, sum};
use super::table::Sliders;
use crate::fit::transform;
use crate::metric::{dot, norm};
use crate::unit_size::unit;
use crate::watch::Watch;
use shapelex_numeric::parallel;

/// Last round, counted from the superimposition.
const ROUNDS: usize = 10;
/// Change of the criterion at which it ends.
const TOLERANCE: f64 = 1e-4;

/// Slides shapes (coordinate-major) as `gpagen` does. `project`: into the tangent space at their mean; `turn`: by the principal axes of the
/// consensus. Cost of a round: `p³`, and `m³/3` for each shape.
///
/// # Errors
/// Shapes without extent; sliders without a direction, or that are not determined; [`SlidingError::Cancelled`].
pub fn slide(
    shapes: &[Vec<f64>],
    sliders: &Sliders,
    (dimension, criterion): (usize, SlidingCriterion),
    [project, turn]: [bool; 2],
    watch: &dyn Watch,
) -> Result<Slid, SlidingError> {
    let units = units(shapes, dimension)?;
    let count = units.len() as f64;
    let square = |shapes: &[Vec<f64>]| {
        let total = sum(shapes);
        dot(&total, &total) / count
    };
    let (mut aligned, _) = rotated(&units, &units[0], dimension);
    let mut consensus: Vec<f64> = sum(&aligned).iter().map(|x| x / count).collect();
    let (mut before, mut values, mut rounds, mut last_move) = (square(&aligned), Vec::new(), 1, 0.0);
    let mut converged = false;
    for round in 2..=ROUNDS {
        if watch.stop() {
            return Err(SlidingError::Cancelled);
        }
        rounds = round;
        let slid = slid_once(&aligned, &consensus, sliders, (dimension, criterion))?;
        let value = square(&slid);
        values.push(value);
        aligned = rotated(&slid, &scaled(&consensus, dimension), dimension).0;
        let next = scaled(&sum(&aligned), dimension);
        last_move = distance(&next, &consensus);
        consensus = next;
        converged = (value - before).abs() <= TOLERANCE;
        if converged {
            break;
        }
        before = value;
    }
    if turn {
        let axes = principal_axes(&consensus, dimension);
        aligned.iter_mut().for_each(|shape| *shape = transform(&axes, shape));
    }
    if project {
        project_all(&mut aligned, dimension);
    }
    let consensus = sum(&aligned).iter().map(|x| x / count).collect();
    let (points, displacements) = (None, None);
    Ok(Slid {
        consensus,
        aligned,
        points,
        displacements,
        rounds,
        last_move,
        converged,
        criterion: values,
        passed: 0,
    })
}

/// Shapes at unit size.
fn units(shapes: &[Vec<f64>], dimension: usize) -> Result<Vec<Vec<f64>>, SlidingError> {
    let one = |(shape, given): (usize, &Vec<f64>)| {
        let (own, place) = unit(given, dimension);
        if place.size > 0.0 { Ok(own) } else { Err(SlidingError::NoExtent { shape }) }
    };
    shapes.iter().enumerate().map(one).collect()
}

/// A sum or mean of shapes divided by its centroid size.
fn scaled(shape: &[f64], dimension: usize) -> Vec<f64> {
    let size = unit(shape, dimension).1.size;
    shape.iter().map(|x| x / size).collect()
}

fn slid_once(
    shapes: &[Vec<f64>],
    consensus: &[f64],
    sliders: &Sliders,
    (dimension, criterion): (usize, SlidingCriterion),
) -> Result<Vec<Vec<f64>>, SlidingError> {
    let bending = match criterion {
        SlidingCriterion::BendingEnergy => Some(bending(&scaled(consensus, dimension), dimension, sliders)?),
        SlidingCriterion::Procrustes => None,
    };
    parallel::try_map(shapes.len(), &|shape| {
        let own = &shapes[shape];
        let directions = directions(own, dimension, sliders)
            .map_err(|point| SlidingError::NoDirection { shape, point })?;
        let by = displacements(own, consensus, &directions, (dimension, bending.as_ref()))
            .ok_or(SlidingError::Free { shape })?;
        Ok(displaced(own, &directions, &by, dimension))
    })
}

/// Directions of all sliders of a shape.
fn directions(shape: &[f64], dimension: usize, sliders: &Sliders) -> Result<Vec<Direction>, usize> {
    let mut found = of_curves(shape, dimension, sliders)?;
    for &point in &sliders.surface {
        found.extend(of_surface(shape, point)?.map(|along| Direction { point, along }));
    }
    Ok(found)
}

/// `Y (I − m mᵀ) + m`, with the mean `m` of unit size.
fn project_all(shapes: &mut [Vec<f64>], dimension: usize) {
    let (mean, _) = unit(&sum(shapes), dimension);
    debug_assert!(norm(&mean) > 0.0);
    for shape in shapes {
        let along = 1.0 - dot(shape, &mean);
        shape.iter_mut().zip(&mean).for_each(|(x, m)| *x += along * m);
    }
}
