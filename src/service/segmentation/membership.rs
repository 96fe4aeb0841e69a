//! Segmented objects that become members of a cohort, as shapes that are posted do.
//!
//! A member says in its metadata where it comes from: the digests of the image and of the other parts of the request, never their
//! contents.

use std::collections::BTreeMap;

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::answer::{SegmentAnswer, SegmentedOutput};
use super::image::{Coordinates, ImageOutput, file_limits};
use super::parts::{Parts, Prepared};
use super::starts::Starts;
use crate::domain::cohort::Cohort;
use crate::domain::job::Job;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::catalogue::{Expected, revision_tag};
use crate::service::cohorts::lengths::Lengths;
use crate::service::cohorts::upload::{self, Occasion, Stored, Treatment};
use crate::service::shapes::outcome::OnError;
use crate::service::shapes::read::attributes;
use crate::store::StoreError;
use crate::wire::checked::{Checked, Metadata, Raw};
use crate::wire::dicom::Instance;
use crate::wire::fault::Fault;
use crate::wire::image::detect;
use crate::wire::json;
use crate::wire::lengths::FileUnits;
use crate::wire::shape::{PointList, ShapeInput};
use crate::wire::unit::Unit;

/// Predicted seconds per byte of a digest.
const DIGEST: f64 = 1e-9;
/// Field of the metadata of a member that says where it comes from.
const ORIGIN: &str = "segmentation";
/// Field of the note of a receipt that names a job.
const JOB: &str = "job";

/// BLAKE3 digests of the parts of a request, in hexadecimal digits.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Digests(Vec<(String, String)>);

impl Digests {
    /// Those of the parts of a request, computed on the pool.
    ///
    /// # Errors
    /// Those of the pool.
    pub async fn of(app: &App, parts: Parts) -> Result<Self, ServiceError> {
        let bytes: usize = parts.named().iter().map(|(_, part)| part.len()).sum();
        let digest =
            |(name, part): (&str, &Bytes)| (name.to_owned(), blake3::hash(part).to_hex().to_string());
        let work = Work::from_seconds(bytes as f64 * DIGEST);
        app.pool.weighing(work).run(move || Ok(Self(parts.named().into_iter().map(digest).collect()))).await
    }

    /// A text that is another one if any part is.
    pub fn text(&self) -> String {
        self.0.iter().map(|(name, digest)| format!("{name} {digest}\n")).collect()
    }

    /// Where the object at `index` comes from.
    fn origin(&self, index: usize, stop: &str) -> Value {
        let parts = self.0.iter().map(|(name, digest)| (name.clone(), json!(digest)));
        let further = [("index".to_owned(), json!(index)), ("stop".to_owned(), json!(stop))];
        Value::Object(parts.chain(further).collect())
    }
}

/// How segmented objects become members.
#[derive(Debug, Clone)]
pub struct Membership {
    /// The cohort.
    pub cohort: Cohort,
    /// Versions of the cohort that the client expects.
    pub expected: Option<Expected>,
    /// Attributes of the objects, one for each; none without.
    pub objects: Option<Vec<ShapeInput>>,
    /// Whether objects are stored that are folded, have left the image or collapsed.
    pub store_failed: bool,
    /// Digests of the parts of the request.
    pub digests: Digests,
    /// The job that adds the objects, as it was claimed.
    pub job: Option<Job>,
    /// Unit of the coordinates, whatever the image says.
    pub unit: Option<Unit>,
    /// Units of the shapes.
    pub lengths: Lengths,
    /// Attributes that the image gives to its objects.
    pub origin: Origin,
}

/// Attributes by which the scan of an image of DICOM is found again; none of other images.
#[derive(Debug, Clone, Default)]
pub struct Origin(BTreeMap<String, Value>);

impl Origin {
    /// Those of the image of a request. A fault is told where the image is read.
    pub fn of(image: &[u8], limits: &Limits) -> Self {
        let is_dicom = detect(image).is_ok_and(|format| format.media_types.contains(&"application/dicom"));
        let read = is_dicom.then(|| Instance::read(image, file_limits(limits).bytes).ok()).flatten();
        let common = read.iter().flat_map(|instance| instance.origin.common());
        Self(common.map(|(name, value)| (name.clone(), json!(value))).collect())
    }

