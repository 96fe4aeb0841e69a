//! Checks, backups, exports and migrations of stores that contain objects of every kind.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::super::engine::sql;
use super::super::folder::DATABASE_FILE;
use super::super::jobs::Claim;
use super::super::tests::{
    DATABASE_URL, cohort, embedded, fresh, fresh_schema, meddle, named, rows, shape, store_all,
};
use super::super::{AssessmentRun, NewAssessment, Store, StoreError};
use super::tables::{Kind, PASSING, TABLES};
use super::*;
use crate::domain::cohort::Cohort;
use crate::domain::job::{Job, JobKind, JobOutput};
use crate::domain::retry::{Receipt, RetryKey};

/// A store with rows in every table except the audit trail.
async fn fill(store: &Store) -> Cohort {
    let hands = cohort("hands");
    let request = RetryKey { key: "k".into(), fingerprint: [7; 32] };
    store.create_cohort(&hands, Some(&Receipt { request, outcome: json!({"id": 1}) })).await.unwrap();
    let mut shapes: Vec<_> = (0..6).map(|i| named(i, &format!("e{i}"))).collect();
    shapes[1].attributes.weight = 0.1;
    shapes[2].attributes.metadata = Some(json!({"π": [0.1, null, "\u{0}"]}).to_string());
    store_all(store, &hands, shapes).await;
    store_all(store, &hands, vec![shape(9)]).await;
    let first = store.find_shape(&hands.id, "e0").await.unwrap().unwrap();
    store.delete_shape(&hands.id, &first.id, 30).await.unwrap();
    let trashed = cohort("feet");
    store.create_cohort(&trashed, None).await.unwrap();
    store.trash_cohort(&trashed.id, None, 31).await.unwrap();
    let claim = claimed(store).await;
    let output = JobOutput { head: json!({"ids": ["a"]}), data: (0..=255).collect() };
    assert!(store.succeed_job(&claim, &json!({"x": -0.0}), None, Some(&output), 40).await.unwrap());
    add_dictionary(store, &hands).await;
    hands
}

async fn claimed(store: &Store) -> Claim {
    let job = Job::new(JobKind::LearnDictionary, json!({"cohort": "hands"}), 7);
    store.create_job(&job, None).await.unwrap();
    store.claim_job(8, 100, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap()
}

/// Inserts a dictionary as plain rows; its content does not matter here.
async fn add_dictionary(store: &Store, cohort: &Cohort) {
    const NAME: &str = "INSERT INTO dictionary_name (handle, versions) VALUES ('default/modes', 1)";
    const ROW: &str = "INSERT INTO dictionary (id, handle, tenant, name, version, cohort, summary, provenance,
        digest, created_at_ms) VALUES ('dic_1', 'default/modes', 'default', 'modes', 1, $1, '{}', '{}', $2, 50)";
    const DATA: &str = "INSERT INTO dictionary_data (dictionary, content, state, state_checksum)
        VALUES ('dic_1', $1, $2, $3)";
    const ALIAS: &str = "INSERT INTO dictionary_alias (handle, alias, tenant, dictionary, moves, moved_at_ms)
        VALUES ('default/modes', 'production', 'default', 'dic_1', 1, 51)";
    let (content, state) = (&b"{}"[..], &[1_u8, 2, 255][..]);
    meddle(store, NAME).await;
    let digest = blake3::hash(content).to_hex().to_string();
    sql(store.writer(), ROW).bind(&cohort.id).bind(digest).execute().await.unwrap();
    let checksum = blake3::hash(state).as_bytes().to_vec();
    sql(store.writer(), DATA).bind(content).bind(state).bind(checksum).execute().await.unwrap();
    meddle(store, ALIAS).await;
    let run = AssessmentRun { cohort: &cohort.id, dictionary: "dic_1", revision: 2, job: None };
    let shape = store.find_shape(&cohort.id, "e1").await.unwrap().unwrap().id;
    let body = json!({"relative_error": 0.1}).to_string();
    let assessment = NewAssessment { shape, class: Some("a".into()), is_outlier: true, body };
    assert_eq!(store.store_assessments(&run, &[assessment], 52).await.unwrap(), Some(1));
}

