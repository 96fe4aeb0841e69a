//! Subdivision surfaces over HTTP: refinement, statistics, fits, overlap, and what is refused.

use std::f64::consts::{FRAC_PI_2, PI};

use serde_json::{Value, json};

use crate::server::{Server, assert_close, shared};

fn blob(level: usize, connectivity: Value) -> Value {
    json!({"kind": "subdivision", "scheme": "blob", "lambda": FRAC_PI_2, "level": level, "connectivity": connectivity})
}

fn of_scheme(scheme: &str, level: usize, connectivity: Value) -> Value {
    json!({"kind": "subdivision", "scheme": scheme, "level": level, "connectivity": connectivity})
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

fn with(body: &Value, change: Value) -> Value {
    let mut body = body.clone();
    body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    body
}

/// Vertices and faces of a starting mesh, as the service answers them.
fn start(server: &Server, name: &str) -> (Vec<[f64; 3]>, Value) {
    let body = json!({"scheme": "loop", "level": 0, "start": name});
    let mesh = server.post("/v1/subdivide", &body).expect(200)["mesh"].clone();
    (serde_json::from_value(mesh["vertices"].clone()).unwrap(), mesh["faces"].clone())
}

/// A body without symmetry on the control vertices of a sphere, moved and turned as a seed says.
fn potato(sphere: &[[f64; 3]], seed: usize) -> Vec<[f64; 3]> {
    let s = seed as f64;
    let (sine, cosine) = (0.9 * s).sin_cos();
    let at = |&[x, y, z]: &[f64; 3]| {
        let [x, y, z] = [(1.0 + 0.2 * (1.3 * s).sin()) * x, (0.8 + 0.1 * (2.1 * s).cos()) * y, 1.5 * z];
        let bump = 1.0 + 0.15 * (s + 2.0 * x).sin() * y + 0.1 * (0.7 * s).cos() * x * z;
        let [x, y, z] = [bump * x, bump * y, bump * z];
        [2.0 * s + cosine * x - sine * y, sine * x + cosine * y - s, z + 0.5 * s]
    };
    sphere.iter().map(at).collect()
}

fn potatoes(sphere: &[[f64; 3]], count: usize) -> Vec<Value> {
    (0..count)
        .map(|seed| json!({"control_points": potato(sphere, seed), "external_id": format!("potato-{seed}")}))
        .collect()
}

#[test]
fn starting_meshes_are_refined_in_every_format() {
    let server = shared();
    let body = json!({"scheme": "blob", "lambda": FRAC_PI_2, "level": 3, "start": "octahedron"});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    let mesh = &answer["mesh"];
    assert_eq!(
        (mesh["vertices"].as_array().unwrap().len(), mesh["faces"].as_array().unwrap().len()),
        (258, 512)
    );
    assert!(mesh.get("normals").is_none() && answer.get("limit").is_none());
    let radii = mesh["vertices"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| (0..3).map(|c| number(&p[c]).powi(2)).sum::<f64>().sqrt());
    let (least, most) = radii.fold((f64::MAX, 0.0_f64), |(a, b), r| (a.min(r), b.max(r)));
    // Sphericity of the third level, as noted with the sources.
    assert!((most - least - 0.01998).abs() < 1e-5, "{}", most - least);
    for (format, media_type) in [
        ("obj", "model/obj"),
        ("ply", "application/ply"),
        ("stl", "model/stl"),
        ("gltf", "model/gltf-binary"),
    ] {
        let file = server.post(&format!("/v1/subdivide?format={format}"), &body);
        assert_eq!((file.status, file.header("content-type")), (200, Some(media_type)));
    }
    let obj = server.post("/v1/subdivide?format=obj", &body);
    assert_eq!(obj.text().lines().filter(|line| line.starts_with("vn ")).count(), 258);
    server.post("/v1/subdivide?format=svg", &body).expect_svg();
    server.post("/v1/subdivide?format=obj&grid=8,8", &body).expect_problem(400, "invalid-query", &[]);

    let limit = server.post("/v1/subdivide", &with(&body, json!({"limit": true}))).expect(200);
    assert_eq!(limit["limit"]["vertices"].as_array().unwrap().len(), 258);
    assert_eq!(limit["limit"]["normals"].as_array().unwrap().len(), 258);
    let butterfly = json!({"scheme": "butterfly", "level": 2, "start": "icosahedron", "limit": true});
    let answer = server.post("/v1/subdivide", &butterfly).expect(200);
    assert_eq!(
        (&answer["limit"]["vertices"], &answer["limit"]["normals"]),
        (&answer["mesh"]["vertices"], &Value::Null)
    );

    let near = json!({"scheme": "loop", "tolerance": 1e-3, "start": "icosahedron"});
    let answer = server.post("/v1/subdivide", &near).expect(200);
    assert!(number(&answer["change"]) <= 1e-3 && number(&answer["level"]) > 1.0, "{}", answer["change"]);
}

/// A sphere with radial normals stays one, and the usual normals are those.
#[test]
fn the_normal_based_scheme_reproduces_spheres_and_circles() {
    let server = shared();
    let (vertices, faces) = start(&server, "tetrahedron");
    let moved: Vec<[f64; 3]> =
        vertices.iter().map(|[x, y, z]| [3.0 * x + 1.0, 3.0 * y, 3.0 * z - 2.0]).collect();
    let mesh = json!({"vertices": moved, "faces": faces});
    let body = json!({"scheme": "normal_based", "level": 4, "mesh": mesh});
    for normals in [None, Some(json!(vertices)), Some(json!(moved))] {
        let mut body = body.clone();
        if let Some(normals) = &normals {
            body["mesh"]["normals"] = normals.clone();
        }
        let answer = server.post("/v1/subdivide", &body).expect(200);
        let warned = answer["warnings"].as_array().unwrap().len();
        if normals == Some(json!(moved)) {
            // Positions as normals: not of unit length, and not radial.
            assert_eq!(warned, 1, "{answer}");
            continue;
        }
        assert_eq!(warned, 0);
        for point in answer["mesh"]["vertices"].as_array().unwrap() {
            let radius = [1.0, 0.0, -2.0].iter().enumerate().map(|(c, m)| (number(&point[c]) - m).powi(2));
            assert!((radius.sum::<f64>().sqrt() - 3.0).abs() < 1e-14, "{point}");
        }
    }
    let square = json!([[2, 0], [0, 2], [-2, 0], [0, -2]]);
    let body = json!({"scheme": "normal_based", "level": 5, "polyline": {"points": square}});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    let points = answer["polyline"]["points"].as_array().unwrap();
    assert_eq!(points.len(), 128);
    for (point, normal) in points.iter().zip(answer["polyline"]["normals"].as_array().unwrap()) {
        assert!((number(&point[0]).hypot(number(&point[1])) - 2.0).abs() < 1e-14);
        assert_close(&json!([number(&point[0]) / 2.0, number(&point[1]) / 2.0]), normal, 1e-13, "normal");
    }
    server.post("/v1/subdivide?format=svg", &body).expect_svg();
    let open = json!({"points": [[0, 0, 0], [1, 0, 0.5], [2, 1, 0]], "normals": [[0, 1, 0], [0, 1, 0.2], [-1, 1, 0]], "closed": false});
    let body = json!({"scheme": "normal_based", "level": 3, "polyline": open});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    assert_eq!(answer["polyline"]["points"].as_array().unwrap().len(), 17);
    // A normal on the other side of one edge is a cusp, told.
    let cusp = json!({"points": square, "normals": [[1, 0], [0, 1], [-1, 0], [-1, -0.5]]});
    let body = json!({"scheme": "normal_based", "level": 1, "polyline": cusp});
    let reply = server.post("/v1/subdivide", &body);
    assert!([200, 422].contains(&reply.status), "{}", reply.text());
}

#[test]
fn what_cannot_be_refined_is_refused_with_the_place() {
    let server = shared();
    let (vertices, faces) = start(&server, "octahedron");
    let faces: Vec<[u32; 3]> = serde_json::from_value(faces).unwrap();
    let mesh = json!({"vertices": vertices, "faces": faces});
    let body = json!({"scheme": "blob", "lambda": 1.5, "level": 2, "mesh": mesh});
    server.post("/v1/subdivide", &body).expect(200);
    let refused = |change: Value, pointers: &[&str]| {
        server
            .post("/v1/subdivide", &with(&body, change))
            .expect_problem(422, "invalid-input", pointers)
            .to_string()
    };
    let with_faces = |change: &dyn Fn(&mut Vec<[u32; 3]>)| {
        let mut faces = faces.clone();
        change(&mut faces);
        json!({"mesh": {"vertices": vertices, "faces": faces}})
    };
    let said = refused(with_faces(&|faces| faces.truncate(7)), &["/mesh/faces/3"]);
    assert!(said.contains("no face on its other side"), "{said}");
    refused(with_faces(&|faces| faces[2] = [1, 4, 3]), &["/mesh/faces/2"]);
    refused(with_faces(&|faces| faces[1] = [2, 2, 4]), &["/mesh/faces/1"]);
    refused(with_faces(&|faces| faces[1] = [2, 1, 40]), &["/mesh/faces/1"]);
    refused(with_faces(&|faces| faces.push([0, 2, 4])), &["/mesh/faces/8"]);
    let mut unused = vertices.clone();
    unused.push([9.0; 3]);
    let said = refused(json!({"mesh": {"vertices": unused, "faces": faces}}), &["/mesh/faces"]);
    assert!(said.contains("vertex 6 belongs to no face"), "{said}");
    let said = refused(
        json!({"mesh": {"vertices": vertices, "faces": faces, "normals": vertices}}),
        &["/mesh/normals"],
    );
    assert!(said.contains("normal_based"), "{said}");
    for level in [json!(9), json!(30), json!(1000), json!(u64::MAX)] {
        let said = refused(json!({"level": level}), &["/level"]);
        assert!(said.contains("at most 300000"), "{said}");
    }
    refused(json!({"level": -1}), &["/level"]);
    refused(json!({"level": null}), &["/level"]);
    refused(json!({"tolerance": 0.1}), &["/tolerance"]);
    refused(json!({"lambda": 3.2}), &["/lambda"]);
    refused(json!({"v0": 0.5}), &["/v0"]);
    refused(json!({"scheme": "loop"}), &["/lambda"]);
    refused(json!({"scheme": "catmull"}), &["/scheme"]);
    refused(json!({"start": "octahedron"}), &[""]);
    refused(json!({"levle": 2}), &["/levle"]);
    refused(json!({"mesh": {"vertices": null, "faces": faces}}), &["/mesh/vertices"]);
    refused(json!({"mesh": {"faces": faces}}), &["/mesh/vertices"]);
    refused(json!({"mesh": {"vertices": [], "faces": []}}), &["/mesh/faces"]);
    let bare = |extra: Value| {
        let body = with(&json!({"scheme": "blob", "lambda": 1.5, "level": 2}), extra);
        server.post("/v1/subdivide", &body)
    };
    bare(json!({})).expect_problem(422, "invalid-input", &["/mesh"]);
    bare(json!({"start": "cube"})).expect_problem(422, "invalid-input", &["/start"]);
    let said =
        bare(json!({"start": "icosahedron"})).expect_problem(422, "invalid-input", &["/start"]).to_string();
    assert!(said.contains("vertex 0 has 5 neighbours"), "{said}");
    bare(json!({"start": "octahedron/15"})).expect_problem(422, "invalid-input", &["/start"]);
    let square = json!([[2, 0], [0, 2], [-2, 0], [0, -2]]);
    bare(json!({"polyline": {"points": square}})).expect_problem(422, "invalid-input", &["/polyline"]);

    let oriented = |polyline: Value| {
        server.post("/v1/subdivide", &json!({"scheme": "normal_based", "level": 2, "polyline": polyline}))
    };
    let problem = |polyline: Value, pointers: &[&str]| {
        oriented(polyline).expect_problem(422, "invalid-input", pointers).to_string()
    };
    let said = problem(
        json!({"points": square, "normals": [[1, 0], [0, 0], [-1, 0], [0, -1]]}),
        &["/polyline/normals/1"],
    );
    assert!(said.contains("got zero"), "{said}");
    problem(json!({"points": square, "normals": [[1, 0]]}), &["/polyline/normals"]);
    problem(json!({"points": [[0, 0], [1, 1]]}), &["/polyline/points"]);
    problem(json!({"points": [[0, 0, 0], [1, 1, 0], [2, 0, 0]]}), &["/polyline/normals"]);
    problem(json!({"points": square, "normals": [[1, 0], [0, 1], [1, 0], [0, -1]]}), &["/polyline"]);
    let said = problem(
        json!({"points": [[0, 0], [0, 0], [1, 1]], "normals": [[1, 0], [1, 0], [0, 1]]}),
        &["/polyline"],
    );
    assert!(said.contains("edge from vertex 0 to vertex 1"), "{said}");
}

#[test]
fn surfaces_are_evaluated_measured_and_moved() {
    let server = shared();
    let (sphere, faces) = start(&server, "octahedron/2");
    // A unit mean radius of the limit needs larger control points; Loop is affine invariant as well.
    let representation = of_scheme("loop", 3, json!("octahedron/2"));
    let shape = json!({"control_points": sphere});
    let body = json!({"representation": representation, "shapes": [shape], "frames": true});
    let answer = server.post("/v1/evaluate", &body).expect(200);
    let points = answer["evaluations"][0]["points"].as_array().unwrap();
    assert_eq!((points.len(), answer["faces"].as_array().unwrap().len()), (4098, 8192));
    let frames = &answer["evaluations"][0];
    for (normal, point) in frames["normals"].as_array().unwrap().iter().zip(points) {
        let along = (0..3).map(|c| number(&normal[c]) * number(&point[c])).sum::<f64>();
        assert!(along > 0.85, "{along}");
    }
    let bends = frames["principal_curvatures"].as_array().unwrap();
    let mean = bends.iter().map(|k| 0.5 * (number(&k[0]) + number(&k[1]))).sum::<f64>() / bends.len() as f64;
    assert!((mean + 1.1).abs() < 0.15, "{mean}");
    server.post("/v1/evaluate?format=svg", &body).expect_svg();
    let file = server.post("/v1/evaluate?format=gltf", &body);
    assert_eq!((file.status, file.header("content-type")), (200, Some("model/gltf-binary")));

    // The same shape from its faces as a list, and by where its control vertices are.
    let at_level: Vec<Value> = points[..66].to_vec();
    let by_points = json!({"representation": with(&representation, json!({"connectivity": faces})), "shapes": [{"points": at_level}]});
    let again = server.post("/v1/evaluate", &by_points).expect(200);
    assert_close(&again["evaluations"][0]["points"], &json!(points), 1e-11, "interpolated");

    let moved: Vec<[f64; 3]> = sphere.iter().map(|[x, y, z]| [2.0 * x + 5.0, y - 1.0, 3.0 * z]).collect();
    let body = json!({"representation": representation, "shapes": [{"control_points": moved}, shape], "reference": shape,
        "field": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "offset": [5, 6, 7]}});
    let answer = server.post("/v1/measure", &body).expect(200);
    let [first, second] = [0, 1].map(|i| answer["results"][i].clone());
    let ratio = number(&first["volume"]) / number(&second["volume"]);
    assert!((ratio - 6.0).abs() < 1e-12, "{ratio}");
    assert!((number(&first["flux"]) / number(&first["volume"]) - 3.0).abs() < 1e-12, "the divergence is 3");
    assert_close(&first["centroid"], &json!([5.0, -1.0, 0.0]), 1e-12, "centroid");
    assert!(number(&second["sphericity"]) > 0.99 && number(&second["distances"]["l2"]) < 1e-15);
    assert!(number(&first["distances"]["l2"]) > 5.0);
    assert!(number(&second["area_error"]) > 0.0 && number(&second["area_error"]) < 0.02);

    let deform = json!({"representation": representation, "shape": shape,
        "handles": [{"parameters": [100], "position": [0, 0, 2]}, {"parameters": [0], "position": [1.5, 0, 0]}]});
    let deformed = server.post("/v1/deform", &deform).expect(200);
    let body =
        json!({"representation": representation, "shapes": [{"control_points": deformed["control_points"]}]});
    let met = server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone();
    assert_close(&json!([met[100], met[0]]), &json!([[0, 0, 2], [1.5, 0, 0]]), 1e-10, "handles");
    for parameters in [json!([4098]), json!([0.5]), json!([-1]), json!([1, 2])] {
        let bad = with(&deform, json!({"handles": [{"parameters": parameters, "position": [0, 0, 2]}]}));
        let reply = server.post("/v1/deform", &bad);
        assert_eq!(reply.status, 422, "{}", reply.text());
        assert!(reply.text().contains("/handles/0/parameters"), "{}", reply.text());
    }
    let morph =
        json!({"representation": representation, "from": shape, "to": {"control_points": moved}, "steps": 3});
    assert_eq!(server.post("/v1/morph", &morph).expect(200)["frames"].as_array().unwrap().len(), 3);
    server.post("/v1/morph?format=svg", &morph).expect_svg();
}

