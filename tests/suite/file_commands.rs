//! Files of shapes on the command line: described, translated, into a cohort and out of it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

use crate::form::label_picture;
use crate::server::{Server, Setting};

const LINES: &str = concat!(
    r#"{"points":[[0.0,0.0],[4.0,0.0],[4.0,1.0]],"external_id":"first","label":"a"}"#,
    "\n",
    r#"{"points":[[0.0,0.0],[3.0,0.0],[4.0,2.0]],"external_id":"second"}"#,
    "\n",
);

/// Exit code, standard output and standard error.
fn run(command: &mut Command) -> (i32, String, String) {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (status.code().unwrap(), text(stdout), text(stderr))
}

fn shapelex(arguments: &[&str], folder: &Path) -> (i32, String, String) {
    run(Command::new(env!("CARGO_BIN_EXE_shapelex")).args(arguments).current_dir(folder))
}

/// A folder with a file of lines, an image, a broken file and one of no format.
fn files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    std::fs::create_dir(folder.path().join("scans")).unwrap();
    write("scans/a.ndjson", LINES.as_bytes());
    write("scans/b.ndjson", b"{\"points\":[[0,0],[1]]}\n");
    write("scans/notes.txt", b"not a shape");
    write("cells.png", &label_picture());
    folder
}

fn create(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let cohort = json!({"name": "c", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
}

#[test]
fn files_are_described_without_a_service() {
    let folder = files();
    let (code, said, _) = shapelex(&["inspect", "scans/a.ndjson", "c*.png"], folder.path());
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("scans/a.ndjson: NDJSON, 2 shapes"), "{said}");
    assert!(said.contains("cells.png: PNG, 3 shapes") && said.contains("left out: 1 holes"), "{said}");
    let (code, said, _) = shapelex(&["inspect", "--json", "scans"], folder.path());
    assert_eq!(code, 1, "{said}");
    let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((&lines[0]["format"], &lines[0]["groups"][0]["records"]), (&json!("ndjson"), &json!(2)));
    assert!(lines[1]["error"].as_str().unwrap().starts_with("line 1: expected 2 coordinates"), "{said}");
    assert_eq!(shapelex(&["inspect", "scans/b.ndjson"], folder.path()).0, 2);
    assert_eq!(shapelex(&["inspect", "nothing"], folder.path()).0, 2);
}

#[test]
fn files_are_translated_without_a_service() {
    let folder = files();
    let (code, said, summary) = shapelex(
        &["convert", "cells.png", "--option", "holes=keep", "--option", "select=3", "--json"],
        folder.path(),
    );
    assert_eq!((code, said.lines().count()), (0, 2), "{said} {summary}");
    let summary: Value = serde_json::from_str(summary.trim()).unwrap();
    assert_eq!(
        (&summary["from"], &summary["to"], &summary["records"]),
        (&json!("png"), &json!("ndjson"), &json!(2))
    );
    let same = ["convert", "scans/a.ndjson", "--output", "copy.ndjson"];
    assert_eq!(shapelex(&same, folder.path()).0, 0);
    assert_eq!(std::fs::read_to_string(folder.path().join("copy.ndjson")).unwrap(), LINES);
    let (code, _, said) = shapelex(&same, folder.path());
    assert!(code == 2 && said.contains("already exists"), "{said}");
    let piped = ["convert", "scans/a.ndjson", "-o", "-"];
    assert_eq!(shapelex(&piped, folder.path()).1, LINES);
    assert!(!folder.path().join("-").exists());
    let regions = ["convert", "cells.png", "-o", "cells.roi.zip", "--json"];
    let (code, _, said) = shapelex(&regions, folder.path());
    assert!(code == 0 && said.contains("imagej-roi-set"), "{said}");
    for (arguments, wanted) in [
        (&["convert", "scans/b.ndjson", "--output", "x.ndjson"][..], "line 1: expected 2 coordinates"),
        (&["convert", "scans/notes.txt"], "expected a file of one of the formats"),
        (&["convert", "cells.png", "--to", "word"], "expected one of the formats"),
        (&["convert", "cells.png", "--option", "colour=red"], "expected an option of reading"),
        (&["convert", "cells.png", "--option", "holes"], "expected an option NAME=VALUE"),
    ] {
        let (code, _, said) = shapelex(arguments, folder.path());
        assert!(code == 2 && said.contains(wanted), "{arguments:?}: {said}");
    }
    let left: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().starts_with("x.ndjson")), "{left:?}");
}