    /// Those of the image of a request, which is read on the pool.
    ///
    /// # Errors
    /// Those of the pool.
    pub async fn of_parts(app: &App, parts: &Parts) -> Result<Self, ServiceError> {
        let (image, limits) = (parts.image.clone(), app.limits);
        let work = Work::from_seconds(image.len() as f64 * DIGEST);
        app.pool.weighing(work).run(move || Ok(Self::of(&image, &limits))).await
    }

    /// Attributes with those that a client gives, which come first.
    fn beside(&self, given: Option<Raw>) -> Option<Raw> {
        if self.0.is_empty() {
            return given;
        }
        let mut all = self.0.clone();
        let read = given.as_ref().filter(|given| !given.is_null());
        let read: Option<BTreeMap<String, Value>> =
            read.and_then(|given| given.read_large("", &mut Vec::new()));
        all.extend(read.unwrap_or_default());
        Raw::of(&all)
    }
}

/// A segmented object, and its place in the cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
struct MemberOutput {
    #[serde(flatten)]
    object: SegmentedOutput,
    /// Identifier assigned by the client, if the object has one.
    external_id: Option<String>,
    /// Id of the shape in the cohort, also of one that existed before with the same content; null if it is not stored.
    id: Option<String>,
    /// Why it is not stored: the value of `stop`, or the fault of the shape.
    not_stored: Option<String>,
}

/// Segmented objects that were added to a cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct MembersAnswer {
    /// The image.
    image: ImageOutput,
    /// Coordinates of the shapes.
    coordinates: Coordinates,
    /// One entry for each initial shape, in order.
    results: Vec<MemberOutput>,
    /// Number of new shapes of the cohort; repeated ones with the same content are not counted.
    added: usize,
    /// Revision of the cohort after the request.
    revision: u64,
    /// Units of the image and of the cohort, in which shapes are stored; absent where the image gives no unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    units: Option<FileUnits>,
    /// Warnings about the shapes as a whole. Absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
}

/// Objects on their way to a cohort.
#[derive(Debug)]
pub struct Arriving {
    /// Those that are to be stored.
    shapes: Vec<ShapeInput>,
    /// Their positions in the request.
    places: Vec<usize>,
    /// The answer as long as nothing is stored.
    answer: Value,
}

impl Membership {
    /// Checks the version of the cohort and the attributes against initial shapes, and returns attributes for each object.
    ///
    /// # Errors
    /// [`ServiceError::Changed`]; faults at `/objects`.
    fn attributes(&self, starts: &Starts) -> Result<Vec<ShapeInput>, ServiceError> {
        if let Some(expected) = &self.expected {
            expected.check(&revision_tag(&self.cohort))?;
        }
        match (starts, &self.objects) {
            (Starts::Shapes(_), Some(_)) => {
                let detail = "expected none beside shapes, which have attributes of their own";
                Err(ServiceError::invalid("/objects", detail))
            }
            (Starts::Shapes(shapes), None) => Ok(shapes.iter().map(ShapeInput::without_geometry).collect()),
            (_, None) => Ok(vec![ShapeInput::default(); starts.count()]),
            (_, Some(objects)) if objects.len() != starts.count() => {
                let (count, found) = (starts.count(), objects.len());
                let detail = format!("expected attributes for each of {count} objects, got {found}");
                Err(ServiceError::invalid("/objects", detail))
            }
            (_, Some(objects)) => {
                let faults_of = |(index, object): (usize, &ShapeInput)| {
                    let found = attributes(object.clone()).err().unwrap_or_default();
                    let place = format!("/objects/{index}");
                    found.into_iter().map(move |fault| fault.below(&place).at_shape(index))
                };
                ServiceError::unless_empty(objects.iter().enumerate().flat_map(faults_of).collect())?;
                Ok(objects.clone())
            }
        }
    }

