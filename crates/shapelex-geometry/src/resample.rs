//! Arc-length sampling of polygonal contours, and the canonical start point of a contour.

use super::GeometryError;
use shapelex_numeric::dense::Matrix;

/// A polygonal contour, closed or open, with its cumulative chord length.
#[derive(Debug, Clone)]
pub struct Contour {
    points: Matrix,
    closed: bool,
    /// `s_0 = 0, …, L`: one entry more than edges.
    arc: Vec<f64>,
    /// Number of repeated points that were dropped.
    repeated: usize,
}

/// Treatment of points of a contour that are equal to their predecessor: `drop` leaves them out, `refuse` names the first
/// of them. Arc length cannot tell them apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum RepeatedPoints {
    /// They are left out and counted.
    #[default]
    Drop,
    /// The contour is refused.
    Refuse,
}

/// The vertices of a ring, without a last vertex that repeats the first.
pub fn without_closing_point(points: Matrix) -> Matrix {
    let count = points.nrows();
    let repeated = count > 1 && points.row(0) == points.row(count - 1);
    if repeated { points.remove_row(count - 1) } else { points }
}

/// Extent, relative to the distance from the origin, below which a shape is rounding error.
const NO_EXTENT: f64 = 1e-13;

impl Contour {
    /// The closed polygon of the vertices `points` (`n × d`, `n ≥ 3`), without repeated ones; a last vertex equal to the
    /// first is dropped.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn closed(points: Matrix) -> Result<Self, GeometryError> {
        Self::new(points, true, RepeatedPoints::Drop)
    }

    /// The open polygon of the vertices `points` (`n × d`, `n ≥ 2`), without repeated ones.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn open(points: Matrix) -> Result<Self, GeometryError> {
        Self::new(points, false, RepeatedPoints::Drop)
    }

    /// The closed or open polygon of the vertices `points`, at least three or two. If it is closed, a last vertex equal
    /// to the first is dropped and not counted as repeated.
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] and [`GeometryError::TooFewDistinctPoints`] below three or two positions,
    /// [`GeometryError::NoLength`] if all points coincide, [`GeometryError::RepeatedPoint`] for equal consecutive
    /// vertices under [`RepeatedPoints::Refuse`].
    pub fn new(points: Matrix, closed: bool, repeated: RepeatedPoints) -> Result<Self, GeometryError> {
        check_length(&points)?;
        let points = if closed { without_closing_point(points) } else { points };
        let (found, needed) = (points.nrows(), if closed { 3 } else { 2 });
        if found < needed {
            return Err(GeometryError::TooFewPoints { found, needed });
        }
        match arc_lengths(&points, closed) {
            Ok(arc) => return Ok(Self { points, closed, arc, repeated: 0 }),
            Err(error) if repeated == RepeatedPoints::Refuse => return Err(error),
            Err(_) => {}
        }
        let kept = advancing(&points, closed);
        let repeated = found - kept.len();
        if kept.len() < needed {
            return Err(GeometryError::TooFewDistinctPoints { found: kept.len(), needed, repeated });
        }
        let points = Matrix::from_fn(kept.len(), points.ncols(), |k, c| points[(kept[k], c)]);
        let arc = arc_lengths(&points, closed)?;
        Ok(Self { points, closed, arc, repeated })
    }

    /// Number of repeated points that were dropped.
    pub fn repeated_points(&self) -> usize {
        self.repeated
    }

    /// Length along the edges.
    pub fn length(&self) -> f64 {
        *self.arc.last().expect("never empty")
    }

    /// The vertices, without repeated ones.
    pub fn points(&self) -> &Matrix {
        &self.points
    }

    /// Arc length of every vertex as a fraction of the total length.
    pub fn parameters(&self) -> Vec<f64> {
        let length = self.length();
        self.arc[..self.points.nrows()].iter().map(|s| s / length).collect()
    }

    /// Position at arc length `s`, which is reduced modulo the perimeter (closed) or clamped to the length (open).
    fn position(&self, s: f64) -> Vec<f64> {
        let (edge, fraction) = self.place(s, 0);
        (0..self.points.ncols()).map(|c| self.on_edge(edge, fraction, c)).collect()
    }

    /// Edge at arc length `s`, and the fraction of it, as for [`Self::position`]. The search begins at edge `near`, from
    /// which it is not far when samples follow each other.
    fn place(&self, s: f64, near: usize) -> (usize, f64) {
        let length = self.length();
        let s = match self.closed {
            false => s.clamp(0.0, length),
            true if (0.0..length).contains(&s) => s,
            true => s.rem_euclid(length),
        };
        let (first, last) = (if self.arc[near] <= s { near } else { 0 }, self.arc.len() - 2);
        let edge = (first..last).find(|&edge| s < self.arc[edge + 1]).unwrap_or(last);
        (edge, (s - self.arc[edge]) / (self.arc[edge + 1] - self.arc[edge]))
    }

    /// Coordinate `c` of the position at a fraction of an edge.
    fn on_edge(&self, edge: usize, fraction: f64, c: usize) -> f64 {
        let next = if edge + 1 == self.points.nrows() { 0 } else { edge + 1 };
        (1.0 - fraction) * self.points[(edge, c)] + fraction * self.points[(next, c)]
    }

    /// `n` points at equal distances along the edges, by linear interpolation: `n × d`. Closed contours are sampled at
    /// `start + L i/n`, open ones from end to end at `L i/(n − 1)`, where `start` has no effect.
    ///
    /// Additional vertices on the edges do not change the result. With `start = 0` the first vertex is kept.
    pub fn sample(&self, n: usize, start: f64) -> Matrix {
        let d = self.points.ncols();
        let mut samples = Matrix::zeros(n, d);
        let mut near = 0;
        for i in 0..n {
            let target = if self.closed {
                start + self.length() * i as f64 / n as f64
            } else {
                self.length() * i as f64 / n.saturating_sub(1).max(1) as f64
            };
            let (edge, fraction) = self.place(target, near);
            (0..d).for_each(|c| samples[(i, c)] = self.on_edge(edge, fraction, c));
            near = edge;
        }
        samples
    }

    /// Arc length of the canonical start point of a closed contour: an end of the major axis of the first elliptic Fourier
    /// harmonic. Of its two ends, the one farther from the centroid of the contour.
    ///
    /// ```text
    /// A = ∮ r cos(2πs/L) ds,  B = ∮ r sin(2πs/L) ds,   θ = ½ atan2(2A·B, |A|² − |B|²),   s = θL/2π
    /// ```
    ///
    /// It depends on the contour alone, not on the start of its list of points. A contour with three-fold or higher symmetry
    /// has several such points, between which rounding decides.
    pub fn canonical_start(&self) -> f64 {
        let (cosine, sine) = self.first_harmonic();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let theta = 0.5 * (2.0 * dot(&cosine, &sine)).atan2(dot(&cosine, &cosine) - dot(&sine, &sine));
        let first = theta / std::f64::consts::TAU * self.length();
        let second = first + 0.5 * self.length();
        let centroid = self.centroid();
        let distance =
            |s: f64| self.position(s).iter().zip(&centroid).map(|(x, m)| (x - m).powi(2)).sum::<f64>();
        let start = if distance(second) > distance(first) { second } else { first };
        start.rem_euclid(self.length())
    }

    /// Centroid along the arc length.
    fn centroid(&self) -> Vec<f64> {
        let n = self.points.nrows();
        (0..self.points.ncols())
            .map(|c| {
                let sum: f64 = (0..n)
                    .map(|i| {
                        0.5 * (self.arc[i + 1] - self.arc[i])
                            * (self.points[(i, c)] + self.points[((i + 1) % n, c)])
                    })
                    .sum();
                sum / self.length()
            })
            .collect()
    }

    /// `∮ r(s) e^{2πjs/L} ds` up to a common factor. On a polygon `r` is linear on every edge; integration by parts gives
    /// `∮ r e^{jws} ds = −(1/jw) ∮ r' e^{jws} ds`, and `r'` is constant on an edge.
    fn first_harmonic(&self) -> (Vec<f64>, Vec<f64>) {
        let (n, d) = self.points.shape();
        let w = std::f64::consts::TAU / self.length();
        let (mut cosine, mut sine) = (vec![0.0; d], vec![0.0; d]);
        for i in 0..n {
            let (a, b) = (self.arc[i], self.arc[i + 1]);
            let step = |c| (self.points[((i + 1) % n, c)] - self.points[(i, c)]) / (b - a);
            // ∫_a^b cos ws and ∫_a^b sin ws, with the difference as a product, which is free of cancellation.
            let (middle, half) = (0.5 * w * (a + b), 0.5 * w * (b - a));
            let (along_cosine, along_sine) =
                (2.0 * middle.cos() * half.sin(), 2.0 * middle.sin() * half.sin());
            for c in 0..d {
                cosine[c] -= step(c) * along_sine;
                sine[c] += step(c) * along_cosine;
            }
        }
        (cosine, sine)
    }
}

