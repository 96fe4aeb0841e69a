//! Corrections of many shapes: the same changes of all that a filter or a list names, or changes of each by its id. All become one
//! revision of the cohort, or none does.

use std::collections::HashSet;
use std::sync::Arc;

use serde_json::{Map, Value};

use super::attribute_names;
use super::attributes::{FilterPlace, refuse_unknown};
use super::catalogue::{Expected, find_as_expected};
use super::corrections::{ATTEMPTS, checked_members, patched};
use super::measures;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{Shape, ShapeAttributes};
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError, Work, now_ms};
use crate::service::shapes::outcome::OnError;
use crate::store::{Listing, Revisions};
use crate::wire::fault::Fault;
use crate::wire::merge_patch::{MergePatch, PatchText};

/// Number of shapes that are read at once.
const PAGE: usize = 1000;
/// Copies of control points: as read, changed, encoded, and on their way to the database.
const COPIES: usize = 4;
/// Memory of the attributes of a shape beside their texts, about.
const ATTRIBUTES: usize = 2048;
/// Predicted time of patching the attributes of a shape.
const SECONDS: f64 = 3e-5;

/// Changes of many shapes.
#[derive(Debug)]
pub struct Bulk {
    /// Which shapes are changed, and how.
    pub edits: Edits,
    /// Treatment of edits that cannot be made.
    pub on_error: OnError,
    /// Whether nothing is stored.
    pub dry_run: bool,
}

/// Which shapes are changed, and how.
#[derive(Debug)]
pub enum Edits {
    /// The same changes of all shapes that pass a filter.
    Filter(Box<ShapeFilter>, MergePatch),
    /// The same changes of the shapes with these ids, or external ids.
    Ids(Vec<String>, MergePatch),
    /// Changes of one shape each.
    Each(Vec<Edit>),
}

/// Changes of a shape.
#[derive(Debug)]
pub struct Edit {
    /// Its id, or its external id.
    pub key: String,
    /// The changes.
    pub patch: PatchText,
    /// Line of the table that says them.
    pub line: Option<u64>,
}

/// An edit that was not made.
#[derive(Debug, Clone)]
pub struct Failed {
    /// Position among the edits, or among the shapes that pass the filter.
    pub index: usize,
    /// Id or external id of the shape.
    pub key: String,
    /// Why.
    pub faults: Vec<Fault>,
}

/// Outcome of many edits.
#[derive(Debug, Default)]
pub struct Corrected {
    /// Number of shapes that were changed, or would be.
    pub updated: usize,
    /// Number of shapes that are as the changes ask for already.
    pub unchanged: usize,
    /// Edits that were not made, under [`OnError::Skip`].
    pub failed: Vec<Failed>,
    /// Revision of the cohort after that.
    pub revision: u64,
}

/// An edit that has been checked as far as it can be without the shape.
struct Checked {
    index: usize,
    key: String,
    members: Arc<Map<String, Value>>,
    pointer: String,
    line: Option<u64>,
}

/// A shape with the edit of it.
type Chosen = (Checked, Shape);

impl Checked {
    fn failed(&self, faults: Vec<Fault>) -> Failed {
        let placed = |fault: Fault| {
            let pointer = format!("{}{}", self.pointer, fault.pointer);
            Fault { pointer, line: self.line, index: Some(self.index), ..fault }
        };
        let faults = faults.into_iter().map(placed).collect();
        Failed { index: self.index, key: self.key.clone(), faults }
    }
}

/// Changes attributes of many shapes by merge patches, as one revision of the cohort, which must be at an expected version. Without a
/// difference nothing is stored.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort; under [`OnError::Abort`] the faults of all edits; more shapes or memory than a request may
/// have; more names of attributes than a cohort may have; [`ServiceError::Changed`].
pub async fn correct_all(
    app: &App,
    key: &str,
    bulk: Bulk,
    expected: Option<Expected>,
) -> Result<Corrected, ServiceError> {
    let Bulk { edits, on_error, dry_run } = bulk;
    let limits = app.limits;
    let plan = Plan::new(edits, on_error, &limits)?;
    for _ in 0..ATTEMPTS {
        let cohort = find_as_expected(app, key, expected.as_ref()).await?;
        let mut room = app.memory.hold(Purpose::Bodies, 0)?;
        let (chosen, mut failed) = plan.choose(app, &cohort, &mut room).await?;
        let work = Work::from_seconds(chosen.len() as f64 * SECONDS);
        let patch = move || Ok(patch_all(&limits, chosen));
        let (changed, unchanged, more) = app.pool.weighing(work).run(patch).await?;
        failed.extend(more);
        failed.extend(plan.failed.iter().cloned());
        failed.sort_by_key(|failed| failed.index);
        if on_error == OnError::Abort {
            ServiceError::unless_empty(failed.iter().flat_map(|failed| failed.faults.clone()).collect())?;
        }
        let mut corrected =
            Corrected { updated: changed.len(), unchanged, failed, revision: cohort.revision };
        if dry_run || changed.is_empty() {
            return Ok(corrected);
        }
        match store(app, &cohort, changed).await {
            Err(ServiceError::Changed(_)) if expected.is_none() => {}
            stored => {
                corrected.revision = stored?;
                app.touched.note("shapes", &corrected.updated.to_string());
                return Ok(corrected);
            }
        }
    }
    Err(ServiceError::Unavailable("the cohort is being changed by others: try again".into()))
}

