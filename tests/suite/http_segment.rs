//! Segmentation over HTTP: phantoms with known truths, and requests that are refused.

use std::f64::consts::TAU;

use reqwest::Method;
use serde_json::{Value, json};
use shapelex_formats::image::write::{nifti_f32, nifti_u8, png_u8};
use shapelex_formats::image::{Grid, LengthUnit};

use crate::form::{form, post_form, post_image};
use crate::server::{Reply, Server, Setting, shared};

pub(crate) const PATH: &str = "/v1/segment";

pub(crate) fn grid(size: [usize; 3], spacing: [f64; 3], unit: LengthUnit) -> Grid {
    Grid::along_axes(size, spacing, [unit; 3]).unwrap()
}

/// Values of an image from the positions of its cells, x fastest.
pub(crate) fn values<T>(size: [usize; 3], value: impl Fn([f64; 3]) -> T) -> Vec<T> {
    let cell = |at: usize| [at % size[0], at / size[0] % size[1], at / size[0] / size[1]].map(|i| i as f64);
    (0..size.iter().product()).map(|at| value(cell(at))).collect()
}

/// Whether a cell is in one of two ellipses of an image of 64 × 40 cells.
pub(crate) fn ellipses([x, y, _]: [f64; 3]) -> u8 {
    let inside =
        |[cx, cy]: [f64; 2], [a, b]: [f64; 2]| ((x - cx) / a).powi(2) + ((y - cy) / b).powi(2) <= 1.0;
    match () {
        () if inside([16.0, 20.0], [10.0, 7.0]) => 1,
        () if inside([46.0, 18.0], [8.0, 12.0]) => 2,
        () => 0,
    }
}

pub(crate) const PLANE: [usize; 3] = [64, 40, 1];

pub(crate) fn picture(value: impl Fn(u8) -> u8) -> Vec<u8> {
    let grid = grid(PLANE, [1.0; 3], LengthUnit::Unknown);
    png_u8(&grid, &values(PLANE, |cell| value(ellipses(cell)))).unwrap()
}

/// Two bright objects.
pub(crate) fn bright() -> Vec<u8> {
    picture(|label| if label > 0 { 200 } else { 40 })
}

pub(crate) fn curves(further: Value) -> Value {
    let mut body = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "trigonometric"}},
        "boxes": [{"lower": [8, 15], "upper": [25, 26]}, {"lower": [40, 10], "upper": [53, 27]}],
        "terms": [{"name": "contour"}]
    });
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    body
}

pub(crate) fn post_with_truth(server: &Server, parameters: &Value, image: &[u8], truth: &[u8]) -> Reply {
    post_files(server, PATH, parameters, &[("image", image), ("truth", truth)])
}

/// Sends parameters and files.
pub(crate) fn post_files(server: &Server, path: &str, parameters: &Value, files: &[(&str, &[u8])]) -> Reply {
    let parameters = parameters.to_string();
    let files = files.iter().map(|(name, file)| (*name, "application/octet-stream", *file));
    let parts: Vec<(&str, &str, &[u8])> =
        std::iter::once(("parameters", "application/json", parameters.as_bytes())).chain(files).collect();
    post_form(server, path, form(&parts))
}

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("expected a number, got {value}"))
}

