//! Mean of a stored cohort at its current revision, with some aligned shapes for drawings.
//!
//! It is computed on demand, and cached by revision and parameters. A search for start points begins with the placements that
//! the last one has found: of the leading shapes, which does not change the result, or on request of all.

use std::collections::HashSet;
use std::mem::take;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use serde::Serialize;
use tokio::runtime::Handle;

use super::at_engine::{AtEngine, Passes, Purpose};
use super::attributes::{FilterPlace, refuse_unknown};
use super::caveats;
use super::measures;
use super::placements::{KnownPlacements, SearchSettings, Which};
use super::source::StoredShapes;
use crate::analysis::accumulate::{ShapeSource, prepare};
use crate::analysis::alignment::{AlignedShape, Alignment, MeanShape, align};
use crate::analysis::factors::{Estimator, RobustSummary};
use crate::analysis::frame::Frame;
use crate::analysis::robust::{Listed, mean_by};
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::domain::dictionary::LessCountedShape;
use crate::domain::filter::ShapeFilter;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::statistics::{CheckedSettings, Settings, Setup};
use crate::store::Revisions;

/// Parameters of a cohort mean.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize)]
pub struct MeanQuery {
    /// Transformation class.
    pub transformation: ClassName,
    /// Projection or Procrustes alignment. Default: [`Alignment::usual`].
    pub alignment: Option<Alignment>,
    /// Frame: selects the representative of the mean space.
    pub frame: Frame,
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// Placements with which the search for start points begins.
    pub start: SearchStart,
    /// Whether shapes unlike the majority count less.
    pub robust: bool,
    /// Whether the client says that the parameters of surfaces correspond.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub corresponding: bool,
}

/// Placements with which a search for start points, directions and mirror images begins. The alternation of mean and
/// placements ends in one of many local optima: from the shapes as given the result depends on the shapes alone, and for more than
/// 8192 plane curves under similarities on their order; from the placements of the last search it takes fewer rounds, but depends on the means that were computed
/// before.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum SearchStart {
    /// The shapes as given.
    #[default]
    Given,
    /// The placements of the last search with the same parameters, if the service remembers one.
    Last,
}

impl MeanQuery {
    /// Alignment of the shapes of `cohort`.
    fn alignment_in(&self, cohort: &Cohort) -> Alignment {
        let dimension = cohort.spec.representation.dimension();
        let usual = Alignment::usual(&Transformation::Named(self.transformation), dimension);
        self.alignment.unwrap_or(usual)
    }

    /// Settings on which the placements of the shapes depend.
    fn search(&self, cohort: &Cohort) -> SearchSettings {
        SearchSettings {
            transformation: Transformation::Named(self.transformation),
            alignment: self.alignment_in(cohort),
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: cohort.spec.mirror,
            filter: self.filter.clone(),
            robust: self.robust,
        }
    }
}

/// Mean of a cohort at a revision.
#[derive(Debug)]
pub struct LiveMean {
    /// The cohort at that revision.
    pub cohort: Cohort,
    /// Setup of the computation.
    pub setup: Setup,
    /// The mean, without placements.
    pub mean: MeanShape,
    /// Some aligned shapes, for drawings.
    pub drawn: Vec<AlignedShape>,
    /// Revision of the placements with which the search for start points began; `None` if it began with the shapes as given,
    /// or if there is nothing to search.
    pub started_from: Option<u64>,
    /// Shapes that a robust mean leaves out.
    pub robust: Option<LeftOut>,
    /// A warning of contours drawn both ways round, if that matters.
    pub mixed: Option<String>,
}

/// Shapes that a robust mean leaves out, or that count less.
#[derive(Debug)]
pub struct LeftOut {
    /// Their numbers.
    pub summary: RobustSummary,
    /// Those with the smallest factors, ascending; at most [`MAX_LISTED`].
    pub shapes: Vec<LessCountedShape>,
}

/// Maximum number of listed shapes of a robust mean.
pub const MAX_LISTED: usize = 100;

/// Maximum number of weights of control points that they have.
const LISTED_NUMBERS: usize = 1 << 16;

