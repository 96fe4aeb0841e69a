//! The same shape on another grid of knots, and meshes refined by a scheme.

use crate::GeometryError;
use crate::curve::Curve;
use crate::distance;
use crate::mesh::TriangleMesh;
use crate::quality::{MeshQuality, collapsed_edges};
use crate::refine::Refinement;
use crate::representation::{Representation, ShapeSpace};
use crate::subdivision::limit::Limit;
use crate::subdivision::measures::measure;
use crate::subdivision::normal_based::Oriented;
use crate::subdivision::oriented::corner_warning;
use crate::subdivision::refinement::{Depth, Refined, refine_mesh_until};
use crate::subdivision::{Scheme, edges_of};
use crate::surface::basis::SurfaceBasis;
use crate::surface::measures::{SurfaceMeasures, l2};
use crate::surface::refinement::SurfaceRefinement;
use crate::vector::{far_origin, norm, plus};
use shapelex_numeric::bounded::Stop;
use shapelex_numeric::dense::Matrix;

use super::measure::mesh_quality;
use super::sample::columns;
use super::tessellate::moved;

impl Representation {
    /// Whether its curves are refined by even factors only.
    pub fn needs_even_factors(&self) -> bool {
        self.generator().is_some_and(|generator| generator.needs_even_factors())
    }
}

impl Refinement {
    /// Control points on the finer grid and, if the refinement is not exact, the `L₂` distance to the original curve.
    pub fn apply_measured(&self, coarse: &ShapeSpace, control_points: &Matrix) -> (Matrix, Option<f64>) {
        let fine = self.apply(control_points);
        let change = (!self.is_exact()).then(|| {
            let curves = Curve::of(coarse, control_points).zip(Curve::of(self.space(), &fine));
            curves.map_or(0.0, |(before, after)| distance::l2(&before, &after))
        });
        (fine, change)
    }
}

/// Distance relative to the extent below which it counts as rounding.
const ROUNDING: f64 = 1e-12;

/// Surfaces of one size on the knots of another size: the same surfaces where both directions have two-scale relations, else
/// interpolated at the knots.
#[derive(Debug)]
pub struct Resizing<'a> {
    from: &'a SurfaceBasis,
    to: &'a SurfaceBasis,
    refinement: Option<SurfaceRefinement>,
}

/// A surface of another size.
#[derive(Debug, Clone)]
pub struct Resized {
    /// Its control points.
    pub control_points: Matrix,
    /// `L₂` distance to the original surface; `None` if the two are the same function.
    pub change: Option<f64>,
    /// Whether this distance is within rounding.
    pub exact: bool,
}

impl ShapeSpace {
    /// The representation of its surfaces with other numbers of intervals; `None` for shapes that are not surfaces with parameters.
    /// Generators are those of the two-scale relations where these lead to the finer grid, else of the same family; on multiples
    /// of the numbers they are those for the same functions of `u` and `v`.
    pub fn resized(&self, intervals: [usize; 2]) -> Option<Representation> {
        let basis = self.surface()?;
        let mut representation = self.representation().with_intervals(intervals);
        let Representation::Surface { generators, .. } = &mut representation else { return None };
        let from = basis.extent().intervals;
        let factors = [0, 1].map(|i| intervals[i].checked_div(from[i]).unwrap_or(0));
        if let Some(refinement) = SurfaceRefinement::new(basis, generators, intervals) {
            *generators = refinement.generators();
        } else if (0..2).all(|i| factors[i] > 0 && factors[i] * from[i] == intervals[i]) {
            *generators = [0, 1].map(|i| generators[i].refined(factors[i]));
        }
        Some(representation)
    }
}

impl<'a> Resizing<'a> {
    /// From surfaces of one space to those of another; `None` for shapes that are not surfaces with parameters.
    pub fn new(from: &'a ShapeSpace, to: &'a ShapeSpace) -> Option<Self> {
        let (basis, finer) = (from.surface()?, to.surface()?);
        let (Representation::Surface { generators, .. }, Representation::Surface { generators: wanted, .. }) =
            (from.representation(), to.representation())
        else {
            return None;
        };
        let refinement = SurfaceRefinement::new(basis, generators, finer.extent().intervals)
            .filter(|refinement| refinement.generators() == *wanted);
        Some(Self { from: basis, to: finer, refinement })
    }