async fn findings(store: &Store) -> Vec<String> {
    let mut found = Vec::new();
    let checked = store.check(&mut |line: &str| found.push(line.to_owned())).await.unwrap();
    assert_eq!(checked.findings, found.len() as u64);
    found
}

async fn exported(store: &Store) -> Vec<u8> {
    let mut out = Vec::new();
    store.export(&mut out).await.unwrap();
    out
}

/// Columns of a table with their types, key columns first.
type Columns = BTreeSet<(String, String)>;

fn listed() -> BTreeMap<String, Columns> {
    let word = |kind| match kind {
        Kind::Integer => "INTEGER",
        Kind::Real => "REAL",
        Kind::Text => "TEXT",
        Kind::Bytes => "BLOB",
    };
    let columns = |columns: &[(&str, Kind)]| {
        columns.iter().map(|(name, kind)| ((*name).to_owned(), word(*kind).to_owned())).collect()
    };
    TABLES.iter().map(|table| (table.name.to_owned(), columns(table.columns))).collect()
}

#[tokio::test]
async fn the_list_of_tables_is_the_schema_of_the_embedded_database() {
    const COLUMNS: &str = "SELECT m.name AS table_name, p.name AS column_name, p.type AS kind, p.pk AS key,
        m.sql LIKE '%AUTOINCREMENT%' AS counted
        FROM sqlite_master AS m JOIN pragma_table_info(m.name) AS p WHERE m.type = 'table'";
    let (_folder, store) = embedded().await;
    let mut schema: BTreeMap<String, Columns> = BTreeMap::new();
    for row in sql(store.reader(), COLUMNS).all().await.unwrap() {
        let (table, column): (String, String) =
            (row.get("table_name").unwrap(), row.get("column_name").unwrap());
        if PASSING.contains(&table.as_str()) {
            continue;
        }
        if let Some(listed) = TABLES.iter().find(|listed| listed.name == table) {
            let place = listed.columns.iter().position(|(name, _)| *name == column);
            let key: i64 = row.get("key").unwrap();
            let expected = place.filter(|place| *place < listed.key).map_or(0, |place| place as i64 + 1);
            assert_eq!(key, expected, "the place of {table}.{column} in the key");
            assert_eq!(row.get::<i64>("counted").unwrap() == 1, listed.counted, "{table}");
        }
        schema.entry(table).or_default().insert((column, row.get("kind").unwrap()));
    }
    assert_eq!(listed(), schema);
}

#[tokio::test]
async fn the_list_of_tables_is_the_schema_of_postgresql() {
    const COLUMNS: &str =
        "SELECT CAST(table_name AS TEXT) AS table_name, CAST(column_name AS TEXT) AS column_name,
        CAST(data_type AS TEXT) AS kind, CAST(is_identity AS TEXT) AS counted
        FROM information_schema.columns WHERE table_schema = current_schema()";
    let Ok(url) = std::env::var(DATABASE_URL) else { return };
    let store = Store::connect(&fresh_schema(&url).await, 2).await.unwrap();
    let mut schema: BTreeMap<String, Columns> = BTreeMap::new();
    for row in sql(store.reader(), COLUMNS).all().await.unwrap() {
        let (table, column): (String, String) =
            (row.get("table_name").unwrap(), row.get("column_name").unwrap());
        if PASSING.contains(&table.as_str()) {
            continue;
        }
        let kind = match row.get("kind").unwrap() {
            "bigint" => "INTEGER",
            "double precision" => "REAL",
            "text" => "TEXT",
            "bytea" => "BLOB",
            other => other,
        };
        if row.get::<&str>("counted").unwrap() == "YES" {
            let listed = TABLES.iter().find(|listed| listed.name == table).unwrap();
            assert_eq!((listed.counted, listed.columns[0].0), (true, column.as_str()), "{table}");
        }
        schema.entry(table).or_default().insert((column, kind.to_owned()));
    }
    assert_eq!(listed(), schema);
    store.close().await;
}

