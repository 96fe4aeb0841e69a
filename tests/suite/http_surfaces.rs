//! Surfaces over HTTP: what every endpoint of curves promises of them too, and what they refuse.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::server::{Server, assert_close, pointers_of, shared};

/// Fields of an object and what they are replaced by.
type Change = [(&'static str, Value)];

fn surface(topology: &str, control_points: [usize; 2]) -> Value {
    json!({"kind": "surface", "topology": topology, "control_points": control_points})
}

/// A grid of points of a function of `k/M_u` and `l/M_v`.
fn grid(count: [usize; 2], steps: [usize; 2], at: impl Fn(f64, f64) -> [f64; 3]) -> Value {
    let row = |k: usize| -> Vec<[f64; 3]> {
        (0..count[1]).map(|l| at(k as f64 / steps[0] as f64, l as f64 / steps[1] as f64)).collect()
    };
    json!((0..count[0]).map(row).collect::<Vec<_>>())
}

fn ellipsoid([a, b, c]: [f64; 3]) -> impl Fn(f64, f64) -> [f64; 3] {
    move |u, v| {
        let ((su, cu), (sv, cv)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
        [a * cu * sv, b * su * sv, c * cv]
    }
}

fn on_sphere([count_u, count_v]: [usize; 2], at: impl Fn(f64, f64) -> [f64; 3]) -> Value {
    grid([count_u, count_v + 1], [count_u, count_v], at)
}

/// A sphere of this size without symmetry: bumps that a seed places, moved and turned.
fn potato(size: [usize; 2], seed: usize) -> Value {
    let s = seed as f64;
    let round = ellipsoid([1.0 + 0.2 * (1.3 * s).sin(), 0.8 + 0.1 * (2.1 * s).cos(), 1.5]);
    on_sphere(size, move |u, v| {
        let [x, y, z] = round(u, v);
        let bump = 1.0 + 0.15 * (s + 2.0 * x).sin() * y + 0.1 * (0.7 * s).cos() * x * z;
        let (sine, cosine) = (0.9 * s).sin_cos();
        let [x, y, z] = [bump * x, bump * y, bump * z];
        [2.0 * s + cosine * x - sine * y, sine * x + cosine * y - s, z + 0.5 * s]
    })
}

fn potatoes(size: [usize; 2], count: usize) -> Vec<Value> {
    (0..count)
        .map(|seed| json!({"points": potato(size, seed), "external_id": format!("potato-{seed}")}))
        .collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn the_smallest_sphere_is_measured_exactly() {
    let server = shared();
    let body = json!({"representation": surface("sphere", [3, 2]), "shapes": [{"points": on_sphere([3, 2], ellipsoid([1.0; 3]))}],
        "field": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "offset": [5, 6, 7]}});
    let measures = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
    assert!((number(&measures["volume"]) - 4.0 * PI / 3.0).abs() < 1e-12, "{measures}");
    assert!((number(&measures["area"]) - 4.0 * PI).abs() < 1e-10, "{measures}");
    assert!((number(&measures["sphericity"]) - 1.0).abs() < 1e-10, "{measures}");
    // the divergence of the field is 3
    assert!((number(&measures["flux"]) - 4.0 * PI).abs() < 1e-12, "{measures}");
    assert_close(&measures["centroid"], &json!([0.0, 0.0, 0.0]), 1e-12, "centroid");
}

/// `F = (x³, y³, z³)` through the unit sphere: `∭ 3r² dV = 12π/5`; through a mesh, 3 V for the linear part.
#[test]
fn fluxes_of_polynomial_fields_are_exact() {
    let server = shared();
    let cubes = json!({"terms": [{"powers": [3, 0, 0], "coefficients": [1, 0, 0]}, {"powers": [0, 3, 0], "coefficients": [0, 1, 0]},
        {"powers": [0, 0, 3], "coefficients": [0, 0, 1]}, {"powers": [0, 0, 0], "coefficients": [5, 6, 7]}]});
    let body = |field: &Value| json!({"representation": surface("sphere", [5, 4]), "shapes": [{"points": on_sphere([5, 4], ellipsoid([1.0; 3]))}], "field": field});
    let measures = server.post("/v1/measure", &body(&cubes)).expect(200)["results"][0].clone();
    assert!((number(&measures["flux"]) - 12.0 * PI / 5.0).abs() < 1e-12, "{measures}");
    // An octahedron with the corners ±1 on the axes: ∭ x² dV = 2/15, so 3·3·2/15.
    let octahedron =
        json!({"kind": "subdivision", "scheme": "loop", "level": 0, "connectivity": "octahedron"});
    let corners = json!([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]);
    let mesh = json!({"representation": octahedron, "shapes": [{"control_points": corners}], "field": cubes});
    let measures = server.post("/v1/measure", &mesh).expect(200)["results"][0].clone();
    assert!((number(&measures["flux"]) - 1.2).abs() < 1e-14, "{measures}");

    let term = |powers: Value, coefficients: Value| json!({"terms": [{"powers": powers, "coefficients": coefficients}]});
    for (field, pointer) in [
        (term(json!([4, 4, 1]), json!([1, 0, 0])), "/field/terms/0/powers"),
        (term(json!([4, -4, 1]), json!([1, 0, 0])), "/field/terms/0/powers/1"),
        (term(json!([1, 1]), json!([1, 0, 0])), "/field/terms/0/powers"),
        (json!({}), "/field"),
        (json!({"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}), "/field/offset"),
        (json!({"terms": [], "offset": [0, 0, 0]}), "/field/terms"),
        (
            json!({"terms": vec![json!({"powers": [1, 0, 0], "coefficients": [1, 0, 0]}); 166]}),
            "/field/terms",
        ),
    ] {
        server.post("/v1/measure", &body(&field)).expect_problem(422, "invalid-input", &[pointer]);
    }
    let none = server.post("/v1/measure", &body(&json!({"terms": []}))).expect(200);
    assert_eq!(none["results"][0]["flux"], 0.0);
}

#[test]
fn a_torus_is_evaluated_with_its_normals_and_curvatures() {
    let server = shared();
    let torus = |u: f64, v: f64| {
        let ((su, cu), (sv, cv)) = ((TAU * u).sin_cos(), (TAU * v).sin_cos());
        [(2.0 + 0.5 * cv) * cu, (2.0 + 0.5 * cv) * su, 0.5 * sv]
    };
    let body = json!({"representation": surface("torus", [5, 4]), "shapes": [{"points": grid([5, 4], [5, 4], torus)}],
        "grid": [7, 6], "derivatives": 2, "frames": true});
    let evaluation = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0].clone();
    assert_close(&evaluation["points"], &grid([7, 6], [7, 6], torus), 1e-12, "points");
    for field in ["u", "v", "uu", "uv", "vv"] {
        assert_eq!(evaluation[field].as_array().unwrap().len(), 7, "{field}");
    }
    for i in 0..7 {
        for j in 0..6 {
            let (v, at) = (TAU * j as f64 / 6.0, i * 6 + j);
            let normal = &evaluation["normals"][at];
            assert!((number(&normal[2]) - v.sin()).abs() < 1e-12, "{normal}");
            let round = -v.cos() / (2.0 + 0.5 * v.cos());
            let (large, small) = (round.max(-2.0), round.min(-2.0));
            assert_close(
                &evaluation["principal_curvatures"][at],
                &json!([large, small]),
                1e-10,
                "curvatures",
            );
        }
    }
    let body = json!({"representation": surface("torus", [5, 4]), "shapes": [{"points": grid([5, 4], [5, 4], torus)}],
        "parameters": [[0.3, 0.4], [1.3, -0.6]]});
    let evaluation = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0].clone();
    assert_close(&evaluation["points"], &json!([torus(0.3, 0.4), torus(0.3, 0.4)]), 1e-12, "at parameters");
}

#[test]
fn what_is_evaluated_at_the_knots_can_be_posted_again() {
    let server = shared();
    for topology in ["sphere", "cylinder", "torus", "plane"] {
        let counts = match topology {
            "sphere" => [6, 6],
            "cylinder" => [6, 6],
            "torus" => [6, 5],
            _ => [7, 6],
        };
        let wave = |u: f64, v: f64| [u + 0.1 * (3.0 * v).sin(), v * v + 0.2 * u, (u - v).cos()];
        let round = ellipsoid([2.0, 1.0, 3.0]);
        let at = |u: f64, v: f64| if topology == "sphere" { round(u, v) } else { wave(u, v) };
        let representation = surface(topology, [6, 5]);
        let body = json!({"representation": representation, "shapes": [{"points": grid(counts, [6, 5], at)}], "grid": counts});
        let first = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone();
        assert_close(&first, &grid(counts, [6, 5], at), 1e-12, topology);
        let body = json!({"representation": representation, "shapes": [{"points": first}], "grid": [9, 8]});
        server.post("/v1/evaluate", &body).expect(200);
    }
}

#[test]
fn tangents_at_the_poles_are_taken_or_estimated() {
    let server = shared();
    let size = [8, 6];
    let evaluate = |poles: Value| {
        let mut shape = json!({"points": on_sphere(size, ellipsoid([2.0, 1.0, 1.0]))});
        if !poles.is_null() {
            shape["poles"] = poles;
        }
        let body = json!({"representation": surface("sphere", size), "shapes": [shape], "parameters": [[0.0, 0.0], [0.25, 0.0], [0.0, 1.0]], "derivatives": 1});
        server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["v"].clone()
    };
    let round = json!([[2.0 * PI, 0.0, 0.0], [0.0, PI, 0.0], [-2.0 * PI, 0.0, 0.0]]);
    assert_close(&evaluate(Value::Null), &round, 1e-11, "estimated");
    let given = json!({"north": {"tangents": [[1, 2, 3], [4, 5, 6]]}});
    assert_close(&evaluate(given), &json!([[1, 2, 3], [4, 5, 6], [-2.0 * PI, 0.0, 0.0]]), 1e-11, "given");
}

/// Numbers that a similarity of every shape must not change.
#[test]
fn means_and_components_of_surfaces_are_those_of_their_classes() {
    let server = shared();
    let body = |class: &str| {
        json!({"representation": surface("sphere", [6, 5]), "transformation": class, "frame": "canonical",
            "shapes": potatoes([6, 5], 6)})
    };
    let moved = |seed: usize, shape: &Value| -> Value {
        let s = seed as f64;
        let map = [[1.2, 0.4 * s, 0.1], [-0.3, 0.9, 0.2 * s], [0.5, 0.0, 1.4]];
        let point = |point: &Value| {
            let p: Vec<f64> = point.as_array().unwrap().iter().map(number).collect();
            json!([0, 1, 2].map(|c| (0..3).map(|i| map[c][i] * p[i]).sum::<f64>() + 10.0 * s))
        };
        let column = |column: &Value| column.as_array().unwrap().iter().map(point).collect::<Vec<_>>();
        json!({"points": shape["points"].as_array().unwrap().iter().map(column).collect::<Vec<_>>()})
    };
    let before = server.post("/v1/mean", &body("affine")).expect(200);
    let mut after = body("affine");
    after["shapes"] =
        json!(potatoes([6, 5], 6).iter().enumerate().map(|(i, s)| moved(i, s)).collect::<Vec<_>>());
    let after = server.post("/v1/mean", &after).expect(200);
    assert_close(&after["mean"]["control_points"], &before["mean"]["control_points"], 1e-8, "affine mean");
    assert_close(&after["eigenvalues"], &before["eigenvalues"], 1e-9, "eigenvalues");

    let mut body = body("similarity");
    body["alignment"] = json!("procrustes");
    body["frame"] = json!("training");
    let mut components = body.clone();
    components["components"] = json!(3);
    let answer = server.post("/v1/pca", &components).expect(200);
    assert_eq!(answer["pca"]["scores"].as_array().unwrap().len(), 6);
    server.post("/v1/pca?format=svg&component=1", &components).expect_svg();
    let svg = server.post("/v1/mean?format=svg", &body).expect_svg().to_owned();
    assert!(svg.contains("mean of 6 shapes"), "{}", &svg[..400]);
}

#[test]
fn a_mean_of_one_shape_moved_about_is_that_shape() {
    let server = shared();
    let shape = |t: f64| {
        let round = ellipsoid([3.0, 2.0, 1.0]);
        let (sine, cosine) = t.sin_cos();
        let size = 1.0 + t;
        on_sphere([8, 6], move |u, v| {
            let [x, y, z] = round(u, v);
            [size * (cosine * x - sine * z) + t, size * y - 4.0 * t, size * (sine * x + cosine * z)]
        })
    };
    let shapes: Vec<Value> = [0.0, 0.4, 1.1].iter().map(|t| json!({"points": shape(*t)})).collect();
    let body = json!({"representation": surface("sphere", [8, 6]), "transformation": "similarity", "alignment": "procrustes", "shapes": shapes});
    let aligned = server.post("/v1/align", &body).expect(200);
    for shape in aligned["aligned"].as_array().unwrap() {
        assert!(number(&shape["residual"]) < 1e-12, "{}", shape["residual"]);
    }
}

/// The mirror image of a sphere has its normals outside: longitudes run the other way round.
#[test]
fn mirror_images_of_surfaces_are_matched() {
    let server = shared();
    let bumpy = |u: f64, v: f64| {
        let [x, y, z] = ellipsoid([3.0, 2.0, 1.0])(u, v);
        [x * (1.0 + 0.2 * y), y + 0.3 * z * x, z + 0.2 * x * y]
    };
    let mirrored = |u: f64, v: f64| {
        let [x, y, z] = bumpy(-u, v);
        [-x + 5.0, y, z]
    };
    let mut body = json!({"representation": surface("sphere", [12, 9]), "transformation": "similarity", "alignment": "procrustes",
        "shapes": [{"points": on_sphere([12, 9], bumpy)}, {"points": on_sphere([12, 9], mirrored)}]});
    let measure = json!({"representation": body["representation"], "shapes": body["shapes"]});
    for measures in server.post("/v1/measure", &measure).expect(200)["results"].as_array().unwrap() {
        assert!(number(&measures["signed_volume"]) > 0.0, "{measures}");
    }
    let forbidden = server.post("/v1/align", &body).expect(200);
    assert!(number(&forbidden["aligned"][1]["residual"]) > 0.05, "{}", forbidden["aligned"][1]["residual"]);
    body["mirror"] = json!("allow");
    let allowed = server.post("/v1/align", &body).expect(200);
    let other = &allowed["aligned"][1];
    assert!(number(&other["residual"]) < 1e-7, "{}", other["residual"]);
    let flags = |shape: &Value| (shape["reversed"].as_bool().unwrap(), shape["reflected"].as_bool().unwrap());
    assert_ne!(flags(&allowed["aligned"][0]), flags(other));
    assert_eq!(flags(other).0, flags(other).1, "a mirror image runs backwards");
}

#[test]
fn a_cohort_of_surfaces_has_everything_that_one_of_curves_has() {
    let server = Server::fresh();
    let size = [8, 6];
    let cohort = json!({"name": "potatoes", "representation": surface("sphere", size), "length_unit": "mm"});
    let created = server.post("/v1/cohorts", &cohort).expect(201);
    assert_eq!(created["representation"]["generators"][1]["name"], "trigonometric");
    let mut shapes = potatoes(size, 24);
    for (i, shape) in shapes.iter_mut().enumerate() {
        shape["label"] = json!(if i % 2 == 0 { "even" } else { "odd" });
        shape["labels"] = json!({"age": i});
    }
    server.post("/v1/cohorts/potatoes/shapes", &json!({"shapes": shapes})).expect(201);

    let found = server.get("/v1/cohorts/potatoes/shapes/potato-3").expect(200);
    assert_eq!(found["control_points"].as_array().unwrap().len(), 8 * 5 + 6);
    server.get("/v1/cohorts/potatoes/shapes/potato-3?format=svg").expect_svg();
    let mesh = server.get("/v1/cohorts/potatoes/shapes/potato-3?format=obj&grid=12,9");
    assert_eq!((mesh.status, mesh.header("content-type")), (200, Some("model/obj")));
    assert_eq!(mesh.text().lines().filter(|line| line.starts_with("v ")).count(), 12 * 7 + 2);
    server
        .get("/v1/cohorts/potatoes/mean?transformation=similarity&alignment=procrustes&format=svg")
        .expect_svg();
    for (format, start) in [("ply", b"ply\n"), ("gltf", b"glTF")] {
        let mesh = server.get(&format!("/v1/cohorts/potatoes/mean?transformation=affine&format={format}"));
        assert_eq!(mesh.status, 200, "{}", mesh.text());
        assert!(mesh.body.starts_with(start));
    }

    for (name, method) in [
        ("modes", json!({"kind": "functional_pca", "components": 4, "centre": true})),
        ("atoms", json!({"kind": "sparse", "atoms": 6, "nonzeros": 2, "max_epochs": 10})),
    ] {
        let request = json!({"name": name, "cohort": "potatoes", "transformation": "affine", "method": method,
            "classifier": {"kind": "nearest_neighbours", "attribute": "label", "repeats": 1}});
        let wait = server
            .request(reqwest::Method::POST, "/v1/dictionaries")
            .header("prefer", "wait=50")
            .json(&request);
        let reply = server.send(wait);
        assert!([200, 201].contains(&reply.status), "{name}: {} {}", reply.status, reply.text());
        for question in ["encode", "score", "prior", "classify", "assess"] {
            let path = format!("/v1/dictionaries/{name}/{question}");
            server.post(&path, &json!({"shapes": potatoes(size, 2)})).expect(200);
        }
        let body = json!({"shapes": potatoes(size, 2), "samples": 5});
        let answer = server.post(&format!("/v1/dictionaries/{name}/reconstruct"), &body).expect(200);
        // Surfaces are compared at their knots.
        assert_eq!(answer["results"][0]["residual"].as_array().unwrap().len(), 8 * 7, "{name}");
        server.get(&format!("/v1/dictionaries/{name}/atoms?format=svg")).expect_svg();
    }
    let drawn = server.get("/v1/dictionaries/modes/atoms?format=svg");
    let heights: Vec<&str> = drawn
        .text()
        .split("<text")
        .filter(|text| text.split("</text>").next().unwrap().ends_with('σ'))
        .map(|text| text.split(" y=\"").nth(1).unwrap().split('"').next().unwrap())
        .collect();
    assert_eq!(heights.len(), 8, "two sides of each of four modes: {}", drawn.text());
    assert!(
        heights.chunks(2).all(|sides| sides[0] == sides[1]),
        "both sides of a mode stand beside each other: {heights:?}"
    );
    server.get("/v1/dictionaries/modes/modes?component=1&sigma=2&format=svg").expect_svg();
    let mesh = server.get("/v1/dictionaries/modes/modes?component=1&sigma=-2&format=stl");
    assert_eq!((mesh.status, mesh.header("content-type")), (200, Some("model/stl")));
    let file = server.get("/v1/dictionaries/modes/modes?sigma=1.5&format=gltf&grid=12,9");
    let length = u32::from_le_bytes(file.body[12..16].try_into().unwrap()) as usize;
    let scene: Value = serde_json::from_slice(&file.body[20..20 + length]).unwrap();
    let mesh = &scene["meshes"][0];
    assert_eq!(mesh["extras"]["targetNames"], json!(["mode 1", "mode 2", "mode 3", "mode 4"]));
    assert_eq!(mesh["extras"]["targets"][0]["standard_deviations"], 1.5);
    assert_eq!(mesh["primitives"][0]["targets"].as_array().unwrap().len(), 4);
    assert_eq!(scene["animations"].as_array().unwrap().len(), 4);
    let one = server.get("/v1/dictionaries/modes/modes?component=2&format=gltf");
    assert!(one.status == 200 && one.body.len() < 4 * file.body.len());
    server.get("/v1/dictionaries/modes/modes?component=5&format=gltf").expect_problem(
        400,
        "invalid-query",
        &[],
    );
    server.get("/v1/dictionaries/modes/modes?format=gltf&grid=700,700").expect_problem(
        400,
        "invalid-query",
        &[],
    );
    let assess = json!({"shapes": potatoes(size, 2)});
    for path in ["modes/assess", "modes/reconstruct", "atoms/reconstruct"] {
        server.post(&format!("/v1/dictionaries/{path}?format=svg&width=200"), &assess).expect_svg();
    }
    let sheet = server.get("/v1/cohorts/potatoes/sheet?columns=4");
    assert!(sheet.expect_svg().contains("<title>potato-0</title>"));
    assert!(sheet.header("link").is_some(), "a page has at most 12 surfaces");
    let search = json!({"shapes": potatoes(size, 1), "transformation": "affine", "neighbours": 3});
    server.post("/v1/cohorts/potatoes/search?format=svg", &search).expect_svg();
    let nearest = server.post("/v1/cohorts/potatoes/search", &search).expect(200);
    assert!(nearest.to_string().contains("potato-0"), "{nearest}");
    let compare = json!({"cohort": "potatoes", "transformation": "affine", "by": "label", "permutations": 99, "seed": 1});
    let comparison = server.post("/v1/comparisons", &compare).expect(200);
    let pair = &comparison["pairs"][0];
    assert_eq!(pair["effect"].as_array().unwrap().len(), 8 * 7);
    let sizes: Vec<&str> =
        pair["sizes"].as_array().unwrap().iter().map(|s| s["measure"].as_str().unwrap()).collect();
    assert_eq!(sizes, ["volume", "area", "centroid_size"]);
    server.post("/v1/comparisons?format=svg", &compare).expect_svg();
    let regress = json!({"cohort": "potatoes", "transformation": "affine", "attribute": "labels.age", "permutations": 99, "seed": 1});
    server.post("/v1/regressions", &regress).expect(200);
    server.post("/v1/regressions?format=svg", &regress).expect_svg();
}

#[test]
fn grids_and_meshes_are_fitted() {
    let server = shared();
    let representation = surface("sphere", [6, 5]);
    // A grid that is finer than the surface: its own points give it back.
    let fine = on_sphere([18, 14], ellipsoid([3.0, 2.0, 1.0]));
    let fits = server
        .post("/v1/fit", &json!({"representation": representation, "shapes": [{"points": fine}]}))
        .expect(200);
    assert!(number(&fits["results"][0]["residual"]) < 1e-12, "{}", fits["results"][0]["residual"]);

    let body = json!({"representation": representation, "shapes": [{"points": on_sphere([6, 5], ellipsoid([3.0, 2.0, 1.0]))}]});
    let mesh = server.post("/v1/evaluate?format=obj&grid=24,17", &body);
    let numbers = |line: &str| -> Vec<f64> {
        line.split_whitespace().skip(1).map(|word| word.parse().unwrap()).collect()
    };
    let vertices: Vec<Vec<f64>> =
        mesh.text().lines().filter(|line| line.starts_with("v ")).map(numbers).collect();
    let corner = |word: &str| word.split('/').next().unwrap().parse::<usize>().unwrap() - 1;
    let faces: Vec<Vec<usize>> = mesh
        .text()
        .lines()
        .filter(|line| line.starts_with("f "))
        .map(|line| line.split_whitespace().skip(1).map(corner).collect())
        .collect();
    assert_eq!(vertices.len() + faces.len() / 2, 2 * vertices.len() - 2, "a sphere");
    let fit = |extra: &Change| {
        let mut mesh = json!({"vertices": vertices, "faces": faces});
        extra.iter().for_each(|(name, value)| mesh[*name] = value.clone());
        server.post("/v1/fit", &json!({"representation": representation, "meshes": [mesh]}))
    };
    // Directions of an ellipsoid that is made round are its own parameters. What is fitted is the mesh, flat faces and all.
    let sphere: Vec<[f64; 3]> = vertices.iter().map(|v| [v[0] / 3.0, v[1] / 2.0, v[2]]).collect();
    let given = fit(&[("sphere", json!(sphere))]).expect(200)["results"][0].clone();
    assert!(number(&given["residual"]) < 0.02 && number(&given["folded"]) == 0.0, "{}", given["residual"]);
    let corner = |i: usize| [0, 1, 2].map(|c| vertices[i][c]);
    let six_fold = |face: &Vec<usize>| {
        let ([a, b, c], [d, e, f], [g, h, i]) = (corner(face[0]), corner(face[1]), corner(face[2]));
        a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    };
    let within = faces.iter().map(six_fold).sum::<f64>() / 6.0;
    let volume_of = |representation: &Value, fit: &Value| {
        let shape = json!({"control_points": fit["control_points"]});
        let body = json!({"representation": representation, "shapes": [shape]});
        number(&server.post("/v1/measure", &body).expect(200)["results"][0]["volume"])
    };
    let volume = volume_of(&representation, &given);
    assert!((volume / within - 1.0).abs() < 5e-3, "{volume} in {within}");
    let again = fit(&[("parameters", given["parameters"].clone())]).expect(200)["results"][0].clone();
    assert_close(&again["control_points"], &given["control_points"], 1e-12, "parameters given back");
    let larger = surface("sphere", [10, 10]);
    let body = json!({"representation": larger, "meshes": [{"vertices": vertices, "faces": faces}]});
    let computed = server.post("/v1/fit", &body).expect(200)["results"][0].clone();
    // No ellipsoid of these parameters is in the space: less than 3 % of the longest axis is left.
    assert!(number(&computed["residual"]) < 0.09, "{}", computed["residual"]);
    let volume = volume_of(&larger, &computed);
    assert!((volume / within - 1.0).abs() < 0.01, "{volume} in {within}");

    // Faces that are seen clockwise from outside: the fit would be inside out.
    let flipped: Vec<Vec<usize>> = faces.iter().map(|f| vec![f[0], f[2], f[1]]).collect();
    let problem = fit(&[("sphere", json!(sphere)), ("faces", json!(flipped))]).expect_problem(
        422,
        "invalid-input",
        &["/meshes/0"],
    );
    assert!(problem.to_string().contains("100.0 % of the area"), "{problem}");
    let open = fit(&[("faces", json!(faces[1..]))]);
    open.expect_problem(422, "invalid-input", &["/meshes/0/faces/0"]);
    fit(&[("sphere", json!(sphere[1..]))]).expect_problem(422, "invalid-input", &["/meshes/0/sphere"]);
    fit(&[("faces", json!([[0, 1, 9999]]))]).expect_problem(422, "invalid-input", &["/meshes/0/faces/0"]);
    fit(&[("vertices", Value::Null)]).expect_problem(422, "invalid-input", &["/meshes/0/vertices"]);
    let large = json!({"representation": surface("sphere", [45, 45]), "meshes": vec![json!({}); 40]});
    server.post("/v1/fit", &large).expect_problem(422, "too-costly", &[]);
    fit(&[("faces", json!([[0, 1, -2]]))]).expect_problem(422, "invalid-input", &["/meshes/0/faces/0/2"]);
}

/// The smallest size that meets a tolerance: one less does not.
#[test]
fn a_tolerance_chooses_the_size_of_a_surface() {
    let server = shared();
    let shape = json!({"points": potato([40, 30], 1)});
    let fit = |representation: Value| {
        server.post("/v1/fit", &json!({"representation": representation, "shapes": [shape]}))
    };
    let mut before = 0;
    for tolerance in [0.03, 0.01, 0.003] {
        let wanted = json!({"kind": "surface", "topology": "sphere", "tolerance": tolerance});
        let found = fit(wanted).expect(200)["results"][0].clone();
        assert!(number(&found["residual"]) <= tolerance, "{} for {tolerance}", found["residual"]);
        let size = found["representation"]["control_points"].clone();
        let width = size[0].as_u64().unwrap() as usize;
        assert_eq!(size, json!([width, width]));
        assert!(width > before, "{width} after {before}");
        before = width;
        let smaller = fit(surface("sphere", [width - 1, width - 1])).expect(200)["results"][0].clone();
        assert!(number(&smaller["residual"]) > tolerance, "{} at {}", smaller["residual"], width - 1);
    }
    let twisted = json!({"kind": "surface", "topology": "torus", "seam": "half_turn", "tolerance": 1e3});
    let mut grid = potato([12, 7], 1);
    grid.as_array_mut().unwrap().iter_mut().for_each(|row| row.as_array_mut().unwrap().truncate(8));
    let body = json!({"representation": twisted, "shapes": [{"points": grid}]});
    let found = server.post("/v1/fit", &body).expect(200)["results"][0].clone();
    assert_eq!(found["representation"]["control_points"], json!([3, 4]));
    let never = json!({"kind": "surface", "topology": "sphere", "tolerance": 1e-12});
    let problem = fit(never).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
    assert!(problem.to_string().contains("no fit reaches the tolerance"), "{problem}");
    let both = json!({"kind": "surface", "topology": "sphere", "tolerance": 0.1, "control_points": [6, 6]});
    fit(both).expect_problem(422, "invalid-input", &["/representation/tolerance"]);
    let wrong = json!({"kind": "surface", "topology": "sphere", "tolerance": -1});
    fit(wrong).expect_problem(422, "invalid-input", &["/representation/tolerance"]);
}

#[test]
fn surfaces_are_resized_with_the_change_told() {
    let server = shared();
    let body = |extra: Value| {
        let mut body =
            json!({"representation": surface("sphere", [6, 5]), "shapes": [{"points": potato([6, 5], 1)}]});
        body.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        body
    };
    let finer = server.post("/v1/refine", &body(json!({"factor": 4}))).expect(200);
    assert_eq!(finer["representation"]["control_points"], json!([24, 20]));
    assert!(number(&finer["shapes"][0]["l2_change"]) < 0.02, "{}", finer["shapes"][0]["l2_change"]);
    let smaller = server.post("/v1/refine", &body(json!({"control_points": [5, 3]}))).expect(200);
    assert!(number(&smaller["shapes"][0]["l2_change"]) > number(&finer["shapes"][0]["l2_change"]));
    assert_eq!(smaller["exact"], false);
    server.post("/v1/refine", &body(json!({"control_points": [2, 3]}))).expect_problem(
        422,
        "invalid-input",
        &["/control_points"],
    );
    server.post("/v1/refine", &body(json!({"factor": 400}))).expect_problem(
        422,
        "invalid-input",
        &["/factor"],
    );
    server.post("/v1/refine", &body(json!({"factor": 2, "control_points": [8, 8]}))).expect_problem(
        422,
        "invalid-input",
        &["/control_points"],
    );
}

/// Half-integer shifts along both directions: the refined torus is the same, at parameters half a fine interval further on.
#[test]
fn surfaces_of_half_integer_shifts_are_refined_exactly() {
    let server = shared();
    let circle = json!([[0, 0], [0, TAU], [0, -TAU]]);
    let shifts = json!({"name": "interpolator", "family": "half_integer_shifts", "domain_poles": circle});
    let representation = json!({"kind": "surface", "topology": "torus", "control_points": [4, 4], "generators": [shifts, shifts]});
    let mut rows = vec![[0.0; 3]; 16];
    (0..16).for_each(|k| rows[k] = [(k * k % 7) as f64, (k % 5) as f64, (k * 3 % 11) as f64]);
    let body = json!({"representation": representation, "shapes": [{"control_points": rows}], "factor": 2});
    let answer = server.post("/v1/refine", &body).expect(200);
    assert_eq!(
        (&answer["exact"], &answer["shapes"][0]["l2_change"]),
        (&json!(true), &Value::Null),
        "{answer}"
    );
    assert_eq!(answer["representation"]["generators"][0]["name"], "exponential");
    assert_eq!(answer["parameter_shifts"], json!([0.0625, 0.0625]));
    assert_eq!(answer["parameter_shift"], json!(0.0625));
    let places: Vec<[f64; 2]> =
        (0..40).map(|k| [f64::from(k) / 40.0, f64::from(k * 7 % 40) / 40.0]).collect();
    let at = |representation: &Value, rows: &Value, shift: f64| {
        let places: Vec<[f64; 2]> = places.iter().map(|place| place.map(|x| (x + shift) % 1.0)).collect();
        let body = json!({"representation": representation, "parameters": places, "shapes": [{"control_points": rows}]});
        server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone()
    };
    let before = at(&representation, &json!(rows), 0.0);
    let after = at(&answer["representation"], &answer["shapes"][0]["control_points"], 0.0625);
    assert_close(&after, &before, 1e-11, "the refined torus");
    // One direction alone, by numbers of control points.
    let body = json!({"representation": representation, "shapes": [{"control_points": rows}], "control_points": [4, 8]});
    let answer = server.post("/v1/refine", &body).expect(200);
    assert_eq!(answer["parameter_shifts"], json!([0.0, 0.0625]));
    assert_eq!(answer["exact"], true);
    assert_eq!(answer["representation"]["generators"][0]["name"], "interpolator");
}

/// Odd lists of poles along open directions and meridians: the refined surface is the same at the same parameters, and is evaluated,
/// measured, drawn, stored, compared and refined again as any other.
#[test]
fn odd_lists_of_poles_are_refined_exactly_along_open_directions() {
    let server = Server::fresh();
    let shifts = |w: f64| json!({"name": "interpolator", "family": "half_integer_shifts", "domain_poles": [[0, 0], [0, w], [0, -w]]});
    let quadratic = json!({"name": "bspline", "degree": 2});
    let round = json!({"name": "exponential", "domain_poles": [[0, 0], [0, TAU], [0, -TAU]]});
    let cases = [
        ("sphere", [shifts(TAU), shifts(PI)], 21),
        ("sphere", [round.clone(), quadratic.clone()], 21),
        ("sharp_sphere", [shifts(TAU), shifts(PI)], 27),
        ("cylinder", [shifts(TAU), shifts(1.0)], 35),
        ("cylinder", [round, quadratic.clone()], 35),
        ("plane", [quadratic, shifts(1.0)], 56),
    ];
    let places: Vec<[f64; 2]> =
        (0..40).map(|k| [f64::from(k) / 40.0, f64::from(k * 7 % 41) / 40.0]).collect();
    for (index, (topology, generators, count)) in cases.into_iter().enumerate() {
        let representation = json!({"kind": "surface", "topology": topology, "control_points": [5, 4], "generators": generators});
        let number_at = |k: usize, c: usize| (1.0 + (k * 11 + c * 5) as f64).sin() * 0.3;
        let rows: Vec<[f64; 3]> = (0..count)
            .map(|k| [0, 1, 2].map(|c| number_at(k, c) + [k as f64 / 5.0, (k % 5) as f64, (k % 3) as f64][c]))
            .collect();
        let shape = json!({"control_points": rows});
        let evaluated = |representation: &Value, shape: &Value, shifts: &Value| {
            let moved: Vec<[f64; 2]> = places
                .iter()
                .map(|[u, v]| [(u + number(&shifts[0])) % 1.0, v + number(&shifts[1])])
                .collect();
            let body = json!({"representation": representation, "parameters": moved, "shapes": [shape]});
            server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone()
        };
        let measured = |representation: &Value, shape: &Value| {
            let body = json!({"representation": representation, "shapes": [shape]});
            number(&server.post("/v1/measure", &body).expect(200)["results"][0]["area"])
        };
        let before = evaluated(&representation, &shape, &json!([0, 0]));
        let body = json!({"representation": representation, "shapes": [shape], "factor": 2});
        let answer = server.post("/v1/refine", &body).expect(200);
        let (fine, refined) = (&answer["representation"], &answer["shapes"][0]);
        assert_eq!((&answer["exact"], &refined["l2_change"]), (&json!(true), &Value::Null), "{answer}");
        assert_eq!(answer["parameter_shifts"][1], 0.0, "{topology}");
        assert_eq!(fine["generators"][1]["name"], "shifted_exponential");
        assert_close(&evaluated(fine, refined, &answer["parameter_shifts"]), &before, 1e-12, topology);
        let [area, wanted] = [measured(fine, refined), measured(&representation, &shape)];
        // Areas of surfaces that fold are known to few digits.
        assert!((area - wanted).abs() <= 1e-3 * wanted, "{topology}: {area} for {wanted}");
        // Again, by a number that has no two-scale relation for half-integer shifts.
        let body = json!({"representation": fine, "shapes": [refined], "control_points": [10, 24]});
        let again = server.post("/v1/refine", &body).expect(200);
        assert_eq!(again["exact"], true, "{again}");
        let both: Vec<f64> = [0, 1]
            .map(|i| number(&answer["parameter_shifts"][i]) + number(&again["parameter_shifts"][i]))
            .into();
        assert_close(
            &evaluated(&again["representation"], &again["shapes"][0], &json!(both)),
            &before,
            1e-12,
            topology,
        );
        // Stored.
        let name = format!("refined-{index}");
        let cohort = json!({"name": name, "representation": fine, "correspondence": "landmarks"});
        server.post("/v1/cohorts", &cohort).expect(201);
        assert_eq!(&server.get(&format!("/v1/cohorts/{name}")).expect(200)["representation"], fine);
        let shapes = json!([{"external_id": "a", "control_points": refined["control_points"]}]);
        server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
        let stored = server.get(&format!("/v1/cohorts/{name}/shapes/a")).expect(200);
        assert_close(&stored["control_points"], &refined["control_points"], 0.0, "stored");
        server.get(&format!("/v1/cohorts/{name}/shapes/a?format=svg")).expect_svg();
    }
}

/// Tangents at smooth poles are waves that B-splines along `u` do not have: sampled along `u`, exact along `v` and with sharp poles.
#[test]
fn a_smooth_sphere_of_cubic_splines_is_refined_along_its_meridians_only() {
    let server = shared();
    let cubic = json!({"name": "bspline", "degree": 3});
    for (topology, count, size, exact) in
        [("sphere", 21, [5, 8], true), ("sphere", 21, [10, 4], false), ("sharp_sphere", 27, [10, 8], true)]
    {
        let rows: Vec<[f64; 3]> =
            (0..count).map(|k| [0, 1, 2].map(|c| f64::from(k * k * (c + 2) % 17))).collect();
        let body = json!({"representation": {"kind": "surface", "topology": topology, "control_points": [5, 4], "generators": [cubic, cubic]},
            "shapes": [{"control_points": rows}], "control_points": size});
        let answer = server.post("/v1/refine", &body).expect(200);
        assert_eq!(answer["exact"], exact, "{topology} {size:?}");
        assert_eq!(answer["shapes"][0]["l2_change"].is_null(), exact, "{topology} {size:?}");
    }
}

/// Domain poles along a meridian belong to functions of `v ∈ [0, 1]`, as along every direction: `sin πv` needs ±πj.
#[test]
fn domain_poles_along_a_meridian_are_those_of_functions_of_v() {
    let server = shared();
    let exponential = |w: f64| json!({"name": "exponential", "domain_poles": [[0, 0], [0, w], [0, -w]]});
    let representation = |w: f64| json!({"kind": "surface", "topology": "sphere", "control_points": [9, 9], "generators": [exponential(TAU), exponential(w)]});
    let body = |w: f64| json!({"representation": representation(w), "surfaces": [{"surface": {"name": "sphere", "radius": 1}}]});
    let rows = server.post("/v1/idealised", &body(PI)).expect(200)["shapes"][0].clone();
    server.post("/v1/idealised", &body(TAU)).expect_problem(422, "invalid-input", &["/surfaces/0/surface"]);
    // Answered under a name of their own, which can be posted as it is.
    let shape = json!({"control_points": rows["control_points"]});
    let refined = json!({"representation": representation(PI), "shapes": [shape], "factor": 3});
    let refined = server.post("/v1/refine", &refined).expect(200);
    assert_eq!(refined["exact"], true, "{refined}");
    assert!(refined["representation"]["generators"][1]["meridian_poles"].is_array(), "{refined}");
    let measure = json!({"representation": refined["representation"], "shapes": refined["shapes"]});
    let measures = server.post("/v1/measure", &measure).expect(200)["results"][0].clone();
    assert!((number(&measures["volume"]) - 4.0 * PI / 3.0).abs() < 1e-12, "{measures}");
    server
        .post(
            "/v1/cohorts",
            &json!({"name": "round", "representation": representation(PI), "correspondence": "landmarks"}),
        )
        .expect(201);
    let stored = server.get("/v1/cohorts/round").expect(200)["representation"].clone();
    assert_eq!(stored["generators"][1]["meridian_poles"][1], json!([0.0, PI]));
}

#[test]
fn the_catalogue_of_surfaces_is_exact() {
    let server = shared();
    let catalogue = server.get("/v1/idealised").expect(200);
    let names: Vec<&str> = catalogue["surfaces"]
        .as_array()
        .unwrap()
        .iter()
        .map(|e| e["surface"]["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "sphere",
            "ellipsoid",
            "cylinder",
            "torus",
            "roman",
            "hyperbolic_paraboloid",
            "figure_eight",
            "helicoid",
            "pinched_torus"
        ]
    );
    for entry in catalogue["surfaces"].as_array().unwrap() {
        let body = json!({"representation": entry["representation"], "surfaces": [{"surface": entry["surface"], "centre": [1, 2, 3], "angle": 0.5}]});
        let placed = server.post("/v1/idealised", &body).expect(200)["shapes"][0].clone();
        let measure = |shape: &Value| {
            let body = json!({"representation": entry["representation"], "shapes": [shape]});
            server.post("/v1/measure", &body).expect(200)["results"][0].clone()
        };
        let (here, there) = (measure(&json!({"control_points": entry["control_points"]})), measure(&placed));
        assert!((number(&here["area"]) / number(&there["area"]) - 1.0).abs() < 1e-9, "{}", entry["surface"]);
        let svg = json!({"representation": entry["representation"], "shapes": [placed]});
        server.post("/v1/evaluate?format=svg", &svg).expect_svg();
        let mesh = server.post("/v1/evaluate?format=gltf", &svg);
        assert_eq!((mesh.status, mesh.header("content-type")), (200, Some("model/gltf-binary")));
    }
    let body = json!({"representation": surface("cylinder", [3, 2]), "surfaces": [{"surface": {"name": "sphere", "radius": 1}}]});
    server.post("/v1/idealised", &body).expect_problem(422, "invalid-input", &["/surfaces/0/surface"]);
    let body = json!({"representation": surface("torus", [3, 3]), "surfaces": [{"surface": {"name": "roman", "radius": 1}}]});
    let problem =
        server.post("/v1/idealised", &body).expect_problem(422, "invalid-input", &["/surfaces/0/surface"]);
    assert!(problem.to_string().contains("5 × 5"), "{problem}");
}

/// The JSON part of a glTF file.
fn scene(file: &[u8]) -> Value {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&file[20..20 + length]).unwrap()
}

/// Lines of a text that begin with a word.
fn count_of(text: &str, word: &str) -> usize {
    text.lines().filter(|line| line.split(' ').next() == Some(word)).count()
}

/// A place `(u, v)` of a picture for every corner: two for a vertex where `u` closes, one for each triangle at a pole.
#[test]
fn surfaces_are_written_with_texture_coordinates() {
    let server = shared();
    let body =
        json!({"representation": surface("sphere", [8, 6]), "shapes": [{"points": potato([8, 6], 0)}]});
    let obj = server.post("/v1/evaluate?format=obj&grid=12,9", &body);
    let text = obj.text();
    // 12 × 7 vertices and two poles; 13 × 7 places, and 24 at the poles.
    let counts = ["v", "vt", "vn", "f"].map(|word| count_of(text, word));
    assert_eq!(counts, [86, 115, 86, 12 * 6 * 2 + 24]);
    let place = |line: &str| -> Vec<f64> { line.split(' ').skip(1).map(|x| x.parse().unwrap()).collect() };
    let places: Vec<Vec<f64>> = text.lines().filter(|line| line.starts_with("vt ")).map(place).collect();
    assert!(places.iter().flatten().all(|x| (0.0..=1.0).contains(x)));
    // Both ends of the rows nearest to the poles; the first pole is at the top of the picture, which is its end in this format.
    for corner in [[0.0, 0.875], [1.0, 0.875], [0.0, 0.125], [1.0, 0.125]] {
        assert_eq!(places.iter().filter(|place| **place == corner).count(), 1, "{corner:?}");
    }
    assert!(text.lines().filter(|line| line.starts_with("f ")).all(|line| line.matches('/').count() == 6));
    let file = server.post("/v1/evaluate?format=gltf&grid=12,9", &body);
    let scene = scene(&file.body);
    let attributes = &scene["meshes"][0]["primitives"][0]["attributes"];
    for kind in ["POSITION", "NORMAL", "TEXCOORD_0"] {
        let accessor = &scene["accessors"][attributes[kind].as_u64().unwrap() as usize];
        assert_eq!(accessor["count"], 115, "{kind}");
    }
    // Meshes without parameters have none.
    let mesh = server
        .post("/v1/subdivide?format=obj", &json!({"scheme": "loop", "level": 1, "start": "octahedron"}));
    assert_eq!(count_of(mesh.text(), "vt"), 0);
}

/// The thesis shows paths as rows of surfaces: an object for each in OBJ, a mesh that moves through them in glTF.
#[test]
fn frames_of_a_morph_are_meshes() {
    let server = shared();
    let (first, second) = (json!({"points": potato([8, 6], 0)}), json!({"points": potato([8, 6], 1)}));
    let body = json!({"representation": surface("sphere", [8, 6]), "from": first, "to": second, "positions": [0, 0.25, 1, 1.5]});
    let obj = server.post("/v1/morph?format=obj&grid=12,9", &body);
    assert_eq!((obj.status, obj.header("content-type")), (200, Some("model/obj")));
    let text = obj.text();
    let names: Vec<&str> = text.lines().filter(|line| line.starts_with("o ")).collect();
    assert_eq!(names, ["o position_0", "o position_0.25", "o position_1", "o position_1.5"]);
    assert_eq!(["v", "vt", "f"].map(|word| count_of(text, word)), [4 * 86, 4 * 115, 4 * 168]);
    // The last object is the mesh of the last frame.
    let frames = server.post("/v1/morph", &body).expect(200)["frames"].clone();
    let last = json!({"representation": surface("sphere", [8, 6]), "shapes": [{"control_points": frames[3]["control_points"]}]});
    let alone = server.post("/v1/evaluate?format=obj&grid=12,9", &last).text().to_owned();
    let vertices = |text: &str| -> Vec<String> {
        text.lines().filter(|line| line.starts_with("v ")).map(str::to_owned).collect()
    };
    assert_eq!(vertices(text)[3 * 86..], vertices(&alone));

    let file = server.post("/v1/morph?format=gltf&grid=12,9", &body);
    assert_eq!((file.status, file.header("content-type")), (200, Some("model/gltf-binary")));
    let scene = scene(&file.body);
    let mesh = &scene["meshes"][0];
    assert_eq!(mesh["extras"]["targetNames"], json!(["position 0.25", "position 1", "position 1.5"]));
    assert_eq!(mesh["primitives"][0]["targets"].as_array().unwrap().len(), 3);
    assert_eq!(scene["animations"].as_array().unwrap().len(), 1);

    let one =
        json!({"representation": surface("sphere", [8, 6]), "from": first, "to": second, "positions": [0.5]});
    assert_eq!(server.post("/v1/morph?format=stl", &one).status, 200);
    let said = server
        .post("/v1/morph?format=ply", &body)
        .expect_problem(422, "invalid-input", &["/positions"])
        .to_string();
    assert!(said.contains("got 4"), "{said}");
    server.post("/v1/morph?format=gltf&animate=true", &body).expect_problem(400, "invalid-query", &[]);
    server.post("/v1/morph?format=gltf&grid=2,2", &body).expect_problem(400, "invalid-query", &[]);
    let many =
        json!({"representation": surface("sphere", [8, 6]), "from": first, "to": second, "steps": 1000});
    server.post("/v1/morph?format=obj&grid=300,300", &many).expect_problem(
        422,
        "invalid-input",
        &["/positions"],
    );
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 3, "generator": {"name": "trigonometric"}});
    let triangle = json!({"points": [[1, 0], [0, 1], [-1, 0]]});
    let flat = json!({"representation": curve, "from": triangle, "to": triangle, "steps": 2});
    server.post("/v1/morph?format=gltf", &flat).expect_problem(400, "invalid-query", &[]);

    // Meshes of a level, with and without normals of their own.
    for scheme in ["loop", "normal_based"] {
        let representation =
            json!({"kind": "subdivision", "scheme": scheme, "level": 2, "connectivity": "octahedron"});
        let points = |x: f64| json!([[x, 0, 0], [-x, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]);
        let body = json!({"representation": representation, "from": {"control_points": points(1.0)}, "to": {"control_points": points(2.0)}, "steps": 3});
        let text = server.post("/v1/morph?format=obj", &body).text().to_owned();
        assert_eq!(["o", "v", "vn"].map(|word| count_of(&text, word)), [3, 3 * 66, 3 * 66], "{scheme}");
        assert_eq!(server.post("/v1/morph?format=gltf", &body).status, 200, "{scheme}");
    }
}

#[test]
fn surfaces_are_morphed_and_deformed() {
    let server = shared();
    let representation = surface("sphere", [8, 6]);
    let (first, second) = (json!({"points": potato([8, 6], 0)}), json!({"points": potato([8, 6], 1)}));
    let body =
        json!({"representation": representation, "from": first, "to": second, "path": "sphere", "steps": 5});
    let morph = server.post("/v1/morph", &body).expect(200);
    assert_eq!(morph["frames"].as_array().unwrap().len(), 5);
    assert!(number(&morph["angle"]) > 0.0);
    server.post("/v1/morph?format=svg", &body).expect_svg();
    // A file is refused before its meshes are made: one that holds a mesh, an animation through too many, too many vertices.
    for (format, count, said) in [
        ("ply", 2, "expected one position in a file of the format ply"),
        ("stl", 5, "which holds one mesh, got 5"),
        ("gltf", 1001, "expected at most 1000 positions in an animation, got 1001"),
        ("obj&grid=500,500", 9, "expected at most 2000000 vertices over all positions"),
    ] {
        let mut many = body.clone();
        many.as_object_mut().unwrap().remove("steps");
        many["positions"] = json!((0..count).map(|k| f64::from(k) / 1000.0).collect::<Vec<_>>());
        let problem = server.post(&format!("/v1/morph?format={format}"), &many);
        let problem = problem.expect_problem(422, "invalid-input", &["/positions"]);
        assert!(problem["errors"][0]["detail"].as_str().unwrap().contains(said), "{problem}");
    }
    let obj = server.post("/v1/morph?format=obj", &body).text().to_owned();
    assert_eq!(obj.lines().filter(|line| line.starts_with("o position_")).count(), 5);

    let deform = |extra: Value| {
        let mut body = json!({"representation": representation, "shape": first});
        body.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        server.post("/v1/deform", &body)
    };
    let handles = json!([{"parameters": [0.3, 0.4], "position": [1, 2, 3]}, {"parameters": [0.0, 0.0], "position": [0, 0, 2]}]);
    let deformed = deform(json!({"handles": handles})).expect(200);
    let body = json!({"representation": representation, "shapes": [{"control_points": deformed["control_points"]}],
        "parameters": [[0.3, 0.4], [0.0, 0.0], [0.7, 0.0]]});
    let met = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone();
    // the surface stays closed at the pole that was pulled
    assert_close(&met, &json!([[1, 2, 3], [0, 0, 2], [0, 0, 2]]), 1e-10, "handles");
    let again = {
        let body = json!({"representation": representation, "shape": {"control_points": deformed["control_points"]}, "handles": handles});
        server.post("/v1/deform", &body).expect(200)
    };
    assert!(number(&again["l2_change"]) < 1e-10, "met already");

    // Row 1 · 5 + 2 is k = 1, l = 3: the generators reach two knots to each side.
    let moved = deform(
        json!({"moves": [{"control_point": 7, "by": [0.1, 0, 0]}, {"control_point": 0, "by": [0, 0, 0.1]}]}),
    )
    .expect(200);
    assert_close(
        &moved["supports"][0]["parameters"],
        &json!([[7.0 / 8.0, 11.0 / 8.0], [1.0 / 6.0, 5.0 / 6.0]]),
        1e-12,
        "support",
    );
    deform(json!({})).expect_problem(422, "invalid-input", &[""]);
    let twice = json!([{"parameters": [0.3, 0.4], "position": [1, 2, 3]}, {"parameters": [0.3, 0.4], "position": [0, 0, 0]}]);
    deform(json!({"handles": twice})).expect_problem(422, "invalid-input", &["/handles"]);
    deform(json!({"handles": [{"parameters": [0.3], "position": [1, 2, 3]}]})).expect_problem(
        422,
        "invalid-input",
        &["/handles/0/parameters"],
    );
    deform(json!({"handles": [{"parameters": [0.3, 1.5], "position": [1, 2]}]})).expect_problem(
        422,
        "invalid-input",
        &["/handles/0/parameters/1", "/handles/0/position"],
    );
    deform(json!({"moves": [{"control_point": 46, "by": [1, 2, 3]}]})).expect_problem(
        422,
        "invalid-input",
        &["/moves/0/control_point"],
    );
}

#[test]
fn what_is_no_surface_is_refused_with_the_place() {
    let server = shared();
    let round = ellipsoid([1.0; 3]);
    let good = |representation: &Value, points: Value| {
        let body = json!({"representation": representation, "shapes": [{"points": points}]});
        server.post("/v1/measure", &body)
    };
    let sphere = surface("sphere", [4, 3]);
    good(&sphere, on_sphere([4, 3], &round)).expect(200);
    let mut open = on_sphere([4, 3], &round);
    open[2][0] = json!([0, 0, 1.1]);
    open[3][3] = json!([0, 0.2, -1]);
    let problem = good(&sphere, open).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/points/2/0", "/shapes/0/points/3/3"],
    );
    assert!(problem.to_string().contains("1.0e-1 away"), "{problem}");
    let problem =
        good(&sphere, on_sphere([5, 3], &round)).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
    assert!(
        problem.to_string().contains("4 × 4 points for a sphere of this size, got a grid of 5 × 4"),
        "{problem}"
    );
    good(&sphere, json!([[0, 0, 1], [1, 0, 0]])).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
    good(&sphere, json!([[[0, 0, 1], [1, 0, 0]], [[0, 0, 1]]])).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/points/1"],
    );
    let curve =
        json!({"kind": "closed_curve", "dimension": 3, "control_points": 4, "generator": {"name": "cubic"}});
    good(&curve, on_sphere([4, 3], &round)).expect_problem(422, "invalid-input", &["/shapes/0/points"]);

    let representation = |change: &Change| {
        let mut value = sphere.clone();
        change.iter().for_each(|(name, other)| value[*name] = other.clone());
        let body = json!({"representation": value, "shapes": [{"points": on_sphere([4, 3], &round)}]});
        // Evaluation chooses a grid by the size, before that is checked.
        assert_eq!(
            pointers_of(&server.post("/v1/evaluate", &body).json()),
            pointers_of(&server.post("/v1/measure", &body).json())
        );
        server.post("/v1/measure", &body)
    };
    let bspline = |degree: usize| json!({"name": "bspline", "degree": degree});
    let cases: [(&Change, &[&str]); 10] = [
        (
            &[("control_points", json!([2, 1]))],
            &["/representation/control_points/0", "/representation/control_points/1"],
        ),
        (&[("control_points", json!([200, 200]))], &["/representation/control_points"]),
        (
            &[("control_points", json!([u64::MAX, u64::MAX]))],
            &["/representation/control_points/0", "/representation/control_points/1"],
        ),
        (&[("topology", json!("ball"))], &["/representation/topology"]),
        (&[("seam", json!("reflected"))], &["/representation/seam"]),
        (&[("dimension", json!(3))], &["/representation/dimension"]),
        (&[("generators", json!([bspline(3), bspline(1)]))], &["/representation/generators/1"]),
        (&[("generators", json!([bspline(3), bspline(5)]))], &["/representation/generators/1"]),
        (
            &[(
                "generators",
                json!([{"name": "exponential", "domain_poles": [[0, 1], [0, -1]]}, bspline(3)]),
            )],
            &["/representation/generators/0"],
        ),
        (&[("generators", json!([bspline(9), {"name": "quintic"}]))], &["/representation/generators/1/name"]),
    ];
    for (change, pointers) in cases {
        representation(change).expect_problem(422, "invalid-input", pointers);
    }
    let torus =
        json!({"kind": "surface", "topology": "torus", "seam": "half_turn", "control_points": [4, 5]});
    good(&torus, json!([])).expect_problem(422, "invalid-input", &["/representation/control_points/1"]);

    // A flat sheet has no inverse of affine maps in space.
    let flat_sheet = grid([5, 5], [4, 4], |u, v| [u + 0.1 * v * v, v, 0.0]);
    let body = json!({"representation": surface("plane", [4, 4]), "transformation": "affine",
        "shapes": [{"points": flat_sheet}, {"points": flat_sheet}]});
    let problem = server.post("/v1/mean", &body).expect_problem(422, "degenerate-shape", &["/shapes/0"]);
    assert!(problem.to_string().contains("singular value"), "{problem}");

    let shape = json!({"points": on_sphere([4, 3], &round)});
    let statistics = |change: &Change| {
        let mut body =
            json!({"representation": sphere, "transformation": "affine", "shapes": [shape, shape]});
        change.iter().for_each(|(name, other)| body[*name] = other.clone());
        server.post("/v1/mean", &body)
    };
    statistics(&[("correspondence", json!("arc_length"))]).expect_problem(
        422,
        "invalid-input",
        &["/correspondence"],
    );
    let sheet = grid([5, 5], [4, 4], |u, v| [u + 0.1 * v * v, v, 0.2 * u * u]);
    let body = json!({"representation": surface("plane", [4, 4]), "transformation": "affine", "correspondence": "cyclic",
        "shapes": [{"points": sheet}, {"points": sheet}]});
    server.post("/v1/mean", &body).expect_problem(422, "invalid-input", &["/correspondence"]);
    let problem = statistics(&[("shapes", json!([{"points": on_sphere([4, 3], &round), "poles": 5}]))])
        .expect_problem(422, "invalid-input", &["/shapes/0/poles"]);
    assert!(problem.to_string().contains("expected an object"), "{problem}");
    let with_poles = |poles: Value| json!([{"points": on_sphere([4, 3], &round), "poles": poles}]);
    statistics(&[("shapes", with_poles(json!({"north": {"tangents": [[1, 2], [3, 4]]}})))]).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/poles/north/tangents/0"],
    );
    statistics(&[("shapes", with_poles(json!({"north": {"tangents": [[1e200, 2, 0], [3, 4, 0]]}})))])
        .expect_problem(422, "invalid-input", &["/shapes/0/poles/north/tangents"]);
    let body = json!({"representation": surface("torus", [4, 4]), "shapes": [{"points": grid([4, 4], [4, 4], |u, v| [u, v, u * v]), "poles": {}}]});
    server.post("/v1/measure", &body).expect_problem(422, "invalid-input", &["/shapes/0/poles"]);

    for (query, body) in [
        ("format=obj&grid=2,2", json!({})),
        ("format=obj&grid=9", json!({})),
        ("format=off", json!({})),
        ("grid=9,9", json!({})),
        ("format=ply&grid=100000,100000", json!({})),
    ] {
        let mut whole = json!({"representation": sphere, "shapes": [shape]});
        whole.as_object_mut().unwrap().extend(body.as_object().unwrap().clone());
        server.post(&format!("/v1/evaluate?{query}"), &whole).expect_problem(400, "invalid-query", &[]);
    }
    let evaluate = |change: &Change| {
        let mut body = json!({"representation": sphere, "shapes": [shape]});
        change.iter().for_each(|(name, other)| body[*name] = other.clone());
        server.post("/v1/evaluate", &body)
    };
    evaluate(&[("grid", json!([0, 4]))]).expect_problem(422, "invalid-input", &["/grid"]);
    evaluate(&[("grid", json!([100_000, 100_000]))]).expect_problem(422, "invalid-input", &["/grid"]);
    evaluate(&[("grid", json!([4, 4])), ("parameters", json!([[0, 0]]))]).expect_problem(
        422,
        "invalid-input",
        &["/parameters"],
    );
    evaluate(&[("samples", json!(4))]).expect_problem(422, "invalid-input", &["/samples"]);
    evaluate(&[("parameters", json!([[0, 0], [0, 2]]))]).expect_problem(
        422,
        "invalid-input",
        &["/parameters/1/1"],
    );
    evaluate(&[("parameters", json!([0.5]))]).expect_problem(422, "invalid-input", &["/parameters/0"]);
    // The largest numbers that are taken, and points that are all one.
    let huge = good(&sphere, on_sphere([4, 3], ellipsoid([1e100, 1e99, 1e98]))).expect(200);
    assert!(number(&huge["results"][0]["volume"]) > 1e297, "{huge}");
    good(&sphere, on_sphere([4, 3], |_, _| [1.0, 2.0, 3.0])).expect(200);
    server.assert_alive();
}

