//! Shapelex: shape statistics as a network service.
//!
//! Layers, each using only those below it (a test reads the imports):
//!
//! | layer | modules |
//! |---|---|
//! | wiring | `cli`, `server`, `config`, `health`, `opening`, `telemetry` |
//! | the doors | [`api`], [`worker`] |
//! | use cases | [`service`] |
//! | storage | [`store`] |
//! | identities | [`domain`] |
//! | bytes ⇄ shapes | [`formats`] |
//! | statistics | [`analysis`] |
//! | shapes | [`geometry`] |
//! | arithmetic | [`numeric`] |
//!
//! Analysis sees every shape as an `N × d` matrix of control points and one Gram operator.

pub mod analysis;
pub mod api;
pub mod cli;
pub mod config;
pub mod domain;
pub mod formats;
pub mod geometry;
mod health;
pub mod numeric;
mod opening;
mod server;
pub mod service;
pub mod store;
pub mod telemetry;
pub mod worker;
