//! Directions of closed planar curves.
//!
//! Curves that are compared as they run are compared by the way in which they were drawn, too: where some run clockwise and others do
//! not, that difference is often the largest of all. Every answer says so that is computed of such a set.

use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::domain::cohort::CohortSpec;
use crate::domain::shape::ShapeMeasures;
use crate::geometry::capability::domain::Domain;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::size::runs_clockwise;
use crate::service::shapes::outcome::Outcomes;
use crate::service::shapes::read::Weighted;
use crate::service::shapes::read_points::given;
use crate::wire::shape::ShapeInput;

/// How many closed planar curves run which way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Ways {
    /// Number of those that run clockwise.
    pub(crate) clockwise: u64,
    /// Number of those that do not.
    pub(crate) counter_clockwise: u64,
}

/// Rule of correspondence of curves, as far as their direction matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rule {
    pub(crate) correspondence: Correspondence,
    pub(crate) direction: Direction,
    pub(crate) mirror: Mirror,
}

/// End of warnings of mixed directions, where start points are found by arc length or searched.
const AS_DRAWN: &str =
    "and are compared as they were drawn: with \"direction\": \"either\" the way of drawing does not count";
/// The same where points correspond as they are listed.
const AS_LISTED: &str = "and are compared point by point: list the points one way round, or match mirror images (\"mirror\": \"allow\") \
                         where these run the other way";

impl Rule {
    /// The rule of a cohort, with a choice of mirror images.
    pub(crate) fn of(spec: &CohortSpec, mirror: Mirror) -> Self {
        Self { correspondence: spec.correspondence, direction: spec.direction, mirror }
    }

    /// Whether it matters which way curves run. Landmarks keep their order in any case, and those of a mirror image run the other
    /// way.
    pub(crate) fn counts(self) -> bool {
        match self.correspondence {
            Correspondence::Landmarks => self.mirror == Mirror::Forbid,
            Correspondence::ArcLength | Correspondence::Cyclic => self.direction == Direction::Given,
        }
    }

    /// How the sentence of a warning ends.
    fn ending(self) -> &'static str {
        if self.correspondence == Correspondence::Landmarks { AS_LISTED } else { AS_DRAWN }
    }

    /// A warning of curves that run both ways, if it matters.
    pub(crate) fn warning(self, ways: Ways) -> Option<String> {
        let Ways { clockwise, counter_clockwise } = ways;
        let few = clockwise.min(counter_clockwise);
        if few == 0 || !self.counts() {
            return None;
        }
        let way = if clockwise <= counter_clockwise { "clockwise" } else { "counter-clockwise" };
        let (all, ending) = (clockwise + counter_clockwise, self.ending());
        Some(format!("{few} of {all} contours run {way}, unlike the others, {ending}"))
    }

    /// A warning of new curves that run against the first one of a cohort, if it matters.
    pub(crate) fn warning_beside(self, ways: Ways, clockwise: bool) -> Option<String> {
        self.warning_against(ways, clockwise, ["new contours", "the first one of the cohort"])
    }

    /// A warning of curves that run against the mean of a dictionary, if it matters.
    pub(crate) fn warning_of_model(self, ways: Ways, clockwise: bool) -> Option<String> {
        let all = format!("of {} contours", ways.clockwise + ways.counter_clockwise);
        self.warning_against(ways, clockwise, [&all, "the mean of the dictionary"])
    }

    fn warning_against(self, ways: Ways, clockwise: bool, [who, other]: [&str; 2]) -> Option<String> {
        let against = if clockwise { ways.counter_clockwise } else { ways.clockwise };
        if against == 0 || !self.counts() {
            return None;
        }
        let way = if clockwise { "counter-clockwise" } else { "clockwise" };
        Some(format!("{against} {who} run {way}, unlike {other}, {}", self.ending()))
    }
}

/// Whether a warning is one of directions.
pub(crate) fn is_warning(text: &str) -> bool {
    text.ends_with(AS_DRAWN) || text.ends_with(AS_LISTED)
}

