//! Configuration: a flag, else its environment variable, else the config file, else the default.

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Deserialize;

use crate::service::Limits;
use crate::worker::Places;

/// Most jobs at once: each has threads of its own.
const MAX_JOBS: usize = 64;
/// Most bytes of a matrix: what is stored as one piece must stay below a billion.
const MOST_MATRIX_BYTES: usize = 900_000_000;

/// Declares the settings once: flags, environment, file and defaults are made from one list.
macro_rules! serve_settings {
    ($($(#[doc = $doc:literal])* $field:ident: $type:ty = $env:literal, $default:expr;)*) => {
        /// Flags of `shapelex serve`; the same names, in snake case, in the config file.
        #[derive(Debug, Default, Clone, Args, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct ServeArgs {
            /// TOML file with settings
            #[arg(long, env = "SHAPELEX_CONFIG", value_name = "FILE")]
            #[serde(skip)]
            config: Option<PathBuf>,
            /// Leave an empty store empty instead of loading the example cohort
            #[arg(long, env = "SHAPELEX_NO_EXAMPLE", num_args = 0..=1, default_missing_value = "true")]
            no_example: Option<bool>,
            $($(#[doc = $doc])* #[arg(long, env = $env)] $field: Option<$type>,)*
        }

        /// Settings of the running service.
        #[derive(Debug, Clone, PartialEq)]
        pub struct ServeConfig {
            /// Leave an empty store empty.
            pub no_example: bool,
            $($(#[doc = $doc])* pub $field: $type,)*
        }

        impl ServeConfig {
            /// Flags over environment over file over defaults.
            ///
            /// # Errors
            /// A file that cannot be read, with its name; values that make no sense.
            pub fn load(args: ServeArgs) -> Result<Self, String> {
                let file = args.config.as_deref().map_or_else(|| Ok(ServeArgs::default()), read_file)?;
                let config = Self {
                    no_example: args.no_example.or(file.no_example).unwrap_or(false),
                    $($field: args.$field.or(file.$field).unwrap_or_else(|| $default),)*
                };
                config.check()
            }
        }
    };
}

serve_settings! {
    /// Address to listen on; port 0 takes a free one and prints it
    listen: SocketAddr = "SHAPELEX_LISTEN", SocketAddr::from(([127, 0, 0, 1], 8080));
    /// Folder of the embedded store, made when missing
    data_dir: PathBuf = "SHAPELEX_DATA_DIR", PathBuf::from("shapelex-data");
    /// Compute threads; 0 takes one per core
    threads: usize = "SHAPELEX_THREADS", 0;
    /// Jobs that run at once, on compute threads of their own, as many as those of the requests
    jobs: NonZeroUsize = "SHAPELEX_JOBS", NonZeroUsize::MIN;
    /// Longest request body in bytes, after decompression (streams are bounded by their lines instead)
    max_body_bytes: usize = "SHAPELEX_MAX_BODY_BYTES", Limits::default().body_bytes;
    /// Longest line of an NDJSON stream in bytes
    max_line_bytes: usize = "SHAPELEX_MAX_LINE_BYTES", Limits::default().line_bytes;
    /// Most shapes of a request that is answered from memory
    max_shapes: usize = "SHAPELEX_MAX_SHAPES", Limits::default().shapes;
    /// Most points of a posted contour
    max_points: usize = "SHAPELEX_MAX_POINTS", Limits::default().points;
    /// Most control points of a representation
    max_control_points: usize = "SHAPELEX_MAX_CONTROL_POINTS", Limits::default().control_points;
    /// Most atoms or components of a dictionary
    max_atoms: usize = "SHAPELEX_MAX_ATOMS", Limits::default().atoms;
    /// Most bytes of memory that a job may be predicted to take; more are refused before it runs
    max_job_bytes: usize = "SHAPELEX_MAX_JOB_BYTES", Limits::default().job_bytes;
    /// Most bytes of a distance matrix, at most 900 million
    max_matrix_bytes: usize = "SHAPELEX_MAX_MATRIX_BYTES", Limits::default().matrix_bytes;
    /// Most multiply-adds that a distance matrix may be predicted to take to be answered at once; larger ones become a job
    max_matrix_operations: usize = "SHAPELEX_MAX_MATRIX_OPERATIONS", Limits::default().matrix_operations;
    /// Most multiply-adds that a search may be predicted to take
    max_search_operations: usize = "SHAPELEX_MAX_SEARCH_OPERATIONS", Limits::default().search_operations;
    /// Log filter, such as `info` or `shapelex=debug`
    log: String = "SHAPELEX_LOG", "info".into();
    /// Log format
    log_format: LogFormat = "SHAPELEX_LOG_FORMAT", LogFormat::Text;
}

/// How log lines are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

impl ServeConfig {
    /// Sizes that requests are checked against.
    pub fn limits(&self) -> Limits {
        Limits {
            control_points: self.max_control_points,
            points: self.max_points,
            shapes: self.max_shapes,
            body_bytes: self.max_body_bytes,
            line_bytes: self.max_line_bytes,
            atoms: self.max_atoms,
            job_bytes: self.max_job_bytes,
            matrix_bytes: self.max_matrix_bytes,
            matrix_operations: self.max_matrix_operations,
            search_operations: self.max_search_operations,
            ..Limits::default()
        }
    }

    /// Where jobs run.
    pub fn places(&self) -> Places {
        Places { jobs: self.jobs, threads: self.threads }
    }

    fn check(self) -> Result<Self, String> {
        if self.jobs.get() > MAX_JOBS {
            return Err(format!("jobs is {}, must be at most {MAX_JOBS}", self.jobs));
        }
        if self.max_matrix_bytes > MOST_MATRIX_BYTES {
            let found = self.max_matrix_bytes;
            return Err(format!("max_matrix_bytes is {found}, must be at most {MOST_MATRIX_BYTES}"));
        }
        // Nobody is asked for a key: a public address would be open to the world.
        if self.listen.ip().is_loopback() {
            return Ok(self);
        }
        Err(format!(
            "refusing to listen on {}: there is no access control yet, only loopback addresses are allowed \
             (put an authenticating proxy in front)",
            self.listen
        ))
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

    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shapelex.toml");
        std::fs::write(&path, "threads = 3\nmax_shapes = 7\nno_example = true\n").unwrap();
        let args = ServeArgs { config: Some(path), threads: Some(1), ..ServeArgs::default() };
        let config = ServeConfig::load(args).unwrap();
        assert_eq!((config.threads, config.max_shapes, config.no_example), (1, 7, true));
        assert_eq!(config.max_points, Limits::default().points);
    }

    #[test]
    fn an_unknown_setting_and_a_public_address_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shapelex.toml");
        std::fs::write(&path, "thread = 3\n").unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("thread"));
        let args = ServeArgs { listen: Some(([0, 0, 0, 0], 80).into()), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("loopback"));
        let args = ServeArgs { jobs: NonZeroUsize::new(65), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("at most 64"));
        let path = folder.path().join("none.toml");
        std::fs::write(&path, "jobs = 0\n").unwrap();
        let args = ServeArgs { config: Some(path), ..ServeArgs::default() };
        assert!(ServeConfig::load(args).unwrap_err().contains("nonzero"));
    }
}
