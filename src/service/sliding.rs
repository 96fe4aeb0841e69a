//! Semilandmarks of posted or stored shapes that slide until they correspond.

use serde::{Deserialize, Serialize};

use crate::analysis::sliding::error::SlidingError;
use crate::analysis::sliding::table::{Sliders, curves_of_counts, rows_of_curves, rows_of_text};
use crate::analysis::sliding::{Slid, SlidingCriterion, centred, gpagen};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeAttributes;
use crate::geometry::capability::domain::Domain;
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError};
use crate::service::cohorts::{attributes, catalogue, source};
use crate::service::cost::requests;
use crate::service::shapes::read;
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Protocol of the rounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SlidingProtocol {
    /// From the points as given, with displacements whose mean over the shapes is 0: converges, and does not depend on the order of shapes.
    #[default]
    Centred,
    /// As geomorph's `gpagen` does, for reproduction.
    Gpagen,
}

/// Source of sliders.
#[derive(Debug, Clone, PartialEq)]
pub enum SliderSource {
    /// None along curves.
    None,
    /// Rows *before, slide, after*, from 0.
    Rows(Vec<[usize; 3]>),
    /// The text of a table, whose numbers begin with 1.
    Text(String),
    /// Points along each curve, from 0.
    Curves(Vec<Vec<usize>>),
    /// Curves as the metadata of the shapes tell them; points between which those of a curve lie.
    Auto(Vec<Option<[usize; 2]>>),
}

/// Shapes that are to slide.
#[derive(Debug)]
pub enum SlidingShapes {
    /// Shapes of the request.
    Posted(Vec<ShapeInput>),
    /// Shapes of a cohort that pass a filter.
    Cohort(String, Box<ShapeFilter>),
}

/// A checked request.
#[derive(Debug)]
pub struct SlidingRequest {
    /// The shapes.
    pub shapes: SlidingShapes,
    /// Sliders along curves.
    pub sliders: SliderSource,
    /// Sliders on surfaces.
    pub surface: Vec<usize>,
    /// Criterion to minimise.
    pub criterion: SlidingCriterion,
    /// Protocol of the rounds.
    pub protocol: SlidingProtocol,
    /// `gpagen`: whether shapes are projected into the tangent space, and turned by principal axes.
    pub options: [bool; 2],
}

/// Shapes that have slid, with their attributes.
#[derive(Debug)]
pub struct SlidingFound {
    /// Attributes of the shapes, in their order.
    pub attributes: Vec<ShapeAttributes>,
    /// `d`.
    pub dimension: usize,
    /// The sliders.
    pub sliders: Sliders,
    /// Results.
    pub slid: Slid,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Maximum number of points of a shape, and of directions in which they slide: systems have their square.
const MAX_POINTS: usize = 2000;
/// Maximum number of curves.
const MAX_CURVES: usize = 1000;
/// Copies of all shapes at the same time.
const COPIES: usize = 10;
/// Displacements of all shapes that the acceleration keeps.
const ITERATES: usize = 16;
/// Fewest shapes: the displacements of one have the mean 0.
const MIN_SHAPES: usize = 2;

/// A shape as given.
struct Given {
    attributes: ShapeAttributes,
    /// Coordinate-major.
    points: Vec<f64>,
}

/// Shapes with the same number of points.
struct Specimens {
    given: Vec<Given>,
    dimension: usize,
    /// Whether they were posted.
    posted: bool,
    /// Memory of all copies of the shapes.
    _room: Held,
}

/// Slides the shapes of a request.
///
/// # Errors
/// All faults of the shapes and sliders, at their places; an unknown cohort; more work than a request may take.
pub async fn slide(app: &App, request: SlidingRequest) -> Result<SlidingFound, ServiceError> {
    let SlidingRequest { shapes, sliders, surface, criterion, protocol, options } = request;
    let specimens = match shapes {
        SlidingShapes::Posted(shapes) => Specimens::posted(app, shapes)?,
        SlidingShapes::Cohort(key, filter) => Specimens::stored(app, &key, &filter).await?,
    };
    let sliders = specimens.sliders(&sliders, &surface)?;
    let (count, size) = (specimens.given.len(), specimens.size());
    let bends = criterion == SlidingCriterion::BendingEnergy;
    let work = requests::slide([count, size, sliders.directions()], bends);
    work.check(app.limits.request_work.as_secs_f64())?;
    let task_app = app.clone();
    let task = move || specimens.slide(&task_app, sliders, criterion, (protocol, options));
    app.pool.weighing(work).run(task).await
}

impl Specimens {
    fn posted(app: &App, shapes: Vec<ShapeInput>) -> Result<Self, ServiceError> {
        let mut faults = Faults::default();
        let mut given: Vec<Given> = Vec::new();
        let mut dimension = None;
        for (k, shape) in shapes.into_iter().enumerate() {
            let size =
                given.first().zip(dimension).map(|(first, d): (&Given, usize)| [first.points.len() / d, d]);
            match read(shape, size, &app.limits) {
                Ok((one, d)) => {
                    dimension.get_or_insert(d);
                    given.push(one);
                }
                Err(found) => {
                    let below = |fault: Fault| fault.below(&format!("/shapes/{k}")).at_shape(k);
                    faults.extend(found.into_iter().map(below));
                }
            }
        }
        faults.unless_any()?;
        let dimension = dimension.unwrap_or(2);
        let size = given.first().map_or(0, |first| first.points.len() / dimension);
        let room = room(app, [given.len(), size, dimension], "/shapes")?;
        Ok(Self { given, dimension, posted: true, _room: room })
    }

