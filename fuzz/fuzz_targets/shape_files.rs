//! Files of shapes: read with small limits, described, written to every format and read again.
//!
//! Every format reads every input: positions in the registry change when a format is added, and most formats refuse at once. With the
//! id of a format in `SHAPELEX_FUZZ_FORMAT`, only that one does.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use shapelex_formats::shape::{
    FORMATS, FaultKind, Format, Inspection, Limits, ReadOptions, Record, Source, WriteOptions, detect, read,
};

/// Limits under which no input keeps the target busy for long.
const LIMITS: Limits = Limits { content: 1 << 20, held: 1 << 18, points: 1 << 12, records: 256, depth: 32 };

/// The formats that read.
static READ: LazyLock<Vec<&'static Format>> = LazyLock::new(|| {
    // The hook of the fuzzer ends it at any panic. Those that readers catch, of libraries of containers, are faults of the file; all
    // others still end it.
    drop(std::panic::take_hook());
    let only = std::env::var("SHAPELEX_FUZZ_FORMAT").ok();
    let is_wanted = |format: &&&Format| format.is_read() && only.as_ref().is_none_or(|id| format.id == id);
    let formats: Vec<&Format> = FORMATS.iter().filter(is_wanted).copied().collect();
    assert!(!formats.is_empty(), "no format has the id {only:?}");
    formats
});

fuzz_target!(|data: &[u8]| {
    let _ = detect(data, None);
    for format in READ.iter() {
        // Some formats cannot say that a file has no shapes.
        let Some(records) = read_all(format, data).filter(|records| !records.is_empty()) else { continue };
        let mut inspection = Inspection::default();
        records.iter().for_each(|record| inspection.add(record));
        for target in FORMATS.iter().filter(|target| target.is_written()) {
            check_round_trip(target, &records);
        }
    }
});

/// The records of a file, or `None` for one that is refused. All of them keep the rules of records.
fn read_all(format: &Format, file: &[u8]) -> Option<Vec<Record>> {
    // Damaged gzip is refused before a format reads.
    let mut source = Source::new(file, LIMITS).ok()?;
    let mut records = Vec::new();
    let summary = read(format, &mut source, &ReadOptions::default(), &mut |record| {
        record.check().expect("records that are given on are valid");
        records.push(record);
        Ok(())
    });
    match summary {
        Ok(summary) => {
            assert_eq!(summary.records, records.len() as u64);
            Some(records)
        }
        Err(error) => {
            assert!(!error.detail.is_empty(), "{error:?}");
            None
        }
    }
}

/// Writes records, and reads what was written: a format may refuse records by name, but not write what it cannot read.
fn check_round_trip(target: &Format, records: &[Record]) {
    let mut bytes = Vec::new();
    {
        let Ok(mut writer) = target.writer(&mut bytes, &WriteOptions::default()) else { return };
        for record in records {
            if writer.push(record).is_err() {
                return;
            }
        }
        if writer.finish().is_err() {
            return;
        }
    }
    // What is written may be longer than what was read.
    let limits =
        Limits { content: u64::MAX, held: usize::MAX / 4, points: 1 << 20, records: 1 << 20, ..LIMITS };
    if target.is_read() {
        let mut source = Source::new(&bytes[..], limits).expect("bytes in memory can be read");
        let again = read(target, &mut source, &ReadOptions::default(), &mut |_| Ok(()));
        // Some formats hold more than they read, and say so.
        if let Err(error) = again {
            let kinds = [FaultKind::Unsupported, FaultKind::TooLarge];
            assert!(kinds.contains(&error.kind), "{} does not read what it writes: {error}", target.id);
        }
    }
}
