//! Learning a dictionary from shapes: mean, preparation, atoms, certificate, statistics of held-out shapes.
//!
//! The result depends on the shapes and the recipe alone, bit by bit, for any number of threads and any process that
//! computes a part of a pass.

use super::content::{Content, ScoreStatistics};
use super::held_out;
use super::in_use::Dictionary;
use super::model::{Certificate, Coded, Model};
use super::procedure::Previous;
use super::recipe::Recipe;
use crate::AnalysisError;
use crate::accumulate::{KEPT_BYTES, ShapeSource, ShapesInMemory, Watched};
use crate::factors::{Estimator, Factors, RobustSummary};
use crate::matching::Disagreement;
use crate::mean_record::MeanRecord;
use crate::partial_sums::Measured;
use crate::preparation::{Pose, Posed, Preparation};
use crate::robust::{LessCounted, Listed, Retained, mean_by};
use crate::watch::{Phase, Quiet, Watch};

/// Maximum number of stored values of a distribution.
const QUANTILES: usize = 1001;

/// Maximum number of listed shapes of a robust dictionary.
pub const MOST_LISTED: usize = 20;

/// A learnt dictionary.
#[derive(Debug, Clone)]
pub struct Learnt {
    /// The dictionary, without classifier.
    pub dictionary: Dictionary,
    /// The sums from which learning can continue.
    pub state: Vec<u8>,
    /// Shapes that count less in a robust dictionary, at most [`MOST_LISTED`], by ascending factors.
    pub less_counted: Vec<LessCounted>,
    /// Whether the parameters of surfaces that correspond as given disagree with those of the mean; `None` for other shapes, and where
    /// an earlier version is continued.
    pub disagreement: Option<Disagreement>,
}

/// Learns a dictionary from `shapes`: whitened, and centred if the class translates, as
/// [`Setting::shapes`](super::recipe::Setting::shapes) prepares them.
///
/// # Errors
/// Errors of the recipe and of the source; degenerate or too few shapes; [`AnalysisError::Interrupted`].
pub fn learn(shapes: &dyn ShapeSource, recipe: &Recipe, watch: &dyn Watch) -> Result<Learnt, AnalysisError> {
    let setting = recipe.setting()?;
    let shapes = Watched::new(shapes, watch);
    Learner { recipe, measured: setting.measured(), watch, help: &|_| Ok(None) }.learn(&shapes)
}

/// Encodes all shapes elsewhere, such as in other processes; `None` if they are to be encoded here.
pub type Help<'a> = dyn Fn(&Dictionary) -> Result<Option<Coded>, AnalysisError> + Sync + 'a;

/// Learns dictionaries from a kind of source.
pub struct Learner<'a> {
    /// Parameters of learning.
    pub recipe: &'a Recipe,
    /// Metric, alignment and matching of the recipe.
    pub measured: Measured<'a>,
    /// Progress and cancellation.
    pub watch: &'a dyn Watch,
    /// Help with the pass that encodes all shapes.
    pub help: &'a Help<'a>,
}

impl Learner<'_> {
    /// The shapes that count less, and where they are wrong.
    fn less_counted(
        &self,
        shapes: &dyn ShapeSource,
        factors: &Factors,
        content: &Content,
    ) -> Result<Vec<LessCounted>, AnalysisError> {
        let Some(listed) = Listed::of(shapes, factors, MOST_LISTED)? else { return Ok(Vec::new()) };
        let aligned = Pose::Aligned { normalise: false };
        let preparation = Preparation { pose: aligned, ..content.preparation(self.measured)? };
        let posed = ShapesInMemory::of(&Posed { source: listed.shapes(), preparation: &preparation })?;
        listed.described(self.measured, &posed.into_whitened())
    }

    /// Learns from scratch.
    ///
    /// # Errors
    /// Errors of the source; degenerate or too few shapes; [`AnalysisError::Interrupted`].
    pub fn learn(&self, shapes: &dyn ShapeSource) -> Result<Learnt, AnalysisError> {
        self.enter(Phase::Mean)?;
        let estimator = self.recipe.estimator;
        let mean = mean_of(estimator, self.recipe, self.measured, shapes);
        let FirstMean { mean, factors, disagreement } = mean.map_err(|error| shapes.located(error))?;
        let Some(factors) = factors else {
            let learnt = self.finish((shapes, shapes), mean, None, None, self.help)?;
            return Ok(Learnt { disagreement, ..learnt });
        };
        // Wrong shapes must not become atoms, nor set the limit of outliers: the following steps do not see them.
        let retained = Retained::new(shapes, &factors.factors);
        let mut learnt =
            self.finish((&retained, &retained), mean, None, Some(factors.summary()), &|_| Ok(None))?;
        learnt.less_counted = self.less_counted(shapes, &factors, &learnt.dictionary.content)?;
        Ok(Learnt { disagreement, ..learnt })
    }

    /// Continues an earlier version with the shapes of `new`, which are among `shapes`. Its mean shape is kept.
    ///
    /// # Errors
    /// As [`Self::learn`]; [`AnalysisError::NotAnAccumulator`] for sums of another dictionary.
    pub fn continue_from(
        &self,
        previous: Previous<'_>,
        shapes: &dyn ShapeSource,
        new: &dyn ShapeSource,
    ) -> Result<Learnt, AnalysisError> {
        self.enter(Phase::Mean)?;
        self.finish((shapes, new), previous.content.mean.clone(), Some(previous), None, self.help)
    }

    fn enter(&self, phase: Phase) -> Result<(), AnalysisError> {
        self.watch.check()?;
        self.watch.phase(phase, 0.0);
        Ok(())
    }

    fn finish(
        &self,
        (shapes, new): (&dyn ShapeSource, &dyn ShapeSource),
        mean: MeanRecord,
        previous: Option<Previous<'_>>,
        robust: Option<RobustSummary>,
        help: &Help<'_>,
    ) -> Result<Learnt, AnalysisError> {
        let mut content = Content { robust, ..self.recipe.content(mean) };
        let preparation = content.preparation(self.measured)?;
        self.enter(Phase::Align)?;
        let fitted = self.fit(new, previous, &preparation, &mut content);
        let state = fitted.map_err(|error| new.located(error))?;
        self.enter(Phase::Certify)?;
        content.statistics.shapes = shapes.count();
        let mut dictionary = Dictionary::new(content, self.measured)?;
        let certificate =
            self.certificate(shapes, &dictionary, help).map_err(|error| shapes.located(error))?;
        dictionary.certify(certificate);
        self.enter(Phase::HoldOut)?;
        let anew = previous.is_none();
        let held_out = held_out::statistics(shapes, &dictionary, self.recipe, &state, anew, self.watch);
        let dictionary = dictionary.holding_out(held_out.map_err(|error| shapes.located(error))?);
        Ok(Learnt { dictionary, state, less_counted: Vec::new(), disagreement: None })
    }

    /// Learns from prepared shapes, which are kept in memory if they fit. Components take a single pass and read them from the
    /// source, as shapes that are coded elsewhere are.
    fn fit(
        &self,
        shapes: &dyn ShapeSource,
        previous: Option<Previous<'_>>,
        preparation: &Preparation,
        content: &mut Content,
    ) -> Result<Vec<u8>, AnalysisError> {
        let (method, watch) = (&self.recipe.method, self.watch);
        let posed = Posed { source: shapes, preparation };
        let elsewhere = posed.coders().is_some();
        if !method.is_sparse() || elsewhere || bytes(shapes, preparation) > KEPT_BYTES {
            return method.fit(&posed, previous, preparation, content, watch);
        }
        let kept = ShapesInMemory::of(&posed)?;
        method.fit(&kept, previous, preparation, content, watch)
    }

    fn certificate(
        &self,
        shapes: &dyn ShapeSource,
        dictionary: &Dictionary,
        help: &Help<'_>,
    ) -> Result<Certificate, AnalysisError> {
        let coded = match help(dictionary)? {
            Some(coded) => coded,
            None => dictionary.coded(shapes, self.watch)?,
        };
        Ok(coded.certificate())
    }
}

