//! Routes through posted shapes: straight lines, or great circles between shapes of unit norm.
//!
//! The functions are synchronous and run on the pool.

use serde_json::json;

use super::each::each;
use super::mesh::mesh_of;
use super::read::check_correspondence;
use super::read_oriented::OrientedReader;
use super::request::Posted;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::path::{PathKind, Positions, Route, on_piece};
use crate::geometry::GeometryError;
use crate::geometry::capability::domain::Admitted;
use crate::geometry::drawing::layer::{Layer, MAX_FACES};
use crate::geometry::drawing::scene::{Drawing, short};
use crate::geometry::drawing::svg::Style;
use crate::geometry::drawing::{colour, layout};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::subdivision::normal_based::Oriented;
use crate::geometry::texture::TexturedMesh;
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::gltf::{self, Displacement, Play};
use crate::wire::mesh::{MeshFormat, objects};
use crate::wire::shape::ShapeInput;

/// Shapes of a request that a route leads through.
#[derive(Debug)]
pub enum Stops {
    /// Those at its start and its end, `from` and `to`.
    Ends(Box<[ShapeInput; 2]>),
    /// Two or more, `shapes`.
    Listed(Vec<ShapeInput>),
}

impl Stops {
    /// Number of shapes.
    pub fn count(&self) -> usize {
        match self {
            Self::Ends(_) => 2,
            Self::Listed(shapes) => shapes.len(),
        }
    }

    /// Pointer to shape `k` in the request.
    fn pointer(&self, k: usize) -> String {
        match (self, k) {
            (Self::Ends(_), 0) => "/from".into(),
            (Self::Ends(_), _) => "/to".into(),
            (Self::Listed(_), _) => format!("/shapes/{k}"),
        }
    }

    /// Reads all shapes, one by one as `ends` or together as `list`.
    ///
    /// # Errors
    /// The faults of all shapes.
    fn read<T>(
        self,
        ends: impl Fn(ShapeInput, &str) -> Result<T, ServiceError>,
        list: impl FnOnce(Vec<ShapeInput>) -> Result<Vec<T>, ServiceError>,
    ) -> Result<Vec<T>, ServiceError> {
        let [from, to] = match self {
            Self::Listed(shapes) => return list(shapes),
            Self::Ends(ends) => *ends,
        };
        let mut faults = Faults::default();
        match (faults.keep(ends(from, "/from"))?, faults.keep(ends(to, "/to"))?) {
            (Some(from), Some(to)) => Ok(vec![from, to]),
            _ => Err(ServiceError::Invalid(faults)),
        }
    }
}

/// Shapes of a request, and the route through them.
#[derive(Debug)]
pub struct MorphTask {
    /// Representation of the shapes.
    pub representation: Admitted,
    /// Conversion of posted points to control points.
    pub correspondence: Correspondence,
    /// Kind of its paths.
    pub kind: PathKind,
    /// Positions on the route.
    pub positions: Positions,
    /// Shapes that the route leads through.
    pub stops: Stops,
}

/// A route through shapes.
#[derive(Debug)]
pub struct Morph {
    /// The shapes on the path, in the order of the positions.
    pub frames: Vec<PathShape>,
    /// Angles between neighbours in radians, for paths on the sphere.
    pub angles: Option<Vec<f64>>,
}

/// A shape on a path.
#[derive(Debug)]
pub struct PathShape {
    /// Position `τ`.
    pub position: f64,
    /// Control points of the shape.
    pub control_points: Matrix,
    /// Unit normals, for shapes of points and normals.
    pub normals: Option<Vec<[f64; 3]>>,
}

/// Maximum number of frames of an animation.
const MAX_FRAMES: usize = 1000;
/// Maximum size of an animation in bytes: no browser plays longer ones.
const MAX_DRAWN: usize = 16 << 20;

/// Maximum extrapolation of a path.
const MAX_POSITION: f64 = 1000.0;

