//! Paths between two posted shapes: straight lines, or great circles between shapes of unit norm.
//!
//! The functions are synchronous and run on the pool.

use super::curves::each;
use super::request::Posted;
use crate::analysis::path::Path;
use crate::formats::fault::Fault;
use crate::formats::shape::ShapeInput;
use crate::geometry::drawing::svg::{self, Layer, colour};
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::{App, Limits, ServiceError};

/// Kind of path between two shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PathKind {
    /// Straight line `(1 − τ) r_1 + τ r_2`.
    #[default]
    Plane,
    /// Great circle between the shapes scaled to unit `L₂` norm.
    Sphere,
}

/// A path between two shapes.
#[derive(Debug)]
pub struct Morph {
    /// Position `τ` and control points of every frame.
    pub frames: Vec<(f64, Matrix)>,
    /// Angle between the shapes in radians, for paths on the sphere.
    pub angle: Option<f64>,
}

/// Positions on a path.
#[derive(Debug, Clone, PartialEq)]
pub enum Positions {
    /// Equally spaced from 0 to 1, at least two.
    Steps(usize),
    /// The given positions.
    At(Vec<f64>),
}

impl Positions {
    /// Number of positions.
    pub fn count(&self) -> usize {
        match self {
            Self::At(list) => list.len(),
            Self::Steps(count) => *count,
        }
    }

    /// List of all positions, for shapes of `size` control points.
    ///
    /// # Errors
    /// Too many positions, or positions out of range.
    pub(crate) fn list(&self, size: usize, limits: &Limits) -> Result<Vec<f64>, ServiceError> {
        let mut faults = Vec::new();
        let (positions, pointer) = match self {
            Self::At(list) => (list.clone(), "/positions"),
            Self::Steps(count) => {
                ((0..*count).map(|i| i as f64 / (count - 1) as f64).collect::<Vec<f64>>(), "/steps")
            }
        };
        let (total, most) = (positions.len().saturating_mul(size), limits.samples);
        if positions.is_empty() || total > most {
            let detail =
                format!("expected between 1 and {most} control points over all positions, got {total}");
            faults.push(Fault::new(pointer, detail));
        }
        let wild = positions.iter().enumerate().filter(|(_, tau)| !(tau.abs() <= MAX_POSITION));
        faults.extend(wild.map(|(i, tau)| {
            Fault::new(
                format!("/positions/{i}"),
                format!("expected a number within ±{MAX_POSITION}, got {tau}"),
            )
        }));
        ServiceError::unless_empty(faults)?;
        Ok(positions)
    }
}

/// Maximum number of frames of an animation.
const MAX_FRAMES: usize = 1000;
/// Maximum size of an animation in bytes: no browser plays longer ones.
const MAX_DRAWN: usize = 16 << 20;

/// Maximum extrapolation.
const MAX_POSITION: f64 = 1000.0;

/// Shapes at `positions` of the path from one shape to another.
///
/// # Errors
/// Faults of the shapes at `/from…` and `/to…`, and of the positions; opposite shapes.
pub fn morph(
    app: &App,
    posted: &Posted,
    kind: PathKind,
    positions: &Positions,
    from: ShapeInput,
    to: ShapeInput,
) -> Result<Morph, ServiceError> {
    let mut faults = Faults::default();
    let positions = faults.keep(positions.list(posted.metric.size(), &app.limits))?;
    let mut read = |shape, pointer: &str| faults.keep(posted.read_one(app, shape, pointer));
    let shapes = (read(from, "/from")?, read(to, "/to")?);
    let (Some(positions), (Some(first), Some(second))) = (positions, shapes) else {
        return Err(ServiceError::Invalid(faults));
    };
    let (first, second) = (first.as_slice().to_vec(), second.as_slice().to_vec());
    let path = match kind {
        PathKind::Plane => Path::plane(first, second),
        PathKind::Sphere => Path::sphere(&posted.metric, first, second).map_err(|error| {
            let pointer = |index: usize| if index == 0 { "/from".to_owned() } else { "/to".to_owned() };
            ServiceError::of_analysis(error, pointer).without_index()
        })?,
    };
    let frames = each(&app.pool.context(), &positions, |&tau| (tau, posted.matrix(&path.at(tau))))?;
    Ok(Morph { frames, angle: path.angle() })
}

/// Animated drawing of a path, through its frames and back.
///
/// # Errors
/// Too many frames.
pub fn draw_morph(posted: &Posted, title: &str, morph: &Morph) -> Result<String, ServiceError> {
    if morph.frames.len() > MAX_FRAMES {
        let detail =
            format!("expected at most {MAX_FRAMES} positions in a drawing, got {}", morph.frames.len());
        return Err(ServiceError::invalid("/positions", detail));
    }
    let shapes = morph.frames.iter().map(|(_, shape)| shape.as_slice());
    let layer = Layer::of(&posted.space, shapes, colour::MAIN, 2.5, 1.0);
    let bytes = svg::animation_bytes(&layer);
    if bytes > MAX_DRAWN {
        let detail = format!(
            "expected an animation of at most {MAX_DRAWN} bytes, got about {bytes}: ask for fewer positions"
        );
        return Err(ServiceError::invalid("", detail));
    }
    Ok(svg::animate(title, &layer))
}
