//! Other programs read the parts: pyarrow, pandas, DuckDB.

use std::path::PathBuf;
use std::process::Command;

use shapelex_analysis::accumulate::PART;
use shapelex_engine::location::open;
use shapelex_engine::objects::{Objects, Patience};

use crate::support::{WIDTH, triangle, write};

/// Python with pyarrow, pandas, duckdb and moto, as `make test-engine` prepares it.
const PYTHON: &str = "SHAPELEX_ENGINE_PYTHON";

/// That Python, or a visible note that a test is skipped.
pub(crate) fn python(skipped: &str) -> Option<PathBuf> {
    let python = std::env::var_os(PYTHON).map(PathBuf::from);
    if python.is_none() {
        // Visible in the log of the tests: libtest shows what goes to the error stream of the process itself.
        use std::io::Write;
        let _ = writeln!(std::io::stderr(), "SKIPPED: {skipped}, {PYTHON} is not set");
    }
    python
}

const SCRIPT: &str = r#"
import glob, json, sys
import duckdb, numpy, pandas, pyarrow.parquet
folder = sys.argv[1]
files = sorted(glob.glob(folder + "/*/parts/*.parquet"))

metadata = pyarrow.parquet.read_metadata(files[0]).metadata
metadata = {key.decode(): value.decode() for key, value in metadata.items() if key.startswith(b"shapelex")}

frame = pandas.concat([pandas.read_parquet(file) for file in files]).sort_values("part")
rows = numpy.concatenate([numpy.frombuffer(blob, "<f8").reshape(count, 2, -1)
                          for blob, count in zip(frame.control_points, frame.shapes)])

query = f"""
  WITH shapes AS (SELECT unnest(ids) AS id, unnest(labels) AS label, unnest(area) AS area, unnest(weights) AS weight,
                         unnest(attributes) AS attributes FROM read_parquet('{folder}/*/parts/*.parquet'))
  SELECT label, count(*), sum(area), sum(weight), sum(CAST(attributes->>'age' AS BIGINT)) FROM shapes GROUP BY label ORDER BY label
"""
groups = duckdb.sql(query).fetchall()
print(json.dumps({"metadata": metadata, "rows": rows.shape, "seventh": rows[7].ravel().tolist(),
                  "last": rows[-1].ravel().tolist(), "groups": groups, "ids": [len(ids) for ids in frame.ids]}))
"#;

#[tokio::test]
async fn python_and_duckdb_read_what_is_written() {
    let Some(python) = python("parts are not read by other programs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    let objects = Objects::new(open(path).unwrap(), Patience::default());
    let count = PART + 9;
    write(&objects, 1, 0..count).await.unwrap();
    let output = Command::new(python).args(["-c", SCRIPT, path]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let metadata =
        serde_json::json!({"shapelex.format": "1", "shapelex.points": "3", "shapelex.dimension": "2"});
    assert_eq!(found["metadata"], metadata);
    assert_eq!(found["rows"], serde_json::json!([count, 2, WIDTH / 2]));
    assert_eq!(found["ids"], serde_json::json!([PART, 9]));
    assert_eq!(found["seventh"], serde_json::json!(triangle(7).control_points));
    assert_eq!(found["last"], serde_json::json!(triangle(count - 1).control_points));
    let group = |label: Option<&str>| {
        let shapes =
            (0..count).map(|k| (k, triangle(k))).filter(|(_, shape)| shape.label.as_deref() == label);
        let mut sums = (0_u64, 0.0, 0.0, 0_u64);
        for (k, shape) in shapes {
            sums.0 += 1;
            sums.1 += shape.measures.area.unwrap();
            sums.2 += shape.weight;
            sums.3 += if shape.attributes.is_some() { k as u64 } else { 0 };
        }
        serde_json::json!([label, sums.0, sums.1, sums.2, sums.3])
    };
    assert_eq!(found["groups"], serde_json::json!([group(Some("a")), group(Some("b")), group(None)]));
}
