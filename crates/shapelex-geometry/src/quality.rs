//! Quality checks of closed triangle meshes: defects that are possible although the faces fit together.
//!
//! ```text
//! collapsed   an edge without length                    flat      thinner than 10⁻⁹ of its extent in some direction
//! no volume   |V| ≤ 10⁻¹² A^{3/2}                       inside out   V < 0
//! meets itself   two faces without a common edge share more than a point, or two with one lie on one another
//! coarse      a rounding of the largest coordinate is more than 10⁻⁹ of the extent
//! ```
//!
//! Candidate pairs of faces come from the box tree of [`NearestTriangles`]. Their number is bounded, so the test for
//! self-intersection may remain undecided.

use super::mesh::TriangleMesh;
use super::mesh_tree::NearestTriangles;
use super::vector::{bounds, cross, dot, minus, norm};
use shapelex_numeric::bounded::{Allowance, Stop};

/// Defects of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MeshQuality {
    /// Number of edges without length.
    pub collapsed_edges: usize,
    /// Whether all vertices are one point.
    pub is_point: bool,
    /// Whether the mesh lies in a plane or on a line.
    pub is_flat: bool,
    /// Whether the mesh encloses no volume although it is not flat: its sheets coincide or cancel.
    pub has_no_volume: bool,
    /// Whether the faces are counter-clockwise as seen from inside.
    pub is_inside_out: bool,
    /// Whether the mesh crosses or touches itself; `None` if it has too many faces or the test was not decided.
    pub self_intersecting: Option<bool>,
    /// Rounding unit of the largest coordinate, if it is a significant fraction of the extent.
    pub rounding: Option<f64>,
}

/// Rounding unit, relative to the extent, that is not reported: nine digits exceed the accuracy of measured surfaces.
const COARSE: f64 = 1e-9;
/// Relative thickness below which a mesh is flat: coordinates with nine digits hold no more.
const FLAT: f64 = 1e-9;
/// Ratio of the volume to the power 3/2 of the area below which the volume is rounding: a ball has 0.09.
const NO_VOLUME: f64 = 1e-12;
/// Length, relative to the largest coordinate, below which a length is rounding.
const NOTHING: f64 = 4.0 * f64::EPSILON;
/// Maximum number of faces for the self-intersection test, which takes some hundredths of a second.
pub const MAX_FACES: usize = 20_000;
/// Maximum number of pairs of boxes and faces to examine per face. A sphere needs some thirty.
const PAIRS_PER_FACE: usize = 1_000;

impl MeshQuality {
    /// The defects in words.
    pub fn warnings(&self) -> Vec<String> {
        let edges = format!("{} of its edges have no length: vertices coincide", self.collapsed_edges);
        let rounding = rounding_warning(self.rounding.unwrap_or_default());
        let found = [
            (self.is_point, "all of its vertices are one point".to_owned()),
            (self.collapsed_edges > 0 && !self.is_point, edges),
            (self.is_flat, "it is flat: it lies in a plane and encloses no volume".to_owned()),
            (self.has_no_volume, "it encloses no volume: its sheets coincide or cancel".to_owned()),
            (
                self.is_inside_out,
                "it is inside out: its volume is negative, because its faces run clockwise seen from outside"
                    .to_owned(),
            ),
            (
                self.self_intersecting == Some(true),
                "it crosses or lies on itself: volumes count some parts twice or not at all".to_owned(),
            ),
            (self.rounding.is_some(), rounding),
        ];
        found.into_iter().filter_map(|(holds, text)| holds.then_some(text)).collect()
    }