    async fn stored(app: &App, key: &str, filter: &ShapeFilter) -> Result<Self, ServiceError> {
        let cohort = catalogue::find(app, key).await.map_err(|error| error.named_at("/cohort"))?;
        let representation = &cohort.spec.representation;
        let described = attributes::describe(app, &cohort, filter, "/filter").await?;
        if representation.domain() != Domain::Points {
            return Err(ServiceError::invalid(
                "/cohort",
                "expected a cohort of landmarks, got one of other shapes",
            ));
        }
        let dimension = representation.dimension();
        let room = room(app, [described.len(), representation.size(), dimension], "/filter")?;
        let ids: Vec<String> = described.into_iter().map(|shape| shape.id).collect();
        let given = Self::of_ids(app, &cohort, &ids).await?;
        Ok(Self { given, dimension, posted: false, _room: room })
    }

    async fn of_ids(app: &App, cohort: &Cohort, ids: &[String]) -> Result<Vec<Given>, ServiceError> {
        let shapes = source::find_all(app, cohort, ids).await?;
        let given = shapes.into_iter().map(|shape| {
            let mut attributes = shape.attributes;
            attributes.external_id.get_or_insert(shape.id);
            Given { attributes, points: shape.control_points }
        });
        Ok(given.collect())
    }

    /// Number of points of a shape.
    fn size(&self) -> usize {
        self.given.first().map_or(0, |first| first.points.len() / self.dimension)
    }

    /// The sliders of all shapes.
    fn sliders(&self, source: &SliderSource, surface: &[usize]) -> Result<Sliders, ServiceError> {
        let rows = match source {
            SliderSource::None => Vec::new(),
            SliderSource::Rows(rows) => rows.clone(),
            SliderSource::Text(text) => rows_of_text(text).map_err(|(line, detail)| {
                ServiceError::invalid("/sliders", format!("line {line}: {detail}"))
            })?,
            SliderSource::Curves(curves) if curves.len() > MAX_CURVES => {
                let detail = format!("expected at most {MAX_CURVES} curves, got {}", curves.len());
                return Err(ServiceError::invalid("/curves", detail));
            }
            SliderSource::Curves(curves) => rows_of_curves(curves),
            SliderSource::Auto(attach) => rows_of_curves(&self.told_curves(attach)?),
        };
        let sliders = Sliders::new([self.size(), self.dimension], &rows, surface).map_err(|error| {
            let (pointer, detail) = match (&error, source) {
                (SlidingError::Row { position, .. }, SliderSource::Rows(_)) => {
                    (format!("/sliders/{position}"), error.to_string())
                }
                (SlidingError::Row { .. }, SliderSource::Curves(_)) => ("/curves".into(), error.to_string()),
                (SlidingError::Row { position, .. }, _) => {
                    ("/sliders".into(), format!("row {}: {error}", position + 1))
                }
                (SlidingError::Surface { position, .. }, _) => {
                    (format!("/surface/{position}"), error.to_string())
                }
                _ => ("/sliders".into(), error.to_string()),
            };
            ServiceError::invalid(&pointer, detail)
        })?;
        let directions = sliders.directions();
        if directions > MAX_POINTS {
            let detail = format!(
                "expected at most {MAX_POINTS} directions, one of a point on a curve and two on a surface"
            );
            return Err(ServiceError::invalid("/sliders", format!("{detail}, got {directions}")));
        }
        Ok(sliders)
    }

