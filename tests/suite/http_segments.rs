//! Segmentations and archives of label images on every route: overlapping segments, where shapes come from, photographs.

use serde_json::{Value, json};
use shapelex_formats::image::write::png_u8;
use shapelex_formats::image::{Grid, LengthUnit};

use crate::announced::archive;
use crate::form::{form, label_picture, post_form, post_image};
use crate::http_segment::{curves, post_files};
use crate::segments::{SIZE, Segments, disc};
use crate::server::{Reply, Server, shared};

const ANY: &str = "application/octet-stream";

fn cohort(server: &Server) -> &'static str {
    let representation = curves(json!({}))["representation"].clone();
    let body = json!({"name": "cells", "representation": representation, "correspondence": "arc_length"});
    server.post("/v1/cohorts", &body).expect(201);
    "/v1/cohorts/cells/shapes"
}

/// Two discs that overlap, and one beside them.
fn overlapping() -> Vec<u8> {
    let cells: [&dyn Fn(i64, i64) -> bool; 3] = [&disc(10, 10, 6), &disc(14, 10, 6), &disc(30, 14, 5)];
    Segments { instance: "1.2.8.1", patient: "P-1", cells: &cells }.file()
}

/// A picture of the size of the segmentation, in which each cell has its own grey value.
fn photograph() -> Vec<u8> {
    let values: Vec<u8> = (0..SIZE[0] * SIZE[1]).map(|cell| (cell * 37 % 251) as u8).collect();
    png_u8(&picture_grid(), &values).unwrap()
}

fn picture_grid() -> Grid {
    let [columns, rows] = SIZE.map(|side| side as usize);
    Grid::along_axes([columns, rows, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap()
}

fn numbers(answer: &Value, field: &str) -> Vec<u64> {
    answer["results"].as_array().unwrap().iter().map(|one| one[field].as_u64().unwrap()).collect()
}

#[test]
fn shapes_of_segmentations_say_where_they_come_from() {
    let server = Server::fresh();
    let shapes = cohort(&server);
    let stored = server.post_bytes(&format!("{shapes}?name=any.dcm"), ANY, overlapping()).expect(201);
    assert_eq!(stored["added"], 3, "{stored}");
    let shape = server.get(&format!("{shapes}/1.2.8.1/2/1")).expect(200);
    let expected = json!({
        "sop_instance": "1.2.8.1", "series": "1.2.7", "study": "1.2.5", "frame_of_reference": "1.2.4",
        "modality": "CT", "image_series": "1.2.6", "body_part": "CHEST", "property": "SCT:80891002",
        "region_number": 2, "contour_number": 1,
    });
    for (name, value) in expected.as_object().unwrap() {
        assert_eq!(&shape["labels"][name], value, "{name}: {shape}");
    }
    let selected = server.get(&format!("{shapes}?labels.property=SCT:80891003")).expect(200);
    assert_eq!(selected["items"].as_array().unwrap().len(), 1);
    // What identifies a person is named, and not stored.
    let left: Vec<_> = stored["file"]["left_out"].as_array().unwrap().iter().collect();
    let of_persons =
        left.iter().find(|left| left["what"] == "identifying elements").expect("they are counted");
    for name in ["PatientName", "PatientID", "InstitutionName", "SegmentDescription"] {
        assert!(of_persons["names"].as_array().unwrap().contains(&json!(name)), "{of_persons}");
    }
    let all = server.get("/v1/cohorts/cells/export?format=ndjson").text().to_owned();
    assert!(!all.to_lowercase().contains("secret") && !all.contains("P-1\""), "{all}");
}

#[test]
fn contours_and_uploads_take_overlapping_segments_one_by_one() {
    let server = shared();
    let answer = post_image(&server, "/v1/contours", &json!({}), &overlapping()).expect(200);
    assert_eq!(numbers(&answer, "label"), [1, 2, 3]);
    let whole = numbers(&answer, "cells");
    assert_eq!(whole[0], whole[1], "each segment has all of its cells");
    let some = post_image(&server, "/v1/contours", &json!({"labels": [2]}), &overlapping()).expect(200);
    assert_eq!(numbers(&some, "cells"), [whole[1]]);
    let none = post_image(&server, "/v1/contours", &json!({"labels": [9]}), &overlapping());
    none.expect_problem(422, "invalid-input", &["/labels"]);
    let lines = server.post_bytes("/v1/convert?to=ndjson&name=s.dcm&select=2", ANY, overlapping());
    assert_eq!((lines.status, lines.text().lines().count()), (200, 1), "{}", lines.text());
}

#[test]
fn overlapping_segments_begin_objects_of_a_segmentation() {
    let server = shared();
    let image = png_u8(&picture_grid(), &brightness()).unwrap();
    let mut body = curves(json!({}));
    body.as_object_mut().unwrap().remove("boxes");
    let answer =
        post_files(&server, "/v1/segment", &body, &[("image", &image), ("mask", &overlapping())]).expect(200);
    assert_eq!(answer["results"].as_array().unwrap().len(), 3, "{answer}");
    body["mask_labels"] = json!([2]);
    let one =
        post_files(&server, "/v1/segment", &body, &[("image", &image), ("mask", &overlapping())]).expect(200);
    assert_eq!(one["results"].as_array().unwrap().len(), 1);
    // Where one label a cell is needed, they are refused.
    let boxed = curves(json!({"boxes": [{"lower": [4, 4], "upper": [20, 16]}]}));
    let files: [(&str, &[u8]); 2] = [("image", &image), ("truth", &overlapping())];
    post_files(&server, "/v1/segment", &boxed, &files).expect_problem(422, "invalid-input", &["/truth"]);
}

/// Grey values of bright discs where the segments are.
fn brightness() -> Vec<u8> {
    let inside = [disc(10, 10, 6), disc(14, 10, 6), disc(30, 14, 5)];
    let cells = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y)));
    cells.map(|(x, y)| if inside.iter().any(|of| of(x, y)) { 200 } else { 40 }).collect()
}

