//! What real files and earlier answers contain, over HTTP: repeated points, the service's own fields, contours walked twice.

use serde_json::{Value, json};

use crate::server::{Server, pointers_of};

const NDJSON: &str = "application/x-ndjson";

fn new_cohort(server: &Server, name: &str, correspondence: &str) {
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 8,
                                "generator": {"name": "trigonometric"}});
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
}

fn stored(server: &Server, cohort: &str) -> Vec<Value> {
    let page = server.get(&format!("/v1/cohorts/{cohort}/shapes")).expect(200);
    page["items"].as_array().unwrap().clone()
}

const PLAIN: [[f64; 2]; 5] = [[0., 0.], [4., 0.], [4., 1.], [2., 3.], [0., 1.]];
/// The same contour with three repeated points, closed like a ring of other formats.
const REPEATED: [[f64; 2]; 9] =
    [[0., 0.], [0., 0.], [4., 0.], [4., 1.], [2., 3.], [2., 3.], [2., 3.], [0., 1.], [0., 0.]];

#[test]
fn repeated_points_are_dropped_and_counted() {
    let server = Server::fresh();
    for correspondence in ["arc_length", "cyclic"] {
        new_cohort(&server, correspondence, correspondence);
        let path = format!("/v1/cohorts/{correspondence}/shapes");
        let shapes = json!({"shapes": [{"points": PLAIN}, {"points": REPEATED}]});
        let answer = server.post(&path, &shapes).expect(201);
        assert_eq!((&answer["added"], &answer["repeated_points"]), (&json!(2), &json!(3)), "{answer}");
        let line = json!({"points": REPEATED}).to_string();
        let answer = server.post_bytes(&path, NDJSON, format!("{line}\n{line}\n")).expect(201);
        assert_eq!(answer["repeated_points"], 6, "{answer}");
        let shapes = stored(&server, correspondence);
        assert!(shapes.iter().all(|shape| shape["control_points"] == shapes[0]["control_points"]));
    }
    // Landmarks keep theirs.
    new_cohort(&server, "landmarks", "landmarks");
    let points = [[0, 0], [2, 0], [2, 0], [4, 0], [4, 2], [4, 4], [0, 4], [0, 4]];
    let answer = server.post("/v1/cohorts/landmarks/shapes", &json!({"shapes": [{"points": points}]}));
    assert_eq!(answer.expect(201)["repeated_points"], 0);
}

#[test]
fn repeated_points_are_refused_on_request_and_when_too_few_are_left() {
    let server = Server::fresh();
    new_cohort(&server, "contours", "arc_length");
    let shapes = |points: Value| json!({"shapes": [{"points": PLAIN}, {"points": points}]});
    let path = "/v1/cohorts/contours/shapes?repeated_points=refuse";
    let problem = server.post(path, &shapes(json!(REPEATED))).expect(422);
    assert_eq!(pointers_of(&problem), ["/shapes/1/points/1"], "{problem}");
    let said = problem["errors"][0]["detail"].as_str().unwrap();
    assert!(said.starts_with("points 0 and 1 are equal"), "{said}");
    let skipped = server.post(&format!("{path}&on_error=skip"), &shapes(json!(REPEATED))).expect(201);
    assert_eq!((&skipped["skipped"], &skipped["repeated_points"]), (&json!(1), &json!(0)), "{skipped}");
    server.post("/v1/cohorts/contours/shapes?repeated_points=keep", &shapes(json!(PLAIN))).expect(400);

    let few = json!([[0, 0], [0, 0], [1, 1], [1, 1], [0, 0]]);
    let problem = server.post("/v1/cohorts/contours/shapes", &shapes(few)).expect(422);
    assert_eq!(pointers_of(&problem), ["/shapes/1/points"], "{problem}");
    let said = problem["errors"][0]["detail"].as_str().unwrap();
    assert!(said.contains("expected at least 3") && said.contains("got 2 and 2 repeated"), "{said}");
    let all =
        server.post("/v1/cohorts/contours/shapes", &shapes(json!([[1, 1], [1, 1], [1, 1]]))).expect(422);
    assert!(all["detail"].as_str().unwrap().contains("points coincide"), "{all}");
}

