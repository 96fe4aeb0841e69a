//! Open and closed curves over HTTP: what the curve endpoints promise, and what they refuse.

use std::f64::consts::{PI, TAU};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::server::{Server, Setting, assert_close, flat, pointers_of, shared};

fn closed(control_points: usize, generator: &Value) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": control_points, "generator": generator})
}

fn open(intervals: usize, generator: &Value) -> Value {
    json!({"kind": "open_curve", "dimension": 2, "intervals": intervals, "generator": generator})
}

fn with(value: &Value, key: &str, other: Value) -> Value {
    let mut value = value.clone();
    value[key] = other;
    value
}

fn without(value: &Value, key: &str) -> Value {
    let mut value = value.clone();
    value.as_object_mut().unwrap().remove(key);
    value
}

fn cubic() -> Value {
    json!({"name": "cubic"})
}

fn trigonometric() -> Value {
    json!({"name": "trigonometric"})
}

fn exponential(poles: &Value) -> Value {
    json!({"name": "exponential", "poles": poles})
}

fn interpolator(family: &str, poles: &Value) -> Value {
    json!({"name": "interpolator", "family": family, "poles": poles})
}

/// The interpolator of half-integer shifts that contains the ellipses.
fn ellipses() -> Value {
    json!({"name": "interpolator", "family": "half_integer_shifts",
        "domain_poles": [[0, 0], [0, TAU], [0, -TAU]]})
}

fn zeros(count: usize) -> Value {
    json!(vec![[0; 2]; count])
}

fn circle(count: usize, radius: f64) -> Vec<[f64; 2]> {
    (0..count)
        .map(|k| (TAU * k as f64 / count as f64).sin_cos())
        .map(|(s, c)| [radius * c, radius * s])
        .collect()
}

/// An arc without symmetry at the parameters `k/(count − 1)`.
fn arc(count: usize, seed: usize) -> Vec<[f64; 2]> {
    let s = seed as f64;
    (0..count)
        .map(|k| k as f64 / (count - 1) as f64)
        .map(|u| [6.0 * u + 3.0 * s, (4.0 * u).sin() + 0.2 * s * (2.0 * u + s).cos() + 1.5 * u * u])
        .collect()
}

fn arc3(count: usize, seed: usize) -> Vec<[f64; 3]> {
    arc(count, seed).iter().map(|[x, y]| [*x, *y, 0.3 * x * y + (x + 0.1 * seed as f64).sin()]).collect()
}

fn knot(count: usize, seed: usize) -> Vec<[f64; 3]> {
    let s = seed as f64;
    (0..count)
        .map(|k| TAU * k as f64 / count as f64)
        .map(|t| {
            [
                3.0 * t.cos() + 0.3 * (2.0 * t + s).sin(),
                2.0 * t.sin() + s,
                (2.0 * t).cos() + 0.2 * s * t.sin(),
            ]
        })
        .collect()
}