#[test]
fn parameters_of_surfaces_that_do_not_correspond_are_told_and_searched() {
    let server = shared();
    let size = [8, 6];
    // One body, its longitudes counted from elsewhere on each surface.
    let turned = |k: usize| {
        let (shift, thick) = (0.17 * k as f64, 1.0 + 0.03 * k as f64);
        on_sphere(size, move |u, v| {
            let [x, y, z] = ellipsoid([1.0; 3])(u + shift, v);
            [thick * (1.6 * x + 0.3 * y * y), y, 2.6 * z + 0.3 * x * x]
        })
    };
    let shapes: Vec<Value> = (0..5).map(|k| json!({"points": turned(k)})).collect();
    let body = |correspondence: &str| {
        json!({"representation": surface("sphere", size), "transformation": "similarity",
        "correspondence": correspondence, "shapes": shapes})
    };
    let residuals = |answer: &Value| -> f64 {
        answer["aligned"].as_array().unwrap().iter().map(|one| number(&one["residual"])).sum()
    };
    let given = server.post("/v1/align", &body("landmarks")).expect(200);
    assert!(given["warnings"][0].as_str().unwrap().contains("disagree"), "{given}");
    assert!(given["aligned"][0].get("motion").is_none());
    let found = server.post("/v1/align", &body("cyclic")).expect(200);
    assert_eq!(found["warnings"], json!([]));
    assert!(residuals(&found) < 0.2 * residuals(&given), "{} {}", residuals(&found), residuals(&given));
    for one in found["aligned"].as_array().unwrap() {
        assert!(number(&one["motion"]["change"]) < 0.05 && one["shift"] == 0, "{one}");
    }

    // A cohort keeps the correspondence; its dictionary scores a surface with other parameters as it does the stored one.
    let cohort =
        json!({"name": "turned", "representation": surface("sphere", size), "correspondence": "cyclic"});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post("/v1/cohorts/turned/shapes", &json!({"shapes": shapes})).expect(201);
    let mean = server.get("/v1/cohorts/turned/mean?transformation=similarity").expect(200);
    assert_close(&mean["mean"]["control_points"], &found["mean"]["control_points"], 1e-9, "mean");
    let query = json!({"shapes": [{"points": turned(7)}], "transformation": "similarity"});
    server.post("/v1/cohorts/turned/search", &query).expect_problem(422, "invalid-input", &[""]);
}

