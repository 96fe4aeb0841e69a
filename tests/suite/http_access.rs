//! Who may call what: keys, roles, cohort scopes, tenants.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};
use shapelex_server::domain::access::Role;
use shapelex_server::domain::key::{Key, Secret};
use shapelex_server::store::Store;

use crate::guards::kept_model;
use crate::server::{Reply, Server, Setting, wait};

/// Within this time a change of keys reaches every process.
const REACHED: Duration = Duration::from_secs(5);

/// Runs `shapelex key` on the data of a server, which may be running.
pub(crate) fn key_command(server: &Server, arguments: &[&str]) -> Output {
    match server.database() {
        Some(url) => {
            let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
            command.arg("key").args(arguments).env("DATABASE_URL", url).output().unwrap()
        }
        None => key_command_in(server.folder(), arguments),
    }
}

/// The same on the embedded database in a folder.
fn key_command_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
    command.arg("key").args(arguments).arg("--data-dir").arg(folder.join("data"));
    command.env_remove("DATABASE_URL").output().unwrap()
}

/// The secret of a new key.
#[track_caller]
pub(crate) fn create_key(server: &Server, arguments: &[&str]) -> String {
    let output = key_command(server, &[&["create", "--name", "test"], arguments].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().trim_end().to_owned()
}

fn id_of(secret: &str) -> String {
    format!("key_{}", secret.split('_').nth(1).unwrap())
}

fn send(server: &Server, secret: &str, method: Method, path: &str, body: Option<&Value>) -> Reply {
    let request = server.request(method, path).bearer_auth(secret);
    server.send(match body {
        Some(body) => request.json(body),
        None => request,
    })
}

fn get(server: &Server, secret: &str, path: &str) -> Reply {
    send(server, secret, Method::GET, path, None)
}

fn post(server: &Server, secret: &str, path: &str, body: &Value) -> Reply {
    send(server, secret, Method::POST, path, Some(body))
}

/// Waits until a request is answered with this status.
#[track_caller]
pub(crate) fn await_status(status: u16, reply: impl Fn() -> Reply) {
    let end = Instant::now() + REACHED;
    while reply().status != status {
        assert!(Instant::now() < end, "not {status} after {REACHED:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn triangles(name: &str) -> Value {
    json!({"name": name, "representation": {"kind": "landmarks", "dimension": 2, "points": 3}})
}

#[test]
fn a_service_without_keys_is_open_to_this_machine_until_the_first_key() {
    let server = Server::fresh();
    assert!(server.log().contains("access is open"), "{}", server.log());
    assert_eq!(server.get("/v1/cohorts").status, 200);
    // A name that somebody else lets resolve to this machine.
    for host in ["evil.example", "127.0.0.1.evil.example:80", "10.0.0.1"] {
        let reply = server.send(server.request(Method::GET, "/v1/cohorts").header("host", host));
        reply.expect_problem(403, "forbidden", &[]);
    }
    let local = server.send(server.request(Method::GET, "/v1/cohorts").header("host", "localhost:1"));
    assert_eq!(local.status, 200);
    // What is wrong is refused also where nothing would do.
    let wrong = format!("shk_{}_{}", "0".repeat(32), "0".repeat(64));
    for wrong in [wrong.as_str(), "shk_", "a.b.c", ""] {
        get(&server, wrong, "/v1/cohorts").expect_problem(401, "unauthenticated", &[]);
    }
    let basic = server.request(Method::GET, "/v1/cohorts").basic_auth("user", Some("password"));
    server.send(basic).expect_problem(401, "unauthenticated", &[]);

    let key = json!({"name": "first", "role": "admin", "expires_in_days": 1});
    let reply = server.post("/v1/keys", &key);
    let issued = reply.expect(201);
    let secret = issued["secret"].as_str().unwrap();
    assert_eq!(reply.header("location"), Some(format!("/v1/keys/{}", id_of(secret)).as_str()));
    assert_eq!(reply.header("cache-control"), Some("no-store"));
    let refused = server.get("/v1/cohorts");
    refused.expect_problem(401, "unauthenticated", &[]);
    assert_eq!(refused.header("www-authenticate"), Some("Bearer"));
    assert_eq!(get(&server, secret, "/v1/cohorts").status, 200);
    // With a key the name of the host does not matter: there may be a proxy.
    let named =
        server.request(Method::GET, "/v1/cohorts").header("host", "shapes.example").bearer_auth(secret);
    assert_eq!(server.send(named).status, 200);
    for path in ["/livez", "/readyz", "/openapi.json", "/docs/"] {
        assert!(server.get(path).status < 300, "{path}");
    }
    let read = get(&server, secret, &format!("/v1/keys/{}", id_of(secret))).expect(200);
    assert!(read.get("secret").is_none() && read["expires_at"].is_string(), "{read}");
    let log = server.log();
    assert!(!log.contains(secret) && !log.contains(secret.rsplit('_').next().unwrap()));
    // Revoked, it ends at once; and the last key does not open the service again.
    assert_eq!(
        send(&server, secret, Method::DELETE, &format!("/v1/keys/{}", id_of(secret)), None).status,
        204
    );
    assert_eq!(get(&server, secret, "/v1/cohorts").status, 401);
    let again = server.kill().start();
    assert_eq!(again.get("/v1/cohorts").status, 401);
    assert_eq!(again.log().matches("access is open").count(), 1, "of the first start");
}

#[test]
fn a_key_that_was_drawn_elsewhere_is_not_printed() {
    let server = Server::fresh();
    let text = format!("shk_{}_{}", "0f".repeat(16), "a7".repeat(32));
    let file = server.folder().join("secret");
    std::fs::write(&file, format!("{text}\n")).unwrap();
    let file = file.to_str().unwrap();
    for _ in 0..2 {
        let arguments = ["create", "--name", "first", "--role", "admin", "--secret-file", file];
        let output = key_command(&server, &arguments);
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && said == format!("{}\n", id_of(&text)), "{said}");
    }
    await_status(401, || server.get("/v1/cohorts"));
    get(&server, &text, "/v1/keys").expect(200);
    assert_eq!(get(&server, &text, "/v1/keys").json()["items"].as_array().unwrap().len(), 1);
    std::fs::write(file, "shk_short").unwrap();
    let output = key_command(&server, &["create", "--name", "x", "--role", "reader", "--secret-file", file]);
    assert!(!output.status.success() && output.stdout.is_empty());
    assert!(!String::from_utf8(output.stderr).unwrap().contains("shk_short"));
}

#[test]
fn pages_of_other_sites_get_nothing_from_an_open_service() {
    let server = Server::fresh();
    let authority = server.address().trim_start_matches("http://").to_owned();
    let ask = |method: Method, path: &str, headers: &[(&str, &str)]| {
        let request = server.request(method, path);
        server.send(headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)))
    };
    let own = format!("http://{authority}");
    let foreign: [&[(&str, &str)]; 5] = [
        &[("origin", "http://evil.example")],
        &[("origin", "null")],
        &[("sec-fetch-site", "cross-site")],
        &[("sec-fetch-site", "same-site"), ("sec-fetch-mode", "no-cors")],
        &[("origin", "http://127.0.0.1:1"), ("sec-fetch-site", "same-site")],
    ];
    let paths = [
        (Method::GET, "/v1/cohorts"),
        (Method::GET, "/metrics"),
        (Method::POST, "/v1/mean"),
        (Method::POST, "/v1/jobs/job_1/cancel"),
        (Method::POST, "/v1/trash/coh_1/restore"),
        (Method::DELETE, "/v1/cohorts/c"),
    ];
    for headers in foreign {
        for (method, path) in &paths {
            let reply = ask(method.clone(), path, headers);
            let problem = reply.expect_problem(403, "forbidden", &[]);
            assert!(problem["detail"].as_str().unwrap().contains("own origin"), "{problem}");
        }
        // What shows nobody's shapes: probes, the reference page and its document.
        assert_eq!(ask(Method::GET, "/livez", headers).status, 204);
        assert_eq!(ask(Method::GET, "/docs/", headers).status, 200);
    }
    for headers in [
        &[][..],
        &[("origin", own.as_str()), ("sec-fetch-site", "same-origin")],
        &[("sec-fetch-site", "none")],
    ] {
        ask(Method::GET, "/v1/cohorts", headers).expect(200);
        ask(Method::POST, "/v1/jobs/job_1/cancel", headers).expect(404);
    }
    // A key is nothing that a browser adds by itself.
    let secret = create_key(&server, &["--role", "reader"]);
    await_status(401, || ask(Method::GET, "/v1/cohorts", foreign[0]));
    let bearer = format!("Bearer {secret}");
    ask(Method::GET, "/v1/cohorts", &[foreign[0][0], ("authorization", &bearer)]).expect(200);
}

