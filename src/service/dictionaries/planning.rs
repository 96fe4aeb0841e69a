//! Planning, submission, listing and deletion of dictionaries.
//!
//! A request is checked and its cost predicted before a job is stored. Learning starts from scratch, or continues from
//! the sums of an earlier version.

use crate::wire::fault::Fault;
use crate::wire::json;
use std::sync::Arc;

use super::class_labels::{self, settings_faults};
use super::plan::{NO_STATE, Plan};
use super::ready::{self, Ready};
use crate::analysis::accumulate::KEPT_BYTES;
use crate::analysis::alignment::{Alignment, MIN_SHAPES};
use crate::analysis::classification::study::WITHIN;
use crate::analysis::classifier_record::ClassifierSettings;
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::method::Method;
use crate::analysis::dictionary::procedure::ParameterFault;
use crate::analysis::dictionary::recipe::Recipe;
use crate::analysis::estimate::{Estimate, Trainings};
use crate::analysis::frame::Frame;
use crate::analysis::robust;
use crate::analysis::transformation::Transformation;
use crate::domain::access::Principal;
use crate::domain::cohort::{Cohort, name_problem};
use crate::domain::dictionary::Listed;
use crate::domain::filter::ShapeFilter;
use crate::domain::id;
use crate::domain::job::{Job, JobKind};
use crate::service::app::error::parameter_fault;
use crate::service::app::{App, Limits, Page, ServiceError};
use crate::service::cohorts::attributes::{FilterPlace, refuse_unknown};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::caveats;
use crate::service::cohorts::measures;
use crate::service::cost::requests;
use crate::service::jobs;
use crate::service::statistics::Setup;
use crate::store::{DictionaryFilter, Revisions};

/// Request to learn a dictionary.
#[derive(Debug, Clone)]
pub struct Learn {
    /// Name of the dictionary; an existing name gets a new version.
    pub name: String,
    /// Id or name of the cohort.
    pub cohort: String,
    /// Start of learning: from scratch, or from a version.
    pub from: From,
    /// Whether nothing is learnt if the newest version of the name has the same shapes and parameters.
    pub only_if_changed: bool,
}

/// Start of learning.
#[derive(Debug, Clone)]
pub enum From {
    /// From scratch, with all parameters.
    Anew {
        /// Filter that selects the shapes.
        filter: Box<ShapeFilter>,
        /// Transformations removed before comparison.
        transformation: Transformation,
        /// Projection on the class, or Procrustes fits. Default: [`Alignment::usual`].
        alignment: Option<Alignment>,
        /// Frame: selects the representative of the mean space that is the mean shape.
        frame: Frame,
        /// Whether mirror images may be matched. Default: the rule of the cohort.
        mirror: Option<Mirror>,
        /// Components or sparse atoms.
        method: Method,
        /// Whether shapes unlike the majority are left out, or count less.
        robust: bool,
        /// Seed of the choice of the shapes that are held out.
        held_out_seed: u64,
        /// Whether the client says that the parameters of surfaces correspond.
        corresponding: bool,
        /// Settings of the classifier, if one is wanted.
        classifier: Option<Box<ClassifierSettings>>,
    },
    /// From the parameters, the mean and the sums of the version with this key, with the shapes added since.
    Version(String),
}

/// A plan that is ready to run, with its cost.
#[derive(Debug)]
pub struct Planned {
    /// The plan.
    pub plan: Plan,
    /// Predicted cost.
    pub estimate: Estimate,
}

/// Decision about a request.
#[derive(Debug)]
pub enum Decision {
    /// A dictionary is to be learnt.
    Learn(Box<Planned>),
    /// The newest version of the name would be learnt again.
    Unchanged(Arc<Ready>),
}

