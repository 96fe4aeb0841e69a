//! Thin sheets of volumes.

use axum::body::Body;
use axum::extract::Request;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

use crate::api::extract::{Caller, Query};
use crate::api::form;
use crate::api::problem::Problem;
use crate::api::respond::{Binary, compute_planned, planned};
use crate::service::app::{App, ServiceError};
use crate::service::segmentation::image::{Coordinates, Part};
use crate::service::segmentation::request::ObjectPolarity;
use crate::service::segmentation::sheets::{self, SheetField, Wanted};
use crate::service::segmentation::shown::LabelFormat;
use crate::wire::checked::{Checked, Many, document, take_given, take_many, take_or_default};

document! {
    /// Detection of the sheets of a volume.
    #[schema(example = json!({"field": "surface", "polarity": "dark", "sigma": 2}))]
    pub(in crate::api::v1) struct SheetsRequest {
        /// Field that is answered. Default: `response`.
        #[schema(value_type = Option<SheetField>)]
        field: Checked<SheetField>;
        /// Standard deviation of the blur, in the unit of the coordinates, at least half a cell along every axis. Default: two cells.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0)]
        sigma: Checked<f64>;
        /// Whether sheets are brighter or darker than their surroundings. Default: `bright`.
        #[schema(value_type = Option<ObjectPolarity>)]
        polarity: Checked<ObjectPolarity>;
        /// Part of the percentile below which responses are no crests. Default: 0.3.
        #[schema(value_type = Option<f64>, minimum = 0, maximum = 1)]
        fraction: Checked<f64>;
        /// Percentile of the positive responses. Default: 99.
        #[schema(value_type = Option<f64>, minimum = 0, maximum = 100)]
        percent: Checked<f64>;
        /// Point around which the innermost surface lies. Default: the middle of the volume.
        #[schema(value_type = Option<Vec<f64>>, min_items = 3, max_items = 3)]
        centre: Many<f64>;
        /// Distance from this point above which the surface is looked for. Default: 0.
        #[schema(value_type = Option<f64>, minimum = 0)]
        beyond: Checked<f64>;
        /// Coordinates of blur, point and distance. Default: `world`.
        #[schema(value_type = Option<Coordinates>)]
        coordinates: Checked<Coordinates>;
        /// Slice of a picture, by its index along z from 0. Default: the middle one.
        #[schema(value_type = Option<usize>)]
        slice: Checked<usize>;
    }
}

/// Form with a volume.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct SheetsForm {
    /// Parameters of the request; the first part.
    parameters: SheetsRequest,
    /// Volume: TIFF or NIfTI.
    image: Binary,
}

/// Format of a file.
#[derive(Debug, Default, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum FileFormat {
    #[default]
    Nifti,
    Png,
}

/// Query parameters of the sheets of a volume.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct SheetsQuery {
    /// Format of the answer: a volume, or a picture of one slice. Default: `nifti`.
    #[serde(default)]
    #[param(inline, required = false)]
    format: FileFormat,
}

/// Detects thin bright or dark sheets in a volume, such as the skull around a brain.
///
/// The response of a cell is that of the steerable kernel `Δg − 5 g_vv` along the direction that fits best. Crests are its maxima
/// across sheets. The innermost surface around a point is answered as a separate image, whose edges a segmentation with the term `contour`
/// follows.
#[utoipa::path(post, path = "/v1/sheets", tag = "images", params(SheetsQuery),
    request_body(content = SheetsForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "The field", content((Binary = "application/x-nifti"), (Binary = "image/png")))
    ))]
pub(in crate::api::v1) async fn detect_sheets(
    Caller(app): Caller,
    Query(SheetsQuery { format }): Query<SheetsQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let form = form::read(&app, request, &["image"]).await?;
    let image = form.required("image")?;
    let format = match format {
        FileFormat::Nifti => LabelFormat::Nifti,
        FileFormat::Png => LabelFormat::Png,
    };
    compute_planned(app, form.parameters, move |app, parameters| {
        let wanted = app.parse::<SheetsRequest>(parameters)?.wanted()?;
        let part = Part { name: "image", bytes: &image, slice: None };
        let found = sheets::Planned::new(app, part, wanted)?;
        let (work, image) = (found.work(), image.clone());
        planned(work, move |app: &App| {
            let file = found.file(app, Part { name: "image", bytes: &image, slice: None }, format)?;
            Ok(([(header::CONTENT_TYPE, format.media_type())], Body::from(file)).into_response())
        })
    })
    .await
}

impl SheetsRequest {
    fn wanted(self) -> Result<Wanted, ServiceError> {
        let mut errors = self.faults;
        let wanted = Wanted {
            field: take_or_default(self.field, "/field", &mut errors).unwrap_or_default(),
            sigma: take_given(self.sigma, "/sigma", &mut errors),
            polarity: take_or_default(self.polarity, "/polarity", &mut errors).unwrap_or_default(),
            fraction: take_given(self.fraction, "/fraction", &mut errors).unwrap_or(sheets::FRACTION),
            percent: take_given(self.percent, "/percent", &mut errors).unwrap_or(sheets::PERCENT),
            centre: take_many(self.centre, "/centre", &mut errors),
            beyond: take_or_default(self.beyond, "/beyond", &mut errors).unwrap_or_default(),
            coordinates: take_or_default(self.coordinates, "/coordinates", &mut errors).unwrap_or_default(),
            slice: take_given(self.slice, "/slice", &mut errors),
        };
        ServiceError::unless_empty(errors)?;
        Ok(wanted)
    }
}
