//! Stateless statistics: projection, mean and alignment, functional PCA, with their drawings.
//!
//! The request carries all data, and nothing is stored. The functions are synchronous and run on the pool.

use crate::analysis::accumulate::{ShapesInMemory, Watched};
use crate::analysis::alignment::{
    AlignedShape, Alignment, BothWays, MeanShape, Method, Onto, Projection, norms, unwhitened,
};
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::dictionary::recipe::NO_CONSTANTS;
use crate::analysis::drawing::{self, View};
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::matching::Matching;
use crate::analysis::metric::Metric;
use crate::analysis::partial_sums::Measured;
use crate::analysis::pca::Components;
use crate::analysis::region::Region;
use crate::analysis::robust::{align_all_by, point_weights};
use crate::analysis::tangent::{LinearAlignment, to_tangent};
use crate::analysis::transformation::{Transformation, TransformationClass};
use crate::geometry::capability::domain::Admitted;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::resample::RepeatedPoints;
use crate::service::app::faults::Faults;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::shapes::directions::{Rule, Ways};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::shapes::outcome::{OnError, Outcomes, of_shape};
use crate::service::shapes::read::{self, Batch, Reading};
use crate::wire::fault::Fault;
use crate::wire::observed::Observed;
use crate::wire::shape::ShapeInput;

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
    /// Whether shapes unlike the majority count less.
    pub estimator: Estimator,
}

impl Settings {
    /// Chooses the alignment of components, unless the request gives one `by_name`; whether aligned shapes are moved into the tangent
    /// space at their mean.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] at `/tangent` for a class that keeps sizes.
    pub fn align_for_components(
        &mut self,
        by_name: bool,
        tangent: Option<bool>,
    ) -> Result<bool, ServiceError> {
        let given = by_name.then_some(self.alignment);
        let dimension = self.representation.dimension();
        let LinearAlignment { alignment, tangent } =
            LinearAlignment::of_components(&self.transformation, dimension, given, tangent)
                .map_err(|error| ServiceError::invalid("/tangent", error.to_string()))?;
        self.alignment = alignment;
        Ok(tangent)
    }

    /// Checks the settings against the limits, and whether they fit together.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] with all fields that are invalid or do not fit together.
    pub fn checked(self, limits: &Limits) -> Result<CheckedSettings, ServiceError> {
        let admitted = read::admit_linear(self.representation.clone(), limits);
        self.checked_with(admitted)
    }

    /// As [`Self::checked`], with the verdict on the representation.
    ///
    /// # Errors
    /// As [`Self::checked`].
    pub(crate) fn checked_with(
        self,
        admitted: Result<Admitted, Vec<Fault>>,
    ) -> Result<CheckedSettings, ServiceError> {
        let Self {
            representation,
            correspondence,
            direction,
            mirror,
            transformation,
            alignment,
            frame,
            estimator,
        } = self;
        let mut faults = Faults::default();
        let admitted = faults.keep_below("/representation", admitted);
        faults.keep(read::check_correspondence(&representation, correspondence))?;
        faults.keep(read::check_mirror(&representation, mirror))?;
        // Classes exist in two and three dimensions only; any other dimension is reported separately.
        let method = match Method::new(&transformation, alignment, representation.dimension()) {
            _ if !(2..=3).contains(&representation.dimension()) => None,
            method => faults.keep(method.map_err(ServiceError::from))?,
        };
        if let (Some(admitted), Some(method)) = (&admitted, &method)
            && method.translates()
            && !admitted.reproduces_constants()
        {
            faults.add("/representation/generator", NO_CONSTANTS);
        }
        match (admitted, method) {
            (Some(representation), Some(method)) if faults.count() == 0 => Ok(CheckedSettings {
                representation,
                correspondence,
                direction,
                mirror,
                transformation,
                alignment,
                frame,
                estimator,
                method,
            }),
            _ => Err(ServiceError::Invalid(faults)),
        }
    }
}

