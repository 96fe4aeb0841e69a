//! Servers in the process of a test, as programs that ask the service use them.

use serde_json::Value;
use shapelex_server::testing::TestServer;

use crate::server::wait;

async fn asked(server: &TestServer, path: &str) -> Value {
    let answer = reqwest::get(format!("{}{path}", server.url())).await.unwrap();
    assert_eq!(answer.status(), 200, "{path}");
    serde_json::from_slice(&answer.bytes().await.unwrap()).unwrap()
}

#[test]
fn servers_of_one_process_have_stores_apart_and_leave_nothing() {
    let (full, empty) = (TestServer::start(&[]).unwrap(), TestServer::start(&["--no-example"]).unwrap());
    let names = |server| wait(asked(server, "/v1/cohorts"))["items"].as_array().unwrap().len();
    assert_eq!((names(&full), names(&empty)), (1, 0));
    let mean = wait(asked(&full, "/v1/cohorts/example-cells/mean?transformation=similarity"));
    assert!(mean["shape_count"].as_u64().unwrap() > 1, "{mean}");
    let folders = [full.folder().to_owned(), empty.folder().to_owned()];
    assert!(folders.iter().all(|folder| folder.join("data").exists()));
    full.stop().unwrap();
    drop(empty);
    assert!(folders.iter().all(|folder| !folder.exists()));
}

#[test]
fn flags_are_those_of_the_program() {
    let server = TestServer::start(&["--no-example", "--max-body-bytes", "100"]).unwrap();
    let request = reqwest::Client::new().post(format!("{}/v1/project", server.url())).body(" ".repeat(101));
    assert_eq!(wait(request.header("content-type", "application/json").send()).unwrap().status(), 413);
    let unknown = TestServer::start(&["--max-shape", "3"]).unwrap_err();
    assert!(unknown.contains("--max-shape"), "{unknown}");
    let wrong = TestServer::start(&["--max-shapes", "-1"]).unwrap_err();
    assert!(wrong.contains("max-shapes") || wrong.contains("-1"), "{wrong}");
}
