//! Names of shapes from files: the same file sent again adds nothing, other files are other shapes, and the facts that a request gives hold.

use reqwest::Method;
use serde_json::{Value, json};
use shapelex_server::wire::image::write::png_u8;
use shapelex_server::wire::image::{Grid, LengthUnit};

use crate::form::{form, post_form};
use crate::server::{Reply, Server};

fn cohort(server: &Server, name: &str, representation: &Value) -> String {
    let correspondence = if representation["kind"] == "landmarks" { "landmarks" } else { "arc_length" };
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
    format!("/v1/cohorts/{name}/shapes")
}

fn curves(dimension: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": dimension, "control_points": 8, "generator": {"name": "cubic"}})
}

fn post(server: &Server, path: &str, body: impl Into<Vec<u8>>) -> Reply {
    server.post_bytes(path, "application/octet-stream", body)
}

fn patch(server: &Server, path: &str, body: &Value) -> Reply {
    server.send(server.request(Method::PATCH, path).json(body))
}

/// External ids of an answer, in order.
fn names(answer: &Value) -> Vec<&str> {
    answer["results"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["external_id"].as_str().unwrap_or("-"))
        .collect()
}

/// A label image of 20 × 12 cells: squares of label 2 at the left and of label 5 at the right, and single cells of label 2.
fn mask(specks: &[(usize, usize)]) -> Vec<u8> {
    let value = |x: usize, y: usize| match (x, y) {
        (3..=7, 3..=7) => 2,
        (12..=17, 3..=8) => 5,
        at if specks.contains(&at) => 2,
        _ => 0,
    };
    let values: Vec<u8> = (0..12).flat_map(|y| (0..20).map(move |x| value(x, y))).collect();
    let grid = Grid::along_axes([20, 12, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
    png_u8(&grid, &values).unwrap()
}

/// A feature with a name, a triangle whose third point is at `x`.
fn feature(name: &str, x: u32) -> String {
    format!(
        r#"{{"type":"Feature","properties":{{"name":"{name}"}},"geometry":{{"type":"Polygon","coordinates":[[[0,0],[9,0],[{x},5],[0,0]]]}}}}"#
    )
}

#[test]
fn shapes_of_files_are_told_apart_by_the_names_of_the_files() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(2));
    let first = post(&server, &format!("{shapes}?name=scans/one.ome.tif.png"), mask(&[])).expect(201);
    assert_eq!(names(&first), ["one.ome.tif/2", "one.ome.tif/5"]);
    let second =
        post(&server, &format!("{shapes}?name=two.png&subject=p-2&label=treated"), mask(&[])).expect(201);
    assert_eq!((names(&second), &second["added"]), (vec!["two/2", "two/5"], &json!(2)));
    let plain = post(&server, &format!("{shapes}?prefix="), mask(&[])).expect(201);
    assert_eq!(names(&plain), ["2", "5"]);
    let shape = server.get(&format!("{shapes}/two/2")).expect(200);
    assert_eq!((&shape["labels"]["file"], &shape["subject"]), (&json!("two"), &json!("p-2")));
    assert_eq!(shape["label"], "treated");
    // The nightly run again: nothing is added, and nothing is a conflict.
    for name in ["scans/one.ome.tif.png", "two.png"] {
        let again = post(&server, &format!("{shapes}?name={name}"), mask(&[])).expect(201);
        assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(2)), "{name}");
    }
    assert_eq!(server.get("/v1/cohorts/cells").expect(200)["revision"], 3);
}

#[test]
fn a_speck_adds_itself_only_and_its_loss_nothing() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(2));
    let options = "name=m.png&on_error=skip";
    let first = post(&server, &format!("{shapes}?{options}"), mask(&[(0, 0), (19, 11)])).expect(201);
    assert!(names(&first).starts_with(&["m/2.1", "m/2"]) || names(&first).contains(&"m/2"), "{first}");
    for specks in [vec![(19, 11)], vec![]] {
        let again = post(&server, &format!("{shapes}?{options}"), mask(&specks)).expect(201);
        assert_eq!(again["added"], 0, "{again}");
    }
    let kept = server.get("/v1/cohorts/cells").expect(200);
    assert_eq!(kept["revision"], 1);
}