#[test]
fn clockwise_rings_and_repeated_points_are_read_wherever_contours_are_resampled() {
    let server = Server::fresh();
    let ring = |points: &[[i32; 2]]| json!({"points": points});
    let shapes = [
        ring(&[[0, 0], [0, 2], [3, 2], [3, 2], [3, 0], [0, 0], [0, 0]]),
        ring(&[[0, 0], [0, 2], [4, 0], [0, 0]]),
    ];
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 12, "generator": {"name": "cubic"}});
    let mean = json!({"representation": representation, "transformation": "similarity", "direction": "either",
                      "correspondence": "cyclic", "shapes": shapes});
    server.post("/v1/mean", &mean).expect(200);
    let measure = json!({"representation": representation, "correspondence": "arc_length", "shapes": shapes});
    server.post("/v1/measure", &measure).expect(200);
    let resampled = server.post("/v1/resample", &json!({"count": 4, "shapes": [shapes[0]]})).expect(200);
    let plain = server
        .post("/v1/resample", &json!({"count": 4, "shapes": [ring(&[[0, 0], [0, 2], [3, 2], [3, 0]])]}));
    assert_eq!(resampled, plain.expect(200));
}

#[test]
fn what_is_read_can_be_posted() {
    let server = Server::fresh();
    new_cohort(&server, "first", "cyclic");
    new_cohort(&server, "second", "cyclic");
    let shapes = json!({"shapes": [
        {"points": PLAIN, "external_id": "a", "label": "x", "labels": {"age": 3}, "weight": 2.0, "metadata": {"n": [1]}},
        {"points": REPEATED}
    ]});
    server.post("/v1/cohorts/first/shapes", &shapes).expect(201);
    let items = stored(&server, "first");
    assert!(items[1]["external_id"].is_null() && items[0]["id"] != items[1]["id"]);
    server.post("/v1/cohorts/second/shapes", &json!({"shapes": items})).expect(201);
    let copies = stored(&server, "second");
    for (item, copy) in items.iter().zip(&copies) {
        for field in ["external_id", "subject", "label", "labels", "weight", "metadata"] {
            assert_eq!(item[field], copy[field], "{field}");
        }
        assert_ne!(item["id"], copy["id"]);
    }
    // Posting them again adds those without an external id only.
    let line = items[0].to_string();
    let again = server.post_bytes("/v1/cohorts/second/shapes", NDJSON, line).expect(201);
    assert_eq!(again["added"], 0);

    // An id of the service is no external id; both kinds of points stay refused.
    let mine = json!({"shapes": [{"id": "mine", "points": PLAIN}]});
    server.post("/v1/cohorts/first/shapes", &mine).expect(201);
    assert!(stored(&server, "first")[2]["external_id"].is_null());
    let mut both = items[0].clone();
    both["points"] = json!(PLAIN);
    let problem = server.post("/v1/cohorts/second/shapes", &json!({"shapes": [both]})).expect(422);
    assert_eq!(pointers_of(&problem), ["/shapes/0"]);
}

#[test]
fn a_contour_walked_twice_is_itself() {
    let server = Server::fresh();
    let square = [[0, 0], [8, 0], [8, 8], [0, 8]];
    let body = json!({"first": {"contour": square.repeat(2)}, "second": {"contour": square}});
    let answer = server.post("/v1/overlap", &body).expect(200);
    assert_eq!((&answer["jaccard"], &answer["hausdorff"]), (&json!(1.0), &json!(0.0)), "{answer}");
    assert!(answer["warnings"].to_string().contains("winding number"), "{answer}");
}

