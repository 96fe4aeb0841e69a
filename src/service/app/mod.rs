//! Foundations shared by all use cases.
//!
//! * [`App`] — the context of a use case; [`Limits`] — limits on sizes and times;
//! * [`pool`] — compute threads, shared fairly between tenants; [`work`] — predicted cost; [`progress`] — progress and
//!   cancellation of a computation;
//! * `parallel` — loops over entries on these threads;
//! * [`cache`] — results that are expensive to compute; `state` — state of a use case for the life of the process;
//! * [`incoming`] — bodies for readers that wait for bytes; [`outgoing`] — answers of such writers;
//! * [`memory`] — accounts of memory; [`shares`] — places that a caller holds at once; [`clock`] — plausibility of the machine's clock;
//! * [`idempotency`] — requests that are sent again; [`touched`] — objects that a request concerns;
//! * [`error`], [`problem`] — errors of use cases and their documents for clients;
//! * [`metrics`], [`scrape`] — counters and gauges, and their text; [`build`] — version, commit and compiler.

pub mod build;
pub mod cache;
pub mod clock;
mod context;
pub mod error;
pub mod faults;
pub mod idempotency;
pub mod incoming;
mod limits;
pub mod memory;
pub mod metrics;
pub mod outgoing;
pub(crate) mod parallel;
pub mod pool;
pub mod problem;
pub mod progress;
mod recorder;
pub mod scrape;
pub mod shares;
mod state;
pub mod touched;
pub mod work;

pub use self::clock::now_ms;
pub use self::context::App;
pub use self::error::{Page, ServiceError};
pub use self::limits::Limits;
pub use self::work::Work;
