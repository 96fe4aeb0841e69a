//! Effects along a shape, as layers with colours and widths.

use super::colour::Colour;
use super::layer::{Facets, Layer, Mark, cells_of, drawn_level, flatten, rows_of};
use super::legend::Entry;
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

/// Stroke widths of significant and other points.
const WIDTHS: (f64, f64) = (9.0, 4.0);
/// Number of colours from no effect to the largest.
const SHADES: u8 = 16;

impl Effect {
    /// The largest effect.
    pub fn largest(&self) -> f64 {
        self.points.iter().map(|point| point.length).fold(0.0, f64::max)
    }

    /// Layers that show the effect, back to front. `most`: the effect with the strongest colour; `scale`: factor of the
    /// widths of lines and dots.
    pub fn layers(&self, most: f64, scale: f64) -> Vec<Layer> {
        let ramp = Ramp { colours: self.colours, most, scale };
        let along: Vec<[f64; 2]> = self.points.iter().map(|point| flatten(&point.point)).collect();
        match &self.connection {
            Connection::Line { closed } => line(self, &ramp, &along, *closed),
            Connection::Sheet { facets, shares } => vec![sheet(self, &ramp, facets, shares)],
            Connection::Apart => {
                let dot = |(point, place): (&EffectPoint, &[f64; 2])| {
                    let width = ramp.width(point.significant) - 1.5;
                    Layer::from_points(vec![*place], Mark::Dots, ramp.shade(ramp.part(point.length)), width)
                };
                self.points.iter().zip(&along).map(dot).collect()
            }
        }
    }

    /// Entry of the legend for the colours of the effect.
    pub fn scale(&self, text: String) -> Entry {
        Entry::Scale { colours: self.colours, text }
    }

    /// How significant points are told from others, as it completes "… where".
    pub fn emphasis(&self) -> &'static str {
        match self.connection {
            Connection::Sheet { .. } => "strong",
            Connection::Line { .. } => "wide",
            Connection::Apart => "large",
        }
    }
}

/// Colours and widths of effects.
struct Ramp {
    colours: (Colour, Colour),
    most: f64,
    scale: f64,
}

impl Ramp {
    /// Colour of a fraction of the largest effect.
    fn shade(&self, part: f64) -> Colour {
        self.colours.0.towards(self.colours.1, part)
    }

    /// Fraction of the largest effect, from 0 to 1.
    fn fraction(&self, length: f64) -> f64 {
        if self.most > 0.0 { (length / self.most).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Fraction of the largest effect, as one of few shades.
    fn part(&self, length: f64) -> f64 {
        let steps = f64::from(SHADES - 1);
        (self.fraction(length) * steps).round() / steps
    }

    fn width(&self, significant: bool) -> f64 {
        self.scale * if significant { WIDTHS.0 } else { WIDTHS.1 }
    }
}

/// Part and width of a stretch along the shape, and its points.
type Stretch = ((f64, f64), Vec<[f64; 2]>);

/// Lines along the shape, one for every stretch of one colour and width.
fn line(effect: &Effect, ramp: &Ramp, along: &[[f64; 2]], closed: bool) -> Vec<Layer> {
    let count = along.len();
    let mut stretches: Vec<Stretch> = Vec::new();
    for i in 0..if closed { count } else { count.saturating_sub(1) } {
        let j = (i + 1) % count;
        let (from, to) = (&effect.points[i], &effect.points[j]);
        let part = ramp.part(0.5 * (from.length + to.length));
        let look = (part, ramp.width(from.significant && to.significant));
        match stretches.last_mut().filter(|(before, _)| *before == look) {
            Some((_, points)) => points.push(along[j]),
            None => stretches.push((look, vec![along[i], along[j]])),
        }
    }
    let layer = |((part, width), points)| Layer::from_points(points, Mark::Open, ramp.shade(part), width);
    stretches.into_iter().map(layer).collect()
}

/// Factor applied to the colour where the effect is not significant.
const PALE: f64 = 0.35;

/// Facets with the effect interpolated between the points; pale where the nearest of them is not significant.
fn sheet(effect: &Effect, ramp: &Ramp, facets: &Facets, shares: &[Vec<(usize, f64)>]) -> Layer {
    let colour = |(light, shares): (&f64, &Vec<(usize, f64)>)| {
        let (mut length, mut nearest) = (0.0, (0.0, false));
        for &(point, share) in shares {
            let point = &effect.points[point];
            length += share * point.length;
            if share > nearest.0 {
                nearest = (share, point.significant);
            }
        }
        let part = ramp.fraction(length);
        ramp.shade(if nearest.1 { part } else { PALE * part }).under(*light)
    };
    let colours = vec![facets.light.iter().zip(shares).map(colour).collect()];
    let corners = facets.corners.clone();
    Layer { colours, ..Layer::from_points(corners, Mark::Facets, effect.colours.1, 1.0) }
}

/// Points before and after a parameter, with their interpolation weights.
fn neighbours(parameter: f64, count: usize, closed: bool) -> [(usize, f64); 2] {
    let steps = if closed { count } else { (count - 1).max(1) };
    let position = parameter * steps as f64;
    let (before, part) = (position.floor(), position.fract());
    let at = |i: usize| if closed { i % count } else { i.min(count - 1) };
    [(at(before as usize), 1.0 - part), (at(before as usize + 1), part)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::colour;
    use crate::drawing::layout;
    use crate::drawing::svg::Style;

    #[test]
    fn the_largest_effect_has_the_strongest_colour() {
        let point = |x: f64, length: f64| EffectPoint { point: vec![x, x * x], length, significant: x > 0.5 };
        let effect = Effect {
            points: vec![point(0.0, 0.0), point(1.0, 2.0), point(2.0, 2.0)],
            connection: Connection::Line { closed: false },
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        };
        let draw = |most: f64| layout::overlay("a", effect.layers(most, 1.0), &[]).to_svg(&Style::default());
        let svg = draw(effect.largest());
        assert!(svg.contains("stroke=\"#880055\" stroke-width=\"9\"") && !svg.contains("NaN"), "{svg}");
        let faint = draw(1e3);
        assert!(!faint.contains("#880055") && !draw(0.0).contains("NaN"), "{faint}");
    }
}
