//! Residuals of the fits of an upload to meshes.

use serde::{Deserialize, Serialize};

use crate::domain::shape::{FitResidual, ShapeMeasures};

/// Part of the centroid size of a surface beyond which the mean distance of its mesh is worth a warning. Modes of shapes are a few per
/// cent of their size, and the residual of the representation should be less.
const COARSE: f64 = 0.01;

/// Residual of the fit of a surface to a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MeshResidual {
    /// Mean distance of the points of the mesh from their places on the surface, over its area, in the unit of the points.
    mean: f64,
    /// Largest such distance.
    largest: f64,
    /// Area of the surface, relative to that of the mesh, minus one.
    area: f64,
}

impl From<FitResidual> for MeshResidual {
    fn from(FitResidual { mean, largest, area }: FitResidual) -> Self {
        Self { mean, largest, area }
    }
}

/// The fits of an upload to meshes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, utoipa::ToSchema)]
pub struct MeshFits {
    /// Number of surfaces that were fitted.
    count: usize,
    /// Number of those whose mesh is farther away than a hundredth of their size in the mean.
    coarse: usize,
    /// Largest mean distance of a mesh from its surface, as a part of the size of the surface.
    worst: f64,
}

impl MeshFits {
    /// Notes a shape, if it was fitted.
    pub(super) fn note(&mut self, measures: &ShapeMeasures) {
        let (Some(fit), Some(size)) = (measures.fit, measures.centroid_size) else { return };
        let relative = fit.mean / size;
        self.count += 1;
        self.coarse += usize::from(relative > COARSE);
        self.worst = self.worst.max(relative);
    }

    /// The fits, if there are any.
    pub(super) fn any(self) -> Option<Self> {
        (self.count > 0).then_some(self)
    }

    /// A warning of surfaces that their control points represent coarsely.
    pub(super) fn warning(&self) -> Option<String> {
        (self.coarse > 0).then(|| {
            format!(
                "{} of {} surfaces are farther from their meshes than {:.0} % of their size in the mean, the worst by {:.1} %: \
                 choose more control points (measures.fit_mean, measures.fit_largest and measures.fit_area tell of each)",
                self.coarse,
                self.count,
                100.0 * COARSE,
                100.0 * self.worst
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_fits_are_counted_relative_to_the_size() {
        let mut fits = MeshFits::default();
        let measures = |mean, size| ShapeMeasures {
            fit: Some(FitResidual { mean, largest: 3.0 * mean, area: -0.01 }),
            centroid_size: Some(size),
            ..ShapeMeasures::default()
        };
        fits.note(&measures(0.5, 100.0));
        fits.note(&ShapeMeasures::default());
        assert_eq!(fits.warning(), None);
        fits.note(&measures(0.5, 20.0));
        let text = fits.warning().unwrap();
        assert!(text.starts_with("1 of 2 surfaces") && text.contains("the worst by 2.5 %"), "{text}");
    }
}
