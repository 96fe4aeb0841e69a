//! Attributes of the shapes of a cohort as columns, kept in memory and brought up to date by what has changed.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::domain::attribute::{Attribute, AttributeValue, Measure};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeDescription;
use crate::formats::fault::Fault;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::measures;
use crate::store::{Cursor, Revisions};

/// Number of shapes read at once.
const PAGE: usize = 8192;
/// Estimated memory of the attributes of a shape.
const BYTES_PER_SHAPE: usize = 400;

/// Value in a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Cell {
    /// The shape has no such attribute.
    Missing,
    /// A finite number.
    Number(f64),
    /// A Boolean.
    Flag(bool),
    /// Milliseconds since 1970 UTC.
    Time(i64),
    /// A text, by its number in the column.
    Text(u32),
}

/// One attribute of all shapes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Column {
    /// One entry per shape.
    pub(crate) cells: Vec<Cell>,
    /// Texts that occur, each once.
    pub(crate) texts: Vec<Arc<str>>,
    numbers: HashMap<Arc<str>, u32>,
}

impl Column {
    fn push(&mut self, value: Option<AttributeValue<'_>>) {
        let cell = match value {
            None => Cell::Missing,
            Some(AttributeValue::Number(number)) => Cell::Number(number),
            Some(AttributeValue::Flag(flag)) => Cell::Flag(flag),
            Some(AttributeValue::Time(ms)) => Cell::Time(ms),
            Some(AttributeValue::Text(text)) => Cell::Text(self.number_of(&text)),
        };
        self.cells.push(cell);
    }

    fn number_of(&mut self, text: &str) -> u32 {
        if let Some(&number) = self.numbers.get(text) {
            return number;
        }
        let (text, number) = (Arc::<str>::from(text), self.texts.len() as u32);
        self.texts.push(Arc::clone(&text));
        self.numbers.insert(text, number);
        number
    }

    /// The cells of these shapes.
    fn of_shapes(&self, shapes: &[usize]) -> Self {
        let cell = |&shape: &usize| self.cells.get(shape).copied().unwrap_or(Cell::Missing);
        Self { cells: shapes.iter().map(cell).collect(), ..self.clone() }
    }
}

/// Attributes of the shapes of a cohort at a revision, in storage order.
#[derive(Debug, Clone, Default)]
pub(crate) struct CohortColumns {
    revision: u64,
    places: Vec<Cursor>,
    ids: Column,
    columns: BTreeMap<Attribute, Column>,
}

impl Cached for CohortColumns {
    const NAME: &'static str = "columns";

    fn bytes(&self) -> usize {
        BYTES_PER_SHAPE * self.places.len()
    }
}

/// Attributes that have a column even if no shape has them.
fn usual_attributes() -> impl Iterator<Item = Attribute> {
    let own = [Attribute::ExternalId, Attribute::Label, Attribute::Subject, Attribute::CreatedAt];
    own.into_iter().chain(Measure::ALL.map(Attribute::Measure))
}

impl CohortColumns {
    /// Places of the shapes.
    pub(crate) fn places(&self) -> &[Cursor] {
        &self.places
    }

    /// Ids of the shapes.
    pub(crate) fn ids(&self) -> &Column {
        &self.ids
    }

    /// Column of an attribute, if there is one.
    pub(crate) fn column(&self, attribute: &Attribute) -> Option<&Column> {
        self.columns.get(attribute)
    }

    /// Attributes with their columns.
    pub(crate) fn columns(&self) -> &BTreeMap<Attribute, Column> {
        &self.columns
    }

    fn push(&mut self, place: Cursor, shape: &ShapeDescription) {
        let before = self.places.len();
        self.places.push(place);
        self.ids.push(Some(AttributeValue::Text(shape.id.as_str().into())));
        for attribute in usual_attributes() {
            let value = attribute.value(shape);
            self.columns.entry(attribute).or_default().push(value);
        }
        for name in shape.labels.keys() {
            let attribute = Attribute::Labels(name.clone());
            let value = attribute.value(shape);
            let column = self.columns.entry(attribute).or_default();
            column.cells.resize(before, Cell::Missing);
            column.push(value);
        }
    }

