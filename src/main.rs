//! The `shapelex` program.

/// Gives freed memory back to the system within a second; that of the GNU C library keeps it, apart for many
/// threads. Its settings are in `.cargo/config.toml`.
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> std::process::ExitCode {
    shapelex_server::cli::run()
}
