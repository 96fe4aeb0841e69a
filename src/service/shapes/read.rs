//! Converts posted shapes to control points of a representation.
//!
//! Points lie on the shape, control points are its coefficients. Under `arc_length` and `cyclic`, any number of points
//! is resampled to the size of the representation. Under `cyclic`, resampling begins at the canonical start of the
//! contour, so that the stored shape does not depend on the first point of the list.

use std::collections::BTreeMap;

use bytes::Bytes;
use rayon::prelude::*;
use serde::de::DeserializeOwned;

use super::read_points::{contour, given};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::domain::shape::ShapeAttributes;
use crate::formats::bounds;
use crate::formats::checked::{Checked, LARGE, Metadata, SMALL, take_given};
use crate::formats::fault::{Fault, json_pointer};
use crate::formats::shape::{MAX_COORDINATE, PointList, PoleInput, PolesInput, ShapeInput};
use crate::geometry::capability::domain::{Domain, SizeBounds};
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::resample::{
    NO_EXTENT, canonical_shift, polygon_area, rotate_start, without_closing_point,
};
use crate::geometry::surface::basis::{Extent, Tangents};
use crate::numeric::dense::Matrix;
use crate::service::app::faults::{Faults, MAX_FAULTS};
use crate::service::app::{App, Limits, ServiceError};

/// Conversion of posted points to control points.
#[derive(Debug, Clone, Copy)]
pub struct Reading<'a> {
    /// The space of the shapes.
    pub space: &'a ShapeSpace,
    /// Correspondence: resampling and start.
    pub correspondence: Correspondence,
    /// Direction of planar contours.
    pub direction: Direction,
    /// Limits on sizes.
    pub limits: &'a Limits,
}

/// Maximum length of an identifier or label.
const MAX_TEXT: usize = 500;
/// Why normals are refused.
const NORMALS: &str = "expected no normals: they belong to the subdivision scheme normal_based";
/// Most attributes of a shape.
const MAX_LABELS: usize = 100;

/// Checks the sizes of a representation against the limits, and that its shapes form a linear space.
///
/// # Errors
/// All fields that are out of bounds.
pub fn check_representation(representation: &Representation, limits: &Limits) -> Result<(), Vec<Fault>> {
    check_sizes(representation, limits)?;
    representation.linearity_fault().map_or(Ok(()), |fault| Err(vec![fault.into()]))
}

/// Checks the sizes of a representation against the limits, then its control mesh, if it has one.
///
/// # Errors
/// All fields that are out of bounds, or the first invalid face or vertex.
pub(crate) fn check_sizes(representation: &Representation, limits: &Limits) -> Result<(), Vec<Fault>> {
    let bounds = SizeBounds { control_points: limits.control_points, vertices: limits.vertices };
    let faults: Vec<Fault> = representation.faults(bounds).into_iter().map(Fault::from).collect();
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}

/// Checks that mirror images exist if they are requested.
///
/// # Errors
/// A fault at `/mirror`.
pub fn check_mirror(representation: &Representation, mirror: Mirror) -> Result<(), ServiceError> {
    if mirror == Mirror::Allow && representation.domain().is_mesh() {
        let detail = "expected \"forbid\" for subdivision surfaces, got \"allow\": the correspondence between a \
                      control mesh and its mirror image is unknown";
        return Err(ServiceError::invalid("/mirror", detail));
    }
    Ok(())
}

/// Checks that the correspondence applies to the representation.
///
/// # Errors
/// A fault at `/correspondence`.
pub fn check_correspondence(
    representation: &Representation,
    correspondence: Correspondence,
) -> Result<(), ServiceError> {
    let detail = match (representation.domain(), correspondence) {
        (_, Correspondence::Landmarks) => return Ok(()),
        (Domain::Sheet { .. }, _) => {
            "expected \"landmarks\": the points of a surface correspond by their place in the grid"
        }
        (Domain::Vertices, _) => {
            "expected \"landmarks\": the vertices of a control mesh correspond by their place"
        }
        (Domain::Points, _) => {
            "expected \"landmarks\": landmarks are not a contour (to resample, use a closed_curve or \
             open_curve)"
        }
        (Domain::Line { closed: false }, Correspondence::Cyclic) => {
            "expected \"arc_length\" or \"landmarks\": an open curve has no start point to search"
        }
        (Domain::Line { .. }, _) => return Ok(()),
    };
    Err(ServiceError::invalid("/correspondence", detail))
}

