//! Dictionaries learnt and used on the engine are those of the analysis.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type};
use object_store::{ObjectStoreExt, path::Path};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use shapelex_analysis::accumulate::{PART, ShapeSource};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::preparation::Posed;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::codes::Codes;
use shapelex_engine::dictionary::{self, Named};
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::revision::{Revision, Setting};
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
    dictionary::learn(&source, &recipe(revision, method), &Unwatched, "triangles".into())
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
