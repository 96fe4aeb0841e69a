//! Sample of a test: attributes of the selected shapes of a stored cohort, and their control points aligned to one
//! mean.

use crate::formats::fault::Fault;
use std::collections::{BTreeMap, BTreeSet, HashMap};

use rayon::prelude::*;
use tokio::runtime::Handle;

use crate::analysis::accumulate::{ShapesInMemory, map_shapes};
use crate::analysis::alignment::{Alignment, MeanShape, align, mean_shape, unwhitened};
use crate::analysis::correspondence::Mirror;
use crate::analysis::frame::Frame;
use crate::analysis::size::{LARGEST_SIZE, SizeTable};
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::shape::{ShapeDescription, ShapeFilter};
use crate::geometry::sampling::Places;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{Attribute, first_names, name_of};
use crate::service::statistics::{Settings, Setup};
use crate::store::{Ids, Revisions};

/// Maximum number of permutations of a test.
pub const MAX_PERMUTATIONS: usize = 100_000;

/// Default number of permutations.
pub const DEFAULT_PERMUTATIONS: usize = 1000;

/// Maximum ratio of the weights of one test: beyond it a single shape dominates, and precision is lost.
const WEIGHT_RATIO: f64 = 1e9;

/// The stratum of every shape: shapes with equal values of all attributes share one.
///
/// # Errors
/// Shapes without one of the attributes, at `/strata`.
pub(crate) fn strata(names: &[String], shapes: &[ShapeDescription]) -> Result<Vec<usize>, ServiceError> {
    let mut faults = Vec::new();
    let mut keys = vec![Vec::new(); shapes.len()];
    for name in names {
        let Some(attribute) = Attribute::parse(name) else {
            faults.push(Fault::new("/strata", format!("{}, got '{name}'", Attribute::WANTED)));
            continue;
        };
        let without: Vec<_> = shapes.iter().filter(|shape| attribute.text(shape).is_none()).collect();
        if !without.is_empty() {
            let (count, first) = (without.len(), first_names(without.into_iter()));
            let detail = format!("{count} of {} shapes have no {name}: {first}", shapes.len());
            faults.push(Fault::new("/strata", detail));
        }
        for (key, shape) in keys.iter_mut().zip(shapes) {
            key.push(attribute.text(shape));
        }
    }
    ServiceError::unless_empty(faults)?;
    let mut numbers = BTreeMap::new();
    Ok(keys
        .into_iter()
        .map(|key| {
            let next = numbers.len();
            *numbers.entry(key).or_insert(next)
        })
        .collect())
}

/// Settings for aligning the shapes of `cohort` in a test. Where the class allows it, the mean depends on the subspaces
/// alone, so that no statistic changes when shapes are moved by members of the class.
pub(crate) fn settings(
    cohort: &Cohort,
    transformation: &Transformation,
    alignment: Alignment,
    mirror: Mirror,
) -> Settings {
    Settings {
        representation: cohort.representation.clone(),
        correspondence: cohort.correspondence,
        direction: cohort.direction,
        mirror,
        transformation: transformation.clone(),
        alignment,
        frame: match transformation {
            Transformation::Named(_) => Frame::Canonical,
            Transformation::Custom(_) => Frame::Training,
        },
    }
}

/// The cohort at the revision of a requested test.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub(crate) fn cohort_at(app: &App, handle: &Handle, id: &str, revision: u64) -> Result<Cohort, ServiceError> {
    let cohort = handle.block_on(app.store.find_cohort(id))?;
    let cohort = cohort.ok_or_else(|| ServiceError::NotFound { kind: "cohort", key: id.into() })?;
    Ok(Cohort { revision, ..cohort })
}

/// Shapes aligned to their mean.
pub(crate) struct Aligned {
    /// The mean; its placements are those of the shapes.
    pub(crate) mean: MeanShape,
    /// Prepared shapes placed on the mean, one per column, whitened.
    pub(crate) placed: Matrix,
    /// Aligned shapes, one per column, whitened.
    pub(crate) aligned: Matrix,
    /// Positive weights.
    pub(crate) weights: Vec<f64>,
    /// Sizes as posted.
    pub(crate) sizes: SizeTable,
    /// Sizes that were left out.
    pub(crate) warnings: Vec<String>,
}

