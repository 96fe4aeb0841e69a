//! Drawings as SVG.
//!
//! * [`layer`] — shapes in the plane; [`colour`] — colours for light and dark pages;
//! * [`orientation`] — orientation of the shapes; [`effect`] — layers that show an effect along a shape;
//! * [`layout`] — arrangements of layers, and animations; [`legend`] — samples and sentences below;
//! * [`picture`] — shapes over a picture of cells;
//! * [`plot`] — graphs of functions; [`scatter`] — points in groups; [`strips`] — ranges of numbers;
//! * [`scene`] — a drawing before, and [`svg`] — after settings of the viewer are known.

pub mod colour;
pub mod effect;
pub mod layer;
pub mod layout;
pub mod legend;
mod line;
pub mod orientation;
pub mod picture;
pub mod plot;
pub mod scatter;
pub mod scene;
pub mod strips;
pub mod svg;
