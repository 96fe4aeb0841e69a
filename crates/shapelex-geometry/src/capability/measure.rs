//! Measures of shapes: those that the shape has, its distances to a reference, and warnings about the numbers.

use super::tessellate::Detail;
use crate::curve::Curve;
use crate::distance::{Distances, STRETCHES, symmetric, symmetric_nodes};
use crate::intersection::self_intersects;
use crate::measures::CurveMeasures;
use crate::mesh::TriangleMesh;
use crate::mesh_tree::NearestTriangles;
use crate::quality::{MAX_FACES, MeshQuality, coarse_rounding, rounding_warning};
use crate::representation::{Representation, ShapeSpace};
use crate::subdivision::measures::{coarse_faces, measure};
use crate::surface::Surface;
use crate::surface::basis::Extent;
use crate::surface::field::VectorField;
use crate::surface::measures::{SurfaceMeasures, flux};
use crate::vector::{cross, dot, far_origin, minus};
use shapelex_numeric::bounded::Stop;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kernels;
use shapelex_numeric::quadrature::GaussLegendre;

/// Measures of one shape, as far as it has them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Measures {
    /// Length, curvature, enclosed area: of curves.
    pub line: Option<CurveMeasures>,
    /// Area, enclosed volume: of surfaces.
    pub sheet: Option<SurfaceMeasures>,
    /// Whether the shape intersects itself; `None` for curves in space, and if undecided.
    pub self_intersecting: Option<bool>,
    /// Flux of the field through a surface, if one is given and the result is finite.
    pub flux: Option<f64>,
    /// Distances to the reference, if there is one.
    pub distances: Option<ReferenceDistances>,
    /// Limitations of the numbers.
    pub warnings: Vec<String>,
}

/// Distances of two shapes, in the unit of their points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceDistances {
    /// `L₂` distance as functions of the parameters.
    pub l2: f64,
    /// Distances as sets of points; curves only.
    pub as_sets: Option<SetDistances>,
}

/// Distances of two shapes as sets of points, in the unit of their points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetDistances {
    /// Root mean square distance to the other shape, over both directions.
    pub symmetric: f64,
    /// Largest distance to the other shape, over both directions.
    pub hausdorff: f64,
}

/// Prepared measures of the shapes of one space.
#[derive(Debug)]
pub struct Measuring<'a> {
    space: &'a ShapeSpace,
    reference: Option<Reference>,
    field: Option<VectorField>,
    /// Number of stretches that the distances of one curve may examine.
    stretches: usize,
}

#[derive(Debug)]
enum Reference {
    Curve(Curve),
    ControlPoints(Matrix),
}

impl<'a> Measuring<'a> {
    /// Prepares measures of `count` shapes, with distances to `reference` and, for surfaces, the flux of `field`.
    pub fn new(
        space: &'a ShapeSpace,
        reference: Option<Matrix>,
        field: Option<VectorField>,
        count: usize,
    ) -> Self {
        let reference = reference.map(|control_points| match Curve::of(space, &control_points) {
            Some(curve) => Reference::Curve(curve),
            None => Reference::ControlPoints(control_points),
        });
        Self { space, reference, field, stretches: STRETCHES / count.max(1) }
    }

    /// Measures the shape with these control points; `None` if `stop` returns true before the measures of a curve or a spline
    /// surface are complete. Cost: that of [`CurveMeasures`], [`SurfaceMeasures`] or the mesh of the level, and of [`Distances`].
    pub fn measure(&self, control_points: &Matrix, stop: Stop<'_>) -> Option<Measures> {
        if let Some(curve) = Curve::of(self.space, control_points) {
            return self.measure_curve(&curve, stop);
        }
        let measures = match self.space.surface() {
            Some(basis) => from_surface(&basis.surface(control_points), self.field.as_ref(), stop)?,
            None => match self.space.refined_mesh(control_points, Detail::Whole) {
                Some(mesh) => Measures::from_mesh(
                    &mesh,
                    self.space.representation().splits(),
                    self.field.as_ref(),
                    stop,
                ),
                None => Measures::default(),
            },
        };
        Some(Measures { distances: self.distances_of(control_points), ..measures })
    }