fn shapes<const D: usize>(lists: impl IntoIterator<Item = Vec<[f64; D]>>) -> Value {
    lists
        .into_iter()
        .map(|points| json!({ "points": points.iter().map(|p| p.to_vec()).collect::<Vec<_>>() }))
        .collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

fn catalogue(server: &Server) -> Vec<Value> {
    server.get("/v1/generators").expect(200)["items"].as_array().unwrap().clone()
}

// ---------------------------------------------------------------- evaluation

#[test]
fn an_open_curve_passes_through_its_points_up_to_both_ends() {
    let server = shared();
    let points = arc(9, 1);
    let hats = exponential(&json!([[0, 1], [0, -1]]));
    let cubic = interpolator("integer_shifts", &zeros(4));
    let wide = with(&interpolator("integer_shifts", &zeros(3)), "support", json!(8));
    let mut generators: Vec<Value> =
        catalogue(&server).iter().map(|item| item["generator"].clone()).collect();
    generators.extend([
        hats,
        cubic,
        wide,
        exponential(&zeros(10)),
        interpolator("half_integer_shifts", &zeros(10)),
    ]);
    for generator in generators {
        let intervals =
            if generator["poles"].as_array().is_some_and(|poles| poles.len() == 10) { 9 } else { 8 };
        let points = if intervals == 9 { arc(10, 1) } else { points.clone() };
        let step = 1e-4;
        let last = [1.0, 1.0 - step, 1.0 - 2.0 * step];
        let body = |field: &str, value: Value| {
            let body = json!({"representation": open(intervals, &generator),
                "shapes": [{"points": points}], "derivatives": 2});
            server.post("/v1/evaluate", &with(&body, field, value)).expect(200)["evaluations"][0].clone()
        };
        let at_knots = body("samples", json!(points.len()));
        assert_close(&at_knots["points"], &json!(points), 1e-10, &generator.to_string());
        // At the end the limits are those from the left.
        let end = body("parameters", json!(last));
        let r: Vec<Vec<f64>> = end["points"].as_array().unwrap().iter().map(flat).collect();
        let first: Vec<f64> =
            (0..2).map(|c| (3.0 * r[0][c] - 4.0 * r[1][c] + r[2][c]) / (2.0 * step)).collect();
        assert_close(&end["first"][0], &json!(first), 2e-4, &format!("left limit of r', {generator}"));
        let scale = flat(&end["second"][0]).iter().fold(1.0, |m: f64, v| m.max(v.abs()));
        assert_close(&end["second"][0], &end["second"][1], 1e-2 * scale, "left limit of r''");
    }
}

#[test]
fn posted_control_points_of_an_open_curve_include_those_beyond_its_ends() {
    let server = shared();
    // A straight line is extended as a line: phantoms included, it is the same curve.
    let line = |from: i32, to: i32| {
        (from..=to).map(|k| [f64::from(k), 2.0 * f64::from(k) - 1.0]).collect::<Vec<_>>()
    };
    for (generator, phantoms) in [
        (cubic(), 1),
        (json!({"name": "bspline", "degree": 3}), 1),
        (json!({"name": "bspline", "degree": 5}), 2),
        (interpolator("integer_shifts", &zeros(4)), 2),
    ] {
        let body = json!({"representation": open(5, &generator), "samples": 6, "derivatives": 1,
            "shapes": [{"points": line(0, 5)}, {"control_points": line(-phantoms, 5 + phantoms)}]});
        let answer = server.post("/v1/evaluate", &body).expect(200);
        assert_close(&answer["evaluations"][0]["points"], &json!(line(0, 5)), 1e-12, "points");
        for name in ["points", "first"] {
            assert_close(&answer["evaluations"][1][name], &answer["evaluations"][0][name], 1e-12, name);
        }
    }
}

#[test]
fn every_generator_serves_closed_and_open_curves() {
    let server = shared();
    for item in catalogue(&server) {
        let generator = &item["generator"];
        let closed_shapes: Value = (1..4)
            .map(|s| {
                circle(9, 2.0)
                    .iter()
                    .enumerate()
                    .map(|(k, p)| {
                        [p[0] + 0.1 * ((k * s) as f64).sin(), p[1] * (1.0 + 0.1 * s as f64) + s as f64]
                    })
                    .collect::<Vec<_>>()
            })
            .map(|points| json!({"points": points}))
            .collect();
        let cases =
            [(closed(9, generator), closed_shapes), (open(8, generator), shapes((1..4).map(|s| arc(9, s))))];
        for (representation, list) in cases {
            let body = json!({"representation": representation, "transformation": "affine", "shapes": list});
            let what = representation.to_string();
            let mean = server.post("/v1/mean", &body).expect(200);
            let control_points = &mean["mean"]["control_points"];
            let pca = server.post("/v1/pca", &body).expect(200);
            assert!(!flat(&pca["eigenvalues"]).is_empty(), "{what}");
            let body =
                json!({"representation": representation, "shapes": [{"control_points": control_points}]});
            let curve = server.post("/v1/evaluate", &with(&body, "frames", json!(true))).expect(200);
            assert_eq!(curve["evaluations"][0]["points"].as_array().unwrap().len(), 100, "{what}");
            server.post("/v1/measure", &body).expect(200);
            server.post("/v1/evaluate?format=svg", &body).expect_svg();
            let refined = server.post("/v1/refine", &body).expect(200);
            let fine = json!({"representation": refined["representation"], "shapes": refined["shapes"]});
            assert!(fine["shapes"][0]["control_points"].is_array(), "{what}");
        }
    }
}

// ---------------------------------------------------------------- statistics

#[test]
fn cohorts_of_open_curves_have_means_and_modes() {
    let server = Server::fresh();
    for (dimension, name) in [(2, "plane"), (3, "space")] {
        let representation = with(&open(8, &cubic()), "dimension", json!(dimension));
        let cohort = json!({"name": name, "representation": representation, "correspondence": "arc_length"});
        server.post("/v1/cohorts", &cohort).expect(201);
        let list = |count: usize, seed: usize| {
            if dimension == 2 { shapes([arc(count, seed)]) } else { shapes([arc3(count, seed)]) }
        };
        let all: Value =
            [(9, 1), (23, 2), (40, 3)].iter().map(|&(count, seed)| list(count, seed)[0].clone()).collect();
        let added = server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": all})).expect(201);
        assert_eq!(added["added"], 3);
        let settings = [
            "transformation=affine",
            "transformation=similarity&alignment=procrustes",
            "transformation=rigid&alignment=procrustes",
        ];
        let plane = ["transformation=similarity"];
        for query in settings.iter().chain(plane.iter().filter(|_| dimension == 2)) {
            let path = format!("/v1/cohorts/{name}/mean?{query}");
            let mean = server.get(&path).expect(200);
            let control_points = mean["mean"]["control_points"].as_array().unwrap();
            assert_eq!(control_points.len(), 8 + 1 + 2, "{path}");
            let svg = server.get(&format!("{path}&format=svg"));
            let svg = svg.expect_svg();
            assert!(svg.contains("<path") && !svg.contains("Z\""), "an open curve is drawn open: {path}");
            let (class, alignment) = match query.split_once('&') {
                Some((class, _)) => (class, "procrustes"),
                None => (*query, "projection"),
            };
            let body = json!({"representation": representation, "correspondence": "arc_length", "alignment": alignment,
                "transformation": class.trim_start_matches("transformation="), "shapes": all});
            let again = server.post("/v1/mean", &body).expect(200);
            assert_close(&again["mean"]["control_points"], &mean["mean"]["control_points"], 1e-9, &path);
            server.post("/v1/pca", &body).expect(200);
            let drawn = server.post("/v1/pca?format=svg&component=1", &body);
            assert!(!drawn.expect_svg().contains("Z\""));
            let evaluate =
                json!({"representation": representation, "shapes": [{"control_points": control_points}]});
            server.post("/v1/evaluate", &evaluate).expect(200);
        }
    }
}

#[test]
fn open_curves_that_run_backwards_match_when_the_direction_has_no_meaning() {
    let server = shared();
    for dimension in [2, 3] {
        let lists: Vec<Value> = (1..5)
            .map(|s| if dimension == 2 { json!(arc(30 + s, s)) } else { json!(arc3(30 + s, s)) })
            .collect();
        let reversed: Vec<Value> = lists
            .iter()
            .enumerate()
            .map(|(i, list)| {
                let mut points = list.as_array().unwrap().clone();
                // One of four: the others say which way the mean runs.
                if i == 3 {
                    points.reverse();
                }
                json!({ "points": points })
            })
            .collect();
        let plain: Value = lists.iter().map(|points| json!({ "points": points })).collect();
        let body = json!({"representation": with(&open(8, &cubic()), "dimension", json!(dimension)), "shapes": plain,
            "transformation": "affine", "correspondence": "arc_length", "direction": "either"});
        let one = server.post("/v1/align", &body).expect(200);
        let other = server.post("/v1/align", &with(&body, "shapes", json!(reversed))).expect(200);
        assert_close(&other["mean"]["control_points"], &one["mean"]["control_points"], 1e-7, "mean");
        for (i, (a, b)) in
            one["aligned"].as_array().unwrap().iter().zip(other["aligned"].as_array().unwrap()).enumerate()
        {
            assert_close(&b["control_points"], &a["control_points"], 1e-7, "aligned");
            // With affine maps a shape may match better backwards; turning the list round turns the answer.
            let (plain, turned) = (a["reversed"] == true, b["reversed"] == true);
            assert_eq!(turned, plain ^ (i == 3), "{dimension}: shape {i}");
            assert!(dimension == 3 || !plain, "shape {i} is matched forwards in the plane");
        }
    }
}

#[test]
fn curves_of_space_are_evaluated_measured_and_aligned() {
    let server = shared();
    let cases = [
        (with(&closed(9, &cubic()), "dimension", json!(3)), shapes((1..4).map(|s| knot(9, s)))),
        (with(&open(8, &cubic()), "dimension", json!(3)), shapes((1..4).map(|s| arc3(9, s)))),
    ];
    for (representation, list) in cases {
        let body = json!({"representation": representation, "shapes": list});
        let evaluate = with(&with(&body, "samples", json!(9)), "frames", json!(true));
        let answer = server.post("/v1/evaluate", &evaluate).expect(200);
        for (evaluation, shape) in
            answer["evaluations"].as_array().unwrap().iter().zip(list.as_array().unwrap())
        {
            assert_close(&evaluation["points"], &shape["points"], 1e-12, "points");
            for (t, n) in evaluation["tangents"]
                .as_array()
                .unwrap()
                .iter()
                .zip(evaluation["normals"].as_array().unwrap())
            {
                let dot: f64 = flat(t).iter().zip(flat(n)).map(|(a, b)| a * b).sum();
                assert!(dot.abs() < 1e-12);
            }
            assert!(flat(&evaluation["curvatures"]).iter().all(|k| *k >= 0.0));
        }
        let answer = server.post("/v1/measure", &with(&body, "reference", list[0].clone())).expect(200);
        let measures = &answer["results"][0];
        assert_eq!(
            (&measures["area"], &measures["turning"], &measures["self_intersecting"]),
            (&Value::Null, &Value::Null, &Value::Null)
        );
        assert!(number(&measures["length"]) > 1.0 && number(&measures["total_curvature"]) > 0.1);
        assert_eq!(measures["distances"]["l2"], 0.0);
        assert_eq!(measures["perimeter"].is_null(), representation["kind"] == "open_curve");
        let align = with(&with(&body, "transformation", json!("rigid")), "alignment", json!("procrustes"));
        assert_eq!(server.post("/v1/align", &align).expect(200)["aligned"].as_array().unwrap().len(), 3);
    }
}

// ---------------------------------------------------------------- refinement

#[test]
fn a_circle_is_refined_exactly() {
    let server = shared();
    let u = [0.0, 0.1, 0.37, 0.5, 0.93];
    let body = json!({"representation": closed(3, &ellipses()), "shapes": [{"points": circle(3, 1.0)}]});
    let fine = server.post("/v1/refine", &body).expect(200);
    assert_eq!(fine["exact"], true);
    assert_eq!(fine["representation"]["control_points"], 6);
    let points = fine["shapes"][0]["control_points"].as_array().unwrap();
    assert_eq!(points.len(), 6);
    for point in points {
        let p = flat(point);
        assert!((p[0].hypot(p[1]) - 1.154_700_538_379_251_5).abs() < 1e-12, "{point}");
    }
    assert!(fine["shapes"][0].get("l2_change").is_none());
    let shift = number(&fine["parameter_shift"]);
    let before = server.post("/v1/evaluate", &with(&body, "parameters", json!(u))).expect(200);
    let moved: Vec<f64> = u.iter().map(|u| u + shift).collect();
    let body =
        json!({"representation": fine["representation"], "shapes": fine["shapes"], "parameters": moved});
    let after = server.post("/v1/evaluate", &body).expect(200);
    let points = |answer: &Value| answer["evaluations"][0]["points"].clone();
    assert_close(&points(&after), &points(&before), 1e-12, "the same curve");
}

#[test]
fn refined_splines_are_the_same_curve_and_others_say_how_much_they_change() {
    let server = shared();
    let u = [0.0, 0.2, 0.41, 0.77, 0.9];
    let quadruple = exponential(&json!([[0.4, 1], [0.4, -1], [-0.4, 1], [-0.4, -1], [0, 0]]));
    let generators = [
        json!({"name": "bspline", "degree": 1}),
        json!({"name": "bspline", "degree": 3}),
        json!({"name": "bspline", "degree": 2}),
        quadruple,
        interpolator("half_integer_shifts", &zeros(4)),
    ];
    for generator in generators {
        for factor in [2, 4, 6] {
            let body = json!({"representation": closed(7, &generator), "shapes": [{"points": arc(7, 2)}], "factor": factor});
            let fine = server.post("/v1/refine", &body).expect(200);
            assert_eq!(fine["exact"], true, "{generator}");
            let shift = number(&fine["parameter_shift"]);
            let before = server
                .post("/v1/evaluate", &with(&without(&body, "factor"), "parameters", json!(u)))
                .expect(200);
            let moved: Vec<f64> = u.iter().map(|u| u + shift).collect();
            let body = json!({"representation": fine["representation"], "shapes": fine["shapes"], "parameters": moved});
            let after = server.post("/v1/evaluate", &body).expect(200);
            assert_close(
                &after["evaluations"][0]["points"],
                &before["evaluations"][0]["points"],
                1e-11,
                &generator.to_string(),
            );
        }
    }
    // Open curves of an odd number of poles begin where they begin.
    let odd = [json!({"name": "bspline", "degree": 2}), interpolator("half_integer_shifts", &zeros(3))];
    for (generator, factor) in odd.iter().flat_map(|generator| [(generator, 2), (generator, 4)]) {
        let body = json!({"representation": open(6, generator), "shapes": [{"points": arc(7, 2)}], "factor": factor});
        let fine = server.post("/v1/refine", &body).expect(200);
        assert_eq!((&fine["exact"], &fine["parameter_shift"]), (&json!(true), &json!(0.0)), "{fine}");
        let at = |representation: &Value, shapes: &Value| {
            let body = json!({"representation": representation, "shapes": shapes, "samples": 41});
            server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone()
        };
        let before = at(&body["representation"], &body["shapes"]);
        assert_close(&at(&fine["representation"], &fine["shapes"]), &before, 1e-12, "an open curve");
        // Closed directions have no such generator.
        let shifted = &fine["representation"]["generator"];
        assert_eq!(shifted["name"], "shifted_exponential");
        let body = json!({"representation": closed(7, shifted), "shapes": [{"points": arc(7, 2)}]});
        server.post("/v1/evaluate", &body).expect_problem(
            422,
            "invalid-input",
            &["/representation/generator"],
        );
    }
    for (representation, points) in [(closed(7, &cubic()), arc(7, 2)), (open(6, &cubic()), arc(7, 2))] {
        let body = json!({"representation": representation, "shapes": [{"points": points}]});
        let fine = server.post("/v1/refine", &body).expect(200);
        assert_eq!(fine["exact"], false);
        assert!(number(&fine["shapes"][0]["l2_change"]) > 1e-6);
    }
}

// ---------------------------------------------------------------- fits

#[test]
fn a_sampled_ellipse_is_recovered() {
    let server = shared();
    let ellipse =
        |count: usize| circle(count, 1.0).iter().map(|[x, y]| [3.0 * x + 1.0, y - 2.0]).collect::<Vec<_>>();
    let parameters: Vec<f64> = (0..50).map(|k| f64::from(k) / 50.0).collect();
    let body = json!({"representation": closed(5, &trigonometric()), "shapes": [{"points": ellipse(50)}], "parameters": [parameters]});
    let fit = &server.post("/v1/fit", &body).expect(200)["results"][0];
    assert_close(&fit["control_points"], &json!(ellipse(5)), 1e-12, "control points");
    assert!(number(&fit["residual"]) < 1e-12 && number(&fit["largest_residual"]) < 1e-12);
    assert_eq!(fit["representation"], closed(5, &trigonometric()));
    // An arc, open, in space.
    let representation = with(&open(6, &json!({"name": "bspline", "degree": 3})), "dimension", json!(3));
    let points = shapes([arc3(7, 1)]);
    let parameters: Vec<f64> = (0..=60).map(|k| f64::from(k) / 60.0).collect();
    let body = json!({"representation": representation, "shapes": points, "parameters": parameters});
    let sampled = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0].clone();
    let body = json!({"representation": representation, "shapes": [sampled], "parameters": [parameters]});
    let fit = server.post("/v1/fit", &body).expect(200)["results"][0].clone();
    assert!(number(&fit["largest_residual"]) < 1e-11, "{fit}");
}