/// Two objects in one picture that is not square, by every image term; the truth is counted in cells.
#[test]
fn two_objects_of_a_picture_are_found_by_every_term() {
    let (server, truth) = (shared(), picture(|label| label));
    for (term, least) in [
        (json!({"name": "contour"}), 0.93),
        (json!({"name": "threshold", "theta": 0.6, "level": 200}), 0.93),
        (json!({"name": "local_contrast"}), 0.90),
    ] {
        let body = curves(json!({"terms": [term], "truth_labels": [1, 2], "history": true}));
        let found = post_with_truth(&server, &body, &bright(), &truth).expect(200);
        assert_eq!(found["image"]["size"], json!([64, 40]));
        let results = found["results"].as_array().unwrap();
        assert_eq!(results.len(), 2);
        for (index, result) in results.iter().enumerate() {
            let jaccard = number(&result["overlap"]["jaccard"]);
            assert!(jaccard >= least, "{term} {index}: {jaccard}");
            assert_eq!((&result["index"], &result["warnings"]), (&json!(index), &json!([])), "{term}");
            assert!(
                ["converged", "line_search", "limit"].contains(&result["stop"].as_str().unwrap()),
                "{result}"
            );
            let stage = &result["stages"][0];
            let history: Vec<f64> = serde_json::from_value(stage["history"].clone()).unwrap();
            assert_eq!(history.len(), stage["iterations"].as_u64().unwrap() as usize + 1);
            assert!(history.windows(2).all(|pair| pair[1] <= pair[0]), "{term}: {history:?}");
        }
    }
    // One object alone gives the same bits as beside another, and a result is a shape.
    let body = curves(json!({}));
    let both = post_image(&server, PATH, &body, &bright()).expect(200);
    let one = curves(json!({"boxes": [{"lower": [40, 10], "upper": [53, 27]}]}));
    let one = post_image(&server, PATH, &one, &bright()).expect(200);
    assert_eq!(one["results"][0]["control_points"], both["results"][1]["control_points"]);
    let shapes = json!([{"control_points": one["results"][0]["control_points"]}]);
    let measured = server
        .post("/v1/measure", &json!({"representation": body["representation"], "shapes": shapes}))
        .expect(200);
    let area = number(&measured["results"][0]["signed_area"]);
    let expected = 0.5 * TAU * 8.0 * 12.0;
    assert!((area / expected - 1.0).abs() < 0.04, "{area}, expected {expected}");
}

/// Other methods find the same object; Newton's is not for surfaces.
#[test]
fn methods_of_minimisation_agree() {
    let (server, truth) = (shared(), picture(|label| label));
    let found = |method: &str| {
        let body = curves(json!({"method": method, "truth_labels": [1, 2]}));
        let results = post_with_truth(&server, &body, &bright(), &truth).expect(200)["results"].clone();
        [0, 1].map(|index| number(&results[index]["overlap"]["jaccard"]))
    };
    let expected = found("lbfgs");
    for method in ["newton", "coordinates"] {
        let found = found(method);
        let near = |index: usize| (found[index] - expected[index]).abs() < 0.02;
        assert!(near(0) && near(1), "{method}: {found:?}, {expected:?}");
    }
    let [image, _] = ball();
    let sphere = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6],
        "generators": [{"name": "trigonometric"}, {"name": "trigonometric"}]});
    let body = json!({"representation": sphere, "terms": [{"name": "contour"}], "method": "newton",
        "boxes": [{"lower": [8, 7, 9], "upper": [20, 18, 23]}]});
    post_image(&server, PATH, &body, &image).expect_problem(422, "invalid-input", &["/method"]);
}

/// The gradient against differences of the energy, by segmentations of no iterations.
#[test]
fn energies_and_gradients_are_evaluated_without_iterations() {
    let server = shared();
    let ask = |points: &[[f64; 2]]| {
        let body = curves(json!({
            "boxes": null, "shapes": [{"control_points": points}], "gradient": true,
            "terms": [{"name": "threshold", "theta": 0.6, "level": 200}, {"name": "spacing", "weight": 0}],
            "stages": [{"sigma": 2, "iterations": 0}]
        }));
        let mut body = body;
        body.as_object_mut().unwrap().remove("boxes");
        post_image(&server, PATH, &body, &bright()).expect(200)["results"][0].clone()
    };
    let points: Vec<[f64; 2]> = (0..8)
        .map(|k| f64::from(k) / 8.0 * TAU)
        .map(|t| [16.0 + 9.0 * t.cos(), 21.0 + 6.0 * t.sin()])
        .collect();
    let found = ask(&points);
    assert_eq!((&found["iterations"], &found["stop"]), (&json!(0), &json!("limit")));
    assert_eq!(found["control_points"].as_array().unwrap().len(), 8);
    assert_eq!(found["gradient_rows"], json!((0..8).collect::<Vec<_>>()));
    // The scale of the term is the area of the first shape: its product with the energy is differentiated.
    let area = |points: &[[f64; 2]]| {
        let body = json!({"representation": curves(json!({}))["representation"], "shapes": [{"control_points": points}]});
        number(&server.post("/v1/measure", &body).expect(200)["results"][0]["signed_area"])
    };
    let energy = |points: &[[f64; 2]]| number(&ask(points)["energies"]["threshold"]["value"]) * area(points);
    let scale = area(&points);
    for (k, c) in [(0, 0), (3, 1), (6, 0)] {
        let moved = |step: f64| {
            let mut moved = points.clone();
            moved[k][c] += step;
            energy(&moved)
        };
        let difference = (moved(1e-3) - moved(-1e-3)) / 2e-3;
        let gradient = number(&found["gradient"][k][c]) * scale;
        // Second-order differences of a field that is a quadratic spline.
        assert!((difference - gradient).abs() <= 1e-4 * (1.0 + gradient.abs()), "{difference}, {gradient}");
    }
}