#[test]
fn a_corrected_shape_is_no_conflict_and_keeps_its_correction() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(2));
    let file = format!("[{},{}]", feature("a", 3), feature("b", 4));
    post(&server, &format!("{shapes}?name=f.geojson"), file.clone()).expect(201);
    patch(&server, &format!("{shapes}/f/a"), &json!({"subject": "p", "labels": {"side": "left"}}))
        .expect(200);
    patch(&server, &shapes, &json!({"ids": ["f/a", "f/b"], "changes": {"label": "treated"}})).expect(200);
    let again = post(&server, &format!("{shapes}?name=f.geojson"), file).expect(201);
    assert_eq!((&again["added"], &again["unchanged"], &again["revision"]), (&json!(0), &json!(2), &json!(3)));
    assert!(again["warnings"].to_string().contains("2 shapes stand in the cohort"), "{again}");
    let shape = server.get(&format!("{shapes}/f%2Fa")).expect(200);
    assert_eq!((&shape["label"], &shape["labels"]["side"]), (&json!("treated"), &json!("left")));
    // Other points are a conflict, which may be skipped.
    let moved = format!("[{},{},{}]", feature("a", 7), feature("b", 4), feature("c", 5));
    let problem = post(&server, &format!("{shapes}?name=f.geojson"), moved.clone());
    let problem = problem.expect_problem(409, "external-id-conflict", &["/external_id"]);
    assert_eq!(problem["errors"][0]["index"], 0);
    let rest = post(&server, &format!("{shapes}?name=f.geojson&on_error=skip"), moved).expect(201);
    assert_eq!((&rest["added"], &rest["unchanged"], &rest["skipped"]), (&json!(1), &json!(1), &json!(1)));
    let entry = &rest["results"][0];
    assert_eq!((&entry["external_id"], &entry["id"]), (&json!("f/a"), &Value::Null), "{entry}");
    assert!(entry["error"]["detail"].to_string().contains("'f/a'"), "{entry}");
    assert_eq!(rest["results"][2]["external_id"], "f/c");
}

#[test]
fn equal_names_get_numbers_and_every_format_has_the_option() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(2));
    let file = format!("[{},{},{}]", feature("cell", 3), feature("cell", 4), feature("nucleus", 5));
    let found = post(&server, &format!("{shapes}?name=f.geojson"), file.clone()).expect(201);
    assert_eq!(names(&found), ["f/cell", "f/cell~2", "f/nucleus"]);
    let again = post(&server, &format!("{shapes}?name=f.geojson"), file.clone()).expect(201);
    assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(3)));
    let numbered = post(&server, &format!("{shapes}?name=g.geojson&names=number"), file).expect(201);
    assert_eq!(names(&numbered), ["g/1", "g/2", "g/3"]);
    assert_eq!(server.get(&format!("{shapes}/g/1")).expect(200)["metadata"]["name"], "cell");
    let numbered = post(&server, &format!("{shapes}?name=m.png&names=number"), mask(&[])).expect(201);
    assert_eq!(names(&numbered), ["m/1", "m/2"]);
    // Identities that a table gives stay, and are no prefix's.
    let table = "id,closed,x1,y1,x2,y2,x3,y3\na,true,0,0,9,0,3,5\na,true,0,0,9,0,4,5\n";
    let refused = post(&server, &format!("{shapes}?name=t.csv"), table);
    let refused = refused.expect_problem(409, "external-id-conflict", &["/external_id"]);
    assert!(refused.to_string().contains("names=number"), "{refused}");
    let found = post(&server, &format!("{shapes}?name=t.csv&on_error=skip"), table).expect(201);
    assert_eq!((names(&found), &found["skipped"]), (vec!["a", "a"], &json!(1)));
    let found = post(&server, &format!("{shapes}?name=t.csv&names=number"), table).expect(201);
    assert_eq!(names(&found), ["t/1", "t/2"]);
}

#[test]
fn a_mesh_is_named_as_its_file() {
    let server = Server::fresh();
    let body = json!({"kind": "landmarks", "dimension": 3, "points": 3});
    let shapes = cohort(&server, "atria", &body);
    let mesh = "OFF\n3 1 0\n0 0 0\n4 0 0\n4 1 0\n3 0 1 2\n";
    let found = post(&server, &format!("{shapes}?name=LA_01.off"), mesh).expect(201);
    assert_eq!(names(&found), ["LA_01"]);
    let again = post(&server, &format!("{shapes}?name=LA_01.off"), mesh).expect(201);
    assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(1)));
    let other = post(&server, &format!("{shapes}?name=LA_02.off"), mesh).expect(201);
    assert_eq!((names(&other), &other["added"]), (vec!["LA_02"], &json!(1)));
}

#[test]
fn facts_of_a_request_are_checked_before_the_file() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(2));
    let parameter = |query: &str| {
        let problem = post(&server, &format!("{shapes}?name=m.png&{query}"), mask(&[])).expect(400);
        problem["errors"][0]["parameter"].as_str().unwrap().to_owned()
    };
    assert_eq!(parameter("weight=heavy"), "weight");
    assert_eq!(parameter("weight=-1"), "weight");
    assert_eq!(parameter("subject="), "subject");
    assert_eq!(parameter("labels.a=1&labels[a]=2"), "labels[a]");
    assert_eq!(parameter("subject_from=Name"), "subject_from");
    assert_eq!(parameter("subject_from=PatientID"), "subject_from");
    let found = post(
        &server,
        &format!("{shapes}?name=m.png&labels.site=zrh&labels[dose]=3&labels[code]=%22007%22&weight=2"),
        mask(&[]),
    );
    let id = found.expect(201)["results"][0]["id"].as_str().unwrap().to_owned();
    let shape = server.get(&format!("{shapes}/{id}")).expect(200);
    let labels = &shape["labels"];
    assert_eq!(
        (&labels["site"], &labels["dose"], &labels["code"]),
        (&json!("zrh"), &json!(3), &json!("007"))
    );
    assert_eq!(shape["weight"], 2.0);
}

