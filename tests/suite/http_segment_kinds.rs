//! Objects of several representations in one request, and control meshes that stages split.

use serde_json::{Value, json};
use shapelex_formats::image::LengthUnit;
use shapelex_formats::image::write::{nifti_f32, nifti_u8};

use crate::http_segment::{PATH, ball, bright, curves, grid, number, post_files, post_with_truth, values};
use crate::server::{Setting, shared};

const TRIGONOMETRIC: &str = "trigonometric";
const VOLUME: [usize; 3] = [56, 30, 24];

fn surface(topology: &str, control_points: [usize; 2]) -> Value {
    let generator = json!({"name": TRIGONOMETRIC});
    let generators = json!([generator, generator]);
    json!({"kind": "surface", "topology": topology, "control_points": control_points, "generators": generators})
}

fn mesh(connectivity: &str, level: usize) -> Value {
    json!({"kind": "subdivision", "scheme": "loop", "connectivity": connectivity, "level": level})
}

/// A ball (label 1) beside a ring around the z axis (label 2), and the labels.
fn ball_and_ring() -> [Vec<u8>; 2] {
    let label = |[x, y, z]: [f64; 3]| {
        let ring = ((x - 40.0).hypot(y - 15.0) - 8.0).hypot(z - 12.0) <= 3.5;
        let ball =
            ((x - 12.0) / 8.0).powi(2) + ((y - 15.0) / 9.0).powi(2) + ((z - 12.0) / 7.0).powi(2) <= 1.0;
        u8::from(ball) + 2 * u8::from(ring)
    };
    let grid = grid(VOLUME, [1.0; 3], LengthUnit::Millimetre);
    let image = values(VOLUME, |cell| if label(cell) > 0 { 100.0_f32 } else { 20.0 });
    [nifti_f32(&grid, &image).unwrap(), nifti_u8(&grid, &values(VOLUME, label)).unwrap()]
}

/// A sphere and a torus: each result is that of a request of its own.
#[test]
fn objects_of_two_topologies_are_found_in_one_request() {
    let (server, [image, truth]) = (shared(), ball_and_ring());
    let boxes = [
        json!({"lower": [5, 7, 6], "upper": [19, 23, 18]}),
        json!({"lower": [29, 4, 9], "upper": [51, 26, 15]}),
    ];
    let (sphere, torus) = (surface("sphere", [6, 6]), surface("torus", [8, 6]));
    let body = |representation: &Value, boxes: &[Value], labels: &[u32], representations: Value| {
        json!({
            "representation": representation, "representations": representations, "coordinates": "index",
            "terms": [{"name": "contour"}], "boxes": boxes, "truth_labels": labels
        })
    };
    let both = body(&sphere, &boxes, &[1, 2], json!([null, torus]));
    let found = post_with_truth(&server, &both, &image, &truth).expect(200);
    for (index, representation) in [&sphere, &torus].into_iter().enumerate() {
        let result = &found["results"][index];
        let jaccard = number(&result["overlap"]["jaccard"]);
        // The phantom has sharp steps: half a cell along the boundary is a tenth of either object.
        assert!(jaccard > 0.85, "{index}: {jaccard}, {}", result["warnings"]);
        let alone = body(representation, &boxes[index..=index], &[index as u32 + 1], Value::Null);
        let alone = post_with_truth(&server, &alone, &image, &truth).expect(200);
        assert_eq!(alone["results"][0]["control_points"], result["control_points"]);
    }
}

/// 6 control points become 66: the answer has the finer mesh, as another request takes it, and is nearer to the object than with 6
/// points.
#[test]
fn stages_split_the_control_mesh() {
    let (server, [image, truth]) = (shared(), ball());
    let body = |splits: [usize; 2]| {
        json!({
            "representation": mesh("octahedron/0", 4), "terms": [{"name": "contour"}],
            "boxes": [{"lower": [8, 7, 9], "upper": [20, 18, 23]}],
            "stages": [
                {"free": "affine", "sigma": 2}, {"sigma": 2}, {"sigma": 2, "splits": splits[0]}, {"sigma": 1, "splits": splits[1]}
            ]
        })
    };
    let [coarse, fine] = [[0, 0], [1, 1]].map(|splits| {
        let found = post_with_truth(&server, &body(splits), &image, &truth).expect(200);
        found["results"][0].clone()
    });
    let points = |result: &Value| result["control_points"].as_array().unwrap().len();
    assert_eq!((points(&coarse), points(&fine)), (6, 66));
    assert_eq!(
        (&coarse["representation"], &fine["representation"]),
        (&Value::Null, &mesh("octahedron/2", 2))
    );
    let jaccard = |result: &Value| number(&result["overlap"]["jaccard"]);
    assert!(jaccard(&fine) > 0.9 && jaccard(&fine) > jaccard(&coarse) - 0.01, "{fine}, {coarse}");
    let shapes = json!([{"control_points": fine["control_points"]}]);
    let measured = server
        .post("/v1/measure", &json!({"representation": fine["representation"], "shapes": shapes}))
        .expect(200);
    // Both are sums over the faces of the same mesh.
    let (measured, answered) =
        (number(&measured["results"][0]["signed_volume"]), number(&fine["moved"]["result"]["size"]));
    assert!((measured / answered - 1.0).abs() < 1e-12, "{measured}, {answered}");
    // A split without an iteration leaves the surface where it is.
    let mut still = body([1, 2]);
    for stage in still["stages"].as_array_mut().unwrap() {
        stage["iterations"] = json!(0);
    }
    let still = post_with_truth(&server, &still, &image, &truth).expect(200);
    assert_eq!(points(&still["results"][0]), 258);
    let moved = &still["results"][0]["moved"];
    let ratio = number(&moved["result"]["size"]) / number(&moved["start"]["size"]);
    assert!((ratio - 1.0).abs() < 1e-12, "{moved}");
}

