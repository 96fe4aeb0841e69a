//! Nearest points on a triangle mesh, by a tree of bounding boxes.
//!
//! ```text
//! q = argmin |p − q|   over all triangles   { w₀ a + w₁ b + w₂ c : w ≥ 0, w₀ + w₁ + w₂ = 1 }
//! ```
//!
//! Faces are halved recursively; the bounding boxes of the halves exclude everything farther than the best point so far.

use super::vector::{cross, dot, minus};
use shapelex_numeric::bounded::Allowance;

/// A mesh prepared for [`NearestTriangles::nearest`].
#[derive(Debug, Clone)]
pub struct NearestTriangles<'a> {
    vertices: &'a [[f64; 3]],
    faces: &'a [[u32; 3]],
    /// Preorder: a node, its first child with all below it, its second child with all below it.
    nodes: Vec<Node>,
}

/// The nearest point of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Index of the face that contains the point.
    pub face: usize,
    /// Barycentric coordinates on that face: non-negative, with sum 1.
    pub weights: [f64; 3],
    /// The nearest point.
    pub point: [f64; 3],
    /// Distance in the unit of the vertices.
    pub distance: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    lower: [f64; 3],
    upper: [f64; 3],
    content: Content,
}

#[derive(Debug, Clone, Copy)]
enum Content {
    Face(usize),
    /// Index of the second child; the first child follows its parent.
    Children(usize),
}

/// Relative padding of boxes, as a fraction of their largest coordinate. A rounded foot stays within its box, so no box is
/// excluded because of a distance that is too short only by rounding.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Sine of the angle at the first corner below which a triangle is also searched along its edges: the direction of its
/// normal has lost half of its digits or more.
const SLIVER: f64 = 1e-8;

/// A point on a triangle.
#[derive(Clone, Copy)]
struct Place {
    weights: [f64; 3],
    point: [f64; 3],
    square: f64,
}

impl<'a> NearestTriangles<'a> {
    /// Builds the tree for faces whose corners are vertices. Faces are halved at the median of their centroids along the
    /// longest direction, down to single faces: `O(F log F)`, depth `⌈log₂ F⌉`.
    pub fn new(vertices: &'a [[f64; 3]], faces: &'a [[u32; 3]]) -> Self {
        let mut tree = Self { vertices, faces, nodes: Vec::with_capacity(2 * faces.len()) };
        let centroid = |face: usize| {
            let corners = tree.corners(face);
            [0, 1, 2].map(|axis| corners.iter().map(|corner| corner[axis] / 3.0).sum())
        };
        let centroids: Vec<[f64; 3]> = (0..faces.len()).map(centroid).collect();
        let mut order: Vec<usize> = (0..faces.len()).collect();
        tree.divide(&mut order, &centroids);
        tree
    }

    /// The point of the mesh nearest to `point`; on several equally near faces, the one with the lowest index. `None` for a
    /// mesh without faces and for a point that is not finite.
    ///
    /// Feet on a common edge or vertex have the same bits on all of its faces, so the choice does not depend on rounding.
    /// Squares of the coordinates must be normal numbers. Cost `O(log F)` for points near the surface; all faces in the
    /// worst case (the centre of a sphere).
    pub fn nearest(&self, point: [f64; 3]) -> Option<Foot> {
        let mut best = None;
        if !self.nodes.is_empty() {
            self.visit(0, point, &mut best);
        }
        best.map(|(face, Place { weights, point, square })| Foot {
            face,
            weights,
            point,
            distance: square.sqrt(),
        })
    }

