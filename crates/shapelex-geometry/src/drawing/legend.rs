//! Legends: samples of layers, scales of colours and sentences, in lines below a drawing.

use super::colour::Colour;
use super::layer::{Layer, Mark};
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, SIZE, Text};

/// An entry of a legend.
#[derive(Debug, Clone)]
pub enum Entry {
    /// Sample of a layer, and its name.
    Sample(Layer),
    /// A range of colours and its meaning.
    Scale {
        /// Colours at both ends.
        colours: (Colour, Colour),
        /// The meaning.
        text: String,
    },
    /// A sentence.
    Text(String),
    /// A row of a table: a name, and numbers that end at equal distances.
    Row(Vec<String>),
}

impl Entry {
    /// Samples of the layers with a name.
    pub fn of(layers: &[Layer]) -> Vec<Self> {
        let sample = |layer: &Layer| Layer {
            lines: Vec::new(),
            colours: Vec::new(),
            name: layer.name.clone(),
            titles: Vec::new(),
            ..*layer
        };
        layers.iter().filter(|layer| layer.name.is_some()).map(|layer| Self::Sample(sample(layer))).collect()
    }
}

/// Height of a line.
const LINE: f64 = 20.0;
/// Approximate width of a letter.
const LETTER: f64 = 7.0;
/// Number of letters of a full line.
const LETTERS: usize = 84;
/// Width of a sample and of a scale.
const SAMPLE: f64 = 18.0;
const SCALE: f64 = 54.0;
/// Maximum number of entries: more could not be told apart.
const MAX_ENTRIES: usize = 60;

impl Drawing {
    /// The same drawing with a legend below. Samples stand side by side, other entries have separate lines.
    #[must_use]
    pub fn with_legend(mut self, entries: &[Entry]) -> Self {
        let (legend, height) = legend(entries, self.height + self.legend_height);
        self.legend.extend(legend);
        self.legend_height += height;
        self
    }
}

/// Place of the next entry.
struct Cursor {
    x: f64,
    y: f64,
    fresh: bool,
}

impl Cursor {
    fn next_line(&mut self) {
        if !self.fresh {
            *self = Self { x: MARGIN, y: self.y + LINE, fresh: true };
        }
    }

    /// Place for something of this width.
    fn take(&mut self, width: f64) -> [f64; 2] {
        if self.x + width > SIZE - MARGIN {
            self.next_line();
        }
        let place = [self.x, self.y];
        (self.x, self.fresh) = (self.x + width, false);
        place
    }
}

/// Elements of a legend from `top` on, and their height.
fn legend(entries: &[Entry], top: f64) -> (Vec<Element>, f64) {
    if entries.is_empty() {
        return (Vec::new(), 0.0);
    }
    let mut elements = Vec::new();
    let mut cursor = Cursor { x: MARGIN, y: top + 0.5 * LINE, fresh: true };
    for entry in entries.iter().take(MAX_ENTRIES) {
        match entry {
            Entry::Sample(layer) => {
                let name = layer.name.as_deref().unwrap_or_default();
                let at = cursor.take(SAMPLE + 22.0 + LETTER * name.chars().count() as f64);
                elements.extend(entry_at(layer, name, at, SAMPLE));
            }
            Entry::Scale { colours, text } => {
                cursor.next_line();
                elements.extend(scale(*colours, [cursor.x, cursor.y]));
                push_lines(&mut elements, &mut cursor, text, SCALE + 6.0);
            }
            Entry::Text(text) => {
                cursor.next_line();
                push_lines(&mut elements, &mut cursor, text, 0.0);
            }
            Entry::Row(cells) => {
                cursor.next_line();
                let [_, y] = cursor.take(SIZE);
                elements.extend(row(cells, y + 5.0));
            }
        }
    }
    cursor.next_line();
    (elements, cursor.y - 0.5 * LINE - top + 4.0)
}

/// Part of the width that the name of a row takes.
const NAMED: f64 = 0.28;

/// Cells of a row with this base line.
fn row(cells: &[String], y: f64) -> impl Iterator<Item = Element> {
    let (left, right) = (MARGIN + NAMED * (SIZE - 2.0 * MARGIN), SIZE - MARGIN);
    let step = (right - left) / cells.len().saturating_sub(1).max(1) as f64;
    cells.iter().enumerate().map(move |(k, cell)| {
        let (x, anchor) = match k {
            0 => (MARGIN, Anchor::Start),
            k => (left + step * k as f64, Anchor::End),
        };
        Element::Text(Text::new([x, y], 13, anchor, cell.clone()))
    })
}

