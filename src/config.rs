//! Configuration of the service. A flag takes precedence over its environment variable, that over the config file, and the
//! file over the default.

mod values;

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, ValueEnum};
use serde::Deserialize;

use self::values::{Bytes, Given, ListenAddress};
use crate::service::access::AccessSettings;
use crate::service::access::login::LoginSettings;
use crate::service::access::tokens::{self, TokenSettings};
use crate::service::app::{Limits, memory};
use crate::service::cohorts::at_engine::EngineSettings;
use crate::service::hooks::{HookSettings, Network};
use crate::store_location::{self, StoreLocation};
use crate::worker::Places;
use crate::worker::tidy::Terms;

/// Maximum number of concurrent jobs: each has its own threads.
const MAX_JOBS: usize = 64;
/// Maximum of the default memory for bodies: enough to parse four bodies of maximum size.
const MAX_BUFFERED: usize = 2 << 30;
/// With fewer connections, jobs could deadlock: a job reads while it writes.
const MIN_CONNECTIONS: u32 = 4;
/// Maximum size of a matrix in bytes: a value stored as one piece must stay below a billion.
const MAX_MATRIX_BYTES: usize = 900_000_000;
/// Maximum clock difference in seconds: a larger one would accept expired tokens for too long.
const MAX_LEEWAY_SECONDS: u64 = 300;

/// Smallest limit on request heads, in bytes, that connections can enforce.
const MIN_HEAD_BYTES: usize = 8192;

/// A default that is at least one.
fn most(count: usize) -> NonZeroUsize {
    NonZeroUsize::new(count).unwrap_or(NonZeroUsize::MIN)
}

fn seconds(count: NonZeroUsize) -> Duration {
    Duration::from_secs(u64::try_from(count.get()).unwrap_or(u64::MAX))
}

