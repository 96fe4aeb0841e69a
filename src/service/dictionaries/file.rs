//! Dictionaries as files: export and import.
//!
//! A file is a JSON document with a digest of its content. An import checks the digest and the consistency of all parts
//! before it stores a new version.

use crate::formats::fault::Fault;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::planning::method_faults;
use super::ready::Ready;
use super::{file_classifier, ready};
use crate::analysis::dictionary::content::{Content, HeldOutMeasure};
use crate::analysis::dictionary::in_use::Dictionary;
use crate::analysis::metric::norm;
use crate::analysis::rows::Row;
use crate::domain::cohort::name_problem;
use crate::domain::dictionary::{NewDictionary, Provenance, Summary};
use crate::domain::id;
use crate::service::app::{App, Limits, ServiceError, now_ms};

/// Name of the file format.
const FORMAT: &str = "shapelex-dictionary";
/// Versions of the format: the second adds measures of held-out shapes.
const FORMAT_VERSIONS: [u32; 2] = [1, 2];

/// Lowest version that can represent `content`, so that a file stays the same when it is imported and exported again.
fn format_version(content: &Content) -> u32 {
    if content.statistics.held_out.is_some() { 2 } else { 1 }
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
    /// Version of the format: 1, or 2 with measures of held-out shapes.
    pub format_version: u32,
    /// Name under which the dictionary was learnt.
    pub name: String,
    /// BLAKE3 digest of `content` as compact JSON, with its fields in the order of this document.
    pub digest: String,
    /// Origin of the dictionary: cohort, revision, filter and program.
    #[schema(value_type = Object)]
    pub provenance: Provenance,
    /// The learnt content.
    pub content: Content,
}

impl DictionaryFile {
    /// File of a stored version.
    pub fn new(ready: &Ready) -> Self {
        let (listed, content) = (&ready.listed, &ready.dictionary.content);
        Self {
            format: FORMAT.into(),
            format_version: format_version(content),
            name: listed.name.clone(),
            digest: listed.digest.clone(),
            provenance: listed.provenance.clone(),
            content: content.clone(),
        }
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
        let [first, last] = FORMAT_VERSIONS;
        let detail = format!(
            "expected {FORMAT} version {first} or {last}, got '{}' version {}",
            file.format, file.format_version
        );
        return Err(ServiceError::invalid("/format", detail));
    }
    let name = name.unwrap_or(file.name);
    if let Some(problem) = name_problem(&name, id::DICTIONARY) {
        return Err(ServiceError::invalid("/name", problem));
    }
    let text = serde_json::to_vec(&file.content)
        .map_err(|error| ServiceError::Internal(format!("a dictionary is not JSON: {error}")))?;
    let digest = blake3::hash(&text).to_hex().to_string();
    if digest != file.digest {
        let detail = format!(
            "expected {digest}, the digest of the content, got {}: the file was changed",
            file.digest
        );
        return Err(ServiceError::invalid("/digest", detail));
    }
    ServiceError::unless_empty(content_faults(&file.content, &app.limits))?;
    ServiceError::unless_empty(file_classifier::classifier_faults(&file.content))?;
    let prepared = ready::prepare(app, file.content).map_err(|error| match error {
        ServiceError::Invalid(faults) => ServiceError::Invalid(faults.map(|fault| fault.below("/content"))),
        other => other,
    });
    let (_, dictionary) = prepared?;
    ServiceError::unless_empty(norm_faults(&dictionary))?;
    Ok(NewDictionary {
        id: id::new_id(id::DICTIONARY),
        name,
        summary: Summary::of(&dictionary.content),
        content: text,
        state: None,
        provenance: file.provenance,
        digest,
        created_at_ms: now_ms(),
    })
}

