//! Shapelex: shape statistics as a network service.
//!
//! Layers, each using only those below it: the wiring (`cli`, `config`, `telemetry`), the doors (`api`),
//! the use cases (`service`), the `store`, the `domain`, the `formats`, the [`analysis`], the [`geometry`] and the
//! [`numeric`] tools. Analysis sees every shape as an `N × d` matrix of control points and one Gram
//! operator.

pub mod analysis;
pub mod domain;
pub mod geometry;
pub mod numeric;
