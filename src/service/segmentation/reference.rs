//! Means and spans of the store as references of priors.

use serde::{Deserialize, Serialize};

use crate::analysis::alignment::Alignment;
use crate::analysis::dictionary::prior::Reference;
use crate::analysis::frame::Frame;
use crate::analysis::rows::columns_of;
use crate::analysis::transformation::Transformation;
use crate::domain::filter::ShapeFilter;
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::caveats;
use crate::service::cohorts::live_mean::{self, MeanQuery, SearchStart};
use crate::service::dictionaries::ready::{self, Ready};
use crate::wire::unit::Unit;

/// Object that has a mean.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// The cohort with this id or name.
    Cohort(String),
    /// A part of the dictionaries with these ids, `name@version`, `name@alias` or names, of which the nearest attracts.
    Dictionaries(Vec<String>, DictionaryPart),
}

/// Part of a dictionary that attracts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DictionaryPart {
    /// Its mean.
    #[default]
    Mean,
    /// All sums of its mean and its principal components.
    Components,
    /// All sums of its atoms; of principal components, and of their mean.
    Atoms,
}

/// A reference of the store.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stored {
    /// Its representation.
    pub representation: Representation,
    /// The attracting structure.
    #[serde(flatten)]
    pub first: Structure,
    /// Structures that attract in its place where they are nearer.
    #[serde(default)]
    pub others: Vec<Structure>,
}

/// Shapes that attract.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Structure {
    /// One, or those of the attracting span; control points, coordinate-major.
    pub shapes: Vec<Vec<f64>>,
    /// Whether their sums attract too.
    pub is_span: bool,
    /// Id of their dictionary.
    #[serde(default)]
    pub dictionary: Option<String>,
    /// Unit of their coordinates, where their cohort or dictionary has one.
    #[serde(default)]
    pub length_unit: Option<String>,
}

impl Structure {
    /// Converts the shapes to another unit; shapes without a unit stay as they are.
    ///
    /// # Errors
    /// The unit of the shapes, if one of both is a length and the other one none.
    pub(super) fn convert(&mut self, unit: Unit) -> Result<(), Unit> {
        let Some(own) = self.length_unit.as_deref().and_then(Unit::find) else { return Ok(()) };
        let ratio = own.to(unit).ok_or(own)?;
        self.shapes.iter_mut().flatten().for_each(|x| *x = ratio.times(*x));
        self.length_unit = Some(unit.word().into());
        Ok(())
    }
}

/// The mean of a cohort under a class of transformations; or the mean of a dictionary, or the span of its components or atoms, which
/// were learnt under its own class.
///
/// # Errors
/// [`ServiceError::NotFound`]; a class of a cohort that has no name, at `/prior/transformation`; shapes without a mean; components of
/// a sparse dictionary, at `/prior/reference`.
pub async fn find(
    app: &App,
    source: Source,
    transformation: Transformation,
    alignment: Option<Alignment>,
) -> Result<Stored, ServiceError> {
    match source {
        Source::Cohort(key) => {
            let Transformation::Named(transformation) = transformation else {
                let detail = "expected the name of a class for the mean of a cohort, got generators";
                return Err(ServiceError::invalid("/prior/transformation", detail));
            };
            let cohort = catalogue::find(app, &key).await?;
            let all = ShapeFilter::default();
            if let Some(found) = caveats::of_meshes(app, &cohort, &all).await? {
                let detail = format!("expected surfaces whose parameters correspond, got others: {found}");
                return Err(ServiceError::invalid("/prior/cohort", detail));
            }
            let query = MeanQuery {
                transformation,
                alignment,
                frame: Frame::default(),
                filter: all,
                start: SearchStart::default(),
                robust: false,
                corresponding: true,
            };
            let live = live_mean::mean(app, cohort, query).await?;
            let representation = live.cohort.spec.representation.clone();
            let shapes = vec![live.mean.control_points.clone()];
            let length_unit = live.cohort.spec.length_unit.clone();
            let first = Structure { shapes, is_span: false, dictionary: None, length_unit };
            Ok(Stored { representation, first, others: Vec::new() })
        }
        Source::Dictionaries(keys, part) => of_dictionaries(app, &keys, part).await,
    }
}

async fn of_dictionaries(app: &App, keys: &[String], part: DictionaryPart) -> Result<Stored, ServiceError> {
    let mut found: Option<Stored> = None;
    for (index, key) in keys.iter().enumerate() {
        let ready = ready::find(app, key).await?;
        let representation = &ready.dictionary().content.representation;
        let structure = of_dictionary(&ready, part)?;
        match &mut found {
            None => {
                let representation = representation.clone();
                found = Some(Stored { representation, first: structure, others: Vec::new() });
            }
            Some(stored) if stored.representation == *representation => stored.others.push(structure),
            Some(_) => {
                let detail =
                    "expected dictionaries of one representation, got another than that of the first";
                return Err(ServiceError::invalid(format!("/prior/dictionaries/{index}"), detail));
            }
        }
    }
    found.ok_or_else(|| ServiceError::Internal("a prior without a dictionary".into()))
}

fn of_dictionary(ready: &Ready, part: DictionaryPart) -> Result<Structure, ServiceError> {
    let (dictionary, content) = (ready.dictionary(), &ready.dictionary().content);
    let (id, length_unit) = (Some(ready.listed.id.clone()), content.length_unit.clone());
    if part == DictionaryPart::Mean {
        let shapes = vec![columns_of(&content.mean.control_points, content.representation.dimension())];
        return Ok(Structure { shapes, is_span: false, dictionary: id, length_unit });
    }
    if part == DictionaryPart::Components && content.method.is_sparse() {
        let detail = "expected mean or atoms of a sparse dictionary, got components";
        return Err(ServiceError::invalid("/prior/reference", detail));
    }
    let unwhitened = |mut shape: Vec<f64>| {
        dictionary.metric().unwhiten(&mut shape);
        shape
    };
    let shapes = dictionary.span(Reference::Atoms).into_iter().map(unwhitened).collect();
    Ok(Structure { shapes, is_span: true, dictionary: id, length_unit })
}
