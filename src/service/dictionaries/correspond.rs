//! Correspondence of new surfaces and curves with a dictionary.

use super::coding::Asked;
use super::ready::Ready;
use crate::analysis::AnalysisError;
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::{ElasticMatch, ElasticSpace};
use crate::analysis::groupwise::{Corresponding, GroupwiseOptions, Reference, shape_work};
use crate::geometry::reparametrisation::{LineRefit, Spherical};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::service::shapes::outcome::{Outcomes, of_shape};

/// Multiply-adds in whose time a number of an answer is written.
const WRITING: f64 = 100.0;

/// Numbers of an answer in whose time a shape is brought into correspondence.
pub fn numbers(options: &GroupwiseOptions) -> usize {
    (shape_work(options) / WRITING) as usize
}

/// Numbers of an answer in whose time a curve is matched, and its points are found.
pub fn elastic_numbers(settings: &ElasticSettings) -> usize {
    /// Seconds in which a number is written, and a point of a curve is found.
    const NUMBER: f64 = 1e-7;
    const POINT: f64 = 2e-6;
    let seconds = settings.seconds(2) + POINT * 6.0 * settings.points as f64;
    (seconds / NUMBER) as usize
}

/// A shape that has the parameters of a dictionary.
#[derive(Debug)]
pub enum Following {
    /// A surface.
    Surface(Box<Corresponding>),
    /// A curve, with its match to the mean, and the smallest and largest slope of its length.
    Curve(Box<(ElasticMatch, LineRefit, [f64; 2])>),
}

/// Brings curves into correspondence with the mean of a dictionary, by its own parameter.
///
/// # Errors
/// A dictionary of other shapes; under `abort` faults of the shapes.
pub fn correspond_curves(
    app: &App,
    ready: &Ready,
    asked: Asked,
    settings: ElasticSettings,
) -> Result<Outcomes<Following>, ServiceError> {
    let space = elastic_space(ready, settings)?;
    let template = space.template_of(&mean_of(ready)).map_err(|_| {
        ServiceError::parameter("dictionary", "expected a mean with a length, got one without")
    })?;
    let shapes = asked.control_points(app, ready, Correspondence::ArcLength)?;
    let context = app.pool.context();
    shapes.each(&context, |index, shape| {
        let curves = space.prepare(&shape).map_err(|error| of_shape(index, error))?;
        let found = space.onto(&template, &curves[0]);
        let refit = space.refit(&shape, &found, &ready.setup.space);
        let (refit, slopes) = refit.map_err(|error| of_shape(index, error))?;
        Ok(Following::Curve(Box::new((found, refit, slopes))))
    })
}

/// Curves of a dictionary as they are compared: closed planar ones in either direction.
///
/// # Errors
/// A dictionary of other shapes.
pub fn elastic_space(ready: &Ready, settings: ElasticSettings) -> Result<ElasticSpace, ServiceError> {
    let space = &ready.setup.space;
    let direction = Direction::usual(Correspondence::Cyclic, space.representation());
    ElasticSpace::new(space, direction, ready.setup.rule().mirror, settings).map_err(|error| match error {
        AnalysisError::Parameter { field: "representation", detail } => {
            ServiceError::parameter("dictionary", detail)
        }
        other => other.into(),
    })
}

/// Brings surfaces into correspondence with a dictionary of components, by checked choices.
///
/// # Errors
/// Sparse codes, a dictionary of other shapes; under `abort` faults of the shapes, shapes without extent.
pub fn correspond(
    app: &App,
    ready: &Ready,
    asked: Asked,
    options: &GroupwiseOptions,
) -> Result<Outcomes<Following>, ServiceError> {
    let Some(spherical) = ready.setup.space.spherical() else {
        let detail = "expected a dictionary of surfaces with the topology sphere";
        return Err(ServiceError::parameter("dictionary", detail));
    };
    if ready.dictionary().content.method.is_sparse() {
        let detail = "expected a dictionary of components: a sparse one has no variances of modes";
        return Err(ServiceError::parameter("dictionary", detail));
    }
    let reference = reference_of(ready, &spherical)?;
    let shapes = asked.control_points(app, ready, Correspondence::Landmarks)?;
    let context = app.pool.context();
    shapes.each(&context, |index, shape| {
        let rows = Matrix::from_column_slice(spherical.size(), 3, &shape);
        let found = reference.correspond(&rows, options, &context);
        found.map(|found| Following::Surface(Box::new(found))).map_err(|error| of_shape(index, error))
    })
}

/// The mean of a dictionary with its modes, each displaced by its standard deviation.
fn reference_of(ready: &Ready, spherical: &Spherical) -> Result<Reference, ServiceError> {
    let dictionary = ready.dictionary();
    let matrix = |x: Vec<f64>| Matrix::from_vec(spherical.size(), 3, x);
    let modes = (0..dictionary.model.len()).filter_map(|component| dictionary.mode(component, 1.0));
    let displacements: Vec<Matrix> = modes
        .map(|mode| {
            matrix(mode.shapes[2].iter().zip(&mode.shapes[1]).map(|(moved, still)| moved - still).collect())
        })
        .collect();
    let found = Reference::new(spherical, &matrix(mean_of(ready)), &displacements);
    found.map_err(|_| {
        ServiceError::parameter("dictionary", "expected a mean with an extent in all directions")
    })
}

/// Control points of the mean of a dictionary, coordinate-major.
fn mean_of(ready: &Ready) -> Vec<f64> {
    let dictionary = ready.dictionary();
    match dictionary.mode(0, 1.0) {
        Some(mode) => mode.shapes[1].clone(),
        None => {
            let mut mean = dictionary.preparation.mean.clone();
            dictionary.metric().unwhiten(&mut mean);
            mean
        }
    }
}
