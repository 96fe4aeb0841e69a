//! Subdivision of meshes and polylines.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::{Caller, Format, JsonBody, OnlyShapeFormat, ShapeFormat};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, mesh_file, picture, planned};
use crate::api::v1::requests::request_macros::checked;
use crate::geometry::capability::refine::RefinedMesh;
use crate::geometry::capability::tessellate::with_normals;
use crate::geometry::drawing::layer::{Layer, MAX_FACES};
use crate::geometry::drawing::{colour, layout};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::subdivision::control::StartMesh;
use crate::geometry::subdivision::measures::coarsened;
use crate::geometry::subdivision::refinement::Depth;
use crate::geometry::subdivision::{LoopWeights, Scheme, SchemeFields, SchemeName};
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests;
use crate::service::shapes::subdivide::{
    ControlMeshInput, PolylineInput, RefinedCurve, subdivide as refine, subdivide_named, subdivide_polyline,
};
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::shape::Points;

document! {
    /// A mesh or a polyline to refine.
    #[schema(example = json!({"scheme": "blob", "lambda": 1.5, "level": 2, "start": "octahedron"}))]
    pub(in crate::api::v1) struct SubdivideRequest {
        /// Subdivision scheme.
        #[schema(value_type = SchemeName, required = true)]
        scheme: Checked<SchemeName>, required;
        /// BLOB: `λ` between −π and π. Give exactly one of `lambda`, `lambda_imaginary` and `v0`.
        #[schema(value_type = Option<f64>)]
        lambda: Checked<f64>;
        /// BLOB: `μ` of an imaginary `λ = iμ`, between −13.8 and 13.8.
        #[schema(value_type = Option<f64>)]
        lambda_imaginary: Checked<f64>;
        /// BLOB: first level parameter, between 0 and 500.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0, exclusive_maximum = 500)]
        v0: Checked<f64>;
        /// Loop: vertex weights. Default: `original`.
        #[schema(value_type = Option<LoopWeights>)]
        weights: Checked<LoopWeights>;
        /// Butterfly: tension `w`. Default: 0.
        #[schema(value_type = Option<f64>, minimum = -0.125, maximum = 0.125)]
        tension: Checked<f64>;
        /// Normal-based: how strongly the weights of the two ends of an edge are balanced. Default: 0.
        #[schema(value_type = Option<f64>, minimum = 0, maximum = 1000)]
        balance: Checked<f64>;
        /// Number of subdivision steps. Give `level` or `tolerance`.
        #[schema(value_type = Option<usize>)]
        level: Checked<usize>;
        /// Subdivides until no vertex of a level is farther than this from the edges of the level before.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0)]
        tolerance: Checked<f64>;
        /// Mesh to refine: closed, or for `loop` and `normal_based` with a boundary. Give one of `mesh`, `start` and `polyline`.
        #[schema(value_type = Option<ControlMeshInput>)]
        mesh: ControlMeshInput;
        /// Named starting mesh on the unit sphere: `tetrahedron`, `octahedron`, `icosahedron`, or `sphere_grid`. A number after a slash
        /// says how often it is split first. `pole_grid` is deprecated here: it is read as `sphere_grid`, with a warning, and is another
        /// mesh as `connectivity` of a representation.
        #[schema(value_type = Option<String>)]
        start: Checked<String>;
        /// Polyline to refine, for the scheme `normal_based`.
        #[schema(value_type = Option<PolylineInput>)]
        polyline: PolylineInput;
        /// Whether to return the limit positions of the vertices of the level. Default: false.
        #[schema(value_type = Option<bool>)]
        limit: Checked<bool>;
    }
}

/// A refined mesh.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RefinedMeshOutput {
    /// Vertices, level by level: old ones first, then one per edge, edges in the lexicographic order of their ends.
    vertices: Vec<[f64; 3]>,
    /// Triangles. Face `(a, b, c)` becomes `(a, ab, ca)`, `(ab, b, bc)`, `(ca, bc, c)`, `(ab, bc, ca)`.
    faces: Vec<[u32; 3]>,
    /// Unit normals; only for the scheme `normal_based`.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<[f64; 3]>>,
}

/// A refined polyline.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RefinedPolylineOutput {
    /// Points: old ones at even indices, new ones between them.
    #[schema(value_type = Vec<Vec<f64>>)]
    points: Points,
    /// Unit normals, one per point.
    #[schema(value_type = Vec<Vec<f64>>)]
    normals: Points,
}

/// Limit of the vertices of a level.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct LimitOutput {
    /// Positions on the limit surface.
    vertices: Vec<[f64; 3]>,
    /// Unit normals of the limit surface, outwards, zero where it has none; null for the butterfly.
    normals: Option<Vec<[f64; 3]>>,
}

