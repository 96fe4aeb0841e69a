//! Contents of a drawing, before settings of the viewer such as width and colours are known.

use super::colour::{self, Colour};
use super::layer::Layer;
use super::picture::Picture;

/// Width of a page; its height follows from its contents.
pub(super) const SIZE: f64 = 640.0;
/// Space left and right.
pub(super) const MARGIN: f64 = 32.0;

/// A drawing, ready to be written with [`Drawing::to_svg`](super::svg).
#[derive(Debug, Clone)]
pub struct Drawing {
    pub(super) title: String,
    /// Height of the contents, below the title and above the legend.
    pub(super) height: f64,
    /// Contents from back to front; `y` points down from the title.
    pub(super) elements: Vec<Element>,
    /// Legend below the contents.
    pub(super) legend: Vec<Element>,
    /// Height of the legend.
    pub(super) legend_height: f64,
    /// Scale, if lengths in the drawing mean lengths of the shapes.
    pub(super) scale: Option<Scale>,
    /// Picture behind the elements, with the map of its corners.
    pub(super) picture: Option<(Picture, Map)>,
}

/// Scale of a drawing.
#[derive(Debug, Clone)]
pub(super) struct Scale {
    /// Page units per unit of length.
    per_unit: f64,
    /// Name of the unit of length, if known.
    unit: Option<String>,
}

/// A part of a drawing.
#[derive(Debug, Clone)]
pub(super) enum Element {
    /// Lines, dots or surfaces.
    Shapes(Layer, Map),
    /// Lines shown one after the other.
    Animation(Layer, Map),
    /// A line of text.
    Text(Text),
    /// A filled rectangle.
    Box { corner: [f64; 2], size: [f64; 2], colour: Colour, opacity: f64 },
}

/// A line of text.
#[derive(Debug, Clone)]
pub(super) struct Text {
    /// Place of the base line, at the anchor.
    pub(super) at: [f64; 2],
    /// Size of the letters.
    pub(super) size: u8,
    pub(super) anchor: Anchor,
    pub(super) text: String,
    pub(super) colour: Colour,
}

/// Part of a text that is at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl Text {
    pub(super) fn new(at: [f64; 2], size: u8, anchor: Anchor, text: String) -> Self {
        Self { at, size, anchor, text, colour: colour::MAIN }
    }
}

/// Map from the plane of the shapes, whose second axis points up, to the page.
#[derive(Debug, Clone, Copy)]
pub(super) struct Map {
    /// Page units per unit of length.
    pub(super) scale: f64,
    /// Point of the plane.
    pub(super) centre: [f64; 2],
    /// Its place on the page.
    pub(super) at: [f64; 2],
}

impl Map {
    pub(super) fn place(&self, p: &[f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|c| self.scale * (p[c] - self.centre[c]));
        [self.at[0] + x, self.at[1] - y]
    }
}

/// Height of the strip with the scale bar.
const BAR_HEIGHT: f64 = 26.0;
/// Greatest length of the scale bar.
const BAR_LENGTH: f64 = 120.0;

impl Drawing {
    pub(super) fn new(title: impl Into<String>, height: f64, elements: Vec<Element>) -> Self {
        let (legend, legend_height) = (Vec::new(), 0.0);
        Self { title: title.into(), height, elements, legend, legend_height, scale: None, picture: None }
    }

    /// The same drawing with a scale bar, for shapes that keep their sizes; `unit`: the unit of length, if known.
    #[must_use]
    pub fn to_scale(mut self, unit: Option<&str>) -> Self {
        let map = self.elements.iter().find_map(|element| match element {
            Element::Shapes(_, map) | Element::Animation(_, map) => Some(map),
            _ => None,
        });
        self.scale = map.map(|map| Scale { per_unit: map.scale, unit: unit.map(str::to_owned) });
        self
    }

    /// The same drawing with a scale bar for `per_unit` page units per unit of length.
    pub(super) fn with_scale(mut self, per_unit: f64, unit: Option<&str>) -> Self {
        self.scale = Some(Scale { per_unit, unit: unit.map(str::to_owned) });
        self
    }

    /// Height of the strip below with the scale bar, if there is one.
    pub(super) fn scale_bar_height(&self) -> f64 {
        if self.scale.is_some() { BAR_HEIGHT } else { 0.0 }
    }

    /// Scale bar with its label, at the right end of the strip, which begins at `top`.
    pub(super) fn scale_bar(&self, top: f64) -> Option<[Element; 2]> {
        let Scale { per_unit, unit } = self.scale.as_ref()?;
        let length = round_length(BAR_LENGTH / per_unit);
        let (width, right, y) = (length * per_unit, SIZE - MARGIN, top + 12.0);
        let label = match unit {
            Some(unit) => format!("{} {unit}", short(length)),
            None => short(length),
        };
        let bar = Element::Box {
            corner: [right - width, y - 5.0],
            size: [width, 3.0],
            colour: colour::MAIN,
            opacity: 1.0,
        };
        Some([bar, Element::Text(Text::new([right - width - 8.0, y], 12, Anchor::End, label))])
    }
}

/// The largest of …, 0.1, 0.2, 0.5, 1, 2, 5, 10, … that is at most `most`, a positive number.
fn round_length(most: f64) -> f64 {
    let power = 10.0_f64.powf(most.log10().floor());
    let first = [5.0, 2.0, 1.0].map(|digit| digit * power).into_iter().find(|length| *length <= most);
    first.unwrap_or(power)
}

/// A number with at most three digits.
pub fn short(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude != 0.0 && !(1e-4..1e6).contains(&magnitude) {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    let digits = if magnitude > 0.0 { (2.0 - magnitude.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 };
    let text = format!("{value:.digits$}");
    if digits == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_scale_bars_are_round() {
        for (most, length) in [
            (1.0, 1.0),
            (4.9, 2.0),
            (5.0, 5.0),
            (99.0, 50.0),
            (0.0123, 0.01),
            (1e300, 1e300),
            (3e-300, 2e-300),
        ] {
            assert!((round_length(most) / length - 1.0).abs() < 1e-9, "{most}");
        }
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (0.05, "0.05"),
            (0.123_45, "0.123"),
            (-2.0, "-2"),
            (50.0, "50"),
            (1234.4, "1234"),
            (2e7, "2e7"),
            (1.24e-9, "1.2e-9"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
