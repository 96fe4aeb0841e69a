//! Use of dictionaries: codes, reconstructions, scores, priors, samples. The functions are synchronous and run on the
//! pool.
//!
//! They read and limit the shapes; the arithmetic is in [`analysis::dictionary`](crate::analysis::dictionary).

use super::ready::Ready;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::dictionary::coding::{AnswerPose, CodedShape, Reconstruction};
use crate::analysis::dictionary::modes::Sample;
use crate::analysis::dictionary::prior::{Energy, Reference};
use crate::analysis::dictionary::score::Score;
use crate::formats::fault::Fault;
use crate::formats::shape::ShapeInput;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::catalogue;
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::read::{self, Reading};

/// Shapes to which a dictionary is applied.
#[derive(Debug)]
pub enum Asked {
    /// Posted shapes.
    Posted(Vec<ShapeInput>),
    /// Control points of stored shapes.
    Stored(Vec<f64>),
}

impl Asked {
    /// Predicted work of encoding the shapes and answering `numbers` numbers for each.
    pub fn work(&self, ready: &Ready, numbers: usize, limits: &Limits) -> Work {
        let count = match self {
            Self::Posted(shapes) => shapes.len(),
            Self::Stored(control_points) => control_points.len() / ready.setup.metric.len(),
        };
        ready.work(count, numbers, limits)
    }
}

/// Control points of stored shapes with these ids or external ids.
///
/// # Errors
/// A cohort that does not exist, or that has another representation or correspondence; shapes that do not exist.
pub async fn stored(app: &App, ready: &Ready, cohort: &str, ids: &[String]) -> Result<Asked, ServiceError> {
    let cohort = catalogue::find(app, cohort).await?;
    let content = &ready.dictionary.content;
    if cohort.spec.representation != content.representation
        || cohort.spec.correspondence != content.correspondence
    {
        let detail = format!(
            "expected a cohort with the representation and correspondence of the dictionary, those of '{}' \
             differ",
            cohort.spec.name
        );
        return Err(ServiceError::invalid("/cohort", detail));
    }
    let shapes = crate::service::cohorts::source::find_all(app, &cohort, ids).await?;
    Ok(Asked::Stored(shapes.into_iter().flat_map(|shape| shape.control_points).collect()))
}

impl Asked {
    /// Control points, one shape after the other, read under `correspondence`.
    fn control_points(
        self,
        app: &App,
        ready: &Ready,
        correspondence: Correspondence,
    ) -> Result<Vec<f64>, ServiceError> {
        let control_points = match self {
            Self::Stored(control_points) => control_points,
            Self::Posted(shapes) => {
                let (space, direction) = (&ready.setup.space, ready.dictionary.content.direction);
                let reading = Reading { space, correspondence, direction, limits: &app.limits };
                read::read_batch(&reading, shapes)?.control_points
            }
        };
        if control_points.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        Ok(control_points)
    }
}

impl Ready {
    /// Predicted work of encoding `shapes` shapes, and of answering `numbers` numbers for each in addition to its code.
    pub fn work(&self, shapes: usize, numbers: usize, limits: &Limits) -> Work {
        let (length, model) = (self.setup.metric.len(), &self.dictionary.model);
        let counts = Counts::new(&self.dictionary.content.representation, shapes, limits);
        let numbers = numbers.min(limits.samples) as f64 + length as f64 + model.len() as f64;
        requests::encode(counts, model.work(length), numbers, self.setup.matching.searches())
    }
}

/// Encodes shapes.
///
/// # Errors
/// Faults of the shapes; degenerate shapes; [`ServiceError::Cancelled`].
pub fn encode(app: &App, ready: &Ready, asked: Asked) -> Result<Vec<CodedShape>, ServiceError> {
    let control_points = asked.control_points(app, ready, ready.dictionary.content.correspondence)?;
    Ok(ready.dictionary.encode(&control_points, &app.pool.context())?)
}

/// Reconstructs shapes from their codes, with the distances at `samples` parameters.
///
/// # Errors
/// Faults of the shapes; degenerate shapes, including those that the alignment makes degenerate.
pub fn reconstruct_shapes(
    app: &App,
    ready: &Ready,
    asked: Asked,
    pose: AnswerPose,
    samples: usize,
) -> Result<Vec<Reconstruction>, ServiceError> {
    let coded = encode(app, ready, asked)?;
    check_samples(app, samples, coded.len())?;
    let (dictionary, space) = (&ready.dictionary, &ready.setup.space);
    let reconstruct = |(index, coded): (usize, &CodedShape)| {
        let reconstruction = dictionary.reconstruct(space, coded, pose, samples);
        Ok(reconstruction.map_err(|error| error.at(index))?)
    };
    coded.iter().enumerate().map(reconstruct).collect()
}

