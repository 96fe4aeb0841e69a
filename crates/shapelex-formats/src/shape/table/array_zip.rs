//! Writing arrays of NumPy into a zip.

use std::io::Write;

use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, ZipWriter};

use super::columns::unwritten;
use super::npy::header_bytes;
use super::npy_file::write_numbers;
use crate::error::FileError;

/// A zip of arrays that is being written.
pub struct ArrayZip<W: Write> {
    zip: ZipWriter<StreamWriter<W>>,
}

impl<W: Write> ArrayZip<W> {
    /// A zip without arrays.
    pub fn new(output: W) -> Self {
        Self { zip: ZipWriter::new_stream(output) }
    }

    fn begin(&mut self, name: &str, descr: &str, size: usize, shape: &[usize]) -> Result<(), FileError> {
        let bytes = shape.iter().fold(size as u64, |bytes, axis| bytes.saturating_mul(*axis as u64));
        // Compressed bytes may be a few more.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1))
            .large_file(bytes >= u64::from(u32::MAX) / 2);
        // No array becomes a file outside of the folder that the zip is unpacked in.
        let name = name.replace(['/', '\\', ':'], "_");
        self.zip.start_file(format!("{name}.npy"), options).map_err(unwritten)?;
        Ok(self.zip.write_all(&header_bytes(descr, shape))?)
    }

    /// An array of doubles in C order.
    ///
    /// # Errors
    /// Those of the output; a name that is there already.
    pub fn numbers(&mut self, name: &str, shape: &[usize], values: &[f64]) -> Result<(), FileError> {
        self.begin(name, "<f8", 8, shape)?;
        write_numbers(&mut self.zip, values)
    }

    /// 0, and the ends of lists that lie one after the other in another array: 64-bit integers.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers).
    pub fn offsets(&mut self, name: &str, ends: &[usize]) -> Result<(), FileError> {
        self.begin(name, "<i8", 8, &[ends.len() + 1])?;
        let offsets = std::iter::once(&0).chain(ends);
        let bytes: Vec<u8> = offsets.flat_map(|end| (*end as u64).to_le_bytes()).collect();
        Ok(self.zip.write_all(&bytes)?)
    }

    /// Flags: 1 yes, 0 no, −1 unknown.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers).
    pub fn flags(&mut self, name: &str, flags: &[Option<bool>]) -> Result<(), FileError> {
        self.begin(name, "|i1", 1, &[flags.len()])?;
        let flag = |flag: &Option<bool>| flag.map_or(0xff, u8::from);
        Ok(self.zip.write_all(&flags.iter().map(flag).collect::<Vec<u8>>())?)
    }

    /// Texts as code points, padded to the length of the longest; nothing if there are none.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers).
    pub fn texts(&mut self, name: &str, texts: &[Option<String>]) -> Result<(), FileError> {
        if texts.iter().all(Option::is_none) {
            return Ok(());
        }
        let width = texts.iter().flatten().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
        self.begin(name, &format!("<U{width}"), 4 * width, &[texts.len()])?;
        for text in texts {
            let points = text.iter().flat_map(|text| text.chars()).map(u32::from);
            let points = points.chain(std::iter::repeat(0)).take(width);
            let bytes: Vec<u8> = points.flat_map(u32::to_le_bytes).collect();
            self.zip.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Writes the table of contents, and returns the output.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(self) -> Result<W, FileError> {
        Ok(self.zip.finish().map_err(unwritten)?.into_inner())
    }
}
