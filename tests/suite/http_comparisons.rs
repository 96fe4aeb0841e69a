//! Comparisons and regressions over HTTP against the real program.

use std::f64::consts::TAU;

use reqwest::Method;
use reqwest::header::ACCEPT;
use serde_json::{Value, json};

use crate::http_bad_input::{Differences, Wanted};
use crate::http_contract::cells;
use crate::http_dictionaries::{finished, job_when};
use crate::server::{Reply, Server, Setting, assert_close, flat};

/// Landmarks of a shape.
const POINTS: usize = 8;

type Rows = Vec<[f64; 2]>;

/// Numbers without a pattern, from −1 to 1.
fn noise(i: usize, k: usize) -> f64 {
    let mut state =
        (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (k as u64 + 1).wrapping_mul(0xd1b5_4a32_d192_ed03);
    for _ in 0..4 {
        state ^= state >> 29;
        state = state.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state ^= state >> 32;
    }
    (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A shape of landmarks; `bend` is what groups and attributes change.
fn landmarks(k: usize, bend: f64) -> Rows {
    (0..POINTS)
        .map(|i| {
            let t = TAU * i as f64 / POINTS as f64;
            [
                2.0 * t.cos() + 0.1 * noise(2 * i, k),
                t.sin() + bend * (2.0 * t).cos() + 0.1 * noise(2 * i + 1, k),
            ]
        })
        .collect()
}

fn create(server: &Server, name: &str, representation: &Value, correspondence: &str, shapes: &[Value]) {
    let cohort = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

fn of_landmarks(server: &Server, name: &str, shapes: &[Value]) {
    create(
        server,
        name,
        &json!({"kind": "landmarks", "dimension": 2, "points": POINTS}),
        "landmarks",
        shapes,
    );
}

fn compare(server: &Server, body: &Value) -> Value {
    server.post("/v1/comparisons", body).expect(200)
}

fn regress(server: &Server, body: &Value) -> Value {
    server.post("/v1/regressions", body).expect(200)
}

/// Centred landmarks: what the class of translations leaves.
fn centred(rows: &Rows) -> Rows {
    let mean = |c: usize| rows.iter().map(|p| p[c]).sum::<f64>() / rows.len() as f64;
    let (x, y) = (mean(0), mean(1));
    rows.iter().map(|p| [p[0] - x, p[1] - y]).collect()
}

fn mean(shapes: &[Rows]) -> Rows {
    (0..shapes[0].len())
        .map(|i| [0, 1].map(|c| shapes.iter().map(|shape| shape[i][c]).sum::<f64>() / shapes.len() as f64))
        .collect()
}

fn squared_distance(a: &Rows, b: &Rows) -> f64 {
    let squares = a.iter().zip(b).map(|(p, q)| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2));
    squares.sum::<f64>() / a.len() as f64
}

#[track_caller]
fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// Upper end and counts of the histogram of a pair, or of all groups.
fn histogram(record: &Value) -> (f64, Vec<u64>) {
    let counts = record["histogram"]["counts"].as_array().unwrap();
    (number(&record["histogram"]["upper"]), counts.iter().map(|count| count.as_u64().unwrap()).collect())
}

// ---------------------------------------------------------------- comparisons

#[test]
fn two_groups_of_three_are_compared_as_by_hand() {
    let server = Server::fresh();
    let shapes: Vec<Rows> = (0..6).map(|k| landmarks(k, if k < 3 { 0.0 } else { 0.06 })).collect();
    let posted: Vec<Value> = shapes
        .iter()
        .enumerate()
        .map(|(k, points)| json!({"points": points, "label": if k < 3 { "a" } else { "b" }, "external_id": k.to_string()}))
        .collect();
    of_landmarks(&server, "six", &posted);
    let body = json!({"cohort": "six", "by": "label", "transformation": "translation"});
    let found = compare(&server, &body);
    let shapes: Vec<Rows> = shapes.iter().map(centred).collect();
    let distance = |second: &[usize]| {
        let side = |inside: bool| {
            let members = (0..6).filter(|k| second.contains(k) == inside);
            mean(&members.map(|k| shapes[k].clone()).collect::<Vec<_>>())
        };
        squared_distance(&side(true), &side(false)).sqrt()
    };
    let observed = distance(&[3, 4, 5]);
    let mut reaching = 0;
    for a in 0..6 {
        for b in a + 1..6 {
            for c in b + 1..6 {
                reaching += u64::from(distance(&[a, b, c]) >= observed - 1e-12);
            }
        }
    }
    let pair = &found["pairs"][0];
    assert!((number(&pair["distance"]["value"]) - observed).abs() < 1e-12, "{pair}");
    let test = &pair["distance"]["test"];
    assert_eq!((&test["exact"], &test["permutations"]), (&json!(true), &json!(19)));
    assert_eq!(test["exceeding"], json!(reaching - 1));
    assert!((number(&test["p"]) - reaching as f64 / 20.0).abs() < 1e-15);
    assert_eq!(test["p"], test["p_holm"]);
    assert_eq!((&found["overall"], &found["exchangeable"]), (&Value::Null, &json!(6)));
    // Those that reach the observed value are in its bin or above.
    let (upper, counts) = histogram(pair);
    let bin = (number(&pair["r_squared"]) / upper * 40.0) as usize;
    assert_eq!((counts.len(), counts.iter().sum::<u64>()), (40, 19));
    assert!(counts[bin.min(39)..].iter().sum::<u64>() >= reaching - 1, "{pair}");
    // Fits have no mean space.
    assert_eq!(pair["chordal_distance"], Value::Null);
    let averages = [mean(&shapes[..3]), mean(&shapes[3..])];
    for (group, average) in found["groups"].as_array().unwrap().iter().zip(&averages) {
        assert_close(&group["average"], &json!(average), 1e-12, "average");
    }
    for (i, point) in pair["effect"].as_array().unwrap().iter().enumerate() {
        let difference: Vec<f64> = (0..2).map(|c| averages[1][i][c] - averages[0][i][c]).collect();
        assert_close(&point["difference"], &json!(difference), 1e-12, "effect");
        assert_eq!(point["parameter"], json!(i as f64));
    }
    // F is that of the squared distances.
    let within: f64 = (0..6).map(|k| squared_distance(&shapes[k], &averages[k / 3])).sum();
    let f = 4.0 * 1.5 * observed * observed / within;
    assert!((number(&pair["pseudo_f"]["value"]) - f).abs() < 1e-10 * f, "{pair}");
    // The norm is a mean over the landmarks, the centroid size a sum.
    let size = |shape: &Rows| (POINTS as f64 * squared_distance(shape, &vec![[0.0; 2]; POINTS])).sqrt();
    let sizes: Vec<f64> = shapes.iter().map(size).collect();
    let difference = (sizes[3] + sizes[4] + sizes[5] - sizes[0] - sizes[1] - sizes[2]) / 3.0;
    assert_eq!(pair["sizes"].as_array().unwrap().len(), 1, "landmarks have no area and no length");
    assert!((number(&pair["sizes"][0]["difference"]) - difference).abs() < 1e-12);
}

#[test]
fn chordal_distance_is_that_of_the_means_of_the_groups() {
    let server = Setting::fresh().with_example().start();
    let found =
        compare(&server, &json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": 99}));
    assert_eq!(found["pairs"].as_array().unwrap().len(), 3);
    let names: Vec<&Value> = found["groups"].as_array().unwrap().iter().map(|group| &group["name"]).collect();
    assert_eq!(names, ["control", "cytd", "jasp"]);
    // Under similarity the mean space is a complex line, spanned by the mean: the distance is the sine between two.
    let metric = |a: &Value, b: &Value| {
        let shape = |points: &Value| json!({"control_points": points});
        let body = json!({"transformation": "similarity", "reference": shape(a), "shapes": [shape(b)], "onto": "shape",
            "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 100, "generator": {"name": "trigonometric"}}});
        number(&server.post("/v1/project", &body).expect(200)["results"][0]["correlation"])
    };
    for pair in found["pairs"].as_array().unwrap() {
        let group =
            |name: &Value| found["groups"].as_array().unwrap().iter().find(|g| g["name"] == *name).unwrap();
        let [a, b] = [&pair["first"], &pair["second"]].map(|name| &group(name)["mean"]["control_points"]);
        let cosine = metric(a, b);
        let wanted = (1.0 - cosine * cosine).sqrt();
        assert!(
            (number(&pair["chordal_distance"]) - wanted).abs() < 1e-8,
            "{wanted} {}",
            pair["chordal_distance"]
        );
    }
    // Holm over the three pairs, and all groups at once.
    let mut p: Vec<(f64, f64)> = (0..3)
        .map(|i| &found["pairs"][i]["distance"]["test"])
        .map(|test| (number(&test["p"]), number(&test["p_holm"])))
        .collect();
    p.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut largest: f64 = 0.0;
    for (rank, (p, holm)) in p.into_iter().enumerate() {
        largest = largest.max((3 - rank) as f64 * p).min(1.0);
        assert!((holm - largest).abs() < 1e-12);
    }
    assert_eq!(number(&found["overall"]["pseudo_f"]["test"]["p"]), 0.01);
    // No relabelling reaches the observed value, up to which there is room.
    let (upper, counts) = histogram(&found["overall"]);
    assert_eq!((upper, counts.iter().sum::<u64>()), (number(&found["overall"]["r_squared"]), 99));
    assert_eq!(counts[39], 0);
    let none =
        compare(&server, &json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": 0}));
    assert_eq!((&none["overall"]["histogram"], &none["pairs"][0]["histogram"]), (&Value::Null, &Value::Null));
}

/// A closed contour with a shape of its own, densely sampled from its own start, moved by its own similarity.
fn contour(k: usize, start: usize, turn: f64, size: f64) -> Rows {
    let dense = 120;
    let group = (k % 2) as f64;
    (0..dense)
        .map(|i| {
            let t = TAU * ((i + start) % dense) as f64 / dense as f64;
            let radius = 1.0
                + 0.02 * noise(0, k) * (2.0 * t).cos()
                + 0.02 * noise(1, k) * (3.0 * t).sin()
                + (0.05 + 0.03 * group) * (5.0 * t).cos();
            let (x, y) = (2.0 * radius * t.cos(), radius * t.sin() + 0.1 * t.cos().powi(2));
            let (sin, cos) = turn.sin_cos();
            [size * (cos * x - sin * y) + turn, size * (sin * x + cos * y) - 3.0 * turn]
        })
        .collect()
}

/// Everything that must not change; sizes do, and names of things.
fn without_sizes(mut found: Value) -> Value {
    found["cohort"] = Value::Null;
    for list in ["groups", "pairs"] {
        found[list].as_array_mut().unwrap().iter_mut().for_each(|item| item["sizes"] = Value::Null);
    }
    found
}

#[track_caller]
fn assert_same(a: &Value, b: &Value, at: &str) {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{at}");
            a.iter().zip(b).enumerate().for_each(|(i, (a, b))| assert_same(a, b, &format!("{at}/{i}")));
        }
        (Value::Object(a), Value::Object(b)) => {
            a.iter().for_each(|(key, value)| assert_same(value, &b[key], &format!("{at}/{key}")));
        }
        (Value::Number(_), Value::Number(_)) => {
            let (a, b) = (number(a), number(b));
            assert!((a - b).abs() <= 1e-8 * a.abs().max(1.0), "{at}: {a} and {b}");
        }
        _ => assert_eq!(a, b, "{at}"),
    }
}

#[test]
fn members_of_the_class_and_start_points_change_nothing() {
    let server = Server::fresh();
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 32, "generator": {"name": "trigonometric"}});
    let shapes = |moved: bool| -> Vec<Value> {
        (0..14)
            .map(|k| {
                let own = f64::from(u8::from(moved));
                let points = contour(
                    k,
                    if moved { 17 * k % 120 } else { 0 },
                    own * 2.0 * noise(7, k),
                    1.0 + own * k as f64,
                );
                json!({"points": points, "label": if k % 2 == 0 { "a" } else { "b" }})
            })
            .collect()
    };
    create(&server, "posed", &representation, "cyclic", &shapes(false));
    create(&server, "moved", &representation, "cyclic", &shapes(true));
    let ask = |cohort: &str| {
        let found =
            compare(&server, &json!({"cohort": cohort, "by": "label", "permutations": 300, "samples": 20}));
        without_sizes(found)
    };
    let (posed, moved) = (ask("posed"), ask("moved"));
    assert_same(&posed, &moved, "");
    assert!(number(&posed["pairs"][0]["distance"]["test"]["p"]) < 0.05, "{}", posed["pairs"][0]["distance"]);
}

#[test]
fn a_local_difference_of_noisy_ellipses_is_found_where_it_is() {
    let server = Server::fresh();
    let (points, middle) = (64, 20);
    let shape = |k: usize| -> Rows {
        (0..points)
            .map(|i| {
                let t = TAU * i as f64 / points as f64;
                let smooth: f64 =
                    (1..6).map(|j| 0.02 * noise(j, k) * (j as f64 * t + 3.0 * noise(j + 9, k)).cos()).sum();
                let bump = (-((i as f64 - middle as f64) / 4.0).powi(2)).exp();
                let radius = 1.0 + smooth + if k >= 40 { 0.04 * bump } else { 0.0 };
                let size = 1.0 + 0.2 * noise(30, k);
                [size * 2.0 * radius * t.cos() + noise(31, k), size * radius * t.sin()]
            })
            .collect()
    };
    let shapes: Vec<Value> = (0..80)
        .map(|k| json!({"points": shape(k), "label": if k < 40 { "controls" } else { "patients" }}))
        .collect();
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": points, "generator": {"name": "trigonometric"}});
    create(&server, "ellipses", &representation, "landmarks", &shapes);
    let body = json!({"cohort": "ellipses", "by": "label", "permutations": 999, "seed": 3});
    let found = compare(&server, &body);
    let pair = &found["pairs"][0];
    for statistic in ["distance", "pseudo_f", "hotelling"] {
        assert!(number(&pair[statistic]["test"]["p"]) < 0.01, "{statistic}: {}", pair[statistic]);
    }
    let effect = pair["effect"].as_array().unwrap();
    let peak = |of: &dyn Fn(&Value) -> f64| {
        (0..points).max_by(|&i, &j| of(&effect[i]).total_cmp(&of(&effect[j]))).unwrap()
    };
    for place in [peak(&|point| number(&point["length"])), peak(&|point| number(&point["t_squared"]))] {
        assert!(place.abs_diff(middle) <= 3, "the effect is largest at {place}");
    }
    assert!(number(&effect[middle]["p"]) < 0.01 && number(&effect[middle + 32]["p"]) > 0.05);
    let sizes = pair["sizes"].as_array().unwrap();
    let measures: Vec<&Value> = sizes.iter().map(|size| &size["measure"]).collect();
    assert_eq!(measures, ["area", "length", "centroid_size"]);
    // The same seed gives the same answer, another one other draws.
    assert_eq!(found, compare(&server, &body));
    let other =
        compare(&server, &json!({"cohort": "ellipses", "by": "label", "permutations": 999, "seed": 4}));
    assert_ne!(found["pairs"][0]["effect"], other["pairs"][0]["effect"]);
    assert_eq!(found["groups"], other["groups"]);
    // As a picture.
    let request = server.request(Method::POST, "/v1/comparisons").header(ACCEPT, "image/svg+xml").json(&body);
    let picture = server.send(request);
    assert_eq!((picture.status, picture.header("content-type")), (200, Some("image/svg+xml")));
    assert!(picture.text().contains("patients (n = 40)") && !picture.text().contains("NaN"));
}

/// The cells with labels `s0`, `s1`, … that mean nothing, and numbers `x0`, `x1`, ….
fn shuffled_cells(server: &Server, count: usize) {
    let mut shapes = cells();
    shapes.truncate(100);
    for (k, shape) in shapes.iter_mut().enumerate() {
        let mut labels = serde_json::Map::new();
        for s in 0..count {
            // A shuffle: half of the shapes, those with the smaller numbers.
            let smaller = (0..100).filter(|&other| noise(s + 50, other) < noise(s + 50, k)).count();
            labels.insert(format!("s{s}"), json!(if smaller < 50 { "a" } else { "b" }));
            labels.insert(format!("x{s}"), json!(noise(s + 500, k)));
        }
        *shape = json!({"points": shape["points"], "labels": labels});
    }
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 40, "generator": {"name": "trigonometric"}});
    create(server, "shuffled", &representation, "cyclic", &shapes);
}

#[test]
fn labels_and_numbers_that_mean_nothing_are_seldom_significant() {
    let server = Server::fresh();
    let count = 50;
    shuffled_cells(&server, count);
    let mut rejected = [0; 3];
    let (mut sum, mut small) = (0.0, 0);
    for s in 0..count {
        let body = json!({"cohort": "shuffled", "by": format!("labels.s{s}"), "permutations": 199, "samples": 10, "seed": s});
        let pair = &compare(&server, &body)["pairs"][0];
        for (rejected, statistic) in rejected.iter_mut().zip(["distance", "pseudo_f", "hotelling"]) {
            *rejected += usize::from(number(&pair[statistic]["test"]["p"]) <= 0.05);
        }
        let body = json!({"cohort": "shuffled", "attribute": format!("labels.x{s}"), "permutations": 199, "seed": s,
            "covariates": ["log_centroid_size"]});
        let p = number(&regress(&server, &body)["test"]["p"]);
        sum += p;
        small += usize::from(p <= 0.05);
    }
    // Of 50 at 5 %, more than 8 come once in a thousand times.
    assert!(rejected.iter().all(|&rejected| rejected <= 8) && small <= 8, "{rejected:?} {small}");
    // The mean of 50 uniform numbers has the standard deviation 0.04.
    let mean = sum / count as f64;
    assert!((mean - 0.5).abs() < 0.15, "{mean}");
}

#[test]
fn strata_bound_what_is_exchanged() {
    let server = Server::fresh();
    let shapes: Vec<Value> = (0..12)
        .map(|k| {
            let label = if k % 2 == 0 { "before" } else { "after" };
            json!({"points": landmarks(k, if k % 2 == 0 { 0.0 } else { 0.02 }), "label": label, "subject": format!("s{}", k / 2),
                "labels": {"own": k, "half": if k < 6 { "one" } else { "two" }, "part": k < 2}})
        })
        .collect();
    of_landmarks(&server, "paired", &shapes);
    let free = compare(&server, &json!({"cohort": "paired", "by": "label", "transformation": "affine"}));
    assert_eq!(
        free["pairs"][0]["distance"]["test"]["permutations"],
        json!(923),
        "12 over 6, but for the observed one"
    );
    let warnings = free["warnings"].to_string();
    assert!(warnings.contains("6 subjects have shapes in several groups"), "{warnings}");
    let within = compare(
        &server,
        &json!({"cohort": "paired", "by": "label", "transformation": "affine", "strata": "subject"}),
    );
    let test = &within["pairs"][0]["distance"]["test"];
    assert_eq!(
        (&test["permutations"], &test["exact"]),
        (&json!(63), &json!(true)),
        "2 to the 6, but for the observed one"
    );
    assert_eq!(within["strata"], json!(["subject"]));
    assert_eq!(within["warnings"], json!([]));
    let both = json!({"cohort": "paired", "by": "label", "strata": ["labels.half", "labels.part"], "permutations": 10_000});
    let both = compare(&server, &both);
    // Strata of 2, 4 and 6 shapes: 2 · 6 · 20 relabellings.
    assert_eq!(both["pairs"][0]["distance"]["test"]["permutations"], json!(239));
    assert_eq!(both["exchangeable"], json!(12));
    let none = compare(&server, &json!({"cohort": "paired", "by": "label", "permutations": 0}));
    let test = &none["pairs"][0]["hotelling"]["test"];
    assert_eq!((&test["p"], &test["p_holm"]), (&Value::Null, &Value::Null));
    let refused =
        server.post("/v1/comparisons", &json!({"cohort": "paired", "by": "label", "strata": "labels.own"}));
    Differences::default().compare("strata of one", &refused, &Wanted::invalid(&["/strata"]));
}

#[test]
fn comparisons_refuse_what_cannot_be_compared() {
    let server = Setting::fresh().with_example().start();
    let two = json!([{"name": "a", "filter": {"labels": {"cell_line": "dlm8"}}}, {"name": "b", "filter": {"labels": {"cell_line": "dunn"}}}]);
    let with = |field: &str, value: Value| {
        let mut body = json!({"cohort": "example-cells", "groups": two.clone()});
        body[field] = value;
        body
    };
    let group = |name: &str, labels: Value| json!({"name": name, "filter": {"labels": labels}});
    let groups = |list: Vec<Value>| json!({"cohort": "example-cells", "groups": list});
    let a = || group("a", json!({"cell_line": "dlm8"}));
    let by = |by: &str| json!({"cohort": "example-cells", "by": by});
    let cases = [
        ("nothing", json!({}), vec!["", "/cohort"]),
        ("both ways", with("by", json!("label")), vec![""]),
        ("filter of groups", with("filter", json!({})), vec!["/filter"]),
        ("one group", groups(vec![a()]), vec!["/groups"]),
        ("no group", groups(vec![]), vec!["/groups"]),
        (
            "many groups",
            groups((0..51).map(|i| group(&i.to_string(), json!({"cell_line": "dunn"}))).collect()),
            vec!["/groups"],
        ),
        ("same names", groups(vec![a(), group("a", json!({"cell_line": "dunn"}))]), vec!["/groups/1/name"]),
        ("no name", groups(vec![a(), group("", json!({"cell_line": "dunn"}))]), vec!["/groups/1/name"]),
        ("overlap", groups(vec![a(), group("b", json!({"treatment": "jasp"}))]), vec!["/groups/1/filter"]),
        ("empty", groups(vec![a(), group("b", json!({"cell_line": "none"}))]), vec!["/groups/1/filter"]),
        (
            "unknown attribute",
            groups(vec![a(), group("b", json!({"age": "7"}))]),
            vec!["/groups/1/filter/labels/age"],
        ),
        (
            "bad filter",
            groups(vec![a(), json!({"name": "b", "filter": {"colour": "red"}})]),
            vec!["/groups/1/filter/colour"],
        ),
        ("by nothing", by("labels.age"), vec!["/by"]),
        (
            "by none",
            json!({"cohort": "example-cells", "by": "label", "filter": {"label": "none"}}),
            vec!["/filter"],
        ),
        ("by subject", by("subject"), vec!["/by"]),
        ("by a word", by("treatment"), vec!["/by"]),
        ("permutations", with("permutations", json!(100_001)), vec!["/permutations"]),
        ("permutations", with("permutations", json!(-1)), vec!["/permutations"]),
        (
            "several",
            {
                let mut body = with("permutations", json!(100_001));
                (body["samples"], body["strata"]) = (json!(0), json!(["age", "subject"]));
                body
            },
            vec!["/permutations", "/samples", "/strata"],
        ),
        ("samples", with("samples", json!(200_000)), vec!["/samples"]),
        ("strata", with("strata", json!(7)), vec!["/strata"]),
        ("strata", with("strata", json!("subject")), vec!["/strata"]),
        ("seed", with("seed", json!(1.5)), vec!["/seed"]),
        ("class", with("transformation", json!("scaled_rotation3")), vec!["/transformation"]),
        ("tangent", with("tangent", json!(1)), vec!["/tangent"]),
        (
            "tangent",
            {
                let mut body = with("tangent", json!(true));
                body["transformation"] = json!("rigid");
                body
            },
            vec!["/tangent"],
        ),
        ("unknown", with("colour", json!("red")), vec!["/colour"]),
    ];
    let mut differences = Differences::default();
    for (what, body, pointers) in cases {
        differences.compare(what, &server.post("/v1/comparisons", &body), &Wanted::invalid(&pointers));
    }
    let reply = server.post("/v1/comparisons", &json!({"cohort": "none", "by": "label"}));
    differences.compare("no cohort", &reply, &Wanted::new(404, "not-found", &["/cohort"]));
    let detail =
        |body: &Value| server.post("/v1/comparisons", body).json()["errors"][0]["detail"].to_string();
    let overlap = detail(&groups(vec![a(), group("b", json!({"treatment": "jasp"}))]));
    assert!(overlap.contains("'b' and 'a' share 20 shapes") && overlap.contains("cell"), "{overlap}");
    let unknown = detail(&groups(vec![a(), group("b", json!({"age": "7"}))]));
    assert!(unknown.contains("label, labels.cell_line, labels.treatment"), "{unknown}");
    // A group of one.
    let shapes: Vec<Value> = (0..4)
        .map(|k| json!({"points": landmarks(k, 0.0), "label": if k == 0 { "a" } else { "b" }}))
        .collect();
    of_landmarks(&server, "lonely", &shapes);
    let named = |name: &str| json!({"name": name, "filter": {"label": name}});
    let bodies = [
        (json!({"cohort": "lonely", "groups": [named("a"), named("b")]}), "/groups/0/filter"),
        (json!({"cohort": "lonely", "by": "label"}), "/by"),
    ];
    for (body, pointer) in bodies {
        differences.compare(
            "one shape",
            &server.post("/v1/comparisons", &body),
            &Wanted::invalid(&[pointer]),
        );
    }
    let shapes = [
        json!({"points": (0..POINTS).map(|i| [i as f64, 2.0 * i as f64]).collect::<Rows>(), "label": "b", "external_id": "flat"}),
        json!({"points": landmarks(9, 0.0), "label": "a"}),
    ];
    server.post("/v1/cohorts/lonely/shapes", &json!({ "shapes": shapes })).expect(201);
    let reply = server
        .post("/v1/comparisons", &json!({"cohort": "lonely", "by": "label", "transformation": "affine"}));
    assert_eq!(reply.json()["code"], "degenerate-shape");
    assert!(reply.text().contains("flat"), "{}", reply.text());
    let samples = json!({"cohort": "lonely", "by": "label", "samples": 5});
    differences.compare(
        "landmarks",
        &server.post("/v1/comparisons", &samples),
        &Wanted::invalid(&["/samples"]),
    );
    server.assert_alive();
}

// ---------------------------------------------------------------- jobs

fn wait_for(server: &Server, path: &str, body: &Value) -> Reply {
    server.send(server.request(Method::POST, path).header("prefer", "wait=50").json(body))
}

#[test]
fn long_work_becomes_a_job_with_the_same_answer() {
    let server = Setting::fresh().with_example().start();
    let body =
        json!({"cohort": "example-cells", "by": "labels.cell_line", "permutations": 100_000, "seed": 5});
    let reply = server.post("/v1/comparisons", &body);
    let job = reply.expect(202);
    assert_eq!(job["kind"], "compare");
    let id = job["id"].as_str().unwrap();
    assert_eq!(reply.header("location"), Some(format!("/v1/jobs/{id}").as_str()));
    let done = finished(&server, id);
    assert_eq!(done["status"], "succeeded", "{done}");
    assert_eq!(done["result"]["pairs"][0]["distance"]["test"]["permutations"], json!(100_000));
    assert_eq!(wait_for(&server, "/v1/comparisons", &body).expect(200), done["result"]);
    let svg =
        server.request(Method::POST, "/v1/comparisons?format=svg").header("prefer", "wait=50").json(&body);
    assert!(server.send(svg).text().starts_with("<svg"));
    // A long one stops when it is told to.
    let long = json!({"cohort": "example-cells", "by": "label", "permutations": 100_000, "samples": 500});
    let id = server.post("/v1/comparisons", &long).expect(202)["id"].as_str().unwrap().to_owned();
    job_when(&server, &id, &["running"]);
    server.post(&format!("/v1/jobs/{id}/cancel"), &json!({})).expect(200);
    let body = json!({"cohort": "example-cells", "attribute": "log_centroid_size", "permutations": 100_000, "covariates": ["label"]});
    let job = server.post("/v1/regressions", &body).expect(202);
    assert_eq!(job["kind"], "regress");
    let done = finished(&server, job["id"].as_str().unwrap());
    assert_eq!(done["result"]["degrees"], json!(113), "{done}");
    assert_eq!(wait_for(&server, "/v1/regressions", &body).expect(200), done["result"]);
}

// ---------------------------------------------------------------- regressions

/// Landmarks that change by `0.03 cos 2t` upwards for one unit of `age`.
fn ageing(server: &Server, size: f64) {
    let shapes: Vec<Value> = (0..20)
        .map(|k| {
            let age = 20.0 + 3.0 * k as f64;
            let mut points = landmarks(if size == 0.0 { 0 } else { k }, 0.03 * age);
            points.iter_mut().for_each(|p| p[0] += 5.0 * noise(90, k));
            let sex = if k % 3 == 0 { "f" } else { "m" };
            json!({"points": points, "external_id": k.to_string(), "subject": format!("s{}", k / 2),
                "labels": {"age": age, "sex": sex, "twice": 2.0 * age, "same": 1, "mixed": if k == 7 { json!("old") } else { json!(k) }, "some": if k < 10 { json!(k * k) } else { Value::Null }}})
        })
        .collect();
    of_landmarks(server, "ageing", &shapes);
}

#[test]
fn a_planted_slope_is_found() {
    let server = Server::fresh();
    ageing(&server, 0.0);
    let body = json!({"cohort": "ageing", "attribute": "labels.age", "transformation": "translation", "permutations": 499});
    let found = regress(&server, &body);
    let planted: Rows =
        (0..POINTS).map(|i| [0.0, 0.03 * (2.0 * TAU * i as f64 / POINTS as f64).cos()]).collect();
    assert_close(&found["change_per_unit"], &json!(planted), 1e-10, "change for a year");
    let deviation = number(&found["attribute"]["deviation"]);
    assert!((deviation - 3.0 * 35.0_f64.sqrt()).abs() < 1e-9, "{deviation}");
    let scaled: Rows = planted.iter().map(|p| [0.0, deviation * p[1]]).collect();
    assert_close(&found["change_per_deviation"], &json!(scaled), 1e-9, "change for a deviation");
    assert!((number(&found["r_squared"]) - 1.0).abs() < 1e-9);
    // Nothing is left: F is infinite, and no permutation reaches it.
    assert_eq!((&found["pseudo_f"], &found["test"]["exceeding"]), (&Value::Null, &json!(0)));
    let predictions = found["predictions"].as_array().unwrap();
    let [low, high] = [&predictions[0], &predictions[2]];
    assert!(
        (number(&low["attribute"]) - 22.85).abs() < 1e-9 && (number(&high["attribute"]) - 74.15).abs() < 1e-9
    );
    let grown: Vec<f64> =
        flat(&high["control_points"]).iter().zip(flat(&low["control_points"])).map(|(a, b)| a - b).collect();
    let wanted: Vec<f64> = planted.iter().flat_map(|p| [0.0, 51.3 * p[1]]).collect();
    assert_close(&json!(grown), &json!(wanted), 1e-9, "growth");
    // The score is a straight line in the attribute.
    let scores = found["scores"].as_array().unwrap();
    assert_eq!((scores.len(), &scores[3]["external_id"]), (20, &json!("3")));
    let step = number(&scores[1]["score"]) - number(&scores[0]["score"]);
    assert!(
        (number(&scores[19]["score"]) - number(&scores[0]["score"]) - 19.0 * step).abs() < 1e-9 && step > 0.0
    );
    assert!(found["warnings"].to_string().contains("20 shapes are of 10 subjects"));
    let picture = server
        .send(server.request(Method::POST, "/v1/regressions").header(ACCEPT, "image/svg+xml").json(&body));
    assert!(
        picture.text().contains("age of 20 shapes")
            && picture.text().contains("age explains")
            && !picture.text().contains("NaN")
    );
}

#[test]
fn covariates_sizes_and_missing_values() {
    let server = Server::fresh();
    ageing(&server, 1.0);
    let base = json!({"cohort": "ageing", "attribute": "labels.age", "permutations": 199});
    let with = |field: &str, value: Value| {
        let mut body = base.clone();
        body[field] = value;
        body
    };
    let found = regress(&server, &with("covariates", json!(["labels.sex", "log_centroid_size"])));
    let levels: Vec<&Value> = found["covariates"].as_array().unwrap().iter().map(|c| &c["levels"]).collect();
    assert_eq!(levels, [&json!(["f", "m"]), &Value::Null]);
    assert_eq!(found["degrees"], json!(16));
    let part = |name: &str| number(&found[name]);
    assert!(part("r_squared") <= part("partial_r_squared") && part("r_squared") <= part("model_r_squared"));
    let f = part("degrees") * part("partial_r_squared") / (1.0 - part("partial_r_squared"));
    assert!((f - part("pseudo_f")).abs() < 1e-8 * f);
    assert!(part("pseudo_f") > 1.0 && number(&found["test"]["p"]) < 0.05, "{found}");
    let some = with("attribute", json!("labels.some"));
    let mut skipping = some.clone();
    skipping["missing"] = json!("skip");
    let found = regress(&server, &skipping);
    assert_eq!((&found["shape_count"], &found["left_out"]), (&json!(10), &json!(10)));
    let refused = server.post("/v1/regressions", &some).json();
    let errors = refused["errors"].as_array().unwrap();
    assert_eq!((errors.len(), &errors[0]["index"]), (10, &json!(10)));
    assert!(errors[0]["detail"].as_str().unwrap().contains("'10'"), "{refused}");
    let cases = [
        ("nothing", json!({}), vec!["/cohort", "/attribute"]),
        ("a text", with("attribute", json!("labels.sex")), vec!["/attribute"]),
        ("one text", with("attribute", json!("labels.mixed")), vec!["/attribute"]),
        ("constant", with("attribute", json!("labels.same")), vec!["/attribute"]),
        ("unknown", with("attribute", json!("labels.height")), vec!["/attribute"]),
        ("not an attribute", with("attribute", json!("subject")), vec!["/attribute"]),
        ("collinear", with("covariates", json!(["labels.twice"])), vec!["/attribute"]),
        (
            "collinear covariate",
            with("covariates", json!(["labels.sex", "labels.same"])),
            vec!["/covariates/1"],
        ),
        ("twice", with("covariates", json!(["labels.sex", "labels.sex"])), vec!["/covariates/1"]),
        ("itself", with("covariates", json!(["labels.age"])), vec!["/covariates/0"]),
        ("unknown", with("covariates", json!(["labels.height", "sex"])), vec!["/covariates/1"]),
        ("unknown", with("covariates", json!(["labels.height"])), vec!["/covariates/0"]),
        ("no freedom", with("covariates", json!(["labels.mixed"])), vec!["/covariates"]),
        ("empty", with("filter", json!({"label": "x"})), vec!["/filter/label"]),
        ("strata", with("strata", json!("labels.age")), vec!["/strata"]),
        ("permutations", with("permutations", json!(1_000_000)), vec!["/permutations"]),
        ("missing", with("missing", json!("guess")), vec!["/missing"]),
        ("covariates", with("covariates", json!("labels.sex")), vec!["/covariates"]),
    ];
    let mut differences = Differences::default();
    for (what, body, pointers) in cases {
        differences.compare(what, &server.post("/v1/regressions", &body), &Wanted::invalid(&pointers));
    }
    let reply = server.post("/v1/regressions", &json!({"cohort": "none", "attribute": "labels.age"}));
    differences.compare("no cohort", &reply, &Wanted::new(404, "not-found", &["/cohort"]));
    // Within subjects there are two shapes each.
    let within = regress(&server, &with("strata", json!(["subject"])));
    assert!(within["warnings"].as_array().unwrap().is_empty(), "{}", within["warnings"]);
    server.assert_alive();
}
