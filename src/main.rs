//! The `shapelex` program.

fn main() -> std::process::ExitCode {
    shapelex::cli::run()
}
