//! Tells the program which commit and compiler it was made from, and gives it the files of the dashboard
//! and the OpenAPI document.
#![allow(clippy::print_stdout, reason = "cargo reads what a build script prints")]

use std::io::Write;
use std::path::Path;
use std::process::Command;

use flate2::Compression;
use flate2::write::GzEncoder;

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
    if let Err(error) = compress_interface() {
        println!("cargo::error=openapi/openapi.json cannot be compressed: {error}");
    }
}

/// Compresses the OpenAPI document, which is served as it is committed.
fn compress_interface() -> std::io::Result<()> {
    println!("cargo:rerun-if-changed=openapi/openapi.json");
    let document = std::fs::read("openapi/openapi.json")?;
    let folder = std::env::var("OUT_DIR").unwrap_or_default();
    let file = std::fs::File::create(Path::new(&folder).join("openapi.json.gz"))?;
    let mut file = GzEncoder::new(file, Compression::best());
    file.write_all(&document)?;
    file.finish().map(drop)
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

/// All that the program is made of.
const SOURCES: [&str; 8] =
    ["src", "crates", "openapi", "dashboard/dist", "build.rs", "Cargo.toml", "Cargo.lock", ".cargo"];

/// The last commit of the checkout that changed the program, in release builds only: a developer's tests need not be built again
/// after each commit. The script watches the sources, not the checkout, so that a commit of documents builds nothing.
fn checked_out_commit() -> Option<String> {
    if std::env::var("PROFILE").as_deref() != Ok("release") || !Path::new(".git").exists() {
        return None;
    }
    for path in SOURCES {
        println!("cargo:rerun-if-changed={path}");
    }
    let of_sources = |arguments: &[&str]| answer_of("git", &[arguments, &["--"], &SOURCES].concat());
    let commit = of_sources(&["log", "-1", "--format=%H"])?;
    let modified = of_sources(&["status", "--porcelain"]).is_some();
    Some(if modified { format!("{commit}-modified") } else { commit })
}

fn answer_of(program: &str, arguments: &[&str]) -> Option<String> {
    let output =
        Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    String::from_utf8(output.stdout).ok().map(|text| text.trim().to_owned()).filter(|text| !text.is_empty())
}
