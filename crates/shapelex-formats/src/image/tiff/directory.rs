//! The directories of a TIFF file, checked before its decoder reads them.
//!
//! The decoder reserves memory for as many entries of a list as a directory announces, before any limit can be given to it, and
//! multiplies numbers of strips and samples without a check. Directories that share their bytes would let a small file keep it
//! busy for long. Only counts and sizes are looked at here; everything else is left to the decoder.

use super::NAME;
use crate::image::error::ImageError;
use crate::image::limits::Limits;

/// Most pages of a file: far above the 65 535 slices of any scanner, and few enough to be walked in a moment.
const MOST_PAGES: usize = 1 << 16;

/// Most numbers in an entry that belongs to samples; four samples are read.
const MOST_NUMBERS: u64 = 16;

/// Memory of the decoder for each entry of a list of strips or tiles.
pub(super) const LIST_ENTRY_BYTES: u64 = 48;

const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;
const SAMPLES: u16 = 277;
const DESCRIPTION: u16 = 270;
/// Offsets and lengths of strips, then of tiles.
const LISTS: [u16; 4] = [273, 279, 324, 325];
/// Further entries that the decoder and this crate read: those of one page, all short.
const SHORT: [u16; 16] = [256, 257, 258, 259, 262, 274, 277, 278, 282, 283, 284, 296, 317, 322, 323, 338];
/// Those of them that came with version 6, and a list of JPEG tables, which must be short as well.
const SHORT_LATER: [u16; 3] = [339, 347, 530];

/// Lengths of the lists of strips or tiles, and the description of the first page.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Lists {
    /// That of the longest list.
    pub(super) longest: u64,
    /// That of all lists together.
    pub(super) entries: u64,
    /// Position and number of bytes of the description of the first page.
    pub(super) description: Option<[usize; 2]>,
}

/// Walks over all directories.
///
/// # Errors
/// [`ImageError::Cells`] of all pages together, [`ImageError::Bytes`] of lists, [`ImageError::Corrupt`].
pub(super) fn check(bytes: &[u8], limits: &Limits) -> Result<Lists, ImageError> {
    let mut walk = Walk::start(bytes, limits)?;
    for _ in 0..MOST_PAGES {
        if walk.next == 0 {
            return Ok(walk.lists);
        }
        walk.directory()?;
    }
    Err(ImageError::corrupt(NAME, format!("expected at most {MOST_PAGES} pages, got more")))
}

struct Walk<'a> {
    bytes: &'a [u8],
    limits: &'a Limits,
    big_endian: bool,
    /// Offsets have 8 bytes, not 4.
    long: bool,
    /// Position of the next directory, 0 at the end.
    next: u64,
    /// Bytes of directories and lists so far.
    walked: u64,
    cells: u64,
    lists: Lists,
}

/// An entry of a directory.
struct Entry {
    tag: u16,
    count: u64,
    /// Number of bytes of its values.
    size: u64,
    /// Where they are.
    from: u64,
    /// The first value, if it is a whole number.
    first: Option<u64>,
}

impl<'a> Walk<'a> {
    fn start(bytes: &'a [u8], limits: &'a Limits) -> Result<Self, ImageError> {
        let big_endian = bytes.starts_with(b"MM");
        let long = matches!(bytes.get(2..4), Some([43, 0] | [0, 43]));
        let mut walk =
            Self { bytes, limits, big_endian, long, next: 0, walked: 0, cells: 0, lists: Lists::default() };
        walk.next = if long { walk.number(8, 8)? } else { walk.number(4, 4)? };
        Ok(walk)
    }

    /// The whole number of `width` bytes at a position.
    fn number(&self, at: u64, width: usize) -> Result<u64, ImageError> {
        let short = ImageError::Short { format: NAME };
        let start = usize::try_from(at).map_err(|_| short.clone())?;
        let bytes = start.checked_add(width).and_then(|end| self.bytes.get(start..end)).ok_or(short)?;
        let add = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Ok(if self.big_endian { bytes.iter().fold(0, add) } else { bytes.iter().rev().fold(0, add) })
    }