/// [`Settings`] that fit together, of shapes within the limits.
#[derive(Debug, Clone)]
pub struct CheckedSettings {
    /// Representation of the shapes.
    pub representation: Admitted,
    /// Correspondence of points between shapes.
    pub correspondence: Correspondence,
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection or Procrustes alignment.
    pub alignment: Alignment,
    direction: Direction,
    mirror: Mirror,
    frame: Frame,
    /// Whether shapes unlike the majority count less.
    pub estimator: Estimator,
    method: Method,
}

impl CheckedSettings {
    /// The class of transformations, if shapes are projected onto its linear space.
    pub fn linear_class(&self) -> Option<&TransformationClass> {
        match &self.method {
            Method::Projection(class) => Some(class),
            Method::Procrustes(_) => None,
        }
    }

    /// The settings for a prior: the parameters of a surface stay as they are, since a model has no other control points.
    pub fn of_a_prior(self) -> Self {
        match self.representation.domain().is_sheet() {
            true => Self { correspondence: Correspondence::Landmarks, ..self },
            false => self,
        }
    }
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
    /// Whether shapes unlike the majority count less.
    pub estimator: Estimator,
    correspondence: Correspondence,
    direction: Direction,
    alignment: Alignment,
}

impl Setup {
    /// Aligned shapes as they are drawn: as `reference` (control points) is upright.
    pub fn view(&self, reference: &[f64]) -> View<'_> {
        View::upright(&self.space, &self.method, reference)
    }

    /// A drawing with a scale bar if aligned shapes keep their sizes; `unit`: the unit of length, if known.
    pub fn in_scale(&self, drawing: Drawing, unit: Option<&str>) -> Drawing {
        if self.method.keeps_sizes() { drawing.to_scale(unit) } else { drawing }
    }

    /// Prepares settings.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] if the space cannot be prepared.
    pub fn new(app: &App, settings: CheckedSettings) -> Result<Self, ServiceError> {
        let CheckedSettings {
            representation,
            correspondence,
            direction,
            mirror,
            frame,
            estimator,
            method,
            alignment,
            ..
        } = settings;
        let space = app.space(&representation)?;
        let metric = Metric::of(&space);
        let matching =
            Matching::new(&space, correspondence, direction, mirror).translating(method.translates());
        Ok(Self { space, metric, method, frame, matching, estimator, correspondence, direction, alignment })
    }

    /// Checks and prepares the settings of stored shapes.
    ///
    /// # Errors
    /// As [`Settings::checked`] and [`Self::new`].
    pub fn of(app: &App, settings: Settings) -> Result<Self, ServiceError> {
        Self::new(app, settings.checked(&app.limits)?)
    }

    /// Metric, alignment method and matching of the shapes.
    pub(crate) fn measured(&self) -> Measured<'_> {
        Measured { metric: &self.metric, method: &self.method, matching: &self.matching }
    }

    /// The mean of shapes in memory (coordinate-major, one after the other), and the variance that is left: the weighted mean of the squared
    /// residuals of the aligned shapes, divided by the squared norm of the mean.
    ///
    /// # Errors
    /// Degenerate or too few shapes; [`ServiceError::Cancelled`] once `stop` returns true.
    pub(crate) fn mean_and_variance(
        &self,
        control_points: Vec<f64>,
        weights: &[f64],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<(MeanShape, f64), ServiceError> {
        let measured = self.measured();
        let found =
            align_all_by(self.estimator, measured, self.frame, control_points, weights.to_vec(), stop);
        let (mean, aligned) = found?;
        let norm: f64 = mean.whitened.iter().map(|x| x * x).sum();
        let left: f64 = aligned.iter().zip(weights).map(|(shape, w)| w * shape.residual.powi(2)).sum();
        let variance = left / (weights.iter().sum::<f64>() * norm);
        Ok((mean, variance))
    }

    /// The region on which shapes are aligned.
    ///
    /// # Errors
    /// Faults at `/region`; a search or a robust mean, which look at whole shapes.
    fn region(&self, region: &Observed) -> Result<Region, ServiceError> {
        let mut faults = Faults::default();
        let found = faults.keep_below("/region", region.region(&self.space));
        if found.as_ref().is_some_and(|region| region.len() < 2) {
            faults.add("/region", "expected at least 2 places in the region, got fewer");
        }
        if self.matching.searches() {
            let detail =
                "expected points that correspond as given beside a region, got a search of whole shapes";
            faults.add("/correspondence", detail);
        }
        if self.estimator != Estimator::Plain {
            faults.add("/robust", "expected false beside a region, got true");
        }
        faults.unless_any()?;
        found.ok_or_else(|| ServiceError::Internal("a region without a fault".into()))
    }

    /// Alignment method.
    pub fn alignment(&self) -> Alignment {
        self.alignment
    }

    /// Rule of correspondence of curves, as far as their direction matters.
    pub(crate) fn rule(&self) -> Rule {
        let mirror = if self.matching.mirrors() { Mirror::Allow } else { Mirror::Forbid };
        Rule { correspondence: self.correspondence, direction: self.direction, mirror }
    }

    /// Correspondence of points between shapes.
    pub(crate) fn correspondence(&self) -> Correspondence {
        self.correspondence
    }

    /// Conversion of posted shapes to control points.
    pub(crate) fn reading<'a>(&'a self, limits: &'a Limits) -> Reading<'a> {
        let Self { space, correspondence, direction, .. } = self;
        let (correspondence, direction) = (*correspondence, *direction);
        let conversion =
            Conversion { space, correspondence, direction, repeated_points: RepeatedPoints::Drop };
        Reading { conversion, limits }
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
    /// Whether components are those of shapes that are moved, at unit size, into the tangent space at their mean.
    pub tangent: bool,
    /// A warning of contours drawn both ways round, if that matters.
    pub mixed: Option<String>,
    weights: Vec<f64>,
}

/// Computes the mean and the aligned shapes, aligned as wholes or on a region.
///
/// # Errors
/// Faults of the input; degenerate or too few shapes.
pub fn align(
    app: &App,
    settings: CheckedSettings,
    region: Option<&Observed>,
    shapes: Vec<ShapeInput>,
) -> Result<Statistics, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let region = region.map(|region| setup.region(region)).transpose()?;
    let Batch { control_points, weights } = read::read_batch(&setup.reading(&app.limits), shapes)?;
    let sizes = norms(&setup.metric, &setup.method, &control_points);
    let mixed = setup.rule().warning(Ways::of_points(&setup.space, &control_points));
    let context = app.pool.context();
    context.check()?;
    let stop = || context.is_cancelled();
    let (estimator, measured) = (setup.estimator, setup.measured());
    let (mean, aligned) = match region {
        Some(region) => {
            region.align(&setup.space, measured, setup.frame, &control_points, &weights, &stop)?
        }
        None => align_all_by(estimator, measured, setup.frame, control_points, weights.clone(), &stop)?,
    };
    Ok(Statistics { setup, mean, aligned, sizes, tangent: false, mixed, weights })
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
    let Statistics { setup, mean, .. } = statistics;
    let source = ShapesInMemory::prepared(statistics.compared()?, statistics.counting());
    let source = Watched::new(&source, &context);
    let found = Components::new(&source, &setup.metric, &mean.whitened, centre, components)?;
    let factors = mean.robust.as_ref().map(|robust| robust.factors.clone());
    Ok(Components { factors, ..found })
}