#[tokio::test]
async fn a_whole_store_has_no_findings() {
    let (_folder, store) = fresh().await;
    assert_eq!(findings(&store).await, [""; 0]);
    let hands = fill(&store).await;
    // An upload in progress, and a cohort being removed.
    let mut upload = store.begin_upload(&hands);
    upload.add(vec![shape(1)]).await.unwrap();
    assert_eq!(findings(&store).await, [""; 0]);
    meddle(&store, "DELETE FROM cohort WHERE name = 'hands'").await;
    assert!(rows(&store, "chunk").await > 0);
    assert_eq!(findings(&store).await, [""; 0]);
    upload.abort().await.unwrap();
    store.close().await;
}

#[tokio::test]
async fn what_is_looked_at_is_counted() {
    let (_folder, store) = fresh().await;
    fill(&store).await;
    let checked = store.check(&mut |_: &str| ()).await.unwrap();
    let expected = Checked {
        cohorts: 2,
        chunks: 2,
        shapes: 7,
        dictionaries: 1,
        jobs: 1,
        outputs: 1,
        receipts: 1,
        ..Checked::default()
    };
    assert_eq!(checked, expected);
    store.close().await;
}

#[tokio::test]
async fn every_kind_of_damage_is_found() {
    let damages: &[(&str, &str)] = &[
        (
            "UPDATE chunk_data SET points = zeroblob(length(points)) WHERE chunk_id = 1",
            "points of chunk 1 do not",
        ),
        ("UPDATE chunk_data SET weights = NULL WHERE chunk_id = 1", "points of chunk 1 do not"),
        ("UPDATE chunk SET width = 4 WHERE id = 2", "another representation"),
        ("UPDATE chunk SET revision = 99 WHERE id = 2", "chunk 2 has a revision"),
        ("DELETE FROM chunk_data WHERE chunk_id = 2", "chunk 2 has no points"),
        ("DELETE FROM shape WHERE external_id = 'e5'", "chunk 1 has 6 shapes, but descriptions of 5"),
        (
            "UPDATE shape SET deleted_revision = 0 WHERE external_id = 'e0'",
            "was deleted by an impossible revision",
        ),
        (
            "UPDATE shape SET deleted_revision = 1 WHERE external_id = 'e0'",
            "was erased, but is still described",
        ),
        ("UPDATE shape SET cohort = 77 WHERE external_id = 'e3'", "under another cohort"),
        ("UPDATE shape SET metadata = '{' WHERE external_id = 'e2'", "the attributes of shape"),
        ("UPDATE cohort SET shapes = shapes + 1 WHERE name = 'hands'", "the number of shapes that it states"),
        ("UPDATE cohort SET handle = 'default/' || name", "cannot be found by its name"),
        ("UPDATE cohort SET representation = '{'", "cannot be read"),
        ("UPDATE dictionary_data SET content = x'7b'", "content of dictionary dic_1"),
        ("UPDATE dictionary_data SET state = NULL", "state of dictionary dic_1"),
        ("DELETE FROM dictionary_data", "dictionary dic_1 has no content"),
        ("UPDATE dictionary_name SET versions = 0", "a version that its name never had"),
        ("UPDATE dictionary SET handle = 'x'", "dictionary dic_1 cannot be found"),
        ("UPDATE dictionary SET handle = 'x'", "alias default/modes@production names"),
        ("UPDATE job SET parameters = '{'", "unreadable"),
        ("UPDATE job_output SET data = x'00'", "does not match its checksum"),
        ("UPDATE receipt SET outcome = '{'", "a receipt of tenant default"),
        ("UPDATE receipt SET fingerprint = x'00'", "a receipt of tenant default"),
        ("DELETE FROM change WHERE sequence = 2", "feed of tenant default has a gap"),
        ("UPDATE change_sequence SET last = last + 1", "feed of tenant default has a gap"),
        ("DELETE FROM change", "feed of tenant default is empty"),
        ("DELETE FROM chunk WHERE id = 2", "the points of chunk 2 belong to no chunk"),
        ("DELETE FROM chunk WHERE id = 2", "belongs to no chunk"),
        ("DELETE FROM cohort WHERE name = 'hands'", "a cohort that does not exist"),
        ("DELETE FROM job", "belongs to no job"),
        ("DELETE FROM dictionary", "belongs to no dictionary"),
    ];
    for (damage, expected) in damages {
        let (_folder, store) = embedded().await;
        fill(&store).await;
        meddle(&store, "PRAGMA foreign_keys = 0").await;
        meddle(&store, damage).await;
        let found = findings(&store).await;
        assert!(found.iter().any(|finding| finding.contains(expected)), "{damage}: {found:?}");
    }
}

