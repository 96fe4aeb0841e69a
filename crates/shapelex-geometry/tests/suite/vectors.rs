//! Loader of the stored vectors: numbers are decimal strings or fractions `"p/q"`.

use std::path::PathBuf;

use serde_json::Value;
use shapelex_geometry::generator::Poles;
use shapelex_numeric::dense::Matrix;

/// The document `tests/vectors/<path>`.
pub(crate) fn load(path: &str) -> Value {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors").join(path);
    let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// The members of an array.
pub(crate) fn list(value: &Value) -> &[Value] {
    value.as_array().unwrap_or_else(|| panic!("not a list: {value}"))
}

/// The `cases` of a document, at least one.
pub(crate) fn cases(document: &Value) -> &[Value] {
    let cases = list(&document["cases"]);
    assert!(!cases.is_empty());
    cases
}

/// A text member.
pub(crate) fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_else(|| panic!("not a text: {value}"))
}

/// One number: JSON number, decimal string or `"p/q"`.
pub(crate) fn number(value: &Value) -> f64 {
    if let Some(number) = value.as_f64() {
        return number;
    }
    let text = text(value);
    let parse = |s: &str| -> f64 { s.parse().unwrap_or_else(|_| panic!("not a number: {text}")) };
    match text.split_once('/') {
        Some((p, q)) => parse(p) / parse(q),
        None => parse(text),
    }
}

/// An array of numbers.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    list(value).iter().map(number).collect()
}

/// An array of equally long rows.
pub(crate) fn matrix(value: &Value) -> Matrix {
    let rows: Vec<Vec<f64>> = list(value).iter().map(numbers).collect();
    Matrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

/// `{q, pi}`: the rational `q`, times π if `pi`.
fn pole(value: &Value) -> f64 {
    let unit = if value["pi"].as_bool().unwrap() { std::f64::consts::PI } else { 1.0 };
    number(&value["q"]) * unit
}

/// A pole list.
pub(crate) fn poles(value: &Value) -> Poles {
    let mut poles = Poles::zeros(value["zeros"].as_u64().unwrap() as usize);
    for pair in list(&value["pairs"]) {
        match text(&pair["kind"]) {
            "t" => poles.trigonometric.push(pole(pair)),
            "h" => poles.hyperbolic.push(pole(pair)),
            kind => panic!("unknown pair {kind}"),
        }
    }
    if let Some(quads) = value.get("quads") {
        for quad in list(quads) {
            poles.quadruples.push((pole(&quad["a"]), pole(&quad["b"])));
        }
    }
    poles
}

/// Fails unless `found` and `wanted` differ by at most `tolerance` times the largest entry wanted, or
/// absolutely where all entries are below 1.
#[track_caller]
pub(crate) fn assert_close(what: &str, found: &[f64], wanted: &[f64], tolerance: f64) {
    assert_eq!(found.len(), wanted.len(), "{what}: number of entries");
    let scale = wanted.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    for (i, (f, w)) in found.iter().zip(wanted).enumerate() {
        let error = (f - w).abs();
        assert!(
            error <= tolerance * scale,
            "{what}[{i}]: {f:e} for {w:e}, error {error:.1e}, allowed {:.1e}",
            tolerance * scale
        );
    }
}