#[test]
fn folders_go_into_a_service_once() {
    let (server, folder) = (Server::fresh(), files());
    create(&server);
    let import = |more: &[&str]| {
        let common = ["import", "scans", "--cohort", "c", "--server", server.address(), "--json"];
        shapelex(&[&common[..], more].concat(), folder.path())
    };
    let (code, said, _) = import(&["--journal", "journal"]);
    let status = |said: &str| -> Vec<String> {
        let line =
            |line: &str| serde_json::from_str::<Value>(line).unwrap()["status"].as_str().unwrap().to_owned();
        said.lines().map(line).collect()
    };
    assert_eq!(
        (code, status(&said)),
        (1, ["imported", "refused", "left_out"].map(str::to_owned).to_vec()),
        "{said}"
    );
    assert!(said.lines().nth(1).unwrap().contains("line 1"), "{said}");
    assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 2);
    // By the journal, and by the receipt of the service.
    for more in [&["--journal", "journal"][..], &[]] {
        let (code, said, _) = import(more);
        assert_eq!((code, status(&said)[0].as_str()), (1, "known"), "{said}");
    }
    let (code, _, said) =
        shapelex(&["import", "scans", "--cohort", "none", "--server", server.address()], folder.path());
    assert!(code == 2 && said.contains("cohort 'none' not found"), "{said}");
    let (code, _, said) = shapelex(&["import", "scans", "--server", server.address()], folder.path());
    assert!(code == 2 && said.contains("--cohort"), "{said}");
    let output = ["export", "out.ndjson", "--cohort", "c", "--server", server.address(), "--label", "a"];
    assert_eq!(shapelex(&output, folder.path()).0, 0);
    let text = std::fs::read_to_string(folder.path().join("out.ndjson")).unwrap();
    assert_eq!(text.lines().count(), 1);
}

#[test]
fn files_go_into_a_store_and_out_of_it() {
    let server = Setting::fresh().start();
    create(&server);
    let folder = files();
    let file = folder.path().join("scans/a.ndjson");
    // Beside the running service.
    let import = |more: &[&str]| {
        run(server.command("import").arg(&file).args(["--cohort", "c", "--prefix", "{file}/"]).args(more))
    };
    let (code, _, said) = import(&[]);
    assert!(code == 0 && said.contains("2 shapes added"), "{said}");
    let (code, _, said) = import(&[]);
    assert!(code == 0 && said.contains("imported before"), "{said}");
    server.get("/v1/cohorts/c/shapes/a%2Ffirst").expect(200);
    let (code, said, _) = run(server.command("export").arg("-").args(["--cohort", "c"]));
    assert_eq!((code, said.lines().count()), (0, 2), "{said}");
    let shape: Value = serde_json::from_str(said.lines().next().unwrap()).unwrap();
    assert_eq!((&shape["external_id"], &shape["points"][2]), (&json!("a/first"), &json!([4.0, 1.0])));
    // Options of files of shapes say nothing of a whole store.
    for (command, option) in [("export", "--write"), ("import", "--option")] {
        let (code, _, said) = run(server.command(command).arg(&file).args([option, "unit=mm"]));
        assert!(code == 2 && said.contains("expected --cohort"), "{said}");
    }
}

