//! Drawings as SVG: settings of the viewer, and the text.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::colour::{self, Colour};
use super::layer::{Layer, Mark};
use super::line::{Place, Resolution};
use super::picture::on_page;
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// Colours of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Theme {
    /// Light or dark, as the viewer prefers (`prefers-color-scheme`). Programs without this preference show light colours.
    #[default]
    Auto,
    /// Dark lines on a light page.
    Light,
    /// Light lines on a dark page.
    Dark,
}

/// Background of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Background {
    /// A painted page.
    #[default]
    Page,
    /// Nothing: transparent.
    None,
}

/// Settings of the viewer of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Style {
    /// Colours.
    pub theme: Theme,
    /// Its background.
    pub background: Background,
    /// Width in pixels.
    pub width: u16,
    /// Whether the title is written above. It stays the name of the picture for readers of the screen.
    pub title: bool,
    /// Whether drawings to scale have a scale bar.
    pub scale_bar: bool,
    /// Whether the legend is written below.
    pub legend: bool,
}

impl Style {
    /// Range of widths.
    pub const WIDTHS: (u16, u16) = (16, 4096);
}

impl Default for Style {
    fn default() -> Self {
        let width = SIZE as u16;
        let (theme, background) = (Theme::Auto, Background::Page);
        Self { theme, background, width, title: true, scale_bar: true, legend: true }
    }
}

/// Height of the line with the title.
const TITLE: f64 = 28.0;
/// Space above drawings without a written title.
const TOP: f64 = 8.0;

impl Style {
    /// Pixels per unit of the page, and the space above the contents in these units.
    pub(super) fn scale_and_top(&self) -> [f64; 2] {
        [f64::from(self.width) / SIZE, top(self)]
    }

    /// Colour of the page, if it is painted; that of a light page under [`Theme::Auto`].
    pub fn page(&self) -> Option<[u8; 3]> {
        let colour = if self.theme == Theme::Dark { colour::PAGE.dark() } else { colour::PAGE.light() };
        (self.background == Background::Page).then_some(colour)
    }
}

/// Space above the contents.
fn top(style: &Style) -> f64 {
    if style.title { TITLE } else { TOP }
}

impl Drawing {
    /// The drawing as an SVG document. The cost is linear in the number of points.
    pub fn to_svg(&self, style: &Style) -> String {
        let mut writer = Writer::new(style);
        if style.background == Background::Page {
            let page = writer.paint("fill", colour::PAGE);
            writer
                .write(format_args!("<rect y=\"{}\" width=\"100%\" height=\"100%\"{page}/>\n", -top(style)));
        }
        if style.title {
            writer.text(&Text::new([MARGIN, -8.0], 14, Anchor::Start, self.title.clone()));
        }
        if let Some(picture) = &self.picture {
            writer.picture(&picture.0.address, on_page(picture));
        }
        for element in &self.elements {
            writer.element(element);
        }
        if style.legend {
            self.legend.iter().for_each(|element| writer.element(element));
        }
        if let Some(bar) = self.scale_bar(self.bottom(style)).filter(|_| style.scale_bar) {
            bar.iter().for_each(|element| writer.element(element));
        }
        self.document(style, writer)
    }

    /// Width and height in pixels.
    pub fn pixels(&self, style: &Style) -> [u64; 2] {
        let pixels = f64::from(style.width) / SIZE;
        [u64::from(style.width), (self.page_height(style) * pixels).round().max(1.0) as u64]
    }

    /// Height of the page, on which a picture is [`SIZE`] wide.
    fn page_height(&self, style: &Style) -> f64 {
        let bar = if style.scale_bar { self.scale_bar_height() } else { 0.0 };
        (self.bottom(style) + bar + top(style)).round()
    }

    /// End of the contents and, if it is written, of the legend.
    fn bottom(&self, style: &Style) -> f64 {
        if style.legend { self.height + self.legend_height } else { self.height }
    }

    fn document(&self, style: &Style, writer: Writer<'_>) -> String {
        let (height, [width, pixels]) = (self.page_height(style), self.pixels(style));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"shapelex\" viewBox=\"0 {} {SIZE} {height}\" \
             width=\"{width}\" height=\"{pixels}\" font-family=\"sans-serif\">\n<title>{}</title>\n{}{}</svg>\n",
            -top(style),
            escape(&self.title),
            writer.rules(),
            writer.svg
        )
    }

    /// Approximate length of the text of an animation in bytes, in which every line appears twice.
    pub fn animation_bytes(&self, style: &Style) -> usize {
        let resolution = resolution(style);
        let animated = self.elements.iter().filter_map(|element| match element {
            Element::Animation(layer, map) => Some((layer, map)),
            _ => None,
        });
        let points = animated
            .map(|(layer, map)| layer.lines.len() * resolution.frame_points(&layer.lines, |p| map.place(p)));
        2 * POINT_BYTES * points.sum::<usize>()
    }
}