#[test]
fn a_cohort_of_subdivision_surfaces_has_everything_that_others_have() {
    let server = Server::fresh();
    let (sphere, _) = start(&server, "octahedron/1");
    let cohort =
        json!({"name": "potatoes", "representation": blob(3, json!("octahedron/1")), "length_unit": "mm"});
    let created = server.post("/v1/cohorts", &cohort).expect(201);
    assert_eq!(created["representation"], cohort["representation"]);
    let mut shapes = potatoes(&sphere, 24);
    for (i, shape) in shapes.iter_mut().enumerate() {
        shape["label"] = json!(if i % 2 == 0 { "even" } else { "odd" });
        shape["labels"] = json!({"age": i});
    }
    server.post("/v1/cohorts/potatoes/shapes", &json!({"shapes": shapes})).expect(201);
    let found = server.get("/v1/cohorts/potatoes/shapes/potato-3").expect(200);
    assert_close(&found["control_points"], &shapes[3]["control_points"], 1e-15, "stored");
    server.get("/v1/cohorts/potatoes/shapes/potato-3?format=svg").expect_svg();
    let mesh = server.get("/v1/cohorts/potatoes/shapes/potato-3?format=obj");
    assert_eq!((mesh.status, mesh.header("content-type")), (200, Some("model/obj")));
    assert_eq!(mesh.text().lines().filter(|line| line.starts_with("v ")).count(), 1026);
    server.get("/v1/cohorts/potatoes/shapes/potato-3?format=obj&grid=9,9").expect_problem(
        400,
        "invalid-query",
        &[],
    );
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
            server.post(&path, &json!({"shapes": potatoes(&sphere, 2)})).expect(200);
        }
        let body = json!({"shapes": potatoes(&sphere, 2), "samples": 5});
        let answer = server.post(&format!("/v1/dictionaries/{name}/reconstruct"), &body).expect(200);
        // They are compared where their control vertices are at the level.
        assert_eq!(answer["results"][0]["residual"].as_array().unwrap().len(), 18, "{name}");
        server.get(&format!("/v1/dictionaries/{name}/atoms?format=svg")).expect_svg();
    }
    server.get("/v1/dictionaries/modes/modes?component=1&sigma=2&format=svg").expect_svg();
    let exported = server.get("/v1/dictionaries/modes/export").expect(200);
    server.post("/v1/dictionaries/import?name=again", &exported);
    let mesh = server.get("/v1/dictionaries/modes/modes?component=1&sigma=-2&format=stl");
    assert_eq!((mesh.status, mesh.header("content-type")), (200, Some("model/stl")));
    let search = json!({"shapes": potatoes(&sphere, 1), "transformation": "affine", "neighbours": 3});
    let nearest = server.post("/v1/cohorts/potatoes/search", &search).expect(200);
    assert!(nearest.to_string().contains("potato-0"), "{nearest}");
    let compare = json!({"cohort": "potatoes", "transformation": "affine", "by": "label", "permutations": 99, "seed": 1});
    let comparison = server.post("/v1/comparisons", &compare).expect(200);
    let pair = &comparison["pairs"][0];
    assert_eq!(pair["effect"].as_array().unwrap().len(), 18);
    let sizes: Vec<&str> =
        pair["sizes"].as_array().unwrap().iter().map(|s| s["measure"].as_str().unwrap()).collect();
    assert_eq!(sizes, ["volume", "area", "centroid_size"]);
    server.post("/v1/comparisons?format=svg", &compare).expect_svg();
    server.post("/v1/comparisons", &with(&compare, json!({"mirror": "allow"}))).expect_problem(
        422,
        "invalid-input",
        &["/mirror"],
    );
    let regress = json!({"cohort": "potatoes", "transformation": "affine", "attribute": "labels.age", "permutations": 99, "seed": 1});
    server.post("/v1/regressions", &regress).expect(200);
    server.post("/v1/regressions?format=svg", &regress).expect_svg();
    let model = json!({"cohort": "potatoes", "transformation": "affine", "formula": "~ poly(age,2)", "permutations": 99});
    server.post("/v1/models", &model).expect(200);
    server.post("/v1/models?format=svg", &model).expect_svg();
}

