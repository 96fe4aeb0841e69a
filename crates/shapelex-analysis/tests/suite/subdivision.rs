//! Inner products and motions of subdivision surfaces against stored vectors.

use std::path::Path;

use serde_json::Value;
use shapelex_analysis::fit::{Fit, Scaling};
use shapelex_analysis::metric::Metric;
use shapelex_geometry::generator::Exact;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::subdivision::control::ControlMesh;
use shapelex_geometry::subdivision::{Frequency, LoopWeights, Scheme, Subdivision};
use shapelex_numeric::dense::Matrix;

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|entry| entry.as_f64().unwrap()).collect()
}

fn matrix(value: &Value) -> Matrix {
    let rows: Vec<Vec<f64>> = value.as_array().unwrap().iter().map(numbers).collect();
    Matrix::from_fn(rows.len(), rows[0].len(), |i, c| rows[i][c])
}

fn scheme(case: &Value) -> Scheme {
    let [re, im] = ["re", "im"].map(|part| case["lambda"][part].as_f64().unwrap());
    match case["scheme"].as_str().unwrap() {
        "loop" => Scheme::Loop(LoopWeights::Original),
        _ if im == 0.0 => Scheme::Blob(Frequency::Real(Exact::new(re))),
        _ => Scheme::Blob(Frequency::Imaginary(Exact::new(im))),
    }
}

#[test]
fn inner_products_distances_and_motions_equal_the_vectors() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/subdivision/gram.json");
    let document: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for case in document["cases"].as_array().unwrap() {
        let faces: Vec<[u32; 3]> = serde_json::from_value(case["faces"].clone()).unwrap();
        let level = case["levels"].as_u64().unwrap() as usize;
        let connectivity = ControlMesh::Faces(faces);
        let subdivision = Subdivision { scheme: scheme(case), level, connectivity };
        let metric = Metric::of(&ShapeSpace::new(&Representation::Subdivision(subdivision)).unwrap());
        let [c, d] = ["C", "D"].map(|name| matrix(&case[name]));
        let close = |found: f64, wanted: &Value| {
            let wanted = wanted.as_f64().unwrap();
            assert!((found - wanted).abs() < 1e-11 * wanted.abs().max(1.0), "{found} {wanted}");
        };
        close(metric.inner(c.as_slice(), d.as_slice()), &case["inner_product_C_D"]);
        let difference = &c - &d;
        close(metric.inner(difference.as_slice(), difference.as_slice()).sqrt(), &case["distance_C_D"]);
        // The best motion of D onto C, by the alignment that all representations share.
        let [mut x, mut y] = [d.as_slice().to_vec(), c.as_slice().to_vec()];
        for shape in [&mut x, &mut y] {
            metric.centre(shape);
            metric.whiten(shape);
        }
        let rotation = Fit { dimension: 3, rotates: true, scaling: Scaling::None }.matrix(&x, &y);
        assert!((rotation - matrix(&case["rigid"]["R"])).amax() < 1e-10, "{}", case["name"]);
    }
}