async fn store(app: &App, cohort: &Cohort, changed: Vec<Shape>) -> Result<u64, ServiceError> {
    let brought = changed.iter().flat_map(|shape| shape.attributes.labels.keys().cloned()).collect();
    let names = attribute_names::admit(app, cohort, brought, "/labels").await?;
    Ok(app.store.correct_shapes(cohort, changed, names.as_ref(), now_ms()).await?)
}

/// An edit by an id: its position, the id, its changes and its line.
type ById = (usize, String, Changes, Option<u64>);

/// Checked changes.
#[derive(Clone)]
enum Changes {
    /// Members that are the same for all shapes.
    Shared(Arc<Map<String, Value>>),
    /// Those of one shape.
    Own(PatchText),
}

impl Changes {
    fn members(&self) -> Arc<Map<String, Value>> {
        match self {
            Self::Shared(members) => Arc::clone(members),
            Self::Own(text) => Arc::new(text.read().members),
        }
    }
}

/// The work, checked as far as it can be without the shapes.
struct Plan {
    filter: Option<(ShapeFilter, Arc<Map<String, Value>>)>,
    /// Edits by ids.
    edits: Vec<ById>,
    /// Where an edit stands in the request.
    list: &'static str,
    failed: Vec<Failed>,
}

impl Plan {
    fn new(edits: Edits, on_error: OnError, limits: &Limits) -> Result<Self, ServiceError> {
        let mut plan = Self { filter: None, edits: Vec::new(), list: "", failed: Vec::new() };
        match edits {
            Edits::Filter(filter, patch) => plan.filter = Some((*filter, shared(limits, patch)?)),
            Edits::Ids(ids, patch) => {
                let members = shared(limits, patch)?;
                plan.list = "/ids/";
                plan.edits = (0..)
                    .zip(ids)
                    .map(|(index, key)| (index, key, Changes::Shared(Arc::clone(&members)), None))
                    .collect();
            }
            Edits::Each(edits) => {
                plan.list = "/shapes/";
                plan.take_each(edits, limits);
            }
        }
        if plan.filter.is_none() && plan.edits.is_empty() && plan.failed.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        if on_error == OnError::Abort && plan.edits.is_empty() {
            ServiceError::unless_empty(
                plan.failed.iter().flat_map(|failed| failed.faults.clone()).collect(),
            )?;
        }
        Ok(plan)
    }

    fn take_each(&mut self, edits: Vec<Edit>, limits: &Limits) {
        for (index, Edit { key, patch, line }) in edits.into_iter().enumerate() {
            match checked(limits, patch.read()) {
                Ok(_) => self.edits.push((index, key, Changes::Own(patch), line)),
                Err(faults) => {
                    let edit = self.edit(index, key, Arc::default(), line);
                    self.failed.push(edit.failed(faults));
                }
            }
        }
    }

    fn edit(
        &self,
        index: usize,
        key: String,
        members: Arc<Map<String, Value>>,
        line: Option<u64>,
    ) -> Checked {
        let pointer = match (line, self.list) {
            (None, list) if !list.is_empty() => format!("{list}{index}"),
            _ => String::new(),
        };
        Checked { index, key, members, pointer, line }
    }

    /// The shapes that are changed, and edits of shapes that do not exist.
    async fn choose(
        &self,
        app: &App,
        cohort: &Cohort,
        room: &mut Held,
    ) -> Result<(Vec<Chosen>, Vec<Failed>), ServiceError> {
        match &self.filter {
            Some((filter, members)) => {
                let shapes = selected(app, cohort, filter, room).await?;
                let edit = |(index, shape): (usize, Shape)| {
                    (self.edit(index, shape.id.clone(), Arc::clone(members), None), shape)
                };
                Ok((shapes.into_iter().enumerate().map(edit).collect(), Vec::new()))
            }
            None => self.named(app, cohort, room).await,
        }
    }

