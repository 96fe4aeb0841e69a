//! Boundaries of label images over HTTP, and forms that are refused.

use serde_json::{Value, json};
use shapelex_formats::image::write::nifti_u8;
use shapelex_formats::image::{Grid, LengthUnit};

use crate::form::{BOUNDARY, form, label_picture, post_form, post_image};
use crate::server::shared;

const PATH: &str = "/v1/contours";

fn grid(size: [usize; 3], spacing: [f64; 3]) -> Grid {
    Grid::along_axes(size, spacing, [LengthUnit::Millimetre; 3]).unwrap()
}

fn area(ring: &Value) -> f64 {
    let points: Vec<[f64; 2]> = serde_json::from_value(ring.clone()).unwrap();
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|([x, y], [u, v])| 0.5 * (x * v - u * y)).sum()
}

#[test]
fn labels_have_contours_and_holes_apart() {
    let server = shared();
    let found = post_image(&server, PATH, &json!({}), &label_picture()).expect(200);
    assert_eq!(found["image"], json!({"size": [40, 24], "spacing": [1.0, 1.0], "has_lengths": false}));
    let results = found["results"].as_array().unwrap();
    let names: Vec<_> = results.iter().map(|r| (r["label"].as_u64(), r["component"].as_u64())).collect();
    // Squares that meet at a corner are two components; cells are searched row by row.
    assert_eq!(names, [(Some(3), Some(0)), (Some(7), Some(0)), (Some(7), Some(1))]);
    let disc = &results[0];
    let cells = disc["cells"].as_f64().unwrap();
    let [outer, hole] = [area(&disc["points"]), area(&disc["holes"][0])];
    // Counter-clockwise and clockwise; each loses half a cell at its corners.
    assert!(outer > 0.0 && hole < 0.0 && (outer + hole - cells).abs() <= 1.0, "{outer} {hole} {cells}");
    assert_eq!((disc["holes"].as_array().unwrap().len(), &disc["edge_sides"]), (1, &json!(0)));
    // A selection of labels and sizes.
    let some = json!({"labels": [7], "least_cells": 16, "coordinates": "index"});
    let some = post_image(&server, PATH, &some, &label_picture()).expect(200);
    assert_eq!(some["results"].as_array().unwrap().len(), 2);
    let none =
        post_image(&server, PATH, &json!({"labels": [7], "least_cells": 17}), &label_picture()).expect(200);
    assert_eq!((&none["results"], &none["left_out"]), (&json!([]), &json!({"components": 2, "cells": 32})));
    // A contour is a shape.
    let shape = json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 8,
        "generator": {"name": "cubic"}}, "correspondence": "arc_length", "shapes": [{"points": disc["points"]}]});
    server.post("/v1/measure", &shape).expect(200);
}

#[test]
fn volumes_have_surfaces_in_millimetres() {
    let size = [12, 10, 9];
    let inside = |cell: usize| {
        let (x, y, z) = (cell % 12, cell / 12 % 10, cell / 120);
        let (wall, core) =
            ((2..9).contains(&x) && (2..8).contains(&y) && (2..7).contains(&z), [5, 5, 4] == [x, y, z]);
        u8::from(wall && !core)
    };
    let values: Vec<u8> = (0..12 * 10 * 9).map(inside).collect();
    let file = nifti_u8(&grid(size, [0.5, 1.0, 2.0]), &values).unwrap();
    let found = post_image(&shared(), PATH, &json!({}), &file).expect(200);
    assert_eq!(found["image"]["spacing"], json!([0.5, 1.0, 2.0]));
    let results = found["results"].as_array().unwrap();
    let (solid, cavities) = (&results[0], results[0]["cavities"].as_array().unwrap());
    assert_eq!((results.len(), cavities.len(), &solid["cells"]), (1, 1, &json!(7 * 6 * 5 - 1)));
    assert_eq!((&solid["genus"], &solid["edge_sides"]), (&json!(0), &json!(0)));
    let mesh = |surface: &Value| json!({"vertices": surface["vertices"], "faces": surface["faces"]});
    let body = json!({"first": mesh(solid), "second": mesh(&cavities[0])});
    let overlap = shared().post("/v1/overlap", &body).expect(200);
    // Half a cell less at every corner and edge of 210 cells of 1 mm³.
    let volume = overlap["measures"][0].as_f64().unwrap();
    assert!((170.0..210.0).contains(&volume), "{volume}");
}

