//! Dictionaries learnt and used on the engine are those of the analysis.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type};
use futures_util::StreamExt;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{PART, ShapeSource};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::learning::Schedule;
use shapelex_analysis::dictionary::method::{self, Method};
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::preparation::Posed;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::{Unwatched, Watch};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::codes::Codes;
use shapelex_engine::cohort::maintenance::{collect, forget};
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::dictionary::{self, Named};
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::source::{AtRest, Runner};
use shapelex_engine::pass::work::Work;

use crate::passes::{engine, runtime, similarity};
use crate::support::{in_memory, shapes, triangle, write};

const SHAPES: usize = 2 * PART + 77;

fn recipe(revision: &Revision, method: Method) -> Recipe {
    let class = Transformation::Named(ClassName::Similarity);
    Recipe {
        length_unit: Some("mm".into()),
        alignment: Alignment::Projection,
        ..Recipe::new(revision.manifest().cohort.representation.clone(), class, method)
    }
}

/// Codes of the whole cohort by a runner: the manifest and its digest.
pub(crate) fn code(
    runner: Option<&dyn Runner>,
    objects: &Objects,
    revision: &Arc<Revision>,
    file: &dictionary::File,
) -> Result<(Codes, String), EngineError> {
    let content = dictionary::read(&serde_json::to_vec(file).unwrap())?;
    let (named, setting) = Named::new(revision, content)?;
    runtime().block_on(named.keep(objects, "coh_triangles"))?;
    let (named, setting) = (Arc::new(named), Arc::new(setting));
    let source = AtRest::new(revision.clone(), setting.clone(), runtime().handle(), runner);
    let state = source.run(Some(named.clone()), setting, &Work::Code(named.digest.clone()))?;
    let codes = Codes::new(revision, &named.digest, &state)?;
    let digest = runtime().block_on(codes.write(objects))?;
    Ok((codes, digest))
}

/// A dictionary learnt by a runner.
pub(crate) fn learnt(
    runner: Option<&dyn Runner>,
    revision: &Arc<Revision>,
    method: Method,
) -> Result<dictionary::File, EngineError> {
    let setting: Arc<Setting> = Arc::new(similarity(revision.manifest()));
    let source = AtRest::new(revision.clone(), setting, runtime().handle(), runner);
    // Whatever is larger than nothing is coded where sums are.
    dictionary::learn(&source, &recipe(revision, method), &Unwatched, "triangles".into(), 0)
}

/// Methods of sparse dictionaries: penalised, whose codes start from those of the epoch before, in batches and online, and a pursuit.
pub(crate) fn sparse_methods() -> Vec<Method> {
    let of = |lambda, nonzeros, codes, schedule, max_epochs| Method::Sparse {
        atoms: 5,
        lambda,
        nonzeros,
        codes,
        nonnegative: false,
        normalise: true,
        seed: 1,
        max_epochs,
        tolerance: 1e-4,
        schedule,
    };
    vec![
        of(Some(0.05), None, method::Codes::Aligned, Schedule::Batch, 4),
        of(Some(0.05), None, method::Codes::Aligned, Schedule::Online, 3),
        of(Some(0.05), None, method::Codes::Invariant, Schedule::Batch, 3),
        of(None, Some(2), method::Codes::Aligned, Schedule::Batch, 2),
    ]
}

