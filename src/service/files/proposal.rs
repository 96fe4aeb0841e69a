//! Numbers of control points that represent the shapes of a file within a tolerance.
//!
//! The first shapes of each kind are fitted with growing numbers of control points until the root mean square distance of their points is
//! below a part of their size, the root mean square distance of their points from the mean of these. Curves are proposed as closed or
//! open ones, meshes without handles as spheres.

use serde::Serialize;

use crate::geometry::capability::fit::{
    FitSettings, FitTarget, Fitted, Fitter, ParameterSource, PointPlaces,
};
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cost::requests::{self, Counts, FitCounts};
use crate::wire::files::{Geometry, Record};
use crate::wire::record::{Placed, Placing};

/// Default part of the size of a shape that a representation may leave.
pub const USUAL_TOLERANCE: f64 = 0.01;
/// Parts that may be asked for.
const TOLERANCES: std::ops::RangeInclusive<f64> = 1e-4..=0.5;
/// Number of shapes of each kind that are fitted.
const TRIED: usize = 3;
/// Maximum number of control points of a proposal: solving for more takes seconds a shape.
const MOST: usize = 400;
/// Number of sizes that are tried, about: doublings up to that one, and bisections.
const SIZES: f64 = 8.0;

/// Numbers of control points for the shapes of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Proposal {
    /// Kind: `curve` or `mesh`.
    #[schema(example = "mesh")]
    kind: &'static str,
    /// Number of shapes that were fitted, the first ones of the file.
    shape_count: usize,
    /// A representation of these shapes, with the smallest number of control points that was found to suffice for all of them. Null
    /// where none does.
    #[schema(required = true)]
    representation: Option<Representation>,
    /// Root mean square distance of the points of a shape from the fit, the largest of the shapes that were fitted; in the unit of the
    /// file. Null where there is no representation.
    #[schema(required = true)]
    residual: Option<f64>,
    /// The largest distance of a point.
    #[schema(required = true)]
    largest: Option<f64>,
    /// The residual relative to the size of its shape.
    #[schema(required = true)]
    relative_residual: Option<f64>,
    /// Why there is no representation; absent where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

/// The first shapes of a file of each kind.
#[derive(Debug, Default)]
pub struct FirstShapes(Vec<(Kind, Vec<Record>)>);

/// Common properties of the shapes of a proposal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Kind {
    mesh: bool,
    closed: bool,
    dimension: usize,
}

impl Kind {
    /// The kind of a record for which a number of control points can be found.
    fn of(record: &Record, limits: &Limits) -> Option<Self> {
        match &record.geometry {
            Geometry::Mesh(mesh) if (4..=limits.points).contains(&mesh.vertices.len()) => {
                Some(Self { mesh: true, closed: true, dimension: 3 })
            }
            Geometry::Curve { points, closed }
                if (3..=limits.points).contains(&points.len())
                    && (2..=3).contains(&points.dimension())
                    && points.missing().is_empty() =>
            {
                Some(Self { mesh: false, closed: *closed, dimension: points.dimension() })
            }
            _ => None,
        }
    }

    /// The representation from which the search begins.
    fn representation(self) -> Result<Representation, ServiceError> {
        let dimension = self.dimension;
        let value = match self {
            Self { mesh: true, .. } => {
                serde_json::json!({"kind": "surface", "topology": "sphere", "control_points": [4, 4],
                    "generators": [{"name": "trigonometric"}, {"name": "trigonometric"}]})
            }
            Self { closed: true, .. } => serde_json::json!({"kind": "closed_curve", "dimension": dimension,
                "control_points": 4, "generator": {"name": "trigonometric"}}),
            _ => serde_json::json!({"kind": "open_curve", "dimension": dimension, "intervals": 4,
                "generator": {"name": "bspline", "degree": 3}}),
        };
        serde_json::from_value(value).map_err(|error| ServiceError::Internal(error.to_string()))
    }
}

