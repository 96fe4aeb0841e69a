//! Drawings as pixels: a painter of the part of SVG that drawings are written in.
//!
//! Elements `svg`, `g`, `rect`, `circle`, `path` and `text`; titles, style sheets and animations are passed over. Anything else is a
//! fault of the writer. Coordinates are read in double precision and placed in single precision, as in resvg.

use std::str::FromStr;

use quick_xml::escape::resolve_xml_entity;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};
use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

use super::letters::{self, Anchor};

/// Paints a drawing over the picture. The picture has the size that the drawing asks for.
///
/// # Errors
/// Elements that no drawing has.
pub(super) fn paint(svg: &str, pixels: &mut Pixmap) -> Result<(), String> {
    let mut reader = Reader::from_str(svg);
    let (page, place) = ([0.0; 4], Transform::identity());
    let mut painter = Painter { pixels, page, place, brushes: Vec::new(), words: None };
    loop {
        match reader.read_event().map_err(|error| error.to_string())? {
            Event::Start(start) => {
                if !painter.start(&start)? {
                    reader.read_to_end(start.name()).map_err(|error| error.to_string())?;
                }
            }
            Event::Empty(start) => {
                if painter.start(&start)? {
                    painter.end();
                }
            }
            Event::End(_) => painter.end(),
            Event::Text(text) => painter.say(&text),
            Event::GeneralRef(entity) => {
                painter.say(resolve_xml_entity(&entity).ok_or("an unknown entity")?);
            }
            Event::Eof => return Ok(()),
            other => return Err(format!("expected a drawing, got {other:?}")),
        }
    }
}

/// Attributes of an element.
struct Attributes(Vec<(String, String)>);

impl Attributes {
    fn of(start: &BytesStart<'_>) -> Result<Self, String> {
        let mut found = Vec::new();
        for attribute in start.attributes() {
            let attribute = attribute.map_err(|error| error.to_string())?;
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            let value = value.map_err(|error| error.to_string())?.into_owned();
            found.push((attribute.key.into_inner().to_owned(), value));
        }
        Ok(Self(found))
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// A number, or `default` without the attribute.
    fn number(&self, name: &str, default: f32) -> Result<f32, String> {
        self.get(name).map_or(Ok(default), |text| parsed::<f64>(text).map(|number| number as f32))
    }

    /// A length, of which `100%` is the whole.
    fn length(&self, name: &str, whole: f32) -> Result<f32, String> {
        if self.get(name) == Some("100%") { Ok(whole) } else { self.number(name, 0.0) }
    }
}

fn parsed<T: FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| format!("expected a number, got {text}"))
}

/// How lines and areas are painted: inherited by the children of an element.
#[derive(Debug, Clone)]
struct Brush {
    fill: Option<[u8; 3]>,
    fill_opacity: f32,
    stroke: Option<[u8; 3]>,
    stroke_opacity: f32,
    line: Stroke,
}

impl Default for Brush {
    fn default() -> Self {
        let line = Stroke { width: 1.0, miter_limit: 4.0, ..Stroke::default() };
        Self { fill: Some([0; 3]), fill_opacity: 1.0, stroke: None, stroke_opacity: 1.0, line }
    }
}

impl Brush {
    /// The brush of an element with these attributes within.
    fn with(mut self, attributes: &Attributes) -> Result<Self, String> {
        if let Some(text) = attributes.get("fill") {
            self.fill = colour(text)?;
        }
        if let Some(text) = attributes.get("stroke") {
            self.stroke = colour(text)?;
        }
        self.fill_opacity = attributes.number("fill-opacity", self.fill_opacity)?;
        self.stroke_opacity = attributes.number("stroke-opacity", self.stroke_opacity)?;
        self.line.width = attributes.number("stroke-width", self.line.width)?;
        if attributes.get("stroke-linejoin") == Some("round") {
            self.line.line_join = LineJoin::Round;
        }
        if attributes.get("stroke-linecap") == Some("round") {
            self.line.line_cap = LineCap::Round;
        }
        Ok(self)
    }
}

/// `none` or `#rrggbb`.
fn colour(text: &str) -> Result<Option<[u8; 3]>, String> {
    if text == "none" {
        return Ok(None);
    }
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6);
    let number = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
    let [_, red, green, blue] = number.ok_or_else(|| format!("expected #rrggbb, got {text}"))?.to_be_bytes();
    Ok(Some([red, green, blue]))
}

