//! Dictionaries as files: export and import.
//!
//! A file is a JSON document with a digest of its content. An import checks the digest and the consistency of all parts
//! before it stores a new version.

use crate::wire::fault::Fault;
use std::ops::RangeInclusive;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::planning::method_faults;
use super::ready::{self, Ready};
use crate::analysis::classification::consistency::classifier_faults;
use crate::analysis::dictionary::content::Content;
use crate::analysis::dictionary::learn::MOST_LISTED;
use crate::domain::cohort::name_problem;
use crate::domain::dictionary::{NewDictionary, Provenance, Summary};
use crate::domain::id;
use crate::geometry::capability::domain::Admitted;
use crate::geometry::field_fault::FieldFault;
use crate::service::app::{App, Limits, ServiceError, now_ms};
use crate::service::shapes::read::admit_linear;

/// Name of the file format.
const FORMAT: &str = "shapelex-dictionary";
/// Versions of the format: see [`format_version`], the lowest one, so that a file stays the same when it is imported and exported again.
const FORMAT_VERSIONS: RangeInclusive<u32> = 1..=4;
/// Maximum number of warnings about the shapes, and their maximum length.
const MOST_WARNINGS: usize = 10;
const MAX_WARNING_CHARS: usize = 1000;

/// Lowest version that can represent a dictionary: that of its content, the fourth with warnings about the shapes.
fn format_version(provenance: &Provenance, content: &Content) -> u32 {
    if provenance.warnings.is_empty() { content.format_version() } else { 4 }
}

/// A dictionary as a single file in JSON, described in `docs/dictionaries.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "format": "shapelex-dictionary", "format_version": 1, "name": "triangles",
    "digest": "413c44869dc63e222ded850757e8b4340b291909bdb47967922e819c2703d2a6",
    "provenance": {
        "cohort": "coh_0198c0ffee00700080000000000000aa", "cohort_name": "triangles", "cohort_revision": 1, "filter": {},
        "shapes_digest": "164dc5ab11f1b921e60dc8aeb3ee5c67d9b98c1d3c6a3a639ece41d00fd29cd0", "program": "shapelex 0.1.0"
    },
    "content": {
        "representation": {"kind": "landmarks", "dimension": 2, "points": 3},
        "correspondence": "landmarks",
        "direction": "given",
        "mirror": "forbid",
        "length_unit": null,
        "transformation": "scaled_rotation",
        "alignment": "projection",
        "frame": "training",
        "method": {"kind": "functional_pca", "components": 1, "centre": false},
        "mean": {
            "control_points": [
                [0.0, -4.696509065219267e-17],
                [1.3785394880741388, 0.11260203829283884],
                [0.11246197728816584, 1.036485390373171]
            ],
            "eigenvalues": [
                2.986129160489358,
                2.9861291604893574,
                0.013870839510641882,
                0.013870839510641709,
                2.081668171172162e-16,
                0.0
            ],
            "gap": 2.9722583209787157,
            "unique": true,
            "converged": true
        },
        "centre": [
            [0.0, 0.0],
            [1.372165654741419, 0.11208141002559517],
            [0.11194199660882816, 1.0316930828715074]
        ],
        "atoms": [{
            "control_points": [
                [0.0, 0.0],
                [1.3785427015357692, 0.11275314801433996],
                [0.11265804953541397, 1.0364433952369017]
            ],
            "usage": 1.0,
            "eigenvalue": 2.9723490620253963,
            "explained": 0.9953852972449114
        }],
        "statistics": {
            "shapes": 3,
            "weight": 3.0,
            "objective": 0.002296683077326716,
            "history": [],
            "converged": true,
            "reseeded": 0,
            "reconstruction_error": 0.004638873111863217,
            "parameters": 1.0,
            "residuals": [0.0009780410231705686, 0.0045713487969166935, 0.008230708643873035],
            "total": 2.986129160489357,
            "scores": {
                "mean": [0.9953763763696422],
                "covariance": [[0.00001333506055889444]],
                "t_squared": [0.00003693173675102373, 0.9939044695641025, 1.0060585987038189]
            }
        }
    }
}))]
pub struct DictionaryFile {
    /// Name of the format: `shapelex-dictionary`.
    pub format: String,
    /// Version of the format: 1, 2 with measures of held-out shapes, 3 with shapes that a robust dictionary leaves out, 4 with held-out
    /// shapes that were chosen by a seed, or with warnings about the shapes.
    #[schema(minimum = 1, maximum = 4)]
    pub format_version: u32,
    /// Name under which the dictionary was learnt.
    pub name: String,
    /// BLAKE3 digest of `content` as compact JSON, with its fields in the order of this document.
    pub digest: String,
    /// Origin of the dictionary: cohort, revision, filter and program.
    pub provenance: Provenance,
    /// The learnt content.
    pub content: Content,
}

impl DictionaryFile {
    /// File of a stored version.
    pub fn new(ready: &Ready) -> Self {
        let (listed, content) = (&ready.listed, &ready.dictionary().content);
        Self {
            format: FORMAT.into(),
            format_version: format_version(&listed.provenance, content),
            name: listed.name.clone(),
            digest: listed.digest.clone(),
            provenance: listed.provenance.clone(),
            content: content.clone(),
        }
    }

    /// The file as text, whose content has the digest.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] if the content does not have the digest.
    pub fn text(&self) -> Result<Box<RawValue>, ServiceError> {
        let content = text_of(&self.content, &self.digest)?;
        let is_former = content != json_text(&self.content)?;
        let text = json_text(self)?;
        RawValue::from_string(if is_former { former(&text) } else { text }).map_err(internal)
    }
}

