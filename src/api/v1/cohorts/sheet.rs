//! Contact sheets: many shapes of a cohort in one picture.

use axum::response::Response;

use crate::api::extract::{BesideFormat, Caller, Path, PictureRequest};
use crate::api::problem::Problem;
use crate::api::respond::{compute, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::Asked;
use crate::api::v1::requests::request_macros::PageQuery;
use crate::api::v1::requests::shape_query::Parameters;
use crate::domain::cohort::Cohort;
use crate::domain::shape::Shape;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::drawing::svg::Style;
#[cfg(feature = "schema")]
use crate::geometry::drawing::svg::{Background, Theme};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue::{self, ShapeListing, ShapesFound, revision_tag};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::draw::{draw_sheet, most_of_a_sheet};
use crate::wire::picture::{MAX_PIXELS, PictureFile, PictureFormat};

/// Query parameters of a contact sheet beside filter and page, for the OpenAPI document.
#[cfg(feature = "schema")]
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(in crate::api::v1) struct SheetQuery {
    /// Number of shapes side by side, at most 100. Default: 10.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    #[param(minimum = 1, maximum = 100)]
    columns: Option<usize>,
    /// Width and height of a shape in pixels. Default: 96. `columns` times `size` is at most 4096.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    #[param(minimum = 16, maximum = 400)]
    size: Option<usize>,
    /// Attribute that gives the order, as in lists of shapes. Default: the order in which shapes were added.
    #[allow(dead_code, reason = "only for the document; `Parameters` reads it")]
    order: Option<String>,
    /// Format: `svg` or `png`. Default: `svg`.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    format: Option<String>,
    /// Colours. Default: `auto`, light or dark as the viewer prefers.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    #[param(inline)]
    theme: Option<Theme>,
    /// Background: a painted page, or nothing. Default: `page`.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    #[param(inline)]
    background: Option<Background>,
    /// Whether the title is written above. Default: true.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    title: Option<bool>,
    /// Whether there is a scale bar. Default: true.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    scale_bar: Option<bool>,
}

/// Cells of a sheet.
#[derive(Debug, Clone, Copy)]
struct Cells {
    columns: usize,
    size: usize,
}

impl Cells {
    fn take(parameters: &mut Parameters) -> Result<Self, Problem> {
        let columns = take_number(parameters, "columns", 10, (1, 100))?;
        let size = take_number(parameters, "size", 96, (16, 400))?;
        let (width, most) = (columns * size, usize::from(Style::WIDTHS.1));
        if width > most {
            let detail = format!("expected columns times size to be at most {most}, got {width}");
            return Err(Problem::of_parameter("size", detail));
        }
        Ok(Self { columns, size })
    }

    fn width(self) -> u16 {
        (self.columns * self.size) as u16
    }

    /// Number of pixels of a sheet of so many shapes.
    fn pixels(self, shapes: usize) -> usize {
        self.columns * self.size * shapes.div_ceil(self.columns) * self.size
    }
}

/// Takes a whole number within bounds.
fn take_number(
    parameters: &mut Parameters,
    name: &str,
    usual: usize,
    (least, most): (usize, usize),
) -> Result<usize, Problem> {
    let Some(text) = parameters.take(name) else { return Ok(usual) };
    text.parse().ok().filter(|number| (least..=most).contains(number)).ok_or_else(|| {
        let detail = format!("expected a whole number between {least} and {most}, got '{text}'");
        Problem::of_parameter(name, detail)
    })
}

/// A request for a sheet.
struct Sheet {
    cells: Cells,
    listing: ShapeListing,
}

impl Sheet {
    fn take(pairs: Vec<(String, String)>) -> Result<Self, Problem> {
        let mut parameters = Parameters::read(pairs)?;
        let cells = Cells::take(&mut parameters)?;
        let page = PageQuery { cursor: parameters.take("cursor"), limit: parameters.take_count("limit")? };
        let listing = ShapeListing {
            revision: None,
            filter: parameters.take_filter(),
            order: parameters.take_order()?,
            limit: page.limit()?,
            cursor: page.cursor,
            geometry: true,
            total: false,
        };
        parameters.refuse_rest()?;
        Ok(Self { cells, listing })
    }

    /// Refuses a PNG of too many pixels before its shapes are read.
    fn check_pixels(&self, format: PictureFormat) -> Result<(), Problem> {
        let pixels = self.cells.pixels(self.listing.limit);
        if format == PictureFormat::Svg || pixels as u64 <= MAX_PIXELS {
            return Ok(());
        }
        let detail =
            format!("expected a PNG of at most {MAX_PIXELS} pixels, got {pixels}: lower size or limit");
        Err(Problem::of_parameter("size", detail))
    }
}

/// Draws many shapes of a cohort in one picture, on one scale, in the order in which they were added or in that of an attribute.
///
/// Each shape has its external id, or its id, as its title. The header `Link` has the address of the next page
/// (`rel="next"`), if there is one. Of surfaces a page has at most 12.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/sheet", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), SheetQuery, FilterQuery, PageQuery),
    responses(
        (status = 200, description = "The picture", content((String = "image/svg+xml")), headers(("Link" = String, description = "Address of the next page"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn cohort_sheet(
    Caller(app): Caller,
    Path(key): Path<String>,
    request: PictureRequest,
    BesideFormat(pairs): BesideFormat<Vec<(String, String)>>,
    asked: Asked,
) -> Result<Response, Problem> {
    let sheet = Sheet::take(pairs)?;
    sheet.check_pixels(request.format)?;
    let format = request.format;
    let file = request.of_width(sheet.cells.width())?;
    let cohort = catalogue::find(&app, &key).await?;
    let revision = revision_tag(&cohort);
    let answer = async {
        let Sheet { cells, mut listing } = sheet;
        listing.limit = listing.limit.min(most_of_a_sheet(cohort.spec.representation.domain()));
        let (_, ShapesFound { page: (shapes, next), .. }) =
            catalogue::list_shapes(&app, &cohort.id, &listing).await?;
        let work = work(&app, &cohort, cells, shapes.len(), &file);
        let draw = move |app: &App| picture(&drawn(app, &cohort, cells, shapes)?, &file);
        Ok(asked.linked(compute(app.weighing(work), draw).await?, next))
    };
    asked.unless_known(&revision, format, answer).await
}

/// Predicted work of drawing the shapes.
fn work(app: &App, cohort: &Cohort, cells: Cells, shapes: usize, file: &PictureFile) -> Work {
    let painting = requests::painting(file.format, cells.pixels(shapes) as f64);
    requests::draw(Counts::for_cohort(cohort, &app.limits), shapes) + painting
}

fn drawn(app: &App, cohort: &Cohort, cells: Cells, shapes: Vec<Shape>) -> Result<Drawing, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    let named = |shape: Shape| (shape.attributes.external_id.unwrap_or(shape.id), shape.control_points);
    let shapes: Vec<(String, Vec<f64>)> = shapes.into_iter().map(named).collect();
    let title = format!("{} of {} shapes of {}", shapes.len(), cohort.shapes, cohort.spec.name);
    Ok(draw_sheet(&space, &title, &shapes, cells.columns, cohort.spec.shown_unit()))
}
