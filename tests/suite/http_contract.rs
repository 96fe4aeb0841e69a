//! What the service promises, over HTTP against the real program.

use std::f64::consts::{PI, TAU};
use std::io::{Read, Write};
use std::path::Path;
use std::time::Duration;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use reqwest::Method;
use reqwest::header::{ACCEPT, ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, IF_NONE_MATCH};
use serde_json::{Value, json};

use crate::server::{Server, Setting, assert_close, flat, shared};

fn vectors(name: &str) -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/vectors/analysis").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The generator of a vector file as it stands in requests.
fn generator(name: &str) -> Value {
    match name.strip_prefix("bspline_") {
        Some("linear") => json!({"name": "bspline", "degree": 1}),
        Some(other) => panic!("no degree for {other}"),
        None => json!({ "name": name }),
    }
}

fn curve(control_points: usize, generator: Value) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": control_points, "generator": generator})
}

fn trigonometric(control_points: usize) -> Value {
    curve(control_points, json!({"name": "trigonometric"}))
}

/// `count` points of the ellipse with half axes `a`, `b` about `(x, y)`, counter-clockwise from the right.
fn ellipse(count: usize, a: f64, b: f64, [x, y]: [f64; 2]) -> Vec<[f64; 2]> {
    let angle = |k: usize| TAU * k as f64 / count as f64;
    (0..count).map(|k| [x + a * angle(k).cos(), y + b * angle(k).sin()]).collect()
}

/// A blob without symmetry, different for every `seed`.
fn blob(count: usize, seed: usize) -> Vec<[f64; 2]> {
    let s = seed as f64;
    let radius = |t: f64| {
        2.0 + 0.3 * (2.0 * t + s).cos()
            + 0.2 * (3.0 * t + 1.7 * s).sin()
            + 0.1 * (5.0 * t - 0.4 * s * s).cos()
    };
    let angle = |k: usize| TAU * k as f64 / count as f64;
    (0..count)
        .map(|k| {
            let (t, r) = (angle(k), radius(angle(k)));
            [10.0 * s + 1.5 * r * t.cos(), r * t.sin() - s]
        })
        .collect()
}

fn transformed(points: &[[f64; 2]], matrix: [[f64; 2]; 2], offset: [f64; 2]) -> Vec<[f64; 2]> {
    let row = |p: &[f64; 2], r: usize| matrix[r][0] * p[0] + matrix[r][1] * p[1] + offset[r];
    points.iter().map(|p| [row(p, 0), row(p, 1)]).collect()
}

fn shapes_of(lists: impl IntoIterator<Item = Vec<[f64; 2]>>) -> Vec<Value> {
    lists.into_iter().map(|points| json!({ "points": points })).collect()
}

pub(crate) fn cells() -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/cells/cells.ndjson");
    std::fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

// ---------------------------------------------------------------- catalogue

#[test]
fn the_catalogue_lists_generators_and_classes() {
    let server = shared();
    let generators = server.get("/v1/generators").expect(200);
    let items = generators["items"].as_array().unwrap();
    let names: Vec<&str> = items.iter().map(|item| item["generator"]["name"].as_str().unwrap()).collect();
    let splines = ["bspline"; 5];
    let with_poles = ["exponential", "interpolator", "interpolator"];
    assert_eq!(names, [&["trigonometric", "cubic"][..], &splines, &with_poles].concat());
    for item in items {
        let support = item["support"].as_u64().unwrap();
        // The B-spline of three poles is of degree 2 but for the functions that it is made of.
        let degree = match item["generator"]["name"].as_str() {
            Some("exponential") => Some(2),
            _ => item["generator"]["degree"].as_u64(),
        };
        assert_eq!(support, degree.map_or(4, |degree| degree + 1), "{item}");
        assert_eq!(item["interpolating"], degree.is_none_or(|degree| degree == 1), "{item}");
        assert_eq!(item["smoothness"], degree.map_or(1, |degree| degree - 1), "{item}");
        assert!(!item["reproduces"].as_array().unwrap().is_empty(), "{item}");
        // What the catalogue shows can be posted as it is.
        let representation = curve(6, item["generator"].clone());
        let body = json!({"representation": representation, "shapes": shapes_of([blob(6, 1)])});
        server.post("/v1/evaluate", &body).expect(200);
    }

    let classes = server.get("/v1/transformations").expect(200);
    let items = classes["items"].as_array().unwrap();
    assert_eq!(items.len(), 16, "{classes}");
    let find = |name: &str| items.iter().find(|item| item["name"] == name).unwrap();
    assert_eq!(find("affine")["translation"], true);
    assert_eq!(find("affine")["projection_dimensions"], json!([2, 3]));
    assert_eq!(find("affine")["planar_basis"].as_array().unwrap().len(), 4);
    assert_eq!(find("similarity")["projection_dimensions"], json!([2]));
    assert_eq!(find("similarity")["procrustes"], true);
    assert_eq!(find("linear")["translation"], false);
    assert_eq!(find("rigid")["projection_dimensions"], json!([]));
}

#[test]
fn every_class_of_the_catalogue_has_a_mean_in_the_dimensions_it_names() {
    let server = shared();
    let classes = server.get("/v1/transformations").expect(200);
    let plane: Vec<Value> = shapes_of([1, 2, 3].map(|seed| blob(8, seed)));
    let space: Vec<Value> = [1, 2, 3].map(|seed| json!({ "points": knot(8, seed) })).to_vec();
    for item in classes["items"].as_array().unwrap() {
        for (dimension, shapes) in [(2, &plane), (3, &space)] {
            let representation = json!({"kind": "closed_curve", "dimension": dimension, "control_points": 8,
                "generator": {"name": "cubic"}});
            let mut body =
                json!({"representation": representation, "transformation": item["name"], "shapes": shapes});
            let projects = item["projection_dimensions"].as_array().unwrap().contains(&json!(dimension));
            let fits = item["procrustes"] == true || item["name"] == "translation";
            let mut mean = |alignment: Value, is_possible: bool| {
                body["alignment"] = alignment;
                let answer = server.post("/v1/mean", &body);
                let what = format!("{} in {dimension}: {}", item["name"], answer.text());
                assert_eq!(answer.status, if is_possible { 200 } else { 422 }, "{what}");
                answer.json()
            };
            let projected = mean(json!("projection"), projects);
            let fitted = mean(json!("procrustes"), fits);
            // Without an alignment the class is projected on, or fitted where it is no linear space.
            let usual = mean(Value::Null, projects || fits);
            if projects || fits {
                assert_eq!(usual, if projects { projected } else { fitted }, "{}", item["name"]);
            }
        }
    }
}

/// A curve of space, different for every `seed`.
fn knot(count: usize, seed: usize) -> Vec<[f64; 3]> {
    let s = seed as f64;
    let point = |t: f64| {
        [
            3.0 * t.cos() + 0.3 * (2.0 * t + s).sin() + s,
            2.0 * t.sin(),
            (2.0 * t).cos() + 0.2 * s * (3.0 * t).sin(),
        ]
    };
    (0..count).map(|k| point(TAU * k as f64 / count as f64)).collect()
}

// ---------------------------------------------------------------- projection

