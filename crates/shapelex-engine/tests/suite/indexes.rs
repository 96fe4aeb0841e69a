//! Indexes: what an approximate search finds is measured as an exact search measures it, and what it misses is told.

use std::num::NonZeroUsize;
use std::sync::Arc;

use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::dictionary::method::Method;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::index::Index;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::dictionary::{self, Named};
use shapelex_engine::nearest::Indexed;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::search::{Near, Search, read};
use shapelex_engine::pass::source::{AtRest, Runner, Subject};
use shapelex_engine::pass::work::Work;

use crate::dictionaries::{code, learnt};
use crate::passes::{engine, runtime};
use crate::support::{in_memory, triangle, write};

/// A cohort with codes in a dictionary of components.
pub(crate) struct Coded {
    pub(crate) revision: Arc<Revision>,
    named: Arc<Named>,
    setting: Arc<Setting>,
}

impl Coded {
    pub(crate) fn new(objects: &Objects, method: Method) -> Self {
        let revision = runtime().block_on(Revision::open(objects.clone(), "coh_triangles", 1)).unwrap();
        let (revision, two) = (Arc::new(revision), engine(2, 256 << 20));
        let file = learnt(Some(&two), &revision, method).unwrap();
        code(Some(&two), objects, &revision, &file).unwrap();
        let content = dictionary::read(&serde_json::to_vec(&file).unwrap()).unwrap();
        let (named, setting) = Named::new(&revision, content).unwrap();
        Self { revision, named: Arc::new(named), setting: Arc::new(setting) }
    }

    /// The index by a runner.
    pub(crate) fn index(&self, runner: Option<&dyn Runner>) -> Result<Index, EngineError> {
        let Self { revision, named, setting } = self;
        let source = AtRest::new(revision.clone(), setting.clone(), runtime().handle(), runner);
        let work = Work::Index(named.digest.clone());
        let state = source.run(Some(named.clone()), setting.clone(), &work)?;
        Index::new(revision, &named.digest, &state)
    }

    fn indexed<'a>(&'a self, index: &'a Index) -> Indexed<'a> {
        let Self { revision, named, setting } = self;
        Indexed { revision, setting, named, index, threads: NonZeroUsize::MIN }
    }

    fn exact(&self, search: &Search) -> Vec<Vec<Near>> {
        let subject = Subject::new(self.revision.clone(), self.setting.clone(), None);
        let work = Work::Search(search.clone());
        let (state, _) = runtime().block_on(engine(2, 64 << 20).run(subject, &work)).unwrap();
        read(&state).unwrap()
    }
}

fn triangles(count: usize) -> (Arc<dyn ObjectStore>, Objects) {
    let (store, objects) = in_memory();
    runtime().block_on(write(&objects, 1, 0..count)).unwrap();
    (store, objects)
}

#[test]
fn neighbours_in_several_groups_are_found_with_their_distances() {
    let count = FAN_IN * PART + 300;
    let (_, objects) = triangles(count);
    let coded = Coded::new(&objects, Method::components(2, true));
    let index = coded.index(Some(&engine(2, 256 << 20))).unwrap();
    let indexed = coded.indexed(&index);
    let queries = [7, PART + 1, count - 2].map(|k| triangle(k).control_points).to_vec();
    let search = Search { queries, neighbours: 8 };
    let found = runtime().block_on(indexed.search(&search, 100)).unwrap();
    let mut hits = 0;
    for (exact, found) in coded.exact(&search).iter().zip(&found) {
        assert_eq!(found.len(), 8);
        assert!(found.is_sorted_by(|a, b| a.distance <= b.distance));
        assert_eq!(found[0], exact[0], "the query itself");
        assert!(found.iter().all(|near| near.id == triangle(near.position).id));
        // Of those that both have, the distances have the same bits.
        for near in found {
            if let Some(exact) = exact.iter().find(|exact| exact.position == near.position) {
                assert_eq!(exact, near);
                hits += 1;
            }
        }
    }
    // Triangles have two dimensions, which two components describe.
    assert!(hits >= 22, "{hits} of 24");
    let recall = runtime().block_on(indexed.recall(&engine(2, 64 << 20), 16, 10, 100)).unwrap();
    assert_eq!((recall.queries, recall.neighbours, recall.candidates), (16, 10, 100));
    assert!(recall.mean > 0.9 && recall.mean <= 1.0 && recall.lowest <= recall.mean, "{recall:?}");
    // Fewer candidates than neighbours are as many.
    let few = runtime().block_on(indexed.recall(&engine(2, 64 << 20), 16, 10, 1)).unwrap();
    assert!(few.mean < recall.mean, "{few:?}");
}

