//! Drawings of atoms, and modes of components.

use super::ready::Ready;
use crate::analysis::dictionary::modes::Mode;
use crate::analysis::drawing;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::ServiceError;

/// Drawing of the atoms, each in its own frame on a common scale.
pub fn draw_atoms(ready: &Ready) -> Drawing {
    let title = format!("atoms of {} version {}", ready.listed.name, ready.listed.version);
    drawing::draw_atoms(&ready.setup.space, &title, &ready.dictionary)
}

/// The mode of `component` (from 1): `ȳ ± sigma·√C_ii ξ_i`.
///
/// # Errors
/// A component that does not exist, a sparse dictionary, a sigma out of bounds.
pub fn mode(ready: &Ready, component: usize, sigma: f64) -> Result<Mode, ServiceError> {
    if ready.dictionary.content.method.is_sparse() {
        let detail = "expected a dictionary of components: a sparse one has atoms, see …/atoms";
        return Err(ServiceError::parameter("dictionary", detail));
    }
    let found = ready.dictionary.model.len();
    let absent = || {
        let detail = format!("expected a number between 1 and {found}, got {component}");
        ServiceError::parameter("component", detail)
    };
    let position = component.checked_sub(1).filter(|position| *position < found).ok_or_else(absent)?;
    if !(sigma.is_finite() && sigma.abs() <= MAX_SIGMA) {
        let detail = format!("expected a number within ±{MAX_SIGMA}, got {sigma}");
        return Err(ServiceError::parameter("sigma", detail));
    }
    ready.dictionary.mode(position, sigma).ok_or_else(absent)
}

/// Maximum step along a mode, in standard deviations.
const MAX_SIGMA: f64 = 1e6;

/// Drawing of a mode.
pub fn draw_mode(ready: &Ready, component: usize, sigma: f64, mode: &Mode) -> Drawing {
    let title = format!("mode {component}: {:.1} %", 100.0 * mode.explained);
    let drawing = drawing::draw_mode(&ready.setup.space, &title, sigma, &mode.shapes);
    ready.setup.in_scale(drawing, ready.dictionary.content.length_unit.as_deref())
}
