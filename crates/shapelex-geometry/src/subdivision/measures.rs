//! Measures of triangle meshes, closed ones and those with a boundary.
//!
//! ```text
//! V = ⅙ Σ_f det(a, b, c)     area = Σ_f |S_f|,  S_f = ½ (b − a) × (c − a)     centroid = Σ_f (det/6)(a + b + c)/4 / V
//! K_i = (2π − Σ angles)/A_i   2 H_i n_i = Σ_j ½ (cot α_ij + cot β_ij)(p_i − p_j)/A_i   κ = H ± √(H² − K)
//! ```
//!
//! `A_i` is the area closest to vertex `i` (Meyer, Desbrun, Schröder, Barr, *Discrete differential-geometry operators for
//! triangulated 2-manifolds*, 2003). Volumes, areas and centroids are exact for the mesh. A mesh with a boundary encloses no volume, and
//! has no curvature at the boundary.

use crate::mesh::TriangleMesh;
use crate::surface::measures::{EnclosedVolume, SurfaceMeasures};
use crate::vector::{bounds, cross, dot, minus, norm};

/// Ratio of the volume to that of the bounding box below which the volume is rounding.
const NO_VOLUME: f64 = 1e-12;

/// Measures a mesh. The mean position is taken over the parameters, of which every face has the same share. If the mesh
/// was split, the error of its area is estimated as a third of the area that the last split added, because areas converge by a factor
/// of four. Cost: linear.
pub fn measure(mesh: &TriangleMesh, was_split: bool) -> SurfaceMeasures {
    let bounding_box = bounds(mesh.vertices.iter().copied()).unwrap_or_default();
    let extent = (0..3).map(|c| bounding_box[1][c] - bounding_box[0][c]).fold(0.0, f64::max);
    // Cubes of coordinates overflow long before volumes do; a power of two changes no digits.
    let unit = if extent > 0.0 { 2.0_f64.powi(extent.log2().round() as i32) } else { 1.0 };
    let origin = mesh.vertices.first().copied().unwrap_or_default();
    let (mut volume, mut area) = (0.0, 0.0);
    let [mut by_volume, mut by_area, mut by_face] = [[0.0; 3]; 3];
    for face in &mesh.faces {
        let [a, b, c] = face.map(|vertex| minus(mesh.vertices[vertex as usize], origin).map(|x| x / unit));
        let cone = dot(a, cross(b, c)) / 6.0;
        let sheet = 0.5 * norm(cross(minus(b, a), minus(c, a)));
        volume += cone;
        area += sheet;
        for i in 0..3 {
            let sum = a[i] + b[i] + c[i];
            by_volume[i] += 0.25 * cone * sum;
            by_area[i] += sheet * sum / 3.0;
            by_face[i] += sum / 3.0;
        }
    }
    let back = |sum: [f64; 3], over: f64| [0, 1, 2].map(|c| origin[c] + unit * (sum[c] / over));
    let mean_position = back(by_face, mesh.faces.len().max(1) as f64);
    let before = was_split.then(|| surface_area(&mesh.vertices, &unsplit(&mesh.faces), unit));
    let area_error = before.map_or(0.0, |before| (area - before).abs() / 3.0);
    let spread: f64 = (0..3).map(|c| (bounding_box[1][c] - bounding_box[0][c]) / unit).product();
    let centroid = (volume.abs() > NO_VOLUME * spread).then(|| back(by_volume, volume));
    let closed = !on_boundary(mesh).contains(&true);
    SurfaceMeasures {
        enclosed: closed.then_some(EnclosedVolume { signed_volume: volume * unit * unit * unit, centroid }),
        area: area * unit * unit,
        area_error: area_error * unit * unit,
        lid_area: 0.0,
        sheet_centroid: if area > 0.0 { back(by_area, area) } else { mean_position },
        mean_position,
        bounding_box,
    }
}

/// Which vertices of a mesh are on its boundary. Around a vertex inside, every neighbour is once the next and once the last corner of
/// a face, so that the sum of their differences is zero; along the boundary, it is the difference of two neighbours. Cost: linear.
fn on_boundary(mesh: &TriangleMesh) -> Vec<bool> {
    let mut sums = vec![0_i64; mesh.vertices.len()];
    for &[a, b, c] in &mesh.faces {
        for [vertex, next, last] in [[a, b, c], [b, c, a], [c, a, b]] {
            sums[vertex as usize] += i64::from(next) - i64::from(last);
        }
    }
    sums.into_iter().map(|sum| sum != 0).collect()
}