#[test]
fn projections_are_those_of_the_vectors() {
    let server = shared();
    let cases = vectors("projectors.json");
    assert_eq!(cases.len(), 28);
    for case in cases {
        let name = case["transformation"].as_str().unwrap();
        let control_points = case["reference"].as_array().unwrap().len();
        let representation = curve(control_points, generator(case["generator"].as_str().unwrap()));
        let answer = server
            .post(
                "/v1/project",
                &json!({
                    "representation": representation,
                    "transformation": name,
                    "reference": {"points": case["reference"]},
                    "shapes": [{"control_points": case["query"]}, {"points": case["query"]}],
                }),
            )
            .expect(200);
        let projections = answer["results"].as_array().unwrap();
        assert_eq!(projections.len(), 2);
        let found = &projections[0];
        let mut same = projections[1].clone();
        same["index"] = json!(0);
        assert_eq!(*found, same, "interpolating generators: points are control points");
        assert_close(&found["control_points"], &case["projected"], 1e-9, name);
        assert_close(&found["matrix"], &case["matrix"], 1e-9, name);
        assert_close(&found["offset"], &case["offset"], 1e-9, name);
        assert_close(&found["squared_distance"], &case["squared_distance"], 1e-9, name);
        let correlation = found["correlation"].as_f64().unwrap();
        assert!((0.0..=1.0 + 1e-12).contains(&correlation), "{name}: {correlation}");
    }
}

#[test]
fn a_projection_onto_the_shape_is_the_projection_with_roles_exchanged() {
    let server = shared();
    let (one, other) = (blob(9, 1), blob(9, 2));
    let body = |reference: &[[f64; 2]], shape: &[[f64; 2]], onto: &str| {
        json!({"representation": trigonometric(9), "transformation": "affine", "onto": onto,
            "reference": {"points": reference}, "shapes": [{"points": shape}]})
    };
    let forth = server.post("/v1/project", &body(&one, &other, "shape")).expect(200);
    let back = server.post("/v1/project", &body(&other, &one, "reference")).expect(200);
    assert_close(&forth["results"][0]["matrix"], &back["results"][0]["matrix"], 1e-12, "matrix");
    assert_close(&forth["results"][0]["offset"], &back["results"][0]["offset"], 1e-12, "offset");
}

// ---------------------------------------------------------------- mean, alignment, PCA

#[test]
fn mean_alignment_and_components_are_those_of_the_vectors() {
    let server = shared();
    let cases = vectors("mean_alignment_pca.json");
    assert_eq!(cases.len(), 10);
    for case in cases {
        let shapes: Vec<Value> =
            case["shapes"].as_array().unwrap().iter().map(|points| json!({ "points": points })).collect();
        let control_points = case["shapes"][0].as_array().unwrap().len();
        let name = case["transformation"].as_str().unwrap();
        let mut body = json!({
            "representation": curve(control_points, generator(case["generator"].as_str().unwrap())),
            "correspondence": "landmarks", "mirror": "forbid", "frame": "training",
            "transformation": name, "shapes": shapes,
        });
        let mean = server.post("/v1/mean", &body).expect(200);
        assert_close(&mean["mean"]["control_points"], &case["mean_training_frame"], 1e-9, name);
        let wanted = flat(&case["eigenvalues"]);
        let mut found = flat(&mean["eigenvalues"]);
        found.resize(found.len().max(wanted.len()), 0.0);
        assert_close(&json!(found[..wanted.len()]), &case["eigenvalues"], 1e-9, name);
        assert_eq!(mean["shape_count"], shapes.len());
        assert_eq!(mean["unique"], true, "{mean}");
        assert!(mean["gap"].as_f64().unwrap() > 0.0);

        let align = server.post("/v1/align", &body).expect(200);
        for field in ["mean", "eigenvalues", "gap", "unique", "shapes"] {
            assert_eq!(align[field], mean[field], "{name}: {field} of align and of mean");
        }
        let aligned = align["aligned"].as_array().unwrap();
        assert_eq!(aligned.len(), shapes.len());
        for (k, (found, wanted)) in aligned.iter().zip(case["aligned"].as_array().unwrap()).enumerate() {
            let what = format!("{name} aligned {k}");
            assert_close(&found["control_points"], wanted, 1e-9, &what);
            is_the_shape_moved(found, &case["shapes"][k], &what);
            assert_eq!(
                (&found["reflected"], &found["shift"]),
                (&json!(determinant(found) < 0.0), &json!(0)),
                "{what}"
            );
        }

        body["components"] = json!(10);
        (body["alignment"], body["centre"]) = (json!("projection"), json!(false));
        let pca = server.post("/v1/pca", &body).expect(200);
        assert_eq!(pca["aligned"], align["aligned"]);
        let warnings = pca["warnings"].as_array().unwrap();
        let told = |warning: &Value| warning.as_str().unwrap().contains("the first one is the mean");
        assert!(warnings.iter().any(told), "{warnings:?}");
        let (pca, wanted) = (&pca["pca"], &case["pca"]);
        assert_close(&pca["eigenvalues"], &wanted["eigenvalues"], 1e-9, name);
        assert_close(&pca["explained"], &wanted["explained"], 1e-9, name);
        first_up_to_sign(
            &pca["eigenshapes"][0]["control_points"],
            &wanted["first_eigenshape_up_to_sign"],
            name,
        );
        for (i, row) in wanted["abs_scores"].as_array().unwrap().iter().enumerate() {
            let scores = pca["scores"].as_array().unwrap();
            let found: Vec<f64> = scores.iter().map(|shape| shape[i].as_f64().unwrap().abs()).collect();
            assert_close(&json!(found), row, 1e-9, &format!("{name}: scores of component {i}"));
        }

        body["centre"] = json!(true);
        let centred = &server.post("/v1/pca", &body).expect(200)["pca"];
        assert_eq!((&centred["centre"], &centred["tangent"]), (&json!(true), &json!(false)));
        assert_close(&centred["mean"]["control_points"], &case["pca_centred"]["mean"], 1e-9, name);
        assert_close(&centred["eigenvalues"], &case["pca_centred"]["eigenvalues"], 1e-9, name);
        assert_close(&centred["explained"], &case["pca_centred"]["explained"], 1e-9, name);
    }
}

fn determinant(aligned: &Value) -> f64 {
    let m = flat(&aligned["matrix"]);
    m[0] * m[3] - m[1] * m[2]
}

/// The aligned control points are `A r + b` of the shape, with the `A` and `b` of the answer.
fn is_the_shape_moved(aligned: &Value, shape: &Value, what: &str) {
    let (matrix, offset) = (flat(&aligned["matrix"]), flat(&aligned["offset"]));
    let rows = shape.as_array().unwrap().iter().map(flat);
    let moved: Vec<f64> =
        rows.flat_map(|p| [0, 1].map(|r| dot(&matrix[2 * r..2 * r + 2], &p) + offset[r])).collect();
    assert_close(&aligned["control_points"], &json!(moved), 1e-9, what);
}

fn first_up_to_sign(found: &Value, wanted: &Value, what: &str) {
    let (found, wanted_list) = (flat(found), flat(wanted));
    let sign = dot(&found, &wanted_list).signum();
    assert_close(&json!(found.iter().map(|v| sign * v).collect::<Vec<_>>()), wanted, 1e-9, what);
}

#[test]
fn a_class_by_its_matrices_is_the_class_by_its_name() {
    let server = shared();
    let shapes = shapes_of((1..5).map(|seed| blob(8, seed)));
    let mut body =
        json!({"representation": trigonometric(8), "transformation": "similarity", "shapes": shapes});
    let named = server.post("/v1/align", &body).expect(200);
    body["transformation"] = json!({"matrices": [[[1, 0], [0, 1]], [[0, -1], [1, 0]]], "translation": true});
    let given = server.post("/v1/align", &body).expect(200);
    assert_close(&given["mean"]["control_points"], &named["mean"]["control_points"], 1e-9, "mean");
    assert_close(&given["eigenvalues"], &named["eigenvalues"], 1e-9, "eigenvalues");
    for (a, b) in given["aligned"].as_array().unwrap().iter().zip(named["aligned"].as_array().unwrap()) {
        assert_close(&a["matrix"], &b["matrix"], 1e-9, "matrix");
        assert_close(&a["offset"], &b["offset"], 1e-9, "offset");
    }
    body["transformation"]["translation"] = json!(false);
    let without = server.post("/v1/align", &body).expect(200);
    assert_eq!(without["aligned"][0]["offset"], json!([0.0, 0.0]));
    body["transformation"] = json!("scaled_rotation");
    let scaled = server.post("/v1/mean", &body).expect(200);
    assert_close(
        &without["mean"]["control_points"],
        &scaled["mean"]["control_points"],
        1e-9,
        "no translation",
    );
}

