//! Semilandmarks that slide along curves and on surfaces.

use std::collections::BTreeMap;

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;
use serde_json::value::RawValue;

use crate::analysis::sliding::SlidingCriterion;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::json;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::checked;
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeAttributes;
use crate::service::app::ServiceError;
use crate::service::sliding::{
    self, SliderSource, SlidingFound, SlidingProtocol, SlidingRequest, SlidingShapes,
};
use crate::wire::checked::{
    Checked, LARGE, List, Many, Raw, document, take_given, take_many, take_or_default,
};
use crate::wire::fault::Fault;
use crate::wire::shape::{Points, ShapeInput};

/// Sliders along curves.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
#[cfg(feature = "schema")]
pub(in crate::api::v1) enum SlidersInput {
    /// Rows *before, slide, after*: indices of points from 0.
    Rows(Vec<[usize; 3]>),
    /// `auto`, or the text of a table whose numbers begin with 1, such as geomorph writes.
    Text(String),
}

document! {
    /// Shapes whose points slide.
    #[schema(example = json!({
        "shapes": [
            {"external_id": "a", "points": [[0, 0], [1, 0.9], [2.2, 1.2], [3, 0.8], [4, 0], [2, -1]]},
            {"external_id": "b", "points": [[0, 0], [0.8, 0.8], [1.9, 1.3], [3.2, 0.8], [4, 0.1], [2, -1.2]]},
            {"external_id": "c", "points": [[0, 0.1], [1.2, 1.0], [2.0, 1.1], [2.9, 0.9], [4, 0], [2.1, -1]]}
        ],
        "sliders": [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    }))]
    pub(in crate::api::v1) struct SlideRequest {
        /// Shapes with the same number of points, in the plane or in space; at least 2.
        #[schema(value_type = Option<Vec<ShapeInput>>, min_items = 2)]
        shapes: List<ShapeInput>;
        /// Name or id of a cohort of landmarks, in place of `shapes`.
        #[schema(value_type = Option<String>)]
        cohort: Checked<String>;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Points that slide along curves: rows *before, slide, after* of indices from 0; the text of such a table, whose numbers begin with
        /// 1; or `auto`: the points within the curves of the shapes, whose metadata say `landmarks` and `curves` as files of TPS read with
        /// `curves=append` do.
        #[schema(value_type = Option<SlidersInput>)]
        sliders: Raw;
        /// Indices of the points along each curve, in place of `sliders`: all but the ends slide. A closed curve begins and ends with the
        /// same point.
        #[schema(value_type = Option<Vec<Vec<usize>>>)]
        curves: Many<Vec<usize>, LARGE>;
        /// With `auto`: for each curve, the two landmarks between which its points lie, which then slide all, or null.
        #[schema(value_type = Option<Vec<Option<[usize; 2]>>>)]
        attach: Checked<Vec<Option<[usize; 2]>>>;
        /// Indices of points that slide on a surface, in space.
        #[schema(value_type = Option<Vec<usize>>)]
        surface: Checked<Vec<usize>, LARGE>;
        /// Criterion that sliding minimises. Default: `bending_energy`.
        #[schema(value_type = Option<SlidingCriterion>)]
        criterion: Checked<SlidingCriterion>;
        /// Protocol of the rounds. Default: `centred`.
        #[schema(value_type = Option<SlidingProtocol>)]
        protocol: Checked<SlidingProtocol>;
        /// With `gpagen`: whether superimposed shapes are projected into the tangent space at their mean. Default: true.
        #[schema(value_type = Option<bool>)]
        project: Checked<bool>;
        /// With `gpagen`: whether superimposed shapes are turned by the principal axes of the consensus; those of `centred` are. Default: true.
        #[schema(value_type = Option<bool>)]
        principal_axes: Checked<bool>;
    }
}