#[test]
fn sparse_dictionaries_are_those_of_the_analysis_and_leave_no_codes_behind() {
    let (store, objects) = in_memory();
    let revision = runtime().block_on(async {
        write(&objects, 1, 0..SHAPES).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    for method in sparse_methods() {
        let setting = similarity(revision.manifest());
        let alone = shapes(&setting, SHAPES);
        let expected = learn(&alone, &recipe(&revision, method.clone()), &Unwatched).unwrap().dictionary;
        let file = learnt(Some(&engine(2, 64 << 20)), &revision, method.clone()).unwrap();
        let content = dictionary::read(&serde_json::to_vec(&file).unwrap()).unwrap();
        assert_eq!(content, expected.content, "{method:?}");
        assert!(content.statistics.history.len() > 1);
        assert_eq!(learnt(None, &revision, method).unwrap().digest, file.digest);
    }
    let folder = Path::from("coh_triangles/learning");
    let left = runtime().block_on(async { store.list(Some(&folder)).collect::<Vec<_>>().await });
    assert!(left.is_empty(), "{left:?}");
}

/// Ends learning after two epochs, as a client that cancels does.
struct Ended(AtomicUsize);

impl Watch for Ended {
    fn stop(&self) -> bool {
        self.0.load(Ordering::Relaxed) >= 2
    }

    fn epoch(&self, _: usize, _: f64) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn learning_that_fails_leaves_no_codes_behind() {
    let (store, objects) = in_memory();
    let revision = runtime().block_on(async {
        write(&objects, 1, 0..500).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    let (setting, engine) = (Arc::new(similarity(revision.manifest())), engine(1, 64 << 20));
    let source = AtRest::new(revision.clone(), setting, runtime().handle(), Some(&engine));
    let recipe = recipe(&revision, sparse_methods().swap_remove(0));
    let ended = Ended(AtomicUsize::new(0));
    let error = dictionary::learn(&source, &recipe, &ended, "triangles".into(), 0).unwrap_err();
    assert!(matches!(error, EngineError::Analysis(AnalysisError::Interrupted)), "{error}");
    let folder = Path::from("coh_triangles/learning");
    let left = runtime().block_on(async { store.list(Some(&folder)).collect::<Vec<_>>().await });
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn codes_that_learning_left_behind_are_collected_or_go_with_their_revision() {
    let (store, objects) = in_memory();
    let path = Path::from("coh_triangles/learning/00000000000000000001/run/00003/0.codes");
    runtime().block_on(async {
        write(&objects, 1, 0..50).await.unwrap();
        store.put(&path, vec![1_u8; 9].into()).await.unwrap();
        let young = collect(&objects, Duration::from_secs(3600), false).await.unwrap();
        assert_eq!((young.removed, young.young), (0, 1));
        let collected = collect(&objects, Duration::ZERO, false).await.unwrap();
        assert_eq!((collected.removed, collected.removed_bytes), (1, 9));
        assert!(store.get(&path).await.is_err());
        // Those of the revision that stays are kept.
        write(&objects, 2, 0..60).await.unwrap();
        let stays = Path::from("coh_triangles/learning/00000000000000000002/run/00003/0.codes");
        for path in [&path, &stays] {
            store.put(path, vec![1_u8; 9].into()).await.unwrap();
        }
        forget(&objects, "coh_triangles", 1, true).await.unwrap();
        assert!(store.get(&path).await.is_err() && store.get(&stays).await.is_ok());
    });
}

#[test]
fn dictionaries_and_codes_are_those_of_the_analysis() {
    let (store, objects) = in_memory();
    let revision = runtime().block_on(async {
        write(&objects, 1, 0..SHAPES).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    let two = engine(2, 64 << 20);
    for method in [
        Method::components(3, true),
        Method::Sparse {
            max_epochs: 2,
            nonzeros: Some(2),
            lambda: None,
            atoms: 5,
            codes: Default::default(),
            nonnegative: false,
            normalise: true,
            seed: 1,
            tolerance: 1e-4,
            schedule: Default::default(),
        },
    ] {
        let setting = similarity(revision.manifest());
        let alone = shapes(&setting, SHAPES);
        let expected = learn(&alone, &recipe(&revision, method.clone()), &Unwatched).unwrap().dictionary;
        let file = learnt(Some(&two), &revision, method.clone()).unwrap();
        let content = dictionary::read(&serde_json::to_vec(&file).unwrap()).unwrap();
        assert_eq!(content, expected.content);
        assert_eq!(learnt(None, &revision, method).unwrap().digest, file.digest);

        let (codes, digest) = code(Some(&two), &objects, &revision, &file).unwrap();
        assert_eq!((codes.shapes(), codes.parts.len()), (SHAPES as u64, 3));
        assert_eq!(code(None, &objects, &revision, &file).unwrap(), (codes.clone(), digest));

        let last = &codes.parts[2];
        let path = Path::from(format!("coh_triangles/codes/{}/{}.parquet", file.digest, last.part));
        let bytes = runtime().block_on(async { store.get(&path).await.unwrap().bytes().await.unwrap() });
        assert_eq!(blake3::hash(&bytes).to_hex().as_str(), last.digest);
        let mut reader = ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap().build().unwrap();
        let row = reader.next().unwrap().unwrap();
        let posed = Posed { source: &alone, preparation: &expected.preparation };
        posed
            .for_each_batch(&mut |batch| {
                let codes = expected.model.codes(batch.whitened, 6)?;
                for (k, code) in codes.iter().enumerate().skip(2 * PART - batch.first) {
                    let i = batch.first + k - 2 * PART;
                    assert_eq!(row["id"].as_string::<i32>().value(i), triangle(batch.first + k).id);
                    if let Some(column) = row.column_by_name("score_3") {
                        assert_eq!(column.as_primitive::<Float64Type>().value(i), code.values[2]);
                    } else {
                        let atoms = row["atoms"].as_list::<i32>().value(i);
                        let atoms: Vec<usize> = atoms
                            .as_primitive::<UInt32Type>()
                            .values()
                            .iter()
                            .map(|atom| *atom as usize)
                            .collect();
                        assert_eq!(atoms, code.indices);
                    }
                    assert!(row["residual"].as_primitive::<Float64Type>().value(i) >= 0.0);
                }
                Ok(())
            })
            .unwrap();
    }
}

#[test]
fn dictionaries_that_do_not_suit_are_refused() {
    let (_, objects) = in_memory();
    let revision = runtime().block_on(async {
        write(&objects, 1, 0..50).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    let file = learnt(None, &revision, Method::components(2, false)).unwrap();
    let mut content = dictionary::read(&serde_json::to_vec(&file).unwrap()).unwrap();
    content.representation =
        shapelex_geometry::representation::Representation::Landmarks { dimension: 3, points: 2 };
    let error = Named::new(&revision, content).map(drop).unwrap_err().to_string();
    assert!(error.starts_with("dictionary: expected one for shapes of 'coh_triangles'"), "{error}");
    for text in ["", "{}", r#"{"content": {}}"#, "[1]"] {
        let error = dictionary::read(text.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("dictionary: expected a dictionary file, got "), "{error}");
    }
    let mut changed = serde_json::to_value(&file).unwrap();
    changed["content"]["atoms"].as_array_mut().unwrap().pop();
    let error = dictionary::read(changed.to_string().as_bytes()).unwrap_err().to_string();
    assert!(error.starts_with("dictionary: "), "{error}");
}
