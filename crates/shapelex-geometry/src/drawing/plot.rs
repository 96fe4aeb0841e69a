//! Plots of functions of one variable.

use super::colour::{self, Colour};
use super::layer::{Layer, Mark};
use super::legend::entry_at;
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// One function: name, colour, and its graph in pieces, which leaves gaps at jumps.
#[derive(Debug, Clone)]
pub struct Graph {
    /// Entry of the legend.
    pub name: String,
    /// Colour.
    pub colour: Colour,
    /// Pieces of the graph, each a list of `[x, y]`.
    pub pieces: Vec<Vec<[f64; 2]>>,
}

const HEIGHT: f64 = 400.0;
/// Width reserved for the labels of the vertical axis.
const LABELS: f64 = 24.0;

/// Draws the graphs in one frame with both axes labelled.
pub fn plot(title: &str, variable: &str, graphs: Vec<Graph>) -> Drawing {
    let points = || graphs.iter().flat_map(|graph| graph.pieces.iter().flatten());
    let range = |c: usize| {
        let (low, high) = points().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[c]), b.max(p[c])));
        if high > low { (low, high) } else { (low - 1.0, low + 1.0) }
    };
    let frame = Frame { x: range(0), y: range(1) };
    let mut elements = frame.grid();
    elements.push(label([RIGHT - 4.0, BOTTOM + 28.0], Anchor::Start, variable.to_owned()));
    let mut legend = LEFT;
    let page = Map { scale: 1.0, centre: [0.0; 2], at: [0.0; 2] };
    for Graph { name, colour, pieces } in graphs {
        let on_page = |piece: &Vec<[f64; 2]>| piece.iter().map(|p| frame.place(p)).collect();
        let lines = pieces.iter().map(on_page).collect();
        let layer = Layer { lines, ..Layer::from_points(Vec::new(), Mark::Open, colour, 2.0) };
        elements.extend(entry_at(&layer, &name, [legend, HEIGHT + 8.0], 18.0));
        legend += 60.0 + 8.0 * name.chars().count() as f64;
        elements.push(Element::Shapes(layer, page));
    }
    Drawing::new(title, HEIGHT + 28.0, elements)
}

/// Left, right, bottom and top end of the axes on the page.
const LEFT: f64 = MARGIN + LABELS;
const RIGHT: f64 = SIZE - MARGIN;
const BOTTOM: f64 = HEIGHT - MARGIN;
const TOP: f64 = MARGIN / 2.0;

/// Ranges of the axes.
struct Frame {
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    /// Place of a point on the page, with `y` upwards as in the plane of shapes.
    fn place(&self, p: &[f64; 2]) -> [f64; 2] {
        [self.across(p[0]), -self.down(p[1])]
    }

    fn across(&self, value: f64) -> f64 {
        LEFT + (RIGHT - LEFT) * (value - self.x.0) / (self.x.1 - self.x.0)
    }

    fn down(&self, value: f64) -> f64 {
        BOTTOM + (TOP - BOTTOM) * (value - self.y.0) / (self.y.1 - self.y.0)
    }

    /// Lines at round numbers, with the numbers beside them.
    fn grid(&self) -> Vec<Element> {
        let line = |corner, size| Element::Box { corner, size, colour: colour::GRID, opacity: 1.0 };
        let upright = ticks(self.x.0, self.x.1).into_iter().flat_map(|tick| {
            let x = self.across(tick);
            let number = label([x, BOTTOM + 14.0], Anchor::Middle, tick.to_string());
            [line([x - 0.5, TOP], [1.0, BOTTOM - TOP]), number]
        });
        let level = ticks(self.y.0, self.y.1).into_iter().flat_map(|tick| {
            let y = self.down(tick);
            let number = label([LEFT - 6.0, y + 4.0], Anchor::End, tick.to_string());
            [line([LEFT, y - 0.5], [RIGHT - LEFT, 1.0]), number]
        });
        upright.chain(level).collect()
    }
}

fn label(at: [f64; 2], anchor: Anchor, text: String) -> Element {
    Element::Text(Text { colour: colour::LABEL, ..Text::new(at, 11, anchor, text) })
}

/// Four to nine round numbers within `[low, high]`.
pub(super) fn ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 6.0;
    let power = 10.0_f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].map(|s| s * power).into_iter().find(|s| *s >= rough).unwrap_or(10.0 * power);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    let decimals = (-step.log10().floor()).max(0.0) as i32;
    let round = |value: f64| (value * 10.0_f64.powi(decimals)).round() / 10.0_f64.powi(decimals) + 0.0;
    (first..=last).map(|k| round(k as f64 * step)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(-2.0, 2.0), [-2.0, -1.0, 0.0, 1.0, 2.0]);
        assert_eq!(ticks(-0.13, 0.71), [0.0, 0.2, 0.4, 0.6]);
        assert!(ticks(0.0, 37.0).len() >= 4);
    }
}