    /// Curves as the metadata tell them.
    fn told_curves(&self, attach: &[Option<[usize; 2]>]) -> Result<Vec<Vec<usize>>, ServiceError> {
        let mut common: Option<(usize, Vec<usize>)> = None;
        for (k, given) in self.given.iter().enumerate() {
            let refused = |detail: String| {
                Err(match self.posted {
                    true => ServiceError::invalid(format!("/shapes/{k}/metadata"), detail),
                    false => {
                        let name = given.attributes.external_id.as_deref().unwrap_or_default();
                        ServiceError::invalid("/sliders", format!("{detail}, of the shape '{name}'"))
                    }
                })
            };
            let Some(told) = told_curves(given.attributes.metadata.as_deref()) else {
                let wanted = "expected landmarks and curves in the metadata, as files of TPS read with curves=append have them";
                return refused(format!("{wanted}, got none"));
            };
            let sum = told.1.iter().fold(told.0, |sum, count| sum.saturating_add(*count));
            if sum != self.size() {
                return refused(format!(
                    "expected {} landmarks and points of curves, got {sum}",
                    self.size()
                ));
            }
            match &common {
                Some(common) if *common != told => {
                    return refused("expected the curves of the first shape, got others".into());
                }
                _ => common = Some(told),
            }
        }
        let (landmarks, counts) = common.unwrap_or_default();
        if attach.len() > counts.len() {
            let detail = format!(
                "expected at most one pair for each of {} curves, got {}",
                counts.len(),
                attach.len()
            );
            return Err(ServiceError::invalid("/attach", detail));
        }
        Ok(curves_of_counts(landmarks, &counts, attach))
    }

