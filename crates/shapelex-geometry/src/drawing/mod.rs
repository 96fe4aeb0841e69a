//! Drawings as SVG.
//!
//! * [`svg`] — drawings and animations of shapes;
//! * [`effect`] — drawings of shapes with an effect along one of them;
//! * [`plot`] — graphs of functions.

pub mod effect;
mod line;
pub mod plot;
pub mod svg;