impl LeftOut {
    /// Of a robust `mean` of `shapes`, which are those of `source`. `None` of a plain one.
    fn new(
        setup: &Setup,
        mean: &MeanShape,
        shapes: &dyn ShapeSource,
        source: &StoredShapes<'_>,
    ) -> Result<Option<Self>, ServiceError> {
        let Some(factors) = &mean.robust else { return Ok(None) };
        let Some(listed) = Listed::of(shapes, factors, MAX_LISTED)? else {
            return Ok(Some(Self { summary: factors.summary(), shapes: Vec::new() }));
        };
        let Setup { metric, method, matching, .. } = setup;
        let (mut aligned, centroid) = (Vec::new(), vec![0.0; metric.dimension()]);
        for (x, &k) in listed.shapes().all().whitened.chunks_exact(metric.len()).zip(listed.positions()) {
            let shape = align(method, matching, &mean.whitened, x, &centroid, mean.placements[k])?;
            aligned.extend(shape.whitened);
        }
        let described = listed.described(setup.measured(), &aligned)?;
        let shapes = source.less_counted(described, LISTED_NUMBERS)?;
        Ok(Some(Self { summary: factors.summary(), shapes }))
    }

    fn bytes(&self) -> usize {
        let of = |shape: &LessCountedShape| 64 + 8 * shape.point_weights.as_ref().map_or(0, Vec::len);
        self.shapes.iter().map(of).sum()
    }
}

impl Cached for LiveMean {
    const NAME: &'static str = "means";

    fn bytes(&self) -> usize {
        // Control points, plain and whitened, of the mean and of every drawn shape, plus a few vectors.
        let vectors = 8 + 3 * self.drawn.len();
        8 * vectors * self.setup.metric.len()
            + self.setup.space.bytes()
            + self.robust.as_ref().map_or(0, LeftOut::bytes)
    }
}

/// Mean of the shapes of a cohort that match the filter, at its current revision; cached.
///
/// # Errors
/// [`ServiceError::NotFound`]; too few or degenerate shapes.
pub async fn mean(app: &App, cohort: Cohort, query: MeanQuery) -> Result<Arc<LiveMean>, ServiceError> {
    let (id, key) = (cohort.id.clone(), (cohort.revision, query.clone()));
    if let Some(known) = app.cache.find(&id, &key) {
        return Ok(known);
    }
    let settings = Settings {
        representation: cohort.spec.representation.clone(),
        correspondence: cohort.spec.correspondence,
        direction: cohort.spec.direction,
        mirror: cohort.spec.mirror,
        transformation: Transformation::Named(query.transformation),
        alignment: query.alignment_in(&cohort),
        frame: query.frame,
        estimator: Estimator::robust(query.robust),
    };
    let settings = settings.checked(&app.limits)?;
    measures::complete_for(app, &cohort, &query.filter).await?;
    if !query.corresponding
        && let Some(detail) = caveats::refusal(app, &cohort, &query.filter).await?
    {
        return Err(ServiceError::parameter("corresponding", detail));
    }
    let mixed = caveats::of_directions(app, &cohort, &query.filter, cohort.spec.mirror).await?;
    let (task_app, handle) = (app.clone(), Handle::current());
    let work = requests::align(&settings, Counts::for_cohort(&cohort, &app.limits));
    let computed =
        app.pool.weighing(work).run(move || compute(&task_app, &handle, cohort, settings, query)).await?;
    let mean = Arc::new(LiveMean { mixed, ..computed });
    app.cache.keep(&id, &key, &mean);
    app.cache.keep(&id, &key.1, &Arc::new(Latest(mean.cohort.clone())));
    Ok(mean)
}

/// A cohort at the revision of its last mean with some parameters.
struct Latest(Cohort);

impl Cached for Latest {
    const NAME: &'static str = "latest_means";

    fn bytes(&self) -> usize {
        1024
    }
}

/// Means that are being computed because an older one was answered.
#[derive(Debug, Default)]
struct Renewals(Mutex<HashSet<(String, u64, MeanQuery)>>);

impl Renewals {
    fn locked(&self) -> MutexGuard<'_, HashSet<(String, u64, MeanQuery)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The cohort at the revision of the last mean with these parameters. The mean of the current revision is then computed in
/// the background. If there was none, or if shapes of its revision were erased since, the cohort as it is.
///
/// # Errors
/// A failure of the store.
pub async fn at_last_mean(app: &App, cohort: Cohort, query: &MeanQuery) -> Result<Cohort, ServiceError> {
    let Some(latest) = app.cache.find::<Latest>(&cohort.id, query) else { return Ok(cohort) };
    let latest = latest.0.clone();
    if latest.revision != cohort.revision {
        let (revisions, all) = (Revisions::until(latest.revision), ShapeFilter::default());
        if app.store.count(&cohort.id, revisions, &all).await? != latest.shapes {
            return Ok(cohort);
        }
        renew(app, cohort, query.clone());
    }
    Ok(latest)
}

/// Starts to compute a mean, unless that is under way.
fn renew(app: &App, cohort: Cohort, query: MeanQuery) {
    let renewals: Arc<Renewals> = app.state();
    let what = (cohort.id.clone(), cohort.revision, query.clone());
    if !renewals.locked().insert(what.clone()) {
        return;
    }
    // The work belongs to the caller, but does not end with the request.
    let app = app.of(Arc::clone(&app.principal)).until(Instant::now() + app.limits.compute_time);
    tokio::spawn(async move {
        if let Err(error) = mean(&app, cohort, query).await {
            tracing::info!(cohort = what.0, %error, "a mean was not renewed");
        }
        renewals.locked().remove(&what);
    });
}

fn compute(
    app: &App,
    handle: &Handle,
    cohort: Cohort,
    settings: CheckedSettings,
    query: MeanQuery,
) -> Result<LiveMean, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let Found { mean, drawn, started_from, robust } = find(app, handle, &cohort, &setup, &query)?;
    Ok(LiveMean { setup, mean, drawn, cohort, started_from, robust, mixed: None })
}

