//! Outcomes of a request about many shapes: a value for each of them, or the reason why it has none.

use crate::analysis::AnalysisError;
use crate::service::app::ServiceError;
use crate::service::app::faults::Faults;
use crate::service::app::parallel;
use crate::service::app::problem::Problem;
use crate::service::app::progress::JobContext;
use crate::wire::fault::Fault;

/// Treatment of shapes that have no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnError {
    /// The request is refused, with the faults of all shapes.
    #[default]
    Abort,
    /// They are answered with an error; all others are treated as usual.
    Skip,
}

/// Reason why a shape has no answer.
#[derive(Debug, serde::Serialize, utoipa::ToSchema)]
pub struct ShapeError {
    /// Short name of the problem type.
    #[schema(example = "degenerate-shape")]
    code: &'static str,
    /// Description and remedy.
    detail: String,
    /// All faults of the shape; those of the first thousand faults of a request are described in full.
    errors: Vec<Fault>,
}

impl From<ServiceError> for ShapeError {
    fn from(error: ServiceError) -> Self {
        let problem = Problem::from(error);
        let (code, detail) = (problem.kind().code(), problem.detail().to_owned());
        Self { code, detail, errors: problem.into_errors() }
    }
}

/// Values for the shapes of a request, in order. A shape without a value has an error in its place.
#[derive(Debug)]
pub struct Outcomes<T>(Vec<Result<T, ServiceError>>);

impl<T> Outcomes<T> {
    /// One outcome per shape.
    pub fn new(outcomes: Vec<Result<T, ServiceError>>) -> Self {
        Self(outcomes)
    }

    /// Outcomes of reading the entries of `list`, whose faults are placed at `/{list}/{index}…`.
    pub(crate) fn of_list(list: &str, results: Vec<Result<T, Vec<Fault>>>) -> Self {
        let place = |(index, result): (usize, Result<T, Vec<Fault>>)| {
            result.map_err(|faults| ServiceError::of_entry(list, index, faults))
        };
        Self(results.into_iter().enumerate().map(place).collect())
    }

    /// Values of all entries of `list`, which are read one after the other: of the faults of many no more is kept than is told.
    ///
    /// # Errors
    /// The faults of all entries without a value, at `/{list}/{index}…`.
    pub(crate) fn all_of_list(
        list: &str,
        results: impl IntoIterator<Item = Result<T, Vec<Fault>>>,
    ) -> Result<Vec<T>, ServiceError> {
        let (mut values, mut faults) = (Vec::new(), Faults::default());
        for (index, result) in results.into_iter().enumerate() {
            let placed = result.map_err(|faults| ServiceError::of_entry(list, index, faults));
            values.extend(faults.keep(placed)?);
        }
        faults.unless_any().map(|()| values)
    }

    /// Number of shapes.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no shapes.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The values that there are, in order.
    pub(crate) fn values(&self) -> impl Iterator<Item = &T> {
        self.0.iter().filter_map(|outcome| outcome.as_ref().ok())
    }

    /// Outcomes in order.
    pub fn into_vec(self) -> Vec<Result<T, ServiceError>> {
        self.0
    }

    /// Values of all shapes.
    ///
    /// # Errors
    /// The faults of all shapes without one; the first error that is not a list of faults.
    pub fn all(self) -> Result<Vec<T>, ServiceError> {
        let (mut values, mut faults) = (Vec::with_capacity(self.0.len()), Faults::default());
        for outcome in self.0 {
            values.extend(faults.keep(outcome)?);
        }
        faults.unless_any().map(|()| values)
    }

    /// The same outcomes; under [`OnError::Abort`] every shape has a value.
    ///
    /// # Errors
    /// Under [`OnError::Abort`] those of [`Self::all`].
    pub fn checked(self, on_error: OnError) -> Result<Self, ServiceError> {
        match on_error {
            OnError::Abort => self.all().map(|values| Self(values.into_iter().map(Ok).collect())),
            OnError::Skip => Ok(self),
        }
    }

    /// Applies `work` to every value.
    pub fn map<U>(self, work: impl Fn(usize, T) -> Result<U, ServiceError>) -> Outcomes<U> {
        let outcomes = self.0.into_iter().enumerate();
        Outcomes(outcomes.map(|(index, outcome)| outcome.and_then(|value| work(index, value))).collect())
    }

    /// Applies `work` to every value in parallel, until the request is cancelled.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`].
    pub(crate) fn each<U: Send>(
        self,
        context: &JobContext,
        work: impl Fn(usize, T) -> Result<U, ServiceError> + Sync,
    ) -> Result<Outcomes<U>, ServiceError>
    where
        T: Send,
    {
        let outcomes = parallel::map(self.0, |index, outcome| {
            context.check()?;
            outcome.and_then(|value| work(index, value))
        });
        context.check().map(|()| Outcomes(outcomes))
    }

