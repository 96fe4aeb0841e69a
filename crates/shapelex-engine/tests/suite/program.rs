//! The program, on a folder.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Runs the program on the folder; its output if it succeeds, else what it says.
fn engine(folder: &Path, arguments: &[&str]) -> Result<Value, String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex-engine"));
    answer(command.arg("--store").arg(folder).args(arguments))
}

/// The output of the program if it succeeds, else what it says.
pub(crate) fn answer(command: &mut Command) -> Result<Value, String> {
    let output = command.output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    if output.status.success() {
        return Ok(serde_json::from_str(&text).unwrap_or(Value::Null));
    }
    Err(format!("{text}{}", String::from_utf8(output.stderr).unwrap()))
}

/// Writes the description of a cohort and its shapes into the folder: their paths.
pub(crate) fn fetched(folder: &Path, count: usize) -> [String; 2] {
    let cohort = serde_json::json!({"id": "coh_1", "name": "leaves",
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 5, "generator": {"name": "cubic"}},
        "correspondence": "landmarks", "direction": "given", "mirror": "forbid", "revision": 4, "shape_count": count});
    let line = |k: usize| {
        let point = |i: usize| {
            let angle = i as f64 * 1.3 + (k as f64 * 0.37).sin() * 0.1;
            [3.0 * angle.cos() + (k as f64 * 0.11).cos() * 0.2, 2.0 * angle.sin()]
        };
        let points: Vec<[f64; 2]> = (0..5).map(point).collect();
        serde_json::json!({"id": format!("shp_{k}"), "labels": {"turn": (k as f64 * 0.37).sin()}, "control_points": points}).to_string() + "\n"
    };
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_string()
    };
    [write("cohort.json", cohort.to_string()), write("shapes.ndjson", (0..count).map(line).collect())]
}

#[test]
fn a_cohort_is_written_checked_and_computed() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let count = 20_000;
    let [cohort, shapes] = fetched(folder.path(), count);
    let ingest = ["ingest", "--cohort", &cohort, "--shapes", &shapes];
    let written = engine(&store, &ingest).unwrap();
    assert_eq!((&written["shapes"], &written["parts"]), (&count.into(), &3.into()));
    let again = engine(&store, &ingest).unwrap();
    assert_eq!((&again["kept"], &again["digest"]), (&3.into(), &written["digest"]));
    assert_eq!(engine(&store, &["list"]).unwrap()[0]["revision"], 4);
    assert_eq!(engine(&store, &["check"]).unwrap()["parts"], 3);

    let run = ["run", "--cohort", "coh_1", "--components", "2"];
    let direct = engine(&store, &[&run[..], &["--direct"]].concat()).unwrap();
    assert_eq!(direct["components"].as_array().unwrap().len(), 2);
    assert_eq!(direct["revision_digest"], written["digest"]);
    for threads in ["1", "3"] {
        let found = engine(&store, &[&run[..], &["--threads", threads]].concat()).unwrap();
        assert_eq!(found["digest"], direct["digest"], "{threads} threads");
        assert_eq!(found["passes"].as_array().unwrap().len(), 3);
    }
    let predicted = engine(&store, &[&run[..], &["--dry-run"]].concat()).unwrap();
    let seconds = |i: usize| predicted["estimates"][i]["seconds"].as_f64().unwrap();
    // Three parts are three tasks: four executors are as fast as sixty-four.
    assert!(seconds(0) > seconds(1) && seconds(1) > seconds(2) && seconds(2) == seconds(6), "{predicted}");
    let rigid = [&run[..], &["--transformation", "rigid", "--alignment", "procrustes"]].concat();
    assert_ne!(engine(&store, &rigid).unwrap()["digest"], direct["digest"]);

    let regress = ["regress", "--cohort", "coh_1", "--attribute", "labels.turn", "--permutations", "19"];
    let regressed = engine(&store, &regress).unwrap();
    assert_eq!((&regressed["shape_count"], &regressed["test"]["p"]), (&count.into(), &0.05.into()));
    // The values, the mean, the sums, the permutations.
    assert_eq!(regressed["passes"].as_array().unwrap().len(), 4);

    let refused = |arguments: &[&str]| engine(&store, arguments).unwrap_err();
    let unknown = refused(&["regress", "--cohort", "coh_1", "--attribute", "turn"]);
    assert!(
        unknown.contains("'labels.<attribute>', 'measures.<measure>' or 'log_centroid_size', got 'turn'"),
        "{unknown}"
    );
    let twice = refused(&[&regress[..], &["--covariate", "labels.turn"]].concat());
    assert!(twice.contains("expected each variable once, got 'labels.turn' twice"), "{twice}");
    let unknown = refused(&["run", "--cohort", "coh_2"]);
    assert!(unknown.ends_with("cohort: expected a cohort with a revision, got 'coh_2'\n"), "{unknown}");
    let class =
        refused(&["run", "--cohort", "coh_1", "--transformation", "rigid", "--alignment", "projection"]);
    assert!(class.starts_with("shapelex-engine: "), "{class}");
    let scheme = engine(Path::new("ftp://x"), &["list"]).unwrap_err();
    assert!(scheme.contains("expected a folder") && scheme.contains("got 'ftp://x'"), "{scheme}");

    let parts = std::fs::read_dir(store.join("coh_1/parts")).unwrap();
    let part = parts.map(|part| part.unwrap().path()).max().unwrap();
    let mut bytes = std::fs::read(&part).unwrap();
    bytes[100] ^= 1;
    std::fs::write(&part, bytes).unwrap();
    let fault = refused(&["check"]);
    assert!(fault.contains("is damaged: expected digest"), "{fault}");

    assert_eq!(engine(&store, &["forget", "--cohort", "coh_1", "--revision", "4"]).unwrap(), Value::Null);
    let dry = engine(&store, &["collect", "--min-age-hours", "0", "--dry-run"]).unwrap();
    assert_eq!((&dry["removed"], &dry["named"]), (&3.into(), &0.into()));
    assert_eq!(engine(&store, &["collect"]).unwrap()["young"], 3);
    engine(&store, &["collect", "--min-age-hours", "0"]).unwrap();
    assert_eq!(std::fs::read_dir(store.join("coh_1/parts")).unwrap().count(), 0);
}