impl FirstShapes {
    /// Keeps a record if it is one of the first of its kind.
    pub fn offer(&mut self, record: &Record, limits: &Limits) {
        let Some(kind) = Kind::of(record, limits) else { return };
        let known = self.0.iter().position(|(known, _)| *known == kind);
        let at = known.unwrap_or_else(|| {
            self.0.push((kind, Vec::new()));
            self.0.len() - 1
        });
        let records = &mut self.0[at].1;
        if records.len() < TRIED {
            records.push(record.clone());
        }
    }

    /// Predicted work of the fits of records of one kind.
    fn work((kind, records): &(Kind, Vec<Record>), limits: &Limits) -> Result<Work, ServiceError> {
        let sizes = records.iter().map(|record| match &record.geometry {
            Geometry::Mesh(mesh) => mesh.vertices.len(),
            Geometry::Curve { points, .. } => points.len(),
            Geometry::Landmarks(_) | Geometry::Fourier(_) => 0,
        });
        let points = sizes.sum::<usize>() as f64;
        let representation = kind.representation()?;
        let counts = Counts::for_stored(&representation, records.len(), limits).with_points(MOST);
        let fit = FitCounts { points, meshes: kind.mesh, tolerance: !kind.mesh, turns: 0 };
        Ok(SIZES * requests::fit(&representation, counts, fit, limits))
    }

    /// Leaves out records whose fits would take longer than a request may: the later ones of a kind first. Returns the work of the
    /// others.
    fn within(&mut self, limits: &Limits) -> Result<Work, ServiceError> {
        let most = limits.request_work.as_secs_f64() / (2.0 * self.0.len().max(1) as f64);
        let mut all = Work::MOMENT;
        for of_kind in &mut self.0 {
            while Self::work(of_kind, limits)?.check(most).is_err() && of_kind.1.pop().is_some() {}
            all = all + Self::work(of_kind, limits)?;
        }
        Ok(all)
    }

    /// Numbers of control points that leave at most `tolerance` of the size of each shape.
    ///
    /// # Errors
    /// A tolerance out of bounds; [`ServiceError::Cancelled`].
    pub async fn propose(mut self, app: &App, tolerance: f64) -> Result<Vec<Proposal>, ServiceError> {
        check_tolerance(tolerance)?;
        let work = self.within(&app.limits)?;
        let task_app = app.clone();
        app.pool
            .weighing(work)
            .run(move || {
                self.0
                    .into_iter()
                    .map(|(kind, records)| propose(&task_app, kind, records, tolerance))
                    .collect()
            })
            .await
    }
}

/// Refuses a tolerance out of bounds.
///
/// # Errors
/// A fault of the parameter `tolerance`.
pub fn check_tolerance(tolerance: f64) -> Result<(), ServiceError> {
    if TOLERANCES.contains(&tolerance) {
        return Ok(());
    }
    let (least, most) = TOLERANCES.into_inner();
    let detail = format!("expected a part of the size between {least} and {most}, got {tolerance}");
    Err(ServiceError::parameter("tolerance", detail))
}

/// A fit with the size of its shape.
struct Found {
    fitted: Fitted,
    size: f64,
}

fn propose(app: &App, kind: Kind, records: Vec<Record>, tolerance: f64) -> Result<Proposal, ServiceError> {
    let name = if kind.mesh { "mesh" } else { "curve" };
    let representation = kind.representation()?;
    let (shape_count, mut found) = (records.len(), Vec::new());
    let mut reason =
        (shape_count == 0).then(|| "expected smaller shapes, whose fits take a moment".to_owned());
    for record in records {
        app.pool.context().check()?;
        match fit(app, &representation, record, tolerance) {
            Ok(one) => found.push(one),
            Err(detail) => reason = reason.or(Some(detail)),
        }
    }
    app.pool.context().check()?;
    let largest = |of: fn(&Found) -> f64| found.iter().map(of).fold(0.0, f64::max);
    let widest = found.iter().max_by_key(|one| one.fitted.representation.size());
    let known = widest.filter(|_| reason.is_none());
    Ok(Proposal {
        kind: name,
        shape_count,
        representation: known.map(|one| one.fitted.representation.clone()),
        residual: known.map(|_| largest(|one| one.fitted.residual)),
        largest: known.map(|_| largest(|one| one.fitted.largest)),
        relative_residual: known.map(|_| largest(|one| one.fitted.residual / one.size)),
        reason,
    })
}

