//! Conversion of points on a shape, or of given control points, to control points that correspond between shapes.
//!
//! Under `arc_length` and `cyclic`, any number of points is resampled to the size of the representation. Under `cyclic`,
//! resampling begins at the canonical start of the contour, so that the result does not depend on the first point of
//! the list.

use super::correspondence::{Correspondence, Direction};
use shapelex_geometry::capability::fit;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::resample::{
    Contour, RepeatedPoints, canonical_shift, polygon_area, rotate_start, without_closing_point,
};
use shapelex_geometry::surface::basis::Tangents;
use shapelex_numeric::dense::Matrix;

/// Conversion to control points of one space.
#[derive(Debug, Clone, Copy)]
pub struct Conversion<'a> {
    /// The space of the shapes.
    pub space: &'a ShapeSpace,
    /// Correspondence: resampling and start.
    pub correspondence: Correspondence,
    /// Direction of planar contours.
    pub direction: Direction,
    /// Points equal to their predecessor, where contours are resampled; landmarks are kept.
    pub repeated_points: RepeatedPoints,
}

/// Control points of a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Converted {
    /// Control points (`N × d`).
    pub control_points: Matrix,
    /// Number of repeated points that were dropped.
    pub repeated_points: usize,
    /// How the contour ran as it was given.
    pub beginning: Beginning,
}

/// How a contour ran as it was given, where its start or its direction was changed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Beginning {
    /// Parameter of the curve at which the contour as given begins, from 0 to 1.
    pub start: f64,
    /// Whether the contour as given runs the other way.
    pub reversed: bool,
}

/// Number of points for each control point through which a curve is converted anew: the polygon leaves a smooth curve by about
/// `(π/32)²/8` of the distance of two control points, a thousandth of it.
const DENSE: usize = 32;

/// Points along a curve of `space`, in the order in which it was given; `None` for other shapes.
pub fn given_points(space: &ShapeSpace, control_points: &Matrix, beginning: Beginning) -> Option<Matrix> {
    let curve = Curve::of(space, control_points)?;
    let (count, dimension) = (DENSE * space.representation().point_count(), curve.dimension());
    let steps = if curve.is_closed() { count } else { count - 1 };
    let mut points = Matrix::zeros(count, dimension);
    for i in 0..count {
        let along = i as f64 / steps as f64;
        let along = if beginning.reversed { 1.0 - along } else { along };
        let u = if curve.is_closed() { (beginning.start + along).rem_euclid(1.0) } else { along };
        for (c, x) in curve.evaluate(u, 0).into_iter().enumerate() {
            points[(i, c)] = x;
        }
    }
    Some(points)
}

