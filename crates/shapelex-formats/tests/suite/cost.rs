//! Reading takes time in proportion to the bytes of a file, however they are arranged: a file that could make a reader repeat itself is
//! compared with an ordinary one of about the same bytes, in the same run.

use std::time::Instant;

use shapelex_formats::shape::{Limits, ReadOptions, Source, find, read};

/// Most times as long as the ordinary file that the other may take. What is repeated takes hundreds of times as long; a busy machine or
/// other work on the same bytes several times.
const MOST: f64 = 20.0;

/// Seconds of `work`: the least of three runs, since a busy machine may hold up one of a few milliseconds for long.
fn seconds(work: impl Fn()) -> f64 {
    let run = || {
        let begin = Instant::now();
        work();
        begin.elapsed().as_secs_f64()
    };
    run().min(run()).min(run())
}

#[track_caller]
pub(crate) fn compare(arranged: impl Fn(), ordinary: impl Fn()) {
    let (arranged, ordinary) = (seconds(arranged), seconds(ordinary));
    assert!(arranged < MOST * ordinary, "{arranged} s, and {ordinary} s for an ordinary file");
}

/// Reads all shapes of a file.
fn read_all(format: &str, file: &[u8]) {
    let mut source = Source::new(file, Limits::default()).unwrap();
    let outcome = read(find(format).unwrap(), &mut source, &ReadOptions::default(), &mut |_| Ok(()));
    assert!(outcome.unwrap().records > 0);
}

#[cfg(feature = "microscopy")]
#[test]
fn an_image_of_coco_is_read_once_for_all_its_annotations() {
    let blanks = " ".repeat(4 << 20);
    let list = vec![r#"{"image_id":1,"segmentation":[[0,0,1,0,0,1]]}"#; 2000].join(",");
    let file = |within: &str, behind: &str| {
        format!(r#"{{"images":[{{"id":1{within}}}]{behind},"annotations":[{list}]}}"#).into_bytes()
    };
    let (within, behind) = (file(&blanks, ""), file("", &blanks));
    compare(|| read_all("coco", &within), || read_all("coco", &behind));
}
