//! The commands for a store, as their operator runs them: beside the service, killed in the middle, on a full disk.

use std::io::Write as _;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Server, Setting, in_blocks, wait};

/// Shapes of an upload.
const SHAPES: usize = 40;

/// What a store answers, by path.
type Answers = Vec<(String, Option<String>, String)>;

fn shape(number: usize) -> Value {
    let x = number as f64;
    json!({"external_id": format!("s{number}"), "label": format!("l{}", number % 2), "metadata": {"n": 0.1 * x, "π": "\"\n"},
        "points": [[0, 0], [3.0 + (x * 0.7).sin(), 0.1 * x], [1.0, 2.0 + (x * 1.3).cos()], [-1.5, 0.3 * x.sin()]]})
}

fn shapes(numbers: std::ops::Range<usize>) -> Value {
    json!({"shapes": numbers.map(shape).collect::<Vec<_>>()})
}

fn create_cohort(server: &Server, name: &str) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    let cohort = json!({"name": name, "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
}

/// Something of everything.
fn fill(server: &Server) {
    create_cohort(server, "c");
    server.post("/v1/cohorts/c/shapes", &shapes(0..SHAPES)).expect(201);
    let more = server.request(Method::POST, "/v1/cohorts/c/shapes").header("idempotency-key", "more");
    server.send(more.json(&shapes(SHAPES..2 * SHAPES))).expect(201);
    assert_eq!(server.delete("/v1/cohorts/c/shapes/s3").status, 204);
    create_cohort(server, "trashed");
    assert_eq!(server.delete("/v1/cohorts/trashed").status, 204);
    let learn = json!({"name": "modes", "cohort": "c", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2}});
    for _ in 0..2 {
        let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50");
        server.send(request.json(&learn)).expect(201);
    }
}

fn answers(server: &Server) -> Answers {
    let paths = [
        "/v1/cohorts",
        "/v1/cohorts/c",
        "/v1/cohorts/c/shapes?limit=1000",
        "/v1/cohorts/c/shapes/s7",
        "/v1/cohorts/c/mean?transformation=similarity",
        "/v1/dictionaries",
        "/v1/dictionaries/modes@1",
        "/v1/dictionaries/modes/atoms",
        "/v1/dictionaries/modes/export",
        "/v1/jobs",
        "/v1/changes?since=0",
        "/v1/trash",
    ];
    let answer = |path: &str| {
        let reply = server.get(path);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        (path.to_owned(), reply.header("etag").map(str::to_owned), reply.text().to_owned())
    };
    paths.into_iter().map(answer).collect()
}

/// Runs a command to its end: its exit code and what it said.
fn run(command: &mut Command) -> (i32, String) {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let said = String::from_utf8(stdout).unwrap() + &String::from_utf8(stderr).unwrap();
    (status.code().unwrap(), said)
}

#[track_caller]
fn done(command: &mut Command) -> String {
    let (code, said) = run(command);
    assert_eq!(code, 0, "{said}");
    said
}

#[track_caller]
fn assert_clean(command: &mut Command) {
    let said = done(command);
    assert!(said.contains(": no findings"), "{said}");
}

#[test]
fn a_backup_beside_the_running_service_comes_back() {
    let server = Setting::fresh().embedded().start();
    fill(&server);
    let before = answers(&server);
    let file = server.folder().join("backup");
    done(server.command("backup").arg(&file));
    // What came after it is not in it.
    server.post("/v1/cohorts/c/shapes", &shapes(100..105)).expect(201);
    assert_clean(&mut server.command("check"));
    let (code, said) = run(server.command("backup").arg(&file));
    assert_eq!((code, said.contains("already exists")), (2, true), "{said}");
    let (code, said) = run(server.command("restore").arg(&file));
    assert!(code == 2 && said.contains("in use by another process"), "{said}");

    let place = Setting::fresh().embedded();
    let said = done(place.command("restore").arg(&file));
    assert!(said.contains("1 cohorts, ") || said.contains("2 cohorts, "), "{said}");
    assert_clean(&mut place.command("check"));
    let restored = place.start();
    assert_eq!(answers(&restored), before);
    restored.post("/v1/cohorts/c/shapes", &shapes(100..105)).expect(201);
}