/// List of all positions on a route of `pieces` paths, for shapes of `size` control points.
///
/// # Errors
/// Too many positions, or positions out of range.
fn listed(
    positions: Positions,
    pieces: usize,
    size: usize,
    limits: &Limits,
) -> Result<Vec<f64>, ServiceError> {
    let pointer = if matches!(positions, Positions::At(_)) { "/positions" } else { "/steps" };
    let (positions, mut faults) = (positions.list(pieces), Vec::new());
    let (total, most) = (positions.len().saturating_mul(size), limits.samples);
    if positions.is_empty() || total > most {
        let detail = format!("expected between 1 and {most} control points over all positions, got {total}");
        faults.push(Fault::new(pointer, detail));
    }
    let last = MAX_POSITION + pieces.saturating_sub(1) as f64;
    let wild = positions.iter().enumerate().filter(|(_, tau)| !(-MAX_POSITION..=last).contains(*tau));
    faults.extend(wild.map(|(i, tau)| {
        let detail = match pieces {
            1 => format!("expected a number within ±{MAX_POSITION}, got {tau}"),
            _ => format!("expected a number between -{MAX_POSITION} and {last}, got {tau}"),
        };
        Fault::new(format!("/positions/{i}"), detail)
    }));
    ServiceError::unless_empty(faults)?;
    Ok(positions)
}

impl MorphTask {
    /// Shapes on the path.
    ///
    /// # Errors
    /// Faults of the shapes at `/from…` and `/to…`, or `/shapes…`, and of the positions; opposite shapes.
    pub fn morph(self, app: &App) -> Result<Morph, ServiceError> {
        if self.representation.is_linear() {
            let posted = Posted::new(app, &self.representation, self.correspondence)?;
            return self.along(app, &posted);
        }
        self.check_oriented()?;
        let (representation, positions) = (self.representation, self.positions);
        let shapes = oriented_route(app, &reader(&representation)?, &representation, positions, self.stops)?;
        Ok(Morph { angles: None, frames: shapes.into_iter().map(oriented_frame).collect() })
    }

    /// File of the meshes of the shapes on the path: over `grid` for surfaces with two parameters, of their level for others. In OBJ
    /// they are objects; in glTF the first is a mesh with displacements to the others and an animation through them. The other
    /// formats hold one mesh.
    ///
    /// # Errors
    /// Those of [`Self::morph`]; shapes that are not surfaces; too many vertices in total; several meshes in a format for one;
    /// coordinates beyond single precision where a format has it.
    pub fn file(
        self,
        app: &App,
        format: MeshFormat,
        grid: Option<[usize; 2]>,
    ) -> Result<Vec<u8>, ServiceError> {
        check_frames(format, self.positions.count())?;
        if self.representation.is_linear() {
            let posted = Posted::new(app, &self.representation, self.correspondence)?;
            let frames = self.along(app, &posted)?.frames;
            let mesh = |frame: &PathShape| mesh_of(&posted.space, frame.control_points.as_slice(), grid);
            let Some(first) = frames.first().map(mesh).transpose()? else { return Ok(Vec::new()) };
            check_vertices_over_all(app, first.mesh.vertices.len(), frames.len())?;
            let positions: Vec<f64> = frames.iter().map(|frame| frame.position).collect();
            return write_meshes(app, format, &positions, first, &|k| Ok(mesh(&frames[k])?.mesh));
        }
        self.check_oriented()?;
        if grid.is_some() {
            let detail = "expected none: a grid belongs to tensor-product surfaces";
            return Err(ServiceError::parameter("grid", detail));
        }
        check_vertices_over_all(app, self.representation.refined_vertices(), self.positions.count())?;
        let (representation, positions) = (self.representation, self.positions);
        let reader = reader(&representation)?;
        let shapes = oriented_route(app, &reader, &representation, positions, self.stops)?;
        let mesh = |k: usize| {
            let refined = reader.meshes.refine(&shapes[k].1, None);
            refined.map_err(|error| ServiceError::invalid("/positions", error.to_string()))
        };
        let positions: Vec<f64> = shapes.iter().map(|(position, _)| *position).collect();
        let first = TexturedMesh { mesh: mesh(0)?, texture: None };
        write_meshes(app, format, &positions, first, &mesh)
    }

