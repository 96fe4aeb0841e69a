//! What is asked of a model besides its table: a reduced model, pairs, disparity, trajectories and bands.

use serde::{Deserialize, Serialize};

use super::super::comparisons::{MAX_EFFECT_POINTS, check_places, samples_fault};
use super::{Options, read_text};
use crate::analysis::estimate::{Estimate, Resampling};
use crate::analysis::models::bands::Bands;
use crate::analysis::models::design::{Design, Prepared};
use crate::analysis::models::disparity::DisparityOptions;
use crate::analysis::models::error::ModelError;
use crate::analysis::models::formula::Formula;
use crate::analysis::models::groups::MAX_GROUPS;
use crate::analysis::models::kept::kept_draws;
use crate::analysis::models::pairs::PairsOptions;
use crate::analysis::models::study::Further;
use crate::analysis::models::trajectories::TrajectoryOptions;
use crate::geometry::sampling::Places;
use crate::service::app::{App, ServiceError};
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Predictions where nothing is asked for.
const USUAL_PREDICTIONS: usize = 12;

/// Options beyond those of the table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FurtherOptions {
    /// Formula of a reduced model, with which the whole one is compared.
    pub reduced: Option<String>,
    /// Pairs of groups.
    pub pairs: Option<PairsOptions>,
    /// Disparity of groups.
    pub disparity: Option<DisparityOptions>,
    /// Trajectories of groups.
    pub trajectories: Option<TrajectoryOptions>,
    /// Level of bands.
    pub bands: Option<f64>,
    /// Number of places along curves where bands are given.
    pub samples: Option<usize>,
    /// Whether the model is kept for predictions.
    #[serde(default)]
    pub keep: bool,
}

impl FurtherOptions {
    /// Formulas besides that of the model, with their places.
    fn texts(&self) -> impl Iterator<Item = (&str, &'static str)> {
        [
            (self.reduced.as_deref(), "/reduced"),
            (self.pairs.as_ref().and_then(|pairs| pairs.null.as_deref()), "/pairs/null"),
            (self.trajectories.as_ref().and_then(|of| of.null.as_deref()), "/trajectories/null"),
        ]
        .into_iter()
        .filter_map(|(text, place)| Some((text?, place)))
    }

