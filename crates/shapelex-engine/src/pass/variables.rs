//! Variables of a regression: their values in the lists of a part, and the summary of all values together.

use std::collections::BTreeSet;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array, ArrayRef};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json};
use shapelex_analysis::inference::limits::MAX_LEVELS;
use shapelex_analysis::inference::regression_sums::Scale;

use crate::EngineError;
use crate::cohort::part::Numbers;

/// List of further attributes, as JSON.
const ATTRIBUTES: &str = "attributes";

/// A measure of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Number of points as received.
    Points,
    /// Centroid size.
    CentroidSize,
    /// Length of a curve.
    Length,
    /// Area.
    Area,
    /// Volume of a surface.
    Volume,
}

impl Measure {
    const ALL: [Self; 5] = [Self::Points, Self::CentroidSize, Self::Length, Self::Area, Self::Volume];

    /// Its name, which is that of its list.
    fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::CentroidSize => "centroid_size",
            Self::Length => "length",
            Self::Area => "area",
            Self::Volume => "volume",
        }
    }
}

/// A variable, by its name in the service.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Variable {
    /// `subject`.
    Subject,
    /// `label`.
    Label,
    /// `labels.<attribute>`.
    Attribute(String),
    /// `measures.<measure>`.
    Measure(Measure),
    /// `log_centroid_size`: its natural logarithm.
    LogCentroidSize,
}

impl Variable {
    /// Form that [`try_from`](Self::try_from) expects.
    const WANTED: &str =
        "expected 'subject', 'label', 'labels.<attribute>', 'measures.<measure>' or 'log_centroid_size'";

    /// The list that has its values.
    pub(crate) fn list(&self) -> &'static str {
        match self {
            Self::Subject => "subjects",
            Self::Label => "labels",
            Self::Attribute(_) => ATTRIBUTES,
            Self::Measure(measure) => measure.name(),
            Self::LogCentroidSize => Measure::CentroidSize.name(),
        }
    }
}

impl TryFrom<String> for Variable {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let measure = |name: &str| Measure::ALL.into_iter().find(|own| own.name() == name).map(Self::Measure);
        let attribute = |name: &str| (!name.is_empty()).then(|| Self::Attribute(name.into()));
        let variable = match name.as_str() {
            "subject" => Some(Self::Subject),
            "label" => Some(Self::Label),
            "log_centroid_size" => Some(Self::LogCentroidSize),
            other => match other.strip_prefix("measures.") {
                Some(name) => measure(name),
                None => other.strip_prefix("labels.").and_then(attribute),
            },
        };
        variable.ok_or_else(|| format!("{}, got '{name}'", Self::WANTED))
    }
}

impl From<Variable> for String {
    fn from(variable: Variable) -> Self {
        match variable {
            Variable::Subject => "subject".into(),
            Variable::Label => "label".into(),
            Variable::Attribute(name) => format!("labels.{name}"),
            Variable::Measure(measure) => format!("measures.{}", measure.name()),
            Variable::LogCentroidSize => "log_centroid_size".into(),
        }
    }
}

/// Value of a variable.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Number(f64),
    Text(String),
}

/// Values of covariates and attribute, the last of which must be a number: one row per shape, `None` where one is missing.
pub(crate) type Rows = Vec<Option<Vec<Value>>>;

