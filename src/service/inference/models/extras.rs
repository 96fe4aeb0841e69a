//! What may be asked of a model beside its table: random effects, multivariate statistics, a known covariance, scores as a response.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::table::resolved;
use crate::analysis::models::covariance::{Covariance, MAX_SHAPES};
use crate::analysis::models::error::ModelError;
use crate::analysis::models::manova::MAX_COORDINATES;
use crate::analysis::models::mixed::{Criterion, MAX_SCORES, RandomQuestion, Structure};
use crate::domain::shape::ShapeDescription;
use crate::service::app::ServiceError;
use crate::service::cohorts::attributes;
use crate::wire::fault::Fault;

/// What a covariance is given by.
const CHOICE: &str = "expected names and rows, or a tree, got another choice";
/// Word before the numbers of scores in a response.
const SCORE: &str = "score ";
/// Last score of a response.
const LAST_SCORE: usize = 1000;

/// Estimates of the random part of a formula.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RandomOptions {
    /// How variances of coordinates belong together. Default: `scalar` for intercepts, `by_score` for slopes.
    pub structure: Option<Structure>,
    /// Criterion that is maximised. Default: `reml`.
    #[serde(default)]
    pub method: Criterion,
    /// Number of principal scores, 1 to 20. Default: those of 95 % of the scatter, at most a third of the degrees of freedom within the
    /// groups.
    pub components: Option<usize>,
    /// Whether the shapes of the groups are wanted.
    #[serde(default)]
    pub subjects: bool,
}

impl From<&RandomOptions> for RandomQuestion {
    fn from(options: &RandomOptions) -> Self {
        let RandomOptions { structure, method, components, subjects } = *options;
        Self { structure, criterion: method, scores: components, subjects }
    }
}

/// Multivariate statistics of the terms.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ManovaOptions {
    /// Number of principal coordinates, 1 to 100. Default: half of the degrees of freedom of the residuals.
    pub components: Option<usize>,
}

/// A known covariance of the shapes: `rows` for `names`, or a `tree`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CovarianceOptions {
    /// Attribute whose values are the names, such as `subject` or `labels.species`. Default: the identifiers of the shapes.
    pub by: Option<String>,
    /// Names of the rows and columns.
    #[schema(value_type = Option<Vec<String>>)]
    pub names: Option<Listed<String>>,
    /// Symmetric and positive definite.
    #[schema(value_type = Option<Vec<Vec<f64>>>)]
    pub rows: Option<Listed<Vec<f64>>>,
    /// Tree in Newick's notation with the lengths of all branches, along which shapes change as Brownian motion.
    pub tree: Option<String>,
}

/// A list of at most as many entries as shapes may have a covariance, cut while it is read.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Listed<T>(Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Listed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for List<T> {
            type Value = Listed<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a list of at most {MAX_SHAPES} entries")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Listed<T>, A::Error> {
                let entries = (0..=MAX_SHAPES).map_while(|_| list.next_element().transpose());
                let entries = entries.collect::<Result<Vec<T>, _>>()?;
                match entries.len() > MAX_SHAPES {
                    true => Err(A::Error::invalid_length(entries.len(), &self)),
                    false => Ok(Listed(entries)),
                }
            }
        }
        deserializer.deserialize_seq(List(PhantomData))
    }
}

/// Other programs whose numbers are added.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Compatibility {
    /// Terms with an error term of the model also have p and Z of the ratio of permuted mean squares.
    Rrpp,
}

impl CovarianceOptions {
    /// The covariance.
    ///
    /// # Errors
    /// Rows and a tree, or none of them; rows that are no covariance; a text that is no tree.
    pub(super) fn read(&self) -> Result<Covariance, ModelError> {
        match (&self.names, &self.rows, &self.tree) {
            (Some(names), Some(rows), None) => Covariance::of_rows(&names.0, rows.0.clone()),
            (None, None, Some(tree)) => Covariance::of_tree(tree),
            _ => Err(ModelError::Covariance { detail: CHOICE.into() }),
        }
    }

    /// Names of the shapes in the covariance.
    ///
    /// # Errors
    /// Shapes without a value of the attribute; too many shapes.
    pub(super) fn names_of(&self, shapes: &[ShapeDescription]) -> Result<Vec<String>, ServiceError> {
        if shapes.len() > MAX_SHAPES {
            let detail =
                format!("expected at most {MAX_SHAPES} shapes with a covariance, got {}", shapes.len());
            return Err(ServiceError::invalid("/covariance", detail));
        }
        let Some(attribute) = self.by.as_deref().and_then(resolved) else {
            return Ok(shapes.iter().map(|shape| attributes::name_of(shape).to_owned()).collect());
        };
        let of = |shape: &ShapeDescription| {
            attribute.text(shape).ok_or_else(|| {
                let detail =
                    format!("expected a value on all shapes, got none on '{}'", attributes::name_of(shape));
                ServiceError::invalid("/covariance/by", detail)
            })
        };
        shapes.iter().map(of).collect()
    }

    fn fault(&self) -> Option<Fault> {
        if let Some(name) = self.by.as_ref().filter(|name| resolved(name).is_none()) {
            return Some(Fault::new(
                "/covariance/by",
                format!("expected the name of an attribute, got '{name}'"),
            ));
        }
        let is_given = match (&self.names, &self.rows, &self.tree) {
            (names, rows, None) => names.is_some() && rows.is_some(),
            (names, rows, Some(_)) => names.is_none() && rows.is_none(),
        };
        (!is_given).then(|| Fault::new("/covariance", CHOICE))
    }
}

/// Faults of what is asked beside the table.
pub(super) fn faults(options: &super::Options) -> Vec<Fault> {
    let out = |pointer: &str, found: Option<usize>, most: usize| {
        let found = found.filter(|found| !(1..=most).contains(found))?;
        Some(Fault::new(pointer, format!("expected a number from 1 to {most}, got {found}")))
    };
    let random = options.random.as_ref().and_then(|random| random.components);
    let manova = options.manova.as_ref().and_then(|manova| manova.components);
    let covariance = options.covariance.as_ref().and_then(CovarianceOptions::fault);
    let faults =
        [out("/random/components", random, MAX_SCORES), out("/manova/components", manova, MAX_COORDINATES)];
    faults.into_iter().flatten().chain(covariance).collect()
}

/// Whether a response is one of scores.
pub(super) fn names_scores(response: &str) -> bool {
    response.starts_with(SCORE)
}

/// Scores of a response `score 3` or `score 1..4`, from 0.
pub(super) fn scores(response: &str) -> Option<Range<usize>> {
    let text = response.strip_prefix(SCORE)?;
    let (first, last) = text.split_once("..").unwrap_or((text, text));
    let (first, last) = (first.trim().parse::<usize>().ok()?, last.trim().parse::<usize>().ok()?);
    (1 <= first && first <= last && last <= LAST_SCORE).then(|| first - 1..last)
}
