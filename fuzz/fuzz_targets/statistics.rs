//! Statistics of small cohorts without variation: copies, one shape, points on a line or in one place, weights far apart. Posted and
//! stored shapes are averaged, compared, regressed and decomposed.

#![no_main]

use axum::body::Body;
use axum::http::{Method, Request, StatusCode};
use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use shapelex_fuzz::{Draws, Service, content_type, post};

const WEIGHTS: [f64; 5] = [1.0, 2.0, 1e-100, 1e16, 1e100];
const CLASSES: [&str; 6] =
    ["translation", "rigid", "uniform_scaling", "similarity", "non_uniform_scaling", "affine"];
const ALIGNMENTS: [&str; 3] = ["projection", "procrustes", "partial_procrustes"];
const POINTS: usize = 5;

fn representation(draws: &mut Draws<'_>, dimension: usize) -> Value {
    match draws.byte() % 2 {
        0 => json!({"kind": "landmarks", "dimension": dimension, "points": POINTS}),
        _ => json!({"kind": "closed_curve", "dimension": dimension, "control_points": POINTS,
            "generator": {"name": "cubic"}}),
    }
}

/// A shape that is like the one before, on a line, flat, in one place, or none of these.
fn points(draws: &mut Draws<'_>, dimension: usize, before: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let kind = draws.byte() % 5;
    if kind == 0 && !before.is_empty() {
        return before.to_vec();
    }
    let mut points = [[0.0; 3]; POINTS].map(|point| point.map(|_: f64| draws.coordinate()));
    match kind {
        1 => points = points.map(|[x, ..]| [x, 2.0 * x, -x]),
        2 => points = points.map(|[x, y, _]| if dimension == 2 { [x, 0.0, 0.0] } else { [x, y, 0.0] }),
        3 => points = [points[0]; POINTS],
        _ => draws.disturb(&mut points),
    }
    points.iter().map(|point| point[..dimension].to_vec()).collect()
}

fn shapes(draws: &mut Draws<'_>, dimension: usize) -> Vec<Value> {
    let mut before = Vec::new();
    let count = draws.between(1, 9);
    let shape = |k: usize| {
        before = points(draws, dimension, &before);
        json!({"points": before, "weight": draws.one(&WEIGHTS), "label": draws.one(&["a", "b", "c"]),
            "subject": draws.one(&["s", "t", "u"]), "labels": {"age": draws.byte(), "k": k}})
    };
    (0..count).map(shape).collect()
}

/// A body with further members.
fn with(body: &Value, more: Value) -> Value {
    let (mut body, Value::Object(more)) = (body.clone(), more) else { return Value::Null };
    body.as_object_mut().expect("an object").extend(more);
    body
}

fn send(method: Method, target: &str, body: &Value) -> StatusCode {
    let request = Request::builder().method(method).uri(target).header("content-type", "application/json");
    let request = request.body(Body::from(body.to_string())).expect("a request");
    let (status, headers, answer) = Service::get().send(request);
    assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{target}: {status} {answer:?} for {body}");
    assert_eq!(status.is_client_error(), content_type(&headers) == "application/problem+json", "{target}");
    status
}

fuzz_target!(|data: &[u8]| {
    let mut draws = Draws(data);
    let dimension = draws.between(2, 3);
    let representation = representation(&mut draws, dimension);
    let (class, alignment) = (*draws.one(&CLASSES), *draws.one(&ALIGNMENTS));
    let (components, centre) = (draws.between(1, 4), draws.byte() % 2 == 0);
    let shapes = shapes(&mut draws, dimension);
    let settings = json!({"representation": representation, "shapes": shapes, "transformation": class,
        "alignment": alignment});
    for path in ["/v1/mean", "/v1/align", "/v1/distances"] {
        post(path, &settings);
    }
    post("/v1/pca", &with(&settings, json!({"components": components, "centre": centre})));
    let cohort = json!({"name": "drawn", "representation": representation, "correspondence": "landmarks"});
    if send(Method::POST, "/v1/cohorts", &cohort) != StatusCode::CREATED {
        return;
    }
    if send(Method::POST, "/v1/cohorts/drawn/shapes", &json!({"shapes": shapes})).is_success() {
        let stored = json!({"cohort": "drawn", "transformation": class, "alignment": alignment});
        for by in ["label", "labels.age"] {
            send(
                Method::POST,
                "/v1/comparisons",
                &with(&stored, json!({"by": by, "permutations": 19, "samples": 8})),
            );
        }
        for attribute in ["labels.age", "log_centroid_size"] {
            let body = with(&stored, json!({"attribute": attribute, "permutations": 19}));
            send(Method::POST, "/v1/regressions", &body);
        }
        for formula in ["~ label", "~ age*label", "~ poly(age,2) + log_centroid_size", "~ 0 + label/factor(age)"] {
            for kind in ["I", "II", "III"] {
                let body = with(&stored, json!({"formula": formula, "type": kind, "permutations": 19}));
                send(Method::POST, "/v1/models", &body);
            }
        }
        send(Method::GET, &format!("/v1/cohorts/drawn/mean?transformation={class}&format=svg"), &Value::Null);
    }
    send(Method::DELETE, "/v1/cohorts/drawn", &Value::Null);
});