#[test]
fn procrustes_recovers_known_motions() {
    let server = shared();
    let (s, c) = 0.7_f64.sin_cos();
    let shape = blob(10, 1);
    let moved = transformed(&shape, [[1.5 * c, -1.5 * s], [1.5 * s, 1.5 * c]], [4.0, -2.0]);
    let mut body = json!({"representation": trigonometric(10), "transformation": "similarity",
        "alignment": "procrustes", "shapes": shapes_of([shape, moved])});
    let answer = server.post("/v1/align", &body).expect(200);
    for aligned in answer["aligned"].as_array().unwrap() {
        assert!(aligned["residual"].as_f64().unwrap() < 1e-9, "{aligned}");
        assert!((aligned["correlation"].as_f64().unwrap() - 1.0).abs() < 1e-9, "{aligned}");
        assert_eq!(aligned["reflected"], false);
    }
    assert_eq!(answer["converged"], true);
    assert_eq!((&answer["gap"], &answer["unique"]), (&Value::Null, &Value::Null));
    let ratio =
        answer["aligned"][1]["size"].as_f64().unwrap() / answer["aligned"][0]["size"].as_f64().unwrap();
    assert!((ratio - 1.5).abs() < 1e-9, "the size that the class removes is reported: {ratio}");
    body["transformation"] = json!("rigid");
    let rigid = server.post("/v1/align", &body).expect(200);
    for aligned in rigid["aligned"].as_array().unwrap() {
        assert!((determinant(aligned) - 1.0).abs() < 1e-9, "rigid keeps the size: {aligned}");
        assert!(aligned["residual"].as_f64().unwrap() > 0.1, "sizes differ: {aligned}");
    }
}

#[test]
fn procrustes_in_space_recovers_a_rotation_as_similarity_and_rigid() {
    let server = shared();
    let (s, c) = 1.1_f64.sin_cos();
    let shape = knot(9, 1);
    let turned: Vec<[f64; 3]> = shape
        .iter()
        .map(|[x, y, z]| {
            let [x, y] = [c * x - s * y, s * x + c * y];
            [x + 3.0, c * y - s * z - 1.0, s * y + c * z]
        })
        .collect();
    let larger: Vec<[f64; 3]> = turned.iter().map(|p| p.map(|v| 2.0 * v)).collect();
    let representation = json!({"kind": "closed_curve", "dimension": 3, "control_points": 9, "generator": {"name": "trigonometric"}});
    for (class, other) in [("rigid", turned), ("similarity", larger)] {
        let body = json!({"representation": representation, "transformation": class, "alignment": "procrustes",
            "shapes": [{"points": shape}, {"points": other}]});
        let answer = server.post("/v1/align", &body).expect(200);
        for aligned in answer["aligned"].as_array().unwrap() {
            assert!(aligned["residual"].as_f64().unwrap() < 1e-9, "{class}: {aligned}");
            assert_eq!(flat(&aligned["matrix"]).len(), 9);
            assert_eq!(flat(&aligned["offset"]).len(), 3);
        }
    }
}

#[test]
fn landmarks_are_compared_in_the_discrete_metric() {
    let server = shared();
    let (reference, query) = (blob(6, 1), blob(6, 2));
    let body = json!({"representation": {"kind": "landmarks", "dimension": 2, "points": 6},
        "transformation": "uniform_scaling",
        "reference": {"points": reference}, "shapes": [{"points": query}]});
    let answer = server.post("/v1/project", &body).expect(200);
    let (r, q) = (reference.as_flattened(), query.as_flattened());
    let factor = dot(q, r) / dot(r, r);
    let found = &answer["results"][0];
    assert_close(&found["matrix"], &json!([[factor, 0.0], [0.0, factor]]), 1e-12, "matrix");
    let squared = q.iter().zip(r).map(|(q, r)| (q - factor * r).powi(2)).sum::<f64>() / 6.0;
    assert_close(&found["squared_distance"], &json!(squared), 1e-12, "1/N times the sum");
    // Two landmarks are the fewest.
    let body = json!({"representation": {"kind": "landmarks", "dimension": 3, "points": 2},
        "transformation": "uniform_scaling_translation", "shapes": [
            {"points": [[0, 0, 0], [1, 2, 3]]}, {"points": [[1, 1, 1], [3, 5, 7.5]]}]});
    assert_eq!(server.post("/v1/mean", &body).expect(200)["shape_count"], 2);
}

#[test]
fn a_mirror_image_matches_only_when_mirrors_are_allowed() {
    let server = shared();
    let shape = blob(10, 1);
    let mirrored = transformed(&shape, [[-1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]);
    let mut body = json!({"representation": trigonometric(10), "transformation": "similarity",
        "mirror": "allow", "shapes": shapes_of([shape.clone(), shape, mirrored])});
    let answer = server.post("/v1/align", &body).expect(200);
    let reflected: Vec<bool> =
        answer["aligned"].as_array().unwrap().iter().map(|a| a["reflected"].as_bool().unwrap()).collect();
    assert_eq!(reflected, [false, false, true]);
    let residual = |answer: &Value| answer["aligned"][2]["residual"].as_f64().unwrap();
    assert!(residual(&answer) < 1e-9, "{}", residual(&answer));
    assert!(determinant(&answer["aligned"][2]) < 0.0);
    body["mirror"] = json!("forbid");
    assert!(residual(&server.post("/v1/align", &body).expect(200)) > 0.01);
}

#[test]
fn a_contour_that_runs_backwards_matches_when_the_direction_has_no_meaning() {
    let server = shared();
    let forwards = blob(120, 1);
    let mut backwards = forwards.clone();
    backwards.reverse();
    let mut body = json!({"representation": trigonometric(24), "correspondence": "cyclic",
        "direction": "either", "transformation": "similarity",
        "shapes": shapes_of([forwards.clone(), forwards, backwards])});
    let residuals = |body: &Value| -> Vec<f64> {
        let answer = server.post("/v1/align", body).expect(200);
        answer["aligned"].as_array().unwrap().iter().map(|a| a["residual"].as_f64().unwrap()).collect()
    };
    for residual in residuals(&body) {
        assert!(residual < 1e-9, "{residual}");
    }
    body["direction"] = json!("given");
    assert!(residuals(&body)[2] > 0.01);
}

#[test]
fn raw_contours_of_different_lengths_are_resampled() {
    let server = shared();
    for correspondence in ["arc_length", "cyclic"] {
        let contours = [4, 50, 333, 3].map(|count| blob(count, 2));
        let body = json!({"representation": trigonometric(16), "correspondence": correspondence,
            "transformation": "affine", "shapes": shapes_of(contours[..3].to_vec())});
        let answer = server.post("/v1/align", &body).expect(200);
        assert_eq!(answer["shape_count"], 3);
        for aligned in answer["aligned"].as_array().unwrap() {
            assert_eq!(aligned["control_points"].as_array().unwrap().len(), 16);
        }
        // Three points are a contour.
        let body = json!({"representation": trigonometric(16), "correspondence": correspondence,
            "transformation": "similarity", "shapes": shapes_of([contours[3].clone(), contours[1].clone()])});
        server.post("/v1/mean", &body).expect(200);
        // Vertices on the edges of a polygon are not seen, nor a last point equal to the first.
        let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]];
        let with_more =
            [square[0], [1.0, 0.0], [3.5, 0.0], square[1], square[2], [0.5, 2.0], square[3], square[0]];
        let body = json!({"representation": trigonometric(16), "correspondence": correspondence,
            "transformation": "translation", "reference": {"points": square}, "shapes": [{"points": with_more}]});
        let answer = server.post("/v1/project", &body).expect(200);
        let distance = answer["results"][0]["squared_distance"].as_f64().unwrap();
        assert!(distance < 1e-24, "{correspondence}: {distance}");
    }
}

