//! The real program as a child process, and a client that checks what every answer must have.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, LazyLock, Mutex, Weak};
use std::time::Duration;

use reqwest::header::{CONTENT_TYPE, HeaderMap};
use reqwest::{Method, RequestBuilder};
use serde_json::Value;
use tempfile::TempDir;
use tokio::runtime::Runtime;

static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());

/// Waits for a future of the client.
pub(crate) fn wait<T>(future: impl Future<Output = T>) -> T {
    RUNTIME.block_on(future)
}

/// A running service; killed when dropped.
pub(crate) struct Server {
    child: Child,
    /// The program writes a second line: with the pipe closed it would fail.
    _stdout: BufReader<ChildStdout>,
    address: String,
    client: reqwest::Client,
    log: PathBuf,
    folder: Arc<TempDir>,
    database: Option<String>,
    /// What was sent and must not be logged.
    sent: Mutex<BTreeSet<String>>,
}

/// How a server is started.
pub(crate) struct Setting {
    folder: Arc<TempDir>,
    /// Where PostgreSQL is, when the tests run on it.
    database: Option<String>,
    flags: Vec<String>,
    environment: Vec<(String, String)>,
    example: bool,
    /// What the shell that starts it sets, such as `ulimit -f 8`.
    limit: Option<String>,
}

/// The program, which knows nothing of the settings of these tests.
fn program() -> Command {
    clean(Command::new(env!("CARGO_BIN_EXE_shapelex")))
}

fn clean(mut command: Command) -> Command {
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("SHAPELEX_")) {
        command.env_remove(name);
    }
    command.env_remove("DATABASE_URL").stdin(Stdio::null());
    command
}

/// The same command where no file can be longer than so many blocks of 512 bytes.
pub(crate) fn in_blocks(command: &Command, blocks: u32) -> Command {
    limited(command, &format!("ulimit -f {blocks}"))
}

/// The same command in a shell that sets a limit first.
fn limited(command: &Command, limit: &str) -> Command {
    let script = format!("{limit}; exec \"$0\" \"$@\"");
    let mut shell = clean(Command::new("sh"));
    shell.args(["-c", &script]).arg(command.get_program()).args(command.get_args());
    shell
}

/// One of the commands for a store, about the store in the folder of a server or in its database.
fn command(name: &str, folder: &Path, database: Option<&str>) -> Command {
    let mut command = program();
    command.arg(name);
    match database {
        Some(url) => command.arg("--database-url").arg(url),
        None => command.arg("--data-dir").arg(folder.join("data")),
    };
    command
}

impl Setting {
    /// On a new empty folder.
    pub(crate) fn fresh() -> Self {
        let folder = Arc::new(tempfile::tempdir().unwrap());
        let database = std::env::var("SHAPELEX_TEST_DATABASE_URL").ok().map(|url| wait(fresh_schema(&url)));
        Self { folder, database, flags: Vec::new(), environment: Vec::new(), example: false, limit: None }
    }

    /// One of the commands for the store of this setting.
    pub(crate) fn command(&self, name: &str) -> Command {
        command(name, self.folder.path(), self.database.as_deref())
    }

    /// Where no file can be longer than so many blocks of 512 bytes.
    pub(crate) fn file_blocks(mut self, blocks: u32) -> Self {
        self.limit = Some(format!("ulimit -f {blocks}"));
        self
    }

    /// Where the process ends when it takes more addresses than so many MiB.
    pub(crate) fn address_space(mut self, mebibytes: u32) -> Self {
        self.limit = Some(format!("ulimit -v {}", mebibytes << 10));
        self
    }

    /// On the embedded database in any case.
    pub(crate) fn embedded(mut self) -> Self {
        self.database = None;
        self
    }

    /// With further flags.
    pub(crate) fn flags(mut self, flags: &[&str]) -> Self {
        self.flags.extend(flags.iter().map(ToString::to_string));
        self
    }

    /// With an environment variable.
    pub(crate) fn environment(mut self, name: &str, value: &str) -> Self {
        self.environment.push((name.into(), value.into()));
        self
    }

    /// With the example cohort.
    pub(crate) fn with_example(mut self) -> Self {
        self.example = true;
        self
    }

