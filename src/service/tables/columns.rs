//! Attributes of the shapes of a cohort as columns, kept in memory and brought up to date by the changes.
//!
//! A column holds the shapes that have its attribute, so that names which few shapes have take no room for the others.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use crate::domain::attribute::{Attribute, AttributeValue, Measure};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::{MAX_NAMES, ShapeDescription};
use crate::service::app::cache::{Cached, Reserved};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::measures;
use crate::store::{Cursor, Places, Revisions};
use crate::wire::fault::Fault;

/// Fewest and most shapes read at once.
const PAGE: (usize, usize) = (64, 8192);
/// Memory that the columns of the shapes read at once should take.
const PAGE_BYTES: usize = 8 << 20;
/// Usual memory of the attributes of a shape.
const BYTES_PER_SHAPE: usize = 400;
/// Memory of a value, with the position of its shape.
const BYTES_PER_CELL: usize = size_of::<Cell>() + size_of::<u32>();
/// Memory of a text beside its letters: its counts, its places in the list and in the index.
const BYTES_PER_TEXT: usize = 72;
/// Memory of a column without values, or of the hash of a name.
const BYTES_PER_COLUMN: usize = 512;
/// Predicted work of a value.
const SECONDS_PER_CELL: f64 = 2e-7;

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

/// One attribute of the shapes that have it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Column {
    /// Positions of the shapes, ascending.
    shapes: Vec<u32>,
    /// Their values, none of which is missing.
    cells: Vec<Cell>,
    /// Texts that occur, each once.
    pub(crate) texts: Vec<Arc<str>>,
    numbers: HashMap<Arc<str>, u32>,
    text_bytes: usize,
}

impl Column {
    /// A column of all shapes.
    #[cfg(test)]
    pub(crate) fn of_all(cells: &[Cell], texts: &[&str]) -> Self {
        let (shapes, cells) =
            (0..).zip(cells.iter().copied()).filter(|(_, cell)| *cell != Cell::Missing).unzip();
        Self { shapes, cells, texts: texts.iter().map(|text| (*text).into()).collect(), ..Self::default() }
    }

    fn push(&mut self, shape: u32, value: AttributeValue<'_>) {
        let cell = match value {
            AttributeValue::Number(number) => Cell::Number(number),
            AttributeValue::Flag(flag) => Cell::Flag(flag),
            AttributeValue::Time(ms) => Cell::Time(ms),
            AttributeValue::Text(text) => Cell::Text(self.number_of(&text)),
        };
        self.shapes.push(shape);
        self.cells.push(cell);
    }

    fn number_of(&mut self, text: &str) -> u32 {
        if let Some(&number) = self.numbers.get(text) {
            return number;
        }
        self.text_bytes += text.len() + BYTES_PER_TEXT;
        let (text, number) = (Arc::<str>::from(text), self.texts.len() as u32);
        self.texts.push(Arc::clone(&text));
        self.numbers.insert(text, number);
        number
    }

    /// Number of shapes that have the attribute.
    pub(crate) fn count(&self) -> usize {
        self.cells.len()
    }

    /// The values that occur.
    pub(crate) fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The cell of each of these shapes, which are in ascending order.
    pub(crate) fn of<'a>(&'a self, shapes: &'a [u32]) -> impl Iterator<Item = Cell> + 'a {
        let mut next = 0;
        shapes.iter().map(move |&shape| {
            next = ahead(&self.shapes, next, shape);
            if self.shapes.get(next) == Some(&shape) { self.cells[next] } else { Cell::Missing }
        })
    }

    /// The values of those of these shapes that have one; the shapes are in ascending order.
    pub(crate) fn present(&self, shapes: &[u32]) -> Vec<Cell> {
        if shapes.len() < self.shapes.len() {
            return self.of(shapes).filter(|cell| *cell != Cell::Missing).collect();
        }
        self.places_in(shapes).map(|(_, cell)| cell).collect()
    }

    /// The values of those of these shapes that have one, with the places of the shapes in the list, which is in ascending order.
    fn places_in<'a>(&'a self, shapes: &'a [u32]) -> impl Iterator<Item = (u32, Cell)> + 'a {
        let mut next = 0;
        self.shapes.iter().zip(&self.cells).filter_map(move |(shape, cell)| {
            next = ahead(shapes, next, *shape);
            (shapes.get(next) == Some(shape)).then_some((next as u32, *cell))
        })
    }

    /// The same column with other shapes.
    fn with(&self, found: impl Iterator<Item = (u32, Cell)>) -> Self {
        let (shapes, cells) = found.unzip();
        let (texts, numbers) = (self.texts.clone(), self.numbers.clone());
        Self { shapes, cells, texts, numbers, text_bytes: self.text_bytes }
    }

