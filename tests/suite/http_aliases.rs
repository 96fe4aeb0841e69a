//! Aliases of dictionaries: names for versions, which can be moved.

use reqwest::Method;
use serde_json::{Value, json};

use crate::http_access::create_key;
use crate::server::{Reply, Server, Setting};

const PRODUCTION: &str = "/v1/dictionaries/modes/aliases/production";

/// Learns the next version of a dictionary from the example cohort.
#[track_caller]
fn learn(server: &Server, name: &str, components: usize) -> Value {
    let learn = json!({"name": name, "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": components, "centre": true}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60");
    server.send(request.json(&learn)).expect(201)
}

fn put(server: &Server, path: &str, version: impl Into<Value>) -> Reply {
    server.send(server.request(Method::PUT, path).json(&json!({"version": version.into()})))
}

fn put_if(server: &Server, path: &str, version: u64, tag: &str) -> Reply {
    let request = server.request(Method::PUT, path).header("if-match", tag);
    server.send(request.json(&json!({"version": version})))
}

/// A service with the versions 1 and 2 of the dictionary `modes`.
fn with_versions() -> Server {
    let server = Setting::fresh().with_example().start();
    learn(&server, "modes", 2);
    learn(&server, "modes", 3);
    server
}

/// Version that an answer was computed with.
fn version_of(answer: &Value) -> u64 {
    answer["dictionary"]["version"].as_u64().unwrap()
}

#[test]
fn an_alias_names_a_version_wherever_a_dictionary_is_named() {
    let server = with_versions();
    let created = put(&server, PRODUCTION, 1);
    let first = created.expect(201);
    assert_eq!(created.header("location"), Some(PRODUCTION));
    assert_eq!((&first["alias"], version_of(&first)), (&json!("production"), 1));
    let id = first["dictionary"]["id"].as_str().unwrap();

    let found = server.get("/v1/dictionaries/modes@production").expect(200);
    assert_eq!((&found["id"], &found["version"]), (&json!(id), &json!(1)));
    let ids = json!({"cohort": "example-cells", "ids": ["cell0004"]});
    for call in ["assess", "encode", "score", "reconstruct"] {
        let answer = server.post(&format!("/v1/dictionaries/modes@production/{call}"), &ids).expect(200);
        assert_eq!(answer["dictionary"], first["dictionary"], "{call}");
    }
    for call in ["atoms", "modes", "drift"] {
        let answer = server.get(&format!("/v1/dictionaries/modes@production/{call}")).expect(200);
        assert_eq!(answer["dictionary"], first["dictionary"], "{call}");
    }
    let table = "/v1/cohorts/example-cells/table?columns=modes@production.t_squared,modes@production.score.2";
    let table = server.get(table).expect(200);
    assert!(table.to_string().contains(id), "{table}");
    let more = json!({"name": "more", "cohort": "example-cells", "continue_from": "modes@production"});
    // The version is found; there is nothing to continue with.
    assert!(server.post("/v1/dictionaries", &more).json()["detail"].as_str().unwrap().contains("shapes"));

    // It moves at once, and the name alone stays the latest version.
    assert_eq!(version_of(&put(&server, PRODUCTION, 2).expect(200)), 2);
    assert_eq!(server.get("/v1/dictionaries/modes@production").expect(200)["version"], 2);
    learn(&server, "modes", 4);
    assert_eq!(server.get("/v1/dictionaries/modes@production").expect(200)["version"], 2);
    assert_eq!(server.get("/v1/dictionaries/modes").expect(200)["version"], 3);
    assert_eq!(server.get("/v1/dictionaries/modes@1").expect(200)["version"], 1);
}

#[test]
fn aliases_belong_to_the_name_and_are_listed_with_their_versions() {
    let server = with_versions();
    let list =
        |key: &str| server.get(&format!("/v1/dictionaries/{key}/aliases")).expect(200)["items"].clone();
    assert_eq!(list("modes"), json!([]));
    put(&server, PRODUCTION, 2).expect(201);
    put(&server, "/v1/dictionaries/modes/aliases/baseline", 1).expect(201);
    learn(&server, "others", 2);
    let id = server.get("/v1/dictionaries/modes@1").expect(200)["id"].as_str().unwrap().to_owned();
    for key in ["modes", "modes@2", "modes@production", &id] {
        let found: Vec<(Value, u64)> = list(key)
            .as_array()
            .unwrap()
            .iter()
            .map(|item| (item["alias"].clone(), version_of(item)))
            .collect();
        assert_eq!(found, [(json!("baseline"), 1), (json!("production"), 2)], "{key}");
    }
    assert_eq!(list("others"), json!([]));
    assert_eq!(version_of(&server.get(PRODUCTION).expect(200)), 2);
    assert_eq!(server.delete(PRODUCTION).status, 204);
    server.delete(PRODUCTION).expect_problem(404, "not-found", &[]);
    server.get(PRODUCTION).expect_problem(404, "not-found", &[]);
    server.get("/v1/dictionaries/modes@production").expect_problem(404, "not-found", &[]);
    assert_eq!(list("modes").as_array().unwrap().len(), 1);
    assert_eq!(server.get("/v1/dictionaries/modes@2").status, 200);
}

#[test]
fn what_is_no_alias_or_no_version_is_refused() {
    let server = with_versions();
    learn(&server, "others", 2);
    // An alias that were a number would hide a version.
    for alias in ["3", "2b", "-x", "_x", ".x", "latest", "a%2Fb", "a@b", "%C3%A9", &"a".repeat(101)] {
        let problem = put(&server, &format!("/v1/dictionaries/modes/aliases/{alias}"), 1).expect(400);
        assert_eq!(problem["errors"][0]["parameter"], "alias", "{alias}: {problem}");
        assert!(problem["errors"][0]["detail"].as_str().unwrap().starts_with("expected "), "{problem}");
    }
    for version in [json!(0), json!(7), json!(u64::MAX)] {
        let problem = put(&server, PRODUCTION, version.clone());
        let problem = problem.expect_problem(422, "invalid-input", &["/version"]);
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.contains("'modes'") && detail.ends_with(&format!("got {version}")), "{detail}");
    }
    for version in [json!("1"), json!(1.5), json!(-1), json!(null), json!([1])] {
        put(&server, PRODUCTION, version).expect_problem(422, "invalid-input", &["/version"]);
    }
    let empty = server.send(server.request(Method::PUT, PRODUCTION).json(&json!({})));
    empty.expect_problem(422, "invalid-input", &["/version"]);
    let more = server.request(Method::PUT, PRODUCTION).json(&json!({"version": 1, "colour": "red"}));
    server.send(more).expect_problem(422, "invalid-input", &["/colour"]);
    put(&server, "/v1/dictionaries/nobody/aliases/production", 1).expect_problem(404, "not-found", &[]);
    server.get("/v1/dictionaries/modes@nobody").expect_problem(404, "not-found", &[]);
    // One of another name.
    put(&server, PRODUCTION, 1).expect(201);
    server.get("/v1/dictionaries/others@production").expect_problem(404, "not-found", &[]);
    server.get("/v1/dictionaries/others/aliases/production").expect_problem(404, "not-found", &[]);
    assert_eq!(
        server.get("/v1/dictionaries/modes/aliases").expect(200)["items"].as_array().unwrap().len(),
        1
    );
}

