//! Pairs, disparity, trajectories, bands and comparisons of linear models of stored shapes, and what is refused.

use serde_json::{Value, json};

use crate::http_dictionaries::finished;
use crate::http_models::{cohort, made, number};
use crate::server::Server;

fn ask(server: &Server, formula: &str, further: Value) -> Value {
    let mut body = json!({"cohort": "made", "formula": formula, "permutations": 199});
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    server.post("/v1/models", &body).expect(200)
}

#[test]
fn pairs_of_means_have_tests_intervals_and_shapes() {
    let server = Server::fresh();
    made(&server);
    let found = ask(&server, "~ treatment*day + age", json!({"pairs": {"groups": ["treatment", "day"]}}));
    let pairs = &found["pairs"];
    assert_eq!(
        (&pairs["null"], &pairs["of"], &pairs["exchange"], &pairs["permutations"]),
        (&json!("~ treatment + day + age"), &json!("means"), &json!("free"), &json!(199))
    );
    let groups = pairs["groups"].as_array().unwrap();
    let names: Vec<&str> = groups.iter().map(|group| group["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["control:d0", "control:d1", "drug:d0", "drug:d1"]);
    assert_eq!(
        (&groups[0]["shape_count"], &groups[0]["shape"][5].as_array().unwrap().len()),
        (&json!(6), &2)
    );
    let list = pairs["pairs"].as_array().unwrap();
    assert_eq!(list.len(), 6);
    for pair in list {
        let (test, interval) = (&pair["distance"], &pair["interval"]);
        let (value, radius) = (number(&test["value"]), number(&interval["radius"]));
        assert!(value > 0.0 && number(&test["critical95"]) > 0.0, "{pair}");
        assert!((number(&interval["high"]) - value - radius).abs() < 1e-12, "{pair}");
        assert!((number(&interval["low"]) - (value - radius).max(0.0)).abs() < 1e-12, "{pair}");
        assert!(number(&test["p_holm"]) >= number(&test["p"]), "{pair}");
        assert!(pair.get("angle").is_none(), "{pair}");
    }
    // Differences from a reference have angles; blocks have no intervals.
    let further = json!({"blocks": "subject", "exchange": "within", "pairs": {"groups": ["treatment", "day"],
        "reference": "control:d0", "statistics": ["angle"], "null": "~ age"}});
    let from = ask(&server, "~ treatment*day + age", further);
    let pairs = &from["pairs"];
    assert_eq!((pairs["groups"].as_array().unwrap().len(), &pairs["null"]), (3, &json!("~ age")));
    assert!(pairs["pairs"][0]["interval"].is_null() && pairs["pairs"][0]["angle"]["value"].is_f64());
    assert!(from["warnings"].to_string().contains("not independent"), "{from}");
    let slopes = ask(
        &server,
        "~ treatment*age",
        json!({"pairs": {"groups": ["treatment"], "of": "slopes", "covariate": "age",
            "statistics": ["distance", "angle", "length_difference"]}}),
    );
    let pair = &slopes["pairs"]["pairs"][0];
    assert!(
        ["distance", "angle", "length_difference"].iter().all(|name| pair[name]["p"].is_f64()),
        "{slopes}"
    );
    assert_eq!(slopes["pairs"]["null"], "~ treatment + age");
    // The same bits again.
    let again = ask(&server, "~ treatment*day + age", json!({"pairs": {"groups": ["treatment", "day"]}}));
    assert_eq!(again["pairs"], found["pairs"]);
}

#[test]
fn groups_scatter_and_move() {
    let server = Server::fresh();
    made(&server);
    let about = |about: &str, further: Value| {
        let mut disparity = json!({"groups": ["treatment"], "about": about});
        disparity.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        ask(&server, "~ treatment*day", json!({"disparity": disparity}))["disparity"].clone()
    };
    let groups = about("groups", json!({}));
    assert_eq!((&groups["formula"], &groups["about"]), (&json!("~ treatment"), &json!("groups")));
    assert!(groups["pairs"][0]["difference"]["p"].is_f64(), "{groups}");
    let partial = about("mean", json!({"partial": true}));
    let sum: f64 = partial["groups"].as_array().unwrap().iter().map(|group| number(&group["variance"])).sum();
    let whole = ask(&server, "~ treatment", json!({}));
    assert!((sum - number(&whole["total"]["sum_of_squares"]) / 23.0).abs() < 1e-12, "{partial}");
    assert_eq!(about("model", json!({"unbiased": true}))["formula"], "~ treatment + day + treatment:day");
    let paths =
        ask(&server, "~ treatment*day", json!({"trajectories": {"groups": ["treatment"], "points": "day"}}));
    let paths = &paths["trajectories"];
    assert_eq!((&paths["points"], &paths["null"]), (&json!(["d0", "d1"]), &json!("~ treatment + day")));
    let pair = &paths["pairs"][0];
    assert!(
        pair["angle"]["p"].is_f64() && pair["length_difference"]["p"].is_f64() && pair["shape"].is_null()
    );
    assert_eq!(paths["groups"][0]["shapes"].as_array().unwrap().len(), 2);
}

#[test]
fn predictions_have_bands() {
    let server = Server::fresh();
    made(&server);
    let at = json!([{"treatment": "drug", "age": 60}, {"treatment": "control"}]);
    let found = ask(&server, "~ treatment*age", json!({"bands": 0.9, "at": at}));
    for prediction in found["predictions"].as_array().unwrap() {
        let band = &prediction["band"];
        // Landmarks are their own places.
        assert_eq!(band["points"].as_array().unwrap().len(), 6);
        for (point, own) in
            band["points"].as_array().unwrap().iter().zip(prediction["shape"].as_array().unwrap())
        {
            assert!((number(&point[0]) - number(&own[0])).abs() < 1e-12, "{prediction}");
        }
        let widths = band["half_width"].as_array().unwrap();
        assert!(widths.iter().all(|width| number(&width[0]) > 0.0 && number(&width[1]) > 0.0));
        assert!(number(&band["simultaneous"]) > 1.0 && number(&band["new_shape"]) > 1.0, "{band}");
    }
    let width = |k: usize| number(&found["predictions"][k]["band"]["deviation"][0]);
    assert!(width(0) > width(1), "outside of the data they are wider");
    let size = ask(&server, "~ treatment", json!({"bands": 0.95, "response": "log_centroid_size"}));
    assert_eq!(size["predictions"][0]["band"]["half_width"].as_array().unwrap().len(), 1);
    let picture = json!({"cohort": "made", "formula": "~ treatment*day", "permutations": 99, "bands": 0.95,
        "pairs": {"groups": ["treatment"]}});
    let picture = server.post("/v1/models?format=svg", &picture);
    let picture = picture.expect_svg();
    assert!(
        picture.contains("control – drug: distance") && picture.contains("of all places together"),
        "{picture}"
    );
}

#[test]
fn nested_models_are_compared() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "reduced": "~ treatment + day", "full": "~ treatment*day", "permutations": 199});
    let found = server.post("/v1/models/compare", &body).expect(200);
    let table = ask(&server, "~ treatment*day", json!({"type": "I"}));
    let (row, own) = (&table["terms"][2], &found["terms"][0]);
    assert_eq!(found["terms"].as_array().unwrap().len(), 1);
    assert_eq!((&own["term"], &own["df"], &own["p"]), (&row["term"], &row["df"], &row["p"]));
    assert!((number(&own["f"]) - number(&row["f"])).abs() < 1e-9, "{found}");
    assert_eq!(
        (&found["reduced"], &found["formula"]),
        (&json!("~ treatment + day"), &json!("~ treatment + day + treatment:day"))
    );
    server.post("/v1/models/compare?format=svg", &body).expect_svg();
    let refused = |changes: &[(&str, Value)], pointer: &str, said: &str| {
        let mut body = body.clone();
        changes.iter().for_each(|(name, value)| body[name] = value.clone());
        let problem = server.post("/v1/models/compare", &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{changes:?}: {problem}"
        );
    };
    refused(&[("reduced", json!("~ age"))], "/reduced", "a model within");
    refused(&[("reduced", json!("~ treatment*day"))], "/reduced", "a smaller model");
    refused(&[("reduced", json!("~ ("))], "/reduced", "character");
    refused(&[("full", json!("~ colour"))], "/full", "none of the 24 shapes has colour");
    refused(
        &[("full", json!("~ treatment + (1 | subject)")), ("reduced", json!("~ 1"))],
        "/full",
        "random parts",
    );
    let mixed =
        [("reduced", json!("~ 1")), ("full", json!("~ treatment + day")), ("blocks", json!("subject"))];
    refused(&mixed, "/exchange", "some vary within the blocks");
}

