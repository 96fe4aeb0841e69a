//! Warnings that accompany a result whose numbers are less accurate or less meaningful than they seem.

use super::faults::MAX_FAULTS;
use crate::geometry::distance::Distances;
use crate::geometry::measures::CurveMeasures;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::quality::{MAX_FACES, MeshQuality};
use crate::geometry::subdivision::measures::{coarse_faces, measure};
use crate::geometry::surface::Surface;
use crate::geometry::surface::measures::SurfaceMeasures;
use crate::numeric::bounded::Stop;

/// Usual relative accuracy of lengths and distances of curves; only a lower accuracy causes a warning.
const USUAL_ACCURACY: f64 = 1e-8;

/// Warnings of a measured curve.
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
        let detail =
            "the points are almost equally far from long stretches, or the coordinates have no more digits";
        let accuracy = distances.accuracy;
        warnings.push(format!("symmetric_l2 and hausdorff are accurate to {accuracy:.1e} only: {detail}"));
    }
    warnings
}

/// Quality of a mesh that was split `splits` times; intersections are searched at its finest level with at most
/// [`MAX_FACES`] faces.
pub(crate) fn of_split_mesh(
    mesh: &TriangleMesh,
    splits: usize,
    measures: &SurfaceMeasures,
    stop: Stop<'_>,
) -> MeshQuality {
    let faces = coarse_faces(mesh, splits, MAX_FACES);
    MeshQuality::of(mesh, (volume_of(measures), measures.area), &faces, stop)
}

/// Warnings of a closed mesh as posted.
pub(crate) fn of_posted_mesh(mesh: &TriangleMesh, stop: Stop<'_>) -> Vec<String> {
    of_split_mesh(mesh, 0, &measure(mesh, false), stop).warnings()
}

/// Minimum and maximum number of cells along each direction of the mesh that represents a surface.
const CELLS: [usize; 2] = [8, 48];

/// Quality of a surface, checked on a mesh with one cell per interval between knots, at least 8 and at most 48 per
/// direction.
pub(crate) fn of_surface(surface: &Surface, measures: &SurfaceMeasures, stop: Stop<'_>) -> MeshQuality {
    let closed = surface.topology().closed();
    let count = [0, 1].map(|i| {
        // The number of cells must be even if the direction closes with a half turn.
        let cells = surface.intervals(i).clamp(CELLS[0], CELLS[1]).next_multiple_of(2);
        cells + usize::from(!closed[i])
    });
    let mut mesh = surface.tessellate(count);
    mesh.normals = None;
    let faces = if surface.is_orientable() { mesh.faces.clone() } else { Vec::new() };
    let quality = MeshQuality::of(&mesh, (volume_of(measures), measures.area), &faces, stop);
    // A one-sided surface intersects itself in space, or the result is undecided.
    let decided = quality.self_intersecting.filter(|_| surface.is_orientable());
    MeshQuality { self_intersecting: decided, ..quality }
}

fn volume_of(measures: &SurfaceMeasures) -> Option<f64> {
    measures.enclosed.map(|enclosed| enclosed.signed_volume)
}

/// Warnings of the shapes of a request, each with the index of its shape; at most [`MAX_FAULTS`].
pub fn by_shape<'a>(list: &str, shapes: impl Iterator<Item = &'a Vec<String>>) -> Vec<String> {
    let numbered = shapes.enumerate().flat_map(|(index, warnings)| {
        warnings.iter().map(move |warning| format!("/{list}/{index}: {warning}"))
    });
    numbered.take(MAX_FAULTS).collect()
}
