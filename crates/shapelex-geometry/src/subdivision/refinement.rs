//! Refinement of one mesh or polyline to a level or a tolerance.
//!
//! A level is close to its limit if its new vertices are close to the edges of the previous level. For smooth shapes this
//! distance falls by a factor of four per level, so the remaining distance is about a third of it.

use super::limit::{Limit, limit};
use super::normal_based::{Oriented, refine_edges, refine_polyline};
use super::stencil::{check_valences, refined as placed};
use super::{MeshSize, Scheme};
use crate::GeometryError;
use crate::edge_fault::EdgeFault;
use crate::mesh::{Connectivity, TriangleMesh};
use crate::vector::{cross, minus, norm};
use shapelex_numeric::bounded::{Stop, never};

/// Depth of a refinement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth {
    /// A fixed number of steps.
    Level(usize),
    /// Until the distance of the vertices of a level from the edges of the previous level is within this; at least one step.
    Tolerance(f64),
}

/// A refined shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined<T> {
    /// The refined shape.
    pub shape: T,
    /// Number of steps.
    pub level: usize,
    /// Largest distance of its vertices from their places on the edges of the previous level; `None` at level 0.
    pub change: Option<f64>,
}

impl Depth {
    /// Whether the requested depth is reached.
    fn reached(self, level: usize, change: Option<f64>) -> bool {
        match self {
            Self::Level(wanted) => level >= wanted,
            Self::Tolerance(tolerance) => change.is_some_and(|change| change <= tolerance),
        }
    }

    /// Checks the number of vertices of a shape at a level against the limit `most`.
    fn check(
        self,
        level: usize,
        vertices: usize,
        most: usize,
        change: Option<f64>,
    ) -> Result<(), GeometryError> {
        match self {
            _ if vertices <= most => Ok(()),
            Self::Level(_) => Err(GeometryError::TooFine { level, vertices, most }),
            Self::Tolerance(tolerance) => {
                let change = change.unwrap_or(f64::INFINITY);
                Err(GeometryError::Coarse { tolerance, level: level.saturating_sub(1), change, most })
            }
        }
    }
}

/// As [`refine_mesh_until`], without cancellation.
///
/// # Errors
/// As for [`refine_mesh_until`].
pub fn refine_mesh(
    scheme: Scheme,
    mesh: TriangleMesh,
    depth: Depth,
    most: usize,
    wanted_limit: bool,
) -> Result<(Refined<TriangleMesh>, Option<Limit>), GeometryError> {
    refine_mesh_until(scheme, mesh, depth, most, wanted_limit, &never)
}

/// Refines a mesh to at most `most` vertices; under the normal-based scheme, together with its normals. It must be closed for the
/// schemes without rules for boundaries. The number of vertices is checked before any step. With `wanted_limit`, also returns
/// the limit of the last level. Once `stop` returns true, the current level is returned.
///
/// # Errors
/// Faces that do not form such a mesh; vertices and edges without a rule; limits and tolerances that cannot be met.
pub fn refine_mesh_until(
    scheme: Scheme,
    mesh: TriangleMesh,
    depth: Depth,
    most: usize,
    wanted_limit: bool,
    stop: Stop<'_>,
) -> Result<(Refined<TriangleMesh>, Option<Limit>), GeometryError> {
    let mut size = MeshSize::of(mesh.vertices.len(), &mesh.faces);
    if let Depth::Level(level) = depth {
        // The limit of BLOB is computed one level further on.
        let last = size.split(level.saturating_add(usize::from(wanted_limit)));
        depth.check(level, last.vertices, most, None)?;
    }
    let TriangleMesh { vertices, normals, faces } = mesh;
    let count = vertices.len();
    let mut shape = Oriented { points: vertices, normals: normals.unwrap_or_default() };
    let mut connectivity = scheme.connectivity(count, faces)?;
    check_valences(scheme, &connectivity)?;
    let (mut level, mut change, mut parameters) = (0, None, scheme.parameters());
    let mut v = parameters.next().unwrap_or(1.0);
    let mut last_faces = None;
    while !depth.reached(level, change) && !stop() {
        depth.check(level + 1, size.split(1 + usize::from(wanted_limit)).vertices, most, change)?;
        let finer = match scheme {
            Scheme::NormalBased { balance } => {
                let sides = |edge| face_normals(&shape.points, &connectivity, edge);
                let fault = |(edge, fault)| edge_error(level, connectivity.edges()[edge], fault);
                refine_edges(&shape, connectivity.edges(), sides, balance.get()).map_err(fault)?
            }
            _ => {
                let points = placed(scheme, v, &connectivity, &shape.points);
                Oriented { points, normals: Vec::new() }
            }
        };
        change = Some(largest_change(&shape.points, &finer.points, connectivity.edges()));
        (shape, level, v) = (finer, level + 1, parameters.next().unwrap_or(1.0));
        size = size.split(1);
        if !wanted_limit && matches!(depth, Depth::Level(last) if last == level) {
            // Only the faces of the last mesh are needed.
            last_faces = Some(connectivity.split_faces());
        } else {
            connectivity = connectivity.split();
        }
    }
    let limit = match scheme {
        _ if !wanted_limit => None,
        Scheme::NormalBased { .. } => {
            Some(Limit { points: shape.points.clone(), normals: Some(shape.normals.clone()) })
        }
        _ => Some(limit(scheme, v, &connectivity, &shape.points)),
    };
    let normals = Some(shape.normals).filter(|normals| !normals.is_empty());
    let faces = last_faces.unwrap_or_else(|| connectivity.faces().to_vec());
    Ok((Refined { shape: TriangleMesh { vertices: shape.points, normals, faces }, level, change }, limit))
}

