//! Widths of Gaussian blurs, along each axis of an image.

use std::fmt;

/// Standard deviations of a Gaussian blur along the axes of an image, in units of length.
///
/// One number blurs equally in all directions. Slices that are thick beside their pixels want different ones: the blur needed along the
/// axis of the slices would wipe out small structures within them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur(pub(crate) [f64; 3]);

impl Blur {
    /// A blur with these standard deviations along x, y, z; that of a missing axis is not used.
    pub fn along(sigmas: [f64; 3]) -> Self {
        Self(sigmas)
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