impl Reading<'_> {
    /// Control points of one shape, `d·N` coordinate-major numbers.
    ///
    /// # Errors
    /// All faults of the shape, with pointers relative to it.
    pub fn control_points(&self, shape: &ShapeInput) -> Result<Vec<f64>, Vec<Fault>> {
        let closed = shape.closed.as_ref().and_then(Checked::get).copied().flatten();
        if let (Some(closed), Domain::Line { closed: curves_are }) = (closed, self.space.domain())
            && closed != curves_are
        {
            let kind = if closed { "open" } else { "closed" };
            return Err(vec![Fault::new(
                "/closed",
                format!("expected the value of the representation, whose curves are {kind}, got {closed}"),
            )]);
        }
        if given(&shape.normals).is_some() {
            return Err(vec![Fault::new("/normals", NORMALS)]);
        }
        let poles = shape.poles.as_ref().and_then(|poles| poles.get()).copied();
        if poles.is_some() && (given(&shape.points).is_none() || !self.space.has_poles()) {
            let detail = "expected no poles: they belong to the points of a sphere";
            return Err(vec![Fault::new("/poles", detail)]);
        }
        let matrix = match (given(&shape.points), given(&shape.control_points)) {
            (Some(points), None) => match self.space.domain() {
                Domain::Sheet { extent, .. } => self.interpolate_grid(extent, points, poles)?,
                _ => self.interpolate(points).map_err(|errors| below(errors, "/points"))?,
            },
            (None, Some(coefficients)) => {
                self.take_coefficients(coefficients).map_err(|errors| below(errors, "/control_points"))?
            }
            (Some(_), Some(_)) => {
                return Err(vec![Fault::new("", "expected either points or control_points, got both")]);
            }
            (None, None) => {
                return Err(vec![Fault::new("", "expected either points or control_points, got neither")]);
            }
        };
        if !matrix.iter().all(|value| value.is_finite()) {
            return Err(vec![Fault::new("", "the control points of this shape exceed the range of numbers")]);
        }
        Ok(matrix.as_slice().to_vec())
    }

    fn interpolate_grid(
        &self,
        extent: Extent,
        list: &PointList,
        poles: Option<PolesInput>,
    ) -> Result<Matrix, Vec<Fault>> {
        let points = self.matrix(list).map_err(|errors| below(errors, "/points"))?;
        let wanted = extent.grid();
        if list.grid() != Some(wanted) {
            let found = match list.grid() {
                Some([u, v]) => format!("a grid of {u} × {v} points"),
                None => format!("a list of {} points, not a grid [u][v]", list.len()),
            };
            let (name, [u, v]) = (extent.topology.name(), wanted);
            let detail =
                format!("expected a grid of {u} × {v} points for a {name} of this size, got {found}");
            return Err(vec![Fault::new("/points", detail)]);
        }
        let poles = poles.unwrap_or_default();
        let mut errors = Vec::new();
        if self.space.has_poles() {
            errors = open_poles(&points, wanted[1]);
        }
        for (pole, pointer) in [(poles.north, "/poles/north"), (poles.south, "/poles/south")] {
            let wild = |value: &f64| !(value.abs() <= MAX_COORDINATE);
            if pole.is_some_and(|pole| pole.tangents.iter().flatten().any(wild)) {
                let detail = format!("expected numbers within ±{MAX_COORDINATE:e}");
                errors.push(Fault::new(format!("{pointer}/tangents"), detail));
            }
        }
        if !errors.is_empty() {
            return Err(errors);
        }
        let of = |pole: Option<PoleInput>| pole.map(|pole| pole.tangents);
        let tangents = Tangents { north: of(poles.north), south: of(poles.south) };
        let found = self.space.interpolate_with(points, &tangents);
        found.map_err(|error| vec![Fault::new("/points", error.to_string())])
    }

    fn interpolate(&self, list: &PointList) -> Result<Matrix, Vec<Fault>> {
        let points = self.matrix(list)?;
        if self.correspondence == Correspondence::Landmarks {
            self.check_count(list, "points", self.space.representation().point_count())?;
            return self.space.interpolate(points).map_err(|error| vec![Fault::new("", error.to_string())]);
        }
        let representation = self.space.representation();
        // The first point stays first; the point that closes the ring would otherwise come second.
        let points = if self.runs_backwards(&points) { without_closing_point(points) } else { points };
        let contour = contour(self.directed(points), representation.is_closed())?;
        let start =
            if self.correspondence == Correspondence::Cyclic { contour.canonical_start() } else { 0.0 };
        let sampled = contour.sample(representation.point_count(), start);
        self.space.interpolate(sampled).map_err(|error| vec![Fault::new("", error.to_string())])
    }

    fn take_coefficients(&self, list: &PointList) -> Result<Matrix, Vec<Fault>> {
        let coefficients = self.matrix(list)?;
        self.check_count(list, "control points", self.space.representation().size())?;
        if self.correspondence != Correspondence::Cyclic {
            return Ok(coefficients);
        }
        let directed = self.directed(coefficients);
        let shift = canonical_shift(&directed);
        Ok(rotate_start(&directed, shift))
    }

    fn matrix(&self, list: &PointList) -> Result<Matrix, Vec<Fault>> {
        if let Some([u, v]) = list.grid()
            && !self.space.domain().is_sheet()
        {
            let detail = format!(
                "expected a list of points, got a grid of {u} × {v} points: only surfaces have grids"
            );
            return Err(vec![Fault::new("", detail)]);
        }
        let dimension = self.space.representation().dimension();
        let coordinates = list.checked(dimension)?;
        if list.len() > self.limits.points {
            let detail = format!("expected at most {1} points, got {0}", list.len(), self.limits.points);
            return Err(vec![Fault::new("", detail)]);
        }
        Ok(Matrix::from_row_slice(list.len(), dimension, coordinates))
    }

    fn check_count(&self, list: &PointList, what: &str, wanted: usize) -> Result<(), Vec<Fault>> {
        if list.len() == wanted {
            return Ok(());
        }
        let hint = if self.space.domain().is_line() && what == "points" {
            " (to resample a contour, use the correspondence arc_length or cyclic)"
        } else {
            ""
        };
        Err(vec![Fault::new(
            "",
            format!("expected {wanted} {what} for this representation, got {}{hint}", list.len()),
        )])
    }

    /// Orients planar closed contours without a meaningful direction counter-clockwise, keeping their first point.
    fn directed(&self, points: Matrix) -> Matrix {
        let (n, d) = points.shape();
        if !self.runs_backwards(&points) {
            return points;
        }
        Matrix::from_fn(n, d, |k, c| points[((n - k) % n, c)])
    }

    /// Whether a contour without a meaningful direction runs clockwise.
    fn runs_backwards(&self, points: &Matrix) -> bool {
        // Empty lists are refused when the contour is built.
        points.ncols() == 2
            && points.nrows() > 0
            && self.space.representation().is_closed()
            && self.direction == Direction::Either
            && self.correspondence != Correspondence::Landmarks
            && !(polygon_area(points) >= 0.0)
    }
}