/// A polyline with normals, for the normal-based scheme.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Polyline {
    /// Points with unit normals.
    pub shape: Oriented,
    /// Whether the last point is connected to the first.
    pub closed: bool,
    /// Binormals of the edges, of any length, for those whose normals define none; zero where there is none. All their parts have
    /// them too. Empty: none.
    pub binormals: Vec<[f64; 3]>,
}

impl Polyline {
    /// Number of edges of a polyline of `count` points.
    fn edges(&self, count: usize) -> usize {
        if self.closed { count } else { count.saturating_sub(1) }
    }

    /// The edges, by their ends.
    pub fn ends(&self) -> impl Iterator<Item = [usize; 2]> {
        let count = self.shape.points.len();
        (0..self.edges(count)).map(move |i| [i, (i + 1) % count])
    }
}

/// Refines a polyline by the normal-based scheme, to at most `most` points.
///
/// # Errors
/// Edges that cannot be split; limits and tolerances that cannot be met.
pub fn refine_curve(
    polyline: Polyline,
    balance: f64,
    depth: Depth,
    most: usize,
    stop: Stop<'_>,
) -> Result<Refined<Oriented>, GeometryError> {
    let finer_count = |count: usize| count.saturating_add(polyline.edges(count));
    if let Depth::Level(level) = depth {
        let mut count = polyline.shape.points.len();
        for _ in 0..level.min(usize::BITS as usize) {
            count = finer_count(count);
        }
        depth.check(level, count, most, None)?;
    }
    let (mut level, mut change, mut shape) = (0, None, polyline.shape.clone());
    while !depth.reached(level, change) && !stop() {
        let count = shape.points.len();
        depth.check(level + 1, finer_count(count), most, change)?;
        let of_edge = |i: usize| [i as u32, ((i + 1) % count) as u32];
        let fault = |(edge, fault)| edge_error(level, of_edge(edge), fault);
        // Edge `i` of a level is part of edge `i/2` of the level before.
        let binormal = |i: usize| polyline.binormals.get(i >> level).copied().unwrap_or_default();
        let finer = refine_polyline(&shape, polyline.closed, balance, binormal).map_err(fault)?;
        let apart = (0..polyline.edges(count)).map(|i| {
            let [a, b] = of_edge(i).map(|vertex| shape.points[vertex as usize]);
            norm(minus(finer.points[2 * i + 1], middle(a, b)))
        });
        change = Some(apart.fold(0.0, f64::max));
        (shape, level) = (finer, level + 1);
    }
    Ok(Refined { shape, level, change })
}

fn edge_error(level: usize, edge: [u32; 2], fault: EdgeFault) -> GeometryError {
    GeometryError::Edge { level, edge, fault }
}

fn middle(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| 0.5 * (a[c] + b[c]))
}

/// Sum of the unit normals of the two faces at an edge; on the boundary, twice that of its face.
fn face_normals(points: &[[f64; 3]], connectivity: &Connectivity, edge: usize) -> [f64; 3] {
    let normal = |half_edge: u32| {
        let [a, b, c] = connectivity.faces()[half_edge as usize / 3].map(|vertex| points[vertex as usize]);
        let normal = cross(minus(b, a), minus(c, a));
        let length = norm(normal);
        if length > 0.0 { normal.map(|x| x / length) } else { [0.0; 3] }
    };
    let [first, second] = connectivity.sides(edge).map(normal);
    [0, 1, 2].map(|c| first[c] + second[c])
}

fn largest_change(before: &[[f64; 3]], after: &[[f64; 3]], edges: &[[u32; 2]]) -> f64 {
    let middles = edges.iter().map(|[a, b]| middle(before[*a as usize], before[*b as usize]));
    let flat = before.iter().copied().chain(middles);
    after.iter().zip(flat).map(|(after, flat)| norm(minus(*after, flat))).fold(0.0, f64::max)
}