    /// Pairs each value with its result of `work` on all values together. Under [`OnError::Skip`], where it fails for one
    /// shape, it is applied to smaller and smaller parts, so that only that shape has an error: with `b` such shapes it
    /// runs at most `2 b log₂ n` times more.
    ///
    /// # Errors
    /// Errors of `work` that are not about a single shape; under [`OnError::Abort`] all.
    pub(crate) fn together<U>(
        self,
        on_error: OnError,
        work: impl Fn(&[T]) -> Result<Vec<U>, AnalysisError>,
    ) -> Result<Outcomes<(T, U)>, ServiceError> {
        let mut values = Vec::with_capacity(self.0.len());
        let places: Vec<Result<(), ServiceError>> =
            self.0.into_iter().map(|outcome| outcome.map(|value| values.push(value))).collect();
        let found = match on_error {
            OnError::Abort => work(&values).map(|found| found.into_iter().map(Ok).collect()),
            OnError::Skip => apart(&values, &work),
        };
        let found: Vec<Result<U, AnalysisError>> =
            found.map_err(|error| of_shape(error.position().unwrap_or(0), error))?;
        let mut found = values.into_iter().zip(found);
        let placed = |(index, place): (usize, Result<(), ServiceError>)| {
            let missing = || ServiceError::Internal("a shape without an outcome".into());
            let (value, result) = place.and_then(|()| found.next().ok_or_else(missing))?;
            result.map(|result| (value, result)).map_err(|error| of_shape(index, error))
        };
        Ok(Outcomes(places.into_iter().enumerate().map(placed).collect()))
    }
}

/// Results of `work` for all values, each with its own error.
fn apart<T, U>(
    values: &[T],
    work: &impl Fn(&[T]) -> Result<Vec<U>, AnalysisError>,
) -> Result<Vec<Result<U, AnalysisError>>, AnalysisError> {
    if values.is_empty() {
        return Ok(Vec::new());
    }
    match work(values) {
        Ok(found) => Ok(found.into_iter().map(Ok).collect()),
        Err(error) if error.position().is_none() => Err(error),
        Err(error) if values.len() == 1 => Ok(vec![Err(error)]),
        Err(_) => {
            let (first, second) = values.split_at(values.len() / 2);
            let mut found = apart(first, work)?;
            found.extend(apart(second, work)?);
            Ok(found)
        }
    }
}

/// Error of the shape at `index` of a request.
pub fn of_shape(index: usize, error: AnalysisError) -> ServiceError {
    let error = error.at(index);
    match error {
        AnalysisError::NoConvergence { .. } => {
            let fault = Fault::new(format!("/shapes/{index}"), error.to_string());
            ServiceError::Invalid(vec![fault.at_shape(index)].into())
        }
        other => ServiceError::from_request(other),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn read(count: usize, bad: &[usize]) -> Outcomes<usize> {
        let one = |i| if bad.contains(&i) { Err(vec![Fault::new("/points", "bad")]) } else { Ok(i) };
        Outcomes::of_list("shapes", (0..count).map(one).collect())
    }

    fn flat(index: usize) -> AnalysisError {
        AnalysisError::NoExtent { index, norm: 0.0, size: 1.0 }
    }

    #[test]
    fn aborting_names_all_faults_and_skipping_keeps_the_others() {
        let Err(ServiceError::Invalid(faults)) = read(5, &[1, 3]).checked(OnError::Abort) else {
            panic!("not refused")
        };
        let places: Vec<_> = faults.listed().iter().map(|f| (f.pointer.as_str(), f.index)).collect();
        assert_eq!(places, [("/shapes/1/points", Some(1)), ("/shapes/3/points", Some(3))]);
        let kept = read(5, &[1, 3]).checked(OnError::Skip).unwrap().into_vec();
        let valid: Vec<Option<usize>> = kept.into_iter().map(Result::ok).collect();
        assert_eq!(valid, [Some(0), None, Some(2), None, Some(4)]);
    }

    #[test]
    fn a_failing_shape_leaves_those_treated_with_it() {
        let calls = Cell::new(0);
        let work = |values: &[usize]| {
            calls.set(calls.get() + 1);
            match values.iter().position(|value| [700, 901].contains(value)) {
                Some(position) => Err(flat(position)),
                None => Ok(values.iter().map(|value| 2 * value).collect()),
            }
        };
        let found = read(1000, &[5]).together(OnError::Skip, work).unwrap().into_vec();
        for (index, outcome) in found.into_iter().enumerate() {
            match outcome {
                Ok((_, value)) => assert!(value == 2 * index && ![5, 700, 901].contains(&index)),
                Err(ServiceError::Invalid(_)) => assert_eq!(index, 5),
                Err(ServiceError::DegenerateShape(faults)) => {
                    assert!([700, 901].contains(&index));
                    let place = (faults[0].pointer.clone(), faults[0].index);
                    assert_eq!(place, (format!("/shapes/{index}"), Some(index)));
                }
                Err(other) => panic!("{other}"),
            }
        }
        assert!(calls.get() <= 1 + 2 * 2 * 10, "{}", calls.get());
        let refused = read(1000, &[]).together(OnError::Abort, work);
        assert!(
            matches!(refused, Err(ServiceError::DegenerateShape(faults)) if faults[0].index == Some(700))
        );
        let stopped = read(9, &[])
            .together(OnError::Skip, |_: &[usize]| Err::<Vec<usize>, _>(AnalysisError::Interrupted));
        assert!(matches!(stopped, Err(ServiceError::Cancelled)));
    }
}
