//! Drawings as SVG: curves, landmarks and surfaces, several layers on one scale.
//!
//! Spline curves are drawn through samples (8 per control point, at least 128), not through their control points; samples that
//! the eye does not need are left out. Shapes in space are drawn in parallel projection along the direction (1, −1, 1)/√3. The y axis points up, as
//! in the data. Surfaces are shaded; since they hide one another, they are drawn side by side, the front layer first.

use std::fmt::Write;
use std::sync::LazyLock;

use super::line::Resolution;
use crate::curve::Curve;
use crate::mesh::TriangleMesh;
use crate::representation::ShapeSpace;
use crate::subdivision::basis::SubdivisionBasis;
use crate::surface::Topology;
use crate::surface::basis::SurfaceBasis;
use crate::vector::{dot, norm};
use shapelex_numeric::dense::Matrix;

/// One layer of a drawing.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Shapes as points in the plane: a polyline each, or the corners of a surface's facets one after the other.
    pub lines: Vec<Vec<[f64; 2]>>,
    /// Brightness of the facets of every surface, from 0 to 1; empty for other shapes.
    pub light: Vec<Vec<f64>>,
    /// Drawing style of the points.
    pub mark: Mark,
    /// Stroke colour.
    pub colour: &'static str,
    /// Stroke width in pixels.
    pub width: f64,
    /// Opacity of the stroke.
    pub opacity: f64,
    /// Entry of the legend, if any.
    pub name: Option<String>,
}

/// Drawing style of the points of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Closed line.
    Closed,
    /// Open line.
    Open,
    /// Dots.
    Dots,
    /// Four-sided facets, farthest first.
    Facets,
}

/// Colours of a mean, its shapes and the two sides of a mode (colour-blind safe).
pub mod colour {
    /// Main line.
    pub const MAIN: &str = "#1b1b1b";
    /// Many thin lines in the background.
    pub const BACK: &str = "#4477aa";
    /// Negative side of a mode.
    pub const MINUS: &str = "#4477aa";
    /// Positive side of a mode.
    pub const PLUS: &str = "#cc3311";
    /// RGB colour of no effect.
    pub const EFFECT_NONE: [u8; 3] = [0xdd, 0xdd, 0xdd];
    /// RGB colour of the largest effect.
    pub const EFFECT_MOST: [u8; 3] = [0x88, 0x00, 0x55];
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
        if space.surface().is_some() || space.subdivision().is_some() {
            let shapes: Vec<&[f64]> = shapes.into_iter().take(MAX_SURFACES).collect();
            let among_others = shapes.len() > 1;
            let facets = |shape: &&[f64]| match (space.surface(), space.subdivision()) {
                (Some(basis), _) => Some(Facets::of(basis, shape, among_others)),
                (_, Some(basis)) => {
                    let mesh = basis.drawn(&rows_of(shape), drawn_level(basis, among_others));
                    Some(Facets::from_mesh(&mesh, among_others))
                }
                _ => None,
            };
            return Self::from_facets(shapes.iter().filter_map(facets), colour);
        }
        let lines = shapes.into_iter().map(|shape| outline(space, shape)).collect();
        let mark = match space.generator() {
            None => Mark::Dots,
            Some(_) if space.representation().is_closed() => Mark::Closed,
            Some(_) => Mark::Open,
        };
        Self { lines, light: Vec::new(), mark, colour, width, opacity, name: None }
    }

    /// Layer of closed meshes.
    pub fn from_meshes(meshes: &[TriangleMesh], colour: &'static str) -> Self {
        let among_others = meshes.len() > 1;
        let drawn = meshes.iter().take(MAX_SURFACES);
        Self::from_facets(drawn.map(|mesh| Facets::from_mesh(mesh, among_others)), colour)
    }

    /// Layer of one polyline in the plane or in space.
    pub fn from_polyline(points: &[&[f64]], closed: bool, colour: &'static str) -> Self {
        let line = points.iter().map(|point| flatten(point)).collect();
        let mark = if closed { Mark::Closed } else { Mark::Open };
        Self { lines: vec![line], light: Vec::new(), mark, colour, width: 2.5, opacity: 1.0, name: None }
    }

    fn from_facets(facets: impl Iterator<Item = Facets>, colour: &'static str) -> Self {
        let (lines, light) = facets.map(|facets| (facets.corners, facets.light)).unzip();
        Self { lines, light, mark: Mark::Facets, colour, width: 1.0, opacity: 1.0, name: None }
    }

    /// Whether its shapes hide what is behind them.
    pub(super) fn hides(&self) -> bool {
        self.mark == Mark::Facets
    }

    /// Layers of one shape each; only the first keeps the name.
    fn apart(&self) -> impl Iterator<Item = Self> + '_ {
        (0..self.lines.len()).map(|i| Self {
            lines: vec![self.lines[i].clone()],
            light: self.light.get(i).cloned().into_iter().collect(),
            name: self.name.clone().filter(|_| i == 0),
            ..*self
        })
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
    match Curve::of(space, &matrix) {
        Some(curve) => curve.sample((8 * n).clamp(128, 4096)).iter().map(|p| flatten(p)).collect(),
        None => (0..n).map(|k| flatten(&matrix.row(k).iter().copied().collect::<Vec<_>>())).collect(),
    }
}