fn paint_of([red, green, blue]: [u8; 3], opacity: f32) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (opacity * 255.0 + 0.5) as u8);
    paint.anti_alias = true;
    paint
}

/// Place of a text.
struct Words {
    at: [f32; 2],
    size: f32,
    anchor: Anchor,
}

impl Words {
    fn of(attributes: &Attributes) -> Result<Self, String> {
        let anchor = match attributes.get("text-anchor") {
            None => Anchor::Start,
            Some("middle") => Anchor::Middle,
            Some("end") => Anchor::End,
            Some(other) => return Err(format!("expected an anchor, got {other}")),
        };
        let at = [attributes.number("x", 0.0)?, attributes.number("y", 0.0)?];
        Ok(Self { at, size: attributes.number("font-size", 12.0)?, anchor })
    }
}

struct Painter<'a> {
    pixels: &'a mut Pixmap,
    /// `x`, `y`, width and height of the part of the plane that is shown.
    page: [f32; 4],
    /// Map from the plane to the pixels.
    place: Transform,
    /// Brushes of the open elements.
    brushes: Vec<Brush>,
    /// The open text.
    words: Option<(Words, String)>,
}

impl Painter<'_> {
    /// Opens an element; `false` if it is to be passed over.
    fn start(&mut self, start: &BytesStart<'_>) -> Result<bool, String> {
        let name = start.name().into_inner();
        if matches!(name, "title" | "style" | "animate") {
            return Ok(false);
        }
        let attributes = Attributes::of(start)?;
        let brush = self.brushes.last().cloned().unwrap_or_default().with(&attributes)?;
        match name {
            "text" => self.words = Some((Words::of(&attributes)?, String::new())),
            _ => self.element(name, &attributes, &brush)?,
        }
        self.brushes.push(brush);
        Ok(true)
    }

    fn say(&mut self, text: &str) {
        if let Some((_, words)) = &mut self.words {
            words.push_str(text);
        }
    }

    /// Closes the last element.
    fn end(&mut self) {
        let brush = self.brushes.pop().unwrap_or_default();
        if let Some((Words { at, size, anchor }, text)) = self.words.take()
            && let Some(path) = letters::outline(&text, at, size, anchor)
        {
            self.path(&path, &brush);
        }
    }

    fn element(&mut self, name: &str, attributes: &Attributes, brush: &Brush) -> Result<(), String> {
        let path = match name {
            "svg" => return self.begin(attributes),
            "g" => return Ok(()),
            "rect" => {
                let [x, y] = [attributes.number("x", 0.0)?, attributes.number("y", 0.0)?];
                let [width, height] =
                    [attributes.length("width", self.page[2])?, attributes.length("height", self.page[3])?];
                Rect::from_xywh(x, y, width, height).map(PathBuilder::from_rect)
            }
            "circle" => {
                let [x, y, radius] = ["cx", "cy", "r"].map(|name| attributes.number(name, 0.0));
                circle([x?, y?], radius?)
            }
            "path" => line(attributes.get("d").unwrap_or_default())?,
            other => return Err(format!("expected an element of drawings, got {other}")),
        };
        if let Some(path) = path {
            self.path(&path, brush);
        }
        Ok(())
    }

    /// The page is scaled evenly and centred.
    fn begin(&mut self, attributes: &Attributes) -> Result<(), String> {
        let numbers = attributes.get("viewBox").unwrap_or_default().split(' ').map(parsed::<f32>);
        let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
        let [x, y, width, height] = numbers.try_into().map_err(|_| "expected a view box of four numbers")?;
        let size = [self.pixels.width() as f32, self.pixels.height() as f32];
        let scale = (size[0] / width).min(size[1] / height);
        let shift =
            [-x * scale + (size[0] - width * scale) / 2.0, -y * scale + (size[1] - height * scale) / 2.0];
        self.page = [x, y, width, height];
        self.place = Transform::from_row(scale, 0.0, 0.0, scale, shift[0], shift[1]);
        Ok(())
    }

    fn path(&mut self, path: &Path, brush: &Brush) {
        let bounds = path.bounds();
        if let Some(colour) = brush.fill.filter(|_| bounds.width() > 0.0 && bounds.height() > 0.0) {
            let paint = paint_of(colour, brush.fill_opacity);
            self.pixels.fill_path(path, &paint, FillRule::Winding, self.place, None);
        }
        if let Some(colour) = brush.stroke {
            let paint = paint_of(colour, brush.stroke_opacity);
            self.pixels.stroke_path(path, &paint, &brush.line, self.place, None);
        }
    }
}