fn detail(problem: &Value) -> String {
    problem["errors"][0]["detail"].to_string()
}

#[test]
fn photographs_are_refused_as_masks_on_every_route() {
    let server = Server::fresh();
    let shapes = cohort(&server);
    let expected = "expected a label image, where each object is a region of one number";
    let refused = |reply: Reply, pointer: &str| {
        let problem = reply.expect_problem(422, "invalid-input", &[pointer]);
        assert!(detail(&problem).contains(expected), "{problem}");
        problem
    };
    refused(server.post_bytes(&format!("{shapes}?name=a.png"), ANY, photograph()), "");
    refused(post_image(&server, "/v1/contours", &json!({}), &photograph()), "/image");
    let mut body = curves(json!({}));
    body.as_object_mut().unwrap().remove("boxes");
    let image = png_u8(&picture_grid(), &brightness()).unwrap();
    let files: [(&str, &[u8]); 2] = [("image", &image), ("mask", &photograph())];
    let mask = refused(post_files(&server, "/v1/segment", &body, &files), "/mask");
    assert!(!detail(&mask).contains("photograph=read"), "a mask has no such option: {mask}");
    // In an archive by its name, and beside other files it costs itself.
    let packed = archive(&[("a.png", &label_picture()), ("day/b.png", &photograph())], None, &[]);
    let problem = refused(server.post_bytes(&format!("{shapes}?name=plate.zip"), ANY, packed.clone()), "");
    assert!(problem.to_string().contains("day/b.png"), "{problem}");
    let some = server.post_bytes(&format!("{shapes}?name=plate.zip&on_error=skip"), ANY, packed).expect(201);
    assert_eq!(some["added"], 3, "{some}");
    assert_eq!(server.get("/v1/cohorts/cells").expect(200)["shape_count"], 3);
}