/// Maximum relative distance between the points of a pole; they may differ by rounding to decimal digits.
const SAME_POLE: f64 = 1e-9;

/// Faults of the poles of a grid with `columns` points from pole to pole, if their points do not coincide.
fn open_poles(points: &Matrix, columns: usize) -> Vec<Fault> {
    let extent = points.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
    let mut errors = Vec::new();
    for (column, name) in [(0, "north"), (columns - 1, "south")] {
        let apart = |k: usize| (points.row(k * columns + column) - points.row(column)).norm();
        let wrong = (0..points.nrows() / columns).find(|&k| apart(k) > SAME_POLE * extent);
        errors.extend(wrong.map(|k| {
            let detail = format!(
                "expected the {name} pole at /points/0/{column}, got a point that is {:.1e} away: all meridians \
                 of a sphere start and end in the same points",
                apart(k)
            );
            Fault::new(format!("/points/{k}/{column}"), detail)
        }));
    }
    errors
}

/// Refuses a shape whose `size` points coincide (coordinate-major control points).
///
/// # Errors
/// The extent and the size of the coordinates.
pub fn check_extent(control_points: &[f64], size: usize) -> Result<(), Vec<Fault>> {
    let range =
        |c: &[f64]| c.iter().copied().fold(f64::MIN, f64::max) - c.iter().copied().fold(f64::MAX, f64::min);
    let extent = control_points.chunks_exact(size).map(range).fold(0.0, f64::max);
    let largest = control_points.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    if extent > NO_EXTENT * largest {
        return Ok(());
    }
    let detail =
        format!("all {size} points coincide: extent {extent:.1e} at coordinates up to {largest:.1e}");
    Err(vec![Fault::new("", detail)])
}

