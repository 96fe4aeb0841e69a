//! Drawings of shapes over one another, with an effect along one of them as colour and width.

use std::fmt::Write;

use super::svg::{CAPTION, Layer, MARGIN, Page, draw_layer, escape, flatten, open};

/// An effect along a shape.
#[derive(Debug, Clone)]
pub struct Effect {
    /// Points in their order along the shape.
    pub points: Vec<EffectPoint>,
    /// Whether the last point goes on to the first.
    pub closed: bool,
    /// Whether the points are of one curve; else they are drawn as dots.
    pub connected: bool,
    /// Colours of no effect and of the largest one, red, green and blue.
    pub colours: ([u8; 3], [u8; 3]),
}

/// The effect at a point.
#[derive(Debug, Clone)]
pub struct EffectPoint {
    /// Where it is, in the plane or in space.
    pub point: Vec<f64>,
    /// How large it is.
    pub length: f64,
    /// Whether it is drawn wide.
    pub significant: bool,
}

/// Height of a line of the legend.
const LINE: f64 = 20.0;
/// Lines of the legend at the most: more would not be told apart.
const MOST_LINES: usize = 60;
/// Widths of what is significant and what is not.
const WIDTHS: (f64, f64) = (9.0, 4.0);

/// The drawing: the effect, the layers over it, and a legend with a line for every named layer, the scale of the effect
/// and the captions.
pub fn draw(title: &str, layers: &[Layer], effect: Option<&Effect>, captions: &[String]) -> String {
    let along: Vec<[f64; 2]> =
        effect.iter().flat_map(|effect| &effect.points).map(|point| flatten(&point.point)).collect();
    let lines = layers.iter().flat_map(|layer| layer.lines.iter().flatten());
    let page = Page::around(lines.chain(&along));
    let named = layers.iter().filter(|layer| layer.name.is_some()).count().min(MOST_LINES);
    let legend = LINE * (named + captions.len() + usize::from(effect.is_some())) as f64;
    let mut svg = open(title, page.height + legend);
    if let Some(effect) = effect {
        let places: Vec<[f64; 2]> = along.iter().map(|point| page.place(point)).collect();
        draw_effect(&mut svg, effect, &places);
    }
    for layer in layers {
        draw_layer(&mut svg, layer, |p| page.place(p));
    }
    draw_legend(&mut svg, layers, effect, captions, page.height - CAPTION + LINE);
    svg.push_str("</svg>\n");
    svg
}

fn largest(effect: &Effect) -> f64 {
    effect.points.iter().map(|point| point.length).fold(0.0, f64::max)
}

/// The colour of `part` (0 to 1) of the largest effect.
fn shade(effect: &Effect, part: f64) -> String {
    let (none, most) = effect.colours;
    let mix = |c: usize| (f64::from(none[c]) * (1.0 - part) + f64::from(most[c]) * part).round() as u8;
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

fn draw_effect(svg: &mut String, effect: &Effect, places: &[[f64; 2]]) {
    let most = largest(effect);
    let part = |length: f64| if most > 0.0 { length / most } else { 0.0 };
    let write = "writing to a string cannot fail";
    if !effect.connected {
        for (point, [x, y]) in effect.points.iter().zip(places) {
            let (colour, width) = (shade(effect, part(point.length)), width(point.significant));
            writeln!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{width}\" fill=\"{colour}\"/>")
                .expect(write);
        }
        return;
    }
    svg.push_str("<g stroke-linecap=\"round\">\n");
    let count = places.len();
    for i in 0..if effect.closed { count } else { count.saturating_sub(1) } {
        let j = (i + 1) % count;
        let (from, to) = (&effect.points[i], &effect.points[j]);
        let colour = shade(effect, part(0.5 * (from.length + to.length)));
        let width = width(from.significant && to.significant);
        let ([x1, y1], [x2, y2]) = (places[i], places[j]);
        writeln!(
            svg,
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
        )
        .expect(write);
    }
    svg.push_str("</g>\n");
}

fn width(significant: bool) -> f64 {
    if significant { WIDTHS.0 } else { WIDTHS.1 }
}

fn draw_legend(svg: &mut String, layers: &[Layer], effect: Option<&Effect>, captions: &[String], mut y: f64) {
    let write = "writing to a string cannot fail";
    let mut line = |svg: &mut String, sample: &str, text: &str| {
        writeln!(
            svg,
            "<g transform=\"translate({MARGIN} {y:.0})\">{sample}<text x=\"64\" y=\"4\" fill=\"#1b1b1b\">{}</text></g>",
            escape(text)
        )
        .expect(write);
        y += LINE;
    };
    let named = layers.iter().filter_map(|layer| layer.name.as_ref().map(|name| (layer, name)));
    for (layer, name) in named.take(MOST_LINES) {
        line(svg, &format!("<rect y=\"-2\" width=\"54\" height=\"4\" fill=\"{}\"/>", layer.colour), name);
    }
    if let Some(effect) = effect {
        let steps = 9;
        let boxes: String = (0..steps)
            .map(|i| {
                let colour = shade(effect, f64::from(i) / f64::from(steps - 1));
                format!("<rect x=\"{}\" y=\"-5\" width=\"6\" height=\"10\" fill=\"{colour}\"/>", 6 * i)
            })
            .collect();
        let text = format!(
            "0 to {:.3} along the shape; wide where p ≤ 0.05 for all points together",
            largest(effect)
        );
        line(svg, &boxes, &text);
    }
    for caption in captions {
        line(svg, "", caption);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::svg::colour;

    #[test]
    fn the_largest_effect_has_the_darkest_colour_and_names_are_escaped() {
        let point = |x: f64, length: f64| EffectPoint { point: vec![x, x * x], length, significant: x > 0.5 };
        let effect = Effect {
            points: vec![point(0.0, 0.0), point(1.0, 2.0), point(2.0, 2.0)],
            closed: false,
            connected: true,
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        };
        let svg = draw("a", &[], Some(&effect), &["<b>".into()]);
        assert!(svg.contains("stroke=\"#880055\" stroke-width=\"9\"") && svg.contains("&lt;b&gt;"), "{svg}");
        assert!(!svg.contains("NaN") && svg.contains("0 to 2.000"));
    }
}
