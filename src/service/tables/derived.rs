//! Results of a dictionary for the shapes of a cohort, as columns: scores, `T²`, novelty, class.

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::analysis::AnalysisError;
use crate::analysis::defaults::OUTLIER_QUANTILE;
use crate::analysis::dictionary::coding::CodedShape;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::ready::Ready;
use crate::store::{Cursor, Ids, Revisions, ScanBatch};
use crate::wire::table::{NO_TEXT, Values};

/// Value that a dictionary gives a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
pub(crate) enum Derived {
    /// Score of a component, or coefficient of an atom, from 0.
    Score(usize),
    /// Squared Mahalanobis distance of the scores.
    TSquared,
    /// Squared prediction error.
    Residual,
    /// Relative error of the reconstruction.
    RelativeError,
    /// Whether the shape is an outlier.
    Outlier,
    /// The most likely class.
    Class,
    /// Confidence of the class.
    Confidence,
}

impl Derived {
    /// Splits the name of a column into that of a dictionary and one of its values.
    pub(crate) fn parse(name: &str) -> Option<(&str, Self)> {
        let (before, last) = name.rsplit_once('.')?;
        let (key, derived) = match last {
            "t_squared" => (before, Self::TSquared),
            "residual" => (before, Self::Residual),
            "relative_error" => (before, Self::RelativeError),
            "outlier" => (before, Self::Outlier),
            "class" => (before, Self::Class),
            "confidence" => (before, Self::Confidence),
            number => {
                let component: usize = number.parse().ok().filter(|component| *component > 0)?;
                (before.strip_suffix(".score")?, Self::Score(component - 1))
            }
        };
        (!key.is_empty()).then_some((key, derived))
    }

    /// Names that [`Self::parse`] reads after that of a dictionary.
    pub(crate) const WANTED: &str = "<dictionary>.score.<number>, .t_squared, .residual, .relative_error, .outlier, .class or .confidence";
}

/// Values of a dictionary for shapes of a cohort, in storage order.
#[derive(Debug, Clone, Default)]
pub(crate) struct DerivedColumns {
    /// Last revision of the cohort that was looked at.
    revision: u64,
    places: Vec<Cursor>,
    /// Components or atoms whose scores are kept, and the scores, one shape after the other.
    components: Vec<usize>,
    scores: Vec<f64>,
    t_squared: Vec<f64>,
    residual: Vec<f64>,
    relative_error: Vec<f64>,
    outlier: Vec<Option<bool>>,
    class: Vec<u32>,
    confidence: Vec<f64>,
}

impl Cached for DerivedColumns {
    const NAME: &'static str = "derived columns";

    fn bytes(&self) -> usize {
        bytes_of(self.places.len(), self.components.len())
    }
}

/// Memory of the values of `shapes` shapes.
fn bytes_of(shapes: usize, components: usize) -> usize {
    shapes.saturating_mul(8 * components + 64)
}

/// Dictionaries with at most this many components keep the scores of all, so that another pair costs nothing.
const KEPT_COMPONENTS: usize = 32;

/// Values of a dictionary for the shapes of a cohort at its revision, those that pass the filter at least. Cost: the shapes that
/// are new since the last call are encoded.
///
/// # Errors
/// A cohort that does not suit the dictionary; values that do not fit in memory; work beyond the limit of a request.
pub(crate) async fn of_cohort(
    app: &App,
    cohort: &Cohort,
    ready: &Arc<Ready>,
    wanted: &BTreeSet<Derived>,
    filter: &ShapeFilter,
) -> Result<Arc<DerivedColumns>, ServiceError> {
    let components = components_kept(ready, wanted);
    // Of the cohort, so that an erasure in it forgets them.
    let key = (&ready.listed.id, &components);
    let known = app.cache.find::<DerivedColumns>(&cohort.id, &key);
    let known = known.filter(|known| known.revision <= cohort.revision);
    if let Some(known) = known.as_ref().filter(|known| known.revision == cohort.revision) {
        return Ok(Arc::clone(known));
    }
    let bytes = bytes_of(usize::try_from(cohort.shapes).unwrap_or(usize::MAX), components.len());
    let keeps_all = (filter.is_everything() || known.is_some()).then(|| app.cache.reserve(bytes)).flatten();
    let everything = ShapeFilter::everything();
    let (filter, begun) = match &keeps_all {
        Some(_) => (&everything, known.as_deref().cloned()),
        None => (filter, None),
    };
    let begun = begun.unwrap_or(DerivedColumns { components, ..DerivedColumns::default() });
    let columns = Arc::new(brought_up(app, cohort, ready, begun, filter).await?);
    if keeps_all.is_some() {
        let key = (&ready.listed.id, &columns.components);
        drop(keeps_all);
        app.cache.keep(&cohort.id, &key, &columns);
    }
    Ok(columns)
}