/// Reads the values of the shapes of a part, whose lists were asked for.
///
/// # Errors
/// Lists of other types.
pub(crate) fn read(variables: &[Variable], numbers: &Numbers) -> Result<Rows, EngineError> {
    let list = |variable: &Variable| {
        let name = variable.list();
        numbers.list(name).ok_or_else(|| EngineError::refused("part", format!("expected '{name}', got none")))
    };
    let lists: Vec<&ArrayRef> = variables.iter().map(list).collect::<Result<_, _>>()?;
    let attributes = numbers.list(ATTRIBUTES);
    let row = |k: usize| -> Result<Option<Vec<Value>>, EngineError> {
        // Read once for all variables.
        let attributes = attributes.map(|list| attributes_of(list, k)).transpose()?;
        let value = |(variable, list): (&Variable, &&ArrayRef)| match variable {
            Variable::Attribute(name) => attributes.as_ref().and_then(|all| json(all.get(name)?)),
            Variable::Subject | Variable::Label => text(list, k).map(|text| Value::Text(text.into())),
            Variable::Measure(_) => number(list, k).map(Value::Number),
            Variable::LogCentroidSize => {
                number(list, k).filter(|size| *size > 0.0).map(|size| Value::Number(size.ln()))
            }
        };
        let values: Option<Vec<Value>> = variables.iter().zip(&lists).map(value).collect();
        Ok(values.filter(|values| matches!(values.last(), Some(Value::Number(_)))))
    };
    (0..numbers.weights.len()).map(row).collect()
}

fn text(list: &ArrayRef, k: usize) -> Option<&str> {
    let list = list.as_string_opt::<i32>()?;
    list.is_valid(k).then(|| list.value(k))
}

fn number(list: &ArrayRef, k: usize) -> Option<f64> {
    if !list.is_valid(k) {
        return None;
    }
    let number = list.as_primitive_opt::<Float64Type>().map(|list| list.value(k));
    number.or_else(|| list.as_primitive_opt::<Int64Type>().map(|list| list.value(k) as f64))
}

fn attributes_of(list: &ArrayRef, k: usize) -> Result<Map<String, Json>, EngineError> {
    let Some(text) = text(list, k) else { return Ok(Map::new()) };
    serde_json::from_str(text).map_err(|error| {
        EngineError::refused(
            "attributes",
            format!("expected a JSON object in shape {k} of a part, got {error}"),
        )
    })
}

fn json(value: &Json) -> Option<Value> {
    match value {
        Json::Null => None,
        Json::String(text) => Some(Value::Text(text.clone())),
        Json::Number(number) => number.as_f64().filter(|number| number.is_finite()).map(Value::Number),
        other => Some(Value::Text(other.to_string())),
    }
}

/// Summary of the values of a variable, over the shapes that have all values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Known {
    /// Whether all values are numbers.
    numeric: bool,
    /// Smallest and largest number.
    range: [f64; 2],
    /// Different values as text; more than [`MAX_LEVELS`] are not kept.
    levels: BTreeSet<String>,
}

impl Known {
    fn new() -> Self {
        Self { numeric: true, range: [f64::MAX, f64::MIN], levels: BTreeSet::new() }
    }

    fn add(&mut self, value: &Value) {
        match value {
            Value::Number(number) => self.range = [self.range[0].min(*number), self.range[1].max(*number)],
            Value::Text(_) => self.numeric = false,
        }
        if self.levels.len() <= MAX_LEVELS {
            self.levels.insert(value.to_text());
        }
    }

    fn append(&mut self, other: Self) {
        self.numeric &= other.numeric;
        self.range = [self.range[0].min(other.range[0]), self.range[1].max(other.range[1])];
        let room = (MAX_LEVELS + 1).saturating_sub(self.levels.len());
        let new: Vec<String> =
            other.levels.into_iter().filter(|level| !self.levels.contains(level)).take(room).collect();
        self.levels.extend(new);
    }
}