#[test]
fn means_are_those_of_their_class() {
    let server = shared();
    let (sphere, _) = start(&server, "octahedron/1");
    // One shape, moved by rigid motions and scales: its Procrustes mean is that shape.
    let one = potato(&sphere, 3);
    let moved = |k: usize| -> Vec<[f64; 3]> {
        let s = k as f64;
        let (sine, cosine) = (0.7 * s).sin_cos();
        let size = 1.0 + 0.3 * s;
        one.iter()
            .map(|[x, y, z]| {
                [size * (cosine * x - sine * z) + s, size * y - 2.0 * s, size * (sine * x + cosine * z)]
            })
            .collect()
    };
    let shapes: Vec<Value> = (0..5).map(|k| json!({"control_points": moved(k)})).collect();
    let representation = blob(2, json!("octahedron/1"));
    let body = json!({"representation": representation, "transformation": "similarity", "alignment": "procrustes", "shapes": shapes});
    let mean = server.post("/v1/mean", &body).expect(200);
    let distances = mean.to_string();
    assert!(mean["mean"]["control_points"].as_array().unwrap().len() == 18, "{distances}");
    let measure = |shape: &Value| {
        let body = json!({"representation": representation, "shapes": [shape]});
        number(&server.post("/v1/measure", &body).expect(200)["results"][0]["sphericity"])
    };
    let found = measure(&json!({"control_points": mean["mean"]["control_points"]}));
    assert!((found - measure(&json!({"control_points": one}))).abs() < 1e-10, "{found}");
    server.post("/v1/pca", &json!({"representation": representation, "transformation": "affine", "components": 3, "shapes": potatoes(&sphere, 8).iter().map(|s| json!({"control_points": s["control_points"]})).collect::<Vec<_>>()})).expect(200);
}

