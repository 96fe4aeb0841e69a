//! Predicted cost of mean and components on a number of executors, before anything runs.
//!
//! ```text
//! processor time   n (p (a w + s) + q b w²)            n shapes of w numbers, p passes, q sums of products of a shape with itself
//! elapsed          p (⌈tasks / executors⌉ t + c)        t processor time of a task in a pass, or the time to read it; c for each pass
//! ```
//!
//! The constants are measured on one machine ("Measured" in `docs/scale.md`); another one differs by a factor, the same for all lines.

use serde::Serialize;
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::alignment::Method;

use crate::cohort::revision::{Revision, Setting};
use crate::pass::division::{Division, MIN_GROUPS};

/// Seconds in which a number is read from the cache of the system, compared with its digest, decoded and prepared: `a`.
const NUMBER_S: f64 = 1.4e-9;

/// Seconds for each shape of a pass: `s`.
const SHAPE_S: f64 = 4.5e-7;

/// Seconds for each product of two numbers of a shape in a sum: `b`.
const PRODUCT_S: f64 = 4.0e-11;

/// Seconds for each pass: submission, results, the eigenproblem of small shapes: `c`.
const PASS_S: f64 = 0.15;

/// Usual number of iterations of a Procrustes mean.
const ITERATIONS: f64 = 10.0;

/// Memory of a process before it reads anything, in bytes.
const PROCESS_BYTES: f64 = 150e6;

/// What a run on a number of executors takes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Number of tasks that run at the same time.
    pub executors: usize,
    /// Elapsed seconds.
    pub seconds: f64,
    /// Seconds of processor time of all executors.
    pub processor_seconds: f64,
    /// Bytes that executors read from the store.
    pub read_bytes: f64,
    /// Bytes of results that reach the client.
    pub moved_bytes: f64,
    /// Peak memory of an executor with one task, in bytes.
    pub executor_bytes: f64,
    /// Peak memory of the client, in bytes.
    pub client_bytes: f64,
}

impl Estimate {
    /// The mean of a revision, and its components if `components`, on `executors` tasks at a time, each of which reads
    /// `read_bytes_per_s` from the store.
    pub fn new(
        revision: &Revision,
        setting: &Setting,
        components: bool,
        executors: usize,
        read_bytes_per_s: f64,
    ) -> Self {
        let (shapes, width) = (revision.shapes() as f64, revision.width() as f64);
        let tasks = Division::new(revision.parts(), MIN_GROUPS).tasks();
        let scatters = f64::from(u8::from(components));
        let (passes, sums) = match &setting.method {
            Method::Projection(_) => (2.0 + scatters, 1.0 + scatters),
            Method::Procrustes(_) => (ITERATIONS + scatters, scatters),
        };
        let file_bytes: f64 = revision.manifest().parts.iter().map(|part| part.size_bytes as f64).sum();
        let processor_seconds =
            shapes * (passes * (NUMBER_S * width + SHAPE_S) + sums * PRODUCT_S * width * width);
        let reading = passes * file_bytes / read_bytes_per_s;
        // A task is as long as its arithmetic or its reading, whichever is longer; the last round may be half empty.
        let task = processor_seconds.max(reading) / tasks.max(1) as f64;
        let rounds = tasks.div_ceil(executors.max(1)) as f64;
        let state = 8.0 * width * width;
        let part = PART as f64 * 8.0 * width;
        Self {
            executors,
            seconds: rounds * task + passes * PASS_S,
            processor_seconds,
            read_bytes: passes * file_bytes,
            moved_bytes: sums * tasks as f64 * state,
            executor_bytes: PROCESS_BYTES + 6.0 * part + 3.0 * state,
            client_bytes: PROCESS_BYTES + 8.0 * shapes + 2.0 * (FAN_IN as f64) * state,
        }
    }
}
