//! Converts posted shapes to control points of a representation.
//!
//! Points lie on the shape, control points are its coefficients. The arithmetic is [`Conversion`].

use std::collections::BTreeMap;

use bytes::Bytes;
use serde::de::DeserializeOwned;

use super::outcome::{OnError, Outcomes};
use super::read_points::given;
use crate::analysis::conversion::{Beginning, Conversion, Converted};
use crate::analysis::correspondence::{Correspondence, Mirror};
use crate::domain::attribute::{LARGEST_WHOLE, is_beyond};
use crate::domain::key::is_deceptive;
use crate::domain::shape::ShapeAttributes;
use crate::geometry::capability::domain::{Admitted, Domain, SizeBounds};
use crate::geometry::field_fault::FieldFault;
use crate::geometry::representation::Representation;
use crate::geometry::surface::basis::Tangents;
use crate::numeric::dense::Matrix;
use crate::service::app::faults::{Faults, MAX_FAULTS};
use crate::service::app::parallel;
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::checked::{Checked, LARGE, Metadata, Raw, SMALL, take_given};
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::shape::{MAX_COORDINATE, PointList, PoleInput, PolesInput, ShapeInput};

/// Reader of posted shapes.
#[derive(Debug, Clone, Copy)]
pub struct Reading<'a> {
    /// Conversion of points to control points.
    pub conversion: Conversion<'a>,
    /// Limits on sizes.
    pub limits: &'a Limits,
}

/// Maximum length of an identifier or label.
const MAX_TEXT: usize = 500;
/// Why normals are refused.
const NORMALS: &str = "expected no normals: they belong to the subdivision scheme normal_based";
/// Why parts of shapes are refused.
const PART: &str =
    "expected a whole shape, got one of which a part is seen: assess and complete of a dictionary take these";
/// Refusal of blocks, with the requests that take them.
const BLOCKS: &str =
    "expected a shape of one resolution, got blocks: refine brings it to the finest of them, the same shape";
/// Most attributes of a shape: programs of microscopy measure some hundred numbers of a cell.
const MAX_LABELS: usize = 1000;

/// A representation within the limits.
///
/// # Errors
/// All fields that are out of bounds, or the first invalid face or vertex of a control mesh.
pub fn admit(representation: Representation, limits: &Limits) -> Result<Admitted, Vec<Fault>> {
    let bounds = SizeBounds { control_points: limits.control_points, vertices: limits.vertices };
    let admitted = Admitted::new(representation, bounds);
    admitted.map_err(|faults| faults.into_iter().map(Fault::from).collect())
}

/// A representation within the limits whose shapes form a linear space.
///
/// # Errors
/// As [`admit`]; a scheme that is not linear.
pub fn admit_linear(representation: Representation, limits: &Limits) -> Result<Admitted, Vec<Fault>> {
    let admitted = admit(representation, limits)?;
    admitted.linearity_fault().map_or(Ok(admitted), |fault| Err(vec![fault.into()]))
}

/// Checks that mirror images exist if they are requested.
///
/// # Errors
/// A fault at `/mirror`.
pub fn check_mirror(representation: &Representation, mirror: Mirror) -> Result<(), ServiceError> {
    let fault = mirror.fault(representation.domain());
    fault.map_or(Ok(()), |detail| Err(ServiceError::invalid("/mirror", detail)))
}

/// Checks that the correspondence applies to the representation.
///
/// # Errors
/// A fault at `/correspondence`.
pub fn check_correspondence(
    representation: &Representation,
    correspondence: Correspondence,
) -> Result<(), ServiceError> {
    let fault = correspondence.fault(representation.domain());
    fault.map_or(Ok(()), |detail| Err(ServiceError::invalid("/correspondence", detail)))
}

