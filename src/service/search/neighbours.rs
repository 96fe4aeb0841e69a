//! Search for the nearest shapes of a stored cohort: its shapes are streamed, and only the nearest are kept. Cohorts that fit
//! in the cache are kept in prepared form for repeated searches.

use crate::wire::fault::Fault;
use std::collections::BTreeMap;

use serde_json::Value;
use std::sync::Arc;

use serde::Serialize;
use tokio::runtime::Handle;

use super::distances::Comparison;
use super::prepared::PreparedCohort;
use super::reranked::Reranking;
use crate::analysis::distance::{DistanceSpace, Match, PreparedShapes};
use crate::analysis::matching::Placement;
use crate::analysis::neighbours::{Neighbour, NeighbourSearch};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::ShapeAttributes;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::attributes::{FilterPlace, refuse_unknown};
use crate::service::cohorts::caveats;
use crate::service::cohorts::measures;
use crate::service::cohorts::source::StoredShapes;
use crate::service::cohorts::{catalogue, source};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::read;
use crate::service::statistics::Setup;
use crate::store::{Cursor, Ids, NamedShape, Places};
use crate::wire::shape::ShapeInput;

/// Maximum number of neighbours per query.
pub const MAX_NEIGHBOURS: usize = 1000;

/// Request for a search.
#[derive(Debug)]
pub struct Search {
    /// Query shapes.
    pub queries: Queries,
    /// Number of neighbours per query.
    pub neighbours: usize,
    /// Settings of the comparison.
    pub comparison: Comparison,
    /// Filter that selects the shapes to search.
    pub filter: ShapeFilter,
    /// Elastic distances: number of nearest shapes modulo the class that are compared with a query.
    pub candidates: usize,
}

/// Query shapes.
#[derive(Debug)]
pub enum Queries {
    /// Posted shapes.
    Posted(Vec<ShapeInput>),
    /// Ids or external ids of shapes of the cohort; a shape is not its own neighbour.
    Stored(Vec<String>),
}

/// Neighbours of all queries.
#[derive(Debug)]
pub struct Found {
    /// Revision of the cohort that was searched.
    pub cohort_revision: u64,
    /// Warnings about the compared shapes.
    pub warnings: Vec<String>,
    /// One list per query, by ascending distance.
    pub neighbours: Vec<Vec<FoundNeighbour>>,
}

/// A neighbour with its attributes.
#[derive(Debug)]
pub struct FoundNeighbour {
    /// Id, `shp_…`.
    pub id: String,
    /// The client's own identifier.
    pub external_id: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Further attributes.
    pub labels: BTreeMap<String, Value>,
    /// Distance to the query.
    pub distance: f64,
    /// Placement of the neighbour on the query.
    pub placement: Placement,
}

/// Places of the nearest shapes of a query, in ascending order of distance.
type Sorted = Vec<(Cursor, Match)>;

