//! Nuclei of a micrograph of the 2018 Data Science Bowl beside the checkout, over HTTP.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};
use shapelex_formats::image::{Limits, read_labels};

use crate::http_segment::{number, post_with_truth};
use crate::server::shared;

const NAME: &str = "11a0170f44e3.png";
/// Nuclei with fewer cells are left out.
const LEAST_CELLS: usize = 100;

/// Label and box of every nucleus that the edge does not cut.
fn nuclei(labels: &[u8]) -> BTreeMap<u32, [[usize; 2]; 2]> {
    let file = read_labels(labels, &Limits { bytes: 1 << 24, cells: 1 << 22 }).unwrap();
    let [width, height, _] = file.grid.size();
    let mut found: BTreeMap<u32, ([[usize; 2]; 2], usize)> = BTreeMap::new();
    for (at, label) in file.values.iter().enumerate().filter(|(_, label)| **label > 0) {
        let cell = [at % width, at / width];
        let ([lower, upper], count) = found.entry(*label).or_insert(([cell; 2], 0));
        *count += 1;
        for c in 0..2 {
            lower[c] = lower[c].min(cell[c]);
            upper[c] = upper[c].max(cell[c]);
        }
    }
    let is_whole = |[lower, upper]: &[[usize; 2]; 2]| {
        lower[0] > 0 && lower[1] > 0 && upper[0] + 1 < width && upper[1] + 1 < height
    };
    let kept = found.into_iter().filter(|(_, (sides, count))| is_whole(sides) && *count >= LEAST_CELLS);
    kept.map(|(label, (sides, _))| (label, sides)).collect()
}

#[test]
fn nuclei_are_found_from_their_boxes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/images-nuclei");
    let read = |kind: &str| std::fs::read(folder.join(kind).join(NAME));
    let (Ok(image), Ok(labels)) = (read("images"), read("labels")) else {
        println!("SKIPPED: images-nuclei is not beside the project");
        return;
    };
    let nuclei = nuclei(&labels);
    assert!(nuclei.len() >= 8, "{}", nuclei.len());
    let boxes: Vec<Value> =
        nuclei.values().map(|[lower, upper]| json!({"lower": lower, "upper": upper})).collect();
    let body = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 12, "generator": {"name": "trigonometric"}},
        "coordinates": "index", "boxes": boxes, "truth_labels": nuclei.keys().collect::<Vec<_>>(),
        "terms": [{"name": "contour"}, {"name": "local_contrast"}]
    });
    let found = post_with_truth(&shared(), &body, &image, &labels).expect(200);
    let overlaps = found["results"].as_array().unwrap().iter();
    let overlaps: Vec<f64> = overlaps.map(|result| number(&result["overlap"]["jaccard"])).collect();
    let mean = overlaps.iter().sum::<f64>() / overlaps.len() as f64;
    println!("{overlaps:.3?}, mean {mean:.3}");
    assert!(mean > 0.7, "{overlaps:?}");
}
