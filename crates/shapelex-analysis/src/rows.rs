//! Control points as rows, the form in which records and documents carry them.

/// A row of control points. Types with a schema write it out: that of an alias would have the name `Vec`.
pub type Row = Vec<f64>;

/// Rows of control points from `d·N` coordinate-major numbers.
pub fn rows_of(columns: &[f64], dimension: usize) -> Vec<Row> {
    let n = columns.len() / dimension;
    (0..n).map(|k| (0..dimension).map(|c| columns[c * n + k]).collect()).collect()
}

/// `d·N` coordinate-major numbers from rows of control points.
pub fn columns_of(rows: &[Row], dimension: usize) -> Vec<f64> {
    (0..dimension).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}
