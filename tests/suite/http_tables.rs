//! Measures, filters, ordered lists, summaries of attributes and tables over HTTP.

use std::collections::BTreeSet;

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting, pointers_of};

/// A cohort of landmarks without shapes.
fn no_squares(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    let body = json!({"name": "squares", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &body).expect(201);
}

/// Squares with sides 2, 4, … in a cohort of landmarks, with attributes.
fn squares(server: &Server, count: usize) {
    no_squares(server);
    let shapes: Vec<Value> = (0..count).map(square).collect();
    server.post("/v1/cohorts/squares/shapes", &json!({"shapes": shapes})).expect(201);
}

fn square(index: usize) -> Value {
    let side = (1 + index) as f64;
    let points = [[1., 1.], [-1., 1.], [-1., -1.], [1., -1.]].map(|point| point.map(|c| c * side));
    let label = ["a", "b", "c"][index % 3];
    let site = if index.is_multiple_of(2) { "zrh" } else { "gva" };
    let mut shape = json!({
        "external_id": format!("q{index:02}"), "points": points, "label": label,
        "labels": {"age": 30 + index, "site": site, "fresh": index < 5}
    });
    if index % 4 == 3 {
        shape["labels"].as_object_mut().unwrap().remove("site");
    }
    shape
}

fn names(page: &Value) -> Vec<String> {
    let items = page["items"].as_array().unwrap();
    items.iter().map(|item| item["external_id"].as_str().unwrap().to_owned()).collect()
}

fn listed(server: &Server, query: &str) -> Vec<String> {
    names(&server.get(&format!("/v1/cohorts/squares/shapes?{query}")).expect(200))
}

fn expected(keep: impl Fn(usize) -> bool) -> Vec<String> {
    (0..12).filter(|&index| keep(index)).map(|index| format!("q{index:02}")).collect()
}

#[test]
fn measures_are_stored_when_shapes_arrive() {
    let server = Server::fresh();
    squares(&server, 3);
    let shape = server.get("/v1/cohorts/squares/shapes/q01").expect(200);
    let size = shape["measures"]["centroid_size"].as_f64().unwrap();
    assert!((size - 32_f64.sqrt()).abs() < 1e-12 && shape["measures"]["points"] == 4, "{shape}");
    assert!(shape["measures"].get("area").is_none(), "landmarks enclose nothing: {shape}");

    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 16,
                                "generator": {"name": "bspline", "degree": 1}});
    let body = json!({"name": "curves", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &body).expect(201);
    let corner = |k: usize| [[0., 0.], [4., 0.], [4., 4.], [0., 4.]][k % 4];
    let along = |k: usize| {
        let (a, b, t) = (corner(k / 4), corner(k / 4 + 1), (k % 4) as f64 / 4.0);
        [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
    };
    let plain: Vec<[f64; 2]> = (0..16).map(along).collect();
    let mut crossed = plain.clone();
    crossed.swap(2, 10);
    let shapes = json!({"shapes": [{"external_id": "plain", "points": plain}, {"external_id": "crossed", "points": crossed}]});
    let answer = server.post("/v1/cohorts/curves/shapes", &shapes).expect(201);
    assert_eq!(answer["self_intersecting"], 1, "{answer}");
    let measures = server.get("/v1/cohorts/curves/shapes/plain").expect(200)["measures"].clone();
    let close = |name: &str, value: f64| (measures[name].as_f64().unwrap() - value).abs() < 1e-9;
    assert!(close("area", 16.0) && close("length", 16.0), "{measures}");
    assert_eq!(measures["self_intersecting"], false);
    // What is read can be posted again.
    let read = server.get("/v1/cohorts/curves/shapes/crossed").expect(200);
    assert_eq!(read["measures"]["self_intersecting"], true);
    let again = server.post("/v1/cohorts/curves/shapes", &json!({"shapes": [read]})).expect(201);
    assert_eq!(again["added"], 0, "{again}");
    let found = server.get("/v1/cohorts/curves/shapes?measures.self_intersecting=true").expect(200);
    assert_eq!(names(&found), ["crossed"]);
}

#[test]
fn filters_have_one_grammar() {
    let server = Server::fresh();
    squares(&server, 12);
    let site = |index: usize| match index % 4 {
        3 => None,
        even if even % 2 == 0 => Some("zrh"),
        _ => Some("gva"),
    };
    assert_eq!(listed(&server, "label=a&label=b"), expected(|index| index % 3 < 2));
    assert_eq!(listed(&server, "label.ne=a&label.ne=b"), expected(|index| index % 3 == 2));
    assert_eq!(listed(&server, "labels.site.ne=zrh"), expected(|index| site(index) != Some("zrh")));
    assert_eq!(
        listed(&server, "has=labels.site&labels[site.ne]=zrh"),
        expected(|index| site(index) == Some("gva"))
    );
    assert_eq!(
        listed(&server, "labels.age.gte=33&labels[age][lt]=36"),
        expected(|index| (3..6).contains(&index))
    );
    assert_eq!(listed(&server, "labels.age=33&labels.age=40.0"), expected(|index| index == 3 || index == 10));
    assert_eq!(listed(&server, "labels.fresh=true"), expected(|index| index < 5));
    assert_eq!(listed(&server, "measures.centroid_size.gt=8.5"), expected(|index| index > 2));
    assert_eq!(listed(&server, "measures.points=4"), expected(|_| true));
    assert_eq!(
        listed(&server, "external_id=q01&external_id=q07"),
        expected(|index| index == 1 || index == 7)
    );
    assert_eq!(listed(&server, "external_id.gte=q10"), expected(|index| index >= 10));
    assert_eq!(listed(&server, "labels.site.gte=h"), expected(|index| site(index) == Some("zrh")));
    assert_eq!(listed(&server, "created_at.gte=2020-01-01T00:00:00Z"), expected(|_| true));
    assert_eq!(listed(&server, "created_at[lt]=2020-01-01T00:00:00Z"), [""; 0]);

    // The same in bodies.
    let select = |filter: Value| {
        let table = json!({"columns": ["external_id"], "filter": filter});
        let table = server.post("/v1/cohorts/squares/table", &table).expect(200);
        let values = table["columns"][0]["values"].as_array().unwrap().clone();
        values.into_iter().map(|value| value.as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(select(json!({"label": ["a", "b"]})), expected(|index| index % 3 < 2));
    assert_eq!(
        select(json!({"labels": {"age": {"gte": 33, "lt": 36}}})),
        expected(|index| (3..6).contains(&index))
    );
    assert_eq!(
        select(json!({"has": ["labels.site"], "labels": {"site": {"ne": "zrh"}}})),
        expected(|index| site(index) == Some("gva"))
    );
    assert_eq!(
        select(json!({"measures": {"centroid_size": {"gt": 8.5}}, "labels": {"fresh": true}})),
        expected(|index| index == 3 || index == 4)
    );
    let problem = server
        .post("/v1/cohorts/squares/table", &json!({"filter": {"measures": {"area": "big"}}}))
        .expect(422);
    assert_eq!(pointers_of(&problem), ["/filter/measures/area"], "{problem}");
    for (filter, pointer) in [
        (json!({"label": {"like": "a"}}), "/filter/label"),
        (json!({"label": []}), "/filter/label"),
        (json!({"has": ["colour"]}), "/filter/has"),
        (json!({"mass": 1}), "/filter"),
    ] {
        let problem = server.post("/v1/cohorts/squares/table", &json!({"filter": filter})).expect(422);
        assert!(pointers_of(&problem)[0].starts_with(pointer), "{problem}");
    }
    let mean = server
        .get("/v1/cohorts/squares/mean?transformation=similarity&alignment=procrustes&label=a&label=b")
        .expect(200);
    assert_eq!(mean["shape_count"], 8, "{mean}");
}

#[test]
fn wrong_queries_say_what_is_expected() {
    let server = Server::fresh();
    squares(&server, 4);
    for (query, wanted) in [
        ("measures.area.gte=big", "expected a finite number"),
        ("created_at.gte=today", "RFC 3339"),
        ("measures.self_intersecting=1", "true or false"),
        ("has=colour", "labels.<attribute>"),
        ("order=colour", "labels.<attribute>"),
        ("fields=id,colour", "expected some of id"),
        ("total=perhaps", "expected true or false"),
        ("labels.age.gte=1&labels.age.gte=2", "got it twice"),
        ("labels.treatmnt=x", "the attributes of the cohort are"),
        ("labels.treatmnt.ne=x", "the attributes of the cohort are"),
        ("order=labels.treatmnt", "the attributes of the cohort are"),
        ("limit=-1", "expected a non-negative whole number"),
        ("colour=red", "expected a parameter of this route"),
        ("cursor=1-2-n3ff0000000000000", "expected a cursor of this list"),
        ("order=label&cursor=1-2", "expected a cursor of this list"),
        ("order=label&cursor=1-2-tzz", "expected a cursor of this list"),
    ] {
        let problem = server.get(&format!("/v1/cohorts/squares/shapes?{query}")).expect(400);
        assert!(problem.to_string().contains(wanted), "{query}: {problem}");
    }
}

#[test]
fn lists_have_fields_orders_and_totals() {
    let server = Server::fresh();
    squares(&server, 12);
    let page = server
        .get("/v1/cohorts/squares/shapes?fields=external_id,label&limit=2&total=true&label=a")
        .expect(200);
    assert_eq!(
        (&page["items"], &page["total"]),
        (&json!([{"external_id": "q00", "label": "a"}, {"external_id": "q03", "label": "a"}]), &json!(4))
    );
    for (order, wanted) in [
        ("-measures.centroid_size", (0..12).rev().collect::<Vec<_>>()),
        ("label", vec![0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]),
        ("-label", vec![2, 5, 8, 11, 1, 4, 7, 10, 0, 3, 6, 9]),
        ("labels.site", vec![1, 5, 9, 0, 2, 4, 6, 8, 10, 3, 7, 11]),
        ("-labels.age", (0..12).rev().collect()),
        ("external_id", (0..12).collect()),
    ] {
        let wanted: Vec<String> = wanted.into_iter().map(|index| format!("q{index:02}")).collect();
        for fields in ["", "&fields=external_id"] {
            let (mut found, mut cursor) = (Vec::new(), String::new());
            loop {
                let query = format!("order={order}&limit=5{fields}{cursor}");
                let page = server.get(&format!("/v1/cohorts/squares/shapes?{query}")).expect(200);
                found.extend(names(&page));
                let Some(next) = page["next"].as_str() else { break };
                cursor = format!("&cursor={next}");
            }
            assert_eq!(found, wanted, "{order}");
        }
    }
    let sizes = server.get("/v1/cohorts/squares/shapes?order=-measures.centroid_size&limit=1").expect(200);
    assert_eq!(sizes["items"][0]["control_points"][0], json!([12.0, 12.0]), "{sizes}");
}

#[test]
fn attributes_are_summed_up() {
    let server = Server::fresh();
    squares(&server, 12);
    let summary = |query: &str| server.get(&format!("/v1/cohorts/squares/attributes?{query}")).expect(200);
    let item = |answer: &Value, name: &str| {
        answer["items"]
            .as_array()
            .unwrap()
            .iter()
            .find(|item| item["name"] == name)
            .cloned()
            .unwrap_or_default()
    };
    let all = summary("bins=3&values=2");
    assert_eq!((&all["revision"], &all["shape_count"]), (&json!(1), &json!(12)));
    let site = item(&all, "labels.site");
    assert_eq!(site["values"], json!([{"value": "zrh", "count": 6}, {"value": "gva", "count": 3}]));
    assert_eq!((&site["type"], &site["missing"], &site["distinct"]), (&json!("text"), &json!(3), &json!(2)));
    let age = item(&all, "labels.age");
    assert_eq!((&age["min"], &age["max"], &age["mean"]), (&json!(30.0), &json!(41.0), &json!(35.5)));
    assert_eq!(age["histogram"]["counts"], json!([4, 4, 4]), "{age}");
    assert_eq!(age["quantiles"][2], json!({"probability": 0.5, "value": 35.5}));
    assert_eq!(item(&all, "labels.fresh")["type"], "boolean");
    assert_eq!(item(&all, "created_at")["type"], "time");
    assert_eq!(item(&all, "measures.centroid_size")["distinct"], 12);
    assert_eq!(item(&all, "measures.area"), Value::Null, "landmarks have none");
    let old = summary("labels.age.gte=38");
    assert_eq!(
        (&old["shape_count"], &item(&old, "labels.fresh")["values"]),
        (&json!(4), &json!([{"value": "false", "count": 4}]))
    );

    // What changes is seen: a shape more, one less.
    server.post("/v1/cohorts/squares/shapes", &json!({"shapes": [square(12)]})).expect(201);
    assert_eq!(server.delete("/v1/cohorts/squares/shapes/q00").status, 204);
    let changed = summary("");
    let age = item(&changed, "labels.age");
    assert_eq!(
        (&changed["revision"], &changed["shape_count"], &age["min"], &age["max"]),
        (&json!(3), &json!(12), &json!(31.0), &json!(42.0))
    );
    for query in ["bins=0", "values=100000", "labels.treatmnt=x", "colour=red"] {
        server.get(&format!("/v1/cohorts/squares/attributes?{query}")).expect(400);
    }
}

/// What begins like a formula is run by a spreadsheet, unless the client asks for texts.
#[test]
fn formulas_in_csv_are_escaped_on_request() {
    let server = Server::fresh();
    no_squares(&server);
    let shapes = [("=1+1", "@sum", "-x"), ("-0.5", "plain", "a=b")].map(|(id, label, note)| {
        let mut shape = square(0);
        (shape["external_id"], shape["label"], shape["labels"]) =
            (json!(id), json!(label), json!({"=note": note}));
        shape
    });
    server.post("/v1/cohorts/squares/shapes", &json!({"shapes": shapes})).expect(201);
    let columns = json!({"columns": ["external_id", "label", "labels.=note"]});
    let search = json!({"ids": ["-0.5"], "neighbours": 1, "transformation": "rigid"});
    let distances = json!({"cohort": "squares", "transformation": "rigid"});
    let asked: [(&str, Option<&Value>); 7] = [
        ("/v1/cohorts/squares/table?format=csv", None),
        ("/v1/cohorts/squares/table?format=csv", Some(&columns)),
        ("/v1/cohorts/squares/export?format=csv", None),
        ("/v1/cohorts/squares/shapes?format=csv", None),
        ("/v1/cohorts/squares/attributes?format=csv&table=items.values", None),
        ("/v1/cohorts/squares/search?format=csv", Some(&search)),
        ("/v1/distances?format=csv", Some(&distances)),
    ];
    for (path, body) in asked {
        let ask = |option: &str| {
            let path = format!("{path}{option}");
            let reply = body.map_or_else(|| server.get(&path), |body| server.post(&path, body));
            assert_eq!(
                (reply.status, reply.header("content-type")),
                (200, Some("text/csv")),
                "{path}: {}",
                reply.text()
            );
            reply.text().to_owned()
        };
        let (kept, escaped) = (ask(""), ask("&formulas=escape"));
        assert_eq!(ask("&formulas=keep"), kept, "{path}");
        assert!(kept.contains("=1+1") && !kept.contains('\''), "{path}: {kept}");
        assert!(escaped.contains("'=1+1") && !escaped.contains("'-0.5"), "{path}: {escaped}");
        let texts = [("@sum", "'@sum"), ("-x", "'-x")];
        let expected =
            texts.iter().fold(kept.replace("=1+1", "'=1+1"), |text, (from, to)| text.replace(from, to));
        let named = |text: &str| text.replace("'=note", "=note");
        assert_eq!(named(&escaped), expected, "{path}");
    }
    for (query, wanted) in [
        ("table?format=csv&formulas=no", "expected 'keep' or 'escape', got 'no'"),
        ("table?format=csv&formulas=keep&formulas=escape", "got it twice"),
        ("sheet?formulas=escape", "formulas"),
    ] {
        let problem = server.get(&format!("/v1/cohorts/squares/{query}")).expect(400);
        assert!(problem.to_string().contains(wanted), "{query}: {problem}");
    }
}

/// A square with so many attributes, whose names nobody else has.
fn with_own_names(index: usize, count: usize) -> Value {
    let labels = (0..count).map(|k| (format!("n{index:03}_{k:02}"), json!(k)));
    let mut shape = square(index);
    shape["labels"] = Value::Object(labels.collect());
    shape["external_id"] = json!(format!("own{index:03}"));
    shape
}

/// Every name is a column: few shapes with names that differ would make large tables of all later looks at the cohort.
#[test]
fn a_cohort_has_a_limited_number_of_attribute_names() {
    let server = Server::fresh();
    no_squares(&server);
    let add = |shapes: Vec<Value>| server.post("/v1/cohorts/squares/shapes", &json!({"shapes": shapes}));
    let refused = |reply: Reply, pointer: &str, found: &str| {
        let problem = reply.expect(422);
        assert_eq!(pointers_of(&problem), [pointer], "{problem}");
        let wanted = format!("expected at most 4096 different names of attributes in a cohort, got {found}");
        assert!(problem.to_string().contains(&wanted), "{problem}");
    };
    let many: Vec<Value> = (0..42).map(|index| with_own_names(index, 100)).collect();
    refused(add(many.clone()), "/shapes", "4100");
    refused(server.post_lines("/v1/cohorts/squares/shapes", &many), "", "4100");
    add(many[..40].to_vec()).expect(201);
    add(vec![with_own_names(100, 96)]).expect(201);
    refused(add(vec![with_own_names(101, 1)]), "/shapes", "4097");
    let patch = |labels: Value| {
        let request = server.request(Method::PATCH, "/v1/cohorts/squares/shapes/own100");
        let body = json!({"labels": labels}).to_string();
        server.send(request.header("content-type", "application/merge-patch+json").body(body))
    };
    refused(patch(json!({"another": 1, "n100_00": null})), "/labels", "4097");
    // Length counts as well: a name that nobody can read is no column.
    let long = json!({"labels": {"n".repeat(501): 1}}).to_string();
    let request = server.request(Method::PATCH, "/v1/cohorts/squares/shapes/own100");
    let reply = server.send(request.header("content-type", "application/merge-patch+json").body(long));
    assert!(reply.expect(422).to_string().contains("1 to 500 characters"));
    // Names that others have are not new.
    patch(json!({"n001_05": 7})).expect(200);
    add(many[..1].to_vec()).expect(201);

    let summary = server.get("/v1/cohorts/squares/attributes?values=1").expect(200);
    let items = summary["items"].as_array().unwrap();
    let of_labels = |item: &&Value| item["name"].as_str().unwrap().starts_with("labels.");
    assert_eq!((items.iter().filter(of_labels).count(), &summary["warnings"]), (4096, &json!([])));
    let shared = items.iter().find(|item| item["name"] == "labels.n001_05").unwrap();
    assert_eq!((&shared["missing"], &shared["max"]), (&json!(39), &json!(7.0)), "{shared}");
    let table = server.get("/v1/cohorts/squares/table?columns=id,labels.n001_05,labels.n039_99").expect(200);
    let given = |column: usize| {
        let values = table["columns"][column]["values"].as_array().unwrap();
        values.iter().filter(|value| !value.is_null()).count()
    };
    assert_eq!((&table["rows"], given(1), given(2)), (&json!(41), 2, 1));
    let problem = server.get("/v1/cohorts/squares/table").expect(400);
    assert!(problem.to_string().contains("expected 1 to 200 columns"), "{problem}");
    let problem = server.get("/v1/cohorts/squares/table?columns=labels.absent").expect(400);
    assert!(problem.to_string().contains(" and 4047 more"), "{problem}");
    assert!(problem.to_string().len() < 4000, "{problem}");

    // The names of shapes that are gone leave room.
    assert_eq!(server.delete("/v1/cohorts/squares/shapes/own100").status, 204);
    add(vec![with_own_names(101, 96)]).expect(201);
}

/// A dashboard asks for the same summary again and again: it is computed once per revision, filter and resolution.
#[test]
fn a_summary_is_kept_until_the_cohort_changes() {
    let server = Server::fresh();
    squares(&server, 12);
    let hits = || {
        let metrics = server.get("/metrics");
        let series = "shapelex_cache_lookups_total{cache=\"summaries\",outcome=\"hit\"} ";
        metrics.text().lines().find_map(|line| line.strip_prefix(series)).unwrap_or("0").to_owned()
    };
    let summary = |query: &str| server.get(&format!("/v1/cohorts/squares/attributes?{query}")).expect(200);
    let first = summary("bins=3");
    for other in ["bins=4", "bins=3&values=1", "bins=3&labels.site=zrh"] {
        assert_ne!(summary(other), first, "{other}");
    }
    assert_eq!(hits(), "0");
    assert_eq!(summary("bins=3"), first);
    assert_eq!(hits(), "1");
    server.post("/v1/cohorts/squares/shapes", &json!({"shapes": [square(12)]})).expect(201);
    assert_eq!(summary("bins=3")["shape_count"], 13);
    assert_eq!(hits(), "1");
}

const COLUMNS: &str =
    "external_id,labels.treatment,measures.area,cells.score.1,cells.t_squared,cells.outlier";

fn with_headers(server: &Server, path: &str, headers: &[(&str, &str)]) -> Reply {
    let request = server.request(Method::GET, path);
    let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
    server.send(request)
}

fn learn_cells(server: &Server) -> Value {
    let body = json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity",
                      "method": {"kind": "functional_pca", "components": 4, "centre": true},
                      "classifier": {"kind": "discriminant", "attribute": "labels.treatment"}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50");
    server.send(request.json(&body)).expect(201)
}

#[test]
fn a_cohort_is_a_table() {
    let server = Setting::fresh().with_example().start();
    learn_cells(&server);
    let path = format!(
        "/v1/cohorts/example-cells/table?columns={COLUMNS},cells.class,cells.confidence,cells.relative_error"
    );
    let table = server.get(&path).expect(200);
    let columns = table["columns"].as_array().unwrap();
    assert_eq!((&table["rows"], columns.len()), (&json!(120), 9));
    let types: Vec<&str> = columns.iter().map(|column| column["type"].as_str().unwrap()).collect();
    assert_eq!(types, ["text", "text", "number", "number", "number", "boolean", "text", "number", "number"]);
    let used = &table["dictionaries"][0];
    assert_eq!((&used["name"], &used["version"]), (&json!("cells"), &json!(1)));

    // The same numbers as the assessment of each shape.
    let ids: BTreeSet<&str> =
        columns[0]["values"].as_array().unwrap().iter().map(|id| id.as_str().unwrap()).collect();
    assert_eq!(ids.len(), 120);
    let asked = json!({"cohort": "example-cells", "ids": [columns[0]["values"][7]]});
    let score = server.post("/v1/dictionaries/cells/score", &asked).expect(200);
    let score = &score["results"][0];
    assert_eq!(columns[3]["values"][7], score["scores"][0], "{score}");
    assert_eq!(columns[4]["values"][7], score["novelty"]["t_squared"]);

    // One shape more is the only one that is encoded; its row comes last.
    let shape = server.get("/v1/cohorts/example-cells/shapes?limit=1").expect(200)["items"][0].clone();
    let again = json!({"shapes": [{"external_id": "again", "control_points": shape["control_points"]}]});
    server.post("/v1/cohorts/example-cells/shapes", &again).expect(201);
    let more = server.get(&path).expect(200);
    let last = |column: usize| more["columns"][column]["values"][120].clone();
    assert_eq!((more["rows"].clone(), last(0), last(1)), (json!(121), json!("again"), Value::Null));
    let first = columns[3]["values"][0].as_f64().unwrap();
    assert!((last(3).as_f64().unwrap() - first).abs() < 1e-9 * first.abs().max(1.0), "{}", last(3));
    for column in 0..9 {
        let before = columns[column]["values"].as_array().unwrap();
        assert_eq!(&more["columns"][column]["values"].as_array().unwrap()[..120], before, "column {column}");
    }
    // A filter that selects few shapes gives the rows of the whole table.
    let few =
        server.get(&format!("{path}&external_id={}", columns[0]["values"][7].as_str().unwrap())).expect(200);
    assert_eq!((&few["rows"], &few["columns"][3]["values"][0]), (&json!(1), &columns[3]["values"][7]));
}

#[test]
fn tables_have_four_formats_and_name_their_source() {
    let server = Setting::fresh().with_example().start();
    learn_cells(&server);
    let path = format!("/v1/cohorts/example-cells/table?columns={COLUMNS}");
    let csv = with_headers(&server, &path, &[("accept", "text/csv")]);
    let header = |answer: &Reply, name: &str| answer.header(name).unwrap_or_default().to_owned();
    assert_eq!(header(&csv, "shapelex-revision"), "1");
    assert!(header(&csv, "shapelex-dictionaries").starts_with("cells@1;digest="));
    let tag = header(&csv, "etag");
    let text = csv.text();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((lines.len(), lines[0]), (121, COLUMNS));
    assert!(lines[1..].iter().all(|line| line.split(',').count() == 6));
    assert_eq!(with_headers(&server, &path, &[("accept", "text/csv"), ("if-none-match", &tag)]).status, 304);
    let posted = server.request(Method::POST, "/v1/cohorts/example-cells/table").header("if-none-match", "*");
    assert_eq!(server.send(posted.json(&json!({"columns": ["id"]}))).status, 200);
    let ndjson = server.get(&format!("{path}&format=ndjson"));
    let rows: Vec<Value> = ndjson.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((rows.len(), rows[0].as_object().unwrap().len()), (120, 6));
    let arrow = with_headers(&server, &path, &[("accept", "application/vnd.apache.arrow.stream")]);
    assert_eq!(header(&arrow, "content-type"), "application/vnd.apache.arrow.stream");
    assert_eq!(&arrow.body[..4], b"\xff\xff\xff\xff", "an Arrow stream starts with a continuation mark");
    assert_eq!(with_headers(&server, &path, &[("accept", "image/png")]).status, 406);
}

#[test]
fn wrong_tables_are_refused() {
    let server = Setting::fresh().with_example().start();
    learn_cells(&server);
    for (columns, wanted) in [
        ("colour", "expected 'id'"),
        ("labels.treatmnt", "the attributes of the cohort are"),
        ("cells.score.5", "expected a score from 1 to 4"),
        ("cells.score.0", "expected 'id'"),
        ("nothing.outlier", "expected the name of a dictionary"),
        ("label,label", "got it twice"),
        ("", "expected 'id'"),
    ] {
        let problem = server.get(&format!("/v1/cohorts/example-cells/table?columns={columns}")).expect(400);
        assert!(problem.to_string().contains(wanted), "{columns}: {problem}");
        let body = json!({"columns": columns.split(',').collect::<Vec<_>>()});
        let problem = server.post("/v1/cohorts/example-cells/table", &body).expect(422);
        assert!(problem.to_string().contains(wanted), "{columns}: {problem}");
    }
    squares(&server, 3);
    let problem = server.get("/v1/cohorts/squares/table?columns=cells.outlier").expect(400);
    assert!(problem.to_string().contains("representation and correspondence of the dictionary"), "{problem}");
    server.get("/v1/cohorts/squares/table?format=xlsx").expect(400);
    server.get("/v1/cohorts/nothing/table").expect(404);
    let whole = server.get("/v1/cohorts/squares/table").expect(200);
    let names: Vec<&str> =
        whole["columns"].as_array().unwrap().iter().map(|column| column["name"].as_str().unwrap()).collect();
    assert_eq!(names[..2], ["id", "external_id"], "{names:?}");
    assert!(names.contains(&"labels.age") && names.contains(&"measures.centroid_size"), "{names:?}");
}
