//! Dictionaries learnt and used on the engine are those of the analysis.

use std::collections::BTreeSet;
use std::path::Path as Folder;
use std::sync::Arc;
use std::time::Duration;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type};
use futures_util::TryStreamExt;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::{Value, json};
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{PART, ShapeSource};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::content::Content;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::learn::{Learner, learn};
use shapelex_analysis::dictionary::learning::Schedule;
use shapelex_analysis::dictionary::method::{self, Method};
use shapelex_analysis::dictionary::model::Coded;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::preparation::Posed;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::maintenance::{collect, forget};
use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::dictionary::Named;
use shapelex_engine::location::open;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::subject::{Runner, Subject};
use shapelex_engine::pass::work::{CodedPart, Work, read_files};

use crate::passes::{engine, runtime, similarity};
use crate::program::pass;
use crate::source::Spread;
use crate::support::{in_memory, objects, shapes, triangle, write};

const SHAPES: usize = 2 * PART + 77;

fn recipe(revision: &Revision, method: Method) -> Recipe {
    let class = Transformation::Named(ClassName::Similarity);
    Recipe {
        length_unit: Some("mm".into()),
        alignment: Alignment::Projection,
        ..Recipe::new(revision.manifest().cohort.representation.clone(), class, method)
    }
}

/// The result of a pass that uses a dictionary, which is kept beside the revision.
fn with_dictionary(
    runner: &dyn Runner,
    objects: &Objects,
    revision: &Arc<Revision>,
    content: &Content,
    work: fn(String) -> Work,
) -> Result<Vec<u8>, EngineError> {
    let (named, setting) = Named::new(revision, content.clone())?;
    runtime().block_on(named.keep(objects, "coh_triangles"))?;
    let work = work(named.digest.clone());
    let subject = Subject::new(revision.clone(), Arc::new(setting), Some(Arc::new(named)));
    Ok(runtime().block_on(runner.run(subject, &work))?.0)
}

/// Codes of the whole cohort by a runner, as files.
pub(crate) fn code(
    runner: &dyn Runner,
    objects: &Objects,
    revision: &Arc<Revision>,
    content: &Content,
) -> Result<Vec<CodedPart>, EngineError> {
    read_files(&with_dictionary(runner, objects, revision, content, Work::Code)?)
}

/// A dictionary learnt by a runner: its sums, its certificate, and the codes of its epochs.
pub(crate) fn learnt(
    runner: &dyn Runner,
    objects: &Objects,
    revision: &Arc<Revision>,
    method: Method,
) -> Result<Content, AnalysisError> {
    let (setting, recipe) = (Arc::new(similarity(revision.manifest())), recipe(revision, method));
    let shapes = shapes(&setting, revision.shapes());
    let source = Spread::new(&shapes, revision, &setting, runner).coding(objects, &recipe.method);
    let help = |dictionary: &Dictionary| {
        let certified = with_dictionary(runner, objects, revision, &dictionary.content, Work::Certify)?;
        let mut coded = Coded::default();
        coded.append(&certified)?;
        Ok(Some(coded))
    };
    let learner = Learner { recipe: &recipe, measured: setting.measured(), watch: &Unwatched, help: &help };
    Ok(learner.learn(&source)?.dictionary.content)
}