/// A structure set with two contours of a region, of a patient.
pub(crate) fn structure_set(server: &Server, patient: &str) -> Vec<u8> {
    let line = |name: &str, z: u32| {
        format!(
            r#"{{"points":[[1.5,2,{z}],[9,2,{z}],[9,7.25,{z}]],"closed":true,"external_id":"{name}","label":"Heart"}}"#
        )
    };
    let lines = format!("{}\n{}\n", line("Heart 1", 5), line("Heart 2", 10));
    let image = |k: u32| {
        json!({
            "class": "1.2.840.10008.5.1.4.1.1.2", "instance": format!("1.2.3.{k}"), "series": "1.2.6",
            "frame_of_reference": "1.2.4", "position": [-100.0, -100.0, 5.0 * f64::from(k)],
            "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "study": {"instance": "1.2.5"}, "patient": {"id": patient},
        })
    };
    let parameters = json!({"series": (0..3).map(image).collect::<Vec<_>>()}).to_string();
    let parts: [(&str, &str, &[u8]); 2] = [
        ("parameters", "application/json", parameters.as_bytes()),
        ("file", "application/x-ndjson", lines.as_bytes()),
    ];
    let file = post_form(server, "/v1/convert?to=rtstruct&format=ndjson", form(&parts));
    assert_eq!(file.status, 200, "{}", file.text());
    file.body
}

#[test]
fn dicom_is_named_by_its_identifiers_and_a_patient_is_one_subject() {
    let server = Server::fresh();
    let shapes = cohort(&server, "hearts", &curves(3));
    let file = structure_set(&server, "P-17");
    let options = "name=any.dcm&subject_from=PatientID";
    let first = post(&server, &format!("{shapes}?{options}"), file.clone()).expect(201);
    let found: Vec<String> = names(&first).into_iter().map(str::to_owned).collect();
    let (instance, rest) = found[0].split_once('/').unwrap();
    assert!(instance.contains('.') && rest == "1/1" && found[1] == format!("{instance}/1/2"), "{found:?}");
    let shape = server.get(&format!("{shapes}/{}", found[1])).expect(200);
    let subject = shape["subject"].as_str().unwrap().to_owned();
    assert!(subject.starts_with("sub_") && subject.len() == 30 && !subject.contains("P-17"), "{subject}");
    assert_eq!(shape["label"], "Heart");
    // Where it comes from: the numbers that lead back to the archive.
    let expected = json!({
        "sop_instance": instance, "study": "1.2.5", "frame_of_reference": "1.2.4", "modality": "CT",
        "image": "1.2.3.2", "image_series": "1.2.6", "region_number": 1, "contour_number": 2,
    });
    for (name, value) in expected.as_object().unwrap() {
        assert_eq!(&shape["labels"][name], value, "{name}: {shape}");
    }
    // Under another name it is the same; of another patient it is another subject.
    let again =
        post(&server, &format!("{shapes}?name=b.dcm&subject_from=PatientID"), file.clone()).expect(201);
    assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(2)));
    let same = server.get(&format!("{shapes}?subject={subject}")).expect(200);
    assert_eq!(same["items"].as_array().unwrap().len(), 2);
    let named = post(&server, &format!("{shapes}?name=c.dcm&names=name"), file.clone()).expect(201);
    assert_eq!(names(&named), ["c/Heart 1", "c/Heart 2"]);
    // All shapes go out again.
    let back = server.get("/v1/cohorts/hearts/export?format=ndjson");
    assert_eq!(back.text().lines().count(), 4);
    // A wrong number of points of a contour.
    let at = file.windows(8).rposition(|bytes| bytes == b"\x06\x30\x46\x00\x02\x00\x00\x00").unwrap() + 8;
    let mut broken = structure_set(&server, "P-18");
    assert_eq!(&broken[at..at + 2], b"3 ");
    broken[at] = b'9';
    let refused = post(&server, &format!("{shapes}?name=d.dcm&prefix=d/"), broken.clone());
    refused.expect_problem(422, "invalid-input", &[""]);
    let skipping = "name=d.dcm&prefix=d/&on_error=skip&subject_from=PatientID";
    let kept = post(&server, &format!("{shapes}?{skipping}"), broken);
    let kept = kept.expect(201);
    assert_eq!(kept["added"], 1, "{kept}");
    let left = &kept["file"]["left_out"];
    let is_broken = |entry: &&Value| entry["what"] == "broken shapes" && entry["count"] == 1;
    assert!(left.as_array().unwrap().iter().any(|entry| is_broken(&entry)), "{left}");
    let id = kept["results"][0]["id"].as_str().unwrap();
    let other = server.get(&format!("{shapes}/{id}")).expect(200);
    assert_ne!(other["subject"], json!(subject));
}
