//! The program, on a bucket of a server that speaks the protocol of Amazon S3.

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::program::{answer, fetched, output, program, request, scatter};
use crate::readers::python;

/// Makes the bucket, and damages the newest part of it when asked to.
const CLIENT: &str = r#"
import sys, boto3
s3 = boto3.client("s3")
if sys.argv[1] == "make":
    s3.create_bucket(Bucket="cohorts")
else:
    parts = [item["Key"] for item in s3.list_objects_v2(Bucket="cohorts")["Contents"] if "/parts/" in item["Key"]]
    content = s3.get_object(Bucket="cohorts", Key=parts[0])["Body"].read()
    s3.put_object(Bucket="cohorts", Key=parts[0], Body=content[:-1] + bytes([content[-1] ^ 1]))
"#;

struct Server {
    process: Child,
    variables: Vec<(&'static str, String)>,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Server {
    fn start(python: &std::path::Path) -> Self {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut command = Command::new(python);
        command.args(["-m", "moto.server", "-H", "127.0.0.1", "-p", &port.to_string()]);
        let process = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let endpoint = format!("http://127.0.0.1:{port}");
        let variables = vec![
            ("AWS_ENDPOINT", endpoint.clone()),
            ("AWS_ENDPOINT_URL", endpoint),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("AWS_ACCESS_KEY_ID", "key".into()),
            ("AWS_SECRET_ACCESS_KEY", "secret".into()),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_DEFAULT_REGION", "us-east-1".into()),
        ];
        let server = Self { process, variables };
        for _ in 0..300 {
            if TcpStream::connect(("127.0.0.1", port)).is_ok() {
                return server;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("the server of buckets does not start");
    }

    fn client(&self, python: &std::path::Path, what: &str) {
        let mut command = Command::new(python);
        command.args(["-c", CLIENT, what]).envs(self.variables.iter().cloned());
        assert!(command.status().unwrap().success(), "{what}");
    }

    fn engine(&self, store: &str, arguments: &[&str]) -> Result<Value, String> {
        answer(program().args(["--store", store]).args(arguments).envs(self.variables.iter().cloned()))
    }

    /// The scatter of all shapes.
    fn sum(&self, store: &str) -> Result<Vec<u8>, String> {
        let mut command = program();
        let command = command.args(["--store", store, "pass"]).envs(self.variables.iter().cloned());
        output(command, &request(&scatter(10)).to_string())
    }
}

#[test]
fn a_cohort_in_a_bucket_is_that_in_a_folder() {
    let Some(python) = python("no bucket is written") else { return };
    let server = Server::start(&python);
    server.client(&python, "make");
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let [cohort, shapes] = fetched(folder.path(), 20_000);
    let ingest = ["ingest", "--cohort", &cohort, "--shapes", &shapes];
    let both = [store.to_str().unwrap(), "s3://cohorts/of/hospitals"];
    let written = both.map(|store| server.engine(store, &ingest).unwrap());
    assert_eq!(written[0]["digest"], written[1]["digest"]);
    assert_eq!(server.engine(both[1], &ingest).unwrap()["kept"], 3);
    let sums = both.map(|store| server.sum(store).unwrap());
    assert_eq!(sums[0], sums[1]);
    assert_eq!(server.engine(both[1], &["list"]).unwrap()[0]["revision"], 4);
    assert_eq!(server.engine(both[1], &["check"]).unwrap()["parts"], 3);

    server.client(&python, "damage");
    let fault = server.sum(both[1]).unwrap_err();
    assert!(fault.contains("is damaged: expected digest"), "{fault}");
    let missing = server.engine("s3://nothing", &["list"]).unwrap_err();
    assert!(missing.contains("shapelex-engine: "), "{missing}");
    server.engine(both[1], &["forget", "--cohort", "coh_1", "--revision", "4"]).unwrap();
    let collected = server.engine(both[1], &["collect", "--min-age-hours", "0"]).unwrap();
    assert_eq!(collected["removed"], 3);
}
