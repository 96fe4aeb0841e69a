//! Files to and from values: bytes in, values or an error out. No network, no file system.
//!
//! * [`image`] — images, volumes, label images and masks.

pub mod image;
