//! Passes on a cluster have the bits of one process, whatever dies meanwhile.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use ballista_core::serde::protobuf::GetJobStatusParams;
use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::dictionary::method::Method;
use shapelex_engine::cluster::client::Client;
use shapelex_engine::cluster::network::{Address, Network};
use shapelex_engine::cohort::maintenance::forget;
use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::division::MIN_GROUPS;
use shapelex_engine::pass::subject::Runner;
use tonic::Code;
use tonic::transport::Endpoint;

use crate::dictionaries::{code, learnt, sparse_methods};
use crate::passes::{by, engine, runtime};
use crate::regressions;
use crate::support::{WIDTH, objects, write, write_with_degenerate};

/// Two groups of parts, the second of three parts, the last of which is not whole.
const SHAPES: usize = (FAN_IN + 2) * PART + 77;

/// A process that ends with the test.
struct Process(Child);

impl Process {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex-engine"));
        Self(command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }

    fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A scheduler and executors on this machine.
struct Cluster {
    store: PathBuf,
    port: u16,
    certificates: Vec<String>,
    scheduler: Process,
    executors: Vec<Process>,
}

impl Cluster {
    fn start(store: &Path, executors: usize, certificates: &[String]) -> Self {
        let port = free_port();
        let scheduler = Self::scheduler(port, certificates);
        let certificates = certificates.to_vec();
        let mut cluster = Self { store: store.into(), port, certificates, scheduler, executors: Vec::new() };
        (0..executors).for_each(|_| cluster.add_executor());
        cluster
    }

    fn scheduler(port: u16, certificates: &[String]) -> Process {
        let listen = format!("127.0.0.1:{port}");
        let mut arguments = vec!["scheduler", "--listen", &listen];
        arguments.extend(certificates.iter().map(String::as_str));
        Process::start(&arguments)
    }

    fn add_executor(&mut self) {
        let (scheduler, listen) = (format!("127.0.0.1:{}", self.port), format!("127.0.0.1:{}", free_port()));
        let store = self.store.to_str().unwrap();
        let mut arguments =
            vec!["--store", store, "executor", "--scheduler", &scheduler, "--listen", &listen];
        arguments.extend(self.certificates.iter().map(String::as_str));
        self.executors.push(Process::start(&arguments));
    }

    fn restart_scheduler(&mut self) {
        self.scheduler.kill();
        self.scheduler = Self::scheduler(self.port, &self.certificates);
    }

    fn client(&self, min_groups: usize) -> Client {
        client(self.port, min_groups, Network::local())
    }
}

fn client(port: u16, min_groups: usize, network: Network) -> Client {
    let scheduler = Address { host: "127.0.0.1".into(), port };
    Client {
        scheduler,
        network,
        patience: Duration::from_secs(120),
        attempts: 12,
        min_groups,
        submitted: |_| {},
        notice: |_| {},
    }
}

/// A folder with a cohort of triangles, written once.
fn store() -> &'static Path {
    static STORE: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = STORE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        runtime().block_on(write(&stored(folder.path()), 1, 0..SHAPES)).unwrap();
        folder
    });
    folder.path()
}

fn stored(folder: &Path) -> Objects {
    objects(shapelex_engine::location::open(folder.to_str().unwrap()).unwrap())
}

fn revision(folder: &Path) -> Arc<Revision> {
    Arc::new(runtime().block_on(Revision::open(stored(folder), "coh_triangles", 1)).unwrap())
}

/// Digest of the cohort of triangles by one process.
fn expected() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| by(&engine(2, 256 << 20), &revision(store())).unwrap().0)
}

#[test]
fn digests_are_those_of_one_process_on_any_number_of_executors() {
    for executors in [1, 2, 8] {
        let cluster = Cluster::start(store(), executors, &[]);
        for min_groups in [2, MIN_GROUPS] {
            let (digest, took) = by(&cluster.client(min_groups), &revision(store())).unwrap();
            assert_eq!(digest, expected(), "{executors} executors, groups from {min_groups} on");
            let jobs = if min_groups == 2 { 1 } else { 2 };
            assert!(took.iter().all(|took| took.jobs == jobs), "{took:?}");
        }
    }
}

#[test]
fn dictionaries_and_codes_are_those_of_one_process() {
    let cluster = Cluster::start(store(), 2, &[]);
    let (client, one) = (cluster.client(2), engine(2, 256 << 20));
    let (revision, objects) = (revision(store()), stored(store()));
    // Sparse ones in batches: two groups of parts, and as many jobs as epochs.
    for method in [Method::components(3, true), sparse_methods().swap_remove(0)] {
        let content = learnt(&client, &objects, &revision, method.clone()).unwrap();
        assert_eq!(content, learnt(&one, &objects, &revision, method).unwrap());
        let codes = code(&client, &objects, &revision, &content).unwrap();
        assert_eq!(codes, code(&one, &objects, &revision, &content).unwrap());
    }
}

