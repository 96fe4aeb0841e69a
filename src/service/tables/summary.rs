//! Summaries of attributes: their types, values and distributions.

use std::cmp::Ordering;
use std::sync::Arc;

use serde::Serialize;

use super::columns::{self, Cell, CohortColumns, Column};
use crate::domain::attribute::{Attribute, LARGEST_WHOLE};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::cache::Cached;
use crate::service::app::parallel;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::attributes::refuse_misspelt;
use crate::service::cohorts::catalogue;
use crate::wire::time::rfc3339;

/// Type of the values of an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ValueType {
    /// Texts, also among other values.
    Text,
    /// Numbers.
    Number,
    /// Booleans.
    Boolean,
    /// Times.
    Time,
}

/// Request for a summary of the attributes of a cohort.
#[derive(Debug, Clone, Serialize)]
pub struct SummaryQuery {
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Maximum number of values listed of each attribute.
    pub values: usize,
    /// Number of bins of a histogram.
    pub bins: usize,
}

/// Summary of one attribute.
#[derive(Debug, Clone, PartialEq)]
pub struct AttributeSummary {
    /// The attribute.
    pub attribute: Attribute,
    /// Type of its values.
    pub value_type: ValueType,
    /// Number of shapes without it.
    pub missing: usize,
    /// Number of different values.
    pub distinct: usize,
    /// The most frequent values with their numbers of shapes; empty for times.
    pub values: Vec<(String, usize)>,
    /// Distribution, of numbers and times in milliseconds.
    pub distribution: Option<Distribution>,
}

/// Distribution of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Distribution {
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// Mean.
    pub mean: f64,
    /// Quantiles of [`PROBABILITIES`], interpolated linearly between order statistics.
    pub quantiles: [f64; PROBABILITIES.len()],
    /// Bins of equal width: their edges, one more than there are bins.
    pub edges: Vec<f64>,
    /// Number of values in each bin, which contains its lower edge; the last one contains both.
    pub counts: Vec<usize>,
}

/// Probabilities of the quantiles of a distribution.
pub const PROBABILITIES: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];

/// Attributes of a cohort with their summaries.
#[derive(Debug)]
pub struct Summaries {
    /// The cohort.
    pub cohort: Cohort,
    /// Number of shapes that pass the filter.
    pub shapes: usize,
    /// One entry per attribute that a shape of the cohort has.
    pub attributes: Vec<AttributeSummary>,
    /// Warnings for readers.
    pub warnings: Vec<String>,
}

impl Cached for Summaries {
    const NAME: &'static str = "summaries";

    fn bytes(&self) -> usize {
        let text = |(value, _): &(String, usize)| value.len() + size_of::<(String, usize)>();
        let of_attribute = |summary: &AttributeSummary| {
            let bins =
                summary.distribution.as_ref().map_or(0, |found| found.edges.len() + found.counts.len());
            size_of::<AttributeSummary>() + 8 * bins + summary.values.iter().map(text).sum::<usize>()
        };
        size_of::<Self>() + self.attributes.iter().map(of_attribute).sum::<usize>()
    }
}

/// Summarises the attributes of the shapes of a cohort at its revision; cached. Cost: a pass over the attributes of the shapes
/// that are new since the last call, and a sort of each numeric attribute.
///
/// # Errors
/// [`ServiceError::NotFound`] for the cohort; an attribute that no shape has; attributes that do not fit in memory.
pub async fn summarise(app: &App, key: &str, query: SummaryQuery) -> Result<Arc<Summaries>, ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    let (id, cached) = (cohort.id.clone(), (cohort.revision, query.clone()));
    if let Some(known) = app.cache.find(&id, &cached) {
        return Ok(known);
    }
    let columns = columns::of_cohort(app, &cohort).await?;
    let shapes = columns::selected(app, &cohort, &columns, &query.filter).await?;
    refuse_misspelt(app, &cohort, &query.filter, None, shapes.is_empty()).await?;
    let (count, warnings) = (shapes.len(), columns.warning().into_iter().collect());
    let cells: usize = columns.columns().values().map(|column| column.count().min(count)).sum();
    let _held = app.memory.foresee(numbers_of(&columns, &query))?;
    let attributes = app
        .pool
        .weighing(Work::from_seconds(SECONDS_PER_VALUE * cells as f64))
        .run(move || Ok(of_columns(&columns, &shapes, &query)))
        .await?;
    let summaries = Arc::new(Summaries { cohort, shapes: count, attributes, warnings });
    app.cache.keep(&id, &cached, &summaries);
    Ok(summaries)
}

/// Predicted work of a value.
const SECONDS_PER_VALUE: f64 = 6e-8;

/// Number of values and numbers of summaries, at most.
fn numbers_of(columns: &CohortColumns, query: &SummaryQuery) -> usize {
    let histogram = 2 * query.bins + PROBABILITIES.len();
    columns.columns().values().map(|column| 2 * column.count().min(query.values) + histogram).sum()
}

