//! Cohorts and their shapes: create, find, list, update, delete.
//!
//! A cohort is found by id or name. Changes can be made conditional on its revision; deleted cohorts go to the trash.

use super::attributes::refuse_misspelt;
use super::{measures, rules};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::domain::attribute::Attribute;
use crate::domain::cohort::{Cohort, CohortSpec, name_problem};
use crate::domain::filter::ShapeFilter;
use crate::domain::id;
use crate::domain::shape::Shape;
use crate::service::app::faults::Faults;
use crate::service::app::{App, Page, ServiceError, now_ms};
use crate::service::shapes::read;
use crate::store::{ListCursor, Listing, Order, Revisions};
use crate::wire::fault::Fault;
use crate::wire::lengths::unit_of;
use crate::wire::unit::Unit;

/// Maximum length of a description.
const MAX_DESCRIPTION_CHARS: usize = 10_000;

/// Faults of the texts of a cohort; absent texts are not checked.
pub fn text_faults(name: Option<&str>, description: Option<&str>, length_unit: Option<&str>) -> Vec<Fault> {
    let mut faults = Vec::new();
    if let Some(problem) = name.and_then(|name| name_problem(name, id::COHORT)) {
        faults.push(Fault::new("/name", problem));
    }
    if description.is_some_and(|text| text.chars().count() > MAX_DESCRIPTION_CHARS) {
        faults
            .push(Fault::new("/description", format!("expected at most {MAX_DESCRIPTION_CHARS} characters")));
    }
    if description.is_some_and(|text| text.contains('\0')) {
        faults.push(Fault::new("/description", "expected text without the character U+0000"));
    }
    if let Some(Err(detail)) = length_unit.map(unit_of) {
        faults.push(Fault::new("/length_unit", detail));
    }
    faults
}

/// The word of the unit that a text names; a text that names none stays.
pub fn word_of_unit(text: Option<String>) -> Option<String> {
    text.map(|text| Unit::find(&text).map_or(text, |unit| unit.word().into()))
}

/// Creates a cohort.
///
/// # Errors
/// All invalid fields; a name that is taken; [`ServiceError::Forbidden`] for keys limited to certain cohorts.
pub async fn create(app: &App, mut spec: CohortSpec) -> Result<Cohort, ServiceError> {
    app.check_unlimited("creating a cohort")?;
    let texts = text_faults(Some(&spec.name), spec.description.as_deref(), spec.length_unit.as_deref());
    let mut faults = Faults::from(texts);
    faults.keep_below("/representation", read::admit_linear(spec.representation.clone(), &app.limits));
    faults.keep(read::check_correspondence(&spec.representation, spec.correspondence))?;
    faults.keep(read::check_mirror(&spec.representation, spec.mirror))?;
    faults.unless_any()?;
    if let Some(id) = app.done_before::<String>().await? {
        return find(app, &id).await;
    }
    spec.length_unit = word_of_unit(spec.length_unit);
    let now = now_ms();
    let cohort = Cohort {
        id: id::new_id(id::COHORT),
        spec,
        revision: 0,
        shapes: 0,
        created_at_ms: now,
        updated_at_ms: now,
        former_rules: Vec::new(),
    };
    app.store.create_cohort(&cohort, app.receipt(&cohort.id).as_ref()).await?;
    Ok(cohort)
}

/// Finds the cohort with this id or name.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, key: &str) -> Result<Cohort, ServiceError> {
    let found = app.store.find_cohort(key).await?;
    let cohort = found.ok_or_else(|| ServiceError::NotFound { kind: "cohort", key: key.into() })?;
    app.touched.note("cohort_id", &cohort.id);
    Ok(cohort)
}

/// Changes to a cohort; fields that are `None` stay as they are.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CohortChanges {
    /// New name.
    pub name: Option<String>,
    /// New description, or `Some(None)` to remove it.
    pub description: Option<Option<String>>,
    /// New unit, or `Some(None)` to remove it.
    pub length_unit: Option<Option<String>>,
    /// New correspondence.
    pub correspondence: Option<Correspondence>,
    /// New treatment of contour direction.
    pub direction: Option<Direction>,
    /// New treatment of mirror images.
    pub mirror: Option<Mirror>,
}

