//! Drawings of atoms, and modes of components.

use serde_json::json;

use super::ready::Ready;
use crate::analysis::dictionary::modes::Mode;
use crate::analysis::drawing::{self, View};
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::texture::TexturedMesh;
use crate::service::app::ServiceError;
use crate::service::shapes::mesh::mesh_of;
use crate::wire::gltf::Displacement;

impl Ready {
    /// Shapes in the pose of the dictionary as they are drawn.
    pub fn view(&self) -> View<'_> {
        drawing::view_of(&self.setup.space, self.dictionary())
    }
}

/// Drawing of the atoms, each in its own frame on a common scale.
pub fn draw_atoms(ready: &Ready) -> Drawing {
    let name = format!("{} version {}", ready.listed.name, ready.listed.version);
    drawing::draw_atoms(&ready.view(), &name, ready.dictionary())
}

/// The mode of `component` (from 1): `ȳ ± sigma·√C_ii ξ_i`.
///
/// # Errors
/// A component that does not exist, a sparse dictionary, a sigma out of bounds.
pub fn mode(ready: &Ready, component: usize, sigma: f64) -> Result<Mode, ServiceError> {
    if ready.dictionary().content.method.is_sparse() {
        let detail = "expected a dictionary of components: a sparse one has atoms, see …/atoms";
        return Err(ServiceError::parameter("dictionary", detail));
    }
    let found = ready.dictionary().model.len();
    let absent = || {
        let detail = format!("expected a number between 1 and {found}, got {component}");
        ServiceError::parameter("component", detail)
    };
    let position = component.checked_sub(1).filter(|position| *position < found).ok_or_else(absent)?;
    if !(sigma.is_finite() && sigma.abs() <= MAX_SIGMA) {
        let detail = format!("expected a number within ±{MAX_SIGMA}, got {sigma}");
        return Err(ServiceError::parameter("sigma", detail));
    }
    ready.dictionary().mode(position, sigma).ok_or_else(absent)
}

/// Maximum number of modes of a file.
pub const MAX_TARGETS: usize = 16;
/// Maximum number of vertices of a file, those of all modes together.
const MAX_VERTICES: usize = 2_000_000;

/// The mean surface, and the surfaces at `sigma` standard deviations along the modes, or along one of them (from 1).
///
/// # Errors
/// As [`mode`]; shapes that are not surfaces, grids that form no mesh, too many vertices.
pub fn displacements(
    ready: &Ready,
    component: Option<usize>,
    sigma: f64,
    grid: Option<[usize; 2]>,
) -> Result<(TexturedMesh, impl Iterator<Item = Result<Displacement, ServiceError>>), ServiceError> {
    let space = &ready.setup.space;
    let components = match component {
        Some(component) => component..=component,
        None => 1..=ready.dictionary().model.len().clamp(1, MAX_TARGETS),
    };
    let mean = mesh_of(space, &mode(ready, *components.start(), sigma)?.shapes[1], grid)?;
    let vertices = mean.mesh.vertices.len() * (components.end() - components.start() + 2);
    if vertices > MAX_VERTICES {
        let detail = format!(
            "expected at most {MAX_VERTICES} vertices over the mean and all modes, got {vertices}: ask for one \
             component, or for a smaller grid"
        );
        return Err(ServiceError::parameter("grid", detail));
    }
    let displacement = move |component: usize| {
        let found = mode(ready, component, sigma)?;
        let extras = json!({"standard_deviations": sigma, "explained": found.explained});
        let mesh = mesh_of(space, &found.shapes[2], grid)?.mesh;
        Ok(Displacement { name: format!("mode {component}"), mesh, extras })
    };
    Ok((mean, components.map(displacement)))
}

/// Maximum step along a mode, in standard deviations.
const MAX_SIGMA: f64 = 1e6;

/// Drawing of a mode.
pub fn draw_mode(ready: &Ready, component: usize, sigma: f64, mode: &Mode) -> Drawing {
    let title = drawing::mode_title(component, mode.explained, ready.dictionary().is_centred());
    let drawing = drawing::draw_mode(&ready.view(), &title, sigma, &mode.shapes);
    ready.setup.in_scale(drawing, ready.dictionary().content.length_unit.as_deref())
}