#[test]
fn an_index_has_the_same_bytes_on_any_number_of_threads_and_is_read_back() {
    let (_, objects) = triangles(2 * PART + 77);
    let coded = Coded::new(&objects, Method::components(3, true));
    let mut index = coded.index(None).unwrap();
    assert_eq!(index, coded.index(Some(&engine(2, 64 << 20))).unwrap());
    index.recall =
        Some(runtime().block_on(coded.indexed(&index).recall(&engine(1, 64 << 20), 4, 3, 50)).unwrap());
    runtime().block_on(index.write(&objects)).unwrap();
    assert_eq!(runtime().block_on(Index::read(&coded.revision, &index.dictionary)).unwrap(), index);
}

#[test]
fn every_shape_as_a_candidate_is_an_exact_search() {
    let (_, objects) = triangles(300);
    let coded = Coded::new(&objects, Method::components(3, true));
    let index = coded.index(None).unwrap();
    let search =
        Search { queries: vec![triangle(1000).control_points, triangle(4).control_points], neighbours: 20 };
    let found = runtime().block_on(coded.indexed(&index).search(&search, 300)).unwrap();
    assert_eq!(found, coded.exact(&search));
}

#[test]
fn what_is_no_index_is_refused_by_name() {
    let (store, objects) = triangles(500);
    let coded = Coded::new(&objects, Method::components(2, true));
    let read =
        |digest: &str| runtime().block_on(Index::read(&coded.revision, digest)).unwrap_err().to_string();
    assert!(
        read(&coded.named.digest)
            .contains("expected an index of this revision over this dictionary, got none")
    );

    let index = coded.index(None).unwrap();
    runtime().block_on(index.write(&objects)).unwrap();
    let path =
        Path::from(format!("coh_triangles/indexes/{}/{}.hnsw", index.dictionary, index.groups[0].digest));
    let bytes = runtime().block_on(async { store.get(&path).await.unwrap().bytes().await.unwrap() });
    let search = Search { queries: vec![triangle(1).control_points], neighbours: 2 };
    let fault = || runtime().block_on(coded.indexed(&index).search(&search, 9)).unwrap_err().to_string();
    runtime().block_on(store.put(&path, bytes.slice(..bytes.len() - 1).into())).unwrap();
    assert!(fault().contains(&format!("expected {} bytes", bytes.len())), "{}", fault());
    let mut changed = bytes.to_vec();
    changed[bytes.len() / 2] ^= 1;
    runtime().block_on(store.put(&path, changed.into())).unwrap();
    assert!(fault().contains("is damaged: expected digest"), "{}", fault());

    let point = Search { queries: vec![vec![1.0; 6]], neighbours: 2 };
    runtime().block_on(store.put(&path, bytes.into())).unwrap();
    let fault = runtime().block_on(coded.indexed(&index).search(&point, 9)).unwrap_err().to_string();
    assert!(fault.starts_with("queries: "), "{fault}");
    let none = runtime().block_on(coded.indexed(&index).recall(&engine(1, 64 << 20), 0, 3, 9));
    assert!(none.unwrap_err().to_string().starts_with("recall: expected"));
}

#[test]
fn sparse_codes_and_codes_that_are_missing_have_no_index() {
    let (store, objects) = triangles(200);
    let sparse = Method::Sparse {
        max_epochs: 1,
        nonzeros: Some(1),
        lambda: None,
        atoms: 4,
        codes: Default::default(),
        nonnegative: false,
        normalise: true,
        seed: 1,
        tolerance: 1e-2,
        schedule: Default::default(),
    };
    let fault = Coded::new(&objects, sparse).index(None).unwrap_err().to_string();
    assert!(fault.contains("expected a dictionary of components, got one of atoms"), "{fault}");

    let coded = Coded::new(&objects, Method::components(2, true));
    let path = format!("coh_triangles/codes/{}/{:020}.json", coded.named.digest, 1);
    runtime().block_on(store.delete(&Path::from(path))).unwrap();
    let fault = coded.index(Some(&engine(1, 64 << 20))).unwrap_err().to_string();
    assert!(fault.contains("codes: expected those of this revision in the dictionary, got none"), "{fault}");
}