/// Reads `shapes` through `filters`, which together select all of them, and aligns them.
///
/// # Errors
/// Degenerate shapes by their ids; [`ServiceError::Cancelled`].
pub(crate) fn read_and_align(
    app: &App,
    handle: &Handle,
    (cohort, filters): (&Cohort, &[ShapeFilter]),
    shapes: &[ShapeDescription],
    setup: &Setup,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Aligned, ServiceError> {
    let (control_points, weights) = read(app, handle, (cohort, filters), shapes, setup.metric.len(), stop)?;
    check_weights(&weights)?;
    let sizes = SizeTable::of(&setup.space, &setup.metric, &control_points, stop)?;
    let cut = sizes.is_cut.then(|| format!("sizes beyond {LARGEST_SIZE:.0e} are not compared"));
    let named = |error| named(error, shapes, &cohort.name);
    let Setup { metric, method, frame, matching, .. } = setup;
    let source = ShapesInMemory::new(metric, method.translates(), control_points, weights.clone())
        .map_err(|error| named(error.into()))?;
    if stop() {
        return Err(ServiceError::Cancelled);
    }
    let mean = mean_shape(&source, metric, method, *frame, matching).map_err(|error| named(error.into()))?;
    let origin = vec![0.0; metric.dimension()];
    let columns = map_shapes(&source, |k, x, _| {
        let placement = mean.placements[k];
        let aligned = align(method, matching, &mean.whitened, x, &origin, placement).map_err(|e| e.at(k))?;
        Ok((matching.place(x, placement).into_owned(), aligned.whitened))
    })
    .map_err(|error| named(error.into()))?;
    let mut placed = Matrix::zeros(metric.len(), columns.len());
    let mut aligned = placed.clone();
    for (k, (laid, moved)) in columns.into_iter().enumerate() {
        placed.column_mut(k).copy_from_slice(&laid);
        aligned.column_mut(k).copy_from_slice(&moved);
    }
    Ok(Aligned { mean, placed, aligned, weights, sizes, warnings: cut.into_iter().collect() })
}

/// Control points and weights of the shapes, in order.
fn read(
    app: &App,
    handle: &Handle,
    (cohort, filters): (&Cohort, &[ShapeFilter]),
    shapes: &[ShapeDescription],
    length: usize,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Vec<f64>, Vec<f64>), ServiceError> {
    let places: HashMap<&str, usize> = shapes.iter().enumerate().map(|(k, s)| (s.id.as_str(), k)).collect();
    let mut control_points = vec![0.0; shapes.len() * length];
    let (mut weights, mut left) = (vec![0.0; shapes.len()], shapes.len());
    for filter in filters {
        let mut position = None;
        loop {
            if stop() {
                return Err(ServiceError::Cancelled);
            }
            let revisions = Revisions::until(cohort.revision);
            let scan = app.store.scan(&cohort.id, revisions, filter, position, Ids::Include);
            let Some(batch) = handle.block_on(scan)? else { break };
            position = Some(batch.position);
            let rows = batch.control_points.chunks_exact(length).zip(&batch.weights);
            for (id, (row, &weight)) in batch.ids.iter().zip(rows) {
                if let Some(&k) = places.get(id.as_str()) {
                    control_points[k * length..(k + 1) * length].copy_from_slice(row);
                    left -= usize::from(weights[k] == 0.0);
                    weights[k] = weight;
                }
            }
        }
    }
    if left > 0 {
        return Err(ServiceError::Internal(format!("{left} shapes of a test are not in the store")));
    }
    Ok((control_points, weights))
}

fn check_weights(weights: &[f64]) -> Result<(), ServiceError> {
    let smallest = weights.iter().copied().fold(f64::MAX, f64::min);
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest <= WEIGHT_RATIO * smallest {
        return Ok(());
    }
    let detail = format!(
        "expected weights that differ by a factor of at most {WEIGHT_RATIO:.0e}, got {smallest:.1e} to \
         {largest:.1e}"
    );
    Err(ServiceError::invalid("/cohort", detail))
}

/// Replaces positions in errors of statistics by shape ids, which clients know.
fn named(error: ServiceError, shapes: &[ShapeDescription], cohort: &str) -> ServiceError {
    let ServiceError::DegenerateShape(faults) = error else { return error };
    let named = |fault: Fault| {
        let name = fault.index.and_then(|k| shapes.get(k)).map_or("", name_of);
        let detail = format!("{} (shape '{name}' of the cohort '{cohort}')", fault.detail);
        Fault { pointer: String::new(), detail, ..fault }
    };
    ServiceError::DegenerateShape(faults.into_iter().map(named).collect())
}

/// Whitened shapes at places along them, coordinate-major, one a column.
pub(crate) fn points_of(setup: &Setup, whitened: &Matrix, places: &Places) -> Matrix {
    let (size, dimension) = (setup.metric.size(), setup.metric.dimension());
    let columns: Vec<&[f64]> = whitened.as_slice().chunks_exact(setup.metric.len()).collect();
    let points: Vec<Vec<f64>> = columns
        .par_iter()
        .map(|shape| {
            let control_points = unwhitened(&setup.metric, shape);
            let matrix = Matrix::from_column_slice(size, dimension, &control_points);
            places.points(&setup.space, &matrix)
        })
        .collect();
    let rows = places.count() * dimension;
    Matrix::from_iterator(rows, points.len(), points.into_iter().flatten())
}

/// Weighted mean of columns, computed relative to the first one to avoid cancellation.
pub(crate) fn average(columns: &Matrix, weights: &[f64], members: &[usize]) -> Vec<f64> {
    let first = columns.column(members[0]);
    let total: f64 = members.iter().map(|&k| weights[k]).sum();
    let mut sum = vec![0.0; columns.nrows()];
    for &k in members {
        let column = columns.column(k);
        let differences = column.iter().zip(first.iter()).map(|(value, first)| value - first);
        sum.iter_mut().zip(differences).for_each(|(sum, difference)| *sum += weights[k] * difference);
    }
    sum.iter().zip(first.iter()).map(|(sum, first)| first + sum / total).collect()
}

/// Weighted mean and standard deviation of numbers.
pub(crate) fn mean_and_deviation(values: &[f64], weights: &[f64]) -> (f64, f64) {
    let total: f64 = weights.iter().sum();
    let first = values[0];
    let mean = first + values.iter().zip(weights).map(|(x, w)| w * (x - first)).sum::<f64>() / total;
    let squares = values.iter().zip(weights).map(|(x, w)| w * (x - mean).powi(2)).sum::<f64>();
    let n = values.len() as f64;
    (mean, (squares / total * n / (n - 1.0)).sqrt())
}

/// Warnings about the mean of all shapes.
pub(crate) fn mean_warnings(mean: &MeanShape) -> Vec<String> {
    let mut warnings = Vec::new();
    if mean.unique == Some(false) {
        warnings.push(
            "the pooled mean is not unique: the eigenvalue gap is below 1e-6 of the total weight".into(),
        );
    }
    if !mean.converged {
        warnings.push(format!("the pooled mean has not converged after {} rounds", mean.rounds));
    }
    warnings
}

/// Warning about shapes of one subject that are treated as independent; none if `strata` contains the subject.
pub(crate) fn subject_warning(shapes: &[ShapeDescription], strata: &[String]) -> Option<String> {
    if strata.iter().any(|name| name == "subject") {
        return None;
    }
    let subjects: Vec<&str> = shapes.iter().filter_map(|shape| shape.subject.as_deref()).collect();
    let distinct = subjects.iter().collect::<BTreeSet<_>>().len();
    (distinct < subjects.len()).then(|| {
        format!(
            "{} shapes are of {distinct} subjects: shapes of one subject are not independent, and p values that treat them \
             so are too small",
            subjects.len()
        )
    })
}
