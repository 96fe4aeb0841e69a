//! Use of dictionaries: codes, reconstructions, scores, priors, samples. The functions are synchronous and run on the
//! pool.
//!
//! Shapes are prepared as in learning, then encoded in the components or sparse atoms of the dictionary.

use crate::formats::fault::Fault;
use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

use super::ready::Ready;
use crate::analysis::AnalysisError;
use crate::analysis::alignment::Method as Alignment;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::dictionary::content::{HeldOutMeasure, HeldOutStatistics, Statistics};
use crate::analysis::dictionary::model::{Model, error_of, squared_distance};
use crate::analysis::dictionary::novelty::{self, Logarithms, Novelty};
use crate::analysis::dictionary::preparation::Prepared;
use crate::analysis::dictionary::prior::{Energy, Prior};
use crate::analysis::sparse::SparseCode;
use crate::formats::shape::ShapeInput;
use crate::geometry::sampling::Places;
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
    if cohort.representation != content.representation || cohort.correspondence != content.correspondence {
        let detail = format!(
            "expected a cohort with the representation and correspondence of the dictionary, those of '{}' \
             differ",
            cohort.name
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

/// Transformed atoms that approximate a shape: `r ≈ Σ_j B_j d_j + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Moves {
    /// Matrices `B_j`, `d × d`, one per atom in use.
    pub matrices: Vec<Matrix>,
    /// Offset `b`, of length `d`.
    pub offset: Vec<f64>,
}

/// A shape with its code.
#[derive(Debug)]
pub struct Coded {
    /// The given shape, `d·N` coordinate-major control points.
    pub control_points: Vec<f64>,
    /// The prepared shape that is encoded.
    pub prepared: Prepared,
    /// Code of the shape.
    pub code: SparseCode,
}

impl Ready {
    /// Predicted work of encoding `shapes` shapes, and of answering `numbers` numbers for each in addition to its code.
    pub fn work(&self, shapes: usize, numbers: usize, limits: &Limits) -> Work {
        let (n, atoms) = (self.setup.metric.len() as f64, self.model.len() as f64);
        let multiply_adds = match &self.model {
            Model::Components { .. } => n * atoms,
            Model::Sparse { algebra, .. } => {
                // As for the path of a code in `cost::jobs`: a third of the columns is in use at its end.
                let columns = atoms * algebra.parameters().max(1) as f64;
                let used = (0.3 * columns).min(n);
                n * columns + used * columns * used.sqrt() + used * n
            }
        };
        let counts = Counts::new(&self.dictionary.content.representation, shapes, limits);
        let numbers = numbers.min(limits.samples) as f64 + n + atoms;
        requests::encode(counts, multiply_adds, numbers, self.setup.matching.searches())
    }
}

/// Number of shapes encoded between two checks for cancellation.
const TOGETHER: usize = 1024;

/// Encodes shapes.
///
/// # Errors
/// Faults of the shapes; degenerate shapes; [`ServiceError::Cancelled`].
pub fn encode(app: &App, ready: &Ready, asked: Asked) -> Result<Vec<Coded>, ServiceError> {
    let correspondence = ready.dictionary.content.correspondence;
    let control_points = asked.control_points(app, ready, correspondence)?;
    let length = ready.setup.metric.len();
    let context = app.pool.context();
    // All shapes are checked before the first one is encoded.
    let mut prepared = Vec::with_capacity(control_points.len() / length);
    for (part, shapes) in control_points.chunks(TOGETHER * length).enumerate() {
        context.check()?;
        prepared.extend(ready.preparation.prepare(shapes).map_err(|error| error.after(part * TOGETHER))?);
    }
    let mut coded = Vec::with_capacity(prepared.len());
    let mut prepared = prepared.into_iter();
    for (part, shapes) in control_points.chunks(TOGETHER * length).enumerate() {
        context.check()?;
        let together: Vec<Prepared> = prepared.by_ref().take(shapes.len() / length).collect();
        let whitened: Vec<f64> = together.iter().flat_map(|shape| shape.whitened.iter().copied()).collect();
        let codes = ready.model.codes(&whitened, length).map_err(|error| error.after(part * TOGETHER))?;
        let shapes = shapes.chunks_exact(length).zip(together).zip(codes);
        coded.extend(shapes.map(|((shape, prepared), code)| Coded {
            control_points: shape.to_vec(),
            prepared,
            code,
        }));
    }
    Ok(coded)
}

impl Coded {
    /// Transformations of the atoms in the pose of the shape; `None` unless codes are invariant.
    ///
    /// # Errors
    /// A degenerate shape, whose normal form cannot be inverted.
    pub fn moves(&self, ready: &Ready) -> Result<Option<Moves>, ServiceError> {
        let Model::Sparse { algebra, .. } = &ready.model else { return Ok(None) };
        if !ready.is_invariant() {
            return Ok(None);
        }
        let (back, offset) = self.prepared.back()?;
        let members = self.code.values.chunks_exact(algebra.parameters());
        let matrices = members.map(|values| &back * algebra.member(values)).collect();
        Ok(Some(Moves { matrices, offset }))
    }

    /// Coefficients, one per atom in use; for invariant codes the norms `‖D_j B_jᵀ‖`, which do not depend on the pose.
    pub fn magnitudes(&self, ready: &Ready) -> Vec<f64> {
        match &ready.model {
            Model::Sparse { algebra, .. } if ready.is_invariant() => {
                let blocks = self.code.values.chunks_exact(algebra.parameters());
                blocks.map(|block| block.iter().map(|value| value * value).sum::<f64>().sqrt()).collect()
            }
            _ => self.code.values.clone(),
        }
    }
}

impl Ready {
    /// Whether codes are invariant: atoms are transformed by members of the class.
    pub fn is_invariant(&self) -> bool {
        matches!(self.preparation.pose, crate::analysis::dictionary::preparation::Pose::Invariant(_))
    }
}

/// Pose of reconstructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnswerPose {
    /// Pose of the shape.
    #[default]
    Input,
    /// Pose of the dictionary: aligned, normalised.
    Model,
}

