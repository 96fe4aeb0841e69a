//! A cohort as a table: attributes, measures, and results of dictionaries for the shapes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::columns::{self, Cell, CohortColumns, Column};
use super::derived::{self, Derived, DerivedColumns};
use super::summary::{ValueType, number_text, value_type};
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::attributes::{FilterPlace, KnownAttributes, refuse_misspelt, refuse_unknown};
use crate::service::cohorts::catalogue;
use crate::service::dictionaries::coding;
use crate::service::dictionaries::ready::{self, Ready};
use crate::store::Cursor;
use crate::wire::fault::Fault;
use crate::wire::table::{NO_TEXT, Table, Values};

/// Content of a table.
#[derive(Debug)]
pub struct TableQuery {
    /// Names of the columns. Default: external id, label, subject, all further attributes and measures.
    pub columns: Option<Vec<String>>,
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Whether the request names columns and filter in parameters of the query.
    pub in_query: bool,
}

/// A table and its sources.
#[derive(Debug)]
pub struct CohortTable {
    /// The cohort, at the revision of the table.
    pub cohort: Cohort,
    /// Dictionaries of the columns, each once.
    pub dictionaries: Vec<Arc<Ready>>,
    /// The columns.
    pub table: Table,
    /// Their memory.
    pub memory: Held,
}

/// Maximum number of columns.
const MAX_COLUMNS: usize = 200;
/// Maximum number of values.
const MAX_VALUES: usize = 50_000_000;

/// Source of a column.
#[derive(Debug, Clone, PartialEq)]
enum Source {
    Id,
    Attribute(Attribute),
    Dictionary(usize, Derived),
}

/// The table of a cohort. Cost: that of its columns; values of dictionaries are computed once for each shape.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort; columns that do not exist; a dictionary that does not suit the cohort; too many
/// values.
pub async fn table(app: &App, key: &str, query: TableQuery) -> Result<CohortTable, ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    let held = columns::of_cohort(app, &cohort).await?;
    let shapes = columns::selected(app, &cohort, &held, &query.filter).await?;
    if query.in_query {
        refuse_misspelt(app, &cohort, &query.filter, None, shapes.is_empty()).await?;
    } else if shapes.is_empty() {
        refuse_unknown(app, &cohort, &query.filter, FilterPlace::Body("/filter")).await?;
    }
    let names = query.columns.clone().unwrap_or_else(|| usual_columns(&held));
    check_size(&query, names.len(), shapes.len())?;
    let (sources, dictionaries) = Sources::read(app, &cohort, &held, &query, &names).await?;
    let derived = sources.derived(app, &cohort, &dictionaries, &query.filter).await?;
    let (cells, list) = (names.len() * shapes.len(), dictionaries.clone());
    let mut memory = app.memory.hold(Purpose::Answers, 0)?;
    let pool = app.pool.weighing(Work::from_seconds(SECONDS_PER_VALUE * cells as f64));
    let columns = pool.run(move || {
        let places: Vec<Cursor> = shapes.iter().map(|&shape| held.places()[shape as usize]).collect();
        let values = |source: &Source| match source {
            Source::Id => of_column(held.ids(), &shapes),
            Source::Attribute(attribute) => {
                held.column(attribute).map_or(Values::Number(Vec::new()), |column| of_column(column, &shapes))
            }
            Source::Dictionary(index, value) => derived[index].values(&list[*index], *value, &places),
        };
        let mut table = Table { fields: serde_json::Map::new(), columns: Vec::new(), rows: shapes.len() };
        for (name, source) in names.into_iter().zip(&sources.0) {
            memory.grow(table.rows * size_of::<f64>())?;
            table.columns.push((name, values(source)));
            memory.resize(table.bytes())?;
        }
        Ok((table, memory))
    });
    let (table, memory) = columns.await?;
    Ok(CohortTable { cohort, dictionaries, table, memory })
}

/// Predicted work of a value.
const SECONDS_PER_VALUE: f64 = 5e-8;