/// `s_0 = 0, …, L` along the edges.
///
/// # Errors
/// [`GeometryError::RepeatedPoint`] for a step that adds no length.
fn arc_lengths(points: &Matrix, closed: bool) -> Result<Vec<f64>, GeometryError> {
    let n = points.nrows();
    let edges = if closed { n } else { n - 1 };
    let mut arc = Vec::with_capacity(edges + 1);
    let mut length = 0.0;
    arc.push(length);
    for i in 0..edges {
        let chord = chord(points, i, (i + 1) % n);
        // This includes steps that are lost in the accumulated length: the interpolation would divide by zero.
        if !(length + chord > length) {
            return Err(GeometryError::RepeatedPoint { first: i, second: (i + 1) % n });
        }
        length += chord;
        arc.push(length);
    }
    Ok(arc)
}

/// Positions of the vertices that add length: the first one, and each at a distance from the one kept before; of a closed
/// polygon also from the first one.
fn advancing(points: &Matrix, closed: bool) -> Vec<usize> {
    let (mut kept, mut last, mut length) = (vec![0], 0, 0.0);
    for i in 1..points.nrows() {
        let chord = chord(points, last, i);
        if length + chord > length {
            kept.push(i);
            (last, length) = (i, length + chord);
        }
    }
    if closed {
        let apart = |&i: &usize| length + chord(points, i, 0) > length;
        kept.truncate(kept.iter().rposition(apart).map_or(1, |last| last + 1));
    }
    kept
}