impl Reading<'_> {
    /// Why the representation has no such shape, besides its points.
    pub(crate) fn unsuitable(&self, shape: &ShapeInput) -> Option<Fault> {
        let space = self.conversion.space;
        let closed = shape.closed.as_ref().and_then(Checked::get).copied().flatten();
        if let (Some(closed), Domain::Line { closed: curves_are }) = (closed, space.domain())
            && closed != curves_are
        {
            let kind = if closed { "open" } else { "closed" };
            let detail =
                format!("expected the value of the representation, whose curves are {kind}, got {closed}");
            return Some(Fault::new("/closed", detail));
        }
        if given(&shape.normals).is_some() {
            return Some(Fault::new("/normals", NORMALS));
        }
        let poles = shape.poles.as_ref().and_then(|poles| poles.get());
        if poles.is_some() && (given(&shape.points).is_none() || !space.has_poles()) {
            let detail = "expected no poles: they belong to the points of a sphere";
            return Some(Fault::new("/poles", detail));
        }
        if poles.is_some() && !space.has_smooth_poles() {
            let detail =
                "expected no tangents: sharp poles have one for each meridian, among the control points";
            return Some(Fault::new("/poles", detail));
        }
        None
    }

    /// Control points of one shape.
    ///
    /// # Errors
    /// All faults of the shape, with pointers relative to it.
    fn convert(&self, shape: &ShapeInput) -> Result<Converted, Vec<Fault>> {
        if let Some(fault) = self.unsuitable(shape) {
            return Err(vec![fault]);
        }
        let poles = shape.poles.as_ref().and_then(|poles| poles.get()).copied();
        match (given(&shape.points), given(&shape.control_points)) {
            (Some(points), None) => finite(self.interpolate(points, poles.unwrap_or_default())?),
            (None, Some(list)) => self.take(list).map_err(|errors| below(errors, "/control_points")),
            (Some(_), Some(_)) => {
                Err(vec![Fault::new("", "expected either points or control_points, got both")])
            }
            (None, None) => {
                Err(vec![Fault::new("", "expected either points or control_points, got neither")])
            }
        }
    }

    /// Control points of the shape through a list or a grid of points.
    fn interpolate(&self, list: &PointList, poles: PolesInput) -> Result<Converted, Vec<Fault>> {
        let at_points = |fault: FieldFault| Fault::from(fault).below("/points");
        let points = self.matrix(list).map_err(|errors| below(errors, "/points"))?;
        let conversion = &self.conversion;
        if !conversion.space.domain().is_sheet() {
            return conversion.interpolate(points).map_err(|fault| vec![at_points(fault)]);
        }
        if let Some(detail) = conversion.space.grid_fault(list.grid(), list.len()) {
            return Err(vec![Fault::new("/points", detail)]);
        }
        let mut errors: Vec<Fault> =
            conversion.space.open_poles(&points).into_iter().map(at_points).collect();
        errors.extend(wild_tangents(&poles));
        if !errors.is_empty() {
            return Err(errors);
        }
        let of = |pole: Option<PoleInput>| pole.map(|pole| pole.tangents);
        let tangents = Tangents { north: of(poles.north), south: of(poles.south) };
        let control_points = conversion.interpolate_grid(points, &tangents);
        control_points.map(unrepeated).map_err(|fault| vec![at_points(fault)])
    }

    fn take(&self, list: &PointList) -> Result<Converted, Vec<Fault>> {
        let control_points = self.matrix(list)?;
        self.conversion.take(control_points).map_err(|fault| vec![fault.into()])
    }

    fn matrix(&self, list: &PointList) -> Result<Matrix, Vec<Fault>> {
        let space = self.conversion.space;
        if let Some([u, v]) = list.grid()
            && !space.domain().is_sheet()
        {
            let detail = format!(
                "expected a list of points, got a grid of {u} × {v} points: only surfaces have grids"
            );
            return Err(vec![Fault::new("", detail)]);
        }
        let dimension = space.representation().dimension();
        let coordinates = list.checked(dimension)?;
        if list.len() > self.limits.points {
            let detail = format!("expected at most {1} points, got {0}", list.len(), self.limits.points);
            return Err(vec![Fault::new("", detail)]);
        }
        Ok(Matrix::from_row_slice(list.len(), dimension, coordinates))
    }
}