#[test]
fn a_tolerance_chooses_the_size_of_a_fit() {
    let server = shared();
    let points = circle(200, 1.0);
    let mut last = 0;
    for tolerance in [0.1, 0.01, 0.001, 1e-4] {
        let representation =
            json!({"kind": "closed_curve", "dimension": 2, "tolerance": tolerance, "generator": cubic()});
        let fit = server
            .post("/v1/fit", &json!({"representation": representation, "shapes": [{"points": points}]}))
            .expect(200)["results"][0]
            .clone();
        assert!(number(&fit["residual"]) <= tolerance);
        let count = fit["representation"]["control_points"].as_u64().unwrap();
        assert!(count >= last && count <= 200);
        last = count;
    }
    assert!(last > 6, "{last}");
    let representation = json!({"kind": "open_curve", "dimension": 2, "tolerance": 0.01, "generator": {"name": "bspline", "degree": 3}});
    let fit = server
        .post("/v1/fit", &json!({"representation": representation, "shapes": [{"points": arc(300, 1)}]}))
        .expect(200)["results"][0]
        .clone();
    assert!(
        number(&fit["residual"]) <= 0.01 && fit["representation"]["intervals"].as_u64().unwrap() < 40,
        "{fit}"
    );
}

// ---------------------------------------------------------------- idealised curves

#[test]
fn idealised_curves_are_exact_where_the_poles_allow() {
    let server = shared();
    for item in server.get("/v1/idealised").expect(200)["items"].as_array().unwrap() {
        let mut poles = item["domain_poles"].as_array().unwrap().clone();
        while poles.len() < 3 {
            poles.push(json!([0, 0]));
        }
        for generator in [
            json!({"name": "exponential", "domain_poles": poles}),
            json!({"name": "interpolator", "family": "integer_shifts", "domain_poles": poles}),
        ] {
            let representation =
                if item["closed"] == true { closed(12, &generator) } else { open(12, &generator) };
            let body =
                json!({"representation": representation, "curves": [{"curve": item["curve"], "angle": 0.3}]});
            let shape = server.post("/v1/idealised", &body).expect(200)["shapes"][0].clone();
            // Twice as fine a grid gives the same curve.
            let finer = if item["closed"] == true { closed(24, &generator) } else { open(24, &generator) };
            let other = server
                .post("/v1/idealised", &with(&body, "representation", finer.clone()))
                .expect(200)["shapes"][0]
                .clone();
            let points = |representation: &Value, shape: &Value| {
                let body = json!({"representation": representation, "shapes": [shape], "parameters": [0, 0.123, 0.5, 0.87]});
                server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone()
            };
            assert_close(
                &points(&finer, &other),
                &points(&representation, &shape),
                1e-10,
                &item["curve"].to_string(),
            );
        }
    }
    let ellipse = json!({"curve": {"name": "ellipse", "semi_axes": [2, 1]}, "centre": [3, 1]});
    let body = json!({"representation": closed(6, &trigonometric()), "curves": [ellipse]});
    let shape = server.post("/v1/idealised", &body).expect(200)["shapes"][0].clone();
    let wanted: Vec<[f64; 2]> = circle(6, 1.0).iter().map(|[x, y]| [2.0 * x + 3.0, y + 1.0]).collect();
    assert_close(&shape["control_points"], &json!(wanted), 1e-14, "ellipse");
    let refused = server.post("/v1/idealised", &with(&body, "representation", closed(6, &cubic())));
    let problem = refused.expect_problem(422, "invalid-input", &["/curves/0/curve"]);
    assert!(problem.to_string().contains("6.283185"), "{problem}");
    let parabola = json!([{"curve": {"name": "parabola", "focal_length": 1, "extent": 2}}]);
    let body =
        json!({"representation": open(6, &json!({"name": "bspline", "degree": 1})), "curves": parabola});
    let problem =
        server.post("/v1/idealised", &body).expect_problem(422, "invalid-input", &["/curves/0/curve"]);
    assert!(problem.to_string().contains("0 (3 times)"), "{problem}");
}

// ---------------------------------------------------------------- morphs

#[test]
fn a_morph_leads_from_one_shape_to_the_other() {
    let server = shared();
    for (representation, count) in [(closed(6, &trigonometric()), 6), (open(5, &cubic()), 6)] {
        let body = json!({"representation": representation, "from": {"points": arc(count, 1)}, "to": {"points": arc(count, 2)}});
        let answer = server.post("/v1/morph", &body).expect(200);
        assert_eq!(answer["angle"], Value::Null);
        let frames = answer["frames"].as_array().unwrap();
        assert_eq!(frames.len(), 11);
        let ends = |frames: &[Value]| json!([{"control_points": frames[0]["control_points"]}, {"control_points": frames[frames.len() - 1]["control_points"]}]);
        let evaluated = server
            .post(
                "/v1/evaluate",
                &json!({"representation": representation, "shapes": ends(frames), "samples": count}),
            )
            .expect(200);
        assert_close(&evaluated["evaluations"][0]["points"], &json!(arc(count, 1)), 1e-13, "from");
        assert_close(&evaluated["evaluations"][1]["points"], &json!(arc(count, 2)), 1e-13, "to");
        let beyond = server.post("/v1/morph", &with(&body, "positions", json!([0, 1, 2, -1]))).expect(200);
        let at = |i: usize| flat(&beyond["frames"][i]["control_points"]);
        let wanted: Vec<f64> = at(0).iter().zip(at(1)).map(|(a, b)| 2.0 * b - a).collect();
        assert_close(&json!(at(2)), &json!(wanted), 1e-12, "extrapolation");
        for path in ["plane", "sphere"] {
            let reply = server.post("/v1/morph?format=svg", &with(&body, "path", json!(path)));
            let svg = reply.expect_svg();
            assert!(svg.contains("<animate"));
            assert_eq!(svg.contains("Z\""), representation["kind"] == "closed_curve");
        }
    }
    // On the sphere: a circle and the same one turned by a quarter are at right angles.
    let quarter: Vec<[f64; 2]> = circle(4, 5.0).iter().map(|[x, y]| [-y, *x]).collect();
    let body = json!({"representation": closed(4, &trigonometric()), "path": "sphere", "positions": [0, 0.5, 1, 2],
        "from": {"points": circle(4, 2.0)}, "to": {"points": quarter}});
    let answer = server.post("/v1/morph", &body).expect(200);
    assert!((number(&answer["angle"]) - PI / 2.0).abs() < 1e-12);
    let half = 0.5_f64.sqrt();
    assert_close(&answer["frames"][0]["control_points"], &json!(circle(4, 1.0)), 1e-12, "unit norm");
    assert_close(&answer["frames"][1]["control_points"][0], &json!([half, half]), 1e-12, "half way");
    assert_close(&answer["frames"][3]["control_points"][0], &json!([-1, 0]), 1e-12, "beyond");
}

