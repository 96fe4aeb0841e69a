//! The tables of `docs/segmentation-evaluation.md`.
//!
//! `cargo run --release -p shapelex-segmentation --example evaluation -- [--data FOLDER] [--write FOLDER]` prints them, or
//! writes the page to a folder. Without the folder of real images and volumes, their tables say so.

mod brain;
mod data;
mod heads;
#[path = "../../tests/suite/phantoms.rs"]
mod phantoms;
mod tables;
#[path = "../../tests/suite/tasks.rs"]
mod tasks;

use std::io::Write;
use std::path::PathBuf;

const OPENING: &str = "# Segmentation: measured

This page is written by one command:

```sh
cargo run --release -p shapelex-segmentation --example evaluation -- --data FOLDER --write docs
```

`FOLDER` holds the real images and volumes; without it their tables are left out. Phantoms, noise and first shapes are computed
from seeds, so every number of the phantoms can be made again. *Print* are the figures of the publications, whose images are not
available; *reference* are those of an independent program on the same phantoms. Seconds are wall-clock time on two shared cores.
";

fn main() -> std::io::Result<()> {
    let (mut data_folder, mut page_folder): (Option<PathBuf>, Option<PathBuf>) = (None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().map(PathBuf::from);
        match (name.as_str(), value) {
            ("--data", Some(folder)) => data_folder = Some(folder),
            ("--write", Some(folder)) => page_folder = Some(folder),
            ("--brain", Some(task)) => {
                return std::io::stdout().write_all(brain::row(&task.to_string_lossy())?.as_bytes());
            }
            _ => {
                eprintln!("expected [--data FOLDER] [--write FOLDER], got {name}");
                std::process::exit(2);
            }
        }
    }
    let mut page: Box<dyn Write> = match page_folder {
        Some(folder) => Box::new(std::fs::File::create(folder.join("segmentation-evaluation.md"))?),
        None => Box::new(std::io::stdout()),
    };
    page.write_all(OPENING.as_bytes())?;
    page.write_all(brain::section()?.as_bytes())?;
    page.write_all(data::sections(data_folder.as_deref())?.as_bytes())?;
    let sections =
        [tables::rods, tables::methods, tables::nucleus, tables::two_objects, tables::head, tables::cylinder];
    for section in sections {
        page.write_all(section().as_bytes())?;
    }
    Ok(())
}
