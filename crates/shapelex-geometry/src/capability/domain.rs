//! Domains: names of places on a shape; and properties of a representation before its space is prepared.

use crate::GeometryError;
use crate::field_fault::FieldFault;
use crate::generator::GeneratorKind;
use crate::knot_line::SHIFTED_CLOSED;
use crate::mesh::MeshError;
use crate::representation::{Knots, Representation, ShapeSpace};
use crate::subdivision::basis::SubdivisionBasis;
use crate::subdivision::oriented::OrientedMeshes;
use crate::subdivision::stencil::check_valences;
use crate::subdivision::{Scheme, Subdivision};
use crate::surface::Topology;
use crate::surface::basis::{self, Extent};
use crate::surface::seam::Seam;

/// Domain of a shape: the names of its places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// Nothing: the shape is a list of points.
    Points,
    /// One parameter `u ∈ [0, 1]`.
    Line {
        /// Whether `u = 0` and `u = 1` are the same place.
        closed: bool,
    },
    /// Two parameters `(u, v) ∈ [0, 1]²`.
    Sheet {
        /// Topology, and number of intervals between knots.
        extent: Extent,
        /// Gluing of the ends of `u`.
        seam: Seam,
    },
    /// The vertices of a mesh at its level.
    Vertices,
}

impl Domain {
    /// Whether places are named by one parameter.
    pub fn is_line(self) -> bool {
        matches!(self, Self::Line { .. })
    }

    /// Whether places are named by two parameters.
    pub fn is_sheet(self) -> bool {
        matches!(self, Self::Sheet { .. })
    }

    /// Whether places are the vertices of a mesh.
    pub fn is_mesh(self) -> bool {
        self == Self::Vertices
    }

    /// Whether shapes are surfaces, given by two parameters or by a mesh.
    pub fn is_surface(self) -> bool {
        self.is_sheet() || self.is_mesh()
    }

    /// Faults of parameters `[u, v]` outside of a domain with two parameters, at `{index}/{direction}`; no faults on other
    /// domains. One fault per pair at most.
    pub fn pair_faults(self, list: &[[f64; 2]]) -> Vec<FieldFault> {
        let Self::Sheet { extent, seam } = self else { return Vec::new() };
        let (closed, straight) = (extent.topology.closed(), seam.is_straight());
        let wrong = |i: usize, value: f64| match (closed[i], i == 0 && !straight) {
            (true, false) => false,
            (true, true) => !(0.0..1.0).contains(&value),
            (false, _) => !(0.0..=1.0).contains(&value),
        };
        let faults = list.iter().enumerate().filter_map(|(k, parameters)| {
            let i = (0..2).find(|&i| wrong(i, parameters[i]))?;
            let detail = format!("expected a number between 0 and 1, got {}", parameters[i]);
            Some(FieldFault::new(format!("{k}/{i}"), detail))
        });
        faults.collect()
    }

    /// Fault of a parameter `u` of a domain with one parameter, if any.
    pub fn line_fault(self, u: f64) -> Option<String> {
        let outside = self == Self::Line { closed: false } && !(0.0..=1.0).contains(&u);
        outside.then(|| format!("expected a number between 0 and 1 on an open curve, got {u}"))
    }
}

/// Bounds on the size of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SizeBounds {
    /// Maximum number of control points.
    pub control_points: usize,
    /// Maximum number of vertices of a refined mesh.
    pub vertices: usize,
}

/// A representation whose sizes are within bounds and whose fields fit together.
#[derive(Debug, Clone, PartialEq)]
pub struct Admitted(Representation);

impl Admitted {
    /// Checks a representation.
    ///
    /// # Errors
    /// Sizes that are out of bounds and fields that do not fit together; for a control mesh within bounds, the first invalid
    /// face or vertex.
    pub fn new(representation: Representation, bounds: SizeBounds) -> Result<Self, Vec<FieldFault>> {
        let faults = representation.faults(bounds);
        if faults.is_empty() { Ok(Self(representation)) } else { Err(faults) }
    }

    /// Whether constants are reproduced, so that moving all control points moves the shape.
    pub fn reproduces_constants(&self) -> bool {
        let unity = |generator: &GeneratorKind| generator.properties().partition_of_unity;
        self.knots().iter().all(|knots| knots.generator.is_none_or(unity))
    }
}

impl std::ops::Deref for Admitted {
    type Target = Representation;

