//! Curves and surfaces of a request that is answered from memory.

use super::blocks::{Layers, read_blocks};
use super::outcome::{OnError, Outcomes};
use super::read::{self, Reading};
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::metric::Metric;
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::resample::RepeatedPoints;
use crate::geometry::resolution::{Detailed, Resolutions};
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Checks that shapes of the representation are curves or surfaces.
///
/// # Errors
/// Landmarks.
pub(crate) fn check_curves(representation: &Representation) -> Result<(), ServiceError> {
    if representation.domain() != Domain::Points {
        return Ok(());
    }
    let detail =
        "expected closed_curve, open_curve, surface or subdivision: landmarks are points without a curve";
    Err(ServiceError::invalid("/representation/kind", detail))
}

/// Prepared space of posted shapes.
#[derive(Debug)]
pub struct Posted {
    /// Space of the shapes; of those with blocks, of their finest grid.
    pub space: ShapeSpace,
    /// Metric of the space.
    pub metric: Metric,
    correspondence: Correspondence,
    /// Grids of the blocks of the shapes, if they may have some.
    grids: Option<Box<Resolutions>>,
}

impl Posted {
    /// Prepares a representation of curves or surfaces.
    ///
    /// # Errors
    /// A space that cannot be prepared; faults of the correspondence; landmarks.
    pub fn new(
        app: &App,
        representation: &Admitted,
        correspondence: Correspondence,
    ) -> Result<Self, ServiceError> {
        check_curves(representation)?;
        let space = app.space(representation)?;
        read::check_correspondence(representation, correspondence)?;
        Ok(Self { metric: Metric::of(&space), space, correspondence, grids: None })
    }

    /// Prepares curves or surfaces that may have blocks.
    ///
    /// # Errors
    /// Those of [`Self::new`]; grids on which the shapes would be other functions.
    pub fn of_layers(
        app: &App,
        layers: &Layers,
        correspondence: Correspondence,
    ) -> Result<Self, ServiceError> {
        let posted = Self::new(app, layers.coarse(), correspondence)?;
        let Some(grids) = layers.prepare(&posted.space)? else { return Ok(posted) };
        let space = grids.finest().space().clone();
        Ok(Self { metric: Metric::of(&space), space, grids: Some(Box::new(grids)), ..posted })
    }

    /// Prepares a representation of splines: curves or tensor-product surfaces.
    ///
    /// # Errors
    /// Those of [`Self::new`]; subdivision surfaces.
    pub fn from_splines(
        app: &App,
        representation: &Admitted,
        correspondence: Correspondence,
    ) -> Result<Self, ServiceError> {
        let posted = Self::new(app, representation, correspondence)?;
        if posted.space.domain().is_mesh() {
            let detail = "expected closed_curve, open_curve or surface, got \"subdivision\": control meshes are \
                          refined by subdivide";
            return Err(ServiceError::invalid("/representation/kind", detail));
        }
        Ok(posted)
    }

    /// The space of the representation of the request.
    pub fn coarse(&self) -> &ShapeSpace {
        self.grids.as_ref().map_or(&self.space, |grids| grids.coarse())
    }

    /// Grids of the blocks of the shapes, if they may have some.
    pub fn grids(&self) -> Option<&Resolutions> {
        self.grids.as_deref()
    }

    /// The shifts `δ_u`, `δ_v` of shapes with blocks: the posted shape at `(u, v)` is the one that was read at `(u + δ_u, v + δ_v)`.
    pub fn shifts(&self) -> [f64; 2] {
        let shifts = self.grids.as_ref().map(|grids| grids.finest().shifts()).unwrap_or_default();
        [0, 1].map(|i| shifts.get(i).copied().unwrap_or_default())
    }

    fn reading<'a>(&'a self, limits: &'a Limits) -> Reading<'a> {
        let (space, correspondence) = (self.coarse(), self.correspondence);
        let (direction, repeated_points) = (Direction::Given, RepeatedPoints::Drop);
        let conversion = Conversion { space, correspondence, direction, repeated_points };
        Reading { conversion, limits }
    }

