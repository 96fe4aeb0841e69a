//! Where segmented objects begin: around seed points, at the components of a mask, at an earlier answer, in a slice of a volume.

use serde_json::{Value, json};
use shapelex_formats::image::LengthUnit;
use shapelex_formats::image::write::{nifti_f32, nifti_u8, png_u8};

use crate::form::post_image;
use crate::http_segment::{
    PATH, PLANE, ball, bright, curves, ellipses, grid, number, picture, post_files, values,
};
use crate::server::shared;

/// Parameters without boxes.
fn without_boxes(further: Value) -> Value {
    let mut body = curves(further);
    body.as_object_mut().unwrap().remove("boxes");
    body
}

#[test]
fn seeds_begin_in_the_squares_around_them() {
    let (server, image, truth) = (shared(), bright(), picture(|label| label));
    let seeds = json!([{"at": [16, 20], "radius": 5.5}, {"at": [46, 18]}]);
    let seeds = without_boxes(json!({"seeds": seeds, "truth_labels": [1, 2]}));
    let found =
        post_files(&server, PATH, &seeds, &[("image", &image), ("truth", &truth)]).expect(200)["results"]
            .clone();
    for index in 0..2 {
        let jaccard = number(&found[index]["overlap"]["jaccard"]);
        assert!(jaccard > 0.93, "{index}: {jaccard}");
    }
    // A tenth of the height of 40 cells is the least radius, four cells.
    let boxes =
        json!([{"lower": [10.5, 14.5], "upper": [21.5, 25.5]}, {"lower": [42, 14], "upper": [50, 22]}]);
    let boxes =
        post_image(&server, PATH, &curves(json!({"boxes": boxes, "leave_box": true})), &image).expect(200);
    for index in 0..2 {
        assert_eq!(found[index]["control_points"], boxes["results"][index]["control_points"]);
    }
    // In space, and in millimetres: the shortest side has 26 of them, a cell 1.5^(1/3).
    let [image, truth] = ball();
    let trigonometric = json!({"name": "trigonometric"});
    let sphere = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 6], "generators": [trigonometric, trigonometric]});
    let body =
        json!({"representation": sphere, "terms": [{"name": "contour"}], "seeds": [{"at": [14, 12, 15.75]}]});
    let found = post_files(&server, PATH, &body, &[("image", &image), ("truth", &truth)]).expect(200);
    let jaccard = number(&found["results"][0]["overlap"]["jaccard"]);
    assert!(jaccard > 0.9, "{jaccard}");
}

/// Contours of the components are the initial shapes: without iterations they are answered.
#[test]
fn components_of_a_mask_begin_objects() {
    let (server, image, truth) = (shared(), bright(), picture(|label| label));
    let ask = |further: Value, mask: &[u8]| {
        let files: [(&str, &[u8]); 3] = [("image", &image), ("truth", &truth), ("mask", mask)];
        post_files(&server, PATH, &without_boxes(further), &files)
    };
    let still = json!([{"sigma": 1, "iterations": 0}]);
    let found = ask(json!({"stages": still, "truth_labels": [2, 1]}), &truth).expect(200)["results"].clone();
    // The second object has the upper first cell.
    for (index, label) in [2, 1].into_iter().enumerate() {
        let result = &found[index];
        let component = &result["component"];
        assert_eq!((&component["label"], &component["component"]), (&json!(label), &json!(0)));
        let expected = values(PLANE, ellipses).into_iter().filter(|found| *found == label).count();
        assert_eq!(component["cells"], json!(expected));
        let jaccard = number(&result["overlap"]["jaccard"]);
        assert!(jaccard > 0.94, "{label}: {jaccard}");
    }
    let moved = ask(json!({"truth_labels": [1], "mask_labels": [1]}), &truth).expect(200)["results"].clone();
    assert_eq!(moved.as_array().unwrap().len(), 1);
    assert!(number(&moved[0]["overlap"]["jaccard"]) > 0.93, "{moved}");
    // A hole is named, small components are left out.
    let holed = |[x, y, _]: [f64; 3]| {
        let hole = (x - 16.0).abs() < 2.0 && (y - 20.0).abs() < 2.0;
        let speck = x == 60.0 && y == 36.0;
        u8::from(speck || (ellipses([x, y, 0.0]) == 1 && !hole))
    };
    let mask = png_u8(&grid(PLANE, [1.0; 3], LengthUnit::Unknown), &values(PLANE, holed)).unwrap();
    let found = ask(json!({"stages": still, "mask_least_cells": 2}), &mask).expect(200)["results"].clone();
    assert_eq!(found.as_array().unwrap().len(), 1);
    assert!(found[0]["warnings"].to_string().contains("holes of its component (1)"), "{found}");
    let [image, truth] = ball();
    let mesh = json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron/1", "level": 3});
    let body = json!({"representation": mesh, "terms": [{"name": "contour"}]});
    let files: [(&str, &[u8]); 3] = [("image", &image), ("truth", &truth), ("mask", &truth)];
    let found = post_files(&server, PATH, &body, &files).expect(200)["results"].clone();
    let jaccard = number(&found[0]["overlap"]["jaccard"]);
    assert!(jaccard > 0.9 && found[0]["component"]["label"] == 1, "{found}");
}