    fn deref(&self) -> &Representation {
        &self.0
    }
}

impl Representation {
    /// Names of places on its shapes.
    pub fn domain(&self) -> Domain {
        match self {
            Self::ClosedCurve { .. } => Domain::Line { closed: true },
            Self::OpenCurve { .. } => Domain::Line { closed: false },
            Self::Surface { topology, seam, control_points, .. } => {
                let extent = Extent { topology: *topology, intervals: *control_points };
                Domain::Sheet { extent, seam: *seam }
            }
            Self::Subdivision(_) => Domain::Vertices,
            Self::Landmarks { .. } => Domain::Points,
        }
    }

    /// Name of the kind in JSON.
    pub fn kind_name(&self) -> &'static str {
        match self {
            Self::ClosedCurve { .. } => "closed_curve",
            Self::OpenCurve { .. } => "open_curve",
            Self::Surface { .. } => "surface",
            Self::Subdivision(_) => "subdivision",
            Self::Landmarks { .. } => "landmarks",
        }
    }

    /// Field at which an error of preparing the space is reported, once sizes are within bounds.
    pub fn decisive_field(&self, error: &GeometryError) -> &'static str {
        match (self, error) {
            (_, GeometryError::NotLinear) => "scheme",
            (Self::Subdivision(_), _) => "level",
            (Self::Surface { .. }, _) => "generators",
            _ => "generator",
        }
    }

    /// Whether its shapes form a linear space, with an inner product: all but those of points and normals.
    pub fn is_linear(&self) -> bool {
        !self
            .subdivision()
            .is_some_and(|subdivision| matches!(subdivision.scheme, Scheme::NormalBased { .. }))
    }

    /// Number of vertices of its refined mesh; 0 for shapes that are not refined.
    pub fn refined_vertices(&self) -> usize {
        self.subdivision().map_or(0, |subdivision| subdivision.size().vertices)
    }

    /// Number of splits of its refined mesh; 0 for shapes that are not refined.
    pub fn splits(&self) -> usize {
        self.subdivision().map_or(0, |subdivision| subdivision.level)
    }

    /// Number of cells between knots: intervals of a curve, `M_u M_v` of a surface.
    pub fn cells(&self) -> usize {
        self.knots().iter().map(|knots| knots.count).product()
    }

    /// Number of control points of an open curve before its first knot; 0 of other shapes.
    pub fn points_before(&self) -> usize {
        let generator = self.generator().filter(|_| !self.is_closed());
        generator.map_or(0, |generator| generator.beyond()[0])
    }

    /// Default number of places at which two of its shapes are compared.
    pub fn comparison_places(&self) -> usize {
        if self.extent().is_some() { self.point_count() } else { self.size() }
    }

    /// The same surface with other numbers of intervals between knots; other shapes are unchanged.
    pub fn with_intervals(&self, intervals: [usize; 2]) -> Self {
        let mut other = self.clone();
        if let Self::Surface { control_points, .. } = &mut other {
            *control_points = intervals;
        }
        other
    }

    /// The same surface with other generators; other shapes are unchanged.
    pub(crate) fn with_generators(&self, kinds: [GeneratorKind; 2]) -> Self {
        let mut other = self.clone();
        if let Self::Surface { generators, .. } = &mut other {
            *generators = kinds;
        }
        other
    }

    /// The same surface with `width` intervals between knots along both directions, or the fewest that are valid, and an even number
    /// behind a half turn; other shapes are unchanged.
    pub fn of_width(&self, width: usize) -> Self {
        let fewest: Vec<usize> = self.knots().iter().map(|knots| knots.fewest).collect();
        let &[u, v] = fewest.as_slice() else { return self.clone() };
        let half_turn = matches!(self, Self::Surface { seam: Seam::HalfTurn, .. });
        let along_v = width.max(v);
        self.with_intervals([width.max(u), if half_turn { along_v.next_multiple_of(2) } else { along_v }])
    }

    /// Shapes of points and normals, if these are not linear.
    ///
    /// # Errors
    /// Faces of the control mesh that do not form a surface.
    pub fn oriented(&self) -> Result<Option<OrientedMeshes<'_>>, MeshError> {
        self.subdivision().filter(|_| !self.is_linear()).map(OrientedMeshes::new).transpose()
    }

    /// Sizes that are out of bounds and fields that do not fit together, by field.
    fn faults(&self, bounds: SizeBounds) -> Vec<FieldFault> {
        if let Some(subdivision) = self.subdivision() {
            return subdivision_faults(subdivision, bounds);
        }
        let mut faults = Vec::new();
        if !(2..=3).contains(&self.dimension()) {
            faults.push(FieldFault::new("dimension", format!("expected 2 or 3, got {}", self.dimension())));
        }
        let knots = self.knots();
        for Knots { generator, generator_field, .. } in &knots {
            let found = generator.map(GeneratorKind::faults).unwrap_or_default().into_iter();
            faults.extend(
                found.map(|(field, detail)| FieldFault::new(format!("{generator_field}/{field}"), detail)),
            );
        }
        let admissible = faults.is_empty();
        faults.extend(knots.iter().filter_map(|knots| count_fault(knots, bounds.control_points, admissible)));
        if faults.is_empty()
            && let Self::ClosedCurve { generator, .. } = self
            && generator.is_shifted()
        {
            faults.push(FieldFault::new("generator", SHIFTED_CLOSED));
        }
        if faults.is_empty() {
            faults = self.surface_faults(bounds.control_points);
        }
        faults
    }

    /// Faults of a surface whose directions have none.
    fn surface_faults(&self, most: usize) -> Vec<FieldFault> {
        let Self::Surface { seam, generators, topology, control_points } = self else { return Vec::new() };
        let extent = Extent { topology: *topology, intervals: *control_points };
        let found = basis::faults(extent, *seam, generators).into_iter();
        let mut faults: Vec<_> = found.map(|(field, detail)| FieldFault::new(field, detail)).collect();
        let size = self.size();
        if size > most {
            let detail = format!("expected at most {most} control points, got {size}");
            faults.push(FieldFault::new("control_points", detail));
        }
        faults
    }

    /// Why its shapes have no mean, inner product and components, if they have none.
    pub fn linearity_fault(&self) -> Option<FieldFault> {
        (!self.is_linear()).then(|| FieldFault::new("scheme", GeometryError::NotLinear.to_string()))
    }
}

