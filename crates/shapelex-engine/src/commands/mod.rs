//! The commands of the program.

#[cfg(feature = "cluster")]
pub(crate) mod cluster;
pub(crate) mod machines;
pub(crate) mod maintenance;
pub(crate) mod pass;