    /// Checks a mesh with known signed volume (`None` for a sheet) and area, and tests `faces` of it for intersections. Cost:
    /// linear, and for the intersections `O(F log F)` with at most 1000 pairs per face.
    pub fn of(
        mesh: &TriangleMesh,
        (signed_volume, area): (Option<f64>, f64),
        faces: &[[u32; 3]],
        stop: Stop<'_>,
    ) -> Self {
        let [low, high] = bounds(mesh.vertices.iter().copied()).unwrap_or_default();
        let extent = (0..3).map(|c| high[c] - low[c]).fold(0.0, f64::max);
        let largest = (0..3).map(|c| low[c].abs().max(high[c].abs())).fold(0.0, f64::max);
        let nothing = NOTHING * largest;
        let is_point = !(extent > nothing);
        let near: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| near_one(*v, low, extent)).collect();
        let is_thin = !is_point && thickness(&near) <= FLAT.max(nothing / extent);
        // A sheet may legitimately be flat.
        let is_flat = is_thin && signed_volume.is_some();
        let has_volume = signed_volume.is_none_or(|volume| volume.abs() > NO_VOLUME * area.powf(1.5));
        let rounding = coarse_rounding(extent, largest);
        // Intersections caused by the rounding of coordinates do not count.
        let decided = !is_point && !is_thin && rounding.is_none() && faces.len() <= MAX_FACES;
        Self {
            collapsed_edges: collapsed_edges(mesh, largest),
            is_point,
            is_flat,
            has_no_volume: !is_point && !is_flat && !has_volume,
            is_inside_out: !is_point
                && !is_flat
                && has_volume
                && signed_volume.is_some_and(|volume| volume < 0.0),
            self_intersecting: if decided { self_intersects(&near, faces, stop) } else { None },
            rounding,
        }
    }
}

/// The rounding unit of the `largest` coordinate of a shape, if it is a significant fraction of its `extent` and the shape is not a
/// point.
pub fn coarse_rounding(extent: f64, largest: f64) -> Option<f64> {
    let rounding = f64::EPSILON * largest;
    (rounding > COARSE * extent && extent > NOTHING * largest).then_some(rounding)
}

/// [`coarse_rounding`] in words.
pub fn rounding_warning(rounding: f64) -> String {
    format!(
        "it is so far from the origin that coordinates are rounded to {rounding:.1e}: smaller details are lost"
    )
}

/// The point relative to the lower corner of the box, in units of the extent.
fn near_one(point: [f64; 3], low: [f64; 3], extent: f64) -> [f64; 3] {
    minus(point, low).map(|x| if extent > 0.0 { x / extent } else { 0.0 })
}

/// Number of edges without length, up to rounding at the `largest` coordinate; each edge is in two faces. The mesh may be
/// unchecked: an edge to a missing vertex is not counted.
pub fn collapsed_edges(mesh: &TriangleMesh, largest: f64) -> usize {
    let nothing = NOTHING * largest;
    let is_collapsed = |[a, b]: [u32; 2]| {
        let ends = mesh.vertices.get(a as usize).zip(mesh.vertices.get(b as usize));
        ends.is_some_and(|(a, b)| (0..3).all(|c| (a[c] - b[c]).abs() <= nothing))
    };
    let edges = mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    edges.filter(|[a, b]| a < b).filter(|edge| is_collapsed(*edge)).count()
}

/// Smallest over largest singular value of points about their mean.
fn thickness(points: &[[f64; 3]]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean = [0, 1, 2].map(|c| points.iter().map(|point| point[c]).sum::<f64>() / count);
    // Three longest mutually orthogonal directions: squares of moments would lose half of the digits.
    let farthest = |from: [f64; 3], across: &[[f64; 3]]| {
        let rest = |point: &[f64; 3]| without(minus(*point, from), across);
        points.iter().map(rest).fold([0.0; 3], |a, b| if dot(b, b) > dot(a, a) { b } else { a })
    };
    let mut axes: Vec<[f64; 3]> = Vec::new();
    let mut lengths = [0.0; 3];
    for length in &mut lengths {
        let axis = farthest(mean, &axes);
        *length = norm(axis);
        axes.push(axis.map(|x| if *length > 0.0 { x / *length } else { 0.0 }));
    }
    if lengths[0] > 0.0 { lengths[2] / lengths[0] } else { 0.0 }
}

fn without(mut vector: [f64; 3], axes: &[[f64; 3]]) -> [f64; 3] {
    for axis in axes {
        let along = dot(vector, *axis);
        vector = [0, 1, 2].map(|c| vector[c] - along * axis[c]);
    }
    vector
}

/// Whether faces of a mesh with extent 1 cross or lie on one another. `None` if that takes too many pairs, or `stop` returns
/// true.
fn self_intersects(vertices: &[[f64; 3]], faces: &[[u32; 3]], stop: Stop<'_>) -> Option<bool> {
    let tree = NearestTriangles::new(vertices, faces);
    let mut allowance = Allowance::new(10_000 + PAIRS_PER_FACE * faces.len(), stop);
    let corners = |face: &[u32; 3]| face.map(|vertex| vertices[vertex as usize]);
    let triangles: Vec<Option<Triangle>> = faces.iter().map(|face| Triangle::new(corners(face))).collect();
    tree.any_pair(&mut allowance, |one, other| {
        let (Some(a), Some(b)) = (&triangles[one], &triangles[other]) else { return false };
        let shared = faces[one].iter().filter(|vertex| faces[other].contains(vertex)).count();
        a.meets(b, shared)
    })
}