    /// Whether `holds` is true for any pair of faces with overlapping boxes, where the second face is not before the first in the
    /// tree. `None` if the allowance of box pairs is used up.
    pub fn any_pair(
        &self,
        allowance: &mut Allowance<'_>,
        holds: impl Fn(usize, usize) -> bool,
    ) -> Option<bool> {
        let mut pending = if self.nodes.is_empty() { Vec::new() } else { vec![(0, 0)] };
        while let Some((one, other)) = pending.pop() {
            if !allowance.take() {
                return None;
            }
            if !self.nodes[one].meets(&self.nodes[other]) {
                continue;
            }
            match (self.nodes[one].content, self.nodes[other].content) {
                (Content::Face(first), Content::Face(second)) => {
                    if first != second && holds(first, second) {
                        return Some(true);
                    }
                }
                (Content::Children(second), Content::Face(_)) => {
                    pending.extend([(one + 1, other), (second, other)]);
                }
                (Content::Face(_), Content::Children(second)) => {
                    pending.extend([(one, other + 1), (one, second)]);
                }
                (Content::Children(second), Content::Children(_)) if one == other => {
                    pending.extend([(one + 1, one + 1), (second, second), (one + 1, second)]);
                }
                // Split the larger box.
                (Content::Children(first), Content::Children(second)) => {
                    let first_is_larger = self.nodes[one].size() >= self.nodes[other].size();
                    let pairs = if first_is_larger {
                        [(one + 1, other), (first, other)]
                    } else {
                        [(one, other + 1), (one, second)]
                    };
                    pending.extend(pairs);
                }
            }
        }
        Some(false)
    }

    #[inline]
    fn corners(&self, face: usize) -> [[f64; 3]; 3] {
        self.faces[face].map(|vertex| self.vertices[vertex as usize])
    }

    /// Adds the node of some faces and all nodes below it.
    fn divide(&mut self, faces: &mut [usize], centroids: &[[f64; 3]]) {
        let Some(&face) = faces.first() else { return };
        let [lower, upper] = around(faces.iter().flat_map(|face| self.corners(*face)));
        let pad = [0, 1, 2].map(|axis: usize| ROUNDING * lower[axis].abs().max(upper[axis].abs()));
        let upper = [0, 1, 2].map(|axis: usize| upper[axis] + pad[axis]);
        let node = self.nodes.len();
        self.nodes.push(Node { lower: minus(lower, pad), upper, content: Content::Face(face) });
        if faces.len() > 1 {
            let (first, second) = halves(faces, centroids);
            self.divide(first, centroids);
            self.nodes[node].content = Content::Children(self.nodes.len());
            self.divide(second, centroids);
        }
    }

    /// Improves `best` from the faces below a node, the nearer child first.
    fn visit(&self, node: usize, point: [f64; 3], best: &mut Option<(usize, Place)>) {
        match self.nodes[node].content {
            Content::Face(face) => {
                let place = on_triangle(point, self.corners(face));
                let improves = match best {
                    Some((first, best)) => {
                        place.square < best.square || (place.square == best.square && face < *first)
                    }
                    None => place.square.is_finite(),
                };
                if improves {
                    *best = Some((face, place));
                }
            }
            Content::Children(second) => {
                let with_distance = |child: usize| (self.nodes[child].square_distance(point), child);
                let mut children = [with_distance(node + 1), with_distance(second)];
                if children[1].0 < children[0].0 {
                    children.swap(0, 1);
                }
                for (square, child) in children {
                    // `<=` rather than `<`: an equal distance may belong to a face with a lower index.
                    if best.is_none_or(|(_, place)| square <= place.square) {
                        self.visit(child, point, best);
                    }
                }
            }
        }
    }
}

impl Node {
    fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.lower[axis] <= other.upper[axis] && other.lower[axis] <= self.upper[axis])
    }

    /// Longest side of the box.
    fn size(&self) -> f64 {
        (0..3).map(|axis| self.upper[axis] - self.lower[axis]).fold(0.0, f64::max)
    }

    /// Squared distance from a point to the box; 0 inside.
    fn square_distance(&self, point: [f64; 3]) -> f64 {
        let beyond =
            |axis: usize| (self.lower[axis] - point[axis]).max(point[axis] - self.upper[axis]).max(0.0);
        let beyond = [beyond(0), beyond(1), beyond(2)];
        dot(beyond, beyond)
    }
}

/// Bounding box of points, lower and upper corner.
fn around(points: impl Iterator<Item = [f64; 3]>) -> [[f64; 3]; 2] {
    points.fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], |[lower, upper], point| {
        [
            std::array::from_fn(|axis| lower[axis].min(point[axis])),
            std::array::from_fn(|axis| upper[axis].max(point[axis])),
        ]
    })
}

