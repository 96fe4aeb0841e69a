//! Dictionaries of cohorts at rest: learnt from a revision, kept beside it, used in passes over it.

use std::sync::Arc;
use std::time::SystemTime;

use object_store::path::Path;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{MergePart, ShapeSource, Shapes, VisitMarked};
use shapelex_analysis::dictionary::content::Content;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::learn::Learner;
use shapelex_analysis::dictionary::model::Coded;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::pass::{CodeGroup, Group, Pass};
use shapelex_analysis::watch::Watch;

use crate::EngineError;
use crate::cohort::learning_folder;
use crate::named::{MAX_BYTES, refused, text};
use crate::pass::learn::Learn;
use crate::pass::source::AtRest;
use crate::pass::work::Work;

pub use crate::named::Named;

/// Name of the file format of the service.
const FORMAT: &str = "shapelex-dictionary";

/// A dictionary as a file, which the service imports.
#[derive(Debug, Serialize)]
pub struct File {
    format: &'static str,
    format_version: u32,
    /// Name under which it is imported.
    pub name: String,
    /// Digest of the content.
    pub digest: String,
    provenance: Provenance,
    content: Box<RawValue>,
}

/// Where a dictionary comes from.
#[derive(Debug, Serialize)]
struct Provenance {
    cohort: String,
    cohort_name: String,
    cohort_revision: u64,
    filter: serde_json::Map<String, serde_json::Value>,
    shapes_digest: String,
    program: String,
}

/// A dictionary file of the service; what is not needed here is not read.
#[derive(Deserialize)]
struct Given {
    content: Box<RawValue>,
}

/// The content of a dictionary file, as the service exports it and [`File`] writes it.
///
/// # Errors
/// [`EngineError::Refused`] for what is none, and for parts that do not fit together.
pub fn read(text: &[u8]) -> Result<Content, EngineError> {
    if text.len() as u64 > MAX_BYTES {
        return Err(refused(&format!("expected at most {MAX_BYTES} bytes, got {}", text.len())));
    }
    let expected = |error: serde_json::Error| refused(&format!("expected a dictionary file, got {error}"));
    let given: Given = serde_json::from_slice(text).map_err(expected)?;
    let content: Content = serde_json::from_str(given.content.get()).map_err(expected)?;
    match content.faults().first() {
        Some(fault) => Err(refused(&format!("{}: {}", fault.field, fault.detail))),
        None => Ok(content),
    }
}

/// Learns a dictionary from the shapes of `source`. Sums, and the pass that tells how well each shape is described, run where the
/// sums of the source do; the others read the shapes here. So do codes of sparse dictionaries whose shapes take more than
/// `kept_bytes`: smaller ones are coded here, from memory.
///
/// Cost: as learning in the service; memory: a part, the sums, and 48 bytes a shape for the measures of the description.
///
/// # Errors
/// As [`Learner::learn`]; errors of the store.
pub fn learn(
    source: &AtRest<'_>,
    recipe: &Recipe,
    watch: &dyn Watch,
    name: String,
    kept_bytes: usize,
) -> Result<File, EngineError> {
    let setting = recipe.setting()?;
    let help = |dictionary: &Dictionary| Ok(certify(source, dictionary)?);
    let learner = Learner { recipe, measured: setting.measured(), watch, help: &help };
    let shapes = Learnt::new(source, recipe, kept_bytes)?;
    // Codes go also where learning failed.
    let (learnt, cleared) = (learner.learn(&shapes), shapes.clear());
    let learnt = learnt?;
    cleared?;
    let (content, digest) = text(&learnt.dictionary.content)?;
    let cohort = &source.revision().manifest().cohort;
    Ok(File {
        format: FORMAT,
        format_version: learnt.dictionary.content.format_version(),
        name,
        digest,
        provenance: Provenance {
            cohort: cohort.id.clone(),
            cohort_name: cohort.name.clone(),
            cohort_revision: cohort.revision,
            filter: serde_json::Map::new(),
            shapes_digest: source.shapes_digest()?,
            program: format!("shapelex-engine {}", env!("CARGO_PKG_VERSION")),
        },
        content,
    })
}

/// The shapes that a dictionary is learnt from, and who codes them.
struct Learnt<'a> {
    source: &'a AtRest<'a>,
    recipe: &'a Recipe,
    /// Whether groups of shapes are coded where the sums of the source are.
    elsewhere: bool,
    /// Name that no other process uses.
    run: String,
    /// Folder of the codes of all dictionaries that are being learnt from the revision.
    folder: Path,
}

impl<'a> Learnt<'a> {
    fn new(source: &'a AtRest<'a>, recipe: &'a Recipe, kept_bytes: usize) -> Result<Self, EngineError> {
        let bytes = 8 * source.revision().width() * source.count();
        let elsewhere = source.has_runner() && recipe.method.is_sparse() && bytes > kept_bytes;
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let run = format!("{:x}-{}", since.as_nanos(), std::process::id());
        let cohort = &source.revision().manifest().cohort;
        let folder = learning_folder(&cohort.id, cohort.revision)?;
        Ok(Self { source, recipe, elsewhere, run, folder })
    }

    fn code(&self, group: Group<'_>) -> Result<Vec<u8>, EngineError> {
        let learn = Learn::new(&self.recipe.method, group, &self.run);
        let old = learn.remove_old(self.source.revision().objects(), &self.folder);
        self.source.wait(old)?;
        self.source.run(None, self.source.setting().clone(), &Work::Learn(Box::new(learn)))
    }

    /// Removes what was kept of codes.
    fn clear(&self) -> Result<(), EngineError> {
        if !self.elsewhere {
            return Ok(());
        }
        let run = self.folder.clone().join(self.run.as_str());
        self.source.wait(self.source.revision().objects().remove_all(&run))
    }
}

impl ShapeSource for Learnt<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.source.for_each_batch(visit)
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.source.for_each_marked(visit)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        self.source.spread(pass, merge)
    }

    fn coders(&self) -> Option<CodeGroup<'_>> {
        self.elsewhere.then(|| Box::new(|group: Group<'_>| Ok(self.code(group)?)) as CodeGroup<'_>)
    }
}

/// How well a dictionary describes each shape, computed where the sums of the source are; `None` if that is here.
fn certify(source: &AtRest<'_>, dictionary: &Dictionary) -> Result<Option<Coded>, EngineError> {
    if !source.has_runner() {
        return Ok(None);
    }
    let revision = source.revision();
    let (named, setting) = Named::new(revision, dictionary.content.clone())?;
    let work = Work::Certify(named.digest.clone());
    source.wait(named.keep(revision.objects(), &revision.manifest().cohort.id))?;
    let mut coded = Coded::default();
    coded.append(&source.run(Some(Arc::new(named)), Arc::new(setting), &work)?)?;
    Ok(Some(coded))
}