#[test]
fn a_public_address_needs_a_key_or_a_provider() {
    let folder = tempfile::tempdir().unwrap();
    let serve = |flags: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
        command.args(["serve", "--no-example", "--listen", "0.0.0.0:0", "--data-dir"]);
        command.arg(folder.path().join("data")).args(flags).env_remove("DATABASE_URL");
        command
    };
    let refused = serve(&[]).output().unwrap();
    let message = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success());
    assert!(message.contains("refusing to listen on 0.0.0.0:0"), "{message}");
    assert!(message.contains("shapelex key create --name admin --role admin"), "{message}");
    let insecure = ["--oidc-issuer", "http://id.example", "--oidc-audience", "shapelex"];
    let refused = serve(&insecure).output().unwrap();
    assert!(String::from_utf8(refused.stderr).unwrap().contains("https://"));
    assert!(key_command_in(folder.path(), &["create", "--name", "a", "--role", "reader"]).status.success());
    let mut child = serve(&[]).stdout(std::process::Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let mut stdout = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut stdout, &mut line).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(line.starts_with("shapelex is listening on http://0.0.0.0:"), "{line}");
}

#[test]
fn keys_are_made_and_revoked_beside_the_running_service() {
    let server = Server::fresh();
    let admin = create_key(&server, &["--role", "admin"]);
    let reader = create_key(&server, &["--role", "reader", "--expires-in-days", "30"]);
    await_status(401, || server.get("/v1/cohorts"));
    assert_eq!(get(&server, &reader, "/v1/cohorts").status, 200);
    let problem =
        post(&server, &reader, "/v1/cohorts", &triangles("a")).expect_problem(403, "forbidden", &[]);
    assert_eq!(problem["detail"], "expected the role writer, the caller has the role reader");

    let listed = get(&server, &admin, "/v1/keys").expect(200);
    let roles: Vec<&str> =
        listed["items"].as_array().unwrap().iter().map(|k| k["role"].as_str().unwrap()).collect();
    assert_eq!(roles, ["admin", "reader"]);
    let page = get(&server, &admin, "/v1/keys?limit=1").expect(200);
    let next = format!("/v1/keys?limit=1&cursor={}", page["next"].as_str().unwrap());
    assert_eq!(get(&server, &admin, &next).expect(200)["items"][0]["id"], id_of(&reader));
    // The use of a key is written down beside the request.
    let path = format!("/v1/keys/{}", id_of(&reader));
    let end = Instant::now() + REACHED;
    while get(&server, &admin, &path).expect(200)["last_used_at"].is_null() {
        assert!(Instant::now() < end, "its use is not noted");
        std::thread::sleep(Duration::from_millis(50));
    }

    assert!(key_command(&server, &["revoke", &id_of(&reader)]).status.success());
    await_status(401, || get(&server, &reader, "/v1/cohorts"));
    let list = key_command(&server, &["list"]);
    let list = String::from_utf8(list.stdout).unwrap();
    let line = list.lines().find(|line| line.contains(&id_of(&reader))).unwrap();
    assert!(line.contains("\treader\trevoked\t"), "{line}");
    assert!(!list.contains(&admin) && !list.contains(&reader));
    for arguments in [
        &["create", "--name", "x", "--role", "root"][..],
        &["create", "--name", "x", "--role", "reader", "--cohort", "none"],
        &["create", "--name", "x", "--role", "reader", "--tenant", "a/b"],
        &["revoke", "key_1"],
        &["revoke", &id_of(&reader), "--tenant", "other"],
    ] {
        let output = key_command(&server, arguments);
        assert!(!output.status.success() && !output.stderr.is_empty(), "{arguments:?}");
    }
    // In an emergency nobody knows the tenant of a key.
    let elsewhere = create_key(&server, &["--role", "reader", "--tenant", "other"]);
    let all = String::from_utf8(key_command(&server, &["list", "--all-tenants"]).stdout).unwrap();
    assert!(
        all.lines().any(|line| line.starts_with(&format!("other\t{}\treader\t", id_of(&elsewhere)))),
        "{all}"
    );
    assert!(all.lines().any(|line| line.starts_with(&format!("default\t{}\t", id_of(&reader)))), "{all}");
    assert!(key_command(&server, &["revoke", &id_of(&elsewhere)]).status.success());
    await_status(401, || get(&server, &elsewhere, "/v1/cohorts"));
    let bad = json!({"name": "", "role": "admin", "cohorts": [], "expires_in_days": 0, "tenant": "b"});
    let pointers = ["/name", "/cohorts", "/cohorts", "/expires_in_days", "/tenant"];
    post(&server, &admin, "/v1/keys", &bad).expect_problem(422, "invalid-input", &pointers);
    let bad = json!({"name": "x", "role": "writer", "cohorts": ["none", "nobody"]});
    post(&server, &admin, "/v1/keys", &bad).expect_problem(
        422,
        "invalid-input",
        &["/cohorts/0", "/cohorts/1"],
    );
}