/// Distance of a word from its point, to the right and up.
const WORD_OFFSET: f64 = 4.0;

/// Approximate length of the text of a point, such as ` 12.3-4.5`, in bytes.
const POINT_BYTES: usize = 9;

fn resolution(style: &Style) -> Resolution {
    Resolution::new(f64::from(style.width) / SIZE)
}

/// Text of a drawing as far as it is written.
struct Writer<'a> {
    style: &'a Style,
    resolution: Resolution,
    svg: String,
    /// Colours on dark pages of the colours used, if viewers choose.
    dark: BTreeMap<String, String>,
}

impl<'a> Writer<'a> {
    fn new(style: &'a Style) -> Self {
        Self { style, resolution: resolution(style), svg: String::new(), dark: BTreeMap::new() }
    }

    fn write(&mut self, text: std::fmt::Arguments<'_>) {
        self.svg.write_fmt(text).expect("writing to a string cannot fail");
    }

    /// The attribute that gives a thing its colour.
    fn paint(&mut self, attribute: &str, colour: Colour) -> String {
        let (light, dark) = (colour.on_light(), colour.on_dark());
        if self.style.theme == Theme::Dark {
            return format!(" {attribute}=\"{dark}\"");
        }
        let text = format!(" {attribute}=\"{light}\"");
        if self.style.theme == Theme::Auto && light != dark {
            self.dark.insert(light, dark);
        }
        text
    }

    /// Style sheet that replaces the colours on dark pages. Rules take precedence over attributes, and programs that do not know
    /// the preference ignore them.
    fn rules(&self) -> String {
        if self.dark.is_empty() {
            return String::new();
        }
        let rule = |(light, dark): (&String, &String)| {
            let of = |name| format!(".shapelex [{name}=\"{light}\"]{{{name}:{dark}}}");
            of("fill") + &of("stroke")
        };
        let rules: String = self.dark.iter().map(rule).collect();
        format!("<style>@media (prefers-color-scheme:dark){{{rules}}}</style>\n")
    }

    fn element(&mut self, element: &Element) {
        match element {
            Element::Shapes(layer, map) => self.layer(layer, |p| map.place(p)),
            Element::Animation(layer, map) => self.animation(layer, map),
            Element::Text(text) => self.text(text),
            Element::Box { corner, size, colour, opacity } => {
                let paint = self.paint("fill", *colour);
                let [[x, y], [width, height]] =
                    [corner, size].map(|pair| pair.map(|x| self.resolution.number(x)));
                let opacity = attribute_unless_one("fill-opacity", *opacity);
                self.write(format_args!(
                    "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"{paint}{opacity}/>\n"
                ));
            }
        }
    }

    fn picture(&mut self, address: &str, [corner, size]: [[f64; 2]; 2]) {
        let [[x, y], [width, height]] = [corner, size].map(|pair| pair.map(|x| self.resolution.number(x)));
        let address = escape(address);
        self.write(format_args!(
            "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
             image-rendering=\"optimizeSpeed\" href=\"{address}\"/>\n"
        ));
    }

    fn text(&mut self, Text { at, size, anchor, text, colour }: &Text) {
        let paint = self.paint("fill", *colour);
        let [x, y] = at.map(|x| self.resolution.number(x));
        let anchor = match anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let text = escape(text);
        self.write(format_args!(
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\"{anchor}{paint}>{text}</text>\n"
        ));
    }

    fn layer(&mut self, layer: &Layer, place: impl Place) {
        let Layer { lines, colours, mark, colour, width, opacity, .. } = layer;
        match mark {
            Mark::Facets => {
                for (i, (corners, colours)) in lines.iter().zip(colours).enumerate() {
                    self.facets(corners, colours, (layer.titles.get(i), &place));
                }
            }
            Mark::Dots => {
                let (paint, opacity) =
                    (self.paint("fill", *colour), attribute_unless_one("fill-opacity", *opacity));
                let radius = self.resolution.number(layer.radius());
                self.write(format_args!("<g{paint}{opacity}>\n"));
                for (i, line) in lines.iter().enumerate() {
                    let title = layer.titles.get(i);
                    self.svg.push_str(if title.is_some() { "<g>" } else { "" });
                    self.title(title);
                    for point in line {
                        let [x, y] = place(point).map(|x| self.resolution.number(x));
                        self.write(format_args!("<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\"/>\n"));
                    }
                    self.svg.push_str(if title.is_some() { "</g>" } else { "" });
                }
                self.svg.push_str("</g>\n");
            }
            Mark::Arrows => {
                let paint = self.paint("stroke", *colour);
                self.write(format_args!("<g{STROKE}{paint} stroke-width=\"{width}\">\n"));
                for line in lines {
                    if let [Some(from), Some(to)] = [line.first(), line.last()] {
                        self.arrow(place(from), place(to));
                    }
                }
                self.svg.push_str("</g>\n");
            }
            Mark::Words => self.words(layer, &place),
            Mark::Closed | Mark::Open => {
                let resolution = self.resolution.of_faint(*opacity);
                let (paint, opacity) =
                    (self.paint("stroke", *colour), attribute_unless_one("stroke-opacity", *opacity));
                self.write(format_args!("<g{STROKE}{paint} stroke-width=\"{width}\"{opacity}>\n"));
                for (i, line) in lines.iter().enumerate() {
                    self.svg.push_str("<path d=\"");
                    resolution.push_path(&mut self.svg, line, &place, *mark == Mark::Closed);
                    match layer.titles.get(i) {
                        None => self.svg.push_str("\"/>\n"),
                        title => {
                            self.svg.push_str("\">");
                            self.title(title);
                            self.svg.push_str("</path>\n");
                        }
                    }
                }
                self.svg.push_str("</g>\n");
            }
        }
    }