/// The refined mesh or polyline.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SubdivideAnswer {
    /// The refined mesh, if a mesh was refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    mesh: Option<RefinedMeshOutput>,
    /// The refined polyline, if a polyline was refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    polyline: Option<RefinedPolylineOutput>,
    /// Number of subdivision steps made.
    level: usize,
    /// Largest distance of the vertices from the edges of the level before; null at level 0. About a third of it remains
    /// between this level and the limit.
    change: Option<f64>,
    /// Volume enclosed by the mesh, positive if its faces are counter-clockwise seen from outside; absent for a mesh with a
    /// boundary.
    #[serde(skip_serializing_if = "Option::is_none")]
    volume: Option<f64>,
    /// Area of the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    area: Option<f64>,
    /// Whether the mesh intersects or overlaps itself, checked on its finest level with at most 20 000 faces; absent if
    /// undecided.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_intersecting: Option<bool>,
    /// Limit of the vertices, if `limit` is set.
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<LimitOutput>,
    /// Corrections made to the input, and suspicious properties of it.
    warnings: Vec<String>,
}

/// The input to refine.
enum Given {
    Mesh(ControlMeshInput),
    Start(StartMesh),
    Polyline(PolylineInput),
}

/// Refines a triangle mesh or a polyline by a subdivision scheme.
///
/// As SVG: a drawing. As OBJ, PLY, STL or glTF: the mesh with normals, or its limit if `limit` is set.
#[utoipa::path(post, path = "/v1/subdivide", tag = "curves", request_body = SubdivideRequest,
    params(ShapeFormatQuery, DrawingQuery),
    responses(
        (status = 200, description = "The refined mesh or polyline", content((SubdivideAnswer = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary")))
    ))]
pub(in crate::api::v1) async fn subdivide(
    Caller(app): Caller,
    OnlyShapeFormat(format): OnlyShapeFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let plan = move |app: &App, body: &[u8]| app.parse::<SubdivideRequest>(body)?.plan(app, format);
    compute_planned(app, body, plan).await
}

impl Given {
    /// Number of vertices or points, and the factor by which it grows with every level.
    fn size(&self) -> (usize, f64) {
        match self {
            Self::Mesh(mesh) => (mesh.vertex_count(), 4.0),
            Self::Start(start) => (start.size().vertices, 4.0),
            Self::Polyline(polyline) => (polyline.point_count(), 2.0),
        }
    }
}

impl SubdivideRequest {
    fn plan(mut self, app: &App, format: ShapeFormat) -> Result<Planned, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let scheme = self.take_scheme(&mut errors);
        let depth = self.take_depth(&mut errors);
        let limit = self.limit.take().map_or(Some(false), |field| field.take("/limit", &mut errors));
        let given = self.take_given(&mut errors);
        let wanted = scheme.zip(depth).zip(limit.zip(given));
        let (((scheme, depth), (limit, given)), _) = checked(wanted, errors, Vec::new())?;
        let (vertices, factor) = given.size();
        let work = requests::subdivide(vertices, factor, &depth, limit, &app.limits) + format.work();
        planned(work, move |app| match given {
            Given::Mesh(mesh) => answer_mesh(refine(app, scheme, mesh, depth, limit)?, format),
            Given::Start(start) => answer_mesh(subdivide_named(app, scheme, start, depth, limit)?, format),
            Given::Polyline(polyline) => {
                let closed = polyline.closed.as_ref().and_then(Checked::get).copied().unwrap_or(true);
                answer_polyline(subdivide_polyline(app, scheme, polyline, depth)?, closed, format)
            }
        })
    }

    fn take_scheme(&mut self, errors: &mut Vec<Fault>) -> Option<Scheme> {
        let before = errors.len();
        let name = take_given(self.scheme.take(), "/scheme", errors);
        let fields = SchemeFields {
            lambda: take_given(self.lambda.take(), "/lambda", errors),
            lambda_imaginary: take_given(self.lambda_imaginary.take(), "/lambda_imaginary", errors),
            v0: take_given(self.v0.take(), "/v0", errors),
            weights: take_given(self.weights.take(), "/weights", errors),
            tension: take_given(self.tension.take(), "/tension", errors),
            balance: take_given(self.balance.take(), "/balance", errors),
            ..SchemeFields::named(name?)
        };
        if errors.len() > before {
            return None;
        }
        let found = fields.scheme();
        let faults = found.map_err(|faults| {
            errors.extend(faults.into_iter().map(|(field, detail)| Fault::new(format!("/{field}"), detail)));
        });
        faults.ok()
    }

    fn take_depth(&mut self, errors: &mut Vec<Fault>) -> Option<Depth> {
        let (level, tolerance) = (self.level.take(), self.tolerance.take());
        if level.is_none() && tolerance.is_none() {
            errors.push(Fault::new("/level", "required field is missing: give a level or a tolerance"));
        }
        let both = level.is_some() && tolerance.is_some();
        let (level, tolerance) =
            (take_given(level, "/level", errors), take_given(tolerance, "/tolerance", errors));
        if both {
            errors.push(Fault::new("/tolerance", "expected either level or tolerance, got both"));
        }
        match tolerance {
            Some(tolerance) if !(tolerance > 0.0) => {
                errors.push(Fault::new("/tolerance", format!("expected a positive number, got {tolerance}")));
                None
            }
            Some(tolerance) => Some(Depth::Tolerance(tolerance)),
            None => level.map(Depth::Level),
        }
    }

    fn take_given(&mut self, errors: &mut Vec<Fault>) -> Option<Given> {
        let start = take_given(self.start.take(), "/start", errors);
        match (self.mesh.take(), start, self.polyline.take()) {
            (Some(mesh), None, None) => Some(Given::Mesh(mesh)),
            (None, None, Some(polyline)) => Some(Given::Polyline(polyline)),
            (None, Some(text), None) => match text.parse() {
                Ok(start) => Some(Given::Start(start)),
                Err(detail) => {
                    errors.push(Fault::new("/start", format!("unknown mesh: {detail}")));
                    None
                }
            },
            (None, None, None) => {
                errors.push(Fault::new(
                    "/mesh",
                    "required field is missing: give a mesh, a start or a polyline",
                ));
                None
            }
            _ => {
                errors.push(Fault::new("", "expected only one of mesh, start and polyline"));
                None
            }
        }
    }
}