impl Conversion<'_> {
    /// Control points of the shape through a list of points (`n × d`), resampled unless points are landmarks.
    ///
    /// # Errors
    /// The number of points; a contour that cannot be resampled, at the index of the point; points that do not determine the
    /// shape.
    pub fn interpolate(&self, points: Matrix) -> Result<Converted, FieldFault> {
        let representation = self.space.representation();
        let interpolate = |points: Matrix, repeated_points: usize| {
            let control_points = self.space.interpolate(points);
            let beginning = Beginning::default();
            let converted = |control_points| Converted { control_points, repeated_points, beginning };
            control_points.map(converted).map_err(|error| FieldFault::new("", error.to_string()))
        };
        if self.correspondence == Correspondence::Landmarks || !self.space.domain().is_line() {
            let hint = if self.space.domain().is_line() {
                " (to resample a contour, use the correspondence arc_length or cyclic)"
            } else {
                ""
            };
            check_count(points.nrows(), "points", representation.point_count(), hint)?;
            return interpolate(points, 0);
        }
        // The point that closes a ring is not a repeated one.
        let points = if representation.is_closed() { without_closing_point(points) } else { points };
        let (posted, reversed) = (points.nrows(), self.runs_backwards(&points));
        let contour = self.contour(points)?;
        let start =
            if self.correspondence == Correspondence::Cyclic { contour.canonical_start() } else { 0.0 };
        let repeated = posted - contour.points().nrows();
        let converted = interpolate(contour.sample(representation.point_count(), start), repeated)?;
        // Control points are at equal arc lengths, so parameters are parts of the length.
        let beginning = Beginning { start: (-start / contour.length()).rem_euclid(1.0), reversed };
        Ok(Converted { beginning, ..converted })
    }

    /// The contour through points, in its direction; the first point stays first.
    fn contour(&self, points: Matrix) -> Result<Contour, FieldFault> {
        let contour = |points: Matrix| {
            fit::contour(points, self.space.representation().is_closed(), self.repeated_points)
        };
        if !self.runs_backwards(&points) {
            return contour(points);
        }
        // A fault is at the index of the point as posted.
        contour(self.directed(points.clone())).map_err(|fault| contour(points).err().unwrap_or(fault))
    }

    /// Control points of the surface through a grid of points that fits ([`ShapeSpace::grid_fault`],
    /// [`ShapeSpace::open_poles`]), with tangents at its poles.
    ///
    /// # Errors
    /// Points that do not determine the shape.
    pub fn interpolate_grid(&self, points: Matrix, tangents: &Tangents) -> Result<Matrix, FieldFault> {
        let found = self.space.interpolate_with(points, tangents);
        found.map_err(|error| FieldFault::new("", error.to_string()))
    }

    /// Given control points; those of a contour are oriented unless their direction counts, and begin at their canonical start under
    /// `cyclic`.
    ///
    /// # Errors
    /// The number of control points.
    pub fn take(&self, control_points: Matrix) -> Result<Converted, FieldFault> {
        let size = self.space.representation().size();
        check_count(control_points.nrows(), "control points", size, "")?;
        let reversed = self.runs_backwards(&control_points);
        let directed = self.directed(control_points);
        let searched = self.correspondence == Correspondence::Cyclic && self.space.domain().is_line();
        let shift = if searched { canonical_shift(&directed) } else { 0 };
        let beginning = Beginning { start: ((size - shift) % size) as f64 / size as f64, reversed };
        let control_points = if shift == 0 { directed } else { rotate_start(&directed, shift) };
        Ok(Converted { control_points, repeated_points: 0, beginning })
    }

    /// Orients planar closed contours without a meaningful direction counter-clockwise, keeping their first point.
    fn directed(&self, points: Matrix) -> Matrix {
        let (n, d) = points.shape();
        if !self.runs_backwards(&points) {
            return points;
        }
        Matrix::from_fn(n, d, |k, c| points[((n - k) % n, c)])
    }

    /// Whether a contour without a meaningful direction runs clockwise.
    fn runs_backwards(&self, points: &Matrix) -> bool {
        // Empty lists are refused when the contour is built.
        points.ncols() == 2
            && points.nrows() > 0
            && self.space.representation().is_closed()
            && self.direction == Direction::Either
            && self.correspondence != Correspondence::Landmarks
            && !(polygon_area(points) >= 0.0)
    }
}

