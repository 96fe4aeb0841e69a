//! Shapelex: shape statistics as a network service.
//!
//! Layers, each using only those below it (enforced by a test):
//!
//! | layer | modules |
//! |---|---|
//! | wiring | `cli`, `server`, `config`, `health`, `store_location`, `telemetry`, [`testing`] |
//! | entry points | [`api`], [`worker`] |
//! | use cases | [`service`] |
//! | storage | [`store`], of the crate `shapelex-store` |
//! | domain values | [`domain`], of the same crate |
//! | conversion between bytes, images and shapes; images to shapes | [`wire`], [`segmentation`], a crate |
//! | statistics | [`analysis`], a crate |
//! | shapes | [`geometry`], a crate |
//! | arithmetic | [`numeric`], a crate |
//!
//! Analysis sees every shape as an `N × d` matrix of control points and one Gram operator.

// Without the feature, attributes of the sources for the OpenAPI document have no effect.
#[cfg(not(feature = "schema"))]
extern crate shapelex_schemaless as utoipa;

pub mod api;
pub mod cli;
pub mod config;
mod health;
mod server;
pub mod service;
mod store_location;
pub mod telemetry;
pub mod testing;
pub mod wire;
pub mod worker;

pub use shapelex_analysis as analysis;
pub use shapelex_geometry as geometry;
pub use shapelex_numeric as numeric;
pub use shapelex_segmentation as segmentation;
pub use shapelex_store::{domain, store};