fn answer_mesh(refined: RefinedMesh, format: ShapeFormat) -> Result<Response, ServiceError> {
    let RefinedMesh { refined, limit, measures, quality, warnings } = refined;
    match format {
        ShapeFormat::Plain(Format::Json) => {}
        ShapeFormat::Plain(Format::Picture(file)) => {
            let drawn = coarsened(&refined.shape, refined.level, MAX_FACES);
            let layer = Layer::from_meshes(&[drawn], colour::BACK);
            return picture(&layout::draw("a refined mesh", vec![layer]).to_scale(None), &file);
        }
        ShapeFormat::Mesh(_, Some(_)) => {
            return Err(ServiceError::parameter(
                "grid",
                "expected none: a grid belongs to tensor-product surfaces",
            ));
        }
        ShapeFormat::Mesh(format, None) => {
            let mesh = match limit {
                Some(limit) => TriangleMesh {
                    vertices: limit.points,
                    normals: limit.normals,
                    faces: refined.shape.faces,
                },
                None => refined.shape,
            };
            return mesh_file(format, with_normals(mesh).into());
        }
    }
    let TriangleMesh { vertices, normals, faces } = refined.shape;
    let limit = limit.map(|limit| LimitOutput { vertices: limit.points, normals: limit.normals });
    json(
        StatusCode::OK,
        &SubdivideAnswer {
            mesh: Some(RefinedMeshOutput { vertices, faces, normals }),
            level: refined.level,
            change: refined.change,
            volume: measures.enclosed.map(|enclosed| enclosed.signed_volume),
            area: Some(measures.area),
            self_intersecting: quality.self_intersecting,
            limit,
            warnings,
            ..SubdivideAnswer::default()
        },
    )
}

fn answer_polyline(curve: RefinedCurve, closed: bool, format: ShapeFormat) -> Result<Response, ServiceError> {
    let RefinedCurve { refined, dimension, warnings } = curve;
    let shape = refined.shape;
    let columns = |points: &[[f64; 3]]| -> Vec<f64> {
        (0..dimension).flat_map(|c| points.iter().map(move |point| point[c])).collect()
    };
    match format {
        ShapeFormat::Plain(Format::Json) => {}
        ShapeFormat::Plain(Format::Picture(file)) => {
            let points: Vec<&[f64]> = shape.points.iter().map(|point| &point[..dimension]).collect();
            let layer = Layer::from_polyline(&points, closed, colour::MAIN);
            return picture(&layout::draw("a refined polyline", vec![layer]).to_scale(None), &file);
        }
        ShapeFormat::Mesh(..) => {
            let detail = "expected 'json', 'svg' or 'png': only meshes are written as meshes";
            return Err(ServiceError::parameter("format", detail));
        }
    }
    let points = |list: &[[f64; 3]]| Points::from_columns(columns(list), dimension);
    let polyline = RefinedPolylineOutput { points: points(&shape.points), normals: points(&shape.normals) };
    json(
        StatusCode::OK,
        &SubdivideAnswer {
            polyline: Some(polyline),
            level: refined.level,
            change: refined.change,
            warnings,
            ..SubdivideAnswer::default()
        },
    )
}