/// The faces below and above the median along the longest direction of their centroids; ties by index.
fn halves<'f>(faces: &'f mut [usize], centroids: &[[f64; 3]]) -> (&'f mut [usize], &'f mut [usize]) {
    let [lower, upper] = around(faces.iter().map(|face| centroids[*face]));
    let extent = minus(upper, lower);
    let axis = (1..3).fold(0, |longest, axis| if extent[axis] > extent[longest] { axis } else { longest });
    let middle = faces.len() / 2;
    faces.select_nth_unstable_by(middle, |one, other| {
        centroids[*one][axis].total_cmp(&centroids[*other][axis]).then(one.cmp(other))
    });
    faces.split_at_mut(middle)
}

/// The point of a triangle nearest to a given point: its foot on the plane if that is inside, else a point on an edge that
/// it lies beyond. Triangles may be degenerate (segments or points).
///
/// # Source
/// The regions of Ericson 2005, Real-Time Collision Detection, section 5.1.5. Ericson's weights are differences of products
/// of two scalar products, which lose digits with the square of the ratio of distance to triangle size; the weights here
/// lose them with the ratio itself. Ericson's quotients along the edges are 0/0 on some segments; here the nearest point
/// of every candidate edge is used.
fn on_triangle(point: [f64; 3], corners: [[f64; 3]; 3]) -> Place {
    let (weights, thin) = under(point, corners);
    let [a, b, c] = corners;
    let inside = weights.iter().all(|weight| *weight >= 0.0).then(|| {
        let at = |axis: usize| a[axis] + weights[1] * (b[axis] - a[axis]) + weights[2] * (c[axis] - a[axis]);
        Place::new(point, [at(0), at(1), at(2)], weights)
    });
    // The nearest point of a convex shape lies on a side facing the given point: opposite to a negative weight.
    let edges = (0..3)
        .filter(|opposite| thin || weights[*opposite] < 0.0)
        .map(|opposite| on_edge(point, corners, (opposite + 1) % 3, (opposite + 2) % 3));
    let nearer = |one: Place, other: Place| if other.square < one.square { other } else { one };
    inside.into_iter().chain(edges).reduce(nearer).unwrap_or_else(|| on_edge(point, corners, 0, 1))
}

/// Barycentric coordinates of the foot on the plane of a triangle, and whether the triangle is so thin that they are
/// unreliable or not finite.
///
/// ```text
/// n = u × v,   w₁ = ⟨n, x × v⟩ / |n|²,   w₂ = ⟨n, u × x⟩ / |n|²      u = b − a, v = c − a, x = p − a
/// ```
fn under(point: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> ([f64; 3], bool) {
    let (u, v) = (minus(b, a), minus(c, a));
    // In units of the triangle size nothing overflows.
    let largest = |w: [f64; 3]| w[0].abs().max(w[1].abs()).max(w[2].abs());
    let unit = 1.0 / largest(u).max(largest(v));
    let scaled = |[x, y, z]: [f64; 3]| [unit * x, unit * y, unit * z];
    let (u, v, x) = (scaled(u), scaled(v), scaled(minus(point, a)));
    let normal = cross(u, v);
    let square = dot(normal, normal);
    let (second, third) = (dot(normal, cross(x, v)) / square, dot(normal, cross(u, x)) / square);
    let thick = square > SLIVER * SLIVER * dot(u, u) * dot(v, v);
    ([1.0 - second - third, second, third], !thick)
}

/// The nearest point on the edge between two corners of a triangle. The edge always runs from its lesser to its greater
/// end, so both of its faces get the same bits.
fn on_edge(point: [f64; 3], corners: [[f64; 3]; 3], from: usize, to: usize) -> Place {
    let (from, to) = if corners[from] <= corners[to] { (from, to) } else { (to, from) };
    let (a, b) = (corners[from], corners[to]);
    let along = minus(b, a);
    let t = dot(minus(point, a), along) / dot(along, along);
    let mut weights = [0.0; 3];
    // An edge of length zero has t = 0/0 and yields its first corner.
    let foot = if t >= 1.0 {
        weights[to] = 1.0;
        b
    } else if t > 0.0 {
        (weights[from], weights[to]) = (1.0 - t, t);
        [a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]]
    } else {
        weights[from] = 1.0;
        a
    };
    Place::new(point, foot, weights)
}