/// Parallel projection along (1, −1, 1): the usual isometric view with z up.
pub(super) fn flatten(point: &[f64]) -> [f64; 2] {
    match *point {
        [x, y, z] => [(x + y) * 0.5_f64.sqrt(), (y - x) / 6.0_f64.sqrt() + z * (2.0_f64 / 3.0).sqrt()],
        [x, y] => [x, y],
        _ => [0.0, 0.0],
    }
}

/// Nearness of a point in space to the viewer.
pub(super) fn depth(point: &[f64]) -> f64 {
    match *point {
        [x, y, z] => (x - y + z) / 3.0_f64.sqrt(),
        _ => 0.0,
    }
}

/// Maximum number of surfaces in a drawing.
const MAX_SURFACES: usize = 12;
/// Facets along each direction of a surface: the range for one alone (about two per interval between knots), and among others.
const CELLS: [usize; 2] = [48, 88];
const CELLS_AMONG_OTHERS: usize = 36;
/// Approximate direction of the light: over the viewer's left shoulder.
const LIGHT: [f64; 3] = [-0.02, -0.73, 0.68];
/// Brightness of faces turned away from the light.
const AMBIENT: f64 = 0.25;

/// Maximum number of faces of a drawn mesh, alone and among others.
pub const MAX_FACES: usize = 10_000;
const MAX_FACES_AMONG_OTHERS: usize = 2_600;

/// Subdivision level at which shapes are drawn.
pub(super) fn drawn_level(basis: &SubdivisionBasis, among_others: bool) -> usize {
    basis.level_with(if among_others { MAX_FACES_AMONG_OTHERS } else { MAX_FACES })
}

/// Control points in space, one per row.
pub(super) fn rows_of(shape: &[f64]) -> Matrix {
    Matrix::from_column_slice(shape.len() / 3, 3, shape)
}

/// A surface as seen by the viewer.
#[derive(Debug)]
pub struct Facets {
    /// Four corners per facet, farthest facet first; a triangle repeats its last corner.
    pub(super) corners: Vec<[f64; 2]>,
    /// Brightness of each facet.
    pub(super) light: Vec<f64>,
    /// Grid cell or mesh face of each facet.
    pub(super) cells: Vec<usize>,
}

/// A facet before sorting: depth, corners, brightness and cell.
type Facet = (f64, [[f64; 2]; 4], f64, usize);

/// Brightness of a facet with a unit normal.
fn light(normal: [f64; 3]) -> f64 {
    AMBIENT + (1.0 - AMBIENT) * (0.5 + 0.5 * dot(normal, LIGHT)).powi(2)
}

/// Facets of a closed surface turned away by more than this sine are omitted among others. Alone, all are drawn: between
/// the folds of a cortex they fill gaps that coarse facets in front leave open.
const HIDDEN: f64 = -0.25;

/// Number of cells along each direction of a surface.
pub(super) fn cells_of(basis: &SurfaceBasis, among_others: bool) -> usize {
    let knots = basis.extent().intervals.into_iter().max().unwrap_or_default();
    if among_others { CELLS_AMONG_OTHERS } else { (2 * knots).clamp(CELLS[0], CELLS[1]) }
}