#[tokio::test]
async fn an_export_makes_the_same_store() {
    let (_one, store) = fresh().await;
    let hands = fill(&store).await;
    // Numbers of removed rows are not assigned again.
    let gone = cohort("gone");
    store.create_cohort(&gone, None).await.unwrap();
    store.remove_cohort(&gone.id).await.unwrap();
    let mut upload = store.begin_upload(&hands);
    upload.add(vec![shape(1)]).await.unwrap();
    let first = exported(&store).await;
    upload.abort().await.unwrap();

    let (_two, embedded) = embedded().await;
    let (count, _) = embedded.import(&mut first.as_slice(), false).await.unwrap();
    assert_eq!(count, first.iter().filter(|byte| **byte == b'\n').count() as u64 - 2);
    assert!(exported(&embedded).await == first, "the embedded store exports something else");
    assert_eq!(findings(&embedded).await, [""; 0]);
    let before = store.find_shape(&hands.id, "e2").await.unwrap();
    assert!(before.is_some());
    assert_eq!(embedded.find_shape(&hands.id, "e2").await.unwrap(), before);

    let (_three, other) = fresh().await;
    other.import(&mut first.as_slice(), false).await.unwrap();
    assert!(exported(&other).await == first, "the other store exports something else");
    for store in [&embedded, &other] {
        store.create_cohort(&cohort("next"), None).await.unwrap();
        let number = "SELECT number FROM cohort WHERE name = 'next'";
        assert_eq!(sql(store.reader(), number).scalar::<i64>().await.unwrap(), 4);
        store_all(store, &hands, vec![shape(20)]).await;
        // The pending chunk had number 3.
        let number = "SELECT max(id) FROM chunk";
        assert_eq!(sql(store.reader(), number).scalar::<i64>().await.unwrap(), 4);
    }
    store.close().await;
    other.close().await;
}

/// The export with one line replaced.
fn with_line(export: &str, number: usize, change: impl Fn(&str) -> String) -> String {
    let lines = export.lines().enumerate();
    lines.map(|(i, line)| if i == number { change(line) } else { line.to_owned() } + "\n").collect()
}

