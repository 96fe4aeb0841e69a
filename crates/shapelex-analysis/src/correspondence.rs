//! Correspondence between the parameter values of two shapes.

use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::representation::Representation;
use shapelex_geometry::surface::Topology;

/// Rule by which the points of two shapes correspond. `landmarks`: as given. `arc_length`: contours are resampled at equal
/// arc length from their first point. `cyclic`: as `arc_length`, and the start point that best matches the mean is searched; of
/// spheres, cylinders and tori, the rotation of the parameter sphere or the start of each closed direction is searched.
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
    /// the mean is searched. The parameters of surfaces move: those of a sphere by the rotation of the parameter sphere that best
    /// matches the mean, poles included, those of cylinders and tori by shifts of their closed directions.
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
/// contours are made counter-clockwise, and for contours in space the direction that best matches the mean is searched, as it is for
/// cylinders and tori under `cyclic`. Where a request gives none, closed planar curves whose start is searched (`cyclic`) are
/// compared in `either` direction, all other shapes as `given`.
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

impl Direction {
    /// The default for shapes of `representation`: [`Self::Either`] for closed planar curves whose start is searched, else
    /// [`Self::Given`]. Where a tracing begins is then of no account, and so is the way in which it runs: which of the two a file
    /// holds is a habit of the program that wrote it.
    pub fn usual(correspondence: Correspondence, representation: &Representation) -> Self {
        let closed = representation.domain() == Domain::Line { closed: true };
        let searched = correspondence == Correspondence::Cyclic;
        if searched && closed && representation.dimension() == 2 { Self::Either } else { Self::Given }
    }
}

impl Correspondence {
    /// Why it does not apply to shapes with this domain, if it does not.
    pub fn fault(self, domain: Domain) -> Option<&'static str> {
        match (domain, self) {
            (_, Self::Landmarks) => None,
            (Domain::Sheet { extent, seam }, Self::Cyclic)
                if extent.topology != Topology::Plane && seam.is_straight() =>
            {
                None
            }
            (Domain::Sheet { .. }, Self::Cyclic) => {
                Some("expected \"landmarks\": the parameters of planes and of twisted tori have no motions")
            }
            (Domain::Sheet { .. }, Self::ArcLength) => Some(
                "expected \"landmarks\" or \"cyclic\": the points of a surface correspond by their place in \
                 the grid",
            ),
            (Domain::Vertices, _) => {
                Some("expected \"landmarks\": the vertices of a control mesh correspond by their place")
            }
            (Domain::Points, _) => Some(
                "expected \"landmarks\": landmarks are not a contour (to resample, use a closed_curve or \
                 open_curve)",
            ),
            (Domain::Line { closed: false }, Self::Cyclic) => {
                Some("expected \"arc_length\" or \"landmarks\": an open curve has no start point to search")
            }
            (Domain::Line { .. }, _) => None,
        }
    }
}

impl Mirror {
    /// Why shapes with this domain have no mirror images, if they are requested.
    pub fn fault(self, domain: Domain) -> Option<&'static str> {
        (self == Self::Allow && domain.is_mesh()).then_some(
            "expected \"forbid\" for subdivision surfaces, got \"allow\": the correspondence between a \
             control mesh and its mirror image is unknown",
        )
    }
}
