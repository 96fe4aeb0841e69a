//! Results beside their starts and beside each other: shapes that leave their object are told, and boxes are kept to.

use serde_json::{Value, json};
use shapelex_formats::image::LengthUnit;
use shapelex_formats::image::write::{nifti_f32, png_u8};

use crate::form::post_image;
use crate::http_segment::{PATH, PLANE, ball, bright, curves, grid, number, values};
use crate::http_segment_cohort::{post as post_to_cohort, with_cohort};
use crate::http_segment_jobs::{ASYNC, ended, post};
use crate::server::shared;

/// Two discs of radius 7 that touch, around (20, 20) and (34, 20).
fn discs() -> Vec<u8> {
    let inside = |[x, y, _]: [f64; 3], cx: f64| (x - cx).hypot(y - 20.0) <= 7.2;
    let value = |cell| if inside(cell, 20.0) || inside(cell, 34.0) { 200_u8 } else { 40 };
    png_u8(&grid(PLANE, [1.0; 3], LengthUnit::Unknown), &values(PLANE, value)).unwrap()
}

/// A box around the left disc.
fn left_disc(further: Value) -> Value {
    let mut body = curves(json!({"boxes": [{"lower": [13, 13], "upper": [27, 27]}], "coordinates": "index"}));
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    body
}

/// An image of one bright band, which has no edges at the left and at the right of a box in it.
fn band() -> Vec<u8> {
    let value = |[_, y, _]: [f64; 3]| if (y - 20.0).abs() < 7.0 { 200_u8 } else { 40 };
    png_u8(&grid(PLANE, [1.0; 3], LengthUnit::Unknown), &values(PLANE, value)).unwrap()
}

/// Size, centre and containment against those of an ellipse and of the answered control points.
#[test]
fn results_are_told_beside_their_starts() {
    let found = post_image(&shared(), PATH, &curves(json!({})), &bright()).expect(200);
    let representation = curves(json!({}))["representation"].clone();
    for (index, [lower, upper]) in
        [[[8.0, 15.0], [25.0, 26.0]], [[40.0, 10.0], [53.0, 27.0]]].iter().enumerate()
    {
        let result = &found["results"][index];
        let moved = &result["moved"];
        let area = 0.25 * std::f64::consts::PI * (upper[0] - lower[0]) * (upper[1] - lower[1]);
        // The area of an exact ellipse, by quadrature that is exact for its trigonometric curve.
        assert!((number(&moved["start"]["size"]) / area - 1.0).abs() < 1e-9, "{moved}, expected {area}");
        for c in 0..2 {
            let centre = 0.5 * (lower[c] + upper[c]);
            assert!(
                (number(&moved["start"]["centre"][c]) - centre).abs() < 1e-9,
                "{moved}, expected {centre}"
            );
        }
        let shapes = json!([{"control_points": result["control_points"]}]);
        let measured =
            shared().post("/v1/measure", &json!({"representation": representation, "shapes": shapes}));
        let measured = measured.expect(200)["results"][0].clone();
        let expected = number(&measured["area"]);
        // 64 samples of a curve that is smooth within its spans: 5e-6 of its area.
        assert!(
            (number(&moved["result"]["size"]) / expected - 1.0).abs() < 2e-5,
            "{moved}, expected {expected}"
        );
        let ratio = number(&moved["result"]["size"]) / number(&moved["start"]["size"]);
        assert!((number(&moved["size_ratio"]) - ratio).abs() < 1e-12, "{moved}");
        assert_eq!((&moved["contains_centre"], &result["stop"] == "left_object"), (&json!(true), false));
        assert!(number(&moved["shared"]) > 0.9, "{moved}");
    }
}