fn below(errors: Vec<Fault>, pointer: &str) -> Vec<Fault> {
    errors.into_iter().map(|error| error.below(pointer)).collect()
}

/// Control points and attributes of a posted shape.
///
/// # Errors
/// All faults of the shape, with pointers relative to it.
pub fn read_shape(
    reading: &Reading<'_>,
    shape: ShapeInput,
) -> Result<(Vec<f64>, ShapeAttributes), Vec<Fault>> {
    // A value that is not an object has one fault, rather than a list of missing fields.
    if shape.faults.iter().any(|fault| fault.pointer.is_empty()) {
        return Err(shape.faults);
    }
    match (reading.control_points(&shape), attributes(shape)) {
        (Ok(control_points), Ok(attributes)) => Ok((control_points, attributes)),
        (control_points, attributes) => {
            Err(control_points.err().into_iter().chain(attributes.err()).flatten().collect())
        }
    }
}

/// Attributes of a posted shape.
///
/// # Errors
/// All faults of the attributes and of the object itself, with pointers relative to the shape.
pub fn attributes(shape: ShapeInput) -> Result<ShapeAttributes, Vec<Fault>> {
    let mut errors = shape.faults;
    let mut text = |field: Option<Checked<Option<String>>>, pointer: &str| {
        let text = take_given(field, pointer, &mut errors).flatten()?;
        if text.is_empty() || text.chars().count() > MAX_TEXT || text.chars().any(char::is_control) {
            errors.push(Fault::new(pointer, format!("expected 1 to {MAX_TEXT} printable characters")));
        }
        Some(text)
    };
    let external_id = text(shape.external_id, "/external_id");
    let subject = text(shape.subject, "/subject");
    let label = text(shape.label, "/label");
    let labels = shape.labels.filter(|labels| !labels.is_null());
    let labels: Option<BTreeMap<String, serde_json::Value>> =
        labels.and_then(|labels| labels.read(SMALL, "/labels", &mut errors));
    let labels = labels.unwrap_or_default();
    if labels.len() > MAX_LABELS {
        errors.push(Fault::new(
            "/labels",
            format!("expected at most {MAX_LABELS} entries, got {}", labels.len()),
        ));
    }
    for (key, value) in labels.iter().take(MAX_LABELS) {
        let is_control = |text: &str| text.chars().any(char::is_control);
        if is_control(key) || value.as_str().is_some_and(is_control) {
            errors.push(Fault::new("/labels", "expected text without control characters"));
        }
        if value.is_object() || value.is_array() {
            let pointer = format!("/labels/{}", key.replace('~', "~0").replace('/', "~1"));
            errors.push(Fault::new(pointer, "expected a string, a number, a boolean or null"));
        }
    }
    let weight = take_given(shape.weight, "/weight", &mut errors).flatten().unwrap_or(1.0);
    if !(1e-100..=1e100).contains(&weight) {
        errors
            .push(Fault::new("/weight", format!("expected a number between 1e-100 and 1e100, got {weight}")));
    }
    take_given(shape.closed, "/closed", &mut errors);
    take_given(shape.poles.map(|poles| *poles), "/poles", &mut errors);
    let mut value = |field: Option<Metadata>, pointer: &str| {
        field.and_then(|field| field.take(pointer, &mut errors)).filter(|value| !value.is_null())
    };
    let given = value(shape.metadata, "/metadata");
    let (index, landmarks) =
        (value(shape.landmark_index, "/landmark_index"), value(shape.landmarks, "/landmarks"));
    if !errors.is_empty() {
        return Err(errors);
    }
    let metadata = metadata(given, index, landmarks).map(|value| value.to_string());
    Ok(ShapeAttributes { external_id, subject, label, labels, weight, metadata })
}

