//! Cohorts of surfaces that came as meshes: what each fit has left, and what is refused because their parameters do not correspond.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, assert_relative, shared};

/// Meridians and rings of the meshes.
const MERIDIANS: usize = 20;
const RINGS: usize = 13;

/// Vertices and faces of a bean whose long half-axis grows with `t`, turned in space by `turn`.
pub(crate) struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[usize; 3]>,
}

pub(crate) fn bean(t: f64, turn: f64) -> Mesh {
    let (s, c) = turn.sin_cos();
    let at = |v: f64, u: f64| {
        let [x, y, z] = [v.sin() * u.cos(), v.sin() * u.sin(), v.cos()];
        let [x, y, z] = [x * (1.0 + 0.1 * z), 1.4 * y + 0.2 * z * z, (2.0 + t) * z + 0.3 * z * z];
        [10.0 + c * x + s * z, y, c * z - s * x]
    };
    let ring = |l: usize| {
        (0..MERIDIANS).map(move |k| (PI * l as f64 / RINGS as f64, TAU * k as f64 / MERIDIANS as f64))
    };
    let mut vertices = vec![at(0.0, 0.0)];
    vertices.extend((1..RINGS).flat_map(ring).map(|(v, u)| at(v, u)));
    vertices.push(at(PI, 0.0));
    let place = |l: usize, k: usize| match l {
        0 => 0,
        l if l == RINGS => 1 + (RINGS - 1) * MERIDIANS,
        l => 1 + (l - 1) * MERIDIANS + k % MERIDIANS,
    };
    let quad = |(l, k): (usize, usize)| {
        let [a, b, c, d] = [place(l, k), place(l + 1, k), place(l + 1, k + 1), place(l, k + 1)];
        let upper = (l + 1 < RINGS).then_some([a, b, c]);
        let lower = (l > 0).then_some([a, if l + 1 < RINGS { c } else { b }, d]);
        [upper, lower]
    };
    let quads = (0..RINGS).flat_map(|l| (0..MERIDIANS).map(move |k| (l, k)));
    Mesh { vertices, faces: quads.flat_map(quad).flatten().collect() }
}

impl Mesh {
    pub(crate) fn off(&self) -> String {
        let mut text = format!("OFF\n{} {} 0\n", self.vertices.len(), self.faces.len());
        self.vertices.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
        self.faces.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
        text
    }

    fn area(&self) -> f64 {
        let of = |[a, b, c]: &[usize; 3]| {
            let [a, b, c] = [a, b, c].map(|i| self.vertices[*i]);
            let edge = |to: [f64; 3]| [to[0] - a[0], to[1] - a[1], to[2] - a[2]];
            let ([x, y, z], [p, q, r]) = (edge(b), edge(c));
            0.5 * ((y * r - z * q).powi(2) + (z * p - x * r).powi(2) + (x * q - y * p).powi(2)).sqrt()
        };
        self.faces.iter().map(of).sum()
    }
}

fn sphere(control_points: [usize; 2]) -> Value {
    json!({"kind": "surface", "topology": "sphere", "control_points": control_points})
}