/// Lines of a sentence, `indent` to the right.
fn push_lines(elements: &mut Vec<Element>, cursor: &mut Cursor, text: &str, indent: f64) {
    let most = LETTERS - (indent / LETTER) as usize;
    for line in wrapped(text, most) {
        let [x, y] = cursor.take(SIZE);
        cursor.fresh = false;
        elements.push(Element::Text(Text::new([x + indent, y + 5.0], 13, Anchor::Start, line)));
        cursor.next_line();
    }
}

/// The words of `text` in lines of at most `most` letters, as far as they are short enough.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut().filter(|line| line.chars().count() + 1 + word.chars().count() <= most) {
            Some(line) => *line = format!("{line} {word}"),
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Least opacity of a sample: fainter ones are seen only where they overlap.
const FAINTEST: f64 = 0.4;

/// Sample of a layer and its name, on a line with its middle at `[x, y]`.
pub(super) fn entry_at(layer: &Layer, name: &str, [x, y]: [f64; 2], width: f64) -> [Element; 2] {
    let text = Text::new([x + width + 6.0, y + 5.0], 13, Anchor::Start, name.to_owned());
    [sample(layer, [x, y], width), Element::Text(text)]
}

/// Sample of a layer: a line, a dot, an arrow, or a patch of a surface.
fn sample(layer: &Layer, [x, y]: [f64; 2], width: f64) -> Element {
    let opacity = layer.opacity.max(FAINTEST);
    let at = |p: [f64; 2]| Map { scale: 1.0, centre: [0.0; 2], at: p };
    let one = |points: Vec<[f64; 2]>, mark: Mark| Layer {
        opacity,
        ..Layer::from_points(points, mark, layer.colour, layer.width)
    };
    let across = vec![[0.0, 0.0], [width, 0.0]];
    match layer.mark {
        Mark::Dots | Mark::Words => {
            Element::Shapes(one(vec![[0.0, 0.0]], Mark::Dots), at([x + 0.5 * width, y]))
        }
        Mark::Closed | Mark::Open => Element::Shapes(one(across, Mark::Open), at([x, y])),
        Mark::Arrows => Element::Shapes(one(across, Mark::Arrows), at([x, y])),
        Mark::Facets => Element::Box {
            corner: [x, y - 5.0],
            size: [width, 10.0],
            colour: layer.colour.pale(),
            opacity: 1.0,
        },
    }
}

/// Number of boxes of a scale.
const STEPS: u8 = 9;

/// Boxes with colours from one end of a range to the other.
fn scale((from, to): (Colour, Colour), [x, y]: [f64; 2]) -> impl Iterator<Item = Element> {
    let step = SCALE / f64::from(STEPS);
    (0..STEPS).map(move |i| Element::Box {
        corner: [x + step * f64::from(i), y - 5.0],
        size: [step, 10.0],
        colour: from.towards(to, f64::from(i) / f64::from(STEPS - 1)),
        opacity: 1.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::colour;
    use crate::drawing::layout;
    use crate::drawing::svg::Style;

    #[test]
    fn sentences_are_broken_between_words() {
        assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
        assert_eq!(wrapped("endless words", 3), ["endless", "words"]);
    }

    #[test]
    fn entries_stay_within_the_page_and_below_one_another() {
        let layer = |name: &str| Layer::from_points(Vec::new(), Mark::Open, colour::MAIN, 1.0).named(name);
        let layers: Vec<Layer> = (0..12).map(|i| layer(&format!("a long name of a group {i}"))).collect();
        let text = "word ".repeat(40);
        let entries = [
            Entry::of(&layers),
            vec![
                Entry::Scale { colours: (colour::EFFECT_NONE, colour::EFFECT_MOST), text: "0 to 1".into() },
                Entry::Text(text.trim().into()),
            ],
        ]
        .concat();
        let bare = layout::draw("t", vec![layer("x")]);
        let drawing = layout::draw("t", Vec::new()).with_legend(&entries);
        // six lines of samples, a scale, and three lines of words
        assert!(
            (drawing.height + drawing.legend_height - 24.0 - (10.0 * LINE + 4.0)).abs() < 1e-9,
            "{}",
            drawing.height
        );
        assert!((bare.height + bare.legend_height - 24.0 - (LINE + 4.0)).abs() < 1e-9, "{}", bare.height);
        let svg = drawing.to_svg(&Style::default());
        assert_eq!(svg.matches("<text").count(), 1 + 12 + 1 + 3, "{svg}");
        let without = Style { legend: false, ..Style::default() };
        assert_eq!(drawing.to_svg(&without).matches("<text").count(), 1, "the title");
        assert!(drawing.pixels(&without)[1] < drawing.pixels(&Style::default())[1] - 200);
    }
}
