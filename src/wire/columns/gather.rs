//! Rows and columns of an answer of JSON.

use std::collections::{BTreeMap, HashMap};

use serde_json::Value;

use super::{ANSWER, Column};

/// Depth of nested fields.
const MAX_DEPTH: usize = 16;

/// A row of a table: a value, and the positions of the lists that it is in.
pub(super) struct Row<'a> {
    pub(super) positions: Vec<(String, usize)>,
    pub(super) value: &'a Value,
}

/// Values of a cell.
#[derive(Clone, Copy)]
pub(super) enum Cell<'a> {
    Position(usize),
    Value(&'a Value),
}

/// Cells by the names of their columns, in the order in which these came up.
#[derive(Default)]
pub(super) struct Gathered<'a> {
    names: Vec<String>,
    cells: HashMap<String, Vec<(usize, Cell<'a>)>>,
    values: usize,
}

impl<'a> Gathered<'a> {
    pub(super) fn put(&mut self, row: usize, name: &str, cell: Cell<'a>) {
        self.values += 1;
        if let Some(cells) = self.cells.get_mut(name) {
            cells.push((row, cell));
            return;
        }
        self.names.push(name.to_owned());
        self.cells.insert(name.to_owned(), vec![(row, cell)]);
    }

    /// Numbers of columns and of values.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.names.len(), self.values)
    }

    pub(super) fn columns(self, rows: usize) -> Vec<(String, Column)> {
        let Self { names, cells, .. } = self;
        let column = |name: String| {
            let cells = cells.get(&name).map(Vec::as_slice).unwrap_or_default();
            let column = column_of(cells, rows);
            (name, column)
        };
        names.into_iter().map(column).collect()
    }
}

/// Collects the rows of the list at a path. Returns whether there is one.
pub(super) fn collect<'a>(
    value: &'a Value,
    path: &[&str],
    positions: &mut Vec<(String, usize)>,
    rows: &mut Vec<Row<'a>>,
) -> bool {
    match (value, path) {
        (Value::Object(_), []) => {
            rows.push(Row { positions: positions.clone(), value });
            true
        }
        (Value::Array(items), []) => {
            rows.extend(items.iter().map(|value| Row { positions: positions.clone(), value }));
            true
        }
        (Value::Object(fields), [first, rest @ ..]) => {
            let Some(inner) = fields.get(*first) else { return false };
            if let (Value::Array(items), false) = (inner, rest.is_empty()) {
                let mut found = items.is_empty();
                for (k, item) in items.iter().enumerate() {
                    positions.push(((*first).to_owned(), k));
                    found |= collect(item, rest, positions, rows);
                    positions.pop();
                }
                return found;
            }
            collect(inner, rest, positions, rows)
        }
        _ => false,
    }
}

/// Whether a value is a list of objects, or of lists of something else than numbers.
pub(super) fn is_table(value: &Value) -> bool {
    matches!(value, Value::Array(items) if items.iter().any(Value::is_object))
}

/// Gives every field of an object by its path; any other value by the given name.
pub(super) fn flatten<'a>(value: &'a Value, name: &str, depth: usize, give: &mut dyn FnMut(&str, &'a Value)) {
    match value {
        Value::Object(fields) if depth < MAX_DEPTH && !fields.is_empty() => {
            for (field, value) in fields {
                let name = if depth == 0 { field.clone() } else { format!("{name}.{field}") };
                flatten(value, &name, depth + 1, give);
            }
        }
        value => give(name, value),
    }
}

/// Single values of an answer by their path, and lists of texts.
pub(super) fn facts_of(value: &Value, name: &str, depth: usize, facts: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(fields) if depth < MAX_DEPTH => {
            for (field, value) in fields {
                let name = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
                facts_of(value, &name, depth + 1, facts);
            }
        }
        Value::Array(items) if !items.is_empty() && items.iter().all(Value::is_string) => {
            facts.insert(name.to_owned(), value.to_string());
        }
        Value::String(text) => {
            facts.insert(name.to_owned(), text.clone());
        }
        Value::Number(_) | Value::Bool(_) => {
            facts.insert(name.to_owned(), value.to_string());
        }
        _ => {}
    }
}

