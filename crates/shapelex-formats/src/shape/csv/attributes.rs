//! Tables of attributes: a row for each shape, which a column names.

use std::collections::BTreeMap;

use super::super::limits::Limits;
use super::super::source::Source;
use super::super::text::{name_fits, number, shown, value};
use super::read::{Rows, separator};
use crate::error::{FileError, Place};
use crate::value::Value;

/// Names of the column that names shapes.
const NAMES: [&str; 2] = ["external_id", "id"];

/// Facts of a row about a shape. Empty fields and `NA` say nothing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AttributeRow {
    /// Line in the file, from 1.
    pub line: u64,
    /// Id or external id of the shape.
    pub name: String,
    /// Subject.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Weight in means.
    pub weight: Option<f64>,
    /// Further attributes.
    pub labels: BTreeMap<String, Value>,
}

/// Reads a table of attributes, in UTF-8, whose columns a comma, a semicolon or a tab separates. The first row names the columns: `id` or
/// `external_id`, and perhaps `subject`, `label` and `weight`; others are further attributes, with or without `labels.` before their
/// names.
///
/// # Errors
/// The line of a fault: no column that names the shapes or several, names of columns that occur twice, rows of another length, rows
/// without a name, weights that are not numbers.
pub fn attribute_rows(bytes: &[u8]) -> Result<Vec<AttributeRow>, FileError> {
    let mut source = Source::new(bytes, Limits::default())?;
    let separator = separator(source.head());
    let mut rows = Rows::new(&mut source, separator);
    if rows.next()?.is_none() {
        return Err(FileError::truncated(Place::line(1), "expected a header, got the end of the file"));
    }
    let columns: Vec<String> =
        rows.record.iter().map(|name| name.trim_matches('\u{feff}').trim().to_owned()).collect();
    let named = check(&columns)?;
    let mut found = Vec::new();
    while let Some(line) = rows.next()? {
        if rows.record.len() != columns.len() {
            let detail =
                format!("expected {} fields as in the header, got {}", columns.len(), rows.record.len());
            return Err(FileError::malformed(Place::line(line), detail));
        }
        let mut row = AttributeRow { line, ..AttributeRow::default() };
        for (k, (name, text)) in columns.iter().zip(&rows.record).enumerate() {
            let text = text.trim();
            if k == named {
                row.name = text.to_owned();
            } else if !text.is_empty() && !text.eq_ignore_ascii_case("na") {
                row.set(name, text)?;
            }
        }
        if row.name.is_empty() {
            let detail = format!("expected the {} of a shape, got an empty field", columns[named]);
            return Err(FileError::malformed(Place::line(line), detail));
        }
        found.push(row);
    }
    Ok(found)
}

/// The column that names shapes.
fn check(columns: &[String]) -> Result<usize, FileError> {
    let refused = |detail: String| Err(FileError::malformed(Place::line(1), detail));
    for (k, name) in columns.iter().enumerate() {
        if let Err(detail) = name_fits(name) {
            return refused(detail);
        }
        if name.is_empty() {
            return refused(format!("expected a name of each column, got none of column {}", k + 1));
        }
    }
    let mut sorted: Vec<&str> = columns.iter().map(|name| attribute(name)).collect();
    sorted.sort_unstable();
    if let Some(twice) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        return refused(format!("expected columns of different names, got {} twice", shown(twice[0])));
    }
    let mut named = (0..columns.len()).filter(|k| NAMES.contains(&columns[*k].to_lowercase().as_str()));
    match (named.next(), named.next()) {
        (Some(column), None) => Ok(column),
        (found, _) => {
            let got = if found.is_some() { "both" } else { "neither" };
            refused(format!("expected one column id or external_id, got {got}"))
        }
    }
}

/// Name of the attribute of a column.
fn attribute(column: &str) -> &str {
    column.strip_prefix("labels.").unwrap_or(column)
}

impl AttributeRow {
    fn set(&mut self, column: &str, text: &str) -> Result<(), FileError> {
        match column.to_lowercase().as_str() {
            "subject" => self.subject = Some(text.to_owned()),
            "label" => self.label = Some(text.to_owned()),
            "weight" => {
                let weight = number(text).map_err(|detail| {
                    let place = Place { tag: Some("column weight".into()), ..Place::line(self.line) };
                    FileError::malformed(place, detail)
                })?;
                self.weight = Some(weight);
            }
            _ => {
                self.labels.insert(attribute(column).to_owned(), value(text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> String {
        attribute_rows(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn columns_are_attributes() {
        let text =
            "\u{feff}external_id;subject;label;weight;labels.age;ward\na/1;p1;;2;61;\"B;3\"\nb;NA;x;;;\n";
        let rows = attribute_rows(text.as_bytes()).unwrap();
        assert_eq!(rows.len(), 2);
        let labels = [("age".into(), Value::Number(61.0)), ("ward".into(), Value::from("B;3"))];
        let first = AttributeRow {
            line: 2,
            name: "a/1".into(),
            subject: Some("p1".into()),
            weight: Some(2.0),
            labels: labels.into(),
            ..AttributeRow::default()
        };
        assert_eq!(rows[0], first);
        let second =
            AttributeRow { line: 3, name: "b".into(), label: Some("x".into()), ..AttributeRow::default() };
        assert_eq!(rows[1], second);
    }

    #[test]
    fn faults_name_their_line() {
        assert_eq!(fault("name,age\na,3\n"), "line 1: expected one column id or external_id, got neither");
        assert_eq!(fault("id,external_id\na,b\n"), "line 1: expected one column id or external_id, got both");
        assert_eq!(
            fault("id,age,labels.age\n"),
            "line 1: expected columns of different names, got 'age' twice"
        );
        assert_eq!(fault("id,\na,b\n"), "line 1: expected a name of each column, got none of column 2");
        assert_eq!(fault("id,age\na\n"), "line 2: expected 2 fields as in the header, got 1");
        assert_eq!(fault("id,age\n,3\n"), "line 2: expected the id of a shape, got an empty field");
        assert!(
            fault("id,weight\na,much\n").starts_with("column weight, line 2: expected"),
            "{}",
            fault("id,weight\na,much\n")
        );
        assert!(fault("").contains("expected a header"), "{}", fault(""));
    }
}
