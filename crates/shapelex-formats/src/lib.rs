//! Files to and from values: bytes in, values or an error out. No network, no file system.
//!
//! * [`image`] — images, volumes, label images and masks;
//! * [`shape`] — contours, landmarks and meshes of other programs;
//! * [`dicom`] — what the files of DICOM of both have in common;
//! * [`words`] — messages of parsers in words that clients know.

pub mod dicom;
pub mod image;
pub mod shape;
pub mod words;