/// Number of values and numbers of summaries.
pub fn numbers_in(summaries: &Summaries) -> usize {
    let of_one = |summary: &AttributeSummary| {
        2 * summary.values.len() + summary.distribution.as_ref().map_or(0, |found| 2 * found.counts.len())
    };
    summaries.attributes.iter().map(of_one).sum()
}

fn of_columns(columns: &CohortColumns, shapes: &[u32], query: &SummaryQuery) -> Vec<AttributeSummary> {
    let occurring = columns.columns().iter().filter(|(_, column)| column.count() > 0);
    parallel::map(occurring.collect(), |_, (attribute, column)| of_column(attribute, column, shapes, query))
}

/// Type of a column: texts if its values are of several types.
pub(super) fn value_type(cells: impl Iterator<Item = Cell>) -> ValueType {
    let mut found = None;
    for cell in cells {
        let this = match cell {
            Cell::Missing => continue,
            Cell::Number(_) => ValueType::Number,
            Cell::Flag(_) => ValueType::Boolean,
            Cell::Time(_) => ValueType::Time,
            Cell::Text(_) => return ValueType::Text,
        };
        if *found.get_or_insert(this) != this {
            return ValueType::Text;
        }
    }
    found.unwrap_or(ValueType::Text)
}

fn of_column(
    attribute: &Attribute,
    column: &Column,
    shapes: &[u32],
    query: &SummaryQuery,
) -> AttributeSummary {
    let cells = column.present(shapes);
    let value_type = value_type(column.cells().iter().copied());
    let numbers = || {
        cells.iter().filter_map(|cell| match cell {
            Cell::Number(number) => Some(*number),
            Cell::Time(ms) => Some(*ms as f64),
            Cell::Missing | Cell::Flag(_) | Cell::Text(_) => None,
        })
    };
    let is_numeric = matches!(value_type, ValueType::Number | ValueType::Time);
    let counted = counted(column, &cells);
    let listed = if value_type == ValueType::Time { 0 } else { query.values };
    AttributeSummary {
        attribute: attribute.clone(),
        value_type,
        missing: shapes.len() - cells.len(),
        distinct: counted.len(),
        values: frequent(column, counted, listed),
        distribution: is_numeric.then(|| Distribution::of(numbers().collect(), query.bins)).flatten(),
    }
}

/// The different values of cells, each with the number of its cells. Cost: a sort of the values that are not texts.
fn counted(column: &Column, cells: &[Cell]) -> Vec<(Cell, usize)> {
    let mut texts = vec![0_usize; column.texts.len()];
    let mut others: Vec<Cell> = Vec::new();
    for cell in cells {
        match cell {
            Cell::Missing => {}
            Cell::Text(text) => texts[*text as usize] += 1,
            other => others.push(*other),
        }
    }
    others.sort_unstable_by(|a, b| order(column, a, b));
    let runs = others.chunk_by(|a, b| order(column, a, b).is_eq());
    let texts = texts.into_iter().enumerate().filter(|(_, count)| *count > 0);
    let texts = texts.map(|(text, count)| (Cell::Text(text as u32), count));
    runs.map(|run| (run[0], run.len())).chain(texts).collect()
}

/// The most frequent of different values; equally frequent ones in ascending order: booleans, numbers, times, texts.
fn frequent(column: &Column, mut counted: Vec<(Cell, usize)>, most: usize) -> Vec<(String, usize)> {
    let order = |(a, i): &(Cell, usize), (b, k): &(Cell, usize)| k.cmp(i).then_with(|| order(column, a, b));
    if most < counted.len() {
        counted.select_nth_unstable_by(most, order);
        counted.truncate(most);
    }
    counted.sort_unstable_by(order);
    counted.into_iter().map(|(cell, count)| (text_of(column, cell), count)).collect()
}

/// Order of values of a column.
fn order(column: &Column, a: &Cell, b: &Cell) -> Ordering {
    let kind = |cell: &Cell| match cell {
        Cell::Missing => 0,
        Cell::Flag(_) => 1,
        Cell::Number(_) => 2,
        Cell::Time(_) => 3,
        Cell::Text(_) => 4,
    };
    match (a, b) {
        (Cell::Number(a), Cell::Number(b)) => a.total_cmp(b),
        (Cell::Flag(a), Cell::Flag(b)) => a.cmp(b),
        (Cell::Time(a), Cell::Time(b)) => a.cmp(b),
        (Cell::Text(a), Cell::Text(b)) => column.texts[*a as usize].cmp(&column.texts[*b as usize]),
        _ => kind(a).cmp(&kind(b)),
    }
}