/// Objects that begin with 6 control points go into a cohort of 18.
#[test]
fn split_control_meshes_go_into_a_cohort_of_the_finest() {
    let (server, [image, _]) = (Setting::fresh().start(), ball());
    let fine = mesh("octahedron/1", 3);
    server
        .post("/v1/cohorts", &json!({"name": "bodies", "representation": fine, "length_unit": "mm"}))
        .expect(201);
    let body = |representation: Value, further: Value| {
        let mut body = json!({
            "representation": representation, "terms": [{"name": "contour"}], "objects": [{"external_id": "one"}],
            "boxes": [{"lower": [5, 4, 7], "upper": [23, 20, 25]}],
            "stages": [{"free": "affine", "sigma": 2}, {"sigma": 1, "splits": 1}]
        });
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        body
    };
    let path = "/v1/cohorts/bodies/segment";
    let post = |body: &Value| post_files(&server, path, body, &[("image", &image)]);
    for (representation, further, pointer) in [
        (mesh("octahedron/1", 3), json!({}), "/representation"),
        (mesh("octahedron/0", 3), json!({}), "/representation"),
        (mesh("octahedron/0", 4), json!({"stages": [{"sigma": 1, "splits": 4}]}), "/representation"),
        (mesh("octahedron/0", 4), json!({"representations": [fine]}), "/representations"),
    ] {
        post(&body(representation, further)).expect_problem(422, "invalid-input", &[pointer]);
    }
    let answer = post(&body(mesh("octahedron/0", 4), json!({}))).expect(201);
    assert_eq!(answer["added"], json!(1), "{answer}");
    let stored = server.get("/v1/cohorts/bodies/shapes/one").expect(200);
    assert_eq!(stored["control_points"].as_array().unwrap().len(), 18);
}

/// Every field that does not fit is named, with what it should be.
#[test]
fn representations_and_splits_that_do_not_fit_are_refused_at_their_place() {
    let (server, [volume, _]) = (shared(), ball());
    let solid = |further: Value| {
        let mut body = json!({
            "representation": mesh("octahedron/0", 2), "terms": [{"name": "contour"}],
            "boxes": [{"lower": [8, 7, 9], "upper": [20, 18, 23]}]
        });
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        body
    };
    let cases = [
        (solid(json!({"stages": [{"sigma": 2}, {"sigma": 1, "splits": 3}]})), "/stages/1/splits"),
        (
            solid(json!({"stages": [{"sigma": 2, "splits": 2}, {"sigma": 1, "splits": 1}]})),
            "/stages/0/splits",
        ),
        (solid(json!({"stages": [{"sigma": 2, "splits": u32::MAX}]})), "/stages/0/splits"),
        (
            solid(
                json!({"representation": surface("sphere", [6, 6]), "stages": [{"sigma": 2, "splits": 1}]}),
            ),
            "/stages/0/splits",
        ),
        (
            solid(
                json!({"representations": [surface("sphere", [6, 6])], "stages": [{"sigma": 2, "splits": 1}]}),
            ),
            "/stages/0/splits",
        ),
        (solid(json!({"representations": [null, null]})), "/representations"),
        (solid(json!({"representations": []})), "/representations"),
        (
            solid(json!({"representations": [surface("sphere", [6, 1])]})),
            "/representations/0/control_points/1",
        ),
        (solid(json!({"representations": [{"kind": "cube"}]})), "/representations/0/kind"),
        (solid(json!({"representations": [curves(json!({}))["representation"]]})), "/representations/0"),
        (solid(json!({"representations": {"kind": "surface"}})), "/representations"),
        (
            solid(json!({
                "stages": [{"sigma": 2}, {"sigma": 1, "splits": 1}],
                "prior": {"reference": {"control_points": [[1,0,0],[-1,0,0],[0,1,0],[0,-1,0],[0,0,1],[0,0,-1]]}, "transformation": "affine"}
            })),
            "/prior",
        ),
    ];
    for (body, pointer) in cases {
        post_files(&server, PATH, &body, &[("image", &volume)]).expect_problem(
            422,
            "invalid-input",
            &[pointer],
        );
    }
    // Each different representation is prepared, so that their number is limited.
    let box_ = json!({"lower": [8, 7, 9], "upper": [20, 18, 23]});
    let many: Vec<Value> = (6..40).map(|count| surface("sphere", [count, 6])).collect();
    let boxes: Vec<&Value> = many.iter().map(|_| &box_).collect();
    let body = solid(json!({"representations": many, "boxes": boxes}));
    let refused = post_files(&server, PATH, &body, &[("image", &volume)]);
    refused.expect_problem(422, "invalid-input", &["/representations"]);
    // Shapes that enclose nothing are found when they are prepared.
    let open = json!({"kind": "open_curve", "dimension": 2, "intervals": 8, "generator": {"name": "cubic"}});
    let body = curves(json!({"representations": [null, open]}));
    post_files(&server, PATH, &body, &[("image", &bright())]).expect_problem(
        422,
        "invalid-input",
        &["/representations/1/kind"],
    );
}