#[test]
fn the_mean_of_cells_depends_neither_on_their_order_nor_on_start_points_nor_on_threads() {
    let cells = cells();
    assert!(cells.len() > 100);
    let body = |shapes: &[Value]| {
        json!({"representation": trigonometric(50), "correspondence": "cyclic",
            "transformation": "similarity", "shapes": shapes})
    };
    let bare: Vec<Value> = cells.iter().map(|cell| json!({"points": cell["points"]})).collect();
    let servers = ["1", "2"].map(|threads| Setting::fresh().environment("SHAPELEX_THREADS", threads).start());
    let answers = servers.each_ref().map(|server| server.post("/v1/mean", &body(&bare)));
    let mean = answers[0].expect(200);
    answers[1].expect(200);
    assert!(answers[0].body == answers[1].body, "one thread and two give other bytes");
    assert_eq!(mean["converged"], true, "{:?}", mean["warnings"]);

    // Order: a fixed shuffle. Start points: every outline begins elsewhere.
    let mut shuffled: Vec<(usize, Value)> = bare.into_iter().enumerate().collect();
    shuffled.sort_by_key(|(k, _)| (k * 7919) % 1009);
    let moved: Vec<Value> = shuffled
        .into_iter()
        .map(|(k, cell)| {
            let mut points = cell["points"].as_array().unwrap().clone();
            let start = (17 * k + 5) % points.len();
            points.rotate_left(start);
            json!({ "points": points })
        })
        .collect();
    let other = servers[1].post("/v1/mean", &body(&moved)).expect(200);
    assert_close(&other["mean"]["control_points"], &mean["mean"]["control_points"], 1e-9, "mean");
    assert_close(&other["eigenvalues"], &mean["eigenvalues"], 1e-9, "eigenvalues");
    assert_close(&other["objective"], &mean["objective"], 1e-9, "objective");
}

#[test]
fn weights_count_as_repetitions() {
    let server = shared();
    let shapes = shapes_of((1..4).map(|seed| blob(8, seed)));
    let mut weighted = shapes.clone();
    weighted[1]["weight"] = json!(3);
    let repeated = [&shapes[..], &[shapes[1].clone(), shapes[1].clone()]].concat();
    let mean = |shapes: &[Value]| {
        let body = json!({"representation": trigonometric(8), "transformation": "affine", "shapes": shapes});
        server.post("/v1/mean", &body).expect(200)
    };
    let (weighted, repeated) = (mean(&weighted), mean(&repeated));
    let points = |mean: &Value| mean["mean"]["control_points"].clone();
    assert_close(&points(&weighted), &points(&repeated), 1e-9, "mean");
    assert_close(&weighted["eigenvalues"], &repeated["eigenvalues"], 1e-9, "eigenvalues");
}

// ---------------------------------------------------------------- curves

#[test]
fn a_circle_of_three_points_is_evaluated_with_its_derivatives() {
    let server = shared();
    let body = json!({"representation": trigonometric(3), "shapes": shapes_of([ellipse(3, 2.0, 2.0, [5.0, -1.0])]),
        "parameters": [0.0, 0.1, 0.37, 0.5, 0.999, 1.1, -0.25], "derivatives": 2});
    let answer = server.post("/v1/evaluate", &body).expect(200);
    let evaluation = &answer["evaluations"][0];
    let angles: Vec<f64> = flat(&body["parameters"]).iter().map(|u| TAU * u).collect();
    let points = |f: &dyn Fn(f64) -> [f64; 2]| json!(angles.iter().map(|&t| f(t)).collect::<Vec<_>>());
    assert_close(&evaluation["points"], &points(&|t| [5.0 + 2.0 * t.cos(), 2.0 * t.sin() - 1.0]), 1e-13, "r");
    let first = points(&|t| [-2.0 * TAU * t.sin(), 2.0 * TAU * t.cos()]);
    assert_close(&evaluation["first"], &first, 1e-13, "r'");
    let second = points(&|t| [-2.0 * TAU * TAU * t.cos(), -2.0 * TAU * TAU * t.sin()]);
    assert_close(&evaluation["second"], &second, 1e-13, "r''");

    let body =
        json!({"representation": trigonometric(3), "shapes": shapes_of([ellipse(3, 2.0, 2.0, [0.0, 0.0])])});
    let answer = server.post("/v1/evaluate", &body).expect(200);
    let evaluation = answer["evaluations"][0].as_object().unwrap();
    assert_eq!(evaluation.keys().collect::<Vec<_>>(), ["points"]);
    assert_eq!(evaluation["points"].as_array().unwrap().len(), 100, "the default number of samples");
}

#[test]
fn points_lie_on_the_curve_and_control_points_are_coefficients() {
    let server = shared();
    let points = blob(9, 3);
    for degree in 1..=5 {
        let body = json!({"representation": curve(9, json!({"name": "bspline", "degree": degree})),
            "shapes": [{"points": points}, {"control_points": points}], "samples": 9});
        let answer = server.post("/v1/evaluate", &body).expect(200);
        assert_close(&answer["evaluations"][0]["points"], &json!(points), 1e-12, "through the points");
        let second = flat(&answer["evaluations"][1]["points"]);
        let apart = second.iter().zip(points.as_flattened()).any(|(a, b)| (a - b).abs() > 1e-3);
        assert_eq!(apart, degree > 1, "degree {degree}");
    }
}

#[test]
fn a_circle_has_the_measures_of_a_circle() {
    let server = shared();
    let mut clockwise = ellipse(7, 1.0, 1.0, [2.0, 1.0]);
    clockwise.reverse();
    let eight: Vec<[f64; 2]> =
        (0..24).map(|k| TAU * f64::from(k) / 24.0).map(|t| [2.0 * t.sin(), (2.0 * t).sin()]).collect();
    let rectangle = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
    let body = json!({"representation": trigonometric(3), "length_unit": "mm",
        "shapes": shapes_of([ellipse(3, 1.0, 1.0, [0.0, 0.0])])});
    let answer = server.post("/v1/measure", &body).expect(200);
    assert_eq!(answer["length_unit"], "mm");
    let circle = &answer["results"][0];
    assert_close(&circle["area"], &json!(PI), 1e-13, "area");
    assert_close(&circle["perimeter"], &json!(TAU), 1e-10, "perimeter");
    assert_close(&circle["centroid"], &json!([0.0, 0.0]), 1e-13, "centroid");
    assert_close(&circle["mean_position"], &json!([0.0, 0.0]), 1e-13, "mean position");
    assert_close(&circle["bounding_box"]["min"], &json!([-1.0, -1.0]), 1e-9, "low corner");
    assert_close(&circle["bounding_box"]["max"], &json!([1.0, 1.0]), 1e-9, "high corner");
    assert_eq!(circle["orientation"], "counter_clockwise");
    assert_eq!(circle["self_intersecting"], false);

    let body = json!({"representation": trigonometric(7), "shapes": shapes_of([clockwise])});
    let measures = server.post("/v1/measure", &body).expect(200);
    let measures = &measures["results"][0];
    assert_close(&measures["signed_area"], &json!(-PI), 1e-12, "signed area");
    assert_close(&measures["centroid"], &json!([2.0, 1.0]), 1e-12, "centroid");
    assert_eq!(measures["orientation"], "clockwise");

    let body = json!({"representation": trigonometric(24), "shapes": shapes_of([eight])});
    let measures = server.post("/v1/measure", &body).expect(200);
    let measures = &measures["results"][0];
    assert_eq!(measures["self_intersecting"], true);
    assert_eq!((&measures["orientation"], &measures["centroid"]), (&json!("none"), &Value::Null));

    // A polygon that is longer than high: swapped axes would show.
    let linear = curve(4, json!({"name": "bspline", "degree": 1}));
    let body = json!({"representation": linear, "shapes": [{"points": rectangle}]});
    let measures = server.post("/v1/measure", &body).expect(200);
    let measures = &measures["results"][0];
    assert_close(&measures["area"], &json!(2.0), 1e-13, "area");
    assert_close(&measures["perimeter"], &json!(6.0), 1e-10, "perimeter");
    assert_close(&measures["bounding_box"]["max"], &json!([2.0, 1.0]), 1e-13, "high corner");
    assert_close(&measures["centroid"], &json!([1.0, 0.5]), 1e-13, "centroid");

    let space =
        json!({"kind": "closed_curve", "dimension": 3, "control_points": 9, "generator": {"name": "cubic"}});
    let body = json!({"representation": space, "shapes": [{"points": knot(9, 1)}]});
    let measures = server.post("/v1/measure", &body).expect(200);
    let measures = &measures["results"][0];
    for planar in ["area", "signed_area", "centroid", "orientation", "self_intersecting"] {
        assert_eq!(measures[planar], Value::Null, "{planar}");
    }
    assert_eq!(measures["bounding_box"]["min"].as_array().unwrap().len(), 3);
}