/// A band has edges above and below only. Along it a shape that may leave its box grows until something stops it; one that is kept to
/// its box stays.
#[test]
fn shapes_that_leave_their_object_are_told_and_boxes_are_kept_to() {
    let server = shared();
    let body = |further| {
        let mut body =
            left_disc(json!({"terms": [{"name": "contour"}, {"name": "spacing", "weight": 0.05}]}));
        body.as_object_mut()
            .unwrap()
            .extend(json!({"boxes": [{"lower": [24, 14], "upper": [38, 26]}]}).as_object().unwrap().clone());
        body.as_object_mut().unwrap().extend(Value::as_object(&further).unwrap().clone());
        body
    };
    let free = post_image(&server, PATH, &body(json!({"leave_box": true})), &band()).expect(200);
    let free = &free["results"][0];
    assert!(number(&free["moved"]["size_ratio"]) > 2.0, "{}", free["moved"]);
    assert_eq!((&free["stop"], &free["converged"]), (&json!("left_object"), &json!(false)));
    assert!(free["warnings"].to_string().contains("left its object"), "{}", free["warnings"]);
    assert!(free["energies"].get("box").is_none());
    let kept = post_image(&server, PATH, &body(json!({})), &band()).expect(200);
    let kept = &kept["results"][0];
    // Half of the box is 7 × 6; the wall begins at 1.5 times, and gives way by a few per cent.
    let xs = kept["control_points"].as_array().unwrap().iter().map(|point| number(&point[0]));
    let reach = xs.map(|x| (x - 31.0).abs()).fold(0.0, f64::max);
    assert!(reach < 1.7 * 7.0, "{reach}");
    assert!(number(&kept["energies"]["box"]["value"]) >= 0.0, "{}", kept["energies"]);
    // A factor of sizes that the request states.
    let strict = post_image(&server, PATH, &body(json!({"size_factor": 1.01})), &band()).expect(200);
    assert_eq!(strict["results"][0]["stop"], "left_object", "{}", strict["results"][0]["moved"]);
}

/// The same for surfaces and meshes, by the threshold that everything is above.
#[test]
fn bodies_that_leave_their_object_are_told() {
    let [image, _] = ball();
    let trigonometric = json!({"name": "trigonometric"});
    for representation in [
        json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]}),
        json!({"kind": "surface", "topology": "cylinder", "control_points": [6, 4], "generators": [trigonometric, {"name": "cubic"}]}),
        json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron/1", "level": 3}),
    ] {
        let body = |leaves: bool| {
            json!({
                "representation": representation, "terms": [{"name": "threshold", "theta": 0.6}, {"name": "spacing", "weight": 0.1}],
                "stages": [{"free": "affine", "sigma": 2}], "leave_box": leaves,
                "boxes": [{"lower": [11, 9, 12], "upper": [17, 15, 19]}]
            })
        };
        let result =
            |leaves| post_image(&shared(), PATH, &body(leaves), &image).expect(200)["results"][0].clone();
        let free = result(true);
        assert_eq!(free["stop"], "left_object", "{representation}: {}", free["moved"]);
        assert!(number(&free["moved"]["size_ratio"]) > 2.83, "{}", free["moved"]);
        let kept = result(false);
        let ratio = |result: &Value| number(&result["moved"]["size_ratio"]);
        // The wall begins at 1.5 and gives way by less than a fifth of the half sides.
        assert!(
            ratio(&kept) < 1.7_f64.powi(3) && ratio(&kept) < ratio(&free),
            "{} {}",
            kept["moved"],
            free["moved"]
        );
    }
}

/// Results that cover the same cells are told with each other; those beside each other are not.
#[test]
fn results_that_overlap_are_told() {
    let two = |other: Value| left_disc(json!({"boxes": [{"lower": [13, 13], "upper": [27, 27]}, other]}));
    let right =
        post_image(&shared(), PATH, &two(json!({"lower": [27.5, 13], "upper": [41.5, 27]})), &discs());
    let right = right.expect(200);
    let much = |result: &Value| result["warnings"].to_string().contains("are those of result");
    assert!(!much(&right["results"][0]) && !much(&right["results"][1]), "{right}");
    let same = post_image(&shared(), PATH, &two(json!({"lower": [14, 13], "upper": [27, 26]})), &discs())
        .expect(200);
    for (index, other) in [(0, 1), (1, 0)] {
        let result = &same["results"][index];
        let shared = &result["shared"][0];
        assert_eq!(shared["index"], json!(other), "{shared}");
        assert!(number(&shared["part"]) > 0.8 && number(&shared["part_of_other"]) > 0.8, "{shared}");
        assert!(much(result), "{}", result["warnings"]);
    }
    let [a, b] = [0, 1].map(|index| same["results"][index]["shared"][0].clone());
    assert_eq!((&a["cells"], &a["part"]), (&b["cells"], &b["part_of_other"]));
}

