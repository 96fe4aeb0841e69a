//! Ranges of numbers as strips, one below the other, against a band.

use super::colour;
use super::layer::{Layer, Mark};
use super::plot::ticks;
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// A range of numbers about its middle.
#[derive(Debug, Clone)]
pub struct Strip {
    /// Name.
    pub name: String,
    /// Middle of the range.
    pub middle: f64,
    /// Distance of its ends from the middle.
    pub reach: f64,
}

/// Height of a strip.
const STRIP: f64 = 22.0;
/// Width for the names.
const NAMES: f64 = 110.0;
/// Ends of the axis: at least, and at most. Strips are cut there.
const EXTENT: (f64, f64) = (3.0, 20.0);

/// Draws strips over the band from −1 to 1.
pub fn strips(title: &str, strips: &[Strip]) -> Drawing {
    let farthest = strips.iter().map(|strip| strip.middle.abs() + strip.reach).fold(0.0, f64::max);
    let extent = farthest.clamp(EXTENT.0, EXTENT.1);
    let (left, right) = (MARGIN + NAMES, SIZE - MARGIN);
    let across =
        |value: f64| 0.5 * (left + right) + 0.5 * (right - left) * value.clamp(-extent, extent) / extent;
    let bottom = STRIP * strips.len() as f64;
    let bar = |[from, to]: [f64; 2], y: f64, height: f64, colour| Element::Box {
        corner: [across(from), y - 0.5 * height],
        size: [across(to) - across(from), height],
        colour,
        opacity: 1.0,
    };
    let small = |at: [f64; 2], anchor, text: String| {
        Element::Text(Text { colour: colour::LABEL, ..Text::new(at, 11, anchor, text) })
    };
    let mut elements = vec![bar([-1.0, 1.0], 0.5 * bottom, bottom, colour::GRID)];
    for tick in ticks(-extent, extent) {
        elements.push(small([across(tick), bottom + 14.0], Anchor::Middle, tick.to_string()));
    }
    for (k, strip) in strips.iter().enumerate() {
        let y = STRIP * (k as f64 + 0.5);
        elements.push(small([left - 10.0, y + 4.0], Anchor::End, strip.name.clone()));
        elements.push(bar([strip.middle - strip.reach, strip.middle + strip.reach], y, 4.0, colour::BACK));
        let dot = Layer::from_points(vec![[0.0; 2]], Mark::Dots, colour::MAIN, 2.5);
        elements
            .push(Element::Shapes(dot, Map { scale: 1.0, centre: [0.0; 2], at: [across(strip.middle), y] }));
    }
    Drawing::new(title, bottom + 24.0, elements)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::svg::Style;

    #[test]
    fn strips_stay_on_the_page() {
        let strip = |middle: f64, reach: f64| Strip { name: "<a>".into(), middle, reach };
        let all = [strip(0.0, 1.0), strip(-1e9, 1.0), strip(2.0, 1e300), strip(0.0, 0.0)];
        let svg = strips("t", &all).to_svg(&Style::default());
        assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains("&lt;a&gt;"), "{svg}");
        // the farthest one ends at the left end of the axis
        assert!(svg.contains(&format!("cx=\"{}\"", MARGIN + NAMES)), "{svg}");
        assert!(strips("t", &[]).to_svg(&Style::default()).contains("<title>t</title>"));
    }
}