fn unrepeated(control_points: Matrix) -> Converted {
    Converted { control_points, repeated_points: 0, beginning: Beginning::default() }
}

/// Tangents of poles with numbers out of range.
fn wild_tangents(poles: &PolesInput) -> impl Iterator<Item = Fault> {
    let wild =
        |pole: &PoleInput| pole.tangents.iter().flatten().any(|value| !(value.abs() <= MAX_COORDINATE));
    let found = [(poles.north, "/poles/north"), (poles.south, "/poles/south")];
    found.into_iter().filter(move |(pole, _)| pole.as_ref().is_some_and(wild)).map(|(_, pointer)| {
        let detail = format!("expected numbers within ±{MAX_COORDINATE:e}");
        Fault::new(format!("{pointer}/tangents"), detail)
    })
}

/// The control points, unless interpolation has made them too large for numbers.
fn finite(converted: Converted) -> Result<Converted, Vec<Fault>> {
    let finite = converted.control_points.iter().all(|value| value.is_finite());
    let fault = || vec![Fault::new("", "the control points of this shape exceed the range of numbers")];
    finite.then_some(converted).ok_or_else(fault)
}

fn below(errors: Vec<Fault>, pointer: &str) -> Vec<Fault> {
    errors.into_iter().map(|error| error.below(pointer)).collect()
}

/// A posted shape in a representation.
#[derive(Debug, Clone)]
pub struct ReadShape {
    /// Control points, `d·N` coordinate-major numbers.
    pub control_points: Vec<f64>,
    /// Attributes.
    pub attributes: ShapeAttributes,
    /// Number of points as received.
    pub points: usize,
    /// Number of repeated points that were dropped.
    pub repeated_points: usize,
    /// How a contour ran as it was given.
    pub beginning: Beginning,
}

/// Control points and attributes of a posted shape.
///
/// # Errors
/// All faults of the shape, with pointers relative to it.
pub fn read_shape(reading: &Reading<'_>, shape: ShapeInput) -> Result<ReadShape, Vec<Fault>> {
    // A value that is not an object has one fault, rather than a list of missing fields.
    if shape.faults.iter().any(|fault| fault.pointer.is_empty()) {
        return Err(shape.faults);
    }
    let points = given(&shape.points).or(given(&shape.control_points)).map_or(0, PointList::len);
    match (reading.convert(&shape), attributes(shape)) {
        (Ok(Converted { control_points, repeated_points, beginning }), Ok(attributes)) => {
            let control_points = control_points.as_slice().to_vec();
            Ok(ReadShape { control_points, attributes, points, repeated_points, beginning })
        }
        (converted, attributes) => {
            Err(converted.err().into_iter().chain(attributes.err()).flatten().collect())
        }
    }
}

/// Whether a text may be an identifier or a label: at least one character of it is seen.
pub(crate) fn is_text(text: &str) -> bool {
    let is_seen = |c: char| !c.is_whitespace() && !is_deceptive(c);
    text.chars().any(is_seen) && text.chars().count() <= MAX_TEXT && !text.chars().any(char::is_control)
}

/// Whether a text may be the name of an attribute: two names that look alike are the same.
fn is_name(text: &str) -> bool {
    is_text(text) && !text.chars().any(is_deceptive)
}

/// The fault of a whole number that doubles do not tell from its neighbours.
fn too_large(number: &dyn std::fmt::Display) -> String {
    format!(
        "expected a whole number of at most {LARGEST_WHOLE} in size, which doubles hold exactly, or the digits as a text, got {number}"
    )
}