/// Jobs tell the same, and what has left its object does not go into a cohort unless it is asked for.
#[test]
fn jobs_and_cohorts_tell_what_has_left_its_object() {
    let server = with_cohort();
    let body = left_disc(json!({"size_factor": 1.0, "boxes": [{"lower": [14, 14], "upper": [25, 25]}]}));
    let files: [(&str, &[u8]); 1] = [("image", &discs())];
    let job = ended(&server, &post(&server, PATH, &body, &files, &[ASYNC]));
    assert_eq!(job["result"]["results"][0]["stop"], "left_object", "{job}");
    let answer = post_to_cohort(&server, &body, &discs(), &[]).expect(200);
    assert_eq!(answer["results"][0]["not_stored"], "left_object", "{answer}");
    let mut stored = body;
    stored["store_failed"] = json!(true);
    let answer = post_to_cohort(&server, &stored, &discs(), &[]).expect(201);
    assert_eq!((&answer["added"], &answer["results"][0]["not_stored"]), (&json!(1), &Value::Null));
}

#[test]
fn factors_are_checked() {
    let server = shared();
    for (further, pointer) in [
        (json!({"size_factor": 0.5}), "/size_factor"),
        (json!({"box_factor": 0}), "/box_factor"),
        (json!({"box_factor": 2, "leave_box": true}), "/box_factor"),
        (json!({"leave_box": "no"}), "/leave_box"),
    ] {
        post_image(&server, PATH, &left_disc(further), &discs()).expect_problem(
            422,
            "invalid-input",
            &[pointer],
        );
    }
}

/// Slices of 6 mm and pixels of 1 mm: one number blurs both, one for each axis does not, and the usual stages see a ball of 5 mm.
#[test]
fn thick_slices_are_blurred_by_axis() {
    let size = [40, 36, 8];
    let inside = |[x, y, z]: [f64; 3]| (x - 20.0).hypot(y - 18.0).hypot(6.0 * (z - 4.0)) <= 9.0;
    let volume = grid(size, [1.0, 1.0, 6.0], LengthUnit::Millimetre);
    let image =
        nifti_f32(&volume, &values(size, |cell| if inside(cell) { 100.0_f32 } else { 20.0 })).unwrap();
    let trigonometric = json!({"name": "trigonometric"});
    let sphere = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]});
    let body = |stages: Value| {
        json!({"representation": sphere, "terms": [{"name": "contour"}], "stages": stages,
        "boxes": [{"lower": [12, 10, 16], "upper": [28, 26, 32]}]})
    };
    let by_axis = json!([{"free": "affine", "sigma": [2, 2, 3]}, {"sigma": [2, 2, 3]}, {"sigma": [1, 1, 3]}]);
    let usual = post_image(&shared(), PATH, &body(json!([])), &image).expect(200);
    let given = post_image(&shared(), PATH, &body(by_axis), &image).expect(200);
    assert_eq!(usual["results"], given["results"]);
    let size = number(&usual["results"][0]["moved"]["result"]["size"]);
    let expected = 4.0 / 3.0 * std::f64::consts::PI * 9.0_f64.powi(3);
    // A surface between slices of 6 mm is known to a third of a slice: 2 of 9 mm along one of three axes.
    assert!((size / expected - 1.0).abs() < 0.25, "{size}, expected {expected}");
    for (sigma, pointer) in [
        (json!([2, 2]), "/stages/0/sigma"),
        (json!([2, 2, 2]), "/stages/0/sigma/2"),
        (json!(2), "/stages/0/sigma"),
        (json!("2"), "/stages/0/sigma"),
    ] {
        let refused = post_image(&shared(), PATH, &body(json!([{"sigma": sigma}])), &image);
        refused.expect_problem(422, "invalid-input", &[pointer]);
    }
}