/// Checks the total number of requested distances.
pub(crate) fn check_samples(app: &App, samples: usize, shapes: usize) -> Result<(), ServiceError> {
    let (total, most) = (samples.saturating_mul(shapes), app.limits.samples);
    if total > most {
        let detail = format!("expected at most {most} distances over all shapes, got {total}");
        return Err(ServiceError::invalid("/samples", detail));
    }
    Ok(())
}

/// A code of a shape.
#[derive(Debug, Clone, PartialEq, serde::Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PostedCode {
    /// Indices of the atoms in use, from 0.
    pub indices: Vec<usize>,
    /// Coefficients, one per index. Excludes `matrices`.
    #[serde(default)]
    pub values: Option<Vec<f64>>,
    /// Matrices of the atoms, row by row, one per index; for invariant codes.
    #[serde(default)]
    pub matrices: Option<Vec<Vec<Vec<f64>>>>,
    /// Translation of the result, for invariant codes. Default: zero.
    #[serde(default)]
    pub offset: Option<Vec<f64>>,
}

/// Maximum absolute value of a number in a posted code.
const MOST: f64 = 1e100;

/// Reconstructs shapes from posted codes: in the pose of the dictionary, or as given by matrices and offset.
///
/// # Errors
/// All faults of the codes, at `/codes/{index}…`.
pub fn reconstruct_codes(
    app: &App,
    ready: &Ready,
    codes: &[PostedCode],
) -> Result<Vec<Reconstruction>, ServiceError> {
    if codes.is_empty() || codes.len() > app.limits.shapes {
        let detail = format!("expected between 1 and {1} codes, got {0}", codes.len(), app.limits.shapes);
        return Err(ServiceError::invalid("/codes", detail));
    }
    let mut faults = Vec::new();
    for (index, code) in codes.iter().enumerate() {
        let found = code_faults(ready, code);
        faults.extend(found.into_iter().map(|(field, detail)| Fault {
            index: Some(index),
            ..Fault::new(format!("/codes/{index}{field}"), detail)
        }));
    }
    ServiceError::unless_empty(faults)?;
    let context = app.pool.context();
    codes.iter().map(|code| context.check().map(|()| reconstruct_code(ready, code))).collect()
}

fn code_faults(ready: &Ready, code: &PostedCode) -> Vec<(String, String)> {
    let mut faults = Vec::new();
    let (atoms, d) = (ready.dictionary.model.len(), ready.setup.metric.dimension());
    for (position, &index) in code.indices.iter().enumerate() {
        if index >= atoms {
            faults.push((
                format!("/indices/{position}"),
                format!("expected an index below {atoms}, the number of atoms, got {index}"),
            ));
        }
        if code.indices[..position].contains(&index) {
            faults.push((format!("/indices/{position}"), format!("the index {index} is given twice")));
            break;
        }
    }
    let wanted = code.indices.len();
    let bounded = |value: &f64| value.abs() <= MOST;
    let given = if ready.dictionary.is_invariant() { "matrices" } else { "values" };
    let fits = if ready.dictionary.is_invariant() {
        code.matrices.as_ref().is_some_and(|matrices| {
            let square = |m: &Vec<Vec<f64>>| m.len() == d && m.iter().all(|row| row.len() == d);
            matrices.len() == wanted
                && matrices.iter().all(square)
                && matrices.iter().flatten().flatten().all(bounded)
        }) && code.values.is_none()
    } else {
        code.values.as_ref().is_some_and(|values| values.len() == wanted && values.iter().all(bounded))
            && code.matrices.is_none()
            && code.offset.is_none()
    };
    if !fits {
        let detail = match given {
            "values" => format!("expected {wanted} numbers, one per index, without matrices and offset"),
            _ => format!("expected {wanted} matrices of {d} × {d} numbers, one per index, without values"),
        };
        faults.push((format!("/{given}"), detail));
    }
    if code.offset.as_ref().is_some_and(|offset| offset.len() != d || !offset.iter().all(bounded)) {
        faults.push(("/offset".into(), format!("expected {d} numbers")));
    }
    faults
}