/// The rows of the gradient of a cylinder are its points: control points beyond its ends follow them.
#[test]
fn a_gradient_says_to_which_control_points_it_belongs() {
    let server = shared();
    let place = |k: usize, l: usize| {
        let (sine, cosine) = (TAU * k as f64 / 6.0).sin_cos();
        [14.0 + 5.0 * cosine, 12.0 + 5.0 * sine, 4.0 + 3.0 * l as f64]
    };
    // M_u (M_v + 3) control points, one of each list before and one after the ends.
    let rows: Vec<[f64; 3]> = (0..6).flat_map(|k| (0..6).map(move |l| place(k, l))).collect();
    let body = json!({"representation": {"kind": "surface", "topology": "cylinder", "control_points": [6, 3]},
        "shapes": [{"control_points": rows}], "gradient": true,
        "terms": [{"name": "threshold", "theta": 0.6, "level": 60}], "stages": [{"sigma": 2, "iterations": 0}]});
    let found = post_image(&server, PATH, &body, &ball()[0]).expect(200)["results"][0].clone();
    assert_eq!(found["control_points"].as_array().unwrap().len(), 36);
    assert_eq!(found["gradient"].as_array().unwrap().len(), 24);
    let free: Vec<usize> = (0..6).flat_map(|k| (1..5).map(move |l| 6 * k + l)).collect();
    assert_eq!(found["gradient_rows"], json!(free));
}

pub(crate) const SPACE: [usize; 3] = [30, 26, 22];

/// A bright ellipsoid in a volume with unequal spacing, as NIfTI, and its truth.
pub(crate) fn ball() -> [Vec<u8>; 2] {
    let spacing = [1.0, 1.0, 1.5];
    let inside = |[x, y, z]: [f64; 3]| {
        ((x - 14.0) / 9.0).powi(2) + ((y - 12.0) / 8.0).powi(2) + ((z - 10.5) / 6.0).powi(2) <= 1.0
    };
    let grid = grid(SPACE, spacing, LengthUnit::Millimetre);
    let image = values(SPACE, |cell| if inside(cell) { 100.0_f32 } else { 20.0 });
    [
        nifti_f32(&grid, &image).unwrap(),
        nifti_u8(&grid, &values(SPACE, |cell| u8::from(inside(cell)))).unwrap(),
    ]
}

/// Spheres, tied to nothing, and subdivision surfaces, in millimetres.
#[test]
fn bodies_in_a_volume_are_found_by_surfaces_and_meshes() {
    let (server, [image, truth]) = (shared(), ball());
    let trigonometric = json!({"name": "trigonometric"});
    for representation in [
        json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]}),
        json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron/1", "level": 3}),
    ] {
        let body = json!({
            "representation": representation, "terms": [{"name": "contour"}],
            "boxes": [{"lower": [8, 7, 9], "upper": [20, 18, 23]}]
        });
        let found = post_with_truth(&server, &body, &image, &truth).expect(200);
        let result = &found["results"][0];
        let jaccard = number(&result["overlap"]["jaccard"]);
        assert!(jaccard > 0.9 && result["warnings"] == json!([]), "{jaccard} {}", result["warnings"]);
        let shapes = json!([{"control_points": result["control_points"]}]);
        let measured = server
            .post("/v1/measure", &json!({"representation": representation, "shapes": shapes}))
            .expect(200);
        let volume = number(&measured["results"][0]["signed_volume"]);
        let expected = TAU * 2.0 / 3.0 * 9.0 * 8.0 * 9.0;
        assert!((volume / expected - 1.0).abs() < 0.06, "{volume}, expected {expected}");
    }
}

