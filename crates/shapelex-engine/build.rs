//! Names the build: sums have the same bits only by the same sources, compiler and optimisation.

use std::collections::hash_map::DefaultHasher;
use std::env;
use std::fs;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Files that decide about the bits of sums, relative to this crate.
const SOURCES: [&str; 6] = [
    "Cargo.lock",
    "Cargo.toml",
    "src",
    "../shapelex-analysis",
    "../shapelex-geometry",
    "../shapelex-numeric",
];

fn main() {
    let mut hasher = DefaultHasher::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        add(Path::new(source), &mut hasher);
    }
    for variable in ["OPT_LEVEL", "TARGET", "CARGO_CFG_TARGET_FEATURE"] {
        env::var(variable).ok().hash(&mut hasher);
    }
    let compiler = env::var_os("RUSTC").and_then(|rustc| Command::new(rustc).arg("-vV").output().ok());
    compiler.map(|version| version.stdout).hash(&mut hasher);
    println!("cargo::rustc-env=SHAPELEX_ENGINE_BUILD={:016x}", hasher.finish());
}

/// Adds the names and contents of files, in the order of their names.
fn add(path: &Path, hasher: &mut DefaultHasher) {
    let Ok(entries) = fs::read_dir(path) else {
        path.hash(hasher);
        fs::read(path).ok().hash(hasher);
        return;
    };
    let mut below: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    below.sort();
    below.iter().for_each(|path| add(path, hasher));
}
