//! Segmented objects as pictures and label images.

use reqwest::Method;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use serde_json::{Value, json};
use shapelex_formats::image::write::png_u8;
use shapelex_formats::image::{LengthUnit, Limits, read, read_labels};

use crate::form::{BOUNDARY, form, post_image};
use crate::http_segment::{PATH, PLANE, ball, bright, curves, ellipses, grid, number, values};
use crate::server::{Reply, Server, shared};

const LIMITS: Limits = Limits { bytes: 1 << 24, cells: 1 << 20 };

fn formatted(server: &Server, format: &str, body: &Value, image: &[u8]) -> Reply {
    post_image(server, &format!("{PATH}?{format}"), body, image)
}

fn sphere(further: Value) -> Value {
    let trigonometric = json!({"name": "trigonometric"});
    let mut body = json!({
        "representation": {"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]},
        "terms": [{"name": "contour"}], "boxes": [{"lower": [8, 7, 9], "upper": [20, 18, 23]}]
    });
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    body
}

/// The grey image lies below both outlines; the picture of an anisotropic volume has its proportions.
#[test]
fn results_are_drawn_over_the_image() {
    let server = shared();
    let drawn = formatted(&server, "format=svg", &curves(json!({})), &bright());
    let svg = drawn.expect_svg();
    let image = svg.find("<image ").unwrap();
    assert!(svg.contains("href=\"data:image/png;base64,iVBOR"), "{svg}");
    // One path for each initial shape, then one for each result.
    let paths: Vec<usize> = svg.match_indices("<path d=").map(|(at, _)| at).collect();
    assert_eq!(paths.len(), 4 + 2, "four outlines and two samples of the legend");
    assert!(paths.iter().all(|path| *path > image));
    assert!(svg.contains("initial shape") && svg.contains(">result<"), "{svg}");
    let png = formatted(&server, "format=png&width=320&title=false", &curves(json!({})), &bright());
    assert_eq!((png.status, png.header("content-type")), (200, Some("image/png")));
    let picture = read(&png.body, &LIMITS).unwrap();
    assert_eq!(picture.grid.size()[0], 320);
    // The centre of the first ellipse is bright, the corner between both dark.
    let at = |x: f64, y: f64| {
        let scale = 288.0 / 64.0;
        let [x, y] = [16.0 + scale * (x + 0.5), 10.0 + scale * (y + 0.5)].map(|x| x.round() as usize);
        picture.values[y * 320 + x]
    };
    assert!(at(16.0, 20.0) > 240.0 && at(31.0, 37.0) < 10.0, "{} {}", at(16.0, 20.0), at(31.0, 37.0));
    let [volume, _] = ball();
    let drawn = formatted(&server, "format=svg", &sphere(json!({})), &volume);
    let svg = drawn.expect_svg();
    assert!(svg.contains("<title>Segmentation, slice 1"), "{svg}");
    assert!(svg.matches("M").count() > 40, "the cut of the surface");
}

/// Labels are those of the truth of a clear picture, but for some cells on the edges; masks are the same cells as runs.
#[test]
fn results_are_answered_as_labels() {
    let server = shared();
    let truth: Vec<u32> = values(PLANE, |cell| u32::from(ellipses(cell)));
    let different = |labels: &[u32]| labels.iter().zip(&truth).filter(|(a, b)| a != b).count();
    let png = formatted(&server, "format=png", &curves(json!({"mask": true})), &bright());
    assert_eq!((png.status, png.header("content-type")), (200, Some("image/png")));
    let labels = read_labels(&png.body, &LIMITS).unwrap();
    assert_eq!(labels.grid.size(), PLANE);
    assert!(different(&labels.values) < 30, "{}", different(&labels.values));
    let nifti = formatted(&server, "format=nifti", &curves(json!({})), &bright());
    assert_eq!(nifti.header("content-type"), Some("application/x-nifti"));
    assert_eq!(read_labels(&nifti.body, &LIMITS).unwrap().values, labels.values);
    let parameters = curves(json!({})).to_string();
    let parts: [(&str, &str, &[u8]); 2] =
        [("parameters", "application/json", parameters.as_bytes()), ("image", "image/png", &bright())];
    let request = server.request(Method::POST, PATH).header(ACCEPT, "application/x-nifti");
    let media_type = format!("multipart/form-data; boundary={BOUNDARY}");
    let accepted = server.send(request.header(CONTENT_TYPE, media_type).body(form(&parts)));
    assert_eq!(accepted.body, nifti.body);
    // A volume keeps its positions.
    let [volume, _] = ball();
    let found = formatted(&server, "format=nifti", &sphere(json!({})), &volume);
    let labels = read_labels(&found.body, &LIMITS).unwrap();
    assert_eq!(labels.grid.affine(), read(&volume, &LIMITS).unwrap().grid.affine());
    let count = labels.values.iter().filter(|label| **label == 1).count() as f64;
    let answer = formatted(&server, "format=json", &sphere(json!({"mask": true})), &volume).expect(200);
    let mask = &answer["results"][0]["mask"];
    assert_eq!((&mask["size"], &mask["spacing"]), (&json!([30, 26, 22]), &json!([1.0, 1.0, 1.5])));
    let runs: Vec<f64> = mask["runs"].as_array().unwrap().iter().map(number).collect();
    assert_eq!(runs.iter().sum::<f64>(), 30.0 * 26.0 * 22.0);
    assert_eq!(runs.iter().skip(1).step_by(2).sum::<f64>(), count);
    // Masks are bodies of an overlap as they are.
    let overlap = json!({"first": {"mask": mask}, "second": {"mask": mask}});
    assert_eq!(server.post("/v1/overlap", &overlap).expect(200)["jaccard"], 1.0);
}

#[test]
fn formats_that_do_not_fit_are_refused() {
    let server = shared();
    let refused = |query: &str, body: &Value, image: &[u8], parameter: &str| {
        let problem = formatted(&server, query, body, image).expect_problem(400, "invalid-query", &[]);
        assert_eq!(problem["errors"][0]["parameter"], parameter, "{problem}");
    };
    let [volume, _] = ball();
    refused("format=tiff", &curves(json!({})), &bright(), "format");
    refused("format=svg", &curves(json!({"mask": true})), &bright(), "format");
    refused("format=png", &sphere(json!({"mask": true})), &volume, "format");
    refused("format=nifti&width=320", &curves(json!({})), &bright(), "width");
    // A large image is drawn by blocks of cells.
    let size = [2100, 30, 1];
    let large = values(size, |[x, y, _]| if (x - 900.0).hypot(y - 15.0) < 9.0 { 200 } else { 20 });
    let large = png_u8(&grid(size, [1.0; 3], LengthUnit::Unknown), &large).unwrap();
    let body = curves(json!({
        "boxes": [{"lower": [893, 8], "upper": [907, 22]}],
        "terms": [{"name": "contour", "edges": {"kind": "given", "scale": 40}}]
    }));
    let drawn = formatted(&server, "format=png", &body, &large);
    assert_eq!(drawn.status, 200);
}
