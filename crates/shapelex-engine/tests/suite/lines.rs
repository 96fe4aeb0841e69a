//! Shapes as lines of JSON.

use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::ingest::{ingest, read_description};

use crate::support::in_memory;

/// As the service answers `GET /v1/cohorts/{cohort}`.
const COHORT: &str = r#"{"id": "coh_1", "name": "two", "description": null,
  "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "cubic"}},
  "correspondence": "arc_length", "direction": "given", "mirror": "forbid", "length_unit": "mm", "revision": 7,
  "shape_count": 2, "created_at": "2026-11-01T00:00:00Z", "updated_at": "2026-11-02T00:00:00Z"}"#;

const FIRST: &str = r#"{"id": "shp_1", "external_id": "scan-1", "subject": null, "label": "a", "labels": {"age": 3},
  "weight": 2.0, "metadata": {"x": [1]}, "measures": {"points": 4, "area": 1.5, "self_intersecting": false},
  "control_points": [[0, 1], [2, 3], [4.5, 5], [6, 7]], "created_at": "2026-11-01T00:00:00Z"}"#;

async fn read(lines: &str) -> Result<Revision, String> {
    let (_, objects) = in_memory();
    let cohort = read_description(COHORT.as_bytes()).unwrap();
    let writer = Writer::begin(objects.clone(), cohort, false).await.unwrap();
    ingest(lines.as_bytes(), writer).await.map_err(|error| error.to_string())?;
    Revision::open(objects, "coh_1", 7).await.map_err(|error| error.to_string())
}

fn one_line(text: &str) -> String {
    text.replace('\n', " ")
}

#[tokio::test]
async fn points_become_coordinates_one_after_the_other() {
    let second = r#"{"id": "shp_2", "control_points": [[1, 0], [0, 1], [-1, 0], [0, -1]]}"#;
    let revision = read(&format!("{}\n\n{second}", one_line(FIRST))).await.unwrap();
    let numbers = revision.read(0, &[]).await.unwrap();
    let expected = [[0.0, 2.0, 4.5, 6.0, 1.0, 3.0, 5.0, 7.0], [1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, -1.0]];
    assert_eq!(numbers.control_points, expected.concat());
    assert_eq!(numbers.weights, [2.0, 1.0]);
}

#[tokio::test]
async fn lines_that_are_no_shapes_of_the_cohort_are_refused_by_number() {
    let first = one_line(FIRST);
    for (line, expected) in [
        ("nonsense", "line 2: expected a shape, got expected ident at line 1"),
        (r#"{"id": "x", "control_points": [[1, 2]]}"#, "line 2: expected 4 control points, got 1"),
        (
            r#"{"id": "x", "control_points": [[1, 2], [1, 2, 3], [1, 2], [1, 2]]}"#,
            "line 2: expected 2 coordinates of a control point, got 3",
        ),
        (
            r#"{"id": "x", "weight": 0, "control_points": [[1, 2], [1, 2], [1, 2], [1, 2]]}"#,
            "line 2: expected a positive weight, got 0",
        ),
        (
            r#"{"id": "x", "colour": 1, "control_points": []}"#,
            "line 2: expected a shape, got unknown field `colour`",
        ),
        (
            r#"{"id": "x", "control_points": [[1e999, 2]]}"#,
            "line 2: expected a shape, got number out of range",
        ),
        ("", "number of shapes: expected 2 (shape_count of the cohort), got 1"),
    ] {
        let error = read(&format!("{first}\n{line}\n")).await.unwrap_err();
        assert!(error.starts_with(expected), "{error}");
    }
    let long = format!("{first}\n{}", " ".repeat((2 << 20) + 1));
    assert_eq!(read(&long).await.unwrap_err(), "line 2: expected at most 2097152 bytes, got more");
}

#[test]
fn a_description_that_is_none_is_refused() {
    for (from, to, expected) in [
        ("\"revision\": 7,", "", "cohort: expected a cohort, got missing field `revision`"),
        ("coh_1", "../x", "id: expected 1 to 100 letters"),
        ("\"control_points\": 4", "\"control_points\": 2", "representation/control_points: expected"),
        ("\"mirror\"", "\"mirrors\"", "cohort: expected a cohort, got unknown field `mirrors`"),
    ] {
        let error = read_description(COHORT.replace(from, to).as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}
