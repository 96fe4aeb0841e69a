//! Changes of the rule by which the shapes of a cohort correspond: correspondence, direction, mirror images.
//!
//! A change is a revision. Curves that the new rule stores otherwise are stored again, as points along them from where they began and
//! in the way in which they ran: the uploaded points are not kept, so the result is that of an upload of the curves, not of the points.
//! Earlier revisions keep their shapes and their rule, and with them the dictionaries and jobs that are of them.

use super::catalogue::{Rule, find};
use super::measures::Measuring;
use crate::analysis::conversion::{Beginning, Conversion, given_points};
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::domain::cohort::{Cohort, CohortSpec, FormerRule};
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{NewShape, Shape, ShapeMeasures};
use crate::geometry::representation::ShapeSpace;
use crate::geometry::resample::{RepeatedPoints, polygon_area};
use crate::numeric::dense::Matrix;
use crate::service::app::memory::Purpose;
use crate::service::app::parallel;
use crate::service::app::{App, ServiceError, now_ms};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::directions::have_direction;
use crate::store::{Listing, Revisions, ShapeRow};
use crate::wire::fault::Fault;

/// Number of shapes that are converted at once.
const AT_ONCE: usize = 1000;
/// Copies of a shape while a cohort is stored again: as read, as converted, as a row, and as a part of a chunk.
const COPIES: usize = 4;
/// Memory of the attributes of a shape, about.
const ATTRIBUTES: usize = 1024;
/// Number of points along a curve for each of its control points, relative to a posted contour of as many points.
const DENSITY: f64 = 32.0;

/// Stores `cohort`, whose properties have changed since `former`, with another rule as its next revision.
///
/// # Errors
/// Too many shapes, too much memory or work; a name that is taken; [`ServiceError::Changed`].
pub(super) async fn change(
    app: &App,
    former: &CohortSpec,
    mut cohort: Cohort,
) -> Result<Cohort, ServiceError> {
    let Rule { correspondence, direction, mirror } = Rule::of(former);
    cohort.former_rules.push(FormerRule { until: cohort.revision, correspondence, direction, mirror });
    let again = stores_again(former, &cohort.spec) && cohort.shapes > 0;
    let held = if again { Some(app.memory.hold(Purpose::Bodies, bytes_of(app, &cohort)?)?) } else { None };
    let rows = if again { Some(rows(app, former, &cohort).await?) } else { None };
    app.store.change_rule(&cohort, rows, now_ms()).await?;
    drop(held);
    app.cache.forget(&cohort.id);
    find(app, &cohort.id).await
}

/// Whether shapes are stored otherwise under another rule: curves that are resampled, or turned round.
fn stores_again(former: &CohortSpec, now: &CohortSpec) -> bool {
    let representation = &now.representation;
    let turns = former.direction != now.direction
        && now.correspondence != Correspondence::Landmarks
        && have_direction(representation);
    representation.domain().is_line() && (former.correspondence != now.correspondence || turns)
}

/// Memory for storing the shapes again, provided that they are few enough.
fn bytes_of(app: &App, cohort: &Cohort) -> Result<usize, ServiceError> {
    let (shapes, most) = (cohort.shapes, app.limits.shapes as u64);
    if shapes > most {
        let detail = format!(
            "expected a cohort of at most {most} curves, which are stored again, got {shapes}: export them into a new cohort"
        );
        return Err(ServiceError::invalid("/correspondence", detail));
    }
    let length = cohort.spec.representation.size() * cohort.spec.representation.dimension();
    Ok((shapes as usize).saturating_mul(COPIES * 8 * length + ATTRIBUTES))
}

/// All shapes of a cohort as its new rule stores them, with their times of creation.
async fn rows(app: &App, former: &CohortSpec, cohort: &Cohort) -> Result<Vec<(ShapeRow, i64)>, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    let counts = Counts::for_cohort(cohort, &app.limits);
    let all = work_of(&space, counts, app);
    all.check(app.limits.request_work.as_secs_f64())?;
    let (mut after, mut rows) = (None, Vec::new());
    loop {
        let (revisions, filter) = (Revisions::until(cohort.revision), &ShapeFilter::default());
        let listing = Listing { revisions, filter, order: None, after, limit: AT_ONCE, geometry: true };
        let page = app.store.list_shapes(&cohort.id, &listing).await?;
        let work = work_of(&space, counts.with_shapes(page.shapes.len()), app);
        let again = Again::new(space.clone(), former.clone(), cohort.spec.clone());
        let converted = app.pool.weighing(work).run(move || again.rows(page.shapes)).await?;
        rows.extend(converted);
        after = page.next;
        if after.is_none() {
            return Ok(rows);
        }
    }
}