#[test]
fn meshes_and_clouds_are_fitted() {
    let server = shared();
    let (sphere, _) = start(&server, "octahedron/1");
    let bean: Vec<[f64; 3]> = sphere
        .iter()
        .map(|[x, y, z]| [3.0 * x + 0.4 * z * z, 1.5 * y + 0.2 * x * z, z + 0.5 * x * x])
        .collect();
    for representation in [blob(3, json!("octahedron/1")), of_scheme("loop", 3, json!("octahedron/1"))] {
        let body = json!({"representation": representation, "shapes": [{"control_points": bean}]});
        let answer = server.post("/v1/evaluate", &body).expect(200);
        let (vertices, faces) = (&answer["evaluations"][0]["points"], &answer["faces"]);
        let measure = |shape: &Value| {
            let body = json!({"representation": representation, "shapes": [shape]});
            number(&server.post("/v1/measure", &body).expect(200)["results"][0]["volume"])
        };
        let volume = measure(&json!({"control_points": bean}));
        let fit =
            json!({"representation": representation, "meshes": [{"vertices": vertices, "faces": faces}]});
        let found = server.post("/v1/fit", &fit).expect(200)["results"][0].clone();
        assert!(number(&found["residual"]) < 0.02, "{}", found["residual"]);
        assert!((measure(&json!({"control_points": found["control_points"]})) / volume - 1.0).abs() < 0.02);
        let exact = with(&fit, json!({"start": {"control_points": bean}, "turns": 2}));
        let found = server.post("/v1/fit", &exact).expect(200)["results"][0].clone();
        assert!(number(&found["residual"]) < 1e-10, "{}", found["residual"]);
        let cloud = json!({"representation": representation, "shapes": [{"points": vertices}], "turns": 40});
        let found = server.post("/v1/fit", &cloud).expect(200)["results"][0].clone();
        assert!(number(&found["residual"]) < 0.03, "{}", found["residual"]);
    }
    let by_faces = of_scheme("loop", 2, start(&server, "octahedron").1);
    let body = json!({"representation": by_faces, "shapes": [{"points": bean}]});
    let said = server.post("/v1/fit", &body).expect_problem(422, "invalid-input", &["/start"]).to_string();
    assert!(said.contains("is missing"), "{said}");
    let body = json!({"representation": blob(2, json!("octahedron")), "shapes": [{"points": [[0, 0, 0], [1, 1, 1]]}]});
    server.post("/v1/fit", &body).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
    let body = json!({"representation": blob(2, json!("octahedron")), "shapes": [{"points": vec![[1.0, 2.0, 3.0]; 50]}]});
    server.post("/v1/fit", &body).expect_problem(422, "invalid-input", &["/shapes/0/points"]);
    let body =
        json!({"representation": blob(2, json!("octahedron")), "shapes": [{"points": bean}], "turns": 1000});
    server.post("/v1/fit", &body).expect_problem(422, "invalid-input", &["/turns"]);
    let curve =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "cubic"}});
    let body = json!({"representation": curve, "shapes": [{"points": [[0, 0], [1, 0], [1, 1], [0, 1]]}], "turns": 3});
    server.post("/v1/fit", &body).expect_problem(422, "invalid-input", &["/turns"]);
}