/// Stores a file as the next version of its name, or of another name.
///
/// # Errors
/// A file of another format, one that was modified, or one with inconsistent parts; [`ServiceError::Forbidden`] for
/// keys limited to cohorts, because a file may claim to come from any of them.
pub async fn import(
    app: &App,
    file: DictionaryFile,
    name: Option<String>,
) -> Result<Arc<Ready>, ServiceError> {
    app.check_unlimited("importing a dictionary")?;
    if let Some(id) = app.done_before::<String>().await? {
        return ready::find(app, &id).await;
    }
    let task_app = app.clone();
    let new = app.pool.run(move || checked_file(&task_app, file, name)).await?;
    app.store.add_dictionary(&new, app.receipt(&new.id).as_ref()).await?;
    ready::find(app, &new.id).await
}

fn checked_file(
    app: &App,
    file: DictionaryFile,
    name: Option<String>,
) -> Result<NewDictionary, ServiceError> {
    if file.format != FORMAT || !FORMAT_VERSIONS.contains(&file.format_version) {
        let (first, last) = FORMAT_VERSIONS.into_inner();
        let detail = format!(
            "expected {FORMAT} version {first} to {last}, got '{}' version {}",
            file.format, file.format_version
        );
        return Err(ServiceError::invalid("/format", detail));
    }
    let name = name.unwrap_or(file.name);
    if let Some(problem) = name_problem(&name, id::DICTIONARY) {
        return Err(ServiceError::invalid("/name", problem));
    }
    let listed = file.provenance.less_counted.len();
    if listed > MOST_LISTED {
        let detail = format!("expected at most {MOST_LISTED} shapes, got {listed}");
        return Err(ServiceError::invalid("/provenance/less_counted", detail));
    }
    let warnings = &file.provenance.warnings;
    if warnings.len() > MOST_WARNINGS || warnings.iter().any(|text| text.chars().count() > MAX_WARNING_CHARS)
    {
        let found = warnings.len();
        let detail = format!(
            "expected at most {MOST_WARNINGS} warnings of at most {MAX_WARNING_CHARS} characters, got {found}"
        );
        return Err(ServiceError::invalid("/provenance/warnings", detail));
    }
    let text = text_of(&file.content, &file.digest)?;
    let admitted = check_content(&file.content, &app.limits);
    let admitted = admitted.map_err(|faults| ServiceError::Invalid(faults.into()))?;
    ServiceError::unless_empty(in_file(classifier_faults(&file.content)).collect())?;
    let settings = ready::settings(&file.content).checked_with(Ok(admitted));
    let prepared = settings.and_then(|settings| ready::prepare(app, settings, file.content));
    let (_, dictionary) = prepared.map_err(|error| match error {
        ServiceError::Invalid(faults) => ServiceError::Invalid(faults.map(|fault| fault.below("/content"))),
        other => other,
    })?;
    ServiceError::unless_empty(in_file(dictionary.norm_faults()).collect())?;
    Ok(NewDictionary {
        id: id::new_id(id::DICTIONARY),
        name,
        summary: Summary::of(&dictionary.content),
        content: text.into_bytes(),
        state: None,
        provenance: file.provenance,
        digest: file.digest,
        created_at_ms: now_ms(),
    })
}

/// The content as text with this digest: as it is written now, or as earlier versions wrote it, which named the generator
/// `cubic` after Keys.
///
/// # Errors
/// [`ServiceError::Invalid`] if neither has the digest.
fn text_of(content: &Content, digest: &str) -> Result<String, ServiceError> {
    let text = json_text(content)?;
    let has_digest = |text: &str| blake3::hash(text.as_bytes()).to_hex().as_str() == digest;
    if has_digest(&text) {
        return Ok(text);
    }
    let former = former(&text);
    if has_digest(&former) {
        return Ok(former);
    }
    let present = blake3::hash(text.as_bytes()).to_hex();
    let detail = format!("expected {present}, the digest of the content, got {digest}: the file was changed");
    Err(ServiceError::invalid("/digest", detail))
}

/// `text` as earlier versions wrote it.
fn former(text: &str) -> String {
    text.replace(r#"{"name":"cubic"}"#, r#"{"name":"keys"}"#)
}

fn json_text(value: &impl Serialize) -> Result<String, ServiceError> {
    serde_json::to_string(value).map_err(internal)
}

fn internal(error: serde_json::Error) -> ServiceError {
    ServiceError::Internal(format!("a dictionary is not JSON: {error}"))
}

/// Checks the content of a file; the representation is then within the limits.
///
/// # Errors
/// Wrong sizes, and values that learning never produces.
fn check_content(content: &Content, limits: &Limits) -> Result<Admitted, Vec<Fault>> {
    let mut faults: Vec<Fault> =
        method_faults(&content.method, limits).into_iter().map(|fault| fault.below("/content")).collect();
    let admitted = match admit_linear(content.representation.clone(), limits) {
        Ok(admitted) => admitted,
        Err(errors) => {
            faults.extend(errors.into_iter().map(|error| error.below("/content/representation")));
            return Err(faults);
        }
    };
    faults.extend(in_file(content.faults()));
    if faults.is_empty() { Ok(admitted) } else { Err(faults) }
}

/// Faults of the content, at their places in the file.
fn in_file(faults: Vec<FieldFault>) -> impl Iterator<Item = Fault> {
    faults.into_iter().map(|fault| Fault::from(fault.below("content")))
}