#[test]
fn a_morph_leads_through_several_shapes() {
    let server = shared();
    for (representation, path) in [(closed(6, &trigonometric()), "plane"), (open(5, &cubic()), "sphere")] {
        let shapes: Vec<Value> = (1..=4).map(|seed| json!({"points": arc(6, seed)})).collect();
        let body = json!({"representation": representation, "shapes": shapes, "path": path});
        let positions = [0.0, 0.5, 1.0, 1.25, 2.0, 2.75, 3.0, 3.5, -1.0];
        let answer = server.post("/v1/morph", &with(&body, "positions", json!(positions))).expect(200);
        let piece = |k: usize, tau: f64| {
            let body = json!({"representation": representation, "from": shapes[k], "to": shapes[k + 1], "path": path, "positions": [tau]});
            server.post("/v1/morph", &body).expect(200)
        };
        for (frame, (tau, k)) in answer["frames"]
            .as_array()
            .unwrap()
            .iter()
            .zip(positions.into_iter().zip([0, 0, 1, 1, 2, 2, 2, 2, 0]))
        {
            let wanted = &piece(k, tau - k as f64)["frames"][0];
            assert_eq!(
                (&frame["position"], &frame["control_points"]),
                (&json!(tau), &wanted["control_points"])
            );
        }
        match path {
            "plane" => assert!(answer["angle"].is_null() && answer.get("angles").is_none(), "{answer}"),
            _ => {
                let angles: Vec<Value> = (0..3).map(|k| piece(k, 0.0)["angle"].clone()).collect();
                assert_eq!(answer["angles"], json!(angles));
                let total: f64 = angles.iter().map(number).sum();
                assert!((number(&answer["angle"]) - total).abs() < 1e-14);
            }
        }
        // Equally spaced positions, ten for each piece, on whole numbers at the shapes.
        let usual = server.post("/v1/morph", &body).expect(200);
        let at: Vec<f64> =
            usual["frames"].as_array().unwrap().iter().map(|frame| number(&frame["position"])).collect();
        assert_eq!((at.len(), at[10], at[20], at[30]), (31, 1.0, 2.0, 3.0));
        assert!(server.post("/v1/morph?format=svg", &body).expect_svg().contains("<animate"));
        let strip = server.post("/v1/morph?format=svg&animate=false", &body);
        let strip = strip.expect_svg();
        assert!(strip.contains("through 4 shapes") && strip.contains("last shape"), "{strip}");
        // Two in a list are from and to.
        let two = with(&body, "shapes", json!([shapes[2], shapes[3]]));
        let ends =
            json!({"representation": representation, "from": shapes[2], "to": shapes[3], "path": path});
        assert_eq!(server.post("/v1/morph", &two).expect(200), server.post("/v1/morph", &ends).expect(200));

        let mut morph = Refusals::of(&server, "/v1/morph", body);
        morph.invalid("/shapes", json!([shapes[0]]), &["/shapes"], "at least 2");
        morph.invalid("/shapes", json!([]), &["/shapes"], "at least 2");
        morph.invalid("/shapes/2/points", json!(arc(7, 1)), &["/shapes/2/points"], "got 7");
        morph.invalid("/from", shapes[0].clone(), &["/from"], "got both");
        morph.invalid("/positions", json!([1002.5, -1000.5]), &["/positions/0", "/positions/1"], "1002");
        if path == "sphere" {
            morph.case(
                &[("/shapes/1/points", json!(vec![[0; 2]; 6]))],
                "degenerate-shape",
                &["/shapes/1"],
                "no extent",
            );
        }
    }
}

#[test]
fn a_shape_of_points_and_normals_is_morphed_through_several() {
    let server = shared();
    let representation =
        json!({"kind": "subdivision", "scheme": "normal_based", "level": 1, "connectivity": "octahedron"});
    let corners = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    let shape = |x: f64, z: f64| json!({"points": corners.map(|[a, b, c]| [x * f64::from(a), f64::from(b), z * f64::from(c)])});
    let shapes = [shape(1.0, 1.0), shape(2.0, 1.0), shape(2.0, 3.0)];
    let body = json!({"representation": representation, "shapes": shapes, "positions": [0.5, 1.5]});
    let answer = server.post("/v1/morph", &body).expect(200);
    for (k, frame) in answer["frames"].as_array().unwrap().iter().enumerate() {
        let body = json!({"representation": representation, "from": shapes[k], "to": shapes[k + 1], "positions": [0.5]});
        let wanted = &server.post("/v1/morph", &body).expect(200)["frames"][0];
        assert_eq!(
            (&frame["control_points"], &frame["normals"]),
            (&wanted["control_points"], &wanted["normals"])
        );
    }
}

/// Curves as surfaces: numbers that have lost their digits are named, in measures and overlaps.
#[test]
fn areas_far_from_the_origin_warn() {
    let server = shared();
    let at = |offset: f64| circle(9, 1.0).iter().map(|[x, y]| [x + offset, y + offset]).collect::<Vec<_>>();
    for (offset, warned) in [(0.0, false), (1e5, false), (1e8, true), (1e12, true), (1e15, true)] {
        let body = json!({"representation": closed(9, &trigonometric()), "shapes": [{"points": at(offset)}]});
        let found = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
        assert_eq!(
            found["warnings"].to_string().contains("so far from the origin"),
            warned,
            "{offset:e}: {found}"
        );
        if !warned {
            assert!((number(&found["area"]) - PI).abs() <= 1e-9, "{found}");
        }
        let path = json!({"representation": open(8, &cubic()), "shapes": [{"points": at(offset)}]});
        let found = server.post("/v1/measure", &path).expect(200)["results"][0].clone();
        assert_eq!(
            found["warnings"].to_string().contains("so far from the origin"),
            warned,
            "{offset:e}: {found}"
        );
        let bodies = json!({"first": {"contour": at(offset)}, "second": {"contour": at(offset)}});
        if offset <= 1e12 {
            let found = server.post("/v1/overlap", &bodies).expect(200);
            assert_eq!(
                found["warnings"].to_string().contains("so far from the origin"),
                warned,
                "{offset:e}: {found}"
            );
        }
    }
}

// ---------------------------------------------------------------- generators

#[test]
fn one_generator_is_described_and_drawn() {
    let server = shared();
    let page = server.get("/v1/generators/trigonometric?control_points=8").expect(200);
    assert_close(&page["riesz_bounds"]["lower_squared"], &json!(0.486_503_6), 1e-6, "lower bound");
    assert_close(&page["riesz_bounds"]["upper_squared"], &json!(1.002_508_1), 1e-6, "upper bound");
    assert_close(&page["weights"], &json!([-1.122_361_756_790_7, 3.297_752_801_127]), 1e-11, "weights");
    assert_eq!(page["control_points"], 8);
    assert_eq!(page["poles"].as_array().unwrap().len(), 3);
    for item in catalogue(&server) {
        let generator = item["generator"].as_object().unwrap();
        let parameters = generator.iter().filter(|(key, _)| *key != "name");
        let query: Vec<String> = parameters
            .map(|(key, value)| {
                format!("{key}={}", value.as_str().map_or_else(|| value.to_string(), str::to_owned))
            })
            .collect();
        let path = format!("/v1/generators/{}?{}", generator["name"].as_str().unwrap(), query.join("&"));
        let page = server.get(&path).expect(200);
        assert_eq!(page["generator"], item["generator"]);
        assert_eq!(page["support"], item["support"]);
        let reply = server.get(&format!("{path}{}format=svg", if query.is_empty() { "" } else { "&" }));
        assert!(reply.expect_svg().contains("<path"));
    }
    // Shifts that do not sum to one are worth a warning, and are not called interpolating.
    let page = server.get("/v1/generators/exponential?poles=%5B%5B1,0%5D,%5B-1,0%5D%5D").expect(200);
    assert_eq!((&page["interpolating"], &page["partition_of_unity"]), (&json!(false), &json!(false)));
    assert!(!page["warnings"].as_array().unwrap().is_empty());
}

// ---------------------------------------------------------------- measures

