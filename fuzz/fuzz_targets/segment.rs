//! Forms with parameters and a tiny image: objects of noise and of constants, begun anywhere, by all terms, priors and methods.
//!
//! An even first byte: the text up to a zero byte is the parameters, as they are; else they are drawn. The rest is the image.

#![no_main]

use axum::body::Body;
use axum::http::{Request, StatusCode};
use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use shapelex_formats::image::write::{nifti_f32, png_u8};
use shapelex_formats::image::{Grid, LengthUnit};
use shapelex_fuzz::{Draws, Service, content_type};

const BOUNDARY: &str = "segment";

/// Numbers of cells along the axes.
const PLANE: [usize; 3] = [9, 7, 1];
const SPACE: [usize; 3] = [7, 6, 5];

/// A representation, and its number of control points.
fn representation(draws: &mut Draws<'_>, planar: bool) -> (Value, usize) {
    let trigonometric = json!({"name": "trigonometric"});
    let surface = |topology: &str| json!({"kind": "surface", "topology": topology, "control_points": [4, 4], "generators": [trigonometric, trigonometric]});
    let curve = |count: usize, generator: &Value| json!({"kind": "closed_curve", "dimension": 2, "control_points": count, "generator": generator});
    match (planar, draws.byte() % 4) {
        (true, 0) => (curve(5, &json!({"name": "cubic"})), 5),
        (true, _) => (curve(4, &trigonometric), 4),
        (false, 0) => (surface("sphere"), 18),
        (false, 1) => (surface("cylinder"), 28),
        (false, 2) => (surface("torus"), 16),
        (false, _) => {
            (json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron", "level": 2}), 6)
        }
    }
}

fn points(draws: &mut Draws<'_>, count: usize, axes: usize) -> Vec<Vec<f64>> {
    let mut points: Vec<[f64; 3]> = (0..count).map(|_| [0; 3].map(|_| draws.coordinate())).collect();
    draws.disturb(&mut points);
    points.into_iter().map(|point| point[..axes].to_vec()).collect()
}

fn terms(draws: &mut Draws<'_>) -> Vec<Value> {
    let weight = draws.length();
    let all = [
        json!({"name": "contour", "weight": weight}),
        json!({"name": "contour", "edges": {"kind": "sheets", "percent": 99}, "polarity": "dark"}),
        json!({"name": "contour", "edges": {"kind": "given", "scale": draws.length()}}),
        json!({"name": "threshold", "theta": draws.length()}),
        json!({"name": "threshold", "level": draws.length()}),
        json!({"name": "local_contrast"}),
        json!({"name": "two_class", "weight": weight}),
        json!({"name": "boundary", "weight": weight}),
        json!({"name": "spacing", "weight": weight}),
    ];
    (0..draws.between(1, 3)).map(|_| draws.one(&all).clone()).collect()
}

fn drawn(draws: &mut Draws<'_>, planar: bool) -> Value {
    let axes = if planar { 2 } else { 3 };
    let (representation, count) = representation(draws, planar);
    let stage = |draws: &mut Draws<'_>| {
        let free = *draws.one(&["affine", "radial", "all"]);
        json!({"free": free, "sigma": draws.length().min(3.0), "iterations": draws.between(0, 6)})
    };
    let stages: Vec<Value> = (0..draws.between(1, 3)).map(|_| stage(draws)).collect();
    let mut body = json!({
        "representation": representation, "terms": terms(draws), "stages": stages,
        "coordinates": draws.one(&["index", "world"]), "method": draws.one(&["lbfgs", "newton", "coordinates"]),
        "history": true, "gradient": true, "mask": draws.byte() % 2 == 0
    });
    let corners = points(draws, 2, axes);
    match draws.byte() % 4 {
        0 => body["shapes"] = json!([{"control_points": points(draws, count, axes)}]),
        1 => body["seeds"] = json!([{"at": corners[0]}, {"at": corners[1], "radius": draws.length()}]),
        2 => body["boxes"] = json!([{"lower": corners[0], "upper": corners[1]}]),
        _ => body["mask_least_cells"] = json!(draws.between(0, 3)),
    }
    if draws.byte() % 2 == 0 {
        let classes = ["similarity", "affine", "rigid", "translation", "scaling"];
        body["prior"] = json!({
            "reference": {"control_points": points(draws, count, axes)}, "transformation": draws.one(&classes), "weight": draws.length()
        });
    }
    if draws.byte() % 4 == 0 {
        body["slice"] = json!(draws.between(0, 5));
    }
    body
}

/// The file of an image: noise of the bytes that are left, repeated.
fn image(draws: &mut Draws<'_>, planar: bool) -> Vec<u8> {
    let size = if planar { PLANE } else { SPACE };
    let spacing = [0; 3].map(|_| f64::from(draws.byte() % 4 + 1));
    let grid = Grid::along_axes(size, spacing, [LengthUnit::Millimetre; 3]).expect("a grid");
    let noise: Vec<u8> = if draws.0.is_empty() { vec![0] } else { draws.0.to_vec() };
    let values = noise.iter().copied().cycle().take(grid.cells());
    match planar {
        true => png_u8(&grid, &values.collect::<Vec<_>>()).expect("a picture"),
        false => nifti_f32(&grid, &values.map(f32::from).collect::<Vec<_>>()).expect("a volume"),
    }
}

fn form(parts: &[(&str, &[u8])]) -> Vec<u8> {
    let part = |(name, content): &(&str, &[u8])| {
        let head = format!("--{BOUNDARY}\r\ncontent-disposition: form-data; name=\"{name}\"\r\n\r\n");
        [head.as_bytes(), content, b"\r\n"].concat()
    };
    let parts: Vec<u8> = parts.iter().flat_map(part).collect();
    [parts, format!("--{BOUNDARY}--\r\n").into_bytes()].concat()
}

fuzz_target!(|data: &[u8]| {
    let mut draws = Draws(data);
    let planar = draws.byte() % 4 != 1;
    let parameters = if draws.byte() % 2 == 0 {
        let end = draws.0.iter().position(|byte| *byte == 0).unwrap_or(draws.0.len());
        let (text, rest) = draws.0.split_at(end);
        draws.0 = rest;
        text.to_vec()
    } else {
        drawn(&mut draws, planar).to_string().into_bytes()
    };
    let format = *draws.one(&["json", "json", "svg", "png", "nifti"]);
    let with_mask = draws.byte() % 3 == 0;
    let file = image(&mut draws, planar);
    let mut parts: Vec<(&str, &[u8])> = vec![("parameters", &parameters), ("image", &file), ("truth", &file)];
    if with_mask {
        parts.push(("mask", &file));
    }
    let request = Request::post(format!("/v1/segment?format={format}"))
        .header("content-type", format!("multipart/form-data; boundary={BOUNDARY}"))
        .body(Body::from(form(&parts)))
        .expect("a request");
    let (status, headers, answer) = Service::get().send(request);
    let text = String::from_utf8_lossy(&parameters);
    assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{status} {answer:?} for {text}");
    let media_type = content_type(&headers);
    assert_eq!(status.is_client_error(), media_type == "application/problem+json", "{status} for {text}");
    if media_type.ends_with("json") {
        serde_json::from_slice::<serde::de::IgnoredAny>(&answer).expect("the answer is JSON");
    }
});