/// Parses a `T` whose fields are not checked individually from JSON text. JSON that is not a `T` is invalid input; text
/// that is not JSON is malformed.
///
/// # Errors
/// [`ServiceError::Invalid`], [`ServiceError::Malformed`].
pub fn parse_whole<T: DeserializeOwned>(limits: &Limits, text: &[u8]) -> Result<T, ServiceError> {
    let value: Checked<T, LARGE> = parse(limits, text)?;
    let mut errors = Vec::new();
    let value = value.take("", &mut errors);
    ServiceError::unless_empty(errors)?;
    value.ok_or_else(|| ServiceError::invalid("", "the value is incomplete"))
}

/// Parses `T` from JSON text; run it on the pool, because bodies can be large. The types of `formats` collect their own
/// faults and keep no more data than the limits allow.
///
/// # Errors
/// [`ServiceError::Malformed`] for text that is not JSON, with a pointer to the place.
pub fn parse<T: DeserializeOwned>(limits: &Limits, text: &[u8]) -> Result<T, ServiceError> {
    bounds::within(limits.bounds(), || parse_within(text))
}

fn parse_within<T: DeserializeOwned>(text: &[u8]) -> Result<T, ServiceError> {
    // Tracking the path costs time: only failed text is parsed again with it.
    serde_json::from_slice(text).or_else(|_| {
        let mut deserializer = serde_json::Deserializer::from_slice(text);
        let value: T = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
            let pointer = json_pointer(error.path());
            let index =
                pointer.strip_prefix("/shapes/").and_then(|rest| rest.split('/').next()?.parse().ok());
            let detail = format!("not valid JSON: {}", error.inner());
            ServiceError::Malformed(vec![Fault { index, ..Fault::new(pointer, detail) }])
        })?;
        deserializer.end().map_err(|error| {
            ServiceError::Malformed(vec![Fault::new("", format!("not valid JSON: {error}"))])
        })?;
        Ok(value)
    })
}

impl App {
    /// Parses `T` from a body: [`parse`].
    ///
    /// # Errors
    /// [`ServiceError::Malformed`].
    pub fn parse<T: DeserializeOwned>(&self, text: &[u8]) -> Result<T, ServiceError> {
        parse(&self.limits, text)
    }

    /// Parses `T` from a body: [`parse_whole`].
    ///
    /// # Errors
    /// [`ServiceError::Invalid`], [`ServiceError::Malformed`].
    pub fn parse_whole<T: DeserializeOwned>(&self, text: &[u8]) -> Result<T, ServiceError> {
        parse_whole(&self.limits, text)
    }

    /// Parses `T` from a body in the lane for its length: [`Pool::read`](crate::service::app::pool::Pool::read).
    ///
    /// # Errors
    /// [`ServiceError::Malformed`], and those of the pool.
    pub async fn read<T: DeserializeOwned + Send + 'static>(&self, body: Bytes) -> Result<T, ServiceError> {
        let limits = self.limits;
        self.pool.read(body, move |text| parse(&limits, text)).await
    }
}