#[test]
fn what_a_cohort_would_take_is_told_and_nothing_is_stored() {
    let (server, folder) = (Setting::fresh().start(), files());
    create(&server);
    let file = folder.path().join("scans/a.ndjson");
    let scans = folder.path().join("scans");
    let service = ["--server", server.address()];
    // Of the store, and of the service that runs beside.
    for more in [&[][..], &service] {
        let ask = |command: &str, what: &std::path::Path, options: &[&str]| {
            run(server.command(command).arg(what).args(["--cohort", "c"]).args(more).args(options))
        };
        let (code, said, told) = ask("inspect", &file, &[]);
        assert!(code == 0 && said.contains("a.ndjson: 2 shapes would be added"), "{said} {told}");
        let (code, said, told) = ask("inspect", &scans, &["--json", "--prefix", "x/"]);
        let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!((code, lines.len(), &lines[0]["added"]), (1, 3, &json!(2)), "{said} {told}");
        assert!(lines[1]["error"].as_str().unwrap().starts_with("line 1: expected 2 coordinates"), "{said}");
        assert!(lines[2]["error"].is_string() && lines[0]["summary"]["records"] == 2, "{said}");
        let (code, said, told) = ask("import", &scans, &["--dry-run", "--json"]);
        let status = |line: &str| serde_json::from_str::<Value>(line).unwrap()["status"].clone();
        let statuses: Vec<Value> = said.lines().map(status).collect();
        assert_eq!(
            (code, statuses),
            (1, ["previewed", "refused", "left_out"].map(Value::from).to_vec()),
            "{told}"
        );
        let (code, _, told) = ask("inspect", &folder.path().join("scans/b.ndjson"), &[]);
        assert!(code == 2 && told.contains("would take none of the files"), "{told}");
        assert_eq!(server.get("/v1/cohorts/c").expect(200)["revision"], 0);
    }
    let import = run(server.command("import").arg(&file).args(["--cohort", "c"]));
    assert_eq!(import.0, 0, "{import:?}");
    std::fs::write(&file, LINES.replace("3.0,0.0", "3.5,0.0").replace("4.0,2.0", "0.0,0.0")).unwrap();
    for more in [&[][..], &service] {
        let looked = run(server.command("inspect").arg(&file).args(["--cohort", "c"]).args(more));
        let (code, said, told) = looked;
        assert!(code == 2 && told.contains("would take none"), "{said} {told}");
        let words = [
            "0 shapes would be added; 1 are there already; 1 cannot be stored, 1 of them under the names of others",
            "nothing would be stored: ",
            "the external id 'second' belongs to another shape",
        ];
        words.iter().for_each(|word| assert!(said.contains(word), "{word}: {said}"));
        let skipping =
            run(server.command("inspect").arg(&file).args(["--cohort", "c", "--skip-invalid"]).args(more));
        assert!(skipping.0 == 1 && !skipping.1.contains("nothing would"), "{skipping:?}");
    }
    // What is said of a cohort needs one; a service that the environment names is not asked without.
    let (code, _, told) = shapelex(&["inspect", "scans", "--skip-invalid"], folder.path());
    assert!(code == 2 && told.contains("--cohort"), "{told}");
    let alone = run(Command::new(env!("CARGO_BIN_EXE_shapelex"))
        .args(["inspect", "scans/a.ndjson"])
        .env("SHAPELEX_SERVER", "http://127.0.0.1:1")
        .current_dir(folder.path()));
    assert_eq!(alone.0, 0, "{alone:?}");
}

/// As `formulas` of HTTP: of a store, of a service, and of a file that is translated.
#[test]
fn formulas_in_csv_are_escaped_by_an_option() {
    let server = Setting::fresh().start();
    create(&server);
    let shapes =
        json!({"shapes": [{"external_id": "=1+1", "label": "-x", "points": [[0, 0], [4, 0], [4, -1]]}]});
    server.post("/v1/cohorts/c/shapes", &shapes).expect(201);
    let escaped = server.get("/v1/cohorts/c/export?format=csv&formulas=escape").text().to_owned();
    let kept = server.get("/v1/cohorts/c/export?format=csv").text().to_owned();
    assert!(escaped.contains("'=1+1") && escaped.contains("'-x") && escaped.contains("-1"), "{escaped}");
    assert!(!escaped.contains("'-1") && kept != escaped, "{kept}");
    let folder = files();
    let of_cohort = |more: &[&str]| {
        run(server.command("export").arg("-").args(["--cohort", "c", "--to", "csv"]).args(more))
    };
    let of_service = ["--server", server.address(), "--formulas", "escape"];
    for more in [&["--formulas", "escape"][..], &of_service] {
        let (code, said, told) = of_cohort(more);
        assert_eq!((code, &said), (0, &escaped), "{told}");
        assert!(told.contains(&format!("{} bytes of CSV", escaped.len())), "{told}");
    }
    assert_eq!(of_cohort(&["--formulas", "keep"]).1, kept);
    std::fs::write(folder.path().join("kept.csv"), &kept).unwrap();
    let convert =
        |to: &str| shapelex(&["convert", "kept.csv", "--to", to, "--formulas", "escape"], folder.path());
    let (code, said, told) = convert("csv");
    assert!(code == 0 && said.contains("'=1+1") && said.contains("'-x"), "{said} {told}");
    let (code, _, told) = convert("ndjson");
    assert!(code == 2 && told.contains("expected --to csv beside --formulas escape, got ndjson"), "{told}");
    let (code, _, told) = run(server.command("export").arg("-").args(["--formulas", "escape"]));
    assert!(code == 2 && told.contains("expected --cohort"), "{told}");
}

#[test]
fn what_harmonics_leave_is_said() {
    let server = Setting::fresh().start();
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "bspline", "degree": 3}});
    let cohort = json!({"name": "c", "representation": representation, "correspondence": "arc_length"});
    server.post("/v1/cohorts", &cohort).expect(201);
    let folder = files();
    let import = run(server.command("import").arg(folder.path().join("cells.png")).args(["--cohort", "c"]));
    assert_eq!(import.0, 0, "{import:?}");
    let fourier = ["--cohort", "c", "--to", "nef", "--fourier", "--write", "harmonics=2"];
    let (code, said, told) = run(server.command("export").arg("-").args(fourier));
    assert!(code == 0 && said.starts_with("#CONST 0 0 0 0\n#HARMO 2\n"), "{said} {told}");
    assert!(told.contains("warning: 3 shapes have further harmonics; these have at most"), "{told}");
    let address = server.address().to_owned();
    let (code, same, told) =
        run(server.command("export").arg("-").args(fourier).args(["--server", &address]));
    assert_eq!((code, same), (0, said), "{told}");
    let (code, _, told) = run(server.command("export").arg("-").args(fourier).arg("--control-points"));
    assert!(code == 2 && told.contains("cannot be used with"), "{told}");
}