#[test]
fn what_does_not_fit_the_model_is_refused_at_its_place() {
    let server = Server::fresh();
    made(&server);
    let refused = |further: Value, pointer: &str, said: &str| {
        let mut body = json!({"cohort": "made", "formula": "~ treatment*day + age", "permutations": 9});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        let problem = server.post("/v1/models", &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{further}: {problem}"
        );
    };
    let pairs = |further: Value| {
        let mut pairs = json!({"groups": ["treatment"]});
        pairs.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        json!({"pairs": pairs})
    };
    refused(pairs(json!({"groups": ["site"]})), "/pairs/groups", "treatment, day, got 'site'");
    refused(pairs(json!({"of": "slopes"})), "/pairs/covariate", "got none");
    refused(pairs(json!({"of": "slopes", "covariate": "day"})), "/pairs/covariate", "age, got 'day'");
    refused(pairs(json!({"of": "slopes", "covariate": "age"})), "/pairs/covariate", "interaction");
    refused(pairs(json!({"of": "medians"})), "/pairs/of", "means");
    refused(pairs(json!({"statistics": ["angle"]})), "/pairs/statistics", "depend on the origin");
    refused(pairs(json!({"null": "~ sin(age)"})), "/pairs/null", "log, sqrt");
    refused(pairs(json!({"null": "~ colour"})), "/pairs/null", "none of the 24 shapes has colour");
    refused(pairs(json!({"null": "~ log(age)"})), "/pairs/null", "a model within");
    refused(pairs(json!({"confidence": 95})), "/pairs/confidence", "between 0 and 1");
    refused(pairs(json!({"colour": 1})), "/pairs/colour", "colour");
    refused(
        json!({"disparity": {"groups": ["treatment"], "partial": true}}),
        "/disparity/partial",
        "the `mean`",
    );
    let paths = json!({"trajectories": {"groups": ["treatment"], "points": "treatment"}});
    refused(paths, "/trajectories/points", "again");
    refused(json!({"bands": 95}), "/bands", "between 0 and 1");
    refused(json!({"samples": 9}), "/samples", "`bands`");
    refused(json!({"bands": 0.9, "samples": 9}), "/samples", "landmarks are compared as they are");
    let random = json!({"formula": "~ treatment + (1 | subject)", "bands": 0.9});
    refused(random, "/bands", "random parts");
}