impl Facets {
    fn sorted(mut seen: Vec<Facet>) -> Self {
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            light: seen.iter().map(|facet| facet.2).collect(),
            cells: seen.iter().map(|facet| facet.3).collect(),
            corners: seen.into_iter().flat_map(|facet| facet.1).collect(),
        }
    }

    /// Faces of a closed mesh; faces without area are omitted.
    pub(super) fn from_mesh(mesh: &TriangleMesh, among_others: bool) -> Self {
        let mut seen = Vec::new();
        for (cell, (face, normal)) in mesh.faces.iter().zip(mesh.face_normals()).enumerate() {
            let length = norm(normal);
            let normal = normal.map(|x| x / length);
            if !(length > 0.0) || (among_others && depth(&normal) < HIDDEN) {
                continue;
            }
            let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
            let middle = [0, 1, 2].map(|c| corners.iter().map(|corner| corner[c]).sum::<f64>() / 3.0);
            let [a, b, c] = corners.map(|corner| flatten(&corner));
            seen.push((depth(&middle), [a, b, c, c], light(normal), cell));
        }
        Self::sorted(seen)
    }

    pub(super) fn of(basis: &SurfaceBasis, shape: &[f64], among_others: bool) -> Self {
        let cells = cells_of(basis, among_others);
        let surface = basis.surface(&Matrix::from_column_slice(basis.gram().size(), 3, shape));
        // The end parameter approached from below: beyond a twisted seam, v differs.
        let edges: Vec<f64> =
            (0..=cells).map(|i| (i as f64 / cells as f64).min(1.0_f64.next_down())).collect();
        let middles: Vec<f64> = (0..cells).map(|i| (i as f64 + 0.5) / cells as f64).collect();
        let points = surface.points(&edges, &edges);
        let at = |i: usize, j: usize| flatten(&points[i * (cells + 1) + j]);
        let inside_is_hidden = surface.encloses() && surface.topology() != Topology::Cylinder;
        let mut seen = Vec::new();
        for (k, jet) in surface.jets(&middles, &middles).iter().enumerate() {
            let (i, j) = (k / cells, k % cells);
            let Some(normal) = surface.frame(middles[j], jet).normal else { continue };
            if inside_is_hidden && among_others && depth(&normal) < HIDDEN {
                continue;
            }
            let turned = depth(&normal) < 0.0 && !inside_is_hidden;
            let light = light(if turned { normal.map(|x| -x) } else { normal });
            let corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            seen.push((depth(&jet[0]), corners, light, k));
        }
        Self::sorted(seen)
    }
}

pub(super) const SIZE: f64 = 640.0;
pub(super) const MARGIN: f64 = 32.0;
pub(super) const CAPTION: f64 = 28.0;

/// Page that fits a set of points: its height, and the map from points to the page.
pub(super) struct Page {
    pub(super) height: f64,
    scale: f64,
    middle: f64,
    centre: [f64; 2],
}

impl Page {
    pub(super) fn around<'a>(points: impl Iterator<Item = &'a [f64; 2]> + Clone) -> Self {
        let bound = |c: usize, f: fn(f64, f64) -> f64, start| points.clone().map(|p| p[c]).fold(start, f);
        let low = [0, 1].map(|c| bound(c, f64::min, f64::MAX));
        let high = [0, 1].map(|c| bound(c, f64::max, f64::MIN));
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let scale = if extent > 0.0 && extent.is_finite() { (SIZE - 2.0 * MARGIN) / extent } else { 1.0 };
        let middle = 0.5 * (scale * (high[1] - low[1])).clamp(0.0, SIZE) + MARGIN;
        let height = (2.0 * middle + 2.0 * CAPTION).round();
        Self { height, scale, middle, centre: [0, 1].map(|c| 0.5 * (low[c] + high[c])) }
    }

    pub(super) fn place(&self, p: &[f64; 2]) -> [f64; 2] {
        let [x, y] = [0, 1].map(|c| self.scale * (p[c] - self.centre[c]));
        [SIZE / 2.0 + x, CAPTION + self.middle - y]
    }
}

/// Resolution of the page at its own size.
pub(super) static RESOLUTION: LazyLock<Resolution> = LazyLock::new(|| Resolution::new(1.0));

/// Opens a picture of `height` with a title.
pub(super) fn open(title: &str, height: f64) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {SIZE} {height}\" width=\"{SIZE}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"14\">\n<title>{0}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
         <text x=\"{MARGIN}\" y=\"20\" fill=\"#1b1b1b\">{0}</text>\n",
        escape(title)
    )
}