/// A face with positive area.
struct Triangle {
    corners: [[f64; 3]; 3],
    normal: [f64; 3],
    size: f64,
}

/// Thickness of a face, relative to its longest edge, below which it has no plane.
const THIN: f64 = 1e-7;
/// Distance of a corner from the plane of another face, relative to the size of both, below which it is in the plane.
const IN_PLANE: f64 = 1e-9;
/// Length of an intersection, relative to the size of the faces, below which they only touch.
const TOUCH: f64 = 1e-5;

impl Triangle {
    fn new(corners: [[f64; 3]; 3]) -> Option<Self> {
        let [a, b, c] = corners;
        let size = norm(minus(b, a)).max(norm(minus(c, b))).max(norm(minus(a, c)));
        let normal = cross(minus(b, a), minus(c, a));
        let length = norm(normal);
        (length > THIN * size * size).then(|| Self { corners, normal: normal.map(|x| x / length), size })
    }

    fn heights(&self, of: &Self, nothing: f64) -> [f64; 3] {
        of.corners.map(|corner| {
            let height = dot(self.normal, minus(corner, self.corners[0]));
            if height.abs() <= nothing { 0.0 } else { height }
        })
    }

    /// Whether two faces with `shared` common corners have more than these, and more than a touch, in common.
    fn meets(&self, other: &Self, shared: usize) -> bool {
        let size = self.size.max(other.size);
        let (mine, theirs) = (other.heights(self, IN_PLANE * size), self.heights(other, IN_PLANE * size));
        if [mine, theirs]
            .iter()
            .any(|heights| heights.iter().all(|h| *h > 0.0) || heights.iter().all(|h| *h < 0.0))
        {
            return false;
        }
        if mine == [0.0; 3] || theirs == [0.0; 3] {
            return self.overlaps(other);
        }
        // Two planes through a common edge intersect nowhere else.
        if shared >= 2 {
            return false;
        }
        let line = cross(self.normal, other.normal);
        let length = norm(line);
        if !(length > IN_PLANE) {
            return false;
        }
        let line = line.map(|x| x / length);
        let (first, second) =
            (self.cut(mine, line, other.corners[0]), other.cut(theirs, line, other.corners[0]));
        let (Some(first), Some(second)) = (first, second) else { return false };
        let common = first[1].min(second[1]) - first[0].max(second[0]);
        common > TOUCH * self.size.min(other.size)
    }

    /// Interval in which a face, given its corners' heights over a plane, meets that plane, along a line from `origin`.
    fn cut(&self, heights: [f64; 3], line: [f64; 3], origin: [f64; 3]) -> Option<[f64; 2]> {
        let along = self.corners.map(|corner| dot(line, minus(corner, origin)));
        let mut cut: Option<[f64; 2]> = None;
        let mut add = |at: f64| {
            let [low, high] = cut.unwrap_or([at, at]);
            cut = Some([low.min(at), high.max(at)]);
        };
        for i in 0..3 {
            let j = (i + 1) % 3;
            if heights[i] == 0.0 {
                add(along[i]);
            }
            if heights[i] * heights[j] < 0.0 {
                add(along[i] + (along[j] - along[i]) * heights[i] / (heights[i] - heights[j]));
            }
        }
        cut
    }

