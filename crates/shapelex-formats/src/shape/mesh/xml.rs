//! XML as a tree of elements, of bounded depth and number. Entities of the document's own are refused, not expanded.

use std::borrow::Cow;

use quick_xml::escape::resolve_xml_entity;
use quick_xml::events::{BytesRef, BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::super::limits::Limits;
use super::super::text::cut;
use crate::error::{FaultKind, FileError, Place};

/// Most elements of a file: an array is one.
const MAX_ELEMENTS: usize = 1 << 20;

/// Most attributes of an element: each is compared with all others.
const MAX_ATTRIBUTES: usize = 64;

/// An element.
pub(super) struct Element<'a> {
    pub(super) name: String,
    attributes: Vec<(String, String)>,
    /// All text within, without that of children.
    pub(super) text: Cow<'a, str>,
    pub(super) children: Vec<Element<'a>>,
    /// Offset of the bytes after its start.
    pub(super) at: u64,
}

impl<'a> Element<'a> {
    fn new(start: &BytesStart<'_>, at: u64) -> Result<Self, FileError> {
        let fault = |error: &dyn std::fmt::Display| {
            FileError::malformed(
                Place::byte(at),
                format!("expected an attribute of XML, got a fault: {error}"),
            )
        };
        let mut attributes = Vec::new();
        for attribute in start.attributes() {
            if attributes.len() == MAX_ATTRIBUTES {
                let detail = format!("expected at most {MAX_ATTRIBUTES} attributes of an element, got more");
                return Err(FileError::too_large(Place::byte(at), detail));
            }
            let attribute = attribute.map_err(|error| fault(&error))?;
            let value = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| fault(&error))?;
            attributes.push((attribute.key.into_inner().to_owned(), value.into_owned()));
        }
        let name = start.name().into_inner().to_owned();
        Ok(Self { name, attributes, text: Cow::Borrowed(""), children: Vec::new(), at })
    }

    /// An attribute.
    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| *known == name).map(|(_, value)| value.as_str())
    }

    /// The first child of a name.
    pub(super) fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// All children of a name.
    pub(super) fn all(&self, name: &str) -> impl Iterator<Item = &Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// Its place, with its name cut off: many records may have the same place.
    pub(super) fn place(&self) -> Place {
        let name = self.attribute("Name").map(|name| format!("{} {}", self.name, cut(name)));
        Place { tag: Some(name.unwrap_or_else(|| self.name.clone())), ..Place::byte(self.at) }
    }

    fn push_text(&mut self, text: Cow<'a, str>) {
        if self.text.is_empty() {
            self.text = text;
        } else {
            self.text.to_mut().push_str(&text);
        }
    }
}

/// The root of a document. Reading ends with the start of an element `last`, which need not be closed.
pub(super) fn parse<'a>(source: &'a str, limits: &Limits, last: &str) -> Result<Element<'a>, FileError> {
    let mut reader = Reader::from_str(source);
    let mut open: Vec<Element<'a>> = Vec::new();
    let mut count = 0;
    loop {
        let before = Place::byte(reader.buffer_position());
        let event = reader.read_event().map_err(|error| {
            let detail = format!("expected XML, got a fault: {error}");
            FileError::malformed(Place::byte(reader.error_position()), detail)
        })?;
        let at = reader.buffer_position();
        let (start, closed) = match event {
            Event::Start(start) => (start, false),
            Event::Empty(start) => (start, true),
            Event::End(_) => {
                if let Some(root) = close(&mut open) {
                    return Ok(root);
                }
                continue;
            }
            Event::Text(text) => {
                add_text(&mut open, text.into_inner());
                continue;
            }
            Event::CData(text) => {
                add_text(&mut open, text.into_inner());
                continue;
            }
            Event::GeneralRef(entity) => {
                add_text(&mut open, Cow::Owned(resolved(&entity).map_err(|error| error.at(before))?));
                continue;
            }
            Event::Eof => {
                let detail = "expected the end of the first element, got the end of the file";
                return Err(FileError::truncated(Place::byte(at), detail));
            }
            Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::DocType(_) => continue,
        };
        count += 1;
        check_size(count, open.len(), limits).map_err(|error| error.at(before.clone()))?;
        let element = Element::new(&start, at)?;
        let ends = element.name == last;
        open.push(element);
        if closed && let Some(root) = close(&mut open) {
            return Ok(root);
        }
        if ends {
            while open.len() > 1 {
                close(&mut open);
            }
            return open.pop().ok_or_else(|| FileError::malformed(before, "expected an element, got none"));
        }
    }
}

/// Refuses one more element after `count` with `depth` elements around it.
fn check_size(count: usize, depth: usize, limits: &Limits) -> Result<(), FileError> {
    let detail = if count > MAX_ELEMENTS {
        format!("expected at most {MAX_ELEMENTS} elements of XML, got more")
    } else if depth >= limits.depth {
        format!("expected elements of XML of depth {}, got a deeper one", limits.depth)
    } else {
        return Ok(());
    };
    Err(FileError::new(FaultKind::TooLarge, detail))
}

fn add_text<'a>(open: &mut [Element<'a>], text: Cow<'a, str>) {
    if let Some(element) = open.last_mut() {
        element.push_text(text);
    }
}

/// Text that an entity of XML stands for.
fn resolved(entity: &BytesRef<'_>) -> Result<String, FileError> {
    let text = match entity.resolve_char_ref() {
        Ok(Some(c)) => Some(c.to_string()),
        _ => resolve_xml_entity(entity).map(str::to_owned),
    };
    let detail = || format!("expected entities of XML, got '&{};'", &**entity);
    text.ok_or_else(|| FileError::malformed(Place::default(), detail()))
}

/// Closes the last element. Returns the root, if it is the one.
fn close<'a>(open: &mut Vec<Element<'a>>) -> Option<Element<'a>> {
    let element = open.pop()?;
    match open.last_mut() {
        Some(parent) => parent.children.push(element),
        None => return Some(element),
    }
    None
}