    /// The titles of the lines beside their first points.
    fn words(&mut self, Layer { lines, titles, colour, .. }: &Layer, place: &impl Place) {
        for (line, word) in lines.iter().zip(titles) {
            if let Some([x, y]) = line.first().map(place) {
                let at = [x + WORD_OFFSET, y - WORD_OFFSET];
                let text = Text::new(at, 10, Anchor::Start, word.clone());
                self.text(&Text { colour: *colour, ..text });
            }
        }
    }

    /// An arrow, unless it is too short to be seen.
    fn arrow(&mut self, from: [f64; 2], to: [f64; 2]) {
        let v = [0, 1].map(|c| to[c] - from[c]);
        let length = v[0].hypot(v[1]);
        if !(length >= SHORTEST_ARROW) {
            return;
        }
        let head = ARROW_HEAD.min(0.6 * length) / length;
        let barb = |side: f64| [to[0] - head * (v[0] - side * v[1]), to[1] - head * (v[1] + side * v[0])];
        self.svg.push_str("<path d=\"");
        for line in [&[from, to][..], &[barb(0.5), to, barb(-0.5)]] {
            self.resolution.push_path(&mut self.svg, line, |p| *p, false);
        }
        self.svg.push_str("\"/>\n");
    }

    /// The name of an element, which viewers show where one points at it.
    fn title(&mut self, title: Option<&String>) {
        if let Some(title) = title {
            self.write(format_args!("<title>{}</title>", escape(title)));
        }
    }

    fn facets(
        &mut self,
        corners: &[[f64; 2]],
        colours: &[Colour],
        (title, place): (Option<&String>, impl Place),
    ) {
        self.svg.push_str("<g stroke-width=\".6\" stroke-linejoin=\"round\">\n");
        self.title(title);
        for (facet, colour) in corners.chunks_exact(4).zip(colours) {
            let (fill, stroke) = (self.paint("fill", *colour), self.paint("stroke", *colour));
            self.write(format_args!("<path{fill}{stroke} d=\""));
            self.resolution.push_polygon(&mut self.svg, facet, &place);
            self.svg.push_str("\"/>\n");
        }
        self.svg.push_str("</g>\n");
    }

    /// Animation through the lines of a layer and back, in a loop; the first and last line stay visible as thin lines. Viewers
    /// without animation show the first.
    fn animation(&mut self, layer: &Layer, map: &Map) {
        let there = self.resolution.frames(&layer.lines, |p| map.place(p), layer.mark == Mark::Closed);
        for (path, colour) in [(there.first(), colour::MINUS), (there.last(), colour::PLUS)] {
            let (Some(path), paint) = (path, self.paint("stroke", colour)) else { continue };
            self.write(format_args!("<path{STROKE}{paint} stroke-opacity=\".6\" d=\"{path}\"/>\n"));
        }
        let frames: Vec<&str> = there.iter().chain(there.iter().rev().skip(1)).map(String::as_str).collect();
        let seconds = FRAME_SECONDS * frames.len().saturating_sub(1).max(1) as f64;
        let (paint, width) = (self.paint("stroke", layer.colour), layer.width);
        let (first, values) = (frames.first().unwrap_or(&""), frames.join(";"));
        self.write(format_args!(
            "<path{STROKE}{paint} stroke-width=\"{width}\" d=\"{first}\"><animate attributeName=\"d\" \
             dur=\"{seconds:.1}s\" repeatCount=\"indefinite\" values=\"{values}\"/></path>\n"
        ));
    }
}

/// Attributes of lines.
const STROKE: &str = " fill=\"none\" stroke-linejoin=\"round\" stroke-linecap=\"round\"";

/// Length of the shortest arrow that is seen beside a dot.
const SHORTEST_ARROW: f64 = 1.0;
/// Length of the head of an arrow.
const ARROW_HEAD: f64 = 8.0;

/// Seconds per frame of an animation.
const FRAME_SECONDS: f64 = 0.4;

/// ` name="value"`, or nothing for 1, which is the default of opacities.
fn attribute_unless_one(name: &str, value: f64) -> String {
    if value < 1.0 { format!(" {name}=\"{value:.2}\"") } else { String::new() }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
