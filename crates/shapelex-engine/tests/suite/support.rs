//! Cohorts of triangles.

use std::sync::Arc;
use std::time::Duration;

use object_store::ObjectStore;
use object_store::memory::InMemory;
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::Description;
use shapelex_engine::cohort::record::{Measures, Record};
use shapelex_engine::cohort::revision::Setting;
use shapelex_engine::cohort::writer::{Writer, Written};
use shapelex_engine::objects::{Objects, Patience};
use shapelex_geometry::representation::Representation;

/// Coordinates of a triangle.
pub(crate) const WIDTH: usize = 6;

/// No pause between attempts.
pub(crate) const PATIENCE: Patience =
    Patience { attempts: 3, timeout: Duration::from_millis(300), pause: Duration::from_millis(1) };

pub(crate) fn in_memory() -> (Arc<InMemory>, Objects) {
    let store = Arc::new(InMemory::new());
    (store.clone(), objects(store))
}

pub(crate) fn objects(store: Arc<dyn ObjectStore>) -> Objects {
    Objects::new(store, PATIENCE)
}

pub(crate) fn description(revision: u64, shapes: usize) -> Description {
    Description {
        id: "coh_triangles".into(),
        name: "triangles".into(),
        description: None,
        representation: Representation::Landmarks { dimension: 2, points: WIDTH / 2 },
        correspondence: Correspondence::Landmarks,
        direction: Direction::Given,
        mirror: Mirror::Forbid,
        length_unit: Some("mm".into()),
        revision,
        shape_count: shapes as u64,
        created_at: None,
        updated_at: None,
    }
}

/// The triangle `k`: of all forms, not symmetric, of a size that shows a wrong unit.
pub(crate) fn triangle(k: usize) -> Record {
    let mut state = (k as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 / (1_u64 << 53) as f64) * 0.6 - 0.3
    };
    let base = [0.0, 20.0, 5.0, 0.0, 3.0, 15.0];
    Record {
        id: format!("shp_{k:08}"),
        label: (!k.is_multiple_of(3)).then(|| ["a", "b"][k % 2].into()),
        attributes: k.is_multiple_of(5).then(|| format!(r#"{{"age":{k}}}"#)),
        weight: 1.0 + (k % 3) as f64,
        measures: Measures { points: Some(3), area: Some(k as f64 / 8.0), ..Measures::default() },
        control_points: base.iter().map(|value| value + 10.0 * noise()).collect(),
        ..Record::default()
    }
}

/// Writes these triangles as a revision.
pub(crate) async fn write(
    objects: &Objects,
    revision: u64,
    triangles: impl ExactSizeIterator<Item = usize>,
) -> Result<Written, EngineError> {
    let mut writer = Writer::begin(objects.clone(), description(revision, triangles.len()), false).await?;
    for k in triangles {
        writer.add(triangle(k)).await?;
    }
    writer.finish().await
}

/// Writes the first triangles as revision 1; the one at `bad` is a single point.
pub(crate) async fn write_with_degenerate(
    objects: &Objects,
    count: usize,
    bad: usize,
) -> Result<Written, EngineError> {
    let mut writer = Writer::begin(objects.clone(), description(1, count), false).await?;
    for k in 0..count {
        let mut shape = triangle(k);
        if k == bad {
            shape.control_points = vec![1.0; WIDTH];
        }
        writer.add(shape).await?;
    }
    writer.finish().await
}

/// The same triangles in memory, for the analysis alone.
pub(crate) fn shapes(setting: &Setting, count: usize) -> ShapesInMemory {
    prepared(setting, &(0..count).map(triangle).collect::<Vec<_>>())
}

/// Shapes in memory, prepared for a setting.
pub(crate) fn prepared(setting: &Setting, shapes: &[Record]) -> ShapesInMemory {
    let points = shapes.iter().flat_map(|shape| shape.control_points.iter().copied()).collect();
    let weights = shapes.iter().map(|shape| shape.weight).collect();
    ShapesInMemory::new(&setting.metric, setting.method.translates(), points, weights).unwrap()
}
