//! Tests of terms against other errors than the residuals: groups of random parts, and terms that contain them.
//!
//! A term whose levels differ only between the groups is tested on the averages of the shapes in them, with the sums of their weights: the
//! model of the averages has the groups as its residuals. Terms that vary inside of the groups of a random part are tested in the model
//! that has these groups as a factor.

use std::ops::Range;

use super::anova::{Model, Testing};
use super::error::ModelError;
use super::exchange::{ExchangeKind, pairs};
use super::formula::{Formula, Term};
use super::permuted::Fitted;
use super::records::TermRecord;
use super::subspaces::{Hypothesis, Space, SumType};
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

impl Model {
    /// The model with the groups of its random parts as factors, in which terms that vary inside of the groups are tested: the groups
    /// come after the other terms and before these.
    pub(super) fn with_groups(&self, inside: &[Hypothesis]) -> Result<Grouped, ModelError> {
        let formula = &self.design.formula;
        let varies = |term: usize| inside.iter().any(|hypothesis| hypothesis.term == term);
        let (within, between): (Vec<usize>, Vec<usize>) =
            (0..formula.terms.len()).partition(|term| varies(*term));
        let (mut groups, mut names): (Vec<Term>, Vec<String>) = (Vec::new(), Vec::new());
        for part in &formula.random {
            let own = part.intercept.then(|| (part.group.clone(), "1".to_owned()));
            let slopes = part.terms.iter().map(|term| (part.group.times(term), formula.name(term)));
            for (term, effect) in own.into_iter().chain(slopes) {
                let is_known = |other: &Term| other.set() == term.set();
                if !groups.iter().any(is_known) && !formula.terms.iter().any(is_known) {
                    names.push(format!("({effect} | {})", formula.name(&part.group)));
                    groups.push(term);
                }
            }
        }
        let of = |terms: &[usize]| terms.iter().map(|&term| formula.terms[term].clone()).collect::<Vec<_>>();
        let terms = [of(&between), groups.clone(), of(&within)].concat();
        let all: Vec<usize> = (0..self.design.shapes()).collect();
        let design =
            self.design.restricted(Formula { terms, random: Vec::new(), ..formula.clone() }, &all)?;
        let space = Space::new(&design, &self.weights)?;
        let fitted = Fitted::new(&space, &self.vectors, design.formula.intercept)?;
        let labels = formula.random.iter().map(|part| self.design.cells_of(&part.group));
        let finest = labels.reduce(|a, b| pairs(&a, &b)).unwrap_or_default();
        let model =
            Self { design, space, fitted, vectors: self.vectors.clone(), weights: self.weights.clone() };
        // Places of the terms in the model with groups, and in the table.
        let first = between.len() + groups.len();
        let places = within.into_iter().enumerate().map(|(k, term)| (first + k, term)).collect();
        Ok(Grouped { model, places, groups: between.len()..first, names, finest })
    }

    /// As [`Self::with_groups`]; `None`, which is told, if the effects of groups leave no degree of freedom.
    pub(super) fn with_groups_if_any(
        &self,
        inside: &[Hypothesis],
        warnings: &mut Vec<String>,
    ) -> Result<Option<Grouped>, ModelError> {
        let has_slopes = self.design.formula.random.iter().any(|part| !part.terms.is_empty());
        match self.with_groups(inside) {
            Err(error @ (ModelError::FewShapes { .. } | ModelError::ManyColumns { .. })) if has_slopes => {
                warnings.push(format!("random parts are not tested: {error}"));
                Ok(None)
            }
            found => found.map(Some),
        }
    }

