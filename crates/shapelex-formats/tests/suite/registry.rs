//! The table of formats in the documentation is that of the registry.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use shapelex_formats::image;
use shapelex_formats::shape::FORMATS;

/// The lines around the table.
const MARKS: [&str; 2] = ["<!-- begin of the table -->\n", "<!-- end of the table -->\n"];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/formats")
}

fn table() -> String {
    let mut text = String::from(
        "| id | name | media types | endings | | shapes | options of reading |\n|---|---|---|---|---|---|---|\n",
    );
    let words = |list: &[&str]| list.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ");
    for format in FORMATS {
        let ways = match (format.is_read(), format.is_written()) {
            (true, true) => "read, written",
            (true, false) => "read",
            (false, _) => "written",
        };
        let kinds = format.kinds.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ");
        writeln!(
            text,
            "| [`{id}`]({id}.md) | {} | {} | {} | {ways} | {kinds} | {} |",
            format.name,
            words(format.media_types),
            words(format.extensions),
            words(format.options),
            id = format.id,
        )
        .unwrap();
    }
    for format in image::FORMATS {
        // Pictures and NIfTI have no page of their own.
        let own = folder().join(format!("{}.md", format.id)).is_file();
        let page = if own { format!("{}.md", format.id) } else { "../images.md".into() };
        writeln!(
            text,
            "| [`{}`]({page}) | {} of labels | {} | {} | read | curve, mesh | {} |",
            format.id,
            format.name,
            words(format.media_types),
            words(format.extensions),
            words(&image::LABEL_OPTIONS),
        )
        .unwrap();
    }
    text
}

/// With `WRITE_FORMATS` in the environment, the page is written.
#[test]
fn the_page_of_formats_lists_the_registry() {
    let path = folder().join("README.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = page.split_once(MARKS[0]).expect("the page has the mark before the table");
    let (found, after) = rest.split_once(MARKS[1]).expect("the page has the mark after the table");
    let wanted = table();
    if std::env::var_os("WRITE_FORMATS").is_some() {
        std::fs::write(&path, [before, MARKS[0], &wanted, MARKS[1], after].concat()).unwrap();
    } else {
        assert_eq!(
            found, wanted,
            "WRITE_FORMATS=1 cargo test -p shapelex-formats --test suite registry writes it"
        );
    }
}

#[test]
fn every_format_has_a_page_with_the_same_headings() {
    for format in FORMATS {
        let path = folder().join(format!("{}.md", format.id));
        let page =
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        for heading in ["Read", "Written", "Left out", "Coordinates", "Example", "Limits"] {
            assert!(
                page.contains(&format!("\n## {heading}\n")),
                "{} has no heading {heading}",
                path.display()
            );
        }
    }
}