#[test]
fn label_images_in_archives_are_named_after_their_files() {
    let server = Server::fresh();
    let shapes = cohort(&server);
    let line = b"{\"external_id\":\"one\",\"points\":[[0,0],[9,0],[9,7],[0,7]],\"closed\":true}\n";
    let volume = picture(2);
    let packed = archive(
        &[
            ("day/a.png", &label_picture()),
            ("b.nii", &volume),
            ("lines.ndjson", line),
            ("seg.dcm", &overlapping()),
        ],
        None,
        &[],
    );
    let stored =
        server.post_bytes(&format!("{shapes}?name=plate.zip&unit=pixel"), ANY, packed.clone()).expect(201);
    let mut names: Vec<&str> =
        stored["results"].as_array().unwrap().iter().filter_map(|one| one["external_id"].as_str()).collect();
    names.sort_unstable();
    let expected = [
        "1.2.8.1/1/1",
        "1.2.8.1/2/1",
        "1.2.8.1/3/1",
        "one",
        "plate/a/3",
        "plate/a/7",
        "plate/a/7.1",
        "plate/b/2",
    ];
    assert_eq!(names, expected, "{stored}");
    let shape = server.get(&format!("{shapes}/plate/a/3")).expect(200);
    assert_eq!((&shape["labels"]["file"], &shape["labels"]["label"]), (&json!("a"), &json!(3)), "{shape}");
    let again = server.post_bytes(&format!("{shapes}?name=plate.zip&unit=pixel"), ANY, packed).expect(201);
    assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(8)), "{again}");
    // Options are those of images, and refuse an archive of other files.
    let images = archive(&[("a.png", &label_picture()), ("b.nii", &volume)], None, &[]);
    let largest = "/v1/convert?to=ndjson&name=p.zip&largest=true&select=7";
    let lines = server.post_bytes(largest, ANY, images);
    assert_eq!((lines.status, lines.text().lines().count()), (200, 1), "{}", lines.text());
    let mixed = archive(&[("a.png", &label_picture()), ("lines.ndjson", line)], None, &[]);
    let refused = server.post_bytes("/v1/convert?to=ndjson&name=p.zip&largest=true", ANY, mixed);
    assert!(refused.status == 400 || refused.status == 422, "{}", refused.text());
}

/// One layer of a volume with a square of a label.
fn picture(label: u8) -> Vec<u8> {
    let inside = |x: i64, y: i64| (5..15).contains(&x) && (6..13).contains(&y);
    let cells = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y)));
    let values: Vec<u8> = cells.map(|(x, y)| u8::from(inside(x, y)) * label).collect();
    shapelex_formats::image::write::nifti_u8(&picture_grid(), &values).unwrap()
}

#[test]
fn cells_of_label_images_of_an_archive_are_bounded_together() {
    // Few bytes, and four million cells each.
    let grid = Grid::along_axes([2000, 2000, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
    let empty = png_u8(&grid, &vec![0; grid.cells()]).unwrap();
    let names: Vec<String> = (0..8).map(|k| format!("{k}.png")).collect();
    let files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &*empty)).collect();
    let server = crate::server::Setting::fresh().flags(&["--max-voxels", "4000000"]).start();
    let reply = server.post_bytes("/v1/inspect?name=p.zip", ANY, archive(&files, None, &[]));
    assert!(reply.status == 413 || reply.status == 422, "{}", reply.text());
    assert!(reply.text().contains("cells of label images"), "{}", reply.text());
    server.post_bytes("/v1/inspect?name=p.zip", ANY, archive(&files[..1], None, &[])).expect(200);
}

#[test]
fn segmented_objects_of_dicom_say_where_they_come_from() {
    let server = Server::fresh();
    cohort(&server);
    let body = curves(json!({"boxes": [{"lower": [-6.0, -16.0], "upper": [6.0, -4.0]}]})).to_string();
    let cells: [&dyn Fn(i64, i64) -> bool; 1] = [&disc(10, 10, 6)];
    let image = Segments { instance: "1.2.8.2", patient: "P-1", cells: &cells }.file();
    let parts: [(&str, &str, &[u8]); 2] =
        [("parameters", "application/json", body.as_bytes()), ("image", ANY, &image)];
    let answer = post_form(&server, "/v1/cohorts/cells/segment", form(&parts)).expect(201);
    let id = answer["results"][0]["id"].as_str().unwrap_or_else(|| panic!("{answer}"));
    let shape = server.get(&format!("/v1/cohorts/cells/shapes/{id}")).expect(200);
    let labels = ["sop_instance", "series", "study", "frame_of_reference", "modality"];
    let found = labels.map(|name| shape["labels"][name].as_str().unwrap_or("none").to_owned());
    assert_eq!(found, ["1.2.8.2", "1.2.7", "1.2.5", "1.2.4", "CT"], "{shape}");
}