/// A strong prior keeps the class of its reference: the result is an ellipse turned and scaled, however dented the object is.
#[test]
fn a_prior_keeps_the_shape_in_a_class() {
    let server = shared();
    let dented = |[x, y, _]: [f64; 3]| {
        ((x - 16.0) / 10.0).powi(2) + ((y - 20.0) / 7.0).powi(2) <= 1.0
            && (x - 24.0).powi(2) + (y - 20.0).powi(2) > 25.0
    };
    let grid = grid(PLANE, [1.0; 3], LengthUnit::Unknown);
    let image = png_u8(&grid, &values(PLANE, |cell| if dented(cell) { 200 } else { 40 })).unwrap();
    let ellipse: Vec<[f64; 2]> =
        (0..8).map(|k| f64::from(k) / 8.0 * TAU).map(|t| [10.0 * t.cos(), 7.0 * t.sin()]).collect();
    let distance = |prior: Value| {
        let body = curves(json!({"boxes": [{"lower": [8, 14], "upper": [26, 26]}]}));
        let mut body = body;
        if !prior.is_null() {
            body["prior"] = prior;
        }
        let found = post_image(&server, PATH, &body, &image).expect(200)["results"][0].clone();
        let project = json!({"representation": body["representation"], "transformation": "similarity",
            "reference": {"control_points": ellipse}, "shapes": [{"control_points": found["control_points"]}]});
        number(&server.post("/v1/project", &project).expect(200)["results"][0]["squared_distance"])
    };
    let prior = |weight: f64| json!({"reference": {"control_points": ellipse}, "transformation": "similarity", "weight": weight});
    let (free, weak, strong) = (distance(Value::Null), distance(prior(3.0)), distance(prior(1000.0)));
    assert!(strong < 0.01 * free && weak < free, "{free} {weak} {strong}");
}