/// Inconsistencies in a file: wrong sizes, and values that learning never produces.
fn content_faults(content: &Content, limits: &Limits) -> Vec<Fault> {
    let mut faults: Vec<Fault> =
        method_faults(&content.method, limits).into_iter().map(|fault| fault.below("/content")).collect();
    let representation = &content.representation;
    if let Err(errors) = crate::service::shapes::read::check_representation(representation, limits) {
        let below = errors.into_iter().map(|error| error.below("/content/representation"));
        faults.extend(below);
        return faults;
    }
    let (size, dimension) = (representation.size(), representation.dimension());
    let mut check = |ok: bool, field: String, detail: &str| {
        if !ok {
            faults.push(Fault::new(format!("/content/{field}"), detail));
        }
    };
    let bounded = |row: &[f64]| row.iter().all(|value| value.abs() <= MAX_NUMBER);
    let shape =
        |rows: &[Row]| rows.len() == size && rows.iter().all(|row| row.len() == dimension && bounded(row));
    let wrong = "expected the size of the representation, and numbers within ±1e100";
    check(shape(&content.mean.control_points), "mean/control_points".into(), wrong);
    for (j, atom) in content.atoms.iter().enumerate() {
        check(shape(&atom.control_points), format!("atoms/{j}/control_points"), wrong);
    }
    if let Some(centre) = &content.centre {
        check(shape(centre), "centre".into(), wrong);
    }
    let scores = content.statistics.scores.as_ref();
    for (field, detail) in content.method.inconsistencies(content, &bounded) {
        check(false, field.into(), detail);
    }
    let quantiles = |values: &[f64]| !values.is_empty() && values.is_sorted();
    let residuals = &content.statistics.residuals;
    check(quantiles(residuals), "statistics/residuals".into(), "expected numbers in ascending order");
    check(
        scores.is_none_or(|scores| quantiles(&scores.t_squared)),
        "statistics/scores/t_squared".into(),
        "expected numbers in ascending order",
    );
    faults.extend(held_out_faults(content));
    faults
}

/// Inconsistencies in the measures of held-out shapes.
fn held_out_faults(content: &Content) -> Vec<Fault> {
    let Some(held_out) = &content.statistics.held_out else { return Vec::new() };
    let mut faults = Vec::new();
    let mut check = |ok: bool, field: &str, detail: &str| {
        if !ok {
            faults.push(Fault::new(format!("/content/statistics/held_out/{field}"), detail));
        }
    };
    let count = held_out.novelty.len();
    let ascending = |values: &[f64]| {
        values.len() == count && values.is_sorted() && values.iter().all(|value| value.abs() <= MAX_NUMBER)
    };
    let fits = |measure: &HeldOutMeasure| {
        ascending(&measure.values)
            && measure.log_mean.abs() <= MAX_NUMBER
            && (1e-100..=MAX_NUMBER).contains(&measure.log_deviation)
    };
    let wrong = "expected one number per held-out shape in ascending order, with mean and positive deviation";
    check(
        count >= 2 && ascending(&held_out.novelty),
        "novelty",
        "expected at least two numbers in ascending order",
    );
    check(fits(&held_out.residuals), "residuals", wrong);
    check(held_out.t_squared.as_ref().is_none_or(fits), "t_squared", wrong);
    let components = !content.method.is_sparse();
    check(
        held_out.t_squared.is_some() == components,
        "t_squared",
        "expected for components, and only for them",
    );
    faults
}

/// Largest number in a shape or a statistic of a file: its square is finite.
const MAX_NUMBER: f64 = 1e100;

/// Tolerance for products of atoms in a file; for learnt atoms the deviation is about 1e-15.
const ORTHONORMAL: f64 = 1e-6;

/// Faults that make comparisons impossible: a mean without extent, and atoms that are not of unit norm or not
/// orthogonal where they must be (components, and the blocks of invariant codes).
fn norm_faults(dictionary: &Dictionary) -> Vec<Fault> {
    let mut faults = Vec::new();
    let model = &dictionary.model;
    if !(norm(&dictionary.preparation.mean) > 0.0) {
        faults.push(Fault::new("/content/mean/control_points", "expected a shape with an extent"));
    }
    // Components are mutually orthogonal; the atoms of invariant codes have orthogonal blocks.
    let (columns, block) = model.columns();
    let group = if dictionary.content.method.is_sparse() { block } else { columns.ncols() };
    for j in 0..model.len() {
        let first = j * block / group.max(1) * group;
        let products = columns.columns(first, group).tr_mul(&columns.columns(j * block, block));
        let wanted = |i: usize, k: usize| if first + i == j * block + k { 1.0 } else { 0.0 };
        let near = |i: usize, k: usize| (products[(i, k)] - wanted(i, k)).abs() <= ORTHONORMAL;
        if !(0..group).all(|i| (0..block).all(|k| near(i, k))) {
            let detail = "expected unit norm, and orthogonality where the method requires it";
            faults.push(Fault::new(format!("/content/atoms/{j}/control_points"), detail));
        }
    }
    faults
}