/// A number as it is stored: one without a fraction as a whole number, so that 61.0 is 61.
///
/// # Errors
/// A whole number that doubles do not tell from its neighbours.
fn stored(number: &serde_json::Number) -> Result<serde_json::Number, String> {
    if is_beyond(number) {
        return Err(too_large(number));
    }
    let whole = number.as_f64().filter(|value| value.fract() == 0.0 && value.abs() <= LARGEST_WHOLE as f64);
    // The cast is exact in this range.
    Ok(whole.map_or_else(|| number.clone(), |value| (value as i64).into()))
}

/// Further attributes of a posted shape; faults go to `errors`.
fn labels(given: Option<Raw>, errors: &mut Vec<Fault>) -> BTreeMap<String, serde_json::Value> {
    let given = given.filter(|labels| !labels.is_null());
    if let Some(long) = given.as_ref().and_then(Raw::too_long) {
        errors.push(Fault::new("/labels", too_large(&long)));
    }
    let labels: Option<BTreeMap<String, serde_json::Value>> =
        given.and_then(|labels| labels.read(SMALL, "/labels", errors));
    let mut labels = labels.unwrap_or_default();
    if labels.len() > MAX_LABELS {
        errors.push(Fault::new(
            "/labels",
            format!(
                "expected at most {MAX_LABELS} entries, got {}: the option attributes takes some of those of a file",
                labels.len()
            ),
        ));
    }
    for (key, value) in labels.iter_mut().take(MAX_LABELS) {
        let is_control = |text: &str| text.chars().any(char::is_control);
        let pointer = || format!("/labels/{}", key.replace('~', "~0").replace('/', "~1"));
        if !is_name(key) {
            let count = key.chars().count();
            errors.push(Fault::new(
                "/labels",
                format!(
                    "expected names of 1 to {MAX_TEXT} characters, none of them invisible, got one of {count}"
                ),
            ));
        }
        if value.as_str().is_some_and(is_control) {
            errors.push(Fault::new("/labels", "expected text without control characters"));
        }
        if value.is_object() || value.is_array() {
            errors.push(Fault::new(pointer(), "expected a string, a number, a boolean or null"));
        }
        if let serde_json::Value::Number(number) = value {
            match stored(number) {
                Ok(number) => *value = number.into(),
                Err(detail) => errors.push(Fault::new(pointer(), detail)),
            }
        }
    }
    labels
}