#[test]
fn a_backup_during_writes_is_one_moment() {
    let server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    let file = server.folder().join("backup");
    let mut backup = server.command("backup").arg(&file).stdout(Stdio::null()).spawn().unwrap();
    let mut uploads = 0;
    while backup.try_wait().unwrap().is_none() || uploads == 0 {
        server.post("/v1/cohorts/c/shapes", &shapes(uploads * 10..uploads * 10 + 10)).expect(201);
        uploads += 1;
    }
    assert!(backup.wait().unwrap().success());
    let place = Setting::fresh().embedded();
    done(place.command("restore").arg(&file));
    let restored = place.start();
    let cohort = restored.get("/v1/cohorts/c").expect(200);
    let revision = cohort["revision"].as_u64().unwrap();
    assert!(revision <= uploads as u64, "{revision} of {uploads}");
    assert_eq!(cohort["shape_count"], 10 * revision, "whole uploads only");
}

#[test]
fn an_export_moves_between_databases() {
    let source = Setting::fresh().embedded().start();
    fill(&source);
    let before = answers(&source);
    let folder = source.folder().to_path_buf();
    let (first, second) = (folder.join("first"), folder.join("second"));
    done(source.command("export").arg(&first));
    let (code, said) = run(source.command("export").arg(&first));
    assert_eq!((code, said.contains("already exists")), (2, true), "{said}");

    // PostgreSQL, where the tests have one.
    let middle = Setting::fresh();
    done(middle.command("import").arg(&first));
    assert_clean(&mut middle.command("check"));
    let (code, said) = run(middle.command("import").arg(&first));
    assert_eq!((code, said.contains("not empty")), (2, true), "{said}");
    let middle = middle.start();
    assert_eq!(answers(&middle), before, "in the middle");
    let stdout = std::fs::File::create(&second).unwrap();
    assert!(middle.command("export").arg("-").stdout(stdout).status().unwrap().success());

    let last = Setting::fresh().embedded();
    let mut import =
        last.command("import").arg("-").stdin(std::fs::File::open(&second).unwrap()).spawn().unwrap();
    assert!(import.wait().unwrap().success());
    assert_clean(&mut last.command("check"));
    let last = last.start();
    assert_eq!(answers(&last), before, "at the end");
    // Numbers go on where they stopped, and what was done once is not done again.
    let more = last.request(Method::POST, "/v1/cohorts/c/shapes").header("idempotency-key", "more");
    assert_eq!(last.send(more.json(&shapes(SHAPES..2 * SHAPES))).expect(201)["added"], SHAPES);
    assert_eq!(last.get("/v1/cohorts/c").expect(200), serde_json::from_str::<Value>(&before[1].2).unwrap());
    create_cohort(&last, "next");
    last.post("/v1/cohorts/next/shapes", &shapes(0..3)).expect(201);
    assert_clean(&mut last.command("check"));
}

#[test]
fn a_killed_import_leaves_nothing() {
    let source = Setting::fresh().embedded().start();
    fill(&source);
    let before = answers(&source);
    let export = source.command("export").arg("-").output().unwrap().stdout;
    let target = Setting::fresh();
    for tenths in [1, 5, 9, 10] {
        let mut import = target.command("import").arg("-").stdin(Stdio::piped()).spawn().unwrap();
        let mut stdin = import.stdin.take().unwrap();
        // All but the end, which the command waits for.
        stdin.write_all(&export[..(export.len() - 2) * tenths / 10]).unwrap();
        stdin.flush().unwrap();
        std::thread::sleep(Duration::from_millis(300));
        import.kill().unwrap();
        import.wait().unwrap();
    }
    // An end that comes too early, in order.
    let mut import = target.command("import").arg("-").stdin(Stdio::piped()).spawn().unwrap();
    import.stdin.take().unwrap().write_all(&export[..export.len() - 2]).unwrap();
    assert_eq!(import.wait().unwrap().code(), Some(2));
    let said = done(&mut target.command("check"));
    assert!(said.contains("checked 0 cohorts, 0 shapes in 0 chunks"), "{said}");
    let file = source.folder().join("export");
    std::fs::write(&file, &export).unwrap();
    done(target.command("import").arg(&file));
    assert_eq!(answers(&target.start()), before);
}

