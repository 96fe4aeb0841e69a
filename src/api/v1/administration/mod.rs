//! Jobs, events, hooks, keys, audit and settings.

pub(in crate::api) mod audit;
pub(in crate::api) mod events;
pub(in crate::api) mod hooks;
pub mod jobs;
pub(in crate::api) mod keys;
pub(in crate::api) mod settings;
pub(in crate::api) mod version;
