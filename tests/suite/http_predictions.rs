//! Predictions of kept linear models: equal to those of the model, quick, and what is refused.

use std::time::Instant;

use serde_json::{Value, json};

use crate::http_dictionaries::finished;
use crate::http_models::{made, number};
use crate::server::{Server, assert_close};

/// The finished job that keeps a model.
fn kept(server: &Server, formula: &str, further: Value) -> Value {
    let mut body = json!({"cohort": "made", "formula": formula, "permutations": 199, "keep": true});
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    let job = server.post("/v1/models", &body).expect(202);
    let job = finished(server, job["id"].as_str().unwrap());
    assert_eq!(job["status"], "succeeded", "{job}");
    job
}

fn address(job: &Value) -> String {
    format!("/v1/models/{}/predictions", job["id"].as_str().unwrap())
}

#[test]
fn kept_models_predict_as_they_did() {
    let server = Server::fresh();
    made(&server);
    let at = json!([{"treatment": "drug", "age": 60}, {"treatment": "control"}, {"age": 45}, {}]);
    // A polynomial, a factor over which is averaged, and numbers at their mean.
    let formula = "~ treatment * poly(age,2) + day";
    let job = kept(&server, formula, json!({"bands": 0.9, "at": at}));
    let (address, model) = (address(&job), &job["result"]);
    assert_eq!((&model["kept_at"], &model["kept"]), (&json!(address), &Value::Null));
    let found = server.post(&address, &json!({"at": at, "bands": 0.9})).expect(200);
    assert_eq!(
        (&found["model"], &found["draws"], &found["shape_count"], &found["cohort_revision"]),
        (&job["id"], &json!(199), &json!(24), &json!(1))
    );
    assert_eq!((&found["formula"], &found["response"]), (&model["formula"], &json!("shape")));
    for (own, wanted) in
        found["predictions"].as_array().unwrap().iter().zip(model["predictions"].as_array().unwrap())
    {
        for name in ["at", "extrapolated"] {
            assert_eq!(own[name], wanted[name]);
        }
        for name in ["shape", "leverage"] {
            assert_close(&own[name], &wanted[name], 1e-11, name);
        }
        let (own, wanted) = (&own["band"], &wanted["band"]);
        for name in ["points", "half_width", "new_shape", "deviation", "covariance"] {
            assert_close(&own[name], &wanted[name], 1e-10, name);
        }
        // Draws are kept to seven digits.
        assert_close(&own["simultaneous"], &wanted["simultaneous"], 1e-5, "simultaneous");
    }
    // One prediction by its address: texts are levels or numbers, as the attribute is.
    let get = |query: &str| server.get(&format!("{address}{query}"));
    let one = get("?at.treatment=drug&at[age]=60&bands=0.9").expect(200);
    assert_eq!(one["predictions"][0], found["predictions"][0]);
    assert_eq!(get("").expect(200)["predictions"][0]["band"], Value::Null);
    let picture = get("?at.treatment=drug&bands=0.9&format=svg");
    assert!(picture.expect_svg().contains("of all places together"));
    server.post(&format!("{address}?format=svg"), &json!({"at": at})).expect_svg();
    let table = server.post(&format!("{address}?format=csv"), &json!({"at": at}));
    assert_eq!(table.text().lines().count(), 5, "{}", table.text());
    // What is kept is no matrix and no file.
    server.get(&format!("/v1/jobs/{}/output", job["id"].as_str().unwrap())).expect_problem(
        404,
        "not-found",
        &[],
    );
    let mut times: Vec<f64> = (0..200)
        .map(|k| {
            let begun = Instant::now();
            get(&format!("?at.age={}&bands=0.95", 40 + k % 20)).expect(200);
            begun.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("a prediction with bands: p50 {:.2} ms, p95 {:.2} ms", 1e3 * times[100], 1e3 * times[190]);
}

#[test]
fn numbers_blocks_and_random_parts_are_kept_too() {
    let server = Server::fresh();
    made(&server);
    let size = kept(&server, "~ treatment + age", json!({"response": "log_centroid_size", "bands": 0.95}));
    let found =
        server.post(&address(&size), &json!({"at": [{"treatment": "control"}], "bands": 0.95})).expect(200);
    let (own, wanted) = (&found["predictions"][0], &size["result"]["predictions"][0]);
    assert_close(&own["value"], &wanted["value"], 1e-12, "value");
    assert_close(&own["band"]["half_width"], &wanted["band"]["half_width"], 1e-10, "half width");
    // Shapes of blocks are not independent.
    let blocks = kept(&server, "~ treatment + day", json!({"blocks": "subject"}));
    let found = server.get(&format!("{}?at.day=d1&bands=0.95", address(&blocks))).expect(200);
    let band = &found["predictions"][0]["band"];
    assert!(band["simultaneous"].is_null() && band["half_width"][0][0].is_f64(), "{found}");
    assert_eq!(found["draws"], 0);
    let random = address(&kept(&server, "~ treatment + day + (1 | subject)", json!({})));
    assert!(server.get(&random).expect(200)["predictions"][0]["shape"].is_array());
    server.get(&format!("{random}?bands=0.95")).expect_problem(400, "invalid-query", &[]);
    let refused = server.post(&random, &json!({"at": [{}], "bands": 0.95}));
    refused.expect_problem(422, "invalid-input", &["/bands"]);
}

#[test]
fn what_a_kept_model_cannot_predict_is_refused() {
    let server = Server::fresh();
    made(&server);
    let model = address(&kept(&server, "~ treatment*subject + age", json!({"samples": 6})));
    let post = |body: Value, pointers: &[&str]| {
        server.post(&model, &body).expect_problem(422, "invalid-input", pointers)
    };
    let problem = post(json!({"at": [{}, {"treatment": "other"}]}), &["/at/1/treatment"]);
    assert!(problem.to_string().contains("'control', 'drug'"), "{problem}");
    post(json!({"at": [{"side": "left"}]}), &["/at/0/side"]);
    post(json!({"at": [{"age": "old"}]}), &["/at/0/age"]);
    // No subject has both treatments.
    server.post(&model, &json!({"at": [{"treatment": "control", "subject": "p0"}]})).expect(200);
    let problem = post(json!({"at": [{}, {"treatment": "drug", "subject": "p0"}]}), &["/at/1"]);
    assert!(problem.to_string().contains("that the shapes determine"), "{problem}");
    server.get(&format!("{model}?at.treatment=drug&at.subject=p0")).expect(400);
    post(json!({"at": []}), &["/at"]);
    post(json!({"at": vec![json!({}); 101]}), &["/at"]);
    post(json!({"at": [{}], "bands": 1}), &["/bands"]);
    post(json!({}), &["/at"]);
    for query in ["?at.side=left", "?at.age=old", "?bands=2", "?bands=x", "?age=60", "?at.age=1&at.age=2"] {
        server.get(&format!("{model}{query}")).expect(400);
    }
    server.get("/v1/models/job_none/predictions").expect_problem(404, "not-found", &[]);
    // A job that keeps nothing.
    let body = json!({"cohort": "made", "transformation": "similarity"});
    let other = server.post("/v1/distances", &body);
    assert!(other.text().contains("distances") || other.json()["id"].is_string());
    let body = json!({"cohort": "made", "formula": "~ treatment", "permutations": 9, "samples": 8});
    server.post("/v1/models", &body).expect_problem(422, "invalid-input", &["/samples"]);
}

/// With and without bands, whether the model is kept or not.
#[test]
fn values_that_the_shapes_do_not_determine_are_never_predicted() {
    let server = Server::fresh();
    made(&server);
    let post = |further: Value| {
        let mut body = json!({"cohort": "made", "formula": "~ treatment*subject + age", "permutations": 9});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/models", &body)
    };
    // No subject has both treatments.
    let at = json!([{"subject": "p0", "treatment": "control"}, {"subject": "p0", "treatment": "drug"}]);
    for further in [
        json!({"at": at}),
        json!({"at": at, "bands": 0.95}),
        json!({"at": at, "response": "age", "formula": "~ treatment*subject"}),
    ] {
        let problem = post(further).expect_problem(422, "invalid-input", &["/at/1"]);
        assert!(problem.to_string().contains("that the shapes determine"), "{problem}");
    }
    let determined = post(json!({"at": [at[0], {"subject": "p4", "treatment": "drug"}]})).expect(200);
    assert_eq!(determined["predictions"].as_array().unwrap().len(), 2);
    // The usual places, one a treatment, are averages over all subjects.
    let usual = post(json!({})).expect(200);
    assert_eq!(usual["predictions"], json!([]), "{usual}");
    assert!(
        usual["warnings"].to_string().contains("2 of 2 usual predictions are left out"),
        "{}",
        usual["warnings"]
    );
    let additive = post(json!({"formula": "~ treatment + age"})).expect(200);
    assert_eq!(additive["predictions"].as_array().unwrap().len(), 2);
    assert!(!additive["warnings"].to_string().contains("left out"));
}

#[test]
fn a_waiting_client_learns_where_the_predictions_are() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "formula": "~ treatment", "permutations": 9, "keep": true});
    let request = server.request(reqwest::Method::POST, "/v1/models").header("prefer", "wait=30").json(&body);
    let found = server.send(request).expect(200);
    let kept = server.get(found["kept_at"].as_str().unwrap()).expect(200);
    // Too few draws for a quantile are not kept.
    assert_eq!(kept["draws"], 0);
    assert!(number(&kept["predictions"][0]["leverage"]) > 0.0);
    // Erasing or deleting the cohort takes the predictions away.
    assert_eq!(server.delete("/v1/cohorts/made").status, 204);
    server.get(found["kept_at"].as_str().unwrap()).expect_problem(404, "not-found", &[]);
}
