//! Drawings as SVG: closed curves and landmarks, several layers on one scale.
//!
//! Spline curves are drawn through samples (8 per control point, at least 128), not through their control
//! points. Shapes of space are drawn along the direction (1, −1, 1)/√3 in parallel projection. The y axis points up, as
//! in the data.

use std::fmt::Write;

use crate::geometry::curve::ClosedCurve;
use crate::geometry::representation::ShapeSpace;
use crate::numeric::dense::Matrix;

/// One layer of a drawing.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Polylines, each a list of plane points.
    pub lines: Vec<Vec<[f64; 2]>>,
    /// Drawn as closed lines, or as dots.
    pub dots: bool,
    /// Stroke colour.
    pub colour: &'static str,
    /// Stroke width in pixels.
    pub width: f64,
    /// Opacity of the stroke.
    pub opacity: f64,
    /// Entry of the legend; none without.
    pub name: Option<String>,
}

/// Colours for a mean, its shapes and the two sides of a mode (colour-blind safe).
pub mod colour {
    /// The main line.
    pub const MAIN: &str = "#1b1b1b";
    /// Many thin lines behind it.
    pub const BACK: &str = "#4477aa";
    /// The negative side of a mode.
    pub const MINUS: &str = "#4477aa";
    /// The positive side of a mode.
    pub const PLUS: &str = "#cc3311";
}

impl Layer {
    /// Layer of shapes of `space`, given by control points (`d·N` coordinate-major numbers each).
    pub fn of<'a>(
        space: &ShapeSpace,
        shapes: impl IntoIterator<Item = &'a [f64]>,
        colour: &'static str,
        width: f64,
        opacity: f64,
    ) -> Self {
        let lines = shapes.into_iter().map(|shape| outline(space, shape)).collect();
        Self { lines, dots: space.generator().is_none(), colour, width, opacity, name: None }
    }

    /// The same layer with an entry in the legend.
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }
}

fn outline(space: &ShapeSpace, control_points: &[f64]) -> Vec<[f64; 2]> {
    let d = space.representation().dimension();
    let n = control_points.len() / d;
    let matrix = Matrix::from_column_slice(n, d, control_points);
    match ClosedCurve::of(space, &matrix) {
        Some(curve) => curve.sample((8 * n).clamp(128, 4096)).iter().map(|p| flatten(p)).collect(),
        None => (0..n).map(|k| flatten(&matrix.row(k).iter().copied().collect::<Vec<_>>())).collect(),
    }
}

/// Parallel projection along (1, −1, 1): the usual isometric view, z up.
fn flatten(point: &[f64]) -> [f64; 2] {
    match *point {
        [x, y, z] => [(x + y) * 0.5_f64.sqrt(), (y - x) / 6.0_f64.sqrt() + z * (2.0_f64 / 3.0).sqrt()],
        [x, y] => [x, y],
        _ => [0.0, 0.0],
    }
}

const SIZE: f64 = 640.0;
const MARGIN: f64 = 32.0;
const CAPTION: f64 = 28.0;

/// The drawing of `layers`, back to front, under a title. Cost linear in the points drawn.
pub fn draw(title: &str, layers: &[Layer]) -> String {
    let points = || layers.iter().flat_map(|layer| layer.lines.iter().flatten());
    let bound = |c: usize, f: fn(f64, f64) -> f64, start| points().map(|p| p[c]).fold(start, f);
    let low = [0, 1].map(|c| bound(c, f64::min, f64::MAX));
    let high = [0, 1].map(|c| bound(c, f64::max, f64::MIN));
    let extent = (high[0] - low[0]).max(high[1] - low[1]);
    let scale = if extent > 0.0 && extent.is_finite() { (SIZE - 2.0 * MARGIN) / extent } else { 1.0 };
    let middle = 0.5 * (scale * (high[1] - low[1])).clamp(0.0, SIZE) + MARGIN;
    let place = |p: &[f64; 2]| {
        let centre = [0, 1].map(|c| 0.5 * (low[c] + high[c]));
        [SIZE / 2.0 + scale * (p[0] - centre[0]), CAPTION + middle - scale * (p[1] - centre[1])]
    };
    let height = (2.0 * middle + 2.0 * CAPTION).round();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {SIZE} {height}\" width=\"{SIZE}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"14\">\n<title>{0}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <text x=\"{MARGIN}\" y=\"20\" fill=\"#1b1b1b\">{0}</text>\n",
        escape(title)
    );
    for layer in layers {
        draw_layer(&mut svg, layer, place);
    }
    draw_legend(&mut svg, layers, height - 12.0);
    svg.push_str("</svg>\n");
    svg
}

fn draw_layer(svg: &mut String, layer: &Layer, place: impl Fn(&[f64; 2]) -> [f64; 2]) {
    let Layer { colour, width, opacity, .. } = layer;
    let write = "writing to a string cannot fail";
    if layer.dots {
        writeln!(svg, "<g fill=\"{colour}\" fill-opacity=\"{opacity}\">").expect(write);
        for [x, y] in layer.lines.iter().flatten().map(&place) {
            writeln!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{:.2}\"/>", width + 1.5).expect(write);
        }
    } else {
        writeln!(
            svg,
            "<g fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\" stroke-linejoin=\"round\">"
        )
        .expect(write);
        for line in &layer.lines {
            svg.push_str("<path d=\"");
            for (i, [x, y]) in line.iter().map(&place).enumerate() {
                let command = if i == 0 { 'M' } else { 'L' };
                write!(svg, "{command}{x:.2} {y:.2}").expect(write);
            }
            svg.push_str("Z\"/>\n");
        }
    }
    svg.push_str("</g>\n");
}

fn draw_legend(svg: &mut String, layers: &[Layer], y: f64) {
    let mut x = MARGIN;
    for layer in layers {
        let Some(name) = &layer.name else { continue };
        writeln!(
            svg,
            "<rect x=\"{x}\" y=\"{:.0}\" width=\"18\" height=\"4\" fill=\"{}\"/><text x=\"{:.0}\" y=\"{:.0}\" fill=\"#1b1b1b\">{}</text>",
            y - 6.0,
            layer.colour,
            x + 24.0,
            y,
            escape(name)
        )
        .expect("writing to a string cannot fail");
        x += 40.0 + 8.0 * name.chars().count() as f64;
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generator::GeneratorKind;
    use crate::geometry::representation::Representation;

    #[test]
    fn a_circle_fills_the_picture_and_text_is_escaped() {
        let generator = GeneratorKind::Trigonometric {};
        let space =
            ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 4, generator })
                .unwrap();
        let circle = [1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, -1.0];
        let svg = draw("a < b", &[Layer::of(&space, [circle.as_slice()], colour::MAIN, 2.0, 1.0)]);
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"));
        // the rightmost point of the circle touches the margin
        assert!(svg.contains(&format!("M{:.2} {:.2}", SIZE - MARGIN, CAPTION + SIZE / 2.0)), "{svg}");
    }
}
