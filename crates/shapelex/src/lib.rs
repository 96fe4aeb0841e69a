#![doc = include_str!("../README.md")]

mod error;
mod mean;
mod model;
mod points;
mod read;
mod setting;
mod shapes;
mod studies;

pub use error::{Error, Result};
pub use mean::Mean;
pub use model::{Model, Score};
pub use points::Points;
pub use setting::Setting;
pub use shapes::{Contour, Contours, Landmark, Landmarks, Shapes, Surface, Surfaces};
pub use studies::{Comparison, LinearModel, Regression};

pub use shapelex_analysis::alignment::Alignment;
pub use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
pub use shapelex_analysis::models::design::Table;
pub use shapelex_analysis::transformation::ClassName as Class;
pub use shapelex_geometry::drawing::scene::Drawing;
pub use shapelex_geometry::representation::Representation;

/// A drawing as an SVG document, in the colours of the page where it is shown.
///
/// ```
/// use shapelex::{Class, Landmarks};
///
/// let triangle = |k: usize| vec![[0.0, 0.0], [1.0, 0.0], [0.1 * k as f64, 1.0]];
/// let mean = Landmarks::new((0..6).map(triangle))?.mean(Class::Similarity)?;
/// assert!(shapelex::svg(&mean.drawing("Triangles")).contains("Triangles"));
/// # Ok::<(), shapelex::Error>(())
/// ```
pub fn svg(drawing: &Drawing) -> String {
    drawing.to_svg(&Default::default())
}

/// The tutorial for users of Rust, whose programs are doc tests.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/tutorials/rust.md")]
struct Tutorial;
