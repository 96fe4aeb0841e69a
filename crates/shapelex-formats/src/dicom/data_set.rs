//! The elements of a data set, whose values are slices of the file.

use std::io::Cursor;

use dicom_core::header::{DataElementHeader, Header};
use dicom_core::{Tag, VR};
use dicom_parser::StatefulDecode;
use dicom_parser::dataset::LazyDataToken;
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use dicom_parser::stateful::decode::DynStatefulDecoder;

use super::values::shown;
use crate::error::{FaultKind, FileError, Place};

/// Group of items and delimiters, which are not elements.
const DELIMITERS: u16 = 0xfffe;
/// Most elements and items of a data set: an empty one takes eight bytes of the file, and some twenty times as many in memory.
const MAX_ELEMENTS: usize = 1 << 20;

/// A reader of tokens over the bytes of a file.
pub(super) type Reader<'a> = LazyDataSetReader<DynStatefulDecoder<Cursor<&'a [u8]>>>;

/// Elements in the order of the file.
#[derive(Debug, Default)]
pub(crate) struct DataSet<'a> {
    elements: Vec<Element<'a>>,
    /// Positions of the elements in the order of their tags, if the file has them in another one.
    order: Vec<usize>,
}

/// An element.
#[derive(Debug)]
pub(crate) struct Element<'a> {
    /// Its tag.
    pub(crate) tag: Tag,
    /// The type of its value.
    pub(crate) vr: VR,
    /// Where its value begins in the file.
    pub(crate) at: u64,
    /// Its value.
    pub(crate) value: Value<'a>,
}

/// The value of an element.
#[derive(Debug)]
pub(crate) enum Value<'a> {
    /// Bytes of the file.
    Bytes(&'a [u8]),
    /// The items of a sequence.
    Items(Vec<DataSet<'a>>),
    /// Compressed pixels: the fragments after the table of offsets.
    Fragments(Vec<&'a [u8]>),
}

impl<'a> Element<'a> {
    /// Its bytes, unless it is a sequence.
    pub(crate) fn bytes(&self) -> Option<&'a [u8]> {
        match self.value {
            Value::Bytes(bytes) => Some(bytes),
            Value::Items(_) | Value::Fragments(_) => None,
        }
    }

    /// Number of bytes of a value that is not a sequence.
    pub(super) fn length(&self) -> u64 {
        self.bytes().map_or(0, |bytes| bytes.len() as u64)
    }
}

impl<'a> DataSet<'a> {
    /// The first element with a tag. Cost: logarithmic, since one item may be asked for every frame of an image.
    pub(crate) fn get(&self, tag: Tag) -> Option<&Element<'a>> {
        let element = if self.order.is_empty() {
            self.elements.get(self.elements.partition_point(|element| element.tag < tag))
        } else {
            let at = self.order.partition_point(|k| self.elements[*k].tag < tag);
            self.order.get(at).map(|k| &self.elements[*k])
        };
        element.filter(|element| element.tag == tag)
    }

    /// The data set with all its elements.
    fn finished(mut self) -> Self {
        if !self.elements.is_sorted_by_key(|element| element.tag) {
            self.order = (0..self.elements.len()).collect();
            self.order.sort_by_key(|k| self.elements[*k].tag);
        }
        self
    }

    /// All elements, in the order of the file.
    pub(crate) fn elements(&self) -> &[Element<'a>] {
        &self.elements
    }
}

