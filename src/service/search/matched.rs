//! The elastic match of two posted curves. The functions are synchronous and run on the pool.

use crate::analysis::correspondence::Correspondence;
use crate::analysis::drawing::elastic::draw_match;
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::{ElasticMatch, ElasticSpace};
use crate::geometry::drawing::scene::Drawing;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cost::requests;
use crate::service::shapes::read;
use crate::service::statistics::{CheckedSettings, Settings, Setup};
use crate::wire::shape::ShapeInput;

/// Ways in which one curve of a pair is laid, at most: mirrored, and reversed.
const WAYS: usize = 4;

/// Two curves that are to be matched.
#[derive(Debug)]
pub struct MatchTask {
    settings: CheckedSettings,
    elastic: ElasticSettings,
    shapes: Vec<ShapeInput>,
}

/// A match, with both curves at matched places.
#[derive(Debug)]
pub struct MatchFound {
    /// The match.
    pub matched: ElasticMatch,
    /// Whether the curves are closed.
    pub closed: bool,
    /// Points of the curves, as given.
    pub points: [Matrix; 2],
}

impl MatchTask {
    /// Checks a request. Contours are resampled along their length, whatever the correspondence.
    ///
    /// # Errors
    /// All faults of the settings; shapes that are not two.
    pub fn new(
        app: &App,
        settings: Settings,
        elastic: ElasticSettings,
        shapes: Vec<ShapeInput>,
    ) -> Result<Self, ServiceError> {
        if shapes.len() != 2 {
            return Err(ServiceError::invalid("/shapes", format!("expected 2 shapes, got {}", shapes.len())));
        }
        let elastic = elastic.checked()?;
        let settings = contour_settings(settings).checked(&app.limits)?;
        Ok(Self { settings, elastic, shapes })
    }

    /// Predicted work.
    pub fn work(&self, app: &App) -> Work {
        let points = self.elastic.points;
        // Its matched points are found and written.
        requests::space(&self.settings.representation, &app.limits)
            + requests::elastic_curves(4, points)
            + Work::from_seconds(self.elastic.seconds(WAYS))
            + Work::numbers(10.0 * points as f64)
    }

    /// Matches the curves.
    ///
    /// # Errors
    /// Faults of the shapes, at their places; shapes that are no curves, at `/representation`.
    pub fn found(self, app: &App) -> Result<MatchFound, ServiceError> {
        let setup = Setup::new(app, self.settings)?;
        let rule = setup.rule();
        let space = ElasticSpace::new(&setup.space, rule.direction, rule.mirror, self.elastic)?;
        let control_points = read::read_batch(&setup.reading(&app.limits), self.shapes)?.control_points;
        let at = |index: usize| format!("/shapes/{index}");
        let curves =
            space.prepare(&control_points).map_err(|error| ServiceError::from_analysis(error, at))?;
        app.pool.context().check()?;
        let matched = space.compare(&curves[0], &curves[1]);
        let (a, b) = control_points.split_at(control_points.len() / 2);
        let points = space.matched_points([a, b], &matched);
        let points = points.ok_or_else(|| ServiceError::Internal("a curve without control points".into()))?;
        Ok(MatchFound { matched, closed: setup.space.representation().is_closed(), points })
    }

    /// Matches the curves, and draws the match.
    ///
    /// # Errors
    /// As [`found`](Self::found).
    pub fn drawing(self, app: &App) -> Result<Drawing, ServiceError> {
        let MatchFound { matched, closed, points } = self.found(app)?;
        Ok(draw_match(&points, closed, &matched))
    }
}

/// The same settings for curves that are posted as contours: those of other shapes stay, and are refused as what they are.
pub(crate) fn contour_settings(settings: Settings) -> Settings {
    let correspondence = match settings.representation.domain().is_line() {
        true => Correspondence::ArcLength,
        false => Correspondence::Landmarks,
    };
    Settings { correspondence, ..settings }
}
