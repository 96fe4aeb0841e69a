//! Plots of functions of one variable as SVG.

use std::fmt::Write;

use super::svg::{CAPTION, MARGIN, RESOLUTION, SIZE, escape, open};

/// One function: name, colour, and its graph in pieces, which leaves gaps at jumps.
#[derive(Debug, Clone)]
pub struct Graph {
    /// Entry of the legend.
    pub name: String,
    /// Stroke colour.
    pub colour: &'static str,
    /// Pieces of the graph, each a list of `[x, y]`.
    pub pieces: Vec<Vec<[f64; 2]>>,
}

const HEIGHT: f64 = 400.0;
/// Width reserved for the labels of the vertical axis.
const LABELS: f64 = 24.0;

/// Draws the graphs in one frame with both axes labelled.
pub fn plot(title: &str, variable: &str, graphs: &[Graph]) -> String {
    let points = || graphs.iter().flat_map(|graph| graph.pieces.iter().flatten());
    let range = |c: usize| {
        let (low, high) = points().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[c]), b.max(p[c])));
        if high > low { (low, high) } else { (low - 1.0, low + 1.0) }
    };
    let ((left, right), (bottom, top)) = (range(0), range(1));
    let (x0, x1) = (MARGIN + LABELS, SIZE - MARGIN);
    let (y0, y1) = (CAPTION + HEIGHT - MARGIN, CAPTION + MARGIN / 2.0);
    let x = |value: f64| x0 + (x1 - x0) * (value - left) / (right - left);
    let y = |value: f64| y0 + (y1 - y0) * (value - bottom) / (top - bottom);
    let write = "writing to a string cannot fail";
    let mut svg = open(title, CAPTION + HEIGHT + CAPTION);
    svg.push_str("<g stroke=\"#dddddd\" fill=\"#555555\" font-size=\"11\">\n");
    for tick in ticks(left, right) {
        writeln!(
            svg,
            "<line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{y0:.1}\" y2=\"{y1:.1}\"/><text stroke=\"none\" text-anchor=\"middle\" x=\"{0:.1}\" y=\"{1:.1}\">{tick}</text>",
            x(tick), y0 + 14.0
        )
        .expect(write);
    }
    for tick in ticks(bottom, top) {
        writeln!(
            svg,
            "<line x1=\"{x0:.1}\" x2=\"{x1:.1}\" y1=\"{0:.1}\" y2=\"{0:.1}\"/><text stroke=\"none\" text-anchor=\"end\" x=\"{1:.1}\" y=\"{2:.1}\">{tick}</text>",
            y(tick), x0 - 6.0, y(tick) + 4.0
        )
        .expect(write);
    }
    writeln!(
        svg,
        "<text stroke=\"none\" x=\"{:.1}\" y=\"{:.1}\">{}</text></g>",
        x1 - 4.0,
        y0 + 28.0,
        escape(variable)
    )
    .expect(write);
    let mut legend = x0;
    for graph in graphs {
        for piece in &graph.pieces {
            write!(svg, "<path fill=\"none\" stroke-width=\"2\" stroke=\"{}\" d=\"", graph.colour)
                .expect(write);
            RESOLUTION.push_path(&mut svg, piece, |p| [x(p[0]), y(p[1])], false);
            svg.push_str("\"/>\n");
        }
        name(&mut svg, graph, legend);
        legend += 60.0 + 8.0 * graph.name.chars().count() as f64;
    }
    svg.push_str("</svg>\n");
    svg
}

/// Writes the colour and the name of a graph below the frame, from `left` on.
fn name(svg: &mut String, graph: &Graph, left: f64) {
    writeln!(
        svg,
        "<rect x=\"{left}\" y=\"{0:.0}\" width=\"18\" height=\"4\" fill=\"{1}\"/><text x=\"{2:.0}\" y=\"{3:.0}\">{4}</text>",
        CAPTION + HEIGHT + 6.0, graph.colour, left + 24.0, CAPTION + HEIGHT + 12.0, escape(&graph.name)
    )
    .expect("writing to a string cannot fail");
}

/// Four to nine round numbers within `[low, high]`.
fn ticks(low: f64, high: f64) -> Vec<f64> {
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