    /// Whether two coplanar faces share an area: no edge of either separates it from the other.
    fn overlaps(&self, other: &Self) -> bool {
        let least = TOUCH * self.size.min(other.size);
        let separates = |from: &Self, to: &Self| {
            (0..3).any(|i| {
                let (a, b) = (from.corners[i], from.corners[(i + 1) % 3]);
                let outward = cross(minus(b, a), from.normal);
                let length = norm(outward);
                to.corners.iter().all(|corner| dot(outward, minus(*corner, a)) > -least * length)
            })
        };
        !separates(self, other) && !separates(other, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subdivision::control::StartMesh;
    use shapelex_numeric::bounded::never;

    fn quality(mesh: &TriangleMesh) -> MeshQuality {
        let measures = crate::subdivision::measures::measure(mesh, false);
        let volume = measures.enclosed.map(|enclosed| enclosed.signed_volume);
        MeshQuality::of(mesh, (volume, measures.area), &mesh.faces, &never)
    }

    fn sphere(text: &str) -> TriangleMesh {
        text.parse::<StartMesh>().unwrap().mesh()
    }

    fn mapped(text: &str, map: impl Fn([f64; 3]) -> [f64; 3]) -> TriangleMesh {
        let mut mesh = sphere(text);
        mesh.vertices.iter_mut().for_each(|vertex| *vertex = map(*vertex));
        mesh
    }

    #[test]
    fn spheres_and_ellipsoids_are_sound_at_every_size_and_place() {
        for text in ["octahedron/1", "octahedron/4", "icosahedron/3"] {
            for (unit, offset) in [(1.0, 0.0), (1e-90, 0.0), (1e90, 0.0), (1.0, 1e5), (1e-3, -40.0)] {
                let mesh = mapped(text, |[x, y, z]| [3.0 * x, y, 0.2 * z].map(|x| unit * x + offset));
                let wanted = MeshQuality { self_intersecting: Some(false), ..MeshQuality::default() };
                assert_eq!(quality(&mesh), wanted, "{text} {unit} {offset}");
            }
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let point = quality(&mapped("octahedron/2", |_| [1.0, 2.0, 3.0]));
        assert!(point.is_point && point.collapsed_edges == 192 && !point.is_flat, "{point:?}");
        let flat = quality(&mapped("octahedron/2", |[x, y, _]| [x + y, y - x, 2.0 * x + 0.5 * y]));
        assert!(flat.is_flat && !flat.has_no_volume, "{flat:?}");
        let turned = quality(&mapped("octahedron/2", |[x, y, z]| [y, x, z]));
        assert!(turned.is_inside_out && turned.self_intersecting == Some(false), "{turned:?}");
        let mut one = sphere("octahedron/2");
        one.vertices[0] = one.vertices[one
            .faces
            .iter()
            .find(|face| face.contains(&0))
            .map(|f| if f[0] == 0 { f[1] } else { f[0] })
            .unwrap() as usize];
        assert_eq!(quality(&one).collapsed_edges, 1);
        let far = quality(&mapped("octahedron/2", |point| point.map(|x| x + 1e15)));
        assert_eq!((far.rounding, far.self_intersecting), (Some(f64::EPSILON * (1e15 + 1.0)), None));
    }

    #[test]
    fn meshes_that_cross_or_lie_on_themselves_are_told() {
        // A spike from the top that emerges at the bottom.
        let mut spike = sphere("octahedron/3");
        let top = spike.vertices.iter().position(|v| v[2] > 0.999).unwrap();
        spike.vertices[top] = [0.03, 0.02, -3.0];
        assert_eq!(quality(&spike).self_intersecting, Some(true));
        // Both halves on the same side: no volume, and every face lies on another.
        let folded = mapped("octahedron/3", |[x, y, z]| [x, y, z.abs()]);
        let found = quality(&folded);
        assert!(found.has_no_volume && found.self_intersecting == Some(true), "{found:?}");
        // Bent until its ends pass through each other.
        let bent = mapped("octahedron/4", |[x, y, z]| {
            let (s, c) = (3.4 * x).sin_cos();
            [(2.0 + 0.4 * y) * c, (2.0 + 0.4 * y) * s, 0.4 * z]
        });
        assert_eq!(quality(&bent).self_intersecting, Some(true));
        let open = mapped("octahedron/4", |[x, y, z]| {
            let (s, c) = (2.6 * x).sin_cos();
            [(2.0 + 0.4 * y) * c, (2.0 + 0.4 * y) * s, 0.4 * z]
        });
        assert_eq!(quality(&open).self_intersecting, Some(false));
    }

    #[test]
    fn the_search_ends_when_there_are_too_many_pairs_or_the_caller_stops() {
        let mesh = sphere("octahedron/4");
        assert_eq!(self_intersects(&mesh.vertices, &mesh.faces, &|| true), None);
        let tree = NearestTriangles::new(&mesh.vertices, &mesh.faces);
        let mut few = Allowance::new(1000, &never);
        assert_eq!(tree.any_pair(&mut few, |_, _| false), None);
        // Some thirty pairs of boxes per face.
        let mut enough = Allowance::new(60 * mesh.faces.len(), &never);
        assert_eq!(tree.any_pair(&mut enough, |_, _| false), Some(false));
    }
}
