//! How widely an image is blurred along each of its axes.

use std::fmt;

use crate::frame::Frame;

/// Standard deviations of a Gaussian blur along the axes of an image, in units of length.
///
/// One number blurs equally in all directions. Slices that are thick beside their pixels want different ones: what a blur along the
/// axis of the slices needs would wipe out what is small within them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur([f64; 3]);

impl Blur {
    /// A blur with these standard deviations along x, y, z; that of a missing axis is not used.
    pub fn along(sigmas: [f64; 3]) -> Self {
        Self(sigmas)
    }

    /// In cells along x, y, z; 0 along missing axes.
    pub fn in_cells<const D: usize>(self, frame: &Frame<D>) -> [f64; 3] {
        let spacing = frame.spacing();
        std::array::from_fn(|axis| spacing.get(axis).map_or(0.0, |spacing| self.0[axis] / spacing))
    }

    /// The mean of the first `axes` standard deviations.
    pub fn mean(self, axes: usize) -> f64 {
        self.0[..axes].iter().sum::<f64>() / axes as f64
    }
}

impl From<f64> for Blur {
    fn from(sigma: f64) -> Self {
        Self([sigma; 3])
    }
}

impl From<[f64; 3]> for Blur {
    fn from(sigmas: [f64; 3]) -> Self {
        Self(sigmas)
    }
}

impl fmt::Display for Blur {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        if x == y && y == z { write!(f, "{x}") } else { write!(f, "{x} × {y} × {z}") }
    }
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
}