    fn measure_curve(&self, curve: &Curve, stop: Stop<'_>) -> Option<Measures> {
        let distances = match &self.reference {
            Some(Reference::Curve(reference)) => {
                Some(Distances::unless_stopped(curve, reference, self.stretches, stop)?)
            }
            _ => None,
        };
        let measures = CurveMeasures::unless_stopped(curve, stop)?;
        Some(Measures {
            self_intersecting: (curve.dimension() == 2).then(|| self_intersects(curve)),
            warnings: curve_warnings(&measures, distances.as_ref()),
            line: Some(measures),
            distances: distances.map(|Distances { l2, symmetric, hausdorff, .. }| ReferenceDistances {
                l2,
                as_sets: Some(SetDistances { symmetric, hausdorff }),
            }),
            ..Measures::default()
        })
    }

    fn distances_of(&self, control_points: &Matrix) -> Option<ReferenceDistances> {
        let Some(Reference::ControlPoints(reference)) = &self.reference else { return None };
        let l2 = self.space.distance(control_points, reference);
        Some(ReferenceDistances { l2, as_sets: None })
    }
}

impl ShapeSpace {
    /// `L₂` distance of two shapes, `√⟨a − b, a − b⟩`. Cost: one application of the Gram operator.
    pub fn distance(&self, a: &Matrix, b: &Matrix) -> f64 {
        self.norm(&(a - b))
    }

    /// Root mean square distance of two shapes (`N × d` control points) as sets of points, over both directions, in the unit of their
    /// points; `None` for landmarks. Curves: to about 1e-4 for outlines near each other; surfaces: from the vertices of one mesh to the
    /// other mesh, weighted by area. Cost: `O(M²)` box tests of curves, `O(V log F)` of surfaces.
    pub fn set_distance(&self, a: &Matrix, b: &Matrix) -> Option<f64> {
        if let (Some(a), Some(b)) = (Curve::of(self, a), Curve::of(self, b)) {
            return Some(symmetric(&a, &b));
        }
        let grid = self.representation().extent().map(Extent::usual_grid);
        let mesh = |shape: &Matrix| match self.refined_mesh(shape, Detail::Drawn) {
            Some(mesh) => Some(mesh),
            None => self.tessellate(shape, grid),
        };
        let (a, b) = (mesh(a)?, mesh(b)?);
        Some((0.5 * (mean_square(&a, &b) + mean_square(&b, &a))).sqrt())
    }

    /// Work of [`Self::set_distance`], in multiply-adds: measured, to a factor of 1.5 for curves near each other. Zero for landmarks.
    pub fn set_distance_work(&self) -> f64 {
        const POINT_TO_CURVE: f64 = 1500.0;
        const POINT_TO_MESH: f64 = 140.0;
        let vertices = match self.representation() {
            Representation::ClosedCurve { control_points: segments, .. }
            | Representation::OpenCurve { intervals: segments, .. } => {
                let halves = 2 * segments;
                return 2.0 * POINT_TO_CURVE * (halves * symmetric_nodes(halves)) as f64;
            }
            Representation::Landmarks { .. } => return 0.0,
            Representation::Surface { .. } => {
                let grid = self.representation().extent().map(Extent::usual_grid);
                grid.map_or(0, |[u, v]| u * v)
            }
            Representation::Subdivision(subdivision) => {
                let level = self.subdivision().map_or(0, |basis| basis.level_with(MAX_FACES));
                subdivision.connectivity.size().split(level).vertices
            }
        };
        let vertices = vertices as f64;
        2.0 * POINT_TO_MESH * vertices * (2.0 * vertices).log2()
    }

    /// `L₂` norm of control points, `√⟨c, c⟩`. Cost: one application of the Gram operator.
    pub fn norm(&self, control_points: &Matrix) -> f64 {
        let mut image = control_points.clone();
        self.gram().apply(image.as_mut_slice());
        kernels::dot(control_points.as_slice(), image.as_slice()).max(0.0).sqrt()
    }
}

/// Mean squared distance from the vertices of a mesh, weighted by the area around them, to another mesh.
fn mean_square(from: &TriangleMesh, to: &TriangleMesh) -> f64 {
    let mut areas = vec![0.0; from.vertices.len()];
    for face in &from.faces {
        let [a, b, c] = face.map(|corner| from.vertices[corner as usize]);
        let normal = cross(minus(b, a), minus(c, a));
        let third = dot(normal, normal).sqrt() / 6.0;
        face.iter().for_each(|corner| areas[*corner as usize] += third);
    }
    let tree = NearestTriangles::new(&to.vertices, &to.faces);
    let squares = from.vertices.iter().zip(&areas).map(|(vertex, area)| {
        let foot = tree.nearest(*vertex);
        area * foot.map_or(0.0, |foot| foot.distance.powi(2))
    });
    squares.sum::<f64>() / areas.iter().sum::<f64>()
}