/// Attributes of a posted shape.
///
/// # Errors
/// All faults of the attributes and of the object itself, with pointers relative to the shape.
pub fn attributes(shape: ShapeInput) -> Result<ShapeAttributes, Vec<Fault>> {
    let mut errors = shape.faults;
    let mut text = |field: Option<Checked<Option<String>>>, pointer: &str| {
        let text = take_given(field, pointer, &mut errors).flatten()?;
        if !is_text(&text) {
            errors.push(Fault::new(
                pointer,
                format!("expected 1 to {MAX_TEXT} printable characters, not only blanks"),
            ));
        }
        Some(text)
    };
    let external_id = text(shape.external_id, "/external_id");
    let subject = text(shape.subject, "/subject");
    let label = text(shape.label, "/label");
    let labels = labels(shape.labels, &mut errors);
    let weight = take_given(shape.weight, "/weight", &mut errors).flatten().unwrap_or(1.0);
    if !(1e-100..=1e100).contains(&weight) {
        errors
            .push(Fault::new("/weight", format!("expected a number between 1e-100 and 1e100, got {weight}")));
    }
    take_given(shape.closed, "/closed", &mut errors);
    if take_given(shape.observed.map(|observed| *observed), "/observed", &mut errors).flatten().is_some() {
        errors.push(Fault::new("/observed", PART));
    }
    if take_given(shape.blocks.map(|blocks| *blocks), "/blocks", &mut errors).flatten().is_some() {
        errors.push(Fault::new("/blocks", BLOCKS));
    }
    take_given(shape.poles.map(|poles| *poles), "/poles", &mut errors);
    let mut value = |field: Option<Box<Metadata>>, pointer: &str| {
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
    json::parse(limits.bounds(), text).map_err(|fault| ServiceError::Malformed(vec![fault]))
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
pub fn own_faults(mut shape: ShapeInput) -> Vec<Fault> {
    // Those of blocks depend on the grids.
    shape.blocks = None;
    let lists = [
        ("/points", shape.points.as_deref()),
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

/// Control points of a shape and its weight. Other attributes are not kept.
pub(crate) type Weighted = (Vec<f64>, f64);

/// Reads all shapes in parallel.
///
/// # Errors
/// Too many numbers in all shapes together.
pub(crate) fn read_each(
    reading: &Reading<'_>,
    shapes: Vec<ShapeInput>,
) -> Result<Outcomes<Weighted>, ServiceError> {
    read_each_by(reading, shapes, |shape| {
        read_shape(reading, shape).map(|shape| (shape.control_points, shape.attributes.weight))
    })
}

/// Reads all shapes in parallel with `read`, whose faults have pointers relative to the shape.
///
/// # Errors
/// As [`read_each`].
pub(crate) fn read_each_by<T: Send>(
    reading: &Reading<'_>,
    shapes: Vec<ShapeInput>,
    read: impl Fn(ShapeInput) -> Result<T, Vec<Fault>> + Send + Sync,
) -> Result<Outcomes<T>, ServiceError> {
    check_numbers(reading, shapes.len())?;
    Ok(Outcomes::of_list("shapes", parallel::map(shapes, |_, shape| read(shape))))
}

/// Reads the control points of a reference, at `/reference`, and all shapes in parallel.
///
/// # Errors
/// All faults of both; no shapes. Under [`OnError::Skip`] the faults of shapes are among the outcomes.
pub(crate) fn read_with_reference(
    reading: &Reading<'_>,
    reference: ShapeInput,
    (shapes, on_error): (Vec<ShapeInput>, OnError),
) -> Result<(Vec<f64>, Outcomes<Weighted>), ServiceError> {
    let shapes = read_each(reading, shapes).and_then(|shapes| shapes.checked(on_error));
    let reference = read_shape(reading, reference)
        .map(|shape| shape.control_points)
        .map_err(|errors| ServiceError::below(errors, "/reference"));
    let mut faults = Faults::default();
    let (Some(reference), Some(shapes)) = (faults.keep(reference)?, faults.keep(shapes)?) else {
        return Err(ServiceError::Invalid(faults));
    };
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    Ok((reference, shapes))
}

/// Reads all shapes in parallel.
///
/// # Errors
/// The faults of all invalid shapes, at `/shapes/{index}…`.
pub fn read_batch(reading: &Reading<'_>, shapes: Vec<ShapeInput>) -> Result<Batch, ServiceError> {
    let read = read_each(reading, shapes)?.all()?;
    let mut batch = Batch { control_points: Vec::new(), weights: Vec::with_capacity(read.len()) };
    for (control_points, weight) in read {
        batch.control_points.extend(control_points);
        batch.weights.push(weight);
    }
    Ok(batch)
}

/// Checks the number of coordinates: resampling can turn short contours into many control points. Lists of shapes are within
/// their limit since they were read.
fn check_numbers(reading: &Reading<'_>, shapes: usize) -> Result<(), ServiceError> {
    let most = reading.limits.coordinates;
    let representation = reading.conversion.space.representation();
    let numbers = representation.size() * representation.dimension() * shapes;
    if numbers > most {
        let detail = format!(
            "expected at most {most} numbers in the control points of all shapes, got {numbers} ({shapes} shapes): \
             send fewer shapes, or use a cohort"
        );
        return Err(ServiceError::invalid("/shapes", detail));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_have_something_to_see() {
        for blank in ["", " ", "\u{a0}\u{3000}", "\u{200b}", "a\tb"] {
            assert!(!is_text(blank), "{blank:?}");
        }
        assert!(is_text(" a ") && is_text("\u{e9}\u{200d}") && is_text(&"x".repeat(MAX_TEXT)));
        assert!(!is_text(&"x".repeat(MAX_TEXT + 1)));
    }
}