/// Distance between two vertices.
fn chord(points: &Matrix, from: usize, to: usize) -> f64 {
    let step = |c| points[(to, c)] - points[(from, c)];
    (0..points.ncols()).map(|c| step(c) * step(c)).sum::<f64>().sqrt()
}

fn check_length(points: &Matrix) -> Result<(), GeometryError> {
    match check_extent(points.as_slice(), points.nrows()) {
        Err(GeometryError::NoExtent { points, extent, .. }) if points > 0 => {
            Err(GeometryError::NoLength { extent })
        }
        _ => Ok(()),
    }
}

/// Checks that the `size` points of a shape (coordinate-major) do not all coincide.
///
/// # Errors
/// [`GeometryError::NoExtent`].
pub fn check_extent(coordinates: &[f64], size: usize) -> Result<(), GeometryError> {
    let range =
        |c: &[f64]| c.iter().copied().fold(f64::MIN, f64::max) - c.iter().copied().fold(f64::MAX, f64::min);
    let extent = coordinates.chunks_exact(size.max(1)).map(range).fold(0.0, f64::max);
    let largest = coordinates.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    if extent > NO_EXTENT * largest {
        return Ok(());
    }
    Err(GeometryError::NoExtent { points: size, extent, largest })
}

/// Signed area of the closed polygon through planar points (`P × 2`, at least one), positive if it runs counter-clockwise.
pub fn polygon_area(points: &Matrix) -> f64 {
    let n = points.nrows();
    let at = |k: usize, c: usize| points[(k, c)] - points[(0, c)];
    let next = |k: usize| if k + 1 == n { 0 } else { k + 1 };
    (0..n).map(|k| at(k, 0) * at(next(k), 1) - at(next(k), 0) * at(k, 1)).sum()
}

