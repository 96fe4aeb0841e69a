//! Predicted work of requests and jobs, in seconds on one core.
//!
//! [`cost`](crate::service::cost) predicts it from the sizes in a request; the [`pool`](super::pool) chooses the lane
//! by it.

use std::ops::{Add, Mul};

use super::error::ServiceError;

/// Predicted seconds on one core.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Work(pub(in crate::service) f64);

/// Maximum work of a light request: each thread of the light lane completes a hundred of them per second.
const MOMENT: f64 = 0.010;

/// Maximum work of a request that is computed on the async thread that has read it: as much again as reading the largest
/// body that is parsed there. A round trip to another thread takes 0.1 ms on busy cores.
const INSTANT: f64 = REQUEST + 2e-4;

/// Parsing a byte of JSON: numbers of ten digits, with checks.
const BYTE: f64 = 1.2e-8;
/// Writing a number of a response as JSON, including its computation as a sum of a few products.
pub(in crate::service) const NUMBER: f64 = 5e-8;
/// A multiply-add of dense products.
const MULTIPLY_ADD: f64 = 2e-10;
/// Passing a request through a lane and preparing its response.
pub(in crate::service) const REQUEST: f64 = 1e-4;

impl Work {
    /// Work known to be light: a drawing, or a response from prepared data.
    pub const MOMENT: Self = Self(1e-3);
    /// Assumed work if nothing is known.
    pub const UNKNOWN: Self = Self(0.1);

    /// Work of this many seconds.
    pub fn from_seconds(seconds: f64) -> Self {
        Self(seconds.max(0.0))
    }

    /// Work of this many multiply-adds.
    pub fn from_multiply_adds(count: f64) -> Self {
        Self(count * MULTIPLY_ADD)
    }

    /// Predicted seconds.
    pub fn seconds(self) -> f64 {
        self.0
    }

    /// Whether it belongs in the light lane.
    pub fn is_moment(self) -> bool {
        self.0 <= MOMENT
    }

    /// Whether it takes less time than passing it to another thread is worth.
    pub fn is_instant(self) -> bool {
        self.0 <= INSTANT
    }

    /// Checks that a request may take this much work.
    ///
    /// # Errors
    /// [`ServiceError::TooCostly`].
    pub fn check(self, most: f64) -> Result<(), ServiceError> {
        if self.0 <= most { Ok(()) } else { Err(ServiceError::TooCostly { seconds: self.0, most }) }
    }

    /// Parsing a body of this many bytes, or writing a file.
    pub fn reading(bytes: usize) -> Self {
        Self(bytes as f64 * BYTE)
    }

    /// A response of this many numbers.
    pub fn numbers(count: f64) -> Self {
        Self(REQUEST + count * NUMBER)
    }
}

impl Add for Work {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl Mul<Work> for f64 {
    type Output = Work;

    fn mul(self, work: Work) -> Work {
        Work(self * work.0)
    }
}