/// The means of a cohort and of a dictionary attract as the same means do when they are posted, to the last bit.
#[test]
fn stored_means_are_references_of_a_prior() {
    let server = Setting::fresh().start();
    let representation = curves(json!({}))["representation"].clone();
    let ellipse = |index: i32| {
        let (a, b, turn) = (10.0, 6.0 + 0.3 * f64::from(index), 0.1 * f64::from(index));
        let point = |k: i32| {
            let (y, x) = (f64::from(k) / 8.0 * TAU).sin_cos();
            [a * x * turn.cos() - b * y * turn.sin(), a * x * turn.sin() + b * y * turn.cos()]
        };
        json!({"control_points": (0..8).map(point).collect::<Vec<_>>()})
    };
    let shapes: Vec<Value> = (0..6).map(ellipse).collect();
    server.post("/v1/cohorts", &json!({"name": "cells", "representation": representation})).expect(201);
    server.post("/v1/cohorts/cells/shapes", &json!({"shapes": shapes})).expect(201);
    let learn = json!({"name": "modes", "cohort": "cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2}});
    let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&learn);
    server.send(learn).expect(201);
    let prior = |mut prior: Value| {
        prior["transformation"] = json!("similarity");
        prior["weight"] = json!(10);
        // The attraction to the boxes, which are smaller than the objects, is left out.
        curves(json!({"prior": prior, "leave_box": true}))
    };
    let segmented = |body: &Value| post_image(&server, PATH, body, &bright()).expect(200)["results"].clone();
    let posted =
        |mean: &Value| segmented(&prior(json!({"reference": {"control_points": mean["control_points"]}})));
    let mean = server.get("/v1/cohorts/cells/mean?transformation=similarity").expect(200)["mean"].clone();
    let by_cohort = segmented(&prior(json!({"cohort": "cells"})));
    assert_eq!(by_cohort, posted(&mean));
    assert_ne!(by_cohort, segmented(&curves(json!({}))));
    let mean = server.get("/v1/dictionaries/modes").expect(200)["mean"].clone();
    assert_eq!(segmented(&prior(json!({"dictionary": "modes@1"}))), posted(&mean));

    // A strong attraction to what the components span leaves nothing outside of it; components and atoms span the same.
    let spanned = |part: &str, weight: f64| {
        let mut body = prior(json!({"dictionary": "modes@1", "reference": part}));
        body["prior"]["weight"] = json!(weight);
        segmented(&body)
    };
    assert_eq!(spanned("mean", 10.0), segmented(&prior(json!({"dictionary": "modes@1"}))));
    assert_eq!(spanned("components", 10.0), spanned("atoms", 10.0));
    let outside = |found: &Value| {
        let shapes = json!([{"control_points": found[0]["control_points"]}]);
        let body = json!({"shapes": shapes, "reference": "atoms"});
        number(&server.post("/v1/dictionaries/modes/prior", &body).expect(200)["results"][0]["energy"])
    };
    let (free, strong) = (outside(&segmented(&curves(json!({})))), outside(&spanned("components", 1e4)));
    assert!(strong < 1e-3 * free, "{strong} {free}");
    let term = |found: &Value| number(&found[0]["energies"]["prior"]["value"]);
    assert!(term(&spanned("components", 10.0)) < term(&spanned("mean", 10.0)));

    let ask = |body: &Value| post_image(&server, PATH, body, &bright());
    let mut rigid = prior(json!({"dictionary": "modes", "reference": "components"}));
    rigid["prior"]["transformation"] = json!("rigid");
    ask(&rigid).expect_problem(422, "invalid-input", &["/prior/transformation"]);
    let unknown = prior(json!({"dictionary": "modes", "reference": "modes"}));
    ask(&unknown).expect_problem(422, "invalid-input", &["/prior/reference"]);
    let of_cohort = prior(json!({"cohort": "cells", "reference": "components"}));
    ask(&of_cohort).expect_problem(422, "invalid-input", &["/prior/reference"]);
    ask(&prior(json!({"cohort": "none"}))).expect_problem(404, "not-found", &[]);
    ask(&prior(json!({"dictionary": "none"}))).expect_problem(404, "not-found", &[]);
    let both = prior(json!({"cohort": "cells", "dictionary": "modes"}));
    ask(&both).expect_problem(422, "invalid-input", &["/prior/reference"]);
    ask(&prior(json!({"cohort": 3}))).expect_problem(422, "invalid-input", &["/prior/cohort"]);
    for field in [json!({"cohort": "cells"}), json!({"dictionary": "modes"})] {
        let pointer = format!("/prior/{}", field.as_object().unwrap().keys().next().unwrap());
        let mut other = prior(field);
        other["representation"]["control_points"] = json!(9);
        ask(&other).expect_problem(422, "invalid-input", &[&pointer]);
    }
}

#[test]
fn another_polarity_is_a_warning_and_a_lost_shape_is_an_answer() {
    let server = shared();
    let dark = picture(|label| if label > 0 { 40 } else { 200 });
    let one = json!({"boxes": [{"lower": [8, 15], "upper": [25, 26]}]});
    let mut wrong = curves(one.clone());
    wrong["terms"] = json!([{"name": "contour", "polarity": "bright"}]);
    let found = post_image(&server, PATH, &wrong, &dark).expect(200);
    let warnings = found["results"][0]["warnings"].to_string();
    assert!(warnings.contains("other polarity"), "{warnings}");
    let mut right = curves(one.clone());
    right["terms"] = json!([{"name": "contour", "polarity": "dark"}]);
    let found = post_image(&server, PATH, &right, &dark).expect(200);
    assert_eq!(found["results"][0]["warnings"], json!([]));
    // By default the contrast decides.
    let usual = post_image(&server, PATH, &curves(one), &dark).expect(200);
    assert_eq!(usual["results"], found["results"]);
    // A shape beside the image has no image in it.
    let outside = curves(json!({"boxes": [{"lower": [200, 15], "upper": [225, 26]}]}));
    let found = post_image(&server, PATH, &outside, &bright()).expect(200);
    let result = &found["results"][0];
    assert_eq!((&result["stop"], &result["converged"]), (&json!("left_image"), &json!(false)));
    assert!(result["warnings"].to_string().contains("left the image in stage 0"), "{}", result["warnings"]);
}

#[test]
fn bad_segmentations_are_refused_at_their_place() {
    let server = shared();
    let refused = |further: Value, pointers: &[&str]| {
        post_image(&server, PATH, &curves(further), &bright()).expect_problem(422, "invalid-input", pointers);
    };
    let kind = |kind: Value| json!({"representation": kind});
    let trigonometric = json!({"name": "trigonometric"});
    refused(json!({"terms": []}), &["/terms"]);
    refused(json!({"terms": [{"name": "spacing"}]}), &["/terms"]);
    refused(json!({"terms": [{"name": "contour", "weight": -1}]}), &["/terms/0/weight"]);
    refused(
        json!({"terms": [{"name": "contour", "edges": {"kind": "percentile", "percent": 101}}]}),
        &["/terms/0/edges/percent"],
    );
    refused(json!({"terms": [{"name": "contour"}, {"name": "contour"}]}), &["/terms/1"]);
    refused(json!({"terms": [{"name": "edges"}]}), &["/terms/0/name"]);
    refused(json!({"stages": [{"sigma": -1}]}), &["/stages/0/sigma"]);
    refused(json!({"stages": [{"sigma": 65}]}), &["/stages/0/sigma"]);
    // Second derivatives need a blur, means do not.
    refused(json!({"stages": [{"sigma": 0}]}), &["/stages/0/sigma"]);
    refused(json!({"stages": [{"sigma": 1}, {"sigma": 0.4}]}), &["/stages/1/sigma"]);
    let unblurred =
        curves(json!({"terms": [{"name": "two_class"}], "stages": [{"sigma": 0, "iterations": 3}]}));
    post_image(&server, PATH, &unblurred, &bright()).expect(200);
    refused(json!({"stages": [{"sigma": 1, "iterations": 100_000}]}), &["/stages/0/iterations"]);
    refused(json!({"boxes": []}), &["/boxes"]);
    refused(json!({"boxes": [{"lower": [1, 2], "upper": [1, 3]}]}), &["/boxes/0/upper/0"]);
    refused(json!({"boxes": [{"lower": [1, 2, 3], "upper": [4, 5]}]}), &["/boxes/0/lower"]);
    refused(json!({"shapes": []}), &["/boxes"]);
    refused(json!({"truth_labels": [1]}), &["/truth_labels"]);
    refused(json!({"size": 3}), &["/size"]);
    refused(json!({"prior": {"transformation": "similarity"}}), &["/prior/reference"]);
    refused(
        json!({"prior": {"reference": {"points": [[0, 0], [1, 0], [0, 1]]}, "transformation": "rigid", "alignment": "projection"}}),
        &["/prior/transformation"],
    );
    refused(kind(json!({"kind": "landmarks", "dimension": 2, "points": 8})), &["/representation/kind"]);
    refused(
        kind(json!({"kind": "open_curve", "dimension": 2, "intervals": 8, "generator": {"name": "cubic"}})),
        &["/representation/kind"],
    );
    let plane = json!({"kind": "surface", "topology": "plane", "control_points": [6, 6], "generators": [{"name": "cubic"}, {"name": "cubic"}]});
    let [volume, _] = ball();
    let in_space = |representation: Value| {
        let boxes = json!([{"lower": [8, 7, 9], "upper": [20, 18, 23]}]);
        json!({"representation": representation, "terms": [{"name": "contour"}], "boxes": boxes})
    };
    post_image(&server, PATH, &in_space(plane), &volume).expect_problem(
        422,
        "invalid-input",
        &["/representation/topology"],
    );
    let faces =
        json!([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]);
    let mesh = json!({"kind": "subdivision", "scheme": "loop", "connectivity": faces, "level": 2});
    post_image(&server, PATH, &in_space(mesh), &volume).expect_problem(
        422,
        "invalid-input",
        &["/representation/connectivity"],
    );
    // A picture for a surface, and a volume for a curve.
    let sphere = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]});
    post_image(&server, PATH, &in_space(sphere), &bright()).expect_problem(422, "invalid-input", &["/image"]);
    post_image(&server, PATH, &curves(json!({})), &volume).expect_problem(422, "invalid-input", &["/image"]);
    // A shape without area.
    let flat = [9, 12, 15, 18, 21, 18, 15, 12].map(|x| json!([x, 20]));
    let mut flat = curves(json!({"shapes": [{"control_points": flat}]}));
    flat.as_object_mut().unwrap().remove("boxes");
    post_image(&server, PATH, &flat, &bright()).expect_problem(422, "invalid-input", &["/shapes/0"]);
    // An image without contrast has no edges, a truth of another size no cells to compare.
    post_image(&server, PATH, &curves(json!({})), &picture(|_| 9)).expect_problem(
        422,
        "invalid-input",
        &["/terms"],
    );
    let small = png_u8(&grid([40, 64, 1], [1.0; 3], LengthUnit::Unknown), &[0; 64 * 40]).unwrap();
    post_with_truth(&server, &curves(json!({})), &bright(), &small).expect_problem(
        422,
        "invalid-input",
        &["/truth"],
    );
    post_image(&server, PATH, &curves(json!({})), &bright()[..100]).expect_problem(
        422,
        "invalid-input",
        &["/image"],
    );
    let parameters = curves(json!({})).to_string();
    post_form(&server, PATH, form(&[("parameters", "application/json", parameters.as_bytes())]))
        .expect_problem(422, "invalid-input", &["/image"]);
}