#[test]
fn readers_compute_without_storing_and_cancel_only_their_own_jobs() {
    let server = Setting::fresh().with_example().start();
    let [reader, other, writer] =
        ["reader", "reader", "writer"].map(|role| create_key(&server, &["--role", role]));
    await_status(401, || server.get("/v1/cohorts"));
    // Each is told who it is, so that a page offers only what its role may do.
    for (secret, role) in [(&reader, "reader"), (&writer, "writer")] {
        let caller = json!({"role": role, "tenant": "default", "name": id_of(secret), "open": false});
        assert_eq!(get(&server, secret, "/v1/version").expect(200)["caller"], caller);
    }
    let groups = |permutations: usize| json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": permutations});
    post(&server, &reader, "/v1/comparisons", &groups(19)).expect(200);
    let few =
        json!({"cohort": "example-cells", "ids": ["cell0004", "cell0010"], "transformation": "similarity"});
    post(&server, &reader, "/v1/distances", &few).expect(200);
    let submitted = |secret: &str| {
        let job = post(&server, secret, "/v1/comparisons", &groups(100_000)).expect(202);
        job["id"].as_str().unwrap().to_owned()
    };
    let cancel = |secret: &str, job: &str| {
        send(&server, secret, Method::POST, &format!("/v1/jobs/{job}/cancel"), None)
    };
    let (own, of_writer) = (submitted(&reader), submitted(&writer));
    get(&server, &reader, &format!("/v1/jobs/{own}")).expect(200);
    for (secret, job) in [(&other, &own), (&reader, &of_writer)] {
        let problem = cancel(secret, job).expect_problem(403, "forbidden", &[]);
        assert_eq!(problem["detail"], "expected a job that the caller has submitted, or the role writer");
    }
    assert_eq!(cancel(&reader, &own).expect(200)["status"], "cancelled");
    assert_eq!(cancel(&reader, &own).expect(200)["status"], "cancelled", "again");
    assert_eq!(cancel(&writer, &of_writer).expect(200)["status"], "cancelled");
    let own = submitted(&reader);
    assert_eq!(cancel(&writer, &own).expect(200)["status"], "cancelled");
    assert_eq!(cancel(&reader, "job_1").status, 404);
}