    /// Fills the columns of attributes that the last shapes lack.
    fn complete(&mut self) {
        let count = self.places.len();
        self.columns.values_mut().for_each(|column| column.cells.resize(count, Cell::Missing));
    }

    /// The columns of these shapes.
    fn of_shapes(&self, shapes: &[usize]) -> Self {
        let of_shapes = |column: &Column| column.of_shapes(shapes);
        Self {
            revision: self.revision,
            places: shapes.iter().map(|&shape| self.places[shape]).collect(),
            ids: of_shapes(&self.ids),
            columns: self.columns.iter().map(|(name, column)| (name.clone(), of_shapes(column))).collect(),
        }
    }

    /// Positions of the shapes at these places, in their order; places of other shapes are left out.
    fn positions(&self, places: impl Iterator<Item = Cursor>) -> Vec<usize> {
        let mut next = 0;
        let position = |place: Cursor| {
            next += self.places[next..].partition_point(|other| *other < place);
            (self.places.get(next) == Some(&place)).then_some(next)
        };
        places.filter_map(position).collect()
    }
}

/// Columns of a cohort at its revision. Cost: a pass over the attributes of the shapes that are new since the last call.
///
/// # Errors
/// [`ServiceError::TooLarge`] if the attributes do not fit in the memory of the cache; a failure of the store.
pub(crate) async fn of_cohort(app: &App, cohort: &Cohort) -> Result<Arc<CohortColumns>, ServiceError> {
    measures::complete(app, cohort).await?;
    let known = app.cache.find::<CohortColumns>(&cohort.id, &());
    let known = known.filter(|known| known.revision <= cohort.revision);
    if let Some(known) = known.as_ref().filter(|known| known.revision == cohort.revision) {
        return Ok(Arc::clone(known));
    }
    let shapes = usize::try_from(cohort.shapes).unwrap_or(usize::MAX);
    let bytes = shapes.saturating_mul(BYTES_PER_SHAPE);
    let _reserved = app.cache.reserve(bytes).ok_or_else(|| {
        let detail = format!("expected a cohort whose attributes fit in memory, got {shapes} shapes");
        ServiceError::TooLarge(Fault::new("", detail))
    })?;
    let columns = Arc::new(brought_up(app, cohort, known.as_deref()).await?);
    drop(_reserved);
    app.cache.keep(&cohort.id, &(), &columns);
    Ok(columns)
}

/// The columns that were `known` at an earlier revision, without the shapes deleted since, and with the new ones.
async fn brought_up(
    app: &App,
    cohort: &Cohort,
    known: Option<&CohortColumns>,
) -> Result<CohortColumns, ServiceError> {
    let (id, until, everything) = (&cohort.id, Revisions::until(cohort.revision), ShapeFilter::everything());
    let mut columns = match known {
        None => CohortColumns::default(),
        Some(known) => {
            let current = app.store.places(id, until, &everything).await?;
            let positions = known.positions(current.iter());
            if positions.len() == known.places.len() { known.clone() } else { known.of_shapes(&positions) }
        }
    };
    let new = Revisions { after: known.map_or(0, |known| known.revision), ..until };
    let mut after = None;
    loop {
        let page = app.store.describe_after(id, new, after, PAGE).await?;
        let Some((last, _)) = page.last() else { break };
        after = Some(*last);
        page.iter().for_each(|(place, shape)| columns.push(*place, shape));
    }
    columns.revision = cohort.revision;
    columns.complete();
    if columns.places.is_sorted() {
        return Ok(columns);
    }
    // Uploads at the same time take their places before they become visible.
    let mut order: Vec<usize> = (0..columns.places.len()).collect();
    order.sort_by_key(|&shape| columns.places[shape]);
    Ok(columns.of_shapes(&order))
}

/// Positions in the columns of the shapes that pass the filter.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn selected(
    app: &App,
    cohort: &Cohort,
    columns: &CohortColumns,
    filter: &ShapeFilter,
) -> Result<Vec<usize>, ServiceError> {
    if filter.is_everything() {
        return Ok((0..columns.places.len()).collect());
    }
    let places = app.store.places(&cohort.id, Revisions::until(cohort.revision), filter).await?;
    Ok(columns.positions(places.iter()))
}
