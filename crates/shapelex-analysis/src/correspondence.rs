//! Correspondence between the parameter values of two shapes.

/// Rule by which the points of two shapes correspond. `landmarks`: as given. `arc_length`: contours are resampled at equal
/// arc length from their first point. `cyclic`: as `arc_length`, and the start point that best matches the mean is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Correspondence {
    /// Points correspond as given. Every shape must have the number of points of the representation.
    #[default]
    Landmarks,
    /// Contours are resampled at equal arc length from their first point.
    ArcLength,
    /// Contours are resampled at equal arc length from a canonical start point; then the start point that best matches
    /// the mean is searched.
    Cyclic,
}

/// Mirror images: `forbid` uses shapes as given; `allow` uses the shape or its mirror image, whichever matches the mean
/// better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Mirror {
    /// Shapes are used as given.
    #[default]
    Forbid,
    /// The shape or its mirror image is used, whichever matches the mean better.
    Allow,
}

/// Treatment of the direction in which contours are traversed: `given` keeps it as posted; `either` disregards it. Then planar
/// contours are made counter-clockwise, and for contours in space the direction that best matches the mean is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Direction {
    /// The direction is kept as given.
    #[default]
    Given,
    /// The direction is disregarded: planar contours are made counter-clockwise; for contours in space, the direction
    /// that best matches the mean is searched.
    Either,
}
