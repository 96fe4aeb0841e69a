//! Shapes of a space on a finer grid of knots: the same functions.

use crate::GeometryError;
use crate::generator::GeneratorKind;
use crate::influence::support;
use crate::refine::Refinement;
use crate::representation::{Representation, ShapeSpace};
use crate::surface::refinement::SurfaceRefinement;
use crate::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

pub use crate::surface::refinement::MAX_FACTOR;

/// A grid whose intervals are parts of those of a coarse one, on which every coarse shape is the same function.
#[derive(Debug, Clone)]
pub struct Finer {
    factors: Vec<usize>,
    space: ShapeSpace,
    relation: Relation,
}

/// How coarse control points become fine ones.
#[derive(Debug, Clone)]
enum Relation {
    /// All factors are 1.
    Same,
    Curve(Box<Refinement>),
    Surface(Box<SurfaceRefinement>),
}

impl Representation {
    /// The same kind of shape with so many times the intervals, one factor per direction, and the same generators. Sizes beyond the range
    /// of numbers become the largest one.
    pub fn with_factors(&self, factors: &[usize]) -> Self {
        let counts: Vec<usize> = self
            .knots()
            .iter()
            .zip(factors)
            .map(|(knots, factor)| knots.count.saturating_mul(*factor))
            .collect();
        match counts[..] {
            [u, v] => self.with_intervals([u, v]),
            [u] => self.with_count(u),
            _ => self.clone(),
        }
    }
}

impl Finer {
    /// Prepares the grid with these numbers of parts of an interval of `coarse`, from 1, one per direction. Cost: a space.
    ///
    /// # Errors
    /// [`GeometryError::NotRefined`] and [`GeometryError::NoRelation`] where the finer shapes would be other functions; errors of the
    /// finer generators.
    pub fn new(coarse: &ShapeSpace, factors: &[usize]) -> Result<Self, GeometryError> {
        Self::onto(coarse, factors, None)
    }

    /// The grid of `coarse` itself.
    pub fn same(coarse: &ShapeSpace) -> Self {
        let directions = coarse.representation().knots().len();
        Self { factors: vec![1; directions], space: coarse.clone(), relation: Relation::Same }
    }

    /// As [`Self::new`], onto the known space of the finer grid.
    fn onto(
        coarse: &ShapeSpace,
        factors: &[usize],
        known: Option<&ShapeSpace>,
    ) -> Result<Self, GeometryError> {
        let representation = coarse.representation();
        if factors.iter().all(|factor| *factor == 1) {
            return Ok(Self::same(coarse));
        }
        let of = |space: ShapeSpace, relation| Self { factors: factors.to_vec(), space, relation };
        let missing = || missing_relation(representation, factors);
        match (representation, factors) {
            (Representation::Surface { generators, .. }, &[..]) => {
                let basis = coarse.surface().ok_or(GeometryError::NotACurve)?;
                let finer = representation.with_factors(factors);
                let intervals = finer.extent().ok_or(GeometryError::NotACurve)?.intervals;
                let relation = SurfaceRefinement::new(basis, generators, intervals).ok_or_else(missing)?;
                if !basis.seam().is_straight() && relation.shifts()[0] != 0.0 {
                    return Err(missing());
                }
                let finer = finer.with_generators(relation.generators());
                let space = known.map_or_else(|| ShapeSpace::new(&finer), |space| Ok(space.clone()))?;
                Ok(of(space, Relation::Surface(Box::new(relation))))
            }
            (_, &[factor]) => {
                let relation = Refinement::new(coarse, factor)?;
                if !relation.is_exact() {
                    return Err(missing());
                }
                Ok(of(relation.space().clone(), Relation::Curve(Box::new(relation))))
            }
            _ => Err(GeometryError::NotACurve),
        }
    }