/// Checks a request as far as possible before it runs, and plans it.
///
/// # Errors
/// All faults of the request; too few shapes; a cohort or version that does not exist.
pub async fn decide(app: &App, learn: Learn) -> Result<Decision, ServiceError> {
    let mut faults: Vec<Fault> = Vec::new();
    if let Some(problem) = name_problem(&learn.name, id::DICTIONARY) {
        faults.push(Fault::new("/name", problem));
    }
    if let From::Anew { method, classifier, robust, .. } = &learn.from {
        faults.extend(method_faults(method, &app.limits));
        if *robust && classifier.is_some() {
            let detail = "expected no robust estimate with a classifier, got both: a class unlike the others would be \
                          left out";
            faults.push(Fault::new("/robust", detail));
        }
        if let Some(classifier) = classifier {
            faults.extend(settings_faults(classifier, method));
        }
    }
    ServiceError::unless_empty(faults)?;
    let cohort = catalogue::find(app, &learn.cohort).await.map_err(|error| error.named_at("/cohort"))?;
    check_name_is_open(app, &learn.name).await?;
    let only_if_changed = learn.only_if_changed;
    let (plan, since) = started(app, learn, &cohort).await?;
    measures::complete_for(app, &cohort, &plan.filter).await?;
    if only_if_changed && let Some(ready) = unchanged(app, &cohort, &plan).await? {
        return Ok(Decision::Unchanged(ready));
    }
    let revisions = Revisions { after: since, until: plan.revision };
    let shapes = app.store.count(&cohort.id, revisions, &plan.filter).await?;
    if shapes == 0 && since == 0 {
        refuse_unknown(app, &cohort, &plan.filter, FilterPlace::Body("/filter")).await?;
    }
    check_count(&plan, since, shapes)?;
    check_correspondence(app, &cohort, &plan).await?;
    if let Some(classifier) = &plan.classifier {
        check_classifier(app, &cohort, &plan, classifier, shapes).await?;
    }
    let (task_app, work) = (app.clone(), requests::space(&cohort.spec.representation, &app.limits));
    let estimated = move || {
        let estimate = estimate(&task_app, &plan, &cohort, shapes)?;
        Ok(Decision::Learn(Box::new(Planned { plan, estimate })))
    };
    app.pool.weighing(work).run(estimated).await
}

/// The newest version of the name of a plan, if it was learnt from the same shapes with the same parameters. A shape that was corrected, or
/// erased, is not the same any more.
async fn unchanged(app: &App, cohort: &Cohort, plan: &Plan) -> Result<Option<Arc<Ready>>, ServiceError> {
    let Some(id) = app.store.find_dictionary_id(&plan.name).await? else { return Ok(None) };
    let ready = ready::find(app, &id).await?;
    let (content, provenance) = (&ready.dictionary().content, &ready.listed.provenance);
    let settings = content.classifier.as_ref().map(|record| &record.settings);
    let is_alike = provenance.cohort == plan.cohort
        && provenance.filter == plan.filter
        && Recipe::of(content) == plan.recipe(cohort)
        && settings == plan.classifier.as_ref();
    if !is_alike {
        return Ok(None);
    }
    let since = Revisions { after: provenance.cohort_revision, until: plan.revision };
    let seen = Revisions::until(provenance.cohort_revision);
    let changed = app.store.count(&cohort.id, since, &plan.filter).await?
        + app.store.count_deleted(&cohort.id, since, &plan.filter).await?;
    let found = app.store.count(&cohort.id, seen, &plan.filter).await?;
    Ok((changed == 0 && found == content.statistics.shapes as u64).then_some(ready))
}

/// Plan of a request, and the revision up to which an earlier version has seen the shapes.
async fn started(app: &App, learn: Learn, cohort: &Cohort) -> Result<(Plan, u64), ServiceError> {
    match learn.from {
        From::Anew {
            filter,
            transformation,
            alignment,
            frame,
            mirror,
            method,
            robust,
            held_out_seed,
            corresponding,
            classifier,
        } => {
            let usual = Alignment::usual(&transformation, cohort.spec.representation.dimension());
            let plan = Plan {
                name: learn.name,
                cohort: cohort.id.clone(),
                revision: cohort.revision,
                filter: *filter,
                transformation,
                alignment: alignment.unwrap_or(usual),
                frame,
                mirror: mirror.unwrap_or(cohort.spec.mirror),
                method,
                robust,
                held_out_seed,
                classifier: classifier.map(|settings| *settings),
                corresponding,
                continue_from: None,
            };
            Ok((plan, 0))
        }
        From::Version(key) => continued(app, learn.name, cohort, &key).await,
    }
}

/// Predicted cost of a plan for `shapes` shapes, within the limits of memory.
fn estimate(app: &App, plan: &Plan, cohort: &Cohort, shapes: u64) -> Result<Estimate, ServiceError> {
    let setup = Setup::of(app, plan.settings(cohort))?;
    plan.method.pose(&setup.method)?;
    let held_out = match plan.continue_from {
        Some(_) => 0,
        None => plan.held_out_trainings(&setup, usize::try_from(shapes).unwrap_or(usize::MAX)),
    };
    let validation = plan.classifier.as_ref().map_or(0, |settings| settings.trainings(WITHIN));
    let trainings = Trainings { held_out, validation };
    let estimate = Estimate::new(setup.measured(), &plan.method, shapes).with(trainings);
    let estimate = if plan.robust { estimate.robust(setup.measured()) } else { estimate };
    let bytes = 8.0 * shapes as f64 * setup.metric.len() as f64;
    if plan.classifier.is_some() && bytes > KEPT_BYTES as f64 {
        let detail = format!(
            "expected shapes that take at most {KEPT_BYTES} bytes in memory, got {bytes:.1e}: choose some with a \
             filter"
        );
        return Err(ServiceError::invalid("/classifier", detail));
    }
    let most = app.limits.job_bytes as f64;
    if estimate.memory_bytes > most {
        let detail = format!(
            "expected a job that takes at most {most:.1e} bytes of memory, got {:.1e} for {shapes} shapes: ask \
             for fewer atoms or control points",
            estimate.memory_bytes
        );
        return Err(ServiceError::invalid("/method", detail));
    }
    Ok(estimate)
}