    /// Faults that do not depend on the shapes.
    pub(super) fn faults(&self, app: &App, options: &Options) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (text, place) in self.texts() {
            faults.extend(read_text(text, options.order).err().map(|detail| Fault::new(place, detail)));
        }
        if let Some(Err(ModelError::Setting { field, detail })) = self.pairs.as_ref().map(PairsOptions::check)
        {
            faults.push(Fault::new(format!("/{field}"), detail));
        }
        if let Some(level) = self.bands.filter(|level| !(*level > 0.0 && *level < 1.0)) {
            let detail = format!("expected a number between 0 and 1, both excluded, got {level}");
            faults.push(Fault::new("/bands", detail));
        }
        match (self.bands.is_some() || self.keep, self.samples) {
            (false, Some(_)) => {
                faults.push(Fault::new("/samples", "expected `bands` or `keep` with it, got none"));
            }
            _ => faults.extend(samples_fault(self.samples, app.limits.samples)),
        }
        faults
    }

    /// The formulas besides that of the model, with their places.
    ///
    /// # Errors
    /// Texts that are none.
    pub(super) fn formulas(&self, options: &Options) -> Result<Vec<(Formula, &'static str)>, ServiceError> {
        let read = |(text, place): (&str, &'static str)| {
            let read = read_text(text, options.order);
            read.map(|formula| (formula, place)).map_err(|detail| ServiceError::invalid(place, detail))
        };
        self.texts().map(read).collect()
    }

    /// The question to the model; `reduced` is the formula of the reduced model.
    pub(super) fn question<'a>(&'a self, reduced: Option<&'a Formula>, places: usize) -> Further<'a> {
        Further {
            reduced,
            pairs: self.pairs.as_ref(),
            disparity: self.disparity.as_ref(),
            trajectories: self.trajectories.as_ref(),
            bands: self.bands.map(|level| Bands { level, samples: self.samples.unwrap_or(places) }),
            keep: self.keep.then(|| self.samples.unwrap_or(places)),
        }
    }

    /// Adds the cost of what is asked for to that of the table.
    ///
    /// # Errors
    /// Places that shapes of the space are not followed at, or too many of them.
    pub(super) fn cost(
        &self,
        estimate: Estimate,
        (options, design): (&Options, &Design),
        (setup, permutations): (&Setup, usize),
    ) -> Result<Estimate, ServiceError> {
        let length = if options.is_of_shapes() { setup.measured().metric.len() } else { 1 };
        let two = |groups: usize| groups * groups.saturating_sub(1) / 2;
        let work =
            |functions, statistics, length| Resampling { length, functions, statistics, draws: permutations };
        let mut estimate = estimate;
        if let Some(pairs) = &self.pairs {
            let groups = count_groups(design, &pairs.groups);
            // The intervals take as many draws again.
            estimate = estimate.with_resampling(work(
                groups,
                two(groups) * (1 + pairs.statistics().len()),
                2 * length,
            ));
        }
        if let Some(disparity) = &self.disparity {
            estimate = estimate.with_resampling(work(1, two(count_groups(design, &disparity.groups)), 1));
        }
        if let Some(trajectories) = &self.trajectories {
            let names: Vec<String> =
                trajectories.groups.iter().chain([&trajectories.points]).cloned().collect();
            let groups = count_groups(design, &trajectories.groups);
            estimate = estimate.with_resampling(work(count_groups(design, &names), 3 * two(groups), length));
        }
        if self.bands.is_some() {
            let predictions = options.at.as_ref().map_or(USUAL_PREDICTIONS, Vec::len);
            let places = match options.is_of_shapes() {
                true => self.places(setup)?,
                false => 1,
            };
            if predictions.saturating_mul(places) > MAX_EFFECT_POINTS {
                let detail = format!(
                    "expected at most {MAX_EFFECT_POINTS} places over all predictions, got {places} for each of {predictions}"
                );
                return Err(ServiceError::invalid("/samples", detail));
            }
            let numbers =
                if options.is_of_shapes() { places * setup.measured().metric.dimension() } else { 1 };
            estimate = estimate.with_resampling(work(predictions, predictions, 2 * numbers));
        }
        if self.keep {
            estimate = self.cost_of_keeping(estimate, (options, design), (setup, permutations))?;
        }
        Ok(estimate)
    }

    /// Adds the cost of keeping the model to that of the rest.
    fn cost_of_keeping(
        &self,
        estimate: Estimate,
        (options, design): (&Options, &Design),
        (setup, permutations): (&Setup, usize),
    ) -> Result<Estimate, ServiceError> {
        let numbers = match options.is_of_shapes() {
            true => self.places(setup)? * setup.measured().metric.dimension(),
            false => 1,
        };
        let functions = design.columns.len();
        let draws = kept_draws(permutations, functions, numbers);
        // In memory as they are drawn, in one list, and as they are written.
        let changes = 3.0 * 4.0 * draws as f64 * functions as f64 * numbers as f64;
        let work = Resampling { length: 2 * numbers, functions, statistics: 0, draws };
        Ok(estimate.with_resampling(work).with_work(0.0, changes))
    }

    /// Number of places at which shapes are followed.
    fn places(&self, setup: &Setup) -> Result<usize, ServiceError> {
        let usual = setup.space.representation().comparison_places();
        let samples = self.samples.unwrap_or(usual);
        check_places(samples, setup)?;
        Ok(Places::along(&setup.space, samples).count())
    }
}

/// Most groups that combinations of factors make.
fn count_groups(design: &Design, names: &[String]) -> usize {
    let levels = |name: &String| {
        let is_own = |v: &usize| {
            let variable = &design.formula.variables[*v];
            variable.name == *name || variable.to_string() == *name
        };
        match (0..design.variables.len()).find(is_own).map(|v| &design.variables[v]) {
            Some(Prepared::Factor(factor)) => factor.levels.len(),
            _ => 1,
        }
    };
    names.iter().fold(1_usize, |product, name| product.saturating_mul(levels(name))).min(MAX_GROUPS)
}
