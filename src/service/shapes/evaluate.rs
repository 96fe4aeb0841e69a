//! Values of posted shapes at places: points, derivatives, frames; also as a drawing or as a mesh.
//!
//! The functions are synchronous and run on the pool.

use super::blocks::Layers;
use super::draw::draw_shapes;
use super::each::each;
use super::mesh::{self, mesh_of};
use super::request::Posted;
use crate::analysis::correspondence::Correspondence;
use crate::geometry::capability::sample::{Evaluation, Parameters};
use crate::geometry::capability::tessellate::{Detail, with_normals};
use crate::geometry::curve::MAX_DERIVATIVE;
use crate::geometry::drawing::layer::Layer;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::drawing::{colour, layout};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::texture::TexturedMesh;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Evaluation of shapes.
#[derive(Debug, Clone)]
pub struct EvaluateTask {
    /// Representation of the shapes, with the grids of their blocks.
    pub layers: Layers,
    /// Conversion of posted points to control points.
    pub correspondence: Correspondence,
    /// Places on shapes with parameters; `None` for the vertices of refined meshes.
    pub parameters: Option<Parameters>,
    /// Highest order of derivatives.
    pub order: usize,
    /// Whether directions and curvatures are computed.
    pub frames: bool,
}

/// Values of the shapes of a request.
#[derive(Debug)]
pub struct Evaluated {
    /// One entry per shape.
    pub evaluations: Vec<Evaluation>,
    /// Triangles between the vertices of refined meshes, the same for all of them.
    pub faces: Option<Vec<[u32; 3]>>,
}

impl EvaluateTask {
    /// Values of the shapes.
    ///
    /// # Errors
    /// Faults of the shapes; too many places, parameters out of range.
    pub fn values(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<Evaluated, ServiceError> {
        let Some(parameters) = &self.parameters else {
            let meshes = self.meshes(app, shapes, Detail::Whole)?;
            let of = |mesh: &TriangleMesh| Evaluation::from_mesh(mesh, self.frames);
            let faces = meshes.first().map(|mesh| mesh.faces.clone());
            return Ok(Evaluated { evaluations: meshes.iter().map(of).collect(), faces });
        };
        let (posted, shapes) = self.read(app, shapes)?;
        let total = self.check_places(app, parameters, shapes.len())?;
        // Reserved before the computation, so that no work is done for a response that does not fit in memory.
        let _room = app.memory.foresee(total)?;
        let evaluations = each(&app.pool.context(), &shapes, |shape| {
            posted.space.evaluate_shifted(shape, parameters, posted.shifts(), self.order, self.frames)
        })?;
        let evaluations = evaluations.into_iter().collect::<Option<_>>();
        let missing = || ServiceError::Internal("parameters of another kind of shape".into());
        Ok(Evaluated { evaluations: evaluations.ok_or_else(missing)?, faces: None })
    }

    /// Drawing of the shapes.
    ///
    /// # Errors
    /// Faults of the shapes.
    pub fn drawing(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<Drawing, ServiceError> {
        let title = |what: &str, count: usize| match count {
            1 => format!("a {what}"),
            count => format!("{count} {what}s"),
        };
        if self.parameters.is_none() {
            let meshes = self.meshes(app, shapes, Detail::Drawn)?;
            let layer = Layer::from_meshes(&meshes, colour::BACK);
            let title = title("subdivision surface", meshes.len());
            return Ok(layout::draw(&title, vec![layer]).to_scale(None));
        }
        let (posted, shapes) = self.read(app, shapes)?;
        let outlines: Vec<&[f64]> = shapes.iter().map(|shape| shape.as_slice()).collect();
        let what = if posted.space.domain().is_sheet() { "surface" } else { "curve" };
        Ok(draw_shapes(&posted.space, &title(what, outlines.len()), &outlines, None))
    }

    /// Mesh of the only shape, at `grid`. Default: the grid of the parameters, if they form one.
    ///
    /// # Errors
    /// Faults of the shape; several shapes; [`ServiceError::Parameters`] for shapes that are not surfaces and for invalid grids.
    pub fn mesh(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
        grid: Option<[usize; 2]>,
    ) -> Result<TexturedMesh, ServiceError> {
        let Some(parameters) = &self.parameters else {
            let meshes = self.meshes(app, shapes, Detail::Whole)?;
            if grid.is_some() {
                let detail = "expected none: a grid belongs to tensor-product surfaces";
                return Err(ServiceError::parameter("grid", detail));
            }
            return match <[TriangleMesh; 1]>::try_from(meshes) {
                Ok([mesh]) => Ok(with_normals(mesh).into()),
                Err(_) => {
                    Err(ServiceError::invalid("/shapes", "expected one surface in a mesh file, got more"))
                }
            };
        };
        let (posted, shapes) = self.read(app, shapes)?;
        let [shape] = &shapes[..] else {
            let detail = format!("expected one surface in a mesh file, got {}", shapes.len());
            return Err(ServiceError::invalid("/shapes", detail));
        };
        let grid = match parameters {
            Parameters::Grid(own) => grid.or(Some(*own)),
            _ => grid,
        };
        mesh_of(&posted.space, shape.as_slice(), grid)
    }

    fn read(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<(Posted, Vec<Matrix>), ServiceError> {
        let posted = Posted::of_layers(app, &self.layers, self.correspondence)?;
        let shapes = posted.read(app, shapes)?;
        Ok((posted, shapes))
    }

    fn meshes(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
        detail: Detail,
    ) -> Result<Vec<TriangleMesh>, ServiceError> {
        if self.order > 0 {
            let order = self.order;
            let detail =
                format!("expected 0, got {order}: the mesh of a level has frames, but no derivatives");
            return Err(ServiceError::invalid("/derivatives", detail));
        }
        mesh::refined(app, self.layers.coarse(), self.correspondence, shapes, detail)
    }

    /// Number of numbers of the values of `shapes` shapes.
    fn check_places(&self, app: &App, parameters: &Parameters, shapes: usize) -> Result<usize, ServiceError> {
        let (order, most) = (self.order, app.limits.answer_numbers);
        let mut faults = Vec::new();
        if order > MAX_DERIVATIVE {
            let detail = format!("expected 0, 1 or {MAX_DERIVATIVE}, got {order}");
            faults.push(Fault::new("/derivatives", detail));
        }
        let pointer = match parameters {
            Parameters::Equidistant(_) => "/samples",
            Parameters::Grid(_) => "/grid",
            Parameters::At(_) | Parameters::Pairs(_) => "/parameters",
        };
        let values = parameters.numbers(self.layers.coarse().dimension(), order, self.frames);
        let total = parameters.count().saturating_mul(shapes).saturating_mul(values);
        if parameters.count() == 0 || total > most {
            let detail = format!("expected a request for between 1 and {most} numbers, got {total}");
            faults.push(Fault::new(pointer, detail));
        }
        let outside = parameters.faults(self.layers.coarse().domain()).into_iter();
        faults.extend(outside.map(|fault| Fault::from(fault).below("/parameters")));
        ServiceError::unless_empty(faults)?;
        Ok(total)
    }
}
