//! Types that only the descriptions of operations name.

pub(super) use super::batches::BatchQuery;
pub(super) use super::file_parameters::{FileQuery, PlacingQuery, ReadQuery, WriteQuery};
pub(super) use super::jobs::JobOutput;
pub(super) use super::request_macros::{IfMatchHeader, PreferHeader, RetryHeader};
pub(super) use super::shape_query::FilterQuery;
pub(super) use crate::api::extract::{DrawingQuery, ShapeFormatQuery};
pub(super) use crate::api::respond::Binary;
pub(super) use crate::formats::shape::{Attributes, PointsOrGrid};