    /// Starts it and waits for the line with its address.
    pub(crate) fn start(self) -> Server {
        let log = self.folder.path().join("log");
        // Appended: a server that is started again writes to the same log.
        let stderr = File::options().create(true).append(true).open(&log).unwrap();
        let mut command = match &self.limit {
            None => program(),
            Some(limit) => limited(&program(), limit),
        };
        command.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(self.folder.path().join("data"));
        if let Some(url) = &self.database {
            command.env("DATABASE_URL", url).env("SHAPELEX_DATABASE_CONNECTIONS", "4");
        }
        command.args(if self.example { None } else { Some("--no-example") }).args(&self.flags);
        // What this program logs at all; other tests look through everything that libraries log too.
        command.env("SHAPELEX_LOG", "info,shapelex=debug").env("SHAPELEX_LOG_FORMAT", "json");
        command.envs(self.environment).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(stderr);
        let mut child = command.spawn().unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("shapelex is listening on ").map(str::to_owned);
        let Some(address) = address else {
            // The process ends by itself when it does not start.
            let _ = child.kill();
            panic!("no address in {line:?}; the log: {}", std::fs::read_to_string(&log).unwrap());
        };
        let client = reqwest::Client::builder()
            .no_proxy()
            .redirect(reqwest::redirect::Policy::none())
            .timeout(Duration::from_secs(60))
            .build()
            .unwrap();
        let sent = Mutex::default();
        Server {
            child,
            _stdout: stdout,
            address,
            client,
            log,
            folder: self.folder,
            database: self.database,
            sent,
        }
    }
}

/// The first part of a body.
async fn beginning(mut response: reqwest::Response) -> Vec<u8> {
    response.chunk().await.unwrap().unwrap_or_default().to_vec()
}

/// The address of a schema of its own, which is a database for everybody who uses it.
async fn fresh_schema(url: &str) -> String {
    let schema = format!("suite_{}", uuid::Uuid::now_v7().simple());
    let pool = sqlx::PgPool::connect(url).await.unwrap();
    let create = sqlx::AssertSqlSafe(format!("CREATE SCHEMA {schema}"));
    sqlx::query(create).execute(&pool).await.unwrap();
    pool.close().await;
    format!("{url}?options=-csearch_path%3D{schema}")
}

/// A server that tests share which leave nothing behind; it ends with the last of them.
pub(crate) fn shared() -> Arc<Server> {
    static SHARED: Mutex<Weak<Server>> = Mutex::new(Weak::new());
    let mut shared = SHARED.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    shared.upgrade().unwrap_or_else(|| {
        let server = Arc::new(Setting::fresh().start());
        *shared = Arc::downgrade(&server);
        server
    })
}

impl Server {
    /// On a new empty store.
    pub(crate) fn fresh() -> Self {
        Setting::fresh().start()
    }

    /// `http://127.0.0.1:PORT`.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }

    /// How another process on the same database is started.
    pub(crate) fn beside(&self) -> Setting {
        let folder = Arc::new(tempfile::tempdir().unwrap());
        let database = self.database.clone();
        let (flags, environment) = (Vec::new(), Vec::new());
        Setting { folder, database, flags, environment, example: false, limit: None }
    }

