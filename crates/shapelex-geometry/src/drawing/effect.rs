//! Drawings of overlaid shapes, with an effect along one of them as colour and width.

use super::colour::Colour;
use super::layer::{Facets, Layer, Mark, cells_of, drawn_level, flatten, rows_of};
use super::layout::{Bounds, entry};
use super::scene::{Anchor, Drawing, Element, MARGIN, Map, Text, short};
use crate::representation::ShapeSpace;
use crate::subdivision::basis::SubdivisionBasis;
use crate::surface::basis::SurfaceBasis;

/// An effect along a shape.
pub struct Effect {
    /// Points in order along the shape.
    pub points: Vec<EffectPoint>,
    /// How the points are connected.
    pub connection: Connection,
    /// Colours of no effect and of the largest effect.
    pub colours: (Colour, Colour),
}

/// Connection between the points along a shape.
pub enum Connection {
    /// None: points are drawn as dots.
    Apart,
    /// Points form a line, open or closed.
    Line {
        /// Whether the last point connects to the first.
        closed: bool,
    },
    /// Points lie on a surface.
    Sheet {
        /// Surface through the points.
        facets: Facets,
        /// For every facet, the nearby points with their interpolation weights.
        shares: Vec<Vec<(usize, f64)>>,
    },
}

impl Connection {
    /// Connection between the points along a shape of `space`.
    pub fn of(space: &ShapeSpace, shape: &[f64]) -> Self {
        match (space.surface(), space.subdivision()) {
            (Some(basis), _) => Self::from_surface(basis, shape),
            (_, Some(basis)) => Self::from_subdivision(basis, shape),
            _ if space.generator().is_some() => Self::Line { closed: space.representation().is_closed() },
            _ => Self::Apart,
        }
    }

    /// Connection between the knots of a grid.
    fn from_surface(basis: &SurfaceBasis, shape: &[f64]) -> Self {
        let (extent, straight) = (basis.extent(), basis.seam().is_straight());
        let [u, v] = extent.topology.closed();
        // Across a twisted seam the neighbours are different ones.
        let (count, closed) = (extent.grid(), [u && straight, v]);
        let (facets, cells) = (Facets::of(basis, shape, false), cells_of(basis, false));
        let shares = facets.cells.iter().map(|cell| {
            let middle = [cell / cells, cell % cells].map(|i| (i as f64 + 0.5) / cells as f64);
            let [along_u, along_v] = [0, 1].map(|i| neighbours(middle[i], count[i], closed[i]));
            let pairs = along_u.into_iter().flat_map(|a| along_v.map(|b| (a, b)));
            pairs.map(|((i, a), (j, b))| (i * count[1] + j, a * b)).collect()
        });
        Self::Sheet { shares: shares.collect(), facets }
    }

    /// Connection between the vertices of the control mesh.
    fn from_subdivision(basis: &SubdivisionBasis, shape: &[f64]) -> Self {
        let level = drawn_level(basis, false);
        let (mesh, flat) = (basis.drawn(&rows_of(shape), level), basis.flat(level));
        let facets = Facets::from_mesh(&mesh, false);
        let shares = facets.cells.iter().map(|cell| {
            let mut shares: Vec<(usize, f64)> = Vec::new();
            let corners = mesh.faces[*cell].into_iter().flat_map(|corner| flat.row(corner as usize));
            for &(point, share) in corners {
                match shares.iter_mut().find(|(known, _)| *known == point as usize) {
                    Some((_, sum)) => *sum += share / 3.0,
                    None => shares.push((point as usize, share / 3.0)),
                }
            }
            shares
        });
        Self::Sheet { shares: shares.collect(), facets }
    }
}

/// Effect at one point.
#[derive(Debug, Clone)]
pub struct EffectPoint {
    /// Position in the plane or in space.
    pub point: Vec<f64>,
    /// Size of the effect.
    pub length: f64,
    /// Whether the effect is significant, which draws it wide.
    pub significant: bool,
}

