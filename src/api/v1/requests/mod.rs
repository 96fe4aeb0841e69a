//! Parts of requests that several resources share.

pub(in crate::api) mod batches;
#[cfg(feature = "schema")]
pub(in crate::api) mod described;
pub(in crate::api) mod entity_tags;
pub(in crate::api) mod file_parameters;
pub(in crate::api) mod planned;
pub(in crate::api) mod request_macros;
pub(in crate::api) mod shape_query;