impl Measures {
    /// Measures of a closed mesh that was split `splits` times, with the flux of `field`.
    pub fn from_mesh(
        mesh: &TriangleMesh,
        splits: usize,
        field: Option<&VectorField>,
        stop: Stop<'_>,
    ) -> Self {
        let measures = measure(mesh, splits > 0);
        let quality = mesh_quality(mesh, splits, &measures, stop);
        Self::from_sheet(measures, quality, field.map(|field| mesh_flux(mesh, field)))
    }

    fn from_sheet(measures: SurfaceMeasures, quality: MeshQuality, flux: Option<f64>) -> Self {
        Self {
            sheet: Some(measures),
            self_intersecting: quality.self_intersecting,
            flux: flux.filter(|flux| flux.is_finite()),
            warnings: quality.warnings(),
            ..Self::default()
        }
    }
}

fn from_surface(surface: &Surface, field: Option<&VectorField>, stop: Stop<'_>) -> Option<Measures> {
    let measures = SurfaceMeasures::unless_stopped(surface, stop)?;
    let quality = surface_quality(surface, &measures, stop);
    let found = Measures::from_sheet(measures, quality, field.map(|field| flux(surface, field, stop)));
    (!stop()).then_some(found)
}

/// Outward flux `Σ_f ∫_f ⟨F, n⟩ dA` through a mesh, exact: at the centroids of the faces for degree 1, else by a Gauss rule on the
/// square that is collapsed to the triangle, `∫∫ s F(a + s(b − a) + st(c − b)) ds dt`. A mesh far from the origin is measured about a
/// point near it. Cost: a value of the field per face, `((D + 3)/2)²` of them for the degree `D > 1`.
pub fn mesh_flux(mesh: &TriangleMesh, field: &VectorField) -> f64 {
    let origin = far_origin(mesh.vertices.iter()).filter(|_| field.degree() > 1);
    let field = &origin.map_or_else(|| field.clone(), |origin| field.about(origin));
    let origin = origin.unwrap_or_default();
    let rule: Vec<(f64, f64)> = GaussLegendre::new((field.degree() + 3) / 2).points().collect();
    let half = |(x, weight): &(f64, f64)| (0.5 + 0.5 * x, 0.5 * weight);
    let through = |(face, normal): (&[u32; 3], [f64; 3])| {
        let [a, b, c] = face.map(|vertex| minus(mesh.vertices[vertex as usize], origin));
        if field.degree() <= 1 {
            let centre = [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0);
            return 0.5 * dot(field.value(centre), normal);
        }
        let (ab, bc) = (minus(b, a), minus(c, b));
        let mut sum = 0.0;
        for (s, outer) in rule.iter().map(half) {
            for (t, inner) in rule.iter().map(half) {
                let point = [0, 1, 2].map(|i| a[i] + s * (ab[i] + t * bc[i]));
                sum += outer * inner * s * dot(field.value(point), normal);
            }
        }
        sum
    };
    mesh.faces.iter().zip(mesh.face_normals()).map(through).sum()
}

/// Usual relative accuracy of lengths and distances of curves; only a lower accuracy causes a warning.
const USUAL_ACCURACY: f64 = 1e-8;

fn curve_warnings(measures: &CurveMeasures, distances: Option<&Distances>) -> Vec<String> {
    let (low, high) = &measures.bounding_box;
    let extent = low.iter().zip(high).map(|(low, high)| high - low).fold(0.0, f64::max);
    let largest = low.iter().chain(high).fold(0.0_f64, |most, value| most.max(value.abs()));
    let mut warnings: Vec<String> =
        coarse_rounding(extent, largest).map(rounding_warning).into_iter().collect();
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
pub fn mesh_quality(
    mesh: &TriangleMesh,
    splits: usize,
    measures: &SurfaceMeasures,
    stop: Stop<'_>,
) -> MeshQuality {
    let faces = coarse_faces(mesh, splits, MAX_FACES);
    MeshQuality::of(mesh, (volume_of(measures), measures.area), &faces, stop)
}

/// Warnings of a closed mesh that was not split.
pub fn mesh_warnings(mesh: &TriangleMesh, stop: Stop<'_>) -> Vec<String> {
    mesh_quality(mesh, 0, &measure(mesh, false), stop).warnings()
}

/// Minimum and maximum number of cells along each direction of the mesh that represents a surface.
const CELLS: [usize; 2] = [8, 48];

/// Quality of a surface, checked on a mesh with one cell per interval between knots, at least 8 and at most 48 per
/// direction.
fn surface_quality(surface: &Surface, measures: &SurfaceMeasures, stop: Stop<'_>) -> MeshQuality {
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