    /// The shifts `δ_u`, `δ_v`: the original surface at `(u, v)` is the new one at `(u + δ_u, v + δ_v)`.
    pub fn shifts(&self) -> [f64; 2] {
        self.refinement.as_ref().map_or([0.0; 2], SurfaceRefinement::shifts)
    }

    /// The refined surface, or the one that interpolates it at the knots, with its tangents at the poles. Cost: the lengths of the
    /// filters for each control point, or one point per knot and the distance of the two.
    pub fn apply(&self, control_points: &Matrix) -> Resized {
        if let Some(refinement) = &self.refinement {
            let control_points = refinement.apply(self.from, self.to, control_points);
            return Resized { control_points, change: None, exact: true };
        }
        let (before, counts) = (self.from.surface(control_points), self.to.extent().grid());
        let [u, v] = [0, 1].map(|i| before.parameters(i, counts[i]));
        let points = before.points(&u, &v);
        let points = Matrix::from_vec(points.len(), 3, columns(&points, |point| *point));
        let rows = self.to.interpolate(&points, &self.from.tangents_of(control_points));
        let change = l2(&before, &self.to.surface(&rows));
        let extent = points.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
        Resized { control_points: rows, change: Some(change), exact: change <= ROUNDING * extent }
    }
}

/// A mesh refined by a scheme.
#[derive(Debug)]
pub struct RefinedMesh {
    /// The mesh, its level, and the displacement of its vertices by the last step.
    pub refined: Refined<TriangleMesh>,
    /// Limit positions of its vertices, if requested.
    pub limit: Option<Limit>,
    /// Volume and area.
    pub measures: SurfaceMeasures,
    /// Quality of the mesh.
    pub quality: MeshQuality,
    /// Defects of the mesh and of the control mesh.
    pub warnings: Vec<String>,
}

impl RefinedMesh {
    /// Refines a mesh to at most `most` vertices, about a point near the mesh if that is far from the origin.
    ///
    /// # Errors
    /// As for [`refine_mesh_until`].
    pub fn new(
        scheme: Scheme,
        mesh: TriangleMesh,
        depth: Depth,
        most: usize,
        wanted_limit: bool,
        stop: Stop<'_>,
    ) -> Result<Self, GeometryError> {
        let origin = far_origin(mesh.vertices.iter()).unwrap_or_default();
        let is_far = origin != [0.0; 3];
        let mesh = if is_far { moved(mesh, origin.map(|x| -x)) } else { mesh };
        let collapsed = collapsed_edges(&mesh, norm(origin));
        let corners = corners_of(scheme, &mesh);
        let (mut refined, mut limit) = refine_mesh_until(scheme, mesh, depth, most, wanted_limit, stop)?;
        let mut measures = measure(&refined.shape, refined.level > 0);
        if is_far {
            measures = measures.moved(origin);
            refined.shape = moved(refined.shape, origin);
            if let Some(limit) = &mut limit {
                limit.points.iter_mut().for_each(|point| *point = plus(*point, origin));
            }
        }
        let quality = mesh_quality(&refined.shape, refined.level, &measures, stop);
        let mut warnings = Vec::new();
        if collapsed > 0 && quality.collapsed_edges == 0 {
            warnings.push(format!("{collapsed} edges of the mesh have no length: vertices coincide"));
        }
        warnings.extend(corners);
        warnings.extend(quality.warnings());
        Ok(Self { refined, limit, measures, quality, warnings })
    }
}

/// Warning of the corners that edges of a control mesh make under the normal-based scheme.
fn corners_of(scheme: Scheme, mesh: &TriangleMesh) -> Option<String> {
    let (Scheme::NormalBased { balance }, Some(normals)) = (scheme, &mesh.normals) else { return None };
    mesh.check_faces().ok()?;
    let edges: Vec<[usize; 2]> =
        edges_of(&mesh.faces).into_iter().map(|edge| edge.map(|vertex| vertex as usize)).collect();
    let shape = Oriented { points: mesh.vertices.clone(), normals: normals.clone() };
    corner_warning(&shape, &edges, balance.get())
}
