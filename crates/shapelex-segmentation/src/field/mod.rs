//! Images and volumes, their Gaussian derivatives, and fields integrated in advance.
//!
//! * [`image`] — grids of values; statistics of them;
//! * [`filter`] — blur and derivatives by separable Gaussian kernels, the Laplacian of a metric;
//! * [`integrated`] — the antiderivative of an image along x, from which integrals over shapes are boundary integrals.

pub mod filter;
pub mod image;
pub mod integrated;

pub use image::{Image, Value};
pub use integrated::Integrated;