/// The service loads the example cohort for a first trial only: a store with keys belongs to its users.
#[test]
fn a_store_with_keys_gets_no_example() {
    let empty = Setting::fresh().start();
    let secret = create_key(&empty, &["--role", "admin"]);
    let server = empty.terminate().with_example().start();
    let cohorts = send(&server, &secret, Method::GET, "/v1/cohorts", None).expect(200);
    assert_eq!(cohorts["items"], json!([]));
}

#[test]
fn a_key_limited_to_cohorts_sees_nothing_else() {
    let server = Setting::fresh().with_example().start();
    let learn = |name: &str, cohort: &str| {
        json!({"name": name, "cohort": cohort, "transformation": "similarity",
            "method": {"kind": "functional_pca", "components": 1, "centre": true}})
    };
    let learnt = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60");
    server.send(learnt.json(&learn("modes", "example-cells"))).expect(201);
    server.post("/v1/cohorts", &triangles("mine")).expect(201);
    let shapes: Vec<Value> = (0..4)
        .map(|i| json!({"points": [[0, 0], [4, f64::from(i)], [1, 3]], "external_id": format!("t-{i}")}))
        .collect();
    let add = json!({"shapes": shapes});
    let key = create_key(&server, &["--role", "writer", "--cohort", "mine"]);
    let admin = create_key(&server, &["--role", "admin"]);
    await_status(401, || server.get("/v1/cohorts"));

    let names = |path: &str| -> Vec<String> {
        let list = get(&server, &key, path).expect(200);
        list["items"]
            .as_array()
            .unwrap()
            .iter()
            .map(|item| item["name"].as_str().unwrap().to_owned())
            .collect()
    };
    assert_eq!(names("/v1/cohorts"), ["mine"]);
    assert_eq!(names("/v1/dictionaries"), [""; 0]);
    let added = post(&server, &key, "/v1/cohorts/mine/shapes", &add);
    assert!((200..300).contains(&added.status), "{}", added.text());
    assert_eq!(get(&server, &key, "/v1/cohorts/mine/mean?transformation=similarity").status, 200);
    post(&server, &key, "/v1/cohorts", &triangles("more")).expect_problem(403, "forbidden", &[]);
    let file = get(&server, &admin, "/v1/dictionaries/modes/export").expect(200);
    post(&server, &key, "/v1/dictionaries/import", &file).expect_problem(403, "forbidden", &[]);

    // Its own dictionary and job, not those of others; and no new version of theirs.
    let wait = |body: &Value| {
        let request = server.request(Method::POST, "/v1/dictionaries").bearer_auth(&key);
        server.send(request.header("prefer", "wait=60").json(body))
    };
    wait(&learn("modes", "mine")).expect_problem(403, "forbidden", &[]);
    wait(&learn("corners", "mine")).expect(201);
    wait(&learn("corners", "mine")).expect(201);
    assert_eq!(names("/v1/dictionaries"), ["corners", "corners"]);
    let all = get(&server, &admin, "/v1/jobs").expect(200)["items"].as_array().unwrap().len();
    let own = get(&server, &key, "/v1/jobs").expect(200)["items"].as_array().unwrap().len();
    assert_eq!((all, own), (3, 2));
    assert_eq!(send(&server, &key, Method::DELETE, "/v1/dictionaries/modes", None).status, 404);
    assert_eq!(get(&server, &admin, "/v1/dictionaries/modes").status, 200);
}