/// Names of the tables of an answer.
pub(super) fn tables_of(answer: &Value) -> Vec<String> {
    let mut names = vec![ANSWER.to_owned()];
    lists_of(answer, "", 0, &mut names);
    names[1..].sort();
    names
}

fn lists_of(value: &Value, name: &str, depth: usize, names: &mut Vec<String>) {
    match value {
        Value::Object(fields) if depth < MAX_DEPTH => {
            for (field, value) in fields {
                let name = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
                lists_of(value, &name, depth + 1, names);
            }
        }
        Value::Array(items) => {
            names.push(name.to_owned());
            if let Some(Value::Object(fields)) = items.first() {
                let inner = fields.iter().filter(|(_, value)| is_table(value));
                names.extend(inner.map(|(field, _)| format!("{name}.{field}")));
            }
        }
        _ => {}
    }
}

fn column_of(cells: &[(usize, Cell<'_>)], rows: usize) -> Column {
    let values = || {
        cells.iter().filter_map(|(_, cell)| match cell {
            Cell::Value(value) if !value.is_null() => Some(*value),
            _ => None,
        })
    };
    let positions = cells.iter().any(|(_, cell)| matches!(cell, Cell::Position(_)));
    if positions || values().all(Value::is_number) {
        let mut numbers = vec![f64::NAN; rows];
        for (row, cell) in cells {
            match cell {
                // Positions of lists in memory are exact.
                Cell::Position(position) => numbers[*row] = *position as f64,
                Cell::Value(value) => numbers[*row] = value.as_f64().unwrap_or(f64::NAN),
            }
        }
        return Column::Numbers(numbers);
    }
    let filled = |give: &mut dyn FnMut(usize, &Value)| {
        for (row, cell) in cells {
            if let Cell::Value(value) = cell {
                give(*row, value);
            }
        }
    };
    if values().all(Value::is_boolean) {
        let mut flags = vec![None; rows];
        filled(&mut |row, value| flags[row] = value.as_bool());
        return Column::Flags(flags);
    }
    if let Some(lists) = values().all(Value::is_array).then(|| lists_column(cells, rows)).flatten() {
        return lists;
    }
    let all_texts = values().all(Value::is_string);
    let mut texts = vec![None; rows];
    filled(&mut |row, value| {
        texts[row] = match value {
            Value::Null => None,
            Value::String(text) if all_texts => Some(text.clone()),
            value => Some(value.to_string()),
        };
    });
    Column::Texts(texts)
}

/// A column of lists of numbers whose elements all have one shape.
fn lists_column(cells: &[(usize, Cell<'_>)], rows: usize) -> Option<Column> {
    let mut found: Vec<Option<Vec<f64>>> = vec![None; rows];
    let mut item: Option<Vec<usize>> = None;
    for (row, cell) in cells {
        let Cell::Value(Value::Array(items)) = cell else { continue };
        let mut values = Vec::new();
        for value in items {
            let shape = regular(value, 0, &mut values)?;
            if *item.get_or_insert_with(|| shape.clone()) != shape {
                return None;
            }
        }
        found[*row] = Some(values);
    }
    let (mut values, mut ends, mut valid) = (Vec::new(), Vec::new(), Vec::new());
    for list in found {
        valid.push(list.is_some());
        values.extend(list.unwrap_or_default());
        ends.push(values.len());
    }
    Some(Column::Lists { values, ends, valid, item: item.unwrap_or_default() })
}

/// Shape of a regular nested list of numbers, whose numbers go to `values`; a missing number is NaN.
fn regular(value: &Value, depth: usize, values: &mut Vec<f64>) -> Option<Vec<usize>> {
    match value {
        Value::Number(number) => {
            values.push(number.as_f64()?);
            Some(Vec::new())
        }
        Value::Null => {
            values.push(f64::NAN);
            Some(Vec::new())
        }
        Value::Array(items) if depth < MAX_DEPTH && !items.is_empty() => {
            let mut inner: Option<Vec<usize>> = None;
            for item in items {
                let shape = regular(item, depth + 1, values)?;
                if *inner.get_or_insert_with(|| shape.clone()) != shape {
                    return None;
                }
            }
            Some([&[items.len()][..], inner.unwrap_or_default().as_slice()].concat())
        }
        _ => None,
    }
}
