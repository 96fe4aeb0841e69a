//! The program, on a folder.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

/// Runs the program on the folder; its output if it succeeds, else what it says.
fn engine(folder: &Path, arguments: &[&str]) -> Result<Value, String> {
    answer(program().arg("--store").arg(folder).args(arguments))
}

/// Runs a pass on the folder: its result, or what the program says.
pub(crate) fn pass(folder: &Path, arguments: &[&str], request: &Value) -> Result<Vec<u8>, String> {
    output(program().arg("--store").arg(folder).arg("pass").args(arguments), &request.to_string())
}

pub(crate) fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_shapelex-engine"))
}

/// The output of the program if it succeeds, else what it says.
pub(crate) fn answer(command: &mut Command) -> Result<Value, String> {
    output(command, "").map(|bytes| serde_json::from_slice(&bytes).unwrap_or(Value::Null))
}

/// What the program writes to its standard output if it succeeds, else all that it says.
pub(crate) fn output(command: &mut Command, input: &str) -> Result<Vec<u8>, String> {
    let command = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // A program that refuses does not read it.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    match output.status.success() {
        true => Ok(output.stdout),
        false => Err(String::from_utf8([output.stdout, output.stderr].concat()).unwrap()),
    }
}

/// A request for a pass over revision 4 of the cohort of [`fetched`].
pub(crate) fn request(work: &Value) -> Value {
    json!({"cohort": "coh_1", "revision": 4, "transformation": "similarity", "alignment": "projection", "work": work})
}

/// The scatter of shapes of so many numbers.
pub(crate) fn scatter(width: usize) -> Value {
    json!({"sum": {"aligned": null, "sum": {"kind": "scatter", "origin": vec![0.0; width]}}})
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

    let sum = pass(&store, &["--threads", "1"], &request(&scatter(10))).unwrap();
    assert_eq!(pass(&store, &["--threads", "3"], &request(&scatter(10))).unwrap(), sum);
    assert!(!sum.is_empty());

    let refused = |arguments: &[&str]| engine(&store, arguments).unwrap_err();
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

#[test]
fn a_pass_that_does_not_suit_is_refused_by_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let [cohort, shapes] = fetched(folder.path(), 30);
    engine(&store, &["ingest", "--cohort", &cohort, "--shapes", &shapes]).unwrap();
    let changed = |field: &str, value: Value| {
        let mut request = request(&scatter(10));
        request[field] = value;
        request
    };
    let variables = json!(["label", "labels.turn"]);
    let design =
        |columns: Value, mean: usize| json!({"mean": vec![0.0; mean], "tangent": false, "columns": columns});
    let regress = |step: Value| request(&json!({"regress": {"variables": variables, "step": step}}));
    let number = json!({"number": {"middle": 0.0, "spread": 1.0}});
    let two = json!([{"levels": ["a", "b"]}, number]);
    let permute = |draws: usize, numbers: usize| {
        let reduced = json!({"inverse": vec![0.0; 9], "coordinates": vec![0.0; numbers]});
        regress(
            json!({"permute": {"design": design(two.clone(), 10), "reduced": reduced, "seed": 1, "draws": draws}}),
        )
    };
    for (request, expected) in [
        (json!({}), "request: expected a request for a pass, got missing field `cohort`"),
        (
            changed("work", json!({"search": {}})),
            "request: expected a request for a pass, got unknown variant `search`",
        ),
        (changed("cohort", json!("coh_2")), "coh_2/revisions/"),
        (changed("transformation", json!("rigid")), "shapelex-engine: "),
        (regress(json!({"sum": design(json!([number]), 10)})), "columns: expected columns of 2 variables"),
        (
            regress(json!({"sum": design(json!([{"levels": []}, number]), 10)})),
            "columns: expected columns of 2 variables",
        ),
        (regress(json!({"sum": design(two.clone(), 9)})), "mean: expected 10 numbers, got 9"),
        (permute(100_000, 20), "draws: expected 1 to "),
        (permute(9, 19), "reduced: expected numbers for 2 columns, got others"),
    ] {
        let error = pass(&store, &[], &request).unwrap_err();
        assert!(error.contains(expected), "{error}, expected {expected}");
    }
    // No shape has a label.
    let summary = pass(&store, &[], &regress(json!("summarise"))).unwrap();
    let head: Value = serde_json::from_slice(&summary[8..]).unwrap();
    assert_eq!((&head["missing"], &head["first_missing"]), (&30.into(), &0.into()));
}
