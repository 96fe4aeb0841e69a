//! Square matrices as JSON, CSV and NPY, written row by row, so that the text of a whole matrix is never in memory.
//!
//! * JSON — `{"ids": […], "labels": […], "distances": [[…], …]}`, preceded by further fields;
//! * CSV (RFC 4180) — a line of ids, then one line of numbers per row;
//! * NPY (version 1.0) — little-endian `f64` in C order, readable by `numpy.load`.
//!
//! Numbers in text formats have as many digits as needed to read back the same bits.

use serde_json::{Map, Value};

use super::table::quoted;

/// File format of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MatrixFormat {
    /// JSON object.
    Json,
    /// Comma-separated values.
    Csv,
    /// NumPy binary format.
    Npy,
}

/// A square matrix with row names.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedMatrix {
    /// Additional fields of the JSON object.
    pub fields: Map<String, Value>,
    /// Name of each row and column.
    pub ids: Vec<String>,
    /// Label of each row and column, if it has one.
    pub labels: Vec<Option<String>>,
    /// Values, row by row.
    pub values: Vec<f64>,
}

impl MatrixFormat {
    /// Media type of the format.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Npy => "application/x-npy",
        }
    }
}

impl NamedMatrix {
    /// Writes the file in pieces of about one row each.
    pub fn pieces(self, format: MatrixFormat) -> impl Iterator<Item = Vec<u8>> + Send + 'static {
        let size = self.ids.len();
        (0..size + 2).map(move |piece| match piece {
            0 => self.head(format),
            last if last == size + 1 => tail(format),
            row => write_row(format, row == 1, &self.values[(row - 1) * size..row * size]),
        })
    }

    fn head(&self, format: MatrixFormat) -> Vec<u8> {
        match format {
            MatrixFormat::Json => {
                let mut head = self.fields.clone();
                head.insert("ids".into(), Value::from(self.ids.clone()));
                head.insert("labels".into(), Value::from(self.labels.clone()));
                let mut text = Value::from(head).to_string();
                text.pop();
                text.push_str(",\"distances\":[");
                text.into_bytes()
            }
            MatrixFormat::Csv => {
                let ids: Vec<String> = self.ids.iter().map(|id| quoted(id)).collect();
                (ids.join(",") + "\r\n").into_bytes()
            }
            MatrixFormat::Npy => npy_head(self.ids.len()),
        }
    }
}

fn tail(format: MatrixFormat) -> Vec<u8> {
    match format {
        MatrixFormat::Json => b"]}".to_vec(),
        MatrixFormat::Csv | MatrixFormat::Npy => Vec::new(),
    }
}

fn write_row(format: MatrixFormat, first: bool, row: &[f64]) -> Vec<u8> {
    let list = || serde_json::to_vec(row).expect("numbers are JSON");
    match format {
        MatrixFormat::Json if first => list(),
        MatrixFormat::Json => [b",".as_slice(), &list()].concat(),
        MatrixFormat::Csv => {
            // A CSV line is the JSON list without its brackets.
            let list = list();
            [&list[1..list.len() - 1], b"\r\n"].concat()
        }
        MatrixFormat::Npy => row.iter().flat_map(|value| value.to_le_bytes()).collect(),
    }
}

/// NPY header of version 1.0: magic, version, length, and a Python literal, padded to a multiple of 64 bytes.
fn npy_head(size: usize) -> Vec<u8> {
    const ALIGNMENT: usize = 64;
    const BEFORE: usize = 10;
    let mut text = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({size}, {size}), }}");
    let padding = (ALIGNMENT - (BEFORE + text.len() + 1) % ALIGNMENT) % ALIGNMENT;
    text.push_str(&" ".repeat(padding));
    text.push('\n');
    let length = u16::try_from(text.len()).expect("two numbers fill no 64 KiB");
    [b"\x93NUMPY\x01\x00".as_slice(), &length.to_le_bytes(), text.as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: MatrixFormat, ids: &[&str]) -> Vec<u8> {
        let count = ids.len();
        let matrix = NamedMatrix {
            fields: [("revision".to_owned(), Value::from(3))].into_iter().collect(),
            ids: ids.iter().map(ToString::to_string).collect(),
            labels: (0..count).map(|k| (k % 2 == 0).then(|| "x".into())).collect(),
            values: (0..count * count).map(|k| k as f64 / 10.0).collect(),
        };
        matrix.pieces(format).flatten().collect()
    }

    #[test]
    fn json_is_one_object() {
        let text = written(MatrixFormat::Json, &["a", "b"]);
        let wanted = serde_json::json!({"revision": 3, "ids": ["a", "b"], "labels": ["x", null],
            "distances": [[0.0, 0.1], [0.2, 0.3]]});
        assert_eq!(serde_json::from_slice::<Value>(&text).unwrap(), wanted);
        let none: Value = serde_json::from_slice(&written(MatrixFormat::Json, &[])).unwrap();
        assert_eq!(none["distances"], serde_json::json!([]));
    }

    #[test]
    fn csv_quotes_what_must_be() {
        let text = String::from_utf8(written(MatrixFormat::Csv, &["a,1", "b\"2\""])).unwrap();
        assert_eq!(text, "\"a,1\",\"b\"\"2\"\"\"\r\n0.0,0.1\r\n0.2,0.3\r\n");
    }

    #[test]
    fn npy_is_aligned_and_tells_its_shape() {
        let bytes = written(MatrixFormat::Npy, &["a", "b", "c"]);
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let head = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(head % 64, 0);
        let text = std::str::from_utf8(&bytes[10..head]).unwrap();
        assert!(
            text.starts_with("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 3), }")
                && text.ends_with('\n')
        );
        assert_eq!(bytes.len(), head + 72);
        assert_eq!(bytes[head + 8..head + 16], 0.1_f64.to_le_bytes());
    }
}