/// A shape that has slid, as cohorts take it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SlidShape {
    /// Identifier assigned by the client; of a shape of a cohort without one, its id.
    #[serde(skip_serializing_if = "Option::is_none")]
    external_id: Option<String>,
    /// Opaque identifier of the subject.
    #[serde(skip_serializing_if = "Option::is_none")]
    subject: Option<String>,
    /// Class label.
    #[serde(skip_serializing_if = "Option::is_none")]
    label: Option<String>,
    /// Additional attributes.
    #[schema(value_type = Attributes)]
    labels: BTreeMap<String, serde_json::Value>,
    /// Weight in means.
    weight: f64,
    /// Metadata, as given.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = serde_json::Value, required = false)]
    metadata: Option<Box<RawValue>>,
    /// Points after they have slid: in the position and size of the shape under `centred`; superimposed under `gpagen`.
    points: Points,
}

/// Shapes that have slid.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SlideAnswer {
    /// Consensus of the superimposed shapes: of unit size under `centred`, the mean of the projected shapes under `gpagen`.
    consensus: Points,
    /// The shapes, in request order; they can be posted to a cohort as they are.
    shapes: Vec<SlidShape>,
    /// Superimposed shapes of unit size.
    aligned: Vec<Points>,
    /// Displacements of points along curves, in units of centroid size, for each shape and row of `sliders`, positive towards the point
    /// after. Absent under `gpagen`.
    #[serde(skip_serializing_if = "Option::is_none")]
    displacements: Option<Vec<Vec<f64>>>,
    /// Rows *before, slide, after*, in ascending order of the points that slide.
    sliders: Vec<[usize; 3]>,
    /// Points that slide on a surface.
    surface: Vec<usize>,
    /// Criterion that was minimised.
    criterion: SlidingCriterion,
    /// Protocol of the rounds.
    protocol: SlidingProtocol,
    /// Number of rounds; those of `gpagen` include the superimposition.
    rounds: usize,
    /// Whether the last round changed nothing.
    converged: bool,
    /// Distance by which the consensus moved in the last round.
    last_move: f64,
    /// Squared size of the sum of the shapes, divided by their number, after each round of `gpagen`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    criterion_values: Vec<f64>,
    /// Limitations of the result.
    warnings: Vec<String>,
}