/// Writes triangles into a store.
fn triangles(objects: &Objects, count: usize) -> Arc<Revision> {
    runtime().block_on(async {
        write(objects, 1, 0..count).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    })
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
fn sparse_dictionaries_are_those_of_the_analysis_and_two_epochs_of_codes_are_kept() {
    let (store, objects) = in_memory();
    let revision = triangles(&objects, SHAPES);
    for method in sparse_methods() {
        let setting = similarity(revision.manifest());
        let alone = shapes(&setting, SHAPES);
        let expected = learn(&alone, &recipe(&revision, method.clone()), &Unwatched).unwrap().dictionary;
        let content = learnt(&engine(2, 64 << 20), &objects, &revision, method.clone()).unwrap();
        assert_eq!(content, expected.content, "{method:?}");
        assert!(content.statistics.history.len() > 1);
    }
    let listed = |folder: &str| {
        let folder = Path::from(folder);
        runtime().block_on(async { store.list(Some(&folder)).try_collect::<Vec<_>>().await.unwrap() })
    };
    let codes = listed("coh_triangles/learning");
    let folder = |location: &Path, levels: usize| {
        location.parts().take(levels).map(|part| part.as_ref().to_string()).collect::<Vec<_>>()
    };
    let folders = |levels: usize| -> BTreeSet<Vec<String>> {
        codes.iter().map(|object| folder(&object.location, levels)).collect()
    };
    let (runs, epochs) = (folders(4), folders(5));
    for run in &runs {
        let kept = epochs.iter().filter(|epoch| epoch.starts_with(run)).count();
        assert!((1..=2).contains(&kept), "{kept} epochs of {run:?}");
    }
    runtime().block_on(forget(&objects, "coh_triangles", 1, true)).unwrap();
    assert_eq!(listed("coh_triangles"), []);
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
    let (revision, two) = (triangles(&objects, SHAPES), engine(2, 64 << 20));
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
        let content = learnt(&two, &objects, &revision, method).unwrap();
        assert_eq!(content, expected.content);

        let codes = code(&two, &objects, &revision, &content).unwrap();
        assert_eq!(codes.iter().map(|part| part.shapes).collect::<Vec<_>>(), [PART as u64, PART as u64, 77]);
        assert_eq!(code(&engine(1, 64 << 20), &objects, &revision, &content).unwrap(), codes);

        let last = &codes[2];
        let digest = Named::new(&revision, content).unwrap().0.digest;
        let path = Path::from(format!("coh_triangles/codes/{digest}/{}.parquet", last.part));
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

/// A request for the codes of the triangles, by the program.
fn coded_by_the_program(folder: &Folder, content: &Value) -> Result<Vec<u8>, String> {
    let request = json!({"cohort": "coh_triangles", "revision": 1, "transformation": "similarity",
        "alignment": "projection", "work": {"code": content}});
    pass(folder, &["--threads", "2"], &request)
}

#[test]
fn the_program_names_the_files_of_codes() {
    let folder = tempfile::tempdir().unwrap();
    let objects = objects(open(folder.path().to_str().unwrap()).unwrap());
    let (revision, one) = (triangles(&objects, PART + 9), engine(1, 64 << 20));
    let content = learnt(&one, &objects, &revision, Method::components(2, true)).unwrap();
    let answer = coded_by_the_program(folder.path(), &serde_json::to_value(&content).unwrap()).unwrap();
    let answer: Value = serde_json::from_slice(&answer).unwrap();
    let files = code(&one, &objects, &revision, &content).unwrap();
    assert_eq!(answer["files"], serde_json::to_value(&files).unwrap());
    assert_eq!(answer["dictionary"], Named::new(&revision, content.clone()).unwrap().0.digest);
    let digest = blake3::hash(&serde_json::to_vec(&files).unwrap());
    assert_eq!(answer["digest"], digest.to_hex().as_str());

    let mut changed = serde_json::to_value(&content).unwrap();
    changed["atoms"].as_array_mut().unwrap().pop();
    let error = coded_by_the_program(folder.path(), &changed).unwrap_err();
    assert!(error.starts_with("shapelex-engine: dictionary: "), "{error}");
}

#[test]
fn dictionaries_of_other_shapes_are_refused() {
    let (_, objects) = in_memory();
    let revision = triangles(&objects, 50);
    let mut content =
        learnt(&engine(1, 64 << 20), &objects, &revision, Method::components(2, false)).unwrap();
    content.representation =
        shapelex_geometry::representation::Representation::Landmarks { dimension: 3, points: 2 };
    let error = Named::new(&revision, content).map(drop).unwrap_err().to_string();
    assert!(error.starts_with("dictionary: expected one for shapes of 'coh_triangles'"), "{error}");
}