/// A mean, and further findings.
struct Found {
    mean: MeanShape,
    drawn: Vec<AlignedShape>,
    started_from: Option<u64>,
    robust: Option<LeftOut>,
}

fn find(
    app: &App,
    handle: &Handle,
    cohort: &Cohort,
    setup: &Setup,
    query: &MeanQuery,
) -> Result<Found, ServiceError> {
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let search = setup.matching.searches().then(|| query.search(cohort));
    let known = search.as_ref().and_then(|search| KnownPlacements::find(app, &cohort.id, search));
    let which = match query.start {
        SearchStart::Given => Which::Leading,
        SearchStart::Last => Which::All,
    };
    let source = StoredShapes::new(app, handle, cohort, &query.filter, 0, setup, &stop)?;
    if source.is_empty() {
        handle.block_on(refuse_unknown(app, cohort, &query.filter, FilterPlace::Query))?;
    }
    let source = source.starting_from(known.as_deref().map(|known| (known, which)));
    let (filter, transformation) = (&query.filter, &Transformation::Named(query.transformation));
    let (alignment, purpose) = (setup.alignment(), Purpose::Mean);
    let passes = Passes { cohort, filter, transformation, alignment, purpose };
    let engine = AtEngine::of(app, passes, source.len());
    let source = match &engine {
        Some(engine) => source.distributed_by(engine),
        None => source,
    };
    let (mut mean, robust) = mean_of(setup, &source, query.robust)?;
    let drawn = drawn(&source, setup, &mean)?;
    let started_from = known.as_ref().filter(|_| which == Which::All).map(|known| known.revision);
    if let Some(search) = search {
        let (revision, places) = (cohort.revision, source.places()?);
        let (placements, mut leading) = (take(&mut mean.placements), take(&mut mean.leading));
        if leading.is_empty() {
            leading = known.and_then(|known| known.start(Which::Leading, &places)).unwrap_or_default();
        }
        let found = KnownPlacements { revision, started_from, places, placements, leading };
        found.keep(app, &cohort.id, &search);
    }
    Ok(Found { mean, drawn, started_from, robust })
}

/// The mean of shapes, and the shapes that a robust one leaves out.
fn mean_of(
    setup: &Setup,
    source: &StoredShapes<'_>,
    robust: bool,
) -> Result<(MeanShape, Option<LeftOut>), ServiceError> {
    let Setup { metric, method, frame, matching, estimator, .. } = setup;
    // Searches and robust means take several passes; others take two, each as fast as the store.
    let kept = if matching.searches() || robust { source.kept(true, None)? } else { None };
    let shapes: &dyn ShapeSource = match &kept {
        Some(kept) => kept,
        None => source,
    };
    let mean = mean_by(*estimator, shapes, metric, method, *frame, matching);
    let mut mean = mean.map_err(|error| source.named(error))?;
    let robust = LeftOut::new(setup, &mean, shapes, source)?;
    mean.robust = None;
    Ok((mean, robust))
}

/// The first shapes, aligned to their mean.
fn drawn(
    source: &StoredShapes<'_>,
    Setup { metric, method, matching, .. }: &Setup,
    mean: &MeanShape,
) -> Result<Vec<AlignedShape>, ServiceError> {
    let mut drawn = Vec::new();
    let first = source.first(MAX_DRAWN)?;
    for (k, shape) in first.chunks_exact(metric.len()).enumerate() {
        let (mut x, centroid) = (shape.to_vec(), metric.centroid(shape));
        prepare(metric, method.translates(), k, &mut x)?;
        drawn.push(align(method, matching, &mean.whitened, &x, &centroid, mean.placements[k])?);
    }
    Ok(drawn)
}