const LIMITED: &str = "a key of another cohort";
const ADMIN: &str = "an admin";

/// Somebody who calls, and what they show.
struct Caller {
    name: &'static str,
    secret: Option<String>,
    /// What may be done, by who is let in.
    role: Option<Role>,
    /// Whether the things of the test exist for them.
    sees: bool,
}

/// What exists in tenant A, by the names of path parameters.
fn things(server: &Server) -> BTreeMap<&'static str, String> {
    let wait = |path: &str, body: &Value| {
        server.send(server.request(Method::POST, path).header("prefer", "wait=60").json(body))
    };
    let learn = json!({"name": "modes", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3, "centre": true},
        "classifier": {"kind": "discriminant", "attribute": "labels.treatment", "repeats": 1}});
    let dictionary = wait("/v1/dictionaries", &learn).expect(201);
    let distances = json!({"cohort": "example-cells", "transformation": "similarity"});
    wait("/v1/distances", &distances).expect(200);
    let job = server.get("/v1/jobs").expect(200)["items"][0]["id"].clone();
    let cohort = server.get("/v1/cohorts/example-cells").expect(200)["id"].clone();
    let shape = server.get("/v1/cohorts/example-cells/shapes?limit=1").expect(200)["items"][0]["id"].clone();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let alias = server.request(Method::PUT, "/v1/dictionaries/modes/aliases/production");
    server.send(alias.json(&json!({"version": 1}))).expect(201);
    let hook = server.post("/v1/hooks", &json!({"url": "https://pipeline.example/"})).expect(201);
    let path = format!("/v1/cohorts/example-cells/shapes/{}", text(&shape));
    server.send(server.request(Method::PATCH, &path).json(&json!({"subject": "subject-1"}))).expect(200);
    BTreeMap::from([
        ("{hook}", text(&hook["id"])),
        ("{cohort}", text(&cohort)),
        ("{shape}", text(&shape)),
        ("{dictionary}", text(&dictionary["id"])),
        ("{alias}", String::from("production")),
        ("{job}", text(&job)),
        // Of the operations of models, a job that has kept one.
        ("/v1/models/{job}", format!("/v1/models/{}", kept_model(server))),
        ("{name}", String::from("keys")),
        ("{subject}", String::from("subject-1")),
    ])
}