#[test]
fn regressions_are_those_of_one_process() {
    let cluster = Cluster::start(store(), 2, &[]);
    let revision = revision(store());
    let of = |runner: &dyn Runner| regressions::on_area(runner, &revision).unwrap();
    assert_eq!(of(&cluster.client(2)), of(&engine(2, 64 << 20)));
}

#[test]
fn a_cohort_of_one_part_is_a_cohort_too() {
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(write(&stored(folder.path()), 1, 0..500)).unwrap();
    let cluster = Cluster::start(folder.path(), 1, &[]);
    let revision = revision(folder.path());
    let (digest, _) = by(&cluster.client(MIN_GROUPS), &revision).unwrap();
    assert_eq!(digest, by(&engine(1, 64 << 20), &revision).unwrap().0);
}

/// The answer to a request without certificates, its head included.
fn get(port: u16, path: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nhost: metrics\r\nconnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn schedulers_and_executors_tell_what_they_did() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().to_str().unwrap();
    runtime().block_on(write(&stored(folder.path()), 1, 0..2 * PART)).unwrap();
    let [port, results, of_scheduler, of_executor] = [(); 4].map(|()| free_port());
    let at = |port: u16| format!("127.0.0.1:{port}");
    let _scheduler = Process::start(&["scheduler", "--listen", &at(port), "--metrics", &at(of_scheduler)]);
    let executor =
        ["executor", "--scheduler", &at(port), "--listen", &at(results), "--metrics", &at(of_executor)];
    let _executor = Process::start(&[&["--store", store][..], &executor[..]].concat());
    by(&client(port, MIN_GROUPS, Network::local()), &revision(folder.path())).unwrap();

    let value = |port: u16, name: &str| -> f64 {
        let answer = get(port, "/metrics");
        let line = answer.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')).unwrap();
        line.parse().unwrap()
    };
    let job = |what: &str| value(of_scheduler, &format!("shapelex_engine_jobs_{what}_total"));
    assert!(job("completed") >= 2.0 && job("completed") == job("submitted"));
    assert_eq!((job("failed"), job("cancelled")), (0.0, 0.0));
    assert_eq!(value(of_scheduler, "shapelex_engine_executors"), 1.0);
    assert_eq!(value(of_executor, "shapelex_engine_units_total"), 2.0 * job("completed"));
    assert_eq!(value(of_executor, "shapelex_engine_failures_total"), 0.0);
    assert!(value(of_executor, "shapelex_engine_read_bytes_total") > (2 * PART * WIDTH * 8) as f64);
    assert!(value(of_executor, "process_resident_memory_bytes") > 1e6);
    assert!(get(of_executor, "/metrics").contains("role=\"executor\"} 1"));
    assert!(get(of_executor, "/").starts_with("HTTP/1.1 404"));
}

#[test]
fn schedulers_and_executors_may_die_at_any_moment() {
    let mut resubmitted = 0;
    for seed in 0..3_u64 {
        let mut cluster = Cluster::start(store(), 2, &[]);
        let client = cluster.client(MIN_GROUPS);
        by(&client, &revision(store())).unwrap();
        let run = std::thread::spawn(move || by(&client, &revision(store())));
        // Moments spread over a run, which takes about a second.
        std::thread::sleep(Duration::from_millis(50 + 217 * seed % 600));
        cluster.restart_scheduler();
        std::thread::sleep(Duration::from_millis(131 * seed % 400));
        cluster.executors[0].kill();
        cluster.add_executor();
        let (digest, took) = run.join().unwrap().unwrap();
        assert_eq!(digest, expected(), "seed {seed}");
        resubmitted += took.iter().map(|took| took.resubmitted).sum::<usize>();
    }
    assert!(resubmitted > 0, "nothing was lost");
}

#[test]
fn a_client_waits_for_executors_and_gives_up_without_a_scheduler() {
    let mut cluster = Cluster::start(store(), 0, &[]);
    let waiting = cluster.client(MIN_GROUPS);
    let run = std::thread::spawn(move || by(&waiting, &revision(store())));
    std::thread::sleep(Duration::from_secs(2));
    cluster.add_executor();
    assert_eq!(run.join().unwrap().unwrap().0, expected());

    let alone = Client { attempts: 1, ..client(free_port(), MIN_GROUPS, Network::local()) };
    let error = by(&alone, &revision(store())).unwrap_err().to_string();
    assert!(error.contains("expected the results of a job, got none in 2 attempts"), "{error}");
}

