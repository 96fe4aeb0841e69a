//! Jobs: long work that survives a restart, with its progress and its outcome.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::access::Principal;

/// Kind of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// Learns a dictionary from a cohort.
    LearnDictionary,
    /// Computes the distances between all pairs of shapes of a cohort.
    Distances,
    /// Compares groups of shapes.
    Compare,
    /// Regresses shapes on an attribute.
    Regress,
    /// Fits a linear model to shapes.
    Model,
    /// Measures the repeatability of shapes.
    Repeatability,
    /// Measures how blocks vary together.
    TwoBlocks,
    /// Measures whether parts of shapes are modules.
    Modularity,
    /// Measures symmetry and asymmetry.
    Symmetry,
    /// Assesses the shapes of a cohort with a dictionary.
    Assess,
    /// Segments objects of an image.
    Segment,
    /// Examines the modes of a dictionary.
    Report,
    /// Brings the surfaces of a cohort into correspondence.
    Correspond,
}

impl JobKind {
    /// Name used in JSON and the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::LearnDictionary => "learn_dictionary",
            Self::Distances => "distances",
            Self::Compare => "compare",
            Self::Regress => "regress",
            Self::Model => "model",
            Self::Repeatability => "repeatability",
            Self::TwoBlocks => "two_blocks",
            Self::Modularity => "modularity",
            Self::Symmetry => "symmetry",
            Self::Assess => "assess",
            Self::Segment => "segment",
            Self::Report => "report",
            Self::Correspond => "correspond",
        }
    }
}

/// Status of a job: `queued ⇄ running → succeeded | failed | cancelled`, and `queued → failed | cancelled`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum JobStatus {
    /// Waiting for its turn, or for the next attempt.
    Queued,
    /// Being processed by a worker.
    Running,
    /// Finished, with a result.
    Succeeded,
    /// Failed, with a problem document.
    Failed,
    /// Cancelled on request.
    Cancelled,
}

impl JobStatus {
    /// Name used in JSON and the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether the status is final.
    pub fn is_finished(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// Conditions on the jobs of a list; all must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct JobFilter {
    /// Jobs with this status.
    pub status: Option<JobStatus>,
    /// Jobs of this kind.
    pub kind: Option<JobKind>,
    /// Jobs on the cohort with this id.
    pub cohort: Option<String>,
    /// Jobs created at this time or later, milliseconds since 1970 UTC.
    pub since_ms: Option<i64>,
}

/// Progress of an attempt.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Progress {
    /// Fraction completed, 0 to 1.
    pub fraction: f64,
    /// Current phase of the work.
    pub phase: Option<&'static str>,
    /// Current value of the quantity that is minimised or maximised.
    pub objective: Option<f64>,
}

/// Parameter of a job that tells who has submitted it.
const SUBMITTED_BY: &str = "submitted_by";

/// Weight of the prediction against the rate so far, as a fraction of the job: the first percent says little of the rest.
const TRUST: f64 = 0.05;

/// Priority among the jobs of a tenant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// Runs when nothing else is waiting.
    Low,
    /// Runs in order of creation.
    #[default]
    Normal,
    /// Runs before all others.
    High,
}

impl Priority {
    /// Rank, larger for jobs that run earlier; the rank of [`Priority::Normal`] is 0.
    pub fn rank(self) -> i64 {
        match self {
            Self::Low => -1,
            Self::Normal => 0,
            Self::High => 1,
        }
    }
}

/// Output of a job that is too large for its result and is stored beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct JobOutput {
    /// Description of the data.
    pub head: Value,
    /// The data.
    pub data: Vec<u8>,
}

/// Parts of an output that was stored piece by piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputParts {
    /// Attempt that stored them.
    pub attempt: u32,
    /// Number of parts.
    pub count: u64,
    /// Their total size.
    pub bytes: u64,
}

impl JobOutput {
    /// Output that consists of `parts`.
    pub fn in_parts(parts: OutputParts) -> Self {
        Self { head: serde_json::json!({"parts": parts}), data: Vec::new() }
    }

    /// Its parts, if it was stored in parts.
    pub fn parts(&self) -> Option<OutputParts> {
        Self::parts_in(&self.head)
    }

    /// Output that is a file of this media type.
    pub fn of_file(media_type: &str, data: Vec<u8>) -> Self {
        Self { head: serde_json::json!({"media_type": media_type}), data }
    }

    /// Media type of an output that is a file.
    pub fn media_type(&self) -> Option<&str> {
        self.head.get("media_type")?.as_str()
    }

    /// Whether the output is a model that is kept for predictions.
    pub fn is_model(&self) -> bool {
        self.head.get("model").is_some()
    }