/// Part that has begun and not yet ended.
enum Open<'a> {
    Sequence { tag: Tag, at: u64, items: Vec<DataSet<'a>>, pixels: bool },
    Item(DataSet<'a>),
}

/// Reads elements until `stop` says that one is not wanted.
pub(super) fn read<'a>(
    bytes: &'a [u8],
    mut reader: Reader<'a>,
    depth: usize,
    stop: impl Fn(Tag) -> bool,
) -> Result<DataSet<'a>, FileError> {
    let mut tree = Tree { open: vec![Open::Item(DataSet::default())], bytes, at: 0, depth, tokens: 0 };
    while let Some(token) = reader.advance() {
        tree.count()?;
        match token.map_err(|error| tree.fault(&error))? {
            LazyDataToken::ElementHeader(DataElementHeader { tag, .. }) => {
                if tag.group() == DELIMITERS {
                    return Err(tree.malformed("expected an element, got a delimiter or an item"));
                }
                if tree.open.len() == 1 && stop(tag) {
                    return tree.whole();
                }
            }
            LazyDataToken::LazyValue { header, decoder } => {
                let length = header.len.get().unwrap_or(u32::MAX);
                let value = tree.value(header.tag(), decoder.position(), length)?;
                tree.push(Element { tag: header.tag(), vr: header.vr(), at: decoder.position(), value })?;
                decoder.skip_bytes(length).map_err(|error| tree.fault(&error))?;
                tree.at = decoder.position();
            }
            LazyDataToken::LazyItemValue { len, decoder } => {
                let (tag, at) = (Tag(0x7fe0, 0x0010), decoder.position());
                let value = tree.value(tag, at, len)?;
                tree.push(Element { tag, vr: VR::OB, at, value })?;
                decoder.skip_bytes(len).map_err(|error| tree.fault(&error))?;
                tree.at = decoder.position();
            }
            LazyDataToken::SequenceStart { tag, .. } => {
                if tree.open.len() == 1 && stop(tag) {
                    return tree.whole();
                }
                tree.begin(tag, false)?;
            }
            LazyDataToken::PixelSequenceStart if tree.open.len() == 1 && stop(Tag(0x7fe0, 0x0010)) => {
                return tree.whole();
            }
            LazyDataToken::PixelSequenceStart => tree.begin(Tag(0x7fe0, 0x0010), true)?,
            LazyDataToken::ItemStart { .. } => tree.open.push(Open::Item(DataSet::default())),
            LazyDataToken::ItemEnd => tree.end_item()?,
            LazyDataToken::SequenceEnd => tree.end_sequence()?,
            _ => return Err(tree.malformed("expected an element or an item, got something else")),
        }
    }
    let read = reader.into_decoder().position();
    if read != bytes.len() as u64 || tree.open.len() != 1 {
        return Err(tree.short());
    }
    tree.whole()
}

/// A data set that is being read.
struct Tree<'a> {
    /// The data set itself, and its open parts.
    open: Vec<Open<'a>>,
    bytes: &'a [u8],
    /// End of the last value.
    at: u64,
    /// Most sequences within each other.
    depth: usize,
    /// Number of tokens so far: two of an element or an item.
    tokens: usize,
}

impl<'a> Tree<'a> {
    /// The bytes of a value, if the file has as many.
    fn value(&self, tag: Tag, at: u64, length: u32) -> Result<Value<'a>, FileError> {
        let left = (self.bytes.len() as u64).saturating_sub(at);
        let rest = usize::try_from(at).ok().and_then(|at| self.bytes.get(at..)).unwrap_or_default();
        rest.get(..length as usize).map(Value::Bytes).ok_or_else(|| {
            let place = Place { tag: Some(shown(tag)), ..Place::byte(at) };
            let detail =
                format!("expected {length} bytes of a value, got the {left} that the file still has");
            FileError::truncated(place, detail)
        })
    }

    fn count(&mut self) -> Result<(), FileError> {
        self.tokens += 1;
        if self.tokens <= 2 * MAX_ELEMENTS {
            return Ok(());
        }
        let detail = format!("expected at most {MAX_ELEMENTS} elements and items, got more");
        Err(FileError::too_large(self.place(), detail))
    }

    fn push(&mut self, element: Element<'a>) -> Result<(), FileError> {
        match self.open.last_mut() {
            Some(Open::Item(set)) => {
                set.elements.push(element);
                Ok(())
            }
            _ => Err(self.malformed("expected an item of a sequence, got an element")),
        }
    }

    fn begin(&mut self, tag: Tag, pixels: bool) -> Result<(), FileError> {
        let nested = self.open.iter().filter(|open| matches!(open, Open::Sequence { .. })).count();
        if nested >= self.depth {
            let place = Place { tag: Some(shown(tag)), ..Place::byte(self.at) };
            let detail = format!("expected at most {} sequences within each other, got more", self.depth);
            return Err(FileError::too_large(place, detail));
        }
        self.open.push(Open::Sequence { tag, at: self.at, items: Vec::new(), pixels });
        Ok(())
    }

    fn end_item(&mut self) -> Result<(), FileError> {
        match (self.open.pop(), self.open.last_mut()) {
            (Some(Open::Item(set)), Some(Open::Sequence { items, .. })) => {
                items.push(set.finished());
                Ok(())
            }
            _ => Err(self.malformed("expected an element, got the end of an item that has not begun")),
        }
    }

    fn end_sequence(&mut self) -> Result<(), FileError> {
        match self.open.pop() {
            Some(Open::Sequence { tag, at, items, pixels }) => {
                let fragment =
                    |item: &DataSet<'a>| item.elements.first().and_then(Element::bytes).unwrap_or_default();
                let value = match pixels {
                    true => Value::Fragments(items.iter().skip(1).map(fragment).collect()),
                    false => Value::Items(items),
                };
                self.push(Element { tag, vr: VR::SQ, at, value })
            }
            _ => Err(self.malformed("expected an element, got the end of a sequence that has not begun")),
        }
    }

    fn whole(self) -> Result<DataSet<'a>, FileError> {
        match self.open.into_iter().next() {
            Some(Open::Item(set)) => Ok(set.finished()),
            _ => Err(FileError::malformed(Place::default(), "expected a data set, got a sequence")),
        }
    }

    fn malformed(&self, detail: &str) -> FileError {
        FileError::malformed(self.place(), detail)
    }

    /// After the last value, in the innermost sequence.
    fn place(&self) -> Place {
        let within = self.open.iter().rev().find_map(|open| match open {
            Open::Sequence { tag, .. } => Some(shown(*tag)),
            Open::Item(_) => None,
        });
        Place { tag: within, ..Place::byte(self.at) }
    }

    fn short(&self) -> FileError {
        FileError::truncated(self.place(), "expected a whole data set, got the end of the file")
    }

    /// The fault of a library, which names its own place.
    fn fault(&self, error: &(dyn std::error::Error + 'static)) -> FileError {
        let mut cause = Some(error);
        while let Some(error) = cause {
            let read = error.downcast_ref::<std::io::Error>();
            if read.is_some_and(|error| error.kind() == std::io::ErrorKind::UnexpectedEof) {
                return self.short();
            }
            cause = error.source();
        }
        let detail = format!("expected elements and items, got other bytes ({error})");
        FileError::of(FaultKind::Malformed, self.place(), detail)
    }
}