    /// The error term that a term is tested against, if it is not the residuals.
    pub(super) fn error_term_of(
        &self,
        hypothesis: &Hypothesis,
        testing: &Testing<'_>,
    ) -> Result<Option<Term>, ModelError> {
        let formula = &self.design.formula;
        let term = &formula.terms[hypothesis.term];
        let name = formula.name(term);
        if let Some((_, error)) = testing.error_terms.iter().find(|(tested, _)| *tested == name) {
            let found =
                formula.terms.iter().find(|other| formula.name(other) == *error && other.contains(term));
            return match found {
                Some(found) => Ok(Some(found.clone())),
                None => Err(ModelError::NoErrorTerm { term: name, error: error.clone() }),
            };
        }
        let own = self.design.cells_of(term);
        let count = |labels: &[usize]| labels.iter().max().map_or(0, |last| last + 1);
        // The coarsest groups in which the term is constant.
        let constant = formula.random.iter().map(|part| &part.group).filter_map(|group| {
            let groups = self.design.cells_of(group);
            let groups_alone = count(&groups);
            (count(&pairs(&groups, &own)) == groups_alone && count(&own) < groups_alone)
                .then_some((groups_alone, group))
        });
        Ok(constant.min_by_key(|(groups, _)| *groups).map(|(_, group)| group.clone()))
    }