fn components_kept(ready: &Ready, wanted: &BTreeSet<Derived>) -> Vec<usize> {
    let all = ready.dictionary().content.atoms.len();
    if all <= KEPT_COMPONENTS {
        return (0..all).collect();
    }
    let component = |derived: &Derived| match derived {
        Derived::Score(component) => Some(*component),
        _ => None,
    };
    wanted.iter().filter_map(component).collect()
}

/// Encodes the shapes that were added since the revision of `columns`; the next batch is read meanwhile.
async fn brought_up(
    app: &App,
    cohort: &Cohort,
    ready: &Arc<Ready>,
    mut columns: DerivedColumns,
    filter: &ShapeFilter,
) -> Result<DerivedColumns, ServiceError> {
    let revisions = Revisions { after: columns.revision, until: cohort.revision };
    let count = app.store.count(&cohort.id, revisions, filter).await?;
    let length = ready.setup.metric.len();
    app.pool.check(ready.work(usize::try_from(count).unwrap_or(usize::MAX), 0, &app.limits))?;
    let next = |after| app.store.scan(&cohort.id, revisions, filter, after, Ids::Skip);
    let mut batch = next(None).await?;
    while let Some(current) = batch {
        let position = current.position;
        let work = ready.work(current.control_points.len() / length.max(1), 0, &app.limits);
        let (ready, task_app) = (Arc::clone(ready), app.clone());
        let pool = app.pool.weighing(work);
        let encoded = pool.run(move || add_batch(&task_app, &ready, columns, &current));
        let (encoded, read) = tokio::join!(encoded, next(Some(position)));
        (columns, batch) = (encoded?, read?);
    }
    columns.revision = cohort.revision;
    columns.sort();
    Ok(columns)
}

fn add_batch(
    app: &App,
    ready: &Ready,
    mut columns: DerivedColumns,
    batch: &ScanBatch,
) -> Result<DerivedColumns, ServiceError> {
    let context = app.pool.context();
    let dictionary = ready.dictionary();
    match dictionary.encode(&batch.control_points, &context) {
        Ok(coded) => columns.push(ready, &coded.iter().map(Some).collect::<Vec<_>>())?,
        Err(AnalysisError::Interrupted) => return Err(AnalysisError::Interrupted.into()),
        // A shape without a code has missing values; the others have theirs.
        Err(_) => {
            let shapes = batch.control_points.chunks_exact(ready.setup.metric.len());
            let coded: Vec<Option<CodedShape>> =
                shapes.map(|shape| dictionary.encode(shape, &context).ok()?.pop()).collect();
            context.check()?;
            columns.push(ready, &coded.iter().map(Option::as_ref).collect::<Vec<_>>())?;
        }
    }
    columns.places.extend(batch.places.iter());
    Ok(columns)
}

impl DerivedColumns {
    fn push(&mut self, ready: &Ready, coded: &[Option<&CodedShape>]) -> Result<(), ServiceError> {
        let dictionary = ready.dictionary();
        for &coded in coded {
            let score = coded.map(|coded| dictionary.score(coded, OUTLIER_QUANTILE));
            let value = |component: &usize| {
                let code = &coded?.code;
                let at = code.indices.binary_search(component).ok();
                Some(at.map_or(0.0, |at| code.values[at]))
            };
            let scores = self.components.iter().map(|component| value(component).unwrap_or(f64::NAN));
            self.scores.extend(scores);
            self.t_squared.push(score.as_ref().and_then(|score| score.t_squared).unwrap_or(f64::NAN));
            self.residual.push(score.as_ref().map_or(f64::NAN, |score| score.residual));
            self.relative_error.push(coded.map_or(f64::NAN, |coded| coded.code.relative_error));
            self.outlier.push(score.map(|score| score.outlier));
        }
        self.push_classes(ready, coded)
    }