impl Ways {
    /// Notes a curve; `None` is a shape without a direction.
    pub(crate) fn note(&mut self, clockwise: Option<bool>) {
        self.clockwise += u64::from(clockwise == Some(true));
        self.counter_clockwise += u64::from(clockwise == Some(false));
    }

    /// Of measured shapes.
    pub(crate) fn of_measures<'a>(measures: impl Iterator<Item = &'a ShapeMeasures>) -> Self {
        let mut ways = Self::default();
        measures.for_each(|measures| ways.note(measures.clockwise));
        ways
    }

    /// Of shapes of `space`, one after the other. Cost: a pass over their segments.
    pub(crate) fn of_points(space: &ShapeSpace, control_points: &[f64]) -> Self {
        let mut ways = Self::default();
        if have_direction(space.representation()) {
            let length = space.representation().size() * space.representation().dimension();
            control_points.chunks_exact(length).for_each(|shape| ways.note(runs_clockwise(space, shape)));
        }
        ways
    }

    /// Of a reference and shapes of `space`, with their weights. Cost: a pass over their segments.
    pub(crate) fn of_each(space: &ShapeSpace, reference: &[f64], shapes: &Outcomes<Weighted>) -> Self {
        let mut ways = Self::of_points(space, reference);
        for (shape, _) in shapes.values() {
            let Self { clockwise, counter_clockwise } = Self::of_points(space, shape);
            ways.clockwise += clockwise;
            ways.counter_clockwise += counter_clockwise;
        }
        ways
    }
}

/// Whether the polygon of the points of a posted curve runs clockwise; `None` without points of the plane.
pub(crate) fn drawn_clockwise(shape: &ShapeInput) -> Option<bool> {
    let points = given(&shape.points).or(given(&shape.control_points))?.checked(2).ok()?.as_chunks::<2>().0;
    let [x0, y0] = *points.first()?;
    let pairs = points.iter().zip(points.iter().cycle().skip(1));
    let area: f64 = pairs.map(|([ax, ay], [bx, by])| (ax - x0) * (by - y0) - (bx - x0) * (ay - y0)).sum();
    Some(area < 0.0)
}

/// Whether shapes are closed planar curves.
pub(crate) fn have_direction(representation: &Representation) -> bool {
    representation.domain() == Domain::Line { closed: true } && representation.dimension() == 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_of_both_ways_are_named_where_it_matters() {
        let rule = |correspondence, direction, mirror| Rule { correspondence, direction, mirror };
        let mixed = Ways { clockwise: 68, counter_clockwise: 462 };
        let given = rule(Correspondence::Cyclic, Direction::Given, Mirror::Allow);
        let text = given.warning(mixed).unwrap();
        assert!(
            text.starts_with("68 of 530 contours run clockwise, unlike the others, and are compared"),
            "{text}"
        );
        assert!(is_warning(&text) && text.contains("\"direction\": \"either\""));
        let turned = given.warning(Ways { clockwise: 5, counter_clockwise: 2 }).unwrap();
        assert!(turned.starts_with("2 of 7 contours run counter-clockwise"), "{turned}");
        assert_eq!(given.warning(Ways { clockwise: 5, counter_clockwise: 0 }), None);
        let either = rule(Correspondence::ArcLength, Direction::Either, Mirror::Forbid);
        assert_eq!(either.warning(mixed), None);
        let landmarks = rule(Correspondence::Landmarks, Direction::Either, Mirror::Forbid);
        assert!(is_warning(&landmarks.warning(mixed).unwrap()));
        assert_eq!(Rule { mirror: Mirror::Allow, ..landmarks }.warning(mixed), None);
    }

    #[test]
    fn new_curves_are_compared_with_the_first_one() {
        let given = Rule {
            correspondence: Correspondence::ArcLength,
            direction: Direction::Given,
            mirror: Mirror::Forbid,
        };
        let clockwise = Ways { clockwise: 3, counter_clockwise: 0 };
        assert_eq!(given.warning_beside(clockwise, true), None);
        let text = given.warning_beside(clockwise, false).unwrap();
        assert!(
            text.starts_with("3 new contours run clockwise, unlike the first one of the cohort"),
            "{text}"
        );
    }
}