    /// Tests a term on the averages of the shapes in the groups of an error term.
    pub(super) fn test_collapsed(
        &self,
        error: &Term,
        row: &mut TermRecord,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<(), ModelError> {
        let collapsed = self.collapsed(error)?;
        let (strata, blocks) = (collapsed.labels(testing.strata), collapsed.labels(testing.blocks));
        if strata.is_none() && testing.strata.is_some() {
            return Err(ModelError::StrataInside { group: self.design.formula.name(error) });
        }
        let testing = Testing {
            strata: strata.as_deref(),
            blocks: blocks.as_deref(),
            error_terms: &[],
            rrpp: false,
            given: None,
            ..testing.clone()
        };
        let (model, own) = (&collapsed.model, row.term.clone());
        let hypotheses = model.space.hypotheses(&model.design, testing.kind, testing.contrasts_of_three)?;
        let found = hypotheses.into_iter().filter(|hypothesis| {
            model.design.formula.name(&model.design.formula.terms[hypothesis.term]) == own
        });
        let chosen: Vec<Hypothesis> = found.collect();
        let observed = model.fitted.observed(&chosen);
        let mut rows: Vec<TermRecord> =
            model.design.formula.terms.iter().map(|_| TermRecord::default()).collect();
        for (hypothesis, sums) in chosen.iter().zip(&observed) {
            rows[hypothesis.term] = model.row(hypothesis, *sums);
        }
        model.test_plain(&chosen, &testing, &mut rows, watch)?;
        if let Some(hypothesis) = chosen.first() {
            let tested = rows.swap_remove(hypothesis.term);
            *row = TermRecord {
                r_squared: row.r_squared,
                partial_eta_squared: row.partial_eta_squared,
                error_term: Some(self.design.formula.name(error)),
                collapsed: true,
                ..tested
            };
        }
        Ok(())
    }

    /// Averages of the vectors in groups with these sums of weights, one a column.
    pub(super) fn group_means(&self, groups: &[usize], weights: &[f64]) -> Matrix {
        let (firsts, mut sums) = (firsts_of(groups), Matrix::zeros(self.vectors.nrows(), weights.len()));
        // About the first shape of each group, so that equal shapes average to themselves.
        for (k, &group) in groups.iter().enumerate() {
            let change = (self.vectors.column(k) - self.vectors.column(firsts[group]))
                * (self.weights[k] / weights[group]);
            let mut sum = sums.column_mut(group);
            sum += change;
        }
        for (group, &first) in firsts.iter().enumerate() {
            let mut sum = sums.column_mut(group);
            sum += self.vectors.column(first);
        }
        sums
    }

    /// The model of the averages of the shapes in the groups of a term: of the terms that are constant in them.
    fn collapsed(&self, error: &Term) -> Result<Collapsed, ModelError> {
        let groups = self.design.cells_of(error);
        let count = groups.iter().max().map_or(0, |last| last + 1);
        let firsts = firsts_of(&groups);
        let mut weights = vec![0.0; count];
        groups.iter().enumerate().for_each(|(k, &group)| weights[group] += self.weights[k]);
        let sums = self.group_means(&groups, &weights);
        let constant = |term: &&Term| {
            let both = pairs(&groups, &self.design.cells_of(term));
            both.iter().max().map_or(0, |last| last + 1) == count
                && term.set() != error.set()
                && !term.contains(error)
        };
        let terms: Vec<Term> = self.design.formula.terms.iter().filter(constant).cloned().collect();
        let formula = Formula { terms, random: Vec::new(), ..self.design.formula.clone() };
        let design = self.design.restricted(formula, &firsts)?;
        let space = Space::new(&design, &weights)?;
        let fitted = Fitted::new(&space, &sums, design.formula.intercept)?;
        Ok(Collapsed { model: Self { design, space, fitted, vectors: sums, weights }, firsts, groups })
    }
}

/// First shape of each group.
fn firsts_of(groups: &[usize]) -> Vec<usize> {
    let mut firsts = vec![usize::MAX; groups.iter().max().map_or(0, |last| last + 1)];
    groups.iter().enumerate().for_each(|(k, &group)| firsts[group] = firsts[group].min(k));
    firsts
}

/// A model with the groups of random parts as factors.
pub(super) struct Grouped {
    pub(super) model: Model,
    /// Terms that vary inside of the groups: places in this model and in the table.
    places: Vec<(usize, usize)>,
    /// Places of the groups in this model, and their random parts.
    groups: Range<usize>,
    names: Vec<String>,
    /// The finest groups, one number for each shape.
    finest: Vec<usize>,
}

impl Grouped {
    /// Fills in the rows of terms that vary inside of the groups, and adds those of the groups.
    pub(super) fn test(
        &self,
        testing: &Testing<'_>,
        rows: &mut Vec<TermRecord>,
        watch: &dyn Watch,
    ) -> Result<(), ModelError> {
        let model = &self.model;
        // The groups depend on the terms that are constant in them.
        let kind = if testing.kind == SumType::III { SumType::II } else { testing.kind };
        let hypotheses = model.space.hypotheses(&model.design, kind, testing.contrasts_of_three)?;
        let observed = model.fitted.observed(&hypotheses);
        let mut own: Vec<TermRecord> =
            hypotheses.iter().zip(&observed).map(|(hypothesis, sums)| model.row(hypothesis, *sums)).collect();
        let inside = testing.blocks.map_or_else(|| self.finest.clone(), |blocks| pairs(&self.finest, blocks));
        let testing = Testing { blocks: Some(&inside), error_terms: &[], ..testing.clone() };
        let chosen = |wanted: &dyn Fn(usize) -> bool| -> Vec<Hypothesis> {
            hypotheses.iter().filter(|h| wanted(h.term) && h.own.ncols() > 0).cloned().collect()
        };
        let within = chosen(&|term| self.places.iter().any(|(place, _)| *place == term));
        if !within.is_empty() {
            model.test(&within, ExchangeKind::Within, &testing, &mut own, watch)?;
        }
        let groups = chosen(&|term| self.groups.contains(&term));
        if !groups.is_empty() {
            model.test(&groups, ExchangeKind::Free, &testing, &mut own, watch)?;
        }
        for (place, name) in self.groups.clone().zip(&self.names) {
            rows.push(TermRecord { term: name.clone(), ..own[place].clone() });
        }
        for &(place, term) in &self.places {
            rows[term] = own[place].clone();
        }
        Ok(())
    }
}

/// The model of averages, with the first shape of each.
struct Collapsed {
    model: Model,
    firsts: Vec<usize>,
    /// Group of each shape.
    groups: Vec<usize>,
}

impl Collapsed {
    /// Labels of the averages; `None` if a group has shapes of several labels.
    fn labels(&self, labels: Option<&[usize]>) -> Option<Vec<usize>> {
        let labels = labels?;
        let of_groups: Vec<usize> = self.firsts.iter().map(|&first| labels[first]).collect();
        let is_constant = self.groups.iter().zip(labels).all(|(&group, label)| of_groups[group] == *label);
        is_constant.then_some(of_groups)
    }
}
