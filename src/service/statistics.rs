//! Stateless statistics: projection, mean and alignment, functional PCA, with their drawings.
//!
//! The request carries all data, and nothing is stored. The functions are synchronous and run on the pool.

use crate::analysis::accumulate::{ShapesInMemory, Watched};
use crate::analysis::alignment::{
    AlignedShape, Alignment, MeanShape, Method, Projection, Projector, align_all_until, unwhitened,
};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::dictionary::recipe::NO_CONSTANTS;
use crate::analysis::frame::Frame;
use crate::analysis::matching::Matching;
use crate::analysis::metric::{Metric, norm};
use crate::analysis::partial_sums::Measured;
use crate::analysis::pca::FunctionalPca;
use crate::analysis::transformation::Transformation;
use crate::formats::shape::ShapeInput;
use crate::geometry::drawing::svg::{self, Layer, colour};
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::service::app::faults::Faults;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::shapes::read::{self, Batch, Reading};

/// Settings for reading and aligning shapes.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Representation of the shapes.
    pub representation: Representation,
    /// Correspondence of points between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Treatment of mirror images.
    pub mirror: Mirror,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection or Procrustes alignment.
    pub alignment: Alignment,
    /// Frame: selects the representative of the mean space.
    pub frame: Frame,
}

/// Settings prepared for computation.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Space of the shapes.
    pub space: ShapeSpace,
    /// Metric of the space.
    pub metric: Metric,
    /// Projection or Procrustes alignment.
    pub method: Method,
    /// Frame: selects the representative of the mean space.
    pub frame: Frame,
    /// Search over start points, directions and mirror images.
    pub matching: Matching,
    correspondence: Correspondence,
    direction: Direction,
}

impl Setup {
    /// Checks and prepares `settings`.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] with all fields that are invalid or do not fit together.
    pub fn new(app: &App, settings: &Settings) -> Result<Self, ServiceError> {
        let Settings { representation, correspondence, direction, mirror, transformation, alignment, frame } =
            settings;
        let mut faults = Faults::default();
        let space = faults.keep(app.space(representation, "/representation"))?;
        faults.keep(read::check_correspondence(representation, *correspondence))?;
        faults.keep(read::check_mirror(representation, *mirror))?;
        // Classes exist in two and three dimensions only; any other dimension is reported separately.
        let method = match Method::new(transformation, *alignment, representation.dimension()) {
            _ if !(2..=3).contains(&representation.dimension()) => None,
            method => faults.keep(method.map_err(ServiceError::from))?,
        };
        if let (Some((space, _)), Some(method)) = (&space, &method)
            && method.translates()
            && !space.reproduces_constants()
        {
            faults.add("/representation/generator", NO_CONSTANTS);
        }
        match (space, method) {
            (Some((space, metric)), Some(method)) if faults.count() == 0 => {
                let matching = Matching::new(&space, *correspondence, *direction, *mirror);
                Ok(Self {
                    space,
                    metric,
                    method,
                    frame: *frame,
                    matching,
                    correspondence: *correspondence,
                    direction: *direction,
                })
            }
            _ => Err(ServiceError::Invalid(faults)),
        }
    }

    /// Metric, alignment method and matching of the shapes.
    pub(crate) fn measured(&self) -> Measured<'_> {
        Measured { metric: &self.metric, method: &self.method, matching: &self.matching }
    }

    /// Conversion of posted shapes to control points.
    pub(crate) fn reading<'a>(&'a self, limits: &'a Limits) -> Reading<'a> {
        let Self { space, correspondence, direction, .. } = self;
        Reading { space, correspondence: *correspondence, direction: *direction, limits }
    }
}

/// A mean with its aligned shapes.
#[derive(Debug)]
pub struct Statistics {
    /// Prepared settings.
    pub setup: Setup,
    /// The mean.
    pub mean: MeanShape,
    /// Aligned shapes, in input order.
    pub aligned: Vec<AlignedShape>,
    /// `L₂` norm of every shape, about its mean position if the class translates.
    pub sizes: Vec<f64>,
    weights: Vec<f64>,
}

