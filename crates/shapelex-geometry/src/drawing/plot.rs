//! Plots of functions of one variable: one in a separate frame, or several side by side.

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

/// A plot among others: graphs with intervals, from zero upwards.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Title above the panel.
    pub title: String,
    /// Name of the variable.
    pub variable: String,
    /// Graphs, each with intervals `[x, low, high]`.
    pub graphs: Vec<(Graph, Vec<[f64; 3]>)>,
}

const HEIGHT: f64 = 400.0;
/// Width reserved for the labels of the vertical axis.
const LABELS: f64 = 24.0;

/// Page units are those of the layers.
pub(super) const PAGE: Map = Map { scale: 1.0, centre: [0.0; 2], at: [0.0; 2] };

/// Draws the graphs in one frame with both axes labelled.
pub fn plot(title: &str, variable: &str, graphs: Vec<Graph>) -> Drawing {
    let points = || graphs.iter().flat_map(|graph| graph.pieces.iter().flatten().copied());
    let frame = Frame {
        x: range(points().map(|p| p[0])),
        y: range(points().map(|p| p[1])),
        across: [MARGIN + LABELS, SIZE - MARGIN],
        down: [MARGIN / 2.0, HEIGHT - MARGIN],
    };
    let mut elements = frame.grid();
    elements.push(label([frame.across[1] - 4.0, frame.down[1] + 28.0], Anchor::Start, variable.to_owned()));
    let mut legend = frame.across[0];
    for graph in graphs {
        let layer = frame.lines(&graph);
        elements.extend(entry_at(&layer, &graph.name, [legend, HEIGHT + 8.0], 18.0));
        legend += 60.0 + 8.0 * graph.name.chars().count() as f64;
        elements.push(Element::Shapes(layer, PAGE));
    }
    Drawing::new(title, HEIGHT + 28.0, elements)
}

/// Height of a panel with its title and legend, and the space between panels.
const PANEL: f64 = 250.0;
const BETWEEN: f64 = 28.0;

/// Draws panels, two in a row.
pub fn panels(title: &str, panels: Vec<Panel>) -> Drawing {
    let width = (SIZE - 2.0 * MARGIN - BETWEEN) / 2.0;
    let rows = panels.len().div_ceil(2);
    let mut elements = Vec::new();
    for (i, panel) in panels.into_iter().enumerate() {
        let corner = [MARGIN + (i % 2) as f64 * (width + BETWEEN), PANEL * (i / 2) as f64];
        elements.extend(in_panel(panel, corner, width));
    }
    Drawing::new(title, PANEL * rows as f64, elements)
}

fn in_panel(Panel { title, variable, graphs }: Panel, [left, top]: [f64; 2], width: f64) -> Vec<Element> {
    let points = || graphs.iter().flat_map(|(graph, _)| graph.pieces.iter().flatten().copied());
    let ends = graphs.iter().flat_map(|(_, bars)| bars.iter().map(|bar| bar[2]));
    let frame = Frame {
        x: range(points().map(|p| p[0])),
        y: range(points().map(|p| p[1]).chain(ends).chain([0.0])),
        across: [left + 2.0 * LABELS, left + width],
        down: [top + 26.0, top + PANEL - 62.0],
    };
    let mut elements = vec![Element::Text(Text::new([left, top + 14.0], 13, Anchor::Start, title))];
    elements.extend(frame.grid());
    elements.push(label([left + width, frame.down[1] + 28.0], Anchor::End, variable));
    let mut legend = left;
    for (graph, bars) in graphs {
        let bar = |[x, low, high]: &[f64; 3]| vec![frame.place(&[*x, *low]), frame.place(&[*x, *high])];
        let spans: Vec<Vec<[f64; 2]>> = bars.iter().map(bar).collect();
        let spans = Layer {
            lines: spans,
            opacity: 0.45,
            ..Layer::from_points(Vec::new(), Mark::Open, graph.colour, 3.0)
        };
        let layer = frame.lines(&graph);
        elements.extend(entry_at(&layer, &graph.name, [legend, frame.down[1] + 44.0], 18.0));
        legend += 40.0 + 6.0 * graph.name.chars().count() as f64;
        elements.push(Element::Shapes(spans, PAGE));
        elements.push(Element::Shapes(layer, PAGE));
    }
    elements
}

/// Least and greatest of some numbers, apart from each other.
pub(super) fn range(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = numbers.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
    if high > low { (low, high) } else { (low - 1.0, low + 1.0) }
}

/// Ranges of the axes, and their places on the page.
pub(super) struct Frame {
    pub(super) x: (f64, f64),
    pub(super) y: (f64, f64),
    /// Left and right end.
    pub(super) across: [f64; 2],
    /// Upper and lower end.
    pub(super) down: [f64; 2],
}

impl Frame {
    /// Place of a point on the page, with `y` upwards as in the plane of shapes.
    pub(super) fn place(&self, p: &[f64; 2]) -> [f64; 2] {
        [self.across(p[0]), -self.down(p[1])]
    }

    fn across(&self, value: f64) -> f64 {
        let [left, right] = self.across;
        left + (right - left) * (value - self.x.0) / (self.x.1 - self.x.0)
    }

    fn down(&self, value: f64) -> f64 {
        let [top, bottom] = self.down;
        bottom + (top - bottom) * (value - self.y.0) / (self.y.1 - self.y.0)
    }

    /// The lines of a graph.
    fn lines(&self, graph: &Graph) -> Layer {
        let on_page = |piece: &Vec<[f64; 2]>| piece.iter().map(|p| self.place(p)).collect();
        let lines = graph.pieces.iter().map(on_page).collect();
        Layer { lines, ..Layer::from_points(Vec::new(), Mark::Open, graph.colour, 2.0) }
    }

    /// Lines at round numbers, with the numbers beside them.
    pub(super) fn grid(&self) -> Vec<Element> {
        let line = |corner, size| Element::Box { corner, size, colour: colour::GRID, opacity: 1.0 };
        let ([left, right], [top, bottom]) = (self.across, self.down);
        let upright = ticks(self.x.0, self.x.1).into_iter().flat_map(|tick| {
            let x = self.across(tick);
            let number = label([x, bottom + 14.0], Anchor::Middle, tick.to_string());
            [line([x - 0.5, top], [1.0, bottom - top]), number]
        });
        let level = ticks(self.y.0, self.y.1).into_iter().flat_map(|tick| {
            let y = self.down(tick);
            let number = label([left - 6.0, y + 4.0], Anchor::End, tick.to_string());
            [line([left, y - 0.5], [right - left, 1.0]), number]
        });
        upright.chain(level).collect()
    }
}

pub(super) fn label(at: [f64; 2], anchor: Anchor, text: String) -> Element {
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
