//! The table of a model, from its sums.

use super::design::StreamedDesign;
use super::sums::{DesignSums, Summed};
use crate::metric::Metric;
use crate::models::anova::{few_exchanges, warnings_of};
use crate::models::chi_squared::tail;
use crate::models::coefficients::Coefficients;
use crate::models::error::ModelError;
use crate::models::outcome::{ModelRecord, PredictionRecord};
use crate::models::permuted::Sums;
use crate::models::predictor::{Attributes, Predictor};
use crate::models::records::{AnovaRecord, TermRecord};
use crate::models::study::{GroupScatter, ModelQuestion, unequal_scatter_warning, usual_places};
use crate::models::subspaces::Hypothesis;
use crate::models::tested::Tested;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Sums with what follows of them.
pub(super) struct Solved<'a> {
    streamed: &'a StreamedDesign<'a>,
    summed: Summed<'a>,
    sums: DesignSums<'a>,
    /// `Uᵀ`: a column for each of the basis.
    cross: Matrix,
    /// `T`.
    squares: f64,
    residual: f64,
    total: f64,
}

impl<'a> Solved<'a> {
    pub(super) fn new(streamed: &'a StreamedDesign<'a>, summed: Summed<'a>, sums: DesignSums<'a>) -> Self {
        let cross = sums.cross();
        let squares: f64 = sums.squares.iter().sum();
        // The intercept takes what the origin lacks to the mean.
        let about = match streamed.design.formula.intercept {
            true => cross.column(0).norm_squared(),
            false => 0.0,
        };
        let (residual, total) = ((squares - cross.norm_squared()).max(0.0), (squares - about).max(0.0));
        Self { streamed, summed, sums, cross, squares, residual, total }
    }

    /// All that the sums tell.
    pub(super) fn record(
        mut self,
        question: &ModelQuestion<'_>,
        metric: Option<&Metric>,
        distinct: f64,
    ) -> Result<ModelRecord, ModelError> {
        let scatter = self.sums.scatter();
        let mut anova = self.table(question, scatter.as_ref(), distinct)?;
        let (coefficients, predictions) = self.predicted(question, metric, &mut anova.warnings)?;
        Ok(ModelRecord {
            anova,
            pooled: None,
            coefficients: coefficients.records(&self.streamed.design, &self.streamed.space, metric),
            predictions,
            reduced: question.further.reduced.map(ToString::to_string),
            pairs: None,
            disparity: None,
            trajectories: None,
            random: None,
            manova: None,
            kept: None,
        })
    }

    fn predicted(
        &self,
        question: &ModelQuestion<'_>,
        metric: Option<&Metric>,
        warnings: &mut Vec<String>,
    ) -> Result<(Coefficients, Vec<PredictionRecord>), ModelError> {
        let StreamedDesign { design, space, weights, table, whole, .. } = self.streamed;
        let mut centred = self.cross.clone();
        let mean = design.formula.intercept.then(|| {
            let root = weights.iter().sum::<f64>().sqrt();
            let along = centred.column(0).into_owned();
            let mean = self.summed.origin.iter().zip(along.iter()).map(|(m, u)| m + u / root);
            mean.collect::<Vec<f64>>()
        });
        if mean.is_some() {
            centred.column_mut(0).fill(0.0);
        }
        let coefficients = Coefficients::of(space, &centred, mean);
        let attributes = Attributes::of(design, weights, table)?;
        let predictor = Predictor { attributes: &attributes, coefficients: &coefficients, metric };
        let (_, predictions) = match question.at {
            Some(at) => predictor.predict_all(at)?,
            None => predictor.usual(&usual_places(design, whole), warnings),
        };
        Ok((coefficients, predictions))
    }