/// Size of the prepared shapes of a source.
pub(super) fn bytes(shapes: &dyn ShapeSource, preparation: &Preparation) -> usize {
    shapes.count().saturating_mul(8 * preparation.metric.len())
}

/// The mean from which learning begins.
struct FirstMean {
    mean: MeanRecord,
    /// Factors of a robust mean.
    factors: Option<Factors>,
    disagreement: Option<Disagreement>,
}

fn mean_of(
    estimator: Estimator,
    recipe: &Recipe,
    measured: Measured<'_>,
    shapes: &dyn ShapeSource,
) -> Result<FirstMean, AnalysisError> {
    let Measured { metric, method, matching } = measured;
    let mean = mean_by(estimator, shapes, metric, method, recipe.frame, matching)?;
    let record = MeanRecord::of(&mean, metric.dimension());
    Ok(FirstMean { mean: record, factors: mean.robust, disagreement: mean.disagreement })
}

/// Learns from shapes in memory, without certificate, held-out shapes and reports: for a part of a validation. Also the shapes in pose.
pub(crate) fn learn_part(
    recipe: &Recipe,
    measured: Measured<'_>,
    shapes: &ShapesInMemory,
    watch: &dyn Watch,
) -> Result<(Dictionary, ShapesInMemory), AnalysisError> {
    let watched = Watched::new(shapes, watch);
    // Wrong shapes are left out of all parts alike.
    let FirstMean { mean, .. } = mean_of(Estimator::Plain, recipe, measured, &watched)?;
    let mut content = recipe.content(mean);
    let preparation = content.preparation(measured)?;
    let posed = ShapesInMemory::of(&Posed { source: &watched, preparation: &preparation })?;
    recipe.method.fit(&posed, None, &preparation, &mut content, &Quiet(watch))?;
    content.statistics.shapes = shapes.count();
    Ok((Dictionary::new(content, measured)?, posed))
}

impl Dictionary {
    /// Stores the certificate in the statistics.
    fn certify(&mut self, certificate: Certificate) {
        let statistics = &mut self.content.statistics;
        statistics.shapes = certificate.residuals.len();
        statistics.weight = certificate.weight;
        statistics.objective = certificate.objective;
        statistics.reconstruction_error = certificate.reconstruction_error;
        statistics.parameters = certificate.parameters;
        statistics.residuals = quantiles(certificate.residuals);
        let atoms = self.content.atoms.iter_mut().zip(certificate.usage);
        atoms.for_each(|(atom, usage)| atom.usage = usage);
        if let Model::Components { pca, spread } = &self.model {
            statistics.converged = true;
            statistics.total =
                pca.eigenvalues.first().zip(pca.explained.first()).map(|(value, part)| value / part);
            statistics.scores = Some(ScoreStatistics {
                mean: spread.mean.clone(),
                covariance: spread.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
                t_squared: quantiles(certificate.distances),
            });
        }
    }
}

/// The values in ascending order; if there are more than [`QUANTILES`], that many of them, evenly spaced by rank.
pub(crate) fn quantiles(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    if values.len() <= QUANTILES {
        return values;
    }
    let last = values.len() - 1;
    (0..QUANTILES).map(|i| values[(i * last + (QUANTILES - 1) / 2) / (QUANTILES - 1)]).collect()
}