/// Faults of a shape that do not depend on its representation, with pointers relative to it.
pub fn own_faults(shape: ShapeInput) -> Vec<Fault> {
    let lists = [
        ("/points", shape.points.as_ref()),
        ("/control_points", shape.control_points.as_deref()),
        ("/normals", shape.normals.as_deref()),
    ];
    let mut errors: Vec<Fault> = lists
        .into_iter()
        .filter_map(|(name, list)| Some((name, list?)))
        .filter_map(|(name, list)| Some(below(list.checked(list.width()).err()?, name)))
        .flatten()
        .collect();
    errors.extend(attributes(shape).err().into_iter().flatten());
    errors
}

/// Faults of shapes that do not depend on their representation, at `/shapes/{index}…`.
pub fn shape_faults(shapes: Vec<ShapeInput>) -> Vec<Fault> {
    let mut faults = Vec::new();
    for (index, shape) in shapes.into_iter().enumerate() {
        if faults.len() >= MAX_FAULTS {
            break;
        }
        let errors = own_faults(shape);
        let prefix = format!("/shapes/{index}");
        faults.extend(errors.into_iter().map(|error| error.below(&prefix).at_shape(index)));
    }
    faults
}

/// Merges landmarks posted with a contour into the client's metadata.
fn metadata(
    metadata: Option<serde_json::Value>,
    landmark_index: Option<serde_json::Value>,
    landmarks: Option<serde_json::Value>,
) -> Option<serde_json::Value> {
    let extra = [("landmark_index", landmark_index), ("landmarks", landmarks)];
    let extra: Vec<_> = extra.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect();
    match metadata {
        other if extra.is_empty() => other,
        Some(serde_json::Value::Object(mut map)) => {
            map.extend(extra);
            Some(map.into())
        }
        Some(other) => Some([("metadata".to_owned(), other)].into_iter().chain(extra).collect()),
        None => Some(extra.into_iter().collect()),
    }
}

/// Shapes of a request that is answered from memory.
#[derive(Debug, Clone)]
pub struct Batch {
    /// Control points of one shape after the other, `d·N` coordinate-major numbers each.
    pub control_points: Vec<f64>,
    /// One weight per shape.
    pub weights: Vec<f64>,
}

/// Control points and weight of one shape, or all of its faults.
type ReadShape = Result<(Vec<f64>, f64), Vec<Fault>>;

/// Reads all shapes in parallel.
///
/// # Errors
/// The faults of all invalid shapes, at `/shapes/{index}…`.
pub fn read_batch(reading: &Reading<'_>, shapes: Vec<ShapeInput>) -> Result<Batch, ServiceError> {
    check_numbers(reading, shapes.len())?;
    let read = |shape: ShapeInput| {
        read_shape(reading, shape).map(|(control_points, attributes)| (control_points, attributes.weight))
    };
    let results: Vec<ReadShape> = shapes.into_par_iter().map(read).collect();
    let mut batch = Batch { control_points: Vec::new(), weights: Vec::with_capacity(results.len()) };
    let mut faults = Faults::default();
    for (index, result) in results.into_iter().enumerate() {
        match result {
            Ok((control_points, weight)) => {
                batch.control_points.extend(control_points);
                batch.weights.push(weight);
            }
            Err(errors) => {
                let prefix = format!("/shapes/{index}");
                let with_index = |error: Fault| error.below(&prefix).at_shape(index);
                faults.extend(errors.into_iter().map(with_index));
            }
        }
    }
    faults.unless_any().map(|()| batch)
}

/// Checks the number of shapes and of their coordinates: resampling can turn short contours into many control points.
fn check_numbers(reading: &Reading<'_>, shapes: usize) -> Result<(), ServiceError> {
    let (most, most_numbers) = (reading.limits.shapes, reading.limits.coordinates);
    if shapes > most {
        let detail = format!("expected at most {most} shapes, got {shapes}");
        return Err(ServiceError::invalid("/shapes", detail));
    }
    let representation = reading.space.representation();
    let numbers = representation.size() * representation.dimension() * shapes;
    if numbers > most_numbers {
        let detail = format!(
            "expected at most {most_numbers} numbers in the control points of all shapes, got {numbers} \
             ({shapes} shapes): send fewer shapes, or use a cohort"
        );
        return Err(ServiceError::invalid("/shapes", detail));
    }
    Ok(())
}
