//! Curves and surfaces of a request that is answered from memory.

use super::outcome::{OnError, Outcomes};
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
        let read = read::read_each(&self.reading(&app.limits), shapes)?;
        Ok(read.map(|_, (control_points, _)| Ok(self.matrix(&control_points))))
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
