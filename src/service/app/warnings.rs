//! What an answer says beside its numbers when these do not hold what they seem to.

use super::error::MAX_FAULTS;
use crate::geometry::distance::Distances;
use crate::geometry::measures::CurveMeasures;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::quality::{MOST_FACES, MeshQuality};
use crate::geometry::subdivision::measures::{coarse_faces, measure};
use crate::geometry::surface::Surface;
use crate::geometry::surface::measures::SurfaceMeasures;
use crate::numeric::bounded::Stop;

/// Accuracy that lengths and distances of curves have, relative to the extent; less is said.
const USUAL_ACCURACY: f64 = 1e-8;

/// Of a curve that was measured.
pub(crate) fn of_curve(measures: &CurveMeasures, distances: Option<&Distances>) -> Vec<String> {
    let (low, high) = &measures.bounding_box;
    let extent = low.iter().zip(high).map(|(low, high)| high - low).fold(0.0, f64::max);
    let mut warnings = Vec::new();
    if measures.length_error > USUAL_ACCURACY * measures.length {
        warnings.push(format!("length is accurate to {:.1e} only", measures.length_error));
    }
    if let Some(distances) = distances
        && distances.accuracy > USUAL_ACCURACY * extent.max(distances.hausdorff)
    {
        let detail = "points are almost equally far from long stretches, or coordinates have no more digits";
        let accuracy = distances.accuracy;
        warnings.push(format!("symmetric_l2 and hausdorff are accurate to {accuracy:.1e} only: {detail}"));
    }
    warnings
}

/// Of a mesh that was split so many times; for intersections at its finest level with at most [`MOST_FACES`] faces.
pub(crate) fn of_split_mesh(
    mesh: &TriangleMesh,
    splits: usize,
    measures: &SurfaceMeasures,
    stop: Stop<'_>,
) -> MeshQuality {
    let faces = coarse_faces(mesh, splits, MOST_FACES);
    MeshQuality::of(mesh, (volume_of(measures), measures.area), &faces, stop)
}

/// Of a closed mesh as it was posted.
pub(crate) fn of_posted_mesh(mesh: &TriangleMesh, stop: Stop<'_>) -> Vec<String> {
    of_split_mesh(mesh, 0, &measure(mesh, false), stop).warnings()
}

/// Cells along a direction of the mesh on which a surface is looked at.
const CELLS: [usize; 2] = [8, 48];

/// Of a surface, for what is wrong with the mesh of one cell for every interval between knots, at least 8 and at most 48.
pub(crate) fn of_surface(surface: &Surface, measures: &SurfaceMeasures, stop: Stop<'_>) -> MeshQuality {
    let closed = surface.topology().closed();
    let count = [0, 1].map(|i| {
        // Behind a half turn there must be an even number.
        let cells = surface.intervals(i).clamp(CELLS[0], CELLS[1]).next_multiple_of(2);
        cells + usize::from(!closed[i])
    });
    let mut mesh = surface.tessellate(count);
    mesh.normals = None;
    let faces = if surface.is_orientable() { mesh.faces.clone() } else { Vec::new() };
    let quality = MeshQuality::of(&mesh, (volume_of(measures), measures.area), &faces, stop);
    // A surface with one side meets itself in space, or nothing is known of it.
    let decided = quality.self_intersecting.filter(|_| surface.is_orientable());
    MeshQuality { self_intersecting: decided, ..quality }
}

fn volume_of(measures: &SurfaceMeasures) -> Option<f64> {
    measures.enclosed.map(|enclosed| enclosed.signed_volume)
}

/// The warnings of the shapes of a request, with the index of each; at most [`MAX_FAULTS`].
pub fn by_shape<'a>(list: &str, shapes: impl Iterator<Item = &'a Vec<String>>) -> Vec<String> {
    let numbered = shapes.enumerate().flat_map(|(index, warnings)| {
        warnings.iter().map(move |warning| format!("/{list}/{index}: {warning}"))
    });
    numbered.take(MAX_FAULTS).collect()
}
