//! A shape as JSON.
//!
//! ```json
//! {"points": [[0, 0], [2, 0], [2, 1]], "external_id": "scan-17", "label": "control", "labels": {"age": 61}}
//! ```
//!
//! Lists of points are read into one flat array; what is wrong in them is collected, not only the first
//! fault, and nothing but finite numbers gets through.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use super::InputError;
use super::checked::{Checked, document, visit_others};

/// Largest coordinate in magnitude: squares, areas and their sums stay finite.
pub const MAX_COORDINATE: f64 = 1e100;

/// Faults kept per list of points.
const MAX_FAULTS: usize = 20;

/// Points as rows of coordinates, read leniently: faults are kept beside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointList {
    coordinates: Vec<f64>,
    /// Coordinates of the first row.
    width: usize,
    rows: usize,
    null: bool,
    faults: Vec<InputError>,
}

impl PointList {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// Whether there is a `null` instead of a list.
    pub fn is_null(&self) -> bool {
        self.null
    }

    /// Coordinates of the first point.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Row-major coordinates, when every row has `dimension` finite numbers.
    ///
    /// # Errors
    /// All faults (at most 20) with pointers relative to the list.
    pub fn checked(&self, dimension: usize) -> Result<&[f64], Vec<InputError>> {
        if !self.faults.is_empty() {
            return Err(self.faults.clone());
        }
        if self.rows > 0 && self.width != dimension {
            let detail = format!(
                "points have {} coordinates, the representation has dimension {dimension}",
                self.width
            );
            return Err(vec![InputError::new("/0", detail)]);
        }
        Ok(&self.coordinates)
    }

    fn fault(&mut self, pointer: String, detail: String) {
        if self.faults.len() < MAX_FAULTS {
            self.faults.push(InputError::new(pointer, detail));
        }
    }

    fn push_row(&mut self, row: &Row) {
        let position = self.rows;
        self.rows += 1;
        for (column, detail) in &row.faults {
            self.fault(format!("/{position}/{column}"), detail.clone());
        }
        if let Some(detail) = &row.not_a_row {
            self.fault(format!("/{position}"), detail.clone());
            return;
        }
        if position == 0 {
            self.width = row.values.len();
        }
        if row.values.len() != self.width {
            let detail =
                format!("has {} coordinates where the first point has {}", row.values.len(), self.width);
            self.fault(format!("/{position}"), detail);
        }
        self.coordinates.extend_from_slice(&row.values);
    }
}

impl<'de> Deserialize<'de> for PointList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ListVisitor;
        impl<'de> Visitor<'de> for ListVisitor {
            type Value = PointList;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of points such as [[0, 0], [1, 0]]")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<PointList, A::Error> {
                let mut list = PointList::default();
                let mut row = Row::default();
                while rows.next_element_seed(RowSeed(&mut row))?.is_some() {
                    list.push_row(&row);
                }
                Ok(list)
            }

            fn visit_unit<E>(self) -> Result<PointList, E> {
                Ok(PointList { null: true, ..PointList::default() })
            }

            visit_others!(@text not_a_list, PointList);
            visit_others!(@number not_a_list, PointList);
            visit_others!(@map not_a_list, PointList);
        }
        fn not_a_list(_: ListVisitor, what: &'static str) -> PointList {
            let mut list = PointList::default();
            list.fault(String::new(), format!("is {what}, not a list of points"));
            list
        }
        deserializer.deserialize_any(ListVisitor)
    }
}

/// One row, reused: a list of a thousand points allocates a few times, not a thousand.
#[derive(Default)]
struct Row {
    values: Vec<f64>,
    faults: Vec<(usize, String)>,
    not_a_row: Option<String>,
}

struct RowSeed<'a>(&'a mut Row);

impl<'de> serde::de::DeserializeSeed<'de> for RowSeed<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        self.0.values.clear();
        self.0.faults.clear();
        self.0.not_a_row = None;
        deserializer.deserialize_any(self)
    }
}

fn not_a_row(seed: RowSeed<'_>, what: &'static str) {
    seed.0.not_a_row = Some(format!("is {what}, not a list of coordinates"));
}

impl<'de> Visitor<'de> for RowSeed<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of coordinates")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut coordinates: A) -> Result<(), A::Error> {
        let mut column = 0;
        while let Some(coordinate) = coordinates.next_element::<Coordinate>()? {
            match coordinate {
                Coordinate::Number(value) if value.is_finite() && value.abs() <= MAX_COORDINATE => {
                    self.0.values.push(value);
                }
                Coordinate::Number(value) => {
                    self.0.faults.push((column, format!("is {value:e}, beyond ±{MAX_COORDINATE:e}")));
                    self.0.values.push(0.0);
                }
                Coordinate::Other(what) => {
                    self.0.faults.push((column, format!("is {what}, not a number")));
                    self.0.values.push(0.0);
                }
            }
            column += 1;
        }
        Ok(())
    }

    visit_others!(@text not_a_row, ());
    visit_others!(@null not_a_row, ());
    visit_others!(@number not_a_row, ());
    visit_others!(@map not_a_row, ());
}