/// Spheres that are closed at their poles, and sharp there: points of cones, in every request that takes surfaces.
#[test]
fn spheres_may_have_sharp_poles() {
    let server = Server::fresh();
    let representation = json!({"kind": "surface", "topology": "sharp_sphere", "control_points": [6, 4],
        "generators": [{"name": "trigonometric"}, {"name": "cubic"}]});
    let lemon = |width: f64, height: f64| -> Value {
        let meridian = |k: usize| -> Vec<[f64; 3]> {
            let (sine, cosine) = (TAU * k as f64 / 6.0).sin_cos();
            let at = |l: usize| {
                let v = l as f64 / 4.0;
                let radius = 4.0 * width * v * (1.0 - v);
                [radius * cosine, radius * sine, height * (1.0 - 2.0 * v)]
            };
            (0..5).map(at).collect()
        };
        json!({"points": (0..6).map(meridian).collect::<Vec<_>>()})
    };
    let body = json!({"representation": representation, "shapes": [lemon(1.0, 1.0), lemon(1.5, 2.0)]});
    let measures = server.post("/v1/measure", &body).expect(200);
    for (i, wanted) in [16.0 * PI / 15.0, 72.0 * PI / 15.0].into_iter().enumerate() {
        let volume = number(&measures["results"][i]["volume"]);
        assert!((volume - wanted).abs() < 1e-12 * wanted, "{volume} for {wanted}");
    }
    let mesh = server.post(
        "/v1/evaluate?format=obj&grid=24,13",
        &json!({"representation": representation, "shapes": [lemon(1.0, 1.0)]}),
    );
    assert_eq!(mesh.text().lines().filter(|line| line.starts_with("v ")).count(), 24 * 11 + 2);
    // Both are linear images of one lemon: under the linear class, the mean is one too.
    let mean = json!({"representation": representation, "transformation": "linear", "shapes": [lemon(1.0, 1.0), lemon(1.5, 2.0)]});
    let mean = server.post("/v1/mean", &mean).expect(200);
    let rows = mean["mean"]["control_points"].as_array().or(mean["control_points"].as_array()).map(Vec::len);
    assert_eq!(rows, Some(6 * 3 + 2 + 12), "{mean}");
    server
        .post(
            "/v1/cohorts",
            &json!({"name": "lemons", "representation": representation, "correspondence": "landmarks"}),
        )
        .expect(201);
    let shapes = json!({"shapes": [lemon(1.0, 1.0), lemon(1.5, 2.0), lemon(0.8, 1.1)]});
    server.post("/v1/cohorts/lemons/shapes", &shapes).expect(201);
    server.get("/v1/cohorts/lemons/mean?transformation=affine").expect(200);
    // Tangent planes are for smooth poles.
    let mut with_tangents = lemon(1.0, 1.0);
    with_tangents["poles"] = json!({"north": {"tangents": [[1, 0, 0], [0, 1, 0]]}});
    let body = json!({"representation": representation, "shapes": [with_tangents]});
    server.post("/v1/measure", &body).expect_problem(422, "invalid-input", &["/shapes/0/poles"]);
    let open = json!({"representation": representation, "shapes": [{"points": vec![[[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]]; 5]}]});
    server.post("/v1/measure", &open).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
}
