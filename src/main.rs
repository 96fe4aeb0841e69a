//! The `shapelex` program.

/// Returns the memory of a job to the system when the job is done; that of glibc keeps most of it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    shapelex::cli::run()
}