    /// Everything it logged.
    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap()
    }

    /// One of the commands for its store.
    pub(crate) fn command(&self, name: &str) -> Command {
        command(name, self.folder.path(), self.database.as_deref())
    }

    /// The folder with its data and its log.
    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Where its PostgreSQL is, when it has one.
    pub(crate) fn database(&self) -> Option<&str> {
        self.database.as_deref()
    }

    /// A request to be completed and given to [`Server::send`].
    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.client.request(method, format!("{}{path}", self.address))
    }

    /// Sends a request and checks the answer.
    pub(crate) fn send(&self, request: RequestBuilder) -> Reply {
        let request = request.build().unwrap();
        let (method, path) = (request.method().clone(), request.url().path().to_owned());
        self.remember(&request);
        let reply = wait(async {
            let response = self.client.execute(request).await.unwrap();
            let (status, headers) = (response.status().as_u16(), response.headers().clone());
            // The events of a tenant do not end: their beginning is enough.
            let is_endless = status == 200 && path == "/v1/events";
            let body =
                if is_endless { beginning(response).await } else { response.bytes().await.unwrap().to_vec() };
            Reply { status, headers, body }
        });
        reply.check(&format!("{method} {path}"), method == Method::HEAD);
        reply
    }

    /// `GET`.
    pub(crate) fn get(&self, path: &str) -> Reply {
        self.send(self.request(Method::GET, path))
    }

    /// `DELETE`.
    pub(crate) fn delete(&self, path: &str) -> Reply {
        self.send(self.request(Method::DELETE, path))
    }

    /// `POST` of JSON.
    pub(crate) fn post(&self, path: &str, body: &Value) -> Reply {
        self.send(self.request(Method::POST, path).json(body))
    }

    /// `POST` of bytes that say they are of `media_type`.
    pub(crate) fn post_bytes(&self, path: &str, media_type: &str, body: impl Into<Vec<u8>>) -> Reply {
        self.send(self.request(Method::POST, path).header(CONTENT_TYPE, media_type).body(body.into()))
    }

    /// `POST` of one shape a line.
    pub(crate) fn post_lines(&self, path: &str, lines: &[Value]) -> Reply {
        let text: Vec<String> = lines.iter().map(ToString::to_string).collect();
        self.post_bytes(path, "application/x-ndjson", text.join("\n"))
    }

    /// Keeps some of what the request says, to look for it in the log.
    fn remember(&self, request: &reqwest::Request) {
        let mut sent = self.sent.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let body = request.body().and_then(reqwest::Body::as_bytes).unwrap_or_default();
        if sent.len() < MAX_MARKS && body.len() < MAX_MARKED_BYTES {
            sent.extend(
                request.url().query_pairs().map(|(_, value)| value.into_owned()).filter(|v| is_mark(v)),
            );
            match serde_json::from_slice(body) {
                Ok(document) => collect_marks("", &document, &mut sent),
                Err(_) => body
                    .split(|byte| *byte == b'\n')
                    .filter_map(|line| serde_json::from_slice(line).ok())
                    .for_each(|line| collect_marks("", &line, &mut sent)),
            }
        }
    }

    /// Asserts that the process lives and answers.
    pub(crate) fn assert_alive(&self) {
        assert_eq!(self.get("/livez").status, 204, "the log: {}", self.log());
    }

    /// Id of the process.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the process to end by itself.
    pub(crate) fn ended(mut self) -> std::process::ExitStatus {
        self.child.wait().unwrap()
    }

    /// Ends the process at once, as `kill -9` does; the same folder can then be opened again.
    pub(crate) fn kill(mut self) -> Setting {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        let folder = Arc::clone(&self.folder);
        Setting {
            folder,
            database: self.database.clone(),
            flags: Vec::new(),
            environment: Vec::new(),
            example: false,
            limit: None,
        }
    }
}

impl Server {
    /// Asks the process to stop and waits until it has; the same folder can then be opened again.
    #[cfg(unix)]
    pub(crate) fn terminate(mut self) -> Setting {
        // A shell has it built in; a machine without procps has no program of that name.
        let kill =
            Command::new("sh").args(["-c", "kill -TERM $0", &self.child.id().to_string()]).status().unwrap();
        assert!(kill.success() && self.child.wait().unwrap().success(), "the log: {}", self.log());
        let (folder, database) = (Arc::clone(&self.folder), self.database.clone());
        Setting { folder, database, flags: Vec::new(), environment: Vec::new(), example: false, limit: None }
    }
}

impl Server {
    /// Empties the log, all of whose errors say `expected`.
    #[cfg(unix)]
    pub(crate) fn set_aside_errors(&self, expected: &str) {
        let log = self.log();
        let other = log.lines().find(|line| line.contains("ERROR") && !line.contains(expected));
        assert_eq!(other, None, "expected errors that say '{expected}'");
        // The service appends.
        File::options().write(true).truncate(true).open(&self.log).unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself; then the log says why.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if !std::thread::panicking() {
            let log = self.log();
            let bad = log.lines().find(|line| line.contains("panicked") || line.contains("ERROR"));
            assert_eq!(bad, None, "the log of the server has errors");
            let sent = self.sent.lock().unwrap();
            let leaked = sent.iter().find(|mark| log.contains(mark.as_str()));
            let line = leaked.and_then(|mark| log.lines().find(|line| line.contains(mark.as_str())));
            assert_eq!(leaked, None, "what a client has sent is in the log: {line:?}");
        }
    }
}

/// Most texts and numbers that are looked for in a log.
const MAX_MARKS: usize = 300;
/// Longest body that is looked through for them.
const MAX_MARKED_BYTES: usize = 1 << 18;
/// Fields whose texts belong to the client.
const PRIVATE_FIELDS: [&str; 7] =
    ["name", "description", "external_id", "subject", "label", "labels", "metadata"];

