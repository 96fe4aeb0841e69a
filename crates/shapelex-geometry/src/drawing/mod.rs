//! Drawings as SVG.
//!
//! * [`layer`] — shapes in the plane; [`colour`] — colours for light and dark pages;
//! * [`layout`] — drawings and animations of layers;
//! * [`effect`] — drawings of shapes with an effect along one of them;
//! * [`plot`] — graphs of functions;
//! * [`scene`] — a drawing before, and [`svg`] — after settings of the viewer are known.

pub mod colour;
pub mod effect;
pub mod layer;
pub mod layout;
mod line;
pub mod plot;
pub mod scene;
pub mod svg;
