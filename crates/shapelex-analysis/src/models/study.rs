//! A model of aligned shapes, from its formula to the record: table, coefficients, predictions.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use super::anova::{Model, Testing};
use super::bands::Bands;
use super::coefficients::Coefficients;
use super::design::{Contrasts, Design, Factor, Prepared, Table, Values};
use super::disparity::DisparityOptions;
use super::error::ModelError;
use super::formula::Formula;
use super::kept::KeptModel;
use super::mixed::records::RandomRecord;
use super::mixed::{RandomQuestion, estimate};
use super::outcome::ModelRecord;
use super::pairs::PairsOptions;
use super::predictor::{Attributes, Predictor};
use super::records::At;
use super::trajectories::TrajectoryOptions;
use crate::inference::aligned::{AlignedShapes, mean_warnings};
use crate::inference::compare::UNEQUAL_SPREADS;
use crate::inference::span::{Span, centre_rows};
use crate::mean_record::MeanRecord;
use crate::metric::Metric;
use crate::quantile::quantile;
use crate::watch::{StopWhen, Watch};
use shapelex_numeric::dense::{self, Matrix};

/// Name of the natural logarithm of the centroid size among the attributes.
pub const LOG_CENTROID_SIZE: &str = "log_centroid_size";
/// Maximum number of predictions.
pub const MAX_PREDICTIONS: usize = 100;
/// Quantiles of a number at which shapes are predicted where nothing is asked for.
const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];
/// Levels of a factor for which shapes are predicted where nothing is asked for.
const USUAL_LEVELS: usize = 12;
/// Fewest shapes of a group whose scatter is compared.
const FEWEST: usize = 5;

/// What is modelled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Response<'a> {
    /// The shapes.
    Shape,
    /// The shapes within the space of some principal components of all, from 0.
    Scores(&'a Range<usize>),
    /// A number for each shape.
    Numbers(&'a [f64]),
}

/// What is asked of a model.
#[derive(Debug)]
pub struct ModelQuestion<'a> {
    /// The formula.
    pub formula: &'a Formula,
    /// Attributes of the shapes.
    pub table: &'a Table,
    /// Coding of factors.
    pub contrasts: Contrasts,
    /// What is modelled.
    pub response: Response<'a>,
    /// Tests.
    pub testing: Testing<'a>,
    /// Estimates of a random part. Default: its usual ones, if the shapes determine them.
    pub random: Option<RandomQuestion>,
    /// Multivariate statistics in so many principal coordinates, or the most that there are.
    pub manova: Option<Option<usize>>,
    /// Covariance of the shapes, as its lower triangular factor.
    pub covariance: Option<&'a Matrix>,
    /// Values of attributes at which shapes are predicted. Default: at the levels, or at quantiles, of the first variable.
    pub at: Option<&'a [BTreeMap<String, At>]>,
    /// What is asked besides.
    pub further: Further<'a>,
}

/// What is asked of a model besides its table and predictions.
#[derive(Debug, Clone, Copy, Default)]
pub struct Further<'a> {
    /// A reduced model with which the whole one is compared, in place of the table of the terms.
    pub reduced: Option<&'a Formula>,
    /// Pairs of groups.
    pub pairs: Option<&'a PairsOptions>,
    /// Disparity of groups.
    pub disparity: Option<&'a DisparityOptions>,
    /// Trajectories of groups.
    pub trajectories: Option<&'a TrajectoryOptions>,
    /// Bands of the predictions.
    pub bands: Option<Bands>,
    /// Whether the model is kept for predictions, and the number of places along curves where it has bands.
    pub keep: Option<usize>,
}

impl Further<'_> {
    /// Warning about what is left out.
    fn warning(&self, testing: &Testing<'_>) -> Option<String> {
        let is_left_out = testing.blocks.is_some() && (self.bands.is_some() || self.pairs.is_some());
        is_left_out.then(|| {
            "shapes of blocks are not independent: intervals and simultaneous bands are left out".into()
        })
    }

    /// Whether anything is asked.
    pub fn is_asked(&self) -> bool {
        self.reduced.is_some()
            || self.pairs.is_some()
            || self.disparity.is_some()
            || self.trajectories.is_some()
            || self.bands.is_some()
    }
}