#[test]
fn a_killed_restore_leaves_nothing_half() {
    let server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    let lines: Vec<Value> = (0..20_000).map(shape).collect();
    server.post_lines("/v1/cohorts/c/shapes", &lines).expect(201);
    let file = server.folder().join("backup");
    done(server.command("backup").arg(&file));
    let mut unfinished = 0;
    for pause in [0, 10, 20, 40, 80, 160, 320] {
        let place = Setting::fresh().embedded();
        let mut restore = place.command("restore").arg(&file).stdout(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(pause));
        restore.kill().unwrap();
        restore.wait().unwrap();
        if run(place.command("migrate").arg("--check")).0 == 2 {
            // There is no store: the same command makes it.
            unfinished += 1;
            done(place.command("restore").arg(&file));
        }
        let said = done(&mut place.command("check"));
        assert!(said.contains("20000 shapes") && said.contains("no findings"), "{pause} ms: {said}");
    }
    assert!(unfinished > 0, "none was killed in time");
}

/// Changes a byte of the first place of `pattern` in a file.
fn flip(file: &Path, pattern: &[u8]) {
    let mut bytes = std::fs::read(file).unwrap();
    let place = bytes.windows(pattern.len()).position(|window| window == pattern).unwrap();
    bytes[place] ^= 1;
    std::fs::write(file, bytes).unwrap();
}

#[test]
fn damage_is_found_and_not_copied_into_a_new_store() {
    let server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    let points = json!([[0.125, 7.0], [12345.678, 1], [2, 3], [4, 9]]);
    server.post("/v1/cohorts/c/shapes", &json!({"shapes": [{"points": points}]})).expect(201);
    let backup = server.folder().join("backup");
    done(server.command("backup").arg(&backup));
    let place = Setting::fresh().embedded();
    done(place.command("restore").arg(&backup));
    assert_clean(&mut place.command("check"));

    flip(&backup, &12345.678_f64.to_le_bytes());
    let other = Setting::fresh().embedded();
    let (code, said) = run(other.command("restore").arg(&backup));
    assert_eq!(code, 2, "{said}");
    assert!(said.contains("do not match their checksum") && said.contains("findings: 1"), "{said}");
    let (code, said) = run(&mut other.command("check"));
    assert_eq!((code, said.contains("no store in")), (2, true), "{said}");

    let damaged = server.folder().join("damaged");
    std::fs::create_dir(&damaged).unwrap();
    std::fs::rename(&backup, damaged.join("shapelex.db")).unwrap();
    let mut check = Command::new(env!("CARGO_BIN_EXE_shapelex"));
    let (code, said) = run(check.arg("check").arg("--data-dir").arg(&damaged).env_remove("DATABASE_URL"));
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("the points of chunk 1 do not match their checksum"), "{said}");
    assert!(said.ends_with(": 1 finding\n"), "{said}");
}

#[test]
fn the_schema_is_brought_up_to_date_by_hand() {
    let place = Setting::fresh();
    if std::env::var("SHAPELEX_TEST_DATABASE_URL").is_err() {
        assert_eq!(run(place.command("migrate").arg("--check")).0, 2, "there is no store");
    } else {
        assert_eq!(run(place.command("migrate").arg("--check")).0, 1, "an empty database");
    }
    assert!(done(&mut place.command("migrate")).contains("a new store"));
    assert!(done(&mut place.command("migrate")).contains("up to date"));
    assert!(done(place.command("migrate").arg("--check")).contains("up to date"));
    assert_clean(&mut place.command("check"));
}

/// Shapes that no request of this test stores twice.
fn large(round: usize) -> Vec<Value> {
    (0..2000).map(|k| shape(round * 2000 + k)).collect()
}

