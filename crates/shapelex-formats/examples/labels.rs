//! The label image in a file as a JSON object: `labels FILE`. Values are x fastest.

use std::process::ExitCode;

use shapelex_formats::image::{ImageError, Limits, label_names, read_labels};

/// For files on the machine of the caller.
const LIMITS: Limits = Limits { bytes: 1 << 30, cells: 1 << 28 };

#[allow(clippy::print_stdout, clippy::print_stderr, reason = "a program of the command line")]
fn main() -> ExitCode {
    let Some(bytes) = std::env::args().nth(1).and_then(|path| std::fs::read(path).ok()) else {
        eprintln!("labels: expected a file, got none that can be read");
        return ExitCode::FAILURE;
    };
    match described(&bytes) {
        Ok(image) => {
            println!("{image}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("labels: {error}");
            ExitCode::FAILURE
        }
    }
}

fn described(bytes: &[u8]) -> Result<serde_json::Value, ImageError> {
    let image = read_labels(bytes, &LIMITS)?;
    let names = label_names(bytes, &LIMITS)?;
    Ok(serde_json::json!({
        "size": image.grid.size(),
        "affine": image.grid.affine(),
        "values": image.values,
        "names": names,
    }))
}