/// The start of a curve given by control points, as a cyclic shift: the control point nearest to the canonical start in
/// the parameter of the curve (see [`Contour::canonical_start`], with the parameter in place of the arc length and
/// control points in place of the contour).
pub fn canonical_shift(control_points: &Matrix) -> usize {
    let (n, d) = control_points.shape();
    let (mut cosine, mut sine) = (vec![0.0; d], vec![0.0; d]);
    for k in 0..n {
        let (s, c) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
        for i in 0..d {
            cosine[i] += c * control_points[(k, i)];
            sine[i] += s * control_points[(k, i)];
        }
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let theta = 0.5 * (2.0 * dot(&cosine, &sine)).atan2(dot(&cosine, &cosine) - dot(&sine, &sine));
    let at = |turn: f64| ((turn * n as f64).round() as isize).rem_euclid(n as isize) as usize;
    let turn = theta / std::f64::consts::TAU;
    let (first, second) = (at(turn), at(turn + 0.5));
    let centroid = control_points.row_mean();
    let distance = |k: usize| (control_points.row(k) - &centroid).norm();
    if distance(second) > distance(first) { second } else { first }
}

/// `control_points` with row `shift` first.
pub fn rotate_start(control_points: &Matrix, shift: usize) -> Matrix {
    let (n, d) = control_points.shape();
    Matrix::from_fn(n, d, |k, c| control_points[((k + shift) % n, c)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bean(n: usize, start: f64) -> Matrix {
        Matrix::from_fn(n, 2, |i, c| {
            let t = std::f64::consts::TAU * i as f64 / n as f64 + start;
            if c == 0 { 2.0 * t.cos() + 0.3 * (2.0 * t).cos() } else { t.sin() + 0.2 * (3.0 * t).sin() }
        })
    }

    #[test]
    fn samples_do_not_depend_on_the_first_vertex() {
        let polygon = bean(200, 0.4);
        let rotated = rotate_start(&polygon, 73);
        let one = Contour::closed(polygon).unwrap();
        let two = Contour::closed(rotated).unwrap();
        let (a, b) = (one.sample(40, one.canonical_start()), two.sample(40, two.canonical_start()));
        assert!((&a - &b).amax() < 1e-12, "{}", (&a - &b).amax());
        // The end of the major axis, on the side that bulges.
        assert!((a[(0, 0)] - 2.3).abs() < 0.05, "{}", a[(0, 0)]);
    }

    #[test]
    fn collinear_vertices_change_nothing() {
        let square = Matrix::from_row_slice(4, 2, &[0., 0., 2., 0., 2., 1., 0., 1.]);
        let denser = Matrix::from_row_slice(6, 2, &[0., 0., 0.5, 0., 2., 0., 2., 1., 1.7, 1., 0., 1.]);
        let a = Contour::closed(square).unwrap().sample(12, 0.0);
        let b = Contour::closed(denser).unwrap().sample(12, 0.0);
        assert!((a - b).amax() < 1e-14);
    }

    #[test]
    fn broken_contours_are_named() {
        let equal = Matrix::from_element(5, 2, 3.0);
        let coincide = GeometryError::NoExtent { points: 5, extent: 0.0, largest: 3.0 };
        assert_eq!(check_extent(equal.as_slice(), 5), Err(coincide));
        assert_eq!(check_extent(&[1.0, 1.0, 0.0, 1e-12], 2), Ok(()));
        assert!(matches!(Contour::closed(equal), Err(GeometryError::NoLength { .. })));
        let refused = |points: Matrix| Contour::new(points, true, RepeatedPoints::Refuse).unwrap_err();
        let repeated = Matrix::from_row_slice(4, 2, &[0., 0., 1., 0., 1., 0., 0., 1.]);
        assert_eq!(refused(repeated), GeometryError::RepeatedPoint { first: 1, second: 2 });
        let lost = Matrix::from_row_slice(4, 2, &[0., 0., 1e100, 0., 1e100, 1., 0., 1e100]);
        assert_eq!(refused(lost), GeometryError::RepeatedPoint { first: 1, second: 2 });
        let two = Matrix::from_row_slice(6, 2, &[0., 0., 0., 0., 1., 0., 1., 0., 1., 0., 0., 0.]);
        assert_eq!(
            Contour::closed(two).unwrap_err(),
            GeometryError::TooFewDistinctPoints { found: 2, needed: 3, repeated: 3 }
        );
        let closed_line = Matrix::from_row_slice(3, 2, &[0., 0., 1., 0., 0., 0.]);
        assert_eq!(
            Contour::closed(closed_line).unwrap_err(),
            GeometryError::TooFewPoints { found: 2, needed: 3 }
        );
    }

    #[test]
    fn repeated_points_change_nothing() {
        let corners = [[0., 0.], [2., 0.], [2., 1.], [0., 1.]];
        let contour = |order: &[usize], closed| {
            let points = Matrix::from_fn(order.len(), 2, |k, c| corners[order[k]][c]);
            Contour::new(points, closed, RepeatedPoints::Drop).unwrap()
        };
        for closed in [true, false] {
            let wanted = contour(&[0, 1, 2, 3], closed).sample(9, 0.0);
            for order in [&[0, 0, 1, 2, 2, 2, 3][..], &[0, 1, 1, 2, 3, 3, 3]] {
                let found = contour(order, closed);
                assert_eq!((found.sample(9, 0.0), found.repeated_points()), (wanted.clone(), 3), "{order:?}");
            }
        }
        // The point that closes a ring is not counted, further ones are.
        let ring = contour(&[0, 1, 2, 3, 0, 0, 0], true);
        assert_eq!((ring.points().nrows(), ring.repeated_points()), (4, 2));
        // Steps that the length cannot hold add up until it can.
        let steps = Matrix::from_fn(2001, 2, |k, c| if c == 1 { k as f64 * 1e-17 } else { f64::from(k > 0) });
        let steps = Contour::open(steps).unwrap();
        let last = steps.points()[(steps.points().nrows() - 1, 1)];
        assert!(steps.repeated_points() > 1000 && (2e-14 - last).abs() < 3e-16, "{last:e}");
    }

    #[test]
    fn canonical_shift_follows_the_rotation() {
        let points = bean(50, 0.0);
        let base = canonical_shift(&points);
        for shift in [1, 7, 49] {
            let moved = canonical_shift(&rotate_start(&points, shift));
            assert_eq!((moved + shift) % 50, base);
        }
    }
}
