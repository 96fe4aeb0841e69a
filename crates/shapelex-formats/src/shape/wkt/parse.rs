//! A line to the parts of its geometry.

use super::super::limits::Limits;
use super::super::objects::Part;
use super::super::record::Points;
use crate::error::{FileError, Place};

/// Types of geometry.
const TYPES: [&str; 8] = [
    "POINT",
    "LINESTRING",
    "LINEARRING",
    "POLYGON",
    "MULTIPOINT",
    "MULTILINESTRING",
    "MULTIPOLYGON",
    "GEOMETRYCOLLECTION",
];

/// Which coordinates of a position there are beside x and y.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Order {
    /// As many as there are: two, or three with a height.
    Open,
    Z,
    M,
    Zm,
}

/// A line that is being read.
pub(super) struct Text<'a> {
    line: &'a str,
    at: usize,
    limits: Limits,
    /// Number of rings, lines and lists of points so far.
    rings: usize,
    /// Number of coordinates of a position, after the first one.
    dimension: Option<usize>,
    /// Number of positions with a measure, which is not given on.
    pub(super) measures: u64,
    /// Values beside the geometry.
    pub(super) id: Option<String>,
    /// Number of the system of reference.
    pub(super) srid: Option<u64>,
}

/// Whether a text begins with a type of geometry, or with the system of reference before it.
pub(super) fn begins_geometry(text: &str) -> bool {
    let word =
        |text: &str| text.chars().take_while(char::is_ascii_alphabetic).collect::<String>().to_uppercase();
    let text = text.trim_start();
    let (first, rest) = (word(text), text.trim_start_matches(|c: char| c.is_ascii_alphabetic()).trim_start());
    let follows = rest.starts_with('(') || ["Z", "M", "ZM", "EMPTY"].contains(&word(rest).as_str());
    let is_type = follows && typed(&first).is_some();
    is_type || (first == "SRID" && rest.starts_with('='))
}

/// The type and order of coordinates of a word such as `POINTZ`.
fn typed(word: &str) -> Option<(&'static str, Order)> {
    let orders = [("", Order::Open), ("ZM", Order::Zm), ("Z", Order::Z), ("M", Order::M)];
    orders.into_iter().find_map(|(end, order)| {
        let bare = word.strip_suffix(end)?;
        TYPES.into_iter().find(|known| *known == bare).map(|known| (known, order))
    })
}

impl<'a> Text<'a> {
    pub(super) fn new(line: &'a str, limits: Limits) -> Self {
        Self { line, at: 0, limits, rings: 0, dimension: None, measures: 0, id: None, srid: None }
    }

    /// The parts of the geometry of the line; its id is kept.
    pub(super) fn line(&mut self) -> Result<Vec<Part>, FileError> {
        let mut parts = Vec::new();
        let is_quoted = |text: &Self| text.rest().strip_prefix('"').is_some_and(begins_geometry);
        self.space();
        if !is_quoted(self) && !begins_geometry(self.rest()) {
            self.id = self.field()?;
            if !self.separator() {
                return Err(self.expected("a geometry, such as POLYGON ((0 0, 1 0, 0 1, 0 0))"));
            }
        }
        let quoted = is_quoted(self);
        self.at += usize::from(quoted);
        self.reference()?;
        self.geometry(&mut parts, 0)?;
        if quoted {
            self.expect('"')?;
        }
        if self.id.is_none() && self.separator() {
            self.id = self.field()?;
        }
        self.space();
        if self.rest().is_empty() { Ok(parts) } else { Err(self.expected("the end of the line")) }
    }

    /// A text up to the next separator, or in quotation marks, which are doubled within.
    fn field(&mut self) -> Result<Option<String>, FileError> {
        self.space();
        let mut found = String::new();
        let is_quoted = self.rest().starts_with('"');
        if is_quoted {
            self.at += 1;
            loop {
                let Some(end) = self.rest().find('"') else { return Err(self.expected("a quotation mark")) };
                found.push_str(&self.rest()[..end]);
                self.at += end + 1;
                if !self.rest().starts_with('"') {
                    break;
                }
                found.push('"');
                self.at += 1;
            }
        } else {
            let end = self.rest().find(['\t', ';', ',']).unwrap_or(self.rest().len());
            found.push_str(self.rest()[..end].trim());
            self.at += end;
        }
        Ok(Some(found).filter(|found| !found.is_empty()))
    }

    /// Passes a tabulator, semicolon or comma.
    fn separator(&mut self) -> bool {
        let rest = self.rest().trim_start_matches(' ');
        let found = rest.starts_with(['\t', ';', ',']);
        if found {
            self.at = self.line.len() - rest.len() + 1;
            self.space();
        }
        found
    }

    /// `SRID=…;`
    fn reference(&mut self) -> Result<(), FileError> {
        let start = self.at;
        if self.word() != "SRID" {
            self.at = start;
            return Ok(());
        }
        self.expect('=')?;
        let digits: String = self.rest().chars().take_while(char::is_ascii_digit).collect();
        self.srid = Some(digits.parse().map_err(|_| self.expected("the number of a system of reference"))?);
        self.at += digits.len();
        self.expect(';')
    }

