//! Texts and numbers of elements, with the place of a fault.

use std::cell::RefCell;

use dicom_core::{Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_encoding::text::{SpecificCharacterSet, TextCodec};
use dicom_encoding::transfer_syntax::TransferSyntax;

use super::data_set::{DataSet, Element, Value};
use super::extended::{self, ESCAPE};
use super::number;
use crate::error::{FileError, Place};
use crate::words::MAX_NAME;

/// Most characters of a value that a message shows.
const SHOWN: usize = 20;

/// A tag as it is written in the standard.
pub(crate) fn shown(tag: Tag) -> String {
    format!("({:04X},{:04X})", tag.group(), tag.element())
}

/// A data set with the context of its values.
pub(crate) struct File<'a> {
    set: DataSet<'a>,
    big_endian: bool,
    charset: Charset,
    syntax: &'static TransferSyntax,
    /// Texts with bytes above 127 of a set that is not declared: their number, and the place of the first one.
    undeclared: RefCell<Option<(usize, Place)>>,
}

/// How texts are encoded.
enum Charset {
    /// ASCII; other bytes, against the rules, are UTF-8 if that is valid, else ISO 8859-1.
    Default,
    Utf8,
    Other(SpecificCharacterSet),
    /// A set that is not known, in which texts of ASCII are read.
    Unknown(String),
}

impl<'a> File<'a> {
    pub(super) fn new(
        set: DataSet<'a>,
        big_endian: bool,
        syntax: &'static TransferSyntax,
    ) -> Result<Self, FileError> {
        let undeclared = RefCell::default();
        let mut file = Self { set, big_endian, charset: Charset::Default, syntax, undeclared };
        file.charset = file.root().charset()?;
        Ok(file)
    }

    /// The data set itself.
    pub(crate) fn root(&self) -> Node<'_> {
        Node { file: self, set: &self.set, path: String::new() }
    }

    /// All elements, in the order of the file.
    pub(super) fn set(&self) -> &DataSet<'a> {
        &self.set
    }

    /// Whether pixels are run lengths.
    pub(crate) fn has_run_lengths(&self) -> bool {
        self.syntax.uid() == uids::RLE_LOSSLESS
    }

    /// Name of the transfer syntax.
    pub(crate) fn syntax(&self) -> &'static str {
        self.syntax.name()
    }

    /// Warning about the texts that were read so far.
    pub(crate) fn warning(&self) -> Option<String> {
        let undeclared = self.undeclared.borrow();
        undeclared.as_ref().map(|(count, place)| {
            format!(
                "texts with bytes above 127, but no character set (0008,0005) that has them: {count}, the first one at {place}; \
                 they are read as UTF-8 if they can be, else as ISO 8859-1, which may be wrong"
            )
        })
    }

    /// Whether the most significant byte comes first.
    pub(crate) fn big_endian(&self) -> bool {
        self.big_endian
    }
}

/// A data set within a file: the whole of it, or an item of a sequence.
#[derive(Clone)]
pub(crate) struct Node<'f> {
    file: &'f File<'f>,
    set: &'f DataSet<'f>,
    /// Sequences and items that lead to it.
    path: String,
}

impl<'f> Node<'f> {
    /// Where an element is, or would be.
    pub(crate) fn place(&self, tag: Tag) -> Place {
        let byte = self.set.get(tag).map(|element| element.at);
        Place { byte, ..Place::tag(format!("{}{}", self.path, shown(tag))) }
    }

    /// A fault of the value of an element.
    pub(crate) fn malformed(&self, tag: Tag, detail: impl Into<String>) -> FileError {
        FileError::malformed(self.place(tag), detail)
    }