/// Id of a new cohort in the trash.
fn trashed(server: &Server, admin: &str) -> String {
    let cohort =
        post(server, admin, "/v1/cohorts", &triangles(&shapelex_server::domain::id::new_id("c"))).expect(201);
    let id = cohort["id"].as_str().unwrap();
    assert_eq!(send(server, admin, Method::DELETE, &format!("/v1/cohorts/{id}"), None).status, 204);
    id.to_owned()
}

/// Makes a key that no command makes: one that has ended.
fn expired_key(server: &Server) -> String {
    let id = shapelex_server::domain::id::new_id("key");
    let secret = Secret::new(&id, [9; 32]);
    let key = Key {
        id,
        tenant: "default".into(),
        name: "expired".into(),
        role: Role::Admin,
        cohorts: None,
        digest: secret.digest(),
        created_at_ms: 0,
        expires_at_ms: Some(1),
        revoked_at_ms: None,
        used_at_ms: None,
    };
    let folder = server.folder().join("data");
    wait(async {
        let store = match server.database() {
            Some(url) => Store::connect(url, 2).await.unwrap(),
            None => Store::attach(&folder).await.unwrap(),
        };
        store.create_key(&key).await.unwrap();
        store.close().await;
    });
    secret.reveal().to_owned()
}

fn callers(server: &Server) -> Vec<Caller> {
    server.post("/v1/cohorts", &triangles("elsewhere")).expect(201);
    let key = |arguments: &[&str]| Some(create_key(server, arguments));
    let revoked = key(&["--role", "admin"]);
    assert!(key_command(server, &["revoke", &id_of(revoked.as_ref().unwrap())]).status.success());
    let caller = |name, secret, role, sees| Caller { name, secret, role, sees };
    vec![
        caller("nobody", None, None, false),
        caller("a revoked key", revoked, None, false),
        caller("an expired key", Some(expired_key(server)), None, false),
        caller(
            "an admin of another tenant",
            key(&["--role", "admin", "--tenant", "b"]),
            Some(Role::Admin),
            false,
        ),
        caller(LIMITED, key(&["--role", "writer", "--cohort", "elsewhere"]), Some(Role::Writer), false),
        caller("a reader", key(&["--role", "reader"]), Some(Role::Reader), true),
        caller("a writer", key(&["--role", "writer"]), Some(Role::Writer), true),
        caller(ADMIN, key(&["--role", "admin"]), Some(Role::Admin), true),
    ]
}

/// An operation of the interface document.
struct Operation {
    method: Method,
    template: String,
    role: Option<Role>,
    body: Option<(String, String)>,
}

/// The operations, those that delete last, and of these what lies in others first.
fn operations() -> Vec<Operation> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let document: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mut found = Vec::new();
    for (template, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let content = operation.pointer("/requestBody/content").and_then(Value::as_object);
            let body = content.and_then(|content| content.iter().next()).map(|(media_type, body)| {
                let schema = body["schema"]["$ref"]
                    .as_str()
                    .map(|name| &document.pointer(&name[1..]).unwrap()["example"]);
                let example = body.get("example").or(schema).unwrap();
                let text = example.as_str().map_or_else(|| example.to_string(), str::to_owned);
                // The only cohort of the test.
                (media_type.clone(), text.replace("hippocampi", "example-cells"))
            });
            let role = Role::from_word(operation["x-role"].as_str().unwrap());
            let method = method.to_uppercase().parse().unwrap();
            found.push(Operation { method, template: template.clone(), role, body });
        }
    }
    found.sort_by_key(|operation| {
        (operation.method == Method::DELETE, std::cmp::Reverse(operation.template.len()))
    });
    found
}

impl Operation {
    /// The body that works, or one that is refused as soon as it is read.
    fn send(&self, server: &Server, path: &str, caller: &Caller, works: bool) -> Reply {
        let mut request = server.request(self.method.clone(), path);
        if let Some(secret) = &caller.secret {
            request = request.bearer_auth(secret);
        }
        server.send(match &self.body {
            Some((media_type, text)) => {
                let text = if works { text.clone() } else { "{".into() };
                request.header("content-type", media_type).body(text)
            }
            None => request,
        })
    }

