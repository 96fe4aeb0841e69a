//! Arrangement of layers on a page: on top of one another, side by side, one after the other.

use super::colour;
use super::layer::{Layer, MAX_SURFACES};
use super::legend::Entry;
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// Width for shapes.
const ROOM: f64 = SIZE - 2.0 * MARGIN;
/// Space above and below shapes.
const GAP: f64 = 12.0;
/// Space below a cell.
const FOOT: f64 = 13.0;
/// Height of a line of the caption of a cell.
const CAPTION: f64 = 13.0;
/// Approximate width of a letter of a caption.
const LETTER: f64 = 5.6;

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

    pub(super) fn of(layers: &[Layer]) -> Self {
        Self::around(layers.iter().flat_map(|layer| layer.lines.iter().flatten()))
    }

    fn and(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|c| self.low[c].min(other.low[c])),
            high: [0, 1].map(|c| self.high[c].max(other.high[c])),
        }
    }

    pub(super) fn centre(&self) -> [f64; 2] {
        [0, 1].map(|c| 0.5 * self.low[c] + 0.5 * self.high[c])
    }

    fn extent(&self) -> [f64; 2] {
        [0, 1].map(|c| self.high[c] - self.low[c])
    }

    /// Largest scale at which it fits a rectangle; `None` for a point and for nothing.
    pub(super) fn scale(&self, [width, height]: [f64; 2]) -> Option<f64> {
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
    let legend = Entry::of(&layers);
    overlay(title, layers, &legend)
}

/// Draws `layers`, back to front, with a legend.
pub fn overlay(title: &str, layers: Vec<Layer>, legend: &[Entry]) -> Drawing {
    let (map, height) = Bounds::of(&layers).fill();
    let elements = layers.into_iter().map(|layer| Element::Shapes(layer, map)).collect();
    Drawing::new(title, height, elements).with_legend(legend)
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

/// A caption, whose lines are separated by `\n`, and the layers above it.
pub type Cell = (String, Vec<Layer>);

/// Draws cells with captions side by side on one scale, each centred on its own shapes.
pub fn grid(title: &str, cells: Vec<Cell>) -> Drawing {
    let columns = columns_of(cells.len());
    in_columns(title, cells, columns)
}

/// Draws cells as [`grid`] in rows of `columns`.
pub fn in_columns(title: &str, cells: Vec<Cell>, columns: usize) -> Drawing {
    let bounds: Vec<Bounds> = cells.iter().map(|(_, layers)| Bounds::of(layers)).collect();
    in_cells(title, cells, &bounds, columns.max(1))
}

/// Draws cells with captions in one row, all in the same frame.
pub fn row(title: &str, cells: Vec<Cell>) -> Drawing {
    let each = cells.iter().map(|(_, layers)| Bounds::of(layers));
    let Some(common) = each.reduce(Bounds::and) else { return Drawing::new(title, 0.0, Vec::new()) };
    let (bounds, columns) = (vec![common; cells.len()], cells.len());
    in_cells(title, cells, &bounds, columns)
}

/// Part of the width of a cell that is used.
const USED: f64 = 0.92;
/// Greatest height of the shapes of a row.
const MAX_HEIGHT: f64 = 420.0;

fn in_cells(title: &str, cells: Vec<Cell>, bounds: &[Bounds], columns: usize) -> Drawing {
    let side = ROOM / columns as f64;
    let scales = bounds.iter().filter_map(|bounds| bounds.scale([USED * side, MAX_HEIGHT]));
    let scale = scales.reduce(f64::min).unwrap_or(1.0);
    let tallest = bounds.iter().map(|bounds| scale * bounds.extent()[1]).fold(0.0, f64::max);
    let lines = cells.iter().map(|(caption, _)| caption.lines().count()).max().unwrap_or(0);
    let captions = CAPTION * lines as f64;
    let row = tallest.clamp(0.0, MAX_HEIGHT) + GAP + captions + FOOT;
    let mut elements = Vec::new();
    let count = cells.len();
    for (i, ((caption, layers), bounds)) in cells.into_iter().zip(bounds).enumerate() {
        let (left, top) = ((i % columns) as f64, (i / columns) as f64);
        let at = [MARGIN + (left + 0.5) * side, row * top + 0.5 * (row - captions - FOOT)];
        let map = Map { scale, centre: bounds.centre(), at };
        elements.extend(layers.into_iter().map(|layer| Element::Shapes(layer, map)));
        for (k, line) in caption.lines().enumerate() {
            let under = [at[0], row * (top + 1.0) - captions + CAPTION * k as f64];
            let line = clipped(line, (side / LETTER) as usize);
            elements.push(Element::Text(Text::new(under, 11, Anchor::Middle, line)));
        }
    }
    Drawing::new(title, row * count.div_ceil(columns) as f64, elements)
}

/// Part of a cell of a sheet that is used.
const FILLED: f64 = 0.86;

/// Draws shapes, one line of the layer each, in the square cells of a sheet, row by row, on one scale and each in the middle of
/// its cell. The cells fill the width of the page. `unit`: the unit of length, if known.
pub fn sheet(title: &str, mut layer: Layer, columns: usize, unit: Option<&str>) -> Drawing {
    let side = SIZE / columns.max(1) as f64;
    let bounds: Vec<Bounds> = layer.lines.iter().map(|line| Bounds::around(line.iter())).collect();
    let scales = bounds.iter().filter_map(|bounds| bounds.scale([FILLED * side; 2]));
    let scale = scales.reduce(f64::min).unwrap_or(1.0);
    for (i, (line, bounds)) in layer.lines.iter_mut().zip(&bounds).enumerate() {
        let cell = [i % columns.max(1), i / columns.max(1)].map(|k| (k as f64 + 0.5) * side);
        let map = Map { scale, centre: bounds.centre(), at: cell };
        for point in line {
            // As in the plane of shapes, y points up.
            let [x, y] = map.place(point);
            *point = [x, -y];
        }
    }
    let rows = layer.lines.len().div_ceil(columns.max(1));
    let page = Map { scale: 1.0, centre: [0.0; 2], at: [0.0; 2] };
    Drawing::new(title, side * rows as f64, vec![Element::Shapes(layer, page)]).with_scale(scale, unit)
}

/// The beginning of a text that has more letters than fit.
fn clipped(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

/// Animation through the lines of a layer and back, with the names of its ends; surfaces are drawn side by side.
pub fn animate(title: &str, layer: Layer, ends: [String; 2]) -> Drawing {
    if layer.hides() {
        return draw(title, vec![layer]);
    }
    let (map, height) = Bounds::around(layer.lines.iter().flatten()).fill();
    let end = |colour, name: String| {
        Entry::Sample(Layer::from_points(Vec::new(), layer.mark, colour, 1.0).named(name))
    };
    let [first, last] = ends;
    let legend = [end(colour::MINUS, first), end(colour::PLUS, last)];
    Drawing::new(title, height, vec![Element::Animation(layer, map)]).with_legend(&legend)
}

#[cfg(test)]
mod tests {
    use super::*;
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
            legend: true,
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
