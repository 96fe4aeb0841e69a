//! Small files made byte by byte, so that each field can be wrong.

use std::io::Write;

use shapelex_formats::image::{ImageError, Limits, describe, read, read_labels};

/// Limits that no valid file of these tests exceeds.
pub(crate) const LIMITS: Limits = Limits { bytes: 1 << 16, cells: 1 << 12 };

/// Sentence of the refusal of a file, which reading and, if the header is at fault, describing give.
pub(crate) fn refusal(bytes: &[u8]) -> String {
    read(bytes, &LIMITS).unwrap_err().to_string()
}

/// As [`refusal`], for a fault that the header alone shows.
pub(crate) fn header_refusal(bytes: &[u8]) -> String {
    let error = describe(bytes, &LIMITS).unwrap_err();
    // As text: values that are no numbers do not equal themselves.
    assert_eq!(refusal(bytes), error.to_string());
    assert_eq!(read_labels(bytes, &LIMITS).unwrap_err().to_string(), error.to_string());
    error.to_string()
}

/// Every shortened form of a file is refused, and its header is described or refused without a panic.
pub(crate) fn is_refused_when_cut_off(bytes: &[u8]) {
    for length in 0..bytes.len() {
        let error = read(&bytes[..length], &LIMITS).unwrap_err();
        assert!(!matches!(error, ImageError::Memory { .. }), "{error} for {length} bytes");
        let _ = describe(&bytes[..length], &LIMITS);
    }
}

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A NIfTI-1 file whose fields are set by their position in the header.
pub(crate) struct Nifti {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl Nifti {
    /// A file of 3 axes with unit spacing in millimetres and voxels of `datatype`, each of `bits` bits.
    pub(crate) fn new(size: [i16; 3], datatype: i16, bits: i16, big_endian: bool) -> Self {
        let mut file = Self { bytes: vec![0; 352], big_endian };
        file.put(0, 348_i32.to_be_bytes()).put(40, 3_i16.to_be_bytes());
        for (axis, size) in size.into_iter().enumerate() {
            file.put(42 + 2 * axis, size.to_be_bytes()).put(80 + 4 * axis, 1_f32.to_be_bytes());
        }
        file.put(70, datatype.to_be_bytes()).put(72, bits.to_be_bytes());
        file.put(108, 352_f32.to_be_bytes());
        file.bytes[123] = 2;
        file.bytes[344..348].copy_from_slice(b"n+1\0");
        file
    }

    /// Sets a field, given big-endian.
    pub(crate) fn put<const N: usize>(&mut self, at: usize, mut value: [u8; N]) -> &mut Self {
        if !self.big_endian {
            value.reverse();
        }
        self.bytes[at..at + N].copy_from_slice(&value);
        self
    }

    pub(crate) fn float(&mut self, at: usize, value: f32) -> &mut Self {
        self.put(at, value.to_be_bytes())
    }

    pub(crate) fn short(&mut self, at: usize, value: i16) -> &mut Self {
        self.put(at, value.to_be_bytes())
    }

    pub(crate) fn raw(&mut self, at: usize, value: &[u8]) -> &mut Self {
        self.bytes[at..at + value.len()].copy_from_slice(value);
        self
    }

    /// The file with these voxels, given big-endian.
    pub(crate) fn with<const N: usize>(&self, voxels: &[[u8; N]]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for voxel in voxels {
            let mut voxel = *voxel;
            if !self.big_endian {
                voxel.reverse();
            }
            bytes.extend(voxel);
        }
        bytes
    }
}

/// A page of a TIFF file: tags with their type, number of values and bytes.
pub(crate) type Tags = Vec<(u16, u16, u32, Vec<u8>)>;

pub(crate) fn shorts(tag: u16, values: &[u16]) -> (u16, u16, u32, Vec<u8>) {
    (tag, 3, values.len() as u32, values.iter().flat_map(|value| value.to_le_bytes()).collect())
}

pub(crate) fn longs(tag: u16, values: &[u32]) -> (u16, u16, u32, Vec<u8>) {
    (tag, 4, values.len() as u32, values.iter().flat_map(|value| value.to_le_bytes()).collect())
}

pub(crate) fn fraction(tag: u16, [above, below]: [u32; 2]) -> (u16, u16, u32, Vec<u8>) {
    (tag, 5, 1, [above.to_le_bytes(), below.to_le_bytes()].concat())
}

/// A little-endian TIFF file whose pages have `tags`, without those of offsets, and `chunks` of pixels.
///
/// `lists`: tags of the offsets and lengths, 273 and 279 for strips, 324 and 325 for tiles.
pub(crate) fn tiff(pages: &[(Tags, Vec<Vec<u8>>)], lists: [u16; 2]) -> Vec<u8> {
    let mut file = b"II*\0\0\0\0\0".to_vec();
    let mut link = 4;
    for (tags, chunks) in pages {
        let mut offsets = Vec::new();
        for chunk in chunks {
            offsets.push(file.len() as u32);
            file.extend(chunk);
        }
        let lengths: Vec<u32> = chunks.iter().map(|chunk| chunk.len() as u32).collect();
        let mut tags = tags.clone();
        tags.extend([longs(lists[0], &offsets), longs(lists[1], &lengths)]);
        tags.sort_by_key(|tag| tag.0);
        let entries: Vec<_> = tags.iter().map(|tag| entry(&mut file, tag)).collect();
        let start = file.len() as u32;
        file[link..link + 4].copy_from_slice(&start.to_le_bytes());
        file.extend((entries.len() as u16).to_le_bytes());
        file.extend(entries.concat());
        link = file.len();
        file.extend([0; 4]);
    }
    file
}

/// The entry of a directory, whose values are in the file if they are longer than four bytes.
fn entry(file: &mut Vec<u8>, (tag, kind, count, bytes): &(u16, u16, u32, Vec<u8>)) -> Vec<u8> {
    let mut value = bytes.clone();
    if value.len() > 4 {
        value = (file.len() as u32).to_le_bytes().to_vec();
        file.extend(bytes);
    }
    value.resize(4, 0);
    [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value].concat()
}

/// Tags of a grey page without compression in one strip.
pub(crate) fn grey(size: [u16; 2], bits: u16) -> Tags {
    vec![
        shorts(256, &size[..1]),
        shorts(257, &size[1..]),
        shorts(258, &[bits]),
        shorts(259, &[1]),
        shorts(262, &[1]),
        shorts(278, &size[1..]),
    ]
}

/// A PNG file by the library, with 8 or 16 bits a sample, or a palette.
pub(crate) fn png(size: [u32; 2], colour: ::png::ColorType, depth: ::png::BitDepth, bytes: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut file, size[0], size[1]);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    if colour == ::png::ColorType::Indexed {
        encoder.set_palette(&[0, 0, 0, 255, 0, 0, 50, 50, 50, 10, 20, 30][..]);
    }
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    file
}