/// Draws `layers`, back to front, under a title. The cost is linear in the number of points drawn.
pub fn draw(title: &str, layers: &[Layer]) -> String {
    if layers.iter().any(Layer::hides) {
        return side_by_side(title, layers);
    }
    let page = Page::around(layers.iter().flat_map(|layer| layer.lines.iter().flatten()));
    let mut svg = open(title, page.height);
    for layer in layers {
        draw_layer(&mut svg, layer, |p| page.place(p));
    }
    draw_legend(&mut svg, layers, page.height - 12.0);
    svg.push_str("</svg>\n");
    svg
}

/// Draws one shape per cell, those of the front layer first.
fn side_by_side(title: &str, layers: &[Layer]) -> String {
    let mut cells: Vec<(String, Vec<Layer>)> = Vec::new();
    for layer in layers.iter().rev() {
        let (before, room) = (cells.len(), MAX_SURFACES - cells.len());
        cells.extend(layer.apart().take(room).map(|one| (one.name.clone().unwrap_or_default(), vec![one])));
        // Only the first of many surfaces are drawn, so the caption says so.
        let many = layer.lines.len() > 1 && layer.name.is_some();
        if let (true, Some((caption, _))) = (many, cells.get_mut(before)) {
            *caption = format!("some of {caption}");
        }
    }
    let columns = if cells.len() <= MAX_IN_A_ROW { cells.len() } else { columns_of(cells.len()) };
    draw_cells(title, &cells, columns)
}

/// Up to this many surfaces are drawn in one row.
const MAX_IN_A_ROW: usize = 7;

/// Number of columns of a grid that is about as wide as high.
fn columns_of(cells: usize) -> usize {
    (cells as f64).sqrt().ceil().clamp(1.0, MAX_COLUMNS as f64) as usize
}

/// Maximum number of cells per row of a grid.
const MAX_COLUMNS: usize = 10;

/// Draws cells with captions side by side on one scale, each centred on its own shapes.
pub fn grid(title: &str, cells: &[(String, Vec<Layer>)]) -> String {
    draw_cells(title, cells, columns_of(cells.len()))
}

fn draw_cells(title: &str, cells: &[(String, Vec<Layer>)], columns: usize) -> String {
    let columns = columns.max(1);
    let pages: Vec<Page> = cells
        .iter()
        .map(|(_, layers)| Page::around(layers.iter().flat_map(|layer| layer.lines.iter().flatten())))
        .collect();
    let side = (SIZE - 2.0 * MARGIN) / columns as f64;
    let scale =
        pages.iter().map(|page| page.scale).fold(f64::MAX, f64::min) * 0.85 * side / (SIZE - 2.0 * MARGIN);
    let height = 2.0 * CAPTION + (side + CAPTION) * cells.len().div_ceil(columns) as f64;
    let mut svg = open(title, height.round());
    for (i, ((caption, layers), page)) in cells.iter().zip(&pages).enumerate() {
        let (left, top) = ((i % columns) as f64, (i / columns) as f64);
        let centre = [MARGIN + (left + 0.5) * side, CAPTION + 0.5 * side + (side + CAPTION) * top];
        for layer in layers {
            draw_layer(&mut svg, layer, |p| {
                [centre[0] + scale * (p[0] - page.centre[0]), centre[1] - scale * (p[1] - page.centre[1])]
            });
        }
        writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.0}\" font-size=\"11\" text-anchor=\"middle\" fill=\"#1b1b1b\">{}</text>",
            centre[0],
            centre[1] + 0.5 * side + 14.0,
            escape(caption)
        )
        .expect("writing to a string cannot fail");
    }
    svg.push_str("</svg>\n");
    svg
}

/// Seconds per frame of an animation.
const FRAME_SECONDS: f64 = 0.4;