fn work_of(space: &ShapeSpace, counts: Counts, app: &App) -> crate::service::app::Work {
    DENSITY * requests::store(counts, Correspondence::Cyclic)
        + requests::measure_stored(space.representation(), counts, &app.limits)
}

/// Conversion of stored curves from a rule to another.
struct Again {
    measuring: Measuring,
    space: ShapeSpace,
    former: CohortSpec,
    now: CohortSpec,
}

impl Again {
    fn new(space: ShapeSpace, former: CohortSpec, now: CohortSpec) -> Self {
        Self { measuring: Measuring::new(space.clone()), space, former, now }
    }

    fn rows(&self, shapes: Vec<Shape>) -> Result<Vec<(ShapeRow, i64)>, ServiceError> {
        parallel::map(shapes, |_, shape| self.row(shape)).into_iter().collect()
    }

    fn row(&self, shape: Shape) -> Result<(ShapeRow, i64), ServiceError> {
        let representation = self.space.representation();
        let (size, dimension) = (representation.size(), representation.dimension());
        let stored = Matrix::from_column_slice(size, dimension, &shape.control_points);
        let known = shape.measures.beginning.unwrap_or_default();
        let (matrix, beginning) = self.converted(stored, known).map_err(|detail| {
            let detail = format!("the shape '{}': {detail}", shape.id);
            ServiceError::Invalid(vec![Fault::new("/correspondence", detail)].into())
        })?;
        let control_points = matrix.as_slice().to_vec();
        let measures = self.measuring.measure(&control_points, None);
        let searched = self.now.correspondence == Correspondence::Cyclic;
        let measures = ShapeMeasures {
            points: shape.measures.points,
            fit: shape.measures.fit,
            beginning: (searched || beginning.reversed).then_some(beginning),
            ..measures
        };
        let new = NewShape { id: shape.id, attributes: shape.attributes, measures, control_points };
        Ok((new.into(), shape.created_at_ms))
    }

    /// A curve, which began in some way, as the new rule stores it.
    fn converted(&self, stored: Matrix, known: Beginning) -> Result<(Matrix, Beginning), String> {
        if self.former.correspondence == self.now.correspondence {
            return Ok(turned(stored, known, self.now.direction));
        }
        // Points of contours are landmarks at equal arc lengths from where they began.
        let (correspondence, direction) = match self.now.correspondence {
            Correspondence::Landmarks => (Correspondence::ArcLength, Direction::Given),
            other => (other, self.now.direction),
        };
        let points = given_points(&self.space, &stored, known).ok_or("expected a curve")?;
        let (space, repeated_points) = (&self.space, RepeatedPoints::Drop);
        let conversion = Conversion { space, correspondence, direction, repeated_points };
        let converted = conversion.interpolate(points).map_err(|fault| fault.detail)?;
        Ok((converted.control_points, converted.beginning))
    }
}

/// A closed curve in another direction, from the same point: its start is canonical whichever way it runs.
fn turned(stored: Matrix, known: Beginning, direction: Direction) -> (Matrix, Beginning) {
    let turns = match direction {
        Direction::Either => stored.ncols() == 2 && polygon_area(&stored) < 0.0,
        Direction::Given => known.reversed,
    };
    if !turns {
        return (stored, known);
    }
    let (n, d) = stored.shape();
    let turned = Matrix::from_fn(n, d, |k, c| stored[((n - k) % n, c)]);
    (turned, Beginning { start: (1.0 - known.start).rem_euclid(1.0), reversed: !known.reversed })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_is_turned_twice_is_the_same() {
        let square = Matrix::from_row_slice(4, 2, &[0.0, 0.0, 0.0, 1.0, 2.0, 1.0, 2.0, 0.0]);
        let known = Beginning { start: 0.25, reversed: false };
        let (turned_once, beginning) = turned(square.clone(), known, Direction::Either);
        assert_eq!(turned_once.row(1).iter().copied().collect::<Vec<_>>(), [2.0, 0.0]);
        assert_eq!(beginning, Beginning { start: 0.75, reversed: true });
        assert_eq!(turned(turned_once.clone(), beginning, Direction::Either).0, turned_once);
        assert_eq!(turned(turned_once, beginning, Direction::Given), (square, known));
    }
}