#[test]
fn a_rectangle_is_resampled_at_equal_arc_length() {
    let server = shared();
    let rectangle = [[0, 0], [2, 0], [2, 1], [0, 1]];
    let body =
        json!({"count": 6, "shapes": [{"points": rectangle}, {"points": [[0, 0, 0], [0, 3, 4], [0, 6, 0]]}]});
    let answer = server.post("/v1/resample", &body).expect(200);
    assert_eq!(answer["shapes"][0]["polygon_length"], 6.0);
    let wanted = json!([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]]);
    assert_close(&answer["shapes"][0]["points"], &wanted, 1e-14, "points");
    assert_close(&answer["shapes"][1]["polygon_length"], &json!(16.0), 1e-14, "in space");
    // The canonical start does not depend on where the list begins.
    let mut turned = blob(40, 1);
    let plain = shapes_of([turned.clone()]);
    turned.rotate_left(13);
    let body = |shapes: &[Value]| json!({"count": 10, "start": "canonical", "shapes": shapes});
    let one = server.post("/v1/resample", &body(&plain)).expect(200);
    let other = server.post("/v1/resample", &body(&shapes_of([turned]))).expect(200);
    assert_close(&other["shapes"][0]["points"], &one["shapes"][0]["points"], 1e-9, "canonical start");
}

// ---------------------------------------------------------------- cohorts and shapes

fn new_cohort(server: &Server, name: &str, representation: &Value, correspondence: &str) -> Value {
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201)
}

#[test]
fn a_cohort_is_created_read_listed_and_deleted() {
    let server = Server::fresh();
    let body = json!({"name": "nuclei.2026-a", "representation": trigonometric(12), "correspondence": "cyclic",
        "mirror": "allow", "direction": "either", "length_unit": "um", "description": "nuclei of two lines"});
    let reply = server.post("/v1/cohorts", &body);
    let cohort = reply.expect(201);
    let id = cohort["id"].as_str().unwrap();
    assert!(id.starts_with("coh_"), "{id}");
    assert_eq!(reply.header("location"), Some(format!("/v1/cohorts/{id}").as_str()));
    for (field, value) in body.as_object().unwrap() {
        assert_eq!(&cohort[field], value, "{field}");
    }
    assert_eq!((&cohort["revision"], &cohort["shape_count"]), (&json!(0), &json!(0)));
    assert!(cohort["created_at"].as_str().unwrap().ends_with('Z'), "{cohort}");
    assert_eq!(server.get(&format!("/v1/cohorts/{id}")).expect(200), cohort);
    let by_name = server.get("/v1/cohorts/nuclei.2026-a");
    assert_eq!(by_name.expect(200), cohort);
    server.post("/v1/cohorts", &body).expect_problem(409, "name-taken", &["/name"]);

    let tag = by_name.header("etag").unwrap().to_owned();
    let get = |tag: &str| {
        server.send(server.request(Method::GET, "/v1/cohorts/nuclei.2026-a").header(IF_NONE_MATCH, tag))
    };
    for known in [tag.as_str(), "*", &format!("\"other\", {tag}"), &format!("W/{tag}")] {
        let reply = get(known);
        assert_eq!((reply.status, reply.body.len()), (304, 0), "If-None-Match: {known}");
        assert_eq!(reply.header("etag"), Some(tag.as_str()));
    }
    assert_eq!(get("\"other\"").status, 200);

    assert_eq!(server.delete("/v1/cohorts/nuclei.2026-a").status, 204);
    server.get(&format!("/v1/cohorts/{id}")).expect_problem(404, "not-found", &[]);
    server.delete("/v1/cohorts/nuclei.2026-a").expect_problem(404, "not-found", &[]);
    // The name is free again.
    server.post("/v1/cohorts", &body).expect(201);
}

/// All pages of a list, in order.
fn pages(server: &Server, path: &str, limit: usize) -> Vec<Value> {
    let (mut items, mut cursor) = (Vec::new(), String::new());
    let join = if path.contains('?') { '&' } else { '?' };
    loop {
        let page = server.get(&format!("{path}{join}limit={limit}{cursor}")).expect(200);
        let found = page["items"].as_array().unwrap();
        assert!(found.len() <= limit, "{} items on a page of {limit}", found.len());
        items.extend(found.iter().cloned());
        match page["next"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => return items,
        }
    }
}

#[test]
fn cohorts_are_listed_page_by_page() {
    let server = Server::fresh();
    assert_eq!(server.get("/v1/cohorts").expect(200), json!({"items": [], "next": null}));
    let names: Vec<String> = (0..5).map(|i| format!("cohort-{i}")).collect();
    for name in &names {
        new_cohort(&server, name, &trigonometric(6), "landmarks");
    }
    for limit in [1, 2, 3, 5, 1000] {
        let found = pages(&server, "/v1/cohorts", limit);
        let found: Vec<&str> = found.iter().map(|cohort| cohort["name"].as_str().unwrap()).collect();
        assert_eq!(found, names, "pages of {limit}");
    }
}

