//! Arrangement of layers on a page: on top of one another, side by side, one after the other.

use super::layer::{Layer, MAX_SURFACES, Mark};
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// Width for shapes.
const ROOM: f64 = SIZE - 2.0 * MARGIN;
/// Space above and below shapes.
const GAP: f64 = 12.0;
/// Height of a line of the legend.
const LINE: f64 = 20.0;
/// Height of the caption of a cell.
const CAPTION: f64 = 26.0;

/// Smallest rectangle around points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    low: [f64; 2],
    high: [f64; 2],
}

impl Bounds {
    pub(super) fn around<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Self {
        let start = Self { low: [f64::MAX; 2], high: [f64::MIN; 2] };
        points.fold(start, |bounds, p| Self {
            low: [0, 1].map(|c| bounds.low[c].min(p[c])),
            high: [0, 1].map(|c| bounds.high[c].max(p[c])),
        })
    }

    fn of(layers: &[Layer]) -> Self {
        Self::around(layers.iter().flat_map(|layer| layer.lines.iter().flatten()))
    }

    fn and(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|c| self.low[c].min(other.low[c])),
            high: [0, 1].map(|c| self.high[c].max(other.high[c])),
        }
    }

    fn centre(&self) -> [f64; 2] {
        [0, 1].map(|c| 0.5 * self.low[c] + 0.5 * self.high[c])
    }

    fn extent(&self) -> [f64; 2] {
        [0, 1].map(|c| self.high[c] - self.low[c])
    }

    /// Largest scale at which it fits a rectangle; `None` for a point and for nothing.
    fn scale(&self, [width, height]: [f64; 2]) -> Option<f64> {
        let [x, y] = self.extent();
        let scale = (width / x.max(0.0)).min(height / y.max(0.0));
        (scale.is_finite() && scale > 0.0).then_some(scale)
    }

    /// Map that shows it as large as the page allows, below the title, and the height that it needs.
    pub(super) fn fill(&self) -> (Map, f64) {
        let scale = self.scale([ROOM; 2]).unwrap_or(1.0);
        let height = (scale * self.extent()[1]).clamp(0.0, ROOM) + 2.0 * GAP;
        (Map { scale, centre: self.centre(), at: [SIZE / 2.0, height / 2.0] }, height)
    }
}

/// Draws `layers`, back to front, under a title, with a legend of those with a name.
pub fn draw(title: &str, layers: Vec<Layer>) -> Drawing {
    if layers.iter().any(Layer::hides) {
        return side_by_side(title, &layers);
    }
    let (map, height) = Bounds::of(&layers).fill();
    let (legend, lines) = legend(&layers, height);
    let mut elements: Vec<Element> = layers.into_iter().map(|layer| Element::Shapes(layer, map)).collect();
    elements.extend(legend);
    Drawing::new(title, height + lines, elements)
}

/// Entries of the legend from `top` on, and their height.
fn legend(layers: &[Layer], top: f64) -> (Vec<Element>, f64) {
    let mut elements = Vec::new();
    let (mut x, mut line) = (MARGIN, 0.0);
    for layer in layers {
        let Some(name) = &layer.name else { continue };
        let width = 40.0 + 7.5 * name.chars().count() as f64;
        if x > MARGIN && x + width > SIZE - MARGIN {
            (x, line) = (MARGIN, line + 1.0);
        }
        elements.extend(entry(layer, name, [x, top + LINE * line + 10.0], 18.0));
        x += width;
    }
    let height = if elements.is_empty() { 0.0 } else { LINE * (line + 1.0) + 4.0 };
    (elements, height)
}

/// Least opacity of a sample in the legend: fainter ones are seen only where they overlap.
const FAINTEST: f64 = 0.4;

/// Sample of a layer and its name, on a line with its middle at `[x, y]`.
pub(super) fn entry(layer: &Layer, name: &str, [x, y]: [f64; 2], width: f64) -> [Element; 2] {
    let text = Text::new([x + width + 6.0, y + 5.0], 13, Anchor::Start, name.to_owned());
    [sample(layer, [x, y], width), Element::Text(text)]
}

