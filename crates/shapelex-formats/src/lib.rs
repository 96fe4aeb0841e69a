//! Files to and from values: bytes in, values or an error out. No network, no file system.
//!
//! * [`image`] — images, volumes, label images and masks;
//! * [`shape`] — contours, landmarks and meshes of other programs;
//! * [`dicom`] — the common parts of files of DICOM of both;
//! * [`mod@unit`] — units of coordinates;
//! * [`words`] — messages of parsers in words that clients know.
//!
//! Families of formats are features, each of which brings the libraries that it needs: `dicom`, `meshes`, `microscopy`, `morphometrics`
//! and `tables`, all on by default. Without one the registries have fewer formats, and nothing else changes.

#![cfg_attr(
    not(all(
        feature = "dicom",
        feature = "meshes",
        feature = "microscopy",
        feature = "morphometrics",
        feature = "tables"
    )),
    allow(
        dead_code,
        unused_imports,
        unreachable_pub,
        reason = "what several families share is there if one of them is left out"
    )
)]

#[cfg(feature = "dicom")]
pub mod dicom;
mod error;
pub mod image;
#[cfg(any(feature = "dicom", feature = "meshes"))]
mod inflate;
mod series;
pub mod shape;
mod summary;
pub mod unit;
mod value;
pub mod words;

/// The examples of the README are tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
