//! Positions of pixels and voxels in the world.
//!
//! ```text
//! w = A i + b,   Δ_w f = Σ_ab M_ab ∂_a ∂_b f,   M = (AᵀA)⁻¹,   ∫_world = |det A| ∫_index
//! ```

use crate::SegmentationError;
use crate::blur::Blur;

/// Determinants below this, relative to the product of the lengths of the columns, are taken for zero: the inverse would have
/// lost all digits that matter for positions.
const SINGULAR: f64 = 1e-9;

/// The affine map from indices to positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<const D: usize> {
    matrix: [[f64; D]; D],
    offset: [f64; D],
    inverse: [[f64; D]; D],
    determinant: f64,
}

impl<const D: usize> Frame<D> {
    /// The frame `w = matrix · i + offset`.
    ///
    /// # Errors
    /// [`SegmentationError::Frame`] if the matrix has no inverse.
    pub fn new(matrix: [[f64; D]; D], offset: [f64; D]) -> Result<Self, SegmentationError> {
        let (inverse, determinant) = invert(matrix);
        let lengths: f64 = (0..D).map(|c| length::<D>(std::array::from_fn(|r| matrix[r][c]))).product();
        if !(determinant.abs() > SINGULAR * lengths) || !determinant.is_finite() {
            return Err(SegmentationError::Frame { determinant });
        }
        Ok(Self { matrix, offset, inverse, determinant })
    }

    /// Indices as positions.
    pub fn identity() -> Self {
        let matrix = std::array::from_fn(|r| std::array::from_fn(|c| f64::from(u8::from(r == c))));
        Self { matrix, offset: [0.0; D], inverse: matrix, determinant: 1.0 }
    }

    /// The frame of an image that begins at the index `first` of this one.
    #[must_use]
    pub fn shifted(&self, first: [f64; D]) -> Self {
        Self { offset: self.to_world(first), ..*self }
    }

    /// `det A`: negative if the frame changes the orientation.
    pub fn determinant(&self) -> f64 {
        self.determinant
    }

    /// Distances of neighbouring centres along the axes, the lengths of the columns of `A`.
    pub fn spacing(&self) -> [f64; D] {
        std::array::from_fn(|c| length::<D>(std::array::from_fn(|r| self.matrix[r][c])))
    }

    /// Blur of `sigma` units of length in cells along x, y, z; 0 along missing axes.
    pub fn sigma_in_cells(&self, sigma: f64) -> [f64; 3] {
        let spacing = self.spacing();
        std::array::from_fn(|axis| spacing.get(axis).map_or(0.0, |spacing| sigma / spacing))
    }

    /// `M = (AᵀA)⁻¹`, as rows of a 3 × 3 matrix; zero along missing axes.
    pub fn metric(&self) -> [[f64; 3]; 3] {
        let product = |a: usize, b: usize| (0..D).map(|c| self.inverse[a][c] * self.inverse[b][c]).sum();
        std::array::from_fn(|a| std::array::from_fn(|b| if a < D && b < D { product(a, b) } else { 0.0 }))
    }

    /// `A i + b`.
    pub fn to_world(&self, index: [f64; D]) -> [f64; D] {
        let turned = self.turn(index);
        std::array::from_fn(|r| turned[r] + self.offset[r])
    }

    /// `A⁻¹(w − b)`.
    pub fn to_index(&self, world: [f64; D]) -> [f64; D] {
        apply(&self.inverse, std::array::from_fn(|c| world[c] - self.offset[c]))
    }

    /// `A⁻¹ v`, a difference of positions as one of indices.
    pub(crate) fn turn_to_index(&self, vector: [f64; D]) -> [f64; D] {
        apply(&self.inverse, vector)
    }

    /// The gradient with respect to a position, of that with respect to an index: `g A⁻¹` as a row.
    pub fn gradient_to_world(&self, gradient: [f64; D]) -> [f64; D] {
        apply_transposed(&self.inverse, gradient)
    }

    /// `A v`, a difference of indices as one of positions.
    pub(crate) fn turn(&self, vector: [f64; D]) -> [f64; D] {
        apply(&self.matrix, vector)
    }