#[test]
fn projects_bring_the_files_that_they_name() {
    let (server, folder) = (Server::fresh(), tempfile::tempdir().unwrap());
    let representation = json!({"kind": "landmarks", "dimension": 3, "points": 2});
    let cohort = json!({"name": "c", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    let path = |name: &str| folder.path().join(name);
    let project = json!({"data": [
        {"name": "m02", "local_particles_1": "../particles/m02.particles", "shape_1": "../m02.ply", "group_sex": "f", "age": 61},
        {"name": "m01", "local_particles_1": "../particles/m01.particles", "shape_1": "../m01.ply", "group_sex": "m"},
    ]});
    ["particles", "study"].iter().for_each(|name| std::fs::create_dir(path(name)).unwrap());
    std::fs::write(path("study/a.swproj"), project.to_string()).unwrap();
    std::fs::write(path("particles/m01.particles"), "0 0 0\n1 0 0\n").unwrap();
    std::fs::write(path("particles/m02.particles"), "0 0 0\n0 2 0\n").unwrap();
    std::fs::write(path("particles/other.particles"), "0 0 0\n0 0 3\n").unwrap();
    let (code, said, _) = shapelex(&["inspect", "study/a.swproj"], folder.path());
    assert!(code == 0 && said.contains("2 × landmarks") && said.contains("m02, m01"), "{said}");
    let (code, said, _) = shapelex(&["convert", "study/a.swproj"], folder.path());
    let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!((code, &lines[0]["points"][1], &lines[0]["label"]), (0, &json!([0.0, 2.0, 0.0]), &json!("f")));
    // In a folder, its files belong to the project; the third one does not.
    let import = || {
        let arguments = ["import", ".", "--cohort", "c", "--server", server.address(), "--json"];
        let (code, said, told) = shapelex(&arguments, folder.path());
        let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let fates: Vec<_> = lines.iter().map(|line| format!("{} {}", line["file"], line["status"])).collect();
        (code, fates, told)
    };
    let wanted = |status: &str| {
        ["./particles/other.particles", "./study/a.swproj"]
            .map(|file| format!("\"{file}\" \"{status}\""))
            .to_vec()
    };
    let (code, fates, told) = import();
    assert_eq!((code, fates), (0, wanted("imported")), "{told}");
    assert_eq!(import().1, wanted("known"));
    assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 3);
    let shape = server.get("/v1/cohorts/c/shapes/a/m02").expect(200);
    assert_eq!((&shape["label"], &shape["labels"]), (&json!("f"), &json!({"age": 61, "file": "m02"})));
    // A file that is missing, one that is no shape, and a project that is sent alone.
    std::fs::remove_file(path("particles/m01.particles")).unwrap();
    let (code, said, _) = shapelex(&["inspect", "study/a.swproj"], folder.path());
    assert!(
        code == 2 && said.contains("item 1, local_particles_1: expected a file that the project names"),
        "{said}"
    );
    std::fs::write(path("particles/m01.particles"), [0xff, 0xfe]).unwrap();
    std::fs::rename(path("particles/m01.particles"), path("particles/secret")).unwrap();
    std::fs::write(path("study/a.swproj"), project.to_string().replace("m01.particles", "secret")).unwrap();
    let (code, said, _) = shapelex(&["inspect", "study/a.swproj"], folder.path());
    assert!(code == 2 && said.contains("expected a file of one of the formats"), "{said}");
    let alone = server.post_bytes(
        "/v1/inspect?name=a.swproj",
        "application/octet-stream",
        project.to_string().into_bytes(),
    );
    let problem = alone.expect(422);
    assert!(problem["detail"].as_str().unwrap().contains("got the project alone"), "{problem}");
}

#[test]
fn completions_and_man_pages_are_written() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let (code, said, _) = shapelex(&["completions", shell], folder.path());
        assert!(code == 0 && said.contains("convert"), "{shell}: {said}");
    }
    let (code, said, _) = shapelex(&["man"], folder.path());
    assert!(code == 0 && said.contains(".TH shapelex"), "{said}");
    assert_eq!(shapelex(&["man", "pages"], folder.path()).0, 0);
    assert!(folder.path().join("pages/shapelex-convert.1").exists());
}
