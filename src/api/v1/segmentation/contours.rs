//! Boundaries of label images: closed contours in the plane, closed surfaces in space.

use axum::body::Bytes;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::Response;

use crate::api::extract::{Caller, NoQuery};
use crate::api::form;
use crate::api::problem::Problem;
use crate::api::respond::{Binary, Planned, compute_planned, json, planned};
use crate::service::app::{App, ServiceError};
#[cfg(feature = "schema")]
use crate::service::segmentation::contours::ContoursAnswer;
use crate::service::segmentation::contours::{self, Wanted};
use crate::service::segmentation::image::{Coordinates, Part};
use crate::wire::checked::{Checked, Many, document, take_given, take_many, take_or_default};
use crate::wire::files::Photograph;

document! {
    /// Boundaries that are wanted of a label image.
    #[schema(example = json!({"least_cells": 20}))]
    pub(in crate::api::v1) struct ContoursRequest {
        /// Labels whose boundaries are wanted. Default: all but 0.
        #[schema(value_type = Option<Vec<u32>>)]
        labels: Many<u32>;
        /// Standard deviation of a Gaussian blur of the mask before its boundary is placed, in the unit of the coordinates: it
        /// smooths the steps between cells and moves points by less than half a cell. Default: 0.
        #[schema(value_type = Option<f64>, minimum = 0)]
        blur: Checked<f64>;
        /// Number of cells below which a component is left out. Default: 1.
        #[schema(value_type = Option<usize>)]
        least_cells: Checked<usize>;
        /// Whether only the largest component of each label is taken. Default: false.
        #[schema(value_type = Option<bool>)]
        largest: Checked<bool>;
        /// Whether holes and cavities are filled, and in space handles, each by a film one cell thick. Default: false.
        #[schema(value_type = Option<bool>)]
        fill: Checked<bool>;
        /// Treatment of an image that looks like a photograph: `refuse`, or `read`, which takes its grey values for
        /// labels. Default: `refuse`.
        #[schema(value_type = Option<PhotographTreatment>)]
        photograph: Checked<Photograph>;
        /// Slice of a volume, by its index along z from 0: the answer is that of an image in the plane. Default: the whole volume.
        #[schema(value_type = Option<usize>)]
        slice: Checked<usize>;
        /// Coordinates of the points. Default: `world`.
        #[schema(value_type = Option<Coordinates>)]
        coordinates: Checked<Coordinates>;
    }
}

/// Treatment of an image that looks like a photograph where labels are expected.
#[derive(utoipa::ToSchema)]
#[schema(rename_all = "snake_case")]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum PhotographTreatment {
    /// It is refused.
    Refuse,
    /// Its grey values are taken for labels.
    Read,
}

/// Form with a label image.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct ContoursForm {
    /// Parameters of the request; the first part.
    parameters: ContoursRequest,
    /// Image of whole numbers: PNG, TIFF, NIfTI-1, NRRD or DICOM segmentation.
    image: Binary,
}

/// Computes the boundaries of the labels of an image or a volume.
///
/// Each connected component of a label has one outer boundary, and its holes or cavities apart: nothing is merged. Cells of an
/// image are connected across sides, those of a volume across faces. Points are in the middle between cells inside and outside,
/// or where the blurred mask is ½. The contours can be posted as shapes, and the surfaces fitted with `POST /v1/fit`.
#[utoipa::path(post, path = "/v1/contours", tag = "images",
    request_body(content = ContoursForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "The boundaries, one entry for each component", body = ContoursAnswer)
    ))]
pub(in crate::api::v1) async fn contours(
    Caller(app): Caller,
    _: NoQuery,
    request: Request,
) -> Result<Response, Problem> {
    let form = form::read(&app, request, &["image"]).await?;
    let image = form.required("image")?;
    let parameters = form.parameters;
    compute_planned(app, parameters, move |app, parameters| {
        let (wanted, slice) = app.parse::<ContoursRequest>(parameters)?.wanted()?;
        let found = contours::Planned::new(app, Part { name: "image", bytes: &image, slice }, wanted)?;
        plan(found, image.clone(), slice)
    })
    .await
}

fn plan(found: contours::Planned, image: Bytes, slice: Option<usize>) -> Result<Planned, ServiceError> {
    planned(found.work(), move |app: &App| {
        let image = Part { name: "image", bytes: &image, slice };
        json(StatusCode::OK, &found.contours(app, image)?)
    })
}

impl ContoursRequest {
    /// The settings, and the slice.
    fn wanted(self) -> Result<(Wanted, Option<usize>), ServiceError> {
        let mut errors = self.faults;
        let labels = take_many(self.labels, "/labels", &mut errors);
        let blur = take_or_default(self.blur, "/blur", &mut errors);
        let least_cells = take_given(self.least_cells, "/least_cells", &mut errors);
        let largest = take_or_default(self.largest, "/largest", &mut errors);
        let fill = take_or_default(self.fill, "/fill", &mut errors);
        let photograph = take_or_default(self.photograph, "/photograph", &mut errors);
        let slice = take_given(self.slice, "/slice", &mut errors);
        let coordinates = take_or_default(self.coordinates, "/coordinates", &mut errors);
        ServiceError::unless_empty(errors)?;
        let (Some(blur), Some(largest), Some(fill), Some(photograph), Some(coordinates)) =
            (blur, largest, fill, photograph, coordinates)
        else {
            return Err(ServiceError::invalid("", "the request is incomplete"));
        };
        let least_cells = least_cells.unwrap_or(1);
        Ok((Wanted { labels, blur, least_cells, largest, fill, photograph, coordinates }, slice))
    }
}