    /// Parts that the head of an output describes.
    pub fn parts_in(head: &Value) -> Option<OutputParts> {
        OutputParts::deserialize(head.get("parts")?).ok()
    }
}

/// A long-running computation.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Identifier, `job_…`.
    pub id: String,
    /// Kind of work.
    pub kind: JobKind,
    /// Parameters, in the form that the kind requires.
    pub parameters: Value,
    /// Current status.
    pub status: JobStatus,
    /// Fraction completed, 0 to 1.
    pub progress: f64,
    /// Current phase of the work.
    pub phase: Option<String>,
    /// Current value of the quantity that is minimised or maximised.
    pub objective: Option<f64>,
    /// Number of attempts begun, not counting those that ended because the service stopped.
    pub attempt: u32,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
    /// Start of the current or last attempt, milliseconds since 1970 UTC.
    pub started_at_ms: Option<i64>,
    /// Time at which the job finished, milliseconds since 1970 UTC.
    pub finished_at_ms: Option<i64>,
    /// Result, if it succeeded.
    pub result: Option<Value>,
    /// Problem document, if it failed.
    pub problem: Option<Value>,
}

impl Job {
    /// A new job that waits for its first attempt.
    pub fn new(kind: JobKind, parameters: Value, now_ms: i64) -> Self {
        Self {
            id: super::id::new_id(super::id::JOB),
            kind,
            parameters,
            status: JobStatus::Queued,
            progress: 0.0,
            phase: None,
            objective: None,
            attempt: 0,
            created_at_ms: now_ms,
            started_at_ms: None,
            finished_at_ms: None,
            result: None,
            problem: None,
        }
    }

    /// Id of the cohort that the job works on, if its parameters name one.
    pub fn cohort(&self) -> Option<&str> {
        self.parameters.get("cohort").and_then(Value::as_str)
    }

    /// Adds the predicted duration and the priority, which are stored among the parameters.
    #[must_use]
    pub fn weighing(mut self, seconds: f64, priority: Priority) -> Self {
        if let Some(parameters) = self.parameters.as_object_mut() {
            parameters.insert("predicted_seconds".into(), seconds.into());
            if priority != Priority::Normal {
                parameters.insert("priority".into(), priority.rank().into());
            }
        }
        self
    }

    /// Notes by whom it is submitted, among the parameters.
    #[must_use]
    pub fn submitted_by(mut self, caller: &Principal) -> Self {
        if let Some(parameters) = self.parameters.as_object_mut() {
            parameters.insert(SUBMITTED_BY.into(), caller.fingerprint().into());
        }
        self
    }

    /// Whether this caller has submitted it; jobs of earlier versions are nobody's.
    pub fn is_of(&self, caller: &Principal) -> bool {
        self.parameters[SUBMITTED_BY].as_str() == Some(&caller.fingerprint())
    }

    /// Predicted duration in seconds, 0 if unknown.
    pub fn predicted_seconds(&self) -> f64 {
        self.parameters["predicted_seconds"].as_f64().unwrap_or(0.0)
    }

    /// Estimated seconds until a running job ends: from its rate so far, and at its beginning from the prediction. `None` if it
    /// is not running.
    pub fn seconds_left(&self, now_ms: i64) -> Option<f64> {
        let started = self.started_at_ms.filter(|_| self.status == JobStatus::Running)?;
        let elapsed = now_ms.saturating_sub(started).max(0) as f64 / 1000.0;
        let whole = (elapsed + TRUST * self.predicted_seconds()) / (self.progress + TRUST);
        Some(whole * (1.0 - self.progress))
    }

    /// Updates the job with the `progress` of its attempt.
    pub fn with_progress(mut self, progress: &Progress) -> Self {
        self.progress = progress.fraction;
        self.phase = progress.phase.map(str::to_owned);
        self.objective = progress.objective;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_time_left_follows_the_prediction_and_then_the_rate() {
        let mut job = Job::new(JobKind::Distances, json!({}), 0).weighing(100.0, Priority::Normal);
        assert_eq!(job.seconds_left(5_000), None);
        (job.status, job.started_at_ms) = (JobStatus::Running, Some(10_000));
        assert!((job.seconds_left(10_000).unwrap() - 100.0).abs() < 1e-9);
        // Half is done in 20 s.
        job.progress = 0.5;
        let left = job.seconds_left(30_000).unwrap();
        assert!((20.0..30.0).contains(&left), "{left}");
        // The clock of another replica may be behind.
        assert!(job.seconds_left(0).unwrap() >= 0.0);
        job.status = JobStatus::Succeeded;
        assert_eq!(job.seconds_left(40_000), None);
    }
}