#[test]
fn errors_of_shapes_parts_and_revisions_come_back_once() {
    let folder = tempfile::tempdir().unwrap();
    let (count, bad) = (2 * PART, PART + 4321);
    runtime().block_on(write_with_degenerate(&stored(folder.path()), count, bad)).unwrap();
    let revision = revision(folder.path());
    let cluster = Cluster::start(folder.path(), 1, &[]);
    let client = cluster.client(MIN_GROUPS);
    let began = Instant::now();
    let error = by(&client, &revision).unwrap_err().to_string();
    assert!(error.starts_with(&format!("shape {bad} has no extent")), "{error}");

    let parts = std::fs::read_dir(folder.path().join("coh_triangles/parts")).unwrap();
    for part in parts.map(|part| part.unwrap().path()) {
        let bytes = std::fs::read(&part).unwrap();
        std::fs::write(&part, &bytes[..bytes.len() - 1]).unwrap();
    }
    let error = by(&client, &revision).unwrap_err().to_string();
    assert!(error.contains("is damaged: expected"), "{error}");

    // A pass that is open may go on; a new one finds nothing.
    runtime().block_on(forget(&stored(folder.path()), "coh_triangles", 1, false)).unwrap();
    let fresh = Cluster::start(folder.path(), 1, &[]);
    let error = by(&fresh.client(MIN_GROUPS), &revision).unwrap_err().to_string();
    assert!(error.contains("coh_triangles/revisions/"), "{error}");
    assert!(began.elapsed() < Duration::from_secs(60), "errors that stay were tried again");
}

#[test]
fn processes_of_other_builds_are_refused() {
    let cluster = Cluster::start(store(), 0, &[]);
    let endpoint = Endpoint::from_shared(format!("http://127.0.0.1:{}", cluster.port)).unwrap();
    let endpoint = endpoint.user_agent("shapelex-engine/0.0.9-0123456789abcdef").unwrap();
    runtime().block_on(async {
        let channel = loop {
            match endpoint.connect().await {
                Ok(channel) => break channel,
                Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
            }
        };
        let mut scheduler = SchedulerGrpcClient::new(channel);
        let asked = scheduler.get_job_status(GetJobStatusParams { job_id: "1".into() });
        let refused = asked.await.unwrap_err();
        assert_eq!(refused.code(), Code::FailedPrecondition);
        assert!(refused.message().contains("got 'shapelex-engine/0.0.9-0123456789abcdef'"), "{refused}");
    });
}

/// An authority, a certificate of it for this machine, and its key, as files.
fn certificates(folder: &Path) -> [String; 3] {
    let mut authority = CertificateParams::new(Vec::<String>::new()).unwrap();
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let authority_key = KeyPair::generate().unwrap();
    let authority_certificate = authority.self_signed(&authority_key).unwrap();
    let issuer = Issuer::new(authority, authority_key);
    let key = KeyPair::generate().unwrap();
    let own = CertificateParams::new(vec!["127.0.0.1".into(), "localhost".into()]).unwrap();
    let own = own.signed_by(&key, &issuer).unwrap();
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_string()
    };
    [
        write("own.pem", own.pem()),
        write("key.pem", key.serialize_pem()),
        write("ca.pem", authority_certificate.pem()),
    ]
}

#[test]
fn certificates_are_demanded_on_both_sides() {
    let folder = tempfile::tempdir().unwrap();
    let [own, key, authority] = certificates(folder.path());
    let options = ["--certificate", &own, "--key", &key, "--authority", &authority].map(String::from);
    let cluster = Cluster::start(store(), 2, &options);
    let network = |own: &str, key: &str, authority: &str| {
        Network::with_certificates(Path::new(own), Path::new(key), Path::new(authority)).unwrap()
    };
    let known = client(cluster.port, 2, network(&own, &key, &authority));
    assert_eq!(by(&known, &revision(store())).unwrap().0, expected());

    let other = tempfile::tempdir().unwrap();
    let [other_own, other_key, _] = certificates(other.path());
    let strangers = [
        ("no certificate", Network::local()),
        ("of another authority", network(&other_own, &other_key, &authority)),
    ];
    for (name, network) in strangers {
        let stranger = Client { attempts: 1, ..client(cluster.port, 2, network) };
        let error = by(&stranger, &revision(store())).unwrap_err().to_string();
        assert!(error.contains("expected the results of a job"), "{name}: {error}");
    }
}