#[test]
fn shapes_are_added_found_listed_and_deleted() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &trigonometric(8), "landmarks");
    let shape = |seed: usize| {
        json!({"points": blob(8, seed), "external_id": format!("scan {seed}/ä"), "subject": format!("s{}", seed / 2),
            "label": (["case", "control"][seed % 2]), "labels": {"age": 60 + seed, "site": "Ulm", "left": seed < 2},
            "weight": 1.0 + seed as f64, "metadata": {"free": ["text", null, 1.5]}})
    };
    let answer =
        server.post("/v1/cohorts/blobs/shapes", &json!({"shapes": [shape(0), shape(1)]})).expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(2), &json!(1)));
    let ids: Vec<String> = (0..2).map(|i| answer["results"][i]["id"].as_str().unwrap().to_owned()).collect();
    assert_eq!(answer["results"][1]["external_id"], "scan 1/ä");
    let results = answer["results"].clone();
    assert!(ids.len() == 2 && ids.iter().all(|id| id.starts_with("shp_")), "{ids:?}");

    // One shape a line, with an id, which is ignored, blank lines and Windows line ends.
    let mut third = shape(2);
    let fields = third.as_object_mut().unwrap();
    fields.insert("id".into(), json!("ignored"));
    let text = format!("\n{third}\r\n\r\n{}\n", shape(3));
    let answer = server
        .post_bytes("/v1/cohorts/blobs/shapes", "application/x-ndjson; charset=utf-8", text)
        .expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(2), &json!(2)));

    // A retry of what is there: nothing new, the same ids.
    let retry = server.post("/v1/cohorts/blobs/shapes", &json!({"shapes": [shape(0), shape(1)]})).expect(201);
    assert_eq!((&retry["added"], &retry["revision"], &retry["results"]), (&json!(0), &json!(2), &results));
    // Half of it new: the order of the ids is that of the input.
    let half = server.post("/v1/cohorts/blobs/shapes", &json!({"shapes": [shape(4), shape(1)]})).expect(201);
    assert_eq!(
        (&half["added"], &half["revision"], &half["results"][1]["id"]),
        (&json!(1), &json!(3), &json!(ids[1]))
    );
    // Other content under a known id: nothing is stored, not even the good neighbours.
    let mut other = shape(1);
    other["points"] = json!(blob(8, 77));
    let conflict = server.post("/v1/cohorts/blobs/shapes", &json!({"shapes": [shape(5), other]}));
    let problem = conflict.expect(409);
    assert_eq!(problem["code"], "external-id-conflict");
    assert_eq!(problem["errors"][0]["index"], 1, "{problem}");
    assert_eq!(problem["errors"][0]["pointer"], "/shapes/1/external_id", "{problem}");

    let cohort = server.get("/v1/cohorts/blobs").expect(200);
    assert_eq!((&cohort["revision"], &cohort["shape_count"]), (&json!(3), &json!(5)));

    // One shape, by both of its ids.
    let found = server.get(&format!("/v1/cohorts/blobs/shapes/{}", ids[1])).expect(200);
    let wanted = shape(1);
    for field in ["external_id", "subject", "label", "labels", "weight", "metadata"] {
        assert_eq!(found[field], wanted[field], "{field}");
    }
    assert_eq!(found["id"], ids[1].as_str());
    assert_eq!(found["control_points"], wanted["points"], "bit for bit");
    assert_eq!(server.get("/v1/cohorts/blobs/shapes/scan%201%2F%C3%A4").expect(200), found);

    lists_and_filters(&server);

    assert_eq!(server.delete("/v1/cohorts/blobs/shapes/scan%201%2F%C3%A4").status, 204);
    let path = format!("/v1/cohorts/blobs/shapes/{}", ids[1]);
    server.get(&path).expect_problem(404, "not-found", &[]);
    server.delete(&path).expect_problem(404, "not-found", &[]);
    let cohort = server.get("/v1/cohorts/blobs").expect(200);
    assert_eq!((&cohort["revision"], &cohort["shape_count"]), (&json!(4), &json!(4)));
    // Its external id is free again.
    let again = server.post("/v1/cohorts/blobs/shapes", &json!({"shapes": [shape(1)]})).expect(201);
    assert_eq!((&again["added"], &again["revision"]), (&json!(1), &json!(5)));
}

fn lists_and_filters(server: &Server) {
    let ids = |path: &str, limit: usize| -> Vec<usize> {
        let items = pages(server, path, limit);
        let seed = |item: &Value| {
            let id = item["external_id"].as_str().unwrap().trim_start_matches("scan ");
            id.trim_end_matches("/ä").parse().unwrap()
        };
        items.iter().map(seed).collect()
    };
    for limit in [1, 2, 4, 1000] {
        assert_eq!(ids("/v1/cohorts/blobs/shapes", limit), [0, 1, 2, 3, 4], "pages of {limit}");
        assert_eq!(ids("/v1/cohorts/blobs/shapes?label=case", limit), [0, 2, 4], "pages of {limit}");
    }
    let cases: [(&str, &[usize]); 7] = [
        ("label=nobody", &[]),
        ("subject=s1", &[2, 3]),
        ("subject=s1&label=control", &[3]),
        ("labels.age=62", &[2]),
        ("labels.left=true", &[0, 1]),
        ("labels.site=Ulm&label=control", &[1, 3]),
        ("labels.age=61&labels.left=false", &[]),
    ];
    for (query, wanted) in cases {
        assert_eq!(ids(&format!("/v1/cohorts/blobs/shapes?{query}"), 3), wanted, "{query}");
    }
}

#[test]
fn the_mean_of_a_cohort_is_the_mean_of_its_shapes() {
    let server = Server::fresh();
    let cells = cells();
    new_cohort(&server, "cells", &trigonometric(40), "cyclic");
    // In three uploads of different kinds.
    let path = "/v1/cohorts/cells/shapes";
    server.post_lines(path, &cells[..50]).expect(201);
    server.post(path, &json!({"shapes": cells[50..57]})).expect(201);
    let answer = server.post_lines(path, &cells[57..]).expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(cells.len() - 57), &json!(3)));

    let direct = |shapes: &[Value], class: &str, frame: &str| {
        let body = json!({"representation": trigonometric(40), "correspondence": "cyclic",
            "transformation": class, "frame": frame, "shapes": shapes});
        server.post("/v1/mean", &body).expect(200)
    };
    let label = cells[0]["label"].as_str().unwrap();
    let of_label: Vec<Value> = cells.iter().filter(|cell| cell["label"] == label).cloned().collect();
    let attribute = cells[0]["labels"]["treatment"].as_str().unwrap();
    let of_attribute: Vec<Value> =
        cells.iter().filter(|cell| cell["labels"]["treatment"] == attribute).cloned().collect();
    assert!(of_label.len() < of_attribute.len() && of_attribute.len() < cells.len());
    let encoded = label.replace('/', "%2F");
    for (query, shapes) in [
        (String::new(), &cells),
        (format!("&label={encoded}"), &of_label),
        (format!("&labels.treatment={attribute}"), &of_attribute),
    ] {
        for (class, frame) in [("similarity", "training"), ("affine", "canonical")] {
            let query = format!("/v1/cohorts/cells/mean?transformation={class}&frame={frame}{query}");
            let mut stored = server.get(&query).expect(200);
            let revision = stored.as_object_mut().unwrap().remove("revision").unwrap();
            assert_eq!(revision, 3);
            assert_eq!(stored.as_object_mut().unwrap().remove("started_from"), Some(Value::Null));
            assert_eq!(stored, direct(shapes, class, frame), "{query}: bit for bit");
        }
    }
    let query = "/v1/cohorts/cells/mean?transformation=rigid&alignment=procrustes";
    assert_eq!(server.get(query).expect(200)["shape_count"], cells.len());
    caching(&server);
}

/// From the shapes as given, a search ends where it always does; from the last search it begins with what that has found.
#[test]
fn the_mean_of_a_growing_cohort_may_start_from_the_last_one() {
    let server = Server::fresh();
    let other = Server::fresh();
    let cells = &cells()[..60];
    for server in [&server, &other] {
        new_cohort(server, "cells", &trigonometric(40), "cyclic");
        server.post("/v1/cohorts/cells/shapes", &json!({"shapes": cells[..58]})).expect(201);
    }
    let path = |alignment: &str, more: &str| {
        format!("/v1/cohorts/cells/mean?transformation=similarity&alignment={alignment}{more}")
    };
    for alignment in ["projection", "procrustes"] {
        let first = server.get(&path(alignment, "&start=last")).expect(200);
        assert_eq!(first["started_from"], Value::Null, "there was none before");
        assert!(first["rounds"].as_u64().unwrap() > 3, "{}", first["rounds"]);
    }
    let again = server.get(&path("projection", "&start=last&frame=canonical")).expect(200);
    assert_eq!(
        (&again["started_from"], &again["rounds"]),
        (&json!(1), &json!(1)),
        "another frame, no new shape"
    );

    let stale = path("projection", "&start=last&stale=true");
    assert_eq!(server.get(&stale).expect(200)["revision"], 1);
    for server in [&server, &other] {
        server.post("/v1/cohorts/cells/shapes", &json!({"shapes": cells[58..]})).expect(201);
    }
    assert_eq!(server.get(&stale).expect(200)["revision"], 1, "the last one computed");
    let renewed = || {
        std::thread::sleep(Duration::from_millis(10));
        server.get(&stale).expect(200)["revision"] == 2
    };
    assert!((0..1000).any(|_| renewed()), "computed in the background");
    for alignment in ["projection", "procrustes"] {
        let warm = server.get(&path(alignment, "&start=last")).expect(200);
        assert_eq!((&warm["revision"], &warm["started_from"]), (&json!(2), &json!(1)), "{alignment}");
        assert_eq!((&warm["shape_count"], &warm["converged"]), (&json!(60), &json!(true)));
        let cold = server.get(&path(alignment, ""));
        assert_eq!(
            cold.body,
            other.get(&path(alignment, "")).body,
            "{alignment}: what was asked before is no part of it"
        );
        let cold = cold.expect(200);
        assert_eq!(cold["started_from"], Value::Null);
        if alignment == "projection" {
            // Another local optimum: the sums of 60 squared cosines differ in the fourth digit.
            let [warm, cold] = [&warm, &cold].map(|mean| mean["objective"].as_f64().unwrap());
            assert!((warm - cold).abs() < 1e-3 * cold, "{warm} {cold}");
        }
    }
    for (name, value) in [("stale", "maybe"), ("start", "first")] {
        let query = path("projection", &format!("&{name}={value}"));
        server.get(&query).expect_problem(400, "invalid-query", &[]);
    }
}

