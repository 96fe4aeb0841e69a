//! Passes on the engine have the bits of the analysis alone.

use std::num::NonZeroUsize;
use std::sync::{Arc, OnceLock};

use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{FAN_IN, PART, ShapeSource};
use shapelex_analysis::alignment::{Alignment, mean_shape};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::pass::{Aligned, Pass, Sum};
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::preparation::Posed;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::manifest::Manifest;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::{Engine, Took};
use shapelex_engine::pass::subject::{Runner, Subject};
use shapelex_engine::pass::work::Work;
use tokio::runtime::Runtime;

use crate::source::Spread;
use crate::support::{description, in_memory, shapes, triangle, write, write_with_degenerate};

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

/// Digest of the mean and three components of shapes: equal for equal bits.
fn statistics(source: &dyn ShapeSource, setting: &Setting) -> Result<String, AnalysisError> {
    let Setting { metric, method, matching, .. } = setting;
    let mean = mean_shape(source, metric, method, Frame::Training, matching)?;
    let preparation = setting.aligned_to(&mean.whitened, false);
    let posed = Posed { source, preparation: &preparation };
    let pca = FunctionalPca::new(&posed, metric, &preparation.mean, true, 3)?;
    let numbers = [&mean.whitened, &mean.eigenvalues, &pca.mean, &pca.eigenvalues];
    let numbers = numbers.into_iter().flatten().chain(pca.eigenshapes.as_slice());
    let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
    Ok(blake3::hash(&bytes).to_hex().to_string())
}

/// Three sums over shapes of so many numbers in the plane: as a mean takes them, as components do, and of shapes aligned to a circle.
fn sums(width: usize) -> [Pass; 3] {
    let angle = |i: usize| 2.0 * std::f64::consts::TAU * i as f64 / width as f64;
    let circle = (0..width / 2).map(|i| angle(i).cos()).chain((0..width / 2).map(|i| angle(i).sin()));
    let aligned = Aligned { mean: circle.collect(), normalise: false };
    let scatter = || Sum::Scatter { origin: vec![0.0; width] };
    [
        Pass { aligned: None, sum: Sum::Projectors },
        Pass { aligned: None, sum: scatter() },
        Pass { aligned: Some(aligned), sum: scatter() },
    ]
}

/// Digest of three sums by a runner, and what the passes took.
pub(crate) fn by(runner: &dyn Runner, revision: &Arc<Revision>) -> Result<(String, Vec<Took>), EngineError> {
    let setting = Arc::new(similarity(revision.manifest()));
    let (mut hasher, mut took) = (blake3::Hasher::new(), Vec::new());
    for pass in sums(revision.width()) {
        let subject = Subject::new(revision.clone(), setting.clone(), None);
        let (state, of_pass) = runtime().block_on(runner.run(subject, &Work::Sum(pass)))?;
        hasher.update(&state);
        took.push(of_pass);
    }
    Ok((hasher.finalize().to_hex().to_string(), took))
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
        let shapes = shapes(&setting, SHAPES);
        let alone = statistics(&shapes, &setting).unwrap();
        for threads in [1, 2, 3, 8] {
            let engine = engine(threads, 256 << 20);
            let source = Spread::new(&shapes, &revision, &setting, &engine);
            assert_eq!(statistics(&source, &setting).unwrap(), alone, "{class:?}, {threads} threads");
            let took = source.took().len();
            assert!(took >= passes, "{class:?}: {took} passes ran on the engine");
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
    let (ample, took) = by(&engine(2, 256 << 20), &revision).unwrap();
    assert!(took.iter().all(|took| *took == Took::default()), "{took:?}");
    let (tight, took) = by(&engine(2, 2 << 20), &revision).unwrap();
    assert_eq!(tight, ample);
    let spilled: usize = took.iter().map(|took| took.spilled_bytes).sum();
    assert!(spilled > 1 << 20, "{took:?}");
}

#[test]
fn memory_that_does_not_suffice_is_an_error_and_no_result() {
    let error = by(&engine(2, 1000), &cohort()).unwrap_err();
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
    for threads in [1, 3] {
        let error = by(&engine(threads, 64 << 20), &revision).unwrap_err().to_string();
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
        let (shapes, engine) = (shapes(&setting, count), engine(2, 64 << 20));
        let found = statistics(&Spread::new(&shapes, &revision, &setting, &engine), &setting);
        match statistics(&shapes, &setting) {
            Ok(alone) => assert_eq!(found.unwrap(), alone, "{count} shapes"),
            Err(error) => assert_eq!(found.unwrap_err().to_string(), error.to_string(), "{count} shapes"),
        }
    }
}