#[test]
fn bad_images_and_settings_are_refused_at_their_place() {
    let server = shared();
    let refused = |parameters: Value, image: &[u8], pointer: &str| {
        post_image(&server, PATH, &parameters, image).expect_problem(422, "invalid-input", &[pointer]);
    };
    refused(json!({"blur": -1}), &label_picture(), "/blur");
    refused(json!({"blur": 100}), &label_picture(), "/blur");
    refused(json!({"labels": [3, 4]}), &label_picture(), "/labels");
    refused(json!({"labels": "3"}), &label_picture(), "/labels");
    refused(json!({"least_cell": 3}), &label_picture(), "/least_cell");
    refused(json!({}), b"no image", "/image");
    refused(json!({}), b"", "/image");
    let whole = label_picture();
    refused(json!({}), &whole[..whole.len() / 2], "/image");
    // The header claims 100 000 × 100 000 pixels; its checksum is not looked at before the size.
    let mut claim = whole.clone();
    claim[16..24].copy_from_slice(&[0, 1, 134, 160, 0, 1, 134, 160]);
    refused(json!({}), &claim, "/image");
    post_image(&server, PATH, &json!([]), &label_picture()).expect_problem(422, "invalid-input", &[""]);
}

#[test]
fn broken_forms_are_refused() {
    let server = shared();
    let (json, picture) = (("parameters", "application/json", &b"{}"[..]), label_picture());
    let image = ("image", "image/png", &picture[..]);
    let refused = |parts: &[(&str, &str, &[u8])], pointer: &str| {
        post_form(&server, PATH, form(parts)).expect_problem(422, "invalid-input", &[pointer]);
    };
    post_form(&server, PATH, form(&[json, image])).expect(200);
    refused(&[], "/parameters");
    refused(&[image, json], "/parameters");
    refused(&[json], "/image");
    refused(&[json, image, image], "/image");
    refused(&[json, json, image], "/parameters");
    refused(&[json, ("picture", "image/png", &picture)], "/picture");
    refused(&[("a/b~c", "image/png", &picture)], "/a~1b~0c");
    let text = ("parameters", "text/plain", &b"{}"[..]);
    post_form(&server, PATH, form(&[text, image])).expect_problem(415, "unsupported-media-type", &[]);
    server.post(PATH, &json!({})).expect_problem(415, "unsupported-media-type", &[]);
    let bytes = |media_type: &str, bytes: Vec<u8>| server.post_bytes(PATH, media_type, bytes);
    bytes("multipart/form-data", form(&[json, image])).expect_problem(400, "malformed-body", &[]);
    let with_boundary = format!("multipart/form-data; boundary={BOUNDARY}");
    let whole = form(&[json, image]);
    for end in [0, 10, 60, 120, 200, whole.len() / 2, whole.len() - 10] {
        let reply = bytes(&with_boundary, whole[..end].to_vec());
        assert!([400, 422].contains(&reply.status), "{end}: {}", reply.text());
    }
    bytes(&with_boundary, b"no form at all".to_vec()).expect_problem(400, "malformed-body", &[]);
}

#[test]
fn overlap_is_counted_on_a_given_grid() {
    let square = |x: f64| json!({"contour": [[x, 0.0], [x + 2.0, 0.0], [x + 2.0, 2.0], [x, 2.0]]});
    let grid = json!({"size": [6, 4], "spacing": [0.5, 0.5], "first": [0.25, 0.25]});
    let body = json!({"first": square(0.0), "second": square(1.0), "grid": grid});
    let found = shared().post("/v1/overlap", &body).expect(200);
    assert_eq!((&found["cells"], &found["intersection"]), (&json!([16, 16]), &json!(8)));
    assert_eq!(found["grid"], grid);
    // Parts beyond the grid are left out, and said to be.
    let mut small = body.clone();
    small["grid"]["size"] = json!([4, 4]);
    let found = shared().post("/v1/overlap", &small).expect(200);
    assert_eq!(found["cells"], json!([16, 8]));
    assert!(found["warnings"][0].as_str().unwrap().starts_with("/second: "), "{found}");
    let refused = |change: &dyn Fn(&mut Value), pointers: &[&str]| {
        let mut wrong = body.clone();
        change(&mut wrong);
        shared().post("/v1/overlap", &wrong).expect_problem(422, "invalid-input", pointers);
    };
    refused(&|wrong| wrong["spacing"] = json!(0.5), &["/grid"]);
    refused(&|wrong| wrong["grid"]["size"] = json!([6000, 4000]), &["/grid/size"]);
    refused(&|wrong| wrong["grid"]["spacing"] = json!([0.5, 0.0]), &["/grid/spacing"]);
    let space = json!({"size": [2, 2, 2], "spacing": [1, 1, 1], "first": [0, 0, 0]});
    refused(&|wrong| wrong["grid"] = space.clone(), &["/first", "/second"]);
}
