//! Attributes of shapes that are read as a stream: a column for each, and no descriptions.

use std::collections::{HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use serde_json::Value;

use crate::analysis::inference::groups::dependence_warning_of;
use crate::analysis::models::design::Values;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::cache::Cached;
use crate::service::app::faults::MAX_FAULTS;
use crate::service::app::{App, ServiceError, Work};
use crate::store::{Cursor, Revisions, ValuesPage};

/// Predicted time of the attributes of a shape.
const DESCRIBED: f64 = 5e-7;

/// An attribute that is read.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(super) struct Wanted {
    /// Name in the request.
    pub(super) name: String,
    /// Place in the request.
    pub(super) pointer: String,
    pub(super) attribute: Attribute,
    pub(super) form: Form,
}

/// Form of the values of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub(super) enum Form {
    /// Numbers if all are, otherwise texts.
    Any,
    /// Texts.
    Texts,
    /// How many there are, and how many of them differ.
    Distinct,
}

/// Columns of shapes in storage order.
#[derive(Debug)]
pub(super) struct Columns {
    pub(super) shapes: usize,
    columns: Vec<Column>,
}

/// Values of an attribute.
#[derive(Debug)]
struct Column {
    attribute: Attribute,
    held: Held,
    /// Number of shapes without a value, and the places of the first of them.
    without: usize,
    places: Vec<Cursor>,
}

#[derive(Debug)]
enum Held {
    Numbers(Vec<f64>),
    Texts { names: Vec<String>, known: HashMap<String, u32>, of_shapes: Vec<u32> },
    Distinct { count: usize, seen: HashSet<u64> },
}

impl Cached for Columns {
    const NAME: &'static str = "columns";

    fn bytes(&self) -> usize {
        let of = |column: &Column| match &column.held {
            Held::Numbers(numbers) => 8 * numbers.len(),
            Held::Texts { names, of_shapes, .. } => {
                4 * of_shapes.len() + names.iter().map(|name| 2 * name.len() + 80).sum::<usize>()
            }
            Held::Distinct { seen, .. } => 16 * seen.len(),
        };
        self.columns.iter().map(of).sum()
    }
}

impl Column {
    fn new(attribute: &Attribute, form: Form) -> Self {
        let held = match form {
            Form::Any => Held::Numbers(Vec::new()),
            Form::Texts => Held::Texts { names: Vec::new(), known: HashMap::new(), of_shapes: Vec::new() },
            Form::Distinct => Held::Distinct { count: 0, seen: HashSet::new() },
        };
        Self { attribute: attribute.clone(), held, without: 0, places: Vec::new() }
    }

    /// Adds the value of a shape; `false` for a text among numbers.
    fn add(&mut self, value: &Value, place: Cursor) -> bool {
        if value.is_null() {
            self.without += 1;
            if self.places.len() < MAX_FAULTS {
                self.places.push(place);
            }
        }
        match &mut self.held {
            Held::Numbers(numbers) => match self.attribute.number_of(value) {
                Some(number) => numbers.push(number),
                None if value.is_null() => numbers.push(f64::NAN),
                None => return false,
            },
            Held::Texts { names, known, of_shapes } => {
                let text = self.attribute.text_of(value).unwrap_or_default();
                let next = names.len() as u32;
                let number = match known.get(&text) {
                    Some(number) => *number,
                    None => {
                        names.push(text.clone());
                        known.insert(text, next);
                        next
                    }
                };
                of_shapes.push(number);
            }
            Held::Distinct { count, seen } => {
                if let Some(text) = self.attribute.text_of(value) {
                    let mut hasher = DefaultHasher::new();
                    text.hash(&mut hasher);
                    *count += 1;
                    seen.insert(hasher.finish());
                }
            }
        }
        true
    }
}

/// Columns as far as they are read, or the first one whose numbers are followed by a text.
type Read = Result<Columns, usize>;

fn extended(mut columns: Columns, page: &ValuesPage) -> Read {
    columns.shapes += page.places.len();
    for (place, values) in page.places.iter().zip(&page.values) {
        for (i, (column, value)) in columns.columns.iter_mut().zip(values).enumerate() {
            if !column.add(value, *place) {
                return Err(i);
            }
        }
    }
    Ok(columns)
}

impl Columns {
    /// The values of the shapes of a cohort that pass a filter; kept while the revision is used.
    ///
    /// Cost: a pass over the attributes, and another for each attribute whose numbers are followed by texts.
    ///
    /// # Errors
    /// A failure of the store.
    pub(super) async fn read(
        app: &App,
        cohort: &Cohort,
        filter: &ShapeFilter,
        wanted: &[Wanted],
    ) -> Result<Arc<Self>, ServiceError> {
        let settings = (cohort.revision, filter, wanted);
        if let Some(known) = app.cache.find::<Self>(&cohort.id, &settings) {
            return Ok(known);
        }
        let attributes: Vec<Attribute> = wanted.iter().map(|wanted| wanted.attribute.clone()).collect();
        let mut forms: Vec<Form> = wanted.iter().map(|wanted| wanted.form).collect();
        // A column becomes one of texts once at most.
        for _ in 0..=forms.len() {
            match Self::in_forms(app, cohort, filter, &attributes, &forms).await? {
                Ok(columns) => {
                    let columns = Arc::new(columns);
                    app.cache.keep(&cohort.id, &settings, &columns);
                    return Ok(columns);
                }
                Err(column) => forms[column] = Form::Texts,
            }
        }
        Err(ServiceError::Internal("attributes without a form".into()))
    }

    async fn in_forms(
        app: &App,
        cohort: &Cohort,
        filter: &ShapeFilter,
        attributes: &[Attribute],
        forms: &[Form],
    ) -> Result<Read, ServiceError> {
        let columns = attributes.iter().zip(forms).map(|(attribute, form)| Column::new(attribute, *form));
        let mut columns = Self { shapes: 0, columns: columns.collect() };
        let (revisions, mut after) = (Revisions::until(cohort.revision), None);
        while let Some(page) = app.store.values(&cohort.id, revisions, filter, attributes, after).await? {
            after = page.places.last().copied();
            let work = Work::from_seconds(page.places.len() as f64 * DESCRIBED);
            match app.pool.weighing(work).run(move || Ok(extended(columns, &page))).await? {
                Ok(more) => columns = more,
                Err(column) => return Ok(Err(column)),
            }
        }
        Ok(Ok(columns))
    }

    /// Values of a column, of which none is missing.
    pub(super) fn values(&self, column: usize) -> Option<Values> {
        match &self.columns[column].held {
            Held::Numbers(numbers) => Some(Values::Numbers(numbers.clone())),
            Held::Texts { names, of_shapes, .. } => {
                Some(Values::Levels { names: names.clone(), of_shapes: of_shapes.clone() })
            }
            Held::Distinct { .. } => None,
        }
    }

    /// Number of shapes without a value in a column, and places of the first of them.
    pub(super) fn without(&self, column: usize) -> (usize, &[Cursor]) {
        (self.columns[column].without, &self.columns[column].places)
    }

    /// A warning about values that several shapes share.
    pub(super) fn dependence(&self, column: usize) -> Option<String> {
        match &self.columns[column].held {
            Held::Distinct { count, seen } => dependence_warning_of(*count, seen.len()),
            _ => None,
        }
    }
}