#[test]
fn shapes_with_normals_are_evaluated_and_morphed_but_have_no_statistics() {
    let server = shared();
    let (sphere, _) = start(&server, "icosahedron");
    let representation = of_scheme("normal_based", 3, json!("icosahedron"));
    let shape = json!({"control_points": sphere, "normals": sphere});
    let body = json!({"representation": representation, "shapes": [shape], "frames": true});
    let answer = server.post("/v1/evaluate", &body).expect(200);
    let evaluation = &answer["evaluations"][0];
    assert_eq!(evaluation["points"].as_array().unwrap().len(), 642);
    assert_close(&evaluation["points"], &evaluation["normals"], 1e-13, "a unit sphere");
    server.post("/v1/evaluate?format=svg", &body).expect_svg();
    assert_eq!(server.post("/v1/evaluate?format=ply", &body).status, 200);
    let measured = json!({"representation": representation, "shapes": [shape]});
    let volume = number(&server.post("/v1/measure", &measured).expect(200)["results"][0]["volume"]);
    assert!((volume / (4.0 * PI / 3.0) - 1.0).abs() < 0.02, "{volume}");
    let stretched: Vec<[f64; 3]> = sphere.iter().map(|[x, y, z]| [2.0 * x, *y, *z]).collect();
    let to = json!({"points": stretched});
    let body = json!({"representation": representation, "from": shape, "to": to, "positions": [0, 0.5, 1]});
    let frames = server.post("/v1/morph", &body).expect(200)["frames"].clone();
    assert_close(&frames[0]["normals"], &json!(sphere), 1e-15, "the first frame");
    assert_eq!(frames[1]["normals"].as_array().unwrap().len(), 12);
    server.post("/v1/morph?format=svg", &body).expect_svg();
    let inward: Vec<[f64; 3]> = sphere.iter().map(|p| p.map(|x| -x)).collect();
    let opposite = with(&body, json!({"to": {"points": sphere, "normals": inward}}));
    server.post("/v1/morph", &opposite).expect_problem(422, "invalid-input", &["/to/normals/0"]);
    server.post("/v1/morph", &with(&body, json!({"path": "sphere"}))).expect_problem(
        422,
        "invalid-input",
        &["/path"],
    );
    let mut zero = json!(sphere);
    zero[4] = json!([0, 0, 0]);
    let bad =
        json!({"representation": representation, "shapes": [shape, {"points": sphere, "normals": zero}]});
    server.post("/v1/evaluate", &bad).expect_problem(422, "invalid-input", &["/shapes/1/normals/4"]);

    for (path, extra) in [
        ("/v1/mean", json!({"transformation": "affine"})),
        ("/v1/pca", json!({"transformation": "affine"})),
        ("/v1/align", json!({"transformation": "affine"})),
    ] {
        let body = with(&json!({"representation": representation, "shapes": [shape, shape]}), extra);
        let said = server.post(path, &body);
        assert_eq!(said.status, 422, "{}", said.text());
        assert!(
            said.text().contains("/representation/scheme") && said.text().contains("not linear"),
            "{}",
            said.text()
        );
    }
    let cohort = json!({"name": "with-normals", "representation": representation});
    server.post("/v1/cohorts", &cohort).expect_problem(422, "invalid-input", &["/representation/scheme"]);
    let linear = of_scheme("loop", 1, json!("icosahedron"));
    let body = json!({"representation": linear, "shapes": [shape]});
    server.post("/v1/measure", &body).expect_problem(422, "invalid-input", &["/shapes/0/normals"]);
}

/// Two triangles of a sheet: what the schemes with rules for boundaries make of them, and what the others say.
#[test]
fn open_meshes_are_refined_by_the_schemes_with_rules_for_boundaries() {
    let server = shared();
    let square =
        json!({"vertices": [[0, 0, 0], [2, 0, 0], [2, 1, 0.5], [0, 1, 0]], "faces": [[0, 1, 2], [0, 2, 3]]});
    let body = json!({"scheme": "loop", "level": 1, "mesh": square, "limit": true});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    let wanted = json!([[0.25, 0.125, 0.0], [1.75, 0.125, 0.0625]]);
    assert_close(
        &json!([answer["mesh"]["vertices"][0], answer["mesh"]["vertices"][1]]),
        &wanted,
        1e-15,
        "⅛, ¾, ⅛",
    );
    // Along the boundary ½, ½; inside ⅜, ⅜, ⅛, ⅛. Edges: 01, 02, 03, 12, 23.
    let wanted = json!([[1.0, 0.0, 0.0], [1.0, 0.5, 0.1875]]);
    assert_close(
        &json!([answer["mesh"]["vertices"][4], answer["mesh"]["vertices"][5]]),
        &wanted,
        1e-15,
        "edges",
    );
    assert!(answer.get("volume").is_none() && number(&answer["area"]) > 1.0, "{answer}");
    assert_eq!(answer["limit"]["vertices"].as_array().unwrap().len(), 9);
    for normal in answer["limit"]["normals"].as_array().unwrap() {
        assert!(number(&normal[2]) > 0.7, "{normal}");
    }
    server.post("/v1/subdivide?format=svg", &body).expect_svg();
    let normals = json!([[-1, 0, 4], [1, 0, 4], [1, 1, 4], [-1, 1, 4]]);
    let mut oriented = json!({"scheme": "normal_based", "level": 2, "mesh": square});
    oriented["mesh"]["normals"] = normals;
    let answer = server.post("/v1/subdivide", &oriented).expect(200);
    assert_eq!(answer["mesh"]["vertices"].as_array().unwrap().len(), 25);
    assert!(answer.get("volume").is_none());
    for scheme in ["butterfly", "blob"] {
        let mut body = json!({"scheme": scheme, "level": 1, "mesh": square});
        if scheme == "blob" {
            body["lambda"] = json!(1.0);
        }
        let said = server
            .post("/v1/subdivide", &body)
            .expect_problem(422, "invalid-input", &["/mesh/faces/0"])
            .to_string();
        assert!(said.contains("no face on its other side"), "{said}");
    }
    let pinched = json!({"vertices": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], "faces": [[0, 1, 2], [0, 3, 4]]});
    let said = server
        .post("/v1/subdivide", &json!({"scheme": "loop", "level": 1, "mesh": pinched}))
        .expect_problem(422, "invalid-input", &["/mesh/faces"])
        .to_string();
    assert!(said.contains("meet only there"), "{said}");
}

