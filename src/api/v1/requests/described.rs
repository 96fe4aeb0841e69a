//! Types that only the descriptions of operations name.

pub(in crate::api::v1) use crate::api::extract::{DrawingQuery, ShapeFormatQuery};
pub(in crate::api::v1) use crate::api::respond::Binary;
pub(in crate::api::v1) use crate::api::v1::administration::jobs::JobOutput;
pub(in crate::api::v1) use crate::api::v1::requests::batches::BatchQuery;
pub(in crate::api::v1) use crate::api::v1::requests::file_parameters::{
    FileQuery, PlacingQuery, ReadQuery, WriteQuery,
};
pub(in crate::api::v1) use crate::api::v1::requests::request_macros::{
    IfMatchHeader, PreferHeader, RetryHeader,
};
pub(in crate::api::v1) use crate::api::v1::requests::shape_query::FilterQuery;
pub(in crate::api::v1) use crate::wire::shape::{Attributes, PointsOrGrid};