/// A slice is an image, and the result of one slice begins the next one.
#[test]
fn slices_of_a_volume_are_images() {
    let server = shared();
    let size = [PLANE[0], PLANE[1], 3];
    let stack = |bright: f32| {
        let shifted = |[x, y, z]: [f64; 3]| ellipses([x - (z - 1.0), y, 0.0]) > 0;
        values(size, |cell| if shifted(cell) { bright } else { 40.0 })
    };
    let grid = grid(size, [1.0, 1.0, 4.0], LengthUnit::Millimetre);
    let volume = nifti_f32(&grid, &stack(200.0)).unwrap();
    let labels: Vec<u8> = stack(1.0).into_iter().map(|value| u8::from(value == 1.0)).collect();
    let labels = nifti_u8(&grid, &labels).unwrap();
    let one = json!([{"lower": [40, 10], "upper": [53, 27]}]);
    let flat =
        post_image(&server, PATH, &curves(json!({"boxes": one, "leave_box": true})), &bright()).expect(200);
    let sliced =
        post_image(&server, PATH, &curves(json!({"boxes": one, "slice": 1, "leave_box": true})), &volume)
            .expect(200);
    assert_eq!(flat["results"][0]["control_points"], sliced["results"][0]["control_points"]);
    assert_eq!(sliced["image"]["size"], json!([64, 40]));
    let shapes = json!([{"control_points": sliced["results"][0]["control_points"]}]);
    let next = without_boxes(json!({"shapes": shapes, "slice": 2}));
    let next = post_image(&server, PATH, &next, &volume).expect(200);
    let x = |answer: &Value| {
        let points = answer["results"][0]["control_points"].as_array().unwrap().clone();
        points.iter().map(|point| number(&point[0])).sum::<f64>() / points.len() as f64
    };
    let moved = x(&next) - x(&sliced);
    assert!((moved - 1.0).abs() < 0.05, "{moved}");
    // Masks and truths are sliced too; a mask of the slice itself is as good.
    let both = without_boxes(json!({"slice": 1, "mask_labels": [1]}));
    let files: [(&str, &[u8]); 3] = [("image", &volume), ("mask", &labels), ("truth", &labels)];
    let found = post_files(&server, PATH, &both, &files).expect(200)["results"].clone();
    assert_eq!(found.as_array().unwrap().len(), 2);
    let mask = picture(|label| u8::from(label > 0));
    let files: [(&str, &[u8]); 2] = [("image", &volume), ("mask", &mask)];
    let same = post_files(&server, PATH, &both, &files).expect(200)["results"].clone();
    assert_eq!(found[0]["control_points"], same[0]["control_points"]);
    let contours = |slice: Value| post_image(&server, "/v1/contours", &json!({"slice": slice}), &labels);
    assert_eq!(contours(json!(1)).expect(200)["results"].as_array().unwrap().len(), 2);
    assert!(contours(json!(0)).expect(200)["results"][0]["points"].is_array());
    contours(json!(3)).expect_problem(422, "invalid-input", &["/slice"]);
    let beyond = curves(json!({"slice": 3}));
    post_image(&server, PATH, &beyond, &volume).expect_problem(422, "invalid-input", &["/slice"]);
}

/// What is not defined is null: a shape that fills more than the image leaves no outside.
#[test]
fn terms_that_are_not_defined_are_null() {
    let body = without_boxes(json!({
        "seeds": [{"at": [32, 20], "radius": 60}], "terms": [{"name": "two_class"}], "history": true,
        "stages": [{"sigma": 1, "iterations": 1}]
    }));
    let found = post_image(&shared(), PATH, &body, &bright()).expect(200)["results"][0].clone();
    assert_eq!(found["energies"]["two_class"], json!({"value": null, "weighted": null}), "{found}");
    assert_eq!(found["stages"][0]["history"], Value::Null, "{found}");
}

#[test]
fn bad_starts_are_refused_at_their_place() {
    let (server, image) = (shared(), bright());
    let refused = |body: Value, pointers: &[&str]| {
        post_image(&server, PATH, &body, &image).expect_problem(422, "invalid-input", pointers);
    };
    refused(without_boxes(json!({})), &["/shapes"]);
    refused(curves(json!({"seeds": [{"at": [16, 20]}]})), &["/seeds"]);
    for (seed, pointer) in [
        (json!({"at": [16]}), "/seeds/0/at"),
        (json!({"at": [16, 1e101]}), "/seeds/0/at/1"),
        (json!({"at": [16, 20], "radius": 0}), "/seeds/0/radius"),
    ] {
        refused(without_boxes(json!({"seeds": [seed]})), &[pointer]);
    }
    refused(without_boxes(json!({"seeds": []})), &["/seeds"]);
    // Boundaries that are much larger than the image would take as many samples.
    refused(without_boxes(json!({"seeds": [{"at": [16, 20], "radius": 65}]})), &["/seeds/0"]);
    refused(curves(json!({"boxes": [{"lower": [-1e90, 0], "upper": [1e90, 20]}]})), &["/boxes/0"]);
    refused(curves(json!({"mask_labels": [1]})), &["/mask_labels"]);
    let with_mask = |further: Value, mask: &[u8], pointers: &[&str]| {
        let files: [(&str, &[u8]); 2] = [("image", &image), ("mask", mask)];
        post_files(&server, PATH, &without_boxes(further), &files).expect_problem(
            422,
            "invalid-input",
            pointers,
        );
    };
    let mask = picture(|label| label);
    with_mask(json!({"mask_labels": [9]}), &mask, &["/mask_labels"]);
    with_mask(json!({"seeds": [{"at": [16, 20]}]}), &mask, &["/mask"]);
    with_mask(json!({}), &picture(|_| 0), &["/mask"]);
    with_mask(json!({}), &mask[..50], &["/mask"]);
    let small = png_u8(&grid([40, 64, 1], [1.0; 3], LengthUnit::Unknown), &[1; 64 * 40]).unwrap();
    with_mask(json!({}), &small, &["/mask"]);
}