#[test]
fn a_name_has_at_most_a_hundred_aliases() {
    let server = with_versions();
    for k in 0..100 {
        put(&server, &format!("/v1/dictionaries/modes/aliases/a{k}"), 1 + k % 2).expect(201);
    }
    let problem = put(&server, PRODUCTION, 1).expect(400);
    assert_eq!(problem["detail"], "alias: expected at most 100 aliases of a dictionary, got one more");
    put(&server, "/v1/dictionaries/modes/aliases/a0", 2).expect(200);
    assert_eq!(server.delete("/v1/dictionaries/modes/aliases/a1").status, 204);
    put(&server, PRODUCTION, 1).expect(201);
}

#[test]
fn a_version_with_an_alias_is_not_deleted() {
    let server = with_versions();
    put(&server, PRODUCTION, 1).expect(201);
    for key in ["modes@1", "modes@production", "modes"] {
        let problem = server.delete(&format!("/v1/dictionaries/{key}"));
        let problem = problem.expect_problem(409, "version-in-use", &[]);
        assert!(problem["detail"].as_str().unwrap().contains("modes@production"), "{key}: {problem}");
    }
    // None of them is deleted when not all can be.
    for key in ["modes@1", "modes@2"] {
        assert_eq!(server.get(&format!("/v1/dictionaries/{key}")).status, 200, "{key}");
    }
    assert_eq!(server.delete("/v1/dictionaries/modes@2").status, 204);
    // What lies in the trash gets no alias, and its restoration brings none back.
    put(&server, PRODUCTION, 2).expect_problem(422, "invalid-input", &["/version"]);
    assert_eq!(server.delete(PRODUCTION).status, 204);
    assert_eq!(server.delete("/v1/dictionaries/modes").status, 204);
    put(&server, PRODUCTION, 1).expect_problem(404, "not-found", &[]);
    server.get("/v1/dictionaries/modes/aliases").expect_problem(404, "not-found", &[]);
    for item in server.get("/v1/trash").expect(200)["items"].as_array().unwrap() {
        let restore = format!("/v1/trash/{}/restore", item["id"].as_str().unwrap());
        server.post(&restore, &json!({}));
    }
    assert_eq!(server.get("/v1/dictionaries/modes/aliases").expect(200)["items"], json!([]));
}

