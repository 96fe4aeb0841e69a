//! Passes on many machines: schedulers and executors of Apache Ballista.
//!
//! ```text
//! client ── a job: 64 parts, or 64 groups of parts ──► scheduler ◄── tasks, results ── executors ──► object store
//!    ▲ a state for each part or group                                                      │
//!    └─────────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! A job computes one node of the tree by which sums are merged: its tasks make the children, and the client merges them in their
//! order. So no task waits for another, nothing is exchanged between executors, and the bits are those of one process. Results that a client
//! has received are never computed again: when a scheduler or an executor dies, the client submits the jobs that are not done.
//!
//! * [`client`] — a [`Runner`](crate::pass::subject::Runner) that submits jobs and merges the results;
//! * [`scheduler`], [`executor`] — the two processes;
//! * [`codec`] — our operators as bytes; `metrics` — counts of the two processes, in the format of Prometheus;
//! * [`network`] — certificates, addresses, and the check that all processes are of one build.

pub mod client;
pub mod codec;
pub mod executor;
mod metrics;
pub mod network;
pub mod scheduler;
