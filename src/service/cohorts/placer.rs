//! Records of files as shapes of a cohort.

use crate::analysis::conversion::Beginning;
use crate::domain::shape::FitResidual;
use crate::geometry::capability::fit::{FitSettings, FitTarget, Fitted, Fitter, ParameterSource};
use crate::geometry::capability::fourier::FourierCurve;
use crate::geometry::mesh::TriangleMesh;
use crate::numeric::bounded::never;
use crate::numeric::dense::Matrix;
use crate::service::shapes::read::{ReadShape, Reading, attributes, read_shape};
use crate::wire::fault::Fault;
use crate::wire::files::{Fourier, Record};
use crate::wire::record::{MAX_SAMPLES, Placed, Placing};
use crate::wire::shape::{PointList, ShapeInput};

/// Reads records into the space of a cohort. Prepared once for many.
pub(super) struct Placer<'a> {
    reading: Reading<'a>,
    placing: &'a Placing,
    /// Fits surfaces with two parameters to meshes.
    fitter: Option<Fitter<'a>>,
}

/// A shape, with the residual of its fit to a mesh.
pub(super) struct Found {
    pub(super) shape: ReadShape,
    pub(super) fit: Option<MeshFit>,
    /// Warnings of the fit.
    pub(super) warnings: Vec<String>,
}

/// Residual of a fit to a mesh, before the surface is measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeshFit {
    mean: f64,
    largest: f64,
    mesh_area: f64,
}

impl MeshFit {
    /// The residual of a surface with this area; `None` where its numbers are beyond bounds.
    pub(super) fn residual(self, area: Option<f64>) -> Option<FitResidual> {
        let Self { mean, largest, mesh_area } = self;
        let area = area? / mesh_area - 1.0;
        [mean, largest, area].iter().all(|x| x.is_finite()).then_some(FitResidual { mean, largest, area })
    }
}

impl From<ReadShape> for Found {
    fn from(shape: ReadShape) -> Self {
        Self { shape, fit: None, warnings: Vec::new() }
    }
}

impl<'a> Placer<'a> {
    pub(super) fn new(reading: Reading<'a>, placing: &'a Placing) -> Self {
        let space = reading.conversion.space;
        let fits = space.domain().is_sheet();
        let fitter = fits.then(|| Fitter::new(space, FitSettings::default()).ok()).flatten();
        Self { reading, placing, fitter }
    }

    pub(super) fn reading(&self) -> &Reading<'a> {
        &self.reading
    }

    /// The shape of a record.
    ///
    /// # Errors
    /// All faults of the record, with pointers into the posted shape; those of a fit to its mesh.
    pub(super) fn read(&self, record: Record) -> Result<Found, Vec<Fault>> {
        let representation = self.reading.conversion.space.representation();
        match self.placing.place(record, representation)? {
            Placed::Shape(shape) => Ok(read_shape(&self.reading, shape)?.into()),
            Placed::Mesh(shape, mesh) => self.fit(shape, mesh),
            Placed::Fourier(shape, fourier) => self.expand(shape, &fourier),
        }
    }

    /// A surface fitted to a mesh.
    fn fit(&self, shape: ShapeInput, mesh: TriangleMesh) -> Result<Found, Vec<Fault>> {
        let refused = |detail: String| Err(vec![Fault::new("/vertices", detail)]);
        let (points, most) = (mesh.vertices.len(), self.reading.limits.points);
        if points > most {
            return refused(format!("expected at most {most} vertices, got {points}"));
        }
        let Some(fitter) = &self.fitter else {
            return refused("expected a representation with two parameters, got another one".into());
        };
        let source = ParameterSource::Computed { poles: None };
        let mesh_area = mesh.face_areas().iter().sum();
        let fitted = fitter.fit(FitTarget::Mesh { mesh, source }, &never);
        let Fitted { control_points, mean, largest, warnings, .. } =
            fitted.map_err(|faults| faults.into_iter().map(Fault::from).collect::<Vec<_>>())?;
        let control_points = control_points.as_slice().to_vec();
        let attributes = attributes(shape)?;
        let fit = mean.map(|mean| MeshFit { mean, largest, mesh_area });
        let beginning = Beginning::default();
        let shape = ReadShape { control_points, attributes, points, repeated_points: 0, beginning };
        Ok(Found { shape, fit, warnings })
    }

    /// The curve of Fourier coefficients: itself where the space contains it, else at the number of points that is asked for.
    fn expand(&self, shape: ShapeInput, fourier: &Fourier) -> Result<Found, Vec<Fault>> {
        let space = self.reading.conversion.space;
        let curve =
            FourierCurve { constant: &fourier.constant, cosine: &fourier.cosine, sine: &fourier.sine };
        let list = |points: &Matrix| {
            let rows = points.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>()).collect();
            Some(Box::new(PointList::of_rows(fourier.dimension(), rows)))
        };
        let shape = match (space.fourier_control_points(&curve), self.placing.samples) {
            (Some(control_points), _) => ShapeInput { control_points: list(&control_points), ..shape },
            (None, Some(samples)) => {
                let samples = samples.min(MAX_SAMPLES);
                ShapeInput { points: list(&curve.points(samples)), ..shape }
            }
            (None, None) => {
                let (harmonics, size) = (fourier.harmonics(), space.representation().size());
                let detail = format!(
                    "expected a representation that contains curves of {harmonics} harmonics (at least {} control \
                     points of a generator with the poles of all of them), got one of {size} control points that does \
                     not: samples=N takes N points of the curve",
                    2 * harmonics + 1
                );
                return Err(vec![Fault::new("", detail)]);
            }
        };
        Ok(read_shape(&self.reading, shape)?.into())
    }
}