    /// Drawing of the path: an animation through its frames and back, or a strip of some of them. Surfaces are always side by
    /// side.
    ///
    /// # Errors
    /// Those of [`Self::morph`]; too many frames.
    pub fn drawing(self, app: &App, style: &Style, animated: bool) -> Result<Drawing, ServiceError> {
        let count = self.stops.count();
        let lines = match (self.kind, count) {
            (PathKind::Plane, 2) => "a straight line",
            (PathKind::Sphere, 2) => "a great circle",
            (PathKind::Plane, _) => "straight lines",
            (PathKind::Sphere, _) => "great circles",
        };
        let name = match count {
            2 => format!("from one shape to another along {lines}"),
            _ => format!("through {count} shapes along {lines}"),
        };
        if self.representation.is_linear() {
            let posted = Posted::new(app, &self.representation, self.correspondence)?;
            let morph = self.along(app, &posted)?;
            return match animated {
                true => animate(&posted, &name, &morph, count, style),
                false => Ok(strip(&posted.space, &name, &morph, count)),
            };
        }
        self.check_oriented()?;
        let (representation, positions) = (self.representation, self.positions);
        let vertices = representation.refined_vertices().min(MAX_FACES);
        check_vertices_over_all(app, vertices, positions.count())?;
        let reader = reader(&representation)?;
        let shapes = oriented_route(app, &reader, &representation, positions, self.stops)?;
        let context = app.pool.context();
        let mesh = |(_, shape): &(f64, Oriented)| {
            context.check()?;
            let refined = reader.meshes.refine(shape, Some(MAX_FACES));
            refined.map_err(|error| ServiceError::invalid("/positions", error.to_string()))
        };
        let meshes = shapes.iter().map(mesh).collect::<Result<Vec<_>, _>>()?;
        Ok(layout::draw(&name, vec![Layer::from_meshes(&meshes, colour::BACK)]))
    }

    /// Checks the path between shapes of points and normals.
    fn check_oriented(&self) -> Result<(), ServiceError> {
        if self.kind == PathKind::Sphere {
            let detail = format!(
                "expected another path than \"sphere\", which requires norms: {}",
                GeometryError::NotLinear
            );
            return Err(ServiceError::invalid("/path", detail));
        }
        check_correspondence(&self.representation, self.correspondence)
    }

    /// Shapes on the path in a linear space.
    fn along(self, app: &App, posted: &Posted) -> Result<Morph, ServiceError> {
        let (mut faults, pieces) = (Faults::default(), self.stops.count().saturating_sub(1));
        let pointers: Vec<String> = (0..=pieces).map(|k| self.stops.pointer(k)).collect();
        let named = matches!(self.stops, Stops::Ends(_));
        let positions = faults.keep(listed(self.positions, pieces, posted.metric.size(), &app.limits))?;
        let read = |shape, pointer: &str| posted.read_one(app, shape, pointer);
        let shapes = faults.keep(self.stops.read(read, |shapes| posted.read(app, shapes)))?;
        let (Some(positions), Some(shapes)) = (positions, shapes) else {
            return Err(ServiceError::Invalid(faults));
        };
        let shapes: Vec<Vec<f64>> = shapes.iter().map(|shape| shape.as_slice().to_vec()).collect();
        let route = Route::new(self.kind, &posted.metric, &shapes).map_err(|error| {
            let error = ServiceError::from_analysis(error, |index: usize| pointers[index].clone());
            if named { error.without_index() } else { error }
        })?;
        let frames = each(&app.pool.context(), &positions, |&position| PathShape {
            position,
            control_points: posted.matrix(&route.at(position)),
            normals: None,
        })?;
        Ok(Morph { frames, angles: route.angles() })
    }
}