#[test]
fn a_circle_has_the_moments_curvature_and_distances_of_a_circle() {
    let server = shared();
    let body = json!({"representation": closed(5, &trigonometric()), "shapes": [{"points": circle(5, 2.0)}], "reference": {"points": circle(5, 1.0)}});
    let measures = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
    assert_close(&measures["area"], &json!(4.0 * PI), 1e-12, "area");
    assert_close(&measures["perimeter"], &json!(4.0 * PI), 1e-10, "perimeter");
    assert_close(&measures["length"], &json!(4.0 * PI), 1e-10, "length");
    assert_close(
        &measures["second_moments"],
        &json!([[4.0 * PI, 0.0], [0.0, 4.0 * PI]]),
        1e-12,
        "second moments",
    );
    assert_close(&measures["total_curvature"], &json!(TAU), 1e-11, "total curvature");
    assert_close(&measures["turning"], &json!(TAU), 1e-11, "turning");
    assert_close(&measures["stretching_energy"], &json!(4.0 * TAU.powi(2)), 1e-12, "stretching");
    assert_close(&measures["bending_energy"], &json!(4.0 * TAU.powi(4)), 1e-12, "bending");
    for (name, tolerance) in [("l2", 1e-12), ("hausdorff", 1e-9), ("symmetric_l2", 1e-6)] {
        assert_close(&measures["distances"][name], &json!(1.0), tolerance, name);
    }
    // The end of an open curve belongs to its box.
    let line: Vec<[f64; 2]> = (0..65).map(|k| [f64::from(k), 0.3 * f64::from(k)]).collect();
    let body = json!({"representation": open(64, &cubic()), "shapes": [{"points": line}]});
    let measures = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
    assert_close(&measures["bounding_box"]["max"], &json!([64.0, 19.2]), 1e-15, "the end");
    assert!(number(&measures["total_curvature"]) < 1e-9);
}

#[test]
fn fits_and_measures_do_not_depend_on_threads() {
    let (one, four) = (
        Setting::fresh().flags(&["--threads", "1"]).start(),
        Setting::fresh().flags(&["--threads", "4"]).start(),
    );
    let list = shapes((1..12).map(|s| arc(60, s)));
    let fit = json!({"representation": {"kind": "open_curve", "dimension": 2, "tolerance": 0.02, "generator": cubic()}, "shapes": list});
    let measure = json!({"representation": open(59, &json!({"name": "bspline", "degree": 3})), "shapes": list, "reference": list[0]});
    for (path, body) in [("/v1/fit", fit), ("/v1/measure", measure)] {
        let answers = [&one, &four].map(|server| server.post(path, &body));
        assert_eq!(answers[0].status, 200, "{}", answers[0].text());
        assert_eq!(answers[0].text(), answers[1].text(), "{path}");
    }
}

#[test]
fn contours_that_are_open_are_resampled_from_end_to_end() {
    let server = shared();
    let body = json!({"count": 5, "closed": false, "shapes": [{"points": [[0, 0], [1, 0], [4, 0]]}, {"points": [[0, 0, 0], [0, 3, 4]], "closed": false}]});
    let answer = server.post("/v1/resample", &body).expect(200);
    assert_close(
        &answer["shapes"][0]["points"],
        &json!([[0, 0], [1, 0], [2, 0], [3, 0], [4, 0]]),
        1e-14,
        "points",
    );
    assert_eq!(answer["shapes"][1]["polygon_length"], 5.0);
    for (key, value, pointer) in [
        ("start", json!("canonical"), "/start"),
        ("count", json!(1), "/count"),
        ("closed", json!(1), "/closed"),
        ("closed", json!(true), "/shapes/1/closed"),
    ] {
        // Two points in space are no closed contour either.
        let reply = server.post("/v1/resample", &with(&body, key, value));
        assert_eq!(reply.status, 422, "{}", reply.text());
        assert!(pointers_of(&reply.json()).contains(&pointer.to_owned()), "{pointer}: {}", reply.text());
    }
}

#[test]
fn extreme_input_has_finite_answers() {
    let server = shared();
    let check = |representation: &Value, points: &[[f64; 2]], samples: usize, tolerance: f64| {
        let size = points.as_flattened().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let body = json!({"representation": representation, "shapes": [{"points": points}]});
        let reply = server
            .post("/v1/evaluate", &with(&with(&body, "samples", json!(samples)), "frames", json!(true)));
        let what: String = representation.to_string().chars().take(200).collect();
        // A generator that cannot be made is refused at its place.
        if reply.status == 422 {
            assert_eq!(pointers_of(&reply.json()), ["/representation/generator"], "{what}");
            return false;
        }
        let evaluation = reply.expect(200)["evaluations"][0].clone();
        let scaled = |list: &[f64]| json!(list.iter().map(|v| v / size).collect::<Vec<_>>());
        assert_close(&scaled(&flat(&evaluation["points"])), &scaled(points.as_flattened()), tolerance, &what);
        assert!(evaluation["curvatures"].as_array().unwrap().iter().all(Value::is_number), "{what}");
        let measures = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
        for name in ["length", "stretching_energy", "bending_energy"] {
            assert!(
                measures[name].is_number() || (name == "bending_energy" && what.contains("[[10,0],[-10,0]]")),
                "{what}: {name} {measures}"
            );
        }
        true
    };
    let mut wave = circle(2048, 1.0);
    assert!(check(&closed(2048, &exponential(&zeros(10))), &wave, 2048, 1e-9));
    assert!(check(&closed(2048, &interpolator("half_integer_shifts", &zeros(10))), &wave, 2048, 1e-9));
    wave.truncate(2048);
    assert!(check(&open(2047, &interpolator("half_integer_shifts", &zeros(10))), &wave, 2048, 1e-9));
    for size in [1e100, 1e-100, 1e-120] {
        for generator in [cubic(), trigonometric(), ellipses(), json!({"name": "bspline", "degree": 3})] {
            assert!(check(&closed(5, &generator), &circle(5, size), 5, 1e-12), "{size}");
            assert!(check(&open(4, &generator), &circle(5, size), 5, 1e-12), "{size}");
        }
    }
    let near = json!([[0, 0], [0, PI - 1e-3], [0, 1e-3 - PI]]);
    let steep = json!([[0, 0], [10, 0], [-10, 0]]);
    for poles in [near, steep, json!([[10, 3], [10, -3], [-10, 3], [-10, -3]]), json!([[10, 0], [-10, 0]])] {
        for (representation, count) in [
            (closed(3, &exponential(&poles)), 3),
            (open(4, &exponential(&poles)), 5),
            (closed(9, &exponential(&poles)), 9),
        ] {
            check(&representation, &circle(count, 1.0), count, 1e-6);
        }
        if poles.as_array().unwrap().len() > 2 {
            check(&closed(3, &interpolator("integer_shifts", &poles)), &circle(3, 1.0), 3, 1e-6);
            check(&open(4, &interpolator("half_integer_shifts", &poles)), &circle(5, 1.0), 5, 1e-6);
        }
    }
    let wide = with(&interpolator("integer_shifts", &zeros(6)), "support", json!(18));
    check(&closed(3, &wide), &circle(3, 1.0), 3, 1e-9);
    // The hat of one interval, and pairs on one interval.
    for poles in [zeros(2), json!([[0, 1], [0, -1]]), json!([[2, 0], [-2, 0]])] {
        let body = json!({"representation": open(1, &exponential(&poles)), "shapes": [{"points": [[1, 2], [3, 5]]}], "samples": 2});
        let answer = server.post("/v1/evaluate", &body).expect(200);
        assert_close(&answer["evaluations"][0]["points"], &json!([[1, 2], [3, 5]]), 1e-12, "one interval");
    }
}

// ---------------------------------------------------------------- what is refused

/// Cases of one route: a good body, a field by its pointer and what it becomes, the pointers that are wanted.
struct Refusals<'a> {
    server: &'a Server,
    path: &'a str,
    good: Value,
    found: Vec<String>,
}

impl<'a> Refusals<'a> {
    fn of(server: &'a Server, path: &'a str, good: Value) -> Self {
        let reply = server.post(path, &good);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        Self { server, path, good, found: Vec::new() }
    }

    fn case(&mut self, changes: &[(&str, Value)], code: &str, wanted: &[&str], word: &str) {
        let mut body = self.good.clone();
        for (pointer, value) in changes {
            let (parent, key) = pointer.rsplit_once('/').unwrap();
            let parent = body.pointer_mut(parent).unwrap();
            match parent {
                Value::Array(items) => items[key.parse::<usize>().unwrap()] = value.clone(),
                other => other[key] = value.clone(),
            }
        }
        let start = Instant::now();
        let reply = self.server.post(self.path, &body);
        let problem = reply.json();
        let mut pointers = if reply.status < 400 { vec!["taken".into()] } else { pointers_of(&problem) };
        let mut wanted: Vec<String> = wanted.iter().map(ToString::to_string).collect();
        pointers.sort();
        wanted.sort();
        if reply.status != 422
            || problem["code"] != code
            || pointers != wanted
            || !problem.to_string().contains(word)
            || start.elapsed() > Duration::from_secs(5)
        {
            let text: String = reply.text().chars().take(500).collect();
            self.found.push(
                format!("{} {changes:?}: wanted {wanted:?} with '{word}'\n  found {text}", self.path)
                    .chars()
                    .take(1200)
                    .collect(),
            );
        }
    }

    fn invalid(&mut self, pointer: &str, value: Value, wanted: &[&str], word: &str) {
        self.case(&[(pointer, value)], "invalid-input", wanted, word);
    }
}