/// Rule by which shapes of a cohort are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rule {
    pub(super) correspondence: Correspondence,
    pub(super) direction: Direction,
    pub(super) mirror: Mirror,
}

impl Rule {
    pub(super) fn of(spec: &CohortSpec) -> Self {
        Self { correspondence: spec.correspondence, direction: spec.direction, mirror: spec.mirror }
    }
}

/// Updates name, description, unit or rule of a cohort, provided that it is at the `expected` revision, if given.
///
/// # Errors
/// [`ServiceError::NotFound`]; invalid fields; a name that is taken; [`ServiceError::Changed`]; of another rule those of
/// `rules::change`.
pub async fn update(
    app: &App,
    key: &str,
    changes: CohortChanges,
    expected: Option<Expected>,
) -> Result<Cohort, ServiceError> {
    let mut cohort = find_as_expected(app, key, expected.as_ref()).await?;
    let CohortChanges { name, description, length_unit, correspondence, direction, mirror } = changes;
    let former = cohort.spec.clone();
    let spec = &mut cohort.spec;
    spec.correspondence = correspondence.unwrap_or(spec.correspondence);
    spec.direction = direction.unwrap_or(spec.direction);
    spec.mirror = mirror.unwrap_or(spec.mirror);
    if let Some(name) = name {
        spec.name = name;
    }
    if let Some(description) = description {
        spec.description = description;
    }
    if let Some(unit) = length_unit {
        spec.length_unit = unit;
    }
    // Units stored by an earlier release stay.
    let unit = spec.length_unit.as_deref().filter(|_| spec.length_unit != former.length_unit);
    let mut faults = Faults::from(text_faults(Some(&spec.name), spec.description.as_deref(), unit));
    faults.keep(read::check_correspondence(&spec.representation, spec.correspondence))?;
    faults.keep(read::check_mirror(&spec.representation, spec.mirror))?;
    faults.unless_any()?;
    spec.length_unit = word_of_unit(spec.length_unit.take());
    if Rule::of(&former) != Rule::of(spec) {
        return rules::change(app, &former, cohort).await;
    }
    app.store.update_cohort(&cohort, now_ms()).await?;
    find(app, &cohort.id).await
}

/// Entity tags of which the current version must match one, or `*`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Expected(pub Vec<String>);

impl Expected {
    /// Checks that the current version is expected.
    ///
    /// # Errors
    /// [`ServiceError::Changed`].
    pub fn check(&self, tag: &str) -> Result<(), ServiceError> {
        if self.0.iter().any(|known| known == "*" || known == tag) {
            return Ok(());
        }
        Err(ServiceError::Changed(format!("the current version is {tag}: read it again")))
    }
}

/// Entity tag of a cohort at its revision.
pub fn revision_tag(cohort: &Cohort) -> String {
    format!("\"{}-{}\"", cohort.id, cohort.revision)
}

/// The cohort with this id or name, at an expected version.
pub(super) async fn find_as_expected(
    app: &App,
    key: &str,
    expected: Option<&Expected>,
) -> Result<Cohort, ServiceError> {
    let cohort = find(app, key).await?;
    if let Some(expected) = expected {
        expected.check(&revision_tag(&cohort))?;
    }
    Ok(cohort)
}

/// Moves a cohort with all its shapes to the trash.
///
/// # Errors
/// [`ServiceError::NotFound`], [`ServiceError::Changed`].
pub async fn delete(app: &App, key: &str, expected: Option<Expected>) -> Result<(), ServiceError> {
    let cohort = find_as_expected(app, key, expected.as_ref()).await?;
    let revision = expected.map(|_| cohort.revision);
    if app.store.trash_cohort(&cohort.id, revision, app.clock().stamp_ms()).await? {
        app.cache.forget(&cohort.id);
        return Ok(());
    }
    Err(ServiceError::NotFound { kind: "cohort", key: key.into() })
}

