//! What all use cases share.
//!
//! * [`App`] — the context of a use case; [`Limits`] — sizes and times that are accepted;
//! * [`pool`] — the threads that compute, shared fairly between tenants; [`work`] — predicted cost; [`progress`] — progress and
//!   cancellation of one computation;
//! * [`cache`] — results that are asked for again and again; `state` — what one use case keeps for the life of the process;
//! * [`memory`] — accounts of memory; [`clock`] — whether the clock of the machine can be trusted;
//! * [`idempotency`] — requests that are sent again; [`touched`] — objects that a request is about;
//! * [`error`], [`problem`] — why a use case did not happen, and how clients are told; [`warnings`] — what a result does not show;
//! * [`metrics`], [`scrape`] — counters and gauges, and their text; [`build`] — version, commit and compiler.

pub mod build;
pub mod cache;
pub mod clock;
mod context;
pub mod error;
pub mod idempotency;
mod limits;
pub mod memory;
pub mod metrics;
pub mod pool;
pub mod problem;
pub mod progress;
pub mod scrape;
mod state;
pub mod touched;
pub mod warnings;
pub mod work;

pub use self::clock::now_ms;
pub use self::context::App;
pub use self::error::{Fault, Page, ServiceError};
pub use self::limits::Limits;
pub use self::work::Work;
