//! Reading and writing of small files in unit tests.

use super::{FileError, Format, Limits, ReadOptions, Record, Source, Summary, WriteOptions, read};

/// All records of a file, within limits.
pub(super) fn records_within(
    format: &Format,
    bytes: &[u8],
    options: &ReadOptions,
    limits: Limits,
) -> Result<(Vec<Record>, Summary), FileError> {
    let mut found = Vec::new();
    let summary = read(format, &mut Source::new(bytes, limits)?, options, &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

/// All records of a text.
pub(super) fn records(
    format: &Format,
    text: &str,
    options: &ReadOptions,
) -> Result<(Vec<Record>, Summary), FileError> {
    records_within(format, text.as_bytes(), options, Limits::default())
}

/// The sentence by which a text is refused.
pub(super) fn fault(format: &Format, text: &str, options: &ReadOptions) -> String {
    records(format, text, options).expect_err("a fault").to_string()
}

/// Records as a text of a format, with the summary of the writer.
pub(super) fn written(
    format: &Format,
    records: &[Record],
    options: &WriteOptions,
) -> Result<(String, Summary), FileError> {
    let mut bytes = Vec::new();
    let mut writer = format.writer(&mut bytes, options)?;
    for record in records {
        writer.push(record)?;
    }
    let summary = writer.finish()?;
    assert_eq!(summary.records, records.len() as u64);
    Ok((String::from_utf8(bytes).expect("text"), summary))
}

/// Records as a text of a format.
pub(super) fn converted(format: &Format, records: &[Record]) -> String {
    written(format, records, &WriteOptions::default()).expect("records that fit").0
}

/// Every shortened form of a file is read or refused without a panic, as are its bytes in UTF-16 and with one that is no UTF-8.
pub(super) fn check_truncations(format: &Format, bytes: &[u8]) {
    let try_reading =
        |bytes: &[u8]| records_within(format, bytes, &ReadOptions::default(), Limits::default()).map(|_| ());
    for length in 0..bytes.len() {
        if let Err(error) = try_reading(&bytes[..length]) {
            assert!(error.to_string().contains("expected "), "{error}");
        }
    }
    let wide: Vec<u8> = bytes.iter().flat_map(|byte| [*byte, 0]).collect();
    assert!(try_reading(&wide).is_err(), "UTF-16");
    let mut broken = bytes.to_vec();
    broken.insert(bytes.len() / 2, 0xff);
    assert!(try_reading(&broken).is_err(), "no UTF-8");
}