fn check_count(found: usize, what: &str, wanted: usize, hint: &str) -> Result<(), FieldFault> {
    if found == wanted {
        return Ok(());
    }
    Err(FieldFault::new("", format!("expected {wanted} {what} for this representation, got {found}{hint}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shapelex_geometry::generator::GeneratorKind;
    use shapelex_geometry::representation::Representation;

    fn space() -> ShapeSpace {
        let generator = GeneratorKind::Bspline { degree: 3 };
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 12, generator }).unwrap()
    }

    /// An ellipse with a bump, counter-clockwise.
    fn bean(n: usize) -> Matrix {
        Matrix::from_fn(n, 2, |k, c| {
            let t = std::f64::consts::TAU * k as f64 / n as f64;
            if c == 0 { 2.0 * t.cos() + 0.3 * (2.0 * t).cos() } else { t.sin() }
        })
    }

    #[test]
    fn under_cyclic_neither_start_nor_direction_of_the_list_matters() {
        let space = space();
        let (correspondence, direction) = (Correspondence::Cyclic, Direction::Either);
        let conversion =
            Conversion { space: &space, correspondence, direction, repeated_points: RepeatedPoints::Drop };
        let (points, n) = (bean(120), 120);
        let backwards = Matrix::from_fn(n, 2, |k, c| points[((2 * n - k) % n, c)]);
        let wanted = conversion.interpolate(points.clone()).unwrap().control_points;
        for other in [rotate_start(&points, 31), backwards.clone(), rotate_start(&backwards, 50)] {
            let found = conversion.interpolate(other).unwrap().control_points;
            assert!((&found - &wanted).amax() < 1e-12, "{:.1e}", (&found - &wanted).amax());
        }
        let taken = |control_points| conversion.take(control_points).unwrap().control_points;
        assert_eq!(taken(rotate_start(&wanted, 5)), taken(wanted));
    }

    /// A contour that was moved to its canonical start and turned round is found again as it was given.
    #[test]
    fn a_stored_curve_is_given_again_from_its_own_start_in_its_own_direction() {
        let space = space();
        let converted = |correspondence, direction, points| {
            let conversion = Conversion {
                space: &space,
                correspondence,
                direction,
                repeated_points: RepeatedPoints::Drop,
            };
            conversion.interpolate(points).unwrap()
        };
        let n = 480;
        let clockwise = Matrix::from_fn(n, 2, |k, c| bean(n)[((2 * n - k + 77) % n, c)]);
        let wanted = converted(Correspondence::ArcLength, Direction::Given, clockwise.clone());
        assert_eq!(wanted.beginning, Beginning::default());
        let stored = converted(Correspondence::Cyclic, Direction::Either, clockwise);
        assert!(stored.beginning.reversed && stored.beginning.start > 0.01, "{:?}", stored.beginning);
        let again = given_points(&space, &stored.control_points, stored.beginning).unwrap();
        let found = converted(Correspondence::ArcLength, Direction::Given, again);
        // Twelve control points represent this bean to some thousandths, at other places of its contour.
        let apart = (&found.control_points - &wanted.control_points).amax();
        assert!(apart < 0.02, "{apart:.1e}");
        let unmoved = given_points(&space, &stored.control_points, Beginning::default()).unwrap();
        let unmoved = converted(Correspondence::ArcLength, Direction::Given, unmoved);
        assert!((&unmoved.control_points - &wanted.control_points).amax() > 0.5);
    }

    #[test]
    fn control_points_of_either_direction_run_counter_clockwise_unless_they_are_landmarks() {
        let space = space();
        let taken = |correspondence, direction| {
            let conversion = Conversion {
                space: &space,
                correspondence,
                direction,
                repeated_points: RepeatedPoints::Drop,
            };
            let backwards = Matrix::from_fn(12, 2, |k, c| bean(12)[((12 - k) % 12, c)]);
            let taken = conversion.take(backwards.clone()).unwrap().control_points;
            (polygon_area(&taken) > 0.0, taken == backwards)
        };
        assert_eq!(taken(Correspondence::ArcLength, Direction::Either), (true, false));
        assert!(taken(Correspondence::Cyclic, Direction::Either).0);
        assert_eq!(taken(Correspondence::ArcLength, Direction::Given), (false, true));
        assert_eq!(taken(Correspondence::Landmarks, Direction::Either), (false, true));
    }

    #[test]
    fn only_closed_planar_curves_whose_start_is_searched_are_compared_in_either_direction_by_default() {
        let generator = GeneratorKind::Bspline { degree: 3 };
        let open = Representation::OpenCurve { dimension: 2, intervals: 12, generator: generator.clone() };
        let closed = |dimension| Representation::ClosedCurve {
            dimension,
            control_points: 12,
            generator: generator.clone(),
        };
        let usual = Direction::usual;
        assert_eq!(usual(Correspondence::Cyclic, &closed(2)), Direction::Either);
        assert_eq!(usual(Correspondence::ArcLength, &closed(2)), Direction::Given);
        assert_eq!(usual(Correspondence::Landmarks, &closed(2)), Direction::Given);
        assert_eq!(usual(Correspondence::Cyclic, &closed(3)), Direction::Given);
        assert_eq!(usual(Correspondence::ArcLength, &open), Direction::Given);
    }

    #[test]
    fn repeated_points_of_a_ring_that_runs_backwards_are_dropped_or_named() {
        let space = space();
        let conversion = |repeated_points| {
            let (correspondence, direction) = (Correspondence::ArcLength, Direction::Either);
            Conversion { space: &space, correspondence, direction, repeated_points }
        };
        let matrix = |rows: &[[f64; 2]]| Matrix::from_fn(rows.len(), 2, |k, c| rows[k][c]);
        let ring = [[0., 0.], [0., 2.], [3., 2.], [3., 0.]];
        let repeated = [[0., 0.], [0., 0.], [0., 2.], [3., 2.], [3., 2.], [3., 0.], [0., 0.], [0., 0.]];
        let wanted = conversion(RepeatedPoints::Refuse).interpolate(matrix(&ring)).unwrap();
        let found = conversion(RepeatedPoints::Drop).interpolate(matrix(&repeated)).unwrap();
        assert_eq!((found.control_points, found.repeated_points), (wanted.control_points, 3));
        let refused = conversion(RepeatedPoints::Refuse).interpolate(matrix(&repeated[2..])).unwrap_err();
        assert!(
            refused.field == "2" && refused.detail.starts_with("points 1 and 2 are equal"),
            "{refused:?}"
        );
    }

    #[test]
    fn landmarks_are_counted() {
        let space = space();
        let (correspondence, direction) = (Correspondence::Landmarks, Direction::Given);
        let conversion =
            Conversion { space: &space, correspondence, direction, repeated_points: RepeatedPoints::Drop };
        let refused = conversion.interpolate(bean(11)).unwrap_err();
        assert!(
            refused.detail.starts_with("expected 12 points for this representation, got 11 (to resample")
        );
        let refused = conversion.take(bean(13)).unwrap_err();
        assert!(refused.detail.ends_with("expected 12 control points for this representation, got 13"));
        let through = conversion.interpolate(bean(12)).unwrap().control_points;
        assert_eq!(conversion.take(through.clone()).unwrap().control_points, through);
    }
}