/// Height of a line of the legend.
const LINE: f64 = 20.0;
/// Width of a sample in the legend.
const SAMPLE: f64 = 54.0;
/// Maximum number of lines of the legend: more could not be told apart.
const MAX_LINES: usize = 60;
/// Stroke widths of significant and other points.
const WIDTHS: (f64, f64) = (9.0, 4.0);
/// Number of colours from no effect to the largest.
const SHADES: u8 = 16;

/// Draws the effect, the layers over it, and a legend with the named layers, the colours of the effect and the captions.
pub fn draw(title: &str, layers: Vec<Layer>, effect: Option<&Effect>, captions: &[String]) -> Drawing {
    let along: Vec<[f64; 2]> =
        effect.iter().flat_map(|effect| &effect.points).map(|point| flatten(&point.point)).collect();
    let lines = layers.iter().flat_map(|layer| layer.lines.iter().flatten());
    let (map, height) = Bounds::around(lines.chain(&along)).fill();
    let (legend, lines) = legend(&layers, effect, captions, height + 0.5 * LINE);
    let mut elements = effect.map_or_else(Vec::new, |effect| draw_effect(effect, &along, map));
    // Surface layers would hide the effect, so they are replaced by the sheet that carries it.
    if !layers.iter().any(Layer::hides) {
        elements.extend(layers.into_iter().map(|layer| Element::Shapes(layer, map)));
    }
    elements.extend(legend);
    Drawing::new(title, height + LINE * lines as f64 + 4.0, elements)
}

impl Effect {
    fn largest(&self) -> f64 {
        self.points.iter().map(|point| point.length).fold(0.0, f64::max)
    }

    fn largest_or_one(&self) -> f64 {
        Some(self.largest()).filter(|most| *most > 0.0).unwrap_or(1.0)
    }

    /// Colour of a fraction of the largest effect.
    fn shade(&self, part: f64) -> Colour {
        self.colours.0.towards(self.colours.1, part)
    }

    /// Fraction of the largest effect, as one of few shades.
    fn part(&self, length: f64) -> f64 {
        let most = self.largest_or_one();
        let steps = f64::from(SHADES - 1);
        (length / most * steps).round().clamp(0.0, steps) / steps
    }
}

fn draw_effect(effect: &Effect, along: &[[f64; 2]], map: Map) -> Vec<Element> {
    match &effect.connection {
        Connection::Line { closed } => draw_line(effect, along, *closed, map),
        Connection::Sheet { facets, shares } => vec![sheet(effect, facets, shares, map)],
        Connection::Apart => {
            let dot = |(point, place): (&EffectPoint, &[f64; 2])| {
                let colour = effect.shade(effect.part(point.length));
                let layer =
                    Layer::from_points(vec![*place], Mark::Dots, colour, width(point.significant) - 1.5);
                Element::Shapes(layer, map)
            };
            effect.points.iter().zip(along).map(dot).collect()
        }
    }
}

/// Part and width of a stretch along the shape, and its points.
type Stretch = ((f64, f64), Vec<[f64; 2]>);

/// Lines along the shape, one for every stretch of one colour and width.
fn draw_line(effect: &Effect, along: &[[f64; 2]], closed: bool, map: Map) -> Vec<Element> {
    let count = along.len();
    let mut stretches: Vec<Stretch> = Vec::new();
    for i in 0..if closed { count } else { count.saturating_sub(1) } {
        let j = (i + 1) % count;
        let (from, to) = (&effect.points[i], &effect.points[j]);
        let part = effect.part(0.5 * (from.length + to.length));
        let look = (part, width(from.significant && to.significant));
        match stretches.last_mut().filter(|(before, _)| *before == look) {
            Some((_, points)) => points.push(along[j]),
            None => stretches.push((look, vec![along[i], along[j]])),
        }
    }
    let element = |((part, width), points)| {
        Element::Shapes(Layer::from_points(points, Mark::Open, effect.shade(part), width), map)
    };
    stretches.into_iter().map(element).collect()
}

/// Factor applied to the colour where the effect is not significant.
const PALE: f64 = 0.35;