/// Distance of the control points of a quarter of a circle of radius 1: `4/3 tan(π/8)`.
const QUARTER: f64 = 0.552_284_749_830_793_4;

fn circle([x, y]: [f32; 2], radius: f32) -> Option<Path> {
    let mut builder = PathBuilder::new();
    builder.move_to(x + radius, y);
    let (cx, cy, r) = (f64::from(x), f64::from(y), f64::from(radius));
    for (cosine, sine) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
        let place = |u: f64, v: f64| {
            ((cx + r * (u * cosine - v * sine)) as f32, (cy + r * (u * sine + v * cosine)) as f32)
        };
        let [(x1, y1), (x2, y2), (x, y)] = [place(1.0, QUARTER), place(QUARTER, 1.0), place(0.0, 1.0)];
        builder.cubic_to(x1, y1, x2, y2, x, y);
    }
    builder.close();
    builder.finish()
}

/// A path of commands `M` and `Z` with absolute, and `l` with relative coordinates. `None` for less than two points.
fn line(text: &str) -> Result<Option<Path>, String> {
    let mut builder = PathBuilder::new();
    for part in text.split('M').skip(1) {
        let open = part.strip_suffix('Z');
        let (start, rest) = open.unwrap_or(part).split_once('l').unwrap_or((open.unwrap_or(part), ""));
        let mut start = pairs(start)?.into_iter();
        let mut last = start.next().ok_or("expected a point, got none")?;
        builder.move_to(last[0] as f32, last[1] as f32);
        for step in pairs(rest)? {
            last = [last[0] + step[0], last[1] + step[1]];
            builder.line_to(last[0] as f32, last[1] as f32);
        }
        if open.is_some() {
            builder.close();
        }
    }
    Ok(builder.finish())
}

/// Pairs of numbers, of which each begins with a sign, after a space, or at the begin.
fn pairs(text: &str) -> Result<Vec<[f64; 2]>, String> {
    let mut numbers = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let end = rest[1..].find([' ', '-']).map_or(rest.len(), |end| end + 1);
        numbers.push(parsed::<f64>(&rest[..end])?);
        rest = rest[end..].trim_start();
    }
    let (pairs, odd) = numbers.as_chunks::<2>();
    if odd.is_empty() { Ok(pairs.to_vec()) } else { Err("expected pairs of numbers, got an odd one".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn painted(content: &str) -> Result<Pixmap, String> {
        let mut pixels = Pixmap::new(20, 20).unwrap();
        paint(&format!("<svg viewBox=\"0 -10 10 10\">{content}</svg>"), &mut pixels).map(|()| pixels)
    }

    #[test]
    fn elements_inherit_how_they_are_painted() {
        let pixels = painted(
            "<title>a &lt; b</title><rect y=\"-10\" width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\
             <g fill=\"none\" stroke=\"#ff0000\" stroke-width=\"2\"><path d=\"M0-5l10 0\"><title>x</title></path>\
             <path d=\"\"/></g><circle cx=\"5\" cy=\"-2\" r=\"1\"/>\
             <g fill-opacity=\".50\"><rect x=\"1\" y=\"-9.5\" width=\"2\" height=\"1.5\"/></g>",
        );
        let pixels = pixels.unwrap();
        let at = |x, y| pixels.pixel(x, y).map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]);
        assert_eq!([at(0, 10), at(19, 9), at(0, 6)], [[255, 0, 0], [255, 0, 0], [255; 3]].map(Some));
        assert_eq!([at(10, 15), at(3, 2)], [[0; 3], [127; 3]].map(Some));
    }

    #[test]
    fn what_no_drawing_has_is_refused() {
        for wrong in
            ["<line/>", "<path d=\"M0 0 1\"/>", "<rect fill=\"red\"/>", "<g><path d=\"M1x\"/></g>", "&nbsp;"]
        {
            assert!(painted(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn numbers_of_paths_need_no_separator_but_a_sign() {
        assert_eq!(pairs("10-.3").unwrap(), [[10.0, -0.3]]);
        assert_eq!(pairs(".4 .6 .5 0-10.9-.3").unwrap(), [[0.4, 0.6], [0.5, 0.0], [-10.9, -0.3]]);
        let path = line("M1 2l1 0 0-1ZM5 5").unwrap().unwrap();
        assert_eq!((path.bounds().right(), path.points().len()), (5.0, 4));
    }
}