/// Refuses a caller limited to certain cohorts a name that a dictionary of another cohort uses: requests for the name
/// would then return the new version.
async fn check_name_is_open(app: &App, name: &str) -> Result<(), ServiceError> {
    if app.principal.cohorts.is_none() {
        return Ok(());
    }
    let whole_tenant = app.store.of(Arc::new(Principal::system(&app.principal.tenant)));
    if whole_tenant.find_dictionary_id(name).await? == app.store.find_dictionary_id(name).await? {
        return Ok(());
    }
    let detail = format!("the name '{name}' belongs to a dictionary of another cohort: choose another name");
    Err(ServiceError::Forbidden(detail))
}

/// Checks that the shapes have classes that can be distinguished.
async fn check_classifier(
    app: &App,
    cohort: &Cohort,
    plan: &Plan,
    settings: &ClassifierSettings,
    shapes: u64,
) -> Result<(), ServiceError> {
    let attribute = &settings.attribute;
    let labels = class_labels::read(app, cohort, &plan.filter, attribute).await?;
    let length = cohort.spec.representation.size() * cohort.spec.representation.dimension();
    let faults = labels.faults(settings, &plan.method, length).into_iter();
    let mut faults: Vec<Fault> = faults.map(parameter_fault).collect();
    let fewest = settings.fewest_training(usize::try_from(shapes).unwrap_or(usize::MAX));
    let atoms = plan.method.needed_shapes();
    if atoms > fewest {
        let detail = format!(
            "expected at most {fewest} atoms (one per training shape of the validation), got {atoms}"
        );
        faults.push(Fault::new("/method/atoms", detail));
    }
    ServiceError::unless_empty(faults)
}

/// Plan that continues a version, and the revision up to which that version has seen the shapes.
async fn continued(app: &App, name: String, cohort: &Cohort, key: &str) -> Result<(Plan, u64), ServiceError> {
    let at = |detail: String| ServiceError::invalid("/continue_from", detail);
    let ready = ready::find(app, key).await.map_err(|error| error.named_at("/continue_from"))?;
    let (content, provenance) = (&ready.dictionary().content, &ready.listed.provenance);
    if provenance.cohort != cohort.id {
        let from = &provenance.cohort_name;
        return Err(at(format!(
            "expected a dictionary learnt from the cohort '{}', got one from '{from}'",
            cohort.spec.name
        )));
    }
    let spec = &cohort.spec;
    if (content.correspondence, content.direction) != (spec.correspondence, spec.direction) {
        let detail = "the correspondence or direction of the cohort has changed since: learn again from the whole cohort";
        return Err(at(detail.into()));
    }
    if app.store.read_dictionary_state(&ready.listed.id).await?.is_none() {
        return Err(at(NO_STATE.into()));
    }
    if content.robust.is_some() {
        let detail = "the version is robust, and what it leaves out depends on all shapes: learn again from the whole cohort";
        return Err(at(detail.into()));
    }
    if content.classifier.is_some() {
        let detail = "the version has a classifier, whose validation needs all shapes: learn again from the whole cohort";
        return Err(at(detail.into()));
    }
    let since = provenance.cohort_revision;
    let revisions = Revisions { after: since, until: cohort.revision };
    let deleted = app.store.count_deleted(&cohort.id, revisions, &provenance.filter).await?;
    // Erased shapes are in no revision any more.
    let found = app.store.count(&cohort.id, Revisions::until(since), &provenance.filter).await?;
    let gone = deleted + (content.statistics.shapes as u64).saturating_sub(found);
    if gone > 0 {
        let detail = format!(
            "{gone} of the shapes that the version was learnt from were deleted, corrected or erased, and sums \
             cannot forget them: learn again from the whole cohort"
        );
        return Err(at(detail));
    }
    let plan = Plan {
        name,
        cohort: cohort.id.clone(),
        revision: cohort.revision,
        filter: provenance.filter.clone(),
        transformation: content.transformation.clone(),
        alignment: content.alignment,
        frame: content.frame,
        mirror: content.mirror,
        method: content.method.clone(),
        robust: false,
        held_out_seed: Recipe::of(content).held_out_seed,
        classifier: None,
        corresponding: false,
        continue_from: Some(ready.listed.id.clone()),
    };
    Ok((plan, since))
}