#[test]
fn the_etag_of_an_alias_guards_its_moves_and_that_of_a_dictionary_is_its_version() {
    let server = with_versions();
    put_if(&server, PRODUCTION, 1, "*").expect_problem(412, "precondition-failed", &[]);
    let created = put(&server, PRODUCTION, 1);
    let first = created.header("etag").unwrap().to_owned();
    assert_eq!(server.get(PRODUCTION).header("etag"), Some(first.as_str()));
    let unchanged = server.request(Method::GET, PRODUCTION).header("if-none-match", &first);
    assert_eq!(server.send(unchanged).status, 304);
    let of_version = |path: &str| server.get(path).header("etag").unwrap().to_owned();
    let before = of_version("/v1/dictionaries/modes@production");
    assert_eq!(before, of_version("/v1/dictionaries/modes@1"));

    let moved = put_if(&server, PRODUCTION, 2, &first);
    let second = moved.header("etag").unwrap().to_owned();
    assert_eq!((moved.status, first == second), (200, false));
    // Who has not seen the move changes nothing.
    put_if(&server, PRODUCTION, 1, &first).expect_problem(412, "precondition-failed", &[]);
    let delete = server.request(Method::DELETE, PRODUCTION).header("if-match", &first);
    server.send(delete).expect_problem(412, "precondition-failed", &[]);
    // The same again is no move.
    assert_eq!(put(&server, PRODUCTION, 2).header("etag"), Some(second.as_str()));
    // Back at the first version it is not what it was.
    assert_ne!(put_if(&server, PRODUCTION, 1, &second).header("etag"), Some(first.as_str()));
    put(&server, PRODUCTION, 2).expect(200);
    // A cached answer is asked for again, and is another one then.
    let cached =
        server.request(Method::GET, "/v1/dictionaries/modes@production").header("if-none-match", &before);
    let reply = server.send(cached);
    assert_eq!(reply.expect(200)["version"], 2);
    let control = reply.header("cache-control").unwrap_or_default();
    assert!(!control.contains("immutable") && !control.contains("max-age"), "{control}");
}