/// A reconstructed shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// Control points, `d·N` coordinate-major numbers.
    pub control_points: Vec<f64>,
    /// Relative error `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary; only for shapes.
    pub relative_error: Option<f64>,
    /// Distances between shape and reconstruction at equally spaced parameters; only for shapes.
    pub residual: Vec<f64>,
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
    let reconstruct = |(index, coded): (usize, &Coded)| {
        let y = ready.model.reconstruct(&coded.code);
        let relative_error = Some(error_of(&coded.prepared.whitened, &y));
        let [shape, answer] = posed(ready, coded, y, pose).map_err(|error| error.at(index))?;
        let residual = distances(ready, &shape, &answer, samples);
        Ok(Reconstruction { control_points: answer, relative_error, residual })
    };
    coded.iter().enumerate().map(reconstruct).collect()
}

/// A shape and its reconstruction `y`, both in the requested pose.
fn posed(
    ready: &Ready,
    coded: &Coded,
    y: Vec<f64>,
    pose: AnswerPose,
) -> Result<[Vec<f64>; 2], AnalysisError> {
    let mut shapes = [coded.prepared.whitened.clone(), y];
    shapes.iter_mut().for_each(|x| ready.setup.metric.unwhiten(x));
    if pose == AnswerPose::Input {
        let (matrix, offset) = coded.prepared.back()?;
        shapes.iter_mut().for_each(|x| transform(x, &matrix, &offset));
    }
    Ok(shapes)
}