enum Coordinate {
    Number(f64),
    Other(&'static str),
}

impl<'de> Deserialize<'de> for Coordinate {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct CoordinateVisitor;
        impl<'de> Visitor<'de> for CoordinateVisitor {
            type Value = Coordinate;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Coordinate, E> {
                Ok(Coordinate::Number(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Coordinate, E> {
                Ok(Coordinate::Number(value as f64))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Coordinate, E> {
                Ok(Coordinate::Number(value as f64))
            }

            visit_others!(@text not_a_number, Coordinate);
            visit_others!(@null not_a_number, Coordinate);
            visit_others!(@seq not_a_number, Coordinate);
            visit_others!(@map not_a_number, Coordinate);
        }
        fn not_a_number(_: CoordinateVisitor, what: &'static str) -> Coordinate {
            Coordinate::Other(what)
        }
        deserializer.deserialize_any(CoordinateVisitor)
    }
}

document! {
    /// A shape as it is posted.
    pub struct ShapeInput {
        /// Points on the shape, one list of coordinates each.
        #[schema(value_type = Option<Vec<Vec<f64>>>, example = json!([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]))]
        points: PointList;
        /// Coefficients of the representation, instead of points.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        control_points: PointList;
        /// The client's own identifier, unique in a cohort; `id` is read too.
        #[schema(value_type = Option<String>)]
        external_id or "id": Checked<Option<String>>;
        /// Opaque identifier of the subject; never a name.
        #[schema(value_type = Option<String>)]
        subject: Checked<Option<String>>;
        /// Class.
        #[schema(value_type = Option<String>)]
        label: Checked<Option<String>>;
        /// Further attributes: texts, numbers or truth values.
        #[schema(value_type = Option<Object>)]
        labels: Checked<BTreeMap<String, serde_json::Value>>;
        /// Positive weight in means, 1 unless given.
        #[schema(value_type = Option<f64>)]
        weight: Checked<Option<f64>>;
        /// Anything to be found again.
        #[schema(value_type = Option<Object>)]
        metadata: serde_json::Value;
        /// Whether the points go round; must agree with the representation.
        #[schema(value_type = Option<bool>)]
        closed: Checked<Option<bool>>;
        /// Positions of homologous points, kept with the metadata.
        #[schema(value_type = Option<Vec<usize>>)]
        landmark_index: serde_json::Value;
        /// Coordinates of homologous points, kept with the metadata.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        landmarks: serde_json::Value;
    }
}

/// Points as they are answered: one list of coordinates each.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    dimension: usize,
    coordinates: Vec<f64>,
}

impl utoipa::PartialSchema for Points {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        <Vec<Vec<f64>> as utoipa::PartialSchema>::schema()
    }
}

impl utoipa::ToSchema for Points {}

impl Points {
    /// From `d·N` coordinate-major numbers.
    pub fn from_columns(coordinates: Vec<f64>, dimension: usize) -> Self {
        Self { dimension, coordinates }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.coordinates.len() / self.dimension.max(1)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Coordinates of one point.
    pub fn row(&self, k: usize) -> Vec<f64> {
        let n = self.len();
        (0..self.dimension).map(|c| self.coordinates[c * n + k]).collect()
    }
}

impl Serialize for Points {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        struct RowView<'a>(&'a Points, usize);
        impl Serialize for RowView<'_> {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let n = self.0.len();
                serializer.collect_seq((0..self.0.dimension).map(|c| self.0.coordinates[c * n + self.1]))
            }
        }
        serializer.collect_seq((0..self.len()).map(|k| RowView(self, k)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> PointList {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn rows_become_flat_numbers() {
        let list = read("[[1, 2.5], [-3e1, 4]]");
        assert_eq!(list.checked(2).unwrap(), &[1.0, 2.5, -30.0, 4.0]);
        assert_eq!(list.len(), 2);
        assert!(list.checked(3).is_err());
    }

    #[test]
    fn every_fault_is_named() {
        let faults = read(r#"[[1, 2], [3], [4, "x"], null, {"a": [1]}, [5, 1e101], [6, [7]], 8]"#)
            .checked(2)
            .unwrap_err();
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/1", "/2/1", "/3", "/4", "/5/1", "/6/1", "/7"]);
    }

    #[test]
    fn faults_are_bounded() {
        let text = format!("[{}]", vec!["null"; 1000].join(","));
        assert_eq!(read(&text).checked(2).unwrap_err().len(), MAX_FAULTS);
    }

    #[test]
    fn points_come_back_as_rows() {
        let points = Points::from_columns(vec![1.0, 2.0, 3.0, 4.0], 2);
        assert_eq!(serde_json::to_string(&points).unwrap(), "[[1.0,3.0],[2.0,4.0]]");
    }
}