/// The job reads its options from the stored plan.
#[test]
fn long_pairs_are_a_job() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "formula": "~ treatment*day + age", "permutations": 100_000, "bands": 0.9,
        "at": vec![json!({"day": "d1"}); 60], "pairs": {"groups": ["treatment", "day"]}});
    let job = server.post("/v1/models", &body).expect(202);
    let done = finished(&server, job["id"].as_str().unwrap());
    let found = &done["result"];
    assert_eq!(found["pairs"]["pairs"].as_array().unwrap().len(), 6, "{done}");
    assert!(found["predictions"][59]["band"]["simultaneous"].is_f64());
}

/// Values of RRPP 2.1.2 on the same coordinates, to the digits in which alignments agree.
#[test]
fn salamanders_differ_as_in_rrpp() {
    let server = Server::fresh();
    if !cohort(&server, "landmarks-plethodon", &[]) {
        return;
    }
    let body = json!({"cohort": "landmarks-plethodon", "formula": "~ species*site", "permutations": 999,
        "pairs": {"groups": ["species", "site"], "null": "~ 1"}, "disparity": {"groups": ["species", "site"]},
        "trajectories": {"groups": ["species"], "points": "site"}});
    let found = server.post("/v1/models", &body).expect(200);
    // Balanced: the squared distances of the four means from their mean are the sum of squares of the model.
    let pairs = found["pairs"]["pairs"].as_array().unwrap();
    let squares: f64 = pairs.iter().map(|pair| number(&pair["distance"]["value"]).powi(2)).sum();
    let model = number(&found["total"]["sum_of_squares"]) - number(&found["residual"]["sum_of_squares"]);
    assert!((squares * 10.0 / 4.0 - model).abs() < 1e-12, "{squares} {model}");
    // The variances within the groups are the residual sum of squares.
    let groups = found["disparity"]["groups"].as_array().unwrap();
    let within: f64 = groups.iter().map(|group| 10.0 * number(&group["variance"])).sum();
    assert!((within - number(&found["residual"]["sum_of_squares"])).abs() < 1e-12);
    // Two points: a trajectory is as long as the distance of its ends, and the paths differ by the interaction.
    let paths = &found["trajectories"];
    let distance = |a: &str, b: &str| {
        let is_it = |pair: &&Value| pair["first"] == a && pair["second"] == b;
        number(&pairs.iter().find(is_it).unwrap()["distance"]["value"])
    };
    for (k, species) in ["Jord", "Teyah"].iter().enumerate() {
        let own = distance(&format!("{species}:Allo"), &format!("{species}:Symp"));
        assert!((own - number(&paths["groups"][k]["length"])).abs() < 1e-12, "{paths}");
    }
    assert!(number(&paths["pairs"][0]["angle"]["p"]) <= 0.01, "{paths}");
}