/// The model of aligned shapes.
///
/// Predictions are those of the whole model. Numeric attributes that are not given have their weighted mean; over factors that are not
/// given the shapes are averaged as they occur.
///
/// Cost: that of [`Fitted::permuted`](super::permuted::Fitted::permuted) for every kind of exchange.
///
/// # Errors
/// Errors of the formula, the design and the tests; predictions at unknown levels.
pub fn model(
    shapes: &AlignedShapes<'_>,
    question: &ModelQuestion<'_>,
    watch: &dyn Watch,
) -> Result<ModelRecord, ModelError> {
    let vectors = match question.response {
        Response::Shape => shapes.aligned.clone(),
        Response::Scores(scores) => within(&shapes.aligned, &shapes.weights, scores)?,
        Response::Numbers(numbers) => Matrix::from_row_slice(1, numbers.len(), numbers),
    };
    let modelled = (!matches!(question.response, Response::Numbers(_))).then_some(shapes);
    let mut record = of_vectors(vectors, shapes.weights.clone(), modelled, question, watch)?;
    record.pooled = modelled.map(|shapes| MeanRecord::of(&shapes.mean, shapes.space.metric.dimension()));
    record.anova.warnings.splice(0..0, mean_warnings(&shapes.mean));
    Ok(record)
}

/// The model of vectors in columns, which are those of the shapes, or numbers.
fn of_vectors(
    vectors: Matrix,
    weights: Vec<f64>,
    shapes: Option<&AlignedShapes<'_>>,
    question: &ModelQuestion<'_>,
    watch: &dyn Watch,
) -> Result<ModelRecord, ModelError> {
    let ModelQuestion { formula, table, contrasts, testing, further, .. } = question;
    let metric = shapes.map(|shapes| shapes.space.metric);
    let lower = question.covariance.cloned();
    if lower.is_some() && further.is_asked() {
        let detail = "expected none beside pairs, disparity, trajectories, bands or a reduced model, got one";
        return Err(ModelError::Setting { field: "covariance", detail: detail.into() });
    }
    let found = Model::with_covariance(formula, table, *contrasts, vectors, weights, lower)?;
    let mut anova = match further.reduced {
        Some(reduced) => found.compare(reduced, table, testing, watch)?,
        None => found.anova(testing, watch)?,
    };
    let random = random_effects(&found, question.random.as_ref(), metric, watch, &mut anova.warnings)?;
    let manova = question.manova.map(|count| found.manova(count, testing, watch)).transpose()?;
    anova.warnings.extend(scatter_warning(&found));
    let coefficients = Coefficients::new(&found);
    let attributes = Attributes::new(&found, table)?;
    let predictor = Predictor { attributes: &attributes, coefficients: &coefficients, metric };
    let (rows, mut predictions) = match question.at {
        Some(at) => predictor.predict_all(at)?,
        None => predictor.usual(&usual_places(&found.design, table), &mut anova.warnings),
    };
    // The table has counted its exchanges: the rest only asks whether to stop.
    let watch = &StopWhen(&|| watch.stop());
    if let Some(bands) = further.bands {
        let leverages: Vec<f64> = predictions.iter().map(|prediction| prediction.leverage).collect();
        let found = found.bands(bands, (&rows, &leverages), shapes, testing, watch)?;
        predictions.iter_mut().zip(found).for_each(|(prediction, band)| prediction.band = Some(band));
    }
    anova.warnings.extend(further.warning(testing));
    let pairs = further.pairs.map(|options| found.pairs(options, table, metric, testing, watch));
    let disparity = further.disparity.map(|options| found.disparity(options, testing, watch));
    let keep = |samples| {
        KeptModel::new(&found, (attributes, coefficients.clone()), (shapes, samples), testing, watch)
    };
    let kept = further.keep.map(keep).transpose()?.map(Box::new);
    let of_trajectories = |options| found.trajectories(options, table, metric, testing, watch);
    Ok(ModelRecord {
        anova,
        pooled: None,
        coefficients: coefficients.records(&found.design, &found.space, metric),
        predictions,
        reduced: further.reduced.map(ToString::to_string),
        pairs: pairs.transpose()?,
        disparity: disparity.transpose()?,
        trajectories: further.trajectories.map(of_trajectories).transpose()?,
        random,
        manova,
        kept,
    })
}

/// Estimates of the random part of a model. Where nothing is asked of it, what the shapes do not determine is told.
fn random_effects(
    model: &Model,
    question: Option<&RandomQuestion>,
    metric: Option<&Metric>,
    watch: &dyn Watch,
    warnings: &mut Vec<String>,
) -> Result<Option<RandomRecord>, ModelError> {
    if model.design.formula.random.is_empty() {
        return Ok(None);
    }
    match (estimate(model, question.unwrap_or(&RandomQuestion::default()), metric, watch), question) {
        (Ok(record), _) => {
            if !record.converged {
                warnings.push("the variances of the random part have not converged".into());
            }
            Ok(Some(record))
        }
        (Err(ModelError::Unidentified { detail }), None) => {
            warnings.push(format!("the random part is not estimated: {detail}"));
            Ok(None)
        }
        (Err(error), _) => Err(error),
    }
}