#[test]
fn a_store_that_cannot_grow_answers_and_stays_whole() {
    // Files of at most 3 MiB: the database, and its write-ahead log.
    let server = Setting::fresh().embedded().file_blocks(6 * 1024).start();
    create_cohort(&server, "c");
    let (mut stored, mut refused) = (0, 0);
    for round in 0..40 {
        let reply = server.post_lines("/v1/cohorts/c/shapes", &large(round));
        match reply.status {
            201 => stored += 1,
            status => {
                assert!(status == 507 || status == 503, "{}", reply.text());
                refused += 1;
            }
        }
        let cohort = server.get("/v1/cohorts/c").expect(200);
        assert_eq!(cohort["shape_count"], 2000 * stored, "round {round}");
        if refused == 3 {
            break;
        }
    }
    assert!(stored > 0 && refused == 3, "{stored} stored, {refused} refused");
    server.get("/v1/cohorts/c/mean?transformation=similarity").expect(200);
    server.get("/v1/cohorts/c/shapes?limit=1000").expect(200);
    assert_clean(&mut server.command("check"));
    // Where the last page was taken decides whether entries of the audit trail find room.
    server.set_aside_errors("the audit trail cannot be written");
    // With room, everything that was answered is there, and writing goes on.
    let server = server.kill().start();
    assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 2000 * stored);
    server.post_lines("/v1/cohorts/c/shapes", &large(50)).expect(201);
    assert_clean(&mut server.command("check"));
}

/// Starts a service on a store without its log, and returns it with its address.
fn started(command: &mut Command) -> (Child, String) {
    command.args(["--listen", "127.0.0.1:0", "--no-example"]).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    let mut stdout = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut stdout, &mut line).unwrap();
    // The pipe stays open: the service writes another line.
    child.stdout = Some(stdout.into_inner());
    let address = line.trim().strip_prefix("shapelex is listening on ").expect("it starts").to_owned();
    (child, address)
}

#[cfg(unix)]
#[test]
fn a_store_on_a_full_disk_is_opened_for_reading_and_is_not_ready() {
    let mut server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    server.post_lines("/v1/cohorts/c/shapes", &large(0)).expect(201);
    for in_order in [true, false] {
        let setting = if in_order { server.terminate() } else { server.kill() };
        // There is not even room for the index of the log.
        let (mut child, address) = started(&mut in_blocks(&setting.command("serve"), 8));
        let ask = |method: Method, path: &str| {
            let request = reqwest::Client::new().request(method, format!("{address}{path}"));
            wait(async { request.send().await.unwrap() })
        };
        let cohort = ask(Method::GET, "/v1/cohorts/c");
        let cohort: Value = serde_json::from_str(&wait(cohort.text()).unwrap()).unwrap();
        assert_eq!(cohort["shape_count"], 2000, "in order: {in_order}");
        for path in ["/v1/cohorts/c/mean?transformation=similarity", "/v1/cohorts/c/shapes?limit=1000"] {
            assert_eq!(ask(Method::GET, path).status(), 200, "{path}, in order: {in_order}");
        }
        let ready = ask(Method::GET, "/readyz");
        assert_eq!(ready.status(), 503);
        let said = wait(ready.text()).unwrap();
        assert!(said.contains("does not accept writes: the"), "{said}");
        let refused = ask(Method::DELETE, "/v1/cohorts/c").status().as_u16();
        assert!([503, 507].contains(&refused), "{refused}");
        child.kill().unwrap();
        child.wait().unwrap();
        server = setting.start();
        assert_eq!(server.get("/readyz").status, 204);
        assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 2000);
        assert_clean(&mut server.command("check"));
    }
}