/// A large cohort is searched in stages, of which a service keeps the last but one: means that were asked for before make the next
/// one faster, and leave its bytes as they are. The other service is asked only once.
#[test]
fn the_mean_of_a_large_growing_cohort_does_not_depend_on_what_was_asked_before() {
    let lines: Vec<Value> =
        (0..8400).map(|k| json!({"external_id": format!("s{k}"), "points": blob(10, k)})).collect();
    let path = "/v1/cohorts/many/mean?transformation=similarity";
    let grow = |server: &Server, step: usize| {
        let shapes = "/v1/cohorts/many/shapes";
        match step {
            0 => {
                new_cohort(server, "many", &trigonometric(10), "cyclic");
                server.post_lines(&format!("{shapes}?return=none"), &lines[..8390]).expect(201);
            }
            1 => drop(server.post(shapes, &json!({"shapes": lines[8390..]})).expect(201)),
            // After the leading shapes, then one of them, a weight, and all but as many as there are leading ones.
            2 => assert_eq!(server.delete(&format!("{shapes}/s8395")).status, 204),
            3 => assert_eq!(server.delete(&format!("{shapes}/s17")).status, 204),
            5 => (0..206).for_each(|k| drop(server.delete(&format!("{shapes}/s{}", 8100 + k)))),
            _ => {
                let patch = server.request(Method::PATCH, &format!("{shapes}/s18"));
                let patch =
                    patch.header(CONTENT_TYPE, "application/merge-patch+json").body(r#"{"weight": 40}"#);
                server.send(patch).expect(200);
            }
        }
    };
    let server = Server::fresh();
    for last in 0..6 {
        grow(&server, last);
        let mean = server.get(path);
        assert_eq!(mean.expect(200)["converged"], true);
        let other = Server::fresh();
        (0..=last).for_each(|step| grow(&other, step));
        assert_eq!(mean.body, other.get(path).body, "after step {last}");
        // What depends on the means before is no start of others.
        server.get(&format!("{path}&start=last")).expect(200);
    }
}

fn caching(server: &Server) {
    let path = "/v1/cohorts/cells/mean?transformation=similarity";
    let first = server.get(path);
    first.expect(200);
    let tag = first.header("etag").unwrap().to_owned();
    let get = |path: &str| server.send(server.request(Method::GET, path).header(IF_NONE_MATCH, &tag));
    let same = get(path);
    assert_eq!((same.status, same.body.len()), (304, 0));
    assert_eq!(same.header("etag"), Some(tag.as_str()));
    assert_eq!(get("/v1/cohorts/cells/mean?transformation=affine").status, 200, "another class");
    assert_eq!(get(&format!("{path}&frame=canonical")).status, 200, "another frame");
    assert_eq!(get(&format!("{path}&labels.cell_line=dlm8")).status, 200, "another filter");
    // Asked for again without a tag: the same bytes.
    assert_eq!(server.get(path).body, first.body);
    server.post("/v1/cohorts/cells/shapes", &json!({"shapes": shapes_of([blob(60, 1)])})).expect(201);
    let changed = get(path);
    let mean = changed.expect(200);
    assert_eq!(mean["revision"], 4);
    assert_ne!(changed.header("etag"), Some(tag.as_str()));
    let id = server.get("/v1/cohorts/cells/shapes?limit=1").expect(200)["items"][0]["id"].clone();
    assert_eq!(server.delete(&format!("/v1/cohorts/cells/shapes/{}", id.as_str().unwrap())).status, 204);
    let after = get(path).expect(200);
    assert_eq!(
        (&after["revision"], &after["shape_count"]),
        (&json!(5), &mean["shape_count"].as_u64().map(|n| n - 1).into())
    );
}

#[test]
fn the_example_cohort_is_there_and_only_in_an_empty_store() {
    let server = Setting::fresh().with_example().start();
    let cohort = server.get("/v1/cohorts/example-cells").expect(200);
    assert_eq!(cohort["shape_count"], cells().len());
    let mean = server.get("/v1/cohorts/example-cells/mean?transformation=similarity").expect(200);
    assert_eq!((&mean["shape_count"], &mean["unique"]), (&json!(cells().len()), &json!(true)));
    assert_eq!(server.delete("/v1/cohorts/example-cells").status, 204);
    new_cohort(&server, "own", &trigonometric(6), "landmarks");
    let server = server.kill().with_example().start();
    let names = pages(&server, "/v1/cohorts", 10);
    assert_eq!(names.len(), 1, "{names:?}");
}

// ---------------------------------------------------------------- drawings

#[test]
fn shapes_means_modes_and_curves_are_drawn() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &trigonometric(12), "landmarks");
    let shapes: Vec<Value> = (1..6)
        .map(|seed| json!({"points": blob(12, seed), "external_id": format!("<b> & {seed}"), "label": "x"}))
        .collect();
    server.post("/v1/cohorts/blobs/shapes", &json!({ "shapes": shapes })).expect(201);
    let body = json!({"representation": trigonometric(12), "transformation": "similarity", "shapes": shapes});
    let curves = json!({"representation": trigonometric(12), "shapes": shapes});
    let shape = "/v1/cohorts/blobs/shapes/%3Cb%3E%20&%201";
    let requests: [(Method, &str, Option<&Value>); 7] = [
        (Method::GET, shape, None),
        (Method::GET, "/v1/cohorts/blobs/mean?transformation=affine", None),
        (Method::POST, "/v1/mean", Some(&body)),
        (Method::POST, "/v1/align", Some(&body)),
        (Method::POST, "/v1/pca", Some(&body)),
        (Method::POST, "/v1/pca?component=2&sigma=1.5", Some(&body)),
        (Method::POST, "/v1/evaluate", Some(&curves)),
    ];
    for (method, path, body) in requests {
        let request = |path: &str| {
            let request = server.request(method.clone(), path);
            match body {
                Some(body) => request.json(body),
                None => request,
            }
        };
        let accepted = server.send(request(path).header(ACCEPT, "image/svg+xml"));
        let svg = accepted.expect_svg();
        assert!(svg.contains("<path d=\"M"), "{path}: no line");
        assert!(!svg.contains("<b>"), "{path}: text of a client unescaped");
        let join = if path.contains('?') { '&' } else { '?' };
        let asked =
            server.send(request(&format!("{path}{join}format=svg")).header(ACCEPT, "application/json"));
        assert_eq!(asked.expect_svg(), svg, "{path}: by the query, over the header");
        let plain = server.send(request(&format!("{path}{join}format=json")).header(ACCEPT, "image/svg+xml"));
        assert_eq!((plain.status, plain.header("content-type")), (200, Some("application/json")), "{path}");
    }
    let drawn = server.get("/v1/cohorts/blobs/mean?transformation=affine&format=svg");
    assert_eq!(drawn.expect_svg().matches("<path").count(), 8, "five shapes, their mean, and the legend");
    let numbers = server.get("/v1/cohorts/blobs/mean?transformation=affine");
    assert_ne!(drawn.header("etag"), numbers.header("etag"), "two representations of one thing");

    let space = json!({"kind": "landmarks", "dimension": 3, "points": 9});
    let body = json!({"representation": space, "transformation": "affine",
        "shapes": [{"points": knot(9, 1)}, {"points": knot(9, 2)}]});
    let drawn = server.post("/v1/align?format=svg", &body);
    assert_eq!(
        drawn.expect_svg().matches("<circle").count(),
        29,
        "landmarks are dots, also of space and in the legend"
    );
}