    /// A geometry with its type.
    fn geometry(&mut self, parts: &mut Vec<Part>, depth: usize) -> Result<(), FileError> {
        if depth >= self.limits.depth {
            let detail = format!("expected at most {} nested collections, got more", self.limits.depth);
            return Err(FileError::too_large(self.place(), detail));
        }
        let place = self.place();
        let word = self.word();
        let Some((kind, mut order)) = typed(&word) else {
            let detail = format!("expected one of {}, got '{word}'", TYPES.join(", "));
            return Err(FileError::unsupported(place, detail));
        };
        let before = self.at;
        match self.word().as_str() {
            "Z" => order = Order::Z,
            "M" => order = Order::M,
            "ZM" => order = Order::Zm,
            _ => self.at = before,
        }
        match kind {
            "POINT" => {
                let points = self.points(order)?;
                if points.len() > 1 {
                    return Err(FileError::malformed(
                        place,
                        format!("expected one position of a POINT, got {}", points.len()),
                    ));
                }
                parts.extend(some(points).map(Part::Points));
            }
            "MULTIPOINT" => {
                let points = self.points(order)?;
                parts.extend(some(points).map(Part::Points));
            }
            "LINESTRING" => parts.extend(some(self.points(order)?).map(Part::Line)),
            "LINEARRING" => {
                parts.extend(some(self.points(order)?).map(ring).map(|ring| Part::Area(vec![ring])))
            }
            "POLYGON" => parts.extend(self.polygon(order)?),
            "MULTILINESTRING" => self.each(|text| {
                parts.extend(some(text.points(order)?).map(Part::Line));
                Ok(())
            })?,
            "MULTIPOLYGON" => self.each(|text| {
                parts.extend(text.polygon(order)?);
                Ok(())
            })?,
            _ => self.each(|text| text.geometry(parts, depth + 1))?,
        }
        Ok(())
    }

    /// Rings in brackets.
    fn polygon(&mut self, order: Order) -> Result<Option<Part>, FileError> {
        let mut rings = Vec::new();
        self.each(|text| {
            let place = text.place();
            match some(text.points(order)?) {
                Some(points) => rings.push(ring(points)),
                None => {
                    return Err(FileError::malformed(place, "expected the positions of a ring, got EMPTY"));
                }
            }
            Ok(())
        })?;
        Ok(Some(rings).filter(|rings| !rings.is_empty()).map(Part::Area))
    }

    /// Positions in brackets; those of a MULTIPOINT may have further brackets.
    fn points(&mut self, order: Order) -> Result<Points, FileError> {
        self.rings += 1;
        self.limits.rings(self.rings, || self.place())?;
        let mut points = Points::default();
        self.each(|text| {
            text.space();
            let is_inner = text.rest().starts_with('(');
            text.at += usize::from(is_inner);
            let position = text.position(order)?;
            if points.is_empty() {
                points = Points::new(position.len());
            }
            points.push(&position);
            if is_inner { text.expect(')') } else { Ok(()) }
        })?;
        Ok(points)
    }

    /// Two or three coordinates; a measure is passed.
    fn position(&mut self, order: Order) -> Result<Vec<f64>, FileError> {
        let place = self.place();
        let mut numbers = Vec::with_capacity(4);
        loop {
            self.space();
            let end = self
                .rest()
                .find(|c: char| !matches!(c, '0'..='9' | '+' | '-' | '.' | 'e' | 'E'))
                .unwrap_or(self.rest().len());
            if end == 0 {
                break;
            }
            let number = self.rest()[..end].parse().map_err(|_| self.expected("a number"))?;
            numbers.push(number);
            self.at += end;
            if numbers.len() > 4 {
                break;
            }
        }
        let (fits, measure) = match order {
            Order::Open => ((2..=3).contains(&numbers.len()), false),
            Order::Z => (numbers.len() == 3, false),
            Order::M => (numbers.len() == 3, true),
            Order::Zm => (numbers.len() == 4, true),
        };
        if measure && fits {
            numbers.pop();
            self.measures += 1;
        }
        let dimension = *self.dimension.get_or_insert(numbers.len());
        if !fits || dimension != numbers.len() {
            let expected =
                if fits { dimension.to_string() } else { String::from("2 or 3, or those of Z, M and ZM,") };
            let detail = format!("expected positions of {expected} coordinates, got {}", numbers.len());
            return Err(FileError::malformed(place, detail));
        }
        Ok(numbers)
    }

    /// EMPTY, or items in brackets with commas between them.
    fn each(&mut self, mut item: impl FnMut(&mut Self) -> Result<(), FileError>) -> Result<(), FileError> {
        let before = self.at;
        if self.word() == "EMPTY" {
            return Ok(());
        }
        self.at = before;
        self.expect('(')?;
        loop {
            item(self)?;
            self.space();
            if self.rest().starts_with(',') {
                self.at += 1;
            } else {
                return self.expect(')');
            }
        }
    }

    /// Passes letters; they are given in upper case.
    fn word(&mut self) -> String {
        self.space();
        let word: String = self.rest().chars().take_while(char::is_ascii_alphabetic).collect();
        self.at += word.len();
        word.to_uppercase()
    }

    fn expect(&mut self, wanted: char) -> Result<(), FileError> {
        self.space();
        if self.rest().starts_with(wanted) {
            self.at += wanted.len_utf8();
            Ok(())
        } else {
            Err(self.expected(&format!("'{wanted}'")))
        }
    }

    fn space(&mut self) {
        self.at = self.line.len() - self.rest().trim_start_matches([' ', '\t']).len();
    }

    fn rest(&self) -> &'a str {
        self.line.get(self.at..).unwrap_or_default()
    }

    fn place(&self) -> Place {
        Place::tag(format!("column {}", self.at + 1))
    }

    fn expected(&self, expected: &str) -> FileError {
        match self.rest().chars().next() {
            Some(found) => FileError::malformed(
                self.place(),
                format!("expected {expected}, got '{}'", found.escape_default()),
            ),
            None => {
                FileError::truncated(self.place(), format!("expected {expected}, got the end of the line"))
            }
        }
    }
}

/// Points, if there are any.
fn some(points: Points) -> Option<Points> {
    Some(points).filter(|points| !points.is_empty())
}

/// A ring without its first point at the end.
fn ring(mut points: Points) -> Points {
    points.open();
    points
}