/// Slides semilandmarks along curves and on surfaces, and superimposes the shapes.
///
/// Points slide until the bending energy from the consensus, or the distance from it, is smallest. `centred` solves for displacements from
/// the points as given, whose mean over the shapes is 0: it converges. `gpagen` repeats geomorph's iteration, which does not, to ten digits.
#[utoipa::path(post, path = "/v1/slide", tag = "statistics", request_body = SlideRequest,
    responses(
        (status = 200, description = "Shapes that have slid, and their consensus", body = SlideAnswer),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn slide(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let reader = app.clone();
    let request = app.pool.read(body, move |body| reader.parse::<SlideRequest>(body)?.checked()).await?;
    let (criterion, protocol) = (request.criterion, request.protocol);
    let found = sliding::slide(&app, request).await?;
    let write = move || json(StatusCode::OK, &SlideAnswer::new(found, criterion, protocol)?);
    Ok(app.pool.run(write).await?)
}

impl SlideRequest {
    fn checked(self) -> Result<SlidingRequest, ServiceError> {
        let mut errors = self.faults;
        let posted = self.shapes.map(|shapes| shapes.take("/shapes", &mut errors));
        let cohort = take_given(self.cohort, "/cohort", &mut errors);
        let has_filter = self.filter.is_some();
        let filter = take_filter(self.filter, "/filter", &mut errors);
        let curves = take_many(self.curves, "/curves", &mut errors);
        let attach = take_given(self.attach, "/attach", &mut errors);
        let surface = take_or_default(self.surface, "/surface", &mut errors);
        let criterion = take_or_default(self.criterion, "/criterion", &mut errors);
        let protocol = take_or_default(self.protocol, "/protocol", &mut errors);
        let mut option = |field: Option<Checked<bool>>, pointer: &str| {
            if field.is_some() && protocol != Some(SlidingProtocol::Gpagen) {
                errors.push(Fault::new(pointer, "expected with the protocol gpagen only"));
            }
            take_given(field, pointer, &mut errors).unwrap_or(true)
        };
        let options = [option(self.project, "/project"), option(self.principal_axes, "/principal_axes")];
        let sliders = sliders(self.sliders, curves, attach, &mut errors);
        let shapes = match (posted, cohort) {
            (Some(shapes), None) if !has_filter => Some(SlidingShapes::Posted(shapes)),
            (Some(_), None) => {
                errors.push(Fault::new("/filter", "expected with a cohort only"));
                None
            }
            (None, Some(cohort)) => filter.map(|filter| SlidingShapes::Cohort(cohort, Box::new(filter))),
            (None, None) if !errors.is_empty() => None,
            _ => {
                errors.push(Fault::new("", "expected either shapes or a cohort"));
                None
            }
        };
        let rest = surface.zip(criterion).zip(protocol);
        let ((shapes, (sliders, ((surface, criterion), protocol))), _) =
            checked(shapes.zip(sliders.zip(rest)), errors, Vec::new())?;
        Ok(SlidingRequest { shapes, sliders, surface, criterion, protocol, options })
    }
}

/// Source of the sliders of a request.
fn sliders(
    given: Option<Raw>,
    curves: Option<Vec<Vec<usize>>>,
    attach: Option<Vec<Option<[usize; 2]>>>,
    errors: &mut Vec<Fault>,
) -> Option<SliderSource> {
    let found = match given {
        None => SliderSource::None,
        Some(raw) if raw.is_text() => match raw.read_large::<String>("/sliders", errors)? {
            text if text == "auto" => SliderSource::Auto(attach.clone().unwrap_or_default()),
            text => SliderSource::Text(text),
        },
        Some(raw) => SliderSource::Rows(raw.read_large("/sliders", errors)?),
    };
    if attach.is_some() && !matches!(found, SliderSource::Auto(_)) {
        errors.push(Fault::new("/attach", "expected with the sliders auto only"));
    }
    match (curves, found) {
        (None, found) => Some(found),
        (Some(curves), SliderSource::None) => Some(SliderSource::Curves(curves)),
        (Some(_), _) => {
            errors.push(Fault::new("/curves", "expected either sliders or curves, got both"));
            None
        }
    }
}

impl SlideAnswer {
    fn new(
        found: SlidingFound,
        criterion: SlidingCriterion,
        protocol: SlidingProtocol,
    ) -> Result<Self, ServiceError> {
        let SlidingFound { attributes, dimension, sliders, slid, warnings } = found;
        let points = |shape: Vec<f64>| Points::from_columns(shape, dimension);
        let aligned: Vec<Points> = slid.aligned.into_iter().map(points).collect();
        let own = slid.points.map_or_else(|| aligned.clone(), |own| own.into_iter().map(points).collect());
        let shapes =
            attributes.into_iter().zip(own).map(|(attributes, points)| SlidShape::new(attributes, points));
        Ok(Self {
            consensus: points(slid.consensus),
            shapes: shapes.collect::<Result<_, ServiceError>>()?,
            aligned,
            displacements: slid.displacements,
            sliders: sliders.curves,
            surface: sliders.surface,
            criterion,
            protocol,
            rounds: slid.rounds,
            converged: slid.converged,
            last_move: slid.last_move,
            criterion_values: slid.criterion,
            warnings,
        })
    }
}

impl SlidShape {
    fn new(attributes: ShapeAttributes, points: Points) -> Result<Self, ServiceError> {
        let ShapeAttributes { external_id, subject, label, labels, weight, metadata } = attributes;
        let metadata = metadata.map(RawValue::from_string).transpose();
        let metadata = metadata.map_err(|error| ServiceError::Internal(error.to_string()))?;
        Ok(Self { external_id, subject, label, labels, weight, metadata, points })
    }
}