impl Place {
    fn new(from: [f64; 3], point: [f64; 3], weights: [f64; 3]) -> Self {
        let way = minus(from, point);
        Self { weights, point, square: dot(way, way) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::norm;

    /// Deterministic uniform numbers in [0, 1) (splitmix64).
    fn uniform(state: &mut u64) -> f64 {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn random(state: &mut u64) -> [f64; 3] {
        [0; 3].map(|_| 2.0 * uniform(state) - 1.0)
    }

    /// Brute force over all faces; the first of the nearest.
    fn brute(vertices: &[[f64; 3]], faces: &[[u32; 3]], point: [f64; 3]) -> (usize, f64) {
        let square = |face: &[u32; 3]| on_triangle(point, face.map(|v| vertices[v as usize])).square;
        faces.iter().map(square).enumerate().fold((0, f64::INFINITY), |best, (face, square)| {
            if square < best.1 { (face, square) } else { best }
        })
    }

    /// Faces of all kinds: ordinary, with a corner twice or three times, with collinear corners, duplicated.
    fn soup(state: &mut u64) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let mut vertices: Vec<[f64; 3]> = (0..60).map(|_| random(state)).collect();
        vertices.extend((0..20).map(|i| [0.0, 0.1 * f64::from(i), 0.0]));
        let mut any = |count: u32, first: u32| first + (uniform(state) * f64::from(count)) as u32;
        let mut faces = Vec::new();
        for i in 0..200 {
            let [a, b, c] = [any(60, 0), any(60, 0), any(60, 0)];
            faces.push(match i % 10 {
                0 => [a, a, b],
                1 => [a; 3],
                2 => [any(20, 60), any(20, 60), any(20, 60)],
                3 => [c, a, c],
                _ => [a, b, c],
            });
            if i % 7 == 0 {
                faces.push(faces[i]);
            }
        }
        (vertices, faces)
    }

    #[test]
    fn the_tree_finds_what_a_look_at_every_face_finds() {
        let mut state = 5;
        for _ in 0..20 {
            let (vertices, faces) = soup(&mut state);
            let tree = NearestTriangles::new(&vertices, &faces);
            for query in 0..200 {
                let far = [0.5, 2.0, 1e6][query % 3];
                let point = if query % 10 == 9 {
                    vertices[query % vertices.len()]
                } else {
                    random(&mut state).map(|x| far * x)
                };
                let foot = tree.nearest(point).unwrap();
                let (face, square) = brute(&vertices, &faces, point);
                assert_eq!((foot.face, foot.distance), (face, square.sqrt()), "{point:?}");
                check(&vertices, &faces, point, &foot);
            }
        }
    }

    /// Checks that the weights give the point, and the point the distance.
    fn check(vertices: &[[f64; 3]], faces: &[[u32; 3]], point: [f64; 3], foot: &Foot) {
        let corners = faces[foot.face].map(|v| vertices[v as usize]);
        let made: [f64; 3] =
            std::array::from_fn(|axis| (0..3).map(|i| foot.weights[i] * corners[i][axis]).sum());
        assert!(norm(minus(made, foot.point)) < 1e-14, "{foot:?}");
        assert!((norm(minus(point, foot.point)) - foot.distance).abs() <= 1e-15 * foot.distance, "{foot:?}");
        let sum: f64 = foot.weights.iter().sum();
        assert!(foot.weights.iter().all(|w| *w >= 0.0) && (sum - 1.0).abs() < 4e-16, "{foot:?}");
    }

    /// No point of the triangle is nearer: neither on a fine lattice over it nor, to first order, in the direction of any
    /// corner, `⟨p − q, corner − q⟩ ≤ 0`.
    #[test]
    fn the_foot_on_a_triangle_is_the_nearest_place() {
        let mut state = 9;
        for trial in 0..2000 {
            let mut corners = [0; 3].map(|_| random(&mut state));
            if trial % 4 == 0 {
                // Nearly or exactly collinear.
                let [t, off] = [3.0 * uniform(&mut state) - 1.0, [0.0, 1e-16, 1e-12, 1e-5][trial / 4 % 4]];
                let shift = random(&mut state);
                corners[2] = std::array::from_fn(|axis| {
                    corners[0][axis] + t * (corners[1][axis] - corners[0][axis]) + off * shift[axis]
                });
            }
            let point = random(&mut state).map(|x| 2.0 * x);
            let place = on_triangle(point, corners);
            let way = minus(point, place.point);
            for corner in corners {
                let gain = dot(way, minus(corner, place.point));
                assert!(gain < 1e-7, "{gain:e} in trial {trial}: {corners:?}");
            }
            for (i, j) in (0..=20).flat_map(|i| (0..=20 - i).map(move |j| (i, j))) {
                let (s, t) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                let on = std::array::from_fn(|axis| {
                    (1.0 - s - t) * corners[0][axis] + s * corners[1][axis] + t * corners[2][axis]
                });
                let other = norm(minus(point, on));
                assert!(place.square.sqrt() <= other + 1e-14, "{} for {other}", place.square.sqrt());
            }
        }
    }

    #[test]
    fn every_region_of_a_triangle_has_its_foot() {
        let corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let cases = [
            ([1.0, 0.5, 3.0], [1.0, 0.5, 0.0], [0.5, 0.25, 0.25]),
            ([-1.0, -2.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
            ([9.0, 1.0, 0.0], [4.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
            ([-1.0, 3.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]),
            ([1.0, -3.0, 2.0], [1.0, 0.0, 0.0], [0.75, 0.25, 0.0]),
            ([-2.0, 0.5, 0.0], [0.0, 0.5, 0.0], [0.75, 0.0, 0.25]),
            ([3.0, 3.0, -1.0], [2.0, 1.0, 0.0], [0.0, 0.5, 0.5]),
        ];
        for (point, foot, weights) in cases {
            let found = NearestTriangles::new(&corners, &[[0, 1, 2]]).nearest(point).unwrap();
            assert!(norm(minus(found.point, foot)) < 1e-15, "{found:?}");
            assert!(norm(minus(found.weights, weights)) < 1e-15, "{found:?}");
        }
    }

    #[test]
    fn feet_on_common_edges_go_to_the_first_face() {
        let mut state = 21;
        for _ in 0..500 {
            // A roof: the ridge from 0 to 1, seen from above.
            let vertices = [random(&mut state), random(&mut state), [3.0, -3.0, -5.0], [-3.0, 3.0, -5.0]];
            let point = [0.1 * uniform(&mut state), 0.1 * uniform(&mut state), 9.0];
            let first = NearestTriangles::new(&vertices, &[[0, 1, 2], [1, 0, 3]]).nearest(point).unwrap();
            let turned = NearestTriangles::new(&vertices, &[[1, 0, 3], [2, 0, 1]]).nearest(point).unwrap();
            if first.weights[2] == 0.0 && turned.weights[2] == 0.0 {
                assert_eq!((first.face, turned.face), (0, 0));
            }
            assert_eq!((first.point, first.distance), (turned.point, turned.distance));
        }
    }

    #[test]
    fn scales_and_empty_meshes() {
        assert_eq!(NearestTriangles::new(&[], &[]).nearest([0.0; 3]), None);
        let corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        for scale in [1e-100, 1e100] {
            let corners = corners.map(|corner| corner.map(|x| scale * x));
            let faces = [[0, 1, 2]];
            let tree = NearestTriangles::new(&corners, &faces);
            let foot = tree.nearest([scale, 0.5 * scale, 3.0 * scale]).unwrap();
            assert!((foot.distance / scale - 3.0).abs() < 1e-15, "{foot:?}");
            assert!(norm(minus(foot.weights, [0.5, 0.25, 0.25])) < 1e-15, "{foot:?}");
            assert_eq!(tree.nearest([f64::NAN, 0.0, 0.0]), None);
        }
        // Far away the weights stay accurate.
        let foot = NearestTriangles::new(&corners, &[[0, 1, 2]]).nearest([1.0, 0.5, 1e12]).unwrap();
        assert!(norm(minus(foot.weights, [0.5, 0.25, 0.25])) < 1e-15, "{foot:?}");
    }
}
