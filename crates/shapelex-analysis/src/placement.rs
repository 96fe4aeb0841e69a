//! Placements of shapes: where they start, in which direction they run, and whether they are mirrored.

/// Placement of one shape on the mean: mirrored (first coordinate negated), then reversed (`u → −u`, end to end
/// for open curves), then started at row `shift`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Placement {
    /// Row at which a contour starts; on surfaces the [code](shapelex_geometry::surface::motion::Motion::code) of the motion of its parameters.
    pub shift: u32,
    /// Whether the shape is traversed backwards.
    pub reversed: bool,
    /// Whether the first coordinate is negated.
    pub mirrored: bool,
}

impl Placement {
    /// Whether both differ at most in the start point.
    pub(crate) fn is_image_of(self, other: Self) -> bool {
        (self.mirrored, self.reversed) == (other.mirrored, other.reversed)
    }
}