/// Nearest shapes of the cohort with this key to every query, by ascending distance; of equally distant shapes, those
/// added first.
///
/// # Errors
/// All faults of the queries; ids that do not exist; a filter that selects nothing; degenerate shapes; a search that
/// costs too much.
pub async fn search(app: &App, key: &str, search: Search) -> Result<Found, ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    check_sizes(app, &search)?;
    measures::complete_for(app, &cohort, &search.filter).await?;
    let Search { queries, neighbours, comparison, filter, candidates } = search;
    let (task_app, handle) = (app.clone(), Handle::current());
    let queries = match queries {
        Queries::Posted(shapes) => Given::Posted(shapes),
        Queries::Stored(keys) => stored_queries(app, &cohort, &keys).await?,
    };
    let (setup, space, queries) = prepared(app, &cohort, &comparison, queries).await?;
    let wanted = comparison.elastic.map_or(neighbours, |_| candidates.max(neighbours));
    let reranking = comparison.elastic.map(|elastic| {
        Reranking::new((app, &cohort), &setup, elastic, (wanted, queries.count()), queries.control_points())
    });
    let reranking = reranking.transpose()?;
    // What is kept of the cohort is the same for elastic distances.
    let comparison = Comparison { elastic: None, ..comparison };
    let mirror = comparison.mirror.unwrap_or(cohort.spec.mirror);
    let warnings = caveats::of_selection(app, &cohort, &filter, mirror).await?;
    let work = predicted(app, &cohort, &space, queries.count(), (&filter, &comparison));
    let (task_cohort, own) = (cohort.clone(), queries.ids().to_vec());
    // A stored query is its own neighbour, and removed in the end.
    let most = wanted + usize::from(!own.is_empty());
    let sorted = app
        .pool
        .weighing(work)
        .run(move || {
            let (comparison, filter) = (&comparison, &filter);
            let (app, handle, cohort) = (&task_app, &handle, &task_cohort);
            let task = Task { app, handle, cohort, filter, comparison, most };
            task.run(&setup, &space, queries)
        })
        .await?;
    let mut found = with_attributes(app, &cohort, sorted).await?;
    for (query, list) in found.iter_mut().enumerate() {
        list.retain(|neighbour| own.get(query) != Some(&neighbour.id));
        list.truncate(wanted);
    }
    let mut warnings = warnings;
    if let Some(reranking) = reranking {
        warnings.extend(reranking.warning(&found));
        found = reranking.run(app, &cohort, found).await?;
        found.iter_mut().for_each(|list| list.truncate(neighbours));
    }
    Ok(Found { cohort_revision: cohort.revision, warnings, neighbours: found })
}

/// The space of a search, and queries that have been read if they are read again for elastic distances.
async fn prepared(
    app: &App,
    cohort: &Cohort,
    comparison: &Comparison,
    queries: Given,
) -> Result<(Setup, DistanceSpace, Given), ServiceError> {
    let (settings, setup_app) = (comparison.settings(cohort), app.clone());
    let is_elastic = comparison.elastic.is_some();
    let counts = Counts::for_cohort(cohort, &app.limits).with_shapes(queries.count());
    let reading = if is_elastic { requests::project(counts) } else { Work::MOMENT };
    let work = requests::space(&cohort.spec.representation, &app.limits) + reading;
    let task = move || {
        let setup = Setup::of(&setup_app, settings)?;
        let space = DistanceSpace::new(&setup.method, &setup.matching)?;
        let queries = if is_elastic { queries.read(&setup, &setup_app)? } else { queries };
        Ok((setup, space, queries))
    };
    app.pool.weighing(work).run(task).await
}

fn check_sizes(app: &App, search: &Search) -> Result<(), ServiceError> {
    let (field, count) = match &search.queries {
        Queries::Posted(shapes) => ("/shapes", shapes.len()),
        Queries::Stored(ids) => ("/ids", ids.len()),
    };
    let mut faults = Vec::new();
    if !(1..=MAX_NEIGHBOURS).contains(&search.neighbours) {
        let detail = format!("expected a number between 1 and {MAX_NEIGHBOURS}, got {}", search.neighbours);
        faults.push(Fault::new("/neighbours", detail));
    }
    let most = app.limits.shapes;
    let per_query = search.comparison.elastic.map_or(search.neighbours, |_| search.candidates);
    if count == 0 {
        faults.push(Fault::new(field, format!("expected between 1 and {most} entries, got 0")));
    } else if faults.is_empty() && per_query > search.neighbours && count.saturating_mul(per_query) > most {
        let detail =
            format!("expected at most {most} candidates in all, got {per_query} for each of {count} shapes");
        faults.push(Fault::new("/candidates", detail));
    } else if faults.is_empty() && count.saturating_mul(search.neighbours) > most {
        let detail = format!(
            "expected at most {most} neighbours in all, got {} for each of {count} shapes",
            search.neighbours
        );
        faults.push(Fault::new("/neighbours", detail));
    }
    ServiceError::unless_empty(faults)
}