/// Many objects with many points are refused before they are computed; a dry run predicts what they cost.
#[test]
fn segmentations_that_cost_too_much_are_refused() {
    let server = Setting::fresh().flags(&["--max-job-seconds", "10"]).start();
    let points = |count: usize| json!({"kind": "closed_curve", "dimension": 2, "control_points": count, "generator": {"name": "trigonometric"}});
    let boxes: Vec<Value> = (0..5000).map(|_| json!({"lower": [8, 15], "upper": [25, 26]})).collect();
    let body = curves(json!({"representation": points(200), "boxes": boxes}));
    post_image(&server, PATH, &body, &bright()).expect_problem(422, "too-costly", &[]);
    let dry = post_image(&server, "/v1/segment?dry_run=true", &body, &bright()).expect(200);
    assert!(number(&dry["estimate"]["seconds"]) > 10.0, "{dry}");
    assert_eq!(dry["estimate"]["objects"], 5000);
    // One object of many points, by methods that take more than an evaluation in an iteration.
    let one = json!([{"lower": [8, 15], "upper": [25, 26]}]);
    for method in ["newton", "coordinates"] {
        let body = curves(json!({"representation": points(2000), "boxes": one, "method": method,
            "stages": [{"sigma": 1, "iterations": 2000}]}));
        post_image(&server, PATH, &body, &bright()).expect_problem(422, "too-costly", &[]);
    }
}

