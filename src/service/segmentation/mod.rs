//! Images to shapes. The functions are synchronous and run on the pool.
//!
//! * [`image`] — images of requests; [`contours`] — boundaries of labels;
//! * [`request`] — energies, stages and initial shapes as they are posted; [`segment`] — objects of an image.
//!
//! The arithmetic is in [`segmentation`](crate::segmentation), the files are read by [`formats::image`](crate::formats::image):
//! this folder limits, predicts and names what is answered.

pub mod contours;
pub mod image;
pub mod request;
pub mod segment;