/// Distances between a shape and its reconstruction `y` in the pose of the shape, at `samples` parameters.
///
/// # Errors
/// A shape that the alignment makes degenerate.
pub(crate) fn residual(
    ready: &Ready,
    coded: &Coded,
    y: Vec<f64>,
    samples: usize,
) -> Result<Vec<f64>, ServiceError> {
    let [shape, answer] = posed(ready, coded, y, AnswerPose::Input)?;
    Ok(distances(ready, &shape, &answer, samples))
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

/// Transforms each point: `r ← M r + b`.
fn transform(control_points: &mut [f64], matrix: &Matrix, offset: &[f64]) {
    let d = offset.len();
    let n = control_points.len() / d;
    for k in 0..n {
        let point: Vec<f64> = (0..d).map(|c| control_points[c * n + k]).collect();
        for c in 0..d {
            control_points[c * n + k] = offset[c] + (0..d).map(|e| matrix[(c, e)] * point[e]).sum::<f64>();
        }
    }
}

/// Distances `|r(u_i) − s(u_i)|` at `u_i = i/samples` of closed curves and `i/(samples − 1)` of open ones; at every
/// point of landmarks, and at all knots of surfaces.
fn distances(ready: &Ready, r: &[f64], s: &[f64], samples: usize) -> Vec<f64> {
    let (metric, difference) = (&ready.setup.metric, r.iter().zip(s).map(|(r, s)| r - s));
    let difference = Matrix::from_iterator(metric.size(), metric.dimension(), difference);
    if samples == 0 {
        return Vec::new();
    }
    let places = Places::along(&ready.setup.space, samples);
    let points = places.points(&ready.setup.space, &difference);
    let points = Matrix::from_vec(places.count(), metric.dimension(), points);
    points.row_iter().map(|row| row.norm()).collect()
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
    let (atoms, d) = (ready.model.len(), ready.setup.metric.dimension());
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
    let given = if ready.is_invariant() { "matrices" } else { "values" };
    let fits = if ready.is_invariant() {
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
    let metric = &ready.setup.metric;
    let mut control_points = vec![0.0; metric.len()];
    match (&code.matrices, &code.values) {
        (Some(matrices), _) => {
            for (&j, rows) in code.indices.iter().zip(matrices) {
                let matrix = Matrix::from_fn(rows.len(), rows.len(), |i, k| rows[i][k]);
                let mut atom = ready.atom(j);
                transform(&mut atom, &matrix, &vec![0.0; rows.len()]);
                control_points.iter_mut().zip(atom).for_each(|(sum, value)| *sum += value);
            }
            let offset = code.offset.clone().unwrap_or_else(|| vec![0.0; metric.dimension()]);
            for (coordinate, b) in control_points.chunks_exact_mut(metric.size()).zip(offset) {
                coordinate.iter_mut().for_each(|value| *value += b);
            }
        }
        (None, values) => {
            let code = SparseCode {
                indices: code.indices.clone(),
                values: values.clone().unwrap_or_default(),
                objective: 0.0,
                duality_gap: None,
                relative_error: 0.0,
            };
            control_points = ready.model.reconstruct(&code);
            metric.unwhiten(&mut control_points);
        }
    }
    Reconstruction { control_points, relative_error: None, residual: Vec::new() }
}

impl Ready {
    /// Control points of atom `j`, `d·N` coordinate-major numbers.
    fn atom(&self, j: usize) -> Vec<f64> {
        let rows = &self.dictionary.content.atoms[j].control_points;
        crate::analysis::rows::columns_of(rows, self.setup.metric.dimension())
    }
}

/// Comparison of a shape with the training shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Scores; `None` for sparse dictionaries.
    pub scores: Option<Vec<f64>>,
    /// Squared Mahalanobis distance of the scores.
    pub t_squared: Option<f64>,
    /// Fraction of the training shapes, held out if possible, with a smaller or equal distance.
    pub t_squared_rank: Option<f64>,
    /// Squared prediction error `‖y − ŷ‖²`.
    pub residual: f64,
    /// Fraction of the training shapes, held out if possible, with a smaller or equal error.
    pub residual_rank: f64,
    /// Whether the larger of the two measures exceeds their common limit.
    pub outlier: bool,
}

/// Scores shapes. Among shapes like those of the training, the fraction `1 − quantile` counts as outliers.
///
/// # Errors
/// Faults of the shapes or of the quantile; degenerate shapes.
pub fn score(app: &App, ready: &Ready, asked: Asked, quantile: f64) -> Result<Vec<Score>, ServiceError> {
    check_quantile(quantile)?;
    Ok(encode(app, ready, asked)?
        .iter()
        .map(|coded| score_of(ready, &coded.prepared.whitened, &coded.code, quantile))
        .collect())
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

/// Score of the prepared shape `y` with this code.
pub(crate) fn score_of(ready: &Ready, y: &[f64], code: &SparseCode, quantile: f64) -> Score {
    let statistics = &ready.dictionary.content.statistics;
    let known = Known::of(statistics);
    let residual = squared_distance(y, &ready.model.reconstruct(code));
    let (scores, t_squared) = match &ready.model {
        Model::Components { spread, .. } => (Some(code.values.clone()), Some(spread.distance(&code.values))),
        Model::Sparse { .. } => (None, None),
    };
    let outlier = match &statistics.held_out {
        Some(held_out) => {
            novelty_of(held_out).measure(t_squared, residual) > novelty::limit(&held_out.novelty, quantile)
        }
        None => {
            residual > value_at(known.residuals, quantile)
                || t_squared.is_some_and(|distance| distance > value_at(known.t_squared, quantile))
        }
    };
    Score {
        scores,
        t_squared,
        t_squared_rank: t_squared.map(|distance| rank(known.t_squared, distance)),
        residual,
        residual_rank: rank(known.residuals, residual),
        outlier,
    }
}

/// Reference values of both measures, ascending: of held-out training shapes if available, otherwise of the training
/// shapes themselves.
pub(crate) struct Known<'a> {
    /// Distances `T²`; empty for sparse dictionaries.
    pub(crate) t_squared: &'a [f64],
    /// Squared prediction errors `‖y − ŷ‖²`.
    pub(crate) residuals: &'a [f64],
}

impl<'a> Known<'a> {
    pub(crate) fn of(statistics: &'a Statistics) -> Self {
        if let Some(held_out) = &statistics.held_out {
            let t_squared = held_out.t_squared.as_ref().map_or(&[][..], |measure| &measure.values);
            return Self { t_squared, residuals: &held_out.residuals.values };
        }
        let t_squared = statistics.scores.as_ref().map_or(&[][..], |scores| &scores.t_squared);
        Self { t_squared, residuals: &statistics.residuals }
    }
}

fn novelty_of(held_out: &HeldOutStatistics) -> Novelty {
    let logarithms =
        |measure: &HeldOutMeasure| Logarithms { mean: measure.log_mean, deviation: measure.log_deviation };
    Novelty {
        distances: held_out.t_squared.as_ref().map(logarithms),
        residuals: logarithms(&held_out.residuals),
    }
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

/// Fraction of the ascending `values` that are at most `value`.
pub(crate) fn rank(values: &[f64], value: f64) -> f64 {
    values.partition_point(|known| *known <= value) as f64 / values.len().max(1) as f64
}

/// Quantile of ascending values, with linear interpolation.
pub(crate) fn value_at(values: &[f64], quantile: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return f64::INFINITY };
    let place = quantile * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    values[below] + (place - below as f64) * (values[above] - values[below])
}

/// Reference of a shape prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// The mean shape under the class.
    #[default]
    Mean,
    /// All combinations of the atoms (and of the mean of the aligned shapes) under the class.
    Atoms,
}

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
    let Alignment::Projection(class) = &ready.setup.method else {
        let detail = "expected a dictionary with a linear class: Procrustes fits have no projector";
        return Err(ServiceError::invalid("/reference", detail));
    };
    let shapes: Vec<Vec<f64>> = match (reference, &ready.model) {
        (Reference::Mean, _) => vec![ready.preparation.mean.clone()],
        (Reference::Atoms, Model::Components { pca, .. }) => {
            let eigenshapes = pca.eigenshapes.column_iter().map(|xi| xi.as_slice().to_vec());
            let mean = pca.centred.then(|| pca.mean.clone());
            mean.into_iter().chain(eigenshapes).collect()
        }
        (Reference::Atoms, Model::Sparse { .. }) => (0..ready.model.len())
            .map(|j| {
                let mut atom = ready.atom(j);
                ready.setup.metric.whiten(&mut atom);
                atom
            })
            .collect(),
    };
    let control_points = asked.control_points(app, ready, Correspondence::Landmarks)?;
    let prior = Prior::new(&ready.setup.metric, class, &shapes, gamma);
    let (context, shapes) = (app.pool.context(), control_points.chunks_exact(ready.setup.metric.len()));
    shapes.map(|shape| context.check().map(|()| prior.energy(shape))).collect()
}

/// A random shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Scores of the shape.
    pub scores: Vec<f64>,
    /// Control points, `d·N` coordinate-major numbers in the pose of the dictionary.
    pub control_points: Vec<f64>,
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
    let Model::Components { pca, spread } = &ready.model else {
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
    let root = spread.root();
    let mut random = ChaCha12Rng::seed_from_u64(seed);
    let mut draw = || {
        let z = Matrix::from_fn(spread.mean.len(), 1, |_, _| StandardNormal.sample(&mut random));
        let step = &root * &z;
        let scores: Vec<f64> = spread.mean.iter().zip(step.iter()).map(|(m, s)| m + sigma * s).collect();
        let mut control_points = pca.reconstruct(&scores);
        ready.setup.metric.unwhiten(&mut control_points);
        Sample { scores, control_points }
    };
    let context = app.pool.context();
    (0..count).map(|_| context.check().map(|()| draw())).collect()
}

/// Maximum `sigma`.
const MAX_SIGMA: f64 = 1e6;