/// The fit of a record with the fewest control points that leave at most `tolerance` of its size.
fn fit(app: &App, representation: &Representation, record: Record, tolerance: f64) -> Result<Found, String> {
    let (target, size) = target_of(representation, record)?;
    if !(size > 0.0 && size.is_finite()) {
        return Err("expected a shape with an extent, got one without".into());
    }
    let space = ShapeSpace::new(representation).map_err(|error| error.to_string())?;
    let settings = FitSettings {
        tolerance: Some(tolerance * size),
        max_control_points: MOST.min(app.limits.control_points),
        ..FitSettings::default()
    };
    let fitter = Fitter::new(&space, settings).map_err(|error| error.to_string())?;
    let context = app.pool.context();
    let fitted = fitter.fit(target, &|| context.is_cancelled());
    let first = |faults: Vec<_>| faults.into_iter().next().map_or_else(String::new, detail_of);
    Ok(Found { fitted: fitted.map_err(first)?, size })
}

fn detail_of(fault: crate::geometry::field_fault::FieldFault) -> String {
    fault.detail
}

/// The target of the fit of a record, and its size.
fn target_of(representation: &Representation, record: Record) -> Result<(FitTarget, f64), String> {
    if let Geometry::Curve { points, .. } = &record.geometry {
        let rows = Matrix::from_row_slice(points.len(), points.dimension(), points.coordinates());
        let size = size_of(points.coordinates().chunks_exact(points.dimension()));
        return Ok((FitTarget::Points { points: rows, places: PointPlaces::Free }, size));
    }
    let placed = Placing::default().place(record, representation);
    match placed.map_err(|faults| faults.into_iter().next().map_or_else(String::new, |fault| fault.detail))? {
        Placed::Mesh(_, mesh) => {
            let size = size_of(mesh.vertices.iter().map(<[f64; 3]>::as_slice));
            let source = ParameterSource::Computed { poles: None };
            Ok((FitTarget::Mesh { mesh, source }, size))
        }
        Placed::Shape(_) | Placed::Fourier(..) => Err("expected a mesh".into()),
    }
}

/// Root mean square distance of points from their mean.
fn size_of<'a>(points: impl ExactSizeIterator<Item = &'a [f64]> + Clone) -> f64 {
    let count = points.len() as f64;
    let dimension = points.clone().next().map_or(0, <[f64]>::len);
    let mean = |c: usize| points.clone().map(|point| point[c]).sum::<f64>() / count;
    let variance = |c: usize| {
        let mean = mean(c);
        points.clone().map(|point| (point[c] - mean).powi(2)).sum::<f64>() / count
    };
    (0..dimension).map(variance).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_size_is_the_distance_from_the_mean() {
        let square = [[1.0, 5.0], [3.0, 5.0], [3.0, 9.0], [1.0, 9.0]];
        let size = size_of(square.iter().map(<[f64; 2]>::as_slice));
        assert!((size - 5.0_f64.sqrt()).abs() < 1e-15, "{size}");
    }

    #[test]
    fn tolerances_are_parts_of_the_size() {
        assert!(check_tolerance(USUAL_TOLERANCE).is_ok());
        for refused in [0.0, -1.0, f64::NAN, 1.0] {
            assert!(check_tolerance(refused).is_err(), "{refused}");
        }
    }
}