/// Animation through the lines of a layer and back, in a loop; the first and last line stay visible as thin lines. Viewers
/// without animation show the first.
pub fn animate(title: &str, layer: &Layer) -> String {
    if layer.hides() {
        return draw(title, std::slice::from_ref(layer));
    }
    let page = Page::around(layer.lines.iter().flatten());
    let mut svg = open(title, page.height);
    let there = RESOLUTION.frames(&layer.lines, |p| page.place(p), layer.mark == Mark::Closed);
    let style = "fill=\"none\" stroke-linejoin=\"round\"";
    let write = "writing to a string cannot fail";
    for (path, colour) in [(there.first(), colour::MINUS), (there.last(), colour::PLUS)] {
        let Some(path) = path else { continue };
        writeln!(svg, "<path {style} stroke=\"{colour}\" stroke-opacity=\"0.5\" d=\"{path}\"/>")
            .expect(write);
    }
    let frames: Vec<&str> = there.iter().chain(there.iter().rev().skip(1)).map(String::as_str).collect();
    let seconds = FRAME_SECONDS * frames.len().saturating_sub(1).max(1) as f64;
    writeln!(
        svg,
        "<path {style} stroke=\"{}\" stroke-width=\"{}\" d=\"{}\"><animate attributeName=\"d\" dur=\"{seconds:.1}s\" \
         repeatCount=\"indefinite\" values=\"{}\"/></path>",
        layer.colour,
        layer.width,
        frames.first().unwrap_or(&""),
        frames.join(";")
    )
    .expect(write);
    svg.push_str("</svg>\n");
    svg
}

/// Approximate length of the text of a point, such as ` 12.3-4.5`, in bytes.
const POINT_BYTES: usize = 9;

/// Approximate length of the text of [`animate`], in which every line appears twice.
pub fn animation_bytes(layer: &Layer) -> usize {
    if layer.hides() {
        return 0;
    }
    let page = Page::around(layer.lines.iter().flatten());
    2 * POINT_BYTES * layer.lines.len() * RESOLUTION.frame_points(&layer.lines, |p| page.place(p))
}

pub(super) fn draw_layer(svg: &mut String, layer: &Layer, place: impl Fn(&[f64; 2]) -> [f64; 2]) {
    let Layer { colour, width, opacity, .. } = layer;
    let write = "writing to a string cannot fail";
    if layer.mark == Mark::Facets {
        svg.push_str(FACETS);
        for (corners, light) in layer.lines.iter().zip(&layer.light) {
            for (facet, light) in corners.chunks_exact(4).zip(light) {
                draw_facet(svg, &lit(colour, *light), facet, &place);
            }
        }
    } else if layer.mark == Mark::Dots {
        writeln!(svg, "<g fill=\"{colour}\" fill-opacity=\"{opacity}\">").expect(write);
        for point in layer.lines.iter().flatten().map(&place) {
            let [x, y] = point.map(|x| RESOLUTION.number(x));
            writeln!(svg, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{:.1}\"/>", width + 1.5).expect(write);
        }
    } else {
        writeln!(
            svg,
            "<g fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\" stroke-linejoin=\"round\">"
        )
        .expect(write);
        for line in &layer.lines {
            svg.push_str("<path d=\"");
            RESOLUTION.push_path(svg, line, &place, layer.mark == Mark::Closed);
            svg.push_str("\"/>\n");
        }
    }
    svg.push_str("</g>\n");
}

/// Opens a group of facets.
pub(super) const FACETS: &str = "<g stroke-width=\".6\" stroke-linejoin=\"round\">\n";

/// Draws a facet of a surface.
pub(super) fn draw_facet(
    svg: &mut String,
    colour: &str,
    corners: &[[f64; 2]],
    place: impl Fn(&[f64; 2]) -> [f64; 2],
) {
    write!(svg, "<path fill=\"{colour}\" stroke=\"{colour}\" d=\"").expect("writing to a string cannot fail");
    RESOLUTION.push_polygon(svg, corners, place);
    svg.push_str("\"/>\n");
}

/// A pale version of a colour under the given light.
fn lit(colour: &str, light: f64) -> String {
    let channel = |i: usize| {
        let value = colour.get(1 + 2 * i..3 + 2 * i).and_then(|hex| u8::from_str_radix(hex, 16).ok());
        let pale = 0.35 * f64::from(value.unwrap_or(0)) + 0.65 * 255.0;
        (pale * light).round().clamp(0.0, 255.0) as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(0), channel(1), channel(2))
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

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;

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
        assert!(svg.contains(&format!("M{} {}", SIZE - MARGIN, CAPTION + SIZE / 2.0)), "{svg}");
    }
}
