//! Thin sheets of volumes over HTTP.

use serde_json::{Value, json};
use shapelex_formats::image::{Limits, read, read_labels};

use crate::form::{label_picture, post_image, shell_volume};
use crate::http_segment::{PATH as SEGMENT, number};
use crate::server::{Reply, shared};

const LIMITS: Limits = Limits { bytes: 1 << 24, cells: 1 << 20 };
const SIZE: [usize; 3] = [20, 18, 16];

fn detect(query: &str, parameters: &Value) -> Reply {
    post_image(&shared(), &format!("/v1/sheets{query}"), parameters, &shell_volume())
}

/// Distance of a cell from the middle of the shell.
fn radius(cell: usize) -> f64 {
    let at = [cell % SIZE[0], cell / SIZE[0] % SIZE[1], cell / SIZE[0] / SIZE[1]].map(|index| index as f64);
    ((at[0] - 10.0).powi(2) + (at[1] - 9.0).powi(2) + (at[2] - 8.0).powi(2)).sqrt()
}

/// The shell answers where it is, its crest is its middle, and the surface is the crest of one shell.
#[test]
fn a_shell_is_detected() {
    let response = detect("", &json!({"sigma": 1}));
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/x-nifti")));
    let response = read(&response.body, &LIMITS).unwrap();
    assert_eq!(response.grid.size(), SIZE);
    let strongest =
        (0..response.values.len()).max_by(|a, b| response.values[*a].total_cmp(&response.values[*b]));
    assert!((radius(strongest.unwrap()) - 6.0).abs() < 1.0, "{strongest:?}");
    for field in ["crests", "surface"] {
        let found = detect("?format=nifti", &json!({"field": field, "sigma": 1, "centre": [10, 9, 8]}));
        let labels = read_labels(&found.body, &LIMITS).unwrap().values;
        let cells: Vec<usize> = (0..labels.len()).filter(|cell| labels[*cell] == 1).collect();
        assert!(cells.len() > 200, "{field}: {}", cells.len());
        let near = cells.iter().filter(|cell| (radius(**cell) - 6.0).abs() < 1.2).count();
        assert!(near * 20 > cells.len() * 19, "{field}: {near} of {}", cells.len());
    }
    // In cells, and of the other polarity: the inside of a bright shell is no dark sheet of this width.
    let dark =
        detect("", &json!({"field": "surface", "polarity": "dark", "sigma": 1, "coordinates": "index"}));
    assert_eq!(dark.status, 200);
}

/// The surface is an image for a segmentation: what it encloses is found by its edges.
#[test]
fn a_surface_is_the_image_of_a_segmentation() {
    let surface = detect("", &json!({"field": "surface", "sigma": 1})).body;
    let mesh = json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron/1", "level": 3});
    let body = json!({
        "representation": mesh, "boxes": [{"lower": [6, 5, 4], "upper": [14, 13, 12]}],
        "terms": [{"name": "contour", "polarity": "dark"}]
    });
    let found = post_image(&shared(), SEGMENT, &body, &surface).expect(200)["results"][0].clone();
    let shapes = json!([{"control_points": found["control_points"]}]);
    let measured =
        shared().post("/v1/measure", &json!({"representation": mesh, "shapes": shapes})).expect(200);
    let volume = number(&measured["results"][0]["signed_volume"]).abs();
    let radius = (volume * 0.75 / std::f64::consts::PI).cbrt();
    assert!((4.0..6.5).contains(&radius), "{radius} {}", found["stop"]);
}

#[test]
fn slices_are_pictures() {
    for (field, slice) in [("response", json!(8)), ("crests", Value::Null)] {
        let found = detect("?format=png", &json!({"field": field, "sigma": 1, "slice": slice}));
        assert_eq!((found.status, found.header("content-type")), (200, Some("image/png")));
        let picture = read(&found.body, &LIMITS).unwrap();
        assert_eq!(picture.grid.size(), [20, 18, 1]);
        let at = |x: usize, y: usize| picture.values[y * 20 + x];
        assert!(at(16, 9) > 100.0 && at(10, 9) < 60.0, "{field}: {} {}", at(16, 9), at(10, 9));
    }
}

#[test]
fn bad_sheets_are_refused_at_their_place() {
    for (parameters, pointer) in [
        (json!({"sigma": 0}), "/sigma"),
        (json!({"sigma": 0.2}), "/sigma"),
        (json!({"sigma": 100}), "/sigma"),
        (json!({"fraction": 2}), "/fraction"),
        (json!({"percent": -1}), "/percent"),
        (json!({"beyond": -1}), "/beyond"),
        (json!({"centre": [1, 2]}), "/centre"),
        (json!({"slice": 16}), "/slice"),
        (json!({"field": "edges"}), "/field"),
        (json!({"kind": "sheet"}), "/kind"),
    ] {
        detect("", &parameters).expect_problem(422, "invalid-input", &[pointer]);
    }
    let picture = post_image(&shared(), "/v1/sheets", &json!({}), &label_picture());
    picture.expect_problem(422, "invalid-input", &["/image"]);
    detect("?format=svg", &json!({})).expect_problem(400, "invalid-query", &[]);
}