/// Computes the mean and the aligned shapes.
///
/// # Errors
/// Faults of the input; degenerate or too few shapes.
pub fn align(app: &App, settings: &Settings, shapes: Vec<ShapeInput>) -> Result<Statistics, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let Batch { control_points, weights } = read::read_batch(&setup.reading(&app.limits), shapes)?;
    let sizes = sizes(&setup, &control_points);
    let Setup { metric, method, frame, matching, .. } = &setup;
    let context = app.pool.context();
    context.check()?;
    let stop = || context.is_cancelled();
    let (mean, aligned) =
        align_all_until(metric, method, *frame, matching, control_points, weights.clone(), &stop)?;
    Ok(Statistics { setup, mean, aligned, sizes, weights })
}

fn sizes(setup: &Setup, control_points: &[f64]) -> Vec<f64> {
    let size = |shape: &[f64]| {
        let mut shape = shape.to_vec();
        if setup.method.translates() {
            setup.metric.centre(&mut shape);
        }
        setup.metric.whiten(&mut shape);
        norm(&shape)
    };
    control_points.chunks_exact(setup.metric.len()).map(size).collect()
}

/// Principal components of aligned shapes, with the scores of each shape.
#[derive(Debug)]
pub struct Components {
    /// The components.
    pub pca: FunctionalPca,
    /// Scores, one list per shape.
    pub scores: Vec<Vec<f64>>,
    /// Reconstruction error of each shape from its scores.
    pub errors: Vec<f64>,
}

/// Functional PCA of aligned shapes.
///
/// # Errors
/// A failure of the eigenproblem; [`ServiceError::Cancelled`].
pub fn pca(
    app: &App,
    statistics: &Statistics,
    components: usize,
    centre: bool,
) -> Result<Components, ServiceError> {
    let context = app.pool.context();
    context.check()?;
    let stop = || context.is_cancelled();
    let metric = &statistics.setup.metric;
    let whitened = statistics.aligned.iter().flat_map(|shape| shape.whitened.iter().copied()).collect();
    let source = ShapesInMemory::prepared(whitened, statistics.weights.clone());
    let source = Watched::new(&source, &stop);
    let pca = FunctionalPca::new(&source, metric, &statistics.mean.whitened, centre, components)?;
    let scores = pca.all_scores(&source)?;
    let errors = statistics
        .aligned
        .iter()
        .zip(&scores)
        .map(|(shape, scores)| {
            context.check()?;
            Ok(crate::analysis::pca::reconstruction_error(&shape.whitened, &pca.reconstruct(scores)))
        })
        .collect::<Result<_, ServiceError>>()?;
    Ok(Components { pca, scores, errors })
}

/// Direction of a projection between shapes and a reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Onto {
    /// Nearest member of the reference's class to each shape, `P_ref r_k = A r_ref + b`.
    #[default]
    Reference,
    /// Nearest member of each shape's class to the reference, `P_k r_ref = A r_k + b`.
    Shape,
}