/// A value as filters compare it.
fn text_of(column: &Column, cell: Cell) -> String {
    match cell {
        Cell::Missing => String::new(),
        Cell::Flag(flag) => flag.to_string(),
        Cell::Number(number) => number_text(number),
        Cell::Time(ms) => rfc3339(ms),
        Cell::Text(text) => column.texts[text as usize].to_string(),
    }
}

/// A number as filters compare it.
pub(super) fn number_text(number: f64) -> String {
    let is_whole = number.fract() == 0.0 && number.abs() <= LARGEST_WHOLE as f64;
    if is_whole { format!("{number:.0}") } else { serde_json::Value::from(number).to_string() }
}

impl Distribution {
    /// Distribution of the values; `None` if there are none.
    fn of(mut values: Vec<f64>, bins: usize) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let (&low, &high) = (values.first()?, values.last()?);
        let count = values.len() as f64;
        let quantile = |probability: f64| {
            let place = probability * (count - 1.0);
            let below = place as usize;
            let above = (below + 1).min(values.len() - 1);
            lerp(values[below], values[above], place - below as f64)
        };
        // Ascending, also where rounding exceeds the width of a bin.
        let rising = |least: &mut f64, edge: usize| {
            *least = lerp(low, high, edge as f64 / bins as f64).clamp(*least, high);
            Some(*least)
        };
        let edges: Vec<f64> = (0..=bins).scan(low, rising).collect();
        let until = |edge: f64| values.partition_point(|value| *value < edge);
        let mut starts: Vec<usize> = edges.iter().map(|&edge| until(edge)).collect();
        if let Some(last) = starts.last_mut() {
            *last = values.len();
        }
        Some(Self {
            range: [low, high],
            // Divided before the sum, which may leave the range of numbers.
            mean: values.iter().map(|value| value / count).sum(),
            quantiles: PROBABILITIES.map(quantile),
            counts: starts.windows(2).map(|pair| pair[1] - pair[0]).collect(),
            edges,
        })
    }
}

/// Between `a` and `b`, without leaving the range of numbers.
fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a * (1.0 - t) + b * t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distributions_by_hand() {
        let found = Distribution::of(vec![3.0, 1.0, 2.0, 4.0, 5.0], 2).unwrap();
        assert_eq!((found.range, found.mean, found.quantiles[2]), ([1.0, 5.0], 3.0, 3.0));
        assert!(found.quantiles[1] == 2.0 && (found.quantiles[0] - 1.2).abs() < 1e-12);
        assert_eq!((found.edges, found.counts), (vec![1.0, 3.0, 5.0], vec![2, 3]));
        let equal = Distribution::of(vec![2.0; 4], 3).unwrap();
        assert_eq!(equal.counts.iter().sum::<usize>(), 4);
        for value in [0.3, 1.0 / 3.0, 1e300, -7.1] {
            let narrow = Distribution::of(vec![value, value * (1.0 + f64::EPSILON)], 1000).unwrap();
            assert_eq!((narrow.counts.iter().sum::<usize>(), narrow.edges.is_sorted()), (2, true));
        }
        let wide = Distribution::of(vec![-1.7e308, 1.7e308], 4).unwrap();
        assert!(wide.edges.iter().chain(&wide.quantiles).all(|value| value.is_finite()) && wide.mean == 0.0);
        assert_eq!(Distribution::of(Vec::new(), 3), None);
    }

    #[test]
    fn values_of_several_types_are_texts() {
        let kind = |cells: &[Cell]| value_type(cells.iter().copied());
        assert_eq!(kind(&[Cell::Missing, Cell::Number(1.0)]), ValueType::Number);
        assert_eq!(kind(&[Cell::Flag(true), Cell::Number(1.0)]), ValueType::Text);
        assert_eq!(kind(&[Cell::Number(1.0), Cell::Text(0)]), ValueType::Text);
        assert_eq!(kind(&[Cell::Missing]), ValueType::Text);
    }

    #[test]
    fn frequent_values_come_first_and_equally_frequent_ones_ascend() {
        let column = Column::of_all(&[], &["b", "a"]);
        let numbers = [10.0, 9.0, -1.0, 9.0, 10.0].map(Cell::Number);
        let others = [Cell::Text(0), Cell::Text(1), Cell::Missing, Cell::Flag(true)];
        let cells: Vec<Cell> = numbers.into_iter().chain(others).collect();
        let all = [("9", 2), ("10", 2), ("true", 1), ("-1", 1), ("a", 1), ("b", 1)];
        let all = all.map(|(text, count)| (text.to_owned(), count));
        for most in 0..8 {
            let found = frequent(&column, counted(&column, &cells), most);
            assert_eq!(found, all[..most.min(all.len())], "{most}");
        }
    }

    #[test]
    fn numbers_are_written_as_they_were_posted() {
        let largest = LARGEST_WHOLE as f64;
        assert_eq!(
            [3.0, -0.5, 1e15, largest].map(number_text),
            ["3", "-0.5", "1000000000000000", "9007199254740991"]
        );
    }
}