/// The mesh before some of its last `splits` splits, as many as needed for at most `faces` faces; vertices keep their positions.
pub fn coarsened(mesh: &TriangleMesh, splits: usize, faces: usize) -> TriangleMesh {
    let coarse = coarse_faces(mesh, splits, faces);
    let count = coarse.iter().flatten().max().map_or(0, |most| *most as usize + 1);
    let kept = |list: &Vec<[f64; 3]>| list[..count].to_vec();
    TriangleMesh { vertices: kept(&mesh.vertices), normals: mesh.normals.as_ref().map(kept), faces: coarse }
}

/// The faces of a mesh before some of its last `splits` splits, as many as needed for at most `faces` faces.
pub fn coarse_faces(mesh: &TriangleMesh, splits: usize, faces: usize) -> Vec<[u32; 3]> {
    let mut coarse = mesh.faces.clone();
    for _ in 0..splits {
        if coarse.len() > faces {
            coarse = unsplit(&coarse);
        }
    }
    coarse
}

/// The faces before the last split.
fn unsplit(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    faces.chunks_exact(4).map(|parts| [parts[0][0], parts[1][1], parts[2][2]]).collect()
}

/// Area in units of `unit²`.
fn surface_area(vertices: &[[f64; 3]], faces: &[[u32; 3]], unit: f64) -> f64 {
    let of = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|vertex| vertices[vertex as usize]);
        let [p, q] = [b, c].map(|corner| minus(corner, a).map(|x| x / unit));
        0.5 * norm(cross(p, q))
    };
    faces.iter().map(of).sum()
}

/// Normal and principal curvatures at a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexFrame {
    /// Outward unit normal: the angle-weighted mean of the normals of the faces; `None` where these cancel.
    pub normal: Option<[f64; 3]>,
    /// Principal curvatures in 1/length, the larger first; negative where the surface bends away from its normal. `None` if the
    /// area is zero, and on the boundary.
    pub curvatures: Option<[f64; 2]>,
}

/// Sums over the faces at a vertex.
#[derive(Debug, Clone, Copy, Default)]
struct Corner {
    normal: [f64; 3],
    angle: f64,
    area: f64,
    /// `Σ_j ½ (cot α + cot β)(p_i − p_j)`.
    gradient: [f64; 3],
}

/// Normals and principal curvatures at all vertices of a mesh; no curvatures on its boundary. Cost: linear.
pub fn frames(mesh: &TriangleMesh) -> Vec<VertexFrame> {
    let mut corners = vec![Corner::default(); mesh.vertices.len()];
    for face in &mesh.faces {
        let points = face.map(|vertex| mesh.vertices[vertex as usize]);
        let normal = cross(minus(points[1], points[0]), minus(points[2], points[0]));
        let twice_area = norm(normal);
        if !(twice_area > 0.0) {
            continue;
        }
        let sides = [0, 1, 2].map(|i| minus(points[(i + 2) % 3], points[(i + 1) % 3]));
        // At corner `i`, between its two sides.
        let angles = [0, 1, 2].map(|i| {
            let (p, q) = (sides[(i + 2) % 3], sides[(i + 1) % 3].map(|x| -x));
            (twice_area.atan2(dot(p, q)), dot(p, q) / twice_area)
        });
        let obtuse = angles.iter().position(|(_, cotangent)| *cotangent < 0.0);
        for i in 0..3 {
            let corner = &mut corners[face[i] as usize];
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            corner.angle += angles[i].0;
            let area = match obtuse {
                Some(wide) if wide == i => twice_area / 4.0,
                Some(_) => twice_area / 8.0,
                None => (dot(sides[k], sides[k]) * angles[k].1 + dot(sides[j], sides[j]) * angles[j].1) / 8.0,
            };
            corner.area += area;
            for c in 0..3 {
                corner.normal[c] += angles[i].0 * normal[c] / twice_area;
                let towards = |other: usize| points[i][c] - points[other][c];
                corner.gradient[c] += 0.5 * (angles[k].1 * towards(j) + angles[j].1 * towards(k));
            }
        }
    }
    let inside = on_boundary(mesh).into_iter().map(|boundary| !boundary);
    corners.iter().zip(inside).map(|(corner, inside)| frame(corner, inside)).collect()
}

