//! Limits of the service, checked before memory is allocated or work begins.

use std::time::Duration;

use super::memory::Quota;
use crate::wire::bounds::Bounds;

/// Limits on sizes, rates and times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Control points per representation.
    pub control_points: usize,
    /// Points per posted contour.
    pub points: usize,
    /// Shapes per request that is answered from memory.
    pub shapes: usize,
    /// Coordinates of all control points per request that is answered from memory.
    pub coordinates: usize,
    /// Vertices per refined mesh.
    pub vertices: usize,
    /// Sample points per response, over all shapes.
    pub samples: usize,
    /// Numbers per response of an evaluation, over all shapes; each takes about 20 bytes of text.
    pub answer_numbers: usize,
    /// Bytes per request body, after decompression.
    pub body_bytes: usize,
    /// Bytes per image, as received and after decompression.
    pub image_bytes: usize,
    /// Pixels or voxels per image.
    pub voxels: usize,
    /// Bytes per line of an NDJSON stream.
    pub line_bytes: usize,
    /// Values per JSON body, counted by its commas and brackets.
    pub json_values: usize,
    /// Maximum ratio of decompressed to transmitted size of a body, beyond its first MiB.
    pub compression_ratio: usize,
    /// Bytes of JSON metadata per shape.
    pub metadata_bytes: usize,
    /// Atoms or components per dictionary.
    pub atoms: usize,
    /// Predicted memory of a job in bytes.
    pub job_bytes: usize,
    /// Bytes per distance matrix.
    pub matrix_bytes: usize,
    /// Predicted multiply-adds of a distance matrix that is answered at once; larger ones become a job.
    pub matrix_operations: usize,
    /// Predicted multiply-adds of a search.
    pub search_operations: usize,
    /// Heavy requests that run or wait at the same time; 0 means four per compute thread.
    pub heavy_requests: usize,
    /// Predicted time of a job; a job that takes three times as long is ended.
    pub job_time: Duration,
    /// Queued jobs per tenant.
    pub queued_jobs: u32,
    /// Total predicted time of the queued jobs of a tenant.
    pub queued_work: Duration,
    /// Time after its last use for which a computed value, such as a cohort prepared for searches, is kept.
    pub cache_time: Duration,
    /// Predicted compute time of a request.
    pub request_work: Duration,
    /// Resident bytes of the process beyond which large requests and responses are refused.
    pub memory: usize,
    /// Bytes of request bodies and of data parsed from them, over all requests.
    pub buffered_bytes: usize,
    /// Bytes of responses in memory, over all requests.
    pub answer_bytes: usize,
    /// Average requests per second of a caller; 0 disables the rate limit.
    pub rate_per_second: u32,
    /// Burst size of the rate limit of a caller; 0 means twice the rate per second.
    pub rate_burst: u32,
    /// Requests of a caller that are answered at the same time.
    pub caller_requests: usize,
    /// Requests per minute from an address that access control refuses with 401 before it refuses with 429; 0 disables
    /// this limit.
    pub refusals_per_minute: u32,
    /// Timeout of a request that only reads stored data.
    pub light_time: Duration,
    /// Timeout of a request that computes.
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
            image_bytes: 256 << 20,
            voxels: 1 << 27,
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
            cache_time: Duration::from_secs(600),
            request_work: Duration::from_secs(10),
            memory: usize::MAX,
            buffered_bytes: 768 << 20,
            answer_bytes: 160 << 20,
            rate_per_second: 0,
            rate_burst: 0,
            caller_requests: 2048,
            // Authenticated requests never count: this limit only slows down clients that are refused. A client with a
            // wrong key that retries five times a second still learns the fault.
            refusals_per_minute: 300,
            light_time: Duration::from_secs(30),
            compute_time: Duration::from_secs(120),
        }
    }
}

impl Limits {
    /// Division of the memory between its uses.
    pub fn quota(&self) -> Quota {
        Quota { process: self.memory, bodies: self.buffered_bytes, answers: self.answer_bytes }
    }

    /// Bounds on the parts of a document that are kept while it is read.
    pub fn bounds(&self) -> Bounds {
        // Vertices of a posted mesh are points too.
        let points = self.points.max(self.vertices);
        Bounds { items: self.shapes, points, metadata_bytes: self.metadata_bytes }
    }
}