impl Drop for Refusals<'_> {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert!(self.found.is_empty(), "{} differences:\n{}", self.found.len(), self.found.join("\n"));
        }
    }
}

#[test]
fn bad_generators_are_refused_by_every_curve_route() {
    let server = shared();
    let good = json!({"points": circle(8, 2.0)});
    let representation = closed(8, &cubic());
    let curves = json!({"representation": representation, "shapes": [good]});
    let routes = [
        ("/v1/evaluate", curves.clone()),
        ("/v1/measure", curves.clone()),
        ("/v1/refine", curves.clone()),
        ("/v1/fit", curves.clone()),
        ("/v1/morph", json!({"representation": representation, "from": good, "to": good})),
        (
            "/v1/idealised",
            json!({"representation": closed(8, &trigonometric()), "curves": [{"curve": {"name": "circle", "radius": 1}}]}),
        ),
        (
            "/v1/mean",
            json!({"representation": representation, "shapes": [good, {"points": arc(8, 1)}], "transformation": "linear"}),
        ),
    ];
    let domain = |poles: Value| json!({"name": "exponential", "domain_poles": poles});
    let cubic = |key: &str, value: Value| with(&interpolator("integer_shifts", &zeros(3)), key, value);
    for (path, body) in routes {
        let mut refusals = Refusals::of(&server, path, body);
        let mut generator = |generator: Value, wanted: &str, word: &str| {
            refusals.invalid(
                "/representation/generator",
                generator,
                &[&format!("/representation{wanted}")],
                word,
            );
        };
        generator(exponential(&json!([[0, 0], [0, 1]])), "/generator/poles/1", "-1i");
        generator(exponential(&json!([[1, 1], [1, -1]])), "/generator/poles/0", "partner");
        generator(domain(json!([[1, 0], [0, 0]])), "/generator/domain_poles/0", "partner");
        for im in [PI, 4.0, 8.98681891, 1e308] {
            generator(
                interpolator("integer_shifts", &json!([[0, 0], [0, im], [0, -im]])),
                "/generator/poles",
                "|Im| < π",
            );
        }
        generator(exponential(&json!([[0, 8.98681891], [0, -8.98681891]])), "/generator/poles", "8.98681891");
        generator(exponential(&json!([[1e308, 0], [-1e308, 0]])), "/generator/poles", "1e308");
        generator(domain(json!([[1e308, 0], [-1e308, 0]])), "/generator/domain_poles", "finer");
        generator(exponential(&json!([["NaN", 0], [0, 0]])), "/generator/poles/0/0", "number");
        generator(exponential(&json!([[0, 0], [0, null]])), "/generator/poles/1/1", "number");
        generator(exponential(&json!("[[0,0]]")), "/generator/poles", "");
        generator(exponential(&json!([])), "/generator/poles", "got 0");
        generator(exponential(&zeros(11)), "/generator/poles", "got 11");
        generator(exponential(&zeros(40_000)), "/generator/poles", "got 40000");
        generator(domain(zeros(40_000)), "/generator/domain_poles", "got 40000");
        for family in ["integer_shifts", "half_integer_shifts"] {
            generator(interpolator(family, &zeros(2)), "/generator/poles", "expected 3 to 10 poles");
        }
        generator(
            with(&exponential(&zeros(2)), "domain_poles", zeros(2)),
            "/generator/domain_poles",
            "got both",
        );
        for support in [json!(3), json!(0), json!(19), json!(u64::MAX)] {
            generator(cubic("support", support), "/generator/support", "between 4 and 18");
        }
        generator(cubic("weights", json!([1])), "/generator/weights", "at most 0 weights");
        generator(
            with(&cubic("support", json!(6)), "weights", json!([1, 2])),
            "/generator/weights",
            "at most 1 weights",
        );
        generator(
            with(&cubic("support", json!(6)), "weights", json!([1e308])),
            "/generator/weights/0",
            "1000",
        );
        generator(
            with(&cubic("support", json!(6)), "weights", json!(["NaN"])),
            "/generator/weights/0",
            "number",
        );
        let half = interpolator("half_integer_shifts", &zeros(3));
        generator(with(&half, "weights", json!([1])), "/generator/weights", "integer_shifts");
        generator(with(&half, "support", json!(4)), "/generator/support", "integer_shifts");
        generator(interpolator("quarter_shifts", &zeros(3)), "/generator/family", "half_integer_shifts");
        generator(
            json!({"name": "interpolator", "poles": [[0, 0], [0, 0], [0, 0]]}),
            "/generator/family",
            "missing",
        );
        generator(json!({"name": "exponential"}), "/generator/poles", "missing");
        generator(json!({"name": "sinc"}), "/generator/name", "trigonometric");
        generator(domain(json!([[0, 0], [0, 30], [0, -30]])), "/control_points", "between 10 and 2048");
        refusals.invalid(
            "/representation/generator",
            with(&half, "colour", json!(1)),
            &["/representation/generator/colour"],
            "expected no field with this name",
        );
        for count in [json!(0), json!(2), json!(2049), json!(1_000_000_000_000_000_000_u64), json!(u64::MAX)]
        {
            refusals.invalid(
                "/representation/control_points",
                count.clone(),
                &["/representation/control_points"],
                "between 3 and 2048",
            );
            let open = with(&open(1, &exponential(&zeros(4))), "intervals", count);
            refusals.invalid("/representation", open, &["/representation/intervals"], "between 3 and 2048");
        }
        refusals.invalid(
            "/representation/control_points",
            json!(1e300),
            &["/representation/control_points"],
            "whole number",
        );
        if path != "/v1/mean" {
            refusals.invalid(
                "/representation",
                json!({"kind": "landmarks", "dimension": 2, "points": 8}),
                &["/representation/kind"],
                "closed_curve",
            );
        }
        refusals.case(
            &[
                ("/representation/dimension", json!(4)),
                ("/representation/control_points", json!(1)),
                ("/representation/generator", exponential(&json!([[0, 1]]))),
            ],
            "invalid-input",
            &[
                "/representation/dimension",
                "/representation/control_points",
                "/representation/generator/poles",
            ],
            "",
        );
    }
    server.assert_alive();
}

#[test]
fn bad_open_curves_are_refused() {
    let server = shared();
    let body = json!({"representation": open(7, &cubic()), "shapes": [{"points": arc(8, 1)}, {"points": arc(8, 2)}]});
    let mut evaluate = Refusals::of(&server, "/v1/evaluate", body.clone());
    evaluate.invalid("/correspondence", json!("cyclic"), &["/correspondence"], "arc_length");
    evaluate.invalid("/shapes/1/closed", json!(true), &["/shapes/1/closed"], "open");
    evaluate.invalid(
        "/shapes/1/points",
        json!(arc(9, 1)),
        &["/shapes/1/points"],
        "expected 8 points for this representation, got 9",
    );
    evaluate.invalid("/shapes/1/points", json!([]), &["/shapes/1/points"], "got 0");
    evaluate.invalid(
        "/shapes/1",
        json!({"control_points": arc(8, 1)}),
        &["/shapes/1/control_points"],
        "expected 10",
    );
    evaluate.invalid(
        "/parameters",
        json!([0, -1e-9, 1.0, 1.000_001, 1e300]),
        &["/parameters/1", "/parameters/3", "/parameters/4"],
        "between 0 and 1",
    );
    evaluate.invalid("/parameters", json!([]), &["/parameters"], "between 1");
    evaluate.invalid("/samples", json!(0), &["/samples"], "between 1");
    evaluate.invalid("/frames", json!("yes"), &["/frames"], "");
    evaluate.case(&[("/shapes", json!([]))], "too-few-shapes", &[], "got 0");
    evaluate.case(
        &[
            ("/correspondence", json!("x")),
            ("/samples", json!("y")),
            ("/derivatives", json!([])),
            ("/frames", json!(3)),
            ("/extra", json!(1)),
            ("/representation/generator", json!(7)),
            ("/shapes/1", json!(null)),
        ],
        "invalid-input",
        &[
            "/correspondence",
            "/samples",
            "/derivatives",
            "/frames",
            "/extra",
            "/representation/generator",
            "/shapes/1",
        ],
        "",
    );
    let mut mean = Refusals::of(&server, "/v1/mean", with(&body, "transformation", json!("affine")));
    mean.invalid("/correspondence", json!("cyclic"), &["/correspondence"], "arc_length");
    for generator in [
        exponential(&json!([[0, 1], [0, -1]])),
        interpolator("integer_shifts", &json!([[0, 1], [0, -1], [1, 0], [-1, 0]])),
    ] {
        mean.invalid(
            "/representation/generator",
            generator.clone(),
            &["/representation/generator"],
            "pole 0",
        );
        let linear =
            with(&with(&mean.good, "transformation", json!("linear")), "representation", open(7, &generator));
        server.post("/v1/mean", &linear).expect(200);
    }
    let mut measure =
        Refusals::of(&server, "/v1/measure", with(&body, "reference", json!({"points": arc(8, 3)})));
    measure.invalid("/reference", json!(7), &["/reference"], "object");
    measure.case(
        &[("/reference", json!({"points": arc(9, 3)})), ("/shapes/0", json!({}))],
        "invalid-input",
        &["/reference/points", "/shapes/0"],
        "",
    );
    server.assert_alive();
}

