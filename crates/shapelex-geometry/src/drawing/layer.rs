//! Layers of drawings: shapes as points in the plane.
//!
//! Spline curves are drawn through samples (8 per control point, at least 128), not through their control points; samples that
//! the eye does not need are left out. Shapes in space are drawn in parallel projection along the direction (1, −1, 1)/√3. The y
//! axis points up, as in the data. Surfaces are shaded.

use super::colour::Colour;
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
    /// Colours of the facets of every surface; empty for other shapes.
    pub colours: Vec<Vec<Colour>>,
    /// Drawing style of the points.
    pub mark: Mark,
    /// Colour.
    pub colour: Colour,
    /// Stroke width in pixels.
    pub width: f64,
    /// Opacity of the stroke.
    pub opacity: f64,
    /// Entry of the legend, if any.
    pub name: Option<String>,
    /// Names of the lines, which viewers show where one points at them; empty if they have none.
    pub titles: Vec<String>,
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
    /// Arrows, from the first to the last point of every line.
    Arrows,
    /// The titles of the lines as words beside their first points.
    Words,
    /// Four-sided facets, farthest first.
    Facets,
}

impl Layer {
    /// Layer of shapes of `space`, given by control points (`d·N` coordinate-major numbers each).
    pub fn of<'a>(
        space: &ShapeSpace,
        shapes: impl IntoIterator<Item = &'a [f64]>,
        colour: Colour,
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
        Self { lines, colours: Vec::new(), mark, colour, width, opacity, name: None, titles: Vec::new() }
    }

    /// Layer of closed meshes.
    pub fn from_meshes(meshes: &[TriangleMesh], colour: Colour) -> Self {
        let among_others = meshes.len() > 1;
        let drawn = meshes.iter().take(MAX_SURFACES);
        Self::from_facets(drawn.map(|mesh| Facets::from_mesh(mesh, among_others)), colour)
    }

    /// Layer of one polyline in the plane or in space.
    pub fn from_polyline(points: &[&[f64]], closed: bool, colour: Colour) -> Self {
        let line = points.iter().map(|point| flatten(point)).collect();
        Self::from_points(line, if closed { Mark::Closed } else { Mark::Open }, colour, 2.5)
    }

    /// Layer of arrows from the control points of one shape to those of another.
    pub fn arrows(space: &ShapeSpace, [from, to]: [&[f64]; 2], colour: Colour, width: f64) -> Self {
        let [from, to] = [from, to].map(|shape| placed(space, shape));
        let lines = from.into_iter().zip(to).map(|(from, to)| vec![from, to]).collect();
        Self { lines, ..Self::from_points(Vec::new(), Mark::Arrows, colour, width) }
    }

    /// Layer of words beside points in the plane or in space.
    pub fn words(points: &[&[f64]], words: Vec<String>, colour: Colour) -> Self {
        let lines = points.iter().map(|point| vec![flatten(point)]).collect();
        Self { lines, titles: words, ..Self::from_points(Vec::new(), Mark::Words, colour, 1.0) }
    }

    /// Layer of points as they are placed in the plane.
    pub(super) fn from_points(points: Vec<[f64; 2]>, mark: Mark, colour: Colour, width: f64) -> Self {
        Self {
            lines: vec![points],
            colours: Vec::new(),
            mark,
            colour,
            width,
            opacity: 1.0,
            name: None,
            titles: Vec::new(),
        }
    }

    fn from_facets(facets: impl Iterator<Item = Facets>, colour: Colour) -> Self {
        let painted = |facets: Facets| {
            let colours = facets.light.iter().map(|light| colour.pale().under(*light)).collect();
            (facets.corners, colours)
        };
        let (lines, colours) = facets.map(painted).unzip();
        Self {
            lines,
            colours,
            mark: Mark::Facets,
            colour,
            width: 1.0,
            opacity: 1.0,
            name: None,
            titles: Vec::new(),
        }
    }

    /// Whether its shapes hide layers behind them.
    pub(super) fn hides(&self) -> bool {
        self.mark == Mark::Facets
    }

    /// Layers of one shape each; only the first keeps the name.
    pub fn apart(&self) -> impl Iterator<Item = Self> + '_ {
        (0..self.lines.len()).map(|i| Self {
            lines: vec![self.lines[i].clone()],
            colours: self.colours.get(i).cloned().into_iter().collect(),
            name: self.name.clone().filter(|_| i == 0),
            titles: self.titles.get(i).cloned().into_iter().collect(),
            ..*self
        })
    }

    /// Radius of its dots.
    pub(super) fn radius(&self) -> f64 {
        self.width + 1.5
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
    match Curve::of(space, &rows_of_dimension(control_points, d)) {
        Some(curve) => curve.sample((8 * n).clamp(128, 4096)).iter().map(|p| flatten(p)).collect(),
        None => placed(space, control_points),
    }
}

/// Control points in the plane.
fn placed(space: &ShapeSpace, control_points: &[f64]) -> Vec<[f64; 2]> {
    let d = space.representation().dimension();
    let n = control_points.len() / d;
    let point = |k: usize| (0..d).map(|c| control_points[c * n + k]).collect::<Vec<_>>();
    (0..n).map(|k| flatten(&point(k))).collect()
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
pub const MAX_SURFACES: usize = 12;
/// Facets along each direction of a surface: the range for one alone (about two per interval between knots), and among others.
const CELLS: [usize; 2] = [48, 88];
const CELLS_AMONG_OTHERS: usize = 36;
/// Approximate direction of the light: over the viewer's left shoulder.
const LIGHT: [f64; 3] = [-0.02, -0.73, 0.68];
/// Brightness of faces turned away from the light.
const AMBIENT: f64 = 0.35;
/// Share of white that light from behind gives to the rim of a surface, which sets it off from dark pages and from folds behind.
const RIM: f64 = 0.45;

/// Maximum number of faces of a drawn mesh, alone and among others.
pub const MAX_FACES: usize = 10_000;
const MAX_FACES_AMONG_OTHERS: usize = 2_600;

/// Subdivision level at which shapes are drawn.
pub(super) fn drawn_level(basis: &SubdivisionBasis, among_others: bool) -> usize {
    basis.level_with(if among_others { MAX_FACES_AMONG_OTHERS } else { MAX_FACES })
}

/// Control points in space, one per row.
pub(super) fn rows_of(shape: &[f64]) -> Matrix {
    rows_of_dimension(shape, 3)
}

/// Control points of a dimension, one per row.
pub(super) fn rows_of_dimension(shape: &[f64], d: usize) -> Matrix {
    Matrix::from_column_slice(shape.len() / d, d, shape)
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
    let front = AMBIENT + (1.0 - AMBIENT) * (0.5 + 0.5 * dot(normal, LIGHT)).powi(2);
    let grazing = 1.0 - depth(&normal).abs().min(1.0);
    front + (1.0 - front) * RIM * grazing.powi(3)
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