#[tokio::test]
async fn what_is_not_a_whole_export_leaves_nothing() {
    let (_one, store) = embedded().await;
    fill(&store).await;
    let export = String::from_utf8(exported(&store).await).unwrap();
    let last = export.lines().count() - 1;
    let cut = |end: usize| export[..end].to_owned();
    let bad = [
        (String::new(), "line 1 ", "incomplete"),
        ("{}\n".into(), "line 1 ", "expected the first line"),
        ("x\n".into(), "line 1 ", "not JSON"),
        (
            with_line(&export, 0, |line| line.replace("\"schema\":", "\"schema\":1")),
            "line 1 ",
            "shapelex migrate",
        ),
        (cut(export.len() / 2), "", "incomplete"),
        (cut(export.len() - 1), "", "incomplete"),
        (with_line(&export, 1, |line| line.replace("hands", "bands")), "", "changed or damaged"),
        (
            with_line(&export, 1, |line| line.replace("\"cohort\",1", "\"cohort\",\"1\"")),
            "line 2 ",
            "another type",
        ),
        (
            with_line(&export, 1, |line| line.replace("\"cohort\",", "\"probe\",")),
            "line 2 ",
            "unexpected row of the table",
        ),
        (with_line(&export, 1, |_| "[\"job\"]".into()), "line 2 ", "values"),
        (with_line(&export, 1, |_| String::new()), "line 2 ", "not JSON"),
        (
            with_line(&export, last, |line| line.replace("\"cohort\":2", "\"cohort\":3")),
            "",
            "numbers of rows",
        ),
        (export.clone() + "\n", "", "after the last line"),
    ];
    let (_two, empty) = fresh().await;
    let nothing = exported(&empty).await;
    for (bad, place, reason) in bad {
        let error = empty.import(&mut bad.as_bytes(), false).await.unwrap_err().to_string();
        assert!(error.contains(place) && error.contains(reason), "{error}, expected {place}{reason}");
        for table in TABLES {
            assert_eq!(rows(&empty, table.name).await, 0, "{}: {error}", table.name);
        }
    }
    assert!(nothing == exported(&empty).await, "numbers were drawn");
    empty.import(&mut export.as_bytes(), false).await.unwrap();
    let error = empty.import(&mut export.as_bytes(), false).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::StoreInUse("cohort")), "{error}");
    empty.close().await;
}

#[tokio::test]
async fn a_backup_makes_the_same_store() {
    let (folder, store) = embedded().await;
    let hands = fill(&store).await;
    let mut upload = store.begin_upload(&hands);
    upload.add(vec![shape(1)]).await.unwrap();
    let file = folder.path().join("copy");
    let bytes = store.back_up(&file).await.unwrap();
    assert_eq!(fs::metadata(&file).unwrap().len(), bytes);
    let error = store.back_up(&file).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::Exists(_)), "{error}");
    let before = exported(&store).await;

    let target = tempfile::tempdir().unwrap();
    let place = target.path().join("new");
    let checked = restore(&file, &place, false, &mut |_: &str| ()).await.unwrap().checked.unwrap();
    assert_eq!((checked.shapes, checked.findings), (8, 0), "the pending shape too");
    let names: Vec<_> = fs::read_dir(&place).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "the database and the lock: {names:?}");
    let error = restore(&file, &place, false, &mut |_: &str| ()).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::FolderInUse(_)), "{error}");
    let restored = Store::open(&place).await.unwrap();
    assert!(exported(&restored).await == before, "another store");
    assert_eq!(rows(&restored, "chunk").await, 2, "the unfinished upload has ended");
    upload.abort().await.unwrap();
}

/// Tries to restore a file that must be refused; returns the reason.
async fn refused(file: &Path) -> String {
    let target = tempfile::tempdir().unwrap();
    let error = restore(file, target.path(), false, &mut |_: &str| ()).await.unwrap_err();
    assert!(!target.path().join(DATABASE_FILE).exists(), "{error}");
    error.to_string()
}

#[tokio::test]
async fn a_bad_backup_is_not_restored() {
    let (folder, store) = embedded().await;
    fill(&store).await;
    let file = folder.path().join("copy");
    store.back_up(&file).await.unwrap();
    let good = fs::read(&file).unwrap();
    assert!(refused(&folder.path().join("none")).await.contains("no file"));
    let write = |bytes: &[u8]| fs::write(&file, bytes).unwrap();
    write(&good[..good.len() / 2]);
    assert!(refused(&file).await.contains("not restored"));
    write(b"no database");
    assert!(refused(&file).await.contains("not restored"));
    write(b"");
    assert!(refused(&file).await.contains("not a backup"));
    // Control points protected only by their checksum.
    let mut bytes = good.clone();
    let points = 21.0_f64.to_le_bytes();
    let place = bytes.windows(8).position(|window| window == points).expect("stored as they are");
    bytes[place] ^= 1;
    write(&bytes);
    assert!(refused(&file).await.contains("findings: 1"));
    // A non-empty folder, even after an interrupted command.
    write(&good);
    let target = tempfile::tempdir().unwrap();
    fs::write(target.path().join("restore.partial"), "x").unwrap();
    restore(&file, target.path(), false, &mut |_: &str| ()).await.unwrap();
}

