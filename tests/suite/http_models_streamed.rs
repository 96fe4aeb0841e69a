//! Models of cohorts above the limit of shapes in memory: read as a stream, with the numbers of a service that reads them into memory.

use serde_json::{Value, json};

use crate::http_models::number;
use crate::server::{Server, Setting};

const SHAPES: usize = 150;
/// Limit of the service that streams.
const LIMIT: usize = 60;

/// Triangles and more that depend on a group and an age, some without an age, two of each subject.
fn shapes() -> Vec<Value> {
    let noise = |k: usize, i: usize| ((k * 37 + i * 11 + 5) as f64 * 0.618_033_988_7).fract() - 0.5;
    let shape = |k: usize| {
        let (group, age) = (k % 3, 20.0 + (k % 40) as f64 + 0.25);
        let point = |i: usize| {
            let t = std::f64::consts::TAU * i as f64 / 7.0;
            let bump = 1.0 + 0.1 * group as f64 * (2.0 * t).cos() + 0.002 * age * (3.0 * t).sin();
            let size = 1.0 + 0.3 * noise(k, 90);
            let [x, y] = [bump * t.cos() + 0.05 * noise(k, i), bump * t.sin() + 0.05 * noise(k, 20 + i)];
            [size * x + 2.0 * noise(k, 91), size * (y + 0.3 * x)]
        };
        let mut labels = json!({"group": (["u", "v", "w"][group]), "site": format!("s{}", k / 50)});
        if k % 29 != 3 {
            labels["age"] = json!(age);
        }
        json!({"external_id": format!("shape{k}"), "subject": format!("p{}", k / 2), "labels": labels,
            "points": (0..7).map(point).collect::<Vec<_>>()})
    };
    (0..SHAPES).map(shape).collect()
}

fn fill(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 7});
    server.post("/v1/cohorts", &json!({"name": "plates", "representation": representation})).expect(201);
    for shapes in shapes().chunks(LIMIT / 2) {
        server.post("/v1/cohorts/plates/shapes", &json!({"shapes": shapes})).expect(201);
    }
}

/// The largest relative difference of the numbers of two answers, other fields being equal.
fn difference(found: &Value, expected: &Value, at: &str) -> f64 {
    match (found, expected) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            (a - b).abs() / b.abs().max(1.0)
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{at}");
            let each = a.iter().zip(b).enumerate();
            each.map(|(i, (a, b))| difference(a, b, &format!("{at}/{i}"))).fold(0.0, f64::max)
        }
        (Value::Object(a), Value::Object(b)) => {
            let names = |of: &serde_json::Map<String, Value>| of.keys().cloned().collect::<Vec<_>>();
            assert_eq!(names(a), names(b), "{at}");
            a.iter().map(|(name, a)| difference(a, &b[name], &format!("{at}/{name}"))).fold(0.0, f64::max)
        }
        (a, b) => {
            assert_eq!(a, b, "{at}");
            0.0
        }
    }
}