#[test]
fn a_pole_grid_to_start_from_covers_the_sphere_once() {
    let server = Server::fresh();
    let body =
        json!({"scheme": "blob", "lambda": std::f64::consts::FRAC_PI_3, "level": 4, "start": "pole_grid"});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    assert!(answer["volume"].as_f64().unwrap() > 0.1, "{}", answer["volume"]);
    assert_eq!(answer["self_intersecting"], false);
    // One name for two meshes: the answer says which one it is.
    assert!(answer["warnings"].to_string().contains("sphere_grid"), "{}", answer["warnings"]);
    let mut body = body;
    body["start"] = json!("sphere_grid");
    let named = server.post("/v1/subdivide", &body).expect(200);
    assert_eq!((&named["mesh"], &named["warnings"]), (&answer["mesh"], &json!([])));
    // Stored under this name, it keeps its 36 vertices.
    let representation = json!({"kind": "subdivision", "scheme": "blob", "lambda": 1.0, "level": 2, "connectivity": "pole_grid"});
    let cohort = json!({"name": "grids", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    let problem =
        server.post("/v1/cohorts/grids/shapes", &json!({"shapes": [{"control_points": [[0, 0, 0]]}]}));
    assert!(problem.expect(422)["detail"].as_str().unwrap().contains("expected 36 control points"));
}

#[test]
fn a_filter_on_an_attribute_that_no_shape_has_is_refused() {
    let server = Server::fresh();
    new_cohort(&server, "plates", "cyclic");
    let shape = |k: usize| {
        let points: Vec<[f64; 2]> = PLAIN.iter().map(|[x, y]| [x * (1.0 + k as f64), *y]).collect();
        json!({"points": points, "external_id": k.to_string(), "label": "a", "labels": {"plate": k % 2, "once": null}})
    };
    let mut shapes: Vec<Value> = (0..6).map(shape).collect();
    shapes[5]["labels"] = json!({"a/b": "x"});
    // In a cohort without shapes any attribute may come later.
    assert_eq!(server.get("/v1/cohorts/plates/shapes?labels.plaet=1").expect(200)["items"], json!([]));
    server.post("/v1/cohorts/plates/shapes", &json!({ "shapes": shapes })).expect(201);

    let list = |query: &str| server.get(&format!("/v1/cohorts/plates/shapes?{query}"));
    assert_eq!(list("labels.plate=none").expect(200)["items"], json!([]));
    assert_eq!(list("labels.plate=1").expect(200)["items"].as_array().unwrap().len(), 2);
    let problem = list("labels.plaet=1&subject=x&label=a").expect(400);
    let names: Vec<&Value> =
        problem["errors"].as_array().unwrap().iter().map(|error| &error["parameter"]).collect();
    // That there is nothing of a subject is an answer.
    assert_eq!(names, ["labels.plaet"], "{problem}");
    let said = problem["errors"][0]["detail"].as_str().unwrap();
    assert!(
        said.ends_with("the attributes of the cohort are label, labels.a/b, labels.once, labels.plate"),
        "{said}"
    );
    let mean = server.get("/v1/cohorts/plates/mean?transformation=similarity&labels.plaet=1").expect(400);
    assert_eq!(mean["errors"][0]["parameter"], "labels.plaet");

    let filter = json!({"labels": {"c/d": "1"}});
    let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
    for (path, body, pointer) in [
        (
            "/v1/dictionaries",
            json!({"name": "p", "cohort": "plates", "transformation": "similarity", "method": method, "filter": filter}),
            "/filter",
        ),
        (
            "/v1/distances",
            json!({"cohort": "plates", "transformation": "similarity", "filter": filter}),
            "/filter",
        ),
        ("/v1/comparisons", json!({"cohort": "plates", "by": "label", "filter": filter}), "/filter"),
        (
            "/v1/comparisons",
            json!({"cohort": "plates", "groups": [{"name": "a", "filter": filter}, {"name": "b", "filter": {"label": "a"}}]}),
            "/groups/0/filter",
        ),
        (
            "/v1/regressions",
            json!({"cohort": "plates", "attribute": "labels.plate", "filter": filter}),
            "/filter",
        ),
        ("/v1/models", json!({"cohort": "plates", "formula": "~ plate", "filter": filter}), "/filter"),
        (
            "/v1/models/compare",
            json!({"cohort": "plates", "reduced": "~ 1", "full": "~ plate", "filter": filter}),
            "/filter",
        ),
        ("/v1/repeatability", json!({"cohort": "plates", "subject": "plate", "filter": filter}), "/filter"),
        (
            "/v1/two-blocks",
            json!({"cohort": "plates", "y": {"labels": ["labels.plate"]}, "filter": filter}),
            "/filter",
        ),
        (
            "/v1/two-blocks",
            json!({"cohort": "plates", "y": {"cohort": "plates", "filter": filter}}),
            "/y/filter",
        ),
        ("/v1/slide", json!({"cohort": "plates", "sliders": [[0, 1, 2]], "filter": filter}), "/filter"),
        ("/v1/symmetry", json!({"cohort": "plates", "kind": "object", "filter": filter}), "/filter"),
        (
            "/v1/modularity",
            json!({"cohort": "plates", "modules": {"a": {"range": [0, 0.4]}, "b": {"range": [0.5, 0.9]}}, "filter": filter}),
            "/filter",
        ),
        ("/v1/cohorts/plates/search", json!({"shapes": [{"points": PLAIN}], "filter": filter}), "/filter"),
    ] {
        let problem = server.post(path, &body).expect(422);
        assert_eq!(pointers_of(&problem), [format!("{pointer}/labels/c~1d")], "{path}: {problem}");
    }
    // Attributes of deleted shapes are gone.
    assert_eq!(list("labels.a/b=y").expect(200)["items"], json!([]));
    assert_eq!(server.delete("/v1/cohorts/plates/shapes/5").status, 204);
    list("labels.a/b=y").expect(400);
}