/// What a layer looks like: a line, a dot, or a patch of a surface.
fn sample(layer: &Layer, [x, y]: [f64; 2], width: f64) -> Element {
    let opacity = layer.opacity.max(FAINTEST);
    let at = |p: [f64; 2]| Map { scale: 1.0, centre: [0.0; 2], at: p };
    let mut one = Layer { lines: vec![vec![[0.0, 0.0]]], light: Vec::new(), opacity, ..layer.clone() };
    match layer.mark {
        Mark::Dots => Element::Shapes(one, at([x + 0.5 * width, y])),
        Mark::Closed | Mark::Open => {
            one.lines = vec![vec![[0.0, 0.0], [width, 0.0]]];
            one.mark = Mark::Open;
            Element::Shapes(one, at([x, y]))
        }
        Mark::Arrows => {
            one.lines = vec![vec![[0.0, 0.0], [width, 0.0]]];
            Element::Shapes(one, at([x, y]))
        }
        Mark::Facets => Element::Box {
            corner: [x, y - 5.0],
            size: [width, 10.0],
            colour: layer.colour.pale(),
            opacity: 1.0,
        },
    }
}

/// Draws one shape per cell, those of the front layer first.
fn side_by_side(title: &str, layers: &[Layer]) -> Drawing {
    let mut cells: Vec<(String, Vec<Layer>)> = Vec::new();
    for layer in layers.iter().rev() {
        let (before, room) = (cells.len(), MAX_SURFACES - cells.len());
        cells.extend(layer.apart().take(room).map(|one| (one.name.clone().unwrap_or_default(), vec![one])));
        // Only the first of many surfaces are drawn, so the caption says so.
        let many = layer.lines.len() > 1 && layer.name.is_some();
        if let (true, Some((caption, _))) = (many, cells.get_mut(before)) {
            *caption = format!("some of {caption}");
        }
    }
    grid(title, cells)
}

/// Maximum number of cells per row.
const MAX_COLUMNS: usize = 10;

/// Number of columns of a grid that is about as wide as high; few cells are in one row.
fn columns_of(cells: usize) -> usize {
    if cells <= 3 {
        cells.max(1)
    } else {
        (cells as f64).sqrt().ceil().clamp(1.0, MAX_COLUMNS as f64) as usize
    }
}

/// Draws cells with captions side by side on one scale, each centred on its own shapes.
pub fn grid(title: &str, cells: Vec<(String, Vec<Layer>)>) -> Drawing {
    let bounds: Vec<Bounds> = cells.iter().map(|(_, layers)| Bounds::of(layers)).collect();
    let columns = columns_of(cells.len());
    in_cells(title, cells, &bounds, columns)
}

/// Draws cells with captions in one row, all in the same frame.
pub fn row(title: &str, cells: Vec<(String, Vec<Layer>)>) -> Drawing {
    let each = cells.iter().map(|(_, layers)| Bounds::of(layers));
    let Some(common) = each.reduce(Bounds::and) else { return Drawing::new(title, 0.0, Vec::new()) };
    let (bounds, columns) = (vec![common; cells.len()], cells.len());
    in_cells(title, cells, &bounds, columns)
}

/// Part of the width of a cell that is used.
const USED: f64 = 0.92;
/// Greatest height of the shapes of a row.
const MAX_HEIGHT: f64 = 420.0;

fn in_cells(title: &str, cells: Vec<(String, Vec<Layer>)>, bounds: &[Bounds], columns: usize) -> Drawing {
    let side = ROOM / columns as f64;
    let scales = bounds.iter().filter_map(|bounds| bounds.scale([USED * side, MAX_HEIGHT]));
    let scale = scales.reduce(f64::min).unwrap_or(1.0);
    let tallest = bounds.iter().map(|bounds| scale * bounds.extent()[1]).fold(0.0, f64::max);
    let row = tallest.clamp(0.0, MAX_HEIGHT) + GAP + CAPTION;
    let mut elements = Vec::new();
    let count = cells.len();
    for (i, ((caption, layers), bounds)) in cells.into_iter().zip(bounds).enumerate() {
        let (left, top) = ((i % columns) as f64, (i / columns) as f64);
        let at = [MARGIN + (left + 0.5) * side, row * top + 0.5 * (row - CAPTION)];
        let map = Map { scale, centre: bounds.centre(), at };
        elements.extend(layers.into_iter().map(|layer| Element::Shapes(layer, map)));
        let under = [at[0], row * (top + 1.0) - CAPTION + 14.0];
        elements.push(Element::Text(Text::new(under, 11, Anchor::Middle, caption)));
    }
    Drawing::new(title, row * count.div_ceil(columns) as f64, elements)
}

