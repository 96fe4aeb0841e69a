//! Limits of the service, checked before memory is taken or work begins.

use std::time::Duration;

use super::memory::Quota;
use crate::formats::bounds::Bounds;

/// Sizes that are checked before memory is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Control points of a representation.
    pub control_points: usize,
    /// Points of a posted contour.
    pub points: usize,
    /// Shapes of a request that is answered from memory.
    pub shapes: usize,
    /// Numbers of the control points of all shapes of a request that is answered from memory.
    pub coordinates: usize,
    /// Vertices of a refined mesh.
    pub vertices: usize,
    /// Points that are answered, over all shapes.
    pub samples: usize,
    /// Numbers that an evaluation answers, over all shapes; each takes some 20 bytes of text.
    pub answer_numbers: usize,
    /// Bytes of a request body, after decompression.
    pub body_bytes: usize,
    /// Bytes of a line of an NDJSON stream.
    pub line_bytes: usize,
    /// Values of a JSON body, counted by its commas and brackets.
    pub json_values: usize,
    /// How many times as long as on the wire a body may become, beyond its first MiB.
    pub compression_ratio: usize,
    /// Bytes of the metadata of a shape, as JSON.
    pub metadata_bytes: usize,
    /// Atoms or components of a dictionary.
    pub atoms: usize,
    /// Bytes of memory that a job may be predicted to take.
    pub job_bytes: usize,
    /// Bytes of a distance matrix.
    pub matrix_bytes: usize,
    /// Multiply-adds that a distance matrix may be predicted to take to be answered at once; more become a job.
    pub matrix_operations: usize,
    /// Multiply-adds that a search may be predicted to take.
    pub search_operations: usize,
    /// Heavy requests that compute or wait for it; 0 means four per compute thread.
    pub heavy_requests: usize,
    /// Time that a job may be predicted to take; one that takes three times as long is ended.
    pub job_time: Duration,
    /// Jobs of a tenant that may wait.
    pub queued_jobs: u32,
    /// Time that the jobs of a tenant that wait may be predicted to take together.
    pub queued_work: Duration,
    /// Compute time that a request may be predicted to take.
    pub request_work: Duration,
    /// Resident bytes of the process, beyond which what is large is refused.
    pub memory: usize,
    /// Bytes of request bodies in memory and of what is read from them, of all requests together.
    pub buffered_bytes: usize,
    /// Bytes of answers in memory, of all requests together.
    pub answer_bytes: usize,
    /// Requests of a caller in a second, on average; 0 does not count them.
    pub rate_per_second: u32,
    /// Requests of a caller at once; 0 means twice those of a second.
    pub rate_burst: u32,
    /// Requests from an address in a minute that access control refuses with 401 before it refuses with 429; 0 does not count
    /// them.
    pub refusals_per_minute: u32,
    /// Time for a request that only reads what is stored.
    pub light_time: Duration,
    /// Time for a request that computes.
    pub compute_time: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            control_points: 2048,
            points: 100_000,
            shapes: 100_000,
            coordinates: 8 << 20,
            vertices: 300_000,
            samples: 2_000_000,
            answer_numbers: 1 << 20,
            body_bytes: 64 << 20,
            line_bytes: 8 << 20,
            json_values: 32 << 20,
            compression_ratio: 100,
            metadata_bytes: 64 << 10,
            atoms: 1024,
            job_bytes: 4 << 30,
            matrix_bytes: 128 << 20,
            matrix_operations: 5_000_000_000,
            search_operations: 100_000_000_000,
            heavy_requests: 0,
            job_time: Duration::from_secs(6 * 3600),
            queued_jobs: 100,
            queued_work: Duration::from_secs(24 * 3600),
            request_work: Duration::from_secs(10),
            memory: usize::MAX,
            buffered_bytes: 768 << 20,
            answer_bytes: 160 << 20,
            rate_per_second: 0,
            rate_burst: 0,
            // Whoever is let in is never counted: this only tells those who are not to slow down. A client with a wrong key that
            // tries five times a second still hears what is wrong.
            refusals_per_minute: 300,
            light_time: Duration::from_secs(30),
            compute_time: Duration::from_secs(120),
        }
    }
}

impl Limits {
    /// How much memory there is for what.
    pub fn quota(&self) -> Quota {
        Quota { process: self.memory, bodies: self.buffered_bytes, answers: self.answer_bytes }
    }

    /// How much of a document is kept while it is read.
    pub fn bounds(&self) -> Bounds {
        // Vertices of a posted mesh are points too.
        let points = self.points.max(self.vertices);
        Bounds { items: self.shapes, points, metadata_bytes: self.metadata_bytes }
    }
}