#[test]
fn open_surfaces_have_statistics_and_measures_without_a_volume() {
    let server = shared();
    let faces =
        json!([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 8], [4, 8, 7]]);
    let representation = of_scheme("loop", 3, faces.clone());
    let sheet = |seed: usize| -> Value {
        let s = seed as f64;
        let at = |k: usize| {
            let [x, y] = [(k % 3) as f64 - 1.0, (k / 3) as f64 - 1.0];
            [
                (1.0 + 0.1 * s) * x + s,
                y + 0.1 * (s + x).sin(),
                0.3 * (1.0 + 0.2 * s) * x * y + 0.1 * (3.0 * s).cos() * x * x,
            ]
        };
        json!({"control_points": (0..9).map(at).collect::<Vec<_>>()})
    };
    let shapes: Vec<Value> = (0..6).map(sheet).collect();
    let body = json!({"representation": representation, "shapes": shapes});
    let measured = server.post("/v1/measure", &body).expect(200)["results"][0].clone();
    assert!(measured["volume"].is_null() && number(&measured["area"]) > 2.0, "{measured}");
    let frames = server.post("/v1/evaluate", &with(&body, json!({"frames": true}))).expect(200);
    let bends = frames["evaluations"][0]["principal_curvatures"].as_array().unwrap();
    // 8 edges of the boundary, split three times.
    assert_eq!((bends.len(), bends.iter().filter(|bend| bend.is_null()).count()), (289, 64));
    let mean = server.post("/v1/mean", &with(&body, json!({"transformation": "affine"}))).expect(200);
    assert_eq!(mean["mean"]["control_points"].as_array().unwrap().len(), 9);
    let overlap = json!({"first": {"vertices": shapes[0]["control_points"], "faces": faces}, "second": {"vertices": shapes[1]["control_points"], "faces": faces}});
    server.post("/v1/overlap", &overlap).expect_problem(
        422,
        "invalid-input",
        &["/first/faces/0", "/second/faces/0"],
    );
    let prior = json!({"representation": representation, "transformation": "affine", "reference": shapes[0], "shapes": shapes});
    let found = server.post("/v1/prior", &prior).expect(200)["results"].clone();
    assert!(number(&found[0]["energy"]).abs() < 1e-12 && number(&found[1]["energy"]) > 0.0, "{found}");
    assert!(found[1]["volume"].is_null(), "{found}");
    let refused = of_scheme("butterfly", 2, faces);
    let body = json!({"representation": refused, "shapes": shapes});
    server.post("/v1/measure", &body).expect_problem(
        422,
        "invalid-input",
        &["/representation/connectivity/0"],
    );
}

/// Two points whose normals lie along the edge: half a circle for each binormal, as 2.2 of the paper has it.
#[test]
fn binormals_bend_edges_whose_normals_define_no_plane() {
    let server = shared();
    let polyline = json!({"points": [[-2, 0], [2, 0]], "normals": [[-1, 0], [1, 0]], "binormals": [[0, 0, -1], [0, 0, -7]]});
    let body = json!({"scheme": "normal_based", "level": 6, "polyline": polyline});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    let points = answer["polyline"]["points"].as_array().unwrap();
    assert_eq!(points.len(), 128);
    for (point, normal) in points.iter().zip(answer["polyline"]["normals"].as_array().unwrap()) {
        assert!((number(&point[0]).hypot(number(&point[1])) - 2.0).abs() < 1e-14, "{point}");
        assert_close(&json!([number(&point[0]) / 2.0, number(&point[1]) / 2.0]), normal, 1e-13, "normal");
    }
    // To its right: counter-clockwise.
    assert!(number(&points[16][1]) < 0.0, "{}", points[16]);
    let open = with(&polyline, json!({"closed": false, "binormals": [[0, 0, 1]]}));
    let answer = server.post("/v1/subdivide", &with(&body, json!({"polyline": open}))).expect(200);
    assert_close(&answer["polyline"]["points"][32], &json!([0, 2]), 1e-14, "the top");
    let refused = |change: Value, pointer: &str| {
        let body = with(&body, json!({"polyline": with(&polyline, change)}));
        server.post("/v1/subdivide", &body).expect_problem(422, "invalid-input", &[pointer]).to_string()
    };
    let said = refused(json!({"binormals": [[0, 0, 1]]}), "/polyline/binormals");
    assert!(said.contains("expected 2 entries"), "{said}");
    refused(json!({"binormals": [[0, 0, 1], [1, 0, 1]]}), "/polyline/binormals/1");
    refused(json!({"binormals": [[0, 0, 1], [0, 0]]}), "/polyline/binormals/1");
    refused(json!({"binormals": null}), "/polyline/points");
    let said = refused(json!({"binormals": [[0, 0, 1], [0, 0, 0]]}), "/polyline");
    assert!(said.contains("parallel"), "{said}");
}

#[test]
fn corners_of_the_normal_based_scheme_are_warned_of() {
    let server = shared();
    // The normal at the second point is orthogonal to the first edge, that at the first point is not.
    let line = json!({"points": [[0, 0], [2, 0], [4, -1]], "normals": [[-0.866025403784, 0.5], [0, 1], [0.6, 0.8]], "closed": false});
    let body = json!({"scheme": "normal_based", "level": 4, "polyline": line});
    let warned = |body: &Value| server.post("/v1/subdivide", body).expect(200)["warnings"].to_string();
    let said = warned(&body);
    assert!(
        said.contains("corners: 1 edges") && said.contains("first at point 0 with 60.0 degrees"),
        "{said}"
    );
    assert_eq!(warned(&with(&body, json!({"balance": 0.25}))), "[]");
    let (vertices, faces) = start(&server, "octahedron");
    let mesh = json!({"vertices": vertices, "faces": faces, "normals": vertices});
    let body = json!({"scheme": "normal_based", "level": 2, "mesh": mesh});
    assert_eq!(warned(&body), "[]");
    let mut normals = json!(vertices);
    normals[0] = json!([1, 1, 0]);
    let tilted = with(&body, json!({"mesh": with(&mesh, json!({"normals": normals}))}));
    // Orthogonal to the edge from +x to +y, while the normal there is not.
    let said = warned(&tilted);
    assert!(
        said.contains("corners: 1 edges") && said.contains("first at point 2 with 45.0 degrees"),
        "{said}"
    );
}

