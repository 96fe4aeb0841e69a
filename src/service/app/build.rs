//! Build information of the program.

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Commit, if known at build time.
pub const COMMIT: Option<&str> = option_env!("SHAPELEX_BUILD_COMMIT");
/// Compiler version.
pub const RUSTC: &str = env!("SHAPELEX_BUILD_RUSTC");
/// Version and, if known, commit, in one line.
pub const LINE: &str = env!("SHAPELEX_BUILD_LINE");
/// Optional features that were built in.
pub const FEATURES: &[&str] = if cfg!(feature = "otel") { &["otel"] } else { &[] };
