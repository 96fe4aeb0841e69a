//! A job: long work that survives a restart, with its progress and its outcome.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// A dictionary is learnt from a cohort.
    LearnDictionary,
    /// The distances of all pairs of shapes of a cohort are computed.
    Distances,
    /// Groups of shapes are compared.
    Compare,
    /// Shapes are regressed on an attribute.
    Regress,
}

impl JobKind {
    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::LearnDictionary => "learn_dictionary",
            Self::Distances => "distances",
            Self::Compare => "compare",
            Self::Regress => "regress",
        }
    }
}

/// Where a job is: `queued ⇄ running → succeeded | failed | cancelled`, and `queued → failed | cancelled`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobStatus {
    /// Waits for its turn, or for the next attempt.
    Queued,
    /// Somebody works on it.
    Running,
    /// Done; there is a result.
    Succeeded,
    /// Given up; there is a problem.
    Failed,
    /// Stopped because somebody asked for it.
    Cancelled,
}

impl JobStatus {
    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether it stays so for ever.
    pub fn is_finished(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// How far an attempt is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Progress {
    /// Fraction that is done, 0 to 1.
    pub fraction: f64,
    /// What it is at.
    pub phase: Option<&'static str>,
    /// What is minimised or maximised, so far.
    pub objective: Option<f64>,
}

/// Which of the jobs of a tenant comes first.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// When nothing else waits.
    Low,
    /// In the order in which they came.
    #[default]
    Normal,
    /// Before all others.
    High,
}

impl Priority {
    /// As a number, larger for what comes first; that of [`Priority::Normal`] is 0.
    pub fn rank(self) -> i64 {
        match self {
            Self::Low => -1,
            Self::Normal => 0,
            Self::High => 1,
        }
    }
}

/// What a job has brought about that is too large for its result: kept beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct JobOutput {
    /// What the bytes are.
    pub head: Value,
    /// The bytes.
    pub data: Vec<u8>,
}

/// A job.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// `job_…`.
    pub id: String,
    /// What is to be done.
    pub kind: JobKind,
    /// What it is to be done with; of the kind.
    pub parameters: Value,
    /// Where it is.
    pub status: JobStatus,
    /// Fraction that is done, 0 to 1.
    pub progress: f64,
    /// What it is at.
    pub phase: Option<String>,
    /// What is minimised or maximised, so far.
    pub objective: Option<f64>,
    /// Attempts that were begun, without those that a stop of the service ended.
    pub attempt: u32,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
    /// When the present or last attempt began.
    pub started_at_ms: Option<i64>,
    /// When it was finished.
    pub finished_at_ms: Option<i64>,
    /// What came out, when it succeeded.
    pub result: Option<Value>,
    /// Why it failed: a problem document.
    pub problem: Option<Value>,
}

impl Job {
    /// A job that waits for its first attempt.
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

    /// The same job with what it is predicted to take and how urgent it is, which stand beside its parameters.
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

    /// What it is predicted to take, 0 where that is not known.
    pub fn predicted_seconds(&self) -> f64 {
        self.parameters["predicted_seconds"].as_f64().unwrap_or(0.0)
    }

    /// The same job as far as `progress` says.
    pub fn with_progress(mut self, progress: &Progress) -> Self {
        self.progress = progress.fraction;
        self.phase = progress.phase.map(str::to_owned);
        self.objective = progress.objective;
        self
    }
}
