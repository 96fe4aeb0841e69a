//! Tells the program which commit and compiler it was made from, and gives it the files of the dashboard.
#![allow(clippy::print_stdout, reason = "cargo reads what a build script prints")]

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=SHAPELEX_COMMIT");
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let commit = given_commit().or_else(checked_out_commit);
    if let Some(commit) = &commit {
        println!("cargo:rustc-env=SHAPELEX_BUILD_COMMIT={commit}");
    }
    let line = commit.map_or_else(|| version.clone(), |commit| format!("{version} ({commit})"));
    println!("cargo:rustc-env=SHAPELEX_BUILD_LINE={line}");
    let compiler = std::env::var("RUSTC").ok().and_then(|rustc| answer_of(&rustc, &["--version"]));
    println!("cargo:rustc-env=SHAPELEX_BUILD_RUSTC={}", compiler.as_deref().unwrap_or("unknown"));
    if let Err(error) = list_dashboard() {
        println!("cargo::error=dashboard/dist cannot be listed: {error}");
    }
}

/// Writes the table of the files in `dashboard/dist`: paths below `/`, and contents.
fn list_dashboard() -> std::io::Result<()> {
    println!("cargo:rerun-if-changed=dashboard/dist");
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join("dashboard/dist");
    let mut paths = vec![root.join("index.html"), root.join("docs.html")];
    for entry in std::fs::read_dir(root.join("assets"))? {
        paths.push(entry?.path());
    }
    paths.sort();
    let row = |path: &Path| {
        let name = path.strip_prefix(&root).unwrap_or(path).display().to_string();
        format!("    ({name:?}, include_bytes!({path:?})),\n")
    };
    let rows: String = paths.iter().map(|path| row(path)).collect();
    let table = Path::new(&std::env::var("OUT_DIR").unwrap_or_default()).join("dashboard.rs");
    std::fs::write(table, format!("[\n{rows}]\n"))
}

/// What whoever builds without a checkout says.
fn given_commit() -> Option<String> {
    std::env::var("SHAPELEX_COMMIT").ok().filter(|commit| !commit.is_empty())
}

/// The commit of the checkout, in release builds only: a developer's tests need not be built again after each commit.
fn checked_out_commit() -> Option<String> {
    if std::env::var("PROFILE").as_deref() != Ok("release") || !Path::new(".git").exists() {
        return None;
    }
    let branch = answer_of("git", &["symbolic-ref", "--quiet", "HEAD"]);
    let parts = ["HEAD".to_owned(), "packed-refs".to_owned()].into_iter().chain(branch);
    for path in parts.filter_map(|part| answer_of("git", &["rev-parse", "--git-path", &part])) {
        // A file that does not exist would have the script run every time.
        if Path::new(&path).exists() {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    answer_of("git", &["rev-parse", "HEAD"])
}

fn answer_of(program: &str, arguments: &[&str]) -> Option<String> {
    let output =
        Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    String::from_utf8(output.stdout).ok().map(|text| text.trim().to_owned()).filter(|text| !text.is_empty())
}