#[test]
fn bad_fits_and_refinements_are_refused() {
    let server = shared();
    let good = json!({"representation": {"kind": "closed_curve", "dimension": 2, "tolerance": 0.1, "generator": cubic()}, "shapes": [{"points": circle(20, 1.0)}]});
    let mut fit = Refusals::of(&server, "/v1/fit", good.clone());
    for tolerance in [json!(0), json!(-1), json!("0.1"), json!(null), json!([1])] {
        fit.invalid("/representation/tolerance", tolerance, &["/representation/tolerance"], "");
    }
    fit.case(
        &[("/representation/tolerance", json!(1e-300)), ("/shapes/0/points", json!(arc(20, 1)))],
        "invalid-input",
        &["/shapes/0/points"],
        "1e-300",
    );
    fit.invalid("/representation/control_points", json!(5), &["/representation/tolerance"], "got both");
    fit.invalid(
        "/representation/intervals",
        json!(5),
        &["/representation/intervals"],
        "expected no field with this name",
    );
    fit.invalid(
        "/representation",
        json!({"kind": "landmarks", "dimension": 2, "points": 4, "tolerance": 1}),
        &["/representation/tolerance"],
        "expected no field with this name",
    );
    fit.invalid("/representation", json!(null), &["/representation"], "object");
    fit.invalid("/representation", closed(21, &cubic()), &["/shapes/0/points"], "at least 21, got 20");
    fit.invalid("/representation", open(18, &cubic()), &["/shapes/0/points"], "at least 21, got 20");
    fit.invalid(
        "/representation",
        without(&closed(8, &cubic()), "control_points"),
        &["/representation/control_points"],
        "missing",
    );
    let cluster: Vec<f64> = (0..20).map(|k| f64::from(k) * 0.001).collect();
    fit.case(
        &[("/parameters", json!([cluster])), ("/representation", closed(8, &cubic()))],
        "invalid-input",
        &["/shapes/0/points"],
        "gaps",
    );
    let mut parameters: Vec<f64> = (0..20).map(|k| f64::from(k) / 20.0).collect();
    server.post("/v1/fit", &with(&good, "parameters", json!([parameters]))).expect(200);
    fit.invalid("/parameters", json!([parameters[..19]]), &["/shapes/0/points"], "(19), got 20");
    fit.invalid("/parameters", json!([]), &["/parameters"], "got 0");
    fit.invalid("/parameters", json!([parameters, parameters]), &["/parameters"], "got 2");
    fit.invalid("/parameters", json!(parameters), &["/parameters/0"], "");
    parameters[7] = parameters[6];
    fit.invalid("/parameters", json!([parameters]), &["/parameters/0/7"], "increase strictly");
    parameters[7] = -1.0;
    fit.invalid("/parameters", json!([parameters]), &["/parameters/0/7"], "increase strictly");
    fit.invalid("/shapes/0/points", json!([]), &["/shapes/0/points"], "got 0");
    fit.invalid("/shapes/0/closed", json!(false), &["/shapes/0/closed"], "closed");
    fit.invalid("/shapes/0", json!({"control_points": circle(8, 1.0)}), &["/shapes/0"], "expected points");
    fit.case(&[("/shapes", json!([]))], "too-few-shapes", &[], "got 0");
    fit.case(
        &[
            ("/representation/tolerance", json!("x")),
            ("/representation/generator", json!({"name": "bspline"})),
            ("/parameters", json!(1)),
            ("/shapes/0", json!(1)),
            ("/samples", json!(1)),
        ],
        "invalid-input",
        &[
            "/representation/tolerance",
            "/representation/generator/degree",
            "/parameters",
            "/shapes/0",
            "/samples",
        ],
        "",
    );

    let mut refine = Refusals::of(
        &server,
        "/v1/refine",
        json!({"representation": closed(8, &ellipses()), "shapes": [{"points": circle(8, 1.0)}]}),
    );
    for factor in [json!(0), json!(1), json!(1025), json!(u64::MAX)] {
        refine.invalid("/factor", factor, &["/factor"], "between 2 and 1024");
    }
    refine.invalid("/factor", json!(3), &["/factor"], "even");
    refine.invalid("/factor", json!(300), &["/factor"], "2048");
    for factor in [json!(-2), json!(2.5), json!("2")] {
        refine.invalid("/factor", factor, &["/factor"], "whole number");
    }
    let many = json!(vec![json!({"points": circle(8, 1.0)}); 1200]);
    refine.case(
        &[("/factor", json!(256)), ("/shapes", many)],
        "invalid-input",
        &["/factor"],
        "over all shapes",
    );
    server.assert_alive();
}

#[test]
fn bad_idealised_curves_and_morphs_are_refused() {
    let server = shared();
    let good = json!({"representation": closed(8, &trigonometric()), "curves": [{"curve": {"name": "circle", "radius": 1}}]});
    let mut ideal = Refusals::of(&server, "/v1/idealised", good);
    let at = "/curves/0/curve";
    ideal.invalid(at, json!({"name": "line", "from": [0, 0], "to": [1, 0]}), &[at], "open_curve");
    for radius in [json!(0), json!(-1), json!(1e300)] {
        ideal.invalid("/curves/0/curve/radius", radius, &[at], "positive radius up to 1e100");
    }
    for radius in [json!("NaN"), json!(null), json!([1])] {
        ideal.invalid("/curves/0/curve/radius", radius, &["/curves/0/curve/radius"], "number");
    }
    ideal.invalid("/curves/0/curve/name", json!("rose"), &["/curves/0/curve/name"], "lissajous");
    ideal.invalid(
        at,
        json!({"name": "lissajous", "amplitudes": [1, 1], "frequencies": [1, 70000], "phase": 0}),
        &["/curves/0/curve/frequencies/1"],
        "whole number",
    );
    ideal.invalid(at, json!(5), &[at], "an object");
    ideal.invalid("/curves/0/centre", json!([1e308, 0]), &["/curves/0"], "1e100");
    ideal.invalid("/curves/0/centre", json!([1]), &["/curves/0/centre"], "");
    ideal.invalid("/curves/0/angle", json!("x"), &["/curves/0/angle"], "number");
    ideal.invalid("/curves", json!([]), &["/curves"], "at least 1");
    ideal.invalid("/curves", json!([{}, 5, null]), &["/curves/0/curve", "/curves/1", "/curves/2"], "");
    let parabola = json!([{"curve": {"name": "parabola", "focal_length": 1e-320, "extent": 1e100}}]);
    ideal.case(
        &[("/representation", open(5, &cubic())), ("/curves", parabola)],
        "invalid-input",
        &["/curves/0"],
        "1e100",
    );

    let opposite: Vec<[f64; 2]> = circle(8, 3.0).iter().map(|[x, y]| [-x, -y]).collect();
    let good = json!({"representation": closed(8, &trigonometric()), "from": {"points": circle(8, 1.0)}, "to": {"points": arc(8, 1)}, "path": "sphere"});
    let mut morph = Refusals::of(&server, "/v1/morph", good);
    morph.invalid("/to/points", json!(opposite), &[""], "opposite");
    for (pointer, name) in [("/from/points", "/from"), ("/to/points", "/to")] {
        morph.case(&[(pointer, json!(vec![[0; 2]; 8]))], "degenerate-shape", &[name], "no extent");
        morph.invalid(pointer, json!(circle(7, 1.0)), &[pointer], "got 7");
        morph.invalid(name, json!(null), &[name], "object");
    }
    morph.invalid("/positions", json!([1e9, 0.5, -1001]), &["/positions/0", "/positions/2"], "±1000");
    morph.invalid("/positions", json!([]), &["/positions"], "between 1");
    morph.invalid("/positions", json!([null]), &["/positions/0"], "number");
    for steps in [json!(0), json!(1), json!(1_000_000), json!(u64::MAX)] {
        morph.invalid("/steps", steps, &["/steps"], "between 2 and 1000");
    }
    morph.case(&[("/steps", json!(3)), ("/positions", json!([0]))], "invalid-input", &["/steps"], "got both");
    morph.invalid("/path", json!("moon"), &["/path"], "sphere");
    morph.case(
        &[
            ("/path", json!("moon")),
            ("/steps", json!(1)),
            ("/from", json!({"points": [[1, "x"]]})),
            ("/to", json!(3)),
            ("/representation/kind", json!("x")),
        ],
        "invalid-input",
        &["/path", "/steps", "/from/points/0/1", "/to", "/representation/kind"],
        "",
    );
    for name in ["from", "to", "representation"] {
        let body = without(&morph.good, name);
        server.post("/v1/morph", &body).expect_problem(422, "invalid-input", &[&format!("/{name}")]);
    }
    let many = with(&morph.good, "positions", json!(vec![0.5; 1001]));
    server.post("/v1/morph", &many).expect(200);
    server.post("/v1/morph?format=svg", &many).expect_problem(422, "invalid-input", &["/positions"]);
    let wide = json!({"points": circle(2048, 1.0)});
    let body = json!({"representation": closed(2048, &cubic()), "from": wide, "to": wide, "steps": 1000});
    server.post("/v1/morph", &body).expect_problem(422, "invalid-input", &["/steps"]);
    server.assert_alive();
}