    fn bytes(&self) -> usize {
        BYTES_PER_COLUMN + self.text_bytes + BYTES_PER_CELL * self.cells.len()
    }
}

/// Position of the first entry of a sorted list, from the one at `from` on, that is not below `least`.
fn ahead(sorted: &[u32], from: usize, least: u32) -> usize {
    let is_below = |at: usize| sorted.get(at).is_some_and(|entry| *entry < least);
    // Mostly the same one or the next.
    match (is_below(from), is_below(from + 1)) {
        (false, _) => from,
        (true, false) => from + 1,
        (true, true) => from + 2 + sorted[from + 2..].partition_point(|entry| *entry < least),
    }
}

/// Attributes of the shapes of a cohort at a revision, in storage order.
#[derive(Debug, Clone, Default)]
pub(crate) struct CohortColumns {
    revision: u64,
    places: Vec<Cursor>,
    ids: Column,
    columns: BTreeMap<Attribute, Column>,
    /// Number of columns of further attributes.
    names: usize,
    /// Hashes of further names beyond [`MAX_NAMES`], which an earlier version let in.
    left_out: HashSet<u64>,
}

impl Cached for CohortColumns {
    const NAME: &'static str = "columns";

    fn bytes(&self) -> usize {
        let columns = self.columns.values().map(Column::bytes).sum::<usize>();
        self.ids.bytes()
            + columns
            + size_of::<Cursor>() * self.places.len()
            + 2 * size_of::<u64>() * self.left_out.len()
    }
}

/// Attributes that have a column even if no shape has them.
fn usual_attributes() -> impl Iterator<Item = Attribute> {
    let own = [Attribute::ExternalId, Attribute::Label, Attribute::Subject, Attribute::CreatedAt];
    own.into_iter().chain(Measure::ALL.map(Attribute::Measure))
}