    fn tested(&self) -> Tested<'_> {
        let StreamedDesign { design, space, .. } = self.streamed;
        let (residual, total) = (self.residual, self.total);
        Tested { design, space, shapes: self.sums.shapes(), residual, total }
    }

    fn table(
        &self,
        question: &ModelQuestion<'_>,
        scatter: Option<&Matrix>,
        distinct: f64,
    ) -> Result<AnovaRecord, ModelError> {
        let StreamedDesign { design, space, .. } = self.streamed;
        let (tested, testing) = (self.tested(), &question.testing);
        let (hypotheses, names): (Vec<_>, Vec<_>) = self.streamed.hypotheses(question)?.into_iter().unzip();
        let draws = self.summed.exchange.map_or(0, |exchange| exchange.draws());
        let plans: Vec<Plan> = hypotheses.iter().map(|of| self.plan(of)).collect();
        let drawn = parallel::map(draws, &|draw| {
            let [cross, own] = self.sums.drawn(draw);
            plans.iter().map(|plan| plan.sums(&cross, &own)).collect::<Vec<Sums>>()
        });
        let row = |(i, (hypothesis, name)): (usize, (&Hypothesis, String))| {
            let own = dense::multiply(&self.cross, &hypothesis.own).norm_squared();
            let observed = Sums { own, residual: self.residual };
            let mut row = TermRecord { term: name, ..tested.row(hypothesis, observed) };
            if row.degrees == 0 {
                row.aliased_with = space.aliases(design, hypothesis.term);
                return row;
            }
            row.distinct = distinct.is_finite().then_some(distinct);
            let drawn: Vec<Sums> = drawn.iter().map(|sums| sums[i]).collect();
            tested.tell(&mut row, observed, &drawn, testing);
            row.p_asymptotic = scatter.and_then(|scatter| self.asymptotic(hypothesis, scatter, own));
            row
        };
        let rows: Vec<TermRecord> = hypotheses.iter().zip(names).enumerate().map(row).collect();
        let dropped = space.dropped(design);
        let mut warnings = design.warnings.clone();
        if question.further.reduced.is_none() {
            warnings.extend(warnings_of(&dropped, testing, false));
        }
        warnings.extend(rows.iter().filter_map(few_exchanges));
        let mut record = tested.record((tested.degrees(), self.residual), rows, dropped, warnings);
        record.warnings.extend(self.scatter_warning());
        Ok(record)
    }

    fn plan(&self, hypothesis: &Hypothesis) -> Plan {
        let reduced = dense::multiply(&self.cross, &hypothesis.reduced);
        let fitted = dense::multiply(&reduced, &hypothesis.reduced.transpose());
        Plan { fitted, whole: self.squares - reduced.norm_squared(), own: hypothesis.own.clone() }
    }

    /// p value of a sum of squares as shapes become many: the weights are the eigenvalues of the covariance of the residuals of the
    /// reduced model.
    fn asymptotic(&self, hypothesis: &Hypothesis, scatter: &Matrix, own: f64) -> Option<f64> {
        let reduced = dense::multiply(&self.cross, &hypothesis.reduced);
        let residual = scatter - dense::multiply(&reduced, &reduced.transpose());
        let degrees = self.sums.shapes().checked_sub(hypothesis.reduced.ncols()).filter(|df| *df > 0)?;
        let values = dense::symmetric_eigen(&residual).eigenvalues;
        let weights: Vec<f64> = values.iter().map(|value| value / degrees as f64).collect();
        tail(&weights, hypothesis.own.ncols(), own)
    }

    fn scatter_warning(&self) -> Option<String> {
        let StreamedDesign { design, space, basis, counts, factors, .. } = self.streamed;
        if factors.is_empty() {
            return None;
        }
        let none = GroupScatter { square: 0.0, free: 0.0, number: 0, first: usize::MAX };
        let mut groups = vec![none; basis.count];
        let leverages = space.leverages();
        // `Σ‖y − Uᵀq‖²` of a group.
        let products: Vec<Matrix> = (0..basis.count)
            .map(|group| dense::transpose_multiply(&self.sums.cross_of(group), &self.cross))
            .collect();
        for (group, (sums, products)) in groups.iter_mut().zip(&products).enumerate() {
            sums.square = self.sums.squares[group] - 2.0 * products.trace();
        }
        for (row, &group) in basis.groups.iter().enumerate() {
            let sums = &mut groups[group as usize];
            let q = Matrix::from_column_slice(basis.rank, 1, space.basis.row(row).transpose().as_slice());
            sums.square += dense::multiply(&self.cross, &q).norm_squared();
            sums.free += counts[row] - leverages[row];
            sums.number += counts[row] as usize;
            sums.first = sums.first.min(row);
        }
        unequal_scatter_warning(&groups, &|row| design.levels_at(factors, row))
    }
}

/// A hypothesis with what all draws share.
struct Plan {
    /// `(M_j U)ᵀ`.
    fitted: Matrix,
    /// `‖R_j‖²`.
    whole: f64,
    /// `B_j`.
    own: Matrix,
}

impl Plan {
    /// Sums of squares of the pseudo-data of a draw with `U_bᵀ` and `X_bᵀ`.
    fn sums(&self, cross: &Matrix, own: &Matrix) -> Sums {
        let all = cross - dense::multiply(&self.fitted, own);
        let residual = (self.whole - all.norm_squared()).max(0.0);
        Sums { own: dense::multiply(&all, &self.own).norm_squared(), residual }
    }
}