/// A dry run computes nothing: of a file only the header is read, and all faults are found.
#[test]
fn dry_runs_predict_memory_and_time() {
    let server = shared();
    let dry = |body: &Value, image: &[u8]| post_image(&server, "/v1/segment?dry_run=true", body, image);
    let one = curves(json!({"boxes": [{"lower": [8, 15], "upper": [25, 26]}]}));
    let small = dry(&one, &bright()[..100]).expect(200)["estimate"].clone();
    let cells = (PLANE[0] * PLANE[1]) as f64;
    assert!(number(&small["memory_bytes"]) > 36.0 * cells, "{small}");
    let seconds = number(&small["seconds"]);
    assert!(seconds > 1e-4 && seconds < 0.1, "{seconds}");
    // More objects and terms cost more, fewer iterations less.
    let more = |body: &Value| number(&dry(body, &bright()).expect(200)["estimate"]["seconds"]);
    assert!(more(&curves(json!({}))) > 1.5 * seconds);
    let mut terms = one.clone();
    terms["terms"] = json!([{"name": "contour"}, {"name": "two_class"}]);
    assert!(more(&terms) > 1.2 * seconds);
    let mut short = one.clone();
    short["stages"] = json!([{"sigma": 2, "iterations": 1}]);
    assert!(more(&short) < 0.5 * seconds);
    dry(&curves(json!({"terms": []})), &bright()).expect_problem(422, "invalid-input", &["/terms"]);
    post_image(&server, "/v1/segment?dry_run=maybe", &one, &bright()).expect_problem(
        400,
        "invalid-query",
        &[],
    );
}