/// Refuses surfaces that came as meshes, unless the client says that their parameters correspond.
async fn check_correspondence(app: &App, cohort: &Cohort, plan: &Plan) -> Result<(), ServiceError> {
    if plan.corresponding || plan.continue_from.is_some() {
        return Ok(());
    }
    match caveats::refusal(app, cohort, &plan.filter).await? {
        Some(detail) => Err(ServiceError::invalid("/corresponding", detail)),
        None => Ok(()),
    }
}

fn check_count(plan: &Plan, since: u64, shapes: u64) -> Result<(), ServiceError> {
    let found = usize::try_from(shapes).unwrap_or(usize::MAX);
    if since > 0 {
        // The sums exist already: one new shape is enough.
        return if found > 0 { Ok(()) } else { Err(ServiceError::TooFewShapes { found, needed: 1 }) };
    }
    let needed = if plan.robust { robust::MIN_SHAPES } else { MIN_SHAPES };
    if found < needed {
        if plan.filter != ShapeFilter::default() {
            let detail = format!("expected a filter that selects at least {needed} shapes, got {found}");
            return Err(ServiceError::invalid("/filter", detail));
        }
        return Err(ServiceError::TooFewShapes { found, needed });
    }
    let atoms = plan.method.needed_shapes();
    if atoms > found {
        let detail = format!("expected at most {found} atoms (one per training shape), got {atoms}");
        return Err(ServiceError::invalid("/method/atoms", detail));
    }
    Ok(())
}

/// Faults of the parameters that do not depend on the shapes.
pub(crate) fn method_faults(method: &Method, limits: &Limits) -> Vec<Fault> {
    let fault = |fault: ParameterFault| Fault::new(format!("/method/{}", fault.field), fault.detail);
    method.faults(limits.atoms).into_iter().map(fault).collect()
}

/// Submits the job that carries out a plan.
///
/// # Errors
/// [`ServiceError::Unavailable`] if too many jobs wait.
pub async fn submit(app: &App, plan: Plan, estimate: &Estimate) -> Result<Job, ServiceError> {
    let parameters = json::to_value(&plan)
        .map_err(|error| ServiceError::Internal(format!("a plan is not JSON: {error}")))?;
    jobs::submit(app, JobKind::LearnDictionary, parameters, estimate.seconds).await
}

/// Versions in order of creation, after `cursor` (the id of the last version of the previous page).
///
/// # Errors
/// An invalid cursor; a failure of the store.
pub async fn list(
    app: &App,
    name: Option<String>,
    cohort: Option<&str>,
    cursor: Option<&str>,
    limit: usize,
) -> Result<Page<Listed>, ServiceError> {
    if cursor.is_some_and(|cursor| !cursor.starts_with(&format!("{}_", id::DICTIONARY))) {
        return Err(ServiceError::foreign_cursor());
    }
    let cohort = match cohort {
        // Dictionaries outlive their cohort: its id still finds them.
        Some(key) => {
            Some(app.store.find_cohort(key).await?.map_or_else(|| key.to_owned(), |cohort| cohort.id))
        }
        None => None,
    };
    let filter = DictionaryFilter { name, cohort };
    let mut items = app.store.list_dictionaries(&filter, cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// Moves a version, or all versions of a name, to the trash.
///
/// # Errors
/// [`ServiceError::NotFound`]; [`ServiceError::VersionInUse`] if an alias names one of them: none is deleted then.
pub async fn delete(app: &App, key: &str) -> Result<(), ServiceError> {
    let not_found = || ServiceError::NotFound { kind: "dictionary", key: key.into() };
    let filter = DictionaryFilter { name: Some(key.into()), cohort: None };
    let mut ids: Vec<String> = Vec::new();
    loop {
        let page = app.store.list_dictionaries(&filter, ids.last().map(String::as_str), PAGE).await?;
        let full = page.len() == PAGE;
        ids.extend(page.into_iter().map(|listed| listed.id));
        if !full {
            break;
        }
    }
    if ids.is_empty() {
        ids.push(app.store.find_dictionary_id(key).await?.ok_or_else(not_found)?);
    }
    let named = app.store.list_aliases(key, None).await?;
    if let Some(alias) = named.iter().find(|alias| ids.contains(&alias.id)) {
        let aliases = named.iter().map(|alias| format!("{}@{}", alias.name, alias.alias)).collect();
        return Err(ServiceError::VersionInUse { id: alias.id.clone(), aliases });
    }
    let mut deleted = false;
    for id in &ids {
        app.touched.note("dictionary_id", id);
        deleted |= app.store.trash_dictionary(id, app.clock().stamp_ms()).await?;
        app.cache.forget(id);
    }
    if deleted { Ok(()) } else { Err(not_found()) }
}

/// Number of versions listed at a time.
const PAGE: usize = 1000;
