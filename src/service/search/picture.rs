//! Drawing of shapes beside their nearest neighbours in a cohort.

use super::neighbours::{self, FoundNeighbour, Queries, Search};
use crate::analysis::accumulate::prepare;
use crate::analysis::alignment::{align, unwhitened};
use crate::analysis::drawing::nearest::{Row, draw_nearest};
use crate::domain::cohort::Cohort;
use crate::geometry::drawing::scene::{Drawing, short};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::{catalogue, source};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::read;
use crate::service::statistics::{Settings, Setup};
use crate::wire::shape::ShapeInput;

/// Maximum number of queries in a drawing.
const MAX_ROWS: usize = 10;
/// Maximum number of neighbours of a query in a drawing.
const MAX_NEIGHBOURS: usize = 9;

/// Query shapes that are drawn.
enum Drawn {
    Posted(Vec<ShapeInput>),
    Stored(Vec<String>),
}

impl Drawn {
    /// The first queries of a search, which is cut down to the drawn part.
    fn of(search: &mut Search) -> Self {
        search.neighbours = search.neighbours.min(MAX_NEIGHBOURS);
        match &mut search.queries {
            Queries::Posted(shapes) => {
                shapes.truncate(MAX_ROWS);
                Self::Posted(shapes.clone())
            }
            Queries::Stored(ids) => {
                ids.truncate(MAX_ROWS);
                Self::Stored(ids.clone())
            }
        }
    }
}

/// Searches, and draws each query with its nearest shapes, aligned to it.
///
/// # Errors
/// As [`neighbours::search`]; shapes that were purged meanwhile.
pub async fn draw(app: &App, key: &str, mut search: Search) -> Result<Drawing, ServiceError> {
    let cohort = catalogue::find(app, key).await?;
    let drawn = Drawn::of(&mut search);
    let settings = search.comparison.settings(&cohort);
    let found = neighbours::search(app, &cohort.id, search).await?.neighbours;
    let ids: Vec<String> = found.iter().flatten().map(|neighbour| neighbour.id.clone()).collect();
    let stored = source::find_all(app, &cohort, &ids).await?;
    let stored: Vec<Vec<f64>> = stored.into_iter().map(|shape| shape.control_points).collect();
    let queries = match drawn {
        Drawn::Posted(shapes) => Known::Posted(shapes),
        Drawn::Stored(keys) => {
            let shapes = source::find_all(app, &cohort, &keys).await?;
            Known::Stored(keys, shapes.into_iter().flat_map(|shape| shape.control_points).collect())
        }
    };
    let shapes = found.len() + stored.len();
    let counts = Counts::for_cohort(&cohort, &app.limits).with_shapes(shapes);
    let work: Work =
        requests::space(&cohort.spec.representation, &app.limits) + requests::draw(counts, shapes);
    let task_app = app.clone();
    let task = move || drawing(&task_app, &cohort, settings, queries, (&found, &stored));
    app.pool.weighing(work).run(task).await
}

/// Queries, with control points if they are stored.
enum Known {
    Posted(Vec<ShapeInput>),
    Stored(Vec<String>, Vec<f64>),
}

fn drawing(
    app: &App,
    cohort: &Cohort,
    settings: Settings,
    queries: Known,
    (found, stored): (&[Vec<FoundNeighbour>], &[Vec<f64>]),
) -> Result<Drawing, ServiceError> {
    let setup = Setup::of(app, settings)?;
    let (names, control_points) = match queries {
        Known::Stored(names, control_points) => (names, control_points),
        Known::Posted(shapes) => {
            let batch = read::read_batch(&setup.reading(&app.limits), shapes)?;
            ((1..=found.len()).map(|number| format!("query {number}")).collect(), batch.control_points)
        }
    };
    let mut stored = stored.iter();
    let queries = control_points.chunks_exact(setup.metric.len()).zip(names).zip(found);
    let aligned = |((query, name), list): ((&[f64], String), &Vec<FoundNeighbour>)| {
        let shapes: Vec<&Vec<f64>> = stored.by_ref().take(list.len()).collect();
        row(&setup, (name, query), list.iter().zip(shapes))
    };
    let rows = queries.map(aligned).collect::<Result<Vec<Row>, ServiceError>>()?;
    let title = format!("nearest shapes of {}, and their distances", cohort.spec.name);
    let drawing = draw_nearest(&setup.space, &setup.method, &title, &rows);
    Ok(setup.in_scale(drawing, cohort.spec.shown_unit()))
}

/// A query and its neighbours, aligned to it.
fn row<'a>(
    setup: &Setup,
    (name, query): (String, &[f64]),
    neighbours: impl Iterator<Item = (&'a FoundNeighbour, &'a Vec<f64>)>,
) -> Result<Row, ServiceError> {
    let Setup { metric, method, matching, .. } = setup;
    let prepared = |shape: &[f64]| {
        let mut x = shape.to_vec();
        prepare(metric, method.translates(), 0, &mut x).map(|()| x)
    };
    let reference = prepared(query)?;
    let aligned = |(neighbour, shape): (&FoundNeighbour, &Vec<f64>)| {
        let (x, centroid) = (prepared(shape)?, metric.centroid(shape));
        let aligned = align(method, matching, &reference, &x, &centroid, neighbour.placement)?;
        let name = neighbour.external_id.as_ref().unwrap_or(&neighbour.id);
        let caption = format!("{name}\n{}", short(neighbour.distance));
        Ok((caption, unwhitened(metric, &aligned.whitened)))
    };
    let neighbours = neighbours.map(aligned).collect::<Result<_, ServiceError>>()?;
    Ok(Row { query: (name, unwhitened(metric, &reference)), neighbours })
}