fn reconstruct_code(ready: &Ready, code: &PostedCode) -> Reconstruction {
    let (dictionary, indices) = (&ready.dictionary, &code.indices);
    let control_points = match (&code.matrices, &code.values) {
        (Some(matrices), _) => {
            let square = |rows: &Vec<Vec<f64>>| Matrix::from_fn(rows.len(), rows.len(), |i, k| rows[i][k]);
            let matrices: Vec<Matrix> = matrices.iter().map(square).collect();
            let zero = || vec![0.0; ready.setup.metric.dimension()];
            dictionary.combine_moved(indices, &matrices, &code.offset.clone().unwrap_or_else(zero))
        }
        (None, values) => dictionary.combine(indices, values.as_deref().unwrap_or_default()),
    };
    Reconstruction { control_points, relative_error: None, residual: Vec::new() }
}

/// Scores shapes. Among shapes like those of the training, the fraction `1 − quantile` counts as outliers.
///
/// # Errors
/// Faults of the shapes or of the quantile; degenerate shapes.
pub fn score(app: &App, ready: &Ready, asked: Asked, quantile: f64) -> Result<Vec<Score>, ServiceError> {
    check_quantile(quantile)?;
    let coded = encode(app, ready, asked)?;
    Ok(coded.iter().map(|coded| ready.dictionary.score(coded, quantile)).collect())
}

/// Checks the range of a training quantile.
pub(crate) fn check_quantile(quantile: f64) -> Result<(), ServiceError> {
    if (0.5..1.0).contains(&quantile) {
        return Ok(());
    }
    Err(ServiceError::invalid(
        "/quantile",
        format!("expected a number of at least 0.5 and below 1, got {quantile}"),
    ))
}

/// Caveats about the outliers that a dictionary reports.
pub fn outlier_warnings(ready: &Ready) -> Vec<String> {
    match ready.dictionary.content.statistics.held_out {
        Some(_) => Vec::new(),
        None => vec![IN_SAMPLE.into()],
    }
}

const IN_SAMPLE: &str = "this dictionary has no measures of held-out shapes: outliers and ranks are relative to \
                         the shapes it was learnt from, which it describes better than new shapes, so that more \
                         new shapes are called outliers than the quantile says. Learn it again";

/// Energy and gradient of the shape prior. Points correspond as given: no start point is searched.
///
/// # Errors
/// Faults of the shapes and of `gamma`; a dictionary whose class is not linear.
pub fn prior(
    app: &App,
    ready: &Ready,
    asked: Asked,
    reference: Reference,
    gamma: f64,
) -> Result<Vec<Energy>, ServiceError> {
    if !(gamma > 0.0 && gamma <= MOST) {
        return Err(ServiceError::invalid(
            "/gamma",
            format!("expected a positive number up to 1e100, got {gamma}"),
        ));
    }
    let prior = ready.dictionary.prior(reference, gamma)?;
    let control_points = asked.control_points(app, ready, Correspondence::Landmarks)?;
    let (context, shapes) = (app.pool.context(), control_points.chunks_exact(ready.setup.metric.len()));
    shapes.map(|shape| context.check().map(|()| prior.energy(shape))).collect()
}

/// Draws shapes from the normal distribution of the training scores, scaled by `sigma`; the same seed gives the same
/// shapes.
///
/// # Errors
/// A sparse dictionary; a count or sigma out of bounds.
pub fn sample(
    app: &App,
    ready: &Ready,
    count: usize,
    seed: u64,
    sigma: f64,
) -> Result<Vec<Sample>, ServiceError> {
    let Some(mut sampler) = ready.dictionary.sampler(seed, sigma) else {
        let detail = "is sparse: only functional_pca describes how shapes spread";
        return Err(ServiceError::invalid("", format!("the dictionary {detail}")));
    };
    let mut faults = Vec::new();
    let total = count.saturating_mul(ready.setup.metric.size());
    if count == 0 || total > app.limits.samples {
        let most = app.limits.samples / ready.setup.metric.size().max(1);
        faults.push(Fault::new("/count", format!("expected a number between 1 and {most}, got {count}")));
    }
    if !(0.0..=MAX_SIGMA).contains(&sigma) {
        faults
            .push(Fault::new("/sigma", format!("expected a number between 0 and {MAX_SIGMA}, got {sigma}")));
    }
    ServiceError::unless_empty(faults)?;
    let context = app.pool.context();
    (0..count).map(|_| context.check().map(|()| sampler.draw())).collect()
}

/// Maximum `sigma`.
const MAX_SIGMA: f64 = 1e6;