impl Statistics {
    /// Whitened aligned shapes, one after the other.
    fn whitened(&self) -> Vec<f64> {
        self.aligned.iter().flat_map(|shape| shape.whitened.iter().copied()).collect()
    }

    /// These statistics with the choice whether components are those of shapes in the tangent space.
    pub fn moved(self, tangent: bool) -> Self {
        Self { tangent, ..self }
    }

    /// The whitened shapes that components describe.
    fn compared(&self) -> Result<Vec<f64>, ServiceError> {
        let mut whitened = self.whitened();
        if self.tangent {
            for (k, shape) in whitened.chunks_exact_mut(self.setup.metric.len()).enumerate() {
                to_tangent(&self.mean.whitened, shape).map_err(|error| error.at(k))?;
            }
        }
        Ok(whitened)
    }

    /// Weights with which the shapes count: those given, times the factors of a robust mean.
    fn counting(&self) -> Vec<f64> {
        match &self.mean.robust {
            None => self.weights.clone(),
            Some(robust) => self.weights.iter().zip(&robust.factors).map(|(w, factor)| w * factor).collect(),
        }
    }

    /// Weights of the control points of every shape, if the mean is robust.
    ///
    /// # Errors
    /// A failure of the eigenproblem; [`ServiceError::Cancelled`].
    pub fn point_weights(&self, app: &App) -> Result<Option<Vec<Vec<f64>>>, ServiceError> {
        if self.mean.robust.is_none() {
            return Ok(None);
        }
        app.pool.context().check()?;
        Ok(Some(point_weights(self.setup.measured(), &self.whitened(), &self.counting())?))
    }
}