/// Queries, with control points if they are stored.
enum Given {
    Posted(Vec<ShapeInput>),
    Stored {
        ids: Vec<String>,
        control_points: Vec<f64>,
    },
    /// Posted shapes that were read.
    Read {
        count: usize,
        control_points: Vec<f64>,
    },
}

impl Given {
    fn count(&self) -> usize {
        match self {
            Self::Posted(shapes) => shapes.len(),
            Self::Stored { ids, .. } => ids.len(),
            Self::Read { count, .. } => *count,
        }
    }

    /// The same, with the control points of posted shapes.
    fn read(self, setup: &Setup, app: &App) -> Result<Self, ServiceError> {
        let Self::Posted(shapes) = self else { return Ok(self) };
        let count = shapes.len();
        let control_points = read::read_batch(&setup.reading(&app.limits), shapes)?.control_points;
        Ok(Self::Read { count, control_points })
    }

    /// Control points that are known.
    fn control_points(&self) -> &[f64] {
        match self {
            Self::Posted(_) => &[],
            Self::Stored { control_points, .. } | Self::Read { control_points, .. } => control_points,
        }
    }

    /// Ids of stored queries.
    fn ids(&self) -> &[String] {
        match self {
            Self::Posted(_) | Self::Read { .. } => &[],
            Self::Stored { ids, .. } => ids,
        }
    }
}

/// Predicted work of a search: less if the cohort is cached.
fn predicted(
    app: &App,
    cohort: &Cohort,
    space: &DistanceSpace,
    queries: usize,
    (filter, comparison): (&ShapeFilter, &Comparison),
) -> Work {
    let kept = app.cache.has::<PreparedCohort>(&cohort.id, &(cohort.revision, filter, comparison));
    let read = (!kept).then(|| Counts::for_cohort(cohort, &app.limits));
    requests::search(read, queries as f64 * cohort.shapes as f64 * space.search_operations())
}

async fn stored_queries(app: &App, cohort: &Cohort, keys: &[String]) -> Result<Given, ServiceError> {
    let shapes = source::find_all(app, cohort, keys).await?;
    let (ids, control_points): (Vec<String>, Vec<Vec<f64>>) =
        shapes.into_iter().map(|shape| (shape.id, shape.control_points)).unzip();
    Ok(Given::Stored { ids, control_points: control_points.concat() })
}

/// A search that runs on the pool.
struct Task<'a> {
    app: &'a App,
    handle: &'a Handle,
    cohort: &'a Cohort,
    filter: &'a ShapeFilter,
    comparison: &'a Comparison,
    /// Number of neighbours to find for each query.
    most: usize,
}