/// Points and normals are moved, as in the experiment of the paper.
#[test]
fn shapes_with_normals_are_deformed_by_their_points_and_normals() {
    let server = shared();
    let (sphere, _) = start(&server, "octahedron");
    let representation = of_scheme("normal_based", 3, json!("octahedron"));
    let shape = json!({"control_points": sphere, "normals": sphere});
    let body = json!({"representation": representation, "shape": shape,
        "moves": [{"control_point": 0, "by": [0.5, 0, 0]}, {"control_point": 4, "by": [0, 0, 0], "normal": [0.2, 0, 2]}],
        "handles": [{"parameters": [2], "position": [0, 1.25, 0]}]});
    let answer = server.post("/v1/deform", &body).expect(200);
    assert_close(&answer["control_points"][0], &json!([1.5, 0, 0]), 1e-15, "moved");
    assert_close(&answer["control_points"][2], &json!([0, 1.25, 0]), 1e-15, "held");
    let length = 4.04_f64.sqrt();
    assert_close(&answer["normals"][4], &json!([0.2 / length, 0, 2.0 / length]), 1e-15, "turned");
    assert_close(&answer["normals"][0], &json!(sphere[0]), 1e-15, "kept");
    assert!(
        answer["l2_change"].is_null() && (number(&answer["largest_change"]) - 0.5).abs() < 1e-12,
        "{answer}"
    );
    assert_eq!(answer["supports"].as_array().unwrap().len(), 2);
    // The answer is a shape again.
    let again = json!({"representation": representation, "shapes": [{"control_points": answer["control_points"], "normals": answer["normals"]}]});
    server.post("/v1/evaluate", &again).expect(200);
    let refused = |change: Value, pointers: &[&str]| {
        server
            .post("/v1/deform", &with(&body, change))
            .expect_problem(422, "invalid-input", pointers)
            .to_string()
    };
    let said = refused(
        json!({"handles": [{"parameters": [9], "position": [0, 0, 0]}]}),
        &["/handles/0/parameters/0"],
    );
    assert!(said.contains("not linear"), "{said}");
    let two = json!([{"parameters": [2], "position": [0, 1, 0]}, {"parameters": [2], "position": [0, 2, 0]}]);
    refused(json!({"handles": two}), &["/handles/1/parameters/0"]);
    refused(
        json!({"moves": [{"control_point": 6, "by": [0, 0, 0], "normal": [0, 0, 0]}]}),
        &["/moves/0/control_point", "/moves/0/normal"],
    );
    refused(json!({"moves": [], "handles": []}), &[""]);
    refused(json!({"shape": {"control_points": [[0, 0, 0]]}}), &["/shape/control_points"]);
    // The point of another vertex: the edge between them cannot be split.
    refused(json!({"handles": [{"parameters": [2], "position": [0, 0, 1]}]}), &["/moves"]);
    let linear = json!({"representation": of_scheme("loop", 2, json!("octahedron")), "shape": {"control_points": sphere},
        "moves": [{"control_point": 0, "by": [0, 0, 0], "normal": [0, 0, 1]}]});
    server.post("/v1/deform", &linear).expect_problem(422, "invalid-input", &["/moves/0/normal"]);
}

#[test]
fn representations_that_are_none_are_refused() {
    let server = shared();
    let (sphere, _) = start(&server, "octahedron");
    let refused = |representation: Value, pointers: &[&str]| {
        let body = json!({"representation": representation, "shapes": [{"control_points": sphere}]});
        for path in ["/v1/evaluate", "/v1/measure"] {
            server.post(path, &body).expect_problem(422, "invalid-input", pointers);
        }
        let body = with(&body, json!({"transformation": "affine"}));
        server.post("/v1/mean", &body).expect_problem(422, "invalid-input", pointers);
        let cohort = json!({"name": "none", "representation": representation});
        server.post("/v1/cohorts", &cohort).expect_problem(422, "invalid-input", pointers);
    };
    refused(blob(30, json!("octahedron")), &["/representation/level"]);
    refused(blob(2, json!("octahedron/9")), &["/representation/connectivity", "/representation/level"]);
    refused(blob(2, json!("icosahedron")), &["/representation/connectivity"]);
    refused(blob(2, json!([[0, 2, 4], [2, 1, 4]])), &["/representation/connectivity/0"]);
    refused(blob(2, json!([])), &["/representation/connectivity"]);
    refused(
        blob(0, json!([[0, 1, 4_000_000_000_u64]])),
        &["/representation/connectivity", "/representation/level"],
    );
    refused(of_scheme("blob", 2, json!("octahedron")), &["/representation/lambda"]);
    refused(of_scheme("loop", 2, json!(7)), &["/representation/connectivity"]);
    let good = blob(2, json!("octahedron"));
    let body = json!({"representation": good, "shapes": [{"control_points": sphere}]});
    for (path, extra, pointer) in [
        ("/v1/evaluate", json!({"samples": 5}), "/samples"),
        ("/v1/evaluate", json!({"grid": [5, 5]}), "/grid"),
        ("/v1/evaluate", json!({"parameters": [[0.5, 0.5]]}), "/parameters"),
        ("/v1/evaluate", json!({"derivatives": 1}), "/derivatives"),
        ("/v1/evaluate", json!({"correspondence": "cyclic"}), "/correspondence"),
        ("/v1/refine", json!({}), "/representation/kind"),
        ("/v1/mean", json!({"transformation": "affine", "mirror": "allow"}), "/mirror"),
    ] {
        server.post(path, &with(&body, extra)).expect_problem(422, "invalid-input", &[pointer]);
    }
    let wrong = json!({"representation": good, "shapes": [{"control_points": [[1, 2, 3]]}]});
    server.post("/v1/evaluate", &wrong).expect_problem(422, "invalid-input", &["/shapes/0/control_points"]);
    let ideal = json!({"representation": good, "curves": [{"curve": {"name": "circle", "radius": 1}}]});
    server.post("/v1/idealised", &ideal).expect_problem(422, "invalid-input", &["/representation/kind"]);
}