/// Facets with the effect interpolated between the points; pale where the nearest of them is not significant.
fn sheet(effect: &Effect, facets: &Facets, shares: &[Vec<(usize, f64)>], map: Map) -> Element {
    let most = effect.largest_or_one();
    let colour = |(light, shares): (&f64, &Vec<(usize, f64)>)| {
        let (mut length, mut nearest) = (0.0, (0.0, false));
        for &(point, share) in shares {
            let point = &effect.points[point];
            length += share * point.length;
            if share > nearest.0 {
                nearest = (share, point.significant);
            }
        }
        let part = (length / most).clamp(0.0, 1.0);
        effect.shade(if nearest.1 { part } else { PALE * part }).under(*light)
    };
    let colours = facets.light.iter().zip(shares).map(colour).collect();
    Element::Facets { corners: facets.corners.clone(), colours, map }
}

/// Points before and after a parameter, with their interpolation weights.
fn neighbours(parameter: f64, count: usize, closed: bool) -> [(usize, f64); 2] {
    let steps = if closed { count } else { (count - 1).max(1) };
    let position = parameter * steps as f64;
    let (before, part) = (position.floor(), position.fract());
    let at = |i: usize| if closed { i % count } else { i.min(count - 1) };
    [(at(before as usize), 1.0 - part), (at(before as usize + 1), part)]
}

fn width(significant: bool) -> f64 {
    if significant { WIDTHS.0 } else { WIDTHS.1 }
}

/// Legend from `top` on, and its number of lines.
fn legend(layers: &[Layer], effect: Option<&Effect>, captions: &[String], top: f64) -> (Vec<Element>, usize) {
    let (mut elements, mut lines) = (Vec::new(), 0);
    let mut next = || {
        lines += 1;
        [MARGIN, top + LINE * f64::from(lines - 1)]
    };
    let named = layers.iter().filter_map(|layer| layer.name.as_ref().map(|name| (layer, name)));
    for (layer, name) in named.take(MAX_LINES) {
        elements.extend(entry(layer, name, next(), SAMPLE));
    }
    if let Some(effect) = effect {
        elements.extend(colours(effect, next()));
    }
    for caption in captions {
        let [x, y] = next();
        elements.push(Element::Text(Text::new([x, y + 5.0], 13, Anchor::Start, caption.clone())));
    }
    (elements, lines as usize)
}

/// The colours of the effect with their range.
fn colours(effect: &Effect, [x, y]: [f64; 2]) -> Vec<Element> {
    let steps: u8 = 9;
    let step = SAMPLE / f64::from(steps);
    let boxes = (0..steps).map(|i| Element::Box {
        corner: [x + step * f64::from(i), y - 5.0],
        size: [step, 10.0],
        colour: effect.shade(effect.part(effect.largest() * f64::from(i) / f64::from(steps - 1))),
        opacity: 1.0,
    });
    let sign = match effect.connection {
        Connection::Sheet { .. } => "pale where p > 0.05",
        Connection::Line { .. } => "wide where p ≤ 0.05",
        Connection::Apart => "large where p ≤ 0.05",
    };
    let text = format!("0 to {}; {sign}, all points taken together", short(effect.largest()));
    let text = Text::new([x + SAMPLE + 6.0, y + 5.0], 13, Anchor::Start, text);
    boxes.chain([Element::Text(text)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::colour;
    use crate::drawing::svg::Style;

    #[test]
    fn the_largest_effect_has_the_strongest_colour_and_names_are_escaped() {
        let point = |x: f64, length: f64| EffectPoint { point: vec![x, x * x], length, significant: x > 0.5 };
        let effect = Effect {
            points: vec![point(0.0, 0.0), point(1.0, 2.0), point(2.0, 2.0)],
            connection: Connection::Line { closed: false },
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        };
        let svg = draw("a", Vec::new(), Some(&effect), &["<b>".into()]).to_svg(&Style::default());
        assert!(svg.contains("stroke=\"#880055\" stroke-width=\"9\"") && svg.contains("&lt;b&gt;"), "{svg}");
        assert!(!svg.contains("NaN") && svg.contains("0 to 2;"));
    }
}