// ---------------------------------------------------------------- HTTP

#[test]
fn probes_documents_and_other_methods() {
    let server = shared();
    for probe in ["/livez", "/readyz"] {
        let reply = server.get(probe);
        assert_eq!((reply.status, reply.body.len()), (204, 0), "{probe}");
    }
    let head = server.send(server.request(Method::HEAD, "/v1/generators"));
    assert_eq!((head.status, head.header("content-type")), (200, Some("application/json")));
    let options = server.send(server.request(Method::OPTIONS, "/v1/mean"));
    assert_eq!(options.expect(405)["code"], "method-not-allowed");
    assert_eq!(options.header("allow"), Some("POST"));
    // The id that a caller gives is kept.
    let request = server.request(Method::GET, "/v1/nothing").header("x-request-id", "caller-17");
    let reply = server.send(request);
    assert_eq!(reply.header("x-request-id"), Some("caller-17"));
    assert_eq!(reply.json()["request_id"], "caller-17");

    let document = server.get("/openapi.json").expect(200);
    assert_eq!(document["openapi"].as_str().map(|v| &v[..2]), Some("3."));
    assert!(document["paths"]["/v1/mean"]["post"].is_object());
}

#[test]
fn bodies_may_be_compressed_both_ways() {
    let server = Server::fresh();
    let shapes: Vec<Value> = (1..20).map(|seed| json!({"points": blob(12, seed)})).collect();
    let body = json!({"representation": trigonometric(12), "transformation": "similarity", "shapes": shapes});
    let plain = server.post("/v1/align", &body);
    plain.expect(200);
    let text = body.to_string();
    let request = || {
        let request = server.request(Method::POST, "/v1/align").header(CONTENT_TYPE, "application/json");
        request.header(CONTENT_ENCODING, "gzip").body(gzip(text.as_bytes()))
    };
    assert_eq!(server.send(request()).body, plain.body);
    let packed = server.send(request().header(ACCEPT_ENCODING, "gzip"));
    assert_eq!(packed.header("content-encoding"), Some("gzip"));
    assert!(packed.body.len() < plain.body.len(), "{} for {}", packed.body.len(), plain.body.len());
    let mut unpacked = Vec::new();
    GzDecoder::new(packed.body.as_slice()).read_to_end(&mut unpacked).unwrap();
    assert_eq!(unpacked, plain.body);

    new_cohort(&server, "packed", &trigonometric(12), "landmarks");
    let lines: Vec<String> = shapes.iter().map(ToString::to_string).collect();
    let request = server.request(Method::POST, "/v1/cohorts/packed/shapes");
    let request = request.header(CONTENT_TYPE, "application/x-ndjson").header(CONTENT_ENCODING, "gzip");
    let answer = server.send(request.body(gzip(lines.join("\n").as_bytes()))).expect(201);
    assert_eq!(answer["added"], shapes.len());

    // A body may have several members, and all of them count; the word is written in any case.
    for (member, coding) in [(1, "gzip"), (7, "GZIP"), (100, "x-gzip")] {
        let parts: Vec<u8> = text.as_bytes().chunks(text.len() / member + 1).flat_map(gzip).collect();
        let request = server.request(Method::POST, "/v1/align").header(CONTENT_TYPE, "application/json");
        assert_eq!(server.send(request.header(CONTENT_ENCODING, coding).body(parts)).body, plain.body);
        let parts: Vec<u8> = lines.iter().flat_map(|line| gzip(format!("{line}\n").as_bytes())).collect();
        for media_type in ["application/x-ndjson", "application/octet-stream"] {
            let (name, path) = (format!("{coding}-{}", &media_type[12..]), "shapes?format=ndjson");
            new_cohort(&server, &name, &trigonometric(12), "landmarks");
            let path = if media_type.ends_with("stream") { path } else { "shapes" };
            let request = server.request(Method::POST, &format!("/v1/cohorts/{name}/{path}"));
            let request = request.header(CONTENT_TYPE, media_type).header(CONTENT_ENCODING, coding);
            assert_eq!(server.send(request.body(parts.clone())).expect(201)["added"], shapes.len(), "{name}");
        }
    }
}

/// The layer that compresses would make a 406 of it when the work is done.
#[test]
fn encodings_that_are_not_offered_are_passed_over() {
    let server = Server::fresh();
    for (name, encodings) in [("none", "identity;q=0, *;q=0"), ("other", "br, identity;q=0")] {
        let request = server.request(Method::POST, "/v1/cohorts").header(ACCEPT_ENCODING, encodings);
        let body = json!({"name": name, "representation": trigonometric(4)});
        let reply = server.send(request.json(&body));
        assert_eq!((reply.status, reply.header("content-encoding")), (201, None), "{encodings}");
        assert_eq!(server.get(&format!("/v1/cohorts/{name}")).expect(200)["name"], name);
    }
}

#[test]
fn nothing_of_a_body_is_logged() {
    let server = Setting::fresh().environment("SHAPELEX_LOG", "debug").start();
    new_cohort(&server, "private", &trigonometric(4), "landmarks");
    let shape = json!({"points": [[123.456789012, 0], [0, 77.000111222], [-1, 0], [0, -1]],
        "external_id": "secret-scan", "subject": "secret-subject", "label": "secret-label",
        "labels": {"secret-key": "secret-value"}, "metadata": {"note": "secret-note"}});
    let mut bad = shape.clone();
    bad["points"][2] = json!([123.456789012, "secret-text"]);
    let path = "/v1/cohorts/private/shapes";
    server.post(path, &json!({ "shapes": [shape] })).expect(201);
    server.post_lines(path, &[shape.clone(), bad.clone()]).expect(422);
    server.post(path, &json!({ "shapes": [bad] })).expect(422);
    let statistics =
        json!({"representation": trigonometric(4), "transformation": "affine", "shapes": [shape, bad]});
    server.post("/v1/mean", &statistics).expect(422);
    server
        .post_bytes(
            "/v1/mean",
            "application/json",
            "{\"shapes\": [{\"label\": \"secret-text\", \"points\": [[123.456789012",
        )
        .expect(400);
    server.get(&format!("{path}?label=secret-label&labels.secret-key=secret-value")).expect(200);
    server.get(&format!("{path}/secret-scan")).expect(200);
    server.get("/v1/cohorts/private/mean?transformation=affine&subject=secret-subject").expect(422);
    server.get(&format!("{path}/secret-other")).expect(404);
    let log = server.log();
    assert!(log.contains("/v1/cohorts/{cohort}/shapes"), "requests are logged at all:\n{log}");
    for word in ["123.456", "77.000", "secret"] {
        let line = log.lines().find(|line| line.contains(word));
        assert_eq!(line, None, "{word} is in the log");
    }
}