    async fn named(
        &self,
        app: &App,
        cohort: &Cohort,
        room: &mut Held,
    ) -> Result<(Vec<Chosen>, Vec<Failed>), ServiceError> {
        let (mut chosen, mut failed, mut seen, mut held) = (Vec::new(), Vec::new(), HashSet::new(), 0);
        for page in self.edits.chunks(PAGE) {
            let keys: Vec<String> = page.iter().map(|(_, key, ..)| key.clone()).collect();
            held += keys.len() * bytes_of(cohort, 0);
            room.resize(held)?;
            let found = app.store.find_shapes(&cohort.id, &keys).await?;
            for ((index, key, changes, line), shape) in page.iter().zip(found) {
                let edit = self.edit(*index, key.clone(), changes.members(), *line);
                let wrong = match shape {
                    Some(shape) if seen.insert(shape.id.clone()) => {
                        held += shape.attributes.metadata.as_ref().map_or(0, String::len) * COPIES;
                        chosen.push((edit, shape));
                        continue;
                    }
                    Some(_) => format!("expected each shape once, got '{key}' again"),
                    None => format!("expected the id or external id of a shape of the cohort, got '{key}'"),
                };
                failed.push(edit.failed(vec![Fault::new("", wrong)]));
            }
            room.resize(held)?;
        }
        Ok((chosen, failed))
    }
}

/// Bytes of memory for a shape of the cohort with metadata of a size.
fn bytes_of(cohort: &Cohort, metadata: usize) -> usize {
    let representation = &cohort.spec.representation;
    let width = representation.size() * representation.dimension();
    COPIES * (width * size_of::<f64>() + metadata) + ATTRIBUTES
}

/// The shapes that pass a filter.
async fn selected(
    app: &App,
    cohort: &Cohort,
    filter: &ShapeFilter,
    room: &mut Held,
) -> Result<Vec<Shape>, ServiceError> {
    refuse_unknown(app, cohort, filter, FilterPlace::Body("/filter")).await?;
    measures::complete_for(app, cohort, filter).await?;
    let (revisions, most) = (Revisions::until(cohort.revision), app.limits.shapes);
    let count = app.store.count(&cohort.id, revisions, filter).await?;
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    if count > most {
        let detail = format!("expected a filter that selects at most {most} shapes, got {count}");
        return Err(ServiceError::invalid("/filter", detail));
    }
    let mut held = count.saturating_mul(bytes_of(cohort, 0));
    room.resize(held)?;
    let (mut shapes, mut after) = (Vec::new(), None);
    loop {
        let listing = Listing { revisions, filter, order: None, after, limit: PAGE, geometry: true };
        let page = app.store.list_shapes(&cohort.id, &listing).await?;
        let metadata = page.shapes.iter().filter_map(|shape| shape.attributes.metadata.as_ref());
        held += metadata.map(String::len).sum::<usize>() * COPIES;
        room.resize(held)?;
        shapes.extend(page.shapes);
        match page.next {
            Some(next) => after = Some(next),
            None => return Ok(shapes),
        }
    }
}

/// Members of changes that are the same for all shapes.
fn shared(limits: &Limits, patch: MergePatch) -> Result<Arc<Map<String, Value>>, ServiceError> {
    let below = |fault: Fault| Fault { pointer: format!("/changes{}", fault.pointer), ..fault };
    match checked(limits, patch) {
        Ok(members) => Ok(Arc::new(members)),
        Err(faults) => Err(ServiceError::Invalid(faults.into_iter().map(below).collect())),
    }
}

/// Members of changes, whose faults do not depend on the shape.
fn checked(limits: &Limits, patch: MergePatch) -> Result<Map<String, Value>, Vec<Fault>> {
    let members = checked_members(patch).map_err(faults_of)?;
    let blank = ShapeAttributes { weight: 1.0, ..ShapeAttributes::default() };
    patched(limits, &blank, &members).map_err(faults_of)?;
    Ok(members)
}

fn faults_of(error: ServiceError) -> Vec<Fault> {
    match error {
        ServiceError::Invalid(faults) => faults.into_listed(),
        ServiceError::Malformed(faults) => faults,
        other => vec![Fault::new("", other.to_string())],
    }
}

/// The shapes that differ with their changes, the number of those that do not, and edits whose result is not valid.
fn patch_all(limits: &Limits, chosen: Vec<Chosen>) -> (Vec<Shape>, usize, Vec<Failed>) {
    let (mut changed, mut unchanged, mut failed) = (Vec::new(), 0, Vec::new());
    for (edit, shape) in chosen {
        match patched(limits, &shape.attributes, &edit.members) {
            Ok(attributes) if attributes == shape.attributes => unchanged += 1,
            Ok(attributes) => changed.push(Shape { attributes, ..shape }),
            Err(error) => failed.push(edit.failed(faults_of(error))),
        }
    }
    (changed, unchanged, failed)
}
