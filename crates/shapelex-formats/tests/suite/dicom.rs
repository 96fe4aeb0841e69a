//! Data sets of DICOM made element by element, so that each of them can be wrong.

/// How a data set is encoded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Encoding {
    pub(crate) explicit: bool,
    pub(crate) big_endian: bool,
}

pub(crate) const IMPLICIT: Encoding = Encoding { explicit: false, big_endian: false };
pub(crate) const EXPLICIT: Encoding = Encoding { explicit: true, big_endian: false };
pub(crate) const BIG: Encoding = Encoding { explicit: true, big_endian: true };

/// Types whose lengths have 32 bits where types are explicit.
const LONG: [&str; 4] = ["OB", "OW", "SQ", "UN"];

impl Encoding {
    /// Its transfer syntax.
    pub(crate) fn syntax(self) -> &'static str {
        match (self.explicit, self.big_endian) {
            (false, _) => "1.2.840.10008.1.2",
            (true, false) => "1.2.840.10008.1.2.1",
            (true, true) => "1.2.840.10008.1.2.2",
        }
    }

    fn short(self, x: u16) -> [u8; 2] {
        if self.big_endian { x.to_be_bytes() } else { x.to_le_bytes() }
    }

    fn long(self, x: u32) -> [u8; 4] {
        if self.big_endian { x.to_be_bytes() } else { x.to_le_bytes() }
    }

    /// Tag, type and length of an element.
    pub(crate) fn header(self, tag: u32, vr: &str, length: u32) -> Vec<u8> {
        let mut bytes = [self.short((tag >> 16) as u16), self.short(tag as u16)].concat();
        if self.explicit {
            bytes.extend(vr.as_bytes());
        }
        if self.explicit && LONG.contains(&vr) {
            bytes.extend([0, 0]);
        }
        if self.explicit && !LONG.contains(&vr) {
            bytes.extend(self.short(length as u16));
        } else {
            bytes.extend(self.long(length));
        }
        bytes
    }

    /// An element with a text, padded to an even length.
    pub(crate) fn text(self, tag: u32, vr: &str, text: &str) -> Vec<u8> {
        self.bytes(tag, vr, text.as_bytes())
    }

    /// An element with bytes, padded to an even length.
    pub(crate) fn bytes(self, tag: u32, vr: &str, value: &[u8]) -> Vec<u8> {
        let mut value = value.to_vec();
        if !value.len().is_multiple_of(2) {
            value.push(if vr == "UI" || vr == "OB" { 0 } else { b' ' });
        }
        [self.header(tag, vr, value.len() as u32), value].concat()
    }

    /// An element with a number of 16 bits.
    pub(crate) fn number(self, tag: u32, value: u16) -> Vec<u8> {
        self.bytes(tag, "US", &self.short(value))
    }

    /// A sequence whose lengths are given.
    pub(crate) fn sequence(self, tag: u32, items: &[Vec<u8>]) -> Vec<u8> {
        let mut value = Vec::new();
        for item in items {
            value.extend([self.short(0xfffe), self.short(0xe000)].concat());
            value.extend(self.long(item.len() as u32));
            value.extend(item);
        }
        [self.header(tag, "SQ", value.len() as u32), value].concat()
    }

    /// A sequence that ends with a delimiter, and so do its items.
    pub(crate) fn open_sequence(self, tag: u32, items: &[Vec<u8>]) -> Vec<u8> {
        let mark = |element: u16, length: u32| {
            [&self.short(0xfffe)[..], &self.short(element), &self.long(length)].concat()
        };
        let mut bytes = self.header(tag, "SQ", u32::MAX);
        for item in items {
            bytes.extend(mark(0xe000, u32::MAX));
            bytes.extend(item);
            bytes.extend(mark(0xe00d, 0));
        }
        bytes.extend(mark(0xe0dd, 0));
        bytes
    }

    /// A file with a preamble and a description.
    pub(crate) fn file(self, data_set: &[u8]) -> Vec<u8> {
        file(self.syntax(), data_set)
    }
}

/// A file with a preamble and the description of a transfer syntax.
pub(crate) fn file(syntax: &str, data_set: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 128];
    bytes.extend(b"DICM");
    let meta = EXPLICIT.text(0x0002_0010, "UI", syntax);
    bytes.extend(EXPLICIT.bytes(0x0002_0000, "UL", &(meta.len() as u32).to_le_bytes()));
    bytes.extend(meta);
    bytes.extend(data_set);
    bytes
}
