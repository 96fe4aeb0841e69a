//! Triangle meshes as posted, to which surfaces are fitted.

use super::read_points::take_points;
use crate::geometry::capability::fit::{ParameterSource, mesh_field};
use crate::geometry::mesh::{MeshError, TriangleMesh};
use crate::geometry::vector::norm;
use crate::service::app::Limits;
use crate::wire::checked::{Checked, LARGE, document, take_given};
use crate::wire::fault::Fault;
use crate::wire::shape::PointList;

document! {
    /// A triangle mesh to which a surface is fitted.
    pub struct MeshInput {
        /// Positions of the vertices.
        #[schema(value_type = Vec<[f64; 3]>, required = true)]
        vertices: PointList, required;
        /// Triangles as indices of their vertices, counter-clockwise as seen from outside.
        #[schema(value_type = Vec<[u32; 3]>, required = true)]
        faces: Checked<Vec<[u32; 3]>, LARGE>, required;
        /// Parameters `u` and `v` of every vertex.
        #[schema(value_type = Option<Vec<[f64; 2]>>)]
        parameters: PointList;
        /// Spherical parameterisation as an alternative to `parameters`: the position of every vertex on a sphere about
        /// the origin, with the north in direction z.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        sphere: PointList;
        /// Indices of the vertices at the north and the south pole, used when parameters are computed. Default: those
        /// at the ends of the longest principal axis.
        #[schema(value_type = Option<[u32; 2]>)]
        poles: Checked<[u32; 2]>;
    }
}

/// A validated mesh.
pub(crate) struct PostedMesh {
    pub(crate) mesh: TriangleMesh,
    pub(crate) source: ParameterSource,
}

impl PostedMesh {
    pub(crate) fn read(input: MeshInput, limits: &Limits) -> Result<Self, Vec<Fault>> {
        let mut errors = input.faults;
        let vertices = take_points(&input.vertices, "/vertices", &mut errors);
        let faces = take_given(input.faces, "/faces", &mut errors);
        let parameters = take_points(&input.parameters, "/parameters", &mut errors);
        let sphere = take_points(&input.sphere, "/sphere", &mut errors);
        let poles = take_given(input.poles, "/poles", &mut errors);
        // A field that is present but null has not been reported as missing.
        if vertices.is_none() && errors.is_empty() {
            errors.push(Fault::new("/vertices", "required field is missing"));
        }
        let (Some(vertices), Some(faces), true) = (vertices, faces, errors.is_empty()) else {
            return Err(errors);
        };
        let mut error = |pointer: &str, detail: String| errors.push(Fault::new(pointer, detail));
        let count = vertices.len();
        if count > limits.points || faces.len() > 4 * limits.points {
            error(
                "",
                format!(
                    "expected at most {1} vertices and {2} faces, got {count} and {0}",
                    faces.len(),
                    limits.points,
                    4 * limits.points
                ),
            );
        }
        let lengths =
            [(parameters.as_ref().map(Vec::len), "/parameters"), (sphere.as_ref().map(Vec::len), "/sphere")];
        for (length, pointer) in lengths {
            if let Some(length) = length.filter(|length| *length != count) {
                error(pointer, format!("expected {count} entries, one per vertex, got {length}"));
            }
        }
        if let Some(index) =
            sphere.as_ref().and_then(|list| list.iter().position(|point| norm(*point) == 0.0))
        {
            error(
                &format!("/sphere/{index}"),
                "expected a point other than the origin, which has no direction".into(),
            );
        }
        let mesh = TriangleMesh { vertices, normals: None, faces };
        if let Err(fault) = mesh.check_faces() {
            error(&format!("/{}", mesh_field(&fault)), fault.to_string());
        }
        let source = match (parameters, sphere, poles) {
            (Some(parameters), None, None) => ParameterSource::Given(parameters),
            (None, Some(sphere), None) => ParameterSource::Sphere(sphere),
            (None, None, poles) => ParameterSource::Computed { poles },
            _ => {
                error("", "expected only one of parameters, sphere and poles".into());
                ParameterSource::Computed { poles: None }
            }
        };
        if errors.is_empty() { Ok(Self { mesh, source }) } else { Err(errors) }
    }
}

/// Pointer to the invalid face in a list of faces.
pub(crate) fn face_pointer(fault: &MeshError) -> String {
    fault.face().map_or_else(String::new, |face| format!("/{face}"))
}
