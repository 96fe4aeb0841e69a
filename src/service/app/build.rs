//! Build information of the program.

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Commit, if known at build time.
pub const COMMIT: Option<&str> = option_env!("SHAPELEX_BUILD_COMMIT");
/// Compiler version.
pub const RUSTC: &str = env!("SHAPELEX_BUILD_RUSTC");
/// Version and, if known, commit, in one line.
pub const LINE: &str = env!("SHAPELEX_BUILD_LINE");
/// Settings of the allocator, from `.cargo/config.toml`; `None` when it was built elsewhere.
pub const ALLOCATOR: Option<&str> = option_env!("JEMALLOC_SYS_WITH_MALLOC_CONF");
/// Optional features that were built in.
pub const FEATURES: &[&str] = if cfg!(feature = "otel") { &["otel"] } else { &[] };

/// Warns when the figures of memory in `docs/operations.md` do not hold for this build.
pub fn check() {
    if cfg!(not(target_env = "msvc"))
        && !ALLOCATOR.is_some_and(|settings| settings.contains("dirty_decay_ms"))
    {
        tracing::warn!(
            "the settings of the allocator in .cargo/config.toml are not compiled in: the process keeps more memory than documented"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_of_the_allocator_are_compiled_in() {
        let config =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/.cargo/config.toml")).unwrap();
        let settings = ALLOCATOR.expect("cargo gives the variable to the compiler");
        assert!(
            settings.contains("dirty_decay_ms") && config.contains(&format!("\"{settings}\"")),
            "{settings}"
        );
    }
}