/// Memory that a shape takes in columns, at most, and the number of its values.
fn size_of_shape(shape: &ShapeDescription) -> (usize, usize) {
    let text = |length: usize| length + BYTES_PER_TEXT;
    let own = [&shape.external_id, &shape.label, &shape.subject].into_iter().flatten();
    let labels = shape.labels.values().filter_map(|value| value.as_str());
    let texts = text(shape.id.len())
        + own.map(|found| text(found.len())).sum::<usize>()
        + labels.map(|found| text(found.len())).sum::<usize>();
    let cells = 1 + usual_attributes().count() + shape.labels.len();
    (size_of::<Cursor>() + texts + BYTES_PER_CELL * cells, cells)
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

    /// Warning about attributes without a column.
    pub(crate) fn warning(&self) -> Option<String> {
        (!self.left_out.is_empty()).then(|| {
            let all = self.names + self.left_out.len();
            format!("the cohort has {all} names of attributes, of which the first {MAX_NAMES} have a column")
        })
    }

    fn push(&mut self, place: Cursor, shape: &ShapeDescription) {
        let position = self.places.len() as u32;
        self.places.push(place);
        self.ids.push(position, AttributeValue::Text(shape.id.as_str().into()));
        for attribute in usual_attributes() {
            let value = attribute.value(shape);
            let column = self.columns.entry(attribute).or_default();
            value.into_iter().for_each(|value| column.push(position, value));
        }
        for name in shape.labels.keys() {
            self.push_further(position, Attribute::Labels(name.clone()), shape);
        }
    }

    fn push_further(&mut self, position: u32, attribute: Attribute, shape: &ShapeDescription) {
        let value = attribute.value(shape);
        let push = |column: &mut Column| value.into_iter().for_each(|value| column.push(position, value));
        if let Some(column) = self.columns.get_mut(&attribute) {
            push(column);
        } else if self.names < MAX_NAMES {
            self.names += 1;
            push(self.columns.entry(attribute).or_default());
        } else {
            let mut hasher = DefaultHasher::new();
            attribute.hash(&mut hasher);
            self.left_out.insert(hasher.finish());
        }
    }

    /// The columns with a further page of shapes.
    fn with_page(mut self, page: &[(Cursor, ShapeDescription)]) -> Self {
        page.iter().for_each(|(place, shape)| self.push(*place, shape));
        self
    }

    /// The columns of the shapes that are still at these places.
    fn at_places(&self, places: &Places) -> Self {
        let kept = self.positions(places.iter());
        if kept.len() == self.places.len() {
            return self.clone();
        }
        let column = |column: &Column| column.with(column.places_in(&kept));
        let places = kept.iter().map(|&shape| self.places[shape as usize]).collect();
        self.with_columns(places, &column)
    }

    /// Every column changed by a function.
    fn with_columns(&self, places: Vec<Cursor>, column: &dyn Fn(&Column) -> Column) -> Self {
        Self {
            revision: self.revision,
            places,
            ids: column(&self.ids),
            columns: self.columns.iter().map(|(name, found)| (name.clone(), column(found))).collect(),
            names: self.names,
            left_out: self.left_out.clone(),
        }
    }

    /// The columns in storage order: uploads at the same time take their places before they become visible.
    fn sorted(self) -> Self {
        if self.places.is_sorted() {
            return self;
        }
        let mut order: Vec<u32> = (0..self.places.len() as u32).collect();
        order.sort_by_key(|&shape| self.places[shape as usize]);
        let mut moved = vec![0_u32; order.len()];
        (0..).zip(&order).for_each(|(new, old)| moved[*old as usize] = new);
        let column = |column: &Column| {
            let cells = column.shapes.iter().zip(&column.cells);
            let mut found: Vec<(u32, Cell)> =
                cells.map(|(shape, cell)| (moved[*shape as usize], *cell)).collect();
            found.sort_unstable_by_key(|(shape, _)| *shape);
            column.with(found.into_iter())
        };
        let places = order.iter().map(|&shape| self.places[shape as usize]).collect();
        self.with_columns(places, &column)
    }

    /// Positions of the shapes at these places, in their order; places of other shapes are left out.
    fn positions(&self, places: impl Iterator<Item = Cursor>) -> Vec<u32> {
        let mut next = 0;
        let position = |place: Cursor| {
            next += self.places[next..].partition_point(|other| *other < place);
            (self.places.get(next) == Some(&place)).then_some(next as u32)
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
    // Names without a column may have one without the shapes that are gone.
    let known = known.filter(|known| known.left_out.is_empty());
    let shapes = usize::try_from(cohort.shapes).unwrap_or(usize::MAX);
    let bytes = shapes.saturating_mul(BYTES_PER_SHAPE);
    let mut reserved = app.cache.reserve(bytes).ok_or_else(|| too_large(cohort))?;
    let columns = Arc::new(brought_up(app, cohort, known, &mut reserved).await?);
    drop(reserved);
    app.cache.keep(&cohort.id, &(), &columns);
    Ok(columns)
}

fn too_large(cohort: &Cohort) -> ServiceError {
    let detail = format!("expected a cohort whose attributes fit in memory, got {} shapes", cohort.shapes);
    ServiceError::TooLarge(Fault::new("", detail).into())
}

/// The columns that were `known` at an earlier revision, without the shapes deleted since, and with the new ones. They are built in
/// the pool, and their memory is reserved before.
async fn brought_up(
    app: &App,
    cohort: &Cohort,
    known: Option<Arc<CohortColumns>>,
    reserved: &mut Reserved<'_>,
) -> Result<CohortColumns, ServiceError> {
    let (id, until, everything) = (&cohort.id, Revisions::until(cohort.revision), ShapeFilter::everything());
    let weighing = |cells: usize| app.pool.weighing(Work::from_seconds(SECONDS_PER_CELL * cells as f64));
    let new = Revisions { after: known.as_ref().map_or(0, |known| known.revision), ..until };
    let mut columns = match known {
        None => CohortColumns::default(),
        Some(known) => {
            if !reserved.grow_to(known.bytes()) {
                return Err(too_large(cohort));
            }
            let current = app.store.places(id, until, &everything).await?;
            let cells = known.columns.values().map(Column::count).sum();
            weighing(cells).run(move || Ok(known.at_places(&current))).await?
        }
    };
    let (mut after, mut limit) = (None, PAGE.1 / 16);
    loop {
        let page = app.store.describe_after(id, new, after, limit).await?;
        let Some((last, _)) = page.last() else { break };
        after = Some(*last);
        let (bytes, cells) = page
            .iter()
            .map(|(_, shape)| size_of_shape(shape))
            .fold((0, 0), |(bytes, cells), (more, values)| (bytes + more, cells + values));
        if !reserved.grow_to(columns.bytes() + bytes) {
            return Err(too_large(cohort));
        }
        limit = (PAGE_BYTES / (bytes / page.len()).max(1)).clamp(PAGE.0, PAGE.1);
        columns = weighing(cells).run(move || Ok(columns.with_page(&page))).await?;
    }
    columns.revision = cohort.revision;
    let cells = columns.places.len() * usual_attributes().count();
    weighing(cells).run(move || Ok(columns.sorted())).await
}

/// Positions in the columns of the shapes that pass the filter, ascending.
///
/// # Errors
/// A failure of the store.
pub(crate) async fn selected(
    app: &App,
    cohort: &Cohort,
    columns: &Arc<CohortColumns>,
    filter: &ShapeFilter,
) -> Result<Vec<u32>, ServiceError> {
    let columns = Arc::clone(columns);
    if filter.is_everything() {
        return Ok((0..columns.places.len() as u32).collect());
    }
    let places = app.store.places(&cohort.id, Revisions::until(cohort.revision), filter).await?;
    let work = Work::from_seconds(SECONDS_PER_CELL * places.count() as f64);
    app.pool.weighing(work).run(move || Ok(columns.positions(places.iter()))).await
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::domain::shape::ShapeMeasures;

    fn place(number: i64) -> Cursor {
        format!("1-{number:x}").parse().unwrap()
    }

    fn shape(number: usize, names: impl Iterator<Item = String>) -> ShapeDescription {
        ShapeDescription {
            id: format!("shp_{number}"),
            external_id: None,
            subject: None,
            label: number.is_multiple_of(2).then(|| "even".to_owned()),
            labels: names.map(|name| (name, json!(number))).collect(),
            measures: ShapeMeasures::default(),
            created_at_ms: 0,
        }
    }

    fn columns(shapes: usize, each: usize) -> CohortColumns {
        let page = (0..shapes).map(|k| {
            let names = (0..each).map(|j| format!("{k}_{j}")).chain(["every".to_owned()]);
            (place(k as i64), shape(k, names))
        });
        CohortColumns::default().with_page(&page.collect::<Vec<_>>())
    }

    #[test]
    fn memory_follows_the_values_and_not_the_names_times_the_shapes() {
        let of = |shapes: usize| columns(shapes, 10).bytes();
        let (few, many) = (of(100), of(400));
        assert!(many < 5 * few && many < 4_000_000, "{few} bytes of 100 shapes, {many} of 400");
        let found = columns(500, 10);
        assert_eq!((found.names, found.left_out.len()), (MAX_NAMES, 5001 - MAX_NAMES));
        let warning = found.warning().unwrap();
        assert!(warning.contains("5001 names") && warning.contains("first 4096"), "{warning}");
        assert_eq!(columns(3, 2).warning(), None);
    }

    #[test]
    fn a_page_takes_no_more_than_was_reserved_for_it() {
        for (shapes, each) in [(50, 0), (50, 20)] {
            let found = columns(shapes, each);
            let names = (0..each).map(|j| format!("{j}")).chain(["every".to_owned()]);
            let (bytes, cells) = size_of_shape(&shape(0, names));
            let fixed = BYTES_PER_COLUMN * (found.columns.len() + 1);
            assert!(found.bytes() <= fixed + shapes * (bytes + 4), "{} > {bytes}", found.bytes());
            assert_eq!(cells, 16 + each);
        }
    }

    #[test]
    fn cells_are_those_of_the_shapes() {
        let found = columns(9, 1);
        let label = found.column(&Attribute::Label).unwrap();
        let (even, none) = (Cell::Text(0), Cell::Missing);
        assert_eq!(label.of(&[0, 1, 4, 7, 8]).collect::<Vec<_>>(), [even, none, even, none, even]);
        assert_eq!((label.count(), label.present(&[1, 2, 3, 8]).len()), (5, 2));
        assert_eq!(label.present(&(0..9).collect::<Vec<_>>()), [even; 5]);
        let own = found.column(&Attribute::Labels("4_0".into())).unwrap();
        assert_eq!(own.present(&[3, 4, 5]), [Cell::Number(4.0)]);
        assert_eq!(own.of(&[3, 5]).collect::<Vec<_>>(), [none; 2]);
    }

    #[test]
    fn shapes_leave_and_come_in_any_order() {
        let mut places = [4, 0, 3, 1].map(place).to_vec();
        let page: Vec<_> = (0..).zip(&places).map(|(k, at)| (*at, shape(k, std::iter::empty()))).collect();
        let sorted = CohortColumns::default().with_page(&page).sorted();
        places.sort();
        assert_eq!(sorted.places(), places);
        let ids = |found: &CohortColumns| -> Vec<String> {
            let all: Vec<u32> = (0..found.places.len() as u32).collect();
            let text = |cell| {
                if let Cell::Text(text) = cell {
                    found.ids.texts[text as usize].to_string()
                } else {
                    String::new()
                }
            };
            found.ids.of(&all).map(text).collect()
        };
        assert_eq!(ids(&sorted), ["shp_1", "shp_3", "shp_2", "shp_0"]);
        let label = sorted.column(&Attribute::Label).unwrap();
        assert_eq!(
            label.of(&[0, 1, 2, 3]).map(|cell| cell != Cell::Missing).collect::<Vec<_>>(),
            [false, false, true, true]
        );
        let kept = sorted.positions([place(1), place(2), place(4)].into_iter());
        assert_eq!(kept, [1, 3]);
        let column = |column: &Column| column.with(column.places_in(&kept));
        assert_eq!(ids(&sorted.with_columns(vec![place(1), place(4)], &column)), ["shp_3", "shp_0"]);
    }
}