    /// From this grid to the finest one of shapes with blocks on this one: the same coarse shape begins at the same place on both.
    pub(super) fn rise(&self, finest: &Self) -> Result<Self, GeometryError> {
        let factors: Vec<usize> =
            finest.factors.iter().zip(&self.factors).map(|(more, less)| more / less).collect();
        let mut rise = Self::onto(&self.space, &factors, Some(&finest.space))?;
        let (knots, shifts) =
            (finest.space.representation().knots(), [self.shifts(), rise.shifts(), finest.shifts()]);
        // Two even splits of odd orders shift the start twice, one even split once: the difference is a whole number of fine intervals.
        let turn = |i: usize| {
            ((shifts[0][i] + shifts[1][i] - shifts[2][i]) * knots[i].count as f64).round() as isize
        };
        rise.relation = match rise.relation {
            Relation::Same => Relation::Same,
            Relation::Curve(relation) => Relation::Curve(Box::new(relation.turned(turn(0)))),
            Relation::Surface(relation) => Relation::Surface(Box::new(relation.turned([turn(0), turn(1)]))),
        };
        Ok(rise)
    }

    /// Numbers of parts of a coarse interval, one per direction.
    pub fn factors(&self) -> &[usize] {
        &self.factors
    }

    /// The space of the finer control points.
    pub fn space(&self) -> &ShapeSpace {
        &self.space
    }

    /// Number of finer control points.
    pub fn size(&self) -> usize {
        self.space.representation().size()
    }

    /// The shifts `δ`, one per direction: the coarse shape at `u` is the finer one at `u + δ`.
    pub fn shifts(&self) -> Vec<f64> {
        match &self.relation {
            Relation::Same => vec![0.0; self.factors.len()],
            Relation::Curve(relation) => vec![relation.parameter_shift()],
            Relation::Surface(relation) => relation.shifts().to_vec(),
        }
    }

    /// Parameters on the finer shape of a place on the coarse one.
    pub fn parameters(&self, coarse: &[f64]) -> Vec<f64> {
        coarse.iter().zip(self.shifts()).map(|(parameter, shift)| parameter + shift).collect()
    }

    /// Region of the coarse domain in which a finer control point moves the shape: as [`support`], from 0 on along closed directions.
    pub fn support(&self, control_point: usize) -> Vec<[f64; 2]> {
        let knots = self.space.representation().knots();
        let coarse = |(([from, to], shift), closed): (([f64; 2], f64), bool)| {
            if closed && to - from >= 1.0 {
                return [from, to];
            }
            let turns = if closed { (from - shift).floor() } else { 0.0 };
            [from, to].map(|end| end - shift - turns)
        };
        let closed = knots.iter().map(|knots| knots.closed);
        support(&self.space, control_point).into_iter().zip(self.shifts()).zip(closed).map(coarse).collect()
    }

    /// Control points on the finer grid of the shape of `coarse` with these; `coarse` is the space of [`Self::new`]. Cost: the control
    /// points times the lengths of the filters.
    pub fn apply(&self, coarse: &ShapeSpace, control_points: &Matrix) -> Matrix {
        match &self.relation {
            Relation::Same => control_points.clone(),
            Relation::Curve(relation) => relation.apply(control_points),
            Relation::Surface(relation) => match (coarse.surface(), self.space.surface()) {
                (Some(from), Some(to)) => relation.apply(from, to, control_points),
                _ => unreachable!("only surfaces have such relations"),
            },
        }
    }
}

/// Error for shapes of `representation` that are other functions on the grid with these factors.
fn missing_relation(representation: &Representation, factors: &[usize]) -> GeometryError {
    let knots = representation.knots();
    let generators =
        knots.iter().zip(factors).filter_map(|(knots, factor)| Some((knots.generator?, *factor)));
    let without = |(kind, factor): &(&GeneratorKind, usize)| *factor > 1 && !kind.has_two_scale(*factor);
    if let Some((kind, factor)) = generators.into_iter().find(without) {
        return GeometryError::NotRefined { generator: kind.name(), factor };
    }
    let twisted = matches!(representation, Representation::Surface { seam, .. } if *seam != Seam::Straight);
    let expected = if twisted {
        "expected odd factors, or even numbers of poles, where a twisted seam joins other parameters"
    } else {
        "expected the poles ±2πj along u, because tangents at smooth poles are multiples of cos 2πu and sin 2πu"
    };
    GeometryError::NoRelation { expected, factors: factors.to_vec() }
}