/// Sizes out of bounds; else the first invalid face or vertex of the control mesh.
fn subdivision_faults(subdivision: &Subdivision, bounds: SizeBounds) -> Vec<FieldFault> {
    let mut faults = Vec::new();
    let (control, fine) = (subdivision.connectivity.size(), subdivision.size());
    if control.vertices > bounds.control_points {
        let (found, most) = (control.vertices, bounds.control_points);
        let detail = format!("expected at most {most} control points, got {found}");
        faults.push(FieldFault::new("connectivity", detail));
    }
    if fine.vertices > bounds.vertices {
        let (level, most) = (subdivision.level, bounds.vertices);
        let error = GeometryError::TooFine { level, vertices: fine.vertices, most };
        faults.push(FieldFault::new("level", format!("expected a level below {level}: {error}")));
    }
    if faults.is_empty() {
        faults.extend(control_mesh_fault(subdivision));
    }
    faults
}

/// The first invalid face or vertex of a control mesh.
fn control_mesh_fault(subdivision: &Subdivision) -> Option<FieldFault> {
    match subdivision.control() {
        Err(fault) => {
            let place = fault.face().map_or_else(String::new, |face| format!("/{face}"));
            Some(FieldFault::new(format!("connectivity{place}"), fault.to_string()))
        }
        Ok(mesh) => {
            let fault = check_valences(subdivision.scheme, &mesh).err()?;
            Some(FieldFault::new("connectivity", fault.to_string()))
        }
    }
}

/// Fault of a number of control points; `admissible`: the generators have no faults.
fn count_fault(knots: &Knots<'_>, most: usize, admissible: bool) -> Option<FieldFault> {
    let Knots { field, count, fewest, generator, generator_field, closed } = *knots;
    if fewest > most && admissible {
        let detail = "expected |Im| below π and |Re| up to 10 after division by the number of control points or intervals";
        let field = format!("{generator_field}/domain_poles");
        return Some(FieldFault::new(
            field,
            format!("{detail} (at most {most}): these poles need a finer grid"),
        ));
    }
    if (fewest..=most).contains(&count) {
        return None;
    }
    let reason = match generator {
        Some(_) if count < fewest && closed && fewest > 3 => {
            ": the domain poles divided by this number must have |Im| < π and |Re| ≤ 10"
        }
        Some(_) if count < fewest && !closed => {
            ": to continue beyond its ends, the curve needs at least one interval less than it has poles, and \
             the domain poles divided by this number must have |Im| < π and |Re| ≤ 10"
        }
        _ => "",
    };
    let detail = format!("expected a number between {fewest} and {most}, got {count}{reason}");
    Some(FieldFault::new(field, detail))
}