/// Declares all settings in one list: flags, environment variables, config file and defaults.
macro_rules! serve_settings {
    ($($(#[doc = $doc:literal])* $field:ident: $type:ty = $env:literal, $default:expr;)*) => {
        /// Flags of `shapelex serve`; the config file uses the same names in snake case.
        #[derive(Debug, Default, Clone, Args, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct ServeArgs {
            /// TOML file with settings
            #[arg(long, env = "SHAPELEX_CONFIG", value_name = "FILE")]
            #[serde(skip)]
            config: Option<PathBuf>,
            /// Leave an empty store empty instead of loading the example cohort, as a service with keys or an identity provider does
            #[arg(long, env = "SHAPELEX_NO_EXAMPLE", num_args = 0..=1, default_missing_value = "true")]
            no_example: Option<bool>,
            $($(#[doc = $doc])* #[arg(long, env = $env)] $field: Option<$type>,)*
        }

        /// Settings of the running service.
        #[derive(Debug, Clone, PartialEq)]
        pub struct ServeConfig {
            /// Leave an empty store empty.
            pub no_example: bool,
            $($(#[doc = $doc])* pub $field: <$type as Given>::Value,)*
        }

        /// What clients are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ConnectionLimits {
    /// Open connections.
    pub(crate) connections: usize,
    /// Bytes of the head of a request.
    pub(crate) head_bytes: usize,
    /// Requests at once on a connection of HTTP/2.
    pub(crate) streams: u32,
    /// From the connection to the end of the head of its first request.
    pub(crate) first_request: Duration,
    /// From one answer to the end of the head of the next request.
    pub(crate) idle: Duration,
    /// With bytes of an answer ready that the client does not take.
    pub(crate) reader: Duration,
}

impl ServeConfig {
            /// Each setting of the list with its default, as it is written in the file.
            #[cfg(test)]
            fn defaults() -> Vec<(&'static str, String)> {
                vec![$((stringify!($field), tests::written::<<$type as Given>::Value>(&$default))),*]
            }

            /// Flags over environment over file over defaults.
            ///
            /// # Errors
            /// A file that cannot be read, with its name; invalid values.
            pub fn load(args: ServeArgs) -> Result<Self, String> {
                let file = args.config.as_deref().map_or_else(|| Ok(ServeArgs::default()), read_file)?;
                let config = Self {
                    no_example: args.no_example.or(file.no_example).unwrap_or(false),
                    $($field: args.$field.or(file.$field).map_or_else(|| $default, Given::value),)*
                };
                config.check()
            }
        }
    };
}

serve_settings! {
    /// Address to listen on, such as `127.0.0.1:8080` or `localhost:8080`, or `:8080` for all networks; port 0 selects a free port and
    /// prints it
    listen: ListenAddress = "SHAPELEX_LISTEN", SocketAddr::from(([127, 0, 0, 1], 8080));
    /// Folder of the embedded store, created if missing
    data_dir: PathBuf = "SHAPELEX_DATA_DIR", PathBuf::from("shapelex-data");
    /// Start even if the newest part of the embedded store is missing, and continue with the rest
    accept_loss: bool = "SHAPELEX_ACCEPT_LOSS", false;
    /// Address of a PostgreSQL database (`postgres://…`) in place of the embedded one; any number of replicas may share it
    database_url: String = "DATABASE_URL", String::new();
    /// File with the address of the PostgreSQL database, in place of the address itself
    database_url_file: PathBuf = "SHAPELEX_DATABASE_URL_FILE", PathBuf::new();
    /// Maximum number of PostgreSQL connections of this process
    database_connections: u32 = "SHAPELEX_DATABASE_CONNECTIONS", 16;
    /// Number of compute threads; 0 means one per core
    threads: usize = "SHAPELEX_THREADS", 0;
    /// Number of jobs that run at once, at most 64; they share compute threads of their own, as many as those of the requests
    jobs: NonZeroUsize = "SHAPELEX_JOBS", NonZeroUsize::MIN;
    /// Maximum size of a request body in bytes, after decompression (for streams, the line limit applies instead)
    max_body_bytes: Bytes = "SHAPELEX_MAX_BODY_BYTES", Limits::default().body_bytes;
    /// Maximum size of an image in bytes, as received and after decompression
    max_image_bytes: Bytes = "SHAPELEX_MAX_IMAGE_BYTES", Limits::default().image_bytes;
    /// Maximum number of pixels or voxels of an image
    max_voxels: usize = "SHAPELEX_MAX_VOXELS", Limits::default().voxels;
    /// Maximum length of a line of an NDJSON stream in bytes
    max_line_bytes: Bytes = "SHAPELEX_MAX_LINE_BYTES", Limits::default().line_bytes;
    /// Maximum number of values in a JSON body, counted by its commas and brackets
    max_json_values: usize = "SHAPELEX_MAX_JSON_VALUES", Limits::default().json_values;
    /// Maximum ratio of decompressed to compressed size of a body, beyond its first MiB
    max_compression_ratio: usize = "SHAPELEX_MAX_COMPRESSION_RATIO", Limits::default().compression_ratio;
    /// Maximum size of the metadata of a shape in bytes, as JSON
    max_metadata_bytes: Bytes = "SHAPELEX_MAX_METADATA_BYTES", Limits::default().metadata_bytes;
    /// Maximum number of shapes in a request that is answered from memory
    max_shapes: usize = "SHAPELEX_MAX_SHAPES", Limits::default().shapes;
    /// Maximum number of points of a posted contour
    max_points: usize = "SHAPELEX_MAX_POINTS", Limits::default().points;
    /// Maximum number of vertices of a refined mesh
    max_mesh_vertices: usize = "SHAPELEX_MAX_MESH_VERTICES", Limits::default().vertices;
    /// Maximum number of control points of a representation
    max_control_points: usize = "SHAPELEX_MAX_CONTROL_POINTS", Limits::default().control_points;
    /// Maximum number of atoms or components of a dictionary
    max_atoms: usize = "SHAPELEX_MAX_ATOMS", Limits::default().atoms;
    /// Maximum predicted memory of a job in bytes; larger jobs are refused before they run; 0 means 4 GiB, but at most three
    /// eighths of the memory
    max_job_bytes: Bytes = "SHAPELEX_MAX_JOB_BYTES", 0;
    /// Maximum size of a distance matrix in bytes, at most 900 million
    max_matrix_bytes: Bytes = "SHAPELEX_MAX_MATRIX_BYTES", Limits::default().matrix_bytes;
    /// Maximum predicted multiply-adds of a distance matrix that is answered at once; larger ones become a job
    max_matrix_operations: usize = "SHAPELEX_MAX_MATRIX_OPERATIONS", Limits::default().matrix_operations;
    /// Maximum predicted multiply-adds of a search
    max_search_operations: usize = "SHAPELEX_MAX_SEARCH_OPERATIONS", Limits::default().search_operations;
    /// Days that deleted cohorts and dictionaries stay in the trash before they are permanently removed
    trash_days: u32 = "SHAPELEX_TRASH_DAYS", 30;
    /// PEM file with the certificate chain, given together with the key. Default: none, which means plain HTTP
    tls_cert: PathBuf = "SHAPELEX_TLS_CERT", PathBuf::new();
    /// PEM file with the private key of the certificate; both files are reloaded when they change, and on SIGHUP
    tls_key: PathBuf = "SHAPELEX_TLS_KEY", PathBuf::new();
    /// Maximum number of open connections; beyond it the one that has been idle longest is closed
    max_connections: NonZeroUsize = "SHAPELEX_MAX_CONNECTIONS", most(4096);
    /// Maximum size of a request head in bytes, at least 8192
    max_head_bytes: Bytes = "SHAPELEX_MAX_HEAD_BYTES", 64 << 10;
    /// Maximum number of concurrent requests on one HTTP/2 connection
    max_streams: u32 = "SHAPELEX_MAX_STREAMS", 100;
    /// Timeout in seconds from a connection to the end of its first request head
    first_request_seconds: NonZeroUsize = "SHAPELEX_FIRST_REQUEST_SECONDS", most(10);
    /// Timeout in seconds from a response to the end of the next request head on the connection
    idle_seconds: NonZeroUsize = "SHAPELEX_IDLE_SECONDS", most(75);
    /// Timeout in seconds of a client that takes less than 16 KiB of a response that is ready
    reader_seconds: NonZeroUsize = "SHAPELEX_READER_SECONDS", most(30);
    /// Timeout in seconds of a request that only reads stored data
    light_seconds: NonZeroUsize = "SHAPELEX_LIGHT_SECONDS", most(30);
    /// Timeout in seconds of a request that computes; streams are bounded by their pauses instead
    compute_seconds: NonZeroUsize = "SHAPELEX_COMPUTE_SECONDS", most(120);
    /// Maximum number of heavy requests that compute or wait to compute, besides jobs; 0 means four per compute thread
    max_heavy_requests: usize = "SHAPELEX_MAX_HEAVY_REQUESTS", Limits::default().heavy_requests;
    /// Jobs that are predicted to take at most so many seconds have one slot more, of one thread, beside those of --jobs; 0 for
    /// none
    short_job_seconds: usize = "SHAPELEX_SHORT_JOB_SECONDS", 10;
    /// Maximum predicted duration of a job in seconds; longer jobs are refused, and a job that takes three times as long is
    /// stopped
    max_job_seconds: NonZeroUsize = "SHAPELEX_MAX_JOB_SECONDS", most(6 * 3600);
    /// Maximum number of queued jobs of a tenant, up to 1000
    max_queued_jobs: u32 = "SHAPELEX_MAX_QUEUED_JOBS", Limits::default().queued_jobs;
    /// Maximum predicted duration of all queued jobs of a tenant together, in seconds
    max_queued_seconds: NonZeroUsize = "SHAPELEX_MAX_QUEUED_SECONDS", most(24 * 3600);
    /// Maximum predicted compute time of a request in seconds; longer requests are refused before they start
    max_request_seconds: NonZeroUsize = "SHAPELEX_MAX_REQUEST_SECONDS", most(10);
    /// Maximum resident memory of the process in bytes, beyond which large requests are refused; 0 means the limit of its
    /// control group, else the memory of the machine
    max_memory: Bytes = "SHAPELEX_MAX_MEMORY", 0;
    /// Seconds after its last use for which a computed result, such as a cohort prepared for searches, is kept in memory
    cache_seconds: NonZeroUsize = "SHAPELEX_CACHE_SECONDS", most(600);
    /// Maximum memory in bytes for all request bodies and the values read from them, at least the size of one body; 0 means a
    /// quarter of the memory
    max_buffered_bytes: Bytes = "SHAPELEX_MAX_BUFFERED_BYTES", 0;
    /// Maximum memory in bytes for all responses that are not yet sent; 0 means an eighth of the memory
    max_answer_bytes: Bytes = "SHAPELEX_MAX_ANSWER_BYTES", 0;
    /// Maximum average number of requests per second and caller; 0 disables the limit
    rate_per_second: u32 = "SHAPELEX_RATE_PER_SECOND", Limits::default().rate_per_second;
    /// Maximum number of requests in a burst per caller; 0 means twice the number per second
    rate_burst: u32 = "SHAPELEX_RATE_BURST", Limits::default().rate_burst;
    /// Number of requests per minute and address without a valid key that get status 401; further ones get 429; 0 disables the
    /// limit
    refusals_per_minute: u32 = "SHAPELEX_REFUSALS_PER_MINUTE", Limits::default().refusals_per_minute;
    /// Days that entries of the audit trail are kept
    audit_days: u32 = "SHAPELEX_AUDIT_DAYS", 365;
    /// Refuse even read requests while the audit trail cannot be written
    audit_required: bool = "SHAPELEX_AUDIT_REQUIRED", false;
    /// Address of the identity provider whose bearer tokens are accepted (claim `iss`); empty for none
    oidc_issuer: String = "SHAPELEX_OIDC_ISSUER", String::new();
    /// Audience that tokens must have (claim `aud`)
    oidc_audience: String = "SHAPELEX_OIDC_AUDIENCE", String::new();
    /// Address of the provider's public keys (JWKS); empty to discover it from the provider
    oidc_jwks_url: String = "SHAPELEX_OIDC_JWKS_URL", String::new();
    /// Claim with the roles `reader`, `writer`, `admin`; dots address nested objects
    oidc_role_claim: String = "SHAPELEX_OIDC_ROLE_CLAIM", "roles".into();
    /// Groups in that claim that stand for roles, such as `/clinic/staff=reader; /clinic/admins=admin`
    oidc_role_map: String = "SHAPELEX_OIDC_ROLE_MAP", String::new();
    /// Claim with the tenant; empty if all callers belong to the default tenant
    oidc_tenant_claim: String = "SHAPELEX_OIDC_TENANT_CLAIM", String::new();
    /// Id of the page at this provider, as a public client of the code flow; empty for no login by the provider on the page
    oidc_client_id: String = "SHAPELEX_OIDC_CLIENT_ID", String::new();
    /// Scopes that the page asks for, separated by spaces
    oidc_scope: String = "SHAPELEX_OIDC_SCOPE", "openid".into();
    /// Accept only tokens declared as access tokens (`typ: at+jwt`, RFC 9068)
    oidc_require_at_jwt: bool = "SHAPELEX_OIDC_REQUIRE_AT_JWT", false;
    /// Allowed difference in seconds between the clocks of provider and service, at most 300
    oidc_leeway_seconds: u64 = "SHAPELEX_OIDC_LEEWAY_SECONDS", 30;
    /// Origins whose pages may read answers in a browser, such as `https://dashboard.example`, separated by commas
    allow_origin: String = "SHAPELEX_ALLOW_ORIGIN", String::new();
    /// Let hooks deliver over plain HTTP and to private, loopback and link-local addresses: for tests, and networks without
    /// anything to protect from administrators of tenants
    allow_private_hooks: bool = "SHAPELEX_ALLOW_PRIVATE_HOOKS", false;
    /// Networks to whose addresses hooks may deliver over https besides public ones, such as `10.1.0.0/16, fd12::/16`, separated by
    /// commas
    hook_networks: String = "SHAPELEX_HOOK_NETWORKS", String::new();
    /// Days after which a hook whose delivery fails is given up; 0 gives up after the first attempt
    hook_days: u32 = "SHAPELEX_HOOK_DAYS", HookSettings::default().days;
    /// Path of `shapelex-engine`, which computes passes over large cohorts; empty for none
    engine: PathBuf = "SHAPELEX_ENGINE", PathBuf::new();
    /// Store of the engine: a folder, or `s3://bucket/folder`
    engine_store: String = "SHAPELEX_ENGINE_STORE", String::new();
    /// Scheduler of a cluster of the engine, as `host:port`; empty if the engine computes on this machine
    engine_scheduler: String = "SHAPELEX_ENGINE_SCHEDULER", String::new();
    /// Number of shapes from which on a job that learns, or a stored mean, uses the engine
    engine_min_shapes: NonZeroUsize = "SHAPELEX_ENGINE_MIN_SHAPES", most(1_000_000);
    /// Serve /metrics without authentication
    metrics_open: bool = "SHAPELEX_METRICS_OPEN", false;
    /// Log filter, such as `info` or `shapelex=debug`
    log: String = "SHAPELEX_LOG", "info".into();
    /// Log format
    log_format: LogFormat = "SHAPELEX_LOG_FORMAT", LogFormat::Text;
}

/// Whether the text is an origin as browsers write it: scheme, host and port, in lower case and without a path.
fn is_origin(text: &str) -> bool {
    let of_scheme = |scheme: &str| text.strip_prefix(scheme);
    let host = of_scheme("https://").or_else(|| of_scheme("http://")).unwrap_or_default();
    let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-.:[]".contains(c);
    !host.is_empty() && host.chars().all(is_plain)
}

/// Format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// Text for people.
    Text,
    /// One JSON object per line.
    Json,
}

impl ServeConfig {
    /// Limits that requests are checked against.
    pub fn limits(&self) -> Limits {
        let memory = self.memory();
        let share = |given: usize, part: usize, least: usize, most: usize| {
            if given == 0 { (memory / 8 * part).min(most).max(least) } else { given }
        };
        // Seven eighths of the quota are for large responses, and a matrix must fit into them.
        let matrix = self.max_matrix_bytes / 7 * 8 + 8;
        Limits {
            control_points: self.max_control_points,
            points: self.max_points,
            vertices: self.max_mesh_vertices,
            shapes: self.max_shapes,
            body_bytes: self.max_body_bytes,
            image_bytes: self.max_image_bytes,
            voxels: self.max_voxels,
            line_bytes: self.max_line_bytes,
            json_values: self.max_json_values,
            compression_ratio: self.max_compression_ratio,
            metadata_bytes: self.max_metadata_bytes,
            atoms: self.max_atoms,
            job_bytes: share(self.max_job_bytes, 3, 0, Limits::default().job_bytes),
            matrix_bytes: self.max_matrix_bytes,
            matrix_operations: self.max_matrix_operations,
            search_operations: self.max_search_operations,
            heavy_requests: self.max_heavy_requests,
            request_work: seconds(self.max_request_seconds),
            job_time: seconds(self.max_job_seconds),
            queued_jobs: self.max_queued_jobs,
            queued_work: seconds(self.max_queued_seconds),
            cache_time: seconds(self.cache_seconds),
            memory: memory / 16 * 15,
            buffered_bytes: share(self.max_buffered_bytes, 2, self.max_body_bytes, MAX_BUFFERED),
            answer_bytes: share(self.max_answer_bytes, 1, matrix, Limits::default().answer_bytes),
            rate_per_second: self.rate_per_second,
            rate_burst: self.rate_burst,
            // Half of the connections is left to others.
            caller_requests: self.max_connections.get().div_ceil(2),
            refusals_per_minute: self.refusals_per_minute,
            light_time: seconds(self.light_seconds),
            compute_time: seconds(self.compute_seconds),
            ..Limits::default()
        }
    }

    /// Memory available to the process in bytes.
    fn memory(&self) -> usize {
        if self.max_memory == 0 { memory::available() } else { self.max_memory }
    }

    /// Location of the store.
    pub(crate) fn place(&self) -> StoreLocation {
        StoreLocation {
            database_url: self.database_url.clone(),
            database_connections: self.database_connections.max(MIN_CONNECTIONS),
            data_dir: self.data_dir.clone(),
            accepts_loss: self.accept_loss,
        }
    }

    /// Limits on connections, which apply before requests are read.
    pub(crate) fn connections(&self) -> ConnectionLimits {
        ConnectionLimits {
            connections: self.max_connections.get(),
            head_bytes: self.max_head_bytes,
            streams: self.max_streams,
            first_request: seconds(self.first_request_seconds),
            idle: seconds(self.idle_seconds),
            reader: seconds(self.reader_seconds),
        }
    }

    /// Origins whose pages may read answers.
    fn origins(&self) -> impl Iterator<Item = &str> {
        self.allow_origin.split(',').map(str::trim).filter(|origin| !origin.is_empty())
    }

    /// Retention periods.
    pub fn terms(&self) -> Terms {
        Terms { trash_days: self.trash_days, audit_days: self.audit_days }
    }

    /// Number of job slots and compute threads.
    pub fn places(&self) -> Places {
        Places { jobs: self.jobs, threads: self.threads, short_seconds: self.short_job_seconds as f64 }
    }

    fn check(mut self) -> Result<Self, String> {
        self.database_url = store_location::database_url(&self.database_url, Some(&self.database_url_file))?;
        self.check_places()?;
        if self.jobs.get() > MAX_JOBS {
            return Err(format!("jobs: expected at most {MAX_JOBS}, got {}", self.jobs));
        }
        if self.max_matrix_bytes > MAX_MATRIX_BYTES {
            let found = self.max_matrix_bytes;
            return Err(format!("max_matrix_bytes: expected at most {MAX_MATRIX_BYTES}, got {found}"));
        }
        if self.tls_cert.as_os_str().is_empty() != self.tls_key.as_os_str().is_empty() {
            return Err("expected both tls_cert and tls_key, or neither".into());
        }
        if self.max_head_bytes < MIN_HEAD_BYTES {
            let found = self.max_head_bytes;
            return Err(format!("max_head_bytes: expected at least {MIN_HEAD_BYTES}, got {found}"));
        }
        if let Some(other) = self.origins().find(|origin| !is_origin(origin)) {
            return Err(format!(
                "allow_origin: expected origins such as https://dashboard.example, without a path, got '{other}'"
            ));
        }
        if self.max_streams == 0 {
            return Err("max_streams: expected at least 1, got 0".into());
        }
        if self.max_buffered_bytes > 0 && self.max_buffered_bytes < self.max_body_bytes {
            let (found, body) = (self.max_buffered_bytes, self.max_body_bytes);
            return Err(format!(
                "max_buffered_bytes: expected at least max_body_bytes, which is {body}, got {found}"
            ));
        }
        if self.oidc_leeway_seconds > MAX_LEEWAY_SECONDS {
            let found = self.oidc_leeway_seconds;
            return Err(format!("oidc_leeway_seconds: expected at most {MAX_LEEWAY_SECONDS}, got {found}"));
        }
        if self.engine.as_os_str().is_empty() != self.engine_store.is_empty() {
            return Err("expected both engine and engine_store, or neither".into());
        }
        if self.oidc_issuer.is_empty() != self.oidc_audience.is_empty() {
            // Without an audience, a token issued for any other service would be accepted.
            return Err("expected both oidc_issuer and oidc_audience, or neither".into());
        }
        Network::list(&self.hook_networks).map_err(|error| format!("hook_networks: {error}"))?;
        tokens::roles_of_groups(&self.oidc_role_map).map_err(|error| format!("oidc_role_map: {error}"))?;
        if self.oidc_issuer.is_empty() && !self.oidc_client_id.is_empty() {
            return Err("expected oidc_issuer with oidc_client_id".into());
        }
        Ok(self)
    }

    fn check_places(&self) -> Result<(), String> {
        if self.data_dir.to_str().is_some_and(|text| text.contains("://")) {
            return Err(
                "data_dir: expected a folder, got an address: that of PostgreSQL is database_url".into()
            );
        }
        match self.engine_store.split_once("://") {
            Some((scheme, _)) if scheme != "s3" => {
                Err(format!("engine_store: expected a folder or s3://bucket/folder, got {scheme}://"))
            }
            _ => Ok(()),
        }
    }

    /// Settings of hooks.
    pub fn hooks(&self) -> HookSettings {
        // Checked at the start.
        let networks = Network::list(&self.hook_networks).unwrap_or_default();
        HookSettings { allow_private: self.allow_private_hooks, networks, days: self.hook_days }
    }

    /// The engine that jobs and means may use.
    pub fn engine(&self) -> EngineSettings {
        EngineSettings {
            program: self.engine.clone(),
            store: self.engine_store.clone(),
            scheduler: self.engine_scheduler.clone(),
            min_shapes: self.engine_min_shapes.get(),
        }
    }

    /// Access control settings.
    pub fn access(&self) -> AccessSettings {
        let given = |text: &String| (!text.is_empty()).then(|| text.clone());
        let tokens = given(&self.oidc_issuer).map(|issuer| TokenSettings {
            issuer,
            audience: self.oidc_audience.clone(),
            jwks_url: given(&self.oidc_jwks_url),
            role_claim: self.oidc_role_claim.clone(),
            // Checked at the start.
            roles: tokens::roles_of_groups(&self.oidc_role_map).unwrap_or_default(),
            tenant_claim: given(&self.oidc_tenant_claim),
            leeway_s: self.oidc_leeway_seconds,
            access_only: self.oidc_require_at_jwt,
        });
        let login = given(&self.oidc_client_id).map(|client_id| LoginSettings {
            issuer: self.oidc_issuer.clone(),
            client_id,
            scope: self.oidc_scope.clone(),
        });
        AccessSettings {
            loopback: self.listen.ip().is_loopback(),
            metrics_open: self.metrics_open,
            origins: self.origins().map(str::to_owned).collect(),
            tokens,
            login,
        }
    }
}

fn read_file(path: &Path) -> Result<ServeArgs, String> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| format!("{name}: {error}"))?;
    toml::from_str(&text).map_err(|error| format!("{name}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A default in the words of the file.
    pub(super) fn written<T: std::fmt::Debug>(value: &T) -> String {
        format!("{value:?}").trim_matches('"').to_lowercase()
    }

    /// The page of settings says of each its flag, its variable, its default and its help. With `WRITE_SETTINGS` in the environment, the
    /// page is written.
    #[test]
    fn the_page_of_settings_is_true() {
        let defaults = ServeConfig::defaults();
        let default =
            |name: &str| defaults.iter().find(|(field, _)| *field == name).map(|(_, text)| text.as_str());
        let row = |setting: &clap::Arg| {
            let (name, env) = (setting.get_id().as_str(), setting.get_env().unwrap().to_str().unwrap());
            let value = match default(name) {
                Some("") | None if name != "no_example" => String::new(),
                value => format!("`{}`", value.unwrap_or("false")),
            };
            let flag = setting.get_long().unwrap();
            format!("| `--{flag}` | `{env}` | {value} | {} |\n", setting.get_help().unwrap())
        };
        let settings = ServeArgs::augment_args(clap::Command::new("serve"));
        let rows: String = settings.get_arguments().map(row).collect();
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/settings.md");
        let page = std::fs::read_to_string(&path).unwrap();
        let (before, after) = page.split_once("<!-- settings begin -->\n").unwrap();
        let (_, after) = after.split_once("<!-- settings end -->").unwrap();
        let head = "| flag | variable | default | meaning |\n|---|---|---|---|\n";
        let expected = format!("{before}<!-- settings begin -->\n{head}{rows}<!-- settings end -->{after}");
        if std::env::var_os("WRITE_SETTINGS").is_some() {
            std::fs::write(path, expected).unwrap();
        } else {
            assert_eq!(page, expected, "WRITE_SETTINGS=1 cargo test --lib page_of_settings writes it");
        }
    }

    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shapelex.toml");
        let text = "threads = 3\nmax_shapes = 7\nno_example = true\nmax_body_bytes = \"64MB\"\nlisten = \"localhost:1\"\n";
        std::fs::write(&path, text).unwrap();
        let args = ServeArgs { config: Some(path), threads: Some(1), ..ServeArgs::default() };
        let config = ServeConfig::load(args).unwrap();
        assert_eq!((config.threads, config.max_shapes, config.no_example), (1, 7, true));
        assert_eq!((config.max_body_bytes, config.listen), (64_000_000, ([127, 0, 0, 1], 1).into()));
        assert_eq!(config.max_points, Limits::default().points);
    }

    #[test]
    fn unknown_settings_and_senseless_values_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shapelex.toml");
        std::fs::write(&path, "thread = 3\n").unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("thread"));
        let args = ServeArgs { oidc_issuer: Some("https://id.example".into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("oidc_audience"));
        let args = ServeArgs { oidc_client_id: Some("page".into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("oidc_issuer"));
        let args = ServeArgs { hook_networks: Some("clinic".into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().starts_with("hook_networks: expected networks"));
        let args = ServeArgs { oidc_role_map: Some("staff=root".into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().starts_with("oidc_role_map: expected groups"));
        let args = ServeArgs { oidc_leeway_seconds: Some(301), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("at most 300"));
        let args = ServeArgs { jobs: NonZeroUsize::new(65), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("at most 64"));
        let args = ServeArgs { tls_cert: Some("chain.pem".into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("both tls_cert and tls_key"));
        let origins = |text: &str| ServeArgs { allow_origin: Some(text.into()), ..ServeArgs::default() };
        for wrong in
            ["*", "null", "dashboard.example", "https://a.example/", "https://A.example", "https://a.b/c"]
        {
            let refused = ServeConfig::load(origins(&format!("https://ok.example, {wrong}")));
            assert!(refused.unwrap_err().contains(&format!("'{wrong}'")), "{wrong}");
        }
        let config = ServeConfig::load(origins("https://a.example, http://localhost:3000")).unwrap();
        assert_eq!(config.access().origins, ["https://a.example", "http://localhost:3000"]);
        let args = ServeArgs { max_head_bytes: Some(Bytes(100)), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("at least 8192"));
        let args = ServeArgs { max_buffered_bytes: Some(Bytes(1 << 20)), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("at least max_body_bytes"));
        let refused = |args: ServeArgs| ServeConfig::load(args).unwrap_err();
        let folder_of = |text: &str| ServeArgs { data_dir: Some(text.into()), ..ServeArgs::default() };
        assert!(refused(folder_of("postgres://a/b")).contains("database_url"));
        let bucket = ServeArgs { engine_store: Some("gs://a/b".into()), ..ServeArgs::default() };
        assert!(refused(bucket).contains("got gs://"));
        let path = folder.path().join("none.toml");
        std::fs::write(&path, "jobs = 0\n").unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("nonzero"));
    }

    #[test]
    fn who_is_let_in_follows_from_the_address_and_the_provider() {
        let access = |args: ServeArgs| ServeConfig::load(args).unwrap().access();
        assert_eq!(
            access(ServeArgs::default()),
            AccessSettings { loopback: true, ..AccessSettings::default() }
        );
        let public = ServeArgs {
            listen: Some(":80".parse().unwrap()),
            oidc_issuer: Some("https://id.example".into()),
            oidc_audience: Some("shapelex".into()),
            ..ServeArgs::default()
        };
        let access = access(public);
        let tokens = access.tokens.unwrap();
        assert!(!access.loopback && !access.metrics_open);
        assert_eq!((tokens.role_claim.as_str(), tokens.jwks_url, tokens.tenant_claim), ("roles", None, None));
    }
}