#[tokio::test]
async fn schemas_are_migrated_and_newer_ones_left_alone() {
    let folder: TempDir = tempfile::tempdir().unwrap();
    let site = Site::Folder(folder.path().to_path_buf());
    let error = versions(&site).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::NoStore(_)), "{error}");
    let known = sqlite::latest();
    assert_eq!(migrate(&site).await.unwrap(), Versions { found: 0, known });
    assert_eq!(migrate(&site).await.unwrap(), Versions { found: known, known });
    assert_eq!(versions(&site).await.unwrap(), Versions { found: known, known });

    let store = Store::open(folder.path()).await.unwrap();
    let error = migrate(&site).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::Store(StoreError::Locked { .. })), "{error}");
    // As if the last migration had never been applied.
    meddle(&store, "DELETE FROM _sqlx_migrations WHERE version > 4").await;
    assert_eq!(versions(&site).await.unwrap(), Versions { found: 4, known });
    let error = Store::inspect(&site).await.unwrap_err();
    assert!(matches!(error, MaintenanceError::Older { found: 4, .. }), "{error}");
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
        VALUES (9999, 'of the future', TRUE, x'00', 0)";
    meddle(&store, newer).await;
    store.close().await;
    for error in [
        migrate(&site).await.unwrap_err(),
        versions(&site).await.unwrap_err(),
        Store::inspect(&site).await.unwrap_err(),
    ] {
        assert!(matches!(error, MaintenanceError::Store(StoreError::Newer { found: 9999, .. })), "{error}");
        assert!(error.to_string().contains("newer"), "{error}");
    }
    let error = Store::open(folder.path()).await.unwrap_err();
    assert!(matches!(error, StoreError::Newer { found: 9999, known: k } if k == known), "{error}");
}

#[tokio::test]
async fn an_old_store_is_brought_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    let site = Site::Folder(folder.path().to_path_buf());
    let pools = sqlite::connect(&folder.path().join(DATABASE_FILE), true).await.unwrap();
    if let Pools::Sqlite { writer, .. } = &pools {
        sqlite::migrate_to(writer, 4).await.unwrap();
    }
    pools.close().await;
    let known = sqlite::latest();
    assert_eq!(migrate(&site).await.unwrap(), Versions { found: 4, known });
    let store = Store::inspect(&site).await.unwrap();
    assert_eq!(findings(&store).await, [""; 0]);
    store.close().await;
}

#[test]
fn values_come_back_from_json() {
    use super::tables::Cell;
    let cells = [
        (Cell::Null, Kind::Bytes),
        (Cell::Integer(i64::MIN), Kind::Integer),
        (Cell::Real(0.1 + 0.2), Kind::Real),
        (Cell::Real(-0.0), Kind::Real),
        (Cell::Real(f64::MIN_POSITIVE), Kind::Real),
        (Cell::Text("\u{0}π\n\"".into()), Kind::Text),
        (Cell::Bytes(vec![0, 255, 10]), Kind::Bytes),
    ];
    for (cell, kind) in cells {
        let text = cell.to_json().to_string();
        let value: Value = serde_json::from_str(&text).unwrap();
        let back = Cell::from_json(value, kind).unwrap();
        assert_eq!(format!("{back:?}"), format!("{cell:?}"), "{text}");
    }
    assert_eq!(Cell::from_json(json!(1.5), Kind::Integer), None);
    assert_eq!(Cell::from_json(json!("?"), Kind::Bytes), None);
}