fn frame(corner: &Corner, inside: bool) -> VertexFrame {
    let length = norm(corner.normal);
    let normal = (length > 0.0).then(|| corner.normal.map(|x| x / length));
    let curvatures = normal.filter(|_| inside && corner.area > 0.0).map(|normal| {
        // The sign is relative to the outward normal, as on tensor-product surfaces: a sphere has −1/R.
        let mean = -0.5 * dot(corner.gradient, normal) / corner.area;
        let gauss = (std::f64::consts::TAU - corner.angle) / corner.area;
        let spread = (mean * mean - gauss).max(0.0).sqrt();
        [mean + spread, mean - spread]
    });
    VertexFrame { normal, curvatures: curvatures.filter(|both| both.iter().all(|x| x.is_finite())) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subdivision::control::StartMesh;

    fn sphere(text: &str, radius: f64, centre: [f64; 3]) -> TriangleMesh {
        let mut mesh = text.parse::<StartMesh>().unwrap().mesh();
        mesh.vertices.iter_mut().for_each(|p| *p = [0, 1, 2].map(|c| centre[c] + radius * p[c]));
        mesh
    }

    /// Errors of the geodesic octahedron as noted in the sources: 2.3e-2, 5.9e-3, 1.5e-3 of the volume, 1.3e-2, 3.2e-3, 8.0e-4
    /// of the area.
    #[test]
    fn volumes_and_areas_of_geodesic_spheres_converge() {
        for (text, volume, area) in [
            ("octahedron/3", 2.3e-2, 1.3e-2),
            ("octahedron/4", 5.9e-3, 3.2e-3),
            ("octahedron/5", 1.5e-3, 8.0e-4),
        ] {
            let measures = measure(&sphere(text, 1.0, [0.0; 3]), true);
            let part = |found: f64, wanted: f64| 1.0 - found / wanted;
            let found = part(measures.enclosed.unwrap().signed_volume, 4.0 / 3.0 * std::f64::consts::PI);
            assert!((found - volume).abs() < 0.03 * volume, "{text} {found}");
            let found = part(measures.area, 4.0 * std::f64::consts::PI);
            assert!((found - area).abs() < 0.04 * area, "{text} {found}");
            // The estimate agrees with the error to second order.
            let missing = 4.0 * std::f64::consts::PI - measures.area;
            assert!((measures.area_error / missing - 1.0).abs() < 0.1, "{text} {}", measures.area_error);
        }
    }

    #[test]
    fn measures_scale_and_centroids_move() {
        for unit in [1.0, 1e-90, 1e90] {
            let centre = [5.0 * unit, -unit, 0.25 * unit];
            let measures = measure(&sphere("octahedron/3", unit, centre), true);
            let one = measure(&sphere("octahedron/3", 1.0, [0.0; 3]), true);
            let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-13, "{a} {b}");
            near(measures.area, one.area * unit * unit);
            let [found, wanted] = [&measures, &one].map(|m| m.enclosed.unwrap());
            near(found.signed_volume, wanted.signed_volume * unit * unit * unit);
            for c in 0..3 {
                assert!((found.centroid.unwrap()[c] - centre[c]).abs() < 1e-13 * unit);
            }
        }
    }

    #[test]
    fn spheres_bend_by_their_radius_everywhere() {
        let mesh = sphere("icosahedron/4", 2.0, [1.0, 2.0, 3.0]);
        for (frame, vertex) in frames(&mesh).iter().zip(&mesh.vertices) {
            let outwards = minus(*vertex, [1.0, 2.0, 3.0]).map(|x| x / 2.0);
            // 1.2 degrees, the angle between neighbouring faces.
            assert!(norm(minus(frame.normal.unwrap(), outwards)) < 0.02);
            let [larger, smaller] = frame.curvatures.unwrap();
            // The mean is accurate to second order in the edge length; the spread is the root of a difference of that order.
            assert!((0.5 * (larger + smaller) + 0.5).abs() < 3e-3, "{larger} {smaller}");
            assert!(larger - smaller < 0.15, "{larger} {smaller}");
        }
    }
}