/// Vectors in columns within the space of some of their principal components, about their mean.
fn within(vectors: &Matrix, weights: &[f64], scores: &Range<usize>) -> Result<Matrix, ModelError> {
    let span = Span::new(vectors, weights)?;
    let most = span.eigenvalues.len();
    if scores.end > most {
        return Err(ModelError::FewScores { found: scores.end, most });
    }
    let chosen = span.scores.rows(scores.start, scores.len()).into_owned();
    let mut centred = vectors.clone();
    centre_rows(&mut centred, weights);
    let weighted = Matrix::from_fn(chosen.nrows(), chosen.ncols(), |i, k| {
        weights[k] * chosen[(i, k)] / span.eigenvalues[scores.start + i]
    });
    let directions = dense::multiply(&centred, &weighted.transpose());
    let mean = vectors.column(0) - centred.column(0);
    let mut found = dense::multiply(&directions, &chosen);
    found.column_iter_mut().for_each(|mut column| column += &mean);
    Ok(found)
}

/// Where shapes are predicted if nothing is asked for: at the levels of the first variable, or at its quantiles.
pub(super) fn usual_places(design: &Design, table: &Table) -> Vec<BTreeMap<String, At>> {
    let Some(&first) = design.formula.terms.first().and_then(|term| term.0.first()) else {
        return Vec::new();
    };
    let name = &design.formula.variables[first].name;
    let at = |at: At| BTreeMap::from([(name.clone(), at)]);
    match (&design.variables[first], table.attributes.get(name)) {
        (Prepared::Factor(Factor { levels, .. }), _) => {
            levels.iter().take(USUAL_LEVELS).map(|level| at(At::Level(level.clone()))).collect()
        }
        (_, Some(Values::Numbers(numbers))) => {
            let mut sorted = numbers.clone();
            sorted.sort_by(f64::total_cmp);
            QUANTILES.iter().map(|q| at(At::Number(quantile(&sorted, *q)))).collect()
        }
        _ => Vec::new(),
    }
}

/// Warning about groups, the combinations of all factors of the formula, whose residuals scatter unequally: permutations of residuals
/// assume that they do not.
fn scatter_warning(model: &Model) -> Option<String> {
    let design = &model.design;
    let used: BTreeSet<usize> = design.formula.terms.iter().flat_map(|term| term.0.iter().copied()).collect();
    let factors: Vec<usize> = design.factors().map(|(k, _)| k).filter(|k| used.contains(k)).collect();
    if factors.is_empty() || model.space.is_correlated() {
        return None;
    }
    let groups = design.cells_of(&super::formula::Term(factors.clone()));
    let (squares, leverages) = (model.fitted.squares(), model.space.leverages());
    let count = groups.iter().max().map_or(0, |last| last + 1);
    let none = GroupScatter { square: 0.0, free: 0.0, number: 0, first: usize::MAX };
    let mut sums = vec![none; count];
    for (k, &group) in groups.iter().enumerate() {
        let GroupScatter { square, free, number, first } = &mut sums[group];
        *square += squares[k];
        *free += 1.0 - leverages[k];
        *number += 1;
        *first = (*first).min(k);
    }
    unequal_scatter_warning(&sums, &|k| design.levels_at(&factors, k))
}

/// Residuals of the shapes of a group.
#[derive(Debug, Clone, Copy)]
pub(super) struct GroupScatter {
    /// Sum of their squares.
    pub(super) square: f64,
    /// Sum of their parts that the model leaves.
    pub(super) free: f64,
    /// Number of shapes.
    pub(super) number: usize,
    /// The first of them.
    pub(super) first: usize,
}

/// Warning about groups that scatter unequally; `name` tells the name of the group of a shape.
pub(super) fn unequal_scatter_warning(
    groups: &[GroupScatter],
    name: &dyn Fn(usize) -> String,
) -> Option<String> {
    let is_small = |group: &GroupScatter| group.number < FEWEST || group.free <= 0.0;
    if groups.len() < 2 || groups.iter().any(is_small) {
        return None;
    }
    let spread = |group: &GroupScatter| (group.square.max(0.0) / group.free).sqrt();
    let wide = groups.iter().max_by(|a, b| spread(a).total_cmp(&spread(b)))?;
    let narrow = groups.iter().min_by(|a, b| spread(a).total_cmp(&spread(b)))?;
    if spread(wide) <= UNEQUAL_SPREADS * spread(narrow) {
        return None;
    }
    let ratio = match spread(narrow) > 0.0 {
        true => format!("{:.2} times as much as", spread(wide) / spread(narrow)),
        false => "unlike".into(),
    };
    let sizes: BTreeSet<usize> = groups.iter().map(|group| group.number).collect();
    let meaning = match sizes.len() {
        1 => "groups of equal size bear this well",
        _ => "with groups of unequal size the tests find differences too often, or too rarely",
    };
    Some(format!(
        "shapes of '{}' scatter {ratio} those of '{}' about the model, and the tests assume equal scatter: {meaning}",
        name(wide.first),
        name(narrow.first)
    ))
}
