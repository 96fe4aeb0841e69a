//! Archives made of generated files: the checksums of an archive hide its content from changes of its bytes.
//!
//! Input: files apart by 0x1e, each a name, 0x1f and the content.

#![no_main]

use std::io::{Cursor, Write};
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use shapelex_formats::shape::{FORMATS, Format, Limits, ReadOptions, Source, read};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Limits under which no input keeps the target busy for long.
const LIMITS: Limits = Limits { content: 1 << 20, held: 1 << 18, points: 1 << 12, records: 256, depth: 32 };

/// The formats that are archives.
static READ: LazyLock<Vec<&'static Format>> = LazyLock::new(|| {
    // As in `shape_files`: panics that readers catch are faults of the file.
    drop(std::panic::take_hook());
    FORMATS.iter().filter(|format| ["zip", "swproj", "npz"].contains(&format.id)).copied().collect()
});

fuzz_target!(|data: &[u8]| {
    let Some(archive) = archive(data) else { return };
    for format in READ.iter() {
        read_all(format, &archive);
    }
});

fn archive(data: &[u8]) -> Option<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for file in data.split(|byte| *byte == 0x1e) {
        let end = file.iter().position(|byte| *byte == 0x1f)?;
        // Names occur once.
        writer.start_file(str::from_utf8(&file[..end]).ok()?, stored).ok()?;
        writer.write_all(&file[end + 1..]).ok()?;
    }
    Some(writer.finish().ok()?.into_inner())
}

/// Reads all records. They keep the rules of records, or the fault is named.
fn read_all(format: &Format, archive: &[u8]) {
    let mut source = Source::new(archive, LIMITS).expect("bytes in memory can be read");
    let read = read(format, &mut source, &ReadOptions::default(), &mut |record| {
        record.check().expect("records that are given on are valid");
        Ok(())
    });
    if let Err(error) = read {
        assert!(!error.detail.is_empty(), "{error:?}");
    }
}