    /// Attributes of the objects, whose unit becomes that of the prepared segmentation.
    ///
    /// # Errors
    /// Faults of the attributes; a number of them that is not that of the initial shapes.
    pub fn look(&self, prepared: &mut Prepared) -> Result<Vec<ShapeInput>, ServiceError> {
        prepared.wanted.unit = self.unit;
        self.attributes(&prepared.wanted.starts)
    }

    /// Notes the unit of the coordinates of an image, as far as it or the request gives one.
    ///
    /// # Errors
    /// A length where the shapes of the cohort have none, and the other way round.
    pub fn meet(&mut self, unit: Option<Unit>) -> Result<(), ServiceError> {
        self.unit = unit;
        self.lengths = Lengths::of(&self.cohort);
        self.unit.map_or(Ok(()), |unit| Ok(self.lengths.meet(unit).map(drop)?))
    }

    /// Shapes of the objects that are to be stored, with their origin.
    ///
    /// # Errors
    /// [`ServiceError::Internal`] if the answer cannot be written (a bug).
    pub fn arriving(
        &self,
        found: SegmentAnswer,
        attributes: Vec<ShapeInput>,
    ) -> Result<Arriving, ServiceError> {
        let SegmentAnswer { image, coordinates, results } = found;
        let (mut shapes, mut places, mut members) = (Vec::new(), Vec::new(), Vec::new());
        for (object, attributes) in results.into_iter().zip(attributes) {
            let external_id =
                attributes.external_id.as_ref().and_then(|id| id.get()).and_then(|id| id.clone());
            let failed = object.has_failed() && !self.store_failed;
            let not_stored = failed.then(|| object.stop.to_owned());
            if !failed {
                places.push(object.index);
                shapes.push(self.shape(&object, attributes));
            }
            members.push(MemberOutput { object, external_id, id: None, not_stored });
        }
        let revision = self.cohort.revision;
        let (units, warnings) = (self.lengths.told(), self.lengths.warning().into_iter().collect());
        let answer =
            MembersAnswer { image, coordinates, results: members, added: 0, revision, units, warnings };
        let answer = json::to_value(&answer).map_err(|error| ServiceError::Internal(error.to_string()))?;
        Ok(Arriving { shapes, places, answer })
    }

    /// The shape of an object: as if it were posted by its control points.
    fn shape(&self, object: &SegmentedOutput, attributes: ShapeInput) -> ShapeInput {
        let origin = self.digests.origin(object.index, object.stop);
        let given = attributes.metadata.and_then(|data| data.take("/metadata", &mut Vec::new()));
        ShapeInput {
            control_points: Some(Box::new(self.stored_points(object))),
            metadata: Some(Box::new(Metadata::of(&with_origin(given, origin)))),
            labels: self.origin.beside(attributes.labels.clone()),
            ..ShapeInput { metadata: None, ..attributes }
        }
    }

    /// The control points of an object in the unit of the cohort.
    fn stored_points(&self, object: &SegmentedOutput) -> PointList {
        let points = PointList::from(&object.control_points);
        match self.lengths.ratio() {
            Some(ratio) => points.scaled(ratio),
            None => points,
        }
    }

    /// Adds objects to the cohort, all in one revision. Returns the answer, and whether anything was stored.
    ///
    /// # Errors
    /// Those of an upload.
    pub async fn store(self, app: &App, arriving: Arriving) -> Result<(Value, bool), ServiceError> {
        let Arriving { shapes, places, answer } = arriving;
        if shapes.is_empty() {
            return Ok((answer, false));
        }
        let list = if self.objects.is_some() { "objects" } else { "shapes" };
        let treatment = Treatment { on_error: OnError::Skip, ..Treatment::default() };
        let occasion = Occasion { note: Some(answer), job: self.job, lengths: self.lengths };
        let stored = upload::add_as(app, self.cohort, shapes, treatment, self.expected, occasion).await;
        let stored = stored.map_err(|error| in_request(error, list, &places))?;
        match Repeated::of(stored)? {
            Repeated::Answer(answer) => Ok((answer, true)),
            // The same request has become a job at this moment.
            Repeated::Job(_) => Err(StoreError::AlreadyDone.into()),
        }
    }
}