/// Names of the columns of a table that names none.
fn usual_columns(held: &CohortColumns) -> Vec<String> {
    let attributes = held.columns().iter().filter(|(_, column)| column.count() > 0);
    let names = attributes.map(|(attribute, _)| attribute.to_string()).filter(|name| name != "created_at");
    std::iter::once("id".to_owned()).chain(names).collect()
}

fn check_size(query: &TableQuery, columns: usize, rows: usize) -> Result<(), ServiceError> {
    let refused = |detail: String| Err(query.refused(None, detail));
    if !(1..=MAX_COLUMNS).contains(&columns) {
        return refused(format!("expected 1 to {MAX_COLUMNS} columns, got {columns}"));
    }
    let values = columns.saturating_mul(rows);
    if values > MAX_VALUES {
        return refused(format!(
            "expected a table of at most {MAX_VALUES} values, got {columns} columns of {rows} shapes: name fewer \
             columns, or filter the shapes"
        ));
    }
    Ok(())
}

impl TableQuery {
    /// The refusal of a column, or of all of them.
    fn refused(&self, column: Option<usize>, detail: String) -> ServiceError {
        let fault = match (self.in_query, column) {
            (true, _) => return ServiceError::parameter("columns", detail),
            (false, None) => Fault::new("/columns", detail),
            (false, Some(index)) => Fault::new(format!("/columns/{index}"), detail),
        };
        ServiceError::Invalid(vec![fault].into())
    }
}

/// Sources of the columns of a table.
struct Sources(Vec<Source>);

impl Sources {
    /// Finds the source of every column.
    async fn read(
        app: &App,
        cohort: &Cohort,
        held: &CohortColumns,
        query: &TableQuery,
        names: &[String],
    ) -> Result<(Self, Vec<Arc<Ready>>), ServiceError> {
        let (mut sources, mut dictionaries) = (Vec::with_capacity(names.len()), Dictionaries::default());
        for (index, name) in names.iter().enumerate() {
            if names[..index].contains(name) {
                return Err(query.refused(Some(index), format!("expected '{name}' once, got it twice")));
            }
            let source = match (name.as_str(), Attribute::parse(name), Derived::parse(name)) {
                ("id", _, _) => Source::Id,
                (_, Some(attribute), _) => {
                    if held.column(&attribute).is_none() {
                        let known = match held.warning() {
                            Some(warning) => warning,
                            None => KnownAttributes::of(app, cohort).await?.to_string(),
                        };
                        let detail = format!(
                            "expected an attribute that shapes of the cohort have, got '{name}': {known}"
                        );
                        return Err(query.refused(Some(index), detail));
                    }
                    Source::Attribute(attribute)
                }
                (_, None, Some((key, value))) => {
                    let dictionary = dictionaries.find(app, cohort, query, index, key).await?;
                    check_value(&dictionaries.list[dictionary], value)
                        .map_err(|detail| query.refused(Some(index), detail))?;
                    Source::Dictionary(dictionary, value)
                }
                (_, None, None) => {
                    let attributes = Attribute::WANTED.trim_start_matches("expected ");
                    let detail = format!("expected 'id', {attributes}, or {}, got '{name}'", Derived::WANTED);
                    return Err(query.refused(Some(index), detail));
                }
            };
            sources.push(source);
        }
        Ok((Self(sources), dictionaries.list))
    }

    /// Values of the dictionaries, by their positions.
    async fn derived(
        &self,
        app: &App,
        cohort: &Cohort,
        dictionaries: &[Arc<Ready>],
        filter: &ShapeFilter,
    ) -> Result<BTreeMap<usize, Arc<DerivedColumns>>, ServiceError> {
        let mut found = BTreeMap::new();
        for (index, ready) in dictionaries.iter().enumerate() {
            let value = |source: &Source| match source {
                Source::Dictionary(dictionary, value) if *dictionary == index => Some(*value),
                _ => None,
            };
            let wanted: BTreeSet<Derived> = self.0.iter().filter_map(value).collect();
            found.insert(index, derived::of_cohort(app, cohort, ready, &wanted, filter).await?);
        }
        Ok(found)
    }
}

