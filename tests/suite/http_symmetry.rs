//! Symmetry of stored landmarks and curves, of left and right shapes, and of a posted curve; refusals.

use std::path::Path;

use serde_json::{Value, json};

use crate::server::{Server, Setting};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number, got {value}"))
}

fn noise(i: usize, k: usize) -> f64 {
    ((13 * i * i + 7 * k * k + 3 * i * k + 5) as f64).sin()
}

/// Three pairs and a point of the midline, turned; `bend` moves the first point alone.
fn face(k: usize, bend: f64, error: f64) -> Value {
    let (sine, cosine) = (k as f64).sin_cos();
    let half = [[1.0, 0.0], [1.5, 1.0], [0.5, 2.0]];
    let mut points: Vec<[f64; 2]> = half
        .iter()
        .enumerate()
        .flat_map(|(i, [x, y])| {
            let own = 0.1 * noise(i, k / 2);
            [[-x - own, y + own], [x + own, y + own]]
        })
        .chain([[0.0, -0.5]])
        .collect();
    points[0][0] -= bend;
    for (i, point) in points.iter_mut().enumerate() {
        point[0] += error * noise(i + 30, k);
        point[1] += error * noise(i + 60, k);
    }
    json!(points.iter().map(|[x, y]| [cosine * x - sine * y, sine * x + cosine * y]).collect::<Vec<_>>())
}

const PAIRS: [[usize; 2]; 3] = [[0, 1], [2, 3], [4, 5]];

/// Eight faces measured twice, and six individuals with left and right sides measured twice, the right ones as seen.
fn made(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 7});
    for name in ["faces", "ears"] {
        server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
    }
    let faces: Vec<Value> = (0..16)
        .map(|k| {
            json!({"external_id": format!("f{k}"), "subject": format!("p{}", k / 2), "points": face(k, 0.3, 0.01),
                "labels": {"take": k % 2, "one": "a"}})
        })
        .collect();
    server.post("/v1/cohorts/faces/shapes", &json!({"shapes": faces})).expect(201);
    let ears: Vec<Value> = (0..24)
        .map(|k| {
            let (individual, right, take) = (k / 4, k / 2 % 2 == 1, k % 2);
            let points = face(2 * individual, if right { 0.0 } else { 0.4 }, 0.0);
            // A right shape as it was seen is the mirror image of a left one.
            let seen = |(i, point): (usize, &Value)| {
                let moved = 0.01 * noise(i, k);
                let x = number(&point[0]) + moved;
                [if right { -x } else { x }, number(&point[1]) - moved]
            };
            let points: Vec<[f64; 2]> = points.as_array().unwrap().iter().enumerate().map(seen).collect();
            json!({"external_id": format!("e{k}"), "subject": format!("p{individual}"), "points": points,
                "labels": {"side": if right { "right" } else { "left" }, "take": take}})
        })
        .collect();
    server.post("/v1/cohorts/ears/shapes", &json!({"shapes": ears})).expect(201);
}

#[test]
fn faces_that_are_bent_have_directional_asymmetry_where_they_are_bent() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "faces", "kind": "object", "pairs": PAIRS, "individual": "subject",
        "replicate": "labels.take", "permutations": 999, "maps": true});
    let found = server.post("/v1/symmetry", &body).expect(200);
    let terms = found["terms"].as_array().unwrap();
    let names: Vec<&str> = terms.iter().map(|term| term["term"].as_str().unwrap()).collect();
    assert_eq!(names, ["individual", "side", "individual:side"]);
    // Three pairs and one point: five symmetric and five asymmetric dimensions.
    let degrees: Vec<_> = terms.iter().map(|term| (&term["df"], &term["df_shape"])).collect();
    let wanted = [(json!(7), json!(35)), (json!(1), json!(5)), (json!(7), json!(35))];
    assert!(
        degrees.iter().zip(&wanted).all(|(found, wanted)| (found.0, found.1) == (&wanted.0, &wanted.1)),
        "{found}"
    );
    assert_eq!((&found["residual"]["df"], &found["residual_df_shape"]), (&json!(16), &json!(80)));
    // The flips of eight individuals are 256.
    assert_eq!((&terms[1]["exact"], &terms[1]["permutations"]), (&json!(true), &json!(255)));
    assert!(number(&terms[1]["p"]) < 0.01 && number(&terms[1]["f"]) > 50.0, "{found}");
    assert!(number(&terms[2]["p"]) > 0.01, "the bend is the same for all: {found}");
    let warned = |found: &Value| found["warnings"].to_string().contains("11 % of null sets");
    assert!(warned(&found), "{found}");
    let map: Vec<f64> =
        found["map"].as_array().unwrap().iter().map(|point| number(&point["directional"])).collect();
    let largest = map.iter().copied().fold(0.0, f64::max);
    assert!(map[0] == largest || map[1] == largest, "{map:?}");
    assert!(number(&found["plane"]["asymmetry"]) < 1e-12 && found["plane"]["axis_degrees"].is_f64());
    let first = &found["individuals"][0];
    assert_eq!((&first["individual"], first["map"].as_array().unwrap().len()), (&json!("p0"), 7));
    assert!(number(&first["unsigned_corrected"]) <= number(&first["unsigned"]), "{first}");
    let reply = server.post("/v1/symmetry?format=svg", &body);
    let picture = reply.expect_svg();
    assert!(
        picture.contains("directional asymmetry: 0 to") && picture.contains("side (directional): df 1"),
        "{picture}"
    );
    // Without individuals each shape is one, and nothing tests the interaction.
    let plain = json!({"cohort": "faces", "kind": "object", "pairs": PAIRS, "permutations": 99});
    let plain = server.post("/v1/symmetry", &plain).expect(200);
    assert_eq!((&plain["residual"], &plain["terms"][2]["p"]), (&Value::Null, &Value::Null));
    assert_eq!(plain["individuals"].as_array().unwrap().len(), 16);
}

