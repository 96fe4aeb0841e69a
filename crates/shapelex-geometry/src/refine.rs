//! Refinement: the same curve on a finer grid of knots.
//!
//! B-splines, and interpolators of half-integer shifts with an even factor, are combinations of B-splines on the finer
//! grid: their curves are refined exactly. Other curves are sampled at the finer knots and interpolated again, which
//! changes them by `O(M^{−n})`; the change is measured.
//!
//! Generators of odd order have their knots at half-integers. If these are split evenly, they fall between the knots of the
//! finer basis: the refined closed curve then starts half a fine interval earlier. Open curves begin where they begin: their finer
//! basis is shifted by half an interval instead.

use super::GeometryError;
use super::curve::Curve;
use super::generator::refinement::FineFilter;
use super::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

/// A refinement, prepared for the shapes of one space.
#[derive(Debug, Clone)]
pub struct Refinement {
    coarse: ShapeSpace,
    fine: ShapeSpace,
    factor: usize,
    filter: Option<FineFilter>,
    /// Fine intervals by which the refined closed curve starts later.
    turn: isize,
}

impl Refinement {
    /// Prepares the refinement from curves of `coarse` to a grid `factor ≥ 2` times as fine.
    ///
    /// # Errors
    /// [`GeometryError::NotACurve`] for landmarks; errors of the finer generator.
    pub fn new(coarse: &ShapeSpace, factor: usize) -> Result<Self, GeometryError> {
        let representation = coarse.representation();
        let kind = representation.generator().ok_or(GeometryError::NotACurve)?;
        let count = representation.count();
        let recipe = kind.recipe(count)?;
        let filter = FineFilter::new(&recipe, kind.build(count)?.as_ref(), factor);
        let (filter, kind) = match filter {
            Some(filter) if filter.half_step && !representation.is_closed() => {
                (Some(filter.for_shifted()), kind.two_scale_shifted(factor))
            }
            Some(filter) => (Some(filter), kind.two_scale(factor)),
            None => (None, kind.refined(factor)),
        };
        let fine = ShapeSpace::new(&representation.with_count(factor * count).with_generator(kind))?;
        Ok(Self { coarse: coarse.clone(), fine, factor, filter, turn: 0 })
    }

    /// The same refinement of closed curves, whose result starts `turn` fine intervals later.
    pub(crate) fn turned(self, turn: isize) -> Self {
        Self { turn: self.turn + turn, ..self }
    }

    /// The finer representation.
    pub fn representation(&self) -> &Representation {
        self.fine.representation()
    }

    /// The finer space.
    pub fn space(&self) -> &ShapeSpace {
        &self.fine
    }

    /// Whether the refined curve is the same function (except for its start point).
    pub fn is_exact(&self) -> bool {
        self.filter.is_some()
    }

    /// The shift `δ` with `r(u) = r_fine(u + δ)`.
    pub fn parameter_shift(&self) -> f64 {
        let half_step = self.filter.as_ref().is_some_and(|filter| filter.half_step);
        (if half_step { 0.5 } else { 0.0 } - self.turn as f64) / self.fine.representation().count() as f64
    }

    /// Control points on the finer grid.
    pub fn apply(&self, control_points: &Matrix) -> Matrix {
        match &self.filter {
            Some(filter) => self.filter_control_points(filter, control_points),
            None => self.sample(control_points),
        }
    }

    fn filter_control_points(&self, filter: &FineFilter, coarse: &Matrix) -> Matrix {
        let rows = self.fine.representation().size() as isize;
        let phantoms_of = |space: &ShapeSpace| space.generator().map_or(0, |g| g.beyond()[0]) as isize;
        let (closed, lead, own) =
            (self.coarse.representation().is_closed(), phantoms_of(&self.coarse), phantoms_of(&self.fine));
        let row_of = |k: isize| {
            if closed {
                Some(k.rem_euclid(rows) as usize)
            } else {
                (0..rows).contains(&(k + own)).then(|| (k + own) as usize)
            }
        };
        let mut fine = Matrix::zeros(rows as usize, coarse.ncols());
        for row in 0..coarse.nrows() {
            let k = if closed { row as isize } else { row as isize - lead };
            for (i, tap) in filter.taps.iter().enumerate() {
                let Some(target) = row_of(self.factor as isize * k + filter.first - self.turn + i as isize)
                else {
                    continue;
                };
                for c in 0..coarse.ncols() {
                    fine[(target, c)] += tap * coarse[(row, c)];
                }
            }
        }
        fine
    }

    fn sample(&self, control_points: &Matrix) -> Matrix {
        let count = self.fine.representation().point_count();
        let curve = Curve::of(&self.coarse, control_points).expect("only curves are refined");
        let mut points = Matrix::zeros(count, control_points.ncols());
        for (row, point) in curve.sample(count).iter().enumerate() {
            point.iter().enumerate().for_each(|(c, value)| points[(row, c)] = *value);
        }
        self.fine.interpolate(points).expect("curves pass through their points")
    }
}
