//! A TrueType font as far as lines of text need it: letters, their widths, their outlines and the distances of pairs.
//!
//! For the font of the program, whose tables are known: `cmap` of format 4, `glyf` with outlines of quadratic curves, kerning in `GPOS`.
//! OpenType 1.9, chapter "OpenType Font Tables". Tables that are not as expected read as absent.

use tiny_skia::{PathBuilder, Transform};

/// Deepest nesting of a composite glyph.
const MAX_DEPTH: u8 = 4;

/// Number of a glyph; 0 is the box for letters that the font does not have.
pub(super) type Glyph = u16;

/// A part of the file. Offsets beyond its end read as absent.
#[derive(Debug, Clone, Copy)]
struct Part(&'static [u8]);

impl Part {
    fn from(self, at: usize) -> Option<Self> {
        self.0.get(at..).map(Self)
    }

    fn u8(self, at: usize) -> Option<u8> {
        self.0.get(at).copied()
    }

    fn u16(self, at: usize) -> Option<u16> {
        self.0.get(at..at + 2).map(|bytes| u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    fn i16(self, at: usize) -> Option<i16> {
        self.u16(at).map(u16::cast_signed)
    }

    fn u32(self, at: usize) -> Option<u32> {
        Some(u32::from(self.u16(at)?) << 16 | u32::from(self.u16(at + 2)?))
    }

    /// The part at the offset that is stored at `at`.
    fn at(self, at: usize) -> Option<Self> {
        self.from(self.u16(at)?.into())
    }
}

/// The font.
#[derive(Debug)]
pub(super) struct Font {
    units_per_em: u16,
    /// Whether `loca` holds numbers of 32 bits.
    long_offsets: bool,
    /// Number of glyphs with their own width.
    widths: u16,
    letters: Part,
    hmtx: Part,
    loca: Part,
    glyf: Part,
    /// Subtables of pairs; of those that have the first letter of a pair, the first counts.
    pairs: Vec<Part>,
}

impl Font {
    /// Reads the tables of a file.
    pub(super) fn new(file: &'static [u8]) -> Option<Self> {
        let file = Part(file);
        let table = |tag: &[u8; 4]| {
            let records = (0..usize::from(file.u16(4)?)).map(|i| 12 + 16 * i);
            let record = records.into_iter().find(|at| file.0.get(*at..at + 4) == Some(tag))?;
            file.from(file.u32(record + 8)? as usize)
        };
        let head = table(b"head")?;
        Some(Self {
            units_per_em: head.u16(18)?,
            long_offsets: head.u16(50)? == 1,
            widths: table(b"hhea")?.u16(34)?,
            letters: letters(table(b"cmap")?)?,
            hmtx: table(b"hmtx")?,
            loca: table(b"loca")?,
            glyf: table(b"glyf")?,
            pairs: table(b"GPOS").and_then(pairs).unwrap_or_default(),
        })
    }

    /// Number of units of the font in the size of its letters.
    pub(super) fn units_per_em(&self) -> u16 {
        self.units_per_em
    }

    /// The glyph of a letter.
    pub(super) fn letter(&self, c: char) -> Glyph {
        u16::try_from(u32::from(c)).ok().and_then(|code| self.find(code)).unwrap_or(0)
    }

    /// Search in `cmap` of format 4: segments with an end, a start, a shift and the place of a list of glyphs.
    fn find(&self, code: u16) -> Option<Glyph> {
        let table = self.letters;
        let length = usize::from(table.u16(6)?);
        let (ends, starts) = (14, 16 + length);
        let i = (0..length).step_by(2).find(|i| table.u16(ends + i).is_some_and(|end| code <= end))?;
        let start = table.u16(starts + i)?;
        let within = code.checked_sub(start)?;
        let (shift, place) = (table.u16(starts + length + i)?, starts + 2 * length + i);
        match usize::from(table.u16(place)?) {
            0 => Some(code.wrapping_add(shift)),
            offset => match table.u16(place + offset + 2 * usize::from(within))? {
                0 => None,
                glyph => Some(glyph.wrapping_add(shift)),
            },
        }
    }

    /// Distance from the start of a letter to that of the next one, in units of the font.
    pub(super) fn advance(&self, letter: Glyph, next: Option<Glyph>) -> i32 {
        let alone = self.hmtx.u16(4 * usize::from(letter.min(self.widths.saturating_sub(1))));
        let closer = next.and_then(|next| self.pairs.iter().find_map(|pairs| distance(*pairs, letter, next)));
        i32::from(alone.unwrap_or(0)) + i32::from(closer.unwrap_or(0))
    }

    /// Appends the outline of a glyph, in units of the font; the second axis points up.
    pub(super) fn outline(&self, glyph: Glyph, path: &mut PathBuilder) {
        self.append(glyph, Transform::identity(), 0, path);
    }

    fn append(&self, glyph: Glyph, place: Transform, depth: u8, path: &mut PathBuilder) -> Option<()> {
        let offset = |i: usize| {
            if self.long_offsets {
                self.loca.u32(4 * i)
            } else {
                self.loca.u16(2 * i).map(|half| 2 * u32::from(half))
            }
        };
        let [from, to] = [offset(glyph.into())?, offset(usize::from(glyph) + 1)?].map(|at| at as usize);
        let outline = Part(self.glyf.0.get(from..to).filter(|bytes| !bytes.is_empty())?);
        match outline.i16(0)? {
            contours @ 0.. => {
                for contour in points(outline, contours.unsigned_abs().into())? {
                    append_contour(&contour, place, path);
                }
            }
            _ if depth < MAX_DEPTH => self.append_parts(outline, place, depth, path)?,
            _ => {}
        }
        Some(())
    }

    /// Appends the glyphs that a composite one is made of.
    fn append_parts(&self, outline: Part, place: Transform, depth: u8, path: &mut PathBuilder) -> Option<()> {
        const WORDS: u16 = 1;
        const SCALE: u16 = 8;
        const MORE: u16 = 0x20;
        const TWO_SCALES: u16 = 0x40;
        const MATRIX: u16 = 0x80;
        let mut at = 10;
        loop {
            let (flags, glyph) = (outline.u16(at)?, outline.u16(at + 2)?);
            let [x, y] = if flags & WORDS != 0 {
                [outline.i16(at + 4)?, outline.i16(at + 6)?]
            } else {
                [outline.u8(at + 4)?, outline.u8(at + 5)?].map(|byte| byte.cast_signed().into())
            };
            at += if flags & WORDS != 0 { 8 } else { 6 };
            let number = |i: usize| outline.i16(at + 2 * i).map(|fixed| f32::from(fixed) / 16_384.0);
            let ([a, b, c, d], count) = if flags & MATRIX != 0 {
                ([number(0)?, number(1)?, number(2)?, number(3)?], 4)
            } else if flags & TWO_SCALES != 0 {
                ([number(0)?, 0.0, 0.0, number(1)?], 2)
            } else if flags & SCALE != 0 {
                ([number(0)?, 0.0, 0.0, number(0)?], 1)
            } else {
                ([1.0, 0.0, 0.0, 1.0], 0)
            };
            at += 2 * count;
            let part = Transform::from_row(a, b, c, d, x.into(), y.into());
            self.append(glyph, place.pre_concat(part), depth + 1, path);
            if flags & MORE == 0 {
                return Some(());
            }
        }
    }
}

/// The subtable of `cmap` for the Basic Multilingual Plane.
fn letters(cmap: Part) -> Option<Part> {
    let records = 0..usize::from(cmap.u16(2)?);
    let tables = records.filter_map(|i| cmap.from(cmap.u32(8 + 8 * i)? as usize));
    tables.into_iter().find(|table| table.u16(0) == Some(4))
}

/// The subtables of pairs of the feature `kern`.
fn pairs(gpos: Part) -> Option<Vec<Part>> {
    const PAIRS: u16 = 2;
    const EXTENSION: u16 = 9;
    let (features, lookups) = (gpos.at(6)?, gpos.at(8)?);
    let records = (0..usize::from(features.u16(0)?)).map(|i| 2 + 6 * i);
    let kern = records.into_iter().find(|at| features.0.get(*at..at + 4) == Some(b"kern"))?;
    let kern = features.at(kern + 4)?;
    let mut pairs = Vec::new();
    for i in 0..usize::from(kern.u16(2)?) {
        let lookup = lookups.at(2 + 2 * usize::from(kern.u16(4 + 2 * i)?))?;
        for j in 0..usize::from(lookup.u16(4)?) {
            let table = lookup.at(6 + 2 * j)?;
            match lookup.u16(0)? {
                PAIRS => pairs.push(table),
                EXTENSION if table.u16(2) == Some(PAIRS) => pairs.push(table.from(table.u32(4)? as usize)?),
                _ => {}
            }
        }
    }
    Some(pairs)
}

/// Distance that a subtable of pairs adds between two letters, if it has the first, and of single pairs the pair.
fn distance(table: Part, first: Glyph, second: Glyph) -> Option<i16> {
    const X_ADVANCE: u16 = 4;
    let index = covered(table.at(2)?, first)?;
    let [of_first, of_second] = [table.u16(4)?, table.u16(6)?];
    let [before, size] = [of_first & (X_ADVANCE - 1), of_first].map(|bits| 2 * bits.count_ones() as usize);
    let pair = size + 2 * of_second.count_ones() as usize;
    let record = match table.u16(0)? {
        1 => {
            let set = table.at(10 + 2 * usize::from(index))?;
            let mut records = (0..usize::from(set.u16(0)?)).map(|i| 2 + i * (2 + pair));
            set.from(records.find(|at| set.u16(*at) == Some(second))? + 2)?
        }
        _ => {
            let [row, column] = [class(table.at(8)?, first), class(table.at(10)?, second)].map(usize::from);
            let columns = usize::from(table.u16(14)?);
            table.from(16 + (row * columns + column) * pair)?
        }
    };
    if of_first & X_ADVANCE == 0 { Some(0) } else { record.i16(before) }
}

/// Position of a glyph in a coverage table.
fn covered(table: Part, glyph: Glyph) -> Option<u16> {
    let count = usize::from(table.u16(2)?);
    if table.u16(0)? == 1 {
        let position = (0..count).find(|i| table.u16(4 + 2 * i) == Some(glyph))?;
        return u16::try_from(position).ok();
    }
    let (start, record) = range(table, 4, count, glyph)?;
    Some(table.u16(record + 4)? + (glyph - start))
}

/// Class of a glyph; 0 is that of all others.
fn class(table: Part, glyph: Glyph) -> u16 {
    let found = || {
        if table.u16(0)? == 1 {
            let index = usize::from(glyph.checked_sub(table.u16(2)?)?);
            return (index < usize::from(table.u16(4)?)).then(|| table.u16(6 + 2 * index))?;
        }
        let (_, record) = range(table, 4, table.u16(2)?.into(), glyph)?;
        table.u16(record + 4)
    };
    found().unwrap_or(0)
}

/// Start and place of the record, one of `count` at `from`, whose range of glyphs has this one.
fn range(table: Part, from: usize, count: usize, glyph: Glyph) -> Option<(Glyph, usize)> {
    let mut records = (0..count).map(|i| from + 6 * i);
    let record = records.find(|at| table.u16(at + 2).is_some_and(|end| glyph <= end))?;
    let start = table.u16(record)?;
    (start <= glyph).then_some((start, record))
}

/// A point of an outline, and whether it is on the curve.
type Point = ([f32; 2], bool);

/// Contours of a glyph that is not composite.
fn points(outline: Part, contours: usize) -> Option<Vec<Vec<Point>>> {
    const ON_CURVE: u8 = 1;
    const REPEAT: u8 = 8;
    let ends = (0..contours).map(|i| outline.u16(10 + 2 * i).map(usize::from)).collect::<Option<Vec<_>>>()?;
    let count = ends.last().map_or(0, |last| last + 1);
    let mut at = 10 + 2 * contours;
    at += 2 + usize::from(outline.u16(at)?);
    let mut flags = Vec::with_capacity(count);
    while flags.len() < count {
        let flag = outline.u8(at)?;
        let times = if flag & REPEAT == 0 { 0 } else { outline.u8(at + 1)? };
        at += if flag & REPEAT == 0 { 1 } else { 2 };
        flags.extend(std::iter::repeat_n(flag, 1 + usize::from(times)));
    }
    let [x, y] = [0, 1].map(|axis| coordinates(outline, &flags[..count], axis, &mut at));
    let (x, y) = (x?, y?);
    let mut start = 0;
    let contour = |end: usize| {
        let points = (std::mem::replace(&mut start, end + 1)..=end)
            .map(|i| ([x[i], y[i]].map(f32::from), flags[i] & ON_CURVE != 0));
        points.collect()
    };
    Some(ends.into_iter().map(contour).collect())
}

/// Coordinates along an axis, stored as differences: one byte with a sign in the flag, two bytes, or none for 0.
fn coordinates(outline: Part, flags: &[u8], axis: u8, at: &mut usize) -> Option<Vec<i16>> {
    let (short, same) = (2 << axis, 16 << axis);
    let mut last = 0_i16;
    let next = |flag: &u8| {
        let step = match (flag & short != 0, flag & same != 0) {
            (true, positive) => {
                *at += 1;
                let step = i16::from(outline.u8(*at - 1)?);
                if positive { step } else { -step }
            }
            (false, true) => 0,
            (false, false) => {
                *at += 2;
                outline.i16(*at - 2)?
            }
        };
        last = last.wrapping_add(step);
        Some(last)
    };
    flags.iter().map(next).collect()
}

/// Appends a closed contour of quadratic curves. Between two points off the curve there is one on it, half-way.
fn append_contour(points: &[Point], place: Transform, path: &mut PathBuilder) {
    let map = |point: [f32; 2]| {
        let mut point = tiny_skia::Point::from_xy(point[0], point[1]);
        place.map_point(&mut point);
        [point.x, point.y]
    };
    let middle = |a: [f32; 2], b: [f32; 2]| [0, 1].map(|c| (a[c] + b[c]) / 2.0);
    let points: Vec<Point> = points.iter().map(|(point, on)| (map(*point), *on)).collect();
    let (Some(&(first, first_on)), Some(&(last, last_on))) = (points.first(), points.last()) else { return };
    let (start, rest) = match (first_on, last_on) {
        (true, _) => (first, &points[1..]),
        (false, true) => (last, &points[..points.len() - 1]),
        (false, false) => (middle(last, first), &points[..]),
    };
    path.move_to(start[0], start[1]);
    let mut control: Option<[f32; 2]> = None;
    for &(point, on) in rest.iter().chain(&[(start, true)]) {
        match (control, on) {
            (None, true) => path.line_to(point[0], point[1]),
            (None, false) => control = Some(point),
            (Some([x, y]), true) => {
                path.quad_to(x, y, point[0], point[1]);
                control = None;
            }
            (Some([x, y]), false) => {
                let between = middle([x, y], point);
                path.quad_to(x, y, between[0], between[1]);
                control = Some(point);
            }
        }
    }
    path.close();
}