/// Tables, coefficients, predictions and warnings of the stream are those of the shapes in memory; exchanges are others, and their p values
/// estimates of the same probability.
#[test]
fn models_above_the_limit_are_those_below_it() {
    let (memory, stream) =
        (Server::fresh(), Setting::fresh().flags(&["--max-shapes", &LIMIT.to_string()]).start());
    fill(&memory);
    fill(&stream);
    let bodies = [
        json!({"formula": "~ group*age", "missing": "skip", "permutations": 0}),
        json!({"formula": "~ group + log_centroid_size", "type": "III", "permutations": 0, "strata": "labels.site"}),
        json!({"formula": "~ group", "response": "log_centroid_size", "permutations": 0,
            "transformation": "rigid", "alignment": "procrustes"}),
        json!({"formula": "~ poly(age,2) + group", "missing": "skip", "permutations": 0, "type": "I",
            "filter": {"labels": {"site": ["s0", "s1"]}}, "at": [{"age": 33.5, "group": "v"}]}),
    ];
    for mut body in bodies {
        body["cohort"] = json!("plates");
        let expected = memory.post("/v1/models", &body).expect(200);
        let mut found = stream.post("/v1/models", &body).expect(200);
        assert_eq!((expected.get("streamed"), &found["streamed"]), (None, &json!(true)));
        for term in found["terms"].as_array_mut().unwrap() {
            let asymptotic = term.as_object_mut().unwrap().remove("p_asymptotic");
            assert_eq!(asymptotic.is_some(), body.get("strata").is_none(), "{term}");
        }
        // Different exchanges are counted where shapes share rows of the design.
        let mut expected = expected.clone();
        let terms = found["terms"].as_array_mut().unwrap().iter_mut();
        for (own, other) in terms.zip(expected["terms"].as_array_mut().unwrap()) {
            if own["distinct"].is_null() {
                other["distinct"] = Value::Null;
            }
        }
        for name in ["streamed", "cohort"] {
            found.as_object_mut().unwrap().remove(name);
        }
        expected.as_object_mut().unwrap().remove("cohort");
        // Sums of squares about the mean, of shapes of unit size; aliases and exchanges are told alike.
        let apart = difference(&found, &expected, "");
        assert!(apart < 1e-11, "{body}: {apart:e}");
    }
    let body = json!({"cohort": "plates", "formula": "~ site + group", "permutations": 499});
    let [expected, found] = [&memory, &stream].map(|server| server.post("/v1/models", &body).expect(200));
    for (found, expected) in
        found["terms"].as_array().unwrap().iter().zip(expected["terms"].as_array().unwrap())
    {
        let (own, other, asymptotic) =
            (number(&found["p"]), number(&expected["p"]), number(&found["p_asymptotic"]));
        // Four standard errors of a difference of two estimates; the asymptotic one is off by the number of shapes as well.
        let allowed = 4.0 * (2.0 * other * (1.0 - other) / 500.0).sqrt() + 0.004;
        assert!((own - other).abs() <= allowed, "{own} and {other}");
        assert!((asymptotic - other).abs() <= allowed + 0.03, "{asymptotic} and {other}");
    }
    // The same request is answered with the same exchanges.
    assert_eq!(stream.post("/v1/models", &body).expect(200)["terms"], found["terms"]);
    let compared =
        json!({"cohort": "plates", "reduced": "~ site", "full": "~ site + group", "permutations": 0});
    let [expected, found] =
        [&memory, &stream].map(|server| server.post("/v1/models/compare", &compared).expect(200));
    assert!(difference(&found["residual"], &expected["residual"], "") < 1e-11);
    assert!((number(&found["terms"][0]["f"]) / number(&expected["terms"][0]["f"]) - 1.0).abs() < 1e-11);
    assert_eq!(found["reduced"], expected["reduced"]);
}

#[test]
fn what_a_stream_does_not_answer_is_refused_at_its_place() {
    let stream = Setting::fresh().flags(&["--max-shapes", &LIMIT.to_string()]).start();
    fill(&stream);
    let refused = |mut body: Value, pointer: &str, words: &str| {
        body["cohort"] = json!("plates");
        let problem = stream.post("/v1/models", &body).expect(422);
        let fault = &problem["errors"][0];
        assert_eq!(fault["pointer"], pointer, "{problem}");
        assert!(fault["detail"].as_str().unwrap().contains(words), "{problem}");
    };
    let asked = |name: &str, value: Value| {
        let mut body = json!({"formula": "~ group"});
        body[name] = value;
        body
    };
    for (name, value) in [
        ("pairs", json!({"groups": ["group"]})),
        ("disparity", json!({"groups": ["group"]})),
        ("bands", json!(0.95)),
        ("keep", json!(true)),
        ("blocks", json!("subject")),
        ("manova", json!({})),
        ("response", json!("score 1..2")),
    ] {
        refused(asked(name, value), &format!("/{name}"), "read as a stream");
    }
    refused(json!({"formula": "~ group + (1 | subject)"}), "/formula", "read as a stream");
    refused(json!({"formula": "~ age"}), "/formula", "6 of 150 shapes have no age: shape3, shape32");
    refused(json!({"formula": "~ aeg"}), "/formula", "none of the 150 shapes has aeg");
    refused(json!({"formula": "~ aeg", "missing": "skip"}), "/formula", "none of the 150 shapes has aeg");
    refused(
        json!({"formula": "~ group", "strata": "labels.age"}),
        "/strata",
        "6 of 150 shapes have no labels.age",
    );
    // Fewer shapes, chosen by a filter, are read into memory.
    let few = json!({"cohort": "plates", "formula": "~ group", "filter": {"labels": {"site": "s1"}},
        "pairs": {"groups": ["group"]}, "permutations": 99});
    assert!(stream.post("/v1/models", &few).expect(200)["pairs"].is_object());
}
