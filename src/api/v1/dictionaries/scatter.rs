//! The morphospace of a dictionary as a picture.

use axum::response::Response;

use crate::analysis::drawing::morphospace::Outline;
use crate::api::extract::{BesideFormat, Caller, Path, PictureRequest};
use crate::api::problem::Problem;
use crate::api::respond::{compute, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::shape_query::Parameters;
#[cfg(feature = "schema")]
use crate::geometry::drawing::svg::{Background, Theme};
use crate::service::app::{ServiceError, Work};
use crate::service::cost::requests::{self, Counts};
use crate::service::tables::scatter::{ScatterQuery, scatter};

/// Query parameters of a scatter beside the filter, for the OpenAPI document.
#[cfg(feature = "schema")]
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` and the extractor read it")]
pub(in crate::api::v1) struct ScatterParameters {
    /// Id or name of the cohort whose shapes are drawn. Default: the one from which the dictionary was learnt.
    cohort: Option<String>,
    /// Component of the horizontal axis, from 1. Default: the first that is not that of the other axis.
    #[param(minimum = 1)]
    x: Option<usize>,
    /// Component of the vertical axis, from 1. Default: the first that is not that of the other axis.
    #[param(minimum = 1)]
    y: Option<usize>,
    /// Attribute whose values are the groups: `label`, `subject` or `labels.<attribute>`. Default: one group.
    groups: Option<String>,
    /// Line about the points of a group: `ellipse` holds 95 % of a normal distribution, `hull` all points. Default: `ellipse`.
    #[param(inline)]
    outline: Option<Outline>,
    /// Whether the mean ± 2 standard deviations stands at the ends of the axes. Default: true.
    shapes: Option<bool>,
    /// Format: `svg` or `png`. Default: `svg`.
    format: Option<String>,
    /// Colours. Default: `auto`, light or dark as the viewer prefers.
    #[param(inline)]
    theme: Option<Theme>,
    /// Background: a painted page, or nothing. Default: `page`.
    #[param(inline)]
    background: Option<Background>,
    /// Width in pixels; the height follows. Default: 640.
    #[param(minimum = 16, maximum = 4096)]
    width: Option<u16>,
    /// Whether the title is written above. Default: true.
    title: Option<bool>,
    /// Whether the legend is written below. Default: true.
    legend: Option<bool>,
}

fn take(pairs: Vec<(String, String)>) -> Result<ScatterQuery, Problem> {
    let mut parameters = Parameters::read(pairs)?;
    // The other axis is the first other component.
    let other = |component: usize| if component == 1 { 2 } else { 1 };
    let components = match (parameters.take_count("x")?, parameters.take_count("y")?) {
        (None, None) => [1, 2],
        (Some(x), None) => [x, other(x)],
        (None, Some(y)) => [other(y), y],
        (Some(x), Some(y)) => [x, y],
    };
    let shapes = parameters.take("shapes").map(|text| {
        text.parse()
            .map_err(|_| Problem::of_parameter("shapes", format!("expected true or false, got '{text}'")))
    });
    let query = ScatterQuery {
        cohort: parameters.take("cohort"),
        components,
        groups: parameters.take("groups"),
        outline: parameters.take_word::<Outline>("outline")?.unwrap_or_default(),
        shapes: shapes.transpose()?.unwrap_or(true),
        filter: parameters.take_filter(),
    };
    parameters.refuse_rest()?;
    Ok(query)
}

/// Draws shapes of a cohort as points in the plane of two components, in groups, with shapes at the ends of the axes.
///
/// Both axes have one scale. Of more than 20 000 shapes, every n-th one is drawn, and the legend says so. The scores themselves are
/// columns of the [table of a cohort](#/operations/find_table): `<dictionary>.score.1`.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/scatter", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), ScatterParameters, FilterQuery),
    responses(
        (status = 200, description = "The picture", content((String = "image/svg+xml"))),
        (status = 404, description = "No such dictionary or cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn dictionary_scatter(
    Caller(app): Caller,
    Path(key): Path<String>,
    request: PictureRequest,
    BesideFormat(pairs): BesideFormat<Vec<(String, String)>>,
) -> Result<Response, Problem> {
    let query = take(pairs)?;
    let file = request.file()?;
    let found = scatter(&app, &key, query).await?;
    let counts = Counts::for_space(&found.ready().setup.space, 4, &app.limits);
    let work = Work::MOMENT
        + requests::draw(counts, 4)
        + Work::numbers(2.0 * found.points() as f64)
        + requests::picture(&file);
    let draw = move || -> Result<Response, ServiceError> { picture(&found.draw()?, &file) };
    compute(app.weighing(work), move |_| draw()).await
}