/// Projects shapes on a reference, or the reference on each shape. Degenerate shapes are refused in both directions.
///
/// # Errors
/// Faults of the input; degenerate shapes, or a degenerate reference at `/reference`.
pub fn project(
    app: &App,
    settings: &Settings,
    onto: Onto,
    reference: ShapeInput,
    shapes: Vec<ShapeInput>,
) -> Result<(Setup, Vec<Projection>), ServiceError> {
    let setup = Setup::new(app, settings)?;
    let reading = setup.reading(&app.limits);
    let batch = read::read_batch(&reading, shapes);
    let reference = read::read_shape(&reading, reference)
        .map(|(control_points, _)| control_points)
        .map_err(|errors| ServiceError::below(errors, "/reference"));
    let mut faults = Faults::default();
    let (Some(reference), Some(batch)) = (faults.keep(reference)?, faults.keep(batch)?) else {
        return Err(ServiceError::Invalid(faults));
    };
    if batch.weights.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    let to_reference = Projector::new(&setup.metric, &setup.method, reference.clone());
    to_reference
        .project(reference.clone())
        .map_err(|error| ServiceError::from_analysis(error, |_| "/reference".into()).without_index())?;
    let context = app.pool.context();
    let projections = batch
        .control_points
        .chunks_exact(setup.metric.len())
        .enumerate()
        .map(|(index, shape)| {
            context.check()?;
            let aligned = to_reference.project(shape.to_vec()).map_err(|error| error.at(index))?;
            Ok(match onto {
                Onto::Shape => aligned,
                Onto::Reference => Projector::new(&setup.metric, &setup.method, shape.to_vec())
                    .project(reference.clone())
                    .map_err(|error| error.at(index))?,
            })
        })
        .collect::<Result<_, ServiceError>>()?;
    Ok((setup, projections))
}

/// Drawing of a mean with aligned shapes behind it.
pub fn draw_mean(setup: &Setup, title: &str, mean: &MeanShape, aligned: &[AlignedShape]) -> String {
    let behind: Vec<Vec<f64>> =
        aligned.iter().take(MAX_DRAWN).map(|shape| unwhitened(&setup.metric, &shape.whitened)).collect();
    let opacity = (8.0 / (behind.len() as f64 + 1.0)).clamp(0.08, 0.6);
    let layers = [
        Layer::of(&setup.space, behind.iter().map(Vec::as_slice), colour::BACK, 1.0, opacity)
            .named(format!("{} aligned shapes", behind.len())),
        Layer::of(&setup.space, [mean.control_points.as_slice()], colour::MAIN, 2.5, 1.0).named("mean"),
    ];
    svg::draw(title, &layers)
}

/// Drawing of one mode: the mean and `mean ± sigma·s ξ`, where `s` is the standard deviation of the scores.
///
/// # Errors
/// A component that does not exist.
pub fn draw_mode(
    statistics: &Statistics,
    components: &Components,
    component: usize,
    sigma: f64,
) -> Result<String, ServiceError> {
    let pca = &components.pca;
    let found = pca.eigenvalues.len();
    if !(1..=found).contains(&component) {
        let detail = format!("expected a number between 1 and {found}, got {component}");
        return Err(ServiceError::Query(format!("component: {detail}")));
    }
    let setup = &statistics.setup;
    let i = component - 1;
    // Uncentred eigenvalues measure energy, not variation: a mode shows the spread of the scores.
    let shapes = statistics.aligned.len() as f64;
    let mean_score = components.scores.iter().map(|s| s[i]).sum::<f64>() / shapes;
    let variance =
        components.scores.iter().map(|s| (s[i] - mean_score).powi(2)).sum::<f64>() / (shapes - 1.0);
    let moved = |sign: f64| {
        let step = sign * sigma * variance.sqrt();
        let x: Vec<f64> =
            pca.mean.iter().zip(pca.eigenshapes.column(i).iter()).map(|(m, xi)| m + step * xi).collect();
        unwhitened(&setup.metric, &x)
    };
    let (minus, mean, plus) = (moved(-1.0), moved(0.0), moved(1.0));
    let layer = |shape: &[f64], colour, width| Layer::of(&setup.space, [shape], colour, width, 1.0);
    let layers = [
        layer(&minus, colour::MINUS, 2.0).named(format!("−{sigma} σ")),
        layer(&plus, colour::PLUS, 2.0).named(format!("+{sigma} σ")),
        layer(&mean, colour::MAIN, 2.5).named("mean"),
    ];
    let title = format!(
        "mode {component}: {:.1} % of {}",
        100.0 * pca.explained[i],
        if pca.centred { "variance" } else { "energy" }
    );
    Ok(svg::draw(&title, &layers))
}
