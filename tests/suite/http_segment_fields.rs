//! Terms of a segmentation that integrate what is detected in a volume.

use serde_json::{Value, json};
use shapelex_formats::image::LengthUnit;
use shapelex_formats::image::write::{nifti_f32, nifti_u8};

use crate::form::post_image;
use crate::http_segment::{PATH, bright, curves, grid, number, post_with_truth, values};
use crate::server::shared;

const SIZE: [usize; 3] = [26, 24, 22];
const CENTRE: [f64; 3] = [13.0, 11.5, 10.5];
const RADIUS: f64 = 7.5;

fn distance(cell: [f64; 3]) -> f64 {
    (0..3).map(|c| (cell[c] - CENTRE[c]).powi(2)).sum::<f64>().sqrt()
}

/// A bright shell of two cells around a centre, in a field that grows along x by more than the shell is bright.
fn shell() -> Vec<u8> {
    let value = |cell: [f64; 3]| {
        let wall = if (distance(cell) - RADIUS).abs() <= 1.0 { 100.0 } else { 0.0 };
        (wall + 8.0 * cell[0]) as f32
    };
    nifti_f32(&grid(SIZE, [2.0; 3], LengthUnit::Millimetre), &values(SIZE, value)).unwrap()
}

fn ball() -> Vec<u8> {
    let inside = |cell: [f64; 3]| u8::from(distance(cell) < RADIUS);
    nifti_u8(&grid(SIZE, [2.0; 3], LengthUnit::Millimetre), &values(SIZE, inside)).unwrap()
}

fn sphere(terms: &Value) -> Value {
    let generators = json!([{"name": "trigonometric"}, {"name": "trigonometric"}]);
    json!({
        "representation": {"kind": "surface", "topology": "sphere", "control_points": [5, 5], "generators": generators},
        "boxes": [{"lower": [14, 11, 11], "upper": [37, 34, 30]}], "terms": terms, "truth_labels": [1],
        "stages": [{"free": "affine", "sigma": 5}, {"sigma": 3}, {"sigma": 1.2}]
    })
}

#[test]
fn what_a_shell_encloses_is_found_in_its_edge_map() {
    let server = shared();
    let jaccard = |field: Value| {
        let term = json!([{"name": "contour", "polarity": "dark", "field": field}]);
        let found = post_with_truth(&server, &sphere(&term), &shell(), &ball()).expect(200);
        assert_eq!(found["results"][0]["warnings"], json!([]), "{field}");
        number(&found["results"][0]["overlap"]["jaccard"])
    };
    // The initial shape has 0.39; a shape ends before the crest of a sheet.
    let edge_map = json!({"kind": "edge_map", "sigma": 3, "centre": [25, 22, 20]});
    for field in [edge_map.clone(), json!({"kind": "sheets", "sigma": 1.5})] {
        let found = jaccard(field.clone());
        assert!(found > 0.55, "{field}: {found}");
    }
    // The same as in the surface that the detector answers.
    let surface = json!({"field": "surface", "sigma": 3, "centre": [25, 22, 20]});
    let map = post_image(&server, "/v1/sheets", &surface, &shell());
    assert_eq!(map.status, 200);
    let of_map = json!([{"name": "contour", "polarity": "dark"}]);
    let of_field = json!([{"name": "contour", "polarity": "dark", "field": edge_map}]);
    let in_map = post_image(&server, PATH, &sphere(&of_map), &map.body).expect(200);
    let in_field = post_image(&server, PATH, &sphere(&of_field), &shell()).expect(200);
    assert_eq!(in_field["results"], in_map["results"]);
    // The image itself is the default.
    let plain = |term: Value| post_image(&server, PATH, &sphere(&json!([term])), &shell()).expect(200);
    let named = json!({"name": "contour", "polarity": "dark", "field": {"kind": "intensity"}});
    assert_eq!(plain(named), plain(json!({"name": "contour", "polarity": "dark"})));
}

#[test]
fn terms_have_fields_of_their_own() {
    // The level of a threshold is the median of its own field in the initial shape: that of an edge map is 0.
    let server = shared();
    let field = json!({"kind": "edge_map", "sigma": 3});
    let threshold = |field: Value| {
        sphere(
            &json!([{"name": "contour", "field": {"kind": "sheets", "sigma": 3}}, {"name": "threshold", "field": field}]),
        )
    };
    let refused = post_image(&server, PATH, &threshold(field), &shell());
    refused.expect_problem(422, "invalid-input", &["/terms"]);
    let mut body = threshold(json!({"kind": "intensity"}));
    body["stages"] = json!([{"sigma": 3, "iterations": 0}]);
    let both = post_image(&server, PATH, &body, &shell()).expect(200);
    let alone = |term: Value| {
        let mut body = sphere(&json!([term]));
        body["stages"] = json!([{"sigma": 3, "iterations": 0}]);
        post_image(&server, PATH, &body, &shell()).expect(200)
    };
    let contour = alone(json!({"name": "contour", "field": {"kind": "sheets", "sigma": 3}}));
    let region = alone(json!({"name": "threshold"}));
    let energies = |answer: &Value, name: &str| answer["results"][0]["energies"][name].clone();
    assert_eq!(energies(&both, "contour"), energies(&contour, "contour"));
    assert_eq!(energies(&both, "threshold"), energies(&region, "threshold"));
}

#[test]
fn fields_that_do_not_fit_are_refused_at_their_place() {
    let server = shared();
    let refused = |field: Value, pointers: &[&str]| {
        let term = json!([{"name": "contour", "field": field}]);
        post_image(&server, PATH, &sphere(&term), &shell()).expect_problem(422, "invalid-input", pointers);
    };
    refused(json!({"kind": "sheets", "sigma": 0}), &["/terms/0/field/sigma"]);
    refused(json!({"kind": "sheets", "sigma": 100}), &["/terms/0/field/sigma"]);
    // Less than half a cell.
    refused(json!({"kind": "sheets", "sigma": 0.9}), &["/terms/0/field/sigma"]);
    refused(json!({"kind": "edge_map", "fraction": 1.5}), &["/terms/0/field/fraction"]);
    refused(json!({"kind": "edge_map", "percent": -1}), &["/terms/0/field/percent"]);
    refused(json!({"kind": "edge_map", "beyond": -1}), &["/terms/0/field/beyond"]);
    refused(json!({"kind": "edge_map", "centre": [1e200, 0, 0]}), &["/terms/0/field/centre"]);
    refused(json!({"kind": "edges"}), &["/terms/0/field/kind"]);
    // Images in the plane have no sheets.
    let term = json!([{"name": "contour", "field": {"kind": "sheets"}}]);
    let planar = post_image(&server, PATH, &curves(json!({"terms": term})), &bright());
    planar.expect_problem(422, "invalid-input", &["/terms/0/field"]);
}
