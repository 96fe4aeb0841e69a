//! Vectors in space.

/// Ratio of coordinates to extent beyond which a shape is moved to its own origin: it has lost three digits. Below, no bit changes.
const FAR: f64 = 1024.0;

/// The first point of a shape that is far from the origin relative to its extent, as a local origin that preserves the digits
/// of the shape. Differences from it are exact for coordinates within a factor of two of those of the origin.
pub fn far_origin<'a>(points: impl Iterator<Item = &'a [f64; 3]> + Clone) -> Option<[f64; 3]> {
    let first = *points.clone().next()?;
    let extent = points.flat_map(|point| minus(*point, first)).fold(0.0_f64, |most, x| most.max(x.abs()));
    let largest = first.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    (largest > FAR * extent).then_some(first)
}

/// `a + b`.
pub fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a − b`.
pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `factor · v`.
pub fn scaled(factor: f64, v: [f64; 3]) -> [f64; 3] {
    v.map(|x| factor * x)
}

/// `⟨a, b⟩`.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `|a|`.
pub fn norm(a: [f64; 3]) -> f64 {
    a[0].hypot(a[1]).hypot(a[2])
}

/// Bounding box of points, lower and upper corner; `None` without points.
pub fn bounds<const D: usize>(points: impl IntoIterator<Item = [f64; D]>) -> Option<[[f64; D]; 2]> {
    points.into_iter().map(|point| [point; 2]).reduce(|[lower, upper], [point, _]| {
        [
            std::array::from_fn(|axis| lower[axis].min(point[axis])),
            std::array::from_fn(|axis| upper[axis].max(point[axis])),
        ]
    })
}