/// Cohorts in order of creation, after `cursor` (the id of the last cohort of the previous page).
///
/// # Errors
/// An invalid cursor; a failure of the store.
pub async fn list(app: &App, cursor: Option<&str>, limit: usize) -> Result<Page<Cohort>, ServiceError> {
    if cursor.is_some_and(|cursor| !cursor.starts_with(&format!("{}_", id::COHORT))) {
        return Err(ServiceError::foreign_cursor());
    }
    let mut items = app.store.list_cohorts(cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// Content of a page of shapes.
#[derive(Debug)]
pub struct ShapeListing {
    /// Revision of the cohort. Default: the latest one, of each page.
    pub revision: Option<u64>,
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Order of the list. Default: that of insertion.
    pub order: Option<Order>,
    /// Where the page starts.
    pub cursor: Option<String>,
    /// Maximum number of shapes.
    pub limit: usize,
    /// Whether weights and control points are wanted.
    pub geometry: bool,
    /// Whether all shapes that pass the filter are counted.
    pub total: bool,
}

/// A page of shapes, and how many there are in all, if asked for.
#[derive(Debug)]
pub struct ShapesFound {
    /// Shapes of the page, and the cursor of the next one.
    pub page: Page<Shape>,
    /// Number of shapes that pass the filter.
    pub total: Option<u64>,
}

/// Shapes of a cohort.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort; an invalid cursor; an attribute that no shape has.
pub async fn list_shapes(
    app: &App,
    key: &str,
    listing: &ShapeListing,
) -> Result<(Cohort, ShapesFound), ServiceError> {
    let cohort = find(app, key).await?;
    let ShapeListing { revision, filter, order, cursor, limit, geometry, total } = listing;
    let revisions = revision.map_or_else(Revisions::latest, Revisions::until);
    let after: Option<ListCursor> =
        cursor.as_deref().map(str::parse).transpose().map_err(|_| ServiceError::foreign_cursor())?;
    if after.as_ref().is_some_and(|after| after.key.is_some() != order.is_some()) {
        return Err(ServiceError::foreign_cursor());
    }
    let limit = if *geometry { (*limit).min(most_of_a_page(&cohort)) } else { *limit };
    let is_first = after.is_none();
    let by_measure = order.as_ref().is_some_and(|order| matches!(order.attribute, Attribute::Measure(_)));
    if by_measure {
        measures::complete(app, &cohort).await?;
    }
    measures::complete_for(app, &cohort, filter).await?;
    let wanted = Listing { revisions, filter, order: order.as_ref(), after, limit, geometry: *geometry };
    let page = app.store.list_shapes(&cohort.id, &wanted).await?;
    let order_attribute = order.as_ref().map(|order| order.attribute.clone());
    if is_first {
        refuse_misspelt(app, &cohort, filter, order_attribute, page.shapes.is_empty()).await?;
    }
    let total = match total {
        true => Some(app.store.count(&cohort.id, Revisions::until(cohort.revision), filter).await?),
        false => None,
    };
    let next = page.next.map(|cursor| cursor.to_string());
    Ok((cohort, ShapesFound { page: (page.shapes, next), total }))
}

/// Maximum size of the control points of a page as text.
const PAGE_BYTES: usize = 8 << 20;
/// Size of a number as text.
const NUMBER_BYTES: usize = 20;

/// Maximum number of shapes on a page.
fn most_of_a_page(cohort: &Cohort) -> usize {
    let representation = &cohort.spec.representation;
    let numbers = representation.size() * representation.dimension();
    (PAGE_BYTES / (NUMBER_BYTES * numbers.max(1))).max(1)
}

/// Finds a shape of a cohort by id or external id.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort or the shape.
pub async fn find_shape(app: &App, key: &str, shape: &str) -> Result<(Cohort, Shape), ServiceError> {
    let cohort = find(app, key).await?;
    let found = app.store.find_shape(&cohort.id, shape).await?;
    let shape = found.ok_or_else(|| ServiceError::NotFound { kind: "shape", key: shape.into() })?;
    app.touched.note("shape_id", &shape.id);
    Ok((cohort, shape))
}

/// Deletes a shape.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort or the shape.
pub async fn delete_shape(app: &App, key: &str, shape: &str) -> Result<(), ServiceError> {
    let (cohort, found) = find_shape(app, key, shape).await?;
    let deleted = app.store.delete_shape(&cohort.id, &found.id, now_ms()).await?;
    deleted.map(|_| ()).ok_or_else(|| ServiceError::NotFound { kind: "shape", key: shape.into() })
}