    fn push_classes(&mut self, ready: &Ready, coded: &[Option<&CodedShape>]) -> Result<(), ServiceError> {
        let present: Vec<CodedShape> = coded.iter().flatten().map(|coded| (*coded).clone()).collect();
        let mut classified = match ready.dictionary().content.classifier {
            Some(_) => ready.assessor.classify(&present, OUTLIER_QUANTILE)?.unwrap_or_default().into_iter(),
            None => Vec::new().into_iter(),
        };
        for coded in coded {
            let first =
                coded.and_then(|_| classified.next()).and_then(|found| found.ranking.into_iter().next());
            self.class.push(first.as_ref().map_or(NO_TEXT, |first| first.class as u32));
            self.confidence.push(first.map_or(f64::NAN, |first| first.confidence));
        }
        Ok(())
    }

    /// Restores storage order, which uploads at the same time may have left.
    fn sort(&mut self) {
        if self.places.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.places.len()).collect();
        order.sort_by_key(|&shape| self.places[shape]);
        let width = self.components.len();
        let numbers = |values: &[f64]| order.iter().map(|&shape| values[shape]).collect();
        *self = Self {
            revision: self.revision,
            places: order.iter().map(|&shape| self.places[shape]).collect(),
            scores: order.iter().flat_map(|&shape| &self.scores[shape * width..][..width]).copied().collect(),
            t_squared: numbers(&self.t_squared),
            residual: numbers(&self.residual),
            relative_error: numbers(&self.relative_error),
            outlier: order.iter().map(|&shape| self.outlier[shape]).collect(),
            class: order.iter().map(|&shape| self.class[shape]).collect(),
            confidence: numbers(&self.confidence),
            components: std::mem::take(&mut self.components),
        };
    }

    /// Values of the shapes at these places, which are in storage order.
    pub(crate) fn values(&self, ready: &Ready, derived: Derived, places: &[Cursor]) -> Values {
        let mut next = 0;
        let found: Vec<Option<usize>> = places
            .iter()
            .map(|place| {
                next += self.places[next..].partition_point(|other| other < place);
                (self.places.get(next) == Some(place)).then_some(next)
            })
            .collect();
        let numbers = |of: &dyn Fn(usize) -> f64| {
            Values::Number(found.iter().map(|shape| shape.map_or(f64::NAN, of)).collect())
        };
        let width = self.components.len();
        match derived {
            Derived::Score(component) => match self.components.binary_search(&component) {
                Ok(at) => numbers(&|shape| self.scores[shape * width + at]),
                Err(_) => numbers(&|_| f64::NAN),
            },
            Derived::TSquared => numbers(&|shape| self.t_squared[shape]),
            Derived::Residual => numbers(&|shape| self.residual[shape]),
            Derived::RelativeError => numbers(&|shape| self.relative_error[shape]),
            Derived::Confidence => numbers(&|shape| self.confidence[shape]),
            Derived::Outlier => {
                Values::Flag(found.iter().map(|shape| shape.and_then(|shape| self.outlier[shape])).collect())
            }
            Derived::Class => {
                let classes = ready.dictionary().content.classifier.iter().flat_map(|record| &record.classes);
                Values::Text {
                    rows: found
                        .iter()
                        .map(|shape| shape.map_or(NO_TEXT, |shape| self.class[shape]))
                        .collect(),
                    texts: classes.map(|class| class.label.as_str().into()).collect(),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_name_a_dictionary_and_a_value() {
        assert_eq!(Derived::parse("cells.score.1"), Some(("cells", Derived::Score(0))));
        assert_eq!(Derived::parse("a.b@3.t_squared"), Some(("a.b@3", Derived::TSquared)));
        for wrong in ["cells.score.0", "cells.score", "score.1", ".outlier", "outlier", "cells.weight", "1.2"]
        {
            assert_eq!(Derived::parse(wrong), None, "{wrong}");
        }
    }
}