impl ShapeSpace {
    /// Names of places on its shapes.
    pub fn domain(&self) -> Domain {
        self.representation().domain()
    }

    /// Whether all meridians of its shapes start and end in two poles.
    pub fn has_poles(&self) -> bool {
        matches!(self.domain(), Domain::Sheet { extent, .. } if extent.topology.has_poles())
    }

    /// Whether its shapes have one tangent plane at each pole.
    pub fn has_smooth_poles(&self) -> bool {
        matches!(self.domain(), Domain::Sheet { extent, .. } if extent.topology == Topology::Sphere)
    }

    /// Whether preparing the space takes far longer than its use for one shape, so that it is worth keeping.
    pub fn is_costly(representation: &Representation) -> bool {
        representation.domain().is_mesh()
    }

    /// Approximate memory of its basis in bytes; 0 if the basis is quickly made again.
    pub fn basis_bytes(&self) -> usize {
        self.subdivision().map_or(0, SubdivisionBasis::bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capability::sample::Parameters;
    use shapelex_numeric::dense::Matrix;

    fn surface(topology: Topology, seam: Seam) -> Representation {
        Representation::Surface {
            topology,
            seam,
            control_points: [8, 6],
            generators: [GeneratorKind::Trigonometric {}, GeneratorKind::Trigonometric {}],
        }
    }

    fn open_curve() -> Representation {
        Representation::OpenCurve { dimension: 2, intervals: 6, generator: GeneratorKind::Cubic {} }
    }

    #[test]
    fn parameters_outside_of_a_domain_are_named() {
        let fields = |domain: Domain, list: &[[f64; 2]]| -> Vec<String> {
            domain.pair_faults(list).into_iter().map(|fault| fault.field).collect()
        };
        let list = [[-0.25, 0.5], [0.5, 1.25], [1.0, 0.5]];
        assert_eq!(fields(surface(Topology::Sphere, Seam::Straight).domain(), &list), ["1/1"]);
        assert_eq!(fields(surface(Topology::Torus, Seam::Reflected).domain(), &list), ["0/0", "2/0"]);
        assert_eq!(fields(surface(Topology::Plane, Seam::Straight).domain(), &list), ["0/0", "1/1"]);
        assert_eq!(fields(open_curve().domain(), &list), [""; 0]);
        assert!(open_curve().domain().line_fault(1.5).is_some_and(|detail| detail.ends_with("got 1.5")));
        assert_eq!(Domain::Line { closed: true }.line_fault(1.5), None);
    }

    #[test]
    fn handles_have_as_many_parameters_as_the_domain() {
        let fields = |representation: &Representation, parameters: &[f64]| -> Vec<String> {
            representation.handle_faults(parameters).into_iter().map(|fault| fault.field).collect()
        };
        let sphere = surface(Topology::Sphere, Seam::Straight);
        assert_eq!(fields(&sphere, &[0.25, 1.5]), ["1"]);
        assert_eq!(fields(&sphere, &[0.25]), [""]);
        assert_eq!(fields(&open_curve(), &[0.25]), [""; 0]);
        assert_eq!(fields(&open_curve(), &[-1.0]), [""]);
        assert_eq!(fields(&Representation::Landmarks { dimension: 2, points: 4 }, &[0.25, 0.5]), [""]);
    }

    /// Measures that a kind lacks are `None`, not zero.
    #[test]
    fn landmarks_have_no_values_and_no_measures() {
        let representation = Representation::Landmarks { dimension: 2, points: 4 };
        let (space, points) = (ShapeSpace::new(&representation).unwrap(), Matrix::zeros(4, 2));
        assert_eq!(space.evaluate(&points, &Parameters::Equidistant(5), 0, false), None);
        assert_eq!(space.tessellate(&points, Some([8, 8])), None);
        let measures = crate::capability::measure::Measuring::new(&space, None, None, 1);
        assert_eq!(measures.measure(&points, &|| false), Some(Default::default()));
        let faults = representation.faults(SizeBounds { control_points: 3, vertices: 10 });
        assert_eq!(faults, [FieldFault::new("points", "expected a number between 2 and 3, got 4")]);
    }
}