/// Refuses a value that a dictionary does not give.
fn check_value(ready: &Ready, value: Derived) -> Result<(), String> {
    let (content, name) = (&ready.dictionary().content, &ready.listed.name);
    let components = content.atoms.len();
    match value {
        Derived::Score(component) if component >= components => {
            Err(format!("expected a score from 1 to {components} of '{name}', got {}", component + 1))
        }
        Derived::Class | Derived::Confidence if content.classifier.is_none() => {
            Err(format!("expected a dictionary with a classifier, '{name}' has none"))
        }
        _ => Ok(()),
    }
}

/// Dictionaries of a table, each once, and the names under which they were asked for.
#[derive(Default)]
struct Dictionaries {
    list: Vec<Arc<Ready>>,
    positions: BTreeMap<String, usize>,
}

impl Dictionaries {
    async fn find(
        &mut self,
        app: &App,
        cohort: &Cohort,
        query: &TableQuery,
        column: usize,
        key: &str,
    ) -> Result<usize, ServiceError> {
        if let Some(&position) = self.positions.get(key) {
            return Ok(position);
        }
        let ready = match ready::find(app, key).await {
            Err(ServiceError::NotFound { .. }) => {
                let detail = format!("expected the name of a dictionary, got '{key}': it was not found");
                return Err(query.refused(Some(column), detail));
            }
            found => found?,
        };
        if let Some(detail) = coding::misfit(&ready, cohort) {
            return Err(query.refused(Some(column), detail));
        }
        let known = self.list.iter().position(|other| other.listed.id == ready.listed.id);
        let position = known.unwrap_or_else(|| {
            self.list.push(ready);
            self.list.len() - 1
        });
        self.positions.insert(key.to_owned(), position);
        Ok(position)
    }
}

/// Values of a column for some shapes; texts if they are of several types.
fn of_column(column: &Column, shapes: &[u32]) -> Values {
    let cells = || column.of(shapes);
    match value_type(column.cells().iter().copied()) {
        ValueType::Number => Values::Number(
            cells().map(|cell| if let Cell::Number(number) = cell { number } else { f64::NAN }).collect(),
        ),
        ValueType::Boolean => Values::Flag(
            cells().map(|cell| if let Cell::Flag(flag) = cell { Some(flag) } else { None }).collect(),
        ),
        ValueType::Time => {
            Values::Time(cells().map(|cell| if let Cell::Time(ms) = cell { ms } else { 0 }).collect())
        }
        ValueType::Text => texts_of(column, cells()),
    }
}

/// Texts of the cells; only those that occur are kept.
fn texts_of(column: &Column, cells: impl Iterator<Item = Cell>) -> Values {
    let (mut texts, mut places) = (Vec::new(), vec![NO_TEXT; column.texts.len()]);
    let mut others: BTreeMap<String, u32> = BTreeMap::new();
    let mut add = |text: Arc<str>| {
        texts.push(text);
        (texts.len() - 1) as u32
    };
    let mut other = |text: String, add: &mut dyn FnMut(Arc<str>) -> u32| {
        *others.entry(text).or_insert_with_key(|text| add(text.as_str().into()))
    };
    let rows = cells.map(|cell| match cell {
        Cell::Missing => NO_TEXT,
        Cell::Text(text) => {
            let place = &mut places[text as usize];
            if *place == NO_TEXT {
                *place = add(Arc::clone(&column.texts[text as usize]));
            }
            *place
        }
        Cell::Number(number) => other(number_text(number), &mut add),
        Cell::Flag(flag) => other(flag.to_string(), &mut add),
        Cell::Time(ms) => other(ms.to_string(), &mut add),
    });
    let rows = rows.collect();
    Values::Text { rows, texts }
}
