//! Points (coordinate-major) without their position and size.

use crate::metric::norm;

/// Position and size of points.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    /// The centroid.
    pub(crate) centre: Vec<f64>,
    /// Root of the sum of squared distances from the centroid; 0 if all points are at one place.
    pub(crate) size: f64,
}

/// Points about the origin, with the centroid size 1 unless they are at one place, and where they were.
pub(crate) fn unit(points: &[f64], dimension: usize) -> (Vec<f64>, Placed) {
    let count = points.len() / dimension;
    let mean = |of: &[f64]| of.iter().sum::<f64>() / count as f64;
    let centre: Vec<f64> = points.chunks_exact(count).map(mean).collect();
    let mut moved: Vec<f64> = points.iter().enumerate().map(|(k, x)| x - centre[k / count]).collect();
    let size = norm(&moved);
    if size > 0.0 {
        moved.iter_mut().for_each(|x| *x /= size);
    }
    (moved, Placed { centre, size })
}
