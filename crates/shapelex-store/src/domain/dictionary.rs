//! Dictionaries: statistics learnt from a cohort and stored.
//!
//! A dictionary is immutable; learning again under the same name creates the next version. Its [`Content`] depends on the
//! shapes and the parameters alone, so that equal inputs give equal digests. Time, name and cohort are recorded outside the
//! content, the cohort in its [`Provenance`].

use serde::{Deserialize, Serialize};
use shapelex_analysis::classifier_record::ClassifierKind;
use shapelex_analysis::dictionary::content::Content;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::transformation::Transformation;
use shapelex_geometry::representation::Representation;

use super::cohort::name_problem;
use super::filter::ShapeFilter;
use super::id;

/// A stored version of a dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct Dictionary {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Version number, from 1.
    pub version: u64,
    /// Learnt content and its parameters.
    pub content: Content,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Dictionary {
    /// Identity of the version, and its content.
    pub fn parts(self) -> (Listed, Content) {
        let Self { id, name, version, content, provenance, digest, created_at_ms } = self;
        let summary = Summary::of(&content);
        (Listed { id, name, version, summary, provenance, digest, created_at_ms }, content)
    }
}

/// Training data of a dictionary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Id of the cohort.
    pub cohort: String,
    /// Name of the cohort at that time.
    pub cohort_name: String,
    /// Revision of the cohort at that time.
    pub cohort_revision: u64,
    /// Filter that selected its shapes.
    pub filter: ShapeFilter,
    /// BLAKE3 digest of their control points and weights.
    pub shapes_digest: String,
    /// Id of the version that learning continued from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continued_from: Option<String>,
    /// Program and its version.
    pub program: String,
    /// Shapes with the smallest factors below one of a robust dictionary, at most 20.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schema(max_items = 20))]
    pub less_counted: Vec<LessCountedShape>,
    /// Warnings about the shapes in everything that is computed with the dictionary: contours drawn both ways round
    /// where their direction counts, surfaces whose parameters do not correspond.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schema(max_items = 10))]
    pub warnings: Vec<String>,
}

/// A shape of a cohort that counts less than its weight in a robust estimate, or not at all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct LessCountedShape {
    /// Id of the shape.
    pub id: String,
    /// Factor of its weight; 0 for a shape that is left out.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 1))]
    pub weight: f64,
    /// Where the shape is like the others: a number between 0 and 1 for each control point, small where it is damaged. Absent where a list
    /// would become too long: shapes of very many control points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_weights: Option<Vec<f64>>,
}

/// List entry of a version.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Version number, from 1.
    pub version: u64,
    /// Parts of the content shown in lists.
    pub summary: Summary,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// Parts of a [`Content`] shown in lists.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Summary {
    /// Representation of the shapes.
    pub representation: Representation,
    /// Transformation class removed before comparison.
    pub transformation: Transformation,
    /// Learning method with all its parameters.
    pub method: Method,
    /// Number of atoms; fewer components than requested if the rank is smaller.
    pub atoms: usize,
    /// Number of training shapes.
    pub shapes: usize,
    /// Mean objective over the training shapes.
    pub objective: f64,
    /// Mean reconstruction error over the training shapes.
    pub reconstruction_error: f64,
    /// Kind of classifier, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub classifier: Option<ClassifierKind>,
    /// Fraction of the shapes classified correctly in cross-validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<f64>,
}

/// A name for a version, written `name@alias`, which can be moved to another version of the same name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alias {
    /// The alias.
    pub alias: String,
    /// Id of the version that it names.
    pub id: String,
    /// Name of the dictionary.
    pub name: String,
    /// Number of the version.
    pub version: u64,
    /// BLAKE3 digest of the content of the version.
    pub digest: String,
    /// Number of versions that it has named so far.
    pub moves: u64,
    /// Since when it names the version, milliseconds since 1970 UTC.
    pub moved_at_ms: i64,
}

/// Reason why `alias` is not a valid alias, if any.
///
/// An alias begins with a letter, so that it is never the number of a version. `latest` is none: the name alone already means
/// the latest version.
pub fn alias_problem(alias: &str) -> Option<String> {
    let got = || format!(", got '{alias}'");
    if let Some(problem) = name_problem(alias, id::DICTIONARY) {
        return Some(problem + &got());
    }
    if !alias.starts_with(|c: char| c.is_ascii_alphabetic()) {
        return Some(format!("expected a letter at the start, unlike the number of a version{}", got()));
    }
    (alias == "latest")
        .then(|| "expected an alias other than 'latest': the name alone is the latest version".to_owned())
}

/// A version about to be stored; the store assigns its number.
#[derive(Debug, Clone, PartialEq)]
pub struct NewDictionary {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Parts of the content shown in lists.
    pub summary: Summary,
    /// The content as JSON.
    pub content: Vec<u8>,
    /// Accumulated sums from which learning can continue.
    pub state: Option<Vec<u8>>,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Summary {
    /// The parts of `content` shown in lists.
    pub fn of(content: &Content) -> Self {
        Self {
            representation: content.representation.clone(),
            transformation: content.transformation.clone(),
            method: content.method.clone(),
            atoms: content.atoms.len(),
            shapes: content.statistics.shapes,
            objective: content.statistics.objective,
            reconstruction_error: content.statistics.reconstruction_error,
            classifier: content.classifier.as_ref().map(|record| record.settings.kind),
            accuracy: content.classifier.as_ref().map(|record| record.validation.accuracy.value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_alias_is_no_number_and_not_the_latest() {
        for right in ["production", "a", "v1.2", "Site_B-2026"] {
            assert_eq!(alias_problem(right), None, "{right}");
        }
        for wrong in ["", "3", "3a", "_x", "-x", ".x", "a@b", "a/b", "é", "latest", "dic_1", &"a".repeat(101)]
        {
            assert!(alias_problem(wrong).is_some_and(|problem| problem.starts_with("expected ")), "{wrong}");
        }
    }
}
