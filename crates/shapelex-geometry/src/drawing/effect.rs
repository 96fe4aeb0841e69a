//! Drawings of overlaid shapes, with an effect along one of them as colour and width.

use std::fmt::Write;

use super::svg::{
    CAPTION, FACETS, Facets, Layer, MARGIN, Page, cells_of, draw_facet, draw_layer, drawn_level, escape,
    flatten, open, rows_of,
};
use crate::representation::ShapeSpace;
use crate::subdivision::basis::SubdivisionBasis;
use crate::surface::basis::SurfaceBasis;

/// An effect along a shape.
pub struct Effect {
    /// Points in order along the shape.
    pub points: Vec<EffectPoint>,
    /// How the points are connected.
    pub connection: Connection,
    /// RGB colours of no effect and of the largest effect.
    pub colours: ([u8; 3], [u8; 3]),
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
/// Maximum number of lines of the legend: more could not be told apart.
const MAX_LINES: usize = 60;
/// Stroke widths of significant and other points.
const WIDTHS: (f64, f64) = (9.0, 4.0);

/// Draws the effect, the layers over it, and a legend with the named layers, the scale of the effect and the captions.
pub fn draw(title: &str, layers: &[Layer], effect: Option<&Effect>, captions: &[String]) -> String {
    let along: Vec<[f64; 2]> =
        effect.iter().flat_map(|effect| &effect.points).map(|point| flatten(&point.point)).collect();
    let lines = layers.iter().flat_map(|layer| layer.lines.iter().flatten());
    // Surface layers would hide the effect, so they are replaced by the sheet that carries it.
    let over: &[Layer] = if layers.iter().any(Layer::hides) { &[] } else { layers };
    let page = Page::around(lines.chain(&along));
    let named = layers.iter().filter(|layer| layer.name.is_some()).count().min(MAX_LINES);
    let legend = LINE * (named + captions.len() + usize::from(effect.is_some())) as f64;
    let mut svg = open(title, page.height + legend);
    if let Some(effect) = effect {
        let places: Vec<[f64; 2]> = along.iter().map(|point| page.place(point)).collect();
        draw_effect(&mut svg, effect, &places, |p| page.place(p));
    }
    for layer in over {
        draw_layer(&mut svg, layer, |p| page.place(p));
    }
    draw_legend(&mut svg, layers, effect, captions, page.height - CAPTION + LINE);
    svg.push_str("</svg>\n");
    svg
}

fn largest(effect: &Effect) -> f64 {
    effect.points.iter().map(|point| point.length).fold(0.0, f64::max)
}

/// Colour of an effect of `part` (0 to 1) times the largest, paler if not significant, under `light` (0 to 1).
fn shade(effect: &Effect, part: f64, significant: bool, light: f64) -> String {
    let (none, most) = effect.colours;
    let part = if significant { part } else { PALE * part };
    let mix = |c: usize| {
        let colour = f64::from(none[c]) * (1.0 - part) + f64::from(most[c]) * part;
        (colour * light).round().clamp(0.0, 255.0) as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

fn draw_effect(
    svg: &mut String,
    effect: &Effect,
    places: &[[f64; 2]],
    place: impl Fn(&[f64; 2]) -> [f64; 2],
) {
    let most = largest(effect);
    let part = |length: f64| if most > 0.0 { length / most } else { 0.0 };
    let write = "writing to a string cannot fail";
    let closed = match &effect.connection {
        Connection::Line { closed } => *closed,
        Connection::Sheet { facets, shares } => return draw_sheet(svg, effect, facets, shares, place),
        Connection::Apart => {
            for (point, [x, y]) in effect.points.iter().zip(places) {
                let (colour, width) =
                    (shade(effect, part(point.length), true, 1.0), width(point.significant));
                writeln!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{width}\" fill=\"{colour}\"/>")
                    .expect(write);
            }
            return;
        }
    };
    svg.push_str("<g stroke-linecap=\"round\">\n");
    let count = places.len();
    for i in 0..if closed { count } else { count.saturating_sub(1) } {
        let j = (i + 1) % count;
        let (from, to) = (&effect.points[i], &effect.points[j]);
        let colour = shade(effect, part(0.5 * (from.length + to.length)), true, 1.0);
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

/// Factor applied to the colour where the effect is not significant.
const PALE: f64 = 0.35;

/// Draws the facets with the effect interpolated between the points; pale where the nearest of them is not significant.
fn draw_sheet(
    svg: &mut String,
    effect: &Effect,
    facets: &Facets,
    shares: &[Vec<(usize, f64)>],
    place: impl Fn(&[f64; 2]) -> [f64; 2],
) {
    let most = largest(effect);
    svg.push_str(FACETS);
    for ((corners, light), shares) in facets.corners.chunks_exact(4).zip(&facets.light).zip(shares) {
        let mut length = 0.0;
        let mut nearest = (0.0, false);
        for &(point, share) in shares {
            let point = &effect.points[point];
            length += share * point.length;
            if share > nearest.0 {
                nearest = (share, point.significant);
            }
        }
        let colour = shade(effect, if most > 0.0 { length / most } else { 0.0 }, nearest.1, *light);
        draw_facet(svg, &colour, corners, &place);
    }
    svg.push_str("</g>\n");
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
    for (layer, name) in named.take(MAX_LINES) {
        let sample = if layer.hides() {
            String::new()
        } else {
            format!("<rect y=\"-2\" width=\"54\" height=\"4\" fill=\"{}\"/>", layer.colour)
        };
        line(svg, &sample, name);
    }
    if let Some(effect) = effect {
        let steps = 9;
        let boxes: String = (0..steps)
            .map(|i| {
                let colour = shade(effect, f64::from(i) / f64::from(steps - 1), true, 1.0);
                format!("<rect x=\"{}\" y=\"-5\" width=\"6\" height=\"10\" fill=\"{colour}\"/>", 6 * i)
            })
            .collect();
        let sign = match effect.connection {
            Connection::Sheet { .. } => "pale where p > 0.05",
            _ => "wide where p ≤ 0.05",
        };
        let text = format!("0 to {:.3}, {sign} over all points together", largest(effect));
        line(svg, &boxes, &text);
    }
    for caption in captions {
        line(svg, "", caption);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::svg::colour;

    #[test]
    fn the_largest_effect_has_the_darkest_colour_and_names_are_escaped() {
        let point = |x: f64, length: f64| EffectPoint { point: vec![x, x * x], length, significant: x > 0.5 };
        let effect = Effect {
            points: vec![point(0.0, 0.0), point(1.0, 2.0), point(2.0, 2.0)],
            connection: Connection::Line { closed: false },
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        };
        let svg = draw("a", &[], Some(&effect), &["<b>".into()]);
        assert!(svg.contains("stroke=\"#880055\" stroke-width=\"9\"") && svg.contains("&lt;b&gt;"), "{svg}");
        assert!(!svg.contains("NaN") && svg.contains("0 to 2.000"));
    }
}