    /// Control points of every shape; at least one shape is required.
    ///
    /// # Errors
    /// The faults of all invalid shapes, at `/shapes/{index}…`.
    pub fn read(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<Vec<Matrix>, ServiceError> {
        self.read_each(app, shapes)?.all()
    }

    /// Control points of every valid shape; at least one shape is required.
    ///
    /// # Errors
    /// Too many numbers in all shapes together.
    pub(crate) fn read_each(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
    ) -> Result<Outcomes<Matrix>, ServiceError> {
        if shapes.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        if let Some(grids) = self.grids() {
            self.check_finest(app, shapes.len())?;
            let read =
                read::read_each_by(&self.reading(&app.limits), shapes, |shape| self.detailed(app, shape))?;
            return Ok(read.map(|_, shape| Ok(grids.flatten(&shape))));
        }
        let read = read::read_each(&self.reading(&app.limits), shapes)?;
        Ok(read.map(|_, (control_points, _)| Ok(self.matrix(&control_points))))
    }

    /// Shapes with their blocks; at least one is required.
    ///
    /// # Errors
    /// The faults of all invalid shapes, at `/shapes/{index}…`.
    pub(crate) fn read_detailed(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
    ) -> Result<Vec<Detailed>, ServiceError> {
        if shapes.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        self.check_finest(app, shapes.len())?;
        read::read_each_by(&self.reading(&app.limits), shapes, |shape| self.detailed(app, shape))?.all()
    }

    /// A shape with its blocks.
    ///
    /// # Errors
    /// All faults of the shape, with pointers relative to it.
    pub(crate) fn detailed(&self, app: &App, mut shape: ShapeInput) -> Result<Detailed, Vec<Fault>> {
        let blocks = match (self.grids(), shape.blocks.take_if(|_| self.grids.is_some())) {
            (Some(grids), Some(blocks)) => read_blocks(*blocks, grids),
            _ => Ok(Vec::new()),
        };
        let coarse = read::read_shape(&self.reading(&app.limits), shape);
        match (coarse, blocks) {
            (Ok(coarse), Ok(blocks)) => {
                let representation = self.coarse().representation();
                let (rows, columns) = (representation.size(), representation.dimension());
                let control_points = Matrix::from_column_slice(rows, columns, &coarse.control_points);
                Ok(Detailed { control_points, blocks })
            }
            (coarse, blocks) => Err(coarse.err().into_iter().chain(blocks.err()).flatten().collect()),
        }
    }

    /// Checks the numbers of all shapes on the finest grid.
    fn check_finest(&self, app: &App, shapes: usize) -> Result<(), ServiceError> {
        let (most, numbers) = (app.limits.coordinates, self.metric.size() * self.metric.dimension() * shapes);
        if numbers <= most {
            return Ok(());
        }
        let detail = format!(
            "expected at most {most} numbers in the control points of all shapes on the finest grid of their blocks, got {numbers}"
        );
        Err(ServiceError::invalid("/shapes", detail))
    }

    /// Control points of one shape.
    ///
    /// # Errors
    /// Its faults, below `pointer`.
    pub(crate) fn read_one(
        &self,
        app: &App,
        shape: ShapeInput,
        pointer: &str,
    ) -> Result<Matrix, ServiceError> {
        let read = self.detailed(app, shape).map_err(|errors| ServiceError::below(errors, pointer))?;
        Ok(self.grids().map_or_else(|| read.control_points.clone(), |grids| grids.flatten(&read)))
    }

    /// Control points of shapes and of a reference shape, if given.
    ///
    /// # Errors
    /// Under [`OnError::Abort`] faults of the shapes; faults of the reference at `/reference…`.
    pub(crate) fn read_with_reference(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
        reference: Option<ShapeInput>,
        on_error: OnError,
    ) -> Result<(Outcomes<Matrix>, Option<Matrix>), ServiceError> {
        let reference = reference.map(|shape| self.read_one(app, shape, "/reference")).transpose();
        let mut faults = Faults::default();
        let shapes = self.read_each(app, shapes).and_then(|shapes| shapes.checked(on_error));
        match (faults.keep(shapes)?, faults.keep(reference)?) {
            (Some(shapes), Some(reference)) => Ok((shapes, reference)),
            _ => Err(ServiceError::Invalid(faults)),
        }
    }

    pub(crate) fn matrix(&self, control_points: &[f64]) -> Matrix {
        Matrix::from_column_slice(self.metric.size(), self.metric.dimension(), control_points)
    }
}