#[test]
fn right_ears_are_mirrored() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "ears", "kind": "matching", "side": "labels.side", "permutations": 99});
    let found = server.post("/v1/symmetry", &body).expect(200);
    assert_eq!((&found["sides"], &found["plane"]), (&json!(["left", "right"]), &Value::Null));
    assert!(!found["warnings"].to_string().contains("null sets"), "{found}");
    let terms = &found["terms"];
    // 14 numbers of seven points without four of similarity.
    assert_eq!((&terms[0]["df_shape"], &terms[1]["df_shape"]), (&json!(50), &json!(10)));
    assert!(number(&terms[1]["f"]) > 20.0 && number(&terms[1]["p"]) <= 0.05, "{found}");
    assert!(number(&found["individuals"][0]["signed"]) > 0.0, "{found}");
    // Left and right turned round: the same lengths, and the other direction.
    let mut turned = body.clone();
    turned["left"] = json!("right");
    let turned = server.post("/v1/symmetry", &turned).expect(200);
    let norm = |of: &Value| number(&of["directional"]["norm"]);
    assert_eq!(turned["sides"], json!(["right", "left"]));
    assert!((norm(&turned) - norm(&found)).abs() < 1e-6 * norm(&found), "{turned}");
    // Not mirrored again: left ears beside right ones as they were seen differ far more.
    let mut seen = body.clone();
    seen["mirrored"] = json!(true);
    assert!(norm(&server.post("/v1/symmetry", &seen).expect(200)) > 3.0 * norm(&found));
}

#[test]
fn curves_are_their_own_images() {
    let server = Setting::fresh().with_example().start();
    let body = json!({"cohort": "example-cells", "kind": "object", "permutations": 19, "samples": 40});
    let found = server.post("/v1/symmetry", &body).expect(200);
    assert_eq!(found["map"].as_array().unwrap().len(), 40);
    assert!(number(&found["plane"]["asymmetry"]) < 1e-9, "the mean of shapes and images: {}", found["plane"]);
    let reply = server.post("/v1/symmetry?format=svg", &body);
    assert!(reply.expect_svg().contains("fluctuating asymmetry"));
}

