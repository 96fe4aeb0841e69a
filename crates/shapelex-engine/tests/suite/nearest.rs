//! Neighbours found part by part are those of all shapes at once.

use std::sync::Arc;

use shapelex_analysis::accumulate::{FAN_IN, PART, ShapeSource, prepare};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::distance::DistanceSpace;
use shapelex_analysis::neighbours::NeighbourSearch;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::pass::search::{Search, read};
use shapelex_engine::pass::source::{Runner, Subject};
use shapelex_engine::pass::work::Work;

use crate::passes::{engine, runtime};
use crate::support::{in_memory, shapes, triangle, write};

#[test]
fn neighbours_are_those_of_brute_force() {
    let count = (FAN_IN + 1) * PART + 5;
    let (_, objects) = in_memory();
    let revision = runtime().block_on(async {
        write(&objects, 1, 0..count).await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    let queries: Vec<Vec<f64>> = [3, PART + 1, count - 1].map(|k| triangle(k).control_points).to_vec();
    for (class, alignment) in
        [(ClassName::Similarity, Alignment::Projection), (ClassName::Rigid, Alignment::Procrustes)]
    {
        let class = Transformation::Named(class);
        let setting = Arc::new(Setting::new(revision.manifest(), &class, Some(alignment)).unwrap());
        let space = DistanceSpace::new(&setting.method, &setting.matching).unwrap();
        let mut points = queries.concat();
        prepare(&setting.metric, setting.method.translates(), 0, &mut points).unwrap();
        let mut search = NeighbourSearch::new(&space, space.prepare(&points).unwrap(), 7);
        let all = shapes(&setting, count);
        all.for_each_batch(&mut |batch| search.offer(&space.prepare(batch.whitened)?, &|| false)).unwrap();
        let expected = search.into_sorted();

        let work = Work::Search(Search { queries: queries.clone(), neighbours: 7 });
        let subject = Subject::new(revision.clone(), setting, None);
        let (state, _) = runtime().block_on(engine(2, 64 << 20).run(subject, &work)).unwrap();
        for (expected, found) in expected.iter().zip(read(&state).unwrap()) {
            let expected: Vec<_> = expected.iter().map(|near| (near.position, near.found.distance)).collect();
            let places: Vec<_> = found.iter().map(|near| (near.position, near.distance)).collect();
            assert_eq!(places, expected);
            assert!(found.iter().all(|near| near.id == triangle(near.position).id));
        }
    }
}
