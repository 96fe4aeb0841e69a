//! The scripts of `make test-all` where none of their tools is installed: each says what it skips, and ends with success.

use std::path::Path;
use std::process::Command;

/// Scripts that the steps run, with arguments. Their own programs are missing too.
const SCRIPTS: [(&str, &[&str]); 17] = [
    ("benches/weight/run.py", &["--gate"]),
    ("crates/shapelex-engine/tests/service.py", &["none/shapelex", "none/shapelex-engine"]),
    ("dashboard/run.sh", &["check"]),
    ("dashboard/run.sh", &["test"]),
    ("deploy/lint.py", &[]),
    ("tests/attack/run.py", &["small", "--binary", "none/shapelex"]),
    ("tests/clients/python.py", &[]),
    ("tests/clients/r.sh", &["none/shapelex"]),
    ("tests/clients/run.py", &[]),
    ("tests/clients/typescript.sh", &["none/shapelex"]),
    ("tests/contract/run.py", &["short"]),
    ("tests/documentation.py", &[]),
    ("tests/image.sh", &[]),
    ("tests/interop/run.py", &[]),
    ("tests/notebooks.py", &[]),
    ("tests/packages.py", &[]),
    ("tests/with_postgres.sh", &["true"]),
];

/// What runs the steps, and what makes environments for them.
const RUNNERS: [&str; 3] = ["tests/steps.sh", "tests/needs.sh", "tests/environment.py"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What a shell prints for a command; `None` if it fails.
fn said(command: &str) -> Option<String> {
    let output =
        Command::new("sh").args(["-c", command]).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}

/// Runs a script without any program in the path, and without what makes environments of Python.
fn run_alone(interpreter: &str, script: &str, arguments: &[&str]) -> (bool, String) {
    let folder = tempfile::tempdir().unwrap();
    // As on Debian without python3-venv.
    std::fs::write(folder.path().join("sitecustomize.py"), "import sys\nsys.modules['ensurepip'] = None\n")
        .unwrap();
    let output = Command::new(interpreter)
        .arg(script)
        .args(arguments)
        .current_dir(root())
        .env_clear()
        .env("PATH", folder.path().join("none"))
        .env("HOME", folder.path())
        .env("CARGO_TARGET_DIR", folder.path().join("target"))
        .env("PYTHONPATH", folder.path())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), text.into_owned())
}

#[test]
fn scripts_without_their_tools_say_what_they_skip() {
    let bash = said("command -v bash");
    // A path may lead to a script that looks for the program itself.
    let python = said("python3 -c 'import os, sys; print(os.path.realpath(sys.executable))'");
    let mut wrong = Vec::new();
    for (script, arguments) in SCRIPTS {
        let interpreter = if script.ends_with(".py") { &python } else { &bash };
        let Some(interpreter) = interpreter else {
            println!("SKIPPED: {script} without tools, there is nothing that runs it");
            continue;
        };
        let (succeeds, text) = run_alone(interpreter, script, arguments);
        let dies = ["Traceback", "command not found", "No such file"].iter().any(|sign| text.contains(sign));
        if !succeeds || dies || !text.lines().any(|line| line.starts_with("SKIPPED: ")) {
            wrong.push(format!("{script} {arguments:?}:\n{text}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_script_of_the_steps_is_listed() {
    let steps = std::fs::read_to_string(root().join("tests/steps.sh")).unwrap();
    let makefile = std::fs::read_to_string(root().join("Makefile")).unwrap();
    let engine = makefile.split("\ntest-engine: ").nth(1).unwrap().split("\n\n").next().unwrap();
    let code = steps.lines().chain(engine.lines()).filter(|line| !line.trim_start().starts_with('#'));
    let words = code.flat_map(|line| line.split([' ', '"', '\'']));
    let mut scripts: Vec<&str> =
        words.filter(|word| word.ends_with(".py") || word.ends_with(".sh")).collect();
    scripts.retain(|script| script.contains('/') && !RUNNERS.contains(script));
    assert!(scripts.len() >= 9, "{scripts:?}");
    for script in scripts {
        assert!(SCRIPTS.iter().any(|(listed, _)| *listed == script), "{script} is not run without its tools");
    }
}