/// Whether a text can be told from what the log says anyway: it is long enough, and not the id of a key.
fn is_mark(text: &str) -> bool {
    text.len() >= 9 && !text.starts_with("key_")
}

/// The texts of private fields, and numbers of many digits, below `field`.
fn collect_marks(field: &str, value: &Value, marks: &mut BTreeSet<String>) {
    let mark = match value {
        Value::Object(fields) => {
            let is_private = PRIVATE_FIELDS.contains(&field);
            return fields.iter().for_each(|(own, value)| {
                collect_marks(if is_private { field } else { own }, value, marks);
            });
        }
        Value::Array(items) => return items.iter().for_each(|item| collect_marks(field, item, marks)),
        Value::String(text) if PRIVATE_FIELDS.contains(&field) => text.clone(),
        Value::Number(number) if number.is_f64() => number.to_string(),
        _ => return,
    };
    if is_mark(&mark) {
        marks.insert(mark);
    }
}

/// An answer.
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Reply {
    /// A header as text.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.get(name).map(|value| value.to_str().unwrap())
    }

    /// The body as text.
    pub(crate) fn text(&self) -> &str {
        std::str::from_utf8(&self.body).unwrap()
    }

    /// The body as JSON, whatever the status.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    /// The JSON body of an answer with this status.
    #[track_caller]
    pub(crate) fn expect(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        self.json()
    }

    /// A drawing: an SVG element that is closed, of finite numbers.
    #[track_caller]
    pub(crate) fn expect_svg(&self) -> &str {
        assert_eq!(self.status, 200, "{}", self.text());
        assert_eq!(self.header("content-type"), Some("image/svg+xml"));
        let svg = self.text();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("<g ").count(), svg.matches("</g>").count());
        svg
    }

    /// A refusal: status, code, and exactly these pointers in any order.
    #[track_caller]
    pub(crate) fn expect_problem(&self, status: u16, code: &str, pointers: &[&str]) -> Value {
        let problem = self.expect(status);
        assert_eq!(problem["code"], code, "{problem}");
        let mut found = pointers_of(&problem);
        let mut wanted: Vec<String> = pointers.iter().map(ToString::to_string).collect();
        found.sort();
        wanted.sort();
        assert_eq!(found, wanted, "pointers of {problem}");
        problem
    }

    fn check(&self, what: &str, head: bool) {
        let id = self.header("x-request-id").unwrap_or_else(|| panic!("{what}: no x-request-id"));
        self.check_headers(what);
        assert!(
            self.status < 500 || [503, 507].contains(&self.status),
            "{what}: {} {}",
            self.status,
            self.text()
        );
        if head {
            assert!(self.body.is_empty(), "{what}: HEAD with a body");
        } else if self.status >= 400 {
            self.check_problem(what, id);
        } else if self.header("content-type") == Some("application/json")
            && self.header("content-encoding").is_none()
            // Tables have missing values, and so have examples of the document.
            && !what.ends_with("/table")
            && !what.ends_with("/openapi.json")
        {
            assert_eq!(null_in_a_list(&self.json()), None, "{what}: a number was lost");
        }
    }

    /// What browsers are told by every answer.
    fn check_headers(&self, what: &str) {
        let is = |name: &str, wanted: &str| assert_eq!(self.header(name), Some(wanted), "{what}: {name}");
        is("x-content-type-options", "nosniff");
        is("referrer-policy", "no-referrer");
        is("cross-origin-resource-policy", "same-origin");
        let policy = self.header("content-security-policy");
        if self.status == 304 && what.contains(" /v1/") {
            assert_eq!(policy, None, "{what}: the one that the browser has already");
        } else {
            let policy = policy.unwrap_or_default();
            assert!(policy.starts_with("default-src 'none'"), "{what}: {policy}");
            assert!(policy.ends_with("frame-ancestors 'none'"), "{what}: {policy}");
        }
        if what.contains(" /v1/") {
            // Caches store no shapes of persons, though these have entity tags.
            let is_stored = self.header("etag").is_some() && !what.contains("/shapes");
            let is_of_version = what.contains("/dictionaries/dic_") || what.contains('@');
            match self.header("cache-control") {
                Some("private, max-age=86400, immutable") if is_stored && is_of_version => {}
                _ => is("cache-control", if is_stored { "private, no-cache" } else { "no-store" }),
            }
        }
    }

    fn check_problem(&self, what: &str, id: &str) {
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{what}");
        let problem = self.json();
        let fields: Vec<&str> = problem.as_object().unwrap().keys().map(String::as_str).collect();
        let wanted = ["code", "detail", "errors", "request_id", "status", "title", "type"];
        let mut sorted = fields.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, wanted, "{what}: {problem}");
        assert_eq!(problem["status"], self.status, "{what}: {problem}");
        assert_eq!(problem["request_id"], id, "{what}: {problem}");
        let code = problem["code"].as_str().unwrap();
        assert_eq!(problem["type"], format!("urn:shapelex:problem:{code}"), "{what}");
        assert!(!problem["title"].as_str().unwrap().is_empty(), "{what}: {problem}");
        assert!(!problem["detail"].as_str().unwrap().is_empty(), "{what}: {problem}");
        for error in problem["errors"].as_array().unwrap() {
            match (error["pointer"].as_str(), error["parameter"].as_str()) {
                (Some(pointer), None) => {
                    assert!(pointer.is_empty() || pointer.starts_with('/'), "{what}: {error}");
                }
                (None, Some(name)) => assert!(!name.is_empty(), "{what}: {error}"),
                _ => panic!("neither a pointer nor a parameter, or both: {what}: {error}"),
            }
            assert!(!error["detail"].as_str().unwrap().is_empty(), "{what}: {error}");
        }
    }
}