#[cfg(test)]
mod tests {
    use super::super::content::Content;
    use super::*;

    /// A data set with a sequence of empty items.
    fn items(count: usize) -> Vec<u8> {
        let mut bytes = b"\x08\0\x60\0CS\x08\0RTSTRUCT\x06\x30\x39\0SQ\0\0".to_vec();
        bytes.extend_from_slice(&u32::try_from(8 * count).expect("short").to_le_bytes());
        bytes.extend(std::iter::repeat_n(*b"\xfe\xff\0\xe0\0\0\0\0", count).flatten());
        bytes
    }

    #[test]
    fn elements_are_counted() {
        let read = |bytes: &[u8]| Content::new(bytes, 0, |_| Ok(()))?.parse(8).map(|_| ());
        assert_eq!(read(&items(1000)), Ok(()));
        let refused = read(&items(MAX_ELEMENTS)).expect_err("many items");
        assert_eq!(refused.kind, FaultKind::TooLarge);
        assert_eq!(
            refused.to_string(),
            "(3006,0039), byte 16: expected at most 1048576 elements and items, got more"
        );
    }

    #[test]
    fn memory_is_asked_for_what_is_inflated() {
        let mut deflated = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut deflated, &items(400_000)).expect("written");
        let uid = "1.2.840.10008.1.2.1.99";
        let mut bytes = [[0; 128].as_slice(), b"DICM\x02\0\0\0UL\x04\0"].concat();
        bytes.extend_from_slice(&(8 + uid.len() as u32).to_le_bytes());
        bytes.extend_from_slice(b"\x02\0\x10\0UI");
        bytes.extend_from_slice(&(uid.len() as u16).to_le_bytes());
        bytes.extend_from_slice(uid.as_bytes());
        bytes.extend(deflated.finish().expect("the end"));
        let asked = std::cell::RefCell::new(Vec::new());
        let grow = |size: usize| {
            asked.borrow_mut().push(size >> 20);
            if size < 3 << 20 { Ok(()) } else { Err(FileError::new(FaultKind::Memory, "none")) }
        };
        let refused = Content::new(&bytes, 1 << 30, grow).map(|_| ()).expect_err("no memory");
        let asked: Vec<usize> = asked.into_inner().into_iter().filter(|size| *size > 0).collect();
        assert_eq!((refused.kind, asked.as_slice()), (FaultKind::Memory, [1, 2, 3].as_slice()));
        assert!(
            Content::new(&bytes, 1 << 30, |_| Ok(()))
                .and_then(|content| content.parse(8).map(|_| ()))
                .is_ok()
        );
    }
}