impl Task<'_> {
    fn run(&self, setup: &Setup, space: &DistanceSpace, queries: Given) -> Result<Vec<Sorted>, ServiceError> {
        let queries = self.prepared(setup, space, queries)?;
        let mut search = NeighbourSearch::new(space, queries, self.most);
        let context = self.app.pool.context();
        let stop = || context.is_cancelled();
        match self.app.cache.find::<PreparedCohort>(&self.cohort.id, &self.key()) {
            Some(known) => {
                self.check_cost(space, search.queries(), known.places.count())?;
                known.shapes.iter().try_for_each(|shapes| search.offer(shapes, &stop))?;
                Ok(sorted(search, &known.places))
            }
            None => {
                let places = self.read(setup, space, &mut search, &stop)?;
                Ok(sorted(search, &places))
            }
        }
    }

    /// Cache key: everything that the prepared shapes of the cohort depend on.
    fn key(&self) -> impl Serialize {
        (self.cohort.revision, self.filter, self.comparison)
    }

    /// Offers the shapes of the cohort as they are read, and caches them if they fit. Returns their places.
    fn read(
        &self,
        setup: &Setup,
        space: &DistanceSpace,
        search: &mut NeighbourSearch<'_>,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Places, ServiceError> {
        let (app, handle, cohort, filter) = (self.app, self.handle, self.cohort, self.filter);
        let shapes = StoredShapes::new(app, handle, cohort, filter, 0, setup, stop)?;
        if shapes.is_empty() && *filter != ShapeFilter::default() {
            handle.block_on(refuse_unknown(app, cohort, filter, FilterPlace::Body("/filter")))?;
            return Err(ServiceError::invalid("/filter", "the filter selects no shapes"));
        }
        self.check_cost(space, search.queries(), shapes.len())?;
        let reserved = app.cache.reserve(PreparedCohort::bytes_for(space, shapes.len()));
        let mut kept = reserved.as_ref().map(|_| PreparedCohort::for_count(space, shapes.len()));
        let mut places = Places::default();
        shapes.for_each_stored(Ids::Skip, &mut |batch| {
            let others = space.prepare(&batch.control_points)?;
            search.offer(&others, stop)?;
            places.append(&batch.places);
            if let Some(kept) = &mut kept {
                kept.append(&batch.places, others);
            }
            Ok(())
        })?;
        drop(reserved);
        if let Some(kept) = kept {
            app.cache.keep(&cohort.id, &self.key(), &Arc::new(kept));
        }
        Ok(places)
    }

    /// Prepared queries.
    fn prepared(
        &self,
        setup: &Setup,
        space: &DistanceSpace,
        queries: Given,
    ) -> Result<PreparedShapes, ServiceError> {
        let (field, control_points) = match queries {
            Given::Stored { control_points, .. } => ("ids", control_points),
            Given::Read { control_points, .. } => ("shapes", control_points),
            Given::Posted(shapes) => {
                let reading = setup.reading(&self.app.limits);
                ("shapes", read::read_batch(&reading, shapes)?.control_points)
            }
        };
        let prepared = space.prepare_given(&setup.metric, control_points);
        let at = |index: usize| format!("/{field}/{index}");
        prepared.map_err(|error| ServiceError::from_analysis(error, at))
    }

    fn check_cost(&self, space: &DistanceSpace, queries: usize, shapes: usize) -> Result<(), ServiceError> {
        let (operations, most) =
            (queries as f64 * shapes as f64 * space.operations(), self.app.limits.search_operations as f64);
        if operations <= most {
            return Ok(());
        }
        let detail = format!(
            "expected at most {most:.1e} multiply-adds, got about {operations:.1e} for {queries} and {shapes} \
             shapes: ask for fewer at a time, or set a filter"
        );
        Err(ServiceError::invalid("", detail))
    }
}

/// Places of the neighbours that were found.
fn sorted(search: NeighbourSearch<'_>, places: &Places) -> Vec<Sorted> {
    let place = |neighbour: Neighbour| Some((places.get(neighbour.position)?, neighbour.found));
    search.into_sorted().into_iter().map(|list| list.into_iter().filter_map(place).collect()).collect()
}

/// Adds ids and attributes, including those of shapes deleted since the search began; shapes purged since are left out.
async fn with_attributes(
    app: &App,
    cohort: &Cohort,
    sorted: Vec<Sorted>,
) -> Result<Vec<Vec<FoundNeighbour>>, ServiceError> {
    let places: Vec<Cursor> = sorted.iter().flatten().map(|(place, _)| *place).collect();
    let mut shapes = app.store.shapes_at(&cohort.id, &places).await?.into_iter();
    let mut found = |(_, found): (Cursor, Match)| {
        let NamedShape { id, attributes } = shapes.next().flatten()?;
        let ShapeAttributes { external_id, label, labels, .. } = attributes;
        Some(FoundNeighbour {
            id,
            external_id,
            label,
            labels,
            distance: found.distance,
            placement: found.placement,
        })
    };
    Ok(sorted.into_iter().map(|list| list.into_iter().filter_map(&mut found).collect()).collect())
}