    /// `Aᵀ v`.
    pub(crate) fn turn_back(&self, vector: [f64; D]) -> [f64; D] {
        apply_transposed(&self.matrix, vector)
    }
}

impl Blur {
    /// In cells along x, y, z; 0 along missing axes.
    pub fn in_cells<const D: usize>(self, frame: &Frame<D>) -> [f64; 3] {
        let spacing = frame.spacing();
        std::array::from_fn(|axis| spacing.get(axis).map_or(0.0, |spacing| self.0[axis] / spacing))
    }
}

fn length<const D: usize>(vector: [f64; D]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn apply<const D: usize>(matrix: &[[f64; D]; D], vector: [f64; D]) -> [f64; D] {
    std::array::from_fn(|r| (0..D).map(|c| matrix[r][c] * vector[c]).sum())
}

fn apply_transposed<const D: usize>(matrix: &[[f64; D]; D], vector: [f64; D]) -> [f64; D] {
    std::array::from_fn(|c| (0..D).map(|r| matrix[r][c] * vector[r]).sum())
}

/// Inverse and determinant by elimination with row pivots. The inverse of a singular matrix is not finite.
fn invert<const D: usize>(mut matrix: [[f64; D]; D]) -> ([[f64; D]; D], f64) {
    let mut inverse = Frame::<D>::identity().matrix;
    let mut determinant = 1.0;
    for column in 0..D {
        let largest = |a: &usize, b: &usize| matrix[*a][column].abs().total_cmp(&matrix[*b][column].abs());
        let pivot = (column..D).max_by(largest).unwrap_or(column);
        if pivot != column {
            matrix.swap(pivot, column);
            inverse.swap(pivot, column);
            determinant = -determinant;
        }
        let scale = matrix[column][column];
        determinant *= scale;
        matrix[column] = matrix[column].map(|x| x / scale);
        inverse[column] = inverse[column].map(|x| x / scale);
        for row in (0..D).filter(|row| *row != column) {
            let factor = matrix[row][column];
            for c in 0..D {
                matrix[row][c] -= factor * matrix[column][c];
                inverse[row][c] -= factor * inverse[column][c];
            }
        }
    }
    (inverse, determinant)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blurs_count_in_cells_of_each_axis() {
        let frame = Frame::new([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 4.0]], [0.0; 3]).unwrap();
        assert_eq!(Blur::from(2.0).in_cells(&frame), [4.0, 4.0, 0.5]);
        assert_eq!(Blur::along([1.0, 1.0, 2.0]).in_cells(&frame), [2.0, 2.0, 0.5]);
        assert_eq!(Blur::from(2.0).in_cells(&Frame::<2>::identity()), [2.0, 2.0, 0.0]);
        assert_eq!(
            (Blur::from(1.5).to_string(), Blur::along([1.0, 1.0, 2.0]).mean(3)),
            ("1.5".into(), 4.0 / 3.0)
        );
    }

    #[test]
    fn positions_go_there_and_back() {
        let frame =
            Frame::new([[0.0, -2.0, 0.1], [1.5, 0.2, 0.0], [0.0, 0.3, 4.0]], [7.0, -3.0, 1.0]).unwrap();
        let index = [3.0, -1.0, 2.5];
        let back = frame.to_index(frame.to_world(index));
        assert!((0..3).all(|c| (back[c] - index[c]).abs() < 1e-12), "{back:?}");
        assert!((frame.determinant() - 12.045).abs() < 1e-12, "{}", frame.determinant());
        assert!(matches!(
            Frame::new([[1.0, 2.0], [2.0, 4.0]], [0.0; 2]),
            Err(SegmentationError::Frame { .. })
        ));
        let mirrored = Frame::new([[-2.0, 0.0], [0.0, 0.5]], [0.0; 2]).unwrap();
        assert_eq!((mirrored.determinant(), mirrored.spacing()), (-1.0, [2.0, 0.5]));
        assert_eq!(mirrored.metric()[0][0], 0.25);
        assert_eq!(mirrored.sigma_in_cells(1.0), [0.5, 2.0, 0.0]);
    }
}