/// Outcome of a request that was executed before.
#[derive(Debug)]
pub enum Repeated {
    /// It was answered.
    Answer(Value),
    /// It has become the job with this id.
    Job(String),
}

impl Repeated {
    fn of(stored: Stored) -> Result<Self, ServiceError> {
        match stored.note.as_ref().and_then(|note| note.get(JOB)?.as_str()) {
            Some(id) => Ok(Self::Job(id.to_owned())),
            None => completed(stored).map(Self::Answer),
        }
    }
}

/// The note of the receipt of a request that has become a job.
pub fn note_of_job(id: &str) -> Value {
    json!({JOB: id})
}

/// Outcome of the request, if it was executed before.
///
/// # Errors
/// [`ServiceError::KeyReused`].
pub async fn done_before(app: &App) -> Result<Option<Repeated>, ServiceError> {
    let stored: Option<Stored> = app.done_before().await?;
    stored.map(Repeated::of).transpose()
}

/// Whether an answer has objects that are stored.
pub fn is_stored(answer: &Value) -> bool {
    let results = answer["results"].as_array().map(Vec::as_slice).unwrap_or_default();
    results.iter().any(|member| !member["id"].is_null())
}

/// External ids and subjects among attributes.
pub fn names(attributes: &[ShapeInput]) -> Vec<String> {
    let text =
        |field: &Option<Checked<Option<String>>>| field.as_ref().and_then(Checked::get).cloned().flatten();
    attributes
        .iter()
        .flat_map(|object| [text(&object.external_id), text(&object.subject)])
        .flatten()
        .collect()
}

/// The objects found, with their outcomes in the cohort.
fn completed(stored: Stored) -> Result<Value, ServiceError> {
    let lost = || ServiceError::Internal("a receipt without its answer".into());
    let Stored { added, revision, results, note, .. } = stored;
    let mut answer = note.ok_or_else(lost)?;
    let members = answer.get_mut("results").and_then(Value::as_array_mut).ok_or_else(lost)?;
    for (member, result) in members.iter_mut().filter(|member| member["not_stored"].is_null()).zip(results) {
        member["id"] = json!(result.id);
        member["not_stored"] = json!(result.faults.first().map(|fault| &fault.detail));
    }
    answer["added"] = json!(added);
    answer["revision"] = json!(revision);
    Ok(answer)
}

/// The metadata of a client with the origin of the shape, which replaces an earlier one.
fn with_origin(given: Option<Value>, origin: Value) -> Value {
    match given.filter(|given| !given.is_null()) {
        Some(Value::Object(mut fields)) => {
            fields.insert(ORIGIN.into(), origin);
            Value::Object(fields)
        }
        Some(other) => json!({"metadata": other, ORIGIN: origin}),
        None => json!({ORIGIN: origin}),
    }
}

/// A conflict of external ids at its place in the request.
fn in_request(error: ServiceError, list: &str, places: &[usize]) -> ServiceError {
    let ServiceError::ExternalIdConflict(fault) = error else { return error };
    let index = fault.index.and_then(|index| places.get(index).copied());
    let pointer = index.map_or_else(|| format!("/{list}"), |index| format!("/{list}/{index}/external_id"));
    ServiceError::ExternalIdConflict(Fault { index, ..Fault::new(pointer, fault.detail) }.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_of_clients_is_kept_beside_the_origin() {
        let origin = || json!({"index": 0});
        assert_eq!(with_origin(None, origin()), json!({"segmentation": {"index": 0}}));
        let given = json!({"scan": 7, "segmentation": {"index": 9}});
        assert_eq!(with_origin(Some(given), origin()), json!({"scan": 7, "segmentation": {"index": 0}}));
        let given = Some(json!([1, 2]));
        assert_eq!(with_origin(given, origin()), json!({"metadata": [1, 2], "segmentation": {"index": 0}}));
    }
}