/// The pointers of the errors of a problem document, in order.
pub(crate) fn pointers_of(problem: &Value) -> Vec<String> {
    let errors = problem["errors"].as_array().unwrap();
    // Faults of parameters have a name in place of a pointer.
    let of_body = errors.iter().filter(|error| error["parameter"].is_null());
    of_body.map(|error| error["pointer"].as_str().unwrap().to_owned()).collect()
}

/// Where a list holds null: a number that was not finite is written so.
fn null_in_a_list(value: &Value) -> Option<String> {
    match value {
        Value::Array(items) => items.iter().enumerate().find_map(|(i, item)| {
            if item.is_null() {
                Some(format!("/{i}"))
            } else {
                null_in_a_list(item).map(|p| format!("/{i}{p}"))
            }
        }),
        Value::Object(map) => map
            .iter()
            // What the client gave comes back as it was; shapes that were not stored have no id, and edges of surfaces no curvature.
            .filter(|(key, _)| !["metadata", "labels", "ids", "principal_curvatures"].contains(&key.as_str()))
            .find_map(|(key, item)| null_in_a_list(item).map(|p| format!("/{key}{p}"))),
        _ => None,
    }
}

/// Rows of points as one list of numbers.
pub(crate) fn flat(points: &Value) -> Vec<f64> {
    match points {
        Value::Array(items) => items.iter().flat_map(flat).collect(),
        number => vec![number.as_f64().unwrap_or_else(|| panic!("{number} is not a number"))],
    }
}

/// Asserts that two lists of numbers agree within `tolerance`, relative to the largest wanted one (at least 1).
#[track_caller]
pub(crate) fn assert_close(found: &Value, wanted: &Value, tolerance: f64, what: &str) {
    let (found, wanted) = (flat(found), flat(wanted));
    assert_eq!(found.len(), wanted.len(), "{what}: lengths");
    let scale = wanted.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    for (i, (a, b)) in found.iter().zip(&wanted).enumerate() {
        assert!(
            (a - b).abs() <= tolerance * scale,
            "{what}[{i}]: {a} for {b} (tolerance {tolerance} · {scale})"
        );
    }
}

#[test]
fn what_is_looked_for_in_logs_is_what_belongs_to_the_client() {
    let sent = serde_json::json!({"name": "a-cohort-name", "kind": "closed_curve", "points": [[1_234.567_890_12, 3], [0.5, 1.25]],
        "labels": {"treatment": "a-treatment"}, "metadata": {"deep": {"er": ["a-note-deep-inside"]}}, "subject": "short"});
    let mut marks = BTreeSet::new();
    collect_marks("", &sent, &mut marks);
    let wanted = ["1234.56789012", "a-cohort-name", "a-note-deep-inside", "a-treatment"];
    assert_eq!(marks.iter().map(String::as_str).collect::<Vec<_>>(), wanted);
}

/// `found` against `wanted`, relative to `wanted`.
#[track_caller]
pub(crate) fn assert_relative(what: &str, found: f64, wanted: f64, tolerance: f64) {
    let error = (found - wanted).abs() / wanted.abs();
    assert!(error <= tolerance, "{what}: {found:e} for {wanted:e}, relative error {error:.1e}");
}