    fn slide(
        self,
        app: &App,
        sliders: Sliders,
        criterion: SlidingCriterion,
        (protocol, options): (SlidingProtocol, [bool; 2]),
    ) -> Result<SlidingFound, ServiceError> {
        let (size, directions) = (self.size(), sliders.directions());
        let numbers = ITERATES * self.given.len() * directions + 4 * (size * size + directions * directions);
        let _systems = app.memory.hold(Purpose::Bodies, size_of::<f64>() * numbers)?;
        let Self { given, dimension, posted, _room } = self;
        let (attributes, shapes): (Vec<ShapeAttributes>, Vec<Vec<f64>>) =
            given.into_iter().map(|one| (one.attributes, one.points)).unzip();
        let watch = app.pool.context();
        let how = (dimension, criterion);
        let slid = match protocol {
            SlidingProtocol::Centred => centred::slide(&shapes, &sliders, how, &watch),
            SlidingProtocol::Gpagen => gpagen::slide(&shapes, &sliders, how, options, &watch),
        };
        let slid = slid.map_err(|error| refused(error, posted, &attributes))?;
        let warnings = warnings(&slid, protocol);
        Ok(SlidingFound { attributes, dimension, sliders, slid, warnings })
    }
}

/// Checks the numbers of shapes, points and coordinates, and takes the memory of all copies before shapes are read.
fn room(app: &App, [count, size, dimension]: [usize; 3], pointer: &str) -> Result<Held, ServiceError> {
    let (limits, refused) = (&app.limits, |detail: String| Err(ServiceError::invalid(pointer, detail)));
    let most = limits.shapes;
    if !(MIN_SHAPES..=most).contains(&count) {
        return refused(format!("expected between {MIN_SHAPES} and {most} shapes, got {count}"));
    }
    if size > MAX_POINTS {
        return refused(format!("expected shapes of at most {MAX_POINTS} points, got {size}"));
    }
    let numbers = count * size * dimension;
    if numbers > limits.coordinates {
        return refused(format!("expected at most {} coordinates, got {numbers}", limits.coordinates));
    }
    app.memory.hold(Purpose::Bodies, size_of::<f64>() * COPIES * numbers)
}

/// Numbers of landmarks and of the points of each curve, from metadata.
fn told_curves(metadata: Option<&str>) -> Option<(usize, Vec<usize>)> {
    #[derive(Deserialize)]
    struct Told {
        landmarks: usize,
        curves: Vec<usize>,
    }
    let told: Told = serde_json::from_str(metadata?).ok()?;
    (told.curves.len() <= MAX_CURVES).then_some((told.landmarks, told.curves))
}

/// Reads a posted shape of `size` points and coordinates, or of any number; returns it with its dimension.
fn read(
    mut shape: ShapeInput,
    size: Option<[usize; 2]>,
    limits: &Limits,
) -> Result<(Given, usize), Vec<Fault>> {
    let lists = [("/points", shape.points.take()), ("/control_points", shape.control_points.take())];
    let attributes = read::attributes(shape)?;
    let given =
        lists.into_iter().find_map(|(pointer, list)| Some((pointer, list.filter(|list| !list.is_null())?)));
    let Some((pointer, list)) = given else { return Err(vec![Fault::new("", "expected points, got none")]) };
    let refused = |detail: String| Err(vec![Fault::new(pointer, detail)]);
    if list.grid().is_some() {
        return refused("expected a list of points, got a grid".into());
    }
    if list.len() > limits.points {
        return refused(format!("expected at most {} points, got {}", limits.points, list.len()));
    }
    let [points, dimension] = size.unwrap_or([list.len(), list.width().clamp(2, 3)]);
    if list.len() != points {
        return refused(format!("expected {points} points as in the first shape, got {}", list.len()));
    }
    let below = |found: Vec<Fault>| found.into_iter().map(|fault| fault.below(pointer)).collect::<Vec<_>>();
    let rows = list.checked(dimension).map_err(below)?;
    let points = Matrix::from_row_slice(points, dimension, rows).as_slice().to_vec();
    Ok((Given { attributes, points }, dimension))
}

/// Warnings about a result.
fn warnings(slid: &Slid, protocol: SlidingProtocol) -> Vec<String> {
    let mut warnings = Vec::new();
    let moved = slid.last_move;
    match protocol {
        SlidingProtocol::Gpagen => {
            warnings.push(format!(
                "the iteration of gpagen does not converge: the consensus moved by {moved:.1e} of its size in the last round; the result \
                 depends on the order of the shapes"
            ));
            let count = slid.aligned.len() as f64;
            if slid.criterion.last().is_some_and(|value| *value > count) {
                warnings.push("shapes have grown beyond unit size while they slid".into());
            }
        }
        SlidingProtocol::Centred if !slid.converged => warnings.push(format!(
            "no convergence after {} rounds: the consensus moved by {moved:.1e} of its size in the last one",
            slid.rounds
        )),
        SlidingProtocol::Centred => {}
    }
    if slid.passed > 0 {
        warnings.push(format!(
            "{} displacements along curves are longer than the distance to the next point: points slide along straight chords, and may \
             have left the curve",
            slid.passed
        ));
    }
    warnings
}

/// Refusal of shapes that do not slide.
fn refused(error: SlidingError, posted: bool, attributes: &[ShapeAttributes]) -> ServiceError {
    let detail = error.to_string();
    let of_shape = |k: usize, part: &str| {
        let fault = match posted {
            true => Fault::new(format!("/shapes/{k}{part}"), detail.clone()),
            false => {
                let name = attributes.get(k).and_then(|one| one.external_id.as_deref()).unwrap_or_default();
                Fault::new("/cohort", format!("{detail} (shape '{name}')"))
            }
        };
        ServiceError::below(vec![fault.at_shape(k)], "")
    };
    match error {
        SlidingError::NoExtent { shape } => of_shape(shape, "/points"),
        SlidingError::NoDirection { shape, point } => of_shape(shape, &format!("/points/{point}")),
        SlidingError::Cancelled => ServiceError::Cancelled,
        SlidingError::Consensus(_) => {
            ServiceError::invalid(if posted { "/shapes" } else { "/cohort" }, detail)
        }
        SlidingError::Surface { .. }
        | SlidingError::Row { .. }
        | SlidingError::NoSliders
        | SlidingError::Free { .. }
        | SlidingError::OnePlace { .. } => ServiceError::invalid("/sliders", detail),
    }
}
