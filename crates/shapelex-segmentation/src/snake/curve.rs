//! Closed planar curves.

use shapelex_geometry::GeometryError;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::intersection::closed_self_intersects;
use shapelex_geometry::knot_line::Line;
use shapelex_numeric::sparse::SparseRows;

use super::{MAX_PER_SPAN, Model, OUTLINE_SPACING, Outline, equal};
use crate::boundary::curve::CurveBoundary;
use crate::boundary::{Boundary, Rule};
use crate::frame::Frame;

/// Samples per cell of length.
const DENSITY: f64 = 1.6;
/// Minimum number of samples per control point.
const LEAST: usize = 8;

/// Closed planar curves of a generator; the free points are the control points.
#[derive(Debug, Clone)]
pub struct CurveSnake {
    line: Line,
}

impl CurveSnake {
    /// The curves with `count` control points.
    ///
    /// # Errors
    /// Errors of the generator.
    pub fn new(generator: &GeneratorKind, count: usize) -> Result<Self, GeometryError> {
        Ok(Self { line: Line::new(generator, count, true)? })
    }

    /// The closed curves with this basis.
    pub fn on(line: Line) -> Self {
        Self { line }
    }

    /// The line of the control points.
    pub fn line(&self) -> &Line {
        &self.line
    }

    /// Samples per control point, for a number of samples per cell of length.
    fn per_span(&self, rows: &[[f64; 2]], density: f64) -> usize {
        let coarse = CurveBoundary::new(&self.line, LEAST, rows, Frame::identity());
        let length = coarse.measure(&coarse.sample(rows)).value;
        ((density * length / rows.len() as f64).ceil() as usize).clamp(LEAST, MAX_PER_SPAN)
    }
}

impl Model<2> for CurveSnake {
    fn rows(&self) -> usize {
        self.line.intervals()
    }

    fn boundary(&self, rows: &[[f64; 2]], _sigma: f64, frame: Frame<2>) -> Box<dyn Boundary<2>> {
        Box::new(CurveBoundary::new(&self.line, self.per_span(rows, DENSITY), rows, frame))
    }

    fn exact(&self, rows: &[[f64; 2]], frame: Frame<2>) -> Box<dyn Boundary<2>> {
        Box::new(CurveBoundary::with_rule(&self.line, Rule::exact(&self.line), rows, frame))
    }

    fn outline(&self, rows: &[[f64; 2]]) -> Outline {
        let per_span = self.per_span(rows, 1.0 / OUTLINE_SPACING);
        Outline::Polygon(
            CurveBoundary::new(&self.line, per_span, rows, Frame::identity()).sample(rows).points,
        )
    }

    fn crosses_itself(&self, rows: &[[f64; 2]]) -> bool {
        closed_self_intersects(&self.line, rows)
    }

    fn centre(&self) -> Vec<f64> {
        equal(self.rows())
    }

    fn lift(&self) -> Option<SparseRows> {
        None
    }
}
