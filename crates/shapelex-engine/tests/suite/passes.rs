//! Passes on the engine have the bits of the analysis alone.

use std::num::NonZeroUsize;
use std::sync::{Arc, OnceLock};

use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::manifest::Manifest;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::{Engine, Took};
use shapelex_engine::pass::source::{AtRest, Runner};
use shapelex_engine::statistics::{Request, Statistics};
use tokio::runtime::Runtime;

use crate::support::{description, in_memory, shapes, triangle, write, write_with_degenerate};

pub(crate) const REQUEST: Request =
    Request { frame: Frame::Training, components: 3, centred: true, normalise: false };

/// More than one group of parts, and a part that is not whole.
const SHAPES: usize = (FAN_IN + 2) * PART + 77;

pub(crate) fn similarity(manifest: &Manifest) -> Setting {
    Setting::new(manifest, &Transformation::Named(ClassName::Similarity), None).unwrap()
}

pub(crate) fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| Runtime::new().unwrap())
}

/// The cohort of all tests, written once.
fn cohort() -> Arc<Revision> {
    static OBJECTS: OnceLock<Objects> = OnceLock::new();
    let objects = OBJECTS.get_or_init(|| {
        let (_, objects) = in_memory();
        runtime().block_on(write(&objects, 1, 0..SHAPES)).unwrap();
        objects
    });
    Arc::new(runtime().block_on(Revision::open(objects.clone(), "coh_triangles", 1)).unwrap())
}

pub(crate) fn engine(threads: usize, memory_bytes: usize) -> Engine {
    Engine { threads: NonZeroUsize::new(threads).unwrap(), memory_bytes, spill: None }
}

/// Digest by the engine, and what its passes took.
fn by(
    engine: Option<&Engine>,
    revision: &Arc<Revision>,
    setting: &Arc<Setting>,
) -> Result<(String, Vec<Took>), EngineError> {
    let source = AtRest::new(
        revision.clone(),
        setting.clone(),
        runtime().handle(),
        engine.map(|engine| engine as &dyn Runner),
    );
    let statistics = Statistics::of(&source, setting, REQUEST)?;
    Ok((statistics.digest(), source.took()))
}

#[test]
fn digests_are_those_of_the_analysis_on_any_number_of_threads() {
    let revision = cohort();
    for (class, alignment, passes) in [
        (ClassName::Similarity, Alignment::Projection, 3),
        (ClassName::Affine, Alignment::Projection, 3),
        (ClassName::NonUniformScaling, Alignment::Projection, 3),
        (ClassName::Rigid, Alignment::Procrustes, 2),
    ] {
        let transformation = Transformation::Named(class);
        let setting = Arc::new(Setting::new(revision.manifest(), &transformation, Some(alignment)).unwrap());
        let alone = Statistics::of(&shapes(&setting, SHAPES), &setting, REQUEST).unwrap().digest();
        let (direct, took) = by(None, &revision, &setting).unwrap();
        assert_eq!((direct, took), (alone.clone(), vec![]), "{class:?}, part after part");
        for threads in [1, 2, 3, 8] {
            let (digest, took) = by(Some(&engine(threads, 256 << 20)), &revision, &setting).unwrap();
            assert_eq!(digest, alone, "{class:?}, {threads} threads");
            assert!(took.len() >= passes, "{class:?}: {} passes ran on the engine", took.len());
        }
    }
}

#[test]
fn sums_that_are_spilled_come_back_with_the_same_bits() {
    // States of 80 KB: 19 parts do not fit into the memory.
    let (points, count) = (50, 18 * PART + 100);
    let (_, objects) = in_memory();
    let mut cohort = description(1, count);
    cohort.representation =
        shapelex_geometry::representation::Representation::Landmarks { dimension: 2, points };
    let revision = runtime().block_on(async {
        let mut writer = Writer::begin(objects.clone(), cohort, false).await.unwrap();
        for k in 0..count {
            let mut shape = triangle(k);
            shape.control_points = (0..2 * points)
                .map(|i| ((k * 31 + i * 17) as f64).sin() + (i as f64 * 0.7).cos() * 3.0)
                .collect();
            writer.add(shape).await.unwrap();
        }
        writer.finish().await.unwrap();
        Arc::new(Revision::open(objects, "coh_triangles", 1).await.unwrap())
    });
    let setting = Arc::new(similarity(revision.manifest()));
    let (alone, _) = by(None, &revision, &setting).unwrap();
    let (ample, took) = by(Some(&engine(2, 256 << 20)), &revision, &setting).unwrap();
    assert_eq!(ample, alone);
    assert!(took.iter().all(|took| *took == Took::default()), "{took:?}");
    let (tight, took) = by(Some(&engine(2, 2 << 20)), &revision, &setting).unwrap();
    assert_eq!(tight, alone);
    let spilled: usize = took.iter().map(|took| took.spilled_bytes).sum();
    assert!(spilled > 1 << 20, "{took:?}");
}

#[test]
fn memory_that_does_not_suffice_is_an_error_and_no_result() {
    let revision = cohort();
    let setting = Arc::new(similarity(revision.manifest()));
    let error = by(Some(&engine(2, 1000)), &revision, &setting).unwrap_err();
    assert!(matches!(error, EngineError::DataFusion(_)), "{error:?}");
    assert!(error.to_string().contains("Resources exhausted"), "{error}");
}

#[test]
fn a_degenerate_shape_is_named_by_its_position() {
    let (_, objects) = in_memory();
    let (count, bad) = (2 * PART, PART + 4321);
    let revision = runtime().block_on(async {
        write_with_degenerate(&objects, count, bad).await.unwrap();
        Arc::new(Revision::open(objects, "coh_triangles", 1).await.unwrap())
    });
    let setting = Arc::new(similarity(revision.manifest()));
    for engine in [None, Some(&engine(1, 64 << 20)), Some(&engine(3, 64 << 20))] {
        let error = by(engine, &revision, &setting).unwrap_err().to_string();
        assert!(error.starts_with(&format!("shape {bad} has no extent")), "{error}");
    }
}

#[test]
fn small_cohorts_are_one_part_or_none() {
    for count in [0, 1, 2, 500] {
        let (_, objects) = in_memory();
        let revision = runtime().block_on(async {
            write(&objects, 1, 0..count).await.unwrap();
            Arc::new(Revision::open(objects, "coh_triangles", 1).await.unwrap())
        });
        let setting = Arc::new(similarity(revision.manifest()));
        let found = by(Some(&engine(2, 64 << 20)), &revision, &setting).map(|(digest, _)| digest);
        match Statistics::of(&shapes(&setting, count), &setting, REQUEST) {
            Ok(alone) => assert_eq!(found.unwrap(), alone.digest(), "{count} shapes"),
            Err(error) => assert_eq!(found.unwrap_err().to_string(), error.to_string(), "{count} shapes"),
        }
    }
}
