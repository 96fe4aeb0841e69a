//! Cohorts: named sets of comparable shapes.

use serde::{Deserialize, Serialize};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_geometry::representation::Representation;

/// Properties of a cohort: those that a client gives.
#[derive(Debug, Clone, PartialEq)]
pub struct CohortSpec {
    /// Unique name; can be used in place of the id.
    pub name: String,
    /// Free-text description.
    pub description: Option<String>,
    /// Representation of the cohort's shapes.
    pub representation: Representation,
    /// Correspondence of parameter values between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Whether shapes may be matched to mirror images.
    pub mirror: Mirror,
    /// Unit of the coordinates, such as `mm`; `none` where they have none by intent, another text of an earlier release.
    pub length_unit: Option<String>,
}

impl CohortSpec {
    /// Unit that stands beside numbers.
    pub fn shown_unit(&self) -> Option<&str> {
        self.length_unit.as_deref().filter(|unit| *unit != "none")
    }
}

/// A named set of shapes in one representation with one correspondence rule.
///
/// The revision starts at 0 and grows by one with every change of the set.
#[derive(Debug, Clone, PartialEq)]
pub struct Cohort {
    /// Identifier, `coh_…`.
    pub id: String,
    /// Its properties.
    pub spec: CohortSpec,
    /// Revision number: number of changes so far.
    pub revision: u64,
    /// Number of shapes at this revision.
    pub shapes: u64,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
    /// Time of the last change, milliseconds since 1970 UTC.
    pub updated_at_ms: i64,
    /// Rules that it had before, in order.
    pub former_rules: Vec<FormerRule>,
}

/// A rule by which the shapes of a cohort were compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FormerRule {
    /// Last revision at which it held.
    pub until: u64,
    /// Correspondence of parameter values between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Whether shapes might be matched to mirror images.
    pub mirror: Mirror,
}

impl Cohort {
    /// The cohort at an earlier revision, with the rule that it had then.
    pub fn at(mut self, revision: u64) -> Self {
        if let Some(rule) = self.former_rules.iter().find(|rule| revision <= rule.until) {
            let FormerRule { correspondence, direction, mirror, .. } = *rule;
            self.spec = CohortSpec { correspondence, direction, mirror, ..self.spec };
        }
        Self { revision, ..self }
    }
}

/// Maximum length of a name in characters.
pub const MAX_NAME_CHARS: usize = 100;

/// Reason why `name` is not a valid name for objects whose ids begin with `prefix`, if any.
///
/// A name is a path segment: letters, digits, `.`, `_`, `-`, at most [`MAX_NAME_CHARS`] characters, not starting
/// with a dot, and not in the form of an id.
pub fn name_problem(name: &str, prefix: &str) -> Option<String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if name.is_empty() || name.chars().count() > MAX_NAME_CHARS {
        return Some(format!("expected 1 to {MAX_NAME_CHARS} characters"));
    }
    if !name.chars().all(allowed) || name.starts_with('.') {
        return Some("expected letters, digits, '.', '_' and '-', without '.' at the start".into());
    }
    name.starts_with(&format!("{prefix}_"))
        .then(|| format!("expected a name that does not look like an id ({prefix}_…)"))
}
