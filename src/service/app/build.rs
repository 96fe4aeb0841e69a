//! What the program was made from.

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The commit, when it was known to the build.
pub const COMMIT: Option<&str> = option_env!("SHAPELEX_BUILD_COMMIT");
/// The compiler.
pub const RUSTC: &str = env!("SHAPELEX_BUILD_RUSTC");
/// Version and, when it is known, commit in one line.
pub const LINE: &str = env!("SHAPELEX_BUILD_LINE");
/// The optional parts that were built in.
pub const FEATURES: &[&str] = if cfg!(feature = "otel") { &["otel"] } else { &[] };