    /// The bytes of an element; `None` if it is absent or empty.
    pub(crate) fn bytes(&self, tag: Tag) -> Result<Option<&'f [u8]>, FileError> {
        let Some(element) = self.set.get(tag) else { return Ok(None) };
        match element.bytes() {
            Some(bytes) => Ok(Some(bytes).filter(|bytes| !bytes.is_empty())),
            None => Err(self.malformed(tag, "expected a value, got a sequence")),
        }
    }

    /// The pieces of compressed pixels; `None` where an element holds something else.
    pub(crate) fn fragments(&self, tag: Tag) -> Option<&'f [&'f [u8]]> {
        match self.set.get(tag).map(|element| &element.value) {
            Some(Value::Fragments(fragments)) => Some(fragments),
            _ => None,
        }
    }

    /// A text without the blanks around it; `None` if it is absent or blank.
    pub(crate) fn text(&self, tag: Tag) -> Result<Option<String>, FileError> {
        let Some(bytes) = self.bytes(tag)? else { return Ok(None) };
        let text = self.decode(tag, bytes)?;
        let text = text.trim_matches([' ', '\0']);
        Ok((!text.is_empty()).then(|| text.to_owned()))
    }

    /// A text that many shapes repeat.
    pub(crate) fn short_text(&self, tag: Tag) -> Result<Option<String>, FileError> {
        match self.bytes(tag)? {
            Some(bytes) if bytes.len() > MAX_NAME => Err(self
                .malformed(tag, format!("expected a text of at most {MAX_NAME} bytes, got {}", bytes.len()))),
            _ => self.text(tag),
        }
    }

    /// A text that must be there.
    pub(crate) fn required_text(&self, tag: Tag, what: &str) -> Result<String, FileError> {
        self.text(tag)?.ok_or_else(|| self.malformed(tag, format!("expected {what}, got none")))
    }

    /// Numbers, as text or binary; none if the element is absent or empty.
    pub(crate) fn numbers(&self, tag: Tag) -> Result<Vec<f64>, FileError> {
        let (Some(element), Some(bytes)) = (self.set.get(tag), self.bytes(tag)?) else {
            return Ok(Vec::new());
        };
        let big = self.file.big_endian;
        macro_rules! binary {
            ($type:ty) => {{
                const WIDTH: usize = size_of::<$type>();
                if !bytes.len().is_multiple_of(WIDTH) {
                    let detail = format!("expected numbers of {WIDTH} bytes, got {} bytes", bytes.len());
                    return Err(self.malformed(tag, detail));
                }
                let number = |bytes: &[u8; WIDTH]| {
                    f64::from(if big {
                        <$type>::from_be_bytes(*bytes)
                    } else {
                        <$type>::from_le_bytes(*bytes)
                    })
                };
                Ok(bytes.as_chunks::<WIDTH>().0.iter().map(number).collect())
            }};
        }
        match element.vr {
            VR::US => binary!(u16),
            VR::SS => binary!(i16),
            VR::UL => binary!(u32),
            VR::SL => binary!(i32),
            VR::FL => binary!(f32),
            VR::FD => binary!(f64),
            _ => self.decimals(element, bytes),
        }
    }

    fn decimals(&self, element: &Element<'_>, bytes: &[u8]) -> Result<Vec<f64>, FileError> {
        if bytes.iter().all(|byte| matches!(byte, b' ' | b'\0')) {
            return Ok(Vec::new());
        }
        let parse = |(k, part): (usize, &[u8])| {
            number::parse(part).ok_or_else(|| {
                let part = String::from_utf8_lossy(&part[..part.len().min(SHOWN)]).into_owned();
                let detail =
                    format!("expected finite numbers, got '{}' as number {k}", part.escape_default());
                self.malformed(element.tag, detail)
            })
        };
        bytes.split(|byte| *byte == b'\\').enumerate().map(parse).collect()
    }

    /// Exactly `N` numbers; `None` if the element is absent or empty.
    pub(crate) fn array<const N: usize>(&self, tag: Tag) -> Result<Option<[f64; N]>, FileError> {
        // Blanks around numbers have no bound, and an item may be asked for every frame.
        if let Some(bytes) = self.bytes(tag)?.filter(|bytes| bytes.len() > MAX_NAME * N) {
            return Err(self.malformed(tag, format!("expected {N} numbers, got {} bytes", bytes.len())));
        }
        let numbers = self.numbers(tag)?;
        if numbers.is_empty() {
            return Ok(None);
        }
        let found = numbers.len();
        let array = <[f64; N]>::try_from(numbers);
        array.map(Some).map_err(|_| self.malformed(tag, format!("expected {N} numbers, got {found}")))
    }

    /// A whole number; `None` if the element is absent or empty.
    pub(crate) fn integer(&self, tag: Tag) -> Result<Option<i64>, FileError> {
        let Some([x]) = self.array::<1>(tag)? else { return Ok(None) };
        if x.fract() == 0.0 && x.abs() <= f64::from(u32::MAX) {
            Ok(Some(x as i64))
        } else {
            Err(self.malformed(tag, format!("expected a whole number, got {x}")))
        }
    }

    /// A whole number that must be there and is not negative.
    pub(crate) fn count(&self, tag: Tag, what: &str) -> Result<u64, FileError> {
        let found = self.integer(tag)?;
        found.and_then(|found| u64::try_from(found).ok()).ok_or_else(|| {
            let found = found.map_or_else(|| "none".into(), |found| found.to_string());
            self.malformed(tag, format!("expected {what}, got {found}"))
        })
    }

    /// The items of a sequence; none if it is absent.
    pub(crate) fn items(&self, tag: Tag) -> Result<Vec<Node<'f>>, FileError> {
        let sets = self.sets(tag)?;
        Ok((0..).zip(sets).map(|(k, set)| self.within(tag, k, set)).collect())
    }

    /// The first item of a sequence.
    pub(crate) fn item(&self, tag: Tag) -> Result<Option<Node<'f>>, FileError> {
        Ok(self.sets(tag)?.first().map(|set| self.within(tag, 0, set)))
    }

    fn sets(&self, tag: Tag) -> Result<&'f [DataSet<'f>], FileError> {
        match self.set.get(tag).map(|element| &element.value) {
            Some(Value::Items(items)) => Ok(items),
            Some(Value::Bytes([])) | None => Ok(&[]),
            Some(_) => Err(self.malformed(tag, "expected a sequence, got a value")),
        }
    }

    fn within(&self, tag: Tag, k: usize, set: &'f DataSet<'f>) -> Node<'f> {
        Node { file: self.file, set, path: format!("{}{}[{k}] ", self.path, shown(tag)) }
    }

    fn charset(&self) -> Result<Charset, FileError> {
        let tag = tags::SPECIFIC_CHARACTER_SET;
        let Some(bytes) = self.bytes(tag)? else { return Ok(Charset::Default) };
        let text = String::from_utf8_lossy(bytes);
        let first = text.split('\\').map(|code| code.trim_matches([' ', '\0'])).find(|code| !code.is_empty());
        match first {
            None | Some("ISO_IR 6" | "ISO 2022 IR 6") => Ok(Charset::Default),
            Some("ISO_IR 192") => Ok(Charset::Utf8),
            Some(code) => Ok(match SpecificCharacterSet::from_code(code) {
                Some(set) => Charset::Other(set),
                None => Charset::Unknown(code.chars().take(SHOWN).collect()),
            }),
        }
    }

    fn decode(&self, tag: Tag, bytes: &[u8]) -> Result<String, FileError> {
        let fault = |what: &str| self.malformed(tag, format!("expected text in {what}, got other bytes"));
        if bytes.contains(&ESCAPE) {
            let usual = match &self.file.charset {
                Charset::Other(set) => Some(set),
                Charset::Default | Charset::Utf8 | Charset::Unknown(_) => None,
            };
            return extended::decode(bytes, usual)
                .map_err(|detail| FileError::unsupported(self.place(tag), detail));
        }
        match &self.file.charset {
            _ if bytes.is_ascii() => Ok(String::from_utf8_lossy(bytes).into_owned()),
            Charset::Utf8 => {
                std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| fault("UTF-8 (ISO_IR 192)"))
            }
            Charset::Other(set) => set.decode(bytes).map_err(|_| fault(&set.name())),
            Charset::Unknown(code) => {
                let detail =
                    format!("expected a character set of the standard, got '{}'", code.escape_default());
                Err(FileError::unsupported(self.place(tag), detail))
            }
            Charset::Default => {
                let mut undeclared = self.file.undeclared.borrow_mut();
                undeclared.get_or_insert_with(|| (0, self.place(tag))).0 += 1;
                Ok(match std::str::from_utf8(bytes) {
                    Ok(text) => text.to_owned(),
                    Err(_) => bytes.iter().copied().map(char::from).collect(),
                })
            }
        }
    }
}