#[test]
fn moves_are_in_the_feed_and_in_the_trail() {
    let server = with_versions();
    let since = server.get("/v1/changes?limit=1000").expect(200)["next"].as_u64().unwrap();
    let first = put(&server, PRODUCTION, 1).expect(201)["dictionary"]["id"].clone();
    let second = put(&server, PRODUCTION, 2).expect(200)["dictionary"]["id"].clone();
    put(&server, PRODUCTION, 2).expect(200);
    assert_eq!(server.delete(PRODUCTION).status, 204);
    let changes = server.get(&format!("/v1/changes?since={since}")).expect(200);
    let found: Vec<(&Value, &Value)> =
        changes["items"].as_array().unwrap().iter().map(|item| (&item["kind"], &item["object"])).collect();
    let (moved, removed) = (json!("dictionary_alias_moved"), json!("dictionary_alias_removed"));
    assert_eq!(found, [(&moved, &first), (&moved, &second), (&removed, &second)]);

    let entries = || server.get("/v1/audit?operation=set_alias").expect(200)["items"].clone();
    let start = std::time::Instant::now();
    while entries().as_array().unwrap().len() < 3 && start.elapsed().as_secs() < 20 {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let entries = entries();
    let objects: Vec<&Value> = entries.as_array().unwrap().iter().map(|entry| &entry["objects"]).collect();
    assert_eq!(objects.len(), 3);
    let both = objects.iter().any(|objects| {
        let text = objects.to_string();
        text.contains(first.as_str().unwrap()) && text.contains(second.as_str().unwrap())
    });
    assert!(both && objects.iter().all(|objects| objects["alias"] == "production"), "{objects:?}");
}

#[test]
fn an_alias_stays_in_its_tenant_and_away_from_keys_of_other_cohorts() {
    let server = with_versions();
    let hidden = json!({"name": "hidden", "representation": {"kind": "landmarks", "dimension": 2, "points": 3},
        "correspondence": "landmarks"});
    server.post("/v1/cohorts", &hidden).expect(201);
    put(&server, PRODUCTION, 1).expect(201);
    let limited = create_key(&server, &["--role", "writer", "--cohort", "hidden"]);
    let reader = create_key(&server, &["--role", "reader"]);
    let other = create_key(&server, &["--role", "admin", "--tenant", "b"]);
    let start = std::time::Instant::now();
    while server.get("/v1/cohorts").status != 401 {
        assert!(start.elapsed().as_secs() < 20);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let send = |key: &str, method: Method, path: &str| {
        let request = server.request(method.clone(), path).bearer_auth(key);
        server.send(if method == Method::PUT { request.json(&json!({"version": 1})) } else { request })
    };
    for key in [&limited, &other] {
        for (method, path) in [
            (Method::GET, "/v1/dictionaries/modes@production"),
            (Method::GET, "/v1/dictionaries/modes/aliases"),
            (Method::GET, PRODUCTION),
            (Method::PUT, PRODUCTION),
            (Method::DELETE, PRODUCTION),
        ] {
            send(key, method.clone(), path).expect_problem(404, "not-found", &[]);
        }
    }
    assert_eq!(send(&reader, Method::GET, PRODUCTION).status, 200);
    send(&reader, Method::PUT, PRODUCTION).expect_problem(403, "forbidden", &[]);
    send(&reader, Method::DELETE, PRODUCTION).expect_problem(403, "forbidden", &[]);
}

#[test]
fn a_key_limited_to_cohorts_moves_no_alias_of_another_cohort() {
    let server = with_versions();
    let mine = json!({"name": "mine", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    server.post("/v1/cohorts", &mine).expect(201);
    let shapes: Vec<Value> = (0..4).map(|i| json!({"points": [[0, 0], [4, f64::from(i)], [1, 3]]})).collect();
    server.post("/v1/cohorts/mine/shapes", &json!({"shapes": shapes})).expect(201);
    let third = json!({"name": "modes", "cohort": "mine", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 1, "centre": true}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60");
    assert_eq!(server.send(request.json(&third)).expect(201)["version"], 3);
    put(&server, PRODUCTION, 1).expect(201);
    put(&server, "/v1/dictionaries/modes/aliases/own", 3).expect(201);
    let limited = create_key(&server, &["--role", "writer", "--cohort", "mine"]);
    let start = std::time::Instant::now();
    while server.get("/v1/cohorts").status != 401 {
        assert!(start.elapsed().as_secs() < 20);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let send = |method: Method, alias: &str, version: u64| {
        let path = format!("/v1/dictionaries/modes/aliases/{alias}");
        let request = server.request(method.clone(), &path).bearer_auth(&limited);
        server.send(if method == Method::PUT { request.json(&json!({"version": version})) } else { request })
    };
    send(Method::PUT, "production", 3).expect_problem(403, "forbidden", &[]);
    send(Method::DELETE, "production", 0).expect_problem(404, "not-found", &[]);
    send(Method::PUT, "own", 1).expect_problem(422, "invalid-input", &["/version"]);
    send(Method::PUT, "own", 3).expect(200);
    send(Method::PUT, "more", 3).expect(201);
    let list = server.request(Method::GET, "/v1/dictionaries/modes/aliases").bearer_auth(&limited);
    assert_eq!(server.send(list).expect(200)["items"].as_array().unwrap().len(), 2);
    assert_eq!(send(Method::DELETE, "own", 0).status, 204);
}

#[test]
fn aliases_outlive_a_kill() {
    let server = with_versions();
    put(&server, PRODUCTION, 1).expect(201);
    put(&server, PRODUCTION, 2).expect(200);
    let server = server.kill().start();
    assert_eq!(version_of(&server.get(PRODUCTION).expect(200)), 2);
    assert_eq!(server.get("/v1/dictionaries/modes@production").expect(200)["version"], 2);
}

#[test]
fn readers_see_one_version_or_the_other_while_an_alias_moves() {
    let server = with_versions();
    put(&server, PRODUCTION, 1).expect(201);
    let moving = std::sync::atomic::AtomicBool::new(true);
    std::thread::scope(|scope| {
        let readers = [(); 2].map(|()| {
            scope.spawn(|| {
                let mut reads = 0;
                while moving.load(std::sync::atomic::Ordering::Relaxed) {
                    let atoms = server.get("/v1/dictionaries/modes@production/atoms").expect(200);
                    let count = atoms["atoms"].as_array().unwrap().len() as u64;
                    assert_eq!(count, version_of(&atoms) + 1);
                    reads += 1;
                }
                reads
            })
        });
        for k in 0..30_u64 {
            put(&server, PRODUCTION, 1 + k % 2).expect(200);
        }
        moving.store(false, std::sync::atomic::Ordering::Relaxed);
        assert!(readers.into_iter().all(|reader| reader.join().unwrap() > 0));
    });
}
