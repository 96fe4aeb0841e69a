//! How parameter values of two shapes correspond.

/// The correspondence rule of a set of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Correspondence {
    /// Points correspond as given; their number must be that of the representation.
    #[default]
    Landmarks,
    /// Contours are resampled at equal arc length from their first point.
    ArcLength,
    /// Contours are resampled at equal arc length from a canonical start, and the start that best
    /// matches the mean is searched.
    Cyclic,
}

/// Whether a shape may be matched as its mirror image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Mirror {
    /// Shapes are taken as they are.
    #[default]
    Forbid,
    /// A shape or its mirror image, whichever matches the mean better.
    Allow,
}

/// The direction in which contours are traversed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Direction {
    /// As given.
    #[default]
    Given,
    /// It has no meaning: planar contours are brought to counter-clockwise, for contours in space the
    /// direction that best matches the mean is searched.
    Either,
}