/// Projects shapes on a reference, or the reference on each shape. Degenerate shapes are refused in both directions.
///
/// # Errors
/// Faults of the input; degenerate shapes, or a degenerate reference at `/reference`. Under [`OnError::Skip`] those of
/// the shapes are among the outcomes.
pub fn project(
    app: &App,
    settings: CheckedSettings,
    onto: Onto,
    reference: ShapeInput,
    (shapes, on_error): (Vec<ShapeInput>, OnError),
) -> Result<Projected, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let reading = setup.reading(&app.limits);
    let (reference, shapes) = read::read_with_reference(&reading, reference, (shapes, on_error))?;
    let mixed = setup.rule().warning(Ways::of_each(&setup.space, &reference, &shapes));
    let both = BothWays::new(&setup.metric, &setup.method, reference)
        .map_err(|error| ServiceError::from_analysis(error, |_| "/reference".into()).without_index())?;
    let projections = shapes.each(&app.pool.context(), |index, (shape, _)| {
        both.project(&shape, onto).map_err(|error| of_shape(index, error))
    })?;
    let projections = projections.checked(on_error)?;
    Ok(Projected { setup, projections, mixed })
}

/// Projections of shapes.
#[derive(Debug)]
pub struct Projected {
    /// Prepared settings.
    pub setup: Setup,
    /// The projections, in input order.
    pub projections: Outcomes<Projection>,
    /// A warning of contours drawn both ways round, the reference among them, if that matters.
    pub mixed: Option<String>,
}

/// Drawing of a mean with aligned shapes behind it; `unit`: the unit of length, if known.
pub fn draw_mean(
    setup: &Setup,
    title: &str,
    mean: &MeanShape,
    aligned: &[AlignedShape],
    unit: Option<&str>,
) -> Drawing {
    let counted = (mean.control_points.as_slice(), mean.shapes);
    let view = setup.view(counted.0);
    setup.in_scale(drawing::draw_mean(&view, &setup.metric, title, counted, aligned, MAX_DRAWN), unit)
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
) -> Result<Drawing, ServiceError> {
    let pca = &components.pca;
    let found = pca.eigenvalues.len();
    if !(1..=found).contains(&component) {
        let detail = format!("expected a number between 1 and {found}, got {component}");
        return Err(ServiceError::parameter("component", detail));
    }
    let setup = &statistics.setup;
    let mode = components.mode(component - 1, sigma).map(|shape| unwhitened(&setup.metric, &shape));
    let title = drawing::mode_title(component, pca.explained[component - 1], pca.centred);
    let view = setup.view(&statistics.mean.control_points);
    Ok(setup.in_scale(drawing::draw_mode(&view, &title, sigma, &mode), None))
}