/// Checks that a file of this format holds so many meshes.
///
/// # Errors
/// Several meshes in a format for one; an animation through too many.
fn check_frames(format: MeshFormat, frames: usize) -> Result<(), ServiceError> {
    let refused = |detail: String| Err(ServiceError::invalid("/positions", detail));
    match format {
        MeshFormat::Ply | MeshFormat::Stl if frames != 1 => refused(format!(
            "expected one position in a file of the format {}, which holds one mesh, got {frames}: ask for 'obj' or 'gltf'",
            format.name()
        )),
        // The weights of an animation are the square of their number.
        MeshFormat::Gltf if frames > MAX_FRAMES => refused(format!(
            "expected at most {MAX_FRAMES} positions in an animation, got {frames}: ask for 'obj'"
        )),
        _ => Ok(()),
    }
}

/// Checks the number of vertices of the meshes of so many positions.
///
/// # Errors
/// Too many vertices in total.
fn check_vertices_over_all(app: &App, vertices: usize, frames: usize) -> Result<(), ServiceError> {
    let (found, most) = (vertices.saturating_mul(frames), app.limits.samples);
    let detail = format!("expected at most {most} vertices over all positions, got {found}");
    if found > most { Err(ServiceError::invalid("/positions", detail)) } else { Ok(()) }
}

/// Writes the meshes of these positions, which have the faces and texture coordinates of the first. One is made after the other: all
/// at once would hold several times the bytes of the file, which are accounted for before they are taken.
fn write_meshes(
    app: &App,
    format: MeshFormat,
    positions: &[f64],
    first: TexturedMesh,
    mesh: &dyn Fn(usize) -> Result<TriangleMesh, ServiceError>,
) -> Result<Vec<u8>, ServiceError> {
    let context = app.pool.context();
    let next = |k: usize| {
        context.check()?;
        mesh(k)
    };
    let named = |k: usize| Ok((format!("position_{}", positions[k]), next(k)?));
    match format {
        MeshFormat::Obj => {
            let texture = first.texture.as_ref();
            // The corners of later objects count on, so that their numbers have more digits.
            let one = objects::<ServiceError>([named(0)], texture, 0)?.len();
            let (vertices, corners) = (first.mesh.vertices.len(), 3 * first.mesh.faces.len());
            let digits = |number: usize| number.max(1).ilog10() as usize;
            let more = digits(vertices.saturating_mul(positions.len())) - digits(vertices);
            let bytes = (one + 3 * corners * more).saturating_mul(positions.len());
            let _room = app.memory.hold(Purpose::Answers, bytes)?;
            objects((0..positions.len()).map(named), texture, bytes)
        }
        MeshFormat::Gltf => {
            let displacement = |k: usize| {
                let position = positions[k];
                let extras = json!({"position": position});
                Ok(Displacement { name: format!("position {position}"), mesh: next(k)?, extras })
            };
            let bytes = gltf::displacement_bytes(first.mesh.vertices.len()).saturating_mul(positions.len());
            let _room = app.memory.hold(Purpose::Answers, bytes)?;
            gltf::write(&first, (1..positions.len()).map(displacement), Play::Sequence)
        }
        MeshFormat::Ply | MeshFormat::Stl => Ok(format.write(first)?),
    }
}

/// Reader of shapes of points and normals.
fn reader(representation: &Admitted) -> Result<OrientedReader<'_>, ServiceError> {
    OrientedReader::new(representation)?
        .ok_or_else(|| ServiceError::Internal("only the normal-based scheme has normals".into()))
}