#[test]
fn the_plane_of_a_curve_needs_no_markings() {
    let server = crate::server::shared();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/vectors/models/symmetry.json");
    let vectors: Value = serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    let curve = &vectors["noisy_curve"];
    let points = curve["points"].as_array().unwrap();
    let found = server.post("/v1/symmetry", &json!({"shape": {"points": points}, "count": 256})).expect(200);
    let best = &found["planes"][0];
    // Points of equal arc length on the polygon, not those of the vector.
    let wanted = number(&curve["result"]["axis_degrees"]);
    assert!((number(&best["axis_degrees"]) - wanted).abs() < 0.5, "{found}");
    assert!(number(&best["asymmetry"]) < 0.03 && found["count"] == 256, "{found}");
    // Another start, the other direction: the same axis to what a shift of the samples does.
    let mut turned = points.clone();
    turned.rotate_left(11);
    turned.reverse();
    let other = server.post("/v1/symmetry", &json!({"shape": {"points": turned}, "count": 256})).expect(200);
    assert!(
        (number(&other["planes"][0]["axis_degrees"]) - number(&best["axis_degrees"])).abs() < 0.5,
        "{other}"
    );
    let square = json!({"shape": {"points": [[1, 1], [-1, 1], [-1, -1], [1, -1]]}, "count": 64});
    let found = server.post("/v1/symmetry", &square).expect(200);
    let mut axes: Vec<f64> =
        found["planes"].as_array().unwrap().iter().map(|plane| number(&plane["axis_degrees"])).collect();
    axes.sort_by(f64::total_cmp);
    assert_eq!(axes.iter().map(|axis| axis.round()).collect::<Vec<_>>(), [0.0, 45.0, 90.0, 135.0]);
    assert!((number(&found["polygon_length"]) - 8.0).abs() < 1e-12);
    let reply = server.post("/v1/symmetry?format=svg", &square);
    assert!(reply.expect_svg().contains("axis at 45"));
}

#[test]
fn copies_of_a_symmetric_shape_have_no_asymmetry() {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 7});
    server.post("/v1/cohorts", &json!({"name": "copies", "representation": representation})).expect(201);
    let points = [[-1, 0], [1, 0], [-2, 1], [2, 1], [-1, 2], [1, 2], [0, -1]];
    let copies: Vec<Value> = (0..6).map(|_| json!({"points": points})).collect();
    server.post("/v1/cohorts/copies/shapes", &json!({"shapes": copies})).expect(201);
    let body = json!({"cohort": "copies", "kind": "object", "pairs": PAIRS, "permutations": 9});
    let found = server.post("/v1/symmetry", &body).expect(200);
    for row in found["terms"].as_array().unwrap() {
        let shares = [&row["r_squared"], &row["partial_eta_squared"]].map(number);
        assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{row}");
    }
}

#[test]
fn what_has_no_sides_is_refused_at_its_place() {
    let server = Server::fresh();
    made(&server);
    let refused = |body: Value, pointer: &str, said: &str| {
        let problem = server.post("/v1/symmetry", &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{body}: {problem}"
        );
    };
    let object =
        |pairs: Value| json!({"cohort": "faces", "kind": "object", "pairs": pairs, "permutations": 9});
    refused(object(json!([])), "/pairs", "at least one pair");
    refused(object(json!([[0, 1], [2, 7]])), "/pairs/1", "different points below 7, got [2, 7]");
    refused(object(json!([[0, 1], [1, 2]])), "/pairs/1", "got [1, 2]");
    let with = |body: Value, name: &str, value: Value| {
        let mut body = body;
        body[name] = value;
        body
    };
    let faces = || object(json!(PAIRS));
    refused(with(faces(), "side", json!("labels.take")), "/side", "matching symmetry only");
    refused(with(faces(), "replicate", json!("labels.take")), "/replicate", "with individual only");
    refused(with(faces(), "individual", json!("labels.one")), "/filter", "at least 3 individuals, got 1");
    refused(with(faces(), "strata", json!("subject")), "/strata", "expected no strata");
    refused(with(faces(), "mirror", json!("allow")), "/mirror", "turned back");
    let twice = with(with(faces(), "individual", json!("subject")), "replicate", json!("labels.one"));
    refused(twice, "/replicate", "got 'a' twice of 'p0'");
    let ears = || json!({"cohort": "ears", "kind": "matching", "side": "labels.side", "permutations": 9});
    refused(json!({"cohort": "ears", "kind": "matching"}), "/side", "tells left from right");
    refused(with(ears(), "left", json!("up")), "/left", "'left' or 'right', got 'up'");
    refused(with(ears(), "pairs", json!([[0, 1]])), "/pairs", "object symmetry only");
    refused(with(ears(), "side", json!("subject")), "/side", "two values");
    let filter = json!({"external_id": "e0"});
    let problem = server.post("/v1/symmetry", &with(ears(), "filter", filter));
    assert!(problem.status == 422, "{}", problem.text());
    refused(json!({"shape": {"points": [[0, 0], [1, 0], [0, 1]]}, "count": 7}), "/count", "between 8");
    refused(json!({"shape": {"points": [[0, 0], [0, 0], [0, 0]]}}), "/shape/points", "");
    refused(
        json!({"shape": {"points": [[0, 0], [1, 0], [0, 1]]}, "kind": "object"}),
        "/kind",
        "one of the fields shape, count",
    );
}
