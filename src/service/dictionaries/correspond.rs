//! Correspondence of new surfaces with the components of a dictionary.

use super::coding::Asked;
use super::ready::Ready;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::groupwise::{Corresponding, GroupwiseOptions, Reference, shape_work};
use crate::geometry::reparametrisation::Spherical;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::service::shapes::outcome::{Outcomes, of_shape};

/// Multiply-adds in whose time a number of an answer is written.
const WRITING: f64 = 100.0;

/// Numbers of an answer in whose time a shape is brought into correspondence.
pub fn numbers(options: &GroupwiseOptions) -> usize {
    (shape_work(options) / WRITING) as usize
}

/// Brings shapes into correspondence with a dictionary of components, by checked choices.
///
/// # Errors
/// Sparse codes, a dictionary of other shapes; under `abort` faults of the shapes, shapes without extent.
pub fn correspond(
    app: &App,
    ready: &Ready,
    asked: Asked,
    options: &GroupwiseOptions,
) -> Result<Outcomes<Corresponding>, ServiceError> {
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
        reference.correspond(&rows, options, &context).map_err(|error| of_shape(index, error))
    })
}

/// The mean of a dictionary with its modes, each displaced by its standard deviation.
fn reference_of(ready: &Ready, spherical: &Spherical) -> Result<Reference, ServiceError> {
    let dictionary = ready.dictionary();
    let matrix = |x: Vec<f64>| Matrix::from_vec(spherical.size(), 3, x);
    let mean = match dictionary.mode(0, 1.0) {
        Some(mode) => mode.shapes[1].clone(),
        None => {
            let mut mean = dictionary.preparation.mean.clone();
            dictionary.metric().unwhiten(&mut mean);
            mean
        }
    };
    let modes = (0..dictionary.model.len()).filter_map(|component| dictionary.mode(component, 1.0));
    let displacements: Vec<Matrix> = modes
        .map(|mode| {
            matrix(mode.shapes[2].iter().zip(&mode.shapes[1]).map(|(moved, still)| moved - still).collect())
        })
        .collect();
    let found = Reference::new(spherical, &matrix(mean), &displacements);
    found.map_err(|_| {
        ServiceError::parameter("dictionary", "expected a mean with an extent in all directions")
    })
}