    /// Whether it is about one of the things of the test: by its path, or by its body, but for a file that only tells
    /// where it comes from.
    fn is_about_things(&self) -> bool {
        let of_all = ["/v1/generators/{name}"];
        let in_path = self.template.contains('{') && !of_all.contains(&self.template.as_str());
        let in_body =
            |(_, text): &(_, String)| text.contains("example-cells") && !text.contains("\"digest\"");
        in_path || self.body.as_ref().is_some_and(in_body)
    }

    /// Whether it makes what a key limited to cohorts may not make.
    fn makes_more(&self) -> bool {
        let makers = ["/v1/cohorts", "/v1/cohorts/{cohort}/correspond", "/v1/dictionaries/import"];
        self.method == Method::POST && makers.contains(&self.template.as_str())
    }

    /// Whether what it is done to is not there any more; a revoked key stays, and so does a cohort without shapes.
    fn takes_away(&self) -> bool {
        let lasting = ["/v1/cohorts/{cohort}/shapes", "/v1/keys/{key}", "/v1/subjects/{subject}"];
        let deletes = self.method == Method::DELETE && !lasting.contains(&self.template.as_str());
        deletes || self.template.ends_with("/restore")
    }

    /// The path for things with these ids.
    fn path(&self, things: &BTreeMap<&'static str, String>) -> String {
        let path = things.iter().fold(self.template.clone(), |path, (name, id)| path.replace(name, id));
        match (self.method.as_str(), self.template.as_str()) {
            ("GET", "/v1/cohorts/{cohort}/mean") => path + "?transformation=similarity",
            ("DELETE", "/v1/cohorts/{cohort}/shapes") => path + "?all=true&dry_run=true",
            _ => path,
        }
    }

    /// What the status for a caller must be, and whether it is; `gone` when somebody has deleted the thing before.
    fn judge(&self, caller: &Caller, gone: bool, status: u16) -> (&'static str, bool) {
        match (self.role, caller.role) {
            (None, _) => ("2XX", status < 300),
            (Some(_), None) => ("401", status == 401),
            (Some(needed), Some(found)) if found < needed => ("403", status == 403),
            _ if self.makes_more() && caller.name == LIMITED => ("403", status == 403),
            _ if self.is_about_things() && !caller.sees => ("404", status == 404),
            _ if gone => ("404, it is deleted", status == 404),
            _ => ("neither 401, 403 nor 404", ![401, 403, 404].contains(&status)),
        }
    }
}

#[test]
fn every_operation_is_open_to_whom_it_should_be_and_to_nobody_else() {
    // Distances are a job, which has an output.
    // Those without a valid key are more than an address may send in a minute.
    let flags = ["--max-matrix-operations", "1", "--refusals-per-minute", "0"];
    let server = Setting::fresh().with_example().flags(&flags).start();
    let mut things = things(&server);
    let callers = callers(&server);
    things.insert("{key}", id_of(callers[1].secret.as_ref().unwrap()));
    await_status(401, || server.get("/v1/cohorts"));
    let mut wrong = Vec::new();
    let admin = callers.last().and_then(|caller| caller.secret.as_deref()).unwrap();
    for operation in operations() {
        let Operation { method, template, .. } = &operation;
        if template.contains("{id}") {
            things.insert("{id}", trashed(&server, admin));
        }
        let mut gone = false;
        for caller in &callers {
            // Who may do it is told by a body that is refused after access; what exists for whom, by one that works.
            let works = !caller.sees || caller.name == ADMIN;
            let reply = operation.send(&server, &operation.path(&things), caller, works);
            let (wanted, right) = operation.judge(caller, gone, reply.status);
            if !right {
                let (name, found, text) = (caller.name, reply.status, reply.text());
                wrong.push(format!("{method} {template} as {name}: {found}, not {wanted}: {text}"));
            }
            // The trail of a tenant holds what its own callers have asked for, whatever that was.
            if !caller.sees && reply.status < 300 && operation.template != "/v1/audit" {
                let secrets = things.values().map(String::as_str).filter(|id| id.contains('_'));
                let shown = secrets.chain(["example-cells"]).find(|secret| reply.text().contains(secret));
                assert_eq!(shown, None, "{method} {template} shows it to {}", caller.name);
            }
            gone |= operation.takes_away() && reply.status < 300;
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