#[test]
fn bad_queries_of_a_generator_are_refused() {
    let server = shared();
    server.get("/v1/generators/sinc").expect_problem(404, "not-found", &[]);
    server.get("/v1/generators/sinc?control_points=8").expect_problem(404, "not-found", &[]);
    let zeros3 = "%5B%5B0,0%5D,%5B0,0%5D,%5B0,0%5D%5D";
    let cases = [
        ("trigonometric?control_points=x", "whole number"),
        ("trigonometric?control_points=-1", "whole number"),
        ("trigonometric?control_points=", "whole number"),
        ("trigonometric?control_points=2", "between 3"),
        ("trigonometric?control_points=18446744073709551615", "between 3"),
        ("trigonometric?control_points=8&control_points=9", "twice"),
        ("trigonometric?degree=3", "degree"),
        ("trigonometric?colour=red", "colour"),
        ("keys?format=xml", "xml"),
        ("keys?format=svg&format=json", "twice"),
        ("keys?name=keys", "twice"),
        ("bspline", "degree: required field is missing"),
        ("bspline?degree=0", "between 1 and 5"),
        ("bspline?degree=9", "between 1 and 5"),
        ("bspline?degree=three", "whole number"),
        ("bspline?degree=3&degree=3", "twice"),
        ("exponential", "poles: required field is missing"),
        ("exponential?poles=x", "poles"),
        ("exponential?poles=%5B%5B0,NaN%5D%5D", "poles"),
        ("exponential?poles=%5B%5B0,0%5D,%5B0,1%5D%5D", "partner"),
        ("exponential?poles=%5B%5B0,4%5D,%5B0,-4%5D%5D", "|Im| < π"),
        ("exponential?domain_poles=%5B%5B1e308,0%5D,%5B-1e308,0%5D%5D", "domain_poles"),
    ];
    for (query, word) in cases {
        let problem =
            server.get(&format!("/v1/generators/{query}")).expect_problem(400, "invalid-query", &[]);
        assert!(problem["detail"].as_str().unwrap().contains(word), "{query}: {problem}");
    }
    for (rest, word) in [
        ("", "family: required field is missing"),
        ("&family=x", "family"),
        ("&family=integer_shifts&support=3", "between 4 and 18"),
        ("&family=half_integer_shifts&weights=%5B1%5D", "integer_shifts"),
        (&format!("&family=integer_shifts&domain_poles={zeros3}"), "got both"),
    ] {
        let path = format!("/v1/generators/interpolator?poles={zeros3}{rest}");
        let problem = server.get(&path).expect_problem(400, "invalid-query", &[]);
        assert!(problem["detail"].as_str().unwrap().contains(word), "{path}: {problem}");
    }
}

// ---------------------------------------------------------------- any body at all

/// Pseudo-random numbers (splitmix64): the same bodies on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }
}

fn junk(random: &mut Random) -> Value {
    let values = [
        json!(null),
        json!(true),
        json!("x"),
        json!(""),
        json!([]),
        json!({}),
        json!(0),
        json!(-1),
        json!(1),
        json!(2),
        json!(3),
        json!(17),
        json!(u64::MAX),
        json!(i64::MIN),
        json!(1e308),
        json!(-1e100),
        json!(1e-308),
        json!(0.5),
        json!(PI - 1e-5),
        json!(10),
        json!(1e18),
        json!([[[0, 0], [1, 0]], []]),
        json!([[0, 0], [0, 0]]),
        json!([[0, 1], [0, -1], [0, 0]]),
        json!([[9, 0], [-9, 0]]),
        json!("integer_shifts"),
        json!("half_integer_shifts"),
        json!({"name": "cubic"}),
        json!({"name": "bspline", "degree": 2}),
        json!("sphere"),
        json!("cyclic"),
        json!("arc_length"),
        json!("open_curve"),
        json!("exponential"),
    ];
    values[random.below(values.len())].clone()
}

/// Changes one place: the deeper, the likelier to stop.
fn mutate(value: &mut Value, random: &mut Random) {
    let deeper = random.below(6) > 0;
    match value {
        Value::Object(map) if !map.is_empty() => {
            let key = map.keys().nth(random.below(map.len())).unwrap().clone();
            match random.below(9) {
                0 => drop(map.remove(&key)),
                1 => {
                    let names = [
                        "support",
                        "weights",
                        "domain_poles",
                        "tolerance",
                        "closed",
                        "positions",
                        "steps",
                        "frames",
                        "poles",
                    ];
                    map.insert(names[random.below(names.len())].into(), junk(random));
                }
                _ if deeper => mutate(map.get_mut(&key).unwrap(), random),
                _ => drop(map.insert(key, junk(random))),
            }
        }
        Value::Array(items) if !items.is_empty() => {
            let i = random.below(items.len());
            match random.below(9) {
                0 => drop(items.remove(i)),
                1 => items.push(items[i].clone()),
                _ if deeper => mutate(&mut items[i], random),
                _ => items[i] = junk(random),
            }
        }
        // Mostly another number, such as may be taken.
        Value::Number(_) if random.below(3) > 0 => {
            let numbers = [0.0, 1.0, 2.0, 4.0, -1.0, 0.25, 1e-300, 1e-16, 1e8, 1e50, 1e100, 1e101];
            *value = json!(numbers[random.below(numbers.len())]);
        }
        other => *other = junk(random),
    }
}

#[test]
fn no_body_breaks_the_curve_routes() {
    let server = Server::fresh();
    let generator = with(
        &with(&interpolator("integer_shifts", &zeros(3)), "support", json!(6)),
        "weights",
        json!([-0.5]),
    );
    let arcs = shapes([arc(7, 1), arc(7, 2)]);
    let curves =
        json!({"representation": open(6, &generator), "correspondence": "landmarks", "shapes": arcs});
    let circles = json!({"representation": closed(6, &ellipses()), "shapes": [{"points": circle(6, 1.0)}], "factor": 2});
    let parameters: Vec<f64> = (0..7).map(|k| f64::from(k) / 7.0).collect();
    let bodies = [
        (
            "/v1/evaluate",
            with(
                &with(&with(&curves, "parameters", json!([0, 0.3, 1])), "derivatives", json!(2)),
                "frames",
                json!(true),
            ),
        ),
        ("/v1/evaluate?format=svg", curves.clone()),
        ("/v1/measure", with(&curves, "reference", arcs[1].clone())),
        ("/v1/refine", circles),
        ("/v1/refine", curves.clone()),
        (
            "/v1/fit",
            json!({"representation": {"kind": "open_curve", "dimension": 2, "tolerance": 0.5, "generator": generator}, "shapes": arcs}),
        ),
        (
            "/v1/fit",
            json!({"representation": closed(4, &exponential(&json!([[0, 0], [0, 0.5], [0, -0.5]]))), "shapes": [arcs[0]], "parameters": [parameters]}),
        ),
        (
            "/v1/idealised",
            json!({"representation": closed(6, &ellipses()), "curves": [{"curve": {"name": "ellipse", "semi_axes": [2, 1]}, "centre": [1, 2], "angle": 0.3}]}),
        ),
        (
            "/v1/morph",
            json!({"representation": open(6, &generator), "from": arcs[0], "to": arcs[1], "path": "sphere", "positions": [0, 0.5, 2]}),
        ),
        (
            "/v1/morph?format=svg",
            json!({"representation": open(6, &generator), "from": arcs[0], "to": arcs[1], "steps": 4}),
        ),
        ("/v1/resample", json!({"count": 6, "closed": false, "shapes": arcs})),
        ("/v1/mean", with(&with(&curves, "transformation", json!("affine")), "direction", json!("either"))),
    ];
    let mut random = Random(7);
    let mut taken = 0;
    for round in 0..360 {
        let (path, good) = &bodies[round % bodies.len()];
        let mut body = good.clone();
        for _ in 0..=random.below(2) {
            mutate(&mut body, &mut random);
        }
        let start = Instant::now();
        // The client checks that answers are JSON, that no number was lost, and that refusals are problem documents.
        let reply = server.post(path, &body);
        assert!((200..500).contains(&reply.status), "{path} {body}: {}", reply.text());
        assert!(!reply.text().contains("NaN") && !reply.text().contains("Infinity"), "{path} {body}");
        assert!(start.elapsed() < Duration::from_secs(10), "{path} {body} took {:?}", start.elapsed());
        taken += usize::from(reply.status == 200);
    }
    assert!((20..340).contains(&taken), "{taken} of 360 bodies were taken");
    server.assert_alive();
}
