//! Curves and surfaces of a request that is answered from memory.

use super::read::{self, Reading};
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::metric::Metric;
use crate::formats::shape::ShapeInput;
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::resample::RepeatedPoints;
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::{App, Limits, ServiceError};

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
    /// Space of the shapes.
    pub space: ShapeSpace,
    /// Metric of the space.
    pub metric: Metric,
    correspondence: Correspondence,
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
        Ok(Self { metric: Metric::of(&space), space, correspondence })
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

    fn reading<'a>(&'a self, limits: &'a Limits) -> Reading<'a> {
        let (space, correspondence) = (&self.space, self.correspondence);
        let (direction, repeated_points) = (Direction::Given, RepeatedPoints::Drop);
        let conversion = Conversion { space, correspondence, direction, repeated_points };
        Reading { conversion, limits }
    }

    /// Control points of every shape; at least one shape is required.
    ///
    /// # Errors
    /// The faults of all invalid shapes, at `/shapes/{index}…`.
    pub fn read(&self, app: &App, shapes: Vec<ShapeInput>) -> Result<Vec<Matrix>, ServiceError> {
        let batch = read::read_batch(&self.reading(&app.limits), shapes)?;
        if batch.weights.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        let shapes = batch.control_points.chunks_exact(self.metric.len());
        Ok(shapes.map(|control_points| self.matrix(control_points)).collect())
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
        read::read_shape(&self.reading(&app.limits), shape)
            .map(|shape| self.matrix(&shape.control_points))
            .map_err(|errors| ServiceError::below(errors, pointer))
    }

    /// Control points of shapes and of a reference shape, if given.
    ///
    /// # Errors
    /// Faults of the shapes, and of the reference at `/reference…`.
    pub(crate) fn read_with_reference(
        &self,
        app: &App,
        shapes: Vec<ShapeInput>,
        reference: Option<ShapeInput>,
    ) -> Result<(Vec<Matrix>, Option<Matrix>), ServiceError> {
        let reference = reference.map(|shape| self.read_one(app, shape, "/reference")).transpose();
        let mut faults = Faults::default();
        match (faults.keep(self.read(app, shapes))?, faults.keep(reference)?) {
            (Some(shapes), Some(reference)) => Ok((shapes, reference)),
            _ => Err(ServiceError::Invalid(faults)),
        }
    }

    pub(crate) fn matrix(&self, control_points: &[f64]) -> Matrix {
        Matrix::from_column_slice(self.metric.size(), self.metric.dimension(), control_points)
    }
}
