//! Whole numbers among attributes: exact to 2⁵³, refused or texts beyond, and the same shape when a file of them comes back.

use std::collections::BTreeMap;

use reqwest::Method;
use serde_json::json;

use crate::server::Server;

const POINTS: &str = r#"[[0,0],[4,0],[4,1]]"#;

fn cohort(server: &Server, name: &str) -> String {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
    format!("/v1/cohorts/{name}")
}

fn lines(labels: &[&str]) -> String {
    let line = |(k, labels): (usize, &&str)| {
        format!("{{\"points\":{POINTS},\"external_id\":\"s{k}\",\"labels\":{{{labels}}}}}\n")
    };
    labels.iter().enumerate().map(line).collect()
}

#[test]
fn whole_numbers_that_doubles_do_not_hold_are_refused() {
    let server = Server::fresh();
    let path = cohort(&server, "c");
    let post = |labels: &str, media_type: &str| {
        let body = match media_type {
            "application/json" => format!(r#"{{"shapes":[{{"points":{POINTS},"labels":{{{labels}}}}}]}}"#),
            _ => lines(&[labels]),
        };
        server.post_bytes(&format!("{path}/shapes"), media_type, body)
    };
    for number in [
        "9007199254740992",
        "9007199254740993",
        "-9007199254740993",
        "18446744073709551615",
        "123456789012345678901",
    ] {
        for media_type in ["application/json", "application/x-ndjson"] {
            let refused = post(&format!(r#""a":"\"7","pid":{number}"#), media_type).expect(422);
            assert!(refused.to_string().contains(number), "{refused}");
            assert!(refused["errors"][0]["pointer"].as_str().unwrap().contains("/labels"), "{refused}");
        }
        let request = server.request(Method::PATCH, &format!("{path}/shapes/s0"));
        let request = request.header("content-type", "application/merge-patch+json");
        let patched = server.send(request.body(format!(r#"{{"labels":{{"pid":{number}}}}}"#)));
        assert_eq!(patched.status, 422, "{number}: {}", patched.text());
        post(&format!(r#""pid":"{number}""#), "application/json").expect(201);
    }
    for number in ["9007199254740991", "-9007199254740991", "1e300", "1.5", "-0.0"] {
        post(&format!(r#""n":{number}"#), "application/json").expect(201);
    }
}

#[test]
fn identifiers_of_many_digits_are_told_apart() {
    let server = Server::fresh();
    let path = cohort(&server, "c");
    let digits = ["9007199254740991", "9007199254740992", "9007199254740993", "1234567890123456789"];
    let table: String =
        digits.iter().enumerate().map(|(k, pid)| format!("t{k},{pid},0,0,4,0,4,1\n")).collect();
    let table = format!("id,pid,x1,y1,x2,y2,x3,y3\n{table}");
    server.post_bytes(&format!("{path}/shapes?format=csv"), "text/csv", table).expect(201);
    let found = server.get(&format!("{path}/attributes")).expect(200);
    let items = found["items"].as_array().unwrap();
    let pid = items.iter().find(|item| item["name"] == "labels.pid").unwrap();
    assert_eq!(pid["distinct"], 4, "{pid}");
    for (k, digits) in digits.iter().enumerate() {
        let list = server.get(&format!("{path}/shapes?labels.pid={digits}")).expect(200);
        let ids: Vec<&str> =
            list["items"].as_array().unwrap().iter().map(|s| s["external_id"].as_str().unwrap()).collect();
        assert_eq!(ids, [format!("t{k}")], "{digits}");
        let body = json!({"filter": {"labels": {"pid": digits.parse::<u64>().unwrap()}}});
        let table = server.post(&format!("{path}/table"), &body).expect(200);
        assert_eq!(table["items"].as_array().map_or(1, Vec::len), 1, "{table}");
    }
    let deleted =
        server.send(server.request(Method::DELETE, &format!("{path}/shapes?labels.pid={}", digits[2])));
    assert_eq!(deleted.expect(200)["deleted"], 1);
    for (k, count) in [(0, 1), (1, 1), (3, 1)] {
        let list = server.get(&format!("{path}/shapes?labels.pid={}", digits[k])).expect(200);
        assert_eq!(list["items"].as_array().unwrap().len(), count);
    }
    let csv = server.get(&format!("{path}/export?format=csv"));
    for (k, digits) in digits.iter().enumerate() {
        assert_eq!(csv.text().contains(digits), k != 2, "{}", csv.text());
    }
}

/// An export of attributes of each kind can be sent again: the shapes are those that are there.
#[test]
fn an_export_can_be_sent_again() {
    let server = Server::fresh();
    let path = cohort(&server, "c");
    let labels = [
        r#""n":61,"x":61.5,"f":true,"t":"a61""#,
        r#""n":61.0,"x":-0.0,"f":false,"t":"","big":"9007199254740993""#,
        r#""n":-3,"x":1e300,"z":9007199254740991"#,
    ];
    server.post_bytes(&format!("{path}/shapes"), "application/x-ndjson", lines(&labels)).expect(201);
    let stored = server.get(&format!("{path}/shapes/s1")).expect(200);
    assert_eq!(
        (stored["labels"]["n"].to_string(), stored["labels"]["x"].to_string()),
        ("61".into(), "0".into())
    );
    let mut outcomes = BTreeMap::new();
    for (format, media_type) in [
        ("ndjson", "application/x-ndjson"),
        ("parquet", "application/vnd.apache.parquet"),
        ("arrow", "application/vnd.apache.arrow.stream"),
        ("geojson", "application/geo+json"),
        ("npz", "application/octet-stream"),
    ] {
        let file = server.get(&format!("{path}/export?format={format}"));
        assert_eq!(file.status, 200, "{format}: {}", file.text());
        let again = server.post_bytes(&format!("{path}/shapes?format={format}"), media_type, file.body);
        outcomes.insert(format, again.json());
    }
    for (format, found) in outcomes {
        assert_eq!(
            (&found["added"], found["results"].as_array().map(Vec::len)),
            (&json!(0), Some(3)),
            "{format}: {found}"
        );
    }
    assert_eq!(server.get(&path).expect(200)["shape_count"], 3);
}