/// Shapes on the straight lines through shapes of points and normals, whose normals rotate along great circles.
fn oriented_route(
    app: &App,
    reader: &OrientedReader<'_>,
    representation: &Representation,
    positions: Positions,
    stops: Stops,
) -> Result<Vec<(f64, Oriented)>, ServiceError> {
    let (mut faults, context, pieces) =
        (Faults::default(), app.pool.context(), stops.count().saturating_sub(1));
    let pointers: Vec<String> = (0..=pieces).map(|k| stops.pointer(k)).collect();
    let positions = faults.keep(listed(positions, pieces, representation.size(), &app.limits))?;
    let read =
        |shape, pointer: &str| reader.read(shape).map_err(|errors| ServiceError::below(errors, pointer));
    let shapes = faults.keep(stops.read(read, |shapes| reader.read_each(&context, shapes)?.all()))?;
    let (Some(positions), Some(shapes)) = (positions, shapes) else {
        return Err(ServiceError::Invalid(faults));
    };
    let at = |tau: f64| {
        context.check()?;
        let (piece, place) = on_piece(tau, pieces);
        let shape = shapes[piece].between(&shapes[piece + 1], place).map_err(|(vertex, fault)| {
            ServiceError::invalid(format!("{}/normals/{vertex}", pointers[piece + 1]), fault.to_string())
        })?;
        Ok((tau, shape))
    };
    positions.into_iter().map(at).collect()
}

fn oriented_frame((position, Oriented { points, normals }): (f64, Oriented)) -> PathShape {
    let control_points = Matrix::from_fn(points.len(), 3, |i, c| points[i][c]);
    PathShape { position, control_points, normals: Some(normals) }
}

/// Maximum number of shapes of a strip.
const MAX_STRIP: usize = 7;

/// Drawing of the first and the last shape of a route through `count` shapes and of some between them, side by side.
fn strip(space: &ShapeSpace, title: &str, morph: &Morph, count: usize) -> Drawing {
    let last = morph.frames.len().saturating_sub(1);
    let drawn = morph.frames.len().min(MAX_STRIP);
    let cell = |k: usize| {
        let frame = &morph.frames[if drawn > 1 { (k * last + (drawn - 1) / 2) / (drawn - 1) } else { 0 }];
        let colour = match k {
            0 => colour::MINUS,
            k if k + 1 == drawn => colour::PLUS,
            _ => colour::MAIN,
        };
        let layer = Layer::of(space, [frame.control_points.as_slice()], colour, 2.0, 1.0);
        (place_on_route(frame.position, count), vec![layer])
    };
    layout::row(title, (0..drawn).map(cell).collect())
}

/// A position on a route through `count` shapes as readers know it.
fn place_on_route(position: f64, count: usize) -> String {
    let last = count as f64 - 1.0;
    match position {
        0.0 => "first shape".into(),
        1.0 if count == 2 => "second shape".into(),
        end if end == last => "last shape".into(),
        k if k.fract() == 0.0 && (0.0..last).contains(&k) => format!("shape {}", k + 1.0),
        other => short(other),
    }
}

/// Animated drawing of a route through `count` shapes, through its frames and back.
///
/// # Errors
/// Too many frames.
fn animate(
    posted: &Posted,
    title: &str,
    morph: &Morph,
    count: usize,
    style: &Style,
) -> Result<Drawing, ServiceError> {
    if morph.frames.len() > MAX_FRAMES {
        let detail =
            format!("expected at most {MAX_FRAMES} positions in a drawing, got {}", morph.frames.len());
        return Err(ServiceError::invalid("/positions", detail));
    }
    let shapes = morph.frames.iter().map(|frame| frame.control_points.as_slice());
    let layer = Layer::of(&posted.space, shapes, colour::MAIN, 2.5, 1.0);
    let ends = [morph.frames.first(), morph.frames.last()]
        .map(|frame| frame.map_or_else(String::new, |frame| place_on_route(frame.position, count)));
    let drawing = layout::animate(title, layer, ends);
    let bytes = drawing.animation_bytes(style);
    if bytes > MAX_DRAWN {
        let detail = format!(
            "expected an animation of at most {MAX_DRAWN} bytes, got about {bytes}: ask for fewer positions"
        );
        return Err(ServiceError::invalid("", detail));
    }
    Ok(drawing)
}