/// A cohort with some meshes; the last answer to an upload.
fn stored(
    server: &Server,
    name: &str,
    control_points: [usize; 2],
    correspondence: &str,
    count: usize,
) -> Value {
    let body =
        json!({"name": name, "representation": sphere(control_points), "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
    let mut answer = Value::Null;
    for k in 0..count {
        let mesh = bean(0.1 * k as f64, 0.7 * k as f64);
        let path = format!("/v1/cohorts/{name}/shapes?name=bean{k}.off&prefix=bean{k}");
        answer = server.post_bytes(&path, "application/octet-stream", mesh.off()).expect(201);
    }
    answer
}

#[test]
fn an_upload_answers_and_keeps_what_the_fit_has_left() {
    let server = shared();
    let answer = stored(&server, "fitted", [8, 8], "landmarks", 1);
    let fit = &answer["results"][0]["fit"];
    let mesh = bean(0.0, 0.0);
    let shape = server.get("/v1/cohorts/fitted/shapes").expect(200)["items"][0].clone();
    let measures = &shape["measures"];
    let number = |value: &Value| value.as_f64().unwrap();
    // The same definition: the surface by its own area, the mesh by the sum of its triangles.
    let area = number(&measures["area"]) / mesh.area() - 1.0;
    assert!((number(&fit["area"]) - area).abs() < 1e-12, "{fit} {area:e}");
    for (name, field) in [("mean", "fit_mean"), ("largest", "fit_largest"), ("area", "fit_area")] {
        assert_eq!(fit[name], measures[field], "{fit} {measures}");
    }
    // The stateless fit of the same mesh: its residual is the root mean square, between the mean and the largest.
    let body = json!({"representation": sphere([8, 8]), "meshes": [{"vertices": mesh.vertices, "faces": mesh.faces}]});
    let alone = server.post("/v1/fit", &body).expect(200)["results"][0].clone();
    assert_relative("largest", number(&fit["largest"]), number(&alone["largest_residual"]), 1e-9);
    let (mean, root) = (number(&fit["mean"]), number(&alone["residual"]));
    assert!(0.0 < mean && mean < root && root < number(&fit["largest"]), "{fit} {alone}");
    let relative = mean / number(&measures["centroid_size"]);
    assert_eq!(answer.get("warnings").is_some(), relative > 0.01, "{relative} {answer}");
}

#[test]
fn an_upload_says_that_a_surface_is_represented_coarsely() {
    let server = shared();
    let answer = stored(&server, "coarse", [4, 3], "landmarks", 1);
    let warnings = answer["warnings"].as_array().unwrap();
    let size =
        server.get("/v1/cohorts/coarse/shapes").expect(200)["items"][0]["measures"]["centroid_size"].clone();
    let relative = answer["results"][0]["fit"]["mean"].as_f64().unwrap() / size.as_f64().unwrap();
    assert!(relative > 0.01, "{relative}: the fixture is not coarse");
    let wanted = format!("the worst by {:.1} %", 100.0 * relative);
    assert!(warnings.len() == 1 && warnings[0].as_str().unwrap().contains(&wanted), "{warnings:?} {wanted}");
    let filter = "/v1/cohorts/coarse/shapes?measures.fit_mean.gt=0";
    assert_eq!(server.get(filter).expect(200)["items"].as_array().unwrap().len(), 1);
}

fn learn(name: &str, cohort: &str, corresponding: Value) -> Value {
    json!({"name": name, "cohort": cohort, "transformation": "rigid", "alignment": "procrustes",
        "method": {"kind": "functional_pca", "components": 2, "centre": true}, "corresponding": corresponding})
}

#[test]
fn a_mean_of_meshes_is_refused_unless_their_parameters_correspond() {
    let server = shared();
    stored(&server, "meshes", [6, 6], "landmarks", 4);
    let path = "/v1/cohorts/meshes/mean?transformation=rigid";
    let refused = server.get(path).expect(400);
    let detail = refused["errors"][0]["detail"].as_str().unwrap();
    assert_eq!(refused["errors"][0]["parameter"], "corresponding", "{refused}");
    assert!(detail.contains("4 of 4 surfaces came as meshes"), "{detail}");
    assert!(detail.contains("POST /v1/cohorts/meshes/correspond"), "{detail}");
    server.get(&format!("{path}&corresponding=true")).expect(200);
    let refused = server.post("/v1/dictionaries", &learn("meshes", "meshes", Value::Null));
    refused.expect_problem(422, "invalid-input", &["/corresponding"]);
    finished(&server, &submit(&server, &learn("meshes", "meshes", json!(true))));
    // Distances and tests are answered, with the same sentence.
    let distances =
        server.post("/v1/distances", &json!({"cohort": "meshes", "transformation": "rigid"})).expect(200);
    assert!(
        distances["warnings"][0].as_str().unwrap().starts_with("4 of 4 surfaces came as meshes"),
        "{distances}"
    );
}

#[test]
fn cohorts_of_the_job_and_surfaces_with_parameters_are_not_refused() {
    let server = shared();
    stored(&server, "unrelated", [6, 6], "landmarks", 4);
    let job = server
        .post("/v1/cohorts/unrelated/correspond", &json!({"name": "related", "degree": 1, "rounds": 1}));
    finished(&server, job.expect(202)["id"].as_str().unwrap());
    server.get("/v1/cohorts/related/mean?transformation=rigid").expect(200);
    finished(&server, &submit(&server, &learn("related", "related", Value::Null)));
    stored(&server, "searched", [4, 4], "cyclic", 2);
    server.get("/v1/cohorts/searched/mean?transformation=rigid").expect(200);
}

#[test]
fn a_dictionary_says_that_the_parameters_of_its_surfaces_disagree() {
    let server = shared();
    // The client posts grids with its parameters, which the service takes as they are: what the mean shows is said everywhere.
    crate::http_correspond::stored(&server, "turned-grids", 6);
    finished(&server, &submit(&server, &learn("turned-grids", "turned-grids", Value::Null)));
    let path = "/v1/dictionaries/turned-grids";
    let said = |answer: &Value, what: &str| {
        let text = answer["warnings"][0].as_str().unwrap_or_default().to_owned();
        assert!(text.starts_with("the parameterisations of"), "{what}: {answer}");
        text
    };
    let wanted = said(&server.get("/v1/cohorts/turned-grids/mean?transformation=rigid").expect(200), "mean");
    assert_eq!(said(&server.get(path).expect(200), "dictionary"), wanted);
    assert_eq!(said(&server.get(&format!("{path}/modes")).expect(200), "modes"), wanted);
    let report = server.post(&format!("{path}/report"), &json!({"resamples": 0, "draws": 10})).expect(202);
    let report = finished(&server, report["id"].as_str().unwrap())["result"].clone();
    let warnings = report["warnings"].as_array().unwrap();
    assert!(warnings.contains(&json!(wanted)), "{report}");
    let ids = json!({"cohort": "turned-grids", "ids": ["bean-1"]});
    for operation in ["score", "assess"] {
        assert_eq!(said(&server.post(&format!("{path}/{operation}"), &ids).expect(200), operation), wanted);
    }
}

/// Files say what numbers of control points represent their shapes, and the error that they leave.
#[test]
fn an_inspection_proposes_numbers_of_control_points() {
    let server = shared();
    let inspect = |query: &str, body: String| {
        let path = format!("/v1/inspect?name=bean.off{query}");
        server.post_bytes(&path, "application/octet-stream", body).expect(200)["proposals"].clone()
    };
    let mesh = bean(0.0, 0.0);
    let count = |proposals: &Value| {
        let counts = &proposals[0]["representation"]["control_points"];
        counts[0].as_u64().unwrap() * counts[1].as_u64().unwrap()
    };
    let number = |proposals: &Value, field: &str| proposals[0][field].as_f64().unwrap();
    let (usual, fine) = (inspect("", mesh.off()), inspect("&tolerance=0.007", mesh.off()));
    assert_eq!((&usual[0]["kind"], &usual[0]["shape_count"]), (&json!("mesh"), &json!(1)));
    assert!(
        number(&usual, "relative_residual") <= 0.01 && number(&fine, "relative_residual") <= 0.007,
        "{usual} {fine}"
    );
    assert!(count(&usual) < count(&fine), "{usual} {fine}");
    // The proposal is what the stateless fit makes with as many control points, and the next smaller one leaves more.
    let residual = |representation: &Value| {
        let body = json!({"representation": representation, "meshes": [{"vertices": mesh.vertices, "faces": mesh.faces}]});
        server.post("/v1/fit", &body).expect(200)["results"][0]["residual"].as_f64().unwrap()
    };
    assert_relative("residual", residual(&usual[0]["representation"]), number(&usual, "residual"), 1e-9);
    assert!(number(&usual, "largest") > number(&usual, "residual"));
    let centroid =
        [0, 1, 2].map(|c| mesh.vertices.iter().map(|v| v[c]).sum::<f64>() / mesh.vertices.len() as f64);
    let square = |v: &[f64; 3]| (0..3).map(|c| (v[c] - centroid[c]).powi(2)).sum::<f64>();
    let size = (mesh.vertices.iter().map(square).sum::<f64>() / mesh.vertices.len() as f64).sqrt();
    assert_relative("size", number(&usual, "residual") / number(&usual, "relative_residual"), size, 1e-9);
    let refused = server
        .post_bytes("/v1/inspect?name=a.off&tolerance=2", "application/octet-stream", mesh.off())
        .expect(400);
    assert_eq!(refused["errors"][0]["parameter"], "tolerance", "{refused}");
}

#[test]
fn an_inspection_proposes_numbers_of_points_of_curves() {
    let server = shared();
    let lines = |closed: bool| {
        let at = |i: usize| {
            let u = TAU * i as f64 / 100.0;
            [3.0 * u.cos() + 0.4 * (3.0 * u).cos(), u.sin()]
        };
        json!({"points": (0..100).map(at).collect::<Vec<_>>(), "closed": closed}).to_string() + "\n"
    };
    let inspect = |body: String| {
        server.post_bytes("/v1/inspect?format=ndjson", "application/octet-stream", body).expect(200)
    };
    let found = inspect(lines(true) + &lines(true));
    let proposal = &found["proposals"][0];
    assert_eq!((&proposal["kind"], &proposal["shape_count"]), (&json!("curve"), &json!(2)), "{found}");
    assert_eq!(proposal["representation"]["kind"], "closed_curve");
    let count = proposal["representation"]["control_points"].as_u64().unwrap();
    assert!((5..=20).contains(&count), "{proposal}");
    assert!(proposal["relative_residual"].as_f64().unwrap() <= 0.01, "{proposal}");
    let both = inspect(lines(true) + &lines(false));
    assert_eq!(both["proposals"].as_array().unwrap().len(), 2, "{both}");
    assert_eq!(both["proposals"][1]["representation"]["kind"], "open_curve");
}