/// Animation through the lines of a layer and back; surfaces are drawn side by side.
pub fn animate(title: &str, layer: Layer) -> Drawing {
    if layer.hides() {
        return draw(title, vec![layer]);
    }
    let (map, height) = Bounds::around(layer.lines.iter().flatten()).fill();
    Drawing::new(title, height, vec![Element::Animation(layer, map)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::colour;
    use crate::drawing::svg::{Background, Style, Theme};
    use crate::generator::GeneratorKind;
    use crate::representation::{Representation, ShapeSpace};

    fn circles(radii: &[f64]) -> Layer {
        let generator = GeneratorKind::Trigonometric {};
        let space =
            ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 4, generator })
                .unwrap();
        let shapes: Vec<[f64; 8]> =
            radii.iter().map(|r| [1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, -1.0].map(|x| x * r)).collect();
        Layer::of(&space, shapes.iter().map(<[f64; 8]>::as_slice), colour::MAIN, 2.0, 1.0)
    }

    #[test]
    fn a_circle_fills_the_picture_and_text_is_escaped() {
        let svg = draw("a < b", vec![circles(&[1.0]).named("<c>")]).to_svg(&Style::default());
        assert!(svg.contains("a &lt; b") && svg.contains("&lt;c&gt;") && !svg.contains("NaN"));
        // the rightmost point of the circle touches the margin
        assert!(svg.contains(&format!("M{} {}", SIZE - MARGIN, GAP + ROOM / 2.0)), "{svg}");
    }

    #[test]
    fn settings_of_the_viewer_are_obeyed() {
        let drawing = draw("two", vec![circles(&[1.0, 2.0])]).to_scale(Some("mm"));
        let plain = drawing.to_svg(&Style::default());
        let dark = colour::MAIN.on_dark();
        assert!(plain.contains("prefers-color-scheme:dark") && plain.contains(&dark));
        assert!(
            plain.contains("<rect y=\"-28\"")
                && plain.contains("width=\"640\"")
                && plain.contains(">0.5 mm<")
        );
        let style = Style {
            theme: Theme::Dark,
            background: Background::None,
            width: 320,
            title: false,
            scale_bar: false,
        };
        let bare = drawing.to_svg(&style);
        assert!(!bare.contains("<style") && !bare.contains("<rect") && !bare.contains("<text"), "{bare}");
        assert!(
            bare.contains(&dark) && bare.contains("width=\"320\"") && bare.contains("<title>two</title>")
        );
        let is_of_number = |c: char| c.is_ascii_digit() || c == '.';
        let numbers = |d: &str| d.split(|c| !is_of_number(c)).filter(|number| !number.is_empty()).count();
        let points =
            |svg: &str| svg.split(" d=\"").skip(1).map(|d| numbers(d.split('"').next().unwrap())).sum();
        // Chords within a tolerance are longer by the root of the scale: 0.71 of the points, and less simple ends.
        let (small, large): (usize, usize) = (points(&bare), points(&plain));
        assert!(10 * small < 8 * large, "{small} of {large} numbers");
        let light = drawing.to_svg(&Style { theme: Theme::Light, ..Style::default() });
        assert!(!light.contains("<style") && light.contains(&colour::MAIN.on_light()));
    }

    #[test]
    fn shapes_without_extent_are_drawn() {
        for layers in [Vec::new(), vec![circles(&[])], vec![circles(&[0.0])], vec![circles(&[1e-300, 1e300])]]
        {
            for drawing in [draw("", layers.clone()), grid("", vec![(String::new(), layers)])] {
                let svg = drawing.to_scale(None).to_svg(&Style::default());
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            }
        }
    }
}