/// A small body far from another one has its cells, and who has few or crosses itself is told.
fn small_bodies_overlap(overlap: &dyn Fn(Value) -> crate::server::Reply) {
    let warnings = |answer: &Value| -> Vec<String> {
        answer["warnings"].as_array().unwrap().iter().map(|w| w.as_str().unwrap().to_owned()).collect()
    };
    let triangle = json!({"contour": [[90, 0], [91, 0], [90, 1]]});
    let square = json!({"contour": [[0, 0], [1, 0], [1, 1], [0, 1]]});
    let answer = overlap(json!({"first": triangle, "second": square})).expect(200);
    // 32 cells along the triangle: half of 32², but for those at its border.
    assert!(number(&answer["cells"][0]) > 450.0 && warnings(&answer).is_empty(), "{answer}");
    assert!((number(&answer["measures"][0]) - 0.5).abs() < 0.05, "{answer}");
    assert!(number(&answer["hausdorff"]) > 89.0, "{answer}");
    // So far away that no grid has cells for both.
    let far = json!({"contour": [[9e6, 9e6], [9e6 + 1.0, 9e6], [9e6, 9e6 + 1.0]]});
    let answer = overlap(json!({"first": square, "second": far})).expect(200);
    assert!(warnings(&answer).iter().any(|warning| warning.starts_with("/second: only 0 cells")), "{answer}");
    let coarse = overlap(json!({"first": square, "second": square, "spacing": 1e9})).expect(200);
    assert_eq!(warnings(&coarse).len(), 2, "{coarse}");
    let eight = json!({"contour": [[0, 0], [1, 1], [1, 0], [0, 1]]});
    let answer = overlap(json!({"first": eight, "second": square})).expect(200);
    assert!(warnings(&answer)[0].starts_with("/first: the contour crosses"), "{answer}");
    // Closed by a repeated point, with a repeated neighbour: no crossing.
    let repeated = json!({"contour": [[0, 0], [1, 0], [1, 0], [1, 1], [0, 1], [0, 0]]});
    assert!(warnings(&overlap(json!({"first": repeated, "second": square})).expect(200)).is_empty());
    for (body, reason) in [
        (json!({"contour": [[1, 1], [1, 1], [1, 1]]}), "points coincide"),
        (json!({"contour": [[0, 0], [1, 2], [2, 4], [3, 6]]}), "on a line"),
    ] {
        let problem = overlap(json!({"first": body, "second": body})).expect_problem(
            422,
            "invalid-input",
            &["/first/contour", "/second/contour"],
        );
        assert!(
            problem.to_string().contains(reason) && !problem.to_string().contains("/spacing"),
            "{problem}"
        );
    }
}

#[test]
fn bodies_overlap_as_much_as_their_cells() {
    let server = shared();
    let overlap = |body: Value| server.post("/v1/overlap", &body);
    let square =
        |at: f64| json!({"contour": [[at, at], [at + 4.0, at], [at + 4.0, at + 4.0], [at, at + 4.0]]});
    let answer = overlap(json!({"first": square(0.0), "second": square(1.0), "spacing": 0.05})).expect(200);
    assert!((number(&answer["jaccard"]) - 9.0 / 23.0).abs() < 1e-12, "{answer}");
    assert!((number(&answer["dice"]) - 18.0 / 32.0).abs() < 1e-12, "{answer}");
    assert!((number(&answer["measures"][0]) - 16.0).abs() < 1e-12, "{answer}");
    // From corner to corner.
    assert!((number(&answer["hausdorff"]) - 2.0_f64.sqrt()).abs() < 1e-12, "{answer}");

    let (vertices, faces) = start(&server, "octahedron/4");
    let ball = |x: f64| {
        let moved: Vec<[f64; 3]> = vertices.iter().map(|[a, b, c]| [a + x, *b, *c]).collect();
        json!({"vertices": moved, "faces": faces})
    };
    let answer = overlap(json!({"first": ball(0.0), "second": ball(0.5)})).expect(200);
    let (r, d) = (1.0_f64, 0.5);
    let lens = PI * (4.0 * r + d) * (2.0 * r - d).powi(2) / 12.0;
    let wanted = lens / (2.0 * 4.0 * PI / 3.0 - lens);
    assert!((number(&answer["jaccard"]) - wanted).abs() < 3e-3, "{answer}");
    assert!((number(&answer["hausdorff"]) - d).abs() < 0.05, "{answer}");
    let same = overlap(json!({"first": ball(0.0), "second": ball(0.0)})).expect(200);
    assert_eq!((&same["jaccard"], &same["hausdorff"]), (&json!(1.0), &json!(0.0)));

    let mask =
        |runs: Value| json!({"mask": {"size": [4, 4], "spacing": [1, 1], "first": [0.5, 0.5], "runs": runs}});
    let answer = overlap(json!({"first": mask(json!([5, 2, 2, 2, 5])), "second": square(0.0)})).expect(200);
    assert_eq!((&answer["cells"], &answer["intersection"]), (&json!([4, 16]), &json!(4)));
    let empty = overlap(json!({"first": mask(json!([16])), "second": mask(json!([16]))})).expect(200);
    assert_eq!((&empty["jaccard"], &empty["hausdorff"]), (&json!(1.0), &Value::Null));

    let refused = |body: Value, pointers: &[&str]| {
        overlap(body).expect_problem(422, "invalid-input", pointers).to_string()
    };
    small_bodies_overlap(&overlap);
    refused(json!({"first": square(0.0)}), &["/second"]);
    refused(json!({"first": square(0.0), "second": ball(0.0)}), &["/second"]);
    refused(json!({"first": square(0.0), "second": {}}), &["/second"]);
    refused(json!({"first": square(0.0), "second": {"contour": [[0, 0], [1, 1]]}}), &["/second/contour"]);
    refused(json!({"first": square(0.0), "second": square(1.0), "spacing": 0}), &["/spacing"]);
    refused(json!({"first": square(0.0), "second": square(1.0), "spacing": 1e-9}), &["/spacing"]);
    refused(json!({"first": mask(json!([16])), "second": square(1.0), "spacing": 1}), &["/spacing"]);
    refused(json!({"first": mask(json!([15])), "second": square(1.0)}), &["/first/mask/runs"]);
    let other = json!({"mask": {"size": [4, 4], "spacing": [1, 1], "first": [0, 0], "runs": [16]}});
    refused(json!({"first": mask(json!([16])), "second": other}), &["/second/mask"]);
    let huge = json!({"mask": {"size": [1_000_000, 1_000_000, 1_000_000], "spacing": [1, 1, 1], "first": [0, 0, 0], "runs": []}});
    refused(json!({"first": huge, "second": ball(0.0)}), &["/first/mask/size", "/first/mask/runs"]);
    let bad = json!({"mask": {"size": [2], "spacing": [0, 1], "first": [0], "runs": [2]}});
    refused(
        json!({"first": bad, "second": square(0.0)}),
        &["/first/mask/size", "/first/mask/spacing", "/first/mask/spacing"],
    );
    let open = json!({"vertices": vertices, "faces": faces.as_array().unwrap()[1..]});
    refused(json!({"first": ball(0.0), "second": open}), &["/second/faces/2"]);
}