impl Value {
    fn to_text(&self) -> String {
        match self {
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

/// How a variable becomes columns of a design.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Columns {
    /// A number: one column.
    Number(Scale),
    /// A category: a column for every level but the first.
    Levels(Vec<String>),
}

impl Columns {
    /// Scales of the columns.
    pub(crate) fn scales(&self) -> Vec<Scale> {
        match self {
            Self::Number(scale) => vec![*scale],
            Self::Levels(levels) => {
                Scale::of(0.0, 1.0).into_iter().cycle().take(levels.len().saturating_sub(1)).collect()
            }
        }
    }

    /// The entries of a value, if it is of this kind.
    fn entries(&self, value: &Value) -> Option<Vec<f64>> {
        match (self, value) {
            (Self::Number(_), Value::Number(number)) => Some(vec![*number]),
            (Self::Number(_), Value::Text(_)) => None,
            (Self::Levels(levels), value) => {
                let own = value.to_text();
                Some(levels.iter().skip(1).map(|level| f64::from(u8::from(*level == own))).collect())
            }
        }
    }
}

/// The entries of all shapes in the columns of a design.
pub(crate) fn entries(columns: &[Columns], rows: Rows) -> Vec<Option<Vec<f64>>> {
    let entries = |values: Vec<Value>| -> Option<Vec<f64>> {
        let entries: Option<Vec<_>> =
            columns.iter().zip(&values).map(|(columns, value)| columns.entries(value)).collect();
        entries.map(|entries| entries.concat())
    };
    rows.into_iter().map(|row| row.and_then(entries)).collect()
}

/// Summary of the values of all shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Summary {
    /// Number of shapes that lack a value.
    pub(crate) missing: u64,
    /// Position of the first one of them.
    pub(crate) first_missing: Option<u64>,
    /// Smallest and largest weight of the others.
    pub(crate) weights: [f64; 2],
    /// Of each variable.
    pub(crate) known: Vec<Known>,
    /// Values of the attribute.
    #[serde(skip)]
    pub(crate) values: Vec<f64>,
}

impl Summary {
    /// Of no shapes.
    pub(crate) fn new(variables: usize) -> Self {
        Self {
            missing: 0,
            first_missing: None,
            weights: [f64::MAX, 0.0],
            known: vec![Known::new(); variables],
            values: Vec::new(),
        }
    }

    /// Of the shapes of a part, the first of which has the position `first`.
    pub(crate) fn of(variables: usize, first: usize, rows: &Rows, weights: &[f64]) -> Self {
        let mut summary = Self::new(variables);
        for (k, (row, &weight)) in rows.iter().zip(weights).enumerate() {
            let Some(row) = row else {
                summary.missing += 1;
                summary.first_missing.get_or_insert((first + k) as u64);
                continue;
            };
            summary.weights = [summary.weights[0].min(weight), summary.weights[1].max(weight)];
            summary.known.iter_mut().zip(row).for_each(|(known, value)| known.add(value));
            summary.values.extend(row.last().and_then(|value| match value {
                Value::Number(number) => Some(*number),
                Value::Text(_) => None,
            }));
        }
        summary
    }

    /// Adds the summary of the shapes that follow.
    pub(crate) fn append(&mut self, other: Self) {
        self.missing += other.missing;
        self.first_missing = self.first_missing.or(other.first_missing);
        self.weights = [self.weights[0].min(other.weights[0]), self.weights[1].max(other.weights[1])];
        self.known.iter_mut().zip(other.known).for_each(|(known, other)| known.append(other));
        self.values.extend(other.values);
    }

    /// The length of the JSON of all but the values, the JSON, the values.
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>, EngineError> {
        let head =
            serde_json::to_vec(self).map_err(|error| EngineError::refused("values", error.to_string()))?;
        let mut bytes = (head.len() as u64).to_le_bytes().to_vec();
        bytes.extend(head);
        bytes.extend(self.values.iter().flat_map(|value| value.to_le_bytes()));
        Ok(bytes)
    }

    /// Reads the output of [`to_bytes`](Self::to_bytes).
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self, EngineError> {
        let not = || EngineError::refused("values", "expected a summary of variables, got other bytes");
        let (length, rest) = bytes.split_first_chunk::<8>().ok_or_else(not)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| not())?;
        let (head, values) = rest.split_at_checked(length).ok_or_else(not)?;
        let mut summary: Self = serde_json::from_slice(head).map_err(|_| not())?;
        let (values, []) = values.as_chunks::<8>() else { return Err(not()) };
        summary.values = values.iter().map(|value| f64::from_le_bytes(*value)).collect();
        Ok(summary)
    }
}
