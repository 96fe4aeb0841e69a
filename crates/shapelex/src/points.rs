//! Points of a shape, row by row.

use shapelex_numeric::dense::Matrix;

/// Points of a shape in the plane or in space.
///
/// ```
/// let points = shapelex::Points::from_arrays(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
/// assert_eq!((points.len(), points.dimension()), (3, 2));
/// assert_eq!(points.rows().last(), Some(&[0.0, 1.0][..]));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    dimension: usize,
    /// The coordinates of the first point, of the second, and so on.
    coordinates: Vec<f64>,
}

impl Points {
    /// The points of rows of two or three coordinates.
    pub fn from_arrays<const D: usize>(rows: &[[f64; D]]) -> Self {
        Self { dimension: D, coordinates: rows.concat() }
    }

    /// Points of these coordinates, one point after the other; the coordinates of an incomplete point are left out.
    ///
    /// ```
    /// let points = shapelex::Points::from_flat(2, vec![0.0, 0.0, 1.0, 0.0]);
    /// assert_eq!(points.to_arrays(), Some(vec![[0.0, 0.0], [1.0, 0.0]]));
    /// ```
    pub fn from_flat(dimension: usize, mut coordinates: Vec<f64>) -> Self {
        let dimension = dimension.max(1);
        coordinates.truncate(coordinates.len() / dimension * dimension);
        Self { dimension, coordinates }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.coordinates.len() / self.dimension
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Number of coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The points in order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.coordinates.chunks_exact(self.dimension)
    }

    /// The points as arrays, if they have `D` coordinates.
    ///
    /// ```
    /// let points = shapelex::Points::from_arrays(&[[1.0, 2.0]]);
    /// assert_eq!(points.to_arrays(), Some(vec![[1.0, 2.0]]));
    /// assert_eq!(points.to_arrays::<3>(), None);
    /// ```
    pub fn to_arrays<const D: usize>(&self) -> Option<Vec<[f64; D]>> {
        let row = |row: &[f64]| <[f64; D]>::try_from(row).ok();
        if self.dimension == D { self.rows().map(row).collect() } else { None }
    }

    /// All coordinates, one point after the other.
    pub fn as_flat(&self) -> &[f64] {
        &self.coordinates
    }

    /// The points of the columns of coordinates: all x, then all y.
    pub(crate) fn of_columns(columns: &[f64], dimension: usize) -> Self {
        let count = columns.len() / dimension;
        let row = |k: usize| (0..dimension).map(move |c| columns[c * count + k]);
        Self { dimension, coordinates: (0..count).flat_map(row).collect() }
    }

    pub(crate) fn matrix(&self) -> Matrix {
        Matrix::from_row_slice(self.len(), self.dimension, &self.coordinates)
    }

    /// Position of the first coordinate that is not a number of a usual size.
    pub(crate) fn fault(&self) -> Option<usize> {
        self.coordinates.iter().position(|x| !(x.abs() <= shapelex_numeric::MAX_NUMBER))
    }
}