    /// Checks the directory at `next`, and moves on.
    fn directory(&mut self) -> Result<(), ImageError> {
        let (head, width, last) = if self.long { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.number(self.next, head)?;
        let length = count.saturating_mul(width).saturating_add((head + last) as u64);
        self.walk_over(length)?;
        let first = self.next.saturating_add(head as u64);
        let (mut size, mut samples, mut longest) = ([0; 2], 1, 0);
        for index in 0..count {
            let entry = self.entry(first.saturating_add(index * width))?;
            match entry.tag {
                WIDTH => size[0] = entry.first.unwrap_or(0),
                HEIGHT => size[1] = entry.first.unwrap_or(0),
                SAMPLES => samples = entry.first.unwrap_or(0),
                DESCRIPTION if self.cells == 0 => self.lists.description = self.within(&entry),
                _ => {}
            }
            longest = longest.max(self.check_entry(&entry)?);
        }
        self.check_page(size, samples, longest)?;
        self.lists.longest = self.lists.longest.max(longest);
        self.next = self.number(first.saturating_add(count.saturating_mul(width)), last)?;
        Ok(())
    }

    /// Position and number of bytes of the values of an entry, if they are in the file.
    fn within(&self, entry: &Entry) -> Option<[usize; 2]> {
        let [from, size] = [usize::try_from(entry.from).ok()?, usize::try_from(entry.size).ok()?];
        self.bytes.get(from..from.checked_add(size)?).map(|_| [from, size])
    }

    fn entry(&self, at: u64) -> Result<Entry, ImageError> {
        let (tag, kind) = (self.number(at, 2)? as u16, self.number(at.saturating_add(2), 2)?);
        let field = if self.long { 8 } else { 4 };
        let count = self.number(at.saturating_add(4), field)?;
        let width = match kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16 | 17 | 18 => 8,
            _ => 0,
        };
        let size = count.saturating_mul(width);
        let mut from = at.saturating_add(4 + field as u64);
        if size > field as u64 {
            from = self.number(from, field)?;
        }
        let whole = count > 0 && matches!(kind, 1 | 3 | 4 | 16);
        let first = if whole { Some(self.number(from, width as usize)?) } else { None };
        Ok(Entry { tag, count, size, from, first })
    }

    /// Number of entries, if this is a list of strips or tiles.
    fn check_entry(&mut self, entry: &Entry) -> Result<u64, ImageError> {
        if LISTS.contains(&entry.tag) {
            if entry.size < entry.count.saturating_mul(2) {
                return Err(ImageError::corrupt(
                    NAME,
                    format!("a list of strips or tiles (tag {}) of a wrong type", entry.tag),
                ));
            }
            self.walk_over(entry.size)?;
            let memory = u128::from(entry.count) * u128::from(LIST_ENTRY_BYTES);
            self.limits.bytes("lists of TIFF strips and tiles", memory)?;
            self.lists.entries = self.lists.entries.saturating_add(entry.count);
            return Ok(entry.count);
        }
        let short = SHORT.contains(&entry.tag) || SHORT_LATER.contains(&entry.tag);
        if short && entry.count > MOST_NUMBERS {
            let fault =
                format!("expected at most {MOST_NUMBERS} numbers of tag {}, got {}", entry.tag, entry.count);
            return Err(ImageError::corrupt(NAME, fault));
        }
        Ok(0)
    }

    /// Parts of a file that do not overlap are no longer than the file.
    fn walk_over(&mut self, length: u64) -> Result<(), ImageError> {
        self.walked = self.walked.saturating_add(length);
        if self.walked <= self.bytes.len() as u64 {
            Ok(())
        } else {
            Err(ImageError::corrupt(NAME, "directories that overlap or go beyond the end of the file"))
        }
    }

    fn check_page(
        &mut self,
        [width, height]: [u64; 2],
        samples: u64,
        longest: u64,
    ) -> Result<(), ImageError> {
        let [width, height, _] = self.limits.size([width, height, 1])?.map(|size| size as u64);
        self.cells = self.cells.saturating_add(width * height);
        if self.cells > self.limits.cells {
            return Err(ImageError::Cells {
                limit: self.limits.cells,
                size: [width, height, self.cells / (width * height)],
            });
        }
        if !(1..=4).contains(&samples) {
            let expected = "1 (grey), 3 (colour) or 4 (colour and alpha) numbers for each pixel";
            return Err(ImageError::Unsupported { format: NAME, expected, found: samples.to_string() });
        }
        if height.saturating_mul(samples) > u64::from(u32::MAX) {
            return Err(ImageError::Cells { limit: u64::from(u32::MAX), size: [width, height, 1] });
        }
        if longest > width.saturating_mul(height).saturating_mul(samples) {
            let fault = format!(
                "expected at most a strip or tile for each of {width} × {height} pixels, got {longest}"
            );
            return Err(ImageError::corrupt(NAME, fault));
        }
        Ok(())
    }
}