#[test]
fn a_wrong_start_is_refused_before_anything_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let command = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
        command.arg("serve").arg("--data-dir").arg(&data).env_remove("DATABASE_URL");
        command
    };
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    for (arguments, wanted) in [
        (&["--listen", &format!("localhost:{port}")][..], "cannot listen on 127.0.0.1"),
        (
            &["--listen", "8080"],
            "expected an address such as 127.0.0.1:8080, localhost:8080 or :8080, got '8080'",
        ),
        (&["--database-url", "mysql://a:secret@b/c", "--listen", "localhost:0"], "got mysql://"),
        (&["--max-body-bytes", "64 parsecs"], "such as 67108864, 64MiB or 64MB, got '64 parsecs'"),
    ] {
        let (code, said) = run(command().args(arguments));
        assert!(
            code != 0 && said.contains(wanted) && !said.contains("secret"),
            "{arguments:?}: {code}: {said}"
        );
    }
    for name in ["serve", "check"] {
        let (code, said) =
            run(Command::new(env!("CARGO_BIN_EXE_shapelex")).arg(name).env("SHAPELEX_THREDS", "2"));
        assert!(
            code != 0 && said.contains("SHAPELEX_THREDS (did you mean SHAPELEX_THREADS?)"),
            "{code}: {said}"
        );
    }
    assert!(!data.exists());
}

#[cfg(unix)]
#[test]
fn a_hangup_does_not_end_a_service_without_a_certificate() {
    let server = Server::fresh();
    let hangup = Command::new("sh").args(["-c", "kill -HUP $0", &server.id().to_string()]).status().unwrap();
    assert!(hangup.success());
    std::thread::sleep(Duration::from_millis(300));
    server.assert_alive();
}

#[test]
fn a_store_whose_log_is_gone_is_refused_until_the_loss_is_accepted() {
    let server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    server.post_lines("/v1/cohorts/c/shapes", &large(0)).expect(201);
    let folder = server.folder().join("data");
    let setting = server.kill();
    std::fs::remove_file(folder.join("shapelex.db-wal")).unwrap();
    let refusals = [
        run(&mut setting.command("check")),
        run(setting.command("serve").args(["--listen", "127.0.0.1:0"])),
        run(setting.command("export").arg("-")),
    ];
    for (code, said) in &refusals {
        assert!(*code != 0 && said.contains("the store is older than it was"), "{code}: {said}");
    }
    assert_eq!(refusals[0].0, 1, "a finding");
    let server = setting.flags(&["--accept-loss", "true"]).start();
    server.get("/v1/cohorts/c").expect(404);
    assert!(server.log().contains("which is accepted"), "{}", server.log());
    let server = server.kill().start();
    create_cohort(&server, "c");
    assert_clean(&mut server.command("check"));
}

#[cfg(unix)]
#[test]
fn after_an_orderly_stop_the_file_alone_is_the_store() {
    let server = Setting::fresh().embedded().start();
    create_cohort(&server, "c");
    server.post_lines("/v1/cohorts/c/shapes", &large(0)).expect(201);
    let data = server.folder().join("data");
    let setting = server.terminate();
    for name in ["shapelex.db-wal", "shapelex.db-shm"] {
        assert!(std::fs::metadata(data.join(name)).map_or(0, |about| about.len()) == 0, "{name}");
        // It may be gone already.
        let _ = std::fs::remove_file(data.join(name));
    }
    let server = setting.start();
    assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 2000);
    assert_clean(&mut server.command("check"));
}

#[test]
fn the_clock_is_confirmed_beside_the_service() {
    let server = Setting::fresh().start();
    assert!(done(&mut server.command("confirm-clock")).contains("the clock is trusted: it shows 20"));
}

#[test]
fn the_start_names_the_example_only_where_it_exists() {
    for (flags, wanted) in [(&["--no-example"][..], false), (&[], true)] {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(folder.path().join("data"));
        command.args(flags).env_remove("DATABASE_URL").stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let lines = std::io::BufReader::new(child.stdout.take().unwrap());
        // The last line of the start of an open service.
        let said: Vec<String> = std::io::BufRead::lines(lines)
            .map(Result::unwrap)
            .take_while(|line| !line.starts_with("access is open"))
            .collect();
        child.kill().unwrap();
        child.wait().unwrap();
        let named = said.iter().any(|line| line.contains("example-cells"));
        assert_eq!(named, wanted, "{flags:?}: {said:?}");
    }
}
